//! A map that sees glass.

pub mod cdr;
pub mod cli;
pub mod config;
pub mod exit;
pub mod grid;
pub mod input;
pub mod live;
pub mod localize;
pub mod logging;
pub mod map;
pub mod mapper;
pub mod notify;
pub mod output;
pub mod pose;
pub mod pose_input;
pub mod record;
pub mod recover;
pub mod replay;
pub mod report;
pub mod scan;
