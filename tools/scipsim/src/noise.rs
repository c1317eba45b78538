//! Random numbers that depend on a seed alone: streams for a scan, and smooth noise along a length.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Mixes numbers into a seed (the finaliser of splitmix64, after each of them).
pub fn mix(parts: &[u64]) -> u64 {
    parts.iter().fold(0x9e37_79b9_7f4a_7c15, |state, &part| {
        let mut z = (state ^ part).wrapping_add(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    })
}

/// A stream of random numbers.
#[derive(Clone, Debug)]
pub struct Random {
    source: ChaCha8Rng,
    spare: Option<f64>,
}

impl Random {
    /// The stream with this name.
    pub fn new(parts: &[u64]) -> Random {
        Random { source: ChaCha8Rng::seed_from_u64(mix(parts)), spare: None }
    }

    /// Evenly from `low` to `high`.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.source.random::<f64>()
    }

    /// True with this probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        probability > 0.0 && self.source.random::<f64>() < probability
    }

    /// One of `0..count`.
    pub fn below(&mut self, count: usize) -> usize {
        (self.uniform(0.0, count as f64) as usize).min(count.saturating_sub(1))
    }

    /// Gaussian with mean 0 and deviation 1 (polar method).
    pub fn normal(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        loop {
            let (u, v) = (self.uniform(-1.0, 1.0), self.uniform(-1.0, 1.0));
            let s = u * u + v * v;
            if s > 0.0 && s < 1.0 {
                let scale = (-2.0 * s.ln() / s).sqrt();
                self.spare = Some(v * scale);
                return u * scale;
            }
        }
    }
}

/// Gaussian noise of deviation 1 that varies smoothly along a length.
#[derive(Clone, Debug)]
pub struct SmoothNoise {
    seed: u64,
    spacing: f64,
}

impl SmoothNoise {
    /// Noise whose values are independent beyond about `spacing` (in the unit of the later argument).
    pub fn new(parts: &[u64], spacing: f64) -> SmoothNoise {
        SmoothNoise { seed: mix(parts), spacing }
    }

    /// Value at `at`.
    pub fn value(&self, at: f64) -> f64 {
        let place = at / self.spacing;
        let knot = place.floor();
        let t = place - knot;
        let w = t * t * (3.0 - 2.0 * t);
        let (a, b) = (self.knot(knot as i64), self.knot(knot as i64 + 1));
        // Divided by the deviation of the blend, which is below 1 between the knots.
        (a * (1.0 - w) + b * w) / (w * w + (1.0 - w) * (1.0 - w)).sqrt()
    }

    fn knot(&self, i: i64) -> f64 {
        // Sum of four uniform numbers: near enough to a Gaussian, bounded, and cheap.
        let sum: f64 =
            (0..4).map(|k| (mix(&[self.seed, i as u64, k]) >> 11) as f64 / (1u64 << 53) as f64).sum();
        (sum - 2.0) * 3f64.sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_mean_0_and_deviation_1_and_is_smooth() {
        let noise = SmoothNoise::new(&[7], 2.0);
        let values: Vec<f64> = (0..200_000).map(|i| noise.value(i as f64 * 0.1)).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let square = values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64;
        assert!(mean.abs() < 0.03 && (square - 1.0).abs() < 0.05, "{mean} {square}");
        assert!(values.windows(2).all(|w| (w[1] - w[0]).abs() < 0.6));
    }
}
