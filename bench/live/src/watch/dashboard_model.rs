//! The dashboard's state: the flight, and what the user looks at and types.
//!
//! It has no inputs and outputs of its own: others pass it messages and keys, and carry out the action of [`Model::key`].

use std::cell::Cell;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use messages::blackboards::{ActiveParameters, EndReason, LOCKSTEP, Run, Status, Supervision};
use messages::channels::Redundancy;
use messages::content::{Mode, NO_TICK, RotorSpeeds, Setpoint, State, TakenCommand, Wrench};
use messages::header::Message;
use messages::monitor::Monitor;
use messages::parameters::{Airframe, Parameter, SPECS};
use messages::role::{Channel, Replica, Role, STAGES};
use messages::topic::Topic;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use serde::Serialize;

use crate::inject::parse_line;
use analysis::faults::{AppliedSwap, InjectedFault};
use analysis::flight_statistics::FlightStatistics;
use analysis::host::Steal;
use analysis::laws::FlownLaws;
use analysis::phrase::name_of;
use analysis::schema::{
    Explained, FlightVerdict, NotFresh, Speed, StabilityVerdict, Ticks, TimingVerdict, Verdicts,
};
use analysis::series::Series;
use analysis::states::is_final_command;
use analysis::theorem::Theorem;
use analysis::tracking::Tracking;
use analysis::verdicts::{flight_verdict, stability_verdict, timing_verdict};
use config::trajectory::is_file;
use config::{PointsFile, Settings};
use controller::laws::adaptive;
use errors::Failure;
use faults::grammar::{Change, Desired};
use flight_log::entry::LogEntry;
use host::cpu_times::CpuTimes;
use host::sampler::Watch;

const NUMBER_MAX: usize = 24;
const FAULT_MAX: usize = 120;
/// Handovers that are kept.
const HANDOVERS: usize = 50;
/// Allowed characters besides digits: for numbers, `nominal`, shares, and the units of a ramp's duration.
const NUMBER: &str = ".+-eE%~nominalmsuhd";

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tab {
    #[default]
    Flight,
    Latency,
    Theorem,
    Plant,
    RealTime,
    Laws,
}

impl Tab {
    pub const ALL: [(Self, &'static str); 6] = [
        (Self::Flight, "Flight"),
        (Self::Latency, "Latency"),
        (Self::Theorem, "Theorem"),
        (Self::Plant, "Plant"),
        (Self::RealTime, "Real time"),
        (Self::Laws, "Laws"),
    ];
}

#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    None,
    Quit,
    EndFlight,
    Reset,
    /// Change a parameter, at once or gradually; or inject a fault, permanently or for a time.
    Inject(Vec<Change>, Option<Duration>),
}

#[derive(Clone, Debug, Default)]
pub struct ParameterPage {
    /// Row of the table of parameters.
    pub selected: usize,
    /// The text being typed: a new value or a fault.
    pub typed: Option<String>,
    pub is_fault: bool,
    /// Whether the plant's answer is pending.
    pub waits: bool,
    /// The result of the last request, or why it was refused.
    pub result: Option<Result<String, String>>,
}

impl ParameterPage {
    pub fn parameter(&self) -> Parameter {
        SPECS[self.selected].parameter
    }
}

#[derive(Debug, Default)]
pub struct Model {
    pub instance: String,
    /// Whether `fly` started the dashboard: then leaving it does not end the flight.
    pub launched: bool,
    pub colours: bool,
    pub tab: Tab,
    pub help: bool,
    /// Row of the table of latencies.
    pub series: usize,
    /// First row that is shown of a page without a table; drawing limits it to what the terminal has no room for.
    pub scrolled: Cell<usize>,
    pub parameters: ParameterPage,
    pub flight: Option<Box<WatchedFlight>>,
}

impl Model {
    pub fn new(instance: &str, launched: bool, colours: bool) -> Self {
        Self {
            instance: instance.into(),
            launched,
            colours,
            ..Self::default()
        }
    }

