//! Poses from outside: one JSON object a datagram, from a localizer that this program does not run.
//!
//! A datagram is either taken whole or rejected for one cause, which is counted. Reading a datagram
//! ([`PoseReader`]) knows no socket and no clock; [`PoseSocket`] is the socket.
//!
//! ```json
//! {"class":"POSE","v":1,"stamp_ns":1700000000000000000,"clock":"realtime","frame":"odom","child":"base_link",
//!  "x":1.5,"y":-2.0,"yaw":0.5,"cov":[0.01,0,0,0.01,0,0.001],"reset":0,"quality":100,"source":"wheel"}
//! ```
//! Needed are `class`, `stamp_ns`, `x`, `y` (m) and `yaw` (rad). `clock` is `realtime` unless given. Other keys are
//! ignored, so that a sender may say more than is used.

use std::collections::BTreeMap;
use std::io;
use std::net::UdpSocket;
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use serde::Deserialize;

use crate::config::{PoseConfig, PoseSource};
use crate::pose::{StampedPose, pose};

/// Longest datagram that is read (bytes); a pose with all its keys has about 300.
pub const LONGEST_DATAGRAM: usize = 4096;

/// Farthest place that is believed (m): beyond it the map's cells could not be numbered.
const FARTHEST: f64 = 1e6;

/// Why a datagram gave no pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rejection {
    /// Not a JSON object with the needed keys, or a key of the wrong kind.
    Malformed,
    /// Another `class` than POSE, or another version than 1.
    OtherClass,
    /// A number that is NaN, infinite, or not possible for what it says.
    NotFinite,
    /// Stamp too long ago, on arrival.
    Stale,
    /// Stamp too far ahead, on arrival.
    Future,
    /// Stamp not later than that of the pose before.
    OutOfOrder,
    /// Pose of another frame than the wanted one, or in another than the poses before.
    OtherFrame,
}

impl Rejection {
    /// Name in report.json and in the log.
    pub fn name(self) -> &'static str {
        match self {
            Self::Malformed => "malformed",
            Self::OtherClass => "other_class",
            Self::NotFinite => "not_finite",
            Self::Stale => "stale",
            Self::Future => "future",
            Self::OutOfOrder => "out_of_order",
            Self::OtherFrame => "other_frame",
        }
    }
}

/// The host's two clocks at one moment (ns).
#[derive(Clone, Copy, Debug)]
pub struct Clocks {
    /// CLOCK_MONOTONIC.
    pub monotonic_ns: i64,
    /// CLOCK_REALTIME.
    pub realtime_ns: i64,
}

/// The datagram as it is sent.
#[derive(Deserialize)]
struct Message {
    class: String,
    #[serde(default = "version_1")]
    v: u32,
    stamp_ns: i64,
    #[serde(default)]
    clock: Clock,
    frame: Option<String>,
    child: Option<String>,
    x: f64,
    y: f64,
    yaw: f64,
    cov: Option<[f64; 6]>,
    #[serde(default)]
    reset: u32,
}

