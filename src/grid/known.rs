//! What a grid knows of the world, as points in metres: for who looks for a place in it.

use super::{angle::units, standard::Standard, verdict::SEEN_THROUGH, visagge::Visagge};

/// What a grid knows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct KnownPlaces {
    /// The cells that are shown as occupied.
    pub surfaces: Vec<KnownSurface>,
    /// Middles of the cells that a beam has crossed (m).
    pub free: Vec<[f64; 2]>,
    /// Mean places of the returns in cells that are not shown (m): something may be there or not.
    pub doubtful: Vec<[f64; 2]>,
}

/// A cell that is shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownSurface {
    /// Mean place of its returns (m).
    pub at: [f64; 2],
    /// Bearing of the sensor seen from it, in the middle of those from which it is visible (rad).
    pub seen_from: f64,
    /// Scans with a return in it.
    pub hits: u16,
    /// Whether it was seen whenever it was looked at.
    pub is_opaque: bool,
}

impl Visagge {
    /// Side of a cell (m).
    pub fn resolution(&self) -> f64 {
        self.resolution
    }

    /// What is shown, and what is free.
    pub fn known(&mut self) -> KnownPlaces {
        self.decide();
        let resolution = self.resolution;
        let cells = |there: bool| {
            self.cells()
                .filter(move |(.., judgement)| judgement.verdict.is_there() == there)
                .map(|(index, cell, _)| (index, cell))
        };
        let surfaces = cells(true).map(|(index, cell)| KnownSurface {
            at: cell.returns_at(index, resolution),
            seen_from: cell.visible.range.middle().rad(),
            hits: cell.returns.hits,
            is_opaque: u32::from(cell.missed_width) <= units(SEEN_THROUGH),
        });
        KnownPlaces {
            surfaces: surfaces.collect(),
            free: self.crossed().map(|index| index.middle(resolution)).collect(),
            doubtful: cells(false).map(|(index, cell)| cell.returns_at(index, resolution)).collect(),
        }
    }
}

impl Standard {
    /// What is occupied and what is free within `reach` of a sensor (m). It does not know from where a cell was seen, nor
    /// that any can be seen through: taken is that the sensor sees them now.
    pub fn known(&self, sensor: [f64; 2], reach: f64) -> KnownPlaces {
        let mut places = KnownPlaces::default();
        for (index, is_occupied, _) in self.cells() {
            let at = index.middle(self.resolution());
            let way = [sensor[0] - at[0], sensor[1] - at[1]];
            if way[0] * way[0] + way[1] * way[1] > reach * reach {
                continue;
            }
            if is_occupied {
                let seen_from = way[1].atan2(way[0]);
                places.surfaces.push(KnownSurface { at, seen_from, hits: u16::MAX, is_opaque: true });
            } else {
                places.free.push(at);
            }
        }
        places
    }
}
