//! The table as text and as CSV, and its means.

use std::collections::BTreeMap;
use std::fmt::Write;

use scipsim::score::{Score, Share};

use crate::mark::Row;

/// A column of marks.
pub struct Column {
    /// Its name.
    pub name: &'static str,
    /// What it says.
    pub meaning: &'static str,
    /// The share.
    pub share: fn(&Score) -> Share,
    /// What is wanted (%), and whether more is better.
    pub wanted: f64,
    /// Whether more is better.
    pub more_is_better: bool,
}

impl Column {
    /// In percent; `None` where nothing of the kind was seen.
    pub fn percent(&self, score: &Score) -> Option<f64> {
        let share = (self.share)(score);
        (share.of > 0).then(|| share.percent())
    }

    /// Whether this is what is wanted.
    pub fn is_good(&self, percent: f64) -> bool {
        if self.more_is_better { percent >= self.wanted } else { percent <= self.wanted }
    }
}

/// The paper's columns and more.
pub const COLUMNS: [Column; 8] = [
    Column {
        name: "glass",
        meaning: "cells of glass, mirrors and metal that are within one cell of an occupied one",
        share: |s| s.glass,
        wanted: 95.0,
        more_is_better: true,
    },
    Column {
        name: "misplaced",
        meaning: "not so, but within 4 cells of one, with nothing diffuse within 3",
        share: |s| s.misplaced,
        wanted: 2.0,
        more_is_better: false,
    },
    Column {
        name: "diffuse",
        meaning: "diffuse cells that are within one cell of an occupied one",
        share: |s| s.diffuse,
        wanted: 97.0,
        more_is_better: true,
    },
    Column {
        name: "motion",
        meaning: "occupied, of the cells where only what moves was seen",
        share: |s| s.motion,
        wanted: 0.35,
        more_is_better: false,
    },
    Column {
        name: "reflection",
        meaning: "occupied, of the cells where images were seen",
        share: |s| s.reflection,
        wanted: 1.0,
        more_is_better: false,
    },
    Column {
        name: "removed",
        meaning: "occupied, of the cells of what was taken away",
        share: |s| s.removed,
        wanted: 1.0,
        more_is_better: false,
    },
    Column {
        name: "stray",
        meaning: "none of these and over 2 cells from any surface, of the occupied cells",
        share: |s| s.stray,
        wanted: 1.0,
        more_is_better: false,
    },
    Column {
        name: "path",
        meaning: "occupied, of the cells that the robot has driven over",
        share: |s| s.path,
        wanted: 0.0,
        more_is_better: false,
    },
];

/// Mean and worst of a mapper's rows after some part of the drives of a group.
pub struct Mean {
    /// Set and variant.
    pub group: String,
    /// Its mapper.
    pub mapper: String,
    /// After which of how many parts.
    pub part: [usize; 2],
    /// Number of drives.
    pub drives: usize,
    /// Mean of each column over the drives that have such cells (%).
    pub mean: [Option<f64>; COLUMNS.len()],
    /// The worst drive's (%).
    pub worst: [Option<f64>; COLUMNS.len()],
    /// Means of the cost: insertion's median and 99 of 100 (us), the map (ms), memory (MB).
    pub cost: [f64; 4],
}

/// Means by group and mapper, in the order of the rows.
pub fn means(rows: &[Row]) -> Vec<Mean> {
    let mut order: BTreeMap<(&str, &str, [usize; 2]), usize> = BTreeMap::new();
    let mut groups: Vec<Vec<&Row>> = Vec::new();
    for row in rows {
        let number = *order.entry((&row.group, &row.mapper, row.part)).or_insert(groups.len());
        if number == groups.len() {
            groups.push(Vec::new());
        }
        groups[number].push(row);
    }
    groups.into_iter().map(|rows| mean(&rows)).collect()
}

fn mean(rows: &[&Row]) -> Mean {
    let of_column =
        |column: &Column| -> Vec<f64> { rows.iter().filter_map(|row| column.percent(&row.score)).collect() };
    let worst = |column: &Column| {
        let pick = if column.more_is_better { f64::min } else { f64::max };
        of_column(column).into_iter().reduce(pick)
    };
    let first = rows[0];
    Mean {
        group: first.group.clone(),
        mapper: first.mapper.clone(),
        part: first.part,
        drives: rows.len(),
        mean: COLUMNS.each_ref().map(|column| average(&of_column(column))),
        worst: COLUMNS.each_ref().map(worst),
        cost: [0, 1, 2, 3]
            .map(|i| average(&rows.iter().map(|row| cost(row)[i]).collect::<Vec<_>>()).unwrap_or(0.0)),
    }
}

