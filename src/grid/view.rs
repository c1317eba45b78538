//! What a scan says of a cell: seen, missed, hidden, or nothing that is sure.
//!
//! No ray is walked. The scan is kept as a table from bearing to range, with the nearest return of every
//! window of beams looked up in two steps, and a cell is compared with the beams that cross it.
//!
//! [`View::sight`] and [`View::observe`] say it of one cell. [`View::sights`] does the first for all cells
//! of a tile, in a loop without branches, and leaves out those that are surely hidden.

use super::{
    angle::{Angle, atan2, nearest},
    sweep::Sweep,
    tiles::SIDE,
};
use nalgebra::{Point2, Vector2};

/// What is known of the errors of ranges and poses, as far as it decides on a cell.
#[derive(Clone, Copy, Debug)]
pub struct Tolerance {
    /// Side of a cell (m).
    pub resolution: f64,
    /// A return within this of the cell's centre, along the beam, is of the cell (m).
    pub along: f64,
    /// How far the cell may lie beside where it was mapped (m).
    pub across: f64,
    /// How far the scan may be turned (rad).
    pub heading: f64,
}

/// What a scan says of a cell (paper IV-B).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Observation {
    /// A return came from it.
    Seen,
    /// All beams that could have met it went past.
    Missed,
    /// The same, but some of them returned nothing at all, so that it takes more of them to be sure.
    Silent,
    /// Something nearer returned, or the beam says nothing this far out.
    Hidden,
    /// Too near to the outline of the scan to tell.
    Unsure,
}

/// A cell as the sensor sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sight {
    /// Distance (m).
    pub range: f32,
    /// Bearing in beams: 0 at the first beam.
    pub beam: f32,
    /// Bearing of the sensor seen from the cell.
    pub angle: Angle,
}

/// Widest window of beams for which tables are kept: 2^LEVELS. Wider ones, of cells nearer than some
/// 10 cm, are cut to it.
const LEVELS: usize = 7;
/// Level of the tables from which [`View::around`] is made.
const AROUND: usize = 3;
/// Beams to either side that are looked at there: two windows that share the beam in the middle.
const AROUND_BEAMS: usize = (1 << AROUND) - 1;
/// The same for the beams that cross a cell, of which there are fewer than of those that may do.
const NARROW: usize = 2;
const NARROW_BEAMS: usize = (1 << NARROW) - 1;
/// Whatever differs by less is the same distance (m); rounding errors are far below.
const HAIR: f32 = 0.001;

/// How a scan turns places into bearings and ranges, in numbers: small enough to stay in registers.
#[derive(Clone, Copy, Debug, Default)]
struct Lens {
    first_bearing: f32,
    beams_per_rad: f32,
    /// The sensor's way from a beam to the next (m).
    shift: [f32; 2],
    /// Number of the last beam.
    last: f32,
    /// Beams of a full turn, and one over it.
    turn: f32,
    per_turn: f32,
    /// In the middle of what the scanner does not see, where bearings are cut.
    cut: f32,
}

impl Lens {
    /// What stands at (dx, dy) from the sensor's place in the middle of the scan (m).
    #[inline(always)]
    fn sight(&self, dx: f32, dy: f32) -> Sight {
        let range = (dx * dx + dy * dy).max(1e-6).sqrt();
        let bearing = atan2(dy, dx);
        let beam = self.wrap((bearing - self.first_bearing) * self.beams_per_rad);
        // To the first order, how the sensor's place at that beam differs from the one in the middle.
        let moved = beam.clamp(0.0, self.last) - self.last / 2.0;
        let (ox, oy) = (self.shift[0] * moved, self.shift[1] * moved);
        let inverse = 1.0 / range;
        let turned = (dy * ox - dx * oy) * inverse * inverse;
        Sight {
            range: range - (dx * ox + dy * oy) * inverse,
            beam: self.wrap(beam + turned * self.beams_per_rad),
            angle: Angle::from_bearing(bearing + turned + std::f32::consts::PI),
        }
    }

    #[inline(always)]
    fn wrap(&self, beam: f32) -> f32 {
        // The whole turns since the cut, rounded down.
        beam - nearest((beam - self.cut) * self.per_turn - 0.5) * self.turn
    }

