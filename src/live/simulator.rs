//! The simulated scanner of `--device sim:WORLD`: a device on a pty of its own and a localizer that sends its poses, so
//! that all the rest is what it would be with a real one.

use anyhow::{Context, anyhow};
use scip::transport::Address;
use scipsim::device::{Running, SpawnOptions, spawn};
use scipsim::pose_message::PoseAddress;
use tempfile::TempDir;

use crate::config::{Config, PoseSource};
use crate::exit::{Exit, Failure};
use crate::mapper::Mount;

/// A simulated scanner at work; it ends when this is dropped.
#[derive(Debug)]
pub struct Simulator {
    device: Running,
    address: Address,
    /// Holds the socket of the poses.
    _folder: Option<TempDir>,
}

impl Simulator {
    /// Starts the scanner of `sim:WORLD[?setting=value&...]`.
    ///
    /// With `sends_poses` its poses go where the configuration expects poses; where it expects none, to a socket of
    /// their own, which is entered there. A mount that is not set is the world's.
    ///
    /// # Errors
    /// Where the world is not known, or pty and socket cannot be made.
    pub fn start(world: &str, config: &mut Config, sends_poses: bool) -> Result<Self, Failure> {
        let io = |error| Failure::new(Exit::Io, error);
        let mut options = SpawnOptions::from_url(world).map_err(|error| Failure::new(Exit::Usage, error))?;
        let mut folder = None;
        if sends_poses {
            if *config.pose.source.socket() == PoseSource::None {
                let made = TempDir::with_prefix("visagged-")
                    .context("cannot make a folder for poses")
                    .map_err(io)?;
                config.pose.source = PoseSource::Unix(made.path().join("pose"));
                folder = Some(made);
            }
            options.poses_to = match config.pose.source.socket() {
                PoseSource::None | PoseSource::Match(_) => None,
                PoseSource::Unix(path) => Some(PoseAddress::Unix(path.clone())),
                PoseSource::Udp(address) => Some(PoseAddress::Udp(*address)),
            };
        }
        let device = spawn(options).map_err(io)?;
        if config.mapper.mount == Mount::default() {
            let mount = device.simulation().mount();
            let (x, y, yaw) = (mount.translation.x, mount.translation.y, mount.rotation.angle());
            config.mapper.mount = Mount { x, y, yaw, upside_down: false };
        }
        let address = device.port().to_string().parse().map_err(|error| io(anyhow!("{error}")))?;
        Ok(Self { device, address, _folder: folder })
    }

    /// Where the scanner is.
    pub fn address(&self) -> Address {
        self.address.clone()
    }

    /// Whether the robot has driven all of its way.
    pub fn is_over(&self) -> bool {
        self.device.finished()
    }
}
