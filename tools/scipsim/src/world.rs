//! A world as it is written down: TOML with lengths in metres, angles in degrees (fields ending in `_deg`) and times
//! in seconds from the start of the drive. Not the form in which beams are traced: that is [`crate::scene::Scene`].

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::scene::Scene;

/// Coordinates may go so far (m); the truth is kept cell by cell for the whole extent of a world.
const FARTHEST: f64 = 250.0;

/// A scene, the people in it, and what the robot does there.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct World {
    /// Short name.
    pub name: String,
    /// One line on what it is good for.
    pub description: String,
    /// Materials by name, beside (or in place of) the built-in ones of [`built_in_materials`].
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub materials: BTreeMap<String, Material>,
    /// Everything that does not walk.
    #[serde(default, rename = "surface")]
    pub surfaces: Vec<Surface>,
    /// Everyone who walks.
    #[serde(default, rename = "person", skip_serializing_if = "Vec::is_empty")]
    pub people: Vec<Person>,
    /// The robot.
    pub robot: Robot,
}

/// How a surface treats light.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Material {
    /// Which law it follows.
    pub kind: Kind,
    /// Share of light scattered evenly (0..1); for metal and mirrors what lies under the gloss.
    #[serde(default = "default_albedo")]
    pub albedo: f64,
    /// Dust on glass, mirrors and metal, relative to the pane of the calibration (0.1 clean .. 3 dirty).
    #[serde(default = "one")]
    pub dust: f64,
    /// Factor on the brightness of the specular return.
    #[serde(default = "one")]
    pub gain: f64,
    /// Panes of a glass: 2 for double glazing, which reflects twice as much.
    #[serde(default = "one_pane")]
    pub panes: u32,
    /// How far a specular surface leans out of the vertical (degrees): its glint then misses the scanner.
    #[serde(default)]
    pub lean_deg: f64,
}

/// The laws of reflection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Scatters evenly (Lambert).
    Diffuse,
    /// Transmits most, reflects some 8 %.
    Glass,
    /// Reflects, transmits nothing.
    Mirror,
    /// Polished or brushed metal: a broad lobe.
    Metal,
}

impl Kind {
    /// Whether it is anything but diffuse ("glass" in the scores).
    pub fn is_specular(self) -> bool {
        self != Kind::Diffuse
    }
}

fn default_albedo() -> f64 {
    0.1
}

fn one_pane() -> u32 {
    1
}

fn one() -> f64 {
    1.0
}

fn is_one(value: &f64) -> bool {
    *value == 1.0
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

fn is_false(value: &bool) -> bool {
    !*value
}

/// Materials every world knows.
pub fn built_in_materials() -> BTreeMap<String, Material> {
    let plain = |kind, albedo| Material { kind, albedo, dust: 1.0, gain: 1.0, panes: 1, lean_deg: 0.0 };
    [
        ("wall", plain(Kind::Diffuse, 0.7)),
        ("wood", plain(Kind::Diffuse, 0.45)),
        ("dark", plain(Kind::Diffuse, 0.15)),
        ("concrete", plain(Kind::Diffuse, 0.5)),
        ("post", plain(Kind::Diffuse, 0.4)),
        ("glass", plain(Kind::Glass, 0.0)),
        ("double glass", Material { panes: 2, ..plain(Kind::Glass, 0.0) }),
        ("mirror", plain(Kind::Mirror, 0.0)),
        ("steel", plain(Kind::Metal, 0.12)),
    ]
    .map(|(name, material)| (name.to_string(), material))
    .into()
}

/// One thing: a shape (exactly one of `line`, `rectangle`, `circle`, `arc`), its material, and when it is there.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Surface {
    /// For messages.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Name of a material.
    pub material: String,
    /// Corners of a polyline (m).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub line: Option<Vec<[f64; 2]>>,
    /// Joins the last corner of `line` to the first.
    #[serde(default, skip_serializing_if = "is_false")]
    pub closed: bool,
    /// A box.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rectangle: Option<Rectangle>,
    /// A pillar.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub circle: Option<Circle>,
    /// A curved wall.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub arc: Option<Arc>,
    /// When it is there: [from, to] (s); always if empty. A later end than the drive's means that it stays.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub present: Vec<[f64; 2]>,
    /// Slides, one after the other.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub moves: Vec<Move>,
    /// Posts along a pane, ends included.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<Frame>,
}

