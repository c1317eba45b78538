//! Requests as a device takes them apart: tolerant of line ends, strict about what is in a line.
//! Written apart from the crate `scip` on purpose, so that the two check each other.

use crate::simulation::BEAMS;

/// The longest line a device takes in; what is longer is refused (`0D`).
const LONGEST: usize = 80;
/// The longest user string.
const LONGEST_STRING: usize = 16;

/// Collects bytes into lines. LF, CR and both end a line; empty lines are silent.
#[derive(Clone, Debug, Default)]
pub struct Lines {
    line: Vec<u8>,
    too_long: bool,
}

impl Lines {
    /// Takes a byte; gives a line when it ends one.
    pub fn push(&mut self, byte: u8) -> Option<Result<Vec<u8>, Vec<u8>>> {
        if byte != b'\n' && byte != b'\r' {
            if self.line.len() < LONGEST {
                self.line.push(byte);
            } else {
                self.too_long = true;
            }
            return None;
        }
        let line = std::mem::take(&mut self.line);
        let too_long = std::mem::take(&mut self.too_long);
        match (line.is_empty(), too_long) {
            (true, _) => None,
            (_, true) => Some(Err(line)),
            _ => Some(Ok(line)),
        }
    }

    /// Forgets a half line.
    pub fn clear(&mut self) {
        *self = Lines::default();
    }
}

/// What a line asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    /// VV.
    Version,
    /// PP.
    Parameters,
    /// II.
    Information,
    /// BM.
    LaserOn,
    /// QT.
    Quit,
    /// RS, and RT.
    Reset,
    /// RB.
    Reboot,
    /// TM with its control code.
    Time(u8),
    /// SS with the bit rate.
    BitRate,
    /// CR with the motor speed.
    MotorSpeed,
    /// HS 0 or 1.
    Sensitivity,
    /// %ST.
    State,
    /// %SL.
    Sleep,
    /// SCIP2.0.
    Scip2,
    /// One of the scan commands.
    Scan(ScanRequest),
}

/// A scan command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScanRequest {
    /// Stream (M, N) or single scan (G, H).
    pub stream: bool,
    /// Multi-echo (N, H).
    pub multi_echo: bool,
    /// With intensities (E).
    pub intensity: bool,
    /// Characters of a distance: 3, or 2 for MS and GS.
    pub distance_chars: usize,
    /// First step.
    pub start: usize,
    /// Last step.
    pub end: usize,
    /// Steps in a group, at least 1.
    pub cluster: usize,
    /// Scans left out between two sent.
    pub skip: u64,
    /// Scans wanted; 0 endless.
    pub count: u32,
}

/// Status with which a line is refused.
pub type Refusal = &'static [u8; 2];

/// Takes a line apart.
pub fn parse(line: &[u8]) -> Result<Request, Refusal> {
    let (body, string) = match line.iter().position(|&b| b == b';') {
        Some(at) => (&line[..at], Some(&line[at + 1..])),
        None => (line, None),
    };
    if let Some(string) = string {
        if string.len() > LONGEST_STRING {
            return Err(b"0G");
        }
        let is_good = |b: &u8| b.is_ascii_alphanumeric() || b" ._+@".contains(b);
        if !string.iter().all(is_good) {
            return Err(b"0H");
        }
    }
    if body == b"SCIP2.0" {
        return Ok(Request::Scip2);
    }
    let name = if body.first() == Some(&b'%') { 3 } else { 2 };
    if body.len() < name {
        return Err(b"0E");
    }
    let (command, parameters) = body.split_at(name);
    let plain = |request: Request| if parameters.is_empty() { Ok(request) } else { Err(b"0D") };
    match command {
        b"VV" => plain(Request::Version),
        b"PP" => plain(Request::Parameters),
        b"II" => plain(Request::Information),
        b"BM" => plain(Request::LaserOn),
        b"QT" => plain(Request::Quit),
        b"RS" | b"RT" => plain(Request::Reset),
        b"RB" => plain(Request::Reboot),
        b"%ST" => plain(Request::State),
        b"%SL" => plain(Request::Sleep),
        b"TM" => match parameters {
            [] => Err(b"0C"),
            [code] => Ok(Request::Time(*code)),
            _ => Err(b"0D"),
        },
        b"SS" => of_length(parameters, 6).map(|()| Request::BitRate),
        b"CR" => of_length(parameters, 2).map(|()| Request::MotorSpeed),
        b"HS" => of_length(parameters, 1).map(|()| Request::Sensitivity),
        [b'M' | b'N' | b'G' | b'H', b'D' | b'E' | b'S']
            if command[1] != b'S' || b"MG".contains(&command[0]) =>
        {
            parse_scan(command[0], command[1], parameters).map(Request::Scan)
        }
        _ => Err(b"0E"),
    }
}

