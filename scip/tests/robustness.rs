//! Properties of the decoder: whatever comes, it neither panics nor grows, and finds the next good reply.

use proptest::collection::vec;
use proptest::prelude::*;
use scip::decoder::MAX_REPLY;
use scip::{
    Body, Command, DecodeError, Decoder, Echo, Event, Fields, FurtherEcho, Located, Monitor, MonitorOptions,
    Reply, Request, ScanData, ScanKind, ScanRequest, Session, SessionSettings, Status, Text,
};

fn drain(decoder: &mut Decoder) -> Vec<Result<Located, DecodeError>> {
    std::iter::from_fn(|| decoder.decode_next()).collect()
}

fn decode_in_chunks(bytes: &[u8], cuts: &[usize]) -> Vec<Result<Located, DecodeError>> {
    let mut decoder = Decoder::new();
    let mut outcomes = Vec::new();
    let mut rest = bytes;
    for cut in cuts.iter().cycle() {
        let (chunk, tail) = rest.split_at((*cut).min(rest.len()));
        decoder.push(chunk);
        outcomes.extend(drain(&mut decoder));
        rest = tail;
        if rest.is_empty() {
            break;
        }
    }
    outcomes.extend(decoder.cut().map(Err));
    outcomes
}

fn text() -> impl Strategy<Value = Option<Text>> {
    prop::option::of("[A-Za-z0-9 ._+@]{0,16}".prop_map(|text| Text::new(text.as_bytes()).unwrap()))
}

fn scan_request() -> impl Strategy<Value = ScanRequest> {
    use ScanKind::*;
    let kind = prop::sample::select(vec![MD, MS, ME, ND, NE, GD, GS, GE, HD, HE]);
    (kind, 0u16..9000, 0u16..200, 0u8..100, 0u8..10, 0u8..100).prop_map(
        |(kind, start, steps, cluster, skip, count)| {
            let (skip, count) = if kind.is_stream() { (skip, count) } else { (0, 0) };
            ScanRequest { kind, start, end: start + steps, cluster, skip, count }
        },
    )
}

fn command() -> impl Strategy<Value = Command> {
    prop_oneof![
        prop::sample::select(vec![
            Command::Version,
            Command::Parameters,
            Command::State,
            Command::LaserOn,
            Command::Quit,
            Command::Reset,
            Command::PartialReset,
            Command::Reboot,
            Command::TimeEnter,
            Command::TimeRead,
            Command::TimeLeave,
            Command::Status22,
            Command::Sleep,
            Command::Scip2,
        ]),
        (0u32..1_000_000).prop_map(Command::BitRate),
        (0u8..100).prop_map(Command::MotorSpeed),
        any::<bool>().prop_map(Command::Sensitivity),
        scan_request().prop_map(Command::Scan),
    ]
}

fn request() -> impl Strategy<Value = Request> {
    (command(), text()).prop_map(|(command, text)| Request { command, text })
}

fn scan_data(request: ScanRequest) -> impl Strategy<Value = ScanData> {
    let kind = request.kind;
    let (least, most) = request.value_counts();
    let (distance, intensity): (u32, u32) =
        (1u32 << (6 * kind.distance_chars()), if kind.has_intensity() { 1 << 18 } else { 1 });
    let value = (0..distance, 0..intensity);
    let further = if kind.has_more_echoes() { 0..3usize } else { 0..1 };
    let step = (value.clone(), vec(value, further));
    (0u32..1 << 24, vec(step, least.max(1)..=most.max(1))).prop_map(move |(stamp_ms, steps)| {
        let mut data = ScanData { stamp_ms, ..ScanData::default() };
        for (index, ((distance, intensity), further)) in steps.into_iter().enumerate() {
            data.distances_mm.push(distance);
            if kind.has_intensity() {
                data.intensities.push(intensity);
            }
            data.more_echoes.extend(further.into_iter().map(|(distance_mm, intensity)| FurtherEcho {
                index: index as u32,
                distance_mm,
                intensity,
            }));
        }
        data
    })
}

fn scan_reply() -> impl Strategy<Value = Reply> {
    (scan_request(), text())
        .prop_flat_map(|(request, text)| (Just(request), Just(text), scan_data(request)))
        .prop_map(|(scan, text, data)| Reply {
            echo: Echo::Request(Request { command: Command::Scan(scan), text }),
            status: if scan.kind.is_stream() { Status::ScanFollows } else { Status::Done },
            body: Body::Scan(data),
        })
}

