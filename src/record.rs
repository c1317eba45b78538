//! Writes what happens in a live run to MCAP files that ROS 2 tools read and from which the run can be replayed
//! bit by bit.
//!
//! Not a thread and not a clock: whoever owns the [`Recorder`] calls it, and every record carries its time. Every
//! channel is CDR with a `ros2msg` schema, since `ros2 bag play` refuses a file with any other; what only a replay
//! needs is of own message types, which players merely pass over.
//!
//! | topic | content |
//! |---|---|
//! | `/visagge/scip` | every read and write of the port, and the gaps between connections |
//! | `/visagge/pose_received` | the poses as the mapper took them, every bit of them; `sequence` is the number of scans that the mapper had taken before |
//! | `/visagge/task_done` | when the mapper took back a search for loops, or a map that was made anew; `sequence` as above |
//! | `/odom` | the same poses for other tools; same `sequence` |
//! | `/scan`, `/visagge/pose`, `/tf`, `/tf_static` | scans, poses used, and the frames that place one on the other |
//! | `/map`, `/visagge/visibility`, `/diagnostics` | results |
//!
//! A file is written as `NAME.mcap.active`, ends a chunk every second or mebibyte, and is renamed when it is complete.
//! It is rotated at a size and age, each file having all that it needs to be read alone. After an I/O error the file
//! is left as it is and a new one tried; what could not be written is counted.

mod date;

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::cdr::{self, Message};
use crate::grid::snapshot::Snapshot;
use crate::map::Map;
use crate::pose::{Pose, StampedPose, quaternion_from_yaw};
use crate::scan::Scan;
use date::utc;

/// Ending of a file that is being written.
pub const ACTIVE: &str = "active";
/// Name of the MCAP metadata record that holds a [`FileInfo`].
pub const SESSION: &str = "visagge.session";
/// Name of the MCAP metadata record with the device's answers to VV, PP and II.
pub const DEVICE: &str = "visagge.device";
/// Name of the attachment with the map that the run went on in, as [`saved`](crate::saved) has it.
pub const BEGUN_WITH: &str = "begun-with.map";
/// Topics whose content a replay needs.
pub mod topic {
    /// Bytes of the port.
    pub const SCIP: &str = "/visagge/scip";
    /// Poses, bit by bit.
    pub const POSE_RECEIVED: &str = "/visagge/pose_received";
    /// When tasks were taken back.
    pub const TASK_DONE: &str = "/visagge/task_done";
    /// Scans.
    pub const SCAN: &str = "/scan";
    /// Poses as received.
    pub const ODOM: &str = "/odom";
    /// Moving frames.
    pub const TF: &str = "/tf";
    /// Fixed frames.
    pub const TF_STATIC: &str = "/tf_static";
}

/// Which way bytes went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From the device.
    Received,
    /// To the device.
    Sent,
    /// No bytes: the connection was opened anew here, or bytes were lost.
    Gap,
}

impl Direction {
    /// Value in [`cdr::ScipBytes`].
    pub fn code(self) -> u8 {
        match self {
            Self::Received => 0,
            Self::Sent => 1,
            Self::Gap => 2,
        }
    }
}

/// A file inside the recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Attachment {
    /// File name.
    pub name: String,
    /// As in HTTP.
    pub media_type: String,
    /// Content.
    pub data: Vec<u8>,
}

/// One thing that happened.
#[derive(Clone, Debug)]
pub enum Record {
    /// One read from or write to the port.
    Bytes {
        /// Which way.
        direction: Direction,
        /// The time that the decoder was given with them (ns).
        monotonic_ns: i64,
        /// Bytes of this direction since the session began, before these.
        stream_offset: u64,
        /// What was read or written.
        data: Vec<u8>,
    },
    /// A scan that was decoded.
    Scan(Arc<Scan>),
    /// A pose when the mapper took it.
    PoseReceived {
        /// The pose.
        pose: StampedPose,
        /// Scans that the mapper had taken before.
        scans_before: u32,
    },
    /// The mapper took back a task that was done; see [`closing`](crate::closing).
    TaskDone {
        /// Scans that the mapper had taken before.
        scans_before: u32,
    },
    /// The pose at which the mapper inserted a scan.
    PoseUsed {
        /// Time of the scan's first beam (ns).
        stamp_ns: i64,
        /// Pose of base_link then.
        pose: Pose,
    },
    /// A map.
    Map(Arc<Snapshot>),
    /// How the parts are; once a second.
    Diagnostics(Vec<cdr::DiagnosticStatus>),
    /// The device has introduced itself.
    Device(Arc<scip::Device>),
    /// A file to keep, once: the final map.
    Attachment(Attachment),
}

