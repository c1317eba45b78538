//! The settings of a run, as the configuration file (TOML) holds them; the command line overrides single ones.
//!
//! One plain struct a part. Keys that are not known are refused, and so are values out of range: a daemon that
//! starts does what its file says. `systemd/visagged.toml` shows every key with its unit and default; a test
//! keeps it so.

use std::f64::consts::PI;
use std::fmt;
use std::net::{SocketAddr, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use scip::transport::Address;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::mapper::{Fallback, MapperSettings, PoseUse};

/// All settings.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// The scanner.
    pub device: DeviceConfig,
    /// Poses from outside.
    pub pose: PoseConfig,
    /// The grid.
    pub mapper: MapperSettings,
    /// The recording.
    pub record: RecordConfig,
    /// The map's files.
    pub output: OutputConfig,
    /// The map that lives on from run to run.
    pub map: MapConfig,
}

/// The scanner and what is asked of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DeviceConfig {
    /// Where the scanner is: `/dev/ttyACM0`, `serial:PATH?baud=N`, `tcp://HOST:PORT` or `sim:WORLD`. Default: not set; it
    /// must be given here or by `--device`.
    pub url: Option<DeviceUrl>,
    /// First step of the window that is measured (steps, 0..=9999). Default: not set, the device's own first
    /// step (AMIN). SCIP 2.0, ME.
    pub first_step: Option<u16>,
    /// Last step of the window (steps, `first_step`..=9999). Default: not set, the device's last (AMAX).
    pub last_step: Option<u16>,
    /// Neighbouring steps of which only the nearest distance is sent (1..=99). Default: 1, every step. SCIP 2.0, ME.
    pub cluster: u8,
    /// Turns left out between two scans (0..=9). Default: 0, every turn. SCIP 2.0, ME.
    pub skip: u8,
    /// Whether intensities are sent too (ME instead of MD): twice the bytes, which some firmware cannot send at full
    /// rate. Default: true.
    pub intensity: bool,
    /// What the device's time stamp refers to. Default: `first-step`, as the specification says.
    pub stamp: StampReference,
    /// How long the device may stay silent before it is opened anew (s, 0.2..=60). Default: 1, forty turns of a
    /// UTM-30LX.
    pub silence_s: f64,
    /// How long to wait for a device at the start before giving up with exit code 69 (s, 0..=86400). Default: 0, for
    /// ever.
    pub wait_s: f64,
}

impl Default for DeviceConfig {
    fn default() -> Self {
        Self {
            url: None,
            first_step: None,
            last_step: None,
            cluster: 1,
            skip: 0,
            intensity: true,
            stamp: StampReference::FirstStep,
            silence_s: 1.0,
            wait_s: 0.0,
        }
    }
}

/// Moment of the turn that the device's stamp refers to; sources disagree.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StampReference {
    /// The moment of step 0 (C-42-03320B).
    FirstStep,
    /// The moment at which the beam points to the rear, an eighth of a turn before step 0 on a UTM-30LX.
    Rear,
}

/// Where a scanner is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DeviceUrl {
    /// A port of this host, or an Ethernet model.
    Port(Address),
    /// A simulated scanner in the world of this name or file.
    Sim(String),
}

/// Poses from outside.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PoseConfig {
    /// Where poses come from. `unix:PATH` or `udp://HOST:PORT` (loopback addresses only): datagrams with poses in the
    /// map. `match`: each scan is matched with those before; `match+unix:PATH` or `match+udp://HOST:PORT`: the same with
    /// odometry as a guide. `none`. Default: `match`.
    pub source: PoseSource,
    /// What becomes of scans for which no poses in the map come: `skip`, or `match`: they are matched with what was mapped before,
    /// until poses come again. Default: `skip`.
    pub fallback: Fallback,
    /// The frame whose poses are wanted; poses of any other (key `child`) are rejected. Default: `base_link` (REP-105).
    pub child: String,
    /// Poses that are older than this when they arrive are rejected (s, 0.01..=60). Default: 1.
    pub stale_s: f64,
    /// Poses that lie further ahead than this when they arrive are rejected (s, 0..=10). Default: 0.1.
    pub future_s: f64,
}

