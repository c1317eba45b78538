//! The mapper thread: takes scans and poses in the order in which they arrived, and tells the others what came of
//! them. The grid's state depends on that order alone, which is what the recording keeps. What it has to do about loops takes
//! long, and is done by a thread of its own.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender as PlainSender};
use hdrhistogram::Histogram;
use log::{info, warn};

use super::clock;
use super::queues::Sender;
use super::shared::{Shared, lock};
use crate::closing::{Done, Task, moved::Moved};
use crate::grid::snapshot::Snapshot;
use crate::mapper::{Mapper, MapperReport, Outcome, ScanTime, times};
use crate::pose::{Pose, StampedPose};
use crate::record::{Attachment, Record};
use crate::saved::SavedMap;
use crate::scan::Scan;

/// Longest wait for an entry, so that the watchdog sees a mapper with nothing to do as one that works.
const PATIENCE: Duration = Duration::from_millis(500);
/// How often the others learn what was done.
const REPORT_PERIOD: Duration = Duration::from_secs(1);
/// How long the end waits for loops to be closed: some searches of a drive of 300 m. A service is given a minute in all.
const PATIENCE_WITH_LOOPS: Duration = Duration::from_secs(15);
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
    /// A loop was closed: what was inserted until now lies elsewhere.
    Moved(Arc<Moved>),
    /// The map as it stands.
    Map(Arc<Snapshot>, Box<MapperReport>),
    /// All that the grid knows, to be kept for the next run.
    Saved(Box<SavedMap>),
}

/// The way to the thread that does the tasks of the mapper and back, one at a time.
pub struct Tasks {
    /// To it.
    pub to_do: PlainSender<Task>,
    /// From it.
    pub done: Receiver<Done>,
    /// Whether one is there.
    pub is_away: bool,
}

/// Does tasks until no more come.
pub fn do_tasks(to_do: &Receiver<Task>, done: &PlainSender<Done>) {
    for task in to_do {
        // At the end nobody may be waiting for it any more.
        let _ = done.send(task.run());
    }
}

