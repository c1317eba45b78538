//! A passive listener on both directions of a wire: it sends nothing and reads no clock. What it reports
//! is a pure function of its calls, so that a replay of a recording gives the same scans, bit by bit. The
//! session listens through one; a replay uses one alone.

use std::collections::VecDeque;

use crate::clock::{Advance, OffsetEstimate, Unwrapper};
use crate::decoder::{Decoder, Located};
use crate::device::{Device, Parameters};
use crate::event::{Event, Rate, Synchronisation};
use crate::fields::Fields;
use crate::reply::{Body, Reply, ScanData};
use crate::request::{Command, Request, ScanRequest};
use crate::scan::Scan;
use crate::status::Status;

/// What the stamps of scans rest on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ClockSource {
    /// The host's clock, tied to the device's by TM rounds and by arrival times.
    #[default]
    Host,
    /// The device's own unwrapped clock: for bytes whose times of arrival are not known.
    Device,
}

/// Which moment of a turn the device stamps: C-42-03320B says step 0, some drivers the rear.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StampReference {
    /// Step 0.
    #[default]
    Step0,
    /// The beam pointing to the rear of the sensor, before step 0 (3.125 ms on a UTM-30LX).
    Rear,
}

/// How a monitor reads the wire.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MonitorOptions {
    /// What stamps rest on.
    pub clock: ClockSource,
    /// What the device's stamp refers to.
    pub stamp_reference: StampReference,
    /// Parameters to go by until PP is seen; without any, lost scans cannot be told from stamps.
    pub parameters: Option<Parameters>,
}

/// Longest request line that is collected: no request is as long.
const MAX_SENT_LINE: usize = 256;
/// Requests without a reply that are remembered.
const MAX_PENDING: usize = 32;
/// Span over which the delivered rate is measured (ms of the device's clock).
const RATE_MS: i64 = 4000;
/// A hole of more scans than this is a pause (a held stream, a reconnection), not a slow link.
const PAUSE_SCANS: u64 = 8;

/// A request that was sent and not answered yet.
#[derive(Clone, Copy, Debug)]
struct Pending {
    request: Request,
    sent_ns: i64,
}

/// Last scan, for numbering the next.
#[derive(Clone, Copy, Debug)]
struct LastScan {
    seq: u64,
    unwrapped_ms: i64,
    /// Scans that have carried its stamp.
    repeats: u32,
}

/// See the module.
#[derive(Debug)]
pub struct Monitor {
    options: MonitorOptions,
    decoder: Decoder,
    /// Offset of the first byte of each chunk whose bytes may still become a reply, and its time.
    arrivals: VecDeque<(u64, i64)>,
    device: Device,
    sent_line: Vec<u8>,
    pending: VecDeque<Pending>,
    /// Whether the sending side is known at all; a bare capture has only the other.
    sees_requests: bool,
    requested: Option<Request>,
    unwrapper: Unwrapper,
    offset: OffsetEstimate,
    last_scan: Option<LastScan>,
    /// The clock began anew since the last scan.
    was_reset: bool,
    counting: Rate,
    rate: Option<Rate>,
    events: VecDeque<Event>,
}

impl Monitor {
    /// A monitor that has seen nothing.
    pub fn new(options: MonitorOptions) -> Monitor {
        Monitor {
            options,
            decoder: Decoder::new(),
            arrivals: VecDeque::new(),
            device: Device::default(),
            sent_line: Vec::new(),
            pending: VecDeque::new(),
            sees_requests: false,
            requested: None,
            unwrapper: Unwrapper::default(),
            offset: OffsetEstimate::new(),
            last_scan: None,
            was_reset: false,
            counting: Rate::default(),
            rate: None,
            events: VecDeque::new(),
        }
    }