impl Default for PoseConfig {
    fn default() -> Self {
        Self {
            source: PoseSource::default(),
            fallback: Fallback::default(),
            child: "base_link".into(),
            stale_s: 1.0,
            future_s: 0.1,
        }
    }
}

/// Where poses come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PoseSource {
    /// Nowhere; then no scan is inserted.
    None,
    /// Datagrams on a Unix socket of this name.
    Unix(PathBuf),
    /// Datagrams on a loopback address.
    Udp(SocketAddr),
    /// Matching, guided by the odometry of this source.
    Match(Box<PoseSource>),
}

impl Default for PoseSource {
    fn default() -> Self {
        Self::Match(Box::new(Self::None))
    }
}

impl PoseSource {
    /// Where datagrams are received: `Unix`, `Udp` or `None`.
    pub fn socket(&self) -> &Self {
        match self {
            Self::Match(odometry) => odometry,
            given => given,
        }
    }

    /// What the poses are that come.
    pub fn pose_use(&self) -> PoseUse {
        match self {
            Self::Match(_) => PoseUse::Odometry,
            _ => PoseUse::Map,
        }
    }
}

/// The recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordConfig {
    /// Whether all that comes and goes is recorded. Default: false.
    pub enabled: bool,
    /// Folder of the recordings; it is made where it is missing. Default: `recordings`.
    pub folder: PathBuf,
    /// A file is closed and the next one begun at this size (bytes, 1048576..=1099511627776). Default: 1073741824,
    /// 1 GiB.
    pub rotate_bytes: u64,
    /// A file is closed and the next one begun after this time (s, 10..=86400). Default: 1800, 30 min.
    pub rotate_s: f64,
}

impl Default for RecordConfig {
    fn default() -> Self {
        Self { enabled: false, folder: "recordings".into(), rotate_bytes: 1 << 30, rotate_s: 1800.0 }
    }
}

/// The map's files.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OutputConfig {
    /// Folder of the map's files; it is made where it is missing. Default: not set, no files.
    pub folder: Option<PathBuf>,
    /// Time between two writings of the files while running (s, 1..=86400); they are written at the end in any
    /// case. Default: 30.
    pub every_s: f64,
}

impl Default for OutputConfig {
    fn default() -> Self {
        Self { folder: None, every_s: 30.0 }
    }
}

/// The map that lives on from run to run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MapConfig {
    /// File that holds all that the grid knows. Where there is one at the start, the run goes on in it; it is saved now and
    /// then and at the end. Default: not set, each run begins an empty map.
    pub file: Option<PathBuf>,
    /// Time between two savings while running (s, 1..=86400): what a power cut may cost. Default: 60.
    pub every_s: f64,
    /// Whether to begin an empty map although there is one; that one becomes `FILE.former`. Default: false.
    pub fresh: bool,
}

impl Default for MapConfig {
    fn default() -> Self {
        Self { file: None, every_s: 60.0, fresh: false }
    }
}

/// Why a configuration was refused.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read the configuration {}: {error}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        error: std::io::Error,
    },
    /// Not TOML, an unknown key, or a value of the wrong kind; the text has line and caret.
    #[error("in the configuration {}: {error}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What the parser said.
        error: Box<toml::de::Error>,
    },
    /// A value that has the right kind but cannot be meant.
    #[error("in the configuration {}: {error}", path.display())]
    OutOfRange {
        /// The file.
        path: PathBuf,
        /// The setting and its range.
        error: OutOfRange,
    },
}

/// A setting with a value that cannot be meant.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{key} = {value} is out of range: {wanted}")]
pub struct OutOfRange {
    /// Table and key.
    pub key: &'static str,
    /// What was given.
    pub value: String,
    /// What it may be.
    pub wanted: String,
}

