//! What inserting a scan costs, beside a bare ray walk over the same scans in the same run, and beside other mappers where
//! they are installed (tools/peers).
//!
//! `cargo bench --bench insert` drives the 20 m hall, the office loop and an office floor of 120 x 60 m in the simulator. The
//! machine may be noisy: what counts is the last column, how many times faster than the ray walk. Each scan is measured by
//! itself, in CPU time of the thread; the rounds alternate between the contestants, and each scan counts with its fastest round.
//!
//! `cargo bench --bench insert -- WORLD` does that for one world; `-- WORLD visagge` runs one contestant, once: for a profiler.
//! `-- WORLD asked` asks for a map each second of the drive and tells what these take.
//! `-- WORLD hours` drives through it for eight hours, as fast as it can, and tells each hour what memory the process holds.

mod laid;

use laid::Laid;
use nalgebra::Point2;
use rustix::time::{ClockId, clock_gettime};
use scipsim::{SimulationOptions, World};
use std::{
    fs::File,
    hint::black_box,
    io::{BufWriter, Write},
    path::Path,
    process::Command,
};
use visagged::{
    grid::{
        standard::Standard,
        sweep::Sweep,
        visagge::{Visagge, VisaggeSettings},
    },
    scan::Scan,
};

/// Side of a cell (m), as in the paper.
const RESOLUTION: f64 = 0.05;
const ROUNDS: usize = 3;
/// Scans between two maps: five seconds.
const MAP_EVERY: usize = 200;
/// Scans in a second.
const SECOND: usize = 40;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    match arguments.as_slice() {
        [world, who] if who == "hours" => hours(world),
        [world, who] if who == "asked" => asked(world, &laid(world)),
        [world, who] => {
            let laid = laid(world);
            let times = contestant(who).expect("raywalk, visagge, portable, maps or standard")(&laid);
            println!("{world} {who}: {} scans, median {:.1} us", laid.len(), quantile(&times, 0.5));
        }
        [world] => compare(world),
        _ => ["hall", "office-loop", "floor-1"].into_iter().for_each(compare),
    }
}

/// The scans of a drive in the world of this name.
fn laid(world: &str) -> Vec<Laid> {
    let world = match world.rsplit_once('-').and_then(|(kind, seed)| Some((kind, seed.parse().ok()?))) {
        Some((kind, seed)) => World::generate(kind, seed),
        None => World::load(world),
    }
    .expect("the name of a world");
    laid::laid(&world, SimulationOptions::default())
}

/// Takes the scans one by one and gives the CPU time of each (us).
type Contestant = fn(&[Laid]) -> Vec<f64>;

fn contestant(name: &str) -> Option<Contestant> {
    Some(match name {
        "raywalk" => |laid| {
            let mut walk = RayWalk::around(laid);
            timed(laid, |_, sweep| walk.insert(sweep))
        },
        "visagge" => |laid| {
            let mut grid = Visagge::new(RESOLUTION, VisaggeSettings::default());
            timed(laid, |_, sweep| grid.insert(sweep))
        },
        "portable" => |laid| {
            let mut grid = Visagge::new(RESOLUTION, VisaggeSettings::default());
            timed(laid, |_, sweep| grid.insert_portably(sweep))
        },
        "maps" => |laid| {
            let mut grid = Visagge::new(RESOLUTION, VisaggeSettings::default());
            let mut last = None;
            timed(laid, |number, sweep| {
                grid.insert(sweep);
                if number % MAP_EVERY == MAP_EVERY - 1 {
                    black_box(last.replace(grid.snapshot()));
                }
            })
        },
        "standard" => |laid| {
            let mut grid = Standard::new(RESOLUTION, 30.0);
            timed(laid, |_, sweep| grid.insert(sweep))
        },
        _ => return None,
    })
}

fn timed(laid: &[Laid], mut insert: impl FnMut(usize, &Sweep)) -> Vec<f64> {
    let time = |(number, (scan, start, end)): (usize, &Laid)| {
        let sweep = Sweep { scan, start: *start, end: *end };
        let before = cpu_us();
        insert(number, &sweep);
        cpu_us() - before
    };
    laid.iter().enumerate().map(time).collect()
}

