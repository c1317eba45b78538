//! A drive through a world in virtual time: scans with the truth of every beam, and poses.
//! No wall clock: scan number `k` is what a device would have measured `k` periods after the start.

use crate::drive::Pose;
use crate::light::{self, BeamTruth, Tracer};
use crate::noise::Random;
use crate::pose_error::{PoseError, PoseSource};
use crate::scene::{Overrides, Scene};
use crate::truth::{TruthMap, TruthRecorder};
use crate::world::World;

/// Beams of a scan (UTM-30LX: AMIN 0, AMAX 1080).
pub const BEAMS: usize = 1081;
/// Bearing from a step to the next (rad; ARES 1440).
pub const STEP_ANGLE: f64 = std::f64::consts::TAU / 1440.0;
/// The step that looks forward (AFRT).
pub const FRONT_STEP: usize = 540;
/// Code for "nothing in range" (a UTM-30LX's distances below DMIN are codes).
pub const CODE_NOTHING: u32 = 1;
/// Code for "too near".
pub const CODE_TOO_NEAR: u32 = 2;
/// Nearest distance (mm).
pub const DMIN: u32 = 23;
/// Farthest distance (mm).
pub const DMAX: u32 = 60_000;

/// How a world is simulated. `Default` is the world as it is written.
#[derive(Clone, Debug)]
pub struct SimulationOptions {
    /// Seed of all noise.
    pub seed: u64,
    /// Scans a second: 40, or 20 for a scanner at half speed.
    pub scan_rate: f64,
    /// Factor on the robot's speed.
    pub speed: f64,
    /// Lean of all specular surfaces (degrees), in place of the world's.
    pub lean_deg: Option<f64>,
    /// Factor on the dust of all specular surfaces.
    pub dust: f64,
    /// Posts on all panes, or on none; the world's own if `None`.
    pub frames: Option<bool>,
    /// Factor on reported intensities.
    pub intensity_gain: f64,
    /// Whether there are intensities.
    pub intensity: bool,
    /// Where reported poses come from.
    pub poses: PoseSource,
    /// Factor on the error of reported poses.
    pub pose_error: f64,
    /// Reported poses a second.
    pub pose_rate: f64,
    /// How long the robot stands before it sets out (s).
    pub start_delay: f64,
    /// Whether the truth map is kept while scans are taken; costs some memory and microseconds.
    pub keep_truth: bool,
}

impl Default for SimulationOptions {
    fn default() -> SimulationOptions {
        SimulationOptions {
            seed: 1,
            scan_rate: 40.0,
            speed: 1.0,
            lean_deg: None,
            dust: 1.0,
            frames: None,
            intensity_gain: 1.0,
            intensity: true,
            poses: PoseSource::Localizer,
            pose_error: 1.0,
            pose_rate: 100.0,
            start_delay: 0.5,
            keep_truth: true,
        }
    }
}

/// A scan with its truth.
#[derive(Clone, Debug, PartialEq)]
pub struct SimScan {
    /// Number of the scan, from 0.
    pub seq: u64,
    /// Time of the first beam since the start of the simulation (ns).
    pub t_ns: i64,
    /// As a UTM-30LX gives them (mm; below [`DMIN`]: codes).
    pub distances_mm: Vec<u32>,
    /// On the device's scale; empty where intensities are off. 0 where nothing returned.
    pub intensities: Vec<u32>,
    /// Where each reading truly comes from.
    pub truth: Vec<BeamTruth>,
}

/// A pose as a source reports it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReportedPose {
    /// Time since the start of the simulation (ns).
    pub t_ns: i64,
    /// base_link in the map's frame (localizer) or in the odometry's (wheels).
    pub pose: Pose,
}

/// A drive through a world.
#[derive(Debug)]
pub struct Simulation {
    scene: Scene,
    options: SimulationOptions,
    error: PoseError,
    next: u64,
    recorder: Option<TruthRecorder>,
}

impl Simulation {
    /// A simulation at its start.
    pub fn new(world: &World, options: SimulationOptions) -> Simulation {
        let overrides = Overrides {
            lean_deg: options.lean_deg,
            dust: Some(options.dust),
            frames: options.frames,
            speed: Some(options.speed),
            start_delay: options.start_delay,
            seed: options.seed,
        };
        let scene = Scene::new(world, &overrides);
        let error = PoseError::new(options.poses, options.seed, options.pose_error, scene.drive());
        let recorder = options.keep_truth.then(|| TruthRecorder::new(&scene));
        Simulation { scene, options, error, next: 0, recorder }
    }

    /// Time from the start of a scan to the start of the next (ns).
    pub fn period_ns(&self) -> i64 {
        (1e9 / self.options.scan_rate).round() as i64
    }

    /// Time from a beam to the next (s); 17.36 us at 40 Hz.
    pub fn time_increment(&self) -> f64 {
        1.0 / (self.options.scan_rate * 1440.0)
    }

    /// When the drive has ended (ns).
    pub fn duration_ns(&self) -> i64 {
        (self.scene.drive().duration() * 1e9) as i64
    }

    /// The options it was made with.
    pub fn options(&self) -> &SimulationOptions {
        &self.options
    }

    /// The laser in the robot's frame.
    pub fn mount(&self) -> Pose {
        self.scene.mount()
    }

