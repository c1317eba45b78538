//! The inner parts, each by itself: decoding what a scanner sends, inserting scans, and making a map for the viewers.
//!
//! `cargo bench --bench inner`; `-- decode`, `-- insert`, `-- map` for one of them. All of it is of a drive through the 20 m hall. What
//! they cost beside others, and over whole drives: `insert`.

mod laid;

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use laid::Laid;
use scip::Decoder;
use scipsim::{
    Simulation, SimulationOptions, World,
    device::{DeviceSettings, capture::capture, responder::Responder},
};
use std::{hint::black_box, sync::Arc};
use visagged::grid::{
    saved::SavedGrid,
    sweep::Sweep,
    visagge::{Visagge, VisaggeSettings},
};

/// Side of a cell (m).
const RESOLUTION: f64 = 0.05;
/// Scans in a second.
const SECOND: usize = 40;
/// What a read from a port gives at most, about (bytes).
const CHUNK: usize = 4096;
/// How long the device sends for the benchmark (ns).
const SENDS_NS: i64 = 2_000_000_000;

fn hall() -> World {
    World::load("hall").expect("it is shipped")
}

/// Distances and intensities, as they come, sums and all.
fn decode(criterion: &mut Criterion) {
    let simulation = Arc::new(Simulation::new(&hall(), SimulationOptions::default()));
    let device = Responder::new(DeviceSettings::default(), simulation, 0);
    let (bytes, _) = capture(device, "ME0000108001000", SENDS_NS);
    let mut group = criterion.benchmark_group("decode");
    group.throughput(Throughput::Bytes(bytes.len() as u64));
    group.bench_function("ME", |bench| {
        bench.iter(|| {
            let mut decoder = Decoder::new();
            let mut replies = 0;
            for chunk in bytes.chunks(CHUNK) {
                decoder.push(chunk);
                while let Some(reply) = decoder.decode_next() {
                    black_box(reply.expect("the device makes no mistakes"));
                    replies += 1;
                }
            }
            assert!(replies > SECOND);
        });
    });
    group.finish();
}

fn insert_all(grid: &mut Visagge, scans: &[Laid]) {
    scans.iter().for_each(|(scan, start, end)| grid.insert(&Sweep { scan, start: *start, end: *end }));
}

/// The grid in the middle of the drive, as after a restart, and the scans of the second that follows.
struct Middle {
    grid: SavedGrid,
    second: Vec<Laid>,
}

impl Middle {
    fn of_the_drive() -> Middle {
        let laid = laid::laid(&hall(), SimulationOptions::default());
        let mut grid = Visagge::new(RESOLUTION, VisaggeSettings::default());
        let (driven, to_come) = laid.split_at(laid.len() / 2);
        insert_all(&mut grid, driven);
        Middle { grid: grid.save(), second: to_come[..SECOND].to_vec() }
    }

    fn grid(&self) -> Visagge {
        Visagge::load(&self.grid, VisaggeSettings::default()).expect("it was saved")
    }
}

fn grid(criterion: &mut Criterion) {
    let middle = Middle::of_the_drive();
    let mut group = criterion.benchmark_group("insert");
    group.throughput(Throughput::Elements(SECOND as u64));
    group.bench_function("a second of scans", |bench| {
        let insert = |grid: &mut Visagge| insert_all(grid, &middle.second);
        bench.iter_batched_ref(|| middle.grid(), insert, BatchSize::PerIteration);
    });
    group.finish();

    let mut group = criterion.benchmark_group("map");
    let after = |seconds: usize| {
        let mut grid = middle.grid();
        black_box(grid.map());
        (0..seconds).for_each(|_| insert_all(&mut grid, &middle.second));
        grid
    };
    group.bench_function("nothing changed", |bench| {
        bench.iter_batched_ref(|| after(0), |grid| grid.map(), BatchSize::PerIteration);
    });
    group.bench_function("after a second", |bench| {
        bench.iter_batched_ref(|| after(1), |grid| grid.map(), BatchSize::PerIteration);
    });
    group.bench_function("all anew", |bench| {
        bench.iter_batched_ref(|| middle.grid(), |grid| grid.map(), BatchSize::PerIteration);
    });
    group.finish();
}

criterion_group! {
    name = inner;
    config = Criterion::default().sample_size(20);
    targets = decode, grid
}
criterion_main!(inner);
