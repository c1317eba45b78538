//! Free space: the area that a scan sweeps, as an even-odd polygon fill.
//!
//! A cell is free where its centre lies inside the polygon of the scan. This visits no cell by itself: an edge of the
//! polygon toggles all cells to its right, by a single bit in each row that it crosses; afterwards the toggles
//! are summed up along the rows, 64 cells at a time. Nothing is sorted, and what a scan costs hardly
//! depends on how ragged it is.

use super::tiles::SIDE;

/// A bit for each cell of a tile, a word a row.
pub type Rows = [u64; SIDE as usize];

const NOTHING: Rows = [0; SIDE as usize];

/// Larger areas are not filled, in tiles: 32 MB. A scan of 60 m in cells of 1 cm is half of that; more
/// comes only from a pose that jumped while the scan was taken.
const MOST_TILES: usize = 1 << 16;

/// Turns the outline of a scan into the cells inside, tile by tile.
#[derive(Debug, Default)]
pub struct Outline {
    /// Corners in cells, x and y, relative to the corner of any tile.
    corners: [Vec<f32>; 2],
    /// Cells from which on the rest of the row is on the other side of the outline.
    toggles: Vec<Rows>,
    /// For each corner, the first row whose cell centres are not below it.
    rows: Vec<i32>,
    /// Numbers of the corners whose row is another than that of the corner before.
    edges: Vec<u32>,
}

impl Outline {
    /// Begins a new outline, with the corners that are put in here (cells); the last one is joined to the first.
    pub fn begin(&mut self) -> &mut [Vec<f32>; 2] {
        &mut self.corners
    }

    /// Adds a corner (cells).
    pub fn push(&mut self, x: f32, y: f32) {
        self.corners[0].push(x);
        self.corners[1].push(y);
    }

    /// Gives the cells whose centres are inside, for each tile that has any: its column and row of tiles, and the cells.
    #[inline(always)]
    pub fn fill(&mut self, mut found: impl FnMut(i32, i32, &Rows)) {
        let Some(area) = Area::around(&self.corners) else { return };
        if self.toggles.len() < area.tiles() {
            self.toggles.resize(area.tiles(), NOTHING);
        }
        self.toggle(&area);
        for strip in 0..area.height {
            // What of each row is inside where the tile begins: all bits or none.
            let mut carry = NOTHING;
            for column in 0..area.width {
                let tile = strip * area.width + column;
                let rows = &mut self.toggles[tile];
                let place = (area.low[0] + column as i32, area.low[1] + strip as i32);
                if *rows != NOTHING {
                    sum_up(rows, &mut carry);
                    found(place.0, place.1, rows);
                    *rows = NOTHING;
                } else if carry != NOTHING {
                    found(place.0, place.1, &carry);
                }
            }
        }
    }

    /// Sets the toggles where edges cross the rows of cell centres.
    #[inline(always)]
    fn toggle(&mut self, area: &Area) {
        let [xs, ys] = &self.corners;
        self.rows.clear();
        self.rows.extend(ys.iter().map(|&y| row_after(y)));
        let (left, columns) = (area.low[0] * SIDE, area.width as i32 * SIDE);
        let first = area.low[1] * area.width as i32;
        // Written in any case, counted if it crosses a row: a branch here would be guessed wrong every other time.
        self.edges.resize(self.rows.len(), 0);
        let (mut edges, mut before) = (0, self.rows.last().copied().unwrap_or_default());
        for (corner, &row) in self.rows.iter().enumerate() {
            self.edges[edges] = corner as u32;
            edges += usize::from(row != before);
            before = row;
        }
        for corner in self.edges[..edges].iter().map(|&corner| corner as usize) {
            let previous = corner.checked_sub(1).unwrap_or(self.rows.len() - 1);
            let (before, row) = (self.rows[previous], self.rows[corner]);
            let ([x, y], corner) = ([xs[previous], ys[previous]], [xs[corner], ys[corner]]);
            // In fixed point with 32 bits after it: a beam without return beside others makes edges over many rows.
            let slope = f64::from(corner[0] - x) / f64::from(corner[1] - y);
            let rows = before.min(row)..before.max(row);
            let crossing = f64::from(x) + (f64::from(rows.start) + 0.5 - f64::from(y)) * slope - 0.5;
            let step = (slope * ONE) as i64;
            // Rounded up, as all rows and columns are.
            let mut at = ((crossing * ONE) as i64).saturating_add(ONE as i64 - 1);
            // Rounding may leave the area by a cell.
            at = at.wrapping_sub(i64::from(left) << 32);
            let most = (i64::from(columns) << 32) - 1;
            for row in rows {
                let column = (at.clamp(0, most) >> 32) as i32;
                at = at.wrapping_add(step);
                let tile = (row >> 6) * area.width as i32 - first + (column >> 6);
                if let Some(row) = self.toggles.as_flattened_mut().get_mut((tile << 6 | row & 63) as usize) {
                    *row ^= 1 << (column & 63);
                }
            }
        }
    }
}

/// One cell in fixed point.
const ONE: f64 = (1u64 << 32) as f64;

/// Turns toggles into cells: each bit becomes the sum, modulo two, of the bits up to it, with what came before the tile.
#[inline(always)]
fn sum_up(rows: &mut Rows, carry: &mut Rows) {
    for (row, carry) in rows.iter_mut().zip(carry) {
        let mut sum = *row;
        for width in [1, 2, 4, 8, 16, 32] {
            sum ^= sum << width;
        }
        *row = sum ^ *carry;
        *carry = 0u64.wrapping_sub(*row >> 63);
    }
}

