//! The localizer on drawn rooms: walls as lines, a scanner of half a degree without noise.

use super::*;
use crate::{pose::pose, scan::Geometry};
use nalgebra::Vector2;

type Wall = [[f64; 2]; 2];

/// A room without symmetry: an L with a niche and a pillar.
const ROOM: [Wall; 12] = [
    [[0.0, 0.0], [8.0, 0.0]],
    [[8.0, 0.0], [8.0, 3.0]],
    [[8.0, 3.0], [5.0, 3.0]],
    [[5.0, 3.0], [5.0, 6.0]],
    [[5.0, 6.0], [0.0, 6.0]],
    [[0.0, 6.0], [0.0, 2.5]],
    [[0.0, 2.5], [-0.8, 2.5]],
    [[-0.8, 2.5], [-0.8, 1.5]],
    [[-0.8, 1.5], [0.0, 1.5]],
    [[0.0, 1.5], [0.0, 0.0]],
    [[2.0, 4.0], [2.5, 4.3]],
    [[2.5, 4.3], [2.6, 3.8]],
];
/// Two walls that go on beyond the scanner's range.
const CORRIDOR: [Wall; 2] = [[[-100.0, -1.0], [100.0, -1.0]], [[-100.0, 1.2], [100.0, 1.2]]];
const PERIOD_NS: i64 = 25_000_000;
const BEAMS: usize = 541;

/// The range along a ray.
fn range(walls: &[Wall], from: Vector2<f64>, direction: Vector2<f64>) -> f32 {
    let mut nearest = f64::INFINITY;
    for [a, b] in walls {
        let (a, way) = (Vector2::from(*a), Vector2::from(*b) - Vector2::from(*a));
        let across = direction.perp(&way);
        let (distance, part) = ((a - from).perp(&way) / across, (a - from).perp(&direction) / across);
        if distance > 0.0 && (0.0..=1.0).contains(&part) {
            nearest = nearest.min(distance);
        }
    }
    if nearest < 30.0 { nearest as f32 } else { f32::INFINITY }
}

/// Scan number `seq` of a scanner that moves as `way` says (s to pose); each beam from where it is fired.
fn scan(walls: &[Wall], way: &dyn Fn(f64) -> Pose, seq: u64) -> Scan {
    let stamp_ns = seq as i64 * PERIOD_NS;
    let geometry = Geometry {
        angle_min: -135_f64.to_radians(),
        angle_increment: 0.5_f64.to_radians(),
        time_increment: 0.01875 / (BEAMS - 1) as f64,
        range_min: 0.023,
        range_max: 60.0,
    };
    let ranges = (0..BEAMS)
        .map(|beam| {
            let at = way(stamp_ns as f64 * 1e-9 + beam as f64 * geometry.time_increment);
            let bearing = geometry.angle_min + beam as f64 * geometry.angle_increment;
            let direction = at.rotation * Vector2::new(bearing.cos(), bearing.sin());
            // A centimetre of error, the same in every run.
            let error =
                0.01 * ((seq as f64 * 12.9898 + beam as f64 * 78.233).sin() * 43758.5453).fract() as f32;
            range(walls, at.translation.vector, direction) + error
        })
        .collect();
    Scan { seq, stamp_ns, received_ns: stamp_ns + PERIOD_NS, geometry, ranges, intensities: Vec::new() }
}

/// What odometry says that runs `factor` too far.
fn wheels(way: &dyn Fn(f64) -> Pose, seq: u64, factor: f64) -> Wheels {
    let at = |seconds: f64| {
        let mut pose = way(seconds);
        pose.translation.vector *= factor;
        pose
    };
    let start = seq as f64 * PERIOD_NS as f64 * 1e-9;
    Wheels { start: at(start), end: at(start + 0.01875), reset: 0 }
}

/// A lap of two seconds for each turn at 2 rad/s and more than 1 m/s.
fn circle(seconds: f64) -> Pose {
    // From rest to 2 rad/s within a second.
    let angle = if seconds < 1.0 { seconds * seconds } else { 2.0 * seconds - 1.0 };
    pose(2.5 + 0.6 * angle.sin(), 1.6 - 0.6 * angle.cos(), angle)
}

fn off(located: &Located, truth: &Pose) -> [f64; 2] {
    let error = difference(&located.start, truth);
    [error.xy().norm(), error.z.abs()]
}

/// The way as the map has it that begins at the way's first pose.
fn from_start(way: &dyn Fn(f64) -> Pose, seconds: f64) -> Pose {
    way(0.009375).inverse() * way(seconds)
}

#[test]
fn a_turning_scanner_is_followed_without_odometry_and_with_lost_scans() {
    let mut localizer = Localizer::new(LocalizeSettings::default(), Pose::identity());
    for seq in (0..400).filter(|seq| ![0, 1, 2].contains(&(seq % 41)) || *seq < 41) {
        let located = localizer.locate(&scan(&ROOM, &circle, seq), None);
        let [place, heading] = off(&located, &from_start(&circle, seq as f64 * 0.025));
        assert!(place < 0.02 && heading < 0.006, "scan {seq}: {place} m, {heading} rad");
        assert_eq!(located.doubt, None, "scan {seq}");
    }
    assert_eq!(localizer.tracking(), Tracking::Tracking);
}

