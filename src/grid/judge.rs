//! What is judged anew when a map is asked for: what may have become another verdict since the last one, and no more.
//!
//! A verdict ([`super::verdict`]) is reached in steps: the shape of a cell's neighbourhood, gaps, images, surfaces drawn one cell
//! thick. What each step makes of a cell is kept, and made anew where something has changed that the step looks at. So the map is,
//! bit by bit, the one of who judges everything anew, no matter when maps were asked for.
//!
//! - Shape: the cell and its neighbours, as far as its [`Reach`] goes.
//! - Gaps: what is shown by its shape in the tile and those around.
//! - Images: the cell's own view angles, the cells on its lines of sight that are mirrors and walls, what is shown, seen and free in the
//!   squares where its original was sought ([`Extent`]), and the walls in those that light from there would come through; of cells
//!   whose lines of sight met nothing, only what has come onto these. Then, which surfaces are opaque.
//! - Thickness: all of this in the tile and those around.
//!
//! That a cell has changed is told by its [fingerprints](super::cell::Cell::fingerprints).

use super::{
    idea::Idea,
    mirrors::{Mirror, Mirrors, Rows, near},
    reflection::{self, AllOpacity, BESIDE_WALLS, Image, Looked, Lookups, Opacity, ROUNDED, Sights, Spot},
    squares::{CellsAround, CellsBySquare, Extent, Reach, Squares, SquaresAround},
    surface::Window,
    tiles::{SIDE, TileIndex},
    verdict::{Verdict, corners, is_alone, is_in_gap, is_in_the_way},
    view::Place,
    visagge::{Evidence, Tile, Visagge, place_of},
};
use std::{cell::OnceCell, sync::Weak};

/// What is judged of a cell, from its observations and those of the cells around.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Judgement {
    /// Of the cell when it was judged.
    fingerprints: [[u32; 2]; 2],
    /// The cells that `shape` depends on.
    reach: Reach,
    /// How it may be an image.
    pub image: Image,
    /// Whether this has to be judged anew.
    image_is_due: bool,
    /// What is known of the lines of sight to it.
    sights: Sights,
    /// Where its original was sought.
    sought: Looked,
    /// What its shape says of it.
    shape: Verdict,
    /// The same with gaps bridged.
    bridged: Verdict,
    /// The same with images.
    pub unthinned: Verdict,
    /// Whether it is shown as occupied, and why.
    pub verdict: Verdict,
}

/// Of every cell: what it takes counts.
const _: () = assert!(size_of::<Judgement>() == 40);

/// What was found of how a cell may be an image.
struct Found {
    /// The cell's number.
    at: usize,
    image: Image,
    sights: Sights,
    sought: Looked,
}

/// What the shape of its neighbourhood says of a cell.
pub(super) struct Shape {
    /// All of the verdict but whether it is in a gap, an image, or beside another cell.
    pub verdict: Verdict,
    /// What there is for images, where something may be seen through it or in it.
    pub mirror: Option<Mirror>,
    /// The cells that this depends on.
    pub reach: Reach,
}

/// What has changed in a tile since it was last judged.
#[derive(Clone, Debug, Default)]
struct Change {
    /// Where cells are no longer as they were.
    cells: Squares,
    /// Where a beam has crossed cells that none had crossed before.
    free: Squares,
    /// Whether shapes were judged anew, or cells have gone.
    judged: bool,
    /// Whether other cells are shown by themselves.
    shaped: bool,
    /// The cells in which lines of sight meet other mirrors.
    mirrors: CellsBySquare,
    /// Those of them in which no mirror was met before.
    newly_met: CellsBySquare,
    /// Where other cells are mirrors, or these are seen from elsewhere.
    seen: Squares,
    /// Where other cells are shown, gaps bridged.
    shown: Squares,
    /// The cells that have become walls, or are none any more.
    walls: CellsBySquare,
    /// Whether a cell's verdict is another, but for how thick surfaces are drawn.
    unthinned: bool,
    /// Whether how a cell may be an image is another in the end.
    image: bool,
}

