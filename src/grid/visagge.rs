//! The VisAGGE grid (paper IV): occupancy that knows from where it can be seen.
//!
//! [`Visagge::insert`] is the paper's core algorithm, a scan at a time. Which of the cells with evidence
//! are shown as occupied is decided in [`super::verdict`].

use super::{
    angle::units,
    cell::{Cell, Look, Rule},
    free::Outline,
    sweep::Sweep,
    tiles::{CellIndex, SIDE, TileIndex, Tiles},
    view::{Observation, Tolerance, View},
};
use serde::{Deserialize, Serialize};
use std::f64::consts::SQRT_2;

/// What the grid assumes of scanner, localization and world.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VisaggeSettings {
    /// Standard deviation of a range (m, 0..0.1). UTM-30LX: 0.01 up to 10 m (data sheet: +-30 mm).
    pub range_sigma: f64,
    /// Standard deviation of the position that comes with a scan (m, 0..0.5). Outside localizers: 0.015.
    pub position_sigma: f64,
    /// Standard deviation of its heading (rad, 0..0.1). Outside localizers: 0.0035, which is 0.2 degrees.
    pub heading_sigma: f64,
    /// By how much two position errors differ, for each metre driven between them (m/m, 0..1).
    pub drift: f64,
    /// Longest distance that counts as a measurement (m, 1..60). UTM-30LX: 30 guaranteed.
    pub range_max: f64,
    /// Up to this distance a beam without return is known to have met nothing (m, 0..30). At 5 m a
    /// scanner that sees an albedo of 0.9 at 30 m still sees one of 0.025.
    pub no_return_range: f64,
    /// Occupancy that a contradiction takes, where a hit adds 1 (1..100).
    pub contradiction: u8,
    /// Occupancy is not counted beyond this (1..200).
    pub occupancy_cap: u8,
    /// Whether a second range of view angles is kept, for what is seen from two sides.
    pub two_ranges: bool,
    /// Whatever stood within this distance of the sensor's own path is gone (m, 0..1).
    pub body_radius: f64,
}

impl Default for VisaggeSettings {
    fn default() -> Self {
        VisaggeSettings {
            range_sigma: 0.01,
            position_sigma: 0.015,
            heading_sigma: 0.0035,
            drift: 0.03,
            range_max: 30.0,
            no_return_range: 5.0,
            contradiction: 5,
            occupancy_cap: 30,
            two_ranges: true,
            body_radius: 0.2,
        }
    }
}

impl VisaggeSettings {
    fn tolerance(&self, resolution: f64) -> Tolerance {
        Tolerance {
            resolution,
            // Half a cell's diagonal, the noise of the range, and that of the pose.
            along: resolution * SQRT_2 / 2.0 + 2.0 * self.range_sigma + self.position_sigma,
            across: SQRT_2 * self.position_sigma,
            heading: self.heading_sigma,
        }
    }

    fn rule(&self, beam: f64) -> Rule {
        Rule {
            contradiction: self.contradiction,
            cap: self.occupancy_cap,
            half_beam: units(beam / 2.0),
            drift_least: 0.002,
            drift_rate: self.drift as f32,
            // Two independent errors, three standard deviations.
            drift_most: (3.0 * SQRT_2 * self.position_sigma) as f32,
            // A surface at grazing incidence still returns three times in ten.
            silent_scans: 20,
            two_ranges: self.two_ranges,
        }
    }
}

/// No cell in this place of a tile.
const NONE: u16 = u16::MAX;

/// The cells with evidence in a tile.
#[derive(Clone, Debug)]
pub(super) struct Evidence {
    slots: Box<[u16; (SIDE * SIDE) as usize]>,
    pub(super) cells: Vec<Cell>,
    /// A bit for each cell that is shown unless it is an image, a word a row.
    pub(super) shown: [u64; SIDE as usize],
    /// Whether anything changed since the verdict on the tile.
    pub(super) changed: bool,
}

