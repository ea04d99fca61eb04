//! The recorder's process: drains the topics, writes the files of the flight's directory.

mod figures;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::Duration;

use hdrhistogram::serialization::V2DeflateSerializer;
use model::boards::{Ending, RolePhase, RunPhase, Status};
use model::envelope::Message;
use model::fault::live::{LIVE, LiveBoard, LiveFault};
use model::grid::NS_PER_S;
use model::messages::{Dated, State, Wrench};
use model::role::Role;
use role::rt::UsageMeter;
use role::station::{Armed, JoinedRun, Station};
use wire::BoardReader;
use wire::clock::now_ns;
use wire::instance::Instance;

use super::facts::facts;
use crate::margin::table;
use crate::record::crew::Crew;
use crate::record::hlog::{self, Hlog, Lines};
use crate::record::pairs::Pairs;
use crate::record::ports::{DRAIN_EVERY, Ports, Relays, horizon, keep_first, rest};
use crate::record::replaced::Replaced;
use crate::record::traced::Traced;
use crate::run_directory::make_latest;
use crate::settings::laws::Chosen;
use crate::settings::{LogName, Settings};
use crate::theorem::FlightMonitor;
use failure::{Failure, InFile as _};
use flight_log::entry::LogEntry;
use flight_log::facts::record;
use flight_log::writer::FlightLog;
use machine::Machine;
use machine::cpu_times::{CpuTimes, host_of};
use machine::doctor;
use machine::interrupts::Interrupts;
use machine::sampler::{Watch, fallen};
use report::files::write_all;
use report::finding::Diagnosis;
use report::host::Host;
use report::json;
use report::margin::line::Section;
use report::schema::Report;
use report::states::{Joined, Joiner, LoopMessage, StatesWriter};
use report::tally::{Tally, is_last_word};
use report::tracking::Tracking;
use report::verdict::take_log;

/// How long the recorder waits for the roles' last figures.
const LANDING: Duration = Duration::from_secs(2);
/// How long it then waits for the records of the last swaps, which come from beside the plant's loop.
const LAST_SWAPS: Duration = Duration::from_millis(500);

/// What suffers where a relay fails.
const OBSERVED: &str = "what observers see";

/// Where the recorder writes.
#[derive(Clone, Debug)]
pub struct Files {
    /// The flight's directory.
    pub directory: PathBuf,
    /// A second place for the states.
    pub states: Option<PathBuf>,
}

/// Records until the plant closes the run; gives the flight's report.
///
/// # Errors
/// Those of the station and the ports; [`Failure`] names a file that cannot be written.
pub fn run(mut station: Station, settings: &Settings, files: &Files) -> Result<Report, Failure> {
    let (mut ports, relays) = (Ports::new(station.wire())?, Relays::new(station.wire())?);
    let machine = Machine::here(settings.rt.priority + Role::Mixer.priority_step(), settings.realtime()?.cpu);
    let (mut crew, mut live) = (Crew::default(), None);
    let armed = station.join(|wire, expected, _| {
        // Before the plant may take off: a flight can be over before the recorder's files are made.
        crew = Crew::open(wire)?;
        live = wire.board_reader(LIVE)?;
        ports.arm(expected)
    })?;
    let meter = UsageMeter::start();
    let lines = Lines::create(&files.directory)?;
    let (mut out, mut serializer) = (lines.out(), V2DeflateSerializer::new());
    let mut log =
        Hlog::begin(&lines, &mut out, &mut serializer, armed.run.get().t0_wall_ns, settings.recorder.hlog_every_s)?;
    let recorder = Recorder::new(&armed, settings, files, &machine, (station.wire().instance(), relays, crew, live))?;
    let outcome = recorder.record(&mut ports, &mut station, &armed, &meter, (&mut log, &lines));
    station.land(&meter);
    outcome
}

