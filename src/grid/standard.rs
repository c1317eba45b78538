//! The standard occupancy grid, for comparison: log odds along every ray (Thrun, Probabilistic Robotics,
//! table 9.2), which assumes that whatever is there is seen from everywhere.

use super::{
    ray::{returns, walk},
    sweep::Sweep,
    tiles::{CellIndex, SIDE, Tiles},
};

/// Log odds, in hundredths, that a return adds: probability 0.7.
const HIT: i16 = 85;
/// Log odds that a beam takes from each cell it crosses: probability 0.4.
const CROSSED: i16 = -41;
/// The log odds stay within these bounds: probability 0.97.
const BOUND: i16 = 350;
/// Cells above this are occupied: probability 0.65, as nav2's map server has it.
const OCCUPIED: i16 = 62;

const CELLS: usize = (SIDE * SIDE) as usize;

/// One tile: log odds in hundredths, and flags, a word a row.
#[derive(Clone, Debug)]
struct Tile {
    odds: Box<[i16; CELLS]>,
    known: [u64; SIDE as usize],
    /// The cells that the scan of this number has updated: a hit goes before a miss, and each counts once.
    updated: [u64; SIDE as usize],
    scan: u64,
}

impl Default for Tile {
    fn default() -> Self {
        Tile { odds: Box::new([0; CELLS]), known: [0; SIDE as usize], updated: [0; SIDE as usize], scan: 0 }
    }
}

/// The grid.
#[derive(Debug)]
pub struct Standard {
    resolution: f64,
    range_max: f64,
    tiles: Tiles<Tile>,
    /// Counts the scans.
    scan: u64,
}

impl Standard {
    /// An empty grid of this resolution (m) that uses returns up to `range_max` (m).
    pub fn new(resolution: f64, range_max: f64) -> Standard {
        Standard { resolution, range_max, tiles: Tiles::default(), scan: 0 }
    }

    /// Inserts one scan: every cell with a return is more likely occupied, every cell before it free.
    pub fn insert(&mut self, sweep: &Sweep) {
        self.scan += 1;
        let ends: Vec<_> = returns(sweep, self.resolution, self.range_max).collect();
        for &(_, _, end) in &ends {
            self.update(end, HIT);
        }
        for (_, start, end) in ends {
            walk(start, end, |cell| self.update(cell, CROSSED));
        }
    }

    fn update(&mut self, cell: CellIndex, change: i16) {
        let (place, column, row) = cell.split();
        let number = self.tiles.find_or_make(place);
        let tile = self.tiles.at_mut(number);
        if tile.scan != self.scan {
            (tile.scan, tile.updated) = (self.scan, [0; SIDE as usize]);
        }
        if tile.updated[row] >> column & 1 == 1 {
            return;
        }
        tile.updated[row] |= 1 << column;
        let odds = &mut tile.odds[row * SIDE as usize + column];
        *odds = (*odds + change).clamp(-BOUND, BOUND);
        tile.known[row] |= 1 << column;
    }

    /// Side of a cell (m).
    pub(super) fn resolution(&self) -> f64 {
        self.resolution
    }

    /// Memory that the grid holds (bytes).
    pub fn bytes(&self) -> usize {
        self.tiles.len() * (size_of::<Tile>() + CELLS * size_of::<i16>())
    }

    /// All cells that were updated, and whether each is occupied.
    pub(super) fn cells(&self) -> impl Iterator<Item = (CellIndex, bool, f32)> {
        self.tiles.iter().flat_map(|(place, tile)| {
            (0..CELLS).filter_map(move |i| {
                let (row, column) = (i / SIDE as usize, i % SIDE as usize);
                let odds = tile.odds[i];
                (tile.known[row] >> column & 1 == 1)
                    .then(|| (place.cell(column, row), odds > OCCUPIED, f32::from(odds) / 100.0))
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{grid::sweep::tests::half_circle, pose::pose};

    #[test]
    fn a_wall_is_occupied_and_the_way_to_it_free() {
        let mut grid = Standard::new(0.5, 30.0);
        let scan = half_circle(0, vec![f32::NAN, 2.0, f32::INFINITY]);
        let at = pose(0.25, 0.25, 0.0);
        grid.insert(&Sweep { scan: &scan, start: at, end: at });
        let mut cells: Vec<_> = grid.cells().map(|(cell, occupied, _)| (cell.x, cell.y, occupied)).collect();
        cells.sort_unstable();
        assert_eq!(cells, [(0, 0, false), (1, 0, false), (2, 0, false), (3, 0, false), (4, 0, true)]);
    }

    #[test]
    fn glass_that_is_seen_through_is_lost() {
        let mut grid = Standard::new(0.5, 30.0);
        let at = pose(0.25, 0.25, 0.0);
        for (seq, range) in [2.0, 2.0, 5.0, 5.0, 5.0, 5.0].into_iter().enumerate() {
            let scan = half_circle(seq as u64, vec![f32::NAN, range, f32::NAN]);
            grid.insert(&Sweep { scan: &scan, start: at, end: at });
        }
        let occupied: Vec<_> = grid.cells().filter(|cell| cell.1).map(|(cell, ..)| cell.x).collect();
        assert_eq!(occupied, [10]);
    }
}
