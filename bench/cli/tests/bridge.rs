//! The Foxglove bridge: what clients get, what they may change, which ones are refused.

use crate::rig::client::{answer, websocket};
use crate::rig::{Rig, Running, wait_until};
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
use std::net::TcpStream;
use std::os::linux::fs::MetadataExt as _;
use tungstenite::{Message, WebSocket};

struct Client {
    socket: WebSocket<TcpStream>,
    /// Messages of subscriptions that came while a text was awaited.
    unread: VecDeque<Vec<u8>>,
    channels: BTreeMap<String, Value>,
    server: Value,
}

impl Client {
    fn connect(port: u16) -> Self {
        Self::of_page(port, None).unwrap()
    }

    /// A client that names an origin, as a page in a browser does; the status if it is refused.
    fn of_page(port: u16, origin: Option<&str>) -> Result<Self, u16> {
        let protocol = ("sec-websocket-protocol", "foxglove.sdk.v1");
        let origin = origin.map(|it| ("origin", it));
        let headers: Vec<_> = [protocol].into_iter().chain(origin).collect();
        let (socket, response) = websocket(&format!("ws://127.0.0.1:{port}"), &headers)?;
        assert_eq!(response.headers()[protocol.0], protocol.1);
        let mut client = Self {
            socket,
            unread: VecDeque::new(),
            channels: BTreeMap::new(),
            server: Value::Null,
        };
        client.server = client.text("serverInfo");
        while client.channels.len() < TOPICS.len() + TELEMETRY_TOPICS.len() + 3 {
            for channel in client.text("advertise")["channels"].as_array().unwrap() {
                let topic = channel["topic"].as_str().unwrap();
                client.channels.insert(topic.to_owned(), channel.clone());
            }
        }
        Ok(client)
    }

    fn send(&mut self, message: &Value) {
        let message = Message::text(message.to_string());
        self.socket.send(message).unwrap();
    }

    /// The next text of an operation; other texts that come meanwhile are skipped.
    fn text(&mut self, op: &str) -> Value {
        loop {
            match self.socket.read().unwrap() {
                Message::Text(text) => {
                    let message: Value = serde_json::from_str(&text).unwrap();
                    if message["op"] == op {
                        return message;
                    }
                }
                // The message of a swap may come before its answer.
                Message::Binary(bytes) => self.unread.push_back(bytes.into()),
                _ => {}
            }
        }
    }

    /// Subscribes to topics, the first of them by the number 1.
    fn subscribe(&mut self, topics: &[&str]) {
        let channel =
            |(topic, id): (&&str, u32)| json!({"id": id, "channelId": self.channels[*topic]["id"]});
        let ids: Vec<Value> = topics.iter().zip(1..).map(channel).collect();
        self.send(&json!({"op": "subscribe", "subscriptions": ids}));
    }

    /// The next message of a subscription: its number, its time [ns since 1970], its content.
    fn data(&mut self) -> (u32, u64, Vec<u8>) {
        loop {
            if let Some(bytes) = self.unread.pop_front() {
                if bytes.first() == Some(&1) {
                    let id = u32::from_le_bytes(bytes[1..5].try_into().unwrap());
                    let time_ns = u64::from_le_bytes(bytes[5..13].try_into().unwrap());
                    // 2020 [ns since 1970]: times are those of the wall clock, not those since the machine's start.
                    assert!(time_ns > 1_600_000_000_000_000_000, "{time_ns}");
                    return (id, time_ns, bytes[13..].to_vec());
                }
            } else if let Message::Binary(bytes) = self.socket.read().unwrap() {
                self.unread.push_back(bytes.into());
            }
        }
    }

    fn last_texts(mut self) -> String {
        let mut texts = String::new();
        loop {
            match self.socket.read().unwrap() {
                Message::Text(text) => texts += text.as_str(),
                Message::Close(_) => return texts,
                _ => {}
            }
        }
    }