fn version_1() -> u32 {
    1
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Clock {
    #[default]
    Realtime,
    Monotonic,
}

/// Only the class and version, for datagrams that are no poses.
#[derive(Deserialize)]
struct ClassOnly {
    class: String,
    #[serde(default = "version_1")]
    v: u32,
}

/// Reads datagrams and counts those it rejects.
#[derive(Debug)]
pub struct PoseReader {
    child: String,
    stale_ns: i64,
    future_ns: i64,
    /// Frame of the first pose; one map can only be made in one frame.
    frame: Option<String>,
    last_stamp_ns: Option<i64>,
    rejected: BTreeMap<&'static str, u64>,
}

impl PoseReader {
    /// A reader with these limits.
    pub fn new(config: &PoseConfig) -> Self {
        Self {
            child: config.child.clone(),
            stale_ns: (config.stale_s * 1e9) as i64,
            future_ns: (config.future_s * 1e9) as i64,
            frame: None,
            last_stamp_ns: None,
            rejected: BTreeMap::new(),
        }
    }

    /// Datagrams rejected so far, by cause.
    pub fn rejected(&self) -> &BTreeMap<&'static str, u64> {
        &self.rejected
    }

    /// The pose in a datagram that arrived at `now`, stamped on the monotonic clock.
    pub fn read(&mut self, datagram: &[u8], now: Clocks) -> Result<StampedPose, Rejection> {
        self.check(datagram, now).inspect_err(|rejection| {
            *self.rejected.entry(rejection.name()).or_default() += 1;
        })
    }

    fn check(&mut self, datagram: &[u8], now: Clocks) -> Result<StampedPose, Rejection> {
        let message: Message = serde_json::from_slice(datagram).map_err(|_| cause_of_malformed(datagram))?;
        if message.class != "POSE" || message.v != 1 {
            return Err(Rejection::OtherClass);
        }
        if message.child.as_ref().is_some_and(|child| *child != self.child) {
            return Err(Rejection::OtherFrame);
        }
        if self.frame.is_some() && message.frame.is_some() && self.frame != message.frame {
            return Err(Rejection::OtherFrame);
        }
        let near = |metres: f64| metres.abs() <= FARTHEST;
        if !near(message.x)
            || !near(message.y)
            || message.yaw.abs() > FARTHEST
            || !message.cov.is_none_or(possible)
        {
            return Err(Rejection::NotFinite);
        }
        let stamp_ns = match message.clock {
            Clock::Monotonic => message.stamp_ns,
            // The wall clock as it stands now: a clock that was set in between shows as a stale or future pose.
            Clock::Realtime => {
                now.monotonic_ns.saturating_sub(now.realtime_ns.saturating_sub(message.stamp_ns))
            }
        };
        let age_ns = now.monotonic_ns.saturating_sub(stamp_ns);
        if age_ns > self.stale_ns {
            return Err(Rejection::Stale);
        }
        if age_ns < -self.future_ns {
            return Err(Rejection::Future);
        }
        if self.last_stamp_ns.is_some_and(|last| stamp_ns <= last) {
            return Err(Rejection::OutOfOrder);
        }
        self.last_stamp_ns = Some(stamp_ns);
        if self.frame.is_none() {
            self.frame = message.frame;
        }
        Ok(StampedPose {
            stamp_ns,
            received_ns: now.monotonic_ns,
            pose: pose(message.x, message.y, message.yaw),
            covariance: message.cov,
            reset: message.reset,
        })
    }
}

/// Variances are not negative.
fn possible([xx, _, _, yy, _, aa]: [f64; 6]) -> bool {
    xx >= 0.0 && yy >= 0.0 && aa >= 0.0
}

/// JSON has no NaN, but most programs that have one write it.
fn cause_of_malformed(datagram: &[u8]) -> Rejection {
    if let Ok(ClassOnly { class, v }) = serde_json::from_slice(datagram) {
        return if class == "POSE" && v == 1 { Rejection::Malformed } else { Rejection::OtherClass };
    }
    let text = String::from_utf8_lossy(datagram).to_ascii_lowercase();
    let is_object = text.trim_start().starts_with('{') && text.trim_end().ends_with('}');
    if is_object
        && [":nan", ": nan", "infinity", ":inf", ": inf", ":-inf", ": -inf"]
            .iter()
            .any(|word| text.contains(word))
    {
        Rejection::NotFinite
    } else {
        Rejection::Malformed
    }
}

/// The socket on which poses arrive.
#[derive(Debug)]
pub enum PoseSocket {
    /// A Unix datagram socket; its name is removed with it.
    Unix(UnixDatagram, SocketName),
    /// UDP on a loopback address.
    Udp(UdpSocket),
}

/// A name in the file system that goes when its socket does.
#[derive(Debug)]
pub struct SocketName(PathBuf);

impl Drop for SocketName {
    fn drop(&mut self) {
        // Another process may have put its own in this place; then there is nothing of ours to remove, and
        // removing a name that is gone is no error that anyone could act on.
        let _ = std::fs::remove_file(&self.0);
    }
}

