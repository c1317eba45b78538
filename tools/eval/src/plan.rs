//! Which drives are marked: worlds, seeds and variants. The seeds for tuning and for validation are kept apart here and
//! nowhere else.

use anyhow::{Context, Result};
use clap::ValueEnum;
use scipsim::{PoseSource, SimulationOptions, World, generate::KINDS};

/// Seeds of generated worlds that rules may be tuned on, with all shipped worlds. 3, 4, 21 to 24, 201 to 203, 301 to 303, 401 to 403 and 501
/// to 503 were looked at for it too, and 701 to 703 once.
const TUNING: [u64; 2] = [1, 2];
/// Seeds of generated worlds that no rule and no number was ever chosen by; one rule was taken out since it brought nothing, here either.
const VALIDATION: [u64; 3] = [801, 802, 803];

/// A set of worlds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
pub enum Set {
    /// The shipped worlds and generated ones: rules were tuned on them.
    Tuning,
    /// Generated worlds that were only ever looked at to report them.
    Validation,
}

impl Set {
    /// The worlds by name.
    fn worlds(self) -> Vec<String> {
        let generated = |seeds: &[u64]| -> Vec<String> {
            KINDS
                .iter()
                // Minutes a drive, and nothing that "office" has not: it is there to be timed.
                .filter(|(kind, _)| *kind != "floor")
                .flat_map(|(kind, _)| seeds.iter().map(move |seed| format!("{kind}-{seed}")))
                .collect()
        };
        match self {
            Set::Tuning => World::shipped().map(String::from).chain(generated(&TUNING)).collect(),
            Set::Validation => generated(&VALIDATION),
        }
    }
}

/// How a drive differs from the world as it is written.
#[derive(Clone, Copy, Debug)]
pub struct Variant {
    /// Short name.
    pub name: &'static str,
    apply: fn(&mut SimulationOptions),
}

/// The world as it is written.
pub const PLAIN: Variant = Variant { name: "plain", apply: |_| {} };

/// All variants.
pub const VARIANTS: [Variant; 17] = [
    PLAIN,
    Variant { name: "lean-0", apply: |o| o.lean_deg = Some(0.0) },
    Variant { name: "lean-0.5", apply: |o| o.lean_deg = Some(0.5) },
    Variant { name: "lean-1", apply: |o| o.lean_deg = Some(1.0) },
    Variant { name: "gain-0.7", apply: |o| o.intensity_gain = 0.7 },
    Variant { name: "gain-1.4", apply: |o| o.intensity_gain = 1.4 },
    Variant { name: "no-intensity", apply: |o| o.intensity = false },
    Variant { name: "pose-error-2", apply: |o| o.pose_error = 2.0 },
    Variant { name: "true-poses", apply: |o| o.poses = PoseSource::Exact },
    Variant { name: "wheels", apply: |o| o.poses = PoseSource::Wheels },
    Variant { name: "speed-0.5", apply: |o| o.speed = 0.5 },
    Variant { name: "speed-2", apply: |o| o.speed = 2.0 },
    Variant { name: "20-hz", apply: |o| o.scan_rate = 20.0 },
    Variant { name: "dust-0.3", apply: |o| o.dust = 0.3 },
    Variant { name: "dust-3", apply: |o| o.dust = 3.0 },
    Variant { name: "frames", apply: |o| o.frames = Some(true) },
    Variant { name: "no-frames", apply: |o| o.frames = Some(false) },
];

/// One drive to be simulated.
#[derive(Clone, Debug)]
pub struct Job {
    /// `None` where the world was named.
    pub set: Option<Set>,
    /// A shipped world, a file, or KIND-SEED.
    pub world: String,
    /// Seed of the noise.
    pub seed: u64,
    /// How it differs.
    pub variant: Variant,
}

impl Job {
    /// World, and where they are not the usual ones, seed and variant.
    pub fn name(&self) -> String {
        let is_usual = self.seed == usual_seed(&self.world);
        let seed = if is_usual { String::new() } else { format!(" seed {}", self.seed) };
        let variant =
            if self.variant.name == PLAIN.name { String::new() } else { format!(" {}", self.variant.name) };
        format!("{}{seed}{variant}", self.world)
    }

