//! A matching map: what surfaces were met where, and how surely they are there still.
//!
//! Cells of 10 cm that hold mean, spread and normal of the returns in them (a surface is known to millimetres, not to a
//! cell), and how many key scans hit them and saw through them: a person who walks by leaves little behind. Not the map that
//! is shown; that is in [`grid`](crate::grid).

use super::points::{Points, Spread};
use crate::pose::Pose;
use nalgebra::{Point2, Vector2};

/// Side of a cell (m): several deviations of the range noise, less than the distance between things.
pub const CELL: f64 = 0.1;
/// Cells along a tile's side.
const SIDE: i32 = 32;
const AREA: usize = (SIDE * SIDE) as usize;
/// Weight of the returns so far against a new one: none counts for more than this many.
const MEMORY: f32 = 200.0;
/// Hits and misses are halved at this sum, so that what changes is believed within some metres of driving.
const EVIDENCE: u16 = 60;
/// A beam has seen through a cell where it passes its surface within this distance (m).
const THROUGH: f64 = 0.03;
/// ... and meets it less grazing than this (sine of the angle): grazing beams often return nothing (measured: beyond
/// 75 degrees of incidence).
const GRAZING: f64 = 0.26;
/// A beam clears only up to this distance before its return (m).
const CLEAR_BEFORE: f64 = 0.15;

/// What a cell knows of the surface in it.
#[derive(Clone, Copy, Debug, Default)]
struct Surface {
    /// Returns, at most [`MEMORY`].
    count: f32,
    /// Their mean, from the cell's lower left corner (m).
    mean: [f32; 2],
    /// Their spread: xx, xy, yy (m2).
    spread: [f32; 3],
    /// Sum of their normals.
    normal: [f32; 2],
    hits: u16,
    misses: u16,
    /// Key scan that counted last, as hit and as miss.
    last_hit: u32,
    last_miss: u32,
}

impl Surface {
    fn existence(&self) -> f32 {
        f32::from(self.hits) / (f32::from(self.hits) + f32::from(self.misses) + 1.0)
    }

    fn normal(&self) -> Option<Vector2<f64>> {
        let normal = Vector2::new(f64::from(self.normal[0]), f64::from(self.normal[1]));
        let length = normal.norm();
        (length > 1e-3).then(|| normal / length)
    }

    /// Takes in `returns` of them at one point.
    fn add(&mut self, at: [f32; 2], normal: Option<Vector2<f64>>, returns: f32) {
        self.count = (self.count + returns).min(MEMORY);
        let part = returns / self.count;
        let before = [at[0] - self.mean[0], at[1] - self.mean[1]];
        self.mean[0] += before[0] * part;
        self.mean[1] += before[1] * part;
        let after = [at[0] - self.mean[0], at[1] - self.mean[1]];
        let squares = [before[0] * after[0], before[0] * after[1], before[1] * after[1]];
        for (spread, square) in self.spread.iter_mut().zip(squares) {
            *spread += (square - *spread) * part;
        }
        if let Some(normal) = normal {
            self.normal[0] += normal.x as f32;
            self.normal[1] += normal.y as f32;
        }
    }

    /// Its mean place, in this column and row (m).
    fn place(&self, x: i32, y: i32) -> Point2<f64> {
        let [dx, dy] = self.mean.map(f64::from);
        Point2::new(f64::from(x) * CELL + dx, f64::from(y) * CELL + dy)
    }

    fn evidence(&mut self) {
        if self.hits + self.misses > EVIDENCE {
            self.hits /= 2;
            self.misses /= 2;
        }
    }
}

/// What is known of a cell, beside its surface.
const FREE: u8 = 1;
const HAS_SURFACE: u8 = 2;
/// The surface was seen whenever it was looked at from before it: who sees through it is not there.
const OPAQUE: u8 = 4;

#[derive(Clone, Debug)]
struct Tile {
    flags: [u8; AREA],
    /// Number in `surfaces` for each cell that has one; empty until something was met in the tile: most of a large map is free.
    slots: Vec<u16>,
    surfaces: Vec<Surface>,
}

impl Tile {
    /// The surface of a cell that has one.
    fn surface(&self, cell: usize) -> &Surface {
        &self.surfaces[usize::from(self.slots[cell])]
    }

    /// See [`surface`](Self::surface).
    fn surface_mut(&mut self, cell: usize) -> &mut Surface {
        &mut self.surfaces[usize::from(self.slots[cell])]
    }

