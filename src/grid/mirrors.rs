//! The cells of a tile that something may be seen through or in, and all that images are judged by of them.

use super::{angle::AngleRange, reflection::ROUNDS, surface::Line, tiles::SIDE, view::Place};

/// What images are judged by of such a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mirror {
    /// The surface through it and its neighbours.
    pub line: Line,
    /// The widest range from which it was continuously observed.
    pub visible: AngleRange,
}

/// A bit for each of some cells of a tile, a word a row.
type Rows = [u64; SIDE as usize];

/// Those of a tile, and which of them reflect in each round of [`super::reflection`].
#[derive(Clone, Debug)]
pub struct Mirrors {
    /// By their places.
    mirrors: Vec<Mirror>,
    rows: Rows,
    /// How many there are in the rows before each.
    before: [u16; SIDE as usize],
    /// Those that reflect, round by round; in the first, all of them.
    reflecting: [Reflecting; ROUNDS],
}

/// Those of a tile that reflect in a round.
#[derive(Clone, Debug)]
pub struct Reflecting {
    /// A bit for each square of 8 x 8 cells that holds one of these or a cell beside one, row by row.
    squares: u64,
    /// Of each of these squares, a bit for each cell that is one, and for each that is one or beside one, row by row.
    cells: Vec<[u64; 2]>,
}

impl From<Rows> for Reflecting {
    fn from(rows: Rows) -> Reflecting {
        let mut all = [[0; 2]; SIDE as usize];
        for row in 0..SIDE as usize {
            let [below, above] =
                [row.wrapping_sub(1), row + 1].map(|row| rows.get(row).copied().unwrap_or(0));
            let near = rows[row] | rows[row] << 1 | rows[row] >> 1 | below | above;
            for (kind, cells) in [rows[row], near].into_iter().enumerate() {
                for (square, cells) in (row & 0o70..).zip(cells.to_le_bytes()) {
                    all[square][kind] |= u64::from(cells) << (8 * (row & 7));
                }
            }
        }
        let squares =
            (0..).zip(&all).fold(0, |squares, (square, [_, near])| squares | u64::from(*near != 0) << square);
        let mut cells = Vec::with_capacity(squares.count_ones() as usize);
        cells.extend(all.into_iter().filter(|[_, near]| *near != 0));
        Reflecting { squares, cells }
    }
}

impl Reflecting {
    /// A bit for each square of 8 x 8 cells that holds one of these or a cell beside one, row by row.
    pub fn squares(&self) -> u64 {
        self.squares
    }

    /// Of a square, a bit for each cell that is one of these, and for each that is one or beside one, row by row.
    fn square(&self, square: usize) -> [u64; 2] {
        let before = (self.squares & ((1 << square) - 1)).count_ones();
        if self.squares >> square & 1 == 1 { self.cells[before as usize] } else { [0; 2] }
    }

    /// A bit for each cell of a square that is one of these or beside one, row by row.
    pub fn near(&self, square: usize) -> u64 {
        self.square(square)[1]
    }

    /// Place of the one in this column and row, or beside, where one is near.
    pub fn nearest(&self, column: usize, row: usize) -> Option<Place> {
        [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)]
            .into_iter()
            .map(|(x, y)| (column as i32 + x, row as i32 + y))
            .filter(|(x, y)| (0..SIDE).contains(x) && (0..SIDE).contains(y))
            .map(|(x, y)| (y << 6 | x) as Place)
            .find(|place| self.has(*place))
    }

    /// Whether the cell at this place is one of these.
    fn has(&self, place: Place) -> bool {
        let (row, column) = (usize::from(place >> 6), usize::from(place & 63));
        self.square(row & 0o70 | column >> 3)[0] >> ((row & 7) << 3 | column & 7) & 1 == 1
    }
}

impl Mirrors {
    /// These, each at its place; `None` where there are none. Until something else is known, those reflect that were not `before`.
    pub fn of(mut mirrors: Vec<(Place, Mirror)>, before: Option<&Mirrors>) -> Option<Mirrors> {
        if mirrors.is_empty() {
            return None;
        }
        mirrors.sort_unstable_by_key(|(place, _)| *place);
        let mut rows: Rows = [0; SIDE as usize];
        mirrors.iter().for_each(|(place, _)| rows[usize::from(place >> 6)] |= 1 << (place & 63));
        let mut count = 0;
        let counts = rows.map(|row| {
            count += row.count_ones() as u16;
            count - row.count_ones() as u16
        });
        let reflecting = std::array::from_fn(|round| {
            let mut reflecting = rows;
            for before in before.iter() {
                for (place, _) in before.iter().filter(|(place, _)| !before.reflecting[round].has(*place)) {
                    reflecting[usize::from(place >> 6)] &= !(1 << (place & 63));
                }
            }
            reflecting.into()
        });
        let mirrors = mirrors.into_iter().map(|(_, mirror)| mirror).collect();
        Some(Mirrors { mirrors, rows, before: counts, reflecting })
    }

    /// All of them, by their places in the tile.
    pub fn iter(&self) -> impl Iterator<Item = (Place, &Mirror)> {
        let places = self.rows.iter().enumerate().flat_map(|(row, &cells)| {
            (0..SIDE as Place)
                .filter(move |column| cells >> column & 1 == 1)
                .map(move |column| (row as Place) << 6 | column)
        });
        places.zip(&self.mirrors)
    }

    /// The cell at this place, if it is one of them.
    pub fn get(&self, place: Place) -> Option<&Mirror> {
        let (row, column) = (usize::from(place >> 6), place & 63);
        let cells = self.rows[row];
        let number = self.before[row] as u32 + (cells & ((1 << column) - 1)).count_ones();
        (cells >> column & 1 == 1).then(|| &self.mirrors[number as usize])
    }

    /// Those that reflect in this round.
    pub fn reflecting(&self, round: usize) -> &Reflecting {
        &self.reflecting[round]
    }

    /// From now on, those reflect in a round for whose places this holds. Gives whether others did.
    pub fn set_reflecting(&mut self, round: usize, holds: impl Fn(Place) -> bool) -> bool {
        let mut rows: Rows = [0; SIDE as usize];
        for (place, _) in self.iter().filter(|(place, _)| holds(*place)) {
            rows[usize::from(place >> 6)] |= 1 << (place & 63);
        }
        let are_others = self.iter().any(|(place, _)| {
            self.reflecting[round].has(place) != (rows[usize::from(place >> 6)] >> (place & 63) & 1 == 1)
        });
        if are_others {
            self.reflecting[round] = rows.into();
        }
        are_others
    }

    /// Whether these are the same.
    pub fn are(&self, others: &Mirrors) -> bool {
        self.rows == others.rows && self.mirrors == others.mirrors
    }

    /// Memory that they hold (bytes).
    pub fn bytes(&self) -> usize {
        let squares: usize = self.reflecting.iter().map(|reflecting| reflecting.cells.capacity()).sum();
        size_of_val(self) + self.mirrors.capacity() * size_of::<Mirror>() + squares * size_of::<[u64; 2]>()
    }
}
