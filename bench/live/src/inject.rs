//! Changes parameters of a running flight's airframe, and injects faults of messages, stages and their processor.
//!
//! Both are requests to the plant, which answers with the ticks, or with the reason for refusing.

use std::fmt;
use std::time::Duration;

use faults::code::FaultCode;
use faults::live::{LiveFault, MAX_LIVE_FAULTS, NOTICE_TICKS};
use faults::{FaultRefusal, MAX_MESSAGE_FAULTS, Span};
use ipc::instance::Instance;
use ipc::{
    ACCEPTED, BUSY, BlackboardReader, ENDED, FaultAnswer, FaultOrder, MALFORMED, MOST_AT_ONCE,
    RequestClient, SwapAnswer, SwapOrder, SwapOutcome, TargetOrder, Wire,
};
use messages::blackboards::{LOCKSTEP, RUN, Run, RunPhase, SETTINGS, SettingsText};
use messages::content::{self, NO_TICK};
use messages::parameters::{Airframe, ParameterError, after_blank};
use messages::role::Role;
use plant::Target;

use config::Settings;
use config::airframe::PAPER;
use config::planned_faults::{check_channel, check_end, check_possible};
use errors::Failure;
use faults::grammar::{Change, Desired, RequestedValue, check_once, duration, joined, targets_of};
use faults::plan::refused;
use recorder::injected_faults::injected as described;

/// How long the plant may take to answer, beyond the time until the requested tick.
const TIMEOUT: Duration = Duration::from_secs(2);

/// Changes parameters, or injects faults of the loop that last for a time; returns what the plant answered.
pub fn injected(
    instance: &Instance,
    changes: &[Change],
    when: When,
    lasts: Option<Duration>,
) -> Result<String, Failure> {
    let desired: Vec<Desired> = changes.iter().filter_map(Change::wanted).collect();
    if desired.is_empty() {
        return inject_faults(instance, changes, when, lasts);
    }
    if desired.len() < changes.len() {
        let what = "parameters and faults of the loop are not injected by one command";
        let help = "give two commands, both with --at-tick N for the same tick";
        return Err(Failure::usage(what).help(help));
    }
    if lasts.is_some() {
        let what = "--for: a parameter holds until it is changed again";
        return Err(Failure::usage(what).help("inject the change back, as in mass_kg=nominal"));
    }
    Ok(ask(instance, &desired, when)?.to_string())
}

/// Changes parameters or injects faults now, as a line says; returns what the plant answered.
pub fn inject_line(instance: &Instance, line: &str) -> Result<String, Failure> {
    let (changes, lasts) = parse_line(line).map_err(Failure::usage)?;
    injected(instance, &changes, When::NOW, lasts)
}

