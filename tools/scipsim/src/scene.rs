//! A world made ready for tracing: shapes with materials and times, people, and the robot, over time.
//! It knows what is where and when; what light does there is [`crate::light`]'s matter.

use crate::drive::{Drive, Gait, Pose, Stop, pose};
use crate::geometry::{Crossing, Index, Shape, Vector, heading};
use crate::noise::{Random, SmoothNoise};
use crate::world::{Course, Frame, Kind, Material, Person, Surface, World};

/// What overrides a world.
#[derive(Clone, Debug, Default)]
pub struct Overrides {
    /// Lean of all specular surfaces (degrees).
    pub lean_deg: Option<f64>,
    /// Factor on all dust.
    pub dust: Option<f64>,
    /// `true` puts posts on every pane, `false` takes all away.
    pub frames: Option<bool>,
    /// Factor on the robot's speed.
    pub speed: Option<f64>,
    /// Stands this long before it sets out (s).
    pub start_delay: f64,
    /// Seed of what is not said in the world: phase and stature of people.
    pub seed: u64,
}

/// Posts where an option asks for them and the world has none.
const USUAL_FRAME: Frame = Frame { every: 2.0, width: 0.05 };
/// The highest acceleration of the robot (m/s2).
const ACCELERATION: f64 = 0.8;
/// Side of the index's buckets (m).
const BUCKET: f64 = 0.5;
/// People keep this far from the scanner (m): they walk around the robot.
const BERTH: f64 = 0.55;
/// Length of a double step (m), from which the swing of the legs follows.
const STRIDE: f64 = 1.4;

/// A surface at one place for some time.
#[derive(Clone, Debug)]
pub struct Placement {
    /// Number of the surface in the scene; posts come after the surfaces of the world.
    pub surface: u16,
    /// Since when (s).
    pub from: f64,
    /// Until when (s).
    pub to: f64,
    /// Its speed while it slides (m/s).
    pub velocity: Option<Vector>,
}

impl Placement {
    /// Whether the surface stands here at `time` (s).
    pub fn holds(&self, time: f64) -> bool {
        self.from <= time && time < self.to
    }
}

/// A shape of a placement.
#[derive(Clone, Debug)]
struct Piece {
    shape: Shape,
    placement: u16,
    /// Length along the surface at which this piece starts (m), so that dust goes on around corners.
    start: f64,
}

/// What a ray met.
#[derive(Clone, Copy, Debug)]
pub struct Met {
    /// Where.
    pub crossing: Crossing,
    /// What.
    pub what: Thing,
}

/// What can be met.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Thing {
    /// A placement, by number.
    Placement(u16),
    /// A leg of the person of this number.
    Person(u16),
    /// The robot's own body.
    Body,
}

/// A surface's material and dust.
#[derive(Clone, Debug)]
pub struct Skin {
    /// Law and constants.
    pub material: Material,
    /// How dust varies along the surface.
    pub dust: SmoothNoise,
}

#[derive(Clone, Debug)]
struct Walker {
    drive: Drive,
    start: f64,
    course: Course,
    phase: f64,
    leg_radius: f64,
    swing: f64,
    stride_rate: f64,
    albedo: f64,
}

/// A leg at a moment, and how it moves.
#[derive(Clone, Copy, Debug)]
pub struct Leg {
    center: Vector,
    velocity: Vector,
    radius: f64,
    person: u16,
}

/// What moves, at one moment: valid for the time of a scan.
#[derive(Clone, Debug)]
pub struct Moment {
    time: f64,
    legs: Vec<Leg>,
}

/// A world over time.
#[derive(Clone, Debug)]
pub struct Scene {
    pieces: Vec<Piece>,
    index: Index,
    /// Sliding pieces, not in the index; as they stand when their slide begins.
    sliding: Vec<Piece>,
    placements: Vec<Placement>,
    skins: Vec<Skin>,
    walkers: Vec<Walker>,
    drive: Drive,
    mount: Pose,
    body: Vec<Shape>,
    body_albedo: f64,
    body_clearance: f64,
}

