//! The live page: what a browser shows of a flight and changes in it, and what its server refuses.
//!
//! The browser is Chromium, as for report.html; other tests speak to the server as the page does.

use std::collections::VecDeque;
use std::io::{BufRead as _, BufReader, Write as _};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::report_page::chromium;
use crate::rig::client::{answer, host, websocket};
use crate::rig::{Rig, Running, wait_until};
use serde_json::{Value, json};
use tungstenite::{Message, WebSocket};

/// Ends a test that hangs.
const TIMEOUT: Duration = Duration::from_secs(180);

/// A page without a browser: it reads what the server sends.
struct Page(WebSocket<TcpStream>);

impl Page {
    fn open(address: &str) -> Self {
        Self::of_origin(address, &format!("http://{}", host(address))).unwrap()
    }

    /// The status of the answer if it is refused.
    fn of_origin(address: &str, origin: &str) -> Result<Self, u16> {
        let url = format!("{}live", address.replace("http:", "ws:"));
        websocket(&url, &[("origin", origin)]).map(|(socket, _)| Self(socket))
    }

    /// The next text of a kind that has what is looked for.
    fn find<T>(&mut self, kind: &str, look: impl Fn(&Value) -> Option<T>) -> T {
        let until = Instant::now() + TIMEOUT;
        loop {
            assert!(Instant::now() < until, "waited in vain for {kind}");
            if let Message::Text(text) = self.0.read().unwrap() {
                let text: Value = serde_json::from_str(&text).unwrap();
                let found = (text["kind"] == kind).then(|| look(&text)).flatten();
                if let Some(found) = found {
                    return found;
                }
            }
        }
    }

    /// Injects something; whether it was accepted, and the words of the answer.
    fn inject(&mut self, what: &str) -> (bool, String) {
        let request = json!({"id": 1, "inject": what}).to_string();
        self.0.send(Message::text(request)).unwrap();
        self.find("answer", |it| {
            Some((it["ok"] == true, it["text"].as_str()?.to_owned()))
        })
    }
}

/// A browser with one page, driven by the DevTools protocol.
struct Browser {
    child: Child,
    socket: WebSocket<TcpStream>,
    session: Value,
    sent: u64,
    complaints: Vec<String>,
}

impl Browser {
    fn open(rig: &Rig, chromium: &str, address: &str) -> Self {
        let flags = "--headless=new --no-sandbox --disable-gpu --disable-dev-shm-usage --no-first-run \
            --remote-debugging-port=0";
        let mut child = Command::new(chromium)
            .args(flags.split_whitespace())
            .arg(format!("--user-data-dir={}", rig.file("profile")))
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut said = BufReader::new(child.stderr.take().unwrap()).lines();
        let url = said.find_map(|line| Some(line.unwrap().split_once("listening on ")?.1.into()));
        std::thread::spawn(move || said.for_each(drop));
        let url: String = url.unwrap();
        let (socket, _) = websocket(&url, &[]).unwrap();
        let mut browser = Self {
            child,
            socket,
            session: Value::Null,
            sent: 0,
            complaints: Vec::new(),
        };
        let target = browser.call("Target.createTarget", json!({"url": "about:blank"}));
        let target = json!({"targetId": target["targetId"], "flatten": true});
        browser.session = browser.call("Target.attachToTarget", target)["sessionId"].clone();
        browser.call("Runtime.enable", json!({}));
        browser.call("Log.enable", json!({}));
        browser.call("Page.navigate", json!({"url": address}));
        browser
    }

