//! What a cell with evidence knows beside its view angles ([`super::track`]): its occupancy, and what is known of its returns.
//!
//! Cells without evidence have no such state; one bit tells whether a beam has crossed them.

use super::{
    angle::{Angle, AngleRange, atan2},
    tiles::{CellIndex, TileIndex},
    track::{Event, Track, UNITS_PER_M},
    verdict::LASTING,
};

/// The rule of the core algorithm, in numbers.
#[derive(Clone, Copy, Debug)]
pub struct Rule {
    /// Occupancy that a contradiction takes for each scan; a hit adds one.
    pub contradiction: u8,
    /// Occupancy is not counted beyond this.
    pub cap: u8,
    /// Half a beam's width (units of [`Angle`]), by which every arc is wider than its directions.
    pub half_beam: u32,
    /// Relative error of two sensor positions right next to each other (m).
    pub drift_least: f32,
    /// By how much that error grows with the way driven between them (m/m).
    pub drift_rate: f32,
    /// The error never exceeds this, however long the way (m): the localization is bounded.
    pub drift_most: f32,
    /// Scans in a row without a return that tell that nothing is there to return.
    pub silent_scans: u16,
    /// Whether what glints may be outshone, from farther away than it was seen from, by what is behind it or reflected in it.
    pub outshone: bool,
    /// Whether a second range, apart from the first, is kept.
    pub two_ranges: bool,
    /// Whether what one range tells of may have gone while what the other tells of has not.
    pub apart: bool,
}

impl Rule {
    /// The shift between two view angles of a cell at `range` that a relative position error may
    /// explain, the sensor having driven `way` between them (units of [`Angle`]).
    pub(super) fn explained(&self, way: f32, range: u16) -> i32 {
        let error = (self.drift_least + self.drift_rate * way).min(self.drift_most);
        (atan2(error, f32::from(range) / UNITS_PER_M) * (65_536.0 / std::f32::consts::TAU)) as i32
    }
}

/// A second range of view angles tells of images if it is at least as wide (rad): 5 degrees. In narrower ones of an image, a gap of the
/// surface decides.
const TELLING: f64 = 0.087;

/// A range of view angles and how far the sensor had driven when it was recorded.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Visible {
    /// The range.
    pub range: AngleRange,
    /// Way driven at its last observation (m).
    pub way: f32,
    /// Distance of the sensor at the clockwise and at the counter-clockwise end (m).
    pub ranges: [f32; 2],
}

impl Visible {
    /// Where the sensor was relative to the cell (m), at both ends of the range.
    pub fn ends(&self) -> [[f64; 2]; 2] {
        [(0, self.ranges[0]), (self.range.width, self.ranges[1])].map(|(width, range)| {
            let (sin, cos) = Angle(self.range.start.0.wrapping_add(width)).rad().sin_cos();
            [f64::from(range) * cos, f64::from(range) * sin]
        })
    }
}

/// What a cell knows of its returns: all that is kept of it beside its [`Track`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Returns {
    /// Column and row in its tile.
    pub place: [u8; 2],
    /// Hits less contradictions, at most [`Rule::cap`]; the cell goes when this reaches 0.
    pub occupancy: u8,
    /// How often it was seen again from angles known before, after having been missed in between.
    pub passes: u8,
    /// Scans with a glint in it ([`super::glints`]).
    pub glints: u8,
    /// Scans with a return in it.
    pub hits: u16,
    /// Whether a beam had crossed it before the first return came: it was not there, or not visible.
    pub was_crossed: bool,
    /// Whether beams had gone past it shortly before, be it without return ([`super::earlier`]).
    pub was_passed: bool,
    /// Whether the robot itself had been there before the first return came.
    pub was_driven: bool,
    /// Mean [brightness](super::glints::Glints::brightness) of its first returns ([`BRIGHTNESS`]); [`UNKNOWN`] as long as none could be told.
    pub brightness: i16,
    /// The last scan that hit it, so that a scan counts once however many beams did.
    pub hit_scan: u32,
    /// Mean place of the returns in the cell (cells, 0..1 each).
    pub centroid: [f32; 2],
    /// When the first and the last return landed in it (s since the first scan).
    pub(super) hit_time: [f32; 2],
}

/// What has glinted at least once in so many scans that it was seen in may be glass or metal. Random readings come once in a thousand beams
/// (paper III-B), of which a scan has some in a cell.
const HITS_A_GLINT: u16 = 64;
/// Units of brightness in an octave.
pub const BRIGHTNESS: f32 = 256.0;
/// Scans whose returns tell how bright a cell is: single ones have a noise of 13 %.
const ENOUGH_TO_TELL: u16 = 64;
/// What has not glinted is a pane's dust if it is no brighter than this ([`BRIGHTNESS`]): a quarter of the brightest that is diffuse. Within a
/// degree of its normal a pane 1 m away is as bright as a wall at 2 m (paper III-B, Fig. 9).
const AS_DUST: i16 = -2 * BRIGHTNESS as i16;
/// No brightness that a return has.
pub const UNKNOWN: i16 = i16::MIN;

