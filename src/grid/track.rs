//! What goes on in a cell from scan to scan: the view angles from which it was observed, and those it was missed from since
//! (paper IV-B).
//!
//! This is all of a cell that most scans touch, so it is kept apart, sixteen cells side by side in a [`Block`], in whole
//! numbers of 16 bits: binary angles, and distances in [`UNITS_PER_M`]. [`Track::record`] is the rule, for one cell;
//! `lanes` does the same for a block.

use super::{
    angle::{Angle, AngleRange, whole},
    cell::{Returns, Rule, Visible},
    view::{HIT, Observation, Place},
};

/// Units of distance in a metre. 15 bits then hold 64 m, and 2 mm are less than any error.
pub const UNITS_PER_M: f32 = 512.0;

/// Cells in a block.
pub const LANES: usize = 16;

/// Distance in units (m), rounded; at most 64 m.
pub fn distance_units(metres: f32) -> u16 {
    whole((metres * UNITS_PER_M).clamp(0.0, f32::from(i16::MAX))) as u16
}

/// Where a cell is looked at from.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    /// Bearing of the sensor seen from the cell.
    pub angle: Angle,
    /// Distance ([`UNITS_PER_M`]).
    pub range: u16,
    /// Way that the sensor has driven since the start (m).
    pub way: f32,
}

/// View angles, and how far the sensor was at the clockwise and at the counter-clockwise end ([`UNITS_PER_M`]).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sector {
    /// The angles.
    pub range: AngleRange,
    /// The distances; never 0 where there is a sector.
    pub ends: [u16; 2],
}

impl Sector {
    /// A single look.
    pub fn at(look: &Look) -> Sector {
        Sector { range: AngleRange::at(look.angle), ends: [look.range; 2] }
    }

    fn extend(&mut self, look: &Look) {
        let before = self.range;
        self.range.extend(look.angle);
        if self.range.start != before.start {
            self.ends[0] = look.range;
        } else if self.range.width != before.width {
            self.ends[1] = look.range;
        }
    }

    /// Whether there is one.
    pub fn exists(&self) -> bool {
        self.ends[0] != 0
    }
}

/// What the last scan has left to be gone on with.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(u16)]
pub enum Run {
    /// Nothing.
    #[default]
    None = 0,
    /// A run of observation.
    Seen = 1,
    /// Scans that missed the cell, since it was last observed or hidden.
    Missed = 2,
}

/// What of a record is the business of the cell's occupancy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// Nothing.
    None,
    /// It was seen again from angles known before, after having been missed in between.
    Pass,
    /// It was missed from where it must have been seen.
    Contradiction {
        /// But from farther away than it was seen from, and not over the middle of its view angles: what is behind glass outshines it there,
        /// the more the farther the sensor is from both, but where it glints.
        may_be_outshone: bool,
    },
}

/// One cell's part of a [`Block`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Track {
    /// Place in the tile, and marks.
    pub place: Place,
    /// What goes on.
    pub run: Run,
    /// Over which angles.
    pub sector: Sector,
    /// Scans in a row that missed it, or could not tell.
    pub missed_scans: u16,
    /// phi_VIS: the widest range from which it was continuously observed.
    pub visible: Sector,
    /// Way driven at the last observation of `visible` (m).
    pub way: f32,
    /// The widest such range apart from `visible`, if there is one.
    pub visible_too: Sector,
    /// Way driven at the last observation of `visible_too` (m).
    pub way_too: f32,
    /// Width of the widest range of misses, phi_MISS, that it survived (units of [`Angle`]).
    pub missed_width: u16,
    /// The widest since it was last observed.
    pub missed_since: AngleRange,
}

impl Track {
    /// A cell that is about to be seen for the first time.
    pub fn new(place: Place, look: &Look) -> Track {
        Track { place, visible: Sector::at(look), way: look.way, ..Track::default() }
    }

    /// Whether the cell, were it still there, would return something over this distance: it was seen from
    /// as far, or nearly. What is seen of glass from near, off its normal, is too faint farther away.
    pub fn would_return(&self, range: u16) -> bool {
        would_return(self.visible.ends, range)
    }

