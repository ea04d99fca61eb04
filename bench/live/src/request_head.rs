//! Reads the head of an HTTP request, which may be endless or never come.

use std::io::{self, ErrorKind, Read as _};
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// Longest head of a request [bytes].
const HEAD_BYTES: usize = 16 << 10;
const HEAD_TIMEOUT: Duration = Duration::from_secs(5);
const HEAD_END: &[u8] = b"\r\n\r\n";

/// The head of a request, and what has arrived after it.
pub(crate) fn read_head(client: &mut TcpStream) -> io::Result<Vec<u8>> {
    let until = Instant::now() + HEAD_TIMEOUT;
    let (mut head, mut piece) = (Vec::new(), [0; 1024]);
    while !head.windows(HEAD_END.len()).any(|end| end == HEAD_END) {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(ErrorKind::TimedOut.into());
        }
        client.set_read_timeout(Some(left))?;
        let read = client.read(&mut piece)?;
        if read == 0 || head.len() > HEAD_BYTES {
            return Err(ErrorKind::InvalidData.into());
        }
        head.extend_from_slice(&piece[..read]);
    }
    Ok(head)
}
