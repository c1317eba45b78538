//! Which cells with evidence are shown as occupied, and why.
//!
//! The core algorithm needs two passes to tell a pane of glass from someone who walked by: both are seen for a moment, from a narrow
//! range of angles. The verdict tells them apart after one. What was hardly ever missed is solid. What was missed must be explained
//! as a surface that is visible near its normal only: the neighbouring cells must form a flat patch whose normal is the direction
//! from which they were seen, with nothing else seen from there right before or behind it (paper IV-C gives the reason, and a weaker
//! test), or a piece of a circle that was met squarely in each of them, or a long straight line that was seen often and may be no image; or
//! they have glinted, where the scanner tells intensities; or it was seen so often, for so long and from so many directions that it is there
//! whatever missed it. What was solid and is missed to the end has been taken away; what has come as a
//! whole and is no larger than a person may be one who waits. What is the image of something else in a mapped surface, or is seen through a wall, is not there at all. And of what is
//! left, a surface is drawn one cell thick, but a pane before a wall and a thin wall's other face are drawn too.
//!
//! [`Idea`] names these and the further ones, each of which can be left out to see what it is worth.

use super::{
    angle::units,
    cell::{Cell, Returns},
    idea::Idea,
    judge::Shape,
    mirrors::{Mirror, Plane, Rows},
    squares::{CellsAround, Reach},
    surface::{Line, OF_PILLAR, OF_PLANE, Window},
    tiles::{CellIndex, TileIndex},
    visagge::{Evidence, Visagge, VisaggeSettings},
};
use std::f64::consts::{FRAC_PI_2, SQRT_2};

/// Why a cell with evidence is shown, or not. The number is the value of layer `verdict` in map.npz.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Verdict {
    /// Not judged yet.
    #[default]
    None = 0,
    /// Shown: seen whenever it could be, or nearly so, and not missed ever since.
    Solid = 1,
    /// Shown: part of a flat surface that is visible near its normal.
    Surface = 2,
    /// Shown: seen again from known angles after it had been missed.
    Repeated = 3,
    /// Shown: few returns, or no surface by themselves, but in a gap of what is shown on both sides.
    Bridged = 4,
    /// Shown: part of a long straight surface that was seen off its normal, but often.
    Oblique = 5,
    /// Shown: seen often, for long and from many directions, though it was missed in between.
    Lasting = 6,
    /// Not shown: too few returns, or too few cells.
    TooFew = 10,
    /// Not shown: missed, and part of no surface that could explain why. Somebody passed, or something was taken away.
    NoSurface = 11,
    /// Not shown: the image, in a mapped surface, of something else or of the robot.
    Image = 12,
    /// Not shown: right before or behind a cell of the same surface that got clearly more returns, or in the corner of a diagonal line.
    Beside = 13,
}

impl Verdict {
    /// Whether the cell is shown as occupied.
    pub fn is_shown(self) -> bool {
        (Verdict::Solid as u8..Verdict::TooFew as u8).contains(&(self as u8))
    }

    /// Whether returns in it come from something that stands there, though it may be drawn in a cell beside.
    pub fn is_there(self) -> bool {
        self.is_shown() || self == Verdict::Beside
    }
}

/// Occupancy below which a cell is a random reading: they come once in a thousand beams (paper III-B). But not if that was a glint and lies on
/// a broad surface: a robot that passes a pane within half a metre, at 1 m/s, meets each cell of it in one scan, or in none.
const LEAST_HITS: u8 = 2;
/// Least length of a surface (m): two legs of 12 cm side by side.
const LEAST_LENGTH: f32 = 0.3;
/// The same where none of it has glinted though glints could be told (m): nearly all panes glint where they are met at their normal,
/// and nobody's legs do. But panes that lean by a degree don't either, and nobody is broader than that, or [stays](STAYING) that long.
const LEAST_DULL: f32 = 0.5;
/// Least share of what was seen from there, somewhat before and behind it, that lies on a surface. Before a pane there is
/// nothing, and behind it seldom anything as near; a person's legs swing to and fro.
const LEAST_SHARE: f32 = 0.85;
/// Most that the normal may lie off the middle of the view angles, and outside of them (rad): 8 and 5 degrees. Glass is seen within
/// 1 to 2 degrees of its normal where something stands behind it (paper, Fig. 7), and the line through 0.3 m with a spread of
/// 2 cm is uncertain by 4 degrees.
const OFF_SHORT: [f64; 2] = [0.14, 0.087];
/// The same for surfaces too long and straight to be anybody's legs: 21 and 15 degrees. Dust is seen over tens of degrees
/// (paper, Fig. 6) on both sides of the normal, where the robot's own image and what is behind outshine it.
const OFF_LONG: [f64; 2] = [0.36, 0.26];
/// What glints is seen over no more than this (rad), 29 degrees on either side of its normal: dust is seen over tens of degrees (paper, Fig. 6),
/// and polished metal over about as many.
const GLINTING: f64 = 1.0;
/// A surface is long from here on (m): what somebody walks in a second.
const LONG: f32 = 1.2;
/// And straight up to this spread (m): ranges and poses alone.
const STRAIGHT: f32 = 0.02;

/// What is long and straight is a surface wherever it was seen from, if it was seen in at least so many scans: metal that is met off its
/// normal only, which images of what is brighter outshine from elsewhere. A quarter of a second of a UTM-30LX, in which whoever walks by has
/// moved on by his own width.
const OFTEN: u16 = 10;

