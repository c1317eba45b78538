//! A serial port, USB CDC-ACM devices and pseudo terminals included: raw, 8N1, for one opener only.
//!
//! The port is opened and read here and not by the crate `serialport`, which lists the ports: its reads give up the bytes
//! that came before a hang-up, and they are the end of a recording.

use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::io::Errno;
use rustix::termios::{
    ControlModes, OptionalActions, QueueSelector, ioctl_tiocexcl, ioctl_tiocnxcl, tcflush, tcgetattr,
    tcsetattr,
};

use super::{Received, Transport, WRITE_TIMEOUT};

/// An open serial port.
#[derive(Debug)]
pub struct SerialPort {
    file: File,
}

impl SerialPort {
    /// Opens a port at any bit rate and locks it (flock and TIOCEXCL). Bytes received before are dropped.
    ///
    /// # Errors
    /// Those of the system: `NotFound`, `PermissionDenied`; `ResourceBusy` where another program has the
    /// port; not a terminal; a bit rate that it cannot take.
    pub fn open(path: &str, baud: u32) -> io::Result<SerialPort> {
        // Without O_NONBLOCK a port could wait for a modem's carrier, with O_NOCTTY it stays an ordinary file.
        let flags = (OFlags::NONBLOCK | OFlags::NOCTTY).bits();
        let file = OpenOptions::new().read(true).write(true).custom_flags(flags as i32).open(path)?;
        flock(&file, FlockOperation::NonBlockingLockExclusive).map_err(|error| match error {
            Errno::WOULDBLOCK => {
                io::Error::new(io::ErrorKind::ResourceBusy, "the port is in use by another program")
            }
            other => other.into(),
        })?;
        ioctl_tiocexcl(&file)?;
        let mut termios = tcgetattr(&file)?;
        termios.make_raw();
        termios.control_modes |= ControlModes::CREAD | ControlModes::CLOCAL;
        termios.control_modes -= ControlModes::CSTOPB | ControlModes::CRTSCTS;
        termios.set_speed(baud)?;
        tcsetattr(&file, OptionalActions::Now, &termios)?;
        tcflush(&file, QueueSelector::IFlush)?;
        Ok(SerialPort { file })
    }

    /// Waits until the port is ready or its other side is gone; false where the time is over.
    fn wait(&self, events: PollFlags, until: Instant) -> io::Result<bool> {
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let timeout = Timespec { tv_sec: left.as_secs() as i64, tv_nsec: left.subsec_nanos().into() };
            match poll(&mut [PollFd::new(&self.file, events)], Some(&timeout)) {
                Ok(0) => return Ok(false),
                Ok(_) => return Ok(true),
                Err(Errno::INTR) => {}
                Err(error) => return Err(error.into()),
            }
        }
    }
}

impl Drop for SerialPort {
    fn drop(&mut self) {
        // The slave of a pseudo terminal lives on with its master, and would refuse the next opener.
        let _ = ioctl_tiocnxcl(&self.file);
    }
}

impl Transport for SerialPort {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<Received> {
        let until = Instant::now() + timeout;
        while self.wait(PollFlags::IN, until)? {
            match rustix::io::read(&self.file, &mut *buffer) {
                // A pulled plug, or a pseudo terminal whose other side was closed.
                Ok(0) | Err(Errno::IO) => return Ok(Received::Closed),
                Ok(count) => return Ok(Received::Bytes(count)),
                Err(Errno::INTR | Errno::AGAIN) => {}
                Err(error) => return Err(error.into()),
            }
        }
        Ok(Received::Nothing)
    }

    fn write_all(&mut self, mut bytes: &[u8]) -> io::Result<()> {
        let until = Instant::now() + WRITE_TIMEOUT;
        while !bytes.is_empty() {
            match rustix::io::write(&self.file, bytes) {
                Ok(count) => bytes = &bytes[count..],
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) if self.wait(PollFlags::OUT, until)? => {}
                Err(Errno::AGAIN) => {
                    return Err(io::Error::new(io::ErrorKind::TimedOut, "the port takes no bytes"));
                }
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::pty;

    #[test]
    fn a_pseudo_terminal_carries_every_byte_both_ways() {
        let master = pty::openpt(pty::OpenptFlags::RDWR | pty::OpenptFlags::NOCTTY).unwrap();
        pty::grantpt(&master).unwrap();
        pty::unlockpt(&master).unwrap();
        let path = pty::ptsname(&master, Vec::new()).unwrap().into_string().unwrap();
        let mut port = SerialPort::open(&path, 115_200).unwrap();
        let second = SerialPort::open(&path, 115_200).unwrap_err();
        assert_eq!(second.kind(), io::ErrorKind::ResourceBusy);

        let mut buffer = [0; 512];
        assert_eq!(port.read(&mut buffer, Duration::ZERO).unwrap(), Received::Nothing);
        port.write_all(b"VV\n\r\x03\x04").unwrap();
        let count = rustix::io::read(&master, &mut buffer).unwrap();
        assert_eq!(&buffer[..count], b"VV\n\r\x03\x04");

        let every: Vec<u8> = (0..=255).collect();
        assert_eq!(rustix::io::write(&master, &every).unwrap(), 256);
        let mut got = Vec::new();
        while got.len() < 256 {
            match port.read(&mut buffer, Duration::from_secs(5)).unwrap() {
                Received::Bytes(count) => got.extend_from_slice(&buffer[..count]),
                other => panic!("{other:?} after {} bytes", got.len()),
            }
        }
        assert_eq!(got, every);
        assert_eq!(rustix::io::write(&master, b"last").unwrap(), 4);
        drop(master);
        let last = port.read(&mut buffer, Duration::from_secs(5)).unwrap();
        assert!(matches!(last, Received::Bytes(4) | Received::Closed), "a pseudo terminal may drop the last");
        assert_eq!(port.read(&mut buffer, Duration::from_secs(5)).unwrap(), Received::Closed);
    }

    #[test]
    fn a_missing_port_is_not_found() {
        let error = SerialPort::open("/dev/ttyNOSUCH0", 9600).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::NotFound);
        assert!(SerialPort::open("/dev/null", 9600).is_err(), "not a terminal");
    }

    #[test]
    fn odd_bit_rates_and_a_port_that_takes_nothing() {
        let master = pty::openpt(pty::OpenptFlags::RDWR | pty::OpenptFlags::NOCTTY).unwrap();
        pty::grantpt(&master).unwrap();
        pty::unlockpt(&master).unwrap();
        let path = pty::ptsname(&master, Vec::new()).unwrap().into_string().unwrap();
        let mut port = SerialPort::open(&path, 750_000).unwrap();
        assert_eq!(tcgetattr(&port.file).unwrap().input_speed(), 750_000);
        // Nobody reads the master: its buffer fills up.
        let error = port.write_all(&[b'x'; 1 << 20]).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::TimedOut);
    }
}