    /// Core steps 2 to 4. Where something nearer returned, or the cell is outside of the field of view, nothing goes on.
    /// `scans`: how many there were since the look before. `returns`: the cell's.
    pub fn record(
        &mut self,
        observation: Observation,
        look: &Look,
        scans: u16,
        rule: &Rule,
        returns: &Returns,
    ) -> Event {
        let (before, was) = (self.sector, self.run);
        self.place &= !HIT;
        match observation {
            Observation::Seen => self.record_seen(before, was, look, rule),
            Observation::Missed | Observation::Silent => {
                self.missed_scans = self.missed_scans.saturating_add(scans);
                self.record_missed(look, observation == Observation::Silent, rule, returns)
            }
            Observation::Hidden => {
                self.end_run();
                Event::None
            }
            // A run of observation may bridge this, what is missed may not: it must hold only angles from which the cell
            // would have been seen.
            Observation::Unsure => {
                if was == Run::Missed {
                    self.run = Run::None;
                }
                Event::None
            }
        }
    }

    /// Nothing goes on, as after scans that were lost.
    pub fn end_run(&mut self) {
        (self.run, self.missed_scans) = (Run::None, 0);
    }

    /// The sector that goes on, or begins here.
    fn go_on(&mut self, as_: Run, look: &Look) {
        if self.run == as_ {
            self.sector.extend(look);
        } else {
            (self.run, self.sector) = (as_, Sector::at(look));
        }
    }

    /// Core step 2: the cell was observed from here. The run of observation goes on or begins, and
    /// replaces phi_VIS where it has become wider.
    fn record_seen(&mut self, before: Sector, was: Run, look: &Look, rule: &Rule) -> Event {
        let is_pass = was == Run::Missed && {
            let again = self.visible.range.depth(AngleRange::at(look.angle), 2 * rule.half_beam) > 0;
            again && i32::from(before.range.width) > rule.explained(look.way - self.way, look.range)
        };
        self.go_on(Run::Seen, look);
        self.missed_since.width = 0;
        self.missed_scans = 0;
        let (run, width) = (self.sector, self.sector.range.width);
        if run.range.meets(self.visible.range, rule.half_beam) || !rule.two_ranges {
            if width >= self.visible.range.width {
                (self.visible, self.way) = (run, look.way);
            }
        } else if !self.visible_too.exists() || width >= self.visible_too.range.width {
            (self.visible_too, self.way_too) = (run, look.way);
            if width > self.visible.range.width {
                std::mem::swap(&mut self.visible, &mut self.visible_too);
                std::mem::swap(&mut self.way, &mut self.way_too);
            }
        }
        if is_pass { Event::Pass } else { Event::None }
    }

    /// Core steps 3 and 4: the beams went past; `silent`, they returned nothing at all.
    fn record_missed(&mut self, look: &Look, silent: bool, rule: &Rule, returns: &Returns) -> Event {
        self.go_on(Run::Missed, look);
        if silent && self.missed_scans < rule.silent_scans {
            return Event::None;
        }
        let missed = self.sector.range;
        let is_deep_in = |range: AngleRange, way: f32| {
            missed.meets(range, rule.half_beam)
                && missed.depth(range, rule.half_beam) > rule.explained(look.way - way, look.range)
        };
        let of = [(self.visible, self.way), (self.visible_too, self.way_too)];
        let contradicted = of.map(|(visible, way)| visible.exists() && is_deep_in(visible.range, way));
        if contradicted != [false; 2] {
            if rule.apart && returns.may_be_two() && self.forgets(contradicted) {
                return Event::None;
            }
            let is_surely = |(contradicted, (visible, way)): (bool, (Sector, f32))| {
                let at_middle = || is_deep_in(AngleRange::at(visible.range.middle()), way);
                contradicted && (would_return(visible.ends, look.range) || at_middle())
            };
            let may_be_outshone = !contradicted.into_iter().zip(of).any(is_surely);
            return Event::Contradiction { may_be_outshone };
        }
        let width = missed.width.max(1);
        self.missed_width = self.missed_width.max(width);
        if width > self.missed_since.width {
            self.missed_since = AngleRange { start: missed.start, width };
        }
        Event::None
    }

    /// Forgets the one of two ranges that is contradicted, where the other is not, and they may tell of two things: a pane seen at its normal and, in
    /// the same cell, an image or its dust seen from elsewhere. Gives whether it did.
    fn forgets(&mut self, contradicted: [bool; 2]) -> bool {
        if !self.visible_too.exists() || contradicted == [true; 2] {
            return false;
        }
        if contradicted[0] {
            (self.visible, self.way) = (self.visible_too, self.way_too);
        }
        self.visible_too = Sector::default();
        true
    }

