//! The VisAGGE grid (paper IV): occupancy that knows from where it can be seen.
//!
//! [`Visagge::insert`] is the paper's core algorithm, a scan at a time. Which of the cells with evidence
//! are shown as occupied is decided in [`super::verdict`].

use super::{
    angle::{Angle, units},
    cell::{Cell, Returns, Rule},
    cells::{self, Cells},
    earlier::Earlier,
    free::Outline,
    glints::Glints,
    idea::Idea,
    judge::Judgement,
    landed::{Landed, Run},
    lanes::{self, Path, Sights},
    mirrors::Mirrors,
    near::{Near, Turns},
    rays::Rays,
    reflection::{Block, Opacity, Sources},
    saved::PAUSE_NS,
    slots::Slots,
    snapshot::ShownTile,
    squares::{CellsBySquare, Counts, Squares},
    sweep::Sweep,
    tiles::{CellIndex, SIDE, TileIndex, Tiles},
    track::{LANES, Look, Track, distance_units},
    view::{Lens, Place, Tolerance, View},
};
use serde::{Deserialize, Serialize};
use std::{f64::consts::SQRT_2, sync::Weak};

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
    /// Occupancy that a contradiction takes for each scan since the last look, where a hit adds 1 (1..100).
    pub contradiction: u8,
    /// Occupancy is not counted beyond this (1..200).
    pub occupancy_cap: u8,
    /// Whether a second range of view angles is kept, for what is seen from two sides.
    pub two_ranges: bool,
    /// Time from one look at a cell to the next, but for what is within a metre (s, 0..1). Default 0.1; 0: it is looked at in
    /// each scan. Every return counts in any case.
    pub look_every: f64,
    /// Whatever stood within this distance of the sensor's own path is gone (m, 0..1), and what comes there later is [somebody](Idea::Driven).
    pub body_radius: f64,
    /// Ideas that are left out, to see what they are worth.
    pub without: Vec<Idea>,
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
            look_every: 0.1,
            body_radius: 0.2,
            without: Vec::new(),
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
            // Two deviations, as of ranges: 20 m away a wall that is met askew is as far off by a heading as by all else.
            heading: 2.0 * self.heading_sigma,
        }
    }

    /// Whether use is made of an idea.
    pub(super) fn has(&self, idea: Idea) -> bool {
        !self.without.contains(&idea)
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
            outshone: self.has(Idea::Outshone),
            two_ranges: self.two_ranges,
            apart: self.has(Idea::Apart),
        }
    }
}

/// The cells with evidence in a tile.
#[derive(Clone, Debug)]
pub(super) struct Evidence {
    pub(super) slots: Slots,
    pub(super) cells: Cells,
    /// The last scan that these were compared with, and the number of their turn.
    looked_scan: u32,
    looked_turn: i32,
    /// What was last judged of each of `cells`.
    pub(super) judgements: Vec<Judgement>,
    /// Whether they were hit or looked at since.
    pub(super) is_touched: bool,
    /// Squares out of which cells were taken since.
    pub(super) emptied: Squares,
    /// A bit for each cell that is shown by itself unless it is an image, a word a row.
    pub(super) shaped: [u64; SIDE as usize],
    /// The same with gaps bridged.
    pub(super) shown: [u64; SIDE as usize],
    /// Those of these that nothing is seen through.
    pub(super) walls: CellsBySquare,
    /// Those that something may be seen through or in.
    pub(super) mirrors: Option<Box<Mirrors>>,
    /// What the images among the cells were judged by.
    pub(super) sources: Sources,
    /// What is seen through surfaces in these cells.
    pub(super) votes: Opacity,
    /// The blocks of `votes` that were opaque.
    pub(super) opaque: Vec<Block>,
}

