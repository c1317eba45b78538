//! A live run: the threads, their start, their supervision and their end in order.
//!
//! | thread | owns | file |
//! |---|---|---|
//! | driver | port and SCIP session | [`driver`] |
//! | poses | the socket on which poses arrive | [`poses`] |
//! | mapper | the grid and the poses | [`mapping`] |
//! | loops | the task about loops that it is doing | [`mapping`] |
//! | recorder | the recording | [`recording`] |
//! | main | signals, supervision, status, the map's files | this one |
//!
//! They speak through bounded queues ([`queues`]). The end goes downstream: the driver turns the laser off and ends, then
//! the poses, then the mapper once its queue is empty and the loops are closed, then the recorder. Each thread ends because all that write to
//! its queue have, so nothing that was accepted is lost. A thread that ends by itself or panics sets the same end
//! off, and the run then fails.

pub mod clock;
pub mod device;
pub mod driver;
pub mod mapping;
pub mod poses;
pub mod queues;
pub mod recording;
pub mod shared;
pub mod simulator;
mod status;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use crossbeam_channel::{Receiver, Sender as PlainSender, bounded, unbounded};
use log::{error, info, warn};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use crate::config::Config;
use crate::exit::{Exit, Failure};
use crate::grid::snapshot::Snapshot;
use crate::localize::Tracking;
use crate::map::Map;
use crate::mapper::{Mapper, MapperReport, PoseUse};
use crate::notify::Manager;
use crate::output::Outputs;
use crate::pose_input::{PoseReader, PoseSocket};
use crate::record::{Record, Recorder, RecorderReport, RecorderSettings};
use crate::report::{MapSummary, Mode, Report, Versions};
use crate::saved::{LoadError, Loaded, MapFile, SavedMap};
use driver::{Driver, Opener};
use mapping::{FromMapper, Mapping, Tasks};
use queues::{Gauge, Sender, TO_MAIN, TO_MAPPER, TO_RECORDER, queue};
use shared::{Shared, lock};
use status::Status;

/// How often main looks after the others.
const TICK: Duration = Duration::from_millis(200);
/// How long the end in order may take; then the run is ended without it.
const PATIENCE_AT_END: Duration = Duration::from_secs(45);

/// What a run needs beside its configuration.
pub struct Run {
    /// The settings, checked.
    pub config: Config,
    /// The file that they came from, to be looked at again on SIGHUP.
    pub config_file: Option<PathBuf>,
    /// Ends the run after this time.
    pub duration: Option<Duration>,
    /// Opens the scanner.
    pub opener: Opener,
    /// Settings of the session with the scanner.
    pub session: scip::SessionSettings,
    /// Whether the scanner has nothing more to show: the drive of a simulated one has ended.
    pub is_over: Box<dyn FnMut() -> bool>,
}

/// A thread has ended.
struct Ended {
    name: &'static str,
    panicked: bool,
}

/// Reports the end of its thread, however it comes.
struct EndReporter {
    name: &'static str,
    ended: PlainSender<Ended>,
}

impl Drop for EndReporter {
    fn drop(&mut self) {
        // Main outlives all threads but where the process is ending anyway.
        let _ = self.ended.send(Ended { name: self.name, panicked: thread::panicking() });
    }
}

/// How far the run is.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Phase {
    Running,
    /// The driver is ending; the end has to be complete at this time.
    Stopping(Instant),
}

/// Main's view of the run.
struct Supervisor {
    config: Config,
    config_file: Option<PathBuf>,
    shared: Arc<Shared>,
    gauges: Vec<Gauge>,
    outputs: Option<Outputs>,
    map_file: Option<MapFile>,
    recorder: Option<Sender<Record>>,
    recording: Arc<Mutex<RecorderReport>>,
    manager: Manager,
    status: Status,
    phase: Phase,
    failure: Option<Failure>,
    latest: Option<(Arc<Snapshot>, MapperReport)>,
    started: Instant,
    wall_minus_monotonic_ns: i64,
    duration: Option<Duration>,
    running: Vec<&'static str>,
    output_failed: bool,
}

