//! One scan with its place in the stream and its times, in the device's units. Metres and radians begin
//! where [`Parameters`](crate::Parameters) are applied to it.

use crate::reply::FurtherEcho;
use crate::request::{ScanRequest, Text};

/// One scan as it came.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Scan {
    /// What it answers; `count` is the number of scans still to come (0 in an endless stream).
    pub request: ScanRequest,
    /// String of the request.
    pub text: Option<Text>,
    /// Number of the scan among all that the device sent or, by its stamps, should have sent: a step of
    /// more than one means lost scans.
    pub seq: u64,
    /// The device's clock as sent (24 bits, ms).
    pub stamp_ms: u32,
    /// The device's clock without wraps and resets (ms): never decreases, continues across reconnections.
    pub unwrapped_ms: i64,
    /// When the first byte was received (ns, as passed in).
    pub first_byte_ns: i64,
    /// When the last byte was received (ns, as passed in).
    pub last_byte_ns: i64,
    /// Host's monotonic time of the first step of this scan (ns), by the estimate of the device's clock;
    /// see [`ClockSource`](crate::ClockSource).
    pub stamp_ns: i64,
    /// First echo of each group of steps (mm), values below DMIN being codes.
    pub distances_mm: Vec<u32>,
    /// One for each distance, or empty (18 bits, device's unit).
    pub intensities: Vec<u32>,
    /// Second and third echoes.
    pub more_echoes: Vec<FurtherEcho>,
}

impl Scan {
    /// Step that the distance of this index begins at.
    pub fn step(&self, index: usize) -> u32 {
        u32::from(self.request.start) + index as u32 * u32::from(self.request.steps_per_group())
    }
}
