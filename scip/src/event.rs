//! What monitor and session report: values that a log can print and a program can count.

use crate::decoder::DecodeError;
use crate::device::ParametersError;
use crate::reply::Reply;
use crate::request::Request;
use crate::scan::Scan;
use crate::status::Status;
use std::fmt;

/// Something seen on the wire, or done by the session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    /// A scan that was asked for.
    Scan(Scan),
    /// A scan that nobody asked for on this connection: the device was left streaming.
    StrayScan(Scan),
    /// Any other reply.
    Reply(Reply),
    /// Bytes that were no reply.
    Skipped(DecodeError),
    /// Scans are missing before scan `seq`, by the stamps.
    Lost {
        /// Number of the scan after the hole.
        seq: u64,
        /// How many are missing.
        scans: u64,
    },
    /// Another scan carries the stamp of the one before: the device is stuck.
    StuckStamp {
        /// The stamp (ms).
        stamp_ms: u32,
        /// How many scans have carried it.
        scans: u32,
    },
    /// The device's clock began anew.
    ClockReset {
        /// Last stamp before (ms, 24 bits).
        before_ms: u32,
        /// First stamp after (ms, 24 bits).
        after_ms: u32,
    },
    /// TM rounds have tied the device's clock to the host's.
    Synchronised(Synchronisation),
    /// Scans have begun to arrive slower than the device turns, or do so no more.
    Rate(Rate),
    /// PP makes no sense.
    BadParameters(ParametersError),
    /// The session did or noticed something.
    Session(SessionEvent),
}

/// Result of the TM rounds so far.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Synchronisation {
    /// Rounds that were used.
    pub rounds: u32,
    /// Shortest round trip (ns).
    pub fastest_ns: i64,
    /// Host's time when the device's unwrapped clock was 0 (ns).
    pub offset_ns: i64,
    /// Largest error of the offset, half the width of what all rounds allow (ns).
    pub uncertainty_ns: i64,
}

/// Scans delivered over a while of the device's time, beside those it should have delivered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rate {
    /// Scans received.
    pub received: u64,
    /// Scans that were due by the stamps.
    pub due: u64,
    /// How long that was, by the device's clock (ms).
    pub over_ms: i64,
    /// Whether fewer than nine in ten arrived.
    pub is_slow: bool,
}

/// Why a session gave a connection up or began the start-up again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trouble {
    /// No reply to a request after all attempts.
    NoReply(Request),
    /// A request was refused for good.
    Refused(Request, Status),
    /// The stream was ended by a hardware fault or another status.
    StreamEnded(Status),
    /// No scan came for this long (ns).
    Silent(i64),
    /// The stamps stand still.
    StuckStamps(u32),
    /// The device takes an error for too long to verify.
    VerifyingTooLong(Status),
    /// PP was answered but cannot be used.
    UnusableParameters,
    /// The window of the settings holds no step of this device.
    EmptyWindow,
}

/// What the session reports beside what its monitor sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SessionEvent {
    /// A connection was opened.
    Opened,
    /// The connection is closed; the next attempt is due after this long (ns), if there is one.
    Closed {
        /// Wait before the next attempt (ns).
        retry_in_ns: Option<i64>,
    },
    /// A request had to be sent again.
    Retry {
        /// The request.
        request: Request,
        /// Attempts so far.
        attempts: u32,
    },
    /// The device was found in SCIP 1.1 and is switched.
    SwitchingFromScip1,
    /// The device was found in the time mode and is taken out.
    LeavingTimeMode,
    /// The clock could not be read; stamps rest on the stream alone.
    NotSynchronised,
    /// STAT is not among the texts of healthy devices, read several times.
    Unhealthy,
    /// The stream was accepted.
    Streaming(Request),
    /// The device holds the stream to verify an error.
    Verifying(Status),
    /// The stream goes on after an error.
    Resumed,
    /// Why the session starts again or gives up.
    Trouble(Trouble),
    /// The device is told to reboot.
    Rebooting,
    /// VV, PP and II were answered and nothing more is wanted.
    Identified,
    /// The session has ended.
    Stopped,
}

