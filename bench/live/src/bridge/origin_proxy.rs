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

use std::io::{self, Read as _, Write as _};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use crate::request_head::read_head;
use errors::output::say;

/// Where the Foxglove app runs.
const APP: &str = "https://app.foxglove.dev";
/// How long clients may take to receive the server's final messages.
const DRAIN_TIMEOUT: Duration = Duration::from_secs(1);
/// How soon to accept again after the system had no room for a client.
const RETRY_EVERY: Duration = Duration::from_millis(100);

/// What clients may take: each needs two threads and four descriptors.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    clients: usize,
    /// How long the server may send a client nothing. A flight sends data all the time to every client that subscribes and
    /// reads, and every request has an answer.
    idle: Duration,
}

pub(super) const LIMITS: Limits = Limits {
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
        limits: Limits,
    ) -> io::Result<Self> {
        let origins: Arc<[String]> = origins.into();
        let proxy = Self {
            port: listener.local_addr()?.port(),
            clients: Arc::new(()),
        };
        let clients = Arc::clone(&proxy.clients);
        thread::Builder::new().spawn(move || {
            for client in listener.incoming() {
                let Ok(mut client) = client else {
                    thread::sleep(RETRY_EVERY);
                    continue;
                };
                if Arc::strong_count(&clients) - 2 >= limits.clients {
                    // A request that was not read would reset the connection and lose the answer, which fits into the
                    // socket's buffer.
                    let _ = client.set_read_timeout(Some(RETRY_EVERY));
                    let _ = client.read(&mut [0; 4096]);
                    let why = format!("the bridge serves {} clients already\n", limits.clients);
                    let _ = refuse(&mut client, "503 Service Unavailable", &why);
                    continue;
                }
                let (origins, clients) = (Arc::clone(&origins), Arc::clone(&clients));
                // Without a thread, the client is disconnected.
                let _ = thread::Builder::new().spawn(move || {
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

/// A random loopback address.
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
        stream.set_write_timeout(Some(idle))?;
    }
    client.set_read_timeout(None)?;
    server.set_read_timeout(Some(idle))?;
    server.write_all(&head)?;
    let (from_client, to_server) = (client.try_clone()?, server.try_clone()?);
    thread::Builder::new().spawn(move || forward(from_client, to_server))?;
    forward(server, client);
    Ok(())
}

/// Forwards everything until one side ends, and then ends the direction; ends the connection if it is idle or broken.
fn forward(mut from: TcpStream, mut to: TcpStream) {
    let sides = match io::copy(&mut from, &mut to) {
        Ok(_) => Shutdown::Write,
        Err(_) => Shutdown::Both,
    };
    // The other side may have ended, too.
    let _ = to.shutdown(sides);
    if sides == Shutdown::Both {
        let _ = from.shutdown(sides);
    }
}

fn refuse(client: &mut TcpStream, status: &str, why: &str) -> io::Result<()> {
    write!(
        client,
        "HTTP/1.1 {status}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{why}",
        why.len()
    )
}

/// Fails with the first unknown origin of a request.
fn check_origins(head: &[u8], origins: &[String]) -> Result<(), String> {
    let text = String::from_utf8_lossy(head);
    let headers = text.lines().skip(1).take_while(|line| !line.is_empty());
    for (name, origin) in headers.filter_map(|line| line.split_once(':')) {
        let origin = origin.trim();
        let is_origin = name.trim().eq_ignore_ascii_case("origin");
        if is_origin && !is_known(origin) && !origins.iter().any(|known| known == origin) {
            return Err(origin.escape_default().to_string());
        }
    }
    Ok(())
}

/// Whether an origin is the app's, or a page of this machine.
fn is_known(origin: &str) -> bool {
    let is_port = |text: &str| text.parse::<u16>().is_ok();
    let is_end = |end: &str| end.is_empty() || end.strip_prefix(':').is_some_and(is_port);
    let secure = origin.strip_prefix("https://");
    let address = secure.or_else(|| origin.strip_prefix("http://"));
    let ends = ["localhost", "127.0.0.1", "[::1]"].map(|host| address?.strip_prefix(host));
    origin == APP || ends.into_iter().flatten().any(is_end)
}

#[cfg(test)]
mod tests {
    use super::*;

    const REQUEST: &[u8] = b"GET / HTTP/1.1\r\n\r\n";

    /// A proxy in front of a server that accepts connections and stays silent.
    fn proxy(clients: usize, idle: Duration) -> (OriginProxy, TcpListener) {
        let listen = || TcpListener::bind(("127.0.0.1", 0)).unwrap();
        let server = listen();
        let address = server.local_addr().unwrap();
        let limits = Limits { clients, idle };
        let proxy = OriginProxy::open(listen(), address, &[], limits).unwrap();
        (proxy, server)
    }

    fn connect(proxy: &OriginProxy) -> TcpStream {
        let mut client = TcpStream::connect(("127.0.0.1", proxy.port)).unwrap();
        client.write_all(REQUEST).unwrap();
        client
    }

    #[test]
    fn one_client_too_many_is_refused_until_another_one_leaves() {
        let (proxy, server) = proxy(2, LIMITS.idle);
        let served = [(); 2].map(|()| (connect(&proxy), server.accept().unwrap().0));
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
        let (proxy, server) = proxy(LIMITS.clients, Duration::from_millis(50));
        let mut client = connect(&proxy);
        let (mut at_server, _) = server.accept().unwrap();
        assert_eq!(client.read(&mut [0]).unwrap(), 0);
        let mut head = Vec::new();
        at_server.read_to_end(&mut head).unwrap();
        assert_eq!(head, REQUEST);
    }

    #[test]
    fn only_the_app_and_pages_of_this_machine_are_known() {
        let known = "https://app.foxglove.dev http://localhost http://localhost:8080 https://127.0.0.1:1 http://[::1]:80";
        assert_eq!(known.split(' ').find(|origin| !is_known(origin)), None);
        let unknown = "null  http://app.foxglove.dev https://app.foxglove.dev.evil.example https://evil.example \
            http://localhost.evil.example http://localhost:80.evil.example http://127.0.0.1.evil.example ws://localhost";
        assert_eq!(unknown.split(' ').find(|origin| is_known(origin)), None);
    }

    #[test]
    fn every_origin_of_a_request_must_be_known_however_it_is_written() {
        let evil = "https://evil.example";
        for (headers, allowed, is_refused) in [
            ("ORIGIN:  http://localhost:5 \r\n", "", false),
            (
                "origin: http://[::1]\r\nOrigin: https://evil.example\r\n",
                "",
                true,
            ),
            ("Origin: https://evil.example\r\n", evil, false),
        ] {
            let head = format!("GET / HTTP/1.1\r\nHost: x\r\n{headers}\r\nOrigin: in the body");
            let refused = check_origins(head.as_bytes(), &[allowed.to_owned()]);
            assert_eq!(refused.err().as_deref(), is_refused.then_some(evil));
        }
    }
}
