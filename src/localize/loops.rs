//! Closes the loops of a drive that has been located: finds where it came back to a place, and bends it so that both visits
//! fall together.
//!
//! For a drive as a whole, or as far as it has come. It is cut into segments of some metres, each with a matching map and with its points
//! put together, which tell a place far better than one scan does. What one segment shows is sought in the maps of those that
//! may be near; what several of them say of each other in agreement is believed ([pairwise consistency][pcm]), and a
//! [pose graph](super::graph) spreads what was out over the way between. Where nothing is out by more than the walls
//! are thick, nothing is touched: a graph cannot make better what is good already.
//!
//! [pcm]: https://doi.org/10.1109/ICRA.2018.8460217 "Mangelson et al. 2018"

use super::free;
use super::graph::{self, Edge};
use super::matcher::{Match, difference, refine};
use super::points::{Points, ScanPoint};
use super::search::{self, Headings};
use super::submap::{Submap, index};
use crate::pose::{Pose, interpolate};
use nalgebra::{Matrix3, Vector3};
use std::{
    collections::{HashMap, HashSet},
    fmt,
};

/// Way and turn between two scans that are put into a segment (m, rad).
const KEY: [f64; 2] = [0.15, 0.15];
/// A segment begins every so often, and is so long (m): long enough to see more than a wall, short enough not to bend.
const STEP: f64 = 3.0;
/// See [`STEP`].
const LENGTH: f64 = 6.0;
/// What lies closer together on the way than this is no loop (m): the matching maps hold it already.
const LOOP: f64 = 20.0;
/// Segments whose beginnings are no farther apart may show the same (m).
const NEAR: f64 = 5.0;
/// By how much a drive may be out, for each metre of the way between: place (m/m) and heading (rad/m). Ranges of a scanner that
/// bends straight walls lost 34 degrees over 105 m.
const OUT: [f64; 2] = [0.15, 0.007];
/// A segment fits where surfaces explain this share of its points in known space, which are this share of all: near where it is
/// expected, and anywhere. Who comes back round a corner knows but a third of what there is to see.
const EXPLAINED: f64 = 0.75;
/// See [`EXPLAINED`].
const KNOWN: [f64; 2] = [0.3, 0.5];
/// ... and no other place fits better than this part as well.
const ONLY: f64 = 0.85;
/// How far a refinement may lead (m, rad): beyond, it is another place that it found.
const REFINED: [f64; 2] = [0.5, 0.15];
/// What was tried from a pose that differs by less need not be tried again (m, rad): a refinement leads to the same place, and a
/// search looks at the same headings.
const SAME_NEAR: [f64; 2] = [0.05, 0.01];
/// See [`SAME_NEAR`].
const SAME_FAR: [f64; 2] = [1.0, 0.05];
/// Searches of a whole map for one segment at most, and for all of a drive.
const SEARCHES: [usize; 2] = [4, 600];
/// Deviations of a closure beside those of the match (m, rad): segments bend.
const CLOSURE: [f64; 2] = [0.02, 0.003];
/// Deviations of the way from one segment to the next, for the square root of a metre (m, rad).
const WAY: [f64; 2] = [0.02, 0.01];
/// How far two closures may contradict each other: at once (m, rad), and for each metre of the way between them (rad/m).
const AGREE: [f64; 3] = [0.15, 0.03, 0.012];
/// As many must agree for any to be believed.
const WITNESSES: usize = 3;
/// Squared deviations beyond which a closure is given up after all: five.
const OUTLIER: f64 = 25.0;
/// Nothing is touched where no closure is out by more (m, rad): two cells, and half a degree. Less can come from the last metres
/// alone, and to spread it over all of the way moves what was right (an office ring of 190 m: 2 cm of error became 4).
const GOOD: [f64; 2] = [0.1, 0.01];
/// Squared deviations by which the way may be bent in all. A building that looks alike in many places has closures that agree
/// and are all wrong; they bend a way by more than it can have been out (190 on a ring of offices; 34 degrees of error that a
/// real drive had come to 40).
const MOST_BENT: f64 = 80.0;
/// Segments that lie in each other's maps afterwards and where surfaces explain less than this share of the points contradict
/// the closures.
const CONTRADICTS: f64 = 0.6;
/// ... of which no more than this part may do so.
const CONTRADICTED: f64 = 0.25;
/// Sets of closures that are tried at most, one after the other.
const TRIES: usize = 3;
/// How often closures are sought anew from where the graph has put the segments.
const ROUNDS: usize = 3;