impl PoseSocket {
    /// Opens the source; `None` for the sources `none` and `match`. A name left by a run that was killed is replaced; one at
    /// which another process listens is not, nor is anything that is no socket.
    pub fn open(source: &PoseSource) -> Result<Option<Self>> {
        let socket = match source.socket() {
            PoseSource::None | PoseSource::Match(_) => return Ok(None),
            PoseSource::Unix(path) => {
                remove_left_over(path)?;
                let socket = UnixDatagram::bind(path)
                    .with_context(|| format!("cannot make the pose socket {}", path.display()))?;
                // To send is to write: the group may, whatever the umask says.
                std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o660)).with_context(
                    || format!("cannot open the pose socket {} to the group", path.display()),
                )?;
                Self::Unix(socket, SocketName(path.clone()))
            }
            PoseSource::Udp(address) => Self::Udp(
                UdpSocket::bind(address)
                    .with_context(|| format!("cannot receive poses at udp://{address}"))?,
            ),
        };
        Ok(Some(socket))
    }

    /// Waits for a datagram for at most `patience`; `None` where none came. A datagram longer than the buffer
    /// is cut, and then is no JSON any more.
    pub fn receive(&self, buffer: &mut [u8], patience: Duration) -> io::Result<Option<usize>> {
        let received = match self {
            Self::Unix(socket, _) => {
                socket.set_read_timeout(Some(patience))?;
                socket.recv(buffer)
            }
            Self::Udp(socket) => {
                socket.set_read_timeout(Some(patience))?;
                socket.recv(buffer)
            }
        };
        match received {
            Ok(length) => Ok(Some(length)),
            Err(error) => match error.kind() {
                io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted => Ok(None),
                _ => Err(error),
            },
        }
    }
}