impl Config {
    /// Reads and checks a file.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path)
            .map_err(|error| ConfigError::Unreadable { path: path.to_owned(), error })?;
        let config: Self = toml::from_str(&text)
            .map_err(|error| ConfigError::Malformed { path: path.to_owned(), error: Box::new(error) })?;
        config.check().map_err(|error| ConfigError::OutOfRange { path: path.to_owned(), error })?;
        Ok(config)
    }

    /// Whether every value lies in its range.
    pub fn check(&self) -> Result<(), OutOfRange> {
        let device = &self.device;
        within("device.first_step", device.first_step.unwrap_or(0), 0, 9999)?;
        within("device.last_step", device.last_step.unwrap_or(9999), device.first_step.unwrap_or(0), 9999)?;
        within("device.cluster", device.cluster, 1, 99)?;
        within("device.skip", device.skip, 0, 9)?;
        within("device.silence_s", device.silence_s, 0.2, 60.0)?;
        within("device.wait_s", device.wait_s, 0.0, 86400.0)?;
        let mapper = &self.mapper;
        within("mapper.resolution", mapper.resolution, 0.01, 0.5)?;
        within("mapper.pose_wait", mapper.pose_wait, 0.0, 10.0)?;
        within("mapper.pose_gap", mapper.pose_gap, 0.0, 10.0)?;
        within("mapper.mount.x", mapper.mount.x, -100.0, 100.0)?;
        within("mapper.mount.y", mapper.mount.y, -100.0, 100.0)?;
        within("mapper.mount.yaw", mapper.mount.yaw, -PI, PI)?;
        let grid = &mapper.visagge;
        within("mapper.visagge.range_sigma", grid.range_sigma, 0.0, 0.1)?;
        within("mapper.visagge.position_sigma", grid.position_sigma, 0.0, 0.5)?;
        within("mapper.visagge.heading_sigma", grid.heading_sigma, 0.0, 0.1)?;
        within("mapper.visagge.drift", grid.drift, 0.0, 1.0)?;
        within("mapper.visagge.range_max", grid.range_max, 1.0, 60.0)?;
        within("mapper.visagge.no_return_range", grid.no_return_range, 0.0, 30.0)?;
        within("mapper.visagge.contradiction", grid.contradiction, 1, 100)?;
        within("mapper.visagge.occupancy_cap", grid.occupancy_cap, 1, 200)?;
        within("mapper.visagge.look_every", grid.look_every, 0.0, 1.0)?;
        within("mapper.visagge.body_radius", grid.body_radius, 0.0, 1.0)?;
        let localize = &mapper.localize;
        within("mapper.localize.spacing", localize.spacing, 0.02, 1.0)?;
        within("mapper.localize.points", localize.points, 50, 1081)?;
        within("mapper.localize.key_way", localize.key_way, 0.02, 1.0)?;
        within("mapper.localize.key_turn", localize.key_turn, 0.01, 1.0)?;
        within("mapper.localize.submap_way", localize.submap_way, 5.0, 1000.0)?;
        within("mapper.localize.explained", localize.explained, 0.1, 0.9)?;
        within("mapper.localize.position_sigma", localize.position_sigma, 0.01, 1.0)?;
        within("mapper.localize.heading_sigma", localize.heading_sigma, 0.005, 0.5)?;
        within("mapper.localize.lost_sigma", localize.lost_sigma, 0.1, 10.0)?;
        within("pose.stale_s", self.pose.stale_s, 0.01, 60.0)?;
        within("pose.future_s", self.pose.future_s, 0.0, 10.0)?;
        within("record.rotate_bytes", self.record.rotate_bytes, 1 << 20, 1 << 40)?;
        within("record.rotate_s", self.record.rotate_s, 10.0, 86400.0)?;
        within("output.every_s", self.output.every_s, 1.0, 86400.0)?;
        within("map.every_s", self.map.every_s, 1.0, 86400.0)?;
        if self.map.file.is_some() && !crate::saved::is_kept(mapper.mapper) {
            return Err(OutOfRange {
                key: "mapper.mapper",
                value: format!("{:?}", mapper.mapper).to_lowercase(),
                wanted: "visagge or paper, where map.file is set: the grids for comparison cannot be saved"
                    .into(),
            });
        }
        Ok(())
    }
}

