//! A small pose graph in the plane: places along a drive, what is known of each relative to another, and the places that suit
//! all of that best.
//!
//! Not a search for what belongs together, which is in [`loops`](super::loops). A node stands for some metres of driving: a
//! kilometre is three hundred of them, which know of each other along the way and where it comes back. Sources: Grisetti et al.
//! 2010, "A tutorial on graph-based SLAM"; Dellaert et al. 2010, "Subgraph-preconditioned conjugate gradients for large scale
//! SLAM".

use crate::pose::{Pose, pose};
use nalgebra::{Matrix3, Vector3};

/// Iterations at most; ten are enough from a loop that is open by half its size.
const MOST_STEPS: usize = 30;
/// A step shorter than this ends them (m, rad).
const DONE: f64 = 1e-6;
/// Part of the squared error at which the equations of a step are solved.
const EXACT: f64 = 1e-16;

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

/// Moves the nodes to where they suit the edges best; the first stays where it is. `None` where those from each node to the next
/// do not tie all of them together.
pub fn solve(nodes: &[Pose], edges: &[Edge]) -> Option<Vec<Pose>> {
    let mut nodes = nodes.to_vec();
    for _ in 0..MOST_STEPS {
        let mut normal = Normal::of(nodes.len());
        let mut gradient = vec![Vector3::zeros(); nodes.len()];
        for edge in edges {
            let error = edge.error(&nodes);
            let [a, b] = slopes(edge, &nodes);
            let weighted = [a, b].map(|slope| slope.transpose() * edge.information);
            gradient[edge.from] -= weighted[0] * error;
            gradient[edge.to] -= weighted[1] * error;
            normal.diagonal[edge.from] += weighted[0] * a;
            normal.diagonal[edge.to] += weighted[1] * b;
            normal.add_beside(edge.from, edge.to, weighted[0] * b);
        }
        let steps = normal.solve(&gradient)?;
        for (node, by) in nodes.iter_mut().zip(&steps).skip(1) {
            let at = node.translation;
            *node = pose(at.x + by.x, at.y + by.y, node.rotation.angle() + by.z);
        }
        if steps.iter().all(|step| step.amax() < DONE) {
            break;
        }
    }
    nodes.iter().all(|node| node.translation.vector.norm().is_finite()).then_some(nodes)
}

/// The normal equations, in blocks of a node's x, y and heading: symmetric, and most of them zero.
struct Normal {
    diagonal: Vec<Matrix3<f64>>,
    /// Of each node and the next.
    next: Vec<Matrix3<f64>>,
    /// All others above the diagonal, by row and column.
    others: Vec<(usize, usize, Matrix3<f64>)>,
}

impl Normal {
    /// The first node is held where it is.
    fn of(nodes: usize) -> Normal {
        let mut diagonal = vec![Matrix3::zeros(); nodes];
        if let Some(first) = diagonal.first_mut() {
            *first = Matrix3::identity() * 1e12;
        }
        Normal { diagonal, next: vec![Matrix3::zeros(); nodes.saturating_sub(1)], others: Vec::new() }
    }

    fn add_beside(&mut self, row: usize, column: usize, block: Matrix3<f64>) {
        let (row, column, block) =
            if row < column { (row, column, block) } else { (column, row, block.transpose()) };
        if column == row + 1 {
            self.next[row] += block;
        } else {
            self.others.push((row, column, block));
        }
    }

    /// Solves by conjugate gradients; what ties each node to the next, which is solved at once, leads the way.
    fn solve(&self, right: &[Vector3<f64>]) -> Option<Vec<Vector3<f64>>> {
        let chain = Chain::of(self)?;
        let mut found = vec![Vector3::zeros(); right.len()];
        let mut rest = right.to_vec();
        let mut led = chain.solve(&rest);
        let mut direction = led.clone();
        let mut error = dot(&rest, &led);
        let enough = error * EXACT;
        // Without rounding, as many steps as there are unknowns would do.
        for _ in 0..6 * right.len() {
            if error <= enough {
                break;
            }
            let across = self.times(&direction);
            let length = error / dot(&direction, &across);
            add(&mut found, length, &direction);
            add(&mut rest, -length, &across);
            led = chain.solve(&rest);
            let before = std::mem::replace(&mut error, dot(&rest, &led));
            for (direction, led) in direction.iter_mut().zip(&led) {
                *direction = led + *direction * (error / before);
            }
        }
        Some(found)
    }

    fn times(&self, vector: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let mut product: Vec<Vector3<f64>> =
            self.diagonal.iter().zip(vector).map(|(block, part)| block * part).collect();
        let next = self.next.iter().enumerate().map(|(row, block)| (row, row + 1, block));
        for (row, column, block) in
            next.chain(self.others.iter().map(|(row, column, block)| (*row, *column, block)))
        {
            product[row] += block * vector[column];
            product[column] += block.tr_mul(&vector[row]);
        }
        product
    }
}

/// The part of the normal equations that ties each node to the next, decomposed.
struct Chain<'a> {
    normal: &'a Normal,
    /// Inverse of each node's block, once those before are eliminated.
    inverse: Vec<Matrix3<f64>>,
}

impl Chain<'_> {
    fn of(normal: &Normal) -> Option<Chain<'_>> {
        let mut inverse: Vec<Matrix3<f64>> = Vec::with_capacity(normal.diagonal.len());
        for (node, block) in normal.diagonal.iter().enumerate() {
            let left = match inverse.last() {
                Some(before) => block - normal.next[node - 1].tr_mul(&(before * normal.next[node - 1])),
                None => *block,
            };
            inverse.push(left.cholesky()?.inverse());
        }
        Some(Chain { normal, inverse })
    }

    fn solve(&self, right: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let mut found = right.to_vec();
        for node in 1..found.len() {
            let before = self.inverse[node - 1] * found[node - 1];
            found[node] -= self.normal.next[node - 1].tr_mul(&before);
        }
        for node in (0..found.len()).rev() {
            if let Some(after) = found.get(node + 1).copied() {
                found[node] -= self.normal.next[node] * after;
            }
            found[node] = self.inverse[node] * found[node];
        }
        found
    }
}

fn dot(a: &[Vector3<f64>], b: &[Vector3<f64>]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
}

fn add(to: &mut [Vector3<f64>], times: f64, what: &[Vector3<f64>]) {
    for (to, what) in to.iter_mut().zip(what) {
        *to += what * times;
    }
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
