//! What may go wrong between a device and its host, with a seed.

use crate::noise::Random;

/// Probabilities of faults; all 0 by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Faults {
    /// Seed of the faults.
    pub seed: u64,
    /// A character of a reply is wrong.
    pub bad_sum: f64,
    /// Garbage comes before a reply.
    pub garbage: f64,
    /// A reply ends before its end.
    pub cut: f64,
    /// A scan is replaced by an error status: `0M`, or `21` followed a second later by `98`.
    pub error_status: f64,
    /// A request is not answered.
    pub silence: f64,
    /// The connection drops before a scan.
    pub disconnect: f64,
    /// A scan is not sent.
    pub skip_scan: f64,
    /// A full ME frame takes 47 ms and comes in bursts, as from the firmware of 2009.
    pub slow_firmware: bool,
}

/// What befalls a scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScanFault {
    /// Not sent.
    Skipped,
    /// The connection drops.
    Disconnect,
    /// `0M` in its place.
    Unstable,
    /// The device stops to verify an error.
    Stopped,
}

/// Draws faults in the order of replies.
#[derive(Clone, Debug)]
pub struct Mischief {
    faults: Faults,
    random: Random,
}

impl Mischief {
    /// At the start.
    pub fn new(faults: Faults) -> Mischief {
        Mischief { faults, random: Random::new(&[faults.seed, 0xfa17]) }
    }

    /// Whether the firmware is the slow one.
    pub fn is_slow(&self) -> bool {
        self.faults.slow_firmware
    }

    /// Whether a request goes unanswered.
    pub fn is_silent(&mut self) -> bool {
        self.random.chance(self.faults.silence)
    }

    /// What befalls the next scan.
    pub fn on_scan(&mut self) -> Option<ScanFault> {
        if self.random.chance(self.faults.skip_scan) {
            Some(ScanFault::Skipped)
        } else if self.random.chance(self.faults.disconnect) {
            Some(ScanFault::Disconnect)
        } else if self.random.chance(self.faults.error_status) {
            Some(if self.random.chance(0.5) { ScanFault::Unstable } else { ScanFault::Stopped })
        } else {
            None
        }
    }

    /// Spoils the bytes of a reply.
    pub fn spoil(&mut self, mut bytes: Vec<u8>) -> Vec<u8> {
        if self.random.chance(self.faults.bad_sum) {
            let at = self.random.below(bytes.len());
            // Another character of the alphabet; a line end is left alone, or two lines would become one.
            if bytes[at] != b'\n' {
                bytes[at] = if bytes[at] == b'0' { b'1' } else { b'0' };
            }
        }
        if self.random.chance(self.faults.cut) {
            bytes.truncate(self.random.below(bytes.len()));
        }
        if self.random.chance(self.faults.garbage) {
            let count = 1 + self.random.below(40);
            let noise: Vec<u8> = (0..count).map(|_| self.random.below(256) as u8).collect();
            bytes.splice(0..0, noise);
        }
        bytes
    }
}
