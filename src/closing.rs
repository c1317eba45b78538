//! Closes loops while the drive goes on: keeps the scans that were placed, has it sought where the drive came back to, and
//! has the map made anew where all then belongs.
//!
//! Not a thread and not a clock. What takes long is given away as a [`Task`], to be run wherever there is time, and comes back
//! as [`Done`]; meanwhile the drive goes on. When a task begins is decided by the way alone. So the same scans and the same
//! tasks taken back before the same scans make the same map, bit by bit.
//!
//! The drive is kept as it was located: each search bends it as a whole, from what was seen, and not from what an earlier search
//! made of it.

pub mod moved;
pub mod placed;

use crate::{
    grid::Grid,
    localize::{
        loops::{Correction, Drive, Loops, Odometer},
        matcher::difference,
    },
    mapper::MapperSettings,
    pose::{Pose, interpolate},
    scan::Scan,
};
use moved::Moved;
use placed::Placed;
use serde::Serialize;
use std::fmt;

/// A drive is searched for loops when it is this long (m): none is shorter.
const FIRST_SEARCH: f64 = 20.0;
/// ... and again after so much way (m), and this part of the way so far: all searches of eight laps of 190 m took 4 % of the time of
/// the drive, those of four laps 2 %.
const NEXT_SEARCH: [f64; 2] = [10.0, 0.1];
/// The first and the last scans of a stand that are kept, two seconds each: what stood there when the robot came may be gone when
/// it leaves. Of 2,200 occupied cells of a busy lobby in which it stood for 15 and 20 s, the map that was made anew had 19 no more
/// (47 with a second each): what was to be seen only when the people moved.
const STAND: usize = 80;
/// Who has moved by less stands (m, rad): a robot at 10 cm/s keeps all of its scans.
const STILL: [f64; 2] = [0.03, 0.02];
/// No more is kept (bytes): 50,000 to 60,000 scans with what the searches made of them, 20 to 25 minutes of driving. A robot has this much
/// memory to spare, and what a search takes grows faster than the way.
const MOST: usize = 320 << 20;

/// See the module.
#[derive(Debug)]
pub struct Closing {
    state: State,
    /// Scans that no task has been given yet.
    fresh: Vec<Placed>,
    odometer: Odometer,
    stand: Stand,
    /// Way driven so far, and when the last search began (m).
    way: f64,
    sought: f64,
    /// What is to be put before a pose, as it was located, to show it now.
    shift: Pose,
    /// Memory of the scans, and of what the searches made of them (bytes).
    scan_bytes: usize,
    drive_bytes: usize,
    scans: u64,
    searches: u64,
    closed: u64,
    last: Option<LastClosing>,
}

/// Where the history is, and what is to be done with it.
#[derive(Debug)]
enum State {
    /// Nothing is to be done.
    Idle(Box<History>),
    /// The map is to be made anew.
    Bent(Box<History>, Correction),
    /// It is away with a task.
    Busy,
    /// The drive has become too long, and none is kept any more.
    Full,
}

/// The drive as it was located.
#[derive(Debug)]
struct History {
    settings: MapperSettings,
    scans: Vec<Placed>,
    /// Scans of these that `drive` has taken in.
    taken: usize,
    drive: Drive,
    /// How the map that is shown was bent.
    bent: Option<Correction>,
}

/// Where a robot stands, or seems to.
#[derive(Debug, Default)]
struct Stand {
    at: Pose,
    scans: usize,
}

/// Something that takes long.
#[derive(Debug)]
pub struct Task {
    history: Box<History>,
    fresh: Vec<Placed>,
    /// How the map is to be bent, where it is to be made anew; else loops are sought.
    bent: Option<Correction>,
}

/// A task that was done.
#[derive(Debug)]
pub struct Done {
    history: Box<History>,
    found: Found,
}

#[derive(Debug)]
enum Found {
    Loops(Loops),
    Map { grid: Box<Grid>, bent: Correction, moved: Moved },
}

