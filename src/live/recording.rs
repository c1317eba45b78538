//! The recorder thread: writes what the others hand it, and completes the file at the end.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError};
use log::error;

use super::clock;
use super::shared::lock;
use crate::record::{Record, Recorder, RecorderReport};

/// How often the clocks are looked at: files are also synced and begun anew while nothing comes.
const PERIOD: Duration = Duration::from_millis(250);

/// Writes until all senders are gone. Errors do not end it: a disk that is full may not stay so, and the map is made
/// without a recording too. They are logged and counted, and show in the exit code.
pub fn run(mut recorder: Recorder, inbox: &Receiver<Record>, report: &Arc<Mutex<RecorderReport>>) {
    let mut last_look = Instant::now();
    loop {
        let mut written = match inbox.recv_timeout(PERIOD) {
            Ok(record) => recorder.write(&record),
            Err(RecvTimeoutError::Timeout) => Ok(()),
            Err(RecvTimeoutError::Disconnected) => break,
        };
        if written.is_ok() && last_look.elapsed() >= PERIOD {
            last_look = Instant::now();
            let clocks = clock::both();
            recorder.on_clocks(clocks.realtime_ns, clocks.monotonic_ns);
            written = recorder.on_time(clocks.monotonic_ns);
            lock(report).clone_from(recorder.report());
        }
        if let Err(error) = written {
            error!("the recording is interrupted: {error}");
        }
    }
    *lock(report) = match recorder.close() {
        Ok(report) => report,
        Err((report, error)) => {
            error!("the recording could not be completed: {error}");
            report
        }
    };
}
