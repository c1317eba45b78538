//! Axes with ticks and labels, curves, and lines of text on a canvas. As much as the paper's figures need.

use embedded_graphics::{
    mono_font::{
        MonoFont, MonoTextStyle,
        iso_8859_1::{FONT_9X18, FONT_9X18_BOLD},
    },
    pixelcolor::Rgb888,
    prelude::*,
    primitives::{Circle, Line, Polyline, PrimitiveStyle, Rectangle},
    text::{Alignment, Baseline, Text, TextStyleBuilder},
};

use crate::canvas::{Canvas, Colour};

/// Height of a line of text (pixels).
pub const LINE: i32 = 22;
/// Width of a letter (pixels).
pub const LETTER: i32 = 9;

/// Room around the axes: left, top, right, bottom (pixels).
const MARGINS: [i32; 4] = [80, 74, 24, 62];
/// Length of a tick (pixels).
const TICK: i32 = 6;

/// One axis.
#[derive(Clone, Copy, Debug)]
pub struct Axis {
    /// Quantity and unit.
    pub label: &'static str,
    /// Lowest and highest value.
    pub range: [f64; 2],
    /// From tick to tick.
    pub step: f64,
}

/// How the points of a series are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// Joined to a line.
    Line,
    /// Each by itself.
    Dots,
}

/// Points of one kind.
#[derive(Clone, Debug)]
pub struct Series {
    /// For the key; none where empty.
    pub name: String,
    /// Colour.
    pub colour: Colour,
    /// How it is drawn.
    pub mark: Mark,
    /// x and y, in the order of x.
    pub points: Vec<[f64; 2]>,
}

/// A diagram.
#[derive(Clone, Debug)]
pub struct Plot {
    /// Above it.
    pub title: String,
    /// To the right.
    pub x: Axis,
    /// Upwards.
    pub y: Axis,
    /// What is in it.
    pub series: Vec<Series>,
}

/// As embedded-graphics has it.
pub fn rgb([r, g, b]: Colour) -> Rgb888 {
    Rgb888::new(r, g, b)
}

/// Writes a line of text, its upper edge at `y`, to the right of `x`, around it or to its left.
pub fn write(canvas: &mut Canvas, text: &str, x: i32, y: i32, colour: Colour, alignment: Alignment) {
    write_in(&FONT_9X18, canvas, text, x, y, colour, alignment);
}

/// The same in bold letters.
pub fn write_bold(canvas: &mut Canvas, text: &str, x: i32, y: i32, alignment: Alignment) {
    write_in(&FONT_9X18_BOLD, canvas, text, x, y, [0; 3], alignment);
}

fn write_in(
    font: &MonoFont,
    canvas: &mut Canvas,
    text: &str,
    x: i32,
    y: i32,
    colour: Colour,
    alignment: Alignment,
) {
    let style = TextStyleBuilder::new().alignment(alignment).baseline(Baseline::Top).build();
    let letters = MonoTextStyle::new(font, rgb(colour));
    let Ok(_) = Text::with_text_style(text, Point::new(x, y), letters, style).draw(canvas);
}

/// Draws a straight line.
pub fn line(canvas: &mut Canvas, from: [i32; 2], to: [i32; 2], colour: Colour, width: u32) {
    let style = PrimitiveStyle::with_stroke(rgb(colour), width);
    let Ok(()) = Line::new(from.into(), to.into()).into_styled(style).draw(canvas);
}

/// Fills a rectangle.
pub fn fill(canvas: &mut Canvas, at: [i32; 2], size: [u32; 2], colour: Colour) {
    let rectangle = Rectangle::new(at.into(), Size::new(size[0], size[1]));
    let Ok(()) = rectangle.into_styled(PrimitiveStyle::with_fill(rgb(colour))).draw(canvas);
}

impl Plot {
    /// The picture of it.
    pub fn draw(&self, width: usize, height: usize) -> Canvas {
        let mut canvas = Canvas::new(width, height);
        let frame = Frame {
            plot: self,
            left: MARGINS[0],
            top: MARGINS[1],
            right: width as i32 - MARGINS[2],
            bottom: height as i32 - MARGINS[3],
        };
        frame.grid(&mut canvas);
        for series in &self.series {
            frame.series(&mut canvas, series);
        }
        frame.outline(&mut canvas);
        frame.key(&mut canvas);
        canvas
    }
}

struct Frame<'a> {
    plot: &'a Plot,
    left: i32,
    top: i32,
    right: i32,
    bottom: i32,
}