impl Default for Evidence {
    fn default() -> Self {
        Evidence {
            slots: Slots::default(),
            cells: Cells::default(),
            looked_scan: 0,
            looked_turn: 0,
            judgements: Vec::new(),
            is_touched: true,
            emptied: Squares::default(),
            shaped: [0; SIDE as usize],
            shown: [0; SIDE as usize],
            walls: CellsBySquare::default(),
            mirrors: None,
            sources: Sources::default(),
            votes: Opacity::default(),
            opaque: Vec::new(),
        }
    }
}

impl Evidence {
    /// Puts a cell in where there was none, and gives its number.
    #[cold]
    #[inline(never)]
    fn add(&mut self, returns: Returns, track: Track) -> usize {
        let number = self.cells.len();
        self.slots.set(place_of(returns.place), number);
        self.cells.push(returns, track);
        cells::push(&mut self.judgements, Judgement::default());
        number
    }

    /// Takes note of being looked at, and gives whether this follows the look before, and how many scans there were since.
    fn look(&mut self, scan: u32, turn: i32) -> (bool, u16) {
        let scans = scan - self.looked_scan;
        let follows = scans <= 1 || turn.wrapping_sub(self.looked_turn) <= 1;
        (self.looked_scan, self.looked_turn, self.is_touched) = (scan, turn, true);
        (follows, if follows { scans.min(u32::from(u16::MAX)) as u16 } else { 1 })
    }

    /// Takes these cells, which lie at different places; the places of their tracks do not count.
    pub(super) fn fill(&mut self, cells: impl Iterator<Item = (Returns, Track)>) {
        for (returns, track) in cells {
            self.add(returns, Track { place: place_of(returns.place), ..track });
        }
    }

    /// The number of the cell in this column and row.
    pub(super) fn number(&self, column: usize, row: usize) -> Option<usize> {
        self.slots.get(place_of([column as u8, row as u8]))
    }

    /// Each cell with what was last judged of it.
    pub(super) fn judged(&mut self) -> impl Iterator<Item = (Cell, &mut Judgement)> {
        self.cells.iter().zip(&mut self.judgements)
    }

    /// Memory that it holds (bytes).
    pub(super) fn bytes(&self) -> usize {
        size_of_val(self)
            + self.slots.bytes()
            + self.cells.bytes()
            + self.judgements.capacity() * size_of::<Judgement>()
            + self.mirrors.as_ref().map_or(0, |mirrors| mirrors.bytes())
            + self.walls.bytes()
            + self.sources.bytes()
            + self.votes.bytes()
            + self.opaque.capacity() * size_of::<Block>()
    }

    fn retain(&mut self, keep: impl Fn(&Returns) -> bool) {
        let mut number = 0;
        while let Some(returns) = self.cells.returns.get(number) {
            if keep(returns) {
                number += 1;
                continue;
            }
            self.slots.clear(place_of(returns.place));
            self.emptied.insert(returns.place);
            self.cells.swap_remove(number);
            self.judgements.swap_remove(number);
            if let Some(moved) = self.cells.returns.get(number) {
                self.slots.set(place_of(moved.place), number);
            }
        }
    }
}

pub(super) fn place_of([column, row]: [u8; 2]) -> Place {
    Place::from(row) << 6 | Place::from(column)
}

/// A tile as the sensor sees it.
pub(super) struct Vantage {
    pub lens: Lens,
    /// The middle of the tile's first cell, seen from the sensor (m).
    pub corner: [f32; 2],
    pub resolution: f32,
}

/// A scan that a tile is compared with.
pub(super) struct Glance<'a> {
    pub view: &'a View,
    pub rule: &'a Rule,
    /// Way that the sensor has driven (m).
    pub way: f32,
    /// Whether the tile was looked at when it could have been last.
    pub follows: bool,
    /// Scans since then, with this one.
    pub scans: u16,
}

/// Of so many beams, one is learned from in each scan, if a wall returned it: that is enough, and next to nothing.
const LEARN_EVERY: usize = 32;

