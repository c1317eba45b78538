//! Finds out where the scanner is by laying each scan onto what was seen before, with wheel odometry as a guide where there
//! is some.
//!
//! No clock, no files: a pure function of the order of its calls, like the mapper that it serves. Its matching maps are its
//! own; they are not the map that is shown. Sources: Hess et al. 2016 (submaps, search by branch and bound), Olson
//! 2009 (correlation), Censi 2008 (points against lines).

pub mod graph;
pub mod known;
pub mod loops;
pub mod matcher;
pub mod motion;
pub mod points;
pub mod search;
pub mod submap;

use crate::{
    grid::{standard::Standard, sweep::Sweep},
    pose::{Pose, interpolate},
    scan::Scan,
};
use known::matching_map;
use matcher::{Match, Prior, difference, refine};
use motion::Motion;
use nalgebra::Matrix3;
use points::Points;
use search::Window;
use serde::{Deserialize, Serialize};
use submap::Submap;

/// What scans are matched with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Reference {
    /// The surfaces of a [matching map](submap).
    #[default]
    Surfaces,
    /// The occupied cells of a standard occupancy grid, for comparison: glass that was seen through is not among them. A
    /// map made anew of these cells with each key scan takes milliseconds, and more the larger the map.
    Standard,
}

/// Settings of the localization.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LocalizeSettings {
    /// What scans are matched with: surfaces, or for comparison a standard grid. Default surfaces.
    pub reference: Reference,
    /// Distance between the points that are matched (m, 0.02..1). Default 0.08: long walls then do not outweigh what is rare.
    pub spacing: f64,
    /// Points that are matched at most (50..1081). Default 400.
    pub points: usize,
    /// Way between two scans that are added to the matching map (m, 0.02..1). Default 0.1.
    pub key_way: f64,
    /// Turn between them (rad, 0.01..1). Default 0.1.
    pub key_turn: f64,
    /// Way after which a new matching map is begun (m, 5..1000); each is used up to twice as long. Default 30.
    pub submap_way: f64,
    /// A match counts where surfaces explain at least this share of the points in known space (0.1..0.9). Default 0.45.
    pub explained: f64,
    /// Deviation of the place beyond which a scan is not inserted (m, 0.01..1). Default 0.15.
    pub position_sigma: f64,
    /// Deviation of the heading beyond which it is not (rad, 0.005..0.5). Default 0.03.
    pub heading_sigma: f64,
    /// Deviation of the place beyond which a scanner whose scans do not fit is lost (m, 0.1..10). Default 0.5.
    pub lost_sigma: f64,
}

impl Default for LocalizeSettings {
    fn default() -> Self {
        Self {
            reference: Reference::Surfaces,
            spacing: 0.08,
            points: 400,
            key_way: 0.1,
            key_turn: 0.1,
            submap_way: 30.0,
            explained: 0.45,
            position_sigma: 0.15,
            heading_sigma: 0.03,
            lost_sigma: 0.5,
        }
    }
}

/// How well the place is known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Tracking {
    /// No scan has come yet.
    #[default]
    Starting,
    /// The last match was good.
    Tracking,
    /// It was not; the motion is taken to go on.
    Degraded,
    /// The place is not known; the map is searched.
    Lost,
}

/// Why a scan's pose is not good enough for the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Doubt {
    /// The scan does not fit the map.
    Poor,
    /// It fits in several ways.
    Ambiguous,
    /// The place is not known.
    Lost,
}

/// Odometry of a scan: the robot at its first and last beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wheels {
    /// base_link in the odometry's frame at the first beam.
    pub start: Pose,
    /// ... and at the last.
    pub end: Pose,
    /// Counts the jumps of the odometry.
    pub reset: u32,
}

