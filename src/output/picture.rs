//! map.png: the map for people to look at. Programs read map.pgm or map.npz.
//!
//! White is free, grey unknown; what is occupied is orange where it was seen whenever it was looked at (diffuse), blue
//! where it was missed from most directions (glass, mirrors, metal), and in between where that is in between. Shown is the part that holds what is occupied; beams go much further. A scale bar is drawn below.

use std::ops::Range;

use crate::grid::verdict::Verdict;
use crate::map::{Map, Values};

type Colour = [u8; 3];
const FREE: Colour = [255, 255, 255];
const UNKNOWN: Colour = [178, 178, 178];
const DIFFUSE: Colour = [190, 80, 0];
const SPECULAR: Colour = [0, 70, 255];
const INK: Colour = [0, 0, 0];

/// Colours of explain.png: strong where the cell is shown, pale where it is not.
const VERDICTS: [(Verdict, Colour); 10] = [
    (Verdict::Solid, INK),
    (Verdict::Surface, [0, 70, 255]),
    (Verdict::Repeated, [0, 140, 60]),
    (Verdict::Bridged, [0, 190, 220]),
    (Verdict::Oblique, [120, 60, 200]),
    (Verdict::Lasting, [0, 90, 90]),
    (Verdict::TooFew, [215, 215, 160]),
    (Verdict::NoSurface, [255, 150, 140]),
    (Verdict::Image, [240, 150, 240]),
    (Verdict::Beside, [205, 190, 170]),
];

/// `Map::visibility` from which a cell counts as specular: missed from a quarter of the directions that
/// it was looked at from. A wall is missed from a few, at grazing incidence.
pub const SPECULAR_FROM: i8 = 25;
/// The colour goes from orange to blue over so much visibility, around `SPECULAR_FROM`.
const TRANSITION: i8 = 20;

/// Unknown border around what is shown (m).
const MARGIN: f64 = 1.0;
/// Share of the occupied cells that may lie beyond the picture's margin at each side: single stray returns.
const STRAY: f64 = 0.002;

/// Small maps are drawn larger until their longer side has about this many pixels.
const WANTED_PIXELS: usize = 1200;
/// A cell is never drawn larger than this (pixels).
const LARGEST_CELL: usize = 8;
/// Height of the strip that holds the scale bar (pixels).
const STRIP: usize = 24;

/// A 3 x 5 face for the scale bar: three bits a row from the top.
const GLYPHS: [(char, [u8; 5]); 12] = [
    ('0', [7, 5, 5, 5, 7]),
    ('1', [2, 6, 2, 2, 7]),
    ('2', [7, 1, 7, 4, 7]),
    ('3', [7, 1, 7, 1, 7]),
    ('4', [5, 5, 7, 1, 1]),
    ('5', [7, 4, 7, 1, 7]),
    ('6', [7, 4, 7, 5, 7]),
    ('7', [7, 1, 1, 1, 1]),
    ('8', [7, 5, 7, 5, 7]),
    ('9', [7, 5, 7, 1, 7]),
    ('.', [0, 0, 0, 0, 2]),
    ('m', [0, 7, 7, 5, 5]),
];

/// Pixels, 8-bit RGB, row 0 at the top.
struct Canvas {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

impl Canvas {
    fn new(width: usize, height: usize, colour: Colour) -> Self {
        Self { width, height, pixels: colour.repeat(width * height) }
    }

    fn fill(&mut self, x: usize, y: usize, width: usize, height: usize, colour: Colour) {
        let columns = x.min(self.width)..(x + width).min(self.width);
        for row in y.min(self.height)..(y + height).min(self.height) {
            for column in columns.clone() {
                let at = (row * self.width + column) * 3;
                self.pixels[at..at + 3].copy_from_slice(&colour);
            }
        }
    }

