//! What a beam brings back: brightness of diffuse surfaces, glass, mirrors and metal, along all the ways the light can
//! take, and the one reading that the scanner makes of it (the paper's section III). Brightness is relative
//! to a white wall, met squarely at one metre.
//!
//! Not simulated: the width of the beam (so no mixed pixels at edges), and the little that rays reflected by a leaning
//! surface leave the plane of the scan (only the glint and the dust know of the lean).

use crate::drive::Pose;
use crate::geometry::Vector;
use crate::noise::Random;
use crate::scene::{Met, Moment, Scene, Skin, Thing};
use crate::world::Kind;

/// A wall of albedo 0.9 met squarely is lost beyond this distance (m); data sheet of the UTM-30LX.
const REACH: f64 = 30.0;
/// Least brightness that makes a reading.
pub const FLOOR: f64 = 0.9 / (REACH * REACH);
/// Deviation of the logarithm of a return's brightness (about 13 %).
const BRIGHTNESS_NOISE: f64 = 0.13;
/// Returns nearer to each other than this are read as one (m).
const MERGE: f64 = 0.12;
/// Rays are followed through this many reflections and transmissions.
const DEPTH: u32 = 3;
/// Deviation of a range, near and beyond 10 m (m); data sheet of the UTM-30LX and the paper's sensor model.
const RANGE_NOISE: [f64; 2] = [0.010, 0.025];
/// Probability of a random reading (paper III-B.2).
const RANDOM_READING: f64 = 1e-3;
/// Beyond this no random reading falls (m).
const RANDOM_REACH: f64 = 30.0;

/// Brightness of dust on glass at 1 degree off the normal: that of a white wall 1 m behind a pane at 1 m, seen
/// through it (0.7 * 0.92^2 / 2^2), so that the pane wins within 1 degree (paper, Fig. 7 and 9).
const DUST_AT_1_DEG: f64 = 0.148;
/// Fall of the dust's brightness with the angle off the normal.
const DUST_POWER: f64 = 1.5;
/// The tail is not followed nearer to the normal than this (degrees).
const DUST_CORE_DEG: f64 = 0.3;
/// Deviation of the logarithm of dust along a pane.
const DUST_SPREAD: f64 = 0.35;
/// A glint that comes straight back, against a white wall: 8 % of the light instead of what enters an
/// aperture of some 2.5 cm from a Lambert surface at 1 m (0.08 / (0.0125^2)) is about 500.
const GLINT: f64 = 500.0;
/// Half width (deviation) of the glint (degrees).
const GLINT_WIDTH_DEG: f64 = 0.1;
/// Reflected share of one face of glass at the normal; two faces make the paper's 8 %.
const FACE: f64 = 0.04;
/// Reflected share of a mirror, and of steel as far as images go.
const MIRROR_SHARE: f64 = 0.9;
const METAL_SHARE: f64 = 0.35;
/// Metal: brightness and width (degrees) of its lobe.
const METAL_LOBE: f64 = 6.0;
const METAL_WIDTH_DEG: f64 = 6.0;
/// Diffuse surfaces at grazing incidence return with falling probability: half at this angle (degrees), over
/// this width. Fitted to a real scanner's 0.91..0.98 at 70..75 degrees, 0.27..0.46 at 75..80, 0 beyond.
const GRAZING_DEG: [f64; 2] = [76.6, 1.1];

/// Intensity on the device's scale is `INTENSITY_AT_1 * brightness ^ INTENSITY_POWER`: fitted to the medians of a
/// real UTM-30LX with typical surfaces (albedo 0.5 at 30 degrees): 3710 at 0.75 m, 2756 at 1.5, 2424 at 2.5, 2040 at 3.5.
const INTENSITY_AT_1: f64 = 3903.0;
const INTENSITY_POWER: f64 = 0.1935;
/// Highest intensity seen from a real UTM-30LX.
const INTENSITY_MAX: f64 = 16219.0;

