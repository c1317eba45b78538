//! What a cell with evidence knows (paper IV-B): its occupancy, the view angles from which it was
//! continuously observed, and those it was missed from since.
//!
//! Cells without evidence have no such state; one bit tells whether a beam has crossed them.

use super::{
    angle::{Angle, AngleRange, atan2},
    tiles::{CellIndex, TileIndex},
    view::Observation,
};

/// How far apart, in the order of scans, two observations may be and still follow each other.
const NEXT_SCAN: u32 = 1;

/// The rule of the core algorithm, in numbers.
#[derive(Clone, Copy, Debug)]
pub struct Rule {
    /// Occupancy that a contradiction takes; a hit adds one.
    pub contradiction: u8,
    /// Occupancy is not counted beyond this.
    pub cap: u8,
    /// Half a beam's width (units of [`Angle`]), by which every arc is wider than its directions.
    pub half_beam: u32,
    /// Relative error of two sensor positions right next to each other (m).
    pub drift_least: f32,
    /// By how much that error grows with the way driven between them (m/m).
    pub drift_rate: f32,
    /// The error never exceeds this, however long the way (m): the localization is bounded.
    pub drift_most: f32,
    /// Scans in a row without a return that tell that nothing is there to return.
    pub silent_scans: u8,
    /// Whether a second range, apart from the first, is kept.
    pub two_ranges: bool,
}

impl Rule {
    /// The shift between two view angles of a cell at `range` that a relative position error may
    /// explain, the sensor having driven `way` between them (units of [`Angle`]).
    fn explained(&self, way: f32, range: f32) -> i32 {
        let error = (self.drift_least + self.drift_rate * way).min(self.drift_most);
        (atan2(error, range) * (65_536.0 / std::f32::consts::TAU)) as i32
    }
}

/// Where and when a cell is looked at.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    /// Number of the scan; it steps by more than one where scans were lost.
    pub scan: u32,
    /// Bearing of the sensor seen from the cell.
    pub angle: Angle,
    /// Distance (m).
    pub range: f32,
    /// Way that the sensor has driven since the start (m).
    pub way: f32,
}

/// A range of view angles and how far the sensor had driven when it was recorded.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Visible {
    /// The range.
    pub range: AngleRange,
    /// Way driven at its last observation (m).
    pub way: f32,
    /// Distance of the sensor at the clockwise and at the counter-clockwise end (m).
    pub ranges: [f32; 2],
}

impl Visible {
    fn at(look: &Look) -> Visible {
        Visible { range: AngleRange::at(look.angle), way: look.way, ranges: [look.range; 2] }
    }

    fn extend(&mut self, look: &Look) {
        let before = self.range;
        self.range.extend(look.angle);
        self.way = look.way;
        if self.range.start != before.start {
            self.ranges[0] = look.range;
        } else if self.range.width != before.width {
            self.ranges[1] = look.range;
        }
    }

    /// Where the sensor was relative to the cell (m), `part` (0..1) of the straight way from one end of the range to the other.
    pub fn sensor(&self, part: f64) -> [f64; 2] {
        let end = |width: u16, range: f32| {
            let bearing = Angle(self.range.start.0.wrapping_add(width)).rad();
            [f64::from(range) * bearing.cos(), f64::from(range) * bearing.sin()]
        };
        let (from, to) = (end(0, self.ranges[0]), end(self.range.width, self.ranges[1]));
        [from[0] + (to[0] - from[0]) * part, from[1] + (to[1] - from[1]) * part]
    }
}

/// A cell with evidence: at least one return landed in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Column and row in its tile.
    pub place: [u8; 2],
    /// Hits less contradictions, at most [`Rule::cap`]; the cell goes when this reaches 0.
    pub occupancy: u8,
    /// How often it was seen again from angles known before, after having been missed in between.
    pub passes: u8,
    /// Scans with a return in it.
    pub hits: u16,
    /// Whether a beam had crossed it before the first return came: it was not there, or not visible.
    pub was_crossed: bool,
    /// The last scan that hit it, so that a scan counts once however many beams did.
    pub hit_scan: u32,
    /// The last scan that saw or missed it, or could not tell.
    pub(super) looked_scan: u32,
    /// phi_VIS: the widest range from which it was continuously observed.
    pub visible: Visible,
    /// The widest such range apart from `visible`; empty where `way` is negative.
    pub visible_too: Visible,
    /// The current run of observation, as of the last look.
    pub(super) run: Option<Visible>,
    /// phi_MISS: the range traversed since the cell was last observed or hidden, as of the last look.
    pub(super) missed: Option<AngleRange>,
    /// Scans in a row that missed it.
    pub(super) missed_scans: u8,
    /// The widest `missed` that it survived.
    pub widest_missed: u16,
    /// Mean place of the returns in the cell (cells, 0..1 each).
    pub centroid: [f32; 2],
    /// When the first and the last return landed in it (s since the first scan).
    pub(super) hit_time: [f32; 2],
}

impl Cell {
    /// A cell of which nothing is known but that returns are about to land in it.
    pub fn new(place: [u8; 2], was_crossed: bool, look: &Look) -> Cell {
        Cell::with_visible(place, was_crossed, Visible::at(look))
    }