    pub fn is_flying(&self) -> bool {
        matches!(&self.flight, Some(flight) if flight.ending.is_none())
    }

    pub fn join(&mut self, run: &Run, settings: &str) -> Result<(), Failure> {
        let settings = Settings::of_shared(settings)?;
        self.flight = Some(Box::new(WatchedFlight::new(run, settings)?));
        self.parameters = ParameterPage {
            selected: self.parameters.selected,
            ..ParameterPage::default()
        };
        Ok(())
    }

    pub fn answer(&mut self, answer: Result<String, Failure>) {
        self.parameters.waits = false;
        let in_one_line = |text: String| text.split_whitespace().collect::<Vec<_>>().join(" ");
        self.parameters.result = Some(answer.map(in_one_line).map_err(|e| e.to_string()));
    }

    pub fn reset(&mut self) -> Result<(), Failure> {
        self.flight.as_mut().map_or(Ok(()), |flight| flight.reset())
    }

    pub fn key(&mut self, key: KeyEvent) -> Action {
        let is_control = key.modifiers.contains(KeyModifiers::CONTROL);
        match key.code {
            _ if key.kind == KeyEventKind::Release => return Action::None,
            KeyCode::Char('c') if is_control && self.launched => return Action::EndFlight,
            KeyCode::Char('c') if is_control => return Action::Quit,
            _ if std::mem::take(&mut self.help) && key.code != KeyCode::Char('q') => {}
            code if self.parameters.typed.is_some() => return self.type_text(code, is_control),
            KeyCode::Char('q') | KeyCode::Esc => return Action::Quit,
            KeyCode::Char('?' | 'h') => self.help = true,
            KeyCode::Char('r') => return Action::Reset,
            KeyCode::Tab | KeyCode::Right => self.turn(1),
            KeyCode::BackTab | KeyCode::Left => self.turn(Tab::ALL.len() - 1),
            KeyCode::Char(digit @ '1'..='6') => self.open(digit as usize - '1' as usize),
            code => self.move_in_table(code),
        }
        Action::None
    }

    fn turn(&mut self, by: usize) {
        self.open((self.tab as usize + by) % Tab::ALL.len());
    }

    fn open(&mut self, page: usize) {
        self.tab = Tab::ALL[page].0;
        self.scrolled.set(0);
    }

    fn move_in_table(&mut self, code: KeyCode) {
        let (selected, last) = match self.tab {
            Tab::Latency => (&mut self.series, Series::all().len() - 1),
            Tab::Plant => (&mut self.parameters.selected, SPECS.len() - 1),
            _ => (self.scrolled.get_mut(), usize::MAX),
        };
        const PAGE: usize = 10;
        match code {
            KeyCode::Up | KeyCode::Char('k') => *selected = selected.saturating_sub(1),
            KeyCode::Down | KeyCode::Char('j') => *selected = (*selected + 1).min(last),
            KeyCode::PageUp => *selected = selected.saturating_sub(PAGE),
            KeyCode::PageDown => *selected = selected.saturating_add(PAGE).min(last),
            KeyCode::Home => *selected = 0,
            KeyCode::End => *selected = last,
            KeyCode::Enter | KeyCode::Char('f') if self.tab == Tab::Plant => {
                self.begin_typing(code != KeyCode::Enter);
            }
            _ => {}
        }
    }

    fn begin_typing(&mut self, is_fault: bool) {
        let is_flying = self.is_flying();
        let page = &mut self.parameters;
        if !is_flying {
            page.result = Some(Err("no flight is running: nothing to inject into".into()));
        } else if !page.waits {
            (page.typed, page.is_fault) = (Some(String::new()), is_fault);
            page.result = None;
        }
    }

