//! Rescues recordings that were cut: everything up to the damage goes into a complete file beside the cut one.
//!
//! Works on any MCAP file. Nothing is ever overwritten, and the damaged file is not touched by [`recover`].

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::input::container::{Entry, visit};
use crate::input::{Damage, InputError};
use crate::record::{ACTIVE, sync_folder};

/// Content of a chunk (bytes): as MCAP's own tools have it.
const CHUNK: u64 = 1 << 20;

/// What was rescued.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Recovery {
    /// The complete file.
    pub output: PathBuf,
    /// Messages in it.
    pub messages: u64,
    /// Where and why the input could not be read on; `None` where it was whole.
    pub damage: Option<Damage>,
    /// Whether all that had been written is there: at most the summary was missing.
    pub is_lossless: bool,
}

impl Recovery {
    /// Exit code as MCAP's own tool has it: 0 lossless, 3 something is lost.
    pub fn exit_code(&self) -> u8 {
        if self.is_lossless { 0 } else { 3 }
    }
}

/// Why nothing was rescued (exit code 1).
#[derive(Debug, thiserror::Error)]
pub enum RecoverError {
    /// The input cannot be read.
    #[error(transparent)]
    Input(#[from] InputError),
    /// Not even the beginning of an MCAP file.
    #[error("{}: nothing to rescue: {what}", path.display())]
    Nothing {
        /// The file.
        path: PathBuf,
        /// Why.
        what: String,
    },
    /// It is being written.
    #[error("{}: is being written by a running recorder", path.display())]
    InUse {
        /// The file.
        path: PathBuf,
    },
    /// The output exists.
    #[error("{}: exists already, and nothing is overwritten: move it away first", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The output cannot be written.
    #[error("{}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: mcap::McapError,
    },
}

/// Rescues one file: `NAME.mcap.active` becomes `NAME.mcap`, any other `NAME.recovered.mcap`, beside it.
///
/// # Errors
/// Where nothing can be rescued or written; then there is no output.
pub fn recover(path: &Path) -> Result<Recovery, RecoverError> {
    let output = output_name(path);
    if output.exists() {
        return Err(RecoverError::Exists { path: output });
    }
    if is_locked(path).map_err(|source| InputError::Io { path: path.to_owned(), source })? {
        return Err(RecoverError::InUse { path: path.to_owned() });
    }
    let write_error =
        |source: std::io::Error| RecoverError::Write { path: output.clone(), source: source.into() };
    let folder = output.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let file = tempfile::Builder::new().prefix(".recovering").tempfile_in(folder).map_err(write_error)?;
    let mut copy = Copy { writer: None, file: file.as_file(), messages: 0, error: None };
    let seen = visit(path, &mut |entry, _| copy.take(entry))?;
    let messages = copy.messages;
    copy.finish().map_err(|source| RecoverError::Write { path: output.clone(), source })?.ok_or_else(
        || {
            let what = seen.damage.as_ref().map_or("it is empty", |damage| damage.what.as_str());
            RecoverError::Nothing { path: path.to_owned(), what: what.to_owned() }
        },
    )?;
    file.as_file().sync_all().map_err(write_error)?;
    // Temporary files are readable by their owner only; the rescued one by whom the cut one is.
    if let Ok(data) = std::fs::metadata(path) {
        file.as_file().set_permissions(data.permissions()).map_err(write_error)?;
    }
    file.persist_noclobber(&output).map_err(|error| match error.error.kind() {
        std::io::ErrorKind::AlreadyExists => RecoverError::Exists { path: output.clone() },
        _ => write_error(error.error),
    })?;
    sync_folder(&output).map_err(write_error)?;
    let is_lossless = seen.damage.is_none() || seen.ends_clean;
    Ok(Recovery { output, messages, damage: seen.damage, is_lossless })
}

/// Completes what an earlier run left in `folder` as `.active`, except what another process is writing. A rescued file
/// is removed where nothing of it was lost, and becomes `NAME.mcap.damaged` where something was.
///
/// Gives each file with what became of it.
///
/// # Errors
/// Where the folder cannot be read.
pub fn recover_left_over(folder: &Path) -> std::io::Result<Vec<(PathBuf, Result<Recovery, RecoverError>)>> {
    let mut left_over: Vec<PathBuf> = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.to_string_lossy().ends_with(&format!(".mcap.{ACTIVE}")) && !is_locked(&path)? {
            left_over.push(path);
        }
    }
    left_over.sort();
    let recover_and_clear = |path: PathBuf| {
        let recovered = recover(&path).and_then(|recovery| {
            let cleared = if recovery.is_lossless {
                std::fs::remove_file(&path)
            } else {
                std::fs::rename(&path, path.with_extension("damaged"))
            };
            cleared.map_err(|source| InputError::Io { path: path.clone(), source })?;
            Ok(recovery)
        });
        (path, recovered)
    };
    Ok(left_over.into_iter().map(recover_and_clear).collect())
}

fn output_name(path: &Path) -> PathBuf {
    if path.extension().is_some_and(|ending| ending == ACTIVE) {
        path.with_extension("")
    } else {
        path.with_extension("recovered.mcap")
    }
}

/// Whether a recorder holds the file. File systems without locks have no way to tell.
fn is_locked(path: &Path) -> std::io::Result<bool> {
    let file = File::open(path)?;
    let lock = rustix::fs::flock(&file, rustix::fs::FlockOperation::NonBlockingLockShared);
    Ok(lock == Err(rustix::io::Errno::WOULDBLOCK))
}

/// Copies entries to a new file, with the same ids.
struct Copy<'a> {
    writer: Option<mcap::Writer<BufWriter<&'a File>>>,
    file: &'a File,
    messages: u64,
    error: Option<mcap::McapError>,
}

impl Copy<'_> {
    /// Returns false, and keeps the error, where it cannot be written.
    fn take(&mut self, entry: Entry<'_>) -> bool {
        match self.write(entry) {
            Ok(()) => true,
            Err(error) => {
                self.error = Some(error);
                false
            }
        }
    }

    fn write(&mut self, entry: Entry<'_>) -> mcap::McapResult<()> {
        if let Entry::Header(header) = &entry {
            let options =
                crate::record::write_options().chunk_size(Some(CHUNK)).profile(header.profile.as_str());
            self.writer = Some(options.create(BufWriter::new(self.file))?);
        }
        let Some(writer) = &mut self.writer else { return Ok(()) };
        match entry {
            Entry::Header(_) => {}
            Entry::Schema(header, data) => {
                writer.add_schema_with_id(header.id, &header.name, &header.encoding, data)?;
            }
            Entry::Channel(channel) => {
                let mcap::records::Channel { id, schema_id, topic, message_encoding, metadata } = channel;
                writer.add_channel_with_id(*id, *schema_id, topic, message_encoding, metadata)?;
            }
            Entry::Message { header, data, .. } => {
                writer.write_to_known_channel(&header, data)?;
                self.messages += 1;
            }
            Entry::Metadata(metadata) => writer.write_metadata(&metadata)?,
            Entry::Attachment(attachment) => writer.attach(&attachment)?,
        }
        Ok(())
    }

    /// `None` where there was not even a header.
    fn finish(self) -> mcap::McapResult<Option<()>> {
        if let Some(error) = self.error {
            return Err(error);
        }
        let Some(mut writer) = self.writer else { return Ok(None) };
        writer.finish()?;
        writer.into_inner().flush()?;
        Ok(Some(()))
    }
}