    /// `visible` and `visible_too`, in metres.
    #[inline(always)]
    pub fn visibles(&self) -> [Visible; 2] {
        let visible = |sector: &Sector, way: f32| Visible {
            range: sector.range,
            way: if sector.exists() { way } else { -1.0 },
            ranges: sector.ends.map(|end| f32::from(end) / UNITS_PER_M),
        };
        [visible(&self.visible, self.way), visible(&self.visible_too, self.way_too)]
    }
}

fn would_return(ends: [u16; 2], range: u16) -> bool {
    let least = ends[0].min(ends[1]);
    range <= least.saturating_add(((u32::from(least) * TENTH) >> 16) as u16)
}

/// A tenth of 2^16, rounded up.
pub(super) const TENTH: u32 = 6_554;

/// [`Sector`]s, side by side.
#[derive(Clone, Debug, Default)]
#[repr(C, align(32))]
pub struct Sectors {
    pub(super) start: [u16; LANES],
    pub(super) width: [u16; LANES],
    pub(super) ends: [[u16; LANES]; 2],
}

impl Sectors {
    fn get(&self, lane: usize) -> Sector {
        Sector {
            range: AngleRange { start: Angle(self.start[lane]), width: self.width[lane] },
            ends: [self.ends[0][lane], self.ends[1][lane]],
        }
    }

    fn set(&mut self, lane: usize, sector: Sector) {
        self.start[lane] = sector.range.start.0;
        self.width[lane] = sector.range.width;
        self.ends[0][lane] = sector.ends[0];
        self.ends[1][lane] = sector.ends[1];
    }
}

/// [`Track`]s of sixteen cells, side by side.
#[derive(Clone, Debug, Default)]
#[repr(C, align(32))]
pub struct Block {
    pub(super) place: [Place; LANES],
    pub(super) run: [u16; LANES],
    pub(super) sector: Sectors,
    pub(super) missed_scans: [u16; LANES],
    pub(super) visible: Sectors,
    pub(super) visible_too: Sectors,
    pub(super) missed_width: [u16; LANES],
    pub(super) since_start: [u16; LANES],
    pub(super) since_width: [u16; LANES],
    pub(super) way: [f32; LANES],
    pub(super) way_too: [f32; LANES],
}

impl Block {
    /// One cell's part.
    #[inline(always)]
    pub fn get(&self, lane: usize) -> Track {
        Track {
            place: self.place[lane],
            run: match self.run[lane] {
                1 => Run::Seen,
                2 => Run::Missed,
                _ => Run::None,
            },
            sector: self.sector.get(lane),
            missed_scans: self.missed_scans[lane],
            visible: self.visible.get(lane),
            way: self.way[lane],
            visible_too: self.visible_too.get(lane),
            way_too: self.way_too[lane],
            missed_width: self.missed_width[lane],
            missed_since: AngleRange { start: Angle(self.since_start[lane]), width: self.since_width[lane] },
        }
    }

    /// [`Track::would_return`] of one cell.
    #[inline(always)]
    pub fn would_return(&self, lane: usize, range: u16) -> bool {
        would_return([self.visible.ends[0][lane], self.visible.ends[1][lane]], range)
    }

    /// How wide the range is that one cell is visible from, and that it was missed from.
    pub fn widths(&self, lane: usize) -> [u16; 2] {
        [self.visible.width[lane], self.missed_width[lane]]
    }