    /// Whether a beam passes there.
    #[inline(always)]
    fn sees(&self, beam: f32) -> bool {
        beam > -0.5 && beam < self.last + 0.5
    }
}

/// Cells of a tile as the sensor sees them.
#[derive(Clone, Debug)]
pub struct Sights {
    range: Box<[f32; CELLS]>,
    beam: Box<[f32; CELLS]>,
    angle: Box<[Angle; CELLS]>,
    /// Numbers of the cells that are worth a look.
    worth: Box<[u16; CELLS]>,
}

const CELLS: usize = (SIDE * SIDE) as usize;

impl Default for Sights {
    fn default() -> Self {
        Sights {
            range: Box::new([0.0; CELLS]),
            beam: Box::new([0.0; CELLS]),
            angle: Box::new([Angle::default(); CELLS]),
            worth: Box::new([0; CELLS]),
        }
    }
}

impl Sights {
    /// The sight of a cell, by its number in the tile.
    #[inline(always)]
    pub fn at(&self, number: usize) -> Sight {
        Sight { range: self.range[number], beam: self.beam[number], angle: self.angle[number] }
    }

    /// Number of the `n`th cell that is worth a look.
    #[inline(always)]
    pub fn worth(&self, n: usize) -> usize {
        self.worth[n].into()
    }
}

/// Place of a cell in its tile: 64 times its row, plus its column. The highest bit marks cells that were hit.
pub type Place = u16;
/// See [`Place`].
pub const HIT: Place = 1 << 15;

/// A beam and those within [`AROUND_BEAMS`] to both sides; all less or more than true by a [`HAIR`], to be on the safe side.
#[derive(Clone, Copy, Debug, Default)]
struct Around {
    /// What the beam itself returned (m), NaN without.
    returned: f32,
    /// How far it is itself known to be free (m).
    itself_clear: f32,
    /// The same if it had met nothing where it returned nothing.
    itself_empty: f32,
    /// All are known to be free up to here (m).
    clear: f32,
    /// The same if beams without return had met nothing however far.
    empty: f32,
    /// None of those within [`NARROW_BEAMS`] returned from beyond this (m).
    peak: f32,
    /// The same, and the beam itself says nothing beyond it.
    hides: f32,
}

/// One scan, ready to be compared with cells.
#[derive(Debug, Default)]
pub struct View {
    middle: [f64; 2],
    lens: Lens,
    /// How far the sensor moved in the scan (m).
    moved: f64,
    count: usize,
    /// Origin and direction of each beam.
    beams: Vec<(Point2<f64>, Vector2<f64>)>,
    /// Range of what returned (m), NaN where nothing did.
    returned: Vec<f32>,
    /// `clear[level][k]`: how far the beams k..k+2^level are all known to be free (m).
    clear: [Vec<f32>; LEVELS + 1],
    /// The same if beams without return had met nothing however far.
    empty: [Vec<f32>; LEVELS + 1],
    /// `reach[level][k]`: how far any of these beams says something (m).
    reach: [Vec<f32>; LEVELS + 1],
    /// `peak[level][k]`: the farthest return of the beams k..k+2^level (m), 0 without.
    peak: [Vec<f32>; NARROW + 1],
    /// What the beams around each beam have in common: nearly all cells lie well before or well behind it.
    around: Vec<Around>,
    /// From this distance on, `around` covers all beams that matter to a cell (m).
    around_from: f32,
    farthest: f32,
}

