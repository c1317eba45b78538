//! Carmen logs: text, a message a line, also packed with gzip.
//!
//! `FLASER n r1..rn x y th ox oy oth ipc_time host logger_time`: x y th is the scanner's pose (in published logs the
//! corrected one), ox oy oth the robot's by odometry. Beam k points to th - 90 deg + k 180/n deg, or 180/(n - 1) where
//! n is odd. `ROBOTLASER1 type start fov step max accuracy remission n r1..rn m i1..im x y th ox oy oth tv rv forward
//! side turn ipc_time host logger_time` tells its bearings itself. Source: Carmen's logger, and the Radish archive.
//!
//! A reading of a SICK in centimetres is a code from 81.83 m on (LMS 2xx telegrams, 4.1): 8183 and 8191 are beyond the
//! range, the others (dazzled, noise, errors) tell nothing.

use std::io::{BufRead, BufReader};
use std::path::PathBuf;

use super::poses::Poses;
use super::tum::nanoseconds;
use super::{Damage, InputError, InputOptions, InputReport, PoseSource, Sink, Source, open_plain_or_gz};
use crate::mapper;
use crate::pose::{Pose, StampedPose, pose};
use crate::scan::{Geometry, Scan};

/// Lines that only Carmen logs begin with.
const WORDS: [&str; 8] = [
    "FLASER ",
    "ROBOTLASER1 ",
    "RLASER ",
    "RAWLASER1 ",
    "ODOM ",
    "PARAM ",
    "SYNC ",
    "# message formats defined",
];
/// First reading that is a code, and the longest that is a distance (m).
const FIRST_CODE: f64 = 81.83;
/// The codes for "beyond the range" (cm).
const BEYOND: [i64; 2] = [8183, 8191];
/// Most beams that a line is believed to have.
const MOST_BEAMS: usize = 100_000;

/// Whether a file begins like a Carmen log.
pub fn looks_like(start: &[u8]) -> bool {
    let text = String::from_utf8_lossy(start);
    text.lines().take(200).any(|line| WORDS.iter().any(|word| line.starts_with(word)))
}

/// Whose poses are used.
enum PoseUse {
    /// The scanner's, beside each scan.
    Recorded,
    /// The robot's, beside each scan and of ODOM lines.
    Odometry,
    /// Those from outside.
    Outside(Poses),
}

/// See the module.
pub struct Carmen {
    files: Vec<PathBuf>,
    bytes: u64,
    mount: Option<Pose>,
    poses: PoseUse,
    is_matched: bool,
}

/// What a line holds.
enum Line {
    Laser(Box<Laser>),
    Odom(i64, Pose),
    Other,
}

struct Laser {
    scan: Scan,
    laser: Pose,
    robot: Pose,
}

impl Carmen {
    /// Opens the files in the order given.
    pub(super) fn open(
        files: Vec<PathBuf>,
        options: &InputOptions,
        report: &mut InputReport,
    ) -> Result<Self, InputError> {
        report.kind = "carmen".to_owned();
        report.files.clone_from(&files);
        report.bytes = super::total_size(&files);
        let poses = match &options.pose {
            None | Some(PoseSource::Recorded) => PoseUse::Recorded,
            Some(PoseSource::Odom) => PoseUse::Odometry,
            Some(PoseSource::Tf) => {
                return Err(InputError::NoPoses { what: "a Carmen log has no transforms".to_owned() });
            }
            Some(PoseSource::Match { odometry: true }) => PoseUse::Odometry,
            Some(PoseSource::Match { odometry: false }) => PoseUse::Outside(Poses::None),
            outside => match Poses::from_outside(outside.as_ref())? {
                Some(poses) => PoseUse::Outside(poses),
                None => PoseUse::Recorded,
            },
        };
        // Recorded poses are the scanner's own, whatever the robot is.
        let mount = if matches!(poses, PoseUse::Recorded) { Some(Pose::identity()) } else { options.mount };
        let bytes = report.bytes;
        let is_matched = matches!(options.pose, Some(PoseSource::Match { .. }));
        Ok(Self { files, bytes, mount, poses, is_matched })
    }
}

impl Source for Carmen {
    fn mount(&self) -> Option<Pose> {
        self.mount
    }

    fn recorded_mapper(&self) -> Option<&serde_json::Value> {
        None
    }

    fn pose_use(&self) -> Option<mapper::PoseUse> {
        Some(if self.is_matched { mapper::PoseUse::Odometry } else { mapper::PoseUse::Map })
    }

    fn bytes(&self) -> u64 {
        self.bytes
    }