/// Runs until the end of the duration, of the drive, or a signal. Files are in place when it returns.
pub fn run(mut run: Run) -> Result<(), Failure> {
    // First of all, so that a signal during the start ends in order as well.
    let signals = listen_for_signals().map_err(|error| Failure::new(Exit::Io, error))?;
    let parts = Parts::build(&run)?;
    let (mut supervisor, ended, from_mapper) = parts.start(&mut run)?;
    supervisor.manager.ready();
    supervisor.watch(&signals, &ended, &from_mapper, &mut run.is_over);
    supervisor.finish()
}

/// All that can fail is made before the first thread starts.
struct Parts {
    config: Config,
    session: scip::Session,
    pose_socket: Option<PoseSocket>,
    outputs: Option<Outputs>,
    mapper: Mapper,
    map_file: Option<MapFile>,
    recorder: Option<Recorder>,
    clocks: crate::pose_input::Clocks,
}

impl Parts {
    fn build(run: &Run) -> Result<Self, Failure> {
        let config = run.config.clone();
        let io = |error| Failure::new(Exit::Io, error);
        let clocks = clock::both();
        let session = scip::Session::new(run.session.clone(), clocks.monotonic_ns)
            .map_err(|error| Failure::new(Exit::Config, anyhow!(error)))?;
        let pose_socket = PoseSocket::open(&config.pose.source).map_err(io)?;
        let outputs = config.output.folder.as_deref().map(Outputs::create).transpose().map_err(io)?;
        let Begun { mapper, map_file, with } = Begun::of(&config)?;
        let recorder = config
            .record
            .enabled
            .then(|| create_recorder(&config, &run.session, clocks, with))
            .transpose()
            .map_err(io)?;
        Ok(Self { config, session, pose_socket, outputs, mapper, map_file, recorder, clocks })
    }

    fn start(self, run: &mut Run) -> Result<(Supervisor, Receiver<Ended>, Receiver<FromMapper>), Failure> {
        let shared = Arc::new(Shared::default());
        let (to_mapper, mapper_inbox, mapper_gauge) = queue(&TO_MAPPER);
        let (to_main, from_mapper, main_gauge) = queue(&TO_MAIN);
        let (to_recorder, recorder_inbox, recorder_gauge) = queue(&TO_RECORDER);
        let recording = Arc::new(Mutex::new(RecorderReport::default()));
        let (end_sender, ended) = unbounded();
        let mut gauges = vec![mapper_gauge, main_gauge];
        let mut running = Vec::new();
        let mut start = |name: &'static str, body: Box<dyn FnOnce() + Send>| -> Result<(), Failure> {
            let reporter = EndReporter { name, ended: end_sender.clone() };
            let body = move || {
                let _reporter = reporter;
                body();
            };
            thread::Builder::new()
                .name(name.into())
                .spawn(body)
                .with_context(|| format!("cannot start the thread {name}"))
                .map_err(|error| Failure::new(Exit::Io, error))?;
            running.push(name);
            Ok(())
        };

        // Downstream first: a thread never sends to one that is not there.
        let recorder = match self.recorder {
            Some(recorder) => {
                gauges.push(recorder_gauge);
                let report = Arc::clone(&recording);
                start("recorder", Box::new(move || recording::run(recorder, &recorder_inbox, &report)))?;
                Some(to_recorder)
            }
            None => None,
        };
        let tasks = if self.mapper.closes_loops() {
            // One is away at a time.
            let ((to_do, todo), (done_to, done)) = (bounded(1), bounded(1));
            start("loops", Box::new(move || mapping::do_tasks(&todo, &done_to)))?;
            Some(Tasks { to_do, done, is_away: false })
        } else {
            None
        };
        let mapping = Mapping {
            mapper: self.mapper,
            tasks,
            main: to_main,
            recorder: recorder.clone(),
            map_every: Duration::from_secs_f64(self.config.output.every_s),
            save_every: self.map_file.is_some().then(|| Duration::from_secs_f64(self.config.map.every_s)),
            shared: Arc::clone(&shared),
        };
        start("mapper", Box::new(move || mapping.run(&mapper_inbox)))?;
        if let Some(socket) = self.pose_socket {
            let reader = PoseReader::new(&self.config.pose);
            let (mapper, shared) = (to_mapper.clone(), Arc::clone(&shared));
            start("poses", Box::new(move || poses::run(&socket, reader, &mapper, &shared)))?;
        }
        let driver = Driver {
            session: self.session,
            opener: std::mem::replace(&mut run.opener, Box::new(|| Err(std::io::ErrorKind::NotFound.into()))),
            url: self.config.device.url.as_ref().map(ToString::to_string).unwrap_or_default(),
            mapper: to_mapper,
            recorder: recorder.clone(),
            shared: Arc::clone(&shared),
            recorded_device: None,
        };
        start("driver", Box::new(move || driver.run()))?;

