//! `ironbird inject`: swaps parameters of a flying airframe.

use std::time::Duration;

use shared::boards::{RUN, Run, RunPhase};
use shared::instance::Instance;
use shared::messages::NO_TICK;
use shared::parameters::{PARAMETERS, Parameter, ParameterError};
use shared::role::Role;
use shared::wire::{SwapAnswer, SwapOrder, Verdict, Wire};

use crate::cli::InjectArgs;
use crate::failure::{Failure, OK};
use crate::output::print;

/// How long the plant may take to answer, beyond the time until the tick that was asked for.
const PATIENCE: Duration = Duration::from_secs(2);

/// Asks the plant for a swap and prints what it answers.
///
/// # Errors
/// Usage; nobody flying; a refusal by the plant; no answer in time.
pub fn inject(args: &InjectArgs) -> Result<u8, Failure> {
    let changes = args
        .parsed()
        .and_then(|changes| plant::Swap::new(0, &changes).map(|_| changes).map_err(Into::into))
        .map_err(|e| Failure::usage(e.to_string()).help("`ironbird params` lists names, units and ranges"))?;
    let instance = Instance::new(&args.instance)?;
    let (wire, run) = flying(&instance)?;
    let in_ticks = args.after.map_or(0, |after| ticks(after, run.sample_time_ns));
    let wait_ticks = args.at_tick.map_or(in_ticks, |at| at.saturating_sub(run.tick));
    let present = if run.tick == NO_TICK { 0 } else { run.tick };
    let wanted = args.at_tick.unwrap_or(present + in_ticks);
    if wanted > run.last_tick {
        return Err(Failure::usage(format!("tick {wanted} never comes: the flight ends at tick {}", run.last_tick)));
    }
    let mut order = SwapOrder {
        at_tick: args.at_tick.unwrap_or(NO_TICK),
        in_ticks,
        count: changes.len() as u64,
        parameter: [0; PARAMETERS],
        value: [0.0; PARAMETERS],
    };
    for (i, (parameter, value)) in changes.iter().enumerate() {
        order.parameter[i] = *parameter as u64;
        order.value[i] = *value;
    }
    let patience = PATIENCE + Duration::from_nanos(wait_ticks.saturating_mul(run.period_ns));
    let answer = wire.swap_client()?.ask(order, patience)?;
    print_answer(&changes, &answer, &run)
}

fn ticks(time: Duration, sample_time_ns: u64) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX) / sample_time_ns.max(1)
}

/// The wire and the run of an instance that flies.
///
/// # Errors
/// [`Failure`] says that nobody flies, and lists the instances that do.
pub fn flying(instance: &Instance) -> Result<(Wire, Run), Failure> {
    let nobody = || {
        let others: Vec<String> = Instance::flying().iter().map(|other| other.name().to_owned()).collect();
        let help = if others.is_empty() {
            "no instance flies; start one: ironbird fly".to_owned()
        } else {
            format!("these fly: {} (--instance NAME)", others.join(", "))
        };
        Failure::failed(format!("instance `{}` does not fly", instance.name())).help(help)
    };
    if !instance.is_occupied(Role::Plant) {
        return Err(nobody());
    }
    let wire = Wire::open(instance)?;
    let run = wire.board_reader::<Run>(RUN)?.map(|board| board.get()).unwrap_or_default();
    if run.phase() == RunPhase::Flying { Ok((wire, run)) } else { Err(nobody()) }
}

fn print_answer(changes: &[(Parameter, f64)], answer: &SwapAnswer, run: &Run) -> Result<u8, Failure> {
    let refused = |why: String| Err(Failure::failed(format!("the plant refused: {why}")));
    match Verdict::from_wire(answer.verdict) {
        Some(Verdict::Applied) => {
            let mut text = format!(
                "applied at tick {} ({:.3} s), parameter epoch {}\n",
                answer.tick,
                run.flight_time_s(answer.tick),
                answer.parameter_epoch
            );
            for ((parameter, value), old) in changes.iter().zip(answer.old) {
                text += &format!("  {parameter}  {old:?} -> {value:?} {}\n", parameter.spec().unit);
            }
            print(&text)?;
            Ok(OK)
        }
        Some(Verdict::OutOfRange) => match Parameter::from_index(answer.parameter) {
            Some(parameter) => {
                let value = changes.iter().find(|(p, _)| *p == parameter).map_or(f64::NAN, |(_, value)| *value);
                refused(ParameterError::OutOfRange { parameter, value }.to_string())
            }
            None => refused("a value is out of range".into()),
        },
        Some(Verdict::UnknownParameter) => refused("it does not know one of the parameters".into()),
        Some(Verdict::Malformed) => refused("the swap names no parameter, or one twice".into()),
        Some(Verdict::QueueFull) => refused("too many swaps wait for their ticks; ask again later".into()),
        Some(Verdict::Ended) => refused("the run ended before the tick".into()),
        None => Err(Failure::failed(format!("the plant's answer {} is of another version", answer.verdict))),
    }
}
