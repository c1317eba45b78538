//! All that matters in one table: ways of localization against worlds, the worst of all drives in each.

use crate::drive::{Drive, Trouble};
use crate::error::TrajectoryError;
use crate::put_down::{self, Trial};
use crate::run::{Method, Run};
use anyhow::Result;
use scipsim::World;
use visagged::localize::Reference;

/// Where in a drive the robot is switched on (s): as it stands, and at full speed.
const STARTS: [f64; 2] = [0.0, 10.0];
/// Robots that are put down in each map, and how long each may take (s).
const PUT_DOWN: (u32, f64) = (20, 60.0);

const NO_TROUBLE: Trouble =
    Trouble { lost_scans: 0.0, random_returns: 0.0, bent: 0.0, half_odometry: false, slip: false, skip: 0.0 };
/// What goes wrong: nothing, half of the odometry is missing, the wheels slip.
const TROUBLES: [Trouble; 3] =
    [NO_TROUBLE, Trouble { half_odometry: true, ..NO_TROUBLE }, Trouble { slip: true, ..NO_TROUBLE }];

const fn matched(guided: bool, reference: Reference) -> Method {
    Method::Matched { guided, reference }
}

/// A row: its name, which of the [`TROUBLES`] its drives have, how they are located.
struct Row {
    name: &'static str,
    trouble: usize,
    method: Method,
    /// Whether two rows follow: the same with its loops closed afterwards, and on the way.
    is_closed: bool,
}

const ROWS: [Row; 7] = [
    Row { name: "wheel odometry alone", trouble: 0, method: Method::Wheels, is_closed: false },
    Row {
        name: "odometry, standard grid",
        trouble: 0,
        method: matched(true, Reference::Standard),
        is_closed: false,
    },
    Row { name: "odometry, ours", trouble: 0, method: matched(true, Reference::Surfaces), is_closed: true },
    Row {
        name: ".. half of the odometry missing",
        trouble: 1,
        method: matched(true, Reference::Surfaces),
        is_closed: false,
    },
    Row {
        name: ".. wheels slip by 20 %",
        trouble: 2,
        method: matched(true, Reference::Surfaces),
        is_closed: false,
    },
    Row {
        name: "scanner alone, standard grid",
        trouble: 0,
        method: matched(false, Reference::Standard),
        is_closed: false,
    },
    Row {
        name: "scanner alone, ours",
        trouble: 0,
        method: matched(false, Reference::Surfaces),
        is_closed: true,
    },
];

/// The rows that follow where loops are closed.
const CLOSED: [&str; 2] = [".. loops closed afterwards", ".. loops closed on the way"];

/// What came of some drives.
#[derive(Default)]
struct Sum {
    /// The worst error of each kind.
    worst: TrajectoryError,
    /// Of each drive: median of the time that a scan took and 99 of 100 (ms), consistency of the covariance.
    median_ms: Vec<f64>,
    p99_ms: Vec<f64>,
    consistency: Vec<f64>,
    /// Scans that have no place, and all.
    unplaced: [u64; 2],
}

impl Sum {
    fn add(&mut self, run: &Run) {
        self.worst = self.worst.worst(&run.error());
        let Some(report) = &run.report else { return };
        let skipped: u64 = report.scans_skipped.values().sum();
        self.unplaced = [self.unplaced[0] + skipped, self.unplaced[1] + report.scans_read];
        if let Some(localization) = &report.localization {
            self.median_ms.push(localization.match_us.median / 1e3);
            self.p99_ms.push(localization.match_us.p99 / 1e3);
        }
        self.consistency.extend(run.consistency());
    }
}

