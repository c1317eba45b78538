//! Marks maps: of simulated drives against the truth (the paper's table and figures), and of real ones against each other.
//!
//! - [`plan`]: which drives; [`contender`]: which mappers; [`mark`]: the runs; [`table`], [`page`]: what comes of them.
//! - [`figures`]: the paper's figures. [`compare`]: two maps, cell by cell.

mod canvas;
mod compare;
mod contender;
mod drive;
mod figures;
mod mark;
mod page;
mod picture;
mod plan;
mod plot;
mod table;
mod why;

use anyhow::Result;
use clap::{Parser, Subcommand};

/// Marks mappers against the truth of simulated drives; without arguments, all of them on all worlds.
#[derive(Parser)]
#[command(args_conflicts_with_subcommands = true)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    mark: mark::Arguments,
}

#[derive(Subcommand)]
enum Command {
    /// Draw the paper's figures 2, 6, 7, 9 and 10 from the simulator.
    Figures(figures::Arguments),
    /// Compare the occupied cells of two maps that `visagged replay` has written.
    Compare(compare::Arguments),
}

fn main() -> Result<()> {
    let cli = Cli::parse();
    match cli.command {
        None => mark::run(&cli.mark),
        Some(Command::Figures(arguments)) => figures::run(&arguments),
        Some(Command::Compare(arguments)) => compare::run(&arguments),
    }
}
