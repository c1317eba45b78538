//! What the threads tell each other beside the queues: single numbers and flags, and counts that main reports.
//!
//! The locks guard small values and are held for a copy only.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::mapper::MapperReport;
use crate::report::PoseCounts;

/// See the module.
#[derive(Debug, Default)]
pub struct Shared {
    /// The driver is to turn the laser off and end.
    pub stop_driver: AtomicBool,
    /// The pose thread is to end.
    pub stop_poses: AtomicBool,
    /// Turns of the driver's loop: waiting for a device counts as well.
    pub driver_steps: Steps,
    /// Turns of the mapper's loop: waiting for a scan counts as well.
    pub mapper_steps: Steps,
    /// Scans that the decoder gave.
    pub scans: AtomicU64,
    /// Whether a connection is open.
    pub is_open: AtomicBool,
    /// Whether a connection was ever open.
    pub was_open: AtomicBool,
    /// What the decoder could not use, by kind.
    pub decode_errors: Mutex<BTreeMap<String, u64>>,
    /// The device as far as it is known.
    pub device: Mutex<Option<Arc<scip::Device>>>,
    /// What the mapper has done, a second ago at most.
    pub mapper: Mutex<Option<MapperReport>>,
    /// Poses taken and not.
    pub poses: Mutex<PoseCounts>,
}

/// A count of turns of a loop that another thread watches.
#[derive(Debug, Default)]
pub struct Steps(AtomicU64);

impl Steps {
    /// One more.
    pub fn count(&self) {
        self.0.fetch_add(1, Relaxed);
    }

    /// How many so far.
    pub fn get(&self) -> u64 {
        self.0.load(Relaxed)
    }
}

/// Locks, also after another thread panicked while it held the lock: counts stay readable for the last report.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
