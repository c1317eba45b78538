//! A VisAGGE grid as it is kept in a file: all evidence, bit for bit, and nothing that follows from it.
//!
//! What goes on from scan to scan is not kept: it ends with the pause.
//!
//! Not the file, which is in [`saved`](crate::saved), and not a copy of the grid's layout: the structs here change with the
//! file's version only. Verdicts, lines and what else is judged from the evidence is judged anew.

use super::{
    angle::{Angle, AngleRange},
    cell::Returns,
    tiles::{SIDE, TileIndex},
    track::{Sector, Track},
    visagge::{Visagge, VisaggeSettings},
};
use serde::{Deserialize, Serialize};

/// Time between the last scan before a grid was saved and the first one after it was loaded (ns): every cell's turn to be looked at.
/// However long it was, nothing was seen meanwhile, and nobody stood anywhere for longer because of it.
pub const PAUSE_NS: i64 = 100_000_000;
/// Tiles in the smallest rectangle around all, at most: 2.6 km2 at 5 cm. More is no map but a damaged file.
const MOST_TILES: i64 = 1 << 18;

/// Scans and time (ns) that no scanner lives to see, so that sums of them are still numbers.
const MOST_SCANS: u32 = u32::MAX / 2;
/// See [`MOST_SCANS`].
const MOST_NS: i64 = i64::MAX / 4;
/// The greatest cap of a cell's occupancy that can be set.
const MOST_OCCUPANCY: u8 = 200;

/// What a [`Visagge`] grid knows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SavedGrid {
    /// Side of a cell (m).
    pub resolution: f64,
    /// Whether it works as the paper has it.
    pub as_in_the_paper: bool,
    /// Whether cells keep a second range.
    pub two_ranges: bool,
    /// Number of the last scan.
    pub scan: u32,
    /// Way that the sensor has driven (m).
    pub way: f32,
    /// Time from the first scan to the last (ns).
    pub elapsed_ns: i64,
    /// The sensor in the middle of the last scan (m).
    pub middle: Option<[f64; 2]>,
    /// In the order in which they were made.
    pub tiles: Vec<SavedTile>,
}

/// A square of cells.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SavedTile {
    /// Column and row of tiles.
    pub place: [i32; 2],
    /// A bit for each cell that was crossed, a word a row; 64 of them.
    pub free: Vec<u64>,
    /// The same for each cell that the robot itself was in; none where it was in none of them.
    pub driven: Vec<u64>,
    /// The cells with evidence, in their order; `None` where no return ever landed.
    pub cells: Option<Vec<SavedCell>>,
}

/// See [`Returns`] and [`Track`]; fields have their names.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "they are theirs")]
pub struct SavedCell {
    pub place: [u8; 2],
    pub occupancy: u8,
    pub passes: u8,
    pub glints: u8,
    pub hits: u16,
    pub was_crossed: bool,
    pub was_passed: bool,
    pub was_driven: bool,
    pub brightness: i16,
    pub hit_scan: u32,
    pub visible: SavedSector,
    pub visible_too: Option<SavedSector>,
    pub missed_width: u16,
    /// Clockwise end and width (units of [`Angle`]).
    pub missed_since: [u16; 2],
    pub centroid: [f32; 2],
    pub hit_time: [f32; 2],
}

/// See [`Sector`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SavedSector {
    /// Clockwise end and width (units of [`Angle`]).
    pub range: [u16; 2],
    /// Distance of the sensor at either end (512 a metre).
    pub ends: [u16; 2],
    /// Way driven at the last observation (m).
    pub way: f32,
}

/// What makes a saved grid none.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("tile {tile}: {what}")]
pub struct BadGrid {
    /// Number of the tile; that of all tiles where it is not one alone.
    pub tile: usize,
    /// What is wrong.
    pub what: &'static str,
}

fn range([start, width]: [u16; 2]) -> AngleRange {
    AngleRange { start: Angle(start), width }
}

impl SavedSector {
    fn of(sector: &Sector, way: f32) -> Self {
        Self { range: [sector.range.start.0, sector.range.width], ends: sector.ends, way }
    }

    fn sector(self) -> Sector {
        Sector { range: range(self.range), ends: self.ends }
    }

