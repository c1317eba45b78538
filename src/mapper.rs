//! The mapper: takes scans and poses in the order in which they come, and owns the grid.
//!
//! It has no clock of its own and decides by what it was given alone, so that the same calls in the same order make the same
//! map, bit by bit, on the robot and in a replay. A scan waits until there are poses around it, and is
//! given up when they have not come within a time; it is never inserted at a guessed pose. Where there are no poses in the map,
//! the scans are [located](crate::localize) by what was seen before, with odometry as a guide where it comes.

use crate::{
    closing::{Closing, ClosingReport, Done, Task, moved::Moved},
    grid::{
        Grid,
        saved::BadGrid,
        snapshot::Snapshot,
        sweep::Sweep,
        visagge::{Visagge, VisaggeSettings},
    },
    localize::{Doubt, LocalizeSettings, Localizer, Tracking, Wheels, known::matching_map},
    map::Map,
    pose::{NoPose, Pose, PoseBuffer, StampedPose, pose},
    saved::{Misfit, SavedMap},
    scan::Scan,
};
use hdrhistogram::Histogram;
use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};
use std::{
    collections::{BTreeMap, VecDeque},
    sync::Arc,
};

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

/// What the poses that come are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PoseUse {
    /// Poses in the map, as a localizer has them: scans are inserted there.
    #[default]
    Map,
    /// Odometry, which drifts, or nothing at all: scans are matched with the map.
    Odometry,
}

/// What becomes of scans for which no poses in the map come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Fallback {
    /// They are not inserted.
    #[default]
    Skip,
    /// They are matched with what was mapped before, until poses come again.
    Match,
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
    /// How long a scan waits for a pose later than its last beam (s, 0..10). Default 0.5; live, 0 where no poses can come.
    pub pose_wait: f64,
    /// Poses farther apart than this are not interpolated (s, 0..10). Default 0.25.
    pub pose_gap: f64,
    /// What the poses are that come: map or odometry. Default map; live, `pose.source` decides.
    pub poses: PoseUse,
    /// What is done with scans for which no poses in the map come. Default skip; live, `pose.fallback` decides.
    pub fallback: Fallback,
    /// How scans are located, where poses are odometry or there are none.
    pub localize: LocalizeSettings,
    /// Whether loops are closed while the drive goes on, where scans are matched in a map that began empty.
    /// Default true.
    pub close_loops: bool,
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
            poses: PoseUse::default(),
            fallback: Fallback::default(),
            localize: LocalizeSettings::default(),
            close_loops: true,
            visagge: VisaggeSettings::default(),
        }
    }
}

impl MapperSettings {
    /// Whether a mapper with an empty map closes loops. Who is told where scans were taken believes it.
    pub fn closes_loops(&self) -> bool {
        self.close_loops && self.poses == PoseUse::Odometry
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
    /// It does not fit what was seen before.
    PoorMatch,
    /// It fits what was seen before in several places.
    AmbiguousMatch,
    /// Nobody knows where it was taken.
    Lost,
}

impl From<Doubt> for SkipReason {
    fn from(doubt: Doubt) -> SkipReason {
        match doubt {
            Doubt::Poor => SkipReason::PoorMatch,
            Doubt::Ambiguous => SkipReason::AmbiguousMatch,
            Doubt::Lost => SkipReason::Lost,
        }
    }
}

/// What became of a scan, or of all of them.
#[derive(Clone, Debug, PartialEq)]
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
        /// Covariance xx, xy, xa, yy, ya, aa of `start` (m2, m rad, rad2) against the map near by, where the pose was matched.
        /// How the map itself has drifted since it was begun is not in it.
        covariance: Option<[f64; 6]>,
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
    /// A loop was closed: what was inserted until now lies elsewhere.
    Moved(Arc<Moved>),
}

impl Outcome {
    /// The same with times that are counted from another moment.
    pub fn shifted(self, by_ns: i64) -> Outcome {
        match self {
            Outcome::Inserted { seq, stamp_ns, start, end, covariance } => {
                Outcome::Inserted { seq, stamp_ns: stamp_ns + by_ns, start, end, covariance }
            }
            Outcome::Skipped { seq, stamp_ns, reason } => {
                Outcome::Skipped { seq, stamp_ns: stamp_ns + by_ns, reason }
            }
            Outcome::Moved(moved) => Outcome::Moved(Arc::new(moved.shifted(by_ns))),
        }
    }