    /// Keys while the user types a value or a fault. Ctrl-U empties the line; other control keys are ignored.
    fn type_text(&mut self, code: KeyCode, is_control: bool) -> Action {
        let is_fault = self.parameters.is_fault;
        let typed = self.parameters.typed.get_or_insert_default();
        let is_allowed = |c: char| match is_fault {
            true => c.is_ascii_graphic() || c == ' ',
            false => c.is_ascii_digit() || NUMBER.contains(c),
        };
        match code {
            KeyCode::Char('u') if is_control => typed.clear(),
            _ if is_control => {}
            KeyCode::Char(c) => {
                let most = if is_fault { FAULT_MAX } else { NUMBER_MAX };
                if typed.len() < most && is_allowed(c) {
                    typed.push(c);
                }
            }
            KeyCode::Backspace => drop(typed.pop()),
            KeyCode::Esc => self.parameters.typed = None,
            KeyCode::Enter => return self.inject(),
            _ => {}
        }
        Action::None
    }

    /// Injects the typed value, or the typed fault such as `state.drop=0.1 for 1s`; an invalid one stays for correction.
    fn inject(&mut self) -> Action {
        let typed = self.parameters.typed.take().unwrap_or_default();
        if typed.trim().is_empty() {
            return Action::None;
        }
        let read = if self.parameters.is_fault {
            parse_line(&typed)
        } else {
            self.value(&typed).map(|change| (vec![change], None))
        };
        match read {
            Ok((changes, lasts)) => {
                self.parameters.waits = true;
                Action::Inject(changes, lasts)
            }
            Err(why) => {
                self.parameters.typed = Some(typed);
                self.parameters.result = Some(Err(why));
                Action::None
            }
        }
    }

    fn value(&self, typed: &str) -> Result<Change, String> {
        let flight = self.flight.as_ref();
        let airframe = flight.map_or(Airframe::nominal(), |flight| flight.airframe);
        let text = format!("{}={typed}", self.parameters.parameter());
        let value: Desired = text.parse().map_err(|e| format!("{e}"))?;
        value.of(&airframe).map_err(|e| e.to_string())?;
        Ok(Change::Parameter(value))
    }
}

/// A flight since the dashboard joined it.
#[derive(Debug)]
pub struct WatchedFlight {
    pub run: Run,
    /// Those that all roles share.
    pub settings: Settings,
    pub ending: Option<EndReason>,
    /// Whether the recorder runs, which passes messages on and runs the Lyapunov monitor; or ran at the end of the flight.
    pub recorder_lives: bool,
    /// Statistics since the dashboard joined, or since they were reset.
    pub statistics: FlightStatistics,
    /// Messages lost before they were reset.
    lost_before: u64,
    tracking: Tracking,
    pub state: Option<State>,
    pub setpoint: Option<Setpoint>,
    pub wrench: Option<Wrench>,
    pub rotor_speeds: Option<RotorSpeeds>,
    /// Of each control loop's newest message its [`Mode`] as number, and the first tick of it in a row.
    modes: BTreeMap<Role, (u64, u64)>,
    pub monitor: Option<Monitor>,
    /// Position error [m].
    pub position_error: Trace,
    /// V_th [rad^2/s^2].
    pub v_th: Trace,
    /// The last [`POSES`] poses, one each [`POINT_S`].
    pub poses: VecDeque<Pose>,
    pub statuses: BTreeMap<Replica, Status>,
    pub active: ActiveParameters,
    pub supervision: Box<Supervision>,
    /// Faults of the settings.
    pub planned: Vec<InjectedFault>,
    /// Faults that were injected into the running flight.
    pub injected: Vec<InjectedFault>,
    /// The channel whose command the plant took last, and its first tick; unknown if that was before the dashboard joined.
    pub channel: Option<(Channel, Option<u64>)>,
    /// The newest handovers: their ticks, and the channels before and after.
    handovers: VecDeque<(u64, [Channel; 2])>,
    /// The plant's account of the channels, if there are several.
    pub redundancy: Option<Redundancy>,
    /// Roles that no process plays now.
    pub missing: Vec<Replica>,
    /// The latest parameter change that the dashboard received.
    pub newest_swap: Option<AppliedSwap>,
    pub airframe: Airframe,
    pub laws: FlownLaws,
    /// The loops' CPU and its times when the dashboard first knew that CPU, and what the hypervisor took since.
    cpu_times: Option<(Option<u64>, CpuTimes)>,
    steal: Steal,
}

