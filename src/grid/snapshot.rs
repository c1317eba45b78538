//! Grids as others see them: tile by tile ([`Snapshot`]), and as a rectangle of cells ([`Map`]).

use super::{
    angle::AngleRange,
    cell::{Cell, UNKNOWN},
    judge::Judgement,
    standard::Standard,
    tiles::{CellIndex, SIDE, TileIndex},
    visagge::{Tile, Visagge},
    visits::Visits,
};
use crate::map::{Layer, Map, Values};
use std::sync::{Arc, OnceLock, Weak};

/// A grid at one moment. Most of it is shared with the one before, and it is put together where and when somebody wants it whole.
#[derive(Debug)]
pub struct Snapshot {
    resolution: f64,
    tiles: Vec<(TileIndex, Arc<ShownTile>)>,
    map: OnceLock<Map>,
}

/// What others see of a tile.
#[derive(Debug)]
pub(super) struct ShownTile {
    /// A bit for each cell that a beam has crossed, a word a row. Boxed, since this memory stays as long as the tile does.
    free: Box<[u64; SIDE as usize]>,
    cells: Vec<ShownCell>,
}

/// And of a cell with evidence.
#[derive(Debug)]
struct ShownCell {
    place: [u8; 2],
    is_shown: bool,
    /// Values of layers, in the order of [`BYTES`] and of [`WORDS`].
    bytes: [u8; BYTES.len()],
    words: [u16; WORDS.len()],
}

/// The layers of map.npz.
const BYTES: [&str; 5] = ["occupancy_count", "passes", "glints", "verdict", "image"];
const WORDS: [&str; 9] = [
    "hits",
    "visible_start",
    "visible_width",
    "visible_too_start",
    "visible_too_width",
    "missed_width",
    "missed_since_start",
    "missed_since_width",
    "brightness",
];

impl From<Map> for Snapshot {
    fn from(map: Map) -> Snapshot {
        Snapshot { resolution: map.resolution, tiles: Vec::new(), map: map.into() }
    }
}

impl Snapshot {
    /// The map, put together when it is first asked for.
    pub fn map(&self) -> &Map {
        self.map.get_or_init(|| self.whole())
    }

    /// The same for who wants nothing else.
    pub fn put_together(mut self) -> Map {
        self.map.take().unwrap_or_else(|| self.whole())
    }

    fn whole(&self) -> Map {
        let frame = Frame::around(self.tiles.iter().flat_map(|(place, tile)| tile.corners(*place)));
        let mut map = frame.map(self.resolution);
        let count = self.tiles.iter().map(|(_, tile)| tile.cells.len()).sum();
        let mut cells = Vec::with_capacity(count);
        let mut bytes = BYTES.map(|_| Vec::with_capacity(count));
        let mut words = WORDS.map(|_| Vec::with_capacity(count));
        for (place, tile) in &self.tiles {
            for (first, count) in tile.crossed_rows(*place) {
                map.occupancy[frame.place(first)..][..count].fill(0);
            }
            for cell in &tile.cells {
                let place = frame.place(cell.index(*place));
                cells.push(place);
                if cell.is_shown {
                    map.occupancy[place] = 100;
                    map.visibility[place] = cell.specularity();
                }
                bytes.iter_mut().zip(cell.bytes).for_each(|(layer, value)| layer.push(value));
                words.iter_mut().zip(cell.words).for_each(|(layer, value)| layer.push(value));
            }
        }
        let cells: Arc<[usize]> = cells.into();
        let layer = |(name, values)| Layer { name, cells: Arc::clone(&cells), values };
        map.layers.extend(BYTES.into_iter().zip(bytes.map(Values::U8)).map(layer));
        map.layers.extend(WORDS.into_iter().zip(words.map(Values::U16)).map(layer));
        map
    }
}

impl ShownTile {
    fn of(tile: &Tile) -> ShownTile {
        let cells = tile.evidence.iter().flat_map(|evidence| evidence.cells.iter().zip(&evidence.judgements));
        let cells = cells.map(|(cell, judgement)| ShownCell::of(&cell, judgement)).collect();
        ShownTile { free: Box::new(tile.free), cells }
    }

    /// Rows of cells side by side that a beam has crossed: the first of each row, and how many they are.
    fn crossed_rows(&self, place: TileIndex) -> impl Iterator<Item = (CellIndex, usize)> {
        self.free.iter().enumerate().flat_map(move |(row, &cells)| {
            let mut left = cells;
            std::iter::from_fn(move || {
                let column = (left != 0).then(|| left.trailing_zeros())?;
                let count = (left >> column).trailing_ones();
                left &= u64::MAX.checked_shl(column + count).unwrap_or(0);
                Some((place.cell(column as usize, row), count as usize))
            })
        })
    }

    /// Corners of the smallest rectangle that holds all cells of which something is known, if not more.
    fn corners(&self, place: TileIndex) -> impl Iterator<Item = CellIndex> {
        let columns = self.free.iter().fold(0, |columns, row| columns | row);
        let mut rows = self.free.iter().enumerate().filter(|(_, cells)| **cells != 0).map(|(row, _)| row);
        let bottom = rows.next();
        let ends = bottom.zip(rows.next_back().or(bottom)).map(|(bottom, top)| {
            let (left, right) = (columns.trailing_zeros() as usize, columns.ilog2() as usize);
            [place.cell(left, bottom), place.cell(right, top)]
        });
        ends.into_iter().flatten().chain(self.cells.iter().map(move |cell| cell.index(place)))
    }
}

