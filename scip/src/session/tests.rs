//! A session against a scripted device, in time that is only counted.

use std::collections::VecDeque;

use super::*;
use crate::number;
use crate::reply::{Body, Echo, Reply, ScanData};
use crate::request::{ScanKind, ScanRequest};
use crate::scan::Scan;

const MS: i64 = 1_000_000;
const SECOND: i64 = 1_000_000_000;

const VV: &str = "VEND:Hokuyo Automatic Co.,Ltd.;[\nPROD:SOKUIKI Sensor TOP-URG UTM-30LX;P\n\
    FIRM:P.1.05(17/Apr./2009);M\nPROT:SCIP 2.0;N\nSERI:00903971;:\n";
const PP: &str = "MODL:UTM-30LX(Hokuyo Automatic Co.,Ltd.);U\nDMIN:23;7\nDMAX:60000;J\nARES:1440;^\nAMIN:0;?\n\
    AMAX:1080;Z\nAFRT:540;0\nSCAN:2400;U\n";

/// What is wrong with the device. Times are counted from the start of the test.
#[derive(Default)]
struct Faults {
    /// QT is ignored this often.
    deaf_to_quit: u32,
    time_mode: bool,
    scip1: bool,
    time_mode_from_ns: i64,
    laser_from_ns: i64,
    silent: bool,
    stuck_stamps: bool,
    says_unhealthy: u32,
    lost_acknowledgement: bool,
    /// TM1 is ignored this often.
    deaf_to_clock: u32,
    needs_reboot: bool,
}

struct Device {
    faults: Faults,
    /// Host's time at the device's clock 0.
    zero_ns: i64,
    stream: Option<(ScanRequest, i64)>,
    line: Vec<u8>,
    requests: Vec<String>,
}

impl Device {
    fn new(faults: Faults) -> Device {
        Device { faults, zero_ns: -5_000 * SECOND, stream: None, line: Vec::new(), requests: Vec::new() }
    }

    fn stamp(&self, now_ns: i64) -> u32 {
        (((now_ns - self.zero_ns) / MS) & 0xff_ffff) as u32
    }

    fn on_bytes(&mut self, now_ns: i64, bytes: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        for &byte in bytes {
            if byte != b'\n' {
                self.line.push(byte);
            } else if !self.line.is_empty() {
                let line = String::from_utf8(std::mem::take(&mut self.line)).unwrap();
                self.requests.push(line.clone());
                let answer = self.answer(now_ns, &line);
                if !answer.is_empty() && !self.faults.silent {
                    out.extend_from_slice(format!("{line}\n{answer}\n").as_bytes());
                }
            }
        }
        out
    }

