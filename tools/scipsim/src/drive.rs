//! A way through the plane and when each point of it is passed: the robot's drive, a person's walk.

use std::f64::consts::TAU;

use nalgebra::{Isometry2, UnitComplex};

use crate::geometry::{Vector, angle_difference, heading};

/// A pose in the plane (m, rad).
pub type Pose = Isometry2<f64>;

/// A pose from its parts (m, m, rad).
pub fn pose(x: f64, y: f64, yaw: f64) -> Pose {
    Pose::from_parts(Vector::new(x, y).into(), UnitComplex::new(yaw))
}

/// How a way is travelled.
#[derive(Clone, Copy, Debug)]
pub struct Gait {
    /// Speed on straight parts (m/s).
    pub speed: f64,
    /// Highest turning rate (rad/s).
    pub turn_rate: f64,
    /// Highest change of speed (m/s2).
    pub acceleration: f64,
    /// Radius of the arcs that replace corners (m), smaller where legs are short.
    pub corner_radius: f64,
}

/// A stop on the way.
#[derive(Clone, Copy, Debug)]
pub struct Stop {
    /// Number of the waypoint.
    pub waypoint: usize,
    /// How long (s).
    pub seconds: f64,
}

#[derive(Clone, Copy, Debug)]
struct Knot {
    time: f64,
    at: Vector,
    yaw: f64,
    /// Way travelled, with turns counted as half a metre a radian.
    way: f64,
}

/// Spacing of the stored points (m).
const STEP: f64 = 0.02;
/// Corners sharper than this are turned on the spot (rad).
const TURN_ON_SPOT: f64 = 2.4;
/// Metres of way that a radian of turning counts as, for errors that grow with the way.
const WAY_PER_RADIAN: f64 = 0.5;

/// A way with its timing; starts at time 0.
#[derive(Clone, Debug)]
pub struct Drive {
    knots: Vec<Knot>,
}

impl Drive {
    /// A drive through `waypoints`, `closed` if it returns to the first and is done `laps` times. With a single
    /// waypoint it stands there, looking along `yaw` (rad). `stops` name waypoints of the first lap.
    pub fn new(
        waypoints: &[Vector],
        closed: bool,
        laps: usize,
        yaw: f64,
        stops: &[Stop],
        gait: Gait,
    ) -> Drive {
        let mut ring = Vec::new();
        for lap in 0..laps.max(1) {
            let skip = usize::from(lap > 0 && !closed);
            ring.extend_from_slice(&waypoints[skip.min(waypoints.len())..]);
        }
        if closed && waypoints.len() > 1 {
            ring.push(waypoints[0]);
        }
        let (points, marks) = smooth(&ring, gait.corner_radius);
        let mut builder = Builder::new(points[0], first_yaw(&points).unwrap_or(yaw));
        let halts: Vec<usize> = stops.iter().filter_map(|s| marks.get(s.waypoint).copied()).collect();
        for stop in stops.iter().filter(|s| marks.get(s.waypoint) == Some(&0)) {
            builder.wait(stop.seconds);
        }
        let mut start = 0;
        while start + 1 < points.len() {
            // A stretch goes up to the next stop or sharp corner.
            let mut end = start + 1;
            while end + 1 < points.len() && !halts.contains(&end) && !is_sharp(&points, end) {
                end += 1;
            }
            builder.turn_to(yaw_between(points[start], points[start + 1]), gait.turn_rate);
            builder.stretch(&points[start..=end], gait);
            for (stop, _) in stops.iter().zip(&halts).filter(|&(_, &halt)| halt == end) {
                builder.wait(stop.seconds);
            }
            start = end;
        }
        Drive { knots: builder.knots }
    }

    /// The same drive, left `seconds` later.
    pub fn delayed(mut self, seconds: f64) -> Drive {
        if seconds > 0.0 {
            let first = self.knots[0];
            for knot in &mut self.knots {
                knot.time += seconds;
            }
            self.knots.insert(0, first);
        }
        self
    }

    /// How long it takes (s).
    pub fn duration(&self) -> f64 {
        self.knots[self.knots.len() - 1].time
    }

