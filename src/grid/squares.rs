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
    /// Takes in the square that holds the cell in this column and row.
    pub fn insert(&mut self, [column, row]: [u8; 2]) {
        self.0 |= 1 << (row & 0o70 | column >> 3);
    }

    /// Those that hold one of these cells, of which each has a bit, a word a row.
    pub fn of(rows: [u64; SIDE as usize]) -> Squares {
        let (rows, _) = rows.as_chunks();
        Squares::of_counts(rows.iter().map(|rows: &[u64; 8]| rows.iter().fold(0, |all, cells| all | cells)))
    }

    /// Those whose byte is not 0, of words for the squares of eight rows each.
    fn of_counts(counts: impl Iterator<Item = u64>) -> Squares {
        let squares = |(row, counts): (usize, u64)| {
            let bit = |(column, count): (usize, u8)| u64::from(count != 0) << (8 * row + column);
            counts.to_le_bytes().into_iter().enumerate().map(bit).fold(0, |all, bit| all | bit)
        };
        Squares(counts.enumerate().map(squares).fold(0, |all, squares| all | squares))
    }

    /// Whether there is none.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }
}

/// How many cells there are in each square of a tile: a word for the squares of eight rows, a byte for each of these.
#[derive(Clone, Debug, Default)]
pub struct Counts([u64; IN_TILE as usize]);

impl Counts {
    /// From now on, of these cells, of which each has a bit, a word a row. Gives the squares in which there were not as many.
    pub fn update(&mut self, rows: &[u64; SIDE as usize]) -> Squares {
        let (rows, _) = rows.as_chunks();
        let count = |rows: &[u64; 8]| rows.iter().map(|cells| ones_by_byte(*cells)).sum();
        let counts = std::array::from_fn(|row| count(&rows[row]));
        let before = std::mem::replace(&mut self.0, counts);
        Squares::of_counts(counts.into_iter().zip(before).map(|(count, before)| count ^ before))
    }
}

/// How many bits are set in each byte.
fn ones_by_byte(word: u64) -> u64 {
    const EVERY_OTHER: u64 = 0x5555_5555_5555_5555;
    const PAIRS: u64 = 0x3333_3333_3333_3333;
    const NIBBLES: u64 = 0x0f0f_0f0f_0f0f_0f0f;
    let pairs = word - (word >> 1 & EVERY_OTHER);
    let nibbles = (pairs & PAIRS) + (pairs >> 2 & PAIRS);
    (nibbles + (nibbles >> 4)) & NIBBLES
}

