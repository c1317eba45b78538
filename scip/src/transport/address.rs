//! Where a device is: `/dev/ttyACM0`, `serial:PATH[?baud=N]`, `tcp://HOST:PORT`.

use std::fmt;
use std::io;
use std::str::FromStr;
use std::time::Duration;

use super::{SerialPort, TcpPort, Transport};
use crate::model::Profile;

/// Bit rate of a serial port where none is given: what MRPT asks for. USB models take any.
pub const DEFAULT_BAUD: u32 = 115_200;
/// Port that Hokuyo's Ethernet models listen on.
pub const DEFAULT_TCP_PORT: u16 = 10_940;

/// Where a device is.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Address {
    /// A serial port, or the slave of a pseudo terminal.
    Serial {
        /// Path of the port.
        path: String,
        /// Bit rate.
        baud: u32,
    },
    /// A TCP server.
    Tcp {
        /// Name or address; IPv6 addresses without brackets.
        host: String,
        /// Port.
        port: u16,
    },
}

/// Why a text is no address.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AddressError {
    /// It is of none of the forms.
    #[error("{0:?} is no device: write /dev/ttyACM0, serial:PATH[?baud=N] or tcp://HOST[:PORT]")]
    Form(String),
    /// `serial:` without a path.
    #[error("{0:?} names no port: write serial:/dev/ttyUSB0?baud=115200")]
    NoPath(String),
    /// Something other than `baud=N` behind `?`.
    #[error("{0:?}: the only setting of a serial port is ?baud=N, N from 1 to 4294967295")]
    Setting(String),
    /// `tcp://` without a host.
    #[error("{0:?} names no host: write tcp://192.168.0.10:{DEFAULT_TCP_PORT}")]
    NoHost(String),
    /// The port is no number of 1..=65535.
    #[error("{0:?}: the port must be a number from 1 to 65535")]
    Port(String),
}

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Address, AddressError> {
        if let Some(rest) = text.strip_prefix("tcp://") {
            parse_tcp(text, rest)
        } else if let Some(rest) = text.strip_prefix("serial:") {
            parse_serial(text, rest)
        } else if text.starts_with('/') {
            Ok(Address::Serial { path: text.to_owned(), baud: DEFAULT_BAUD })
        } else {
            Err(AddressError::Form(text.to_owned()))
        }
    }
}

fn parse_serial(text: &str, rest: &str) -> Result<Address, AddressError> {
    let (path, setting) = match rest.split_once('?') {
        Some((path, setting)) => (path, Some(setting)),
        None => (rest, None),
    };
    if path.is_empty() {
        return Err(AddressError::NoPath(text.to_owned()));
    }
    let baud = match setting {
        None => DEFAULT_BAUD,
        Some(setting) => setting
            .strip_prefix("baud=")
            .and_then(|number| number.parse().ok())
            .filter(|&baud| baud > 0)
            .ok_or_else(|| AddressError::Setting(text.to_owned()))?,
    };
    Ok(Address::Serial { path: path.to_owned(), baud })
}

fn parse_tcp(text: &str, rest: &str) -> Result<Address, AddressError> {
    let rest = rest.strip_suffix('/').unwrap_or(rest);
    let (host, port) = match rest.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some((host, "")) => (host, None),
        Some((host, port)) => {
            (host, Some(port.strip_prefix(':').ok_or_else(|| AddressError::Port(text.to_owned()))?))
        }
        None => match rest.rsplit_once(':') {
            Some((host, port)) => (host, Some(port)),
            None => (rest, None),
        },
    };
    if host.is_empty() {
        return Err(AddressError::NoHost(text.to_owned()));
    }
    let port = match port {
        None => DEFAULT_TCP_PORT,
        Some(port) => {
            port.parse().ok().filter(|&port| port > 0).ok_or_else(|| AddressError::Port(text.to_owned()))?
        }
    };
    Ok(Address::Tcp { host: host.to_owned(), port })
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Address::Serial { path, baud } => write!(f, "serial:{path}?baud={baud}"),
            Address::Tcp { host, port } if host.contains(':') => write!(f, "tcp://[{host}]:{port}"),
            Address::Tcp { host, port } => write!(f, "tcp://{host}:{port}"),
        }
    }
}

impl Address {
    /// The profile of devices that are connected like this.
    pub fn profile(&self) -> Profile {
        match self {
            Address::Serial { .. } => Profile::Usb,
            Address::Tcp { .. } => Profile::Ethernet,
        }
    }

    /// Opens the port. `timeout` bounds the connection of TCP.
    ///
    /// # Errors
    /// Those of the system, with the address in the text.
    pub fn open(&self, timeout: Duration) -> io::Result<Box<dyn Transport>> {
        let opened = match self {
            Address::Serial { path, baud } => {
                SerialPort::open(path, *baud).map(|port| Box::new(port) as Box<dyn Transport>)
            }
            Address::Tcp { host, port } => {
                TcpPort::connect(host, *port, timeout).map(|port| Box::new(port) as Box<dyn Transport>)
            }
        };
        opened.map_err(|error| io::Error::new(error.kind(), format!("cannot open {self}: {error}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forms() {
        let serial = |path: &str, baud| Ok(Address::Serial { path: path.to_owned(), baud });
        let tcp = |host: &str, port| Ok(Address::Tcp { host: host.to_owned(), port });
        for (text, address) in [
            ("/dev/ttyACM0", serial("/dev/ttyACM0", DEFAULT_BAUD)),
            ("serial:/dev/ttyS0?baud=19200", serial("/dev/ttyS0", 19_200)),
            ("serial:COM3", serial("COM3", DEFAULT_BAUD)),
            ("tcp://192.168.0.10:10940", tcp("192.168.0.10", 10_940)),
            ("tcp://scanner", tcp("scanner", DEFAULT_TCP_PORT)),
            ("tcp://[::1]:4000", tcp("::1", 4000)),
        ] {
            assert_eq!(text.parse::<Address>(), address);
            assert_eq!(address.clone().unwrap().to_string().parse(), address);
        }
    }

    #[test]
    fn errors_name_the_text() {
        for (text, want) in [
            ("ttyACM0", AddressError::Form("ttyACM0".to_owned())),
            ("serial:", AddressError::NoPath("serial:".to_owned())),
            ("serial:/dev/x?speed=9", AddressError::Setting("serial:/dev/x?speed=9".to_owned())),
            ("tcp://:1", AddressError::NoHost("tcp://:1".to_owned())),
            ("tcp://a:99999", AddressError::Port("tcp://a:99999".to_owned())),
            ("tcp://[::1]1", AddressError::Port("tcp://[::1]1".to_owned())),
        ] {
            assert_eq!(text.parse::<Address>(), Err(want));
        }
    }
}
