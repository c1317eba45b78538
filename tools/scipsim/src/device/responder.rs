//! The device as a state machine: bytes and time come in, bytes with the time at which they leave come out.
//! No port, no thread, no clock: that is [`super::runner`]. Written apart from the crate `scip`, of which it uses only
//! the numbers and sums.
//!
//! Not simulated: SCIP 1.1, the sleep of %SL beyond its state, further echoes of N* and H* (each step has one), and a change
//! of motor speed or bit rate.

use std::collections::VecDeque;

use scip::number::{checksum, encode};

use super::fault::{Faults, Mischief, ScanFault};
use super::profile::{Condition, Profile};
use super::request::{Lines, Refusal, Request, ScanRequest, parse};
use crate::simulation::{BEAMS, DMIN};

/// From the stamp of a scan to its first byte (ns): 23.5 ms in a capture of a UTM-30LX.
const STAMP_TO_DATA_NS: i64 = 23_500_000;
/// From the stamp of a scan to its last beam and a little more (ns): then it can be computed. 18.75 ms at 40 Hz.
const STAMP_TO_MEASURED_NS: i64 = 19_000_000;
/// A device answers within this time where it does not wait for a rotation (ns): 1 ms in a capture.
const PROMPT_NS: i64 = 1_000_000;
/// A second RB must come within this time (ns).
const REBOOT_WINDOW_NS: i64 = 1_000_000_000;
/// A device is silent so long while it boots (ns).
const BOOT_NS: i64 = 2_000_000_000;
/// Bursts of the slow firmware: bytes, and time after the first (ns). A frame takes 47 ms in all.
const SLOW_BURSTS: [(usize, i64); 3] = [(2402, 0), (2376, 23_500_000), (usize::MAX, 47_000_000)];
/// Scans missed while the device verifies an error.
const VERIFY_SCANS: u64 = 40;
/// Lines of data are at most so long, without the sum.
const LINE: usize = 64;

/// Gives what is measured in a rotation.
pub trait ScanSource {
    /// Distances (mm, codes below 23) and intensities of all steps in rotation number `rotation`, counted from the
    /// one of the first scan that was asked for. Intensities may be empty: they are sent as 0.
    fn measure(&mut self, rotation: u64) -> (Vec<u32>, Vec<u32>);
}

/// How a device is set up.
#[derive(Clone, Debug)]
pub struct DeviceSettings {
    /// The model.
    pub profile: Profile,
    /// Serial number in VV.
    pub serial: String,
    /// Time from a rotation to the next (ns): 25 ms for 2400 rpm.
    pub rotation_ns: i64,
    /// Device clock at power-on (ms, 24 bits).
    pub clock_start_ms: u32,
    /// How much faster than the host's clock the device's runs (parts per million).
    pub drift_ppm: f64,
    /// What goes wrong.
    pub faults: Faults,
}

impl Default for DeviceSettings {
    fn default() -> DeviceSettings {
        DeviceSettings {
            profile: Profile::Usb,
            serial: "S0000001".into(),
            rotation_ns: 25_000_000,
            clock_start_ms: 1000,
            drift_ppm: 0.0,
            faults: Faults::default(),
        }
    }
}

/// What the device does.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Output {
    /// Sends these bytes; `is_scan` if they belong to a scan (which may be dropped when the host does not read).
    Bytes {
        /// The bytes.
        bytes: Vec<u8>,
        /// Part of a scan.
        is_scan: bool,
    },
    /// Drops the connection.
    Disconnect,
}

#[derive(Clone, Debug)]
enum State {
    Idle,
    LaserOn,
    Streaming(Stream),
    TimeMode,
    Asleep,
}

#[derive(Clone, Debug)]
struct Stream {
    request: ScanRequest,
    /// The request's line without the count and the string, and the string with its `;`.
    head: Vec<u8>,
    tail: Vec<u8>,
    remaining: u32,
    /// Rotation to send next (on the device's count since power-on).
    rotation: u64,
    /// Whether the device has stopped to verify an error.
    is_verifying: bool,
}

