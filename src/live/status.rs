//! What people see of a run: a line on the terminal, a line in the log now and then, a line for the service manager.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering::Relaxed;
use std::time::{Duration, Instant};

use log::info;

use super::shared::{Shared, lock};
use crate::closing::ClosingReport;
use crate::logging::Progress;
use crate::map::Map;
use crate::mapper::MapperReport;

/// How often the log gets a line where no terminal shows one.
const LOG_PERIOD: Duration = Duration::from_secs(60);
const SECOND: Duration = Duration::from_secs(1);

/// See the module.
pub struct Status {
    progress: Option<Progress>,
    text: String,
    last_second: Instant,
    is_second: bool,
    last_log: Instant,
    last_feeding: Instant,
    seen_steps: (u64, u64),
}

impl Status {
    /// Shows a line on stderr where that is a terminal.
    pub fn new() -> Self {
        let now = Instant::now();
        Self {
            progress: std::io::stderr().is_terminal().then(Progress::start),
            text: String::new(),
            last_second: now,
            is_second: false,
            last_log: now,
            last_feeding: now,
            seen_steps: (0, 0),
        }
    }

    /// Looks at the run, and shows it.
    pub fn on_tick(&mut self, shared: &Shared, elapsed: Duration) {
        self.text = describe(shared);
        if let Some(progress) = &self.progress {
            progress.show(&format!("{:6.1} s  {}", elapsed.as_secs_f64(), self.text));
        } else if self.last_log.elapsed() >= LOG_PERIOD {
            self.last_log = Instant::now();
            info!("{}", self.text);
        }
        self.is_second = self.last_second.elapsed() >= SECOND;
        if self.is_second {
            self.last_second = Instant::now();
        }
    }

    /// Whether a second has passed since this was last true.
    pub fn is_second(&self) -> bool {
        self.is_second
    }

    /// The run in one line.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Whether the watchdog, with its period, is to be fed: a fourth of the period has passed, and in it both the
    /// driver and the mapper have made progress.
    pub fn both_made_progress(&mut self, shared: &Shared, watchdog: Option<Duration>) -> bool {
        let Some(period) = watchdog else { return false };
        let steps = (shared.driver_steps.get(), shared.mapper_steps.get());
        let is_due = self.last_feeding.elapsed() >= period / 4;
        if !is_due || steps.0 == self.seen_steps.0 || steps.1 == self.seen_steps.1 {
            return false;
        }
        self.seen_steps = steps;
        self.last_feeding = Instant::now();
        true
    }

    /// Takes the line away.
    pub fn clear(&mut self) {
        self.progress = None;
    }

    /// The last words.
    pub fn summary(&self, map: &Map, mapper: &MapperReport, folder: Option<&Path>, recordings: &[PathBuf]) {
        info!(
            "{} of {} scans are in the map ({:.1} x {:.1} m), {:.0} us each",
            mapper.scans_inserted,
            mapper.scans_read,
            map.width as f64 * map.resolution,
            map.height as f64 * map.resolution,
            mapper.insert_us.mean,
        );
        for (reason, count) in &mapper.scans_skipped {
            info!("{count} scans are not: {reason:?}");
        }
        for recording in recordings {
            info!("recorded: {}", recording.display());
        }
        if let Some(folder) = folder {
            info!("the map: {}", folder.join("map.png").display());
        }
    }
}

fn describe(shared: &Shared) -> String {
    let scans = shared.scans.load(Relaxed);
    let mapped = lock(&shared.mapper).as_ref().map_or_else(String::new, |report| {
        let place = report.localization.as_ref().map_or("", |found| found.in_words());
        let loaded = report.scans_loaded;
        let earlier = if loaded > 0 { format!(" + {loaded} of earlier runs") } else { String::new() };
        let loops = report.loops.as_ref().map_or_else(String::new, ClosingReport::in_words);
        format!(
            ", {}{earlier} in the map of {:.1} MB{place}{loops}",
            report.scans_inserted,
            report.map_bytes as f64 / 1e6
        )
    });
    let waiting = if shared.is_open.load(Relaxed) { "" } else { ", waiting for the scanner" };
    format!("{scans} scans{mapped}{waiting}")
}
