//! Insertion in the widest instructions that the processor has.
//!
//! The same code, compiled twice: for every processor, and for x86-64 with AVX2, where the loops over cells and beams take
//! eight numbers at a time and rounding needs no calls. Neither fuses a multiplication with an addition, so both
//! give the same map, bit by bit. This is the only file with `unsafe`; what it gains is measured by
//! `cargo bench --bench insert`.
#![allow(unsafe_code)]

use super::{sweep::Sweep, visagge::Visagge};

/// Inserts one scan.
pub(super) fn insert(grid: &mut Visagge, sweep: &Sweep) {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2")
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
    grid.insert_here(sweep);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi2,lzcnt")]
fn insert_with_avx2(grid: &mut Visagge, sweep: &Sweep) {
    grid.insert_here(sweep);
}