/// Names of the frames (REP-105).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Frames {
    /// Frame of the map and of the poses.
    pub fixed: String,
    /// The robot.
    pub base: String,
    /// The scanner.
    pub laser: String,
}

impl Default for Frames {
    fn default() -> Self {
        Self { fixed: "map".into(), base: "base_link".into(), laser: "laser".into() }
    }
}

/// What a replay must know of the run besides its messages.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SessionInfo {
    /// Name and version of the program.
    pub software: String,
    /// Settings of the mapper.
    pub mapper: serde_json::Value,
    /// Whether the device's stamps are taken to refer to the rear of the sensor, not to step 0.
    pub stamps_at_rear: bool,
    /// Whether the mapper closed loops, so that it is told when its tasks were done.
    pub closes_loops: bool,
    /// Where the poses came from, for people.
    pub pose_source: String,
}

/// Content of the metadata record [`SESSION`], as JSON under the key `json`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct FileInfo {
    /// Same in all files of a run: wall clock at its start (ns).
    pub session: i64,
    /// Number of the file in the run, from 0.
    pub file: u32,
    /// Scans of the run before this file.
    pub scans_before: u64,
    /// Wall clock minus monotonic clock (ns) in this file.
    pub wall_minus_monotonic_ns: i64,
    /// Names of the frames.
    pub frames: Frames,
    /// The run.
    #[serde(flatten)]
    pub info: SessionInfo,
}

impl FileInfo {
    /// What the metadata record of a file tells, where it can be read.
    pub fn of(session: &mcap::records::Metadata) -> Option<FileInfo> {
        serde_json::from_str(session.metadata.get("json")?).ok()
    }
}

/// How and what to record.
#[derive(Clone, Debug)]
pub struct RecorderSettings {
    /// Where the files go; it must exist.
    pub folder: PathBuf,
    /// Size at which a new file is begun (bytes). 1 GiB.
    pub rotate_bytes: u64,
    /// Age at which a new file is begun (ns). 30 minutes.
    pub rotate_ns: i64,
    /// Longest time between two flushes (ns): what a power cut may cost. 1 s.
    pub flush_ns: i64,
    /// Most content between two flushes (bytes). 1 MiB.
    pub flush_bytes: usize,
    /// Names of the frames.
    pub frames: Frames,
    /// The scanner in `frames.base`.
    pub mount: Pose,
    /// What a replay must know.
    pub session: SessionInfo,
    /// Files kept in every file of the recording: the configuration.
    pub attachments: Vec<Attachment>,
}

impl RecorderSettings {
    /// Settings for a folder, the rest by default.
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self {
            folder: folder.into(),
            rotate_bytes: 1 << 30,
            rotate_ns: 30 * 60 * SECOND,
            flush_ns: SECOND,
            flush_bytes: 1 << 20,
            frames: Frames::default(),
            mount: Pose::identity(),
            session: SessionInfo::default(),
            attachments: Vec::new(),
        }
    }
}

const SECOND: i64 = 1_000_000_000;

/// What keeps the recorder from writing. It goes on with a new file when it can.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// A file could not be made, written, synced or renamed.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The MCAP writer failed.
    #[error("{path}: {source}")]
    Mcap {
        /// The file.
        path: PathBuf,
        /// Why.
        source: Box<mcap::McapError>,
    },
}

/// What was recorded so far.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RecorderReport {
    /// Files completed, in order.
    pub files: Vec<PathBuf>,
    /// Files left as `.active` after an error.
    pub failed_files: Vec<PathBuf>,
    /// Messages written.
    pub messages: u64,
    /// Records that were not written because no file could be.
    pub lost: u64,
    /// Errors of writing, or of making a file.
    pub errors: u64,
}