#[derive(Clone, Debug)]
struct Leaving {
    at_ns: i64,
    output: Output,
    /// Goes on with a frame of which a burst has left or will leave before.
    continues: bool,
    /// For refusing the repeat of a request that is still to be answered.
    command: Option<[u8; 2]>,
}

/// A simulated device.
#[derive(Debug)]
pub struct Responder<S> {
    settings: DeviceSettings,
    source: S,
    mischief: Mischief,
    lines: Lines,
    state: State,
    leaving: VecDeque<Leaving>,
    /// Power-on: rotations and the device clock count from here (ns).
    power_on_ns: i64,
    /// Last reset of the device clock (ns), and its value then (ms).
    clock_set: (i64, u32),
    reboot_asked_ns: Option<i64>,
    asleep_until_ns: i64,
    /// Rotation of the first scan ever asked for: the drive begins with it.
    first_rotation: Option<u64>,
}

impl<S: ScanSource> Responder<S> {
    /// A device switched on at `now_ns`.
    pub fn new(settings: DeviceSettings, source: S, now_ns: i64) -> Responder<S> {
        Responder {
            mischief: Mischief::new(settings.faults),
            clock_set: (now_ns, settings.clock_start_ms),
            settings,
            source,
            lines: Lines::default(),
            state: State::Idle,
            leaving: VecDeque::new(),
            power_on_ns: now_ns,
            reboot_asked_ns: None,
            asleep_until_ns: i64::MIN,
            first_rotation: None,
        }
    }

    /// Takes bytes from the host.
    pub fn on_received(&mut self, now_ns: i64, bytes: &[u8]) {
        self.on_time(now_ns);
        for &byte in bytes {
            match self.lines.push(byte) {
                _ if now_ns < self.asleep_until_ns => {}
                None => {}
                Some(Err(line)) => self.reply(now_ns, &line, b"0D", &[]),
                Some(Ok(line)) => self.on_line(now_ns, &line),
            }
        }
    }

    /// The host has gone. A device on Ethernet ends its session; one on USB does not notice.
    pub fn on_disconnected(&mut self) {
        self.lines.clear();
        if self.settings.profile == Profile::Ethernet {
            self.leaving.clear();
            if !matches!(self.state, State::Asleep) {
                self.state = State::Idle;
            }
        }
    }

    /// Lets time pass: scans that have been measured by now are made ready.
    pub fn on_time(&mut self, now_ns: i64) {
        while let State::Streaming(stream) = &self.state {
            let rotation = stream.rotation;
            if self.rotation_start(rotation) + STAMP_TO_MEASURED_NS > now_ns {
                return;
            }
            self.send_scan(rotation);
        }
    }

    /// What leaves at or before `now_ns`, one after the other.
    pub fn next_output(&mut self, now_ns: i64) -> Option<Output> {
        if self.leaving.front()?.at_ns > now_ns {
            return None;
        }
        self.leaving.pop_front().map(|l| l.output)
    }

    /// When to call [`Responder::on_time`] or [`Responder::next_output`] next.
    pub fn deadline_ns(&self) -> Option<i64> {
        let leaving = self.leaving.front().map(|l| l.at_ns);
        let measured = match &self.state {
            State::Streaming(s) => Some(self.rotation_start(s.rotation) + STAMP_TO_MEASURED_NS),
            _ => None,
        };
        leaving.into_iter().chain(measured).min()
    }

    /// When the drive began: start of the first scan that was asked for (ns).
    pub fn drive_start_ns(&self) -> Option<i64> {
        self.first_rotation.map(|r| self.rotation_start(r))
    }

    /// Device clock at a time (ms, 24 bits).
    pub fn clock_ms(&self, now_ns: i64) -> u32 {
        let (set_ns, set_ms) = self.clock_set;
        let passed = (now_ns - set_ns) as f64 * self.pace() / 1e6;
        ((i64::from(set_ms) + (passed + 1e-6).floor() as i64) & 0xff_ffff) as u32
    }

    /// Seconds of the device's clock in a second of the host's.
    fn pace(&self) -> f64 {
        1.0 + self.settings.drift_ppm * 1e-6
    }

