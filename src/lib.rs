//! A map that sees glass.

pub mod grid;
pub mod map;
pub mod mapper;
pub mod pose;
pub mod scan;