struct Recorder<'a> {
    settings: &'a Settings,
    /// What the loop bears.
    margin: Option<Section>,
    /// Their laws, as they were when it began: a file that goes in flight is no matter.
    chosen: [Chosen; 3],
    directory: &'a Path,
    instance: String,
    host: Host,
    doctor: Diagnosis,
    tally: Tally,
    watch: Watch,
    traced: Traced,
    pairs: Pairs,
    theorem: FlightMonitor,
    joiner: Joiner,
    states: Vec<StatesWriter>,
    /// The report while the flight is in the air.
    so_far: Replaced,
    /// Seconds of the flight that are over.
    seconds: u64,
    /// Whether `latest` leads to this flight.
    is_latest: bool,
    /// None where no messages are to be kept.
    log: Option<FlightLog>,
    relays: Relays,
    /// Files that could not be written, with the first reason: the flight goes on without them.
    unwritten: BTreeMap<&'static str, String>,
    /// Of the newest state.
    parameter_epoch: u64,
    crew: Crew,
    /// The plant's board of faults, and what was on it last.
    live: Option<BoardReader<LiveBoard>>,
    injected: Vec<LiveFault>,
    cpu_times: CpuTimes,
    interrupts: Interrupts,
    period_s: f64,
}

impl<'a> Recorder<'a> {
    fn new(
        armed: &Armed,
        settings: &'a Settings,
        files: &'a Files,
        machine: &Machine,
        (instance, relays, crew, live): (&Instance, Relays, Crew, Option<BoardReader<LiveBoard>>),
    ) -> Result<Self, Failure> {
        let host = host_of(machine);
        let period_s = settings.flight.period_s;
        let (tracking, laws) = (Tracking::along(settings.course()?, period_s), settings.flown_laws()?);
        let every = settings.recorder.states_every_ticks;
        let mut states = vec![StatesWriter::spooled(&files.directory.join("states.csv"), tracking, laws, every)?];
        if let Some(path) = &files.states {
            states.push(StatesWriter::spooled(path, tracking, laws, every)?);
        }
        let watch = Watch::new(&crew.loops(), host.hypervisor != Some(false));
        let mut tally = Tally::new(armed.pace, armed.run.get().t0_ns, tracking)?;
        tally.theorem.flown_by(&settings.airframe()?);
        tally.flown_by(laws);
        tally.begin_autopsy(watch.is_virtual, watch.processor.is_some());
        let facts = facts(&armed.run.get(), settings, instance.name(), &host, &crew.sections())?;
        let log = match settings.recorder.log {
            LogName::Off => None,
            LogName::All | LogName::AroundMisses => {
                Some(FlightLog::create(&files.directory.join(flight_log::FILE), &facts)?)
            }
        };
        Ok(Self {
            settings,
            margin: table::of_flight(armed.pace, settings, &files.directory)?,
            chosen: settings.chosen_laws()?,
            relays,
            log,
            unwritten: BTreeMap::new(),
            parameter_epoch: 0,
            directory: &files.directory,
            instance: instance.name().into(),
            host,
            doctor: Diagnosis::of(&doctor::findings(machine)),
            tally,
            watch,
            traced: Traced::begin(settings.recorder.trace, instance, watch.processor)?,
            pairs: Pairs::new(),
            theorem: FlightMonitor::new(settings.theorem()?),
            joiner: Joiner::default(),
            states,
            so_far: Replaced::new(files.directory.join("report.json"))?,
            seconds: 0,
            is_latest: false,
            crew,
            live,
            injected: Vec::new(),
            cpu_times: CpuTimes::read(watch.processor),
            interrupts: Interrupts::read(watch.processor),
            period_s,
        })
    }

