//! How far a trajectory is from the truth, as evo's `evo_ape` counts it (translation part).

use nalgebra::Vector2;
use visagged::pose::Pose;

/// Errors of a trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrajectoryError {
    /// Root mean square of the distances as they are (m).
    pub raw: f64,
    /// The same after the best rotation and translation (m); Umeyama 1991 without scale.
    pub aligned: f64,
    /// Root mean square of the headings' errors (rad).
    pub heading: f64,
    /// Distance at the end (m).
    pub end: f64,
    /// The greatest distance (m).
    pub max: f64,
    /// By how much the error changes at most from one pose to the next (m).
    pub jump: f64,
}

impl TrajectoryError {
    /// The greater of each.
    pub fn worst(&self, other: &TrajectoryError) -> TrajectoryError {
        TrajectoryError {
            raw: self.raw.max(other.raw),
            aligned: self.aligned.max(other.aligned),
            heading: self.heading.max(other.heading),
            end: self.end.max(other.end),
            max: self.max.max(other.max),
            jump: self.jump.max(other.jump),
        }
    }
}

/// Errors of pairs of an estimated and a true pose.
pub fn error(pairs: &[(Pose, Pose)]) -> TrajectoryError {
    let count = pairs.len().max(1) as f64;
    let place = |pose: &Pose| pose.translation.vector;
    let distances: Vec<f64> =
        pairs.iter().map(|(found, truth)| (place(found) - place(truth)).norm()).collect();
    let mean = |of: fn(&(Pose, Pose)) -> Vector2<f64>| pairs.iter().map(of).sum::<Vector2<f64>>() / count;
    let (middle, true_middle) =
        (mean(|pair| pair.0.translation.vector), mean(|pair| pair.1.translation.vector));
    let (mut cos, mut sin) = (0.0, 0.0);
    for (found, truth) in pairs {
        let (a, b) = (place(found) - middle, place(truth) - true_middle);
        cos += a.dot(&b);
        sin += a.perp(&b);
    }
    let turn = nalgebra::UnitComplex::new(sin.atan2(cos));
    let aligned: f64 = pairs
        .iter()
        .map(|(found, truth)| (turn * (place(found) - middle) + true_middle - place(truth)).norm_squared())
        .sum();
    let headings: f64 =
        pairs.iter().map(|(found, truth)| found.rotation.angle_to(&truth.rotation).powi(2)).sum();
    let off = |pair: &(Pose, Pose)| place(&pair.0) - place(&pair.1);
    let jumps = pairs.windows(2).map(|pair| (off(&pair[1]) - off(&pair[0])).norm());
    TrajectoryError {
        raw: (distances.iter().map(|d| d * d).sum::<f64>() / count).sqrt(),
        aligned: (aligned / count).sqrt(),
        heading: (headings / count).sqrt(),
        end: distances.last().copied().unwrap_or_default(),
        max: distances.iter().copied().fold(0.0, f64::max),
        jump: jumps.fold(0.0, f64::max),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use visagged::pose::pose;

    #[test]
    fn a_turned_trajectory_has_a_raw_error_only() {
        let turn = pose(0.1, 0.0, 0.01);
        let pairs: Vec<_> = (0..10).map(|i| pose(f64::from(i), 0.0, 0.0)).map(|p| (turn * p, p)).collect();
        let error = error(&pairs);
        assert!(error.raw > 0.1 && error.aligned < 1e-12, "{error:?}");
        assert!((error.heading - 0.01).abs() < 1e-12);
        assert!((error.end - 0.1_f64.hypot(0.09)).abs() < 1e-3);
    }
}
