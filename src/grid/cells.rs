//! The cells with evidence of a tile, by number: what is kept of each, laid out for scans to go through.

use super::{
    cell::{Cell, Returns},
    track::{Block, LANES, Track},
    verdict::is_wall,
    view::HIT,
};

/// See the module.
#[derive(Clone, Debug, Default)]
pub struct Cells {
    /// One for each cell.
    pub(super) returns: Vec<Returns>,
    /// Their view angles, in the same order: all of them that most scans touch.
    pub(super) blocks: Vec<Block>,
}

impl Cells {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.returns.len()
    }

    /// Adds one; its number is how many there were.
    pub fn push(&mut self, returns: Returns, track: Track) {
        let number = self.len();
        push(&mut self.returns, returns);
        if number.is_multiple_of(LANES) {
            push(&mut self.blocks, Block::default());
        }
        self.blocks[number / LANES].set(number % LANES, track);
    }

    /// Takes one out; the last one takes over its number.
    pub fn swap_remove(&mut self, number: usize) {
        self.returns.swap_remove(number);
        let last = self.len();
        let track = self.track(last);
        self.blocks[number / LANES].set(number % LANES, track);
        self.blocks[last / LANES].set(last % LANES, Track::default());
        self.blocks.truncate(last.div_ceil(LANES));
    }

    /// Marks a cell as hit.
    #[inline(always)]
    pub fn hit(&mut self, number: usize) -> &mut Returns {
        self.blocks[number / LANES].place[number % LANES] |= HIT;
        &mut self.returns[number]
    }

    /// Whether a cell is a wall's ([`is_wall`]).
    pub fn is_wall(&self, number: usize) -> bool {
        is_wall(&self.returns[number], self.blocks[number / LANES].widths(number % LANES))
    }

    /// The view angles of a cell.
    #[inline(always)]
    pub fn track(&self, number: usize) -> Track {
        self.blocks[number / LANES].get(number % LANES)
    }

    /// A cell. As a part of who asks, what is not needed is not put together.
    #[inline(always)]
    pub fn get(&self, number: usize) -> Cell {
        Cell::of(&self.returns[number], &self.track(number))
    }

    /// All cells.
    pub fn iter(&self) -> impl Iterator<Item = Cell> {
        self.kept().map(|(returns, track)| Cell::of(returns, &track))
    }

    /// What is kept of them.
    pub fn kept(&self) -> impl Iterator<Item = (&Returns, Track)> {
        self.returns.iter().enumerate().map(|(number, returns)| (returns, self.track(number)))
    }

    /// Memory beside itself (bytes).
    pub fn bytes(&self) -> usize {
        self.returns.capacity() * size_of::<Returns>() + self.blocks.capacity() * size_of::<Block>()
    }
}

/// Makes room by a sixteenth: twice as much would be half empty.
pub fn push<T>(to: &mut Vec<T>, value: T) {
    if to.len() == to.capacity() {
        to.reserve_exact((to.len() / 16).max(1));
    }
    to.push(value);
}
