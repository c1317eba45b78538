//! Runs a device in real time on a pty or a TCP port, and sends its poses. Owns the clock and the threads.
//!
//! The drive begins with the first scan that a client asks for, so that a map does not depend on how long the client took
//! to start. Until then the robot stands at its start, and poses say so; after the drive's end it stands too.
//!
//! When nobody reads: what waits is limited to some scans, as in the buffers between a real device and its host. Then scans
//! are dropped, each as a whole, and answers wait. When a client closes the pty, what was on its way is lost and the device goes on (a
//! device left streaming); when a client closes TCP, the device stops.

use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::Context;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::pty::OpenptFlags;
use rustix::termios::{OptionalActions, QueueSelector, tcflush, tcgetattr, tcsetattr};

use super::options::{SpawnOptions, Transport};
use super::responder::{Output, Responder};
use crate::pose_message::{PoseAddress, PoseSocket, message};
use crate::simulation::Simulation;

/// The runner looks at least this often whether it should stop (ns).
const LONGEST_WAIT_NS: i64 = 20_000_000;
/// How often a closed pty is looked at (ns).
const CLOSED_WAIT: Duration = Duration::from_millis(2);
/// What may wait for a client that does not read (bytes): nine full scans, and as much again for answers.
const MOST_WAITING_SCANS: usize = 1 << 16;
const MOST_WAITING: usize = 2 * MOST_WAITING_SCANS;
/// `drive_start` before the drive.
const NOT_STARTED: i64 = i64::MIN;

/// Where a device can be reached.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Port {
    /// Path of the pty (or of the link to it).
    Pty(PathBuf),
    /// Address of the TCP port.
    Tcp(SocketAddr),
}

impl Port {
    /// The path of a pty.
    pub fn path(&self) -> Option<&Path> {
        match self {
            Port::Pty(path) => Some(path),
            Port::Tcp(_) => None,
        }
    }
}

/// As a device URL: the path, or `tcp://HOST:PORT`.
impl std::fmt::Display for Port {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Port::Pty(path) => write!(f, "{}", path.display()),
            Port::Tcp(address) => write!(f, "tcp://{address}"),
        }
    }
}

#[derive(Debug)]
struct Shared {
    stop: AtomicBool,
    drive_start: AtomicI64,
    dropped: AtomicU64,
}

/// A device at work. Dropping it stops it.
#[derive(Debug)]
pub struct Running {
    port: Port,
    link: Option<PathBuf>,
    duration_ns: i64,
    shared: Arc<Shared>,
    simulation: Arc<Simulation>,
    threads: Vec<JoinHandle<()>>,
}

impl Running {
    /// Where it can be reached.
    pub fn port(&self) -> &Port {
        &self.port
    }

    /// What it simulates.
    pub fn simulation(&self) -> &Simulation {
        &self.simulation
    }

    /// When the drive began (ns, host's monotonic clock), if it has.
    pub fn drive_start_ns(&self) -> Option<i64> {
        Some(self.shared.drive_start.load(Ordering::Relaxed)).filter(|&ns| ns != NOT_STARTED)
    }

    /// Whether the drive has begun and ended.
    pub fn finished(&self) -> bool {
        self.drive_start_ns().is_some_and(|start| now_ns() > start + self.duration_ns)
    }

    /// Scans dropped because nobody read them.
    pub fn dropped(&self) -> u64 {
        self.shared.dropped.load(Ordering::Relaxed)
    }

    /// Stops it and waits until its threads have ended.
    pub fn stop(mut self) {
        self.end();
    }

    fn end(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // A thread that panicked has already said so.
            let _ = thread.join();
        }
        if let Some(link) = self.link.take() {
            let _ = std::fs::remove_file(link);
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.end();
    }
}

/// Now on the host's monotonic clock (ns).
pub fn now_ns() -> i64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    now.tv_sec * 1_000_000_000 + now.tv_nsec
}

/// Starts a device.
///
/// # Errors
/// When the pty, the link, the TCP port or the pose socket cannot be opened.
pub fn spawn(options: SpawnOptions) -> anyhow::Result<Running> {
    let mut simulation_options = options.simulation.clone();
    simulation_options.keep_truth = false;
    let simulation = Arc::new(Simulation::new(&options.world, simulation_options));
    let shared = Arc::new(Shared {
        stop: AtomicBool::new(false),
        drive_start: AtomicI64::new(NOT_STARTED),
        dropped: AtomicU64::new(0),
    });
    let may_disconnect = options.device.faults.disconnect > 0.0;
    let (connection, port, link) = match &options.transport {
        Transport::Pty { link } => {
            let (connection, slave) = open_pty().context("cannot open a pty")?;
            let link = link.clone().or_else(|| may_disconnect.then(own_link));
            if let Some(link) = &link {
                make_link(&slave, link)?;
            }
            (connection, Port::Pty(link.clone().unwrap_or(slave)), link)
        }
        Transport::Tcp(address) => {
            let listener =
                TcpListener::bind(address).with_context(|| format!("cannot listen on {address}"))?;
            listener.set_nonblocking(true)?;
            let port = Port::Tcp(listener.local_addr()?);
            (Connection::Tcp { listener, stream: None }, port, None)
        }
    };
    let device = Responder::new(options.device.clone(), Arc::clone(&simulation), now_ns());
    let mut server =
        Server { device, connection, waiting: Vec::new(), link: link.clone(), shared: Arc::clone(&shared) };
    let mut threads =
        vec![std::thread::Builder::new().name("scipsim-device".into()).spawn(move || server.run())?];
    if let Some(address) = &options.poses_to {
        let poses = PoseSender::open(address, &simulation, &shared, &options)?;
        threads.push(std::thread::Builder::new().name("scipsim-poses".into()).spawn(move || poses.run())?);
    }
    Ok(Running { port, link, duration_ns: simulation.duration_ns(), shared, simulation, threads })
}