/// Index of a channel in [`CHANNELS`].
#[derive(Clone, Copy)]
enum Topic {
    Scip,
    Scan,
    PoseReceived,
    TaskDone,
    Odom,
    Pose,
    Tf,
    TfStatic,
    Map,
    Visibility,
    Diagnostics,
}

/// QoS that a player must offer for a topic whose last message late subscribers get (rosbag2's YAML; durability 1 is
/// transient local, history 1 keep last).
const LATCHED: &str = "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n  deadline:\n    \
     sec: 9223372036\n    nsec: 854775807\n  lifespan:\n    sec: 9223372036\n    nsec: 854775807\n  liveliness: 1\n  \
     liveliness_lease_duration:\n    sec: 9223372036\n    nsec: 854775807\n  avoid_ros_namespace_conventions: false\n";

/// Topic, type, schema and QoS, in the order of [`Topic`].
const CHANNELS: [(&str, &str, &str, &str); 11] = [
    (topic::SCIP, cdr::ScipBytes::TYPE, cdr::ScipBytes::SCHEMA, ""),
    (topic::SCAN, cdr::LaserScan::TYPE, cdr::LaserScan::SCHEMA, ""),
    (topic::POSE_RECEIVED, cdr::PoseReceived::TYPE, cdr::PoseReceived::SCHEMA, ""),
    (topic::TASK_DONE, cdr::TaskDone::TYPE, cdr::TaskDone::SCHEMA, ""),
    (topic::ODOM, cdr::Odometry::TYPE, cdr::Odometry::SCHEMA, ""),
    ("/visagge/pose", cdr::Odometry::TYPE, cdr::Odometry::SCHEMA, ""),
    (topic::TF, cdr::TfMessage::TYPE, cdr::TfMessage::SCHEMA, ""),
    (topic::TF_STATIC, cdr::TfMessage::TYPE, cdr::TfMessage::SCHEMA, LATCHED),
    ("/map", cdr::OccupancyGrid::TYPE, cdr::OccupancyGrid::SCHEMA, LATCHED),
    ("/visagge/visibility", cdr::OccupancyGrid::TYPE, cdr::OccupancyGrid::SCHEMA, LATCHED),
    ("/diagnostics", cdr::DiagnosticArray::TYPE, cdr::DiagnosticArray::SCHEMA, ""),
];

/// A file with its lock; in tests, one that runs full.
struct Output {
    file: File,
    #[cfg(test)]
    left: Option<usize>,
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        #[cfg(test)]
        if let Some(left) = &mut self.left {
            *left = left.checked_sub(bytes.len()).ok_or(std::io::ErrorKind::StorageFull)?;
        }
        self.file.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.flush()
    }
}

impl Seek for Output {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.file.seek(to)
    }
}

/// The file that is being written.
struct OpenFile {
    path: PathBuf,
    writer: Writer,
    /// The same file, to sync and measure it.
    handle: File,
    channels: [u16; CHANNELS.len()],
    started_ns: i64,
    flushed_ns: i64,
    unflushed: usize,
}

impl OpenFile {
    fn mcap_error(&self) -> impl Fn(mcap::McapError) -> RecordError + use<> {
        let path = self.path.clone();
        move |source| RecordError::Mcap { path: path.clone(), source: source.into() }
    }

    fn io_error(&self) -> impl Fn(std::io::Error) -> RecordError + use<> {
        let path = self.path.clone();
        move |source| RecordError::Io { path: path.clone(), source }
    }

    /// Ends the chunk and brings it to the disk.
    fn flush(&mut self, now_ns: i64) -> Result<(), RecordError> {
        self.writer.flush().map_err(self.mcap_error())?;
        self.handle.sync_data().map_err(self.io_error())?;
        self.flushed_ns = now_ns;
        self.unflushed = 0;
        Ok(())
    }

    /// Completes the file and gives it its final name.
    fn finish(mut self) -> Result<PathBuf, RecordError> {
        self.writer.finish().map_err(self.mcap_error())?;
        let io_error = self.io_error();
        self.writer.into_inner().flush().map_err(&io_error)?;
        self.handle.sync_all().map_err(&io_error)?;
        let complete = self.path.with_extension("");
        std::fs::rename(&self.path, &complete).map_err(&io_error)?;
        sync_folder(&complete).map_err(&io_error)?;
        Ok(complete)
    }
}

