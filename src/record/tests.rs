//! Recorders that rotate, run full, are cut and are read back.

use super::*;
use crate::input::container::{Entry, visit};
use crate::pose::pose;
use crate::recover::{RecoverError, recover, recover_left_over};
use crate::scan::Geometry;

const MS: i64 = 1_000_000;
/// 2026-11-23 14:57:30 UTC.
const WALL: i64 = 1_795_445_850 * SECOND;
const START: i64 = 500 * SECOND;

fn scan(number: i64) -> Record {
    let stamp_ns = START + number * 25 * MS;
    Record::Scan(Arc::new(Scan {
        seq: number as u64,
        stamp_ns,
        received_ns: stamp_ns + 23 * MS,
        geometry: Geometry {
            angle_min: -135_f64.to_radians(),
            angle_increment: 0.25_f64.to_radians(),
            time_increment: 1.0 / (40.0 * 1440.0),
            range_min: 0.023,
            range_max: 60.0,
        },
        ranges: vec![1.5; 1081],
        intensities: vec![700.0; 1081],
    }))
}

/// Bytes that zstd cannot make smaller.
fn bytes(number: i64, offset: u64) -> Record {
    let mut state = number as u64 + 1;
    let data = (0..6717).map(|_| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 56) as u8
    });
    Record::Bytes {
        direction: Direction::Received,
        monotonic_ns: START + number * 25 * MS,
        stream_offset: offset,
        data: data.collect(),
    }
}

fn stamped(number: i64) -> StampedPose {
    let stamp_ns = START + number * 25 * MS;
    StampedPose {
        stamp_ns,
        received_ns: stamp_ns + MS,
        pose: pose(0.1, -0.2, 0.3),
        covariance: Some([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]),
        reset: 3,
    }
}

struct Read {
    messages: Vec<(String, u32, u64, Vec<u8>)>,
    info: FileInfo,
    attachments: Vec<String>,
    is_whole: bool,
}

impl Read {
    fn of(path: &Path) -> Self {
        let mut read = Self {
            messages: Vec::new(),
            info: FileInfo::default(),
            attachments: Vec::new(),
            is_whole: false,
        };
        let seen = visit(path, &mut |entry, _| {
            match entry {
                Entry::Message { channel, header, data } => {
                    read.messages.push((
                        channel.topic.clone(),
                        header.sequence,
                        header.log_time,
                        data.to_vec(),
                    ));
                }
                Entry::Metadata(metadata) if metadata.name == SESSION => {
                    read.info = serde_json::from_str(&metadata.metadata["json"]).unwrap();
                }
                Entry::Attachment(attachment) => read.attachments.push(attachment.name),
                _ => {}
            }
            true
        });
        read.is_whole = seen.unwrap().damage.is_none();
        read
    }

    fn of_topic(&self, topic: &str) -> Vec<&(String, u32, u64, Vec<u8>)> {
        self.messages.iter().filter(|message| message.0 == topic).collect()
    }
}

fn settings(folder: &Path) -> RecorderSettings {
    RecorderSettings {
        mount: pose(0.2, 0.0, 0.5),
        session: SessionInfo {
            software: "visagged test".into(),
            mapper: serde_json::json!({"resolution": 0.05, "third": 1.0 / 3.0}),
            ..SessionInfo::default()
        },
        attachments: vec![Attachment {
            name: "visagged.toml".into(),
            media_type: "application/toml".into(),
            data: b"[mapper]\n".to_vec(),
        }],
        ..RecorderSettings::new(folder)
    }
}

