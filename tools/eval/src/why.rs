//! Which verdicts the cells have that are shown or missing by mistake.

use std::collections::BTreeMap;

use scipsim::score::Score;
use scipsim::truth::{Label, TruthMap};
use visagged::grid::verdict::Verdict;
use visagged::map::{Map, Values};

use crate::picture::place;

/// Counts of wrong cells by label and verdict, as one line. A surface's cell is missing where nothing in its 3 x 3
/// neighbourhood is shown; the verdicts are all that are found there. Of images left, it says how they may be images. What the marks lack beyond these was lost when the map
/// was thinned: the surface is shown too thick, or beside its place. Empty for maps without verdicts.
pub fn wrong_cells(map: &Map, truth: &TruthMap, score: &Score) -> String {
    let (Some(verdicts), Some(images)) = (layer(map, "verdict"), layer(map, "image")) else {
        return String::new();
    };
    let at = |x: i64, y: i64| place(map, truth, x, y).map(|place| verdicts[place]);
    let image = |x: i64, y: i64| place(map, truth, x, y).map_or(0, |place| images[place]);
    let mut counts: BTreeMap<(String, Vec<u8>), u32> = BTreeMap::new();
    for (cell, label) in truth.labels.iter().enumerate() {
        let (x, y) = ((cell % truth.width) as i64, (cell / truth.width) as i64);
        let wrong = match label {
            Label::Other => None,
            Label::Glass | Label::Diffuse => {
                let mut near: Vec<u8> = (-1..=1)
                    .flat_map(|dy| (-1..=1).filter_map(move |dx| at(x + dx, y + dy)))
                    .filter(|verdict| *verdict > 0)
                    .collect();
                near.sort_unstable();
                near.dedup();
                (!near.iter().any(|verdict| is_shown(*verdict))).then_some(near)
            }
            _ => at(x, y).filter(|verdict| is_shown(*verdict)).map(|verdict| vec![verdict]),
        };
        if let Some(verdicts) = wrong {
            let label = match label {
                Label::Reflection => format!("Reflection (image {})", image(x, y)),
                _ => format!("{label:?}"),
            };
            *counts.entry((label, verdicts)).or_default() += 1;
        }
    }
    let lost = |what: &str, share: scipsim::Share| {
        let missing: u32 =
            counts.iter().filter(|((label, _), _)| label == what).map(|(_, count)| count).sum();
        format!("; {what} lost by thinning: {}", (share.of - share.count).saturating_sub(missing as usize))
    };
    let lost = lost("Glass", score.glass) + &lost("Diffuse", score.diffuse);
    let text = counts.iter().map(|((label, verdicts), count)| format!("{label} {verdicts:?}: {count}"));
    text.collect::<Vec<_>>().join("; ") + &lost
}

fn layer(map: &Map, name: &str) -> Option<Vec<u8>> {
    let layer = map.layers.iter().find(|layer| layer.name == name)?;
    match layer.spread(map.occupancy.len()) {
        Values::U8(values) => Some(values),
        _ => None,
    }
}

/// As [`Verdict::is_shown`], by number.
fn is_shown(verdict: u8) -> bool {
    (Verdict::Solid as u8..Verdict::TooFew as u8).contains(&verdict)
}