/// Where a scan was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Located {
    /// base_link in the map at the first beam.
    pub start: Pose,
    /// ... and at the last.
    pub end: Pose,
    /// Covariance xx, xy, xa, yy, ya, aa of `start` (m2, m rad, rad2) against the map near by: how the map itself has drifted
    /// since it was begun is not in it.
    pub covariance: [f64; 6],
    /// Why it must not be inserted.
    pub doubt: Option<Doubt>,
}

/// See the module.
#[derive(Debug)]
pub struct Localizer {
    settings: LocalizeSettings,
    /// The scanner on the robot.
    mount: Pose,
    motion: Option<Motion>,
    tracking: Tracking,
    /// Odometry at the middle of the last scan.
    wheels: Option<(Pose, u32)>,
    /// What earlier runs have left: matched against wherever it tells, and never changed.
    known: Option<Submap>,
    /// The map that is matched against, and the one that will follow it.
    current: Submap,
    following: Submap,
    /// The grid of whose cells `current` is made, where that is [wanted](Reference::Standard).
    standard: Option<Standard>,
    /// Way driven since `following` was begun, and since the last key scan (m).
    submap_way: f64,
    last_key: Option<Pose>,
    /// Where the frame of `current` lies in the map that is shown: elsewhere, once a loop was closed.
    frame: Pose,
    /// When `current` was begun to be matched against (ns).
    since_ns: i64,
    /// Maps that were matched against before, oldest first, at most [`KEPT`]: for when the place is lost.
    former: Vec<Former>,
    points: Points,
    /// Scans that have to fit before one is inserted again, after one that did not.
    probation: u32,
    /// Share of the points that is usually explained.
    usual: f64,
    /// Time of the last good match (ns).
    good_ns: i64,
    /// Scans since the place was lost, and searches since then.
    searching: u32,
    searched: usize,
    /// Searches that found several places.
    ambiguous: u64,
    /// Whether the last one did.
    is_ambiguous: bool,
    scans: u32,
}

/// A map that was matched against before.
#[derive(Debug)]
struct Former {
    map: Submap,
    /// Where its frame lies in the map that is shown.
    frame: Pose,
    /// When it was begun to be matched against, which is the middle of the way that made it (ns).
    since_ns: i64,
}

/// First scans that are all added to the map, so that its beginning does not rest on the noise of one.
const FIRST_KEYS: u32 = 10;

impl Localizer {
    /// A localizer with an empty map.
    pub fn new(settings: LocalizeSettings, mount: Pose) -> Localizer {
        let standard = settings.reference == Reference::Standard;
        Localizer {
            settings,
            mount,
            motion: None,
            tracking: Tracking::Starting,
            wheels: None,
            known: None,
            current: Submap::default(),
            following: Submap::default(),
            standard: standard.then(|| Standard::new(STANDARD_CELL, points::RANGE_MAX.into())),
            submap_way: 0.0,
            last_key: None,
            frame: Pose::identity(),
            since_ns: i64::MIN,
            former: Vec::new(),
            points: Points::default(),
            probation: 0,
            usual: 0.0,
            good_ns: i64::MIN,
            searching: 0,
            searched: 0,
            ambiguous: 0,
            is_ambiguous: false,
            scans: 0,
        }
    }

    /// A localizer that is somewhere in a known map and has to find out where.
    pub fn in_known(settings: LocalizeSettings, mount: Pose, known: Submap) -> Localizer {
        // The first scan is searched for.
        let searching = SEARCH_EVERY - 1;
        let tracking = Tracking::Lost;
        Localizer { known: Some(known), tracking, searching, ..Localizer::new(settings, mount) }
    }

    /// Whether the last search found several places that are as good as each other.
    pub fn is_ambiguous(&self) -> bool {
        self.is_ambiguous
    }

    /// Searches after which several places were as good as each other.
    pub fn ambiguous(&self) -> u64 {
        self.ambiguous
    }

    /// How well the place is known.
    pub fn tracking(&self) -> Tracking {
        self.tracking
    }

    /// Whether a scan was ever located.
    pub fn has_begun(&self) -> bool {
        self.motion.is_some()
    }

