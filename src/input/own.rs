//! A recording of this program: the bytes of the port through the decoder of the live run, at the times recorded, and
//! the poses in the order in which the mapper took them. So the mapper is called as it was called then.

use std::path::PathBuf;

use super::bag::Survey;
use super::container::{Entry, visit_all};
use super::poses::Poses;
use super::{InputError, InputOptions, InputReport, PoseSource, Sink, Source};
use crate::cdr::{self, Message};
use crate::mapper::PoseUse;
use crate::pose::{Pose, StampedPose};
use crate::record::{BEGUN_WITH, DEVICE, FileInfo, SESSION, topic};
use crate::scan::Scan;

/// See the module.
pub struct Recording {
    files: Vec<PathBuf>,
    bytes: u64,
    info: FileInfo,
    mount: Option<Pose>,
    /// The map that the run went on in.
    begun_with: Option<Vec<u8>>,
    /// Answer to PP, which a file that does not begin the run has not among its bytes.
    parameters: Option<scip::Parameters>,
    poses: RecordedPoses,
    /// Poses that were asked for in the place of the recorded ones.
    other_poses: Option<Poses>,
    pose_use: Option<PoseUse>,
}

/// Poses with the number of scans that the mapper had taken before each.
#[derive(Default)]
struct RecordedPoses {
    poses: Vec<(u64, StampedPose)>,
    given: usize,
}

impl RecordedPoses {
    fn give_before_scan(&mut self, number: u64, sink: &mut dyn Sink, report: &mut InputReport) {
        while let Some((_, pose)) = self.poses.get(self.given).filter(|(before, _)| *before <= number) {
            sink.on_pose(*pose);
            report.poses += 1;
            self.given += 1;
        }
    }
}

impl Recording {
    /// Looks through the files for what must be known before the first scan.
    pub(super) fn open(
        files: Vec<PathBuf>,
        options: &InputOptions,
        report: &mut InputReport,
    ) -> Result<Self, InputError> {
        report.kind = "recording".to_owned();
        let mut infos: Vec<FileInfo> = Vec::new();
        let (mut parameters, mut begun_with) = (None, None);
        let mut poses = RecordedPoses::default();
        visit_all(&files, report, &mut |entry, _, report| match entry {
            Entry::Metadata(metadata) if metadata.name == SESSION => {
                let json = metadata.metadata.get("json").map(String::as_str).unwrap_or_default();
                match serde_json::from_str(json) {
                    Ok(info) => infos.push(info),
                    Err(_) => report.error("visagge.session"),
                }
            }
            Entry::Metadata(metadata) if metadata.name == DEVICE => {
                let pp = metadata
                    .metadata
                    .iter()
                    .filter_map(|(key, value)| Some((key.strip_prefix("PP.")?, value)));
                let fields = scip::Fields::new(pp.map(|(key, value)| (key, value.as_str())));
                parameters = parameters.take().or(scip::Parameters::from_fields(&fields).ok());
            }
            Entry::Attachment(attachment) if attachment.name == BEGUN_WITH => {
                begun_with.get_or_insert_with(|| attachment.data.to_vec());
            }
            Entry::Message { channel, data, .. } if channel.topic == topic::POSE_RECEIVED => {
                match cdr::PoseReceived::decode(data) {
                    Ok(pose) => poses.poses.push((pose.scans_before, stamped_pose(&pose))),
                    Err(_) => report.error("pose_received"),
                }
            }
            _ => {}
        })?;
        // The order of poses with the same count is that in which they were taken and written.
        poses.poses.sort_by_key(|(before, _)| *before);
        if let Some(other) = infos.iter().position(|info| info.session != infos[0].session) {
            return Err(InputError::Mixed {
                first: files[0].clone(),
                second: files[other.min(files.len() - 1)].clone(),
                what: "they are of two runs".to_owned(),
            });
        }
        let info = infos.into_iter().next().unwrap_or_default();
        let mut pose_use = PoseSource::pose_use(options.pose.as_ref());
        let other_poses = match &options.pose {
            None | Some(PoseSource::Recorded) => {
                if poses.poses.is_empty() {
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
        let mount = options.mount;
        Ok(Self { files, bytes, info, mount, begun_with, parameters, poses, other_poses, pose_use })
    }

    fn give_poses(&mut self, number: u64, scan: &Scan, sink: &mut dyn Sink, report: &mut InputReport) {
        match &mut self.other_poses {
            Some(poses) => poses.give_for(scan, sink, report),
            None => self.poses.give_before_scan(number, sink, report),
        }
    }
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
        self.begun_with.as_deref()
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
        let parameters = self.parameters.clone().filter(|_| !begins_the_run);
        let mut port = Port {
            monitor: scip::Monitor::new(monitor_options(self.info.info.stamps_at_rear, parameters.clone())),
            parameters,
            takes_strays: !begins_the_run,
            offsets: [None; 2],
        };
        let mut number = self.info.scans_before;
        let files = std::mem::take(&mut self.files);
        visit_all(&files, report, &mut |entry, offset, report| {
            let Entry::Message { channel, data, .. } = entry else { return };
            if channel.topic != topic::SCIP {
                return;
            }
            let Ok(bytes) = cdr::ScipBytes::borrow(data) else {
                report.error("scip message");
                return;
            };
            port.take(&bytes, report);
            while let Some(scan) = port.next_scan(report) {
                self.give_poses(number, &scan, sink, report);
                report.scans += 1;
                number += 1;
                sink.on_scan(scan);
            }
            sink.on_progress(offset);
        })?;
        self.files = files;
        if self.other_poses.is_none() {
            self.poses.give_before_scan(u64::MAX, sink, report);
        }
        Ok(())
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
