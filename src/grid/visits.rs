//! Hits over visits, on keyframes: the grid of Karto as slam_toolbox uses it, for comparison. With [`Visits::with_glints`]
//! also the usual way to have glass in such a grid: what is too bright to be diffuse is marked for good.
//!
//! Sources: open_karto, `OccupancyGrid` (RayTrace, UpdateCell); slam_toolbox, mapper_params_online_async.yaml (minimum travel of
//! 0.5 m and 0.5 rad). Not the scan matcher: poses come from outside.

use super::{
    ray::{returns, walk},
    sweep::Sweep,
    tiles::{CellIndex, SIDE, Tiles},
};
use crate::pose::Pose;

/// A scan counts when the sensor has gone this far since the last one that did (m).
const TRAVEL: f64 = 0.5;
/// Or has turned this far (rad).
const TURN: f64 = 0.5;
/// A cell is known from this many beams on.
const MIN_VISITS: u16 = 2;
/// It is occupied where more than this share of them ended in it.
const OCCUPIED_FROM: f32 = 0.1;

/// Intensity that a UTM-30LX gives for a white wall, met squarely at 1 m, and how it falls with range: power 0.1935 of the
/// brightness, which itself falls with the square of the range (fitted to a real scanner, as the simulator has it).
const WHITE_AT_1_M: f32 = 3903.0;
/// See [`WHITE_AT_1_M`].
const RANGE_POWER: f32 = -2.0 * 0.1935;
/// A return brighter than a white wall's by this factor is a glint. 1.5 in intensity is 8 in brightness; at the normal
/// glass comes to 3.3, polished metal to 1.4.
const GLINT: f32 = 1.5;

const CELLS: usize = (SIDE * SIDE) as usize;

/// One tile.
#[derive(Clone, Debug)]
struct Tile {
    /// Beams that ended in each cell, and beams that crossed it or ended there.
    hits: Box<[u16; CELLS]>,
    visits: Box<[u16; CELLS]>,
    /// A bit for each cell with a glint, a word a row.
    glints: [u64; SIDE as usize],
}

impl Default for Tile {
    fn default() -> Self {
        Tile { hits: Box::new([0; CELLS]), visits: Box::new([0; CELLS]), glints: [0; SIDE as usize] }
    }
}

/// The grid.
#[derive(Debug)]
pub struct Visits {
    resolution: f64,
    range_max: f64,
    marks_glints: bool,
    keyframe: Option<Pose>,
    tiles: Tiles<Tile>,
}

impl Visits {
    /// An empty grid of this resolution (m) that uses returns up to `range_max` (m).
    pub fn new(resolution: f64, range_max: f64) -> Visits {
        Visits { resolution, range_max, marks_glints: false, keyframe: None, tiles: Tiles::default() }
    }

    /// The same; glints are marked in every scan, keyframe or not.
    pub fn with_glints(resolution: f64, range_max: f64) -> Visits {
        Visits { marks_glints: true, ..Visits::new(resolution, range_max) }
    }

    /// Takes in one scan.
    pub fn insert(&mut self, sweep: &Sweep) {
        if self.marks_glints {
            self.mark_glints(sweep);
        }
        if !self.is_due(&sweep.start) {
            return;
        }
        self.keyframe = Some(sweep.start);
        for (_, start, end) in returns(sweep, self.resolution, self.range_max) {
            walk(start, end, |cell| self.count(cell, 0));
            self.count(end, 1);
        }
    }

    fn is_due(&self, at: &Pose) -> bool {
        self.keyframe.is_none_or(|last| {
            (at.translation.vector - last.translation.vector).norm() >= TRAVEL
                || last.rotation.angle_to(&at.rotation).abs() >= TURN
        })
    }

    fn mark_glints(&mut self, sweep: &Sweep) {
        let Sweep { scan, .. } = sweep;
        for (beam, _, end) in returns(sweep, self.resolution, self.range_max) {
            let brightest_diffuse = WHITE_AT_1_M * scan.ranges[beam].powf(RANGE_POWER);
            if scan.intensities.get(beam).is_some_and(|&value| value > GLINT * brightest_diffuse) {
                let (place, column, row) = end.split();
                let number = self.tiles.find_or_make(place);
                self.tiles.at_mut(number).glints[row] |= 1 << column;
            }
        }
    }

