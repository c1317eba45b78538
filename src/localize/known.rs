//! A matching map made of a grid that earlier runs have left.
//!
//! What the grid does not show (people, reflections) is not matched with. What was seen from some directions only is; but
//! it hides nothing: only what was never missed does.

use super::points::Spread;
use super::submap::{Known, Submap};
use crate::grid::known::KnownPlaces;
use nalgebra::{Point2, Vector2};
use std::collections::HashMap;

/// Neighbours within this make the line that a cell is a part of (m): three returns of 1 cm noise over 30 cm turn it by 3
/// degrees.
const REACH: f64 = 0.15;
/// ... where they are seen from the same side, within 60 degrees (cosine).
const SAME_SIDE: f64 = 0.5;
/// They are a line where they are this much longer than thick.
const STRAIGHT: f64 = 3.0;
/// Returns that make a piece of surface count as much as any other.
const SEEN_WELL: u16 = 30;

/// The map for matching with what a grid knows, whose cells have sides of `resolution` (m).
pub fn matching_map(places: &KnownPlaces, resolution: f64) -> Submap {
    let square = |at: &[f64; 2]| at.map(|at| (at / reach(resolution)).floor() as i32);
    let mut squares: HashMap<[i32; 2], Vec<usize>> = HashMap::new();
    for (number, surface) in places.surfaces.iter().enumerate() {
        squares.entry(square(&surface.at)).or_default().push(number);
    }
    let side = |number: usize| {
        let (sin, cos) = places.surfaces[number].seen_from.sin_cos();
        Vector2::new(cos, sin)
    };
    let surfaces = places.surfaces.iter().enumerate().map(|(number, surface)| {
        let (at, seen_from) = (Point2::from(surface.at), side(number));
        let [x, y] = square(&surface.at);
        let around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| [x + dx, y + dy]));
        let near = around.filter_map(|square| squares.get(&square)).flatten();
        let offs = near
            .filter(|&&other| side(other).dot(&seen_from) >= SAME_SIDE)
            .map(|&other| Point2::from(places.surfaces[other].at) - at)
            .filter(|off| off.norm() <= reach(resolution));
        Known {
            at,
            normal: normal(offs, seen_from),
            length: resolution,
            returns: f32::from(surface.hits.min(SEEN_WELL)) / 10.0,
            is_opaque: surface.is_opaque,
        }
    });
    let point = |at: &[f64; 2]| Point2::from(*at);
    Submap::of_known(surfaces, places.free.iter().map(point), places.doubtful.iter().map(point))
}

/// Coarse cells need farther neighbours.
fn reach(resolution: f64) -> f64 {
    REACH.max(2.5 * resolution)
}

/// Normal of the line through points, to this side.
fn normal(offs: impl Iterator<Item = Vector2<f64>>, side: Vector2<f64>) -> Option<Vector2<f64>> {
    let (mut n, mut sum, mut squares) = (0.0, Vector2::zeros(), Spread::default());
    for off in offs {
        n += 1.0;
        sum += off;
        squares.xx += off.x * off.x;
        squares.xy += off.x * off.y;
        squares.yy += off.y * off.y;
    }
    if n < 3.0 {
        return None;
    }
    let mean = sum / n;
    let spread = Spread {
        xx: squares.xx / n - mean.x * mean.x,
        xy: squares.xy / n - mean.x * mean.y,
        yy: squares.yy / n - mean.y * mean.y,
    };
    let (normal, least, most) = spread.axes();
    (most > STRAIGHT * STRAIGHT * least).then(|| if normal.dot(&side) < 0.0 { -normal } else { normal })
}
