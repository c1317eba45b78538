//! The device's clock: from 24-bit stamps to one that never runs backwards, and from that to the host's.
//! Integers only, so that a replay gives the same bits.
//!
//! The offset is first read in TM rounds: the device took its stamp between request and reply, so every
//! round bounds the offset from both sides, and slow rounds say little. While scans stream the clock cannot
//! be asked, but (receive - stamp) is the offset plus a latency with a firm lower bound. The lower envelope
//! of it moves with the device's drift only; its distance from the offset is fixed by the TM rounds.

use std::collections::VecDeque;

/// Values of the device's clock: 24 bits of ms.
const WRAP_MS: i64 = 1 << 24;
const MS: i64 = 1_000_000;
const SECOND: i64 = 1_000_000_000;
/// 139 years: where the unwrapped clock stops, so that no input, however strange, overflows a sum.
const MAX_UNWRAPPED_MS: i64 = 1 << 42;

/// A host that was held up may see stamps arrive this much later or earlier than they were taken (ms);
/// more than that is a reset, not a wrap.
const HELD_UP_MS: i64 = 30_000;

/// What a stamp says against the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Advance {
    /// There was none before.
    First,
    /// The same stamp again.
    Same,
    /// Later, by this many ms.
    Forward(i64),
    /// The clock began anew.
    Reset { before_ms: u32 },
}

#[derive(Clone, Copy, Debug)]
struct Seen {
    raw_ms: u32,
    unwrapped_ms: i64,
    host_ns: Option<i64>,
}

/// Unwraps stamps. Across a reset the clock goes on by what the host's clock says, or by 1 ms.
#[derive(Debug, Default)]
pub(crate) struct Unwrapper {
    last: Option<Seen>,
    reset_announced: bool,
}

impl Unwrapper {
    /// The device acknowledged a command that sets its clock to zero.
    pub fn announce_reset(&mut self) {
        self.reset_announced = self.last.is_some();
    }

    /// The unwrapped value of a stamp, and what it says.
    pub fn advance(&mut self, raw_ms: u32, host_ns: Option<i64>) -> (i64, Advance) {
        let Some(last) = self.last else {
            self.last = Some(Seen { raw_ms, unwrapped_ms: raw_ms.into(), host_ns });
            return (raw_ms.into(), Advance::First);
        };
        let elapsed_ms = host_ns.zip(last.host_ns).map(|(now, then)| (now - then) / MS);
        let advance = if std::mem::take(&mut self.reset_announced) {
            Advance::Reset { before_ms: last.raw_ms }
        } else {
            classify(last.raw_ms, raw_ms, elapsed_ms)
        };
        let step_ms = match advance {
            Advance::Forward(step) => step,
            Advance::Reset { .. } => elapsed_ms.unwrap_or(1).max(1),
            Advance::Same | Advance::First => 0,
        };
        let unwrapped_ms = (last.unwrapped_ms + step_ms).min(MAX_UNWRAPPED_MS);
        self.last = Some(Seen { raw_ms, unwrapped_ms, host_ns });
        (unwrapped_ms, advance)
    }
}

fn classify(last: u32, raw: u32, elapsed_ms: Option<i64>) -> Advance {
    let step = (i64::from(raw) - i64::from(last)).rem_euclid(WRAP_MS);
    if step == 0 {
        return Advance::Same;
    }
    let turned_over = raw < last;
    let Some(elapsed) = elapsed_ms else {
        let is_reset = turned_over && step > HELD_UP_MS;
        return if is_reset { Advance::Reset { before_ms: last } } else { Advance::Forward(step) };
    };
    // After a long silence the clock may have wrapped more than once.
    let wraps = ((elapsed - step + WRAP_MS / 2).div_euclid(WRAP_MS)).max(0);
    let total = step + wraps * WRAP_MS;
    let tolerance = HELD_UP_MS + elapsed / 100;
    let too_early = total > elapsed + tolerance;
    let too_late = total < elapsed - tolerance;
    if too_early || (turned_over && too_late) {
        Advance::Reset { before_ms: last }
    } else {
        Advance::Forward(total)
    }
}

