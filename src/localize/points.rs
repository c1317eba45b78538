//! The points of one scan, each put where it was when its beam was fired, with the direction of the surface around it.
//!
//! Not a map: nothing here outlives its scan.

use crate::{grid::sweep::Sweep, pose::Pose, scan::Scan};
use nalgebra::{Point2, Vector2};

/// Farthest range that is matched (m): a UTM-30LX is specified to 30 m.
pub const RANGE_MAX: f32 = 30.0;
/// Deviation of a range up to [`NEAR`] and beyond it (m): UTM-30LX specification, 10 and 30 mm; 25 mm measured.
const RANGE_SIGMA: [f32; 2] = [0.010, 0.025];
/// See [`RANGE_SIGMA`] (m).
const NEAR: f32 = 10.0;
/// Reach of the line that is fitted through a point's neighbours, to either side (m): wide enough that 1 cm of noise
/// turns it by no more than 5 degrees, narrow enough to fit between the posts of a glass front.
const REACH: f64 = 0.15;
/// Neighbours to either side that the fit takes at least and at most.
const NEIGHBOURS: [usize; 2] = [2, 12];
/// A fit is a surface where it is this much longer than thick.
const STRAIGHT: f64 = 3.0;

/// Width of a post, and half of how far it stands before what is behind (m).
const POST: f64 = 0.15;

/// One return.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanPoint {
    /// Where it is, in the scanner's frame at the middle of the scan (m).
    pub at: Point2<f64>,
    /// Unit normal of the surface, toward the scanner; `None` where the neighbours make no line.
    pub normal: Option<Vector2<f64>>,
    /// Variance of its range (m2).
    pub variance: f64,
    /// Whether it is on something narrow that stands before all beside it, such as a post.
    pub post: bool,
    /// Sine of the angle at which its surface was met; 1 where that is not known.
    pub sine: f64,
}

impl ScanPoint {
    /// 1, or less where its surface is met at an angle of a smaller sine than `least`.
    pub fn slant_weight(&self, least: f64) -> f64 {
        (self.sine / least).min(1.0).powi(2)
    }
}

/// One beam with a return, for the clearing of free space.
#[derive(Clone, Copy, Debug)]
pub struct Beam {
    /// Where the scanner was, in its own frame at the middle of the scan (m).
    pub from: Point2<f64>,
    /// Where the return is (m).
    pub to: Point2<f64>,
}

/// The points of a scan.
#[derive(Clone, Debug, Default)]
pub struct Points {
    /// All of them, in the order of the beams.
    pub all: Vec<ScanPoint>,
    /// Those that are matched: thinned to even spacing.
    pub thinned: Vec<ScanPoint>,
    /// The beams of `all`.
    pub beams: Vec<Beam>,
    numbers: Vec<usize>,
    ways: Vec<f64>,
}

impl Points {
    /// Takes the scan's points in the place of those before. `start` and `end`: the scanner at the first and last beam,
    /// in its own frame at the middle of the scan.
    pub fn read(&mut self, scan: &Scan, start: Pose, end: Pose, spacing: f64, most: usize) {
        self.all.clear();
        self.beams.clear();
        self.numbers.clear();
        let sweep = Sweep { scan, start, end };
        for (number, ((origin, direction), &range)) in sweep.beams().zip(&scan.ranges).enumerate() {
            if !(range.is_finite() && range > 0.0 && range <= RANGE_MAX) {
                continue;
            }
            let at = origin + direction * f64::from(range);
            let sigma = f64::from(RANGE_SIGMA[usize::from(range > NEAR)]);
            self.all.push(ScanPoint { at, normal: None, variance: sigma * sigma, post: false, sine: 1.0 });
            self.beams.push(Beam { from: origin, to: at });
            self.numbers.push(number);
        }
        let step = scan.geometry.angle_increment.abs();
        for i in 0..self.all.len() {
            let normal = self.normal(i, step);
            let point = &mut self.all[i];
            let range = point.at.coords.norm().max(1e-3);
            point.sine = normal.map_or(1.0, |normal| normal.dot(&point.at.coords).abs() / range);
            point.normal = normal;
        }
        self.mark_posts();
        self.thin(step, spacing, most);
    }