/// Something is seen through a surface, or in it, that was missed over at least this range (rad): 1 degree. Less is a
/// wall at grazing incidence.
pub(super) const SEEN_THROUGH: f64 = 0.02;
/// What is shown on both sides of a gap must begin within this many cells: a quarter of a metre, less than half a
/// door or a person's width.
const GAP: i32 = 5;
/// What a beam has crossed before it was first seen, or gone past without return, has come, or is seen from some directions only. It is
/// solid if it was seen over at least this range (rad), 10 degrees: a leg takes 0.3 s to cross a cell, and at 1 m/s a
/// sensor 2 m away moves by 9 degrees meanwhile.
const WIDE: f64 = 0.17;
/// Or if its returns came over at least this time (s): nobody who walks stays in a cell for a second.
pub(super) const LASTING: f32 = 1.0;
/// What has come as a whole may be somebody who waits, for whom half a minute (s) is long. What has been put down and stays will be seen again.
const STAYING: f32 = 30.0;
/// But not if it is flat and as long as this (m): nobody is as wide.
const LARGE: f32 = 0.7;
/// What was solid has been taken away if it was missed over this range (rad) and never seen again: 3 degrees, the error of a view
/// angle at 1 m.
const GONE: f64 = 0.05;
/// Brightness from which on what is seen over [more](GLINTING) than glass is cannot be its dust, which falls off with the power of 1.5 of the
/// angle: a sixth of the brightest that is diffuse, dark cloth (octaves).
const DIFFUSE: f64 = -2.5;
/// Scans in which nobody who walks by is seen in a cell, nor eight of them one after the other: each takes 0.3 s, 12 scans of a UTM-30LX.
const MANY: u16 = 100;
/// Incidence from which on a wall that is still there may return nothing (rad): 75 degrees, where some return three times in ten.
const GRAZING: f64 = 1.31;
/// A cell is drawn unless one right before or behind it got so many times its returns. Where a wall's face runs along the border of two
/// cells, both get the same, give or take a few.
const OUTWEIGHS: f32 = 1.33;
/// A pane right before a wall glints in at least this share of its scans, since the wall outshines what else of it could be seen ..
const SHINES: f32 = 0.125;
/// .. and in so many times the share that the cells behind it do, in which the wall's returns merge with glints: the scanner does not tell
/// apart what is within some 12 cm.
const OUTSHINES: f32 = 4.0;

/// Columns of a tile of which the two before and behind are in it as well.
const INNER: u64 = u64::MAX << 2 & u64::MAX >> 2;

/// Whether two neighbouring cells that are `shown` by themselves lie near on both sides, along a row, a column or a diagonal.
pub(super) fn is_in_gap(cell: [u8; 2], shown: &CellsAround) -> bool {
    [(1, 0), (0, 1), (1, 1), (1, -1)].into_iter().any(|(x, y)| {
        [1, -1].into_iter().all(|side| {
            let shown = |step: i32| shown.has(cell, [x * side * step, y * side * step]);
            (1..GAP).any(|step| shown(step) && shown(step + 1))
        })
    })
}

/// Whether none of the cells around, up to three columns and rows away, is `shown` by itself: of 0.3 m of a surface, which is the
/// [least](LEAST_LENGTH), others are.
pub(super) fn is_alone(cell: [u8; 2], shown: &CellsAround) -> bool {
    shown.near(cell).iter().map(|cells| cells.count_ones()).sum::<u32>() <= 1
}

/// Those of a tile's cells at which a diagonal line goes round a corner that it could cut: the cells before and behind touch each other, and
/// the line leads on from both. A line of such cells is two cells thick, both of which got as many returns. Not where the next tile's
/// cells would have to be known.
pub(super) fn corners(shown: &Rows) -> Rows {
    let at = |row: usize| shown.get(row).copied().unwrap_or(u64::MAX);
    std::array::from_fn(|row| {
        let here = shown[row];
        let [south2, south, north, north2] =
            [row.wrapping_sub(2), row.wrapping_sub(1), row + 1, row + 2].map(at);
        let leads = |to: u64, beyond: u64, away: u64| to & !(to << 1) & !beyond & !away;
        let turns = leads(north, north2, south) | leads(south, south2, north);
        here & here << 1 & !(here << 2) & !(here >> 1) & turns & INNER
    })
}

/// The step from a cell to the one behind it: across the row, column or diagonal in which most of its neighbours are `shown`. It is
/// not the direction of view, which runs along a wall at grazing incidence; only of rows alike, it says which.
fn across(cell: &Cell, shown: &CellsAround) -> (i32, i32) {
    let near = shown.near(cell.returns.place);
    let rows = [(1, 0, 1.0), (1, 1, SQRT_2), (0, 1, 1.0), (-1, 1, SQRT_2)].map(|(x, y, length)| {
        let count = [-3, -2, -1, 1, 2, 3].map(|step| near[(3 + y * step) as usize] >> (3 + x * step) & 1);
        let count: u8 = count.into_iter().sum();
        (count, (x, y, length))
    });
    let most = rows.iter().map(|(count, _)| *count).max().unwrap_or_default();
    let mut alike = rows.into_iter().filter(|(count, _)| *count == most);
    let (x, y) = match (alike.next(), alike.next()) {
        (Some((_, (x, y, _))), None) => (x, y),
        _ => {
            let (sin, cos) = cell.visible.range.middle().rad().sin_cos();
            let across_view = |(_, (x, y, length)): &(u8, (i32, i32, f64))| {
                let along = f64::from(*x) * cos + f64::from(*y) * sin;
                f64::from(most) + (1.0 - (along / length).abs()).min(0.999)
            };
            let alike = rows.into_iter().filter(|(count, _)| *count == most);
            let most = alike.max_by(|a, b| across_view(a).total_cmp(&across_view(b)));
            most.map(|(_, (x, y, _))| (x, y)).expect("there are two")
        }
    };
    (-y, x)
}

