//! Storage that grows with what was seen: square tiles of 64 x 64 cells, found by their place.
//!
//! A tile is made when something in it is first written. Nothing is ever allocated for the space between.

use std::{
    collections::HashMap,
    hash::{BuildHasherDefault, Hasher},
};

/// Cells along a tile's side. 64, so that a row of flags is one word.
pub const SIDE: i32 = 64;

/// Place of a cell: columns and rows counted from the map frame's origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct CellIndex {
    /// Column, growing with x.
    pub x: i32,
    /// Row, growing with y.
    pub y: i32,
}

impl CellIndex {
    /// The cell that holds the point (m) in a grid of this resolution (m).
    pub fn of(x: f64, y: f64, resolution: f64) -> CellIndex {
        CellIndex { x: floor(x / resolution), y: floor(y / resolution) }
    }

    /// Its middle (m) in such a grid.
    pub fn middle(self, resolution: f64) -> [f64; 2] {
        [self.x, self.y].map(|index| (f64::from(index) + 0.5) * resolution)
    }

    /// Whether its middle is within so far of a point (m) in such a grid.
    pub fn is_within(self, distance: f64, [x, y]: [f64; 2], resolution: f64) -> bool {
        let [at_x, at_y] = self.middle(resolution);
        (at_x - x).powi(2) + (at_y - y).powi(2) <= distance * distance
    }

    /// Place of the tile that holds the cell, and the cell's column and row in it.
    pub fn split(self) -> (TileIndex, usize, usize) {
        let tile = TileIndex { x: self.x >> 6, y: self.y >> 6 };
        (tile, (self.x & 63) as usize, (self.y & 63) as usize)
    }
}

/// Rounded down; without SSE4.1, `f64::floor` is a call.
pub(super) fn floor(number: f64) -> i32 {
    let whole = number as i32;
    whole.saturating_sub(i32::from(f64::from(whole) > number))
}

/// In `f64`, neighbours of 1.5 x 2^52 are whole numbers.
const ROUNDER: f64 = (3u64 << 51) as f64;

/// The nearest whole number, for numbers below 2^51: the addition rounds. Beyond it is any.
pub(super) fn whole(number: f64) -> i64 {
    // The whole number stands in the low bits, negative ones as their two's complement.
    (number + ROUNDER).to_bits().wrapping_sub(ROUNDER.to_bits()) as i64
}

/// The same as [`floor`] for numbers below 2^31, without minding what no integer can be. Beyond it is any.
pub(super) fn floor_near(number: f64) -> i32 {
    let is_above = (number + ROUNDER) - ROUNDER > number;
    (whole(number) - i64::from(is_above)) as i32
}

/// Place of a tile: its lower left cell is at 64 times these.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TileIndex {
    /// Column of tiles.
    pub x: i32,
    /// Row of tiles.
    pub y: i32,
}

impl TileIndex {
    /// The cell in this column and row of the tile.
    pub fn cell(self, column: usize, row: usize) -> CellIndex {
        CellIndex { x: self.x * SIDE + column as i32, y: self.y * SIDE + row as i32 }
    }
}

/// Hashes places by a multiplication for each number: they come from no adversary, and the standard
/// library's hash costs as much as all else that is done to find a tile.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PlaceHasher(u64);

impl Hasher for PlaceHasher {
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| self.write_u32(byte.into()));
    }

    fn write_i32(&mut self, number: i32) {
        self.write_u32(number as u32);
    }

    fn write_u32(&mut self, number: u32) {
        // 2^64 over the golden ratio: neighbours land far apart.
        self.0 = (self.0.rotate_left(32) ^ u64::from(number)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }

    fn finish(&self) -> u64 {
        // The table takes its buckets from the low bits and its tags from the highest; both shall be mixed.
        self.0 ^ self.0 >> 32
    }
}

/// A tile that was looked for: its place, and its number, which is [`NONE`] as long as there was no such tile. Scan after scan goes to
/// the tiles around the sensor, and most need not be looked up.
#[derive(Clone, Copy, Debug)]
struct Recent {
    place: TileIndex,
    number: u32,
}

const NONE: u32 = u32::MAX;
/// In a square of so many tiles none is in the way of another: 51 m in cells of 5 cm.
const RECENT_SIDE: i32 = 16;
const RECENT: usize = (RECENT_SIDE * RECENT_SIDE) as usize;

#[inline(always)]
fn recent(place: TileIndex) -> usize {
    ((place.y & (RECENT_SIDE - 1)) * RECENT_SIDE + (place.x & (RECENT_SIDE - 1))) as usize
}

/// Tiles by place, kept in the order in which they were made.
#[derive(Clone, Debug)]
pub struct Tiles<T> {
    numbers: HashMap<TileIndex, u32, BuildHasherDefault<PlaceHasher>>,
    /// Some of these once more, each where its place tells ([`Recent`]).
    recent: [Recent; RECENT],
    /// Apart from the tiles, so that going through all places touches little memory.
    places: Vec<TileIndex>,
    tiles: Vec<T>,
}

