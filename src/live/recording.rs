//! The recorder thread: writes what the others hand it, and completes the file at the end.

use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use crossbeam_channel::{Receiver, TryRecvError};
use log::error;

use super::clock;
use super::shared::lock;
use crate::record::{Record, RecordError, Recorder, RecorderReport};

/// How often it looks for records, and at the clocks: files are also synced and begun anew while nothing comes. To be woken for each of
/// some hundred records a second would take a tenth of the daemon's CPU; a twentieth of a second of them is half a percent of what the
/// queue holds.
const PERIOD: Duration = Duration::from_millis(50);

/// Writes until all senders are gone. Errors do not end it: a disk that is full may not stay so, and the map is made
/// without a recording too. They are logged and counted, and show in the exit code.
pub fn run(mut recorder: Recorder, inbox: &Receiver<Record>, report: &Arc<Mutex<RecorderReport>>) {
    let tell = |written: Result<(), RecordError>| {
        if let Err(error) = written {
            error!("the recording is interrupted: {error}");
        }
    };
    loop {
        match inbox.try_recv() {
            Ok(record) => tell(recorder.write(&record)),
            Err(TryRecvError::Disconnected) => break,
            Err(TryRecvError::Empty) => {
                let clocks = clock::both();
                recorder.on_clocks(clocks.realtime_ns, clocks.monotonic_ns);
                tell(recorder.on_time(clocks.monotonic_ns));
                lock(report).clone_from(recorder.report());
                thread::sleep(PERIOD);
            }
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
