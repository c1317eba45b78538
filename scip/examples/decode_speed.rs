//! How fast scans are decoded: `cargo run --release -p scip --example decode_speed`.

use std::time::Instant;

use scip::{
    Body, Command, Decoder, Echo, Monitor, MonitorOptions, Reply, ScanData, ScanKind, ScanRequest, Status,
};

/// A full scan of a UTM-30LX, 1081 steps.
fn frame(kind: ScanKind) -> Vec<u8> {
    let distances_mm: Vec<u32> = (0..1081).map(|step| 1000 + 7 * step).collect();
    let intensities =
        if kind.has_intensity() { (0..1081).map(|step| step * 13).collect() } else { Vec::new() };
    let data = ScanData { stamp_ms: 4_821_609, distances_mm, intensities, more_echoes: Vec::new() };
    let echo = Echo::Request(Command::Scan(ScanRequest::new(kind, 0, 1080)).into());
    let mut bytes = Vec::new();
    Reply { echo, status: Status::ScanFollows, body: Body::Scan(data) }.emit(&mut bytes);
    bytes
}

fn report(name: &str, bytes: usize, scans: usize, begun: Instant) {
    let seconds = begun.elapsed().as_secs_f64();
    println!(
        "{name}: {:.0} MB/s, {:.2} us a scan",
        bytes as f64 / seconds / 1e6,
        seconds * 1e6 / scans as f64
    );
}

fn main() {
    const SCANS: usize = 60_000;
    for kind in [ScanKind::ME, ScanKind::MD] {
        let frame = frame(kind);
        for chunk in [4096, 64 * 1024] {
            let stream = frame.repeat(100);
            let (begun, mut scans) = (Instant::now(), 0);
            let mut decoder = Decoder::new();
            for _ in 0..SCANS / 100 {
                for bytes in stream.chunks(chunk) {
                    decoder.push(bytes);
                    scans += std::iter::from_fn(|| decoder.decode_next()).filter(Result::is_ok).count();
                }
            }
            assert_eq!(scans, SCANS);
            report(
                &format!("decoder, {} in chunks of {chunk}", kind.name()),
                frame.len() * SCANS,
                SCANS,
                begun,
            );
        }
    }
    let frame = frame(ScanKind::ME);
    let (begun, mut events) = (Instant::now(), 0);
    let mut monitor = Monitor::new(MonitorOptions::default());
    for scan in 0..SCANS {
        monitor.on_received(scan as i64 * 25_000_000, &frame);
        events += std::iter::from_fn(|| monitor.next_event()).count();
    }
    assert!(events >= SCANS);
    report("monitor, ME by whole scans", frame.len() * SCANS, SCANS, begun);
}
