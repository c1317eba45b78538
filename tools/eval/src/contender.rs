//! What is marked: a kind of mapper with its settings, some of them overridden.

use anyhow::{Context, Result, bail};
use visagged::grid::idea::Idea;
use visagged::mapper::{MapperKind, MapperSettings};

/// A setting in the place of the default: `key=value`, where the value is TOML and the key that of the mapper's table
/// or of its table `visagge`.
#[derive(Clone, Debug, PartialEq)]
pub struct Override {
    key: String,
    value: toml::Value,
}

impl std::str::FromStr for Override {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (key, value) = text.split_once('=').ok_or("KEY=VALUE is wanted, such as two_ranges=false")?;
        let parsed: toml::Table = toml::from_str(&format!("value = {}", value.trim()))
            .map_err(|_| format!("`{value}` is no TOML value; text needs quotes"))?;
        Ok(Override { key: key.trim().into(), value: parsed["value"].clone() })
    }
}

impl std::fmt::Display for Override {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{}={}", self.key, self.value)
    }
}

/// Each idea of ours left out by itself.
pub fn each_idea() -> Vec<Override> {
    let without = |idea: &Idea| Override {
        key: "without".into(),
        value: vec![toml::Value::try_from(idea).expect("an idea is a name")].into(),
    };
    let settings = [("two_ranges", false.into()), ("body_radius", 0.0.into()), ("look_every", 0.0.into())];
    let settings = settings.map(|(key, value)| Override { key: key.into(), value });
    Idea::ALL.iter().map(without).chain(settings).collect()
}

/// A mapper that is marked.
#[derive(Clone, Debug)]
pub struct Contender {
    /// Its row's name.
    pub name: String,
    /// Its settings.
    pub settings: MapperSettings,
}

/// The contenders: each kind with the settings, and the first kind once more for each of the ablations.
pub fn contenders(
    kinds: &[MapperKind],
    settings: &MapperSettings,
    ablations: &[Override],
) -> Result<Vec<Contender>> {
    let name = |kind: MapperKind| format!("{kind:?}").to_lowercase();
    let plain = kinds.iter().map(|&kind| {
        Ok(Contender { name: name(kind), settings: MapperSettings { mapper: kind, ..settings.clone() } })
    });
    let without = ablations.iter().map(|change| {
        let mapper = kinds.first().copied().unwrap_or_default();
        let settings = apply(settings, std::slice::from_ref(change))?;
        Ok(Contender { name: change.to_string(), settings: MapperSettings { mapper, ..settings } })
    });
    plain.chain(without).collect()
}

/// The settings with these overrides.
pub fn apply(settings: &MapperSettings, overrides: &[Override]) -> Result<MapperSettings> {
    let mut table = toml::Table::try_from(settings).context("settings are a table")?;
    for change in overrides {
        let table = match change.key.strip_prefix("visagge.") {
            None if table.contains_key(&change.key) => &mut table,
            _ => table["visagge"].as_table_mut().context("visagge is a table")?,
        };
        let key = change.key.strip_prefix("visagge.").unwrap_or(&change.key);
        if !table.contains_key(key) {
            bail!("no setting `{key}`; known are {}", table.keys().cloned().collect::<Vec<_>>().join(", "));
        }
        table.insert(key.into(), change.value.clone());
    }
    table.try_into().context("these settings do not fit")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_overridden_by_name() {
        let change = |text: &str| text.parse::<Override>().unwrap();
        let settings = MapperSettings::default();
        let changed = apply(&settings, &[change("resolution=0.1"), change("two_ranges = false")]).unwrap();
        assert_eq!(changed.resolution, 0.1);
        assert!(!changed.visagge.two_ranges && settings.visagge.two_ranges);
        assert!(apply(&settings, &[change("visagge.two_rangs=false")]).is_err());
        assert!(apply(&settings, &[change("two_ranges=3")]).is_err());
        assert!("two_ranges".parse::<Override>().is_err());
        let rows = contenders(
            &[MapperKind::Visagge, MapperKind::Standard],
            &settings,
            &[change("two_ranges=false")],
        )
        .unwrap();
        let names: Vec<_> = rows.iter().map(|row| row.name.as_str()).collect();
        assert_eq!(names, ["visagge", "standard", "two_ranges=false"]);
    }
}
