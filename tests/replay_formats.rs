//! Replays of every kind of input, made here byte by byte, and of real data where VISAGGED_TEST_DATA names it.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use visagged::cdr::{Header, LaserScan, Message, Odometry, TfMessage, Transform, TransformStamped};
use visagged::input::{InputError, InputOptions, PoseSource};
use visagged::mapper::{MapperKind, MapperSettings, Mount, Outcome, PoseUse};
use visagged::pose::{Pose, pose};
use visagged::replay::{self, Replay, ReplayError, ReplayOptions};

const MS: i64 = 1_000_000;

fn options(inputs: &[PathBuf], source: Option<&str>) -> ReplayOptions {
    let pose = source.map(|text| text.parse::<PoseSource>().unwrap());
    ReplayOptions {
        inputs: inputs.to_vec(),
        input: InputOptions { pose, ..InputOptions::default() },
        ..ReplayOptions::default()
    }
}

fn run(options: &ReplayOptions) -> (Replay, Vec<Outcome>) {
    let mut outcomes = Vec::new();
    let replay = replay::run(options, &mut |outcome| outcomes.push(outcome), &mut |_| {}).unwrap();
    (replay, outcomes)
}

fn error(options: &ReplayOptions) -> InputError {
    match replay::run(options, &mut |_| {}, &mut |_| {}) {
        Err(ReplayError::Input(error)) => error,
        Err(other) => panic!("{other}"),
        Ok(_) => panic!("a map was made"),
    }
}

fn starts(outcomes: &[Outcome]) -> Vec<Pose> {
    let start = |outcome: &Outcome| match outcome {
        Outcome::Inserted { start, .. } => Some(*start),
        Outcome::Skipped { .. } | Outcome::Moved(_) => None,
    };
    outcomes.iter().filter_map(start).collect()
}

#[track_caller]
fn assert_near(a: &Pose, b: &Pose) {
    let apart = a.inverse() * b;
    assert!(apart.translation.vector.norm() < 1e-6 && apart.rotation.angle().abs() < 1e-6, "{a} {b}");
}

/// Writes a bag as ROS 2 does: MCAP, CDR, ros2msg.
struct BagWriter {
    writer: mcap::Writer<BufWriter<File>>,
    channels: BTreeMap<String, u16>,
}

impl BagWriter {
    fn create(path: &Path) -> Self {
        let options = mcap::WriteOptions::new().profile("ros2").chunk_size(Some(4096)).compression_threads(0);
        let writer = options.create(BufWriter::new(File::create(path).unwrap())).unwrap();
        Self { writer, channels: BTreeMap::new() }
    }

    fn write<M: Message>(&mut self, topic: &str, log_time: i64, message: &M) {
        self.write_bytes::<M>(topic, log_time, &message.encode());
    }

    fn write_bytes<M: Message>(&mut self, topic: &str, log_time: i64, data: &[u8]) {
        let channel_id = *self.channels.entry(topic.to_owned()).or_insert_with(|| {
            let schema = self.writer.add_schema(M::TYPE, "ros2msg", M::SCHEMA.as_bytes()).unwrap();
            self.writer.add_channel(schema, topic, "cdr", &BTreeMap::new()).unwrap()
        });
        let log_time = log_time as u64;
        let header =
            mcap::records::MessageHeader { channel_id, sequence: 0, log_time, publish_time: log_time };
        self.writer.write_to_known_channel(&header, data).unwrap();
    }

    fn finish(mut self) {
        self.writer.finish().unwrap();
    }
}

/// A scan of three beams, straight ahead the middle one, taken within 2 ms.
fn laser_scan(stamp_ns: i64) -> LaserScan {
    LaserScan {
        header: Header { stamp_ns, frame_id: "laser".into() },
        angle_min: -0.5,
        angle_max: 0.5,
        angle_increment: 0.5,
        time_increment: 0.001,
        range_min: 0.1,
        range_max: 10.0,
        ranges: vec![1.0, 2.0, f32::INFINITY],
        ..LaserScan::default()
    }
}

