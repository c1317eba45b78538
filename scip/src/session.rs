//! Drives a device: start-up, stream, stop, reconnection. Bytes and time come in, actions and events go
//! out; there is no port, clock or thread in here.
//!
//! The start-up works on every device that drivers report about: LF, a short drain, QT (sent again when it
//! is ignored), TM2 where QT is refused, SCIP2.0 where SCIP 1.1 answers, RS, VV, PP, II, TM rounds, BM until
//! it succeeds, ME without end. II is never sent while scans stream: its answer can split them.

mod settings;
mod step;

use std::collections::VecDeque;

pub use settings::{Patience, Purpose, SessionSettings, Window};
use step::{Next, Step};

use crate::device::Device;
use crate::event::{Event, SessionEvent, Trouble};
use crate::monitor::{Monitor, within_reason};
use crate::request::{Command, Request, RequestError};
use crate::status::Status;

/// What the caller is to do next.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// Open the connection, then call [`Session::on_opened`], or [`Session::on_closed`] where that fails.
    Open,
    /// Send these bytes. Where traffic is recorded, record them with this time: the session's own monitor
    /// was given it, and a replay must see the same.
    Send {
        /// Time of the request (ns).
        at_ns: i64,
        /// The bytes.
        bytes: Vec<u8>,
    },
    /// Close the connection, then call [`Session::on_closed`].
    Close,
}

/// Where the session stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// Waits before the next attempt to open.
    Waiting {
        /// Until when (ns).
        until_ns: i64,
    },
    /// The caller is opening the connection.
    Opening,
    /// Lets bytes go by that were under way.
    Draining {
        /// Until when (ns).
        until_ns: i64,
    },
    /// A request of the start-up is under way or due.
    Starting(Request),
    /// Scans come.
    Streaming(Request),
    /// The laser is being turned off.
    Stopping,
    /// The caller is closing the connection.
    Closing,
    /// The end.
    Stopped,
}

/// A request under way, or due to be sent again.
#[derive(Clone, Copy, Debug)]
struct Exchange {
    step: Step,
    /// When the step was begun.
    begun_ns: i64,
    attempts: u32,
    /// When the reply is overdue, or the next attempt is due.
    due_ns: i64,
    /// Whether a reply is awaited.
    sent: bool,
}

impl Exchange {
    fn new(step: Step, now_ns: i64) -> Exchange {
        Exchange { step, begun_ns: now_ns, attempts: 0, due_ns: now_ns, sent: false }
    }
}

#[derive(Clone, Copy, Debug)]
struct Streaming {
    request: Request,
    since_ns: i64,
    /// When the last scan came, or the stream was accepted.
    heard_ns: i64,
    /// When a scan is overdue, or the verification of an error.
    due_ns: i64,
    /// The status that holds the stream.
    held: Option<Status>,
}

#[derive(Clone, Copy, Debug)]
enum Phase {
    Waiting { until_ns: i64 },
    Opening,
    Draining { until_ns: i64 },
    Starting(Exchange),
    Streaming(Streaming),
    Stopping { until_ns: i64, due_ns: i64 },
    Closing,
    Stopped,
}

/// What a monitor's event means to the session.
enum Signal {
    Scan,
    Reply(Request, Status),
    Stuck(u32),
}

impl Signal {
    fn of(event: &Event) -> Option<Signal> {
        match event {
            Event::Scan(_) => Some(Signal::Scan),
            Event::Reply(reply) => Some(Signal::Reply(*reply.request()?, reply.status)),
            Event::StuckStamp { scans, .. } => Some(Signal::Stuck(*scans)),
            _ => None,
        }
    }
}

/// See the module. After every call take the actions and events until there are none.
#[derive(Debug)]
pub struct Session {
    settings: SessionSettings,
    monitor: Monitor,
    phase: Phase,
    now_ns: i64,
    stop_wanted: bool,
    /// Connections and streams that failed since the last that lasted.
    failures: u32,
    /// Times that II was read on this connection, and QT or a detour was repeated: bounds the detours.
    state_reads: u32,
    detours: u32,
    /// Wait before the next attempt to open, where a reboot asks for more than the back-off.
    reopen_after_ns: Option<i64>,
    actions: VecDeque<Action>,
    events: VecDeque<Event>,
}

impl Session {
    /// II is read this often before a device is called unhealthy or a running laser is accepted.
    const STATE_READS: u32 = 3;
    /// TM1 may go unanswered this often before the rounds are ended.
    const SPARE_ROUNDS: u32 = 3;
    /// A stream that lasted this long (ns) was no failure.
    const LASTING_NS: i64 = 3_000_000_000;
    /// Detours of one start-up.
    const MAX_DETOURS: u32 = 8;
    /// Streams that may break on one connection before it is closed.
    const MAX_RESTARTS: u32 = 2;

