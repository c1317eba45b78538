//! Two maps against each other: what share of either's occupied cells lies within one cell of the other's, and where they
//! differ. Reads what `visagged replay` writes: map.pgm and map.yaml, and from map.npz why cells are not shown.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use scipsim::score::thinned;

use crate::canvas::{Canvas, Colour};

/// Which maps.
#[derive(Args)]
pub struct Arguments {
    /// Folder of a map.
    first: PathBuf,
    /// Folder of the map it is compared with.
    second: PathBuf,
    /// Look for the middle lines of either map's surfaces in the other, thinned as for the marks: one may draw them thicker.
    #[arg(long)]
    thin: bool,
    /// Picture of the differences: both black, only the first red, only the second blue.
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// How many of the largest patches of differing cells are told.
    #[arg(long, default_value_t = 12)]
    patches: usize,
    /// Fail where either share is below this (%).
    #[arg(long, value_name = "PERCENT")]
    at_least: Option<f64>,
}

/// Cells this far apart are at the same place (cells, the larger of dx and dy).
const NEAR: i64 = 1;

/// A map as nav2's map server reads it; rows from the bottom.
struct Nav2Map {
    resolution: f64,
    origin: [f64; 2],
    width: usize,
    occupied: Vec<bool>,
    /// Those of them that are looked for in the other map.
    sought: Vec<bool>,
    known: Vec<bool>,
    /// Layer `verdict` of map.npz, where there is one.
    verdicts: Option<Vec<u8>>,
}

/// Cells of one map that the other lacks.
struct Missing {
    /// Cells of the map that were looked for.
    of: usize,
    /// Columns and rows in the map.
    cells: Vec<[i64; 2]>,
}

impl Missing {
    fn agreement(&self) -> f64 {
        100.0 * (1.0 - self.cells.len() as f64 / self.of.max(1) as f64)
    }
}

/// Compares and prints.
pub fn run(arguments: &Arguments) -> Result<()> {
    let [a, b] = [&arguments.first, &arguments.second];
    let [mut first, mut second] = [Nav2Map::read(a)?, Nav2Map::read(b)?];
    if arguments.thin {
        for map in [&mut first, &mut second] {
            map.sought = thinned(&map.occupied, map.width);
        }
    }
    let what = if arguments.thin { "middle" } else { "occupied" };
    let both = [(a, &first, b, &second), (b, &second, a, &first)];
    let mut agreements = Vec::new();
    for (name, map, other_name, other) in both {
        let missing = map.missing_in(other)?;
        println!(
            "{:.2} % of the {} {what} cells of {} are within one cell of one of {}; {} are not",
            missing.agreement(),
            missing.of,
            name.display(),
            other_name.display(),
            missing.cells.len()
        );
        tell_reasons(map, other, &missing, other_name);
        tell_patches(map, &missing, arguments.patches);
        agreements.push(missing.agreement());
    }
    if let Some(file) = &arguments.picture {
        let png = picture(&first, &second)?.png()?;
        std::fs::write(file, png).with_context(|| format!("cannot write {}", file.display()))?;
    }
    if let Some(least) = arguments.at_least {
        ensure!(agreements.iter().all(|share| *share >= least), "the maps agree on less than {least} %");
    }
    Ok(())
}

/// What the other map holds in the place of the cells it lacks.
fn tell_reasons(map: &Nav2Map, other: &Nav2Map, missing: &Missing, other_name: &Path) {
    let offset = map.offset_in(other);
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for [x, y] in &missing.cells {
        let place = other.place(x + offset[0], y + offset[1]);
        let reason = match place {
            Some(place) => {
                let ground = if other.known[place] { "free" } else { "unknown" };
                match other.verdicts.as_ref().map(|verdicts| verdicts[place]) {
                    Some(0) | None => ground.to_string(),
                    Some(verdict) => format!("verdict {verdict}"),
                }
            }
            None => "unknown".into(),
        };
        *counts.entry(reason).or_default() += 1;
    }
    let text: Vec<String> = counts.iter().map(|(reason, count)| format!("{count} {reason}")).collect();
    println!("  {} has there: {}", other_name.display(), text.join(", "));
}

/// The largest patches of connected cells, with their middles.
fn tell_patches(map: &Nav2Map, missing: &Missing, count: usize) {
    let patches = patches(&missing.cells);
    let alone = patches.iter().filter(|patch| patch.len() <= 2).count();
    println!("  {} patches, {alone} of them of one or two cells; the largest:", patches.len());
    for patch in patches.iter().take(count) {
        let middle = |axis: usize| {
            let sum: i64 = patch.iter().map(|cell| cell[axis]).sum();
            map.origin[axis] + (sum as f64 / patch.len() as f64 + 0.5) * map.resolution
        };
        println!("    {:4} cells around ({:.2}, {:.2}) m", patch.len(), middle(0), middle(1));
    }
}