fn frame(parent: &str, child: &str, stamp_ns: i64, x: f64) -> TfMessage {
    TfMessage {
        transforms: vec![TransformStamped {
            header: Header { stamp_ns, frame_id: parent.into() },
            child_frame_id: child.into(),
            transform: Transform { translation: [x, 0.0, 0.0], ..Transform::default() },
        }],
    }
}

fn odometry(stamp_ns: i64, x: f64) -> Odometry {
    Odometry {
        header: Header { stamp_ns, frame_id: "odom".into() },
        child_frame_id: "base_link".into(),
        pose: Transform { translation: [x, 0.0, 0.0], ..Transform::default() },
        pose_covariance: [0.0; 36],
        twist: [0.0; 6],
        twist_covariance: [0.0; 36],
    }
}

/// Ten scans, 100 ms apart, of a robot at 1 m/s; the poses of each moment come late, as they do on a robot.
fn moving_bag(path: &Path) {
    let mut bag = BagWriter::create(path);
    bag.write("/tf_static", 0, &frame("base_link", "laser", 0, 0.25));
    for step in 0..10 {
        let stamp = step * 100 * MS;
        bag.write("/scan", stamp, &laser_scan(stamp));
        bag.write("/tf", stamp + MS, &frame("odom", "base_link", stamp, step as f64 * 0.1));
        bag.write("/tf", stamp + MS, &frame("map", "odom", stamp, 100.0));
        bag.write("/odom", stamp + 2 * MS, &odometry(stamp, step as f64 * 0.1));
    }
    bag.write("/tf", 1000 * MS, &frame("map", "odom", 1000 * MS, 100.0));
    bag.write("/tf", 1000 * MS, &frame("odom", "base_link", 1000 * MS, 1.0));
    bag.write("/odom", 1000 * MS, &odometry(1000 * MS, 1.0));
    bag.finish();
}

#[test]
fn a_bag_by_transforms_odometry_and_a_file_of_poses() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    moving_bag(&path);
    let tum = folder.path().join("drive.tum");
    std::fs::write(&tum, "0 5 0 0 0 0 0 1\n0.2 5.2 0 0 0 0 0 1\n0.4 5.4 0 0 0 0 0 1 # ends early\n").unwrap();
    let file = tum.to_str().unwrap();
    for (source, first, third, inserted) in [
        (None, 100.0, 100.2, 10),
        (Some("tf"), 100.0, 100.2, 10),
        (Some("odom"), 0.0, 0.2, 10),
        (Some("fixed:7,0,0"), 7.0, 7.0, 10),
        (Some(file), 5.0, 5.2, 4),
    ] {
        let (replay, outcomes) = run(&options(std::slice::from_ref(&path), source));
        let starts = starts(&outcomes);
        assert_eq!((outcomes.len(), starts.len()), (10, inserted), "{source:?}");
        assert_near(&starts[0], &pose(first, 0.0, 0.0));
        assert_near(&starts[2], &pose(third, 0.0, 0.0));
        assert!((replay.settings.mount.x - 0.25).abs() < 1e-9, "{source:?}");
        assert_eq!((replay.input.scans, replay.input.kind.as_str()), (10, "bag"));
        assert!(replay.input.damage.is_empty());
    }
    let mut in_odom = options(&[path], Some("tf"));
    in_odom.input.fixed_frame = Some("odom".into());
    assert_near(&starts(&run(&in_odom).1)[9], &pose(0.9, 0.0, 0.0));
}

