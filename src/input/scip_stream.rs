//! A bare stream of bytes as it came from a device: no times of arrival, so the device's own clock is the time.

use std::io::Read;
use std::path::PathBuf;

use super::poses::Poses;
use super::{Damage, InputError, InputOptions, InputReport, PoseSource, Sink, Source, open_plain_or_gz};
use crate::mapper::PoseUse;
use crate::pose::Pose;
use crate::scan::Scan;

/// Model that is assumed where a stream has no answer to PP.
const ASSUMED: &str = "UTM-30LX";

/// Whether the start of a file holds a SCIP reply with good sums.
pub fn looks_like(start: &[u8]) -> bool {
    let mut decoder = scip::Decoder::new();
    decoder.push(start);
    std::iter::from_fn(|| decoder.decode_next()).any(|reply| reply.is_ok())
}

/// Next scan of a monitor in SI units; everything else that it reports is counted.
pub fn next_scan(
    monitor: &mut scip::Monitor,
    parameters: Option<&scip::Parameters>,
    takes_strays: bool,
    report: &mut InputReport,
) -> Option<Scan> {
    while let Some(event) = monitor.next_event() {
        match event {
            scip::Event::StrayScan(_) if !takes_strays => report.error("scan that nobody asked for"),
            scip::Event::Scan(scan) | scip::Event::StrayScan(scan) => {
                match monitor.device().parameters.as_ref().or(parameters) {
                    Some(parameters) => return Some(Scan::from_scip(&scan, parameters)),
                    None => report.error("scan before PP"),
                }
            }
            scip::Event::Skipped(error) => {
                report.error(error.kind.name());
                report.skipped_bytes += error.len;
            }
            scip::Event::Lost { scans, .. } => report.lost_scans += scans,
            scip::Event::StuckStamp { .. } => report.error("stuck stamp"),
            scip::Event::BadParameters(_) => report.error("bad PP"),
            _ => {}
        }
    }
    None
}

/// See the module.
pub struct ScipStream {
    files: Vec<PathBuf>,
    bytes: u64,
    mount: Option<Pose>,
    assumed: scip::Parameters,
    poses: Poses,
    pose_use: PoseUse,
}

impl ScipStream {
    /// Opens the files in the order given: their bytes tell no time of day.
    pub(super) fn open(
        files: Vec<PathBuf>,
        options: &InputOptions,
        report: &mut InputReport,
    ) -> Result<Self, InputError> {
        report.kind = "scip".to_owned();
        report.files.clone_from(&files);
        report.bytes = super::total_size(&files);
        let model = options.model.as_deref().unwrap_or(ASSUMED);
        let assumed =
            scip::model::find(model).and_then(scip::Parameters::of_model).ok_or_else(|| InputError::Bag {
                what: format!(
                    "nothing is known of a scanner {model:?}; known are UTM-30LX, URG-04LX, UST-10LX .."
                ),
            })?;
        let (poses, pose_use) = match (Poses::from_outside(options.pose.as_ref())?, &options.pose) {
            (Some(poses), _) => (poses, PoseUse::Map),
            (None, None | Some(PoseSource::Match { .. })) => {
                report.note(super::MATCHED);
                (Poses::None, PoseUse::Odometry)
            }
            (None, Some(_)) => {
                return Err(InputError::NoPoses { what: "a bare SCIP stream has no poses".to_owned() });
            }
        };
        let bytes = report.bytes;
        Ok(Self { files, bytes, mount: options.mount, assumed, poses, pose_use })
    }
}

impl Source for ScipStream {
    fn mount(&self) -> Option<Pose> {
        self.mount
    }

    fn recorded_mapper(&self) -> Option<&serde_json::Value> {
        None
    }

    fn pose_use(&self) -> Option<PoseUse> {
        Some(self.pose_use)
    }

    fn bytes(&self) -> u64 {
        self.bytes
    }

    fn feed(&mut self, sink: &mut dyn Sink, report: &mut InputReport) -> Result<(), InputError> {
        let mut monitor = scip::Monitor::new(scip::MonitorOptions {
            clock: scip::ClockSource::Device,
            parameters: Some(self.assumed.clone()),
            ..scip::MonitorOptions::default()
        });
        let mut chunk = vec![0; 64 * 1024];
        let mut before = 0;
        for path in &self.files {
            let (mut reader, offset) = open_plain_or_gz(path)?;
            loop {
                let read = match reader.read(&mut chunk) {
                    Ok(0) => break,
                    Ok(read) => read,
                    Err(error) if error.kind() == std::io::ErrorKind::Interrupted => continue,
                    Err(error) => {
                        let what = error.to_string();
                        report.damage.push(Damage { file: path.clone(), offset: offset.get(), what });
                        break;
                    }
                };
                // Nobody knows when these came; the device's clock is used instead.
                monitor.on_received(0, &chunk[..read]);
                while let Some(mut scan) = next_scan(&mut monitor, Some(&self.assumed), true, report) {
                    scan.received_ns = scan.end_ns();
                    self.poses.give_for(&scan, sink, report);
                    report.scans += 1;
                    sink.on_scan(scan);
                }
                sink.on_progress(before + offset.get());
            }
            before += offset.get();
        }
        if monitor.device().parameter_fields.is_none() {
            report.note(format!("no answer to PP in the stream: taken for a {}", self.assumed.model));
        }
        Ok(())
    }
}
