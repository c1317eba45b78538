//! The message types themselves, field by field in the order of their definitions.
//!
//! Where a definition nests what nobody here takes apart (a pose with its covariance), the Rust type is flat.

use super::{CdrError, Decoder, Encoder, Message};

/// Text of a type that others use: a line of `=`, its name, its fields.
macro_rules! dependency {
    ($name:literal, $fields:literal) => {
        concat!(
            "================================================================================\nMSG: ",
            $name,
            "\n",
            $fields
        )
    };
}
macro_rules! time {
    () => {
        dependency!("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n")
    };
}
macro_rules! header {
    () => {
        concat!(dependency!("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n"), time!())
    };
}
macro_rules! quaternion {
    () => {
        dependency!("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n")
    };
}
macro_rules! vector3 {
    () => {
        dependency!("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n")
    };
}
macro_rules! pose {
    () => {
        concat!(
            dependency!(
                "geometry_msgs/Pose",
                "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"
            ),
            dependency!("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n"),
            quaternion!()
        )
    };
}

/// `std_msgs/Header`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Header {
    /// Moment of the content (ns of the recording's wall clock).
    pub stamp_ns: i64,
    /// Frame of the content.
    pub frame_id: String,
}

impl Header {
    fn write(&self, out: &mut Encoder<'_>) {
        out.time(self.stamp_ns);
        out.text(&self.frame_id);
    }

    /// Takes the fields; also alone, where the rest of a message does not matter.
    pub fn read(input: &mut Decoder<'_>) -> Result<Self, CdrError> {
        Ok(Self { stamp_ns: input.time()?, frame_id: input.text()? })
    }
}

/// `sensor_msgs/msg/LaserScan`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LaserScan {
    /// Time of the first beam, frame of the scanner.
    pub header: Header,
    /// Bearing of the first beam (rad).
    pub angle_min: f32,
    /// Bearing of the last beam (rad).
    pub angle_max: f32,
    /// Bearing from a beam to the next (rad).
    pub angle_increment: f32,
    /// Time from a beam to the next (s).
    pub time_increment: f32,
    /// Time from a scan to the next (s).
    pub scan_time: f32,
    /// Nearest distance (m).
    pub range_min: f32,
    /// Farthest distance (m).
    pub range_max: f32,
    /// Range of each beam (m), REP-117.
    pub ranges: Vec<f32>,
    /// Intensity of each beam, or none.
    pub intensities: Vec<f32>,
}

impl Message for LaserScan {
    const TYPE: &'static str = "sensor_msgs/msg/LaserScan";
    const SCHEMA: &'static str = concat!(
        "std_msgs/Header header\nfloat32 angle_min\nfloat32 angle_max\nfloat32 angle_increment\n\
         float32 time_increment\nfloat32 scan_time\nfloat32 range_min\nfloat32 range_max\nfloat32[] ranges\n\
         float32[] intensities\n",
        header!()
    );

    fn write(&self, out: &mut Encoder<'_>) {
        self.header.write(out);
        for value in [
            self.angle_min,
            self.angle_max,
            self.angle_increment,
            self.time_increment,
            self.scan_time,
            self.range_min,
            self.range_max,
        ] {
            out.f32(value);
        }
        out.f32s(&self.ranges);
        out.f32s(&self.intensities);
    }

    fn read(input: &mut Decoder<'_>) -> Result<Self, CdrError> {
        Ok(Self {
            header: Header::read(input)?,
            angle_min: input.f32()?,
            angle_max: input.f32()?,
            angle_increment: input.f32()?,
            time_increment: input.f32()?,
            scan_time: input.f32()?,
            range_min: input.f32()?,
            range_max: input.f32()?,
            ranges: input.f32s()?,
            intensities: input.f32s()?,
        })
    }
}

/// `geometry_msgs/Transform`, and `geometry_msgs/Pose`, whose fields are the same.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transform {
    /// x, y, z (m).
    pub translation: [f64; 3],
    /// Quaternion x, y, z, w.
    pub rotation: [f64; 4],
}

impl Default for Transform {
    fn default() -> Self {
        Self { translation: [0.0; 3], rotation: [0.0, 0.0, 0.0, 1.0] }
    }
}

