//! Lays the points of a scan onto a matching map: least squares from a pose that is nearly right, and a search around
//! one that is not.

use super::points::ScanPoint;
use super::submap::{Place, Submap};
use crate::pose::{Pose, pose};
use nalgebra::{Matrix3, Vector2, Vector3};

/// Share of the points' information that is believed: their errors are not independent (neighbouring points lie on the same
/// surface, and the map has the errors of the scans that made it).
const BELIEF: f64 = 1.0;
/// Distance at which a point counts half, from the first iteration to the last (m): wide at first to find the surface, then
/// narrow against what is not in the map.
const SCALES: [f64; 6] = [0.15, 0.10, 0.07, 0.05, 0.04, 0.04];
/// A point is explained by a surface within this distance (m): three deviations of far ranges.
const EXPLAINED: f64 = 0.08;
/// Least deviation of a surface of the map (m).
const SURFACE_SIGMA: f64 = 0.005;
/// Spread of a map's returns below which they tell no direction (m).
const SHORT: f64 = 0.04;
/// A step shorter than this ends the iteration (m, rad).
const DONE: f64 = 2e-5;

/// What was expected before the match.
#[derive(Clone, Copy, Debug)]
pub struct Prior {
    /// The scanner in the map.
    pub pose: Pose,
    /// Information of x, y (1/m2) and heading (1/rad2).
    pub information: Matrix3<f64>,
}

/// What a match found.
#[derive(Clone, Copy, Debug)]
pub struct Match {
    /// The scanner in the map.
    pub pose: Pose,
    /// Information that the points alone have of it.
    pub information: Matrix3<f64>,
    /// Share of the points in known space that a surface explains.
    pub explained: f64,
    /// Share of all points that lie in known space.
    pub known: f64,
}

/// Finds the pose at which the points lie best on the map, near the expected one.
pub fn refine(map: &Submap, points: &[ScanPoint], prior: &Prior) -> Match {
    let mut at = prior.pose;
    for (i, scale) in SCALES.iter().enumerate() {
        let sums = Sums::of(map, points, &at, *scale);
        let off = difference(&at, &prior.pose);
        let information = sums.information + prior.information;
        let gradient = sums.gradient + prior.information * off;
        let Some(solver) = information.cholesky() else { break };
        let step = solver.solve(&-gradient);
        at = shifted(&at, &step);
        if step.amax() < DONE && i >= 3 {
            break;
        }
    }
    let last = Sums::of(map, points, &at, SCALES[SCALES.len() - 1]);
    Match {
        pose: at,
        information: last.information,
        explained: last.explained / last.known.max(1.0),
        known: last.known / (points.len() as f64).max(1.0),
    }
}

/// `from` to `to` as x, y (m) and heading (rad) in the map's frame.
pub fn difference(to: &Pose, from: &Pose) -> Vector3<f64> {
    let way = to.translation.vector - from.translation.vector;
    Vector3::new(way.x, way.y, from.rotation.angle_to(&to.rotation))
}

/// A pose moved by a [`difference`].
pub fn shifted(at: &Pose, by: &Vector3<f64>) -> Pose {
    let place = at.translation.vector + Vector2::new(by.x, by.y);
    pose(place.x, place.y, at.rotation.angle() + by.z)
}

/// Sums over all points at one pose.
#[derive(Default)]
struct Sums {
    information: Matrix3<f64>,
    gradient: Vector3<f64>,
    explained: f64,
    known: f64,
}

impl Sums {
    fn of(map: &Submap, points: &[ScanPoint], at: &Pose, scale: f64) -> Sums {
        let mut sums = Sums::default();
        let scale2 = scale * scale;
        for point in points {
            let arm = at.rotation * point.at.coords;
            let place = at.translation.vector + arm;
            let normal = point.normal.map(|normal| at.rotation * normal);
            let line = match map.look(place.into(), normal) {
                Place::Unknown => continue,
                Place::Free => {
                    sums.known += 1.0;
                    continue;
                }
                Place::Surface(line) => line,
            };
            sums.known += 1.0;
            let off = place - line.mean.coords;
            let floor = SURFACE_SIGMA * SURFACE_SIGMA;
            let [across, along] = line.variance;
            let is_line = along > SHORT * SHORT && along > 4.0 * across;
            // A few returns that lie together tell no direction; the scan may.
            let direction = if is_line { Some(line.normal) } else { normal };
            let distance = direction.map_or(off.norm(), |direction| direction.dot(&off).abs());
            let distance = if point.post { off.norm() } else { distance };
            if distance < EXPLAINED {
                sums.explained += 1.0;
            }
            let robust = scale2 / (scale2 + distance * distance);
            let weight = BELIEF * line.weight * robust * robust;
            if point.post {
                let weight = weight / (point.variance + along.max(floor));
                sums.add(Vector2::x(), off.x, arm, weight);
                sums.add(Vector2::y(), off.y, arm, weight);
            } else if let Some(direction) = direction {
                let weight =
                    weight / (point.variance + if is_line { across.max(floor) } else { SHORT * SHORT });
                sums.add(direction, direction.dot(&off), arm, weight);
            }
        }
        sums
    }

    fn add(&mut self, direction: Vector2<f64>, residual: f64, arm: Vector2<f64>, weight: f64) {
        let slope = Vector3::new(direction.x, direction.y, direction.y * arm.x - direction.x * arm.y);
        self.information += slope * slope.transpose() * weight;
        self.gradient += slope * (residual * weight);
    }
}
