//! Shapes in the plane, rays, and an index that finds the first shape on a ray.
//! Not materials, not time: a shape here simply is.

use std::f64::consts::TAU;

use nalgebra::Vector2;

/// A point or direction in the plane (m).
pub type Vector = Vector2<f64>;

/// Rays start this far from what they left (m), so that they do not hit it again.
const CLEARANCE: f64 = 1e-6;

/// A straight or round piece of a surface.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// Straight from `a` to `b`.
    Segment {
        /// Start.
        a: Vector,
        /// End.
        b: Vector,
    },
    /// Part of a circle, counter-clockwise from bearing `from` (rad) over `span` (rad, at most a turn).
    Arc {
        /// Centre of the circle.
        center: Vector,
        /// Its radius (m).
        radius: f64,
        /// Bearing of the start, seen from the centre (rad).
        from: f64,
        /// Angle covered (rad).
        span: f64,
    },
}

/// Where a ray meets a shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// Distance along the ray (m).
    pub distance: f64,
    /// Unit normal of the shape there, on the side the ray comes from.
    pub normal: Vector,
    /// Length along the shape from its start (m).
    pub along: f64,
    /// Radius of curvature where the shape bulges towards the ray (m), negative where it is hollow,
    /// infinite where it is straight.
    pub radius: f64,
}

impl Shape {
    /// The shape moved by `by`.
    pub fn moved(&self, by: Vector) -> Shape {
        match *self {
            Shape::Segment { a, b } => Shape::Segment { a: a + by, b: b + by },
            Shape::Arc { center, radius, from, span } => {
                Shape::Arc { center: center + by, radius, from, span }
            }
        }
    }

    /// Length (m).
    pub fn length(&self) -> f64 {
        match self {
            Shape::Segment { a, b } => (b - a).norm(),
            Shape::Arc { radius, span, .. } => radius * span,
        }
    }

    /// The point `along` metres from the start.
    pub fn point(&self, along: f64) -> Vector {
        match *self {
            Shape::Segment { a, b } => a + (b - a) * (along / self.length()),
            Shape::Arc { center, radius, from, .. } => center + radius * heading(from + along / radius),
        }
    }

    /// Distance from `p` to the nearest point of the shape (m).
    pub fn distance(&self, p: Vector) -> f64 {
        match *self {
            Shape::Segment { a, b } => {
                let ab = b - a;
                let t = ((p - a).dot(&ab) / ab.norm_squared()).clamp(0.0, 1.0);
                (a + ab * t - p).norm()
            }
            Shape::Arc { center, radius, from, span } => {
                let d = p - center;
                if (d.y.atan2(d.x) - from).rem_euclid(TAU) <= span {
                    (d.norm() - radius).abs()
                } else {
                    (self.point(0.0) - p).norm().min((self.point(self.length()) - p).norm())
                }
            }
        }
    }

    /// Lower left and upper right corner of a box around the shape.
    pub fn bounds(&self) -> (Vector, Vector) {
        match *self {
            Shape::Segment { a, b } => (a.inf(&b), a.sup(&b)),
            Shape::Arc { center, radius, .. } => {
                (center - Vector::repeat(radius), center + Vector::repeat(radius))
            }
        }
    }

    /// First crossing of the ray from `origin` along the unit vector `direction`, nearer than `limit` (m).
    pub fn cross(&self, origin: Vector, direction: Vector, limit: f64) -> Option<Crossing> {
        match *self {
            Shape::Segment { a, b } => {
                let ab = b - a;
                let turn = direction.perp(&ab);
                if turn.abs() < 1e-12 {
                    return None;
                }
                let oa = a - origin;
                let distance = oa.perp(&ab) / turn;
                let share = oa.perp(&direction) / turn;
                if distance <= CLEARANCE || distance >= limit || !(0.0..=1.0).contains(&share) {
                    return None;
                }
                let length = ab.norm();
                let normal = Vector::new(-ab.y, ab.x) / length;
                let normal = if normal.dot(&direction) > 0.0 { -normal } else { normal };
                Some(Crossing { distance, normal, along: share * length, radius: f64::INFINITY })
            }
            Shape::Arc { center, radius, from, span } => {
                let oc = origin - center;
                let middle = -oc.dot(&direction);
                let reach = radius * radius - (oc.norm_squared() - middle * middle);
                if reach <= 0.0 {
                    return None;
                }
                let reach = reach.sqrt();
                for (distance, radius_seen) in [(middle - reach, radius), (middle + reach, -radius)] {
                    if distance <= CLEARANCE || distance >= limit {
                        continue;
                    }
                    let outward = (oc + direction * distance) / radius;
                    let turn = (outward.y.atan2(outward.x) - from).rem_euclid(TAU);
                    if turn <= span {
                        let normal = if radius_seen > 0.0 { outward } else { -outward };
                        return Some(Crossing {
                            distance,
                            normal,
                            along: turn * radius,
                            radius: radius_seen,
                        });
                    }
                }
                None
            }
        }
    }
}