    fn feed(&mut self, sink: &mut dyn Sink, report: &mut InputReport) -> Result<(), InputError> {
        let mut feeder =
            Feeder { poses: &mut self.poses, last_scan_ns: i64::MIN, last_pose_ns: i64::MIN, seq: 0 };
        let mut before = 0;
        let mut line = Vec::new();
        for path in &self.files {
            let (reader, offset) = open_plain_or_gz(path)?;
            let mut reader = BufReader::new(reader);
            for number in 1_u64.. {
                line.clear();
                match reader.read_until(b'\n', &mut line) {
                    Ok(0) => break,
                    Ok(_) => {}
                    Err(error) => {
                        let what = error.to_string();
                        report.damage.push(Damage { file: path.clone(), offset: offset.get(), what });
                        break;
                    }
                }
                match parse(&String::from_utf8_lossy(&line)) {
                    Ok(content) => feeder.give(content, sink, report),
                    Err(what) => {
                        log::debug!("{}:{number}: {what}", path.display());
                        report.error(what);
                    }
                }
                sink.on_progress(before + offset.get());
            }
            before += offset.get();
        }
        Ok(())
    }
}

/// Gives lines to the sink, in order.
struct Feeder<'a> {
    poses: &'a mut PoseUse,
    last_scan_ns: i64,
    last_pose_ns: i64,
    seq: u64,
}

impl Feeder<'_> {
    fn give(&mut self, line: Line, sink: &mut dyn Sink, report: &mut InputReport) {
        match line {
            Line::Other => {}
            Line::Odom(stamp_ns, pose) => {
                if matches!(self.poses, PoseUse::Odometry) {
                    self.give_pose(stamp_ns, pose, sink, report);
                }
            }
            Line::Laser(laser) => {
                let Laser { mut scan, laser, robot } = *laser;
                if scan.stamp_ns <= self.last_scan_ns {
                    report.error("scan not behind the one before");
                    return;
                }
                self.last_scan_ns = scan.stamp_ns;
                scan.seq = self.seq;
                self.seq += 1;
                match self.poses {
                    PoseUse::Recorded => self.give_pose(scan.stamp_ns, laser, sink, report),
                    PoseUse::Odometry => self.give_pose(scan.stamp_ns, robot, sink, report),
                    PoseUse::Outside(poses) => poses.give_for(&scan, sink, report),
                }
                report.scans += 1;
                sink.on_scan(scan);
            }
        }
    }

    /// Lines of a log are not quite in order of time; a pose behind another is left out.
    fn give_pose(&mut self, stamp_ns: i64, pose: Pose, sink: &mut dyn Sink, report: &mut InputReport) {
        if stamp_ns > self.last_pose_ns {
            self.last_pose_ns = stamp_ns;
            report.poses += 1;
            sink.on_pose(StampedPose { stamp_ns, received_ns: stamp_ns, pose, covariance: None, reset: 0 });
        }
    }
}

/// The words of a line, taken one after the other.
struct Words<'a>(std::str::SplitAsciiWhitespace<'a>);

impl Words<'_> {
    fn number(&mut self) -> Result<f64, &'static str> {
        let word = self.0.next().ok_or("line too short")?;
        word.parse().ok().filter(|value: &f64| value.is_finite()).ok_or("no number")
    }

    fn numbers<const N: usize>(&mut self) -> Result<[f64; N], &'static str> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.number()?;
        }
        Ok(values)
    }

    fn pose(&mut self) -> Result<Pose, &'static str> {
        let [x, y, yaw] = self.numbers()?;
        Ok(pose(x, y, yaw))
    }

    fn count(&mut self) -> Result<usize, &'static str> {
        let word = self.0.next().ok_or("line too short")?;
        word.parse().ok().filter(|count| *count <= MOST_BEAMS).ok_or("no count")
    }

    /// `ipc_time host logger_time`. The first is when it was measured, in logs that have it.
    fn stamp_ns(&mut self) -> Result<i64, &'static str> {
        self.0.next().and_then(nanoseconds).ok_or("no time")
    }

    fn ranges(&mut self, count: usize, most: f64) -> Result<Vec<f32>, &'static str> {
        (0..count).map(|_| self.number().map(|value| range(value, most))).collect()
    }
}

/// A reading as REP-117 has it; `most` is the farthest distance.
fn range(value: f64, most: f64) -> f32 {
    if value <= 0.0 {
        f32::NAN
    } else if value < most {
        value as f32
    } else if value < FIRST_CODE || BEYOND.contains(&((value * 100.0).round() as i64)) || value > 82.0 {
        f32::INFINITY
    } else {
        f32::NAN
    }
}

fn parse(line: &str) -> Result<Line, &'static str> {
    let mut words = Words(line.split_ascii_whitespace());
    match words.0.next() {
        Some("FLASER") => flaser(&mut words).map(|laser| Line::Laser(laser.into())),
        Some("ROBOTLASER1") => robot_laser(&mut words).map(|laser| Line::Laser(laser.into())),
        Some("ODOM") => {
            let pose = words.pose()?;
            let _speeds: [f64; 3] = words.numbers()?;
            Ok(Line::Odom(words.stamp_ns()?, pose))
        }
        _ => Ok(Line::Other),
    }
}

