//! A robot that is put down somewhere in a known map, without a hint where: does it find out, and is it ever wrongly sure?

use crate::drive::{Drive, Trouble};
use anyhow::{Context, Result};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scipsim::World;
use std::{f64::consts::PI, time::Instant};
use visagged::{
    map::Map,
    mapper::{Mapper, MapperSettings, Outcome, PoseUse},
    pose::{Pose, pose},
    saved::SavedMap,
};

/// A robot needs this much room to every side (m).
const ROOM: f64 = 0.45;
/// It is put down this far from where it has driven, at most (m).
const ASIDE: f64 = 1.5;
/// Where it thinks to be is right within this (m, rad).
const RIGHT: [f64; 2] = [0.1, 0.03];

/// What became of the robots that were put down.
#[derive(Clone, Copy, Debug, Default)]
pub struct Counts {
    /// Found their place.
    pub right: u32,
    /// Never said that they knew it.
    pub unsure: u32,
    /// Said so and were elsewhere.
    pub wrong: u32,
    /// Longest search (s of drive), of those that found their place.
    pub slowest: f64,
    /// Longest time that one scan took (s).
    pub scan: f64,
}

/// A map that a drive has left.
pub struct KnownMap {
    saved: SavedMap,
    map: Map,
    path: Vec<Pose>,
}

impl KnownMap {
    /// Drives through the world and keeps the map, by way of a file's bytes.
    pub fn of(world: &World, seed: u64) -> Result<KnownMap> {
        let drive = Drive::new(world, seed, Trouble::default());
        let settings = MapperSettings { poses: PoseUse::Odometry, mount: drive.mount, ..Default::default() };
        let mut mapper = Mapper::new(settings);
        let mut odometry = drive.odometry.iter().peekable();
        for scan in &drive.scans {
            while let Some(pose) = odometry.next_if(|pose| pose.stamp_ns <= scan.end_ns() + 10_000_000) {
                mapper.on_pose(*pose);
            }
            mapper.on_scan(scan.clone());
            while mapper.next_outcome().is_some() {}
        }
        mapper.finish();
        let bytes = mapper.save().context("the grid can be saved")?.encode()?;
        let saved = SavedMap::decode(&bytes)?;
        eprintln!(
            "{} seed {seed}: {} scans, {:.2} MB",
            world.name,
            drive.scans.len(),
            bytes.len() as f64 / 1e6
        );
        Ok(KnownMap { saved, map: mapper.map(), path: drive.truth })
    }

    /// A place near the drive with room around it and any heading, and which pose of the drive it is near to.
    fn place(&self, random: &mut ChaCha8Rng) -> (Pose, usize) {
        loop {
            let number = random.random_range(0..self.path.len());
            let near = self.path[number].translation.vector;
            let bearing: f64 = random.random_range(0.0..std::f64::consts::TAU);
            let way = random.random_range(0.0..ASIDE);
            let step = self.map.resolution / 2.0;
            // Nobody is put down behind a wall.
            let is_open = (0..=(way / step) as usize).all(|i| {
                let way = i as f64 * step;
                self.has_room(near.x + way * bearing.cos(), near.y + way * bearing.sin())
            });
            if is_open {
                let heading = random.random_range(-PI..PI);
                let place = pose(near.x + way * bearing.cos(), near.y + way * bearing.sin(), heading);
                return (place, number);
            }
        }
    }

    /// The drive from a pose on, to its end and then back, for so many seconds at 1 m/s.
    fn onward(&self, from: usize, seconds: f64) -> Vec<[f64; 2]> {
        let there_and_back = (from..self.path.len()).chain((0..self.path.len()).rev());
        let mut way: Vec<[f64; 2]> = Vec::new();
        for number in there_and_back {
            let at = self.path[number].translation.vector;
            if way.last().is_none_or(|last| (at.x - last[0]).hypot(at.y - last[1]) >= 1.0) {
                way.push([at.x, at.y]);
            }
            if way.len() as f64 > seconds {
                break;
            }
        }
        way
    }

    fn has_room(&self, x: f64, y: f64) -> bool {
        let cells = (ROOM / self.map.resolution) as i64;
        let at = |value: f64, origin: f64| ((value - origin) / self.map.resolution).floor() as i64;
        let (column, row) = (at(x, self.map.origin[0]), at(y, self.map.origin[1]));
        (-cells..=cells).all(|dy| {
            (-cells..=cells).all(|dx| {
                let (column, row) = (column + dx, row + dy);
                let inside = (0..self.map.width as i64).contains(&column)
                    && (0..self.map.height as i64).contains(&row);
                inside && self.map.occupancy[row as usize * self.map.width + column as usize] == 0
            })
        })
    }

