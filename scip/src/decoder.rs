//! Bytes to replies, whatever the chunks. A reply ends at an empty line, so everything up to the next one
//! is collected and then taken apart; where that fails, the last place in it that looks like the head of
//! a reply is tried, and all that was skipped is reported. No clock, no log, bounded memory.

use crate::fields::Fields;
use crate::number;
use crate::reply::{Body, Echo, FurtherEcho, LINE_CHARS, Reply, ScanData};
use crate::request::{Command, Request, ScanKind, ScanRequest};
use crate::status::Status;

/// Longest reply that is collected. The wire format allows 10,000 steps of three echoes of 6 characters
/// and two `&`, 65 bytes of line for each 64 of them and a LF: 206,250 bytes.
pub const MAX_REPLY: usize = 256 * 1024;
/// Longest line of a reply: those of VV, PP and II are the longest, about 80 bytes in captures.
pub const MAX_LINE: usize = 512;
/// Longest echo line: `ME` and 13 digits, `;`, 16 characters.
const MAX_ECHO: usize = 32;
/// Longest line that is taken for the echo of something unknown: twice the longest request.
const MAX_STRANGE_ECHO: usize = 2 * MAX_ECHO;
/// Characters in the alphabet of numbers lie within 64 of this one.
const ZERO: u8 = 0x30;
/// Marks a further echo of the same step.
const FURTHER: u8 = b'&';

/// Why bytes are no reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeErrorKind {
    /// The first two lines are no echo and status with its sum.
    #[error("no reply begins with this line of {len} bytes")]
    NoStatus {
        /// Length of the first line.
        len: usize,
    },
    /// A line's sum is wrong. Lines count from 0, the echo.
    #[error("line {line}: its sum should be '{}', is '{}'", want.escape_ascii(), got.escape_ascii())]
    Checksum {
        /// Number of the line in the reply.
        line: usize,
        /// Sum by the bytes of the line.
        want: u8,
        /// Sum that was sent.
        got: u8,
    },
    /// A byte outside the alphabet of numbers.
    #[error("line {line}: byte 0x{byte:02x} is no digit of a number")]
    Character {
        /// Number of the line in the reply.
        line: usize,
        /// The byte.
        byte: u8,
    },
    /// A line of scan data or of a stamp that is too long, too short or empty.
    #[error("line {line}: has {len} bytes")]
    LineLength {
        /// Number of the line in the reply.
        line: usize,
        /// Its length with the sum.
        len: usize,
    },
    /// Data that ends inside a value.
    #[error("{chars} characters of data are no multiple of {per_value}")]
    PartialValue {
        /// Characters of data.
        chars: usize,
        /// Characters of one value.
        per_value: usize,
    },
    /// More or fewer values than the request asks for.
    #[error("{got} values, the request asks for {least} to {most}")]
    ValueCount {
        /// Values in the reply.
        got: usize,
        /// Fewest possible.
        least: usize,
        /// Most possible.
        most: usize,
    },
    /// A reply longer than any can be.
    #[error("{len} bytes without an empty line")]
    TooLong {
        /// Bytes thrown away.
        len: usize,
    },
    /// The stream ended or broke here.
    #[error("the stream broke after {len} bytes of a reply")]
    Cut {
        /// Bytes of the reply that had come.
        len: usize,
    },
}

impl DecodeErrorKind {
    /// A short name, for counting errors by kind.
    pub fn name(&self) -> &'static str {
        match self {
            DecodeErrorKind::NoStatus { .. } => "no_status",
            DecodeErrorKind::Checksum { .. } => "checksum",
            DecodeErrorKind::Character { .. } => "character",
            DecodeErrorKind::LineLength { .. } => "line_length",
            DecodeErrorKind::PartialValue { .. } => "partial_value",
            DecodeErrorKind::ValueCount { .. } => "value_count",
            DecodeErrorKind::TooLong { .. } => "too_long",
            DecodeErrorKind::Cut { .. } => "cut",
        }
    }
}

