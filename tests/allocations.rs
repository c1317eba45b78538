//! Inserting a scan takes no memory once the map holds what is there.
#![allow(unsafe_code)]

use std::{
    alloc::{GlobalAlloc, Layout, System},
    f64::consts::PI,
    sync::atomic::{AtomicUsize, Ordering::Relaxed},
};
use visagged::{
    grid::{
        sweep::Sweep,
        visagge::{Visagge, VisaggeSettings},
    },
    pose::pose,
    scan::{Geometry, Scan},
};

/// The system's allocator, counting.
struct Counting;

static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);

// SAFETY: all is passed on as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Relaxed);
        // SAFETY: the caller's promises are passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: the caller's promises are passed on.
        unsafe { System.dealloc(memory, layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Relaxed);
        // SAFETY: the caller's promises are passed on.
        unsafe { System.realloc(memory, layout, size) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

/// A square room of 12 m, seen from a place in it.
fn scan(seq: u64, x: f64) -> Scan {
    let range = |beam: usize| {
        let (sin, cos) = (-0.75 * PI + beam as f64 * 0.25f64.to_radians()).sin_cos();
        let wall =
            |from: f64, along: f64| if along > 0.0 { (6.0 - from) / along } else { -(6.0 + from) / along };
        wall(x, cos).min(wall(0.0, sin)) as f32
    };
    Scan {
        seq,
        stamp_ns: seq as i64 * 25_000_000,
        received_ns: seq as i64 * 25_000_000,
        geometry: Geometry {
            angle_min: -0.75 * PI,
            angle_increment: 0.25f64.to_radians(),
            time_increment: 0.0,
            range_min: 0.023,
            range_max: 60.0,
        },
        ranges: (0..1081).map(range).collect(),
        intensities: Vec::new(),
    }
}

#[test]
fn a_map_that_holds_all_there_is_takes_no_memory() {
    let there: Vec<f64> = (0..100).map(|step| 0.025 * f64::from(step)).collect();
    let lap: Vec<f64> = there.iter().chain(there.iter().rev()).copied().collect();
    let drive: Vec<(Scan, f64)> = lap
        .iter()
        .cycle()
        .take(3 * lap.len())
        .enumerate()
        .map(|(seq, &x)| (scan(seq as u64, x), x))
        .collect();
    for portably in [false, true] {
        let mut grid = Visagge::new(0.05, VisaggeSettings::default());
        let mut counts = [0; 3];
        for (number, (scan, x)) in drive.iter().enumerate() {
            let at = pose(*x, 0.0, 0.0);
            let sweep = Sweep { scan, start: at, end: at };
            let before = ALLOCATIONS.load(Relaxed);
            if portably {
                grid.insert_portably(&sweep)
            } else {
                grid.insert(&sweep)
            }
            counts[number / lap.len()] += ALLOCATIONS.load(Relaxed) - before;
        }
        assert!(counts[0] > 0, "the first lap fills the map");
        assert_eq!(counts[2], 0, "{counts:?}");
    }
}