/// Unit vector of a bearing (rad).
pub fn heading(angle: f64) -> Vector {
    Vector::new(angle.cos(), angle.sin())
}

/// Difference of two angles, brought to -pi..pi.
pub fn angle_difference(a: f64, b: f64) -> f64 {
    let d = (a - b).rem_euclid(TAU);
    if d > TAU / 2.0 { d - TAU } else { d }
}

/// A grid of buckets that names, for each square, the shapes that may cross it.
#[derive(Clone, Debug)]
pub struct Index {
    origin: Vector,
    side: f64,
    columns: usize,
    rows: usize,
    /// Where the list of each bucket starts in `members`; one more than there are buckets.
    starts: Vec<u32>,
    members: Vec<u32>,
}

impl Index {
    /// Index of `shapes` with buckets of `side` metres.
    pub fn new(shapes: &[Shape], side: f64) -> Index {
        let (mut low, mut high) = (Vector::repeat(0.0), Vector::repeat(0.0));
        for (i, (l, h)) in shapes.iter().map(Shape::bounds).enumerate() {
            (low, high) = if i == 0 { (l, h) } else { (low.inf(&l), high.sup(&h)) };
        }
        let origin = low - Vector::repeat(side / 2.0);
        let columns = ((high.x - origin.x) / side).ceil().max(1.0) as usize + 1;
        let rows = ((high.y - origin.y) / side).ceil().max(1.0) as usize + 1;
        let mut buckets = vec![Vec::new(); columns * rows];
        // A shape is listed in each bucket that a point of it, or the margin around that point, lies in.
        let margin = side * 0.05;
        for (i, shape) in shapes.iter().enumerate() {
            let steps = (shape.length() / margin).ceil().max(1.0);
            for k in 0..=steps as usize {
                let p = shape.point(shape.length() * k as f64 / steps) - origin;
                for (dx, dy) in [(-margin, -margin), (margin, -margin), (-margin, margin), (margin, margin)] {
                    let x = (((p.x + dx) / side) as usize).min(columns - 1);
                    let y = (((p.y + dy) / side) as usize).min(rows - 1);
                    let bucket: &mut Vec<u32> = &mut buckets[y * columns + x];
                    if bucket.last() != Some(&(i as u32)) {
                        bucket.push(i as u32);
                    }
                }
            }
        }
        let mut starts = vec![0];
        let mut members = Vec::new();
        for bucket in buckets {
            members.extend(bucket);
            starts.push(members.len() as u32);
        }
        Index { origin, side, columns, rows, starts, members }
    }

