//! The mapper: takes scans and poses in the order in which they come, and owns the grid.
//!
//! It has no clock of its own and decides by what it was given alone, so that the same calls in the same order make the same
//! map, bit by bit, on the robot and in a replay. A scan waits until there are poses around it, and is
//! given up when they have not come within a time; it is never inserted at a guessed pose.

use crate::{
    grid::{Grid, sweep::Sweep, visagge::VisaggeSettings},
    map::Map,
    pose::{NoPose, Pose, PoseBuffer, StampedPose, pose},
    scan::Scan,
};
use hdrhistogram::Histogram;
use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};

/// Which grid is kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MapperKind {
    /// VisAGGE: cells know from where they are visible.
    #[default]
    Visagge,
    /// VisAGGE with the single-pass motion removal of the paper, as the paper has it.
    Paper,
    /// The standard occupancy grid, which loses glass.
    Standard,
    /// Hits over visits on keyframes, as slam_toolbox and Karto have it.
    Visits,
    /// The same, with returns too bright to be diffuse marked for good; needs intensities.
    Glints,
}

/// Where the scanner is mounted on the robot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Mount {
    /// Forward of base_link (m). Default 0.
    pub x: f64,
    /// Left of base_link (m). Default 0.
    pub y: f64,
    /// Turned counter-clockwise (rad, -pi..pi). Default 0.
    pub yaw: f64,
    /// Whether the scanner hangs upside down, so that its beams go clockwise. Default false.
    pub upside_down: bool,
}

impl Mount {
    /// Pose of the scanner in base_link.
    pub fn pose(&self) -> Pose {
        pose(self.x, self.y, self.yaw)
    }
}

/// Settings of the mapper.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MapperSettings {
    /// Which grid is kept: visagge, paper, standard, visits or glints. Default visagge.
    pub mapper: MapperKind,
    /// Side of a cell (m, 0.01..0.5). Default 0.05, as in the paper's experiments.
    pub resolution: f64,
    /// Where the scanner is mounted.
    pub mount: Mount,
    /// Beams that show the robot itself: first and last of each group, counted from 0. Default none.
    pub ignore_beams: Vec<[usize; 2]>,
    /// How long a scan waits for a pose later than its last beam (s, 0..10). Default 0.5.
    pub pose_wait: f64,
    /// Poses farther apart than this are not interpolated (s, 0..10). Default 0.25.
    pub pose_gap: f64,
    /// What the VisAGGE grid assumes.
    pub visagge: VisaggeSettings,
}

impl Default for MapperSettings {
    fn default() -> Self {
        MapperSettings {
            mapper: MapperKind::default(),
            resolution: 0.05,
            mount: Mount::default(),
            ignore_beams: Vec::new(),
            pose_wait: 0.5,
            pose_gap: 0.25,
            visagge: VisaggeSettings::default(),
        }
    }
}

/// Why a scan was not inserted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SkipReason {
    /// No pose came in time.
    NoPose,
    /// It is older than the first pose.
    BeforeFirstPose,
    /// The poses around it are too far apart.
    PoseGap,
    /// The source of the poses jumped while it was taken.
    PoseJump,
    /// It has no beams.
    Empty,
    /// It is not newer than the scan before.
    OutOfOrder,
}

/// What became of a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outcome {
    /// It is in the map.
    Inserted {
        /// Its number.
        seq: u64,
        /// Time of its first beam (ns).
        stamp_ns: i64,
        /// base_link at its first beam.
        start: Pose,
        /// base_link at its last beam.
        end: Pose,
    },
    /// It is not.
    Skipped {
        /// Its number.
        seq: u64,
        /// Time of its first beam (ns).
        stamp_ns: i64,
        /// Why not.
        reason: SkipReason,
    },
}

/// CPU time of insertions (us).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct InsertTime {
    /// Half of the scans took less.
    pub median: f64,
    /// 99 of 100 scans took less.
    pub p99: f64,
    /// The slowest.
    pub max: f64,
    /// The mean.
    pub mean: f64,
}

/// What the mapper has done.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MapperReport {
    /// Scans that came.
    pub scans_read: u64,
    /// Scans in the map.
    pub scans_inserted: u64,
    /// Scans that are not, by reason.
    pub scans_skipped: BTreeMap<SkipReason, u64>,
    /// Scans that the numbers of those that came show to be missing.
    pub scans_missing: u64,
    /// Poses that came.
    pub poses_read: u64,
    /// Poses that were no newer than the one before.
    pub poses_out_of_order: u64,
    /// CPU time of one insertion, from ranges to updated map (us).
    pub insert_us: InsertTime,
    /// Memory that the grid holds (bytes).
    pub map_bytes: usize,
}

/// The mapper.
#[derive(Debug)]
pub struct Mapper {
    settings: MapperSettings,
    grid: Grid,
    poses: PoseBuffer,
    waiting: VecDeque<Scan>,
    outcomes: VecDeque<Outcome>,
    last: Option<(u64, i64)>,
    insert_ns: Histogram<u64>,
    read: u64,
    inserted: u64,
    skipped: BTreeMap<SkipReason, u64>,
    missing: u64,
    poses_read: u64,
    poses_out_of_order: u64,
}

