//! Requests from the host, as checked values, parsed from and emitted to the wire. A reply echoes its
//! request, so the decoder uses the same parser.

use std::fmt;

/// Longest string that a request may carry behind `;` (C-42-03320B).
pub const MAX_TEXT: usize = 16;
/// Steps are four digits on the wire.
pub const MAX_STEP: u16 = 9999;
/// The cluster count is two digits on the wire.
pub const MAX_CLUSTER: u8 = 99;
/// The interval between scans is one digit on the wire.
pub const MAX_SKIP: u8 = 9;
/// The number of scans is two digits on the wire.
pub const MAX_COUNT: u8 = 99;

/// Why bytes or values are no request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RequestError {
    /// No such command.
    #[error("no such command")]
    UnknownCommand,
    /// A known command with parameters of the wrong length, or not digits.
    #[error("{command} takes {want} digits as parameters")]
    Parameters {
        /// Name of the command.
        command: &'static str,
        /// How many digits it takes.
        want: usize,
    },
    /// The string behind `;` is longer than 16.
    #[error("the string has {len} characters, at most {MAX_TEXT} are allowed")]
    TextTooLong {
        /// Its length.
        len: usize,
    },
    /// A character that the string may not hold.
    #[error("the string holds byte 0x{byte:02x}; letters, digits, space and . _ + @ are allowed")]
    TextCharacter {
        /// The byte.
        byte: u8,
    },
    /// A value that does not fit on the wire.
    #[error("{what} is {value}, at most {max} fits on the wire")]
    TooLarge {
        /// Which value.
        what: &'static str,
        /// What it is.
        value: u32,
        /// The largest allowed.
        max: u32,
    },
    /// The first step lies behind the last.
    #[error("the first step {start} lies behind the last {end}")]
    EmptyWindow {
        /// First step.
        start: u16,
        /// Last step.
        end: u16,
    },
}

/// String that the device echoes: at most 16 of letters, digits, space, `.`, `_`, `+`, `@`.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Text {
    len: u8,
    bytes: [u8; MAX_TEXT],
}

impl Text {
    /// Checks the characters.
    pub fn new(text: &[u8]) -> Result<Text, RequestError> {
        let allowed = |b: &u8| b.is_ascii_alphanumeric() || b" ._+@".contains(b);
        if text.len() > MAX_TEXT {
            return Err(RequestError::TextTooLong { len: text.len() });
        }
        if let Some(&byte) = text.iter().find(|b| !allowed(b)) {
            return Err(RequestError::TextCharacter { byte });
        }
        let mut bytes = [0; MAX_TEXT];
        bytes[..text.len()].copy_from_slice(text);
        Ok(Text { len: text.len() as u8, bytes })
    }

    /// The characters.
    pub fn as_str(&self) -> &str {
        std::str::from_utf8(&self.bytes[..usize::from(self.len)]).unwrap_or_default()
    }
}

impl fmt::Debug for Text {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self.as_str(), f)
    }
}

/// The ten commands that ask for scans.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ScanKind {
    /// Stream of distances of 3 characters.
    MD,
    /// Stream of distances of 2 characters.
    MS,
    /// Stream of distances and intensities.
    ME,
    /// Stream of distances, several echoes a step.
    ND,
    /// Stream of distances and intensities, several echoes a step.
    NE,
    /// One scan like MD.
    GD,
    /// One scan like MS.
    GS,
    /// One scan like ME.
    GE,
    /// One scan like ND.
    HD,
    /// One scan like NE.
    HE,
}

impl ScanKind {
    const ALL: [ScanKind; 10] = {
        use ScanKind::*;
        [MD, MS, ME, ND, NE, GD, GS, GE, HD, HE]
    };

