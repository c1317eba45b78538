//! The map is the one of who judges everything anew, no matter when and how often maps were asked for.

#[path = "../benches/laid/mod.rs"]
mod laid;

use laid::Laid;
use proptest::prelude::*;
use scipsim::{SimulationOptions, World};
use std::sync::LazyLock;
use visagged::{
    grid::{
        idea::Idea,
        sweep::Sweep,
        visagge::{Visagge, VisaggeSettings},
    },
    map::Map,
};

/// Drives with mirrors, glass, people, and what is taken away, at five times the speed: a fifth of the scans.
static DRIVES: LazyLock<Vec<Vec<Laid>>> =
    LazyLock::new(|| ["mirror-corridor", "hall", "two-passes", "busy-lobby"].map(laid).into());

fn laid(world: &str) -> Vec<Laid> {
    let world = World::load(world).expect("the name of a world");
    let options = SimulationOptions { speed: 5.0, ..SimulationOptions::default() };
    laid::laid(&world, options)
}

/// The same grid as after a restart, which has judged nothing yet.
fn restarted(grid: &Visagge, settings: &VisaggeSettings) -> Visagge {
    Visagge::load(&grid.save(), settings.clone()).expect("it was a grid")
}

/// What is different.
fn compare(map: &Map, fresh: &Map) -> Result<(), String> {
    let layers = map.layers.iter().zip(&fresh.layers).filter(|(a, b)| a != b).map(|(a, _)| a.name);
    let different: Vec<_> = layers.collect();
    let cells = map.occupancy.iter().zip(&fresh.occupancy).filter(|(a, b)| a != b).count();
    if map == fresh { Ok(()) } else { Err(format!("{cells} cells, and of the layers {different:?}")) }
}

#[derive(Clone, Debug)]
enum Step {
    /// Inserts so many scans, and asks for no map.
    Drive(usize),
    /// So many again, with a map after each.
    Ask(usize),
    Restart,
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let step = prop_oneof![
        6 => (1usize..60).prop_map(Step::Drive),
        4 => (1usize..4).prop_map(Step::Ask),
        1 => Just(Step::Restart),
    ];
    proptest::collection::vec(step, 5..30)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, max_shrink_iters: 200, ..ProptestConfig::default() })]
    #[test]
    fn the_map_does_not_depend_on_when_it_was_asked_for(
        world in 0usize..4,
        begin in 0.0..0.7,
        steps in steps(),
        without in proptest::sample::subsequence(Idea::ALL.to_vec(), 0..2),
    ) {
        let settings = VisaggeSettings { without, ..VisaggeSettings::default() };
        let mut grid = Visagge::new(0.05, settings.clone());
        let drive = &DRIVES[world];
        let mut scans = drive[(begin * drive.len() as f64) as usize..].iter();
        let mut insert = |grid: &mut Visagge, count| {
            for (scan, start, end) in scans.by_ref().take(count) {
                grid.insert(&Sweep { scan, start: *start, end: *end });
            }
        };
        for step in steps {
            match step {
                Step::Drive(count) => insert(&mut grid, count),
                Step::Ask(count) => for _ in 0..count {
                    insert(&mut grid, 1);
                    prop_assert_eq!(compare(&grid.map(), &restarted(&grid, &settings).map()), Ok(()));
                },
                Step::Restart => grid = restarted(&grid, &settings),
            }
        }
        prop_assert_eq!(compare(&grid.map(), &restarted(&grid, &settings).map()), Ok(()));
    }
}