    /// Pose at `time` (s); before the start and after the end it stands.
    pub fn pose(&self, time: f64) -> Pose {
        let (a, b, t) = self.between(time);
        let at = a.at + (b.at - a.at) * t;
        pose(at.x, at.y, a.yaw + angle_difference(b.yaw, a.yaw) * t)
    }

    /// Way travelled at `time` (m), turns on the spot counted too.
    pub fn way(&self, time: f64) -> f64 {
        let (a, b, t) = self.between(time);
        a.way + (b.way - a.way) * t
    }

    fn between(&self, time: f64) -> (&Knot, &Knot, f64) {
        let next = self.knots.partition_point(|k| k.time <= time);
        if next == 0 {
            return (&self.knots[0], &self.knots[0], 0.0);
        }
        let a = &self.knots[next - 1];
        match self.knots.get(next) {
            None => (a, a, 0.0),
            Some(b) => (a, b, (time - a.time) / (b.time - a.time)),
        }
    }
}

/// Builds the list of knots one movement after the other.
struct Builder {
    knots: Vec<Knot>,
}

impl Builder {
    fn new(at: Vector, yaw: f64) -> Builder {
        Builder { knots: vec![Knot { time: 0.0, at, yaw, way: 0.0 }] }
    }

    fn last(&self) -> Knot {
        self.knots[self.knots.len() - 1]
    }

    fn push(&mut self, seconds: f64, at: Vector, yaw: f64) {
        if seconds > 0.0 {
            let last = self.last();
            let way = (at - last.at).norm() + WAY_PER_RADIAN * angle_difference(yaw, last.yaw).abs();
            self.knots.push(Knot { time: last.time + seconds, at, yaw, way: last.way + way });
        }
    }

    fn wait(&mut self, seconds: f64) {
        let last = self.last();
        self.push(seconds, last.at, last.yaw);
    }

    fn turn_to(&mut self, yaw: f64, rate: f64) {
        let last = self.last();
        let turn = angle_difference(yaw, last.yaw);
        if turn.abs() > 0.2 {
            let steps = (turn.abs() / 0.1).ceil();
            for k in 1..=steps as usize {
                self.push(turn.abs() / steps / rate, last.at, last.yaw + turn * k as f64 / steps);
            }
        }
    }

    /// Drives along points that have no sharp corner; stands at both ends.
    fn stretch(&mut self, points: &[Vector], gait: Gait) {
        let n = points.len();
        let step: Vec<f64> = points.windows(2).map(|w| (w[1] - w[0]).norm()).collect();
        let yaws: Vec<f64> = points.windows(2).map(|w| yaw_between(w[0], w[1])).collect();
        let mut speed = vec![gait.speed; n];
        for i in 1..n - 1 {
            let bend = angle_difference(yaws[i], yaws[i - 1]).abs() / step[i - 1].max(step[i]);
            if bend > 1e-6 {
                speed[i] = gait.speed.min(gait.turn_rate / bend);
            }
        }
        let creep = 0.05f64.min(gait.speed);
        speed[0] = creep;
        speed[n - 1] = creep;
        for i in 1..n {
            speed[i] = speed[i].min((speed[i - 1].powi(2) + 2.0 * gait.acceleration * step[i - 1]).sqrt());
        }
        for i in (0..n - 1).rev() {
            speed[i] = speed[i].min((speed[i + 1].powi(2) + 2.0 * gait.acceleration * step[i]).sqrt());
        }
        for i in 0..n - 1 {
            let pace = (speed[i] + speed[i + 1]) / 2.0;
            // At a point the heading is the mean of the legs before and after it.
            let after = yaws[(i + 1).min(n - 2)];
            let yaw = yaws[i] + angle_difference(after, yaws[i]) / 2.0;
            self.push(step[i] / pace, points[i + 1], yaw);
        }
    }
}

fn yaw_between(a: Vector, b: Vector) -> f64 {
    (b.y - a.y).atan2(b.x - a.x)
}

fn first_yaw(points: &[Vector]) -> Option<f64> {
    (points.len() > 1).then(|| yaw_between(points[0], points[1]))
}

