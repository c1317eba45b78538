//! From the configuration to a session and a connection.

use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use anyhow::bail;
use scip::transport::Address;
use scip::{MonitorOptions, Profile, Purpose, SessionSettings, Window};

use super::clock;
use super::driver::{Driver, Opener};
use super::queues::{TO_MAPPER, queue};
use super::shared::{Shared, lock};
use crate::config::{DeviceConfig, DeviceUrl, StampReference};

/// What the configuration asks of the device.
pub fn session_settings(config: &DeviceConfig, url: &DeviceUrl) -> SessionSettings {
    let mut settings = SessionSettings {
        profile: match url {
            DeviceUrl::Port(address) => address.profile(),
            DeviceUrl::Sim(_) => Profile::Usb,
        },
        window: match (config.first_step, config.last_step) {
            (None, None) => Window::Full,
            (first, last) => Window::Steps { first: first.unwrap_or(0), last: last.unwrap_or(u16::MAX) },
        },
        cluster: config.cluster,
        skip: config.skip,
        intensity: config.intensity,
        monitor: MonitorOptions {
            stamp_reference: match config.stamp {
                StampReference::FirstStep => scip::StampReference::Step0,
                StampReference::Rear => scip::StampReference::Rear,
            },
            ..MonitorOptions::default()
        },
        ..SessionSettings::default()
    };
    settings.patience.silence_ns = (config.silence_s * 1e9) as i64;
    settings
}

/// How long a TCP connection may take to come about.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(2);

/// Opens the device, again and again.
pub fn opener(address: Address) -> Opener {
    Box::new(move || address.open(CONNECT_TIMEOUT))
}

/// Asks a device who it is.
///
/// # Errors
/// Where it cannot be opened or does not answer.
pub fn identify(address: &Address) -> anyhow::Result<scip::Device> {
    let mut port = Some(address.open(CONNECT_TIMEOUT)?);
    let settings = SessionSettings {
        purpose: Purpose::Identify,
        profile: address.profile(),
        ..SessionSettings::default()
    };
    let shared = Arc::new(Shared::default());
    let stop = Arc::clone(&shared);
    let (mapper, _inbox, _) = queue(&TO_MAPPER);
    let driver = Driver {
        session: scip::Session::new(settings, clock::monotonic_ns())?,
        // One connection: a session that asks for a second one has had no answer.
        opener: Box::new(move || {
            port.take().ok_or_else(|| {
                stop.stop_driver.store(true, Relaxed);
                io::ErrorKind::NotConnected.into()
            })
        }),
        url: address.to_string(),
        mapper,
        recorder: None,
        shared: Arc::clone(&shared),
        recorded_device: None,
    };
    driver.run();
    let device = lock(&shared.device).take();
    match device {
        Some(device) if device.version.is_some() => Ok((*device).clone()),
        _ => bail!("{address} gave no answer that a scanner would give"),
    }
}