#[test]
fn a_bag_without_poses_is_matched_or_says_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("standing.mcap");
    let mut bag = BagWriter::create(&path);
    bag.write("/front/scan", 0, &laser_scan(0));
    bag.write("/front/scan", 100 * MS, &laser_scan(100 * MS));
    bag.finish();
    let message = error(&options(std::slice::from_ref(&path), Some("tf"))).to_string();
    assert!(message.contains("--pose fixed"), "{message}");
    for source in [None, Some("match"), Some("match-ranges")] {
        let (replay, _) = run(&options(std::slice::from_ref(&path), source));
        assert_eq!(replay.settings.poses, PoseUse::Odometry);
        assert!(replay.input.notes.iter().any(|note| note.contains("matched")), "{:?}", replay.input.notes);
        assert_eq!(replay.input.poses, 0);
    }
    let (replay, outcomes) = run(&options(std::slice::from_ref(&path), Some("fixed")));
    assert_eq!(replay.settings.poses, PoseUse::Map);
    assert_eq!(starts(&outcomes).len(), 2);
    assert_eq!(replay.input.poses, 4);
    let mut wrong = options(&[path], Some("fixed"));
    wrong.input.scan_topic = Some("/scan".into());
    assert!(error(&wrong).to_string().contains("it has /front/scan"));
}

#[test]
fn odometry_without_a_mount_asks_for_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("odom.mcap");
    let mut bag = BagWriter::create(&path);
    for step in 0..3 {
        bag.write("/odom", step * 100 * MS, &odometry(step * 100 * MS, 1.0));
        bag.write("/scan", step * 100 * MS, &laser_scan(step * 100 * MS));
    }
    bag.finish();
    assert!(error(&options(std::slice::from_ref(&path), None)).to_string().contains("--mount X,Y,YAW"));
    let mut with_mount = options(&[path], Some("odom"));
    with_mount.input.mount = Some(pose(0.5, 0.0, 0.1));
    let (replay, outcomes) = run(&with_mount);
    assert_eq!(starts(&outcomes).len(), 2, "the last scan ends behind the last pose");
    assert!((replay.settings.mount.yaw - 0.1).abs() < 1e-9);
    with_mount.input.mount = None;
    with_mount.mapper = Some(mounted(0.1));
    let (replay, outcomes) = run(&with_mount);
    assert_eq!((starts(&outcomes).len(), replay.settings.mount.yaw), (2, 0.1));
}

/// Settings that tell where the scanner is: 0.5 m ahead, turned.
fn mounted(yaw: f64) -> MapperSettings {
    MapperSettings { mount: Mount { x: 0.5, yaw, ..Mount::default() }, ..MapperSettings::default() }
}

/// Three scans, 100 ms apart, among other messages.
fn bag_of_three(path: &Path, mut write: impl FnMut(&mut BagWriter, i64)) {
    let mut bag = BagWriter::create(path);
    for stamp in [0, 100 * MS, 200 * MS] {
        write(&mut bag, stamp);
        bag.write("/scan", stamp, &laser_scan(stamp));
    }
    bag.finish();
}

fn metres(stamp_ns: i64) -> f64 {
    stamp_ns as f64 * 1e-9
}

#[test]
fn transforms_without_a_mount_ask_for_it_and_are_used_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("apart.mcap");
    bag_of_three(&path, |bag, stamp| {
        bag.write("/tf", stamp, &frame("map", "base_link", stamp, metres(stamp)))
    });
    for source in [None, Some("tf"), Some("match")] {
        let message = error(&options(std::slice::from_ref(&path), source)).to_string();
        for wanted in ["base_link, map", "frame laser", "--mount X,Y,YAW", "match-ranges"] {
            assert!(message.contains(wanted), "{source:?}: {message}");
        }
    }
    let (left_alone, _) = run(&options(std::slice::from_ref(&path), Some("match-ranges")));
    assert_eq!((left_alone.settings.poses, left_alone.input.poses), (PoseUse::Odometry, 0));
    let mut by_option = options(std::slice::from_ref(&path), None);
    by_option.input.mount = Some(pose(0.5, 0.0, 0.1));
    let by_settings = ReplayOptions { mapper: Some(mounted(0.1)), ..options(&[path], None) };
    for (options, placed) in [(by_option, "as given"), (by_settings, "by the settings")] {
        let (replay, outcomes) = run(&options);
        assert_eq!(replay.settings.poses, PoseUse::Map);
        assert!((replay.settings.mount.x - 0.5).abs() + (replay.settings.mount.yaw - 0.1).abs() < 1e-9);
        assert_near(&starts(&outcomes)[1], &pose(0.1, 0.0, 0.0));
        let note = &replay.input.notes[0];
        assert!(note.contains("base_link in map by tf") && note.contains(placed), "{note}");
    }
}

