//! The program's words and exit codes.

use std::fs;

use assert_cmd::Command;

fn visagged(arguments: &[&str]) -> (i32, String, String) {
    let output = Command::cargo_bin("visagged")
        .unwrap()
        .args(arguments)
        .env_remove("VISAGGED_LOG")
        .timeout(std::time::Duration::from_secs(60))
        .output()
        .unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (output.status.code().expect("an exit, not a signal"), text(output.stdout), text(output.stderr))
}

#[test]
fn with_nothing_to_do_it_says_what_it_needs() {
    let (code, out, err) = visagged(&[]);
    assert_eq!(code, 2, "{err}");
    assert_eq!(out, "");
    for wanted in ["needs a scanner", "--device sim:hall --out demo", "/dev/ttyACM0", "replay FILE", "--help"]
    {
        assert!(err.contains(wanted), "{err}");
    }
}

#[test]
fn help_and_version_are_no_errors() {
    let (code, out, _) = visagged(&["--help"]);
    assert_eq!(code, 0);
    for wanted in [
        "--device",
        "--record",
        "--pose",
        "--out",
        "--duration",
        "replay",
        "recover",
        "check-config",
        "identify",
        "78",
    ] {
        assert!(out.contains(wanted), "{wanted}: {out}");
    }
    let (code, out, _) = visagged(&["--version"]);
    assert_eq!((code, out.trim()), (0, concat!("visagged ", env!("CARGO_PKG_VERSION"))));
}

#[test]
fn bad_arguments_are_told_with_what_would_be_right() {
    for (arguments, wanted) in [
        (&["--device", "ttyACM0"][..], "tcp://HOST"),
        (&["--device", "tcp://:1"], "names no host"),
        (&["--device", "/dev/null", "--pose", "udp://192.0.2.1:1"], "loopback"),
        (&["--device", "/dev/null", "--pose", "elsewhere"], "unix:PATH"),
        (&["--device", "/dev/null", "--duration", "0"], "larger than 0"),
        (&["--devise", "/dev/null"], "--device"),
        (&["replay", "--out", "map"], "<INPUT>"),
        (&["replay", "file.mcap"], "--out"),
        (&["fly"], "unrecognized subcommand"),
        (&["--out", "map"], "Give --device URL"),
    ] {
        let (code, _, err) = visagged(arguments);
        assert_eq!(code, 2, "{arguments:?}: {err}");
        assert!(err.contains(wanted), "{arguments:?}: {err}");
    }
}

#[test]
fn a_configuration_is_accepted_or_refused_with_line_and_hint() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("visagged.toml");
    let path = file.to_str().unwrap();

    let (code, out, err) = visagged(&["check-config", "systemd/visagged.toml"]);
    assert_eq!(code, 0, "{err}");
    assert!(out.contains("accepted"), "{out}");

    fs::write(&file, "[device]\nurl = \"/dev/ttyACM0\"\n\n[record]\nenable = true\n").unwrap();
    let (code, _, err) = visagged(&["check-config", path]);
    assert_eq!(code, 78);
    for wanted in [path, "line 5, column 1", "unknown field `enable`", "`enabled`"] {
        assert!(err.contains(wanted), "{wanted}: {err}");
    }

    fs::write(&file, "[mapper.mount]\nyaw = 90\n").unwrap();
    let (code, _, err) = visagged(&["--config", path]);
    assert_eq!(code, 78);
    assert!(err.contains("mapper.mount.yaw = 90 is out of range"), "{err}");

    fs::write(&file, "").unwrap();
    let (code, _, err) = visagged(&["--config", path]);
    assert_eq!(code, 78);
    assert!(err.contains("device.url"), "{err}");

    let (code, _, err) = visagged(&["--config", "/no/such/file"]);
    assert_eq!(code, 78);
    assert!(err.contains("/no/such/file") && err.contains("No such file"), "{err}");
}

#[test]
fn a_scanner_that_is_not_there_has_its_exit_code() {
    let (code, _, err) = visagged(&["identify", "/dev/no-such-scanner"]);
    assert_eq!(code, 69, "{err}");
    assert!(err.contains("/dev/no-such-scanner"), "{err}");

    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let (code, _, err) = visagged(&["--device", "/dev/no-such-scanner", "--out", out, "--duration", "0.5"]);
    assert_eq!(code, 69, "{err}");
    assert!(err.contains("waiting for the scanner"), "{err}");
}

#[test]
fn a_folder_that_cannot_be_written_has_its_exit_code() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    let out = file.join("map");
    let (code, _, err) = visagged(&["--device", "/dev/null", "--out", out.to_str().unwrap()]);
    assert_eq!(code, 74, "{err}");
    assert!(err.contains(out.to_str().unwrap()), "{err}");
}

#[test]
fn an_input_that_is_not_there_has_its_exit_code() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("map");
    let (code, _, err) = visagged(&["replay", "/no/such.mcap", "--out", out.to_str().unwrap()]);
    assert_eq!(code, 74, "{err}");
    assert!(err.contains("/no/such.mcap"), "{err}");
}

#[test]
fn a_word_that_is_no_source_of_poses_is_told_what_is() {
    let folder = tempfile::tempdir().unwrap();
    let (log, out) = (folder.path().join("drive.log"), folder.path().join("map"));
    fs::write(&log, "FLASER 2 1 1 0 0 0 0 0 0 1.5 host 1.5\n").unwrap();
    let [log, out] = [&log, &out].map(|path| path.to_str().unwrap());
    let (code, _, err) = visagged(&["replay", log, "--pose", "tff", "--out", out]);
    assert_eq!(code, 2, "{err}");
    for wanted in ["tff", "tf, odom, match, match-ranges, fixed", "TUM"] {
        assert!(err.contains(wanted), "{err}");
    }
}
