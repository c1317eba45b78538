//! What a scan says of a cell: seen, missed, hidden, or nothing that is sure.
//!
//! No ray is walked. The scan is kept as a table from bearing to range, with the nearest return of every
//! window of beams looked up in two steps, and a cell is compared with the beams that cross it.

use super::{angle::Angle, sweep::Sweep};

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

/// One scan, ready to be compared with cells.
#[derive(Debug, Default)]
pub struct View {
    middle: [f64; 2],
    first_bearing: f32,
    beams_per_rad: f32,
    shift: [f32; 2],
    count: usize,
    /// Range of what returned (m), NaN where nothing did.
    returned: Vec<f32>,
    /// `clear[level][k]`: how far the beams k..k+2^level are all known to be free (m).
    clear: [Vec<f32>; LEVELS + 1],
    /// The same if beams without return had met nothing however far.
    empty: [Vec<f32>; LEVELS + 1],
    /// `reach[level][k]`: how far any of these beams says something (m).
    reach: [Vec<f32>; LEVELS + 1],
    farthest: f32,
}

impl View {
    /// Takes over a scan. `far` is the longest distance that counts as a measurement (m).
    pub fn load(&mut self, sweep: &Sweep, far: f64) {
        let shift = sweep.shift();
        self.middle = [sweep.middle().x, sweep.middle().y];
        self.first_bearing = sweep.first_bearing() as f32;
        self.beams_per_rad = (1.0 / sweep.bearing_step()) as f32;
        self.shift = [shift.x as f32, shift.y as f32];
        self.count = sweep.len();
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
        let (first, others) = self.reach.split_first_mut().expect("there is a level 0");
        first.clone_from(&self.empty[0]);
        self.farthest = first.iter().copied().fold(0.0, f32::max);
        double(first, others, f32::max);
        let (first, others) = self.clear.split_first_mut().expect("there is a level 0");
        double(first, others, f32::min);
        let (first, others) = self.empty.split_first_mut().expect("there is a level 0");
        double(first, others, f32::min);
    }

    /// The longest distance of which the scan says something (m).
    pub fn farthest(&self) -> f32 {
        self.farthest
    }

    /// How far each beam is known to be free (m); `silent`, where it returned nothing.
    pub fn free_ranges(&self, silent: f32) -> impl Iterator<Item = f32> {
        let both = self.clear[0].iter().zip(&self.empty[0]);
        both.map(move |(&clear, &empty)| if clear < empty { silent } else { clear })
    }

    /// Where the sensor was in the middle of the scan (m).
    pub fn middle(&self) -> [f64; 2] {
        self.middle
    }

    /// The point (m) as seen by the beam that passes nearest to it; `None` outside the field of view.
    pub fn sight(&self, x: f64, y: f64) -> Option<Sight> {
        let (dx, dy) = ((x - self.middle[0]) as f32, (y - self.middle[1]) as f32);
        let square = (dx * dx + dy * dy).max(1e-6);
        let bearing = dy.atan2(dx);
        let beam = self.wrap((bearing - self.first_bearing) * self.beams_per_rad);
        // To the first order, how the sensor's place at that beam differs from the one in the middle.
        let moved = beam.clamp(0.0, self.count as f32 - 1.0) - (self.count as f32 - 1.0) / 2.0;
        let (ox, oy) = (self.shift[0] * moved, self.shift[1] * moved);
        let turned = (dy * ox - dx * oy) / square;
        let range = square.sqrt();
        let beam = self.wrap(beam + turned * self.beams_per_rad);
        (beam > -0.5 && beam < self.count as f32 - 0.5).then(|| Sight {
            range: range - (dx * ox + dy * oy) / range,
            beam,
            angle: Angle::from_rad(f64::from(bearing + turned) + std::f64::consts::PI),
        })
    }