impl Scene {
    /// Makes a world ready. The world must have passed [`World::check`]'s first part: shapes and materials exist.
    pub fn new(world: &World, overrides: &Overrides) -> Scene {
        let mut builder = Builder::default();
        for surface in &world.surfaces {
            let mut material = world.material(&surface.material).expect("materials were checked");
            if material.kind.is_specular() {
                material.lean_deg = overrides.lean_deg.unwrap_or(material.lean_deg);
                material.dust *= overrides.dust.unwrap_or(1.0);
            }
            let shapes = shapes_of(surface);
            let posts = posts_of(surface, material.kind, &shapes, overrides.frames);
            builder.add(surface, material, shapes);
            if !posts.is_empty() {
                builder.add(surface, world.material("post").expect("built in"), posts);
            }
        }
        let shapes: Vec<Shape> = builder.pieces.iter().map(|p| p.shape.clone()).collect();
        let robot = &world.robot;
        let factor = overrides.speed.unwrap_or(1.0);
        let gait = Gait {
            speed: robot.speed * factor,
            turn_rate: robot.turn_rate_deg.to_radians() * factor,
            acceleration: ACCELERATION,
            corner_radius: robot.corner_radius,
        };
        let stops: Vec<Stop> =
            robot.stops.iter().map(|&(waypoint, seconds)| Stop { waypoint, seconds }).collect();
        let drive = Drive::new(
            &vectors(&robot.path),
            robot.closed,
            robot.laps,
            robot.heading_deg.to_radians(),
            &stops,
            gait,
        );
        let [length, width] = robot.body.size;
        let body = if robot.body.round {
            vec![full_circle(Vector::zeros(), length / 2.0)]
        } else {
            box_shapes(Vector::zeros(), robot.body.size, 0.0)
        };
        Scene {
            index: Index::new(&shapes, BUCKET),
            pieces: builder.pieces,
            sliding: builder.sliding,
            placements: builder.placements,
            skins: builder.skins,
            walkers: world.people.iter().enumerate().map(|(i, p)| walker(i, p, overrides.seed)).collect(),
            drive: drive.delayed(overrides.start_delay),
            mount: pose(robot.mount.x, robot.mount.y, robot.mount.yaw_deg.to_radians()),
            body,
            body_albedo: robot.body.albedo,
            body_clearance: if robot.body.round { length / 2.0 } else { length.min(width) / 2.0 },
        }
    }

    /// The robot's drive.
    pub fn drive(&self) -> &Drive {
        &self.drive
    }

    /// The laser in the robot's frame.
    pub fn mount(&self) -> Pose {
        self.mount
    }

    /// Radius around the robot's origin that its body always covers (m).
    pub fn body_radius(&self) -> f64 {
        self.body_clearance
    }

    /// Placements by number.
    pub fn placements(&self) -> &[Placement] {
        &self.placements
    }

    /// Material and dust of a surface.
    pub fn skin(&self, surface: u16) -> &Skin {
        &self.skins[usize::from(surface)]
    }

    /// Albedo of a person's trousers.
    pub fn trousers(&self, person: u16) -> f64 {
        self.walkers[usize::from(person)].albedo
    }

    /// Albedo of the robot.
    pub fn body_albedo(&self) -> f64 {
        self.body_albedo
    }

    /// Length along its surface at which a placement's crossing lies (m).
    fn along(&self, piece: &Piece, crossing: Crossing) -> Crossing {
        Crossing { along: piece.start + crossing.along, ..crossing }
    }

    /// Shapes that stand still at `time` (s), with their surface.
    pub fn standing(&self, time: f64) -> impl Iterator<Item = (u16, &Shape)> {
        self.pieces.iter().filter_map(move |piece| {
            let placement = &self.placements[usize::from(piece.placement)];
            placement.holds(time).then_some((placement.surface, &piece.shape))
        })
    }

    /// Lower left and upper right corner of all that stands at some time, and of the drive (m).
    pub fn bounds(&self) -> (Vector, Vector) {
        let start = self.drive.pose(0.0).translation.vector;
        let points = (0..=self.drive.duration() as usize).map(|t| {
            let p = self.drive.pose(t as f64).translation.vector;
            (p, p)
        });
        self.pieces
            .iter()
            .map(|p| p.shape.bounds())
            .chain(points)
            .fold((start, start), |(low, high), (l, h)| (low.inf(&l), high.sup(&h)))
    }

    /// What moves at `time` (s).
    pub fn moment(&self, time: f64) -> Moment {
        let scanner = (self.drive.pose(time) * self.mount).translation.vector;
        let dt = 0.01;
        let mut legs = Vec::with_capacity(2 * self.walkers.len());
        for (i, walker) in self.walkers.iter().enumerate() {
            let (Some(now), Some(soon)) = (walker.legs(time, scanner), walker.legs(time + dt, scanner))
            else {
                continue;
            };
            for k in 0..2 {
                let velocity = (soon[k] - now[k]) / dt;
                legs.push(Leg { center: now[k], velocity, radius: walker.leg_radius, person: i as u16 });
            }
        }
        Moment { time, legs }
    }

