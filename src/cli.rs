//! The command line: what it may say. What it does is in `main.rs`.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};

use serde::Deserialize;

use crate::config::{Config, DeviceUrl, PoseSource};
use crate::input::{self, InputOptions};
use crate::mapper::MapperKind;
use crate::pose::Pose;

/// Shown where neither arguments nor a configuration say what to do.
pub const WHAT_IS_NEEDED: &str = "\
visagged needs a scanner, or a recording to replay.

  A demo without a scanner:   visagged --device sim:hall --out demo
  A scanner on USB:           visagged --device /dev/ttyACM0 --out map
  ... on a robot with poses:  visagged --device /dev/ttyACM0 --pose unix:/tmp/pose --out map
  A scanner on Ethernet:      visagged --device tcp://192.168.0.10:10940 --pose udp://127.0.0.1:7777 --out map
  A recording, bag or log:    visagged replay FILE --out map
  As a service:               visagged --config /etc/visagged.toml

`visagged --help` tells the rest.";

const EXIT_CODES: &str = "\
Exit codes: 0 done, 2 usage, 69 no device, 74 input or output failed, 78 configuration.
`recover` has its own: 0 nothing lost, 3 the cut end lost, 1 failed.";

/// Drives a Hokuyo laser scanner and keeps an occupancy grid that remembers glass.
#[derive(Debug, Parser)]
#[command(version, about, after_help = EXIT_CODES, args_conflicts_with_subcommands = true)]
pub struct Cli {
    /// What to do other than to run a scanner.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// How to run a scanner.
    #[command(flatten)]
    pub run: RunArgs,
}

/// How to run a scanner. What is given here overrides the configuration.
#[derive(Debug, Default, Args)]
pub struct RunArgs {
    /// Configuration (TOML); systemd/visagged.toml explains every setting.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// The scanner: /dev/ttyACM0, serial:PATH, tcp://HOST:PORT, or sim:WORLD for a simulated one with its poses.
    #[arg(long, value_name = "URL")]
    pub device: Option<DeviceUrl>,
    /// Record all that comes and goes, to DIR where given.
    #[arg(long, value_name = "DIR", num_args = 0..=1, require_equals = true)]
    pub record: Option<Option<PathBuf>>,
    /// Where poses come from: unix:PATH or udp://HOST:PORT for poses in the map; match, or match+unix:PATH and
    /// match+udp://HOST:PORT with odometry as a guide; none. Without it, match.
    #[arg(long, value_name = "SRC")]
    pub pose: Option<PoseSource>,
    /// Folder of the map's files.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// The map that lives on: go on in FILE where it is there, and save it there now and then and at the end.
    #[arg(long, value_name = "FILE")]
    pub map: Option<PathBuf>,
    /// Begin an empty map although there is one; that one becomes FILE.former.
    #[arg(long)]
    pub fresh: bool,
    /// End after this many seconds.
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub duration: Option<f64>,
}

/// What to do other than to run a scanner.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Make the map of recordings, bags, captures or logs.
    Replay(Box<ReplayArgs>),
    /// Complete a recording that was cut off; FILE is kept, the result is put beside it.
    Recover {
        /// The recording.
        file: PathBuf,
    },
    /// Say whether a configuration would be accepted.
    CheckConfig {
        /// The configuration.
        file: PathBuf,
    },
    /// Ask a scanner who it is, or list the serial ports where one may be.
    Identify {
        /// The scanner: /dev/ttyACM0, serial:PATH, tcp://HOST:PORT or sim:WORLD. All ports are listed where none is named.
        device: Option<DeviceUrl>,
    },
}