    fn count(&mut self, cell: CellIndex, hits: u16) {
        let (place, column, row) = cell.split();
        let number = self.tiles.find_or_make(place);
        let tile = self.tiles.at_mut(number);
        let at = row * SIDE as usize + column;
        // Where a count is full both stop, so that their ratio stays.
        if tile.visits[at] < u16::MAX {
            tile.visits[at] += 1;
            tile.hits[at] += hits;
        }
    }

    /// Side of a cell (m).
    pub(super) fn resolution(&self) -> f64 {
        self.resolution
    }

    /// Memory that the grid holds (bytes).
    pub fn bytes(&self) -> usize {
        self.tiles.len() * (size_of::<Tile>() + 2 * CELLS * size_of::<u16>())
    }

    /// All cells that are known, whether each is occupied, and its share of hits.
    pub(super) fn cells(&self) -> impl Iterator<Item = (CellIndex, bool, f32)> {
        self.tiles.iter().flat_map(|(place, tile)| {
            (0..CELLS).filter_map(move |i| {
                let (row, column) = (i / SIDE as usize, i % SIDE as usize);
                let glint = tile.glints[row] >> column & 1 == 1;
                let known = tile.visits[i] >= MIN_VISITS;
                let ratio = f32::from(tile.hits[i]) / f32::from(tile.visits[i].max(1));
                (known || glint)
                    .then(|| (place.cell(column, row), glint || known && ratio > OCCUPIED_FROM, ratio))
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{grid::sweep::tests::half_circle, pose::pose};

    fn cells(grid: &Visits) -> Vec<(i32, bool)> {
        let mut cells: Vec<_> = grid.cells().map(|(cell, occupied, _)| (cell.x, occupied)).collect();
        cells.sort_unstable();
        cells
    }

    fn look(grid: &mut Visits, x: f64, range: f32, intensity: f32) {
        let mut scan = half_circle(0, vec![f32::NAN, range, f32::NAN]);
        scan.intensities = vec![0.0, intensity, 0.0];
        let at = pose(x, 0.25, 0.0);
        grid.insert(&Sweep { scan: &scan, start: at, end: at });
    }

    #[test]
    fn a_scan_counts_only_when_the_sensor_has_moved() {
        let mut grid = Visits::new(0.5, 30.0);
        look(&mut grid, 0.25, 2.0, 0.0);
        look(&mut grid, 0.45, 1.8, 0.0);
        assert_eq!(cells(&grid), [], "one visit is not enough, and the second scan is no keyframe");
        look(&mut grid, 0.75, 1.5, 0.0);
        assert_eq!(cells(&grid), [(1, false), (2, false), (3, false), (4, true)]);
    }

    #[test]
    fn one_hit_in_ten_visits_is_too_few() {
        let mut grid = Visits::new(0.5, 30.0);
        look(&mut grid, 0.25, 2.0, 0.0);
        for step in 1..9 {
            look(&mut grid, 0.25 - 0.5 * f64::from(step), 8.0, 0.0);
        }
        assert!(cells(&grid).contains(&(4, true)), "1 of 9");
        look(&mut grid, -4.25, 8.0, 0.0);
        assert!(cells(&grid).contains(&(4, false)), "1 of 10");
    }

    #[test]
    fn a_glint_stays_whatever_is_seen_behind_it() {
        // A white wall at 2 m gives 2985; a glint is brighter than 4477.
        for (intensity, stays) in [(4400.0, false), (4500.0, true)] {
            let mut grid = Visits::with_glints(0.5, 30.0);
            look(&mut grid, 0.25, 2.0, intensity);
            for step in 1..20 {
                look(&mut grid, 0.25 - 0.5 * f64::from(step), 29.0, 0.0);
            }
            assert_eq!(cells(&grid).contains(&(4, true)), stays);
        }
    }
}
