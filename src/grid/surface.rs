//! The surface that runs through a cell: a line through the returns in its neighbourhood.

use super::{
    angle::{Angle, units},
    cell::Cell,
    idea::Idea,
    squares::Reach,
    tiles::{CellIndex, SIDE, TileIndex, whole},
    verdict::is_solid,
    visagge::Visagge,
};
use nalgebra::Vector2;
use std::{
    f64::consts::{FRAC_PI_2, FRAC_PI_3, PI},
    ops::{Range, RangeInclusive},
    sync::LazyLock,
};

/// Cells around a tile whose surfaces reach into it.
pub const MARGIN: i32 = 24;
/// Cells along the side of a window.
pub const WINDOW: i32 = SIDE + 2 * MARGIN;
const _: () = assert!(WINDOW <= 128 && PATCH <= MARGIN);
/// Half the side of the square in which the first patch is sought (cells).
const PATCH: i32 = 8;
/// Half the length of that patch (m).
const PATCH_HALF: f64 = 0.4;
/// Depth of the patch (m): what lies farther before or behind is not part of the surface.
const PATCH_DEPTH: f64 = 0.15;
/// Neighbours seen from directions farther apart than this are parts of different surfaces (rad): 3 degrees on a flat pane,
/// where a position error of 5 cm seen from 1 m is all that differs.
pub const OF_PLANE: f64 = 0.05;
/// The same where it bends: a pillar of glass of 1 m radius turns by this over the length of the patch.
pub const OF_PILLAR: f64 = 0.3;
/// Round surfaces, cases and columns, have radii of at least this many steps of 0.1 m, and less than so many: legs are thinner, and of what is
/// wider a patch is flat enough.
const RADII: Range<usize> = 2..10;
const RADIUS_STEP: f64 = 0.1;
/// A cell tells the radius if the normal there is turned by at least this (rad), 8 degrees: by less, it may be seen off its normal as well.
const TURNED: f64 = 0.14;
/// What is round is looked at as far as it bends by this to either side (rad): 60 degrees, half a patch at a radius of 0.46 m.
const BEND: f64 = FRAC_PI_3;
/// Returns that a cell counts with at most: enough that single ones do not spoil a line, few enough that nobody who stood
/// still outweighs all else.
const WEIGHT: u8 = 10;
/// What is seen from directions no farther apart than this (rad) is seen one behind the other: 6 degrees, a leg's width at 1 m.
const SAME_VIEW: f64 = 0.1;
/// What lies no farther off a line is on it (m): two standard deviations of ranges and poses, and half a cell.
const ON_LINE: f64 = 0.06;
/// Two legs lie this far apart at most while they swing, along the line of sight (m); behind a pane seldom anything stands as near.
const CLUTTER: f64 = 0.3;
/// Most that a flat surface spreads across its line, root mean square (m): cells, ranges and poses.
const FLAT: f32 = 0.035;
/// A patch that spreads by this (m, root mean square) has something else right before or behind its surface: more than ranges and poses do,
/// and less than what is no surface at all. Without that, it is as long as this at least (m): broader than anybody.
const UNEVEN: RangeInclusive<f32> = 0.03..=0.05;
const LEAST_TRIMMED: f32 = 0.5;
/// What lies this near is part of the same thing (m): the legs of who stands.
const AROUND: f64 = 0.25;
/// Share of what is around a cell that has come, if it came with it.
const COME_AS_ONE: f64 = 0.9;
/// Most cells without evidence that a long surface bridges: a frame, somebody in front.
const BRIDGE: i32 = 5;

/// A line through a patch of cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// A point on it (m), in the middle of the patch.
    pub at: [f32; 2],
    /// Direction of its normal (rad, modulo pi).
    pub normal: f32,
    /// Spread across it, root mean square (m).
    pub rms: f32,
    /// Length of an even row of points with the same spread along it (m).
    pub length: f32,
    /// Share of what was seen from the same direction, there and up to 0.3 m before and behind it, that lies on it (0..1).
    pub share: f32,
    /// Whether any of what lies on it has glinted.
    pub glints: bool,
}

impl Line {
    /// Whether the patch is as flat as noise allows.
    pub fn is_flat(&self) -> bool {
        self.rms <= FLAT
    }