#[test]
fn what_is_named_and_not_there_is_told_with_what_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    bag_of_three(&path, |bag, stamp| {
        bag.write("/tf", stamp, &frame("odom", "base_link", stamp, metres(stamp)));
        bag.write("/tf", stamp, &frame("base_link", "laser", stamp, 0.25));
        bag.write("/tf", stamp, &frame("base_link", "wheel", stamp, 0.0));
        bag.write("/wheels", stamp, &odometry(stamp, metres(stamp)));
    });
    let set = |set: fn(&mut InputOptions)| {
        let mut options = options(std::slice::from_ref(&path), None);
        set(&mut options.input);
        error(&options)
    };
    for (error, wanted) in [
        (
            set(|input| input.fixed_frame = Some("map".into())),
            "no frame map; it has base_link, laser, odom, wheel",
        ),
        (set(|input| input.base_frame = Some("/cart".into())), "no frame cart; it has base_link"),
        (set(|input| input.fixed_frame = Some("wheel".into())), "laser <- base_link <- odom"),
        (set(|input| input.odom_topic = Some("/odom".into())), "/odom; it has /wheels"),
        (set(|input| input.scan_topic = Some("/scn".into())), "/scn; it has /scan"),
        (
            set(|input| input.pose = Some("tff".parse().unwrap())),
            "no file of poses tff; --pose takes recorded, tf,",
        ),
    ] {
        assert!(error.to_string().contains(wanted), "{error}");
        assert!(!matches!(error, InputError::Io { .. }), "it is no fault of reading: {error:?}");
    }
}

#[test]
fn odometry_guides_and_is_taken_for_true_where_that_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name| folder.path().join(name);
    let by_tf = |parent: &'static str| {
        move |bag: &mut BagWriter, stamp| {
            bag.write("/tf", stamp, &frame(parent, "base_link", stamp, metres(stamp)));
            bag.write("/tf", stamp, &frame("base_link", "laser", stamp, 0.25));
        }
    };
    let by_topic = |fixed: &'static str| {
        move |bag: &mut BagWriter, stamp| {
            let mut message = odometry(stamp, metres(stamp));
            message.header.frame_id = fixed.into();
            bag.write("/odometry", stamp, &message);
            bag.write("/tf", stamp, &frame("base_link", "laser", stamp, 0.25));
        }
    };
    bag_of_three(&path("odom.mcap"), by_tf("odom"));
    bag_of_three(&path("names.mcap"), by_tf("robot1/odom_combined"));
    bag_of_three(&path("hall.mcap"), by_tf("hall"));
    bag_of_three(&path("wheels.mcap"), by_topic("odom"));
    bag_of_three(&path("filter.mcap"), by_topic("map"));
    bag_of_three(&path("both.mcap"), |bag, stamp| {
        by_tf("odom")(bag, stamp);
        by_topic("odom")(bag, stamp);
    });
    for (name, source, is_true, told) in [
        ("odom.mcap", None, true, "in odom by tf"),
        ("odom.mcap", Some("match"), false, "in odom by tf"),
        ("odom.mcap", Some("tf"), true, "in odom by tf"),
        ("names.mcap", None, true, "in robot1/odom_combined by tf"),
        ("hall.mcap", None, true, "in hall by tf"),
        ("wheels.mcap", None, false, "by /odometry; scanner laser. Odometry drifts; --pose odom would"),
        ("wheels.mcap", Some("odom"), true, "by /odometry"),
        ("filter.mcap", None, true, "by /odometry"),
        ("both.mcap", None, true, "in odom by tf"),
        ("both.mcap", Some("match"), false, "by /odometry"),
    ] {
        let (replay, outcomes) = run(&options(&[path(name)], source));
        let expected = if is_true { PoseUse::Map } else { PoseUse::Odometry };
        assert_eq!((replay.settings.poses, replay.input.poses), (expected, 3), "{name} {source:?}");
        assert!(replay.input.notes[0].contains(told), "{name} {source:?}: {:?}", replay.input.notes);
        let is_doubtful = source.is_none() && told.contains(" by tf") && !told.contains("hall");
        assert_eq!(replay.input.doubts.len(), usize::from(is_doubtful), "{name} {source:?}");
        if is_true {
            assert_near(&starts(&outcomes)[1], &pose(0.1, 0.0, 0.0));
        }
    }
    // A topic that is named is the guide.
    let mut named = options(&[path("both.mcap")], None);
    named.input.odom_topic = Some("/odometry".into());
    let (replay, _) = run(&named);
    assert_eq!(replay.settings.poses, PoseUse::Odometry);
    assert!(replay.input.notes[0].contains("by /odometry"), "{:?}", replay.input.notes);
}

