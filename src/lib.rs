//! A map that sees glass.

pub mod cli;
pub mod config;
pub mod logging;
pub mod map;
pub mod mapper;
pub mod output;
pub mod pose;
pub mod pose_input;
pub mod report;
pub mod scan;
