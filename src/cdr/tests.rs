//! Literal bytes, round trips, and bytes that are no message.

use proptest::prelude::*;

use super::*;

#[test]
fn a_scip_message_as_literal_bytes() {
    let message = ScipBytes {
        stamp_ns: 2_000_000_003,
        monotonic_ns: 0x0102,
        stream_offset: 7,
        direction: 1,
        data: b"QT\n"[..].into(),
    };
    let bytes = message.encode();
    #[rustfmt::skip]
    assert_eq!(bytes, [
        0, 1, 0, 0,
        2, 0, 0, 0,  3, 0, 0, 0, // stamp
        2, 1, 0, 0, 0, 0, 0, 0, // monotonic_ns
        7, 0, 0, 0, 0, 0, 0, 0, // stream_offset
        1, 0, 0, 0, // direction, padding
        3, 0, 0, 0, b'Q', b'T', b'\n',
    ]);
    assert_eq!(ScipBytes::borrow(&bytes), Ok(message));
}

#[test]
fn strings_end_with_nul_and_numbers_are_aligned_behind_them() {
    let scan = LaserScan {
        header: Header { stamp_ns: 1, frame_id: "laser".into() },
        angle_min: 1.0,
        ranges: vec![f32::INFINITY],
        ..LaserScan::default()
    };
    let bytes = scan.encode();
    #[rustfmt::skip]
    assert_eq!(bytes[..32], [
        0, 1, 0, 0,
        0, 0, 0, 0,  1, 0, 0, 0,
        6, 0, 0, 0,  b'l', b'a', b's', b'e', b'r', 0, 0, 0,
        0, 0, 0x80, 0x3f, // 1.0
        0, 0, 0, 0,
    ]);
    assert_eq!(bytes[52..], [1, 0, 0, 0, 0, 0, 0x80, 0x7f, 0, 0, 0, 0]);
    // 8-byte numbers are aligned from behind the encapsulation header, not from the message's start.
    let odometry = PoseReceived { reset: 9, has_covariance: true, ..PoseReceived::default() }.encode();
    assert_eq!(odometry.len(), 4 + 24 + 8 + 10 * 8);
}

#[test]
fn times_before_1970_and_behind_2038_are_no_panic() {
    for (ns, back) in [(-1, -1), (i64::MAX, 2_147_483_647_000_000_000 + i64::MAX % 1_000_000_000)] {
        let bytes = ScipBytes { stamp_ns: ns, ..ScipBytes::default() }.encode();
        assert_eq!(ScipBytes::borrow(&bytes).unwrap().stamp_ns, back);
    }
}

#[test]
fn bad_messages_say_what_and_where() {
    assert_eq!(LaserScan::decode(&[0, 1]), Err(CdrError::Cut { at: 0, need: 4, left: 2 }));
    assert_eq!(LaserScan::decode(&[0, 0, 0, 0]), Err(CdrError::Encapsulation(0)));
    let mut bytes = ScipBytes { data: vec![1; 4].into(), ..ScipBytes::default() }.encode();
    bytes[32..36].copy_from_slice(&u32::MAX.to_le_bytes());
    assert_eq!(ScipBytes::decode(&bytes), Err(CdrError::Cut { at: 36, need: u32::MAX as usize, left: 4 }));
    let text = [0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 2, 0, 0, 0, 0xff, 0];
    assert_eq!(LaserScan::decode(&text), Err(CdrError::Text { at: 16 }));
}

