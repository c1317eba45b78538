//! The map is the one of who judges everything anew, no matter when and how often maps were asked for.

#[path = "../benches/laid/mod.rs"]
mod laid;

use laid::Laid;
use proptest::prelude::*;
use scipsim::{SimulationOptions, World, WorldError};
use std::sync::LazyLock;
use visagged::{
    grid::{
        idea::Idea,
        sweep::Sweep,
        visagge::{Visagge, VisaggeSettings},
    },
    map::Map,
    pose::Pose,
};

/// Drives with mirrors, glass, people, what is taken away, and images of images, at five times the speed: a fifth of the scans.
static DRIVES: LazyLock<[Vec<Laid>; 4]> = LazyLock::new(|| {
    let worlds = ["mirror-corridor", "hall", "two-passes"].map(World::load).into_iter();
    let all: Vec<_> = worlds.chain([World::generate("lobby", 1)]).map(laid).collect();
    all.try_into().expect("four")
});

fn laid(world: Result<World, WorldError>) -> Vec<Laid> {
    let world = world.expect("the name of a world");
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

/// The middle of one of the cells shown: this part of them come before it.
fn shown(map: &Map, part: f64) -> Option<Pose> {
    let cells: Vec<usize> = (0..map.occupancy.len()).filter(|&cell| map.occupancy[cell] == 100).collect();
    let cell = *cells.get((part * cells.len() as f64) as usize)?;
    let at = |origin: f64, index: usize| origin + (index as f64 + 0.5) * map.resolution;
    Some(Pose::translation(at(map.origin[0], cell % map.width), at(map.origin[1], cell / map.width)))
}

#[derive(Clone, Debug)]
enum Step {
    /// Inserts so many scans, and asks for no map.
    Drive(usize),
    /// So many again, with a map after each.
    Ask(usize),
    /// The scanner stands for a scan without returns where one of the cells shown is (this part of them before it), and nowhere else
    /// is anything changed: what stood there has gone.
    Stand(f64),
    Restart,
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let step = prop_oneof![
        6 => (1usize..300).prop_map(Step::Drive),
        2 => (1usize..4).prop_map(Step::Ask),
        8 => (0.0..1.0).prop_map(Step::Stand),
        1 => Just(Step::Restart),
    ];
    proptest::collection::vec(step, 5..30)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, max_shrink_iters: 200, ..ProptestConfig::default() })]
    #[test]
    fn the_map_does_not_depend_on_when_it_was_asked_for(
        world in 0usize..4,
        begin in 0.0..0.4,
        steps in steps(),
        without in proptest::sample::subsequence(Idea::ALL.to_vec(), 0..2),
    ) {
        let settings = VisaggeSettings { without, ..VisaggeSettings::default() };
        let mut grid = Visagge::new(0.05, settings.clone());
        let drive = &DRIVES[world];
        let mut scans = drive[(begin * drive.len() as f64) as usize..].iter().cloned();
        let insert = |grid: &mut Visagge, (scan, start, end): Laid| {
            grid.insert(&Sweep { scan: &scan, start, end });
        };
        for step in steps {
            match step {
                Step::Drive(count) => scans.by_ref().take(count).for_each(|scan| insert(&mut grid, scan)),
                Step::Ask(count) => for scan in scans.by_ref().take(count) {
                    insert(&mut grid, scan);
                    prop_assert_eq!(compare(&grid.map(), &restarted(&grid, &settings).map()), Ok(()));
                },
                Step::Stand(part) => {
                    let at = shown(&grid.map(), part);
                    let Some((pose, (mut scan, ..))) = at.zip(scans.next()) else { continue };
                    scan.ranges.fill(f32::NAN);
                    insert(&mut grid, (scan, pose, pose));
                    prop_assert_eq!(compare(&grid.map(), &restarted(&grid, &settings).map()), Ok(()));
                }
                Step::Restart => grid = restarted(&grid, &settings),
            }
        }
        prop_assert_eq!(compare(&grid.map(), &restarted(&grid, &settings).map()), Ok(()));
    }
}
