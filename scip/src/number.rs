//! The numbers and sums of SCIP: 6 bits a character, offset by 0x30 (SCIP 2.0, C-42-03320B).

/// Sum of a line: the low 6 bits of the sum of its bytes, plus 0x30.
pub fn checksum(line: &[u8]) -> u8 {
    (line.iter().fold(0u8, |sum, &byte| sum.wrapping_add(byte)) & 0x3f) + 0x30
}

/// Appends `value` as `chars` characters, most significant first; bits beyond `6 * chars` are cut off.
pub fn encode(value: u32, chars: usize, out: &mut Vec<u8>) {
    for place in (0..chars).rev() {
        out.push(((value >> (6 * place)) & 0x3f) as u8 + 0x30);
    }
}

/// Value of `chars` (at most 5 of them), or `None` where one lies outside the alphabet 0x30..=0x6F.
pub fn decode(chars: &[u8]) -> Option<u32> {
    debug_assert!(chars.len() <= 5);
    chars.iter().try_fold(0u32, |value, &c| match c {
        0x30..=0x6f => Some(value << 6 | u32::from(c - 0x30)),
        _ => None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn examples_of_the_specification() {
        for (chars, value) in [("CB", 1234), ("1Dh", 5432), ("m2@0", 16_000_000)] {
            assert_eq!(decode(chars.as_bytes()), Some(value));
            let mut out = Vec::new();
            encode(value, chars.len(), &mut out);
            assert_eq!(out, chars.as_bytes());
        }
        for (line, sum) in [("Hokuyo", b'o'), ("00", b'P'), ("99", b'b'), ("10", b'Q'), ("0E", b'e')] {
            assert_eq!(checksum(line.as_bytes()), sum);
        }
    }

    #[test]
    fn characters_outside_the_alphabet_are_no_number() {
        assert_eq!(decode(b"0p"), None);
        assert_eq!(decode(b"/0"), None);
    }
}
