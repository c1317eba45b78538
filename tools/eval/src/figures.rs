//! The paper's figures from the simulator: 2 (maps of the hall), 6 and 7 (visibility of glass over the angle), 9 (intensity
//! over the angle) and 10 (the table).

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use embedded_graphics::text::Alignment;
use scipsim::light::{Route, Source};
use scipsim::score::{Score, score};
use scipsim::simulation::{DMIN, FRONT_STEP, STEP_ANGLE};
use scipsim::world::Kind;
use scipsim::{Simulation, SimulationOptions, World};
use visagged::map::Map;
use visagged::mapper::{MapperKind, MapperSettings};

use crate::canvas::{Canvas, Colour};
use crate::drive::Drive;
use crate::mark::{follow, marked};
use crate::picture;
use crate::plot::{Axis, LETTER, LINE, Mark, Plot, Series, fill, line, write, write_bold};
use crate::table::{COLUMNS, percent};

/// Where to.
#[derive(Args)]
pub struct Arguments {
    /// Folder of the pictures.
    #[arg(long, value_name = "DIR", default_value = "figures")]
    out: PathBuf,
    /// Which figures.
    #[arg(value_parser = ["2", "6", "7", "9", "10"], default_values = ["2", "6", "7", "9", "10"])]
    figures: Vec<String>,
}

const BLUE: Colour = [0, 90, 255];
const RED: Colour = [200, 30, 30];
const GREY: Colour = [150, 150, 150];

/// Pixels of a diagram.
const SIZE: [usize; 2] = [860, 440];
/// Scans that each probability is measured with.
const SCANS: usize = 400;

/// Draws the figures.
pub fn run(arguments: &Arguments) -> Result<()> {
    let folder = &arguments.out;
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let wants = |figure: &str| arguments.figures.iter().any(|name| name == figure);
    if wants("6") {
        let title = "Visibility of glass at 1 m, nothing within 20 m behind it";
        save(folder, "figure-6.png", &visibility(title, 22.0)?)?;
    }
    if wants("7") {
        let title = "Visibility of glass at 1 m, a wall 1 m behind it";
        save(folder, "figure-7.png", &visibility(title, 2.0)?)?;
    }
    if wants("9") {
        save(folder, "figure-9.png", &intensity()?)?;
    }
    if wants("2") || wants("10") {
        let hall = Hall::new()?;
        if wants("2") {
            for (name, canvas) in ["a", "b", "c"].into_iter().zip(hall.panels(ZOOM)) {
                save(folder, &format!("figure-2{name}.png"), &canvas)?;
            }
            save(folder, "figure-2.png", &hall.side_by_side())?;
        }
        if wants("10") {
            save(folder, "figure-10.png", &hall.table())?;
        }
    }
    Ok(())
}

fn save(folder: &Path, name: &str, canvas: &Canvas) -> Result<()> {
    let file = folder.join(name);
    std::fs::write(&file, canvas.png()?).with_context(|| format!("cannot write {}", file.display()))?;
    println!("{}", file.display());
    Ok(())
}

/// A sensor that stands at the origin and looks at surfaces ahead of it, each across the view at some distance.
fn stand(surfaces: &[(&str, f64)]) -> Result<Simulation> {
    let mut text = String::from("name = 'stand'\ndescription = 'figures 6, 7 and 9'\n");
    for (material, distance) in surfaces {
        // Long enough for 80 degrees to either side.
        let half = 6.0 * distance;
        text += &format!(
            "[[surface]]\nmaterial = '{material}'\nline = [[{distance:.1}, -{half:.1}], [{distance:.1}, {half:.1}]]\n"
        );
    }
    text += "[robot]\npath = [[0.0, 0.0]]\nstops = [[0, 60.0]]\n";
    let world = World::from_toml("stand", &text)?;
    Ok(Simulation::new(&world, SimulationOptions { keep_truth: false, ..Default::default() }))
}

/// The angle of a beam (degrees), which is that of incidence on what lies across the view.
fn degrees(beam: usize) -> f64 {
    ((beam as f64 - FRONT_STEP as f64) * STEP_ANGLE).to_degrees()
}

