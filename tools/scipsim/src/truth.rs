//! What a map should look like: for each cell what the returns in it truly came from. Says nothing about a map;
//! that is [`mod@crate::score`].

use std::collections::BTreeMap;

use crate::geometry::{Shape, Vector, heading};
use crate::light::{Route, Source};
use crate::scene::Scene;
use crate::simulation::{DMIN, FRONT_STEP, STEP_ANGLE, SimScan, Simulation};
use crate::world::Kind;

/// Side of a cell (m).
pub const RESOLUTION: f64 = 0.05;
/// Cells around the world that readings may fall in (m): the reach of the scanner.
const MARGIN: f64 = 31.0;
/// A surface's cell counts if its 3 x 3 neighbourhood got this many returns.
const ENOUGH_RETURNS: u32 = 3;
/// What is no surface must be farther than this many cells from any.
pub const CLEAR_OF_SURFACES: u8 = 2;

/// What a cell truly is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Label {
    /// None of the following.
    Other,
    /// A specular surface that stands there and was seen (glass, mirror, metal).
    Glass,
    /// A diffuse surface that stands there and was seen.
    Diffuse,
    /// Away from surfaces, and most returns in it came from what moves.
    Motion,
    /// Away from surfaces, and most returns in it were images.
    Reflection,
    /// Away from surfaces, and most returns in it came from what no longer stands there.
    Removed,
}

/// The truth of a drive up to some moment. Cells lie row by row from the bottom, `width` in a row.
#[derive(Clone, Debug)]
pub struct TruthMap {
    /// Side of a cell (m).
    pub resolution: f64,
    /// Lower left corner (m), a whole number of cells from the world's origin.
    pub origin: [f64; 2],
    /// Cells in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// What each cell is.
    pub labels: Vec<Label>,
    /// Distance to the nearest surface that stands there, seen or not (cells, the larger of dx and dy, at most 255).
    pub clearance: Vec<u8>,
    /// Whether the robot's body has covered the cell.
    pub path: Vec<bool>,
}

impl TruthMap {
    /// Number of the cell that a point lies in.
    pub fn cell(&self, x: f64, y: f64) -> Option<usize> {
        let column = ((x - self.origin[0]) / self.resolution).floor();
        let row = ((y - self.origin[1]) / self.resolution).floor();
        let inside = column >= 0.0 && row >= 0.0 && column < self.width as f64 && row < self.height as f64;
        inside.then(|| row as usize * self.width + column as usize)
    }

    /// Smallest rectangle of cells that holds all labels and the path: first column, first row, width, height.
    pub fn extent(&self) -> [usize; 4] {
        let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
        for (i, label) in self.labels.iter().enumerate() {
            if *label != Label::Other || self.path[i] {
                for (axis, v) in [i % self.width, i / self.width].into_iter().enumerate() {
                    low[axis] = low[axis].min(v);
                    high[axis] = high[axis].max(v);
                }
            }
        }
        if low[0] == usize::MAX {
            return [0; 4];
        }
        [low[0], low[1], high[0] - low[0] + 1, high[1] - low[1] + 1]
    }
}

/// Counts what falls where while scans are taken.
#[derive(Clone, Debug)]
pub struct TruthRecorder {
    grid: TruthMap,
    specular: Vec<u16>,
    diffuse: Vec<u16>,
    motion: Vec<u16>,
    reflection: Vec<u16>,
    /// Returns of what comes, goes or slides, by cell and placement: what they count for depends on the moment.
    changing: BTreeMap<(usize, u16), u32>,
}

impl TruthRecorder {
    /// Nothing seen yet.
    pub fn new(scene: &Scene) -> TruthRecorder {
        let (low, high) = scene.bounds();
        let first = (low - Vector::repeat(MARGIN)).map(|v| (v / RESOLUTION).floor());
        let size = ((high + Vector::repeat(MARGIN)) / RESOLUTION - first).map(|v| v.ceil() as usize);
        let cells = size.x * size.y;
        TruthRecorder {
            grid: TruthMap {
                resolution: RESOLUTION,
                origin: [first.x * RESOLUTION, first.y * RESOLUTION],
                width: size.x,
                height: size.y,
                labels: Vec::new(),
                clearance: Vec::new(),
                path: vec![false; cells],
            },
            specular: vec![0; cells],
            diffuse: vec![0; cells],
            motion: vec![0; cells],
            reflection: vec![0; cells],
            changing: BTreeMap::new(),
        }
    }