/// Makes a rename of `file` last.
pub(crate) fn sync_folder(file: &Path) -> std::io::Result<()> {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    File::open(folder)?.sync_all()
}

/// The options of every file that is written here: with seeking disabled a chunk is in the file as a whole or not at
/// all, and a killed process leaves no chunk with a false length.
pub(crate) fn write_options() -> mcap::WriteOptions {
    mcap::WriteOptions::new()
        .profile("ros2")
        .library(concat!("visagged ", env!("CARGO_PKG_VERSION")))
        .chunk_size(None)
        .disable_seeking(true)
        .compression(Some(mcap::Compression::Zstd))
        .compression_threads(0)
}

/// Writes the files of one run.
pub struct Recorder {
    settings: RecorderSettings,
    info: FileInfo,
    report: RecorderReport,
    /// As last told; a file keeps what it was begun with.
    wall_minus_monotonic_ns: i64,
    /// `None` after an error, until `retry_ns`.
    open: Option<OpenFile>,
    retry_ns: i64,
    /// Latest time that any record carried, which stands for now where a record has none.
    now_ns: i64,
    device: Option<Arc<scip::Device>>,
    scans: u64,
    sequences: [u32; CHANNELS.len()],
    bytes: Vec<u8>,
    #[cfg(test)]
    room: Option<usize>,
}

impl Recorder {
    /// Begins a recording in the settings' folder. `wall_ns` (since 1970) and `monotonic_ns` are the two clocks at one
    /// moment.
    ///
    /// # Errors
    /// Where the first file cannot be made.
    pub fn create(settings: RecorderSettings, wall_ns: i64, monotonic_ns: i64) -> Result<Self, RecordError> {
        let info = FileInfo {
            session: wall_ns,
            frames: settings.frames.clone(),
            info: settings.session.clone(),
            ..FileInfo::default()
        };
        let mut recorder = Self {
            settings,
            info,
            report: RecorderReport::default(),
            wall_minus_monotonic_ns: wall_ns - monotonic_ns,
            open: None,
            retry_ns: monotonic_ns,
            now_ns: monotonic_ns,
            device: None,
            scans: 0,
            sequences: [0; CHANNELS.len()],
            bytes: Vec::new(),
            #[cfg(test)]
            room: None,
        };
        recorder.open = Some(recorder.begin_file()?);
        Ok(recorder)
    }

    /// Tells how the two clocks stand now; used from the next file on, so that a step of the wall clock does not
    /// reorder a file.
    pub fn on_clocks(&mut self, wall_ns: i64, monotonic_ns: i64) {
        self.wall_minus_monotonic_ns = wall_ns - monotonic_ns;
    }

    /// Writes one record.
    ///
    /// # Errors
    /// Once for every file that cannot be made or written any more. The recorder stays usable: it tries a new file,
    /// at most once a second, and counts what is lost until then.
    pub fn write(&mut self, record: &Record) -> Result<(), RecordError> {
        self.now_ns = self.now_ns.max(match record {
            Record::Bytes { monotonic_ns, .. } => *monotonic_ns,
            Record::Scan(scan) => scan.received_ns,
            Record::PoseReceived { pose, .. } => pose.received_ns,
            Record::PoseUsed { stamp_ns, .. } => *stamp_ns,
            Record::TaskDone { .. }
            | Record::Map(_)
            | Record::Diagnostics(_)
            | Record::Device(_)
            | Record::Attachment(_) => self.now_ns,
        });
        match record {
            Record::Scan(_) => self.scans += 1,
            // Kept even where no file is open: the next file begins with it.
            Record::Device(device) => self.device = Some(device.clone()),
            _ => {}
        }
        self.on_time(self.now_ns)?;
        if self.open.is_none() {
            self.report.lost += 1;
            return Ok(());
        }
        let written = self.put(record);
        self.keep_or_fail(written)
    }