        let supervisor = Supervisor {
            config: self.config,
            config_file: run.config_file.clone(),
            shared,
            gauges,
            outputs: self.outputs,
            map_file: self.map_file,
            recorder,
            recording,
            manager: Manager::find(),
            status: Status::new(),
            phase: Phase::Running,
            failure: None,
            latest: None,
            started: Instant::now(),
            wall_minus_monotonic_ns: self.clocks.realtime_ns - self.clocks.monotonic_ns,
            duration: run.duration,
            running,
            output_failed: false,
        };
        Ok((supervisor, ended, from_mapper))
    }
}

/// A mapper, in the map that an earlier run has left where there is one.
struct Begun {
    mapper: Mapper,
    /// Where the map is kept.
    map_file: Option<MapFile>,
    /// The map that it begins with, as it was read.
    with: Option<Vec<u8>>,
}

impl Begun {
    fn of(config: &Config) -> Result<Self, Failure> {
        let empty = |map_file| Self { mapper: Mapper::new(config.mapper.clone()), map_file, with: None };
        let Some(path) = &config.map.file else { return Ok(empty(None)) };
        let refused = |error: LoadError| {
            let exit = if matches!(error, LoadError::Io { .. }) { Exit::Io } else { Exit::Config };
            Failure::new(exit, error)
        };
        let (file, loaded) = MapFile::open(path, config.map.fresh, &config.mapper).map_err(refused)?;
        let Some(Loaded { map, bytes }) = loaded else {
            info!("an empty map begins; it will be kept in {}", path.display());
            return Ok(empty(Some(file)));
        };
        let mapper = Mapper::going_on(&map, config.mapper.clone())
            .with_context(|| format!("the map {}", path.display()))
            .map_err(|error| Failure::new(Exit::Config, error))?;
        info!("the map {} of {} scans goes on", path.display(), map.scans);
        if config.mapper.poses == PoseUse::Odometry {
            info!("nothing is mapped until the scanner's place in it has been found");
        }
        if config.mapper.closes_loops() {
            info!("loops are not closed: the scans that made it are not there to be put elsewhere");
        }
        Ok(Self { mapper, map_file: Some(file), with: Some(bytes) })
    }
}

fn create_recorder(
    config: &Config,
    session: &scip::SessionSettings,
    clocks: crate::pose_input::Clocks,
    begun_with: Option<Vec<u8>>,
) -> Result<Recorder> {
    let folder = &config.record.folder;
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let mut attachments = vec![crate::record::Attachment {
        name: "visagged.toml".into(),
        media_type: "application/toml".into(),
        data: toml::to_string(config)?.into_bytes(),
    }];
    let closes_loops = config.mapper.closes_loops() && begun_with.is_none();
    // A replay begins with it as well.
    attachments.extend(begun_with.map(|data| crate::record::Attachment {
        name: crate::record::BEGUN_WITH.into(),
        media_type: "application/octet-stream".into(),
        data,
    }));
    let settings = RecorderSettings {
        rotate_bytes: config.record.rotate_bytes,
        rotate_ns: (config.record.rotate_s * 1e9) as i64,
        mount: config.mapper.mount.pose(),
        session: crate::record::SessionInfo {
            software: concat!("visagged ", env!("CARGO_PKG_VERSION")).into(),
            mapper: serde_json::to_value(&config.mapper)?,
            closes_loops,
            stamps_at_rear: session.monitor.stamp_reference == scip::StampReference::Rear,
            pose_source: config.pose.source.to_string(),
        },
        attachments,
        ..RecorderSettings::new(folder)
    };
    Recorder::create(settings, clocks.realtime_ns, clocks.monotonic_ns)
        .with_context(|| format!("cannot record into {}", folder.display()))
}

