//! The Foxglove bridge: what clients get, what they may change, who is sent away.

use crate::rig::{Rig, Running};
use flight_log::TOPICS;
use flight_log::codec::decode;
use flight_log::telemetry::TELEMETRY_TOPICS;
use messages::content::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use messages::parameters::PARAMETERS;
use prost::Message as _;
use prost_types::FileDescriptorSet;
use rustix::process::Signal;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs;
use std::io::{Read as _, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::os::linux::fs::MetadataExt as _;
use std::time::{Duration, Instant};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::{HandshakeError, Message, WebSocket};

const PATIENCE: Duration = Duration::from_secs(60);

struct Client {
    socket: WebSocket<TcpStream>,
    /// Messages of subscriptions that came while a text was waited for.
    unread: VecDeque<Vec<u8>>,
    channels: BTreeMap<String, Value>,
    server: Value,
}

impl Client {
    fn connect(port: u16) -> Self {
        Self::of_page(port, None).unwrap()
    }

    /// A client that tells an origin, as a page in a browser does; the status where it is sent away.
    fn of_page(port: u16, origin: Option<&str>) -> Result<Self, u16> {
        let stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let mut request = format!("ws://127.0.0.1:{port}")
            .into_client_request()
            .unwrap();
        request
            .headers_mut()
            .insert("sec-websocket-protocol", "foxglove.sdk.v1".parse().unwrap());
        if let Some(origin) = origin {
            request
                .headers_mut()
                .insert("origin", origin.parse().unwrap());
        }
        let (socket, response) = match tungstenite::client(request, stream) {
            Ok(joined) => joined,
            Err(HandshakeError::Failure(tungstenite::Error::Http(response))) => {
                return Err(response.status().as_u16());
            }
            Err(e) => panic!("{e}"),
        };
        assert_eq!(
            response.headers()["sec-websocket-protocol"],
            "foxglove.sdk.v1"
        );
        let mut client = Self {
            socket,
            unread: VecDeque::new(),
            channels: BTreeMap::new(),
            server: Value::Null,
        };
        client.server = client.text("serverInfo");
        while client.channels.len() < TOPICS.len() + TELEMETRY_TOPICS.len() + 3 {
            for channel in client.text("advertise")["channels"].as_array().unwrap() {
                client.channels.insert(
                    channel["topic"].as_str().unwrap().to_owned(),
                    channel.clone(),
                );
            }
        }
        Ok(client)
    }

    fn send(&mut self, message: &Value) {
        self.socket
            .send(Message::text(message.to_string()))
            .unwrap();
    }

    /// The next text of an operation; other texts that come meanwhile are passed over.
    fn text(&mut self, op: &str) -> Value {
        loop {
            match self.socket.read().unwrap() {
                Message::Text(text) => {
                    let message: Value = serde_json::from_str(&text).unwrap();
                    if message["op"] == op {
                        return message;
                    }
                }
                // A swap may be heard of before its answer is.
                Message::Binary(bytes) => self.unread.push_back(bytes.into()),
                _ => {}
            }
        }
    }

    /// Subscribes to topics, the first of them by the number 1.
    fn subscribe(&mut self, topics: &[&str]) {
        let ids: Vec<Value> = topics
            .iter()
            .zip(1..)
            .map(|(topic, id)| json!({"id": id, "channelId": self.channels[*topic]["id"]}))
            .collect();
        self.send(&json!({"op": "subscribe", "subscriptions": ids}));
    }

    /// The next message of a subscription: its number, its time [ns since 1970], its content.
    fn data(&mut self) -> (u32, u64, Vec<u8>) {
        loop {
            if let Some(bytes) = self.unread.pop_front() {
                if bytes.first() == Some(&1) {
                    let id = u32::from_le_bytes(bytes[1..5].try_into().unwrap());
                    return (
                        id,
                        u64::from_le_bytes(bytes[5..13].try_into().unwrap()),
                        bytes[13..].to_vec(),
                    );
                }
            } else if let Message::Binary(bytes) = self.socket.read().unwrap() {
                self.unread.push_back(bytes.into());
            }
        }
    }

    /// What the server says until it closes the connection in order.
    fn farewell(mut self) -> String {
        let mut said = String::new();
        loop {
            match self.socket.read().unwrap() {
                Message::Text(text) => said += text.as_str(),
                Message::Close(_) => return said,
                _ => {}
            }
        }
    }

    /// Asks for parameters, sets some where `set` has them, and gives what comes back by name.
    fn values(&mut self, request: Value) -> BTreeMap<String, f64> {
        self.send(&request);
        loop {
            let answer = self.text("parameterValues");
            if answer["id"] == request["id"] {
                return by_name(&answer);
            }
        }
    }
}

fn by_name(answer: &Value) -> BTreeMap<String, f64> {
    let values = answer["parameters"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|p| p["name"] != "inject");
    values
        .map(|p| {
            (
                p["name"].as_str().unwrap().to_owned(),
                p["value"].as_f64().unwrap(),
            )
        })
        .collect()
}

/// A bridge on a free port, which it is asked for.
fn open(rig: &Rig, args: &[&str]) -> (Running, u16) {
    let bridge = rig.start("bridge", [&["foxglove", "--port", "0"], args].concat());
    bridge.await_output("Ctrl-C ends");
    let said = bridge.stdout();
    let port = said
        .split("ws://127.0.0.1:")
        .nth(1)
        .unwrap()
        .split(',')
        .next()
        .unwrap()
        .parse()
        .unwrap();
    (bridge, port)
}

fn take_off(rig: &Rig) -> Running {
    rig.take_off("--rt off --duration 600s")
}

fn land(rig: &Rig, flight: Running, bridge: Running) {
    flight.signal(Signal::INT);
    bridge
        .end()
        .expect(0)
        .says("the flight has ended: interrupted\n");
    flight.end().expect(130);
    rig.assert_nothing_left();
}

#[test]
fn topics_have_the_schemas_of_the_log_and_their_messages_decode() {
    let rig = Rig::with_features("topics");
    let flight = take_off(&rig);
    let (bridge, port) = open(&rig, &[]);
    let mut client = Client::connect(port);
    assert_eq!(client.server["name"], format!("ironbird {}", rig.instance));
    assert!(
        client.server["capabilities"]
            .as_array()
            .unwrap()
            .contains(&"parameters".into()),
        "{}",
        client.server
    );
    for topic in TOPICS {
        let channel = &client.channels[topic];
        assert_eq!(
            (&channel["encoding"], &channel["schemaEncoding"]),
            (&"protobuf".into(), &"protobuf".into())
        );
        let name = channel["schemaName"].as_str().unwrap();
        let set = FileDescriptorSet::decode(base64(channel["schema"].as_str().unwrap()).as_slice())
            .unwrap();
        let names: Vec<_> = set.file[0]
            .message_type
            .iter()
            .map(|m| format!("ironbird.{}", m.name()))
            .collect();
        assert!(
            names.iter().any(|known| known == name),
            "{name} in {names:?}"
        );
    }
    assert_eq!(
        client.channels["pose/actual"]["schemaName"],
        "foxglove.PoseInFrame"
    );
    assert_eq!(
        client.channels["transforms"]["schemaName"],
        "foxglove.FrameTransform"
    );

    client.subscribe(&[
        "state",
        "setpoint",
        "wrench",
        "rotor_speeds",
        "pose/actual",
        "transforms",
    ]);
    let mut seen: BTreeMap<u32, Vec<u64>> = BTreeMap::new();
    while (1..=6).any(|id| seen.get(&id).is_none_or(|ticks| ticks.len() < 3)) {
        let (id, time_ns, bytes) = client.data();
        let tick = match id {
            1 => decode::<State>(&bytes).unwrap().envelope.tick,
            2 => decode::<Setpoint>(&bytes).unwrap().envelope.tick,
            3 => decode::<Wrench>(&bytes).unwrap().envelope.tick,
            4 => decode::<RotorSpeeds>(&bytes).unwrap().envelope.tick,
            _ => time_ns,
        };
        // The wall clock, not that of the machine's start.
        assert!(time_ns > 1_600_000_000_000_000_000, "{time_ns}");
        seen.entry(id).or_default().push(tick);
    }
    for ticks in seen.values() {
        assert!(ticks.is_sorted(), "{ticks:?}");
    }
    assert!(decode::<SwapRecord>(&client.data().2).is_none());
    land(&rig, flight, bridge);
}

#[test]
fn what_the_laws_show_has_their_names_and_a_topic_that_stays_empty_says_why() {
    let rig = Rig::with_features("laws");
    let flight = rig.take_off("--rt off --duration 600s --outer estimating --inner geometric");
    let (bridge, port) = open(&rig, &[]);
    bridge.await_output(
        "topic theorem stays empty, not applicable: the inner law `geometric` has no theorem\n",
    );
    let mut client = Client::connect(port);
    let theorem = &client.channels["theorem"]["metadata"];
    assert_eq!(
        theorem["not_applicable"], "the inner law `geometric` has no theorem",
        "{:?}",
        client.channels
    );
    let fields = |topic: &str| -> Vec<String> {
        let schema = base64(client.channels[topic]["schema"].as_str().unwrap());
        let set = FileDescriptorSet::decode(schema.as_slice()).unwrap();
        set.file[0].message_type[0]
            .field
            .iter()
            .map(|field| field.name().to_owned())
            .collect()
    };
    assert_eq!(
        client.channels["outer_telemetry"]["schemaName"],
        "ironbird.OuterTelemetry"
    );
    assert_eq!(
        fields("outer_telemetry"),
        ["tick", "thrust_scale", "mass_kg", "drag_1_s"]
    );
    assert_eq!(
        fields("inner_telemetry")[..3],
        ["tick", "position_error_m", "attitude_error"]
    );
    client.subscribe(&["outer_telemetry"]);
    let (_, time_ns, bytes) = client.data();
    // A tag and a word for each; the law believes in the mass that flies.
    let words: Vec<[u8; 8]> = bytes
        .chunks(9)
        .map(|field| field[1..].try_into().unwrap())
        .collect();
    let mass_kg = f64::from_le_bytes(words[2]);
    assert!(
        words.len() == 4 && u64::from_le_bytes(words[0]) < 600_000,
        "{words:?}"
    );
    assert!(
        (mass_kg - 0.52).abs() < 0.05 && time_ns > 1_600_000_000_000_000_000,
        "{mass_kg} at {time_ns}"
    );
    land(&rig, flight, bridge);
}

fn base64(text: &str) -> Vec<u8> {
    let digit = |c: u8| match c {
        b'A'..=b'Z' => c - b'A',
        b'a'..=b'z' => c - b'a' + 26,
        b'0'..=b'9' => c - b'0' + 52,
        b'+' => 62,
        _ => 63,
    };
    let digits: Vec<u8> = text.bytes().filter(|c| *c != b'=').map(digit).collect();
    let bits = |chunk: &[u8]| {
        chunk
            .iter()
            .fold(0_u32, |bits, d| bits << 6 | u32::from(*d))
            << (6 * (4 - chunk.len()))
    };
    digits
        .chunks(4)
        .flat_map(|chunk| bits(chunk).to_be_bytes()[1..chunk.len()].to_vec())
        .collect()
}

#[test]
fn parameters_are_read_and_swapped_and_every_client_hears_of_it() {
    let rig = Rig::with_features("values");
    let flight = take_off(&rig);
    let (bridge, port) = open(&rig, &["--allow-swaps"]);
    let (mut client, mut other) = (Client::connect(port), Client::connect(port));
    let all = client.values(json!({"op": "getParameters", "parameterNames": [], "id": "all"}));
    assert_eq!(
        (all.len(), all["mass_kg"], all["rotor_inertia_kg_m2"]),
        (PARAMETERS, 0.52, 3.36e-5)
    );
    other.send(&json!({"op": "subscribeParameterUpdates", "parameterNames": ["mass_kg"]}));
    other.values(json!({"op": "getParameters", "parameterNames": ["mass_kg"], "id": "subscribed"}));
    client.subscribe(&["swaps"]);
    let set = client.values(json!({"op": "setParameters", "id": "set", "parameters": [
        {"name": "mass_kg", "value": 0.6, "type": "float64"}, {"name": "motor_time_constant_s", "value": 0}
    ]}));
    assert_eq!(
        set,
        BTreeMap::from([
            ("mass_kg".into(), 0.6),
            ("motor_time_constant_s".into(), 0.0)
        ])
    );
    let params = rig.run("params", "--json").json();
    assert_eq!(
        (&params[0]["name"], &params[0]["in_force"]),
        (&"mass_kg".into(), &0.6.into())
    );
    assert_eq!(
        by_name(&other.text("parameterValues")),
        BTreeMap::from([("mass_kg".into(), 0.6)])
    );
    let swap = decode::<SwapRecord>(&client.data().2).unwrap();
    let changed: Vec<_> = swap
        .content
        .changes()
        .map(|change| (change.parameter.name(), change.old, change.new))
        .collect();
    assert_eq!(
        changed,
        [("mass_kg", 0.52, 0.6), ("motor_time_constant_s", 0.0, 0.0)]
    );
    // Who else swaps is heard of as well.
    rig.ok("inject mass_kg=0.55");
    assert_eq!(
        by_name(&other.text("parameterValues")),
        BTreeMap::from([("mass_kg".into(), 0.55)])
    );
    let fault = json!([{"name": "inject", "value": "setpoint.drop=0.1 for 20ms"}]);
    client.send(&json!({"op": "setParameters", "id": "fault", "parameters": fault}));
    let said = client.text("parameterValues")["parameters"][0]["value"].to_string();
    assert!(said.starts_with("\"setpoint.drop=0.1 from tick "), "{said}");
    land(&rig, flight, bridge);
}

#[test]
fn what_the_plant_would_refuse_is_answered_with_what_is_in_force_and_why() {
    let rig = Rig::with_features("refused");
    let flight = take_off(&rig);
    let (bridge, port) = open(&rig, &["--allow-swaps"]);
    let mut client = Client::connect(port);
    for (name, value, why) in [
        (
            "mass_kg",
            json!(50),
            "mass_kg = 50 is out of range: allowed are 0.05 to 5.0 kg",
        ),
        (
            "mass_kg",
            json!("heavy"),
            "mass_kg = `heavy` is not a number",
        ),
        (
            "mas_kg",
            json!(0.6),
            "unknown parameter `mas_kg`; did you mean `mass_kg`?",
        ),
        (
            "inject",
            json!("setpoint.dorp=1"),
            "unknown fault `setpoint.dorp`; did you mean `setpoint.drop`?",
        ),
    ] {
        client.send(&json!({"op": "setParameters", "id": why, "parameters": [{"name": name, "value": value}]}));
        let status = client.text("status");
        assert!(
            status["message"].as_str().unwrap().contains(why),
            "{status}"
        );
        assert_eq!(status["level"], 2, "an error");
        let answer = client.text("parameterValues");
        assert_eq!(answer["id"], why);
        let expected = if name == "mass_kg" {
            BTreeMap::from([("mass_kg".to_owned(), 0.52)])
        } else {
            BTreeMap::new()
        };
        assert_eq!(by_name(&answer), expected);
    }
    client.send(&json!({"op": "getParameters", "parameterNames": ["mas_kg"], "id": "get"}));
    let status = client.text("status");
    assert!(
        status["message"]
            .as_str()
            .unwrap()
            .contains("did you mean `mass_kg`?"),
        "{status}"
    );
    assert_eq!(by_name(&client.text("parameterValues")), BTreeMap::new());
    let params = rig.run("params", "--json").json();
    assert_eq!(params[0]["in_force"], 0.52);
    land(&rig, flight, bridge);
}

#[test]
fn clients_swap_nothing_unless_they_are_allowed_to() {
    let rig = Rig::with_features("read-only");
    let flight = take_off(&rig);
    let (bridge, port) = open(&rig, &[]);
    assert!(
        bridge.stdout().contains(", read-only; Ctrl-C ends"),
        "{}",
        bridge.stdout()
    );
    let mut client = Client::connect(port);
    let all = client.values(json!({"op": "getParameters", "parameterNames": [], "id": "all"}));
    assert_eq!((all.len(), all["mass_kg"]), (PARAMETERS, 0.52));
    let wanted = json!([{"name": "mass_kg", "value": 0.6}]);
    client.send(&json!({"op": "setParameters", "id": "set", "parameters": wanted}));
    let status = client.text("status");
    assert!(
        status["message"]
            .as_str()
            .unwrap()
            .contains("read-only: start it with --allow-swaps"),
        "{status}"
    );
    assert_eq!(
        by_name(&client.text("parameterValues")),
        BTreeMap::from([("mass_kg".into(), 0.52)])
    );
    let params = rig.run("params", "--json").json();
    assert_eq!(params[0]["in_force"], 0.52);
    // As soon as they are, the same wish is granted.
    let (second, port) = open(&rig, &["--allow-swaps"]);
    assert!(
        second
            .stdout()
            .contains(", whoever reaches it may swap parameters; "),
        "{}",
        second.stdout()
    );
    let set = Client::connect(port)
        .values(json!({"op": "setParameters", "id": "set", "parameters": wanted}));
    assert_eq!(set, BTreeMap::from([("mass_kg".into(), 0.6)]));
    second.signal(Signal::INT);
    second.end().expect(130);
    land(&rig, flight, bridge);
}

#[test]
fn pages_of_other_origins_are_sent_away() {
    let rig = Rig::with_features("origins");
    let flight = take_off(&rig);
    let (bridge, port) = open(&rig, &["--allow-origin", "https://studio.example:8080"]);
    let status =
        |origin: Option<&str>| Client::of_page(port, origin).map_or_else(|status| status, |_| 101);
    for known in [
        "https://app.foxglove.dev",
        "http://localhost:3000",
        "https://studio.example:8080",
    ] {
        assert_eq!(status(Some(known)), 101, "{known}");
    }
    for unknown in [
        "https://evil.example",
        "null",
        "https://studio.example",
        "http://localhost.evil.example",
    ] {
        assert_eq!(status(Some(unknown)), 403, "{unknown}");
        assert!(
            bridge
                .stderr()
                .contains(&format!("refused a page of {unknown}; ")),
            "{}",
            bridge.stderr()
        );
    }
    assert_eq!(status(None), 101, "a program tells none");
    for wrong in [
        "*",
        "studio.example",
        "https://studio.example/",
        "https://*.example",
    ] {
        let refused = rig.refused(&format!("bridge foxglove --allow-origin {wrong}"));
        refused
            .complains(&format!("invalid value '{wrong}'"))
            .complains("as in https://studio.example:8080");
    }
    land(&rig, flight, bridge);
}

#[test]
fn ctrl_c_ends_it_and_the_flight_flies_on() {
    let rig = Rig::with_features("ctrlc");
    let flight = take_off(&rig);
    let (bridge, port) = open(&rig, &[]);
    let mut client = Client::connect(port);
    client.subscribe(&["state"]);
    client.data();
    bridge.signal(Signal::INT);
    bridge.end().expect(130);
    client.farewell();
    rig.ok("inject mass_kg=0.6");
    let (bridge, _) = open(&rig, &[]);
    land(&rig, flight, bridge);
}

#[test]
fn every_client_hears_how_the_flight_ended() {
    let rig = Rig::with_features("farewell");
    let flight = take_off(&rig);
    let (bridge, port) = open(&rig, &[]);
    let mut clients: Vec<Client> = (0..3).map(|_| Client::connect(port)).collect();
    clients[0].subscribe(&["state"]);
    clients[0].data();
    land(&rig, flight, bridge);
    for client in clients {
        let said = client.farewell();
        assert!(said.contains("the flight has ended: interrupted"), "{said}");
    }
}

#[test]
fn addresses_that_cannot_be_served_are_named() {
    let rig = Rig::with_features("address");
    rig.run("bridge", "foxglove")
        .expect(1)
        .complains("no flight is running as instance")
        .complains("ironbird fly");
    rig.assert_nothing_started();
    let flight = take_off(&rig);
    let other = TcpListener::bind(("127.0.0.1", 0)).unwrap();
    let port = other.local_addr().unwrap().port().to_string();
    let refused = rig
        .run("bridge", format!("foxglove --port {port}"))
        .expect(5);
    refused
        .complains(&format!(
            "cannot serve on 127.0.0.1:{port}: the port is in use"
        ))
        .complains("--port 0");
    // Of a network that is for documents alone.
    let refused = rig.refused("bridge foxglove --host 192.0.2.1");
    refused
        .complains("cannot serve on 192.0.2.1:8765")
        .complains("--host is a name or an address of this machine");
    rig.refused("bridge foxglove --port 70000")
        .complains("70000");
    flight.signal(Signal::INT);
    flight.end().expect(130);
    rig.assert_nothing_left();
}

/// How long the door may take to send somebody away: a head has 5 s to come.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(60);

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
        .flat_map(|table| {
            listening(fs::read_to_string(format!("/proc/{pid}/net/{table}")).unwrap())
        })
        .collect()
}