    /// A session whose first action is to open.
    ///
    /// # Errors
    /// Where the settings cannot be put on the wire.
    pub fn new(settings: SessionSettings, now_ns: i64) -> Result<Session, RequestError> {
        settings.check()?;
        Ok(Session {
            monitor: Monitor::new(settings.monitor.clone()),
            settings,
            phase: Phase::Opening,
            now_ns: within_reason(now_ns),
            stop_wanted: false,
            failures: 0,
            state_reads: 0,
            detours: 0,
            reopen_after_ns: None,
            actions: VecDeque::from([Action::Open]),
            events: VecDeque::new(),
        })
    }

    /// The connection is open.
    pub fn on_opened(&mut self, now_ns: i64) {
        self.now_ns = within_reason(now_ns);
        if !matches!(self.phase, Phase::Opening) {
            return;
        }
        self.monitor.on_gap();
        self.forward_events();
        self.report(SessionEvent::Opened);
        if self.stop_wanted {
            self.close();
            return;
        }
        // An empty line has no reply, and ends whatever was half sent before.
        self.send(b"\n".to_vec());
        self.phase = Phase::Draining { until_ns: self.now_ns + self.settings.patience.drain_ns };
    }

    /// The connection is closed as asked, was lost, or could not be opened.
    pub fn on_closed(&mut self, now_ns: i64) {
        self.now_ns = within_reason(now_ns);
        if matches!(self.phase, Phase::Stopped | Phase::Waiting { .. }) {
            return;
        }
        self.actions.clear();
        self.detours = 0;
        self.state_reads = 0;
        if self.stop_wanted || self.settings.purpose == Purpose::Identify {
            self.report(SessionEvent::Closed { retry_in_ns: None });
            self.end();
            return;
        }
        let wait_ns = self.reopen_after_ns.take().unwrap_or_else(|| self.back_off_ns());
        self.failures += 1;
        self.report(SessionEvent::Closed { retry_in_ns: Some(wait_ns) });
        self.phase = Phase::Waiting { until_ns: self.now_ns + wait_ns };
    }

    /// Bytes were received.
    pub fn on_received(&mut self, now_ns: i64, bytes: &[u8]) {
        self.now_ns = within_reason(now_ns);
        self.monitor.on_received(now_ns, bytes);
        self.forward_events();
        self.on_time(now_ns);
    }

    /// Time went by; to be called at [`deadline_ns`](Session::deadline_ns) at the latest.
    pub fn on_time(&mut self, now_ns: i64) {
        self.now_ns = within_reason(now_ns);
        if self.deadline_ns().is_none_or(|deadline| now_ns < deadline) {
            return;
        }
        match self.phase {
            Phase::Waiting { .. } => {
                self.actions.push_back(Action::Open);
                self.phase = Phase::Opening;
            }
            Phase::Draining { .. } => self.begin(Step::Quiet),
            Phase::Starting(exchange) if exchange.sent => self.on_no_reply(exchange),
            Phase::Starting(exchange) => self.attempt(exchange),
            Phase::Streaming(streaming) => {
                let waited_ns = self.now_ns - streaming.heard_ns;
                let held = streaming.held.map(Trouble::VerifyingTooLong);
                self.on_stream_broken(held.unwrap_or(Trouble::Silent(waited_ns)));
            }
            Phase::Stopping { until_ns, .. } if now_ns >= until_ns => self.close(),
            Phase::Stopping { until_ns, .. } => self.send_quit(until_ns, false),
            Phase::Opening | Phase::Closing | Phase::Stopped => {}
        }
    }

    /// Turn the laser off, close, end. Asks to close within [`Patience::stop_ns`], whatever the device does.
    pub fn stop(&mut self, now_ns: i64) {
        self.now_ns = within_reason(now_ns);
        if std::mem::replace(&mut self.stop_wanted, true) {
            return;
        }
        let until_ns = self.now_ns + self.settings.patience.stop_ns;
        match self.phase {
            Phase::Waiting { .. } => self.end(),
            Phase::Starting(exchange) => self.send_quit(until_ns, exchange.step.in_time_mode()),
            Phase::Draining { .. } | Phase::Streaming(_) => self.send_quit(until_ns, false),
            Phase::Opening | Phase::Stopping { .. } | Phase::Closing | Phase::Stopped => {}
        }
    }

    /// Next thing to do.
    pub fn next_action(&mut self) -> Option<Action> {
        self.actions.pop_front()
    }

