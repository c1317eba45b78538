//! One way of localization along one drive: what it found, and what that is worth.

use crate::drive::Drive;
use crate::error::{TrajectoryError, error};
use anyhow::Result;
use nalgebra::{Matrix3, Vector2};
use std::{io::Write, path::Path, str::FromStr};
use visagged::{
    closing::Task,
    localize::{
        LocalizeSettings, Reference,
        loops::{self, Loops},
        matcher::difference,
        points::Points,
    },
    mapper::{Mapper, MapperKind, MapperReport, MapperSettings, Outcome, PoseUse},
    pose::{Pose, PoseBuffer, interpolate},
};

/// Way over which the covariance is held against the error (m): long enough that neither end knows the other's noise, short
/// against that on which the map drifts.
const INCREMENT: f64 = 5.0;

/// How a drive is located.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// By its odometry alone.
    Wheels,
    /// By matching.
    Matched {
        /// With odometry as a guide.
        guided: bool,
        /// What scans are matched with.
        reference: Reference,
    },
}

impl Method {
    /// As it is named on the command line.
    pub fn name(self) -> String {
        let Method::Matched { guided, reference } = self else { return "wheels".into() };
        let what = if guided { "odometry" } else { "ranges" };
        match reference {
            Reference::Surfaces => what.into(),
            Reference::Standard => format!("standard-{what}"),
        }
    }
}

impl FromStr for Method {
    type Err = String;

    fn from_str(text: &str) -> Result<Method, String> {
        let matched = [true, false].into_iter().flat_map(|guided| {
            [Reference::Surfaces, Reference::Standard].map(|reference| Method::Matched { guided, reference })
        });
        let all: Vec<Method> = [Method::Wheels].into_iter().chain(matched).collect();
        all.iter().copied().find(|method| method.name() == text).ok_or_else(|| {
            format!("known are {}", all.iter().map(|method| method.name()).collect::<Vec<_>>().join(", "))
        })
    }
}

/// A scan that was located.
#[derive(Clone, Copy)]
struct Located {
    /// Its number in the drive.
    number: usize,
    /// Where the robot was at its first beam: as was found, and in truth.
    found: Pose,
    truth: Pose,
    /// Covariance xx, xy, xa, yy, ya, aa (m2, m rad, rad2) against the map, where it was matched.
    covariance: Option<[f64; 6]>,
}

/// What one way of localization made of a drive.
#[derive(Clone)]
pub struct Run {
    located: Vec<Located>,
    /// Where the frame of what was found is in that of the truth.
    frame: Pose,
    /// What the mapper tells of it, where there was one.
    pub report: Option<MapperReport>,
}

impl Run {
    /// Locates a drive, and closes its loops on the way or not.
    pub fn of(drive: &Drive, method: Method, close_loops: bool) -> Run {
        match method {
            Method::Wheels => Run::of_wheels(drive),
            Method::Matched { guided, reference } => Run::of_matching(drive, guided, reference, close_loops),
        }
    }

    fn of_wheels(drive: &Drive) -> Run {
        let mut odometry = PoseBuffer::default();
        drive.odometry.iter().for_each(|pose| _ = odometry.push(*pose));
        let known = drive.scans.iter().zip(&drive.truth).enumerate().filter_map(|(number, (scan, truth))| {
            let found = odometry.at(scan.stamp_ns, i64::MAX).ok()?;
            Some(Located { number, found, truth: *truth, covariance: None })
        });
        Run { located: known.collect(), frame: Pose::identity(), report: None }
    }

