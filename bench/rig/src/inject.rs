//! `ironbird inject`: swaps parameters of a flying airframe, and has messages, stages and their processor fail.

pub mod strike;

use std::fmt;
use std::time::Duration;

use ipc::instance::Instance;
use ipc::{SwapAnswer, SwapOrder, SwapOutcome, Wire};
use messages::blackboards::{RUN, Run, RunPhase, SETTINGS, SettingsText};
use messages::content::{self, NO_TICK};
use messages::parameters::{Airframe, PARAMETERS, Parameter, ParameterError, after_blank};
use messages::role::Role;
use plant::Target;

use crate::cli::InjectArgs;
use crate::cli::values::duration;
use crate::fault::{Change, Desired, FaultError, RequestedValue, check_once, targets_of};
use crate::inject::strike::strike;
use crate::output::print;
use crate::settings::airframe::{PAPER, airframe_of, pairs};
use errors::{Failure, OK};

/// How long the plant may take to answer, beyond the time until the tick that was asked for.
const PATIENCE: Duration = Duration::from_secs(2);

/// Asks the plant for what goes wrong and prints what it answers.
pub fn inject(args: &InjectArgs) -> Result<u8, Failure> {
    let changes = args.parsed().map_err(|e| listed(&e))?;
    let when = match (args.at_tick, args.after) {
        (Some(tick), _) => When::AtTick(tick),
        (None, after) => When::In(after.unwrap_or_default()),
    };
    print(&injected(
        &Instance::new(&args.instance)?,
        &changes,
        when,
        args.lasts,
    )?)?;
    Ok(OK)
}

/// Injects parameters, or faults of the loop that last for a time; says what came of it.
pub fn injected(
    instance: &Instance,
    changes: &[Change],
    when: When,
    lasts: Option<Duration>,
) -> Result<String, Failure> {
    let wanted: Vec<Desired> = changes.iter().filter_map(Change::wanted).collect();
    if wanted.is_empty() {
        return Ok(strike(instance, changes, when, lasts)?.to_string());
    }
    if wanted.len() < changes.len() {
        return Err(Failure::usage(
            "parameters and faults of the loop are not injected by one command",
        )
        .help("give two commands, both with --at-tick N for the same tick"));
    }
    if lasts.is_some() {
        return Err(
            Failure::usage("--for: a parameter holds until it is changed again")
                .help("inject the change back, as in mass_kg=nominal"),
        );
    }
    Ok(ask(instance, &wanted, when)?.to_string())
}

/// What somebody typed into a line: `state.drop=0.1,inner.late=1ms for 1s`.
pub fn words_of(text: &str) -> Result<(Vec<Change>, Option<Duration>), String> {
    let (what, time) = match text.split_once(" for ") {
        Some((what, time)) => (what, Some(time.trim())),
        None => (text, None),
    };
    let changes = what
        .trim()
        .split(',')
        .map(str::parse)
        .collect::<Result<Vec<Change>, _>>();
    let lasts = time.map(duration).transpose()?;
    Ok((changes.map_err(|e| e.to_string())?, lasts))
}

fn listed(error: &FaultError) -> Failure {
    Failure::usage(error.to_string()).help(error.listed(""))
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum When {
    AtTick(u64),
    /// This much flight time later; from the next tick on where it is nothing.
    In(Duration),
}

/// The same in ticks, as the plant is asked.
struct Instant {
    /// The tick; `NO_TICK` where it is counted from now.
    at_tick: u64,
    in_ticks: u64,
    wait_ticks: u64,
}

impl When {
    fn of(self, run: &Run) -> Result<Instant, Failure> {
        let present = if run.tick == NO_TICK { 0 } else { run.tick };
        let (at_tick, in_ticks) = match self {
            Self::AtTick(tick) => (tick, 0),
            Self::In(after) => (NO_TICK, ticks(after, run.sample_time_ns)),
        };
        let wanted = if at_tick == NO_TICK {
            present.saturating_add(in_ticks)
        } else {
            at_tick
        };
        if wanted > run.last_tick {
            let what = format!(
                "tick {wanted} never comes: the flight ends at tick {}",
                run.last_tick
            );
            return Err(
                Failure::usage(what).help(format!("name one from {present} to {}", run.last_tick))
            );
        }
        Ok(Instant {
            at_tick,
            in_ticks,
            wait_ticks: wanted.saturating_sub(present),
        })
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Applied {
    pub tick: u64,
    /// The tick that was asked for, where it was past.
    pub past_tick: Option<u64>,
    /// The same as time of the flight [s].
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
        for content::Change {
            parameter,
            old,
            new,
            steps,
        } in &self.changes
        {
            write!(
                f,
                "  {parameter}  {old:?} -> {new:?}{}",
                after_blank(parameter.spec().unit)
            )?;
            if *steps > 1 {
                let over = Duration::from_nanos(steps.saturating_mul(self.sample_time_ns));
                write!(f, " over {} s", over.as_secs_f64())?;
            }
            writeln!(f)?;
        }
        Ok(())
    }
}

fn wrong(error: &impl fmt::Display) -> Failure {
    Failure::usage(error.to_string()).help("`ironbird params` lists names, units and ranges")
}

/// Asks the plant of an instance for a swap, and waits for its answer.
pub fn ask(instance: &Instance, wanted: &[Desired], when: When) -> Result<Applied, Failure> {
    check_once(wanted).map_err(|e| wrong(&e))?;
    if flight(instance).is_ok_and(|flight| flight.is_none()) {
        check_possible(wanted)?;
    }
    let (wire, run) = flying(instance)?;
    let airframe = airframe(&wire)?;
    let targets =
        targets_of(wanted, &airframe, run.sample_time_ns as f64 / 1e9).map_err(|e| wrong(&e))?;
    plant::Swap::to(0, &targets).map_err(|e| wrong(&e))?;
    let Instant {
        at_tick,
        in_ticks,
        wait_ticks,
    } = when.of(&run)?;
    let mut order = SwapOrder {
        at_tick,
        in_ticks,
        count: targets.len() as u64,
        parameter: [0; PARAMETERS],
        value: [0.0; PARAMETERS],
        steps: [1; PARAMETERS],
    };
    for (
        i,
        &Target {
            parameter,
            value,
            steps,
        },
    ) in targets.iter().enumerate()
    {
        (order.parameter[i], order.value[i], order.steps[i]) = (parameter as u64, value, steps);
    }
    let patience = PATIENCE + Duration::from_nanos(wait_ticks.saturating_mul(run.period_ns));
    let answer = wire.swap_client()?.ask(order, patience)?;
    read_answer(&targets, at_tick, &answer, &run, &airframe)
}

/// Refuses what no airframe of any size can have: that need not wait for one that flies.
fn check_possible(wanted: &[Desired]) -> Result<(), Failure> {
    for Desired {
        parameter, value, ..
    } in wanted
    {
        if let RequestedValue::Number(value) = *value
            && parameter.widest().check(*parameter, value).is_err()
        {
            let paper = |e| {
                wrong(&format!(
                    "{e} for the airframe `{PAPER}`, and no other flies"
                ))
            };
            parameter.check(value).map_err(paper)?;
        }
    }
    Ok(())
}

fn ticks(time: Duration, sample_time_ns: u64) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX) / sample_time_ns.max(1)
}