    /// Next event.
    pub fn next_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// When [`on_time`](Session::on_time) is due; `None` where only the caller can bring the next change.
    pub fn deadline_ns(&self) -> Option<i64> {
        match self.phase {
            Phase::Waiting { until_ns } | Phase::Draining { until_ns } => Some(until_ns),
            Phase::Starting(exchange) => Some(exchange.due_ns),
            Phase::Streaming(streaming) => Some(streaming.due_ns),
            Phase::Stopping { until_ns, due_ns } => Some(until_ns.min(due_ns)),
            Phase::Opening | Phase::Closing | Phase::Stopped => None,
        }
    }

    /// Where the session stands.
    pub fn state(&self) -> State {
        match self.phase {
            Phase::Waiting { until_ns } => State::Waiting { until_ns },
            Phase::Opening => State::Opening,
            Phase::Draining { until_ns } => State::Draining { until_ns },
            Phase::Starting(exchange) => State::Starting(exchange.step.request()),
            Phase::Streaming(streaming) => State::Streaming(streaming.request),
            Phase::Stopping { .. } => State::Stopping,
            Phase::Closing => State::Closing,
            Phase::Stopped => State::Stopped,
        }
    }

    /// The device as far as it has introduced itself.
    pub fn device(&self) -> &Device {
        self.monitor.device()
    }

    /// The monitor inside: rates, drift, parameters.
    pub fn monitor(&self) -> &Monitor {
        &self.monitor
    }

    fn report(&mut self, event: SessionEvent) {
        self.events.push_back(Event::Session(event));
    }

    fn send(&mut self, bytes: Vec<u8>) {
        self.monitor.on_sent(self.now_ns, &bytes);
        self.actions.push_back(Action::Send { at_ns: self.now_ns, bytes });
    }

    fn close(&mut self) {
        self.actions.push_back(Action::Close);
        self.phase = Phase::Closing;
    }

    fn end(&mut self) {
        self.phase = Phase::Stopped;
        self.report(SessionEvent::Stopped);
    }

    fn back_off_ns(&self) -> i64 {
        let patience = &self.settings.patience;
        let doubled = patience.back_off_min_ns.saturating_mul(1 << self.failures.min(20));
        doubled.min(patience.back_off_max_ns)
    }

    fn forward_events(&mut self) {
        while let Some(event) = self.monitor.next_event() {
            let signal = Signal::of(&event);
            self.events.push_back(event);
            match (self.phase, signal) {
                (Phase::Starting(exchange), Some(signal)) => self.on_signal_starting(exchange, signal),
                (Phase::Streaming(streaming), Some(signal)) => self.on_signal_streaming(streaming, signal),
                (Phase::Stopping { until_ns, .. }, Some(Signal::Reply(request, status))) => {
                    self.on_reply_stopping(until_ns, request, status);
                }
                _ => {}
            }
        }
    }

    // Start-up

    fn begin(&mut self, step: Step) {
        self.attempt(Exchange::new(step, self.now_ns));
    }

    fn attempt(&mut self, mut exchange: Exchange) {
        let request = exchange.step.request();
        if exchange.attempts > 0 {
            self.report(SessionEvent::Retry { request, attempts: exchange.attempts });
        }
        exchange.attempts += 1;
        exchange.sent = true;
        exchange.due_ns = self.now_ns + self.settings.patience.reply_ns;
        self.phase = Phase::Starting(exchange);
        self.send(request.to_bytes());
    }

    /// Whether the step may be tried once more: by time where devices need it, else by number.
    fn may_try_again(&self, exchange: &Exchange) -> bool {
        let patience = &self.settings.patience;
        let spent_ns = self.now_ns - exchange.begun_ns;
        match exchange.step {
            Step::LaserOn | Step::Stream(_) => spent_ns < patience.laser_on_ns,
            Step::EnterTime => spent_ns < self.settings.time_mode_ns(),
            Step::ReadTime { .. } | Step::Reboot { .. } => false,
            _ => exchange.attempts < patience.attempts,
        }
    }

    fn on_no_reply(&mut self, exchange: Exchange) {
        if self.may_try_again(&exchange) {
            self.attempt(exchange);
        } else {
            self.follow(exchange, exchange.step.exhausted(), Trouble::NoReply(exchange.step.request()));
        }
    }

