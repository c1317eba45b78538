//! The paper's table (Fig. 10) and further columns, for simulated drives.

mod drive;

use anyhow::Result;
use clap::Parser;
use drive::Drive;
use scipsim::{
    SimulationOptions, World,
    score::{Marked, Score, score},
};
use std::time::Instant;
use visagged::mapper::{Mapper, MapperKind, MapperSettings};

/// Marks mappers against the truth of simulated drives.
#[derive(Parser)]
struct Arguments {
    /// Worlds, shipped or files; all shipped ones where none is named.
    worlds: Vec<String>,
    /// Seeds of the noise.
    #[arg(long, value_delimiter = ',', default_value = "1")]
    seeds: Vec<u64>,
    /// Parts of the drive after which the map is marked.
    #[arg(long, default_value_t = 1)]
    parts: usize,
    /// Mappers to compare.
    #[arg(long, value_delimiter = ',', default_value = "visagge,standard")]
    mappers: Vec<String>,
    /// Lean of the specular surfaces (degrees).
    #[arg(long)]
    lean: Option<f64>,
    /// TOML file with settings of the mapper.
    #[arg(long)]
    settings: Option<std::path::PathBuf>,
    /// Say which verdicts the cells have that are shown or missing by mistake.
    #[arg(long)]
    why: bool,
    /// Folder for pictures.
    #[arg(long)]
    pictures: Option<std::path::PathBuf>,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let worlds = if arguments.worlds.is_empty() {
        World::shipped().map(String::from).collect()
    } else {
        arguments.worlds.clone()
    };
    println!("{}", heading());
    for name in &worlds {
        let world = World::load(name)?;
        for &seed in &arguments.seeds {
            let options = SimulationOptions { seed, lean_deg: arguments.lean, ..Default::default() };
            let began = Instant::now();
            let drive = Drive::new(format!("{name} {seed}"), &world, options, arguments.parts);
            eprintln!("{}: {} scans simulated in {:.1?}", drive.name, drive.scans.len(), began.elapsed());
            for kind in &arguments.mappers {
                let kind: MapperKind = toml::Value::String(kind.clone()).try_into()?;
                run(&drive, kind, &arguments)?;
            }
        }
    }
    Ok(())
}

fn run(drive: &Drive, kind: MapperKind, arguments: &Arguments) -> Result<()> {
    let settings = match &arguments.settings {
        Some(file) => toml::from_str(&std::fs::read_to_string(file)?)?,
        None => MapperSettings::default(),
    };
    let mut mapper = Mapper::new(MapperSettings { mapper: kind, mount: drive.mount, ..settings });
    let mut poses = drive.poses.iter().peekable();
    let mut fed = 0;
    for (until, truth) in &drive.truths {
        for scan in &drive.scans[fed..*until] {
            while let Some(pose) = poses.next_if(|pose| pose.stamp_ns <= scan.end_ns() + 20_000_000) {
                mapper.on_pose(*pose);
            }
            mapper.on_scan(scan.clone());
            while mapper.next_outcome().is_some() {}
        }
        fed = *until;
        let began = Instant::now();
        let map = mapper.map();
        let took = began.elapsed();
        let marked = Marked {
            resolution: map.resolution,
            origin: map.origin,
            width: map.width,
            height: map.height,
            cells: &map.occupancy,
        };
        let report = mapper.report();
        let part = if *until == drive.scans.len() { String::new() } else { format!("@{until}") };
        println!(
            "{:24} {:9} {} {:6.0} {:6.0} {:6.1} {:6.2}",
            format!("{}{part}", drive.name),
            format!("{kind:?}").to_lowercase(),
            row(&score(truth, &marked)),
            report.insert_us.median,
            report.insert_us.p99,
            took.as_secs_f64() * 1e3,
            report.map_bytes as f64 / 1e6,
        );
        if arguments.why {
            why(&map, truth);
        }
        if let Some(folder) = &arguments.pictures {
            std::fs::create_dir_all(folder)?;
            let name = format!("{}-{kind:?}{part}.png", drive.name.replace([' ', '/'], "-"));
            picture(&folder.join(name), &map, truth)?;
        }
    }
    Ok(())
}

fn heading() -> String {
    format!(
        "{:24} {:9} {:>6} {:>6} {:>6} {:>6} {:>6} {:>6} {:>6} {:>6} {:>6} {:>6} {:>6} {:>6}",
        "world",
        "mapper",
        "glass",
        "mispl",
        "diff",
        "motion",
        "refl",
        "remov",
        "stray",
        "path",
        "us",
        "p99",
        "map ms",
        "MB"
    )
}

