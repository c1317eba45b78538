//! Poses in the plane and the buffer that knows them over time (REP-103, REP-105).

use nalgebra::{Isometry2, UnitComplex, Vector2};

/// A frame's pose in another: metres, counter-clockwise positive.
pub type Pose = Isometry2<f64>;

/// Pose from its parts (m, m, rad).
pub fn pose(x: f64, y: f64, yaw: f64) -> Pose {
    Pose::from_parts(Vector2::new(x, y).into(), UnitComplex::new(yaw))
}

/// The heading as the z and w parts of a quaternion, which is how messages carry it.
///
/// A pose that came as a yaw angle goes through this and [`yaw_from_quaternion`] when it is received, so
/// that a recording gives back the very same bits.
pub fn quaternion_from_yaw(yaw: f64) -> [f64; 2] {
    [(yaw / 2.0).sin(), (yaw / 2.0).cos()]
}

/// Heading (rad) of the quaternion with these z and w parts and no others.
pub fn yaw_from_quaternion([z, w]: [f64; 2]) -> f64 {
    2.0 * z.atan2(w)
}

/// The pose of the robot (base_link) in the map's frame at a moment, as a source reported it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StampedPose {
    /// Moment for which the pose holds (ns), on the clock of the scans that go with it.
    pub stamp_ns: i64,
    /// When it was received (ns, host's monotonic clock); `stamp_ns` where the input does not tell.
    pub received_ns: i64,
    /// base_link in the map's (or odometry's) frame.
    pub pose: Pose,
    /// Covariance xx, xy, xa, yy, ya, aa (m2, m rad, rad2), where the source gives one.
    pub covariance: Option<[f64; 6]>,
    /// Counts the jumps of the source: poses with different counts must not be interpolated.
    pub reset: u32,
}
