//! View angles as 16-bit binary angles, and ranges of them on the circle.
//!
//! 65536 units are one turn, so that all differences wrap by themselves; a unit is 0.0055 degrees, a
//! fortieth of the scanner's step. A view angle is the bearing, in the map's frame, of the sensor as seen
//! from the cell.

use std::f64::consts::TAU;

/// Units of a full turn.
pub const TURN: u32 = 1 << 16;

/// A direction in the plane, 65536 units a turn, counter-clockwise from the x axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Angle(pub u16);

impl Angle {
    /// The nearest binary angle to `rad`.
    pub fn from_rad(rad: f64) -> Angle {
        Angle((rad * (f64::from(TURN) / TAU)).round() as i64 as u16)
    }

    /// The nearest binary angle to the bearing of (x, y): [`Angle::from_rad`] of its `atan2`, which is asked only where less leaves a doubt.
    pub fn of([x, y]: [f64; 2]) -> Angle {
        let near = atan2(y as f32, x as f32) * (TURN as f32 / std::f32::consts::TAU);
        let whole = nearest(near);
        // Off by 0.04 units at most.
        if (near - whole).abs() < 0.45 { Angle(whole as i32 as u16) } else { Angle::from_rad(y.atan2(x)) }
    }

    /// The same where speed counts more than units: within one of it for bearings up to some hundred turns.
    #[inline(always)]
    pub fn from_bearing(rad: f32) -> Angle {
        // The whole number stands in the low bits, negative ones as their two's complement.
        Angle((rad * (TURN as f32 / std::f32::consts::TAU) + ROUNDER).to_bits() as u16)
    }

    /// The angle in radians, 0..2 pi.
    pub fn rad(self) -> f64 {
        f64::from(self.0) * (TAU / f64::from(TURN))
    }

    /// Smallest turn between two directions (units, 0..=32768).
    pub fn distance(self, other: Angle) -> u32 {
        let difference = self.0.wrapping_sub(other.0);
        u32::from(difference.min(difference.wrapping_neg()))
    }
}

/// Minimax of atan(t) / t in t^2 over 0..1: off by 2e-6 at most.
pub(super) const ATAN: [f32; 6] =
    [0.999_977_26, -0.332_623_47, 0.193_543_46, -0.116_432_87, 0.052_653_32, -0.011_721_2];

/// atan of a ratio in 0..1, with its square.
#[inline(always)]
pub(super) fn atan(ratio: f32, square: f32) -> f32 {
    // In pairs, which wait less for each other than term by term.
    let [a, b, c] = [0, 2, 4].map(|n| ATAN[n] + ATAN[n + 1] * square);
    let fourth = square * square;
    (a + fourth * (b + fourth * c)) * ratio
}

/// The bearing of (x, y), in rad, to within 3e-6: [`f32::atan2`] without a branch or a call, so that eight can be
/// had at a time. Where both are 0 it is 0.
#[inline(always)]
pub fn atan2(y: f32, x: f32) -> f32 {
    let (across, along) = (y.abs(), x.abs());
    let steep = across > along;
    let (less, more) = if steep { (along, across) } else { (across, along) };
    let ratio = less / more.max(f32::MIN_POSITIVE);
    let octant = atan(ratio, ratio * ratio);
    in_circle(octant, steep, y, x)
}

/// The bearing of (x, y) from the angle to the nearest axis; `steep`: that is the y axis.
#[inline(always)]
pub(super) fn in_circle(octant: f32, steep: bool, y: f32, x: f32) -> f32 {
    use std::f32::consts::{FRAC_PI_2, PI};
    let quadrant = if steep { FRAC_PI_2 - octant } else { octant };
    let half = if x < 0.0 { PI - quadrant } else { quadrant };
    if y < 0.0 { -half } else { half }
}

/// The nearest whole number, for numbers below 2^22: the addition rounds. Without SSE4.1, `round` is a call.
#[inline(always)]
pub fn nearest(number: f32) -> f32 {
    (number + ROUNDER) - ROUNDER
}

