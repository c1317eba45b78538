//! Images: what is seen in a mirror, in polished metal, or reflected by glass, stands elsewhere.
//!
//! The line of sight to an image crosses the surface that reflects it. Mirrored at that surface, the image
//! falls on what it is an image of: a mapped cell, or the robot itself (paper IV-B.2 looks only at beams through surfaces
//! that are mapped already; this looks back, since an image is often mapped before its mirror is, which is seen only near
//! its normal).
//!
//! Where the mirror is not mapped, or not well enough, a wall may tell as much: what is seen through one that has always stood there is an
//! image of something, wherever that is.

use super::{
    angle::{Angle, AngleRange, units},
    cell::Cell,
    idea::Idea,
    mirrors::Mirror,
    squares::{CellsBySquare, Extent, cells_of, rectangle},
    tiles::{CellIndex, PlaceHasher, SIDE, TileIndex, floor_near, whole},
    visagge::{Evidence, Tile, Visagge, place_of},
};
use std::cell::LazyCell;
use std::collections::{BTreeMap, HashMap};
use std::f64::consts::SQRT_2;
use std::hash::{BuildHasherDefault, Hash, Hasher};
use std::ops::RangeInclusive;

/// From which parts of the straight way from one end of the range of view angles to the other the line of sight is looked at, the
/// most telling first. The very ends look past the edges of the surface that reflects, where a cell's error decides.
const OBSERVERS: [f64; 5] = [0.5, 0.3, 0.7, 0.1, 0.9];
/// How many of these need not be explained: surfaces are mapped with gaps.
const GAPS: usize = 2;
/// What is crossed this near to the cell is the surface that the cell is part of (m).
const CLEAR_OF_CELL: f64 = 0.3;
/// What is crossed this near to the sensor is the robot (m).
const CLEAR_OF_SENSOR: f64 = 0.2;
/// A surface is drawn no thicker than this (m): two cells, by the noise of ranges and poses.
const THICKNESS: f64 = 0.1;
/// The robot's body reaches this far from the sensor (m): half a wheelchair and its footrest.
const BODY: f64 = 0.6;
/// How exactly an image is known (m): a cell and the noise of two poses.
const PLACE: f64 = 0.1;
/// How exactly the direction of the reflecting surface is known (rad).
const DIRECTION: f64 = 0.02;
/// Widest search around the mirrored point (m).
const WIDEST: f64 = 0.3;
/// An original tells that a surface is opaque if it lies within this part of how exactly it is known: rooms on both sides of glass may be as deep
/// as each other, give or take a quarter of a metre, and seldom are exactly.
const TELLS: f64 = 0.5;
/// An original that is seen from some directions only is seen up to this far off those from which it was (rad): 6 degrees, by which
/// an image is off at 3 m from where it is sought.
const OFF_VIEW: f64 = 0.1;
/// Share that a surface must reflect for a glint to be one in it still, on the way there and on the way back: a quarter is left. Glass does at
/// 78 degrees of incidence.
const OF_GLINTS: f64 = 0.5;
/// An image in glass may be brighter than glass makes of the brightest walls by this factor: walls may be grey, where what is reflected is
/// white, and brightness has a noise of 13 %.
const WHITER: f64 = 4.0;
/// What may be somebody who walks by in a mirror is solid only if it was seen for so long (s), in as many scans as come in this time. Of somebody
/// who walks by in a mirror each cell is seen for no longer than that, and nothing comes to free it: beams to what is farther meet the
/// mirror elsewhere.
const GLIMPSE: f64 = 0.26;
/// No more scans than this are asked for, which a UTM-30LX sends in the time; nor fewer than make anything solid.
const GLIMPSES: RangeInclusive<f64> = 2.0..=10.0;
/// A wall hides what is behind it if it does so this far to both sides of the line of sight as well, step by step (m): past its ends and
/// through its gaps errors of poses decide.
const ASIDE: [f64; 5] = [0.0, 0.05, -0.05, 0.1, -0.1];
/// More than any of these (m).
pub(super) const BESIDE_WALLS: f64 = 0.15;
/// More than a line of sight is off by rounding (m).
pub(super) const ROUNDED: f64 = 0.01;

/// Half the side of the blocks in which surfaces are told to be opaque or not (cells).
const BLOCK: i32 = 16;
/// Share of what is seen through a surface, and could be known, that must be explained for the surface to be opaque. In
/// a mirror nearly everything is, short of what has moved; behind glass what happens to be symmetric.
const OPAQUE: f32 = 0.65;
/// A wall that runs straight at a mirror goes on this far before or behind each of its cells (m); one that is met face on, errors of
/// ranges and poses included, is not that deep.
const RUNS_ON: f64 = 0.25;
/// A wall hides from a surface what is at least this far behind the wall (m): originals are sought within [0.3 m](WIDEST), and where light
/// meets a wall at an angle of 17 degrees, 0.3 m beside is 1 m along it.
const HIDDEN: f64 = 1.0;
/// The ways that light could take are looked at between these, in parts of how exactly the original is known.
const ACROSS: [f64; 5] = [0.0, 0.5, -0.5, 1.0, -1.0];
/// Distance at which the scanner sees a good target (m). UTM-30LX: 30, which a target of albedo 0.9 returns.
const SEES: f64 = 30.0;

/// How a cell may be an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Image {
    /// Not seen through any surface.
    #[default]
    No,
    /// Seen through a surface, and where its original would stand beams have passed.
    Unexplained(Block),
    /// The same, but seen as shortly as somebody who walks by.
    PassedBy(Block),
    /// Seen through a surface, and a wall hides from that where its original would stand: so it has none.
    NoOriginal(Block),
    /// Seen through a surface, and no beam has come to where its original would stand, or what stands thereabouts may be another thing, or it
    /// runs straight at the surface, or is too bright for what would be glass.
    Unknown(Block),
    /// Explained, but glass would not reflect that much: only an opaque surface there.
    IfOpaque(Block),
    /// Explained, in any surface.
    Yes,
}

impl Image {
    /// The value of layer `image` in map.npz.
    pub fn number(self) -> u8 {
        match self {
            Image::No => 0,
            Image::Unexplained(_) | Image::NoOriginal(_) => 1,
            Image::Unknown(_) | Image::PassedBy(_) => 2,
            Image::IfOpaque(_) => 3,
            Image::Yes => 4,
        }
    }

    /// The verdict, where the surfaces in these blocks are opaque, and no others. They are in order.
    pub(super) fn is_image(self, opaque: &[Block]) -> bool {
        match self {
            Image::No => false,
            // Through what is opaque nothing is seen, explained or not: it has moved on, or was reflected twice.
            Image::Unexplained(block)
            | Image::PassedBy(block)
            | Image::NoOriginal(block)
            | Image::Unknown(block)
            | Image::IfOpaque(block) => opaque.binary_search(&block).is_ok(),
            Image::Yes => true,
        }
    }

    /// Whether it may be an image at all: it is seen through a surface, and no wall hides its original.
    pub(super) fn may_be(self) -> bool {
        !matches!(self, Image::No | Image::NoOriginal(_))
    }

    /// Whether it may be of somebody who walks by in a mirror: beams have passed where he would be, after him or before, or something is mapped
    /// there that only a mirror would show.
    pub(super) fn may_pass_by(self) -> bool {
        matches!(self, Image::Unexplained(_) | Image::PassedBy(_) | Image::IfOpaque(_))
    }
}

/// A block of cells. Packed, since each cell keeps some.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[repr(Rust, packed)]
pub(super) struct Block {
    /// Its place modulo 2^16 blocks, which is 52 km.
    x: i16,
    y: i16,
}

impl Hash for Block {
    fn hash<H: Hasher>(&self, state: &mut H) {
        let Block { x, y } = *self;
        state.write_i32(i32::from(x) << 16 | i32::from(y as u16));
    }
}

impl Block {
    fn of(cell: CellIndex) -> Block {
        Block { x: cell.x.div_euclid(BLOCK) as i16, y: cell.y.div_euclid(BLOCK) as i16 }
    }

