//! A passive listener on both directions of a wire.

use crate::{Device, Event, Parameters};

/// What the stamps of scans rest on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ClockSource {
    /// The host's clock, tied to the device's by TM rounds and by arrival times.
    #[default]
    Host,
    /// The device's own unwrapped clock: for bytes whose times of arrival are not known.
    Device,
}

/// Which moment of a turn the device stamps; C-42-03320B says step 0, some drivers the rear.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StampReference {
    /// Step 0.
    #[default]
    Step0,
    /// The beam pointing to the rear of the sensor, before step 0.
    Rear,
}

/// How a monitor reads the wire.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MonitorOptions {
    /// What stamps rest on.
    pub clock: ClockSource,
    /// What the device's stamp refers to.
    pub stamp_reference: StampReference,
    /// Parameters to go by until PP is seen; without any, lost scans cannot be told from stamps.
    pub parameters: Option<Parameters>,
}

/// See the module.
#[derive(Debug)]
pub struct Monitor {
    device: Device,
}

impl Monitor {
    /// A monitor that has seen nothing.
    pub fn new(_options: MonitorOptions) -> Monitor {
        Monitor { device: Device::default() }
    }
    /// Bytes that the host sent at `now_ns`.
    pub fn on_sent(&mut self, _now_ns: i64, _bytes: &[u8]) {}
    /// Bytes that were received at `now_ns`.
    pub fn on_received(&mut self, _now_ns: i64, _bytes: &[u8]) {}
    /// The connection was reopened, or bytes are missing here.
    pub fn on_gap(&mut self) {}
    /// Next event.
    pub fn next_event(&mut self) -> Option<Event> {
        None
    }
    /// The device so far.
    pub fn device(&self) -> &Device {
        &self.device
    }
}