impl Change {
    /// Where originals may no longer be what they were.
    fn of_originals(&self) -> Squares {
        self.shown | self.free | self.walls.in_squares() | self.seen
    }
}

/// Of each tile, by its number.
pub(super) struct Changes(Vec<Change>);

impl Visagge {
    /// Judges all cells of which the verdict may have changed.
    pub(super) fn judge(&mut self) {
        let mut changes = self.changes();
        self.judge_shapes(&mut changes);
        self.bridge_gaps(&mut changes);
        self.forget_sights(&changes);
        self.judge_images(&mut changes);
        self.judge_opacity(&mut changes);
        self.thin(&changes);
    }

    /// What has changed in cells; all else follows.
    fn changes(&mut self) -> Changes {
        let numbers = 0..self.tiles.len();
        let change = |number| {
            let tile: &mut Tile = self.tiles.at_mut(number);
            let free = tile.judged_free.update(&tile.free);
            let cells = tile.evidence.as_mut().map(|evidence| evidence.changed()).unwrap_or_default();
            Change { cells, free, ..Change::default() }
        };
        Changes(numbers.map(change).collect())
    }

    /// What has changed in the tile at a place, if there is one.
    fn change<'a>(&self, changes: &'a Changes, place: TileIndex) -> Option<&'a Change> {
        self.tiles.find(place).map(|number| &changes.0[number])
    }

    /// Whether this holds of the tile or one of those around.
    fn any_around(&self, changes: &Changes, number: usize, holds: impl Fn(&Change) -> bool) -> bool {
        let TileIndex { x, y } = self.tiles.place(number);
        let around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| TileIndex { x: x + dx, y: y + dy }));
        around.into_iter().any(|place| self.change(changes, place).is_some_and(&holds))
    }

    /// Bits of the tile at a place and of those around.
    fn around(&self, place: TileIndex, bits: impl Fn(&Evidence) -> &[u64; SIDE as usize]) -> CellsAround {
        CellsAround::of(place, |place| self.tiles.get(place)?.evidence.as_deref().map(&bits))
    }

    /// Judges cells by their own observations and their neighbours'.
    fn judge_shapes(&mut self, changes: &mut Changes) {
        for number in 0..self.tiles.len() {
            let place = self.tiles.place(number);
            let cells = |place| self.change(changes, place).map(|change| change.cells).unwrap_or_default();
            let around = SquaresAround::of(place, cells);
            let Some(evidence) = self.tiles.at(number).evidence.as_ref().filter(|_| !around.is_empty())
            else {
                continue;
            };
            let window = OnceCell::new();
            let shapes: Vec<(usize, Shape)> = evidence
                .judgements
                .iter()
                .enumerate()
                .filter(|(_, judged)| judged.shape == Verdict::None || around.touch(judged.reach))
                .map(|(at, _)| {
                    let cell = evidence.cells.get(at);
                    let window = || window.get_or_init(|| Window::around(self, place));
                    (at, self.judge_shape(cell.index(place), &cell, window))
                })
                .collect();
            let change = &mut changes.0[number];
            if !shapes.is_empty() || !change.cells.is_empty() {
                let evidence = self.tiles.at_mut(number).evidence.as_mut().expect("it was there");
                evidence.take_shapes(shapes, change);
            }
        }
    }

    /// Shows cells in the gaps of what is shown. A pane is seen cell by cell, for a few scans each: where somebody stands in
    /// between, or two cells share a return, single ones have too little to be a surface by themselves.
    fn bridge_gaps(&mut self, changes: &mut Changes) {
        for number in 0..self.tiles.len() {
            if !changes.0[number].judged && !self.any_around(changes, number, |change| change.shaped) {
                continue;
            }
            let place = self.tiles.place(number);
            let Some(evidence) = &self.tiles.at(number).evidence else { continue };
            let shown = self.around(place, |evidence| &evidence.shaped);
            let cells = evidence.cells.returns.iter().zip(&evidence.judgements).enumerate();
            let bridged: Vec<Verdict> = cells
                .map(|(at, (returns, judgement))| {
                    let is_bridged = !judgement.shape.is_shown()
                        && self.settings.has(Idea::Gaps)
                        && is_in_gap(returns.place, &shown)
                        && !is_in_the_way(&evidence.cells.get(at), &self.settings);
                    if is_bridged { Verdict::Bridged } else { judgement.shape }
                })
                .collect();
            let evidence = self.tiles.at_mut(number).evidence.as_mut().expect("it was there");
            evidence.take_bridged(bridged, &mut changes.0[number]);
        }
    }

    /// Forgets what is known of the lines of sight to cells, where on these walls are others: how these may be images has to be told anew.
    fn forget_sights(&mut self, changes: &Changes) {
        for number in 0..self.tiles.len() {
            let place = self.tiles.place(number);
            let Some(evidence) = &self.tiles.at(number).evidence else { continue };
            let walls = self.in_the_way(evidence, BESIDE_WALLS, |number| &changes.0[number].walls);
            if walls.is_empty() {
                continue;
            }
            let passed = |at: &usize| {
                let judgement = &evidence.judgements[*at];
                (judgement.bridged.is_shown() || judgement.sights != Sights::default())
                    && reflection::passes(self, place, &evidence.cells.get(*at), &walls)
            };
            let passed: Vec<usize> = (0..evidence.judgements.len()).filter(passed).collect();
            let evidence = self.tiles.at_mut(number).evidence.as_mut().expect("it was there");
            for at in passed {
                let judgement = &mut evidence.judgements[at];
                (judgement.sights, judgement.image_is_due) = (Sights::default(), true);
            }
        }
    }

    /// Where these cells of each tile, by its number, are in the way of lines of sight to the cells of this one, or so far beside (m).
    fn in_the_way<'a>(
        &self,
        evidence: &Evidence,
        beside: f64,
        cells: impl Fn(usize) -> &'a CellsBySquare,
    ) -> Vec<Spot> {
        let crossed = evidence.sources.crossed.iter();
        let found = crossed.filter_map(|place| Some((place, cells(self.tiles.find(place)?))));
        found.flat_map(|(place, cells)| Spot::of(place, cells, self.resolution, beside)).collect()
    }

    /// Tells which cells that are shown may be images.
    fn judge_images(&mut self, changes: &mut Changes) {
        let may_be = self.settings.has(Idea::Images);
        for number in 0..self.tiles.len() {
            let place = self.tiles.place(number);
            let Some(evidence) = &self.tiles.at(number).evidence else { continue };
            let others = self.in_the_way(evidence, ROUNDED, |number| &changes.0[number].mirrors);
            let changed = |squares: fn(&Change) -> Squares| -> Vec<(TileIndex, Squares)> {
                let places = evidence.sources.sought.iter();
                let found = places.filter_map(|place| Some((place, squares(self.change(changes, place)?))));
                found.filter(|(_, squares)| !squares.is_empty()).collect()
            };
            let originals = changed(Change::of_originals);
            let walls = changed(|change| change.walls.in_squares());
            if others.is_empty()
                && originals.is_empty()
                && !evidence.judgements.iter().any(|judgement| judgement.image_is_due)
            {
                continue;
            }
            let newly_met = self.in_the_way(evidence, ROUNDED, |number| &changes.0[number].newly_met);
            let mut lookups = Lookups::of(place, evidence.sources.clone());
            let judge = |(at, judgement): (usize, &Judgement)| {
                let Judgement { mut sights, mut sought, image_is_due: is_due, .. } = *judgement;
                if !(may_be && judgement.bridged.is_shown()) {
                    sights.set_clear(false);
                    return is_due.then_some(Found { at, image: Image::No, sights, sought });
                }
                let cell = evidence.cells.get(at);
                let passes =
                    |spots: &[Spot]| !spots.is_empty() && reflection::passes(self, place, &cell, spots);
                let touch = |others: &[(TileIndex, Squares)], extent: Extent| {
                    others.iter().any(|(tile, squares)| extent.touches(place, *tile, *squares))
                };
                let may_differ = if sights.are_clear() {
                    is_due || passes(&newly_met)
                } else {
                    is_due
                        || touch(&originals, sought.originals)
                        || touch(&walls, sought.ways)
                        || passes(&others)
                };
                if !may_differ {
                    return None;
                }
                let image = reflection::image(self, place, &cell, &mut sights, &mut lookups);
                sought = if is_due { lookups.sought() } else { sought.and(lookups.sought()) };
                sights.set_clear(lookups.were_clear() && image == Image::No);
                Some(Found { at, image, sights, sought })
            };
            let found = evidence.judgements.iter().enumerate().filter_map(judge).collect();
            let evidence = self.tiles.at_mut(number).evidence.as_mut().expect("it was there");
            evidence.sources = lookups.into();
            evidence.take_images(found, &mut changes.0[number]);
        }
    }

    /// Tells which of these are images.
    fn judge_opacity(&mut self, changes: &mut Changes) {
        let mut opacity = AllOpacity::default();
        let glimpses = self.glimpses();
        let are_others = glimpses != std::mem::replace(&mut self.judged_glimpses, glimpses);
        for number in 0..self.tiles.len() {
            let Some(evidence) = &mut self.tiles.at_mut(number).evidence else { continue };
            if changes.0[number].judged {
                evidence.count_votes();
            }
            if self.settings.has(Idea::Opacity) {
                opacity.add(&evidence.votes);
            }
        }
        for (number, change) in changes.0.iter_mut().enumerate() {
            let Some(evidence) = &mut self.tiles.at_mut(number).evidence else { continue };
            let opaque = opacity.opaque(&evidence.votes);
            if change.judged || are_others || opaque != evidence.opaque {
                evidence.opaque = opaque;
                change.unthinned |= evidence.take_unthinned(glimpses);
            }
        }
    }

    /// Leaves out cells of surfaces that are alone, and draws surfaces one cell thick: ranges and poses spread the returns of a wall over
    /// cells one behind the other, and those are shown that got the most.
    fn thin(&mut self, changes: &Changes) {
        for (number, change) in changes.0.iter().enumerate() {
            if change.image || !(change.free | change.cells).is_empty() {
                self.tiles.at_mut(number).shown = Weak::new();
            }
            let matters = |change: &Change| !(change.cells | change.shown).is_empty() || change.unthinned;
            if !self.any_around(changes, number, matters) {
                continue;
            }
            let place = self.tiles.place(number);
            let Some(evidence) = &self.tiles.at(number).evidence else { continue };
            let shown = self.around(place, |evidence| &evidence.shown);
            let mut verdicts: Vec<Verdict> = evidence
                .judgements
                .iter()
                .enumerate()
                .map(|(at, judgement)| {
                    let unthinned = judgement.unthinned;
                    let is_alone = || is_alone(evidence.cells.returns[at].place, &shown);
                    let is_outweighed = || self.is_outweighed((place, evidence), at, &shown);
                    if !unthinned.is_shown() {
                        unthinned
                    } else if unthinned != Verdict::Solid && self.settings.has(Idea::Alone) && is_alone() {
                        Verdict::TooFew
                    } else if self.settings.has(Idea::Thin) && is_outweighed() {
                        Verdict::Beside
                    } else {
                        unthinned
                    }
                })
                .collect();
            if [Idea::Thin, Idea::Diagonals].iter().all(|idea| self.settings.has(*idea)) {
                let corners = corners(&evidence.rows(|number| verdicts[number].is_shown()));
                for (verdict, returns) in verdicts.iter_mut().zip(&evidence.cells.returns) {
                    let [column, row] = returns.place;
                    if corners[usize::from(row)] >> column & 1 == 1 {
                        *verdict = Verdict::Beside;
                    }
                }
            }
            let tile = self.tiles.at_mut(number);
            let evidence = tile.evidence.as_mut().expect("it was there");
            for (judgement, verdict) in evidence.judgements.iter_mut().zip(verdicts) {
                if verdict != std::mem::replace(&mut judgement.verdict, verdict) {
                    tile.shown = Weak::new();
                }
            }
        }
    }
}