    /// Gets parameters; none stand for all.
    fn get(&mut self, names: &[&str]) -> BTreeMap<String, f64> {
        self.values(&json!({"op": "getParameters", "parameterNames": names, "id": "get"}))
    }

    fn set(&mut self, parameters: &Value) -> BTreeMap<String, f64> {
        self.values(&json!({"op": "setParameters", "id": "set", "parameters": parameters}))
    }

    fn values(&mut self, request: &Value) -> BTreeMap<String, f64> {
        self.send(request);
        loop {
            let answer = self.text("parameterValues");
            if answer["id"] == request["id"] {
                return by_name(&answer);
            }
        }
    }

    /// Sets a parameter, which is refused with an error; returns the values of the answer.
    fn refused(&mut self, name: &str, value: &Value, why: &str) -> BTreeMap<String, f64> {
        let parameters = json!([{"name": name, "value": value}]);
        self.send(&json!({"op": "setParameters", "id": why, "parameters": parameters}));
        let status = self.text("status");
        assert!(
            status["message"].as_str().unwrap().contains(why),
            "{status}"
        );
        assert_eq!(status["level"], 2, "an error");
        let answer = self.text("parameterValues");
        assert_eq!(answer["id"], why);
        by_name(&answer)
    }

    fn fields(&self, topic: &str) -> Vec<String> {
        let set = self.descriptors(topic);
        let fields = set.file[0].message_type[0].field.iter();
        fields.map(|field| field.name().to_owned()).collect()
    }

    fn descriptors(&self, topic: &str) -> FileDescriptorSet {
        let schema = self.channels[topic]["schema"].as_str().unwrap();
        let schema = data_encoding::BASE64.decode(schema.as_bytes()).unwrap();
        FileDescriptorSet::decode(schema.as_slice()).unwrap()
    }
}

/// Values by name, without that of `inject`.
fn by_name(answer: &Value) -> BTreeMap<String, f64> {
    let values = answer["parameters"].as_array().unwrap().iter();
    let value = |it: &Value| Some((it["name"].as_str()?.to_owned(), it["value"].as_f64()?));
    values.filter_map(value).collect()
}

fn mass(mass_kg: f64) -> BTreeMap<String, f64> {
    BTreeMap::from([("mass_kg".to_owned(), mass_kg)])
}

/// A bridge on a free port, and the port.
fn open(rig: &Rig, args: &str) -> (Running, u16) {
    let bridge = rig.start("bridge", format!("foxglove --port 0 {args}"));
    bridge.await_words("Ctrl-C ends");
    let printed = bridge.stdout();
    let (_, port) = printed.split_once("ws://127.0.0.1:").unwrap();
    let (port, _) = port.split_once(',').unwrap();
    (bridge, port.parse().unwrap())
}

fn flown(name: &str, laws: &str, args: &str) -> (Rig, Running, Running, u16) {
    let rig = Rig::with_features(name);
    let flight = rig.take_off(format!("--rt off --duration 600s {laws}"));
    let (bridge, port) = open(&rig, args);
    bridge.await_words("serving a flight");
    (rig, flight, bridge, port)
}

fn land(rig: &Rig, flight: Running, bridge: Running) {
    flight.signal(Signal::INT);
    bridge.await_words("the flight has ended: interrupted\n");
    bridge.signal(Signal::INT);
    let ended = bridge.end().expect(130);
    assert!(!ended.stderr.contains("panicked"), "{ended}");
    flight.end().expect(130);
    rig.assert_nothing_left();
}