    /// How far points are from it (m).
    fn distance(&self) -> impl Fn([f64; 2]) -> f64 + use<> {
        let (sin, cos) = f64::from(self.normal).sin_cos();
        let [x, y] = self.at.map(f64::from);
        move |at| ((at[0] - x) * cos + (at[1] - y) * sin).abs()
    }

    /// Angle between the normal and a view (rad, 0..pi/2).
    pub fn off_normal(&self, seen_from: f64) -> f64 {
        off_normal(f64::from(self.normal), seen_from)
    }
}

/// Angle between a line's normal and a view (rad, 0..pi/2).
pub fn off_normal(normal: f64, seen_from: f64) -> f64 {
    let off = (normal - seen_from).rem_euclid(PI);
    off.min(PI - off)
}

/// Weighted moments of points.
#[derive(Default)]
struct Moments {
    sum: f64,
    mean: [f64; 2],
    square: [f64; 3],
}

impl Moments {
    fn add(&mut self, [x, y]: [f64; 2], weight: f64) {
        self.sum += weight;
        self.mean = [self.mean[0] + weight * x, self.mean[1] + weight * y];
        self.square = [
            self.square[0] + weight * x * x,
            self.square[1] + weight * x * y,
            self.square[2] + weight * y * y,
        ];
    }

    /// The line through the points, which were given relative to `origin`.
    fn line(&self, origin: [f64; 2]) -> Option<Line> {
        if self.sum <= 0.0 {
            return None;
        }
        let [x, y] = self.mean.map(|mean| mean / self.sum);
        let [xx, xy, yy] = self.square.map(|square| square / self.sum);
        let (xx, xy, yy) = (xx - x * x, xy - x * y, yy - y * y);
        let spread = (((xx - yy) / 2.0).powi(2) + xy * xy).sqrt();
        let along = f64::atan2(2.0 * xy, xx - yy) / 2.0;
        Some(Line {
            at: [(origin[0] + x) as f32, (origin[1] + y) as f32],
            normal: (along + FRAC_PI_2) as f32,
            rms: ((xx + yy) / 2.0 - spread).max(0.0).sqrt() as f32,
            length: (12.0 * ((xx + yy) / 2.0 + spread)).sqrt() as f32,
            share: 0.0,
            glints: false,
        })
    }
}

/// A cell in or near the tile in work.
#[derive(Clone, Copy, Default)]
struct Neighbour {
    at: [f64; 2],
    seen_from: Angle,
    weight: f64,
    /// The same by all of its returns, as their square root: each has an error of its range, and those of one pass share that of the pose.
    weight_of_returns: f64,
    /// Whether a beam had crossed it before the first return came.
    was_crossed: bool,
    /// Whether it was hardly ever missed: what stands behind a pane, not somebody's other leg.
    is_solid: bool,
    /// Whether it has ever glinted: once is enough, far away a cell is met at its normal in a scan or two.
    glints: bool,
}

/// No cell.
const NONE: u16 = u16::MAX;

/// The cells with evidence in a tile and around it, found by their place.
pub struct Window {
    origin: CellIndex,
    resolution: f64,
    /// Whether [`Idea::Trimmed`] is made use of.
    trims: bool,
    /// A bit for each cell with evidence, a word a row.
    rows: [u128; WINDOW as usize],
    /// Which number each of these has; [`NONE`] for all others.
    slots: Vec<u16>,
    /// By number: row by row, and in each from left to right.
    cells: Vec<Neighbour>,
}

