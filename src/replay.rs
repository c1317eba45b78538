//! Feeds what was recorded to a mapper, in the order in which it takes it.
//!
//! Not the map's files, which the caller writes, and not the formats, which are in `input`.

mod optimize;

use std::path::PathBuf;

use crate::closing::Task;
use crate::input::{self, InputError, InputOptions, InputReport, Sink};
use crate::mapper::{GoingOnError, LocalizeReport, Mapper, MapperKind, MapperSettings, Mount, Outcome};
use crate::pose::StampedPose;
use crate::saved::{LoadError, MapFile, SavedMap};
use crate::scan::Scan;

/// What to replay, and how.
#[derive(Clone, Debug, Default)]
pub struct ReplayOptions {
    /// Files of one recording, in any order where they tell their time.
    pub inputs: Vec<PathBuf>,
    /// How to read them.
    pub input: InputOptions,
    /// Settings of the mapper; `None`: those of the recording, or the defaults.
    pub mapper: Option<MapperSettings>,
    /// Kind of the mapper in the place of what the settings say.
    pub mapper_kind: Option<MapperKind>,
    /// Beams that show the robot, beside those of the settings: first and last of each group.
    pub ignore_beams: Vec<[usize; 2]>,
    /// File of the map to go on in where it is there, in the place of the one that the recorded run went on in.
    pub map: Option<PathBuf>,
    /// Whether to begin an empty map in any case.
    pub fresh: bool,
    /// Whether to close the drive's loops, in a second pass; the map begins empty then.
    pub optimize: bool,
}

/// Why a replay ended without a map.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The input cannot be replayed.
    #[error(transparent)]
    Input(#[from] InputError),
    /// Settings of another version.
    #[error(
        "the recording was made with settings that this version does not know ({0}); give --config FILE instead"
    )]
    Settings(serde_json::Error),
    /// The map to go on in cannot be used.
    #[error(transparent)]
    Map(#[from] LoadError),
    /// The map to go on in is none.
    #[error("the map {}: {error}", path.display())]
    GoingOn {
        /// Its file.
        path: PathBuf,
        /// Why not.
        error: GoingOnError,
    },
}

/// How far a replay is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Bytes read of all files.
    pub bytes: u64,
    /// Their size.
    pub total: u64,
}

/// A replay that has ended.
#[derive(Debug)]
pub struct Replay {
    /// The mapper with its map.
    pub mapper: Mapper,
    /// Settings that it had.
    pub settings: MapperSettings,
    /// What was read.
    pub input: InputReport,
    /// How the scans were located where another pass did it.
    pub localization: Option<Box<LocalizeReport>>,
    /// Where the map is to be saved, if it is.
    pub map_file: Option<MapFile>,
}

/// Replays all of `options.inputs`. `on_outcome` gets what became of each scan, in order, with the time since 1970 as its
/// stamp where the input tells it; `on_progress` is called a few thousand times at most.
///
/// # Errors
/// Where there is nothing to make a map from. Damage within the input is none: it is in the report.
pub fn run(
    options: &ReplayOptions,
    on_outcome: &mut dyn FnMut(Outcome),
    on_progress: &mut dyn FnMut(Progress),
) -> Result<Replay, ReplayError> {
    if options.optimize {
        return optimize::run(options, on_outcome, on_progress);
    }
    let mut report = InputReport::default();
    let mut source = open(options, &mut report)?;
    let settings = settings(options, source.as_ref())?;
    let (mapper, map_file) = begin(options, &settings, source.begun_with(), &mut report)?;
    let total = source.bytes();
    // Of a run that went on in another map, or had other settings, it is of no use to know.
    let is_same = options.mapper.is_none() && options.map.is_none() && !options.fresh;
    let mut feeder = Feeder {
        mapper,
        tasks: if is_same && source.tells_of_tasks() { Tasks::AsRecorded(None) } else { Tasks::AtOnce },
        wall_offset_ns: source.wall_offset_ns(),
        on_outcome,
        on_progress,
        progress: Progress { bytes: 0, total },
    };
    source.feed(&mut feeder, &mut report)?;
    feeder.do_last_tasks();
    feeder.mapper.finish();
    feeder.give_outcomes();
    feeder.progress(total);
    Ok(Replay { mapper: feeder.mapper, localization: None, settings, input: report, map_file })
}

/// The input, which has to know whether the settings tell where the scanner is.
fn open(options: &ReplayOptions, report: &mut InputReport) -> Result<Box<dyn input::Source>, InputError> {
    let is_told = options.mapper.as_ref().is_some_and(|settings| settings.mount != Mount::default());
    let mount_in_settings = options.input.mount_in_settings || is_told;
    input::open(&options.inputs, &InputOptions { mount_in_settings, ..options.input.clone() }, report)
}