impl Default for Evidence {
    fn default() -> Self {
        Evidence {
            slots: Box::new([NONE; (SIDE * SIDE) as usize]),
            cells: Vec::new(),
            shown: [0; SIDE as usize],
            changed: false,
        }
    }
}

impl Evidence {
    fn cell_mut(&mut self, place: [u8; 2], make: impl FnOnce() -> Cell) -> &mut Cell {
        let slot = &mut self.slots[slot(place)];
        if *slot == NONE {
            *slot = self.cells.len() as u16;
            self.cells.push(make());
        }
        &mut self.cells[usize::from(*slot)]
    }

    /// The cell in this column and row, if it is shown unless it is an image.
    pub(super) fn shown_at(&self, column: usize, row: usize) -> Option<&Cell> {
        let shown = self.shown[row] >> column & 1 == 1;
        let slot = || usize::from(self.slots[slot([column as u8, row as u8])]);
        if shown { self.cells.get(slot()) } else { None }
    }

    /// Memory beside the tile itself (bytes).
    pub(super) fn bytes(&self) -> usize {
        size_of_val(&*self.slots) + self.cells.capacity() * size_of::<Cell>()
    }

    fn retain(&mut self, keep: impl Fn(&Cell) -> bool) {
        let mut number = 0;
        while let Some(cell) = self.cells.get(number) {
            if keep(cell) {
                number += 1;
                continue;
            }
            self.slots[slot(cell.place)] = NONE;
            self.shown[usize::from(cell.place[1])] &= !(1 << cell.place[0]);
            self.cells.swap_remove(number);
            if let Some(moved) = self.cells.get(number) {
                self.slots[slot(moved.place)] = number as u16;
            }
            self.changed = true;
        }
    }
}

fn slot(place: [u8; 2]) -> usize {
    usize::from(place[1]) * SIDE as usize + usize::from(place[0])
}

/// One tile of the grid.
#[derive(Clone, Debug)]
pub(super) struct Tile {
    /// A bit for each cell that a beam has crossed, a word a row.
    pub(super) free: [u64; SIDE as usize],
    /// The cells in which returns have landed.
    pub(super) evidence: Option<Evidence>,
}

impl Default for Tile {
    fn default() -> Self {
        Tile { free: [0; SIDE as usize], evidence: None }
    }
}

/// The grid.
#[derive(Debug)]
pub struct Visagge {
    pub(super) settings: VisaggeSettings,
    pub(super) resolution: f64,
    pub(super) tiles: Tiles<Tile>,
    pub(super) as_in_the_paper: bool,
    tolerance: Tolerance,
    view: View,
    outline: Outline,
    /// Number of the last scan: one more for the next, two more where scans were lost in between.
    scan: u32,
    seq: Option<u64>,
    way: f32,
    middle: Option<[f64; 2]>,
}

impl Visagge {
    /// An empty grid.
    pub fn new(resolution: f64, settings: VisaggeSettings) -> Visagge {
        Visagge {
            tolerance: settings.tolerance(resolution),
            settings,
            resolution,
            tiles: Tiles::default(),
            as_in_the_paper: false,
            view: View::default(),
            outline: Outline::default(),
            scan: 0,
            seq: None,
            way: 0.0,
            middle: None,
        }
    }

    /// An empty grid that works as the paper has it: one range of view angles, a constant error of the
    /// localization, a beam without return as good as any, and the single-pass motion removal.
    pub fn as_in_the_paper(resolution: f64, settings: VisaggeSettings) -> Visagge {
        let settings = VisaggeSettings { two_ranges: false, ..settings };
        Visagge { as_in_the_paper: true, ..Visagge::new(resolution, settings) }
    }