    /// Start of a rotation (ns). The motor follows the device's clock.
    fn rotation_start(&self, rotation: u64) -> i64 {
        let device_ns = rotation as f64 * self.settings.rotation_ns as f64;
        self.power_on_ns + (device_ns / self.pace()).round() as i64
    }

    /// First rotation that starts at or after a time.
    fn rotation_from(&self, now_ns: i64) -> u64 {
        let device_ns = (now_ns - self.power_on_ns) as f64 * self.pace();
        let mut rotation = (device_ns / self.settings.rotation_ns as f64).floor().max(0.0) as u64;
        while self.rotation_start(rotation) < now_ns {
            rotation += 1;
        }
        rotation
    }

    fn on_line(&mut self, now_ns: i64, line: &[u8]) {
        if self.mischief.is_silent() {
            return;
        }
        let name = [line[0], line.get(1).copied().unwrap_or(0)];
        if self.leaving.iter().any(|l| l.command == Some(name)) {
            return self.reply(now_ns, line, b"0B", &[]);
        }
        let request = match parse(line) {
            Ok(request) => request,
            Err(status) => return self.reply(now_ns, line, status, &[]),
        };
        if let Some(refusal) = self.refusal(&request) {
            return self.reply(now_ns, line, refusal, &[]);
        }
        self.carry_out(now_ns, line, request);
    }

    /// Whether the present state forbids a request.
    fn refusal(&self, request: &Request) -> Option<Refusal> {
        let ethernet = self.settings.profile == Profile::Ethernet;
        let time_mode = matches!(self.state, State::TimeMode);
        match request {
            Request::State | Request::Sleep if !ethernet => Some(b"0E"),
            Request::BitRate | Request::Sensitivity if ethernet => Some(b"0E"),
            Request::Scan(scan) if scan.multi_echo && !ethernet => Some(b"0E"),
            Request::LaserOn | Request::Quit | Request::Scan(_) | Request::Sleep if time_mode => {
                Some(if ethernet { b"10" } else { b"0E" })
            }
            Request::Scan(scan) if !scan.stream && !matches!(self.state, State::LaserOn) => Some(b"10"),
            _ => None,
        }
    }

    fn carry_out(&mut self, now_ns: i64, line: &[u8], request: Request) {
        let rpm = (60_000_000_000 / self.settings.rotation_ns) as u32;
        let profile = self.settings.profile;
        match request {
            Request::Version => {
                let lines = profile.version(&self.settings.serial);
                self.reply_lines(now_ns, line, &lines);
            }
            Request::Parameters => self.reply_lines(now_ns, line, &profile.parameters(rpm)),
            Request::Information => {
                let at_ns = self.answer_time(now_ns);
                let condition = Condition {
                    laser: matches!(self.state, State::LaserOn | State::Streaming(_)),
                    streaming: matches!(self.state, State::Streaming(_)),
                    clock_ms: self.clock_ms(at_ns),
                };
                self.reply_lines(now_ns, line, &profile.information(rpm, condition));
            }
            Request::LaserOn => {
                if matches!(self.state, State::LaserOn | State::Streaming(_)) {
                    return self.reply(now_ns, line, b"02", &[]);
                }
                self.state = State::LaserOn;
                self.reply(now_ns, line, b"00", &[]);
            }
            Request::Quit => {
                self.reply(now_ns, line, b"00", &[]);
                self.stop(State::Idle);
            }
            Request::Reset => {
                self.reply(now_ns, line, b"00", &[]);
                self.stop(State::Idle);
                self.clock_set = (now_ns, 0);
            }
            Request::Reboot => self.reboot(now_ns, line),
            Request::Time(code) => self.time_mode(now_ns, line, code),
            // A bit rate means nothing on USB: 03, not for this interface. CR: 04 in a capture of a UTM-30LX.
            Request::BitRate => self.reply(now_ns, line, b"03", &[]),
            Request::MotorSpeed => self.reply(now_ns, line, b"04", &[]),
            Request::Sensitivity => self.reply(now_ns, line, b"00", &[]),
            Request::Scip2 => self.reply(now_ns, line, b"0E", &[]),
            Request::State => {
                let code: &[u8] = match self.state {
                    State::Idle => b"000",
                    State::TimeMode => b"002",
                    State::LaserOn => b"003",
                    State::Streaming(_) => b"004",
                    State::Asleep => b"005",
                };
                self.reply(now_ns, line, b"00", &summed(code));
            }
            Request::Sleep => {
                self.reply(now_ns, line, b"00", &[]);
                self.stop(State::Asleep);
            }
            Request::Scan(scan) if scan.stream => self.start_stream(now_ns, line, scan),
            Request::Scan(scan) => self.single_scan(now_ns, line, &scan),
        }
    }