    /// The two letters.
    pub fn name(self) -> &'static str {
        match self {
            ScanKind::MD => "MD",
            ScanKind::MS => "MS",
            ScanKind::ME => "ME",
            ScanKind::ND => "ND",
            ScanKind::NE => "NE",
            ScanKind::GD => "GD",
            ScanKind::GS => "GS",
            ScanKind::GE => "GE",
            ScanKind::HD => "HD",
            ScanKind::HE => "HE",
        }
    }

    /// Whether the device goes on sending scans by itself.
    pub fn is_stream(self) -> bool {
        matches!(self, ScanKind::MD | ScanKind::MS | ScanKind::ME | ScanKind::ND | ScanKind::NE)
    }

    /// Whether intensities come with the distances.
    pub fn has_intensity(self) -> bool {
        matches!(self, ScanKind::ME | ScanKind::NE | ScanKind::GE | ScanKind::HE)
    }

    /// Whether a step may have further echoes, marked by `&`.
    pub fn has_more_echoes(self) -> bool {
        matches!(self, ScanKind::ND | ScanKind::NE | ScanKind::HD | ScanKind::HE)
    }

    /// Characters of one distance.
    pub fn distance_chars(self) -> usize {
        if matches!(self, ScanKind::MS | ScanKind::GS) { 2 } else { 3 }
    }

    /// Characters of one echo: distance, and intensity of 3 where there is one.
    pub fn echo_chars(self) -> usize {
        self.distance_chars() + if self.has_intensity() { 3 } else { 0 }
    }
}

/// What a scan command asks for. In the echo of a streamed scan `count` is the number still to come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ScanRequest {
    /// The command.
    pub kind: ScanKind,
    /// First step.
    pub start: u16,
    /// Last step, included.
    pub end: u16,
    /// Neighbouring steps merged into one value; 0 and 1 both mean none.
    pub cluster: u8,
    /// Scans left out between two that are sent (streams only).
    pub skip: u8,
    /// How many scans, 0 for endless (streams only).
    pub count: u8,
}

impl ScanRequest {
    /// An endless stream, or one scan, of the steps `start..=end`.
    pub fn new(kind: ScanKind, start: u16, end: u16) -> ScanRequest {
        ScanRequest { kind, start, end, cluster: 1, skip: 0, count: 0 }
    }

    /// Checks that every value fits on the wire and that the window holds a step.
    pub fn check(&self) -> Result<(), RequestError> {
        let limits = [
            ("first step", u32::from(self.start), u32::from(MAX_STEP)),
            ("last step", u32::from(self.end), u32::from(MAX_STEP)),
            ("cluster", u32::from(self.cluster), u32::from(MAX_CLUSTER)),
            ("skip", u32::from(self.skip), u32::from(MAX_SKIP)),
            ("count", u32::from(self.count), u32::from(MAX_COUNT)),
        ];
        for (what, value, max) in limits {
            if value > max {
                return Err(RequestError::TooLarge { what, value, max });
            }
        }
        if self.start > self.end {
            return Err(RequestError::EmptyWindow { start: self.start, end: self.end });
        }
        Ok(())
    }

    /// Steps merged into one value, at least 1.
    pub fn steps_per_group(&self) -> u16 {
        u16::from(self.cluster.max(1))
    }

    /// Fewest and most values that a reply may hold: devices differ on a partial last group.
    pub fn value_counts(&self) -> (usize, usize) {
        let steps = usize::from(self.end.saturating_sub(self.start)) + 1;
        let group = usize::from(self.steps_per_group());
        (steps / group, steps.div_ceil(group))
    }

    /// Whether both ask for the same, whatever number of scans is still to come.
    pub fn same_stream(&self, other: &ScanRequest) -> bool {
        ScanRequest { count: 0, ..*self } == ScanRequest { count: 0, ..*other }
    }
}

/// A command with its parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Command {
    /// `VV`: vendor, product, firmware, protocol, serial number.
    Version,
    /// `PP`: the numbers that turn steps into bearings and distances.
    Parameters,
    /// `II`: what the device is doing; never send it while streaming.
    State,
    /// `BM`: laser on.
    LaserOn,
    /// `QT`: laser off, end of stream.
    Quit,
    /// `RS`: all settings to default, clock to zero.
    Reset,
    /// `RT`: like RS, but motor speed and bit rate stay.
    PartialReset,
    /// `RB`: reboot; to be sent twice within a second.
    Reboot,
    /// `TM0`: enter the time mode.
    TimeEnter,
    /// `TM1`: read the clock.
    TimeRead,
    /// `TM2`: leave the time mode.
    TimeLeave,
    /// `SS`: bit rate (RS-232 only), six digits.
    BitRate(u32),
    /// `CR`: motor speed level, two digits.
    MotorSpeed(u8),
    /// `HS`: high sensitivity on or off.
    Sensitivity(bool),
    /// `%ST`: state (SCIP 2.2).
    Status22,
    /// `%SL`: sleep (SCIP 2.2).
    Sleep,
    /// `SCIP2.0`: leave SCIP 1.1.
    Scip2,
    /// A scan or a stream of scans.
    Scan(ScanRequest),
}