    /// Status and data lines, or nothing.
    fn answer(&mut self, now_ns: i64, line: &str) -> String {
        let faults = &mut self.faults;
        if faults.scip1 {
            faults.scip1 = line != "SCIP2.0";
            return if faults.scip1 { "E\n".into() } else { "0\n".into() };
        }
        if faults.needs_reboot && !line.starts_with("RB") {
            return "0Ll\n".into();
        }
        if faults.time_mode && !line.starts_with("TM") {
            return "0Ee\n".into();
        }
        match line {
            "QT" if faults.deaf_to_quit > 0 => {
                faults.deaf_to_quit -= 1;
                String::new()
            }
            "QT" => {
                self.stream = None;
                "00P\n".into()
            }
            "RS" => {
                self.zero_ns = now_ns;
                "00P\n".into()
            }
            "RB" => {
                let second = self.requests.iter().filter(|request| *request == "RB").count() == 2;
                faults.needs_reboot &= !second;
                if second { "00P\n".into() } else { "01Q\n".into() }
            }
            "VV" => format!("00P\n{VV}"),
            "PP" => format!("00P\n{PP}"),
            "II" => {
                assert!(self.stream.is_none(), "II was sent while scans streamed");
                let ill = faults.says_unhealthy > 0;
                faults.says_unhealthy = faults.says_unhealthy.saturating_sub(1);
                let stat = if ill { "STAT:Laser malfunction." } else { "STAT:Sensor works well." };
                format!("00P\nLASR:OFF;7\n{stat};{}\n", number::checksum(stat.as_bytes()) as char)
            }
            "TM0" if now_ns < faults.time_mode_from_ns => "01Q\n".into(),
            "TM0" => {
                faults.time_mode = true;
                "00P\n".into()
            }
            "TM1" if faults.deaf_to_clock > 0 => {
                faults.deaf_to_clock -= 1;
                String::new()
            }
            "TM1" => {
                let mut time = Vec::new();
                number::encode(self.stamp(now_ns), 4, &mut time);
                time.push(number::checksum(&time));
                format!("00P\n{}\n", String::from_utf8(time).unwrap())
            }
            "TM2" => {
                let status = if faults.time_mode { "00P\n" } else { "03S\n" };
                faults.time_mode = false;
                status.into()
            }
            "BM" if now_ns < faults.laser_from_ns => "01Q\n".into(),
            "BM" => "00P\n".into(),
            _ => {
                let Ok(Request { command: Command::Scan(scan), .. }) = Request::parse(line.as_bytes()) else {
                    return "0Ee\n".into();
                };
                self.stream = Some((scan, now_ns + 25 * MS));
                if std::mem::take(&mut faults.lost_acknowledgement) { String::new() } else { "00P\n".into() }
            }
        }
    }

    /// Bytes of the scan that is due: sent 23 ms after its stamp.
    fn scan_due(&mut self, now_ns: i64) -> Vec<u8> {
        let stamp_ms = if self.faults.stuck_stamps { 777 } else { self.stamp(now_ns - 23 * MS) };
        let Some((request, next_ns)) = &mut self.stream else { return Vec::new() };
        *next_ns += 25 * MS;
        let steps = usize::from(request.end - request.start) + 1;
        let distances_mm = vec![1000; steps];
        let intensities = if request.kind.has_intensity() { vec![262_143; steps] } else { Vec::new() };
        let body = Body::Scan(ScanData { stamp_ms, distances_mm, intensities, more_echoes: Vec::new() });
        let echo = Echo::Request(Command::Scan(*request).into());
        let mut bytes = Vec::new();
        Reply { echo, status: Status::ScanFollows, body }.emit(&mut bytes);
        if self.faults.silent { Vec::new() } else { bytes }
    }
}

/// What crossed the wire, for a replay.
enum Traffic {
    Gap,
    Sent(i64, Vec<u8>),
    Received(i64, Vec<u8>),
}

struct Bench {
    now_ns: i64,
    session: Session,
    device: Device,
    on_wire: VecDeque<(i64, Vec<u8>)>,
    is_open: bool,
    opened: u32,
    traffic: Vec<Traffic>,
    events: Vec<SessionEvent>,
    scans: Vec<Scan>,
    strays: usize,
}

impl Bench {
    fn new(settings: SessionSettings, faults: Faults) -> Bench {
        Bench {
            now_ns: 0,
            session: Session::new(settings, 0).unwrap(),
            device: Device::new(faults),
            on_wire: VecDeque::new(),
            is_open: false,
            opened: 0,
            traffic: Vec::new(),
            events: Vec::new(),
            scans: Vec::new(),
            strays: 0,
        }
    }

    fn usb(faults: Faults) -> Bench {
        Bench::new(SessionSettings::default(), faults)
    }

    fn receive(&mut self, bytes: Vec<u8>) {
        self.session.on_received(self.now_ns, &bytes);
        self.traffic.push(Traffic::Received(self.now_ns, bytes));
        self.settle();
    }