    /// The surface of a cell, which has one from now on.
    fn make_surface(&mut self, cell: usize) -> &mut Surface {
        if self.flags[cell] & HAS_SURFACE == 0 {
            self.flags[cell] |= HAS_SURFACE;
            self.slots.resize(AREA, 0);
            self.slots[cell] = self.surfaces.len() as u16;
            self.surfaces.push(Surface::default());
        }
        self.surface_mut(cell)
    }
}

/// The surface around a point of the map.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    /// A point on it (m).
    pub mean: Point2<f64>,
    /// Its normal (unit vector, either side).
    pub normal: Vector2<f64>,
    /// Variance across it and along it (m2).
    pub variance: [f64; 2],
    /// 0..1, how surely it is there.
    pub weight: f64,
}

/// What the map says of a place.
#[derive(Clone, Copy, Debug)]
pub enum Place {
    /// Never seen.
    Unknown,
    /// Free, and nothing near.
    Free,
    /// Near this surface.
    Surface(Line),
}

/// A piece of a surface that is known from elsewhere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Known {
    /// A point on it (m).
    pub at: Point2<f64>,
    /// Unit normal, to the side from which it was seen.
    pub normal: Option<Vector2<f64>>,
    /// Its length along the surface (m).
    pub length: f64,
    /// How many returns it stands for.
    pub returns: f32,
    /// Whether it was seen whenever it was looked at: not glass.
    pub is_opaque: bool,
}

/// See the module.
#[derive(Clone, Debug, Default)]
pub struct Submap {
    /// Number + 1 of each tile in `tiles`, row by row; 0 where there is none.
    table: Vec<u32>,
    /// Tile in the lower left corner, columns, rows.
    origin: [i32; 2],
    size: [i32; 2],
    tiles: Vec<Tile>,
    /// Key scans so far.
    keys: u32,
}

impl Submap {
    /// Number of key scans in it.
    pub fn keys(&self) -> u32 {
        self.keys
    }

    /// Memory that it holds (bytes).
    pub fn bytes(&self) -> usize {
        let of_tile =
            |tile: &Tile| AREA + tile.slots.len() * 2 + tile.surfaces.capacity() * size_of::<Surface>();
        self.tiles.iter().map(of_tile).sum::<usize>() + self.table.len() * 4
    }

    /// Rectangle of all that was seen: least and greatest x and y (m).
    pub fn extent(&self) -> [[f64; 2]; 2] {
        let side = f64::from(SIDE) * CELL;
        let low = self.origin.map(|tile| f64::from(tile) * side);
        let high = [0, 1].map(|i| f64::from(self.origin[i] + self.size[i]) * side);
        [low, high]
    }

    fn tile(&self, x: i32, y: i32) -> Option<&Tile> {
        let (column, row) = ((x >> 5) - self.origin[0], (y >> 5) - self.origin[1]);
        if column < 0 || row < 0 || column >= self.size[0] || row >= self.size[1] {
            return None;
        }
        let number = self.table[(row * self.size[0] + column) as usize];
        (number > 0).then(|| &self.tiles[number as usize - 1])
    }

    fn make_tile(&mut self, x: i32, y: i32) -> usize {
        let at = [x >> 5, y >> 5];
        let inside = (0..2).all(|i| (0..self.size[i]).contains(&(at[i] - self.origin[i])));
        if !inside {
            self.grow(at);
        }
        let place = ((at[1] - self.origin[1]) * self.size[0] + at[0] - self.origin[0]) as usize;
        if self.table[place] == 0 {
            self.tiles.push(Tile { flags: [0; AREA], slots: Vec::new(), surfaces: Vec::new() });
            self.table[place] = self.tiles.len() as u32;
        }
        self.table[place] as usize - 1
    }

    /// Makes room for a tile, with some to spare.
    fn grow(&mut self, at: [i32; 2]) {
        const SPARE: i32 = 4;
        let (old_origin, old_size) = (self.origin, self.size);
        let (mut low, mut high) = (self.origin, [0, 1].map(|i| self.origin[i] + self.size[i]));
        if self.table.is_empty() {
            (low, high) = (at, at);
        }
        for i in 0..2 {
            if at[i] < low[i] || self.table.is_empty() {
                low[i] = at[i] - SPARE;
            }
            if at[i] >= high[i] || self.table.is_empty() {
                high[i] = at[i] + 1 + SPARE;
            }
        }
        self.origin = low;
        self.size = [0, 1].map(|i| high[i] - low[i]);
        let mut table = vec![0; (self.size[0] * self.size[1]) as usize];
        for row in 0..old_size[1] {
            let from = (row * old_size[0]) as usize;
            let to = ((row + old_origin[1] - low[1]) * self.size[0] + old_origin[0] - low[0]) as usize;
            table[to..to + old_size[0] as usize]
                .copy_from_slice(&self.table[from..from + old_size[0] as usize]);
        }
        self.table = table;
    }

