//! A scan that was placed, kept small: 2.3 kB for one of 1081 beams.

use crate::{
    grid::{Grid, sweep::Sweep},
    localize::{LocalizeSettings, loops::Correction, points::Points},
    pose::{Pose, interpolate},
    scan::{Geometry, Scan},
};

/// What stands for no valid measurement, too near and nothing in range among ranges in mm.
const CODES: [(u16, f32); 3] = [(0, f32::NAN), (u16::MAX - 1, f32::NEG_INFINITY), (u16::MAX, f32::INFINITY)];
/// The longest range that can be kept (mm); a UXM-30LX-EW measures up to 60 m.
const LONGEST: f32 = (u16::MAX - 2) as f32;

/// See the module. Its intensities are not kept, so a map that is made anew has no glints.
#[derive(Clone, Debug)]
pub struct Placed {
    seq: u64,
    stamp_ns: i64,
    geometry: Geometry,
    ranges_mm: Box<[u16]>,
    /// The scanner at the first and last beam, as it was located.
    start: Pose,
    end: Pose,
    /// Way driven until there (m).
    way: f64,
    /// Whether it is one of those that tell where the drive led.
    is_key: bool,
}

impl Placed {
    /// Keeps a scan: the scanner at its first and last beam, the way until there (m).
    pub fn new(scan: &Scan, [start, end]: [Pose; 2], way: f64, is_key: bool) -> Placed {
        Placed {
            seq: scan.seq,
            stamp_ns: scan.stamp_ns,
            geometry: scan.geometry,
            ranges_mm: scan.ranges.iter().map(|&range| millimetres(range)).collect(),
            start,
            end,
            way,
            is_key,
        }
    }

    /// Memory that it holds (bytes).
    pub fn bytes(&self) -> usize {
        size_of_val(self) + size_of_val(&*self.ranges_mm)
    }

    /// Its number.
    #[cfg(test)]
    pub fn seq(&self) -> u64 {
        self.seq
    }

    /// Time of its first beam (ns).
    pub fn stamp_ns(&self) -> i64 {
        self.stamp_ns
    }

    /// Way driven until there (m).
    pub fn way(&self) -> f64 {
        self.way
    }

    /// Whether it is one of those that tell where the drive led.
    pub fn is_key(&self) -> bool {
        self.is_key
    }

    /// The scanner in its middle.
    pub fn middle(&self) -> Pose {
        interpolate(&self.start, &self.end, 0.5)
    }

    /// The scanner at its first beam, in a drive that is bent like this.
    pub fn start(&self, bent: Option<&Correction>) -> Pose {
        bent.map_or(self.start, |bent| bent.correct(self.way, &self.start))
    }

    /// Puts it where it belongs in a drive that is bent like this.
    pub fn insert(&self, grid: &mut Grid, bent: &Correction) {
        let [start, end] = [self.start, self.end].map(|pose| bent.correct(self.way, &pose));
        grid.insert(&Sweep { scan: &self.scan(), start, end });
    }

    /// Its points, as they lie around its middle.
    pub fn points(&self, settings: &LocalizeSettings) -> Points {
        let to_middle = self.middle().inverse();
        let mut points = Points::default();
        let [start, end] = [self.start, self.end].map(|pose| to_middle * pose);
        points.read(&self.scan(), start, end, settings.spacing, settings.points);
        points
    }

    fn scan(&self) -> Scan {
        Scan {
            seq: self.seq,
            stamp_ns: self.stamp_ns,
            received_ns: self.stamp_ns,
            geometry: self.geometry,
            ranges: self.ranges_mm.iter().map(|&mm| metres(mm)).collect(),
            intensities: Vec::new(),
        }
    }
}

/// A range as it is kept. Those of a scanner come in whole millimetres, and come back with every bit.
fn millimetres(range: f32) -> u16 {
    if range.is_finite() {
        return (range * 1000.0).round().clamp(1.0, LONGEST) as u16;
    }
    let is_same = |code: f32| code == range || code.is_nan() && range.is_nan();
    CODES.iter().find(|(_, code)| is_same(*code)).map_or(0, |(mm, _)| *mm)
}

fn metres(mm: u16) -> f32 {
    CODES.iter().find(|(code, _)| *code == mm).map_or(f32::from(mm) / 1000.0, |(_, range)| *range)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_of_a_scanner_come_back_with_every_bit() {
        for mm in 1..u16::MAX - 1 {
            let range = f32::from(mm) / 1000.0;
            assert_eq!(metres(millimetres(range)).to_bits(), range.to_bits(), "{mm} mm");
        }
        for code in [f32::INFINITY, f32::NEG_INFINITY] {
            assert_eq!(metres(millimetres(code)), code);
        }
        assert!(metres(millimetres(f32::NAN)).is_nan());
        assert_eq!(millimetres(-1.0), 1, "no range is none");
        assert_eq!(millimetres(1e9), LONGEST as u16);
    }
}