impl Command {
    /// Commands without parameters. A longer name stands before one that begins it.
    const PLAIN: [(&'static str, Command); 14] = [
        ("SCIP2.0", Command::Scip2),
        ("%ST", Command::Status22),
        ("%SL", Command::Sleep),
        ("TM0", Command::TimeEnter),
        ("TM1", Command::TimeRead),
        ("TM2", Command::TimeLeave),
        ("VV", Command::Version),
        ("PP", Command::Parameters),
        ("II", Command::State),
        ("BM", Command::LaserOn),
        ("QT", Command::Quit),
        ("RS", Command::Reset),
        ("RT", Command::PartialReset),
        ("RB", Command::Reboot),
    ];

    /// Parses the command and its parameters, without string and LF.
    pub fn parse(line: &[u8]) -> Result<Command, RequestError> {
        if let Some((_, command)) = Command::PLAIN.iter().find(|(name, _)| name.as_bytes() == line) {
            return Ok(*command);
        }
        let (name, parameters) = line.split_at_checked(2).ok_or(RequestError::UnknownCommand)?;
        match name {
            b"SS" => Ok(Command::BitRate(digits("SS", parameters, 6)?)),
            b"CR" => Ok(Command::MotorSpeed(digits("CR", parameters, 2)? as u8)),
            b"HS" => match parameters {
                b"0" => Ok(Command::Sensitivity(false)),
                b"1" => Ok(Command::Sensitivity(true)),
                _ => Err(RequestError::Parameters { command: "HS", want: 1 }),
            },
            _ => {
                let kind = ScanKind::ALL.into_iter().find(|kind| kind.name().as_bytes() == name);
                parse_scan(kind.ok_or(RequestError::UnknownCommand)?, parameters).map(Command::Scan)
            }
        }
    }

    /// Appends command and parameters, without string and LF. Values too large for the wire lose their
    /// leading digits; see [`Request::check`].
    pub fn emit(&self, out: &mut Vec<u8>) {
        if let Some((name, _)) = Command::PLAIN.iter().find(|(_, command)| command == self) {
            out.extend_from_slice(name.as_bytes());
            return;
        }
        match *self {
            Command::BitRate(rate) => {
                out.extend_from_slice(b"SS");
                put_digits(rate, 6, out);
            }
            Command::MotorSpeed(level) => {
                out.extend_from_slice(b"CR");
                put_digits(u32::from(level), 2, out);
            }
            Command::Sensitivity(high) => out.extend_from_slice(if high { b"HS1" } else { b"HS0" }),
            Command::Scan(scan) => {
                out.extend_from_slice(scan.kind.name().as_bytes());
                put_digits(u32::from(scan.start), 4, out);
                put_digits(u32::from(scan.end), 4, out);
                put_digits(u32::from(scan.cluster), 2, out);
                if scan.kind.is_stream() {
                    put_digits(u32::from(scan.skip), 1, out);
                    put_digits(u32::from(scan.count), 2, out);
                }
            }
            _ => unreachable!("every command without parameters is in the table"),
        }
    }
}

fn parse_scan(kind: ScanKind, parameters: &[u8]) -> Result<ScanRequest, RequestError> {
    let want = if kind.is_stream() { 13 } else { 10 };
    digits(kind.name(), parameters, want)?;
    let value = |from: usize, to: usize| {
        parameters[from..to].iter().fold(0u16, |value, digit| value * 10 + u16::from(digit - b'0'))
    };
    let (skip, count) = if kind.is_stream() { (value(10, 11), value(11, 13)) } else { (0, 0) };
    Ok(ScanRequest {
        kind,
        start: value(0, 4),
        end: value(4, 8),
        cluster: value(8, 10) as u8,
        skip: skip as u8,
        count: count as u8,
    })
}

/// Value of exactly `want` decimal digits; more than nine of them are only checked.
fn digits(command: &'static str, parameters: &[u8], want: usize) -> Result<u32, RequestError> {
    if parameters.len() != want || !parameters.iter().all(u8::is_ascii_digit) {
        return Err(RequestError::Parameters { command, want });
    }
    Ok(parameters
        .iter()
        .fold(0u32, |value, digit| value.wrapping_mul(10).wrapping_add(u32::from(digit - b'0'))))
}

fn put_digits(value: u32, count: u32, out: &mut Vec<u8>) {
    for place in (0..count).rev() {
        out.push(b'0' + (value / 10u32.pow(place) % 10) as u8);
    }
}

/// A command and the string that its reply will echo.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Request {
    /// What is asked for.
    pub command: Command,
    /// String behind `;`.
    pub text: Option<Text>,
}