/// Whether a cell glints as a pane does that stands right before what the other one is part of, which does not.
fn is_pane_before(pane: &Returns, other: &Returns) -> bool {
    let share = |of: &Returns| f32::from(of.glints) / f32::from(of.hits);
    pane.has_glinted() && pane.glints > other.glints && share(pane) >= SHINES.max(OUTSHINES * share(other))
}

impl Visagge {
    /// Whether a cell of the same surface that is shown, right before or behind the one with this number in a tile, got clearly more
    /// returns. What is seen from the other side, two cells away, is the other face of a thin wall.
    pub(super) fn is_outweighed(
        &self,
        (tile, evidence): (TileIndex, &Evidence),
        number: usize,
        shown: &CellsAround,
    ) -> bool {
        let (cell, judgement) = (evidence.cells.get(number), &evidence.judgements[number]);
        let index = cell.index(tile);
        let (x, y) = across(&cell, shown);
        [-2, -1, 1, 2].into_iter().any(|steps| {
            let (place, column, row) = CellIndex { x: index.x + steps * x, y: index.y + steps * y }.split();
            let evidence = if place == tile {
                Some(evidence)
            } else {
                self.tiles.get(place).and_then(|tile| tile.evidence.as_deref())
            };
            let found = evidence.and_then(|evidence| Some((evidence, evidence.number(column, row)?)));
            found.is_some_and(|(evidence, number)| {
                let (other, judged) = (&evidence.cells.returns[number], &evidence.judgements[number]);
                let (more, less) = (f32::from(other.hits), f32::from(cell.returns.hits));
                // Two standard deviations of counts. A pane has few returns, and nothing stands right behind it that would be lost.
                let is_certain = (more - less).powi(2) > 4.0 * (more + less);
                let is_pane = || self.settings.has(Idea::Panes) && is_pane_before(&cell.returns, other);
                let is_face = || {
                    let off =
                        |other: Cell| other.visible.range.middle().distance(cell.visible.range.middle());
                    steps.abs() == 2
                        && self.settings.has(Idea::Faces)
                        && off(evidence.cells.get(number)) > units(FRAC_PI_2)
                };
                judged.unthinned.is_shown()
                    && more > OUTWEIGHS * less
                    && (is_certain || judgement.unthinned != Verdict::Solid)
                    && !is_pane()
                    && !is_face()
            })
        })
    }

    /// What the shape of a cell's neighbourhood says of it, in the window around its tile.
    pub(super) fn judge_shape<'a>(
        &self,
        index: CellIndex,
        cell: &Cell,
        window: impl Fn() -> &'a Window,
    ) -> Shape {
        let settings = &self.settings;
        // Of what is shown in any case and nothing is seen through, the surface does not matter.
        let alone = shape(cell, None, false, settings);
        let is_seen_through = is_seen_through(cell, alone, settings);
        let mut reach = Reach::at(cell.returns.place);
        let may_go = alone == Verdict::Solid && cell.returns.was_crossed && cell.lasted() < STAYING;
        let has_come = may_go && settings.has(Idea::Visitors) && window().has_come(index, cell, &mut reach);
        let is_single = cell.returns.occupancy < LEAST_HITS;
        let matters = if is_single {
            cell.returns.glints > 0 && settings.has(Idea::Singles)
        } else {
            !alone.is_shown() || is_seen_through || has_come
        };
        let line = if matters {
            let patch = window().patch(index, cell, &mut reach);
            let surface = |same_view: u32, reach: &mut Reach| {
                let line = patch.surface(same_view, reach)?;
                // Where all else speaks against it already, what is on it does not matter.
                let at_best = Line { share: 1.0, glints: true, ..line };
                let matters = explains(&at_best, cell, settings) || is_oblique(&at_best, cell, settings);
                Some(if matters { patch.compared(line) } else { line })
            };
            if alone == Verdict::Solid && !has_come {
                // It needs no explanation, only a surface that something else may be seen in.
                patch.surface(units(OF_PILLAR), &mut reach)
            } else {
                let plane = surface(units(OF_PLANE), &mut reach);
                plane
                    .filter(|line| explains(line, cell, settings) && settings.has(Idea::PlanesFirst))
                    .or_else(|| surface(units(OF_PILLAR), &mut reach))
            }
        } else {
            None
        };
        // What is round is flat where it was met squarely, but too short.
        let may_be_round = |line: &Line| {
            let off = line.off_normal(cell.visible.range.middle().rad());
            line.is_flat() && off <= OFF_LONG[0] && !explains(line, cell, settings)
        };
        let is_sought =
            !alone.is_shown() && settings.has(Idea::Round) && line.as_ref().is_some_and(may_be_round);
        let round = is_sought.then(|| window().round(index, cell, &mut reach)).flatten();
        let round = round.filter(|line| explains(line, cell, settings));
        let verdict = shape(cell, round.as_ref().or(line.as_ref()), has_come, settings);
        // What is seen in something round is elsewhere; and of what no surface explains, the plane is not known well enough.
        let is_unexplained = matches!(verdict, Verdict::Oblique | Verdict::Lasting);
        let may_show = verdict.is_shown() && !is_unexplained && round.is_none();
        let mirror =
            line.filter(|line| may_show && is_seen_through && !is_single && line.is_flat()).map(|line| {
                let is_long = settings.has(Idea::LongPlanes);
                let line = if is_long { window().plane(index, cell, line, &mut reach) } else { line };
                let plane = Plane::new(&line, index.middle(self.resolution));
                Mirror { plane, visible: cell.visible.range }
            });
        Shape { verdict, mirror, reach }
    }
}

