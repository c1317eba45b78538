//! A scan that was placed, kept small: 3.4 kB for one of 1081 beams with intensities.

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

/// See the module.
#[derive(Clone, Debug)]
pub struct Placed {
    seq: u64,
    stamp_ns: i64,
    geometry: Geometry,
    ranges_mm: Box<[u16]>,
    intensities: Intensities,
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
            intensities: Intensities::new(&scan.intensities),
            start,
            end,
            way,
            is_key,
        }
    }

    /// Memory that it holds (bytes).
    pub fn bytes(&self) -> usize {
        size_of_val(self) + size_of_val(&*self.ranges_mm) + size_of_val(&*self.intensities.steps)
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
            intensities: self.intensities.iter().collect(),
        }
    }
}

/// Intensities of a scan, each a power of the scan's own. A UTM-30LX's lie within two octaves, so each comes back within 0.3 %,
/// which is 2 % of a brightness (its fifth power), where brightness has a noise of 13 % (paper III-C).
#[derive(Clone, Debug, Default)]
struct Intensities {
    /// Logarithms to base 2 of the least one, and of how far they are apart.
    least: f32,
    step: f32,
    /// How many steps each is above the least, from 1 on; 0 where there was none. Empty where the scan has none.
    steps: Box<[u8]>,
}

impl Intensities {
    fn new(intensities: &[f32]) -> Intensities {
        let is_told = |intensity: f32| intensity > 0.0 && intensity.is_finite();
        let told = || intensities.iter().copied().filter(|&intensity| is_told(intensity));
        let least = told().fold(f32::INFINITY, f32::min).log2();
        let most = told().fold(0.0, f32::max).log2();
        let step = ((most - least) / f32::from(u8::MAX - 1)).max(f32::MIN_POSITIVE);
        let steps = |&intensity: &f32| {
            if is_told(intensity) { 1 + ((intensity.log2() - least) / step).round() as u8 } else { 0 }
        };
        Intensities { least, step, steps: intensities.iter().map(steps).collect() }
    }

    fn iter(&self) -> impl Iterator<Item = f32> {
        let intensity = |steps: u8| (self.least + f32::from(steps - 1) * self.step).exp2().min(f32::MAX);
        self.steps.iter().map(move |&steps| if steps == 0 { 0.0 } else { intensity(steps) })
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

    #[test]
    fn intensities_come_back_as_nearly_as_brightness_is_measured() {
        let back = |intensities: &[f32]| Intensities::new(intensities).iter().collect::<Vec<_>>();
        let of_a_scanner: Vec<f32> = (0..1081).map(|beam| 3000.0 + 9000.0 * (beam as f32 / 1080.0)).collect();
        for (kept, was) in back(&of_a_scanner).iter().zip(&of_a_scanner) {
            assert!((kept / was - 1.0).abs() < 0.003, "{kept} for {was}");
        }
        assert_eq!(
            back(&[0.0, f32::NAN, f32::INFINITY, -1.0, 64.0]),
            [0.0, 0.0, 0.0, 0.0, 64.0],
            "none, and one"
        );
        assert_eq!(back(&[5.0, 5.0]), [5.0, 5.0].map(|of: f32| of.log2().exp2()), "all the same");
        for (kept, was) in
            back(&[f32::MIN_POSITIVE, 1.0, f32::MAX]).iter().zip([f32::MIN_POSITIVE, 1.0, f32::MAX])
        {
            assert!((kept / was).log2().abs() <= 0.51, "{kept} for {was}: a step is an octave");
        }
        assert!(back(&[]).is_empty());
    }
}