/// The faults in a line: `state.drop=0.1,inner.late=1ms for 1s`.
pub fn parse_line(text: &str) -> Result<(Vec<Change>, Option<Duration>), String> {
    let (what, time) = match text.split_once(" for ") {
        Some((what, time)) => (what, Some(time.trim())),
        None => (text, None),
    };
    let changes = what.trim().split(',').map(str::parse);
    let changes = changes.collect::<Result<Vec<Change>, _>>();
    let lasts = time.map(duration).transpose()?;
    Ok((changes.map_err(|e| e.to_string())?, lasts))
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum When {
    AtTick(u64),
    /// This much flight time later; from the next tick on if it is zero.
    In(Duration),
}

/// The same in ticks, as the request to the plant has it.
struct Instant {
    /// The tick; `NO_TICK` if it is counted from now.
    at_tick: u64,
    in_ticks: u64,
    /// Newest tick of the flight, and ticks from it to the instant.
    present: u64,
    wait_ticks: u64,
}

impl When {
    pub const NOW: Self = Self::In(Duration::ZERO);

    fn of(self, run: &Run) -> Result<Instant, Failure> {
        let present = run.present_tick();
        let (at_tick, in_ticks, tick) = match self {
            Self::AtTick(tick) => (tick, 0, tick),
            Self::In(after) => {
                let ticks = ticks(after, run.sample_time_ns);
                (NO_TICK, ticks, present.saturating_add(ticks))
            }
        };
        if tick > run.last_tick {
            let last_tick = run.last_tick;
            return Err(Failure::usage(format!(
                "tick {tick} never comes: the flight ends at tick {last_tick}"
            ))
            .help(format!("name one from {present} to {last_tick}")));
        }
        Ok(Instant {
            at_tick,
            in_ticks,
            present,
            wait_ticks: tick.saturating_sub(present),
        })
    }
}

/// A time in ticks, rounded to the nearest one.
fn ticks(time: Duration, sample_time_ns: u64) -> u64 {
    let time_ns = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
    time_ns.saturating_add(sample_time_ns / 2) / sample_time_ns.max(1)
}

/// A parameter change that the plant has applied.
#[derive(Clone, Debug, PartialEq)]
pub struct Applied {
    pub tick: u64,
    /// The requested tick, if it was past.
    pub past_tick: Option<u64>,
    /// The tick as time of the flight [s].
    pub time_s: f64,
    /// Parameter epoch that began with it.
    pub parameter_epoch: u64,
    /// Sample time of the laws [ns].
    pub sample_time_ns: u64,
    pub changes: Vec<content::Change>,
}

impl fmt::Display for Applied {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "applied at tick {} ({:.3} s), parameter epoch {}",
            self.tick, self.time_s, self.parameter_epoch
        )?;
        match self.past_tick {
            Some(past) => writeln!(f, ": tick {past} was past")?,
            None => writeln!(f)?,
        }
        for change in &self.changes {
            let (parameter, steps) = (change.parameter, change.steps);
            let unit = after_blank(parameter.spec().unit);
            write!(
                f,
                "  {parameter}  {:?} -> {:?}{unit}",
                change.old, change.new
            )?;
            if steps > 1 {
                let over = Duration::from_nanos(steps.saturating_mul(self.sample_time_ns));
                write!(f, " over {} s", over.as_secs_f64())?;
            }
            writeln!(f)?;
        }
        Ok(())
    }
}

/// Requests a parameter change from the plant of an instance, and waits for its answer.
pub fn ask(instance: &Instance, desired: &[Desired], when: When) -> Result<Applied, Failure> {
    let wrong = |error: &dyn fmt::Display| {
        Failure::usage(error.to_string()).help("`ironbird params` lists names, units and ranges")
    };
    check_once(desired).map_err(|e| wrong(&e))?;
    let (wire, run) = flying(instance).or_else(|no_flight| {
        check_widest_ranges(desired).map_err(|e| {
            wrong(&format!(
                "{e} for the airframe `{PAPER}`, and no other flies"
            ))
        })?;
        Err(no_flight)
    })?;
    let airframe = airframe(&wire)?;
    let period_s = run.sample_time_ns as f64 / 1e9;
    let targets = targets_of(desired, &airframe, period_s).map_err(|e| wrong(&e))?;
    plant::Swap::to(0, &targets).map_err(|e| wrong(&e))?;
    let instant = when.of(&run)?;
    let changes = targets.iter().map(|it| (it.parameter, it.value, it.steps));
    let changes: Vec<_> = changes.collect();
    let order = SwapOrder::new(instant.at_tick, instant.in_ticks, &changes);
    // In lockstep, ticks take less time than on the clock.
    let tick_ns = run.period_ns.max(run.sample_time_ns);
    let wait = Duration::from_nanos(instant.wait_ticks.saturating_mul(tick_ns));
    let answer = wire.client::<SwapOrder>()?.request(order, TIMEOUT + wait)?;
    check_applied(&answer)?;
    let change = |(target, old): (&Target, f64)| content::Change {
        parameter: target.parameter,
        old,
        new: target.value,
        steps: target.steps,
    };
    Ok(Applied {
        tick: answer.tick,
        past_tick: Some(instant.at_tick).filter(|tick| *tick < answer.tick),
        time_s: run.flight_time_s(answer.tick),
        parameter_epoch: answer.parameter_epoch,
        sample_time_ns: run.sample_time_ns,
        changes: targets.iter().zip(answer.old).map(change).collect(),
    })
}

/// Refuses values that no airframe of any size can have: that need not wait for one that flies.
fn check_widest_ranges(desired: &[Desired]) -> Result<(), ParameterError> {
    for Desired {
        parameter, value, ..
    } in desired
    {
        if let RequestedValue::Number(value) = *value
            && parameter.widest().check(*parameter, value).is_err()
        {
            parameter.check(value)?;
        }
    }
    Ok(())
}

