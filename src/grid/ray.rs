//! The cells that a beam crosses in a plain grid, one a step along the longer axis (Bresenham 1965).
//! The VisAGGE grid does not walk along beams; it asks of each cell which beams cross it.

use super::{sweep::Sweep, tiles::CellIndex};

/// Cells of the sensor and of the return, for every beam of a sweep with a return up to `range_max` (m), with the beam's
/// number.
pub fn returns(
    sweep: &Sweep,
    resolution: f64,
    range_max: f64,
) -> impl Iterator<Item = (usize, CellIndex, CellIndex)> {
    sweep
        .beams()
        .zip(&sweep.scan.ranges)
        .enumerate()
        .filter(move |(_, (_, range))| **range > 0.0 && f64::from(**range) <= range_max)
        .map(move |(beam, ((origin, direction), &range))| {
            let end = origin + direction * f64::from(range);
            (beam, CellIndex::of(origin.x, origin.y, resolution), CellIndex::of(end.x, end.y, resolution))
        })
}

/// Visits the cells from `start` up to but without `end`.
pub fn walk(start: CellIndex, end: CellIndex, mut visit: impl FnMut(CellIndex)) {
    let (dx, dy) = ((end.x - start.x).abs(), -(end.y - start.y).abs());
    let (sx, sy) = ((end.x - start.x).signum(), (end.y - start.y).signum());
    let mut error = dx + dy;
    let mut cell = start;
    while cell != end {
        visit(cell);
        let twice = 2 * error;
        if twice >= dy {
            error += dy;
            cell.x += sx;
        }
        if twice <= dx {
            error += dx;
            cell.y += sy;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{grid::sweep::tests::half_circle, pose::pose};

    #[test]
    fn rays_visit_each_cell_once() {
        for (x, y) in [(7, 3), (-7, 3), (2, -9), (0, 4), (-5, -5)] {
            let mut seen = Vec::new();
            walk(CellIndex { x: 0, y: 0 }, CellIndex { x, y }, |cell| seen.push(cell));
            assert_eq!(seen.len() as i32, x.abs().max(y.abs()));
        }
    }

    #[test]
    fn only_beams_with_a_return_in_range_have_an_end() {
        let scan = half_circle(0, vec![f32::NAN, 2.0, f32::INFINITY, 9.0, f32::NEG_INFINITY]);
        let at = pose(0.25, 0.25, std::f64::consts::FRAC_PI_4);
        let sweep = Sweep { scan: &scan, start: at, end: at };
        let ends: Vec<_> = returns(&sweep, 0.5, 5.0).collect();
        assert_eq!(ends, [(1, CellIndex { x: 0, y: 0 }, CellIndex { x: 4, y: 0 })]);
    }
}