/// The wire and the run of an instance that flies.
pub fn flying(instance: &Instance) -> Result<(Wire, Run), Failure> {
    flight(instance)?.ok_or_else(|| {
        if instance.is_alive() {
            return Failure::failed(format!("instance `{}` has not taken off, or has landed", instance.name()))
                .help("a flight begins when plant, outer, inner and mixer are ready; each says for whom it waits");
        }
        let others: Vec<String> = Instance::flying().iter().map(|other| other.name().to_owned()).collect();
        let help = if others.is_empty() {
            "no instance flies; start one: ironbird fly".to_owned()
        } else {
            format!("running instances: {}; name one with --instance NAME", others.join(", "))
        };
        Failure::failed(format!("no flight is running as instance `{}`", instance.name())).help(help)
    })
}

/// The wire and the run of an instance, if it flies.
pub fn flight(instance: &Instance) -> Result<Option<(Wire, Run)>, Failure> {
    if !instance.look_for(Role::Plant)? {
        return Ok(None);
    }
    let wire = Wire::open(instance)?;
    let run = wire
        .blackboard_reader::<Run>(RUN)?
        .map(|board| board.get())
        .unwrap_or_default();
    Ok((run.phase() == RunPhase::Flying).then_some((wire, run)))
}

/// The airframe that flies, as it was built.
pub fn airframe(wire: &Wire) -> Result<Airframe, Failure> {
    let text = wire
        .blackboard_reader::<SettingsText>(SETTINGS)?
        .map(|board| board.get())
        .unwrap_or_default();
    airframe_of(&pairs(text.text()))
}

fn read_answer(
    targets: &[Target],
    at_tick: u64,
    answer: &SwapAnswer,
    run: &Run,
    airframe: &Airframe,
) -> Result<Applied, Failure> {
    let refused = |why: String| Err(Failure::failed(format!("the plant refused: {why}")));
    match SwapOutcome::from_wire(answer.verdict) {
        Some(SwapOutcome::Applied) => Ok(Applied {
            tick: answer.tick,
            past_tick: (at_tick < answer.tick).then_some(at_tick),
            time_s: run.flight_time_s(answer.tick),
            parameter_epoch: answer.parameter_epoch,
            sample_time_ns: run.sample_time_ns,
            changes: targets
                .iter()
                .zip(answer.old)
                .map(
                    |(
                        &Target {
                            parameter,
                            value,
                            steps,
                        },
                        old,
                    )| content::Change {
                        parameter,
                        old,
                        new: value,
                        steps,
                    },
                )
                .collect(),
        }),
        Some(SwapOutcome::OutOfRange) => match Parameter::from_index(answer.parameter) {
            Some(parameter) => {
                let wanted = targets.iter().find(|target| target.parameter == parameter);
                let value = wanted.map_or(f64::NAN, |target| target.value);
                refused(
                    ParameterError::OutOfRange {
                        parameter,
                        value,
                        range: airframe.range(parameter),
                    }
                    .to_string(),
                )
            }
            None => refused("a value is out of range".into()),
        },
        Some(SwapOutcome::UnknownParameter) => {
            refused("it does not know one of the parameters".into())
        }
        Some(SwapOutcome::Malformed) => {
            refused("the swap names no parameter, or one twice, or a ramp of no length".into())
        }
        Some(SwapOutcome::QueueFull) => {
            refused("too many swaps wait for their ticks; ask again later".into())
        }
        Some(SwapOutcome::Ended) => refused("the run ended before the tick".into()),
        None => Err(Failure::failed(format!(
            "the plant's answer {} is of another version",
            answer.verdict
        ))),
    }
}