fn remove_left_over(path: &Path) -> Result<()> {
    let Ok(metadata) = std::fs::symlink_metadata(path) else { return Ok(()) };
    if !metadata.file_type().is_socket() {
        bail!("cannot make the pose socket {}: there is something else of that name", path.display());
    }
    if UnixDatagram::unbound()?.connect(path).is_ok() {
        bail!("cannot make the pose socket {}: another process receives there", path.display());
    }
    std::fs::remove_file(path).with_context(|| format!("cannot replace the pose socket {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: Clocks = Clocks { monotonic_ns: 50_000_000_000, realtime_ns: 1_700_000_050_000_000_000 };

    fn read(text: &str) -> Result<StampedPose, Rejection> {
        PoseReader::new(&PoseConfig::default()).read(text.as_bytes(), NOW)
    }

    #[test]
    fn the_documented_message_is_read() {
        let got = read(
            r#"{"class":"POSE","v":1,"stamp_ns":1700000049990000000,"clock":"realtime","frame":"odom",
               "child":"base_link","x":1.5,"y":-2.0,"yaw":0.5,"cov":[0.01,0,0,0.02,0,0.001],"reset":3,
               "quality":100,"source":"wheel"}"#,
        )
        .unwrap();
        assert_eq!(got.stamp_ns, 49_990_000_000);
        assert_eq!(got.received_ns, NOW.monotonic_ns);
        assert_eq!(got.pose.translation.vector.as_slice(), [1.5, -2.0]);
        assert!((got.pose.rotation.angle() - 0.5).abs() < 1e-15);
        assert_eq!(got.covariance, Some([0.01, 0.0, 0.0, 0.02, 0.0, 0.001]));
        assert_eq!(got.reset, 3);
    }

    #[test]
    fn five_keys_are_enough_and_the_wall_clock_is_meant() {
        let got = read(r#"{"class":"POSE","stamp_ns":1700000050000000000,"x":0,"y":0,"yaw":0}"#).unwrap();
        assert_eq!((got.stamp_ns, got.reset, got.covariance), (50_000_000_000, 0, None));
    }

    #[test]
    fn each_cause_has_its_name() {
        let with = |rest: &str| format!(r#"{{"class":"POSE","clock":"monotonic",{rest}}}"#);
        let good = r#""stamp_ns":50000000000,"x":0,"y":0,"yaw":0"#;
        assert!(read(&with(good)).is_ok());
        for (text, cause) in [
            ("".into(), Rejection::Malformed),
            ("POSE 1 2 3".into(), Rejection::Malformed),
            (with(r#""stamp_ns":50000000000,"x":0,"y":0"#), Rejection::Malformed),
            (with(r#""stamp_ns":50000000000,"x":"a","y":0,"yaw":0"#), Rejection::Malformed),
            (with(&format!(r#"{good},"cov":[1,2,3]"#)), Rejection::Malformed),
            (with(&format!(r#"{good},"v":2"#)), Rejection::OtherClass),
            (r#"{"class":"TPV","lat":1.0}"#.into(), Rejection::OtherClass),
            (with(r#""stamp_ns":50000000000,"x":NaN,"y":0,"yaw":0"#), Rejection::NotFinite),
            (with(r#""stamp_ns":50000000000,"x":0,"y":-Infinity,"yaw":0"#), Rejection::NotFinite),
            (with(r#""stamp_ns":50000000000,"x":0,"y":1e300,"yaw":0"#), Rejection::NotFinite),
            (with(&format!(r#"{good},"cov":[-1,0,0,1,0,1]"#)), Rejection::NotFinite),
            (with(r#""stamp_ns":48999999999,"x":0,"y":0,"yaw":0"#), Rejection::Stale),
            (with(r#""stamp_ns":-9223372036854775808,"x":0,"y":0,"yaw":0"#), Rejection::Stale),
            (with(r#""stamp_ns":50100000001,"x":0,"y":0,"yaw":0"#), Rejection::Future),
            (with(r#""stamp_ns":9223372036854775807,"x":0,"y":0,"yaw":0"#), Rejection::Future),
            (with(&format!(r#"{good},"child":"camera""#)), Rejection::OtherFrame),
        ] {
            assert_eq!(read(&text), Err(cause), "{text}");
        }
    }

    #[test]
    fn rejections_are_counted_and_leave_no_trace() {
        let mut reader = PoseReader::new(&PoseConfig::default());
        let mut read = |stamp_ns: i64, frame: &str| {
            let text = format!(
                r#"{{"class":"POSE","clock":"monotonic","stamp_ns":{stamp_ns},"frame":"{frame}","x":0,"y":0,"yaw":0}}"#
            );
            reader.read(text.as_bytes(), NOW).map(|pose| pose.stamp_ns)
        };
        assert_eq!(read(60_000_000_000, "map"), Err(Rejection::Future));
        assert_eq!(read(49_900_000_000, "odom"), Ok(49_900_000_000));
        assert_eq!(read(49_900_000_000, "odom"), Err(Rejection::OutOfOrder));
        assert_eq!(read(49_950_000_000, "map"), Err(Rejection::OtherFrame));
        assert_eq!(read(49_950_000_000, "odom"), Ok(49_950_000_000));
        let counts: Vec<_> = reader.rejected().iter().map(|(cause, count)| (*cause, *count)).collect();
        assert_eq!(counts, [("future", 1), ("other_frame", 1), ("out_of_order", 1)]);
    }

    #[test]
    fn a_left_over_name_is_replaced_and_others_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pose");
        let source = PoseSource::Unix(path.clone());
        drop(UnixDatagram::bind(&path).unwrap());
        assert!(path.exists(), "a killed run leaves its name");

        let socket = PoseSocket::open(&source).unwrap().unwrap();
        let error = PoseSocket::open(&source).unwrap_err().to_string();
        assert!(error.contains("another process"), "{error}");
        UnixDatagram::unbound().unwrap().send_to(b"hello", &path).unwrap();
        let mut buffer = [0; 16];
        assert_eq!(socket.receive(&mut buffer, Duration::from_secs(10)).unwrap(), Some(5));
        assert_eq!(socket.receive(&mut buffer, Duration::from_millis(1)).unwrap(), None);
        drop(socket);
        assert!(!path.exists(), "a run that ends takes its name along");

        std::fs::write(&path, "a file").unwrap();
        let error = PoseSocket::open(&source).unwrap_err().to_string();
        assert!(error.contains("something else"), "{error}");
        assert!(path.exists());
    }
}