    /// Number of the scan that it is about.
    pub fn seq(&self) -> Option<u64> {
        match self {
            Outcome::Inserted { seq, .. } | Outcome::Skipped { seq, .. } => Some(*seq),
            Outcome::Moved(_) => None,
        }
    }
}

/// Why a mapper cannot go on in a saved map.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GoingOnError {
    /// The settings are for another one.
    #[error(transparent)]
    Misfit(#[from] Misfit),
    /// It is none.
    #[error(transparent)]
    Grid(#[from] BadGrid),
}

/// How well the place was known.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LocalizeReport {
    /// State after the last scan.
    pub state: Tracking,
    /// Scans after which the state was this.
    pub scans: BTreeMap<Tracking, u64>,
    /// Times that the place was lost.
    pub lost: u64,
    /// Times that it was found again, or at all in a map that was loaded.
    pub found: u64,
    /// Searches after which several places were as good as each other, so that none was taken.
    pub ambiguous: u64,
    /// Scans that were matched and inserted because no poses in the map came for them.
    pub fallen_back: u64,
    /// Whether the last search was one of these.
    #[serde(skip)]
    pub searched_in_vain: bool,
    /// Covariance of the last pose against the map near by: xx, xy, xa, yy, ya, aa (m2, m rad, rad2). How the map itself has
    /// drifted since it was begun is not in it.
    pub covariance: [f64; 6],
    /// CPU time of locating one scan (us).
    pub match_us: ScanTime,
    /// Memory that the matching maps hold (bytes).
    pub bytes: usize,
}

impl LocalizeReport {
    /// How well the place is known, to be put behind a line that says what is mapped; nothing where all is well.
    pub fn in_words(&self) -> &'static str {
        match self.state {
            Tracking::Starting | Tracking::Tracking => "",
            Tracking::Degraded => ", the scans fit badly",
            Tracking::Lost if self.searched_in_vain => {
                ", place not known: it looks like several places of the map"
            }
            Tracking::Lost => ", place not known: searching the map",
        }
    }
}

/// Times that something took, scan by scan (us).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ScanTime {
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
    /// Scans that were put into the map.
    pub scans_inserted: u64,
    /// Scans that were in it already when it was loaded.
    pub scans_loaded: u64,
    /// Scans that are not, by reason.
    pub scans_skipped: BTreeMap<SkipReason, u64>,
    /// Scans that the numbers of those that came show to be missing.
    pub scans_missing: u64,
    /// Poses that came.
    pub poses_read: u64,
    /// Poses that were no newer than the one before.
    pub poses_out_of_order: u64,
    /// CPU time of one insertion, from ranges to updated map (us).
    pub insert_us: ScanTime,
    /// From the last byte of a scan on the wire to the map that holds it, waiting for poses included (us, wall time); absent in a
    /// replay.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub latency_us: Option<ScanTime>,
    /// Memory that the grid holds (bytes).
    pub map_bytes: usize,
    /// How the scans were located; absent where poses in the map were given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub localization: Option<Box<LocalizeReport>>,
    /// How its loops stand; absent where none are closed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub loops: Option<ClosingReport>,
}

/// Locates scans and keeps the account of it.
#[derive(Debug)]
struct Matching {
    localizer: Localizer,
    /// No odometry came in time for the last scan that waited for it: the next ones do not wait until some comes.
    is_silent: bool,
    scans: BTreeMap<Tracking, u64>,
    lost: u64,
    found: u64,
    fallen_back: u64,
    covariance: [f64; 6],
    time_ns: Histogram<u64>,
}

/// The mapper.
#[derive(Debug)]
pub struct Mapper {
    settings: MapperSettings,
    grid: Grid,
    /// Present where poses are not given in the map.
    matching: Option<Matching>,
    /// Present where loops are closed.
    closing: Option<Closing>,
    poses: PoseBuffer,
    waiting: VecDeque<Scan>,
    outcomes: VecDeque<Outcome>,
    last: Option<(u64, i64)>,
    insert_ns: Histogram<u64>,
    read: u64,
    inserted: u64,
    /// By earlier runs in the same map.
    inserted_before: u64,
    skipped: BTreeMap<SkipReason, u64>,
    missing: u64,
    poses_read: u64,
    poses_out_of_order: u64,
}

