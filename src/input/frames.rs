//! The tree of frames of a bag (tf2), and the robot's way through the plane that it tells.
//!
//! Source: REP-105 for the frames, tf2 for interpolation between samples. Positions are projected onto the plane, and
//! so are headings: that of a frame is the direction of its x axis.

use std::collections::{BTreeSet, HashMap};

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
    /// The scanner in `base`; `None` where no transform connects the two.
    pub mount: Option<Pose>,
    /// Whether the scanner hangs head down, its bearings clockwise.
    pub upside_down: bool,
    /// `None` where no frame on the way has ever moved in time: `standing` then holds for all of it.
    pub poses: Option<Vec<StampedPose>>,
    /// Pose of a robot that stands.
    pub standing: Pose,
}

/// Why there is no way, with the frames that there are.
#[derive(Debug)]
pub enum NoWay {
    /// A frame that was asked for is not there.
    NoFrame(String),
    /// There is one of the robot, but where the scanner is on it is not told.
    NoMount(String),
    /// Nothing tells where the robot was.
    Nowhere(String),
}

/// The robot's frame, where nothing else is said.
const BASES: [&str; 2] = ["base_link", "base_footprint"];

/// A frame's name without the robot's in front of it.
fn own_name(frame: &str) -> &str {
    frame.rsplit('/').next().unwrap_or(frame)
}

/// Whether poses in this frame are true to the ground.
pub fn is_map(frame: &str) -> bool {
    ["map", "world", "earth"].contains(&own_name(frame))
}

/// Whether poses in this frame drift (REP-105).
pub fn is_odometry(frame: &str) -> bool {
    own_name(frame).contains("odom")
}

