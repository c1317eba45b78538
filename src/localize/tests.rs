//! The localizer on drawn rooms: walls as lines, a scanner of half a degree without noise.

use super::*;
use crate::{pose::pose, scan::Geometry};
use nalgebra::Vector2;

pub(crate) type Wall = [[f64; 2]; 2];

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
pub(crate) fn scan(walls: &[Wall], way: &dyn Fn(f64) -> Pose, seq: u64) -> Scan {
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
        assert!(place < 0.02 && heading < 0.005, "scan {seq}: {place} m, {heading} rad");
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
fn a_standard_grid_can_be_matched_with_for_comparison() {
    let settings = LocalizeSettings { reference: Reference::Standard, ..LocalizeSettings::default() };
    let mut localizer = Localizer::new(settings, Pose::identity());
    for seq in 0..160 {
        let located = localizer.locate(&scan(&ROOM, &circle, seq), None);
        let [place, heading] = off(&located, &from_start(&circle, seq as f64 * 0.025));
        assert!(place < 0.1 && heading < 0.03, "scan {seq}: {place} m, {heading} rad");
    }
    assert_eq!(localizer.tracking(), Tracking::Tracking);
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

#[test]
fn what_was_moved_is_found_where_it_is_now() {
    let way = |seconds: f64| pose(1.0 + seconds, 1.2, 0.0);
    let settings = LocalizeSettings { submap_way: 1.0, ..LocalizeSettings::default() };
    let mut localizer = Localizer::new(settings, Pose::identity());
    for seq in 0..100 {
        localizer.locate(&scan(&ROOM, &way, seq), None);
    }
    assert_eq!(localizer.former.len(), 2);
    let mut unmoved = Localizer::new(localizer.settings.clone(), Pose::identity());
    (0..100).for_each(|seq| _ = unmoved.locate(&scan(&ROOM, &way, seq), None));
    // The later something was, the farther it has moved.
    let later = |stamp_ns: i64| pose(0.0, 1e-9 * stamp_ns.clamp(0, 3_000_000_000) as f64, 0.5);
    localizer.on_moved(later);
    let next = scan(&ROOM, &way, 100);
    let (found, before) = (localizer.locate(&next, None), unmoved.locate(&next, None));
    assert!(difference(&found.start, &(pose(0.0, 3.0, 0.5) * before.start)).norm() < 1e-9);
    let spread = |[xx, xy, _, yy, _, aa]: [f64; 6]| [xx + yy, xx * yy - xy * xy, aa];
    for (a, b) in spread(found.covariance).into_iter().zip(spread(before.covariance)) {
        assert!((a - b).abs() < 1e-6 * b, "the same deviations in other directions");
    }
    let frames: Vec<f64> = localizer.former.iter().map(|former| former.frame.translation.y).collect();
    let since: Vec<f64> =
        localizer.former.iter().map(|former| later(former.since_ns).translation.y).collect();
    assert_eq!(frames, since);
    assert!(frames[0] < 0.01 && (0.9..1.2).contains(&frames[1]), "{frames:?}");
}

/// A ring of corridors, 16 m by 12 m, with a niche or pillar here and there, none like another.
pub(crate) fn ring() -> Vec<Wall> {
    let rectangle = |[x0, y0]: [f64; 2], [x1, y1]: [f64; 2]| {
        [[[x0, y0], [x1, y0]], [[x1, y0], [x1, y1]], [[x1, y1], [x0, y1]], [[x0, y1], [x0, y0]]]
    };
    let mut walls: Vec<Wall> = Vec::new();
    walls.extend(rectangle([0.0, 0.0], [16.0, 12.0]));
    walls.extend(rectangle([2.2, 2.2], [13.8, 9.8]));
    for (at, size) in [
        ([3.0, 0.0], [0.5, 0.3]),
        ([8.0, 0.0], [1.2, 0.2]),
        ([13.0, 1.9], [0.3, 0.3]),
        ([15.6, 4.0], [0.4, 0.9]),
        ([13.8, 7.0], [0.3, 0.4]),
        ([11.0, 11.5], [0.7, 0.5]),
        ([5.5, 9.8], [0.4, 0.4]),
        ([0.0, 8.0], [0.3, 1.5]),
        ([1.9, 4.5], [0.3, 0.6]),
    ] {
        let [x, y]: [f64; 2] = at;
        let [w, h]: [f64; 2] = size;
        walls.extend(rectangle([x, y], [x + w, y + h]));
    }
    walls
}

/// Round the ring, a lap in 44 m.
fn round(way: f64) -> Pose {
    const SIDES: [f64; 4] = [13.0, 9.0, 13.0, 9.0];
    let (mut way, mut at) = (way.rem_euclid(44.0), pose(1.5, 1.2, 0.0));
    for side in SIDES {
        if way <= side {
            return at * pose(way, 0.0, 0.0);
        }
        way -= side;
        at *= pose(side, 0.0, std::f64::consts::FRAC_PI_2);
    }
    at
}

/// Drives round and a third, located with this much drift a metre, and says what loops there are and how far out the poses
/// are, before and after.
fn driven_round(drift: Pose) -> (loops::Loops, [f64; 2]) {
    let walls = ring();
    let mut drive = loops::Drive::default();
    let mut located = Vec::new();
    let mut at = round(0.0);
    for step in 0..600 {
        let truth = round(f64::from(step) * 0.1);
        if step > 0 {
            let before = round(f64::from(step - 1) * 0.1);
            at *= before.inverse() * truth * pose(drift.translation.x, 0.0, drift.rotation.angle());
        }
        let scan = scan(&walls, &|_| truth, step as u64);
        let way = drive.add(&at, || {
            let mut points = Points::default();
            points.read(&scan, Pose::identity(), Pose::identity(), 0.08, 400);
            points
        });
        located.push((way, at, truth));
    }
    let found = drive.close(None);
    let worst = |correct: &dyn Fn(f64, &Pose) -> Pose| {
        located
            .iter()
            .map(|(way, at, truth)| difference(&correct(*way, at), truth).xy().norm())
            .fold(0.0, f64::max)
    };
    let before = worst(&|_, at| *at);
    let after = match &found {
        loops::Loops::Bent(correction) => worst(&|way, at| correction.correct(way, at)),
        _ => before,
    };
    (found, [before, after])
}

#[test]
fn a_drive_that_comes_back_out_of_place_is_bent_together() {
    let (found, [before, after]) = driven_round(pose(0.0002, 0.0, 0.0006));
    let loops::Loops::Bent(correction) = found else { panic!("{found}") };
    assert!(before > 2.0 && after < before / 5.0, "{before} m before, {after} m after");
    assert!(correction.left[0] < 0.1 && correction.left[1] < 0.02, "{:?}", correction.left);
}

#[test]
fn a_drive_that_is_good_is_not_touched() {
    let (found, [_, after]) = driven_round(pose(0.0, 0.0, 0.0));
    assert!(matches!(found, loops::Loops::Good { closures: 3.., .. }), "{found}");
    assert!(after < 1e-9);
}

#[test]
fn what_looks_alike_but_is_not_the_same_closes_nothing() {
    // Two walls and nothing else: every part looks like every other.
    let mut drive = loops::Drive::default();
    for step in 0..500 {
        let at = pose(f64::from(step) * 0.1, 0.0, 0.0);
        let scan = scan(&CORRIDOR, &|_| at, step as u64);
        drive.add(&at, || {
            let mut points = Points::default();
            points.read(&scan, Pose::identity(), Pose::identity(), 0.08, 400);
            points
        });
    }
    let found = drive.close(None);
    assert!(!matches!(found, loops::Loops::Bent(_)), "{found}");
}