impl WatchedFlight {
    fn new(run: &Run, mut settings: Settings) -> Result<Self, Failure> {
        let tracking = tracking(run, &mut settings)?;
        let (airframe, laws) = (settings.as_built()?, settings.flown_laws()?);
        let planned = settings.injected()?;
        let mut statistics = Self::statistics(run, tracking, laws)?;
        statistics.stages.theorem.set_airframe(&airframe);
        Ok(Self {
            airframe,
            laws,
            run: *run,
            settings,
            ending: None,
            recorder_lives: true,
            statistics,
            lost_before: 0,
            tracking,
            state: None,
            setpoint: None,
            wrench: None,
            rotor_speeds: None,
            modes: BTreeMap::new(),
            monitor: None,
            position_error: Trace::default(),
            v_th: Trace::default(),
            poses: VecDeque::new(),
            statuses: BTreeMap::new(),
            active: ActiveParameters::default(),
            supervision: Box::default(),
            planned,
            injected: Vec::new(),
            channel: (run.channels <= 1).then_some((Channel::A, Some(0))),
            handovers: VecDeque::new(),
            redundancy: None,
            missing: Vec::new(),
            newest_swap: None,
            cpu_times: None,
            steal: Steal::default(),
        })
    }

    fn statistics(
        run: &Run,
        tracking: Tracking,
        laws: FlownLaws,
    ) -> Result<FlightStatistics, Failure> {
        let mut statistics = FlightStatistics::joining(run.pace(), run.t0_ns, tracking)?;
        statistics.set_channels(run.channels as usize);
        statistics.set_laws(laws);
        Ok(statistics)
    }

    fn reset(&mut self) -> Result<(), Failure> {
        self.lost_before = self.lost();
        let theorem = self.statistics.stages.theorem;
        self.statistics = Self::statistics(&self.run, self.tracking, self.laws)?;
        // The recorder counts these, from the start of the flight.
        self.statistics.stages.theorem = theorem;
        self.position_error = Trace::default();
        self.v_th = Trace::default();
        Ok(())
    }

    /// Messages that were overwritten before the dashboard read them.
    pub fn lost(&self) -> u64 {
        self.lost_before + self.statistics.lost().iter().sum::<u64>()
    }

    /// Tick of the newest state; that of the plant's blackboard before the first state.
    pub fn tick(&self) -> u64 {
        match self.state {
            Some(_) => self.statistics.newest_tick(),
            None => self.run.present_tick(),
        }
    }

    /// The latest known tick if the recorder has died since.
    pub fn lost_at(&self) -> Option<u64> {
        (!self.recorder_lives).then(|| self.tick())
    }

    /// Whether a ground station flies the vehicle.
    pub fn follows_targets(&self) -> bool {
        self.tracking.course().follows_targets()
    }

    pub fn take(&mut self, entry: &LogEntry) {
        self.statistics.take(entry);
        match entry {
            LogEntry::State(message) => {
                self.state = Some(message.content);
                let tick = message.envelope.tick;
                let error_m = self.tracking.error_m(tick, &message.content, None);
                self.position_error
                    .take(self.run.flight_time_s(tick), error_m);
                self.note_pose(tick, error_m);
                let decision = &message.content.decision;
                if decision.count == 1 {
                    self.note_channel(&decision.command);
                }
            }
            LogEntry::Setpoint(message) => {
                self.setpoint = Some(message.content);
                self.note_mode(message, message.content.mode);
            }
            LogEntry::Wrench(message) => {
                self.wrench = Some(message.content);
                self.note_mode(message, message.content.mode);
            }
            LogEntry::RotorSpeeds(message) => {
                if !is_final_command(message) {
                    self.rotor_speeds = Some(message.content);
                    self.note_mode(message, message.content.mode);
                }
            }
            LogEntry::Swap(message) => {
                let (tick, period_s) = (message.envelope.tick, self.run.flight_time_s(1));
                self.newest_swap = Some(AppliedSwap::new(tick, period_s, &message.content));
            }
            LogEntry::Theorem(message) => {
                self.monitor = Some(message.content);
                let time_s = self.run.flight_time_s(message.envelope.tick);
                self.v_th.take(time_s, message.content.v_th);
            }
            LogEntry::Decisions(message) => {
                let commands = message.content.commands().iter();
                commands.for_each(|command| self.note_channel(command));
            }
            LogEntry::Loss(_) => {}
        }
    }