    fn time_mode(&mut self, now_ns: i64, line: &[u8], code: u8) {
        let is_in = matches!(self.state, State::TimeMode);
        match (code, is_in) {
            (b'0', true) => self.reply(now_ns, line, b"02", &[]),
            (b'0', false) => {
                self.reply(now_ns, line, b"00", &[]);
                self.stop(State::TimeMode);
            }
            (b'1', true) => {
                let stamp = stamp(self.clock_ms(self.answer_time(now_ns)));
                self.reply(now_ns, line, b"00", &stamp);
            }
            (b'1', false) => self.reply(now_ns, line, b"04", &[]),
            (b'2', true) => {
                self.reply(now_ns, line, b"00", &[]);
                self.state = State::Idle;
            }
            (b'2', false) => self.reply(now_ns, line, b"03", &[]),
            _ => self.reply(now_ns, line, b"01", &[]),
        }
    }

    fn reboot(&mut self, now_ns: i64, line: &[u8]) {
        match self.reboot_asked_ns.take() {
            Some(asked) if now_ns - asked <= REBOOT_WINDOW_NS => {
                self.reply(now_ns, line, b"00", &[]);
                self.stop(State::Idle);
                let at_ns = self.answer_time(now_ns);
                self.leave(at_ns, Output::Disconnect, None);
                self.asleep_until_ns = at_ns + BOOT_NS;
                self.clock_set = (self.asleep_until_ns, 0);
            }
            _ => {
                self.reboot_asked_ns = Some(now_ns);
                self.reply(now_ns, line, b"01", &[]);
            }
        }
    }

    fn start_stream(&mut self, now_ns: i64, line: &[u8], request: ScanRequest) {
        self.stop(State::LaserOn);
        self.reply(now_ns, line, b"00", &[]);
        let acknowledged_ns = self.leaving.back().map_or(now_ns, |l| l.at_ns);
        let rotation = self.rotation_from(acknowledged_ns);
        self.first_rotation.get_or_insert(rotation);
        let (head, tail) = line.split_at(line.iter().position(|&b| b == b';').unwrap_or(line.len()));
        self.state = State::Streaming(Stream {
            head: head[..head.len() - 2].to_vec(),
            tail: tail.to_vec(),
            remaining: request.count,
            rotation,
            is_verifying: false,
            request,
        });
    }

    fn single_scan(&mut self, now_ns: i64, line: &[u8], request: &ScanRequest) {
        let rotation = self.rotation_from(now_ns);
        self.first_rotation.get_or_insert(rotation);
        let at_ns = self.rotation_start(rotation) + STAMP_TO_DATA_NS;
        let mut bytes = opening(line, b"00");
        self.append_scan(rotation, request, &mut bytes);
        let bytes = self.mischief.spoil(bytes);
        self.leave(at_ns, Output::Bytes { bytes, is_scan: true }, Some([line[0], line[1]]));
    }

