//! Where the mapper thinks that it was, against where it was, beside plain odometry: simulated drives, a line each.

mod drive;
mod error;
mod put_down;

use anyhow::Result;
use clap::Parser;
use drive::{Drive, Trouble};
use error::{TrajectoryError, error};
use nalgebra::{Matrix3, Vector3};
use scipsim::World;
use std::{io::Write, path::Path, path::PathBuf};
use visagged::{
    localize::{
        LocalizeSettings,
        loops::{self, Loops},
        matcher::difference,
        points::Points,
    },
    mapper::{Mapper, MapperKind, MapperReport, MapperSettings, Outcome, PoseUse},
    pose::{Pose, PoseBuffer, interpolate},
};

/// Measures trajectories on simulated drives.
#[derive(Parser)]
struct Arguments {
    /// Worlds, shipped or files.
    #[arg(default_values_t = ["hall", "glass-corridor", "showcases", "busy-lobby", "office-loop"].map(String::from))]
    worlds: Vec<String>,
    /// Seeds of the noise.
    #[arg(long, value_delimiter = ',', default_value = "1,2,3")]
    seeds: Vec<u64>,
    /// Kinds of localization: wheels (odometry alone), odometry (matching with it), ranges (matching without).
    #[arg(long, value_delimiter = ',', default_value = "wheels,odometry,ranges")]
    modes: Vec<String>,
    /// Seconds of the drive that are left out at its start, so that it begins at speed.
    #[arg(long, default_value_t = 0.0)]
    skip: f64,
    /// Share of scans that are lost.
    #[arg(long, default_value_t = 0.0)]
    lost_scans: f64,
    /// Share of returns that are random.
    #[arg(long, default_value_t = 0.0)]
    random_returns: f64,
    /// Leave out the odometry of every second second.
    #[arg(long)]
    half_odometry: bool,
    /// Let the wheels slip by 20 % for one second in ten.
    #[arg(long)]
    slip: bool,
    /// Grid that is kept meanwhile.
    #[arg(long, default_value = "standard", value_parser = ["visagge", "standard"])]
    mapper: String,
    /// Close the loops afterwards, as `visagged replay --optimize` does, and print a second line for each.
    #[arg(long)]
    optimize: bool,
    /// Instead of all that: put a robot down at so many random places of each world's map, to find out where it is.
    #[arg(long, value_name = "PLACES")]
    put_down: Option<u32>,
    /// Seconds that it may take to; it stands for a second and then drives.
    #[arg(long, default_value_t = 20.0)]
    seconds: f64,
    /// Let it stand all the time.
    #[arg(long)]
    stand: bool,
    /// Folder for the trajectories in TUM format, for evo: NAME.tum and NAME.truth.tum.
    #[arg(long)]
    tum: Option<PathBuf>,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    if let Some(places) = arguments.put_down {
        return put_down::run(
            &arguments.worlds,
            &arguments.seeds,
            places,
            arguments.seconds,
            arguments.stand,
        );
    }
    let trouble = Trouble {
        lost_scans: arguments.lost_scans,
        random_returns: arguments.random_returns,
        half_odometry: arguments.half_odometry,
        slip: arguments.slip,
        skip: arguments.skip,
    };
    println!(
        "{:18} {:8} {:>7} {:>7} {:>7} {:>7} {:>7} {:>7} {:>7} {:>6} {:>5} {:>6}",
        "world",
        "mode",
        "raw m",
        "aligned",
        "head °",
        "end m",
        "max m",
        "ms",
        "p99 ms",
        "skip",
        "lost",
        "NEES"
    );
    for name in &arguments.worlds {
        let world = World::load(name)?;
        for &seed in &arguments.seeds {
            let drive = Drive::new(&world, seed, trouble);
            for mode in &arguments.modes {
                let label = format!("{} {seed}", Path::new(name).file_stem().unwrap_or_default().display());
                let run = Run::of(&drive, mode, &arguments.mapper);
                run.print(&label, mode);
                if arguments.optimize {
                    let (closed, words) = run.closed(&drive);
                    closed.print(&label, "closed");
                    println!("    {words}");
                }
                if let Some(folder) = &arguments.tum {
                    run.write(folder, &format!("{}-{mode}", label.replace(' ', "-")))?;
                }
            }
        }
    }
    Ok(())
}

/// An error (m, m, rad) in deviations of a covariance xx, xy, xa, yy, ya, aa, squared.
fn squared_deviations([xx, xy, xa, yy, ya, aa]: [f64; 6], error: &Vector3<f64>) -> Option<f64> {
    let information = Matrix3::new(xx, xy, xa, xy, yy, ya, xa, ya, aa).try_inverse()?;
    Some(error.dot(&(information * error)))
}

/// What one way of localization made of a drive.
#[derive(Clone)]
struct Run {
    /// Moments (ns), estimated and true poses.
    stamps_ns: Vec<i64>,
    pairs: Vec<(Pose, Pose)>,
    /// Number of the scan of each pair, and its pose as it was found.
    located: Vec<(usize, Pose)>,
    report: Option<MapperReport>,
    /// Squared deviations of the error of each pose, by the covariance that came with it: NEES, 3 where that is true.
    deviations: Vec<f64>,
}