/// Figures 6 and 7: in which share of scans the glass is what is read, a bin a beam (0.25 degrees).
fn visibility(title: &str, wall: f64) -> Result<Canvas> {
    let mut seen = vec![0usize; scipsim::simulation::BEAMS];
    for scan in stand(&[("glass", 1.0), ("wall", wall)])?.take(SCANS) {
        for (count, truth) in seen.iter_mut().zip(&scan.truth) {
            let is_pane = matches!(truth.source, Source::Placement(_));
            *count += usize::from(is_pane && truth.kind == Kind::Glass && truth.route == Route::Direct);
        }
    }
    let points = seen.iter().enumerate().map(|(beam, &count)| [degrees(beam), count as f64 / SCANS as f64]);
    let plot = Plot {
        title: title.into(),
        x: Axis { label: "angle of incidence (°, bins of 0.25°)", range: [-80.0, 80.0], step: 20.0 },
        y: Axis { label: "share of scans", range: [0.0, 1.05], step: 0.2 },
        series: vec![Series {
            name: "probability that the glass is what is read".into(),
            colour: BLUE,
            mark: Mark::Line,
            points: points.collect(),
        }],
    };
    Ok(plot.draw(SIZE[0], SIZE[1]))
}

/// Figure 9: intensities read from glass and from diffuse surfaces.
fn intensity() -> Result<Canvas> {
    let readings = |material: &str, distance: f64, kind: Kind| -> Result<Vec<[f64; 2]>> {
        let mut points = Vec::new();
        for scan in stand(&[(material, distance)])?.take(3) {
            for (beam, truth) in scan.truth.iter().enumerate() {
                let is_it = matches!(truth.source, Source::Placement(_)) && truth.kind == kind;
                if is_it && scan.distances_mm[beam] >= DMIN {
                    points.push([degrees(beam), f64::from(scan.intensities[beam])]);
                }
            }
        }
        Ok(points)
    };
    let series = |name: &str, colour, points| Series { name: name.into(), colour, mark: Mark::Dots, points };
    let plot = Plot {
        title: "Intensity of glass and of diffuse surfaces".into(),
        x: Axis { label: "angle of incidence (°)", range: [-60.0, 60.0], step: 10.0 },
        y: Axis { label: "intensity (device's unit)", range: [0.0, 14_000.0], step: 2_000.0 },
        series: vec![
            series("glass at 1 m", BLUE, readings("glass", 1.0, Kind::Glass)?),
            series("wall at 1 m", RED, readings("wall", 1.0, Kind::Diffuse)?),
            series("wall at 2 m", GREY, readings("wall", 2.0, Kind::Diffuse)?),
        ],
    };
    Ok(plot.draw(SIZE[0], SIZE[1]))
}

/// The hall, which is like the paper's: the drive and what the mappers made of it.
struct Hall {
    drive: Drive,
    /// Of the standard grid, of the paper's, and ours.
    maps: [Map; 3],
}

/// Pixels a cell in the panels of figure 2 each by itself; side by side it is one.
const ZOOM: usize = 2;
/// Room for the words above and below a panel (pixels).
const ABOVE: usize = 30;
const BELOW: usize = 34;

impl Hall {
    fn new() -> Result<Hall> {
        let drive = Drive::new(&World::load("hall")?, SimulationOptions::default(), 1);
        let map = |mapper| -> Result<Map> {
            let mut last = None;
            let settings = MapperSettings { mapper, ..MapperSettings::default() };
            follow(&drive, &settings, |_, _, map, _| {
                last = Some(map.clone());
                Ok(())
            })?;
            last.context("the drive has a part")
        };
        let maps = [map(MapperKind::Standard)?, map(MapperKind::Paper)?, map(MapperKind::Visagge)?];
        Ok(Hall { drive, maps })
    }

    fn truth(&self) -> &scipsim::TruthMap {
        &self.drive.truths[0].1
    }

    /// Figure 2: (a) the standard grid, (b) what was observed, by what it truly was, (c) ours.
    fn panels(&self, zoom: usize) -> [Canvas; 3] {
        let truth = self.truth();
        let key = |panel: &mut Canvas| {
            let (mut x, y) = (4, (panel.height() - BELOW + 8) as i32);
            for (colour, name) in &picture::LABELS[..4] {
                fill(panel, [x, y + 3], [11, 11], *colour);
                write(panel, name, x + 16, y, [0; 3], Alignment::Left);
                x += 16 + name.len() as i32 * LETTER + 10;
            }
        };
        let mut panels = [
            panel("(a) standard grid", &picture::plain(&self.maps[0], truth).enlarged(zoom)),
            panel("(b) what was observed, by its truth", &picture::labels(truth).enlarged(zoom)),
            panel("(c) visagged", &picture::plain(&self.maps[2], truth).enlarged(zoom)),
        ];
        scale(&mut panels[0], zoom);
        key(&mut panels[1]);
        scale(&mut panels[2], zoom);
        panels
    }

    fn side_by_side(&self) -> Canvas {
        let panels = self.panels(1);
        let gap = 16;
        let width = panels.iter().map(|panel| panel.width() + gap).sum::<usize>() - gap;
        let mut all = Canvas::new(width, panels[0].height());
        let mut x = 0;
        for panel in &panels {
            all.paste(panel, x, 0);
            x += panel.width() + gap;
        }
        all
    }

