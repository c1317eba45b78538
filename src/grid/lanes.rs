//! How a block of cells is compared with a scan: in the widest instructions that the processor has.
//!
//! [`Portable`] is the specification, a cell at a time. [`Avx2`], for x86-64, takes sixteen, and gives the same, bit by bit:
//! nothing fuses a multiplication with an addition, and both round alike. Which one it is decides also what the rest of an
//! insertion is compiled for. This is the only file with `unsafe`; what it gains is measured by `cargo bench --bench insert`.
#![allow(unsafe_code)]

use super::{
    angle::Angle,
    cell::Returns,
    sweep::Sweep,
    track::{Block, Event, LANES, Look},
    view::{Around, Crossing, HIT, Observation, Sight},
    visagge::{Glance, Vantage, Visagge},
};

/// Compares cells with a scan and records what it says of them.
pub(super) trait Path {
    /// Works out what crosses a cell near each beam; everything around has as many beams.
    fn cross(around: &Around, crossings: &mut [Crossing]);
    /// How the sensor sees the cells of a block, and how far the nearest of them is, or some other place in the tile.
    fn sights(vantage: &Vantage, block: &Block, sights: &mut Sights) -> u16;
    /// Records what the scan says of the cells of a block, of which these are the returns, and gives whether one of them has gone.
    fn record(glance: &Glance, block: &mut Block, sights: &Sights, returns: &mut [Returns]) -> bool;
}

/// [`super::view::Sight`]s of the cells of a block. They are taken of all blocks of a tile before any is recorded: each takes long,
/// but none waits for another.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(32))]
pub(super) struct Sights {
    range: [u16; LANES],
    beam: [u16; LANES],
    angle: [u16; LANES],
    /// All ones or 0.
    is_in_view: [u16; LANES],
}

/// Inserts one scan.
pub(super) fn insert(grid: &mut Visagge, sweep: &Sweep) {
    // Beams are numbered in 15 bits there.
    #[cfg(target_arch = "x86_64")]
    if sweep.len() <= i16::MAX as usize
        && is_x86_feature_detected!("avx2")
        && is_x86_feature_detected!("bmi2")
        && is_x86_feature_detected!("lzcnt")
    {
        // SAFETY: the features that the function is compiled for were found just now.
        return unsafe { insert_with_avx2(grid, sweep) };
    }
    insert_anywhere(grid, sweep);
}

