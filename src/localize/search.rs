//! Finds a pose in a matching map from far off: around an expected one, or anywhere.
//!
//! Correlation of thinned points with the cells that surely hold something (Olson 2009), coarse poses first. What it gives
//! is near enough for [`refine`](super::matcher::refine), not exact.

use super::points::ScanPoint;
use super::submap::{CELL, Submap, index};
use crate::pose::Pose;
use nalgebra::Vector2;

/// Points that a search looks at, spread evenly over the scan.
const POINTS: usize = 120;
/// Candidates that are handed on at most.
const CANDIDATES: usize = 8;
/// Candidates are different places where they are at least this far apart (m, rad).
const APART: [f64; 2] = [0.25, 0.15];

/// A pose that may be the right one.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// The scanner in the map.
    pub pose: Pose,
    /// Share of the points that lie on something, weighed by how surely it is there.
    pub score: f64,
}

/// Around where a search looks.
#[derive(Clone, Copy, Debug)]
pub struct Window {
    /// Farthest place to either side (m).
    pub reach: f64,
    /// Farthest heading to either side (rad).
    pub turn: f64,
}

/// The best poses within a window around one, best first.
pub fn around(map: &Submap, points: &[ScanPoint], at: &Pose, window: Window) -> Vec<Candidate> {
    let reach = Vector2::repeat(window.reach + reach_of(points));
    let field = Field::of(map, at.translation.vector, reach);
    let mut found = Vec::new();
    let steps = (window.reach / CELL).ceil() as i32;
    let turn_step = turn_step(points);
    let turns = (window.turn / turn_step).ceil() as i32;
    let few: Vec<Vector2<f64>> = few(points);
    for turn in -turns..=turns {
        let rotation = at.rotation * nalgebra::UnitComplex::new(f64::from(turn) * turn_step);
        let cells = cells_of(&few, &rotation, at.translation.vector);
        for y in -steps..=steps {
            for x in -steps..=steps {
                let score = field.score(&cells, x, y, 0);
                let place = at.translation.vector + Vector2::new(f64::from(x), f64::from(y)) * CELL;
                keep(&mut found, Candidate { pose: Pose::from_parts(place.into(), rotation), score });
            }
        }
    }
    found
}

/// The headings at which a search looks.
#[derive(Clone, Copy, Debug)]
pub struct Headings {
    /// The middle one (rad).
    pub middle: f64,
    /// Farthest to either side (rad).
    pub turn: f64,
}

/// All headings.
pub const ALL_HEADINGS: Headings = Headings { middle: std::f64::consts::PI, turn: std::f64::consts::PI };