    /// Walks the ray from `origin` along `direction` through the buckets, near to far. `look` is given the
    /// members of each and returns the distance (m) beyond which nothing is of interest any more.
    pub fn walk(&self, origin: Vector, direction: Vector, mut limit: f64, mut look: impl FnMut(u32) -> f64) {
        let size = Vector::new(self.columns as f64, self.rows as f64) * self.side;
        let start = origin - self.origin;
        // Clip to the indexed rectangle.
        let (mut enter, mut leave) = (0.0f64, limit);
        for axis in 0..2 {
            if direction[axis].abs() < 1e-12 {
                if start[axis] < 0.0 || start[axis] >= size[axis] {
                    return;
                }
            } else {
                let t0 = -start[axis] / direction[axis];
                let t1 = (size[axis] - start[axis]) / direction[axis];
                enter = enter.max(t0.min(t1));
                leave = leave.min(t0.max(t1));
            }
        }
        if enter >= leave {
            return;
        }
        let p = start + direction * (enter + 1e-9);
        let mut x = ((p.x / self.side) as usize).min(self.columns - 1);
        let mut y = ((p.y / self.side) as usize).min(self.rows - 1);
        let next = |cell: usize, axis: usize| {
            if direction[axis] > 0.0 {
                ((cell + 1) as f64 * self.side - start[axis]) / direction[axis]
            } else if direction[axis] < 0.0 {
                (cell as f64 * self.side - start[axis]) / direction[axis]
            } else {
                f64::INFINITY
            }
        };
        let (mut next_x, mut next_y) = (next(x, 0), next(y, 1));
        let (step_x, step_y) = (self.side / direction.x.abs(), self.side / direction.y.abs());
        loop {
            let bucket = y * self.columns + x;
            for k in self.starts[bucket]..self.starts[bucket + 1] {
                limit = limit.min(look(self.members[k as usize]));
            }
            let exit = next_x.min(next_y);
            if exit >= limit || exit >= leave {
                return;
            }
            if next_x < next_y {
                next_x += step_x;
                x = x.wrapping_add_signed(direction.x.signum() as isize);
            } else {
                next_y += step_y;
                y = y.wrapping_add_signed(direction.y.signum() as isize);
            }
            if x >= self.columns || y >= self.rows {
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ray_meets_a_segment_and_both_sides_of_a_circle() {
        let wall = Shape::Segment { a: Vector::new(2.0, -1.0), b: Vector::new(2.0, 3.0) };
        let hit = wall.cross(Vector::zeros(), Vector::new(1.0, 0.0), 9.0).unwrap();
        assert_eq!((hit.distance, hit.along, hit.normal), (2.0, 1.0, Vector::new(-1.0, 0.0)));
        assert!(wall.cross(Vector::zeros(), Vector::new(1.0, 0.0), 1.5).is_none());
        let circle = Shape::Arc { center: Vector::new(5.0, 0.0), radius: 1.0, from: 0.0, span: TAU };
        let hit = circle.cross(Vector::zeros(), Vector::new(1.0, 0.0), 9.0).unwrap();
        assert_eq!((hit.distance, hit.radius), (4.0, 1.0));
        let inside = circle.cross(Vector::new(5.0, 0.0), Vector::new(1.0, 0.0), 9.0).unwrap();
        assert_eq!((inside.distance, inside.radius, inside.normal.x), (1.0, -1.0, -1.0));
    }

    #[test]
    fn the_index_finds_what_a_search_of_all_shapes_finds() {
        let mut shapes = Vec::new();
        for i in 0..60 {
            let a = Vector::new((i * 37 % 19) as f64, (i * 53 % 23) as f64);
            let b = a + 3.0 * heading(i as f64);
            shapes.push(Shape::Segment { a, b });
            shapes.push(Shape::Arc { center: b, radius: 0.7, from: i as f64, span: 4.0 });
        }
        let index = Index::new(&shapes, 1.0);
        let mut found_any = 0;
        for i in 0..2000 {
            let origin = Vector::new((i % 29) as f64 - 3.3, (i % 31) as f64 - 2.7);
            let direction = heading(i as f64 * 0.37);
            let first = |candidates: &mut dyn Iterator<Item = u32>| {
                candidates
                    .filter_map(|k| shapes[k as usize].cross(origin, direction, 40.0))
                    .fold(f64::INFINITY, |m, c| m.min(c.distance))
            };
            let all = first(&mut (0..shapes.len() as u32));
            let mut indexed = f64::INFINITY;
            index.walk(origin, direction, 40.0, |k| {
                if let Some(c) = shapes[k as usize].cross(origin, direction, 40.0) {
                    indexed = indexed.min(c.distance);
                }
                indexed
            });
            assert_eq!(indexed, all);
            found_any += usize::from(all.is_finite());
        }
        assert!(found_any > 500);
    }
}