    fn is_sound(&self) -> bool {
        self.way.is_finite() && self.sector().exists()
    }
}

impl SavedCell {
    fn of((cell, track): (&Returns, Track)) -> Self {
        let too = track.visible_too;
        Self {
            place: cell.place,
            occupancy: cell.occupancy,
            passes: cell.passes,
            glints: cell.glints,
            hits: cell.hits,
            was_crossed: cell.was_crossed,
            was_passed: cell.was_passed,
            was_driven: cell.was_driven,
            brightness: cell.brightness,
            hit_scan: cell.hit_scan,
            visible: SavedSector::of(&track.visible, track.way),
            visible_too: too.exists().then(|| SavedSector::of(&too, track.way_too)),
            missed_width: track.missed_width,
            missed_since: [track.missed_since.start.0, track.missed_since.width],
            centroid: cell.centroid,
            hit_time: cell.hit_time,
        }
    }

    fn cell(&self) -> (Returns, Track) {
        let mut cell = Returns::new(self.place, self.was_crossed);
        cell.was_passed = self.was_passed;
        cell.was_driven = self.was_driven;
        cell.brightness = self.brightness;
        cell.occupancy = self.occupancy;
        cell.passes = self.passes;
        cell.glints = self.glints;
        cell.hits = self.hits;
        cell.hit_scan = self.hit_scan;
        cell.centroid = self.centroid;
        cell.hit_time = self.hit_time;
        let track = Track {
            visible: self.visible.sector(),
            way: self.visible.way,
            visible_too: self.visible_too.map(SavedSector::sector).unwrap_or_default(),
            way_too: self.visible_too.map_or(0.0, |too| too.way),
            missed_width: self.missed_width,
            missed_since: range(self.missed_since),
            ..Track::default()
        };
        (cell, track)
    }

    fn is_sound(&self) -> bool {
        let inside = self.place.iter().all(|&at| i32::from(at) < SIDE) && self.occupancy <= MOST_OCCUPANCY;
        let numbers = self.centroid.iter().chain(&self.hit_time).all(|number| number.is_finite());
        let sectors = [Some(self.visible), self.visible_too];
        inside && numbers && sectors.iter().flatten().all(SavedSector::is_sound)
    }
}

impl SavedGrid {
    /// Whether a grid can be made of it.
    ///
    /// # Errors
    /// Where numbers are none, or places are out of range or taken twice.
    pub fn check(&self) -> Result<(), BadGrid> {
        let bad = |tile, what| Err(BadGrid { tile, what });
        let all = self.tiles.len();
        let middle = self.middle.unwrap_or_default();
        let is_number = middle.iter().all(|at| at.is_finite()) && self.way.is_finite();
        if !(is_number && self.resolution > 0.0 && self.resolution.is_finite()) {
            return bad(all, "a number is none");
        }
        if self.scan > MOST_SCANS || !(0..=MOST_NS).contains(&self.elapsed_ns) {
            return bad(all, "more scans or time than can be");
        }
        let range = |axis: usize| {
            let places = self.tiles.iter().map(|tile| i64::from(tile.place[axis]));
            places.clone().max().unwrap_or(0) - places.min().unwrap_or(0) + 1
        };
        let is_far = |tile: &SavedTile| tile.place.iter().any(|at| i64::from(*at).abs() > MOST_TILES);
        if range(0).saturating_mul(range(1)) > MOST_TILES || self.tiles.iter().any(is_far) {
            return bad(all, "they reach too far");
        }
        let mut places = std::collections::HashSet::new();
        for (number, tile) in self.tiles.iter().enumerate() {
            if !places.insert(tile.place) {
                return bad(number, "its place is taken");
            }
            if tile.free.len() != SIDE as usize {
                return bad(number, "its rows are not 64");
            }
            if ![0, SIDE as usize].contains(&tile.driven.len()) {
                return bad(number, "its rows are neither 64 nor none");
            }
            let mut taken = [0u64; SIDE as usize];
            for cell in tile.cells.iter().flatten() {
                if !cell.is_sound() {
                    return bad(number, "a cell's place or a number is none");
                }
                let [column, row] = cell.place.map(usize::from);
                if taken[row] >> column & 1 == 1 {
                    return bad(number, "a cell is there twice");
                }
                taken[row] |= 1 << column;
            }
        }
        Ok(())
    }
}

