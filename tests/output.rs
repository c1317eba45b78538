//! The folder of results, read back by other means than those that wrote it.

use std::collections::BTreeMap;
use std::fs;
use std::io::Read;
use std::path::Path;

use visagged::closing::moved::Moved;
use visagged::map::{Layer, Map, Values};
use visagged::mapper::{Mapper, MapperSettings};
use visagged::output::Outputs;
use visagged::pose::pose;
use visagged::report::{MapSummary, Mode, PoseCounts, Report, Versions};

fn map() -> Map {
    Map {
        resolution: 0.05,
        origin: [-1.25, 2.5],
        width: 3,
        height: 2,
        //         bottom row   top row
        occupancy: vec![0, 100, -1, -1, 100, 0],
        visibility: vec![-1, 100, -1, -1, 5, -1],
        layers: vec![
            layer("hits", &[1, 2, 3, 4, 5], Values::U8(vec![1, 2, 3, 4, 255])),
            layer("start", &[5, 1, 2, 3, 4], Values::U16(vec![5, 1, 256, 65535, 4])),
            layer(
                "drift",
                &[0, 1, 2, 3, 4, 5],
                Values::F32(vec![0.5, -1.0, f32::MIN_POSITIVE, 3.0, 4.0, 5.0]),
            ),
        ],
    }
}

fn layer(name: &'static str, cells: &[usize], values: Values) -> Layer {
    Layer { name, cells: cells.into(), values }
}

fn report(map: &Map) -> Report {
    Report {
        versions: Versions::default(),
        mode: Mode::Live,
        finished: true,
        inputs: vec!["sim:hall".into()],
        started_s: 1.7e9,
        elapsed_s: 30.0,
        device: BTreeMap::from([("PROD".into(), "UTM-30LX".into())]),
        mapper: Mapper::new(MapperSettings::default()).report(),
        poses: PoseCounts { accepted: 7, rejected: BTreeMap::from([("stale", 2)]) },
        queues: BTreeMap::new(),
        decode_errors: BTreeMap::from([("checksum".into(), 1)]),
        input: None,
        recording: None,
        map: MapSummary::of(map),
        settings: serde_json::json!({"a": 1}),
    }
}

fn npy(folder: &Path, name: &str) -> (String, Vec<u8>) {
    let mut zip = zip::ZipArchive::new(fs::File::open(folder.join("map.npz")).unwrap()).unwrap();
    let mut bytes = Vec::new();
    zip.by_name(&format!("{name}.npy")).unwrap().read_to_end(&mut bytes).unwrap();
    assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
    let length = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let header = String::from_utf8(bytes[10..10 + length].to_vec()).unwrap();
    (header.trim_end().to_owned(), bytes[10 + length..].to_vec())
}

#[test]
fn every_file_says_what_the_map_says() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path().join("made/as/needed");
    let mut outputs = Outputs::create(&folder).unwrap();
    outputs.add_pose(1_700_000_000_000_000_001, &pose(1.0, 2.0, 0.0)).unwrap();
    outputs.write(&map(), &report(&map())).unwrap();

    assert_eq!(fs::read(folder.join("map.pgm")).unwrap(), b"P5\n3 2\n255\n\xcd\x00\xfe\xfe\x00\xcd");
    let yaml = fs::read_to_string(folder.join("map.yaml")).unwrap();
    for line in [
        "image: map.pgm",
        "mode: trinary",
        "resolution: 0.050000000",
        "origin: [-1.250000000, 2.500000000, 0.000000000]",
        "free_thresh: 0.196",
    ] {
        assert!(yaml.lines().any(|got| got == line), "{yaml}");
    }

    let (header, data) = npy(&folder, "occupancy");
    assert_eq!(header, "{'descr': '|i1', 'fortran_order': False, 'shape': (2, 3), }");
    assert_eq!(data, [0, 100, 255, 255, 100, 0]);
    assert_eq!(npy(&folder, "visibility").1, [255, 100, 255, 255, 5, 255]);
    assert_eq!(npy(&folder, "resolution").1, 0.05_f64.to_le_bytes());
    assert_eq!(npy(&folder, "origin").1, [(-1.25_f64).to_le_bytes(), 2.5_f64.to_le_bytes()].concat());
    assert_eq!(
        npy(&folder, "hits"),
        ("{'descr': '|u1', 'fortran_order': False, 'shape': (2, 3), }".into(), vec![0, 1, 2, 3, 4, 255])
    );
    let (header, data) = npy(&folder, "start");
    assert!(header.contains("'<u2'"), "{header}");
    assert_eq!(data[4..8], [0, 1, 255, 255]);
    let (header, data) = npy(&folder, "drift");
    assert!(header.contains("'<f4'"), "{header}");
    assert_eq!(data[4..8], (-1.0_f32).to_le_bytes());

    let mut png = png::Decoder::new(std::io::BufReader::new(fs::File::open(folder.join("map.png")).unwrap()))
        .read_info()
        .unwrap();
    let mut pixels = vec![0; png.output_buffer_size().unwrap()];
    let info = png.next_frame(&mut pixels).unwrap();
    let at = |x: usize, y: usize| &pixels[(y * info.width as usize + x) * 3..][..3];
    let (blue, orange) = (at(12, 12), at(12, 4));
    assert!(blue[2] > blue[0], "a narrow view is blue: {blue:?}");
    assert!(orange[0] > orange[2], "a wide one is orange: {orange:?}");
    assert_eq!(at(4, 12), [255, 255, 255]);

    let trajectory = fs::read_to_string(folder.join("trajectory.tum")).unwrap();
    assert!(trajectory.starts_with("1700000000.000000001 1.000000000 2.000000000 "), "{trajectory}");

    let report: serde_json::Value =
        serde_json::from_slice(&fs::read(folder.join("report.json")).unwrap()).unwrap();
    assert_eq!(report["map"]["specular_like"], 1);
    assert_eq!(report["poses"]["rejected"]["stale"], 2);
    assert_eq!(report["decode_errors"]["checksum"], 1);
    assert_eq!(report["insert_us"]["median"], 0.0);
    assert_eq!(report["scans_read"], 0);
    assert_eq!(report["trajectory_poses"], 1);
    for (name, sum) in report["files"].as_object().unwrap() {
        let content = fs::read(folder.join(name)).unwrap();
        assert_eq!(sum["bytes"], content.len(), "{name}");
        assert_eq!(sum["crc32"], format!("{:08x}", crc32fast::hash(&content)), "{name}");
    }
}