fn is_sharp(points: &[Vector], i: usize) -> bool {
    let turn = angle_difference(yaw_between(points[i], points[i + 1]), yaw_between(points[i - 1], points[i]));
    turn.abs() > 0.8
}

/// Replaces corners by arcs; gives points about [`STEP`] apart and where each waypoint went.
fn smooth(waypoints: &[Vector], corner_radius: f64) -> (Vec<Vector>, Vec<usize>) {
    let mut points = vec![waypoints[0]];
    let mut marks = vec![0];
    for i in 1..waypoints.len() {
        let corner = waypoints[i];
        let before = waypoints[i - 1];
        let Some(&after) = waypoints.get(i + 1) else {
            line_to(&mut points, corner);
            marks.push(points.len() - 1);
            continue;
        };
        let (leg_in, leg_out) = ((corner - before).norm(), (after - corner).norm());
        let turn = angle_difference(yaw_between(corner, after), yaw_between(before, corner));
        if turn.abs() < 1e-3 || turn.abs() > TURN_ON_SPOT || corner_radius <= 0.0 {
            line_to(&mut points, corner);
            marks.push(points.len() - 1);
            continue;
        }
        let cut = (corner_radius * (turn.abs() / 2.0).tan()).min(0.45 * leg_in.min(leg_out));
        let radius = cut / (turn.abs() / 2.0).tan();
        let yaw = yaw_between(before, corner);
        let entry = corner - heading(yaw) * cut;
        line_to(&mut points, entry);
        let center = entry + heading(yaw + turn.signum() * TAU / 4.0) * radius;
        let steps = ((radius * turn.abs()) / STEP).ceil().max(4.0);
        for k in 1..=steps as usize {
            let angle = yaw - turn.signum() * TAU / 4.0 + turn * k as f64 / steps;
            points.push(center + heading(angle) * radius);
        }
        marks.push(points.len() - 1 - steps as usize / 2);
    }
    (points, marks)
}

fn line_to(points: &mut Vec<Vector>, end: Vector) {
    let start = points[points.len() - 1];
    let length = (end - start).norm();
    if length < 1e-6 {
        return;
    }
    let steps = (length / STEP).ceil();
    for k in 1..=steps as usize {
        points.push(start + (end - start) * (k as f64 / steps));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GAIT: Gait = Gait { speed: 1.0, turn_rate: 1.0, acceleration: 1.0, corner_radius: 0.5 };

    #[test]
    fn a_square_is_driven_with_rounded_corners_and_no_jumps() {
        let square: Vec<Vector> =
            [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)].map(|(x, y)| Vector::new(x, y)).to_vec();
        let drive = Drive::new(&square, true, 1, 0.0, &[Stop { waypoint: 1, seconds: 5.0 }], GAIT);
        assert!((44.0..60.0).contains(&drive.duration()), "{}", drive.duration());
        let mut last = drive.pose(0.0);
        for i in 1..=(drive.duration() * 100.0) as usize {
            let now = drive.pose(i as f64 * 0.01);
            assert!((now.translation.vector - last.translation.vector).norm() < 0.0102);
            assert!(angle_difference(now.rotation.angle(), last.rotation.angle()).abs() < 0.05);
            last = now;
        }
        assert!((drive.way(1e9) - 39.0).abs() < 4.0);
    }

    #[test]
    fn a_way_out_and_back_turns_on_the_spot() {
        let way = [Vector::new(0.0, 0.0), Vector::new(3.0, 0.0), Vector::new(0.0, 0.0)];
        let drive = Drive::new(&way, false, 1, 0.0, &[], GAIT);
        let end = drive.pose(drive.duration());
        assert!(end.translation.vector.norm() < 1e-9 && end.rotation.angle().abs() > 3.1);
    }

    #[test]
    fn a_single_point_stands() {
        let drive =
            Drive::new(&[Vector::new(1.0, 2.0)], false, 1, 0.5, &[Stop { waypoint: 0, seconds: 9.0 }], GAIT);
        assert_eq!(drive.duration(), 9.0);
        assert!((drive.pose(4.0).rotation.angle() - 0.5).abs() < 1e-12);
    }
}