/// Bytes that were skipped, and why.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{len} bytes skipped at byte {at} of the stream: {kind}")]
pub struct DecodeError {
    /// Offset of the first skipped byte from the beginning of the stream.
    pub at: u64,
    /// Number of bytes skipped.
    pub len: u64,
    /// Why.
    pub kind: DecodeErrorKind,
}

/// A reply and where it stood in the stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Located {
    /// Offset of its first byte.
    pub at: u64,
    /// Its bytes, the final empty line included.
    pub len: u64,
    /// The reply.
    pub reply: Reply,
}

/// Streaming decoder. After each [`push`](Decoder::push) take what [`decode_next`](Decoder::decode_next)
/// gives until it is `None`; memory is then bounded by [`MAX_REPLY`] and the longest chunk.
#[derive(Debug, Default)]
pub struct Decoder {
    /// Bytes from `start` on are not decoded yet.
    buffer: Vec<u8>,
    start: usize,
    /// Up to here the buffer has been searched for line ends.
    searched: usize,
    /// Ends (index of the LF) of the whole lines from `start` on.
    line_ends: Vec<usize>,
    /// Offset in the stream of `buffer[0]`.
    base: u64,
    /// A reply found behind skipped bytes, to be given after their error.
    waiting: Option<Located>,
    /// Scan data without sums, kept for its memory.
    payload: Vec<u8>,
}

impl Decoder {
    /// A decoder at offset 0 of a stream.
    pub fn new() -> Decoder {
        Decoder::default()
    }

    /// Bytes that have been pushed in all.
    pub fn offset(&self) -> u64 {
        self.base + self.buffer.len() as u64
    }

    /// Offset of the first byte that may still become part of a reply.
    pub fn undecoded_at(&self) -> u64 {
        self.base + self.start as u64
    }

    /// Adds received bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        if self.start > 0 {
            self.buffer.drain(..self.start);
            self.base += self.start as u64;
            self.searched -= self.start;
            self.line_ends.iter_mut().for_each(|end| *end -= self.start);
            self.start = 0;
        }
        self.buffer.extend_from_slice(bytes);
    }

    /// Next reply, or the bytes skipped before it.
    pub fn decode_next(&mut self) -> Option<Result<Located, DecodeError>> {
        if let Some(located) = self.waiting.take() {
            return Some(Ok(located));
        }
        loop {
            let line_start = self.line_ends.last().map_or(self.start, |&end| end + 1);
            // What is given up must not depend on the chunks, so no line is looked at beyond its limit.
            let limit = self.buffer.len().min(line_start + MAX_LINE + 1);
            let Some(length) = line_length(&self.buffer[self.searched..limit]) else {
                self.searched = limit;
                let is_too_long = limit - line_start > MAX_LINE;
                // The last bytes may be the start of an echo line glued to the garbage.
                return is_too_long.then(|| Err(self.give_up(limit - MAX_ECHO)));
            };
            let end = self.searched + length;
            self.searched = end + 1;
            if end > line_start {
                self.line_ends.push(end);
                if self.searched - self.start > MAX_REPLY {
                    return Some(Err(self.give_up(line_start)));
                }
            } else if self.line_ends.is_empty() {
                self.start = self.searched; // an empty line outside a reply means nothing
            } else {
                return Some(self.finish_block());
            }
        }
    }

    /// The stream ends, or bytes are missing here: reports the unfinished reply.
    pub fn cut(&mut self) -> Option<DecodeError> {
        let len = self.buffer.len() - self.start;
        let error =
            DecodeError { at: self.undecoded_at(), len: len as u64, kind: DecodeErrorKind::Cut { len } };
        self.drop_until(self.buffer.len());
        (len > 0).then_some(error)
    }

    /// Goes on at `end`, as if a reply could begin there.
    fn drop_until(&mut self, end: usize) {
        self.start = end;
        self.searched = end;
        self.line_ends.clear();
    }

    fn give_up(&mut self, end: usize) -> DecodeError {
        let len = end - self.start;
        let error =
            DecodeError { at: self.undecoded_at(), len: len as u64, kind: DecodeErrorKind::TooLong { len } };
        self.drop_until(end);
        error
    }

    /// Takes the lines up to an empty one apart.
    fn finish_block(&mut self) -> Result<Located, DecodeError> {
        let (start, end) = (self.start, self.searched);
        let base = self.base;
        let located =
            |from: usize, reply| Located { at: base + from as u64, len: (end - from) as u64, reply };
        let block = Block { bytes: &self.buffer, start, line_ends: &self.line_ends };
        let outcome = match block.decode(&mut self.payload) {
            Ok(reply) => Ok(located(start, reply)),
            Err(kind) => {
                self.waiting =
                    block.decode_last_head(&mut self.payload).map(|(from, reply)| located(from, reply));
                let until = self.waiting.as_ref().map_or(base + end as u64, |found| found.at);
                let at = base + start as u64;
                Err(DecodeError { at, len: until - at, kind })
            }
        };
        self.drop_until(end);
        outcome
    }
}

