//! MCAP files read from front to back, record by record, as far as they are whole.

use std::collections::HashMap;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use mcap::records::{MessageHeader, Metadata, Record};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::bag::Bag;
use super::own::Recording;
use super::{Damage, InputError, InputOptions, InputReport, Source, read_up_to};
use crate::record::{FileInfo, SESSION, topic};

/// No message or attachment of a recording is larger (bytes): a damaged length must not take all memory.
const LARGEST_RECORD: usize = 256 << 20;

/// Who wrote a message, and how.
pub struct Channel {
    /// Topic.
    pub topic: String,
    /// Type name, as `package/msg/Type` whatever the file has (ROS 1 names have no `msg`).
    pub type_name: String,
    /// `cdr` in ROS 2.
    pub encoding: String,
    /// Schema id, of which `type_name` may come later.
    schema: u16,
}

/// What a file holds.
pub enum Entry<'a> {
    /// A message.
    Message {
        /// Its channel.
        channel: &'a Channel,
        /// Sequence and times.
        header: MessageHeader,
        /// Its bytes.
        data: &'a [u8],
    },
    /// Named values.
    Metadata(Metadata),
    /// Anything else, for those who copy a file.
    Attachment(mcap::Attachment<'a>),
    /// A schema, with id, name, encoding and content.
    Schema(&'a mcap::records::SchemaHeader, &'a [u8]),
    /// A channel.
    Channel(&'a mcap::records::Channel),
    /// The file's profile and library.
    Header(mcap::records::Header),
}

/// How a visit of a file ended.
#[derive(Debug, Default)]
pub struct Visit {
    /// Where it could not be read on; `None` where it is whole.
    pub damage: Option<Damage>,
    /// Whether it ended between two records: nothing that was written is lost, only the summary is missing.
    pub ends_clean: bool,
}

/// Gives all entries of a file to `visit` with the bytes read so far, until it returns `false`.
///
/// # Errors
/// Where the file cannot be opened.
pub fn visit(path: &Path, visit: &mut dyn FnMut(Entry<'_>, u64) -> bool) -> Result<Visit, InputError> {
    let file = File::open(path).map_err(|source| InputError::Io { path: path.to_owned(), source })?;
    // Files without chunks are read record by record.
    let mut file = BufReader::with_capacity(256 * 1024, file);
    let mut reader = LinearReader::new_with_options(
        LinearReaderOptions::default()
            .with_skip_end_magic(true)
            .with_validate_chunk_crcs(true)
            .with_record_length_limit(LARGEST_RECORD),
    );
    let mut table = Table::default();
    let mut offset = 0;
    let damaged = |offset, what: String, ends_clean| {
        Ok(Visit { damage: Some(Damage { file: path.to_owned(), offset, what }), ends_clean })
    };
    while let Some(event) = reader.next_event() {
        match event {
            Ok(LinearReadEvent::ReadRequest(need)) => {
                let buffer = reader.insert(need.min(LARGEST_RECORD));
                let read = match read_up_to(&mut file, buffer) {
                    Ok(read) => read,
                    Err(error) => return damaged(offset, error.to_string(), false),
                };
                offset += read as u64;
                reader.notify_read(read);
            }
            Ok(LinearReadEvent::Record { opcode, data }) => {
                // Opcode 0 is never written: a file of which only the length reached the disk is full of zeros.
                if opcode == 0 {
                    return damaged(offset, "zeros in the place of records".to_owned(), false);
                }
                if opcode == mcap::records::op::DATA_END {
                    return Ok(Visit { damage: None, ends_clean: true });
                }
                match table.entry(opcode, data, &mut |entry| visit(entry, offset)) {
                    Ok(true) => {}
                    Ok(false) => return Ok(Visit { damage: None, ends_clean: true }),
                    Err(error) => return damaged(offset, error.to_string(), false),
                }
            }
            Err(error) => return damaged(offset, error.to_string(), false),
        }
    }
    damaged(offset, "the file ends without its summary".to_owned(), true)
}

/// Schemas and channels so far.
#[derive(Default)]
struct Table {
    schemas: HashMap<u16, String>,
    channels: HashMap<u16, Channel>,
}

impl Table {
    fn entry(
        &mut self,
        opcode: u8,
        data: &[u8],
        visit: &mut dyn FnMut(Entry<'_>) -> bool,
    ) -> mcap::McapResult<bool> {
        Ok(match mcap::parse_record(opcode, data)? {
            Record::Header(header) => visit(Entry::Header(header)),
            Record::Schema { header, data } => {
                self.schemas.insert(header.id, ros2_name(&header.name));
                visit(Entry::Schema(&header, &data))
            }
            Record::Channel(channel) => {
                let known = Channel {
                    topic: channel.topic.clone(),
                    type_name: self.schemas.get(&channel.schema_id).cloned().unwrap_or_default(),
                    encoding: channel.message_encoding.clone(),
                    schema: channel.schema_id,
                };
                let go_on = visit(Entry::Channel(&channel));
                self.channels.insert(channel.id, known);
                go_on
            }
            Record::Message { header, data } => {
                let Some(channel) = self.channels.get_mut(&header.channel_id) else {
                    return Err(mcap::McapError::UnknownChannel(header.sequence, header.channel_id));
                };
                if channel.type_name.is_empty()
                    && let Some(name) = self.schemas.get(&channel.schema)
                {
                    channel.type_name.clone_from(name);
                }
                visit(Entry::Message { channel, header, data: &data })
            }
            Record::Metadata(metadata) => visit(Entry::Metadata(metadata)),
            Record::Attachment { header, data, .. } => visit(Entry::Attachment(mcap::Attachment {
                log_time: header.log_time,
                create_time: header.create_time,
                name: header.name,
                media_type: header.media_type,
                data,
            })),
            _ => true,
        })
    }
}

fn ros2_name(name: &str) -> String {
    match name.split_once('/') {
        Some((package, rest)) if !rest.contains('/') => format!("{package}/msg/{rest}"),
        _ => name.to_owned(),
    }
}

/// Visits several files as one; damage of each goes to the report, the next is read nevertheless.
pub fn visit_all(
    files: &[PathBuf],
    report: &mut InputReport,
    visit_entry: &mut dyn FnMut(Entry<'_>, u64, &mut InputReport),
) -> Result<(), InputError> {
    let mut before = 0;
    for path in files {
        let seen = visit(path, &mut |entry, offset| {
            visit_entry(entry, before + offset, report);
            true
        })?;
        if let Some(damage) = seen.damage
            && !report.damage.contains(&damage)
        {
            report.damage.push(damage);
        }
        before += std::fs::metadata(path).map_or(0, |data| data.len());
    }
    Ok(())
}

/// Opens files as a recording of this program, or else as a bag.
pub fn open(
    files: Vec<PathBuf>,
    options: &InputOptions,
    report: &mut InputReport,
) -> Result<Box<dyn Source>, InputError> {
    let mut looks = Vec::new();
    for path in files {
        looks.push((look(&path, report)?, path));
    }
    // By number where the files have one: the wall clock may have stepped back between two.
    looks.sort_by_key(|(look, _)| (look.number(), look.first_log_time));
    let (looks, files): (Vec<Look>, Vec<PathBuf>) = looks.into_iter().unzip();
    let find = |own| looks.iter().position(|look| look.is_own == own);
    if let (Some(own), Some(other)) = (find(true), find(false)) {
        return Err(InputError::Mixed {
            first: files[own].clone(),
            second: files[other].clone(),
            what: "only one is of this program".to_owned(),
        });
    }
    report.files.clone_from(&files);
    report.bytes = super::total_size(&files);
    if find(true).is_some() {
        let infos = looks.into_iter().map(|look| look.info).collect();
        return Ok(Box::new(Recording::open(files, infos, options, report)?));
    }
    if let Some(index) = looks.iter().position(|look| look.is_ros1) {
        return Err(InputError::Unknown { path: files[index].clone(), hint: super::CONVERT });
    }
    Ok(Box::new(Bag::open(files, options, report)?))
}

/// What the first records of a file tell.
#[derive(Default)]
struct Look {
    is_own: bool,
    info: Option<FileInfo>,
    is_ros1: bool,
    first_log_time: u64,
}

impl Look {
    /// Run, and number of the file in it.
    fn number(&self) -> (i64, u32) {
        self.info.as_ref().map_or((0, 0), |info| (info.session, info.file))
    }
}

fn look(path: &Path, report: &mut InputReport) -> Result<Look, InputError> {
    let mut look = Look::default();
    visit(path, &mut |entry, _| match entry {
        Entry::Metadata(metadata) => {
            if metadata.name == SESSION {
                look.is_own = true;
                look.info = FileInfo::of(&metadata);
                if look.info.is_none() {
                    report.error("visagge.session");
                }
            }
            true
        }
        Entry::Message { channel, header, .. } => {
            look.is_own |= channel.topic == topic::SCIP;
            look.is_ros1 = channel.encoding == "ros1";
            look.first_log_time = header.log_time;
            false
        }
        _ => true,
    })?;
    Ok(look)
}