    /// Sends the scan of a rotation of the running stream, or what befalls it, and moves on to the next.
    fn send_scan(&mut self, rotation: u64) {
        let State::Streaming(stream) = &mut self.state else { return };
        let mut next = rotation + 1 + stream.request.skip;
        if stream.remaining > 0 {
            stream.remaining -= 1;
        }
        let is_last = stream.request.count > 0 && stream.remaining == 0;
        let mut echo = stream.head.clone();
        echo.extend(format!("{:02}", stream.remaining).bytes());
        echo.extend(&stream.tail);
        let request = stream.request.clone();
        let resumes = std::mem::take(&mut stream.is_verifying);
        let fault = if resumes { None } else { self.mischief.on_scan() };
        let at_ns = self.rotation_start(rotation) + STAMP_TO_DATA_NS;
        let closed = |status: Refusal| {
            let mut bytes = opening(&echo, status);
            bytes.push(b'\n');
            Output::Bytes { bytes, is_scan: true }
        };
        match fault {
            Some(ScanFault::Skipped) => {}
            Some(ScanFault::Disconnect) => self.leave(at_ns, Output::Disconnect, None),
            Some(ScanFault::Unstable) => self.leave(at_ns, closed(b"0M"), None),
            Some(ScanFault::Stopped) => {
                self.leave(at_ns, closed(b"21"), None);
                next = rotation + VERIFY_SCANS;
            }
            None if resumes => self.leave(at_ns, closed(b"98"), None),
            None => {
                let mut bytes = opening(&echo, b"99");
                self.append_scan(rotation, &request, &mut bytes);
                let end_ns = self.send_frame(at_ns, bytes);
                while self.rotation_start(next) + STAMP_TO_DATA_NS < end_ns {
                    next += 1 + request.skip;
                }
            }
        }
        if is_last {
            self.state = State::LaserOn;
        } else if let State::Streaming(stream) = &mut self.state {
            stream.rotation = next;
            stream.is_verifying = fault == Some(ScanFault::Stopped);
        }
    }

    /// Lets a frame leave, whole or in the bursts of the slow firmware; gives the time of its end.
    fn send_frame(&mut self, at_ns: i64, bytes: Vec<u8>) -> i64 {
        let bytes = self.mischief.spoil(bytes);
        let whole_frame = SLOW_BURSTS[0].0 + SLOW_BURSTS[1].0;
        if !self.mischief.is_slow() || bytes.len() < whole_frame {
            self.leave(at_ns, Output::Bytes { bytes, is_scan: true }, None);
            return at_ns;
        }
        let mut rest = &bytes[..];
        for (size, delay) in SLOW_BURSTS {
            let (burst, after) = rest.split_at(size.min(rest.len()));
            let output = Output::Bytes { bytes: burst.to_vec(), is_scan: true };
            self.leaving.push_back(Leaving {
                at_ns: at_ns + delay,
                output,
                continues: delay > 0,
                command: None,
            });
            rest = after;
        }
        at_ns + SLOW_BURSTS[2].1
    }

    /// Stamp, data and the empty line of a scan.
    fn append_scan(&mut self, rotation: u64, request: &ScanRequest, bytes: &mut Vec<u8>) {
        let first = self.first_rotation.unwrap_or(rotation);
        let (distances, intensities) = self.source.measure(rotation - first);
        bytes.extend(stamp(self.clock_ms(self.rotation_start(rotation))));
        let data = encoded(request, &distances, &intensities);
        for line in data.chunks(LINE) {
            bytes.extend(summed(line));
        }
        bytes.push(b'\n');
    }

    /// Ends a stream: scans that have not begun to leave never will, one that has is finished.
    fn stop(&mut self, state: State) {
        self.state = state;
        let mut in_begun_frame = true;
        self.leaving.retain(|l| {
            let is_scan = matches!(l.output, Output::Bytes { is_scan: true, .. });
            in_begun_frame &= !is_scan || l.continues;
            !is_scan || in_begun_frame
        });
    }

    /// When an answer to what is asked at `now_ns` leaves.
    fn answer_time(&self, now_ns: i64) -> i64 {
        let on_rotation = self.settings.profile == Profile::Usb
            && matches!(self.state, State::LaserOn | State::Streaming(_));
        if on_rotation {
            self.rotation_start(self.rotation_from(now_ns + PROMPT_NS))
        } else {
            now_ns + PROMPT_NS
        }
    }

    fn reply_lines(&mut self, now_ns: i64, line: &[u8], lines: &[String]) {
        let mut body = Vec::new();
        for text in lines {
            body.extend(text.bytes());
            body.extend([b';', checksum(text.as_bytes()), b'\n']);
        }
        self.reply(now_ns, line, b"00", &body);
    }