    /// What its row of means is called: the set and, where it is not plain, the variant.
    pub fn group(&self) -> String {
        let set = match self.set {
            Some(Set::Tuning) => "tuning",
            Some(Set::Validation) => "validation",
            None => "named",
        };
        if self.variant.name == PLAIN.name { set.into() } else { format!("{set} {}", self.variant.name) }
    }

    /// The world itself.
    pub fn load(&self) -> Result<World> {
        match generated(&self.world) {
            Some((kind, seed)) => World::generate(kind, seed),
            None => World::load(&self.world),
        }
        .with_context(|| format!("cannot simulate `{}`", self.world))
    }

    /// How it is simulated.
    pub fn options(&self) -> SimulationOptions {
        let mut options = SimulationOptions { seed: self.seed, ..Default::default() };
        (self.variant.apply)(&mut options);
        options
    }
}

/// Kind and seed of a generated world, which is named KIND-SEED.
fn generated(world: &str) -> Option<(&str, u64)> {
    let (kind, seed) = world.rsplit_once('-')?;
    let known = KINDS.iter().any(|(name, _)| *name == kind);
    Some((kind, seed.parse().ok().filter(|_| known)?))
}

/// Seed of the noise where none is asked for: a generated world's own.
fn usual_seed(world: &str) -> u64 {
    generated(world).map_or(1, |(_, seed)| seed)
}

/// The drives of these worlds, or else of these sets, with each of these seeds, or else the usual one, in each of these
/// variants.
pub fn jobs(worlds: &[String], seeds: &[u64], sets: &[Set], variants: &[Variant]) -> Vec<Job> {
    let worlds: Vec<(Option<Set>, String)> = if worlds.is_empty() {
        let of_set =
            |set: &Set| set.worlds().into_iter().map(|world| (Some(*set), world)).collect::<Vec<_>>();
        sets.iter().flat_map(of_set).collect()
    } else {
        worlds.iter().map(|world| (None, world.clone())).collect()
    };
    let mut jobs = Vec::new();
    for (set, world) in worlds {
        let usual = [usual_seed(&world)];
        for &seed in if seeds.is_empty() { &usual } else { seeds } {
            let job = |&variant: &Variant| Job { set, world: world.clone(), seed, variant };
            jobs.extend(variants.iter().map(job));
        }
    }
    jobs
}

/// A variant by its name.
pub fn variant(name: &str) -> Result<Variant, String> {
    VARIANTS.into_iter().find(|variant| variant.name == name).ok_or_else(|| {
        format!("no such variant; known are {}", VARIANTS.map(|variant| variant.name).join(", "))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sets_share_no_world() {
        let tuning = Set::Tuning.worlds();
        assert!(Set::Validation.worlds().iter().all(|world| !tuning.contains(world)));
        assert!(TUNING.iter().all(|seed| !VALIDATION.contains(seed)));
    }

    #[test]
    fn every_world_of_the_sets_can_be_had() {
        for job in jobs(&[], &[], &[Set::Tuning, Set::Validation], &[PLAIN]) {
            job.load().unwrap();
        }
    }

    #[test]
    fn named_worlds_and_variants_make_the_jobs() {
        let variants = ["plain", "lean-1"].map(|name| variant(name).unwrap());
        let worlds = ["hall".into(), "lobby-7".into()];
        let names = |seeds: &[u64]| -> Vec<String> {
            jobs(&worlds, seeds, &[Set::Tuning], &variants).iter().map(Job::name).collect()
        };
        assert_eq!(names(&[]), ["hall", "hall lean-1", "lobby-7", "lobby-7 lean-1"]);
        assert_eq!(names(&[1]), ["hall", "hall lean-1", "lobby-7 seed 1", "lobby-7 seed 1 lean-1"]);
        assert!(variant("upright").unwrap_err().contains("dust-3"));
        assert!(jobs(&["castle-1".into()], &[], &[], &variants)[0].load().is_err());
    }
}
