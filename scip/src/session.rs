//! Drives a device: start-up, stream, stop, reconnection.

mod settings;

pub use settings::{Patience, Purpose, SessionSettings, Window};

use crate::request::RequestError;
use crate::{Device, Event, Monitor, Request};

/// What the caller is to do next.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// Open the connection, then call `on_opened`, or `on_closed` where that fails.
    Open,
    /// Send these bytes; if they are recorded, then with this time, which the monitor inside was given.
    Send {
        /// Time of the request (ns).
        at_ns: i64,
        /// The bytes.
        bytes: Vec<u8>,
    },
    /// Close the connection, then call `on_closed`.
    Close,
}

/// Where the session stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// Waits before the next attempt to open.
    Waiting {
        /// Until when (ns).
        until_ns: i64,
    },
    /// The caller is opening the connection.
    Opening,
    /// Lets bytes go by that were under way.
    Draining {
        /// Until when (ns).
        until_ns: i64,
    },
    /// A request of the start-up is under way or due.
    Starting(Request),
    /// Scans come.
    Streaming,
    /// The laser is being turned off.
    Stopping,
    /// The caller is closing the connection.
    Closing,
    /// The end.
    Stopped,
}

/// See the module.
#[derive(Debug)]
pub struct Session {
    monitor: Monitor,
    state: State,
}

impl Session {
    /// A session whose first action is to open.
    pub fn new(settings: SessionSettings, now_ns: i64) -> Result<Session, RequestError> {
        settings.check()?;
        let _ = now_ns;
        Ok(Session { monitor: Monitor::new(settings.monitor), state: State::Opening })
    }
    /// The connection is open.
    pub fn on_opened(&mut self, _now_ns: i64) {}
    /// The connection is closed, was lost, or could not be opened.
    pub fn on_closed(&mut self, _now_ns: i64) {}
    /// Bytes were received.
    pub fn on_received(&mut self, _now_ns: i64, _bytes: &[u8]) {}
    /// Time went by; to be called at `deadline_ns` at the latest.
    pub fn on_time(&mut self, _now_ns: i64) {}
    /// Turn the laser off, close, end. Takes `Patience::stop_ns` at most.
    pub fn stop(&mut self, _now_ns: i64) {}
    /// Next thing to do.
    pub fn next_action(&mut self) -> Option<Action> {
        None
    }
    /// Next event.
    pub fn next_event(&mut self) -> Option<Event> {
        None
    }
    /// When `on_time` is due.
    pub fn deadline_ns(&self) -> Option<i64> {
        None
    }
    /// Where the session stands.
    pub fn state(&self) -> State {
        self.state
    }
    /// The device so far.
    pub fn device(&self) -> &Device {
        self.monitor.device()
    }
}