/// By which way the light of a reading came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Route {
    /// Straight.
    Direct,
    /// Through glass.
    Transmitted,
    /// By at least one reflection: the reading is an image.
    Reflected,
}

/// What a reading is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// Nothing returned enough light.
    Nothing,
    /// The scanner failed.
    Random,
    /// A placement of a surface, by number.
    Placement(u16),
    /// A person, by number.
    Person(u16),
    /// The robot itself, in a reflection.
    Body,
}

/// Where a reading truly comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeamTruth {
    /// What it is of.
    pub source: Source,
    /// Law of the surface met; `Diffuse` for people and the robot.
    pub kind: Kind,
    /// By which way.
    pub route: Route,
    /// Its incidence: angle between the last part of the ray and the surface's normal (rad).
    pub incidence: f32,
}

/// Light that comes back to the scanner along one way.
#[derive(Clone, Copy, Debug)]
struct Return {
    distance: f64,
    brightness: f64,
    truth: BeamTruth,
}

/// What the scanner makes of a beam.
#[derive(Clone, Copy, Debug)]
pub struct Reading {
    /// Range (m), or `None`.
    pub range: Option<f64>,
    /// Brightness of the return that was read.
    pub brightness: f64,
    /// Where it came from.
    pub truth: BeamTruth,
}

const NOTHING: BeamTruth =
    BeamTruth { source: Source::Nothing, kind: Kind::Diffuse, route: Route::Direct, incidence: 0.0 };

/// Intensity that the device gives for a brightness.
pub fn intensity(brightness: f64) -> f64 {
    (INTENSITY_AT_1 * brightness.max(0.0).powf(INTENSITY_POWER)).min(INTENSITY_MAX)
}

/// Traces beams. Keeps its memory from beam to beam.
#[derive(Debug)]
pub struct Tracer<'a> {
    scene: &'a Scene,
    moment: &'a Moment,
    /// Of the beam at hand: when it was fired (s), and where the robot was.
    time: f64,
    robot: Pose,
    returns: Vec<Return>,
}

#[derive(Clone, Copy)]
struct Ray {
    origin: Vector,
    direction: Vector,
    /// Way behind it (m).
    travelled: f64,
    /// Share of the light that is left after the way out and the same way back.
    share: f64,
    route: Route,
    depth: u32,
    /// Curved mirrors passed: how much faster than the way the beam widens.
    spread: f64,
}

