//! The host's clocks. Only the threads of a live run look at them; all else is told the time.

use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};

use crate::pose_input::Clocks;

/// CLOCK_MONOTONIC (ns).
pub fn monotonic_ns() -> i64 {
    read(ClockId::Monotonic)
}

/// Both clocks, read together.
pub fn both() -> Clocks {
    Clocks { monotonic_ns: read(ClockId::Monotonic), realtime_ns: read(ClockId::Realtime) }
}

/// A time span from its nanoseconds; nothing for a negative one.
pub fn span(ns: i64) -> Duration {
    Duration::from_nanos(u64::try_from(ns).unwrap_or(0))
}

fn read(clock: ClockId) -> i64 {
    let time = clock_gettime(clock);
    time.tv_sec * 1_000_000_000 + time.tv_nsec
}