impl Evidence {
    /// The squares in which cells have changed since this was last asked.
    fn changed(&mut self) -> Squares {
        let mut changed = std::mem::take(&mut self.emptied);
        if std::mem::take(&mut self.is_touched) {
            for (cell, judgement) in self.judged() {
                let fingerprints = cell.fingerprints();
                if fingerprints != judgement.fingerprints {
                    changed.insert(cell.returns.place);
                    if fingerprints[0] != judgement.fingerprints[0] {
                        (judgement.image_is_due, judgement.sights) = (true, Sights::default());
                    }
                    judgement.fingerprints = fingerprints;
                }
            }
        }
        changed
    }

    fn take_shapes(&mut self, shapes: Vec<(usize, Shape)>, change: &mut Change) {
        let before = self.mirrors.take();
        let before_at = |place: Place| before.as_ref().and_then(|before| before.get(place));
        let mut mirrors: Vec<(Place, Mirror)> = Vec::new();
        let mut judged = [0u64; SIDE as usize];
        // Those that reflect in another way, and those that are seen from elsewhere.
        let (mut others, mut seen) = ([0u64; SIDE as usize], [0u64; SIDE as usize]);
        for (number, Shape { verdict, mirror, reach }) in shapes {
            let judgement = &mut self.judgements[number];
            (judgement.shape, judgement.reach) = (verdict, reach);
            let [column, row] = self.cells.returns[number].place;
            let place = place_of([column, row]);
            let was = before_at(place);
            judged[usize::from(row)] |= 1 << column;
            let differs = |by: fn(&Mirror, &Mirror) -> bool| match (was, &mirror) {
                (Some(was), Some(mirror)) => !by(was, mirror),
                (was, mirror) => was.is_some() != mirror.is_some(),
            };
            others[usize::from(row)] |= u64::from(differs(|a, b| a.plane == b.plane)) << column;
            seen[usize::from(row)] |= u64::from(differs(|a, b| a.visible == b.visible)) << column;
            mirrors.extend(mirror.map(|mirror| (place, mirror)));
        }
        for (place, mirror) in before.iter().flat_map(|before| before.iter()) {
            let (row, column) = (usize::from(place >> 6), place & 63);
            if self.slots.get(place).is_none() {
                others[row] |= 1 << column;
                seen[row] |= 1 << column;
            } else if judged[row] >> column & 1 == 0 {
                mirrors.push((place, *mirror));
            }
        }
        self.mirrors = Mirrors::of(mirrors).map(Box::new);
        change.mirrors = near(others);
        change.seen = Squares::of(seen);
        let [met, met_before] =
            [self.mirrors.as_deref(), before.as_deref()].map(|mirrors| mirrors.map(Mirrors::near));
        let none = CellsBySquare::default();
        change.newly_met = met.unwrap_or(&none).but(met_before.unwrap_or(&none));
        let shaped = self.rows(|number| self.judgements[number].shape.is_shown());
        change.shaped = shaped != self.shaped;
        change.judged = true;
        self.shaped = shaped;
    }