impl<'a> Tracer<'a> {
    /// For the beams of one scan.
    pub fn new(scene: &'a Scene, moment: &'a Moment) -> Tracer<'a> {
        Tracer { scene, moment, time: 0.0, robot: Pose::identity(), returns: Vec::new() }
    }

    /// The reading of a beam fired at `time` (s) from `origin` along `direction`, the robot being at `robot`.
    pub fn read(
        &mut self,
        origin: Vector,
        direction: Vector,
        robot: Pose,
        time: f64,
        random: &mut Random,
    ) -> Reading {
        self.returns.clear();
        (self.time, self.robot) = (time, robot);
        let ray = Ray {
            origin,
            direction,
            travelled: 0.0,
            share: 1.0,
            route: Route::Direct,
            depth: 0,
            spread: 1.0,
        };
        self.follow(ray, random);
        if random.chance(RANDOM_READING) {
            let truth = BeamTruth { source: Source::Random, ..NOTHING };
            return Reading { range: Some(random.uniform(0.1, RANDOM_REACH)), brightness: FLOOR, truth };
        }
        for back in &mut self.returns {
            back.brightness *= (BRIGHTNESS_NOISE * random.normal()).exp();
        }
        let Some(best) = self.returns.iter().copied().max_by(|a, b| a.brightness.total_cmp(&b.brightness))
        else {
            return Reading { range: None, brightness: 0.0, truth: NOTHING };
        };
        // What lies within the pulse's length adds to the brightest and pulls its range.
        let (mut light, mut moment) = (0.0, 0.0);
        for near in self.returns.iter().filter(|r| (r.distance - best.distance).abs() < MERGE) {
            light += near.brightness;
            moment += near.brightness * near.distance;
        }
        if light < FLOOR {
            return Reading { range: None, brightness: 0.0, truth: NOTHING };
        }
        let range = moment / light;
        let noise = RANGE_NOISE[usize::from(range > 10.0)] * random.normal();
        Reading { range: Some((range + noise).max(0.0)), brightness: light, truth: best.truth }
    }

    /// Follows a ray to the first thing it meets, notes what comes back, and goes on with what is left.
    fn follow(&mut self, ray: Ray, random: &mut Random) {
        // Beyond this way even a white wall would be too dark.
        let limit = (2.0 * ray.share / FLOOR).sqrt() - ray.travelled;
        if limit <= 0.0 {
            return;
        }
        let body = (ray.route == Route::Reflected).then_some(self.robot);
        let Some(met) = self.scene.first(ray.origin, ray.direction, limit, self.moment, self.time, body)
        else {
            return;
        };
        let distance = ray.travelled + met.crossing.distance;
        let cosine = -ray.direction.dot(&met.crossing.normal);
        let to_brightness = ray.share / (distance * distance * ray.spread);
        let (kind, source, brightness) = match met.what {
            Thing::Person(person) => {
                (Kind::Diffuse, Source::Person(person), self.scene.trousers(person) * cosine)
            }
            Thing::Body => (Kind::Diffuse, Source::Body, self.scene.body_albedo() * cosine),
            Thing::Placement(placement) => {
                let surface = self.scene.placements()[usize::from(placement)].surface;
                let skin = self.scene.skin(surface);
                let kind = skin.material.kind;
                let brightness = match kind {
                    Kind::Diffuse if random.chance(1.0 - grazing(cosine)) => 0.0,
                    Kind::Diffuse => skin.material.albedo * cosine,
                    _ => gloss(skin, &met, cosine, distance),
                };
                self.go_on(ray, &met, skin, cosine, random);
                (kind, Source::Placement(placement), brightness)
            }
        };
        if brightness > 0.0 {
            let truth = BeamTruth {
                source,
                kind,
                route: ray.route,
                incidence: cosine.clamp(-1.0, 1.0).acos() as f32,
            };
            self.returns.push(Return { distance, brightness: brightness * to_brightness, truth });
        }
    }

    /// The reflected and the transmitted ray.
    fn go_on(&mut self, ray: Ray, met: &Met, skin: &Skin, cosine: f64, random: &mut Random) {
        let reflected = match skin.material.kind {
            Kind::Diffuse => return,
            Kind::Glass => glass_share(cosine, skin.material.panes),
            Kind::Mirror => MIRROR_SHARE,
            Kind::Metal => METAL_SHARE,
        };
        if ray.depth >= DEPTH {
            return;
        }
        let origin = ray.origin + ray.direction * met.crossing.distance;
        let travelled = ray.travelled + met.crossing.distance;
        let next = Ray { origin, travelled, depth: ray.depth + 1, ..ray };
        if skin.material.kind == Kind::Glass {
            let passed = 1.0 - reflected;
            let route = if ray.route == Route::Direct { Route::Transmitted } else { ray.route };
            self.follow(Ray { share: ray.share * passed * passed, route, ..next }, random);
        }
        // A bulging mirror spreads the light that comes back: at equal distances before and behind it
        // the beam is (1 + travelled / (radius cosine)) times as wide. A hollow one is taken as flat.
        let bulge = if met.crossing.radius.is_finite() && met.crossing.radius > 0.0 {
            1.0 + travelled / (met.crossing.radius * cosine.max(0.05))
        } else {
            1.0
        };
        let direction = ray.direction + met.crossing.normal * (2.0 * cosine);
        self.follow(
            Ray {
                direction,
                share: ray.share * reflected * reflected,
                route: Route::Reflected,
                spread: ray.spread * bulge,
                ..next
            },
            random,
        );
    }
}

