//! The tree of frames of a bag (tf2), and the robot's way through the plane that it tells.
//!
//! Source: REP-105 for the frames, tf2 for interpolation between samples. Positions are projected onto the plane, and
//! so are headings: that of a frame is the direction of its x axis.

use std::collections::HashMap;

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

use crate::cdr;
use crate::pose::{Pose, StampedPose, pose};

/// A frame that repeats the same transform is kept this often (ns), enough to interpolate.
const KEEP_EVERY_NS: i64 = 100_000_000;
/// Samples that differ by less are the same (m, and parts of a quaternion): noise of a printed URDF.
const SAME: f64 = 1e-6;

/// How a frame moved in its parent.
struct Edge {
    parent: String,
    is_static: bool,
    samples: Vec<(i64, Isometry3<f64>)>,
}

impl Edge {
    fn is_constant(&self) -> bool {
        let Some((_, first)) = self.samples.first() else { return true };
        self.samples.iter().all(|(_, sample)| is_same(first, sample))
    }

    /// The transform at a moment; `None` outside of the samples of a frame that moves.
    fn at(&self, stamp_ns: i64) -> Option<Isometry3<f64>> {
        let behind = self.samples.partition_point(|(stamp, _)| *stamp < stamp_ns);
        if let Some((stamp, exact)) = self.samples.get(behind)
            && *stamp == stamp_ns
        {
            return Some(*exact);
        }
        if behind == 0 || behind == self.samples.len() {
            return if self.is_static || self.is_constant() { Some(self.samples.first()?.1) } else { None };
        }
        let ((t0, before), (t1, after)) = (&self.samples[behind - 1], &self.samples[behind]);
        let part = (stamp_ns - t0) as f64 / (t1 - t0) as f64;
        // Half a turn between two samples has no shortest way; the earlier is as good.
        Some(before.try_lerp_slerp(after, part, 1e-9).unwrap_or(*before))
    }
}

fn is_same(a: &Isometry3<f64>, b: &Isometry3<f64>) -> bool {
    (a.translation.vector - b.translation.vector).amax() < SAME
        && a.rotation.angle_to(&b.rotation) < SAME.sqrt()
}

/// Heading of a rotated frame: the direction of its x axis in the plane (rad).
pub fn yaw(rotation: &UnitQuaternion<f64>) -> f64 {
    let forward = rotation * Vector3::x();
    forward.y.atan2(forward.x)
}

fn planar(transform: &Isometry3<f64>) -> Pose {
    pose(transform.translation.x, transform.translation.y, yaw(&transform.rotation))
}

fn is_upside_down(transform: &Isometry3<f64>) -> bool {
    (transform.rotation * Vector3::z()).z < 0.0
}

/// The transform of a message, or `None` where its numbers make none.
pub fn isometry(transform: &cdr::Transform) -> Option<Isometry3<f64>> {
    let [x, y, z] = transform.translation;
    let [qx, qy, qz, qw] = transform.rotation;
    let is_finite = transform.translation.iter().chain(&transform.rotation).all(|value| value.is_finite());
    let rotation = UnitQuaternion::try_new(Quaternion::new(qw, qx, qy, qz), 1e-9)?;
    is_finite.then(|| Isometry3::from_parts(Translation3::new(x, y, z), rotation))
}

/// Frame names of tf were written with a leading slash once.
pub fn name(frame: &str) -> &str {
    frame.strip_prefix('/').unwrap_or(frame)
}

/// Where the scanner is on the robot, and where the robot went.
pub struct Way {
    /// Frame whose poses these are.
    pub base: String,
    /// Frame that they are given in.
    pub fixed: String,
    /// The scanner in `base`.
    pub mount: Pose,
    /// Whether the scanner hangs head down, its bearings clockwise.
    pub upside_down: bool,
    /// `None` where no frame on the way has ever moved in time: `standing` then holds for all of it.
    pub poses: Option<Vec<StampedPose>>,
    /// Pose of a robot that stands.
    pub standing: Pose,
}

/// All frames of a bag.
#[derive(Default)]
pub struct Frames {
    edges: HashMap<String, Edge>,
    /// Transforms whose numbers made no sense.
    pub bad: u64,
}

impl Frames {
    /// Takes one transform.
    pub fn insert(&mut self, stamped: &cdr::TransformStamped, is_static: bool) {
        let Some(transform) = isometry(&stamped.transform) else {
            self.bad += 1;
            return;
        };
        let (parent, stamp_ns) = (name(&stamped.header.frame_id), stamped.header.stamp_ns);
        let child = name(&stamped.child_frame_id);
        let edge = self.edges.entry(child.to_owned()).or_insert_with(|| Edge {
            parent: parent.to_owned(),
            is_static,
            samples: Vec::new(),
        });
        if edge.parent != parent {
            // A frame has one parent; a bag that changes it means the later one no more than the first.
            self.bad += 1;
            return;
        }
        if let [.., (t0, a), (t1, b)] = edge.samples.as_slice()
            && is_same(a, &transform)
            && is_same(b, &transform)
            && (*t0..t0.saturating_add(KEEP_EVERY_NS)).contains(&stamp_ns)
            && stamp_ns >= *t1
        {
            edge.samples.pop();
        }
        edge.samples.push((stamp_ns, transform));
    }

