//! What to simulate and where to serve it, also from a text such as `sim:hall?seed=3&speed=0.5`.

use std::net::SocketAddr;
use std::path::PathBuf;

use super::profile::Profile;
use super::responder::DeviceSettings;
use crate::pose_error::PoseSource;
use crate::pose_message::PoseAddress;
use crate::simulation::SimulationOptions;
use crate::world::{World, WorldError};

/// Where a device is served.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Transport {
    /// A new pty, with a symbolic link to it if wanted.
    Pty {
        /// The link; an existing link is replaced.
        link: Option<PathBuf>,
    },
    /// A TCP port; port 0 takes a free one.
    Tcp(SocketAddr),
}

/// A device to be started.
#[derive(Clone, Debug)]
pub struct SpawnOptions {
    /// Where it stands.
    pub world: World,
    /// What it measures there.
    pub simulation: SimulationOptions,
    /// How it answers.
    pub device: DeviceSettings,
    /// Where it is served.
    pub transport: Transport,
    /// Where poses are sent; nowhere if `None`.
    pub poses_to: Option<PoseAddress>,
}

/// Why a text gives no device.
#[derive(Debug, thiserror::Error)]
pub enum OptionsError {
    /// The world cannot be had.
    #[error(transparent)]
    World(#[from] WorldError),
    /// A setting is unknown or has an impossible value.
    #[error("simulated device `{url}`: {what}")]
    Setting {
        /// The whole text.
        url: String,
        /// What is wrong.
        what: String,
    },
}

/// Settings of [`SpawnOptions::from_url`], for messages.
const KNOWN: &str = "seed, speed, rate (20 or 40), lean (degrees), dust, frames (on or off), intensity (on or off), gain, \
    poses (localizer, wheels or exact), pose-error, pose-rate, delay (s), profile (usb or ethernet), transport (pty or tcp), \
    clock (ms), drift (ppm), fault-seed, bad-sum, garbage, cut, error-status, silence, disconnect, skip-scan, slow (on or off)";

impl SpawnOptions {
    /// A device as a world asks for it: USB on a pty, no poses.
    pub fn new(world: World) -> SpawnOptions {
        SpawnOptions {
            world,
            simulation: SimulationOptions { keep_truth: false, ..Default::default() },
            device: DeviceSettings::default(),
            transport: Transport::Pty { link: None },
            poses_to: None,
        }
    }

    /// From `sim:WORLD` or `WORLD`, followed by `?setting=value&...`.
    pub fn from_url(url: &str) -> Result<SpawnOptions, OptionsError> {
        let text = url.strip_prefix("sim:").unwrap_or(url);
        let (world, settings) = text.split_once('?').unwrap_or((text, ""));
        let mut options = SpawnOptions::new(World::load(world)?);
        for setting in settings.split('&').filter(|s| !s.is_empty()) {
            let (key, value) = setting.split_once('=').unwrap_or((setting, ""));
            options.set(key, value).map_err(|what| OptionsError::Setting { url: url.into(), what })?;
        }
        Ok(options)
    }

