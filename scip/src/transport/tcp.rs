//! TCP to an Ethernet model, without Nagle's delay.

use std::io::{self, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

use super::{Received, Transport, WRITE_TIMEOUT, received};

/// An open connection.
#[derive(Debug)]
pub struct TcpPort {
    stream: TcpStream,
    /// The time limit that the socket has.
    timeout: Option<Duration>,
}

impl TcpPort {
    /// Connects to the first address of the host that answers, each within `timeout`.
    ///
    /// # Errors
    /// Those of the system, of the last address tried.
    pub fn connect(host: &str, port: u16, timeout: Duration) -> io::Result<TcpPort> {
        let mut last = io::Error::new(io::ErrorKind::NotFound, format!("{host} has no address"));
        for address in (host, port).to_socket_addrs()? {
            match TcpStream::connect_timeout(&address, timeout) {
                Ok(stream) => return TcpPort::new(stream),
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    /// Takes over a connection.
    ///
    /// # Errors
    /// Those of setting TCP_NODELAY and the time limit of writes.
    pub fn new(stream: TcpStream) -> io::Result<TcpPort> {
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(WRITE_TIMEOUT))?;
        Ok(TcpPort { stream, timeout: None })
    }

    fn set_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        // Zero would mean to wait for ever.
        let timeout = Some(timeout.max(Duration::from_micros(1)));
        if self.timeout != timeout {
            self.stream.set_read_timeout(timeout)?;
            self.timeout = timeout;
        }
        Ok(())
    }
}

impl Transport for TcpPort {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<Received> {
        self.set_timeout(timeout)?;
        loop {
            if let Some(outcome) = received(self.stream.read(buffer)) {
                return outcome;
            }
        }
    }

    fn write_all(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.stream.write_all(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    #[test]
    fn bytes_both_ways_and_the_end() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let mut client = TcpPort::connect("127.0.0.1", port, Duration::from_secs(5)).unwrap();
        let (mut server, _) = listener.accept().unwrap();
        let mut buffer = [0; 64];
        assert_eq!(client.read(&mut buffer, Duration::ZERO).unwrap(), Received::Nothing);
        client.write_all(b"VV\n").unwrap();
        let mut got = [0; 3];
        server.read_exact(&mut got).unwrap();
        assert_eq!(&got, b"VV\n");
        server.write_all(b"QT\n00P\n\n").unwrap();
        assert_eq!(client.read(&mut buffer, Duration::from_secs(5)).unwrap(), Received::Bytes(8));
        drop(server);
        assert_eq!(client.read(&mut buffer, Duration::from_secs(5)).unwrap(), Received::Closed);
    }
}