    /// Figure 10, with the further columns and the paper's own numbers.
    fn table(&self) -> Canvas {
        let scores = self.maps.each_ref().map(|map| score(self.truth(), &marked(map)));
        let of = |score: &Score| COLUMNS.each_ref().map(|column| column.percent(score));
        let paper = |glass, misplaced, motion, reflection| {
            [Some(glass), Some(misplaced), None, Some(motion), Some(reflection), None, None, None]
        };
        let rows = [
            ("paper's hall, standard grid", paper(13.29, 1.21, 1.09, 2.24)),
            ("paper's hall, VisAGGE", paper(94.90, 0.94, 0.35, 5.17)),
            ("simulated, standard grid", of(&scores[0])),
            ("simulated, VisAGGE as in the paper", of(&scores[1])),
            ("simulated, visagged", of(&scores[2])),
        ];
        draw_table("Cells of the hall found, and shown by mistake (%)", &rows)
    }
}

/// A map with its title, and room below.
fn panel(title: &str, map: &Canvas) -> Canvas {
    let mut panel = Canvas::new(map.width(), map.height() + ABOVE + BELOW);
    panel.paste(map, 0, ABOVE);
    write_bold(&mut panel, title, 4, 6, Alignment::Left);
    panel
}

/// A bar of 5 m below a panel.
fn scale(panel: &mut Canvas, zoom: usize) {
    let (x, y) = (8, (panel.height() - BELOW / 2) as i32);
    let end = x + (5.0 / scipsim::truth::RESOLUTION) as i32 * zoom as i32;
    line(panel, [x, y], [end, y], [0; 3], 2);
    for end in [x, end] {
        line(panel, [end, y - 5], [end, y + 5], [0; 3], 2);
    }
    write(panel, "5 m", end + 10, y - LINE / 2 + 2, [0; 3], Alignment::Left);
}

fn draw_table(title: &str, rows: &[(&str, [Option<f64>; COLUMNS.len()])]) -> Canvas {
    const FIRST: i32 = 325;
    const COLUMN: i32 = 98;
    const ROW: i32 = 30;
    const TOP: i32 = 44;
    let width = FIRST + COLUMN * COLUMNS.len() as i32 + 12;
    let height = TOP + ROW * (rows.len() as i32 + 2) + 4;
    let mut canvas = Canvas::new(width as usize, height as usize);
    write_bold(&mut canvas, title, 12, 12, Alignment::Left);
    let right = |column: usize| FIRST + COLUMN * (column as i32 + 1);
    for (number, column) in COLUMNS.iter().enumerate() {
        write_bold(&mut canvas, column.name, right(number), TOP, Alignment::Right);
        let bound = if column.more_is_better { ">=" } else { "<=" };
        let wanted = if column.wanted > 0.0 { format!("{bound} {}", column.wanted) } else { "0".into() };
        let y = TOP + ROW * (rows.len() as i32 + 1) + 6;
        write(&mut canvas, &wanted, right(number), y, GREY, Alignment::Right);
    }
    write(&mut canvas, "wanted", 12, TOP + ROW * (rows.len() as i32 + 1) + 6, GREY, Alignment::Left);
    for (number, (name, values)) in rows.iter().enumerate() {
        let y = TOP + ROW * (number as i32 + 1);
        line(&mut canvas, [12, y - 5], [width - 12, y - 5], [210; 3], 1);
        write(&mut canvas, name, 12, y, [0; 3], Alignment::Left);
        for (column, value) in values.iter().enumerate() {
            write(&mut canvas, &percent(*value), right(column), y, [0; 3], Alignment::Right);
        }
    }
    let y = TOP + ROW * (rows.len() as i32 + 1);
    line(&mut canvas, [12, y], [width - 12, y], [0; 3], 1);
    canvas
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_glass_is_seen_at_its_normal_only_where_a_wall_is_behind_it() {
        let shares = |wall: f64, beam: usize| {
            let scans: Vec<_> = stand(&[("glass", 1.0), ("wall", wall)]).unwrap().take(40).collect();
            let seen = scans.iter().filter(|scan| {
                scan.truth[beam].kind == Kind::Glass && scan.truth[beam].route == Route::Direct
            });
            seen.count() as f64 / 40.0
        };
        let at = |degrees: f64| (FRONT_STEP as f64 + degrees / 0.25) as usize;
        assert!(shares(2.0, at(0.0)) > 0.9 && shares(22.0, at(0.0)) > 0.9);
        assert!(shares(2.0, at(5.0)) < 0.1, "a wall 1 m behind outshines it");
        assert!(shares(22.0, at(10.0)) > 0.9, "nothing outshines it");
    }
}