    fn take_bridged(&mut self, bridged: Vec<Verdict>, change: &mut Change) {
        for (judgement, bridged) in self.judgements.iter_mut().zip(bridged) {
            judgement.image_is_due |= bridged.is_shown() != judgement.bridged.is_shown();
            judgement.bridged = bridged;
        }
        let shown = self.rows(|number| self.judgements[number].bridged.is_shown());
        let walls = self
            .rows(|number| self.judgements[number].bridged == Verdict::Solid && self.cells.is_wall(number));
        let walls = CellsBySquare::from(walls);
        change.shown = Squares::of(std::array::from_fn(|row| shown[row] ^ self.shown[row]));
        change.walls = walls.unlike(&self.walls);
        change.judged = true;
        (self.shown, self.walls) = (shown, walls);
    }

    /// Takes note of how cells may be images, and of what is known of the lines of sight to them.
    fn take_images(&mut self, found: Vec<Found>, change: &mut Change) {
        change.judged = true;
        for Found { at, image, sights, sought } in found {
            let judgement = &mut self.judgements[at];
            change.image |= judgement.image != image;
            (judgement.sights, judgement.sought) = (sights, sought);
            (judgement.image, judgement.image_is_due) = (image, false);
        }
    }

    fn count_votes(&mut self) {
        let mut votes = Opacity::default();
        self.judgements.iter().for_each(|judgement| votes.vote(judgement.image));
        self.votes = votes;
    }