/// A stretch of the drive.
#[derive(Debug)]
struct Segment {
    /// The scanner where it begins, as it was located.
    pose: Pose,
    /// Way driven until there (m).
    way: f64,
    map: Submap,
    /// Its points in the frame of its beginning, no two in one cell of the matching map.
    points: Vec<ScanPoint>,
    taken: HashSet<(i32, i32)>,
}

/// Counts the way of a drive, and tells which of its scans are enough to know it by.
#[derive(Debug, Default)]
pub struct Odometer {
    /// The last of these scans, and the way until there (m).
    last: Option<(Pose, f64)>,
}

impl Odometer {
    /// The way driven until the scanner was here (m), and whether this is one of these scans.
    pub fn advance(&mut self, pose: &Pose) -> (f64, bool) {
        let (way, is_key) = match &self.last {
            None => (0.0, true),
            Some((last, way)) => {
                let off = difference(pose, last);
                let moved = off.xy().norm();
                (way + moved, moved >= KEY[0] || off.z.abs() >= KEY[1])
            }
        };
        if is_key {
            self.last = Some((*pose, way));
        }
        (way, is_key)
    }
}

/// A drive, as it was located.
#[derive(Debug, Default)]
pub struct Drive {
    segments: Vec<Segment>,
    odometer: Odometer,
    /// Way until the last of its scans (m).
    end: f64,
    known: Known,
}

/// Numbers of two segments: of the one whose map it is, and of the one whose points are laid onto it.
type Pair = (usize, usize);

/// What was found when segments were laid onto each other's maps: near where they were expected, and anywhere. Each search
/// would else begin with all that the one before has done.
#[derive(Debug, Default)]
struct Known {
    near: HashMap<Pair, Tried<Match>>,
    far: HashMap<Pair, Tried<Option<Match>>>,
    /// Segments that were complete then; the others have grown since.
    complete: usize,
}

impl Known {
    fn forget_incomplete(&mut self) {
        self.near.retain(|(_, to), _| *to < self.complete);
        self.far.retain(|(_, to), _| *to < self.complete);
    }
}

/// What was found from an expected pose.
#[derive(Clone, Copy, Debug)]
struct Tried<T> {
    expected: Pose,
    found: T,
}

impl<T: Copy> Tried<T> {
    /// What is known of a pair, or else what is found, where the pose that is expected is another by so much (m, rad).
    fn or_try(
        known: &mut HashMap<Pair, Tried<T>>,
        pair: Pair,
        expected: Pose,
        [place, turn]: [f64; 2],
        find: impl FnOnce() -> T,
    ) -> T {
        let is_as_before = |tried: &&Tried<T>| {
            let off = difference(&tried.expected, &expected);
            off.xy().norm() <= place && off.z.abs() <= turn
        };
        if let Some(tried) = known.get(&pair).filter(is_as_before) {
            return tried.found;
        }
        let found = find();
        known.insert(pair, Tried { expected, found });
        found
    }
}

/// Two segments that show the same.
#[derive(Clone, Copy, Debug)]
struct Closure {
    edge: Edge,
}

/// How a drive is to be bent.
#[derive(Clone, Debug)]
pub struct Correction {
    /// Way driven (m), and what to put before a pose there.
    steps: Vec<(f64, Pose)>,
    /// Closures that agree.
    pub closures: usize,
    /// How far the one that was out most was out (m, rad).
    pub out: [f64; 2],
    /// ... and is now (m, rad).
    pub left: [f64; 2],
}

/// What a search for loops found.
#[derive(Clone, Debug)]
pub enum Loops {
    /// None that is sure.
    None,
    /// So many, and none is out by more than walls are thick (m, rad).
    Good {
        /// Closures that agree.
        closures: usize,
        /// How far the one that is out most is out (m, rad).
        out: [f64; 2],
    },
    /// The drive is to be bent.
    Bent(Correction),
}

