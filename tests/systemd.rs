//! The files for the system, against the tools that read them, where those are installed.

use std::fs;
use std::process::{Command, Output};

/// Runs a tool; `None`, and says so, where it is not installed.
fn run(program: &str, arguments: &[&str]) -> Option<Output> {
    match Command::new(program).args(arguments).output() {
        Ok(output) => Some(output),
        Err(_) => {
            println!("skipped: {program} is not installed");
            None
        }
    }
}

fn words(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

#[test]
fn the_unit_is_verified_without_a_word() {
    let folder = tempfile::tempdir().unwrap();
    let unit = folder.path().join("visagged.service");
    // Verified are the programs too, and the tests must not need an installed one.
    let text = fs::read_to_string("systemd/visagged.service").unwrap();
    fs::write(&unit, text.replace("/usr/bin/visagged", env!("CARGO_BIN_EXE_visagged"))).unwrap();
    if let Some(output) = run("systemd-analyze", &["verify", unit.to_str().unwrap()]) {
        assert_eq!(words(&output), "", "the exit code is 0 on warnings, so the words count");
        assert!(output.status.success());
    }
}

#[test]
fn the_service_can_do_little_harm() {
    let arguments = ["security", "--offline=true", "--threshold=15", "systemd/visagged.service"];
    if let Some(output) = run("systemd-analyze", &arguments) {
        assert!(output.status.success(), "{}", words(&output));
    }
}

#[test]
fn the_unit_starts_what_there_is() {
    let text = fs::read_to_string("systemd/visagged.service").unwrap();
    for line in [
        "Type=notify",
        "ExecStart=/usr/bin/visagged --config /etc/visagged.toml",
        "RestartPreventExitStatus=2 78",
        "SupplementaryGroups=dialout",
        "RuntimeDirectory=visagged",
        "StateDirectory=visagged",
    ] {
        assert!(text.lines().any(|got| got == line), "{line}");
    }
    let example = visagged::config::Config::load("systemd/visagged.toml".as_ref()).unwrap();
    // Installed and plugged in it maps, with nothing else that tells poses.
    assert_eq!(example.pose.source.to_string(), "match");
    assert!(example.record.folder.starts_with("/var/lib/visagged"));
    assert!(example.output.folder.unwrap().starts_with("/var/lib/visagged"));
}

#[test]
fn the_rule_gives_the_port_of_the_example_its_name() {
    let rules = fs::read_to_string("systemd/20-visagged.rules").unwrap();
    for wanted in [
        "15d1",
        "SYMLINK+=\"hokuyo\"",
        "GROUP=\"dialout\"",
        "ENV{ID_MM_DEVICE_IGNORE}=\"1\"",
        "visagged.service",
    ] {
        assert!(rules.contains(wanted), "{wanted}");
    }
    let example = fs::read_to_string("systemd/visagged.toml").unwrap();
    assert!(example.contains("\nurl = \"/dev/hokuyo\"\n"));
}
