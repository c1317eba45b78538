//! A live run from end to end: the program against a simulated scanner on a pty, as a service manager sees it and as a
//! user does. Nothing here waits for a time to pass, but for something to happen.

use std::fs;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use visagged::saved::SavedMap;

/// How long anything may take before a test gives up.
const PATIENCE: Duration = Duration::from_secs(60);

/// The program, killed where a test ends early.
struct Daemon(Child);

impl Daemon {
    fn start(folder: &Path, arguments: &[&str], notify: Option<&Path>) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_visagged"));
        command.args(arguments).current_dir(folder).env_remove("VISAGGED_LOG").stdin(Stdio::null());
        command.stderr(fs::File::create(folder.join("log")).unwrap());
        if let Some(notify) = notify {
            command.env("NOTIFY_SOCKET", notify).env("WATCHDOG_USEC", "2000000");
            command.env_remove("WATCHDOG_PID");
        }
        Self(command.spawn().unwrap())
    }

    fn signal(&self, name: &str) {
        let status =
            Command::new("kill").args([format!("-{name}"), self.0.id().to_string()]).status().unwrap();
        assert!(status.success());
    }

    fn wait(&mut self) -> ExitStatus {
        wait_for("the end of the program", || self.0.try_wait().unwrap())
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn wait_for<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(start.elapsed() < PATIENCE, "waited in vain for {what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn json(path: &Path) -> serde_json::Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

fn recordings(folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

fn recordings_if_any(folder: &Path) -> Vec<PathBuf> {
    if folder.is_dir() { recordings(folder) } else { Vec::new() }
}

/// Number of a report's scans, skipped ones included.
fn decided(report: &serde_json::Value) -> u64 {
    let skipped = report["scans_skipped"].as_object().unwrap().values().map(|count| count.as_u64().unwrap());
    report["scans_inserted"].as_u64().unwrap() + skipped.sum::<u64>()
}

#[test]
fn a_live_run_and_the_replay_of_its_recording_end_in_the_same_map() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let arguments = ["--device", "sim:hall", "--record=recordings", "--out", "live", "--duration", "10"];
    let status = Daemon::start(folder.path(), &arguments, None).wait();
    let log = fs::read_to_string(at("log")).unwrap();
    assert!(status.success(), "{log}");

    let report = json(&at("live/report.json"));
    let scans = report["scans_read"].as_u64().unwrap();
    // 400 in 10 s; the start of the scanner takes some of them where the machine is busy.
    assert!((100..=401).contains(&scans), "{scans} scans\n{log}");
    assert_eq!(decided(&report), scans);
    assert!(report["scans_inserted"].as_u64().unwrap() > 50, "{report:#}");
    assert!(report["map"]["occupied"].as_u64().unwrap() > 100, "{report:#}");
    assert!(report["poses"]["accepted"].as_u64().unwrap() > 100, "{report:#}");
    assert_eq!(report["device"]["PROT"], "SCIP 2.0");
    for (name, queue) in report["queues"].as_object().unwrap() {
        assert_eq!(queue["dropped"], 0, "{name}");
        assert!(queue["accepted"].as_u64().unwrap() > 0, "{name}");
    }
    assert_eq!(report["queues"].as_object().unwrap().len(), 3);

    let files = recordings(&at("recordings"));
    assert_eq!(files.len(), 1, "{files:?}");
    assert_eq!(files[0].extension().unwrap(), "mcap");
    for name in ["one", "two"] {
        let arguments = ["replay", files[0].to_str().unwrap(), "--out", name];
        assert!(Daemon::start(folder.path(), &arguments, None).wait().success());
        for file in ["map.npz", "map.pgm", "map.png", "map.yaml"] {
            let equal = fs::read(at("live").join(file)).unwrap() == fs::read(at(name).join(file)).unwrap();
            assert!(equal, "{name}/{file} differs from that of the live run");
        }
        let replayed = json(&at(name).join("report.json"));
        for key in ["scans_read", "scans_inserted", "scans_skipped", "poses_read"] {
            assert_eq!(replayed[key], report[key], "{key}");
        }
    }
}

#[test]
fn with_the_scanner_alone_the_replay_finds_the_same_poses() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let wheels = format!("match+unix:{}", at("wheels").display());
    for (name, device, pose) in
        [("alone", "sim:hall", "match"), ("guided", "sim:hall?poses=wheels", wheels.as_str())]
    {
        let recorded = format!("--record={name}-recordings");
        let arguments = ["--device", device, "--pose", pose, &recorded, "--out", name, "--duration", "5"];
        let status = Daemon::start(folder.path(), &arguments, None).wait();
        let log = fs::read_to_string(at("log")).unwrap();
        assert!(status.success(), "{log}");
        let report = json(&at(name).join("report.json"));
        assert!(report["scans_inserted"].as_u64().unwrap() > 50, "{report:#}");
        assert_eq!(report["localization"]["state"], "tracking", "{report:#}");
        assert_eq!(report["poses_read"].as_u64().unwrap() > 100, name == "guided", "{report:#}");
        // Odometry that cannot come is not waited for.
        assert_eq!(report["settings"]["mapper"]["pose_wait"] == 0.0, name == "alone");

        let files = recordings(&at(&format!("{name}-recordings")));
        let replayed = format!("{name}-replayed");
        let arguments = ["replay", files[0].to_str().unwrap(), "--out", &replayed];
        assert!(Daemon::start(folder.path(), &arguments, None).wait().success());
        let poses = |folder: &str| -> Vec<String> {
            let text = fs::read_to_string(at(folder).join("trajectory.tum")).unwrap();
            // The stamps of a live run are on the wall clock.
            let poses = text.lines().filter_map(|line| line.split_once(' ').map(|(_, pose)| pose.to_owned()));
            poses.collect()
        };
        assert_eq!(poses(name), poses(&replayed));
        let map = |folder: &str| fs::read(at(folder).join("map.npz")).unwrap();
        assert!(map(name) == map(&replayed));

        // There is no loop in it to be closed, and what is good is not touched.
        let optimized = format!("{name}-optimized");
        let arguments = ["replay", files[0].to_str().unwrap(), "--optimize", "--out", &optimized];
        assert!(Daemon::start(folder.path(), &arguments, None).wait().success());
        assert_eq!(poses(name), poses(&optimized));
        assert!(map(name) == map(&optimized));
        let again = json(&at(&optimized).join("report.json"));
        for key in ["scans_read", "scans_inserted", "scans_skipped", "scans_missing"] {
            assert_eq!(again[key], report[key], "{key}");
        }
        assert_eq!(again["localization"]["state"], "tracking", "{again:#}");
    }
}

#[test]
fn faults_on_the_wire_are_survived_counted_and_replayed_alike() {
    let folder = tempfile::tempdir().unwrap();
    let device = "sim:hall?fault-seed=3&disconnect=0.02&bad-sum=0.03&garbage=0.03&cut=0.02&skip-scan=0.02";
    let arguments = ["--device", device, "--record=recordings", "--out", "live"];
    let mut daemon = Daemon::start(folder.path(), &arguments, None);
    let log = || fs::read_to_string(folder.path().join("log")).unwrap();
    wait_for("a stream after two lost connections", || {
        let log = log();
        let streams = log.matches("streaming").count();
        (log.matches("is lost").count() >= 2 && streams >= 3).then_some(())
    });
    daemon.signal("TERM");
    assert!(daemon.wait().success(), "{}", log());

    let report = json(&folder.path().join("live/report.json"));
    assert!(report["scans_missing"].as_u64() > Some(0), "{report:#}");
    assert!(!report["decode_errors"].as_object().unwrap().is_empty(), "{report:#}");
    let files = recordings(&folder.path().join("recordings"));
    // One scanner is one entry, however often it was reconnected: readers refuse or warn about more of a name.
    let recorded = fs::read(&files[0]).unwrap();
    let is_device = |record: &mcap::records::Record| matches!(record, mcap::records::Record::Metadata(metadata) if metadata.name == "visagge.device");
    let entries = mcap::read::LinearReader::new(&recorded)
        .unwrap()
        .filter(|record| is_device(record.as_ref().unwrap()));
    assert_eq!(entries.count(), 1);
    let arguments = ["replay", files[0].to_str().unwrap(), "--out", "replayed"];
    assert!(Daemon::start(folder.path(), &arguments, None).wait().success());
    let replayed = json(&folder.path().join("replayed/report.json"));
    for key in ["scans_read", "scans_inserted", "scans_missing", "poses_read"] {
        assert_eq!(replayed[key], report[key], "{key}");
    }
    let map = |name: &str| fs::read(folder.path().join(name).join("map.npz")).unwrap();
    assert!(map("live") == map("replayed"));
}

#[test]
fn a_thread_that_fails_ends_the_run_in_order() {
    use visagged::config::{Config, OutputConfig, RecordConfig};
    let folder = tempfile::tempdir().unwrap();
    let config = Config {
        output: OutputConfig { folder: Some(folder.path().join("map")), ..OutputConfig::default() },
        record: RecordConfig {
            enabled: true,
            folder: folder.path().join("recordings"),
            ..RecordConfig::default()
        },
        ..Config::default()
    };
    let failure = visagged::live::run(visagged::live::Run {
        config,
        config_file: None,
        duration: None,
        opener: Box::new(|| panic!("the test wants it so")),
        session: scip::SessionSettings::default(),
        is_over: Box::new(|| false),
    })
    .expect_err("a failed thread is a failed run");
    assert_eq!(failure.exit, visagged::exit::Exit::Fault);
    assert!(failure.to_string().contains("driver"), "{failure}");
    assert_eq!(json(&folder.path().join("map/report.json"))["finished"], true);
    let files = recordings(&folder.path().join("recordings"));
    assert_eq!(files[0].extension().unwrap(), "mcap", "the recording is complete");
}

#[test]
fn a_service_manager_hears_of_start_progress_and_end() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notify");
    let manager = UnixDatagram::bind(&path).unwrap();
    manager.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut buffer = [0; 4096];
    let mut heard = move || {
        let length = manager.recv(&mut buffer).expect("the program says something");
        String::from_utf8(buffer[..length].to_vec()).unwrap()
    };
    let mut hear = |wanted: &str| {
        let start = Instant::now();
        while start.elapsed() < PATIENCE {
            let said = heard();
            if said.lines().any(|line| line.starts_with(wanted)) {
                return said;
            }
        }
        panic!("waited in vain for {wanted}");
    };

    fs::write(
        folder.path().join("visagged.toml"),
        "[device]\nurl = \"sim:hall\"\n[output]\nfolder = \"map\"\nevery_s = 1.0\n",
    )
    .unwrap();
    let mut daemon = Daemon::start(folder.path(), &["--config", "visagged.toml"], Some(&path));
    hear("READY=1");
    hear("WATCHDOG=1");
    wait_for("the first map, while the run goes on", || {
        let report = folder.path().join("map/report.json");
        report.exists().then(|| json(&report)).filter(|report| report["scans_inserted"].as_u64() > Some(0))
    });
    let status = hear("STATUS=");
    assert!(status.contains("scans"), "{status}");
    hear("WATCHDOG=1");

    // A mistake in the file does not reach the run.
    fs::write(folder.path().join("visagged.toml"), "[device]\nurl = 5\n").unwrap();
    daemon.signal("HUP");
    assert!(hear("RELOADING=1").contains("MONOTONIC_USEC="));
    hear("READY=1");

    daemon.signal("TERM");
    hear("STOPPING=1");
    let status = daemon.wait();
    let log = fs::read_to_string(folder.path().join("log")).unwrap();
    assert_eq!(status.code(), Some(0), "{log}");
    assert!(log.contains("would be refused"), "{log}");
    let report = json(&folder.path().join("map/report.json"));
    assert_eq!(report["finished"], true);
    assert_eq!(decided(&report), report["scans_read"].as_u64().unwrap());
}

