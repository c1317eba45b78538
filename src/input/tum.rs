//! Pose files as the TUM benchmark has them: `stamp x y z qx qy qz qw` a line, `#` before a comment.

use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion};

use super::InputError;
use super::frames::yaw;
use crate::pose::{StampedPose, pose};

/// Poses of a file, in order of time.
///
/// # Errors
/// Where the file is not there or cannot be read, or a line is not eight numbers.
pub fn read(path: &Path) -> Result<Vec<StampedPose>, InputError> {
    let text = std::fs::read_to_string(path).map_err(|source| match source.kind() {
        // It may be a word that was mistyped.
        std::io::ErrorKind::NotFound => InputError::NoPoseFile { path: path.to_owned() },
        _ => InputError::Io { path: path.to_owned(), source },
    })?;
    parse(&text).map_err(|(line, what)| InputError::Line { path: path.to_owned(), line, what })
}

fn parse(text: &str) -> Result<Vec<StampedPose>, (usize, String)> {
    let mut poses = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let content = line.split('#').next().unwrap_or_default().trim();
        if !content.is_empty() {
            poses.push(parse_line(content).map_err(|what| (index + 1, what))?);
        }
    }
    poses.sort_by_key(|pose| pose.stamp_ns);
    Ok(poses)
}

fn parse_line(line: &str) -> Result<StampedPose, String> {
    let words: Vec<&str> =
        line.split(|c: char| c.is_whitespace() || c == ',').filter(|w| !w.is_empty()).collect();
    let [stamp, rest @ ..] = words.as_slice() else { return Err("no stamp".to_owned()) };
    let stamp_ns = nanoseconds(stamp).ok_or_else(|| format!("{stamp:?} is no stamp in seconds"))?;
    let mut values = [0.0; 7];
    if rest.len() != values.len() {
        return Err(format!("{} numbers, expected 8: stamp x y z qx qy qz qw", words.len()));
    }
    for (value, word) in values.iter_mut().zip(rest) {
        *value = word
            .parse()
            .ok()
            .filter(|value: &f64| value.is_finite())
            .ok_or_else(|| format!("{word:?} is no finite number"))?;
    }
    let [x, y, _, qx, qy, qz, qw] = values;
    let rotation = UnitQuaternion::try_new(Quaternion::new(qw, qx, qy, qz), 1e-9)
        .ok_or_else(|| "the quaternion is zero".to_owned())?;
    let pose = pose(x, y, yaw(&rotation));
    Ok(StampedPose { stamp_ns, received_ns: stamp_ns, pose, covariance: None, reset: 0 })
}

/// Nanoseconds of decimal seconds, exactly: a double loses the last digits of times since 1970.
pub fn nanoseconds(text: &str) -> Option<i64> {
    let (sign, digits) = match text.strip_prefix('-') {
        Some(rest) => (-1, rest),
        None => (1, text),
    };
    let (seconds, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    let is_number = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    if (seconds.is_empty() && fraction.is_empty()) || !is_number(seconds) || !is_number(fraction) {
        // 1.5e9 and the like.
        let value: f64 = text.parse().ok()?;
        return (value.abs() < 9e9).then_some((value * 1e9).round() as i64);
    }
    let seconds: i64 = if seconds.is_empty() { 0 } else { seconds.parse().ok()? };
    let nine_digits: String = fraction.chars().chain(std::iter::repeat('0')).take(9).collect();
    let fraction: i64 = nine_digits.parse().ok()?;
    seconds.checked_mul(1_000_000_000)?.checked_add(fraction).map(|ns| sign * ns)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_file() {
        let poses = parse(
            "# stamp x y z qx qy qz qw\n\n2.5 1 2 0 0 0 1 0 # half a turn\n1.000000001 0 0 0 0 0 0 2\n",
        );
        let poses = poses.unwrap();
        assert_eq!(poses[0].stamp_ns, 1_000_000_001);
        assert_eq!(poses[0].pose, pose(0.0, 0.0, 0.0));
        assert_eq!(poses[1].stamp_ns, 2_500_000_000);
        assert_eq!(poses[1].pose.translation.vector.as_slice(), [1.0, 2.0]);
        assert!((poses[1].pose.rotation.angle().abs() - std::f64::consts::PI).abs() < 1e-12);
    }

    #[test]
    fn bad_lines_are_named() {
        for (text, line, what) in [
            ("1 0 0 0 0 0 0 1\n1 2 3", 2, "3 numbers"),
            ("x 0 0 0 0 0 0 1", 1, "\"x\" is no stamp"),
            ("1 0 0 nan 0 0 0 1", 1, "\"nan\" is no finite"),
            ("1 0 0 0 0 0 0 0", 1, "quaternion is zero"),
        ] {
            let (at, message) = parse(text).unwrap_err();
            assert!(at == line && message.contains(what), "{at}: {message}");
        }
    }

    #[test]
    fn stamps_keep_their_nanoseconds() {
        assert_eq!(nanoseconds("1708550444.669774839"), Some(1_708_550_444_669_774_839));
        assert_eq!(nanoseconds("-0.5"), Some(-500_000_000));
        assert_eq!(nanoseconds("1.5e9"), Some(1_500_000_000_000_000_000));
        for bad in ["", "-", ".", "1.2.3", "inf", "99999999999999"] {
            assert_eq!(nanoseconds(bad), None, "{bad}");
        }
    }
}