    fn on_signal_starting(&mut self, exchange: Exchange, signal: Signal) {
        match (exchange.step, signal) {
            // The acknowledgement was lost but the stream runs.
            (Step::Stream(request), Signal::Scan) => {
                self.on_streaming(request);
                self.on_scan();
            }
            (step, Signal::Reply(request, status)) if exchange.sent && request == step.request() => {
                let trouble = Trouble::Refused(request, status);
                let next = match step.after(status) {
                    Next::Again if !self.may_try_again(&exchange) => step.exhausted(),
                    next => next,
                };
                self.follow(exchange, next, trouble);
            }
            _ => {}
        }
    }

    fn follow(&mut self, exchange: Exchange, next: Next, trouble: Trouble) {
        match next {
            Next::Done => self.on_step_done(exchange.step),
            Next::Skip => self.on_step_skipped(exchange.step),
            Next::Again => self.try_later(exchange),
            Next::Detour(step) if self.detours < Self::MAX_DETOURS => self.take_detour(exchange, step),
            Next::Detour(_) | Next::Fail => {
                self.report(SessionEvent::Trouble(trouble));
                self.close();
            }
        }
    }

    fn try_later(&mut self, exchange: Exchange) {
        let due_ns = self.now_ns + self.settings.patience.retry_ns;
        self.phase = Phase::Starting(Exchange { sent: false, due_ns, ..exchange });
    }

    fn take_detour(&mut self, from: Exchange, step: Step) {
        self.detours += 1;
        match step {
            Step::SwitchFromScip1 => self.report(SessionEvent::SwitchingFromScip1),
            Step::LeaveForgottenTime => self.report(SessionEvent::LeavingTimeMode),
            Step::Reboot { again: false } => self.report(SessionEvent::Rebooting),
            _ => {}
        }
        if step == Step::LaserOn {
            // The stream was denied: give the laser a moment before it is asked again.
            self.try_later(Exchange { step, ..from });
        } else {
            self.begin(step);
        }
    }

    fn on_step_skipped(&mut self, step: Step) {
        match step {
            Step::ReadTime { rounds, spare } => {
                self.begin(Step::ReadTime { rounds: rounds - 1, spare: spare.saturating_sub(1) });
            }
            step => self.on_step_done(step),
        }
    }

    fn on_step_done(&mut self, step: Step) {
        match step {
            Step::Quiet if self.settings.purpose == Purpose::Identify => self.begin(Step::Version),
            Step::Quiet if self.state_reads > 0 => self.begin(Step::State),
            Step::Quiet => self.begin(Step::Reset),
            Step::LeaveForgottenTime | Step::SwitchFromScip1 => self.begin(Step::Quiet),
            Step::Reset => self.begin(Step::Version),
            Step::Version => self.begin(Step::Parameters),
            Step::Parameters if self.monitor.parameters().is_none() => {
                self.report(SessionEvent::Trouble(Trouble::UnusableParameters));
                self.close();
            }
            Step::Parameters => self.begin(Step::State),
            Step::State => self.on_state_read(),
            Step::EnterTime => {
                let (rounds, spare) = (self.settings.sync_rounds, Self::SPARE_ROUNDS);
                self.begin(Step::ReadTime { rounds, spare });
            }
            Step::ReadTime { rounds: 0 | 1, .. } => self.begin(Step::LeaveTime),
            Step::ReadTime { rounds, spare } => self.begin(Step::ReadTime { rounds: rounds - 1, spare }),
            Step::LeaveTime => {
                if !self.monitor.is_synchronised() {
                    self.report(SessionEvent::NotSynchronised);
                }
                self.begin(Step::LaserOn);
            }
            Step::LaserOn => self.begin_stream(),
            Step::Stream(request) => self.on_streaming(request),
            Step::Reboot { .. } => {
                self.reopen_after_ns = Some(self.settings.patience.reboot_ns);
                self.close();
            }
        }
    }

    /// II can be late: a laser that still runs is told again, a device that seems ill is asked again.
    fn on_state_read(&mut self) {
        self.state_reads += 1;
        let may_read_again = self.state_reads < Self::STATE_READS;
        let is_unhealthy = self.device().is_healthy() == Some(false);
        if self.device().laser_on() == Some(true) && may_read_again {
            self.begin(Step::Quiet);
        } else if is_unhealthy && may_read_again {
            self.try_later(Exchange::new(Step::State, self.now_ns));
        } else {
            if is_unhealthy {
                self.report(SessionEvent::Unhealthy);
            }
            self.on_introduced();
        }
    }

    fn on_introduced(&mut self) {
        if self.settings.purpose == Purpose::Identify {
            self.report(SessionEvent::Identified);
            self.close();
        } else if self.settings.sync_rounds > 0 {
            self.begin(Step::EnterTime);
        } else {
            self.begin(Step::LaserOn);
        }
    }

