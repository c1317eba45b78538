//! Which number a cell of a tile has: a table by place, in squares of 8 x 8 cells that are there only where a cell is. Most tiles
//! hold a few stray returns, and walls cross some squares of the others.

use super::{tiles::SIDE, view::Place};

/// Squares in a tile, and cells in one.
const SQUARES: usize = (SIDE * SIDE) as usize / CELLS;
const CELLS: usize = 64;
/// No cell.
const NONE: u16 = u16::MAX;

/// Numbers by place.
#[derive(Clone, Debug)]
pub struct Slots {
    /// Which of `numbers` each square has; beyond the end where it has none.
    squares: [u8; SQUARES],
    numbers: Vec<[u16; CELLS]>,
}

impl Default for Slots {
    fn default() -> Self {
        Slots { squares: [u8::MAX; SQUARES], numbers: Vec::new() }
    }
}

impl Slots {
    /// Number of the cell in this place, if there is one.
    #[inline(always)]
    pub fn get(&self, place: Place) -> Option<usize> {
        let (square, within) = split(place);
        let number = self.numbers.get(usize::from(self.squares[square]))?[within];
        (number != NONE).then_some(usize::from(number))
    }

    /// Gives the cell in this place a number.
    pub fn set(&mut self, place: Place, number: usize) {
        let (square, within) = split(place);
        if usize::from(self.squares[square]) >= self.numbers.len() {
            self.squares[square] = self.numbers.len() as u8;
            self.numbers.reserve_exact(1);
            self.numbers.push([NONE; CELLS]);
        }
        self.numbers[usize::from(self.squares[square])][within] = number as u16;
    }

    /// There is no cell in this place any more.
    pub fn clear(&mut self, place: Place) {
        let (square, within) = split(place);
        if let Some(numbers) = self.numbers.get_mut(usize::from(self.squares[square])) {
            numbers[within] = NONE;
        }
    }

    /// Whether a cell may be between these columns and rows, the last ones included.
    pub fn may_hold(&self, columns: [usize; 2], rows: [usize; 2]) -> bool {
        let [columns, rows] = [columns, rows].map(|[first, last]| first >> 3..=last >> 3);
        let is_there = |square: usize| usize::from(self.squares[square]) < self.numbers.len();
        rows.flat_map(|row| columns.clone().map(move |column| row << 3 | column)).any(is_there)
    }

    /// Memory beside itself (bytes).
    pub fn bytes(&self) -> usize {
        self.numbers.capacity() * size_of::<[u16; CELLS]>()
    }
}

/// The square that holds a place, and the place in it: the higher halves of row and column, and the lower ones.
#[inline(always)]
fn split(place: Place) -> (usize, usize) {
    let (row, column) = (usize::from(place >> 6) & 63, usize::from(place) & 63);
    (row & 0o70 | column >> 3, (row & 7) << 3 | column & 7)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_place_has_its_own_number() {
        let mut slots = Slots::default();
        let all = (SIDE * SIDE) as Place;
        assert!((0..all).all(|place| slots.get(place).is_none()));
        (0..all).rev().for_each(|place| slots.set(place, usize::from(place) ^ 0x5a5));
        assert!((0..all).all(|place| slots.get(place) == Some(usize::from(place) ^ 0x5a5)));
        slots.clear(77);
        assert_eq!((slots.get(77), slots.get(78)), (None, Some(78 ^ 0x5a5)));
        assert_eq!(slots.bytes(), 8192);
    }

    #[test]
    fn where_no_square_is_there_is_no_cell() {
        let mut slots = Slots::default();
        slots.set(17 << 6 | 40, 0);
        assert!(slots.may_hold([40, 40], [17, 17]) && slots.may_hold([0, 63], [0, 63]));
        assert!(slots.may_hold([30, 41], [10, 16]), "as far as squares tell");
        assert!(!slots.may_hold([30, 39], [16, 23]) && !slots.may_hold([40, 47], [24, 63]));
    }
}