    /// Memory that the matching maps hold (bytes).
    pub fn bytes(&self) -> usize {
        [&self.current, &self.following]
            .into_iter()
            .chain(self.former.iter().map(|former| &former.map))
            .chain(&self.known)
            .map(Submap::bytes)
            .sum()
    }

    /// What was shown is shown elsewhere now: `moved` says where what was there at a time (ns) belongs.
    pub fn on_moved(&mut self, moved: impl Fn(i64) -> Pose) {
        self.frame = moved(i64::MAX) * self.frame;
        for former in &mut self.former {
            former.frame = moved(former.since_ns) * former.frame;
        }
    }

    /// Locates a scan.
    pub fn locate(&mut self, scan: &Scan, wheels: Option<Wheels>) -> Located {
        self.scans += 1;
        let middle_ns = scan.stamp_ns + (scan.end_ns() - scan.stamp_ns) / 2;
        let wheels_middle = wheels.map(|wheels| interpolate(&wheels.start, &wheels.end, 0.5));
        let mut motion = match self.motion.take() {
            Some(motion) => motion,
            None => {
                let base = wheels_middle.unwrap_or_else(Pose::identity);
                let motion = Motion::new(middle_ns, base * self.mount);
                if self.known.is_none() {
                    return self.begin(motion, scan, wheels, wheels_middle);
                }
                motion
            }
        };
        match (wheels_middle, wheels, self.wheels) {
            (Some(now), Some(Wheels { reset, .. }), Some((before, reset_before)))
                if reset == reset_before =>
            {
                let by = self.mount.inverse() * before.inverse() * now * self.mount;
                motion.drive(middle_ns, &by);
            }
            _ => motion.coast(middle_ns),
        }
        self.wheels = wheels_middle.zip(wheels.map(|wheels| wheels.reset));
        let [start, end] = self.within_scan(&motion, scan, wheels, wheels_middle);
        self.points.read(scan, start, end, self.settings.spacing, self.settings.points);
        let doubt = self.follow(&mut motion);
        // The match has told how fast it was, and so how the points lie that are added to the map.
        let [start, end] = self.within_scan(&motion, scan, wheels, wheels_middle);
        if wheels.is_none() && doubt.is_none() && self.is_key(&motion.pose) {
            self.points.read(scan, start, end, self.settings.spacing, self.settings.points);
        }
        self.finish(motion, scan, [start, end], doubt)
    }

    /// Takes in a scan of which somebody else has told where it was taken (base_link at its first and last beam), so that what
    /// follows can be matched when that one falls silent.
    pub fn follow_given(&mut self, scan: &Scan, start: &Pose, end: &Pose) {
        self.scans += 1;
        let middle_ns = scan.stamp_ns + (scan.end_ns() - scan.stamp_ns) / 2;
        let [start, end] = [start, end].map(|pose| pose * self.mount);
        let at = interpolate(&start, &end, 0.5);
        let mut motion = self.motion.take().unwrap_or_else(|| Motion::new(middle_ns, at));
        // Whoever jumps is not moving that fast; and what was matched before is of no use at another place.
        if !motion.allows(&at) {
            motion = Motion::new(middle_ns, at);
        }
        motion.given(middle_ns, at);
        (self.wheels, self.tracking, self.probation) = (None, Tracking::Tracking, 0);
        self.good_ns = middle_ns;
        if self.is_key(&at) {
            let own = [start, end].map(|pose| at.inverse() * pose);
            self.points.read(scan, own[0], own[1], self.settings.spacing, self.settings.points);
            self.add_key(&at, scan, own);
        }
        self.motion = Some(motion);
    }