/// Makes a link to a pty; one that is there already is replaced.
fn make_link(slave: &Path, link: &Path) -> anyhow::Result<()> {
    if link.symlink_metadata().is_ok_and(|m| m.file_type().is_symlink()) {
        std::fs::remove_file(link).with_context(|| format!("cannot replace {}", link.display()))?;
    }
    std::os::unix::fs::symlink(slave, link)
        .with_context(|| format!("cannot link {} to {}", link.display(), slave.display()))
}

/// A link in the folder for temporary files, for a device that will come back on another pty.
fn own_link() -> PathBuf {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let number = COUNT.fetch_add(1, Ordering::Relaxed);
    std::env::temp_dir().join(format!("scipsim-{}-{number}.tty", std::process::id()))
}

/// A pty, raw, and the path of its other end.
fn open_pty() -> anyhow::Result<(Connection, PathBuf)> {
    let master = rustix::pty::openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
    rustix::pty::grantpt(&master)?;
    rustix::pty::unlockpt(&master)?;
    let slave = PathBuf::from(rustix::pty::ptsname(&master, Vec::new())?.into_string()?);
    let mut settings = tcgetattr(&master)?;
    settings.make_raw();
    tcsetattr(&master, OptionalActions::Now, &settings)?;
    rustix::io::ioctl_fionbio(&master, true)?;
    // Opened and closed once, so that the master tells from now on whether a client has it open.
    drop(std::fs::OpenOptions::new().read(true).write(true).open(&slave)?);
    Ok((Connection::Pty { master, is_open: false }, slave))
}

#[derive(Debug)]
enum Connection {
    Pty { master: OwnedFd, is_open: bool },
    Tcp { listener: TcpListener, stream: Option<TcpStream> },
}

/// The thread of a device.
#[derive(Debug)]
struct Server {
    device: Responder<Arc<Simulation>>,
    connection: Connection,
    /// Bytes that the client has not taken yet.
    waiting: Vec<u8>,
    /// Link to the pty.
    link: Option<PathBuf>,
    shared: Arc<Shared>,
}

impl Server {
    fn run(&mut self) {
        let mut buffer = [0; 4096];
        while !self.shared.stop.load(Ordering::Relaxed) {
            let now = now_ns();
            self.device.on_time(now);
            while let Some(output) = self.device.next_output(now) {
                self.send(output);
            }
            self.write_waiting();
            self.wait();
            while let Some(count) = self.read(&mut buffer) {
                self.device.on_received(now_ns(), &buffer[..count]);
            }
            if let Some(start) = self.device.drive_start_ns() {
                self.shared.drive_start.store(start, Ordering::Relaxed);
            }
        }
    }

    /// Waits for bytes, for room to write, or for the device's next deadline.
    fn wait(&mut self) {
        let due = self.device.deadline_ns().map_or(LONGEST_WAIT_NS, |at| at - now_ns());
        let due = due.clamp(0, LONGEST_WAIT_NS);
        let timeout = Timespec { tv_sec: 0, tv_nsec: due };
        let mut events = PollFlags::IN;
        if !self.waiting.is_empty() {
            events |= PollFlags::OUT;
        }
        let hung_up = match &self.connection {
            Connection::Pty { master, .. } => {
                let mut fds = [PollFd::new(master, PollFlags::empty())];
                let _ = poll(&mut fds, Some(&Timespec { tv_sec: 0, tv_nsec: 0 }));
                let hung_up = fds[0].revents().contains(PollFlags::HUP);
                if !hung_up {
                    // Interrupted or not, the loop looks again.
                    let _ = poll(&mut [PollFd::new(master, events)], Some(&timeout));
                }
                hung_up
            }
            Connection::Tcp { listener, stream } => {
                let fd = stream.as_ref().map_or(listener.as_fd(), |s| s.as_fd());
                let _ = poll(&mut [PollFd::from_borrowed_fd(fd, events)], Some(&timeout));
                false
            }
        };
        if let Connection::Pty { is_open, master } = &mut self.connection {
            if hung_up && *is_open {
                // The client has gone: what it did not read is lost.
                let _ = tcflush(&*master, QueueSelector::IOFlush);
                self.waiting.clear();
                self.device.on_disconnected();
            }
            *is_open = !hung_up;
            if hung_up {
                std::thread::sleep(CLOSED_WAIT);
            }
        }
    }

