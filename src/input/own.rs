//! A recording of this program: the bytes of the port through the decoder of the live run, at the times recorded, and
//! the poses and the tasks that were done in the order in which the mapper took them. So the mapper is called as it was called then.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use super::bag::Survey;
use super::container::{Entry, visit, visit_all};
use super::poses::Poses;
use super::{InputError, InputOptions, InputReport, PoseSource, Sink, Source};
use crate::cdr::{self, Message};
use crate::live::queues::TO_MAPPER;
use crate::mapper::PoseUse;
use crate::pose::{Pose, StampedPose};
use crate::record::{BEGUN_WITH, DEVICE, FileInfo, SESSION, topic};
use crate::scan::Scan;

/// Scans that the mapper of the run may have been behind the driver, the one in its hands included. Once as many are decoded behind a
/// scan, all poses that the mapper took before it have been read: they were recorded when it took them.
const BEHIND: usize = TO_MAPPER.capacity + 1;

/// See the module.
pub struct Recording {
    files: Vec<PathBuf>,
    bytes: u64,
    info: FileInfo,
    mount: Option<Pose>,
    beginning: Beginning,
    /// Poses that were asked for in the place of the recorded ones.
    other_poses: Option<Poses>,
    pose_use: Option<PoseUse>,
}

impl Recording {
    /// Looks for what must be known before the first scan. `infos` are what the files tell of themselves.
    pub(super) fn open(
        files: Vec<PathBuf>,
        infos: Vec<Option<FileInfo>>,
        options: &InputOptions,
        report: &mut InputReport,
    ) -> Result<Self, InputError> {
        report.kind = "recording".to_owned();
        let known = || infos.iter().zip(&files).filter_map(|(info, file)| Some((info.as_ref()?, file)));
        if let Some((first, file)) = known().next()
            && let Some((_, other)) = known().find(|(info, _)| info.session != first.session)
        {
            return Err(InputError::Mixed {
                first: file.clone(),
                second: other.clone(),
                what: "they are of two runs".to_owned(),
            });
        }
        let info = infos.into_iter().flatten().next().unwrap_or_default();
        let beginning = Beginning::of(&files[0])?;
        let mut pose_use = PoseSource::pose_use(options.pose.as_ref());
        let other_poses = match &options.pose {
            None | Some(PoseSource::Recorded) => {
                if !holds_poses(&files)? {
                    report.note(super::MATCHED);
                    pose_use = Some(PoseUse::Odometry);
                }
                None
            }
            // What a localizer told is as good a guide as odometry.
            Some(PoseSource::Match { odometry: true }) => None,
            Some(PoseSource::Match { odometry: false }) => Some(Poses::None),
            // Transforms and odometry carry wall time, the scans the monotonic clock.
            Some(PoseSource::Tf | PoseSource::Odom) => {
                Some(Survey::of(&files, report)?.poses(options)?.poses.shifted(-info.wall_minus_monotonic_ns))
            }
            outside => Poses::from_outside(outside.as_ref())?.map(|poses| on_clock_of(poses, &info)),
        };
        let bytes = report.bytes;
        Ok(Self { files, bytes, info, mount: options.mount, beginning, other_poses, pose_use })
    }
}

/// What a file tells before its first message.
#[derive(Default)]
struct Beginning {
    /// Answer to PP, which a file that does not begin the run has not among its bytes.
    parameters: Option<scip::Parameters>,
    /// The map that the run went on in.
    begun_with: Option<Vec<u8>>,
}

impl Beginning {
    fn of(file: &Path) -> Result<Self, InputError> {
        let mut beginning = Self::default();
        visit(file, &mut |entry, _| {
            match entry {
                Entry::Metadata(metadata) if metadata.name == DEVICE => {
                    let pp = metadata
                        .metadata
                        .iter()
                        .filter_map(|(key, value)| Some((key.strip_prefix("PP.")?, value)));
                    let fields = scip::Fields::new(pp.map(|(key, value)| (key, value.as_str())));
                    beginning.parameters = scip::Parameters::from_fields(&fields).ok();
                }
                Entry::Attachment(attachment) if attachment.name == BEGUN_WITH => {
                    beginning.begun_with = Some(attachment.data.into_owned());
                }
                Entry::Message { .. } => return false,
                _ => {}
            }
            true
        })?;
        Ok(beginning)
    }
}