/// A box.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Rectangle {
    /// Middle (m).
    pub center: [f64; 2],
    /// Length and width (m).
    pub size: [f64; 2],
    /// Turned counter-clockwise by (degrees).
    #[serde(default, skip_serializing_if = "is_zero")]
    pub turn_deg: f64,
}

/// A pillar.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Circle {
    /// Middle (m).
    pub center: [f64; 2],
    /// Radius (m).
    pub radius: f64,
}

/// A curved wall, counter-clockwise from one bearing to the other.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Arc {
    /// Middle of the circle (m).
    pub center: [f64; 2],
    /// Radius (m).
    pub radius: f64,
    /// Bearing of the start, seen from the middle (degrees).
    pub from_deg: f64,
    /// Bearing of the end, larger than that of the start (degrees).
    pub to_deg: f64,
}

/// A slide, as of a door.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Move {
    /// When it begins (s).
    pub at: f64,
    /// How far it goes (m, m).
    pub by: [f64; 2],
    /// How long it takes (s).
    pub seconds: f64,
}

/// Posts along a pane.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Frame {
    /// Distance from post to post at most (m).
    pub every: f64,
    /// Width of a post (m).
    pub width: f64,
}

/// What people and the robot do at the end of their way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Course {
    /// Walks to the end and leaves the scene.
    Once,
    /// Returns to the first waypoint and starts again.
    Loop,
}

/// A person: two legs at the height of the scan.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Person {
    /// Waypoints (m).
    pub path: Vec<[f64; 2]>,
    /// Walking speed (m/s).
    #[serde(default = "walking_speed")]
    pub speed: f64,
    /// When the person sets out (s); before that the person is not there. Negative: is already on the way.
    #[serde(default)]
    pub start: f64,
    /// What happens at the end of the path.
    #[serde(default = "course_loop")]
    pub course: Course,
    /// Albedo of the trousers.
    #[serde(default = "trousers")]
    pub albedo: f64,
}

fn walking_speed() -> f64 {
    1.3
}

fn course_loop() -> Course {
    Course::Loop
}

fn trousers() -> f64 {
    0.35
}

/// The robot and its drive.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Robot {
    /// Waypoints (m); a single one if the robot stands.
    pub path: Vec<[f64; 2]>,
    /// Whether the drive ends where it began.
    #[serde(default, skip_serializing_if = "is_false")]
    pub closed: bool,
    /// How often the path is driven.
    #[serde(default = "one_lap")]
    pub laps: usize,
    /// Speed (m/s).
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub speed: f64,
    /// Radius of the arcs that replace corners (m).
    #[serde(default = "corner_radius")]
    pub corner_radius: f64,
    /// Highest turning rate (degrees/s).
    #[serde(default = "turn_rate")]
    pub turn_rate_deg: f64,
    /// Heading where the robot never moves (degrees).
    #[serde(default, skip_serializing_if = "is_zero")]
    pub heading_deg: f64,
    /// Stops: [number of the waypoint, seconds].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub stops: Vec<(usize, f64)>,
    /// Outline of the body; it is seen in reflections only.
    #[serde(default)]
    pub body: Body,
    /// The laser in the robot's frame.
    #[serde(default)]
    pub mount: Mount,
}

fn one_lap() -> usize {
    1
}

fn corner_radius() -> f64 {
    0.8
}

fn turn_rate() -> f64 {
    60.0
}

/// Outline of the robot around its origin.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// Length and width of a box (m); a circle of diameter `size[0]` if `round`.
    pub size: [f64; 2],
    /// Round instead of a box.
    #[serde(default, skip_serializing_if = "is_false")]
    pub round: bool,
    /// Albedo.
    #[serde(default = "body_albedo")]
    pub albedo: f64,
}

fn body_albedo() -> f64 {
    0.4
}

impl Default for Body {
    /// A wheelchair, as in the paper.
    fn default() -> Body {
        Body { size: [0.9, 0.6], round: false, albedo: body_albedo() }
    }
}

/// Where the laser sits in the robot's frame.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Mount {
    /// Forward (m).
    pub x: f64,
    /// Left (m).
    pub y: f64,
    /// Counter-clockwise (degrees).
    #[serde(default, skip_serializing_if = "is_zero")]
    pub yaw_deg: f64,
}