/// What was closed last.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LastClosing {
    /// Stretches of the drive that agree about it.
    pub closures: usize,
    /// How far the drive was out at most (m).
    pub metres: f64,
    /// ... and its heading (degrees).
    pub degrees: f64,
}

impl fmt::Display for LastClosing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let LastClosing { closures, metres, degrees } = self;
        write!(
            f,
            "the drive came back {closures} times and was out by {metres:.2} m, {degrees:.1} degrees at most: the map was \
             made anew"
        )
    }
}

/// How the loops stand.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClosingReport {
    /// Whether loops are closed still: a drive that is too long to be kept is mapped on without.
    pub is_on: bool,
    /// Searches for loops that have ended.
    pub searches: u64,
    /// Times that the map was made anew with a loop closed.
    pub closed: u64,
    /// The last of these times.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub last: Option<LastClosing>,
    /// Scans that are kept.
    pub scans_kept: u64,
    /// Memory that all of it holds (bytes).
    pub bytes: usize,
}

impl ClosingReport {
    /// How they stand, to be put behind a line that says what is mapped; nothing where there is nothing to say.
    pub fn in_words(&self) -> String {
        match (self.is_on, self.closed) {
            (false, _) => ", the drive is too long for its loops to be closed".into(),
            (true, 0) => String::new(),
            (true, times) => format!(", loops closed: {times}"),
        }
    }
}

impl Closing {
    /// At the beginning of a drive.
    pub fn new(settings: &MapperSettings) -> Closing {
        let history = History {
            settings: settings.clone(),
            scans: Vec::new(),
            taken: 0,
            drive: Drive::default(),
            bent: None,
        };
        Closing {
            state: State::Idle(Box::new(history)),
            fresh: Vec::new(),
            odometer: Odometer::default(),
            stand: Stand::default(),
            way: 0.0,
            sought: 0.0,
            shift: Pose::identity(),
            scan_bytes: 0,
            drive_bytes: 0,
            scans: 0,
            searches: 0,
            closed: 0,
            last: None,
        }
    }

    /// How the loops stand.
    pub fn report(&self) -> ClosingReport {
        ClosingReport {
            is_on: !matches!(self.state, State::Full),
            searches: self.searches,
            closed: self.closed,
            last: self.last,
            scans_kept: self.scans,
            bytes: self.scan_bytes + self.drive_bytes,
        }
    }

    /// Keeps a scan that was placed: the scanner in the map at its first and last beam.
    pub fn keep(&mut self, scan: &Scan, shown: [Pose; 2]) {
        if matches!(self.state, State::Full) {
            return;
        }
        let to_located = self.shift.inverse();
        let [start, end] = shown.map(|pose| to_located * pose);
        let middle = interpolate(&start, &end, 0.5);
        let (way, is_key) = self.odometer.advance(&middle);
        self.way = way;
        let placed = Placed::new(scan, [start, end], way, is_key);
        self.scan_bytes += placed.bytes();
        self.scans += 1;
        self.fresh.push(placed);
        if self.stand.is_long(&middle)
            && let Some(surplus) = self.fresh.len().checked_sub(STAND + 1)
        {
            self.scan_bytes -= self.fresh.remove(surplus).bytes();
            self.scans -= 1;
        }
    }

    /// What is to be done next, where it is time to.
    pub fn next_task(&mut self) -> Option<Task> {
        let is_due = self.way >= FIRST_SEARCH
            && self.way - self.sought >= NEXT_SEARCH[0].max(NEXT_SEARCH[1] * self.sought);
        self.task(is_due)
    }

    /// What is to be done at the end of the drive.
    pub fn last_task(&mut self) -> Option<Task> {
        self.task(self.way >= FIRST_SEARCH && self.way > self.sought)
    }

    fn task(&mut self, is_search_due: bool) -> Option<Task> {
        match std::mem::replace(&mut self.state, State::Busy) {
            State::Idle(_) if self.scan_bytes + self.drive_bytes > MOST => {
                self.fresh = Vec::new();
                (self.scans, self.scan_bytes, self.drive_bytes) = (0, 0, 0);
                self.state = State::Full;
                None
            }
            State::Idle(history) if is_search_due => {
                self.sought = self.way;
                Some(Task { history, fresh: std::mem::take(&mut self.fresh), bent: None })
            }
            State::Bent(history, bent) => {
                Some(Task { history, fresh: std::mem::take(&mut self.fresh), bent: Some(bent) })
            }
            other => {
                self.state = other;
                None
            }
        }
    }