/// See the module.
pub struct Mapping {
    /// The grid and the poses.
    pub mapper: Mapper,
    /// Where the map and the trajectory go.
    pub main: Sender<FromMapper>,
    /// Where all goes that is recorded.
    pub recorder: Option<Sender<Record>>,
    /// Who does what takes long; `None` where loops are not closed.
    pub tasks: Option<Tasks>,
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
            let came = inbox.recv_timeout(PATIENCE);
            self.take_back(scans_taken, Duration::ZERO);
            self.tell_outcomes(&mut delays);
            match came {
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
            self.give_task();
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
        self.do_last_tasks(scans_taken);
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

    /// Gives what is to be done about loops to the thread that does it, where that has nothing to do.
    fn give_task(&mut self) {
        if let Some(tasks) = &mut self.tasks
            && !tasks.is_away
            && let Some(task) = self.mapper.next_task()
        {
            tasks.is_away = tasks.to_do.send(task).is_ok();
        }
    }

    /// Takes a task back if it is done within a time, and gives the next one away.
    fn take_back(&mut self, scans_taken: u32, patience: Duration) {
        let Some(tasks) = self.tasks.as_mut().filter(|tasks| tasks.is_away) else { return };
        let done = match tasks.done.recv_timeout(patience) {
            Ok(done) => done,
            Err(RecvTimeoutError::Timeout) => return,
            // Main has heard of its end as well.
            Err(RecvTimeoutError::Disconnected) => return self.tasks = None,
        };
        tasks.is_away = false;
        if let Some(recorder) = &self.recorder {
            recorder.offer(Record::TaskDone { scans_before: scans_taken });
        }
        self.mapper.take_back(done);
        self.give_task();
    }

    /// Closes what loops there are, as far as that is done in time.
    fn do_last_tasks(&mut self, scans_taken: u32) {
        let deadline = Instant::now() + PATIENCE_WITH_LOOPS;
        loop {
            let Some(tasks) = &mut self.tasks else { return };
            if !tasks.is_away {
                let Some(task) = self.mapper.last_task() else { return };
                tasks.is_away = tasks.to_do.send(task).is_ok();
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                warn!(
                    "loops of the last metres are not closed, for want of time; a replay with --optimize does it"
                );
                return;
            }
            self.take_back(scans_taken, left);
            self.shared.mapper_steps.count();
        }
    }

    fn tell_outcomes(&mut self, delays: &mut Delays) {
        while let Some(outcome) = self.mapper.next_outcome() {
            delays.note(&outcome);
            match outcome {
                Outcome::Inserted { stamp_ns, start: pose, .. } => {
                    self.main.offer(FromMapper::Inserted { stamp_ns, pose });
                    if let Some(recorder) = &self.recorder {
                        recorder.offer(Record::PoseUsed { stamp_ns, pose });
                    }
                }
                Outcome::Moved(moved) => {
                    self.main.offer(FromMapper::Moved(moved));
                    if let Some(closed) = self.mapper.report().loops.and_then(|loops| loops.last) {
                        info!("{closed}");
                    }
                }
                Outcome::Skipped { .. } => {}
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
        let map = Arc::new(self.mapper.snapshot());
        self.main.hand_over(FromMapper::Map(Arc::clone(&map), Box::new(self.report(delays))), patience);
        let Some(recorder) = &self.recorder else { return };
        recorder.hand_over(Record::Map(Arc::clone(&map)), patience);
        if patience.is_zero() {
            return;
        }
        if let Ok(data) = crate::output::npz(map.map()) {
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
        let Some(seq) = outcome.seq() else { return };
        let Some(place) = self.waiting.iter().position(|waiting| waiting.0 == seq) else { return };
        let Some((_, received_ns)) = self.waiting.remove(place) else { return };
        if let Outcome::Inserted { .. } = outcome {
            self.ns.saturating_record(u64::try_from(clock::monotonic_ns() - received_ns).unwrap_or(0));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::closing::tests::{settings, taken};
    use crate::live::queues::{TO_MAIN, TO_RECORDER, queue};
    use crate::localize::tests::ring;
    use crossbeam_channel::{bounded, unbounded};

    /// Scans and poses all at once, the tasks beside: whenever these were done, it can be told from what was recorded.
    #[test]
    fn loops_are_closed_beside_and_again_in_the_same_places() {
        let (to_mapper, inbox) = unbounded();
        let walls = ring();
        for seq in 0..800 {
            let (odometry, scan) = taken(&walls, seq);
            odometry.into_iter().for_each(|pose| to_mapper.send(ToMapper::Pose(pose)).unwrap());
            to_mapper.send(ToMapper::Scan(scan)).unwrap();
        }
        drop(to_mapper);
        let (main, news, _) = queue(&TO_MAIN);
        let (recorder, records, _) = queue(&TO_RECORDER);
        let ((to_do, todo), (done_to, done)) = (bounded(1), bounded(1));
        let worker = std::thread::spawn(move || do_tasks(&todo, &done_to));
        let mapping = Mapping {
            mapper: Mapper::new(settings(true)),
            main,
            recorder: Some(recorder),
            tasks: Some(Tasks { to_do, done, is_away: false }),
            map_every: Duration::MAX,
            save_every: None,
            shared: Arc::default(),
        };
        mapping.run(&inbox);
        worker.join().unwrap();

        let mut again = Mapper::new(settings(true));
        let mut task = None;
        for record in records.try_iter() {
            match record {
                Record::PoseReceived { pose, .. } => again.on_pose(pose),
                Record::Scan(scan) => again.on_scan(Scan::clone(&scan)),
                Record::TaskDone { .. } => {
                    let task = task.take().or_else(|| again.last_task()).expect("it was given away");
                    again.take_back(Task::run(task));
                }
                _ => continue,
            }
            task = task.or_else(|| again.next_task());
        }
        again.finish();
        let mut closed = 0;
        let mut last = None;
        for news in news.try_iter() {
            match news {
                FromMapper::Moved(_) => closed += 1,
                FromMapper::Map(map, report) => last = Some((map, report.loops)),
                FromMapper::Inserted { .. } | FromMapper::Saved(_) => {}
            }
        }
        let (map, loops) = last.unwrap();
        assert!(closed > 0, "{loops:?}");
        assert_eq!(again.report().loops, loops);
        assert!(again.map() == *map.map(), "the maps differ");
    }
}
