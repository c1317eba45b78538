//! The tiles of which a scan may say something.
//!
//! Worked out for all tiles at a time, number beside number: one by one, each would wait for its own square root, quotients and
//! bearing.

use super::{
    angle::atan2,
    tiles::TileIndex,
    view::{HAIR, Tolerance, View},
};

/// Tiles within reach, by their number, and how the sensor sees the disc around each.
#[derive(Debug, Default)]
pub struct Near {
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
    /// Finds the tiles. `side`: between the middles of the first and the last cell (m).
    #[inline(always)]
    pub fn find(&mut self, places: &[TileIndex], view: &View, tolerance: &Tolerance, side: f32) {
        let radius = side * std::f32::consts::FRAC_1_SQRT_2;
        let slack = radius + view.moved() + HAIR;
        let beyond = view.farthest() + tolerance.along as f32 + slack;
        for values in self.middles.iter_mut().chain([&mut self.nearest, &mut self.beam, &mut self.half]) {
            values.resize(places.len(), 0.0);
        }
        self.numbers.resize(places.len(), 0);
        let (mut count, [xs, ys]) = (0, &mut self.middles);
        for (number, &place) in places.iter().enumerate() {
            let [x, y] = view.corner(place, tolerance.resolution).map(|at| at + side / 2.0);
            // Written in any case, counted if it shall stay: a branch here would be guessed wrong too often.
            (self.numbers[count], xs[count], ys[count]) = (number as u32, x, y);
            count += usize::from(x * x + y * y <= beyond * beyond);
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
                || view.reaches(self.beam[tile], self.half[tile], nearest - tolerance.along as f32);
            (self.numbers[reached], self.nearest[reached]) = (self.numbers[tile], nearest);
            reached += usize::from(is_reached);
        }
        self.numbers.truncate(reached);
    }

    /// Their numbers, and how far the nearest cell of each may be (m).
    pub fn tiles(&self) -> impl Iterator<Item = (usize, f32)> {
        self.numbers.iter().map(|&number| number as usize).zip(self.nearest.iter().copied())
    }
}
