//! A ROS 2 bag in MCAP from anyone: LaserScan messages placed by transforms or odometry.
//!
//! The poses are read first, in a pass of their own, and given to the mapper just before the scans that need them.
//! Transforms are taken for true, with a warning where they are in an odometry's frame, which may drift (REP-105). A topic of
//! odometry guides the matching, where nobody asks for it as it is.
//!
//! Ranges: `NaN` and what is below range_min tell nothing (drivers put error codes and masks there), `+inf` and what
//! is range_max or more is no return (many drivers and simulators say range_max for it), `-inf` is too near (REP-117).

use std::collections::BTreeMap;
use std::path::PathBuf;

use super::container::{Channel, Entry, visit_all};
use super::frames::{Frames, NoWay, is_map, is_odometry, isometry, name, yaw};
use super::poses::Poses;
use super::{InputError, InputOptions, InputReport, PoseSource, Sink, Source};
use crate::cdr::{self, Message};
use crate::mapper::PoseUse;
use crate::pose::{Pose, StampedPose, pose};
use crate::scan::{Geometry, Scan};

/// See the module.
pub struct Bag {
    files: Vec<PathBuf>,
    bytes: u64,
    scan_topic: String,
    /// Usual time from a scan to the next (ns), 0 where there are too few to tell.
    period_ns: i64,
    placement: Placement,
}

/// Poses with what they mean for the scanner.
pub(super) struct Placement {
    pub poses: Poses,
    /// Where they are from, for people.
    note: String,
    mount: Option<Pose>,
    upside_down: bool,
    /// What the poses are.
    pose_use: PoseUse,
    /// Where they are odometry's, the word with which `--pose` takes them for true.
    drifts: Option<&'static str>,
}

/// What a first pass over the files finds.
#[derive(Default)]
pub(super) struct Survey {
    frames: Frames,
    /// Stamps and frame of the scans of each topic.
    scans: BTreeMap<String, ScanTopic>,
    odometry: BTreeMap<String, OdomTopic>,
}

#[derive(Default)]
struct ScanTopic {
    frame: String,
    stamps_ns: Vec<i64>,
}

#[derive(Default)]
struct OdomTopic {
    /// Frame in which the poses are.
    fixed: String,
    /// Frame whose poses these are.
    base: String,
    poses: Vec<StampedPose>,
}

impl Survey {
    pub(super) fn of(files: &[PathBuf], report: &mut InputReport) -> Result<Self, InputError> {
        let mut survey = Self::default();
        visit_all(files, report, &mut |entry, _, report| {
            if let Entry::Message { channel, data, .. } = entry
                && channel.encoding == "cdr"
                && let Err(error) = survey.take(channel, data)
            {
                log::debug!("{}: {error}", channel.topic);
                // Scans are decoded once more, as a whole, and counted then.
                if channel.type_name != cdr::LaserScan::TYPE {
                    report.error(&channel.type_name);
                }
            }
        })?;
        survey.frames.sort();
        if survey.frames.bad > 0 {
            *report.decode_errors.entry("bad transform".to_owned()).or_default() += survey.frames.bad;
        }
        Ok(survey)
    }

    fn take(&mut self, channel: &Channel, data: &[u8]) -> Result<(), cdr::CdrError> {
        match channel.type_name.as_str() {
            cdr::TfMessage::TYPE => {
                let is_static = channel.topic.ends_with("tf_static");
                for transform in &cdr::TfMessage::decode(data)?.transforms {
                    self.frames.insert(transform, is_static);
                }
            }
            cdr::LaserScan::TYPE => {
                let header = cdr::Header::read(&mut cdr::Decoder::new(data)?)?;
                let topic = self.scans.entry(channel.topic.clone()).or_default();
                topic.stamps_ns.push(header.stamp_ns);
                topic.frame = header.frame_id;
            }
            cdr::Odometry::TYPE => {
                let odometry = cdr::Odometry::decode(data)?;
                let topic = self.odometry.entry(channel.topic.clone()).or_default();
                if let Some(transform) = isometry(&odometry.pose) {
                    let stamp_ns = odometry.header.stamp_ns;
                    topic.poses.push(StampedPose {
                        stamp_ns,
                        received_ns: stamp_ns,
                        pose: pose(
                            transform.translation.x,
                            transform.translation.y,
                            yaw(&transform.rotation),
                        ),
                        covariance: None,
                        reset: 0,
                    });
                } else {
                    self.frames.bad += 1;
                }
                topic.fixed = odometry.header.frame_id;
                topic.base = odometry.child_frame_id;
            }
            _ => {}
        }
        Ok(())
    }

