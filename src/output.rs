//! The folder that a run leaves: map.pgm and map.yaml, map.png, map.npz, trajectory.tum, report.json.
//!
//! Each file is whole or not there: it is written under another name, synced and renamed. A crash between two
//! renames leaves files of two generations; report.json comes last and holds the sizes and sums of the files
//! that belong to it, so that such a set can be told. Equal maps give equal files: none but the report holds a
//! time of writing.
//!
//! The trajectory alone grows for as long as the run lasts, so it is neither kept in memory nor written anew each
//! time: whole lines are appended, and only where a loop was closed are those that are there put where they belong. `trajectory_poses` in the report says how many belong to the map.

mod nav2;
mod npz;
mod picture;

use std::collections::BTreeMap;
use std::fs::{File, create_dir_all};
use std::io::{self, BufRead, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::Serialize;
use tempfile::{Builder, NamedTempFile, TempPath};

use crate::closing::moved::Moved;
use crate::map::Map;
use crate::pose::Pose;
use crate::report::Report;

pub use npz::encode as npz;
pub use picture::SPECULAR_FROM;

/// Writer of the folder.
pub struct Outputs {
    folder: PathBuf,
    generation: u64,
    trajectory: Trajectory,
}

/// Size and sum of a file of the set.
#[derive(Serialize)]
struct FileSum {
    bytes: usize,
    /// CRC-32 (IEEE 802.3), as `crc32` and zip compute it.
    crc32: String,
}

/// report.json: the run's report, and what makes the files one set.
#[derive(Serialize)]
struct Document<'a> {
    /// Counts the sets that this run has written.
    generation: u64,
    files: BTreeMap<&'static str, FileSum>,
    trajectory_poses: u64,
    #[serde(flatten)]
    report: &'a Report,
}

impl Outputs {
    /// Opens (and makes) the folder. Fails where it cannot be written, so that a long run does not find out at
    /// its end. Files of an earlier run stay until the first [`write`](Self::write).
    pub fn create(folder: &Path) -> Result<Self> {
        create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
        let trajectory = Trajectory::create(folder)
            .with_context(|| format!("cannot write into the folder {}", folder.display()))?;
        Ok(Self { folder: folder.to_owned(), generation: 0, trajectory })
    }

    /// Where the files are.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Adds the pose at the first beam of an inserted scan; the time is seconds since the Unix epoch, or what the
    /// input counts its time from (ns).
    pub fn add_pose(&mut self, time_ns: i64, pose: &Pose) -> Result<()> {
        self.trajectory
            .add(time_ns, pose)
            .with_context(|| format!("cannot write the trajectory in {}", self.folder.display()))
    }

    /// Puts the poses that were added until now where they belong; times as in [`add_pose`](Self::add_pose).
    pub fn move_poses(&mut self, moved: &Moved) -> Result<()> {
        self.trajectory
            .put_elsewhere(&self.folder, moved)
            .with_context(|| format!("cannot write the trajectory in {} anew", self.folder.display()))
    }

    /// Writes the set of files for this map.
    pub fn write(&mut self, map: &Map, report: &Report) -> Result<()> {
        self.write_set(map, report)
            .with_context(|| format!("cannot write the map into {}", self.folder.display()))
    }

    /// Writes explain.png, which shows why each cell is in the map or not; nothing for a grid without verdicts.
    pub fn write_explained(&mut self, map: &Map) -> Result<()> {
        let Some(picture) = picture::encode_explained(map) else { return Ok(()) };
        let path = self.folder.join("explain.png");
        self.write_aside(&picture?)
            .and_then(|aside| Ok(aside.persist(&path)?))
            .and_then(|_| sync_folder(&self.folder))
            .with_context(|| format!("cannot write {}", path.display()))
    }

    fn write_set(&mut self, map: &Map, report: &Report) -> Result<()> {
        let contents = [
            ("map.pgm", nav2::pgm(map)),
            ("map.yaml", nav2::yaml(map, "map.pgm").into_bytes()),
            ("map.png", picture::encode(map)?),
            ("map.npz", npz::encode(map)?),
        ];
        let files = contents.iter().map(|(name, bytes)| (*name, FileSum::of(bytes))).collect();
        // All that can fail for want of room comes before the first rename.
        let mut written = Vec::new();
        for (name, bytes) in &contents {
            written.push((*name, self.write_aside(bytes)?));
        }
        let trajectory_poses = self.trajectory.flush()?;
        self.generation += 1;
        let document = Document { generation: self.generation, files, trajectory_poses, report };
        let mut json = serde_json::to_vec_pretty(&document)?;
        json.push(b'\n');
        written.push(("report.json", self.write_aside(&json)?));

        self.trajectory.publish(&self.folder.join(TRAJECTORY))?;
        for (name, path) in written {
            path.persist(self.folder.join(name))?;
        }
        sync_folder(&self.folder)?;
        Ok(())
    }