/// Lines before an empty line; there is at least one, and none is empty.
#[derive(Clone, Copy)]
struct Block<'a> {
    bytes: &'a [u8],
    start: usize,
    line_ends: &'a [usize],
}

impl<'a> Block<'a> {
    fn line(&self, index: usize) -> &'a [u8] {
        let from = index.checked_sub(1).map_or(self.start, |before| self.line_ends[before] + 1);
        &self.bytes[from..self.line_ends[index]]
    }

    fn lines_from(&self, index: usize) -> impl Iterator<Item = (usize, &'a [u8])> {
        let block = *self;
        (index..block.line_ends.len()).map(move |index| (index, block.line(index)))
    }

    fn decode(&self, payload: &mut Vec<u8>) -> Result<Reply, DecodeErrorKind> {
        let head = self.line(0);
        let no_status = DecodeErrorKind::NoStatus { len: head.len() };
        if self.line_ends.len() < 2 {
            return Err(no_status);
        }
        let status = Status::parse(self.line(1)).ok_or(no_status)?;
        let request = Request::parse(head).ok();
        if request.is_none() && (!may_be_echo(head, status) || glued_request(head).is_some()) {
            return Err(no_status);
        }
        let body = match (status, request.map(|request| request.command)) {
            _ if self.line_ends.len() == 2 => Body::Empty,
            // Some SCIP 1.1 replies lack the empty line (that to V, in a capture of a URG-04LX), so the next one stands in them.
            (Status::Scip1(_), _) if self.lines_from(2).any(|(_, line)| line == b"SCIP2.0") => {
                return Err(no_status);
            }
            (Status::Scip1(_), _) => Body::Lines(self.lines_from(2).map(|(_, line)| line.to_vec()).collect()),
            (_, Some(Command::Scan(scan))) => Body::Scan(self.scan(&scan, payload)?),
            (_, Some(Command::TimeRead)) if self.line_ends.len() == 3 => Body::Time(self.stamp(2)?),
            (_, Some(Command::Version | Command::Parameters | Command::State | Command::Status22)) => {
                Body::Fields(self.fields()?)
            }
            _ => Body::Lines(self.summed_lines()?),
        };
        let echo = request.map_or_else(|| Echo::Other(head.to_vec()), Echo::Request);
        Ok(Reply { echo, status, body })
    }

    /// Looks from the end for an echo and a status, the echo perhaps glued to the rest of a cut line.
    fn decode_last_head(&self, payload: &mut Vec<u8>) -> Option<(usize, Reply)> {
        /// A reply has one head only; more than a few that look like one mean garbage.
        const TRIES: usize = 4;
        let heads = (0..self.line_ends.len().saturating_sub(1)).rev().filter_map(|index| {
            let status = Status::parse(self.line(index + 1))?;
            let line = self.line(index);
            // A status of SCIP 1.1 has no sum; only the answer to the switch is worth the risk.
            if matches!(status, Status::Scip1(_)) && !line.ends_with(b"SCIP2.0") {
                return None;
            }
            let from = self.line_ends[index] - line.len() + glued_request(line)?;
            (from > self.start).then_some((index, from))
        });
        heads.take(TRIES).find_map(|(index, from)| {
            let rest = Block { start: from, line_ends: &self.line_ends[index..], ..*self };
            rest.decode(payload).ok().map(|reply| (from, reply))
        })
    }

    fn fields(&self) -> Result<Fields, DecodeErrorKind> {
        let mut fields = Fields::default();
        for (line, bytes) in self.lines_from(2) {
            fields.push_line(bytes).map_err(|bad| DecodeErrorKind::Checksum {
                line,
                want: bad.want,
                got: bad.got,
            })?;
        }
        Ok(fields)
    }

    fn summed_lines(&self) -> Result<Vec<Vec<u8>>, DecodeErrorKind> {
        let content = |(line, bytes)| check_sum(line, bytes).map(<[u8]>::to_vec);
        self.lines_from(2).map(content).collect()
    }

    fn stamp(&self, line: usize) -> Result<u32, DecodeErrorKind> {
        let chars = check_sum(line, self.line(line))?;
        if chars.len() != 4 {
            return Err(DecodeErrorKind::LineLength { line, len: chars.len() + 1 });
        }
        check_alphabet(line, chars, false)?;
        number::decode(chars).ok_or(DecodeErrorKind::LineLength { line, len: chars.len() + 1 })
    }

    fn scan(&self, request: &ScanRequest, payload: &mut Vec<u8>) -> Result<ScanData, DecodeErrorKind> {
        let stamp_ms = self.stamp(2)?;
        payload.clear();
        for (line, bytes) in self.lines_from(3) {
            let chars = check_sum(line, bytes)?;
            let is_last = line + 1 == self.line_ends.len();
            if chars.len() > LINE_CHARS || (chars.len() < LINE_CHARS && !is_last) || chars.is_empty() {
                return Err(DecodeErrorKind::LineLength { line, len: bytes.len() });
            }
            check_alphabet(line, chars, request.kind.has_more_echoes())?;
            payload.extend_from_slice(chars);
        }
        let data = if request.kind.has_more_echoes() {
            decode_echoes(request.kind, stamp_ms, payload)?
        } else {
            decode_values(request.kind, stamp_ms, payload)?
        };
        let (least, most) = request.value_counts();
        let got = data.distances_mm.len();
        if got < least || got > most {
            return Err(DecodeErrorKind::ValueCount { got, least, most });
        }
        Ok(data)
    }
}

