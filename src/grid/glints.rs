//! How bright returns are, and which of them are glints: brighter than anything diffuse at their distance, so that they come from glass,
//! mirrors or polished metal that a beam has met about its normal (paper III-B, Fig. 9).
//!
//! Scanners tell intensities in units of their own, and no threshold holds for all. But the brightness of diffuse surfaces falls with
//! the square of the distance, and an intensity is some power of the brightness (a UTM-30LX's about the fifth root). Which
//! power, and how bright diffuse surfaces are, is learned from walls: what is seen over a wide range of angles and was hardly ever missed.
//! Without intensities, or where they do not fall with distance, there are no glints. A grid that is loaded from a file keeps those it has, and
//! learns again.

/// Returns of walls that must have been seen before anything is concluded from them: some seconds' worth.
const ENOUGH: f32 = 1000.0;
/// Returns of walls from which on older ones count for less: a minute's worth.
const MANY: f32 = 20_000.0;
/// Least variance of the logarithms of their distances by which the exponent can be told: half an octave, squared.
const SPREAD: f32 = 0.25;
/// Powers of the brightness that an intensity may be; beyond, it is something else.
const POWERS: std::ops::RangeInclusive<f32> = 0.05..=1.5;
/// Share of the walls' returns that are no brighter than diffuse surfaces are. The rest are glints beside a wall, and noise.
const DIFFUSE: f32 = 0.99;
/// A glint is brighter by this factor: the walls may be grey, where something else is white, and brightness has a noise of 13 %. Glass at its
/// normal is brighter by far more (paper III-B, Fig. 9), within a degree from 1 m as bright as a wall at 2 m.
const FACTOR: f32 = 4.0;

/// Levels of intensity in an octave, and all of them.
const LEVELS_PER_OCTAVE: f32 = 32.0;
const LEVELS: usize = 512;

/// Beams that are looked through at a time.
const CHUNK: usize = 32;

/// What is known of the intensities of diffuse surfaces. All logarithms are to base 2.
#[derive(Clone, Debug, Default)]
pub struct Glints {
    /// Returns of walls, and sums over their logarithms: distance, intensity, the first squared, and both multiplied.
    count: f32,
    sums: [f32; 4],
    /// The power of the distance that an intensity falls with, twice that of the brightness that it is.
    fall: f32,
    /// How many of these returns, were they from 1 m, are of each level of intensity.
    levels: Vec<f32>,
    /// Logarithm of the intensity of the first level.
    lowest: f32,
    /// Logarithm of the least intensity of a glint at 1 m.
    threshold: Option<f32>,
}

impl Glints {
    /// Whether glints can be told from other returns by now.
    pub fn are_known(&self) -> bool {
        self.threshold.is_some()
    }

    /// Whether a return is one; `range` in m.
    #[inline(always)]
    pub fn are(&self, range: f32, intensity: f32) -> bool {
        let threshold = self.threshold.unwrap_or(f32::INFINITY);
        log2(intensity.max(0.0)) + self.fall * log2(range) >= threshold
    }

    /// Brightness of a return, `range` m away, beside that of the brightest diffuse surfaces there; as a logarithm to base 2.
    #[inline(always)]
    pub fn brightness(&self, range: f32, intensity: f32) -> Option<f32> {
        let of_glint = log2(intensity.max(0.0)) + self.fall * log2(range) - self.threshold?;
        Some(2.0 * of_glint / self.fall + FACTOR.log2())
    }

    /// The beams that brought one; `ranges` in m.
    #[inline(always)]
    pub fn find(&self, ranges: &[f32], intensities: &[f32], beams: &mut Vec<u32>) {
        if !self.are_known() {
            return;
        }
        // Nearly always there is none among so many.
        let (ranges, intensities) = (ranges.chunks(CHUNK), intensities.chunks(CHUNK));
        for (first, (ranges, intensities)) in (0u32..).step_by(CHUNK).zip(ranges.zip(intensities)) {
            let are =
                || ranges.iter().zip(intensities).map(|(&range, &intensity)| self.are(range, intensity));
            if are().fold(false, |any, is| any | is) {
                beams.extend((first..).zip(are()).filter(|(_, is)| *is).map(|(beam, _)| beam));
            }
        }
    }

    /// Takes note of a wall's return; `range` in m.
    pub fn learn(&mut self, range: f32, intensity: f32) {
        // Neither is true of what is no number.
        if !(range > 0.0 && intensity > 0.0 && intensity.is_finite()) {
            return;
        }
        let (x, y) = (log2(range), log2(intensity));
        self.count += 1.0;
        for (sum, value) in self.sums.iter_mut().zip([x, y, x * x, x * y]) {
            *sum += value;
        }
        if !self.levels.is_empty() {
            let level = (y + self.fall * x - self.lowest) * LEVELS_PER_OCTAVE;
            self.levels[level.clamp(0.0, (LEVELS - 1) as f32) as usize] += 1.0;
        }
    }

