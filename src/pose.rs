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

/// Why there is no pose for a moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoPose {
    /// The moment lies after the last pose: one may still come.
    NotYet,
    /// The moment lies before the first pose that is kept.
    TooOld,
    /// The poses around it are too far apart to interpolate.
    Gap,
    /// The source jumped between the poses around it.
    Jump,
}

/// The poses of the last moments, by time.
#[derive(Debug, Default)]
pub struct PoseBuffer {
    poses: std::collections::VecDeque<StampedPose>,
}

impl PoseBuffer {
    /// Takes in a pose. Returns false, and leaves the buffer as it was, where it is not newer than the last one.
    pub fn push(&mut self, pose: StampedPose) -> bool {
        let newer = self.poses.back().is_none_or(|last| last.stamp_ns < pose.stamp_ns);
        if newer {
            self.poses.push_back(pose);
        }
        newer
    }

    /// The pose at a moment, between two that are at most `widest_gap_ns` apart.
    ///
    /// # Errors
    /// [`NoPose`] says why there is none; a pose is never extrapolated.
    pub fn at(&self, stamp_ns: i64, widest_gap_ns: i64) -> Result<Pose, NoPose> {
        let after = self.poses.partition_point(|pose| pose.stamp_ns < stamp_ns);
        let next = self.poses.get(after).ok_or(NoPose::NotYet)?;
        if next.stamp_ns == stamp_ns {
            return Ok(next.pose);
        }
        let before = self.poses.get(after.wrapping_sub(1)).ok_or(NoPose::TooOld)?;
        if before.reset != next.reset {
            return Err(NoPose::Jump);
        }
        let gap = next.stamp_ns - before.stamp_ns;
        if gap > widest_gap_ns {
            return Err(NoPose::Gap);
        }
        let part = (stamp_ns - before.stamp_ns) as f64 / gap as f64;
        Ok(interpolate(&before.pose, &next.pose, part))
    }

    /// The count of jumps at a moment, where poses reach that far.
    pub fn reset_at(&self, stamp_ns: i64) -> Option<u32> {
        let after = self.poses.partition_point(|pose| pose.stamp_ns < stamp_ns);
        self.poses.get(after).map(|pose| pose.reset)
    }

    /// Forgets what is older than the moment, except for the last pose before it.
    pub fn forget_before(&mut self, stamp_ns: i64) {
        while self.poses.get(1).is_some_and(|second| second.stamp_ns <= stamp_ns) {
            self.poses.pop_front();
        }
    }
}

/// The pose `part` (0..1) of the way from one to the other, turning the shorter way.
pub fn interpolate(from: &Pose, to: &Pose, part: f64) -> Pose {
    let position = from.translation.vector.lerp(&to.translation.vector, part);
    let turn = from.rotation.angle_to(&to.rotation) * part;
    Pose::from_parts(position.into(), UnitComplex::new(turn) * from.rotation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    fn stamped(stamp_ns: i64, x: f64, yaw: f64, reset: u32) -> StampedPose {
        StampedPose { stamp_ns, received_ns: stamp_ns, pose: pose(x, 0.0, yaw), covariance: None, reset }
    }

    #[test]
    fn poses_between_poses() {
        let mut buffer = PoseBuffer::default();
        assert_eq!(buffer.at(0, 100), Err(NoPose::NotYet));
        assert!(buffer.push(stamped(100, 1.0, PI - 0.1, 0)));
        assert!(buffer.push(stamped(200, 2.0, 0.1 - PI, 0)));
        assert!(!buffer.push(stamped(200, 9.0, 0.0, 0)), "not newer");
        let between = buffer.at(150, 100).unwrap();
        assert!((between.translation.x - 1.5).abs() < 1e-12);
        assert!((between.rotation.angle().abs() - PI).abs() < 1e-12, "the shorter way round");
        assert_eq!(buffer.at(99, 100), Err(NoPose::TooOld));
        assert_eq!(buffer.at(201, 100), Err(NoPose::NotYet));
        assert_eq!(buffer.at(150, 99), Err(NoPose::Gap));
        buffer.push(stamped(250, 3.0, 0.0, 1));
        assert_eq!(buffer.at(220, 100), Err(NoPose::Jump));
        assert_eq!(buffer.at(250, 1).map(|p| p.translation.x), Ok(3.0));
        buffer.forget_before(210);
        assert_eq!(buffer.at(150, 100), Err(NoPose::TooOld));
        assert_eq!(buffer.at(200, 100).map(|p| p.translation.x), Ok(2.0));
    }

    #[test]
    fn a_heading_survives_its_message() {
        for degrees in -180..180 {
            let yaw = yaw_from_quaternion(quaternion_from_yaw(f64::from(degrees).to_radians()));
            assert!((yaw - f64::from(degrees).to_radians()).abs() < 1e-12);
            let again = yaw_from_quaternion(quaternion_from_yaw(yaw));
            assert!((again - yaw).abs() < 1e-12);
        }
    }
}