    /// The topic that was asked for, else the usual one, else the only one.
    fn choose<'a, T>(
        topics: &'a BTreeMap<String, T>,
        wanted: Option<&str>,
        usual: &str,
        what: &str,
    ) -> Result<(&'a str, &'a T), InputError> {
        let there_are = || topics.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
        let found = match (wanted, topics.len()) {
            (Some(wanted), _) => topics.get_key_value(wanted),
            (None, 1) => topics.iter().next(),
            (None, _) => topics.get_key_value(usual),
        };
        found.map(|(topic, content)| (topic.as_str(), content)).ok_or_else(|| InputError::Bag {
            what: match (wanted, topics.is_empty()) {
                (_, true) => format!("the bag has no {what}"),
                (Some(wanted), _) => format!("the bag has no {what} {wanted}; it has {}", there_are()),
                (None, _) => format!("the bag has several topics with {what}; choose one of {}", there_are()),
            },
        })
    }

    fn scans(&self, options: &InputOptions) -> Result<(&str, &ScanTopic), InputError> {
        Self::choose(&self.scans, options.scan_topic.as_deref(), "/scan", "scans (sensor_msgs/msg/LaserScan)")
    }

    fn odometry(&self, options: &InputOptions) -> Result<(&str, &OdomTopic), InputError> {
        let wanted = options.odom_topic.as_deref();
        Self::choose(&self.odometry, wanted, "/odom", "odometry (nav_msgs/msg/Odometry)")
    }

    /// What is named is there, whether or not it would be used.
    fn check_names(&self, laser: &str, options: &InputOptions) -> Result<(), InputError> {
        if options.odom_topic.is_some() {
            self.odometry(options)?;
        }
        let mut frames = self.frames.names();
        frames.insert(name(laser));
        frames.extend(self.odometry.values().flat_map(|topic| [name(&topic.fixed), name(&topic.base)]));
        frames.remove("");
        // Poses from outside may be of a frame that only they know.
        let is_outside = matches!(options.pose, Some(PoseSource::File(_) | PoseSource::Fixed(_)));
        let base = options.base_frame.as_deref().filter(|_| !is_outside || options.mount.is_none());
        let missing = [options.fixed_frame.as_deref(), base].into_iter().flatten();
        match missing.map(name).find(|wanted| !frames.contains(wanted)) {
            None => Ok(()),
            Some(wanted) => {
                let there_are = frames.into_iter().collect::<Vec<_>>().join(", ");
                Err(InputError::Bag { what: format!("the bag has no frame {wanted}; it has {there_are}") })
            }
        }
    }

    /// Poses as the options want them, or the best that there are.
    pub(super) fn poses(&self, options: &InputOptions) -> Result<Placement, InputError> {
        let laser = &self.scans(options)?.1.frame;
        self.check_names(laser, options)?;
        match &options.pose {
            Some(PoseSource::Tf) => self.by_tf(laser, options).map_err(no_poses),
            Some(PoseSource::Odom) => self.by_odometry(laser, options),
            outside @ Some(PoseSource::File(_) | PoseSource::Fixed(_)) => {
                let base = options.base_frame.as_deref().unwrap_or("base_link");
                let (mount, upside_down) = self.frames.mount(laser, base).unzip();
                let mount_from = match (options.mount, mount) {
                    (Some(_), _) => "as given",
                    (None, Some(_)) => "by tf",
                    (None, None) => "not told by the bag: by the settings",
                };
                Ok(Placement {
                    note: format!("poses of {base} from outside; mount of {} {mount_from}", name(laser)),
                    poses: Poses::from_outside(outside.as_ref())?.unwrap_or(Poses::Fixed(Pose::identity())),
                    mount: options.mount.or(mount),
                    upside_down: upside_down.unwrap_or(false),
                    pose_use: PoseUse::Map,
                    drifts: None,
                })
            }
            Some(PoseSource::Match { odometry }) => self.by_matching(laser, *odometry, options),
            None | Some(PoseSource::Recorded) => self.by_what_there_is(laser, options),
        }
    }

    /// What the robot's own software holds for true, else matching with what odometry there is.
    fn by_what_there_is(&self, laser: &str, options: &InputOptions) -> Result<Placement, InputError> {
        let is_true = |placement: &Placement| placement.drifts.is_none();
        if options.odom_topic.is_none()
            && let Ok(placement) = self.by_tf(laser, options)
        {
            return Ok(placement);
        }
        if self.prefers_topic(options)
            && let Some(placement) = self.by_odometry(laser, options).ok().filter(is_true)
        {
            return Ok(placement);
        }
        let mut matched = self.by_matching(laser, true, options)?;
        if let Some(word) = matched.drifts {
            matched.note.push_str(&format!(". Odometry drifts; --pose {word} would take it for true"));
        }
        Ok(matched)
    }

    fn by_tf(&self, laser: &str, options: &InputOptions) -> Result<Placement, NoWay> {
        let has_mount = options.mount.is_some() || options.mount_in_settings;
        let (base, fixed) = (options.base_frame.as_deref(), options.fixed_frame.as_deref());
        let way = self.frames.way(laser, base, fixed, has_mount)?;
        let placed = match (options.mount, way.mount) {
            (Some(_), _) => ", placed as given",
            (None, Some(_)) => "",
            (None, None) => ", placed by the settings",
        };
        let note = format!("poses of {} in {} by tf; scanner {}{placed}", way.base, way.fixed, name(laser));
        let drifts = (way.poses.is_some() && is_odometry(&way.fixed)).then_some("tf");
        let poses = way.poses.map_or(Poses::Fixed(way.standing), Poses::known);
        let mount = options.mount.or(way.mount);
        Ok(Placement { poses, note, mount, upside_down: way.upside_down, pose_use: PoseUse::Map, drifts })
    }

    fn by_odometry(&self, laser: &str, options: &InputOptions) -> Result<Placement, InputError> {
        let (topic, odometry) = self.odometry(options)?;
        let base = Some(name(&odometry.base)).filter(|base| !base.is_empty()).unwrap_or("base_link");
        let by_frames = self.frames.mount(laser, base);
        let mount = options.mount.or(by_frames.map(|(mount, _)| mount));
        if mount.is_none() && !options.mount_in_settings {
            return Err(InputError::Bag {
                what: format!(
                    "{topic} gives poses of {base}, and the bag does not tell where {} is on it: give --mount X,Y,YAW, or \
                     leave them alone with --pose match-ranges",
                    name(laser),
                ),
            });
        }
        let upside_down = by_frames.is_some_and(|(_, upside_down)| upside_down);
        let note = format!("poses of {base} by {topic}; scanner {}", name(laser));
        let poses = Poses::known(odometry.poses.clone());
        let drifts = (!is_map(name(&odometry.fixed))).then_some("odom");
        Ok(Placement { poses, note, mount, upside_down, pose_use: PoseUse::Map, drifts })
    }

    /// Whether odometry is the topic's rather than that of transforms: frames that are named are theirs.
    fn prefers_topic(&self, options: &InputOptions) -> bool {
        let fixed = options.fixed_frame.as_deref();
        !self.odometry.is_empty()
            && (options.odom_topic.is_some() || fixed.is_none_or(|fixed| !self.frames.has(fixed)))
    }

    /// Matching, guided by odometry where it is wanted and there: the topic, else the highest frame, which is odometry's
    /// where no localizer ran.
    fn by_matching(
        &self,
        laser: &str,
        with_odometry: bool,
        options: &InputOptions,
    ) -> Result<Placement, InputError> {
        let mut why = String::new();
        let guide = if !with_odometry {
            None
        } else if self.prefers_topic(options) {
            match self.by_odometry(laser, options) {
                // Transforms may know what the topic does not tell: whose poses these are.
                Err(error) if options.odom_topic.is_none() => {
                    Some(self.by_tf(laser, options).map_err(|_| error)?)
                }
                result => Some(result?),
            }
        } else {
            match self.by_tf(laser, options) {
                Err(NoWay::Nowhere(what)) => {
                    if !self.frames.names().is_empty() {
                        why = format!(" ({what})");
                    }
                    None
                }
                result => Some(result.map_err(no_poses)?),
            }
        };
        if let Some(guide) = guide {
            let note = format!("scans are matched; odometry: {}", guide.note);
            return Ok(Placement { note, pose_use: PoseUse::Odometry, ..guide });
        }
        let base = options.base_frame.as_deref().unwrap_or("base_link");
        let (mount, upside_down) = self.frames.mount(laser, base).unzip();
        Ok(Placement {
            poses: Poses::None,
            note: format!("{}{why}", super::MATCHED),
            mount: options.mount.or(mount),
            upside_down: upside_down.unwrap_or(false),
            pose_use: PoseUse::Odometry,
            drifts: None,
        })
    }
}