/// One TM1 exchange.
#[derive(Clone, Copy, Debug)]
struct Round {
    device_ns: i64,
    sent_ns: i64,
    received_ns: i64,
}

impl Round {
    fn trip_ns(&self) -> i64 {
        self.received_ns - self.sent_ns
    }
}

/// Offset at one moment of the device's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Point {
    device_ns: i64,
    /// Host's time minus the device's (ns).
    offset_ns: i64,
}

/// What TM rounds say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Tie {
    pub rounds: u32,
    pub fastest_ns: i64,
    pub offset_ns: i64,
    pub uncertainty_ns: i64,
}

/// Estimate of host's time minus the device's.
#[derive(Debug)]
pub(crate) struct OffsetEstimate {
    rounds: Vec<Round>,
    tie: Option<Point>,
    /// Least (receive - stamp) of each second, oldest first; the last one is still growing.
    envelope: VecDeque<Point>,
    /// The first points of the envelope after the tie.
    first: Vec<Point>,
    /// Distance of the envelope from the offset: how long after its stamp a scan begins to arrive (ns).
    latency_ns: Option<i64>,
    /// Drift of the host's clock against the device's (parts in 10^9), once it could be measured.
    drift_ppb: Option<i64>,
    /// Drift as it was measured before the last restart: a property of the two crystals.
    drift_before_ppb: i64,
}

impl OffsetEstimate {
    /// More rounds than this say nothing new.
    const MAX_ROUNDS: usize = 64;
    /// Width of one point of the envelope.
    const POINT_NS: i64 = SECOND;
    /// Two minutes: long enough to tell 10 ppm through a jitter of 1 ms, short enough for warming up.
    const MAX_POINTS: usize = 120;
    /// Points of the envelope that its distance from the offset is taken from: before there are so many, the
    /// tie alone is as good.
    const FIRST_POINTS: usize = 5;
    /// Stretch of the envelope at which its slope is half believed: one jitters by about 0.3 ms a point, the
    /// other is within 100 ppm from the beginning.
    const HALF_BELIEVED_NS: i64 = 12 * SECOND;
    /// Crystals stay within 100 ppm; what looks like more is jitter.
    const MAX_DRIFT_PPB: i64 = 300_000;
    /// How far back the envelope reaches: a sixth of what the drift was taken from, within these.
    const REACH_NS: [i64; 2] = [3 * SECOND, 20 * SECOND];

    pub fn new() -> OffsetEstimate {
        OffsetEstimate {
            rounds: Vec::new(),
            tie: None,
            envelope: VecDeque::new(),
            first: Vec::new(),
            latency_ns: None,
            drift_ppb: None,
            drift_before_ppb: 0,
        }
    }

    /// The device's clock began anew: what is known of the offset is void; latency and drift remain.
    pub fn restart(&mut self) {
        self.drift_before_ppb = self.drift_ppb.unwrap_or(0);
        self.rounds.clear();
        self.tie = None;
        self.first.clear();
        self.envelope.clear();
    }

    /// New rounds begin; until they give a result the old one counts.
    pub fn begin_rounds(&mut self) {
        self.rounds.clear();
    }

    /// One TM1 exchange.
    pub fn on_round(&mut self, device_ms: i64, sent_ns: i64, received_ns: i64) {
        if received_ns >= sent_ns && self.rounds.len() < Self::MAX_ROUNDS {
            self.rounds.push(Round { device_ns: device_ms * MS, sent_ns, received_ns });
        }
    }