    /// Writes with the little face, two pixels a dot.
    fn write(&mut self, mut x: usize, y: usize, text: &str) {
        for letter in text.chars() {
            let Some((_, rows)) = GLYPHS.iter().find(|(glyph, _)| *glyph == letter) else { continue };
            for (row, bits) in rows.iter().enumerate() {
                for column in (0..3).filter(|column| bits & (4 >> column) != 0) {
                    self.fill(x + 2 * column, y + 2 * row, 2, 2, INK);
                }
            }
            x += 8;
        }
    }
}

/// The bytes of map.png.
pub fn encode(map: &Map) -> Result<Vec<u8>, png::EncodingError> {
    draw(map, |index| match map.occupancy[index] {
        -1 => UNKNOWN,
        occupancy => colour(occupancy, map.visibility[index]),
    })
    .png()
}

/// The bytes of explain.png: each cell with evidence in the colour of its verdict. `None` where the map has none.
pub fn encode_explained(map: &Map) -> Option<Result<Vec<u8>, png::EncodingError>> {
    let layer = map.layers.iter().find(|layer| layer.name == "verdict")?;
    let Values::U8(verdicts) = layer.spread(map.occupancy.len()) else { return None };
    let canvas = draw(map, |index| match (verdicts[index], map.occupancy[index]) {
        (0, -1) => UNKNOWN,
        (0, _) => FREE,
        (verdict, _) => {
            VERDICTS.iter().find(|(of, _)| *of as u8 == verdict).map_or(INK, |(_, colour)| *colour)
        }
    });
    Some(canvas.png())
}

impl Canvas {
    fn png(&self) -> Result<Vec<u8>, png::EncodingError> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.pixels)?;
        writer.finish()?;
        Ok(bytes)
    }
}
/// Columns and rows of the map that are shown.
struct View {
    columns: Range<usize>,
    rows: Range<usize>,
}

impl View {
    /// Where things are; all of a map without any.
    fn of(map: &Map) -> Self {
        let margin = (MARGIN / map.resolution).ceil() as usize;
        let occupied = || map.occupancy.iter().enumerate().filter(|(_, cell)| **cell == 100);
        let columns = most_of(occupied().map(|(index, _)| index % map.width).collect(), map.width, margin);
        let rows = most_of(occupied().map(|(index, _)| index / map.width).collect(), map.height, margin);
        Self { columns, rows }
    }
}

/// The range that holds most of the places, with a margin, within `0..end`.
fn most_of(mut places: Vec<usize>, end: usize, margin: usize) -> Range<usize> {
    if places.is_empty() {
        return 0..end;
    }
    places.sort_unstable();
    let stray = (places.len() as f64 * STRAY) as usize;
    let (first, last) = (places[stray], places[places.len() - 1 - stray]);
    first.saturating_sub(margin)..(last + 1 + margin).min(end)
}

fn draw(map: &Map, colour: impl Fn(usize) -> Colour) -> Canvas {
    let view = View::of(map);
    let longest = view.columns.len().max(view.rows.len()).max(1);
    let cell = (WANTED_PIXELS / longest).clamp(1, LARGEST_CELL);
    // A map of nothing still is a picture.
    let (width, height) = ((view.columns.len() * cell).max(64), (view.rows.len() * cell).max(1));
    let mut canvas = Canvas::new(width, height + STRIP, FREE);
    canvas.fill(0, 0, width, height, UNKNOWN);
    for (y, row) in view.rows.clone().rev().enumerate() {
        for (x, column) in view.columns.clone().enumerate() {
            canvas.fill(x * cell, y * cell, cell, cell, colour(row * map.width + column));
        }
    }
    draw_scale(&mut canvas, height, cell as f64 / map.resolution);
    canvas
}

fn colour(occupancy: i8, visibility: i8) -> Colour {
    if occupancy != 100 {
        return FREE;
    }
    let beyond = f64::from(visibility) - f64::from(SPECULAR_FROM);
    let blue = (beyond / f64::from(TRANSITION) + 0.5).clamp(0.0, 1.0);
    let mix = |from: u8, to: u8| (f64::from(from) + (f64::from(to) - f64::from(from)) * blue).round() as u8;
    [0, 1, 2].map(|part| mix(DIFFUSE[part], SPECULAR[part]))
}