/// Probability that a diffuse surface returns anything at this cosine of incidence.
fn grazing(cosine: f64) -> f64 {
    if cosine > 0.5 {
        return 1.0;
    }
    let angle = cosine.clamp(-1.0, 1.0).acos().to_degrees();
    1.0 / (1.0 + ((angle - GRAZING_DEG[0]) / GRAZING_DEG[1]).exp())
}

/// Share of the light that panes reflect (Schlick's form of Fresnel's law, all faces one behind the other).
fn glass_share(cosine: f64, panes: u32) -> f64 {
    let face = FACE + (1.0 - FACE) * (1.0 - cosine.clamp(0.0, 1.0)).powi(5);
    let faces = f64::from(2 * panes);
    faces * face / (1.0 + (faces - 1.0) * face)
}

/// Brightness of a glossy surface, before distance.
fn gloss(skin: &Skin, met: &Met, cosine: f64, distance: f64) -> f64 {
    let material = &skin.material;
    // The angle to the normal in space: the lean is square to the angle in the plane.
    let cosine_in_space = cosine.clamp(-1.0, 1.0) * material.lean_deg.to_radians().cos();
    let angle = cosine_in_space.clamp(-1.0, 1.0).acos().to_degrees();
    let dust = material.dust * (DUST_SPREAD * skin.dust.value(met.crossing.along)).exp();
    let tail = DUST_AT_1_DEG * dust * angle.max(DUST_CORE_DEG).powf(-DUST_POWER);
    // A bulge spreads the glint as it spreads any reflection.
    let bulge =
        if met.crossing.radius > 0.0 { 1.0 / (1.0 + 2.0 * distance / met.crossing.radius) } else { 1.0 };
    let lobe = |peak: f64, width: f64| peak * bulge * (-0.5 * (angle / width).powi(2)).exp();
    let specular = match material.kind {
        Kind::Diffuse => 0.0,
        Kind::Glass => lobe(GLINT, GLINT_WIDTH_DEG) + tail,
        Kind::Mirror => lobe(10.0 * GLINT, GLINT_WIDTH_DEG) + tail,
        Kind::Metal => lobe(METAL_LOBE, METAL_WIDTH_DEG) + tail,
    };
    material.gain * specular + material.albedo * cosine.max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive::pose;
    use crate::geometry::heading;
    use crate::scene::Overrides;
    use crate::world::World;

    /// Share of readings of each source along beams at `angle` degrees off the normal of a surface at x = 1.
    fn share_seen(surfaces: &str, angle: f64, is_seen: impl Fn(&Reading) -> bool) -> f64 {
        let text = format!("name='t'\ndescription='t'\n{surfaces}\n[robot]\npath=[[0,0]]\n");
        let world = World::from_toml("t", &text).unwrap();
        let scene = Scene::new(&world, &Overrides::default());
        let moment = scene.moment(0.0);
        let mut random = Random::new(&[1]);
        let mut seen = 0;
        let tries = 400;
        for i in 0..tries {
            // From places along the pane, so that its dust varies.
            let y = i as f64 * 0.01 - 2.0 - angle.to_radians().tan();
            let reading = Tracer::new(&scene, &moment).read(
                Vector::new(0.0, y),
                heading(angle.to_radians()),
                pose(0.0, -50.0, 0.0),
                0.0,
                &mut random,
            );
            seen += u32::from(is_seen(&reading));
        }
        f64::from(seen) / f64::from(tries)
    }

    fn near(reading: &Reading) -> bool {
        reading.truth.kind.is_specular() && reading.truth.route == Route::Direct
    }

    const PANE: &str = "[[surface]]\nmaterial='glass'\nline=[[1,-9],[1,9]]\n";
    const WALL_BEHIND: &str = "[[surface]]\nmaterial='wall'\nline=[[2,-9],[2,9]]\n";

    #[test]
    fn a_pane_beats_a_wall_1_m_behind_within_1_degree() {
        let both = format!("{PANE}{WALL_BEHIND}");
        assert!(share_seen(&both, 0.1, near) > 0.99);
        assert!(share_seen(&both, 0.5, near) > 0.95);
        let at_1 = share_seen(&both, 1.0, near);
        assert!((0.25..0.75).contains(&at_1), "{at_1}");
        assert!(share_seen(&both, 2.0, near) < 0.05);
        assert!(share_seen(&both, 6.0, near) < 0.01);
    }

    #[test]
    fn a_pane_with_nothing_behind_is_seen_over_tens_of_degrees() {
        assert!(share_seen(PANE, 10.0, near) > 0.98);
        assert!(share_seen(PANE, 20.0, near) > 0.8);
        let far = share_seen(PANE, 60.0, near);
        assert!(far < 0.05, "{far}");
    }

    #[test]
    fn leaning_by_a_degree_takes_the_glint_away() {
        let lean = "[materials.leaning]\nkind='glass'\nlean_deg=1.0\nalbedo=0.0\n\
                    [[surface]]\nmaterial='leaning'\nline=[[1,-9],[1,9]]\n";
        let bright = |r: &Reading| r.brightness > 5.0;
        assert!(share_seen(PANE, 0.1, bright) > 0.99);
        assert!(share_seen(lean, 0.1, bright) < 0.01);
    }

    #[test]
    fn mirrors_show_images_and_metal_is_seen_widely() {
        let mirror = "[[surface]]\nmaterial='mirror'\nline=[[1,-9],[1,9]]\n\
                      [[surface]]\nmaterial='wall'\nline=[[-1,-30],[-1,30]]\n";
        assert!(share_seen(mirror, 0.0, near) > 0.99);
        let image = |r: &Reading| r.truth.route == Route::Reflected && r.range.is_some_and(|d| d > 2.9);
        assert!(share_seen(mirror, 20.0, image) > 0.95);
        let steel = "[[surface]]\nmaterial='steel'\nline=[[1,-9],[1,9]]\n";
        assert!(share_seen(steel, 25.0, near) > 0.99);
    }

    #[test]
    fn grazing_walls_drop_out_as_measured() {
        let wall = "[[surface]]\nmaterial='wall'\nline=[[1,-30],[1,30]]\n";
        let any = |r: &Reading| r.truth.kind == Kind::Diffuse && r.truth.source == Source::Placement(0);
        let over =
            |from: f64| (0..20).map(|i| share_seen(wall, from + 0.25 * i as f64, any)).sum::<f64>() / 20.0;
        assert!(share_seen(wall, 60.0, any) > 0.95);
        assert!((0.91..0.98).contains(&over(70.0)), "{}", over(70.0));
        assert!((0.27..0.46).contains(&over(75.0)), "{}", over(75.0));
        assert!(over(81.0) < 0.02);
    }

    #[test]
    fn a_white_wall_is_lost_at_30_m_and_intensity_is_on_the_devices_scale() {
        let wall = |x: f64| {
            format!(
                "[materials.white]\nkind='diffuse'\nalbedo=0.9\n\
                 [[surface]]\nmaterial='white'\nline=[[{x},-50],[{x},50]]\n"
            )
        };
        let read = |r: &Reading| r.truth.source == Source::Placement(0);
        assert!(share_seen(&wall(24.0), 0.0, read) > 0.95);
        assert!(share_seen(&wall(38.0), 0.0, read) < 0.01);
        for (distance, median) in [(0.75, 3710.0), (1.5, 2756.0), (2.5, 2424.0), (3.5, 2040.0f64)] {
            let ours = intensity(0.5 * 30f64.to_radians().cos() / (distance * distance));
            assert!((ours / median - 1.0).abs() < 0.06, "{distance} m: {ours}");
        }
        assert!(intensity(GLINT / 0.36) > 12_000.0);
    }
}