/// For every processor.
pub(super) fn insert_anywhere(grid: &mut Visagge, sweep: &Sweep) {
    grid.insert_here::<Portable>(sweep);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi2,lzcnt")]
fn insert_with_avx2(grid: &mut Visagge, sweep: &Sweep) {
    grid.insert_here::<avx2::Avx2>(sweep);
}

/// A cell at a time.
pub(super) struct Portable;

impl Path for Portable {
    #[inline(always)]
    fn cross(around: &Around, crossings: &mut [Crossing]) {
        cross_from(0, around, crossings);
    }

    #[inline(always)]
    fn sights(vantage: &Vantage, block: &Block, sights: &mut Sights) -> u16 {
        for lane in 0..LANES {
            let at = |axis: usize| {
                let along = block.place[lane] >> (6 * axis) & 63;
                vantage.corner[axis] + f32::from(along) * vantage.resolution
            };
            let Sight { range, beam, angle, is_in_view } = vantage.lens.sight(at(0), at(1));
            sights.range[lane] = range;
            sights.beam[lane] = beam;
            sights.angle[lane] = angle.0;
            sights.is_in_view[lane] = if is_in_view { u16::MAX } else { 0 };
        }
        sights.range.into_iter().fold(u16::MAX, u16::min)
    }

    #[inline(always)]
    fn record(glance: &Glance, block: &mut Block, sights: &Sights, returns: &mut [Returns]) -> bool {
        let mut has_gone = false;
        for (lane, returns) in returns.iter_mut().enumerate() {
            has_gone |= record_lane(glance, block, sights, lane, returns);
        }
        has_gone
    }
}

/// From a beam on.
#[inline(always)]
fn cross_from(first: usize, around: &Around, crossings: &mut [Crossing]) {
    let (around, crossings) = (around.between(first, crossings.len()), &mut crossings[first..]);
    for (beam, crossing) in crossings.iter_mut().enumerate() {
        around.cross(beam, crossing);
    }
}

/// Records what the scan says of the cell in a lane, and gives whether it has gone.
#[inline(always)]
fn record_lane(
    glance: &Glance,
    block: &mut Block,
    sights: &Sights,
    lane: usize,
    returns: &mut Returns,
) -> bool {
    let sight = Sight {
        range: sights.range[lane],
        beam: sights.beam[lane],
        angle: Angle(sights.angle[lane]),
        is_in_view: sights.is_in_view[lane] != 0,
    };
    let observation = if block.place[lane] & HIT != 0 {
        Observation::Seen
    } else {
        glance.view.observe(&sight, || block.would_return(lane, sight.range))
    };
    // Nearly always nothing has gone on here before either.
    if observation == Observation::Hidden && block.run[lane] == 0 && block.missed_scans[lane] == 0 {
        return false;
    }
    let mut track = block.get(lane);
    if !glance.follows {
        track.end_run();
    }
    let look = Look { angle: sight.angle, range: sight.range, way: glance.way };
    let event = track.record(observation, &look, glance.scans, glance.rule, returns);
    block.set(lane, track);
    if event == Event::None {
        return false;
    }
    returns.record(event, glance.scans, glance.rule);
    returns.occupancy == 0
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::{Path, Sights, cross_from, record_lane};
    use crate::grid::{
        angle::{ATAN, ROUNDER},
        cell::Returns,
        track::{Block, LANES, Run, Sectors, TENTH, UNITS_PER_M},
        view::{Around, Crossing, FARTHEST, HIT, INVERSE, LEAST_DISTANCE},
        visagge::{Glance, Vantage},
    };
    use std::{arch::x86_64::*, f32::consts};

    /// Sixteen cells at a time. Only [`super::insert_with_avx2`] may name it.
    pub(in super::super) struct Avx2;

    impl Path for Avx2 {
        #[inline(always)]
        fn cross(around: &Around, crossings: &mut [Crossing]) {
            // SAFETY: `insert_with_avx2` alone comes here, and it was called because the features are there.
            unsafe { cross(around, crossings) }
        }

        #[inline(always)]
        fn sights(vantage: &Vantage, block: &Block, sights: &mut Sights) -> u16 {
            // SAFETY: as above.
            unsafe { take_sights(vantage, block, sights) }
        }

        #[inline(always)]
        fn record(glance: &Glance, block: &mut Block, sights: &Sights, returns: &mut [Returns]) -> bool {
            let mut has_gone = false;
            // SAFETY: as above.
            let mut closely = unsafe { record_block(glance, block, sights, returns.len()) };
            while closely != 0 {
                // Two bits a lane.
                let lane = closely.trailing_zeros() as usize / 2;
                closely &= !(0b11 << (2 * lane));
                has_gone |= record_lane(glance, block, sights, lane, &mut returns[lane]);
            }
            has_gone
        }
    }

    /// Sixteen numbers of 16 bits.
    type Words = __m256i;

    /// [`Around::cross`] of sixteen beams at a time. What the compiler makes of the four numbers side by side takes three times as many shuffles.
    #[target_feature(enable = "avx2,bmi2,lzcnt")]
    #[inline]
    fn cross(around: &Around, crossings: &mut [Crossing]) {
        let count = crossings.len();
        let (sixteens, _) = crossings.as_chunks_mut::<LANES>();
        let done = LANES * sixteens.len();
        for (number, crossings) in sixteens.iter_mut().enumerate() {
            let of = |beams: &[i16]| load_signed(&beams[..count][LANES * number..]);
            let least = |windows: [&[i16]; 2]| _mm256_min_epi16(of(windows[0]), of(windows[1]));
            let own = of(around.own);
            let is_none = _mm256_cmpeq_epi16(own, _mm256_setzero_si256());
            let returned = _mm256_blendv_epi8(own, words(FARTHEST as u16), is_none);
            let (low, clear, empty) = (least(around.low), least(around.clear), least(around.empty));
            let high = _mm256_max_epi16(of(around.high[0]), of(around.high[1]));
            // Where fewer are known to be free, the sign bit, which is `SILENT`.
            let is_silent = _mm256_slli_epi16::<15>(_mm256_cmpgt_epi16(empty, clear));
            let empty = _mm256_or_si256(empty, is_silent);
            // Side by side, in each half of a register: beams 0..4 and 8..12, then 4..8 and 12..16.
            let pairs = [(returned, low), (high, empty)]
                .map(|(a, b)| [_mm256_unpacklo_epi16(a, b), _mm256_unpackhi_epi16(a, b)]);
            let quads = [0, 1].map(|n| {
                let (a, b) = (pairs[0][n], pairs[1][n]);
                (_mm256_unpacklo_epi32(a, b), _mm256_unpackhi_epi32(a, b))
            });
            let [first, second] = quads.map(|(a, b)| {
                [_mm256_permute2x128_si256::<0x20>(a, b), _mm256_permute2x128_si256::<0x31>(a, b)]
            });
            let in_order = [first[0], second[0], first[1], second[1]];
            for (crossings, quad) in crossings.as_chunks_mut::<4>().0.iter_mut().zip(in_order) {
                // SAFETY: four crossings are 32 bytes in which anything may stand, and any alignment will do.
                unsafe { _mm256_storeu_si256(crossings.as_mut_ptr().cast(), quad) };
            }
        }
        cross_from(done, around, crossings);
    }

    #[target_feature(enable = "avx2,bmi2,lzcnt")]
    #[inline]
    fn take_sights(vantage: &Vantage, block: &Block, sights: &mut Sights) -> u16 {
        let zero = _mm256_setzero_si256();
        let place = load(&block.place);
        let column = _mm256_and_si256(place, words(63));
        let row = _mm256_and_si256(_mm256_srli_epi16(place, 6), words(63));
        let low = |words| _mm256_unpacklo_epi16(words, zero);
        let high = |words| _mm256_unpackhi_epi16(words, zero);
        let (first, second) =
            (sight(vantage, low(column), low(row)), sight(vantage, high(column), high(row)));
        let range = _mm256_max_epi16(_mm256_packs_epi32(first.range, second.range), words(1));
        store(&mut sights.range, range);
        store(&mut sights.beam, _mm256_packus_epi32(first.beam, second.beam));
        store(&mut sights.angle, _mm256_packus_epi32(first.angle, second.angle));
        store(&mut sights.is_in_view, _mm256_packs_epi32(first.is_in_view, second.is_in_view));
        let halves = _mm_min_epu16(_mm256_castsi256_si128(range), _mm256_extracti128_si256::<1>(range));
        _mm_extract_epi16::<0>(_mm_minpos_epu16(halves)) as u16
    }

    /// Records what the scan says of a block, but for the lanes of which it returns two bits each: these
    /// are left as they were.
    #[target_feature(enable = "avx2,bmi2,lzcnt")]
    #[inline]
    fn record_block(glance: &Glance, block: &mut Block, sights: &Sights, count: usize) -> u32 {
        let (view, rule) = (glance.view, glance.rule);
        let zero = _mm256_setzero_si256();
        let place = load(&block.place);
        let (range, beam) = (load(&sights.range), load(&sights.beam));
        let (angle, in_view) = (load(&sights.angle), load(&sights.is_in_view));
        let hit = _mm256_srai_epi16(place, 15);

        // The entry of each cell.
        let mut band = zero;
        for &nearer in &view.nearer {
            let is_nearer = _mm256_cmpgt_epi16(words(nearer as u16), range);
            if is_none(is_nearer) {
                break;
            }
            band = _mm256_sub_epi16(band, is_nearer);
        }
        let stride = _mm256_set1_epi32(1 | (view.count as i32) << 16);
        let entries = [
            _mm256_madd_epi16(_mm256_unpacklo_epi16(beam, band), stride),
            _mm256_madd_epi16(_mm256_unpackhi_epi16(beam, band), stride),
        ];
        let mut numbers = [[0u32; LANES / 2]; 2];
        for (numbers, entries) in numbers.iter_mut().zip(entries) {
            // SAFETY: 32 bytes are there, and any alignment will do.
            unsafe { _mm256_storeu_si256(numbers.as_mut_ptr().cast(), entries) };
        }
        let crossings = view.crossings.as_ptr().cast::<i64>();
        // SAFETY: a beam is less than `count`, which `insert` has limited to 15 bits; a band is less than `BANDS`, since the last
        // of `nearer` is 0; `crossings` has an entry, of eight bytes, aligned to them, for each beam in each band.
        let entry = |half: usize, n: usize| unsafe { crossings.add(numbers[half][n] as usize).read() };
        // Unpacking has split the cells: 0..4 and 8..12, then 4..8 and 12..16.
        let pairs = |half: usize, n: usize| {
            _mm256_set_epi64x(entry(half, n + 5), entry(half, n + 4), entry(half, n + 1), entry(half, n))
        };
        let [returned, low, high, empty] = turned([pairs(0, 0), pairs(0, 2), pairs(1, 0), pairs(1, 2)]);

        // What the scan says of each cell.
        let along = words(view.along as u16);
        let of_cell = |distance| {
            let off = _mm256_abs_epi16(_mm256_sub_epi16(distance, range));
            _mm256_cmpgt_epi16(off, along)
        };
        let none_of_cell = _mm256_and_si256(_mm256_and_si256(of_cell(returned), of_cell(low)), of_cell(high));
        let valid = load(&VALID[LANES - count..]);
        // Of what is hit, something is seen also where rounding puts it out of the field of view.
        let in_view = _mm256_and_si256(valid, _mm256_or_si256(in_view, hit));
        let seen = _mm256_and_si256(in_view, _mm256_or_si256(hit, not(none_of_cell)));
        let unseen = _mm256_andnot_si256(seen, in_view);
        let least = _mm256_min_epu16(load(&block.visible.ends[0]), load(&block.visible.ends[1]));
        let farthest = _mm256_adds_epu16(least, _mm256_mulhi_epu16(least, words(TENTH as u16)));
        let would_return = _mm256_cmpeq_epi16(_mm256_min_epu16(range, farthest), range);
        let is_silent = _mm256_srai_epi16(empty, 15);
        let is_past =
            _mm256_cmpgt_epi16(_mm256_and_si256(empty, words(0x7fff)), _mm256_adds_epi16(range, along));
        let past = _mm256_and_si256(unseen, is_past);
        let missed = _mm256_andnot_si256(is_silent, past);
        let silent = _mm256_and_si256(_mm256_and_si256(past, is_silent), would_return);
        let passed = _mm256_or_si256(missed, silent);
        let hidden = _mm256_cmpgt_epi16(range, low);
        let unsure = _mm256_andnot_si256(_mm256_or_si256(hidden, passed), unseen);

        // What goes on.
        let follows = words(if glance.follows { u16::MAX } else { 0 });
        let run = _mm256_and_si256(load(&block.run), follows);
        let missed_scans = _mm256_and_si256(load(&block.missed_scans), follows);
        let looked = _mm256_or_si256(_mm256_or_si256(seen, passed), unsure);
        if is_none(looked) {
            // Nearly always nothing has gone on here before either.
            if !is_none(_mm256_or_si256(load(&block.run), load(&block.missed_scans))) {
                store(&mut block.run, zero);
                store(&mut block.missed_scans, zero);
            }
            return 0;
        }
        let was_seen = _mm256_cmpeq_epi16(run, words(Run::Seen as u16));
        let was_missed = _mm256_cmpeq_epi16(run, words(Run::Missed as u16));
        let goes_on = _mm256_or_si256(_mm256_and_si256(seen, was_seen), _mm256_and_si256(passed, was_missed));
        let sector = extended(&block.sector, goes_on, angle, range);
        let half_beam = rule.half_beam as u16;
        let visible = Wide::load(&block.visible);
        let too = Wide::load(&block.visible_too);
        let meets = sector.meets(&visible, half_beam);
        let meets_too = sector.meets(&too, half_beam);
        let has_too = not(_mm256_cmpeq_epi16(too.ends[0], zero));

        // Seen: the run may be wider than what was known.
        let one_range = words(if rule.two_ranges { 0 } else { u16::MAX });
        let is_visible = _mm256_or_si256(meets, one_range);
        let becomes_visible =
            _mm256_and_si256(_mm256_and_si256(seen, is_visible), at_least(sector.width, visible.width));
        let apart = _mm256_andnot_si256(is_visible, seen);
        let becomes_too =
            _mm256_and_si256(apart, _mm256_or_si256(not(has_too), at_least(sector.width, too.width)));
        // Missed: often enough, and nowhere near where it was seen.
        let missed_scans_now = _mm256_adds_epu16(missed_scans, words(glance.scans));
        let often = _mm256_or_si256(
            missed,
            _mm256_and_si256(silent, at_least(missed_scans_now, words(rule.silent_scans))),
        );
        let survived = often;

        // What is rare is left to the scalar path: seen again after misses, a second range that becomes the first, and misses
        // that may contradict.
        let again = _mm256_and_si256(seen, was_missed);
        let swapped = _mm256_andnot_si256(at_least(visible.width, sector.width), becomes_too);
        let met = _mm256_or_si256(meets, _mm256_and_si256(meets_too, has_too));
        let doubtful = _mm256_and_si256(often, met);
        let closely = _mm256_or_si256(_mm256_or_si256(again, swapped), doubtful);
        let plainly = not(closely);
        let keep = |mask| _mm256_and_si256(mask, plainly);

        let gone_on = keep(_mm256_or_si256(seen, passed));
        sector.store(&mut block.sector, gone_on);
        sector.store(&mut block.visible, keep(becomes_visible));
        set_way(&mut block.way, glance.way, keep(becomes_visible));
        if !is_none(becomes_too) {
            sector.store(&mut block.visible_too, keep(becomes_too));
            set_way(&mut block.way_too, glance.way, keep(becomes_too));
        }
        let width = _mm256_max_epu16(sector.width, words(1));
        let survived = keep(survived);
        let missed_width = load(&block.missed_width);
        store(&mut block.missed_width, _mm256_max_epu16(missed_width, _mm256_and_si256(width, survived)));
        let since_width = load(&block.since_width);
        let is_widest = _mm256_andnot_si256(at_least(since_width, width), survived);
        blend(&mut block.since_start, sector.start, is_widest);
        let since_width = _mm256_blendv_epi8(since_width, width, is_widest);
        store(&mut block.since_width, _mm256_andnot_si256(keep(seen), since_width));

        // Of what is unsure, a run of observation is left, and the number of misses; of what is hidden nothing.
        let run_now = _mm256_or_si256(
            _mm256_and_si256(seen, words(Run::Seen as u16)),
            _mm256_or_si256(
                _mm256_and_si256(passed, words(Run::Missed as u16)),
                _mm256_and_si256(_mm256_and_si256(unsure, was_seen), words(Run::Seen as u16)),
            ),
        );
        let missed_scans_now = _mm256_or_si256(
            _mm256_and_si256(passed, missed_scans_now),
            _mm256_and_si256(unsure, missed_scans),
        );
        // Lanes that are left to the scalar path have followed, or what they were does not matter.
        store(&mut block.run, _mm256_blendv_epi8(run_now, run, closely));
        store(&mut block.missed_scans, _mm256_blendv_epi8(missed_scans_now, missed_scans, closely));
        let unmarked = _mm256_and_si256(plainly, words(HIT));
        store(&mut block.place, _mm256_andnot_si256(unmarked, place));
        _mm256_movemask_epi8(closely) as u32
    }

    /// Lanes from `LANES - count` on: the first `count` are all ones.
    static VALID: [u16; 2 * LANES] = {
        let mut valid = [0; 2 * LANES];
        let mut lane = 0;
        while lane < LANES {
            valid[lane] = u16::MAX;
            lane += 1;
        }
        valid
    };

    /// [`Sectors`] in registers.
    struct Wide {
        start: Words,
        width: Words,
        ends: [Words; 2],
    }

    impl Wide {
        #[target_feature(enable = "avx2")]
        #[inline]
        fn load(from: &Sectors) -> Wide {
            Wide {
                start: load(&from.start),
                width: load(&from.width),
                ends: [load(&from.ends[0]), load(&from.ends[1])],
            }
        }

        /// Puts the lanes of `mask` in.
        #[target_feature(enable = "avx2")]
        #[inline]
        fn store(&self, to: &mut Sectors, mask: Words) {
            blend(&mut to.start, self.start, mask);
            blend(&mut to.width, self.width, mask);
            blend(&mut to.ends[0], self.ends[0], mask);
            blend(&mut to.ends[1], self.ends[1], mask);
        }

        /// `AngleRange::meets`.
        #[target_feature(enable = "avx2")]
        #[inline]
        fn meets(&self, other: &Wide, margin: u16) -> Words {
            let half = |wide: &Wide| _mm256_srli_epi16(wide.width, 1);
            let (a, b) = (half(self), half(other));
            let reach = _mm256_adds_epu16(_mm256_adds_epu16(a, b), words(2 * margin));
            let middles = _mm256_sub_epi16(_mm256_add_epi16(self.start, a), _mm256_add_epi16(other.start, b));
            let distance = _mm256_min_epu16(middles, _mm256_sub_epi16(_mm256_setzero_si256(), middles));
            not(at_least(distance, reach))
        }
    }

    /// `Sector::extend` in the lanes of `goes_on`, `Sector::at` in the others.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn extended(from: &Sectors, goes_on: Words, angle: Words, range: Words) -> Wide {
        let from = Wide::load(from);
        let beyond = _mm256_sub_epi16(angle, from.start);
        let inside = at_least(from.width, beyond);
        let after = _mm256_sub_epi16(beyond, from.width);
        let before = _mm256_sub_epi16(_mm256_setzero_si256(), beyond);
        let is_before = not(at_least(before, after));
        let width =
            _mm256_adds_epu16(from.width, _mm256_andnot_si256(inside, _mm256_min_epu16(before, after)));
        let moves_start = _mm256_andnot_si256(inside, is_before);
        // What was full has no end that moves.
        let moves_end = _mm256_andnot_si256(
            _mm256_or_si256(moves_start, _mm256_cmpeq_epi16(width, from.width)),
            words(u16::MAX),
        );
        let fresh = not(goes_on);
        let replace = |old, new, mask| _mm256_blendv_epi8(old, new, _mm256_or_si256(mask, fresh));
        Wide {
            start: replace(from.start, angle, moves_start),
            width: _mm256_and_si256(width, goes_on),
            ends: [replace(from.ends[0], range, moves_start), replace(from.ends[1], range, moves_end)],
        }
    }

    /// What eight cells look like.
    struct Seen {
        range: __m256i,
        beam: __m256i,
        angle: __m256i,
        is_in_view: __m256i,
    }

    /// `Lens::sight` of eight cells.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn sight(vantage: &Vantage, column: __m256i, row: __m256i) -> Seen {
        let lens = &vantage.lens;
        let at = |corner: f32, along| {
            _mm256_add_ps(
                _mm256_set1_ps(corner),
                _mm256_mul_ps(_mm256_cvtepi32_ps(along), _mm256_set1_ps(vantage.resolution)),
            )
        };
        let (dx, dy) = (at(vantage.corner[0], column), at(vantage.corner[1], row));
        let sign = _mm256_set1_ps(-0.0);
        let (across, along) = (_mm256_andnot_ps(sign, dy), _mm256_andnot_ps(sign, dx));
        let steep = _mm256_cmp_ps::<_CMP_GT_OQ>(across, along);
        let (less, more) = (_mm256_min_ps(across, along), _mm256_max_ps(across, along));
        let one = _mm256_set1_ps(1.0);
        let inverse = _mm256_div_ps(one, _mm256_max_ps(more, _mm256_set1_ps(LEAST_DISTANCE)));
        let ratio = _mm256_mul_ps(less, inverse);
        let square = _mm256_mul_ps(ratio, ratio);
        let middle_range = _mm256_mul_ps(more, _mm256_sqrt_ps(_mm256_add_ps(one, square)));
        let bearing = in_circle(atan(ratio, square), steep, dy, dx);
        let beam = _mm256_mul_ps(
            _mm256_sub_ps(bearing, _mm256_set1_ps(lens.first_bearing)),
            _mm256_set1_ps(lens.beams_per_rad),
        );
        let turns =
            _mm256_mul_ps(_mm256_sub_ps(beam, _mm256_set1_ps(lens.cut)), _mm256_set1_ps(lens.per_turn));
        let turns = nearest(_mm256_sub_ps(turns, _mm256_set1_ps(0.5)));
        let beam = _mm256_sub_ps(beam, _mm256_mul_ps(turns, _mm256_set1_ps(lens.turn)));
        let last = _mm256_set1_ps(lens.last);
        let clamped = _mm256_min_ps(_mm256_max_ps(beam, _mm256_setzero_ps()), last);
        let moved = _mm256_sub_ps(clamped, _mm256_set1_ps(lens.last * 0.5));
        let ox = _mm256_mul_ps(_mm256_set1_ps(lens.shift[0]), moved);
        let oy = _mm256_mul_ps(_mm256_set1_ps(lens.shift[1]), moved);
        let across = _mm256_sub_ps(_mm256_mul_ps(dy, ox), _mm256_mul_ps(dx, oy));
        let term = |n: usize| _mm256_set1_ps(INVERSE[n]);
        let inverse_sum = _mm256_add_ps(term(1), _mm256_mul_ps(square, term(2)));
        let inverse_sum = _mm256_add_ps(term(0), _mm256_mul_ps(square, inverse_sum));
        let inverse_square = _mm256_mul_ps(_mm256_mul_ps(inverse, inverse), inverse_sum);
        let turned = _mm256_mul_ps(across, inverse_square);
        let along = _mm256_add_ps(_mm256_mul_ps(dx, ox), _mm256_mul_ps(dy, oy));
        let nearer = _mm256_mul_ps(_mm256_mul_ps(along, inverse_square), middle_range);
        let range = _mm256_sub_ps(middle_range, nearer);
        let beam = _mm256_add_ps(beam, _mm256_mul_ps(turned, _mm256_set1_ps(lens.beams_per_rad)));
        let limit = _mm256_set1_epi32(lens.last as i32);
        let bearing = _mm256_add_ps(_mm256_add_ps(bearing, turned), _mm256_set1_ps(consts::PI));
        let units = _mm256_mul_ps(bearing, _mm256_set1_ps(65_536.0 / consts::TAU));
        Seen {
            range: whole(_mm256_mul_ps(range, _mm256_set1_ps(UNITS_PER_M))),
            beam: _mm256_min_epi32(_mm256_max_epi32(whole(beam), _mm256_setzero_si256()), limit),
            angle: _mm256_and_si256(whole(units), _mm256_set1_epi32(0xffff)),
            is_in_view: _mm256_castps_si256(_mm256_and_ps(
                _mm256_cmp_ps::<_CMP_GT_OQ>(beam, _mm256_set1_ps(-0.5)),
                _mm256_cmp_ps::<_CMP_LT_OQ>(beam, _mm256_set1_ps(lens.last + 0.5)),
            )),
        }
    }

    /// `angle::atan` of eight.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn atan(ratio: __m256, square: __m256) -> __m256 {
        let pair = |n: usize| {
            _mm256_add_ps(_mm256_set1_ps(ATAN[n]), _mm256_mul_ps(_mm256_set1_ps(ATAN[n + 1]), square))
        };
        let fourth = _mm256_mul_ps(square, square);
        let sum = _mm256_add_ps(pair(2), _mm256_mul_ps(fourth, pair(4)));
        _mm256_mul_ps(_mm256_add_ps(pair(0), _mm256_mul_ps(fourth, sum)), ratio)
    }

    /// `angle::in_circle` of eight.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn in_circle(octant: __m256, steep: __m256, y: __m256, x: __m256) -> __m256 {
        let turned = |from: f32, angle| _mm256_sub_ps(_mm256_set1_ps(from), angle);
        let quadrant = _mm256_blendv_ps(octant, turned(consts::FRAC_PI_2, octant), steep);
        let half = _mm256_blendv_ps(quadrant, turned(consts::PI, quadrant), x);
        _mm256_xor_ps(half, _mm256_and_ps(y, _mm256_set1_ps(-0.0)))
    }

    /// `angle::nearest` of eight.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn nearest(number: __m256) -> __m256 {
        let rounder = _mm256_set1_ps(ROUNDER);
        _mm256_sub_ps(_mm256_add_ps(number, rounder), rounder)
    }

    /// `angle::whole` of eight.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn whole(number: __m256) -> __m256i {
        let rounder = _mm256_set1_ps(ROUNDER);
        _mm256_sub_epi32(_mm256_castps_si256(_mm256_add_ps(number, rounder)), _mm256_castps_si256(rounder))
    }

    /// From four numbers of each of sixteen cells, two cells to a half of a register, sixteen of each of the four.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn turned(pairs: [__m256i; 4]) -> [Words; 4] {
        let quads = [[pairs[0], pairs[1]], [pairs[2], pairs[3]]].map(|[a, b]| {
            let (even, odd) = (_mm256_unpacklo_epi16(a, b), _mm256_unpackhi_epi16(a, b));
            [_mm256_unpacklo_epi16(even, odd), _mm256_unpackhi_epi16(even, odd)]
        });
        let [[a, c], [b, d]] = quads;
        [
            _mm256_unpacklo_epi64(a, b),
            _mm256_unpackhi_epi64(a, b),
            _mm256_unpacklo_epi64(c, d),
            _mm256_unpackhi_epi64(c, d),
        ]
    }

    #[target_feature(enable = "avx2")]
    #[inline]
    fn words(number: u16) -> Words {
        _mm256_set1_epi16(number as i16)
    }

    #[target_feature(enable = "avx2")]
    #[inline]
    fn not(mask: Words) -> Words {
        _mm256_xor_si256(mask, words(u16::MAX))
    }

    /// Whether `a >= b`, without sign.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn at_least(a: Words, b: Words) -> Words {
        _mm256_cmpeq_epi16(_mm256_max_epu16(a, b), a)
    }

    #[target_feature(enable = "avx2")]
    #[inline]
    fn is_none(mask: Words) -> bool {
        _mm256_testz_si256(mask, mask) == 1
    }

    /// The first sixteen of these.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn load(from: &[u16]) -> Words {
        let from: &[u16; LANES] = from.first_chunk().expect("sixteen at least");
        // SAFETY: 32 bytes are there, and any alignment will do.
        unsafe { _mm256_loadu_si256(from.as_ptr().cast()) }
    }

    /// The same with sign.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn load_signed(from: &[i16]) -> Words {
        let from: &[i16; LANES] = from.first_chunk().expect("sixteen at least");
        // SAFETY: 32 bytes are there, and any alignment will do.
        unsafe { _mm256_loadu_si256(from.as_ptr().cast()) }
    }

    #[target_feature(enable = "avx2")]
    #[inline]
    fn store(to: &mut [u16; LANES], words: Words) {
        // SAFETY: 32 bytes are there, and any alignment will do.
        unsafe { _mm256_storeu_si256(to.as_mut_ptr().cast(), words) }
    }

    /// Puts the lanes of `mask` in.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn blend(to: &mut [u16; LANES], new: Words, mask: Words) {
        let old = load(to);
        store(to, _mm256_blendv_epi8(old, new, mask));
    }

    /// Sets the lanes of `mask`.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn set_way(to: &mut [f32; LANES], way: f32, mask: Words) {
        let halves = [_mm256_castsi256_si128(mask), _mm256_extracti128_si256::<1>(mask)];
        for (to, mask) in to.as_chunks_mut::<8>().0.iter_mut().zip(halves) {
            // SAFETY: eight numbers are there.
            unsafe { _mm256_maskstore_ps(to.as_mut_ptr(), _mm256_cvtepi16_epi32(mask), _mm256_set1_ps(way)) };
        }
    }
}