impl Transform {
    fn write(&self, out: &mut Encoder<'_>) {
        out.f64s(&self.translation);
        out.f64s(&self.rotation);
    }

    fn read(input: &mut Decoder<'_>) -> Result<Self, CdrError> {
        Ok(Self { translation: input.f64s()?, rotation: input.f64s()? })
    }
}

/// `geometry_msgs/TransformStamped`: where the child frame is in the header's frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TransformStamped {
    /// Moment, and the parent frame.
    pub header: Header,
    /// The child frame.
    pub child_frame_id: String,
    /// The child frame in its parent.
    pub transform: Transform,
}

/// `tf2_msgs/msg/TFMessage`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TfMessage {
    /// Any number of frames.
    pub transforms: Vec<TransformStamped>,
}

impl Message for TfMessage {
    const TYPE: &'static str = "tf2_msgs/msg/TFMessage";
    const SCHEMA: &'static str = concat!(
        "geometry_msgs/TransformStamped[] transforms\n",
        dependency!(
            "geometry_msgs/TransformStamped",
            "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
        ),
        dependency!(
            "geometry_msgs/Transform",
            "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"
        ),
        vector3!(),
        quaternion!(),
        header!()
    );

    fn write(&self, out: &mut Encoder<'_>) {
        out.length(self.transforms.len());
        for transform in &self.transforms {
            transform.header.write(out);
            out.text(&transform.child_frame_id);
            transform.transform.write(out);
        }
    }

    fn read(input: &mut Decoder<'_>) -> Result<Self, CdrError> {
        // 72: two empty strings' lengths, a time and seven numbers.
        let length = input.length(72)?;
        let mut transforms = Vec::with_capacity(length);
        for _ in 0..length {
            transforms.push(TransformStamped {
                header: Header::read(input)?,
                child_frame_id: input.text()?,
                transform: Transform::read(input)?,
            });
        }
        Ok(Self { transforms })
    }
}

/// `nav_msgs/msg/Odometry`.
#[derive(Clone, Debug, PartialEq)]
pub struct Odometry {
    /// Moment, and the frame in which the pose is given.
    pub header: Header,
    /// Frame whose pose it is.
    pub child_frame_id: String,
    /// The pose.
    pub pose: Transform,
    /// Its covariance, row by row (x, y, z, roll, pitch, yaw).
    pub pose_covariance: [f64; 36],
    /// Linear and angular speed in the child frame (m/s, rad/s).
    pub twist: [f64; 6],
    /// Its covariance.
    pub twist_covariance: [f64; 36],
}

impl Message for Odometry {
    const TYPE: &'static str = "nav_msgs/msg/Odometry";
    const SCHEMA: &'static str = concat!(
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n\
         geometry_msgs/TwistWithCovariance twist\n",
        dependency!("geometry_msgs/PoseWithCovariance", "geometry_msgs/Pose pose\nfloat64[36] covariance\n"),
        dependency!(
            "geometry_msgs/TwistWithCovariance",
            "geometry_msgs/Twist twist\nfloat64[36] covariance\n"
        ),
        dependency!("geometry_msgs/Twist", "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"),
        vector3!(),
        pose!(),
        header!()
    );

    fn write(&self, out: &mut Encoder<'_>) {
        self.header.write(out);
        out.text(&self.child_frame_id);
        self.pose.write(out);
        out.f64s(&self.pose_covariance);
        out.f64s(&self.twist);
        out.f64s(&self.twist_covariance);
    }

    fn read(input: &mut Decoder<'_>) -> Result<Self, CdrError> {
        Ok(Self {
            header: Header::read(input)?,
            child_frame_id: input.text()?,
            pose: Transform::read(input)?,
            pose_covariance: input.f64s()?,
            twist: input.f64s()?,
            twist_covariance: input.f64s()?,
        })
    }
}

/// `nav_msgs/msg/OccupancyGrid`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OccupancyGrid {
    /// Moment and frame of the map.
    pub header: Header,
    /// When the map was made (ns).
    pub map_load_time_ns: i64,
    /// Side of a cell (m).
    pub resolution: f32,
    /// Cells in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Pose of the lower left corner of cell (0, 0).
    pub origin: Transform,
    /// -1 unknown, 0..=100; row by row from the lowest y.
    pub data: Vec<i8>,
}

