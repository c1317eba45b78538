//! The driver thread: owns the port and the session, carries out what the session wants, and hands on what it gives.
//!
//! It never waits for another thread. All bytes go to the recorder with the very times that the decoder was given,
//! so that a replay decodes the same scans with the same stamps.

use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use log::{debug, error, info, warn};
use scip::transport::{Received, Transport};
use scip::{Action, Event, Session, SessionEvent, State};

use super::clock;
use super::mapping::ToMapper;
use super::queues::Sender;
use super::shared::{Shared, lock};
use crate::record::{Direction, Record};
use crate::scan::Scan;

/// Longest wait for bytes, and so for the news that the run is to end.
const PATIENCE: Duration = Duration::from_millis(50);
/// More than a scan of 1081 steps with intensities (6717 bytes) brings at once.
const BUFFER: usize = 8192;

/// Opens the connection; called anew for each attempt.
pub type Opener = Box<dyn FnMut() -> io::Result<Box<dyn Transport>> + Send>;

/// See the module.
pub struct Driver {
    /// What the scanner is asked for, and how it is kept going.
    pub session: Session,
    /// How to reach it.
    pub opener: Opener,
    /// Where it is, for messages.
    pub url: String,
    /// Where scans go.
    pub mapper: Sender<ToMapper>,
    /// Where bytes go.
    pub recorder: Option<Sender<Record>>,
    /// Progress and counts.
    pub shared: Arc<Shared>,
    /// The device as the recording knows it; `None` at the start.
    pub recorded_device: Option<Arc<scip::Device>>,
}

/// What the loop carries from turn to turn.
struct Wire {
    port: Option<Box<dyn Transport>>,
    received: u64,
    sent: u64,
    last_open_error: Option<String>,
    is_stopping: bool,
}

impl Driver {
    /// Runs until told to stop: then the laser is off and the port closed.
    pub fn run(mut self) {
        let mut wire = Wire { port: None, received: 0, sent: 0, last_open_error: None, is_stopping: false };
        let mut buffer = vec![0; BUFFER];
        loop {
            while let Some(action) = self.session.next_action() {
                self.carry_out(action, &mut wire);
            }
            self.hand_on_events();
            if self.session.state() == State::Stopped {
                break;
            }
            if self.shared.stop_driver.load(Relaxed) && !wire.is_stopping {
                wire.is_stopping = true;
                self.session.stop(clock::monotonic_ns());
                continue;
            }
            self.receive(&mut wire, &mut buffer);
            self.session.on_time(clock::monotonic_ns());
            self.shared.driver_steps.count();
        }
        self.shared.is_open.store(false, Relaxed);
    }

    fn carry_out(&mut self, action: Action, wire: &mut Wire) {
        match action {
            Action::Open => match (self.opener)() {
                Ok(port) => {
                    wire.port = Some(port);
                    wire.last_open_error = None;
                    self.shared.is_open.store(true, Relaxed);
                    self.shared.was_open.store(true, Relaxed);
                    let now_ns = clock::monotonic_ns();
                    self.record(Direction::Gap, now_ns, wire.received, &[]);
                    self.session.on_opened(now_ns);
                }
                Err(error) => {
                    let error = error.to_string();
                    if wire.last_open_error.as_ref() != Some(&error) {
                        warn!("waiting for the scanner at {}: {error}", self.url);
                        wire.last_open_error = Some(error);
                    }
                    self.session.on_closed(clock::monotonic_ns());
                }
            },
            Action::Send { at_ns, bytes } => {
                self.record(Direction::Sent, at_ns, wire.sent, &bytes);
                wire.sent += bytes.len() as u64;
                let sent = wire.port.as_mut().map_or(Ok(()), |port| port.write_all(&bytes));
                if let Err(error) = sent {
                    self.lose(wire, &error.to_string());
                }
            }
            Action::Close => {
                wire.port = None;
                self.shared.is_open.store(false, Relaxed);
                self.session.on_closed(clock::monotonic_ns());
            }
        }
    }