impl Mapper {
    /// A mapper with an empty map.
    pub fn new(settings: MapperSettings) -> Mapper {
        let localizer = Localizer::new(settings.localize.clone(), settings.mount.pose());
        Mapper::with(Grid::new(&settings), localizer, settings)
    }

    /// A mapper that goes on in a map that was saved. Poses that are given are taken for poses in it; where scans are
    /// matched, none is inserted until its place has been found.
    ///
    /// # Errors
    /// Where the map [does not fit](SavedMap::fits) the settings, or is none.
    pub fn going_on(saved: &SavedMap, settings: MapperSettings) -> Result<Mapper, GoingOnError> {
        saved.fits(&settings)?;
        let mut grid = Visagge::load(&saved.grid, settings.visagge.clone())?;
        let (localize, mount) = (settings.localize.clone(), settings.mount.pose());
        // A map of nothing holds no place to be found.
        let localizer = if saved.scans > 0 {
            Localizer::in_known(localize, mount, matching_map(&grid.known(), grid.resolution()))
        } else {
            Localizer::new(localize, mount)
        };
        let mapper = Mapper::with(Grid::Visagge(Box::new(grid)), localizer, settings);
        // What was loaded has no scans that could be put elsewhere.
        Ok(Mapper { inserted_before: saved.scans, closing: None, ..mapper })
    }

