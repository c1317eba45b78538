//! Marks a map against the truth, column by column as the paper's Figure 10 and beyond.

use serde::Serialize;

use crate::truth::{CLEAR_OF_SURFACES, Label, TruthMap};

/// Cells from this value of nav_msgs/OccupancyGrid on are occupied.
const OCCUPIED: i8 = 65;
/// A surface is found if an occupied cell lies within this many cells.
const FOUND_WITHIN: usize = 1;
/// It is misplaced if not found, but an occupied cell lies within this many.
const MISPLACED_WITHIN: usize = 4;
/// Unless a diffuse surface lies within this many, which explains the cell.
const EXPLAINED_WITHIN: usize = 3;

/// A map to be marked: cells row by row from the bottom.
#[derive(Clone, Copy, Debug)]
pub struct Marked<'a> {
    /// Side of a cell (m); must be the truth's.
    pub resolution: f64,
    /// Lower left corner (m).
    pub origin: [f64; 2],
    /// Cells in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// nav_msgs/OccupancyGrid's values.
    pub cells: &'a [i8],
}

/// How many of how many.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Share {
    /// Cells that are so.
    pub count: usize,
    /// Out of these.
    pub of: usize,
}

impl Share {
    /// In percent; 0 of 0 is 0.
    pub fn percent(self) -> f64 {
        if self.of == 0 { 0.0 } else { 100.0 * self.count as f64 / self.of as f64 }
    }
}

/// The columns of the table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Score {
    /// Specular cells within one cell of an occupied one; the map is thinned first.
    pub glass: Share,
    /// Specular cells not found, but with an occupied cell within 4 and no diffuse cell within 3.
    pub misplaced: Share,
    /// Diffuse cells within one cell of an occupied one.
    pub diffuse: Share,
    /// Occupied cells among those where only (or mostly) moving things were seen.
    pub motion: Share,
    /// Occupied cells among those of images.
    pub reflection: Share,
    /// Occupied cells among those of things that were taken away.
    pub removed: Share,
    /// Occupied cells that are none of these and over 2 cells from any surface, among all occupied cells.
    pub stray: Share,
    /// Occupied cells among those that the robot has driven over.
    pub path: Share,
}

/// Marks a map. Cells of the map outside the truth are ignored.
pub fn score(truth: &TruthMap, map: &Marked) -> Score {
    let occupied = on_truth(truth, map);
    let thin = thinned(&occupied, truth.width);
    let mut score = Score::default();
    for (cell, label) in truth.labels.iter().enumerate() {
        let away = truth.clearance[cell] > CLEAR_OF_SURFACES;
        let set = occupied[cell];
        let mark = |share: &mut Share, is_so: bool| {
            share.of += 1;
            share.count += usize::from(is_so);
        };
        match label {
            Label::Glass => {
                let found = any_within(&thin, truth.width, cell, FOUND_WITHIN, |&o| o);
                let misplaced = !found
                    && any_within(&thin, truth.width, cell, MISPLACED_WITHIN, |&o| o)
                    && !any_within(&truth.labels, truth.width, cell, EXPLAINED_WITHIN, |&l| {
                        l == Label::Diffuse
                    });
                mark(&mut score.glass, found);
                mark(&mut score.misplaced, misplaced);
            }
            Label::Diffuse => {
                mark(&mut score.diffuse, any_within(&thin, truth.width, cell, FOUND_WITHIN, |&o| o));
            }
            Label::Motion => mark(&mut score.motion, set),
            Label::Reflection => mark(&mut score.reflection, set),
            Label::Removed => mark(&mut score.removed, set),
            Label::Other => {}
        }
        if set {
            mark(&mut score.stray, *label == Label::Other && away);
        }
        if truth.path[cell] && away {
            mark(&mut score.path, set);
        }
    }
    score
}

/// The map's occupied cells, cell by cell of the truth.
fn on_truth(truth: &TruthMap, map: &Marked) -> Vec<bool> {
    let mut occupied = vec![false; truth.labels.len()];
    for (i, _) in map.cells.iter().enumerate().filter(|(_, v)| **v >= OCCUPIED) {
        let (column, row) = (i % map.width, i / map.width);
        let x = map.origin[0] + (column as f64 + 0.5) * map.resolution;
        let y = map.origin[1] + (row as f64 + 0.5) * map.resolution;
        if let Some(cell) = truth.cell(x, y) {
            occupied[cell] = true;
        }
    }
    occupied
}

fn any_within<T>(values: &[T], width: usize, cell: usize, reach: usize, is_so: impl Fn(&T) -> bool) -> bool {
    let (x, y) = (cell % width, cell / width);
    let height = values.len() / width;
    (y.saturating_sub(reach)..=(y + reach).min(height - 1)).any(|row| {
        let columns = x.saturating_sub(reach)..=(x + reach).min(width - 1);
        values[row * width..][columns].iter().any(&is_so)
    })
}

