//! The ROS 2 messages of a recording as CDR bytes: a handful of fixed types, encoded and decoded by hand.
//!
//! Not a general CDR library: little-endian plain CDR (encapsulation `00 01`) only, and no type is described at run
//! time. Decoding checks every length against the bytes that are there, and never panics. Source: OMG DDS-RTPS 2.5,
//! clause 10 (plain CDR, alignment counted from behind the 4-byte encapsulation header), and the ROS 2 interface
//! definitions in [`Message::SCHEMA`], which the MCAP schema records repeat.

mod messages;

pub use messages::{
    DiagnosticArray, DiagnosticStatus, Header, LaserScan, OccupancyGrid, Odometry, PoseReceived, ScipBytes,
    TaskDone, TfMessage, Transform, TransformStamped,
};

/// Why bytes are not the message they should be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CdrError {
    /// Fewer bytes than the next field needs.
    #[error("the message is cut: {need} bytes needed at byte {at}, {left} left")]
    Cut {
        /// Offset of the field, from the start of the message.
        at: usize,
        /// Bytes that the field needs.
        need: usize,
        /// Bytes that are there.
        left: usize,
    },
    /// Not little-endian plain CDR.
    #[error("CDR encapsulation {0:#06x} is not plain little-endian CDR (0x0001)")]
    Encapsulation(u16),
    /// A string is not UTF-8.
    #[error("the string at byte {at} is not UTF-8")]
    Text {
        /// Offset of its first character.
        at: usize,
    },
}

/// A message type with its name and definition.
pub trait Message: Sized {
    /// ROS 2 name, `package/msg/Type`.
    const TYPE: &'static str;
    /// Definition as MCAP's schema encoding `ros2msg` wants it: the message, then every type it uses behind a line
    /// of `=` and `MSG: package/Type`.
    const SCHEMA: &'static str;

    /// Appends the fields.
    fn write(&self, out: &mut Encoder<'_>);

    /// Takes the fields.
    fn read(input: &mut Decoder<'_>) -> Result<Self, CdrError>;

    /// Replaces the content of `bytes` by the whole message.
    fn encode_into(&self, bytes: &mut Vec<u8>) {
        self.write(&mut Encoder::new(bytes));
    }

    /// The whole message.
    fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.encode_into(&mut bytes);
        bytes
    }

    /// The message in `bytes`; what follows it (padding) is ignored.
    fn decode(bytes: &[u8]) -> Result<Self, CdrError> {
        Self::read(&mut Decoder::new(bytes)?)
    }
}

/// Length of the encapsulation header, from whose end alignment is counted.
const ENCAPSULATION: usize = 4;

/// Appends values to a message.
pub struct Encoder<'a> {
    bytes: &'a mut Vec<u8>,
}

impl<'a> Encoder<'a> {
    /// Starts a message: clears `bytes` and writes the encapsulation header.
    pub fn new(bytes: &'a mut Vec<u8>) -> Self {
        bytes.clear();
        bytes.extend([0, 1, 0, 0]);
        Self { bytes }
    }

    fn align(&mut self, size: usize) {
        let end = (self.bytes.len() - ENCAPSULATION).next_multiple_of(size) + ENCAPSULATION;
        self.bytes.resize(end, 0);
    }

    /// A `uint8`, `byte` or `bool`.
    pub fn u8(&mut self, value: u8) {
        self.bytes.push(value);
    }

    /// A `uint32`.
    pub fn u32(&mut self, value: u32) {
        self.align(4);
        self.bytes.extend(value.to_le_bytes());
    }

    /// An `int32`.
    pub fn i32(&mut self, value: i32) {
        self.u32(value as u32);
    }

    /// A `uint64`.
    pub fn u64(&mut self, value: u64) {
        self.align(8);
        self.bytes.extend(value.to_le_bytes());
    }

    /// An `int64`.
    pub fn i64(&mut self, value: i64) {
        self.u64(value as u64);
    }

    /// A `float32`.
    pub fn f32(&mut self, value: f32) {
        self.u32(value.to_bits());
    }

    /// A `float64`.
    pub fn f64(&mut self, value: f64) {
        self.u64(value.to_bits());
    }

    /// The elements of a `float64` array of fixed length.
    pub fn f64s(&mut self, values: &[f64]) {
        for &value in values {
            self.f64(value);
        }
    }

    /// The length of a sequence or string.
    pub fn length(&mut self, length: usize) {
        self.u32(u32::try_from(length).expect("a message of a recording has fewer than 2^32 elements"));
    }

    /// A `uint8[]`.
    pub fn octets(&mut self, values: &[u8]) {
        self.length(values.len());
        self.bytes.extend_from_slice(values);
    }

    /// An `int8[]`.
    pub fn i8s(&mut self, values: &[i8]) {
        self.length(values.len());
        self.bytes.extend(values.iter().map(|&value| value as u8));
    }