/// Sends bytes and waits to be sent away; what was said before.
fn sent_away(port: u16, bytes: &[u8], ends: bool) -> String {
    let mut client = TcpStream::connect(("127.0.0.1", port)).unwrap();
    client.set_read_timeout(Some(ANSWER_TIMEOUT)).unwrap();
    // The door may close while it is still being written to.
    let _ = client.write_all(bytes);
    if ends {
        let _ = client.shutdown(Shutdown::Write);
    }
    let mut said = Vec::new();
    let (begin, read) = (Instant::now(), client.read_to_end(&mut said));
    assert!(
        begin.elapsed() < ANSWER_TIMEOUT,
        "it is not sent away: {read:?}"
    );
    String::from_utf8_lossy(&said).into_owned()
}

#[test]
fn it_listens_on_this_machine_alone_and_outlives_what_is_no_request() {
    let rig = Rig::with_features("door");
    let flight = rig.take_off("--rt off --duration 600s");
    let bridge = rig.start("bridge", "foxglove --port 0");
    bridge.await_output("Ctrl-C ends");
    let said = bridge.stdout();
    let port: u16 = said
        .split("ws://127.0.0.1:")
        .nth(1)
        .unwrap()
        .split(',')
        .next()
        .unwrap()
        .parse()
        .unwrap();
    let addresses = listens(bridge.pid());
    assert!(
        addresses
            .iter()
            .any(|address| address.ends_with(&format!(":{port:04X}"))),
        "{addresses:?}"
    );
    for address in &addresses {
        let host = address.split(':').next().unwrap();
        assert!(
            host.len() == 8 && host.ends_with("7F"),
            "{address} is no address of 127.0.0.0/8: {addresses:?}"
        );
    }

    let endless = [b"GET / HTTP/1.1\r\n".to_vec(), b"X: y\r\n".repeat(50_000)].concat();
    for (bytes, ends) in [
        (&b""[..], true),
        (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03", true),
        (b"\0\0\0\0\r\n\r\n", true),
        (
            b"GET / HTTP/1.1\r\nUpgrade: websocket\r\nContent-Length: -1\r\n\r\n",
            true,
        ),
        (b"GET /\r\n\r\n", true),
        (
            b"POST / HTTP/9.9\r\nHost: \xff\xfe\r\n\r\n\x81\xff\xff\xff\xff\xff\xff\xff\xff\xff",
            true,
        ),
        (&endless, false),
        // It never ends its head.
        (b"GET / HTTP/1.1\r\n", false),
    ] {
        let said = sent_away(port, bytes, ends);
        assert!(
            !said.starts_with("HTTP/1.1 101"),
            "{}",
            String::from_utf8_lossy(&bytes[..bytes.len().min(80)])
        );
    }
    let evil = sent_away(
        port,
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://rebound.example\r\n\r\n",
        false,
    );
    assert!(evil.starts_with("HTTP/1.1 403 "), "{evil}");
    rig.ok("params --json");
    flight.signal(Signal::INT);
    let ended = bridge
        .end()
        .expect(0)
        .says("the flight has ended: interrupted\n");
    assert!(!ended.stderr.contains("panicked"), "{ended}");
    flight.end().expect(130);
    rig.assert_nothing_left();
}