#[test]
fn every_record_is_in_the_file_with_its_time() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = Recorder::create(settings(folder.path()), WALL, START).unwrap();
    let map = Map {
        resolution: 0.05,
        origin: [-1.0, -2.0],
        width: 2,
        height: 1,
        occupancy: vec![-1, 100],
        visibility: vec![-1, 60],
        layers: Vec::new(),
    };
    let device = scip::Device {
        version: Some(scip::Fields::new([("SERI", "00903971")])),
        parameter_fields: Some(scip::Fields::new([("DMIN", "23"), ("DMAX", "60000")])),
        ..scip::Device::default()
    };
    for record in [
        Record::Device(Arc::new(device)),
        bytes(0, 0),
        scan(0),
        Record::PoseReceived { pose: stamped(1), scans_before: 1 },
        Record::PoseUsed { stamp_ns: START, pose: pose(1.0, 2.0, 0.0) },
        Record::Map(Arc::new(map.into())),
        Record::Diagnostics(vec![cdr::DiagnosticStatus { name: "scanner".into(), ..Default::default() }]),
        Record::Attachment(Attachment { name: "map.npz".into(), media_type: String::new(), data: vec![1] }),
    ] {
        recorder.write(&record).unwrap();
    }
    let report = recorder.close().unwrap();
    assert_eq!(report.messages, 10);
    let [path] = report.files.as_slice() else { panic!("{report:?}") };
    assert_eq!(path.file_name().unwrap(), "visagged_20261123T145730Z_0000.mcap");

    let read = Read::of(path);
    assert!(read.is_whole);
    assert_eq!(read.attachments, ["visagged.toml", "VV.txt", "PP.txt", "map.npz"]);
    assert_eq!(read.info.wall_minus_monotonic_ns, WALL - START);
    assert_eq!(read.info.info.mapper["third"], 1.0 / 3.0);
    for (topic, count) in
        [("/scan", 1), ("/tf", 1), ("/tf_static", 1), ("/map", 1), ("/visagge/visibility", 1)]
    {
        assert_eq!(read.of_topic(topic).len(), count, "{topic}");
    }
    let (_, sequence, log_time, data) = read.of_topic(topic::POSE_RECEIVED)[0];
    assert_eq!((*sequence, *log_time), (1, (WALL + 26 * MS) as u64));
    let exact = cdr::PoseReceived::decode(data).unwrap();
    let rotation = stamped(1).pose.rotation;
    assert_eq!(exact.pose, [0.1, -0.2, rotation.re, rotation.im]);
    assert_eq!((exact.reset, exact.scans_before, exact.covariance), (3, 1, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
    let (_, sequence, _, data) = read.of_topic("/odom")[0];
    let odometry = cdr::Odometry::decode(data).unwrap();
    assert_eq!((*sequence, odometry.pose_covariance[5], odometry.pose_covariance[35]), (1, 3.0, 6.0));
    let laser = cdr::LaserScan::decode(&read.of_topic("/scan")[0].3).unwrap();
    assert_eq!(laser.header.stamp_ns, WALL);
    assert_eq!(((laser.angle_max - laser.angle_min) / laser.angle_increment).round(), 1080.0);
    assert!((laser.scan_time - 0.025).abs() < 1e-6);
    let mount = cdr::TfMessage::decode(&read.of_topic("/tf_static")[0].3).unwrap();
    assert_eq!(mount.transforms[0].transform.translation, [0.2, 0.0, 0.0]);
}

#[test]
fn files_rotate_by_age_and_size_and_each_is_complete() {
    for (rotate_ns, rotate_bytes) in [(2 * SECOND, u64::MAX), (i64::MAX, 500_000)] {
        let folder = tempfile::tempdir().unwrap();
        let settings = RecorderSettings { rotate_ns, rotate_bytes, ..settings(folder.path()) };
        let mut recorder = Recorder::create(settings, WALL, START).unwrap();
        let device = scip::Device {
            parameter_fields: Some(scip::Fields::new([("DMIN", "23")])),
            ..scip::Device::default()
        };
        recorder.write(&Record::Device(Arc::new(device))).unwrap();
        for number in 0..240 {
            recorder.write(&bytes(number, number as u64 * 6717)).unwrap();
            recorder.write(&scan(number)).unwrap();
        }
        let report = recorder.close().unwrap();
        assert!((3..=4).contains(&report.files.len()), "{report:?}");
        let (mut scans, mut sequences) = (0, Vec::new());
        for (number, path) in report.files.iter().enumerate() {
            let read = Read::of(path);
            assert!(read.is_whole);
            assert_eq!((read.info.file, read.info.scans_before), (number as u32, scans));
            assert_eq!(read.attachments, ["visagged.toml", "PP.txt"]);
            assert_eq!(read.of_topic("/tf_static").len(), 1);
            scans += read.of_topic("/scan").len() as u64;
            sequences.extend(read.of_topic(topic::SCIP).iter().map(|message| message.1));
        }
        assert_eq!(scans, 240);
        assert!(sequences.iter().copied().eq(0..240));
    }
}

#[test]
fn a_step_of_the_wall_clock_waits_for_the_next_file() {
    let folder = tempfile::tempdir().unwrap();
    let settings = RecorderSettings { rotate_ns: SECOND, ..settings(folder.path()) };
    let mut recorder = Recorder::create(settings, WALL, START).unwrap();
    recorder.on_clocks(WALL - 3600 * SECOND, START);
    for number in 0..60 {
        recorder.write(&bytes(number, 0)).unwrap();
    }
    let report = recorder.close().unwrap();
    assert_eq!(report.files.len(), 2);
    for (path, offset) in report.files.iter().zip([WALL - START, WALL - START - 3600 * SECOND]) {
        let read = Read::of(path);
        assert_eq!(read.info.wall_minus_monotonic_ns, offset);
        assert!(read.messages.is_sorted_by_key(|message| message.2));
        assert!(read.messages.iter().all(|message| (message.2 as i64 - offset - START) / SECOND < 2));
    }
}

#[test]
fn a_full_disk_costs_one_file_and_is_counted() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = Recorder::create(settings(folder.path()), WALL, START).unwrap();
    // The first file has no limit; the next ones have.
    recorder.room = Some(60_000);
    recorder.settings.rotate_ns = SECOND;
    let mut errors = 0;
    for number in 0..200 {
        if number == 100 {
            recorder.room = None;
        }
        errors += u64::from(recorder.write(&bytes(number, 0)).is_err());
    }
    let report = recorder.close().unwrap();
    assert_eq!(report.errors, errors);
    assert!((1..=4).contains(&errors), "{report:?}");
    assert_eq!(report.failed_files.len() as u64, errors);
    let written: usize = report.files.iter().map(|path| Read::of(path).of_topic(topic::SCIP).len()).sum();
    assert!(report.lost > 0 && written as u64 + report.lost <= 200, "{written} {report:?}");
    assert!(report.files.len() >= 2, "went on when there was room: {report:?}");
}