    /// First thing on the ray within `limit` metres. `body` is the robot's pose where its own body can be met.
    pub fn first(
        &self,
        origin: Vector,
        direction: Vector,
        limit: f64,
        moment: &Moment,
        time: f64,
        body: Option<Pose>,
    ) -> Option<Met> {
        let mut best: Option<Met> = None;
        let mut nearest = limit;
        let mut piece_met = None;
        self.index.walk(origin, direction, limit, |k| {
            let piece = &self.pieces[k as usize];
            if let Some(crossing) = piece.shape.cross(origin, direction, nearest)
                && self.placements[usize::from(piece.placement)].holds(time)
            {
                nearest = crossing.distance;
                piece_met = Some((piece, crossing));
            }
            nearest
        });
        if let Some((piece, crossing)) = piece_met {
            best =
                Some(Met { crossing: self.along(piece, crossing), what: Thing::Placement(piece.placement) });
        }
        for piece in &self.sliding {
            let placement = &self.placements[usize::from(piece.placement)];
            if !placement.holds(time) {
                continue;
            }
            let by = placement.velocity.unwrap_or_default() * (time - placement.from);
            if let Some(crossing) = piece.shape.cross(origin - by, direction, nearest) {
                nearest = crossing.distance;
                let what = Thing::Placement(piece.placement);
                best = Some(Met { crossing: self.along(piece, crossing), what });
            }
        }
        for leg in &moment.legs {
            let center = leg.center + leg.velocity * (time - moment.time);
            let shape_hit = cross_disc(center, leg.radius, origin, direction, nearest);
            if let Some(crossing) = shape_hit {
                nearest = crossing.distance;
                best = Some(Met { crossing, what: Thing::Person(leg.person) });
            }
        }
        if let Some(body) = body {
            let local = body.inverse_transform_point(&origin.into()).coords;
            let turned = body.rotation.inverse() * direction;
            for shape in &self.body {
                if let Some(crossing) = shape.cross(local, turned, nearest) {
                    nearest = crossing.distance;
                    let normal = body.rotation * crossing.normal;
                    best = Some(Met { crossing: Crossing { normal, ..crossing }, what: Thing::Body });
                }
            }
        }
        best
    }

    /// Where the robot first comes nearer to something than its own half width, if it does.
    pub fn first_collision(&self) -> Option<String> {
        let steps = (self.drive.duration() / 0.1).ceil() as usize;
        let mut last: Option<Vector> = None;
        for i in 0..=steps {
            let time = i as f64 * 0.1;
            let at = self.drive.pose(time).translation.vector;
            let is_new = last.is_none_or(|l| (l - at).norm() > 1e-9) || i % 10 == 0;
            last = Some(at);
            if !is_new {
                continue;
            }
            let hit = self.pieces.iter().find(|piece| {
                self.placements[usize::from(piece.placement)].holds(time)
                    && piece.shape.distance(at) < self.body_clearance
            });
            if let Some(piece) = hit {
                let surface = self.placements[usize::from(piece.placement)].surface;
                return Some(format!(
                    "at {time:.1} s the robot at ({:.2}, {:.2}) runs into surface {surface} ({:?})",
                    at.x, at.y, piece.shape
                ));
            }
        }
        None
    }
}

/// Leg of a person: only its outside can be met.
fn cross_disc(
    center: Vector,
    radius: f64,
    origin: Vector,
    direction: Vector,
    limit: f64,
) -> Option<Crossing> {
    let oc = origin - center;
    let middle = -oc.dot(&direction);
    let reach = radius * radius - (oc.norm_squared() - middle * middle);
    if reach <= 0.0 {
        return None;
    }
    let distance = middle - reach.sqrt();
    if distance <= 1e-6 || distance >= limit {
        return None;
    }
    let normal = (oc + direction * distance) / radius;
    Some(Crossing { distance, normal, along: 0.0, radius })
}

impl Walker {
    /// Both legs at `time` (s), clear of the scanner; `None` where the person is not there.
    fn legs(&self, time: f64, scanner: Vector) -> Option<[Vector; 2]> {
        let mut walked = time - self.start;
        let duration = self.drive.duration();
        match self.course {
            Course::Once if !(0.0..=duration).contains(&walked) => return None,
            Course::Loop if self.start >= 0.0 && walked < 0.0 => return None,
            Course::Loop => walked = walked.rem_euclid(duration),
            Course::Once => {}
        }
        let body = self.drive.pose(walked);
        let mut at = body.translation.vector;
        let away = at - scanner;
        let distance = away.norm();
        if distance < BERTH {
            at = scanner + away * (BERTH / distance.max(1e-6));
        }
        let forward = heading(body.rotation.angle());
        let left = Vector::new(-forward.y, forward.x);
        let swing = self.swing * (self.phase + walked * self.stride_rate).sin();
        Some([at + forward * swing + left * 0.09, at - forward * swing - left * 0.09])
    }
}

