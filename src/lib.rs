//! A map that sees glass: the parts of the daemon `visagged`.
//!
//! Bytes and time go in, a map comes out:
//!
//! ```text
//! scanner --bytes--> scip::Session --scans--> Mapper --sweeps--> grid::Visagge --> Map --> files
//!                                               ^
//! localizer --datagrams--> pose_input --poses---+
//! ```
//!
//! - The crate `scip` reads the wire. [`scan`], [`pose`] and [`map`] are what the parts share: SI units, x forward,
//!   y left, counter-clockwise positive (REP-103). Device units end in [`scan`].
//! - [`mapper`] owns the grid and the poses. It has no clock and no thread: it is a function of the order of its calls.
//! - [`localize`] finds the poses by matching where nothing outside tells them, on maps of its own.
//! - [`closing`] keeps the scans that were matched, closes the drive's loops and has the map made anew of them. What takes long is
//!   done outside of the mapper; when it was done is recorded.
//! - [`grid`] holds the VisAGGE grid ([`grid::visagge`], the paper's core algorithm; [`grid::verdict`], which cells
//!   are shown) and the standard one for comparison. It knows neither time nor files.
//! - [`live`] gives the mapper threads, bounded queues and clocks. [`record`] keeps what came, in the order in which
//!   the mapper took it; [`replay`] with [`input`] gives it back through the same decoder. So a live run and the
//!   replay of its recording end in the same map, bit by bit.
//! - [`saved`] is the file by which a map lives on from run to run.
//! - [`output`] and [`report`] write what is left of a run; [`config`], [`cli`], [`exit`], [`logging`] and [`notify`]
//!   are the manners of a daemon.
//!
//! Only `live`, `output`, `record`, `saved`, `input` and the program itself touch files, sockets or clocks. (The mapper reads the CPU
//! time of its thread, for the report only.)

pub mod cdr;
pub mod cli;
pub mod closing;
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
pub mod saved;
pub mod scan;