/// Thins to lines one cell wide (Zhang and Suen 1984). Only occupied cells are looked at, so its cost goes with
/// their number.
pub fn thinned(occupied: &[bool], width: usize) -> Vec<bool> {
    let height = occupied.len() / width;
    let mut thin = occupied.to_vec();
    // The border cannot be thinned and is left as it is.
    let mut left: Vec<usize> = (0..thin.len())
        .filter(|&c| {
            let (x, y) = (c % width, c / width);
            thin[c] && x > 0 && y > 0 && x + 1 < width && y + 1 < height
        })
        .collect();
    loop {
        let before = left.len();
        for second in [false, true] {
            let gone: Vec<usize> =
                left.iter().copied().filter(|&c| can_go(&thin, width, c, second)).collect();
            for c in gone {
                thin[c] = false;
            }
            left.retain(|&c| thin[c]);
        }
        if left.len() == before {
            return thin;
        }
    }
}

fn can_go(thin: &[bool], width: usize, c: usize, second: bool) -> bool {
    // North first, then clockwise.
    let around = [
        thin[c + width],
        thin[c + width + 1],
        thin[c + 1],
        thin[c - width + 1],
        thin[c - width],
        thin[c - width - 1],
        thin[c - 1],
        thin[c + width - 1],
    ];
    let count = around.iter().filter(|&&v| v).count();
    let rises = (0..8).filter(|&k| !around[k] && around[(k + 1) % 8]).count();
    let [north, _, east, _, south, _, west, _] = around;
    // The first half of a round takes cells off the south and east, the second off the north and west.
    let is_inner = if second { north && west && (east || south) } else { east && south && (north || west) };
    (2..=6).contains(&count) && rises == 1 && !is_inner
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `G` glass, `D` diffuse, `m` motion, `r` reflection, `x` removed, `p` path, `.` other; top row first.
    fn truth(drawing: &[&str]) -> TruthMap {
        let width = drawing[0].len();
        let cells: Vec<u8> = drawing.iter().rev().flat_map(|row| row.bytes()).collect();
        let label = |c: &u8| match c {
            b'G' => Label::Glass,
            b'D' => Label::Diffuse,
            b'm' => Label::Motion,
            b'r' => Label::Reflection,
            b'x' => Label::Removed,
            _ => Label::Other,
        };
        let labels: Vec<Label> = cells.iter().map(label).collect();
        let clearance = (0..cells.len())
            .map(|c| {
                let near = |reach| {
                    any_within(&labels, width, c, reach, |l| matches!(l, Label::Glass | Label::Diffuse))
                };
                (0..9).find(|&r| near(r)).unwrap_or(9) as u8
            })
            .collect();
        let path = cells.iter().map(|&c| c == b'p').collect();
        TruthMap {
            resolution: 0.05,
            origin: [-1.0, 2.0],
            width,
            height: drawing.len(),
            labels,
            clearance,
            path,
        }
    }

    fn marks(drawing: &[&str], map: &[&str]) -> Score {
        let cells: Vec<i8> = map
            .iter()
            .rev()
            .flat_map(|row| row.bytes())
            .map(|c| match c {
                b'#' => 100,
                b' ' => -1,
                _ => 0,
            })
            .collect();
        let map = Marked {
            resolution: 0.05,
            origin: [-1.0, 2.0],
            width: map[0].len(),
            height: map.len(),
            cells: &cells,
        };
        score(&truth(drawing), &map)
    }

    fn share(count: usize, of: usize) -> Share {
        Share { count, of }
    }

    #[test]
    fn found_misplaced_and_false_cells_are_told_apart() {
        let drawing = [
            "GGGGGGGGGGGG",
            "............",
            "............",
            "............",
            "m..r..x..p..",
            "............",
            "............",
            "DDDDDD......",
        ];
        let map = [
            "............",
            "####........",
            "............",
            "............",
            "#.....#..#.#",
            "............",
            "............",
            "######......",
        ];
        let score = marks(&drawing, &map);
        assert_eq!(score.glass, share(5, 12));
        assert_eq!(score.misplaced, share(7, 12));
        assert_eq!(score.diffuse, share(6, 6));
        assert_eq!(score.motion, share(1, 1));
        assert_eq!(score.reflection, share(0, 1));
        assert_eq!(score.removed, share(1, 1));
        // The cell on the path, and the one to the right of it.
        assert_eq!(score.stray, share(2, 14));
        assert_eq!(score.path, share(1, 1));
        assert!((score.glass.percent() - 41.67).abs() < 0.01);
    }

    #[test]
    fn a_blot_is_thinned_before_it_finds_anything() {
        let drawing = [
            "..........",
            "..........",
            "..........",
            "..........",
            "GGGGGGGGGG",
            "..........",
            "..........",
            "..........",
            "..........",
        ];
        let blot = [
            "..........",
            ".########.",
            ".########.",
            ".########.",
            ".########.",
            "..........",
            "..........",
            "..........",
            "..........",
        ];
        let score = marks(&drawing, &blot);
        // Its skeleton lies one to two cells above the pane, not on it.
        assert!(score.glass.count < 10);
        let thin =
            thinned(&blot.iter().rev().flat_map(|r| r.bytes().map(|b| b == b'#')).collect::<Vec<_>>(), 10);
        assert!(thin.iter().filter(|&&v| v).count() <= 10);
        assert!(thin.iter().any(|&v| v));
    }

    #[test]
    fn a_diffuse_surface_nearby_explains_a_misplaced_cell() {
        let with = ["GGGG", "....", "DDDD"];
        let map = ["....", "....", "####"];
        assert_eq!(marks(&with, &map).misplaced.count, 0);
        assert_eq!(marks(&["GGGG", "....", "...."], &map).misplaced.count, 4);
    }
}