    /// Bytes that the host sent at `now_ns`, in any chunks. Once this was called, scans that were not
    /// requested are reported as [`Event::StrayScan`].
    pub fn on_sent(&mut self, now_ns: i64, bytes: &[u8]) {
        let now_ns = within_reason(now_ns);
        self.sees_requests = true;
        for &byte in bytes {
            if byte == b'\n' || byte == b'\r' {
                let line = std::mem::take(&mut self.sent_line);
                if let Ok(request) = Request::parse(&line) {
                    self.on_request(now_ns, request);
                }
            } else if self.sent_line.len() < MAX_SENT_LINE {
                self.sent_line.push(byte);
            }
        }
    }

    fn on_request(&mut self, sent_ns: i64, request: Request) {
        if matches!(request.command, Command::Scan(_)) {
            self.requested = Some(request);
        }
        if self.pending.len() == MAX_PENDING {
            self.pending.pop_front();
        }
        self.pending.push_back(Pending { request, sent_ns });
    }

    /// Bytes that were received at `now_ns` (of the first of them, where that is known).
    pub fn on_received(&mut self, now_ns: i64, bytes: &[u8]) {
        let now_ns = within_reason(now_ns);
        if self.arrivals.back().is_none_or(|&(_, time)| time != now_ns) {
            self.arrivals.push_back((self.decoder.offset(), now_ns));
        }
        self.decoder.push(bytes);
        while let Some(outcome) = self.decoder.decode_next() {
            match outcome {
                Ok(located) => self.on_reply(located),
                Err(error) => self.events.push_back(Event::Skipped(error)),
            }
        }
        let undecoded_at = self.decoder.undecoded_at();
        while self.arrivals.get(1).is_some_and(|&(offset, _)| offset <= undecoded_at) {
            self.arrivals.pop_front();
        }
    }

    /// The connection was reopened, or bytes are missing here: a reply does not go on across this.
    pub fn on_gap(&mut self) {
        self.events.extend(self.decoder.cut().map(Event::Skipped));
        self.sent_line.clear();
        self.pending.clear();
        self.arrivals.clear();
    }

    /// Next event, in the order of the stream.
    pub fn next_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// The device as far as it has introduced itself.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Parameters by PP, or those of the options.
    pub fn parameters(&self) -> Option<&Parameters> {
        self.device.parameters.as_ref().or(self.options.parameters.as_ref())
    }

    /// Bytes received in all.
    pub fn received_bytes(&self) -> u64 {
        self.decoder.offset()
    }

    /// Rate of the last whole span of 4 s.
    pub fn rate(&self) -> Option<Rate> {
        self.rate
    }

    /// Whether TM rounds have tied the device's clock to the host's since it last began anew.
    pub fn is_synchronised(&self) -> bool {
        self.offset.is_tied()
    }

    /// Drift of the host's clock against the device's (parts in 10^9), once measured.
    pub fn drift_ppb(&self) -> Option<i64> {
        self.offset.drift_ppb()
    }

    fn arrival_of(&self, offset: u64) -> i64 {
        let after = self.arrivals.partition_point(|&(from, _)| from <= offset);
        after.checked_sub(1).and_then(|index| self.arrivals.get(index)).map_or(0, |&(_, time)| time)
    }

    fn on_reply(&mut self, located: Located) {
        let first_byte_ns = self.arrival_of(located.at);
        let last_byte_ns = self.arrival_of(located.at + located.len - 1);
        let reply = located.reply;
        let Some(request) = reply.request().copied() else {
            self.events.push_back(Event::Reply(reply));
            return;
        };
        let sent_ns = self.take_pending(&request);
        match (request.command, reply) {
            (Command::Scan(scan), Reply { body: Body::Scan(data), .. }) => {
                self.on_scan(scan, request, data, first_byte_ns, last_byte_ns);
            }
            (command, reply) => {
                self.on_answer(command, &reply, sent_ns, first_byte_ns);
                self.events.push_back(Event::Reply(reply));
            }
        }
    }

    /// Time at which the request of this echo was sent. Devices answer in order, so older ones are lost.
    fn take_pending(&mut self, echo: &Request) -> Option<i64> {
        let at = self.pending.iter().position(|pending| pending.request == *echo)?;
        self.pending.drain(..=at).next_back().map(|pending| pending.sent_ns)
    }