/// SIGINT and SIGTERM end the run in order, a second one at once; SIGHUP checks the configuration.
fn listen_for_signals() -> Result<Receiver<i32>> {
    use signal_hook::flag;
    use std::sync::atomic::AtomicBool;
    let is_second = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        // In this order: the first signal finds the flag down and raises it.
        flag::register_conditional_shutdown(signal, 128 + signal, Arc::clone(&is_second))?;
        flag::register(signal, Arc::clone(&is_second))?;
    }
    let mut signals = signal_hook::iterator::Signals::new([SIGHUP, SIGINT, SIGTERM])?;
    let (sender, receiver) = unbounded();
    thread::Builder::new().name("signals".into()).spawn(move || {
        for signal in signals.forever() {
            if sender.send(signal).is_err() {
                return;
            }
        }
    })?;
    Ok(receiver)
}

impl Supervisor {
    /// Looks after the threads until all have ended.
    fn watch(
        &mut self,
        signals: &Receiver<i32>,
        ended: &Receiver<Ended>,
        from_mapper: &Receiver<FromMapper>,
        is_over: &mut dyn FnMut() -> bool,
    ) {
        let mut next_tick = Instant::now();
        let ticker = crossbeam_channel::tick(TICK);
        let mut news_of_mapper = from_mapper.clone();
        while !self.running.is_empty() {
            crossbeam_channel::select! {
                recv(news_of_mapper) -> news => match news {
                    Ok(news) => self.on_news(news),
                    // The mapper's end is told by `ended`; a closed channel would keep this loop spinning.
                    Err(_) => news_of_mapper = crossbeam_channel::never(),
                },
                recv(ended) -> end => if let Ok(end) = end { self.on_end(&end) },
                recv(signals) -> signal => if let Ok(signal) = signal { self.on_signal(signal) },
                recv(ticker) -> _ => {}
            }
            if Instant::now() >= next_tick {
                next_tick = Instant::now() + TICK;
                self.on_tick(is_over);
            }
            if let Phase::Stopping(deadline) = self.phase
                && Instant::now() > deadline
            {
                self.fail(Exit::Fault, anyhow!("{} did not end in time", self.running.join(", ")));
                return;
            }
        }
        // What the mapper said last may still be in the queue.
        while let Ok(news) = from_mapper.try_recv() {
            self.on_news(news);
        }
    }

    fn on_news(&mut self, news: FromMapper) {
        match news {
            FromMapper::Inserted { stamp_ns, pose } => {
                let time_ns = stamp_ns + self.wall_minus_monotonic_ns;
                if let Some(outputs) = &mut self.outputs
                    && !self.output_failed
                    && let Err(error) = outputs.add_pose(time_ns, &pose)
                {
                    self.output_failed = true;
                    self.fail(Exit::Io, error);
                }
            }
            FromMapper::Moved(moved) => {
                let moved = moved.shifted(self.wall_minus_monotonic_ns);
                if let Some(outputs) = &mut self.outputs
                    && !self.output_failed
                    && let Err(error) = outputs.move_poses(&moved)
                {
                    self.output_failed = true;
                    self.fail(Exit::Io, error);
                }
            }
            FromMapper::Saved(map) => self.save_map(&map),
            FromMapper::Map(map, report) => {
                let is_last = self.phase != Phase::Running;
                self.latest = Some((map, *report));
                // The last map is written when the recorder has ended too, with the final counts.
                if !is_last {
                    self.write_outputs(false);
                }
            }
        }
    }

    fn on_end(&mut self, end: &Ended) {
        self.running.retain(|name| *name != end.name);
        if end.panicked {
            // The cause, even where a thread that it fed has ended before this one could tell.
            self.failure = self.failure.take().filter(|earlier| earlier.exit == Exit::Fault);
            self.fail(Exit::Fault, anyhow!("the thread {} failed; its message is above", end.name));
        } else if self.phase == Phase::Running {
            self.fail(Exit::Io, anyhow!("the thread {} has ended by itself", end.name));
        }
        self.stop("a thread has ended");
        match end.name {
            // No scans come any more; the poses that came are enough.
            "driver" => self.shared.stop_poses.store(true, Relaxed),
            "mapper" => {
                // Main's is the last end of the recorder's queue.
                self.recorder = None;
                // What is still being done about loops came too late.
                self.running.retain(|name| *name != "loops");
            }
            _ => {}
        }
    }