    /// Adds a key scan taken at `pose`.
    pub fn insert(&mut self, points: &Points, pose: &Pose) {
        self.keys += 1;
        for point in &points.all {
            self.hit(pose * point.at, point.normal.map(|normal| pose.rotation * normal));
        }
        // Every other beam is enough to clear cells of 10 cm: at 20 m the beams are 9 cm apart.
        for beam in points.beams.iter().step_by(2) {
            self.clear(pose * beam.from, pose * beam.to);
        }
    }

    fn hit(&mut self, at: Point2<f64>, normal: Option<Vector2<f64>>) {
        let (x, y) = (index(at.x), index(at.y));
        let key = self.keys;
        let number = self.make_tile(x, y);
        let surface = self.tiles[number].make_surface(in_tile(x, y));
        // A thin wall's other side: the cell keeps the side that it saw first, while that is believed.
        if let (Some(new), Some(old)) = (normal, surface.normal())
            && new.dot(&old) < 0.0
            && surface.existence() > 0.3
        {
            return;
        }
        surface.add([(at.x - f64::from(x) * CELL) as f32, (at.y - f64::from(y) * CELL) as f32], normal, 1.0);
        if surface.last_hit != key {
            surface.last_hit = key;
            surface.hits += 1;
            surface.evidence();
        }
    }

    /// A map of what is known from elsewhere: surfaces, points that are free, and points where something may be: what is met
    /// there speaks neither for nor against a place.
    pub fn of_known(
        surfaces: impl Iterator<Item = Known>,
        free: impl Iterator<Item = Point2<f64>>,
        doubtful: impl Iterator<Item = Point2<f64>>,
    ) -> Submap {
        let mut map = Submap { keys: 1, ..Submap::default() };
        for surface in surfaces {
            let along = surface.normal.map_or(Vector2::zeros(), |normal| Vector2::new(-normal.y, normal.x));
            // An even row of that length has the deviation of three points this far apart.
            let apart = along * (surface.length / 8.0_f64.sqrt());
            for step in [-1.0, 0.0, 1.0] {
                map.know(surface.at + apart * step, &surface);
            }
        }
        for at in free {
            let (x, y) = (index(at.x), index(at.y));
            let number = map.make_tile(x, y);
            map.tiles[number].flags[in_tile(x, y)] |= FREE;
        }
        for at in doubtful {
            let (x, y) = (index(at.x), index(at.y));
            let number = map.make_tile(x, y);
            map.tiles[number].flags[in_tile(x, y)] &= !FREE;
        }
        map
    }

    fn know(&mut self, at: Point2<f64>, known: &Known) {
        let (x, y) = (index(at.x), index(at.y));
        let number = self.make_tile(x, y);
        let tile = &mut self.tiles[number];
        let cell = in_tile(x, y);
        let is_first = tile.flags[cell] & HAS_SURFACE == 0;
        let side = tile.make_surface(cell).normal();
        let is_other_side = |normal: Vector2<f64>| side.is_some_and(|old| normal.dot(&old) < 0.0);
        if known.normal.is_some_and(is_other_side) {
            return;
        }
        // One piece that can be seen through is enough.
        if is_first && known.is_opaque {
            tile.flags[cell] |= OPAQUE;
        } else if !known.is_opaque {
            tile.flags[cell] &= !OPAQUE;
        }
        let surface = tile.surface_mut(cell);
        let at = [(at.x - f64::from(x) * CELL) as f32, (at.y - f64::from(y) * CELL) as f32];
        surface.add(at, known.normal, known.returns / 3.0);
        surface.hits = EVIDENCE / 2;
    }