    /// Fits a line through the neighbours of a point.
    fn normal(&self, i: usize, angle_step: f64) -> Option<Vector2<f64>> {
        let at = self.all[i].at;
        let range = (at - self.beams[i].from).norm();
        let between = (range * angle_step).max(1e-4);
        let most = ((REACH / between).ceil() as usize).clamp(NEIGHBOURS[0], NEIGHBOURS[1]);
        // Far out the beams are farther apart than the reach, and along a grazed wall farther still.
        let reach = REACH.max(between * 4.0 * NEIGHBOURS[0] as f64);
        let (mut n, mut sum, mut squares) = (0.0, Vector2::zeros(), [0.0; 3]);
        let mut take = |j: usize| {
            let d = self.all[j].at - at;
            if d.norm_squared() > reach * reach {
                return false;
            }
            n += 1.0;
            sum += d;
            squares[0] += d.x * d.x;
            squares[1] += d.x * d.y;
            squares[2] += d.y * d.y;
            true
        };
        take(i);
        let is_near = |j: usize| self.numbers[j].abs_diff(self.numbers[i]) <= most;
        for j in (0..i).rev() {
            if !is_near(j) || !take(j) {
                break;
            }
        }
        for j in i + 1..self.all.len() {
            if !is_near(j) || !take(j) {
                break;
            }
        }
        if n < 4.0 {
            return None;
        }
        let mean = sum / n;
        let spread = Spread {
            xx: squares[0] / n - mean.x * mean.x,
            xy: squares[1] / n - mean.x * mean.y,
            yy: squares[2] / n - mean.y * mean.y,
        };
        let (normal, least, most) = spread.axes();
        let toward = self.beams[i].from - at;
        (most > STRAIGHT * STRAIGHT * least).then(|| if normal.dot(&toward) < 0.0 { -normal } else { normal })
    }

    /// Marks what is narrower than [`POST`] and nearer than what the beams to both sides meet.
    fn mark_posts(&mut self) {
        let mut first = 0;
        for i in 1..=self.all.len() {
            let ends =
                i == self.all.len() || (self.all[i].at - self.all[i - 1].at).norm_squared() > POST * POST;
            if !ends {
                continue;
            }
            let is_narrow = (self.all[i - 1].at - self.all[first].at).norm_squared() < POST * POST;
            let range = |k: usize| (self.all[k].at - self.beams[k].from).norm();
            let is_behind = |k: usize, edge: usize| range(k) > range(edge) + 2.0 * POST;
            let stands_before =
                first > 0 && i < self.all.len() && is_behind(first - 1, first) && is_behind(i, i - 1);
            if is_narrow && i - first >= 2 && stands_before {
                self.all[first..i].iter_mut().for_each(|point| point.post = true);
            }
            first = i;
        }
    }

    /// Keeps points at even spacing along the outline, wider where there would be too many.
    ///
    /// The way along the outline is that from beam to beam on the fitted surface, never between measured points: those whose
    /// noise carries them on would be chosen more often, and turn every map by a twentieth of a degree.
    fn thin(&mut self, angle_step: f64, spacing: f64, most: usize) {
        self.ways.clear();
        let mut way = 0.0;
        for (i, point) in self.all.iter().enumerate() {
            let beam = point.at - self.beams[i].from;
            let range = beam.norm().max(1e-3);
            // Along a wall that is grazed more than this its returns are rare (measured: beyond 80 degrees).
            let slant = point.normal.map_or(1.0, |normal| (normal.dot(&beam) / range).abs().max(0.17));
            let beams = if i == 0 { 1 } else { self.numbers[i] - self.numbers[i - 1] };
            way += beams as f64 * range * angle_step / slant;
            self.ways.push(way);
        }
        let spacing = spacing.max(way / most.max(1) as f64);
        let mut next = 0.0;
        self.thinned.clear();
        for (point, &way) in self.all.iter().zip(&self.ways) {
            if way >= next {
                next = way + spacing;
                self.thinned.push(*point);
            }
        }
    }
}

/// Second moments of points around their mean (m2).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread {
    /// Along x.
    pub xx: f64,
    /// Mixed.
    pub xy: f64,
    /// Along y.
    pub yy: f64,
}

impl Spread {
    /// The direction in which the points spread least (unit vector), and the least and the most variance (m2).
    pub fn axes(&self) -> (Vector2<f64>, f64, f64) {
        let half_trace = (self.xx + self.yy) / 2.0;
        let half_difference = (self.xx - self.yy) / 2.0;
        let root = (half_difference * half_difference + self.xy * self.xy).sqrt();
        // Direction of the most variance; atan2 has an answer for a round spread too.
        let angle = 0.5 * self.xy.atan2(half_difference);
        let normal = Vector2::new(-angle.sin(), angle.cos());
        (normal, (half_trace - root).max(0.0), half_trace + root)
    }
}
