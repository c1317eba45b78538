//! A run that is recorded, and the replay of its recording: the same calls of the mapper, the same map, bit by bit.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use visagged::closing::Task;
use visagged::input::{InputError, InputOptions, PoseSource};
use visagged::map::Map;
use visagged::mapper::{Mapper, MapperSettings, Outcome, PoseUse};
use visagged::pose::{Pose, StampedPose, pose, quaternion_from_yaw, yaw_from_quaternion};
use visagged::record::{Direction, Record, Recorder, RecorderReport, RecorderSettings, SessionInfo};
use visagged::replay::{self, ReplayError, ReplayOptions};
use visagged::scan::Scan;

const SECOND: i64 = 1_000_000_000;
const MS: i64 = 1_000_000;
const START: i64 = 1_000 * SECOND;
const WALL: i64 = 1_795_445_850 * SECOND;

/// Replies of a UTM-30LX, each with the time of its last byte.
struct Device {
    random: u64,
}

impl Device {
    fn random(&mut self, below: u64) -> u64 {
        self.random =
            self.random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.random >> 33) % below
    }

    fn line(out: &mut Vec<u8>, line: &[u8]) {
        out.extend_from_slice(line);
        out.push(scip::number::checksum(line));
        out.push(b'\n');
    }

    fn parameters() -> Vec<u8> {
        let mut out = b"PP\n00P\n".to_vec();
        for line in [
            "MODL:UTM-30LX",
            "DMIN:23",
            "DMAX:60000",
            "ARES:1440",
            "AMIN:0",
            "AMAX:1080",
            "AFRT:540",
            "SCAN:2400",
        ] {
            out.extend_from_slice(line.as_bytes());
            out.push(b';');
            out.push(scip::number::checksum(line.as_bytes()));
            out.push(b'\n');
        }
        out.push(b'\n');
        out
    }

    /// A scan in a room of 4 x 6 m with some codes among its distances.
    fn scan(&mut self, stamp_ms: u32) -> Vec<u8> {
        self.scan_of(stamp_ms, |bearing| (2.0 / bearing.cos().abs()).min(3.0 / bearing.sin().abs()))
    }

    /// A scan of walls that are so far (m) in a direction (rad), with some codes among its distances.
    fn scan_of(&mut self, stamp_ms: u32, wall: impl Fn(f64) -> f64) -> Vec<u8> {
        let mut out = b"ME0000108000000\n99b\n".to_vec();
        let mut stamp = Vec::new();
        scip::number::encode(stamp_ms & 0xff_ffff, 4, &mut stamp);
        Self::line(&mut out, &stamp);
        let mut data = Vec::with_capacity(6486);
        for step in 0..=1080 {
            let bearing = (f64::from(step) - 540.0) * std::f64::consts::TAU / 1440.0;
            let distance = match self.random(100) {
                0 => 1,
                1 => 5,
                noise => (wall(bearing) * 1000.0) as u32 + noise as u32 % 20,
            };
            scip::number::encode(distance, 3, &mut data);
            scip::number::encode(2000 + self.random(500) as u32, 3, &mut data);
        }
        for line in data.chunks(64) {
            Self::line(&mut out, line);
        }
        out.push(b'\n');
        out
    }
}

/// What happens in a run, in order: bytes that come and go, poses.
enum Happening {
    Sent(i64, Vec<u8>),
    Received(i64, Vec<u8>),
    Gap(i64),
    Pose(StampedPose),
}

/// What is said before the first scan.
fn opening() -> Vec<Happening> {
    vec![
        Happening::Sent(START, b"PP\n".to_vec()),
        Happening::Received(START + 2 * MS, Device::parameters()),
        Happening::Sent(START + 3 * MS, b"ME0000108000000\n".to_vec()),
        Happening::Received(START + 5 * MS, b"ME0000108000000\n00P\n\n".to_vec()),
    ]
}