    /// Carries out what the session wants.
    fn settle(&mut self) {
        while let Some(action) = self.session.next_action() {
            match action {
                Action::Open => {
                    self.is_open = true;
                    self.opened += 1;
                    self.traffic.push(Traffic::Gap);
                    self.session.on_opened(self.now_ns);
                }
                Action::Send { at_ns, bytes } => {
                    assert!(self.is_open, "sent to a closed port");
                    let answer = self.device.on_bytes(self.now_ns, &bytes);
                    self.traffic.push(Traffic::Sent(at_ns, bytes));
                    if !answer.is_empty() {
                        self.on_wire.push_back((self.now_ns + MS, answer));
                    }
                }
                Action::Close => {
                    self.is_open = false;
                    self.on_wire.clear();
                    self.session.on_closed(self.now_ns);
                }
            }
        }
        while let Some(event) = self.session.next_event() {
            match event {
                Event::Scan(scan) => self.scans.push(scan),
                Event::StrayScan(_) => self.strays += 1,
                Event::Session(event) => self.events.push(event),
                _ => {}
            }
        }
    }

    fn run_until(&mut self, end_ns: i64) {
        self.settle();
        loop {
            let scan_ns = self.device.stream.filter(|_| self.is_open).map(|(_, next_ns)| next_ns);
            let reply_ns = self.on_wire.front().map(|(at, _)| *at);
            let times = [scan_ns, reply_ns, self.session.deadline_ns()];
            let next_ns = times.into_iter().flatten().min().unwrap_or(i64::MAX);
            if next_ns > end_ns {
                self.now_ns = end_ns;
                return;
            }
            self.now_ns = self.now_ns.max(next_ns);
            if reply_ns == Some(next_ns) {
                let (_, bytes) = self.on_wire.pop_front().unwrap();
                self.receive(bytes);
            } else if scan_ns == Some(next_ns) {
                let bytes = self.device.scan_due(self.now_ns);
                self.receive(bytes);
            } else {
                self.session.on_time(self.now_ns);
                self.settle();
            }
        }
    }

    fn is_streaming(&self) -> bool {
        matches!(self.session.state(), State::Streaming(_))
    }

    fn reported(&self, event: SessionEvent) -> bool {
        self.events.contains(&event)
    }

    fn requests(&self) -> String {
        self.device.requests.join(" ")
    }

    /// A status of the running stream.
    fn stream_status(&mut self, status: &str) {
        self.receive(format!("ME0000108001000\n{status}\n\n").into_bytes());
    }
}

#[test]
fn a_healthy_device() {
    let mut bench = Bench::usb(Faults::default());
    bench.run_until(10 * SECOND);
    let rounds = "TM1 ".repeat(12);
    assert_eq!(bench.requests(), format!("QT RS VV PP II TM0 {rounds}TM2 BM ME0000108001000"));
    assert!(bench.is_streaming());
    let scans = &bench.scans;
    assert!(scans.len() > 380);
    assert!(scans.iter().enumerate().all(|(index, scan)| scan.seq == index as u64));
    assert!(scans.iter().all(|scan| scan.intensities[0] == 262_143));
    for scan in scans {
        let true_ns = bench.device.zero_ns + i64::from(scan.stamp_ms) * MS;
        assert!((scan.stamp_ns - true_ns).abs() <= MS, "{} against {true_ns}", scan.stamp_ns);
    }
    assert_eq!(bench.session.device().serial_number(), Some("00903971"));
    assert_eq!(bench.session.device().is_healthy(), Some(true));
}

#[test]
fn a_device_left_streaming_in_another_mode_that_ignores_qt_once() {
    let mut bench = Bench::usb(Faults { deaf_to_quit: 1, ..Faults::default() });
    bench.device.stream = Some((ScanRequest::new(ScanKind::MD, 100, 200), 10 * MS));
    bench.run_until(3 * SECOND);
    assert!(bench.is_streaming());
    assert!(bench.strays > 5);
    assert!(bench.scans.iter().all(|scan| scan.request.kind == ScanKind::ME && scan.seq < 200));
    assert!(bench.requests().starts_with("QT QT RS"));
}