/// Transforms without a way are no poses; what was named or is missing can be told.
fn no_poses(why: NoWay) -> InputError {
    match why {
        NoWay::Nowhere(what) => InputError::NoPoses { what },
        NoWay::NoFrame(what) | NoWay::NoMount(what) => InputError::Bag { what },
    }
}

impl Bag {
    /// Surveys the files.
    pub(super) fn open(
        files: Vec<PathBuf>,
        options: &InputOptions,
        report: &mut InputReport,
    ) -> Result<Self, InputError> {
        report.kind = "bag".to_owned();
        let survey = Survey::of(&files, report)?;
        let (scan_topic, scans) = survey.scans(options)?;
        let placement = survey.poses(options)?;
        report.note(&placement.note);
        if placement.drifts.is_some() && placement.pose_use == PoseUse::Map && options.pose.is_none() {
            report.doubt("these poses are taken for true; those of wheels drift, and are but a guide with --pose match");
        }
        let bytes = report.bytes;
        Ok(Self {
            files,
            bytes,
            scan_topic: scan_topic.to_owned(),
            period_ns: median_step(&scans.stamps_ns),
            placement,
        })
    }
}

/// Median of the steps between stamps.
fn median_step(stamps_ns: &[i64]) -> i64 {
    let mut steps: Vec<i64> =
        stamps_ns.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0).collect();
    steps.sort_unstable();
    steps.get(steps.len() / 2).copied().unwrap_or(0)
}