    /// Puts one cell's part in.
    pub fn set(&mut self, lane: usize, track: Track) {
        self.place[lane] = track.place;
        self.run[lane] = track.run as u16;
        self.sector.set(lane, track.sector);
        self.missed_scans[lane] = track.missed_scans;
        self.visible.set(lane, track.visible);
        self.way[lane] = track.way;
        self.visible_too.set(lane, track.visible_too);
        self.way_too[lane] = track.way_too;
        self.missed_width[lane] = track.missed_width;
        self.since_start[lane] = track.missed_since.start.0;
        self.since_width[lane] = track.missed_since.width;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{angle::units, cell::Returns};

    const RULE: Rule = Rule {
        contradiction: 5,
        cap: 30,
        half_beam: 23,
        drift_least: 0.002,
        drift_rate: 0.03,
        drift_most: 0.06,
        silent_scans: 20,
        outshone: true,
        two_ranges: true,
        apart: true,
    };

    struct Drive {
        cell: Returns,
        track: Track,
        way: f32,
    }

    impl Drive {
        fn look(&self, degrees: f64) -> Look {
            Look { angle: Angle::from_rad(degrees.to_radians()), range: distance_units(3.0), way: self.way }
        }

        fn new(degrees: f64) -> Drive {
            let mut drive = Drive { cell: Returns::new([0, 0], false), track: Track::default(), way: 0.0 };
            drive.track = Track::new(0, &drive.look(degrees));
            drive
        }

        /// One scan; returns whether the cell was contradicted.
        fn scan(&mut self, degrees: f64, seen: bool) -> bool {
            let look = self.look(degrees);
            let observation = if seen { Observation::Seen } else { Observation::Missed };
            self.cell.occupancy += u8::from(seen);
            let event = self.track.record(observation, &look, 1, &RULE, &self.cell);
            self.cell.record(event, 1, &RULE);
            matches!(event, Event::Contradiction { .. })
        }

        /// Looks from `from` to `to` degrees in steps of one, 5 cm of way each.
        fn pass(&mut self, from: i32, to: i32, seen: std::ops::RangeInclusive<i32>) -> u32 {
            let mut contradictions = 0;
            let step = (to - from).signum();
            let mut degrees = from;
            while degrees != to + step {
                self.way += 0.05;
                contradictions += u32::from(self.scan(f64::from(degrees), seen.contains(&degrees)));
                degrees += step;
            }
            self.track.end_run();
            contradictions
        }
    }

    #[test]
    fn a_contradiction_takes_as_much_as_the_scans_that_it_stands_for_may_have_added() {
        let left = |scans: u16| {
            let mut cell = Returns { occupancy: 30, ..Returns::new([0, 0], false) };
            cell.record(Event::Contradiction { may_be_outshone: false }, scans, &RULE);
            cell.occupancy
        };
        assert_eq!([1, 4, 6, u16::MAX].map(left), [25, 10, 0, 0]);
    }

    #[test]
    fn what_glints_is_not_contradicted_from_afar_but_where_it_would_glint() {
        let left = |glints: u8, seen_from: f32, missed: std::ops::Range<i32>, missed_from: f32| {
            let look = |degrees: f64, range: f32| Look {
                angle: Angle::from_rad(degrees.to_radians()),
                range: distance_units(range),
                way: 0.0,
            };
            let mut cell = Returns { occupancy: 30, glints, hits: 60, ..Returns::new([0, 0], false) };
            let mut track = Track::new(0, &look(-5.0, seen_from));
            for degrees in -4..=5 {
                track.record(Observation::Seen, &look(degrees.into(), seen_from), 1, &RULE, &cell);
            }
            for degrees in missed {
                let look = look(degrees.into(), missed_from);
                let event = track.record(Observation::Missed, &look, 1, &RULE, &cell);
                cell.record(event, 1, &RULE);
            }
            cell.occupancy
        };
        assert_eq!(left(9, 2.0, 2..6, 6.0), 30, "a wall behind the pane outshines its dust");
        assert!(left(9, 2.0, 2..6, 2.1) < 30, "not from as near as before");
        assert!(left(9, 2.0, -3..6, 6.0) < 30, "nor its glint");
        assert!(left(0, 2.0, 2..6, 6.0) < 30, "somebody has gone");
        assert!(left(1, 2.0, 2..6, 6.0) < 30, "a random reading");
    }

    #[test]
    fn a_pane_seen_near_its_normal_survives_every_other_view() {
        let mut drive = Drive::new(0.0);
        assert_eq!(drive.pass(0, 40, 0..=2), 0);
        assert_eq!(drive.pass(-40, 40, -1..=2), 0);
        assert_eq!(drive.cell.occupancy, 7);
        assert!(u32::from(drive.track.missed_width) >= units(37f64.to_radians()));
    }

    #[test]
    fn what_is_missed_to_the_end_counts_from_when_it_was_last_seen() {
        let mut drive = Drive::new(0.0);
        let angle = |degrees: f64| Angle::from_rad(degrees.to_radians());
        let range =
            |from: f64, to: f64| AngleRange { start: angle(from), width: angle(to).0 - angle(from).0 };
        drive.pass(0, 40, 0..=2);
        assert_eq!(drive.track.missed_since, range(3.0, 40.0));
        drive.pass(0, 1, 0..=1);
        assert_eq!(drive.track.missed_since.width, 0);
        drive.pass(41, 10, 0..=0);
        assert_eq!(drive.track.missed_since, range(10.0, 41.0), "narrower than before");
        drive.pass(10, 20, 0..=0);
        assert_eq!(drive.track.missed_since, range(10.0, 41.0), "the widest");
        assert_eq!(drive.track.missed_width, range(3.0, 40.0).width, "of all");
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
            assert_eq!(drive.scan(10.0, seen), !seen);
        }
        assert_eq!(drive.cell.occupancy, 0);
    }

