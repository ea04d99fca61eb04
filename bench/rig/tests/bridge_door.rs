//! What reaches the bridge's port besides clients of its protocol.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::collections::BTreeSet;
use std::fs;
use std::io::{Read as _, Write as _};
use std::net::{Shutdown, TcpStream};
use std::os::linux::fs::MetadataExt as _;
use std::time::{Duration, Instant};

use crate::rig::Rig;
use rustix::process::Signal;

/// How long the door may take to send somebody away: a head has 5 s to come.
const PATIENCE: Duration = Duration::from_secs(60);

/// Addresses on which a process listens for TCP, as the kernel writes them: hexadecimal, of IPv4 the last byte first.
fn listens(pid: u32) -> Vec<String> {
    let descriptors = fs::read_dir(format!("/proc/{pid}/fd")).unwrap();
    let inodes: BTreeSet<String> = descriptors
        .filter_map(|entry| fs::metadata(entry.ok()?.path()).ok())
        .map(|metadata| metadata.st_ino().to_string())
        .collect();
    let listening = |table: String| -> Vec<String> {
        table
            .lines()
            .map(|line| line.split_whitespace().collect::<Vec<_>>())
            .filter(|fields| fields.len() > 9 && fields[3] == "0A" && inodes.contains(fields[9]))
            .map(|fields| fields[1].to_owned())
            .collect()
    };
    ["tcp", "tcp6"]
        .iter()
        .flat_map(|table| listening(fs::read_to_string(format!("/proc/{pid}/net/{table}")).unwrap()))
        .collect()
}

/// Sends bytes and waits to be sent away; what was said before.
fn sent_away(port: u16, bytes: &[u8], ends: bool) -> String {
    let mut client = TcpStream::connect(("127.0.0.1", port)).unwrap();
    client.set_read_timeout(Some(PATIENCE)).unwrap();
    // The door may close while it is still being written to.
    let _ = client.write_all(bytes);
    if ends {
        let _ = client.shutdown(Shutdown::Write);
    }
    let mut said = Vec::new();
    let (begin, read) = (Instant::now(), client.read_to_end(&mut said));
    assert!(begin.elapsed() < PATIENCE, "it is not sent away: {read:?}");
    String::from_utf8_lossy(&said).into_owned()
}

#[test]
fn it_listens_on_this_machine_alone_and_outlives_what_is_no_request() {
    let rig = Rig::new("door");
    let flight = rig.take_off(&["--rt", "off", "--duration", "600s"]);
    let bridge = rig.start("bridge", &["foxglove", "--port", "0"]);
    bridge.await_output("Ctrl-C ends");
    let said = bridge.stdout();
    let port: u16 = said.split("ws://127.0.0.1:").nth(1).unwrap().split(',').next().unwrap().parse().unwrap();
    let addresses = listens(bridge.pid());
    assert!(addresses.iter().any(|address| address.ends_with(&format!(":{port:04X}"))), "{addresses:?}");
    for address in &addresses {
        let host = address.split(':').next().unwrap();
        assert!(host.len() == 8 && host.ends_with("7F"), "{address} is no address of 127.0.0.0/8: {addresses:?}");
    }

    let endless = [b"GET / HTTP/1.1\r\n".to_vec(), b"X: y\r\n".repeat(50_000)].concat();
    for (bytes, ends) in [
        (&b""[..], true),
        (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03", true),
        (b"\0\0\0\0\r\n\r\n", true),
        (b"GET / HTTP/1.1\r\nUpgrade: websocket\r\nContent-Length: -1\r\n\r\n", true),
        (b"GET /\r\n\r\n", true),
        (b"POST / HTTP/9.9\r\nHost: \xff\xfe\r\n\r\n\x81\xff\xff\xff\xff\xff\xff\xff\xff\xff", true),
        (&endless, false),
        // It never ends its head.
        (b"GET / HTTP/1.1\r\n", false),
    ] {
        let said = sent_away(port, bytes, ends);
        assert!(!said.starts_with("HTTP/1.1 101"), "{}", String::from_utf8_lossy(&bytes[..bytes.len().min(80)]));
    }
    let evil = sent_away(port, b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://rebound.example\r\n\r\n", false);
    assert!(evil.starts_with("HTTP/1.1 403 "), "{evil}");
    rig.run("params", &["--json"]).expect(0);
    flight.signal(Signal::INT);
    let ended = bridge.end().expect(0).says("the flight has ended: interrupted\n");
    assert!(!ended.stderr.contains("panicked"), "{ended}");
    flight.end().expect(130);
    rig.assert_nothing_left();
}