impl Source for Bag {
    fn mount(&self) -> Option<Pose> {
        self.placement.mount
    }

    fn recorded_mapper(&self) -> Option<&serde_json::Value> {
        None
    }

    fn pose_use(&self) -> Option<PoseUse> {
        Some(self.placement.pose_use)
    }

    fn bytes(&self) -> u64 {
        self.bytes
    }

    fn feed(&mut self, sink: &mut dyn Sink, report: &mut InputReport) -> Result<(), InputError> {
        let mut last: Option<(u64, i64)> = None;
        let (scan_topic, period_ns, placement) = (&self.scan_topic, self.period_ns, &mut self.placement);
        visit_all(&self.files, report, &mut |entry, offset, report| {
            let Entry::Message { channel, data, .. } = entry else { return };
            if channel.topic != *scan_topic || channel.type_name != cdr::LaserScan::TYPE {
                return;
            }
            let Ok(message) = cdr::LaserScan::decode(data) else {
                report.error("LaserScan");
                return;
            };
            let stamp_ns = message.header.stamp_ns;
            let step = match last {
                None => 0,
                Some((_, before)) if stamp_ns <= before => {
                    report.error("scan not behind the one before");
                    return;
                }
                Some((_, before)) => scans_between(before, stamp_ns, period_ns),
            };
            report.lost_scans += step.saturating_sub(1);
            let seq = last.map_or(0, |(seq, _)| seq) + step;
            last = Some((seq, stamp_ns));
            let Some(scan) = scan(message, seq, placement.upside_down) else {
                report.error("scan without beams or angles");
                return;
            };
            placement.poses.give_for(&scan, sink, report);
            report.scans += 1;
            sink.on_scan(scan);
            sink.on_progress(offset);
        })
    }
}