    /// Counts a scan of this simulation.
    pub fn note(&mut self, simulation: &Simulation, scan: &SimScan) {
        let scene = simulation.scene();
        let start = scan.t_ns as f64 * 1e-9;
        self.drive_over(scene.drive().pose(start).translation.vector, scene.body_radius());
        for (step, (&distance, truth)) in scan.distances_mm.iter().zip(&scan.truth).enumerate() {
            if distance < DMIN {
                continue;
            }
            let laser = scene.drive().pose(start + simulation.time_increment() * step as f64) * scene.mount();
            let bearing = (step as f64 - FRONT_STEP as f64) * STEP_ANGLE;
            let at = laser.translation.vector
                + heading(laser.rotation.angle() + bearing) * (f64::from(distance) * 1e-3);
            let Some(cell) = self.grid.cell(at.x, at.y) else { continue };
            let counter = match (truth.source, truth.route) {
                (Source::Nothing | Source::Random, _) => continue,
                (_, Route::Reflected) | (Source::Body, _) => &mut self.reflection,
                (Source::Person(_), _) => &mut self.motion,
                (Source::Placement(number), _) => {
                    let placement = &scene.placements()[usize::from(number)];
                    if placement.from.is_finite() || placement.to.is_finite() {
                        *self.changing.entry((cell, number)).or_default() += 1;
                        continue;
                    }
                    if truth.kind.is_specular() { &mut self.specular } else { &mut self.diffuse }
                }
            };
            counter[cell] = counter[cell].saturating_add(1);
        }
    }

    fn drive_over(&mut self, at: Vector, radius: f64) {
        let reach = (radius / RESOLUTION).ceil() as i64;
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let offset = Vector::new(dx as f64, dy as f64) * RESOLUTION;
                if offset.norm() <= radius
                    && let Some(cell) = self.grid.cell(at.x + offset.x, at.y + offset.y)
                {
                    self.grid.path[cell] = true;
                }
            }
        }
    }

    /// The truth as of `time` (s): what stands then is a surface, what stood before is removed.
    pub fn map(&self, scene: &Scene, time: f64) -> TruthMap {
        let mut map = self.grid.clone();
        let (mut specular, mut diffuse, mut motion) =
            (self.specular.clone(), self.diffuse.clone(), self.motion.clone());
        let mut removed = vec![0u16; self.motion.len()];
        for (&(cell, number), &count) in &self.changing {
            let placement = &scene.placements()[usize::from(number)];
            let counter = if placement.velocity.is_some() {
                &mut motion
            } else if !placement.holds(time) {
                &mut removed
            } else if scene.skin(placement.surface).material.kind.is_specular() {
                &mut specular
            } else {
                &mut diffuse
            };
            counter[cell] = counter[cell].saturating_add(count.min(u32::from(u16::MAX)) as u16);
        }
        let cells = map.width * map.height;
        map.labels = vec![Label::Other; cells];
        map.clearance = vec![u8::MAX; cells];
        for (surface, shape) in scene.standing(time) {
            let kind = scene.skin(surface).material.kind;
            for cell in rasterised(&map, shape) {
                map.clearance[cell] = 0;
                let (counts, label) = match kind {
                    Kind::Diffuse => (&diffuse, Label::Diffuse),
                    _ => (&specular, Label::Glass),
                };
                // Where a post stands on a pane, the cell is the post's.
                if map.labels[cell] != Label::Diffuse && around(counts, map.width, cell) >= ENOUGH_RETURNS {
                    map.labels[cell] = label;
                }
            }
        }
        spread(&mut map.clearance, map.width);
        for cell in 0..cells {
            if map.clearance[cell] <= CLEAR_OF_SURFACES {
                continue;
            }
            let candidates = [
                (self.reflection[cell], Label::Reflection),
                (motion[cell], Label::Motion),
                (removed[cell], Label::Removed),
            ];
            // The first of the largest.
            let most = candidates.into_iter().rev().max_by_key(|c| c.0);
            if let Some((count, label)) = most
                && count > 0
            {
                map.labels[cell] = label;
            }
        }
        map
    }
}