/// The error of a request that the plant has refused.
fn check_applied(answer: &SwapAnswer) -> Result<(), Failure> {
    let outcome = SwapOutcome::from_wire(answer.verdict);
    let why = match outcome.ok_or_else(|| other_version(answer.verdict))? {
        SwapOutcome::Applied => return Ok(()),
        // Checked by the airframe of the flight that was read.
        SwapOutcome::UnknownParameter | SwapOutcome::OutOfRange | SwapOutcome::Malformed => {
            "the change is not possible for its airframe: another flight may have begun since it was checked; ask again"
        }
        SwapOutcome::QueueFull => {
            "too many parameter changes wait for their ticks; ask again later"
        }
        SwapOutcome::Ended => "the run ended before the tick",
    };
    Err(plant_refused(why))
}

fn plant_refused(why: &str) -> Failure {
    Failure::failed(format!("the plant refused: {why}"))
}

fn other_version(verdict: u64) -> Failure {
    Failure::failed(format!(
        "the plant's answer {verdict} is of another version"
    ))
}

/// Requests faults of the loop from the plant of an instance, and waits for its answer.
fn inject_faults(
    instance: &Instance,
    changes: &[Change],
    when: When,
    lasts: Option<Duration>,
) -> Result<String, Failure> {
    let mut once = changes.iter().filter(|change| !change.lasts());
    if let (Some(once), Some(_)) = (once.next(), lasts) {
        let what = format!("--for: {once} happens once, at an instant");
        return Err(Failure::usage(what).help("leave it out"));
    }
    let (wire, run) = flying(instance)?;
    let (in_lockstep, has_supervisor) = (run.period_ns == LOCKSTEP, run.launcher_pid != 0);
    for change in changes {
        for (kind, _) in change.kinds() {
            check_possible(&kind, &change.to_string(), in_lockstep, has_supervisor)?;
            check_channel(&kind, &change.to_string(), run.channels as usize)?;
        }
    }
    let period_s = run.sample_time_ns as f64 / 1e9;
    let for_ticks = lasts.map_or(Span::FOR_GOOD, |time| ticks(time, run.sample_time_ns));
    if for_ticks == 0 {
        let tick_ms = period_s * 1e3;
        return Err(Failure::usage(format!(
            "--for: it is less than half a tick: one is {tick_ms} ms here"
        )));
    }
    let faults = |span| changes.iter().flat_map(move |change| change.faults(span));
    let requested: Vec<LiveFault> = faults(Span::new(0, for_ticks)).collect();
    let count = requested.len();
    if count > MOST_AT_ONCE {
        return Err(Failure::usage(format!(
            "{count} faults at once, counted by input: allowed are {MOST_AT_ONCE}"
        ))
        .help("give several commands, all with --at-tick N for the same tick"));
    }
    let instant = when.of(&run)?;
    let notice_ticks = instant.wait_ticks.max(NOTICE_TICKS);
    let from = instant.present.saturating_add(notice_ticks);
    let what = format!("--for: the fault {}", joined(changes));
    check_end(&what, from.saturating_add(for_ticks), run.last_tick)?;
    let mut order = FaultOrder {
        at_tick: instant.at_tick,
        in_ticks: instant.in_ticks,
        for_ticks,
        count: count as u64,
        faults: [FaultCode::default(); MOST_AT_ONCE],
    };
    for (code, fault) in order.faults.iter_mut().zip(&requested) {
        *code = FaultCode::of(fault);
    }
    // The plant answers when it has taken them; they begin later.
    let timeout = TIMEOUT + Duration::from_nanos(run.period_ns);
    let answer = wire.client::<FaultOrder>()?.request(order, timeout)?;
    check_taken(&answer, &requested, period_s)?;
    let taken: Vec<LiveFault> = faults(Span::new(answer.from, answer.to)).collect();
    let mut text = String::new();
    for fault in described(&taken, period_s) {
        text += &format!("{}\n", render::sentences::fault(&fault));
    }
    if instant.at_tick < answer.from {
        let tick = instant.at_tick;
        text += &format!(
            "tick {tick} was past, or too near: all stages are notified {NOTICE_TICKS} ticks before\n"
        );
    }
    Ok(text)
}