#[test]
fn a_device_left_in_the_time_mode() {
    let mut bench = Bench::usb(Faults { time_mode: true, ..Faults::default() });
    bench.run_until(2 * SECOND);
    assert!(bench.is_streaming());
    assert!(bench.requests().starts_with("QT TM2 QT RS VV"));
    assert!(bench.reported(SessionEvent::LeavingTimeMode));
}

#[test]
fn a_device_in_scip_1_1() {
    let mut bench = Bench::usb(Faults { scip1: true, ..Faults::default() });
    bench.run_until(2 * SECOND);
    assert!(bench.is_streaming());
    assert!(bench.requests().starts_with("QT SCIP2.0 QT RS VV"));
    assert!(bench.reported(SessionEvent::SwitchingFromScip1));
}

#[test]
fn a_laser_that_needs_ten_seconds() {
    let mut bench = Bench::usb(Faults { laser_from_ns: 10 * SECOND, ..Faults::default() });
    bench.run_until(9 * SECOND);
    assert!(!bench.is_streaming());
    bench.run_until(11 * SECOND);
    assert!(bench.is_streaming());
    assert_eq!(bench.opened, 1);
}

#[test]
fn tm0_that_fails_for_seconds_after_the_connection() {
    let settings = SessionSettings { profile: crate::Profile::Ethernet, ..SessionSettings::default() };
    let mut bench = Bench::new(settings, Faults { time_mode_from_ns: 4 * SECOND, ..Faults::default() });
    bench.run_until(6 * SECOND);
    assert!(bench.is_streaming());
    assert!(!bench.reported(SessionEvent::NotSynchronised));

    let mut usb = Bench::usb(Faults { time_mode_from_ns: 4 * SECOND, ..Faults::default() });
    usb.run_until(3 * SECOND);
    assert!(usb.is_streaming() && usb.reported(SessionEvent::NotSynchronised));
    let scan = usb.scans.last().unwrap();
    let true_ns = usb.device.zero_ns + i64::from(scan.stamp_ms) * MS;
    assert!((scan.stamp_ns - true_ns).abs() <= 2 * MS, "the nominal latency serves");
}

#[test]
fn rounds_without_an_answer() {
    let mut some = Bench::usb(Faults { deaf_to_clock: 2, ..Faults::default() });
    some.run_until(3 * SECOND);
    assert!(some.is_streaming() && !some.reported(SessionEvent::NotSynchronised));
    assert_eq!(some.requests().matches("TM1").count(), 12);
    let mut all = Bench::usb(Faults { deaf_to_clock: 99, ..Faults::default() });
    all.run_until(4 * SECOND);
    assert!(all.is_streaming() && all.reported(SessionEvent::NotSynchronised));
    assert!(all.requests().contains("TM1 TM1 TM1 TM1 TM2 BM"));
}

#[test]
fn nobody_there() {
    let mut bench = Bench::usb(Faults { silent: true, ..Faults::default() });
    bench.run_until(120 * SECOND);
    let waits: Vec<i64> = bench
        .events
        .iter()
        .filter_map(|event| match event {
            SessionEvent::Closed { retry_in_ns } => retry_in_ns.map(|ns| ns / MS),
            _ => None,
        })
        .collect();
    assert_eq!(waits[..7], [250, 500, 1000, 2000, 4000, 8000, 10_000]);
    bench.device.faults.silent = false;
    bench.run_until(140 * SECOND);
    assert!(bench.is_streaming());
}

#[test]
fn an_ill_reading_of_the_state_is_verified() {
    let mut once = Bench::usb(Faults { says_unhealthy: 1, ..Faults::default() });
    once.run_until(3 * SECOND);
    assert!(once.is_streaming() && !once.reported(SessionEvent::Unhealthy));
    let mut always = Bench::usb(Faults { says_unhealthy: 99, ..Faults::default() });
    always.run_until(3 * SECOND);
    assert!(always.is_streaming() && always.reported(SessionEvent::Unhealthy));
}