    fn with(grid: Grid, localizer: Localizer, settings: MapperSettings) -> Mapper {
        Mapper {
            grid,
            matching: (settings.poses == PoseUse::Odometry || settings.fallback == Fallback::Match)
                .then(|| Matching::new(localizer)),
            closing: settings.closes_loops().then(|| Closing::new(&settings)),
            settings,
            poses: PoseBuffer::default(),
            waiting: VecDeque::new(),
            outcomes: VecDeque::new(),
            last: None,
            insert_ns: times(),
            read: 0,
            inserted: 0,
            inserted_before: 0,
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
        self.take_waiting(now_ns);
    }

    /// Takes in a scan of which somebody else has found out where it was taken (base_link at its first and last beam), or why
    /// it is not to be inserted.
    pub fn on_located(&mut self, mut scan: Scan, at: Result<(Pose, Pose), SkipReason>) {
        self.read += 1;
        if let Some((seq, _)) = self.last {
            self.missing += scan.seq.saturating_sub(seq + 1);
        }
        self.last = Some((scan.seq, scan.stamp_ns));
        self.prepare(&mut scan);
        match at {
            Ok((start, end)) => self.insert(&scan, start, end, None),
            Err(reason) => self.skip(&scan, reason),
        }
    }

    /// Takes in a pose of base_link.
    pub fn on_pose(&mut self, pose: StampedPose) {
        self.poses_read += 1;
        if !self.poses.push(pose) {
            self.poses_out_of_order += 1;
        } else if let Some(matching) = &mut self.matching {
            matching.is_silent = false;
        }
        self.take_waiting(pose.received_ns);
    }

    #[cfg(test)]
    pub(crate) fn closing(&mut self) -> Option<&mut Closing> {
        self.closing.as_mut()
    }

    /// Whether it closes loops.
    pub fn closes_loops(&self) -> bool {
        self.closing.is_some()
    }

    /// What is to be done about loops next, where it is time to: to be run wherever there is time, and brought back.
    pub fn next_task(&mut self) -> Option<Task> {
        self.closing.as_mut()?.next_task()
    }

    /// The same at the end of the drive, when no task is away.
    pub fn last_task(&mut self) -> Option<Task> {
        self.closing.as_mut()?.last_task()
    }

    /// Takes a task back that was done.
    pub fn take_back(&mut self, done: Done) {
        let Some(moved) = self.closing.as_mut().and_then(|closing| closing.take_back(done, &mut self.grid))
        else {
            return;
        };
        if let Some(matching) = &mut self.matching {
            matching.localizer.on_moved(|stamp_ns| moved.at(stamp_ns));
        }
        self.outcomes.push_back(Outcome::Moved(Arc::new(moved)));
    }

    /// No more poses will come: what still waits is given up.
    pub fn finish(&mut self) {
        self.take_waiting(i64::MAX);
    }

    /// What became of the scans, one after the other.
    pub fn next_outcome(&mut self) -> Option<Outcome> {
        self.outcomes.pop_front()
    }

    /// The map as it is now, for who may want it whole.
    pub fn snapshot(&mut self) -> Snapshot {
        self.grid.snapshot()
    }

    /// The map as it is now.
    pub fn map(&mut self) -> Map {
        self.snapshot().put_together()
    }

    /// Scans that were put into the map so far.
    pub fn scans_inserted(&self) -> u64 {
        self.inserted
    }

    /// All that the grid knows, for the next run; `None` for the grids that are for comparison.
    pub fn save(&self) -> Option<SavedMap> {
        self.grid.save().map(|grid| SavedMap::new(grid, self.inserted_before + self.inserted))
    }

    /// What was done so far.
    pub fn report(&self) -> MapperReport {
        MapperReport {
            scans_read: self.read,
            scans_inserted: self.inserted,
            scans_loaded: self.inserted_before,
            scans_skipped: self.skipped.clone(),
            scans_missing: self.missing,
            poses_read: self.poses_read,
            poses_out_of_order: self.poses_out_of_order,
            insert_us: ScanTime::of(&self.insert_ns),
            latency_us: None,
            map_bytes: self.grid.bytes(),
            localization: self.matching.as_ref().map(|matching| Box::new(matching.report())),
            loops: self.closing.as_ref().map(Closing::report),
        }
    }

    /// Brings the beams into the sense of the robot and blanks those that show the robot itself.
    pub(crate) fn prepare(&self, scan: &mut Scan) {
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

    /// Decides on the scans that can be decided on at this moment.
    fn take_waiting(&mut self, now_ns: i64) {
        if self.settings.poses == PoseUse::Odometry {
            return self.locate_waiting(now_ns);
        }
        self.insert_waiting();
        self.give_up(now_ns);
    }

    /// Locates the scans in their order, each when its odometry has come or is not waited for any more.
    fn locate_waiting(&mut self, now_ns: i64) {
        let gap_ns = (self.settings.pose_gap * 1e9) as i64;
        while let Some(scan) = self.waiting.front() {
            let Some(matching) = &mut self.matching else { return };
            let start = self.poses.at(scan.stamp_ns, gap_ns);
            let end = self.poses.at(scan.end_ns(), gap_ns);
            let is_late = now_ns.saturating_sub(scan.received_ns) > wait_ns(&self.settings);
            let wheels = match (start, end) {
                (Ok(start), Ok(end)) => {
                    let reset = self.poses.reset_at(scan.end_ns()).unwrap_or_default();
                    Some(Wheels { start, end, reset })
                }
                (Err(NoPose::NotYet), _) | (_, Err(NoPose::NotYet)) if !matching.is_silent => {
                    if !is_late {
                        return;
                    }
                    matching.is_silent = true;
                    None
                }
                _ => None,
            };
            let Some(scan) = self.waiting.pop_front() else { return };
            let before = cpu_ns();
            let located = matching.locate(&scan, wheels);
            matching.time_ns.saturating_record(cpu_ns() - before);
            match located.doubt {
                None => self.insert(&scan, located.start, located.end, Some(located.covariance)),
                Some(doubt) => self.skip(&scan, doubt.into()),
            }
        }
        if let Some((_, stamp_ns)) = self.last {
            self.poses.forget_before(stamp_ns);
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
                    if let Some(matching) = &mut self.matching {
                        matching.follow_given(&scan, &start, &end);
                    }
                    self.insert(&scan, start, end, None);
                    continue;
                }
                (Err(NoPose::TooOld), _) | (_, Err(NoPose::TooOld)) => SkipReason::BeforeFirstPose,
                (Err(NoPose::Jump), _) | (_, Err(NoPose::Jump)) => SkipReason::PoseJump,
                (Err(NoPose::Gap), _) | (_, Err(NoPose::Gap)) => SkipReason::PoseGap,
            };
            let scan = self.waiting.pop_front().expect("it is the front one");
            self.without_pose(&scan, reason);
        }
        if let Some((_, stamp_ns)) = self.last {
            self.poses.forget_before(stamp_ns);
        }
    }

