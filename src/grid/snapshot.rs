//! Grids as a rectangle of cells: [`Map`].

use super::{
    cell::Cell,
    standard::Standard,
    tiles::{CellIndex, SIDE},
    visagge::Visagge,
    visits::Visits,
};
use crate::map::{Layer, Map, Values};
use std::sync::Arc;

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

    /// Rows of cells side by side that a beam has crossed: the first of each row, and how many they are.
    fn crossed_rows(&self) -> impl Iterator<Item = (CellIndex, usize)> {
        self.tiles.iter().flat_map(|(place, tile)| {
            tile.free.iter().enumerate().flat_map(move |(row, &cells)| {
                let mut left = cells;
                std::iter::from_fn(move || {
                    let column = (left != 0).then(|| left.trailing_zeros())?;
                    let count = (left >> column).trailing_ones();
                    left &= u64::MAX.checked_shl(column + count).unwrap_or(0);
                    Some((place.cell(column as usize, row), count as usize))
                })
            })
        })
    }

    /// The map as it is now.
    pub fn map(&mut self) -> Map {
        self.decide();
        let ends = self.crossed_rows().flat_map(|(first, count)| {
            let last = CellIndex { x: first.x + count as i32 - 1, ..first };
            [first, last]
        });
        let frame = Frame::around(ends.chain(self.cells().map(|(index, ..)| index)));
        let mut map = frame.map(self.resolution);
        for (first, count) in self.crossed_rows() {
            map.occupancy[frame.place(first)..][..count].fill(0);
        }
        let mut cells = Vec::new();
        let mut bytes = ["occupancy_count", "passes", "verdict", "image"].map(|name| (name, Vec::new()));
        let mut words = [
            "hits",
            "visible_start",
            "visible_width",
            "visible_too_start",
            "visible_too_width",
            "missed_start",
            "missed_width",
        ]
        .map(|name| (name, Vec::new()));
        for (index, cell, judgement) in self.cells() {
            let place = frame.place(index);
            cells.push(place);
            if judgement.verdict.is_shown() {
                map.occupancy[place] = 100;
                map.visibility[place] = specularity(&cell);
            }
            for ((_, layer), value) in bytes.iter_mut().zip([
                cell.returns.occupancy,
                cell.returns.passes,
                judgement.verdict as u8,
                judgement.image.number(),
            ]) {
                layer.push(value);
            }
            let too = if cell.visible_too.way >= 0.0 { cell.visible_too.range } else { Default::default() };
            let values = [
                cell.returns.hits,
                cell.visible.range.start.0,
                cell.visible.range.width,
                too.start.0,
                too.width,
                cell.missed.start.0,
                cell.missed.width,
            ];
            for ((_, layer), value) in words.iter_mut().zip(values) {
                layer.push(value);
            }
        }
        let cells: Arc<[usize]> = cells.into();
        let layer = |name, values| Layer { name, cells: Arc::clone(&cells), values };
        map.layers.extend(bytes.map(|(name, values)| layer(name, Values::U8(values))));
        map.layers.extend(words.map(|(name, values)| layer(name, Values::U16(values))));
        map
    }

    /// Memory that the grid holds (bytes).
    pub fn bytes(&self) -> usize {
        self.tiles
            .iter()
            .map(|(_, tile)| {
                size_of_val(tile) + tile.evidence.as_ref().map_or(0, |evidence| evidence.bytes())
            })
            .sum()
    }
}

/// Percentage of the view angles that a cell was missed from, among those it was looked at from.
fn specularity(cell: &Cell) -> i8 {
    let (missed, visible) = (u32::from(cell.missed.width), u32::from(cell.visible.range.width));
    (100 * missed / (missed + visible).max(1)) as i8
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