/// One tile of the grid.
#[derive(Clone, Debug)]
pub(super) struct Tile {
    /// A bit for each cell that a beam has crossed, a word a row.
    pub(super) free: [u64; SIDE as usize],
    /// The same for the robot, if it has been here.
    pub(super) driven: Option<Box<[u64; SIDE as usize]>>,
    /// The cells in which returns have landed.
    pub(super) evidence: Option<Box<Evidence>>,
    /// How many bits of `free` were set in each square when last judged.
    pub(super) judged_free: Counts,
    /// What others see of it, if somebody holds that still and nothing has changed since.
    pub(super) shown: Weak<ShownTile>,
}

impl Default for Tile {
    fn default() -> Self {
        Tile {
            free: [0; SIDE as usize],
            driven: None,
            evidence: None,
            judged_free: Counts::default(),
            shown: Weak::new(),
        }
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
    rays: Rays,
    /// A distance for each beam.
    distances: Vec<f32>,
    landed: Landed,
    earlier: Earlier,
    glints: Glints,
    /// The beams that brought one.
    glinting: Vec<u32>,
    outline: Outline,
    near: Near,
    turns: Turns,
    /// By number, which tiles were hit since they were last looked at.
    was_hit: Vec<bool>,
    /// Of the tile in work.
    sights: Box<[Sights; (SIDE * SIDE) as usize / LANES]>,
    /// Number of the last scan: one more for the next, two more where scans were lost in between.
    pub(super) scan: u32,
    seq: Option<u64>,
    pub(super) way: f32,
    /// Time of the scan (s since the first one).
    time: f32,
    first_stamp_ns: Option<i64>,
    /// Time from the first scan to the last (ns).
    pub(super) elapsed_ns: i64,
    pub(super) middle: Option<[f64; 2]>,
    /// In how many scans something must have been seen through a surface when that was last judged.
    pub(super) judged_glimpses: u16,
    /// Where it was when cells that the robot was in were last marked (m).
    marked_at: Option<[f64; 2]>,
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
            rays: Rays::default(),
            distances: Vec::new(),
            landed: Landed::default(),
            earlier: Earlier::default(),
            glints: Glints::default(),
            glinting: Vec::new(),
            outline: Outline::default(),
            near: Near::default(),
            turns: Turns::default(),
            was_hit: Vec::new(),
            sights: Box::new([Sights::default(); (SIDE * SIDE) as usize / LANES]),
            scan: 0,
            seq: None,
            way: 0.0,
            time: 0.0,
            first_stamp_ns: None,
            elapsed_ns: 0,
            middle: None,
            judged_glimpses: 0,
            marked_at: None,
        }
    }

    /// An empty grid that works as the paper has it: one range of view angles, a constant error of the
    /// localization, a beam without return as good as any, and the single-pass motion removal.
    pub fn as_in_the_paper(resolution: f64, settings: VisaggeSettings) -> Visagge {
        let settings = VisaggeSettings { two_ranges: false, look_every: 0.0, ..settings };
        Visagge { as_in_the_paper: true, ..Visagge::new(resolution, settings) }
    }

    /// Inserts one scan: VISAGGE CORE of the paper.
    pub fn insert(&mut self, sweep: &Sweep) {
        lanes::insert(self, sweep);
    }

    /// The same in instructions that every processor of the kind has, and with the same map, bit by bit: for comparison.
    pub fn insert_portably(&mut self, sweep: &Sweep) {
        lanes::insert_anywhere(self, sweep);
    }

    /// Inserts one scan, in the instructions of the function that this becomes a part of.
    #[inline(always)]
    pub(super) fn insert_here<P: Path>(&mut self, sweep: &Sweep) {
        if sweep.is_empty() {
            return;
        }
        self.begin(sweep);
        let rule = self.rule(sweep);
        self.record_hits(sweep, &rule);
        self.record_observations::<P>(&rule);
        if self.turns.are_of(TileIndex { x: 0, y: 0 }) {
            self.record_free();
        }
        self.mark_driven();
        self.free_body();
    }

    fn rule(&self, sweep: &Sweep) -> Rule {
        let rule = self.settings.rule(sweep.bearing_step().abs());
        if self.as_in_the_paper {
            return Rule { drift_least: rule.drift_most, silent_scans: 1, outshone: false, ..rule };
        }
        rule
    }

    /// Counts the scan and the way; a gap in the sequence ends all runs.
    #[inline(always)]
    fn begin(&mut self, sweep: &Sweep) {
        let follows = self.seq.is_none_or(|last| last + 1 == sweep.scan.seq);
        self.scan += if follows { 1 } else { 2 };
        self.seq = Some(sweep.scan.seq);
        // The scans before those that this grid was loaded with were stamped by another clock.
        let before_ns = if self.middle.is_some() { self.elapsed_ns + PAUSE_NS } else { 0 };
        let first_ns = *self.first_stamp_ns.get_or_insert(sweep.scan.stamp_ns - before_ns);
        self.elapsed_ns = sweep.scan.stamp_ns - first_ns;
        self.time = (self.elapsed_ns as f64 * 1e-9) as f32;
        let middle = [sweep.middle().x, sweep.middle().y];
        if let Some(before) = self.middle {
            self.way += (middle[0] - before[0]).hypot(middle[1] - before[1]) as f32;
        }
        self.middle = Some(middle);
        self.turns.go_on(self.elapsed_ns, self.settings.look_every, follows);
        self.rays.load(sweep, self.resolution);
        self.view.load(sweep, self.settings.range_max, &self.tolerance);
        self.earlier.keep(&self.view, &sweep.scan.ranges, self.time, follows);
    }

    /// Core step 1: where a return lands, the cell is more likely to be occupied.
    #[inline(always)]
    fn record_hits(&mut self, sweep: &Sweep, rule: &Rule) {
        let Visagge {
            tiles,
            was_hit,
            rays,
            distances,
            landed,
            earlier,
            glints,
            glinting,
            turns,
            settings,
            tolerance,
            ..
        } = self;
        let far = settings.range_max as f32;
        distances.clear();
        distances.extend(
            sweep.scan.ranges.iter().map(|&range| if range > 0.0 && range <= far { range } else { 0.0 }),
        );
        landed.load(rays, distances);
        let intensities = if settings.has(Idea::Glints) { &*sweep.scan.intensities } else { &[] };
        let has_intensities = intensities.len() == distances.len();
        if has_intensities && turns.are_of(TileIndex { x: 0, y: 0 }) {
            glints.conclude();
        }
        glinting.clear();
        if has_intensities {
            glints.find(distances, intensities, glinting);
        }
        let mut glinting = glinting.iter().map(|&beam| beam as usize).peekable();
        // Some of the beams of each scan, one after the other.
        let learns = |beam: usize| has_intensities && (beam + self.scan as usize).is_multiple_of(LEARN_EVERY);
        let base = rays.base();
        let mut recent = (TileIndex { x: i32::MAX, y: i32::MAX }, 0);
        let mut beam = 0;
        while let Some(Run { first, next, index, mean }) = landed.run(beam) {
            beam = next;
            let (place, column, row) = index.split();
            if recent.0 != place {
                recent = (place, tiles.find_or_make(TileIndex { x: base.x + place.x, y: base.y + place.y }));
                was_hit.resize(tiles.len(), false);
                was_hit[recent.1] = true;
                tiles.at_mut(recent.1).evidence.get_or_insert_default().is_touched = true;
            }
            let tile = tiles.at_mut(recent.1);
            let evidence = tile.evidence.get_or_insert_default();
            let at = place_of([column as u8, row as u8]);
            let number = match evidence.slots.get(at) {
                Some(number) => number,
                None => {
                    let angle = Angle::from_bearing(rays.bearing(first) + std::f32::consts::PI);
                    let look = Look { angle, range: distance_units(distances[first]).max(1), way: self.way };
                    let was_crossed = tile.free[row] >> column & 1 == 1;
                    let mut returns = Returns::new([column as u8, row as u8], was_crossed);
                    let middle = [(base.x, index.x), (base.y, index.y)].map(|(tile, cell)| {
                        (f64::from(tile) * f64::from(SIDE) + f64::from(cell) + 0.5) * self.resolution
                    });
                    let driven = tile.driven.as_ref();
                    returns.was_driven = driven.is_some_and(|driven| driven[row] >> column & 1 == 1);
                    returns.was_passed = !was_crossed && earlier.went_past(middle, self.time, tolerance);
                    evidence.add(returns, Track::new(at, &look))
                }
            };
            let is_glint = glinting.next_if(|glint| *glint < next).is_some();
            while glinting.next_if(|glint| *glint < next).is_some() {}
            if learns(first) && evidence.cells.is_wall(number) {
                glints.learn(distances[first], intensities[first]);
            }
            let returns = evidence.cells.hit(number);
            returns.record_hit(mean, is_glint, self.scan, self.time, rule);
            if has_intensities
                && returns.needs_brightness()
                && let Some(octaves) = glints.brightness(distances[first], intensities[first])
            {
                returns.record_brightness(octaves);
            }
        }
    }

    /// Core steps 2 to 5 for every cell with evidence that the scan may say something of.
    #[inline(always)]
    fn record_observations<P: Path>(&mut self, rule: &Rule) {
        let Visagge { tiles, turns, was_hit, view, tolerance, near, sights, .. } = self;
        let side = (f64::from(SIDE - 1) * self.resolution) as f32;
        was_hit.resize(tiles.len(), false);
        near.find(tiles, was_hit, *turns, view, tolerance, side);
        for number in near.tiles() {
            let place = tiles.place(number);
            let corner = view.corner(place, self.resolution);
            let vantage = Vantage { lens: view.lens, corner, resolution: self.resolution as f32 };
            let Some(evidence) = &mut tiles.at_mut(number).evidence else { continue };
            was_hit[number] = false;
            let (follows, scans) = evidence.look(self.scan, turns.number(place));
            let Cells { returns, blocks } = &mut evidence.cells;
            let mut nearest = i16::MAX as u16;
            for (block, sights) in blocks.iter().zip(&mut **sights) {
                nearest = nearest.min(P::sights(&vantage, block, sights));
            }
            view.prepare::<P>(nearest);
            let glance = Glance { view, rule, way: self.way, follows, scans };
            let mut removed = false;
            for ((block, returns), sights) in blocks.iter_mut().zip(returns.chunks_mut(LANES)).zip(&**sights)
            {
                removed |= P::record(&glance, block, sights, returns);
            }
            if removed {
                evidence.retain(|returns| returns.occupancy > 0);
            }
        }
    }

    /// Marks the area that the scan has swept, up to just before its returns.
    #[inline(always)]
    fn record_free(&mut self) {
        let Visagge { tiles, view, rays, distances, outline, .. } = self;
        view.free_ranges(self.settings.no_return_range as f32, self.tolerance.along as f32, distances);
        rays.points(distances, outline.begin());
        let [first, last] = rays.first_and_last(distances.len());
        outline.push(last[0], last[1]);
        outline.push(first[0], first[1]);
        let base = rays.base();
        outline.fill(|x, y, inside| {
            let number = tiles.find_or_make(TileIndex { x: base.x + x, y: base.y + y });
            for (free, inside) in tiles.at_mut(number).free.iter_mut().zip(inside) {
                *free |= inside;
            }
        });
    }

    /// Takes note of where the robot itself is, each time it has gone on by a cell.
    fn mark_driven(&mut self) {
        let (radius, [x, y], resolution) = (self.settings.body_radius, self.view.middle(), self.resolution);
        let way_squared = |[from_x, from_y]: [f64; 2]| (from_x - x).powi(2) + (from_y - y).powi(2);
        if self.marked_at.is_some_and(|from| way_squared(from) < resolution * resolution) {
            return;
        }
        self.marked_at = Some([x, y]);
        let low = CellIndex::of(x - radius, y - radius, resolution);
        let high = CellIndex::of(x + radius, y + radius, resolution);
        let mut recent = None;
        for row in low.y..=high.y {
            for column in low.x..=high.x {
                let index = CellIndex { x: column, y: row };
                if !index.is_within(radius, [x, y], resolution) {
                    continue;
                }
                let (place, column, row) = index.split();
                let number = match recent {
                    Some((of, number)) if of == place => number,
                    _ => self.tiles.find_or_make(place),
                };
                recent = Some((place, number));
                let rows = || Box::new([0; SIDE as usize]);
                self.tiles.at_mut(number).driven.get_or_insert_with(rows)[row] |= 1 << column;
            }
        }
    }

    /// Where the robot itself is, nothing else can be.
    #[inline(always)]
    fn free_body(&mut self) {
        let radius = self.settings.body_radius;
        let [x, y] = self.view.middle();
        let low = CellIndex::of(x - radius, y - radius, self.resolution);
        let high = CellIndex::of(x + radius, y + radius, self.resolution);
        let resolution = self.resolution;
        let within =
            |place: TileIndex, returns: &Returns| returns.index(place).is_within(radius, [x, y], resolution);
        let (low, first_column, first_row) = low.split();
        let (high, last_column, last_row) = high.split();
        for place in (low.y..=high.y).flat_map(|y| (low.x..=high.x).map(move |x| TileIndex { x, y })) {
            if let Some(number) = self.tiles.find(place)
                && let Some(evidence) = &mut self.tiles.at_mut(number).evidence
            {
                let last = SIDE as usize - 1;
                let columns = [
                    if place.x == low.x { first_column } else { 0 },
                    if place.x == high.x { last_column } else { last },
                ];
                let rows = [
                    if place.y == low.y { first_row } else { 0 },
                    if place.y == high.y { last_row } else { last },
                ];
                // Nearly always nothing is there.
                if evidence.slots.may_hold(columns, rows)
                    && evidence.cells.returns.iter().any(|returns| within(place, returns))
                {
                    evidence.retain(|returns| !within(place, returns));
                }
            }
        }
    }

    /// All cells with evidence.
    pub(super) fn cells(&self) -> impl Iterator<Item = (CellIndex, Cell, &Judgement)> {
        self.tiles.iter().flat_map(|(place, tile)| {
            tile.evidence.iter().flat_map(move |evidence| {
                let judged = evidence.cells.iter().zip(&evidence.judgements);
                judged.map(move |(cell, judgement)| (cell.index(place), cell, judgement))
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        grid::{
            lanes::Portable,
            sweep::tests::{half_circle, single},
            track::{Run, Sector},
            view::{HIT, Observation},
        },
        pose::pose,
        scan::Scan,
    };
    use proptest::prelude::*;
    use std::collections::HashSet;

    impl Visagge {
        /// What the fast paths must do, cell by cell: all tiles are gone through, and in those that are left out nothing may be learned.
        fn insert_plainly(&mut self, sweep: &Sweep) {
            self.begin(sweep);
            let rule = self.rule(sweep);
            self.record_hits(sweep, &rule);
            let side = (f64::from(SIDE - 1) * self.resolution) as f32;
            self.was_hit.resize(self.tiles.len(), false);
            let Visagge { tiles, turns, was_hit, view, tolerance, near, .. } = self;
            near.find(tiles, was_hit, *turns, view, tolerance, side);
            let looked_at: HashSet<usize> = near.tiles().collect();
            looked_at.iter().for_each(|&number| was_hit[number] = false);
            self.view.prepare::<Portable>(0);
            for number in 0..self.tiles.len() {
                let place = self.tiles.place(number);
                let corner = self.view.corner(place, self.resolution);
                let [x, y] = corner.map(|at| at + side / 2.0);
                if !self.turns.have_come(place, [x, y], side / 2.0) {
                    continue;
                }
                let Some(evidence) = &mut self.tiles.at_mut(number).evidence else { continue };
                let is_looked_at = looked_at.contains(&number);
                let (follows, scans) = if is_looked_at {
                    evidence.look(self.scan, self.turns.number(place))
                } else {
                    (false, 0)
                };
                for number in 0..evidence.cells.len() {
                    let mut track = evidence.cells.track(number);
                    let returns = &mut evidence.cells.returns[number];
                    if !follows {
                        track.end_run();
                    }
                    let at =
                        |axis: usize| corner[axis] + f32::from(returns.place[axis]) * self.resolution as f32;
                    let sight = self.view.sight(at(0), at(1));
                    let look = Look { angle: sight.angle, range: sight.range, way: self.way };
                    let observation = if track.place & HIT != 0 {
                        Observation::Seen
                    } else {
                        self.view.observe(&sight, || track.would_return(sight.range))
                    };
                    if !is_looked_at {
                        assert_eq!(observation, Observation::Hidden, "{:?} of {place:?}", returns.place);
                        continue;
                    }
                    returns.record(track.record(observation, &look, scans, &rule, returns), scans, &rule);
                    evidence.cells.blocks[number / LANES].set(number % LANES, track);
                }
                evidence.retain(|returns| returns.occupancy > 0);
            }
            if self.turns.are_of(TileIndex { x: 0, y: 0 }) {
                self.record_free();
            }
            self.mark_driven();
            self.free_body();
        }
    }

    #[test]
    fn cells_know_whether_the_robot_had_been_there() {
        let mut grid = Visagge::new(0.05, VisaggeSettings::default());
        let mut drive = |number: usize, ahead: f32, [x, yaw]: [f64; 2]| {
            let scan = half_circle(number as u64, vec![ahead; 181]);
            let at = pose(x, 0.0, yaw);
            grid.insert(&Sweep { scan: &scan, start: at, end: at });
        };
        (0..60).for_each(|number| drive(number, 4.0, [0.05 * number as f64, 0.0]));
        // Somebody stands around it, 1 m away, when it has turned back.
        drive(60, 1.0, [2.95, std::f64::consts::PI]);
        let near = |[x, y]: [f64; 2]| {
            let found = grid.cells().find(|(index, ..)| *index == CellIndex::of(x, y, 0.05));
            found.expect("it was hit").1.returns.was_driven
        };
        assert!(near([1.96, 0.02]) && near([1.96, 0.12]), "half a robot's width");
        assert!(!near([2.03, 0.42]), "beside its way");
    }

    #[test]
    fn cells_count_their_glints_as_soon_as_walls_are_known() {
        // Between walls 2 m to the left and 6 m to the right; the left one glints where a beam meets it squarely.
        let drive = |glint: f32| {
            let mut grid = Visagge::new(0.05, VisaggeSettings::default());
            for number in 0..1200 {
                let bearing = |beam: usize| (beam as f32 / 2.0 - 90.0).to_radians();
                let across = |beam: usize| if beam < 180 { 6.0 } else { 2.0 };
                let ranges = (0..361).map(|beam| across(beam) / bearing(beam).sin().abs().max(0.1)).collect();
                let mut scan = half_circle(number, ranges);
                scan.stamp_ns = number as i64 * 100_000_000;
                let brightness = |(beam, range): (usize, &f32)| {
                    let of = if beam == 360 { glint } else { 0.4 + 0.1 * (beam % 5) as f32 };
                    700.0 * (of / range.powi(2)).powf(0.3)
                };
                scan.intensities = scan.ranges.iter().enumerate().map(brightness).collect();
                let at = pose(0.01 * number as f64, 0.0, 0.0);
                grid.insert(&Sweep { scan: &scan, start: at, end: at });
            }
            let glinted =
                grid.cells().filter(|(_, cell, _)| cell.returns.glints > 0).map(|(index, ..)| index);
            glinted.collect::<Vec<_>>()
        };
        assert!(drive(0.8).is_empty());
        let glinted = drive(50.0);
        assert!(glinted.len() > 50, "{}", glinted.len());
        assert!(
            glinted.iter().all(|index| (38..42).contains(&index.y) && index.x < 240),
            "where it was met squarely"
        );
    }

    /// Ranges as of walls, people and glass: long stretches that step, with holes.
    fn ranges() -> impl Strategy<Value = Vec<f32>> {
        let stretch =
            (prop_oneof![1 => Just(f32::INFINITY), 1 => Just(f32::NAN), 12 => single(0.1..12.0)], 1usize..60);
        proptest::collection::vec((stretch, single(-0.02..0.02)), 5..30).prop_map(|stretches| {
            let mut ranges: Vec<f32> = Vec::new();
            for ((range, count), slope) in stretches {
                ranges.extend((0..count).map(|beam| range + slope * beam as f32));
            }
            ranges.resize(ranges.len().max(10), 4.0);
            ranges
        })
    }

    fn moves() -> impl Strategy<Value = [f64; 3]> {
        [-0.2..0.2, -0.2..0.2, -0.3..0.3]
    }

    type Contents = Vec<(TileIndex, [u64; SIDE as usize], Vec<(Returns, Track)>)>;

    fn contents(grid: &Visagge) -> Contents {
        let cells = |tile: &Tile| {
            let evidence = tile.evidence.iter();
            evidence
                .flat_map(|evidence| evidence.cells.kept())
                // Of tiles that were left out, runs end when they are looked at again.
                .map(|(returns, track)| {
                    (*returns, Track { run: Run::None, sector: Sector::default(), missed_scans: 0, ..track })
                })
                .collect()
        };
        grid.tiles.iter().map(|(place, tile)| (place, tile.free, cells(tile))).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]
        #[test]
        fn all_paths_make_the_same_map(
            scans in proptest::collection::vec((ranges(), 1usize..6, moves()), 1..8),
            first in [-20.0..20.0, -20.0..20.0, -3.0..3.0],
            clockwise: bool,
        ) {
            let mut grids = [0; 3].map(|_| Visagge::new(0.05, VisaggeSettings::default()));
            let mut at = pose(first[0], first[1], first[2]);
            let mut seq = 0;
            for (ranges, times, [x, y, turn]) in scans {
                for _ in 0..times {
                    let mut scan: Scan = half_circle(seq, ranges.clone());
                    if clockwise {
                        scan.geometry.angle_min *= -1.0;
                        scan.geometry.angle_increment *= -1.0;
                    }
                    let end = at * pose(x / 10.0, y / 10.0, turn / 10.0);
                    let sweep = Sweep { scan: &scan, start: at, end };
                    grids[0].insert_plainly(&sweep);
                    grids[1].insert_portably(&sweep);
                    grids[2].insert(&sweep);
                    at = end;
                    seq += 1;
                }
                at *= pose(x, y, turn);
                seq += u64::from(turn > 0.2);
            }
            let plain = contents(&grids[0]);
            for (grid, name) in [(&grids[1], "portable"), (&grids[2], "widest")] {
                for ((place, free, cells), other) in plain.iter().zip(contents(grid)) {
                    prop_assert_eq!((place, free), (&other.0, &other.1));
                    let differ = cells.iter().zip(&other.2).find(|(a, b)| a != b);
                    prop_assert!(cells.len() == other.2.len() && differ.is_none(), "{name}: {differ:?}");
                }
            }
            prop_assert!(plain.iter().any(|(.., cells)| cells.len() > 1) || seq < 20);
        }
    }
}
