//! `ironbird watch --web`: a flight on a page in a browser, without affecting the control loops.
//!
//! ```text
//!   recorder, blackboards --feed--> dashboard's model --texts--> hub --server--> pages
//!   the plant's parameter server <--inject-- requests of the pages, with --allow-control
//! ```
//!
//! The model is that of the terminal's dashboard. The page is in `web/`, without a build step.

mod filed_report;
mod server;
mod texts;

use std::io::ErrorKind;
use std::net::{Ipv4Addr, TcpListener};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, sleep};
use std::time::{Duration, Instant};

use faults::grammar::duration;
use ipc::instance::Instance;
use messages::role::Role;
use process::signals::stop_flag;
use render::{VEHICLE_JS, plot};
use serde::Deserialize;
use serde_json::Value;

use crate::inject::{When, flight, injected, parse_line, still_flying};
use crate::observation::DRAIN_EVERY;
use crate::watch::dashboard_model::Model;
use crate::watch::feed::Feed;
use errors::output::print;
use errors::{Failure, INTERRUPTED, OCCUPIED, OK};
use filed_report::FiledReport;
use server::{Answer, Hub, PageFile, Server};

const POSE_EVERY: Duration = Duration::from_millis(50);
const NEWS_EVERY: Duration = Duration::from_millis(500);
/// Requests of all pages whose answer is pending.
const PENDING: usize = 64;
/// How much later a page may request a change.
const LATEST: Duration = Duration::from_secs(10);

#[derive(Clone, Debug)]
pub struct WebOptions {
    pub instance: String,
    /// 0 takes a free one.
    pub port: u16,
    /// Whether pages may change parameters and inject faults.
    pub allow_control: bool,
    /// Whether `fly` started the server: it then ends with the flight.
    pub launched: bool,
}

/// Serves one flight of the instance after the other, until a signal comes; `opened` receives the page's address.
pub fn serve(options: &WebOptions, opened: impl FnOnce(&str)) -> Result<u8, Failure> {
    let instance = Instance::new(&options.instance)?;
    // Another user's instance is refused before an address is printed.
    instance.look_for(Role::Plant)?;
    let stop = stop_flag()?;
    let hub = Arc::new(Hub::default());
    let server = start(options, &instance, &hub)?;
    let access = match options.allow_control {
        true => "pages with this address may change the flight",
        false => "read-only",
    };
    let address = server.address();
    print(&format!("live page: {address} ({access})\n"))?;
    opened(&address);
    let served = follow(options, instance, &hub, &stop);
    hub.close();
    served
}

fn start(
    options: &WebOptions,
    instance: &Instance,
    hub: &Arc<Hub>,
) -> Result<Arc<Server>, Failure> {
    let port = options.port;
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(|e| match e.kind() {
        ErrorKind::AddrInUse => {
            let what = format!("cannot serve the live page: port {port} is in use");
            Failure::new(OCCUPIED, what)
                .help("name another port, or leave --port out: it takes one that is free")
        }
        _ => Failure::usage(format!("cannot serve the live page on port {port}: {e}"))
            .help("ports below 1024 need rights; leave --port out, and it takes one that is free"),
    })?;
    let failed = |e| Failure::failed(format!("cannot serve the live page: {e}"));
    let token = server::random_token().map_err(failed)?;
    let answer = answer_to(instance, options.allow_control);
    Server::open(listener, token, files(), Arc::clone(hub), answer).map_err(failed)
}

/// The files of the page, by their names below the token; the page itself has none.
fn files() -> Vec<PageFile> {
    const HTML: &str = "text/html; charset=utf-8";
    const SCRIPT: &str = "text/javascript; charset=utf-8";
    const STYLE: &str = "text/css; charset=utf-8";
    let file = |name, media_type, text| PageFile {
        name,
        media_type,
        text,
    };
    let licence = include_str!("web/uplot/LICENSE");
    let chart = include_str!("web/uplot/uPlot.iife.min.js");
    let style = [
        plot::STYLE,
        include_str!("web/uplot/uPlot.min.css"),
        include_str!("web/page.css"),
    ];
    vec![
        file("", HTML, include_str!("web/index.html").into()),
        file("page.js", SCRIPT, include_str!("web/page.js").into()),
        file("vehicle.js", SCRIPT, VEHICLE_JS.into()),
        file("uplot.js", SCRIPT, format!("/*{licence}*/\n{chart}")),
        file("page.css", STYLE, style.join("\n")),
    ]
}

/// A change that a page requests.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Request {
    id: u64,
    /// As in a terminal: `mass_kg=0.6`, `state.drop=0.1 for 1s`.
    inject: String,
    /// How much later.
    after: Option<String>,
}