/// The same as an integer.
#[inline(always)]
pub fn whole(number: f32) -> i32 {
    ((number + ROUNDER).to_bits() as i32).wrapping_sub(ROUNDER.to_bits() as i32)
}

/// In `f32`, neighbours of 1.5 x 2^23 are whole numbers.
pub(super) const ROUNDER: f32 = 12_582_912.0;

/// Units of an arc of `rad`.
pub fn units(rad: f64) -> u32 {
    (rad * (f64::from(TURN) / TAU)).round() as u32
}

/// A closed arc: `width` units counter-clockwise from `start`. A width of 65535 is the full circle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AngleRange {
    /// Clockwise end.
    pub start: Angle,
    /// Length of the arc (units).
    pub width: u16,
}

impl AngleRange {
    /// The range that holds a single direction.
    pub fn at(angle: Angle) -> AngleRange {
        AngleRange { start: angle, width: 0 }
    }

    /// Whether the range is the whole circle.
    pub fn is_full(self) -> bool {
        self.width == u16::MAX
    }

    /// Direction in the middle of the arc.
    pub fn middle(self) -> Angle {
        Angle(self.start.0.wrapping_add(self.width / 2))
    }

    /// Its width (rad).
    pub fn width_rad(self) -> f64 {
        f64::from(self.width) * (std::f64::consts::TAU / 65_536.0)
    }

    /// Whether `angle` lies in the arc.
    pub fn contains(self, angle: Angle) -> bool {
        angle.0.wrapping_sub(self.start.0) <= self.width
    }

    /// Grows the arc to `angle`, on the side where less is missing.
    pub fn extend(&mut self, angle: Angle) {
        let beyond_start = angle.0.wrapping_sub(self.start.0);
        if beyond_start <= self.width {
            return;
        }
        let after = beyond_start - self.width;
        let before = beyond_start.wrapping_neg();
        let grown = u32::from(self.width) + u32::from(after.min(before));
        if before < after {
            self.start = angle;
        }
        self.width = grown.min(u32::from(u16::MAX)) as u16;
    }

    /// Whether the two arcs, each widened by `margin` on both sides, meet: whether [`AngleRange::depth`] is positive, but for
    /// its rounding.
    pub fn meets(self, other: AngleRange, margin: u32) -> bool {
        let reach = (self.width / 2).saturating_add(other.width / 2).saturating_add(2 * margin as u16);
        u32::from(reach) > self.middle().distance(other.middle())
    }

    /// How far the two arcs, each widened by `margin` on both sides, must slide apart until they no
    /// longer meet (units); negative by the gap between them where they do not meet.
    pub fn depth(self, other: AngleRange, margin: u32) -> i32 {
        if self.is_full() || other.is_full() {
            return TURN as i32;
        }
        let lengths = u32::from(self.width) + u32::from(other.width) + 4 * margin;
        lengths as i32 / 2 - self.middle().distance(other.middle()) as i32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::sweep::tests::single;
    use proptest::prelude::*;

    fn range(start: u16, width: u16) -> AngleRange {
        AngleRange { start: Angle(start), width }
    }

    #[test]
    fn grows_to_the_nearer_side() {
        let mut arc = range(100, 50);
        arc.extend(Angle(120));
        assert_eq!(arc, range(100, 50));
        arc.extend(Angle(170));
        assert_eq!(arc, range(100, 70));
        arc.extend(Angle(90));
        assert_eq!(arc, range(90, 80));
        arc.extend(Angle(65_530));
        assert_eq!(arc, range(65_530, 176), "across the wrap");
    }

    #[test]
    fn bearings_along_the_axes() {
        for (x, y) in [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0), (2.0, 2.0), (0.0, 0.0)] {
            assert!((atan2(y, x) - y.atan2(x)).abs() <= 3e-6, "{x} {y}");
        }
        for (x, y) in [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (-1.0, -0.0), (0.0, -1.0), (0.0, 0.0)] {
            assert_eq!(Angle::of([x, y]), Angle::from_rad(f64::atan2(y, x)), "{x} {y}");
        }
        assert_eq!([-2.5, -0.4, 0.4, 7.6].map(nearest), [-2.0, 0.0, 0.0, 8.0]);
    }

