//! What replaying a recording costs, end to end and by part.
//!
//! `cargo bench --bench replay` lets the daemon record a minute of the hall at poses that are given, and replays it; `-- WORLD` does that in
//! another world of the simulator, `-- FILE...` replays what is there. Of several rounds the fastest counts. The time is the CPU time of
//! all threads, so that the rate is what one core replays; beside it stands the rate by the clock on the wall.

use anyhow::{Context, Result, ensure};
use rustix::time::{ClockId, clock_gettime};
use std::{
    path::{Path, PathBuf},
    process::{Command, Stdio},
};
use visagged::{
    input::{self, InputOptions, InputReport, Sink},
    output::Outputs,
    pose::StampedPose,
    replay::{self, ReplayOptions},
    report::Report,
    scan::Scan,
};

const ROUNDS: usize = 5;

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let folder = tempfile::tempdir()?;
    let files: Vec<PathBuf> = match arguments.as_slice() {
        [] => vec![record("hall", folder.path())?],
        [world] if !Path::new(world).exists() => vec![record(world, folder.path())?],
        files => files.iter().map(PathBuf::from).collect(),
    };
    let rounds = (0..ROUNDS).map(|_| round(&files, folder.path())).collect::<Result<Vec<_>>>()?;
    let scans = rounds[0].scans;
    let a_scan = |of: fn(&Round) -> f64| 1e6 / scans as f64 * best(&rounds, of);
    println!("{scans} scans; us a scan, CPU time of all threads:");
    println!("{:8.1} reading: decompressed, decoded, brought into order", a_scan(|round| round.reading_s));
    println!("{:8.1} inserting them", a_scan(|round| round.inserting_s));
    println!("{:8.1} all until the mapper has them", a_scan(|round| round.replay.cpu_s));
    println!("{:8.0} scans/s on one core", 1e6 / a_scan(|round| round.replay.cpu_s));
    println!("{:8.0} scans/s by the clock on the wall", 1e6 / a_scan(|round| round.replay.wall_s));
    println!(
        "ms, once: {:.0} the map, {:.0} its files",
        1e3 * best(&rounds, |r| r.map_s),
        1e3 * best(&rounds, |r| r.files_s)
    );
    println!(
        "{:8.0} scans/s on one core with these",
        scans as f64 / best(&rounds, |r| r.replay.cpu_s + r.map_s + r.files_s)
    );
    Ok(())
}

/// Has the daemon record a minute of a simulated drive.
fn record(world: &str, folder: &Path) -> Result<PathBuf> {
    eprintln!("recording {world} for a minute ...");
    let (recordings, poses) = (folder.join("recordings"), folder.join("poses"));
    let done = Command::new(env!("CARGO_BIN_EXE_visagged"))
        .args(["--device", &format!("sim:{world}"), "--duration", "60"])
        .arg(format!("--record={}", recordings.display()))
        .arg(format!("--pose=unix:{}", poses.display()))
        .stderr(Stdio::null())
        .status()?;
    ensure!(done.success(), "the daemon could not record {world}: {done}");
    Ok(recordings)
}

/// What one replay took (s).
struct Round {
    scans: u64,
    reading_s: f64,
    inserting_s: f64,
    replay: Span,
    map_s: f64,
    files_s: f64,
}

fn round(files: &[PathBuf], folder: &Path) -> Result<Round> {
    let begun = Clocks::now();
    let mut report = InputReport::default();
    input::open(files, &InputOptions::default(), &mut report)?.feed(&mut Nothing, &mut report)?;
    let reading_s = begun.span().cpu_s;

    let begun = Clocks::now();
    let options = ReplayOptions { inputs: files.to_vec(), ..ReplayOptions::default() };
    let mut replay = replay::run(&options, &mut |_| {}, &mut |_| {})?;
    let span = begun.span();

    let begun = Clocks::now();
    let map = replay.mapper.map();
    let map_s = begun.span().cpu_s;

    let begun = Clocks::now();
    let mapper = replay.mapper.report();
    let (scans, inserting_s) =
        (mapper.scans_read, mapper.insert_us.mean * mapper.scans_inserted as f64 / 1e6);
    let report = Report::of_replay(&map, mapper, replay.input, &replay.settings, 0.0, Default::default());
    Outputs::create(&folder.join("out"))?.write(&map, &report).context("the map's files")?;
    let files_s = begun.span().cpu_s;
    Ok(Round { scans, reading_s, inserting_s, replay: span, map_s, files_s })
}

fn best(rounds: &[Round], of: fn(&Round) -> f64) -> f64 {
    rounds.iter().map(of).fold(f64::INFINITY, f64::min)
}

/// Takes what is read and does nothing with it.
struct Nothing;

impl Sink for Nothing {
    fn on_pose(&mut self, _: StampedPose) {}
    fn on_scan(&mut self, _: Scan) {}
    fn on_progress(&mut self, _: u64) {}
}

/// CPU time of the process and the clock on the wall (s).
struct Clocks([f64; 2]);

/// Time that went by, on both.
struct Span {
    cpu_s: f64,
    wall_s: f64,
}

impl Clocks {
    fn now() -> Clocks {
        Clocks([ClockId::ProcessCPUTime, ClockId::Monotonic].map(|clock| {
            let time = clock_gettime(clock);
            time.tv_sec as f64 + time.tv_nsec as f64 / 1e9
        }))
    }

    fn span(&self) -> Span {
        let Clocks([cpu_s, wall_s]) = Clocks::now();
        Span { cpu_s: cpu_s - self.0[0], wall_s: wall_s - self.0[1] }
    }
}
