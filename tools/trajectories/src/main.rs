//! Where the mapper thinks that it was, against where it was, beside plain odometry: simulated drives, a line each.

mod drive;
mod error;
mod put_down;
mod run;
mod table;

use anyhow::Result;
use clap::Parser;
use drive::{Drive, Trouble};
use run::{Method, Run};
use scipsim::World;
use std::path::PathBuf;

/// Measures trajectories on simulated drives.
#[derive(Parser)]
struct Arguments {
    /// Worlds, shipped or files.
    #[arg(default_values_t = ["hall", "glass-corridor", "showcases", "busy-lobby", "office-loop"].map(String::from))]
    worlds: Vec<String>,
    /// Seeds of the noise.
    #[arg(long, value_delimiter = ',', default_value = "1,2,3")]
    seeds: Vec<u64>,
    /// Kinds of localization: wheels (odometry alone), odometry (matching with it), ranges (matching without); the latter two
    /// with a standard grid in the place of our matching map: standard-odometry, standard-ranges.
    #[arg(long, value_delimiter = ',', default_value = "wheels,odometry,ranges")]
    modes: Vec<Method>,
    /// Seconds of the drive that are left out at its start, so that it begins at speed.
    #[arg(long, default_value_t = 0.0)]
    skip: f64,
    /// Share of scans that are lost.
    #[arg(long, default_value_t = 0.0)]
    lost_scans: f64,
    /// Share of returns that are random.
    #[arg(long, default_value_t = 0.0)]
    random_returns: f64,
    /// Let what is to the left seem too far by this part, and what is to the right too near: walls are bent, and a drive with them.
    #[arg(long, default_value_t = 0.0)]
    bent: f64,
    /// Drive each path so many times.
    #[arg(long)]
    laps: Option<usize>,
    /// Leave out the odometry of every second second.
    #[arg(long)]
    half_odometry: bool,
    /// Let the wheels slip by 20 % for one second in ten.
    #[arg(long)]
    slip: bool,
    /// Print all that matters as a table instead, the worst of all seeds and starts.
    #[arg(long, conflicts_with_all = ["modes", "skip", "lost_scans", "random_returns", "bent", "laps", "half_odometry", "slip", "optimize", "tum"])]
    table: bool,
    /// Print two more lines for each, with its loops closed afterwards, as `visagged replay --optimize` does, and on the way, as
    /// `visagged` does.
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
    let mut worlds: Vec<World> =
        arguments.worlds.iter().map(|name| World::load(name)).collect::<Result<_, _>>()?;
    if let Some(laps) = arguments.laps {
        worlds.iter_mut().for_each(|world| world.robot.laps = laps);
    }
    if let Some(places) = arguments.put_down {
        let (seeds, seconds) = (&arguments.seeds, arguments.seconds);
        return put_down::run(&worlds, seeds, places, seconds, arguments.stand);
    }
    if arguments.table {
        return table::run(&worlds, &arguments.seeds);
    }
    let trouble = Trouble {
        lost_scans: arguments.lost_scans,
        random_returns: arguments.random_returns,
        bent: arguments.bent,
        half_odometry: arguments.half_odometry,
        slip: arguments.slip,
        skip: arguments.skip,
    };
    println!(
        "{:18} {:17} {:>7} {:>7} {:>7} {:>7} {:>7} {:>7} {:>7} {:>7} {:>6} {:>5} {:>6}",
        "world",
        "mode",
        "raw m",
        "aligned",
        "head °",
        "end m",
        "max m",
        "jump m",
        "ms",
        "p99 ms",
        "skip",
        "lost",
        "NEES"
    );
    for world in &worlds {
        for &seed in &arguments.seeds {
            let drive = Drive::new(world, seed, trouble);
            for method in &arguments.modes {
                let label = format!("{} {seed}", world.name);
                let mode = method.name();
                let run = Run::of(&drive, *method, false);
                run.print(&label, &mode);
                if arguments.optimize {
                    let (closed, words) = run.closed(&drive);
                    closed.print(&label, "closed");
                    println!("    {words}");
                    let on_the_way = Run::of(&drive, *method, true);
                    on_the_way.print(&label, "closed on the way");
                    if let Some(loops) = on_the_way.report.and_then(|report| report.loops) {
                        let closed =
                            loops.last.map_or_else(|| "nothing was closed".into(), |last| last.to_string());
                        println!(
                            "    {closed}; {} searches, {} scans and {:.0} MB kept",
                            loops.searches,
                            loops.scans_kept,
                            loops.bytes as f64 / 1e6
                        );
                    }
                }
                if let Some(folder) = &arguments.tum {
                    run.write(&drive, folder, &format!("{}-{mode}", label.replace(' ', "-")))?;
                }
            }
        }
    }
    Ok(())
}