prop_compose! {
    fn header()(stamp_ns in 0..4_000_000_000_000_000_i64, frame_id in "[a-z_/]{0,12}") -> Header {
        Header { stamp_ns, frame_id }
    }
}
prop_compose! {
    fn transform()(translation: [f64; 3], rotation: [f64; 4]) -> Transform {
        Transform { translation, rotation }
    }
}
prop_compose! {
    fn laser_scan()(header in header(), angles: [f32; 7], ranges: Vec<f32>, intensities: Vec<f32>) -> LaserScan {
        let [angle_min, angle_max, angle_increment, time_increment, scan_time, range_min, range_max] = angles;
        LaserScan {
            header, angle_min, angle_max, angle_increment, time_increment, scan_time, range_min, range_max, ranges,
            intensities,
        }
    }
}
prop_compose! {
    fn stamped()(header in header(), child_frame_id in "[a-z]{0,9}", transform in transform()) -> TransformStamped {
        TransformStamped { header, child_frame_id, transform }
    }
}
prop_compose! {
    fn odometry()(
        header in header(), child_frame_id in "[a-z]{0,9}", pose in transform(),
        pose_covariance in prop::array::uniform32(any::<f64>()), twist: [f64; 6],
    ) -> Odometry {
        let mut covariance = [0.5; 36];
        covariance[..32].copy_from_slice(&pose_covariance);
        Odometry { header, child_frame_id, pose, pose_covariance: covariance, twist, twist_covariance: [0.0; 36] }
    }
}
prop_compose! {
    fn grid()(header in header(), resolution: f32, width: u32, height: u32, origin in transform(), data: Vec<i8>)
    -> OccupancyGrid {
        OccupancyGrid { map_load_time_ns: header.stamp_ns, header, resolution, width, height, origin, data }
    }
}
prop_compose! {
    fn status()(level: u8, name in ".{0,9}", message in ".{0,9}", hardware_id in "[a-z]{0,3}",
                values in prop::collection::vec((".{0,5}", ".{0,5}"), 0..4)) -> DiagnosticStatus {
        DiagnosticStatus { level, name, message, hardware_id, values }
    }
}

/// Decodes to the same, and every cut of it is an error or (where only the end of a padding is gone) the same.
fn round_trip<M: Message + PartialEq + std::fmt::Debug>(message: &M) -> Result<(), TestCaseError> {
    let bytes = message.encode();
    let decoded = M::decode(&bytes);
    prop_assert_eq!(decoded.as_ref(), Ok(message));
    for cut in 0..bytes.len() {
        prop_assert!(M::decode(&bytes[..cut]).is_err(), "cut at {} of {}", cut, bytes.len());
    }
    Ok(())
}

proptest! {
    #[test]
    fn laser_scans_come_back(message in laser_scan()) { round_trip(&message)?; }

    #[test]
    fn transforms_come_back(transforms in prop::collection::vec(stamped(), 0..4)) {
        round_trip(&TfMessage { transforms })?;
    }

    #[test]
    fn odometry_comes_back(message in odometry()) { round_trip(&message)?; }

    #[test]
    fn grids_come_back(message in grid()) { round_trip(&message)?; }

    #[test]
    fn diagnostics_come_back(header in header(), status in prop::collection::vec(status(), 0..3)) {
        round_trip(&DiagnosticArray { header, status })?;
    }

    #[test]
    fn poses_come_back(ns: [i64; 2], scans_before: u64, reset: u32, has_covariance: bool, pose: [f64; 4],
                       covariance: [f64; 6]) {
        let [stamp_ns, received_ns] = ns;
        round_trip(&PoseReceived { stamp_ns, received_ns, scans_before, reset, has_covariance, pose, covariance })?;
    }

    #[test]
    fn tasks_come_back(scans_before: u64) { round_trip(&TaskDone { scans_before })?; }

    #[test]
    fn scip_bytes_come_back(stamp_ns in 0..4_000_000_000_000_000_i64, monotonic_ns: u64, stream_offset: u64,
                            direction: u8, data: Vec<u8>) {
        round_trip(&ScipBytes { stamp_ns, monotonic_ns, stream_offset, direction, data: data.into() })?;
    }

    #[test]
    fn random_bytes_are_no_panic(mut bytes: Vec<u8>) {
        if bytes.len() >= 4 {
            bytes[..4].copy_from_slice(&[0, 1, 0, 0]);
        }
        let _ = LaserScan::decode(&bytes);
        let _ = TfMessage::decode(&bytes);
        let _ = Odometry::decode(&bytes);
        let _ = OccupancyGrid::decode(&bytes);
        let _ = DiagnosticArray::decode(&bytes);
        let _ = ScipBytes::decode(&bytes);
        let _ = PoseReceived::decode(&bytes);
        let _ = TaskDone::decode(&bytes);
    }
}