    fn on_signal(&mut self, signal: i32) {
        match signal {
            SIGHUP => self.on_reload(),
            _ => self.stop(if signal == SIGINT { "interrupted" } else { "asked to end" }),
        }
    }

    /// A running map cannot change its settings; but a mistake is better found now than at the next start.
    fn on_reload(&mut self) {
        self.manager.reloading();
        match self.config_file.as_deref().map(Config::load) {
            None => info!("SIGHUP: there is no configuration file to read again"),
            Some(Err(error)) => {
                error!("SIGHUP: the configuration would be refused, all stays as it is: {error}")
            }
            Some(Ok(config)) if config == self.config => info!("SIGHUP: the configuration is in force"),
            Some(Ok(config)) => warn!(
                "SIGHUP: the configuration is valid; what it changes in {} takes effect with the next start",
                changed_parts(&self.config, &config).join(", ")
            ),
        }
        self.manager.ready();
    }

    fn on_tick(&mut self, is_over: &mut dyn FnMut() -> bool) {
        let elapsed = self.started.elapsed();
        if self.phase == Phase::Running {
            if self.duration.is_some_and(|duration| elapsed >= duration) {
                self.stop("the time is over");
            } else if is_over() {
                self.stop("the drive has ended");
            } else if !self.shared.was_open.load(Relaxed) && self.waited_long_enough(elapsed) {
                self.fail(Exit::NoDevice, anyhow!("no scanner in {:.0} s", elapsed.as_secs_f64()));
                self.stop("there is no scanner");
            }
        }
        self.status.on_tick(&self.shared, elapsed);
        if self.status.is_second() {
            self.manager.status(self.status.text());
            if let Some(recorder) = &self.recorder {
                recorder.offer(Record::Diagnostics(self.diagnostics()));
            }
        }
        if self.status.both_made_progress(&self.shared, self.manager.watchdog()) {
            self.manager.feed_watchdog();
        }
    }

    fn waited_long_enough(&self, elapsed: Duration) -> bool {
        let wait_s = self.config.device.wait_s;
        wait_s > 0.0 && elapsed.as_secs_f64() >= wait_s
    }

    /// Sets the end in order off, once.
    fn stop(&mut self, why: &str) {
        if self.phase != Phase::Running {
            return;
        }
        info!("{why}: ending");
        self.phase = Phase::Stopping(Instant::now() + PATIENCE_AT_END);
        self.manager.stopping();
        self.shared.stop_driver.store(true, Relaxed);
        if !self.running.contains(&"driver") {
            self.shared.stop_poses.store(true, Relaxed);
        }
    }

    /// Keeps the first failure, which is the cause of the others.
    fn fail(&mut self, exit: Exit, error: anyhow::Error) {
        error!("{error:#}");
        self.failure.get_or_insert(Failure::new(exit, error));
    }

    fn diagnostics(&self) -> Vec<crate::cdr::DiagnosticStatus> {
        let mut values = vec![
            ("scans".into(), self.shared.scans.load(Relaxed).to_string()),
            ("poses".into(), lock(&self.shared.poses).accepted.to_string()),
        ];
        let mut dropped = 0;
        for gauge in &self.gauges {
            let report = gauge.read();
            dropped += report.dropped;
            values.push((format!("{}.dropped", gauge.name()), report.dropped.to_string()));
        }
        let is_open = self.shared.is_open.load(Relaxed);
        let state =
            lock(&self.shared.mapper).as_ref().and_then(|report| Some(report.localization.as_ref()?.state));
        if let Some(state) = state {
            values.push(("localization".into(), format!("{state:?}").to_lowercase()));
        }
        let is_unsure = matches!(state, Some(Tracking::Degraded | Tracking::Lost));
        vec![crate::cdr::DiagnosticStatus {
            level: if !is_open { 2 } else { u8::from(dropped > 0 || is_unsure) },
            name: "visagged".into(),
            message: self.status.text().into(),
            hardware_id: lock(&self.shared.device)
                .as_ref()
                .and_then(|device| device.serial_number().map(ToOwned::to_owned))
                .unwrap_or_default(),
            values,
        }]
    }

