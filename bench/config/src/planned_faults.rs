//! The faults of the settings: what they are in ticks, and whether the flight is long enough for them.

use faults::live::LiveFault;
use faults::{FaultKind, Span, StageTicks, Target};
use messages::realtime::RealtimeStep;
use messages::role::Channel;
use process::rt::{fifo_refusal, remedy};

use crate::settings::{PaceName, Settings};
use analysis::faults::InjectedFault;
use errors::Failure;
use faults::grammar::{Change, Fault, FaultError, planned_again};
use faults::plan::Planned;

impl Settings {
    pub fn planned(&self) -> Result<Planned, Failure> {
        let airframe = self.airframe()?;
        let (period_s, seed) = (self.flight.period_s, self.flight.seed);
        let planned = self
            .typed_faults()
            .and_then(|faults| Planned::new(&faults, period_s, &airframe, seed));
        planned.map_err(|e| {
            Failure::usage(format!("fault: {e} ({})", e.listed(&self.airframe_flag())))
        })
    }

    /// The faults as they were typed.
    pub fn typed_faults(&self) -> Result<Vec<Fault>, FaultError> {
        self.flight.faults.iter().map(|text| text.parse()).collect()
    }

    /// The planned faults of messages, stages and their processor, for the report.
    pub fn injected(&self) -> Result<Vec<InjectedFault>, Failure> {
        self.planned_faults_beside(&[])
    }

    /// The planned faults of a flight into which the `live` ones were injected, each up to the fault that ends it.
    pub fn planned_faults_beside(&self, live: &[LiveFault]) -> Result<Vec<InjectedFault>, Failure> {
        let period_s = self.flight.period_s;
        let planned = spans(&self.flight.faults, period_s)?;
        let planned = planned.into_iter().map(|fault| (fault, true));
        let live = planned_again(live).into_iter().map(|fault| {
            let from = fault.from.tick(period_s);
            let to = Span::FOR_GOOD;
            ((fault, Span { from, to }), false)
        });
        let mut injected: Vec<(InjectedFault, Vec<FaultKind>)> = Vec::new();
        for ((fault, Span { from, to }), is_planned) in planned.chain(live) {
            let what: Vec<String> = fault.of_the_loop().map(Change::to_string).collect();
            let kinds = fault.of_the_loop().flat_map(Change::kinds);
            let (ends, begins): (Vec<_>, Vec<_>) = kinds.partition(|(_, ends)| *ends);
            let is_ended = |kind: &FaultKind| ends.iter().any(|(end, _)| kind.is_ended_by(end));
            for (fault, kinds) in &mut injected {
                let before = kinds.len();
                kinds.retain(|kind| !is_ended(kind));
                if before > 0 && kinds.is_empty() {
                    fault.end(from, period_s);
                }
            }
            if is_planned && !what.is_empty() {
                let to = (to != Span::FOR_GOOD).then_some(to);
                let described = InjectedFault::new(what.join(","), from, to, period_s);
                let kinds = begins.into_iter().map(|(kind, _)| kind);
                injected.push((described, kinds.collect()));
            }
        }
        Ok(injected.into_iter().map(|(fault, _)| fault).collect())
    }

    /// Refuses faults that this flight cannot have.
    pub fn check_faults(&self) -> Result<(), Failure> {
        let swaps = self.planned()?.swaps.len();
        let most = plant::swap::PENDING_SWAPS;
        if swaps > most {
            return Err(Failure::usage(format!(
                "flight.faults has {swaps} parameter changes: allowed are {most}"
            ))
            .help("put values that change at the same instant into one fault: NAME=VALUE,NAME=VALUE@8s"));
        }
        let last_tick = self.last_tick();
        for (fault, Span { from, to }) in spans(&self.flight.faults, self.flight.period_s)? {
            for (kind, _) in fault.of_the_loop().flat_map(Change::kinds) {
                check_channel(&kind, &fault.to_string(), self.rt.channels)?;
                if kind.switch().is_some() && !self.has_several_laws() {
                    let what = format!("{fault}: all channels fly the same laws");
                    return Err(Failure::usage(what)
                        .help("name another law for a channel: --channel b:inner=pid"));
                }
            }
            if from > last_tick {
                return Err(Failure::usage(format!(
                    "a fault at tick {from} is after the end of the flight: the last tick is {last_tick}"
                ))
                .help("fly longer (--duration), or inject the fault earlier"));
            }
            check_end(&format!("the fault {fault}"), to, last_tick)?;
        }
        Ok(())
    }