    fn call(&mut self, method: &str, params: Value) -> Value {
        self.sent += 1;
        let mut call = json!({"id": self.sent, "method": method, "params": params});
        if !self.session.is_null() {
            call["sessionId"] = self.session.clone();
        }
        self.socket.send(Message::text(call.to_string())).unwrap();
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else {
                continue;
            };
            let answer: Value = serde_json::from_str(&text).unwrap();
            if answer["id"] == self.sent {
                return answer["result"].clone();
            }
            let complaints = ["Runtime.exceptionThrown", "Log.entryAdded"];
            if complaints.iter().any(|method| answer["method"] == *method) {
                self.complaints.push(text.to_string());
            }
        }
    }

    fn run(&mut self, script: &str) -> Value {
        let params = json!({"expression": script, "returnByValue": true});
        self.call("Runtime.evaluate", params)["result"]["value"].clone()
    }

    /// Waits until a script is true.
    fn until(&mut self, script: &str) {
        wait_until(script, || (self.run(script) == true).then_some(()));
    }

    fn text(&mut self, id: &str) -> String {
        let text = self.run(&format!("document.getElementById('{id}').textContent"));
        text.as_str().unwrap().to_owned()
    }

    fn click(&mut self, label: &str) {
        let clicked = self.run(&format!(
            "document.querySelector('[aria-label=\"{label}\"]').click() ?? true"
        ));
        assert_eq!(clicked, true, "{label}");
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The address that a process has printed.
fn address(process: &Running) -> String {
    process.await_words("live page: http");
    let said = process.stdout() + &process.stderr();
    let (_, rest) = said.split_once("live page: ").unwrap();
    rest.split(' ').next().unwrap().to_owned()
}

#[test]
#[ignore = "long: part of the gate"]
fn a_browser_shows_a_flight_and_changes_it() {
    let Some(chromium) = chromium() else {
        return;
    };
    let rig = Rig::new("page");
    let config = rig.slow(2);
    let args = format!("--web --allow-control --channels 2 --duration 300s --config {config}");
    let flight = rig.take_off(args);
    let mut browser = Browser::open(&rig, &chromium, &address(&flight));
    browser.until("document.querySelector('#tile-phase .word')?.textContent === 'flying'");
    browser.until("document.getElementById('progress').value > 0");
    let clock = browser.text("clock");
    browser.until(&format!(
        "document.getElementById('clock').textContent !== '{clock}'"
    ));
    browser.until("document.querySelectorAll('#hist-loop tbody tr').length === 1");
    for width in [400, 1600] {
        let screen =
            json!({"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": false});
        browser.call("Emulation.setDeviceMetricsOverride", screen);
        browser.until("document.documentElement.scrollWidth <= innerWidth");
    }

    // A slider; its parameter is in force from the tick that the page names on.
    browser.run("(() => { const it = document.getElementById('parameter-mass_kg'); it.value = 520; it.dispatchEvent(new Event('change')); })()");
    browser.until(
        "document.querySelector('#parameters .answer').textContent.startsWith('applied at tick ')",
    );
    let applied = browser.run("document.querySelector('#parameters .answer').textContent");
    let applied = applied.as_str().unwrap().to_owned();
    let tick = applied.split(' ').nth(3).unwrap().parse::<u64>().unwrap();
    browser.until("document.querySelector('.parameter.changed label').textContent === 'mass_kg'");

    // A value out of range is refused with the reason.
    browser.run("document.getElementById('what').value = 'mass_kg=99'");
    browser.run("document.querySelector('#free button').click()");
    browser.until("/mass_kg = 99.*out of range.*0.05 to 5/.test(document.querySelector('#answers .bad-text')?.textContent)");

    browser.click("process a.inner: kill");
    browser
        .until("document.getElementById('answers').textContent.includes('a.inner.kill at tick ')");
    browser.until("document.getElementById('events').textContent.includes('channel b flies in place of channel a')");
    browser
        .until("document.getElementById('events').textContent.includes('was killed by the fault')");
    browser.until("!document.getElementById('channels').textContent.includes(' 0 handovers')");

    flight.interrupt().expect(130);
    browser.until("document.getElementById('banner').textContent.includes('The flight has ended: interrupted')");
    let banner = browser.text("banner");
    let report = rig.out().join("latest").canonicalize().unwrap();
    let path = report.join("report.html");
    assert!(banner.contains(path.to_str().unwrap()), "{banner}");
    assert_eq!(rig.report()["swaps"][0]["tick"], tick, "{applied}");
    // Files and styles that the policy forbids would be among them.
    assert_eq!(browser.complaints, [""; 0]);
}

#[test]
fn a_page_stays_for_the_next_flight_and_changes_nothing_unless_it_may() {
    let rig = Rig::new("page");
    let watch = rig.start("watch", "--web");
    let mut page = Page::open(&address(&watch));
    page.find("flight", |it| it["flight"].is_null().then_some(()));
    let mut runs = Vec::new();
    for _ in 0..2 {
        let flight = rig.take_off(format!("--duration 300s --config {}", rig.slow(2)));
        runs.push(page.find("flight", |it| {
            it["flight"]["run"].as_str().map(str::to_owned)
        }));
        page.find("pose", |it| (it["t"].as_f64()? > 0.1).then_some(()));
        let (accepted, why) = page.inject("mass_kg=0.6");
        assert!(!accepted && why.contains("--allow-control"), "{why}");
        flight.interrupt().expect(130);
        page.find("news", |it| {
            let flight = &it["flight"];
            let is_over = flight["phase"]["word"] == "ended" && flight["status"] == "INTERRUPTED";
            is_over.then(|| assert_eq!(flight["phase"]["why"], "interrupted"))
        });
        assert_eq!(rig.report()["swaps"], json!([]));
    }
    assert_ne!(runs[0], runs[1]);
    watch.interrupt().expect(130);
    rig.assert_nothing_left();
}

#[test]
fn the_last_news_of_a_flight_has_its_end_and_its_status() {
    let rig = Rig::new("page");
    let flight = rig.take_off("--web --duration 3s --on-death restart");
    let mut page = Page::open(&address(&flight));
    let mut last = Value::Null;
    while let Ok(message) = page.0.read() {
        if let Message::Text(text) = message {
            let text: Value = serde_json::from_str(&text).unwrap();
            if text["kind"] == "news" {
                last = text["flight"].clone();
            }
        }
    }
    assert_ne!(last["phase"]["word"], "flying", "{last}");
    assert!(last["status"].is_string(), "{last}");
    drop(flight.end());
}

#[test]
fn requests_that_do_not_know_the_address_are_refused() {
    let rig = Rig::new("page");
    let watch = rig.start("watch", "--web --allow-control");
    let address = address(&watch);
    let (own, path) = (host(&address), &address[7 + host(&address).len()..]);
    let get = |file: &str| format!("GET {path}{file}");
    let host = format!("Host: {own}");
    let [long, foreign, other_port, second] = [
        &format!("X: {}", "x".repeat(20_000)),
        "Origin: https://evil.example",
        "Origin: http://127.0.0.1:1",
        "Host: evil.example",
    ]
    .map(|more| format!("{host}\r\n{more}"));
    for (start, headers, status, words) in [
        (get(""), &*host, "200", "<!DOCTYPE html>"),
        (get("page.js"), &host, "200", "script-src 'self'"),
        (get("nothing"), &host, "404", "no such file"),
        (format!("POST {path}"), &host, "405", "GET"),
        (get("live"), &host, "400", "handshake"),
        ("GET /".into(), &host, "403", "token"),
        (format!("GET /{}/", "0".repeat(32)), &host, "403", "token"),
        (get("")[..path.len() + 2].into(), &host, "403", "token"),
        (get(""), "Host: evil.example", "403", "Host"),
        (get(""), "Host: 127.0.0.1", "403", "Host"),
        (get(""), &foreign, "403", "own page"),
        (get(""), &other_port, "403", "own page"),
        (get(""), &second, "400", "one Host"),
        (get(""), &long, "", ""),
        ("nonsense".into(), &host, "400", "no HTTP request"),
    ] {
        let request = format!("{start} HTTP/1.1\r\n{headers}\r\n\r\n");
        let text = answer(own, request.as_bytes(), false);
        let found = text.split(' ').nth(1).unwrap_or_default();
        assert_eq!(found, status, "{request}{text}");
        assert!(text.contains(words), "{request}{text}");
    }
    let refused = Page::of_origin(&address, "https://evil.example");
    assert_eq!(refused.err(), Some(403));
    let wrong = address.replace(path, "/wrong/");
    let refused = Page::of_origin(&wrong, &format!("http://{own}"));
    assert_eq!(refused.err(), Some(403));
    let mut page = Page::open(&address);
    page.0
        .send(Message::text("{\"id\": 1, \"run\": \"rm\"}"))
        .unwrap();
    page.find("answer", |it| (it["ok"] == false).then_some(()));
    let (accepted, why) = page.inject("mass_kg=0.6");
    assert!(!accepted && why.contains("no flight is running"), "{why}");
    watch.interrupt().expect(130);
}

#[test]
#[ignore = "long: part of the gate"]
fn many_pages_and_half_open_connections_do_no_harm_and_slow_pages_are_closed() {
    const HALF_OPEN: usize = 1000;
    let rig = Rig::new("page");
    let flight = rig.take_off(format!("--web --duration 300s --config {}", rig.slow(2)));
    let address = address(&flight);
    let slow = Page::open(&address);
    let mut pages: Vec<Page> = (0..20).map(|_| Page::open(&address)).collect();
    let mut open = VecDeque::new();
    for _ in 0..HALF_OPEN {
        let mut stream = TcpStream::connect(host(&address)).unwrap();
        // The server may have closed it for a newer one.
        let _ = stream.write_all(b"GET / HTTP/1.1\r\n");
        open.push_back(stream);
        // Descriptors of the test are limited, too.
        if open.len() > HALF_OPEN / 2 {
            open.pop_front();
        }
    }
    let mut last = Page::open(&address);
    let tick = |it: &Value| it["flight"]["tick"].as_u64();
    let seen = last.find("news", tick);
    let newest = last.find("news", |it| tick(it).filter(|tick| *tick > seen));
    pages.push(last);
    // The news after those count all pages and reach all that read; then these are all.
    std::thread::scope(|scope| {
        for page in &mut pages {
            let is_left =
                move |it: &Value| (it["pages"] == 21 && tick(it) > Some(newest)).then_some(());
            scope.spawn(move || page.find("news", is_left));
        }
    });
    drop((slow, open));
    flight.interrupt().expect(130);
    rig.assert_nothing_left();
}
