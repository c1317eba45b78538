//! How the program ends: exit codes by sysexits.h, which a service manager can act on.

use std::fmt;

/// Exit codes other than 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// The command line makes no sense.
    Usage = 2,
    /// There is no scanner.
    NoDevice = 69,
    /// A fault of the program itself: a thread failed.
    Fault = 70,
    /// Reading or writing failed.
    Io = 74,
    /// The configuration was refused.
    Config = 78,
}

/// Why the program ends, and with which code.
#[derive(Debug)]
pub struct Failure {
    /// The code.
    pub exit: Exit,
    /// What to tell.
    pub error: anyhow::Error,
}

impl Failure {
    /// A failure.
    pub fn new(exit: Exit, error: impl Into<anyhow::Error>) -> Self {
        Self { exit, error: error.into() }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:#}", self.error)
    }
}
