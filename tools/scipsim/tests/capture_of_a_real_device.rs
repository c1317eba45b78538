//! The simulated UTM-30LX against what a real one answered (folder `scip-captures` of the test data): the same
//! requests get the same replies, but for the firmware, the serial number and the clock.

use scipsim::device::{DeviceSettings, Output, Responder, ScanSource};

struct Nothing;

impl ScanSource for Nothing {
    fn measure(&mut self, _rotation: u64) -> (Vec<u32>, Vec<u32>) {
        (vec![1; 1081], vec![0; 1081])
    }
}

/// Replies, without lines that must differ and without scan data.
fn comparable(stream: &[u8]) -> Vec<Vec<String>> {
    let text: String = stream.iter().map(|&b| b as char).collect();
    let replies = text.split("\n\n").filter(|r| !r.is_empty());
    replies
        .map(|reply| {
            let is_scan = reply.lines().nth(1) == Some("99b");
            let lines = reply.lines().take(if is_scan { 2 } else { usize::MAX });
            let differs = |line: &&str| ["FIRM:", "SERI:", "TIME:"].iter().any(|key| line.starts_with(key));
            lines.filter(|l| !differs(l)).map(str::to_owned).collect()
        })
        .collect()
}

#[test]
fn a_session_of_a_real_utm_30lx_is_answered_alike() {
    let Some(data) = std::env::var_os("VISAGGED_TEST_DATA") else {
        eprintln!("skipped: VISAGGED_TEST_DATA does not name the folder of real recordings");
        return;
    };
    let folder = std::path::Path::new(&data).join("scip-captures/utm_30lx");
    let requests = std::fs::read(folder.join("host_to_dev.bin")).unwrap();
    let real = std::fs::read(folder.join("dev_to_host.bin")).unwrap();
    let mut device = Responder::new(DeviceSettings::default(), Nothing, 0);
    // The real one was on already.
    device.on_received(0, b"BM\n");
    let mut now = 100_000_000;
    let mut ours = Vec::new();
    device.on_time(now);
    while device.next_output(now).is_some() {}
    for request in requests.split_inclusive(|&b| b == b'\n') {
        device.on_received(now, request);
        while let Some(at) = device.deadline_ns() {
            now = at;
            device.on_time(now);
            while let Some(Output::Bytes { bytes, .. }) = device.next_output(now) {
                ours.extend(bytes);
            }
        }
    }
    assert_eq!(comparable(&ours), comparable(&real));
}
