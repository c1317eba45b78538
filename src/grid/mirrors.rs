//! The cells of a tile that something may be seen through or in, and all that images are judged by of them.

use super::{angle::AngleRange, reflection::ROUNDS, surface::Line, tiles::SIDE, view::Place};
use std::collections::BTreeMap;

/// What images are judged by of such a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mirror {
    /// The surface through it and its neighbours.
    pub line: Line,
    /// The widest range from which it was continuously observed.
    pub visible: AngleRange,
}

/// One of a tile, and whether it reflects in each round of [`super::reflection`].
#[derive(Clone, Debug)]
pub struct Reflecting {
    pub mirror: Mirror,
    rounds: [bool; ROUNDS],
}

impl From<Mirror> for Reflecting {
    /// Until something else is known, it does.
    fn from(mirror: Mirror) -> Reflecting {
        Reflecting { mirror, rounds: [true; ROUNDS] }
    }
}

/// Those of a tile.
#[derive(Clone, Debug)]
pub struct Mirrors {
    mirrors: BTreeMap<Place, Reflecting>,
    /// A bit for each of them, a word a row.
    rows: [u64; SIDE as usize],
    /// A bit for each cell that is one of these or beside one.
    near: [u64; SIDE as usize],
    /// For each square of 8 x 8 cells, row by row, how many squares away the nearest one is that holds such a cell.
    away: [u8; SQUARES * SQUARES],
}

/// Squares along the side of a tile, and cells along that of a square.
const SQUARES: usize = 8;
const CELLS: usize = SIDE as usize / SQUARES;

impl Mirrors {
    /// `None` where there are none.
    pub fn of(mirrors: BTreeMap<Place, Reflecting>) -> Option<Mirrors> {
        if mirrors.is_empty() {
            return None;
        }
        let mut rows = [0; SIDE as usize];
        mirrors.keys().for_each(|place| rows[usize::from(place >> 6)] |= 1 << (place & 63));
        let near = std::array::from_fn(|row| {
            let beside = [row.wrapping_sub(1), row + 1].map(|row| rows.get(row).copied().unwrap_or(0));
            rows[row] | rows[row] << 1 | rows[row] >> 1 | beside[0] | beside[1]
        });
        Some(Mirrors { mirrors, rows, near, away: away(&near) })
    }

    /// All of them, by their places in the tile.
    pub fn into_all(self) -> BTreeMap<Place, Reflecting> {
        self.mirrors
    }

    /// Whether the cell at this place is one of them.
    pub fn has(&self, place: Place) -> bool {
        self.rows[usize::from(place >> 6)] >> (place & 63) & 1 == 1
    }

    /// From now on, those reflect in a round for whose places this holds. Gives whether others did.
    pub fn set_reflecting(&mut self, round: usize, holds: impl Fn(Place) -> bool) -> bool {
        let mut are_others = false;
        for (place, mirror) in &mut self.mirrors {
            let before = std::mem::replace(&mut mirror.rounds[round], holds(*place));
            are_others |= before != mirror.rounds[round];
        }
        are_others
    }

    /// A rectangle around the cell in this column and row in which none is near: column and row of its lower left cell, and of the one
    /// beyond its upper right one.
    pub fn clear_around(&self, column: usize, row: usize) -> Option<[[u8; 2]; 2]> {
        let square = [column / CELLS, row / CELLS];
        let away = usize::from(self.away[square[1] * SQUARES + square[0]]);
        let low = square.map(|at| (CELLS * (at + 1).saturating_sub(away)) as u8);
        let high = square.map(|at| (CELLS * (at + away).min(SQUARES)) as u8);
        (away > 0).then_some([low, high])
    }

    /// The one in this column and row, or beside, that reflects in this round.
    pub fn near(&self, column: usize, row: usize, round: usize) -> Option<&Mirror> {
        if self.near[row] >> column & 1 == 0 {
            return None;
        }
        [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)]
            .into_iter()
            .map(|(x, y)| (column as i32 + x, row as i32 + y))
            .filter(|(x, y)| (0..SIDE).contains(x) && (0..SIDE).contains(y))
            .map(|(x, y)| (y << 6 | x) as Place)
            .filter(|place| self.has(*place))
            .filter_map(|place| self.mirrors.get(&place))
            .find(|mirror| mirror.rounds[round])
            .map(|mirror| &mirror.mirror)
    }

    /// Memory that they hold (bytes), but for what the tree takes beside its entries.
    pub fn bytes(&self) -> usize {
        size_of_val(self) + self.mirrors.len() * size_of::<(Place, Reflecting)>()
    }
}

/// See [`Mirrors::away`].
fn away(near: &[u64; SIDE as usize]) -> [u8; SQUARES * SQUARES] {
    // A bit for each square that holds a cell, or has been reached from there.
    let mut reached: [u8; SQUARES] = std::array::from_fn(|y| {
        let row = near[y * CELLS..][..CELLS].iter().fold(0, |all, row| all | row);
        (0..SQUARES).fold(0, |squares, x| squares | u8::from(row >> (x * CELLS) & 0xff != 0) << x)
    });
    let mut away = [0; SQUARES * SQUARES];
    while reached != [u8::MAX; SQUARES] {
        for (square, away) in away.iter_mut().enumerate() {
            *away += u8::from(reached[square / SQUARES] >> (square % SQUARES) & 1 == 0);
        }
        let wider = reached.map(|row| row | row << 1 | row >> 1);
        let row = |y: usize| wider.get(y).copied().unwrap_or(0);
        reached = std::array::from_fn(|y| row(y.wrapping_sub(1)) | row(y) | row(y + 1));
    }
    away
}