impl Message for OccupancyGrid {
    const TYPE: &'static str = "nav_msgs/msg/OccupancyGrid";
    const SCHEMA: &'static str = concat!(
        "std_msgs/Header header\nnav_msgs/MapMetaData info\nint8[] data\n",
        dependency!(
            "nav_msgs/MapMetaData",
            "builtin_interfaces/Time map_load_time\nfloat32 resolution\nuint32 width\nuint32 height\n\
             geometry_msgs/Pose origin\n"
        ),
        pose!(),
        header!()
    );

    fn write(&self, out: &mut Encoder<'_>) {
        self.header.write(out);
        out.time(self.map_load_time_ns);
        out.f32(self.resolution);
        out.u32(self.width);
        out.u32(self.height);
        self.origin.write(out);
        out.i8s(&self.data);
    }

    fn read(input: &mut Decoder<'_>) -> Result<Self, CdrError> {
        Ok(Self {
            header: Header::read(input)?,
            map_load_time_ns: input.time()?,
            resolution: input.f32()?,
            width: input.u32()?,
            height: input.u32()?,
            origin: Transform::read(input)?,
            data: input.i8s()?,
        })
    }
}

/// `diagnostic_msgs/DiagnosticStatus`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DiagnosticStatus {
    /// 0 OK, 1 WARN, 2 ERROR, 3 STALE.
    pub level: u8,
    /// What it is about.
    pub name: String,
    /// In a few words.
    pub message: String,
    /// Serial number of the device, where it is about one.
    pub hardware_id: String,
    /// Values by name.
    pub values: Vec<(String, String)>,
}

/// `diagnostic_msgs/msg/DiagnosticArray`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DiagnosticArray {
    /// Moment.
    pub header: Header,
    /// One for each part.
    pub status: Vec<DiagnosticStatus>,
}

impl Message for DiagnosticArray {
    const TYPE: &'static str = "diagnostic_msgs/msg/DiagnosticArray";
    const SCHEMA: &'static str = concat!(
        "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n",
        dependency!(
            "diagnostic_msgs/DiagnosticStatus",
            "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\nstring name\nstring message\n\
             string hardware_id\ndiagnostic_msgs/KeyValue[] values\n"
        ),
        dependency!("diagnostic_msgs/KeyValue", "string key\nstring value\n"),
        header!()
    );

    fn write(&self, out: &mut Encoder<'_>) {
        self.header.write(out);
        out.length(self.status.len());
        for status in &self.status {
            out.u8(status.level);
            out.text(&status.name);
            out.text(&status.message);
            out.text(&status.hardware_id);
            out.length(status.values.len());
            for (key, value) in &status.values {
                out.text(key);
                out.text(value);
            }
        }
    }

    fn read(input: &mut Decoder<'_>) -> Result<Self, CdrError> {
        let header = Header::read(input)?;
        // 17: the level and four lengths.
        let length = input.length(17)?;
        let mut status = Vec::with_capacity(length);
        for _ in 0..length {
            let mut part = DiagnosticStatus {
                level: input.u8()?,
                name: input.text()?,
                message: input.text()?,
                hardware_id: input.text()?,
                values: Vec::new(),
            };
            for _ in 0..input.length(8)? {
                part.values.push((input.text()?, input.text()?));
            }
            status.push(part);
        }
        Ok(Self { header, status })
    }
}

/// `visagge_msgs/msg/ScipBytes`: what one read or write of the scanner's port carried.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ScipBytes<'a> {
    /// Wall clock (ns).
    pub stamp_ns: i64,
    /// Host's monotonic clock (ns) as the decoder saw it.
    pub monotonic_ns: u64,
    /// Bytes of this direction since the session began, before these; a step shows what was not recorded.
    pub stream_offset: u64,
    /// 0 from the device, 1 to the device, 2 a gap: the connection was opened anew or bytes were lost here.
    pub direction: u8,
    /// The bytes.
    pub data: std::borrow::Cow<'a, [u8]>,
}

