//! The server of the live page: HTTP and WebSocket on the loopback address, for requests that know the token.
//!
//! ```text
//!   connection --request--> Host, Origin, token --> file of the page
//!                             \--else--> 403          \--> WebSocket: texts of the hub; requests of the page
//! ```
//!
//! The token is the first part of the path. `Host` is checked because a foreign page can have a name that resolves to
//! this machine, and `Origin` because a browser lets every page open a WebSocket to it.

use std::collections::VecDeque;
use std::fs::File;
use std::hint::black_box;
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use rustix::net::sockopt::set_socket_send_buffer_size;
use tungstenite::handshake::derive_accept_key;
use tungstenite::protocol::frame::coding::CloseCode;
use tungstenite::protocol::{CloseFrame, Role, WebSocketConfig};
use tungstenite::{Error, Message, Utf8Bytes, WebSocket};

use crate::request_head::read_head;

const HEADERS: usize = 64;
/// Connections that may wait for their request or their answer; the oldest one makes room for the next.
const WAITING: usize = 64;
const PAGES: usize = 64;
/// Texts that a page may be behind.
const QUEUE: usize = 64;
/// How long a page may take to take a text.
const WRITE_TIMEOUT: Duration = Duration::from_secs(2);
/// How long to look for requests of a page before its next text.
const READ_TIMEOUT: Duration = Duration::from_millis(1);
/// How long to wait for a text before looking for requests.
const LOOK_EVERY: Duration = Duration::from_millis(100);
const SEND_BUFFER_BYTES: usize = 64 << 10;
/// Longest request of a page [bytes].
const REQUEST_BYTES: usize = 1024;
/// Requests that a page may send between two texts.
const REQUESTS: usize = 16;
const RETRY_EVERY: Duration = Duration::from_millis(100);
const CLOSE_TIMEOUT: Duration = Duration::from_secs(1);

pub(super) struct PageFile {
    pub(super) name: &'static str,
    pub(super) media_type: &'static str,
    pub(super) text: String,
}

/// Answers a request of the page with this number, at once or later, by [`Hub::send`].
pub(super) type Answer = dyn Fn(&Arc<Hub>, u64, &str) + Send + Sync;

/// The pages that are open.
#[derive(Default)]
pub(super) struct Hub {
    pages: Mutex<Vec<Page>>,
    /// Sessions, also of pages that are being closed.
    sessions: AtomicUsize,
    has_ended: AtomicBool,
}