#[test]
fn an_interrupt_ends_a_run_in_order() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["--device", "sim:hall", "--record", "--out", "map"];
    let mut daemon = Daemon::start(folder.path(), &arguments, None);
    wait_for("a stream", || {
        fs::read_to_string(folder.path().join("log")).unwrap().contains("streaming").then_some(())
    });
    daemon.signal("INT");
    let status = daemon.wait();
    let log = fs::read_to_string(folder.path().join("log")).unwrap();
    assert_eq!(status.code(), Some(0), "{log}");
    assert!(folder.path().join("map/map.png").exists());
    let files = recordings(&folder.path().join("recordings"));
    assert!(files.iter().all(|file| file.extension().unwrap() == "mcap"), "{files:?}");
    let bytes = fs::read(&files[0]).unwrap();
    assert!(bytes.ends_with(b"\x89MCAP0\r\n"), "the recording is complete");
    // The laser is told to go off; that is the last request.
    let raw = decompressed_sent_bytes(&files[0]);
    assert!(raw.ends_with(b"QT\n"), "{}", raw.escape_ascii());
}

/// All that was sent to the scanner, joined.
fn decompressed_sent_bytes(file: &Path) -> Vec<u8> {
    let mapped = fs::read(file).unwrap();
    let mut sent = Vec::new();
    for message in mcap::MessageStream::new(&mapped).unwrap() {
        let message = message.unwrap();
        if message.channel.topic != "/visagge/scip" {
            continue;
        }
        // CDR of ScipBytes: 4 bytes of header, stamp 8, monotonic 8, offset 8, direction 1, padding to 4, length 4.
        let data = &message.data[4..];
        if data[24] == 1 {
            let length = u32::from_le_bytes(data[28..32].try_into().unwrap()) as usize;
            sent.extend_from_slice(&data[32..32 + length]);
        }
    }
    sent
}

