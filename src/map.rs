//! A map as others see it: a rectangle of cells, made by a mapper at one moment, no longer changing.

/// Values of one layer, row by row from the bottom (lowest y), each row from the left (lowest x).
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// 8-bit counts and flags.
    U8(Vec<u8>),
    /// 16-bit counts and binary angles (65536 a turn).
    U16(Vec<u16>),
    /// Metres, radians and ratios.
    F32(Vec<f32>),
}

/// One further value a cell.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Name in map.npz.
    pub name: &'static str,
    /// `width * height` values.
    pub values: Values,
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
    /// All that the mapper knows of each cell, for map.npz.
    pub layers: Vec<Layer>,
}