    /// Takes a task back that was done. Where it has made a map, that is in `grid` from now on, with all that came meanwhile.
    pub fn take_back(&mut self, done: Done, grid: &mut Grid) -> Option<Moved> {
        let Done { mut history, found } = done;
        self.drive_bytes = history.drive.bytes();
        match found {
            Found::Loops(loops) => {
                self.searches += 1;
                self.state = match loops {
                    Loops::Bent(bent) => State::Bent(history, bent),
                    Loops::None | Loops::Good { .. } => State::Idle(history),
                };
                None
            }
            Found::Map { grid: made, bent, moved } => {
                *grid = *made;
                self.fresh.iter().for_each(|placed| placed.insert(grid, &bent));
                self.closed += 1;
                let Correction { closures, out: [metres, turn], .. } = bent;
                self.last = Some(LastClosing { closures, metres, degrees: turn.to_degrees() });
                self.shift = bent.last();
                history.bent = Some(bent);
                self.state = State::Idle(history);
                Some(moved)
            }
        }
    }
}

impl Stand {
    /// Whether more scans were taken here than are kept.
    fn is_long(&mut self, at: &Pose) -> bool {
        let off = difference(at, &self.at);
        if off.xy().norm() > STILL[0] || off.z.abs() > STILL[1] {
            *self = Stand { at: *at, scans: 0 };
        }
        self.scans = self.scans.saturating_add(1);
        self.scans > 2 * STAND
    }
}

impl Task {
    /// Does it.
    pub fn run(self) -> Done {
        let Task { mut history, mut fresh, bent } = self;
        history.scans.append(&mut fresh);
        let found = match bent {
            None => Found::Loops(history.seek()),
            Some(bent) => history.map(bent),
        };
        Done { history, found }
    }
}

impl History {
    fn seek(&mut self) -> Loops {
        for placed in self.scans[self.taken..].iter().filter(|placed| placed.is_key()) {
            self.drive.add_key(placed.way(), &placed.middle(), &placed.points(&self.settings.localize));
        }
        self.taken = self.scans.len();
        self.drive.close(self.bent.as_ref())
    }