/// A rectangle of tiles.
struct Area {
    low: [i32; 2],
    width: usize,
    height: usize,
}

impl Area {
    /// The area around these corners and the cell to their right; `None` where there is nothing inside, or too much.
    #[inline(always)]
    fn around(corners: &[Vec<f32>; 2]) -> Option<Area> {
        if corners[0].len() < 3 {
            return None;
        }
        let extreme = |axis: usize, from: f32, choose: fn(f32, f32) -> f32| {
            // Eight at a time: one by one, each would wait for the one before.
            let (chunks, rest) = corners[axis].as_chunks::<8>();
            let start = [rest.iter().copied().fold(from, choose); 8];
            let all =
                chunks.iter().fold(start, |all, chunk| std::array::from_fn(|n| choose(all[n], chunk[n])));
            all.into_iter().fold(from, choose)
        };
        let least = |a: f32, b: f32| if b < a { b } else { a };
        let most = |a: f32, b: f32| if b > a { b } else { a };
        let low = [0, 1].map(|axis| extreme(axis, f32::MAX, least));
        let high = [0, 1].map(|axis| extreme(axis, f32::MIN, most));
        let tile = |at: f32| row_after(at) >> 6;
        let (low, high) = (low.map(tile), high.map(tile));
        let side = |axis: usize| (i64::from(high[axis]) - i64::from(low[axis]) + 1).max(0) as usize;
        let area = Area { low, width: side(0), height: side(1) };
        (area.width.saturating_mul(area.height) <= MOST_TILES).then_some(area)
    }

    fn tiles(&self) -> usize {
        self.width * self.height
    }
}

/// The first cell whose centre is not below `at`. Rounding up by hand: without SSE4.1, `ceil` is a call.
#[inline(always)]
fn row_after(at: f32) -> i32 {
    let at = at - 0.5;
    let whole = at as i32;
    whole.saturating_add(i32::from((whole as f32) < at))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn drawn(corners: &[[f32; 2]]) -> Vec<String> {
        let mut outline = Outline::default();
        let mut rows = vec![vec!['.'; 6]; 5];
        for _ in 0..2 {
            outline.begin().iter_mut().for_each(Vec::clear);
            rows.iter_mut().for_each(|row| row.fill('.'));
            corners.iter().for_each(|c| outline.push(c[0], c[1]));
            outline.fill(|column, row, inside| {
                assert_eq!((column, row), (0, 0));
                for (row, inside) in rows.iter_mut().zip(inside) {
                    for (column, cell) in row.iter_mut().enumerate() {
                        *cell = if inside >> column & 1 == 1 { '#' } else { '.' };
                    }
                }
            });
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

    #[test]
    fn poses_that_are_no_numbers_or_far_apart_do_no_harm() {
        for far in [f32::NAN, f32::INFINITY, 1e30, 1e7, 4_096.0] {
            let mut outline = Outline::default();
            for [x, y] in [[0.0, 0.0], [far, 1.0], [far, far], [-far, 5.0], [3.0, -far]] {
                outline.push(x, y);
            }
            outline.fill(|_, _, _| ());
        }
    }

    /// Whether the cell's centre has an odd number of edges to its left.
    fn inside(corners: &[[f32; 2]], column: i32, row: i32) -> bool {
        let (x, y) = (f64::from(column) + 0.5, f64::from(row) + 0.5);
        let next = corners.iter().cycle().skip(1);
        let crossed = |(a, b): (&[f32; 2], &[f32; 2])| {
            let ([x0, y0], [x1, y1]) = (a.map(f64::from), b.map(f64::from));
            (y0 <= y) != (y1 <= y) && x0 + (y - y0) * (x1 - x0) / (y1 - y0) <= x
        };
        corners.iter().zip(next).filter(|edge| crossed(*edge)).count() % 2 == 1
    }

    proptest! {
        #[test]
        fn cells_are_inside_as_the_definition_has_it(corners in proptest::collection::vec([-150..200, -90..100], 3..40)) {
            // Off any centre of a cell, where rounding would decide.
            let corners: Vec<[f32; 2]> = corners.iter().map(|c| c.map(|at| at as f32 + 0.0123)).collect();
            let mut outline = Outline::default();
            corners.iter().for_each(|c| outline.push(c[0], c[1]));
            let mut found = std::collections::HashMap::new();
            outline.fill(|column, row, rows| assert!(found.insert((column, row), *rows).is_none()));
            for (column, row) in (-192..256).flat_map(|column| (-128..128).map(move |row| (column, row))) {
                let rows = found.get(&(column >> 6, row >> 6)).unwrap_or(&NOTHING);
                let got = rows[(row & 63) as usize] >> (column & 63) & 1 == 1;
                let near = corners.iter().zip(corners.iter().cycle().skip(1)).any(|(a, b)| on_edge(*a, *b, column, row));
                prop_assert!(near || got == inside(&corners, column, row), "{column} {row}");
            }
        }
    }

    /// Whether rounding may decide on which side of the edge the cell's centre is.
    fn on_edge(a: [f32; 2], b: [f32; 2], column: i32, row: i32) -> bool {
        let ([x0, y0], [x1, y1]) = (a.map(f64::from), b.map(f64::from));
        let (x, y) = (f64::from(column) + 0.5, f64::from(row) + 0.5);
        (y0 <= y) != (y1 <= y) && (x0 + (y - y0) * (x1 - x0) / (y1 - y0) - x).abs() < 1e-3
    }
}
