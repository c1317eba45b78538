//! A device in virtual time: what it would send after a request, as fast as it can be computed.

use super::responder::{Output, Responder, ScanSource};

/// What a device sends after `request` (a line without LF) that comes at time 0, until `until_ns`; the bytes and the
/// device they came from.
pub fn capture<S: ScanSource>(
    mut device: Responder<S>,
    request: &str,
    until_ns: i64,
) -> (Vec<u8>, Responder<S>) {
    let mut bytes = Vec::new();
    device.on_received(0, format!("{request}\n").as_bytes());
    while let Some(at) = device.deadline_ns().filter(|&at| at <= until_ns) {
        device.on_time(at);
        while let Some(output) = device.next_output(at) {
            if let Output::Bytes { bytes: more, .. } = output {
                bytes.extend(more);
            }
        }
    }
    (bytes, device)
}
