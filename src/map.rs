//! A map as others see it: a rectangle of cells, made by a mapper at one moment, no longer changing.

use std::sync::Arc;

/// Values of one layer.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// 8-bit counts and flags.
    U8(Vec<u8>),
    /// 16-bit counts and binary angles (65536 a turn).
    U16(Vec<u16>),
    /// Metres, radians and ratios.
    F32(Vec<f32>),
}

/// One further value for each of some cells. Of most cells there is nothing to tell.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Name in map.npz.
    pub name: &'static str,
    /// Places in the map of these cells; the value of all others is 0.
    pub cells: Arc<[usize]>,
    /// A value for each of these.
    pub values: Values,
}

impl Layer {
    /// The values of all cells of a map with so many, row by row as in [`Map::occupancy`].
    pub fn spread(&self, area: usize) -> Values {
        match &self.values {
            Values::U8(values) => Values::U8(spread(&self.cells, values, area)),
            Values::U16(values) => Values::U16(spread(&self.cells, values, area)),
            Values::F32(values) => Values::F32(spread(&self.cells, values, area)),
        }
    }
}

fn spread<T: Copy + Default>(cells: &[usize], values: &[T], area: usize) -> Vec<T> {
    let mut all = vec![T::default(); area];
    for (&cell, &value) in cells.iter().zip(values) {
        all[cell] = value;
    }
    all
}

/// A snapshot of a grid.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// Side of a cell (m).
    pub resolution: f64,
    /// x and y of the lower left corner of the lower left cell (m).
    pub origin: [f64; 2],
    /// Cells in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// nav_msgs/OccupancyGrid's values: -1 unknown, 0 free, 100 occupied; row by row from the bottom.
    pub occupancy: Vec<i8>,
    /// How much of the view angles from which an occupied cell was looked at it was missed from: 100 all but a
    /// single direction (specular-like), 0 none (diffuse); -1 where the cell is not occupied. The second layer of
    /// the live view.
    pub visibility: Vec<i8>,
    /// All that the mapper knows of cells, for map.npz.
    pub layers: Vec<Layer>,
}
