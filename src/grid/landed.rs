//! Where the returns of a scan have landed, cell by cell.
//!
//! Beams side by side often land in the same cell: a cell is then hit by a run of them. Where a run ends cannot be guessed, and a branch
//! there would be guessed wrong nearly each time. So it is worked out for several beams at a time how many beams a run that began with each
//! would have, up to [`FEW`]; what is found for beams in the midst of one is not used.

use super::{angle::whole, rays::Rays, tiles::CellIndex};

/// Of runs of so many beams or more, the end is looked for one by one.
const FEW: usize = 4;
/// Beams beyond the end, so that windows need not be cut there.
const PAD: usize = FEW;

/// The column of what did not return, and its row.
const NOWHERE: i32 = i32::MAX;

/// See the module. All numbers are relative to the [base](Rays::base) of the rays.
#[derive(Debug, Default)]
pub struct Landed {
    /// How many beams there are.
    beams: usize,
    /// The point of each beam (cells), and the cell that it is in; [`NOWHERE`] without a return. X, y.
    points: [Vec<f32>; 2],
    cells: [Vec<i32>; 2],
    /// Of the run that begins with each beam: how many beams it has, at most [`FEW`], and the mean of their points in the cell.
    counts: Vec<u32>,
    means: [Vec<f32>; 2],
}

/// Beams side by side that landed in the same cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Run {
    /// The first of them.
    pub first: usize,
    /// The first one after them.
    pub next: usize,
    /// The cell.
    pub index: CellIndex,
    /// Mean of their points, from the cell's lower left corner (cells).
    pub mean: [f32; 2],
}

impl Landed {
    /// Takes over a scan with these distances (m), 0 where nothing returned.
    #[inline(always)]
    pub fn load(&mut self, rays: &Rays, distances: &[f32]) {
        self.beams = distances.len();
        rays.points(distances, &mut self.points);
        for (points, cells) in self.points.iter_mut().zip(&mut self.cells) {
            cells.clear();
            let returns = points.iter().zip(distances);
            cells.extend(returns.map(|(&point, &range)| if range > 0.0 { floor(point) } else { NOWHERE }));
            cells.resize(self.beams + PAD, NOWHERE);
            points.resize(self.beams + PAD, 0.0);
        }
        self.counts.resize(self.beams, 0);
        let [columns, rows] = [0, 1].map(|axis| windows(&self.cells[axis], self.beams));
        for (beam, count) in self.counts.iter_mut().enumerate() {
            let (mut goes_on, mut beams) = (1, 1);
            for next in 1..FEW {
                let is_column = columns[next][beam] == columns[0][beam];
                goes_on &= u32::from(is_column) & u32::from(rows[next][beam] == rows[0][beam]);
                beams += goes_on;
            }
            *count = beams;
        }
        for axis in 0..2 {
            let (points, counts) = (windows(&self.points[axis], self.beams), &self.counts[..self.beams]);
            let cells = &self.cells[axis][..self.beams];
            self.means[axis].resize(self.beams, 0.0);
            for (beam, mean) in self.means[axis].iter_mut().enumerate() {
                let mut sum = points[0][beam];
                for (before, points) in (1..).zip(&points[1..]) {
                    let further = sum + points[beam];
                    sum = if counts[beam] > before { further } else { sum };
                }
                *mean = sum / counts[beam] as i32 as f32 - cells[beam] as f32;
            }
        }
    }

    /// The first run of beams with returns, from this beam on.
    #[inline(always)]
    pub fn run(&self, mut from: usize) -> Option<Run> {
        while from < self.beams {
            let (first, index) = (from, self.cell(from));
            from += self.counts[first] as usize;
            if index.x == NOWHERE {
                continue;
            }
            let mut mean = [0, 1].map(|axis| self.means[axis][first]);
            if from - first == FEW {
                while self.cell(from) == index {
                    from += 1;
                }
                mean = self.mean(first, from);
            }
            return Some(Run { first, next: from, index, mean });
        }
        None
    }

    #[inline(always)]
    fn cell(&self, beam: usize) -> CellIndex {
        CellIndex { x: self.cells[0][beam], y: self.cells[1][beam] }
    }

    /// Mean of the points of the run from a beam to before another.
    fn mean(&self, first: usize, end: usize) -> [f32; 2] {
        [0, 1].map(|axis| {
            let sum: f32 = self.points[axis][first..end].iter().sum();
            sum / (end - first) as f32 - self.cells[axis][first] as f32
        })
    }
}

/// The numbers of all beams, those of the beams after each, and so on.
#[inline(always)]
fn windows<T>(padded: &[T], beams: usize) -> [&[T]; FEW] {
    std::array::from_fn(|next| &padded[next..next + beams])
}

/// Rounded down, for numbers below 2^22; beyond is any. Without SSE4.1, `floor` is a call, and a cast that must mind what no
/// integer can be is done one by one.
#[inline(always)]
fn floor(number: f32) -> i32 {
    let whole = whole(number);
    whole.wrapping_sub(i32::from(whole as f32 > number))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        grid::sweep::{
            Sweep,
            tests::{half_circle, single},
        },
        pose::pose,
    };
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn runs_are_the_beams_side_by_side_in_a_cell(stretches in proptest::collection::vec((single(0.0..9.0), 1usize..30), 1..30)) {
            let distance = |range: f32| if range < 0.5 { 0.0 } else { range };
            let distances: Vec<f32> = stretches
                .into_iter()
                .flat_map(|(range, beams)| std::iter::repeat_n(distance(range), beams))
                .chain([1.0])
                .collect();
            let scan = half_circle(0, distances.clone());
            let (mut rays, mut landed) = (Rays::default(), Landed::default());
            rays.load(&Sweep { scan: &scan, start: pose(0.3, 0.3, 0.1), end: pose(0.32, 0.3, 0.1) }, 0.05);
            // What was there before does not matter.
            landed.load(&rays, &vec![2.0; distances.len()]);
            landed.load(&rays, &distances);
            let mut points = Default::default();
            rays.points(&distances, &mut points);
            let cell = |beam: usize| {
                let [x, y] = [0, 1].map(|axis| points[axis][beam].floor() as i32);
                (distances[beam] > 0.0).then_some(CellIndex { x, y })
            };
            let beams: Vec<usize> = (0..distances.len()).collect();
            let mut next = 0;
            for beams in beams.chunk_by(|a, b| cell(*a) == cell(*b)) {
                let Some(index) = cell(beams[0]) else { continue };
                let mean = [0, 1].map(|axis| {
                    let sum: f32 = beams.iter().map(|&beam| points[axis][beam]).sum();
                    sum / beams.len() as f32 - [index.x, index.y][axis] as f32
                });
                let expected = Run { first: beams[0], next: beams[0] + beams.len(), index, mean };
                prop_assert_eq!(landed.run(next), Some(expected));
                next = expected.next;
            }
            prop_assert_eq!(landed.run(next), None);
        }
    }
}