    /// Sets one setting by name.
    pub fn set(&mut self, key: &str, value: &str) -> Result<(), String> {
        let number = || -> Result<f64, String> {
            let parsed = value.parse::<f64>().ok().filter(|v| v.is_finite());
            parsed.ok_or_else(|| format!("{key} needs a number, not `{value}`"))
        };
        let positive =
            || number().and_then(|v| if v > 0.0 { Ok(v) } else { Err(format!("{key} must be above 0")) });
        let not_negative = || {
            number().and_then(|v| if v >= 0.0 { Ok(v) } else { Err(format!("{key} must not be negative")) })
        };
        let probability = || {
            number().and_then(|v| {
                if (0.0..=1.0).contains(&v) { Ok(v) } else { Err(format!("{key} is a probability, 0 to 1")) }
            })
        };
        let count = || value.parse::<u64>().map_err(|_| format!("{key} needs a whole number, not `{value}`"));
        let switch = || match value {
            "on" | "true" | "1" => Ok(true),
            "off" | "false" | "0" => Ok(false),
            _ => Err(format!("{key} is on or off, not `{value}`")),
        };
        let (simulation, device) = (&mut self.simulation, &mut self.device);
        match key {
            "seed" => simulation.seed = count()?,
            "speed" => simulation.speed = positive()?,
            "rate" => match value {
                "20" | "40" => {
                    simulation.scan_rate = number()?;
                    device.rotation_ns = (1e9 / simulation.scan_rate) as i64;
                }
                _ => return Err(format!("rate is 20 or 40, not `{value}`")),
            },
            "lean" => simulation.lean_deg = Some(not_negative()?),
            "dust" => simulation.dust = not_negative()?,
            "frames" => simulation.frames = Some(switch()?),
            "intensity" => simulation.intensity = switch()?,
            "gain" => simulation.intensity_gain = positive()?,
            "poses" => {
                simulation.poses = match value {
                    "localizer" => PoseSource::Localizer,
                    "wheels" => PoseSource::Wheels,
                    "exact" => PoseSource::Exact,
                    _ => return Err(format!("poses are localizer, wheels or exact, not `{value}`")),
                }
            }
            "pose-error" => simulation.pose_error = not_negative()?,
            "pose-rate" => simulation.pose_rate = positive()?,
            "delay" => simulation.start_delay = not_negative()?,
            "profile" => {
                device.profile = match value {
                    "usb" => Profile::Usb,
                    "ethernet" => Profile::Ethernet,
                    _ => return Err(format!("profile is usb or ethernet, not `{value}`")),
                }
            }
            "transport" => {
                self.transport = match value {
                    "pty" => Transport::Pty { link: None },
                    "tcp" => Transport::Tcp(([127, 0, 0, 1], 0).into()),
                    _ => return Err(format!("transport is pty or tcp, not `{value}`")),
                }
            }
            "clock" => device.clock_start_ms = (count()? & 0xff_ffff) as u32,
            "drift" => device.drift_ppm = number()?.clamp(-10_000.0, 10_000.0),
            "fault-seed" => device.faults.seed = count()?,
            "bad-sum" => device.faults.bad_sum = probability()?,
            "garbage" => device.faults.garbage = probability()?,
            "cut" => device.faults.cut = probability()?,
            "error-status" => device.faults.error_status = probability()?,
            "silence" => device.faults.silence = probability()?,
            "disconnect" => device.faults.disconnect = probability()?,
            "skip-scan" => device.faults.skip_scan = probability()?,
            "slow" => device.faults.slow_firmware = switch()?,
            _ => return Err(format!("no setting `{key}`; known are {KNOWN}")),
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_url_sets_what_it_names() {
        let options = SpawnOptions::from_url(
            "sim:room?seed=3&speed=0.5&lean=1&rate=20&poses=wheels&profile=ethernet&transport=tcp&bad-sum=0.1",
        )
        .unwrap();
        assert_eq!((options.simulation.seed, options.simulation.speed), (3, 0.5));
        assert_eq!((options.simulation.lean_deg, options.device.rotation_ns), (Some(1.0), 50_000_000));
        assert_eq!(options.device.profile, Profile::Ethernet);
        assert_eq!(options.device.faults.bad_sum, 0.1);
        assert!(matches!(options.transport, Transport::Tcp(_)));
    }

    #[test]
    fn mistakes_are_named() {
        let fault = |url: &str| SpawnOptions::from_url(url).unwrap_err().to_string();
        assert!(fault("sim:nowhere").contains("no world `nowhere`"));
        assert!(fault("sim:room?sed=3").contains("no setting `sed`; known are seed"));
        assert!(fault("sim:room?speed=fast").contains("needs a number"));
        assert!(fault("sim:room?cut=2").contains("0 to 1"));
    }
}