    fn on_answer(&mut self, command: Command, reply: &Reply, sent_ns: Option<i64>, received_ns: i64) {
        match (command, reply.status, &reply.body) {
            (Command::Version, Status::Done, Body::Fields(fields)) => {
                self.device.version = Some(fields.clone())
            }
            (Command::Parameters, Status::Done, Body::Fields(fields)) => self.on_parameters(fields),
            (Command::State, Status::Done, Body::Fields(fields)) => self.device.state = Some(fields.clone()),
            (Command::Reset | Command::PartialReset | Command::Reboot, Status::Done, _) => {
                self.unwrapper.announce_reset();
                self.offset.restart();
            }
            (Command::TimeEnter, Status::Done, _) => self.offset.begin_rounds(),
            (Command::TimeRead, Status::Done, Body::Time(ms)) => {
                let device_ms = self.unwrap(*ms, received_ns);
                if let Some(sent_ns) = sent_ns {
                    self.offset.on_round(device_ms, sent_ns, received_ns);
                }
            }
            (Command::TimeLeave, Status::Done, _) => self.finish_rounds(),
            _ => {}
        }
    }

    fn on_parameters(&mut self, fields: &Fields) {
        self.device.parameter_fields = Some(fields.clone());
        match Parameters::from_fields(fields) {
            Ok(parameters) => self.device.parameters = Some(parameters),
            Err(error) => self.events.push_back(Event::BadParameters(error)),
        }
    }

    fn finish_rounds(&mut self) {
        if let Some(tie) = self.offset.finish_rounds() {
            self.events.push_back(Event::Synchronised(Synchronisation {
                rounds: tie.rounds,
                fastest_ns: tie.fastest_ns,
                offset_ns: tie.offset_ns,
                uncertainty_ns: tie.uncertainty_ns,
            }));
        }
    }

    fn unwrap(&mut self, stamp_ms: u32, host_ns: i64) -> i64 {
        let host_ns = (self.options.clock == ClockSource::Host).then_some(host_ns);
        let (unwrapped_ms, advance) = self.unwrapper.advance(stamp_ms, host_ns);
        if let Advance::Reset { before_ms } = advance {
            self.offset.restart();
            self.was_reset = true;
            self.events.push_back(Event::ClockReset { before_ms, after_ms: stamp_ms });
        }
        unwrapped_ms
    }

    fn is_stray(&self, scan: &ScanRequest, request: &Request) -> bool {
        let asked_for = self.requested.is_some_and(|asked| {
            asked.text == request.text
                && matches!(asked.command, Command::Scan(asked) if asked.same_stream(scan))
        });
        self.sees_requests && !asked_for
    }

    fn on_scan(&mut self, scan: ScanRequest, request: Request, data: ScanData, first_ns: i64, last_ns: i64) {
        let mut scan = Scan {
            request: scan,
            text: request.text,
            seq: 0,
            stamp_ms: data.stamp_ms,
            unwrapped_ms: 0,
            first_byte_ns: first_ns,
            last_byte_ns: last_ns,
            stamp_ns: 0,
            distances_mm: data.distances_mm,
            intensities: data.intensities,
            more_echoes: data.more_echoes,
        };
        if self.is_stray(&scan.request, &request) {
            self.events.push_back(Event::StrayScan(scan));
            return;
        }
        scan.unwrapped_ms = self.unwrap(scan.stamp_ms, first_ns);
        scan.seq = self.number(&scan);
        self.offset.on_scan(scan.unwrapped_ms, first_ns);
        scan.stamp_ns = self.stamp_ns(&scan);
        self.events.push_back(Event::Scan(scan));
    }

