//! The proxy before the WebSocket server: admits programs, and web pages of known origins, and limits their number.
//!
//! ```text
//!   client --request--> proxy --Origin known, or none--> server of the SDK, on a loopback address of its own
//!                         \--else--> 403, or 503 if there are too many clients
//! ```
//!
//! A browser lets every page open a WebSocket to this machine, and names the page's origin; the SDK does not check it.
//! Other programs name none, or any. The server's address is drawn anew each time, from the 16 million of 127.0.0.0/8
//! and any port: a page cannot try them all.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use ipc::clock::now_ns;

use crate::output::say;

/// Where the Foxglove app runs.
const APP: &str = "https://app.foxglove.dev";
/// Longest head of a request [bytes].
const HEAD_BYTES: usize = 16 << 10;
/// How long a request may take to arrive.
const HEAD_TIMEOUT: Duration = Duration::from_secs(5);
/// How long clients may take to receive the server's final messages.
const DRAIN_TIMEOUT: Duration = Duration::from_secs(1);
/// How soon to accept again after the system had no room for a client.
const RETRY_EVERY: Duration = Duration::from_millis(100);
const HEAD_END: &[u8] = b"\r\n\r\n";

/// What clients may take: each needs two threads and four descriptors.
#[derive(Clone, Copy, Debug)]
struct Limits {
    clients: usize,
    /// How long nothing may be transferred in either direction. A flight sends data all the time to every client that
    /// subscribes and reads.
    idle: Duration,
}

const LIMITS: Limits = Limits {
    clients: 16,
    idle: Duration::from_secs(60),
};

#[derive(Debug)]
pub(super) struct OriginProxy {
    pub(super) port: u16,
    /// Held once by every client, and twice by the proxy.
    clients: Arc<()>,
}

impl OriginProxy {
    /// Forwards the connections of a listener to `server`, if they name no origin, one of `origins`, or a known one.
    pub(super) fn open(
        listener: TcpListener,
        server: SocketAddr,
        origins: &[String],
    ) -> io::Result<Self> {
        Self::open_with(listener, server, origins, LIMITS)
    }

    fn open_with(
        listener: TcpListener,
        server: SocketAddr,
        origins: &[String],
        limits: Limits,
    ) -> io::Result<Self> {
        let origins: Arc<[String]> = origins.into();
        let proxy = Self {
            port: listener.local_addr()?.port(),
            clients: Arc::new(()),
        };
        let clients = Arc::clone(&proxy.clients);
        thread::Builder::new().name("proxy".into()).spawn(move || {
            for client in listener.incoming() {
                let Ok(mut client) = client else {
                    thread::sleep(RETRY_EVERY);
                    continue;
                };
                if Arc::strong_count(&clients) - 2 >= limits.clients {
                    // A request that was not read would reset the connection and lose the answer. The answer fits into the
                    // socket's buffer.
                    let _ = client
                        .set_read_timeout(Some(RETRY_EVERY))
                        .and_then(|()| client.read(&mut [0; 4096]));
                    let why = format!("the bridge serves {} clients already\n", limits.clients);
                    let _ = refuse(&mut client, "503 Service Unavailable", &why);
                    continue;
                }
                let (origins, clients) = (Arc::clone(&origins), Arc::clone(&clients));
                // Without a thread, the client is disconnected.
                let _ = thread::Builder::new().name("client".into()).spawn(move || {
                    let _ = serve(client, server, &origins, limits.idle);
                    drop(clients);
                });
            }
        })?;
        Ok(proxy)
    }

    /// Waits until every client has received what the server, which has ended, sent.
    pub(super) fn await_empty(&self) {
        let until = Instant::now() + DRAIN_TIMEOUT;
        while Arc::strong_count(&self.clients) > 2 && Instant::now() < until {
            thread::sleep(DRAIN_TIMEOUT / 100);
        }
    }
}

/// A loopback address that nobody can guess.
pub(super) fn hidden_address() -> Ipv4Addr {
    let [a, b, c, _] = fastrand::u32(..).to_le_bytes();
    // The first and the last address of a network are no host's.
    Ipv4Addr::new(127, a, b, c.clamp(1, 254))
}

fn serve(
    mut client: TcpStream,
    server: SocketAddr,
    origins: &[String],
    idle: Duration,
) -> io::Result<()> {
    let head = read_head(&mut client)?;
    if let Err(origin) = check_origins(&head, origins) {
        say(&format!(
            "refused a page of {origin}; --allow-origin {origin} lets it in\n"
        ));
        let why = format!("ironbird's bridge does not know the origin {origin} (--allow-origin)\n");
        return refuse(&mut client, "403 Forbidden", &why);
    }
    let mut server = TcpStream::connect(server)?;
    for stream in [&client, &server] {
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(idle))?;
        stream.set_write_timeout(Some(idle))?;
    }
    server.write_all(&head)?;
    let last_ns = Arc::new(AtomicU64::new(now_ns()));
    let (mut from_client, mut to_server) = (client.try_clone()?, server.try_clone()?);
    let last_ns_too = Arc::clone(&last_ns);
    thread::Builder::new()
        .name("client".into())
        .spawn(move || forward(&mut from_client, &mut to_server, &last_ns_too, idle))?;
    forward(&mut server, &mut client, &last_ns, idle);
    Ok(())
}

fn refuse(client: &mut TcpStream, status: &str, why: &str) -> io::Result<()> {
    write!(
        client,
        "HTTP/1.1 {status}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{why}",
        why.len()
    )
}