/// The bits from one column to another and from one row to another, both included, of eight times eight, row by row.
pub fn rectangle([left, right]: [u32; 2], [bottom, top]: [u32; 2]) -> u64 {
    let first_column = 0x0101_0101_0101_0101;
    let columns: u64 = ((2 << right) - (1 << left)) * first_column;
    columns & u64::MAX << (8 * bottom) & u64::MAX >> (8 * (7 - top))
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

    /// The squares that hold one, and a bit for each of those in it, row by row.
    pub fn iter(&self) -> impl Iterator<Item = (usize, u64)> {
        cells_of(self.squares).zip(self.cells.iter().copied())
    }

    /// The squares that hold one.
    pub fn in_squares(&self) -> Squares {
        Squares(self.squares)
    }

    /// Those that are none of these others.
    pub fn but(&self, others: &CellsBySquare) -> CellsBySquare {
        self.joined(others, |cells, others| cells & !others)
    }

    /// Those that are one of both only.
    pub fn unlike(&self, others: &CellsBySquare) -> CellsBySquare {
        self.joined(others, |cells, others| cells ^ others)
    }

    /// What this makes of the cells of each square.
    fn joined(&self, others: &CellsBySquare, join: impl Fn(u64, u64) -> u64) -> CellsBySquare {
        let mut joined = CellsBySquare::default();
        for square in cells_of(self.squares | others.squares) {
            let cells = join(self.cells(square), others.cells(square));
            if cells != 0 {
                joined.squares |= 1 << square;
                joined.cells.push(cells);
            }
        }
        joined
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

/// The smallest rectangle of squares that holds some places, which may be in any tile. Columns and rows are counted from a tile's first
/// square; what is farther than can be told is taken for as far as can be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    low: [i8; 2],
    high: [i8; 2],
}

impl Default for Extent {
    /// Of nothing.
    fn default() -> Extent {
        Extent { low: [i8::MAX; 2], high: [i8::MIN; 2] }
    }
}

impl Extent {
    /// Takes in the cells between these two of that tile, seen from a tile.
    pub fn extend(&mut self, from: TileIndex, tile: TileIndex, [low, high]: [[usize; 2]; 2]) {
        let first = Extent::first(from, tile);
        for axis in 0..2 {
            let at = |at: usize| first[axis].saturating_add(at as i32 >> 3);
            let told = |at: i32| at.clamp(i8::MIN.into(), i8::MAX.into()) as i8;
            self.low[axis] = self.low[axis].min(told(at(low[axis])));
            self.high[axis] = self.high[axis].max(told(at(high[axis])));
        }
    }

    /// The smallest that holds both.
    pub fn and(self, other: Extent) -> Extent {
        let [low, high] = [[self.low, other.low], [self.high, other.high]];
        Extent {
            low: [0, 1].map(|axis| low[0][axis].min(low[1][axis])),
            high: [0, 1].map(|axis| high[0][axis].max(high[1][axis])),
        }
    }

    /// Whether one of these squares of that tile may be in it, seen from the same tile.
    pub fn touches(&self, from: TileIndex, tile: TileIndex, Squares(squares): Squares) -> bool {
        let first = Extent::first(from, tile);
        let [columns, rows] = [0, 1].map(|axis| {
            let low = if self.low[axis] == i8::MIN { i32::MIN } else { self.low[axis].into() };
            let high = if self.high[axis] == i8::MAX { i32::MAX } else { self.high[axis].into() };
            let [low, high] = [low, high].map(|at| at.saturating_sub(first[axis]));
            (low <= high && low < IN_TILE && high >= 0)
                .then(|| [low.max(0), high.min(IN_TILE - 1)].map(|at| at as u32))
        });
        columns.zip(rows).is_some_and(|(columns, rows)| squares & rectangle(columns, rows) != 0)
    }

    /// Column and row of a tile's first square, seen from another.
    fn first(from: TileIndex, tile: TileIndex) -> [i32; 2] {
        [(tile.x, from.x), (tile.y, from.y)]
            .map(|(tile, from)| tile.saturating_sub(from).saturating_mul(IN_TILE))
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
    fn cells_are_put_together_square_by_square() {
        let cells = |rows: &[(usize, u64)]| {
            let mut all = [0; SIDE as usize];
            rows.iter().for_each(|(row, cells)| all[*row] = *cells);
            all
        };
        let (a, b) = (cells(&[(0, 1), (9, 6)]), cells(&[(9, 2), (63, 1 << 63)]));
        let [of_a, of_b] = [a, b].map(CellsBySquare::from);
        assert_eq!(of_a.but(&of_b), cells(&[(0, 1), (9, 4)]).into());
        assert_eq!(of_a.unlike(&of_b), cells(&[(0, 1), (9, 4), (63, 1 << 63)]).into());
        assert_eq!(of_a.unlike(&of_a), CellsBySquare::default());
        assert_eq!(of_b.in_squares(), Squares::of(b));
    }

    #[test]
    fn squares_that_hold_more_cells_than_before_are_told() {
        let mut rows = [0; SIDE as usize];
        let mut counts = Counts::default();
        assert!(counts.update(&rows).is_empty());
        (rows[0], rows[15]) = (u64::MAX, 1 << 8);
        assert_eq!(counts.update(&rows), Squares(0xff | 1 << 9));
        assert!(counts.update(&rows).is_empty());
        rows[8..16].fill(u64::MAX);
        assert_eq!(counts.update(&rows), Squares(0xff << 8), "all 64 of them");
    }

    #[test]
    fn an_extent_is_touched_by_what_may_be_in_it() {
        let [here, left, far] = [(5, -3), (4, -3), (5000, -3)].map(|(x, y)| TileIndex { x, y });
        let square = |column: u8, row: u8| {
            let mut squares = Squares::default();
            squares.insert([column, row]);
            squares
        };
        let mut extent = Extent::default();
        assert!(!extent.touches(here, here, Squares(u64::MAX)), "of nothing");
        extent.extend(here, left, [[60, 16], [63, 23]]);
        assert!(extent.touches(here, left, square(56, 16)) && !extent.touches(here, left, square(55, 16)));
        assert!(!extent.touches(here, left, square(63, 24)) && !extent.touches(here, here, square(0, 16)));
        let both = extent.and({
            let mut other = Extent::default();
            other.extend(here, here, [[8, 0], [8, 0]]);
            other
        });
        assert!(both.touches(here, here, square(15, 23)) && !both.touches(here, here, square(16, 23)));
        assert!(!both.touches(here, far, Squares(u64::MAX)));
        extent.extend(here, far, [[0, 16], [0, 16]]);
        assert!(extent.touches(here, far, square(63, 16)), "as far as can be told");
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