#[test]
fn a_recording_that_was_cut_is_completed_at_the_next_start() {
    let folder = tempfile::tempdir().unwrap();
    let recorded = folder.path().join("recordings");
    let mut daemon = Daemon::start(folder.path(), &["--device", "sim:hall", "--record"], None);
    wait_for("some content", || {
        let cut = recordings_if_any(&recorded).into_iter().next()?;
        (fs::metadata(cut).ok()?.len() > 100_000).then_some(())
    });
    daemon.signal("KILL");
    daemon.wait();
    let left = recordings(&recorded);
    assert!(left[0].extension().unwrap() == "active", "{left:?}");

    let status =
        Daemon::start(folder.path(), &["--device", "sim:hall", "--record", "--duration", "1"], None).wait();
    let log = fs::read_to_string(folder.path().join("log")).unwrap();
    assert!(status.success(), "{log}");
    assert!(log.contains("was left by an earlier run"), "{log}");
    let complete = |file: &PathBuf| fs::read(file).unwrap().ends_with(b"\x89MCAP0\r\n");
    let whole: Vec<_> =
        recordings(&recorded).into_iter().filter(|file| file.extension().unwrap() == "mcap").collect();
    assert_eq!(whole.len(), 2, "{:?}", recordings(&recorded));
    assert!(whole.iter().all(complete));
}

