//! Faults of messages, stages and their processor, injected into a flight in the air.

use std::fmt;
use std::time::Duration;

use ipc::injection::{ENDED, MALFORMED, MOST_AT_ONCE, STRIKES};
use ipc::instance::Instance;
use ipc::{FaultAnswer, FaultOrder};
use messages::blackboards::LOCKSTEP;
use messages::fault::code::FaultCode;
use messages::fault::live::{LiveFault, MOST_LIVE, NOTICE_TICKS};
use messages::fault::{MOST, NotTaken, Span};

use crate::fault::injected;
use crate::fault::plan::refused;
use crate::fault::{Change, FaultError};
use crate::inject::{Instant, PATIENCE, When, flying, ticks};
use crate::settings::faults::{check_possible, check_priority};
use errors::Failure;
use report::faults::InjectedFault;

/// Faults that the plant has taken.
#[derive(Clone, Debug, PartialEq)]
pub struct Strikes {
    pub faults: Vec<InjectedFault>,
    /// The tick that was asked for, where it was too early.
    pub early_tick: Option<u64>,
}

impl fmt::Display for Strikes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for fault in &self.faults {
            writeln!(f, "{}", fault.words())?;
        }
        self.early_tick.map_or(Ok(()), |tick| {
            writeln!(
                f,
                "tick {tick} was past, or too near: all stages are told {NOTICE_TICKS} ticks before"
            )
        })
    }
}

/// Has the plant of an instance take faults, and waits for its answer.
///
/// # Errors
/// Usage; nobody flying; what cannot go wrong in this flight; a refusal by the plant; no answer in time.
pub fn strike(
    instance: &Instance,
    changes: &[Change],
    when: When,
    lasts: Option<Duration>,
) -> Result<Strikes, Failure> {
    if let Some(once) = changes
        .iter()
        .find(|change| lasts.is_some() && !change.lasts())
    {
        return Err(
            Failure::usage(format!("--for: {once} happens once, at an instant"))
                .help("leave it out"),
        );
    }
    let (wire, run) = flying(instance)?;
    for change in changes {
        for (trouble, ends) in change.kinds() {
            check_possible(
                &trouble,
                &change.to_string(),
                run.period_ns == LOCKSTEP,
                run.launcher_pid != 0,
            )?;
            if !ends {
                check_priority(&trouble)?;
            }
        }
    }
    let for_ticks = lasts.map_or(Span::FOR_GOOD, |time| ticks(time, run.sample_time_ns));
    if for_ticks == 0 {
        let tick_ms = run.sample_time_ns as f64 / 1e6;
        return Err(Failure::usage(format!(
            "--for: it is less than a tick, which is {tick_ms} ms here"
        )));
    }
    let faults: Vec<LiveFault> = changes
        .iter()
        .flat_map(|change| {
            change.faults(Span {
                from: 0,
                to: for_ticks,
            })
        })
        .collect();
    let mut order = FaultOrder {
        at_tick: 0,
        in_ticks: 0,
        for_ticks,
        count: faults.len() as u64,
        faults: [FaultCode::default(); MOST_AT_ONCE],
    };
    if faults.len() > MOST_AT_ONCE {
        let what = format!(
            "{} faults at once, counted by input: allowed are {MOST_AT_ONCE}",
            faults.len()
        );
        return Err(Failure::usage(what)
            .help("give several commands, all with --at-tick N for the same tick"));
    }
    order
        .faults
        .iter_mut()
        .zip(&faults)
        .for_each(|(words, fault)| *words = FaultCode::of(fault));
    let Instant {
        at_tick, in_ticks, ..
    } = when.of(&run)?;
    (order.at_tick, order.in_ticks) = (at_tick, in_ticks);
    // The plant answers when it has taken them; they strike later.
    let answer = wire
        .fault_client()?
        .ask(order, PATIENCE + Duration::from_nanos(run.period_ns))?;
    let FaultAnswer { from, to, .. } = answer;
    check(&answer, &faults, run.sample_time_ns as f64 / 1e9)?;
    let taken: Vec<LiveFault> = faults
        .iter()
        .map(|fault| LiveFault {
            span: fault.span_from(Span { from, to }),
            ..*fault
        })
        .collect();
    let early_tick = Some(at_tick).filter(|tick| *tick < from);
    Ok(Strikes {
        faults: injected(&taken, run.sample_time_ns as f64 / 1e9),
        early_tick,
    })
}

/// Whether the plant has taken them.
fn check(answer: &FaultAnswer, faults: &[LiveFault], period_s: f64) -> Result<(), Failure> {
    let no = |why: String| Err(Failure::failed(format!("the plant refused: {why}")));
    match answer.verdict {
        STRIKES => Ok(()),
        MALFORMED => no("what was asked for is no fault".into()),
        ENDED => no("the run ended before it".into()),
        verdict => match NotTaken::from_wire(verdict) {
            Some(reason) => {
                let which = usize::try_from(answer.which)
                    .ok()
                    .and_then(|which| faults.get(which));
                let why = which.map(|fault| refused(reason, fault, period_s));
                match why {
                    Some(FaultError::TooMany) | None => no(format!(
                        "it has no room for more: a flight takes {MOST_LIVE} faults by `inject`, counted by input, of \
                         which {MOST} of messages with those that were planned"
                    )),
                    Some(why) => no(why.to_string()),
                }
            }
            None => Err(Failure::failed(format!(
                "the plant's answer {verdict} is of another version"
            ))),
        },
    }
}