#[test]
fn bad_messages_are_counted_and_lost_scans_are_seen() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.mcap");
    let mut bag = BagWriter::create(&path);
    for step in [0, 1, 2, 3, 6, 7] {
        bag.write("/scan", step * 100 * MS, &laser_scan(step * 100 * MS));
    }
    let cut = laser_scan(800 * MS).encode();
    bag.write_bytes::<LaserScan>("/scan", 800 * MS, &cut[..cut.len() - 9]);
    bag.write("/scan", 300 * MS, &laser_scan(300 * MS));
    bag.write("/scan", 900 * MS, &LaserScan { ranges: Vec::new(), ..laser_scan(900 * MS) });
    bag.finish();
    let (replay, outcomes) = run(&options(&[path], Some("fixed")));
    assert_eq!(outcomes.len(), 6);
    let seqs: Vec<u64> = outcomes.iter().filter_map(Outcome::seq).collect();
    assert_eq!(seqs, [0, 1, 2, 3, 6, 7]);
    let errors = &replay.input.decode_errors;
    assert_eq!(errors["LaserScan"], 1);
    assert_eq!(errors["scan not behind the one before"], 1);
    assert_eq!(errors["scan without beams or angles"], 1);
}

#[test]
fn a_cut_bag_is_used_up_to_the_cut() {
    let folder = tempfile::tempdir().unwrap();
    let whole = folder.path().join("whole.mcap");
    let mut bag = BagWriter::create(&whole);
    let mut state = 1_u32;
    for step in 0..500 {
        let mut scan = laser_scan(step * 25 * MS);
        // Ranges that do not compress, so that a cut lies among the scans and not in the summary.
        scan.ranges.resize_with(100, || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            1.0 + state as f32 / u32::MAX as f32
        });
        bag.write("/scan", step * 25 * MS, &scan);
    }
    bag.finish();
    let bytes = std::fs::read(&whole).unwrap();
    let cut = folder.path().join("cut.mcap");
    let mut last = 0;
    for part in 2..=9 {
        std::fs::write(&cut, &bytes[..bytes.len() * part / 10]).unwrap();
        let (replay, _) = run(&options(std::slice::from_ref(&cut), Some("fixed")));
        assert_eq!(replay.input.damage.len(), 1, "{:?}", replay.input);
        assert!(replay.input.damage[0].offset <= (bytes.len() * part / 10) as u64);
        assert!(replay.input.scans >= last, "{} scans at {part}/10", replay.input.scans);
        last = replay.input.scans;
    }
    assert!(last > 250, "{last}");
}

#[test]
fn flipped_bytes_are_no_panic() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    moving_bag(&path);
    let whole = std::fs::read(&path).unwrap();
    let mut state = 1_usize;
    let (mut errors, mut maps) = (0, 0);
    for _ in 0..400 {
        let mut bytes = whole.clone();
        for _ in 0..3 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let at = (state >> 20) % bytes.len();
            bytes[at] ^= 1 << (state >> 50 & 7);
        }
        std::fs::write(&path, &bytes).unwrap();
        match replay::run(&options(std::slice::from_ref(&path), None), &mut |_| {}, &mut |_| {}) {
            Ok(_) => maps += 1,
            Err(_) => errors += 1,
        }
    }
    assert!(errors > 10 && maps > 10, "{errors} errors, {maps} maps");
}