    /// Inserts one scan: VISAGGE CORE of the paper.
    pub fn insert(&mut self, sweep: &Sweep) {
        if sweep.is_empty() {
            return;
        }
        self.begin(sweep);
        let mut rule = self.settings.rule(sweep.bearing_step().abs());
        if self.as_in_the_paper {
            rule = Rule { drift_least: rule.drift_most, silent_scans: 1, ..rule };
        }
        self.record_hits(sweep, &rule);
        self.record_observations(&rule);
        self.record_free(sweep);
        self.free_body();
    }

    /// Counts the scan and the way; a gap in the sequence ends all runs.
    fn begin(&mut self, sweep: &Sweep) {
        let follows = self.seq.is_none_or(|last| last + 1 == sweep.scan.seq);
        self.scan += if follows { 1 } else { 2 };
        self.seq = Some(sweep.scan.seq);
        let middle = [sweep.middle().x, sweep.middle().y];
        if let Some(before) = self.middle {
            self.way += (middle[0] - before[0]).hypot(middle[1] - before[1]) as f32;
        }
        self.middle = Some(middle);
        self.view.load(sweep, self.settings.range_max);
    }

    fn look(&self, angle: super::angle::Angle, range: f32) -> Look {
        Look { scan: self.scan, angle, range, way: self.way }
    }

    /// Core step 1: where a return lands, the cell is more likely to be occupied.
    fn record_hits(&mut self, sweep: &Sweep, rule: &Rule) {
        for ((origin, direction), &range) in sweep.beams().zip(&sweep.scan.ranges) {
            let range = f64::from(range);
            if !(range > 0.0 && range <= self.settings.range_max) {
                continue;
            }
            let point = origin + direction * range;
            let index = CellIndex::of(point.x, point.y, self.resolution);
            let (place, column, row) = index.split();
            let angle = super::angle::Angle::from_rad((-direction.y).atan2(-direction.x));
            let look = self.look(angle, range as f32);
            let number = self.tiles.find_or_make(place);
            let tile = self.tiles.at_mut(number);
            let crossed = tile.free[row] >> column & 1 == 1;
            let evidence = tile.evidence.get_or_insert_default();
            evidence.changed = true;
            let at = [
                (point.x / self.resolution - f64::from(index.x)) as f32,
                (point.y / self.resolution - f64::from(index.y)) as f32,
            ];
            let place = [column as u8, row as u8];
            evidence.cell_mut(place, || Cell::new(place, crossed, &look)).record_hit(at, &look, rule);
        }
    }

    /// Core steps 2 to 5 for every cell with evidence that the scan says something of.
    fn record_observations(&mut self, rule: &Rule) {
        let half_tile = f64::from(SIDE) * self.resolution / 2.0;
        for number in 0..self.tiles.len() {
            if self.tiles.at(number).evidence.is_none() {
                continue;
            }
            let place = self.tiles.place(number);
            let centre = |index: i32| (f64::from(index * SIDE) * self.resolution) + half_tile;
            if self.out_of_reach([centre(place.x), centre(place.y)], half_tile * SQRT_2) {
                continue;
            }
            let look = Look { scan: self.scan, angle: Default::default(), range: 0.0, way: self.way };
            let (view, tolerance, resolution) = (&self.view, &self.tolerance, self.resolution);
            let evidence = self.tiles.at_mut(number).evidence.as_mut().expect("tested above");
            let mut removed = false;
            for cell in &mut evidence.cells {
                let index = cell.index(place);
                let at = |index: i32| (f64::from(index) + 0.5) * resolution;
                let Some(sight) = view.sight(at(index.x), at(index.y)) else {
                    cell.record_hidden();
                    continue;
                };
                let look = Look { angle: sight.angle, range: sight.range, ..look };
                if cell.hit_scan == look.scan {
                    cell.record_seen(&look, rule);
                    continue;
                }
                match view.observe(&sight, cell.would_return(sight.range), tolerance) {
                    Observation::Seen => cell.record_seen(&look, rule),
                    observed @ (Observation::Missed | Observation::Silent) => {
                        cell.record_missed(&look, observed == Observation::Silent, rule);
                        removed |= cell.occupancy == 0;
                    }
                    Observation::Hidden => cell.record_hidden(),
                    Observation::Unsure => cell.record_unsure(&look),
                }
            }
            if removed {
                evidence.retain(|cell| cell.occupancy > 0);
            }
        }
    }

