//! Occupancy grids: the VisAGGE grid and, for comparison, those that count hits along rays.

pub mod angle;
pub mod cell;
mod cells;
pub mod earlier;
mod free;
pub mod glints;
pub mod idea;
mod judge;
pub mod known;
mod landed;
mod lanes;
mod mirrors;
pub mod near;
pub mod ray;
pub mod rays;
mod reflection;
pub mod saved;
mod single_pass;
mod slots;
pub mod snapshot;
mod squares;
pub mod standard;
pub mod surface;
pub mod sweep;
pub mod tiles;
pub mod track;
pub mod verdict;
pub mod view;
pub mod visagge;
pub mod visits;

use crate::mapper::{MapperKind, MapperSettings};
use saved::SavedGrid;
use snapshot::Snapshot;
use standard::Standard;
use sweep::Sweep;
use visagge::Visagge;
use visits::Visits;

/// The grid that a mapper keeps.
#[derive(Debug)]
pub enum Grid {
    /// VisAGGE.
    Visagge(Box<Visagge>),
    /// The standard occupancy grid.
    Standard(Standard),
    /// The hits/visits grid with keyframes.
    Visits(Visits),
}

impl Grid {
    /// An empty grid of the kind that is set.
    pub fn new(settings: &MapperSettings) -> Grid {
        let (resolution, visagge) = (settings.resolution, settings.visagge.clone());
        match settings.mapper {
            MapperKind::Visagge => Grid::Visagge(Box::new(Visagge::new(resolution, visagge))),
            MapperKind::Paper => Grid::Visagge(Box::new(Visagge::as_in_the_paper(resolution, visagge))),
            MapperKind::Standard => Grid::Standard(Standard::new(resolution, visagge.range_max)),
            MapperKind::Visits => Grid::Visits(Visits::new(resolution, visagge.range_max)),
            MapperKind::Glints => Grid::Visits(Visits::with_glints(resolution, visagge.range_max)),
        }
    }

    /// Inserts one scan.
    pub fn insert(&mut self, sweep: &Sweep) {
        match self {
            Grid::Visagge(grid) => grid.insert(sweep),
            Grid::Standard(grid) => grid.insert(sweep),
            Grid::Visits(grid) => grid.insert(sweep),
        }
    }

    /// The map as it is now.
    pub fn snapshot(&mut self) -> Snapshot {
        match self {
            Grid::Visagge(grid) => grid.snapshot(),
            Grid::Standard(grid) => grid.map().into(),
            Grid::Visits(grid) => grid.map().into(),
        }
    }

    /// All that it knows, for a file; `None` for those that are for comparison.
    pub fn save(&self) -> Option<SavedGrid> {
        match self {
            Grid::Visagge(grid) => Some(grid.save()),
            Grid::Standard(_) | Grid::Visits(_) => None,
        }
    }

    /// Memory that the grid holds (bytes).
    pub fn bytes(&self) -> usize {
        match self {
            Grid::Visagge(grid) => grid.bytes(),
            Grid::Standard(grid) => grid.bytes(),
            Grid::Visits(grid) => grid.bytes(),
        }
    }
}
