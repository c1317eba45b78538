//! Which cells with evidence are shown as occupied, and why.
//!
//! The core algorithm needs two passes to tell a pane of glass from someone who walked by: both are seen
//! for a moment, from a narrow range of angles. The verdict tells them apart after one. What was hardly
//! ever missed is solid. What was missed must be explained as a surface that is visible near its normal
//! only: the neighbouring cells must form a flat patch whose normal is the direction from which they were
//! seen (paper IV-C gives the reason, and a weaker test). And what is the image of something else in a mapped surface is
//! not there at all.

use super::{
    angle::units,
    cell::Cell,
    reflection::{self, Image, Opacity},
    surface::{Line, Window},
    tiles::CellIndex,
    visagge::{Evidence, Visagge},
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
    /// Shown: few returns, or no surface by themselves, but in a gap of what is shown on both sides.
    Bridged = 4,
    /// Not shown: too few returns.
    TooFew = 10,
    /// Not shown: missed, and part of no surface that could explain why. Somebody passed.
    NoSurface = 11,
    /// Not shown: the image, in a mapped surface, of something else or of the robot.
    Image = 12,
}

impl Verdict {
    /// Whether the cell is shown as occupied.
    pub fn is_shown(self) -> bool {
        (Verdict::Solid as u8..Verdict::TooFew as u8).contains(&(self as u8))
    }
}

/// What is judged of a cell, from its observations and those of the cells around.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Judgement {
    /// The surface through it and its neighbours.
    pub line: Option<Line>,
    /// What its shape says of it: all of the verdict but whether it is an image.
    pub shape: Verdict,
    /// How it may be an image.
    pub image: Image,
    /// Whether it is shown as occupied, and why.
    pub verdict: Verdict,
}

/// Occupancy below which a cell is a random reading: they come once in a thousand beams (paper III-B).
const LEAST_HITS: u8 = 2;
/// Least length of a surface (m). A leg is 12 cm thick, two of them side by side 30.
const LEAST_LENGTH: f32 = 0.4;
/// Most that the normal may differ from the middle of the view angles (rad): 8 degrees. Glass is seen
/// within 1 to 2 degrees of its normal where something stands behind it (paper, Fig. 7), and the line
/// through a patch is uncertain by some degrees.
const NORMAL: f64 = 0.14;

/// Something is seen through a surface, or in it, that was missed over at least this range (rad): 1 degree. Less is a
/// wall at grazing incidence.
const SEEN_THROUGH: f64 = 0.02;
/// What is shown on both sides of a gap must begin within this many cells: a quarter of a metre, less than half a
/// door or a person's width.
const GAP: i32 = 5;
/// What a beam has crossed before it was first seen has come, or is seen from some directions only. It is
/// solid if it was seen over at least this range (rad), 10 degrees: a leg takes 0.3 s to cross a cell, and at 1 m/s a
/// sensor 2 m away moves by 9 degrees meanwhile.
const WIDE: f64 = 0.17;
/// Or if its returns came over at least this time (s): nobody who walks stays in a cell for a second.
const LASTING: f32 = 1.0;

impl Visagge {
    /// Judges all cells, from their observations alone: a verdict does not depend on the one before, so the map does not
    /// depend on when it was asked for.
    pub(super) fn judge(&mut self) {
        for number in 0..self.tiles.len() {
            self.judge_tile(number);
        }
        self.bridge_gaps();
        self.judge_images();
    }

    /// Shows cells in the gaps of what is shown. A pane is seen cell by cell, for a few scans each: where somebody stands in
    /// between, or two cells share a return, single ones have too little to be a surface by themselves.
    fn bridge_gaps(&mut self) {
        let mut bridged = Vec::new();
        for number in 0..self.tiles.len() {
            let place = self.tiles.place(number);
            let Some(evidence) = &self.tiles.at(number).evidence else { continue };
            for (at, (cell, judgement)) in evidence.cells.iter().zip(&evidence.judgements).enumerate() {
                if !judgement.shape.is_shown() && self.is_in_gap(cell.index(place)) {
                    bridged.push((number, at));
                }
            }
        }
        // Afterwards, so that no cell is held by one that is bridged itself.
        for (number, at) in bridged {
            let evidence = self.tiles.at_mut(number).evidence.as_mut().expect("the cell is in it");
            let [column, row] = evidence.cells[at].place;
            evidence.shown[usize::from(row)] |= 1 << column;
            evidence.judgements[at].shape = Verdict::Bridged;
        }
    }

    /// Whether two neighbouring cells that are shown lie near on both sides, along a row, a column or a diagonal.
    fn is_in_gap(&self, index: CellIndex) -> bool {
        [(1, 0), (0, 1), (1, 1), (1, -1)].into_iter().any(|(x, y)| {
            [1, -1].into_iter().all(|side| {
                let shown = |step: i32| {
                    self.is_shown(CellIndex { x: index.x + x * side * step, y: index.y + y * side * step })
                };
                (1..GAP).any(|step| shown(step) && shown(step + 1))
            })
        })
    }