    /// Brings the samples in order; to be called when all are in.
    pub fn sort(&mut self) {
        for edge in self.edges.values_mut() {
            edge.samples.sort_by_key(|(stamp, _)| *stamp);
            edge.samples.dedup_by_key(|(stamp, _)| *stamp);
        }
    }

    /// Frames from `frame` up to the highest.
    fn ancestry<'a>(&'a self, frame: &'a str) -> Vec<&'a str> {
        let mut chain = vec![frame];
        let mut current = frame;
        while let Some(edge) = self.edges.get(current) {
            // A ring of frames ends where it began.
            if chain.contains(&edge.parent.as_str()) {
                break;
            }
            current = &edge.parent;
            chain.push(current);
        }
        chain
    }

    fn edges_between<'a>(&'a self, chain: &'a [&str]) -> impl Iterator<Item = &'a Edge> {
        chain[..chain.len() - 1].iter().filter_map(|frame| self.edges.get(*frame))
    }

    /// The last frame of the chain has the first one here at a moment.
    fn compose(&self, chain: &[&str], stamp_ns: i64) -> Option<Isometry3<f64>> {
        self.edges_between(chain)
            .try_fold(Isometry3::identity(), |below, edge| Some(edge.at(stamp_ns)? * below))
    }

    /// The scanner in a frame of the robot, and whether it hangs head down; `None` where the frames are not connected
    /// or the scanner moves.
    pub fn mount(&self, laser: &str, base: &str) -> Option<(Pose, bool)> {
        let ancestry = self.ancestry(name(laser));
        let end = ancestry.iter().position(|frame| *frame == name(base))?;
        let chain = &ancestry[..=end];
        if !self.edges_between(chain).all(Edge::is_constant) {
            return None;
        }
        let transform = self.compose(chain, 0)?;
        Some((planar(&transform), is_upside_down(&transform)))
    }