/// Where the longest request begins that ends with the line: its echo may be glued to the rest of a cut line.
fn glued_request(line: &[u8]) -> Option<usize> {
    (line.len().saturating_sub(MAX_ECHO)..line.len()).find(|&from| Request::parse(&line[from..]).is_ok())
}

/// Whether a device may echo this line, which is no request that is known.
fn may_be_echo(line: &[u8], status: Status) -> bool {
    match (status, line) {
        // SCIP 1.1 has the commands V, L, G and S; its statuses have no sum, so nothing else tells them
        // from any text.
        (Status::Scip1(_), [b'V' | b'L' | b'G' | b'S', rest @ ..]) => rest.iter().all(u8::is_ascii_digit),
        (Status::Scip1(_), _) => false,
        _ => line.len() <= MAX_STRANGE_ECHO && line.iter().all(|byte| (0x20..0x7f).contains(byte)),
    }
}

/// Bytes before the first LF. Whole chunks are looked at without a branch for each byte, which the compiler
/// turns into vector code.
fn line_length(bytes: &[u8]) -> Option<usize> {
    const CHUNK: usize = 32;
    let (chunks, _) = bytes.as_chunks::<CHUNK>();
    let has_lf = |chunk: &[u8; CHUNK]| chunk.iter().fold(false, |found, &byte| found | (byte == b'\n'));
    let from = CHUNK * chunks.iter().position(has_lf).unwrap_or(chunks.len());
    bytes[from..].iter().position(|&byte| byte == b'\n').map(|length| from + length)
}