    /// A scan for which there is no pose: matched where that is wanted and something was mapped before, else not inserted.
    fn without_pose(&mut self, scan: &Scan, reason: SkipReason) {
        let Some(matching) = self.matching.as_mut().filter(|matching| matching.localizer.has_begun()) else {
            return self.skip(scan, reason);
        };
        let before = cpu_ns();
        let located = matching.locate(scan, None);
        matching.time_ns.saturating_record(cpu_ns() - before);
        match located.doubt {
            None => {
                matching.fallen_back += 1;
                self.insert(scan, located.start, located.end, Some(located.covariance));
            }
            Some(doubt) => self.skip(scan, doubt.into()),
        }
    }

    /// Gives up the scans that have waited too long at this moment.
    fn give_up(&mut self, now_ns: i64) {
        let wait_ns = wait_ns(&self.settings);
        while self.waiting.front().is_some_and(|scan| now_ns.saturating_sub(scan.received_ns) > wait_ns) {
            let scan = self.waiting.pop_front().expect("it is the front one");
            self.without_pose(&scan, SkipReason::NoPose);
        }
    }

    fn insert(&mut self, scan: &Scan, start: Pose, end: Pose, covariance: Option<[f64; 6]>) {
        let mount = self.settings.mount.pose();
        let sweep = Sweep { scan, start: start * mount, end: end * mount };
        let before = cpu_ns();
        self.grid.insert(&sweep);
        self.insert_ns.saturating_record(cpu_ns() - before);
        self.inserted += 1;
        if let Some(closing) = &mut self.closing {
            closing.keep(scan, [sweep.start, sweep.end]);
        }
        let (seq, stamp_ns) = (scan.seq, scan.stamp_ns);
        self.outcomes.push_back(Outcome::Inserted { seq, stamp_ns, start, end, covariance });
    }

    fn skip(&mut self, scan: &Scan, reason: SkipReason) {
        *self.skipped.entry(reason).or_default() += 1;
        self.outcomes.push_back(Outcome::Skipped { seq: scan.seq, stamp_ns: scan.stamp_ns, reason });
    }
}

impl Matching {
    fn new(localizer: Localizer) -> Matching {
        Matching {
            localizer,
            is_silent: false,
            scans: BTreeMap::new(),
            lost: 0,
            found: 0,
            fallen_back: 0,
            covariance: [0.0; 6],
            time_ns: times(),
        }
    }

    fn locate(&mut self, scan: &Scan, wheels: Option<Wheels>) -> crate::localize::Located {
        let was_lost = self.localizer.tracking() == Tracking::Lost;
        let located = self.localizer.locate(scan, wheels);
        let state = self.localizer.tracking();
        *self.scans.entry(state).or_default() += 1;
        let is_lost = state == Tracking::Lost;
        self.lost += u64::from(is_lost && !was_lost);
        self.found += u64::from(was_lost && !is_lost);
        self.covariance = located.covariance;
        located
    }

    /// Somebody else has located a scan.
    fn follow_given(&mut self, scan: &Scan, start: &Pose, end: &Pose) {
        self.localizer.follow_given(scan, start, end);
        *self.scans.entry(Tracking::Tracking).or_default() += 1;
    }

    fn report(&self) -> LocalizeReport {
        LocalizeReport {
            state: self.localizer.tracking(),
            scans: self.scans.clone(),
            lost: self.lost,
            found: self.found,
            ambiguous: self.localizer.ambiguous(),
            fallen_back: self.fallen_back,
            searched_in_vain: self.localizer.is_ambiguous(),
            covariance: self.covariance,
            match_us: ScanTime::of(&self.time_ns),
            bytes: self.localizer.bytes(),
        }
    }
}

