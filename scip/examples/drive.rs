//! Drives a scanner for some seconds: `cargo run -p scip --example drive -- /dev/ttyACM0 10`.

use std::time::{Duration, Instant};

use scip::transport::{Address, Received, Transport};
use scip::{Action, Event, Session, SessionSettings, State};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let address: Address = arguments.next().unwrap_or("/dev/ttyACM0".to_owned()).parse()?;
    let seconds = arguments.next().map_or(Ok(10), |seconds| seconds.parse())?;

    let begun = Instant::now();
    let now = || begun.elapsed().as_nanos() as i64;
    let settings = SessionSettings { profile: address.profile(), ..SessionSettings::default() };
    let mut session = Session::new(settings, now())?;
    let mut port: Option<Box<dyn Transport>> = None;
    let mut buffer = [0; 64 * 1024];
    let mut scans = 0;

    while session.state() != State::Stopped {
        if begun.elapsed() > Duration::from_secs(seconds) {
            session.stop(now());
        }
        while let Some(action) = session.next_action() {
            match action {
                Action::Open => match address.open(Duration::from_secs(2)) {
                    Ok(opened) => {
                        port = Some(opened);
                        session.on_opened(now());
                    }
                    Err(error) => {
                        eprintln!("{error}");
                        session.on_closed(now());
                    }
                },
                Action::Send { bytes, .. } => {
                    if port.as_mut().is_some_and(|port| port.write_all(&bytes).is_err()) {
                        port = None;
                        session.on_closed(now());
                    }
                }
                Action::Close => {
                    port = None;
                    session.on_closed(now());
                }
            }
        }
        while let Some(event) = session.next_event() {
            match &event {
                Event::Scan(scan) => {
                    scans = scan.seq + 1;
                    if scan.seq.is_multiple_of(40) {
                        let values = scan.distances_mm.len();
                        let late_ns = scan.first_byte_ns - scan.stamp_ns;
                        println!("{event}: {values} values, {:.3} ms after its stamp", late_ns as f64 / 1e6);
                    }
                }
                other => println!("{:9.3} s: {other}", begun.elapsed().as_secs_f64()),
            }
        }
        let due_ns = session.deadline_ns().map_or(0, |deadline| (deadline - now()).max(0));
        let wait = Duration::from_nanos(due_ns as u64).min(Duration::from_millis(100));
        match port.as_mut().map(|port| port.read(&mut buffer, wait)) {
            Some(Ok(Received::Bytes(count))) => session.on_received(now(), &buffer[..count]),
            Some(Ok(Received::Nothing)) => session.on_time(now()),
            Some(Ok(Received::Closed) | Err(_)) => {
                port = None;
                session.on_closed(now());
            }
            None => {
                std::thread::sleep(wait);
                session.on_time(now());
            }
        }
    }
    println!("{scans} scans");
    Ok(())
}