    /// It and the eight around it.
    fn around(self) -> impl Iterator<Item = Block> {
        let Block { x, y } = self;
        (-1..=1).flat_map(move |dy| {
            (-1..=1).map(move |dx| Block { x: x.wrapping_add(dx), y: y.wrapping_add(dy) })
        })
    }
}

/// Where something was looked at for originals.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Looked {
    /// Where they were sought.
    pub originals: Extent,
    /// Which ways light from there was followed.
    pub ways: Extent,
}

impl Looked {
    /// What holds both.
    pub(super) fn and(self, other: Looked) -> Looked {
        Looked { originals: self.originals.and(other.originals), ways: self.ways.and(other.ways) }
    }
}

/// The tiles that images were judged by.
#[derive(Clone, Debug, Default)]
pub(super) struct Sources {
    /// Those that lines of sight cross, by their mirrors and walls.
    pub crossed: Places,
    /// Those in which originals were sought, by what is shown, from where it is seen, and what is free there.
    pub sought: Places,
}

impl Sources {
    /// Memory beside itself (bytes).
    pub fn bytes(&self) -> usize {
        (self.crossed.0.capacity() + self.sought.0.capacity()) * size_of::<TileIndex>()
    }
}

/// The same while images are judged.
pub(super) struct Lookups {
    crossed: Lookup,
    sought: Sought,
}

impl Lookups {
    /// The same, of cells of a tile.
    pub(super) fn of(tile: TileIndex, Sources { crossed, sought }: Sources) -> Lookups {
        let lookup = |places| Lookup { places, recent: [None; 64], met: false };
        let sought = Sought { lookup: lookup(sought), of: tile, looked: Looked::default() };
        Lookups { crossed: lookup(crossed), sought }
    }

    /// Whether lines of sight met nothing at all since this was last asked.
    pub(super) fn were_clear(&mut self) -> bool {
        !std::mem::take(&mut self.crossed.met)
    }

    /// Where originals were sought since this was last asked.
    pub(super) fn sought(&mut self) -> Looked {
        std::mem::take(&mut self.sought.looked)
    }
}

impl From<Lookups> for Sources {
    fn from(Lookups { crossed, sought }: Lookups) -> Sources {
        Sources { crossed: crossed.places, sought: sought.lookup.places }
    }
}

/// Looks tiles up, and takes note of where.
struct Lookup {
    places: Places,
    /// Those that were looked up last, by the lowest bits of their places: nearly always it is one of these again.
    recent: [Option<(TileIndex, Option<u32>)>; 64],
    /// Whether a line of sight has met one of the cells that it was about.
    met: bool,
}

impl Lookup {
    /// The tile at this place.
    fn tile<'a>(&mut self, grid: &'a Visagge, place: TileIndex) -> Option<&'a Tile> {
        let recent = &mut self.recent[(place.y << 3 & 0o70 | place.x & 7) as usize];
        let number = match recent {
            Some((of, number)) if *of == place => *number,
            _ => {
                self.places.insert(place);
                let number = grid.tiles.find(place).map(|number| number as u32);
                *recent = Some((place, number));
                number
            }
        };
        number.map(|number| grid.tiles.at(number as usize))
    }
}

/// Where originals are sought.
struct Sought {
    lookup: Lookup,
    /// The tile whose cells are judged.
    of: TileIndex,
    /// Where that was for one cell, since this was last taken.
    looked: Looked,
}

impl Sought {
    /// The tile at this place, of which the cells between these two are looked at.
    fn tile<'a>(&mut self, grid: &'a Visagge, place: TileIndex, cells: [[usize; 2]; 2]) -> Option<&'a Tile> {
        self.looked.originals.extend(self.of, place, cells);
        self.lookup.tile(grid, place)
    }
}

/// Places of tiles, each of them once.
#[derive(Clone, Debug, Default)]
pub(super) struct Places(Vec<TileIndex>);

impl Places {
    fn insert(&mut self, place: TileIndex) {
        if let Err(at) = self.0.binary_search(&place) {
            self.0.reserve_exact(usize::from(self.0.len() == self.0.capacity()) * 4);
            self.0.insert(at, place);
        }
    }

    /// All of them.
    pub fn iter(&self) -> impl Iterator<Item = TileIndex> {
        self.0.iter().copied()
    }
}

/// What is seen through the surfaces in each block: how much of it is explained, and all of it.
#[derive(Clone, Debug, Default)]
pub(super) struct Opacity {
    votes: BTreeMap<Block, (u32, u32)>,
}

impl Opacity {
    /// Counts what was found of a cell.
    pub(super) fn vote(&mut self, image: Image) {
        let (block, explained, all) = match image {
            Image::No | Image::Yes => return,
            Image::Unknown(block) | Image::PassedBy(block) => (block, 0, 0),
            Image::Unexplained(block) | Image::NoOriginal(block) => (block, 0, 1),
            Image::IfOpaque(block) => (block, 1, 1),
        };
        self.count(block, (explained, all));
    }

    fn count(&mut self, block: Block, (explained, all): (u32, u32)) {
        let votes = self.votes.entry(block).or_default();
        *votes = (votes.0 + explained, votes.1 + all);
    }

    /// Memory beside itself (bytes), but for what the tree takes beside its entries.
    pub(super) fn bytes(&self) -> usize {
        self.votes.len() * size_of::<(Block, (u32, u32))>()
    }
}

/// The same of all the map.
#[derive(Debug, Default)]
pub(super) struct AllOpacity {
    votes: HashMap<Block, (u32, u32), BuildHasherDefault<PlaceHasher>>,
}

impl AllOpacity {
    /// Counts what was counted in a tile.
    pub(super) fn add(&mut self, of: &Opacity) {
        for (block, (explained, all)) in &of.votes {
            let votes = self.votes.entry(*block).or_default();
            *votes = (votes.0 + explained, votes.1 + all);
        }
    }

    /// Those of the blocks counted in `of` whose surface reflects all that is seen through it.
    pub(super) fn opaque(&self, of: &Opacity) -> Vec<Block> {
        of.votes.keys().copied().filter(|block| self.is_opaque(*block)).collect()
    }

    /// Whether the surface in the block, with its neighbours, reflects all that is seen through it.
    fn is_opaque(&self, block: Block) -> bool {
        let (explained, all) = block
            .around()
            .filter_map(|block| self.votes.get(&block))
            .fold((0, 0), |sum, votes| (sum.0 + votes.0, sum.1 + votes.1));
        all > 0 && explained as f32 >= OPAQUE * all as f32
    }
}

/// Whether a cell is explained as an image from everywhere it was seen. `lookups` take in what this depends on, but for the cell.
pub(super) fn image(
    grid: &Visagge,
    place: TileIndex,
    cell: &Cell,
    sights: &mut Sights,
    lookups: &mut Lookups,
) -> Image {
    let point = cell.index(place).middle(grid.resolution);
    let too = cell.telling_too().filter(|_| grid.settings.has(Idea::SecondRange));
    let has_glinted = cell.returns.has_glinted();
    let passes_by = cell.may_pass_by() && grid.settings.has(Idea::PassersBy);
    let mut image = Image::Yes;
    let mut glass = None;
    for (range, visible) in [Some(&cell.visible), too].into_iter().flatten().enumerate() {
        let (mut explaining, mut unexplained) = (0, 0);
        let [from, to] = visible.ends();
        for (observer, part) in OBSERVERS.into_iter().enumerate() {
            let [x, y] = [0, 1].map(|axis| from[axis] + (to[axis] - from[axis]) * part);
            let from = [point[0] + x, point[1] + y];
            let sight = Sight {
                from,
                to: point,
                range: (x * x + y * y).sqrt(),
                has_glinted,
                // Where enough explain it, others do not matter; nor, before too many do not, how they do not.
                may_explain: explaining < OBSERVERS.len() - GAPS,
                decides: unexplained == GAPS,
            };
            let found = explained(grid, &sight, lookups, &mut glass);
            explaining += usize::from(matches!(found, Image::IfOpaque(_) | Image::Yes));
            match found {
                Image::Yes => (),
                _ if sights
                    .is_behind(range, observer, || is_behind_wall(grid, &sight, &mut lookups.crossed)) => {}
                Image::IfOpaque(block) => image = Image::IfOpaque(block),
                other => {
                    unexplained += 1;
                    if unexplained > GAPS {
                        return match other {
                            // Nor do glints move on.
                            _ if has_glinted => Image::No,
                            // Nor does somebody who walks by tell what shows him.
                            Image::Unexplained(block) if passes_by => Image::PassedBy(block),
                            other => other,
                        };
                    }
                }
            }
        }
    }
    match (image, glass, cell.brightness()) {
        (Image::Yes, Some(glass), Some(brightness))
            if cell.returns.glints == 0
                && brightness > (glass.reflects.powi(2) * WHITER).log2()
                && [Idea::Fresnel, Idea::Bright].iter().all(|idea| grid.settings.has(*idea)) =>
        {
            Image::Unknown(glass.block)
        }
        _ => image,
    }
}

