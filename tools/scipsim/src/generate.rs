//! Makes worlds from a seed, so that nothing is tuned to the shipped ones alone.

use crate::noise::Random;
use crate::world::{Arc, Circle, Course, Frame, Move, Person, Rectangle, Robot, Surface, World, WorldError};

/// Kinds of worlds and what they are.
pub const KINDS: [(&str, &str); 5] = [
    ("hall", "a walkway around an atrium of glass, as in the paper"),
    ("corridor", "a corridor with panes, mirrors and doors of steel in its walls, out and back"),
    ("office", "a ring of corridors with glass offices"),
    ("lobby", "a large room with pillars, showcases, a glass front and many people"),
    (
        "floor",
        "an office floor of 120 x 60 m: eight blocks of rooms, the corridors between them, out and back in 400 m",
    ),
];

/// A world is made again with another seed if the robot would run into something, so often.
const TRIES: u64 = 50;

impl World {
    /// A world of a kind (see [`KINDS`]); the same for the same seed.
    pub fn generate(kind: &str, seed: u64) -> Result<World, WorldError> {
        let invalid = |what: String| WorldError::Invalid { name: format!("{kind} {seed}"), what };
        let mut last = String::new();
        for attempt in 0..TRIES {
            let mut maker = Maker::new(kind, seed, attempt);
            match kind {
                "hall" => maker.hall(),
                "corridor" => maker.corridor(),
                "office" => maker.office(),
                "lobby" => maker.lobby(),
                "floor" => maker.floor(),
                _ => {
                    let known: Vec<&str> = KINDS.iter().map(|k| k.0).collect();
                    return Err(invalid(format!("no such kind; known are {}", known.join(", "))));
                }
            }
            match maker.world.check() {
                Ok(()) => return Ok(maker.world),
                Err(what) => last = what,
            }
        }
        Err(invalid(format!("no try led to a drive that hits nothing; the last: {last}")))
    }
}

/// Something in the wall of a corridor.
enum Feature {
    Pane { framed: bool },
    Mirror,
    Steel,
    Niche,
}

struct Maker {
    random: Random,
    world: World,
}

impl Maker {
    fn new(kind: &str, seed: u64, attempt: u64) -> Maker {
        let name = kind.bytes().fold(0, |n, b| n * 256 + u64::from(b));
        let description = KINDS.iter().find(|k| k.0 == kind).map_or("", |k| k.1);
        Maker {
            random: Random::new(&[0x6e4e, name, seed, attempt]),
            world: World {
                name: format!("{kind}-{seed}"),
                description: format!("Generated: {description}"),
                materials: Default::default(),
                surfaces: Vec::new(),
                people: Vec::new(),
                robot: Robot {
                    path: vec![[0.0, 0.0]],
                    closed: false,
                    laps: 1,
                    speed: 1.0,
                    corner_radius: 0.9,
                    turn_rate_deg: 60.0,
                    heading_deg: 0.0,
                    stops: Vec::new(),
                    body: Default::default(),
                    mount: crate::world::Mount { x: 0.2, y: 0.0, yaw_deg: 0.0 },
                },
            },
        }
    }

    fn line(&mut self, material: &str, line: &[[f64; 2]], frame: Option<Frame>) {
        let line = Some(line.iter().map(|p| p.map(millimetres)).collect());
        self.world.surfaces.push(Surface { material: material.into(), line, frame, ..Default::default() });
    }

    fn pillar(&mut self, material: &str, center: [f64; 2], radius: f64) {
        let circle = Some(Circle { center: center.map(millimetres), radius: millimetres(radius) });
        self.world.surfaces.push(Surface { material: material.into(), circle, ..Default::default() });
    }

    fn a_box(
        &mut self,
        material: &str,
        center: [f64; 2],
        size: [f64; 2],
        turn_deg: f64,
        present: Vec<[f64; 2]>,
    ) {
        let rectangle = Some(Rectangle {
            center: center.map(millimetres),
            size: size.map(millimetres),
            turn_deg: turn_deg.round(),
        });
        self.world.surfaces.push(Surface {
            material: material.into(),
            rectangle,
            present,
            ..Default::default()
        });
    }

    /// A quarter of a circle of glass.
    fn round_corner(&mut self, center: [f64; 2], radius: f64, from_deg: f64) {
        let radius = millimetres(radius);
        let arc = Some(Arc { center: center.map(millimetres), radius, from_deg, to_deg: from_deg + 90.0 });
        let material = self.glass().into();
        self.world.surfaces.push(Surface { material, arc, ..Default::default() });
    }