    /// A synced file in the folder that is removed unless it is renamed.
    fn write_aside(&self, bytes: &[u8]) -> io::Result<TempPath> {
        let mut file = aside(&self.folder)?;
        file.write_all(bytes)?;
        file.as_file().sync_all()?;
        Ok(file.into_temp_path())
    }
}

impl FileSum {
    fn of(bytes: &[u8]) -> Self {
        Self { bytes: bytes.len(), crc32: format!("{:08x}", crc32fast::hash(bytes)) }
    }
}

fn aside(folder: &Path) -> io::Result<NamedTempFile> {
    use std::os::unix::fs::PermissionsExt;
    // As any other new file: the umask takes away what it takes away.
    let readable = std::fs::Permissions::from_mode(0o666);
    Builder::new().prefix(".visagged-").suffix(".part").permissions(readable).tempfile_in(folder)
}

/// Makes renames in the folder durable.
fn sync_folder(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}

const TRAJECTORY: &str = "trajectory.tum";

/// trajectory.tum: `time x y z qx qy qz qw` a line, as evo and TUM's tools read it.
struct Trajectory {
    lines: BufWriter<File>,
    /// Name until the first set is written; `None` once the file has its own.
    unpublished: Option<TempPath>,
    poses: u64,
}

impl Trajectory {
    fn create(folder: &Path) -> io::Result<Self> {
        let (file, path) = aside(folder)?.into_parts();
        Ok(Self { lines: BufWriter::with_capacity(64 << 10, file), unpublished: Some(path), poses: 0 })
    }

    fn add(&mut self, time_ns: i64, pose: &Pose) -> io::Result<()> {
        let line = line(time_ns, pose);
        // The buffer is emptied between lines only, so that a reader never meets half a line.
        if self.lines.buffer().len() + line.len() > self.lines.capacity() {
            self.lines.flush()?;
        }
        self.lines.write_all(line.as_bytes())?;
        self.poses += 1;
        Ok(())
    }

    /// Writes all lines anew, into another file that takes the place of this one.
    fn put_elsewhere(&mut self, folder: &Path, moved: &Moved) -> io::Result<()> {
        self.lines.flush()?;
        let published = folder.join(TRAJECTORY);
        let path = self.unpublished.as_deref().unwrap_or(&published);
        let mut next = Trajectory::create(folder)?;
        for text in BufReader::new(File::open(path)?).lines() {
            let (time_ns, pose) = parse(&text?).ok_or(io::ErrorKind::InvalidData)?;
            next.add(time_ns, &(moved.at(time_ns) * pose))?;
        }
        next.flush()?;
        if self.unpublished.is_none() {
            next.publish(&published)?;
        }
        *self = next;
        Ok(())
    }

    /// Number of poses that are in the file, synced.
    fn flush(&mut self) -> io::Result<u64> {
        self.lines.flush()?;
        self.lines.get_ref().sync_data()?;
        Ok(self.poses)
    }

    fn publish(&mut self, path: &Path) -> io::Result<()> {
        match self.unpublished.take() {
            Some(unpublished) => Ok(unpublished.persist(path)?),
            None => Ok(()),
        }
    }
}

fn line(time_ns: i64, pose: &Pose) -> String {
    const SECOND: i64 = 1_000_000_000;
    let (seconds, nanoseconds) = (time_ns.div_euclid(SECOND), time_ns.rem_euclid(SECOND));
    let [qz, qw] = crate::pose::quaternion_from_yaw(pose.rotation.angle());
    let at = pose.translation.vector;
    format!(
        "{seconds}.{nanoseconds:09} {:.9} {:.9} 0.000000000 0.000000000 0.000000000 {qz:.9} {qw:.9}\n",
        at.x, at.y
    )
}

/// Time (ns) and pose of a line.
fn parse(line: &str) -> Option<(i64, Pose)> {
    let mut words = line.split(' ');
    let (seconds, nanoseconds) = words.next()?.split_once('.')?;
    let whole_ns = seconds.parse::<i64>().ok()?.checked_mul(1_000_000_000)?;
    let time_ns = whole_ns.checked_add(nanoseconds.parse().ok()?)?;
    let numbers = words.map(str::parse).collect::<Result<Vec<f64>, _>>().ok()?;
    let [x, y, _, _, _, qz, qw] = numbers[..] else { return None };
    Some((time_ns, crate::pose::pose(x, y, crate::pose::yaw_from_quaternion([qz, qw]))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_what_evo_reads() {
        assert_eq!(
            line(1_700_000_000_123_456_789, &crate::pose::pose(1.5, -2.25, std::f64::consts::FRAC_PI_2)),
            "1700000000.123456789 1.500000000 -2.250000000 0.000000000 0.000000000 0.000000000 0.707106781 0.707106781\n"
        );
    }
}