#[test]
fn equal_maps_give_equal_files() {
    let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    for folder in &folders {
        Outputs::create(folder.path()).unwrap().write(&map(), &report(&map())).unwrap();
    }
    for name in ["map.pgm", "map.yaml", "map.png", "map.npz"] {
        let [one, two] = folders.each_ref().map(|folder| fs::read(folder.path().join(name)).unwrap());
        assert_eq!(one, two, "{name}");
    }
}

#[test]
fn the_set_is_replaced_while_the_trajectory_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("trajectory.tum"), "of an earlier run\n").unwrap();
    let read = |name: &str| fs::read_to_string(folder.path().join(name)).unwrap();
    let mut outputs = Outputs::create(folder.path()).unwrap();
    assert_eq!(
        read("trajectory.tum"),
        "of an earlier run\n",
        "nothing is touched before there is something to show"
    );
    for generation in 1..=3 {
        outputs.add_pose(generation * 1_000_000_000, &pose(0.0, 0.0, 0.0)).unwrap();
        outputs.write(&map(), &report(&map())).unwrap();
        let shown: serde_json::Value = serde_json::from_str(&read("report.json")).unwrap();
        assert_eq!(shown["generation"], generation);
        assert_eq!(shown["trajectory_poses"], generation);
        assert_eq!(read("trajectory.tum").lines().count(), generation as usize);
    }
    let mut names: Vec<_> = fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert_eq!(names, ["map.npz", "map.pgm", "map.png", "map.yaml", "report.json", "trajectory.tum"]);
}

#[test]
fn a_run_without_a_map_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut outputs = Outputs::create(folder.path()).unwrap();
    outputs.add_pose(1, &pose(0.0, 0.0, 0.0)).unwrap();
    drop(outputs);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn a_folder_that_cannot_be_is_refused_at_the_start() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("file"), "").unwrap();
    let error = Outputs::create(&folder.path().join("file/map")).err().expect("a file is no folder");
    assert!(format!("{error:#}").contains("file/map"), "{error:#}");
}

#[test]
fn a_trajectory_is_put_elsewhere_where_a_loop_was_closed() {
    let folder = tempfile::tempdir().unwrap();
    let mut outputs = Outputs::create(folder.path()).unwrap();
    let poses = || -> Vec<Vec<f64>> {
        let text = fs::read_to_string(folder.path().join("trajectory.tum")).unwrap();
        text.lines().map(|line| line.split(' ').map(|word| word.parse().unwrap()).collect()).collect()
    };
    let places = || -> Vec<[f64; 3]> { poses().iter().map(|line| [line[0], line[1], line[2]]).collect() };
    let moved = |by: f64| Moved::new(vec![(0, pose(by, 0.0, 0.0)), (2_000_000_000, pose(0.0, by, 0.0))]);
    let map = map();

    outputs.add_pose(1_500_000_000, &pose(1.0, 2.0, 0.5)).unwrap();
    outputs.add_pose(2_500_000_000, &pose(3.0, 4.0, -3.0)).unwrap();
    outputs.move_poses(&moved(10.0)).unwrap();
    assert!(!folder.path().join("trajectory.tum").exists(), "not before the first set");
    outputs.add_pose(3_500_000_000, &pose(5.0, 6.0, 0.0)).unwrap();
    outputs.write(&map, &report(&map)).unwrap();
    assert_eq!(places(), [[1.5, 11.0, 2.0], [2.5, 3.0, 14.0], [3.5, 5.0, 6.0]]);
    let yaws: Vec<f64> = poses().iter().map(|line| 2.0 * line[6].atan2(line[7])).collect();
    assert!((yaws[0] - 0.5).abs() < 1e-8 && (yaws[1] + 3.0).abs() < 1e-8, "{yaws:?}");

    outputs.move_poses(&moved(-10.0)).unwrap();
    assert_eq!(places(), [[1.5, 1.0, 2.0], [2.5, 3.0, 4.0], [3.5, 5.0, -4.0]]);
    outputs.add_pose(4_500_000_000, &pose(7.0, 8.0, 0.0)).unwrap();
    outputs.write(&map, &report(&map)).unwrap();
    assert_eq!(places().last(), Some(&[4.5, 7.0, 8.0]));
    let written: serde_json::Value =
        serde_json::from_slice(&fs::read(folder.path().join("report.json")).unwrap()).unwrap();
    assert_eq!(written["trajectory_poses"], 4);
    let left = fs::read_dir(folder.path()).unwrap().count();
    assert_eq!(left, 6, "nothing that was on the way is left");
}