    /// The same, visible from this range.
    pub(super) fn with_visible(place: [u8; 2], was_crossed: bool, visible: Visible) -> Cell {
        Cell {
            place,
            occupancy: 0,
            passes: 0,
            hits: 0,
            was_crossed,
            hit_scan: 0,
            looked_scan: 0,
            visible,
            visible_too: Visible { way: -1.0, ..Visible::default() },
            run: None,
            missed: None,
            missed_scans: 0,
            widest_missed: 0,
            centroid: [0.5; 2],
            hit_time: [0.0; 2],
        }
    }

    /// Its place in the map, in this tile.
    pub fn index(&self, tile: TileIndex) -> CellIndex {
        tile.cell(usize::from(self.place[0]), usize::from(self.place[1]))
    }

    /// Core step 1: a return at this place in the cell (cells, 0..1).
    pub fn record_hit(&mut self, at: [f32; 2], scan: u32, time: f32, rule: &Rule) {
        if self.hits == 0 {
            self.hit_time[0] = time;
        }
        self.hit_time[1] = time;
        if self.hit_scan != scan {
            self.hit_scan = scan;
            self.occupancy = (self.occupancy + 1).min(rule.cap);
            self.hits = self.hits.saturating_add(1);
        }
        let weight = 1.0 / f32::from(self.hits.min(255));
        for (mean, at) in self.centroid.iter_mut().zip(at) {
            *mean += (at - *mean) * weight;
        }
    }

    /// Core steps 2 to 4. Where something nearer returned, or the cell is outside of the field of view, there is nothing to
    /// record: neither range goes on over that angle, since both are bound to the scan that looked last.
    #[inline(always)]
    pub fn record(&mut self, observation: Observation, look: &Look, rule: &Rule) {
        match observation {
            Observation::Seen => self.record_seen(look, rule),
            Observation::Missed | Observation::Silent => {
                self.record_missed(look, observation == Observation::Silent, rule);
            }
            Observation::Hidden => (),
            Observation::Unsure => self.record_unsure(look),
        }
    }

    /// Time from its first return to its last (s).
    pub fn lasted(&self) -> f32 {
        self.hit_time[1] - self.hit_time[0]
    }

    /// Core step 2: the cell was observed from here. The run of observation goes on or begins, and
    /// replaces phi_VIS where it has become wider.
    pub fn record_seen(&mut self, look: &Look, rule: &Rule) {
        let run = match self.run {
            Some(mut run) if self.follows(look) => {
                run.extend(look);
                run
            }
            _ => Visible::at(look),
        };
        self.missed_scans = 0;
        if let Some(missed) = self.missed.take().filter(|_| self.follows(look)) {
            let again = self.visible.range.depth(AngleRange::at(look.angle), 2 * rule.half_beam) > 0;
            let moved_away = missed.width as i32 > rule.explained(look.way - self.visible.way, look.range);
            if again && moved_away {
                self.passes = self.passes.saturating_add(1);
            }
        }
        self.run = Some(run);
        self.looked_scan = look.scan;
        let width = run.range.width;
        if run.range.depth(self.visible.range, rule.half_beam) > 0 || !rule.two_ranges {
            if width >= self.visible.range.width {
                self.visible = run;
            }
        } else if self.visible_too.way < 0.0 || width >= self.visible_too.range.width {
            self.visible_too = run;
            if width > self.visible.range.width {
                std::mem::swap(&mut self.visible, &mut self.visible_too);
            }
        }
    }

    /// Whether the cell, were it still there, would return something over this distance (m): it was seen from
    /// as far. What is seen of glass from near, off its normal, is too faint farther away.
    pub fn would_return(&self, range: f32) -> bool {
        range <= 1.1 * self.visible.ranges[0].min(self.visible.ranges[1])
    }

    /// Core steps 3 and 4: the beams went past; `silent`, they returned nothing at all. Returns whether that contradicts what was observed
    /// before; the occupancy is then lower, and at 0 the cell must be removed (step 5).
    pub fn record_missed(&mut self, look: &Look, silent: bool, rule: &Rule) -> bool {
        self.run = None;
        let missed = match self.missed {
            Some(mut missed) if self.follows(look) => {
                missed.extend(look.angle);
                missed
            }
            _ => AngleRange::at(look.angle),
        };
        self.missed = Some(missed);
        self.missed_scans = if self.follows(look) { self.missed_scans.saturating_add(1) } else { 1 };
        self.looked_scan = look.scan;
        if silent && self.missed_scans < rule.silent_scans {
            return false;
        }
        let contradicts = |visible: &Visible| {
            let depth = visible.range.depth(missed, rule.half_beam);
            depth > 0 && depth > rule.explained(look.way - visible.way, look.range)
        };
        let contradicted =
            contradicts(&self.visible) || (self.visible_too.way >= 0.0 && contradicts(&self.visible_too));
        if contradicted {
            self.occupancy = self.occupancy.saturating_sub(rule.contradiction);
        } else {
            self.widest_missed = self.widest_missed.max(missed.width.max(1));
        }
        contradicted
    }