/// How to make a map of files.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// Recordings and bags (.mcap, or a folder of them), Carmen logs (.log, .clf, .gz) or byte streams captured
    /// from a port (.scip). Several are taken for parts of one drive.
    #[arg(required = true, value_name = "INPUT")]
    pub inputs: Vec<PathBuf>,
    /// Folder of the map's files.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Poses: recorded, tf, odom, FILE.tum, fixed where the scanner stood still, fixed:X,Y,YAW (m, m, rad), match with
    /// the input's odometry as a guide, or match-ranges without. Without it, what the input has, else match. A bag's
    /// transforms are taken for true; of its odometry topic that is done by odom only, else it is a guide.
    #[arg(long, value_name = "SRC")]
    pub pose: Option<input::PoseSource>,
    /// Kind of the grid: visagge, paper, standard, visits or glints. Without it, that of the recording, or visagge.
    #[arg(long, value_name = "KIND", value_parser = mapper_kind)]
    pub mapper: Option<MapperKind>,
    /// Configuration, of which the table `mapper` is used in the place of what the recording says.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Go on in the map of FILE where it is there, and save it there at the end. Without it, a recording of a run that went
    /// on in a map begins with that one, which it holds.
    #[arg(long, value_name = "FILE")]
    pub map: Option<PathBuf>,
    /// Begin an empty map although there is one; that of --map becomes FILE.former.
    #[arg(long)]
    pub fresh: bool,
    /// Close loops: a first pass locates all scans and finds where the drive came back, a second one maps them where they then
    /// belong. What is good already is not touched.
    #[arg(long, conflicts_with_all = ["map", "fresh"])]
    pub optimize: bool,
    /// Write explain.png too: why each cell is shown (black solid, blue a surface visible near its normal, green seen
    /// again, light blue in a gap, violet long, straight and seen often, dark green seen for long) or not (sand too few
    /// returns, red somebody who moved, pink an image in a mirror or pane).
    #[arg(long)]
    pub explain: bool,
    /// Topic of the scans in a bag.
    #[arg(long, value_name = "TOPIC")]
    pub scan_topic: Option<String>,
    /// Topic of the odometry in a bag, which is then the guide. Without it, the only one, or /odom.
    #[arg(long, value_name = "TOPIC")]
    pub odom_topic: Option<String>,
    /// Frame in which the map is made. Without it, map where the bag has it, else its highest.
    #[arg(long, value_name = "FRAME")]
    pub fixed_frame: Option<String>,
    /// Frame of the robot. Without it, base_link, or base_footprint.
    #[arg(long, value_name = "FRAME")]
    pub base_frame: Option<String>,
    /// The scanner on the robot, where the input does not tell or tells it wrong (m, m, rad). Without it, what
    /// `[mapper.mount]` in --config says, where the input does not tell.
    #[arg(long, value_name = "X,Y,YAW", value_parser = mount, allow_hyphen_values = true)]
    pub mount: Option<Pose>,
    /// Beams that show the robot itself, counted from 0; may be given several times.
    #[arg(long, value_name = "FIRST-LAST", value_parser = beams)]
    pub ignore_beams: Vec<[usize; 2]>,
    /// Model of the scanner that a bare byte stream came from. Without it, what the stream says, or UTM-30LX.
    #[arg(long, value_name = "MODEL")]
    pub model: Option<String>,
}

impl ReplayArgs {
    /// How the files are to be read.
    pub fn input_options(&self) -> InputOptions {
        InputOptions {
            pose: self.pose.clone(),
            scan_topic: self.scan_topic.clone(),
            odom_topic: self.odom_topic.clone(),
            fixed_frame: self.fixed_frame.clone(),
            base_frame: self.base_frame.clone(),
            mount: self.mount,
            mount_in_settings: false,
            model: self.model.clone(),
        }
    }
}

impl RunArgs {
    /// Whether nothing at all was asked for.
    pub fn is_empty(&self) -> bool {
        let Self { config, device, record, pose, out, map, fresh, duration } = self;
        config.is_none()
            && device.is_none()
            && record.is_none()
            && pose.is_none()
            && out.is_none()
            && map.is_none()
            && !fresh
            && duration.is_none()
    }