fn ms(ns: i64) -> f64 {
    ns as f64 / 1e6
}

impl fmt::Display for Trouble {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Trouble::NoReply(request) => write!(f, "no reply to {request}; is this the scanner's port?"),
            Trouble::Refused(request, status) => write!(f, "{request} was refused: {status}"),
            Trouble::StreamEnded(status) => write!(f, "the stream ended: {status}"),
            Trouble::Silent(ns) => write!(f, "no scan for {:.0} ms", ms(*ns)),
            Trouble::StuckStamps(scans) => write!(f, "{scans} scans with one stamp, the device is stuck"),
            Trouble::VerifyingTooLong(status) => write!(f, "the stream did not resume: {status}"),
            Trouble::UnusableParameters => write!(f, "the answer to PP cannot be used"),
            Trouble::EmptyWindow => write!(f, "the window of the settings holds no step of this device"),
        }
    }
}

impl fmt::Display for SessionEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            SessionEvent::Opened => write!(f, "connection opened"),
            SessionEvent::Closed { retry_in_ns: Some(ns) } => {
                write!(f, "connection closed, next attempt in {:.0} ms", ms(*ns))
            }
            SessionEvent::Closed { retry_in_ns: None } => write!(f, "connection closed"),
            SessionEvent::Retry { request, attempts } => {
                write!(f, "sending {request} again, after {attempts} attempts")
            }
            SessionEvent::SwitchingFromScip1 => write!(f, "the device speaks SCIP 1.1, switching it"),
            SessionEvent::LeavingTimeMode => write!(f, "the device was left in the time mode, taking it out"),
            SessionEvent::NotSynchronised => {
                write!(f, "the device's clock could not be read, stamps rest on arrival times alone")
            }
            SessionEvent::Unhealthy => write!(f, "the device does not report itself healthy (STAT)"),
            SessionEvent::Streaming(request) => write!(f, "streaming {request}"),
            SessionEvent::Verifying(status) => write!(f, "the stream is held: {status}"),
            SessionEvent::Resumed => write!(f, "the stream goes on"),
            SessionEvent::Trouble(trouble) => trouble.fmt(f),
            SessionEvent::Rebooting => write!(f, "rebooting the device"),
            SessionEvent::Identified => write!(f, "device identified"),
            SessionEvent::Stopped => write!(f, "session stopped"),
        }
    }
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Event::Scan(scan) => write!(f, "scan {} at {} ms", scan.seq, scan.stamp_ms),
            Event::StrayScan(scan) => write!(f, "scan at {} ms that was not asked for", scan.stamp_ms),
            Event::Reply(reply) => match &reply.echo {
                crate::Echo::Request(request) => write!(f, "{request}: {}", reply.status),
                crate::Echo::Other(line) => write!(f, "{}: {}", line.escape_ascii(), reply.status),
            },
            Event::Skipped(error) => error.fmt(f),
            Event::Lost { seq, scans } => write!(f, "scans lost before scan {seq}: {scans}"),
            Event::StuckStamp { stamp_ms, scans } => write!(f, "{scans} scans carry the stamp {stamp_ms} ms"),
            Event::ClockReset { before_ms, after_ms } => {
                write!(f, "the device's clock went from {before_ms} to {after_ms} ms")
            }
            Event::Synchronised(sync) => write!(
                f,
                "clock read in {} rounds, fastest {:.3} ms, to within {:.3} ms",
                sync.rounds,
                ms(sync.fastest_ns),
                ms(sync.uncertainty_ns)
            ),
            Event::Rate(rate) => write!(
                f,
                "{} of {} scans arrived in {} ms{}",
                rate.received,
                rate.due,
                rate.over_ms,
                if rate.is_slow {
                    "; the link is too slow: set skip, cluster, a smaller window, or no intensity"
                } else {
                    ""
                }
            ),
            Event::BadParameters(error) => error.fmt(f),
            Event::Session(event) => event.fmt(f),
        }
    }
}