    /// Flushes, rotates, and tries a new file after an error, where it is time to.
    ///
    /// # Errors
    /// As [`write`](Self::write).
    pub fn on_time(&mut self, now_ns: i64) -> Result<(), RecordError> {
        self.now_ns = self.now_ns.max(now_ns);
        let Some(file) = &mut self.open else {
            return if self.now_ns >= self.retry_ns { self.begin_or_fail() } else { Ok(()) };
        };
        let since_flush = self.now_ns - file.flushed_ns;
        let due = since_flush >= self.settings.flush_ns || file.unflushed >= self.settings.flush_bytes;
        if !due {
            return Ok(());
        }
        let flushed = file.flush(self.now_ns);
        self.keep_or_fail(flushed)?;
        self.rotate_when_due()
    }

    /// Completes the last file and gives the report, which comes beside the error too.
    ///
    /// # Errors
    /// Where the file cannot be completed; it stays as `.active`.
    pub fn close(mut self) -> Result<RecorderReport, (RecorderReport, RecordError)> {
        match self.finish_file() {
            Ok(()) => Ok(self.report),
            Err(error) => Err((self.report, error)),
        }
    }

    /// What was recorded so far.
    pub fn report(&self) -> &RecorderReport {
        &self.report
    }

    fn rotate_when_due(&mut self) -> Result<(), RecordError> {
        let Some(file) = &self.open else { return Ok(()) };
        let old = self.now_ns - file.started_ns >= self.settings.rotate_ns;
        let large = file.handle.metadata().is_ok_and(|data| data.len() >= self.settings.rotate_bytes);
        if !old && !large {
            return Ok(());
        }
        self.finish_file()?;
        self.begin_or_fail()
    }

    fn finish_file(&mut self) -> Result<(), RecordError> {
        let Some(file) = self.open.take() else { return Ok(()) };
        let active = file.path.clone();
        match file.finish() {
            Ok(path) => self.report.files.push(path),
            Err(error) => {
                self.fail(active);
                return Err(error);
            }
        }
        Ok(())
    }

    fn keep_or_fail(&mut self, result: Result<(), RecordError>) -> Result<(), RecordError> {
        if result.is_err()
            && let Some(file) = self.open.take()
        {
            self.report.lost += 1;
            self.fail(file.path);
        }
        result
    }

    fn fail(&mut self, path: PathBuf) {
        self.report.failed_files.push(path);
        self.report.errors += 1;
        self.retry_ns = self.now_ns + SECOND;
    }

    fn begin_or_fail(&mut self) -> Result<(), RecordError> {
        match self.begin_file() {
            Ok(file) => self.open = Some(file),
            Err(error) => {
                self.report.errors += 1;
                self.retry_ns = self.now_ns + SECOND;
                return Err(error);
            }
        }
        Ok(())
    }

    /// Makes the next file, with all that a reader of it alone needs: metadata, attachments, channels, fixed frames.
    fn begin_file(&mut self) -> Result<OpenFile, RecordError> {
        let (path, file) = self.create_file()?;
        self.info.wall_minus_monotonic_ns = self.wall_minus_monotonic_ns;
        let io_error = |source| RecordError::Io { path: path.clone(), source };
        let handle = file.try_clone().map_err(io_error)?;
        let output = Output {
            file,
            #[cfg(test)]
            left: self.room,
        };
        let mcap_error =
            |source: mcap::McapError| RecordError::Mcap { path: path.clone(), source: source.into() };
        let mut writer = write_options().create(BufWriter::new(output)).map_err(mcap_error)?;
        self.info.scans_before = self.scans;
        let log_time = self.log_time(self.now_ns);
        write_session(&mut writer, &self.info).map_err(mcap_error)?;
        for attachment in &self.settings.attachments {
            attach(&mut writer, attachment, log_time).map_err(mcap_error)?;
        }
        if let Some(device) = &self.device {
            write_device(&mut writer, device, log_time).map_err(mcap_error)?;
        }
        let channels = add_channels(&mut writer).map_err(mcap_error)?;
        let mut file = OpenFile {
            path,
            writer,
            handle,
            channels,
            started_ns: self.now_ns,
            flushed_ns: self.now_ns,
            unflushed: 0,
        };
        self.put_mount(&mut file)?;
        file.flush(self.now_ns)?;
        self.info.file += 1;
        Ok(file)
    }

