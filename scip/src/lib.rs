//! SCIP 2.0, the protocol of Hokuyo laser scanners.

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
