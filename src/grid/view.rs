//! What a scan says of a cell: seen, missed, hidden, or nothing that is sure.
//!
//! No ray is walked. The scan is kept as a table: for each beam, the nearest and the farthest return of the beams that cross a
//! cell there. How many these are depends on how far the cell is, so there is such a table for each of some bands of distance,
//! and a cell is compared with a single entry of one of them.

use super::{
    angle::{Angle, atan, in_circle, nearest, whole},
    lanes::Path,
    sweep::Sweep,
    tiles::{SIDE, TileIndex},
    track::UNITS_PER_M,
};

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
    /// Distance ([`UNITS_PER_M`]), at least 1.
    pub range: u16,
    /// The beam that passes nearest.
    pub beam: u16,
    /// Bearing of the sensor seen from the cell.
    pub angle: Angle,
    /// Whether it is in the field of view.
    pub is_in_view: bool,
}

/// Levels of windows of beams: the widest is 2^LEVELS beams.
const LEVELS: usize = 6;
/// Beams without meaning at both ends of a scan, so that windows need not be cut there.
const PAD: usize = 1 << LEVELS;
/// Most bands of distance.
pub(super) const BANDS: usize = 12;
/// Longest distance that there is ([`UNITS_PER_M`]): what returned nothing.
pub(super) const FARTHEST: i16 = i16::MAX;

/// How a scan turns places into bearings and ranges, in numbers: small enough to stay in registers.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lens {
    pub first_bearing: f32,
    pub beams_per_rad: f32,
    /// The sensor's way from a beam to the next (m).
    pub shift: [f32; 2],
    /// Number of the last beam.
    pub last: f32,
    /// Beams of a full turn, and one over it.
    pub turn: f32,
    pub per_turn: f32,
    /// In the middle of what the scanner does not see, where bearings are cut.
    pub cut: f32,
}

impl Lens {
    /// What stands at (dx, dy) from the sensor's place in the middle of the scan (m). `lanes` does the same, in the same
    /// steps.
    #[inline(always)]
    pub fn sight(&self, dx: f32, dy: f32) -> Sight {
        let (across, along) = (dy.abs(), dx.abs());
        let steep = across > along;
        let (less, more) = if steep { (along, across) } else { (across, along) };
        let inverse = 1.0 / greater(more, LEAST_DISTANCE);
        let ratio = less * inverse;
        let square = ratio * ratio;
        let middle_range = more * (1.0 + square).sqrt();
        let bearing = in_circle(atan(ratio, square), steep, dy, dx);
        let beam = self.beam(bearing);
        // To the first order, how the sensor's place at that beam differs from the one in the middle.
        let moved = lesser(greater(beam, 0.0), self.last) - self.last * 0.5;
        let (ox, oy) = (self.shift[0] * moved, self.shift[1] * moved);
        // One over the square of the range, to within a hundredth: it is multiplied with centimetres.
        let inverse_square = inverse * inverse * (INVERSE[0] + square * (INVERSE[1] + square * INVERSE[2]));
        let turned = (dy * ox - dx * oy) * inverse_square;
        let range = middle_range - (dx * ox + dy * oy) * inverse_square * middle_range;
        let beam = beam + turned * self.beams_per_rad;
        Sight {
            range: whole(range * UNITS_PER_M).clamp(1, i32::from(FARTHEST)) as u16,
            beam: whole(beam).clamp(0, self.last as i32) as u16,
            angle: Angle::from_bearing(bearing + turned + std::f32::consts::PI),
            is_in_view: beam > -0.5 && beam < self.last + 0.5,
        }
    }

    /// A bearing in beams.
    #[inline(always)]
    pub fn beam(&self, bearing: f32) -> f32 {
        let beam = (bearing - self.first_bearing) * self.beams_per_rad;
        // The whole turns since the cut, rounded down.
        beam - nearest((beam - self.cut) * self.per_turn - 0.5) * self.turn
    }
}

/// Least distance along an axis (m).
pub(super) const LEAST_DISTANCE: f32 = 1e-3;
/// 1 / (1 + s) for s in 0..1, as a polynomial of s: off by 0.008 at most.
pub(super) const INVERSE: [f32; 3] = [0.9926, -0.8284, 0.3431];

/// Place of a cell in its tile: 64 times its row, plus its column. Higher bits are marks.
pub type Place = u16;
/// Mark of a [`Place`]: this scan hit the cell.
pub const HIT: Place = 1 << 15;

