//! What a replay can be made from: recordings of this program, ROS 2 bags, bare SCIP streams, Carmen logs.
//!
//! An input is recognised by its content. Each kind gives scans and poses to a [`Sink`] in the order in which a mapper
//! takes them, reading its files from front to back as it goes; hour-long files need no more memory than their poses.
//! Damaged input is used up to the damage, which is reported with its offset.

mod bag;
mod carmen;
pub(crate) mod container;
mod frames;
mod own;
mod poses;
mod scip_stream;
mod tum;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use flate2::read::MultiGzDecoder;
use serde::Serialize;

use crate::mapper::PoseUse;
use crate::pose::{Pose, StampedPose};
use crate::scan::Scan;

pub use poses::{CHOICES, PoseSource, parse_pose};

/// Takes what an input gives.
pub trait Sink {
    /// A pose, before every scan that it is needed for.
    fn on_pose(&mut self, pose: StampedPose);
    /// A scan, in order of time.
    fn on_scan(&mut self, scan: Scan);
    /// The mapper of the run took back a task that was done; see [`closing`](crate::closing).
    fn on_task_done(&mut self) {}
    /// Bytes of all files read so far.
    fn on_progress(&mut self, bytes: u64);
}

/// How to read an input.
#[derive(Clone, Debug, Default)]
pub struct InputOptions {
    /// Where the poses come from; `None`: what the input itself has.
    pub pose: Option<PoseSource>,
    /// Topic of the scans in a bag; `None`: the only one of type LaserScan, or `/scan`.
    pub scan_topic: Option<String>,
    /// Topic of the odometry in a bag; `None`: the only one of type Odometry, or `/odom`.
    pub odom_topic: Option<String>,
    /// Frame in which the map is made; `None`: `map` where the bag has it, else the highest that it has.
    pub fixed_frame: Option<String>,
    /// Frame of the robot; `None`: `base_link`, or `base_footprint`.
    pub base_frame: Option<String>,
    /// The scanner in the robot's frame, where the input does not tell or tells it wrong.
    pub mount: Option<Pose>,
    /// Whether the mapper's settings tell that where nothing else does.
    pub mount_in_settings: bool,
    /// Model that a bare SCIP stream without an answer to PP came from; `None`: UTM-30LX.
    pub model: Option<String>,
}

/// Where and why a file could not be read on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Damage {
    /// The file.
    pub file: PathBuf,
    /// Bytes that had been read of it (compressed, where it is).
    pub offset: u64,
    /// Why.
    pub what: String,
}

/// What was read.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct InputReport {
    /// What it is: `recording`, `bag`, `scip` or `carmen`.
    pub kind: String,
    /// The files, in order.
    pub files: Vec<PathBuf>,
    /// Their size (bytes).
    pub bytes: u64,
    /// Scans given to the mapper.
    pub scans: u64,
    /// Poses given to the mapper.
    pub poses: u64,
    /// Scans that the device's stamps show as lost.
    pub lost_scans: u64,
    /// What could not be decoded, by kind.
    pub decode_errors: BTreeMap<String, u64>,
    /// Bytes of SCIP streams that were skipped.
    pub skipped_bytes: u64,
    /// Where files could not be read on.
    pub damage: Vec<Damage>,
    /// What was assumed or left out, for people.
    pub notes: Vec<String>,
    /// What of that is likely to be wrong.
    pub doubts: Vec<String>,
}

impl InputReport {
    fn error(&mut self, kind: &str) {
        *self.decode_errors.entry(kind.to_owned()).or_default() += 1;
    }

    fn doubt(&mut self, doubt: impl Into<String>) {
        self.doubts.push(doubt.into());
    }

    pub(crate) fn note(&mut self, note: impl Into<String>) {
        self.notes.push(note.into());
    }
}