/// Places of a trajectory (m).
fn places(file: &Path) -> Vec<[f64; 2]> {
    let text = fs::read_to_string(file).unwrap_or_default();
    let numbers =
        |line: &str| -> Vec<f64> { line.split(' ').map(|number| number.parse().unwrap()).collect() };
    text.lines().map(numbers).map(|pose| [pose[1], pose[2]]).collect()
}

#[test]
fn who_is_killed_goes_on_in_the_same_map() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let settings = "[output]\nevery_s = 1.0\n[map]\nfile = \"kept.map\"\nevery_s = 1.0\n";
    fs::write(at("visagged.toml"), settings).unwrap();
    let kept = || SavedMap::decode(&fs::read(at("kept.map")).ok()?).ok();
    let arguments = ["--config", "visagged.toml", "--device", "sim:hall", "--pose", "match", "--record"];
    let first = Daemon::start(folder.path(), &[&arguments[..], &["--out", "first"]].concat(), None);
    let before = wait_for("a kept map", || kept().filter(|map| map.scans > 150));
    first.signal("KILL");
    drop(first);
    // What was saved last is whole, whenever the end came.
    let before = kept().filter(|map| map.scans >= before.scans).expect("a whole map");
    let driven = places(&at("first/trajectory.tum"));
    assert!(driven.len() > 50);

    let mut second = Daemon::start(
        folder.path(),
        &[
            "--config",
            "visagged.toml",
            "--device",
            "sim:hall",
            "--pose",
            "match",
            "--record=again",
            "--out",
            "second",
        ],
        None,
    );
    let log = || fs::read_to_string(at("log")).unwrap();
    wait_for("the place and more of the map", || {
        assert!(second.0.try_wait().unwrap().is_none(), "{}", log());
        kept().filter(|map| map.scans > before.scans + 100)
    });
    second.signal("TERM");
    assert!(second.wait().success(), "{}", log());
    assert!(log().contains("goes on"), "{}", log());
    let report = json(&at("second/report.json"));
    assert_eq!(report["scans_loaded"], before.scans, "{report:#}");
    assert_eq!(report["localization"]["found"], 1, "{report:#}");
    let inserted = report["scans_inserted"].as_u64().unwrap();
    assert_eq!(kept().unwrap().scans, before.scans + inserted);
    // The simulated robot begins where it began before, and drives the same way.
    let again = places(&at("second/trajectory.tum"));
    let near = |a: &[f64; 2], b: &[f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    for place in &again[..20] {
        let off = driven.iter().map(|other| near(place, other)).fold(f64::INFINITY, f64::min);
        assert!(off < 0.05, "{place:?} is {off} m beside the way of the first run");
    }
    // Walls that were seen twice are single: the second drive added little to the first one's.
    let solid = |map: &SavedMap| -> usize {
        map.grid
            .tiles
            .iter()
            .flat_map(|tile| tile.cells.iter().flatten())
            .filter(|cell| cell.hits > 20)
            .count()
    };
    let (cells, more) = (solid(&before), solid(&kept().unwrap()));
    assert!(more < cells * 3 / 2, "{cells} cells became {more}");

    // The recording holds the map that it went on in.
    let files = recordings(&at("again"));
    let replay = ["replay", files[0].to_str().unwrap(), "--out", "replayed"];
    assert!(Daemon::start(folder.path(), &replay, None).wait().success(), "{}", log());
    let map = |name: &str| fs::read(at(name).join("map.npz")).unwrap();
    assert!(map("second") == map("replayed"));
}