impl ShownCell {
    fn of(cell: &Cell, judgement: &Judgement) -> ShownCell {
        let Cell { returns, visible, visible_too, missed_width, missed_since } = cell;
        let too = if visible_too.way >= 0.0 { visible_too.range } else { AngleRange::default() };
        let ranges = [visible.range, too, *missed_since].map(|range| [range.start.0, range.width]);
        let [[visible_start, visible_width], [too_start, too_width], [since_start, since_width]] = ranges;
        ShownCell {
            place: returns.place,
            is_shown: judgement.verdict.is_shown(),
            bytes: [
                returns.occupancy,
                returns.passes,
                returns.glints,
                judgement.verdict as u8,
                judgement.image.number(),
            ],
            words: [
                returns.hits,
                visible_start,
                visible_width,
                too_start,
                too_width,
                *missed_width,
                since_start,
                since_width,
                // Without a sign: 0 where it is not known, 32768 as bright as the brightest walls.
                returns.brightness.wrapping_sub(UNKNOWN) as u16,
            ],
        }
    }

    fn index(&self, tile: TileIndex) -> CellIndex {
        tile.cell(usize::from(self.place[0]), usize::from(self.place[1]))
    }

    /// Percentage of the view angles that the cell was missed from, among those it was looked at from.
    fn specularity(&self) -> i8 {
        let [_, _, visible, _, _, missed, ..] = self.words.map(u32::from);
        (100 * missed / (missed + visible).max(1)) as i8
    }
}

/// A rectangle of cells that grows out of the cells that were seen.
struct Frame {
    low: CellIndex,
    width: usize,
    height: usize,
}

impl Frame {
    /// The smallest rectangle that holds all cells.
    fn around(cells: impl Iterator<Item = CellIndex>) -> Frame {
        let (low, high) = cells
            .fold(None, |bounds: Option<(CellIndex, CellIndex)>, cell| {
                let (low, high) = bounds.unwrap_or((cell, cell));
                Some((
                    CellIndex { x: low.x.min(cell.x), y: low.y.min(cell.y) },
                    CellIndex { x: high.x.max(cell.x), y: high.y.max(cell.y) },
                ))
            })
            .unwrap_or((CellIndex { x: 0, y: 0 }, CellIndex { x: -1, y: -1 }));
        Frame { low, width: (high.x - low.x + 1) as usize, height: (high.y - low.y + 1) as usize }
    }

    fn place(&self, cell: CellIndex) -> usize {
        (cell.y - self.low.y) as usize * self.width + (cell.x - self.low.x) as usize
    }

    fn area(&self) -> usize {
        self.width * self.height
    }

    fn map(&self, resolution: f64) -> Map {
        Map {
            resolution,
            origin: [f64::from(self.low.x) * resolution, f64::from(self.low.y) * resolution],
            width: self.width,
            height: self.height,
            occupancy: vec![-1; self.area()],
            visibility: vec![-1; self.area()],
            layers: Vec::new(),
        }
    }
}

impl Visagge {
    /// Decides which cells are shown.
    pub(super) fn decide(&mut self) {
        if self.as_in_the_paper {
            self.remove_motion();
            (0..self.tiles.len()).for_each(|number| self.tiles.at_mut(number).shown = Weak::new());
        } else {
            self.judge();
        }
    }

    /// The cells that a beam has crossed.
    pub(super) fn crossed(&self) -> impl Iterator<Item = CellIndex> {
        let side = SIDE as usize;
        self.tiles.iter().flat_map(move |(place, tile)| {
            (0..side * side)
                .filter(move |cell| tile.free[cell / side] >> (cell % side) & 1 == 1)
                .map(move |cell| place.cell(cell % side, cell / side))
        })
    }

    /// The map as it is now. Tiles in which nothing has changed are shared with the snapshot before this one, if it is still there.
    pub fn snapshot(&mut self) -> Snapshot {
        self.decide();
        let tiles = (0..self.tiles.len()).map(|number| {
            let tile = self.tiles.at_mut(number);
            let shown = tile.shown.upgrade().unwrap_or_else(|| {
                let shown = Arc::new(ShownTile::of(tile));
                tile.shown = Arc::downgrade(&shown);
                shown
            });
            (self.tiles.place(number), shown)
        });
        Snapshot { resolution: self.resolution, tiles: tiles.collect(), map: OnceLock::new() }
    }

    /// The same, put together.
    pub fn map(&mut self) -> Map {
        self.snapshot().put_together()
    }

    /// Memory that the grid holds (bytes).
    pub fn bytes(&self) -> usize {
        self.tiles
            .iter()
            .map(|(_, tile)| {
                size_of_val(tile)
                    + tile.driven.as_deref().map_or(0, size_of_val)
                    + tile.evidence.as_ref().map_or(0, |evidence| evidence.bytes())
            })
            .sum()
    }
}

impl Standard {
    /// The map as it is now.
    pub fn map(&self) -> Map {
        plain(self.resolution(), "log_odds", || self.cells())
    }
}

impl Visits {
    /// The map as it is now.
    pub fn map(&self) -> Map {
        plain(self.resolution(), "hit_ratio", || self.cells())
    }
}

/// The map of a grid that knows of each cell whether it is occupied, and one number, but not from where it is seen.
fn plain<I>(resolution: f64, layer: &'static str, cells: impl Fn() -> I) -> Map
where
    I: Iterator<Item = (CellIndex, bool, f32)>,
{
    let frame = Frame::around(cells().map(|(cell, ..)| cell));
    let mut map = frame.map(resolution);
    let (mut places, mut values) = (Vec::new(), Vec::new());
    for (cell, occupied, value) in cells() {
        let place = frame.place(cell);
        map.occupancy[place] = if occupied { 100 } else { 0 };
        if occupied {
            map.visibility[place] = 0;
        }
        places.push(place);
        values.push(value);
    }
    map.layers.push(Layer { name: layer, cells: places.into(), values: Values::F32(values) });
    map
}