impl Window {
    /// The window around a tile.
    pub(super) fn around(grid: &Visagge, place: TileIndex) -> Window {
        let corner = place.cell(0, 0);
        let mut window = Window {
            origin: CellIndex { x: corner.x - MARGIN, y: corner.y - MARGIN },
            resolution: grid.resolution,
            trims: grid.settings.has(Idea::Trimmed),
            rows: [0; WINDOW as usize],
            slots: vec![NONE; (WINDOW * WINDOW) as usize],
            cells: Vec::new(),
        };
        let mut found = Vec::new();
        for (dx, dy) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))) {
            let place = TileIndex { x: place.x + dx, y: place.y + dy };
            let Some(evidence) = grid.tiles.get(place).and_then(|tile| tile.evidence.as_ref()) else {
                continue;
            };
            for (number, returns) in evidence.cells.returns.iter().enumerate() {
                let index = returns.index(place);
                let [x, y] = window.inside(index);
                if (0..WINDOW).contains(&x) && (0..WINDOW).contains(&y) {
                    window.rows[y as usize] |= 1 << x;
                    found.push(((y * WINDOW + x) as usize, index, evidence, number));
                }
            }
        }
        let mut count = 0;
        for (row, mut cells) in window.rows.into_iter().enumerate() {
            while cells != 0 {
                window.slots[row * WINDOW as usize + cells.trailing_zeros() as usize] = count;
                count += 1;
                cells &= cells - 1;
            }
        }
        window.cells.resize(found.len(), Neighbour::default());
        for (slot, index, evidence, number) in found {
            let cell = evidence.cells.get(number);
            window.cells[usize::from(window.slots[slot])] = Neighbour {
                at: cell.returns_at(index, grid.resolution),
                seen_from: cell.visible.range.middle(),
                weight: f64::from(cell.returns.occupancy.min(WEIGHT)),
                weight_of_returns: f64::from(cell.returns.hits).sqrt(),
                was_crossed: cell.returns.was_crossed,
                is_solid: is_solid(&cell, &grid.settings),
                glints: cell.returns.glints > 0,
            };
        }
        window
    }

    /// What a surface through a cell may be made of. `reach` takes in all cells that this depends on.
    pub fn patch(&self, index: CellIndex, cell: &Cell, reach: &mut Reach) -> Patch<'_> {
        self.reach_patch(index, reach);
        let origin = cell.returns_at(index, self.resolution);
        let seen_from = cell.visible.range.middle();
        let (sin, cos) = seen_from.rad().sin_cos();
        let view = [cos, sin];
        let mut patch = Patch { window: self, origin, seen_from, view, numbers: [0; Patch::MOST], count: 0 };
        for (first, count) in self.rows_around(index) {
            for (number, cell) in (first..).zip(&self.cells[usize::from(first)..][..count]) {
                // Without a branch: it would be guessed wrong too often.
                patch.numbers[patch.count] = number;
                patch.count += usize::from(cell.seen_from.distance(seen_from) <= units(OF_PILLAR));
            }
        }
        patch
    }

    /// Whether a cell has come with all that is around it: nearly nothing there had stood before a beam crossed it. Single cells of what
    /// stands are crossed by errors of poses.
    pub fn has_come(&self, index: CellIndex, cell: &Cell, reach: &mut Reach) -> bool {
        self.reach_patch(index, reach);
        let origin = cell.returns_at(index, self.resolution);
        let (mut came, mut all) = (0.0, 0.0);
        let rows = self.rows_around(index);
        rows.flat_map(|(first, count)| &self.cells[usize::from(first)..][..count]).for_each(|neighbour| {
            let [x, y] = [0, 1].map(|axis| neighbour.at[axis] - origin[axis]);
            if x * x + y * y <= AROUND * AROUND {
                came += f64::from(u8::from(neighbour.was_crossed)) * neighbour.weight;
                all += neighbour.weight;
            }
        });
        came > COME_AS_ONE * all
    }

    /// The line through what lies along a patch, on both sides as far as the row does not break off; `weigh` tells what each cell counts.
    fn lengthened(
        &self,
        patch: &Line,
        origin: [f64; 2],
        seen_from: Angle,
        same_view: u32,
        weigh: impl Fn(&Neighbour) -> f64,
        reach: &mut Reach,
    ) -> Option<Line> {
        if !patch.is_flat() {
            return None;
        }
        let (sin, cos) = f64::from(patch.normal).sin_cos();
        // Columns and rows of the window, in whole numbers: rounding down is a shift. 2^-40 of a cell a step is less than all else rounds.
        const ONE: f64 = (1u64 << 40) as f64;
        let whole = |cells: f64| whole(cells * ONE);
        let start = [(patch.at[0], self.origin.x), (patch.at[1], self.origin.y)]
            .map(|(at, origin)| whole(f64::from(at) / self.resolution - f64::from(origin)));
        let [across, along] = [[cos, sin], [-sin, cos]].map(|way| way.map(whole));
        let mut moments = Moments::default();
        for side in [1, -1] {
            let mut since = 0;
            let mut step = 1 - i64::from(side == 1);
            let at = |step: i64, depth: i64| {
                [0, 1].map(|axis| start[axis] + side * step * along[axis] + depth * across[axis])
            };
            let cell = |at: [i64; 2]| at.map(|at| (at >> 40) as i32);
            while step <= i64::from(MARGIN) && since <= BRIDGE {
                let mut found = false;
                let [x, y] = at(step, 0);
                for [x, y] in [[x - across[0], y - across[1]], [x, y], [x + across[0], y + across[1]]] {
                    let neighbour = self.at(cell([x, y]));
                    if let Some(neighbour) =
                        neighbour.filter(|it| it.seen_from.distance(seen_from) <= same_view)
                    {
                        moments.add(
                            [neighbour.at[0] - origin[0], neighbour.at[1] - origin[1]],
                            weigh(neighbour),
                        );
                        found = true;
                    }
                }
                since = if found { 0 } else { since + 1 };
                step += 1;
            }
            // What lies between is in the rectangle around the corners.
            for depth in [-1, 1] {
                reach.extend(cell(at(step - 1, depth)).map(|at| at.clamp(0, WINDOW - 1)));
            }
        }
        moments.line(origin)
    }

    /// The plane that a surface through a cell is part of, along this line: drawn through all that goes on along it, be it a wall that a mirror
    /// hangs on or that a pane is set in. The line through what was seen alike is off by a degree in one case of five, which is 0.3 m beside the
    /// image of what is 9 m away. `reach` takes in all cells that this depends on.
    pub fn plane(&self, index: CellIndex, cell: &Cell, line: Line, reach: &mut Reach) -> Line {
        let origin = cell.returns_at(index, self.resolution);
        let seen_from = cell.visible.range.middle();
        let weigh = |neighbour: &Neighbour| neighbour.weight_of_returns;
        let long = self.lengthened(&line, origin, seen_from, units(OF_PILLAR), weigh, reach);
        long.filter(Line::is_flat).unwrap_or(line)
    }

    /// The line that touches, in a cell, the round surface through it: one that is met squarely, in each of the cells around, from where that
    /// was seen. `reach` takes in all cells that this depends on.
    pub fn round(&self, index: CellIndex, cell: &Cell, reach: &mut Reach) -> Option<Line> {
        self.reach_patch(index, reach);
        let origin = cell.returns_at(index, self.resolution);
        let seen_from = cell.visible.range.middle();
        let normal = direction(seen_from);
        // Where each is, and how its normal is turned: on a circle, the one is so many times the other as the radius is long.
        let neighbours = || {
            let all =
                self.rows_around(index).flat_map(|(first, count)| &self.cells[usize::from(first)..][..count]);
            all.filter(|neighbour| neighbour.seen_from.distance(seen_from) <= units(BEND)).map(|neighbour| {
                let at = Vector2::from(neighbour.at) - Vector2::from(origin);
                (neighbour, at, direction(neighbour.seen_from) - normal)
            })
        };
        // The weight of those that tell a radius between two steps, and with it the sum of what they tell.
        let mut told = [[0.0; 2]; RADII.end];
        for (neighbour, at, turned) in neighbours() {
            let square = turned.norm_squared();
            if square < TURNED * TURNED {
                continue;
            }
            let radius = at.dot(&turned) / square;
            let step = (radius / RADIUS_STEP) as usize;
            if RADII.contains(&step) && at.norm_squared() - radius * radius * square <= ON_LINE * ON_LINE {
                told[step][0] += neighbour.weight;
                told[step][1] += neighbour.weight * radius;
            }
        }
        let around_steps = told.windows(2).map(|told| [0, 1].map(|number| told[0][number] + told[1][number]));
        let most = around_steps.max_by(|a, b| a[0].total_cmp(&b[0]));
        let radius = most.filter(|[weight, _]| *weight > 0.0).map(|[weight, sum]| sum / weight)?;
        let (mut on, mut off, mut square_sum, mut glints) = (0.0, 0.0, 0.0, false);
        let mut ends = [0.0f64; 2];
        for (neighbour, at, turned) in neighbours() {
            let away = at - turned * radius;
            let square = away.norm_squared();
            if square <= ON_LINE * ON_LINE {
                on += neighbour.weight;
                square_sum += neighbour.weight * square;
                glints |= neighbour.glints;
                let along = at.norm().copysign(normal.perp(&at));
                ends = [ends[0].min(along), ends[1].max(along)];
            } else if !neighbour.is_solid && neighbour.seen_from.distance(seen_from) <= units(SAME_VIEW) {
                off += neighbour.weight * one_if(away.dot(&normal).abs() <= CLUTTER);
            }
        }
        Some(Line {
            at: origin.map(|at| at as f32),
            normal: seen_from.rad() as f32,
            // Half of it is along the surface.
            rms: (square_sum / on / 2.0).sqrt() as f32,
            length: (ends[1] - ends[0]) as f32,
            share: (on / (on + off)) as f32,
            glints,
        })
    }

    /// Takes in all cells of [`Window::rows_around`].
    fn reach_patch(&self, index: CellIndex, reach: &mut Reach) {
        let [x, y] = self.inside(index);
        reach.extend([x - PATCH, y - PATCH]);
        reach.extend([x + PATCH, y + PATCH]);
    }

    /// Column and row in the window.
    fn inside(&self, index: CellIndex) -> [i32; 2] {
        [index.x - self.origin.x, index.y - self.origin.y]
    }

    /// The cell in this column and row.
    fn at(&self, [x, y]: [i32; 2]) -> Option<&Neighbour> {
        let is_inside = (0..WINDOW).contains(&x) && (0..WINDOW).contains(&y);
        let slot = if is_inside { self.slots[(y * WINDOW + x) as usize] } else { NONE };
        self.cells.get(usize::from(slot))
    }

    /// The cells around one of the tile's: of each row the number of the first, and how many they are.
    fn rows_around(&self, index: CellIndex) -> impl Iterator<Item = (u16, usize)> {
        // A tile's cells are farther from the window's border than that.
        let [left, bottom] = self.inside(index).map(|at| (at - PATCH) as usize);
        (bottom..=bottom + 2 * PATCH as usize).filter_map(move |row| {
            let cells = (self.rows[row] >> left) as u32 & ((2 << (2 * PATCH)) - 1);
            let first = || self.slots[row * WINDOW as usize + left + cells.trailing_zeros() as usize];
            (cells != 0).then(|| (first(), cells.count_ones() as usize))
        })
    }
}

