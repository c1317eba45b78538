//! A serial port, USB CDC-ACM devices and pseudo terminals included: raw, 8N1, for one opener only.

use std::io::{self, Read, Write};
use std::time::Duration;

use super::{Received, Transport, WRITE_TIMEOUT, received};

/// An open serial port.
#[derive(Debug)]
pub struct SerialPort {
    port: serialport::TTYPort,
}

impl SerialPort {
    /// Opens a port at any bit rate and locks it (TIOCEXCL and flock).
    ///
    /// # Errors
    /// Those of the system: `NotFound`, `PermissionDenied`, and a busy port.
    pub fn open(path: &str, baud: u32) -> io::Result<SerialPort> {
        // Opening waits for nothing; the time limits are set with every read and write.
        let builder = serialport::new(path, baud).timeout(WRITE_TIMEOUT);
        Ok(SerialPort { port: serialport::TTYPort::open(&builder)? })
    }

    fn set_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        Ok(serialport::SerialPort::set_timeout(&mut self.port, timeout)?)
    }
}

impl Transport for SerialPort {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<Received> {
        self.set_timeout(timeout)?;
        loop {
            if let Some(outcome) = received(self.port.read(buffer)) {
                return match outcome {
                    // A pulled plug, or the other end of a pseudo terminal that was closed.
                    Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(Received::Closed),
                    Err(error) if error.raw_os_error() == Some(rustix::io::Errno::IO.raw_os_error()) => {
                        Ok(Received::Closed)
                    }
                    outcome => outcome,
                };
            }
        }
    }

    fn write_all(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.set_timeout(WRITE_TIMEOUT)?;
        self.port.write_all(bytes)
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
        assert!(SerialPort::open(&path, 115_200).is_err(), "the port is for one opener");

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
        drop(master);
        assert_eq!(port.read(&mut buffer, Duration::from_secs(5)).unwrap(), Received::Closed);
    }

    #[test]
    fn a_missing_port_is_not_found() {
        let error = SerialPort::open("/dev/ttyNOSUCH0", 9600).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::NotFound);
    }
}