    #[test]
    fn a_turn_fills_the_circle() {
        let mut arc = AngleRange::at(Angle(5));
        for step in 0..700u32 {
            arc.extend(Angle((5 + step * 100) as u16));
        }
        assert!(u32::from(arc.width) + 100 >= TURN - 1, "{arc:?}");
        assert!(range(9, u16::MAX).is_full());
        assert_eq!(range(9, u16::MAX).depth(AngleRange::at(Angle(40_000)), 0), TURN as i32);
    }

    #[test]
    fn depth_is_the_slide_that_parts_them() {
        assert_eq!(range(100, 100).depth(range(180, 100), 0), 20);
        assert_eq!(range(100, 100).depth(range(140, 20), 0), 60, "inside: out by the nearer end");
        assert_eq!(range(100, 0).depth(range(100, 0), 23), 46, "two single views at the same angle");
        assert_eq!(range(65_500, 100).depth(range(10, 10), 0), 54 + 1 - 1);
        assert!(range(0, 10).depth(range(500, 10), 0) < 0);
    }

    proptest! {
        #[test]
        fn extending_keeps_what_was_there(start: u16, width in 0u16..60_000, angle: u16, probe: u16) {
            let before = range(start, width);
            let mut after = before;
            after.extend(Angle(angle));
            prop_assert!(after.contains(Angle(angle)));
            prop_assert!(!before.contains(Angle(probe)) || after.contains(Angle(probe)));
        }

        #[test]
        fn turning_both_arcs_changes_no_depth(a: u16, wa in 0u16..30_000, b: u16, wb in 0u16..30_000, turn: u16) {
            let turned = |s: u16, w| range(s.wrapping_add(turn), w);
            prop_assert_eq!(range(a, wa).depth(range(b, wb), 7), turned(a, wa).depth(turned(b, wb), 7));
            prop_assert_eq!(range(a, wa).depth(range(b, wb), 7), range(b, wb).depth(range(a, wa), 7));
        }

        #[test]
        fn depth_is_positive_exactly_where_arcs_overlap(a: u16, wa in 1u16..15_000, b: u16, wb in 1u16..15_000) {
            let (a, b) = (range(a, wa), range(b, wb));
            let meet = a.contains(b.start) || b.contains(a.start);
            let depth = a.depth(b, 0);
            // The middle of an odd arc is rounded down, so a touch may come out one unit off.
            prop_assert!(if meet { depth >= -1 } else { depth <= 1 }, "{:?} {:?} {}", a, b, depth);
        }

        #[test]
        fn bearings_are_those_of_the_library(x in single(-30.0..30.0), y in single(-30.0..30.0), turns in -3i32..4) {
            prop_assert!((atan2(y, x) - y.atan2(x)).abs() <= 3e-6);
            let bearing = y.atan2(x) + turns as f32 * TAU as f32;
            prop_assert!(Angle::from_bearing(bearing).distance(Angle::from_rad(y.atan2(x).into())) <= 1);
        }

        #[test]
        fn bearings_are_rounded_as_those_of_the_library(x in -30f64..30.0, y in -30f64..30.0, part in 0f64..1.0) {
            prop_assert_eq!(Angle::of([x, y]), Angle::from_rad(y.atan2(x)));
            // Around the middle between two units.
            let (sin, cos) = ((x.to_bits() as u16 as f64 + 0.4 + 0.2 * part) / f64::from(TURN) * TAU).sin_cos();
            prop_assert_eq!(Angle::of([cos, sin]), Angle::from_rad(sin.atan2(cos)));
        }

        #[test]
        fn radians_survive(angle: u16) {
            prop_assert_eq!(Angle::from_rad(Angle(angle).rad()), Angle(angle));
            prop_assert_eq!(Angle::from_rad(Angle(angle).rad() - TAU), Angle(angle));
        }
    }
}