/// Patches of cells that touch, corners included, the largest first.
fn patches(cells: &[[i64; 2]]) -> Vec<Vec<[i64; 2]>> {
    let mut left: std::collections::BTreeSet<[i64; 2]> = cells.iter().copied().collect();
    let mut patches = Vec::new();
    while let Some(start) = left.pop_first() {
        let mut patch = vec![start];
        let mut next = 0;
        while let Some(&[x, y]) = patch.get(next) {
            let around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| [x + dx, y + dy]));
            patch.extend(around.filter(|cell| left.remove(cell)));
            next += 1;
        }
        patches.push(patch);
    }
    patches.sort_by_key(|patch| std::cmp::Reverse(patch.len()));
    patches
}

const BOTH: Colour = [0, 0, 0];
const ONLY_FIRST: Colour = [230, 0, 0];
const ONLY_SECOND: Colour = [0, 80, 255];

fn picture(first: &Nav2Map, second: &Nav2Map) -> Result<Canvas> {
    let height = |map: &Nav2Map| (map.occupied.len() / map.width.max(1)) as i64;
    let offset = second.offset_in(first);
    let low = [offset[0].min(0), offset[1].min(0)];
    let right = (first.width as i64).max(second.width as i64 + offset[0]);
    let top = height(first).max(height(second) + offset[1]);
    let mut canvas = Canvas::new((right - low[0]) as usize, (top - low[1]) as usize);
    let mut paint = |[x, y]: [i64; 2], colour| canvas.set(x - low[0], top - 1 - y, colour);
    for (cell, known) in first.known.iter().enumerate() {
        let at = [(cell % first.width) as i64, (cell / first.width) as i64];
        paint(at, if *known { [255; 3] } else { [225; 3] });
    }
    first.cells().for_each(|cell| paint(cell, BOTH));
    second.cells().for_each(|[x, y]| paint([x + offset[0], y + offset[1]], BOTH));
    first.missing_in(second)?.cells.into_iter().for_each(|cell| paint(cell, ONLY_FIRST));
    for [x, y] in second.missing_in(first)?.cells {
        paint([x + offset[0], y + offset[1]], ONLY_SECOND);
    }
    Ok(canvas)
}

impl Nav2Map {
    fn read(folder: &Path) -> Result<Nav2Map> {
        let yaml = folder.join("map.yaml");
        let text =
            std::fs::read_to_string(&yaml).with_context(|| format!("cannot read {}", yaml.display()))?;
        let pgm = folder.join("map.pgm");
        let bytes = std::fs::read(&pgm).with_context(|| format!("cannot read {}", pgm.display()))?;
        let mut map =
            Nav2Map::decode(&text, &bytes).with_context(|| format!("the map in {}", folder.display()))?;
        let layer = verdicts(&folder.join("map.npz"));
        map.verdicts = layer.filter(|verdicts| verdicts.len() == map.occupied.len());
        Ok(map)
    }

    fn decode(yaml: &str, pgm: &[u8]) -> Result<Nav2Map> {
        let value = |key: &str| {
            let found = yaml.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(':'));
            found.map(str::trim).with_context(|| format!("map.yaml has no `{key}`"))
        };
        let number =
            |text: &str| text.trim().parse::<f64>().with_context(|| format!("`{text}` is no number"));
        let origin = value("origin")?.trim_matches(['[', ']']).split(',').map(number);
        let origin: Vec<f64> = origin.collect::<Result<_>>()?;
        let [x, y, ..] = origin[..] else { bail!("map.yaml's origin has no x and y") };
        let (occupied_from, free_to) = (number(value("occupied_thresh")?)?, number(value("free_thresh")?)?);
        let (width, height, grey) = grey(pgm)?;
        let rows = grey.chunks(width.max(1)).rev().flatten();
        let dark: Vec<f64> = rows.map(|&value| f64::from(255 - value) / 255.0).collect();
        ensure!(dark.len() == width * height, "map.pgm is cut off");
        let occupied: Vec<bool> = dark.iter().map(|dark| *dark > occupied_from).collect();
        Ok(Nav2Map {
            resolution: number(value("resolution")?)?,
            origin: [x, y],
            width,
            sought: occupied.clone(),
            occupied,
            known: dark.iter().map(|dark| *dark > occupied_from || *dark < free_to).collect(),
            verdicts: None,
        })
    }

    fn cells(&self) -> impl Iterator<Item = [i64; 2]> {
        let width = self.width;
        let sought = self.sought.iter().enumerate().filter(|(_, sought)| **sought);
        sought.map(move |(cell, _)| [(cell % width) as i64, (cell / width) as i64])
    }

    fn place(&self, x: i64, y: i64) -> Option<usize> {
        let inside = (0..self.width as i64).contains(&x) && y >= 0;
        let place = y.checked_mul(self.width as i64)?.checked_add(x)? as usize;
        (inside && place < self.occupied.len()).then_some(place)
    }

    /// What is to be added to a column and row of this map to get those of the other.
    fn offset_in(&self, other: &Nav2Map) -> [i64; 2] {
        [0, 1].map(|axis| ((self.origin[axis] - other.origin[axis]) / self.resolution).round() as i64)
    }

    fn missing_in(&self, other: &Nav2Map) -> Result<Missing> {
        ensure!(
            (self.resolution - other.resolution).abs() < 1e-6,
            "cells of {} m and of {} m cannot be compared",
            self.resolution,
            other.resolution
        );
        let offset = self.offset_in(other);
        let is_near = |[x, y]: [i64; 2]| {
            let mut around = (-NEAR..=NEAR).flat_map(|dy| (-NEAR..=NEAR).map(move |dx| [x + dx, y + dy]));
            around.any(|[x, y]| {
                other.place(x + offset[0], y + offset[1]).is_some_and(|place| other.occupied[place])
            })
        };
        let cells: Vec<_> = self.cells().filter(|cell| !is_near(*cell)).collect();
        Ok(Missing { of: self.cells().count(), cells })
    }
}