/// Content of a line whose last byte is the sum of the others.
fn check_sum(line: usize, bytes: &[u8]) -> Result<&[u8], DecodeErrorKind> {
    let (&got, content) = bytes.split_last().ok_or(DecodeErrorKind::LineLength { line, len: 0 })?;
    let want = number::checksum(content);
    if want == got { Ok(content) } else { Err(DecodeErrorKind::Checksum { line, want, got }) }
}

fn check_alphabet(line: usize, chars: &[u8], further: bool) -> Result<(), DecodeErrorKind> {
    // One pass without a branch, which the compiler turns into vector code; the culprit is looked for after.
    let strange = |byte: u8| byte.wrapping_sub(ZERO) & 0xc0;
    if chars.iter().fold(0, |all, &byte| all | strange(byte)) == 0 {
        return Ok(());
    }
    match chars.iter().find(|&&byte| strange(byte) != 0 && !(further && byte == FURTHER)) {
        Some(&byte) => Err(DecodeErrorKind::Character { line, byte }),
        None => Ok(()),
    }
}

/// Value of checked characters.
fn value<const N: usize>(chars: [u8; N]) -> u32 {
    chars.iter().fold(0, |value, &c| value << 6 | u32::from(c.wrapping_sub(ZERO)))
}

fn decode_values(kind: ScanKind, stamp_ms: u32, payload: &[u8]) -> Result<ScanData, DecodeErrorKind> {
    let per_value = kind.echo_chars();
    if !payload.len().is_multiple_of(per_value) {
        return Err(DecodeErrorKind::PartialValue { chars: payload.len(), per_value });
    }
    let mut data = ScanData { stamp_ms, ..ScanData::default() };
    if kind.has_intensity() {
        let (values, _) = payload.as_chunks::<6>();
        data.distances_mm = values.iter().map(|&[a, b, c, ..]| value([a, b, c])).collect();
        data.intensities = values.iter().map(|&[.., d, e, f]| value([d, e, f])).collect();
    } else if kind.distance_chars() == 2 {
        data.distances_mm = payload.as_chunks::<2>().0.iter().map(|&chars| value(chars)).collect();
    } else {
        data.distances_mm = payload.as_chunks::<3>().0.iter().map(|&chars| value(chars)).collect();
    }
    Ok(data)
}