/// Why an input cannot be replayed at all.
#[derive(Debug, thiserror::Error)]
pub enum InputError {
    /// A file cannot be opened or read from its beginning.
    #[error("cannot read {}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file that is nothing known.
    #[error(
        "{}: neither MCAP, SCIP bytes nor a Carmen log{hint}", path.display()
    )]
    Unknown {
        /// The file.
        path: PathBuf,
        /// What it may be, and what to do.
        hint: &'static str,
    },
    /// Nothing to read.
    #[error("no input file is given")]
    Nothing,
    /// Files of different kinds or recordings.
    #[error("{} and {} do not belong to one recording ({what}): replay each by itself", first.display(), second.display())]
    Mixed {
        /// One.
        first: PathBuf,
        /// The other.
        second: PathBuf,
        /// What differs.
        what: String,
    },
    /// No poses.
    #[error(
        "{what}. Give poses with --pose FILE.tum, or --pose fixed (or fixed:X,Y,YAW) where the scanner stood still"
    )]
    NoPoses {
        /// What was looked for.
        what: String,
    },
    /// Neither a file of poses nor a word.
    #[error(
        "there is no file of poses {}; --pose takes {CHOICES}", path.display()
    )]
    NoPoseFile {
        /// What was taken for a file.
        path: PathBuf,
    },
    /// A file of poses with a bad line.
    #[error("{}:{line}: {what}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// What is wrong.
        what: String,
    },
    /// A bag in which the wanted data is not there or cannot be told.
    #[error("{what}")]
    Bag {
        /// What is missing and which option helps.
        what: String,
    },
}

/// An input that has been looked through and is ready to be read.
pub trait Source {
    /// The scanner in the robot's frame, where input or options tell.
    fn mount(&self) -> Option<Pose>;

    /// What must be added to the stamps of scans and poses to get the time since 1970 (ns): recordings count by the
    /// robot's monotonic clock.
    fn wall_offset_ns(&self) -> i64 {
        0
    }

    /// Settings of the mapper that made the recording.
    fn recorded_mapper(&self) -> Option<&serde_json::Value>;

    /// The map that the recorded run went on in, as bytes of [`saved`](crate::saved).
    fn begun_with(&self) -> Option<&[u8]> {
        None
    }

    /// Whether it tells when the mapper of the run took back tasks.
    fn tells_of_tasks(&self) -> bool {
        false
    }

    /// What the poses are that it gives; `None`: what the settings of its mapper say.
    fn pose_use(&self) -> Option<PoseUse>;

    /// Size of all files (bytes).
    fn bytes(&self) -> u64;

    /// Gives everything to `sink`, in order.
    ///
    /// # Errors
    /// Where a file cannot be opened any more; damage is no error.
    fn feed(&mut self, sink: &mut dyn Sink, report: &mut InputReport) -> Result<(), InputError>;
}

/// What a file is, by its first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// MCAP: a recording or a bag.
    Mcap,
    /// SCIP bytes from a device.
    Scip,
    /// A Carmen log.
    Carmen,
}

/// Looks at all files of one recording and makes them ready to be read, in order of time.
///
/// # Errors
/// Where a file is nothing known, the files do not belong together, or there are no poses.
pub fn open(
    files: &[PathBuf],
    options: &InputOptions,
    report: &mut InputReport,
) -> Result<Box<dyn Source>, InputError> {
    let files = with_folders_expanded(files)?;
    let first = files.first().ok_or(InputError::Nothing)?;
    let kind = detect(first)?;
    for other in &files[1..] {
        if detect(other)? != kind {
            return Err(InputError::Mixed {
                first: first.clone(),
                second: other.clone(),
                what: "they are of different kinds".to_owned(),
            });
        }
    }
    match kind {
        Kind::Mcap => container::open(files, options, report),
        Kind::Scip => Ok(Box::new(scip_stream::ScipStream::open(files, options, report)?)),
        Kind::Carmen => Ok(Box::new(carmen::Carmen::open(files, options, report)?)),
    }
}

