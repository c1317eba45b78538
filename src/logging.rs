//! Where log lines go: a terminal gets time and colour, systemd's journal gets its own priority prefix.
//!
//! Level from `VISAGGED_LOG` (as env_logger reads it), `info` otherwise.

use std::io::Write;

use log::Level;

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
    }
    builder.init();
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