impl Mapper {
    /// A mapper with an empty map.
    pub fn new(settings: MapperSettings) -> Mapper {
        Mapper {
            grid: Grid::new(&settings),
            settings,
            poses: PoseBuffer::default(),
            waiting: VecDeque::new(),
            outcomes: VecDeque::new(),
            last: None,
            insert_ns: Histogram::new_with_bounds(1, 60_000_000_000, 3).expect("bounds in order, 3 digits"),
            read: 0,
            inserted: 0,
            skipped: BTreeMap::new(),
            missing: 0,
            poses_read: 0,
            poses_out_of_order: 0,
        }
    }

    /// Takes in a scan; it is inserted now or when its poses have come.
    pub fn on_scan(&mut self, mut scan: Scan) {
        self.read += 1;
        let now_ns = scan.received_ns;
        if let Some((seq, stamp_ns)) = self.last {
            if scan.seq <= seq || scan.stamp_ns <= stamp_ns {
                return self.skip(&scan, SkipReason::OutOfOrder);
            }
            self.missing += scan.seq - seq - 1;
        }
        self.last = Some((scan.seq, scan.stamp_ns));
        if scan.ranges.is_empty() {
            return self.skip(&scan, SkipReason::Empty);
        }
        self.prepare(&mut scan);
        self.waiting.push_back(scan);
        self.insert_waiting();
        self.give_up(now_ns);
    }

    /// Takes in a pose of base_link.
    pub fn on_pose(&mut self, pose: StampedPose) {
        self.poses_read += 1;
        if !self.poses.push(pose) {
            self.poses_out_of_order += 1;
        }
        self.insert_waiting();
        self.give_up(pose.received_ns);
    }

    /// No more poses will come: what still waits is given up.
    pub fn finish(&mut self) {
        self.give_up(i64::MAX);
    }

    /// What became of the scans, one after the other.
    pub fn next_outcome(&mut self) -> Option<Outcome> {
        self.outcomes.pop_front()
    }

    /// The map as it is now.
    pub fn map(&mut self) -> Map {
        self.grid.map()
    }

    /// What was done so far.
    pub fn report(&self) -> MapperReport {
        let us = |ns: u64| ns as f64 / 1e3;
        MapperReport {
            scans_read: self.read,
            scans_inserted: self.inserted,
            scans_skipped: self.skipped.clone(),
            scans_missing: self.missing,
            poses_read: self.poses_read,
            poses_out_of_order: self.poses_out_of_order,
            insert_us: InsertTime {
                median: us(self.insert_ns.value_at_quantile(0.5)),
                p99: us(self.insert_ns.value_at_quantile(0.99)),
                max: us(self.insert_ns.max()),
                mean: self.insert_ns.mean() / 1e3,
            },
            map_bytes: self.grid.bytes(),
        }
    }

    /// Brings the beams into the sense of the robot and blanks those that show the robot itself.
    fn prepare(&self, scan: &mut Scan) {
        if self.settings.mount.upside_down {
            scan.geometry.angle_min = -scan.geometry.angle_min;
            scan.geometry.angle_increment = -scan.geometry.angle_increment;
        }
        for &[first, last] in &self.settings.ignore_beams {
            let end = last.saturating_add(1).min(scan.ranges.len());
            if let Some(beams) = scan.ranges.get_mut(first..end) {
                beams.fill(f32::NAN);
            }
        }
    }

    /// Inserts, in their order, the scans whose poses are known.
    fn insert_waiting(&mut self) {
        let gap_ns = (self.settings.pose_gap * 1e9) as i64;
        while let Some(scan) = self.waiting.front() {
            let start = self.poses.at(scan.stamp_ns, gap_ns);
            let end = self.poses.at(scan.end_ns(), gap_ns);
            let reason = match (start, end) {
                (Err(NoPose::NotYet), _) | (_, Err(NoPose::NotYet)) => return,
                (Ok(start), Ok(end)) => {
                    let scan = self.waiting.pop_front().expect("it is the front one");
                    self.insert(&scan, start, end);
                    continue;
                }
                (Err(NoPose::TooOld), _) | (_, Err(NoPose::TooOld)) => SkipReason::BeforeFirstPose,
                (Err(NoPose::Jump), _) | (_, Err(NoPose::Jump)) => SkipReason::PoseJump,
                (Err(NoPose::Gap), _) | (_, Err(NoPose::Gap)) => SkipReason::PoseGap,
            };
            let scan = self.waiting.pop_front().expect("it is the front one");
            self.skip(&scan, reason);
        }
        if let Some((_, stamp_ns)) = self.last {
            self.poses.forget_before(stamp_ns);
        }
    }