    fn note_mode<C: Topic>(&mut self, message: &Message<C>, mode: u64) {
        let since = (mode, message.envelope.tick);
        let noted = self.modes.entry(C::SENDER).or_insert(since);
        if noted.0 != mode {
            *noted = since;
        }
    }

    /// How each control loop came by its newest output, and since which tick.
    pub fn modes(&self) -> impl Iterator<Item = (Role, Mode, u64)> {
        let modes = self.modes.iter();
        modes.filter_map(|(role, (mode, since))| Some((*role, Mode::from_wire(*mode)?, *since)))
    }

    fn note_pose(&mut self, tick: u64, error_m: f64) {
        let (pose, last) = (self.pose(tick, error_m), self.poses.back());
        let is_due = |last: &Pose| pose.time_s >= last.time_s + POINT_S;
        if last.is_none_or(is_due) {
            keep(&mut self.poses, pose, POSES);
        }
    }

    fn pose(&self, tick: u64, position_error_m: f64) -> Pose {
        let state = self.state.unwrap_or_default();
        let reference = self.tracking.reference(tick, &state);
        let estimates = self.wrench.filter(|_| self.laws.without_theorem.is_none());
        Pose {
            time_s: self.run.flight_time_s(tick),
            position_w_m: state.truth.position_w_m,
            attitude: state.measured.attitude_quaternion,
            yaw_rad: state.measured.attitude_rad[2],
            reference_w_m: reference.position_w_m,
            reference_yaw_rad: reference.yaw_rad,
            rotor_command_rad_s: state.measured.rotor_speed_command_rad_s,
            position_error_m,
            estimates: estimates.map(|wrench| adaptive::estimate(&wrench.telemetry)),
            estimated: state.truth.theta(),
        }
    }

    /// The pose of the newest state; none before the first.
    pub fn newest_pose(&self) -> Option<Pose> {
        let (tick, state) = (self.tick(), self.state.as_ref()?);
        Some(self.pose(tick, self.tracking.error_m(tick, state, None)))
    }

    /// The reference over at most a minute from the start of the flight, one point each [`POINT_S`] [m]; no point of a
    /// vehicle that a ground station flies.
    pub fn reference_line(&self) -> Vec<[f64; 3]> {
        let ticks = (POINT_S / self.tracking.period_s()).round().max(1.0) as usize;
        let line = (0..=self.run.last_tick).step_by(ticks).take(POINTS);
        let time_s = |tick| tick as f64 * self.tracking.period_s();
        let course = self.tracking.course();
        line.filter(|_| !course.follows_targets())
            .map(|tick| course.reference(time_s(tick)).position_w_m)
            .collect()
    }

    /// Notes whose command the plant took.
    fn note_channel(&mut self, command: &TakenCommand) {
        let channel = Channel::from_wire(command.channel).filter(|_| command.is_offered == 1);
        let Some(channel) = channel else { return };
        let tick = command.of_tick;
        match self.channel {
            Some((before, _)) if before == channel => {}
            Some((before, _)) => {
                self.channel = Some((channel, Some(tick)));
                keep(&mut self.handovers, (tick, [before, channel]), HANDOVERS);
            }
            None => self.channel = Some((channel, (tick == 0).then_some(0))),
        }
    }

    fn faults(&self) -> impl Iterator<Item = &InjectedFault> {
        let all = self.planned.iter().chain(&self.injected);
        all.filter(|fault| fault.acted())
    }

