//! A simulated drive with what may go wrong on it: lost scans, random returns, odometry that stops or slips.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scipsim::{PoseSource, Simulation, SimulationOptions, World, simulation};
use visagged::{
    mapper::Mount,
    pose::{Pose, StampedPose},
    scan::{Geometry, Scan},
};

/// What goes wrong.
#[derive(Clone, Copy, Debug, Default)]
pub struct Trouble {
    /// Share of the scans that are lost, in runs of one to four.
    pub lost_scans: f64,
    /// Share of the returns that lie anywhere before their true place.
    pub random_returns: f64,
    /// By this part what is to the left seems too far and what is to the right too near: walls are bent, and a drive with them.
    pub bent: f64,
    /// Odometry is missing for every second second.
    pub half_odometry: bool,
    /// The wheels slip by 20 % for one second in ten.
    pub slip: bool,
    /// Seconds of the drive that are left out at its start.
    pub skip: f64,
}

/// A drive and its truth.
pub struct Drive {
    /// What arrived, in order.
    pub scans: Vec<Scan>,
    /// Wheel odometry.
    pub odometry: Vec<StampedPose>,
    /// The robot at the first beam of each scan.
    pub truth: Vec<Pose>,
    /// Where the laser is.
    pub mount: Mount,
}

impl Drive {
    /// Simulates a drive.
    pub fn new(world: &World, seed: u64, trouble: Trouble) -> Drive {
        let options = SimulationOptions {
            seed,
            poses: PoseSource::Wheels,
            intensity: false,
            keep_truth: false,
            ..Default::default()
        };
        let mut simulation = Simulation::new(world, options);
        let pose = simulation.mount();
        let mount = Mount {
            x: pose.translation.x,
            y: pose.translation.y,
            yaw: pose.rotation.angle(),
            upside_down: false,
        };
        let begin_ns = (trouble.skip * 1e9) as i64;
        let odometry = odometry(&simulation, begin_ns, trouble);
        let geometry = Geometry {
            angle_min: -(simulation::FRONT_STEP as f64) * simulation::STEP_ANGLE,
            angle_increment: simulation::STEP_ANGLE,
            time_increment: simulation.time_increment(),
            range_min: f64::from(simulation::DMIN) / 1e3,
            range_max: f64::from(simulation::DMAX) / 1e3,
        };
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let (mut scans, mut truth, mut losing) = (Vec::new(), Vec::new(), 0);
        while let Some(scan) = simulation.next() {
            if losing == 0 && random.random_bool((trouble.lost_scans / 2.5).min(1.0)) {
                losing = random.random_range(1..=4);
            }
            if losing > 0 {
                losing -= 1;
                continue;
            }
            if scan.t_ns < begin_ns {
                continue;
            }
            let mut ranges: Vec<f32> = scan.distances_mm.iter().map(|&mm| metres(mm)).collect();
            for (beam, range) in ranges.iter_mut().enumerate() {
                let bearing = geometry.angle_min + beam as f64 * geometry.angle_increment;
                *range *= (1.0 + trouble.bent * bearing.sin()) as f32;
                if random.random_bool(trouble.random_returns) {
                    let farthest = if range.is_finite() { *range } else { 10.0 };
                    *range = random.random_range(0.1..farthest.max(0.2));
                }
            }
            truth.push(simulation.true_pose(scan.t_ns));
            scans.push(Scan {
                seq: scan.seq,
                stamp_ns: scan.t_ns,
                received_ns: scan.t_ns + simulation.period_ns(),
                geometry,
                ranges,
                intensities: Vec::new(),
            });
        }
        Drive { scans, odometry, truth, mount }
    }
}

fn odometry(simulation: &Simulation, begin_ns: i64, trouble: Trouble) -> Vec<StampedPose> {
    // Odometry begins at the true pose; slip is laid on top of its steps.
    let mut at: Option<(Pose, Pose)> = None;
    let mut poses = Vec::new();
    for reported in simulation.reported_poses(begin_ns, simulation.duration_ns() + 1_000_000_000) {
        let second = reported.t_ns / 1_000_000_000;
        let pose = match at {
            None => simulation.true_pose(reported.t_ns),
            Some((before, pose)) => {
                let mut step = before.inverse() * reported.pose;
                if trouble.slip && second % 10 == 5 {
                    step.translation.vector *= 1.2;
                }
                pose * step
            }
        };
        at = Some((reported.pose, pose));
        if trouble.half_odometry && second % 2 == 1 {
            continue;
        }
        let stamp_ns = reported.t_ns;
        poses.push(StampedPose { stamp_ns, received_ns: stamp_ns, pose, covariance: None, reset: 0 });
    }
    poses
}

fn metres(mm: u32) -> f32 {
    match mm {
        simulation::CODE_NOTHING => f32::INFINITY,
        simulation::CODE_TOO_NEAR => f32::NEG_INFINITY,
        0..simulation::DMIN => f32::NAN,
        simulation::DMIN..=simulation::DMAX => mm as f32 / 1e3,
        _ => f32::INFINITY,
    }
}
