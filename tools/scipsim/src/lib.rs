//! A simulated Hokuyo scanner: a 2-D world of glass, mirrors, metal and people, what a scanner would measure there,
//! and a device that serves it as SCIP 2.0. For tests, demos and the measuring of maps.
//!
//! - [`world`]: worlds as TOML; [`generate`]: more of them from a seed; [`scene`], [`geometry`], [`drive`]: the same, made ready to be looked at over time.
//! - [`light`]: what a beam brings back. [`simulation`]: a drive in virtual time; [`pose_error`]: its reported poses.
//! - [`device`]: the SCIP responder, on a pty or TCP in real time; [`pose_message`]: its poses as datagrams.
//! - [`truth`] and [`mod@score`]: what a map should look like, and how near one comes.
//!
//! ```
//! use scipsim::{Simulation, SimulationOptions, World};
//! let world = World::load("hall")?;
//! let mut simulation = Simulation::new(&world, SimulationOptions::default());
//! let scan = simulation.next().expect("a drive has at least one scan");
//! assert_eq!(scan.distances_mm.len(), 1081);
//! # Ok::<(), scipsim::world::WorldError>(())
//! ```

pub mod device;
pub mod drive;
pub mod generate;
pub mod geometry;
pub mod light;
mod noise;
pub mod picture;
pub mod pose_error;
pub mod pose_message;
pub mod scene;
pub mod score;
pub mod simulation;
pub mod truth;
pub mod world;

pub use noise::SmoothNoise;
pub use pose_error::PoseSource;
pub use score::{Marked, Score, Share, score};
pub use simulation::{ReportedPose, SimScan, Simulation, SimulationOptions};
pub use truth::{Label, TruthMap};
pub use world::{World, WorldError};
