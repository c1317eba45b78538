//! Where log lines go: a terminal gets time and colour, systemd's journal gets its own priority prefix.
//!
//! Level from `VISAGGED_LOG` (as env_logger reads it), `info` otherwise.

use std::io::{self, IsTerminal, Write};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use log::Level;

/// The line that stands on the terminal, if there is one; log lines are written above it.
static LINE: Mutex<Option<ProgressBar>> = Mutex::new(None);

/// Installs the logger. Lines go to stderr.
pub fn init() {
    let env = env_logger::Env::new().filter_or("VISAGGED_LOG", "info");
    let mut builder = env_logger::Builder::from_env(env);
    if stderr_is_the_journal(std::env::var("JOURNAL_STREAM").ok().as_deref()) {
        builder.format(|out, record| {
            writeln!(out, "{}", journal_line(record.level(), record.target(), &record.args().to_string()))
        });
    } else {
        builder.format_target(false);
        if io::stderr().is_terminal() {
            builder.write_style(env_logger::WriteStyle::Always);
            builder.target(env_logger::Target::Pipe(Box::new(AboveTheLine)));
        }
    }
    builder.init();
}

/// A line at the bottom of the terminal that says how far things are. There is one at a time.
#[derive(Debug)]
pub struct Progress(());

impl Progress {
    /// Puts an empty line on stderr.
    pub fn start() -> Self {
        let line = ProgressBar::new_spinner();
        line.set_style(ProgressStyle::with_template("{spinner} {msg}").expect("the template is right"));
        line.enable_steady_tick(Duration::from_millis(200));
        *LINE.lock().unwrap_or_else(PoisonError::into_inner) = Some(line);
        Self(())
    }

    /// Changes the line.
    pub fn show(&self, text: &str) {
        if let Some(line) = &*LINE.lock().unwrap_or_else(PoisonError::into_inner) {
            line.set_message(text.to_owned());
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(line) = LINE.lock().unwrap_or_else(PoisonError::into_inner).take() {
            line.finish_and_clear();
        }
    }
}

/// Stderr, with the line taken away while something is written.
struct AboveTheLine;

impl Write for AboveTheLine {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &*LINE.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(line) => line.suspend(|| io::stderr().write_all(bytes))?,
            None => io::stderr().write_all(bytes)?,
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}

/// sd-daemon(3): `<3>` error .. `<7>` debug at the start of each line.
fn journal_line(level: Level, target: &str, message: &str) -> String {
    let priority = match level {
        Level::Error => 3,
        Level::Warn => 4,
        Level::Info => 6,
        Level::Debug | Level::Trace => 7,
    };
    let lines: Vec<_> = message.lines().map(|line| format!("<{priority}>{target}: {line}")).collect();
    lines.join("\n")
}

/// systemd.exec(5): `JOURNAL_STREAM` names device and inode of the journal's socket; stderr may lead elsewhere.
fn stderr_is_the_journal(stream: Option<&str>) -> bool {
    let Some((device, inode)) = stream.and_then(|stream| stream.split_once(':')) else { return false };
    let Ok(stderr) = rustix::fs::fstat(std::io::stderr()) else { return false };
    device.parse() == Ok(stderr.st_dev) && inode.parse() == Ok(stderr.st_ino)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_line_for_the_journal_has_its_priority() {
        assert_eq!(
            journal_line(Level::Warn, "visagged::live", "a\nb"),
            "<4>visagged::live: a\n<4>visagged::live: b"
        );
        assert_eq!(journal_line(Level::Trace, "x", "y"), "<7>x: y");
    }

    #[test]
    fn the_journal_is_told_by_device_and_inode() {
        let stderr = rustix::fs::fstat(std::io::stderr()).unwrap();
        let (device, inode) = (stderr.st_dev, stderr.st_ino);
        assert!(stderr_is_the_journal(Some(&format!("{device}:{inode}"))));
        assert!(!stderr_is_the_journal(Some(&format!("{device}:{}", inode + 1))));
        assert!(!stderr_is_the_journal(Some("nonsense")));
        assert!(!stderr_is_the_journal(None));
    }
}