/// The best poses anywhere in the map at these headings, best first; branch and bound over places (Hess et al. 2016).
pub fn anywhere(map: &Submap, points: &[ScanPoint], headings: Headings, least: f64) -> Vec<Candidate> {
    /// Levels of halving: the coarsest cell has 64 fine ones along its side, 6.4 m.
    const LEVELS: usize = 6;
    let [low, high] = map.extent();
    let middle = Vector2::new((low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0);
    let reach = Vector2::new((high[0] - low[0]) / 2.0, (high[1] - low[1]) / 2.0).map(|half| half.max(CELL));
    let mut field = Field::of(map, middle, reach);
    field.build(LEVELS);
    let few = few(points);
    let turn_step = turn_step(points).max(0.5_f64.to_radians());
    let width = 2.0 * headings.turn.min(std::f64::consts::PI);
    let turns = (width / turn_step).ceil() as i32;
    let side = 1 << LEVELS;
    let blocks = reach.map(|reach| (reach / CELL).ceil() as i32 / side + 1);
    let mut roots = Vec::new();
    let mut rotated = Vec::with_capacity(turns as usize);
    for turn in 0..turns {
        let rotation =
            nalgebra::UnitComplex::new(headings.middle - width / 2.0 + f64::from(turn) * turn_step);
        let cells = cells_of(&few, &rotation, middle);
        for y in -blocks.y..blocks.y {
            for x in -blocks.x..blocks.x {
                let score = field.score(&cells, x * side, y * side, LEVELS);
                if score >= least {
                    roots.push((score, turn, x * side, y * side));
                }
            }
        }
        rotated.push((rotation, cells));
    }
    roots.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut found = Vec::new();
    for (score, turn, x, y) in roots {
        if score < bar(&found, least) {
            break;
        }
        let (rotation, cells) = &rotated[turn as usize];
        let mut stack = vec![(score, x, y, LEVELS)];
        while let Some((score, x, y, level)) = stack.pop() {
            if score < bar(&found, least) {
                continue;
            }
            if level == 0 {
                let place = middle + Vector2::new(f64::from(x), f64::from(y)) * CELL;
                keep(&mut found, Candidate { pose: Pose::from_parts(place.into(), *rotation), score });
                continue;
            }
            let half = 1 << (level - 1);
            let mut children = [(0, 0), (half, 0), (0, half), (half, half)]
                .map(|(dx, dy)| (field.score(cells, x + dx, y + dy, level - 1), x + dx, y + dy, level - 1));
            children.sort_by(|a, b| a.0.total_cmp(&b.0));
            stack.extend(children);
        }
    }
    found
}

/// What a candidate has to reach to be of interest: near the best, since the second best tells whether the best is
/// the only one.
fn bar(found: &[Candidate], least: f64) -> f64 {
    found.first().map_or(least, |best| (best.score * 0.85).max(least))
}

/// Puts a candidate among the others, best first; of those at one place the best stays.
fn keep(found: &mut Vec<Candidate>, new: Candidate) {
    if found.len() == CANDIDATES && found[CANDIDATES - 1].score >= new.score {
        return;
    }
    let is_same = |old: &Candidate| {
        (old.pose.translation.vector - new.pose.translation.vector).norm() < APART[0]
            && old.pose.rotation.angle_to(&new.pose.rotation).abs() < APART[1]
    };
    if found.iter().any(|old| is_same(old) && old.score >= new.score) {
        return;
    }
    found.retain(|old| !is_same(old));
    let place = found.partition_point(|old| old.score >= new.score);
    found.insert(place, new);
    found.truncate(CANDIDATES);
}

/// Some of the points, evenly.
fn few(points: &[ScanPoint]) -> Vec<Vector2<f64>> {
    let every = points.len().div_ceil(POINTS).max(1);
    points.iter().step_by(every).map(|point| point.at.coords).collect()
}

fn reach_of(points: &[ScanPoint]) -> f64 {
    points.iter().map(|point| point.at.coords.norm_squared()).fold(0.0, f64::max).sqrt()
}

/// The turn by which the farthest tenth of the points does not leave its cell (rad).
fn turn_step(points: &[ScanPoint]) -> f64 {
    let mut ranges: Vec<f64> = points.iter().map(|point| point.at.coords.norm()).collect();
    ranges.sort_by(f64::total_cmp);
    let far = ranges.get(ranges.len() * 9 / 10).copied().unwrap_or(1.0).max(1.0);
    CELL / far
}

/// The points' cells where the scanner is at `at`.
fn cells_of(
    few: &[Vector2<f64>],
    rotation: &nalgebra::UnitComplex<f64>,
    at: Vector2<f64>,
) -> Vec<(i32, i32)> {
    few.iter()
        .map(|point| {
            let place = at + rotation * point;
            (index(place.x), index(place.y))
        })
        .collect()
}

/// What stands in a rectangle of cells, level by level: level `n` holds the greatest of the 2^n x 2^n cells from a cell on
/// to the upper right.
struct Field {
    low: (i32, i32),
    width: i32,
    height: i32,
    levels: Vec<Vec<u8>>,
}

impl Field {
    fn of(map: &Submap, middle: Vector2<f64>, reach: Vector2<f64>) -> Field {
        let low = (index(middle.x - reach.x) - 1, index(middle.y - reach.y) - 1);
        let high = (index(middle.x + reach.x) + 1, index(middle.y + reach.y) + 1);
        let (width, height) = (high.0 - low.0 + 1, high.1 - low.1 + 1);
        let mut cells = vec![0_u8; width as usize * height as usize];
        for (x, y) in map.occupied() {
            let (column, row) = (x - low.0, y - low.1);
            // Half as much beside a surface: poses are looked at in steps of a cell.
            for (dx, dy, value) in [(0, 0, 100), (1, 0, 50), (-1, 0, 50), (0, 1, 50), (0, -1, 50)] {
                let (column, row) = (column + dx, row + dy);
                if (0..width).contains(&column) && (0..height).contains(&row) {
                    let cell = &mut cells[(row * width + column) as usize];
                    *cell = (*cell).max(value);
                }
            }
        }
        Field { low, width, height, levels: vec![cells] }
    }

    fn build(&mut self, levels: usize) {
        for level in 1..=levels {
            let half = 1 << (level - 1);
            let (width, height) = (self.width, self.height);
            let fine = &self.levels[level - 1];
            let at = |x: i32, y: i32| {
                if x < width && y < height { fine[(y * width + x) as usize] } else { 0 }
            };
            let mut coarse = vec![0; fine.len()];
            for y in 0..height {
                for x in 0..width {
                    coarse[(y * width + x) as usize] =
                        at(x, y).max(at(x + half, y)).max(at(x, y + half)).max(at(x + half, y + half));
                }
            }
            self.levels.push(coarse);
        }
    }

    /// Score of the cells moved by `x`, `y`; at a level, the best that any move from there to 2^level - 1 farther can have.
    fn score(&self, cells: &[(i32, i32)], x: i32, y: i32, level: usize) -> f64 {
        let values = &self.levels[level];
        let side = 1 << level;
        let mut sum = 0_u32;
        for &(column, row) in cells {
            let (mut column, mut row) = (column - self.low.0 + x, row - self.low.1 + y);
            // A block that begins outside may reach in.
            if column < 0 && column + side > 0 {
                column = 0;
            }
            if row < 0 && row + side > 0 {
                row = 0;
            }
            if column >= 0 && row >= 0 && column < self.width && row < self.height {
                sum += u32::from(values[(row * self.width + column) as usize]);
            }
        }
        f64::from(sum) / 100.0 / (cells.len() as f64).max(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::localize::points::Points;
    use crate::pose::pose;
    use std::f64::consts::PI;

    /// An outline like no other, of points 5 cm apart.
    fn outline() -> Points {
        let walls = [[[0.0, -2.0], [3.0, -2.0]], [[3.0, -2.0], [3.0, 1.0]], [[-1.5, 1.8], [0.5, 1.8]]];
        let mut points = Points::default();
        for [a, b] in walls.map(|wall| wall.map(Vector2::from)) {
            let steps = ((b - a).norm() / 0.05) as usize;
            points.all.extend((0..steps).map(|step| ScanPoint {
                at: (a + (b - a) * (step as f64 / steps as f64)).into(),
                normal: None,
                variance: 1e-4,
                post: false,
                sine: 1.0,
            }));
        }
        points
    }

    #[test]
    fn a_place_is_found_at_the_headings_that_are_searched_only() {
        let (points, truth) = (outline(), pose(4.0, -1.0, 2.0));
        let mut map = Submap::default();
        (0..3).for_each(|_| map.insert(&points, &truth));
        let find = |middle: f64, turn: f64| anywhere(&map, &points.all, Headings { middle, turn }, 0.6);
        for headings in [ALL_HEADINGS, Headings { middle: 2.2, turn: 0.4 }] {
            let best = find(headings.middle, headings.turn)[0].pose;
            assert!((best.translation.vector - truth.translation.vector).norm() < 0.15, "{best}");
            assert!(best.rotation.angle_to(&truth.rotation).abs() < 0.05, "{best}");
        }
        assert!(find(2.0 + PI, 1.0).is_empty());
    }
}