/// The error of faults that the plant has refused.
fn check_taken(answer: &FaultAnswer, faults: &[LiveFault], period_s: f64) -> Result<(), Failure> {
    let why = match answer.verdict {
        ACCEPTED => return Ok(()),
        MALFORMED => "the request contains no fault".into(),
        ENDED => "the run ended before it".into(),
        verdict => {
            let reason = FaultRefusal::from_wire(verdict).ok_or_else(|| other_version(verdict))?;
            match faults
                .get(answer.which as usize)
                .filter(|_| reason != FaultRefusal::NoRoom)
            {
                Some(fault) => refused(reason, fault, period_s).to_string(),
                None => format!(
                    "it has no room for more: a flight takes {MAX_LIVE_FAULTS} faults by `inject`, counted by input, of \
                     which {MAX_MESSAGE_FAULTS} of messages with those that were planned"
                ),
            }
        }
    };
    Err(plant_refused(&why))
}

fn ended() -> Failure {
    Failure::failed("the flight that it was meant for has ended")
}

/// The wire of a run that flies; a request to it must not reach the next one.
pub fn still_flying(instance: &Instance, run_id: u64) -> Result<Wire, Failure> {
    let flies = flight(instance)?.filter(|(_, run)| run.run_id == run_id);
    flies.map(|(wire, _)| wire).ok_or_else(ended)
}

/// A client for targets, open for as long as a flight lasts: they come many times a second.
pub struct TargetClient {
    run_id: u64,
    run: BlackboardReader<Run>,
    client: RequestClient<TargetOrder>,
    _wire: Wire,
}

impl TargetClient {
    /// The client of a flight, which is opened if there is none yet.
    pub fn of<'a>(
        opened: &'a mut Option<Self>,
        instance: &Instance,
        run_id: u64,
    ) -> Result<&'a Self, Failure> {
        let is_known = |it: &Self| it.run_id == run_id && it.run.get().phase() == RunPhase::Flying;
        let known = opened.take().filter(is_known);
        let client = match known {
            Some(client) => client,
            None => Self::open(instance, run_id)?,
        };
        Ok(opened.insert(client))
    }

    fn open(instance: &Instance, run_id: u64) -> Result<Self, Failure> {
        let wire = still_flying(instance, run_id)?;
        let run = wire.blackboard_reader::<Run>(RUN)?;
        Ok(Self {
            run_id,
            run: run.ok_or_else(ended)?,
            client: wire.client()?,
            _wire: wire,
        })
    }

    /// Requests a target from the plant, and waits for its answer.
    pub fn aim(&self, order: TargetOrder) -> Result<String, Failure> {
        match self.client.request(order, TIMEOUT)?.verdict {
            ACCEPTED => Ok(String::new()),
            MALFORMED => Err(plant_refused("the target is out of range")),
            ENDED => Err(plant_refused("the run ended before it")),
            BUSY => Err(plant_refused("too many requests wait; ask again later")),
            verdict => Err(other_version(verdict)),
        }
    }
}

/// The wire and the run of an instance that flies.
pub fn flying(instance: &Instance) -> Result<(Wire, Run), Failure> {
    if let Some(flight) = flight(instance)? {
        return Ok(flight);
    }
    let name = instance.name();
    if instance.is_alive() {
        let what = format!("instance `{name}` has not taken off, or has landed");
        return Err(Failure::failed(what).help(
            "a flight begins when plant, outer, inner and mixer are ready; each says for whom it waits",
        ));
    }
    let others = Instance::flying();
    let others: Vec<&str> = others.iter().map(Instance::name).collect();
    let help = match others.join(", ") {
        none if none.is_empty() => "no instance flies; start one: ironbird fly".to_owned(),
        others => format!("running instances: {others}; name one with --instance NAME"),
    };
    Err(Failure::failed(format!("no flight is running as instance `{name}`")).help(help))
}

/// The wire and the run of an instance, if it flies.
pub fn flight(instance: &Instance) -> Result<Option<(Wire, Run)>, Failure> {
    if !instance.look_for(Role::Plant)? {
        return Ok(None);
    }
    let wire = Wire::open(instance)?;
    let run = wire.blackboard_reader::<Run>(RUN)?;
    let run = run.map(|blackboard| blackboard.get()).unwrap_or_default();
    Ok((run.phase() == RunPhase::Flying).then_some((wire, run)))
}

/// The airframe that flies, as it was built.
pub fn airframe(wire: &Wire) -> Result<Airframe, Failure> {
    let text = wire.blackboard_reader::<SettingsText>(SETTINGS)?;
    let text = text.map(|blackboard| blackboard.get()).unwrap_or_default();
    Settings::of_shared(text.text())?.as_built()
}