impl fmt::Display for Loops {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let out = |[place, turn]: [f64; 2]| format!("{place:.2} m, {:.1} degrees", turn.to_degrees());
        match self {
            Loops::None => f.write_str("no loop was found that is sure: the poses are as they were located"),
            Loops::Good { closures, out: most } => write!(
                f,
                "the drive came back {closures} times and was out by {} at most: nothing is moved",
                out(*most)
            ),
            Loops::Bent(correction) => write!(
                f,
                "the drive came back {} times and was out by {} at most, now by {}",
                correction.closures,
                out(correction.out),
                out(correction.left)
            ),
        }
    }
}

impl Drive {
    /// Takes in a scan that was located: the scanner in its middle, and its points. Returns the way driven until there (m).
    pub fn add(&mut self, pose: &Pose, points: impl FnOnce() -> Points) -> f64 {
        let (way, is_key) = self.odometer.advance(pose);
        if is_key {
            self.add_key(way, pose, &points());
        }
        way
    }

    /// Takes in a scan that an [`Odometer`] of its own has told to be enough, after so much way (m).
    pub fn add_key(&mut self, way: f64, pose: &Pose, points: &Points) {
        self.end = way;
        if self.segments.last().is_none_or(|last| way >= last.way + STEP) {
            for complete in self.segments.iter_mut().filter(|segment| way >= segment.way + LENGTH) {
                complete.taken = HashSet::new();
                complete.points.shrink_to_fit();
            }
            self.segments.push(Segment {
                pose: *pose,
                way,
                map: Submap::default(),
                points: Vec::new(),
                taken: HashSet::new(),
            });
        }
        for segment in self.segments.iter_mut().rev().take_while(|segment| way < segment.way + LENGTH) {
            segment.add(pose, points);
        }
    }

    /// Memory that it holds (bytes).
    pub fn bytes(&self) -> usize {
        self.segments.iter().map(Segment::bytes).sum()
    }

    /// Seeks loops, and how to close them where the drive has been bent like `bent` already.
    pub fn close(&mut self, bent: Option<&Correction>) -> Loops {
        let mut known = std::mem::take(&mut self.known);
        known.forget_incomplete();
        let loops = self.close_knowing(&mut known, bent);
        known.complete = self.segments.partition_point(|segment| segment.way + LENGTH <= self.end);
        self.known = known;
        loops
    }

    fn close_knowing(&self, known: &mut Known, bent: Option<&Correction>) -> Loops {
        let before: Vec<Pose> = self.segments.iter().map(|segment| segment.pose).collect();
        let now: Vec<Pose> = self
            .segments
            .iter()
            .map(|segment| bent.map_or(segment.pose, |bent| bent.correct(segment.way, &segment.pose)))
            .collect();
        let way: Vec<Edge> = (1..before.len()).map(|to| self.way_edge(to)).collect();
        let mut nodes = now.clone();
        let mut agreed: Vec<Closure> = Vec::new();
        for round in 0..ROUNDS {
            let found = self.seek(known, &nodes, round == 0);
            let Some((bent, kept)) = self.believe(known, &before, &way, found) else { break };
            // Whoever finds fewer from a better start was wrong.
            if kept.len() < agreed.len() {
                break;
            }
            (nodes, agreed) = (bent, kept);
        }
        if agreed.is_empty() {
            return Loops::None;
        }
        let (out, left) = (worst(&agreed, &now), worst(&agreed, &nodes));
        let closures = agreed.len();
        if out[0] <= GOOD[0] && out[1] <= GOOD[1] {
            return Loops::Good { closures, out };
        }
        let steps = self
            .segments
            .iter()
            .zip(&nodes)
            .map(|(segment, node)| (segment.way, node * segment.pose.inverse()));
        Loops::Bent(Correction { steps: steps.collect(), closures, out, left })
    }

    /// What the drive says of a segment relative to the one before.
    fn way_edge(&self, to: usize) -> Edge {
        let (a, b) = (&self.segments[to - 1], &self.segments[to]);
        let length = (b.way - a.way).max(KEY[0]);
        let weight = |sigma: f64| 1.0 / (sigma * sigma * length);
        let information =
            Matrix3::from_diagonal(&Vector3::new(weight(WAY[0]), weight(WAY[0]), weight(WAY[1])));
        Edge { from: to - 1, to, pose: a.pose.inverse() * b.pose, information }
    }