fn average(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Insertion's median and 99 of 100 (us), the map (ms), memory (MB).
pub fn cost(row: &Row) -> [f64; 4] {
    [row.insert_us[0], row.insert_us[1], row.map_ms, row.bytes as f64 / 1e6]
}

/// Names of the columns of cost.
pub const COSTS: [&str; 4] = ["us", "p99", "map ms", "MB"];

/// After which part of the drive.
pub fn part([number, of]: [usize; 2]) -> String {
    if number == of { String::new() } else { format!(" {number}/{of}") }
}

/// A percentage, or a dash where there was nothing to mark.
pub fn percent(value: Option<f64>) -> String {
    value.map_or("-".into(), |value| format!("{value:.2}"))
}

/// The first line.
pub fn heading() -> String {
    let mut text = format!("{:28} {:20}", "drive", "mapper");
    for name in COLUMNS.iter().map(|column| column.name).chain(COSTS) {
        write!(text, " {name:>6.6}").expect("text takes all");
    }
    text
}

fn line(name: &str, mapper: &str, percents: &[Option<f64>], cost: Option<[f64; 4]>) -> String {
    let mut text = format!("{name:28} {mapper:20}");
    for value in percents {
        write!(text, " {:>6}", percent(*value)).expect("text takes all");
    }
    if let Some([median, p99, map_ms, megabytes]) = cost {
        write!(text, " {median:6.0} {p99:6.0} {map_ms:6.1} {megabytes:6.2}").expect("text takes all");
    }
    text + "\n"
}

/// A line a row.
pub fn rows(rows: &[Row]) -> String {
    let text = |row: &Row| {
        let percents = COLUMNS.each_ref().map(|column| column.percent(&row.score));
        let name = format!("{}{}", row.world, part(row.part));
        let why = row.why.as_ref().map(|why| format!("    {why}\n")).unwrap_or_default();
        line(&name, &row.mapper, &percents, Some(cost(row))) + &why
    };
    rows.iter().map(text).collect()
}

/// Two lines a mean: the mean, and the worst drive in each column.
pub fn mean_rows(means: &[Mean]) -> String {
    let text = |mean: &Mean| {
        let name = |what: &str| format!("{what}, {}{}", mean.group, part(mean.part));
        let of = format!("mean of {}", mean.drives);
        line(&name(&of), &mean.mapper, &mean.mean, Some(mean.cost))
            + &line(&name("worst"), &mean.mapper, &mean.worst, None)
    };
    means.iter().map(text).collect()
}

/// All rows with counts, a line each.
pub fn csv(rows: &[Row]) -> String {
    let mut text = String::from("drive,group,mapper,part,parts");
    for column in &COLUMNS {
        write!(text, ",{0}_percent,{0}_cells,{0}_of", column.name).expect("text takes all");
    }
    text += ",insert_us_median,insert_us_p99,map_ms,bytes\n";
    for row in rows {
        let [number, of] = row.part;
        write!(text, "{},{},{},{number},{of}", row.world, row.group, row.mapper).expect("text takes all");
        for column in &COLUMNS {
            let share = (column.share)(&row.score);
            let percent = column.percent(&row.score).map(|p| format!("{p:.4}")).unwrap_or_default();
            write!(text, ",{percent},{},{}", share.count, share.of).expect("text takes all");
        }
        let [median, p99] = row.insert_us;
        writeln!(text, ",{median:.1},{p99:.1},{:.2},{}", row.map_ms, row.bytes).expect("text takes all");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(world: &str, glass: Share) -> Row {
        Row {
            drive: 0,
            world: world.into(),
            group: "tuning".into(),
            mapper: "visagge".into(),
            part: [1, 1],
            score: Score { glass, motion: Share { count: glass.count / 10, of: 100 }, ..Score::default() },
            insert_us: [100.0, 200.0],
            map_ms: 1.0,
            bytes: 1_000_000,
            png: None,
            why: None,
        }
    }

    #[test]
    fn a_drive_without_glass_does_not_count_in_the_mean_of_glass() {
        let share = |count, of| Share { count, of };
        let rows = [row("a", share(90, 100)), row("b", share(50, 100)), row("c", share(0, 0))];
        let means = means(&rows);
        assert_eq!(means.len(), 1);
        assert_eq!((means[0].drives, means[0].mean[0], means[0].worst[0]), (3, Some(70.0), Some(50.0)));
        assert_eq!((means[0].mean[2], means[0].worst[3]), (None, Some(9.0)));
        assert!(mean_rows(&means).contains("70.00"));
        assert_eq!(
            csv(&rows).lines().nth(1).unwrap().split(',').count(),
            csv(&rows).lines().next().unwrap().split(',').count()
        );
    }
}