    fn record(
        mut self,
        ports: &mut Ports,
        station: &mut Station,
        armed: &Armed,
        meter: &UsageMeter,
        (hlog, lines): (&mut Hlog<'_>, &Lines),
    ) -> Result<Report, Failure> {
        let ending = loop {
            rest(armed.pace);
            self.drain(ports, armed)?;
            self.look_at_loops(&armed.run);
            station.status.ticks_run = self.tally.newest_tick();
            station.pass_on_stop();
            self.look_for_faults();
            self.log.as_mut().map_or(Ok(()), |log| log.keep(now_ns()))?;
            if now_ns() >= armed.run.get().t0_ns + (self.seconds + 1) * NS_PER_S {
                self.seconds += 1;
                if self.seconds.is_multiple_of(self.settings.recorder.hlog_every_s) {
                    let closed = hlog.close_interval(&mut self.tally.series);
                    self.note(hlog::FILE, closed);
                }
                let report = self.report(&armed.run.get(), ports, meter, None)?;
                let text = json::to_string(&report).in_file("write", Path::new("report.json"));
                let put = text.and_then(|text| self.so_far.put(text + "\n"));
                self.note("report.json", put);
                self.point_latest();
                self.keep_states();
            }
            let run = armed.run.get();
            if run.phase() == RunPhase::Closed {
                break run.ending();
            }
            if !station.plant_lives() {
                break Ending::Failed;
            }
        };
        let closed_ns = now_ns();
        self.look_for_faults();
        self.await_landing();
        self.drain(ports, armed)?;
        let (until, run) = (now_ns() + LAST_SWAPS.as_nanos() as u64, armed.run.get());
        // A swap of a tick that was skipped at the very end is in no state, but the plant has counted it.
        let swaps = self.parameter_epoch.max(run.parameter_epoch);
        while self.tally.swaps_seen < swaps && now_ns() < until {
            sleep(DRAIN_EVERY);
            self.drain(ports, armed)?;
        }
        while let Some((wrench, state)) = self.pairs.rest() {
            self.judge(&wrench, state.as_ref());
        }
        self.tally.finish(&run, closed_ns);
        self.tally.deaths.finish(fallen(&self.crew.loops()), self.tally.newest_tick());
        let closed = hlog.close_interval(&mut self.tally.series).and_then(|()| lines.finish());
        self.note(hlog::FILE, closed);
        while let Some(joined) = self.joiner.rest() {
            self.follow(&joined);
        }
        // Each of them, also after one that is not whole.
        let finished = self.states.iter_mut().map(StatesWriter::finish).fold(Ok(()), Result::and);
        self.note("states.csv", finished);
        self.take_trace();
        if let Some(autopsy) = &mut self.tally.autopsy {
            autopsy.fallen(fallen(&self.crew.loops()), now_ns());
            autopsy.finish(run.deadlines_missed, run.last_tick + 1);
        }
        self.tally.miss_runs.update(run.deadlines_missed, run.deadline_miss_run);
        // The final one is written whole, or it is said why not.
        self.unwritten.remove("report.json");
        if !self.is_latest {
            let pointed = make_latest(self.directory);
            self.note("latest", pointed);
        }
        let mut report = self.report(&run, ports, meter, Some(ending))?;
        // Last of what needs room, and before the report, which says what became of it.
        if let Some(log) = self.log {
            let fate = log.finish(record(&[
                ("ending", ending.words()),
                ("ticks_run", &run.ticks_run.to_string()),
                ("ticks_skipped", &run.ticks_skipped.to_string()),
                ("deadlines_missed", &run.deadlines_missed.to_string()),
            ]))?;
            take_log(&mut report, self.settings.recorder.log.name(), &fate);
        }
        self.so_far.close();
        write_all(&report, self.directory)?;
        Ok(report)
    }

    /// Samples what the kernel counts for the loops while they fly, and classes the deadlines missed so far.
    fn look_at_loops(&mut self, run: &JoinedRun) {
        let sample = self.watch.sample(&self.crew.loops(), self.tally.lost().iter().sum());
        self.take_trace();
        let Some(autopsy) = &mut self.tally.autopsy else { return };
        // After the last tick processes end as they should.
        if run.get().phase() == RunPhase::Flying {
            autopsy.sample(sample);
        }
        autopsy.look();
    }

    /// Takes what the kernel has traced since the last time.
    fn take_trace(&mut self) {
        match (self.traced.take(), &mut self.tally.autopsy) {
            (Ok(slices), Some(autopsy)) => autopsy.ran(slices),
            (taken, _) => self.note("the trace of the loops' processor", taken.map(drop)),
        }
    }

    /// Waits for the figures of roles that still live.
    fn await_landing(&self) {
        let until = now_ns() + LANDING.as_nanos() as u64;
        let landed = || {
            let loops = self.crew.loops();
            let is_over = |(status, fallen): (&Status, bool)| fallen || status.phase() == RolePhase::Landed;
            loops.iter().zip(fallen(&loops)).all(is_over)
        };
        while !landed() && now_ns() < until {
            sleep(DRAIN_EVERY);
        }
    }

    /// Remembers a file that cannot be written.
    fn note(&mut self, file: &'static str, written: Result<(), Failure>) {
        if let Err(failure) = written {
            self.unwritten.entry(file).or_insert_with(|| failure.to_string());
        }
    }

    fn drain(&mut self, ports: &mut Ports, armed: &Armed) -> Result<(), Failure> {
        let horizon = horizon(armed.pace, || armed.run.get());
        let (tally, joiner, pairs) = (&mut self.tally, &mut self.joiner, &mut self.pairs);
        let mut log = |entry| self.log.as_mut().map_or((), |log| log.take(entry));
        let (relays, mut relayed) = (&self.relays, Ok(()));
        ports.states.drain(horizon, |message| {
            keep_first(&mut relayed, relays.states.pass_on(message));
            log(LogEntry::State(*message));
            self.parameter_epoch = message.content.parameter_epoch;
            tally.state(message);
            pairs.state(message);
            joiner.take(message.envelope.tick, LoopMessage::State(message.content));
        })?;
        ports.setpoints.drain(horizon, |message| {
            keep_first(&mut relayed, relays.setpoints.pass_on(message));
            log(LogEntry::Setpoint(*message));
            tally.setpoint(message);
            joiner.take(message.envelope.tick, LoopMessage::Setpoint(message.content));
        })?;
        ports.wrenches.drain(horizon, |message| {
            keep_first(&mut relayed, relays.wrenches.pass_on(message));
            log(LogEntry::Wrench(*message));
            tally.wrench(message);
            pairs.wrench(message);
        })?;
        ports.rotor_speeds.drain(horizon, |message| {
            keep_first(&mut relayed, relays.rotor_speeds.pass_on(message));
            log(LogEntry::RotorSpeeds(*message));
            tally.rotor_speeds(message);
            if !is_last_word(message) {
                joiner.take(message.envelope.tick, LoopMessage::RotorSpeeds(message.content));
            }
        })?;
        ports.swaps.drain(horizon, |message| {
            keep_first(&mut relayed, relays.swaps.pass_on(message));
            log(LogEntry::Swap(*message));
            tally.swap(message);
        })?;
        self.note(OBSERVED, relayed.map_err(Failure::from));
        while let Some((wrench, state)) = self.pairs.paired() {
            self.judge(&wrench, state.as_ref());
        }
        while let Some(joined) = self.joiner.settled() {
            self.follow(&joined);
        }
        Ok(())
    }

    /// Says of a wrench what the theorem's monitor finds, on a topic that goes the ways of the others.
    fn judge(&mut self, wrench: &Message<Wrench>, state: Option<&Dated<State>>) {
        let found = self.theorem.watch(wrench, state);
        match &found {
            Some(message) => {
                let relayed = self.relays.theorem.pass_on(message);
                self.note(OBSERVED, relayed.map_err(Failure::from));
                if let Some(log) = &mut self.log {
                    log.take(LogEntry::Theorem(*message));
                }
                self.tally.theorem(message);
            }
            None if self.theorem.applies() => self.tally.theorem.unwatched(),
            None => {}
        }
        let monitor = found.map(|message| message.content);
        self.joiner.take(wrench.envelope.tick, LoopMessage::Wrench(wrench.content, monitor));
    }

    /// Takes a state, with what the stages made of it.
    fn follow(&mut self, joined: &Joined) {
        self.tally.tracer.take(joined);
        let written = self.states.iter_mut().try_for_each(|states| states.write(joined));
        self.note("states.csv", written);
    }
}
