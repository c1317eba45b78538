//! Which cells with evidence are shown as occupied, and why.
//!
//! The core algorithm needs two passes to tell a pane of glass from someone who walked by: both are seen
//! for a moment, from a narrow range of angles. The verdict tells them apart after one. What was hardly
//! ever missed is solid. What was missed must be explained as a surface that is visible near its normal
//! only: the neighbouring cells must form a flat patch whose normal is the direction from which they were
//! seen (paper IV-C gives the reason, and a weaker test).

use super::{
    angle::Angle,
    cell::Cell,
    tiles::{CellIndex, SIDE, TileIndex},
    visagge::Visagge,
};

/// Why a cell with evidence is shown, or not. The number is the value of layer `verdict` in map.npz.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Verdict {
    /// Not judged yet.
    #[default]
    None = 0,
    /// Shown: seen whenever it could be, or nearly so.
    Solid = 1,
    /// Shown: part of a flat surface that is visible near its normal.
    Surface = 2,
    /// Shown: seen again from known angles after it had been missed.
    Repeated = 3,
    /// Not shown: too few returns.
    TooFew = 10,
    /// Not shown: missed, and part of no surface that could explain why. Somebody passed.
    NoSurface = 11,
}

impl Verdict {
    /// Whether the cell is shown as occupied.
    pub fn is_shown(self) -> bool {
        (Verdict::Solid as u8..Verdict::TooFew as u8).contains(&(self as u8))
    }
}

/// Cells around a tile that its verdicts depend on.
const MARGIN: i32 = 8;
const WINDOW: i32 = SIDE + 2 * MARGIN;
/// Occupancy below which a cell is a random reading: they come once in a thousand beams (paper III-B).
const LEAST_HITS: u8 = 2;
/// Neighbours seen from directions farther apart than this are parts of different surfaces (rad).
/// A pillar of glass of 1 m radius turns by this over the length of the patch.
const SAME_VIEW: f64 = 0.3;
/// Depth of the patch (m): what lies farther before or behind is not part of the surface.
const PATCH_DEPTH: f64 = 0.15;
/// Half the length of the patch (m).
const PATCH_HALF: f64 = 0.4;
/// Most that a flat surface spreads across its line, root mean square (m): cells, ranges and poses.
const FLAT: f64 = 0.035;
/// Least length of a surface (m). A leg is 12 cm thick.
const LEAST_LENGTH: f64 = 0.25;
/// Most that the normal may differ from the middle of the view angles (rad): 8 degrees. Glass is seen
/// within 1 to 2 degrees of its normal where something stands behind it (paper, Fig. 7), and the line
/// through a patch of this length is uncertain by some degrees.
const NORMAL: f64 = 0.14;

/// A cell near the tile in work.
struct Neighbour {
    at: [f64; 2],
    seen_from: Angle,
    weight: f64,
}

/// The cells of a tile and around it, found by their place.
struct Window {
    origin: CellIndex,
    slots: Vec<u16>,
    cells: Vec<Neighbour>,
}

impl Window {
    fn around(grid: &Visagge, place: TileIndex) -> Window {
        let corner = place.cell(0, 0);
        let origin = CellIndex { x: corner.x - MARGIN, y: corner.y - MARGIN };
        let mut window =
            Window { origin, slots: vec![u16::MAX; (WINDOW * WINDOW) as usize], cells: Vec::new() };
        for (dx, dy) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))) {
            let place = TileIndex { x: place.x + dx, y: place.y + dy };
            let Some(evidence) = grid.tiles.get(place).and_then(|tile| tile.evidence.as_ref()) else {
                continue;
            };
            for cell in &evidence.cells {
                let index = place.cell(usize::from(cell.place[0]), usize::from(cell.place[1]));
                if let Some(slot) = window.slot(index) {
                    window.slots[slot] = window.cells.len() as u16;
                    window.cells.push(Neighbour {
                        at: centroid(index, cell, grid.resolution),
                        seen_from: cell.visible.range.middle(),
                        weight: f64::from(cell.occupancy.min(4)),
                    });
                }
            }
        }
        window
    }

    fn slot(&self, index: CellIndex) -> Option<usize> {
        let (x, y) = (index.x - self.origin.x, index.y - self.origin.y);
        ((0..WINDOW).contains(&x) && (0..WINDOW).contains(&y)).then_some((y * WINDOW + x) as usize)
    }

    fn near(&self, index: CellIndex) -> impl Iterator<Item = &Neighbour> {
        (-MARGIN..=MARGIN)
            .flat_map(|dy| (-MARGIN..=MARGIN).map(move |dx| (dx, dy)))
            .filter_map(move |(dx, dy)| self.slot(CellIndex { x: index.x + dx, y: index.y + dy }))
            .filter_map(|slot| self.cells.get(usize::from(self.slots[slot])))
    }
}

