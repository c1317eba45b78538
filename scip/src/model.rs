//! What differs between models, as a table. It names the device that was not asked yet and the codes that
//! stand among the distances; what PP says beats it.

/// How a device is connected, which decides how patient the start-up is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Profile {
    /// USB CDC-ACM: the laser may refuse to start for 10 s after plugging in.
    Usb,
    /// Ethernet: TM0 may fail for some seconds after the connection was accepted.
    Ethernet,
}

/// Meaning of the distances below DMIN, by family of models.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Codes {
    /// UTM, UST, UXM: 1 nothing in range, 2 too near, 3 measurement error or interference, 4 out of range
    /// at the near end, 5 other.
    Utm,
    /// URG, UBG, UHG: 0 possibly 22 m, 1..5 low intensity, 6 other, 7 neighbours bad, 8 waves disagree,
    /// 9 same step bad twice, 10..17 other, 18 strong reflector, 19 not measurable.
    Urg,
    /// Not known: no code is given a meaning.
    Unknown,
}

/// What one value on the wire says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measurement {
    /// A distance.
    Millimetres(u32),
    /// The beam met nothing within reach (REP-117: +inf).
    NothingInRange,
    /// Something is nearer than the device can measure (REP-117: -inf).
    TooNear,
    /// No valid measurement; the code says why (REP-117: NaN).
    Invalid(u32),
}

impl Codes {
    /// What `distance_mm` says on a device that measures `min_mm..=max_mm`.
    pub fn classify(self, distance_mm: u32, min_mm: u32, max_mm: u32) -> Measurement {
        match (self, distance_mm) {
            (_, d) if d > max_mm => Measurement::NothingInRange,
            (_, d) if d >= min_mm => Measurement::Millimetres(d),
            (Codes::Utm, 1) => Measurement::NothingInRange,
            (Codes::Utm, 2) => Measurement::TooNear,
            (_, code) => Measurement::Invalid(code),
        }
    }

    /// What a code below DMIN means, for people.
    pub fn meaning(self, code: u32) -> &'static str {
        match (self, code) {
            (Codes::Utm, 1) => "nothing in range",
            (Codes::Utm, 2) => "too near",
            (Codes::Utm, 3) => "measurement error or interference",
            (Codes::Utm, 4) => "out of range at the near end",
            (Codes::Utm, 5) => "other",
            (Codes::Urg, 0) => "possibly 22 m",
            (Codes::Urg, 1..=5) => "low intensity",
            (Codes::Urg, 6 | 10..=17) => "other",
            (Codes::Urg, 7) => "neighbours are bad",
            (Codes::Urg, 8) => "the waves disagree",
            (Codes::Urg, 9) => "the same step was bad twice",
            (Codes::Urg, 18) => "strong reflector",
            (Codes::Urg, 19) => "not measurable",
            _ => "unknown code",
        }
    }
}

/// How II writes the device's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TimeFormat {
    /// 6 hexadecimal digits (USB models).
    Hex,
    /// 4 SCIP characters (Ethernet models).
    Scip,
}

/// Nominal values, those that PP reports on a device of this model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Nominal {
    /// Shortest distance measured (mm).
    pub min_mm: u32,
    /// Longest distance measured (mm).
    pub max_mm: u32,
    /// Steps of a whole turn.
    pub steps_per_turn: u32,
    /// First step that is measured.
    pub first_step: u32,
    /// Last step that is measured.
    pub last_step: u32,
    /// Step that points forward.
    pub front_step: u32,
    /// Speed of rotation (turns a minute).
    pub rpm: u32,
}

/// One row of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Model {
    /// Name as it begins in PP's MODL and stands in VV's PROD.
    pub name: &'static str,
    /// How it is connected.
    pub profile: Profile,
    /// How II writes the clock.
    pub time_format: TimeFormat,
    /// What its codes mean.
    pub codes: Codes,
    /// What PP says nominally, where it was seen in a capture or a driver.
    pub nominal: Option<Nominal>,
}

const UTM_30LX: Nominal = Nominal {
    min_mm: 23,
    max_mm: 60_000,
    steps_per_turn: 1440,
    first_step: 0,
    last_step: 1080,
    front_step: 540,
    rpm: 2400,
};

