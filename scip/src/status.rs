//! The two characters that tell how a request went. Meanings differ between models and commands
//! (C-42-03320B, and the SCIP 2.2 additions), so the raw code is always kept and shown beside the text.

use crate::number;

/// Status of a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Status {
    /// `00`: done, or a stream was accepted.
    Done,
    /// `99`: one scan of a stream follows.
    ScanFollows,
    /// `01`..`09`: refused or already so, by the command's own list.
    Refused(u8),
    /// `0A`..`0K`: a general error, named by its letter.
    General(u8),
    /// `0L`: abnormal; only a reboot (RB) helps.
    Abnormal,
    /// `0M`: unstable, still starting.
    Unstable,
    /// `10`: laser off, or denied in this state.
    Denied,
    /// `21`..`49`: the stream is held to verify an error; `98` may follow.
    Verifying(u8),
    /// `50`..`97`: hardware fault.
    Fault(u8),
    /// `98`: the stream goes on after an error.
    Resumed,
    /// Any other two characters, kept.
    Other([u8; 2]),
    /// One character without a sum: the device still speaks SCIP 1.1 (`0` is success).
    Scip1(u8),
}

impl Status {
    /// Status of a code of two characters.
    pub fn from_code(code: [u8; 2]) -> Status {
        let number = match code {
            [tens @ b'0'..=b'9', ones @ b'0'..=b'9'] => Some((tens - b'0') * 10 + (ones - b'0')),
            _ => None,
        };
        match (number, code) {
            (Some(0), _) => Status::Done,
            (Some(n @ 1..=9), _) => Status::Refused(n),
            (Some(10), _) => Status::Denied,
            (Some(n @ 21..=49), _) => Status::Verifying(n),
            (Some(n @ 50..=97), _) => Status::Fault(n),
            (Some(98), _) => Status::Resumed,
            (Some(99), _) => Status::ScanFollows,
            (None, [b'0', letter @ b'A'..=b'K']) => Status::General(letter),
            (None, [b'0', b'L']) => Status::Abnormal,
            (None, [b'0', b'M']) => Status::Unstable,
            _ => Status::Other(code),
        }
    }

    /// The characters on the wire without the sum: two, or one for SCIP 1.1.
    pub fn code(self) -> ([u8; 2], usize) {
        let digits = |n: u8| [b'0' + n / 10, b'0' + n % 10];
        let code = match self {
            Status::Done => digits(0),
            Status::ScanFollows => digits(99),
            Status::Refused(n) | Status::Verifying(n) | Status::Fault(n) => digits(n % 100),
            Status::General(letter) => [b'0', letter],
            Status::Abnormal => *b"0L",
            Status::Unstable => *b"0M",
            Status::Denied => digits(10),
            Status::Resumed => digits(98),
            Status::Other(code) => code,
            Status::Scip1(c) => return ([c, 0], 1),
        };
        (code, 2)
    }

    /// Status of a status line (without its LF): two characters and their sum, or the single one of SCIP 1.1.
    pub fn parse(line: &[u8]) -> Option<Status> {
        match *line {
            [a, b, sum] if number::checksum(&[a, b]) == sum => Some(Status::from_code([a, b])),
            [c @ 0x21..=0x7e] => Some(Status::Scip1(c)),
            _ => None,
        }
    }

    /// Appends the status line with sum and LF.
    pub fn emit(self, out: &mut Vec<u8>) {
        let (code, len) = self.code();
        out.extend_from_slice(&code[..len]);
        if len == 2 {
            out.push(number::checksum(&code));
        }
        out.push(b'\n');
    }

    /// What the code usually means. SCIP 2.0 and 2.2 disagree on some letters; both readings are given.
    pub fn meaning(self) -> &'static str {
        match self {
            Status::Done => "done",
            Status::ScanFollows => "scan follows",
            Status::Refused(_) => "refused, or already so, by this command's own list",
            Status::General(b'A') => "cannot build a reply",
            Status::General(b'B') => "buffer shortage, or repeated while pending",
            Status::General(b'C') => "too few parameters, or too short",
            Status::General(b'D') => "undefined, or too long",
            Status::General(b'E') => "not defined",
            Status::General(b'F') => "too few parameters, or not supported",
            Status::General(b'G') => "string longer than 16",
            Status::General(b'H') => "bad character in the string, or too short",
            Status::General(b'I') => "firmware is being updated",
            Status::General(_) => "general error",
            Status::Abnormal => "abnormal, needs a reboot",
            Status::Unstable => "unstable, still starting",
            Status::Denied => "laser off, or denied in this state",
            Status::Verifying(_) => "stopped to verify an error",
            Status::Fault(_) => "hardware fault",
            Status::Resumed => "resumed after an error",
            Status::Other(_) => "unknown",
            Status::Scip1(b'0') => "done (SCIP 1.1)",
            Status::Scip1(_) => "refused (SCIP 1.1)",
        }
    }
}

impl std::fmt::Display for Status {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (code, len) = self.code();
        write!(f, "{} ({})", code[..len].escape_ascii(), self.meaning())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_both_ways() {
        for (line, status) in [
            (&b"00P"[..], Status::Done),
            (b"99b", Status::ScanFollows),
            (b"02R", Status::Refused(2)),
            (b"04T", Status::Refused(4)),
            (b"10Q", Status::Denied),
            (b"0Ee", Status::General(b'E')),
            (b"0", Status::Scip1(b'0')),
        ] {
            assert_eq!(Status::parse(line), Some(status));
            let mut out = Vec::new();
            status.emit(&mut out);
            assert_eq!(&out[..out.len() - 1], line);
        }
        assert_eq!(Status::parse(b"00Q"), None);
    }

    #[test]
    fn every_code_is_kept() {
        for a in 0..=255 {
            for b in 0..=255 {
                assert_eq!(Status::from_code([a, b]).code(), ([a, b], 2));
            }
        }
        assert_eq!(Status::from_code(*b"Z?"), Status::Other(*b"Z?"));
        assert_eq!(Status::from_code(*b"15"), Status::Other(*b"15"));
    }
}
