//! A device in real time: on a pty and on TCP, with its poses. Waits for what must come, never for a time.

use std::fs::OpenOptions;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::time::{Duration, Instant};

use scipsim::device::{Port, SpawnOptions, Transport, spawn};
use scipsim::pose_message::PoseAddress;
use scipsim::{Simulation, SimulationOptions, World};

/// Longer than anything here takes, even on a busy machine.
const PATIENCE: Duration = Duration::from_secs(20);

fn read_until(source: &mut impl Read, end: impl Fn(&[u8]) -> bool) -> Vec<u8> {
    let (start, mut all, mut buffer) = (Instant::now(), Vec::new(), [0; 4096]);
    while !end(&all) {
        assert!(start.elapsed() < PATIENCE, "only {:?}", String::from_utf8_lossy(&all));
        let count = source.read(&mut buffer).unwrap();
        all.extend(&buffer[..count]);
    }
    all
}

fn frames(bytes: &[u8]) -> usize {
    bytes.windows(5).filter(|w| w == b"\n99b\n").count()
}

fn open(path: &Path) -> std::fs::File {
    OpenOptions::new().read(true).write(true).open(path).unwrap()
}

#[test]
fn a_pty_serves_scans_again_after_it_was_closed() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("tty");
    let mut options = SpawnOptions::from_url("sim:room").unwrap();
    options.transport = Transport::Pty { link: Some(link.clone()) };
    let running = spawn(options).unwrap();
    assert_eq!(running.port(), &Port::Pty(link.clone()));
    assert_eq!(running.drive_start_ns(), None);
    {
        let mut client = open(&link);
        client.write_all(b"VV\n").unwrap();
        let answer = read_until(&mut client, |b| b.ends_with(b"\n\n"));
        assert!(answer.starts_with(b"VV\n00P\nVEND:"));
        client.write_all(b"ME0000108001000\n").unwrap();
        read_until(&mut client, |b| frames(b) >= 5);
    }
    let mut again = open(&link);
    again.write_all(b"\nQT\n").unwrap();
    read_until(&mut again, |b| b.ends_with(b"QT\n00P\n\n"));
    again.write_all(b"ME0000108001003\n").unwrap();
    let all = read_until(&mut again, |b| frames(b) == 3 && b.ends_with(b"\n\n"));
    assert_eq!(all.len(), 21 + 3 * 6717);
    assert!(running.drive_start_ns().is_some() && !running.finished());
    running.stop();
    assert!(!link.exists());
}

#[test]
fn over_tcp_the_first_scan_is_that_of_the_simulation_and_poses_come() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("poses");
    let poses = UnixDatagram::bind(&path).unwrap();
    poses.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut options =
        SpawnOptions::from_url("sim:room?seed=9&transport=tcp&profile=ethernet&poses=wheels").unwrap();
    options.poses_to = Some(PoseAddress::Unix(path));
    let running = spawn(options).unwrap();
    let Port::Tcp(address) = *running.port() else { panic!("{}", running.port()) };
    let mut client = TcpStream::connect(address).unwrap();
    client.write_all(b"MD0000108000001\r\n").unwrap();
    let all = read_until(&mut client, |b| frames(b) == 1 && b.ends_with(b"\n\n"));
    let world = World::load("room").unwrap();
    let first = Simulation::new(&world, SimulationOptions { seed: 9, ..Default::default() }).scan_at(0);
    let mut expected = Vec::new();
    scip::number::encode(first.distances_mm[0], 3, &mut expected);
    // Acknowledgement, echo, status, stamp, then the first distance.
    let data = 21 + 16 + 4 + 6;
    assert_eq!(&all[data..data + 3], &expected[..]);
    let mut buffer = [0; 1000];
    let count = poses.recv(&mut buffer).unwrap();
    let pose: serde_json::Value = serde_json::from_slice(&buffer[..count]).unwrap();
    assert_eq!((&pose["class"], &pose["source"]), (&"POSE".into(), &"wheel".into()));
    assert!((pose["x"].as_f64().unwrap() - 1.2).abs() < 0.01);
}

#[test]
fn a_device_that_drops_out_comes_back_behind_its_link() {
    let options = SpawnOptions::from_url("sim:room?disconnect=0.3&fault-seed=2").unwrap();
    let running = spawn(options).unwrap();
    let path = running.port().path().unwrap().to_path_buf();
    let first = std::fs::read_link(&path).unwrap();
    let mut client = open(&path);
    client.write_all(b"ME0000108001000\n").unwrap();
    // The old pty hangs up: its reads fail or end.
    let mut buffer = [0; 4096];
    while client.read(&mut buffer).is_ok_and(|n| n > 0) {}
    drop(client);
    let start = Instant::now();
    while std::fs::read_link(&path).is_ok_and(|now| now == first) || !path.exists() {
        assert!(start.elapsed() < PATIENCE);
        std::thread::yield_now();
    }
    let mut again = open(&path);
    again.write_all(b"\nQT\n").unwrap();
    assert!(again.read(&mut buffer).is_ok());
}
