//! Simulates drives, runs the mappers over them and marks the maps, on a few threads, a drive at a time on each.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{
    Mutex,
    atomic::{AtomicUsize, Ordering},
    mpsc,
};

use anyhow::{Context, Result};
use clap::Args;
use rustix::time::{ClockId, clock_gettime};
use scipsim::score::{Marked, Score, score};
use visagged::map::Map;
use visagged::mapper::{Mapper, MapperKind, MapperSettings};

use crate::contender::{Contender, Override, apply, contenders, each_idea};
use crate::drive::Drive;
use crate::plan::{Job, PLAIN, Set, VARIANTS, Variant, jobs, variant};
use crate::{page, picture, table, why};

/// What is marked.
#[derive(Args)]
pub struct Arguments {
    /// Worlds: shipped ones, files, or generated ones as KIND-SEED (hall-7). Without any, the sets.
    worlds: Vec<String>,
    /// Seeds of the noise. Without any, a generated world's own, and 1 for others.
    #[arg(long, value_delimiter = ',')]
    seeds: Vec<u64>,
    /// Sets of worlds, where none is named.
    #[arg(long, value_delimiter = ',', default_value = "tuning,validation")]
    set: Vec<Set>,
    /// Variants of each drive, plain among them: all, or the ones named.
    #[arg(long, value_delimiter = ',', num_args = 0..=1, require_equals = true, default_missing_value = "all")]
    variants: Vec<String>,
    /// Mappers to compare.
    #[arg(long, value_delimiter = ',', default_value = "visagge,paper,standard,visits,glints")]
    mappers: Vec<String>,
    /// Parts of the drive after each of which the map is marked.
    #[arg(long, default_value_t = 3)]
    parts: usize,
    /// TOML file with settings of the mapper.
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
    /// A setting of the mapper for all rows; may be given several times.
    #[arg(long, value_name = "KEY=VALUE")]
    set_mapper: Vec<Override>,
    /// One more row for the first mapper with this setting; may be given several times.
    #[arg(long, value_name = "KEY=VALUE")]
    ablate: Vec<Override>,
    /// One more row for the first mapper without each of its ideas.
    #[arg(long)]
    ablate_ideas: bool,
    /// Say which verdicts the cells have that are shown or missing by mistake.
    #[arg(long)]
    why: bool,
    /// Only the rows of the means.
    #[arg(long)]
    means: bool,
    /// Drives that are simulated at the same time.
    #[arg(long, default_value_t = 2)]
    threads: usize,
    /// Folder for table.txt, table.csv and index.html, which shows the maps.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Marks of one map.
#[derive(Clone, Debug)]
pub struct Row {
    /// Number of the drive, as planned.
    pub drive: usize,
    /// The drive's name.
    pub world: String,
    /// What it goes into the mean of.
    pub group: String,
    /// Its mapper.
    pub mapper: String,
    /// After which of how many parts of the drive.
    pub part: [usize; 2],
    /// The marks.
    pub score: Score,
    /// CPU time of an insertion so far (us): median and 99 of 100.
    pub insert_us: [f64; 2],
    /// CPU time of making the map (ms): the verdict on what changed and the snapshot.
    pub map_ms: f64,
    /// Memory that the grid holds (bytes).
    pub bytes: usize,
    /// The map against the truth as PNG, at the end and where pictures are wanted.
    pub png: Option<Vec<u8>>,
    /// Verdicts of the wrong cells, where wanted.
    pub why: Option<String>,
}

impl Row {
    /// Whether the drive was over.
    pub fn is_final(&self) -> bool {
        self.part[0] == self.part[1]
    }
}

/// Marks everything that the arguments name.
pub fn run(arguments: &Arguments) -> Result<()> {
    let jobs = jobs(&arguments.worlds, &arguments.seeds, &arguments.set, &variants(&arguments.variants)?);
    let mut ablations = arguments.ablate.clone();
    if arguments.ablate_ideas {
        ablations.extend(each_idea());
    }
    let contenders = contenders(&kinds(&arguments.mappers)?, &settings(arguments)?, &ablations)?;
    if let Some(folder) = &arguments.out {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    println!("{}", table::heading());
    let rows = mark_all(&jobs, &contenders, arguments, |rows| {
        if !arguments.means {
            print!("{}", table::rows(rows));
        }
    })?;
    let means = table::means(&rows);
    println!("{}", table::mean_rows(&means));
    if let Some(folder) = &arguments.out {
        let text = format!("{}\n{}\n{}", table::heading(), table::rows(&rows), table::mean_rows(&means));
        let files = [
            ("table.txt", text),
            ("table.csv", table::csv(&rows)),
            ("index.html", page::html(&rows, &means)),
        ];
        for (name, content) in files {
            let file = folder.join(name);
            std::fs::write(&file, content).with_context(|| format!("cannot write {}", file.display()))?;
        }
        eprintln!("pictures: {}", folder.join("index.html").display());
    }
    Ok(())
}

fn variants(names: &[String]) -> Result<Vec<Variant>> {
    match names {
        [] => Ok(vec![PLAIN]),
        [all] if all == "all" => Ok(VARIANTS.into()),
        _ => names.iter().map(|name| variant(name).map_err(anyhow::Error::msg)).collect(),
    }
}

fn kinds(names: &[String]) -> Result<Vec<MapperKind>> {
    let kind = |name: &String| {
        toml::Value::String(name.clone()).try_into().with_context(|| format!("mapper `{name}`"))
    };
    names.iter().map(kind).collect()
}

fn settings(arguments: &Arguments) -> Result<MapperSettings> {
    let settings = match &arguments.settings {
        Some(file) => {
            let text = std::fs::read_to_string(file)
                .with_context(|| format!("cannot read the settings {}", file.display()))?;
            toml::from_str(&text).with_context(|| format!("settings {}", file.display()))?
        }
        None => MapperSettings::default(),
    };
    apply(&settings, &arguments.set_mapper)
}

/// Marks all drives; `on_drive` gets the rows of each, in the order of the jobs.
fn mark_all(
    jobs: &[Job],
    contenders: &[Contender],
    arguments: &Arguments,
    mut on_drive: impl FnMut(&[Row]),
) -> Result<Vec<Row>> {
    let next = AtomicUsize::new(0);
    let (sender, results) = mpsc::channel();
    let sender = Mutex::new(sender);
    std::thread::scope(|scope| {
        for _ in 0..arguments.threads.clamp(1, jobs.len().max(1)) {
            let sender = sender.lock().expect("nobody panics with it").clone();
            let next = &next;
            scope.spawn(move || {
                while let Some((number, job)) = take(next, jobs) {
                    let rows = mark_drive(number, job, contenders, arguments);
                    let failed = rows.is_err();
                    if sender.send((number, rows)).is_err() || failed {
                        return;
                    }
                }
            });
        }
        drop(sender);
        let (mut waiting, mut rows) = (BTreeMap::new(), Vec::new());
        for number in 0..jobs.len() {
            while !waiting.contains_key(&number) {
                let (done, result) = results.recv().context("a worker has failed")?;
                // The others find no more work.
                waiting.insert(done, result.inspect_err(|_| next.store(jobs.len(), Ordering::Relaxed))?);
            }
            let of_drive: Vec<Row> = waiting.remove(&number).unwrap_or_default();
            on_drive(&of_drive);
            rows.extend(of_drive);
        }
        Ok(rows)
    })
}

fn take<'a>(next: &AtomicUsize, jobs: &'a [Job]) -> Option<(usize, &'a Job)> {
    let number = next.fetch_add(1, Ordering::Relaxed);
    jobs.get(number).map(|job| (number, job))
}

fn mark_drive(number: usize, job: &Job, contenders: &[Contender], arguments: &Arguments) -> Result<Vec<Row>> {
    let drive = Drive::new(&job.load()?, job.options(), arguments.parts);
    let mut rows = Vec::new();
    for contender in contenders {
        follow(&drive, &contender.settings, |part, mapper, map, map_ms| {
            let report = mapper.report();
            let truth = &drive.truths[part].1;
            let is_final = part + 1 == drive.truths.len();
            let png = (is_final && arguments.out.is_some()).then(|| picture::errors(map, truth).png());
            let score = score(truth, &marked(map));
            rows.push(Row {
                drive: number,
                world: job.name(),
                group: job.group(),
                mapper: contender.name.clone(),
                part: [part + 1, drive.truths.len()],
                score,
                insert_us: [report.insert_us.median, report.insert_us.p99],
                map_ms,
                bytes: report.map_bytes,
                png: png.transpose()?,
                why: arguments.why.then(|| why::wrong_cells(map, truth, &score)),
            });
            Ok(())
        })?;
    }
    Ok(rows)
}

/// Runs a mapper along a drive. `on_part` gets, after each part, its number, the mapper, the map and what making the map
/// took (ms of CPU time).
pub fn follow(
    drive: &Drive,
    settings: &MapperSettings,
    mut on_part: impl FnMut(usize, &Mapper, &Map, f64) -> Result<()>,
) -> Result<()> {
    let mut mapper = Mapper::new(MapperSettings { mount: drive.mount, ..settings.clone() });
    let mut poses = drive.poses.iter().peekable();
    let mut fed = 0;
    for (part, (until, _)) in drive.truths.iter().enumerate() {
        for scan in &drive.scans[fed..*until] {
            while let Some(pose) = poses.next_if(|pose| pose.stamp_ns <= scan.end_ns() + POSE_AHEAD_NS) {
                mapper.on_pose(*pose);
            }
            mapper.on_scan(scan.clone());
            while mapper.next_outcome().is_some() {}
        }
        fed = *until;
        let began = cpu_ms();
        let map = mapper.map();
        let map_ms = cpu_ms() - began;
        on_part(part, &mapper, &map, map_ms)?;
    }
    Ok(())
}

/// Poses are given to the mapper until there is one past the scan; at 100 a second the next is at most 10 ms away.
const POSE_AHEAD_NS: i64 = 20_000_000;

fn cpu_ms() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 / 1e6
}

/// The map as the marker takes it.
pub fn marked(map: &Map) -> Marked<'_> {
    Marked {
        resolution: map.resolution,
        origin: map.origin,
        width: map.width,
        height: map.height,
        cells: &map.occupancy,
    }
}
