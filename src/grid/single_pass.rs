//! SINGLE PASS MOTION REMOVAL, the verdict as the paper has it (paper IV-C), for comparison with ours.

use super::{
    tiles::CellIndex,
    verdict::Verdict,
    visagge::{Evidence, Visagge},
};
use std::collections::HashMap;

/// Cells seen from a range narrower than this are uncertain (rad): 6 degrees in the paper.
const UNCERTAIN: f64 = 0.105;

impl Visagge {
    /// Judges all cells: uncertain ones without neighbours on both sides, across the direction of view, are
    /// unoccupied; repeated until nothing changes. A cell of two and more passes is left alone.
    pub(super) fn remove_motion(&mut self) {
        let uncertain = super::angle::units(UNCERTAIN);
        let mut occupied: HashMap<CellIndex, Option<f64>> = self
            .cells()
            .map(|(index, cell, _)| {
                let view = cell.visible.range;
                let doubtful = u32::from(view.width) < uncertain && cell.returns.passes == 0;
                (index, doubtful.then(|| view.middle().rad()))
            })
            .collect();
        loop {
            let removed: Vec<CellIndex> = occupied
                .iter()
                .filter(|(index, seen_from)| {
                    seen_from.is_some_and(|seen_from| {
                        let held = |side: f64| {
                            beside(**index, seen_from + side).any(|cell| occupied.contains_key(&cell))
                        };
                        !(held(QUARTER) && held(-QUARTER))
                    })
                })
                .map(|(index, _)| *index)
                .collect();
            if removed.is_empty() {
                break;
            }
            for index in removed {
                occupied.remove(&index);
            }
        }
        for number in 0..self.tiles.len() {
            let place = self.tiles.place(number);
            for (cell, judgement) in
                self.tiles.at_mut(number).evidence.as_deref_mut().into_iter().flat_map(Evidence::judged)
            {
                judgement.verdict = match occupied.get(&cell.index(place)) {
                    Some(None) => Verdict::Solid,
                    Some(Some(_)) => Verdict::Surface,
                    None => Verdict::NoSurface,
                };
            }
        }
    }
}

const QUARTER: f64 = std::f64::consts::FRAC_PI_2;

/// The three of a cell's eight neighbours that lie most nearly in a direction (rad).
fn beside(index: CellIndex, direction: f64) -> impl Iterator<Item = CellIndex> {
    [-QUARTER / 2.0, 0.0, QUARTER / 2.0].into_iter().map(move |turn| {
        let (sin, cos) = (direction + turn).sin_cos();
        // Beyond the octant's border the other coordinate no longer counts.
        let step = |part: f64| if part.abs() < 0.383 { 0 } else { part.signum() as i32 };
        CellIndex { x: index.x + step(cos), y: index.y + step(sin) }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_lie_on_the_side_that_is_asked_for() {
        let around = |degrees: f64| {
            let cells = beside(CellIndex { x: 0, y: 0 }, degrees.to_radians());
            cells.map(|cell| (cell.x, cell.y)).collect::<Vec<_>>()
        };
        assert_eq!(around(0.0), [(1, -1), (1, 0), (1, 1)]);
        assert_eq!(around(90.0), [(1, 1), (0, 1), (-1, 1)]);
        assert_eq!(around(-135.0), [(-1, 0), (-1, -1), (0, -1)]);
    }
}