/// A map each second of the drive, as in the daemon: what each takes, and what that is for a scan.
fn asked(world: &str, laid: &[Laid]) {
    let mut grid = Visagge::new(RESOLUTION, VisaggeSettings::default());
    let (mut maps, mut last) = (Vec::new(), None);
    let begun = cpu_us();
    for (number, (scan, start, end)) in laid.iter().enumerate() {
        grid.insert(&Sweep { scan, start: *start, end: *end });
        if number % SECOND == SECOND - 1 {
            let before = cpu_us();
            black_box(last.replace(grid.snapshot()));
            maps.push((cpu_us() - before) / 1e3);
        }
    }
    let a_scan = (cpu_us() - begun) / laid.len().max(1) as f64;
    let mean = maps.iter().sum::<f64>() / maps.len().max(1) as f64;
    println!(
        "{world}, a map each second: {mean:.1} ms each (median {:.1}, p99 {:.1}), {a_scan:.0} us a scan with them",
        quantile(&maps, 0.5),
        quantile(&maps, 0.99)
    );
    println!("{world}: {:.2} MB", grid.bytes() as f64 / 1e6);
}

/// Eight hours of scans at 40 Hz, lap after lap, with a map each half minute as in the daemon.
fn hours(world: &str) {
    const HOUR: usize = 3600 * 40;
    let laid = laid(world);
    let mut grid = Visagge::new(RESOLUTION, VisaggeSettings::default());
    let mut last = None;
    for (number, (scan, start, end)) in laid.iter().cycle().take(8 * HOUR + 1).enumerate() {
        if number % HOUR == 0 {
            let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
            let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap_or("?").trim();
            println!(
                "{world}, {} h: {resident} resident, map {:.2} MB",
                number / HOUR,
                grid.bytes() as f64 / 1e6
            );
        }
        let scan = Scan { seq: number as u64, stamp_ns: number as i64 * 25_000_000, ..scan.clone() };
        grid.insert(&Sweep { scan: &scan, start: *start, end: *end });
        if number % 1200 == 1199 {
            black_box(last.replace(grid.snapshot()));
        }
    }
}

fn compare(world: &str) {
    let laid = laid(world);
    let rows = [
        ("bare ray walk", "raywalk", ROUNDS),
        ("visagge", "visagge", ROUNDS),
        ("visagge, portable instructions", "portable", ROUNDS),
        ("visagge, each 200th scan with map", "maps", 1),
        ("standard grid", "standard", 1),
    ];
    let mut best: [Vec<f64>; 5] = Default::default();
    for round in 0..ROUNDS {
        for ((_, who, rounds), best) in rows.iter().zip(&mut best) {
            if round < *rounds {
                let times = contestant(who).expect("named above")(&laid);
                if best.is_empty() {
                    *best = times;
                } else {
                    best.iter_mut().zip(times).for_each(|(best, time)| *best = best.min(time));
                }
            }
        }
    }
    let walk = quantile(&best[0], 0.5);
    let row = |name: &str, times: &[f64]| {
        let (median, p99, most) = (quantile(times, 0.5), quantile(times, 0.99), quantile(times, 1.0));
        let mean = times.iter().sum::<f64>() / times.len().max(1) as f64;
        println!(
            "{name:34} {median:9.1} {mean:9.1} {p99:9.1} {most:9.1} {:7.2} {:9.2}",
            p99 / median,
            walk / median
        );
    };
    let mut grid = Visagge::new(RESOLUTION, VisaggeSettings::default());
    timed(&laid, |_, sweep| grid.insert(sweep));
    println!(
        "{world}: {} scans, {} cell visits a scan by ray walk; the map takes {:.2} MB",
        laid.len(),
        visits(&laid),
        grid.bytes() as f64 / 1e6
    );
    println!(
        "{:34} {:>9} {:>9} {:>9} {:>9} {:>7} {:>9}",
        "us a scan", "median", "mean", "p99", "max", "p99/med", "vs walk"
    );
    rows.iter().zip(&best).for_each(|((name, ..), times)| row(name, times));
    peers(&laid).iter().for_each(|(name, times)| row(name, times));
    println!();
}

/// Those of the other mappers that could be built: the least time that each scan took (us). OctoMap, which is slow, gets few
/// scans and one round.
fn peers(laid: &[Laid]) -> Vec<(&'static str, Vec<f64>)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let programs = root.join("target/peers");
    let built = Command::new(root.join("tools/peers/build")).arg(&programs).status();
    let Ok(file) = tempfile::NamedTempFile::new() else { return Vec::new() };
    if !built.is_ok_and(|built| built.success()) || write_scans(laid, file.path()).is_err() {
        return Vec::new();
    }
    let run = |(name, program, rounds, scans): (&'static str, &str, usize, usize)| {
        let mut command = Command::new(programs.join(program));
        let output = command.arg(file.path()).args([rounds, scans].map(|n| n.to_string())).output().ok()?;
        let times: Option<Vec<f64>> =
            String::from_utf8(output.stdout).ok()?.lines().map(|line| line.parse().ok()).collect();
        Some((name, times.filter(|times| output.status.success() && !times.is_empty())?))
    };
    [("MRPT's grid", "mrpt", ROUNDS, usize::MAX), ("OctoMap, its first 300 scans", "octomap", 1, 300)]
        .into_iter()
        .filter_map(run)
        .collect()
}

