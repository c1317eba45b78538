//! A small pose graph in the plane: places along a drive, what is known of each relative to another, and the places that suit
//! all of that best.
//!
//! Not a search for what belongs together, which is in [`loops`](super::loops). Dense: a node stands for some metres of
//! driving, so that a kilometre is two hundred of them. Source: Grisetti et al. 2010, "A tutorial on graph-based SLAM".

use crate::pose::{Pose, pose};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

/// Iterations at most; ten are enough from a loop that is open by half its size.
const MOST_STEPS: usize = 30;
/// A step shorter than this ends them (m, rad).
const DONE: f64 = 1e-6;

/// What is known of one node relative to another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// Number of the node in whose frame the other one is.
    pub from: usize,
    /// Number of the other.
    pub to: usize,
    /// `to` in the frame of `from`.
    pub pose: Pose,
    /// Information of x, y (1/m2) and heading (1/rad2), in the frame of `to` as `pose` has it.
    pub information: Matrix3<f64>,
}

impl Edge {
    /// How far two nodes are from what the edge says: x, y (m) and heading (rad).
    pub fn error(&self, nodes: &[Pose]) -> Vector3<f64> {
        let off = self.pose.inverse() * nodes[self.from].inverse() * nodes[self.to];
        Vector3::new(off.translation.x, off.translation.y, off.rotation.angle())
    }

    /// The same in squared deviations: 3 on average where all is as it should be.
    pub fn squared_deviations(&self, nodes: &[Pose]) -> f64 {
        let error = self.error(nodes);
        error.dot(&(self.information * error))
    }
}

/// Moves the nodes to where they suit the edges best; the first stays where it is. `None` where the edges do not tie all of
/// them together.
pub fn solve(nodes: &[Pose], edges: &[Edge]) -> Option<Vec<Pose>> {
    let mut nodes = nodes.to_vec();
    let size = 3 * nodes.len();
    for _ in 0..MOST_STEPS {
        let mut information = DMatrix::<f64>::zeros(size, size);
        let mut gradient = DVector::<f64>::zeros(size);
        for i in 0..3 {
            information[(i, i)] = 1e12;
        }
        for edge in edges {
            let error = edge.error(&nodes);
            let [a, b] = slopes(edge, &nodes);
            for (node, slope) in [(edge.from, a), (edge.to, b)] {
                let weighted = slope.transpose() * edge.information;
                let mut part = gradient.fixed_rows_mut::<3>(3 * node);
                part += weighted * error;
                for (other, slope) in [(edge.from, a), (edge.to, b)] {
                    let mut part = information.fixed_view_mut::<3, 3>(3 * node, 3 * other);
                    part += weighted * slope;
                }
            }
        }
        let step = -information.cholesky()?.solve(&gradient);
        for (node, by) in nodes.iter_mut().zip(step.as_slice().chunks_exact(3)).skip(1) {
            let at = node.translation;
            *node = pose(at.x + by[0], at.y + by[1], node.rotation.angle() + by[2]);
        }
        if step.amax() < DONE {
            break;
        }
    }
    nodes.iter().all(|node| node.translation.vector.norm().is_finite()).then_some(nodes)
}

/// How an edge's error changes with its two nodes, each as x, y, heading in the common frame.
fn slopes(edge: &Edge, nodes: &[Pose]) -> [Matrix3<f64>; 2] {
    let (from, to) = (&nodes[edge.from], &nodes[edge.to]);
    let turn = (from.rotation * edge.pose.rotation).inverse().to_rotation_matrix();
    let way = to.translation.vector - from.translation.vector;
    // The way seen from a frame that turns.
    let across = turn * nalgebra::Vector2::new(way.y, -way.x);
    let mut a = Matrix3::zeros();
    let mut b = Matrix3::zeros();
    a.fixed_view_mut::<2, 2>(0, 0).copy_from(&-turn.matrix());
    a.fixed_view_mut::<2, 1>(0, 2).copy_from(&across);
    a[(2, 2)] = -1.0;
    b.fixed_view_mut::<2, 2>(0, 0).copy_from(turn.matrix());
    b[(2, 2)] = 1.0;
    [a, b]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::localize::matcher::difference;

    /// A square of 20 m sides, driven with a heading that drifts, and closed.
    #[test]
    fn a_loop_that_drifted_is_closed() {
        let truth: Vec<Pose> = (0..=40)
            .scan(pose(1.0, 2.0, 0.3), |at, number| {
                let before = *at;
                *at *= pose(2.0, 0.0, if number % 10 == 9 { std::f64::consts::FRAC_PI_2 } else { 0.0 });
                Some(before)
            })
            .collect();
        let step = |number: usize| truth[number].inverse() * truth[number + 1];
        let drift = pose(0.01, 0.0, 0.01);
        let odometry: Vec<Edge> = (0..40)
            .map(|number| Edge {
                from: number,
                to: number + 1,
                pose: step(number) * drift,
                information: Matrix3::from_diagonal(&Vector3::new(1e3, 1e3, 1e3)),
            })
            .collect();
        let mut nodes = vec![truth[0]];
        for edge in &odometry {
            nodes.push(nodes[edge.from] * edge.pose);
        }
        assert!(difference(&nodes[40], &truth[40]).xy().norm() > 3.0);
        let mut edges = odometry;
        edges.push(Edge {
            from: 0,
            to: 40,
            pose: truth[0].inverse() * truth[40],
            information: Matrix3::identity() * 1e6,
        });
        let solved = solve(&nodes, &edges).unwrap();
        assert_eq!(solved[0], truth[0]);
        for (found, truth) in solved.iter().zip(&truth) {
            let off = difference(found, truth);
            assert!(off.xy().norm() < 0.3 && off.z.abs() < 0.06, "{off}");
        }
        assert!(difference(&solved[40], &truth[40]).norm() < 1e-3);
        assert!(edges.iter().all(|edge| edge.squared_deviations(&solved) < 3.0));
    }

    #[test]
    fn slopes_are_those_of_the_error() {
        let nodes = [pose(1.0, -2.0, 0.7), pose(4.0, 1.0, -2.0)];
        let edge = Edge { from: 0, to: 1, pose: pose(3.5, 0.5, -2.5), information: Matrix3::identity() };
        let slopes = slopes(&edge, &nodes);
        let h = 1e-6;
        for (node, slope) in slopes.iter().enumerate() {
            for axis in 0..3 {
                let mut moved = nodes;
                let at = nodes[node].translation;
                let by = [0, 1, 2].map(|i| if i == axis { h } else { 0.0 });
                moved[node] = pose(at.x + by[0], at.y + by[1], nodes[node].rotation.angle() + by[2]);
                let change = (edge.error(&moved) - edge.error(&nodes)) / h;
                assert!((change - slope.column(axis)).amax() < 1e-4, "{node} {axis}");
            }
        }
    }

    #[test]
    fn nodes_that_nothing_ties_have_no_solution() {
        let nodes = [Pose::identity(); 3];
        let edge = Edge { from: 0, to: 1, pose: Pose::identity(), information: Matrix3::identity() };
        assert!(solve(&nodes, &[edge]).is_none());
    }
}