    /// The first scan makes the map.
    fn begin(
        &mut self,
        motion: Motion,
        scan: &Scan,
        wheels: Option<Wheels>,
        wheels_middle: Option<Pose>,
    ) -> Located {
        self.wheels = wheels_middle.zip(wheels.map(|wheels| wheels.reset));
        let [start, end] = self.within_scan(&motion, scan, wheels, wheels_middle);
        self.points.read(scan, start, end, self.settings.spacing, self.settings.points);
        if self.points.thinned.len() < FEWEST {
            // A map of nothing could never be matched: begin with a scan that shows something.
            return self.finish_without(motion.pose, start, end);
        }
        self.tracking = Tracking::Tracking;
        self.good_ns = motion.stamp_ns;
        self.finish(motion, scan, [start, end], None)
    }

    /// The scanner at the first and last beam, in its own frame at the middle of the scan.
    fn within_scan(
        &self,
        motion: &Motion,
        scan: &Scan,
        wheels: Option<Wheels>,
        middle: Option<Pose>,
    ) -> [Pose; 2] {
        match (wheels, middle) {
            (Some(wheels), Some(middle)) => [wheels.start, wheels.end]
                .map(|pose| self.mount.inverse() * middle.inverse() * pose * self.mount),
            _ => [-0.5, 0.5].map(|part| motion.ahead(part * sweep_s(scan))),
        }
    }

    /// Matches the points, and says what speaks against the result.
    fn follow(&mut self, motion: &mut Motion) -> Option<Doubt> {
        if self.tracking == Tracking::Lost {
            return self.find_back(motion);
        }
        let points = &self.points.thinned;
        if points.len() < FEWEST {
            return self.miss(motion, Doubt::Poor);
        }
        let prior = motion.prior();
        let mut found = None;
        if let Some(known) = &self.known {
            let there = fit(known, points, motion, &prior);
            let is_good = there.known >= KNOWN_ENOUGH && there.explained >= AGAIN_PART * self.usual;
            found = (is_good && motion.allows(&there.pose)).then_some(there);
        }
        let found = match found {
            Some(found) => found,
            // Nothing was added since the place was found.
            None if self.current.keys() == 0 => return self.miss(motion, Doubt::Poor),
            None => fit(&self.current, points, motion, &prior),
        };
        let fits = if self.probation > 0 {
            found.known >= AGAIN_KNOWN && found.explained >= AGAIN_PART * self.usual
        } else {
            let least = self.settings.explained.max(USUAL_PART * self.usual);
            found.known <= SEEN_BEFORE || found.explained >= least
        };
        if !fits || !motion.allows(&found.pose) {
            return self.miss(motion, Doubt::Poor);
        }
        motion.correct(&found);
        self.good_ns = motion.stamp_ns;
        if self.probation == 0 {
            self.usual += (found.explained - self.usual) * USUAL_MEMORY;
        }
        let [place, heading] = motion.sigmas().map(|sigma| sigma * CAUTION);
        if place > self.settings.position_sigma || heading > self.settings.heading_sigma {
            self.tracking = Tracking::Degraded;
            return Some(Doubt::Ambiguous);
        }
        self.probation = self.probation.saturating_sub(1);
        if self.probation > 0 {
            self.tracking = Tracking::Degraded;
            return Some(Doubt::Ambiguous);
        }
        self.tracking = Tracking::Tracking;
        None
    }

    /// The scan does not fit: the motion is believed for a while.
    fn miss(&mut self, motion: &Motion, doubt: Doubt) -> Option<Doubt> {
        let [place, _] = motion.sigmas();
        // Odometry that goes on leaves little room for a wrong place.
        let is_guided = self.wheels.is_some();
        if !is_guided {
            self.probation = PROBATION;
        }
        let is_lost = place > self.settings.lost_sigma
            || motion.stamp_ns.saturating_sub(self.good_ns) > BELIEVED_NS[usize::from(is_guided)];
        self.tracking = if is_lost { Tracking::Lost } else { Tracking::Degraded };
        Some(if is_lost { Doubt::Lost } else { doubt })
    }