/// Mean place of the cell's returns (m).
fn centroid(index: CellIndex, cell: &Cell, resolution: f64) -> [f64; 2] {
    [
        (f64::from(index.x) + f64::from(cell.centroid[0])) * resolution,
        (f64::from(index.y) + f64::from(cell.centroid[1])) * resolution,
    ]
}

/// The line through a patch of cells.
#[derive(Clone, Copy, Debug)]
struct Line {
    /// Direction of its normal (rad, modulo pi).
    normal: f64,
    /// Spread across it, root mean square (m).
    rms: f64,
    /// Length of an even row of points with the same spread along it (m).
    length: f64,
}

/// Fits a line to the cells near one that were seen from about the same direction.
fn fit(window: &Window, index: CellIndex, at: [f64; 2], seen_from: Angle) -> Option<Line> {
    let (sin, cos) = seen_from.rad().sin_cos();
    let same_view = super::angle::units(SAME_VIEW);
    let (mut sum, mut mean, mut square) = (0.0, [0.0; 2], [0.0; 3]);
    for neighbour in window.near(index) {
        let (dx, dy) = (neighbour.at[0] - at[0], neighbour.at[1] - at[1]);
        let (depth, across) = (dx * cos + dy * sin, dy * cos - dx * sin);
        if depth.abs() > PATCH_DEPTH
            || across.abs() > PATCH_HALF
            || neighbour.seen_from.distance(seen_from) > same_view
        {
            continue;
        }
        let weight = neighbour.weight;
        sum += weight;
        mean = [mean[0] + weight * dx, mean[1] + weight * dy];
        square = [square[0] + weight * dx * dx, square[1] + weight * dx * dy, square[2] + weight * dy * dy];
    }
    if sum <= 0.0 {
        return None;
    }
    let [mx, my] = mean.map(|m| m / sum);
    let (xx, xy, yy) = (square[0] / sum - mx * mx, square[1] / sum - mx * my, square[2] / sum - my * my);
    let spread = ((xx - yy) / 2.0).hypot(xy);
    let along = f64::atan2(2.0 * xy, xx - yy) / 2.0;
    Some(Line {
        normal: along + std::f64::consts::FRAC_PI_2,
        rms: ((xx + yy) / 2.0 - spread).max(0.0).sqrt(),
        length: (12.0 * ((xx + yy) / 2.0 + spread)).sqrt(),
    })
}

impl Line {
    fn explains(&self, seen_from: Angle) -> bool {
        let off = (self.normal - seen_from.rad()).rem_euclid(std::f64::consts::PI);
        let off = off.min(std::f64::consts::PI - off);
        self.length >= LEAST_LENGTH && self.rms <= FLAT && off <= NORMAL
    }
}

impl Visagge {
    /// Judges the tiles around which something changed.
    pub(super) fn judge(&mut self) {
        let changed: Vec<TileIndex> = self
            .tiles
            .iter()
            .filter(|(_, tile)| tile.evidence.as_ref().is_some_and(|evidence| evidence.changed))
            .map(|(place, _)| place)
            .collect();
        let mut touched: Vec<TileIndex> = changed
            .iter()
            .flat_map(|place| {
                (-1..=1).flat_map(move |dy| {
                    (-1..=1).map(move |dx| TileIndex { x: place.x + dx, y: place.y + dy })
                })
            })
            .collect();
        touched.sort_unstable();
        touched.dedup();
        for place in touched {
            self.judge_tile(place);
        }
    }

    fn judge_tile(&mut self, place: TileIndex) {
        let Some(number) = self.tiles.find(place) else { return };
        if self.tiles.at(number).evidence.is_none() {
            return;
        }
        let window = Window::around(self, place);
        let resolution = self.resolution;
        let evidence = self.tiles.at_mut(number).evidence.as_mut().expect("tested above");
        evidence.changed = false;
        for cell in &mut evidence.cells {
            let index = place.cell(usize::from(cell.place[0]), usize::from(cell.place[1]));
            cell.verdict = judge_cell(&window, index, cell, resolution);
        }
    }
}

fn judge_cell(window: &Window, index: CellIndex, cell: &Cell, resolution: f64) -> Verdict {
    if cell.occupancy < LEAST_HITS {
        return Verdict::TooFew;
    }
    if u32::from(cell.visible.range.width) >= 2 * u32::from(cell.widest_missed) {
        return Verdict::Solid;
    }
    if cell.passes > 0 {
        return Verdict::Repeated;
    }
    let seen_from = cell.visible.range.middle();
    match fit(window, index, centroid(index, cell, resolution), seen_from) {
        Some(line) if line.explains(seen_from) => Verdict::Surface,
        _ => Verdict::NoSurface,
    }
}
