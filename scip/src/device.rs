//! Who the device says it is: the answers to VV, PP and II, verbatim and as values.

use crate::fields::Fields;
use crate::model::{self, Codes, Measurement, Model};
use crate::number;

/// The numbers of PP that turn steps into bearings and raw values into measurements.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Parameters {
    /// MODL; empty where PP has none.
    pub model: String,
    /// Shortest distance measured (DMIN, mm); smaller values are codes.
    pub min_mm: u32,
    /// Longest distance measured (DMAX, mm).
    pub max_mm: u32,
    /// Steps of a whole turn (ARES), at least 1.
    pub steps_per_turn: u32,
    /// First step measured (AMIN).
    pub first_step: u32,
    /// Last step measured (AMAX), not before the first.
    pub last_step: u32,
    /// Step that points forward (AFRT).
    pub front_step: u32,
    /// Speed of rotation (SCAN, turns a minute), at least 1.
    pub rpm: u32,
    /// What values below `min_mm` mean, by the table of models.
    pub codes: Codes,
}

/// A value of PP that is missing or makes no sense.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("PP: {key} is {value:?}, which is no usable number, and the table of models has none for {model:?}")]
pub struct ParametersError {
    /// The key.
    pub key: &'static str,
    /// Its value; empty where the key is missing.
    pub value: String,
    /// MODL as the device wrote it.
    pub model: String,
}

impl Parameters {
    /// Nominal values of a model of the table.
    pub fn of_model(model: &Model) -> Option<Parameters> {
        let nominal = model.nominal?;
        Some(Parameters {
            model: model.name.to_owned(),
            min_mm: nominal.min_mm,
            max_mm: nominal.max_mm,
            steps_per_turn: nominal.steps_per_turn,
            first_step: nominal.first_step,
            last_step: nominal.last_step,
            front_step: nominal.front_step,
            rpm: nominal.rpm,
            codes: model.codes,
        })
    }

    /// Values of PP. A key that is missing is taken from the table; keys that are not known are no error.
    pub fn from_fields(fields: &Fields) -> Result<Parameters, ParametersError> {
        let model = fields.get("MODL").unwrap_or_default();
        let row = model::find(model);
        let nominal = row.and_then(|row| row.nominal);
        let number = |key: &'static str, least: u32, most: u32, nominal: Option<u32>| {
            let value = match fields.get(key) {
                Some(text) => leading_number(text),
                None => nominal,
            };
            value.filter(|value| (least..=most).contains(value)).ok_or_else(|| ParametersError {
                key,
                value: fields.get(key).unwrap_or_default().to_owned(),
                model: model.to_owned(),
            })
        };
        // Steps have four digits, distances 18 bits, on the wire.
        let (steps, distance) = (u32::from(crate::request::MAX_STEP), (1 << 18) - 1);
        let first_step = number("AMIN", 0, steps, nominal.map(|n| n.first_step))?;
        Ok(Parameters {
            model: model.to_owned(),
            min_mm: number("DMIN", 0, distance, nominal.map(|n| n.min_mm))?,
            max_mm: number("DMAX", 1, distance, nominal.map(|n| n.max_mm))?,
            steps_per_turn: number("ARES", 1, 100_000, nominal.map(|n| n.steps_per_turn))?,
            first_step,
            last_step: number("AMAX", first_step, steps, nominal.map(|n| n.last_step))?,
            front_step: number("AFRT", 0, steps, nominal.map(|n| n.front_step))?,
            rpm: number("SCAN", 1, 100_000, nominal.map(|n| n.rpm))?,
            codes: row.map_or(Codes::Unknown, |row| row.codes),
        })
    }

    /// What a raw value says.
    pub fn classify(&self, distance_mm: u32) -> Measurement {
        self.codes.classify(distance_mm, self.min_mm, self.max_mm)
    }

    /// Bearing of a step (rad), counter-clockwise seen from above, 0 forward.
    pub fn bearing(&self, step: f64) -> f64 {
        (step - f64::from(self.front_step)) * self.bearing_per_step()
    }

    /// Angle from one step to the next (rad).
    pub fn bearing_per_step(&self) -> f64 {
        std::f64::consts::TAU / f64::from(self.steps_per_turn)
    }

    /// Time of one turn (ns).
    pub fn turn_ns(&self) -> i64 {
        60_000_000_000 / i64::from(self.rpm)
    }

    /// Time that the beam takes for a number of steps (ns): 60 s / (SCAN * ARES) each.
    pub fn steps_ns(&self, steps: i64) -> i64 {
        steps * 60_000_000_000 / (i64::from(self.rpm) * i64::from(self.steps_per_turn))
    }
}

/// Number at the start of a text: some firmware writes a unit behind it.
fn leading_number(text: &str) -> Option<u32> {
    let text = text.trim();
    let digits = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    text[..digits].parse().ok()
}

/// The device as far as it has introduced itself.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Device {
    /// Answer to VV, verbatim.
    pub version: Option<Fields>,
    /// Answer to PP, verbatim.
    pub parameter_fields: Option<Fields>,
    /// Answer to PP, as values.
    pub parameters: Option<Parameters>,
    /// Last answer to II, verbatim.
    pub state: Option<Fields>,
}