impl View {
    /// Takes over a scan. `far` is the longest distance that counts as a measurement (m).
    #[inline(always)]
    pub fn load(&mut self, sweep: &Sweep, far: f64, tolerance: &Tolerance) {
        self.middle = [sweep.middle().x, sweep.middle().y];
        self.count = sweep.len();
        self.moved = (sweep.end.translation.vector - sweep.start.translation.vector).norm();
        let (shift, beams_per_rad) = (sweep.shift(), (1.0 / sweep.bearing_step()) as f32);
        let turn = (std::f32::consts::TAU * beams_per_rad).abs();
        self.lens = Lens {
            first_bearing: sweep.first_bearing() as f32,
            beams_per_rad,
            shift: [shift.x as f32, shift.y as f32],
            last: self.count as f32 - 1.0,
            turn,
            per_turn: 1.0 / turn,
            cut: (self.count as f32 - turn) / 2.0,
        };
        self.beams.clear();
        self.beams.extend(sweep.beams());
        self.returned.clear();
        self.clear[0].clear();
        self.empty[0].clear();
        for &range in &sweep.scan.ranges {
            let valid = range.is_finite() && range <= far as f32;
            self.returned.push(if valid { range } else { f32::NAN });
            let (clear, empty) = if valid {
                (range, range)
            } else if range == f32::INFINITY || range > far as f32 {
                (0.0, far as f32)
            } else {
                (0.0, 0.0)
            };
            self.clear[0].push(clear);
            self.empty[0].push(empty);
        }
        self.reach[0].clone_from(&self.empty[0]);
        self.farthest = self.reach[0].iter().copied().fold(0.0, greater);
        double(&mut self.clear, lesser);
        double(&mut self.empty, lesser);
        double(&mut self.reach, greater);
        self.peak[0].clone_from(&self.clear[0]);
        double(&mut self.peak, greater);
        self.look_around(tolerance);
    }

    #[inline(always)]
    fn look_around(&mut self, tolerance: &Tolerance) {
        // Of the beams within `around`, those that are not taken up by the heading's error.
        let per_rad = self.lens.beams_per_rad.abs();
        let beams = AROUND_BEAMS as f32 - tolerance.heading as f32 * per_rad;
        let half_cell = tolerance.resolution as f32 / 2.0;
        let from = (half_cell + tolerance.across as f32) * per_rad / beams;
        self.around_from = from.max(half_cell * per_rad / NARROW_BEAMS as f32) + HAIR;
        self.around.clear();
        if self.count <= AROUND_BEAMS || beams <= 0.0 {
            self.around_from = f32::INFINITY;
            let beams = self.returned.iter().map(|&returned| Around { returned, ..Around::default() });
            self.around.extend(beams);
            return;
        }
        let both = |table: &[f32], beam: usize, beams: usize| {
            let last = table.len() - 1;
            [table[beam.saturating_sub(beams).min(last)], table[beam.min(last)]]
        };
        let (clear, empty, peak) = (&self.clear[AROUND], &self.empty[AROUND], &self.peak[NARROW]);
        self.around.extend((0..self.count).map(|beam| {
            let itself = self.empty[0][beam];
            let [a, b] = both(clear, beam, AROUND_BEAMS);
            let [c, d] = both(empty, beam, AROUND_BEAMS);
            let [e, f] = both(peak, beam, NARROW_BEAMS);
            Around {
                returned: self.returned[beam],
                itself_clear: self.clear[0][beam],
                itself_empty: itself,
                clear: lesser(a, b) - HAIR,
                empty: lesser(c, d) - HAIR,
                peak: greater(e, f) + HAIR,
                hides: greater(itself, greater(e, f)) + HAIR,
            }
        }));
    }

    /// Origin (m) and direction (unit vector) of every beam in the map's frame, in the scan's order.
    pub fn beams(&self) -> &[(Point2<f64>, Vector2<f64>)] {
        &self.beams
    }

    /// The longest distance of which the scan says something (m).
    pub fn farthest(&self) -> f32 {
        self.farthest
    }

    /// How far each beam and both beside it are known to be free (m); `silent`, where they returned nothing. A
    /// beam that alone goes far is a random reading, or slipped through where nothing else can.
    pub fn free_ranges(&self, silent: f32) -> impl Iterator<Item = f32> {
        let free = move |beam: usize| {
            let (clear, empty) = (self.clear[0][beam], self.empty[0][beam]);
            if clear < empty { silent } else { clear }
        };
        let last = self.clear[0].len().saturating_sub(1);
        (0..self.clear[0].len())
            .map(move |beam| free(beam.saturating_sub(1)).min(free(beam)).min(free((beam + 1).min(last))))
    }

    /// Where the sensor was in the middle of the scan (m).
    pub fn middle(&self) -> [f64; 2] {
        self.middle
    }