struct Page {
    number: u64,
    texts: SyncSender<Utf8Bytes>,
    /// Whether the flight is still to be sent to it.
    is_new: bool,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Hub {
    pub(super) fn pages(&self) -> usize {
        lock(&self.pages).len()
    }

    pub(super) fn has_new_page(&self) -> bool {
        lock(&self.pages).iter().any(|page| page.is_new)
    }

    /// Sends the flight to the new pages or, if it is another one, to all.
    pub(super) fn welcome(&self, flight: &Utf8Bytes, is_another: bool) {
        lock(&self.pages).retain_mut(|page| {
            let is_new = std::mem::take(&mut page.is_new);
            !(is_new || is_another) || page.texts.try_send(flight.clone()).is_ok()
        });
    }

    /// Sends a text to all pages; those that are too far behind are closed.
    pub(super) fn broadcast(&self, text: &Utf8Bytes) {
        lock(&self.pages).retain(|page| page.texts.try_send(text.clone()).is_ok());
    }

    pub(super) fn send(&self, number: u64, text: Utf8Bytes) {
        let pages = lock(&self.pages);
        if let Some(page) = pages.iter().find(|page| page.number == number) {
            let _ = page.texts.try_send(text);
        }
    }

    /// Adds a page, unless there are too many.
    fn join(&self, number: u64) -> Option<Receiver<Utf8Bytes>> {
        let mut pages = lock(&self.pages);
        if pages.len() >= PAGES || self.has_ended.load(Ordering::Relaxed) {
            return None;
        }
        let (texts, receiver) = sync_channel(QUEUE);
        pages.push(Page {
            number,
            texts,
            is_new: true,
        });
        Some(receiver)
    }

    /// Closes all pages after their last text.
    pub(super) fn close(&self) {
        self.has_ended.store(true, Ordering::Relaxed);
        lock(&self.pages).clear();
        let until = Instant::now() + CLOSE_TIMEOUT;
        while self.sessions.load(Ordering::Relaxed) > 0 && Instant::now() < until {
            thread::sleep(CLOSE_TIMEOUT / 100);
        }
    }
}

pub(super) struct Server {
    pub(super) token: String,
    /// Values of `Host` that are accepted.
    hosts: [String; 2],
    files: Vec<PageFile>,
    hub: Arc<Hub>,
    answer: Box<Answer>,
    waiting: Mutex<VecDeque<(u64, TcpStream)>>,
}

/// A status line and why.
type Refusal = (&'static str, String);

enum Route<'a> {
    File(&'a PageFile),
    /// The answer to the key of the handshake.
    Live(String),
}

/// A token that cannot be guessed: 128 bits of the kernel's random numbers.
pub(super) fn random_token() -> io::Result<String> {
    let mut bytes = [0; 16];
    File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

impl Server {
    /// Serves the connections of a listener, which is on the loopback address.
    pub(super) fn open(
        listener: TcpListener,
        token: String,
        files: Vec<PageFile>,
        hub: Arc<Hub>,
        answer: Box<Answer>,
    ) -> io::Result<Arc<Self>> {
        let port = listener.local_addr()?.port();
        let server = Arc::new(Self {
            token,
            hosts: ["127.0.0.1", "localhost"].map(|host| format!("{host}:{port}")),
            files,
            hub,
            answer,
            waiting: Mutex::default(),
        });
        let accepting = Arc::clone(&server);
        thread::Builder::new().spawn(move || accepting.accept(&listener))?;
        Ok(server)
    }

    pub(super) fn address(&self) -> String {
        format!("http://{}/{}/", self.hosts[0], self.token)
    }

    fn accept(self: &Arc<Self>, listener: &TcpListener) {
        for (number, stream) in (0..).zip(listener.incoming()) {
            let twins = stream.and_then(|stream| Ok((stream.try_clone()?, stream)));
            let Ok((twin, stream)) = twins else {
                thread::sleep(RETRY_EVERY);
                continue;
            };
            let mut waiting = lock(&self.waiting);
            waiting.push_back((number, twin));
            if waiting.len() > WAITING
                && let Some((_, oldest)) = waiting.pop_front()
            {
                let _ = oldest.shutdown(Shutdown::Both);
            }
            drop(waiting);
            let server = Arc::clone(self);
            // Without a thread, the client is disconnected.
            let serve = move || {
                // A client that has gone or is too slow has no answer.
                let _ = server.serve(number, stream);
                server.is_served(number);
            };
            if thread::Builder::new().spawn(serve).is_err() {
                self.is_served(number);
            }
        }
    }

    /// Notes that a connection no longer waits.
    fn is_served(&self, number: u64) {
        lock(&self.waiting).retain(|(waiting, _)| *waiting != number);
    }

    fn serve(&self, number: u64, mut stream: TcpStream) -> io::Result<()> {
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(WRITE_TIMEOUT))?;
        let head = read_head(&mut stream)?;
        let mut headers = [httparse::EMPTY_HEADER; HEADERS];
        let mut request = httparse::Request::new(&mut headers);
        let (route, rest) = match request.parse(&head) {
            Ok(httparse::Status::Complete(length)) => (self.route(&request), &head[length..]),
            _ => {
                let why = "this is no HTTP request".into();
                (Err(("400 Bad Request", why)), &[][..])
            }
        };
        match route {
            Ok(Route::File(file)) => {
                self.respond(&mut stream, "200 OK", file.media_type, &file.text)
            }
            Ok(Route::Live(accepted)) => self.session(number, stream, &accepted, rest),
            Err((status, why)) => self.respond(
                &mut stream,
                status,
                "text/plain; charset=utf-8",
                &(why + "\n"),
            ),
        }
    }

    fn route(&self, request: &httparse::Request<'_, '_>) -> Result<Route<'_>, Refusal> {
        let values = |name: &'static str| {
            let of_name = request
                .headers
                .iter()
                .filter(move |it| it.name.eq_ignore_ascii_case(name));
            of_name.map(|it| std::str::from_utf8(it.value).unwrap_or("").trim())
        };
        let forbidden = |why: String| ("403 Forbidden", why);
        let host = values("host").collect::<Vec<_>>();
        let [host] = host[..] else {
            return Err(("400 Bad Request", "a request names one Host".into()));
        };
        if !self.hosts.iter().any(|known| known == host) {
            let hosts = self.hosts.join(" or ");
            return Err(forbidden(format!("this server's Host is {hosts}")));
        }
        let is_foreign = |origin: &str| origin.strip_prefix("http://") != Some(host);
        if values("origin").any(is_foreign) {
            return Err(forbidden("only this server's own page may do that".into()));
        }
        if request.method != Some("GET") {
            return Err(("405 Method Not Allowed", "only GET is served".into()));
        }
        let path = request.path.unwrap_or_default().trim_start_matches('/');
        let (token, name) = path.split_once('/').unwrap_or((path, ""));
        if !self.is_token(token) {
            let why = "wrong or missing token: open the whole address that ironbird printed";
            return Err(forbidden(why.into()));
        }
        if name == "live" {
            let key = values("sec-websocket-key").next();
            let is_version = values("sec-websocket-version").eq(["13"]);
            let accepted = key
                .filter(|_| is_version)
                .map(|key| derive_accept_key(key.as_bytes()));
            let no_handshake = || ("400 Bad Request", "a WebSocket handshake goes here".into());
            return accepted.map(Route::Live).ok_or_else(no_handshake);
        }
        let file = self.files.iter().find(|file| file.name == name);
        file.map(Route::File)
            .ok_or_else(|| ("404 Not Found", "there is no such file".into()))
    }