    /// The scan could not tell. A run of observation may bridge this, what is missed may not: it must
    /// hold only angles from which the cell would have been seen.
    pub fn record_unsure(&mut self, look: &Look) {
        if self.follows(look) {
            self.looked_scan = look.scan;
        }
        self.missed = None;
    }

    /// Whether the last look was at the scan before.
    fn follows(&self, look: &Look) -> bool {
        look.scan.wrapping_sub(self.looked_scan) <= NEXT_SCAN
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::angle::units;

    const RULE: Rule = Rule {
        contradiction: 5,
        cap: 30,
        half_beam: 23,
        drift_least: 0.002,
        drift_rate: 0.03,
        drift_most: 0.06,
        silent_scans: 20,
        two_ranges: true,
    };

    struct Drive {
        cell: Cell,
        scan: u32,
        way: f32,
    }

    impl Drive {
        fn look(&self, degrees: f64) -> Look {
            Look { scan: self.scan, angle: Angle::from_rad(degrees.to_radians()), range: 3.0, way: self.way }
        }

        fn new(degrees: f64) -> Drive {
            let look = Look { scan: 1, angle: Angle::from_rad(degrees.to_radians()), range: 3.0, way: 0.0 };
            Drive { cell: Cell::new([0, 0], true, &look), scan: 1, way: 0.0 }
        }

        /// Looks from `from` to `to` degrees in steps of one, 5 cm of way each.
        fn pass(&mut self, from: i32, to: i32, seen: std::ops::RangeInclusive<i32>) -> u32 {
            let mut contradictions = 0;
            let step = (to - from).signum();
            let mut degrees = from;
            while degrees != to + step {
                (self.scan, self.way) = (self.scan + 1, self.way + 0.05);
                let look = self.look(f64::from(degrees));
                if seen.contains(&degrees) {
                    self.cell.record_hit([0.5, 0.5], look.scan, 0.025 * look.scan as f32, &RULE);
                    self.cell.record_seen(&look, &RULE);
                } else {
                    contradictions += u32::from(self.cell.record_missed(&look, false, &RULE));
                }
                degrees += step;
            }
            self.scan += 100;
            contradictions
        }
    }

    #[test]
    fn a_pane_seen_near_its_normal_survives_every_other_view() {
        let mut drive = Drive::new(0.0);
        assert_eq!(drive.pass(0, 40, 0..=2), 0);
        assert_eq!(drive.pass(-40, 40, -1..=2), 0);
        assert_eq!(drive.cell.occupancy, 7);
        assert!(u32::from(drive.cell.widest_missed) >= units(37f64.to_radians()));
    }

    #[test]
    fn what_has_gone_is_freed_when_its_angles_are_passed_again() {
        let mut drive = Drive::new(0.0);
        drive.pass(-3, 40, -3..=3);
        assert_eq!(drive.cell.occupancy, 7);
        assert!(drive.pass(-40, 40, 99..=99) >= 2);
        assert_eq!(drive.cell.occupancy, 0);
    }

    #[test]
    fn a_parked_robot_frees_what_has_walked_away() {
        let mut drive = Drive::new(10.0);
        for seen in [true, true, false] {
            drive.scan += 1;
            let look = drive.look(10.0);
            if seen {
                drive.cell.record_hit([0.5, 0.5], look.scan, 0.025 * look.scan as f32, &RULE);
                drive.cell.record_seen(&look, &RULE);
            } else {
                assert!(drive.cell.record_missed(&look, false, &RULE));
            }
        }
        assert_eq!(drive.cell.occupancy, 0);
    }

    #[test]
    fn lost_scans_end_a_run() {
        let mut drive = Drive::new(0.0);
        for degrees in [0.0, 1.0, 2.0] {
            drive.scan += 1;
            let look = drive.look(degrees);
            drive.cell.record_seen(&look, &RULE);
        }
        drive.scan += 2;
        let look = drive.look(10.0);
        drive.cell.record_seen(&look, &RULE);
        assert_eq!(u32::from(drive.cell.visible.range.width), units(2f64.to_radians()));
    }

    #[test]
    fn what_was_hidden_meanwhile_was_not_missed() {
        let mut drive = Drive::new(0.0);
        drive.pass(0, 2, 0..=2);
        drive.scan -= 100;
        for degrees in -30i32..30 {
            drive.scan += 1;
            let look = drive.look(f64::from(degrees));
            if degrees.rem_euclid(2) != 0 && !(-4..=6).contains(&degrees) {
                assert!(!drive.cell.record_missed(&look, false, &RULE));
            }
        }
        assert!(drive.cell.widest_missed <= 1);
    }

    #[test]
    fn a_second_side_is_kept_apart() {
        let mut drive = Drive::new(0.0);
        drive.pass(0, 4, 0..=4);
        drive.pass(170, 173, 170..=173);
        assert_eq!(u32::from(drive.cell.visible.range.width), units(4f64.to_radians()));
        assert_eq!(u32::from(drive.cell.visible_too.range.width), units(3f64.to_radians()));
        assert!(drive.pass(150, 200, 0..=0) >= 2, "gone from the second side as well");
    }
}
