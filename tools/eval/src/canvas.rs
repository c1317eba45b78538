//! A picture in memory: what embedded-graphics draws on, and what becomes a PNG.

use std::convert::Infallible;

use anyhow::Result;
use embedded_graphics::{pixelcolor::Rgb888, prelude::*};

/// A colour's red, green and blue.
pub type Colour = [u8; 3];

/// A picture, row by row from the top.
#[derive(Clone, Debug)]
pub struct Canvas {
    width: usize,
    pixels: Vec<Colour>,
}

impl Canvas {
    /// All white. Empty pictures cannot be written, so there is at least one pixel.
    pub fn new(width: usize, height: usize) -> Canvas {
        let (width, height) = (width.max(1), height.max(1));
        Canvas { width, pixels: vec![[255; 3]; width * height] }
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.pixels.len() / self.width
    }

    /// Colours a pixel; one outside of the picture is left out.
    pub fn set(&mut self, x: i64, y: i64, colour: Colour) {
        if (0..self.width as i64).contains(&x) && (0..self.height() as i64).contains(&y) {
            self.pixels[y as usize * self.width + x as usize] = colour;
        }
    }

    /// Colour of a pixel.
    #[cfg(test)]
    pub fn at(&self, x: usize, y: usize) -> Colour {
        self.pixels[y * self.width + x]
    }

    /// Each pixel as a square of `times` x `times`.
    pub fn enlarged(&self, times: usize) -> Canvas {
        let mut large = Canvas::new(self.width * times, self.height() * times);
        let width = large.width;
        for (i, pixel) in large.pixels.iter_mut().enumerate() {
            *pixel = self.pixels[i / width / times * self.width + i % width / times];
        }
        large
    }

    /// Copies another picture into this one, its upper left corner to (x, y).
    pub fn paste(&mut self, other: &Canvas, x: usize, y: usize) {
        for (i, &colour) in other.pixels.iter().enumerate() {
            self.set((x + i % other.width) as i64, (y + i / other.width) as i64, colour);
        }
    }

    /// The picture as PNG.
    pub fn png(&self) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width as u32, self.height() as u32);
        encoder.set_color(png::ColorType::Rgb);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(self.pixels.as_flattened())?;
        writer.finish()?;
        Ok(bytes)
    }
}

impl OriginDimensions for Canvas {
    fn size(&self) -> Size {
        Size::new(self.width as u32, self.height() as u32)
    }
}

impl DrawTarget for Canvas {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(&mut self, pixels: I) -> Result<(), Infallible> {
        for Pixel(at, colour) in pixels {
            self.set(at.x.into(), at.y.into(), [colour.r(), colour.g(), colour.b()]);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_pasted_enlarged_and_clipped() {
        let mut small = Canvas::new(2, 1);
        small.set(1, 0, [1, 2, 3]);
        small.set(2, 0, [9; 3]);
        let mut large = Canvas::new(3, 2);
        large.paste(&small.enlarged(2), 0, 1);
        assert_eq!(large.pixels, [[255; 3], [255; 3], [255; 3], [255; 3], [255; 3], [1, 2, 3]]);
        assert_eq!(&large.png().unwrap()[1..4], b"PNG");
    }
}
