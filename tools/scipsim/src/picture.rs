//! The truth as a picture: one pixel a cell, north up.

use crate::truth::{Label, TruthMap};

/// PNG of the part of the truth where anything was seen. Glass blue, diffuse black, motion orange, reflections
/// violet, removed things red, the robot's path light green, surfaces that were not seen grey.
pub fn truth_png(truth: &TruthMap) -> Result<Vec<u8>, png::EncodingError> {
    let [left, bottom, width, height] = truth.extent();
    let mut pixels = Vec::with_capacity(3 * width * height);
    for row in (bottom..bottom + height).rev() {
        for column in left..left + width {
            pixels.extend(colour(truth, row * truth.width + column));
        }
    }
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width.max(1) as u32, height.max(1) as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    if pixels.is_empty() {
        pixels = vec![255; 3];
    }
    writer.write_image_data(&pixels)?;
    writer.finish()?;
    Ok(bytes)
}

fn colour(truth: &TruthMap, cell: usize) -> [u8; 3] {
    match truth.labels[cell] {
        Label::Glass => [0, 90, 255],
        Label::Diffuse => [0, 0, 0],
        Label::Motion => [255, 150, 0],
        Label::Reflection => [190, 80, 220],
        Label::Removed => [220, 30, 30],
        Label::Other if truth.clearance[cell] == 0 => [150, 150, 150],
        Label::Other if truth.path[cell] => [200, 240, 200],
        Label::Other => [255, 255, 255],
    }
}

/// The truth as lines `x,y,label` (middle of the cell, m), of cells that have a label.
pub fn truth_csv(truth: &TruthMap) -> String {
    let mut text = String::from("x,y,label\n");
    for (cell, label) in truth.labels.iter().enumerate().filter(|(_, l)| **l != Label::Other) {
        let x = truth.origin[0] + ((cell % truth.width) as f64 + 0.5) * truth.resolution;
        let y = truth.origin[1] + ((cell / truth.width) as f64 + 0.5) * truth.resolution;
        text.push_str(&format!("{x:.3},{y:.3},{}\n", format!("{label:?}").to_lowercase()));
    }
    text
}
