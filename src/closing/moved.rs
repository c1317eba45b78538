//! Where what was placed belongs, once a loop was closed.

use crate::pose::Pose;

/// See the module: a step for each scan that was kept.
#[derive(Clone, Debug, PartialEq)]
pub struct Moved {
    /// Times (ns), in order, and what is to be put before a pose from then on.
    steps: Vec<(i64, Pose)>,
}

impl Moved {
    /// From times (ns), in order, and what is to be put before a pose from then on.
    pub fn new(steps: Vec<(i64, Pose)>) -> Moved {
        Moved { steps }
    }

    /// What is to be put before a pose of this time (ns).
    pub fn at(&self, stamp_ns: i64) -> Pose {
        let after = self.steps.partition_point(|(at, _)| *at <= stamp_ns);
        self.steps.get(after.saturating_sub(1)).map_or_else(Pose::identity, |(_, by)| *by)
    }

    /// The same for times that are counted from another moment.
    pub fn shifted(&self, by_ns: i64) -> Moved {
        Moved { steps: self.steps.iter().map(|(at, by)| (at + by_ns, *by)).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::pose;

    #[test]
    fn a_step_holds_until_the_next() {
        let steps: Vec<(i64, Pose)> = (0..3).map(|i| (10 * i, pose(i as f64, 0.0, 0.0))).collect();
        let at = |moved: &Moved, ns: i64| moved.at(ns).translation.x;
        let moved = Moved::new(steps);
        assert_eq!([-5, 0, 9, 10, 99].map(|ns| at(&moved, ns)), [0.0, 0.0, 0.0, 1.0, 2.0]);
        assert_eq!([105, 110].map(|ns| at(&moved.shifted(100), ns)), [0.0, 1.0]);
        assert_eq!(Moved::new(Vec::new()).at(5), Pose::identity());
    }
}
