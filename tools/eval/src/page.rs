//! The table as one HTML page with pictures of the maps, complete in itself.

use std::fmt::Write;

use base64::{Engine, engine::general_purpose::STANDARD as BASE64};

use crate::mark::Row;
use crate::picture::ERRORS;
use crate::table::{COLUMNS, COSTS, Mean, cost, part, percent};

const STYLE: &str = "body{font:15px system-ui,sans-serif;margin:2em;color:#222}\
table{border-collapse:collapse;margin:1em 0}td,th{padding:2px 9px;text-align:right;border-bottom:1px solid #ddd}\
td:first-child,th:first-child,td:nth-child(2),th:nth-child(2){text-align:left}\
td.bad{background:#ffd9d0}td.worst{color:#888}\
.maps{display:flex;flex-wrap:wrap;gap:1em}figure{margin:0}figcaption{font-size:13px}\
img{image-rendering:pixelated;border:1px solid #ccc;max-width:46vw}\
.key span{display:inline-block;margin-right:1.2em;white-space:nowrap}\
.key i{display:inline-block;width:.9em;height:.9em;margin-right:.3em;border:1px solid #aaa;vertical-align:-1px}";

/// The page.
pub fn html(rows: &[Row], means: &[Mean]) -> String {
    let mut page = format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Maps against the truth</title>\
         <style>{STYLE}</style>\n<h1>Maps against the truth</h1>\n{}{}",
        meanings(),
        key()
    );
    page += &mean_table(means);
    for rows in rows.chunk_by(|a, b| a.drive == b.drive) {
        page += &drive(rows);
    }
    page + "</html>\n"
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

fn meanings() -> String {
    let items = COLUMNS.iter().map(|column| {
        let bound = if column.more_is_better { "at least" } else { "at most" };
        format!(
            "<li><b>{}</b>: {}; wanted {bound} {} %</li>\n",
            column.name,
            escaped(column.meaning),
            column.wanted
        )
    });
    format!(
        "<ul>{}<li><b>us, p99</b>: CPU time of an insertion; <b>map ms</b>: CPU time of making the map; <b>MB</b>: memory \
         of the grid</li></ul><p>A red cell misses what is wanted. A dash: there was nothing of the kind.</p>\n",
        items.collect::<String>()
    )
}

fn key() -> String {
    let spans = ERRORS.iter().map(|([r, g, b], meaning)| {
        format!("<span><i style=\"background:rgb({r},{g},{b})\"></i>{}</span>", escaped(meaning))
    });
    format!("<p class=\"key\">{}</p>\n", spans.collect::<String>())
}

fn heading(first: &str) -> String {
    let names = COLUMNS.iter().map(|column| column.name).chain(COSTS);
    let cells: String = names.map(|name| format!("<th>{name}</th>")).collect();
    format!("<tr><th>{first}</th><th>mapper</th>{cells}</tr>\n")
}

fn marks(percents: &[Option<f64>]) -> String {
    let cell = |(value, column): (&Option<f64>, &crate::table::Column)| {
        let class = if value.is_some_and(|value| !column.is_good(value)) { " class=\"bad\"" } else { "" };
        format!("<td{class}>{}</td>", percent(*value))
    };
    percents.iter().zip(&COLUMNS).map(cell).collect()
}

fn costs([median, p99, map_ms, megabytes]: [f64; 4]) -> String {
    format!("<td>{median:.0}</td><td>{p99:.0}</td><td>{map_ms:.1}</td><td>{megabytes:.2}</td>")
}

fn mean_table(means: &[Mean]) -> String {
    let mut text = format!("<h2>Means</h2>\n<table>{}", heading("drives"));
    for mean in means {
        let name = format!("{} of {}{}", mean.drives, mean.group, part(mean.part));
        writeln!(
            text,
            "<tr><td>{}</td><td>{}</td>{}{}</tr>\n<tr><td class=\"worst\">the worst in each column</td><td></td>{}</tr>",
            escaped(&name),
            escaped(&mean.mapper),
            marks(&mean.mean),
            costs(mean.cost),
            marks(&mean.worst)
        )
        .expect("text takes all");
    }
    text + "</table>\n"
}

fn drive(rows: &[Row]) -> String {
    let mut text = format!("<h2>{}</h2>\n<table>{}", escaped(&rows[0].world), heading("after"));
    for row in rows {
        let after = if row.is_final() { "all".into() } else { part(row.part) };
        let percents = COLUMNS.each_ref().map(|column| column.percent(&row.score));
        writeln!(
            text,
            "<tr><td>{after}</td><td>{}</td>{}{}</tr>",
            escaped(&row.mapper),
            marks(&percents),
            costs(cost(row))
        )
        .expect("text takes all");
        if let Some(why) = row.why.as_ref().filter(|why| !why.is_empty()) {
            writeln!(text, "<tr><td colspan=\"14\">{}</td></tr>", escaped(why)).expect("text takes all");
        }
    }
    text += "</table>\n<div class=\"maps\">\n";
    for (row, png) in rows.iter().filter_map(|row| Some((row, row.png.as_ref()?))) {
        writeln!(
            text,
            "<figure><img alt=\"map by {0}\" src=\"data:image/png;base64,{1}\"><figcaption>{0}</figcaption></figure>",
            escaped(&row.mapper),
            BASE64.encode(png)
        )
        .expect("text takes all");
    }
    text + "</div>\n"
}