    /// Refuses faults that these processes cannot have: those of a supervisor, or those that were started by hand.
    pub fn check_faults_of_processes(&self, launched: bool) -> Result<(), Failure> {
        let in_lockstep = self.flight.pace == PaceName::Lockstep;
        for (fault, _) in spans(&self.flight.faults, self.flight.period_s)? {
            for change in fault.of_the_loop() {
                for (kind, _) in change.kinds() {
                    check_possible(&kind, &change.to_string(), in_lockstep, launched)?;
                }
            }
        }
        Ok(())
    }

    /// Refuses a planned process whose priority the kernel does not grant here.
    pub fn check_priorities(&self) -> Result<(), Failure> {
        let acts = self.planned()?.acts;
        acts.iter()
            .try_for_each(|fault| check_priority(&fault.kind))
    }
}

fn spans(faults: &[String], period_s: f64) -> Result<Vec<(Fault, Span)>, Failure> {
    let span = |text: &String| {
        let fault: Fault = text.parse()?;
        let span = fault.span(period_s)?;
        Ok((fault, span))
    };
    let spans: Result<_, FaultError> = faults.iter().map(span).collect();
    spans.map_err(|e| Failure::usage(format!("fault: {e}")))
}

/// Refuses a fault that ends after the flight.
pub fn check_end(what: &str, to: u64, last_tick: u64) -> Result<(), Failure> {
    if to == Span::FOR_GOOD || to <= last_tick.saturating_add(1) {
        return Ok(());
    }
    Err(Failure::usage(format!(
        "{what} ends at tick {to}, after the flight: that ends at tick {last_tick}"
    ))
    .help("leave out its end, so that it lasts until the flight ends, or fly longer (--duration)"))
}

/// Refuses a fault in a channel that the flight does not have; `what` is how it was typed.
pub fn check_channel(kind: &FaultKind, what: &str, channels: usize) -> Result<(), Failure> {
    match kind.channel() {
        Some(_) if channels == 1 && kind.role().is_none() => Err(Failure::usage(format!(
            "{what}: the flight has one channel"
        ))
        .help("another channel needs laws of its own: ironbird fly --channels 2 --channel b:inner=pid")),
        Some(channel) if channels == 1 => Err(Failure::usage(format!(
            "{what}: the flight has one channel, so that a stage needs no letter"
        ))
        .help(format!(
            "leave out `{channel}.`, or fly with more channels: --channels 2"
        ))),
        Some(channel) if channel as usize >= channels => Err(Failure::usage(format!(
            "{what}: the flight has {channels} channels: a to {}",
            Channel::ALL[channels - 1]
        ))
        .help("name one of them, or fly with --channels 3")),
        _ => Ok(()),
    }
}

/// Refuses what cannot go wrong in a flight of this pace, or one without a launcher; `what` is how it was typed.
pub fn check_possible(
    kind: &FaultKind,
    what: &str,
    in_lockstep: bool,
    launched: bool,
) -> Result<(), Failure> {
    match kind.target {
        Target::Message(..) | Target::Number(..) | Target::Channel(..) => Ok(()),
        Target::Processor(_) if in_lockstep => Err(Failure::usage(format!(
            "{what}: in lockstep no tick is late, however busy the processor is"
        ))
        .help("fly on the clock: --pace realtime")),
        Target::Stage(..) if in_lockstep => Err(Failure::usage(format!(
            "{what}: in lockstep ticks wait for a stage that is not ready"
        ))
        .help("fly on the clock: --pace realtime; `ironbird simulate` flies it in ticks")),
        // The stage itself computes longer.
        Target::Stage(..) if matches!(kind.stage_ticks(), Some(StageTicks::Late(_))) => Ok(()),
        Target::Stage(..) | Target::Processor(_) if !launched => Err(Failure::usage(format!(
            "{what}: only `ironbird fly` can inject this, and these processes were started by hand"
        ))
        .help("start the flight with `ironbird fly`, or signal the process yourself")),
        Target::Stage(..) | Target::Processor(_) => Ok(()),
    }
}

/// Refuses a priority that the kernel does not grant this process, the launcher of the flight. That of an injected fault
/// is refused when it begins.
fn check_priority(kind: &FaultKind) -> Result<(), Failure> {
    let priority = match kind.target {
        Target::Processor(of) => of.load(kind.value).0,
        Target::Message(..) | Target::Number(..) | Target::Stage(..) | Target::Channel(..) => 0,
    };
    if priority == 0 {
        return Ok(());
    }
    let refusal = fifo_refusal(i32::try_from(priority).unwrap_or(i32::MAX));
    refusal.map_or(Ok(()), |reason| {
        let errno = i64::from(reason.raw_os_error().unwrap_or_default());
        Err(Failure::failed(format!(
            "cpu.{}={priority}: the kernel refuses SCHED_FIFO {priority} to this process: {reason}",
            kind.spec().name
        ))
        .help(remedy(RealtimeStep::Scheduler, errno)))
    })
}