/// Why a world cannot be had.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// Neither a shipped world nor a file.
    #[error("no world `{name}`: neither a file nor one of the shipped worlds ({known})")]
    Unknown {
        /// What was asked for.
        name: String,
        /// The shipped ones.
        known: String,
    },
    /// The file cannot be read.
    #[error("cannot read the world {path}: {source}")]
    Read {
        /// The file.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// Not TOML, or not the fields of a world.
    #[error("world {name}: {source}")]
    Parse {
        /// Name or file.
        name: String,
        /// Line, column and what was expected.
        source: Box<toml::de::Error>,
    },
    /// Well-formed but impossible.
    #[error("world {name}: {what}")]
    Invalid {
        /// Name of the world.
        name: String,
        /// Which part and why.
        what: String,
    },
}

/// The worlds that are part of the program.
const SHIPPED: [(&str, &str); 10] = [
    ("hall", include_str!("../worlds/hall.toml")),
    ("mirror-corridor", include_str!("../worlds/mirror-corridor.toml")),
    ("two-passes", include_str!("../worlds/two-passes.toml")),
    ("parked-crowd", include_str!("../worlds/parked-crowd.toml")),
    ("diffuse", include_str!("../worlds/diffuse.toml")),
    ("office-loop", include_str!("../worlds/office-loop.toml")),
    ("showcases", include_str!("../worlds/showcases.toml")),
    ("glass-corridor", include_str!("../worlds/glass-corridor.toml")),
    ("busy-lobby", include_str!("../worlds/busy-lobby.toml")),
    ("room", include_str!("../worlds/room.toml")),
];

impl World {
    /// Names of the shipped worlds.
    pub fn shipped() -> impl Iterator<Item = &'static str> {
        SHIPPED.iter().map(|(name, _)| *name)
    }

    /// A shipped world by its name, or a world from a TOML file.
    pub fn load(name_or_path: &str) -> Result<World, WorldError> {
        if let Some((name, text)) = SHIPPED.iter().find(|(name, _)| *name == name_or_path) {
            return World::from_toml(name, text);
        }
        let looks_like_a_path = name_or_path.contains(['/', '.']) || Path::new(name_or_path).exists();
        if !looks_like_a_path {
            let known = World::shipped().collect::<Vec<_>>().join(", ");
            return Err(WorldError::Unknown { name: name_or_path.into(), known });
        }
        let text = std::fs::read_to_string(name_or_path)
            .map_err(|source| WorldError::Read { path: name_or_path.into(), source })?;
        World::from_toml(name_or_path, &text)
    }

    /// A world from its text; `name` is for messages.
    pub fn from_toml(name: &str, text: &str) -> Result<World, WorldError> {
        let world: World = toml::from_str(text)
            .map_err(|source| WorldError::Parse { name: name.into(), source: Box::new(source) })?;
        world.check().map_err(|what| WorldError::Invalid { name: name.into(), what })?;
        Ok(world)
    }

    /// The world as TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a world has no maps with keys other than text")
    }

    /// The material of this name: the world's own, or a built-in one.
    pub fn material(&self, name: &str) -> Option<Material> {
        self.materials.get(name).copied().or_else(|| built_in_materials().get(name).copied())
    }

    /// Says what is impossible about this world, if anything: also a drive that runs into something.
    pub fn check(&self) -> Result<(), String> {
        check_path("the robot", &self.robot.path)?;
        positive("the robot's speed", self.robot.speed)?;
        positive("the robot's turn_rate_deg", self.robot.turn_rate_deg)?;
        positive("the length of the robot's body", self.robot.body.size[0])?;
        positive("the width of the robot's body", self.robot.body.size[1])?;
        if let Some((number, _)) = self.robot.stops.iter().find(|(n, _)| *n >= self.robot.path.len()) {
            return Err(format!("the robot stops at waypoint {number}, but has {}", self.robot.path.len()));
        }
        for (i, person) in self.people.iter().enumerate() {
            check_path(&format!("person {i}"), &person.path)?;
            if person.path.len() < 2 {
                return Err(format!("person {i} has a path of one point; people walk"));
            }
            positive(&format!("the speed of person {i}"), person.speed)?;
        }
        for (i, surface) in self.surfaces.iter().enumerate() {
            let name = surface.name.clone().unwrap_or_else(|| format!("surface {i}"));
            self.check_surface(surface).map_err(|what| format!("{name}: {what}"))?;
        }
        match Scene::new(self, &Default::default()).first_collision() {
            Some(what) => Err(what),
            None => Ok(()),
        }
    }

    fn check_surface(&self, surface: &Surface) -> Result<(), String> {
        if self.material(&surface.material).is_none() {
            let known: Vec<String> =
                built_in_materials().into_keys().chain(self.materials.keys().cloned()).collect();
            return Err(format!("no material `{}`; known are {}", surface.material, known.join(", ")));
        }
        let shapes = [
            surface.line.is_some(),
            surface.rectangle.is_some(),
            surface.circle.is_some(),
            surface.arc.is_some(),
        ];
        if shapes.iter().filter(|&&given| given).count() != 1 {
            return Err("needs exactly one of line, rectangle, circle, arc".into());
        }
        if let Some(line) = &surface.line {
            check_path("line", line)?;
            if line.len() < 2 {
                return Err("a line needs two points".into());
            }
        }
        if let Some(rectangle) = surface.rectangle {
            check_path("center", &[rectangle.center])?;
            check_path("size", &[rectangle.size])?;
            positive("size", rectangle.size[0].min(rectangle.size[1]))?;
        }
        if let Some(circle) = surface.circle {
            check_path("center", &[circle.center])?;
            positive("radius", circle.radius)?;
        }
        if let Some(arc) = surface.arc {
            check_path("center", &[arc.center])?;
            positive("radius", arc.radius)?;
            let span = arc.to_deg - arc.from_deg;
            if !(span > 0.0 && span <= 360.0) {
                return Err("to_deg must lie 0 to 360 degrees after from_deg".into());
            }
        }
        if let Some(frame) = surface.frame {
            positive("frame.every", frame.every)?;
            positive("frame.width", frame.width)?;
        }
        for [from, to] in &surface.present {
            if to.partial_cmp(from) != Some(std::cmp::Ordering::Greater) {
                return Err(format!("present from {from} to {to} is no interval"));
            }
        }
        let mut free_from = f64::NEG_INFINITY;
        for slide in &surface.moves {
            check_path("by", &[slide.by])?;
            positive("seconds of a move", slide.seconds)?;
            if slide.at < free_from {
                return Err(format!("the move at {} s begins before the one before it ends", slide.at));
            }
            free_from = slide.at + slide.seconds;
        }
        Ok(())
    }
}