impl Request {
    /// Asks the plant, after the time that the request names. `turn` is held meanwhile: the plant serves few clients.
    fn injected(&self, instance: &Instance, turn: &Mutex<()>) -> Result<String, String> {
        let (changes, lasts) = parse_line(&self.inject)?;
        let after = self.after.as_deref().map_or(Ok(Duration::ZERO), duration)?;
        if after > LATEST {
            return Err(format!(
                "after {after:?}: a page may wait at most {LATEST:?}"
            ));
        }
        let mut run_id = None;
        if !after.is_zero() {
            let flight = flight(instance).map_err(|e| e.to_string())?;
            let (_, run) = flight.ok_or("no flight is running")?;
            run_id = Some(run.run_id);
            // The time is flight time, which may pass slower than the clock.
            sleep(after.saturating_mul(run.slowdown()));
        }
        let _turn = turn.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(run_id) = run_id {
            still_flying(instance, run_id).map_err(|e| e.to_string())?;
        }
        injected(instance, &changes, When::NOW, lasts).map_err(|e| e.to_string())
    }
}

/// Answers requests, each in a thread: the plant may take a while.
fn answer_to(instance: &Instance, allows_control: bool) -> Box<Answer> {
    // Held once here, and once by each request whose answer is pending.
    let (instance, turn) = (instance.clone(), Arc::new(Mutex::new(())));
    Box::new(move |hub: &Arc<Hub>, page: u64, text: &str| {
        let answer = move |hub: &Hub, id: u64, answered: &Result<String, String>| {
            hub.send(page, texts::answer(id, answered).to_string().into());
        };
        let request = match serde_json::from_str::<Request>(text) {
            Ok(request) => request,
            Err(e) => return answer(hub, 0, &Err(format!("this is no request of the page: {e}"))),
        };
        let id = request.id;
        let refuse = |why: &str| answer(hub, id, &Err(why.to_owned()));
        if !allows_control {
            return refuse(
                "this page is read-only: start it with --allow-control, or use `ironbird inject`",
            );
        }
        let (instance, asked, turn) = (instance.clone(), Arc::clone(hub), Arc::clone(&turn));
        if Arc::strong_count(&turn) > PENDING + 1 {
            return refuse("too many requests wait for their answers: try again later");
        }
        let inject = move || answer(&asked, id, &request.injected(&instance, &turn));
        if let Err(e) = thread::Builder::new().spawn(inject) {
            refuse(&format!("cannot start a thread to ask the plant: {e}"));
        }
    })
}

/// Feeds the model and sends its texts, until a signal comes or, if `fly` started it, the flight's report is complete.
fn follow(
    options: &WebOptions,
    instance: Instance,
    hub: &Hub,
    stop: &AtomicBool,
) -> Result<u8, Failure> {
    let mut model = Model::new(instance.name(), options.launched, true);
    let mut feed = Feed::new(instance);
    let mut filed = FiledReport::default();
    let (mut shown, mut next_pose, mut next_news) = (None, Instant::now(), Instant::now());
    let text = |value: Value| value.to_string().into();
    loop {
        let is_stopped = stop.load(Ordering::Relaxed);
        feed.update(&mut model)?;
        let now = Instant::now();
        let run = model.flight.as_ref().map(|flight| flight.run.run_id);
        let is_new = run != shown;
        if is_new {
            (shown, filed) = (run, FiledReport::default());
        }
        let has_new_page = hub.has_new_page();
        let is_due = now >= next_news || is_new || has_new_page;
        if is_new || has_new_page {
            let flight = text(texts::flight(&model, options.allow_control));
            hub.welcome(&flight, is_new);
        }
        if let Some(flight) = model.flight.as_ref().filter(|_| is_due) {
            filed.look(flight.supervision.directory.text(), flight.run.run_id);
        }
        let is_over = options.launched && filed.complete().is_some() && !model.is_flying();
        // The last news have the end of the flight and its verdicts.
        if is_due || is_over || is_stopped {
            next_news = now + NEWS_EVERY;
            hub.broadcast(&text(texts::news(&model, &filed, hub.pages())));
        }
        if is_due || (model.is_flying() && now >= next_pose) {
            next_pose = now + POSE_EVERY;
            let pose = model.flight.as_ref().and_then(|flight| texts::pose(flight));
            pose.into_iter().for_each(|pose| hub.broadcast(&text(pose)));
        }
        if is_stopped {
            return Ok(INTERRUPTED);
        }
        if is_over {
            return Ok(OK);
        }
        sleep(DRAIN_EVERY);
    }
}