fn of_length(parameters: &[u8], length: usize) -> Result<(), Refusal> {
    match parameters.len().cmp(&length) {
        std::cmp::Ordering::Less => Err(b"0C"),
        std::cmp::Ordering::Equal => Ok(()),
        std::cmp::Ordering::Greater => Err(b"0D"),
    }
}

fn parse_scan(kind: u8, data: u8, parameters: &[u8]) -> Result<ScanRequest, Refusal> {
    let stream = matches!(kind, b'M' | b'N');
    of_length(parameters, if stream { 13 } else { 10 })?;
    let start = digits(&parameters[0..4]).ok_or(b"01")?;
    let end = digits(&parameters[4..8]).ok_or(b"02")?;
    let cluster = digits(&parameters[8..10]).ok_or(b"03")?;
    if end >= BEAMS {
        return Err(b"04");
    }
    if end < start {
        return Err(b"05");
    }
    let (skip, count) = if stream {
        (digits(&parameters[10..11]).ok_or(b"06")?, digits(&parameters[11..13]).ok_or(b"07")?)
    } else {
        (0, 1)
    };
    Ok(ScanRequest {
        stream,
        multi_echo: matches!(kind, b'N' | b'H'),
        intensity: data == b'E',
        distance_chars: if data == b'S' { 2 } else { 3 },
        start,
        end,
        cluster: cluster.max(1),
        skip: skip as u64,
        count: count as u32,
    })
}

fn digits(text: &[u8]) -> Option<usize> {
    text.iter().try_fold(0, |value, &b| b.is_ascii_digit().then(|| value * 10 + usize::from(b - b'0')))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_end_with_lf_cr_or_both_and_may_come_in_pieces() {
        let mut lines = Lines::default();
        let got: Vec<_> = b"\nVV\r\nPP\rQ".iter().chain(b"T\n\n").filter_map(|&b| lines.push(b)).collect();
        assert_eq!(got, [Ok(b"VV".to_vec()), Ok(b"PP".to_vec()), Ok(b"QT".to_vec())]);
        let long: Vec<_> = [b'x'; 500].iter().chain(b"\n").filter_map(|&b| lines.push(b)).collect();
        assert_eq!(long, [Err(vec![b'x'; LONGEST])]);
    }

    #[test]
    fn refusals() {
        let table: [(&[u8], Refusal); 14] = [
            (b"ZZ", b"0E"),
            (b"V", b"0E"),
            (b"ME00", b"0C"),
            (b"ME00001080010000", b"0D"),
            (b"MEx000108001000", b"01"),
            (b"ME0000x08001000", b"02"),
            (b"ME00001080x1000", b"03"),
            (b"ME0000108101000", b"04"),
            (b"ME0010000501000", b"05"),
            (b"ME000010800000x", b"07"),
            (b"ME0000108001x00", b"06"),
            (b"QT;12345678901234567", b"0G"),
            (b"QT;a-b", b"0H"),
            (b"VVx", b"0D"),
        ];
        for (line, status) in table {
            assert_eq!(parse(line), Err(status), "{}", String::from_utf8_lossy(line));
        }
        assert_eq!(parse(b"TM1;ab @"), Ok(Request::Time(b'1')));
        assert!(matches!(parse(b"HE0000108000"), Ok(Request::Scan(r)) if r.cluster == 1 && r.multi_echo));
    }
}