#[test]
fn topics_have_the_schemas_of_the_log_and_their_messages_decode() {
    let laws = "--outer estimating --inner geometric";
    let (rig, flight, bridge, port) = flown("topics", laws, "");
    let why = "the inner law `geometric` has no theorem";
    let line = format!("topic theorem stays empty, not applicable: {why}\n");
    bridge.await_words(&line);
    let mut client = Client::connect(port);
    assert_eq!(client.server["name"], format!("ironbird {}", rig.instance));
    let capabilities = client.server["capabilities"].as_array().unwrap();
    assert!(capabilities.contains(&"parameters".into()));
    for topic in TOPICS {
        let channel = &client.channels[topic];
        let encodings = [&channel["encoding"], &channel["schemaEncoding"]];
        assert_eq!(encodings, ["protobuf", "protobuf"]);
        let set = client.descriptors(topic);
        let mut types = set.file[0].message_type.iter();
        let name = channel["schemaName"].as_str().unwrap();
        assert!(types.any(|it| format!("ironbird.{}", it.name()) == name));
    }
    for (topic, path, expected) in [
        ("pose/actual", "/schemaName", "foxglove.PoseInFrame"),
        ("transforms", "/schemaName", "foxglove.FrameTransform"),
        ("outer_telemetry", "/schemaName", "ironbird.OuterTelemetry"),
        ("theorem", "/metadata/not_applicable", why),
    ] {
        let found = client.channels[topic].pointer(path).unwrap();
        assert_eq!(found, expected, "{topic}");
    }
    // The layout in the examples plots fields that there are.
    let layout = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../examples/foxglove-layout.json"
    );
    let layout: Value = serde_json::from_slice(&fs::read(layout).unwrap()).unwrap();
    for panel in layout["configById"].as_object().unwrap().values() {
        for path in panel["paths"].as_array().into_iter().flatten() {
            let path = path["value"].as_str().unwrap();
            let (topic, field) = path.split_once('.').unwrap();
            let field = field.split(['.', '[']).next().unwrap();
            let set = client.descriptors(topic);
            let mut types = set.file[0].message_type.iter();
            let has = types.any(|it| it.field.iter().any(|it| it.name() == field));
            assert!(has, "{path}");
        }
    }
    let outer = ["tick", "thrust_scale", "mass_kg", "drag_1_s"];
    assert_eq!(client.fields("outer_telemetry"), outer);
    let inner = ["tick", "position_error_m", "attitude_error"];
    assert_eq!(client.fields("inner_telemetry")[..3], inner);
    let topics = "state setpoint wrench rotor_speeds pose/actual transforms outer_telemetry";
    client.subscribe(&topics.split(' ').collect::<Vec<_>>());
    let mut seen = [const { Vec::new() }; 7];
    while seen.iter().any(|ticks: &Vec<u64>| ticks.len() < 3) {
        let (id, time_ns, bytes) = client.data();
        seen[id as usize - 1].push(match id {
            1 => decode::<State>(&bytes).unwrap().envelope.tick,
            2 => decode::<Setpoint>(&bytes).unwrap().envelope.tick,
            3 => decode::<Wrench>(&bytes).unwrap().envelope.tick,
            4 => decode::<RotorSpeeds>(&bytes).unwrap().envelope.tick,
            // A tag and eight bytes for each of four fields.
            7 => u64::from_le_bytes(bytes[1..9].try_into().unwrap()),
            _ => time_ns,
        });
    }
    assert!(seen.iter().all(|ticks| ticks.is_sorted()), "{seen:?}");
    land(&rig, flight, bridge);
}

#[test]
fn it_waits_for_a_flight_survives_its_end_and_serves_the_next() {
    let rig = Rig::with_features("flights");
    let (bridge, port) = open(&rig, "");
    let await_line = |line: &str, times| {
        wait_until(line, || {
            (bridge.stdout().matches(line).count() == times).then_some(())
        });
    };
    for flights in 1..=2 {
        let flight = rig.take_off("--rt off --duration 600s");
        await_line("serving a flight", flights);
        let mut client = Client::connect(port);
        client.subscribe(&["state"]);
        client.data();
        flight.interrupt().expect(130);
        await_line("the flight has ended", flights);
    }
    bridge.signal(Signal::INT);
    bridge.end().expect(130);
    rig.assert_nothing_left();
}