/// NaN lies in no range.
fn within<T: PartialOrd + fmt::Display>(
    key: &'static str,
    value: T,
    least: T,
    most: T,
) -> Result<(), OutOfRange> {
    if value >= least && value <= most {
        return Ok(());
    }
    Err(OutOfRange { key, value: value.to_string(), wanted: format!("{least} to {most}") })
}

impl FromStr for DeviceUrl {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.strip_prefix("sim:") {
            Some("") => Err(format!("{text:?} names no world; try sim:hall")),
            Some(world) => Ok(Self::Sim(world.to_owned())),
            None => text
                .parse()
                .map(Self::Port)
                .map_err(|error| format!("{error}, or sim:WORLD for a simulated scanner")),
        }
    }
}

impl fmt::Display for DeviceUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Port(address) => address.fmt(f),
            Self::Sim(world) => write!(f, "sim:{world}"),
        }
    }
}

impl FromStr for PoseSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "none" {
            return Ok(Self::None);
        }
        if text == "match" {
            return Ok(Self::default());
        }
        if let Some(odometry) = text.strip_prefix("match+") {
            return match odometry.parse()? {
                source @ (Self::Unix(_) | Self::Udp(_)) => Ok(Self::Match(Box::new(source))),
                _ => Err(format!("{text:?} names no odometry: match+unix:PATH or match+udp://HOST:PORT")),
            };
        }
        if let Some(path) = text.strip_prefix("unix:").filter(|path| !path.is_empty()) {
            return Ok(Self::Unix(path.into()));
        }
        let Some(address) = text.strip_prefix("udp://") else {
            return Err(format!(
                "{text:?} is none of match, unix:PATH, udp://HOST:PORT, match+unix:PATH, match+udp://HOST:PORT, none"
            ));
        };
        let mut addresses =
            address.to_socket_addrs().map_err(|error| format!("{text:?} is not udp://HOST:PORT: {error}"))?;
        // Whoever can send a pose can spoil the map, and a datagram carries no proof of who sent it.
        addresses.find(|address| address.ip().is_loopback()).map(Self::Udp).ok_or_else(|| {
            format!(
                "{text:?} is not a loopback address; poses are taken from this host only (127.0.0.1, [::1])"
            )
        })
    }
}

impl fmt::Display for PoseSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => f.write_str("none"),
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
            Self::Udp(address) => write!(f, "udp://{address}"),
            Self::Match(odometry) if **odometry == Self::None => f.write_str("match"),
            Self::Match(odometry) => write!(f, "match+{odometry}"),
        }
    }
}