    /// A leaf of a door that slides along the wall in front of which it hangs, once and perhaps back.
    fn sliding_door(&mut self, material: &str, a: [f64; 2], b: [f64; 2]) {
        let by = [b[0] - a[0], b[1] - a[1]].map(millimetres);
        let at = millimetres(self.random.uniform(8.0, 30.0));
        let mut moves = vec![Move { at, by, seconds: 1.5 }];
        if self.random.chance(0.5) {
            moves.push(Move { at: at + 8.0, by: by.map(|v| -v), seconds: 1.5 });
        }
        self.line(material, &[a, b], None);
        if let Some(door) = self.world.surfaces.last_mut() {
            door.moves = moves;
        }
    }

    fn person(&mut self, path: &[[f64; 2]], course: Course) {
        let path = path.iter().map(|p| p.map(millimetres)).collect();
        self.world.people.push(Person {
            path,
            speed: millimetres(self.random.uniform(0.7, 1.6)),
            start: match course {
                Course::Loop => millimetres(-self.random.uniform(0.0, 20.0)),
                Course::Once => millimetres(self.random.uniform(0.0, 50.0)),
            },
            course,
            albedo: millimetres(self.random.uniform(0.12, 0.6)),
        });
    }

    fn glass(&mut self) -> &'static str {
        if self.random.chance(0.4) { "double glass" } else { "glass" }
    }

    fn frame(&mut self, probability: f64) -> Option<Frame> {
        let every = millimetres(self.random.uniform(1.2, 3.0));
        self.random.chance(probability).then_some(Frame { every, width: 0.05 })
    }

    /// Walkway of a random width around a rectangle of glass with cut corners.
    fn hall(&mut self) {
        let (w, h) = (self.random.uniform(15.0, 24.0), self.random.uniform(13.0, 22.0));
        let walk = self.random.uniform(3.0, 4.5);
        self.line("wall", &[[0.0, 0.0], [w, 0.0], [w, h]], None);
        let door = self.random.uniform(3.0, w - 6.0);
        self.line("wall", &[[w, h], [door + 2.0, h]], None);
        self.line("steel", &[[door + 2.0, h + 0.08], [door, h + 0.08]], None);
        self.line("wall", &[[door, h], [0.0, h], [0.0, 0.0]], None);
        let (x0, y0, x1, y1) = (walk, walk, w - walk, h - walk);
        let cut = self.random.uniform(0.6, 1.8);
        let corners = [
            [x0 + cut, y0],
            [x1 - cut, y0],
            [x1, y0 + cut],
            [x1, y1 - cut],
            [x1 - cut, y1],
            [x0 + cut, y1],
            [x0, y1 - cut],
            [x0, y0 + cut],
        ];
        let is_round = self.random.chance(0.5);
        for i in 0..8 {
            let (a, b) = (corners[i], corners[(i + 1) % 8]);
            if is_round && i % 2 == 1 {
                // Centre of the corner's arc; the corners go south-east, north-east, north-west, south-west.
                let center = match i {
                    1 => [x1 - cut, y0 + cut],
                    3 => [x1 - cut, y1 - cut],
                    5 => [x0 + cut, y1 - cut],
                    _ => [x0 + cut, y0 + cut],
                };
                self.round_corner(center, cut, -90.0 + 90.0 * ((i - 1) / 2) as f64);
                continue;
            }
            let material = if self.random.chance(0.12) { "wall" } else { self.glass() };
            let frame = if material == "wall" { None } else { self.frame(0.25) };
            self.line(material, &[a, b], frame);
        }
        for _ in 0..4 + self.random.below(6) {
            let x = self.random.uniform(x0 + 0.6, x1 - 0.6);
            let y = if self.random.chance(0.5) { y0 + 0.6 + cut * 0.5 } else { y1 - 0.6 - cut * 0.5 };
            let x = x.clamp(x0 + cut + 0.4, x1 - cut - 0.4);
            let radius = self.random.uniform(0.12, 0.35);
            self.pillar("concrete", [x, y], radius);
        }
        let lane = walk * self.random.uniform(0.45, 0.62);
        self.world.robot.path =
            [[w / 2.0, lane], [w - lane, lane], [w - lane, h - lane], [lane, h - lane], [lane, lane]]
                .map(|p| p.map(millimetres))
                .into();
        self.world.robot.closed = true;
        for _ in 0..2 + self.random.below(3) {
            let lane = if self.random.chance(0.6) { 0.7 } else { walk - 0.5 };
            let mut ring = vec![[lane, lane], [lane, h - lane], [w - lane, h - lane], [w - lane, lane]];
            if self.random.chance(0.5) {
                ring.reverse();
            }
            self.person(&ring, Course::Loop);
        }
        self.things_along(w, walk);
        if self.random.chance(0.5) {
            let y = self.random.uniform(0.3, 0.6) * h;
            let material = if self.random.chance(0.5) { "glass" } else { "wood" };
            self.sliding_door(material, [w - 0.15, y], [w - 0.15, y + 1.1]);
        }
    }

    /// Bins and cabinets along the south wall; some go away.
    fn things_along(&mut self, length: f64, width: f64) {
        for k in 0..self.random.below(4) {
            let x = self.random.uniform(0.1, 0.2) * length + k as f64 * length * 0.2;
            let size = [self.random.uniform(0.4, 1.2), self.random.uniform(0.25, 0.4)];
            let until = millimetres(self.random.uniform(15.0, 50.0));
            let present = if self.random.chance(0.4) { vec![[-1.0, until]] } else { Vec::new() };
            if size[1] < width / 4.0 {
                self.a_box("wood", [x, size[1] / 2.0 + 0.02], size, 0.0, present);
            }
        }
    }

    /// A wall from `a` along `u`, with features; what lies behind panes is on the side of `out`.
    fn wall_with_features(&mut self, a: [f64; 2], u: [f64; 2], out: [f64; 2], length: f64) {
        let place = |s: f64, o: f64| [a[0] + u[0] * s + out[0] * o, a[1] + u[1] * s + out[1] * o];
        let mut at = 0.0;
        loop {
            let gap = self.random.uniform(1.0, 4.5);
            let size = self.random.uniform(1.0, 6.0);
            if at + gap + size + 0.8 > length {
                self.line("wall", &[place(at, 0.0), place(length, 0.0)], None);
                return;
            }
            let (from, to) = (at + gap, at + gap + size);
            self.line("wall", &[place(at, 0.0), place(from, 0.0)], None);
            let feature = match self.random.below(10) {
                0..=4 => Feature::Pane { framed: self.random.chance(0.4) },
                5 => Feature::Mirror,
                6 => Feature::Steel,
                _ => Feature::Niche,
            };
            match feature {
                Feature::Pane { framed } => {
                    let frame = if framed { self.frame(1.0) } else { None };
                    let glass = self.glass();
                    self.line(glass, &[place(from, 0.0), place(to, 0.0)], frame);
                    let depth = self.random.uniform(1.0, 4.0);
                    self.line(
                        "wall",
                        &[place(from, 0.06), place(from, depth), place(to, depth), place(to, 0.06)],
                        None,
                    );
                    let desk = self.random.uniform(0.3, 0.7);
                    let center = place(from + size * desk, depth * 0.6);
                    self.a_box("wood", center, [size * 0.2, 0.3], 0.0, Vec::new());
                }
                Feature::Mirror => self.line("mirror", &[place(from, 0.0), place(to, 0.0)], None),
                Feature::Steel => {
                    self.line("steel", &[place(from, 0.0), place(to.min(from + 2.0), 0.0)], None);
                    self.line("wall", &[place(to.min(from + 2.0), 0.0), place(to, 0.0)], None);
                }
                Feature::Niche => {
                    let deep = self.random.uniform(0.1, 0.5);
                    self.line(
                        "wall",
                        &[place(from, 0.0), place(from, deep), place(to, deep), place(to, 0.0)],
                        None,
                    );
                }
            }
            at = to;
        }
    }

    fn corridor(&mut self) {
        let (length, width) = (self.random.uniform(18.0, 32.0), self.random.uniform(2.0, 3.2));
        self.line("wall", &[[0.0, 0.0], [0.0, width]], None);
        self.line("wall", &[[length, 0.0], [length, width]], None);
        self.wall_with_features([0.0, 0.0], [1.0, 0.0], [0.0, -1.0], length);
        self.wall_with_features([0.0, width], [1.0, 0.0], [0.0, 1.0], length);
        let lane = width * self.random.uniform(0.4, 0.6);
        let back = lane + 0.1;
        self.world.robot.path =
            [[1.2, lane], [length - 1.2, lane], [1.2, back]].map(|p| p.map(millimetres)).into();
        self.world.robot.speed = millimetres(self.random.uniform(0.7, 1.1));
        for _ in 0..1 + self.random.below(3) {
            let side = if self.random.chance(0.5) { 0.5 } else { width - 0.5 };
            let course = if self.random.chance(0.5) { Course::Loop } else { Course::Once };
            self.person(&[[0.8, side], [length - 0.8, side]], course);
        }
    }

    fn office(&mut self) {
        let (w, h) = (self.random.uniform(24.0, 44.0), self.random.uniform(16.0, 30.0));
        let width = self.random.uniform(1.9, 2.8);
        self.wall_with_features([0.0, 0.0], [1.0, 0.0], [0.0, -1.0], w);
        self.wall_with_features([w, 0.0], [0.0, 1.0], [1.0, 0.0], h);
        self.wall_with_features([w, h], [-1.0, 0.0], [0.0, 1.0], w);
        self.wall_with_features([0.0, h], [0.0, -1.0], [-1.0, 0.0], h);
        let (iw, ih) = (w - 2.0 * width, h - 2.0 * width);
        self.wall_with_features([width, width], [1.0, 0.0], [0.0, 1.0], iw);
        self.wall_with_features([w - width, width], [0.0, 1.0], [-1.0, 0.0], ih);
        self.wall_with_features([w - width, h - width], [-1.0, 0.0], [0.0, -1.0], iw);
        self.wall_with_features([width, h - width], [0.0, -1.0], [1.0, 0.0], ih);
        let lane = width / 2.0;
        self.world.robot.path =
            [[w / 2.0, lane], [w - lane, lane], [w - lane, h - lane], [lane, h - lane], [lane, lane]]
                .map(|p| p.map(millimetres))
                .into();
        self.world.robot.closed = true;
        self.world.robot.corner_radius = 0.6;
        for _ in 0..1 + self.random.below(4) {
            let lane = if self.random.chance(0.5) { 0.45 } else { width - 0.45 };
            let ring = [[lane, lane], [lane, h - lane], [w - lane, h - lane], [w - lane, lane]];
            self.person(&ring, Course::Loop);
        }
    }

    fn floor(&mut self) {
        const SIZE: [f64; 2] = [120.0, 60.0];
        const BLOCKS: [usize; 2] = [4, 2];
        let width = self.random.uniform(2.2, 2.8);
        let [w, h] = SIZE;
        self.wall_with_features([0.0, 0.0], [1.0, 0.0], [0.0, -1.0], w);
        self.wall_with_features([w, 0.0], [0.0, 1.0], [1.0, 0.0], h);
        self.wall_with_features([w, h], [-1.0, 0.0], [0.0, 1.0], w);
        self.wall_with_features([0.0, h], [0.0, -1.0], [-1.0, 0.0], h);
        let side = |axis: usize| (SIZE[axis] - width) / BLOCKS[axis] as f64 - width;
        let (bw, bh) = (side(0), side(1));
        let corridor = |axis: usize, number: usize| (side(axis) + width) * number as f64;
        for (i, j) in (0..BLOCKS[0]).flat_map(|i| (0..BLOCKS[1]).map(move |j| (i, j))) {
            let (x0, y0) = (corridor(0, i) + width, corridor(1, j) + width);
            let (x1, y1) = (x0 + bw, y0 + bh);
            self.wall_with_features([x0, y0], [1.0, 0.0], [0.0, 1.0], bw);
            self.wall_with_features([x1, y0], [0.0, 1.0], [-1.0, 0.0], bh);
            self.wall_with_features([x1, y1], [-1.0, 0.0], [0.0, -1.0], bw);
            self.wall_with_features([x0, y1], [0.0, -1.0], [1.0, 0.0], bh);
        }
        // Where steel takes the whole of its place, no wall is left beside it. The other kinds are tried again instead: to be
        // spared of it so many times over would take luck.
        let is_point = |line: &Vec<[f64; 2]>| line.windows(2).any(|ends| ends[0] == ends[1]);
        self.world.surfaces.retain(|surface| !surface.line.as_ref().is_some_and(is_point));
        // Crossings of corridors, by number: most corridors once, the western one whole.
        let crossings =
            [[2, 0], [4, 0], [4, 1], [3, 1], [3, 2], [2, 2], [2, 1], [1, 1], [1, 2], [0, 2], [0, 0]];
        let place = |[i, j]: [usize; 2]| {
            [corridor(0, i) + width / 2.0, corridor(1, j) + width / 2.0].map(millimetres)
        };
        self.world.robot.path = crossings.map(place).into();
        self.world.robot.closed = true;
        self.world.robot.corner_radius = 0.6;
        for _ in 0..6 + self.random.below(6) {
            let aside = if self.random.chance(0.5) { 0.45 } else { width - 0.45 };
            let (i, j) = (self.random.below(BLOCKS[0]), self.random.below(BLOCKS[1]));
            let ring = [[i, j], [i, j + 1], [i + 1, j + 1], [i + 1, j]];
            let path = ring.map(|[i, j]| [corridor(0, i) + aside, corridor(1, j) + aside]);
            self.person(&path, Course::Loop);
        }
    }

    fn lobby(&mut self) {
        let (w, h) = (self.random.uniform(14.0, 24.0), self.random.uniform(10.0, 16.0));
        let front = self.glass();
        let frame = self.frame(0.5);
        self.line(front, &[[0.0, 0.0], [w, 0.0]], frame);
        self.line("wall", &[[w, 0.0], [w, h]], None);
        let lift = self.random.uniform(2.0, w - 5.0);
        self.line("wall", &[[w, h], [lift + 2.4, h]], None);
        self.line("steel", &[[lift + 2.4, h], [lift, h]], None);
        self.line("wall", &[[lift, h], [0.0, h], [0.0, 0.0]], None);
        // Things stand on a grid in the middle, clear of the lane around it.
        let (columns, rows) = ((w / 4.5) as usize - 1, (h / 4.5) as usize);
        for i in 0..columns {
            for j in 0..rows.saturating_sub(1).max(1) {
                let x = 4.0 + (w - 8.0) * (i as f64 + 0.5) / columns as f64;
                let y = 4.0 + (h - 8.0) * (j as f64 + 0.5) / rows.saturating_sub(1).max(1) as f64;
                let turn = self.random.uniform(0.0, 90.0);
                match self.random.below(5) {
                    0 => self.pillar("concrete", [x, y], 0.3),
                    1 => self.a_box("mirror", [x, y], [0.7, 0.7], 0.0, Vec::new()),
                    2 => {
                        let glass = self.glass();
                        self.a_box(glass, [x, y], [1.4, 1.0], turn, Vec::new());
                        self.pillar("wood", [x, y], 0.15);
                    }
                    3 => {
                        let glass = self.glass();
                        let half = self.random.uniform(0.7, 1.2);
                        self.line(glass, &[[x - half, y], [x + half, y + 0.3]], None);
                    }
                    _ => {
                        let until = millimetres(self.random.uniform(10.0, 40.0));
                        let present = if self.random.chance(0.5) { vec![[-1.0, until]] } else { Vec::new() };
                        self.a_box("dark", [x, y], [0.9, 0.6], turn, present);
                    }
                }
            }
        }
        let door = self.random.uniform(0.3, 0.6) * w;
        let material = if self.random.chance(0.6) { "glass" } else { "wood" };
        self.sliding_door(material, [door, 0.3], [door + 1.2, 0.3]);
        let lane = self.random.uniform(1.5, 2.1);
        self.world.robot.path =
            [[w / 2.0, lane], [w - lane, lane], [w - lane, h - lane], [lane, h - lane], [lane, lane]]
                .map(|p| p.map(millimetres))
                .into();
        self.world.robot.closed = true;
        self.world.robot.speed = millimetres(self.random.uniform(0.7, 1.0));
        for _ in 0..5 + self.random.below(8) {
            let mut point = || [self.random.uniform(0.6, w - 0.6), self.random.uniform(0.6, h - 0.6)];
            let path = [point(), point(), point()];
            self.person(&path, Course::Loop);
        }
    }
}

/// Rounded, so that generated files are short.
fn millimetres(value: f64) -> f64 {
    (value * 1000.0).round() / 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_gives_worlds_that_pass_their_own_check() {
        for (kind, _) in KINDS {
            let texts: Vec<String> = (0..12)
                .map(|seed| World::generate(kind, seed).unwrap_or_else(|e| panic!("{e}")).to_toml())
                .collect();
            assert_eq!(World::generate(kind, 3).unwrap().to_toml(), texts[3]);
            assert_ne!(texts[3], texts[4]);
            World::from_toml("again", &texts[5]).unwrap();
        }
        assert!(World::generate("castle", 1).unwrap_err().to_string().contains("known are hall"));
    }
}
