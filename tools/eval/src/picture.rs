//! Maps as pictures, a pixel a cell, north up: against the truth, and the truth alone.

use scipsim::truth::{CLEAR_OF_SURFACES, Label, TruthMap};
use visagged::map::Map;

use crate::canvas::{Canvas, Colour};

/// What the colours of [`errors`] mean.
pub const ERRORS: [(Colour, &str); 13] = [
    ([0, 60, 255], "glass, mirror or metal, found"),
    ([0, 225, 255], "glass, mirror or metal, missing"),
    ([0, 0, 0], "diffuse, found"),
    ([160, 160, 160], "diffuse, missing"),
    ([255, 0, 0], "moving thing, shown"),
    ([255, 220, 220], "moving thing, not shown"),
    ([255, 0, 255], "image in glass or a mirror, shown"),
    ([248, 222, 248], "image, not shown"),
    ([255, 120, 0], "thing taken away, shown"),
    ([255, 235, 200], "thing taken away, not shown"),
    ([90, 90, 70], "beside a surface"),
    ([0, 160, 0], "stray cell"),
    ([225, 238, 255], "the robot's way"),
];

/// What the colours of [`labels`] mean.
pub const LABELS: [(Colour, &str); 5] = [
    ([0, 60, 255], "glass, metal"),
    ([0, 0, 0], "diffuse"),
    ([255, 120, 0], "motion"),
    ([200, 60, 220], "reflection"),
    ([200, 30, 30], "removed"),
];

/// The part of the truth where anything was seen: strong colours where the map is occupied, pale where it is not.
pub fn errors(map: &Map, truth: &TruthMap) -> Canvas {
    draw(truth, |cell| {
        let label = truth.labels[cell];
        // A surface is found where the map has it within one cell, as the marks have it (but for the thinning).
        let reach = if matches!(label, Label::Glass | Label::Diffuse) { 1 } else { 0 };
        match (label, is_occupied_within(map, truth, cell, reach)) {
            (Label::Glass, true) => [0, 60, 255],
            (Label::Glass, false) => [0, 225, 255],
            (Label::Diffuse, true) => [0, 0, 0],
            (Label::Diffuse, false) => [160, 160, 160],
            (Label::Motion, true) => [255, 0, 0],
            (Label::Motion, false) => [255, 220, 220],
            (Label::Reflection, true) => [255, 0, 255],
            (Label::Reflection, false) => [248, 222, 248],
            (Label::Removed, true) => [255, 120, 0],
            (Label::Removed, false) => [255, 235, 200],
            // The surface's own width, or beside its place.
            (Label::Other, true) if truth.clearance[cell] <= CLEAR_OF_SURFACES => [90, 90, 70],
            (Label::Other, true) => [0, 160, 0],
            (Label::Other, false) if truth.path[cell] => [225, 238, 255],
            (Label::Other, false) => [255, 255, 255],
        }
    })
}

/// The truth: every cell in which something was seen, by what it was.
pub fn labels(truth: &TruthMap) -> Canvas {
    draw(truth, |cell| match truth.labels[cell] {
        Label::Glass => LABELS[0].0,
        Label::Diffuse => LABELS[1].0,
        Label::Motion => LABELS[2].0,
        Label::Reflection => LABELS[3].0,
        Label::Removed => LABELS[4].0,
        Label::Other => [255, 255, 255],
    })
}

/// The map as others draw it, cut to where the truth has anything: occupied black, free white, unknown grey.
pub fn plain(map: &Map, truth: &TruthMap) -> Canvas {
    draw(truth, |cell| match at(map, truth, cell) {
        Some(100) => [0, 0, 0],
        Some(0) => [255, 255, 255],
        _ => [205, 205, 205],
    })
}

/// Cells around what the truth knows of.
const MARGIN: usize = 8;

fn draw(truth: &TruthMap, colour: impl Fn(usize) -> Colour) -> Canvas {
    let [left, bottom, width, height] = truth.extent();
    // The truth's own margin is far wider than this.
    let (left, bottom) = (left.saturating_sub(MARGIN), bottom.saturating_sub(MARGIN));
    let width = (width + 2 * MARGIN).min(truth.width - left);
    let height = (height + 2 * MARGIN).min(truth.height - bottom);
    let mut canvas = Canvas::new(width, height);
    for y in 0..height {
        for x in 0..width {
            let cell = (y + bottom) * truth.width + x + left;
            canvas.set(x as i64, (height - 1 - y) as i64, colour(cell));
        }
    }
    canvas
}

fn is_occupied_within(map: &Map, truth: &TruthMap, cell: usize, reach: i64) -> bool {
    let (x, y) = ((cell % truth.width) as i64, (cell / truth.width) as i64);
    let mut around = (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| [x + dx, y + dy]));
    around.any(|[x, y]| place(map, truth, x, y).is_some_and(|place| map.occupancy[place] == 100))
}

/// The map's value in a cell of the truth, if the map goes that far.
fn at(map: &Map, truth: &TruthMap, cell: usize) -> Option<i8> {
    place(map, truth, (cell % truth.width) as i64, (cell / truth.width) as i64)
        .map(|place| map.occupancy[place])
}

/// Place in the map's layers of a column and row of the truth, whose cells coincide with the map's.
pub fn place(map: &Map, truth: &TruthMap, x: i64, y: i64) -> Option<usize> {
    let offset = |axis: usize| ((truth.origin[axis] - map.origin[axis]) / truth.resolution).round() as i64;
    let (column, row) = (x + offset(0), y + offset(1));
    let inside = (0..map.width as i64).contains(&column) && (0..map.height as i64).contains(&row);
    inside.then(|| row as usize * map.width + column as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_surface_is_found_by_the_cell_beside_it_and_an_error_only_where_it_is() {
        let labels = [Label::Glass, Label::Other, Label::Motion, Label::Glass].to_vec();
        let truth = TruthMap {
            resolution: 0.05,
            origin: [0.0, 0.0],
            width: 4,
            height: 1,
            labels,
            clearance: vec![0, 1, 1, 0],
            path: vec![false; 4],
        };
        let map = Map {
            resolution: 0.05,
            origin: [0.05, 0.0],
            width: 1,
            height: 1,
            occupancy: vec![100],
            visibility: vec![0],
            layers: vec![],
        };
        let (found, missing, not_shown) = (ERRORS[0].0, ERRORS[1].0, ERRORS[5].0);
        let picture = errors(&map, &truth);
        let row: Vec<Colour> = (0..4).map(|x| picture.at(x, 0)).collect();
        assert_eq!(row, [found, [90, 90, 70], not_shown, missing]);
    }
}