/// Serde by way of the text form.
macro_rules! as_text {
    ($type:ty) => {
        impl Serialize for $type {
            fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.collect_str(self)
            }
        }
        impl<'de> Deserialize<'de> for $type {
            fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
            }
        }
    };
}
as_text!(DeviceUrl);
as_text!(PoseSource);

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str) -> Result<Config, String> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        Config::load(file.path()).map_err(|error| error.to_string())
    }

    /// The shipped example with its commented-out settings in force: they are lines that begin with `#` and no
    /// space, text begins with `# `.
    fn example_in_force() -> String {
        include_str!("../systemd/visagged.toml")
            .lines()
            .map(|line| match line.strip_prefix('#') {
                Some(setting) if setting.starts_with(|first: char| first.is_ascii_lowercase()) => setting,
                _ => line,
            })
            .collect::<Vec<_>>()
            .join("\n")
    }

    #[test]
    fn the_example_is_accepted_and_shows_the_defaults() {
        let example = Config::load(Path::new("systemd/visagged.toml")).unwrap();
        let mut shown: Config = load(&example_in_force()).unwrap();
        assert_eq!(shown.device.url, example.device.url);
        // What the example sets for the service is no default.
        shown.device.url = None;
        shown.pose.source = PoseSource::default();
        shown.record.folder = RecordConfig::default().folder;
        shown.output.folder = None;
        shown.map.file = None;
        assert_eq!(shown, Config::default());
    }

    #[test]
    fn the_example_names_every_setting() {
        let example: toml::Table = example_in_force().parse().unwrap();
        let example_text = include_str!("../systemd/visagged.toml");
        let all = toml::Table::try_from(Config::default()).unwrap();
        for (part, settings) in &all {
            for key in settings.as_table().unwrap().keys() {
                let shown = example.get(part).and_then(|settings| settings.get(key));
                assert!(shown.is_some(), "{part}.{key} is not in systemd/visagged.toml");
            }
        }
        // Settings that are not set by default cannot be in the table above.
        for key in ["url", "first_step", "last_step", "folder", "file"] {
            assert!(example_text.contains(&format!("{key} = ")), "{key}");
        }
    }

    #[test]
    fn an_unknown_key_is_refused_with_its_line_and_the_known_ones() {
        let error = load("[device]\nurl = \"/dev/ttyACM0\"\nclusters = 3\n").unwrap_err();
        assert!(error.contains("line 3, column 1"), "{error}");
        assert!(error.contains("3 | clusters = 3") && error.contains("^^^^^^^^"), "{error}");
        assert!(error.contains("unknown field `clusters`") && error.contains("`cluster`"), "{error}");
    }

    #[test]
    fn values_out_of_range_are_refused_by_name() {
        for (text, wanted) in [
            ("[device]\ncluster = 0", "device.cluster = 0 is out of range: 1 to 99"),
            ("[device]\nskip = 10", "device.skip = 10 is out of range: 0 to 9"),
            (
                "[device]\nfirst_step = 500\nlast_step = 400",
                "device.last_step = 400 is out of range: 500 to 9999",
            ),
            ("[device]\nsilence_s = nan", "device.silence_s = NaN"),
            ("[mapper.mount]\nyaw = 90", "mapper.mount.yaw = 90 is out of range: -3.14"),
            ("[pose]\nstale_s = 0", "pose.stale_s = 0"),
            ("[record]\nrotate_bytes = 1", "record.rotate_bytes = 1"),
            ("[output]\nevery_s = inf", "output.every_s = inf"),
            ("[map]\nevery_s = 0", "map.every_s = 0"),
            ("[map]\nfile = \"a\"\n[mapper]\nmapper = \"standard\"", "mapper.mapper = standard"),
        ] {
            let error = load(text).unwrap_err();
            assert!(error.contains(wanted), "{error}");
        }
    }

    #[test]
    fn urls_and_sources_are_read_and_written_alike() {
        for text in ["serial:/dev/ttyS0?baud=19200", "tcp://192.168.0.10:10940", "sim:hall"] {
            assert_eq!(text.parse::<DeviceUrl>().unwrap().to_string(), text);
        }
        for text in ["", "ttyACM0", "serial:", "sim:", "tcp://:1", "tcp://host:http", "http://host:1"] {
            assert!(text.parse::<DeviceUrl>().is_err(), "{text}");
        }
        for text in [
            "none",
            "match",
            "match+unix:/run/visagged/wheels",
            "unix:/run/visagged/pose",
            "udp://127.0.0.1:7777",
            "udp://[::1]:7777",
        ] {
            assert_eq!(text.parse::<PoseSource>().unwrap().to_string(), text);
        }
        for text in
            ["", "unix:", "udp://127.0.0.1", "udp://192.0.2.1:7777", "match+", "match+none", "match+match"]
        {
            assert!(text.parse::<PoseSource>().is_err(), "{text}");
        }
    }
}
