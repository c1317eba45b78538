//! Poses that are all known before the first scan, given to the mapper just before the scans that need them.

use std::path::PathBuf;
use std::str::FromStr;

use super::{InputError, InputReport, Sink, tum};
use crate::mapper::PoseUse;
use crate::pose::{Pose, StampedPose, pose};
use crate::scan::Scan;

/// What [`PoseSource`] can be, for people.
pub const CHOICES: &str =
    "recorded, tf, odom, match, match-ranges, fixed, fixed:X,Y,YAW or a file of poses (TUM format)";

/// Where a replay takes its poses from.
#[derive(Clone, Debug, PartialEq)]
pub enum PoseSource {
    /// What the input itself recorded: the default where it has any.
    Recorded,
    /// Transforms of a bag.
    Tf,
    /// Odometry of a bag or a Carmen log.
    Odom,
    /// A file of poses of the robot (TUM format).
    File(PathBuf),
    /// The robot stood here.
    Fixed(Pose),
    /// Scans are matched with the map; odometry guides where the input has some and it is wanted.
    Match {
        /// Whether the input's odometry is used.
        odometry: bool,
    },
}

impl PoseSource {
    /// What the poses are that an input gives when it is asked for these; `None`: as the recording has it.
    pub fn pose_use(source: Option<&Self>) -> Option<PoseUse> {
        match source {
            None | Some(Self::Recorded) => None,
            Some(Self::Match { .. }) => Some(PoseUse::Odometry),
            Some(_) => Some(PoseUse::Map),
        }
    }
}

impl FromStr for PoseSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "recorded" => Ok(Self::Recorded),
            "tf" => Ok(Self::Tf),
            "odom" => Ok(Self::Odom),
            "match" => Ok(Self::Match { odometry: true }),
            "match-ranges" => Ok(Self::Match { odometry: false }),
            "fixed" => Ok(Self::Fixed(Pose::identity())),
            _ => match text.strip_prefix("fixed:") {
                Some(numbers) => parse_pose(numbers).map(Self::Fixed),
                None => Ok(Self::File(text.into())),
            },
        }
    }
}

/// Pose from `X,Y,YAW` (m, m, rad).
///
/// # Errors
/// Says what was expected.
pub fn parse_pose(text: &str) -> Result<Pose, String> {
    let numbers: Vec<f64> = text.split(',').filter_map(|word| word.trim().parse().ok()).collect();
    match numbers.as_slice() {
        &[x, y, yaw] if numbers.iter().all(|n| n.is_finite()) && text.split(',').count() == 3 => {
            Ok(pose(x, y, yaw))
        }
        _ => Err(format!("{text:?} is no pose: expected X,Y,YAW in metres and radians")),
    }
}

/// Poses ready to be given away.
pub(super) enum Poses {
    /// In order of time, and how many were given.
    Known(Vec<StampedPose>, usize),
    /// The same for every scan.
    Fixed(Pose),
    /// There are none.
    None,
}

impl Poses {
    pub fn known(mut poses: Vec<StampedPose>) -> Self {
        poses.sort_by_key(|pose| pose.stamp_ns);
        poses.dedup_by_key(|pose| pose.stamp_ns);
        Self::Known(poses, 0)
    }

    /// Poses of a file or a fixed one, where these are asked for.
    pub fn from_outside(source: Option<&PoseSource>) -> Result<Option<Self>, InputError> {
        match source {
            Some(PoseSource::File(path)) => Ok(Some(Self::known(tum::read(path)?))),
            Some(PoseSource::Fixed(pose)) => Ok(Some(Self::Fixed(*pose))),
            _ => Ok(None),
        }
    }

    /// The same poses on another clock.
    pub fn shifted(mut self, by_ns: i64) -> Self {
        if let Self::Known(poses, _) = &mut self {
            for pose in poses {
                pose.stamp_ns += by_ns;
                pose.received_ns += by_ns;
            }
        }
        self
    }

    /// Gives all poses up to the first at or behind the end of `scan`.
    pub fn give_for(&mut self, scan: &Scan, sink: &mut dyn Sink, report: &mut InputReport) {
        match self {
            Self::Known(poses, given) => {
                let needed = |given: usize| given == 0 || poses[given - 1].stamp_ns < scan.end_ns();
                while *given < poses.len() && needed(*given) {
                    sink.on_pose(poses[*given]);
                    report.poses += 1;
                    *given += 1;
                }
            }
            Self::None => {}
            Self::Fixed(pose) => {
                let mut stamps = vec![scan.stamp_ns, scan.end_ns()];
                stamps.dedup();
                for stamp_ns in stamps {
                    let received_ns = stamp_ns;
                    sink.on_pose(StampedPose {
                        stamp_ns,
                        received_ns,
                        pose: *pose,
                        covariance: None,
                        reset: 0,
                    });
                    report.poses += 1;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sources_as_the_command_line_has_them() {
        assert_eq!("tf".parse(), Ok(PoseSource::Tf));
        assert_eq!("fixed".parse(), Ok(PoseSource::Fixed(Pose::identity())));
        assert_eq!("match".parse(), Ok(PoseSource::Match { odometry: true }));
        assert_eq!("match-ranges".parse(), Ok(PoseSource::Match { odometry: false }));
        assert_eq!("fixed:1,-2,0.5".parse(), Ok(PoseSource::Fixed(pose(1.0, -2.0, 0.5))));
        assert_eq!("drive.tum".parse(), Ok(PoseSource::File("drive.tum".into())));
        for bad in ["fixed:1,2", "fixed:1,2,x", "fixed:1,2,3,4", "fixed:1,2,inf"] {
            assert!(bad.parse::<PoseSource>().unwrap_err().contains("X,Y,YAW"));
        }
    }
}
