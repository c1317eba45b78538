//! map.png: the map for people to look at. Programs read map.pgm or map.npz.
//!
//! White is free, grey unknown; what is occupied is orange where it is seen from all around (diffuse) and blue
//! where it is seen from a narrow view only (glass, mirrors, metal), or was seen once and from one side. A
//! scale bar is drawn below.

use crate::map::Map;

type Colour = [u8; 3];
const FREE: Colour = [255, 255, 255];
const UNKNOWN: Colour = [178, 178, 178];
const DIFFUSE: Colour = [190, 80, 0];
const SPECULAR: Colour = [0, 70, 255];
const INK: Colour = [0, 0, 0];

/// `Map::visibility` from which a cell is drawn blue.
pub const SPECULAR_FROM: i8 = 80;

/// Small maps are drawn larger until their longer side has about this many pixels.
const WANTED_PIXELS: usize = 900;
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

/// The file's bytes.
pub fn encode(map: &Map) -> Result<Vec<u8>, png::EncodingError> {
    let canvas = draw(map);
    let mut bytes = Vec::new();
    let (width, height) = (canvas.width as u32, canvas.height as u32);
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&canvas.pixels)?;
    writer.finish()?;
    Ok(bytes)
}

fn draw(map: &Map) -> Canvas {
    let cell = pixels_per_cell(map);
    // A map of nothing still is a picture.
    let (width, height) = ((map.width * cell).max(64), (map.height * cell).max(1));
    let mut canvas = Canvas::new(width, height + STRIP, FREE);
    canvas.fill(0, 0, width, height, UNKNOWN);
    for (index, (&occupancy, &visibility)) in map.occupancy.iter().zip(&map.visibility).enumerate() {
        let (column, row) = (index % map.width, map.height - 1 - index / map.width);
        if occupancy >= 0 {
            canvas.fill(column * cell, row * cell, cell, cell, colour(occupancy, visibility));
        }
    }
    draw_scale(&mut canvas, height, cell as f64 / map.resolution);
    canvas
}

fn pixels_per_cell(map: &Map) -> usize {
    (WANTED_PIXELS / map.width.max(map.height).max(1)).clamp(1, LARGEST_CELL)
}

fn colour(occupancy: i8, visibility: i8) -> Colour {
    match occupancy {
        100 if visibility >= SPECULAR_FROM => SPECULAR,
        100 => DIFFUSE,
        _ => FREE,
    }
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
