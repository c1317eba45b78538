//! A simulated device: the protocol ([`responder`]) without ports and threads, and what runs it on a pty or
//! TCP in real time ([`runner`]) or into a buffer in virtual time ([`capture`]).

pub mod capture;
pub mod fault;
mod options;
pub mod profile;
mod request;
pub mod responder;
pub mod runner;

pub use fault::Faults;
pub use options::{OptionsError, SpawnOptions, Transport};
pub use profile::Profile;
pub use responder::{DeviceSettings, Output, Responder, ScanSource};
pub use runner::{Port, Running, spawn};

use std::sync::Arc;

use crate::simulation::Simulation;

impl ScanSource for Arc<Simulation> {
    fn measure(&mut self, rotation: u64) -> (Vec<u32>, Vec<u32>) {
        let scan = self.scan_at(rotation);
        (scan.distances_mm, scan.intensities)
    }
}