/// The cells around one that were seen from about the same direction.
pub struct Patch<'a> {
    window: &'a Window,
    /// Mean place of the returns in the cell that it is around (m).
    origin: [f64; 2],
    seen_from: Angle,
    /// The same as a direction of length 1.
    view: [f64; 2],
    /// The first `count` of these.
    numbers: [u16; Patch::MOST],
    count: usize,
}

impl Patch<'_> {
    /// One more than there are cells: what does not count is written as well.
    const MOST: usize = ((2 * PATCH + 1) * (2 * PATCH + 1)) as usize + 1;

    /// These cells, and how much those count that were seen from the same direction give or take `same_view` (units of [`Angle`]): without a
    /// branch, since what counts nothing changes no sum.
    fn cells(&self, same_view: u32) -> impl Iterator<Item = (&Neighbour, f64)> {
        self.numbers[..self.count].iter().map(move |&number| {
            let cell = &self.window.cells[usize::from(number)];
            (cell, cell.weight * one_if(cell.seen_from.distance(self.seen_from) <= same_view))
        })
    }

    /// The surface through the cell, from those that were seen from the same direction, give or take `same_view` (units of [`Angle`], no more
    /// than [`OF_PILLAR`]): the patch of 0.8 m, without what lies beside its line where it is uneven, or more of it along the line as far as it stays flat. How it [compares](Patch::compared) with all else is not told
    /// yet. `reach` takes in all cells that this depends on.
    pub fn surface(&self, same_view: u32, reach: &mut Reach) -> Option<Line> {
        let patch = self.line(same_view, |_| true)?;
        let is_uneven = self.window.trims && UNEVEN.contains(&patch.rms);
        let trim = || {
            let distance = patch.distance();
            self.line(same_view, |at| distance(at) <= ON_LINE)
        };
        let trimmed = is_uneven.then(trim).flatten().filter(|line| line.length >= LEAST_TRIMMED);
        let patch = trimmed.unwrap_or(patch);
        let weigh = |neighbour: &Neighbour| neighbour.weight;
        let long = self.window.lengthened(&patch, self.origin, self.seen_from, same_view, weigh, reach);
        let long = long.filter(|long| long.is_flat() && long.length > patch.length);
        Some(long.unwrap_or(patch))
    }

    /// The line through those of the patch of which this holds.
    fn line(&self, same_view: u32, holds: impl Fn([f64; 2]) -> bool) -> Option<Line> {
        let [cos, sin] = self.view;
        let mut moments = Moments::default();
        for (cell, weight) in self.cells(same_view) {
            let to = [cell.at[0] - self.origin[0], cell.at[1] - self.origin[1]];
            let (depth, across) = (to[0] * cos + to[1] * sin, to[1] * cos - to[0] * sin);
            let is_in = depth.abs() <= PATCH_DEPTH && across.abs() <= PATCH_HALF;
            moments.add(to, weight * one_if(is_in && holds(cell.at)));
        }
        moments.line(self.origin)
    }

    /// The same line with [`Line::share`] and [`Line::glints`].
    pub fn compared(&self, line: Line) -> Line {
        let distance = line.distance();
        let (mut on, mut off, mut glints) = (0.0, 0.0, false);
        for (cell, weight) in self.cells(units(SAME_VIEW)) {
            let distance = distance(cell.at);
            let is_on = distance <= ON_LINE;
            on += weight * one_if(is_on);
            glints |= is_on && weight > 0.0 && cell.glints;
            off += weight * one_if(!is_on && distance <= CLUTTER && !cell.is_solid);
        }
        // Where its own cell is not on the line, there may be nothing at all.
        Line { share: if on > 0.0 { (on / (on + off)) as f32 } else { 0.0 }, glints, ..line }
    }
}