    /// Gives up the scans that have waited too long at this moment.
    fn give_up(&mut self, now_ns: i64) {
        let wait_ns = (self.settings.pose_wait * 1e9) as i64;
        while self.waiting.front().is_some_and(|scan| now_ns.saturating_sub(scan.received_ns) > wait_ns) {
            let scan = self.waiting.pop_front().expect("it is the front one");
            self.skip(&scan, SkipReason::NoPose);
        }
    }

    fn insert(&mut self, scan: &Scan, start: Pose, end: Pose) {
        let mount = self.settings.mount.pose();
        let sweep = Sweep { scan, start: start * mount, end: end * mount };
        let before = cpu_ns();
        self.grid.insert(&sweep);
        self.insert_ns.saturating_record(cpu_ns() - before);
        self.inserted += 1;
        self.outcomes.push_back(Outcome::Inserted { seq: scan.seq, stamp_ns: scan.stamp_ns, start, end });
    }

    fn skip(&mut self, scan: &Scan, reason: SkipReason) {
        *self.skipped.entry(reason).or_default() += 1;
        self.outcomes.push_back(Outcome::Skipped { seq: scan.seq, stamp_ns: scan.stamp_ns, reason });
    }
}

/// CPU time of this thread (ns).
fn cpu_ns() -> u64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::Geometry;

    fn scan(seq: u64, ms: i64) -> Scan {
        Scan {
            seq,
            stamp_ns: ms * 1_000_000,
            received_ns: (ms + 25) * 1_000_000,
            geometry: Geometry {
                angle_min: -1.0,
                angle_increment: 0.02,
                time_increment: 0.0001,
                range_min: 0.023,
                range_max: 60.0,
            },
            ranges: vec![3.0; 101],
            intensities: Vec::new(),
        }
    }

    fn at(ms: i64, reset: u32) -> StampedPose {
        let stamp_ns = ms * 1_000_000;
        StampedPose { stamp_ns, received_ns: stamp_ns, pose: pose(0.0, 0.0, 0.0), covariance: None, reset }
    }

    fn outcomes(mapper: &mut Mapper) -> Vec<(u64, Option<SkipReason>)> {
        std::iter::from_fn(|| mapper.next_outcome())
            .map(|outcome| match outcome {
                Outcome::Inserted { seq, .. } => (seq, None),
                Outcome::Skipped { seq, reason, .. } => (seq, Some(reason)),
            })
            .collect()
    }

    #[test]
    fn scans_wait_for_the_pose_after_them() {
        let mut mapper = Mapper::new(MapperSettings::default());
        mapper.on_pose(at(0, 0));
        mapper.on_scan(scan(0, 5));
        mapper.on_pose(at(10, 0));
        assert_eq!(outcomes(&mut mapper), [], "the scan ends at 15 ms");
        mapper.on_pose(at(20, 0));
        assert_eq!(outcomes(&mut mapper), [(0, None)]);
    }

    #[test]
    fn every_scan_ends_as_one_outcome() {
        let mut mapper = Mapper::new(MapperSettings::default());
        mapper.on_scan(scan(0, 0));
        mapper.on_pose(at(2, 0));
        mapper.on_pose(at(20, 0));
        mapper.on_scan(scan(1, 5));
        mapper.on_pose(at(30, 1));
        mapper.on_scan(scan(2, 19));
        mapper.on_pose(at(1_030, 1));
        mapper.on_scan(scan(4, 500));
        mapper.on_scan(scan(4, 510));
        mapper.on_scan(Scan { ranges: vec![], ..scan(5, 520) });
        mapper.on_scan(scan(6, 1_100));
        mapper.on_scan(scan(7, 1_700));
        mapper.finish();
        assert_eq!(
            outcomes(&mut mapper),
            [
                (0, Some(SkipReason::BeforeFirstPose)),
                (1, None),
                (2, Some(SkipReason::PoseJump)),
                (4, Some(SkipReason::PoseGap)),
                (4, Some(SkipReason::OutOfOrder)),
                (5, Some(SkipReason::Empty)),
                (6, Some(SkipReason::NoPose)),
                (7, Some(SkipReason::NoPose)),
            ]
        );
        let report = mapper.report();
        assert_eq!((report.scans_read, report.scans_inserted, report.scans_missing), (8, 1, 1));
        assert_eq!(report.scans_skipped.values().sum::<u64>(), 7);
    }

    #[test]
    fn masked_beams_and_a_scanner_on_its_head() {
        let settings = MapperSettings {
            ignore_beams: vec![[0, 1], [99, 2_000], [5_000, 6_000]],
            mount: Mount { upside_down: true, ..Mount::default() },
            ..MapperSettings::default()
        };
        let mut scan = scan(0, 0);
        Mapper::new(settings).prepare(&mut scan);
        assert_eq!((scan.geometry.angle_min, scan.geometry.angle_increment), (1.0, -0.02));
        let blank: Vec<_> = (0..101).filter(|&beam| scan.ranges[beam].is_nan()).collect();
        assert_eq!(blank, [0, 1, 99, 100]);
    }
}