    /// Faults that act now, and how long they still will [s]; none if they have no end.
    pub fn active_faults(&self) -> Vec<(&str, Option<f64>)> {
        let (tick, period_s) = (self.run.tick, self.run.flight_time_s(1));
        let mut active = Vec::new();
        for fault in self.faults() {
            if fault.is_active(tick, tick, period_s, &[]) {
                let end = fault.end_tick(period_s, &[]);
                let rest_s = end.map(|end| self.run.flight_time_s(end.saturating_sub(tick)));
                active.push((fault.what.as_str(), rest_s));
            }
        }
        active
    }

    /// The events with their ticks, the newest first; of handovers, which may be many, the newest `handovers`.
    pub fn events(&self, handovers: usize) -> Vec<Event> {
        let mut events = Vec::new();
        let mut add = |tick: u64, kind: &'static str, text: String| {
            if self.run.tick != NO_TICK && tick <= self.run.tick {
                events.push(Event { tick, kind, text });
            }
        };
        for (tick, subject, message) in self.supervision.events() {
            add(tick, subject.name(), message.to_owned());
        }
        for (tick, [before, after]) in self.handovers.iter().rev().take(handovers) {
            let text = format!("channel {after} flies in place of channel {before}");
            add(*tick, "handover", text);
        }
        for it in self.faults() {
            add(it.tick, "fault", format!("fault {}", it.what));
        }
        for (it, end) in self.faults().filter_map(|it| Some((it, it.to_tick?))) {
            add(end, "end", format!("end of the fault {}", it.what));
        }
        for it in &self.statistics.swaps {
            add(it.tick, "parameter", render::sentences::swap(it));
        }
        for it in &self.statistics.targets.followed {
            add(it.tick, "target", render::sentences::target(it));
        }
        events.sort_by_key(|event| std::cmp::Reverse(event.tick));
        events
    }

    /// Updates the time that the hypervisor took from the loops' CPU.
    pub fn update_steal(&mut self) {
        let loops = STAGES.map(|role| self.statuses.get(&role.into()).copied().unwrap_or_default());
        let processor = Watch::new(&loops, true).processor;
        let now = CpuTimes::read(processor);
        match &self.cpu_times {
            Some((known, begin)) if *known == processor => self.steal = begin.steal_until(&now),
            _ => self.cpu_times = Some((processor, now)),
        }
    }

    /// The verdicts so far, and what the one on timing follows from: the plant counts the ticks, and the recorder those
    /// without a fresh command on time, from the start of the flight.
    pub fn verdicts(&self) -> (Verdicts, NotFresh) {
        let (run, statistics) = (&self.run, &self.statistics);
        let ticks = Ticks {
            run: run.ticks_run,
            skipped: run.ticks_skipped,
            ..Ticks::default()
        };
        let recorder = self.statuses.get(&Role::Record.into());
        let [missed, stale] = recorder.map_or([0; 2], |it| [it.commands_missed, it.commands_stale]);
        let not_fresh = match run.period_ns {
            LOCKSTEP => NotFresh::default(),
            _ => NotFresh::new(missed, stale, &ticks),
        };
        let seen = statistics.stages.theorem.section();
        let unwatched = recorder.map_or(0, |it| it.wrenches_unwatched);
        let theorem = Theorem {
            ticks: seen.ticks + unwatched,
            ticks_unwatched: unwatched,
            ..seen
        };
        let limits = self.settings.flight_limits();
        let speed = Speed::of(run.period_ns, run.sample_time_ns);
        let mut verdicts = Verdicts {
            flight: flight_verdict(&statistics.flight(), self.ending, &limits),
            timing: timing_verdict(&ticks, &not_fresh, speed, &self.steal),
            theorem: stability_verdict(&theorem),
        };
        verdicts.end(self.ending, &ticks, run.flight_time_s(ticks.all()));
        (verdicts, not_fresh)
    }
}

/// A verdict as all views show it.
#[derive(Clone, Debug)]
pub struct Judged<'a> {
    pub word: String,
    pub why: &'a str,
    /// None if it is neither good nor bad.
    pub is_good: Option<bool>,
}

