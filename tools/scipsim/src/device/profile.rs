//! What a simulated device says of itself: the two models and how they differ.

/// Which model is simulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Profile {
    /// UTM-30LX on USB: SCIP 2.0, answers on rotation boundaries while the laser is on.
    Usb,
    /// UTM-30LX-EW on Ethernet: SCIP 2.2, answers at once, has multi-echo commands, %ST and %SL.
    Ethernet,
}

/// What II tells beside the constants.
#[derive(Clone, Copy, Debug)]
pub struct Condition {
    /// Whether the laser is on.
    pub laser: bool,
    /// Whether scans are streamed.
    pub streaming: bool,
    /// Device clock (ms, 24 bits).
    pub clock_ms: u32,
}

impl Profile {
    /// Lines of VV, without sums.
    pub fn version(self, serial: &str) -> Vec<String> {
        let (product, firmware, protocol) = match self {
            Profile::Usb => ("SOKUIKI Sensor TOP-URG UTM-30LX", "sim.1.0(23/Nov./2026)", "SCIP 2.0"),
            Profile::Ethernet => ("UTM-30LX-EW", "sim 1.0 (2026-11-23)", "SCIP 2.2"),
        };
        vec![
            "VEND:Hokuyo Automatic Co.,Ltd.".into(),
            format!("PROD:{product}"),
            format!("FIRM:{firmware}"),
            format!("PROT:{protocol}"),
            format!("SERI:{serial}"),
        ]
    }

    /// Lines of PP, without sums; `rpm` is the speed of the motor.
    pub fn parameters(self, rpm: u32) -> Vec<String> {
        vec![
            format!("MODL:{}", self.model()),
            "DMIN:23".into(),
            "DMAX:60000".into(),
            "ARES:1440".into(),
            "AMIN:0".into(),
            "AMAX:1080".into(),
            "AFRT:540".into(),
            format!("SCAN:{rpm}"),
        ]
    }

    /// Lines of II, without sums.
    pub fn information(self, rpm: u32, condition: Condition) -> Vec<String> {
        let laser = if condition.laser { "ON" } else { "OFF" };
        match self {
            // As a UTM-30LX answered in a capture.
            Profile::Usb => vec![
                format!("MODL:{}", self.model()),
                format!("LASR:{laser}"),
                format!("SCSP:Initial({rpm}[rpm])<-Default setting by user"),
                "MESM:CLASSIC".into(),
                "SBPS:USB Full Speed".into(),
                format!("TIME:{:06X}", condition.clock_ms),
                "STAT:Sensor works well.".into(),
            ],
            Profile::Ethernet => {
                let mut time = Vec::new();
                scip::number::encode(condition.clock_ms, 4, &mut time);
                let mode = match (condition.laser, condition.streaming) {
                    (_, true) => "Measuring",
                    (true, false) => "Single scan",
                    (false, false) => "000 Idle",
                };
                vec![
                    format!("MODL:{}", self.model()),
                    format!("LASR:{laser}"),
                    format!("SCSP:{rpm}"),
                    format!("MESM:{mode}"),
                    "SBPS:Ethernet 100 [Mbps]".into(),
                    format!("TIME:{}", String::from_utf8_lossy(&time)),
                    "STAT:Stable 000 no error.".into(),
                ]
            }
        }
    }

    fn model(self) -> &'static str {
        match self {
            Profile::Usb => "UTM-30LX(Hokuyo Automatic Co.,Ltd.)",
            Profile::Ethernet => "UTM-30LX-EW",
        }
    }
}