    /// Searches one of the maps now and then, each in its turn: the known one, the present one, the former ones.
    fn find_back(&mut self, motion: &mut Motion) -> Option<Doubt> {
        self.searching += 1;
        if self.points.thinned.len() < FEWEST || !self.searching.is_multiple_of(SEARCH_EVERY) {
            return Some(Doubt::Lost);
        }
        let own = (self.current.keys() > 0).then_some(&self.current);
        let maps: Vec<&Submap> =
            self.known.iter().chain(own).chain(self.former.iter().map(|former| &former.map)).collect();
        let number = self.searched % maps.len().max(1);
        self.searched = number + 1;
        let Some(&map) = maps.get(number) else { return Some(Doubt::Lost) };
        let recognized = recognize(map, &self.points);
        self.is_ambiguous = matches!(recognized, Recognized::Several);
        self.ambiguous += u64::from(self.is_ambiguous);
        let found = match recognized {
            Recognized::Here(found) => found,
            Recognized::Several => {
                return Some(Doubt::Ambiguous);
            }
            Recognized::Nowhere => return Some(Doubt::Lost),
        };
        // What was seen since is of no use in another map: its place against that one is not known well enough.
        let is_known = self.known.is_some() && number == 0;
        let former = number.checked_sub(maps.len() - self.former.len());
        if is_known || former.is_some() {
            let new = Former { map: Submap::default(), frame: Pose::identity(), since_ns: motion.stamp_ns };
            let next = former.map(|former| self.former.remove(former)).unwrap_or(new);
            self.following = Submap::default();
            self.submap_way = 0.0;
            self.last_key = None;
            self.change_to(next);
        }
        motion.jump(&found);
        self.good_ns = motion.stamp_ns;
        (self.searching, self.searched) = (0, 0);
        if self.usual == 0.0 {
            self.usual = found.explained;
        }
        // The next scans show whether it holds.
        self.probation = PROBATION;
        self.tracking = Tracking::Degraded;
        Some(Doubt::Ambiguous)
    }

    /// Matches against another map from now on.
    fn change_to(&mut self, next: Former) {
        let map = std::mem::replace(&mut self.current, next.map);
        let left = Former { map, frame: self.frame, since_ns: self.since_ns };
        (self.frame, self.since_ns) = (next.frame, next.since_ns);
        if left.map.keys() == 0 {
            return;
        }
        if self.former.len() == KEPT {
            self.former.remove(0);
        }
        self.former.push(left);
    }

    /// Notes the motion, adds the scan to the matching map where it is time to, and puts the result together.
    fn finish(
        &mut self,
        motion: Motion,
        scan: &Scan,
        [start, end]: [Pose; 2],
        doubt: Option<Doubt>,
    ) -> Located {
        let at = motion.pose;
        // Where nothing but its speed tells how the scanner moved within the scan, that adds to what is not known.
        let half_sweep_s = if self.wheels.is_some() { 0.0 } else { sweep_s(scan) / 2.0 };
        let covariance = motion.covariance_ahead(-half_sweep_s);
        if doubt.is_none() && self.is_key(&at) {
            self.add_key(&at, scan, [start, end]);
        }
        let turn = self.frame.rotation.to_rotation_matrix().to_homogeneous();
        let covariance = turn * covariance * turn.transpose();
        self.motion = Some(motion);
        let c = |row: usize, column: usize| covariance[(row, column)] * CAUTION * CAUTION;
        Located {
            covariance: [c(0, 0), c(0, 1), c(0, 2), c(1, 1), c(1, 2), c(2, 2)],
            doubt,
            ..self.finish_without(at, start, end)
        }
    }

