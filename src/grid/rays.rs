//! The beams of a scan in cells, relative to a corner near the sensor.
//!
//! Taken anew for each scan, so that `f32` is exact enough however far the map reaches: to a thousandth of a cell. Numbers of
//! one kind lie side by side, so that several beams are worked out at a time.

use super::{
    angle::atan2,
    sweep::Sweep,
    tiles::{CellIndex, SIDE, TileIndex},
};
use nalgebra::UnitComplex;

/// Numbers for each beam, x and y.
type Pairs = [Vec<f32>; 2];

/// See the module.
#[derive(Debug)]
pub struct Rays {
    /// The tile whose lower left corner all else is relative to.
    base: TileIndex,
    /// Where each beam starts (cells).
    origin: Pairs,
    /// Where it points (cells a metre).
    direction: Pairs,
}

impl Default for Rays {
    fn default() -> Self {
        Rays { base: TileIndex { x: 0, y: 0 }, origin: Pairs::default(), direction: Pairs::default() }
    }
}

/// Beams that are worked out at a time.
const LANES: usize = 8;

impl Rays {
    /// Takes over a scan. `resolution`: side of a cell (m).
    #[inline(always)]
    pub fn load(&mut self, sweep: &Sweep, resolution: f64) {
        let middle = sweep.middle();
        (self.base, ..) = CellIndex::of(middle.x, middle.y, resolution).split();
        let (count, per_cell) = (sweep.len(), 1.0 / resolution);
        for values in self.origin.iter_mut().chain(&mut self.direction) {
            values.resize(count.next_multiple_of(LANES), 0.0);
        }
        let (shift, start) = (sweep.shift() * per_cell, sweep.start.translation.vector * per_cell);
        let corner = [self.base.x, self.base.y].map(|tile| f64::from(tile) * f64::from(SIDE));
        for axis in 0..2 {
            let from = start[axis] - corner[axis];
            // Numbers of 32 bits: those of 64 are turned into floats one by one.
            for (origin, beam) in self.origin[axis].iter_mut().zip(0i32..) {
                *origin = (from + shift[axis] * f64::from(beam)) as f32;
            }
        }
        // Turned by eight beams at a time: one by one, each would wait for the one before.
        let bearings: [UnitComplex<f64>; LANES] = std::array::from_fn(|lane| {
            UnitComplex::new(sweep.first_bearing() + sweep.bearing_step() * lane as f64)
        });
        let (mut xs, mut ys) = (bearings.map(|at| at.re * per_cell), bearings.map(|at| at.im * per_cell));
        let turn = UnitComplex::new(sweep.bearing_step() * LANES as f64);
        let [x, y] = &mut self.direction;
        for (x, y) in x.as_chunks_mut::<LANES>().0.iter_mut().zip(y.as_chunks_mut::<LANES>().0) {
            for lane in 0..LANES {
                (x[lane], y[lane]) = (xs[lane] as f32, ys[lane] as f32);
                let turned = xs[lane] * turn.re - ys[lane] * turn.im;
                ys[lane] = xs[lane] * turn.im + ys[lane] * turn.re;
                xs[lane] = turned;
            }
        }
    }

    /// The tile whose lower left corner all else is relative to.
    pub fn base(&self) -> TileIndex {
        self.base
    }

    /// Bearing of a beam (rad).
    pub fn bearing(&self, beam: usize) -> f32 {
        atan2(self.direction[1][beam], self.direction[0][beam])
    }

    /// Where the first and the last beam started (cells).
    pub fn first_and_last(&self, count: usize) -> [[f32; 2]; 2] {
        [0, count - 1].map(|beam| [self.origin[0][beam], self.origin[1][beam]])
    }

    /// The points on the beams at these distances (m), in cells.
    #[inline(always)]
    pub fn points(&self, distances: &[f32], points: &mut Pairs) {
        for ((points, origins), directions) in points.iter_mut().zip(&self.origin).zip(&self.direction) {
            points.resize(distances.len(), 0.0);
            let from = distances.iter().zip(origins).zip(directions);
            for (point, ((&distance, &origin), &direction)) in points.iter_mut().zip(from) {
                *point = origin + direction * distance;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{grid::sweep::tests::half_circle, pose::pose};

    #[test]
    fn points_are_where_the_beams_go() {
        let scan = half_circle(0, vec![0.0; 1081]);
        let sweep = Sweep { scan: &scan, start: pose(-71.3, 502.2, 2.0), end: pose(-71.2, 502.25, 2.1) };
        let (mut rays, mut points) = (Rays::default(), Pairs::default());
        rays.load(&sweep, 0.05);
        let distances: Vec<f32> = (0..1081).map(|beam| 0.03 * beam as f32).collect();
        rays.points(&distances, &mut points);
        let corner = rays.base().cell(0, 0);
        for (beam, (origin, direction)) in sweep.beams().enumerate() {
            let point = (origin + direction * f64::from(distances[beam])) / 0.05;
            let expected = [point.x - f64::from(corner.x), point.y - f64::from(corner.y)];
            for axis in 0..2 {
                let off = (f64::from(points[axis][beam]) - expected[axis]).abs();
                assert!(off < 1e-3, "{beam}: {off}");
            }
        }
    }
}
