//! Replies of the device, as values, and their bytes. Parsing a stream into replies is `decoder`.

use crate::fields::Fields;
use crate::number;
use crate::request::{Request, ScanRequest};
use crate::status::Status;

/// Characters of a data line before its sum.
pub(crate) const LINE_CHARS: usize = 64;

/// First line of a reply.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Echo {
    /// Of a request that is known.
    Request(Request),
    /// Of anything else that was sent; the device refuses it but still echoes it.
    Other(Vec<u8>),
}

/// Second or third echo of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FurtherEcho {
    /// Index into the distances of the first echoes.
    pub index: u32,
    /// Raw value, codes included (mm).
    pub distance_mm: u32,
    /// Raw value of 18 bits; 0 where the command carries none.
    pub intensity: u32,
}

/// Content of one scan. All values are as they were on the wire: small distances are codes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ScanData {
    /// The device's clock (24 bits, ms).
    pub stamp_ms: u32,
    /// First echo of each group of steps (mm, codes included).
    pub distances_mm: Vec<u32>,
    /// One for each distance, or empty (18 bits, device's unit).
    pub intensities: Vec<u32>,
    /// Second and third echoes in order of their step.
    pub more_echoes: Vec<FurtherEcho>,
}

/// What follows the status.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Body {
    /// Nothing.
    Empty,
    /// Answer to VV, PP, II or %ST: `KEY:value` lines.
    Fields(Fields),
    /// Answer to TM1: the device's clock (24 bits, ms).
    Time(u32),
    /// A scan.
    Scan(ScanData),
    /// Lines of a reply whose form is not known, sums checked and taken off (SCIP 1.1 has none).
    Lines(Vec<Vec<u8>>),
}

/// One whole reply.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reply {
    /// What was asked.
    pub echo: Echo,
    /// How it went.
    pub status: Status,
    /// The answer.
    pub body: Body,
}

impl Reply {
    /// The known request that this answers.
    pub fn request(&self) -> Option<&Request> {
        match &self.echo {
            Echo::Request(request) => Some(request),
            Echo::Other(_) => None,
        }
    }

    /// Appends the bytes of the reply with its final empty line, as a device sends them.
    pub fn emit(&self, out: &mut Vec<u8>) {
        match &self.echo {
            Echo::Request(request) => request.emit_line(out),
            Echo::Other(line) => out.extend_from_slice(line),
        }
        out.push(b'\n');
        self.status.emit(out);
        match &self.body {
            Body::Empty => {}
            Body::Fields(fields) => fields.emit(out),
            Body::Time(ms) => put_stamp(*ms, out),
            Body::Scan(data) => {
                put_stamp(data.stamp_ms, out);
                if let Echo::Request(Request { command: crate::Command::Scan(scan), .. }) = &self.echo {
                    put_payload(&payload(scan, data), out);
                }
            }
            Body::Lines(lines) => {
                for line in lines {
                    out.extend_from_slice(line);
                    if !matches!(self.status, Status::Scip1(_)) {
                        out.push(number::checksum(line));
                    }
                    out.push(b'\n');
                }
            }
        }
        out.push(b'\n');
    }
}

fn put_stamp(ms: u32, out: &mut Vec<u8>) {
    let from = out.len();
    number::encode(ms, 4, out);
    out.push(number::checksum(&out[from..]));
    out.push(b'\n');
}

fn payload(request: &ScanRequest, data: &ScanData) -> Vec<u8> {
    let kind = request.kind;
    let mut chars = Vec::with_capacity(data.distances_mm.len() * kind.echo_chars());
    let put = |distance: u32, intensity: u32, chars: &mut Vec<u8>| {
        number::encode(distance, kind.distance_chars(), chars);
        if kind.has_intensity() {
            number::encode(intensity, 3, chars);
        }
    };
    let mut further = data.more_echoes.iter().peekable();
    for (index, &distance) in data.distances_mm.iter().enumerate() {
        put(distance, data.intensities.get(index).copied().unwrap_or(0), &mut chars);
        while let Some(echo) = further.next_if(|echo| echo.index as usize == index) {
            chars.push(b'&');
            put(echo.distance_mm, echo.intensity, &mut chars);
        }
    }
    chars
}

fn put_payload(chars: &[u8], out: &mut Vec<u8>) {
    for line in chars.chunks(LINE_CHARS) {
        out.extend_from_slice(line);
        out.push(number::checksum(line));
        out.push(b'\n');
    }
}