    /// Adds the scan to the matching maps, and begins a new one where it is time to. `own`: the scanner at the first and last
    /// beam, seen from `at`.
    fn add_key(&mut self, at: &Pose, scan: &Scan, own: [Pose; 2]) {
        if let Some(last) = self.last_key {
            self.submap_way += (at.translation.vector - last.translation.vector).norm();
        }
        self.last_key = Some(*at);
        if let Some(grid) = &mut self.standard {
            let [start, end] = own.map(|own| at * own);
            grid.insert(&Sweep { scan, start, end });
            let places = grid.known(at.translation.vector.into(), points::RANGE_MAX.into());
            self.current = matching_map(&places, STANDARD_CELL);
            return;
        }
        if self.submap_way > self.settings.submap_way {
            self.submap_way = 0.0;
            let map = std::mem::take(&mut self.following);
            self.change_to(Former { map, frame: self.frame, since_ns: scan.stamp_ns });
        }
        self.current.insert(&self.points, at);
        self.following.insert(&self.points, at);
    }

    fn finish_without(&self, at: Pose, start: Pose, end: Pose) -> Located {
        let to_base = self.mount.inverse();
        Located {
            start: self.frame * at * start * to_base,
            end: self.frame * at * end * to_base,
            covariance: [0.0; 6],
            doubt: Some(Doubt::Poor),
        }
    }

    fn is_key(&self, at: &Pose) -> bool {
        let Some(last) = self.last_key else { return true };
        let off = difference(at, &last);
        self.scans <= FIRST_KEYS
            || off.xy().norm() >= self.settings.key_way
            || off.z.abs() >= self.settings.key_turn
    }
}

/// Side of a cell of the [standard grid](Reference::Standard) (m).
const STANDARD_CELL: f64 = 0.05;
/// Fewer points than this show nothing.
const FEWEST: usize = 20;
/// Below this share of explained points a search looks whether there is a better place near by.
const GOOD: f64 = 0.6;
/// A place that a search finds is better than the one that was expected where it explains so much more.
const BETTER: f64 = 0.05;
/// Points in known space tell whether a scan fits where they are more than this share of all.
const SEEN_BEFORE: f64 = 0.15;
/// A scan that explains less than this part of the usual does not fit: people before the scanner cover much of what it sees,
/// but at even spacing few of the points are theirs.
const USUAL_PART: f64 = 0.7;
/// After a scan that did not fit the next ones have to fit nearly as well as usual (part of it), most of what they show
/// known (share), for so many scans: half a second at 40 Hz.
const AGAIN_PART: f64 = 0.9;
/// See [`AGAIN_PART`].
const AGAIN_KNOWN: f64 = 0.6;
/// See [`AGAIN_PART`].
const PROBATION: u32 = 20;
/// Weight of one scan in what is usual: some two seconds at 40 Hz.
const USUAL_MEMORY: f64 = 0.02;
/// A search looks as well where the place or the heading is less sure than this (m, rad): a refinement finds no farther.
const NARROW: [f64; 2] = [0.06, 0.03];
/// Share of the points that must lie on something for a place to be looked at more closely. It is half as much as at the right
/// place, in steps of a cell; less, and a search of a map in which it is not takes seconds.
const CANDIDATE: f64 = 0.45;
/// A place that a search finds is believed where this share of the points is explained,
const FOUND: f64 = 0.8;
/// ... no more than this share of the beams would have gone through a wall: a door that was open is shut,
const CONTRADICTED: f64 = 0.15;
/// ... and the next best place, as far as this share of the points is known there, fits no better than this part as well,
const ONLY: f64 = 0.8;
/// See [`ONLY`].
const KNOWN_WELL: f64 = 0.8;
/// ... or leaves so many times as much unexplained, and this share of the points more: the same place in another corner of a
/// building that looks alike from all sides. People who stand around leave a tenth unexplained at the right place.
const UNLIKE: [f64; 2] = [3.0, 0.1];
/// The known map tells where it holds at least this share of the points.
const KNOWN_ENOUGH: f64 = 0.5;
/// While lost, one scan in this many is searched for: a search takes up to 0.4 s, and the queue before the mapper holds 2 s.
const SEARCH_EVERY: u32 = 40;
/// For so long the motion is believed without a good match: an even one, and that of odometry (ns).
const BELIEVED_NS: [i64; 2] = [2_000_000_000, 10_000_000_000];
/// Former maps that are kept: 8 of some 10 MB each.
const KEPT: usize = 8;
/// Deviations are told this much larger than the points' noise makes them: points on one surface share its errors, and
/// the map has those of the scans that made it. On simulated drives, whose walls are straight, it is too much: the way over 5 m
/// is told with deviations four times as large as its errors (`trajectories --table`). On a real one (Freiburg, building 079) it
/// is not: in a map of every other scan the way over 5 m is another by 10 mrad in the median and 17 rms, where 13 are told.
const CAUTION: f64 = 3.0;