/// A surface that explains an image if it is glass.
struct Glass {
    block: Block,
    /// Share of the light that it reflects, at most.
    reflects: f64,
}

/// What is known of the lines of sight to a cell from its first range of view angles, until that or the walls on them change.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Sights {
    /// A bit for each of [`OBSERVERS`] that sees it past the walls.
    past_walls: u8,
    /// The same of those that see a wall before it, and [`CLEAR`].
    behind: u8,
}

/// Of `Sights::behind`.
const CLEAR: u8 = 1 << 7;

impl Sights {
    /// Whether the cell is no image since its lines of sight met nothing.
    pub(super) fn are_clear(self) -> bool {
        self.behind & CLEAR != 0
    }

    /// Takes note of that.
    pub(super) fn set_clear(&mut self, are_clear: bool) {
        self.behind = self.behind & !CLEAR | if are_clear { CLEAR } else { 0 };
    }

    /// Whether the cell is behind a wall, seen from there; `look` tells where that is not known.
    fn is_behind(&mut self, range: usize, observer: usize, look: impl FnOnce() -> bool) -> bool {
        let bit = u8::from(range == 0) << observer;
        if (self.past_walls | self.behind) & bit == 0 {
            if look() {
                self.behind |= bit;
                return true;
            }
            self.past_walls |= bit;
        }
        self.behind & bit != 0
    }
}

/// A square in which cells are no longer what they were.
pub(super) struct Spot {
    /// Around the square, and farther by how far beside a cell a line of sight still depends on it.
    around: Circle,
    /// The same around the square's first cell.
    first: Circle,
    /// A bit for each of the cells, row by row, and side of a cell (m).
    cells: u64,
    resolution: f64,
}

impl Spot {
    /// These cells of a tile, on which lines of sight depend that pass them so far beside (m).
    pub(super) fn of(
        place: TileIndex,
        cells: &CellsBySquare,
        resolution: f64,
        beside: f64,
    ) -> impl Iterator<Item = Spot> {
        cells.iter().map(move |(square, cells)| {
            let CellIndex { x, y } = place.cell(8 * (square & 7), 8 * (square >> 3));
            let circle = |side: f64| Circle {
                middle: [x, y].map(|low| (f64::from(low) + side / 2.0) * resolution),
                radius: side * SQRT_2 / 2.0 * resolution + beside,
            };
            Spot { around: circle(8.0), first: circle(1.0), cells, resolution }
        })
    }

    /// The circle around each of the cells.
    fn each(&self) -> impl Iterator<Item = Circle> {
        cells_of(self.cells).map(|cell| {
            let to = [cell & 7, cell >> 3].map(|cells| -(cells as f64) * self.resolution);
            self.first.seen_from(to)
        })
    }
}

#[derive(Clone, Copy)]
struct Circle {
    middle: [f64; 2],
    radius: f64,
}

impl Circle {
    fn seen_from(self, [x, y]: [f64; 2]) -> Circle {
        Circle { middle: [self.middle[0] - x, self.middle[1] - y], ..self }
    }
}

/// The straight way from a cell to there (m), and how far that is.
struct Way {
    to: [f64; 2],
    range: f64,
}

impl Way {
    fn to([x, y]: [f64; 2]) -> Way {
        Way { to: [x, y], range: (x * x + y * y).sqrt() }
    }

    /// How far a circle, seen from the cell, is along and beside it, and its radius; all of this times the range.
    fn relative(&self, circle: Circle) -> [f64; 3] {
        let ([x, y], [to_x, to_y]) = (circle.middle, self.to);
        [x * to_x + y * to_y, x * to_y - y * to_x, circle.radius * self.range]
    }

    fn comes_into(&self, circle: Circle) -> bool {
        let [along, beside, radius] = self.relative(circle);
        beside.abs() <= radius && along >= -radius && along <= self.range * self.range + radius
    }

    /// On which side it leaves a circle: -1 or 1, or 0 where it would go through, however far it went.
    fn side(&self, circle: Circle) -> i8 {
        let [_, beside, radius] = self.relative(circle);
        i8::from(beside > radius) - i8::from(beside < -radius)
    }
}

/// Whether a line of sight to the cell may depend on one of these.
pub(super) fn passes(grid: &Visagge, place: TileIndex, cell: &Cell, spots: &[Spot]) -> bool {
    let point = cell.index(place).middle(grid.resolution);
    [Some(&cell.visible), cell.telling_too()].into_iter().flatten().any(|visible| {
        let [from, to] = visible.ends();
        // All of these are in the triangle of the cell and both ends.
        let ways =
            OBSERVERS.map(|part| Way::to([0, 1].map(|axis| from[axis] + (to[axis] - from[axis]) * part)));
        let bounds =
            [0, 1].map(|axis| [from[axis].min(to[axis]).min(0.0), from[axis].max(to[axis]).max(0.0)]);
        let [from, to] = [from, to].map(Way::to);
        let comes_into_triangle = |circle: Circle| {
            let is_within = |axis: usize| {
                let [low, high] = bounds[axis];
                (low - circle.radius..=high + circle.radius).contains(&circle.middle[axis])
            };
            is_within(0) && is_within(1) && {
                let side = from.side(circle);
                side == 0 || side != to.side(circle)
            }
        };
        spots.iter().any(|spot| {
            let around = spot.around.seen_from(point);
            comes_into_triangle(around)
                && ways.iter().any(|way| {
                    way.comes_into(around) && spot.each().any(|cell| way.comes_into(cell.seen_from(point)))
                })
        })
    })
}

/// A line of sight.
struct Sight {
    /// The sensor (m).
    from: [f64; 2],
    /// The cell (m).
    to: [f64; 2],
    /// From one to the other (m).
    range: f64,
    /// Whether the cell has glints.
    has_glinted: bool,
    /// Whether it matters that what would explain the cell is hidden.
    may_explain: bool,
    /// Whether it matters how the cell may be an image where nothing explains it.
    decides: bool,
}