    /// What the scan says of the cell with this sight (paper IV-B; the margins are in [`Tolerance`]).
    ///
    /// `would_return`: from this far, the cell is known to return something.
    pub fn observe(&self, sight: &Sight, would_return: bool, tolerance: &Tolerance) -> Observation {
        let (range, along) = (sight.range, tolerance.along as f32);
        let half_cell = tolerance.resolution as f32 / 2.0;
        let half_wide = (half_cell + tolerance.across as f32) / range + tolerance.heading as f32;
        let wide = self.window(sight.beam, half_wide);
        if lookup(&self.clear, wide, f32::min) > range + along {
            return Observation::Missed;
        }
        if would_return && lookup(&self.empty, wide, f32::min) > range + along {
            return Observation::Silent;
        }
        let window = self.window(sight.beam, half_cell / range);
        if self.returned[window.0..window.1].iter().any(|returned| (returned - range).abs() <= along) {
            Observation::Seen
        } else if lookup(&self.clear, window, f32::min) < range - along {
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
            lookup(&self.reach, window, f32::max)
        }
    }

    /// The beams within `half` (rad) of a bearing: at least the nearest.
    fn window(&self, beam: f32, half: f32) -> (usize, usize) {
        let half = half * self.beams_per_rad.abs();
        let last = self.count - 1;
        let nearest = (beam.round().max(0.0) as usize).min(last);
        let low = ((beam - half).ceil().max(0.0) as usize).min(nearest);
        let high = ((beam + half).floor().max(0.0) as usize).clamp(nearest, last);
        (low, high + 1)
    }

    fn wrap(&self, beam: f32) -> f32 {
        let turn = (std::f32::consts::TAU * self.beams_per_rad).abs();
        // The turn is cut in the middle of what the scanner does not see.
        let low = (self.count as f32 - turn) / 2.0;
        beam - ((beam - low) / turn).floor() * turn
    }
}

/// Fills each level from the one before: a window of twice as many beams.
fn double(first: &[f32], others: &mut [Vec<f32>], choose: fn(f32, f32) -> f32) {
    let mut width = 1;
    let mut below = first;
    for level in others {
        level.clear();
        let pairs = below.iter().zip(below.get(width..).unwrap_or(&[]));
        level.extend(pairs.map(|(&a, &b)| choose(a, b)));
        width *= 2;
        below = level;
    }
}

/// The chosen value over a window, by the two tabulated windows that cover it.
fn lookup(table: &[Vec<f32>; LEVELS + 1], (low, high): (usize, usize), choose: fn(f32, f32) -> f32) -> f32 {
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
        view.load(&Sweep { scan: &scan, start: pose(0.0, 0.0, 0.0), end: pose(0.0, 0.0, 0.0) }, 30.0);
        view
    }

    fn observe(view: &View, x: f64, y: f64) -> Option<Observation> {
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
        view.load(&sweep, 30.0);
        for (number, (origin, direction)) in sweep.beams().enumerate() {
            let point = origin + direction * 2.0;
            let sight = view.sight(point.x, point.y).unwrap();
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
            let expected = ranges[low..high].iter().copied().fold(f32::MAX, f32::min);
            prop_assert_eq!(lookup(&view.clear, (low, high), f32::min), expected);
            let expected = ranges[low..high].iter().copied().fold(0.0, f32::max);
            prop_assert_eq!(view.reach_between(beam, half), expected);
        }

        #[test]
        fn sights_are_bearings_and_distances(x in -5.0f64..5.0, y in -5.0f64..5.0) {
            prop_assume!(x.hypot(y) > 0.2);
            let view = view(vec![10.0; 721]);
            let inside = y.atan2(x).abs() < FRAC_PI_2 + PI / 1440.0;
            if let Some(sight) = view.sight(x, y) {
                prop_assert!(inside);
                prop_assert!((f64::from(sight.range) - x.hypot(y)).abs() < 1e-4);
                prop_assert!(sight.angle.distance(Angle::from_rad((-y).atan2(-x))) <= 1);
            } else {
                prop_assert!(y.atan2(x).abs() > FRAC_PI_2 - PI / 1440.0);
            }
        }
    }
}