/// From the first beam of a scan to its last (s).
fn sweep_s(scan: &Scan) -> f64 {
    (scan.end_ns() - scan.stamp_ns) as f64 * 1e-9
}

/// Expects nothing: from a pose that a search has found.
fn free(pose: Pose) -> Prior {
    Prior { pose, information: Matrix3::zeros() }
}

/// The best match near the expected pose; wherever that is not sure or fits badly, a search looks around it.
fn fit(map: &Submap, points: &[points::ScanPoint], motion: &Motion, prior: &Prior) -> Match {
    let mut found = refine(map, points, prior);
    let [place, heading] = motion.sigmas();
    if found.explained < GOOD || place > NARROW[0] || heading > NARROW[1] {
        let window = Window { reach: (3.0 * place).clamp(0.2, 1.0), turn: (3.0 * heading).clamp(0.1, 0.5) };
        for candidate in search::around(map, points, &prior.pose, window) {
            let other = refine(map, points, &free(candidate.pose));
            if other.explained > found.explained + BETTER && motion.allows(&other.pose) {
                found = other;
            }
        }
    }
    found
}

/// What a search of a whole map finds.
enum Recognized {
    /// The one place where the points fit.
    Here(Match),
    /// They fit in several.
    Several,
    /// They fit nowhere.
    Nowhere,
}

/// Where in all of the map the points fit.
fn recognize(map: &Submap, points: &Points) -> Recognized {
    let candidates = search::anywhere(map, &points.thinned, search::ALL_HEADINGS, CANDIDATE);
    let mut matches: Vec<(f64, f64, Match)> = candidates
        .iter()
        .map(|candidate| {
            let found = refine(map, &points.thinned, &free(candidate.pose));
            let unlike = contradicted(map, points, &found.pose);
            (found.explained * (1.0 - unlike), unlike, found)
        })
        .collect();
    let sure = |(fit, _, found): &(f64, f64, Match)| fit * found.known;
    matches.sort_by(|a, b| sure(b).total_cmp(&sure(a)));
    let Some(first) = matches.first() else { return Recognized::Nowhere };
    let (fit, (_, unlike, best)) = (sure(first), *first);
    if best.explained < FOUND || best.known < AGAIN_KNOWN || unlike > CONTRADICTED {
        return Recognized::Nowhere;
    }
    // Another place may be the right one although less of it is known.
    let second = matches
        .iter()
        .filter(|(.., found)| {
            let off = difference(&found.pose, &best.pose);
            off.xy().norm() > 0.5 || off.z.abs() > 0.3
        })
        .map(|(fit, _, found)| fit * (found.known / KNOWN_WELL).min(1.0))
        .fold(0.0, f64::max);
    let is_only = second <= ONLY * fit || 1.0 - second >= UNLIKE[0] * (1.0 - fit) + UNLIKE[1];
    if is_only { Recognized::Here(best) } else { Recognized::Several }
}

/// Share of the beams that would have gone through what hides all behind it.
fn contradicted(map: &Submap, points: &Points, at: &Pose) -> f64 {
    // One in four is enough.
    let beams = points.beams.iter().step_by(4);
    let all = beams.len().max(1);
    let against = beams.filter(|beam| map.contradicts(at * beam.from, at * beam.to)).count();
    against as f64 / all as f64
}

#[cfg(test)]
pub(crate) mod tests;
