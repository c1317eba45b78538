//! What a session is to do, and how patient it is.

use crate::device::Parameters;
use crate::model::Profile;
use crate::monitor::MonitorOptions;
use crate::request::{RequestError, ScanKind, ScanRequest, Text};

const MS: i64 = 1_000_000;

/// What the session is for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Purpose {
    /// Stream scans until stopped, reconnecting for ever.
    #[default]
    Stream,
    /// Ask VV, PP and II on one connection and end; the device is not reset.
    Identify,
}

/// Which steps are wanted.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Window {
    /// All that the device measures.
    #[default]
    Full,
    /// Steps, both included, cut to what the device measures.
    Steps {
        /// First step.
        first: u16,
        /// Last step.
        last: u16,
    },
    /// Bearings (rad, 0 forward, counter-clockwise positive), both included, cut to what the device measures.
    Bearings {
        /// Smallest bearing (rad).
        min_rad: f64,
        /// Largest bearing (rad).
        max_rad: f64,
    },
}

/// How long the session waits (ns) and how often it tries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Patience {
    /// For a reply. With the laser on, devices answer once a turn: 25 ms to 100 ms in captures.
    pub reply_ns: i64,
    /// For the bytes that are still under way after opening.
    pub drain_ns: i64,
    /// Attempts of one request.
    pub attempts: u32,
    /// For BM to succeed: it can fail for about 10 s after plugging in.
    pub laser_on_ns: i64,
    /// Between two attempts that were refused.
    pub retry_ns: i64,
    /// For a scan while streaming; at least four scan periods are granted.
    pub silence_ns: i64,
    /// For the first scan after the stream was accepted: the motor may have to spin up.
    pub first_scan_ns: i64,
    /// For an error that the device verifies (21..49) to be over.
    pub verify_ns: i64,
    /// For stopping in all.
    pub stop_ns: i64,
    /// Before the first reconnection; doubled each time.
    pub back_off_min_ns: i64,
    /// Longest wait before a reconnection.
    pub back_off_max_ns: i64,
    /// For a device to come back after a reboot.
    pub reboot_ns: i64,
    /// Scans with one stamp before the device is taken for stuck.
    pub stuck_scans: u32,
}

impl Default for Patience {
    fn default() -> Patience {
        Patience {
            reply_ns: 500 * MS,
            drain_ns: 100 * MS,
            attempts: 4,
            laser_on_ns: 12_000 * MS,
            retry_ns: 500 * MS,
            silence_ns: 1000 * MS,
            first_scan_ns: 3000 * MS,
            verify_ns: 10_000 * MS,
            stop_ns: 2000 * MS,
            back_off_min_ns: 250 * MS,
            back_off_max_ns: 10_000 * MS,
            reboot_ns: 3000 * MS,
            stuck_scans: 10,
        }
    }
}

/// What a session is to do.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionSettings {
    /// What it is for.
    pub purpose: Purpose,
    /// How the device is connected.
    pub profile: Profile,
    /// Which steps are wanted.
    pub window: Window,
    /// Neighbouring steps merged into one value (1..=99).
    pub cluster: u8,
    /// Scans left out between two (0..=9).
    pub skip: u8,
    /// ME (distances and intensities) or MD.
    pub intensity: bool,
    /// String that marks the stream.
    pub text: Option<Text>,
    /// TM rounds before the stream; 0 for none.
    pub sync_rounds: u32,
    /// How the wire is read.
    pub monitor: MonitorOptions,
    /// How patient the session is.
    pub patience: Patience,
}

impl Default for SessionSettings {
    fn default() -> SessionSettings {
        SessionSettings {
            purpose: Purpose::Stream,
            profile: Profile::Usb,
            window: Window::Full,
            cluster: 1,
            skip: 0,
            intensity: true,
            text: None,
            sync_rounds: 12,
            monitor: MonitorOptions::default(),
            patience: Patience::default(),
        }
    }
}

impl SessionSettings {
    /// Checks what can be checked without a device.
    pub fn check(&self) -> Result<(), RequestError> {
        let (start, end) = match self.window {
            Window::Steps { first, last } => (first, last),
            _ => (0, 0),
        };
        ScanRequest { cluster: self.cluster, skip: self.skip, ..ScanRequest::new(self.kind(), start, end) }
            .check()
    }

    fn kind(&self) -> ScanKind {
        if self.intensity { ScanKind::ME } else { ScanKind::MD }
    }

    /// How long TM0 is tried: on Ethernet it fails for some seconds after the connection was accepted.
    pub fn time_mode_ns(&self) -> i64 {
        match self.profile {
            Profile::Usb => 1000 * MS,
            Profile::Ethernet => 6000 * MS,
        }
    }

    /// The endless stream that these settings ask of a device; `None` where the window holds no step of it.
    pub fn scan_request(&self, device: &Parameters) -> Option<ScanRequest> {
        let (first, last) = (f64::from(device.first_step), f64::from(device.last_step));
        let (start, end) = match self.window {
            Window::Full => (first, last),
            Window::Steps { first: from, last: to } => (first.max(f64::from(from)), last.min(f64::from(to))),
            Window::Bearings { min_rad, max_rad } if min_rad.is_nan() || max_rad.is_nan() => return None,
            Window::Bearings { min_rad, max_rad } => {
                // Bearings are mostly given rounded; a thousandth of a step more decides nothing else.
                let step = |rad: f64| f64::from(device.front_step) + rad / device.bearing_per_step();
                (first.max((step(min_rad) - 1e-3).ceil()), last.min((step(max_rad) + 1e-3).floor()))
            }
        };
        if start > end {
            return None;
        }
        let window = ScanRequest::new(self.kind(), start as u16, end as u16);
        Some(ScanRequest { cluster: self.cluster, skip: self.skip, ..window })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model;

    #[test]
    fn windows_of_a_utm_30lx() {
        let utm = Parameters::of_model(model::find("UTM-30LX").unwrap()).unwrap();
        let steps = |window| {
            let settings = SessionSettings { window, ..SessionSettings::default() };
            settings.scan_request(&utm).map(|request| (request.start, request.end))
        };
        assert_eq!(steps(Window::Full), Some((0, 1080)));
        assert_eq!(steps(Window::Steps { first: 100, last: 2000 }), Some((100, 1080)));
        let half = std::f64::consts::FRAC_PI_2;
        assert_eq!(steps(Window::Bearings { min_rad: -half, max_rad: half }), Some((180, 900)));
        assert_eq!(steps(Window::Bearings { min_rad: 3.0, max_rad: 3.1 }), None);
        assert_eq!(steps(Window::Bearings { min_rad: f64::NAN, max_rad: 1.0 }), None);
    }

    #[test]
    fn values_that_the_wire_cannot_carry() {
        let settings = SessionSettings { cluster: 100, ..SessionSettings::default() };
        assert!(matches!(
            settings.check(),
            Err(RequestError::TooLarge { what: "cluster", value: 100, max: 99 })
        ));
        assert_eq!(SessionSettings::default().check(), Ok(()));
    }
}