    /// Answers a line.
    fn reply(&mut self, now_ns: i64, line: &[u8], status: Refusal, body: &[u8]) {
        let mut bytes = opening(line, status);
        bytes.extend(body);
        bytes.push(b'\n');
        let bytes = self.mischief.spoil(bytes);
        let name = [line[0], line.get(1).copied().unwrap_or(0)];
        let at_ns = self.answer_time(now_ns);
        self.leave(at_ns, Output::Bytes { bytes, is_scan: false }, Some(name));
    }

    /// Queues an output behind those before it.
    fn leave(&mut self, at_ns: i64, output: Output, command: Option<[u8; 2]>) {
        let at_ns = self.leaving.back().map_or(at_ns, |last| last.at_ns.max(at_ns));
        self.leaving.push_back(Leaving { at_ns, output, continues: false, command });
    }
}

/// Echo and status of a reply.
fn opening(line: &[u8], status: Refusal) -> Vec<u8> {
    let mut bytes = line.to_vec();
    bytes.push(b'\n');
    bytes.extend(summed(status));
    bytes
}

/// A line with its sum and LF.
fn summed(line: &[u8]) -> Vec<u8> {
    let mut bytes = line.to_vec();
    bytes.extend([checksum(line), b'\n']);
    bytes
}

fn stamp(clock_ms: u32) -> Vec<u8> {
    let mut chars = Vec::new();
    encode(clock_ms, 4, &mut chars);
    summed(&chars)
}