#[test]
fn a_map_that_cannot_be_gone_on_in_is_left_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("a.map"), b"VISAGGE\n\x01\0\0\0 and something").unwrap();
    let before = fs::read(at("a.map")).unwrap();
    let arguments = ["--device", "sim:hall", "--map", "a.map", "--duration", "1"];
    let status = Daemon::start(folder.path(), &arguments, None).wait();
    let log = || fs::read_to_string(at("log")).unwrap();
    assert_eq!(status.code(), Some(78), "{}", log());
    assert!(log().contains("a.map") && log().contains("--fresh"), "{}", log());
    assert_eq!(fs::read(at("a.map")).unwrap(), before);

    let arguments = ["--device", "sim:hall", "--map", "a.map", "--fresh", "--duration", "3"];
    assert!(Daemon::start(folder.path(), &arguments, None).wait().success(), "{}", log());
    assert_eq!(fs::read(at("a.map.former")).unwrap(), before);
    assert!(SavedMap::decode(&fs::read(at("a.map")).unwrap()).is_ok());
}

#[test]
fn a_run_ends_by_itself_when_the_drive_has_ended() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["--device", "sim:hall?speed=1000", "--out", "map"];
    let status = Daemon::start(folder.path(), &arguments, None).wait();
    let log = fs::read_to_string(folder.path().join("log")).unwrap();
    assert!(status.success(), "{log}");
    assert!(log.contains("the drive has ended"), "{log}");
}

#[test]
fn without_poses_nothing_is_mapped_and_all_is_counted() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["--device", "sim:hall", "--pose", "none", "--out", "map", "--duration", "3"];
    let status = Daemon::start(folder.path(), &arguments, None).wait();
    assert!(status.success());
    let report = json(&folder.path().join("map/report.json"));
    assert_eq!(report["scans_inserted"], 0);
    assert_eq!(report["map"]["occupied"], 0);
    assert!(report["scans_read"].as_u64().unwrap() > 0);
    assert_eq!(report["scans_skipped"]["no_pose"], report["scans_read"]);
}

#[test]
fn poses_of_a_localizer_are_taken_and_bad_ones_counted() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("pose");
    let pose = format!("unix:{}", socket.display());
    let arguments = ["--device", "sim:hall", "--pose", &pose, "--out", "map"];
    let mut daemon = Daemon::start(folder.path(), &arguments, None);
    wait_for("the socket", || socket.exists().then_some(()));
    let sender = UnixDatagram::unbound().unwrap();
    sender.send_to(b"{\"class\":\"POSE\",\"stamp_ns\":5,\"x\":0,\"y\":0,\"yaw\":0}", &socket).unwrap();
    sender.send_to(b"hello", &socket).unwrap();
    sender.send_to(b"{\"class\":\"POSE\",\"stamp_ns\":5,\"x\":NaN,\"y\":0,\"yaw\":0}", &socket).unwrap();
    let start = Instant::now();
    // Sent until the log says that they are used; the robot stands.
    while !fs::read_to_string(folder.path().join("log")).unwrap().contains("streaming")
        || start.elapsed() < Duration::from_secs(2)
    {
        assert!(start.elapsed() < PATIENCE, "no stream");
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_nanos();
        let text = format!("{{\"class\":\"POSE\",\"stamp_ns\":{now},\"x\":1.5,\"y\":0,\"yaw\":0.25}}");
        sender.send_to(text.as_bytes(), &socket).unwrap();
        std::thread::sleep(Duration::from_millis(10));
    }
    daemon.signal("TERM");
    assert!(daemon.wait().success());
    let report = json(&folder.path().join("map/report.json"));
    let rejected = &report["poses"]["rejected"];
    assert_eq!(
        (&rejected["stale"], &rejected["malformed"], &rejected["not_finite"]),
        (&1.into(), &1.into(), &1.into())
    );
    assert!(report["scans_inserted"].as_u64().unwrap() > 0, "{report:#}");
    assert!(!socket.exists(), "the socket's name is removed");
}