/// Whether the cell returned whenever it could, or nearly so.
pub(super) fn is_solid(cell: &Cell, settings: &VisaggeSettings) -> bool {
    let width = u32::from(cell.visible.range.width);
    let was_passed = cell.returns.was_passed && settings.has(Idea::Silences);
    width >= 2 * u32::from(cell.missed_width)
        && (!(cell.returns.was_crossed || was_passed)
            || width >= units(WIDE)
            || cell.lasted() >= LASTING
            || !settings.has(Idea::Newcomers))
}

/// Whether something may be seen through the cell, or in it. `alone` tells what it is by itself: what is solid though a beam had crossed it
/// before it was first seen may be a door that was shut since, but also dust or metal, which was met farther off its normal first, from
/// where nothing came back that would tell of a miss.
fn is_seen_through(cell: &Cell, alone: Verdict, settings: &VisaggeSettings) -> bool {
    let returns = &cell.returns;
    let was_missed = u32::from(cell.missed_width) >= units(SEEN_THROUGH);
    let may_show = || returns.glints_often() || returns.was_crossed && alone == Verdict::Solid;
    was_missed || may_show() && settings.has(Idea::Unmissed)
}

/// Whether a surface along this line would be seen from where the cell was seen, and hardly from elsewhere.
fn explains(line: &Line, cell: &Cell, settings: &VisaggeSettings) -> bool {
    let off = line.off_normal(cell.visible.range.middle().rad());
    let beyond = off - cell.visible.range.width_rad() / 2.0;
    let is_long = line.length >= LONG && line.rms <= STRAIGHT && settings.has(Idea::LongSurfaces);
    let [most, most_beyond] = if is_long { OFF_LONG } else { OFF_SHORT };
    let may_be_somebody = cell.returns.is_brightness_known() && !line.glints && cell.lasted() < STAYING;
    let is_dull = may_be_somebody && settings.has(Idea::Dull);
    line.length >= if is_dull { LEAST_DULL } else { LEAST_LENGTH }
        && line.is_flat()
        && (line.share >= LEAST_SHARE || !settings.has(Idea::Clutter))
        && off <= most
        && beyond <= most_beyond
}

/// Whether the cell is part of a surface along this line, which was seen from where nothing need be seen of it. What was solid and is gone
/// is not.
fn is_oblique(line: &Line, cell: &Cell, settings: &VisaggeSettings) -> bool {
    settings.has(Idea::Oblique)
        && line.length >= LONG
        && line.rms <= STRAIGHT
        && line.share >= LEAST_SHARE
        && line.off_normal(cell.visible.range.middle().rad()) <= GRAZING
        && cell.returns.hits >= OFTEN
        && !is_solid(cell, settings)
}

/// Whether the cell is of a surface that was seen about its normal, by its glints alone. What was solid, or was seen over more than
/// dust shows of glass, would have been seen from where it was missed as well.
fn glints(cell: &Cell, settings: &VisaggeSettings) -> bool {
    cell.returns.has_glinted() && !is_solid(cell, settings) && cell.visible.range.width_rad() <= GLINTING
}

/// Whether the cell is where the robot itself has been, so that somebody must have come, or something that is known by its glints or by how
/// long it has stayed: a door that was shut.
pub(super) fn is_in_the_way(cell: &Cell, settings: &VisaggeSettings) -> bool {
    cell.returns.was_driven
        && !cell.returns.has_glinted()
        && cell.lasted() < STAYING
        && settings.has(Idea::Driven)
}

/// Whether the cell was missed to the end, and not for being looked at along the surface through it.
fn is_gone(cell: &Cell, line: Option<&Line>, settings: &VisaggeSettings) -> bool {
    let missed = &cell.missed_since;
    // All of it but less than what tells that it is gone.
    let is_along =
        |line: &Line| line.off_normal(missed.middle().rad()) - missed.width_rad() / 2.0 + GONE > GRAZING;
    let is_grazing = line.is_some_and(|line| line.is_flat() && line.length >= LEAST_LENGTH && is_along(line));
    u32::from(missed.width) >= units(GONE) && !is_grazing && settings.has(Idea::TakenAway)
}

/// Whether the cell is of something diffuse, which returns wherever it is looked at from: what could have glinted and has not, is seen over
/// more than glass and too bright for dust.
fn is_diffuse(cell: &Cell, settings: &VisaggeSettings) -> bool {
    let is_bright = cell.brightness().is_some_and(|brightness| brightness >= DIFFUSE);
    is_bright
        && !cell.returns.has_glinted()
        && cell.visible.range.width_rad() > GLINTING
        && settings.has(Idea::Diffuse)
}

/// Whether the cell was seen for so long, so often and from so many directions that it is there whatever made scans miss it in between: an
/// image in a mirror before it, or glass.
fn is_lasting(cell: &Cell, settings: &VisaggeSettings) -> bool {
    cell.returns.hits >= MANY
        && cell.lasted() >= STAYING
        && u32::from(cell.visible.range.width) >= units(WIDE)
        && settings.has(Idea::Lasting)
}

/// Whether nothing is seen through the cell, which is solid: it was not crossed before it was first seen, and it is seen from so many
/// directions that it is no glass with nothing behind. It may have been missed over a few: an image behind it misses it.
///
/// `visible` and `missed` are the widths of its ranges.
pub(super) fn is_wall(returns: &Returns, [visible, missed]: [u16; 2]) -> bool {
    !returns.was_crossed && u32::from(visible) >= units(WIDE).max(4 * u32::from(missed))
}

