//! The program: reads the command line and the configuration, and carries out what they say.

use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, anyhow};
use clap::Parser;
use log::{info, warn};
use visagged::cli::{Cli, Command, ReplayArgs, RunArgs, WHAT_IS_NEEDED};
use visagged::config::{Config, DeviceUrl, PoseSource};
use visagged::exit::{Exit, Failure};
use visagged::live::{self, device, simulator::Simulator};
use visagged::mapper::Outcome;
use visagged::output::Outputs;
use visagged::recover;
use visagged::replay::{self, ReplayError, ReplayOptions};
use visagged::report::Report;
use visagged::saved::LoadError;
use visagged::{input::InputError, logging};

fn main() -> ExitCode {
    let cli = Cli::parse();
    logging::init();
    let result = match &cli.command {
        None => run(&cli.run),
        Some(Command::Replay(args)) => replay_files(args),
        Some(Command::Recover { file }) => Ok(recover_file(file)),
        Some(Command::CheckConfig { file }) => check_config(file),
        Some(Command::Identify { device: Some(device) }) => identify(device),
        Some(Command::Identify { device: None }) => list_ports(),
    };
    match result {
        Ok(code) => code,
        Err(failure) => {
            // Not by the log: it may be set to be silent.
            eprintln!("visagged: {failure}");
            ExitCode::from(failure.exit as u8)
        }
    }
}

fn load(file: Option<&Path>) -> Result<Config, Failure> {
    match file {
        Some(file) => Config::load(file).map_err(|error| Failure::new(Exit::Config, error)),
        None => Ok(Config::default()),
    }
}

fn check_config(file: &Path) -> Result<ExitCode, Failure> {
    load(Some(file))?;
    println!("{}: accepted", file.display());
    Ok(ExitCode::SUCCESS)
}

fn run(args: &RunArgs) -> Result<ExitCode, Failure> {
    if args.is_empty() {
        return Err(Failure::new(Exit::Usage, anyhow!(WHAT_IS_NEEDED)));
    }
    let mut config = load(args.config.as_deref())?;
    args.override_config(&mut config);
    // Once more: the command line may ask for what does not go together.
    config.check().map_err(|error| Failure::new(Exit::Config, error))?;
    let Some(url) = config.device.url.clone() else {
        return Err(match args.config {
            Some(_) => {
                Failure::new(Exit::Config, anyhow!("device.url is not set; set it, or give --device URL"))
            }
            None => Failure::new(Exit::Usage, anyhow!("which scanner? Give --device URL, or --config FILE")),
        });
    };
    if config.output.folder.is_none() && !config.record.enabled && config.map.file.is_none() {
        warn!("neither a map nor a recording will be kept; --out DIR and --record do that");
    }
    let session = device::session_settings(&config.device, &url);

    // Lives until the run has ended.
    let simulator = match &url {
        DeviceUrl::Sim(world) => {
            let sends_poses = args.pose.as_ref().is_none_or(|pose| *pose.socket() != PoseSource::None);
            Some(Simulator::start(world, &mut config, sends_poses)?)
        }
        _ => None,
    };
    config.mapper.poses = config.pose.source.pose_use();
    config.mapper.fallback = config.pose.fallback;
    if *config.pose.source.socket() == PoseSource::None {
        // None will come.
        config.mapper.pose_wait = 0.0;
    }
    if config.pose.source == PoseSource::None {
        warn!("no scan will be mapped without poses; --pose SRC says where they come from");
    }
    let address = match (&url, &simulator) {
        (DeviceUrl::Port(address), _) => address.clone(),
        (DeviceUrl::Sim(_), Some(simulator)) => simulator.address(),
        (DeviceUrl::Sim(_), None) => unreachable!("it was started above"),
    };
    if config.record.enabled {
        recover_left_overs(&config.record.folder);
    }
    let result = live::run(live::Run {
        config,
        config_file: args.config.clone(),
        duration: args.duration.map(Duration::from_secs_f64),
        opener: device::opener(address),
        session,
        is_over: Box::new(move || simulator.as_ref().is_some_and(Simulator::is_over)),
    });
    result.map(|()| ExitCode::SUCCESS)
}

/// Completes what an earlier run that was killed has left, so that nobody needs to know of it.
fn recover_left_overs(folder: &Path) {
    if !folder.is_dir() {
        return;
    }
    match recover::recover_left_over(folder) {
        Ok(rescued) => {
            for (file, result) in rescued {
                match result {
                    Ok(recovery) => info!(
                        "{} was left by an earlier run: now {}",
                        file.display(),
                        recovery.output.display()
                    ),
                    Err(error) => warn!(
                        "{} was left by an earlier run and cannot be completed: {error}",
                        file.display()
                    ),
                }
            }
        }
        Err(error) => {
            warn!("{} cannot be searched for recordings of earlier runs: {error}", folder.display())
        }
    }
}