/// Sum over the 3 x 3 neighbourhood; the margin keeps surfaces off the border.
fn around(counts: &[u16], width: usize, cell: usize) -> u32 {
    let rows = [cell - width, cell, cell + width];
    rows.iter().flat_map(|&row| &counts[row - 1..=row + 1]).map(|&count| u32::from(count)).sum()
}

/// Cells along a shape, one a column or row (whichever there are more of): a line one cell thick.
fn rasterised(map: &TruthMap, shape: &Shape) -> Vec<usize> {
    let steps = (shape.length() / (RESOLUTION / 10.0)).ceil().max(1.0);
    let mut cells: Vec<usize> = Vec::new();
    for k in 0..=steps as usize {
        let p = shape.point(shape.length() * k as f64 / steps);
        let Some(cell) = map.cell(p.x, p.y) else { continue };
        if cells.last() == Some(&cell) {
            continue;
        }
        // Leave out the corner of an L, so that the line stays thin.
        if let [.., before, corner] = cells[..] {
            let apart = |axis: usize| {
                let place = |c: usize| if axis == 0 { c % map.width } else { c / map.width };
                place(before).abs_diff(place(cell))
            };
            let is_corner = apart(0) == 1 && apart(1) == 1 && corner != cell;
            if is_corner {
                cells.pop();
            }
        }
        cells.push(cell);
    }
    cells
}

/// Turns 0 and 255 into the chessboard distance to the nearest 0 (two passes).
fn spread(distance: &mut [u8], width: usize) {
    let height = distance.len() / width;
    let mut pass = |cells: &mut dyn Iterator<Item = usize>, back: [[isize; 2]; 4]| {
        for cell in cells {
            let (x, y) = ((cell % width) as isize, (cell / width) as isize);
            for [dx, dy] in back {
                let (nx, ny) = (x + dx, y + dy);
                if nx >= 0 && ny >= 0 && nx < width as isize && ny < height as isize {
                    let near = distance[ny as usize * width + nx as usize];
                    distance[cell] = distance[cell].min(near.saturating_add(1));
                }
            }
        }
    };
    let cells = width * height;
    pass(&mut (0..cells), [[-1, 0], [-1, -1], [0, -1], [1, -1]]);
    pass(&mut (0..cells).rev(), [[1, 0], [1, 1], [0, 1], [-1, 1]]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::SimulationOptions;
    use crate::world::World;

    #[test]
    fn distances_spread_from_surfaces() {
        let mut d = vec![255; 35];
        d[7 + 1] = 0;
        spread(&mut d, 7);
        assert_eq!(d[..7], [1, 1, 1, 2, 3, 4, 5]);
        assert_eq!(d[28..], [3, 3, 3, 3, 3, 4, 5]);
    }

    #[test]
    fn labels_follow_the_moment() {
        // A parked robot; a box stands 2 m ahead for the first two seconds, a wall behind it always.
        let text = "name='t'\ndescription='t'\n\
            [[surface]]\nmaterial='wall'\nline=[[4,-3],[4,3]]\n\
            [[surface]]\nmaterial='wood'\nrectangle={center=[2,0],size=[0.3,0.6]}\npresent=[[-1,2]]\n\
            [[person]]\npath=[[1.5,-3],[1.5,3]]\n\
            [robot]\npath=[[0,0]]\nstops=[[0,5.0]]\n";
        let world = World::from_toml("t", text).unwrap();
        let mut simulation = Simulation::new(&world, SimulationOptions::default());
        let at = |map: &TruthMap, x: f64, y: f64| map.labels[map.cell(x, y).unwrap()];
        simulation.by_ref().take(60).count();
        let early = simulation.truth();
        assert_eq!(at(&early, 1.86, 0.0), Label::Diffuse);
        simulation.by_ref().count();
        let late = simulation.truth();
        let count = |map: &TruthMap, label| map.labels.iter().filter(|&&l| l == label).count();
        assert_eq!(count(&early, Label::Removed), 0);
        assert!(count(&late, Label::Removed) >= 8);
        assert_eq!(at(&late, 4.0, 0.0), Label::Diffuse);
        assert!(count(&late, Label::Motion) > 50);
        assert_eq!(count(&late, Label::Reflection), 0);
        assert!(late.path[late.cell(0.1, 0.1).unwrap()] && !late.path[late.cell(1.0, 0.0).unwrap()]);
        assert_eq!(late.clearance[late.cell(3.92, 0.02).unwrap()], 2);
    }
}