fn one_if(holds: bool) -> f64 {
    f64::from(u8::from(holds))
}

/// The direction of length 1 at an angle, give or take a fifth of a degree: a sine takes long.
fn direction(angle: Angle) -> Vector2<f64> {
    static DIRECTIONS: LazyLock<[Vector2<f64>; 1024]> = LazyLock::new(|| {
        std::array::from_fn(|number| {
            let (sin, cos) = Angle((number << 6 | 1 << 5) as u16).rad().sin_cos();
            Vector2::new(cos, sin)
        })
    });
    DIRECTIONS[usize::from(angle.0 >> 6)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{
        angle::AngleRange,
        cell::Returns,
        idea::Idea,
        track::{Sector, Track},
        verdict::Verdict,
        visagge::{Evidence, VisaggeSettings, place_of},
    };
    use std::{collections::BTreeMap, f64::consts::TAU};

    const CELL: f64 = 0.05;

    const TILE: TileIndex = TileIndex { x: 0, y: 0 };

    /// A map of one tile with these cells.
    fn filled(cells: impl Iterator<Item = (Returns, Track)>, without: &[Idea]) -> Visagge {
        let settings = VisaggeSettings { without: without.to_vec(), ..VisaggeSettings::default() };
        let mut grid = Visagge::new(CELL, settings);
        let tile = grid.tiles.find_or_make(TILE);
        let evidence = grid.tiles.at_mut(tile).evidence.get_or_insert_default();
        evidence.fill(cells);
        evidence.is_touched = true;
        grid
    }

    fn evidence(grid: &Visagge) -> &Evidence {
        grid.tiles.get(TILE).and_then(|tile| tile.evidence.as_deref()).expect("it was filled")
    }

    /// What is judged of the cells of half a circle of this radius (m) around (2, 2), each seen over 6 degrees about the direction that
    /// `seen_from` makes of the one from the middle (rad), and missed over 60.
    fn judged(radius: f64, seen_from: impl Fn(f64) -> f64, without: &[Idea]) -> Vec<Verdict> {
        let mut cells = BTreeMap::new();
        for step in 0..200 {
            let bearing = TAU * f64::from(step) / 400.0;
            let at = [bearing.cos(), bearing.sin()].map(|part| (2.0 + radius * part) / CELL);
            let place = at.map(|at| at as u8);
            cells.entry(place_of(place)).or_insert((place, at.map(f64::fract), seen_from(bearing)));
        }
        let cells = cells.into_values().map(|(place, inside, from)| {
            let mut returns = Returns::new(place, true);
            (returns.occupancy, returns.hits) = (20, 20);
            returns.centroid = inside.map(|at| at as f32);
            let width = |degrees: f64| units(degrees.to_radians()) as u16;
            let range = AngleRange { start: Angle::from_rad(from - 3f64.to_radians()), width: width(6.0) };
            let visible = Sector { range, ends: [1024; 2] };
            (returns, Track { visible, missed_width: width(60.0), ..Track::default() })
        });
        let mut grid = filled(cells, without);
        grid.decide();
        evidence(&grid).judgements.iter().map(|judgement| judgement.verdict).collect()
    }

    #[test]
    fn what_is_round_is_met_squarely_all_around() {
        let there = |judged: Vec<Verdict>| {
            judged.iter().filter(|verdict| verdict.is_there()).count() as f64 / judged.len() as f64
        };
        let squarely = |bearing: f64| bearing;
        for radius in [0.3, 0.45, 0.6] {
            assert!(there(judged(radius, squarely, &[])) > 0.85, "{radius}");
        }
        assert!(there(judged(0.45, squarely, &[Idea::Round])) < 0.2);
        assert_eq!(there(judged(0.12, squarely, &[])), 0.0, "a leg");
        assert!(
            there(judged(0.45, |bearing| -bearing, &[])) < 0.2,
            "somebody, from a robot that turns around him"
        );
        assert!(there(judged(0.45, |bearing| bearing + 0.5, &[])) < 0.2, "off the normal");
    }

    #[test]
    fn a_plane_is_drawn_through_the_wall_on_both_sides_of_a_pane() {
        // The normal of the plane through a pane of half a metre, askew by a hundredth, in a wall so many cells before it that is seen from
        // `off` degrees off the pane's normal; and that of the pane's line.
        let normals = |before: u8, off: f64| {
            let cells = (4..50).map(|y| {
                let is_pane = (22..32).contains(&y);
                let x = if is_pane { 30 } else { 30 - before };
                let mut returns = Returns::new([x, y], true);
                (returns.occupancy, returns.hits) = (10, if is_pane { 25 } else { 400 });
                returns.centroid = [if is_pane { 0.5 + 0.01 * (f32::from(y) - 26.5) } else { 0.5 }, 0.5];
                let seen_from = if is_pane { 180.0 } else { 180.0 + off };
                let range = AngleRange::at(Angle::from_rad(f64::to_radians(seen_from)));
                let visible = Sector { range, ends: [1024; 2] };
                (returns, Track { visible, ..Track::default() })
            });
            let grid = filled(cells, &[]);
            let window = Window::around(&grid, TILE);
            let evidence = evidence(&grid);
            let cell = evidence.cells.get(evidence.number(30, 24).expect("it was filled"));
            let mut reach = Reach::at(cell.returns.place);
            let index = cell.index(TILE);
            let line = window.patch(index, &cell, &mut reach).surface(units(OF_PLANE), &mut reach);
            let line = line.expect("there is one");
            [window.plane(index, &cell, line, &mut reach), line].map(|line| line.off_normal(PI))
        };
        let [plane, line] = normals(0, 10.0);
        assert!((line - 0.01).abs() < 0.001, "{line}");
        assert!(plane < 0.003, "{plane}");
        for alone in [normals(0, 25.0), normals(4, 10.0)] {
            assert!((alone[0] - alone[1]).abs() < 0.001, "{alone:?}");
        }
    }

    /// The line through a row of cells along y and, as far to the right of every third one, others; all seen from the left.
    fn through_row_and(beside: i32, without: &[Idea]) -> Line {
        let row = (20..34).map(|y| [30, y]);
        let others = (20..34).step_by(3).map(|y| [30 + beside, y]);
        let cells = row.chain(others).map(|[x, y]| {
            let mut returns = Returns::new([x as u8, y as u8], true);
            returns.occupancy = 10;
            let visible = Sector { range: AngleRange::at(Angle::from_rad(PI)), ends: [1024; 2] };
            (returns, Track { visible, ..Track::default() })
        });
        let grid = filled(cells, without);
        let window = Window::around(&grid, TILE);
        let cell = evidence(&grid).cells.get(7);
        let mut reach = Reach::at(cell.returns.place);
        let patch = window.patch(cell.index(TILE), &cell, &mut reach);
        patch.surface(units(OF_PLANE), &mut reach).expect("there are cells")
    }

    #[test]
    fn what_is_right_behind_a_surface_is_left_out_of_it() {
        let trimmed = through_row_and(2, &[]);
        assert!(trimmed.rms < 0.001 && (trimmed.at[0] - 1.5).abs() < 0.03, "{trimmed:?}");
        let untrimmed = through_row_and(2, &[Idea::Trimmed]);
        assert!(untrimmed.rms > 0.035, "{untrimmed:?}");
    }
}