    /// Whether a beam goes through a surface that was seen whenever it was looked at: then this is not where it was fired.
    pub fn contradicts(&self, from: Point2<f64>, to: Point2<f64>) -> bool {
        let way = to - from;
        let length = way.norm();
        // As far as a pose that a search has found may be off.
        let clear = length - 2.0 * CLEAR_BEFORE;
        if clear <= 0.0 {
            return false;
        }
        let direction = way / length;
        let mut walk = Walk::new(from, direction);
        while walk.distance < clear {
            let (x, y) = (walk.x, walk.y);
            walk.step();
            let Some(tile) = self.tile(x, y) else { continue };
            let cell = in_tile(x, y);
            if tile.flags[cell] & OPAQUE == 0 {
                continue;
            }
            let surface = tile.surface(cell);
            let off = surface.place(x, y) - from;
            let across = (off.x * direction.y - off.y * direction.x).abs();
            // From behind it may never have been looked at.
            let faces = surface.normal().is_some_and(|normal| normal.dot(&direction) < -2.0 * GRAZING);
            if across < THROUGH && faces && off.dot(&direction) < clear {
                return true;
            }
        }
        false
    }

    fn clear(&mut self, from: Point2<f64>, to: Point2<f64>) {
        let way = to - from;
        let length = way.norm();
        let clear = length - CLEAR_BEFORE;
        if clear <= 0.0 {
            return;
        }
        let direction = way / length;
        let key = self.keys;
        let mut walk = Walk::new(from, direction);
        let mut current = (i32::MIN, i32::MIN, 0);
        while walk.distance < clear {
            let (x, y) = (walk.x, walk.y);
            if (x >> 5, y >> 5) != (current.0, current.1) {
                current = (x >> 5, y >> 5, self.make_tile(x, y));
            }
            let tile = &mut self.tiles[current.2];
            let cell = in_tile(x, y);
            tile.flags[cell] |= FREE;
            if tile.flags[cell] & HAS_SURFACE != 0 {
                let surface = tile.surface_mut(cell);
                if surface.last_miss != key && surface.last_hit != key {
                    let off = surface.place(x, y) - from;
                    let across = (off.x * direction.y - off.y * direction.x).abs();
                    let is_met = surface.normal().is_none_or(|normal| normal.dot(&direction).abs() > GRAZING);
                    if across < THROUGH && is_met && off.dot(&direction) < clear {
                        surface.last_miss = key;
                        surface.misses += 1;
                        surface.evidence();
                    }
                }
            }
            walk.step();
        }
    }

    /// What is at a place of the map; of surfaces, only those that face the way of `normal` where it is given.
    pub fn look(&self, at: Point2<f64>, normal: Option<Vector2<f64>>) -> Place {
        let (cx, cy) = (index(at.x), index(at.y));
        let mut sum = Sum::default();
        let mut seen = false;
        let inside = (1..SIDE - 1).contains(&(cx & 31)) && (1..SIDE - 1).contains(&(cy & 31));
        let home = self.tile(cx, cy);
        if inside {
            let Some(tile) = home else { return Place::Unknown };
            for y in cy - 1..=cy + 1 {
                for x in cx - 1..=cx + 1 {
                    let cell = in_tile(x, y);
                    if tile.flags[cell] & HAS_SURFACE != 0 {
                        sum.add(tile.surface(cell), x - cx, y - cy, normal);
                    }
                }
            }
            seen = tile.flags[in_tile(cx, cy)] & FREE != 0;
        } else {
            for y in cy - 1..=cy + 1 {
                for x in cx - 1..=cx + 1 {
                    let Some(tile) = self.tile(x, y) else { continue };
                    let cell = in_tile(x, y);
                    if tile.flags[cell] & HAS_SURFACE != 0 {
                        sum.add(tile.surface(cell), x - cx, y - cy, normal);
                    }
                    if (x, y) == (cx, cy) {
                        seen = tile.flags[cell] & FREE != 0;
                    }
                }
            }
        }
        match sum.line(cx, cy) {
            Some(line) => Place::Surface(line),
            None if seen => Place::Free,
            None => Place::Unknown,
        }
    }

    /// How surely something is in the cell that holds the point: 0..1.
    pub fn existence(&self, at: Point2<f64>) -> f64 {
        let (x, y) = (index(at.x), index(at.y));
        let Some(tile) = self.tile(x, y) else { return 0.0 };
        let cell = in_tile(x, y);
        if tile.flags[cell] & HAS_SURFACE == 0 { 0.0 } else { f64::from(tile.surface(cell).existence()) }
    }

    /// Cells that surely hold something.
    pub fn occupied(&self) -> impl Iterator<Item = (i32, i32)> {
        (0..self.table.len()).filter(|&place| self.table[place] > 0).flat_map(move |place| {
            let tile = &self.tiles[self.table[place] as usize - 1];
            let column = place as i32 % self.size[0] + self.origin[0];
            let row = place as i32 / self.size[0] + self.origin[1];
            (0..AREA)
                .filter(move |&cell| {
                    tile.flags[cell] & HAS_SURFACE != 0 && tile.surface(cell).existence() > 0.4
                })
                .map(move |cell| (column * SIDE + cell as i32 % SIDE, row * SIDE + cell as i32 / SIDE))
        })
    }
}

