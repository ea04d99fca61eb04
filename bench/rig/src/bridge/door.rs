//! The door before the WebSocket server: lets in programs, and pages of known origins.
//!
//! ```text
//!   client --request--> door --Origin known, or none--> server of the SDK, on a loopback address of its own
//!                        \--else--> 403
//! ```
//!
//! A browser lets every page open a WebSocket to this machine, and tells the page's origin; the SDK does not look at
//! it. What is not a browser tells none, or any. The server's address is drawn anew each time, from the 16 million of
//! 127.0.0.0/8 and any port: a page cannot try them all.

use std::io::{self, ErrorKind, Read as _, Write as _};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use crate::output::say;

/// Where the app runs that this is made for.
const APP: &str = "https://app.foxglove.dev";
/// Longest head of a request [bytes].
const HEAD_BYTES: usize = 16 << 10;
/// How long a request may take to come.
const PATIENCE: Duration = Duration::from_secs(5);
/// How long clients may take to hear the server's last words.
const LEAVING: Duration = Duration::from_secs(1);
/// How soon the system is asked again that had no room for a client.
const RETRY_EVERY: Duration = Duration::from_millis(100);
const HEAD_END: &[u8] = b"\r\n\r\n";

/// The door.
#[derive(Debug)]
pub(super) struct Door {
    /// Where it is.
    pub(super) port: u16,
    /// Held by every client that is in, and twice by the door.
    clients: Arc<()>,
}

impl Door {
    /// Opens a door: from now on its connections go to `server`, if they come from `origins` or are known anyway.
    ///
    /// # Errors
    /// The system's, where it has no thread for it.
    pub(super) fn open(listener: TcpListener, server: SocketAddr, origins: &[String]) -> io::Result<Self> {
        let origins: Arc<[String]> = origins.into();
        let clients = Arc::new(());
        let door = Self { port: listener.local_addr()?.port(), clients: Arc::clone(&clients) };
        thread::Builder::new().name("door".into()).spawn(move || {
            for client in listener.incoming() {
                let Ok(client) = client else {
                    thread::sleep(RETRY_EVERY);
                    continue;
                };
                let (origins, clients) = (Arc::clone(&origins), Arc::clone(&clients));
                // Where there is no thread for it, the client is sent away with the stream.
                let _ = thread::Builder::new().name("client".into()).spawn(move || {
                    let _ = let_in(client, server, &origins);
                    drop(clients);
                });
            }
        })?;
        Ok(door)
    }

    /// Waits until every client has what the server, which has ended, had to say.
    pub(super) fn await_empty(&self) {
        let until = Instant::now() + LEAVING;
        while Arc::strong_count(&self.clients) > 2 && Instant::now() < until {
            thread::sleep(LEAVING / 100);
        }
    }
}

/// A loopback address that nobody can guess.
pub(super) fn hidden_address() -> Ipv4Addr {
    let [a, b, c, _] = fastrand::u32(..).to_le_bytes();
    // The first and the last one of a network are no host's.
    Ipv4Addr::new(127, a, b, c.clamp(1, 254))
}

fn let_in(mut client: TcpStream, server: SocketAddr, origins: &[String]) -> io::Result<()> {
    let head = head(&mut client)?;
    if let Err(origin) = check(&head, origins) {
        say(&format!("refused a page of {origin}; --allow-origin {origin} lets it in\n"));
        let why = format!("ironbird's bridge does not know the origin {origin} (--allow-origin)\n");
        return write!(
            client,
            "HTTP/1.1 403 Forbidden\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{why}",
            why.len()
        );
    }
    client.set_read_timeout(None)?;
    let mut server = TcpStream::connect(server)?;
    for stream in [&client, &server] {
        stream.set_nodelay(true)?;
    }
    server.write_all(&head)?;
    let (mut from_client, mut to_server) = (client.try_clone()?, server.try_clone()?);
    thread::Builder::new().name("client".into()).spawn(move || pass_on(&mut from_client, &mut to_server))?;
    pass_on(&mut server, &mut client);
    Ok(())
}

/// Passes everything on until one side ends, and tells the other.
fn pass_on(from: &mut TcpStream, to: &mut TcpStream) {
    // However it ended, there is nobody to tell but the other side.
    let _ = io::copy(from, to);
    let _ = to.shutdown(Shutdown::Write);
}

/// The head of a request, and what has come behind it.
fn head(client: &mut TcpStream) -> io::Result<Vec<u8>> {
    let until = Instant::now() + PATIENCE;
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

/// Gives the origin of a request that is not to be let in.
fn check(head: &[u8], origins: &[String]) -> Result<(), String> {
    let text = String::from_utf8_lossy(head);
    let headers = text.lines().skip(1).take_while(|line| !line.is_empty()).filter_map(|line| line.split_once(':'));
    let told = headers.filter(|(name, _)| name.trim().eq_ignore_ascii_case("origin")).map(|(_, origin)| origin.trim());
    let mut unknown = told.filter(|origin| !is_known(origin) && !origins.iter().any(|known| known == origin));
    unknown.next().map_or(Ok(()), |origin| Err(origin.escape_default().to_string()))
}

/// Whether an origin is the app's, or a page of this machine.
fn is_known(origin: &str) -> bool {
    let is_here = |rest: &str| {
        ["localhost", "127.0.0.1", "[::1]"].iter().any(|host| {
            rest.strip_prefix(host).is_some_and(|rest| {
                rest.is_empty() || rest.strip_prefix(':').is_some_and(|port| port.parse::<u16>().is_ok())
            })
        })
    };
    origin == APP || ["http://", "https://"].iter().any(|scheme| origin.strip_prefix(scheme).is_some_and(is_here))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_app_and_pages_of_this_machine_are_known() {
        for known in [
            "https://app.foxglove.dev",
            "http://localhost",
            "http://localhost:8080",
            "https://127.0.0.1:1",
            "http://[::1]:80",
        ] {
            assert!(is_known(known), "{known}");
        }
        for unknown in [
            "null",
            "",
            "http://app.foxglove.dev",
            "https://app.foxglove.dev.evil.example",
            "https://evil.example",
            "http://localhost.evil.example",
            "http://localhost:80.evil.example",
            "http://127.0.0.1.evil.example",
            "ws://localhost",
        ] {
            assert!(!is_known(unknown), "{unknown}");
        }
    }

    #[test]
    fn every_origin_of_a_request_must_be_known_however_it_is_written() {
        let request = |headers: &str| format!("GET / HTTP/1.1\r\nHost: x\r\n{headers}\r\nOrigin: in the body");
        let check = |headers: &str, origins: &[String]| check(request(headers).as_bytes(), origins);
        assert_eq!(check("", &[]), Ok(()));
        assert_eq!(check("ORIGIN:  http://localhost:5 \r\n", &[]), Ok(()));
        let evil = "https://evil.example".to_owned();
        assert_eq!(check("origin: https://evil.example\r\n", &[]), Err(evil.clone()));
        assert_eq!(check("Origin: http://localhost\r\nOrigin: https://evil.example\r\n", &[]), Err(evil.clone()));
        assert_eq!(check("Origin: https://evil.example\r\n", &[evil]), Ok(()));
    }

    #[test]
    fn hidden_addresses_are_of_this_machine_and_differ() {
        let addresses: Vec<Ipv4Addr> = (0..100).map(|_| hidden_address()).collect();
        assert!(addresses.iter().all(Ipv4Addr::is_loopback));
        assert!(addresses.iter().any(|address| *address != addresses[0]));
    }
}