/// Data characters of a scan: of each group the nearest distance (a code only if there is no distance).
fn encoded(request: &ScanRequest, distances: &[u32], intensities: &[u32]) -> Vec<u8> {
    let most = (1u32 << (6 * request.distance_chars)) - 1;
    let mut data = Vec::new();
    let end = request.end.min(BEAMS - 1).min(distances.len().saturating_sub(1));
    for first in (request.start..=end).step_by(request.cluster) {
        let group = first..=(first + request.cluster - 1).min(end);
        let nearest = group.min_by_key(|&s| (distances[s] < DMIN, distances[s])).unwrap_or(first);
        encode(distances[nearest].min(most), request.distance_chars, &mut data);
        if request.intensity {
            encode(intensities.get(nearest).copied().unwrap_or(0), 3, &mut data);
        }
    }
    data
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    /// Step `s` at `1000 + s` mm, intensity `2000 + s`; step 3 sees nothing.
    struct Ramp;

    impl ScanSource for Ramp {
        fn measure(&mut self, _rotation: u64) -> (Vec<u32>, Vec<u32>) {
            let mut distances: Vec<u32> = (0..1081).map(|s| 1000 + s).collect();
            distances[3] = 1;
            (distances, (0..1081).map(|s| 2000 + s).collect())
        }
    }

    fn device(profile: Profile) -> Responder<Ramp> {
        Responder::new(DeviceSettings { profile, ..Default::default() }, Ramp, 0)
    }

    /// Everything that leaves up to `until_ns`, with its time.
    fn outputs(device: &mut Responder<Ramp>, until_ns: i64) -> Vec<(i64, Output)> {
        let mut all = Vec::new();
        while let Some(at) = device.deadline_ns().filter(|&at| at <= until_ns) {
            device.on_time(at);
            while let Some(output) = device.next_output(at) {
                all.push((at, output));
            }
        }
        all
    }

    /// Sends a line at `now_ns` and joins all that comes within 10 ms (or the next rotation).
    fn ask(device: &mut Responder<Ramp>, now_ns: i64, line: &str) -> String {
        device.on_received(now_ns, format!("{line}\n").as_bytes());
        let mut text = String::new();
        for (_, output) in outputs(device, now_ns + 30 * MS) {
            if let Output::Bytes { bytes, .. } = output {
                text.push_str(std::str::from_utf8(&bytes).unwrap());
            }
        }
        text
    }

    #[test]
    fn answers_to_the_letter() {
        let mut usb = device(Profile::Usb);
        // PP, and II with the laser off, as a UTM-30LX wrote them in a capture.
        assert_eq!(
            ask(&mut usb, 0, "PP"),
            "PP\n00P\nMODL:UTM-30LX(Hokuyo Automatic Co.,Ltd.);U\nDMIN:23;7\nDMAX:60000;J\nARES:1440;^\n\
             AMIN:0;?\nAMAX:1080;Z\nAFRT:540;0\nSCAN:2400;U\n\n"
        );
        let information = ask(&mut usb, 100 * MS, "II;a b");
        assert!(information.starts_with("II;a b\n00P\nMODL:UTM-30LX(Hokuyo Automatic Co.,Ltd.);U\n"));
        assert!(information.contains("LASR:OFF;7\nSCSP:Initial(2400[rpm])<-Default setting by user;1\n"));
        assert!(
            information.contains("TIME:00044D;") && information.ends_with("STAT:Sensor works well.;8\n\n")
        );
        for (i, (line, answer)) in [
            ("BM", "BM\n00P\n\n"),
            ("BM", "BM\n02R\n\n"),
            ("CR00", "CR00\n04T\n\n"),
            ("QT", "QT\n00P\n\n"),
            ("ZZ", "ZZ\n0Ee\n\n"),
            ("GD0000108000", "GD0000108000\n10Q\n\n"),
            ("SCIP2.0", "SCIP2.0\n0Ee\n\n"),
            ("TM2", "TM2\n03S\n\n"),
            ("TM1", "TM1\n04T\n\n"),
            ("TM0", "TM0\n00P\n\n"),
            ("TM0", "TM0\n02R\n\n"),
            ("QT", "QT\n0Ee\n\n"),
            ("TM2", "TM2\n00P\n\n"),
            ("RB", "RB\n01Q\n\n"),
            ("%ST", "%ST\n0Ee\n\n"),
        ]
        .into_iter()
        .enumerate()
        {
            assert_eq!(ask(&mut usb, (i as i64 * 2000 + 1000) * MS, line), answer, "{line}");
        }
        let mut ethernet = device(Profile::Ethernet);
        assert_eq!(ask(&mut ethernet, 0, "%ST"), "%ST\n00P\n000@\n\n");
        assert!(ask(&mut ethernet, 50 * MS, "II").contains("TIME:00@K;"));
        ask(&mut ethernet, 100 * MS, "TM0");
        assert_eq!(ask(&mut ethernet, 150 * MS, "QT"), "QT\n10Q\n\n");
        // 1000 ms at the start, 200 since, 1 until the answer.
        assert_eq!(ask(&mut ethernet, 200 * MS, "TM1"), "TM1\n00P\n00Ba3\n\n");
    }

    #[test]
    fn a_stream_counts_down_and_scans_come_23_5_ms_after_their_stamp() {
        let mut usb = device(Profile::Usb);
        usb.on_received(3 * MS, b"ME0000000500102;t\n");
        let all = outputs(&mut usb, 1000 * MS);
        let text = |i: usize| match &all[i].1 {
            Output::Bytes { bytes, .. } => String::from_utf8(bytes.clone()).unwrap(),
            Output::Disconnect => String::new(),
        };
        assert_eq!(all.len(), 3);
        assert_eq!(text(0), "ME0000000500102;t\n00P\n\n");
        // The rotation that starts at 25 ms; the laser was on when the request was answered.
        assert_eq!(usb.drive_start_ns(), Some(25 * MS));
        assert_eq!(all[1].0, 25 * MS + 23_500_000);
        assert_eq!(text(1), "ME0000000500101;t\n99b\n00@1A\n0?X0O@0?Y0OA0?Z0OB0010OC0?\\0OD0?]0OE9\n\n");
        // One scan is left out between them.
        assert!(text(2).starts_with("ME0000000500100;t\n99b\n00@c3\n"));
        assert_eq!(ask(&mut usb, 2000 * MS, "BM"), "BM\n02R\n\n");
    }

    #[test]
    fn windows_clusters_and_short_distances() {
        let mut usb = device(Profile::Usb);
        ask(&mut usb, 0, "BM");
        usb.on_received(50 * MS, b"GS0002000602\r\n");
        let all = outputs(&mut usb, 200 * MS);
        // Steps 2..6 in pairs: 1002 (3 sees nothing), 1004, and the partial group 1006.
        let Output::Bytes { bytes, .. } = &all[0].1 else { panic!() };
        let text = std::str::from_utf8(bytes).unwrap();
        assert!(text.starts_with("GS0002000602\n00P\n") && text.ends_with("\n?Z?\\?^A\n\n"), "{text}");
    }

    #[test]
    fn a_full_frame_has_the_size_of_a_real_one_and_the_clock_wraps() {
        let settings = DeviceSettings { clock_start_ms: 0xff_fff0, ..Default::default() };
        let mut usb = Responder::new(settings, Ramp, 0);
        usb.on_received(0, b"ME0000108001001\n");
        let all = outputs(&mut usb, 100 * MS);
        let Output::Bytes { bytes, .. } = &all[1].1 else { panic!() };
        assert_eq!(bytes.len(), 6717);
        // 0xfffff0 + 25 ms has wrapped to 9.
        assert_eq!(&bytes[20..26], b"00099\n");
    }

    #[test]
    fn qt_ends_an_endless_stream_and_resets_forget_the_clock() {
        let mut usb = device(Profile::Usb);
        usb.on_received(0, b"\nMD0000108000000\n");
        assert_eq!(outputs(&mut usb, 510 * MS).len(), 1 + 19);
        let text = ask(&mut usb, 511 * MS, "QT");
        assert_eq!(text, "QT\n00P\n\n");
        assert_eq!(usb.deadline_ns(), None);
        ask(&mut usb, 2000 * MS, "RS");
        assert_eq!(usb.clock_ms(2005 * MS), 5);
    }

    #[test]
    fn pipelined_requests_are_answered_in_order_and_a_repeat_is_refused() {
        let mut usb = device(Profile::Usb);
        usb.on_received(0, b"PP\nVV\nVV\n");
        let all = outputs(&mut usb, 50 * MS);
        let starts: Vec<&[u8]> = all
            .iter()
            .map(|(_, o)| match o {
                Output::Bytes { bytes, .. } => &bytes[..6],
                Output::Disconnect => b"",
            })
            .collect();
        assert_eq!(starts, [b"PP\n00P".as_slice(), b"VV\n00P", b"VV\n0Bb"]);
    }

    #[test]
    fn faults_follow_their_seed() {
        let run = |faults: Faults| {
            let settings = DeviceSettings { faults, ..Default::default() };
            let mut usb = Responder::new(settings, Ramp, 0);
            usb.on_received(0, b"MD0000108000000\n");
            outputs(&mut usb, 5000 * MS)
        };
        let clean = run(Faults::default());
        let all = Faults {
            seed: 5,
            bad_sum: 0.1,
            garbage: 0.1,
            cut: 0.1,
            error_status: 0.02,
            disconnect: 0.02,
            skip_scan: 0.1,
            ..Default::default()
        };
        assert_eq!(run(all), run(all));
        assert_ne!(run(all), run(Faults { seed: 6, ..all }));
        assert!(run(all).len() < clean.len());
        assert!(run(Faults { silence: 1.0, ..Default::default() }).is_empty());
    }

    #[test]
    fn slow_firmware_needs_47_ms_a_frame_and_sends_every_second_scan() {
        let faults = Faults { slow_firmware: true, ..Default::default() };
        let mut usb = Responder::new(DeviceSettings { faults, ..Default::default() }, Ramp, 0);
        usb.on_received(0, b"ME0000108001000\n");
        let all = outputs(&mut usb, 1000 * MS);
        let sizes: Vec<usize> = all[1..4]
            .iter()
            .map(|(_, o)| match o {
                Output::Bytes { bytes, .. } => bytes.len(),
                Output::Disconnect => 0,
            })
            .collect();
        assert_eq!(sizes, [2402, 2376, 1939]);
        assert_eq!(all[3].0 - all[1].0, 47 * MS);
        assert_eq!(all[4].0 - all[1].0, 50 * MS);
        // A frame that has begun is finished before QT is answered: 48.5 + 50 k, and 23.5 and 47 ms after it.
        usb.on_received(1005 * MS, b"QT\n");
        let ends: Vec<usize> = outputs(&mut usb, 2000 * MS)
            .iter()
            .map(|(_, o)| match o {
                Output::Bytes { bytes, .. } => bytes.len(),
                Output::Disconnect => 0,
            })
            .collect();
        assert_eq!(ends, [2376, 1939, 8]);
    }
}