impl<'a> Judged<'a> {
    fn new<W: Serialize + PartialEq>(verdict: &'a Explained<W>, good: W, bad: &[W]) -> Self {
        let is_good = verdict.word == good;
        Self {
            word: name_of(&verdict.word),
            why: &verdict.why,
            is_good: (is_good || bad.contains(&verdict.word)).then_some(is_good),
        }
    }

    /// The verdicts on flight, timing and theorem.
    pub fn all(verdicts: &'a Verdicts) -> [Self; 3] {
        use FlightVerdict::{Lost, OffTrack, Tracked};
        use StabilityVerdict::{Broken, Holds};
        use TimingVerdict::{InTime, Late};
        [
            Self::new(&verdicts.flight, Tracked, &[OffTrack, Lost]),
            Self::new(&verdicts.timing, InTime, &[Late]),
            Self::new(&verdicts.theorem, Holds, &[Broken]),
        ]
    }
}

fn tracking(run: &Run, settings: &mut Settings) -> Result<Tracking, Failure> {
    let name = &settings.flight.trajectory;
    if is_file(name) {
        let sha256 = &settings.trajectory.sha256;
        let gone = |what: String| {
            Failure::failed(what).help(format!(
                "restore the file with SHA-256 {sha256}, and start watch again; the flight itself continues, and flight.mcap \
                 contains its points"
            ))
        };
        let points = PointsFile::read(name, settings.trajectory.tolerance)
            .map_err(|e| gone(format!("the trajectory of the flight cannot be shown: {e}")))?;
        if points.sha256 != *sha256 {
            let what = format!("the trajectory file {name} has changed since the flight began");
            return Err(gone(what));
        }
        settings.points = Some(points);
    }
    Ok(Tracking::along(settings.course()?, run.flight_time_s(1)))
}

/// Adds the newest of at most `most`.
fn keep<T>(all: &mut VecDeque<T>, newest: T, most: usize) {
    if all.len() >= most {
        all.pop_front();
    }
    all.push_back(newest);
}

/// Flight time of a point [s].
pub const POINT_S: f64 = 0.1;
pub const POINTS: usize = 600;

/// Something that happened in a flight, and the kind of it: process, fault, end (of a fault), handover, parameter, target.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Event {
    pub tick: u64,
    pub kind: &'static str,
    pub text: String,
}

/// Poses that are kept: two minutes.
pub const POSES: usize = 1200;

/// Where the vehicle is and should be, and what drives it.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    pub time_s: f64,
    pub position_w_m: [f64; 3],
    /// Body to world: w, x, y, z.
    pub attitude: [f64; 4],
    pub yaw_rad: f64,
    pub reference_w_m: [f64; 3],
    pub reference_yaw_rad: f64,
    pub rotor_command_rad_s: [f64; 4],
    pub position_error_m: f64,
    /// Estimates of [`messages::parameters::ESTIMATED`]; none of a law that the theorem does not cover.
    pub estimates: Option<[f64; 3]>,
    /// Their true values.
    pub estimated: [f64; 3],
}

/// The last [`POINTS`] points: the largest value of each tenth of a second.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    points: VecDeque<f64>,
    /// The current point: its number, and the largest value so far.
    present: Option<(u64, f64)>,
}

impl Trace {
    /// Takes the value at a time of the flight [s].
    pub fn take(&mut self, time_s: f64, value: f64) {
        let number = (time_s / POINT_S) as u64;
        match &mut self.present {
            Some((present, largest)) if *present == number => *largest = largest.max(value),
            present => {
                if let Some((_, largest)) = present.replace((number, value)) {
                    keep(&mut self.points, largest, POINTS);
                }
            }
        }
    }

    /// At most `most` newest points, in order of time.
    pub fn newest(&self, most: usize) -> Vec<f64> {
        let present = self.present.map(|(_, largest)| largest);
        let points = self.points.iter().copied().chain(present);
        let surplus = (self.points.len() + present.iter().len()).saturating_sub(most);
        points.skip(surplus).collect()
    }
}
