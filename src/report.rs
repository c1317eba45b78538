//! report.json: what went into a map and what did not, in numbers.
//!
//! Not the log: it says how often, not when.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::Serialize;

use crate::input::InputReport;
use crate::map::Map;
use crate::mapper::{MapperReport, MapperSettings};
use crate::record::RecorderReport;

/// The report of a run, live or replayed.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Versions of the parts that made the map.
    pub versions: Versions,
    /// `live` or `replay`.
    pub mode: Mode,
    /// Whether the run has ended; false in the reports that are written while it runs.
    pub finished: bool,
    /// What the scans came from: the scanner's URL, or the names of the files.
    pub inputs: Vec<String>,
    /// Wall-clock time at which the run began (s since the Unix epoch).
    pub started_s: f64,
    /// Time that the run has taken so far (s).
    pub elapsed_s: f64,
    /// What the scanner told about itself, by the names of the protocol.
    pub device: BTreeMap<String, String>,
    /// Scans read, inserted, and skipped by reason; time of insertions.
    #[serde(flatten)]
    pub mapper: MapperReport,
    /// Poses from outside, taken or not.
    pub poses: PoseCounts,
    /// Every bounded queue between the threads.
    pub queues: BTreeMap<&'static str, QueueReport>,
    /// Replies and bytes that the decoder could not use, by kind.
    pub decode_errors: BTreeMap<String, u64>,
    /// What was read, and what of it could not be; absent in a live run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub input: Option<InputReport>,
    /// What the recorder kept; absent where nothing was recorded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recording: Option<RecorderReport>,
    /// The map's size and content.
    pub map: MapSummary,
    /// The settings of the run as a whole.
    pub settings: serde_json::Value,
}

impl Report {
    /// The report of a replay.
    pub fn of_replay(
        map: &Map,
        mapper: MapperReport,
        input: InputReport,
        settings: &MapperSettings,
        started_s: f64,
        elapsed: Duration,
    ) -> Self {
        Self {
            versions: Versions::default(),
            mode: Mode::Replay,
            finished: true,
            inputs: input.files.iter().map(|file| file.display().to_string()).collect(),
            started_s,
            elapsed_s: elapsed.as_secs_f64(),
            device: BTreeMap::new(),
            mapper,
            poses: PoseCounts { accepted: input.poses, rejected: BTreeMap::new() },
            queues: BTreeMap::new(),
            decode_errors: input.decode_errors.clone(),
            input: Some(input),
            recording: None,
            map: MapSummary::of(map),
            settings: serde_json::json!({ "mapper": settings }),
        }
    }
}

/// Versions of the parts.
#[derive(Clone, Debug, Serialize)]
pub struct Versions {
    /// The program.
    pub visagged: &'static str,
    /// Format of this report: grows when a field changes its meaning.
    pub report: u32,
}

impl Default for Versions {
    fn default() -> Self {
        Self { visagged: env!("CARGO_PKG_VERSION"), report: 1 }
    }
}

/// Where the scans of a run come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// A scanner.
    Live,
    /// Files.
    Replay,
}

/// Poses that came from outside.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PoseCounts {
    /// Poses given to the mapper.
    pub accepted: u64,
    /// Datagrams that were not, by cause.
    pub rejected: BTreeMap<&'static str, u64>,
}

/// What a bounded queue did.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct QueueReport {
    /// Entries that it holds at most.
    pub capacity: usize,
    /// What happens to an entry that finds it full.
    pub when_full: &'static str,
    /// Entries that were put in.
    pub accepted: u64,
    /// Entries that found it full and were lost.
    pub dropped: u64,
    /// Most entries that it held.
    pub most: usize,
}

/// A map in a few numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MapSummary {
    /// Cells in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Side of a cell (m).
    pub resolution: f64,
    /// Lower left corner (m).
    pub origin: [f64; 2],
    /// Cells by what they are.
    pub free: usize,
    /// See `free`.
    pub occupied: usize,
    /// Those of the occupied cells that are drawn blue in map.png.
    pub specular_like: usize,
    /// See `free`.
    pub unknown: usize,
}

impl MapSummary {
    /// Counts the cells.
    pub fn of(map: &Map) -> Self {
        let count = |wanted: fn(&i8) -> bool| map.occupancy.iter().filter(|cell| wanted(cell)).count();
        let specular = |&(occupancy, visibility): &(&i8, &i8)| {
            *occupancy == 100 && *visibility >= crate::output::SPECULAR_FROM
        };
        Self {
            width: map.width,
            height: map.height,
            resolution: map.resolution,
            origin: map.origin,
            free: count(|cell| *cell == 0),
            occupied: count(|cell| *cell == 100),
            specular_like: map.occupancy.iter().zip(&map.visibility).filter(specular).count(),
            unknown: count(|cell| *cell < 0),
        }
    }
}