impl ScanTime {
    /// Of times in ns.
    pub fn of(times_ns: &Histogram<u64>) -> ScanTime {
        let us = |ns: u64| ns as f64 / 1e3;
        ScanTime {
            median: us(times_ns.value_at_quantile(0.5)),
            p99: us(times_ns.value_at_quantile(0.99)),
            max: us(times_ns.max()),
            mean: times_ns.mean() / 1e3,
        }
    }
}

/// Room for times up to a minute (ns).
pub fn times() -> Histogram<u64> {
    Histogram::new_with_bounds(1, 60_000_000_000, 3).expect("bounds in order, 3 digits")
}

/// How long a scan waits for poses (ns).
fn wait_ns(settings: &MapperSettings) -> i64 {
    (settings.pose_wait * 1e9) as i64
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
                Outcome::Moved(_) => panic!("there are no loops here"),
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

    /// A wall ahead and one to either side.
    fn in_a_room(seq: u64, ms: i64) -> Scan {
        let mut scan = scan(seq, ms);
        for (beam, range) in scan.ranges.iter_mut().enumerate() {
            let bearing = -1.0 + 0.02 * beam as f32;
            *range = (3.0 / bearing.cos()).min(2.0 / bearing.sin().abs().max(1e-3));
        }
        scan
    }

    #[test]
    fn matched_scans_wait_for_odometry_while_it_comes() {
        let settings = MapperSettings { poses: PoseUse::Odometry, ..MapperSettings::default() };
        let mut mapper = Mapper::new(settings);
        mapper.on_scan(in_a_room(0, 5));
        mapper.on_scan(in_a_room(1, 405));
        assert_eq!(outcomes(&mut mapper), [], "half a second for the first pose");
        mapper.on_scan(in_a_room(2, 605));
        assert_eq!(
            outcomes(&mut mapper),
            [(0, None), (1, None), (2, None)],
            "none came, and none is waited for"
        );
        mapper.on_pose(at(600, 0));
        mapper.on_pose(at(640, 0));
        mapper.on_scan(in_a_room(3, 630));
        assert_eq!(outcomes(&mut mapper), [(3, None)]);
        mapper.on_scan(in_a_room(4, 655));
        assert_eq!(outcomes(&mut mapper), [], "odometry is there: it is waited for");
        mapper.on_pose(at(680, 0));
        assert_eq!(outcomes(&mut mapper), [(4, None)]);
        let report = mapper.report().localization.unwrap();
        assert_eq!((report.state, report.lost), (Tracking::Tracking, 0));
        assert_eq!(report.scans[&Tracking::Tracking], 5);
    }

    #[test]
    fn when_poses_stop_scans_are_matched_where_that_is_wanted() {
        for fallback in [Fallback::Skip, Fallback::Match] {
            let mut mapper = Mapper::new(MapperSettings { fallback, ..MapperSettings::default() });
            // Before any pose there is nothing to match with, and no pose to begin at.
            mapper.on_scan(in_a_room(0, 0));
            let place = pose(4.0, -3.0, 1.0);
            for ms in [600, 650, 700, 750] {
                mapper.on_pose(StampedPose { pose: place, ..at(ms, 0) });
            }
            (1..5).for_each(|seq| mapper.on_scan(in_a_room(seq, 590 + 25 * seq as i64)));
            // No more poses come.
            (5..60).for_each(|seq| mapper.on_scan(in_a_room(seq, 750 + 25 * seq as i64)));
            mapper.finish();
            let mut skipped = 0;
            while let Some(outcome) = mapper.next_outcome() {
                match outcome {
                    Outcome::Inserted { seq, start, covariance, .. } => {
                        assert_eq!(covariance.is_some(), seq >= 5, "{seq}");
                        let off = place.inverse() * start;
                        assert!(off.translation.vector.norm() < 0.01 && off.rotation.angle().abs() < 0.01);
                    }
                    Outcome::Skipped { reason, .. } => {
                        skipped += 1;
                        assert!(matches!(reason, SkipReason::NoPose | SkipReason::BeforeFirstPose));
                    }
                    Outcome::Moved(_) => panic!("there are no loops here"),
                }
            }
            let matched = mapper.report().localization.map_or(0, |report| report.fallen_back);
            let wanted = if fallback == Fallback::Match { (1, 55) } else { (56, 0) };
            assert_eq!((skipped, matched), wanted);
        }
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