/// One over each number: a quotient takes long.
static WEIGHTS: [f32; 256] = {
    let (mut weights, mut number) = ([0.0; 256], 0);
    while number < weights.len() {
        weights[number] = 1.0 / number as f32;
        number += 1;
    }
    weights
};

impl Returns {
    /// Of a cell in which returns are about to land.
    pub fn new(place: [u8; 2], was_crossed: bool) -> Returns {
        Returns {
            place,
            occupancy: 0,
            passes: 0,
            glints: 0,
            hits: 0,
            was_crossed,
            was_passed: false,
            was_driven: false,
            brightness: UNKNOWN,
            hit_scan: 0,
            centroid: [0.5; 2],
            hit_time: [0.0; 2],
        }
    }

    /// The cell's place in the map, in this tile.
    pub fn index(&self, tile: TileIndex) -> CellIndex {
        tile.cell(usize::from(self.place[0]), usize::from(self.place[1]))
    }

    /// Whether it is glass, a mirror or metal, by its glints: they are no random readings.
    fn is_specular(&self) -> bool {
        self.has_glinted() && self.glints_often()
    }

    /// Whether it has glinted: more than once, since now and then a random reading is bright.
    pub fn has_glinted(&self) -> bool {
        self.glints >= 2
    }

    /// Whether it has glinted so often, for the scans that it was seen in, that this is not by chance; as far as glints are counted.
    pub fn glints_often(&self) -> bool {
        u16::from(self.glints) >= (self.hits / HITS_A_GLINT).clamp(1, u8::MAX.into())
    }

    /// Whether there may be two things in the cell: a pane and, seen from elsewhere, an image. What stood before a beam had ever crossed the cell
    /// is one thing, and so is what could have glinted, has not, and is too bright for dust.
    pub fn may_be_two(&self) -> bool {
        // What is not known is less than anything.
        self.was_crossed && (self.has_glinted() || self.brightness <= AS_DUST)
    }

    /// Core step 1: a return, which may be a glint, at this place in the cell (cells, 0..1).
    pub fn record_hit(&mut self, at: [f32; 2], is_glint: bool, scan: u32, time: f32, rule: &Rule) {
        if self.hits == 0 {
            self.hit_time[0] = time;
        }
        self.hit_time[1] = time;
        // Without a branch: it would be guessed wrong every other time.
        let is_first = self.hit_scan != scan;
        self.hit_scan = scan;
        self.occupancy = (self.occupancy + u8::from(is_first)).min(rule.cap);
        self.hits = self.hits.saturating_add(u16::from(is_first));
        self.glints = self.glints.saturating_add(u8::from(is_glint && is_first));
        let weight = WEIGHTS[usize::from(self.hits.min(255))];
        for (mean, at) in self.centroid.iter_mut().zip(at) {
            *mean += (at - *mean) * weight;
        }
    }

    /// Whether its brightness is to be recorded: of so many scans it is known well enough.
    #[inline(always)]
    pub fn needs_brightness(&self) -> bool {
        self.hits <= ENOUGH_TO_TELL || !self.is_brightness_known()
    }

    /// The return is so bright (octaves).
    #[inline(always)]
    pub fn record_brightness(&mut self, octaves: f32) {
        let now = (octaves * BRIGHTNESS).clamp(-f32::from(i16::MAX), f32::from(i16::MAX));
        let mean = if self.is_brightness_known() { f32::from(self.brightness) } else { now };
        let weight = WEIGHTS[usize::from(self.hits.clamp(1, ENOUGH_TO_TELL))];
        self.brightness = (mean + (now - mean) * weight) as i16;
    }

    /// Whether returns landed in it when their brightness, and so glints, could be told.
    pub fn is_brightness_known(&self) -> bool {
        self.brightness != UNKNOWN
    }

    /// Takes over what a scan has brought about; where the occupancy is 0 then, the cell must be removed (core step 5).
    /// A look stands for all `scans` since the one before, each of which may have hit it.
    pub fn record(&mut self, event: Event, scans: u16, rule: &Rule) {
        match event {
            Event::None => (),
            Event::Pass => self.passes = self.passes.saturating_add(1),
            Event::Contradiction { may_be_outshone: true } if rule.outshone && self.is_specular() => (),
            Event::Contradiction { .. } => {
                let taken = u16::from(rule.contradiction).saturating_mul(scans);
                self.occupancy = self.occupancy.saturating_sub(taken.min(u16::from(u8::MAX)) as u8);
            }
        }
    }
}

