//! Captures of real devices, and of an independent encoder, decode to the values that others read from
//! them. The files are not part of this repository: set VISAGGED_TEST_DATA to the folder that holds
//! `scip-captures`, or these tests say that they were skipped.

use std::path::PathBuf;

use scip::{
    Body, ClockSource, Command, Decoder, Echo, Event, Monitor, MonitorOptions, Reply, Scan, ScanData, Status,
};

fn capture(name: &str) -> Option<Vec<u8>> {
    let Some(data) = std::env::var_os("VISAGGED_TEST_DATA") else {
        println!("skipped: VISAGGED_TEST_DATA is not set, {name} is not read");
        return None;
    };
    let path = PathBuf::from(data).join("scip-captures").join(name);
    Some(std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display())))
}

fn decode(bytes: &[u8]) -> Vec<Reply> {
    let mut decoder = Decoder::new();
    decoder.push(bytes);
    let replies =
        std::iter::from_fn(|| decoder.decode_next()).map(|outcome| outcome.expect("all sums are good").reply);
    let replies: Vec<Reply> = replies.collect();
    assert_eq!(decoder.cut(), None, "the capture ends with a whole reply");
    replies
}

fn scan_data(reply: &Reply) -> Option<&ScanData> {
    match &reply.body {
        Body::Scan(data) => Some(data),
        _ => None,
    }
}

/// Time stamp and columns of an expected CSV.
fn expected(csv: &[u8]) -> (u32, Vec<Vec<u32>>) {
    let text = std::str::from_utf8(csv).unwrap();
    let head = text.lines().next().unwrap();
    let stamp = head.split("timestamp_ms=").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    let mut columns = vec![Vec::new(); text.lines().nth(1).unwrap().split(',').count()];
    for line in text.lines().skip(2) {
        for (column, value) in columns.iter_mut().zip(line.split(',')) {
            column.push(value.parse().unwrap());
        }
    }
    (stamp, columns)
}

fn compare(folder: &str, frame: &str) {
    let Some(csv) = capture(&format!("{folder}/{frame}_frame_expected.csv")) else { return };
    let (stamp_ms, columns) = expected(&csv);
    for file in [format!("{folder}/{frame}_frame.bin"), format!("{folder}/dev_to_host.bin")] {
        let replies = decode(&capture(&file).unwrap());
        let data = replies.iter().find_map(scan_data).expect("a scan");
        assert_eq!(data.stamp_ms, stamp_ms, "{file}");
        assert_eq!(data.distances_mm, columns[1], "{file}");
        assert_eq!(data.intensities, columns.get(2).cloned().unwrap_or_default(), "{file}");
    }
}

#[test]
fn frames_of_three_real_devices() {
    compare("utm_30lx", "me");
    compare("urg_04lx", "gd");
    compare("uxm_30lx_e", "gd");
}

#[test]
fn every_capture_is_emitted_as_it_was() {
    for file in [
        "utm_30lx/dev_to_host.bin",
        "urg_04lx/dev_to_host.bin",
        "uxm_30lx_e/dev_to_host.bin",
        "urg_sim_encoder/commands_dev_to_host.bin",
        "urg_sim_encoder/me_full_3scans.bin",
        "urg_sim_encoder/me_cluster3_skip1_2scans_tag.bin",
        "urg_sim_encoder/md_window_2scans.bin",
    ] {
        let Some(bytes) = capture(file) else { return };
        let mut out = Vec::new();
        decode(&bytes).iter().for_each(|reply| reply.emit(&mut out));
        // A sum that leaves out the text behind `<-` is emitted over the whole line.
        let text = |bytes: &[u8]| -> Vec<String> {
            let lines = bytes.split(|&byte| byte == b'\n');
            let without_sum = |line: &[u8]| match line.windows(2).any(|pair| pair == b"<-") {
                true => line[..line.len() - 1].escape_ascii().to_string(),
                false => line.escape_ascii().to_string(),
            };
            lines.map(without_sum).collect()
        };
        assert_eq!(text(&out), text(&bytes), "{file}");
    }
}

#[test]
fn the_independent_encoder() {
    for (file, cluster, scans) in [
        ("urg_sim_encoder/me_full_3scans.bin", 1, 3),
        ("urg_sim_encoder/me_cluster3_skip1_2scans_tag.bin", 3, 2),
        ("urg_sim_encoder/md_window_2scans.bin", 1, 2),
    ] {
        let Some(bytes) = capture(file) else { return };
        let replies = decode(&bytes);
        let data: Vec<&ScanData> = replies.iter().filter_map(scan_data).collect();
        assert_eq!(data.len(), scans, "{file}");
        let Echo::Request(request) = &replies[1].echo else { panic!("{file}") };
        let Command::Scan(scan) = request.command else { panic!("{file}") };
        for data in data {
            // The encoder's formula; k is the number of the scan, of which each value carries the last digit.
            let k = data.distances_mm[0] - 1000 - 10 * u32::from(scan.start);
            for (index, &distance) in data.distances_mm.iter().enumerate() {
                let step = u32::from(scan.start) + index as u32 * cluster;
                assert_eq!(distance, 1000 + 10 * step + k, "{file} step {step}");
            }
            if scan.kind.has_intensity() {
                let k18 = data.intensities[0];
                for (index, &intensity) in data.intensities.iter().enumerate() {
                    assert_eq!(intensity, (241 * index as u32 * cluster + k18) & 0x3_ffff, "{file}");
                }
            }
        }
    }
}

