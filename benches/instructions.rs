//! How many instructions inserting a scan takes: a gate that does not depend on what else the machine does.
//!
//! `cargo bench --bench instructions` runs itself under callgrind (valgrind must be installed), over a small drive that never
//! changes, and fails where a count is not within [`MARGIN`] of the one that is kept in `benches/instructions.txt`: a gain is to
//! be kept, a loss to be explained. `cargo bench --bench instructions -- --update` keeps the new counts; other compilers and
//! processors make for other counts, so they are compared on the machine that CI runs on.

use anyhow::{Context, Result, bail, ensure};
use std::{
    collections::BTreeMap,
    f64::consts::{FRAC_PI_2, PI},
    path::Path,
    process::Command,
};
use visagged::{
    grid::{
        sweep::Sweep,
        visagge::{Visagge, VisaggeSettings},
    },
    pose::{Pose, pose},
    scan::{Geometry, Scan},
};

/// Part of a count by which it may differ from the one that is kept.
const MARGIN: f64 = 0.03;
const KEPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/instructions.txt");
const SCANS: usize = 400;
const BEAMS: usize = 1081;

type Insert = fn(&mut Visagge, &Sweep);

/// What is counted, and how a scan is inserted then.
const PATHS: [(&str, Insert); 2] = [("widest", Visagge::insert), ("portable", Visagge::insert_portably)];
/// The drive alone.
const NOTHING: (&str, Insert) = ("nothing", |_, _| ());

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["drive", path] => {
            let (_, insert) =
                PATHS.into_iter().chain([NOTHING]).find(|(name, _)| name == path).context("no such path")?;
            drive(insert);
            Ok(())
        }
        [] => compare(false),
        ["--update"] => compare(true),
        _ => bail!("usage: cargo bench --bench instructions [-- --update]"),
    }
}

fn compare(update: bool) -> Result<()> {
    let kept = if update { BTreeMap::new() } else { kept()? };
    let (mut lines, mut differ) = (String::new(), Vec::new());
    let nothing = counted(NOTHING.0)?;
    for (name, _) in PATHS {
        let count = (counted(name)? - nothing) / SCANS as u64;
        lines += &format!("{name} {count}\n");
        let Some(&before) = kept.get(name) else {
            println!("{name}: {count} instructions a scan");
            continue;
        };
        let change = count as f64 / before as f64 - 1.0;
        println!("{name}: {count} instructions a scan, {:+.2} % of {before}", 100.0 * change);
        if change.abs() > MARGIN {
            differ.push(name);
        }
    }
    if update {
        std::fs::write(KEPT, lines).with_context(|| format!("cannot write {KEPT}"))?;
    }
    ensure!(
        differ.is_empty(),
        "not within {} % of what is kept: {}. If that is meant, `cargo bench --bench instructions -- --update`",
        100.0 * MARGIN,
        differ.join(", ")
    );
    Ok(())
}

fn kept() -> Result<BTreeMap<String, u64>> {
    let text = std::fs::read_to_string(KEPT).with_context(|| format!("cannot read {KEPT}"))?;
    let line = |line: &str| {
        let (name, count) = line.split_once(' ')?;
        Some((name.to_string(), count.parse().ok()?))
    };
    text.lines()
        .map(line)
        .collect::<Option<_>>()
        .with_context(|| format!("{KEPT}: a line is no name and number"))
}

/// Instructions that the drive takes.
fn counted(path: &str) -> Result<u64> {
    let folder = tempfile::tempdir()?;
    let out = folder.path().join("callgrind.out");
    let output = Command::new("valgrind")
        .args(["--tool=callgrind", "--cache-sim=no", "--branch-sim=no"])
        .arg(format!("--callgrind-out-file={}", out.display()))
        .arg(std::env::current_exe()?)
        .args(["drive", path])
        .output()
        .context("cannot run valgrind: is it installed?")?;
    ensure!(output.status.success(), "valgrind: {}", String::from_utf8_lossy(&output.stderr));
    total(&out)
}

fn total(file: &Path) -> Result<u64> {
    let text = std::fs::read_to_string(file)?;
    let total =
        text.lines().find_map(|line| line.strip_prefix("summary: ").or(line.strip_prefix("totals: ")));
    Ok(total.context("callgrind gives no total")?.trim().parse()?)
}

fn drive(insert: Insert) {
    let mut grid = Visagge::new(0.05, VisaggeSettings::default());
    for number in 0..SCANS {
        let (start, end) = (place(number as f64), place(number as f64 + 0.75));
        let scan = scan(number, &start);
        insert(&mut grid, &Sweep { scan: &scan, start, end });
    }
}

/// On a circle in the middle of the room, 1 m/s.
fn place(scan: f64) -> Pose {
    let turned = scan * 0.025 / 4.0;
    pose(10.0 + 4.0 * turned.cos(), 8.0 + 4.0 * turned.sin(), turned + FRAC_PI_2)
}

/// A room of 20 x 16 m with pillars and two panes that are seen near their normal only; some beams return nothing.
fn scan(number: usize, at: &Pose) -> Scan {
    let step = 1.5 * PI / (BEAMS - 1) as f64;
    let (x, y) = (at.translation.x, at.translation.y);
    // Unevenness that is the same everywhere.
    let mut state = number as u64 * 0x9e37_79b9 + 1;
    let mut random = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / (1u64 << 24) as f64
    };
    let mut range = |beam: usize| {
        let bearing = at.rotation.angle() - 0.75 * PI + step * beam as f64;
        let (sin, cos) = bearing.sin_cos();
        let wall =
            |from: f64, to: f64, along: f64| if along > 0.0 { (to - from) / along } else { -from / along };
        let mut range = wall(x, 20.0, cos).min(wall(y, 16.0, sin));
        for (px, py) in [(3.0, 3.0), (17.0, 4.0), (4.0, 13.0), (16.0, 12.5), (10.0, 8.0)] {
            let (dx, dy) = (px - x, py - y);
            let (along, across) = (dx * cos + dy * sin, dy * cos - dx * sin);
            if along > 0.0 && across.abs() < 0.25 {
                range = range.min(along - (0.0625 - across * across).sqrt());
            }
        }
        for pane in [15.0, 6.0] {
            let distance = (pane - y) / sin;
            if sin.abs() > 0.99 && distance > 0.0 {
                range = range.min(distance);
            }
        }
        match random() {
            chance if chance < 0.02 => f32::INFINITY,
            chance => (range + 0.03 * (chance - 0.5)) as f32,
        }
    };
    Scan {
        seq: number as u64,
        stamp_ns: number as i64 * 25_000_000,
        received_ns: number as i64 * 25_000_000,
        geometry: Geometry {
            angle_min: -0.75 * PI,
            angle_increment: step,
            time_increment: 0.025 / 1440.0,
            range_min: 0.023,
            range_max: 60.0,
        },
        ranges: (0..BEAMS).map(&mut range).collect(),
        intensities: Vec::new(),
    }
}