    /// Segments that show what others show, where the nodes are about right; `far`: where they may be out by as much as such a
    /// way allows.
    fn seek(&self, known: &mut Known, nodes: &[Pose], far: bool) -> Vec<Closure> {
        let mut closures = Vec::new();
        let mut searches = 0;
        for (to, segment) in self.segments.iter().enumerate() {
            let apart = |from: usize| (nodes[from].translation.vector - nodes[to].translation.vector).norm();
            let mut others: Vec<usize> =
                (0..to).filter(|&from| segment.way - self.segments[from].way >= LOOP).collect();
            others.sort_by(|a, b| apart(*a).total_cmp(&apart(*b)));
            let expected = |from: usize| self.segments[from].pose * nodes[from].inverse() * nodes[to];
            let mut found: Vec<(usize, Match)> = others
                .iter()
                .take_while(|&&from| apart(from) <= NEAR)
                .filter_map(|&from| {
                    let there = self.refined(known, (from, to), expected(from));
                    (is_near(&there, &expected(from)) && fits(&there, KNOWN[0])).then_some((from, there))
                })
                .collect();
            // Whoever is at home already need not be sought far away.
            if far && found.is_empty() {
                let allowed = |from: usize| {
                    let way = segment.way - self.segments[from].way;
                    [NEAR + OUT[0] * way, REFINED[1] + OUT[1] * way]
                };
                let may_be = others.iter().filter(|&&from| apart(from) <= allowed(from)[0]);
                for &from in may_be.take(SEARCHES[0].min(SEARCHES[1] - searches)) {
                    searches += 1;
                    let there = Tried::or_try(&mut known.far, (from, to), expected(from), SAME_FAR, || {
                        segment.fits_far(&self.segments[from].map, &expected(from), allowed(from))
                    });
                    found.extend(there.map(|there| (from, there)));
                }
            }
            closures.extend(
                found.iter().map(|(from, found)| closure(*from, to, &self.segments[*from].pose, found)),
            );
        }
        closures
    }

    /// Where a segment lies best in the map of another one, near where it is expected.
    fn refined(&self, known: &mut Known, (from, to): Pair, expected: Pose) -> Match {
        let (map, points) = (&self.segments[from].map, &self.segments[to].points);
        Tried::or_try(&mut known.near, (from, to), expected, SAME_NEAR, || {
            refine(map, points, &free(expected))
        })
    }

    /// The nodes bent to the closures that can be believed, and these.
    fn believe(
        &self,
        known: &mut Known,
        before: &[Pose],
        way: &[Edge],
        mut found: Vec<Closure>,
    ) -> Option<(Vec<Pose>, Vec<Closure>)> {
        for _ in 0..TRIES {
            let set = self.agreeing(&found);
            if set.len() < WITNESSES {
                return None;
            }
            let is_in_set = |closure: &Closure| set.iter().any(|other| other.is_same(closure));
            let others = found.iter().copied().filter(|closure| !is_in_set(closure)).collect();
            if let Some((nodes, kept)) = bend(before, way, set) {
                let bent: f64 = way.iter().map(|edge| edge.squared_deviations(&nodes)).sum();
                if kept.len() >= WITNESSES && bent <= MOST_BENT && !self.is_contradicted(known, &nodes) {
                    return Some((nodes, kept));
                }
            }
            found = others;
        }
        None
    }

    /// Whether much of what lies together then does not look alike.
    fn is_contradicted(&self, known: &mut Known, nodes: &[Pose]) -> bool {
        let (mut looks, mut against) = (0, 0);
        for (to, segment) in self.segments.iter().enumerate() {
            for (from, other) in self.segments[..to].iter().enumerate() {
                let apart = (nodes[from].translation.vector - nodes[to].translation.vector).norm();
                if segment.way - other.way < LOOP || apart > 2.0 * NEAR {
                    continue;
                }
                let expected = other.pose * nodes[from].inverse() * nodes[to];
                let found = self.refined(known, (from, to), expected);
                if found.known >= KNOWN[1] {
                    looks += 1;
                    against += usize::from(found.explained < CONTRADICTS || !is_near(&found, &expected));
                }
            }
        }
        against as f64 > CONTRADICTED * looks as f64
    }