    /// The way of the robot that carries `laser`.
    ///
    /// # Errors
    /// Says which frames there are.
    pub fn way(&self, laser: &str, base: Option<&str>, fixed: Option<&str>) -> Result<Way, String> {
        let ancestry = self.ancestry(name(laser));
        let position = |wanted: &str| ancestry.iter().position(|frame| *frame == name(wanted));
        let there_are = || format!("frames above the scanner's are: {}", ancestry.join(" <- "));
        let top = match fixed {
            Some(wanted) => {
                position(wanted).ok_or_else(|| format!("no frame {wanted:?}; {}", there_are()))?
            }
            None => position("map").unwrap_or(ancestry.len() - 1),
        };
        let wanted_base = match base {
            Some(wanted) => {
                Some(position(wanted).ok_or_else(|| format!("no frame {wanted:?}; {}", there_are()))?)
            }
            None => position("base_link").or_else(|| position("base_footprint")),
        };
        // A scanner that moves on the robot, or has no robot, is its own.
        let base =
            wanted_base.filter(|&at| at <= top && self.mount(laser, ancestry[at]).is_some()).unwrap_or(0);
        let (mount, mut upside_down) = self.mount(laser, ancestry[base]).unwrap_or((Pose::identity(), false));
        let chain = &ancestry[base..=top];
        let moving =
            self.edges_between(chain).filter(|edge| !edge.is_static).max_by_key(|edge| edge.samples.len());
        let stands_on_the_ground = ["map", "odom", "world", "earth"].contains(&ancestry[top]);
        if moving.is_none() && fixed.is_none() && !stands_on_the_ground {
            return Err(format!("no frame of the bag moves or is fixed to the ground; {}", there_are()));
        }
        let at = |stamp_ns| self.compose(chain, stamp_ns);
        let standing = at(0).unwrap_or_else(Isometry3::identity);
        if base == 0 {
            let sample = moving.and_then(|edge| edge.samples.iter().find_map(|(stamp, _)| at(*stamp)));
            upside_down = is_upside_down(&sample.unwrap_or(standing));
        }
        let poses = moving.map(|edge| {
            let stamped = |&(stamp_ns, _): &(i64, _)| {
                let pose = planar(&at(stamp_ns)?);
                Some(StampedPose { stamp_ns, received_ns: stamp_ns, pose, covariance: None, reset: 0 })
            };
            edge.samples.iter().filter_map(stamped).collect()
        });
        Ok(Way {
            base: ancestry[base].to_owned(),
            fixed: ancestry[top].to_owned(),
            mount,
            upside_down,
            poses,
            standing: planar(&standing),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2};

    /// Rotations about z by a quarter turn, about x by half a turn, and none.
    const LEFT: [f64; 4] = [0.0, 0.0, FRAC_1_SQRT_2, FRAC_1_SQRT_2];
    const ROLLED: [f64; 4] = [1.0, 0.0, 0.0, 0.0];
    const NONE: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

    /// Parent, child, stamp, translation, rotation, static or not.
    type Row<'a> = (&'a str, &'a str, i64, [f64; 3], [f64; 4], bool);

    fn frames(list: &[Row<'_>]) -> Frames {
        let mut frames = Frames::default();
        for &(parent, child, stamp_ns, translation, rotation, is_static) in list {
            let stamped = cdr::TransformStamped {
                header: cdr::Header { stamp_ns, frame_id: parent.into() },
                child_frame_id: child.into(),
                transform: cdr::Transform { translation, rotation },
            };
            frames.insert(&stamped, is_static);
        }
        frames.sort();
        frames
    }

    #[track_caller]
    fn assert_near(a: Pose, b: Pose) {
        let d = a.inverse() * b;
        assert!(d.translation.vector.norm() < 1e-9 && d.rotation.angle().abs() < 1e-9, "{a} {b}");
    }

    #[test]
    fn the_chain_from_map_to_laser() {
        let frames = frames(&[
            ("/map", "odom", 0, [10.0, 0.0, 0.0], LEFT, false),
            ("map", "odom", 200, [10.0, 0.0, 0.0], LEFT, false),
            ("odom", "base_link", 0, [0.0, 0.0, 0.0], NONE, false),
            ("odom", "base_link", 50, [0.5, 0.0, 0.0], NONE, false),
            ("odom", "base_link", 100, [1.0, 0.0, 0.0], NONE, false),
            ("base_link", "mast", 0, [0.2, 0.0, 1.0], NONE, true),
            ("mast", "laser", 0, [0.0, 0.1, 0.0], LEFT, true),
        ]);
        let way = frames.way("laser", None, None).unwrap();
        assert_eq!((way.base.as_str(), way.fixed.as_str(), way.upside_down), ("base_link", "map", false));
        assert_near(way.mount, pose(0.2, 0.1, FRAC_PI_2));
        let poses = way.poses.unwrap();
        assert_eq!(poses.iter().map(|pose| pose.stamp_ns).collect::<Vec<_>>(), [0, 50, 100]);
        assert_near(poses[1].pose, pose(10.0, 0.5, FRAC_PI_2));
        let way = frames.way("laser", None, Some("odom")).unwrap();
        assert_near(way.poses.unwrap()[2].pose, pose(1.0, 0.0, 0.0));
        assert!(
            frames.way("laser", None, Some("world")).err().unwrap().contains("laser <- mast <- base_link")
        );
    }

    #[test]
    fn a_scanner_that_turns_on_the_robot_is_its_own_base() {
        let frames = frames(&[
            ("odom", "base_link", 0, [1.0, 0.0, 0.0], NONE, false),
            ("odom", "base_link", 100, [1.0, 0.0, 0.0], NONE, false),
            ("base_link", "laser", 0, [0.0; 3], NONE, false),
            (
                "base_link",
                "laser",
                50,
                [0.0; 3],
                [0.0, 0.0, (FRAC_PI_2 / 4.0).sin(), (FRAC_PI_2 / 4.0).cos()],
                false,
            ),
            ("base_link", "laser", 100, [0.0; 3], LEFT, false),
        ]);
        let way = frames.way("laser", None, None).unwrap();
        assert_eq!(way.base, "laser");
        assert_near(way.mount, Pose::identity());
        assert_near(way.poses.unwrap()[1].pose, pose(1.0, 0.0, FRAC_PI_2 / 2.0));
    }

    #[test]
    fn a_standing_robot_and_one_that_is_nowhere() {
        let standing =
            frames(&[("map", "laser", 0, [1.0, 2.0, 3.0], ROLLED, true)]).way("laser", None, None).unwrap();
        assert!(standing.poses.is_none() && standing.upside_down);
        assert_near(standing.standing, pose(1.0, 2.0, 0.0));
        let nowhere = frames(&[("base_link", "laser", 0, [0.0; 3], NONE, true)]);
        assert!(nowhere.way("laser", None, None).is_err());
        assert!(Frames::default().way("laser", None, None).is_err());
    }

    #[test]
    fn rings_and_nonsense_end() {
        let ring = frames(&[
            ("a", "b", 0, [0.0; 3], NONE, true),
            ("b", "a", 0, [0.0; 3], NONE, true),
            ("a", "c", 0, [f64::NAN, 0.0, 0.0], NONE, true),
            ("a", "c", 0, [0.0; 3], [0.0; 4], true),
        ]);
        assert_eq!(ring.bad, 2);
        assert!(ring.way("b", None, None).is_err());
    }
}