/// `scans` scans in chunks as a port gives them, poses at 20 Hz with jitter and one jump, a cut reply, a reconnection.
fn happenings(scans: i64) -> Vec<Happening> {
    let mut device = Device { random: 7 };
    let mut all = opening();
    for number in 0..scans {
        // The device's clock began before, and wraps on the way.
        let stamp_ms = (1_u32 << 24) - 500 + 25 * number as u32;
        let mut bytes = device.scan(stamp_ms);
        let begin = START + 30 * MS + number * 25 * MS + device.random(2_000_000) as i64;
        if number == scans / 3 {
            bytes.truncate(3000);
        }
        for (part, chunk) in bytes.chunks(1 + device.random(4000) as usize).enumerate() {
            all.push(Happening::Received(begin + part as i64 * 100_000, chunk.to_vec()));
        }
        if number == scans / 2 {
            all.push(Happening::Gap(begin + 10 * MS));
            all.push(Happening::Sent(begin + 11 * MS, b"ME0000108000000\n".to_vec()));
            all.push(Happening::Received(begin + 12 * MS, b"ME0000108000000\n00P\n\n".to_vec()));
        }
        if number % 2 == 0 {
            let stamp_ns = begin - 3 * MS;
            let t = number as f64 * 0.025;
            let yaw = yaw_from_quaternion(quaternion_from_yaw((0.3 * t).sin()));
            all.push(Happening::Pose(StampedPose {
                stamp_ns,
                received_ns: begin + 20 * MS,
                pose: pose(0.2 * t.sin(), 0.1 * t, yaw),
                covariance: (number % 3 == 0).then_some([1e-4, 0.0, 0.1, 2e-4, 0.3, 1.0 / 3.0]),
                reset: u32::from(number > scans * 2 / 3),
            }));
        }
    }
    all
}

/// Rectangles by their lower left and upper right corners: a ring of corridors with things in it, none like another.
const RING: [[f64; 4]; 11] = [
    [0.0, 0.0, 16.0, 12.0],
    [2.2, 2.2, 13.8, 9.8],
    [3.0, 0.0, 3.5, 0.3],
    [8.0, 0.0, 9.2, 0.2],
    [13.0, 1.9, 13.3, 2.2],
    [15.6, 4.0, 16.0, 4.9],
    [13.8, 7.0, 14.1, 7.4],
    [11.0, 11.5, 11.7, 12.0],
    [5.5, 9.8, 5.9, 10.2],
    [0.0, 8.0, 0.3, 9.5],
    [1.9, 4.5, 2.2, 5.1],
];
/// Scans of a lap round it: ten a metre, and twenty while it turns.
const LAP: i64 = 520;

/// Where the robot is in the ring.
fn in_ring(number: i64) -> Pose {
    let (mut at, mut number) = (pose(1.5, 1.2, 0.0), number % LAP);
    for side in [130, 90, 130, 90] {
        at *= pose(number.min(side) as f64 * 0.1, 0.0, 0.0);
        number = (number - side).max(0);
        at *= pose(0.0, 0.0, number.min(20) as f64 / 20.0 * std::f64::consts::FRAC_PI_2);
        number = (number - 20).max(0);
    }
    at
}

/// Range in the ring, of a scanner that sees what is to its left too far and what is to its right too near.
fn bent_range(at: &Pose, bearing: f64) -> f64 {
    let from = at.translation.vector;
    let heading = at.rotation.angle() + bearing;
    let direction = nalgebra::Vector2::new(heading.cos(), heading.sin());
    let mut nearest = 60.0_f64;
    for [x0, y0, x1, y1] in RING {
        for (axis, wall, low, high) in [(0, x0, y0, y1), (0, x1, y0, y1), (1, y0, x0, x1), (1, y1, x0, x1)] {
            let range = (wall - from[axis]) / direction[axis];
            let along = from[1 - axis] + range * direction[1 - axis];
            if range > 0.0 && (low..=high).contains(&along) {
                nearest = nearest.min(range);
            }
        }
    }
    nearest * (1.0 + 0.04 * bearing.sin())
}

/// A drive round the ring and half of it again, with true odometry.
fn round_the_ring() -> Vec<Happening> {
    let mut device = Device { random: 7 };
    let mut all = opening();
    for number in 0..LAP * 3 / 2 {
        let at = in_ring(number);
        let bytes = device.scan_of(25 * number as u32, |bearing| bent_range(&at, bearing));
        let end = START + 30 * MS + number * 25 * MS;
        let odometry = |stamp_ns: i64| {
            let received_ns = stamp_ns;
            Happening::Pose(StampedPose { stamp_ns, received_ns, pose: at, covariance: None, reset: 0 })
        };
        all.push(odometry(end - 22 * MS));
        all.push(odometry(end - MS));
        all.push(Happening::Received(end, bytes));
    }
    all
}

/// The threads of a live run, one after the other: each reads the port, records, and maps.
struct Live {
    monitor: scip::Monitor,
    mapper: Mapper,
    recorder: Recorder,
    offsets: [u64; 2],
    scans: u32,
    outcomes: Vec<Outcome>,
    received: Vec<u8>,
    described: bool,
    /// What the mapper gives to the recorder, as late as it comes at all.
    held_back: Option<Vec<Record>>,
    /// What is being done about loops, and the number of scans after which it is done.
    task: Option<(Task, u32)>,
}