    /// The rounds are over: ties the clocks.
    pub fn finish_rounds(&mut self) -> Option<Tie> {
        let fastest_ns = self.rounds.iter().map(Round::trip_ns).min()?;
        let fast = || self.rounds.iter().filter(|round| round.trip_ns() <= 2 * fastest_ns + MS);
        // The stamp is the time cut to ms, so the offset lies in (sent - stamp - 1 ms, received - stamp].
        let most = fast().map(|round| round.received_ns - round.device_ns).min()?;
        let least = fast().map(|round| round.sent_ns - round.device_ns - MS).max()?;
        let width_ns = most.saturating_sub(least);
        let offset_ns = least + width_ns / 2;
        let device_ns = fast().map(|round| round.device_ns).max()?;
        self.tie = Some(Point { device_ns, offset_ns });
        self.first.clear();
        self.envelope.clear();
        let rounds = fast().count() as u32;
        Some(Tie { rounds, fastest_ns, offset_ns, uncertainty_ns: width_ns.saturating_abs() / 2 })
    }

    /// A scan of this stamp began to arrive.
    pub fn on_scan(&mut self, device_ms: i64, first_byte_ns: i64) {
        let device_ns = device_ms * MS;
        let seen = Point { device_ns, offset_ns: first_byte_ns - device_ns };
        let slot = |point: &Point| point.device_ns.div_euclid(Self::POINT_NS);
        match self.envelope.back_mut() {
            Some(last) if slot(last) == slot(&seen) => {
                if seen.offset_ns < last.offset_ns {
                    *last = seen;
                }
            }
            _ => {
                self.finish_point();
                self.envelope.push_back(seen);
                if self.envelope.len() > Self::MAX_POINTS {
                    self.envelope.pop_front();
                }
            }
        }
    }

    /// A point of the envelope is complete: takes drift and latency anew.
    fn finish_point(&mut self) {
        self.drift_ppb = self.measure_drift().or(self.drift_ppb);
        let Some(tie) = self.tie else { return };
        if self.first.len() < Self::FIRST_POINTS {
            self.first.extend(self.envelope.back());
        }
        if self.first.len() == Self::FIRST_POINTS {
            let above = |point: &Point| {
                let drift_ns = self.drift_over(point.device_ns - tie.device_ns);
                point.offset_ns.saturating_sub(tie.offset_ns).saturating_sub(drift_ns)
            };
            self.latency_ns = self.first.iter().map(above).min();
        }
    }

    fn drift_over(&self, device_ns: i64) -> i64 {
        (i128::from(self.drift_ppb.unwrap_or(0)) * i128::from(device_ns) / i128::from(SECOND)) as i64
    }

    /// Slope of the line below all points that is nearest to them: the edge of their lower hull over their
    /// middle (Moon, Skelly and Towsley, INFOCOM 1999).
    fn measure_drift(&self) -> Option<i64> {
        let (first, last) = (self.envelope.front()?, self.envelope.back()?);
        let cross = |a: &Point, b: &Point, c: &Point| {
            let run = |to: &Point| i128::from(to.device_ns) - i128::from(a.device_ns);
            let rise = |to: &Point| i128::from(to.offset_ns) - i128::from(a.offset_ns);
            run(b) * rise(c) - run(c) * rise(b)
        };
        let mut hull: Vec<Point> = Vec::new();
        for point in &self.envelope {
            while hull.len() >= 2 && cross(&hull[hull.len() - 2], &hull[hull.len() - 1], point) <= 0 {
                hull.pop();
            }
            hull.push(*point);
        }
        let middle = first.device_ns + (last.device_ns - first.device_ns) / 2;
        let edge = hull.windows(2).find(|edge| edge[1].device_ns >= middle)?;
        let run = edge[1].device_ns - edge[0].device_ns;
        let rise = i128::from(edge[1].offset_ns) - i128::from(edge[0].offset_ns);
        let slope = rise * i128::from(SECOND) / i128::from(run.max(1));
        let square = |ns: i64| i128::from(ns / MS) * i128::from(ns / MS);
        let (known, unknown) = (square(last.device_ns - first.device_ns), square(Self::HALF_BELIEVED_NS));
        let before = i128::from(self.drift_before_ppb);
        let ppb = before + (slope - before) * known / (known + unknown);
        Some(ppb.clamp(-i128::from(Self::MAX_DRIFT_PPB), i128::from(Self::MAX_DRIFT_PPB)) as i64)
    }