/// Has exit codes of its own: 0 lossless, 3 with loss, 1 failed, as MCAP's own tool has them.
fn recover_file(file: &Path) -> ExitCode {
    match recover::recover(file) {
        Ok(recovery) => {
            println!("{}: {} messages", recovery.output.display(), recovery.messages);
            if let Some(damage) = &recovery.damage {
                println!("not readable from byte {}: {}", damage.offset, damage.what);
            }
            ExitCode::from(recovery.exit_code())
        }
        Err(error) => {
            eprintln!("visagged: {error}");
            ExitCode::from(1)
        }
    }
}

fn list_ports() -> Result<ExitCode, Failure> {
    let ports = scip::transport::list_ports().map_err(|error| Failure::new(Exit::Io, error))?;
    for port in &ports {
        println!("{}{}", port.path, if port.is_hokuyo { "  a Hokuyo scanner" } else { "" });
    }
    if ports.is_empty() {
        println!(
            "no serial ports; a scanner on Ethernet is asked by `visagged identify tcp://192.168.0.10:10940`"
        );
    }
    Ok(ExitCode::SUCCESS)
}

fn identify(url: &DeviceUrl) -> Result<ExitCode, Failure> {
    let no_device = |error| Failure::new(Exit::NoDevice, error);
    let device = match url {
        DeviceUrl::Port(address) => device::identify(address).map_err(no_device)?,
        DeviceUrl::Sim(world) => {
            let simulator = Simulator::start(world, &mut Config::default(), false)?;
            device::identify(&simulator.address()).map_err(no_device)?
        }
    };
    for fields in [&device.version, &device.parameter_fields, &device.state].into_iter().flatten() {
        for (key, value) in fields.iter() {
            println!("{key}:{value}");
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn replay_files(args: &ReplayArgs) -> Result<ExitCode, Failure> {
    let io = |error: anyhow::Error| Failure::new(Exit::Io, error);
    let started = std::time::Instant::now();
    let started_s =
        std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default().as_secs_f64();
    let options = ReplayOptions {
        inputs: args.inputs.clone(),
        input: args.input_options(),
        mapper: args.config.as_deref().map(|file| load(Some(file))).transpose()?.map(|config| config.mapper),
        mapper_kind: args.mapper,
        ignore_beams: args.ignore_beams.clone(),
        map: args.map.clone(),
        fresh: args.fresh,
        optimize: args.optimize,
    };
    let mut outputs = Outputs::create(&args.out).map_err(io)?;
    let mut output_error = None;
    let bar = replay::progress_bar();
    let mut on_outcome = |outcome| {
        if output_error.is_some() {
            return;
        }
        output_error = match outcome {
            Outcome::Inserted { stamp_ns, start, .. } => outputs.add_pose(stamp_ns, &start).err(),
            Outcome::Moved(moved) => outputs.move_poses(&moved).err(),
            Outcome::Skipped { .. } => None,
        };
    };
    let result = replay::run(&options, &mut on_outcome, &mut |progress| replay::show(&bar, progress));
    bar.finish_and_clear();
    let mut replayed = result.map_err(replay_failure)?;
    if let Some(error) = output_error {
        return Err(io(error));
    }
    for note in &replayed.input.notes {
        info!("{note}");
    }
    for doubt in &replayed.input.doubts {
        warn!("{doubt}");
    }
    for damage in &replayed.input.damage {
        warn!("{}: not readable from byte {}: {}", damage.file.display(), damage.offset, damage.what);
    }
    let map = replayed.mapper.map();
    let mut mapper = replayed.mapper.report();
    mapper.localization = mapper.localization.or(replayed.localization.take());
    info!(
        "{} of {} scans are in the map, {:.0} us each; {:.1} s in all",
        mapper.scans_inserted,
        mapper.scans_read,
        mapper.insert_us.mean,
        started.elapsed().as_secs_f64()
    );
    for (reason, count) in &mapper.scans_skipped {
        info!("{count} scans are not: {reason:?}");
    }
    if let Some(closed) = mapper.loops.as_ref().and_then(|loops| loops.last) {
        info!("{closed}");
    }
    let report =
        Report::of_replay(&map, mapper, replayed.input, &replayed.settings, started_s, started.elapsed());
    outputs.write(&map, &report).map_err(io)?;
    if let Some(file) = &mut replayed.map_file {
        match replayed.mapper.save() {
            Some(saved) => file
                .save(&saved)
                .with_context(|| format!("the map cannot be saved as {}", file.path().display()))
                .map_err(io)?,
            None => warn!("{} is not written: only visagge and paper can be saved", file.path().display()),
        }
        info!("kept for the next run: {}", file.path().display());
    }
    if args.explain {
        outputs.write_explained(&map).map_err(io)?;
    }
    info!("the map: {}", args.out.join("map.png").display());
    Ok(ExitCode::SUCCESS)
}

/// What the user can change by other arguments is usage; what cannot be read is input and output.
fn replay_failure(error: ReplayError) -> Failure {
    let exit = match &error {
        ReplayError::Map(LoadError::Io { .. }) => Exit::Io,
        ReplayError::Settings(_) | ReplayError::Map(_) | ReplayError::GoingOn { .. } => Exit::Config,
        ReplayError::Input(InputError::Io { .. } | InputError::Line { .. }) => Exit::Io,
        ReplayError::Input(_) => Exit::Usage,
    };
    Failure::new(exit, error)
}
