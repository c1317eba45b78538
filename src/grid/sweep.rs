//! A scan laid into the map: where each beam started and pointed, the sensor moving while it turned.
//!
//! The scanner takes 18.75 ms for its 270 degrees; at 1 m/s it moves by 2 cm meanwhile, and at 2 rad/s it
//! turns by 2 degrees, nine beams. Position and heading are taken to change evenly between the poses at
//! the first and the last beam.

use crate::{pose::Pose, scan::Scan};
use nalgebra::{Point2, Vector2};

/// A scan and the poses of the scanner, in the map's frame, at its first and last beam.
#[derive(Clone, Copy, Debug)]
pub struct Sweep<'a> {
    /// The scan.
    pub scan: &'a Scan,
    /// Pose of the scanner at the first beam.
    pub start: Pose,
    /// Pose of the scanner at the last beam.
    pub end: Pose,
}

impl Sweep<'_> {
    /// Number of beams.
    pub fn len(&self) -> usize {
        self.scan.ranges.len()
    }

    /// Whether there is no beam.
    pub fn is_empty(&self) -> bool {
        self.scan.ranges.is_empty()
    }

    /// How far the sensor moves from one beam to the next (m).
    pub fn shift(&self) -> Vector2<f64> {
        (self.end.translation.vector - self.start.translation.vector) / self.steps()
    }

    /// Where the sensor was in the middle of the scan (m).
    pub fn middle(&self) -> Point2<f64> {
        ((self.start.translation.vector + self.end.translation.vector) / 2.0).into()
    }

    /// Bearing of the first beam in the map's frame (rad).
    pub fn first_bearing(&self) -> f64 {
        self.start.rotation.angle() + self.scan.geometry.angle_min
    }

    /// Turn from one beam to the next in the map's frame (rad).
    pub fn bearing_step(&self) -> f64 {
        self.scan.geometry.angle_increment + self.start.rotation.angle_to(&self.end.rotation) / self.steps()
    }

    /// Origin (m) and direction (unit vector) of every beam in the map's frame, in the scan's order.
    pub fn beams(&self) -> impl Iterator<Item = (Point2<f64>, Vector2<f64>)> {
        let shift = self.shift();
        let step = nalgebra::UnitComplex::new(self.bearing_step());
        let origin = Point2::from(self.start.translation.vector);
        let direction = nalgebra::UnitComplex::new(self.first_bearing());
        (0..self.len()).scan((origin, direction), move |(origin, direction), _| {
            let beam = (*origin, Vector2::new(direction.re, direction.im));
            *origin += shift;
            *direction *= step;
            Some(beam)
        })
    }

    fn steps(&self) -> f64 {
        self.len().saturating_sub(1).max(1) as f64
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::{pose::pose, scan::Geometry};
    use proptest::strategy::Strategy;
    use std::{
        f64::consts::{FRAC_PI_2, PI},
        ops::Range,
    };

    /// Any number of single precision between these. Drawn in double precision: of some million numbers that proptest 1.12
    /// draws in single precision, one fails an assertion of its own.
    pub(crate) fn single(between: Range<f64>) -> impl Strategy<Value = f32> {
        between.prop_map(|number| number as f32)
    }

    /// A scan of these ranges, spread over the full half circle in front.
    pub(crate) fn half_circle(seq: u64, ranges: Vec<f32>) -> Scan {
        let step = PI / (ranges.len() - 1) as f64;
        Scan {
            seq,
            stamp_ns: seq as i64 * 25_000_000,
            received_ns: seq as i64 * 25_000_000,
            geometry: Geometry {
                angle_min: -FRAC_PI_2,
                angle_increment: step,
                time_increment: 0.0,
                range_min: 0.023,
                range_max: 60.0,
            },
            ranges,
            intensities: Vec::new(),
        }
    }

    #[test]
    fn beams_start_where_the_sensor_was() {
        let scan = half_circle(0, vec![1.0; 3]);
        let sweep = Sweep { scan: &scan, start: pose(0.0, 0.0, 0.0), end: pose(0.2, 0.0, FRAC_PI_2) };
        let beams: Vec<_> = sweep.beams().collect();
        let bearings = [-FRAC_PI_2, FRAC_PI_2 / 2.0, PI];
        for ((origin, direction), (x, bearing)) in beams.iter().zip([0.0, 0.1, 0.2].iter().zip(bearings)) {
            assert!((origin - Point2::new(*x, 0.0)).norm() < 1e-12);
            assert!((direction - Vector2::new(bearing.cos(), bearing.sin())).norm() < 1e-12);
        }
    }
}