    /// The map of all scans in a drive that is bent like this.
    fn map(&self, bent: Correction) -> Found {
        let mut grid = Box::new(Grid::new(&self.settings));
        let steps = self.scans.iter().map(|placed| {
            placed.insert(&mut grid, &bent);
            let by = placed.start(Some(&bent)) * placed.start(self.bent.as_ref()).inverse();
            (placed.stamp_ns(), by)
        });
        let moved = Moved::new(steps.collect());
        Found::Map { grid, bent, moved }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::{
        localize::tests::{ring, scan},
        map::{Map, Values},
        mapper::{Mapper, MapperKind, Outcome, PoseUse},
        pose::{StampedPose, pose},
    };
    use std::f64::consts::FRAC_PI_2;

    /// Scans of a lap round the ring: ten a metre, and twenty while it turns.
    const LAP: u64 = 520;

    /// Where the robot truly is.
    fn truth(seq: u64) -> Pose {
        let (mut at, mut seq) = (pose(1.5, 1.2, 0.0), seq % LAP);
        for side in [130, 90, 130, 90] {
            at *= pose(seq.min(side) as f64 * 0.1, 0.0, 0.0);
            seq = seq.saturating_sub(side);
            at *= pose(0.0, 0.0, seq.min(20) as f64 / 20.0 * FRAC_PI_2);
            seq = seq.saturating_sub(20);
        }
        at
    }

    /// Odometry is true, but the scanner bends walls, and what lies some metres back is matched no more.
    pub(crate) fn settings(close_loops: bool) -> MapperSettings {
        let mut settings = MapperSettings { poses: PoseUse::Odometry, close_loops, ..Default::default() };
        settings.localize.submap_way = 5.0;
        settings
    }

    /// In whole millimetres, of a scanner that sees what is to its left too far and what is to its right too near. Walls shine at
    /// their normal.
    fn bent_scan(walls: &[[[f64; 2]; 2]], seq: u64) -> Scan {
        let mut scan = scan(walls, &|_| truth(seq), seq);
        for (beam, range) in scan.ranges.iter_mut().enumerate() {
            let bearing = scan.geometry.angle_min + beam as f64 * scan.geometry.angle_increment;
            let bent = f64::from(*range) * (1.0 + 0.04 * bearing.sin());
            *range = (bent * 1000.0).round() as f32 / 1000.0;
            let off_normal = (truth(seq).rotation.angle() + bearing).rem_euclid(FRAC_PI_2);
            let glint = if off_normal < 0.005 { 2.5 } else { 1.0 };
            scan.intensities.push(5000.0 * glint * range.powf(-0.4));
        }
        scan
    }

    /// How often cells have glinted.
    fn glints(map: &Map) -> u64 {
        let glints = map.layers.iter().find(|layer| layer.name == "glints").unwrap();
        let Values::U8(counts) = &glints.values else { panic!("{glints:?}") };
        counts.iter().map(|&count| u64::from(count)).sum()
    }

    /// What comes of a place: true odometry and a scan.
    pub(crate) fn taken(walls: &[[[f64; 2]; 2]], seq: u64) -> ([StampedPose; 2], Scan) {
        let (pose, scan) = (truth(seq), bent_scan(walls, seq));
        let odometry = [scan.stamp_ns, scan.end_ns()].map(|stamp_ns| {
            let received_ns = stamp_ns;
            StampedPose { stamp_ns, received_ns, pose, covariance: None, reset: 0 }
        });
        (odometry, scan)
    }

    /// A drive round the ring.
    struct Driven {
        mapper: Mapper,
        /// Where each scan is shown, at last.
        shown: Vec<Pose>,
        /// Scans that were shown before each closing.
        closed_after: Vec<usize>,
    }

    impl Driven {
        /// With the tasks brought back so many scans after they were given away.
        fn new(settings: MapperSettings, scans: u64, delay: u64) -> Driven {
            let (mapper, walls) = (Mapper::new(settings), ring());
            let mut driven = Driven { mapper, shown: Vec::new(), closed_after: Vec::new() };
            let mut away: Option<(Task, u64)> = None;
            for seq in 0..scans {
                if let Some((task, _)) = away.take_if(|(_, due)| *due <= seq) {
                    driven.mapper.take_back(task.run());
                }
                driven.take(&walls, seq);
                away = away.or_else(|| Some((driven.mapper.next_task()?, seq + delay)));
            }
            let mut last = away.map(|(task, _)| task).or_else(|| driven.mapper.last_task());
            while let Some(task) = last {
                driven.mapper.take_back(task.run());
                last = driven.mapper.next_task().or_else(|| driven.mapper.last_task());
            }
            driven.take_outcomes();
            driven
        }

        fn take(&mut self, walls: &[[[f64; 2]; 2]], seq: u64) {
            let (odometry, scan) = taken(walls, seq);
            odometry.into_iter().for_each(|pose| self.mapper.on_pose(pose));
            self.mapper.on_scan(scan);
            self.take_outcomes();
        }

        fn take_outcomes(&mut self) {
            while let Some(outcome) = self.mapper.next_outcome() {
                match outcome {
                    Outcome::Inserted { seq, start, .. } => {
                        assert_eq!(seq, self.shown.len() as u64);
                        self.shown.push(start);
                    }
                    Outcome::Moved(moved) => {
                        self.closed_after.push(self.shown.len());
                        for (seq, shown) in self.shown.iter_mut().enumerate() {
                            *shown = moved.at(seq as i64 * 25_000_000) * *shown;
                        }
                    }
                    Outcome::Skipped { reason, .. } => panic!("{reason:?}"),
                }
            }
        }

        /// How far the second lap lies beside the first at most (m).
        fn apart(&self) -> f64 {
            let laps = self.shown.iter().zip(&self.shown[LAP as usize..]);
            laps.map(|(first, second)| difference(first, second).xy().norm()).fold(0.0, f64::max)
        }
    }

    #[test]
    fn a_second_lap_falls_onto_the_first() {
        let open = Driven::new(settings(false), 800, 0);
        let apart = open.apart();
        assert!(apart > 0.3, "{apart} m");
        for delay in [0, 37] {
            let mut closed = Driven::new(settings(true), 800, delay);
            assert!(closed.apart() < 0.05, "{} m", closed.apart());
            let report = closed.mapper.report().loops.unwrap();
            assert_eq!((report.closed, report.scans_kept), (closed.closed_after.len() as u64, 800));
            assert!(closed.closed_after[0] < 700, "not before the end: {:?}", closed.closed_after);
            // The map is that of a mapper that is told where each scan was taken.
            let mut told = Mapper::new(MapperSettings::default());
            let walls = ring();
            for (seq, at) in closed.shown.iter().enumerate() {
                told.on_located(bent_scan(&walls, seq as u64), Ok((*at, *at)));
            }
            let (map, wanted) = (closed.mapper.map(), told.map());
            assert_eq!((map.width, map.height, map.origin), (wanted.width, wanted.height, wanted.origin));
            let unlike = map.occupancy.iter().zip(&wanted.occupancy).filter(|(a, b)| a != b).count();
            assert!(unlike * 1000 < map.occupancy.len(), "{unlike} of {} cells", map.occupancy.len());
            let [glints, wanted] = [&map, &wanted].map(glints);
            assert!(wanted > 500 && glints.abs_diff(wanted) * 20 < wanted, "{glints} glints, not {wanted}");
        }
    }

    #[test]
    fn who_stands_keeps_no_more() {
        let mut closing = Closing::new(&settings(true));
        let walls = ring();
        let scan = bent_scan(&walls, 0);
        let mut numbers = 0..;
        let mut stand = |x: f64, scans: usize| {
            for seq in numbers.by_ref().take(scans) {
                let at = pose(x + 0.01 * (seq as f64).sin(), 0.0, 0.0);
                closing.keep(&Scan { seq, ..scan.clone() }, [at, at]);
            }
            closing.report()
        };
        let kept = [stand(0.0, 30), stand(0.0, 1_000), stand(0.0, 10_000), stand(1.0, 1_000)];
        let most = 2 * STAND as u64;
        assert_eq!(kept.each_ref().map(|report| report.scans_kept), [30, most, most, 2 * most]);
        assert_eq!(kept[1].bytes, kept[2].bytes);
        let numbers: Vec<u64> = closing.fresh.iter().map(Placed::seq).collect();
        assert_eq!(numbers[STAND - 1..=STAND], [79, 11_030 - 80], "the first and the last");
    }

    #[test]
    fn a_drive_that_is_too_long_is_mapped_on_without() {
        let mut driven = Driven::new(settings(true), 300, 0);
        let closing = driven.mapper.closing().unwrap();
        closing.scan_bytes = MOST;
        assert!(driven.mapper.last_task().is_none());
        driven.take(&ring(), 300);
        assert_eq!(driven.shown.len(), 301);
        let report = driven.mapper.report().loops.unwrap();
        assert_eq!((report.is_on, report.scans_kept, report.bytes), (false, 0, 0));
    }

    #[test]
    fn loops_are_closed_where_scans_are_matched_in_an_empty_map() {
        let closes = |settings: MapperSettings| Mapper::new(settings).closes_loops();
        assert!(closes(settings(true)));
        assert!(!closes(settings(false)));
        assert!(!closes(MapperSettings { poses: PoseUse::Map, ..settings(true) }));
        assert!(
            closes(MapperSettings { mapper: MapperKind::Glints, ..settings(true) }),
            "intensities are kept"
        );
        let saved = Driven::new(settings(true), 10, 0).mapper.save().unwrap();
        assert!(!Mapper::going_on(&saved, settings(true)).unwrap().closes_loops());
    }
}