impl Visagge {
    /// All that is known, for a file.
    pub fn save(&self) -> SavedGrid {
        let tiles = self.tiles.iter().map(|(place, tile)| SavedTile {
            place: [place.x, place.y],
            free: tile.free.to_vec(),
            driven: tile.driven.iter().flat_map(|driven| driven.iter().copied()).collect(),
            cells: tile.evidence.as_ref().map(|evidence| evidence.cells.kept().map(SavedCell::of).collect()),
        });
        SavedGrid {
            resolution: self.resolution,
            as_in_the_paper: self.as_in_the_paper,
            two_ranges: self.settings.two_ranges,
            scan: self.scan,
            way: self.way,
            elapsed_ns: self.elapsed_ns,
            middle: self.middle,
            tiles: tiles.collect(),
        }
    }

    /// The grid that was saved. The next scan follows a gap: whatever its number, all runs have ended, and its time is
    /// [`PAUSE_NS`] after the last one's.
    ///
    /// # Errors
    /// See [`SavedGrid::check`].
    pub fn load(saved: &SavedGrid, settings: VisaggeSettings) -> Result<Visagge, BadGrid> {
        saved.check()?;
        let mut grid = if saved.as_in_the_paper {
            Visagge::as_in_the_paper(saved.resolution, settings)
        } else {
            Visagge::new(saved.resolution, settings)
        };
        // One more than for the scan that follows.
        grid.scan = saved.scan.saturating_add(1);
        grid.way = saved.way;
        grid.elapsed_ns = saved.elapsed_ns;
        grid.middle = saved.middle;
        for saved in &saved.tiles {
            let [x, y] = saved.place;
            let number = grid.tiles.find_or_make(TileIndex { x, y });
            let tile = grid.tiles.at_mut(number);
            tile.free.copy_from_slice(&saved.free);
            tile.driven = <[u64; SIDE as usize]>::try_from(&saved.driven[..]).ok().map(Box::new);
            if let Some(cells) = &saved.cells {
                tile.evidence.insert(Default::default()).fill(cells.iter().map(SavedCell::cell));
            }
        }
        Ok(grid)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        grid::sweep::{
            Sweep,
            tests::{half_circle, single},
        },
        pose::pose,
        scan::Scan,
    };
    use proptest::prelude::*;

    /// A drive along a wall and back, with a pane on the other side that is seen near its normal only; the numbers of the
    /// scans have a gap at `gap`.
    fn drive(gap: usize) -> Vec<(Scan, [f64; 3])> {
        (0..60)
            .map(|number| {
                let angle = 0.005 * number.min(60 - number) as f64;
                let ranges = (0..181)
                    .map(|beam| {
                        let bearing = (beam as f64 - 90.0).to_radians() + angle;
                        let wall = 2.0 / bearing.sin().abs().max(0.05);
                        let shows = bearing.sin() > 0.0 || bearing.cos().abs() < 0.3;
                        if shows { wall.min(9.0) as f32 } else { 9.0 }
                    })
                    .collect();
                let mut scan = half_circle((number + usize::from(number >= gap)) as u64, ranges);
                scan.stamp_ns = number as i64 * PAUSE_NS;
                (scan, [0.1 * number.min(60 - number) as f64, 0.0, angle])
            })
            .collect()
    }

    fn insert(grid: &mut Visagge, scan: &Scan, [x, y, yaw]: [f64; 3]) {
        let at = pose(x, y, yaw);
        grid.insert(&Sweep { scan, start: at, end: at });
    }

