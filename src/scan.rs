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

/// Metres of a distance on the wire, as near as `f32` can say it.
fn metres(distance_mm: u32) -> f32 {
    distance_mm as f32 / 1000.0
}

impl Geometry {
    /// Geometry of what `request` asks for on a device with these `parameters`.
    ///
    /// With a cluster of `n` steps the device sends the smallest distance of each group (SCIP 2.0, C-42-03320B)
    /// and does not say which step it came from. The bearing is that of the group's middle, and so is the time:
    /// the error is at most half a group to either side, where the first step's would be a whole group to one.
    pub fn from_scip(request: &scip::ScanRequest, parameters: &scip::Parameters) -> Self {
        let group = f64::from(request.steps_per_group());
        let middle = (group - 1.0) / 2.0;
        let turn_s = 60.0 / f64::from(parameters.rpm);
        Self {
            angle_min: parameters.bearing(f64::from(request.start) + middle),
            angle_increment: group * parameters.bearing_per_step(),
            time_increment: group * turn_s / f64::from(parameters.steps_per_turn),
            range_min: metres(parameters.min_mm).into(),
            range_max: metres(parameters.max_mm).into(),
        }
    }
}

impl Scan {
    /// The scan in SI units: codes become `+inf`, `-inf` and `NaN` by REP-117, by the model's table of codes.
    ///
    /// Only first echoes are kept. A last group of fewer steps than the others, whose middle lies elsewhere, is
    /// left out.
    pub fn from_scip(scan: &scip::Scan, parameters: &scip::Parameters) -> Self {
        let geometry = Geometry::from_scip(&scan.request, parameters);
        let whole_groups = scan.request.value_counts().0;
        let to_middle = (f64::from(scan.request.steps_per_group()) - 1.0) / 2.0;
        let step_ns = parameters.turn_ns() as f64 / f64::from(parameters.steps_per_turn);
        Self {
            seq: scan.seq,
            stamp_ns: scan.stamp_ns + (to_middle * step_ns).round() as i64,
            received_ns: scan.last_byte_ns,
            geometry,
            ranges: scan
                .distances_mm
                .iter()
                .take(whole_groups)
                .map(|&mm| range(parameters.classify(mm)))
                .collect(),
            intensities: scan.intensities.iter().take(whole_groups).map(|&value| value as f32).collect(),
        }
    }
}

/// Range of a measurement (m, REP-117).
fn range(measurement: scip::Measurement) -> f32 {
    match measurement {
        scip::Measurement::Millimetres(mm) => metres(mm),
        scip::Measurement::NothingInRange => f32::INFINITY,
        scip::Measurement::TooNear => f32::NEG_INFINITY,
        scip::Measurement::Invalid(_) => f32::NAN,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn utm() -> scip::Parameters {
        scip::Parameters::of_model(scip::model::find("UTM-30LX").unwrap()).unwrap()
    }

    fn scan(start: u16, end: u16, cluster: u8, distances_mm: Vec<u32>) -> scip::Scan {
        let mut request = scip::ScanRequest::new(scip::ScanKind::MD, start, end);
        request.cluster = cluster;
        scip::Scan {
            request,
            text: None,
            seq: 3,
            stamp_ms: 5,
            unwrapped_ms: 5,
            first_byte_ns: 30,
            last_byte_ns: 40,
            stamp_ns: 1_000_000,
            distances_mm,
            intensities: Vec::new(),
            more_echoes: Vec::new(),
        }
    }

    #[test]
    fn codes_are_no_ranges() {
        let scan = Scan::from_scip(&scan(538, 543, 1, vec![1, 2, 3, 23, 60_000, 60_001]), &utm());
        assert_eq!(scan.ranges[..2], [f32::INFINITY, f32::NEG_INFINITY]);
        assert!(scan.ranges[2].is_nan());
        assert_eq!(scan.ranges[3..], [0.023, 60.0, f32::INFINITY]);
        let Geometry { range_min, range_max, .. } = scan.geometry;
        assert!(scan.ranges[3..5].iter().all(|&r| (range_min..=range_max).contains(&r.into())));
        assert_eq!((scan.seq, scan.stamp_ns, scan.received_ns), (3, 1_000_000, 40));
    }

    #[test]
    fn bearings_and_times_of_a_full_scan() {
        let scan = Scan::from_scip(&scan(0, 1080, 0, vec![1000; 1081]), &utm());
        let geometry = scan.geometry;
        assert!((geometry.angle_min + 135_f64.to_radians()).abs() < 1e-12);
        assert!((geometry.angle_increment - 0.25_f64.to_radians()).abs() < 1e-15);
        // 60 s / (2400 * 1440) a step: the last of 1081 beams is fired 18.75 ms after the first.
        assert_eq!(scan.end_ns() - scan.stamp_ns, 18_750_000);
    }

    #[test]
    fn a_group_points_to_its_middle_and_a_partial_one_is_left_out() {
        let scan = Scan::from_scip(&scan(540, 546, 3, vec![1000, 2000, 3000]), &utm());
        assert_eq!(scan.ranges, [1.0, 2.0]);
        assert!((scan.geometry.angle_min - 0.25_f64.to_radians()).abs() < 1e-12);
        assert!((scan.geometry.angle_increment - 0.75_f64.to_radians()).abs() < 1e-12);
        assert_eq!(scan.stamp_ns, 1_000_000 + 17_361);
    }
}