/// Values of which some are further echoes of the step before, marked by `&`.
fn decode_echoes(kind: ScanKind, stamp_ms: u32, payload: &[u8]) -> Result<ScanData, DecodeErrorKind> {
    let per_value = kind.echo_chars();
    let partial = DecodeErrorKind::PartialValue { chars: payload.len(), per_value };
    let mut data = ScanData { stamp_ms, ..ScanData::default() };
    let mut rest = payload;
    while !rest.is_empty() {
        let further = rest[0] == FURTHER;
        if further {
            rest = &rest[1..];
        }
        let (chars, tail) = rest.split_at_checked(per_value).ok_or(partial)?;
        rest = tail;
        let (distance, intensity) = chars.split_at(kind.distance_chars());
        // A `&` inside a value is no digit, so the value is cut.
        let distance_mm = number::decode(distance).ok_or(partial)?;
        let intensity = number::decode(intensity).ok_or(partial)?;
        if further {
            let index = data.distances_mm.len().checked_sub(1).ok_or(partial)? as u32;
            data.more_echoes.push(FurtherEcho { index, distance_mm, intensity });
        } else {
            data.distances_mm.push(distance_mm);
            if kind.has_intensity() {
                data.intensities.push(intensity);
            }
        }
    }
    Ok(data)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::request::Text;

    /// A stream of two scans of three steps with intensities, between answers to BM and QT.
    const STREAM: &[u8] = b"BM\n00P\n\nME0000000201000\n00P\n\n\
        ME0000000201000\n99b\nBI9YM\n00]0LA00`0Kd00a0L06\n\n\
        ME0000000201000\n99b\nBI9ZN\n00]0LA00`0Kd00a0L06\n\nQT\n00P\n\n";

    fn decode(bytes: &[u8]) -> Vec<Result<Located, DecodeError>> {
        let mut decoder = Decoder::new();
        decoder.push(bytes);
        std::iter::from_fn(|| decoder.decode_next()).collect()
    }

    fn replies(bytes: &[u8]) -> Vec<Reply> {
        decode(bytes).into_iter().map(|outcome| outcome.unwrap().reply).collect()
    }

    fn echoes(outcomes: &[Result<Located, DecodeError>]) -> Vec<String> {
        let name = |found: &Located| found.reply.request().map_or("?".to_owned(), |r| r.to_string());
        outcomes.iter().flatten().map(name).collect()
    }

    #[test]
    fn a_small_stream() {
        let replies = replies(STREAM);
        assert_eq!(replies.len(), 5);
        let Body::Scan(scan) = &replies[2].body else { panic!("{:?}", replies[2]) };
        assert_eq!(scan.stamp_ms, 4_821_609);
        assert_eq!(scan.distances_mm, [45, 48, 49]);
        assert_eq!(scan.intensities, [1809, 1780, 1792]);
        assert_eq!((replies[1].status, &replies[1].body), (Status::Done, &Body::Empty));
    }

    #[test]
    fn replies_and_their_bytes_agree() {
        let mut out = Vec::new();
        replies(STREAM).iter().for_each(|reply| reply.emit(&mut out));
        assert_eq!(out.escape_ascii().to_string(), STREAM.escape_ascii().to_string());
    }

    #[test]
    fn further_echoes_of_a_step() {
        let replies = replies(b"NE0000000100000\n99b\n00000\n007008&00900:00:002d\n\n");
        let Body::Scan(scan) = &replies[0].body else { panic!("{replies:?}") };
        assert_eq!((&scan.distances_mm[..], &scan.intensities[..]), (&[7, 10][..], &[8, 2][..]));
        assert_eq!(scan.more_echoes, [FurtherEcho { index: 0, distance_mm: 9, intensity: 10 }]);
        let mut out = Vec::new();
        replies[0].emit(&mut out);
        assert_eq!(decode(&out)[0].as_ref().unwrap().reply, replies[0]);
    }

    #[test]
    fn eighteen_bits_of_intensity() {
        let replies = replies(b"GE0000000001\n00P\n00000\n00goooD\n\n");
        let Body::Scan(scan) = &replies[0].body else { panic!("{replies:?}") };
        assert_eq!((scan.distances_mm[0], scan.intensities[0]), (55, 262_143));
    }

    #[test]
    fn refusals_and_strange_requests() {
        let replies = replies(b"ZZ\n0Ee\n\nME00\n0Cc\n\nQT;end\n00P\n\nTM1;a1\n00P\n015W]\n\nSCIP2.0\n0\n\n");
        assert_eq!(replies[0].echo, Echo::Other(b"ZZ".to_vec()));
        assert_eq!(replies[1].status, Status::General(b'C'));
        assert_eq!(replies[2].request().unwrap().text, Some(Text::new(b"end").unwrap()));
        assert_eq!(replies[3].body, Body::Time(4455));
        assert_eq!(replies[4].status, Status::Scip1(b'0'));
    }

    #[test]
    fn a_bad_sum_costs_one_reply_and_says_where() {
        let mut stream = STREAM.to_vec();
        stream[60] ^= 1;
        let outcomes = decode(&stream);
        let errors: Vec<_> = outcomes.iter().filter_map(|outcome| outcome.as_ref().err()).collect();
        let [DecodeError { at: 29, len: 47, kind: DecodeErrorKind::Checksum { line: 3, .. } }] = errors[..]
        else {
            panic!("{errors:?}")
        };
        assert_eq!(echoes(&outcomes), ["BM", "ME0000000201000", "ME0000000201000", "QT"]);
    }

    #[test]
    fn a_cut_reply_does_not_take_the_next_with_it() {
        let scan = b"ME0000000201000\n99b\nBI9YM\n00]0LA00`0Kd00a0L06\n\n";
        for cut in 1..scan.len() - 1 {
            let stream = [&scan[..cut], b"QT\n00P\n\n", scan].concat();
            let outcomes = decode(&stream);
            assert_eq!(echoes(&outcomes).last().unwrap(), "ME0000000201000", "cut at {cut}");
            // Where a cut leaves `..QT` to be read as something longer, only that one reply is lost.
            let error = outcomes[0].as_ref().unwrap_err();
            assert_eq!(error.at, 0, "cut at {cut}");
            let found = echoes(&outcomes).contains(&"QT".to_owned());
            assert!(found || cut == 15, "cut at {cut}: {outcomes:?}");
        }
    }

    #[test]
    fn a_device_found_streaming() {
        let mut stream = b"0Kd00a0L06\n\n".to_vec();
        stream.extend_from_slice(STREAM);
        let outcomes = decode(&stream);
        let kind = DecodeErrorKind::NoStatus { len: 10 };
        assert_eq!(outcomes[0], Err(DecodeError { at: 0, len: 12, kind }));
        assert_eq!(echoes(&outcomes).len(), 5);
    }

    #[test]
    fn a_switch_behind_a_reply_without_an_end() {
        let outcomes = decode(b"V\n0\nVEND:Hokuyo\nSTAT:FW Normal\nSCIP2.0\n0\n\n");
        assert_eq!(outcomes[0].as_ref().unwrap_err().len, 31);
        assert_eq!(echoes(&outcomes), ["SCIP2.0"]);
        let whole = decode(b"V\n0\nVEND:Hokuyo\n\n");
        assert_eq!(whole[0].as_ref().unwrap().reply.body, Body::Lines(vec![b"VEND:Hokuyo".to_vec()]));
    }

    #[test]
    fn missing_lines_and_partial_values_are_noticed() {
        let kind = |bytes: &[u8]| decode(bytes)[0].as_ref().unwrap_err().kind;
        let partial = kind(b"GD0000000301\n00P\n00000\n00700800991\n\n");
        assert_eq!(partial, DecodeErrorKind::PartialValue { chars: 10, per_value: 3 });
        let few = kind(b"GD0000000301\n00P\n00000\n0070080098\n\n");
        assert_eq!(few, DecodeErrorKind::ValueCount { got: 3, least: 4, most: 4 });
        let foreign = kind(b"TM1\n00P\n00p00\n\n");
        assert_eq!(foreign, DecodeErrorKind::Character { line: 2, byte: b'p' });
    }

    #[test]
    fn the_end_of_a_stream_is_reported() {
        let mut decoder = Decoder::new();
        decoder.push(b"\nQT\n00P\n\nVV\n0");
        assert!(decoder.decode_next().unwrap().is_ok());
        assert_eq!(decoder.decode_next(), None);
        let kind = DecodeErrorKind::Cut { len: 4 };
        assert_eq!(decoder.cut(), Some(DecodeError { at: 9, len: 4, kind }));
        assert_eq!(decoder.cut(), None);
        decoder.push(b"QT\n00P\n\n");
        assert_eq!(decoder.decode_next().unwrap().unwrap().at, 13);
    }

    #[test]
    fn noise_without_an_end_is_thrown_away() {
        let mut decoder = Decoder::new();
        let mut skipped = 0;
        for chunk in 0..5000u32 {
            decoder.push(&[b'x', (chunk % 7) as u8 + b'0'].repeat(50));
            while let Some(outcome) = decoder.decode_next() {
                skipped += outcome.unwrap_err().len;
            }
            assert!(decoder.buffer.len() <= MAX_LINE + 200);
        }
        decoder.push(b"QT\n00P\n\n");
        let last: Vec<_> = std::iter::from_fn(|| decoder.decode_next()).collect();
        assert_eq!(echoes(&last), ["QT"]);
        assert!(skipped > 499_000);
    }
}
