//! A map that sees glass.

pub mod map;
pub mod pose;
pub mod scan;