/// Whether a surface on the line of sight shows at its end what is elsewhere. Where it would as glass, `glass` becomes that surface, if it
/// reflects more.
fn explained<'a>(
    grid: &'a Visagge,
    sight: &Sight,
    lookups: &mut Lookups,
    glass: &mut Option<Glass>,
) -> Image {
    let mut image = Image::No;
    let Sight { from: sensor, to: point, range, .. } = *sight;
    let Lookups { crossed, sought } = lookups;
    let view = [sensor[0] - point[0], sensor[1] - point[1]];
    let near = |evidence: &'a Evidence| Some(evidence.mirrors.as_ref()?.near());
    follow(grid, sight, crossed, near, |evidence, place, [column, row], distance| {
        let mirrors = evidence.mirrors.as_ref();
        let mirror = mirrors.and_then(|mirrors| mirrors.nearest(column, row));
        let Some(mirror) = mirror else { return false };
        let block = Block::of(place.cell(column, row));
        let [mirrored, image_of_sensor] = mirror.plane.reflect([point, sensor]);
        let is_within = |reach: f64, [x, y]: [f64; 2]| {
            (mirrored[0] - x).powi(2) + (mirrored[1] - y).powi(2) <= reach * reach
        };
        let known = PLACE + 2.0 * DIRECTION * (range - distance);
        let tolerance = known.min(WIDEST);
        // What lies in the plane of a mirror would be its own original.
        if is_within(SQRT_2 * tolerance, point) {
            return false;
        }
        // Where the original would be seen from.
        let seen_from = LazyCell::new(|| {
            let [x, y] = image_of_sensor;
            Angle::of([x - mirrored[0], y - mirrored[1]])
        });
        let is_hidden = |sought: &mut Sought| {
            let met = [0, 1].map(|axis| sensor[axis] - view[axis] * distance / range);
            grid.is_hidden(mirrored, tolerance, &Sight { from: met, ..*sight }, sought)
        };
        let is_robot = is_within(BODY + tolerance, sensor);
        let explains = is_robot
            || grid.has_original(mirrored, || *seen_from, tolerance, sought)
                && !(sight.may_explain && is_hidden(sought));
        let needed = (range / SEES).max(if sight.has_glinted { OF_GLINTS } else { 0.0 });
        let reflects = LazyCell::new(|| glass_reflects(mirror.plane.off_normal(view[1].atan2(view[0]))));
        let tells = grid.settings.has(Idea::Tells);
        // Of what glints hardly anything else is that near.
        let is_right_there = |sought: &mut Sought| {
            is_robot
                || sight.has_glinted
                || grid.has_original(mirrored, || *seen_from, tolerance.min(TELLS * known), sought)
        };
        let is_any_around = |sought: &mut Sought| {
            known > tolerance && grid.is_any_shown(mirrored, known, sought, |_, _, _| true)
        };
        let by_glass = || needed <= *reflects || !grid.settings.has(Idea::Fresnel);
        image = match (explains, image) {
            (true, _) if by_glass() => {
                if glass.as_ref().is_none_or(|glass| glass.reflects < *reflects) {
                    *glass = Some(Glass { block, reflects: *reflects });
                }
                Image::Yes
            }
            (true, _) if grid.runs_along(point, mirror.plane.normal(), sought) => Image::Unknown(block),
            (true, _) if tells && !is_right_there(sought) => Image::Unknown(block),
            (true, _) => Image::IfOpaque(block),
            (false, Image::No)
                if sight.decides
                    && grid.is_crossed(mirrored, sought)
                    && !(tells && is_any_around(sought)) =>
            {
                Image::Unexplained(block)
            }
            (false, Image::No) if sight.decides && is_hidden(sought) => Image::NoOriginal(block),
            (false, Image::No) => Image::Unknown(block),
            _ => image,
        };
        explains
    });
    image
}

/// Share of the light that a pane of glass (index of refraction 1.5, both faces) reflects at an angle of incidence
/// (rad): Fresnel, of light polarised across the plane of incidence. A laser's light is polarised, and how is in no data
/// sheet: this is the most that glass may reflect.
fn glass_reflects(incidence: f64) -> f64 {
    let cos = incidence.cos();
    let cos_inside = (1.0 - (incidence.sin() / 1.5).powi(2)).sqrt();
    let across = ((cos - 1.5 * cos_inside) / (cos + 1.5 * cos_inside)).powi(2);
    2.0 * across / (1.0 + across)
}

/// Whether the line of sight meets a wall.
fn meets_wall(grid: &Visagge, sight: &Sight, crossed: &mut Lookup) -> bool {
    follow(grid, sight, crossed, |evidence| Some(&evidence.walls), |_, _, _, _| true)
}

/// Whether a wall hides what is at the end of the line of sight.
fn is_behind_wall(grid: &Visagge, sight: &Sight, crossed: &mut Lookup) -> bool {
    let [x, y] = [0, 1].map(|axis| (sight.to[axis] - sight.from[axis]) / sight.range);
    grid.settings.has(Idea::Walls)
        && ASIDE.into_iter().all(|aside| {
            let beside = |[at_x, at_y]: [f64; 2]| [at_x - y * aside, at_y + x * aside];
            let sight = Sight { from: beside(sight.from), to: beside(sight.to), ..*sight };
            meets_wall(grid, &sight, crossed)
        })
}