/// Writes the scans as tools/peers/scans.hpp reads them: each taken at one place, since none of these knows better.
fn write_scans(laid: &[Laid], path: &Path) -> std::io::Result<()> {
    let mut file = BufWriter::new(File::create(path)?);
    let Some((first, ..)) = laid.first() else { return Ok(()) };
    file.write_all(&(first.ranges.len() as u32).to_le_bytes())?;
    for angle in [first.geometry.angle_min, first.geometry.angle_increment] {
        file.write_all(&(angle as f32).to_le_bytes())?;
    }
    for (scan, start, end) in laid {
        let middle = start.lerp_slerp(end, 0.5);
        for number in [middle.translation.x, middle.translation.y, middle.rotation.angle()] {
            file.write_all(&number.to_le_bytes())?;
        }
        for range in &scan.ranges {
            let range = if *range > 0.0 && *range <= 30.0 { *range } else { 0.0 };
            file.write_all(&range.to_le_bytes())?;
        }
    }
    file.flush()
}

fn visits(laid: &[Laid]) -> usize {
    let mut walk = RayWalk::around(laid);
    for (scan, start, end) in laid {
        walk.insert(&Sweep { scan, start: *start, end: *end });
    }
    walk.visits / laid.len().max(1)
}

fn quantile(times: &[f64], part: f64) -> f64 {
    let mut sorted = times.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[((sorted.len() - 1) as f64 * part) as usize]
}

/// CPU time of this thread (us).
fn cpu_us() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 * 1e6 + time.tv_nsec as f64 / 1e3
}

/// The least that a grid with rays can do: 16.16 fixed point, one cell a step, one byte added in each.
/// The grid is dense, made large enough beforehand, and knows nothing but that one number.
struct RayWalk {
    cells: Vec<i8>,
    /// Rows are so many cells apart: an odd number of cache lines, since rows a power of two apart would contend for the same ones.
    stride: i32,
    origin: Point2<f64>,
    visits: usize,
}

impl RayWalk {
    /// A grid that holds all the scans.
    fn around(laid: &[Laid]) -> RayWalk {
        let (mut low, mut high) = (Point2::new(f64::MAX, f64::MAX), Point2::new(f64::MIN, f64::MIN));
        for (scan, start, end) in laid {
            let sweep = Sweep { scan, start: *start, end: *end };
            for ((origin, direction), range) in sweep.beams().zip(&scan.ranges) {
                let (_, range) = reach(*range);
                for point in [origin, origin + direction * range] {
                    (low, high) = (low.inf(&point), high.sup(&point));
                }
            }
        }
        let cells = |length: f64| (length / RESOLUTION) as usize + 3;
        let stride = (cells(high.x - low.x) / 64) | 1;
        let stride = (stride + 2) * 64;
        let margin = nalgebra::Vector2::new(RESOLUTION, RESOLUTION);
        RayWalk {
            cells: vec![0; cells(high.y - low.y) * stride],
            stride: stride as i32,
            origin: low - margin,
            visits: 0,
        }
    }

    fn insert(&mut self, sweep: &Sweep) {
        let scale = 65_536.0 / RESOLUTION;
        for ((origin, direction), &range) in sweep.beams().zip(&sweep.scan.ranges) {
            let (returned, range) = reach(range);
            let (from, way) = ((origin - self.origin) * scale, direction * (range * scale));
            let steps = (way.x.abs().max(way.y.abs()) / 65_536.0) as usize;
            let (mut x, mut y) = (from.x as i32, from.y as i32);
            let step = way / steps.max(1) as f64;
            let (dx, dy) = (step.x as i32, step.y as i32);
            for _ in 0..steps {
                let cell = &mut self.cells[((y >> 16) * self.stride + (x >> 16)) as usize];
                *cell = cell.saturating_sub(1);
                (x, y) = (x + dx, y + dy);
            }
            if returned {
                let cell = &mut self.cells[((y >> 16) * self.stride + (x >> 16)) as usize];
                *cell = cell.saturating_add(3);
            }
            self.visits += steps;
        }
    }
}

/// Whether there is a return, and how far the beam is free (m): the same limits as in the grid.
fn reach(range: f32) -> (bool, f64) {
    let range = f64::from(range);
    if range > 0.0 && range <= 30.0 { (true, range) } else { (false, if range > 30.0 { 5.0 } else { 0.0 }) }
}
