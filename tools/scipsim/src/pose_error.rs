//! How reported poses differ from the true ones: the wandering of a localizer, the drift of wheel odometry.
//! Errors go with the way driven, not with time: a robot that stands has a constant error.

use crate::drive::{Drive, Pose, pose};
use crate::geometry::{Vector, angle_difference};
use crate::noise::{Random, SmoothNoise};

/// Where poses come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseSource {
    /// An outside localizer: 1.2 to 2 cm and 0.2 degrees of error that wander with the way.
    Localizer,
    /// Wheel odometry: scale off by about 1 %, heading drifting with slip; starts at the true pose.
    Wheels,
    /// The truth.
    Exact,
}

/// Deviation of a localizer's position error (m); each seed takes one value out of this range.
const POSITION: [f64; 2] = [0.012, 0.020];
/// Deviation of its heading error (rad): 0.2 degrees.
const HEADING: f64 = 0.2 * std::f64::consts::PI / 180.0;
/// Way over which a localizer's error becomes another one (m).
const WANDER: f64 = 1.5;
/// Deviation of the wheels' scale.
const SCALE: f64 = 0.01;
/// Deviation of the slip: heading error a metre (rad/m), wandering over [`SLIP_WANDER`] metres.
const SLIP: f64 = 0.004;
const SLIP_WANDER: f64 = 8.0;
/// Spacing at which odometry is integrated (s).
const INTEGRATION: f64 = 0.02;

/// The error of one drive.
#[derive(Clone, Debug)]
pub enum PoseError {
    /// See [`PoseSource::Exact`].
    None,
    /// See [`PoseSource::Localizer`].
    Wander {
        /// Errors in x, y, heading.
        noise: [SmoothNoise; 3],
        /// Deviation of the position (m).
        position: f64,
        /// Deviation of the heading (rad).
        heading: f64,
    },
    /// See [`PoseSource::Wheels`]: a pose every 20 ms of the drive.
    Odometry(Vec<(f64, f64, f64)>),
}

impl PoseError {
    /// Error of a drive; `factor` scales it.
    pub fn new(source: PoseSource, seed: u64, factor: f64, drive: &Drive) -> PoseError {
        let mut random = Random::new(&[seed, 0x9052]);
        match source {
            PoseSource::Exact => PoseError::None,
            PoseSource::Localizer => PoseError::Wander {
                noise: [0, 1, 2].map(|axis| SmoothNoise::new(&[seed, 0x9053, axis], WANDER)),
                position: factor * random.uniform(POSITION[0], POSITION[1]),
                heading: factor * HEADING,
            },
            PoseSource::Wheels => {
                let scale = 1.0 + factor * SCALE * random.normal().clamp(-2.0, 2.0);
                let slip = SmoothNoise::new(&[seed, 0x9054], SLIP_WANDER);
                PoseError::Odometry(odometry(drive, scale, factor * SLIP, &slip))
            }
        }
    }

    /// The reported pose at `time` (s).
    pub fn report(&self, drive: &Drive, time: f64) -> Pose {
        match self {
            PoseError::None => drive.pose(time),
            PoseError::Wander { noise, position, heading } => {
                let truth = drive.pose(time);
                let way = drive.way(time);
                let [dx, dy, turn] = [0, 1, 2].map(|axis: usize| noise[axis].value(way));
                let at = truth.translation.vector + Vector::new(dx, dy) * *position;
                pose(at.x, at.y, truth.rotation.angle() + turn * heading)
            }
            PoseError::Odometry(track) => {
                let place = (time / INTEGRATION).max(0.0);
                let i = (place as usize).min(track.len() - 1);
                let (a, b) = (track[i], track[(i + 1).min(track.len() - 1)]);
                let t = (place - i as f64).clamp(0.0, 1.0);
                let mix = |a: f64, b: f64| a + (b - a) * t;
                pose(mix(a.0, b.0), mix(a.1, b.1), mix(a.2, b.2))
            }
        }
    }
}

/// Integrates the true movements, scaled and with slip; headings are not wrapped.
fn odometry(drive: &Drive, scale: f64, slip_size: f64, slip: &SmoothNoise) -> Vec<(f64, f64, f64)> {
    let start = drive.pose(0.0);
    let mut yaw = start.rotation.angle();
    let mut at = start.translation.vector;
    let mut track = vec![(at.x, at.y, yaw)];
    let mut last = start;
    for i in 1..=(drive.duration() / INTEGRATION).ceil() as usize {
        let time = i as f64 * INTEGRATION;
        let now = drive.pose(time);
        let moved = last.inverse() * now;
        let way = moved.translation.vector.norm();
        let turn = angle_difference(now.rotation.angle(), last.rotation.angle());
        at += nalgebra::UnitComplex::new(yaw) * moved.translation.vector * scale;
        yaw += turn * scale + slip_size * slip.value(drive.way(time)) * way;
        track.push((at.x, at.y, yaw));
        last = now;
    }
    track
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::{Simulation, SimulationOptions};
    use crate::world::World;

    fn errors(world: &str, poses: PoseSource) -> Vec<(f64, f64)> {
        let world = World::load(world).unwrap();
        let simulation = Simulation::new(&world, SimulationOptions { poses, ..Default::default() });
        simulation
            .reported_poses(0, simulation.duration_ns())
            .iter()
            .map(|r| {
                let truth = simulation.true_pose(r.t_ns);
                let off = r.pose.translation.vector - truth.translation.vector;
                (off.norm(), angle_difference(r.pose.rotation.angle(), truth.rotation.angle()))
            })
            .collect()
    }

    #[test]
    fn a_localizer_is_off_by_centimetres_and_by_a_constant_where_the_robot_stands() {
        let off = errors("hall", PoseSource::Localizer);
        let rms = (off.iter().map(|o| o.0 * o.0).sum::<f64>() / off.len() as f64).sqrt();
        assert!((0.014..0.034).contains(&rms), "{rms}");
        assert!(off.iter().all(|o| o.1.abs() < 0.02));
        let parked = errors("parked-crowd", PoseSource::Localizer);
        assert!(parked.iter().all(|o| (o.0 - parked[0].0).abs() < 1e-12));
    }

    #[test]
    fn wheels_start_right_and_drift() {
        let off = errors("hall", PoseSource::Wheels);
        assert!(off[0].0 < 1e-9);
        let last = off[off.len() - 1].0;
        assert!((0.05..5.0).contains(&last), "{last}");
        assert!(errors("hall", PoseSource::Exact).iter().all(|o| o.0 == 0.0));
    }
}