#[test]
fn a_person_who_stands_before_it_does_not_move_it() {
    let way = |seconds: f64| pose(1.0 + 0.5 * seconds.min(4.0), 1.2, 0.0);
    let mut localizer = Localizer::new(LocalizeSettings::default(), Pose::identity());
    for seq in 0..240 {
        let mut scan = scan(&ROOM, &way, seq);
        if seq > 80 {
            // A third of all beams, half a metre away, walking along with the scanner and swaying.
            let sway = 0.1 * (seq as f32 * 0.3).sin();
            scan.ranges[180..360].fill(0.5 + sway);
        }
        let located = localizer.locate(&scan, Some(wheels(&way, seq, 1.01)));
        let truth = way(seq as f64 * 0.025);
        let start = wheels(&way, 0, 1.01);
        let begin = interpolate(&start.start, &start.end, 0.5);
        let [place, heading] = off(&located, &(begin * way(0.009375).inverse() * truth));
        assert!(place < 0.03 && heading < 0.01, "scan {seq}: {place} m, {heading} rad");
    }
}

#[test]
fn a_bare_corridor_shows_in_the_covariance() {
    let way = |seconds: f64| pose(0.5 * seconds, 0.0, 0.0);
    let mut localizer = Localizer::new(LocalizeSettings::default(), Pose::identity());
    let mut doubts = 0;
    for seq in 0..400 {
        let located = localizer.locate(&scan(&CORRIDOR, &way, seq), None);
        doubts += usize::from(located.doubt.is_some());
        let [xx, _, _, yy, ..] = located.covariance;
        if seq > 40 && located.doubt != Some(Doubt::Lost) {
            assert!(xx > 25.0 * yy, "scan {seq}: {xx} along, {yy} across");
        }
    }
    assert!(doubts > 100, "nobody knows where in the corridor it is, and {doubts} scans were doubted");

    let mut guided = Localizer::new(LocalizeSettings::default(), Pose::identity());
    for seq in 0..400 {
        let located = guided.locate(&scan(&CORRIDOR, &way, seq), Some(wheels(&way, seq, 1.0)));
        let [place, _] = off(&located, &way(seq as f64 * 0.025));
        assert!(place < 0.1, "scan {seq}: odometry tells it, {place} m");
    }
}

#[test]
fn who_is_carried_off_is_lost_inserts_nothing_wrong_and_finds_back() {
    let mut localizer = Localizer::new(LocalizeSettings::default(), Pose::identity());
    // It looks around in all of the room, and is then put down elsewhere.
    let walk = |seconds: f64| {
        pose(2.5 + 1.5 * (0.7 * seconds).sin(), 1.6 + 0.4 * (0.9 * seconds).sin(), 0.4 * seconds)
    };
    let carried = pose(6.5, 1.0, -1.5);
    let way = move |seconds: f64| if seconds < 20.0 { walk(seconds) } else { carried };
    let mut was_lost = false;
    let mut found_at = None;
    for seq in 0..1300 {
        let located = localizer.locate(&scan(&ROOM, &way, seq), None);
        was_lost |= localizer.tracking() == Tracking::Lost;
        let [place, heading] = off(&located, &from_start(&way, seq as f64 * 0.025));
        if located.doubt.is_none() {
            assert!(place < 0.05 && heading < 0.02, "scan {seq} at a wrong place: {place} m, {heading} rad");
            if was_lost {
                found_at.get_or_insert(seq);
            }
        }
    }
    assert!(was_lost);
    assert!(found_at.is_some_and(|seq| seq < 1200), "{found_at:?}");
}

#[test]
fn the_same_scans_give_the_same_poses_bit_by_bit() {
    let run = || {
        let mut localizer = Localizer::new(LocalizeSettings::default(), pose(0.2, 0.0, 0.1));
        (0..120).map(|seq| localizer.locate(&scan(&ROOM, &circle, seq), None)).collect::<Vec<_>>()
    };
    assert_eq!(format!("{:?}", run()), format!("{:?}", run()));
}

#[test]
fn scans_of_nothing_begin_no_map() {
    let mut localizer = Localizer::new(LocalizeSettings::default(), Pose::identity());
    let mut empty = scan(&ROOM, &circle, 0);
    empty.ranges.fill(f32::INFINITY);
    assert_eq!(localizer.locate(&empty, None).doubt, Some(Doubt::Poor));
    assert_eq!(localizer.tracking(), Tracking::Starting);
    assert_eq!(localizer.locate(&scan(&ROOM, &circle, 1), None).doubt, None);
    assert_eq!(localizer.tracking(), Tracking::Tracking);
}