fn positive(what: &str, value: f64) -> Result<(), String> {
    if value > 0.0 && value <= FARTHEST {
        Ok(())
    } else {
        Err(format!("{what} is {value}, not within 0 to {FARTHEST}"))
    }
}

fn check_path(what: &str, path: &[[f64; 2]]) -> Result<(), String> {
    if path.is_empty() {
        return Err(format!("{what} has no points"));
    }
    if path.iter().flatten().any(|v| !v.is_finite() || v.abs() > FARTHEST) {
        return Err(format!("{what} has a coordinate beyond {FARTHEST} m"));
    }
    match path.windows(2).position(|w| w[0] == w[1]) {
        Some(i) => Err(format!("{what} has the same point twice in a row (number {i})")),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shipped_world_loads_and_its_drive_hits_nothing() {
        for name in World::shipped() {
            let world = World::load(name).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!(world.name, name);
            let again = World::from_toml(name, &world.to_toml()).unwrap();
            assert_eq!(again.to_toml(), world.to_toml());
        }
    }

    #[test]
    fn mistakes_are_named() {
        let text = |surface: &str, robot: &str| {
            format!("name='t'\ndescription='d'\n[[surface]]\n{surface}\n[robot]\n{robot}\n")
        };
        let fault = |surface: &str, robot: &str| {
            World::from_toml("t", &text(surface, robot)).unwrap_err().to_string()
        };
        let stand = "path=[[0,0]]";
        assert!(fault("material='wal'\nline=[[1,1],[2,1]]", stand).contains("no material `wal`"));
        assert!(fault("material='wall'", stand).contains("exactly one of"));
        assert!(fault("material='wall'\nlin=[[1,1],[2,1]]", stand).contains("unknown field `lin`"));
        assert!(fault("material='wall'\nline=[[1,-1],[1,1]]", "path=[[0,0],[2,0]]").contains("runs into"),);
        assert!(fault("material='wall'\ncircle={center=[1e9,0],radius=1}", stand).contains("beyond 250 m"));
        assert!(fault("material='wall'\ncircle={center=[9,0],radius=nan}", stand).contains("radius is NaN"));
        assert!(World::load("hal").unwrap_err().to_string().contains("mirror-corridor"));
    }
}