#[test]
fn parameters_are_read_and_changed_and_every_client_is_notified() {
    let (rig, flight, bridge, port) = flown("values", "", "--allow-swaps");
    let access = ", every client may change parameters; Ctrl-C ends";
    assert!(bridge.stdout().contains(access), "{}", bridge.stdout());
    let (mut client, mut other) = (Client::connect(port), Client::connect(port));
    let all = client.get(&[]);
    assert_eq!(all.len(), PARAMETERS);
    assert_eq!(
        (all["mass_kg"], all["rotor_inertia_kg_m2"]),
        (0.52, 3.36e-5)
    );
    other.send(&json!({"op": "subscribeParameterUpdates", "parameterNames": ["mass_kg"]}));
    other.get(&["mass_kg"]);
    client.subscribe(&["swaps"]);
    let set = client.set(&json!([
        {"name": "mass_kg", "value": 0.6, "type": "float64"}, {"name": "motor_time_constant_s", "value": 0}
    ]));
    let both = [
        ("mass_kg".to_owned(), 0.6),
        ("motor_time_constant_s".to_owned(), 0.0),
    ];
    assert_eq!(set, BTreeMap::from(both));
    assert_eq!(rig.run("params", "--json").json()[0]["in_force"], 0.6);
    assert_eq!(by_name(&other.text("parameterValues")), mass(0.6));
    let swap = decode::<SwapRecord>(&client.data().2).unwrap();
    let changes = swap.content.changes();
    let changes: Vec<_> = changes
        .map(|it| (it.parameter.name(), it.old, it.new))
        .collect();
    assert_eq!(
        changes,
        [("mass_kg", 0.52, 0.6), ("motor_time_constant_s", 0.0, 0.0)]
    );
    // Changes by others are passed on as well.
    rig.ok("inject mass_kg=0.55");
    assert_eq!(by_name(&other.text("parameterValues")), mass(0.55));
    let fault = json!([{"name": "inject", "value": "setpoint.drop=0.1 for 20ms"}]);
    client.send(&json!({"op": "setParameters", "id": "fault", "parameters": fault}));
    let answer = client.text("parameterValues")["parameters"][0]["value"].to_string();
    assert!(
        answer.starts_with("\"inner.setpoint.drop=0.1 from tick "),
        "{answer}"
    );
    for case in "mass_kg | 50 | mass_kg = 50 is out of range: allowed are 0.05 to 5.0 kg
        mass_kg | \"heavy\" | mass_kg = `heavy` is not a number
        mas_kg | 0.6 | unknown parameter `mas_kg`; did you mean `mass_kg`?
        inject | \"setpoint.dorp=1\" | did you mean `setpoint.drop`?"
        .lines()
    {
        let [name, value, why] = case.trim().split(" | ").collect::<Vec<_>>()[..] else {
            panic!("{case}")
        };
        let value = serde_json::from_str(value).unwrap();
        let active = match name {
            "mass_kg" => mass(0.55),
            _ => BTreeMap::new(),
        };
        assert_eq!(client.refused(name, &value, why), active);
    }
    client.send(&json!({"op": "getParameters", "parameterNames": ["mas_kg"], "id": "get"}));
    let status = client.text("status")["message"].to_string();
    assert!(status.contains("did you mean `mass_kg`?"), "{status}");
    assert_eq!(by_name(&client.text("parameterValues")), BTreeMap::new());
    land(&rig, flight, bridge);
    for client in [client, other] {
        let texts = client.last_texts();
        let words = "the flight has ended: interrupted";
        assert!(texts.contains(words), "{texts}");
    }
}

#[test]
fn clients_change_nothing_unless_they_are_allowed_to() {
    let (rig, flight, bridge, port) = flown("read-only", "", "");
    assert!(
        bridge.stdout().contains(", read-only; Ctrl-C ends"),
        "{}",
        bridge.stdout()
    );
    let mut client = Client::connect(port);
    assert_eq!(client.get(&[]).len(), PARAMETERS);
    let why = "read-only: start it with --allow-swaps";
    assert_eq!(client.refused("mass_kg", &json!(0.6), why), mass(0.52));
    assert_eq!(rig.run("params", "--json").json()[0]["in_force"], 0.52);
    land(&rig, flight, bridge);
}