    fn is_shown(&self, index: CellIndex) -> bool {
        let (place, column, row) = index.split();
        let evidence = self.tiles.get(place).and_then(|tile| tile.evidence.as_ref());
        evidence.is_some_and(|evidence| evidence.shown[row] >> column & 1 == 1)
    }

    fn judge_images(&mut self) {
        let mut opacity = Opacity::default();
        for number in 0..self.tiles.len() {
            let place = self.tiles.place(number);
            let Some(evidence) = &self.tiles.at(number).evidence else { continue };
            let judged = evidence.cells.iter().zip(&evidence.judgements);
            let images: Vec<Image> = judged
                .map(|(cell, judgement)| {
                    if judgement.shape.is_shown() { reflection::image(self, place, cell) } else { Image::No }
                })
                .collect();
            images.iter().for_each(|image| opacity.vote(*image));
            let evidence = self.tiles.at_mut(number).evidence.as_mut().expect("it was there");
            for (judgement, image) in evidence.judgements.iter_mut().zip(images) {
                judgement.image = image;
            }
        }
        for number in 0..self.tiles.len() {
            let judged = self.tiles.at_mut(number).evidence.iter_mut().flat_map(Evidence::judged);
            for (_, judgement) in judged {
                judgement.verdict =
                    if opacity.is_image(judgement.image) { Verdict::Image } else { judgement.shape };
            }
        }
    }

    /// Judges the cells of a tile by their own observations and their neighbours'.
    fn judge_tile(&mut self, number: usize) {
        let place = self.tiles.place(number);
        if self.tiles.at(number).evidence.is_none() {
            return;
        }
        let window = Window::around(self, place);
        let evidence = self.tiles.at_mut(number).evidence.as_mut().expect("tested above");
        evidence.shown = [0; 64];
        evidence.mirrors = [0; 64];
        evidence.has_mirrors = false;
        for (cell, judgement) in evidence.cells.iter().zip(&mut evidence.judgements) {
            // What was never missed is solid and nothing is seen through it: its surface does not matter.
            let matters = cell.occupancy >= LEAST_HITS && (cell.widest_missed > 0 || cell.was_crossed);
            let line = if matters { window.surface(cell.index(place), cell) } else { None };
            *judgement = Judgement { line, shape: shape(cell, line.as_ref()), ..Judgement::default() };
            let [column, row] = cell.place;
            if judgement.shape.is_shown() {
                evidence.shown[usize::from(row)] |= 1 << column;
                if u32::from(cell.widest_missed) >= units(SEEN_THROUGH)
                    && line.is_some_and(|line| line.is_flat())
                {
                    evidence.mirrors[usize::from(row)] |= 1 << column;
                    evidence.has_mirrors = true;
                }
            }
        }
    }
}

fn shape(cell: &Cell, line: Option<&Line>) -> Verdict {
    if cell.occupancy < LEAST_HITS {
        return Verdict::TooFew;
    }
    let width = u32::from(cell.visible.range.width);
    if width >= 2 * u32::from(cell.widest_missed)
        && (!cell.was_crossed || width >= units(WIDE) || cell.lasted() >= LASTING)
    {
        return Verdict::Solid;
    }
    if cell.passes > 0 {
        return Verdict::Repeated;
    }
    let seen_from = cell.visible.range.middle().rad();
    let explains =
        |line: &Line| line.length >= LEAST_LENGTH && line.is_flat() && line.off_normal(seen_from) <= NORMAL;
    if line.is_some_and(explains) { Verdict::Surface } else { Verdict::NoSurface }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        grid::{
            sweep::{Sweep, tests::half_circle},
            visagge::VisaggeSettings,
        },
        pose::pose,
    };

    #[test]
    fn the_map_does_not_depend_on_when_it_was_asked_for() {
        let [mut often, mut once] = [(); 2].map(|()| Visagge::new(0.05, VisaggeSettings::default()));
        // Seen from one place, then missed from another, with nothing else to see but far away.
        for (seq, (x, range)) in [(0.0, 2.0), (0.0, 2.0), (0.0, 2.0), (1.0, 25.0)].into_iter().enumerate() {
            let scan = half_circle(seq as u64, vec![range; 361]);
            let at = pose(x, 0.0, 0.0);
            let sweep = Sweep { scan: &scan, start: at, end: at };
            often.insert(&sweep);
            once.insert(&sweep);
            let shown = often.map().occupancy.iter().filter(|cell| **cell == 100).count();
            assert!(seq == 0 || shown > 0, "{seq}");
        }
        assert!(often.map() == once.map());
    }
}