impl Device {
    fn version_field(&self, key: &str) -> Option<&str> {
        self.version.as_ref()?.get(key)
    }

    /// Vendor (VEND).
    pub fn vendor(&self) -> Option<&str> {
        self.version_field("VEND")
    }

    /// Product (PROD).
    pub fn product(&self) -> Option<&str> {
        self.version_field("PROD")
    }

    /// Firmware (FIRM).
    pub fn firmware(&self) -> Option<&str> {
        self.version_field("FIRM")
    }

    /// Protocol (PROT).
    pub fn protocol(&self) -> Option<&str> {
        self.version_field("PROT")
    }

    /// Serial number (SERI): on USB the only way to tell two devices apart.
    pub fn serial_number(&self) -> Option<&str> {
        self.version_field("SERI")
    }

    /// Row of the table of models, by PP's MODL or VV's PROD.
    pub fn model(&self) -> Option<&'static Model> {
        let modl = self.parameter_fields.as_ref().and_then(|fields| fields.get("MODL"));
        modl.and_then(model::find).or_else(|| model::find(self.product()?))
    }

    /// Whether the laser was on when II was last answered (LASR).
    pub fn laser_on(&self) -> Option<bool> {
        match self.state.as_ref()?.get("LASR")? {
            "ON" => Some(true),
            "OFF" => Some(false),
            _ => None,
        }
    }

    /// What the device said of its health (STAT).
    pub fn health(&self) -> Option<&str> {
        self.state.as_ref()?.get("STAT")
    }

    /// Whether STAT is one of the texts that healthy devices send; `None` where there is no STAT.
    pub fn is_healthy(&self) -> Option<bool> {
        const HEALTHY: [&str; 3] = ["sensor works well", "stable 000 no error", "sensor is working normally"];
        let text = self.health()?.trim().trim_end_matches('.').to_ascii_lowercase();
        Some(HEALTHY.contains(&text.as_str()))
    }

    /// The device's clock in the last II (ms, 24 bits): 6 hexadecimal digits or 4 SCIP characters.
    pub fn time_ms(&self) -> Option<u32> {
        let text = self.state.as_ref()?.get("TIME")?;
        match text.len() {
            6 => u32::from_str_radix(text, 16).ok(),
            4 => number::decode(text.as_bytes()),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const UTM: [(&str, &str); 8] = [
        ("MODL", "UTM-30LX(Hokuyo Automatic Co.,Ltd.)"),
        ("DMIN", "23"),
        ("DMAX", "60000"),
        ("ARES", "1440"),
        ("AMIN", "0"),
        ("AMAX", "1080"),
        ("AFRT", "540"),
        ("SCAN", "2400"),
    ];

    #[test]
    fn pp_beats_the_table_and_the_table_fills_gaps() {
        let full = Parameters::from_fields(&Fields::new(UTM)).unwrap();
        assert_eq!((full.min_mm, full.rpm, full.codes), (23, 2400, Codes::Utm));
        let slow = UTM.map(|(key, value)| (key, if key == "SCAN" { "2395" } else { value }));
        assert_eq!(Parameters::from_fields(&Fields::new(slow)).unwrap().rpm, 2395);
        let without_dmin = Fields::new(UTM.into_iter().filter(|(key, _)| *key != "DMIN"));
        assert_eq!(Parameters::from_fields(&without_dmin).unwrap().min_mm, 23);
        let with_more = Fields::new(UTM.into_iter().chain([("PROT", "SCIP 2.2"), ("ZZZZ", "?")]));
        assert_eq!(Parameters::from_fields(&with_more), Ok(full));
    }

    #[test]
    fn numbers_without_sense_are_refused() {
        for (key, value) in [("ARES", "0"), ("SCAN", "0"), ("AMAX", "99999"), ("DMIN", "far")] {
            let bad = UTM.map(|(k, v)| (k, if k == key { value } else { v }));
            assert_eq!(Parameters::from_fields(&Fields::new(bad)).unwrap_err().key, key);
        }
        let unknown = Fields::new([("MODL", "X-1")]);
        assert_eq!(Parameters::from_fields(&unknown).unwrap_err().key, "AMIN");
    }

    #[test]
    fn bearings_and_times_of_a_utm_30lx() {
        let utm = Parameters::of_model(model::find("UTM-30LX").unwrap()).unwrap();
        assert!((utm.bearing(0.0).to_degrees() + 135.0).abs() < 1e-9);
        assert!((utm.bearing(1080.0).to_degrees() - 135.0).abs() < 1e-9);
        assert_eq!(utm.turn_ns(), 25_000_000);
        assert_eq!(utm.steps_ns(180), 3_125_000); // from the rear of the sensor to step 0
    }

    #[test]
    fn both_forms_of_time() {
        let time = |text| {
            let state = Fields::new([("TIME", text)]);
            Device { state: Some(state), ..Device::default() }.time_ms()
        };
        assert_eq!(time("4991D0"), Some(0x4991d0));
        assert_eq!(time("00jX"), Some(0x3a << 6 | 0x28));
        assert_eq!(time("midnight"), None);
    }
}
