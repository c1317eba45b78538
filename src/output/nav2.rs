//! map.pgm and map.yaml as nav2's map server reads them (mode trinary).
//!
//! Row 0 of the picture is the top; the origin is the pose of the lower left corner of the lower left cell.

use crate::map::Map;

/// Grey values of an occupied, a free and an unknown cell, as nav2's map saver writes them.
const OCCUPIED: u8 = 0;
const FREE: u8 = 254;
const UNKNOWN: u8 = 205;

/// Binary PGM, 8 bits.
pub fn pgm(map: &Map) -> Vec<u8> {
    let mut bytes = format!("P5\n{} {}\n255\n", map.width, map.height).into_bytes();
    for row in map.occupancy.chunks(map.width.max(1)).rev() {
        bytes.extend(row.iter().map(|&cell| match cell {
            0 => FREE,
            100 => OCCUPIED,
            _ => UNKNOWN,
        }));
    }
    bytes
}

/// The picture's description. `free_thresh` lies below (255 - 205) / 255 = 0.19608: with nav2's own default of
/// 0.25 the unknown cells would read as free.
pub fn yaml(map: &Map, image: &str) -> String {
    let [x, y] = map.origin;
    format!(
        "image: {image}\nmode: trinary\nresolution: {:.9}\norigin: [{x:.9}, {y:.9}, 0.000000000]\n\
         negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
        map.resolution
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn top_row_comes_first_and_unknown_is_not_free_for_nav2() {
        let map = Map {
            resolution: 0.05,
            origin: [-1.0, 0.123456789],
            width: 2,
            height: 2,
            occupancy: vec![0, 100, -1, 0],
            visibility: vec![-1, 10, -1, -1],
            layers: Vec::new(),
        };
        assert_eq!(pgm(&map), b"P5\n2 2\n255\n\xcd\xfe\xfe\x00");
        let yaml = yaml(&map, "map.pgm");
        assert!(
            yaml.contains("resolution: 0.050000000\norigin: [-1.000000000, 0.123456789, 0.000000000]"),
            "{yaml}"
        );
        // nav2: occupancy = (255 - grey) / 255; free below free_thresh, occupied above occupied_thresh.
        let unknown = f64::from(255 - UNKNOWN) / 255.0;
        assert!(unknown > 0.196 && unknown < 0.65);
    }
}