    /// A new file, named by time and number, locked against a recovery while it is written.
    fn create_file(&mut self) -> Result<(PathBuf, File), RecordError> {
        loop {
            let name = format!("visagged_{}_{:04}.mcap", utc(self.info.session), self.info.file);
            let complete = self.settings.folder.join(&name);
            let path = self.settings.folder.join(format!("{name}.{ACTIVE}"));
            let error = |source| RecordError::Io { path: path.clone(), source };
            match OpenOptions::new().write(true).create_new(true).open(&path) {
                Err(exists) if exists.kind() == std::io::ErrorKind::AlreadyExists => self.info.file += 1,
                Err(other) => return Err(error(other)),
                Ok(_) if complete.exists() => {
                    std::fs::remove_file(&path).map_err(error)?;
                    self.info.file += 1;
                }
                Ok(file) => {
                    // A file system without locks must not keep anyone from recording.
                    let _ = rustix::fs::flock(&file, rustix::fs::FlockOperation::NonBlockingLockExclusive);
                    return Ok((path, file));
                }
            }
        }
    }

    fn wall_ns(&self, monotonic_ns: i64) -> i64 {
        monotonic_ns + self.info.wall_minus_monotonic_ns
    }

    fn log_time(&self, monotonic_ns: i64) -> u64 {
        self.wall_ns(monotonic_ns).max(0) as u64
    }

    fn header(&self, stamp_ns: i64, frame: &str) -> cdr::Header {
        cdr::Header { stamp_ns: self.wall_ns(stamp_ns), frame_id: frame.to_owned() }
    }

    fn put(&mut self, record: &Record) -> Result<(), RecordError> {
        match record {
            Record::Bytes { direction, monotonic_ns, stream_offset, data } => {
                let message = cdr::ScipBytes {
                    stamp_ns: self.wall_ns(*monotonic_ns),
                    monotonic_ns: *monotonic_ns as u64,
                    stream_offset: *stream_offset,
                    direction: direction.code(),
                    data: data.as_slice().into(),
                };
                self.message(Topic::Scip, None, *monotonic_ns, &message)
            }
            Record::Scan(scan) => {
                let header = self.header(scan.stamp_ns, &self.settings.frames.laser);
                self.message(Topic::Scan, None, scan.received_ns, &laser_scan(scan, header))
            }
            Record::PoseReceived { pose, scans_before } => self.put_pose_received(pose, *scans_before),
            Record::TaskDone { scans_before } => {
                let message = cdr::TaskDone { scans_before: (*scans_before).into() };
                self.message(Topic::TaskDone, Some(*scans_before), self.now_ns, &message)
            }
            Record::PoseUsed { stamp_ns, pose } => self.put_pose_used(*stamp_ns, pose),
            Record::Map(map) => self.put_map(map.map()),
            Record::Diagnostics(status) => {
                let header = self.header(self.now_ns, "");
                let message = cdr::DiagnosticArray { header, status: status.clone() };
                self.message(Topic::Diagnostics, None, self.now_ns, &message)
            }
            Record::Device(device) => {
                self.with_writer(|writer, log_time| write_device(writer, device, log_time))
            }
            Record::Attachment(attachment) => {
                self.with_writer(|writer, log_time| attach(writer, attachment, log_time))
            }
        }
    }

    fn with_writer(
        &mut self,
        write: impl FnOnce(&mut Writer, u64) -> mcap::McapResult<()>,
    ) -> Result<(), RecordError> {
        let log_time = self.log_time(self.now_ns);
        let Some(file) = &mut self.open else { return Ok(()) };
        write(&mut file.writer, log_time).map_err(file.mcap_error())
    }

    fn put_pose_received(&mut self, pose: &StampedPose, scans_before: u32) -> Result<(), RecordError> {
        let rotation = pose.pose.rotation;
        let exact = cdr::PoseReceived {
            stamp_ns: pose.stamp_ns,
            received_ns: pose.received_ns,
            scans_before: scans_before.into(),
            reset: pose.reset,
            has_covariance: pose.covariance.is_some(),
            pose: [pose.pose.translation.x, pose.pose.translation.y, rotation.re, rotation.im],
            covariance: pose.covariance.unwrap_or_default(),
        };
        self.message(Topic::PoseReceived, Some(scans_before), pose.received_ns, &exact)?;
        let odometry = self.odometry(pose.stamp_ns, &pose.pose, pose.covariance);
        self.message(Topic::Odom, Some(scans_before), pose.received_ns, &odometry)
    }

