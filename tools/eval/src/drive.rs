//! A simulated drive, kept so that every mapper gets the very same scans and poses.

use scipsim::{Simulation, SimulationOptions, World, simulation, truth::TruthMap};
use visagged::{
    mapper::Mount,
    pose::StampedPose,
    scan::{Geometry, Scan},
};

/// A drive and its truth.
pub struct Drive {
    /// All scans.
    pub scans: Vec<Scan>,
    /// All poses as reported.
    pub poses: Vec<StampedPose>,
    /// Where the laser is.
    pub mount: Mount,
    /// Number of scans after which the map is marked, and the truth then.
    pub truths: Vec<(usize, TruthMap)>,
}

impl Drive {
    /// Simulates a drive and keeps the truth after each of `parts` even parts of it.
    pub fn new(world: &World, options: SimulationOptions, parts: usize) -> Drive {
        let mut simulation = Simulation::new(world, options);
        let total = (simulation.duration_ns() / simulation.period_ns()) as usize;
        let pose = simulation.mount();
        let mount = Mount {
            x: pose.translation.x,
            y: pose.translation.y,
            yaw: pose.rotation.angle(),
            upside_down: false,
        };
        let poses = simulation
            .reported_poses(0, simulation.duration_ns() + 1_000_000_000)
            .into_iter()
            .map(|reported| StampedPose {
                stamp_ns: reported.t_ns,
                received_ns: reported.t_ns,
                pose: reported.pose,
                covariance: None,
                reset: 0,
            })
            .collect();
        let geometry = Geometry {
            angle_min: -(simulation::FRONT_STEP as f64) * simulation::STEP_ANGLE,
            angle_increment: simulation::STEP_ANGLE,
            time_increment: simulation.time_increment(),
            range_min: f64::from(simulation::DMIN) / 1e3,
            range_max: f64::from(simulation::DMAX) / 1e3,
        };
        let mut scans = Vec::with_capacity(total);
        let mut truths = Vec::new();
        for number in 0..total {
            let Some(scan) = simulation.next() else { break };
            scans.push(Scan {
                seq: scan.seq,
                stamp_ns: scan.t_ns,
                received_ns: scan.t_ns + 25_000_000,
                geometry,
                ranges: scan.distances_mm.iter().map(|&mm| metres(mm)).collect(),
                intensities: scan.intensities.iter().map(|&value| value as f32).collect(),
            });
            if (number + 1) % (total / parts).max(1) == 0 && truths.len() + 1 < parts || number + 1 == total {
                truths.push((number + 1, simulation.truth()));
            }
        }
        Drive { scans, poses, mount, truths }
    }
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
