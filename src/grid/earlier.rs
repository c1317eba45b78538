//! The scans of the last second, for what comes into view: whether it could have been seen there just before.
//!
//! A beam without return crosses nothing for the map, since what is dark or stands askew returns nothing either. But where a cell is
//! seen for the first time now, and half a second ago beams went by without return from nearly the same place, something has probably
//! come: somebody walks down a corridor that is longer than the scanner sees.

use super::view::{Lens, Tolerance, View};
use std::collections::VecDeque;

/// Time between two scans that are kept (s): whoever walks has gone by his own width.
const EVERY: f32 = 0.5;
/// How long they are kept (s): a sensor at 1 m/s sees what is 6 m away from 10 degrees elsewhere by then.
const LONGEST: f32 = 1.05;
/// How old they must be (s): by then, whoever walks at 1 m/s has come from more than a cell and all errors away.
const LEAST: f32 = 0.15;

/// See the module.
#[derive(Debug, Default)]
pub struct Earlier {
    scans: VecDeque<Past>,
}

#[derive(Debug, Default)]
struct Past {
    time: f32,
    /// Where the sensor was in the middle of the scan (m).
    middle: [f64; 2],
    lens: Lens,
    /// As they came (m): what returned nothing is beyond all that is measured.
    ranges: Vec<f32>,
}

impl Earlier {
    /// Takes a scan at this time (s), if it is time for one. `follows`: none was lost before it.
    pub fn keep(&mut self, view: &View, ranges: &[f32], time: f32, follows: bool) {
        if !follows {
            self.scans.clear();
        }
        if self.scans.back().is_some_and(|last| time - last.time < EVERY) {
            return;
        }
        let is_old = self.scans.front().is_some_and(|past| time - past.time > LONGEST);
        let mut past = if is_old { self.scans.pop_front() } else { None }.unwrap_or_default();
        (past.time, past.middle, past.lens) = (time, view.middle(), view.lens);
        past.ranges.clear();
        past.ranges.extend_from_slice(ranges);
        self.scans.push_back(past);
    }

    /// Whether all beams of one of these scans that may cross a cell in this place (m) went past it, be it without return.
    pub fn went_past(&self, place: [f64; 2], time: f32, tolerance: &Tolerance) -> bool {
        self.scans
            .iter()
            .any(|past| (LEAST..=LONGEST).contains(&(time - past.time)) && past.goes_past(place, tolerance))
    }
}

impl Past {
    fn goes_past(&self, [x, y]: [f64; 2], tolerance: &Tolerance) -> bool {
        let [dx, dy] = [x - self.middle[0], y - self.middle[1]].map(|way| way as f32);
        let sight = self.lens.sight(dx, dy);
        let (range, beam) = (dx.hypot(dy), usize::from(sight.beam));
        let angle = (tolerance.resolution / 2.0 + tolerance.across) as f32 / range + tolerance.heading as f32;
        let half = (angle * self.lens.beams_per_rad.abs()).min(self.lens.last).ceil() as usize;
        let beams = beam.saturating_sub(half)..(beam + half + 1).min(self.ranges.len());
        let free = range + tolerance.along as f32;
        sight.is_in_view && self.ranges[beams].iter().all(|&range| range > free)
    }
}

#[cfg(test)]
mod tests {
    use crate::{
        grid::{
            sweep::{Sweep, tests::half_circle},
            visagge::{Visagge, VisaggeSettings},
        },
        pose::pose,
    };

    /// Where a beam straight ahead returns, scan by scan of 0.1 s, in a room that is longer than the scanner sees; `.`: nowhere.
    /// Whether the cell of its last return was passed before.
    fn was_passed(ahead: &str) -> bool {
        let mut grid = Visagge::new(0.05, VisaggeSettings::default());
        for (number, beam) in (0..).zip(ahead.bytes()) {
            let mut ranges = vec![65.0; 181];
            if beam != b'.' {
                ranges[85..96].fill(f32::from(beam - b'0') + 0.02);
            }
            let mut scan = half_circle(number, ranges);
            scan.stamp_ns = number as i64 * 100_000_000;
            let at = pose(0.0, 0.0, 0.0);
            grid.insert(&Sweep { scan: &scan, start: at, end: at });
        }
        let last = f32::from(*ahead.as_bytes().last().unwrap() - b'0');
        let (.., cell) = grid
            .cells()
            .map(|(index, cell, _)| ((index.x as f32 * 0.05 - last).abs() + index.y.abs() as f32, cell))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .unwrap();
        assert!(!cell.returns.was_crossed);
        cell.returns.was_passed
    }

    #[test]
    fn who_comes_into_a_beam_without_return_was_not_there_before() {
        assert!(was_passed("..........7"));
        assert!(was_passed("333.......7"));
        assert!(!was_passed("7"), "nothing is known of before");
        assert!(!was_passed("33333333337"), "it was hidden");
        assert!(!was_passed(".7"), "a moment ago only");
        assert!(!was_passed("....33333333333333337"), "long ago");
    }
}
