//! Messages to the service manager (sd_notify(3)); nothing happens where there is none.

use std::time::Duration;

use log::debug;
use sd_notify::NotifyState;

/// The manager that started this process, if one did.
#[derive(Clone, Copy, Debug)]
pub struct Manager {
    watchdog: Option<Duration>,
}

impl Manager {
    /// Looks for the manager in the environment.
    pub fn find() -> Self {
        Self { watchdog: sd_notify::watchdog_enabled() }
    }

    /// How often the watchdog wants to be fed at least, if there is one.
    pub fn watchdog(&self) -> Option<Duration> {
        self.watchdog
    }

    /// The threads run and the search for the device has begun. A device that is not there does not hold up
    /// the boot.
    pub fn ready(&self) {
        self.send(&[NotifyState::Ready]);
    }

    /// Both the driver and the mapper have made progress.
    pub fn feed_watchdog(&self) {
        self.send(&[NotifyState::Watchdog]);
    }

    /// One line on how things are, for `systemctl status`.
    pub fn status(&self, text: &str) {
        self.send(&[NotifyState::Status(text)]);
    }

    /// The orderly end has begun.
    pub fn stopping(&self) {
        self.send(&[NotifyState::Stopping]);
    }

    /// The configuration is being read again; followed by [`ready`](Self::ready).
    pub fn reloading(&self) {
        match NotifyState::monotonic_usec_now() {
            Ok(now) => self.send(&[NotifyState::Reloading, now]),
            Err(error) => debug!("no monotonic clock: {error}"),
        }
    }

    fn send(&self, states: &[NotifyState]) {
        if let Err(error) = sd_notify::notify(states) {
            debug!("the service manager could not be told: {error}");
        }
    }
}
