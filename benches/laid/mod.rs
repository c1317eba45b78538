//! A simulated drive, scan by scan where each was taken, as a grid is given them.

#[expect(dead_code, reason = "the truth is for the marks")]
#[path = "../../tools/eval/src/drive.rs"]
mod drive;

use drive::Drive;
use scipsim::{SimulationOptions, World};
use visagged::{
    pose::{Pose, PoseBuffer},
    scan::Scan,
};

/// A scan and the poses of the scanner at its first and last beam.
pub type Laid = (Scan, Pose, Pose);

/// The scans of a simulated drive, at the poses that are reported.
pub fn laid(world: &World, options: SimulationOptions) -> Vec<Laid> {
    let drive = Drive::new(world, options, 1);
    let mut poses = PoseBuffer::default();
    for pose in drive.poses {
        poses.push(pose);
    }
    let mount = drive.mount.pose();
    let at = |stamp_ns| poses.at(stamp_ns, 250_000_000).ok().map(|pose| pose * mount);
    let laid =
        |scan: Scan| Some((at(scan.stamp_ns)?, at(scan.end_ns())?)).map(|(start, end)| (scan, start, end));
    drive.scans.into_iter().filter_map(laid).collect()
}