impl Frame<'_> {
    fn place(&self, [x, y]: [f64; 2]) -> Point {
        let part = |axis: &Axis, value: f64| (value - axis.range[0]) / (axis.range[1] - axis.range[0]);
        let across = f64::from(self.right - self.left) * part(&self.plot.x, x);
        let up = f64::from(self.bottom - self.top) * part(&self.plot.y, y);
        Point::new(self.left + across.round() as i32, self.bottom - up.round() as i32)
    }

    fn grid(&self, canvas: &mut Canvas) {
        const PALE: Colour = [228; 3];
        for value in ticks(&self.plot.x) {
            let x = self.place([value, self.plot.y.range[0]]).x;
            line(canvas, [x, self.top], [x, self.bottom], PALE, 1);
            line(canvas, [x, self.bottom], [x, self.bottom + TICK], [0; 3], 1);
            write(
                canvas,
                &number(value, self.plot.x.step),
                x,
                self.bottom + TICK + 2,
                [0; 3],
                Alignment::Center,
            );
        }
        for value in ticks(&self.plot.y) {
            let y = self.place([self.plot.x.range[0], value]).y;
            line(canvas, [self.left, y], [self.right, y], PALE, 1);
            line(canvas, [self.left - TICK, y], [self.left, y], [0; 3], 1);
            let text = number(value, self.plot.y.step);
            write(canvas, &text, self.left - TICK - 4, y - LINE / 2 + 2, [0; 3], Alignment::Right);
        }
        let middle = (self.left + self.right) / 2;
        write_bold(canvas, &self.plot.title, middle, 6, Alignment::Center);
        write(canvas, self.plot.y.label, 8, self.top - LINE - 2, [0; 3], Alignment::Left);
        write(canvas, self.plot.x.label, middle, self.bottom + TICK + 6 + LINE, [0; 3], Alignment::Center);
    }

    fn outline(&self, canvas: &mut Canvas) {
        let corners = [
            [self.left, self.top],
            [self.right, self.top],
            [self.right, self.bottom],
            [self.left, self.bottom],
            [self.left, self.top],
        ];
        for ends in corners.windows(2) {
            line(canvas, ends[0], ends[1], [0; 3], 1);
        }
    }

    fn series(&self, canvas: &mut Canvas, series: &Series) {
        let inside = |[x, y]: &[f64; 2]| {
            let within = |axis: &Axis, value: f64| (axis.range[0]..=axis.range[1]).contains(&value);
            within(&self.plot.x, *x) && within(&self.plot.y, *y)
        };
        let points: Vec<Point> = series.points.iter().filter(|p| inside(p)).map(|p| self.place(*p)).collect();
        match series.mark {
            Mark::Line => {
                let style = PrimitiveStyle::with_stroke(rgb(series.colour), 2);
                let Ok(()) = Polyline::new(&points).into_styled(style).draw(canvas);
            }
            Mark::Dots => {
                let style = PrimitiveStyle::with_fill(rgb(series.colour));
                for point in points {
                    let Ok(()) = Circle::with_center(point, 3).into_styled(style).draw(canvas);
                }
            }
        }
    }

    /// Names of the series, side by side above the axes, to the right.
    fn key(&self, canvas: &mut Canvas) {
        let mut x = self.right;
        for series in self.plot.series.iter().rev().filter(|series| !series.name.is_empty()) {
            x -= series.name.chars().count() as i32 * LETTER;
            write(canvas, &series.name, x, self.top - LINE - 2, [0; 3], Alignment::Left);
            fill(canvas, [x - 16, self.top - LINE + 2], [11, 11], series.colour);
            x -= 36;
        }
    }
}

/// Values of the ticks of an axis.
fn ticks(axis: &Axis) -> Vec<f64> {
    let first = (axis.range[0] / axis.step).ceil() as i64;
    let last = (axis.range[1] / axis.step + 1e-9).floor() as i64;
    (first..=last).map(|number| number as f64 * axis.step).collect()
}

/// A tick's number with as many digits as its step needs.
fn number(value: f64, step: f64) -> String {
    let digits = (-step.log10().floor()).max(0.0) as usize;
    format!("{value:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_lie_on_whole_steps() {
        let axis = Axis { label: "", range: [-25.0, 40.0], step: 20.0 };
        assert_eq!(ticks(&axis), [-20.0, 0.0, 20.0, 40.0]);
        let axis = Axis { label: "", range: [0.0, 1.0], step: 0.25 };
        assert_eq!(ticks(&axis).len(), 5);
        assert_eq!(number(0.2, 0.2), "0.2");
        assert_eq!(number(4000.0, 2000.0), "4000");
    }

    #[test]
    fn points_fall_where_the_axes_say() {
        let axis = Axis { label: "x", range: [0.0, 10.0], step: 5.0 };
        let plot = Plot { title: "t".into(), x: axis, y: axis, series: vec![] };
        let frame = Frame { plot: &plot, left: 100, top: 50, right: 200, bottom: 150 };
        assert_eq!(frame.place([0.0, 0.0]), Point::new(100, 150));
        assert_eq!(frame.place([10.0, 5.0]), Point::new(200, 100));
    }
}
