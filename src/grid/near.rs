//! The tiles of which a scan may say something.
//!
//! Worked out for all tiles at a time, number beside number: one by one, each would wait for its own square root, quotients and
//! bearing.

use super::{
    angle::atan2,
    tiles::{CellIndex, TileIndex, Tiles},
    view::{HAIR, Tolerance, View},
};

/// What is nearer than this is looked at in each scan (m): at 1 m/s, what is 1 m away is seen from 6 degrees elsewhere by its
/// next turn.
const CLOSE: f32 = 1.0;

/// Whose turn it is to be looked at. From one scan to the next, what is some metres away is seen from nearly the same angle, with the
/// same error of the pose: it would say the same once more. So tiles take turns, quarter by quarter.
#[derive(Clone, Copy, Debug)]
pub struct Turns {
    /// Quarters of the time between two turns of a tile, since the first scan: at the last scan and at the one before.
    now: i32,
    before: i32,
    /// Quarters that were added where scans were lost, so that nobody's turns are in a row there.
    lost: i32,
}

impl Default for Turns {
    fn default() -> Self {
        Turns { now: -4, before: -8, lost: 0 }
    }
}

impl Turns {
    /// Goes on to a scan, so long after the first one (ns). `period`: from one turn of a tile to the next (s); 0 if each scan is
    /// everybody's. `follows`: no scan was lost before it.
    pub fn go_on(&mut self, elapsed_ns: i64, period: f64, follows: bool) {
        self.before = self.now;
        self.lost = self.lost.wrapping_add(if follows { 0 } else { 8 });
        self.now = if period > 0.0 {
            ((elapsed_ns as f64 * 1e-9 / period * 4.0) as i64 as i32).wrapping_add(self.lost)
        } else {
            self.now.wrapping_add(if follows { 4 } else { 8 })
        };
    }

    /// Whether a tile is looked at in this scan; `middle`: where its middle is, seen from the sensor, `half`: half its side (m).
    #[inline(always)]
    pub fn have_come(self, place: TileIndex, [x, y]: [f32; 2], half: f32) -> bool {
        let [x, y] = [x.abs() - half, y.abs() - half].map(|beyond| if beyond > 0.0 { beyond } else { 0.0 });
        self.are_of(place) | (x * x + y * y <= CLOSE * CLOSE)
    }

    /// Whether this scan is one of a tile's turns, wherever it is.
    #[inline(always)]
    pub fn are_of(self, place: TileIndex) -> bool {
        self.are_of_group(group(place))
    }

    #[inline(always)]
    fn are_of_group(self, group: usize) -> bool {
        number(self.now, group) != number(self.before, group)
    }

    /// Number of the last turn that a tile had.
    pub fn number(self, place: TileIndex) -> i32 {
        number(self.now, group(place))
    }
}

/// Groups of tiles that have their turns together.
const GROUPS: usize = 4;

#[inline(always)]
fn group(place: TileIndex) -> usize {
    ((place.x + 2 * place.y) & 3) as usize
}

#[inline(always)]
fn number(quarters: i32, group: usize) -> i32 {
    quarters.wrapping_add(group as i32) >> 2
}

/// Tiles within reach, by their number, and how the sensor sees the disc around each.
#[derive(Debug, Default)]
pub struct Near {
    /// All tiles with their numbers, by group: most scans are the turn of one, and need not go through the others.
    groups: [Vec<(TileIndex, u32)>; GROUPS],
    /// How many tiles these are.
    grouped: usize,
    numbers: Vec<u32>,
    /// The middle of each, seen from the sensor in the middle of the scan (m).
    middles: [Vec<f32>; 2],
    /// How far the nearest cell may be (m).
    nearest: Vec<f32>,
    /// Bearing of the middle, and the beams to either side that may meet the disc.
    beam: Vec<f32>,
    half: Vec<f32>,
}

impl Near {
    /// Finds those whose turn it is, those that were hit since their last one wherever the scanner looks now. `side`: between the
    /// middles of the first and the last cell (m).
    #[inline(always)]
    pub fn find<T: Default>(
        &mut self,
        tiles: &Tiles<T>,
        was_hit: &[bool],
        turns: Turns,
        view: &View,
        tolerance: &Tolerance,
        side: f32,
    ) {
        let radius = side * std::f32::consts::FRAC_1_SQRT_2;
        let slack = radius + view.moved() + HAIR;
        let beyond = view.farthest() + tolerance.along as f32 + slack;
        let places = tiles.places();
        for (number, &place) in places.iter().enumerate().skip(self.grouped) {
            self.groups[group(place)].push((place, number as u32));
        }
        self.grouped = places.len();
        for values in self.middles.iter_mut().chain([&mut self.nearest, &mut self.beam, &mut self.half]) {
            values.resize(places.len(), 0.0);
        }
        self.numbers.resize(places.len(), 0);
        let (mut count, [xs, ys]) = (0, &mut self.middles);
        let numbers = &mut self.numbers;
        let mut take = |place: TileIndex, number: u32| {
            let [x, y] = view.corner(place, tolerance.resolution).map(|at| at + side / 2.0);
            // Written in any case, counted if it shall stay: a branch here would be guessed wrong too often.
            (numbers[count], xs[count], ys[count]) = (number, x, y);
            let may_show = was_hit[number as usize] | (x * x + y * y <= beyond * beyond);
            count += usize::from(turns.have_come(place, [x, y], side / 2.0) & may_show);
        };
        for (_, tiles) in (0..).zip(&self.groups).filter(|(group, _)| turns.are_of_group(*group)) {
            tiles.iter().for_each(|&(place, number)| take(place, number));
        }
        // Of the others, those that are close.
        let [x, y] = view.middle();
        let close = f64::from(CLOSE);
        let (low, ..) = CellIndex::of(x - close, y - close, tolerance.resolution).split();
        let (high, ..) = CellIndex::of(x + close, y + close, tolerance.resolution).split();
        for place in (low.y..=high.y).flat_map(|y| (low.x..=high.x).map(move |x| TileIndex { x, y })) {
            if !turns.are_of(place)
                && let Some(number) = tiles.find(place)
            {
                take(place, number as u32);
            }
        }
        self.numbers.truncate(count);
        let per_rad = view.lens.beams_per_rad.abs();
        // For the motion within the scan and for the heading.
        let margin = tolerance.heading as f32 + 0.02;
        let middles = self.middles[0].iter().zip(&self.middles[1]).take(count);
        let found = self.nearest.iter_mut().zip(&mut self.beam).zip(&mut self.half);
        for ((&x, &y), ((nearest, beam), half)) in middles.zip(found) {
            let distance = (x * x + y * y).sqrt();
            *nearest = distance - slack;
            *beam = view.lens.beam(atan2(y, x));
            // The disc's width, from above; where the sensor is in the disc, or nearly, it does not matter.
            let sine = radius / distance;
            let width = sine + 0.571 * sine * sine * sine + view.moved() / *nearest + margin;
            *half = width * per_rad;
        }
        let mut reached = 0;
        for tile in 0..count {
            let nearest = self.nearest[tile];
            let is_reached = nearest <= radius
                || was_hit[self.numbers[tile] as usize]
                || view.reaches(self.beam[tile], self.half[tile], nearest - tolerance.along as f32);
            self.numbers[reached] = self.numbers[tile];
            reached += usize::from(is_reached);
        }
        self.numbers.truncate(reached);
    }

    /// Their numbers.
    pub fn tiles(&self) -> impl Iterator<Item = usize> {
        self.numbers.iter().map(|&number| number as usize)
    }
}
