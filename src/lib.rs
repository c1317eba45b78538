//! A map that sees glass.

pub mod cdr;
pub mod map;
pub mod pose;
pub mod record;
pub mod scan;