    /// Whether the scan says nothing of any cell in the disc. What is not looked at in a scan ends its runs by itself: they
    /// are bound to the number of the scan.
    fn out_of_reach(&self, centre: [f64; 2], radius: f64) -> bool {
        let distance = (centre[0] - self.view.middle()[0]).hypot(centre[1] - self.view.middle()[1]);
        let nearest = distance - radius;
        if nearest > f64::from(self.view.farthest()) + self.tolerance.along {
            return true;
        }
        if nearest <= radius {
            return false;
        }
        // The disc's width, and a margin for the motion within the scan and for the heading.
        let half = (radius / distance).asin() + self.tolerance.heading + 0.02;
        match self.view.sight(centre[0], centre[1]) {
            Some(sight) => {
                f64::from(self.view.reach_between(sight.beam, half as f32)) + self.tolerance.along < nearest
            }
            None => false,
        }
    }

    /// Marks the area that the scan has swept, up to just before its returns.
    fn record_free(&mut self, sweep: &Sweep) {
        let [x, y] = self.view.middle();
        let (base, ..) = CellIndex::of(x, y, self.resolution).split();
        let corner = base.cell(0, 0);
        let local = |point: nalgebra::Point2<f64>| {
            (
                (point.x / self.resolution - f64::from(corner.x)) as f32,
                (point.y / self.resolution - f64::from(corner.y)) as f32,
            )
        };
        self.outline.clear();
        for ((origin, direction), clear) in
            sweep.beams().zip(self.view.free_ranges(self.settings.no_return_range as f32))
        {
            let free = (f64::from(clear) - self.tolerance.along).max(0.0);
            let (x, y) = local(origin + direction * free);
            self.outline.push(x, y);
        }
        for end in [&sweep.end, &sweep.start] {
            let (x, y) = local(end.translation.vector.into());
            self.outline.push(x, y);
        }
        let tiles = &mut self.tiles;
        self.outline.fill(|x, y, inside| {
            let number = tiles.find_or_make(TileIndex { x: base.x + x, y: base.y + y });
            for (free, inside) in tiles.at_mut(number).free.iter_mut().zip(inside) {
                *free |= inside;
            }
        });
    }

    /// Where the robot itself is, nothing else can be.
    fn free_body(&mut self) {
        let radius = self.settings.body_radius;
        let [x, y] = self.view.middle();
        let low = CellIndex::of(x - radius, y - radius, self.resolution);
        let high = CellIndex::of(x + radius, y + radius, self.resolution);
        let resolution = self.resolution;
        let within = |place: TileIndex, cell: &Cell| {
            let index = cell.index(place);
            let at = |index: i32| (f64::from(index) + 0.5) * resolution;
            (at(index.x) - x).hypot(at(index.y) - y) <= radius
        };
        let (low, _, _) = low.split();
        let (high, _, _) = high.split();
        for place in (low.y..=high.y).flat_map(|y| (low.x..=high.x).map(move |x| TileIndex { x, y })) {
            if let Some(number) = self.tiles.find(place)
                && let Some(evidence) = &mut self.tiles.at_mut(number).evidence
            {
                evidence.retain(|cell| !within(place, cell));
            }
        }
    }

    /// All cells with evidence.
    pub(super) fn cells(&self) -> impl Iterator<Item = (CellIndex, &Cell)> {
        self.tiles.iter().flat_map(|(place, tile)| {
            tile.evidence.iter().flat_map(move |evidence| {
                evidence.cells.iter().map(move |cell| {
                    (place.cell(usize::from(cell.place[0]), usize::from(cell.place[1])), cell)
                })
            })
        })
    }
}