fn walker(number: usize, person: &Person, seed: u64) -> Walker {
    let mut random = Random::new(&[seed, 0x1e65, number as u64]);
    let gait = Gait { speed: person.speed, turn_rate: 2.5, acceleration: 5.0, corner_radius: 0.6 };
    Walker {
        drive: Drive::new(&vectors(&person.path), person.course == Course::Loop, 1, 0.0, &[], gait),
        start: person.start,
        course: person.course,
        phase: random.uniform(0.0, std::f64::consts::TAU),
        leg_radius: random.uniform(0.055, 0.08),
        // Half a step between the feet at full stride; a slow walker takes shorter ones.
        swing: 0.28 * (person.speed / 1.3).min(1.2),
        stride_rate: std::f64::consts::TAU * person.speed / (STRIDE * (person.speed / 1.3).clamp(0.5, 1.2)),
        albedo: person.albedo,
    }
}

fn vectors(points: &[[f64; 2]]) -> Vec<Vector> {
    points.iter().map(|p| Vector::new(p[0], p[1])).collect()
}

fn full_circle(center: Vector, radius: f64) -> Shape {
    Shape::Arc { center, radius, from: 0.0, span: std::f64::consts::TAU }
}

fn box_shapes(center: Vector, size: [f64; 2], turn: f64) -> Vec<Shape> {
    let (along, across) =
        (heading(turn) * (size[0] / 2.0), heading(turn + std::f64::consts::FRAC_PI_2) * (size[1] / 2.0));
    let corners =
        [center - along - across, center + along - across, center + along + across, center - along + across];
    (0..4).map(|i| Shape::Segment { a: corners[i], b: corners[(i + 1) % 4] }).collect()
}

fn shapes_of(surface: &Surface) -> Vec<Shape> {
    if let Some(line) = &surface.line {
        let mut points = vectors(line);
        if surface.closed {
            points.push(points[0]);
        }
        return points.windows(2).map(|w| Shape::Segment { a: w[0], b: w[1] }).collect();
    }
    if let Some(r) = surface.rectangle {
        return box_shapes(r.center.into(), r.size, r.turn_deg.to_radians());
    }
    if let Some(circle) = surface.circle {
        return vec![full_circle(circle.center.into(), circle.radius)];
    }
    let arc = surface.arc.expect("one shape was checked to be given");
    vec![Shape::Arc {
        center: arc.center.into(),
        radius: arc.radius,
        from: arc.from_deg.to_radians(),
        span: (arc.to_deg - arc.from_deg).to_radians(),
    }]
}

/// Posts: square boxes on the pane, at both ends of each piece and between.
fn posts_of(surface: &Surface, kind: Kind, shapes: &[Shape], wanted: Option<bool>) -> Vec<Shape> {
    let frame = match wanted {
        Some(false) => None,
        Some(true) if kind == Kind::Glass => surface.frame.or(Some(USUAL_FRAME)),
        _ => surface.frame,
    };
    let Some(frame) = frame else { return Vec::new() };
    let mut posts = Vec::new();
    for shape in shapes {
        let length = shape.length();
        let gaps = (length / frame.every).ceil().max(1.0);
        for k in 0..=gaps as usize {
            let at = shape.point(length * k as f64 / gaps);
            posts.extend(box_shapes(at, [frame.width; 2], 0.0));
        }
    }
    posts
}

#[derive(Default)]
struct Builder {
    pieces: Vec<Piece>,
    sliding: Vec<Piece>,
    placements: Vec<Placement>,
    skins: Vec<Skin>,
}

impl Builder {
    /// Adds a surface with all its placements over time.
    fn add(&mut self, surface: &Surface, material: Material, shapes: Vec<Shape>) {
        let number = self.skins.len() as u16;
        // Dust varies over some 30 cm; each pane has its own.
        let dust = SmoothNoise::new(&[0xd057, u64::from(number)], 0.3);
        self.skins.push(Skin { material, dust });
        let always = vec![[f64::NEG_INFINITY, f64::INFINITY]];
        let present = if surface.present.is_empty() { &always } else { &surface.present };
        for &[from, to] in present {
            let (mut offset, mut since) = (Vector::zeros(), from);
            for slide in &surface.moves {
                self.place(number, since, slide.at.min(to), offset, None, &shapes);
                let by = Vector::new(slide.by[0], slide.by[1]);
                let (begin, end) = (slide.at.max(since), (slide.at + slide.seconds).min(to));
                self.place(number, begin, end, offset, Some(by / slide.seconds), &shapes);
                offset += by;
                since = end.max(from);
            }
            self.place(number, since, to, offset, None, &shapes);
        }
    }

    fn place(
        &mut self,
        surface: u16,
        from: f64,
        to: f64,
        offset: Vector,
        velocity: Option<Vector>,
        shapes: &[Shape],
    ) {
        if from >= to {
            return;
        }
        let placement = self.placements.len() as u16;
        self.placements.push(Placement { surface, from, to, velocity });
        let list = if velocity.is_some() { &mut self.sliding } else { &mut self.pieces };
        let mut start = 0.0;
        for shape in shapes {
            list.push(Piece { shape: shape.moved(offset), placement, start });
            start += shape.length();
        }
    }
}