    /// Reads what is there; `None` if nothing is.
    fn read(&mut self, buffer: &mut [u8]) -> Option<usize> {
        match &mut self.connection {
            Connection::Pty { master, .. } => {
                rustix::io::retry_on_intr(|| rustix::io::read(&*master, &mut *buffer)).ok().filter(|&n| n > 0)
            }
            Connection::Tcp { listener, stream } => {
                if stream.is_none()
                    && let Ok((accepted, _)) = listener.accept()
                    && accepted.set_nonblocking(true).is_ok()
                {
                    // Without Nagle's delay, as a device; a failure only makes it slower.
                    let _ = accepted.set_nodelay(true);
                    *stream = Some(accepted);
                }
                match stream.as_mut()?.read(buffer) {
                    Ok(count) if count > 0 => Some(count),
                    Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => None,
                    _ => {
                        self.close();
                        None
                    }
                }
            }
        }
    }

    fn close(&mut self) {
        self.waiting.clear();
        if let Connection::Tcp { stream, .. } = &mut self.connection {
            *stream = None;
        }
        self.device.on_disconnected();
    }

    /// The plug is pulled. A pty hangs up for good, as a ttyACM does; the device comes back on another one, which
    /// the link then names.
    fn disconnect(&mut self) {
        if let (Connection::Pty { .. }, Some(link)) = (&self.connection, &self.link) {
            match open_pty().and_then(|(connection, slave)| {
                make_link(&slave, link)?;
                Ok(connection)
            }) {
                Ok(connection) => self.connection = connection,
                Err(e) => eprintln!("scipsim: the pty stays: {e:#}"),
            }
        }
        self.close();
    }

    fn send(&mut self, output: Output) {
        let has_client = match &self.connection {
            Connection::Pty { is_open, .. } => *is_open,
            Connection::Tcp { stream, .. } => stream.is_some(),
        };
        match output {
            Output::Disconnect => self.disconnect(),
            Output::Bytes { .. } if !has_client => {}
            Output::Bytes { bytes, is_scan } => {
                if is_scan && self.waiting.len() + bytes.len() > MOST_WAITING_SCANS {
                    self.shared.dropped.fetch_add(1, Ordering::Relaxed);
                } else if self.waiting.len() + bytes.len() <= MOST_WAITING {
                    self.waiting.extend(bytes);
                    self.write_waiting();
                }
            }
        }
    }

    fn write_waiting(&mut self) {
        while !self.waiting.is_empty() {
            let written = match &mut self.connection {
                Connection::Pty { master, .. } => rustix::io::write(&*master, &self.waiting),
                Connection::Tcp { stream: Some(stream), .. } => match stream.write(&self.waiting) {
                    Ok(count) => Ok(count),
                    Err(e) if e.kind() == ErrorKind::WouldBlock => Err(Errno::AGAIN),
                    Err(e) if e.kind() == ErrorKind::Interrupted => Err(Errno::INTR),
                    Err(_) => Err(Errno::IO),
                },
                Connection::Tcp { .. } => Err(Errno::IO),
            };
            match written {
                Ok(count) => drop(self.waiting.drain(..count)),
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) => return,
                Err(_) => return self.close(),
            }
        }
    }
}

/// The thread that sends poses.
struct PoseSender {
    socket: PoseSocket,
    simulation: Arc<Simulation>,
    shared: Arc<Shared>,
    /// Seconds of the drive in a second of the host's clock: the drive keeps step with the device's rotations.
    pace: f64,
}

impl PoseSender {
    fn open(
        address: &PoseAddress,
        simulation: &Arc<Simulation>,
        shared: &Arc<Shared>,
        options: &SpawnOptions,
    ) -> anyhow::Result<PoseSender> {
        let socket = PoseSocket::open(address)
            .with_context(|| format!("cannot open a socket for poses to {address:?}"))?;
        Ok(PoseSender {
            socket,
            simulation: Arc::clone(simulation),
            shared: Arc::clone(shared),
            pace: 1.0 + options.device.drift_ppm * 1e-6,
        })
    }

    fn run(&self) {
        let period_ns = (1e9 / self.simulation.options().pose_rate) as i64;
        let mut stamp_ns = now_ns();
        while !self.shared.stop.load(Ordering::Relaxed) {
            let wait_ns = stamp_ns - now_ns();
            if wait_ns > 0 {
                std::thread::sleep(Duration::from_nanos(wait_ns.min(LONGEST_WAIT_NS) as u64));
                continue;
            }
            let start_ns = self.shared.drive_start.load(Ordering::Relaxed);
            let driven = if start_ns == NOT_STARTED { 0 } else { (stamp_ns - start_ns).max(0) };
            let pose = self.simulation.reported_pose((driven as f64 * self.pace) as i64);
            let source = self.simulation.options().poses;
            self.socket.send(&message(&pose, source, stamp_ns));
            stamp_ns += period_ns;
        }
    }
}