    fn begin_stream(&mut self) {
        let scan = self.monitor.parameters().and_then(|device| self.settings.scan_request(device));
        match scan {
            Some(scan) => {
                let request = Request { command: Command::Scan(scan), text: self.settings.text };
                self.begin(Step::Stream(request));
            }
            None => {
                self.report(SessionEvent::Trouble(Trouble::EmptyWindow));
                self.close();
            }
        }
    }

    // Stream

    fn on_streaming(&mut self, request: Request) {
        self.report(SessionEvent::Streaming(request));
        let now_ns = self.now_ns;
        let due_ns = now_ns + self.settings.patience.first_scan_ns;
        self.phase =
            Phase::Streaming(Streaming { request, since_ns: now_ns, heard_ns: now_ns, due_ns, held: None });
    }

    fn silence_ns(&self) -> i64 {
        let turns = 4 * (i64::from(self.settings.skip) + 1);
        let scans_ns = self.monitor.parameters().map_or(0, |device| device.turn_ns() * turns);
        self.settings.patience.silence_ns.max(scans_ns)
    }

    fn on_scan(&mut self) {
        let due_ns = self.now_ns + self.silence_ns();
        if let Phase::Streaming(streaming) = &mut self.phase {
            streaming.heard_ns = self.now_ns;
            streaming.due_ns = due_ns;
            streaming.held = None;
            if self.now_ns - streaming.since_ns > Self::LASTING_NS {
                self.failures = 0;
            }
        }
    }

    fn on_signal_streaming(&mut self, streaming: Streaming, signal: Signal) {
        match signal {
            Signal::Scan => self.on_scan(),
            Signal::Stuck(scans) if scans >= self.settings.patience.stuck_scans => {
                self.on_stream_broken(Trouble::StuckStamps(scans));
            }
            Signal::Reply(request, status) if is_same_stream(&request, &streaming.request) => {
                self.on_stream_status(streaming, status);
            }
            Signal::Stuck(_) | Signal::Reply(..) => {}
        }
    }

    fn on_stream_status(&mut self, streaming: Streaming, status: Status) {
        match status {
            // A late acknowledgement, or a scan without data.
            Status::Done | Status::ScanFollows => {}
            Status::Verifying(_) | Status::Unstable => {
                let due_ns = self.now_ns + self.settings.patience.verify_ns;
                self.report(SessionEvent::Verifying(status));
                self.phase = Phase::Streaming(Streaming { due_ns, held: Some(status), ..streaming });
            }
            Status::Resumed => {
                self.report(SessionEvent::Resumed);
                self.on_scan();
            }
            Status::Abnormal => {
                self.report(SessionEvent::Trouble(Trouble::StreamEnded(status)));
                self.report(SessionEvent::Rebooting);
                self.begin(Step::Reboot { again: false });
            }
            _ => self.on_stream_broken(Trouble::StreamEnded(status)),
        }
    }

    /// Starts up again on the same connection, or, where that was tried, on a new one.
    fn on_stream_broken(&mut self, trouble: Trouble) {
        self.report(SessionEvent::Trouble(trouble));
        self.failures += 1;
        self.detours = 0;
        self.state_reads = 0;
        if self.failures > Self::MAX_RESTARTS {
            self.close();
        } else {
            self.begin(Step::Quiet);
        }
    }

    // Stop

    /// QT, and before it TM2 where the device may be in the time mode: it would refuse QT.
    fn send_quit(&mut self, until_ns: i64, leave_time_mode: bool) {
        let mut bytes = Vec::new();
        if leave_time_mode {
            bytes.extend(Request::from(Command::TimeLeave).to_bytes());
        }
        bytes.extend(Request::from(Command::Quit).to_bytes());
        self.send(bytes);
        let due_ns = self.now_ns + self.settings.patience.reply_ns;
        self.phase = Phase::Stopping { until_ns, due_ns };
    }

    fn on_reply_stopping(&mut self, until_ns: i64, request: Request, status: Status) {
        match (request.command, status) {
            (Command::Quit, Status::Done | Status::Refused(_)) => self.close(),
            (Command::Quit, _) if self.detours < Self::MAX_DETOURS => {
                self.detours += 1;
                self.send_quit(until_ns, true);
            }
            (Command::Quit, _) => self.close(),
            _ => {}
        }
    }
}

fn is_same_stream(a: &Request, b: &Request) -> bool {
    match (a.command, b.command) {
        (Command::Scan(x), Command::Scan(y)) => a.text == b.text && x.same_stream(&y),
        _ => false,
    }
}

#[cfg(test)]
mod tests;