/// Whether poses came in the run: mostly its first second tells.
fn holds_poses(files: &[PathBuf]) -> Result<bool, InputError> {
    let mut found = false;
    for file in files {
        visit(file, &mut |entry, _| {
            found |= matches!(entry, Entry::Message { channel, data, .. }
                if channel.topic == topic::POSE_RECEIVED && cdr::PoseReceived::decode(data).is_ok());
            !found
        })?;
    }
    Ok(found)
}

/// A file of poses may be on either of the two clocks: stamps behind the year 2000 are on the wall's.
fn on_clock_of(poses: Poses, info: &FileInfo) -> Poses {
    const YEAR_2000_NS: i64 = 946_684_800_000_000_000;
    match &poses {
        Poses::Known(list, _) if list.first().is_some_and(|pose| pose.stamp_ns > YEAR_2000_NS) => {
            poses.shifted(-info.wall_minus_monotonic_ns)
        }
        _ => poses,
    }
}

fn stamped_pose(pose: &cdr::PoseReceived) -> StampedPose {
    let [x, y, cos, sin] = pose.pose;
    let rotation = nalgebra::UnitComplex::new_unchecked(nalgebra::Complex::new(cos, sin));
    StampedPose {
        stamp_ns: pose.stamp_ns,
        received_ns: pose.received_ns,
        pose: Pose::from_parts(nalgebra::Translation2::new(x, y), rotation),
        covariance: pose.has_covariance.then_some(pose.covariance),
        reset: pose.reset,
    }
}

impl Source for Recording {
    fn mount(&self) -> Option<Pose> {
        self.mount
    }

    fn wall_offset_ns(&self) -> i64 {
        self.info.wall_minus_monotonic_ns
    }

    fn recorded_mapper(&self) -> Option<&serde_json::Value> {
        Some(&self.info.info.mapper).filter(|value| !value.is_null())
    }

    fn begun_with(&self) -> Option<&[u8]> {
        self.beginning.begun_with.as_deref()
    }

    fn tells_of_tasks(&self) -> bool {
        // Of poses that are others than those of the run other tasks come.
        self.other_poses.is_none() && self.info.info.closes_loops
    }

    fn pose_use(&self) -> Option<PoseUse> {
        self.pose_use
    }

    fn bytes(&self) -> u64 {
        self.bytes
    }

    fn feed(&mut self, sink: &mut dyn Sink, report: &mut InputReport) -> Result<(), InputError> {
        // The first file has PP among its bytes, and the live monitor knew no more than these.
        let begins_the_run = self.info.scans_before == 0 && self.info.file == 0;
        let parameters = self.beginning.parameters.clone().filter(|_| !begins_the_run);
        let mut port = Port {
            monitor: scip::Monitor::new(monitor_options(self.info.info.stamps_at_rear, parameters.clone())),
            parameters,
            takes_strays: !begins_the_run,
            offsets: [None; 2],
        };
        let mut order = Order {
            scans: VecDeque::with_capacity(BEHIND + 1),
            number: self.info.scans_before,
            recorded: VecDeque::new(),
            other_poses: self.other_poses.as_mut(),
        };
        visit_all(&self.files, report, &mut |entry, offset, report| {
            match entry {
                Entry::Message { channel, data, .. } if channel.topic == topic::SCIP => {
                    match cdr::ScipBytes::borrow(data) {
                        Ok(bytes) => port.take(&bytes, report),
                        Err(_) => report.error("scip message"),
                    }
                    while let Some(scan) = port.next_scan(report) {
                        order.take_scan(scan);
                        if order.scans.len() > BEHIND {
                            order.give_scan(sink, report);
                        }
                    }
                }
                Entry::Message { channel, data, .. } if channel.topic == topic::POSE_RECEIVED => {
                    match cdr::PoseReceived::decode(data) {
                        Ok(pose) => order.take(pose.scans_before, Call::Pose(stamped_pose(&pose))),
                        Err(_) => report.error("pose_received"),
                    }
                }
                Entry::Message { channel, data, .. } if channel.topic == topic::TASK_DONE => {
                    match cdr::TaskDone::decode(data) {
                        Ok(done) => order.take(done.scans_before, Call::TaskDone),
                        Err(_) => report.error("task_done"),
                    }
                }
                // Where a file before is damaged, its scans are missing.
                Entry::Metadata(metadata) if metadata.name == SESSION => {
                    let before = FileInfo::of(&metadata).map_or(0, |info| info.scans_before);
                    order.number = order.number.max(before);
                }
                _ => return,
            }
            sink.on_progress(offset);
        })?;
        order.give_rest(sink, report);
        Ok(())
    }
}