/// Forwards everything until one side ends, and then ends the direction; ends the connection if it is idle or broken.
fn forward(from: &mut TcpStream, to: &mut TcpStream, last_ns: &AtomicU64, idle: Duration) {
    let mut piece = [0; 16 << 10];
    loop {
        let transferred = from.read(&mut piece).and_then(|read| {
            to.write_all(&piece[..read])?;
            Ok(read)
        });
        let idle_ns = now_ns().saturating_sub(last_ns.load(Ordering::Relaxed));
        match transferred {
            Ok(0) => {
                // The other side may have ended, too.
                let _ = to.shutdown(Shutdown::Write);
                return;
            }
            Ok(_) => last_ns.store(now_ns(), Ordering::Relaxed),
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            // Nothing to read; the other direction may be busy.
            Err(e)
                if e.kind() == ErrorKind::WouldBlock && u128::from(idle_ns) < idle.as_nanos() => {}
            Err(_) => {
                let _ = from.shutdown(Shutdown::Both);
                let _ = to.shutdown(Shutdown::Both);
                return;
            }
        }
    }
}

/// The head of a request, and what has arrived after it.
fn read_head(client: &mut TcpStream) -> io::Result<Vec<u8>> {
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

/// Fails with the first unknown origin of a request.
fn check_origins(head: &[u8], origins: &[String]) -> Result<(), String> {
    let text = String::from_utf8_lossy(head);
    let headers = text
        .lines()
        .skip(1)
        .take_while(|line| !line.is_empty())
        .filter_map(|line| line.split_once(':'));
    let named = headers
        .filter(|(name, _)| name.trim().eq_ignore_ascii_case("origin"))
        .map(|(_, origin)| origin.trim());
    let mut unknown =
        named.filter(|origin| !is_known(origin) && !origins.iter().any(|known| known == origin));
    unknown
        .next()
        .map_or(Ok(()), |origin| Err(origin.escape_default().to_string()))
}

/// Whether an origin is the app's, or a page of this machine.
fn is_known(origin: &str) -> bool {
    let is_here = |rest: &str| {
        ["localhost", "127.0.0.1", "[::1]"].iter().any(|host| {
            rest.strip_prefix(host).is_some_and(|rest| {
                rest.is_empty()
                    || rest
                        .strip_prefix(':')
                        .is_some_and(|port| port.parse::<u16>().is_ok())
            })
        })
    };
    origin == APP
        || ["http://", "https://"]
            .iter()
            .any(|scheme| origin.strip_prefix(scheme).is_some_and(is_here))
}

#[cfg(test)]
mod tests {
    use super::*;

    const REQUEST: &[u8] = b"GET / HTTP/1.1\r\n\r\n";

    /// A proxy before a server that accepts connections and stays silent.
    fn proxy(limits: Limits) -> (OriginProxy, TcpListener) {
        let listen = || TcpListener::bind(("127.0.0.1", 0)).unwrap();
        let server = listen();
        let address = server.local_addr().unwrap();
        let proxy = OriginProxy::open_with(listen(), address, &[], limits).unwrap();
        (proxy, server)
    }

    fn connect(proxy: &OriginProxy) -> TcpStream {
        let mut client = TcpStream::connect(("127.0.0.1", proxy.port)).unwrap();
        client.write_all(REQUEST).unwrap();
        client
    }

    #[test]
    fn one_client_too_many_is_refused_and_a_place_that_is_free_again_is_given_to_the_next() {
        let limits = Limits {
            clients: 2,
            ..LIMITS
        };
        let (proxy, server) = proxy(limits);
        let served: Vec<(TcpStream, TcpStream)> = (0..limits.clients)
            .map(|_| (connect(&proxy), server.accept().unwrap().0))
            .collect();
        let mut answer = String::new();
        connect(&proxy).read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with("HTTP/1.1 503 "), "{answer}");
        drop(served);
        while Arc::strong_count(&proxy.clients) > 2 {
            thread::sleep(Duration::from_millis(1));
        }
        let _client = connect(&proxy);
        let mut head = [0; REQUEST.len()];
        server.accept().unwrap().0.read_exact(&mut head).unwrap();
        assert_eq!(head, REQUEST);
    }

    #[test]
    fn an_idle_client_is_disconnected() {
        let (proxy, server) = proxy(Limits {
            idle: Duration::from_millis(50),
            ..LIMITS
        });
        let mut client = connect(&proxy);
        let (mut at_server, _) = server.accept().unwrap();
        assert_eq!(client.read(&mut [0]).unwrap(), 0);
        let mut head = Vec::new();
        at_server.read_to_end(&mut head).unwrap();
        assert_eq!(head, REQUEST);
    }

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
        let request = |headers: &str| {
            format!("GET / HTTP/1.1\r\nHost: x\r\n{headers}\r\nOrigin: in the body")
        };
        let check =
            |headers: &str, origins: &[String]| check_origins(request(headers).as_bytes(), origins);
        assert_eq!(check("", &[]), Ok(()));
        assert_eq!(check("ORIGIN:  http://localhost:5 \r\n", &[]), Ok(()));
        let evil = "https://evil.example".to_owned();
        assert_eq!(
            check("origin: https://evil.example\r\n", &[]),
            Err(evil.clone())
        );
        assert_eq!(
            check(
                "Origin: http://localhost\r\nOrigin: https://evil.example\r\n",
                &[]
            ),
            Err(evil.clone())
        );
        assert_eq!(check("Origin: https://evil.example\r\n", &[evil]), Ok(()));
    }

    #[test]
    fn hidden_addresses_are_of_this_machine_and_differ() {
        let addresses: Vec<Ipv4Addr> = (0..100).map(|_| hidden_address()).collect();
        assert!(addresses.iter().all(Ipv4Addr::is_loopback));
        assert!(addresses.iter().any(|address| *address != addresses[0]));
    }
}