/// Scans from one stamp to the next, at least 1: more where some are missing in between.
fn scans_between(before_ns: i64, stamp_ns: i64, period_ns: i64) -> u64 {
    if period_ns <= 0 {
        return 1;
    }
    (((stamp_ns - before_ns) as f64 / period_ns as f64).round() as u64).max(1)
}

fn scan(message: cdr::LaserScan, seq: u64, upside_down: bool) -> Option<Scan> {
    let sign = if upside_down { -1.0 } else { 1.0 };
    let geometry = Geometry {
        angle_min: sign * f64::from(message.angle_min),
        angle_increment: sign * f64::from(message.angle_increment),
        time_increment: f64::from(message.time_increment),
        range_min: f64::from(message.range_min),
        range_max: f64::from(message.range_max),
    };
    let is_usable = geometry.angle_min.is_finite()
        && geometry.angle_increment.is_finite()
        && geometry.angle_increment != 0.0
        && (0.0..1.0).contains(&geometry.time_increment)
        && !message.ranges.is_empty();
    let (least, most) = (message.range_min, message.range_max);
    let mut ranges = message.ranges;
    for range in &mut ranges {
        if range.is_finite() && *range < least {
            *range = f32::NAN;
        } else if *range >= most {
            *range = f32::INFINITY;
        }
    }
    let has_intensities = message.intensities.len() == ranges.len();
    let mut scan = Scan {
        seq,
        stamp_ns: message.header.stamp_ns,
        received_ns: 0,
        geometry,
        ranges,
        intensities: if has_intensities { message.intensities } else { Vec::new() },
    };
    scan.received_ns = scan.end_ns();
    is_usable.then_some(scan)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_outside_of_the_limits_are_none() {
        let message = cdr::LaserScan {
            angle_min: -1.0,
            angle_increment: 0.5,
            range_min: 0.1,
            range_max: 10.0,
            ranges: vec![0.0, 0.1, f32::NAN, 10.0, 10.5, f32::NEG_INFINITY, f32::INFINITY, 9.999],
            intensities: vec![1.0],
            ..cdr::LaserScan::default()
        };
        let scan = scan(message.clone(), 0, true).unwrap();
        assert_eq!(format!("{:?}", scan.ranges), "[NaN, 0.1, NaN, inf, inf, -inf, inf, 9.999]");
        assert_eq!((scan.geometry.angle_min, scan.geometry.angle_increment), (1.0, -0.5));
        assert!(scan.intensities.is_empty());
        assert!(super::scan(cdr::LaserScan { angle_increment: 0.0, ..message }, 0, false).is_none());
    }

    #[test]
    fn missing_scans_show_in_the_stamps() {
        assert_eq!(median_step(&[0, 100, 201, 300, 400, 800]), 100);
        assert_eq!(median_step(&[5]), 0);
        assert_eq!(scans_between(0, 101, 100), 1);
        assert_eq!(scans_between(0, 30, 100), 1);
        assert_eq!(scans_between(300, 700, 100), 4);
        assert_eq!(scans_between(300, 700, 0), 1);
    }
}