    /// The most closures that all agree with each other.
    fn agreeing(&self, closures: &[Closure]) -> Vec<Closure> {
        let agree: Vec<Bits> =
            closures.iter().map(|a| closures.iter().map(|b| self.agrees(a, b)).collect()).collect();
        let friends: Vec<usize> = agree.iter().map(Bits::count).collect();
        let mut order: Vec<usize> = (0..closures.len()).collect();
        order.sort_by_key(|&a| std::cmp::Reverse(friends[a]));
        let mut best: Vec<usize> = Vec::new();
        for &seed in &order {
            if friends[seed] <= best.len() {
                break;
            }
            let mut set = vec![seed];
            let mut agreed = agree[seed].clone();
            for &next in &order {
                if next != seed && agreed.has(next) {
                    set.push(next);
                    agreed.keep(&agree[next]);
                }
            }
            if set.len() > best.len() {
                best = set;
            }
        }
        best.sort_unstable();
        best.into_iter().map(|number| closures[number]).collect()
    }

    /// Whether two closures can both be right: around the ring of both, the ways between them are short or out by little.
    fn agrees(&self, a: &Closure, b: &Closure) -> bool {
        let (a, b) = (&a.edge, &b.edge);
        let pose = |number: usize| &self.segments[number].pose;
        let there = pose(a.from).inverse() * pose(b.from);
        let here = pose(a.to).inverse() * pose(b.to);
        let way = |from: usize, to: usize| (self.segments[from].way - self.segments[to].way).abs();
        let between = way(a.from, b.from) + way(a.to, b.to);
        let off = difference(&(a.pose * here), &(there * b.pose));
        let turn = AGREE[1] + AGREE[2] * between;
        let lever = here.translation.vector.norm().max(there.translation.vector.norm());
        off.z.abs() <= turn && off.xy().norm() <= AGREE[0] + turn * lever
    }
}

/// A bit for each closure: of long drives there are thousands, and each is held against all others.
#[derive(Clone, Debug)]
struct Bits(Vec<u64>);

impl FromIterator<bool> for Bits {
    fn from_iter<T: IntoIterator<Item = bool>>(bits: T) -> Bits {
        let mut words = Vec::new();
        for (number, bit) in bits.into_iter().enumerate() {
            if number % 64 == 0 {
                words.push(0);
            }
            words[number / 64] |= u64::from(bit) << (number % 64);
        }
        Bits(words)
    }
}

impl Bits {
    fn has(&self, number: usize) -> bool {
        self.0[number / 64] >> (number % 64) & 1 == 1
    }

    fn count(&self) -> usize {
        self.0.iter().map(|word| word.count_ones() as usize).sum()
    }

    /// Keeps those that are in both.
    fn keep(&mut self, others: &Bits) {
        self.0.iter_mut().zip(&others.0).for_each(|(word, other)| *word &= other);
    }
}

impl Segment {
    fn bytes(&self) -> usize {
        let points = self.points.capacity() * size_of::<ScanPoint>();
        self.map.bytes() + points + self.taken.capacity() * size_of::<(i32, i32)>()
    }

    fn add(&mut self, pose: &Pose, points: &Points) {
        self.map.insert(points, pose);
        let by = self.pose.inverse() * pose;
        for point in &points.thinned {
            let at = by * point.at;
            if self.taken.insert((index(at.x), index(at.y))) {
                let normal = point.normal.map(|normal| by.rotation * normal);
                self.points.push(ScanPoint { at, normal, ..*point });
            }
        }
    }

