//! Squares of 8 x 8 cells: how finely it is known where something has changed, and how far what is judged of a cell reaches.

use super::{
    surface::{MARGIN, WINDOW},
    tiles::{SIDE, TileIndex},
};
use std::ops::BitOr;

/// Squares along the side of a tile, of its margin, and of both margins and it.
const IN_TILE: i32 = SIDE / 8;
const IN_MARGIN: i32 = MARGIN / 8;
const IN_WINDOW: usize = WINDOW as usize / 8;
const _: () = assert!(MARGIN % 8 == 0 && IN_MARGIN <= IN_TILE && IN_WINDOW <= 16);

/// Some of a tile's squares.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Squares(u64);

impl BitOr for Squares {
    type Output = Squares;

    fn bitor(self, Squares(others): Squares) -> Squares {
        Squares(self.0 | others)
    }
}

impl Squares {
    /// All of them.
    pub const ALL: Squares = Squares(u64::MAX);

    /// Takes in the square that holds the cell in this column and row.
    pub fn insert(&mut self, [column, row]: [u8; 2]) {
        self.0 |= 1 << (row & 0o70 | column >> 3);
    }

    /// Whether there is none.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Column and row of each, among the squares.
    pub fn iter(self) -> impl Iterator<Item = [usize; 2]> {
        (0..64).filter(move |square| self.0 >> square & 1 == 1).map(|square| [square & 7, square >> 3])
    }
}

/// Some cells of a tile, square by square, for lines that go from one square to the next.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CellsBySquare {
    squares: u64,
    /// Of each square that holds one, in their order.
    cells: Vec<u64>,
}

impl From<[u64; SIDE as usize]> for CellsBySquare {
    /// From a bit for each cell, a word a row.
    fn from(rows: [u64; SIDE as usize]) -> CellsBySquare {
        let mut all = [0; SIDE as usize];
        for (row, cells) in rows.into_iter().enumerate().filter(|(_, cells)| *cells != 0) {
            for (square, cells) in (row & 0o70..).zip(cells.to_le_bytes()) {
                all[square] |= u64::from(cells) << (8 * (row & 7));
            }
        }
        let squares =
            (0..).zip(all).fold(0, |squares, (square, cells)| squares | u64::from(cells != 0) << square);
        CellsBySquare { squares, cells: all.into_iter().filter(|cells| *cells != 0).collect() }
    }
}

impl CellsBySquare {
    /// A bit for each square that holds one, row by row.
    pub fn squares(&self) -> u64 {
        self.squares
    }

    /// A bit for each of those in a square, row by row.
    pub fn cells(&self, square: usize) -> u64 {
        let before = (self.squares & ((1 << square) - 1)).count_ones();
        if self.squares >> square & 1 == 1 { self.cells[before as usize] } else { 0 }
    }

    /// Where a line of sight that met none of those `before` may meet one of these, or goes another way (from square to square that
    /// holds some).
    pub fn beyond(&self, before: &CellsBySquare) -> Squares {
        let both = self.squares & before.squares;
        let others = |square: &usize| self.cells(*square) & !before.cells(*square) != 0;
        let grown = (0..64).filter(|square| both >> square & 1 == 1).filter(others);
        Squares(grown.fold(self.squares ^ before.squares, |squares, square| squares | 1 << square))
    }

    /// The squares in which others are.
    pub fn unlike(&self, others: &CellsBySquare) -> Squares {
        self.beyond(others) | others.beyond(self)
    }

    /// Whether the cell in this column and row is one of them.
    pub fn has(&self, column: usize, row: usize) -> bool {
        self.cells(row & 0o70 | column >> 3) >> ((row & 7) << 3 | column & 7) & 1 == 1
    }

    /// Memory beside itself (bytes).
    pub fn bytes(&self) -> usize {
        self.cells.capacity() * size_of::<u64>()
    }
}

/// A bit for each of some cells of a tile and of its neighbours' next to it, a word a row.
pub struct CellsAround([u128; Self::ROWS as usize]);

impl CellsAround {
    /// How far around the tile they go.
    const MARGIN: i32 = 8;
    const ROWS: i32 = SIDE + 2 * Self::MARGIN;

    /// Those of these tiles.
    pub fn of<'a>(
        place: TileIndex,
        cells: impl Fn(TileIndex) -> Option<&'a [u64; SIDE as usize]>,
    ) -> CellsAround {
        let mut around = CellsAround([0; Self::ROWS as usize]);
        for (dx, dy) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))) {
            let Some(cells) = cells(TileIndex { x: place.x + dx, y: place.y + dy }) else { continue };
            let rows = (Self::MARGIN + dy * SIDE..).zip(cells);
            for (row, cells) in rows.filter(|(row, _)| (0..Self::ROWS).contains(row)) {
                let cells = u128::from(*cells);
                around.0[row as usize] |= match dx {
                    -1 => cells >> (SIDE - Self::MARGIN),
                    0 => cells << Self::MARGIN,
                    _ => cells << (SIDE + Self::MARGIN),
                };
            }
        }
        around
    }

    /// Whether the cell so many columns and rows from this one of the tile is among them.
    pub fn has(&self, [column, row]: [u8; 2], [x, y]: [i32; 2]) -> bool {
        let at = |at: u8, step: i32| (i32::from(at) + step + Self::MARGIN) as usize;
        self.0[at(row, y)] >> at(column, x) & 1 == 1
    }

    /// Those up to three columns and rows from this one of the tile: a bit for each, a word a row.
    pub fn near(&self, [column, row]: [u8; 2]) -> [u8; 7] {
        let first = |at: u8| usize::from(at) + Self::MARGIN as usize - 3;
        std::array::from_fn(|y| (self.0[first(row) + y] >> first(column)) as u8 & 0x7f)
    }
}

