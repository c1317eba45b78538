//! The mapper thread: takes scans and poses in the order in which they arrived, and tells the others what came of
//! them. The grid's state depends on that order alone, which is what the recording keeps.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError};
use hdrhistogram::Histogram;

use super::clock;
use super::queues::Sender;
use super::shared::{Shared, lock};
use crate::map::Map;
use crate::mapper::{Mapper, MapperReport, Outcome, ScanTime, times};
use crate::pose::{Pose, StampedPose};
use crate::record::{Attachment, Record};
use crate::saved::SavedMap;
use crate::scan::Scan;

/// Longest wait for an entry, so that the watchdog sees a mapper with nothing to do as one that works.
const PATIENCE: Duration = Duration::from_millis(500);
/// How often the others learn what was done.
const REPORT_PERIOD: Duration = Duration::from_secs(1);
/// How long the last map may wait for the others to make room.
const PATIENCE_AT_END: Duration = Duration::from_secs(20);

/// What the mapper takes.
#[derive(Debug)]
pub enum ToMapper {
    /// From the driver.
    Scan(Scan),
    /// From the pose thread.
    Pose(StampedPose),
}

/// What the mapper tells main.
#[derive(Debug)]
pub enum FromMapper {
    /// A scan was inserted here.
    Inserted {
        /// Time of its first beam (ns, monotonic).
        stamp_ns: i64,
        /// base_link then.
        pose: Pose,
    },
    /// The map as it stands.
    Map(Arc<Map>, Box<MapperReport>),
    /// All that the grid knows, to be kept for the next run.
    Saved(Box<SavedMap>),
}

/// See the module.
pub struct Mapping {
    /// The grid and the poses.
    pub mapper: Mapper,
    /// Where the map and the trajectory go.
    pub main: Sender<FromMapper>,
    /// Where all goes that is recorded.
    pub recorder: Option<Sender<Record>>,
    /// Time between two maps.
    pub map_every: Duration,
    /// Time between two savings; `None` where the map is not kept.
    pub save_every: Option<Duration>,
    /// Progress.
    pub shared: Arc<Shared>,
}

impl Mapping {
    /// Maps until both senders are gone, then decides on the scans that still wait and gives the last map.
    pub fn run(mut self, inbox: &Receiver<ToMapper>) {
        let mut scans_taken = 0;
        let mut delays = Delays { waiting: VecDeque::new(), ns: times() };
        let mut last_map = Instant::now();
        let mut last_report = Instant::now();
        let mut last_saved = Instant::now();
        let mut saved_scans = 0;
        loop {
            match inbox.recv_timeout(PATIENCE) {
                Ok(ToMapper::Scan(scan)) => {
                    if let Some(recorder) = &self.recorder {
                        recorder.offer(Record::Scan(Arc::new(scan.clone())));
                    }
                    delays.waiting.push_back((scan.seq, scan.received_ns));
                    self.mapper.on_scan(scan);
                    scans_taken += 1;
                }
                Ok(ToMapper::Pose(pose)) => {
                    if let Some(recorder) = &self.recorder {
                        recorder.offer(Record::PoseReceived { pose, scans_before: scans_taken });
                    }
                    self.mapper.on_pose(pose);
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            self.tell_outcomes(&mut delays);
            if last_report.elapsed() >= REPORT_PERIOD {
                *lock(&self.shared.mapper) = Some(self.report(&delays));
                last_report = Instant::now();
            }
            if last_map.elapsed() >= self.map_every {
                self.tell_map(&delays, Duration::ZERO);
                last_map = Instant::now();
            }
            if self.save_every.is_some_and(|every| last_saved.elapsed() >= every) {
                self.save(&mut saved_scans, Duration::ZERO);
                last_saved = Instant::now();
            }
            self.shared.mapper_steps.count();
        }
        self.mapper.finish();
        self.tell_outcomes(&mut delays);
        if self.save_every.is_some() {
            self.save(&mut saved_scans, PATIENCE_AT_END);
        }
        self.tell_map(&delays, PATIENCE_AT_END);
    }

    fn report(&self, delays: &Delays) -> MapperReport {
        MapperReport { latency_us: Some(ScanTime::of(&delays.ns)), ..self.mapper.report() }
    }

    fn tell_outcomes(&mut self, delays: &mut Delays) {
        while let Some(outcome) = self.mapper.next_outcome() {
            delays.note(&outcome);
            let Outcome::Inserted { stamp_ns, start, .. } = outcome else { continue };
            self.main.offer(FromMapper::Inserted { stamp_ns, pose: start });
            if let Some(recorder) = &self.recorder {
                recorder.offer(Record::PoseUsed { stamp_ns, pose: start });
            }
        }
    }

    /// Gives the map to be saved, where it has changed since.
    fn save(&mut self, saved_scans: &mut u64, patience: Duration) {
        let scans = self.mapper.scans_inserted();
        if scans > *saved_scans
            && let Some(saved) = self.mapper.save()
            && self.main.hand_over(FromMapper::Saved(Box::new(saved)), patience)
        {
            *saved_scans = scans;
        }
    }

    fn tell_map(&mut self, delays: &Delays, patience: Duration) {
        let map = Arc::new(self.mapper.map());
        self.main.hand_over(FromMapper::Map(Arc::clone(&map), Box::new(self.report(delays))), patience);
        let Some(recorder) = &self.recorder else { return };
        recorder.hand_over(Record::Map(Arc::clone(&map)), patience);
        if patience.is_zero() {
            return;
        }
        if let Ok(data) = crate::output::npz(&map) {
            let name = "map.npz".into();
            let attachment = Attachment { name, media_type: "application/x-npz".into(), data };
            recorder.hand_over(Record::Attachment(attachment), patience);
        }
    }
}

/// How long scans take from their last byte to the map.
struct Delays {
    /// Numbers of the scans that were taken and when their last byte came (ns, monotonic).
    waiting: VecDeque<(u64, i64)>,
    ns: Histogram<u64>,
}

impl Delays {
    /// Takes the time of a scan that is in the map by now. Every scan has one outcome, in the order of their numbers but for those
    /// that are out of order.
    fn note(&mut self, outcome: &Outcome) {
        let (Outcome::Inserted { seq, .. } | Outcome::Skipped { seq, .. }) = *outcome;
        let Some(place) = self.waiting.iter().position(|waiting| waiting.0 == seq) else { return };
        let Some((_, received_ns)) = self.waiting.remove(place) else { return };
        if let Outcome::Inserted { .. } = outcome {
            self.ns.saturating_record(u64::try_from(clock::monotonic_ns() - received_ns).unwrap_or(0));
        }
    }
}