/// Visits those of `cells` that are on the line of sight, until `visit` returns true. Gives whether it did.
fn follow<'a>(
    grid: &'a Visagge,
    sight: &Sight,
    crossed: &mut Lookup,
    cells: impl Fn(&'a Evidence) -> Option<&'a CellsBySquare>,
    mut visit: impl FnMut(&'a Evidence, TileIndex, [usize; 2], f64) -> bool,
) -> bool {
    let resolution = grid.resolution;
    // Half a cell: rows of cells that touch at their corners only are not slipped through.
    let step = resolution / 2.0;
    let end = sight.range - CLEAR_OF_CELL;
    let course = Course::of(sight, resolution);
    // Steps are counted from where it begins and, having met a cell, behind that: where they end depends on nothing else, not even on
    // rounding.
    let mut origin = CLEAR_OF_SENSOR;
    let mut entered = 0;
    let at = |origin: f64, steps: i64| origin + step * steps as f64;
    // The first that ends there (m) or beyond, or before that by no more than rounding.
    let first = |origin: f64, to: f64| whole((to - origin) * (2.0 / resolution) + (0.5 - 1e-6)).max(0);
    while at(origin, entered) < end {
        let distance = at(origin, entered);
        let place = course.tile(distance);
        let course = course.inside(place);
        let leaves = course.leaves(f64::from(SIDE));
        let evidence = crossed.tile(grid, place).and_then(|tile| tile.evidence.as_deref());
        let found = evidence.and_then(|evidence| Some((evidence, cells(evidence)?)));
        let mut steps = entered;
        if let Some((evidence, cells)) = found {
            let mut squares = course.squares(distance, leaves.min(end), cells.squares());
            while squares != 0 {
                let square = course.first(squares);
                squares &= !(1 << square);
                let [enters, leaves] = course.crosses(square);
                if enters > leaves {
                    continue;
                }
                let mut from = first(origin, enters).max(steps);
                while let Some((further, cell)) =
                    course.go_on(square, cells.cells(square), at(origin, from), step)
                {
                    let distance = at(origin, from + further);
                    if distance >= end {
                        break;
                    }
                    crossed.met = true;
                    if visit(evidence, place, cell, distance) {
                        return true;
                    }
                    (origin, steps, from) = (distance + THICKNESS, 0, 0);
                }
            }
        }
        steps = first(origin, leaves).max(steps);
        // On a border, rounding may tell that it is in this tile and, in the tile's own columns and rows, that it is not.
        let is_stuck = at(origin, steps) <= distance;
        entered = steps + i64::from(is_stuck || course.is_inside(at(origin, steps)));
    }
    false
}

/// The course of a line of sight.
#[derive(Clone, Copy)]
struct Course {
    /// Where it begins (cells).
    start: [f64; 2],
    /// How it goes on (cells a metre), and the inverse.
    along: [f64; 2],
    inverse: [f64; 2],
}

impl Course {
    fn of(sight: &Sight, resolution: f64) -> Course {
        let along = [0, 1].map(|axis| (sight.to[axis] - sight.from[axis]) / (sight.range * resolution));
        // No negative zeros.
        let inverse = along.map(|along| 1.0 / (along + 0.0));
        Course { start: sight.from.map(|at| at / resolution), along, inverse }
    }

    /// The tile that it is in there (m).
    fn tile(&self, distance: f64) -> TileIndex {
        let [x, y] = self.at(distance).map(floor_near);
        CellIndex { x, y }.split().0
    }

    /// The same course, in columns and rows of a tile.
    fn inside(self, tile: TileIndex) -> Course {
        let corner = tile.cell(0, 0);
        Course { start: [self.start[0] - f64::from(corner.x), self.start[1] - f64::from(corner.y)], ..self }
    }

    fn at(&self, distance: f64) -> [f64; 2] {
        [0, 1].map(|axis| self.start[axis] + self.along[axis] * distance)
    }

    /// Whether it is in the tile there (m).
    fn is_inside(&self, distance: f64) -> bool {
        self.at(distance).iter().all(|at| (0.0..f64::from(SIDE)).contains(at))
    }

    /// Goes on from there (m) in steps, to the first of these cells in the square of 8 x 8 with this number (a bit for each, row by row).
    /// Gives how many steps that takes, and column and row; nothing where the square is left before. It may begin before the square,
    /// by no more than a step.
    fn go_on(&self, square: usize, cells: u64, from: f64, step: f64) -> Option<(i64, [usize; 2])> {
        // Whole numbers: rounding down is a shift. 2^-40 of a cell a step is less than all else rounds.
        const ONE: f64 = (1u64 << 40) as f64;
        let low = [square & 7, square >> 3].map(|at| 8 * at as i64);
        let start = self.at(from).map(|at| whole(at * ONE));
        let mut at = [start[0] - (low[0] << 40), start[1] - (low[1] << 40)];
        let along = self.along.map(|along| whole(along * step * ONE));
        let mut steps = 0;
        loop {
            let [x, y] = at.map(|at| at >> 40);
            if (x | y) & !7 == 0 {
                if cells >> (8 * y + x) & 1 == 1 {
                    return Some((steps, [(low[0] + x) as usize, (low[1] + y) as usize]));
                }
            } else if steps > 0 {
                return None;
            }
            at = [at[0] + along[0], at[1] + along[1]];
            steps += 1;
        }
    }

    /// Distance at which it leaves the square between 0 and this in x and y, which it is in (m).
    fn leaves(&self, side: f64) -> f64 {
        let [x, y] = [0, 1].map(|axis| {
            let border = if self.along[axis] >= 0.0 { side } else { 0.0 };
            (border - self.start[axis]) * self.inverse[axis]
        });
        x.min(y)
    }

    /// Distances at which it enters and leaves the square of 8 x 8 cells with this number (m).
    fn crosses(&self, square: usize) -> [f64; 2] {
        let [x, y] = [0, 1].map(|axis| {
            let low = ((square >> (3 * axis) & 7) * 8) as f64;
            let [first, last] = if self.along[axis] >= 0.0 { [low, low + 8.0] } else { [low + 8.0, low] };
            [first, last].map(|border| (border - self.start[axis]) * self.inverse[axis])
        });
        [x[0].max(y[0]), x[1].min(y[1])]
    }

    /// Those of these squares of 8 x 8 cells that are in the rectangle around its course between two distances (m) within the tile: a bit for
    /// each, row by row.
    fn squares(&self, from: f64, to: f64, of: u64) -> u64 {
        if of == 0 {
            return 0;
        }
        let [from, to] = [from, to].map(|distance| self.at(distance));
        let [columns, rows] = [0, 1].map(|axis| {
            // A little more than that, for what lies on a border.
            let ends = [from[axis].min(to[axis]) - 1e-5, from[axis].max(to[axis]) + 1e-5];
            ends.map(|at| whole(at / 8.0 - 0.5).clamp(0, 7) as u32)
        });
        of & rectangle(columns, rows)
    }

    /// Which of these squares it comes to first.
    fn first(&self, squares: u64) -> usize {
        let row = if self.along[1] >= 0.0 { squares.trailing_zeros() } else { squares.ilog2() } / 8;
        let columns = squares >> (8 * row) & 0xff;
        let column = if self.along[0] >= 0.0 { columns.trailing_zeros() } else { columns.ilog2() };
        (8 * row + column) as usize
    }
}

impl Evidence {
    /// Whether a cell that is shown is seen from a direction. What something is seen through is not seen from everywhere.
    fn is_seen(&self, column: usize, row: usize, seen_from: impl Fn() -> Angle) -> bool {
        let mirror =
            self.mirrors.as_ref().and_then(|mirrors| mirrors.get(place_of([column as u8, row as u8])));
        let is_in_view = |mirror: &Mirror| {
            let off = -mirror.visible.depth(AngleRange::at(seen_from()), 0);
            off < units(OFF_VIEW) as i32
        };
        mirror.is_none_or(is_in_view) || self.walls.has(column, row)
    }
}

impl Visagge {
    /// In so many scans something must have been seen through a surface, or in it, to be solid; in 0 where that does not matter.
    pub(super) fn glimpses(&self) -> u16 {
        let period = self.elapsed_ns as f64 * 1e-9 / f64::from(self.scan);
        let scans = if period > 0.0 { GLIMPSE / period } else { f64::INFINITY };
        let scans = scans.round().clamp(*GLIMPSES.start(), *GLIMPSES.end());
        if self.settings.has(Idea::Glimpses) { scans as u16 } else { 0 }
    }

    /// The cell that holds a point, which is not far beyond the map (m).
    fn cell_near(&self, point: [f64; 2]) -> CellIndex {
        let [x, y] = point.map(|at| floor_near(at / self.resolution));
        CellIndex { x, y }
    }

    /// Whether a beam has crossed the point; `sought` takes in where that was looked up.
    fn is_crossed(&self, point: [f64; 2], sought: &mut Sought) -> bool {
        let (place, column, row) = self.cell_near(point).split();
        let cells = [[column, row]; 2];
        sought.tile(self, place, cells).is_some_and(|tile| tile.free[row] >> column & 1 == 1)
    }

    /// Whether a cell that is shown, and that is seen from this direction, lies within this distance of the point (m), in x and in y;
    /// `sought` takes in where that was looked up.
    fn has_original(
        &self,
        point: [f64; 2],
        seen_from: impl Fn() -> Angle,
        distance: f64,
        sought: &mut Sought,
    ) -> bool {
        self.is_any_shown(point, distance, sought, |evidence, column, row| {
            !self.settings.has(Idea::Originals) || evidence.is_seen(column, row, &seen_from)
        })
    }

    /// Whether a wall hides what is at a point, give or take this distance (m), from where the line of sight begins, which is where another
    /// meets a surface: no light goes that way, and what is seen there is no image of it. `sought` takes in where that was looked up.
    fn is_hidden(&self, point: [f64; 2], distance: f64, sight: &Sight, sought: &mut Sought) -> bool {
        let Sight { from, .. } = *sight;
        let [x, y] = [0, 1].map(|axis| point[axis] - from[axis]);
        let range = (x * x + y * y).sqrt();
        if range <= HIDDEN || !self.settings.has(Idea::Hidden) {
            return false;
        }
        // Lines of sight end before the cell that they lead to.
        let part = 1.0 - (HIDDEN - CLEAR_OF_CELL) / range;
        let end = |across: f64| {
            let aside = across * distance / range;
            [from[0] + x * part - y * aside, from[1] + y * part + x * aside]
        };
        for corner in [from, end(1.0), end(-1.0)] {
            let (place, column, row) = self.cell_near(corner).split();
            sought.looked.ways.extend(sought.of, place, [[column, row]; 2]);
        }
        ACROSS.into_iter().all(|across| {
            let to = end(across);
            let range = ((to[0] - from[0]).powi(2) + (to[1] - from[1]).powi(2)).sqrt();
            meets_wall(self, &Sight { to, range, ..*sight }, &mut sought.lookup)
        })
    }

    /// Whether what is shown goes on from the point in this direction, or in the opposite one. Such a wall is its own image in a mirror that
    /// it runs straight at, and may stand on both sides of glass as well: it tells neither.
    fn runs_along(&self, point: [f64; 2], [x, y]: [f64; 2], sought: &mut Sought) -> bool {
        self.settings.has(Idea::Symmetry)
            && [-RUNS_ON, RUNS_ON].into_iter().any(|way| {
                let beside = [point[0] + way * x, point[1] + way * y];
                self.is_any_shown(beside, self.resolution, sought, |_, _, _| true)
            })
    }

    /// Whether this holds of a cell that is shown within this distance of the point (m), in x and in y; it is given the cell's column and
    /// row. `sought` takes in where that was looked up.
    fn is_any_shown(
        &self,
        point: [f64; 2],
        distance: f64,
        sought: &mut Sought,
        holds: impl Fn(&Evidence, usize, usize) -> bool,
    ) -> bool {
        let low = self.cell_near(point.map(|at| at - distance));
        let high = self.cell_near(point.map(|at| at + distance));
        let ((first, left, bottom), (last, right, top)) = (low.split(), high.split());
        (first.y..=last.y).any(|y| {
            let rows =
                if y == first.y { bottom } else { 0 }..=if y == last.y { top } else { SIDE as usize - 1 };
            (first.x..=last.x).any(|x| {
                let from = if x == first.x { left } else { 0 };
                let to = if x == last.x { right } else { SIDE as usize - 1 };
                let columns = (u64::MAX << from) & (u64::MAX >> (SIDE as usize - 1 - to));
                let place = TileIndex { x, y };
                let cells = [[from, *rows.start()], [to, *rows.end()]];
                let tile = sought.tile(self, place, cells);
                tile.and_then(|tile| tile.evidence.as_ref()).is_some_and(|evidence| {
                    let shown = &evidence.shown[rows.clone()];
                    // Nearly always there is none.
                    let is_any = shown.iter().fold(0, |all, cells| all | cells) & columns != 0;
                    is_any
                        && rows.clone().zip(shown).any(|(row, cells)| {
                            cells_of(cells & columns).any(|column| holds(evidence, column, row))
                        })
                })
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{
        cell::Returns,
        track::{LANES, Sector, Track, distance_units},
        verdict::Verdict,
        visagge::VisaggeSettings,
    };

    /// A row of cells along x (m), all seen from `range` metres away over these bearings of the sensor (degrees).
    #[derive(Clone)]
    struct Row {
        x: [f64; 2],
        y: f64,
        bearings: [f64; 2],
        range: f32,
        /// Whether they were missed over 30 degrees, as glass is.
        is_missed: bool,
    }

    #[test]
    fn a_line_of_sight_ends_wherever_it_crosses_from_tile_to_tile() {
        let mut grid = Visagge::new(CELL, VisaggeSettings::default());
        for x in -24..24 {
            let number = grid.tiles.find_or_make(TileIndex { x, y: 0 });
            grid.tiles.at_mut(number).evidence.get_or_insert_default();
        }
        fn walls(evidence: &Evidence) -> Option<&CellsBySquare> {
            Some(&evidence.walls)
        }
        // Steps end on a border, give or take what rounding does.
        for tile in -20..20 {
            for (steps, way) in (0..400).flat_map(|steps| [(steps, 1.0), (steps, -1.0)]) {
                let border = f64::from(tile * SIDE) * CELL;
                let start = border - way * (CLEAR_OF_SENSOR + f64::from(steps) * CELL / 2.0);
                let sight = Sight {
                    from: [start, 1.0],
                    to: [start + way * 12.0, 1.0 + 1e-9],
                    range: 12.0,
                    has_glinted: false,
                    may_explain: false,
                    decides: false,
                };
                let looked = std::cell::Cell::new(0);
                let cells = |evidence| {
                    looked.set(looked.get() + 1);
                    assert!(looked.get() < 100, "from {start} m");
                    walls(evidence)
                };
                assert!(!follow(
                    &grid,
                    &sight,
                    &mut Lookups::of(TileIndex { x: 0, y: 0 }, Sources::default()).crossed,
                    cells,
                    |_, _, _, _| false
                ));
            }
        }
    }

    const CELL: f64 = 0.05;

    /// Puts the cells of a row in, or has them observed in another way.
    fn draw(grid: &mut Visagge, Row { x, y, bearings, range: seen, is_missed }: &Row) {
        let cells = (x[1] - x[0]) / CELL;
        for number in 0..cells.round() as i32 {
            let (place, column, row) =
                CellIndex::of(x[0] + (f64::from(number) + 0.5) * CELL, *y, CELL).split();
            let mut returns = Returns::new([column as u8, row as u8], *is_missed);
            (returns.occupancy, returns.hits) = (20, 20);
            let from = |degrees: f64| Angle::from_rad(degrees.to_radians());
            let width = units((bearings[1] - bearings[0]).to_radians()) as u16;
            let range = AngleRange { start: from(bearings[0]), width };
            let missed = AngleRange { start: from(bearings[1]), width: units(0.5) as u16 };
            let track = Track {
                visible: Sector { range, ends: [distance_units(*seen); 2] },
                missed_width: if *is_missed { missed.width } else { 0 },
                missed_since: if *is_missed { missed } else { AngleRange::default() },
                ..Track::default()
            };
            let tile = grid.tiles.find_or_make(place);
            let evidence = grid.tiles.at_mut(tile).evidence.get_or_insert_default();
            let place = place_of(returns.place);
            match evidence.slots.get(place) {
                Some(number) => {
                    let block = &mut evidence.cells.blocks[number / LANES];
                    block.set(number % LANES, Track { place, ..track });
                }
                None => evidence.fill([(returns, track)].into_iter()),
            }
            evidence.is_touched = true;
        }
    }

    /// What is judged of the cell at this point (m).
    fn verdict(grid: &mut Visagge, [x, y]: [f64; 2]) -> Verdict {
        grid.decide();
        let (place, column, row) = CellIndex::of(x, y, CELL).split();
        let evidence = grid.tiles.get(place).and_then(|tile| tile.evidence.as_ref());
        let evidence = evidence.expect("it was drawn");
        evidence.judgements[evidence.number(column, row).expect("it was drawn")].verdict
    }

    fn drawn(rows: &[Row]) -> Visagge {
        drawn_without(&[], rows)
    }

    fn drawn_without(without: &[Idea], rows: &[Row]) -> Visagge {
        let settings = VisaggeSettings { without: without.to_vec(), ..VisaggeSettings::default() };
        let mut grid = Visagge::new(CELL, settings);
        rows.iter().for_each(|row| draw(&mut grid, row));
        grid
    }

    /// What is judged of the cell at each of these points (m).
    fn verdicts<const N: usize>(rows: &[Row], points: [[f64; 2]; N]) -> [Verdict; N] {
        let mut grid = drawn(rows);
        points.map(|point| verdict(&mut grid, point))
    }

    /// A mirror, seen head on from y = 0, what stands before it, and the image of that.
    fn mirror() -> [Row; 3] {
        let seen = |y: f64, middle: f64, is_missed| Row {
            x: [0.0, 4.4],
            y,
            bearings: [middle - 1.0, middle + 1.0],
            range: y as f32,
            is_missed,
        };
        [seen(2.01, -90.0, true), seen(1.01, -90.0, false), seen(3.01, -85.0, true)]
    }

    #[test]
    fn what_a_mirror_shows_behind_it_is_an_image() {
        let points = [[1.01, 2.01], [1.01, 1.01], [1.01, 3.01]];
        assert_eq!(verdicts(&mirror(), points), [Verdict::Surface, Verdict::Solid, Verdict::Image]);
        let [mirror, _, image] = mirror();
        // Without anything that it could be the image of, and with no beam where that would stand: nothing is known.
        assert_eq!(verdicts(&[mirror, image], [points[0], points[2]]), [Verdict::Surface; 2]);
    }

    #[test]
    fn what_metal_shows_is_an_image_though_the_metal_is_seen_from_there_too() {
        let [mirror, original, image] = mirror();
        let metal = Row { bearings: [-130.0, -50.0], ..mirror };
        let seen = |rows: &[Row]| verdicts(rows, [[1.01, 2.01], [1.01, 3.01]]);
        assert_eq!(seen(&[metal.clone(), original, image.clone()]), [Verdict::Surface, Verdict::Image]);
        assert_eq!(seen(&[metal, image]), [Verdict::Surface; 2]);
    }

    #[test]
    fn a_wall_that_runs_straight_at_glass_does_not_make_it_a_mirror() {
        // Met so squarely, and seen from so far, that only a mirror would show it.
        let cells = (16..56).chain(66..106).map(|row| Row {
            x: [1.0, 1.05],
            y: f64::from(row) * CELL + CELL / 2.0,
            bearings: [-80.0, -75.0],
            range: 4.0,
            is_missed: false,
        });
        let pane = Row { x: [0.0, 4.4], y: 3.025, bearings: [-91.0, -89.0], range: 3.0, is_missed: true };
        let rows: Vec<Row> = cells.chain([pane]).collect();
        let seen = |without: &[Idea]| verdict(&mut drawn_without(without, &rows), [1.02, 4.52]);
        assert_eq!(seen(&[]), Verdict::Solid);
        assert_eq!(seen(&[Idea::Symmetry]), Verdict::Image);
    }

    #[test]
    fn what_is_seen_from_the_other_side_only_is_no_original() {
        // Far enough apart that none is where another would show the robot.
        let at = |y: f64, row: &Row| Row { y, range: y as f32, ..row.clone() };
        let [mirror, original, image] = mirror();
        let [mirror, image] = [at(3.01, &mirror), at(3.41, &image)];
        let seen_from = |bearings: [f64; 2]| {
            let original = Row { bearings, is_missed: true, ..at(2.61, &original) };
            let [image] = verdicts(&[mirror.clone(), original, image.clone()], [[1.01, 3.41]]);
            image
        };
        assert_eq!(seen_from([89.0, 91.0]), Verdict::Image, "from where the mirror is");
        assert_eq!(seen_from([-91.0, -89.0]), Verdict::Surface);
    }

    /// What a pane shows, what that is an image of, and the image: as near as glass reflects what is ahead.
    fn pane() -> [Row; 3] {
        let at = |y: f64, row: &Row| Row { y, range: y as f32, ..row.clone() };
        let [mirror, original, image] = mirror();
        [at(1.61, &mirror), at(0.91, &original), at(2.31, &image)]
    }

    /// How a cell of the image in the [`pane`] may be one, had it such returns.
    fn found(rows: &[Row], returns: impl Fn(&mut Returns)) -> Image {
        found_in(&mut drawn(rows), IMAGE, |cell| returns(&mut cell.returns))
    }

    /// A point of the image in the [`pane`] (m).
    const IMAGE: [f64; 2] = [1.01, 2.31];

    /// The same of the cell at this point (m) in this grid, were it such a cell.
    fn found_in(grid: &mut Visagge, [x, y]: [f64; 2], change: impl Fn(&mut Cell)) -> Image {
        grid.decide();
        let (place, column, row) = CellIndex::of(x, y, CELL).split();
        let evidence = grid.tiles.get(place).and_then(|tile| tile.evidence.as_ref()).expect("it was drawn");
        let number = evidence.number(column, row).expect("it was drawn");
        let mut cell = evidence.cells.get(number);
        change(&mut cell);
        let (mut sights, mut lookups) =
            (Sights::default(), Lookups::of(TileIndex { x: 0, y: 0 }, Sources::default()));
        image(grid, place, &cell, &mut sights, &mut lookups)
    }

    #[test]
    fn what_glints_behind_glass_is_no_image_in_it() {
        let rows = pane();
        let glinting = |rows: &[Row], glints: u8| found(rows, |returns| returns.glints = glints);
        assert_eq!(glinting(&rows, 0), Image::Yes);
        assert_eq!(glinting(&rows, 1), Image::Yes, "a random reading");
        assert!(matches!(glinting(&rows, 2), Image::IfOpaque(_)), "a mirror shows glints too");
        let without_original = [rows[0].clone(), rows[2].clone()];
        assert!(matches!(glinting(&without_original, 0), Image::Unknown(_)));
        assert_eq!(glinting(&without_original, 2), Image::No);
    }

    #[test]
    fn what_is_brighter_behind_glass_than_glass_reflects_is_no_image_in_it() {
        // 8 % there and 8 % back of what may be 4 times as bright as any wall: 5.3 octaves below one.
        let so_bright = |octaves: f32, glints: u8| {
            found(&pane(), |returns| {
                returns.record_brightness(octaves);
                returns.glints = glints;
            })
        };
        assert_eq!(so_bright(-6.0, 0), Image::Yes);
        assert!(matches!(so_bright(-4.5, 0), Image::Unknown(_)), "of a dark wall, but not in glass");
        assert_eq!(so_bright(-4.5, 1), Image::Yes, "of something that glints");
    }

    #[test]
    fn what_was_seen_in_some_scans_only_through_a_surface_is_not_shown() {
        let [mirror, _, behind] = mirror();
        let judged_if = |has_passed: bool, mirrors: &[&Row], hits: u16, scans_a_second: u32| {
            let mut grid = drawn(&[]);
            if has_passed {
                pass(&mut grid, [1.01, 1.01]);
            }
            (grid.scan, grid.elapsed_ns) = (60 * scans_a_second, 60_000_000_000);
            mirrors.iter().for_each(|mirror| draw(&mut grid, mirror));
            let behind = Row { is_missed: false, ..behind.clone() };
            draw(&mut grid, &behind);
            for number in 0..grid.tiles.len() {
                if let Some(evidence) = &mut grid.tiles.at_mut(number).evidence {
                    let cells = evidence.cells.returns.iter_mut();
                    cells.filter(|returns| returns.place[1] == 60).for_each(|returns| returns.hits = hits);
                }
            }
            verdict(&mut grid, [1.01, 3.01])
        };
        let judged =
            |mirrors: &[&Row], hits: u16, scans_a_second: u32| judged_if(true, mirrors, hits, scans_a_second);
        assert_eq!(judged(&[&mirror], 9, 40), Verdict::TooFew);
        assert_eq!(judged(&[&mirror], 10, 40), Verdict::Solid);
        assert_eq!(judged(&[&mirror], 9, 10), Verdict::Solid, "for as long as four times as many");
        assert_eq!(judged(&[], 9, 40), Verdict::Solid, "through nothing");
        assert_eq!(judged_if(false, &[&mirror], 9, 40), Verdict::Solid, "nobody where no beam has come");
    }

    /// Beams have crossed all cells of the tile that are as far along y as this point (m).
    fn pass(grid: &mut Visagge, [x, y]: [f64; 2]) {
        let (place, _, row) = CellIndex::of(x, y, CELL).split();
        let number = grid.tiles.find_or_make(place);
        grid.tiles.at_mut(number).free[row] = u64::MAX;
    }

    /// A pane, with the sensor between it and a wall: something behind the wall, something as far behind the pane, and the wall.
    fn hidden() -> [Row; 4] {
        let row =
            |y: f64, bearings| Row { x: [0.0, 4.4], y, bearings, range: y.abs() as f32, is_missed: false };
        let pane = Row { is_missed: true, ..row(2.01, [-91.0, -89.0]) };
        [pane, row(-1.49, [85.0, 95.0]), row(5.51, [-91.0, -89.0]), row(-0.39, [80.0, 100.0])]
    }

    #[test]
    fn what_a_wall_hides_from_glass_is_no_original_of_what_is_seen_behind_the_glass() {
        let [pane, original, behind, wall] = hidden();
        let seen = |wall: Row, without: &[Idea]| {
            let rows = [pane.clone(), original.clone(), behind.clone(), wall];
            let mut grid = drawn_without(without, &rows);
            (verdict(&mut grid, [2.01, 5.51]), found_in(&mut grid, [2.01, 5.51], |_| ()).number())
        };
        assert_eq!(seen(wall.clone(), &[]), (Verdict::Solid, 1));
        assert_eq!(seen(wall.clone(), &[Idea::Hidden]), (Verdict::Image, 3));
        assert_eq!(
            seen(Row { y: -0.59, ..wall.clone() }, &[]),
            (Verdict::Image, 3),
            "it may be the wall itself"
        );
        let past_its_end = seen(Row { x: [2.1, 4.4], ..wall.clone() }, &[]);
        assert_eq!(past_its_end, (Verdict::Solid, 3), "what else is seen there tells that it is glass");
        assert_eq!(seen(Row { is_missed: true, ..wall }, &[]), (Verdict::Image, 3), "seen through glass");
    }

    #[test]
    fn who_walks_by_in_a_mirror_does_not_tell_that_it_is_glass() {
        let [pane, _, image] = pane();
        let mut grid = drawn(&[pane, image]);
        // Where the original would stand beams have passed.
        pass(&mut grid, [1.01, 0.91]);
        let mut seen = |lasted: f32, missed_width: u16| {
            found_in(&mut grid, IMAGE, |cell| {
                cell.returns.hit_time = [5.0, 5.0 + lasted];
                cell.missed_width = missed_width;
            })
        };
        assert!(matches!(seen(0.4, 0), Image::PassedBy(_)));
        assert!(matches!(seen(0.4, 9), Image::Unexplained(_)));
        assert!(matches!(seen(1.2, 0), Image::Unexplained(_)));
    }

    #[test]
    fn an_original_tells_that_a_surface_is_opaque_only_right_where_it_is_sought() {
        let seen = |beside: f64, glints: u8, without: &[Idea]| {
            let [mirror, original, image] = mirror();
            let original = Row { y: original.y - beside, ..original };
            let mut grid = drawn_without(without, &[mirror, original, image]);
            found_in(&mut grid, [1.01, 3.01], |cell| cell.returns.glints = glints)
        };
        assert!(matches!(seen(0.0, 0, &[]), Image::IfOpaque(_)));
        assert!(matches!(seen(0.12, 0, &[]), Image::Unknown(_)), "another wall");
        assert!(matches!(seen(0.12, 0, &[Idea::Tells]), Image::IfOpaque(_)));
        assert!(matches!(seen(0.12, 2, &[]), Image::IfOpaque(_)), "a glint");
    }

    #[test]
    fn what_may_have_an_original_thereabouts_does_not_tell_that_a_surface_is_seen_through() {
        let seen = |beside: f64, without: &[Idea]| {
            let [pane, original, image] = pane();
            let y = pane.y + 8.0;
            let image = Row { y, range: y as f32, ..image };
            let other = Row { y: pane.y - 8.0 - beside, range: (8.0 - pane.y + beside) as f32, ..original };
            let mut grid = drawn_without(without, &[pane.clone(), image, other]);
            // Where the original would stand beams have passed.
            pass(&mut grid, [1.01, pane.y - 8.0]);
            found_in(&mut grid, [1.01, y], |cell| cell.returns.hit_time = [5.0, 7.0])
        };
        assert!(matches!(seen(0.5, &[]), Image::Unexplained(_)));
        assert!(matches!(seen(0.35, &[]), Image::Unknown(_)));
        assert!(matches!(seen(0.35, &[Idea::Tells]), Image::Unexplained(_)));
    }

    #[test]
    fn nothing_is_seen_through_a_wall() {
        let wall = |bearings, is_missed| Row { x: [0.0, 2.0], y: 1.01, bearings, range: 1.0, is_missed };
        let behind =
            |x| Row { x: [x, x + 0.2], y: 3.01, bearings: [-91.0, -89.0], range: 3.0, is_missed: false };
        let seen = |wall: Row, x| verdicts(&[wall, behind(x)], [[x + 0.06, 3.01]])[0];
        assert_eq!(seen(wall([-100.0, -80.0], false), 1.0), Verdict::Image);
        assert_eq!(seen(wall([-100.0, -80.0], false), 1.85), Verdict::Solid, "just past its end");
        assert_eq!(seen(wall([-92.0, -88.0], false), 1.0), Verdict::Solid, "it may be glass");
        assert_eq!(seen(wall([-100.0, -80.0], true), 1.0), Verdict::Solid, "a door that was open before");
    }

    #[test]
    fn what_another_tile_has_become_is_taken_into_account() {
        let wall = |bearings| Row { x: [0.0, 2.0], y: 1.01, bearings, range: 1.0, is_missed: false };
        let behind = Row { x: [1.0, 1.2], y: 3.61, bearings: [-91.0, -89.0], range: 3.6, is_missed: false };
        let mut grid = drawn(&[wall([-92.0, -88.0]), behind]);
        assert_eq!(verdict(&mut grid, [1.06, 3.61]), Verdict::Solid);
        draw(&mut grid, &wall([-100.0, -80.0]));
        assert_eq!(verdict(&mut grid, [1.06, 3.61]), Verdict::Image, "it is a wall now");

        let at = |y: f64, row: &Row| Row { y, range: y as f32, ..row.clone() };
        let [mirror, original, image] = mirror();
        let original = |bearings| Row { bearings, is_missed: true, ..at(3.01, &original) };
        let mut grid = drawn(&[at(3.61, &mirror), original([-91.0, -89.0]), at(4.21, &image)]);
        assert_eq!(verdict(&mut grid, [1.01, 4.21]), Verdict::Surface);
        draw(&mut grid, &original([89.0, 91.0]));
        assert_eq!(verdict(&mut grid, [1.01, 4.21]), Verdict::Image, "it is seen from the mirror now");

        let [pane, original, behind, wall] = hidden();
        let mut grid = drawn(&[pane, original, behind]);
        assert_eq!(verdict(&mut grid, [2.01, 5.51]), Verdict::Image);
        draw(&mut grid, &wall);
        assert_eq!(verdict(&mut grid, [2.01, 5.51]), Verdict::Solid, "no light comes from there now");
    }

    /// Asserts that what is known of images is what looking anew tells; gives of how many.
    fn look_anew(grid: &mut Visagge) -> usize {
        grid.decide();
        let tiles = grid.tiles.iter().filter_map(|(place, tile)| Some((place, tile.evidence.as_ref()?)));
        let cells = tiles.flat_map(|(place, evidence)| {
            evidence.cells.iter().zip(&evidence.judgements).map(move |cell| (place, cell))
        });
        let mut count = 0;
        for (tile, (cell, judgement)) in cells {
            if judgement.unthinned.is_shown() || judgement.unthinned == Verdict::Image {
                let mut lookups = Lookups::of(tile, Sources::default());
                let anew = image(grid, tile, &cell, &mut Sights::default(), &mut lookups);
                assert_eq!(judgement.image, anew, "{:?} of {tile:?}", cell.returns.place);
                count += 1;
            }
        }
        count
    }

    #[test]
    fn what_is_known_of_images_is_what_looking_anew_tells() {
        let [mirror, original, image] = mirror();
        let moved = |row: &Row, x: f64| Row { x: [row.x[0] + x, row.x[1] + x], ..row.clone() };
        let box_ = Row { x: [1.4, 1.6], y: 4.01, bearings: [-24.0, -23.0], range: 3.8, is_missed: false };
        for without in [&[][..], &[Idea::Opacity]] {
            let mut grid = drawn_without(without, &[mirror.clone(), image.clone()]);
            assert!(look_anew(&mut grid) >= 2 * 88, "a cell of either row at least once");
            // In other tiles, bit by bit: what images are of, what they are seen in, and what hides them.
            let rows = [
                original.clone(),
                box_.clone(),
                moved(&mirror, 4.4),
                moved(&image, 4.4),
                Row { bearings: [-130.0, -50.0], ..mirror.clone() },
                Row { x: [0.0, 2.0], y: 1.51, bearings: [-100.0, -80.0], range: 1.0, is_missed: false },
                Row { bearings: [89.0, 91.0], ..original.clone() },
            ];
            for row in rows {
                draw(&mut grid, &row);
                look_anew(&mut grid);
            }
        }
    }

    #[test]
    fn glass_reflects_a_little_ahead_and_nearly_all_at_grazing_incidence() {
        let percent = |degrees: f64| (100.0 * glass_reflects(degrees.to_radians())).round();
        // 4 % a face and once more inside: the paper's 8 %.
        assert_eq!([0.0, 45.0, 60.0, 80.0, 89.9].map(percent), [8.0, 17.0, 30.0, 70.0, 100.0]);
    }

    #[test]
    fn what_is_explained_makes_a_surface_opaque_and_what_cannot_be_known_says_nothing() {
        let [here, beside, above, far] = [(3, 4), (4, 4), (3, 5), (30, 4)].map(|(x, y)| Block { x, y });
        let votes = |explained: usize, unexplained: usize, unknown: usize| {
            let mut opacity = Opacity::default();
            (0..explained).for_each(|_| opacity.vote(Image::IfOpaque(here)));
            (0..unexplained).for_each(|_| opacity.vote(Image::Unexplained(beside)));
            (0..unknown).for_each(|_| opacity.vote(Image::Unknown(above)));
            opacity
        };
        let is_image = |votes: &Opacity, image: Image| {
            let mut all = AllOpacity::default();
            all.add(votes);
            image.is_image(&all.opaque(votes))
        };
        let mirror = votes(80, 20, 300);
        assert!(is_image(&mirror, Image::IfOpaque(here)) && is_image(&mirror, Image::Unknown(above)));
        assert!(is_image(&mirror, Image::Unexplained(here)), "somebody who has moved on");
        assert!(!is_image(&mirror, Image::IfOpaque(far)), "another surface");
        assert!(!is_image(&mirror, Image::No), "seen past it");
        let pane = votes(50, 50, 0);
        assert!(!is_image(&pane, Image::IfOpaque(here)) && is_image(&pane, Image::Yes));
    }
}