    /// Its place in another segment's map within a distance and a turn (m, rad) of the expected one, if there is exactly one.
    fn fits_far(&self, map: &Submap, expected: &Pose, [reach, turn]: [f64; 2]) -> Option<Match> {
        let headings = Headings { middle: expected.rotation.angle(), turn };
        let mut matches: Vec<Match> = search::anywhere(map, &self.points, headings, 0.3)
            .iter()
            .map(|candidate| refine(map, &self.points, &free(candidate.pose)))
            .collect();
        let fit = |found: &Match| found.explained * found.known;
        matches.sort_by(|a, b| fit(b).total_cmp(&fit(a)));
        let best = *matches.first()?;
        let is_other = |found: &&Match| {
            let off = difference(&found.pose, &best.pose);
            off.xy().norm() > REFINED[0] || off.z.abs() > REFINED[1]
        };
        let second = matches.iter().find(is_other).map_or(0.0, fit);
        let off = difference(&best.pose, expected);
        let is_possible = off.xy().norm() <= reach && off.z.abs() <= turn;
        (is_possible && fits(&best, KNOWN[1]) && second <= ONLY * fit(&best)).then_some(best)
    }
}

impl Closure {
    fn is_same(&self, other: &Closure) -> bool {
        (self.edge.from, self.edge.to) == (other.edge.from, other.edge.to)
    }
}

/// Whether a refinement has led to the place that was meant.
fn is_near(found: &Match, expected: &Pose) -> bool {
    let off = difference(&found.pose, expected);
    off.xy().norm() <= REFINED[0] && off.z.abs() <= REFINED[1]
}

fn fits(found: &Match, known: f64) -> bool {
    found.explained >= EXPLAINED && found.known >= known
}

/// `to` was found in the map of `from`, whose beginning that map has at `pose`.
fn closure(from: usize, to: usize, pose: &Pose, found: &Match) -> Closure {
    // What the points know, in the frame of what was found; a little of everything, so that it can be inverted.
    let mut turn = Matrix3::identity();
    turn.fixed_view_mut::<2, 2>(0, 0).copy_from(found.pose.rotation.to_rotation_matrix().matrix());
    let caution = super::CAUTION * super::CAUTION;
    let known = turn.transpose() * found.information * turn / caution + Matrix3::identity() * 0.1;
    let floor = Vector3::new(CLOSURE[0], CLOSURE[0], CLOSURE[1]).map(|sigma| sigma * sigma);
    let covariance = known.try_inverse().unwrap_or_else(Matrix3::identity) + Matrix3::from_diagonal(&floor);
    let information = covariance.try_inverse().unwrap_or_else(Matrix3::identity);
    let edge = Edge { from, to, pose: pose.inverse() * found.pose, information };
    Closure { edge }
}

/// Bends the way so that it suits the closures, without those that then still contradict it; `None` where that are too many.
fn bend(before: &[Pose], way: &[Edge], mut closures: Vec<Closure>) -> Option<(Vec<Pose>, Vec<Closure>)> {
    let most_dropped = closures.len() / 3;
    let mut nodes = before.to_vec();
    for _ in 0..=most_dropped {
        let edges: Vec<Edge> =
            way.iter().copied().chain(closures.iter().map(|closure| closure.edge)).collect();
        nodes = graph::solve(&nodes, &edges)?;
        let deviations = closures.iter().map(|closure| closure.edge.squared_deviations(&nodes));
        let (worst, most) = deviations.enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
        if most <= OUTLIER {
            return Some((nodes, closures));
        }
        closures.swap_remove(worst);
    }
    None
}

/// How far the closures are out at most (m, rad).
fn worst(closures: &[Closure], nodes: &[Pose]) -> [f64; 2] {
    closures
        .iter()
        .map(|closure| closure.edge.error(nodes))
        .fold([0.0; 2], |[place, turn], error| [error.xy().norm().max(place), error.z.abs().max(turn)])
}

impl Correction {
    /// What is to be put before a pose at the end of the drive.
    pub fn last(&self) -> Pose {
        self.steps.last().map_or_else(Pose::identity, |(_, last)| *last)
    }

    /// Where a pose belongs that was located after so much way (m).
    pub fn correct(&self, way: f64, pose: &Pose) -> Pose {
        let after = self.steps.partition_point(|(at, _)| *at <= way);
        let Some((begin, before)) = after.checked_sub(1).map(|number| &self.steps[number]) else {
            return self.steps.first().map_or(*pose, |(_, first)| first * pose);
        };
        let Some((end, next)) = self.steps.get(after) else { return before * pose };
        interpolate(&(before * pose), &(next * pose), (way - begin) / (end - begin))
    }
}