/// Scans that a task takes.
const TASK: u32 = 33;

impl Live {
    fn create(folder: &Path, rotate_ns: i64) -> Self {
        let mut settings = MapperSettings::default();
        settings.mount.x = 1.0 / 3.0;
        settings.mount.yaw = 0.1;
        Self::with(settings, folder, rotate_ns)
    }

    fn with(settings: MapperSettings, folder: &Path, rotate_ns: i64) -> Self {
        let recorder_settings = RecorderSettings {
            rotate_ns,
            mount: settings.mount.pose(),
            session: SessionInfo {
                software: "test".into(),
                mapper: serde_json::to_value(&settings).unwrap(),
                closes_loops: settings.closes_loops(),
                ..SessionInfo::default()
            },
            ..RecorderSettings::new(folder)
        };
        Self {
            monitor: scip::Monitor::new(scip::MonitorOptions::default()),
            mapper: Mapper::new(settings),
            recorder: Recorder::create(recorder_settings, WALL, START).unwrap(),
            offsets: [0; 2],
            scans: 0,
            outcomes: Vec::new(),
            received: Vec::new(),
            described: false,
            held_back: None,
            task: None,
        }
    }

    fn record(&mut self, record: Record) {
        match &mut self.held_back {
            Some(held_back) if !matches!(record, Record::Bytes { .. }) => held_back.push(record),
            _ => self.recorder.write(&record).unwrap(),
        }
    }

    fn record_bytes(&mut self, direction: Direction, monotonic_ns: i64, data: Vec<u8>) {
        let offset = self.offsets.get_mut(usize::from(direction.code()));
        let stream_offset = offset.map_or(0, |offset| {
            *offset += data.len() as u64;
            *offset - data.len() as u64
        });
        self.record(Record::Bytes { direction, monotonic_ns, stream_offset, data });
    }

    /// Takes a task back where it is time to, and the next one.
    fn do_tasks(&mut self) {
        if let Some((task, _)) = self.task.take_if(|(_, due)| *due <= self.scans) {
            self.take_back(task);
        }
        let next = || Some((self.mapper.next_task()?, self.scans + TASK));
        self.task = self.task.take().or_else(next);
    }

    fn take_back(&mut self, task: Task) {
        self.record(Record::TaskDone { scans_before: self.scans });
        self.mapper.take_back(task.run());
    }

    fn happen(&mut self, happening: Happening) {
        self.do_tasks();
        match happening {
            Happening::Sent(now, bytes) => {
                self.monitor.on_sent(now, &bytes);
                self.record_bytes(Direction::Sent, now, bytes);
            }
            Happening::Received(now, bytes) => {
                self.received.extend_from_slice(&bytes);
                self.monitor.on_received(now, &bytes);
                self.record_bytes(Direction::Received, now, bytes);
            }
            Happening::Gap(now) => {
                self.monitor.on_gap();
                self.record_bytes(Direction::Gap, now, Vec::new());
            }
            Happening::Pose(pose) => {
                self.record(Record::PoseReceived { pose, scans_before: self.scans });
                self.mapper.on_pose(pose);
            }
        }
        while let Some(event) = self.monitor.next_event() {
            if let scip::Event::Scan(scan) = event {
                let device = self.monitor.device();
                let scan = Scan::from_scip(&scan, device.parameters.as_ref().unwrap());
                if !self.described {
                    self.described = true;
                    let device = Arc::new(device.clone());
                    self.record(Record::Device(device));
                }
                self.record(Record::Scan(Arc::new(scan.clone())));
                self.mapper.on_scan(scan);
                self.scans += 1;
            }
        }
        self.do_tasks();
        self.take_outcomes();
    }

    fn take_outcomes(&mut self) {
        while let Some(outcome) = self.mapper.next_outcome() {
            if let Outcome::Inserted { stamp_ns, start, .. } = outcome {
                self.record(Record::PoseUsed { stamp_ns, pose: start });
            }
            self.outcomes.push(outcome);
        }
    }