fn reply() -> impl Strategy<Value = Reply> {
    let status = "[0-9][0-9A-M]".prop_map(|code| Status::from_code(code.as_bytes().try_into().unwrap()));
    let line = "[ -~]{0,40}";
    let fields = vec(("[A-Z]{4}", line), 1..9).prop_map(|fields| Body::Fields(Fields::new(fields)));
    let informing = prop::sample::select(vec![Command::Version, Command::Parameters, Command::State]);
    let echo = |command: Command| Echo::Request(command.into());
    prop_oneof![
        (request(), status).prop_map(|(request, status)| Reply {
            echo: Echo::Request(request),
            status,
            body: Body::Empty
        }),
        (0u32..1 << 24).prop_map(move |ms| Reply {
            echo: echo(Command::TimeRead),
            status: Status::Done,
            body: Body::Time(ms)
        }),
        (informing, fields).prop_map(move |(command, body)| Reply {
            echo: echo(command),
            status: Status::Done,
            body
        }),
        scan_reply(),
    ]
}

fn emit(replies: &[Reply]) -> Vec<u8> {
    let mut bytes = Vec::new();
    replies.iter().for_each(|reply| reply.emit(&mut bytes));
    bytes
}

/// Bytes that resemble the protocol more than noise does.
fn likely_bytes() -> impl Strategy<Value = Vec<u8>> {
    let piece = prop_oneof![
        4 => vec(any::<u8>(), 0..80),
        1 => vec(b' '..0x7f, 0..1200),
        2 => Just(b"\n\n".to_vec()),
        2 => Just(b"\n".to_vec()),
        2 => Just(b"00P\n".to_vec()),
        2 => Just(b"99b\n".to_vec()),
        1 => Just(b"0\n".to_vec()),
        2 => Just(b"ME0000108000000\n".to_vec()),
        1 => Just(b"NE0000000100000\n".to_vec()),
        1 => Just(b"TM1\n".to_vec()),
        1 => Just(b"PP\n".to_vec()),
        1 => Just(b"SCIP2.0\n".to_vec()),
        2 => vec(0x30u8..0x70, 64..=64),
        2 => reply().prop_map(|reply| emit(&[reply])),
    ];
    vec(piece, 0..60).prop_map(|pieces| pieces.concat())
}