/// Width, height and pixels of a binary PGM of 8 bits (netpbm's pgm(5)).
fn grey(pgm: &[u8]) -> Result<(usize, usize, &[u8])> {
    let mut rest = pgm.strip_prefix(b"P5").context("map.pgm is no binary PGM")?;
    let mut numbers = [0usize; 3];
    for number in &mut numbers {
        rest = rest.trim_ascii_start();
        while rest.starts_with(b"#") {
            let end = rest.iter().position(|byte| *byte == b'\n').context("map.pgm is cut off")?;
            rest = rest[end..].trim_ascii_start();
        }
        let digits = rest.iter().take_while(|byte| byte.is_ascii_digit()).count();
        let text = std::str::from_utf8(&rest[..digits])?;
        *number = text.parse().context("map.pgm has no proper size")?;
        rest = &rest[digits..];
    }
    let [width, height, most] = numbers;
    ensure!(most == 255, "map.pgm has grey values up to {most}, not 255");
    Ok((width, height, rest.get(1..).unwrap_or_default()))
}

/// Layer `verdict` of a map.npz; `None` where there is none, as in maps of plain grids.
fn verdicts(npz: &Path) -> Option<Vec<u8>> {
    let mut archive = zip::ZipArchive::new(std::fs::File::open(npz).ok()?).ok()?;
    let mut bytes = Vec::new();
    archive.by_name("verdict.npy").ok()?.read_to_end(&mut bytes).ok()?;
    // NPY 1.0: magic, version, length of the header in two bytes, header, data.
    let header = usize::from(u16::from_le_bytes(bytes.get(8..10)?.try_into().ok()?));
    Some(bytes.split_off((10 + header).min(bytes.len())))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(origin: [f64; 2], rows: &[&str]) -> Nav2Map {
        let yaml = format!(
            "image: map.pgm\nresolution: 0.05\norigin: [{}, {}, 0]\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
            origin[0], origin[1]
        );
        let mut pgm = format!("P5\n# by hand\n{} {}\n255\n", rows[0].len(), rows.len()).into_bytes();
        pgm.extend(rows.join("").bytes().map(|byte| match byte {
            b'#' => 0,
            b'.' => 254,
            _ => 205,
        }));
        Nav2Map::decode(&yaml, &pgm).unwrap()
    }

    #[test]
    fn a_cell_next_to_the_others_is_at_the_same_place() {
        let first = map([0.0, 0.0], &["#####", ".....", "#...#"]);
        // One column to the left of it, one row higher.
        let second = map([-0.05, 0.0], &["  ....", "  ##..", "......"]);
        let missing = first.missing_in(&second).unwrap();
        assert_eq!((missing.of, missing.cells), (7, vec![[4, 0], [4, 2]]));
        assert_eq!(second.missing_in(&first).unwrap().cells, Vec::<[i64; 2]>::new());
        assert_eq!(first.offset_in(&second), [1, 0]);
        let picture = picture(&first, &second).unwrap();
        assert_eq!((picture.width(), picture.height()), (6, 3));
    }

    #[test]
    fn damaged_maps_are_named() {
        let yaml = "resolution: 0.05\norigin: [0, 0, 0]\noccupied_thresh: 0.65\nfree_thresh: 0.196\n";
        assert!(Nav2Map::decode(yaml, b"P5\n2 2\n255\nabc").is_err());
        assert!(Nav2Map::decode(yaml, b"P2\n2 2\n255\nabcd").is_err());
        assert!(Nav2Map::decode("resolution: 0.05\n", b"P5\n1 1\n255\na").is_err());
    }

    #[test]
    fn patches_are_connected_over_corners() {
        let found = patches(&[[0, 0], [5, 5], [1, 1], [9, 9], [2, 1]]);
        assert_eq!(found.iter().map(Vec::len).collect::<Vec<_>>(), [3, 1, 1]);
    }
}