#[test]
fn a_folder_that_vanishes_is_an_error_once_a_second() {
    let folder = tempfile::tempdir().unwrap();
    let deeper = folder.path().join("deeper");
    std::fs::create_dir(&deeper).unwrap();
    let settings = RecorderSettings { rotate_ns: SECOND, ..settings(&deeper) };
    let mut recorder = Recorder::create(settings, WALL, START).unwrap();
    recorder.write(&bytes(0, 0)).unwrap();
    std::fs::remove_dir_all(&deeper).unwrap();
    let errors = (1..200).filter(|&number| recorder.write(&bytes(number, 0)).is_err()).count();
    assert!((3..=5).contains(&errors), "{errors}");
    std::fs::create_dir(&deeper).unwrap();
    for number in 200..280 {
        recorder.write(&bytes(number, 0)).unwrap();
    }
    assert_eq!(recorder.close().unwrap().files.len(), 2);
}

/// An `.active` file as a kill leaves it: `Recorder` is forgotten, not dropped.
fn killed(folder: &Path) -> PathBuf {
    let mut recorder = Recorder::create(settings(folder), WALL, START).unwrap();
    for number in 0..100 {
        recorder.write(&bytes(number, number as u64 * 6717)).unwrap();
        recorder.write(&scan(number)).unwrap();
    }
    let path = recorder.open.as_ref().unwrap().path.clone();
    let left = folder.join("left.mcap.active");
    // A copy is what another process finds when this one is gone, and its lock with it.
    std::fs::copy(&path, &left).unwrap();
    std::mem::forget(recorder);
    std::fs::remove_file(path).unwrap();
    left
}

