//! The program `scipsim`: serves a simulated scanner, or writes down what it would send.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use scipsim::device::capture::capture;
use scipsim::device::{Responder, SpawnOptions, Transport, spawn};
use scipsim::generate::KINDS;
use scipsim::{Simulation, World, picture};

/// A simulated Hokuyo laser scanner in a 2-D world.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Serves a scanner in real time, on a pty unless --tcp is given.
    Serve {
        /// A shipped world, or a TOML file; settings may follow: `hall?seed=3&speed=0.5`.
        world: String,
        /// Makes this symbolic link to the pty.
        #[arg(long, value_name = "PATH", conflicts_with = "tcp")]
        pty_link: Option<PathBuf>,
        /// Serves on this TCP address, as an Ethernet model.
        #[arg(long, value_name = "HOST:PORT")]
        tcp: Option<SocketAddr>,
        /// Sends poses to unix:PATH or udp://HOST:PORT.
        #[arg(long, value_name = "ADDRESS")]
        poses: Option<String>,
        /// Ends when the drive has ended.
        #[arg(long)]
        once: bool,
        /// Further settings, such as `--set seed=3`; an unknown one lists them all.
        #[arg(long = "set", value_name = "KEY=VALUE")]
        settings: Vec<String>,
    },
    /// Writes a whole drive, as fast as it can be computed: capture.scip (what the device sends after ME),
    /// poses.tum (reported) and truth.tum (true), on the device's clock, truth.csv and truth.png.
    Capture {
        /// A shipped world, or a TOML file; settings may follow: `hall?seed=3&speed=0.5`.
        world: String,
        /// Folder for the files.
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
        /// Seed of all noise.
        #[arg(long)]
        seed: Option<u64>,
        /// Further settings, such as `--set lean=1`.
        #[arg(long = "set", value_name = "KEY=VALUE")]
        settings: Vec<String>,
    },
    /// Lists the shipped worlds and the kinds that can be generated.
    Worlds,
    /// Prints a world as TOML, to be changed.
    Show {
        /// A shipped world, or a TOML file.
        world: String,
    },
    /// Prints a generated world as TOML.
    Generate {
        /// Kind of the world; see `scipsim worlds`.
        kind: String,
        /// Seed of the world.
        #[arg(long, default_value_t = 1)]
        seed: u64,
    },
}

fn main() -> Result<()> {
    match Arguments::parse().command {
        Command::Serve { world, pty_link, tcp, poses, once, settings } => {
            let mut options = read_options(&world, &settings)?;
            if let Some(link) = pty_link {
                options.transport = Transport::Pty { link: Some(link) };
            }
            if let Some(address) = tcp {
                options.transport = Transport::Tcp(address);
                options.device.profile = scipsim::device::Profile::Ethernet;
            }
            options.poses_to = poses.map(|a| a.parse()).transpose().map_err(anyhow::Error::msg)?;
            serve(options, once)
        }
        Command::Capture { world, out, seed, settings } => {
            let mut options = read_options(&world, &settings)?;
            options.simulation.seed = seed.unwrap_or(options.simulation.seed);
            write_capture(options, &out)
        }
        Command::Worlds => {
            list_worlds();
            Ok(())
        }
        Command::Show { world } => {
            print!("{}", World::load(&world)?.to_toml());
            Ok(())
        }
        Command::Generate { kind, seed } => {
            print!("{}", World::generate(&kind, seed)?.to_toml());
            Ok(())
        }
    }
}

fn read_options(world: &str, settings: &[String]) -> Result<SpawnOptions> {
    let mut options = SpawnOptions::from_url(world)?;
    for setting in settings {
        let (key, value) =
            setting.split_once('=').with_context(|| format!("--set {setting}: give it as KEY=VALUE"))?;
        options.set(key, value).map_err(anyhow::Error::msg)?;
    }
    Ok(options)
}

fn serve(options: SpawnOptions, once: bool) -> Result<()> {
    let name = options.world.name.clone();
    let running = spawn(options)?;
    let seconds = running.simulation().duration_ns() as f64 * 1e-9;
    println!("{}", running.port());
    eprintln!("{name}: a drive of {seconds:.0} s, beginning with the first scan that is asked for");
    while !(once && running.finished()) {
        std::thread::sleep(Duration::from_millis(100));
    }
    running.stop();
    Ok(())
}

fn write_capture(mut options: SpawnOptions, out: &Path) -> Result<()> {
    options.simulation.keep_truth = true;
    let mut simulation = Simulation::new(&options.world, options.simulation.clone());
    let scans = simulation.by_ref().count();
    let truth = simulation.truth();
    let duration_ns = simulation.duration_ns();
    let simulation = Arc::new(simulation);
    let device = Responder::new(options.device, Arc::clone(&simulation), 0);
    // A rotation more at the start, and time for the last scan to leave.
    let until_ns = duration_ns + 3 * simulation.period_ns();
    let (bytes, device) = capture(device, "ME0000108001000", until_ns);
    let start_ns = device.drive_start_ns().context("the device sent no scan")?;
    // Stamps of scans are whole milliseconds of the device's clock; so the poses are put on that clock.
    let start_ms = device.clock_ms(start_ns);

    std::fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
    let write = |name: &str, bytes: &[u8]| {
        let path = out.join(name);
        std::fs::write(&path, bytes).with_context(|| format!("cannot write {}", path.display()))
    };
    write("capture.scip", &bytes)?;
    let reported = simulation.reported_poses(0, duration_ns + 2 * simulation.period_ns());
    let tum = |poses: &mut dyn Iterator<Item = (i64, scipsim::drive::Pose)>| {
        poses
            .map(|(t_ns, pose)| tum_line(f64::from(start_ms) * 1e-3 + t_ns as f64 * 1e-9, pose))
            .collect::<String>()
    };
    write("poses.tum", tum(&mut reported.iter().map(|p| (p.t_ns, p.pose))).as_bytes())?;
    write("truth.tum", tum(&mut reported.iter().map(|p| (p.t_ns, simulation.true_pose(p.t_ns)))).as_bytes())?;
    write("truth.csv", picture::truth_csv(&truth).as_bytes())?;
    write("truth.png", &picture::truth_png(&truth)?)?;
    eprintln!(
        "{}: {scans} scans, {:.1} s; the scanner stands at {:?} on the robot",
        out.display(),
        duration_ns as f64 * 1e-9,
        [
            simulation.mount().translation.x,
            simulation.mount().translation.y,
            simulation.mount().rotation.angle()
        ],
    );
    Ok(())
}

/// `time x y z qx qy qz qw`.
fn tum_line(time: f64, pose: scipsim::drive::Pose) -> String {
    let (at, half) = (pose.translation.vector, pose.rotation.angle() / 2.0);
    format!("{time:.6} {:.6} {:.6} 0 0 0 {:.9} {:.9}\n", at.x, at.y, half.sin(), half.cos())
}

fn list_worlds() {
    for name in World::shipped() {
        if let Ok(world) = World::load(name) {
            println!("{name:16} {}", world.description);
        }
    }
    println!();
    for (kind, description) in KINDS {
        println!("generate {kind:10} {description}");
    }
}