    /// What stands at (dx, dy) from [`View::middle`] (m), as seen by the beam that passes nearest to it; `None` outside the
    /// field of view.
    #[inline(always)]
    pub fn sight(&self, dx: f32, dy: f32) -> Option<Sight> {
        let sight = self.lens.sight(dx, dy);
        self.lens.sees(sight.beam).then_some(sight)
    }

    /// The sights of the cells at these places of a tile, and how many of them are worth a look: hit, or within the field of
    /// view and not surely hidden. `corner`: the middle of the tile's first cell, seen from [`View::middle`] (m).
    #[inline(always)]
    pub fn sights(
        &self,
        corner: [f32; 2],
        places: &[Place],
        tolerance: &Tolerance,
        sights: &mut Sights,
    ) -> usize {
        let (lens, resolution, along) = (self.lens, tolerance.resolution as f32, tolerance.along as f32);
        let count = places.len().min(CELLS);
        let (ranges, beams) = (&mut sights.range[..count], &mut sights.beam[..count]);
        let angles = &mut sights.angle[..count];
        for (((place, range), beam), angle) in places.iter().zip(&mut *ranges).zip(&mut *beams).zip(angles) {
            let sight = lens.sight(
                corner[0] + f32::from(place & 63) * resolution,
                corner[1] + f32::from(place >> 6 & 63) * resolution,
            );
            (*range, *beam, *angle) = (sight.range, sight.beam, sight.angle);
        }
        let mut worth = 0;
        for (number, ((place, &range), &beam)) in places.iter().zip(&*ranges).zip(&*beams).enumerate() {
            let hidden = range >= self.around_from && self.around[self.nearest(beam)].hides < range - along;
            // Written in any case, counted if it shall stay: a branch here would be guessed wrong every other time.
            sights.worth[worth] = number as u16;
            worth += usize::from(lens.sees(beam) & (!hidden | (place & HIT != 0)));
        }
        worth
    }

    /// Whether the scan says nothing of any cell whose centre lies in the disc around (dx, dy) from [`View::middle`] (m).
    #[inline(always)]
    pub fn is_out_of_reach(&self, dx: f32, dy: f32, radius: f32, tolerance: &Tolerance) -> bool {
        let (along, moved) = (tolerance.along as f32, self.moved as f32);
        let square = dx * dx + dy * dy;
        let beyond = self.farthest + along + radius + moved + HAIR;
        if square > beyond * beyond {
            return true;
        }
        let distance = square.sqrt();
        let nearest = distance - radius - moved - HAIR;
        if nearest <= radius {
            return false;
        }
        // The disc's width, from above, and margins for the motion within the scan and for the heading.
        let sine = radius / distance;
        let half = sine + 0.571 * sine * sine * sine + moved / nearest + tolerance.heading as f32 + 0.02;
        let beam = self.lens.sight(dx, dy).beam;
        if self.lens.sees(beam) {
            return self.reach_between(beam, half) + along < nearest;
        }
        // The gap between the last beam and the first one after a turn.
        let (beam, half) =
            (if beam < 0.0 { beam + self.lens.turn } else { beam }, half * self.lens.beams_per_rad.abs());
        beam - half > self.lens.last + 1.0 && beam + half < self.lens.turn - 1.0
    }

    /// What the scan says of the cell with this sight (paper IV-B; the margins are in [`Tolerance`]).
    ///
    /// `would_return`: from this far, the cell is known to return something.
    #[inline(always)]
    pub fn observe(&self, sight: &Sight, would_return: bool, tolerance: &Tolerance) -> Observation {
        let (range, along) = (sight.range, tolerance.along as f32);
        let around = &self.around[self.nearest(sight.beam)];
        if (around.returned - range).abs() <= along {
            return Observation::Seen;
        }
        if range >= self.around_from {
            if around.clear > range + along {
                return Observation::Missed;
            }
            if around.itself_clear < range - along {
                // The nearest beam alone shows that the cell is not missed, and if it is not hidden it is silent or seen.
                if would_return & (around.empty > range + along) {
                    return Observation::Silent;
                }
                let silent = would_return & (around.itself_empty > range + along);
                let seen = around.peak >= range - along;
                if !silent & !seen {
                    return Observation::Hidden;
                }
            }
        }
        self.observe_closely(sight, would_return, tolerance)
    }