fn is_ground(frame: &str) -> bool {
    is_map(frame) || is_odometry(frame)
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

    /// Whether a transform names the frame.
    pub fn has(&self, frame: &str) -> bool {
        let frame = name(frame);
        self.edges.contains_key(frame) || self.edges.values().any(|edge| edge.parent == frame)
    }

    /// All that transforms name.
    pub fn names(&self) -> BTreeSet<&str> {
        self.edges.iter().flat_map(|(child, edge)| [child.as_str(), edge.parent.as_str()]).collect()
    }

    /// Whether frames from one up to the highest tell where something was on the ground.
    fn leads(&self, ancestry: &[&str], fixed: Option<&str>) -> bool {
        let Some(top) = ancestry.last() else { return false };
        match fixed {
            Some(fixed) => ancestry.contains(&name(fixed)),
            None => is_ground(top) || self.edges_between(ancestry).any(|edge| !edge.is_static),
        }
    }

    /// The robot, where it is in no frame above the scanner's: by its usual name, else what alone moves on the ground.
    fn apart(&self, fixed: Option<&str>) -> Option<&str> {
        if let Some(base) = BASES.into_iter().find(|base| self.leads(&self.ancestry(base), fixed)) {
            return Some(base);
        }
        let mut moving = self.edges.iter().filter(|(child, edge)| {
            !edge.is_static
                && !is_ground(child)
                && is_ground(&edge.parent)
                && self.leads(&self.ancestry(child), fixed)
        });
        let (only, _) = moving.next()?;
        moving.next().is_none().then_some(only)
    }

    /// The way of the robot that carries `laser`. `has_mount` where it is known from elsewhere how.
    ///
    /// # Errors
    /// Says which frames there are.
    pub fn way(
        &self,
        laser: &str,
        base: Option<&str>,
        fixed: Option<&str>,
        has_mount: bool,
    ) -> Result<Way, NoWay> {
        let laser = name(laser);
        let above_laser = self.ancestry(laser);
        // A bag that does not connect the two has the robot's poses nevertheless.
        let apart = match base.map(name) {
            Some(base) => (!above_laser.contains(&base)).then_some(base),
            None => {
                let from = BASES.iter().find_map(|base| above_laser.iter().position(|frame| frame == base));
                let leads = self.leads(&above_laser[from.unwrap_or(0)..], fixed);
                if leads { None } else { self.apart(fixed) }
            }
        };
        let ancestry = apart.map_or(above_laser, |robot| self.ancestry(robot));
        let position = |wanted: &str| ancestry.iter().position(|frame| *frame == name(wanted));
        let there_are = || format!("frames above {} are: {}", ancestry[0], ancestry.join(" <- "));
        let top = match fixed {
            Some(wanted) => position(wanted).ok_or_else(|| {
                NoWay::NoFrame(format!("{wanted} is not above {}; {}", ancestry[0], there_are()))
            })?,
            None => position("map").unwrap_or(ancestry.len() - 1),
        };
        if let Some(robot) = apart.filter(|_| !has_mount && self.leads(&ancestry, fixed)) {
            return Err(NoWay::NoMount(format!(
                "the bag has poses of {robot} in {}, but no transform from {robot} to the scanner's frame {laser}; its frames \
                 are {}. Say where the scanner is on {robot} with --mount X,Y,YAW, or leave these poses alone with --pose \
                 match-ranges",
                ancestry[top],
                self.names().into_iter().collect::<Vec<_>>().join(", "),
            )));
        }
        let wanted_base = match (apart, base) {
            (Some(_), _) => Some(0),
            (None, Some(named)) => position(named),
            (None, None) => BASES.into_iter().find_map(position),
        };
        // A scanner that moves on the robot, or has no robot, is its own.
        let base = wanted_base
            .filter(|&at| at <= top && self.mount(ancestry[0], ancestry[at]).is_some())
            .unwrap_or(0);
        let mounted = self.mount(ancestry[0], ancestry[base]).unwrap_or((Pose::identity(), false));
        let (mount, mut upside_down) = (apart.is_none().then_some(mounted.0), mounted.1);
        let chain = &ancestry[base..=top];
        let moving =
            self.edges_between(chain).filter(|edge| !edge.is_static).max_by_key(|edge| edge.samples.len());
        if moving.is_none() && fixed.is_none() && !is_ground(ancestry[top]) {
            let what = format!("no frame of the bag moves or is fixed to the ground; {}", there_are());
            return Err(NoWay::Nowhere(what));
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
        let way = frames.way("laser", None, None, false).unwrap();
        assert_eq!((way.base.as_str(), way.fixed.as_str(), way.upside_down), ("base_link", "map", false));
        assert_near(way.mount.unwrap(), pose(0.2, 0.1, FRAC_PI_2));
        let poses = way.poses.unwrap();
        assert_eq!(poses.iter().map(|pose| pose.stamp_ns).collect::<Vec<_>>(), [0, 50, 100]);
        assert_near(poses[1].pose, pose(10.0, 0.5, FRAC_PI_2));
        let way = frames.way("laser", None, Some("odom"), false).unwrap();
        assert_near(way.poses.unwrap()[2].pose, pose(1.0, 0.0, 0.0));
        let Err(NoWay::NoFrame(what)) = frames.way("laser", None, Some("world"), false) else { panic!() };
        assert!(what.contains("laser <- mast <- base_link"), "{what}");
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
        let way = frames.way("laser", None, None, false).unwrap();
        assert_eq!(way.base, "laser");
        assert_near(way.mount.unwrap(), Pose::identity());
        assert_near(way.poses.unwrap()[1].pose, pose(1.0, 0.0, FRAC_PI_2 / 2.0));
    }

    #[test]
    fn a_standing_robot_and_one_that_is_nowhere() {
        let standing = frames(&[("map", "laser", 0, [1.0, 2.0, 3.0], ROLLED, true)])
            .way("laser", None, None, false)
            .unwrap();
        assert!(standing.poses.is_none() && standing.upside_down);
        assert_near(standing.standing, pose(1.0, 2.0, 0.0));
        let nowhere = frames(&[("base_link", "laser", 0, [0.0; 3], NONE, true)]);
        assert!(nowhere.way("laser", None, None, false).is_err());
        assert!(Frames::default().way("laser", None, None, false).is_err());
    }

    #[test]
    fn a_scanner_that_no_transform_connects_with_the_robot() {
        let apart = |robot| {
            frames(&[
                ("odom", robot, 0, [0.0; 3], NONE, false),
                ("odom", robot, 100, [1.0, 0.0, 0.0], NONE, false),
                ("mast", "laser", 0, [0.0; 3], NONE, true),
            ])
        };
        for (robot, base) in [("base_link", None), ("chassis", None), ("cart", Some("/cart"))] {
            let frames = apart(robot);
            let Err(NoWay::NoMount(what)) = frames.way("laser", base, None, false) else { panic!("{robot}") };
            for wanted in [&format!("{robot}, laser, mast, odom"), "--mount", "no transform", "match-ranges"]
            {
                assert!(what.contains(wanted), "{what}");
            }
            let way = frames.way("laser", base, None, true).unwrap();
            assert_eq!((way.base.as_str(), way.fixed.as_str(), way.mount), (robot, "odom", None));
            assert_near(way.poses.unwrap()[1].pose, pose(1.0, 0.0, 0.0));
            assert!(matches!(frames.way("laser", base, Some("map"), true), Err(NoWay::NoFrame(_))));
        }
        // Wheels turn on the robot; that does not tell where it is.
        let wheels = frames(&[("base_link", "wheel", 0, [0.0; 3], NONE, false)]);
        assert!(matches!(wheels.way("laser", None, None, true), Err(NoWay::Nowhere(_))));
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
        assert!(ring.way("b", None, None, false).is_err());
    }
}