fn flaser(words: &mut Words<'_>) -> Result<Laser, &'static str> {
    let count = words.count()?;
    let ranges = words.ranges(count, FIRST_CODE)?;
    let (laser, robot) = (words.pose()?, words.pose()?);
    let stamp_ns = words.stamp_ns()?;
    let steps = if count % 2 == 0 { count } else { count - 1 };
    if steps == 0 {
        return Err("no beams");
    }
    let half_turn = std::f64::consts::PI;
    Ok(Laser {
        scan: scan(stamp_ns, -half_turn / 2.0, half_turn / steps as f64, FIRST_CODE, ranges),
        laser,
        robot,
    })
}

fn robot_laser(words: &mut Words<'_>) -> Result<Laser, &'static str> {
    let [_, start, _, step, most, _, _] = words.numbers()?;
    let count = words.count()?;
    let most = if most > 0.0 { most.min(FIRST_CODE) } else { FIRST_CODE };
    let ranges = words.ranges(count, most)?;
    let remissions = words.count()?;
    let intensities =
        (0..remissions).map(|_| words.number().map(|value| value as f32)).collect::<Result<_, _>>()?;
    let (laser, robot) = (words.pose()?, words.pose()?);
    let _speeds_and_safety: [f64; 5] = words.numbers()?;
    let stamp_ns = words.stamp_ns()?;
    if count == 0 || step == 0.0 {
        return Err("no beams");
    }
    let mut scan = scan(stamp_ns, start, step, most, ranges);
    if remissions == count {
        scan.intensities = intensities;
    }
    Ok(Laser { scan, laser, robot })
}

fn scan(stamp_ns: i64, angle_min: f64, angle_increment: f64, range_max: f64, ranges: Vec<f32>) -> Scan {
    Scan {
        seq: 0,
        stamp_ns,
        received_ns: stamp_ns,
        // Poses of these logs were made for whole scans; there is nothing to spread over time.
        geometry: Geometry { angle_min, angle_increment, time_increment: 0.0, range_min: 0.0, range_max },
        ranges,
        intensities: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn laser(line: &str) -> Laser {
        match parse(line) {
            Ok(Line::Laser(laser)) => *laser,
            Ok(_) => panic!("not a laser: {line}"),
            Err(error) => panic!("{error}: {line}"),
        }
    }

    #[test]
    fn a_flaser_line() {
        let read = laser("FLASER 4 1.5 81.91 81.90 0 1 2 0.5 3 4 0.25 12.25 host 12.5\r\n");
        assert_eq!(read.scan.ranges[..2], [1.5, f32::INFINITY]);
        assert!(read.scan.ranges[2].is_nan() && read.scan.ranges[3].is_nan());
        assert_eq!((read.laser, read.robot), (pose(1.0, 2.0, 0.5), pose(3.0, 4.0, 0.25)));
        assert_eq!(read.scan.stamp_ns, 12_250_000_000);
        let degrees = |scan: &Scan| {
            let geometry = scan.geometry;
            (geometry.angle_min.to_degrees().round(), geometry.angle_increment.to_degrees())
        };
        assert_eq!(degrees(&read.scan), (-90.0, 45.0));
        let odd = laser("FLASER 5 1 1 1 1 1 0 0 0 0 0 0 1 h 1");
        assert_eq!(degrees(&odd.scan), (-90.0, 45.0));
    }

    #[test]
    fn a_robotlaser_line() {
        let read =
            laser("ROBOTLASER1 0 -1.5 3 0.75 40 0.01 1 3 1 40.0 50 3 7 8 9 1 2 3 4 5 6 0 0 0 0 0 7.5 host 8");
        assert_eq!(read.scan.ranges, [1.0, f32::INFINITY, f32::INFINITY]);
        assert_eq!(read.scan.intensities, [7.0, 8.0, 9.0]);
        assert_eq!((read.scan.geometry.angle_min, read.scan.geometry.angle_increment), (-1.5, 0.75));
        assert_eq!((read.laser, read.robot), (pose(1.0, 2.0, 3.0), pose(4.0, 5.0, 6.0)));
        assert_eq!(read.scan.stamp_ns, 7_500_000_000);
    }

    #[test]
    fn bad_lines_say_why() {
        for (line, why) in [
            ("FLASER 3 1 2", "line too short"),
            ("FLASER x 1 2", "no count"),
            ("FLASER 99999999999 1", "no count"),
            ("FLASER 2 1 x 0 0 0 0 0 0 1 h 1", "no number"),
            ("FLASER 0 0 0 0 0 0 0 1 h 1", "no beams"),
            ("ODOM 1 2 3 0 0 0 soon h 1", "no time"),
        ] {
            assert_eq!(parse(line).err(), Some(why), "{line}");
        }
        assert!(matches!(parse("PARAM x y"), Ok(Line::Other)));
    }
}
