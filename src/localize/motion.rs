//! Where the scanner is and how it moves, with what is known of either: a Kalman filter over pose and velocity.
//!
//! Not the matcher: a match comes in as a pose with its information.

use super::matcher::{Match, Prior, difference};
use crate::pose::{Pose, pose};
use nalgebra::{Matrix3, Matrix6, Vector2, Vector3};

/// Change of the velocity that is expected without odometry (m/s2, rad/s2): a robot of 1 m/s that starts or brakes within
/// half a second, and one that reaches 2 rad/s within as much.
const ACCELERATION: [f64; 2] = [2.0, 4.0];
/// Odometry's error along and across a metre driven (m) and in its heading (rad), as a walk at random: what a scale
/// error of 1 % and slip of 0.25 degree a metre add up to within the metres over which matches average.
const ODOMETRY: [f64; 3] = [0.02, 0.01, 0.03];
/// ... and in the heading for each radian turned (rad).
const ODOMETRY_TURN: f64 = 0.02;
/// Odometry's error where the wheels stand, for each second (m, rad).
const ODOMETRY_REST: [f64; 2] = [0.002, 0.001];
/// Deviation of a velocity that odometry gives (m/s, rad/s).
const ODOMETRY_VELOCITY: [f64; 2] = [0.1, 0.1];
/// Deviation of what no prediction sees coming: a kerb, a push (m, rad).
const SUDDEN: [f64; 2] = [0.03, 0.02];
/// Deviation of the first velocity where nothing tells it (m/s, rad/s): the drive may have begun already.
const FIRST_VELOCITY: [f64; 2] = [1.0, 1.0];
/// Variance that a pose has at least (m2, rad2), so that all matrices can be inverted.
const FLOOR: f64 = 1e-10;

/// See the module. Poses and velocities are the scanner's, in the map.
#[derive(Clone, Debug)]
pub struct Motion {
    /// Moment for which all holds (ns).
    pub stamp_ns: i64,
    /// Pose.
    pub pose: Pose,
    /// Velocity in the map's frame: x, y (m/s), heading (rad/s).
    pub velocity: Vector3<f64>,
    /// Covariance of x, y, heading and their velocities.
    covariance: Matrix6<f64>,
}

impl Motion {
    /// At a known place, moving nobody knows how.
    pub fn new(stamp_ns: i64, pose: Pose) -> Motion {
        let mut covariance = Matrix6::identity() * FLOOR;
        set_velocity_variance(&mut covariance, FIRST_VELOCITY);
        Motion { stamp_ns, pose, velocity: Vector3::zeros(), covariance }
    }

    /// Covariance of x, y (m2) and heading (rad2).
    pub fn pose_covariance(&self) -> Matrix3<f64> {
        self.covariance.fixed_view::<3, 3>(0, 0).into_owned()
    }

    /// The same for `seconds` from now, where it moves on evenly.
    pub fn covariance_ahead(&self, seconds: f64) -> Matrix3<f64> {
        let part = |row: usize, column: usize| self.covariance.fixed_view::<3, 3>(row, column).into_owned();
        part(0, 0) + (part(0, 3) + part(3, 0)) * seconds + part(3, 3) * (seconds * seconds)
    }

    /// The largest deviation of the place (m) and that of the heading (rad).
    pub fn sigmas(&self) -> [f64; 2] {
        let c = &self.covariance;
        let half = (c[(0, 0)] + c[(1, 1)]) / 2.0;
        let difference = (c[(0, 0)] - c[(1, 1)]) / 2.0;
        let most = half + (difference * difference + c[(0, 1)] * c[(0, 1)]).sqrt();
        [most.max(0.0).sqrt(), c[(2, 2)].max(0.0).sqrt()]
    }

    /// The scanner `seconds` from now, in its own frame now, where it moves on evenly.
    pub fn ahead(&self, seconds: f64) -> Pose {
        let way = Vector2::new(self.velocity.x, self.velocity.y) * seconds;
        let own = self.pose.rotation.inverse() * way;
        pose(own.x, own.y, self.velocity.z * seconds)
    }

    /// Moves on evenly.
    pub fn coast(&mut self, stamp_ns: i64) {
        let dt = seconds(self.stamp_ns, stamp_ns);
        self.stamp_ns = stamp_ns;
        self.pose *= self.ahead(dt);
        // A robot that drives and turns drives to where it turns.
        let turned =
            nalgebra::UnitComplex::new(self.velocity.z * dt) * Vector2::new(self.velocity.x, self.velocity.y);
        self.velocity = Vector3::new(turned.x, turned.y, self.velocity.z);
        let mut step = Matrix6::identity();
        for i in 0..3 {
            step[(i, i + 3)] = dt;
        }
        self.covariance = step * self.covariance * step.transpose();
        for i in 0..3 {
            let variance = ACCELERATION[usize::from(i == 2)].powi(2) * dt * dt;
            self.covariance[(i, i)] += variance * dt * dt / 4.0 + FLOOR;
            self.covariance[(i, i + 3)] += variance * dt / 2.0;
            self.covariance[(i + 3, i)] += variance * dt / 2.0;
            self.covariance[(i + 3, i + 3)] += variance;
        }
    }