    /// Puts what was given in the place of what the configuration says.
    pub fn override_config(&self, config: &mut Config) {
        if let Some(device) = &self.device {
            config.device.url = Some(device.clone());
        }
        if let Some(folder) = &self.record {
            config.record.enabled = true;
            if let Some(folder) = folder {
                config.record.folder = folder.clone();
            }
        }
        if let Some(pose) = &self.pose {
            config.pose.source = pose.clone();
        }
        if let Some(out) = &self.out {
            config.output.folder = Some(out.clone());
        }
        if let Some(file) = &self.map {
            config.map.file = Some(file.clone());
        }
        config.map.fresh |= self.fresh;
    }
}

/// As the configuration spells it.
fn mapper_kind(text: &str) -> Result<MapperKind, String> {
    let value = serde::de::value::StrDeserializer::<serde::de::value::Error>::new(text);
    MapperKind::deserialize(value).map_err(|error| error.to_string())
}

fn mount(text: &str) -> Result<Pose, String> {
    match format!("fixed:{text}").parse()? {
        input::PoseSource::Fixed(pose) => Ok(pose),
        _ => Err("X,Y,YAW in metres and radians are wanted".into()),
    }
}

fn beams(text: &str) -> Result<[usize; 2], String> {
    text.split_once('-')
        .and_then(|(first, last)| Some([first.parse().ok()?, last.parse().ok()?]))
        .filter(|[first, last]| first <= last)
        .ok_or_else(|| "two numbers of beams are wanted, such as 0-40".into())
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds > 0.0 && seconds <= 1e9 => Ok(seconds),
        _ => Err("a time in seconds is wanted, larger than 0".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(arguments: &[&str]) -> RunArgs {
        Cli::try_parse_from(["visagged"].iter().chain(arguments)).unwrap().run
    }

    #[test]
    fn the_command_line_wins_over_the_configuration() {
        let mut config: Config =
            toml::from_str("[device]\nurl = \"/dev/a\"\nskip = 1\n[pose]\nsource = \"unix:/a\"\n").unwrap();
        run(&["--device", "tcp://b:1", "--record=there", "--pose", "none", "--out", "map"])
            .override_config(&mut config);
        assert_eq!(config.device.url, Some("tcp://b:1".parse().unwrap()));
        assert_eq!(config.device.skip, 1);
        assert!(config.record.enabled);
        assert_eq!(config.record.folder, PathBuf::from("there"));
        assert_eq!(config.pose.source, PoseSource::None);
        assert_eq!(config.output.folder, Some("map".into()));
    }

    #[test]
    fn record_needs_no_folder_and_does_not_take_the_next_argument_for_one() {
        let mut config = Config::default();
        let run = run(&["--record", "--out", "map"]);
        run.override_config(&mut config);
        assert!(config.record.enabled);
        assert_eq!(config.record.folder, PathBuf::from("recordings"));
    }

    #[test]
    fn kinds_and_beams_are_read() {
        let replay = |arguments: &[&str]| {
            let all = ["visagged", "replay", "a.mcap", "--out", "b"];
            match Cli::try_parse_from(all.iter().chain(arguments)).map(|cli| cli.command) {
                Ok(Some(Command::Replay(replay))) => Some(replay),
                _ => None,
            }
        };
        let parsed =
            replay(&["--mapper", "standard", "--ignore-beams", "0-40", "--ignore-beams", "7-7"]).unwrap();
        assert_eq!(parsed.mapper, Some(MapperKind::Standard));
        assert_eq!(parsed.ignore_beams, [[0, 40], [7, 7]]);
        assert!(replay(&["--mount", "-0.1,0,3.14"]).unwrap().mount.is_some());
        for bad in
            [["--mapper", "other"], ["--ignore-beams", "5-4"], ["--ignore-beams", "5"], ["--mount", "1,2"]]
        {
            assert!(replay(&bad).is_none(), "{bad:?}");
        }
    }

    #[test]
    fn durations_are_positive_numbers() {
        assert_eq!(run(&["--duration", "2.5"]).duration, Some(2.5));
        for bad in ["0", "-1", "nan", "inf", "5s", ""] {
            assert!(Cli::try_parse_from(["visagged", "--duration", bad]).is_err(), "{bad}");
        }
    }
}