#[test]
fn pages_of_other_origins_are_refused() {
    let allowed = "https://studio.example:8080";
    let (rig, flight, bridge, port) = flown("origins", "", &format!("--allow-origin {allowed}"));
    let status = |origin: Option<&str>| Client::of_page(port, origin).map_or_else(|it| it, |_| 101);
    for origin in [
        None,
        Some("https://app.foxglove.dev"),
        Some("http://localhost:3000"),
        Some(allowed),
    ] {
        assert_eq!(status(origin), 101, "{origin:?}");
    }
    for origin in ["https://evil.example", "null", "https://studio.example"] {
        assert_eq!(status(Some(origin)), 403, "{origin}");
        bridge.await_words(&format!("refused a page of {origin}; "));
    }
    land(&rig, flight, bridge);
}

/// Addresses on which a process listens for TCP, as the kernel writes them: hexadecimal, of IPv4 the last byte first.
fn listening(pid: u32) -> Vec<String> {
    let descriptors = fs::read_dir(format!("/proc/{pid}/fd")).unwrap();
    let inode = |entry: fs::DirEntry| Some(fs::metadata(entry.path()).ok()?.st_ino().to_string());
    let inodes: BTreeSet<String> = descriptors.flatten().filter_map(inode).collect();
    let tables =
        ["tcp", "tcp6"].map(|it| fs::read_to_string(format!("/proc/{pid}/net/{it}")).unwrap());
    let lines = tables.iter().flat_map(|table| table.lines());
    let fields = lines.map(|line| line.split_whitespace().collect::<Vec<_>>());
    let ours = fields.filter(|it| it.len() > 9 && it[3] == "0A" && inodes.contains(it[9]));
    ours.map(|fields| fields[1].to_owned()).collect()
}

#[test]
fn it_listens_on_this_machine_alone_and_survives_what_is_no_request() {
    let (rig, flight, bridge, port) = flown("requests", "", "");
    let host = format!("127.0.0.1:{port}");
    let addresses = listening(bridge.pid());
    let is_its_port = |address: &String| address.ends_with(&format!(":{port:04X}"));
    assert!(addresses.iter().any(is_its_port), "{addresses:?}");
    for address in &addresses {
        let (host, _) = address.split_once(':').unwrap();
        assert!(
            host.len() == 8 && host.ends_with("7F"),
            "not in 127.0.0.0/8: {addresses:?}"
        );
    }
    let endless = [b"GET / HTTP/1.1\r\n".to_vec(), b"X: y\r\n".repeat(50_000)].concat();
    // Garbage, wrong heads, frames without a handshake; with false, the client stays and waits.
    let requests: [(&[u8], bool); 7] = [
        (b"", true),
        (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03", true),
        (b"\0\0\0\0\r\n\r\n", true),
        (
            b"GET / HTTP/1.1\r\nUpgrade: websocket\r\nContent-Length: -1\r\n\r\n",
            true,
        ),
        (
            b"POST / HTTP/9.9\r\nHost: \xff\xfe\r\n\r\n\x81\xff\xff\xff\xff\xff\xff",
            true,
        ),
        (&endless, false),
        (b"GET / HTTP/1.1\r\n", false),
    ];
    for (bytes, ends) in requests {
        let answer = answer(&host, bytes, ends);
        assert!(!answer.starts_with("HTTP/1.1 101"), "{answer}");
    }
    let page = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://rebound.example\r\n\r\n";
    let refusal = answer(&host, page, false);
    assert!(refusal.starts_with("HTTP/1.1 403 "), "{refusal}");
    rig.ok("params --json");
    land(&rig, flight, bridge);
}
