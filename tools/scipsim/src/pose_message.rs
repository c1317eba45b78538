//! Reported poses as datagrams: one JSON object each, as visagged takes them in.

use std::net::{SocketAddr, ToSocketAddrs, UdpSocket};
use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;

use crate::pose_error::PoseSource;
use crate::simulation::ReportedPose;

/// Where poses go.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PoseAddress {
    /// A Unix datagram socket.
    Unix(PathBuf),
    /// A UDP socket.
    Udp(SocketAddr),
}

impl std::str::FromStr for PoseAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<PoseAddress, String> {
        if let Some(path) = text.strip_prefix("unix:") {
            return Ok(PoseAddress::Unix(path.into()));
        }
        let Some(host) = text.strip_prefix("udp://") else {
            return Err(format!("`{text}` is no address for poses; give unix:PATH or udp://HOST:PORT"));
        };
        let found = host.to_socket_addrs().map_err(|e| format!("{text}: {e}"))?.next();
        found.map(PoseAddress::Udp).ok_or_else(|| format!("{text}: the host has no address"))
    }
}

/// Sends poses and never waits: what nobody takes is lost.
#[derive(Debug)]
pub enum PoseSocket {
    /// See [`PoseAddress::Unix`].
    Unix(UnixDatagram, PathBuf),
    /// See [`PoseAddress::Udp`].
    Udp(UdpSocket, SocketAddr),
}

impl PoseSocket {
    /// Opens a socket to send from.
    pub fn open(address: &PoseAddress) -> std::io::Result<PoseSocket> {
        match address {
            PoseAddress::Unix(path) => {
                let socket = UnixDatagram::unbound()?;
                socket.set_nonblocking(true)?;
                Ok(PoseSocket::Unix(socket, path.clone()))
            }
            PoseAddress::Udp(to) => {
                let from: SocketAddr = if to.is_ipv4() {
                    ([0, 0, 0, 0], 0).into()
                } else {
                    (std::net::Ipv6Addr::UNSPECIFIED, 0).into()
                };
                let socket = UdpSocket::bind(from)?;
                socket.set_nonblocking(true)?;
                Ok(PoseSocket::Udp(socket, *to))
            }
        }
    }

    /// Sends a message; whether someone took it.
    pub fn send(&self, message: &str) -> bool {
        match self {
            PoseSocket::Unix(socket, path) => socket.send_to(message.as_bytes(), path).is_ok(),
            PoseSocket::Udp(socket, to) => socket.send_to(message.as_bytes(), to).is_ok(),
        }
    }
}

/// The datagram of a pose that holds at `stamp_ns` on the host's monotonic clock.
pub fn message(pose: &ReportedPose, source: PoseSource, stamp_ns: i64) -> String {
    // Variances as a good localizer would state them: 1.5 cm and 0.2 degrees.
    let (frame, name, xx, aa) = match source {
        PoseSource::Localizer => ("map", "localizer", 2.25e-4, 1.2e-5),
        PoseSource::Exact => ("map", "truth", 1e-8, 1e-8),
        PoseSource::Wheels => ("odom", "wheel", 1e-2, 1e-3),
    };
    let at = pose.pose.translation.vector;
    serde_json::json!({
        "class": "POSE", "v": 1, "stamp_ns": stamp_ns, "clock": "monotonic", "frame": frame, "child": "base_link",
        "x": at.x, "y": at.y, "yaw": pose.pose.rotation.angle(),
        "cov": [xx, 0.0, 0.0, xx, 0.0, aa], "reset": 0, "quality": 100, "source": name,
    })
    .to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_carries_what_a_pose_needs() {
        let pose = ReportedPose { t_ns: 5, pose: crate::drive::pose(1.5, -2.0, 0.25) };
        let value: serde_json::Value = serde_json::from_str(&message(&pose, PoseSource::Wheels, 42)).unwrap();
        assert_eq!(
            (&value["class"], &value["v"], &value["stamp_ns"]),
            (&"POSE".into(), &1.into(), &42.into())
        );
        assert_eq!((value["x"].as_f64(), value["yaw"].as_f64()), (Some(1.5), Some(0.25)));
        assert_eq!((&value["source"], &value["clock"]), (&"wheel".into(), &"monotonic".into()));
    }

    #[test]
    fn addresses() {
        assert_eq!("unix:/a/b".parse(), Ok(PoseAddress::Unix("/a/b".into())));
        assert_eq!("udp://127.0.0.1:99".parse(), Ok(PoseAddress::Udp(([127, 0, 0, 1], 99).into())));
        assert!("tcp://x".parse::<PoseAddress>().unwrap_err().contains("unix:PATH"));
    }
}