#[test]
fn a_cut_gzip_is_used_up_to_the_cut() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.log.gz");
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    for number in 1..2000 {
        let (range, x) = (number % 77, number * 31 % 101);
        writeln!(encoder, "FLASER 4 {range} 1 81.91 {x} {x} 0 0 {x} 0 0 {number}.5 host {number}.5").unwrap();
    }
    let bytes = encoder.finish().unwrap();
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let (replay, _) = run(&options(&[path], None));
    assert!((100..1999).contains(&replay.input.scans), "{:?}", replay.input);
    assert_eq!(replay.input.damage.len(), 1);
}

#[test]
fn a_bare_stream_in_two_files_with_garbage() {
    let folder = tempfile::tempdir().unwrap();
    let mut stream = Vec::new();
    for number in 0..4_u32 {
        stream.extend_from_slice(b"MD0540054201000\n99b\n");
        let mut line = |value: u32, chars| {
            let mut text = Vec::new();
            scip::number::encode(value, chars, &mut text);
            text.push(scip::number::checksum(&text));
            stream.extend_from_slice(&text);
            stream.push(b'\n');
        };
        line(1000 + 25 * number, 4);
        let mut data = Vec::new();
        for distance in [1500, 1, 2500] {
            scip::number::encode(distance, 3, &mut data);
        }
        data.push(scip::number::checksum(&data));
        stream.extend_from_slice(&data);
        stream.extend_from_slice(b"\n\n");
        if number == 1 {
            stream.extend_from_slice(b"\x00garbage\n\n");
        }
    }
    let (first, second) = stream.split_at(stream.len() / 2 + 7);
    let paths = [folder.path().join("a.scip"), folder.path().join("b.bin")];
    std::fs::write(&paths[0], first).unwrap();
    std::fs::write(&paths[1], second).unwrap();
    assert!(error(&options(&paths, Some("odom"))).to_string().contains("--pose fixed"));
    assert_eq!(run(&options(&paths, None)).0.settings.poses, PoseUse::Odometry);
    let (replay, outcomes) = run(&options(&paths, Some("fixed")));
    assert_eq!((replay.input.scans, starts(&outcomes).len()), (4, 4), "{:?}", replay.input);
    assert!(replay.input.skipped_bytes > 0);
    assert!(replay.input.notes[0].contains("UTM-30LX"));
}

#[test]
fn what_is_no_input_is_refused_with_a_hint() {
    let folder = tempfile::tempdir().unwrap();
    for (content, hint) in [
        (&b"#ROSBAG V2.0\n"[..], "rosbags-convert"),
        (b"SQLite format 3\0", "rosbags-convert"),
        (b"hello\n", "neither MCAP, SCIP bytes nor a Carmen log"),
        (b"", "neither MCAP"),
        (b"\x89MCAP1\r\n", "neither MCAP"),
    ] {
        let path = folder.path().join("input.mcap");
        std::fs::write(&path, content).unwrap();
        let message = error(&options(&[path], Some("fixed"))).to_string();
        assert!(message.contains(hint), "{message}");
    }
    assert!(matches!(error(&options(&[folder.path().join("none")], None)), InputError::Io { .. }));
    assert!(matches!(error(&options(&[], None)), InputError::Nothing));
}

const CARMEN: &str = "\
# message formats defined: PARAM SYNC ODOM FLASER RLASER
ODOM 0 0 0 0 0 0 1.0 host 1.0
FLASER 4 1 1 81.91 1 10 0 0 20 0 0 1.5 host 1.5
FLASER 4 1 1 81.91
FLASER 4 1 1 81.91 1 11 0 0 21 0 0 2.0 host 2.0
FLASER 4 1 1 81.91 1 11 0 0 21 0 0 1.9 host 1.9
";