/// A bar of the longest round length that takes at most a third of the picture.
fn draw_scale(canvas: &mut Canvas, top: usize, pixels_per_metre: f64) {
    const LENGTHS: [f64; 10] = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0];
    let room = canvas.width as f64 / 3.0;
    let fits = LENGTHS.iter().rev().find(|metres| **metres * pixels_per_metre <= room);
    let Some(metres) = fits else { return };
    let length = (metres * pixels_per_metre).round() as usize;
    canvas.fill(0, top, canvas.width, 1, INK);
    canvas.fill(8, top + 12, length, 2, INK);
    canvas.fill(8, top + 8, 2, 10, INK);
    canvas.fill(8 + length, top + 8, 2, 10, INK);
    canvas.write(length + 18, top + 8, &format!("{metres}m"));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::Layer;

    #[test]
    fn colours_stand_where_the_cells_are() {
        let map = Map {
            resolution: 0.1,
            origin: [0.0, 0.0],
            width: 2,
            height: 2,
            occupancy: vec![0, 100, -1, 100],
            visibility: vec![-1, 10, -1, 100],
            layers: Vec::new(),
        };
        let bytes = encode(&map).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(&bytes)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        assert_eq!((info.width, info.height), (64, 16 + STRIP as u32));
        let at = |x: usize, y: usize| &pixels[(y * 64 + x) * 3..][..3];
        assert_eq!(at(0, 15), FREE);
        assert_eq!(at(15, 15), DIFFUSE);
        assert_eq!(at(0, 0), UNKNOWN);
        assert_eq!(at(15, 0), SPECULAR);
        // 80 pixels a metre: a bar of 0.2 m is 16 pixels of the 21 that it may have.
        assert_eq!(at(8 + 16 - 1, 16 + 12), INK);
        assert_eq!(at(8 + 16 + 4, 16 + 12), FREE);
    }

    #[test]
    fn every_verdict_has_a_colour_of_its_own() {
        let map = Map {
            resolution: 0.1,
            origin: [0.0, 0.0],
            width: VERDICTS.len(),
            height: 1,
            occupancy: vec![0; VERDICTS.len()],
            visibility: vec![-1; VERDICTS.len()],
            layers: vec![Layer {
                name: "verdict",
                cells: (0..VERDICTS.len()).collect(),
                values: Values::U8(VERDICTS.iter().map(|(verdict, _)| *verdict as u8).collect()),
            }],
        };
        let bytes = encode_explained(&map).unwrap().unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(&bytes)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        for (number, (_, colour)) in VERDICTS.iter().enumerate() {
            assert_eq!(pixels[number * LARGEST_CELL * 3..][..3], *colour);
        }
        assert!(encode_explained(&Map { layers: Vec::new(), ..map }).is_none());
    }

    #[test]
    fn a_stray_return_does_not_make_the_picture_small() {
        let (width, height) = (2000, 100);
        let mut occupancy = vec![-1; width * height];
        for row in 20..60 {
            occupancy[row * width + 500..row * width + 550].fill(100);
        }
        occupancy[1999] = 100;
        let map = Map {
            resolution: 0.1,
            origin: [0.0, 0.0],
            width,
            height,
            visibility: occupancy.clone(),
            occupancy,
            layers: Vec::new(),
        };
        let view = View::of(&map);
        assert_eq!((view.columns, view.rows), (490..560, 10..70));
    }

    #[test]
    fn the_colour_turns_blue_where_a_cell_was_missed() {
        assert_eq!(colour(100, 0), DIFFUSE);
        assert_eq!(colour(100, 15), DIFFUSE);
        assert_eq!(colour(100, 35), SPECULAR);
        let [red, _, blue] = colour(100, SPECULAR_FROM);
        assert!(red < DIFFUSE[0] && blue > DIFFUSE[2]);
    }

    #[test]
    fn a_map_without_cells_is_a_picture_too() {
        let map = Map {
            resolution: 0.05,
            origin: [0.0, 0.0],
            width: 0,
            height: 0,
            occupancy: Vec::new(),
            visibility: Vec::new(),
            layers: Vec::new(),
        };
        assert!(png::Decoder::new(std::io::Cursor::new(encode(&map).unwrap())).read_info().is_ok());
    }
}