/// A folder stands for the MCAP files in it: so ROS 2 keeps its bags.
fn with_folders_expanded(files: &[PathBuf]) -> Result<Vec<PathBuf>, InputError> {
    let mut all = Vec::new();
    for path in files {
        if !path.is_dir() {
            all.push(path.clone());
            continue;
        }
        let error = |source| InputError::Io { path: path.clone(), source };
        let entries =
            std::fs::read_dir(path).map_err(error)?.collect::<Result<Vec<_>, _>>().map_err(error)?;
        let mut found: Vec<_> = entries.iter().map(std::fs::DirEntry::path).collect();
        found.retain(|path| path.extension().is_some_and(|ending| ending == "mcap"));
        if found.is_empty() {
            return Err(InputError::Unknown { path: path.clone(), hint: CONVERT });
        }
        found.sort();
        all.append(&mut found);
    }
    Ok(all)
}

/// Note for people where an input has no poses and none are given.
const MATCHED: &str = "no poses: each scan is matched with those before";

const CONVERT: &str = ". ROS 1 bags and ROS 2 bags in other containers can be converted to MCAP by rosbags-convert \
                       (PyPI rosbags)";

/// What the file is, by its content.
///
/// # Errors
/// Where it cannot be read or is nothing known.
pub fn detect(path: &Path) -> Result<Kind, InputError> {
    let mut start = Vec::new();
    let mut reader = open_plain_or_gz(path)?.0.take(PROBE);
    // What a damaged file gives before the damage is enough to tell.
    if let Err(source) = reader.read_to_end(&mut start)
        && start.is_empty()
    {
        return Err(InputError::Io { path: path.to_owned(), source });
    }
    if start.starts_with(mcap::MAGIC) {
        Ok(Kind::Mcap)
    } else if start.starts_with(b"#ROSBAG") || start.starts_with(b"SQLite format 3") {
        Err(InputError::Unknown { path: path.to_owned(), hint: CONVERT })
    } else if carmen::looks_like(&start) {
        Ok(Kind::Carmen)
    } else if scip_stream::looks_like(&start) {
        Ok(Kind::Scip)
    } else {
        Err(InputError::Unknown { path: path.to_owned(), hint: "" })
    }
}

/// Bytes looked at to tell what a file is: some full scans, or the header of a Carmen log.
const PROBE: u64 = 64 * 1024;

/// Bytes read so far, shared with the reader that counts them.
type Offset = std::rc::Rc<std::cell::Cell<u64>>;

struct Counting<R> {
    inner: R,
    offset: Offset,
}

impl<R: Read> Read for Counting<R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let read = self.inner.read(buffer)?;
        self.offset.set(self.offset.get() + read as u64);
        Ok(read)
    }
}

/// The file's content, unpacked where it is gzip, and how far the file itself has been read.
fn open_plain_or_gz(path: &Path) -> Result<(Box<dyn Read>, Offset), InputError> {
    let error = |source| InputError::Io { path: path.to_owned(), source };
    let mut file = File::open(path).map_err(error)?;
    let mut magic = [0; 2];
    let is_gz = read_up_to(&mut file, &mut magic).map_err(error)? == 2 && magic == [0x1f, 0x8b];
    std::io::Seek::rewind(&mut file).map_err(error)?;
    let offset = Offset::default();
    let reader = BufReader::with_capacity(256 * 1024, Counting { inner: file, offset: offset.clone() });
    Ok((if is_gz { Box::new(MultiGzDecoder::new(reader)) } else { Box::new(reader) }, offset))
}

/// Fills `buffer` as far as there is content.
fn read_up_to(reader: &mut impl Read, buffer: &mut [u8]) -> std::io::Result<usize> {
    let mut filled = 0;
    while filled < buffer.len() {
        match reader.read(&mut buffer[filled..]) {
            Ok(0) => break,
            Ok(read) => filled += read,
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(filled)
}

/// Size of all files (bytes).
fn total_size(files: &[PathBuf]) -> u64 {
    files.iter().filter_map(|path| std::fs::metadata(path).ok()).map(|data| data.len()).sum()
}