const fn usb(name: &'static str, codes: Codes, nominal: Option<Nominal>) -> Model {
    Model { name, profile: Profile::Usb, time_format: TimeFormat::Hex, codes, nominal }
}

const fn ethernet(name: &'static str, nominal: Option<Nominal>) -> Model {
    Model { name, profile: Profile::Ethernet, time_format: TimeFormat::Scip, codes: Codes::Utm, nominal }
}

/// The models that are known. Numbers of the UTM-30LX, URG-04LX and UXM-30LX-E are from captures of real
/// devices, the others from drivers.
pub const MODELS: &[Model] = &[
    usb("UTM-30LX", Codes::Utm, Some(UTM_30LX)),
    ethernet("UTM-30LX-EW", Some(UTM_30LX)),
    ethernet("UST-10LX", Some(Nominal { min_mm: 20, max_mm: 30_000, ..UTM_30LX })),
    ethernet("UST-20LX", None),
    ethernet("UST", None),
    // An Ethernet model, but the captured one reports USB and writes its time in hexadecimal.
    Model {
        name: "UXM-30LX-E",
        profile: Profile::Ethernet,
        time_format: TimeFormat::Hex,
        codes: Codes::Utm,
        nominal: Some(Nominal {
            min_mm: 100,
            max_mm: 100_000,
            last_step: 760,
            front_step: 380,
            rpm: 1200,
            ..UTM_30LX
        }),
    },
    usb("UXM", Codes::Utm, None),
    usb(
        "URG-04LX",
        Codes::Urg,
        Some(Nominal {
            min_mm: 20,
            max_mm: 5600,
            steps_per_turn: 1024,
            first_step: 44,
            last_step: 725,
            front_step: 384,
            rpm: 600,
        }),
    ),
    usb("URG", Codes::Urg, None),
    usb("UBG", Codes::Urg, None),
    usb("UHG", Codes::Urg, None),
];

/// Model of which MODL or PROD speaks: the longest name that stands in the text as words of their own.
pub fn find(text: &str) -> Option<&'static Model> {
    let names = |model: &&Model| {
        text.match_indices(model.name).any(|(at, _)| {
            let before = text[..at].chars().next_back();
            // "TOP-URG UTM-30LX" and "Tough-URG UXM" name a series before the model.
            !before.is_some_and(|c| c.is_ascii_alphanumeric() || c == '-')
        })
    };
    MODELS.iter().filter(names).max_by_key(|model| model.name.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_as_devices_write_them() {
        for (text, name) in [
            ("UTM-30LX(Hokuyo Automatic Co.,Ltd.)", "UTM-30LX"),
            ("SOKUIKI Sensor TOP-URG UTM-30LX", "UTM-30LX"),
            ("UTM-30LX-EW", "UTM-30LX-EW"),
            ("SOKUIKI Sensor Tough-URG UXM-30LX-E", "UXM-30LX-E"),
            ("SOKUIKI Sensor URG-04LX", "URG-04LX"),
            ("URG-04LX-UG01(Simple-URG)", "URG-04LX"),
            ("UBG-04LX-F01", "UBG"),
        ] {
            assert_eq!(find(text).map(|model| model.name), Some(name), "{text}");
        }
        assert_eq!(find("SICK LMS-200"), None);
    }

    #[test]
    fn codes_are_no_distances() {
        use Measurement::*;
        let utm = |d| Codes::Utm.classify(d, 23, 60_000);
        let seen: Vec<_> = [0, 1, 2, 3, 4, 5, 22, 23, 60_000, 60_001].map(utm).into();
        let invalid = [Invalid(3), Invalid(4), Invalid(5), Invalid(22)];
        assert_eq!(seen[..3], [Invalid(0), NothingInRange, TooNear]);
        assert_eq!(seen[3..7], invalid);
        assert_eq!(seen[7..], [Millimetres(23), Millimetres(60_000), NothingInRange]);
        assert_eq!(Codes::Urg.classify(1, 20, 5600), Invalid(1));
        assert_eq!(Codes::Unknown.classify(1, 20, 5600), Invalid(1));
    }
}