    /// Compares in the same time, wherever the first difference is.
    fn is_token(&self, given: &str) -> bool {
        let pairs = given.bytes().zip(self.token.bytes());
        let difference = pairs.fold(0, |sum, (a, b)| black_box(sum | (a ^ b)));
        given.len() == self.token.len() && difference == 0
    }

    fn respond(
        &self,
        stream: &mut TcpStream,
        status: &str,
        media_type: &str,
        text: &str,
    ) -> io::Result<()> {
        let [host, name] = &self.hosts;
        let length = text.len();
        write!(
            stream,
            "HTTP/1.1 {status}\r\nContent-Type: {media_type}\r\nContent-Length: {length}\r\nConnection: close\r\n\
             Cache-Control: no-store\r\nReferrer-Policy: no-referrer\r\nX-Content-Type-Options: nosniff\r\n\
             Cross-Origin-Resource-Policy: same-origin\r\nCross-Origin-Opener-Policy: same-origin\r\n\
             Content-Security-Policy: default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; \
             connect-src ws://{host} ws://{name}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'\r\n\r\n{text}"
        )?;
        stream.shutdown(Shutdown::Write)
    }

    /// Sends a page the texts of the hub, and takes its requests; `rest` came behind the handshake.
    fn session(
        &self,
        number: u64,
        mut stream: TcpStream,
        accepted: &str,
        rest: &[u8],
    ) -> io::Result<()> {
        let Some(texts) = self.hub.join(number) else {
            let why = format!("{PAGES} pages are open already\n");
            return self.respond(&mut stream, "503 Service Unavailable", "text/plain", &why);
        };
        self.is_served(number);
        self.hub.sessions.fetch_add(1, Ordering::Relaxed);
        let ended = self.exchange(number, stream, accepted, rest, &texts);
        lock(&self.hub.pages).retain(|page| page.number != number);
        self.hub.sessions.fetch_sub(1, Ordering::Relaxed);
        ended.map_err(io::Error::other)
    }

    fn exchange(
        &self,
        number: u64,
        mut stream: TcpStream,
        accepted: &str,
        rest: &[u8],
        texts: &Receiver<Utf8Bytes>,
    ) -> Result<(), Error> {
        write!(
            stream,
            "HTTP/1.1 101 Switching Protocols\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Accept: {accepted}\r\n\r\n"
        )?;
        stream.set_read_timeout(Some(READ_TIMEOUT))?;
        // The system's own buffers hold a minute of texts: a page that does not read would be noticed late.
        set_socket_send_buffer_size(&stream, SEND_BUFFER_BYTES).map_err(io::Error::from)?;
        let config = WebSocketConfig::default()
            .max_message_size(Some(REQUEST_BYTES))
            .max_frame_size(Some(REQUEST_BYTES));
        let mut socket =
            WebSocket::from_partially_read(stream, rest.to_vec(), Role::Server, Some(config));
        loop {
            match texts.recv_timeout(LOOK_EVERY) {
                Ok(text) => socket.send(Message::Text(text))?,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    let (code, reason) = match self.hub.has_ended.load(Ordering::Relaxed) {
                        true => (CloseCode::Away, "ironbird has ended"),
                        false => (CloseCode::Policy, "the page was too slow"),
                    };
                    socket.close(Some(CloseFrame {
                        code,
                        reason: reason.into(),
                    }))?;
                    return socket.flush();
                }
            }
            for _ in 0..REQUESTS {
                match socket.read() {
                    Ok(Message::Text(text)) => (self.answer)(&self.hub, number, &text),
                    Ok(_) => {}
                    Err(Error::Io(e))
                        if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) =>
                    {
                        break;
                    }
                    Err(e) => return Err(e),
                }
            }
        }
    }
}