/// Drives through all worlds with all seeds from all starts and prints the tables.
pub fn run(worlds: &[World], seeds: &[u64]) -> Result<()> {
    let names = ROWS.iter().flat_map(|row| {
        let more: &[&str] = if row.is_closed { &CLOSED } else { &[] };
        [row.name].into_iter().chain(more.iter().copied())
    });
    let mut rows: Vec<(&str, Vec<Sum>)> = names.map(|name| (name, Vec::new())).collect();
    for world in worlds {
        rows.iter_mut().for_each(|(_, sums)| sums.push(Sum::default()));
        for (seed, skip) in seeds.iter().flat_map(|&seed| STARTS.map(|start| (seed, start))) {
            eprintln!("{}, seed {seed}, from {skip} s on", world.name);
            let drives = TROUBLES.map(|trouble| Drive::new(world, seed, Trouble { skip, ..trouble }));
            let runs = ROWS.iter().flat_map(|row| {
                let drive = &drives[row.trouble];
                let run = Run::of(drive, row.method, false);
                let closed = row.is_closed.then(|| [run.closed(drive).0, Run::of(drive, row.method, true)]);
                [run].into_iter().chain(closed.into_iter().flatten())
            });
            for (run, (_, sums)) in runs.zip(&mut rows) {
                sums.last_mut().expect("one was put there for this world").add(&run);
            }
        }
    }
    print_errors(worlds, &rows);
    println!();
    let (count, seconds) = PUT_DOWN;
    let counts = put_down::trial(worlds, Trial { count, seconds, stands: false, seed: seeds[0] })?;
    print_put_down(worlds, &counts);
    Ok(())
}

fn print_line(cells: impl IntoIterator<Item = String>) {
    println!("| {} |", cells.into_iter().collect::<Vec<_>>().join(" | "));
}

fn print_heading(first: &str, worlds: &[World], more: &[&str]) {
    let names = worlds.iter().map(|world| world.name.as_str());
    let heading: Vec<String> =
        [first].into_iter().chain(names).chain(more.iter().copied()).map(String::from).collect();
    println!("| {} |\n|{}", heading.join(" | "), "---|".repeat(heading.len()));
}

fn print_errors(worlds: &[World], rows: &[(&str, Vec<Sum>)]) {
    print_heading("raw (aligned) end, m", worlds, &["jump, m", "ms (99 %)", "not placed", "NEES"]);
    for (name, sums) in rows {
        let error = |sum: &Sum| {
            let TrajectoryError { raw, aligned, end, .. } = sum.worst;
            format!("{} ({}) {}", metres(raw), metres(aligned), metres(end))
        };
        let jump = sums.iter().map(|sum| sum.worst.jump).fold(0.0, f64::max);
        let mean = |of: fn(&Sum) -> &Vec<f64>| {
            let values: Vec<f64> = sums.iter().flat_map(of).copied().collect();
            values.iter().sum::<f64>() / values.len() as f64
        };
        let [unplaced, all] = [0, 1].map(|i| sums.iter().map(|sum| sum.unplaced[i]).sum::<u64>());
        let more = if all == 0 {
            ["", "", ""].map(String::from)
        } else {
            [
                format!("{:.2} ({:.2})", mean(|sum| &sum.median_ms), mean(|sum| &sum.p99_ms)),
                format!("{unplaced} of {all}"),
                format!("{:.2}", mean(|sum| &sum.consistency)),
            ]
        };
        let all = [name.to_string()].into_iter().chain(sums.iter().map(error)).chain([metres(jump)]);
        print_line(all.chain(more));
    }
}

/// To a millimetre, without the zero before the point.
fn metres(value: f64) -> String {
    let text = if value < 1.0 { format!("{value:.3}") } else { format!("{value:.2}") };
    text.strip_prefix('0').map(String::from).unwrap_or(text)
}

fn print_put_down(worlds: &[World], counts: &[[put_down::Counts; 2]]) {
    let (count, seconds) = PUT_DOWN;
    print_heading(&format!("put down at {count} places, {seconds} s"), worlds, &[]);
    let line = |name: &str, of: &dyn Fn(&[put_down::Counts; 2]) -> String| {
        print_line([name.to_string()].into_iter().chain(counts.iter().map(of)));
    };
    line("found", &|[here, _]| here.right.to_string());
    line(".. after, at most (s)", &|[here, _]| format!("{:.1}", here.slowest));
    line("not sure", &|[here, _]| here.unsure.to_string());
    line("wrongly sure", &|[here, _]| here.wrong.to_string());
    line("wrongly sure in the other buildings", &|[_, elsewhere]| {
        format!("{} of {}", elsewhere.wrong, elsewhere.wrong + elsewhere.unsure)
    });
}