/// What the mapper was told between scans.
enum Call {
    Pose(StampedPose),
    TaskDone,
}

/// Brings scans and all else into the order in which the mapper took them.
struct Order<'a> {
    /// Not given yet, each with its number among the scans that the mapper took.
    scans: VecDeque<(u64, Scan)>,
    /// That of the next.
    number: u64,
    /// What else was not given yet, with the number of scans that the mapper had taken before each.
    recorded: VecDeque<(u64, Call)>,
    other_poses: Option<&'a mut Poses>,
}

impl Order<'_> {
    fn take_scan(&mut self, scan: Scan) {
        self.scans.push_back((self.number, scan));
        self.number += 1;
    }

    fn take(&mut self, scans_before: u64, call: Call) {
        // What has the same count stays in the order in which it was taken and written.
        let place = self.recorded.partition_point(|(before, _)| *before <= scans_before);
        self.recorded.insert(place, (scans_before, call));
    }

    fn give_scan(&mut self, sink: &mut dyn Sink, report: &mut InputReport) -> bool {
        let Some((number, scan)) = self.scans.pop_front() else { return false };
        match &mut self.other_poses {
            Some(poses) => poses.give_for(&scan, sink, report),
            None => self.give_calls_before(number, sink, report),
        }
        report.scans += 1;
        sink.on_scan(scan);
        true
    }

    fn give_calls_before(&mut self, number: u64, sink: &mut dyn Sink, report: &mut InputReport) {
        while self.recorded.front().is_some_and(|(before, _)| *before <= number)
            && let Some((_, call)) = self.recorded.pop_front()
        {
            match call {
                Call::Pose(pose) => {
                    sink.on_pose(pose);
                    report.poses += 1;
                }
                Call::TaskDone => sink.on_task_done(),
            }
        }
    }

    fn give_rest(&mut self, sink: &mut dyn Sink, report: &mut InputReport) {
        while self.give_scan(sink, report) {}
        if self.other_poses.is_none() {
            self.give_calls_before(u64::MAX, sink, report);
        }
    }
}

fn monitor_options(at_rear: bool, parameters: Option<scip::Parameters>) -> scip::MonitorOptions {
    scip::MonitorOptions {
        stamp_reference: if at_rear { scip::StampReference::Rear } else { scip::StampReference::Step0 },
        parameters,
        ..scip::MonitorOptions::default()
    }
}

/// The recorded port, played to a monitor.
struct Port {
    monitor: scip::Monitor,
    parameters: Option<scip::Parameters>,
    /// A later file alone does not show what was asked for.
    takes_strays: bool,
    /// Where the next bytes of each direction should begin.
    offsets: [Option<u64>; 2],
}

impl Port {
    fn take(&mut self, bytes: &cdr::ScipBytes<'_>, report: &mut InputReport) {
        let now_ns = bytes.monotonic_ns as i64;
        if bytes.direction > 1 {
            self.monitor.on_gap();
            return;
        }
        let expected = &mut self.offsets[usize::from(bytes.direction)];
        if expected.is_some_and(|expected| expected != bytes.stream_offset) {
            report.error("bytes not recorded");
            self.monitor.on_gap();
        }
        *expected = Some(bytes.stream_offset + bytes.data.len() as u64);
        match bytes.direction {
            0 => self.monitor.on_received(now_ns, &bytes.data),
            _ => self.monitor.on_sent(now_ns, &bytes.data),
        }
    }

    fn next_scan(&mut self, report: &mut InputReport) -> Option<Scan> {
        super::scip_stream::next_scan(&mut self.monitor, self.parameters.as_ref(), self.takes_strays, report)
    }
}