    /// A `float32[]`.
    pub fn f32s(&mut self, values: &[f32]) {
        self.length(values.len());
        self.bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    }

    /// A `string`.
    pub fn text(&mut self, text: &str) {
        self.length(text.len() + 1);
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes.push(0);
    }

    /// A `builtin_interfaces/Time`; its 32-bit seconds end in 2038, later times stay at the end.
    pub fn time(&mut self, ns: i64) {
        let seconds = ns.div_euclid(1_000_000_000).clamp(i32::MIN.into(), i32::MAX.into());
        self.i32(seconds as i32);
        self.u32(ns.rem_euclid(1_000_000_000) as u32);
    }
}

/// Takes values from a message.
pub struct Decoder<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Decoder<'a> {
    /// Starts behind the encapsulation header, which must say little-endian plain CDR.
    pub fn new(bytes: &'a [u8]) -> Result<Self, CdrError> {
        let mut decoder = Self { bytes, at: 0 };
        let header = decoder.take(ENCAPSULATION)?;
        match u16::from_be_bytes([header[0], header[1]]) {
            1 => Ok(decoder),
            other => Err(CdrError::Encapsulation(other)),
        }
    }

    fn take(&mut self, need: usize) -> Result<&'a [u8], CdrError> {
        let left = self.bytes.get(self.at..).unwrap_or_default();
        let Some(taken) = left.get(..need) else {
            return Err(CdrError::Cut { at: self.at, need, left: left.len() });
        };
        self.at += need;
        Ok(taken)
    }

    fn aligned<const N: usize>(&mut self) -> Result<[u8; N], CdrError> {
        self.at = (self.at - ENCAPSULATION).next_multiple_of(N) + ENCAPSULATION;
        let mut value = [0; N];
        value.copy_from_slice(self.take(N)?);
        Ok(value)
    }

    /// A `uint8`, `byte` or `bool`.
    pub fn u8(&mut self) -> Result<u8, CdrError> {
        Ok(self.aligned::<1>()?[0])
    }

    /// A `uint32`.
    pub fn u32(&mut self) -> Result<u32, CdrError> {
        self.aligned().map(u32::from_le_bytes)
    }

    /// An `int32`.
    pub fn i32(&mut self) -> Result<i32, CdrError> {
        self.aligned().map(i32::from_le_bytes)
    }

    /// A `uint64`.
    pub fn u64(&mut self) -> Result<u64, CdrError> {
        self.aligned().map(u64::from_le_bytes)
    }

    /// An `int64`.
    pub fn i64(&mut self) -> Result<i64, CdrError> {
        self.aligned().map(i64::from_le_bytes)
    }

    /// A `float32`.
    pub fn f32(&mut self) -> Result<f32, CdrError> {
        self.aligned().map(f32::from_le_bytes)
    }

    /// A `float64`.
    pub fn f64(&mut self) -> Result<f64, CdrError> {
        self.aligned().map(f64::from_le_bytes)
    }

    /// A `float64` array of fixed length.
    pub fn f64s<const N: usize>(&mut self) -> Result<[f64; N], CdrError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f64()?;
        }
        Ok(values)
    }

    /// The length of a sequence whose elements have at least `element` bytes each; an error where that many cannot
    /// follow, so that a bad length allocates nothing.
    pub fn length(&mut self, element: usize) -> Result<usize, CdrError> {
        let length = self.u32()? as usize;
        let (need, left) = (length.saturating_mul(element), self.bytes.len() - self.at);
        if need > left {
            return Err(CdrError::Cut { at: self.at, need, left });
        }
        Ok(length)
    }

    /// A `uint8[]`, not copied.
    pub fn octets(&mut self) -> Result<&'a [u8], CdrError> {
        let length = self.length(1)?;
        self.take(length)
    }

    /// An `int8[]`.
    pub fn i8s(&mut self) -> Result<Vec<i8>, CdrError> {
        Ok(self.octets()?.iter().map(|&value| value as i8).collect())
    }

    /// A `float32[]`.
    pub fn f32s(&mut self) -> Result<Vec<f32>, CdrError> {
        let length = self.length(4)?;
        let bytes = self.take(4 * length)?;
        Ok(bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
    }

    /// A `string`.
    pub fn text(&mut self) -> Result<String, CdrError> {
        let length = self.length(1)?;
        let at = self.at;
        let bytes = self.take(length)?;
        let text = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        std::str::from_utf8(text).map(str::to_owned).map_err(|_| CdrError::Text { at })
    }

    /// A `builtin_interfaces/Time` in nanoseconds.
    pub fn time(&mut self) -> Result<i64, CdrError> {
        let seconds = self.i32()?;
        Ok(i64::from(seconds) * 1_000_000_000 + i64::from(self.u32()?))
    }
}

#[cfg(test)]
mod tests;
