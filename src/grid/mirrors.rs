//! The cells of a tile that something may be seen through or in, and all that images are judged by of them.

use super::{
    angle::AngleRange,
    squares::{CellsBySquare, cells_of},
    surface::{Line, off_normal},
    tiles::SIDE,
    view::Place,
    visagge::place_of,
};

/// What images are judged by of such a cell.
#[derive(Clone, Copy, Debug)]
pub struct Mirror {
    /// The surface through it and its neighbours.
    pub plane: Plane,
    /// The widest range from which it was continuously observed.
    pub visible: AngleRange,
}

/// Where something is mirrored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Cosine and sine of its normal's direction.
    normal: [f32; 2],
    /// From the map's origin to it, along the normal (m).
    offset: f32,
    /// Direction of the normal (rad, modulo pi).
    direction: f32,
}

/// How finely a plane is told: its direction (rad) and how far it passes the cell (m). Far finer than it is [known](super::reflection), so
/// that not each return changes it.
const DIRECTION: f64 = 1.0 / 512.0;
const PASSES: f64 = 0.005;

impl Plane {
    /// That of a line through the cell around this point (m), or past it.
    pub fn new(line: &Line, at: [f64; 2]) -> Plane {
        let rounded = |number: f64, step: f64| (number / step).round() * step;
        let along = |[cos, sin]: [f64; 2], [x, y]: [f64; 2]| x * cos + y * sin;
        let of = |direction: f64| [direction.cos(), direction.sin()];
        let exact = f64::from(line.normal);
        let passes = along(of(exact), [0, 1].map(|axis| f64::from(line.at[axis]) - at[axis]));
        let direction = rounded(exact, DIRECTION);
        let normal = of(direction);
        let offset = along(normal, at) + rounded(passes, PASSES);
        Plane { normal: normal.map(|at| at as f32), offset: offset as f32, direction: direction as f32 }
    }

    /// Direction of its normal, of length 1.
    pub fn normal(&self) -> [f64; 2] {
        self.normal.map(f64::from)
    }

    /// Angle between the normal and a view (rad, 0..pi/2).
    pub fn off_normal(&self, seen_from: f64) -> f64 {
        off_normal(f64::from(self.direction), seen_from)
    }

    /// The mirror images of points (m).
    pub fn reflect<const N: usize>(&self, points: [[f64; 2]; N]) -> [[f64; 2]; N] {
        let ([cos, sin], offset) = (self.normal(), f64::from(self.offset));
        points.map(|[x, y]| {
            let beyond = x * cos + y * sin - offset;
            [x - 2.0 * beyond * cos, y - 2.0 * beyond * sin]
        })
    }
}

/// A bit for each of some cells of a tile, a word a row.
pub type Rows = [u64; SIDE as usize];

/// Those of a tile.
#[derive(Clone, Debug)]
pub struct Mirrors {
    /// By their places.
    mirrors: Vec<Mirror>,
    rows: Rows,
    /// How many there are in the rows before each.
    before: [u16; SIDE as usize],
    /// In which cells a line of sight meets them.
    near: CellsBySquare,
}

/// These and the cells beside them: in which a line of sight [meets](Mirrors::nearest) one of them.
pub fn near(rows: Rows) -> CellsBySquare {
    let near = std::array::from_fn(|row| {
        let beside = [row.wrapping_sub(1), row + 1].map(|row| rows.get(row).copied().unwrap_or(0));
        rows[row] | rows[row] << 1 | rows[row] >> 1 | beside[0] | beside[1]
    });
    CellsBySquare::from(near)
}

impl Mirrors {
    /// These, each at its place; `None` where there are none.
    pub fn of(mut mirrors: Vec<(Place, Mirror)>) -> Option<Mirrors> {
        if mirrors.is_empty() {
            return None;
        }
        mirrors.sort_unstable_by_key(|(place, _)| *place);
        let mut rows: Rows = [0; SIDE as usize];
        mirrors.iter().for_each(|(place, _)| rows[usize::from(place >> 6)] |= 1 << (place & 63));
        let mut count = 0;
        let before = rows.map(|row| {
            count += row.count_ones() as u16;
            count - row.count_ones() as u16
        });
        // Collected in place, where there was room for the places too.
        let mut mirrors: Vec<Mirror> = mirrors.into_iter().map(|(_, mirror)| mirror).collect();
        mirrors.shrink_to_fit();
        Some(Mirrors { mirrors, rows, before, near: near(rows) })
    }

    /// All of them, by their places in the tile.
    pub fn iter(&self) -> impl Iterator<Item = (Place, &Mirror)> {
        let rows = self.rows.iter().enumerate();
        let places = rows
            .flat_map(|(row, &cells)| cells_of(cells).map(move |column| place_of([column as u8, row as u8])));
        places.zip(&self.mirrors)
    }

    /// Which of them the cell at this place is, if it is one of them.
    fn number(&self, place: Place) -> Option<usize> {
        let (row, column) = (usize::from(place >> 6), place & 63);
        let cells = self.rows[row];
        let number = self.before[row] as u32 + (cells & ((1 << column) - 1)).count_ones();
        (cells >> column & 1 == 1).then_some(number as usize)
    }

    /// The cell at this place, if it is one of them.
    pub fn get(&self, place: Place) -> Option<&Mirror> {
        self.number(place).map(|number| &self.mirrors[number])
    }

    /// The one in this column and row, or beside.
    pub fn nearest(&self, column: usize, row: usize) -> Option<&Mirror> {
        [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)]
            .into_iter()
            .map(|(x, y)| (column as i32 + x, row as i32 + y))
            .filter(|(x, y)| (0..SIDE).contains(x) && (0..SIDE).contains(y))
            .find_map(|(x, y)| self.get((y << 6 | x) as Place))
    }

    /// The cells in which a line of sight meets one of them: these and those beside them.
    pub fn near(&self) -> &CellsBySquare {
        &self.near
    }

    /// Memory that they hold (bytes).
    pub fn bytes(&self) -> usize {
        size_of_val(self) + self.mirrors.capacity() * size_of::<Mirror>() + self.near.bytes()
    }
}