/// `has_come`: with all around it, and it may go again.
fn shape(cell: &Cell, line: Option<&Line>, has_come: bool, settings: &VisaggeSettings) -> Verdict {
    if cell.returns.occupancy < LEAST_HITS {
        let is_broad = |line: &Line| line.length >= LEAST_DULL && explains(line, cell, settings);
        let is_glint = cell.returns.glints > 0 && line.is_some_and(is_broad);
        return if is_glint { Verdict::Surface } else { Verdict::TooFew };
    }
    if is_in_the_way(cell, settings) {
        return Verdict::NoSurface;
    }
    let is_large = || line.is_some_and(|line| line.is_flat() && line.length >= LARGE);
    let is_gone = || is_gone(cell, line, settings);
    if is_solid(cell, settings) && !is_gone() && (!has_come || is_large()) {
        return Verdict::Solid;
    }
    if cell.returns.passes > 0 {
        return Verdict::Repeated;
    }
    if is_diffuse(cell, settings) && is_gone() {
        return Verdict::NoSurface;
    }
    let is_explained = line.is_some_and(|line| explains(line, cell, settings)) || glints(cell, settings);
    if is_explained || !settings.has(Idea::Surfaces) {
        Verdict::Surface
    } else if line.is_some_and(|line| is_oblique(line, cell, settings)) {
        Verdict::Oblique
    } else if is_lasting(cell, settings) && !is_gone() {
        Verdict::Lasting
    } else {
        Verdict::NoSurface
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{
        angle::{Angle, AngleRange},
        cell::UNKNOWN,
        tiles::{SIDE, TileIndex},
        track::{Sector, Track},
        visagge::VisaggeSettings,
    };

    #[test]
    fn a_pane_is_flat_alone_and_seen_about_its_normal() {
        let settings = VisaggeSettings::default();
        let explains = |line: &Line, cell: &Cell| explains(line, cell, &settings);
        let pane = Line { at: [0.0; 2], normal: 0.0, rms: 0.012, length: 0.6, share: 1.0, glints: false };
        let seen = |from: f64, to: f64| {
            let mut cell = Cell::of(&Returns::new([0, 0], true), &Track::default());
            let start = Angle::from_rad(from.to_radians());
            cell.visible.range = AngleRange { start, width: units((to - from).to_radians()) as u16 };
            cell
        };
        assert!(explains(&pane, &seen(-1.0, 1.0)));
        assert!(explains(&pane, &seen(179.0, 182.0)), "from behind");
        assert!(explains(&Line { rms: 0.03, ..pane }, &seen(3.0, 5.0)));
        assert!(!explains(&pane, &seen(6.0, 7.0)), "somebody who walks by");
        assert!(explains(&pane, &seen(-2.0, 16.0)), "dust, to one side");
        assert!(!explains(&pane, &seen(-2.0, 40.0)), "a wall beside");
        let front = Line { length: 2.0, ..pane };
        assert!(explains(&front, &seen(8.0, 20.0)), "dust, where the robot's image outshines the glint");
        assert!(!explains(&Line { rms: 0.03, ..front }, &seen(8.0, 20.0)));
        assert!(!explains(&front, &seen(17.0, 20.0)));
        assert!(!explains(&Line { share: 0.8, ..pane }, &seen(-1.0, 1.0)), "two legs");
        assert!(!explains(&Line { length: 0.25, ..pane }, &seen(-1.0, 1.0)), "one leg");
        assert!(!explains(&Line { rms: 0.05, ..pane }, &seen(-1.0, 1.0)), "a bag");
    }

    #[test]
    fn what_is_long_straight_and_seen_often_need_not_be_met_about_its_normal() {
        let metal = Line { at: [0.0; 2], normal: 0.0, rms: 0.012, length: 1.5, share: 1.0, glints: false };
        let judged = |line: &Line, from: f64, hits: u16, missed: f64| {
            let returns = Returns { hits, occupancy: hits as u8, ..Returns::new([0, 0], false) };
            let mut cell = Cell::of(&returns, &Track::default());
            let at = |degrees: f64| Angle::from_rad(degrees.to_radians());
            cell.visible.range = AngleRange { start: at(from), width: units(0.1) as u16 };
            cell.missed_since = AngleRange { start: at(-60.0), width: units(0.2) as u16 };
            cell.missed_width = units(missed) as u16;
            shape(&cell, Some(line), false, &VisaggeSettings::default())
        };
        assert_eq!(judged(&metal, 40.0, 20, 0.2), Verdict::Oblique);
        assert_eq!(judged(&metal, 40.0, 9, 0.2), Verdict::NoSurface, "for an instant");
        assert_eq!(judged(&metal, 80.0, 20, 0.2), Verdict::NoSurface, "along it");
        assert_eq!(judged(&metal, 40.0, 20, 0.04), Verdict::NoSurface, "taken away");
        assert_eq!(judged(&Line { length: 1.0, ..metal }, 40.0, 20, 0.2), Verdict::NoSurface);
        assert_eq!(
            judged(&Line { rms: 0.03, ..metal }, 40.0, 20, 0.2),
            Verdict::NoSurface,
            "a row of people"
        );
        assert_eq!(judged(&Line { share: 0.8, ..metal }, 40.0, 20, 0.2), Verdict::NoSurface, "in clutter");
        assert_eq!(judged(&metal, -2.0, 20, 0.2), Verdict::Surface);
    }

    #[test]
    fn what_could_have_glinted_and_has_not_is_broader_than_anybody() {
        let judged = |length: f32, was_told: bool, glints: bool, lasted: f32| {
            let line = Line { at: [0.0; 2], normal: 0.0, rms: 0.012, length, share: 1.0, glints };
            let brightness = if was_told { 0 } else { UNKNOWN };
            let returns = Returns { brightness, hit_time: [5.0, 5.0 + lasted], ..Returns::new([0, 0], true) };
            explains(&line, &Cell::of(&returns, &Track::default()), &VisaggeSettings::default())
        };
        let is_surface = |length, was_told, glints| judged(length, was_told, glints, 3.0);
        assert!(!is_surface(0.4, true, false), "somebody's legs");
        assert!(judged(0.4, true, false, 60.0), "a pane that leans, passed again");
        assert!(is_surface(0.4, true, true));
        assert!(is_surface(0.4, false, false), "without intensities");
        assert!(is_surface(0.6, true, false), "a pane that leans");
    }

    #[test]
    fn what_was_missed_or_glints_or_had_been_crossed_may_show_something_else() {
        let shows = |missed: f64, glints: u8, hits: u16| {
            let mut cell =
                Cell::of(&Returns { glints, hits, ..Returns::new([0, 0], false) }, &Track::default());
            cell.missed_width = units(missed.to_radians()) as u16;
            is_seen_through(&cell, Verdict::Solid, &VisaggeSettings::default())
        };
        assert!(!shows(0.0, 0, 900));
        assert!(shows(3.0, 0, 900));
        assert!(shows(0.0, 2, 60), "glass that was met at its normal first");
        assert!(!shows(0.0, 2, 900), "random readings");
        assert!(shows(0.0, u8::MAX, u16::MAX), "as many as are counted");
        let was_crossed = Cell::of(&Returns::new([0, 0], true), &Track::default());
        let shows = |alone: Verdict| is_seen_through(&was_crossed, alone, &VisaggeSettings::default());
        assert!(shows(Verdict::Solid), "metal that a beam off its normal had crossed");
        assert!(!shows(Verdict::NoSurface), "somebody");
    }

    #[test]
    fn who_has_come_out_of_silence_is_solid_once_he_was_seen_for_longer() {
        let is_solid = |was_passed: bool, lasted: f32| {
            let mut returns = Returns { was_passed, ..Returns::new([0, 0], false) };
            returns.hit_time = [0.0, lasted];
            is_solid(&Cell::of(&returns, &Track::default()), &VisaggeSettings::default())
        };
        assert!(is_solid(false, 0.2));
        assert!(!is_solid(true, 0.2));
        assert!(is_solid(true, 1.2));
    }

    #[test]
    fn where_the_robot_has_been_somebody_has_come_unless_it_is_a_door() {
        let line = Line { at: [0.0; 2], normal: 0.0, rms: 0.012, length: 2.0, share: 1.0, glints: true };
        let judged = |was_driven: bool, glints: u8, lasted: f32| {
            let hit_time = [5.0, 5.0 + lasted];
            let returns = Returns {
                was_driven,
                glints,
                hit_time,
                occupancy: 9,
                hits: 90,
                ..Returns::new([0, 0], true)
            };
            shape(&Cell::of(&returns, &Track::default()), Some(&line), false, &VisaggeSettings::default())
        };
        assert!(judged(false, 0, 3.0).is_shown());
        assert_eq!(judged(true, 0, 3.0), Verdict::NoSurface);
        assert!(judged(true, 2, 3.0).is_shown(), "a door of glass, shut since");
        assert!(judged(true, 0, 40.0).is_shown(), "a door of wood");
    }

    #[test]
    fn what_is_missed_to_the_end_where_it_would_return_has_gone() {
        let box_ = Line { at: [0.0; 2], normal: 0.0, rms: 0.012, length: 0.6, share: 1.0, glints: false };
        let judged = |line: &Line, from: f64, to: f64, seen_again: bool| {
            let mut cell = Cell::of(&Returns::new([0, 0], false), &Track::default());
            cell.returns.occupancy = 9;
            cell.visible.range = AngleRange { start: Angle(0), width: units(1.0) as u16 };
            let start = Angle::from_rad(from.to_radians());
            let range = AngleRange { start, width: units((to - from).to_radians()) as u16 };
            cell.missed_width = range.width;
            cell.missed_since = if seen_again { AngleRange::default() } else { range };
            shape(&cell, Some(line), false, &VisaggeSettings::default())
        };
        let missed = |from: f64, seen_again: bool| judged(&box_, from, from + 5.0, seen_again);
        assert_eq!(missed(-50.0, false), Verdict::NoSurface);
        assert_eq!(missed(-50.0, true), Verdict::Solid);
        assert_eq!(missed(-85.0, false), Verdict::Solid, "along its face");
        let somebody = Line { rms: 0.06, ..box_ };
        assert_eq!(judged(&somebody, -85.0, -80.0, false), Verdict::NoSurface, "who has no face");
        assert_eq!(judged(&box_, -88.0, -66.0, false), Verdict::NoSurface, "not all of it along its face");
    }

    #[test]
    fn what_is_seen_over_more_than_glass_and_too_bright_for_dust_has_gone_when_it_is_missed() {
        let front = Line { at: [0.0; 2], normal: 0.0, rms: 0.012, length: 0.9, share: 1.0, glints: false };
        let judged = |degrees: f64, octaves: Option<f32>, glints: u8, seen_again: bool| {
            let returns = Returns { occupancy: 9, hits: 60, glints, ..Returns::new([0, 0], true) };
            let mut cell = Cell::of(&returns, &Track::default());
            if let Some(octaves) = octaves {
                cell.returns.record_brightness(octaves);
            }
            let at = |degrees: f64| Angle::from_rad(degrees.to_radians());
            let width = |degrees: f64| units(degrees.to_radians()) as u16;
            cell.visible.range = AngleRange { start: at(-degrees / 2.0), width: width(degrees) };
            cell.missed_width = width(70.0);
            let missed = AngleRange { start: at(-60.0), width: width(9.0) };
            cell.missed_since = if seen_again { AngleRange::default() } else { missed };
            shape(&cell, Some(&front), false, &VisaggeSettings::default())
        };
        assert_eq!(judged(60.0, Some(-2.4), 0, false), Verdict::NoSurface, "the side of a cart");
        assert_eq!(judged(60.0, Some(-2.0), 0, true), Verdict::Surface, "seen again");
        assert_eq!(judged(40.0, Some(-2.0), 0, false), Verdict::Surface, "of a pane");
        assert_eq!(judged(60.0, Some(-2.6), 0, false), Verdict::Surface, "dust");
        assert_eq!(judged(60.0, Some(-2.0), 2, false), Verdict::Surface, "metal");
        assert_eq!(judged(60.0, None, 0, false), Verdict::Surface, "without intensities");
    }

    #[test]
    fn what_was_seen_often_for_long_and_from_many_directions_is_there() {
        let judged = |hits: u16, lasted: f32, degrees: f64, missed_since: f64| {
            let returns =
                Returns { occupancy: 30, hits, hit_time: [0.0, lasted], ..Returns::new([0, 0], true) };
            let mut cell = Cell::of(&returns, &Track::default());
            let width = |degrees: f64| units(degrees.to_radians()) as u16;
            cell.visible.range.width = width(degrees);
            cell.missed_width = width(20.0);
            cell.missed_since = AngleRange { start: Angle::from_rad(1.0), width: width(missed_since) };
            shape(&cell, None, false, &VisaggeSettings::default())
        };
        assert_eq!(judged(100, 40.0, 12.0, 1.0), Verdict::Lasting, "a wall behind a mirror's images");
        assert_eq!(judged(90, 40.0, 12.0, 1.0), Verdict::NoSurface, "people on their ways");
        assert_eq!(judged(900, 20.0, 12.0, 1.0), Verdict::NoSurface, "somebody who stood there");
        assert_eq!(judged(900, 40.0, 8.0, 1.0), Verdict::NoSurface, "from one direction");
        assert_eq!(judged(100, 40.0, 12.0, 9.0), Verdict::NoSurface, "gone since");
    }

    #[test]
    fn what_glints_is_seen_about_its_normal_unless_it_is_seen_from_all_around() {
        let judged = |degrees: f64, glints: u8| {
            let mut cell = Cell::of(&Returns::new([0, 0], true), &Track::default());
            (cell.returns.occupancy, cell.returns.glints) = (2, glints);
            let wide = |degrees: f64| units(degrees.to_radians()) as u16;
            cell.visible.range = AngleRange { start: Angle(0), width: wide(degrees) };
            cell.missed_width = wide(40.0);
            shape(&cell, None, false, &VisaggeSettings::default())
        };
        assert_eq!(judged(2.0, 0), Verdict::NoSurface);
        assert_eq!(judged(2.0, 1), Verdict::NoSurface, "a random reading");
        assert_eq!(judged(2.0, 2), Verdict::Surface);
        assert_eq!(judged(60.0, 2), Verdict::NoSurface, "a box of polished metal that was taken away");
    }

    #[test]
    fn a_single_glint_on_a_broad_surface_is_no_random_reading() {
        let judged = |glints: u8, length: f32| {
            let mut cell = Cell::of(&Returns::new([0, 0], true), &Track::default());
            (cell.returns.occupancy, cell.returns.glints) = (1, glints);
            let line = Line { at: [0.0; 2], normal: 0.0, rms: 0.012, length, share: 1.0, glints: true };
            shape(&cell, Some(&line), false, &VisaggeSettings::default())
        };
        assert_eq!(judged(1, 0.6), Verdict::Surface);
        assert_eq!(judged(0, 0.6), Verdict::TooFew);
        assert_eq!(judged(1, 0.4), Verdict::TooFew, "no broader than somebody");
    }

    #[test]
    fn who_has_come_and_waits_is_not_shown() {
        // Cells of 8 returns over some seconds, seen over 15 degrees: `c` were crossed before, `#` never.
        let shown = |drawing: &[&str], lasted: f32| {
            let mut grid = Visagge::new(0.05, VisaggeSettings::default());
            let number = grid.tiles.find_or_make(TileIndex { x: 0, y: 0 });
            let cells = drawing.iter().enumerate().flat_map(|(row, line)| {
                let cells = line.bytes().enumerate().filter(|(_, cell)| *cell != b'.');
                cells.map(move |(column, cell)| {
                    let mut returns = Returns::new([column as u8 + 20, row as u8 + 20], cell == b'c');
                    (returns.occupancy, returns.hits, returns.hit_time) = (8, 8, [0.0, lasted]);
                    let range = AngleRange { start: Angle(0), width: units(0.26) as u16 };
                    (returns, Track { visible: Sector { range, ends: [1000; 2] }, ..Track::default() })
                })
            });
            grid.tiles.at_mut(number).evidence.get_or_insert_default().fill(cells);
            grid.decide();
            grid.cells().filter(|(.., judgement)| judgement.verdict.is_shown()).count()
        };
        let legs = ["cc....cc", "cc....cc"];
        assert_eq!(shown(&legs, 9.0), 0);
        assert!(shown(&legs, 40.0) > 0, "longer than people wait");
        // What is there, with one cell that an error of a pose has crossed.
        assert_eq!(shown(&["#c#.####"], 9.0), 7);
        assert_eq!(shown(&["cccccccccccccccccccc"], 9.0), 20, "a shutter of a metre");
    }

    #[test]
    fn a_wall_is_drawn_one_cell_thick() {
        // Cells one behind the other, seen from along the row: those before `other` from one side, the others from the other one.
        let drawn = |hits: &[u16], glints: &[u8], other: usize| {
            let mut grid = Visagge::new(0.05, VisaggeSettings::default());
            let number = grid.tiles.find_or_make(TileIndex { x: 0, y: 0 });
            let evidence = grid.tiles.at_mut(number).evidence.get_or_insert_default();
            let cells = hits.iter().enumerate().map(|(column, &hits)| {
                let mut returns = Returns::new([column as u8, 5], false);
                (returns.hits, returns.glints) = (hits, glints.get(column).copied().unwrap_or_default());
                let mut track = Track::default();
                track.visible.range.start = Angle(if column < other { 0 } else { 1 << 15 });
                (returns, track)
            });
            evidence.fill(cells);
            evidence.judgements.iter_mut().for_each(|judgement| judgement.unthinned = Verdict::Solid);
            grid.thin_all();
            grid.cells().map(|(.., judgement)| u8::from(judgement.verdict.is_shown())).collect::<Vec<_>>()
        };
        let wall = |hits: &[u16]| drawn(hits, &[], 9);
        assert_eq!(wall(&[3, 20, 80, 30, 2]), [0, 0, 1, 0, 0]);
        assert_eq!(wall(&[3, 40, 50, 2]), [0, 1, 1, 0], "along the border of both");
        assert_eq!(wall(&[90, 0, 0, 9]), [1, 0, 0, 1], "another surface");
        let two_faces = [12, 90, 12, 30, 4];
        assert_eq!(drawn(&two_faces, &[], 2), [0, 1, 0, 1, 0], "of a wall of 0.1 m");
        assert_eq!(wall(&two_faces), [0, 1, 0, 0, 0]);
        // A pane 0.1 m before a wall, with which it merges where it glints least.
        let pane = |hits: &[u16], glints: &[u8]| drawn(hits, glints, 9);
        assert_eq!(pane(&[6, 55, 237, 456, 9], &[2, 21, 7, 0, 0]), [0, 1, 0, 1, 0]);
        assert_eq!(pane(&[6, 55, 237, 9], &[3, 21, 60, 4]), [0, 0, 1, 0], "by itself");
        assert_eq!(pane(&[55, 237, 456], &[1, 1, 0]), [0, 0, 1], "random readings");
    }

    #[test]
    fn diagonal_lines_are_one_cell_thick() {
        let cut = |drawing: [&str; 6]| {
            let mut rows: Rows = [0; SIDE as usize];
            for (row, line) in rows[20..].iter_mut().zip(drawing.iter().rev()) {
                *row = line.bytes().rev().fold(0, |row, cell| row << 1 | u64::from(cell == b'#')) << 20;
            }
            let corners = corners(&rows);
            let drawn = |(row, corners): (&u64, &u64)| -> String {
                let left = (row & !corners) >> 20;
                (0..8).map(|column| if left >> column & 1 == 1 { '#' } else { '.' }).collect()
            };
            rows.iter().zip(&corners).skip(20).take(6).rev().map(drawn).collect::<Vec<_>>()
        };
        let rising = ["....##..", "...##...", "..##....", ".##.....", "##......", "........"];
        assert_eq!(cut(rising), ["....##..", "...#....", "..#.....", ".#......", "#.......", "........"]);
        let falling = ["##......", ".##.....", "..##....", "...##...", "....##..", "........"];
        assert_eq!(cut(falling), ["#.......", ".#......", "..#.....", "...#....", "....##..", "........"]);
        for whole in [
            ["###.....", "..#.....", "..#.....", "..###...", "....#...", "....#..."],
            ["###.....", "..###...", "....###.", "......##", "........", "........"],
            ["##......", "##......", "..##....", "..##....", "........", "........"],
            ["...#....", "...#....", "########", "...#....", "...#....", "........"],
        ] {
            assert_eq!(cut(whole), whole);
        }
    }

    #[test]
    fn a_surface_is_more_than_one_cell() {
        // Shown by themselves, in these columns.
        let drawn = |columns: &[u8], by_itself: Verdict| {
            let mut grid = Visagge::new(0.05, VisaggeSettings::default());
            let number = grid.tiles.find_or_make(TileIndex { x: 0, y: 0 });
            let evidence = grid.tiles.at_mut(number).evidence.get_or_insert_default();
            evidence.fill(columns.iter().map(|&column| (Returns::new([column, 5], false), Track::default())));
            evidence.judgements.iter_mut().for_each(|judgement| judgement.unthinned = by_itself);
            columns.iter().for_each(|column| evidence.shown[5] |= 1 << column);
            grid.thin_all();
            grid.cells().map(|(.., judgement)| judgement.verdict).collect::<Vec<_>>()
        };
        assert_eq!(drawn(&[9], Verdict::Surface), [Verdict::TooFew]);
        assert_eq!(drawn(&[9, 13], Verdict::Repeated), [Verdict::TooFew; 2]);
        assert_eq!(drawn(&[9, 12], Verdict::Surface), [Verdict::Surface; 2]);
        assert_eq!(drawn(&[9], Verdict::Solid), [Verdict::Solid], "the leg of a table");
    }
}