/// A cell with evidence, at least one return landed in it, and all that is known of it by now. For who judges and shows it: it is
/// kept as [`Returns`] and a [`Track`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// What is known of its returns.
    pub returns: Returns,
    /// phi_VIS: the widest range from which it was continuously observed.
    pub visible: Visible,
    /// The widest such range apart from `visible`; empty where `way` is negative.
    pub visible_too: Visible,
    /// Width of the widest range of misses that it survived (units of [`Angle`]).
    pub missed_width: u16,
    /// The widest since it was last observed.
    pub missed_since: AngleRange,
}

impl Cell {
    /// The cell of which this is kept.
    #[inline(always)]
    pub fn of(returns: &Returns, track: &Track) -> Cell {
        let [visible, visible_too] = track.visibles();
        Cell {
            returns: *returns,
            visible,
            visible_too,
            missed_width: track.missed_width,
            missed_since: track.missed_since,
        }
    }

    /// Its place in the map, in this tile.
    pub fn index(&self, tile: TileIndex) -> CellIndex {
        self.returns.index(tile)
    }

    /// Mean place of its returns in the map (m), in a grid of this resolution (m), `index` being its place there.
    pub fn returns_at(&self, index: CellIndex, resolution: f64) -> [f64; 2] {
        let [x, y] = self.returns.centroid.map(f64::from);
        [(f64::from(index.x) + x) * resolution, (f64::from(index.y) + y) * resolution]
    }

    /// The second range, if it is wide enough to tell of images.
    pub fn telling_too(&self) -> Option<&Visible> {
        Some(&self.visible_too).filter(|too| too.way >= 0.0 && too.range.width_rad() >= TELLING)
    }

    /// Mean brightness of its returns in half octaves, rounded down.
    fn half_octaves(&self) -> i16 {
        self.returns.brightness.div_euclid(BRIGHTNESS as i16 / 2)
    }

    /// Mean [brightness](super::glints::Glints::brightness) of its returns, where it could be told, rounded down to half an octave: all
    /// that matters of it.
    pub fn brightness(&self) -> Option<f64> {
        self.returns.is_brightness_known().then(|| f64::from(self.half_octaves()) / 2.0)
    }

    /// Numbers that are others as soon as anything is that the cell is judged by, all of it but when it was observed: the first tells of
    /// where it is seen from, as far as that tells of images, how bright it is, whether it has glinted and whether it may pass by, which is
    /// all that how it may be an image depends on, the second of the rest.
    pub fn fingerprints(&self) -> [[u32; 2]; 2] {
        let Cell { returns, visible, visible_too, missed_width, missed_since } = self;
        let pair = |[a, b]: [u32; 2]| u64::from(a) << 32 | u64::from(b);
        let floats = |floats: [f32; 2]| pair(floats.map(f32::to_bits));
        let range = |range: &AngleRange| u32::from(range.start.0) << 16 | u32::from(range.width);
        let counts = u32::from_le_bytes([returns.occupancy, returns.passes, returns.glints, 0]);
        // Without a second range, its ends are no distance at all.
        let too = |visible: &Visible| [floats(visible.ranges), u64::from(range(&visible.range))];
        let [telling_ends, telling] = self.telling_too().map(too).unwrap_or_default();
        let [ends_too, range_too] = too(visible_too);
        let seen_from = [
            u64::from(self.half_octaves() as u16) << 48
                | u64::from(self.may_pass_by()) << 40
                | u64::from(returns.glints.min(2)) << 32
                | u64::from(range(&visible.range)),
            floats(visible.ranges),
            telling_ends,
            telling,
        ];
        let rest = [
            floats(returns.centroid),
            floats(returns.hit_time),
            pair([range(missed_since), u32::from(*missed_width) << 16 | u32::from(returns.hits)]),
            u64::from(counts) << 32 | range_too,
            ends_too,
        ];
        [print(&seen_from), print(&rest)]
    }

    /// Whether it may be somebody who walks by in a mirror: seen for less than a second, and never missed.
    pub fn may_pass_by(&self) -> bool {
        self.missed_width == 0 && self.lasted() < LASTING
    }

    /// Time from its first return to its last (s).
    pub fn lasted(&self) -> f32 {
        self.returns.hit_time[1] - self.returns.hit_time[0]
    }
}

/// A number for these words, in two halves.
fn print(words: &[u64]) -> [u32; 2] {
    // Each step turns different numbers into different ones; 2^64 over the golden ratio spreads them.
    let print = words.iter().fold(0, |print: u64, word| {
        let mixed = (print ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        mixed ^ mixed >> 32
    });
    [(print >> 32) as u32, print as u32]
}