    /// The same without the shortcut.
    #[inline(always)]
    pub(super) fn observe_closely(
        &self,
        sight: &Sight,
        would_return: bool,
        tolerance: &Tolerance,
    ) -> Observation {
        let (range, along) = (sight.range, tolerance.along as f32);
        let is_of_cell = |returned: &f32| (returned - range).abs() <= along;
        if is_of_cell(&self.returned[self.nearest(sight.beam)]) {
            return Observation::Seen;
        }
        let half_cell = tolerance.resolution as f32 / 2.0;
        let half_wide = (half_cell + tolerance.across as f32) / range + tolerance.heading as f32;
        let wide = self.window(sight.beam, half_wide);
        if lookup(&self.clear, wide, lesser) > range + along {
            return Observation::Missed;
        }
        if would_return && lookup(&self.empty, wide, lesser) > range + along {
            return Observation::Silent;
        }
        let window = self.window(sight.beam, half_cell / range);
        if self.returned[window.0..window.1].iter().any(is_of_cell) {
            Observation::Seen
        } else if lookup(&self.clear, window, lesser) < range - along {
            Observation::Hidden
        } else {
            Observation::Unsure
        }
    }

    /// How far the beams between two bearings (in beams, any order) say anything (m).
    pub fn reach_between(&self, beam: f32, half: f32) -> f32 {
        let window = self.window(beam, half);
        if window.1 - window.0 > 1 << (LEVELS + 1) {
            self.farthest
        } else {
            lookup(&self.reach, window, greater)
        }
    }

    /// The beams within `half` (rad) of a bearing: at least the nearest.
    #[inline(always)]
    fn window(&self, beam: f32, half: f32) -> (usize, usize) {
        let half = half * self.lens.beams_per_rad.abs();
        let nearest = self.nearest(beam);
        // Rounded up and down by hand: without SSE4.1, `ceil` and `floor` are calls.
        let from = (beam - half).max(0.0);
        let low = from as i32 as usize;
        let low = (low + usize::from((low as i32 as f32) < from)).min(nearest);
        let high = ((beam + half).max(0.0) as i32 as usize).clamp(nearest, self.count - 1);
        (low, high + 1)
    }

    /// The beam that passes nearest.
    #[inline(always)]
    fn nearest(&self, beam: f32) -> usize {
        ((beam + 0.5).max(0.0) as i32 as usize).min(self.count - 1)
    }
}