    #[test]
    fn who_saves_and_loads_ends_in_the_map_of_who_never_stopped() {
        for gap in [1, 17, 30, 59] {
            let drive = drive(gap);
            let mut going_on = Visagge::new(0.05, VisaggeSettings::default());
            drive.iter().for_each(|(scan, at)| insert(&mut going_on, scan, *at));

            let mut before = Visagge::new(0.05, VisaggeSettings::default());
            drive[..gap].iter().for_each(|(scan, at)| insert(&mut before, scan, *at));
            // To have it judged must not matter.
            before.map();
            let mut after = Visagge::load(&before.save(), VisaggeSettings::default()).unwrap();
            for (number, (scan, at)) in drive[gap..].iter().enumerate() {
                // After a restart both numbers and times are others.
                let seq = number as u64 + 5;
                let stamp_ns = scan.stamp_ns - 1_000_000_007;
                insert(&mut after, &Scan { seq, stamp_ns, ..scan.clone() }, *at);
            }
            assert!(after.save() == going_on.save(), "{gap}");
            assert!(after.map() == going_on.map(), "{gap}");
            assert!(going_on.map().occupancy.iter().filter(|cell| **cell == 100).count() > 20);
            let saved = going_on.save();
            let mut cells = saved.tiles.iter().flat_map(|tile| tile.cells.iter().flatten());
            assert!(cells.any(|cell| cell.missed_width > 1000 && cell.visible.range[1] > 0), "the pane");
        }
    }

    #[test]
    fn a_pause_ends_all_runs() {
        let drive = drive(usize::MAX);
        let mut grid = Visagge::new(0.05, VisaggeSettings::default());
        drive[..30].iter().for_each(|(scan, at)| insert(&mut grid, scan, *at));
        let mut paused = Visagge::load(&grid.save(), VisaggeSettings::default()).unwrap();
        for (scan, at) in &drive[30..] {
            insert(&mut grid, scan, *at);
            insert(&mut paused, scan, *at);
        }
        let widths = |grid: &Visagge| {
            let saved = grid.save();
            let cells = saved.tiles.iter().flat_map(|tile| tile.cells.iter().flatten());
            cells.map(|cell| u64::from(cell.visible.range[1])).sum::<u64>()
        };
        assert!(widths(&paused) < widths(&grid));
    }

    #[test]
    fn what_is_no_grid_is_refused() {
        let mut grid = Visagge::new(0.05, VisaggeSettings::default());
        drive(5).iter().for_each(|(scan, at)| insert(&mut grid, scan, *at));
        let saved = grid.save();
        let tile = saved.tiles.iter().position(|tile| tile.cells.is_some()).unwrap();
        type Damage = fn(&mut SavedGrid, usize);
        let damages: [Damage; 12] = [
            |saved, _| saved.scan = u32::MAX,
            |saved, _| saved.elapsed_ns = -1,
            |saved, tile| saved.tiles[tile].cells.as_mut().unwrap()[0].occupancy = 255,
            |saved, _| saved.resolution = f64::NAN,
            |saved, _| saved.way = f32::INFINITY,
            |saved, tile| saved.tiles[tile].place = [i32::MAX, i32::MIN],
            |saved, tile| saved.tiles.push(saved.tiles[tile].clone()),
            |saved, tile| saved.tiles[tile].free.truncate(63),
            |saved, tile| saved.tiles[tile].driven.resize(65, 0),
            |saved, tile| saved.tiles[tile].cells.as_mut().unwrap()[0].place[1] = 64,
            |saved, tile| saved.tiles[tile].cells.as_mut().unwrap()[0].centroid[0] = f32::NAN,
            |saved, tile| {
                let cells = saved.tiles[tile].cells.as_mut().unwrap();
                cells.push(cells[0].clone());
            },
        ];
        for (number, damage) in damages.into_iter().enumerate() {
            let mut damaged = saved.clone();
            damage(&mut damaged, tile);
            assert!(Visagge::load(&damaged, VisaggeSettings::default()).is_err(), "{number}");
        }
        assert!(Visagge::load(&saved, VisaggeSettings::default()).is_ok());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        #[test]
        fn any_evidence_survives(
            scans in proptest::collection::vec((proptest::collection::vec(single(0.05..12.0), 40..200), -1.0..1.0, -1.0..1.0, -3.0..3.0), 1..12),
        ) {
            let mut grid = Visagge::new(0.05, VisaggeSettings::default());
            for (seq, (ranges, x, y, yaw)) in scans.into_iter().enumerate() {
                insert(&mut grid, &half_circle(seq as u64 * 2 / 3 * 2, ranges), [x, y, yaw]);
            }
            let saved = grid.save();
            let loaded = Visagge::load(&saved, VisaggeSettings::default()).unwrap();
            prop_assert_eq!(SavedGrid { scan: saved.scan + 1, ..saved }, loaded.save());
        }
    }
}