    /// Puts a robot down at `count` places of a world, whose own map is `places_of`, and says what became of them.
    pub fn put_down(
        &self,
        world: &World,
        places_of: &KnownMap,
        count: u32,
        Trial { seconds, stands, seed, .. }: Trial,
    ) -> Result<Counts> {
        let seed = seed + 100;
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let is_here = std::ptr::eq(self, places_of);
        let mut counts = Counts::default();
        for number in 0..count {
            let (place, near) = places_of.place(&mut random);
            let mut world = world.clone();
            let at = place.translation;
            world.robot.path = vec![[at.x, at.y]];
            world.robot.heading_deg = place.rotation.angle().to_degrees();
            if stands {
                world.robot.stops = vec![(0, seconds)];
            } else {
                world.robot.path.extend(places_of.onward(near, seconds));
                world.robot.stops = vec![(0, 1.0)];
            }
            (world.robot.closed, world.robot.laps) = (false, 1);
            let drive = Drive::new(&world, seed + u64::from(number) * 1000, Trouble::default());
            let settings =
                MapperSettings { poses: PoseUse::Odometry, mount: drive.mount, ..Default::default() };
            let mut mapper = Mapper::going_on(&self.saved, settings)?;
            let (mut found, mut wrong) = (None, None);
            let mut next = 0;
            for scan in drive.scans.iter().take((seconds * 40.0) as usize) {
                let before = Instant::now();
                mapper.on_scan(scan.clone());
                counts.scan = counts.scan.max(before.elapsed().as_secs_f64());
                while let Some(outcome) = mapper.next_outcome() {
                    if let Outcome::Inserted { start, .. } = outcome {
                        let truth = &drive.truth[next];
                        let off = (start.translation.vector - truth.translation.vector).norm();
                        let turn = start.rotation.angle_to(&truth.rotation).abs();
                        if !is_here || off > RIGHT[0] || turn > RIGHT[1] {
                            wrong.get_or_insert((off, turn));
                        }
                        found.get_or_insert(next as f64 / 40.0);
                    }
                    next += 1;
                }
            }
            match (found, wrong) {
                (Some(_), Some((off, turn))) => {
                    counts.wrong += 1;
                    eprintln!(
                        "  wrongly sure at {:.2} {:.2} {:.0}°: off by {off:.2} m, {:.1}°",
                        at.x,
                        at.y,
                        place.rotation.angle().to_degrees(),
                        turn.to_degrees()
                    );
                }
                (Some(time), None) => {
                    counts.right += 1;
                    counts.slowest = counts.slowest.max(time);
                }
                (None, _) => {
                    counts.unsure += 1;
                    if is_here {
                        let report = mapper.report();
                        eprintln!(
                            "  unsure at {:.2} {:.2} {:.0}°: {:?}",
                            at.x,
                            at.y,
                            place.rotation.angle().to_degrees(),
                            report.scans_skipped
                        );
                    }
                }
            }
        }
        Ok(counts)
    }
}

/// How robots are put down.
#[derive(Clone, Copy, Debug)]
pub struct Trial {
    /// So many in each map.
    pub count: u32,
    /// So long they may take to find out where (s).
    pub seconds: f64,
    /// Whether they stand all the time.
    pub stands: bool,
    /// Seed of places and noise.
    pub seed: u64,
}

/// Puts robots down in the maps of these worlds, each in its own, and says what became of them, world by world; and a quarter as
/// many in each of the other worlds with the same map, of which none can be right.
pub fn trial(worlds: &[World], trial: Trial) -> Result<Vec<[Counts; 2]>> {
    let Trial { count, seed, .. } = trial;
    let maps: Vec<KnownMap> = worlds.iter().map(|world| KnownMap::of(world, seed)).collect::<Result<_>>()?;
    let here_and_elsewhere = |(map, world): (&KnownMap, &World)| {
        let here = map.put_down(world, map, count, trial)?;
        let mut elsewhere = Counts::default();
        for (places_of, world) in maps.iter().zip(worlds) {
            if std::ptr::eq(places_of, map) {
                continue;
            }
            let counts = map.put_down(world, places_of, (count / 4).max(1), trial)?;
            elsewhere.unsure += counts.unsure;
            elsewhere.wrong += counts.wrong + counts.right;
            elsewhere.scan = elsewhere.scan.max(counts.scan);
        }
        Ok([here, elsewhere])
    };
    maps.iter().zip(worlds).map(here_and_elsewhere).collect()
}

/// Does so for several seeds and prints a line each.
pub fn run(worlds: &[World], seeds: &[u64], count: u32, seconds: f64, stands: bool) -> Result<()> {
    for &seed in seeds {
        for (world, counts) in worlds.iter().zip(trial(worlds, Trial { count, seconds, stands, seed })?) {
            for (counts, where_) in counts.iter().zip(["", "elsewhere, with the map of "]) {
                println!(
                    "{:40} right {:3}  unsure {:3}  wrong {:3}  slowest {:.1} s  longest scan {:.2} s",
                    format!("{where_}{} {seed}", world.name),
                    counts.right,
                    counts.unsure,
                    counts.wrong,
                    counts.slowest,
                    counts.scan
                );
            }
        }
    }
    Ok(())
}