    /// Moves as odometry says: `by` is the scanner at `stamp_ns` in its own frame before.
    pub fn drive(&mut self, stamp_ns: i64, by: &Pose) {
        let dt = seconds(self.stamp_ns, stamp_ns);
        let before = self.pose;
        self.stamp_ns = stamp_ns;
        self.pose *= by;
        let moved = difference(&self.pose, &before);
        let mut step = Matrix3::identity();
        (step[(0, 2)], step[(1, 2)]) = (-moved.y, moved.x);
        let mut covariance = step * self.pose_covariance() * step.transpose();
        let (way, turn) = (by.translation.vector.norm(), moved.z.abs());
        // Along and across the way that was driven, or forward and left where it was none.
        let direction = if way > 1e-9 { Vector2::new(moved.x, moved.y) / way } else { Vector2::x() };
        let rest = ODOMETRY_REST[0].powi(2) * dt;
        let along = ODOMETRY[0].powi(2) * way + rest;
        let across = ODOMETRY[1].powi(2) * way + rest;
        let (c, s) = (direction.x, direction.y);
        covariance[(0, 0)] += along * c * c + across * s * s + FLOOR;
        covariance[(1, 1)] += along * s * s + across * c * c + FLOOR;
        covariance[(0, 1)] += (along - across) * c * s;
        covariance[(1, 0)] += (along - across) * c * s;
        covariance[(2, 2)] +=
            ODOMETRY[2].powi(2) * way + ODOMETRY_TURN.powi(2) * turn + ODOMETRY_REST[1].powi(2) * dt + FLOOR;
        self.covariance = Matrix6::zeros();
        self.covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&covariance);
        set_velocity_variance(&mut self.covariance, ODOMETRY_VELOCITY);
        if dt > 0.0 {
            self.velocity = moved / dt;
        }
    }

    /// Whether the scanner can be there, within four deviations told three times as large as they are, and
    /// `SUDDEN`.
    pub fn allows(&self, pose: &Pose) -> bool {
        let mut covariance = self.pose_covariance() * 9.0;
        for (i, sudden) in [SUDDEN[0], SUDDEN[0], SUDDEN[1]].into_iter().enumerate() {
            covariance[(i, i)] += sudden * sudden;
        }
        let off = difference(pose, &self.pose);
        covariance.try_inverse().is_some_and(|information| off.dot(&(information * off)) <= 16.0)
    }

    /// What is expected of a match.
    pub fn prior(&self) -> Prior {
        let information = self.pose_covariance().try_inverse().unwrap_or_else(Matrix3::zeros);
        Prior { pose: self.pose, information }
    }

    /// Takes in a match that was made with [`Motion::prior`].
    pub fn correct(&mut self, found: &Match) {
        let before = self.pose_covariance();
        let Some(prior) = before.try_inverse() else { return };
        let Some(after) = (prior + found.information).try_inverse() else { return };
        let after = (after + after.transpose()) / 2.0;
        let pull = self.covariance.fixed_view::<3, 3>(3, 0) * prior;
        self.velocity += pull * difference(&found.pose, &self.pose);
        let mixed = pull * after;
        let velocity = self.covariance.fixed_view::<3, 3>(3, 3) - pull * (before - after) * pull.transpose();
        self.covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&after);
        self.covariance.fixed_view_mut::<3, 3>(3, 0).copy_from(&mixed);
        self.covariance.fixed_view_mut::<3, 3>(0, 3).copy_from(&mixed.transpose());
        self.covariance.fixed_view_mut::<3, 3>(3, 3).copy_from(&velocity);
        self.pose = found.pose;
    }

    /// Is where somebody else says.
    pub fn given(&mut self, stamp_ns: i64, pose: Pose) {
        let dt = seconds(self.stamp_ns, stamp_ns);
        let moved = difference(&pose, &self.pose);
        self.velocity = if dt > 0.0 { moved / dt } else { Vector3::zeros() };
        (self.stamp_ns, self.pose) = (stamp_ns, pose);
        self.covariance = Matrix6::identity() * FLOOR;
        set_velocity_variance(&mut self.covariance, ODOMETRY_VELOCITY);
    }

    /// Is somewhere else all at once, found by a search as well as `found` says.
    pub fn jump(&mut self, found: &Match) {
        self.pose = found.pose;
        let covariance = found.information.try_inverse().unwrap_or_else(Matrix3::identity);
        self.covariance = Matrix6::zeros();
        self.covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&covariance);
        set_velocity_variance(&mut self.covariance, FIRST_VELOCITY);
        self.velocity = Vector3::zeros();
    }
}

fn set_velocity_variance(covariance: &mut Matrix6<f64>, [place, heading]: [f64; 2]) {
    for (i, sigma) in [place, place, heading].into_iter().enumerate() {
        covariance[(i + 3, i + 3)] = sigma * sigma;
    }
}

fn seconds(from_ns: i64, to_ns: i64) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 * 1e-9
}