    fn of_matching(drive: &Drive, guided: bool, reference: Reference, close_loops: bool) -> Run {
        let settings = MapperSettings {
            // The grid has no part in it, and this one is quick.
            mapper: MapperKind::Visits,
            poses: PoseUse::Odometry,
            mount: drive.mount,
            localize: LocalizeSettings { reference, ..LocalizeSettings::default() },
            close_loops,
            ..MapperSettings::default()
        };
        let mut mapper = Mapper::new(settings);
        let mut odometry = drive.odometry.iter().filter(|_| guided).peekable();
        let (mut located, mut number): (Vec<Located>, _) = (Vec::new(), 0);
        let mut take = |mapper: &mut Mapper| {
            while let Some(outcome) = mapper.next_outcome() {
                match outcome {
                    Outcome::Inserted { start: found, covariance, .. } => {
                        located.push(Located { number, found, truth: drive.truth[number], covariance });
                    }
                    Outcome::Skipped { .. } => {}
                    Outcome::Moved(moved) => {
                        for located in &mut located {
                            located.found = moved.at(drive.scans[located.number].stamp_ns) * located.found;
                            located.covariance = None;
                        }
                        continue;
                    }
                }
                number += 1;
            }
        };
        let mut do_tasks = |mapper: &mut Mapper, first: Option<Task>| {
            let mut task = first.or_else(|| mapper.next_task());
            while let Some(next) = task {
                mapper.take_back(next.run());
                task = mapper.next_task();
            }
            take(mapper);
        };
        for scan in &drive.scans {
            while let Some(pose) = odometry.next_if(|pose| pose.stamp_ns <= scan.end_ns() + 10_000_000) {
                mapper.on_pose(*pose);
            }
            mapper.on_scan(scan.clone());
            do_tasks(&mut mapper, None);
        }
        mapper.finish();
        let last = mapper.last_task();
        do_tasks(&mut mapper, last);
        // Without odometry the map begins at the first pose that was found.
        let frame = if guided { Pose::identity() } else { drive.truth[0] };
        Run { located, frame, report: Some(mapper.report()) }
    }

    /// The same with its loops closed, and what was closed.
    pub fn closed(&self, drive: &Drive) -> (Run, String) {
        let mount = drive.mount.pose();
        let mut loops = loops::Drive::default();
        let next = self.located.iter().skip(1).chain(self.located.last());
        let ways: Vec<f64> = self
            .located
            .iter()
            .zip(next)
            .map(|(Located { number, found: start, .. }, next)| {
                let scan = &drive.scans[*number];
                // The next scan begins a third later than this one ends.
                let end = interpolate(start, &next.found, 0.75);
                let middle = interpolate(start, &end, 0.5) * mount;
                loops.add(&middle, || {
                    let own = [*start, end].map(|pose| middle.inverse() * pose * mount);
                    let settings = LocalizeSettings::default();
                    let mut points = Points::default();
                    points.read(scan, own[0], own[1], settings.spacing, settings.points);
                    points
                })
            })
            .collect();
        let mut run = Run { report: None, ..self.clone() };
        let before = std::time::Instant::now();
        let found = loops.close(None);
        let words = format!("{found} ({:.1} s)", before.elapsed().as_secs_f64());
        if let Loops::Bent(correction) = &found {
            for (located, way) in run.located.iter_mut().zip(&ways) {
                located.found = correction.correct(*way, &located.found);
            }
        }
        run.located.iter_mut().for_each(|located| located.covariance = None);
        (run, words)
    }

    /// What was found, in the frame of the truth, and the truth.
    fn pairs(&self) -> Vec<(Pose, Pose)> {
        self.located.iter().map(|located| (self.frame * located.found, located.truth)).collect()
    }

    /// How far it is from the truth.
    pub fn error(&self) -> TrajectoryError {
        error(&self.pairs())
    }

    /// The covariance held against the error: squared deviations of what lies [`INCREMENT`] of way apart, by the covariances of
    /// both ends; 3 on average where these are true (NEES). What the map itself has drifted on that way is in the error.
    pub fn consistency(&self) -> Option<f64> {
        let (mut sum, mut count) = (0.0, 0);
        let mut way = 0.0;
        let ways: Vec<f64> = self
            .located
            .iter()
            .zip(self.located.iter().skip(1).chain(self.located.last()))
            .map(|(located, next)| {
                let before = way;
                way += (next.truth.translation.vector - located.truth.translation.vector).norm();
                before
            })
            .collect();
        for (from, begin) in self.located.iter().zip(&ways) {
            let Some(to) = self.located.get(ways.partition_point(|way| way - begin < INCREMENT)) else {
                break;
            };
            if let Some(deviations) = squared_deviations(from, to) {
                (sum, count) = (sum + deviations, count + 1);
            }
        }
        (count > 0).then(|| sum / f64::from(count))
    }