    /// Number of a scan, by the turns that its stamp says went by since the last.
    fn number(&mut self, scan: &Scan) -> u64 {
        let unwrapped_ms = scan.unwrapped_ms;
        let was_reset = std::mem::take(&mut self.was_reset);
        let Some(last) = self.last_scan else {
            self.last_scan = Some(LastScan { seq: 0, unwrapped_ms, repeats: 1 });
            return 0;
        };
        let over_ms = unwrapped_ms - last.unwrapped_ms;
        let due = match self.parameters() {
            Some(parameters) => turns(over_ms, parameters, scan.request.skip),
            None => 1,
        };
        // Nothing is known of the time around a reset; that some is missing is certain.
        let due = due.max(if was_reset { 2 } else { 1 });
        let seq = last.seq + due;
        let repeats = if over_ms == 0 { last.repeats + 1 } else { 1 };
        self.last_scan = Some(LastScan { seq, unwrapped_ms, repeats });
        if due > 1 {
            self.events.push_back(Event::Lost { seq, scans: due - 1 });
        }
        if repeats > 1 {
            self.events.push_back(Event::StuckStamp { stamp_ms: scan.stamp_ms, scans: repeats });
        }
        self.count(due, over_ms);
        seq
    }

    fn count(&mut self, due: u64, over_ms: i64) {
        if due > PAUSE_SCANS {
            self.counting = Rate::default();
            return;
        }
        self.counting.received += 1;
        self.counting.due += due;
        self.counting.over_ms += over_ms;
        if self.counting.over_ms < RATE_MS {
            return;
        }
        let was_slow = self.rate.is_some_and(|rate| rate.is_slow);
        let is_slow = self.counting.received * 10 < self.counting.due * 9;
        let rate = Rate { is_slow, ..self.counting };
        self.rate = Some(rate);
        self.counting = Rate::default();
        if is_slow != was_slow {
            self.events.push_back(Event::Rate(rate));
        }
    }

    /// Time of the first step of a scan.
    fn stamp_ns(&self, scan: &Scan) -> i64 {
        let parameters = self.parameters();
        let device_ns = scan.unwrapped_ms * 1_000_000;
        let stamped_ns = match self.options.clock {
            ClockSource::Device => device_ns,
            ClockSource::Host => {
                // In a capture of a UTM-30LX data began 23.5 ms after the stamp, 0.94 of a turn.
                let latency_ns = parameters.map_or(0, |parameters| parameters.turn_ns() * 47 / 50);
                self.offset.host_ns(scan.unwrapped_ms, latency_ns).unwrap_or(scan.first_byte_ns)
            }
        };
        stamped_ns.saturating_add(
            parameters.map_or(0, |parameters| self.first_step_ns(parameters, scan.request.start)),
        )
    }

    /// Time from the moment that is stamped to a step (ns).
    fn first_step_ns(&self, parameters: &Parameters, start: u16) -> i64 {
        let before_step0 = match self.options.stamp_reference {
            StampReference::Step0 => 0,
            StampReference::Rear => {
                i64::from(parameters.steps_per_turn) / 2 - i64::from(parameters.front_step)
            }
        };
        parameters.steps_ns(before_step0 + i64::from(start))
    }
}

/// Times are cut to 36 years around 0, so that no sum overflows.
pub(crate) fn within_reason(now_ns: i64) -> i64 {
    now_ns.clamp(-(1 << 60), 1 << 60)
}