impl<'a> ScipBytes<'a> {
    /// The message in `bytes` with its data not copied.
    pub fn borrow(bytes: &'a [u8]) -> Result<Self, CdrError> {
        let input = &mut Decoder::new(bytes)?;
        Ok(Self {
            stamp_ns: input.time()?,
            monotonic_ns: input.u64()?,
            stream_offset: input.u64()?,
            direction: input.u8()?,
            data: input.octets()?.into(),
        })
    }
}

impl Message for ScipBytes<'_> {
    const TYPE: &'static str = "visagge_msgs/msg/ScipBytes";
    const SCHEMA: &'static str = concat!(
        "uint8 RECEIVED=0\nuint8 SENT=1\nuint8 GAP=2\nbuiltin_interfaces/Time stamp\nuint64 monotonic_ns\n\
         uint64 stream_offset\nuint8 direction\nuint8[] data\n",
        time!()
    );

    fn write(&self, out: &mut Encoder<'_>) {
        out.time(self.stamp_ns);
        out.u64(self.monotonic_ns);
        out.u64(self.stream_offset);
        out.u8(self.direction);
        out.octets(&self.data);
    }

    fn read(input: &mut Decoder<'_>) -> Result<Self, CdrError> {
        Ok(Self {
            stamp_ns: input.time()?,
            monotonic_ns: input.u64()?,
            stream_offset: input.u64()?,
            direction: input.u8()?,
            data: input.octets()?.to_vec().into(),
        })
    }
}

/// `visagge_msgs/msg/PoseReceived`: a pose exactly as the mapper took it.
///
/// Odometry messages have no place for the count of jumps, and keep a heading as a quaternion; this one keeps every
/// bit of a [`StampedPose`](crate::pose::StampedPose), which an exact replay needs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PoseReceived {
    /// Moment of the pose (ns of the host's monotonic clock).
    pub stamp_ns: i64,
    /// When it was received (ns of the host's monotonic clock).
    pub received_ns: i64,
    /// Scans that the mapper had taken before it took this pose.
    pub scans_before: u64,
    /// Count of the source's jumps.
    pub reset: u32,
    /// Whether `covariance` came with it.
    pub has_covariance: bool,
    /// x, y (m), cosine and sine of the heading.
    pub pose: [f64; 4],
    /// xx, xy, xa, yy, ya, aa (m2, m rad, rad2).
    pub covariance: [f64; 6],
}

impl Message for PoseReceived {
    const TYPE: &'static str = "visagge_msgs/msg/PoseReceived";
    const SCHEMA: &'static str = "int64 stamp_ns\nint64 received_ns\nuint64 scans_before\nuint32 reset\n\
         bool has_covariance\nfloat64 x\nfloat64 y\nfloat64 cos_yaw\nfloat64 sin_yaw\nfloat64[6] covariance\n";

    fn write(&self, out: &mut Encoder<'_>) {
        out.i64(self.stamp_ns);
        out.i64(self.received_ns);
        out.u64(self.scans_before);
        out.u32(self.reset);
        out.u8(self.has_covariance.into());
        out.f64s(&self.pose);
        out.f64s(&self.covariance);
    }

    fn read(input: &mut Decoder<'_>) -> Result<Self, CdrError> {
        Ok(Self {
            stamp_ns: input.i64()?,
            received_ns: input.i64()?,
            scans_before: input.u64()?,
            reset: input.u32()?,
            has_covariance: input.u8()? != 0,
            pose: input.f64s()?,
            covariance: input.f64s()?,
        })
    }
}

/// `visagge_msgs/msg/TaskDone`: the mapper took back a task that was done; see [`closing`](crate::closing).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TaskDone {
    /// Scans that the mapper had taken before.
    pub scans_before: u64,
}

impl Message for TaskDone {
    const TYPE: &'static str = "visagge_msgs/msg/TaskDone";
    const SCHEMA: &'static str = "uint64 scans_before\n";

    fn write(&self, out: &mut Encoder<'_>) {
        out.u64(self.scans_before);
    }

    fn read(input: &mut Decoder<'_>) -> Result<Self, CdrError> {
        Ok(Self { scans_before: input.u64()? })
    }
}