    /// Prints a line.
    pub fn print(&self, label: &str, mode: &str) {
        let TrajectoryError { raw, aligned, heading, end, max, jump } = self.error();
        print!(
            "{label:18} {mode:17} {raw:7.4} {aligned:7.4} {:7.3} {end:7.4} {max:7.4} {jump:7.4}",
            heading.to_degrees()
        );
        match self.report.as_ref().and_then(|report| Some((report, report.localization.as_ref()?))) {
            Some((report, localization)) => println!(
                " {:7.2} {:7.2} {:6} {:5} {:6.2}",
                localization.match_us.median / 1e3,
                localization.match_us.p99 / 1e3,
                report.scans_skipped.values().sum::<u64>(),
                localization.lost,
                self.consistency().unwrap_or(f64::NAN)
            ),
            None => println!(),
        }
    }

    /// Writes what was found and the truth as NAME.tum and NAME.truth.tum.
    pub fn write(&self, drive: &Drive, folder: &Path, name: &str) -> Result<()> {
        std::fs::create_dir_all(folder)?;
        let write = |file: String, of: fn(&(Pose, Pose)) -> &Pose| -> Result<()> {
            let mut file = std::io::BufWriter::new(std::fs::File::create(folder.join(file))?);
            for (located, pair) in self.located.iter().zip(self.pairs()) {
                let pose = of(&pair);
                let half = pose.rotation.angle() / 2.0;
                writeln!(
                    file,
                    "{:.9} {:.6} {:.6} 0 0 0 {:.9} {:.9}",
                    drive.scans[located.number].stamp_ns as f64 * 1e-9,
                    pose.translation.x,
                    pose.translation.y,
                    half.sin(),
                    half.cos()
                )?;
            }
            Ok(())
        };
        write(format!("{name}.tum"), |pair| &pair.0)?;
        write(format!("{name}.truth.tum"), |pair| &pair.1)
    }
}

/// The error of the way from one pose to another in deviations of both poses' covariances, squared.
fn squared_deviations(from: &Located, to: &Located) -> Option<f64> {
    let way = from.found.inverse() * to.found;
    let error = difference(&way, &(from.truth.inverse() * to.truth));
    // How the way, in the frame of its beginning, changes with x, y and heading of either end in the map.
    let turn = from.found.rotation.inverse().to_rotation_matrix();
    let across = Vector2::new(way.translation.y, -way.translation.x);
    let mut of_to = Matrix3::identity();
    of_to.fixed_view_mut::<2, 2>(0, 0).copy_from(turn.matrix());
    let mut of_from = -of_to;
    of_from.fixed_view_mut::<2, 1>(0, 2).copy_from(&across);
    let covariance = of_from * matrix(from.covariance?) * of_from.transpose()
        + of_to * matrix(to.covariance?) * of_to.transpose();
    Some(error.dot(&(covariance.try_inverse()? * error)))
}

/// Of xx, xy, xa, yy, ya, aa.
fn matrix([xx, xy, xa, yy, ya, aa]: [f64; 6]) -> Matrix3<f64> {
    Matrix3::new(xx, xy, xa, xy, yy, ya, xa, ya, aa)
}

#[cfg(test)]
mod tests {
    use super::*;
    use visagged::pose::pose;

    #[test]
    fn methods_have_the_names_that_they_are_called_by() {
        for name in ["wheels", "odometry", "ranges", "standard-odometry", "standard-ranges"] {
            assert_eq!(name.parse::<Method>().map(Method::name).as_deref(), Ok(name));
        }
        assert!("legs".parse::<Method>().unwrap_err().contains("standard-ranges"));
    }

    /// One end is turned by a deviation: 5 m on that is one of 5 cm across, which the other end does not explain.
    #[test]
    fn an_error_of_one_deviation_counts_one() {
        let truth = pose(1.0, 2.0, 0.7);
        let onward = truth * pose(5.0, 0.0, 0.0);
        let located = |found: Pose, truth: Pose, covariance: [f64; 6]| Located {
            number: 0,
            found,
            truth,
            covariance: Some(covariance),
        };
        let to = located(onward, onward, [1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6]);
        let from = located(truth * pose(0.0, 0.0, 0.01), truth, [1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-4]);
        let deviations = squared_deviations(&from, &to).unwrap();
        assert!((deviations - 1.0).abs() < 0.05, "{deviations}");
        let aside = located(truth * pose(0.0, 0.02, 0.0), truth, [1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-8]);
        let deviations = squared_deviations(&aside, &to).unwrap();
        assert!((deviations - 4.0).abs() < 0.2, "{deviations}");
    }
}