    fn put_pose_used(&mut self, stamp_ns: i64, pose: &Pose) -> Result<(), RecordError> {
        self.message(Topic::Pose, None, stamp_ns, &self.odometry(stamp_ns, pose, None))?;
        let transform = cdr::TransformStamped {
            header: self.header(stamp_ns, &self.settings.frames.fixed),
            child_frame_id: self.settings.frames.base.clone(),
            transform: transform(pose),
        };
        self.message(Topic::Tf, None, stamp_ns, &cdr::TfMessage { transforms: vec![transform] })
    }

    fn put_mount(&mut self, file: &mut OpenFile) -> Result<(), RecordError> {
        let mount = cdr::TransformStamped {
            header: self.header(self.now_ns, &self.settings.frames.base),
            child_frame_id: self.settings.frames.laser.clone(),
            transform: transform(&self.settings.mount),
        };
        cdr::TfMessage { transforms: vec![mount] }.encode_into(&mut self.bytes);
        self.put_bytes(file, Topic::TfStatic, None, self.now_ns)
    }

    fn put_map(&mut self, map: &Map) -> Result<(), RecordError> {
        for (topic, cells) in [(Topic::Map, &map.occupancy), (Topic::Visibility, &map.visibility)] {
            let message = cdr::OccupancyGrid {
                header: self.header(self.now_ns, &self.settings.frames.fixed),
                map_load_time_ns: self.wall_ns(self.now_ns),
                resolution: map.resolution as f32,
                width: map.width as u32,
                height: map.height as u32,
                origin: cdr::Transform {
                    translation: [map.origin[0], map.origin[1], 0.0],
                    ..cdr::Transform::default()
                },
                data: cells.clone(),
            };
            self.message(topic, None, self.now_ns, &message)?;
        }
        Ok(())
    }

    fn odometry(&self, stamp_ns: i64, pose: &Pose, covariance: Option<[f64; 6]>) -> cdr::Odometry {
        cdr::Odometry {
            header: self.header(stamp_ns, &self.settings.frames.fixed),
            child_frame_id: self.settings.frames.base.clone(),
            pose: transform(pose),
            pose_covariance: planar_covariance(covariance.unwrap_or_default()),
            twist: [0.0; 6],
            twist_covariance: [0.0; 36],
        }
    }

    fn message(
        &mut self,
        topic: Topic,
        sequence: Option<u32>,
        monotonic_ns: i64,
        message: &impl Message,
    ) -> Result<(), RecordError> {
        message.encode_into(&mut self.bytes);
        // Taken out so that the rest of the recorder can be used beside it.
        let Some(mut file) = self.open.take() else { return Ok(()) };
        let written = self.put_bytes(&mut file, topic, sequence, monotonic_ns);
        self.open = Some(file);
        written
    }

    /// Writes the message in `self.bytes`; its sequence is the channel's own count unless given.
    ///
    /// Log times never go back, as players and checkers want it: they are the latest time known, while publish times
    /// (and what is inside the messages) are each message's own.
    fn put_bytes(
        &mut self,
        file: &mut OpenFile,
        topic: Topic,
        sequence: Option<u32>,
        monotonic_ns: i64,
    ) -> Result<(), RecordError> {
        let (log_time, publish_time) = (self.log_time(self.now_ns), self.log_time(monotonic_ns));
        let own = &mut self.sequences[topic as usize];
        let header = mcap::records::MessageHeader {
            channel_id: file.channels[topic as usize],
            sequence: sequence.unwrap_or(*own),
            log_time,
            publish_time,
        };
        *own = own.wrapping_add(1);
        file.unflushed += self.bytes.len();
        self.report.messages += 1;
        file.writer.write_to_known_channel(&header, &self.bytes).map_err(file.mcap_error())
    }
}

type Writer = mcap::Writer<BufWriter<Output>>;