    #[test]
    fn lost_scans_end_a_run() {
        let mut drive = Drive::new(0.0);
        for degrees in [0.0, 1.0, 2.0] {
            drive.scan(degrees, true);
        }
        drive.track.end_run();
        drive.scan(10.0, true);
        assert_eq!(u32::from(drive.track.visible.range.width), units(2f64.to_radians()));
    }

    #[test]
    fn what_was_hidden_meanwhile_was_not_missed() {
        let mut drive = Drive::new(0.0);
        drive.pass(0, 2, 0..=2);
        for degrees in -30i32..30 {
            if degrees.rem_euclid(2) != 0 && !(-4..=6).contains(&degrees) {
                assert!(!drive.scan(f64::from(degrees), false));
            } else {
                drive.track.record(
                    Observation::Hidden,
                    &drive.look(f64::from(degrees)),
                    1,
                    &RULE,
                    &drive.cell,
                );
            }
        }
        assert!(drive.track.missed_width <= 1);
    }

    #[test]
    fn a_second_side_is_kept_apart() {
        let mut drive = Drive::new(0.0);
        drive.pass(0, 4, 0..=4);
        drive.pass(170, 173, 170..=173);
        assert_eq!(u32::from(drive.track.visible.range.width), units(4f64.to_radians()));
        assert_eq!(u32::from(drive.track.visible_too.range.width), units(3f64.to_radians()));
        assert!(drive.pass(150, 200, 0..=0) >= 2, "gone from the second side as well");
    }

    #[test]
    fn of_two_things_in_a_cell_the_one_that_has_gone_is_forgotten() {
        let seen = |was_crossed: bool| {
            let mut drive = Drive::new(0.0);
            drive.cell.was_crossed = was_crossed;
            drive.pass(0, 4, 0..=4);
            drive.pass(60, 63, 60..=63);
            drive
        };
        let mut pane = seen(true);
        let [first, second] = [pane.track.visible, pane.track.visible_too];
        assert_eq!(pane.pass(50, 80, 0..=0), 0);
        assert_eq!([pane.track.visible, pane.track.visible_too], [first, Sector::default()], "the narrower");
        assert!(pane.pass(-10, 10, 99..=99) >= 2, "then the other");
        let mut pane = seen(true);
        assert_eq!(pane.pass(-10, 10, 99..=99), 0);
        assert_eq!([pane.track.visible, pane.track.visible_too], [second, Sector::default()], "the wider");
        assert!(seen(false).pass(50, 80, 0..=0) >= 2, "a door is one thing");
        let both = seen(true).pass(-10, 80, 99..=99);
        assert!(both >= 2, "missed over both");
    }

    #[test]
    fn a_pane_may_share_its_cell_and_what_is_diffuse_does_not() {
        let may_be_two = |was_crossed: bool, octaves: Option<f32>, glints: u8| {
            let mut returns = Returns { glints, hits: 9, ..Returns::new([0, 0], was_crossed) };
            octaves.into_iter().for_each(|octaves| returns.record_brightness(octaves));
            returns.may_be_two()
        };
        assert!(may_be_two(true, None, 0), "without intensities");
        assert!(!may_be_two(false, None, 0), "it stood there before a beam had crossed the cell");
        assert!(!may_be_two(true, Some(-1.0), 0), "somebody");
        assert!(may_be_two(true, Some(-2.5), 0), "a pane that leans");
        assert!(may_be_two(true, Some(1.0), 2), "one that glints");
    }
}
