//! A map that sees glass.

pub mod cdr;
pub mod grid;
pub mod input;
pub mod map;
pub mod mapper;
pub mod pose;
pub mod record;
pub mod recover;
pub mod replay;
pub mod scan;
