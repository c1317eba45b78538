//! SCIP 2.0 and 2.2, the protocol of Hokuyo laser scanners (C-42-03320B), in four layers:
//!
//! 1. **Codec**: [`Request`], [`Reply`] and the streaming [`Decoder`]. Bytes to checked values and back.
//!    Replies survive any chunking; after garbage the next reply is found, and what was skipped is said.
//! 2. **[`Monitor`]**: listens to both directions of a wire. It knows the [`Device`], numbers the scans so
//!    that lost ones show, and estimates the device's clock. It sends nothing, so it serves replays as well.
//! 3. **[`Session`]**: drives a device: start-up, endless stream, errors, reconnection, stop. A state
//!    machine that hears bytes and times and says what to do.
//! 4. **[`transport`]**: serial ports, TCP, capture files. The only layer with I/O.
//!
//! Layers 1 to 3 have no I/O, clock, thread or log. Times are `i64` nanoseconds of the caller's monotonic
//! clock. Distances stay as they were on the wire (mm, with codes below DMIN), intensities keep their 18
//! bits; [`Parameters::classify`] says which values are distances, [`Parameters::bearing`] where they point.
//!
//! What differs between models stands in a table, [`model::MODELS`]; what a device says of itself in PP
//! beats it.
//!
//! # Reading a captured stream
//! ```
//! use scip::{ClockSource, Event, Measurement, Monitor, MonitorOptions, Parameters, model};
//!
//! let parameters = model::find("UTM-30LX").and_then(Parameters::of_model);
//! let mut monitor = Monitor::new(MonitorOptions {
//!     clock: ClockSource::Device, // the times of arrival are not known
//!     parameters,                 // the capture has no answer to PP
//!     ..MonitorOptions::default()
//! });
//! monitor.on_received(0, b"GE0540054201\n00P\nBI9YM\n00]0LA00`0Kd00a0L06\n\n");
//! let Some(Event::Scan(scan)) = monitor.next_event() else { panic!("a scan") };
//! assert_eq!(scan.distances_mm, [45, 48, 49]);
//! assert_eq!(scan.intensities, [1809, 1780, 1792]);
//!
//! let parameters = monitor.parameters().unwrap();
//! assert_eq!(parameters.classify(scan.distances_mm[0]), Measurement::Millimetres(45));
//! assert_eq!(parameters.classify(1), Measurement::NothingInRange);
//! assert_eq!(parameters.bearing(scan.step(0).into()), 0.0);
//! ```
//!
//! # Driving a device
#![doc = concat!("```no_run\n", include_str!("../examples/drive.rs"), "```")]

mod clock;
pub mod decoder;
pub mod device;
pub mod event;
pub mod fields;
pub mod model;
pub mod monitor;
pub mod number;
pub mod reply;
pub mod request;
pub mod scan;
pub mod session;
pub mod status;
pub mod transport;

pub use decoder::{DecodeError, DecodeErrorKind, Decoder, Located};
pub use device::{Device, Parameters, ParametersError};
pub use event::{Event, Rate, SessionEvent, Synchronisation, Trouble};
pub use fields::Fields;
pub use model::{Codes, Measurement, Model, Profile};
pub use monitor::{ClockSource, Monitor, MonitorOptions, StampReference};
pub use reply::{Body, Echo, FurtherEcho, Reply, ScanData};
pub use request::{Command, Request, RequestError, ScanKind, ScanRequest, Text};
pub use scan::Scan;
pub use session::{Action, Patience, Purpose, Session, SessionSettings, State, Window};
pub use status::Status;