proptest! {
    #[test]
    fn requests_survive_the_wire(request in request()) {
        prop_assert_eq!(request.check(), Ok(()));
        let bytes = request.to_bytes();
        prop_assert_eq!(Request::parse(bytes.strip_suffix(b"\n").unwrap()), Ok(request));
    }

    #[test]
    fn replies_survive_the_wire(reply in reply()) {
        let outcomes = decode_in_chunks(&emit(std::slice::from_ref(&reply)), &[usize::MAX]);
        prop_assert_eq!(outcomes.len(), 1);
        prop_assert_eq!(&outcomes[0].as_ref().unwrap().reply, &reply);
    }

    #[test]
    fn chunks_make_no_difference(replies in vec(reply(), 1..8), cuts in vec(1usize..300, 1..20)) {
        let bytes = emit(&replies);
        let whole = decode_in_chunks(&bytes, &[usize::MAX]);
        let got: Vec<Reply> = whole.iter().map(|outcome| outcome.as_ref().unwrap().reply.clone()).collect();
        prop_assert_eq!(&got, &replies);
        prop_assert_eq!(decode_in_chunks(&bytes, &cuts), whole);
    }

    #[test]
    fn chunks_make_no_difference_to_garbage(bytes in likely_bytes(), cuts in vec(1usize..300, 1..20)) {
        prop_assert_eq!(decode_in_chunks(&bytes, &cuts), decode_in_chunks(&bytes, &[1]));
    }

    #[test]
    fn every_byte_is_accounted_for_in_order(bytes in likely_bytes(), cuts in vec(1usize..300, 1..20)) {
        let mut at = 0;
        for outcome in decode_in_chunks(&bytes, &cuts) {
            let (from, len) = match outcome {
                Ok(located) => (located.at, located.len),
                Err(error) => (error.at, error.len),
            };
            prop_assert!(from >= at && len > 0);
            // Only empty lines between replies belong to nothing.
            prop_assert!(bytes[at as usize..from as usize].iter().all(|&byte| byte == b'\n'));
            at = from + len;
        }
        prop_assert!(at <= bytes.len() as u64);
        prop_assert!(bytes[at as usize..].iter().all(|&byte| byte == b'\n'));
    }

    #[test]
    fn garbage_before_a_reply_does_not_hide_it(garbage in likely_bytes(), reply in reply()) {
        let mut bytes = garbage;
        bytes.extend_from_slice(b"\n\n");
        bytes.extend(emit(std::slice::from_ref(&reply)));
        let outcomes = decode_in_chunks(&bytes, &[usize::MAX]);
        prop_assert_eq!(&outcomes.last().unwrap().as_ref().unwrap().reply, &reply);
    }

    /// One byte of a stream is changed, lost or doubled: at most the reply that holds it and its neighbour
    /// (whose border it may have been) are lost, and no other reply appears in a scan's place.
    #[test]
    fn a_damaged_byte_costs_little(
        replies in vec(scan_reply(), 3..6), at in any::<prop::sample::Index>(), byte: u8, how in 0..3,
    ) {
        let good = emit(&replies);
        let at = at.index(good.len());
        let mut bytes = good.clone();
        match how {
            0 => bytes[at] = byte,
            1 => drop(bytes.remove(at)),
            _ => bytes.insert(at, byte),
        }
        let got: Vec<Reply> =
            decode_in_chunks(&bytes, &[usize::MAX]).into_iter().flatten().map(|found| found.reply).collect();
        let kept = replies.iter().filter(|reply| got.contains(reply)).count();
        prop_assert!(kept + 2 >= replies.len(), "{} of {}", kept, replies.len());
    }

    #[test]
    fn a_monitor_takes_anything_at_any_time(
        traffic in vec((any::<bool>(), prop_oneof![any::<i64>(), 0i64..1_000_000_000_000], wire_bytes()), 0..30),
    ) {
        let parameters = scip::model::find("UTM-30LX").and_then(scip::Parameters::of_model);
        let mut monitor = Monitor::new(MonitorOptions { parameters, ..MonitorOptions::default() });
        for (is_sent, now_ns, bytes) in traffic {
            if is_sent { monitor.on_sent(now_ns, &bytes) } else { monitor.on_received(now_ns, &bytes) }
        }
        let mut last = None;
        while let Some(event) = monitor.next_event() {
            let _ = event.to_string();
            if let Event::Scan(scan) = event {
                prop_assert!(last.is_none_or(|last| scan.seq > last));
                last = Some(scan.seq);
            }
        }
    }

    #[test]
    fn a_session_takes_anything_at_any_time(
        traffic in vec((0u8..8, prop_oneof![any::<i64>(), 0i64..100_000_000_000], wire_bytes()), 0..60),
    ) {
        let mut session = Session::new(SessionSettings::default(), 0).unwrap();
        for (what, now_ns, bytes) in traffic {
            match what {
                0 => session.on_opened(now_ns),
                1 => session.on_closed(now_ns),
                2 => session.on_time(now_ns),
                3 => session.stop(now_ns),
                _ => session.on_received(now_ns, &bytes),
            }
            while session.next_action().is_some() {}
            while session.next_event().is_some() {}
        }
    }
}

/// Bytes of whole exchanges, and of none.
fn wire_bytes() -> impl Strategy<Value = Vec<u8>> {
    prop_oneof![
        2 => likely_bytes(),
        2 => reply().prop_map(|reply| emit(&[reply])),
        1 => Just(b"TM0\nTM1\nTM1\nTM2\n".to_vec()),
        1 => (0u32..1 << 24).prop_map(|ms| {
            let echo = |command: Command| Echo::Request(command.into());
            let done = |command, body| Reply { echo: echo(command), status: Status::Done, body };
            emit(&[
                done(Command::TimeEnter, Body::Empty),
                done(Command::TimeRead, Body::Time(ms)),
                done(Command::TimeLeave, Body::Empty),
            ])
        }),
        1 => prop::sample::select(vec!["QT", "RS", "VV", "II", "TM0", "BM", "ME0000108001000"])
            .prop_map(|echo| format!("{echo}\n00P\n\n").into_bytes()),
    ]
}

#[test]
fn memory_stays_bounded_without_any_empty_line() {
    let mut decoder = Decoder::new();
    let mut largest = 0;
    let line = b"ME0000108000000\n99b\n".repeat(50);
    for _ in 0..2000 {
        decoder.push(&line);
        drain(&mut decoder);
        largest = largest.max(decoder.offset() - decoder.undecoded_at());
    }
    assert!(largest <= (MAX_REPLY + line.len()) as u64, "{largest} bytes are held");
}