/// Scans that were due in a span of the device's time, to the nearest.
fn turns(over_ms: i64, parameters: &Parameters, skip: u8) -> u64 {
    let minute_ms = 60_000 * (i64::from(skip) + 1);
    let turns =
        (over_ms.saturating_mul(2 * i64::from(parameters.rpm)).saturating_add(minute_ms)) / (2 * minute_ms);
    turns.max(0) as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model;
    use crate::number;
    use crate::reply::Echo;
    use crate::request::ScanKind;

    const MS: i64 = 1_000_000;

    fn utm() -> Option<Parameters> {
        model::find("UTM-30LX").and_then(Parameters::of_model)
    }

    fn scan_bytes(request: ScanRequest, stamp_ms: u32) -> Vec<u8> {
        let body = Body::Scan(ScanData { stamp_ms, distances_mm: vec![1000; 3], ..ScanData::default() });
        let echo = Echo::Request(Command::Scan(request).into());
        let mut bytes = Vec::new();
        Reply { echo, status: Status::ScanFollows, body }.emit(&mut bytes);
        bytes
    }

    /// Steps 180 to 182 of a stream of distances.
    fn request(skip: u8) -> ScanRequest {
        ScanRequest { skip, ..ScanRequest::new(ScanKind::MD, 180, 182) }
    }

    fn events(monitor: &mut Monitor) -> Vec<Event> {
        std::iter::from_fn(|| monitor.next_event()).collect()
    }

    /// Numbers of scans with these stamps.
    fn numbers(options: MonitorOptions, skip: u8, stamps: &[u32]) -> (Vec<u64>, Vec<Event>) {
        let mut monitor = Monitor::new(options);
        for (index, &stamp) in stamps.iter().enumerate() {
            monitor.on_received(index as i64 * 25 * MS, &scan_bytes(request(skip), stamp));
        }
        let (scans, others): (Vec<Event>, Vec<Event>) =
            events(&mut monitor).into_iter().partition(|event| matches!(event, Event::Scan(_)));
        let number = |event| match event {
            Event::Scan(scan) => scan.seq,
            other => panic!("{other}"),
        };
        (scans.into_iter().map(number).collect(), others)
    }

    fn with_parameters() -> MonitorOptions {
        MonitorOptions { parameters: utm(), ..MonitorOptions::default() }
    }

    #[test]
    fn lost_scans_show_in_the_numbers() {
        let (seq, others) = numbers(with_parameters(), 0, &[100, 125, 150, 226, 251]);
        assert_eq!(seq, [0, 1, 2, 5, 6]);
        assert_eq!(others, [Event::Lost { seq: 5, scans: 2 }]);
        let (seq, others) = numbers(with_parameters(), 1, &[100, 150, 200, 300]);
        assert_eq!((seq, others.len()), (vec![0, 1, 2, 4], 1));
        let (seq, others) = numbers(MonitorOptions::default(), 0, &[100, 125, 500]);
        assert_eq!((seq, others.len()), (vec![0, 1, 2], 0), "without PP nothing is known of losses");
    }

    #[test]
    fn a_wrap_loses_nothing_and_a_reset_does() {
        let (seq, others) = numbers(with_parameters(), 0, &[16_777_200, 9, 34]);
        assert_eq!((seq, others.len()), (vec![0, 1, 2], 0));
        let (seq, others) = numbers(with_parameters(), 0, &[9_000_000, 9_000_025, 10, 35]);
        assert_eq!(seq, [0, 1, 3, 4]);
        assert_eq!(others[0], Event::ClockReset { before_ms: 9_000_025, after_ms: 10 });
    }

    #[test]
    fn stuck_stamps() {
        let (seq, others) = numbers(with_parameters(), 0, &[100, 100, 100]);
        assert_eq!(seq, [0, 1, 2]);
        let stuck = |scans| Event::StuckStamp { stamp_ms: 100, scans };
        assert_eq!(others, [stuck(2), stuck(3)]);
    }

    #[test]
    fn a_link_that_is_too_slow_is_reported_once() {
        let stamps: Vec<u32> = (0..400).map(|scan| scan * 50).collect();
        let (_, others) = numbers(with_parameters(), 0, &stamps);
        let rates: Vec<_> = others
            .iter()
            .filter_map(|event| match event {
                Event::Rate(rate) => Some(*rate),
                _ => None,
            })
            .collect();
        assert_eq!(rates, [Rate { received: 80, due: 160, over_ms: 4000, is_slow: true }]);
    }

    #[test]
    fn a_pause_is_no_slow_link() {
        let stamps: Vec<u32> = (0..400).map(|scan| scan * 25 + scan / 100 * 2000).collect();
        let (_, others) = numbers(with_parameters(), 0, &stamps);
        assert!(others.iter().all(|event| matches!(event, Event::Lost { scans: 80, .. })), "{others:?}");
        assert_eq!(others.len(), 3);
    }

    #[test]
    fn the_first_step_and_the_reference_move_the_stamp() {
        let stamp = |stamp_reference| {
            let options = MonitorOptions { clock: ClockSource::Device, stamp_reference, parameters: utm() };
            let mut monitor = Monitor::new(options);
            monitor.on_received(0, &scan_bytes(request(0), 100));
            match monitor.next_event() {
                Some(Event::Scan(scan)) => scan.stamp_ns,
                other => panic!("{other:?}"),
            }
        };
        // 180 steps are an eighth of a turn of 25 ms; the rear lies as far before step 0.
        assert_eq!(stamp(StampReference::Step0), 100 * MS + 3_125_000);
        assert_eq!(stamp(StampReference::Rear), 100 * MS + 6_250_000);
    }

    #[test]
    fn a_reply_carries_the_times_of_its_first_and_last_byte() {
        let mut monitor = Monitor::new(MonitorOptions::default());
        let bytes = [scan_bytes(request(0), 100), scan_bytes(request(0), 125)].concat();
        for (index, byte) in bytes.iter().enumerate() {
            monitor.on_received(index as i64, &[*byte]);
        }
        let half = bytes.len() as i64 / 2;
        let times: Vec<_> = events(&mut monitor)
            .into_iter()
            .map(|event| match event {
                Event::Scan(scan) => (scan.first_byte_ns, scan.last_byte_ns),
                other => panic!("{other}"),
            })
            .collect();
        assert_eq!(times, [(0, half - 1), (half, 2 * half - 1)]);
    }

    #[test]
    fn only_what_was_asked_for_is_a_scan() {
        let mut monitor = Monitor::new(MonitorOptions::default());
        // A client that writes a command and its LF apart.
        monitor.on_sent(0, b"MD01800182");
        monitor.on_sent(0, b"00005");
        monitor.on_sent(0, b"\n");
        let asked = ScanRequest { cluster: 0, count: 4, ..request(0) };
        monitor.on_received(1, &scan_bytes(asked, 100));
        monitor.on_received(2, &scan_bytes(ScanRequest { cluster: 1, ..asked }, 125));
        let events = events(&mut monitor);
        assert!(matches!(events[..], [Event::Scan(_), Event::StrayScan(_)]), "{events:?}");
    }

    #[test]
    fn a_reply_does_not_go_on_across_a_gap() {
        let mut monitor = Monitor::new(MonitorOptions::default());
        let bytes = scan_bytes(request(0), 100);
        monitor.on_received(0, &bytes[..30]);
        monitor.on_gap();
        monitor.on_received(1, &bytes);
        let events = events(&mut monitor);
        assert!(matches!(events[..], [Event::Skipped(_), Event::Scan(_)]), "{events:?}");
    }

    #[test]
    fn rounds_tie_the_clock() {
        let mut monitor = Monitor::new(with_parameters());
        monitor.on_sent(0, b"TM0\n");
        monitor.on_received(MS, b"TM0\n00P\n\n");
        for round in 0..5 {
            let sent_ns = 10 * MS + round * 2 * MS;
            monitor.on_sent(sent_ns, b"TM1\n");
            let mut stamp = Vec::new();
            number::encode(500 + round as u32 * 2, 4, &mut stamp);
            stamp.push(number::checksum(&stamp));
            let reply = [b"TM1\n00P\n", &stamp[..], b"\n\n"].concat();
            monitor.on_received(sent_ns + MS, &reply);
        }
        monitor.on_sent(30 * MS, b"TM2\n");
        monitor.on_received(31 * MS, b"TM2\n00P\n\n");
        let found = events(&mut monitor).into_iter().find_map(|event| match event {
            Event::Synchronised(sync) => Some(sync),
            _ => None,
        });
        let want = Synchronisation { rounds: 5, fastest_ns: MS, offset_ns: -490 * MS, uncertainty_ns: MS };
        assert_eq!(found, Some(want));
        monitor.on_sent(40 * MS, b"MD0180018201000\n");
        monitor.on_received(90 * MS, &scan_bytes(request(0), 560));
        let Some(Event::Scan(scan)) = monitor.next_event() else { panic!("no scan") };
        assert_eq!(scan.stamp_ns, 70 * MS + 3_125_000);
    }
}