/// A mapper in the map that it is to go on in, or else an empty one; and where it is to be saved.
fn begin(
    options: &ReplayOptions,
    settings: &MapperSettings,
    begun_with: Option<&[u8]>,
    report: &mut InputReport,
) -> Result<(Mapper, Option<MapFile>), ReplayError> {
    if let Some(path) = &options.map {
        let (file, saved) = MapFile::open(path, options.fresh, settings)?;
        let mapper = match saved {
            None => Mapper::new(settings.clone()),
            Some(loaded) => Mapper::going_on(&loaded.map, settings.clone())
                .map_err(|error| ReplayError::GoingOn { path: path.clone(), error })?,
        };
        return Ok((mapper, Some(file)));
    }
    let Some(bytes) = begun_with.filter(|_| !options.fresh) else {
        return Ok((Mapper::new(settings.clone()), None));
    };
    let going_on = SavedMap::decode(bytes)
        .map_err(|damage| damage.to_string())
        .and_then(|saved| Mapper::going_on(&saved, settings.clone()).map_err(|error| error.to_string()));
    let mapper = going_on.unwrap_or_else(|why| {
        report.note(format!(
            "the recorded run went on in a map that is of no use here ({why}); this one begins empty"
        ));
        Mapper::new(settings.clone())
    });
    Ok((mapper, None))
}

/// The options' settings or else the recording's, with what the input tells of the mount where the options do not.
fn settings(options: &ReplayOptions, source: &dyn input::Source) -> Result<MapperSettings, ReplayError> {
    let mut settings = match (&options.mapper, source.recorded_mapper()) {
        (Some(settings), _) => settings.clone(),
        (None, Some(recorded)) => serde_json::from_value(recorded.clone()).map_err(ReplayError::Settings)?,
        (None, None) => MapperSettings::default(),
    };
    if let Some(mount) = source.mount() {
        let (x, y, yaw) = (mount.translation.x, mount.translation.y, mount.rotation.angle());
        // Where the input knows of a scanner that hangs head down, it has turned the bearings already.
        settings.mount = Mount { x, y, yaw, upside_down: false };
    }
    if let Some(pose_use) = source.pose_use() {
        settings.poses = pose_use;
    }
    if let Some(kind) = options.mapper_kind {
        settings.mapper = kind;
    }
    settings.ignore_beams.extend(&options.ignore_beams);
    Ok(settings)
}

/// When what the mapper has to do about loops is taken to be done.
enum Tasks {
    /// As soon as it is to be done.
    AtOnce,
    /// When the recording says so; the one that is waiting for that.
    AsRecorded(Option<Task>),
}

/// Calls the mapper.
struct Feeder<'a> {
    mapper: Mapper,
    tasks: Tasks,
    wall_offset_ns: i64,
    on_outcome: &'a mut dyn FnMut(Outcome),
    on_progress: &'a mut dyn FnMut(Progress),
    progress: Progress,
}

impl Feeder<'_> {
    fn give_outcomes(&mut self) {
        while let Some(outcome) = self.mapper.next_outcome() {
            (self.on_outcome)(outcome.shifted(self.wall_offset_ns));
        }
    }

    fn do_tasks(&mut self) {
        match &mut self.tasks {
            Tasks::AtOnce => {
                while let Some(task) = self.mapper.next_task() {
                    self.mapper.take_back(task.run());
                }
            }
            Tasks::AsRecorded(waiting) if waiting.is_none() => *waiting = self.mapper.next_task(),
            Tasks::AsRecorded(_) => {}
        }
        self.give_outcomes();
    }

    /// A recording tells of the last tasks as well.
    fn do_last_tasks(&mut self) {
        if let Tasks::AtOnce = self.tasks
            && let Some(task) = self.mapper.last_task()
        {
            self.mapper.take_back(task.run());
            self.do_tasks();
        }
    }

    fn progress(&mut self, bytes: u64) {
        self.progress.bytes = bytes;
        (self.on_progress)(self.progress);
    }
}

impl Sink for Feeder<'_> {
    fn on_pose(&mut self, pose: StampedPose) {
        self.mapper.on_pose(pose);
        self.do_tasks();
    }

    fn on_scan(&mut self, scan: Scan) {
        self.mapper.on_scan(scan);
        self.do_tasks();
    }

    fn on_task_done(&mut self) {
        if let Tasks::AsRecorded(waiting) = &mut self.tasks
            // Where none was waiting, the run had come to its end.
            && let Some(task) = waiting.take().or_else(|| self.mapper.last_task())
        {
            self.mapper.take_back(task.run());
            self.do_tasks();
        }
    }

    fn on_progress(&mut self, bytes: u64) {
        // A thousandth is finer than any bar.
        if bytes >= self.progress.bytes + (self.progress.total / 1000).max(1) {
            self.progress(bytes.min(self.progress.total));
        }
    }
}

/// A bar for [`run`] on standard error; hidden where that is no terminal.
pub fn progress_bar() -> indicatif::ProgressBar {
    let style = "{wide_bar} {bytes}/{total_bytes} {elapsed} (eta {eta})";
    let bar = indicatif::ProgressBar::new(0);
    match indicatif::ProgressStyle::with_template(style) {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    }
}

/// Shows a progress on a bar.
pub fn show(bar: &indicatif::ProgressBar, progress: Progress) {
    bar.set_length(progress.total);
    bar.set_position(progress.bytes);
}