/// `f32::min` of numbers that are numbers, in one instruction.
#[inline(always)]
fn lesser(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// `f32::max` of numbers that are numbers, in one instruction.
#[inline(always)]
fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Fills each level from the one before: a window of twice as many beams.
#[inline(always)]
fn double(table: &mut [Vec<f32>], choose: impl Fn(f32, f32) -> f32) {
    for level in 1..table.len() {
        let (below, above) = table.split_at_mut(level);
        let (below, width) = (&below[level - 1], 1 << (level - 1));
        let shifted = below.get(width..).unwrap_or(&[]);
        above[0].resize(shifted.len(), 0.0);
        for ((chosen, &a), &b) in above[0].iter_mut().zip(below).zip(shifted) {
            *chosen = choose(a, b);
        }
    }
}

/// The chosen value over a window, by the two tabulated windows that cover it.
#[inline(always)]
fn lookup(
    table: &[Vec<f32>; LEVELS + 1],
    (low, high): (usize, usize),
    choose: impl Fn(f32, f32) -> f32,
) -> f32 {
    let level = ((high - low).ilog2() as usize).min(LEVELS);
    let width = 1 << level;
    choose(table[level][low], table[level][high - width])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{grid::sweep::tests::half_circle, pose::pose};
    use proptest::prelude::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    const TOLERANCE: Tolerance = Tolerance { resolution: 0.05, along: 0.07, across: 0.02, heading: 0.0035 };

    fn view(ranges: Vec<f32>) -> View {
        let scan = half_circle(0, ranges);
        let mut view = View::default();
        view.load(
            &Sweep { scan: &scan, start: pose(0.0, 0.0, 0.0), end: pose(0.0, 0.0, 0.0) },
            30.0,
            &TOLERANCE,
        );
        view
    }

    fn observe(view: &View, x: f32, y: f32) -> Option<Observation> {
        view.sight(x, y).map(|sight| view.observe(&sight, sight.range < 12.0, &TOLERANCE))
    }

    #[test]
    fn the_four_cases() {
        let view = view(vec![4.0; 721]);
        assert_eq!(observe(&view, 2.0, 0.0), Some(Observation::Missed));
        assert_eq!(observe(&view, 4.05, 0.0), Some(Observation::Seen));
        assert_eq!(observe(&view, 5.0, 0.0), Some(Observation::Hidden));
        assert_eq!(observe(&view, -1.0, 0.0), None, "behind the sensor");
    }

    #[test]
    fn beside_an_edge_nothing_is_sure() {
        // A post of one beam, 3 m ahead; the cell stands 5 cm beside it.
        let mut ranges = vec![8.0; 721];
        ranges[360] = 3.0;
        let view = view(ranges);
        assert_eq!(observe(&view, 3.0, 0.05), Some(Observation::Unsure));
        assert_eq!(observe(&view, 3.0, 0.5), Some(Observation::Missed));
    }

    #[test]
    fn a_beam_without_return_is_no_sure_miss() {
        let view = view(vec![f32::INFINITY; 721]);
        assert_eq!(observe(&view, 10.0, 0.0), Some(Observation::Silent), "what would return from there");
        assert_eq!(observe(&view, 15.0, 0.0), Some(Observation::Hidden), "what would perhaps not");
    }

    #[test]
    fn an_invalid_beam_says_nothing() {
        for code in [f32::NAN, f32::NEG_INFINITY] {
            assert_eq!(observe(&self::view(vec![code; 721]), 2.0, 0.0), Some(Observation::Hidden));
        }
    }

    #[test]
    fn a_moving_sensor_sees_with_the_beam_that_fired_from_there() {
        let scan = half_circle(0, vec![10.0; 181]);
        let sweep = Sweep { scan: &scan, start: pose(0.0, 0.0, 0.0), end: pose(0.04, 0.02, 0.05) };
        let mut view = View::default();
        view.load(&sweep, 30.0, &TOLERANCE);
        for (number, (origin, direction)) in sweep.beams().enumerate() {
            let point = origin + direction * 2.0;
            let [dx, dy] = [point.x - view.middle[0], point.y - view.middle[1]];
            let sight = view.sight(dx as f32, dy as f32).unwrap();
            assert!((sight.beam - number as f32).abs() < 0.05, "{number}: {sight:?}");
            assert!((sight.range - 2.0).abs() < 0.001, "{number}: {sight:?}");
        }
    }

    proptest! {
        #[test]
        fn the_tables_give_what_the_beams_say(ranges in proptest::collection::vec(0.1f32..20.0, 200..400), at in 0.0f32..1.0, half in 0.0f32..1.2) {
            let count = ranges.len();
            let view = view(ranges.clone());
            let beam = at * (count - 1) as f32;
            let (low, high) = view.window(beam, half);
            prop_assume!(high - low <= 1 << (LEVELS + 1));
            let expected = ranges[low..high].iter().copied().fold(f32::MAX, lesser);
            prop_assert_eq!(lookup(&view.clear, (low, high), lesser), expected);
            let expected = ranges[low..high].iter().copied().fold(0.0, f32::max);
            prop_assert_eq!(view.reach_between(beam, half), expected);
        }

        #[test]
        fn sights_are_bearings_and_distances(x in -5.0f64..5.0, y in -5.0f64..5.0) {
            prop_assume!(x.hypot(y) > 0.2);
            let view = view(vec![10.0; 721]);
            let inside = y.atan2(x).abs() < FRAC_PI_2 + PI / 1440.0;
            if let Some(sight) = view.sight(x as f32, y as f32) {
                prop_assert!(inside);
                prop_assert!((f64::from(sight.range) - x.hypot(y)).abs() < 1e-4);
                prop_assert!(sight.angle.distance(Angle::from_rad((-y).atan2(-x))) <= 1);
            } else {
                prop_assert!(y.atan2(x).abs() > FRAC_PI_2 - PI / 1440.0);
            }
        }
    }
}
