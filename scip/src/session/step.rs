//! The start-up, request by request: what is asked in which order, and what each answer leads to.

use crate::request::{Command, Request};
use crate::status::Status;

/// One request of the start-up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Step {
    /// QT: whatever the device was left doing ends.
    Quiet,
    /// TM2, since QT was refused: the device was left in the time mode.
    LeaveForgottenTime,
    /// SCIP2.0: an old URG-04LX begins in SCIP 1.1.
    SwitchFromScip1,
    /// RS: all settings to their defaults, clock to zero.
    Reset,
    /// VV.
    Version,
    /// PP.
    Parameters,
    /// II.
    State,
    /// TM0.
    EnterTime,
    /// TM1, so many times more.
    ReadTime {
        /// Rounds still to be sent, this one included.
        rounds: u32,
        /// Rounds that may still go unanswered.
        spare: u32,
    },
    /// TM2.
    LeaveTime,
    /// BM.
    LaserOn,
    /// MD or ME.
    Stream(Request),
    /// RB, to be sent twice within a second.
    Reboot {
        /// Whether this is the second.
        again: bool,
    },
}

/// What an answer, or its absence, leads to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Next {
    /// The step is done.
    Done,
    /// The step did not work but the start-up can go on without it.
    Skip,
    /// Send the request again after a pause.
    Again,
    /// Do this step instead.
    Detour(Step),
    /// The connection cannot be used.
    Fail,
}

impl Step {
    pub fn request(self) -> Request {
        let command = match self {
            Step::Quiet => Command::Quit,
            Step::LeaveForgottenTime | Step::LeaveTime => Command::TimeLeave,
            Step::SwitchFromScip1 => Command::Scip2,
            Step::Reset => Command::Reset,
            Step::Version => Command::Version,
            Step::Parameters => Command::Parameters,
            Step::State => Command::State,
            Step::EnterTime => Command::TimeEnter,
            Step::ReadTime { .. } => Command::TimeRead,
            Step::LaserOn => Command::LaserOn,
            Step::Reboot { .. } => Command::Reboot,
            Step::Stream(request) => return request,
        };
        command.into()
    }

    /// Whether the device may be in the time mode while this step is under way.
    pub fn in_time_mode(self) -> bool {
        matches!(self, Step::EnterTime | Step::ReadTime { .. } | Step::LeaveTime | Step::LeaveForgottenTime)
    }

    /// What an answer leads to.
    pub fn after(self, status: Status) -> Next {
        use Status::{Abnormal, Denied, Done, General, Refused, Scip1, Unstable};
        match (self, status) {
            (Step::SwitchFromScip1, _) => Next::Done,
            (_, Scip1(_)) => Next::Detour(Step::SwitchFromScip1),
            (Step::Reboot { again: false }, Refused(1)) => Next::Detour(Step::Reboot { again: true }),
            (Step::Reboot { .. }, _) => Next::Done,
            (_, Abnormal) => Next::Detour(Step::Reboot { again: false }),
            (_, Done) => Next::Done,
            (_, Unstable) => Next::Again,
            // Off already.
            (Step::Quiet, Refused(_)) => Next::Done,
            (Step::Quiet, General(_) | Denied) => Next::Detour(Step::LeaveForgottenTime),
            // 03: was not in the time mode; anything else shows in the next answer to QT.
            (Step::LeaveForgottenTime, _) => Next::Done,
            // Not every model knows RS, VV and II in every state; nothing that follows depends on them.
            (Step::Reset, General(b'D'..=b'F')) => Next::Skip,
            (Step::Version | Step::State, General(_) | Refused(_) | Denied) => Next::Skip,
            (Step::EnterTime, Refused(2)) | (Step::LeaveTime, Refused(3)) => Next::Done,
            // 04: the device is not in the time mode.
            (Step::ReadTime { .. }, _) => Next::Detour(Step::LeaveTime),
            (Step::LaserOn, Refused(2)) => Next::Done,
            (Step::Stream(_), Denied) => Next::Detour(Step::LaserOn),
            (Step::Stream(_), Refused(_) | General(b'C'..=b'H')) => Next::Fail,
            _ => Next::Again,
        }
    }

    /// What follows when the request went unanswered or was refused as often as it may be.
    pub fn exhausted(self) -> Next {
        match self {
            Step::Quiet => Next::Detour(Step::SwitchFromScip1),
            Step::LeaveForgottenTime | Step::Reboot { .. } => Next::Done,
            Step::ReadTime { rounds: 2.., spare: 1.. } => Next::Skip,
            Step::Reset => Next::Skip,
            Step::EnterTime | Step::ReadTime { .. } => Next::Detour(Step::LeaveTime),
            _ => Next::Fail,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_and_what_they_lead_to() {
        let status = |code: &[u8; 2]| Status::from_code(*code);
        for (step, code, next) in [
            (Step::Quiet, b"00", Next::Done),
            (Step::Quiet, b"02", Next::Done),
            (Step::Quiet, b"0E", Next::Detour(Step::LeaveForgottenTime)),
            (Step::Quiet, b"10", Next::Detour(Step::LeaveForgottenTime)),
            (Step::Quiet, b"0L", Next::Detour(Step::Reboot { again: false })),
            (Step::LeaveForgottenTime, b"03", Next::Done),
            (Step::SwitchFromScip1, b"0E", Next::Done),
            (Step::Reset, b"0E", Next::Skip),
            (Step::Reset, b"0M", Next::Again),
            (Step::State, b"10", Next::Skip),
            (Step::Parameters, b"0B", Next::Again),
            (Step::EnterTime, b"02", Next::Done),
            (Step::EnterTime, b"01", Next::Again),
            (Step::ReadTime { rounds: 5, spare: 3 }, b"04", Next::Detour(Step::LeaveTime)),
            (Step::LeaveTime, b"03", Next::Done),
            (Step::LaserOn, b"02", Next::Done),
            (Step::LaserOn, b"01", Next::Again),
            (Step::Reboot { again: false }, b"01", Next::Detour(Step::Reboot { again: true })),
            (Step::Reboot { again: true }, b"00", Next::Done),
        ] {
            assert_eq!(step.after(status(code)), next, "{step:?} {}", code.escape_ascii());
        }
        let stream = Step::Stream(Command::LaserOn.into());
        assert_eq!(stream.after(status(b"10")), Next::Detour(Step::LaserOn));
        assert_eq!(stream.after(status(b"04")), Next::Fail);
        assert_eq!(stream.after(status(b"0B")), Next::Again);
        assert_eq!(Step::Quiet.after(Status::Scip1(b'E')), Next::Detour(Step::SwitchFromScip1));
    }
}
