//! The serial ports of this machine, and which of them are scanners.

use std::io;

use serialport::SerialPortType;

/// USB vendor and product of Hokuyo's scanners.
const HOKUYO: (u16, u16) = (0x15d1, 0x0000);

/// A serial port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FoundPort {
    /// Its device file.
    pub path: String,
    /// Whether it is on USB with Hokuyo's numbers (15d1:0000). All their scanners share these and have no serial
    /// number on USB: two of them are told apart by VV only.
    pub is_hokuyo: bool,
}

/// Lists the serial ports, scanners first.
///
/// # Errors
/// Where the system does not tell its devices.
pub fn list_ports() -> io::Result<Vec<FoundPort>> {
    let mut ports: Vec<FoundPort> = serialport::available_ports()?
        .into_iter()
        .map(|port| FoundPort {
            is_hokuyo: matches!(&port.port_type, SerialPortType::UsbPort(usb) if (usb.vid, usb.pid) == HOKUYO),
            path: port.port_name,
        })
        .collect();
    ports.sort_by(|a, b| b.is_hokuyo.cmp(&a.is_hokuyo).then_with(|| a.path.cmp(&b.path)));
    Ok(ports)
}