#[test]
fn a_lost_acknowledgement_of_the_stream() {
    let mut bench = Bench::usb(Faults { lost_acknowledgement: true, ..Faults::default() });
    bench.run_until(2 * SECOND);
    assert!(bench.is_streaming());
    assert_eq!(bench.requests().matches("ME").count(), 1);
}

#[test]
fn stop_turns_the_laser_off() {
    let mut bench = Bench::usb(Faults { deaf_to_quit: 0, ..Faults::default() });
    bench.run_until(2 * SECOND);
    bench.device.faults.deaf_to_quit = 1;
    bench.session.stop(bench.now_ns);
    bench.run_until(5 * SECOND);
    assert_eq!(bench.session.state(), State::Stopped);
    assert!(bench.device.stream.is_none() && !bench.is_open);
    assert!(bench.requests().ends_with("ME0000108001000 QT QT"));
    assert_eq!(bench.events.last(), Some(&SessionEvent::Stopped));
}

#[test]
fn stop_takes_no_longer_than_said_whatever_the_device_does() {
    for at_ms in [0, 50, 101, 103, 109, 115, 130, 3000] {
        for silent in [false, true] {
            let mut bench = Bench::usb(Faults::default());
            bench.run_until(at_ms * MS);
            bench.device.faults.silent = silent;
            bench.session.stop(bench.now_ns);
            bench.run_until(at_ms * MS + Patience::default().stop_ns);
            assert_eq!(bench.session.state(), State::Stopped, "stopped at {at_ms} ms, silent {silent}");
            assert!(!bench.is_open && bench.session.deadline_ns().is_none());
            assert!(silent || !bench.device.faults.time_mode);
        }
    }
}

#[test]
fn errors_that_the_device_verifies() {
    let mut bench = Bench::usb(Faults::default());
    bench.run_until(2 * SECOND);
    let stream = bench.device.stream.take();
    bench.stream_status("21S");
    bench.run_until(8 * SECOND);
    assert!(bench.is_streaming(), "the device has ten seconds");
    bench.stream_status("98a");
    bench.device.stream = stream.map(|(request, _)| (request, 8 * SECOND + 25 * MS));
    bench.run_until(10 * SECOND);
    assert!(bench.is_streaming() && bench.reported(SessionEvent::Resumed));
    assert_eq!(bench.requests().matches("QT").count(), 1);

    bench.device.stream = None;
    bench.stream_status("49]");
    bench.run_until(25 * SECOND);
    let trouble = Trouble::VerifyingTooLong(Status::Verifying(49));
    assert!(bench.is_streaming() && bench.reported(SessionEvent::Trouble(trouble)));
    assert_eq!(bench.requests().matches("QT").count(), 2);
}

#[test]
fn a_hardware_fault_and_a_silent_stream_start_again() {
    let mut bench = Bench::usb(Faults::default());
    bench.run_until(2 * SECOND);
    bench.stream_status("50U");
    assert!(bench.reported(SessionEvent::Trouble(Trouble::StreamEnded(Status::Fault(50)))));
    bench.run_until(4 * SECOND);
    assert!(bench.is_streaming());
    bench.device.stream = None;
    bench.run_until(7 * SECOND);
    assert!(bench.reported(SessionEvent::Trouble(Trouble::Silent(SECOND))));
    assert!(bench.is_streaming());
    assert_eq!((bench.opened, bench.requests().matches("RS").count()), (1, 3));
    let steps: Vec<u64> = bench.scans.windows(2).map(|pair| pair[1].seq - pair[0].seq).collect();
    assert_eq!(steps.iter().filter(|&&step| step > 1).count(), 2, "both holes show in the numbers");
    let stamps_rise = bench.scans.windows(2).all(|pair| pair[0].stamp_ns < pair[1].stamp_ns);
    assert!(stamps_rise, "across resets of the clock as well");
}