fn row(score: &Score) -> String {
    [
        score.glass,
        score.misplaced,
        score.diffuse,
        score.motion,
        score.reflection,
        score.removed,
        score.stray,
        score.path,
    ]
    .map(|share| format!("{:6.2}", share.percent()))
    .join(" ")
}

/// Which verdicts the wrong cells have, by label.
fn why(map: &visagged::map::Map, truth: &scipsim::truth::TruthMap) {
    use scipsim::truth::Label;
    use std::collections::BTreeMap;
    use visagged::map::Values;
    let Some(Values::U8(verdicts)) = map.layers.iter().find(|l| l.name == "verdict").map(|l| &l.values)
    else {
        return;
    };
    let offset = |i: usize| ((truth.origin[i] - map.origin[i]) / truth.resolution).round() as i64;
    let at = |x: i64, y: i64| {
        let (column, row) = (x + offset(0), y + offset(1));
        ((0..map.width as i64).contains(&column) && (0..map.height as i64).contains(&row))
            .then(|| verdicts[row as usize * map.width + column as usize])
    };
    let mut counts: BTreeMap<(String, Vec<u8>), u32> = BTreeMap::new();
    for (cell, label) in truth.labels.iter().enumerate() {
        let (x, y) = ((cell % truth.width) as i64, (cell / truth.width) as i64);
        let shown = |v: u8| (1..10).contains(&v);
        let key = match label {
            Label::Other => continue,
            Label::Glass | Label::Diffuse => {
                let mut near: Vec<u8> = (-1..=1)
                    .flat_map(|dy| (-1..=1).filter_map(move |dx| at(x + dx, y + dy)))
                    .filter(|v| *v > 0)
                    .collect();
                if near.iter().any(|v| shown(*v)) {
                    continue;
                }
                near.sort_unstable();
                near.dedup();
                near
            }
            _ => match at(x, y) {
                Some(v) if shown(v) => vec![v],
                _ => continue,
            },
        };
        *counts.entry((format!("{label:?}"), key)).or_default() += 1;
    }
    println!(
        "    {}",
        counts.iter().map(|((l, v), n)| format!("{l} {v:?}: {n}")).collect::<Vec<_>>().join("; ")
    );
}

/// The truth in pale colours with the map's occupied cells in strong ones.
fn picture(file: &std::path::Path, map: &visagged::map::Map, truth: &scipsim::truth::TruthMap) -> Result<()> {
    use scipsim::truth::Label;
    let [left, bottom, width, height] = truth.extent();
    let mut pixels = vec![255u8; width * height * 3];
    let offset = |i: usize| ((truth.origin[i] - map.origin[i]) / truth.resolution).round() as i64;
    for y in 0..height {
        for x in 0..width {
            let cell = (y + bottom) * truth.width + x + left;
            let (column, row) = ((x + left) as i64 + offset(0), (y + bottom) as i64 + offset(1));
            let inside = (0..map.width as i64).contains(&column) && (0..map.height as i64).contains(&row);
            let occupied = inside && map.occupancy[row as usize * map.width + column as usize] == 100;
            let colour: [u8; 3] = match (truth.labels[cell], occupied) {
                (Label::Glass, true) => [0, 60, 255],
                (Label::Glass, false) => [0, 230, 255],
                (Label::Diffuse, true) => [0, 0, 0],
                (Label::Diffuse, false) => [160, 160, 160],
                (Label::Motion, true) => [255, 0, 0],
                (Label::Motion, false) => [255, 220, 220],
                (Label::Reflection, true) => [255, 0, 255],
                (Label::Reflection, false) => [250, 225, 250],
                (Label::Removed, true) => [255, 120, 0],
                (Label::Removed, false) => [255, 235, 200],
                (Label::Other, true) if truth.clearance[cell] <= 2 => [90, 90, 60],
                (Label::Other, true) => [0, 160, 0],
                (Label::Other, false) if truth.path[cell] => [230, 240, 255],
                (Label::Other, false) => [255, 255, 255],
            };
            let pixel = ((height - 1 - y) * width + x) * 3;
            pixels[pixel..pixel + 3].copy_from_slice(&colour);
        }
    }
    let mut encoder =
        png::Encoder::new(std::io::BufWriter::new(std::fs::File::create(file)?), width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header()?.write_image_data(&pixels)?;
    Ok(())
}