    /// The scene behind it.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// base_link in the world at a time (ns).
    pub fn true_pose(&self, t_ns: i64) -> Pose {
        self.scene.drive().pose(t_ns as f64 * 1e-9)
    }

    /// base_link as the pose source gives it for a time (ns).
    pub fn reported_pose(&self, t_ns: i64) -> ReportedPose {
        ReportedPose { t_ns, pose: self.error.report(self.scene.drive(), t_ns as f64 * 1e-9) }
    }

    /// All reports with `from_ns <= t_ns < to_ns`, at the rate of the options.
    pub fn reported_poses(&self, from_ns: i64, to_ns: i64) -> Vec<ReportedPose> {
        let period = (1e9 / self.options.pose_rate).round() as i64;
        let first = from_ns.div_euclid(period) + i64::from(from_ns.rem_euclid(period) > 0);
        (first..).map(|k| k * period).take_while(|&t| t < to_ns).map(|t| self.reported_pose(t)).collect()
    }

    /// Scan number `seq`, whatever came before; not noted in the truth.
    pub fn scan_at(&self, seq: u64) -> SimScan {
        let t_ns = seq as i64 * self.period_ns();
        let start = t_ns as f64 * 1e-9;
        let increment = self.time_increment();
        let moment = self.scene.moment(start + increment * (BEAMS / 2) as f64);
        let mut tracer = Tracer::new(&self.scene, &moment);
        let mut random = Random::new(&[self.options.seed, 0x5ca4, seq]);
        let mut scan = SimScan {
            seq,
            t_ns,
            distances_mm: Vec::with_capacity(BEAMS),
            intensities: Vec::with_capacity(if self.options.intensity { BEAMS } else { 0 }),
            truth: Vec::with_capacity(BEAMS),
        };
        for step in 0..BEAMS {
            let time = start + increment * step as f64;
            let robot = self.scene.drive().pose(time);
            let laser = robot * self.scene.mount();
            let bearing = (step as f64 - FRONT_STEP as f64) * STEP_ANGLE;
            let direction = crate::geometry::heading(laser.rotation.angle() + bearing);
            let reading = tracer.read(laser.translation.vector, direction, robot, time, &mut random);
            scan.distances_mm.push(wire_distance(reading.range));
            if self.options.intensity {
                let value = light::intensity(reading.brightness) * self.options.intensity_gain;
                scan.intensities.push(value.round() as u32);
            }
            scan.truth.push(reading.truth);
        }
        scan
    }

    /// The truth of all scans so far, as of the start of the latest one.
    ///
    /// # Panics
    /// If the options have `keep_truth` off.
    pub fn truth(&self) -> TruthMap {
        let now = (self.next.saturating_sub(1)) as i64 * self.period_ns();
        self.recorder.as_ref().expect("keep_truth is on").map(&self.scene, now as f64 * 1e-9)
    }
}

/// Scans until the drive ends.
impl Iterator for Simulation {
    type Item = SimScan;

    fn next(&mut self) -> Option<SimScan> {
        if self.next as i64 * self.period_ns() > self.duration_ns() {
            return None;
        }
        let scan = self.scan_at(self.next);
        self.next += 1;
        if let Some(mut recorder) = self.recorder.take() {
            recorder.note(self, &scan);
            self.recorder = Some(recorder);
        }
        Some(scan)
    }
}

/// Distance as the device sends it.
fn wire_distance(range: Option<f64>) -> u32 {
    match range.map(|r| (r * 1000.0).round() as u32) {
        None => CODE_NOTHING,
        Some(mm) if mm < DMIN => CODE_TOO_NEAR,
        Some(mm) if mm > DMAX => CODE_NOTHING,
        Some(mm) => mm,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_determines_everything_and_another_changes_it() {
        let world = World::load("hall").unwrap();
        let scans = |seed| {
            let options = SimulationOptions { seed, ..Default::default() };
            Simulation::new(&world, options).skip(100).take(3).collect::<Vec<_>>()
        };
        assert_eq!(scans(3), scans(3));
        assert_ne!(scans(3)[0].distances_mm, scans(4)[0].distances_mm);
        let simulation = Simulation::new(&world, SimulationOptions { seed: 3, ..Default::default() });
        assert_eq!(simulation.scan_at(101), scans(3)[1]);
    }

    #[test]
    fn the_hall_takes_about_70_seconds_and_shows_every_kind_of_return() {
        let world = World::load("hall").unwrap();
        let mut simulation = Simulation::new(&world, SimulationOptions::default());
        let seconds = simulation.duration_ns() as f64 * 1e-9;
        assert!((60.0..85.0).contains(&seconds), "{seconds}");
        // Every tenth scan is enough to see them all.
        let mut routes = [0usize; 3];
        let (mut people, mut glints) = (0, 0);
        let count = simulation.duration_ns() / simulation.period_ns();
        for seq in (0..count as u64).step_by(10) {
            let scan = simulation.scan_at(seq);
            for truth in &scan.truth {
                routes[truth.route as usize] += 1;
                people += usize::from(matches!(truth.source, crate::light::Source::Person(_)));
            }
            glints += scan.intensities.iter().filter(|&&i| i > 8000).count();
        }
        assert!(routes.iter().all(|&n| n > 500), "{routes:?}");
        assert!(people > 500 && glints > 50, "{people} {glints}");
        assert!(simulation.next().is_some());
    }
}