#[test]
fn stuck_stamps_start_again() {
    let mut bench = Bench::usb(Faults::default());
    bench.run_until(2 * SECOND);
    bench.device.faults.stuck_stamps = true;
    bench.run_until(2 * SECOND + 300 * MS);
    assert!(bench.reported(SessionEvent::Trouble(Trouble::StuckStamps(10))));
    bench.device.faults.stuck_stamps = false;
    bench.run_until(4 * SECOND);
    assert!(bench.is_streaming());
}

#[test]
fn a_device_that_needs_a_reboot() {
    let mut bench = Bench::usb(Faults { needs_reboot: true, ..Faults::default() });
    bench.run_until(2 * SECOND);
    assert!(bench.requests().starts_with("QT RB RB"));
    assert!(bench.reported(SessionEvent::Rebooting));
    assert!(matches!(bench.session.state(), State::Waiting { .. }));
    bench.run_until(6 * SECOND);
    assert!(bench.is_streaming());
    assert_eq!(bench.opened, 2);
}

#[test]
fn a_lost_connection_comes_back_in_the_same_mode() {
    let mut bench = Bench::usb(Faults::default());
    bench.run_until(2 * SECOND);
    bench.is_open = false;
    bench.session.on_closed(bench.now_ns);
    bench.run_until(5 * SECOND);
    assert!(bench.is_streaming());
    assert_eq!(bench.opened, 2);
    assert!(bench.requests().ends_with("ME0000108001000"));
}

#[test]
fn identify_asks_and_ends() {
    let settings = SessionSettings { purpose: Purpose::Identify, ..SessionSettings::default() };
    let mut bench = Bench::new(settings.clone(), Faults::default());
    bench.run_until(2 * SECOND);
    assert_eq!(bench.requests(), "QT VV PP II");
    assert_eq!(bench.session.state(), State::Stopped);
    assert!(bench.reported(SessionEvent::Identified));
    assert_eq!(bench.session.device().product(), Some("SOKUIKI Sensor TOP-URG UTM-30LX"));

    let mut silent = Bench::new(settings, Faults { silent: true, ..Faults::default() });
    silent.run_until(10 * SECOND);
    assert_eq!(silent.session.state(), State::Stopped);
    assert!(!silent.reported(SessionEvent::Identified));
}

#[test]
fn settings_reach_the_request() {
    let half = std::f64::consts::FRAC_PI_2;
    let settings = SessionSettings {
        window: Window::Bearings { min_rad: -half, max_rad: half },
        cluster: 2,
        skip: 1,
        intensity: false,
        text: Some(crate::Text::new(b"left").unwrap()),
        sync_rounds: 0,
        ..SessionSettings::default()
    };
    let mut bench = Bench::new(settings, Faults::default());
    bench.run_until(SECOND);
    assert!(bench.requests().ends_with("II BM MD0180090002100;left"), "{}", bench.requests());
}

#[test]
fn a_monitor_fed_the_same_traffic_sees_the_same_scans() {
    let mut bench = Bench::usb(Faults { deaf_to_quit: 1, ..Faults::default() });
    bench.device.stream = Some((ScanRequest::new(ScanKind::ME, 0, 1080), 10 * MS));
    bench.run_until(12 * SECOND);
    bench.stream_status("50U");
    bench.run_until(20 * SECOND);
    bench.is_open = false;
    bench.session.on_closed(bench.now_ns);
    bench.run_until(30 * SECOND);

    let mut monitor = Monitor::new(SessionSettings::default().monitor);
    let mut scans = Vec::new();
    for traffic in &bench.traffic {
        match traffic {
            Traffic::Gap => monitor.on_gap(),
            Traffic::Sent(at_ns, bytes) => monitor.on_sent(*at_ns, bytes),
            Traffic::Received(at_ns, bytes) => monitor.on_received(*at_ns, bytes),
        }
        scans.extend(std::iter::from_fn(|| monitor.next_event()).filter_map(|event| match event {
            Event::Scan(scan) => Some(scan),
            _ => None,
        }));
    }
    assert!(scans.len() > 1000);
    assert!(scans == bench.scans);
    assert_eq!(monitor.device(), bench.session.device());
}