#[test]
fn a_killed_run_is_rescued_without_loss() {
    let folder = tempfile::tempdir().unwrap();
    let left = killed(folder.path());
    let rescued = recover_left_over(folder.path()).unwrap();
    let [(path, Ok(recovery))] = rescued.as_slice() else { panic!("{rescued:?}") };
    assert_eq!((path, recovery.exit_code()), (&left, 0));
    assert!(!left.exists());
    let read = Read::of(&recovery.output);
    assert!(read.is_whole);
    assert_eq!(read.messages.len() as u64, recovery.messages);
    // Flushed once a second and not since the last second.
    assert!(read.of_topic("/scan").len() >= 60);
    assert_eq!(read.attachments, ["visagged.toml"]);
    assert!(recover_left_over(folder.path()).unwrap().is_empty());
}

#[test]
fn any_cut_is_rescued_up_to_the_cut() {
    let folder = tempfile::tempdir().unwrap();
    let left = killed(folder.path());
    let whole = std::fs::read(&left).unwrap();
    let cut = folder.path().join("cut.mcap");
    let output = folder.path().join("cut.recovered.mcap");
    let messages = Read::of(&left).messages;
    let (mut last, mut losses) = (0, 0);
    for length in (8..whole.len()).step_by(whole.len() / 97) {
        std::fs::write(&cut, &whole[..length]).unwrap();
        let recovery = match recover(&cut) {
            Ok(recovery) => recovery,
            Err(RecoverError::Nothing { .. }) if length < 100 => continue,
            Err(other) => panic!("{length}: {other}"),
        };
        let rescued = Read::of(&output);
        assert!(rescued.is_whole);
        assert_eq!(rescued.messages, messages[..rescued.messages.len()]);
        assert!(rescued.messages.len() >= last);
        last = rescued.messages.len();
        losses += usize::from(recovery.exit_code() == 3);
        assert_eq!(std::fs::read(&cut).unwrap().len(), length, "the cut file is left alone");
        std::fs::remove_file(&output).unwrap();
    }
    assert!(last > 100 && losses > 50, "{last} messages, {losses} cuts with loss");
}

#[test]
fn nothing_is_overwritten_and_nothing_else_is_taken_for_a_recording() {
    let folder = tempfile::tempdir().unwrap();
    let left = killed(folder.path());
    std::fs::write(left.with_extension(""), "mine").unwrap();
    assert!(matches!(recover(&left), Err(RecoverError::Exists { .. })));
    assert_eq!(std::fs::read(left.with_extension("")).unwrap(), b"mine");
    let text = folder.path().join("text.mcap");
    std::fs::write(&text, "no recording, but a text\n").unwrap();
    assert!(matches!(recover(&text), Err(RecoverError::Nothing { .. })));
    let names: Vec<_> =
        std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(names.len(), 3, "no rest of a failed rescue: {names:?}");
}

#[test]
fn a_file_that_is_being_written_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let recorder = Recorder::create(settings(folder.path()), WALL, START).unwrap();
    assert!(recover_left_over(folder.path()).unwrap().is_empty());
    let path = recorder.open.as_ref().unwrap().path.clone();
    assert!(matches!(recover(&path), Err(RecoverError::InUse { .. })));
    let second = Recorder::create(settings(folder.path()), WALL, START).unwrap();
    assert_ne!(second.open.as_ref().unwrap().path, path);
    second.close().unwrap();
    recorder.close().unwrap();
}

#[test]
fn damage_inside_ends_the_rescue_and_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let left = killed(folder.path());
    let mut bytes = std::fs::read(&left).unwrap();
    let inside_a_chunk = bytes.len() / 4;
    bytes[inside_a_chunk..inside_a_chunk + 64].fill(0);
    std::fs::write(&left, bytes).unwrap();
    let recovery = recover(&left).unwrap();
    assert_eq!(recovery.exit_code(), 3);
    assert!(recovery.damage.unwrap().offset >= inside_a_chunk as u64);
    assert!(recovery.messages > 10);
}