    /// Draws conclusions from what was learned.
    pub fn conclude(&mut self) {
        if self.count < ENOUGH {
            return;
        }
        let [x, y, xx, xy] = self.sums.map(|sum| sum / self.count);
        let variance = xx - x * x;
        // The slope of the line through all, by least squares.
        let power = (xy - x * y) / variance / -2.0;
        if variance < SPREAD || !POWERS.contains(&power) {
            self.threshold = None;
            return;
        }
        self.fall = 2.0 * power;
        if self.levels.is_empty() {
            self.levels = vec![0.0; LEVELS];
            self.lowest = y + self.fall * x - LEVELS as f32 / LEVELS_PER_OCTAVE / 2.0;
        }
        let count: f32 = self.levels.iter().sum();
        if count >= ENOUGH {
            let mut above = (1.0 - DIFFUSE) * count;
            let brightest = self.levels.iter().rposition(|count| {
                above -= count;
                above < 0.0
            });
            let level = brightest.map_or(LEVELS, |level| level + 1) as f32;
            self.threshold = Some(self.lowest + level / LEVELS_PER_OCTAVE + power * FACTOR.log2());
        }
        if self.count >= MANY {
            self.count /= 2.0;
            self.sums.iter_mut().chain(&mut self.levels).for_each(|sum| *sum /= 2.0);
        }
    }
}

/// Logarithm to base 2 of a positive number, within 0.01; of zero, less than of any other.
#[inline(always)]
fn log2(number: f32) -> f32 {
    let bits = number.to_bits();
    let beyond_one = f32::from_bits(bits & 0x007f_ffff | 0x3f80_0000) - 1.0;
    ((bits >> 23) as i32 - 127) as f32 + beyond_one * (1.339 - 0.339 * beyond_one)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a scanner makes of a brightness, that of white at 1 m being 1.
    fn intensity(power: f32, unit: f32, brightness: f32) -> f32 {
        unit * brightness.powf(power)
    }

    /// Learned from walls of many albedos, from 0.5 to 10 m, one in 200 of the returns being a glint.
    fn learned(power: f32, unit: f32) -> Glints {
        let mut glints = Glints::default();
        // Evenly spread over both, and neither with the other.
        let part = |number: usize, of: f32| (number as f32 * of).fract();
        for number in 0..6000 {
            let range = 0.5 * 20f32.powf(part(number, 0.754_878));
            let albedo = if number % 200 == 0 { 100.0 } else { 0.05 + 0.85 * part(number, 0.569_84) };
            glints.learn(range, intensity(power, unit, albedo / (range * range)));
            if number % 500 == 499 {
                glints.conclude();
            }
        }
        glints
    }

    #[test]
    fn what_is_brighter_than_white_glints_at_any_distance_on_any_scanner() {
        for (power, unit) in [(0.19, 3900.0), (1.0, 1.0), (0.5, 255.0), (1.0, 1e-3)] {
            let glints = learned(power, unit);
            for range in [0.3, 1.0, 3.0, 12.0f32] {
                let are = |albedo: f32| {
                    let brightness = albedo / (range * range);
                    glints.are(range, intensity(power, unit, brightness))
                };
                assert!(!are(0.9 * 1.5) && !are(0.1), "{power}, {range} m: white, and grey");
                assert!(are(0.9 * 8.0), "{power}, {range} m");
            }
        }
    }

    #[test]
    fn brightness_is_beside_that_of_the_brightest_walls_from_any_distance_on_any_scanner() {
        for (power, unit) in [(0.19, 3900.0), (1.0, 1.0), (0.5, 255.0)] {
            let glints = learned(power, unit);
            for range in [0.3, 1.0, 3.0, 12.0f32] {
                for share in [2.0, 1.0, 0.1, 0.01] {
                    let brightness = intensity(power, unit, 0.9 * share / (range * range));
                    let told = glints.brightness(range, brightness).expect("it was learned");
                    assert!((told - share.log2()).abs() < 0.5, "{power}, {range} m, {share}: {told}");
                }
            }
            assert!(glints.brightness(1.0, 0.0).is_some_and(|told| told < -100.0));
        }
    }

    #[test]
    fn nothing_glints_where_nothing_can_be_learned() {
        let mut few = Glints::default();
        assert!(!few.are(1.0, f32::MAX) && few.brightness(1.0, 1.0).is_none());
        (0..100).for_each(|number| few.learn(1.0 + number as f32, 1.0));
        few.conclude();
        assert!(!few.are_known());
        let learned = |of: fn(usize) -> [f32; 2]| {
            let mut glints = Glints::default();
            for number in 0..10_000 {
                let [range, intensity] = of(number);
                glints.learn(range, intensity);
                if number % 1000 == 999 {
                    glints.conclude();
                }
            }
            glints.are_known()
        };
        assert!(learned(|number| [1.0 + (number % 9) as f32, 900.0 / (1.0 + (number % 9) as f32)]));
        assert!(!learned(|_| [2.0, 800.0]), "from one distance");
        assert!(!learned(|number| [1.0 + (number % 9) as f32, 800.0]), "as bright from everywhere");
        assert!(!learned(|number| [(number % 9) as f32, f32::NAN]));
        assert!(!learned(|number| [number as f32, -1.0]));
        assert!(!learned(|number| [f32::NAN, number as f32]));
    }

    #[test]
    fn bad_numbers_are_no_glints() {
        let glints = learned(1.0, 1.0);
        assert!(
            [f32::NAN, -5.0, 0.0, f32::NEG_INFINITY].iter().all(|&intensity| !glints.are(1.0, intensity))
        );
        assert!(!glints.are(0.0, 1.0));
    }
}