fn add_channels(writer: &mut Writer) -> mcap::McapResult<[u16; CHANNELS.len()]> {
    let mut ids = [0; CHANNELS.len()];
    for (id, (topic, name, schema, qos)) in ids.iter_mut().zip(CHANNELS) {
        let schema = writer.add_schema(name, "ros2msg", schema.as_bytes())?;
        let metadata = BTreeMap::from([("offered_qos_profiles".to_owned(), qos.to_owned())]);
        *id = writer.add_channel(schema, topic, "cdr", &metadata)?;
    }
    Ok(ids)
}

fn attach(writer: &mut Writer, attachment: &Attachment, log_time: u64) -> mcap::McapResult<()> {
    writer.attach(&mcap::Attachment {
        log_time,
        create_time: log_time,
        name: attachment.name.clone(),
        media_type: attachment.media_type.clone(),
        data: attachment.data.as_slice().into(),
    })
}

fn write_session(writer: &mut Writer, info: &FileInfo) -> mcap::McapResult<()> {
    let json = serde_json::to_string(info).map_err(|error| mcap::McapError::Io(error.into()))?;
    let metadata = BTreeMap::from([
        ("software".to_owned(), info.info.software.clone()),
        ("pose_source".to_owned(), info.info.pose_source.clone()),
        ("json".to_owned(), json),
    ]);
    writer.write_metadata(&mcap::records::Metadata { name: SESSION.to_owned(), metadata })
}

/// The answers to VV, PP and II: each as an attachment (`KEY:value` lines) and all in one metadata record (`PP.DMIN`).
fn write_device(writer: &mut Writer, device: &scip::Device, log_time: u64) -> mcap::McapResult<()> {
    let mut metadata = BTreeMap::new();
    for (command, fields) in
        [("VV", &device.version), ("PP", &device.parameter_fields), ("II", &device.state)]
    {
        let Some(fields) = fields else { continue };
        let mut text = String::new();
        for (key, value) in fields.iter() {
            text += &format!("{key}:{value}\n");
            metadata.insert(format!("{command}.{key}"), value.to_owned());
        }
        let media_type = "text/plain".to_owned();
        attach(
            writer,
            &Attachment { name: format!("{command}.txt"), media_type, data: text.into() },
            log_time,
        )?;
    }
    writer.write_metadata(&mcap::records::Metadata { name: DEVICE.to_owned(), metadata })
}

/// The message of a scan. `angle_max` is computed from the rounded numbers beside it, so that readers who count the
/// beams by it get the right count.
pub fn laser_scan(scan: &Scan, header: cdr::Header) -> cdr::LaserScan {
    let geometry = &scan.geometry;
    let (angle_min, angle_increment) = (geometry.angle_min as f32, geometry.angle_increment as f32);
    let last = scan.ranges.len().saturating_sub(1) as f64;
    cdr::LaserScan {
        header,
        angle_min,
        angle_max: (f64::from(angle_min) + last * f64::from(angle_increment)) as f32,
        angle_increment,
        time_increment: geometry.time_increment as f32,
        scan_time: (std::f64::consts::TAU / geometry.angle_increment.abs() * geometry.time_increment) as f32,
        range_min: geometry.range_min as f32,
        range_max: geometry.range_max as f32,
        ranges: scan.ranges.clone(),
        intensities: scan.intensities.clone(),
    }
}

fn transform(pose: &Pose) -> cdr::Transform {
    let [z, w] = quaternion_from_yaw(pose.rotation.angle());
    cdr::Transform { translation: [pose.translation.x, pose.translation.y, 0.0], rotation: [0.0, 0.0, z, w] }
}

/// The 6 x 6 matrix over (x, y, z, roll, pitch, yaw) of xx, xy, xa, yy, ya, aa.
fn planar_covariance([xx, xy, xa, yy, ya, aa]: [f64; 6]) -> [f64; 36] {
    let mut matrix = [0.0; 36];
    for (row, column, value) in [
        (0, 0, xx),
        (0, 1, xy),
        (1, 0, xy),
        (0, 5, xa),
        (5, 0, xa),
        (1, 1, yy),
        (1, 5, ya),
        (5, 1, ya),
        (5, 5, aa),
    ] {
        matrix[6 * row + column] = value;
    }
    matrix
}

#[cfg(test)]
mod tests;
