//! `KEY:value;sum` lines, the body of VV, PP and II, kept verbatim and in order. Keys and sums can be `;`
//! as well, so lines are taken apart from their end.

use crate::number;

/// Lines of one reply in the device's order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Fields(Vec<(String, String)>);

/// A line whose sum is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct BadSum {
    pub want: u8,
    pub got: u8,
}

impl Fields {
    /// Fields of keys and values.
    pub fn new<K: Into<String>, V: Into<String>>(fields: impl IntoIterator<Item = (K, V)>) -> Fields {
        Fields(fields.into_iter().map(|(key, value)| (key.into(), value.into())).collect())
    }

    /// First value of this key.
    pub fn get(&self, key: &str) -> Option<&str> {
        self.iter().find(|(name, _)| *name == key).map(|(_, value)| value)
    }

    /// Key and value of every line.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &str)> {
        self.0.iter().map(|(key, value)| (key.as_str(), value.as_str()))
    }

    /// Adds one line (without LF). The `;` before the sum is not summed. Some UTM-30LX firmware leaves the
    /// text after `<-` out of the sum, so either is accepted.
    pub(crate) fn push_line(&mut self, line: &[u8]) -> Result<(), BadSum> {
        let (&got, rest) = line.split_last().ok_or(BadSum { want: b'0', got: 0 })?;
        let content = rest.strip_suffix(b";").unwrap_or(rest);
        let want = number::checksum(content);
        let short_sum = before_arrow(content).map(number::checksum);
        if got != want && short_sum != Some(got) {
            return Err(BadSum { want, got });
        }
        let text = String::from_utf8_lossy(content);
        let (key, value) = text.split_once(':').unwrap_or((&text, ""));
        self.0.push((key.to_owned(), value.to_owned()));
        Ok(())
    }

    /// Appends the lines with sums.
    pub(crate) fn emit(&self, out: &mut Vec<u8>) {
        for (key, value) in &self.0 {
            let from = out.len();
            out.extend_from_slice(key.as_bytes());
            out.push(b':');
            out.extend_from_slice(value.as_bytes());
            let sum = number::checksum(&out[from..]);
            out.extend_from_slice(&[b';', sum, b'\n']);
        }
    }
}

fn before_arrow(content: &[u8]) -> Option<&[u8]> {
    let at = content.windows(2).position(|pair| pair == b"<-")?;
    Some(&content[..at])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_and_sums_that_are_semicolons() {
        let mut fields = Fields::default();
        for line in ["VEND:Hokuyo Automatic Co., Ltd.;;", "TIME:j;o[;H", "PROT:SCIP 2.0;N", "AMIN:0;?"] {
            fields.push_line(line.as_bytes()).unwrap();
        }
        assert_eq!(fields.get("VEND"), Some("Hokuyo Automatic Co., Ltd."));
        assert_eq!(fields.get("TIME"), Some("j;o["));
        let mut out = Vec::new();
        fields.emit(&mut out);
        assert!(out.starts_with(b"VEND:Hokuyo Automatic Co., Ltd.;;\nTIME:j;o[;H\n"));
    }

    #[test]
    fn text_behind_an_arrow_may_be_left_out_of_the_sum() {
        let content = b"SCSP:Initial(2400[rpm])";
        let mut line = b"SCSP:Initial(2400[rpm])<-Default setting by user;".to_vec();
        line.push(number::checksum(content));
        let mut fields = Fields::default();
        fields.push_line(&line).unwrap();
        fields.push_line(b"SCSP:Initial(2400[rpm])<-Default setting by user;1").unwrap();
        assert_eq!(fields.push_line(b"AMIN:0;@"), Err(BadSum { want: b'?', got: b'@' }));
    }
}