impl<T> Default for Tiles<T> {
    fn default() -> Self {
        let recent = [Recent { place: TileIndex { x: 0, y: 0 }, number: NONE }; RECENT];
        Tiles { numbers: HashMap::default(), recent, places: Vec::new(), tiles: Vec::new() }
    }
}

impl<T: Default> Tiles<T> {
    /// Number of the tile at this place, if there is one.
    pub fn find(&self, place: TileIndex) -> Option<usize> {
        if let Some(number) = self.recent(place) {
            return Some(number);
        }
        self.numbers.get(&place).map(|&number| number as usize)
    }

    /// Number of the tile at this place; it is made where it was missing.
    #[inline(always)]
    pub fn find_or_make(&mut self, place: TileIndex) -> usize {
        if let Some(number) = self.recent(place) {
            return number;
        }
        let number = self.look_up_or_make(place);
        self.recent[recent(place)] = Recent { place, number: number as u32 };
        number
    }

    #[inline(always)]
    fn recent(&self, place: TileIndex) -> Option<usize> {
        let found = &self.recent[recent(place)];
        (found.place == place && found.number != NONE).then_some(found.number as usize)
    }

    #[inline(never)]
    fn look_up_or_make(&mut self, place: TileIndex) -> usize {
        let next = self.tiles.len() as u32;
        let number = *self.numbers.entry(place).or_insert(next);
        if number == next {
            self.places.push(place);
            self.tiles.push(T::default());
        }
        number as usize
    }

    /// The tile at this place.
    pub fn get(&self, place: TileIndex) -> Option<&T> {
        self.find(place).map(|number| &self.tiles[number])
    }

    /// The tile with this number.
    pub fn at(&self, number: usize) -> &T {
        &self.tiles[number]
    }

    /// The tile with this number.
    pub fn at_mut(&mut self, number: usize) -> &mut T {
        &mut self.tiles[number]
    }

    /// Place of the tile with this number.
    pub fn place(&self, number: usize) -> TileIndex {
        self.places[number]
    }

    /// The places of all tiles, by their number.
    pub fn places(&self) -> &[TileIndex] {
        &self.places
    }

    /// How many tiles there are.
    pub fn len(&self) -> usize {
        self.tiles.len()
    }

    /// Whether nothing was ever written.
    pub fn is_empty(&self) -> bool {
        self.tiles.is_empty()
    }

    /// All tiles with their places.
    pub fn iter(&self) -> impl Iterator<Item = (TileIndex, &T)> {
        self.places.iter().copied().zip(&self.tiles)
    }

    /// Lower left and upper right tile of the smallest rectangle that holds all.
    pub fn bounds(&self) -> Option<(TileIndex, TileIndex)> {
        let first = self.places.first()?;
        Some(self.places.iter().fold((*first, *first), |(low, high), place| {
            (
                TileIndex { x: low.x.min(place.x), y: low.y.min(place.y) },
                TileIndex { x: high.x.max(place.x), y: high.y.max(place.y) },
            )
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_left_of_the_origin_have_their_own_tiles() {
        let (tile, column, row) = CellIndex::of(-0.01, 3.21, 0.05).split();
        assert_eq!((tile, column, row), (TileIndex { x: -1, y: 1 }, 63, 0));
        assert_eq!(tile.cell(column, row), CellIndex { x: -1, y: 64 });
    }

    #[test]
    fn tiles_that_share_a_place_among_the_recent_are_told_apart() {
        let mut tiles = Tiles::<u8>::default();
        let places = [0, 1, RECENT_SIDE, -RECENT_SIDE].map(|x| TileIndex { x, y: 0 });
        assert!(places.iter().all(|place| tiles.find(*place).is_none()));
        for _ in 0..2 {
            assert_eq!(places.map(|place| tiles.find_or_make(place)), [0, 1, 2, 3]);
            assert_eq!(places.map(|place| tiles.find(place)), [Some(0), Some(1), Some(2), Some(3)]);
        }
        assert_eq!(tiles.len(), 4);
    }

    #[test]
    fn numbers_are_rounded_down_alike() {
        let numbers = [0.0, -0.0, 0.5, 1.5, 2.5, -0.5, -1.5, -1.0, 3.0, 0.999_999_999_999, -1e-12, 2e9, -2e9];
        numbers.into_iter().for_each(|number| assert_eq!(floor_near(number), floor(number), "{number}"));
    }

    #[test]
    fn only_what_was_written_is_kept() {
        let mut tiles = Tiles::<u8>::default();
        assert_eq!(tiles.bounds(), None);
        let far = TileIndex { x: 1_000, y: -1_000 };
        let number = tiles.find_or_make(far);
        *tiles.at_mut(number) = 7;
        tiles.find_or_make(TileIndex { x: 0, y: 0 });
        assert_eq!(tiles.find_or_make(far), number);
        assert_eq!(tiles.len(), 2);
        assert_eq!(tiles.get(far), Some(&7));
        assert_eq!(tiles.bounds(), Some((TileIndex { x: 0, y: -1_000 }, TileIndex { x: 1_000, y: 0 })));
    }
}