    fn end(mut self) -> (Map, Vec<Outcome>, RecorderReport, Vec<u8>) {
        while let Some(task) = self
            .task
            .take()
            .map(|(task, _)| task)
            .or_else(|| self.mapper.next_task())
            .or_else(|| self.mapper.last_task())
        {
            self.take_back(task);
        }
        self.mapper.finish();
        self.take_outcomes();
        self.held_back.take().unwrap_or_default().into_iter().for_each(|record| self.record(record));
        let map = self.mapper.map();
        self.record(Record::Map(Arc::new(map.clone().into())));
        (map, self.outcomes, self.recorder.close().unwrap(), self.received)
    }
}

fn live(folder: &Path, scans: i64, rotate_ns: i64) -> (Map, Vec<Outcome>, RecorderReport, Vec<u8>) {
    let mut live = Live::create(folder, rotate_ns);
    for happening in happenings(scans) {
        live.happen(happening);
    }
    live.end()
}

fn replayed(files: &[PathBuf], pose: Option<PoseSource>) -> (Map, Vec<Outcome>, replay::Replay) {
    let options = ReplayOptions {
        inputs: files.to_vec(),
        input: InputOptions { pose, ..InputOptions::default() },
        ..ReplayOptions::default()
    };
    let mut outcomes = Vec::new();
    // A replay tells the time since 1970, the run its monotonic clock.
    let mut on_outcome = |outcome: Outcome| outcomes.push(outcome.shifted(START - WALL));
    let mut replay = replay::run(&options, &mut on_outcome, &mut |_| {}).unwrap();
    (replay.mapper.map(), outcomes, replay)
}

fn inserted(outcomes: &[Outcome]) -> usize {
    outcomes.iter().filter(|outcome| matches!(outcome, Outcome::Inserted { .. })).count()
}

#[test]
fn the_replay_is_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let (map, outcomes, report, received) = live(folder.path(), 400, i64::MAX);
    assert!(inserted(&outcomes) > 350, "{} of {}", inserted(&outcomes), outcomes.len());
    let (map_again, outcomes_again, replay) = replayed(&report.files, None);
    assert_eq!(outcomes_again, outcomes);
    assert!(map_again == map, "the maps differ");
    assert_eq!(replay.input.kind, "recording");
    assert_eq!(replay.input.poses, 200);
    assert!(replay.input.skipped_bytes >= 3000, "{:?}", replay.input);
    assert!((replay.settings.mount.x - 1.0 / 3.0).abs() < f64::EPSILON);
    // For tools/check-recording.py.
    if let Some(keep) = std::env::var_os("VISAGGED_KEEP_RECORDING") {
        std::fs::copy(&report.files[0], Path::new(&keep).join("recording.mcap")).unwrap();
        std::fs::write(Path::new(&keep).join("received.bin"), received).unwrap();
    }
}

#[test]
fn a_loop_is_closed_in_the_replay_where_it_was_in_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let mut settings = MapperSettings { poses: PoseUse::Odometry, ..MapperSettings::default() };
    settings.localize.submap_way = 5.0;
    let mut live = Live::with(settings, folder.path(), 5 * SECOND);
    round_the_ring().into_iter().for_each(|happening| live.happen(happening));
    let (map, outcomes, report, _) = live.end();
    assert!(report.files.len() >= 3, "{report:?}");
    let closings: Vec<usize> =
        (0..outcomes.len()).filter(|&number| matches!(outcomes[number], Outcome::Moved(_))).collect();
    assert!(closings.len() >= 2, "{closings:?}");
    assert!(closings[0] < outcomes.len() - 100, "while the drive goes on: {closings:?}");
    let (map_again, outcomes_again, replay) = replayed(&report.files, None);
    assert_eq!(outcomes_again.len(), outcomes.len());
    assert!(outcomes_again == outcomes, "the outcomes differ");
    assert!(map_again == map, "the maps differ");
    assert_eq!(replay.mapper.report().loops.unwrap().closed, closings.len() as u64);

    // With settings of its own a replay does all tasks at once.
    let options =
        ReplayOptions { inputs: report.files, mapper: Some(replay.settings), ..ReplayOptions::default() };
    let mut moved = Vec::new();
    let mut number = 0;
    let mut on_outcome = |outcome: Outcome| match outcome {
        Outcome::Moved(_) => moved.push(number),
        _ => number += 1,
    };
    replay::run(&options, &mut on_outcome, &mut |_| {}).unwrap();
    assert!(moved[0] < closings[0], "{moved:?}");
}

