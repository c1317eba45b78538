//! A replay in two passes: the first locates the scans and finds where the drive came back, the second maps them where they
//! belong.

use std::collections::{HashMap, VecDeque};

use super::{Feeder, Progress, Replay, ReplayError, ReplayOptions, Tasks, open, settings};
use crate::input::{InputReport, Sink};
use crate::localize::loops::{Drive, Loops};
use crate::localize::points::Points;
use crate::mapper::{Mapper, MapperSettings, Outcome, PoseUse, SkipReason};
use crate::pose::{Pose, StampedPose, interpolate};
use crate::scan::Scan;

/// Where a scan was taken, by the first pass.
#[derive(Clone, Copy, Debug)]
struct Place {
    /// Way driven until there (m).
    way: f64,
    start: Pose,
    end: Pose,
}

/// See [`super::run`].
pub(super) fn run(
    options: &ReplayOptions,
    on_outcome: &mut dyn FnMut(Outcome),
    on_progress: &mut dyn FnMut(Progress),
) -> Result<Replay, ReplayError> {
    let mut report = InputReport::default();
    let mut source = open(options, &mut report)?;
    // Here loops are closed with all of the drive at hand.
    let settings = MapperSettings { close_loops: false, ..settings(options, source.as_ref())? };
    // Each pass is half of the work.
    let total = 2 * source.bytes();
    let mut located = Located {
        mapper: Mapper::new(settings.clone()),
        waiting: VecDeque::new(),
        places: HashMap::new(),
        drive: Drive::default(),
        settings: settings.clone(),
        on_progress,
        total,
    };
    source.feed(&mut located, &mut report)?;
    located.mapper.finish();
    located.take_outcomes();
    let Located { mapper: first, mut places, mut drive, .. } = located;

    let loops = drive.close(None);
    if let Loops::Bent(correction) = &loops {
        for place in places.values_mut().flatten() {
            place.start = correction.correct(place.way, &place.start);
            place.end = correction.correct(place.way, &place.end);
        }
    }

    let mut report = InputReport::default();
    let mut source = open(options, &mut report)?;
    report.note(loops.to_string());
    let given = MapperSettings { poses: PoseUse::Map, ..settings.clone() };
    let mut placed = Placed {
        feeder: Feeder {
            mapper: Mapper::new(given),
            tasks: Tasks::AtOnce,
            wall_offset_ns: source.wall_offset_ns(),
            on_outcome,
            on_progress,
            progress: Progress { bytes: total / 2, total },
        },
        places,
        half: total / 2,
    };
    source.feed(&mut placed, &mut report)?;
    let mut feeder = placed.feeder;
    feeder.give_outcomes();
    feeder.progress(total);
    let localization = first.report().localization;
    Ok(Replay { mapper: feeder.mapper, localization, settings, input: report, map_file: None })
}

/// First pass.
struct Located<'a> {
    mapper: Mapper,
    /// Scans of which the mapper has not told yet.
    waiting: VecDeque<Scan>,
    places: HashMap<u64, Result<Place, SkipReason>>,
    drive: Drive,
    settings: MapperSettings,
    on_progress: &'a mut dyn FnMut(Progress),
    total: u64,
}

impl Located<'_> {
    fn take_outcomes(&mut self) {
        while let Some(outcome) = self.mapper.next_outcome() {
            let Some(seq) = outcome.seq() else { continue };
            let scan =
                self.waiting.iter().position(|scan| scan.seq == seq).and_then(|at| self.waiting.remove(at));
            let place = match outcome {
                Outcome::Inserted { start, end, .. } => {
                    let way = scan.map_or(0.0, |scan| self.add(scan, &start, &end));
                    Ok(Place { way, start, end })
                }
                Outcome::Skipped { reason, .. } => Err(reason),
                Outcome::Moved(_) => continue,
            };
            // Of scans with the same number the first is the one that counts.
            self.places.entry(seq).or_insert(place);
        }
    }

    fn add(&mut self, mut scan: Scan, start: &Pose, end: &Pose) -> f64 {
        let mount = self.settings.mount.pose();
        let (start, end) = (start * mount, end * mount);
        let middle = interpolate(&start, &end, 0.5);
        let (settings, mapper) = (&self.settings.localize, &self.mapper);
        self.drive.add(&middle, || {
            mapper.prepare(&mut scan);
            let mut points = Points::default();
            let own = [start, end].map(|pose| middle.inverse() * pose);
            points.read(&scan, own[0], own[1], settings.spacing, settings.points);
            points
        })
    }
}

impl Sink for Located<'_> {
    fn on_pose(&mut self, pose: StampedPose) {
        self.mapper.on_pose(pose);
        self.take_outcomes();
    }

    fn on_scan(&mut self, scan: Scan) {
        self.waiting.push_back(scan.clone());
        self.mapper.on_scan(scan);
        self.take_outcomes();
    }

    fn on_progress(&mut self, bytes: u64) {
        (self.on_progress)(Progress { bytes, total: self.total });
    }
}

/// Second pass.
struct Placed<'a> {
    feeder: Feeder<'a>,
    places: HashMap<u64, Result<Place, SkipReason>>,
    /// Where the first pass ended, of the progress (bytes).
    half: u64,
}

impl Sink for Placed<'_> {
    fn on_pose(&mut self, _: StampedPose) {}

    fn on_scan(&mut self, scan: Scan) {
        let place = self.places.remove(&scan.seq).unwrap_or(Err(SkipReason::OutOfOrder));
        self.feeder.mapper.on_located(scan, place.map(|place| (place.start, place.end)));
        self.feeder.give_outcomes();
    }

    fn on_progress(&mut self, bytes: u64) {
        self.feeder.on_progress(self.half + bytes);
    }
}