    fn receive(&mut self, wire: &mut Wire, buffer: &mut [u8]) {
        let due = self.session.deadline_ns().map(|at_ns| clock::span(at_ns - clock::monotonic_ns()));
        let patience = due.map_or(PATIENCE, |due| due.min(PATIENCE));
        let Some(port) = &mut wire.port else {
            std::thread::sleep(patience);
            return;
        };
        match port.read(buffer, patience) {
            Ok(Received::Nothing) => {}
            Ok(Received::Bytes(length)) => {
                let now_ns = clock::monotonic_ns();
                let bytes = &buffer[..length];
                self.record(Direction::Received, now_ns, wire.received, bytes);
                wire.received += length as u64;
                self.session.on_received(now_ns, bytes);
            }
            Ok(Received::Closed) => self.lose(wire, "the other side has closed it"),
            Err(error) => self.lose(wire, &error.to_string()),
        }
    }

    fn lose(&mut self, wire: &mut Wire, error: &str) {
        warn!("the connection to {} is lost: {error}", self.url);
        wire.port = None;
        self.shared.is_open.store(false, Relaxed);
        self.session.on_closed(clock::monotonic_ns());
    }

    fn record(&self, direction: Direction, monotonic_ns: i64, stream_offset: u64, bytes: &[u8]) {
        let Some(recorder) = &self.recorder else { return };
        // A loss is counted by the queue and seen in the offsets.
        recorder.offer(Record::Bytes { direction, monotonic_ns, stream_offset, data: bytes.to_vec() });
    }

    fn hand_on_events(&mut self) {
        while let Some(event) = self.session.next_event() {
            match &event {
                Event::Scan(scan) => {
                    self.shared.scans.fetch_add(1, Relaxed);
                    let Some(parameters) = &self.session.device().parameters else {
                        self.count_error("scan_without_parameters");
                        continue;
                    };
                    // A loss is counted by the queue and seen in the numbers of the scans.
                    self.mapper.offer(ToMapper::Scan(Scan::from_scip(scan, parameters)));
                }
                Event::Skipped(skipped) => {
                    debug!("{skipped}");
                    self.count_error(skipped.kind.name());
                }
                Event::Reply(_) => {
                    debug!("{event}");
                    self.keep_device();
                }
                Event::StrayScan(_) => debug!("{event}"),
                Event::Lost { .. } => debug!("{event}"),
                Event::StuckStamp { .. } | Event::ClockReset { .. } => warn!("{event}"),
                Event::BadParameters(_) => error!("{event}"),
                Event::Rate(rate) if rate.is_slow => warn!("{event}"),
                Event::Synchronised(_) | Event::Rate(_) => info!("{event}"),
                Event::Session(session_event) => {
                    log_session_event(session_event, &self.url);
                    if matches!(session_event, SessionEvent::Streaming(_)) {
                        self.record_device();
                    }
                }
            }
        }
    }

    /// Keeps what VV, PP and II have told, for the report.
    fn keep_device(&mut self) {
        let device = self.session.device();
        let mut kept = lock(&self.shared.device);
        if kept.as_deref() != Some(device) {
            *kept = Some(Arc::new(device.clone()));
        }
    }

    /// Gives the recording the device's answers, once they are complete: when the stream begins. After a
    /// reconnection the same device is not told again.
    fn record_device(&mut self) {
        let Some(recorder) = &self.recorder else { return };
        let device = self.session.device();
        let is_same = |told: &scip::Device| {
            told.version == device.version && told.parameter_fields == device.parameter_fields
        };
        if self.recorded_device.as_deref().is_some_and(is_same) {
            return;
        }
        let device = Arc::new(device.clone());
        recorder.offer(Record::Device(Arc::clone(&device)));
        self.recorded_device = Some(device);
    }

    fn count_error(&self, kind: &str) {
        *lock(&self.shared.decode_errors).entry(kind.to_owned()).or_default() += 1;
    }
}

fn log_session_event(event: &SessionEvent, url: &str) {
    match event {
        SessionEvent::Trouble(_) | SessionEvent::Unhealthy | SessionEvent::NotSynchronised => {
            warn!("{url}: {event}")
        }
        SessionEvent::Verifying(_) | SessionEvent::Rebooting => warn!("{url}: {event}"),
        SessionEvent::Opened | SessionEvent::Closed { .. } | SessionEvent::Retry { .. } => {
            debug!("{url}: {event}")
        }
        _ => info!("{url}: {event}"),
    }
}
