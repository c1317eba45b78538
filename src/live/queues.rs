//! Every queue between the threads: how much it holds, what happens when it is full, and what did happen.
//!
//! | from | to | policy |
//! |---|---|---|
//! | driver, poses | mapper | [`TO_MAPPER`] |
//! | driver, mapper, main | recorder | [`TO_RECORDER`] |
//! | mapper | main | [`TO_MAIN`] |
//!
//! Between the mapper and the thread that does its tasks about loops there is one task at most, and it is waited for by neither.
//!
//! A sender never waits while the run lasts ([`Sender::offer`]): the scanner's bytes do not wait either. Only what is
//! due at the very end, when no more bytes come, is waited for ([`Sender::hand_over`]).

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering::Relaxed};
use std::time::Duration;

use crate::report::QueueReport;

/// What a queue promises.
#[derive(Debug)]
pub struct Policy {
    /// Name in report.json.
    pub name: &'static str,
    /// Entries that it holds at most.
    pub capacity: usize,
    /// What happens to an entry that finds it full.
    pub when_full: &'static str,
}

/// Scans and poses in the order in which the mapper takes them: 2 s of a scanner at 40 Hz with poses at 200 Hz.
pub const TO_MAPPER: Policy = Policy {
    name: "to_mapper",
    capacity: 480,
    when_full: "the newest is refused and counted; a refused scan leaves a gap in the numbers of the scans, which ends \
                the grid's runs",
};

/// What is recorded: 10 s at 40 Hz with four reads a scan and poses at 200 Hz; at most 4 KiB each, so 40 MB.
pub const TO_RECORDER: Policy = Policy {
    name: "to_recorder",
    capacity: 10_000,
    when_full: "the newest is refused and counted; refused bytes leave a gap in stream_offset",
};

/// Poses for the trajectory and maps to write: 60 s at 40 Hz, which is how long writing a set of files may take.
pub const TO_MAIN: Policy = Policy {
    name: "to_main",
    capacity: 2_400,
    when_full: "the newest is refused and counted; a pose is then missing in trajectory.tum, or those before a loop \
                was closed stay where they were, or the map's files are written at the next time",
};

#[derive(Debug, Default)]
struct Counters {
    accepted: AtomicU64,
    dropped: AtomicU64,
    most: AtomicUsize,
}

/// The end of a queue that is written to.
#[derive(Debug)]
pub struct Sender<T> {
    channel: crossbeam_channel::Sender<T>,
    counters: Arc<Counters>,
}

// Not derived: that would ask for T: Clone.
impl<T> Clone for Sender<T> {
    fn clone(&self) -> Self {
        Self { channel: self.channel.clone(), counters: Arc::clone(&self.counters) }
    }
}

/// What a queue did so far, seen from outside.
#[derive(Clone, Debug)]
pub struct Gauge {
    policy: &'static Policy,
    counters: Arc<Counters>,
}

/// A queue of this policy.
pub fn queue<T>(policy: &'static Policy) -> (Sender<T>, crossbeam_channel::Receiver<T>, Gauge) {
    let (channel, receiver) = crossbeam_channel::bounded(policy.capacity);
    let counters = Arc::new(Counters::default());
    (Sender { channel, counters: Arc::clone(&counters) }, receiver, Gauge { policy, counters })
}

impl<T> Sender<T> {
    /// Puts an entry in, or counts it as lost, at once. Says whether it is in.
    pub fn offer(&self, entry: T) -> bool {
        self.count(self.channel.try_send(entry).is_ok())
    }

    /// Puts an entry in, and waits for room for a while.
    pub fn hand_over(&self, entry: T, patience: Duration) -> bool {
        self.count(self.channel.send_timeout(entry, patience).is_ok())
    }

    fn count(&self, is_in: bool) -> bool {
        if is_in {
            self.counters.accepted.fetch_add(1, Relaxed);
            self.counters.most.fetch_max(self.channel.len(), Relaxed);
        } else {
            self.counters.dropped.fetch_add(1, Relaxed);
        }
        is_in
    }
}

impl Gauge {
    /// Name in report.json.
    pub fn name(&self) -> &'static str {
        self.policy.name
    }

    /// The counts so far.
    pub fn read(&self) -> QueueReport {
        QueueReport {
            capacity: self.policy.capacity,
            when_full: self.policy.when_full,
            accepted: self.counters.accepted.load(Relaxed),
            dropped: self.counters.dropped.load(Relaxed),
            most: self.counters.most.load(Relaxed),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OF_TWO: Policy = Policy { name: "of_two", capacity: 2, when_full: "refused" };

    #[test]
    fn the_newest_is_refused_and_counted() {
        let (sender, receiver, gauge) = queue(&OF_TWO);
        assert_eq!([1, 2, 3].map(|entry| sender.offer(entry)), [true, true, false]);
        assert!(!sender.hand_over(4, Duration::ZERO));
        assert_eq!(receiver.try_iter().collect::<Vec<_>>(), [1, 2]);
        assert!(sender.offer(5));
        let report = gauge.read();
        assert_eq!((report.accepted, report.dropped, report.most), (3, 2, 2));
    }

    #[test]
    fn an_entry_for_a_thread_that_is_gone_is_lost_and_counted() {
        let (sender, receiver, gauge) = queue(&OF_TWO);
        drop(receiver);
        assert!(!sender.offer(1));
        assert_eq!(gauge.read().dropped, 1);
    }
}