/// Some of the squares in a window around a tile ([`super::surface::Window`]).
#[derive(Clone, Copy, Debug, Default)]
pub struct SquaresAround {
    /// A bit for each, a word a row.
    rows: [u16; IN_WINDOW],
}

impl SquaresAround {
    /// Those of these tiles.
    pub fn of(place: TileIndex, squares: impl Fn(TileIndex) -> Squares) -> SquaresAround {
        let mut around = SquaresAround::default();
        for (dx, dy) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))) {
            let Squares(bits) = squares(TileIndex { x: place.x + dx, y: place.y + dy });
            for (row, bits) in (0..).zip(bits.to_le_bytes()) {
                let row = IN_MARGIN + dy * IN_TILE + row;
                if let Some(row) = usize::try_from(row).ok().and_then(|row| around.rows.get_mut(row)) {
                    // One tile to the left of the window's border, and cut at both of its borders.
                    let bits = u64::from(bits) << ((dx + 1) * IN_TILE);
                    *row |= (bits >> (IN_TILE - IN_MARGIN)) as u16 & (u16::MAX >> (16 - IN_WINDOW));
                }
            }
        }
        around
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.rows == [0; IN_WINDOW]
    }

    /// Whether one of them is within reach.
    pub fn touch(&self, reach: Reach) -> bool {
        let [(left, right), (bottom, top)] =
            [0, 1].map(|axis| (usize::from(reach.low[axis] >> 3), usize::from(reach.high[axis] >> 3)));
        let columns = (2 << right) - (1 << left);
        self.rows[bottom..=top].iter().any(|row| u32::from(*row) & columns != 0)
    }
}

/// The smallest rectangle that holds all cells that something was judged by. Columns and rows are those of the window.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reach {
    low: [u8; 2],
    high: [u8; 2],
}

impl Reach {
    /// A single cell of the tile in the middle of the window.
    pub fn at(cell: [u8; 2]) -> Reach {
        let at = cell.map(|at| at + MARGIN as u8);
        Reach { low: at, high: at }
    }

    /// Takes in a cell; what lies beyond the window is never looked at.
    pub fn extend(&mut self, [x, y]: [i32; 2]) {
        if (0..WINDOW).contains(&x) && (0..WINDOW).contains(&y) {
            for (axis, at) in [x as u8, y as u8].into_iter().enumerate() {
                self.low[axis] = self.low[axis].min(at);
                self.high[axis] = self.high[axis].max(at);
            }
        }
    }
}

/// The columns of a row's cells, of which each has a bit.
pub fn cells_of(mut row: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let column = (row != 0).then(|| row.trailing_zeros() as usize)?;
        row &= row - 1;
        Some(column)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_found_in_their_squares() {
        let mut rows = [0; SIDE as usize];
        (rows[9], rows[15], rows[63]) = (1 << 8 | 1 << 3, 1 << 15, 1 << 63);
        let cells = CellsBySquare::from(rows);
        assert_eq!(cells.squares(), 1 << 8 | 1 << 9 | 1 << 63);
        assert_eq!([8, 9, 63].map(|square| cells.cells(square)), [1 << 11, 1 << 8 | 1 << 63, 1 << 63]);
        assert_eq!(cells.cells(10), 0);
    }

    #[test]
    fn cells_of_nine_tiles_are_found() {
        let middle = TileIndex { x: 4, y: -1 };
        let (mut corner, mut own) = ([0; SIDE as usize], [0; SIDE as usize]);
        (corner[62], own[0]) = (1 << 57, 1 << 63);
        let around = CellsAround::of(middle, |place| match (place.x - middle.x, place.y - middle.y) {
            (-1, -1) => Some(&corner),
            (0, 0) | (1, 1) => Some(&own),
            _ => None,
        });
        assert!(around.has([63, 0], [0, 0]) && around.has([60, 3], [3, -3]));
        assert!(around.has([0, 0], [-7, -2]) && !around.has([0, 0], [-6, -2]));
        assert!(!around.has([63, 63], [1, 1]));
    }

    #[test]
    fn squares_of_nine_tiles_are_found_where_they_are_within_reach() {
        let middle = TileIndex { x: -3, y: 8 };
        // In the tile to the lower left the last square but three and the one before it; in the middle one the first.
        let around = SquaresAround::of(middle, |place| {
            let mut squares = Squares::default();
            match (place.x - middle.x, place.y - middle.y) {
                (-1, -1) => [[40, 63], [39, 63]].into_iter().for_each(|cell| squares.insert(cell)),
                (0, 0) => squares.insert([7, 0]),
                _ => (),
            }
            squares
        });
        let touches = |cell: [u8; 2], others: &[[i32; 2]]| {
            let mut reach = Reach::at(cell);
            others.iter().for_each(|other| reach.extend(*other));
            around.touch(reach)
        };
        assert!(touches([0, 7], &[]) && !touches([8, 0], &[]) && !touches([0, 8], &[]));
        assert!(touches([20, 9], &[[31, 40], [24, 24]]), "the first of its own tile");
        assert!(touches([63, 63], &[[7, 23]]) && !touches([63, 63], &[[7, 32]]), "the one to the lower left");
        assert!(!touches([9, 9], &[[-1, 0], [0, 112]]), "beyond the window");
        assert!(SquaresAround::of(middle, |_| Squares::default()).is_empty() && !around.is_empty());
    }
}
