//! A scan in SI units and in the scanner's own frame (REP-103: x forward, y left, counter-clockwise
//! positive), as every input gives it: a live scanner, a recording, a bag, a Carmen log.

/// Where the beams of a scan point and when they were fired.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry {
    /// Bearing of the first beam in the scanner's frame (rad).
    pub angle_min: f64,
    /// Step from a beam to the next (rad); negative for a scanner mounted upside down.
    pub angle_increment: f64,
    /// Time from a beam to the next (s); 0 where all beams are taken at once.
    pub time_increment: f64,
    /// Nearest and farthest distance that the scanner measures (m); what lies outside is not a distance.
    pub range_min: f64,
    /// See `range_min`.
    pub range_max: f64,
}

/// One turn of the scanner.
#[derive(Clone, Debug, PartialEq)]
pub struct Scan {
    /// Number of the scan among all that the device sent or should have sent. A step of more than one
    /// means that scans were lost in between, which ends the runs of observation in the grid.
    pub seq: u64,
    /// Time of the first beam (ns), on the clock of the poses that go with it.
    pub stamp_ns: i64,
    /// When the last byte of the scan had been received (ns, host's monotonic clock); `stamp_ns` where
    /// the input does not tell.
    pub received_ns: i64,
    /// Where the beams point.
    pub geometry: Geometry,
    /// Range of each beam (m). REP-117: `+inf` nothing in range, `-inf` too near, `NaN` no valid
    /// measurement. Every finite value lies in `range_min..=range_max`.
    pub ranges: Vec<f32>,
    /// Intensity of each beam in the device's own unit; empty where the input has none.
    pub intensities: Vec<f32>,
}

impl Scan {
    /// Time of the last beam (ns).
    pub fn end_ns(&self) -> i64 {
        let last = self.ranges.len().saturating_sub(1) as f64;
        self.stamp_ns + (last * self.geometry.time_increment * 1e9).round() as i64
    }
}
