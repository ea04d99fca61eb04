//! The faults of the settings: what they are in ticks, and whether the flight is long enough for them.

use model::fault::Span;

use crate::fault::plan::Planned;
use crate::fault::{Fault, FaultError};
use crate::settings::{Settings, airframe};
use failure::Failure;
use report::injected::InjectedFault;

impl Settings {
    /// What is planned to go wrong.
    ///
    /// # Errors
    /// A usage [`Failure`] says what is wrong with the first fault that cannot be.
    pub fn planned(&self) -> Result<Planned, Failure> {
        let airframe = self.airframe()?;
        let faults = self.typed_faults();
        let planned =
            faults.and_then(|faults| Planned::new(&faults, self.flight.period_s, &airframe, self.flight.seed));
        planned.map_err(|e| {
            let flags = match self.flight.airframe.as_str() {
                airframe::PAPER => String::new(),
                other => format!(" --airframe {other}"),
            };
            Failure::usage(format!("fault: {e} ({})", e.listed(&flags)))
        })
    }

    /// The faults as they were typed.
    ///
    /// # Errors
    /// [`FaultError`] of the first that cannot be read.
    pub fn typed_faults(&self) -> Result<Vec<Fault>, FaultError> {
        self.flight.faults.iter().map(|text| text.parse()).collect()
    }

    /// The faults of messages and stages, for the report.
    ///
    /// # Errors
    /// A usage [`Failure`], which settings that were resolved have ruled out.
    pub fn injected(&self) -> Result<Vec<InjectedFault>, Failure> {
        let period_s = self.flight.period_s;
        let refused = |e: FaultError| Failure::usage(format!("fault: {e}"));
        let mut injected = Vec::new();
        for fault in self.typed_faults().map_err(refused)? {
            let Span { from, to } = fault.span(period_s).map_err(refused)?;
            let what: Vec<String> = fault.of_the_loop().map(|change| change.to_string()).collect();
            if !what.is_empty() {
                let to = (to != Span::FOR_GOOD).then_some(to);
                injected.push(InjectedFault::new(what.join(","), from, to, period_s));
            }
        }
        Ok(injected)
    }

    pub(super) fn check_faults(&self) -> Result<(), Failure> {
        let planned = self.planned()?;
        if planned.swaps.len() > plant::swap::PENDING_SWAPS {
            return Err(Failure::usage(format!(
                "flight.faults has {} swaps: allowed are {}",
                planned.swaps.len(),
                plant::swap::PENDING_SWAPS
            ))
            .help("put values that change at the same instant into one fault: NAME=VALUE,NAME=VALUE@8s"));
        }
        let last_tick = self.last_tick();
        for fault in self.typed_faults().map_err(|e| Failure::usage(format!("fault: {e}")))? {
            let Span { from, to } =
                fault.span(self.flight.period_s).map_err(|e| Failure::usage(format!("fault: {e}")))?;
            if from > last_tick {
                return Err(Failure::usage(format!(
                    "a fault at tick {from} never strikes: the flight ends at tick {last_tick}"
                ))
                .help("fly longer (--duration), or strike earlier"));
            }
            if to != Span::FOR_GOOD && to > last_tick + 1 {
                return Err(Failure::usage(format!(
                    "the fault {fault} ends at tick {to}, after the flight: that ends at tick {last_tick}"
                ))
                .help("leave its end out, as it then holds for good, or fly longer (--duration)"));
            }
        }
        Ok(())
    }

    /// Refuses what processes cannot be made to do.
    ///
    /// # Errors
    /// A usage [`Failure`] names the stage.
    pub fn check_faults_of_processes(&self) -> Result<(), Failure> {
        let planned = self.planned()?;
        let Some(stage) = planned.stages.first() else { return Ok(()) };
        Err(Failure::usage(format!(
            "a fault of the stage {}, from tick {}: processes are not made late, stopped or killed by plan",
            stage.role, stage.span.from
        ))
        .help("`ironbird simulate` flies it; messages of a stage can be lost or late in both, as in setpoint.drop=1"))
    }
}
