//! A bare stream of received bytes, as captured from a port, read as if it came from one.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;
use std::time::Duration;

use super::{Received, Transport, received};
use crate::decoder::Decoder;
use crate::reply::Echo;

/// An open capture. What is written to it is dropped: the device of a capture listens no more.
#[derive(Debug)]
pub struct CaptureFile {
    file: File,
}

impl CaptureFile {
    /// How much of a file is looked at to recognise it.
    pub const HEAD: usize = 64 * 1024;

    /// Opens a capture.
    ///
    /// # Errors
    /// Those of the system.
    pub fn open(path: impl AsRef<Path>) -> io::Result<CaptureFile> {
        Ok(CaptureFile { file: File::open(path)? })
    }

    /// Whether bytes from the beginning of a file (the first [`HEAD`](CaptureFile::HEAD) will do) look like
    /// what a device sends: known replies, and more of them than of anything else.
    pub fn recognises(head: &[u8]) -> bool {
        let mut decoder = Decoder::new();
        decoder.push(head);
        let (mut known, mut strange) = (0, 0);
        while let Some(outcome) = decoder.decode_next() {
            match outcome {
                Ok(located) if matches!(located.reply.echo, Echo::Request(_)) => known += located.len,
                Ok(located) => strange += located.len,
                Err(error) => strange += error.len,
            }
        }
        known > strange
    }
}

impl Transport for CaptureFile {
    fn read(&mut self, buffer: &mut [u8], _timeout: Duration) -> io::Result<Received> {
        loop {
            if let Some(outcome) = received(self.file.read(buffer)) {
                return outcome;
            }
        }
    }

    fn write_all(&mut self, _bytes: &[u8]) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn captures_are_recognised_and_other_files_are_not() {
        assert!(CaptureFile::recognises(b"QT\n00P\n\n"));
        assert!(CaptureFile::recognises(b"6Qh0\n\nVV\n00P\nPROT:SCIP 2.0;N\n\n"));
        assert!(!CaptureFile::recognises(b""));
        assert!(!CaptureFile::recognises(b"# a text\n\nwith paragraphs\n\nof words\n\n"));
        assert!(!CaptureFile::recognises(b"FLASER 3 1.0 2.0 3.0 0 0 0\n"));
        assert!(!CaptureFile::recognises(&[0; 4096]));
    }

    #[test]
    fn bytes_and_the_end() {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        io::Write::write_all(&mut file, b"QT\n00P\n\n").unwrap();
        let mut capture = CaptureFile::open(file.path()).unwrap();
        let mut buffer = [0; 64];
        capture.write_all(b"ignored").unwrap();
        assert_eq!(capture.read(&mut buffer, Duration::ZERO).unwrap(), Received::Bytes(8));
        assert_eq!(capture.read(&mut buffer, Duration::ZERO).unwrap(), Received::Closed);
    }
}