#[test]
fn poses_may_be_recorded_long_after_the_scans_that_need_them() {
    let folder = tempfile::tempdir().unwrap();
    let mut live = Live { held_back: Some(Vec::new()), ..Live::create(folder.path(), i64::MAX) };
    // As many as the mapper may be behind.
    happenings(480).into_iter().for_each(|happening| live.happen(happening));
    let (map, outcomes, report, _) = live.end();
    let (map_again, outcomes_again, _) = replayed(&report.files, None);
    assert_eq!(outcomes_again, outcomes);
    assert!(map_again == map, "the maps differ");
}

#[test]
fn rotated_files_are_one_run_in_any_order_and_each_can_be_read_alone() {
    let folder = tempfile::tempdir().unwrap();
    let (map, outcomes, report, _) = live(folder.path(), 400, 3 * SECOND);
    assert!(report.files.len() >= 3, "{report:?}");
    let mut files = report.files.clone();
    files.reverse();
    let (map_again, outcomes_again, replay) = replayed(&files, None);
    assert_eq!(replay.input.files, report.files);
    assert_eq!(outcomes_again, outcomes);
    assert!(map_again == map, "the maps differ");
    let (_, alone, replay) = replayed(&files[1..2], None);
    assert!(inserted(&alone) > 60, "{} of {}: {:?}", inserted(&alone), alone.len(), replay.input);
}

#[test]
fn behind_a_file_that_is_missing_poses_and_scans_are_together_again() {
    let folder = tempfile::tempdir().unwrap();
    let (_, outcomes, report, _) = live(folder.path(), 400, 3 * SECOND);
    let (first, second) = (&report.files[0], &report.files[2]);
    let (_, some, replay) = replayed(&[first.clone(), second.clone()], None);
    let lost = outcomes.len() - some.len();
    assert!(lost > 60, "{lost}");
    let not_inserted = some.len() - inserted(&some);
    assert!(
        not_inserted < 25,
        "{not_inserted} of {}: {:?}",
        some.len(),
        replay.mapper.report().scans_skipped
    );
}

#[test]
fn other_poses_can_be_taken() {
    let folder = tempfile::tempdir().unwrap();
    let (_, outcomes, report, _) = live(folder.path(), 100, i64::MAX);
    let (_, fixed, _) = replayed(&report.files, Some("fixed:1,2,0".parse().unwrap()));
    assert_eq!(inserted(&fixed), outcomes.len());
    for source in [PoseSource::Tf, PoseSource::Odom] {
        let (_, other, replay) = replayed(&report.files, Some(source.clone()));
        assert!(inserted(&other) > 80, "{source:?}: {} {:?}", inserted(&other), replay.input);
    }
}

#[test]
fn a_cut_recording_is_replayed_up_to_the_cut() {
    let folder = tempfile::tempdir().unwrap();
    let (_, outcomes, report, _) = live(folder.path(), 200, i64::MAX);
    let bytes = std::fs::read(&report.files[0]).unwrap();
    let cut = folder.path().join("cut.mcap");
    for part in [4, 6, 8] {
        std::fs::write(&cut, &bytes[..bytes.len() * part / 10]).unwrap();
        let (_, some, replay) = replayed(std::slice::from_ref(&cut), None);
        assert_eq!(replay.input.damage.len(), 1);
        assert!(some.len() > 20 * (part - 2) && some.len() < outcomes.len(), "{part}: {}", some.len());
        let same = some.iter().zip(&outcomes).take_while(|(a, b)| a == b).count();
        assert!(same + 20 >= some.len(), "only the last scans may wait for poses that are cut off");
    }
}

#[test]
fn two_runs_are_not_one() {
    let folder = tempfile::tempdir().unwrap();
    let (_, _, first, _) = live(folder.path(), 10, i64::MAX);
    let other = tempfile::tempdir().unwrap();
    let mut recorder = Recorder::create(RecorderSettings::new(other.path()), WALL + SECOND, START).unwrap();
    recorder
        .write(&Record::Bytes {
            direction: Direction::Sent,
            monotonic_ns: START,
            stream_offset: 0,
            data: vec![10],
        })
        .unwrap();
    let second = recorder.close().unwrap();
    let inputs = vec![first.files[0].clone(), second.files[0].clone()];
    let options = ReplayOptions { inputs, ..ReplayOptions::default() };
    let result = replay::run(&options, &mut |_| {}, &mut |_| {});
    assert!(matches!(result, Err(ReplayError::Input(InputError::Mixed { .. }))));
    let options = ReplayOptions { inputs: second.files, ..ReplayOptions::default() };
    let replay = replay::run(&options, &mut |_| {}, &mut |_| {}).unwrap();
    assert_eq!(replay.settings.poses, PoseUse::Odometry, "without poses the scans are matched");
}