/// What the beams that cross a cell have in common ([`UNITS_PER_M`]).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(8))]
pub(super) struct Crossing {
    /// What the middle one returned.
    pub returned: i16,
    /// How far all are known to be free: 0 where one says nothing.
    pub low: i16,
    /// The farthest return, 0 without.
    pub high: i16,
    /// How far all beams that may cross the cell, errors considered, are free if those without return met nothing; with
    /// [`SILENT`] if there are such.
    pub empty: i16,
}

/// What the crossings of a band are taken from, a number for each beam: its own return, 0 without, and those of two windows of beams that
/// together are around it.
pub(super) struct Around<'a> {
    pub own: &'a [i16],
    /// Of the narrow windows, how far all are known to be free, and the farthest return.
    pub low: [&'a [i16]; 2],
    pub high: [&'a [i16]; 2],
    /// Of the wide ones, how far all are known to be free, and how far if those without return met nothing.
    pub clear: [&'a [i16]; 2],
    pub empty: [&'a [i16]; 2],
}

impl<'a> Around<'a> {
    /// That of the beams from one on to before another: as many as are asked for, so that nothing need be checked beam by beam.
    #[inline(always)]
    pub fn between(&self, first: usize, end: usize) -> Self {
        let cut = |beams: &'a [i16]| &beams[first..end];
        let &Around { own, low: [low_a, low_b], high: [high_a, high_b], clear: [clear_a, clear_b], empty } =
            self;
        Around {
            own: cut(own),
            low: [cut(low_a), cut(low_b)],
            high: [cut(high_a), cut(high_b)],
            clear: [cut(clear_a), cut(clear_b)],
            empty: [cut(empty[0]), cut(empty[1])],
        }
    }

    /// Writes down what crosses a cell near this beam, number by number: put together, they would be a word of 64 bits, of which only
    /// two are worked out at a time. `lanes` does the same.
    #[inline(always)]
    pub fn cross(&self, beam: usize, crossing: &mut Crossing) {
        let Around { own, low, high, clear, empty } = self;
        let clear = clear[0][beam].min(clear[1][beam]);
        let empty = empty[0][beam].min(empty[1][beam]);
        crossing.returned = if own[beam] == 0 { FARTHEST } else { own[beam] };
        crossing.low = low[0][beam].min(low[1][beam]);
        crossing.high = high[0][beam].max(high[1][beam]);
        crossing.empty = if clear < empty { empty | SILENT } else { empty };
    }
}

/// See [`Crossing::empty`].
pub(super) const SILENT: i16 = i16::MIN;

/// Distances at which so many beams cross a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Band {
    /// Beams to either side of the nearest that cross a cell.
    narrow: usize,
    /// The same for those that may, errors considered.
    wide: usize,
}

/// One scan, ready to be compared with cells.
#[derive(Debug, Default)]
pub struct View {
    middle: [f64; 2],
    pub(super) lens: Lens,
    /// How far the sensor moved in the scan (m).
    moved: f64,
    pub(super) count: usize,
    /// `clear[level][k]`: how far the beams k..k+2^level are all known to be free ([`UNITS_PER_M`]). This and the next three have
    /// [`PAD`] beams more on either side.
    clear: [Vec<i16>; LEVELS + 1],
    /// The same if beams without return had met nothing however far.
    empty: [Vec<i16>; LEVELS + 1],
    /// `reach[level][k]`: how far any of these beams says something.
    reach: [Vec<i16>; LEVELS + 1],
    /// `peak[level][k]`: the farthest return of these beams, 0 without.
    peak: [Vec<i16>; LEVELS + 1],
    /// Band by band, what crosses a cell near each beam.
    pub(super) crossings: Vec<Crossing>,
    /// Cells nearer than this belong to the next band, or to one beyond ([`UNITS_PER_M`]).
    pub(super) nearer: [i16; BANDS],
    bands: [Band; BANDS],
    /// How many of the bands have their crossings: they are worked out when something stands near enough.
    known: usize,
    /// The last level that `clear`, `empty` and `peak` have of this scan.
    doubled: usize,
    pub(super) along: i16,
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
        let last = self.count as f32 - 1.0;
        self.lens = Lens {
            first_bearing: sweep.first_bearing() as f32,
            beams_per_rad,
            shift: [shift.x as f32, shift.y as f32],
            last,
            turn,
            per_turn: 1.0 / turn,
            cut: (last - turn) / 2.0,
        };
        self.along = (tolerance.along as f32 * UNITS_PER_M) as i16;
        self.load_ranges(&sweep.scan.ranges, far as f32);
        self.load_bands(tolerance);
    }

    #[inline(always)]
    fn load_ranges(&mut self, ranges: &[f32], far: f32) {
        let far_units = (far * UNITS_PER_M).min(f32::from(FARTHEST) - 1.0) as i16;
        let padded = ranges.len() + 2 * PAD;
        for (table, neutral) in [
            (&mut self.clear, FARTHEST),
            (&mut self.empty, FARTHEST),
            (&mut self.peak, 0),
            (&mut self.reach, 0),
        ] {
            table[0].clear();
            table[0].resize(padded, neutral);
        }
        let inside = PAD..PAD + ranges.len();
        let (clear, empty) = (&mut self.clear[0][inside.clone()], &mut self.empty[0][inside.clone()]);
        for ((&range, clear), empty) in ranges.iter().zip(&mut *clear).zip(&mut *empty) {
            // Neither is true of what is no number.
            let (is_return, is_far) = (range > 0.0 && range <= far, range > far);
            let units = whole(if is_return { range } else { 0.0 } * UNITS_PER_M) as i16;
            *clear = units;
            *empty = if is_far { far_units } else { units };
        }
        self.peak[0][inside.clone()].copy_from_slice(clear);
        self.reach[0][inside].copy_from_slice(empty);
        self.farthest = f32::from(empty.iter().copied().fold(0, i16::max)) / UNITS_PER_M;
        self.doubled = 0;
        (1..=LEVELS).for_each(|level| double(&mut self.reach, level, i16::max));
    }

    /// The bands.
    #[inline(always)]
    fn load_bands(&mut self, tolerance: &Tolerance) {
        let per_rad = self.lens.beams_per_rad.abs();
        let half_cell = tolerance.resolution as f32 / 2.0 * per_rad;
        let lateral = half_cell + tolerance.across as f32 * per_rad;
        let heading = tolerance.heading as f32 * per_rad;
        self.nearer = [0; BANDS];
        self.known = 0;
        // Those of each band that is known are written anew.
        self.crossings.resize(BANDS * self.count, Crossing::default());
        let (mut wide, mut farther) =
            ((lateral / f32::from(FARTHEST) * UNITS_PER_M + heading + 0.5) as usize, 0.0);
        for band in 0..BANDS {
            let is_last = band == BANDS - 1 || wide >= PAD - 1;
            wide = wide.min(PAD - 1);
            // From here on, so many beams and no more are within the margins.
            let nearest = lateral / (wide as f32 + 0.5 - heading).max(0.25);
            // Half as many in the middle of the band as at both of its ends together.
            let narrow = (half_cell / nearest + farther) / 2.0;
            farther = half_cell / nearest;
            self.bands[band] = Band { narrow: (narrow as usize).min(wide), wide };
            if is_last {
                return;
            }
            self.nearer[band] = (nearest * UNITS_PER_M).min(f32::from(FARTHEST)) as i16;
            wide += (wide / 2).max(1);
        }
    }

    /// Has at hand what cells from this distance on ([`UNITS_PER_M`]) are compared with.
    #[inline(always)]
    pub(super) fn prepare<P: Path>(&mut self, distance: u16) {
        let band = self.nearer.iter().take_while(|&&nearer| nearer > distance as i16).count();
        while self.known <= band {
            self.load_band::<P>(self.known, self.bands[self.known]);
            self.known += 1;
        }
    }

    #[inline(always)]
    fn load_band<P: Path>(&mut self, number: usize, band: Band) {
        // The two tabulated windows that cover the beams within `half` of each one.
        let count = self.count;
        let windows = |half: usize| {
            let beams = 2 * half + 1;
            let (level, first) = (beams.ilog2() as usize, PAD - half);
            let second = first + beams - (1 << level);
            (level, first..first + count, second..second + count)
        };
        for level in self.doubled + 1..=windows(band.wide).0 {
            double(&mut self.clear, level, i16::min);
            double(&mut self.empty, level, i16::min);
            double(&mut self.peak, level, i16::max);
            self.doubled = level;
        }
        let (narrow, a, b) = windows(band.narrow);
        let (wide, wide_a, wide_b) = windows(band.wide);
        let around = Around {
            own: &self.clear[0][PAD..PAD + count],
            low: [&self.clear[narrow][a.clone()], &self.clear[narrow][b.clone()]],
            high: [&self.peak[narrow][a], &self.peak[narrow][b]],
            clear: [&self.clear[wide][wide_a.clone()], &self.clear[wide][wide_b.clone()]],
            empty: [&self.empty[wide][wide_a], &self.empty[wide][wide_b]],
        };
        P::cross(&around, &mut self.crossings[number * count..][..count]);
    }

    /// How far each beam and both beside it are known to be free (m), less `margin`; `silent`, where they returned nothing. A
    /// beam that alone goes far is a random reading, or slipped through where nothing else can.
    #[inline(always)]
    pub fn free_ranges(&self, silent: f32, margin: f32, free: &mut Vec<f32>) {
        let silent = (silent * UNITS_PER_M) as i16;
        let beams = PAD - 1..PAD + self.count + 1;
        let (clear, empty) = (&self.clear[0][beams.clone()], &self.empty[0][beams]);
        // Beyond the ends both are FARTHEST.
        let of = |beam: usize| if clear[beam] < empty[beam] { silent } else { clear[beam] };
        free.resize(self.count, 0.0);
        for (beam, free) in free.iter_mut().enumerate() {
            let least = of(beam).min(of(beam + 1)).min(of(beam + 2));
            *free = greater(f32::from(least) / UNITS_PER_M - margin, 0.0);
        }
    }

    /// Where the sensor was in the middle of the scan (m).
    #[inline(always)]
    pub fn middle(&self) -> [f64; 2] {
        self.middle
    }

    /// What stands at (dx, dy) from [`View::middle`] (m).
    #[inline(always)]
    pub fn sight(&self, dx: f32, dy: f32) -> Sight {
        self.lens.sight(dx, dy)
    }

    /// How far the sensor moved in the scan (m).
    pub fn moved(&self) -> f32 {
        self.moved as f32
    }

    /// The longest distance of which the scan says something (m).
    pub fn farthest(&self) -> f32 {
        self.farthest
    }

    /// The middle of a tile's first cell, seen from [`View::middle`] (m). Taken anew for each scan, so that `f32` is exact
    /// enough however far the map reaches.
    #[inline(always)]
    pub fn corner(&self, place: TileIndex, resolution: f64) -> [f32; 2] {
        let at = |index: i32| (f64::from(index) * f64::from(SIDE) + 0.5) * resolution;
        [(at(place.x) - self.middle[0]) as f32, (at(place.y) - self.middle[1]) as f32]
    }

    /// Whether the beams within `half` beams of a bearing (in beams) say something of what is as far as this (m).
    #[inline(always)]
    pub(super) fn reaches(&self, beam: f32, half: f32, distance: f32) -> bool {
        if beam > -0.5 && beam < self.lens.last + 0.5 {
            return self.reach_between(beam, half) >= distance;
        }
        // The gap between the last beam and the first one after a turn.
        let beam = if beam < 0.0 { beam + self.lens.turn } else { beam };
        beam - half <= self.lens.last + 1.0 || beam + half >= self.lens.turn - 1.0
    }

    /// What the scan says of the cell with this sight (paper IV-B; the margins are in [`Tolerance`]). `lanes` does the same.
    ///
    /// `would_return`: from this far, the cell is known to return something.
    #[inline(always)]
    pub fn observe(&self, sight: &Sight, would_return: impl FnOnce() -> bool) -> Observation {
        if !sight.is_in_view {
            return Observation::Hidden;
        }
        let range = sight.range as i16;
        let band = self.nearer.iter().filter(|&&nearer| nearer > range).count();
        let Crossing { returned, low, high, empty } =
            self.crossings[band * self.count + usize::from(sight.beam)];
        let is_of_cell = |distance: i16| (distance - range).abs() <= self.along;
        if is_of_cell(returned) || is_of_cell(low) || is_of_cell(high) {
            Observation::Seen
        } else if empty & FARTHEST > range.saturating_add(self.along) && (empty >= 0 || would_return()) {
            if empty >= 0 { Observation::Missed } else { Observation::Silent }
        } else if low < range {
            Observation::Hidden
        } else {
            Observation::Unsure
        }
    }

    /// How far the beams within `half` beams of a bearing (in beams) say anything (m).
    fn reach_between(&self, beam: f32, half: f32) -> f32 {
        let low = (beam - half).max(0.0) as usize;
        let high = ((beam + half).max(0.0) as usize + 2).min(self.count).max(low + 1);
        if high - low > 1 << (LEVELS + 1) {
            return self.farthest;
        }
        let level = ((high - low).ilog2() as usize).min(LEVELS);
        let table = &self.reach[level];
        f32::from(table[PAD + low].max(table[PAD + high - (1 << level)])) / UNITS_PER_M
    }
}

/// Whatever differs by less is the same distance (m): units and rounding errors are below.
pub(super) const HAIR: f32 = 0.004;

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

/// Fills a level from the one before: a window of twice as many beams.
#[inline(always)]
fn double(table: &mut [Vec<i16>], level: usize, choose: impl Fn(i16, i16) -> i16) {
    let (below, above) = table.split_at_mut(level);
    let (below, width) = (&below[level - 1], 1 << (level - 1));
    let shifted = below.get(width..).unwrap_or(&[]);
    above[0].resize(shifted.len(), 0);
    for ((chosen, &a), &b) in above[0].iter_mut().zip(below).zip(shifted) {
        *chosen = choose(a, b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        grid::{
            lanes::Portable,
            sweep::tests::{half_circle, single},
            track::distance_units,
        },
        pose::pose,
    };
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
        view.prepare::<Portable>(0);
        view
    }

    fn observe(view: &View, x: f32, y: f32) -> Option<Observation> {
        let sight = view.sight(x, y);
        sight.is_in_view.then(|| view.observe(&sight, || sight.range < distance_units(12.0)))
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
            let sight = view.sight(dx as f32, dy as f32);
            assert!(sight.is_in_view && usize::from(sight.beam) == number, "{number}: {sight:?}");
            assert!(sight.range.abs_diff(distance_units(2.0)) <= 1, "{number}: {sight:?}");
        }
    }

    proptest! {
        #[test]
        fn the_tables_give_what_the_beams_say(ranges in proptest::collection::vec((single(0.1..20.0), 0..12), 200..400), at in single(0.0..1.0), distance in single(0.1..20.0)) {
            let beams = ranges.len();
            let code = |(range, kind): (f32, i32)| match kind { 0 => f32::INFINITY, 1 => f32::NAN, _ => range };
            let ranges: Vec<f32> = ranges.into_iter().map(code).collect();
            let view = view(ranges.clone());
            let beam = (at * (beams - 1) as f32) as usize;
            let range = distance_units(distance) as i16;
            let band = view.nearer.iter().filter(|nearer| **nearer > range).count();
            let crossing = view.crossings[band * beams + beam];
            // All beams that may cross the cell are in the wide window; the narrow one has at least the nearest.
            let per_rad = view.lens.beams_per_rad;
            let sure = ((0.025 + TOLERANCE.across as f32) / (distance + 0.002) + TOLERANCE.heading as f32) * per_rad;
            let around = |half: usize| beam.saturating_sub(half)..(beam + half + 1).min(beams);
            let sure = &ranges[around((sure as usize).min(PAD - 1))];
            let units = |range: &f32| distance_units(*range) as i16;
            let clear = |range: &f32| if range.is_finite() { units(range) } else { 0 };
            let empty = |range: &f32| if range.is_infinite() { distance_units(30.0) as i16 } else { clear(range) };
            prop_assert!(crossing.empty & FARTHEST <= sure.iter().map(empty).min().unwrap());
            prop_assert!(crossing.empty < 0 || sure.iter().all(|range| !range.is_infinite()) || crossing.empty == 0);
            prop_assert!(crossing.low <= clear(&ranges[beam]) && crossing.high >= clear(&ranges[beam]));
            let known = [crossing.low, crossing.high].map(|of| ranges.iter().any(|range| clear(range) == of));
            prop_assert_eq!(known, [true, true]);

            let (half, reach) = (sure.len() as f32, view.reach_between(beam as f32, 0.0));
            prop_assert!(reach >= f32::from(empty(&ranges[beam])) / UNITS_PER_M);
            prop_assert!(view.reach_between(beam as f32, half) >= reach);
        }

        #[test]
        fn sights_are_bearings_and_distances(x in -5.0f64..5.0, y in -5.0f64..5.0) {
            prop_assume!(x.hypot(y) > 0.2);
            let view = view(vec![10.0; 721]);
            let inside = y.atan2(x).abs() < FRAC_PI_2 + PI / 1440.0;
            let sight = view.sight(x as f32, y as f32);
            if sight.is_in_view {
                prop_assert!(inside);
                prop_assert!(sight.range.abs_diff(distance_units(x.hypot(y) as f32)) <= 1);
                prop_assert!(sight.angle.distance(Angle::from_rad((-y).atan2(-x))) <= 2);
            } else {
                prop_assert!(y.atan2(x).abs() > FRAC_PI_2 - PI / 1440.0);
            }
        }
    }
}
