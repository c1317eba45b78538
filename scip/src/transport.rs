//! Ports that carry SCIP: serial, TCP, and captures read as if they were one. Thin: no protocol in here.
//! Reads wait for a while at most; reads and writes go on after a signal (EINTR) and after a short write.

mod address;
mod capture;
mod ports;
mod serial;
mod tcp;

use std::io;
use std::time::Duration;

pub use address::{Address, AddressError, DEFAULT_BAUD, DEFAULT_TCP_PORT};
pub use capture::CaptureFile;
pub use ports::{FoundPort, list_ports};
pub use serial::SerialPort;
pub use tcp::TcpPort;

/// What a read brought.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// So many bytes, at least one.
    Bytes(usize),
    /// Nothing within the time.
    Nothing,
    /// The other side is gone; nothing more will come.
    Closed,
}

/// A connection to a device.
pub trait Transport: Send {
    /// Reads what is there, waiting for the first byte for `timeout` at most.
    ///
    /// # Errors
    /// Those of the system, never `Interrupted`, `WouldBlock` or `TimedOut`.
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<Received>;

    /// Writes everything.
    ///
    /// # Errors
    /// Those of the system; `TimedOut` where the port takes nothing for [`WRITE_TIMEOUT`].
    fn write_all(&mut self, bytes: &[u8]) -> io::Result<()>;
}

/// A port that takes no byte for this long is taken for dead: requests have 32 bytes at most.
pub const WRITE_TIMEOUT: Duration = Duration::from_secs(1);

/// Sorts out what a system's read gave; `None` asks for another attempt.
fn received(outcome: io::Result<usize>) -> Option<io::Result<Received>> {
    match outcome {
        Ok(0) => Some(Ok(Received::Closed)),
        Ok(count) => Some(Ok(Received::Bytes(count))),
        Err(error) => match error.kind() {
            io::ErrorKind::Interrupted => None,
            io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => Some(Ok(Received::Nothing)),
            _ => Some(Err(error)),
        },
    }
}
