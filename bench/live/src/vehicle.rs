//! `ironbird bridge mavlink`: a flight as a MAVLink vehicle, without affecting the control loops.
//!
//! ```text
//!   recorder, blackboards --feed--> dashboard's model --telemetry--> link --> ground station
//!   the plant's request server <--inject-- requests of the ground station, with --allow-control
//! ```
//!
//! The model is that of the terminal's dashboard. docs/ground-station.md is the user's page.

mod failures;
mod link;
mod offboard;
mod outbox;
mod parameters;
mod protocol;
mod telemetry;
#[cfg(test)]
mod tests;

use std::io::ErrorKind;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::{self, sleep};
use std::time::{Duration, Instant};

use ipc::instance::Instance;
use process::signals::stop_flag;

use crate::inject::{TargetClient, inject_line, still_flying};
use crate::observation::DRAIN_EVERY;
use crate::watch::dashboard_model::Model;
use crate::watch::feed::Feed;
use errors::output::{print, say};
use errors::{Failure, INTERRUPTED, OCCUPIED, OK};
use link::{Frame, Link};
use protocol::{Request, Vehicle, What};

pub use link::Address;

#[derive(Clone, Debug)]
pub struct VehicleOptions {
    pub instance: String,
    pub address: Address,
    /// Whether the ground station may change parameters and inject failures.
    pub allow_control: bool,
    /// Whether `fly` started the bridge: it then ends with the flight.
    pub launched: bool,
}

/// Serves one flight of the instance after the other, until a signal comes.
pub fn serve(options: &VehicleOptions) -> Result<u8, Failure> {
    let instance = &Instance::new(&options.instance)?;
    let stop = stop_flag()?;
    let mut link = open(options.address)?;
    let address = link
        .address()
        .map_err(|e| Failure::failed(format!("cannot serve: {e}")))?;
    let place = match options.address {
        Address::Udp(_) => format!("reports to udp {address}"),
        Address::Tcp(_) => format!("waits for a ground station at tcp {address}"),
    };
    let access = match options.allow_control {
        true => "the ground station may change the flight",
        false => "read-only",
    };
    if options.allow_control && !options.address.is_of_this_machine() {
        say(&format!(
            "warning: {address} is not of this machine, and MAVLink has no passwords: every program that can send from \
             there or reach it may change the flight\n"
        ));
    }
    print(&format!(
        "MAVLink vehicle {} {place} ({access})\n",
        protocol::SYSTEM
    ))?;
    let (asked, requests) = channel();
    let (answers, answered) = channel();
    thread::scope(|scope| {
        // The plant may take a while, and the vehicle reports meanwhile.
        thread::Builder::new()
            .spawn_scoped(scope, move || ask(instance, &requests, &answers))
            .map_err(|e| Failure::failed(format!("cannot start a thread to ask the plant: {e}")))?;
        report(options, instance, &mut link, &stop, (asked, answered))
    })
}

fn open(address: Address) -> Result<Link, Failure> {
    Link::open(address).map_err(|e| match (address, e.kind()) {
        (Address::Tcp(at), ErrorKind::AddrInUse) => {
            let what = format!("cannot wait for a ground station at tcp {at}: the port is in use");
            Failure::new(OCCUPIED, what)
                .help("end the other server, or name another port with --tcp")
        }
        (Address::Tcp(at), _) => {
            Failure::usage(format!("cannot wait for a ground station at tcp {at}: {e}"))
                .help("--tcp takes an address of this machine, such as 127.0.0.1:5760")
        }
        (Address::Udp(to), _) => Failure::usage(format!("cannot report to udp {to}: {e}"))
            .help("--udp takes the address of a ground station, such as 127.0.0.1:14550"),
    })
}

/// Without a request for this long, the client for targets is dropped: it keeps files of the flight in shared memory.
const IDLE: Duration = Duration::from_millis(500);

/// A request with the plant's answer.
type Answered = (Request, Result<String, String>);

/// Asks the plant, one request after the other, until the sender of requests is gone.
fn ask(instance: &Instance, requests: &Receiver<Request>, answers: &Sender<Answered>) {
    let mut client = None;
    loop {
        let request = match requests.recv_timeout(IDLE) {
            Ok(request) => request,
            Err(RecvTimeoutError::Timeout) => {
                client = None;
                continue;
            }
            Err(RecvTimeoutError::Disconnected) => return,
        };
        // Only into the flight that the request was meant for.
        let answer = match &request.what {
            What::Line(line) => {
                still_flying(instance, request.run_id).and_then(|_| inject_line(instance, line))
            }
            What::Target(order) => TargetClient::of(&mut client, instance, request.run_id)
                .and_then(|client| client.aim(*order)),
        };
        if answers
            .send((request, answer.map_err(|e| e.to_string())))
            .is_err()
        {
            return;
        }
    }
}

/// Reports flights. The requests end with it.
fn report(
    options: &VehicleOptions,
    instance: &Instance,
    link: &mut Link,
    stop: &AtomicBool,
    (asked, answered): (Sender<Request>, Receiver<Answered>),
) -> Result<u8, Failure> {
    let mut model = Model::new(instance.name(), options.launched, false);
    let mut feed = Feed::new(instance.clone());
    let mut vehicle = Vehicle::new(options.allow_control);
    let start = Instant::now();
    loop {
        let is_stopped = stop.load(Ordering::Relaxed);
        feed.update(&mut model)?;
        let now = start.elapsed();
        link.receive(|frame| match frame {
            Frame::Message(header, message) => vehicle.receive(&header, &message, &model, now),
            Frame::Signed => vehicle.refuse_signed(now),
        });
        for (request, answer) in answered.try_iter() {
            vehicle.answered(&request, &answer, &model, now);
            // A value that is acknowledged is read from then on.
            feed.look_soon();
        }
        vehicle.update(&model, now);
        for request in vehicle.requests.drain(..) {
            asked
                .send(request)
                .map_err(|e| Failure::failed(format!("cannot ask the plant: {e}")))?;
        }
        for message in vehicle.outbox.messages.drain(..) {
            link.send(&message);
        }
        if is_stopped {
            return Ok(INTERRUPTED);
        }
        if options.launched && vehicle.has_ended() {
            return Ok(OK);
        }
        sleep(DRAIN_EVERY);
    }
}