#[test]
fn a_carmen_log_plain_and_packed() {
    let folder = tempfile::tempdir().unwrap();
    let plain = folder.path().join("drive.log");
    std::fs::write(&plain, CARMEN).unwrap();
    let packed = folder.path().join("drive.clf.gz");
    let mut encoder =
        flate2::write::GzEncoder::new(File::create(&packed).unwrap(), flate2::Compression::fast());
    encoder.write_all(CARMEN.as_bytes()).unwrap();
    encoder.finish().unwrap();
    for path in [plain, packed] {
        let (replay, outcomes) = run(&options(std::slice::from_ref(&path), None));
        let starts_ = starts(&outcomes);
        assert_eq!(starts_.len(), 2);
        assert_near(&starts_[1], &pose(11.0, 0.0, 0.0));
        assert_eq!(replay.input.decode_errors["line too short"], 1);
        assert_eq!(replay.input.decode_errors["scan not behind the one before"], 1);
        let (_, outcomes) = run(&options(&[path], Some("odom")));
        assert_near(&starts(&outcomes)[1], &pose(21.0, 0.0, 0.0));
    }
}

/// Real data, where it is.
fn data(path: &str) -> Option<PathBuf> {
    let Some(folder) = std::env::var_os("VISAGGED_TEST_DATA") else {
        eprintln!("skipped: VISAGGED_TEST_DATA does not name the folder of {path}");
        return None;
    };
    Some(Path::new(&folder).join(path))
}

fn show(name: &str, replay: &Replay, outcomes: &[Outcome]) {
    let inserted = starts(outcomes).len();
    eprintln!(
        "{name}: {inserted} of {} inserted, mount {:?}, {:?}",
        outcomes.len(),
        replay.settings.mount,
        replay.input
    );
}

#[test]
fn real_office_without_poses() {
    let Some(path) = data("real/utm30lx-office.mcap") else { return };
    let (matched, outcomes) = run(&options(std::slice::from_ref(&path), None));
    show("office, matched", &matched, &outcomes);
    assert_eq!(starts(&outcomes).len(), 885);
    let (replay, outcomes) = run(&options(&[path], Some("fixed")));
    show("office", &replay, &outcomes);
    assert_eq!((replay.input.scans, starts(&outcomes).len()), (885, 885));
}

#[test]
fn real_wheelchair_by_odometry() {
    let Some(path) = data("real/smartwheeler.mcap") else { return };
    for (source, least) in [(None, 870), (Some("match"), 860), (Some("odom"), 870)] {
        let mut options = options(std::slice::from_ref(&path), source);
        options.ignore_beams = vec![[0, 52], [587, 666], [764, 767]];
        let (replay, outcomes) = run(&options);
        show("wheelchair", &replay, &outcomes);
        assert_eq!(replay.input.scans, 873);
        assert!(starts(&outcomes).len() >= least);
        assert!((replay.settings.mount.x - 0.850326).abs() < 1e-6);
    }
}

#[test]
fn real_carmen_log() {
    let Some(path) = data("real/freiburg-079-corrected.log.gz") else { return };
    let mut options = options(&[path], None);
    options.mapper_kind = Some(MapperKind::Standard);
    let (replay, outcomes) = run(&options);
    show("freiburg", &replay, &outcomes);
    assert_eq!((replay.input.scans, starts(&outcomes).len()), (4791, 4791));
}

#[test]
fn real_scip_streams() {
    for (file, scans) in [
        ("utm_30lx/dev_to_host.bin", 1),
        ("urg_sim_encoder/me_full_3scans.bin", 3),
        ("urg_04lx/dev_to_host.bin", 1),
        ("uxm_30lx_e/dev_to_host.bin", 1),
    ] {
        let Some(path) = data(&format!("scip-captures/{file}")) else { return };
        let (replay, outcomes) = run(&options(&[path], Some("fixed")));
        show(file, &replay, &outcomes);
        assert_eq!(replay.input.scans, scans, "{file}");
        assert_eq!(starts(&outcomes).len() as u64, scans, "{file}");
    }
}