/// Surfaces of neighbouring cells put together.
#[derive(Default)]
struct Sum {
    weight: f64,
    existence: f64,
    mean: Vector2<f64>,
    squares: [f64; 3],
}

impl Sum {
    fn add(&mut self, surface: &Surface, column: i32, row: i32, facing: Option<Vector2<f64>>) {
        let existence = f64::from(surface.existence());
        if existence < 0.15 {
            return;
        }
        // Of the same side within 53 degrees: what is left of two walls that meet in a corner is one of them.
        if let (Some(facing), Some(normal)) = (facing, surface.normal())
            && facing.dot(&normal) < 0.6
        {
            return;
        }
        let weight = existence * f64::from(surface.count.min(10.0));
        let mean = Vector2::new(
            f64::from(column) * CELL + f64::from(surface.mean[0]),
            f64::from(row) * CELL + f64::from(surface.mean[1]),
        );
        self.weight += weight;
        self.existence = self.existence.max(existence);
        self.mean += mean * weight;
        let [xx, xy, yy] = surface.spread.map(f64::from);
        self.squares[0] += weight * (xx + mean.x * mean.x);
        self.squares[1] += weight * (xy + mean.x * mean.y);
        self.squares[2] += weight * (yy + mean.y * mean.y);
    }

    fn line(&self, cx: i32, cy: i32) -> Option<Line> {
        if self.weight <= 0.0 {
            return None;
        }
        let mean = self.mean / self.weight;
        let spread = Spread {
            xx: self.squares[0] / self.weight - mean.x * mean.x,
            xy: self.squares[1] / self.weight - mean.x * mean.y,
            yy: self.squares[2] / self.weight - mean.y * mean.y,
        };
        let (normal, least, most) = spread.axes();
        let corner = Vector2::new(f64::from(cx) * CELL, f64::from(cy) * CELL);
        // Fewer than three returns make no line.
        let weight = self.existence * (self.weight / self.existence / 3.0).min(1.0);
        Some(Line { mean: (corner + mean).into(), normal, variance: [least, most], weight })
    }
}

/// Walks the cells along a ray (Amanatides and Woo 1987).
struct Walk {
    x: i32,
    y: i32,
    /// Way to the border by which the present cell was entered (m).
    distance: f64,
    next: [f64; 2],
    step: [f64; 2],
    sign: [i32; 2],
}

impl Walk {
    fn new(from: Point2<f64>, direction: Vector2<f64>) -> Walk {
        let cell = [index(from.x), index(from.y)];
        let mut walk = Walk {
            x: cell[0],
            y: cell[1],
            distance: 0.0,
            next: [f64::INFINITY; 2],
            step: [f64::INFINITY; 2],
            sign: [1; 2],
        };
        for i in 0..2 {
            let (d, at) = (direction[i], from[i]);
            if d.abs() < 1e-12 {
                continue;
            }
            walk.sign[i] = if d > 0.0 { 1 } else { -1 };
            let border = f64::from(cell[i] + i32::from(d > 0.0)) * CELL;
            walk.next[i] = (border - at) / d;
            walk.step[i] = CELL / d.abs();
        }
        walk
    }

    fn step(&mut self) {
        let i = usize::from(self.next[1] < self.next[0]);
        self.distance = self.next[i];
        self.next[i] += self.step[i];
        if i == 0 { self.x += self.sign[0] } else { self.y += self.sign[1] }
    }
}

/// Farthest column or row: a match that goes astray looks there, and at the neighbours.
const FARTHEST: f64 = 1e9;

/// Column or row of the cell that holds a coordinate.
pub fn index(at: f64) -> i32 {
    (at / CELL).floor().clamp(-FARTHEST, FARTHEST) as i32
}

fn in_tile(x: i32, y: i32) -> usize {
    ((y & 31) * SIDE + (x & 31)) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_known_far_beyond_the_map() {
        let map = Submap::default();
        for far in [f64::MAX, f64::MIN, f64::INFINITY, f64::NAN] {
            let (far, near) = (Point2::new(far, -far), Point2::origin());
            assert!(matches!(map.look(far, None), Place::Unknown));
            assert_eq!(map.existence(far), 0.0);
            assert!(!map.contradicts(far, near));
        }
    }
}