impl From<Command> for Request {
    fn from(command: Command) -> Request {
        Request { command, text: None }
    }
}

impl Request {
    /// Checks that every value fits on the wire.
    pub fn check(&self) -> Result<(), RequestError> {
        match self.command {
            Command::Scan(scan) => scan.check(),
            Command::BitRate(rate) if rate > 999_999 => {
                Err(RequestError::TooLarge { what: "bit rate", value: rate, max: 999_999 })
            }
            Command::MotorSpeed(level) if level > 99 => {
                Err(RequestError::TooLarge { what: "motor speed level", value: level.into(), max: 99 })
            }
            _ => Ok(()),
        }
    }

    /// Parses a request line, or the echo line of a reply, without its LF.
    pub fn parse(line: &[u8]) -> Result<Request, RequestError> {
        let (command, text) = match line.iter().position(|&b| b == b';') {
            Some(at) => (&line[..at], Some(Text::new(&line[at + 1..])?)),
            None => (line, None),
        };
        Ok(Request { command: Command::parse(command)?, text })
    }

    /// Appends the line without LF.
    pub fn emit_line(&self, out: &mut Vec<u8>) {
        self.command.emit(out);
        if let Some(text) = self.text {
            out.push(b';');
            out.extend_from_slice(text.as_str().as_bytes());
        }
    }

    /// The bytes to send: the line and LF (some devices refuse CRLF).
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(16);
        self.emit_line(&mut out);
        out.push(b'\n');
        out
    }
}

impl fmt::Display for Request {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut line = Vec::with_capacity(16);
        self.emit_line(&mut line);
        write!(f, "{}", line.escape_ascii())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_both_ways() {
        let me = |cluster, skip, count| {
            Command::Scan(ScanRequest { kind: ScanKind::ME, start: 0, end: 1080, cluster, skip, count })
        };
        let gd = ScanRequest { kind: ScanKind::GD, start: 44, end: 725, cluster: 1, skip: 0, count: 0 };
        for (line, command) in [
            ("VV", Command::Version),
            ("%ST", Command::Status22),
            ("SCIP2.0", Command::Scip2),
            ("SS115200", Command::BitRate(115_200)),
            ("CR00", Command::MotorSpeed(0)),
            ("HS1", Command::Sensitivity(true)),
            ("TM1", Command::TimeRead),
            ("ME0000108001101", me(1, 1, 1)),
            ("ME0000108000000", me(0, 0, 0)),
            ("GD0044072501", Command::Scan(gd)),
        ] {
            let request = Request::parse(line.as_bytes()).unwrap();
            assert_eq!(request, command.into());
            assert_eq!(request.to_string(), line);
        }
        let tagged = Request::parse(b"ME0000108003102;tag 1").unwrap();
        assert_eq!(tagged.text.unwrap().as_str(), "tag 1");
        assert_eq!(tagged.to_bytes(), b"ME0000108003102;tag 1\n");
    }

    #[test]
    fn refused() {
        assert_eq!(Request::parse(b"ZZ"), Err(RequestError::UnknownCommand));
        assert_eq!(Request::parse(b""), Err(RequestError::UnknownCommand));
        assert_eq!(Request::parse(b"ME00"), Err(RequestError::Parameters { command: "ME", want: 13 }));
        assert_eq!(Request::parse(b"VV;a-b"), Err(RequestError::TextCharacter { byte: b'-' }));
        assert_eq!(Request::parse(b"VV;12345678901234567"), Err(RequestError::TextTooLong { len: 17 }));
        let window = ScanRequest::new(ScanKind::MD, 9, 8);
        assert_eq!(window.check(), Err(RequestError::EmptyWindow { start: 9, end: 8 }));
    }

    #[test]
    fn a_partial_group_may_be_left_out() {
        let request = ScanRequest { cluster: 3, ..ScanRequest::new(ScanKind::ME, 0, 1080) };
        assert_eq!(request.value_counts(), (360, 361));
    }
}