impl Run {
    fn of(drive: &Drive, mode: &str, grid: &str) -> Run {
        match mode {
            "wheels" => Run::of_wheels(drive),
            _ => Run::of_matching(drive, mode != "ranges", grid),
        }
    }

    fn of_wheels(drive: &Drive) -> Run {
        let mut odometry = PoseBuffer::default();
        drive.odometry.iter().for_each(|pose| _ = odometry.push(*pose));
        let known = drive.scans.iter().zip(&drive.truth).enumerate().filter_map(|(number, (scan, truth))| {
            let pose = odometry.at(scan.stamp_ns, i64::MAX).ok()?;
            Some((scan.stamp_ns, ((pose, *truth), (number, pose))))
        });
        let (stamps_ns, (pairs, located)) = known.unzip();
        Run { stamps_ns, pairs, located, report: None, deviations: Vec::new() }
    }

    fn of_matching(drive: &Drive, with_odometry: bool, grid: &str) -> Run {
        let mapper = if grid == "visagge" { MapperKind::Visagge } else { MapperKind::Standard };
        let settings =
            MapperSettings { mapper, poses: PoseUse::Odometry, mount: drive.mount, ..Default::default() };
        let mut mapper = Mapper::new(settings);
        let mut odometry = drive.odometry.iter().filter(|_| with_odometry).peekable();
        // Without odometry the map begins at the first pose that was found.
        let first = if with_odometry { Pose::identity() } else { drive.truth[0] };
        let (mut stamps_ns, mut pairs, mut located, mut next) = (Vec::new(), Vec::new(), Vec::new(), 0);
        let mut deviations = Vec::new();
        let mut take = |mapper: &mut Mapper| {
            while let Some(outcome) = mapper.next_outcome() {
                if let Outcome::Inserted { stamp_ns, start, covariance, .. } = outcome {
                    let error = difference(&(first * start), &drive.truth[next]);
                    deviations
                        .extend(covariance.and_then(|covariance| squared_deviations(covariance, &error)));
                    stamps_ns.push(stamp_ns);
                    pairs.push((first * start, drive.truth[next]));
                    located.push((next, start));
                }
                next += 1;
            }
        };
        for scan in &drive.scans {
            while let Some(pose) = odometry.next_if(|pose| pose.stamp_ns <= scan.end_ns() + 10_000_000) {
                mapper.on_pose(*pose);
            }
            mapper.on_scan(scan.clone());
            take(&mut mapper);
        }
        mapper.finish();
        take(&mut mapper);
        Run { stamps_ns, pairs, located, report: Some(mapper.report()), deviations }
    }

    /// The same with its loops closed, and what was closed.
    fn closed(&self, drive: &Drive) -> (Run, String) {
        let mount = drive.mount.pose();
        let mut loops = loops::Drive::default();
        let poses = self.located.iter().map(|(_, pose)| pose);
        let next = poses.clone().skip(1).chain(poses.clone().next_back());
        let ways: Vec<f64> = self
            .located
            .iter()
            .zip(next)
            .map(|((number, start), next)| {
                let scan = &drive.scans[*number];
                // The next scan begins a third later than this one ends.
                let end = interpolate(start, next, 0.75);
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
        let found = loops.close();
        let words = format!("{found} ({:.1} s)", before.elapsed().as_secs_f64());
        if let Loops::Bent(correction) = &found {
            let pairs = run.pairs.iter_mut().zip(&self.located).zip(&ways);
            for ((pair, (_, start)), way) in pairs {
                let first = pair.0 * start.inverse();
                pair.0 = first * correction.correct(*way, start);
            }
        }
        (run, words)
    }

    fn print(&self, label: &str, mode: &str) {
        let TrajectoryError { raw, aligned, heading, end, max } = error(&self.pairs);
        print!(
            "{label:18} {mode:8} {raw:7.4} {aligned:7.4} {:7.3} {end:7.4} {max:7.4}",
            heading.to_degrees()
        );
        match self.report.as_ref().and_then(|report| Some((report, report.localization.as_ref()?))) {
            Some((report, localization)) => println!(
                " {:7.2} {:7.2} {:6} {:5} {:6.2}",
                localization.match_us.median / 1e3,
                localization.match_us.p99 / 1e3,
                report.scans_skipped.values().sum::<u64>(),
                localization.lost,
                self.deviations.iter().sum::<f64>() / self.deviations.len().max(1) as f64
            ),
            None => println!(),
        }
    }

    fn write(&self, folder: &Path, name: &str) -> Result<()> {
        std::fs::create_dir_all(folder)?;
        let write = |file: String, of: fn(&(Pose, Pose)) -> &Pose| -> Result<()> {
            let mut file = std::io::BufWriter::new(std::fs::File::create(folder.join(file))?);
            for (stamp_ns, pair) in self.stamps_ns.iter().zip(&self.pairs) {
                let pose = of(pair);
                let half = pose.rotation.angle() / 2.0;
                writeln!(
                    file,
                    "{:.9} {:.6} {:.6} 0 0 0 {:.9} {:.9}",
                    *stamp_ns as f64 * 1e-9,
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
