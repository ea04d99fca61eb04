//! Clients of the servers of `watch --web` and `bridge foxglove`.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{Shutdown, TcpStream};
use std::time::Duration;

use tungstenite::client::IntoClientRequest as _;
use tungstenite::handshake::client::Response;
use tungstenite::{Error, HandshakeError, WebSocket};

/// Ends a test that hangs.
const TIMEOUT: Duration = Duration::from_secs(180);

/// `HOST:PORT` of an address.
pub fn host(address: &str) -> &str {
    address.split('/').nth(2).unwrap()
}

/// Opens a WebSocket with these headers; the status of the answer if it is refused.
pub fn websocket(
    url: &str,
    headers: &[(&'static str, &str)],
) -> Result<(WebSocket<TcpStream>, Response), u16> {
    let stream = TcpStream::connect(host(url)).unwrap();
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    let mut request = url.into_client_request().unwrap();
    for (name, value) in headers {
        request.headers_mut().insert(*name, value.parse().unwrap());
    }
    match tungstenite::client(request, stream) {
        Ok(opened) => Ok(opened),
        Err(HandshakeError::Failure(Error::Http(answer))) => Err(answer.status().as_u16()),
        Err(e) => panic!("{e}"),
    }
}

/// Sends a server bytes and waits until it closes the connection; returns its answer. The client may end its side.
pub fn answer(host: &str, request: &[u8], ends: bool) -> String {
    let mut client = TcpStream::connect(host).unwrap();
    client.set_read_timeout(Some(TIMEOUT)).unwrap();
    // The server may close the connection while the client still writes.
    let _ = client.write_all(request);
    if ends {
        let _ = client.shutdown(Shutdown::Write);
    }
    let mut answer = Vec::new();
    if let Err(e) = client.read_to_end(&mut answer) {
        assert_ne!(e.kind(), ErrorKind::WouldBlock, "it is not closed");
    }
    String::from_utf8_lossy(&answer).into_owned()
}
