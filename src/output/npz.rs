//! map.npz: a zip of numpy arrays (NEP 1, format 1.0), lossless.
//!
//! The bytes depend on the arrays alone (no time of writing), so equal maps give equal files.

use std::io::{Cursor, Write};

use zip::write::{SimpleFileOptions, ZipWriter};
use zip::{CompressionMethod, DateTime};

use crate::map::{Map, Values};

/// The file's bytes: `occupancy` and `visibility` (int8, height x width, row 0 at the bottom), `resolution`
/// (float64, m), `origin` (float64, x and y of the lower left corner, m) and every layer by its name.
pub fn encode(map: &Map) -> zip::result::ZipResult<Vec<u8>> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let cells = format!("({}, {})", map.height, map.width);
    add(&mut zip, "resolution", "<f8", "()", &map.resolution.to_le_bytes())?;
    let origin: Vec<u8> = map.origin.iter().flat_map(|metres| metres.to_le_bytes()).collect();
    add(&mut zip, "origin", "<f8", "(2,)", &origin)?;
    add(&mut zip, "occupancy", "|i1", &cells, &bytes_of(&map.occupancy))?;
    add(&mut zip, "visibility", "|i1", &cells, &bytes_of(&map.visibility))?;
    for layer in &map.layers {
        let (dtype, data) = match layer.spread(map.occupancy.len()) {
            Values::U8(values) => ("|u1", values),
            Values::U16(values) => ("<u2", values.iter().flat_map(|value| value.to_le_bytes()).collect()),
            Values::F32(values) => ("<f4", values.iter().flat_map(|value| value.to_le_bytes()).collect()),
        };
        add(&mut zip, layer.name, dtype, &cells, &data)?;
    }
    Ok(zip.finish()?.into_inner())
}

fn bytes_of(values: &[i8]) -> Vec<u8> {
    values.iter().map(|value| value.cast_unsigned()).collect()
}

fn add(
    zip: &mut ZipWriter<Cursor<Vec<u8>>>,
    name: &str,
    dtype: &str,
    shape: &str,
    data: &[u8],
) -> zip::result::ZipResult<()> {
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Deflated)
        .last_modified_time(DateTime::default());
    zip.start_file(format!("{name}.npy"), options)?;
    zip.write_all(&header(dtype, shape))?;
    zip.write_all(data)?;
    Ok(())
}

/// The array's header, filled up with spaces so that the data begins at a multiple of 64 bytes.
fn header(dtype: &str, shape: &str) -> Vec<u8> {
    /// Magic, version and the length field.
    const BEFORE: usize = 10;
    let mut text = format!("{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}");
    let filled = (BEFORE + text.len() + 1).next_multiple_of(64) - BEFORE;
    while text.len() + 1 < filled {
        text.push(' ');
    }
    text.push('\n');
    let length = u16::try_from(text.len()).expect("a header of a few hundred bytes at most");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend_from_slice(&length.to_le_bytes());
    bytes.extend_from_slice(text.as_bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_begins_at_a_multiple_of_64_after_a_line_feed() {
        for shape in ["()", "(2,)", "(1000, 1000)", "(123456789, 123456789)"] {
            let header = header("<f4", shape);
            assert_eq!(header.len() % 64, 0, "{shape}");
            assert_eq!(header.last(), Some(&b'\n'));
            assert_eq!(usize::from(u16::from_le_bytes([header[8], header[9]])), header.len() - 10);
        }
        assert_eq!(
            &header("<f8", "(2,)")[10..],
            b"{'descr': '<f8', 'fortran_order': False, 'shape': (2,), }"
                .iter()
                .copied()
                .chain(std::iter::repeat_n(b' ', 60))
                .chain([b'\n'])
                .collect::<Vec<u8>>()
                .as_slice()
        );
    }
}