    /// Least (receive - stamp) near a moment, each point carried there by the drift.
    fn envelope_at(&self, device_ns: i64) -> Option<i64> {
        let [least, most] = Self::REACH_NS;
        let begun = self.envelope.front()?.device_ns;
        let reach = ((device_ns - begun) / 6).clamp(least, most);
        let near = self.envelope.iter().rev().take_while(|point| device_ns - point.device_ns <= reach);
        near.map(|point| point.offset_ns.saturating_add(self.drift_over(device_ns - point.device_ns))).min()
    }

    /// Host's time at a value of the device's unwrapped clock. `nominal_latency_ns` serves where the
    /// latency was never measured.
    pub fn host_ns(&self, device_ms: i64, nominal_latency_ns: i64) -> Option<i64> {
        let device_ns = device_ms * MS;
        let by_tie = |tie: Point| tie.offset_ns.saturating_add(self.drift_over(device_ns - tie.device_ns));
        let by_envelope =
            |envelope: i64| envelope.saturating_sub(self.latency_ns.unwrap_or(nominal_latency_ns));
        let offset_ns = match self.tie {
            Some(tie) if self.first.len() < Self::FIRST_POINTS => by_tie(tie),
            _ => by_envelope(self.envelope_at(device_ns)?),
        };
        Some(device_ns.saturating_add(offset_ns))
    }

    /// Whether rounds have tied the clocks.
    pub fn is_tied(&self) -> bool {
        self.tie.is_some()
    }

