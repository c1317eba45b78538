//! SCIP 2.0, the protocol of Hokuyo laser scanners.

pub mod number;