    fn report(&self, map: &Map, mapper: &MapperReport, finished: bool) -> Report {
        let started_ns = clock::both().realtime_ns - self.started.elapsed().as_nanos() as i64;
        Report {
            versions: Versions::default(),
            mode: Mode::Live,
            finished,
            inputs: self.config.device.url.iter().map(ToString::to_string).collect(),
            started_s: started_ns as f64 / 1e9,
            elapsed_s: self.started.elapsed().as_secs_f64(),
            device: lock(&self.shared.device).as_deref().map(device_fields).unwrap_or_default(),
            mapper: mapper.clone(),
            poses: lock(&self.shared.poses).clone(),
            queues: self.gauges.iter().map(|gauge| (gauge.name(), gauge.read())).collect(),
            decode_errors: lock(&self.shared.decode_errors).clone(),
            input: None,
            recording: self.config.record.enabled.then(|| lock(&self.recording).clone()),
            map: MapSummary::of(map),
            settings: serde_json::to_value(&self.config).unwrap_or_default(),
        }
    }

    fn save_map(&mut self, map: &SavedMap) {
        let Some(file) = &mut self.map_file else { return };
        let is_last = self.phase != Phase::Running;
        match file.save(map) {
            Ok(()) if is_last => info!("kept for the next run: {}", file.path().display()),
            Ok(()) => {}
            Err(error) => {
                let error = anyhow!("the map cannot be saved as {}: {error}", file.path().display());
                error!("{error}");
                // The next time there may be room again; only the last one decides.
                if is_last {
                    self.failure.get_or_insert(Failure::new(Exit::Io, error));
                }
            }
        }
    }

    fn write_outputs(&mut self, finished: bool) {
        let Some((map, mapper)) = self.latest.clone() else { return };
        let report = self.report(map.map(), &mapper, finished);
        let Some(outputs) = &mut self.outputs else { return };
        if let Err(error) = outputs.write(map.map(), &report) {
            // The next set may find room again; only the last one decides.
            error!("{error:#}");
            if finished {
                self.failure.get_or_insert(Failure::new(Exit::Io, error));
            }
        }
    }

    /// The last files, and how the run is to be judged.
    fn finish(mut self) -> Result<(), Failure> {
        self.status.clear();
        self.write_outputs(true);
        if let Some((map, mapper)) = &self.latest {
            self.status.summary(
                map.map(),
                mapper,
                self.outputs.as_ref().map(Outputs::folder),
                &lock(&self.recording).files,
            );
        }
        if let Some(failure) = self.failure {
            return Err(failure);
        }
        if !self.shared.was_open.load(Relaxed) && self.duration.is_some() {
            return Err(Failure::new(Exit::NoDevice, anyhow!("there was no scanner the whole time")));
        }
        let recording = lock(&self.recording);
        if recording.errors > 0 {
            let error = anyhow!("the recording is not complete: {} errors, see above", recording.errors);
            return Err(Failure::new(Exit::Io, error));
        }
        Ok(())
    }
}

/// VV, PP and II by the protocol's names.
fn device_fields(device: &scip::Device) -> BTreeMap<String, String> {
    [&device.version, &device.parameter_fields, &device.state]
        .into_iter()
        .flatten()
        .flat_map(|fields| fields.iter())
        .map(|(key, value)| (key.to_owned(), value.to_owned()))
        .collect()
}

fn changed_parts(old: &Config, new: &Config) -> Vec<&'static str> {
    [
        ("[device]", old.device != new.device),
        ("[pose]", old.pose != new.pose),
        ("[mapper]", old.mapper != new.mapper),
        ("[record]", old.record != new.record),
        ("[output]", old.output != new.output),
        ("[map]", old.map != new.map),
    ]
    .into_iter()
    .filter_map(|(part, has_changed)| has_changed.then_some(part))
    .collect()
}