    /// Drift of the host's clock against the device's (parts in 10^9).
    pub fn drift_ppb(&self) -> Option<i64> {
        self.drift_ppb
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrap_goes_on_and_a_reset_is_seen() {
        let mut clock = Unwrapper::default();
        let wrap = WRAP_MS as u32;
        assert_eq!(clock.advance(wrap - 10, Some(0)), (WRAP_MS - 10, Advance::First));
        assert_eq!(clock.advance(15, Some(25 * MS)), (WRAP_MS + 15, Advance::Forward(25)));
        assert_eq!(clock.advance(15, Some(50 * MS)), (WRAP_MS + 15, Advance::Same));
        assert_eq!(clock.advance(1_000_000, Some(1_000_000 * MS)).1, Advance::Forward(999_985));
        let reset = clock.advance(40, Some(1_002_000 * MS));
        assert_eq!(reset, (WRAP_MS + 1_002_000, Advance::Reset { before_ms: 1_000_000 }));
    }

    #[test]
    fn several_wraps_in_one_silence() {
        let mut clock = Unwrapper::default();
        clock.advance(100, Some(0));
        let elapsed = 2 * WRAP_MS + 500;
        assert_eq!(clock.advance(600, Some(elapsed * MS)), (100 + elapsed, Advance::Forward(elapsed)));
    }

    #[test]
    fn a_host_that_was_held_up_sees_no_reset() {
        let mut clock = Unwrapper::default();
        clock.advance(1000, Some(0));
        assert_eq!(clock.advance(1025, Some(15_000 * MS)).1, Advance::Forward(25));
        assert_eq!(clock.advance(16_000, Some(15_001 * MS)).1, Advance::Forward(14_975));
    }

    #[test]
    fn without_times_only_short_steps_wrap() {
        let mut clock = Unwrapper::default();
        clock.advance(WRAP_MS as u32 - 5, None);
        assert_eq!(clock.advance(20, None), (WRAP_MS + 20, Advance::Forward(25)));
        clock.advance(500_000, None);
        assert_eq!(clock.advance(10, None).1, Advance::Reset { before_ms: 500_000 });
    }

    #[test]
    fn an_announced_reset_needs_no_guess() {
        let mut clock = Unwrapper::default();
        clock.advance(5, Some(0));
        clock.announce_reset();
        assert_eq!(clock.advance(30, Some(25 * MS)), (30, Advance::Reset { before_ms: 5 }));
    }

    /// A device with an exact oscillator of its own, seen through a jittering link.
    struct Link {
        seed: u64,
        drift_ppm: f64,
        offset_ns: f64,
    }

    impl Link {
        /// Uniform in 0..1 (xorshift64*, so that the test needs no other source).
        fn uniform(&mut self) -> f64 {
            self.seed ^= self.seed >> 12;
            self.seed ^= self.seed << 25;
            self.seed ^= self.seed >> 27;
            (self.seed.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 11) as f64 / (1u64 << 53) as f64
        }

        /// Host's time of a device's time (ns).
        fn host(&self, device_ns: f64) -> f64 {
            self.offset_ns + device_ns * (1.0 + self.drift_ppm * 1e-6)
        }
    }

    /// Scans of 25.07 ms, received 23.5 ms after their stamp and up to 2 ms late, every tenth up to 40 ms late.
    /// The cases are fixed, so that what passes once passes always.
    #[test]
    fn drift_and_jitter_stay_within_a_millisecond() {
        for case in 0..100u32 {
            let drift_ppm = f64::from(case) * 2.0 - 99.0;
            let mut link = Link { seed: u64::from(case) * 7919 + 1, drift_ppm, offset_ns: 7.3e12 };
            let mut estimate = OffsetEstimate::new();
            let mut device_ns = 5.0e9;
            estimate.begin_rounds();
            for _ in 0..12 {
                let sent = link.host(device_ns) - 0.2e6 - 0.6e6 * link.uniform();
                let received = link.host(device_ns) + 0.2e6 + 0.6e6 * link.uniform();
                estimate.on_round((device_ns / 1e6) as i64, sent as i64, received as i64);
                device_ns += 1.5e6 + 1e6 * link.uniform();
            }
            assert!(estimate.finish_rounds().unwrap().uncertainty_ns < MS);
            device_ns += 0.5e9;
            for _ in 0..40 * 200 {
                device_ns += 25.07e6;
                let late = if link.uniform() < 0.1 { 40e6 } else { 2e6 } * link.uniform();
                let stamp_ms = (device_ns / 1e6) as i64;
                estimate.on_scan(stamp_ms, (link.host(device_ns) + 23.5e6 + late) as i64);
                let error = estimate.host_ns(stamp_ms, 0).unwrap() as f64 - link.host(stamp_ms as f64 * 1e6);
                assert!(error.abs() < 1e6, "case {case}: {} ms wrong at {} s", error / 1e6, device_ns / 1e9);
            }
            let measured = estimate.drift_ppb().unwrap() as f64 / 1e3;
            assert!((measured - drift_ppm).abs() < 15.0, "case {case}: {measured} ppm for {drift_ppm}");
        }
    }

    #[test]
    fn slow_rounds_are_left_out() {
        let mut estimate = OffsetEstimate::new();
        estimate.on_round(1000, 5_000 * MS, 5_001 * MS);
        estimate.on_round(1010, 5_010 * MS, 5_011 * MS);
        estimate.on_round(1020, 5_020 * MS, 5_090 * MS);
        let tie = estimate.finish_rounds().unwrap();
        assert_eq!((tie.rounds, tie.fastest_ns), (2, MS));
        assert_eq!((tie.offset_ns, tie.uncertainty_ns), (4_000 * MS, MS));
    }

    #[test]
    fn without_rounds_the_nominal_latency_serves() {
        let mut estimate = OffsetEstimate::new();
        assert_eq!(estimate.host_ns(0, 0), None);
        estimate.on_scan(1000, 9_023_500_000);
        assert_eq!(estimate.host_ns(1000, 23_500_000), Some(9_000_000_000));
    }
}
