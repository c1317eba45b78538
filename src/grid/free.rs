//! Free space: the area that a scan sweeps, as an even-odd polygon fill.
//!
//! A cell is free where its centre lies inside the polygon of the scan. This visits each cell once, not
//! once a beam, and writes 64 cells at a time.

/// Turns the outline of a scan into spans of cells, row by row.
#[derive(Debug, Default)]
pub struct Outline {
    /// Corners in cells, relative to any whole cell.
    corners: Vec<[f32; 2]>,
    low: i32,
    /// Where edges cross each row of cell centres, from row `low` on.
    crossings: Vec<Vec<f32>>,
}

impl Outline {
    /// Begins a new outline.
    pub fn clear(&mut self) {
        self.corners.clear();
    }

    /// Adds a corner (cells); the last one is joined to the first.
    pub fn push(&mut self, x: f32, y: f32) {
        self.corners.push([x, y]);
    }

    /// Gives each run of cells whose centres are inside: row, first column, column after the last.
    pub fn fill(&mut self, mut span: impl FnMut(i32, i32, i32)) {
        let bounds = |i: usize| {
            self.corners.iter().fold((f32::MAX, f32::MIN), |(low, high), c| (low.min(c[i]), high.max(c[i])))
        };
        let (low, high) = bounds(1);
        if self.corners.len() < 3 {
            return;
        }
        self.low = row_after(low);
        let rows = (row_after(high) - self.low).max(0) as usize;
        if self.crossings.len() < rows {
            self.crossings.resize_with(rows, Vec::new);
        }
        let mut previous = self.corners[self.corners.len() - 1];
        for &corner in &self.corners {
            let ([x0, y0], [x1, y1]) =
                if previous[1] <= corner[1] { (previous, corner) } else { (corner, previous) };
            let rows = row_after(y0)..row_after(y1);
            if !rows.is_empty() {
                let slope = (x1 - x0) / (y1 - y0);
                for row in rows {
                    self.crossings[(row - self.low) as usize].push(x0 + (row as f32 + 0.5 - y0) * slope);
                }
            }
            previous = corner;
        }
        for (row, crossings) in self.crossings[..rows].iter_mut().enumerate() {
            crossings.sort_unstable_by(f32::total_cmp);
            for pair in crossings.chunks_exact(2) {
                let (from, to) = (row_after(pair[0]), row_after(pair[1]));
                if from < to {
                    span(self.low + row as i32, from, to);
                }
            }
            crossings.clear();
        }
    }
}

/// The first cell whose centre is not below `at`.
fn row_after(at: f32) -> i32 {
    (at - 0.5).ceil() as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(corners: &[[f32; 2]]) -> Vec<String> {
        let mut outline = Outline::default();
        let mut rows = vec![vec!['.'; 6]; 5];
        for _ in 0..2 {
            outline.clear();
            rows.iter_mut().for_each(|row| row.fill('.'));
            corners.iter().for_each(|c| outline.push(c[0], c[1]));
            outline.fill(|row, from, to| rows[row as usize][from as usize..to as usize].fill('#'));
        }
        rows.iter().rev().map(|row| row.iter().collect()).collect()
    }

    #[test]
    fn cells_with_their_centre_inside() {
        assert_eq!(
            drawn(&[[1.0, 1.0], [4.4, 1.0], [4.4, 3.6], [1.0, 3.6]]),
            [
                "......", //
                ".###..", //
                ".###..", //
                ".###..", //
                "......",
            ]
        );
    }

    #[test]
    fn an_outline_with_a_notch() {
        assert_eq!(
            drawn(&[[0.0, 0.0], [6.0, 0.0], [6.0, 5.0], [3.0, 1.0], [0.0, 5.0]]),
            ["......", "#....#", "##..##", "######", "######"]
        );
    }

    #[test]
    fn nothing_for_less_than_a_triangle() {
        assert_eq!(drawn(&[[1.0, 1.0], [4.0, 4.0]]), ["......"; 5]);
    }
}