#[test]
fn commands_of_the_independent_encoder() {
    let Some(bytes) = capture("urg_sim_encoder/commands_dev_to_host.bin") else { return };
    let statuses: Vec<Status> = decode(&bytes).iter().map(|reply| reply.status).collect();
    use Status::{Done, General, Refused};
    let refusals = [General(b'E'), General(b'C'), Refused(4), Refused(5)];
    assert_eq!(statuses[..8], [Done; 8]);
    assert_eq!(statuses[8..], refusals);
}

#[test]
fn numbers_and_sums_of_the_specification() {
    let Some(csv) = capture("spec_examples.csv") else { return };
    let text = String::from_utf8(csv).unwrap();
    for line in text.lines().skip(1) {
        let (kind, rest) = line.split_once(',').unwrap();
        let (chars, value) = rest.rsplit_once(',').unwrap();
        match kind {
            "sum" | "sum_line" => assert_eq!(scip::number::checksum(chars.as_bytes()), value.as_bytes()[0]),
            _ => assert_eq!(scip::number::decode(chars.as_bytes()), value.parse().ok()),
        }
    }
}

/// Chunks of a timeline: time (ns), whether the device sent it, bytes.
fn timeline(folder: &str) -> Option<Vec<(i64, bool, Vec<u8>)>> {
    let csv = String::from_utf8(capture(&format!("{folder}/timeline.csv"))?).unwrap();
    let mut sides = [
        capture(&format!("{folder}/host_to_dev.bin"))?.into_iter(),
        capture(&format!("{folder}/dev_to_host.bin"))?.into_iter(),
    ];
    let chunk = |line: &str| {
        let mut cells = line.split(',');
        let first_us: i64 = cells.next().unwrap().parse().unwrap();
        let from_device = cells.nth(1).unwrap() == "DEV>HOST";
        let len = cells.next().unwrap().parse().unwrap();
        (first_us * 1000, from_device, sides[usize::from(from_device)].by_ref().take(len).collect())
    };
    Some(csv.lines().skip(1).map(chunk).collect())
}

fn watch(options: MonitorOptions, folder: &str) -> Option<(Monitor, Vec<Event>)> {
    let mut monitor = Monitor::new(options);
    for (at_ns, from_device, bytes) in timeline(folder)? {
        if from_device { monitor.on_received(at_ns, &bytes) } else { monitor.on_sent(at_ns, &bytes) }
    }
    let events = std::iter::from_fn(|| monitor.next_event()).collect();
    Some((monitor, events))
}

fn scans(events: &[Event]) -> Vec<&Scan> {
    let scans = events.iter().filter_map(|event| match event {
        Event::Scan(scan) => Some(scan),
        _ => None,
    });
    scans.collect()
}

#[test]
fn a_monitor_of_a_real_utm_30lx() {
    let Some((monitor, events)) = watch(MonitorOptions::default(), "utm_30lx") else { return };
    let device = monitor.device();
    assert_eq!(device.serial_number(), Some("00903971"));
    assert_eq!(device.firmware(), Some("P.1.05(17/Apr./2009)"));
    assert_eq!((device.laser_on(), device.is_healthy()), (Some(true), Some(true)));
    assert_eq!(
        device.parameters.as_ref().map(|pp| (pp.min_mm, pp.last_step, pp.rpm)),
        Some((23, 1080, 2400))
    );
    let scans = scans(&events);
    assert_eq!(scans.len(), 1);
    assert_eq!(scans[0].unwrapped_ms, 4_821_609);
    // No TM rounds: the stamp lies the nominal 23.5 ms before the first byte.
    assert_eq!(scans[0].first_byte_ns - scans[0].stamp_ns, 23_500_000);
    let options = MonitorOptions { clock: ClockSource::Device, ..MonitorOptions::default() };
    let (_, events) = watch(options, "utm_30lx").unwrap();
    assert_eq!(self::scans(&events)[0].stamp_ns, 4_821_609_000_000);
}

#[test]
fn clock_rounds_of_a_real_uxm_30lx_e() {
    let Some((_, events)) = watch(MonitorOptions::default(), "uxm_30lx_e") else { return };
    let found = events.iter().find_map(|event| match event {
        Event::Synchronised(sync) => Some(*sync),
        _ => None,
    });
    let sync = found.expect("TM2 ends the rounds");
    assert!(sync.rounds >= 9 && sync.fastest_ns < 1_100_000, "{sync:?}");
    assert!(sync.uncertainty_ns <= 1_000_000, "{sync:?}");
}

#[test]
fn a_real_urg_04lx_in_scip_1_1() {
    let Some((monitor, events)) = watch(MonitorOptions::default(), "urg_04lx_scip11_switch") else { return };
    let replies: Vec<&Reply> = events
        .iter()
        .filter_map(|event| match event {
            Event::Reply(reply) => Some(reply),
            _ => None,
        })
        .collect();
    let switch = replies.iter().find(|reply| reply.request().is_some_and(|r| r.command == Command::Scip2));
    assert_eq!(switch.unwrap().status, Status::Scip1(b'0'));
    assert_eq!(monitor.device().parameters.as_ref().unwrap().codes, scip::Codes::Urg);
}