    /// Takes note of which cells are images, or may be, and which were seen through a surface in fewer scans than this. Gives whether
    /// others were.
    fn take_unthinned(&mut self, glimpses: u16) -> bool {
        let opaque = &self.opaque;
        let mut are_others = false;
        for (returns, judgement) in self.cells.returns.iter().zip(&mut self.judgements) {
            let Judgement { image, bridged, .. } = *judgement;
            let is_glimpse = || {
                matches!(bridged, Verdict::Solid | Verdict::Bridged)
                    && returns.hits < glimpses
                    && image.may_pass_by()
            };
            let verdict = match bridged {
                _ if image.is_image(opaque) => Verdict::Image,
                _ if is_glimpse() => Verdict::TooFew,
                Verdict::Oblique | Verdict::Lasting if image.may_be() => Verdict::NoSurface,
                _ => bridged,
            };
            are_others |= verdict != judgement.unthinned;
            judgement.unthinned = verdict;
        }
        are_others
    }

    /// A bit for each cell of whose number this holds, a word a row.
    fn rows(&self, holds: impl Fn(usize) -> bool) -> Rows {
        let mut rows = [0; SIDE as usize];
        for (number, returns) in self.cells.returns.iter().enumerate() {
            let [column, row] = returns.place;
            rows[usize::from(row)] |= u64::from(holds(number)) << column;
        }
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{cell::Returns, reflection::Block, track::Track};

    impl Visagge {
        /// Only the last step, for all cells.
        pub fn thin_all(&mut self) {
            let all = Change { unthinned: true, ..Change::default() };
            self.thin(&Changes(vec![all; self.tiles.len()]));
        }
    }

    #[test]
    fn what_no_surface_explains_is_not_shown_where_it_may_be_an_image() {
        let shown = |bridged: Verdict, image: Image| {
            let mut evidence = Evidence::default();
            evidence.fill(std::iter::once((Returns::new([5, 5], true), Track::default())));
            (evidence.judgements[0].bridged, evidence.judgements[0].image) = (bridged, image);
            evidence.take_unthinned(0);
            evidence.judgements[0].unthinned.is_shown()
        };
        let block = Block::default();
        let images = [Image::No, Image::NoOriginal(block), Image::Unknown(block), Image::Unexplained(block)];
        assert_eq!(images.map(|image| shown(Verdict::Oblique, image)), [true, true, false, false]);
        assert_eq!(images.map(|image| shown(Verdict::Lasting, image)), [true, true, false, false]);
        assert_eq!(images.map(|image| shown(Verdict::Surface, image)), [true; 4]);
    }
}
