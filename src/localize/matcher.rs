//! Lays the points of a scan onto a matching map: least squares from a pose that is nearly right, and a search around
//! one that is not.

use super::points::ScanPoint;
use super::submap::{Place, Submap};
use crate::pose::{Pose, pose};
use nalgebra::{Matrix3, Vector2, Vector3};

/// Distance at which a point counts half, from the first iteration to the last (m): wide at first to find the surface, then
/// narrow against what is not in the map.
const SCALES: [f64; 6] = [0.15, 0.10, 0.07, 0.05, 0.04, 0.04];
/// A point is explained by a surface within this distance (m): three deviations of far ranges.
const EXPLAINED: f64 = 0.08;
/// A surface that is met at a smaller angle than this counts less (sine of the angle, 30 degrees): what a scanner's ranges have
/// of systematic error shows there. A real one of 11 m range saw straight walls bent by 3 cm at their ends, and matching
/// then bent the map by 0.2 degree a metre; half as much with this.
const SLANT: f64 = 0.5;
/// What is left of a surface's information along it, which is unevenness that was taken for form (rad2): a line through 30
/// returns with 1 cm of noise over 30 cm turns by 0.02 rad.
const UNEVEN: f64 = 4e-4;
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
        information: last.sound_information(),
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
    /// What a surface's unevenness adds to the information, which tells nothing.
    uneven: Matrix3<f64>,
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
            let weight = line.weight * robust * robust * point.slant_weight(SLANT);
            if point.post {
                let weight = weight / (point.variance + along.max(floor));
                sums.add(Vector2::x(), off.x, arm, weight);
                sums.add(Vector2::y(), off.y, arm, weight);
            } else if let Some(direction) = direction {
                let weight =
                    weight / (point.variance + if is_line { across.max(floor) } else { SHORT * SHORT });
                sums.add(direction, direction.dot(&off), arm, weight);
                sums.uneven(Vector2::new(-direction.y, direction.x), arm, weight * UNEVEN);
            }
        }
        sums
    }

    fn add(&mut self, direction: Vector2<f64>, residual: f64, arm: Vector2<f64>, weight: f64) {
        let slope = Vector3::new(direction.x, direction.y, direction.y * arm.x - direction.x * arm.y);
        self.information += slope * slope.transpose() * weight;
        self.gradient += slope * (residual * weight);
    }

    fn uneven(&mut self, direction: Vector2<f64>, arm: Vector2<f64>, weight: f64) {
        let slope = Vector3::new(direction.x, direction.y, direction.y * arm.x - direction.x * arm.y);
        self.uneven += slope * slope.transpose() * weight;
    }

    /// The information without what unevenness feigns; none is negative.
    fn sound_information(&self) -> Matrix3<f64> {
        // Headings are weighed as lengths at 3 m, so that the parts can be compared.
        let scale = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 3.0));
        let unscale = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 1.0 / 3.0));
        let difference = unscale * (self.information - self.uneven) * unscale;
        let mut parts = difference.symmetric_eigen();
        parts.eigenvalues.apply(|value| *value = value.max(0.0));
        scale * parts.recompose() * scale
    }
}
