//! `ironbird.simulate`: a flight in one process, with laws of the rig or of Python.

use std::sync::Arc;

use config::Settings;
use control_api::law::{InnerLaw, OuterLaw};
use control_api::registry::Made;
use control_api::{GuardedInner, GuardedOuter};
use errors::Failure;
use messages::blackboards::EndReason;
use messages::role::Role;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use python_law::{Flying, PythonLaw, Raised};
use sim::simulate::fly;
use sim::simulator::Simulator;

use crate::errors::settings_error;
use crate::flight::{FlownLaw, Shown, Tables, facts};
use crate::py_laws::PyLaw;
use crate::settings::{overrides, table};

/// Ticks between two looks at whether Ctrl-C was pressed.
const LOOK_TICKS: u64 = 1024;

/// Flies what settings describe, and arguments before them, by the keys of their settings; `outer` and `inner` are laws
/// in Python, or None for those of the settings.
#[pyfunction]
#[pyo3(signature = (settings, arguments, outer=None, inner=None))]
pub(crate) fn simulate<'py>(
    py: Python<'py>,
    settings: &Bound<'py, PyDict>,
    arguments: &Bound<'py, PyDict>,
    outer: Option<&Bound<'py, PyAny>>,
    inner: Option<&Bound<'py, PyAny>>,
) -> PyResult<Shown<'py>> {
    let outer = PyLaw::of(Role::Outer, settings, arguments, outer)?;
    let inner = PyLaw::of(Role::Inner, settings, arguments, inner)?;
    let settings =
        Settings::of(table(settings, "")?, &overrides(arguments)?).map_err(settings_error)?;
    let laws = laws(&settings, outer.as_ref(), inner.as_ref()).map_err(settings_error)?;
    let rig = settings.rig().map_err(settings_error)?;
    let made = |law: &Option<PyLaw<'py>>| law.as_ref().map(|law| law.law(rig)).transpose();
    let raised = Raised::default();
    let mut flight =
        flight(&settings, made(&outer)?, made(&inner)?, &raised).map_err(settings_error)?;
    let mut tables = Tables::of(&settings, &laws).map_err(settings_error)?;
    tables.reserve(settings.last_tick() + 1)?;
    let flown = py.detach(|| {
        fly(&mut flight, &settings, |rig| {
            if rig.has_state() {
                tables.take(rig);
            }
            if rig.flown_tick().is_multiple_of(LOOK_TICKS) {
                Python::attach(|py| py.check_signals())
                    .unwrap_or_else(|signal| raised.keep(signal));
            }
            match raised.is_there() {
                true => Err(Failure::failed("an exception")),
                false => Ok(()),
            }
        })
    });
    if let Some(raised) = raised.take() {
        return Err(raised);
    }
    let flown = flown.map_err(settings_error)?;
    let text = settings.commented().map_err(settings_error)?;
    let facts = facts(py, &settings, &text, &laws, &flown.swaps)?;
    facts.set_item(
        "end",
        flown
            .departure
            .as_deref()
            .unwrap_or(EndReason::Completed.name()),
    )?;
    facts.set_item("fingerprint", flown.outputs.to_string())?;
    let handed = PyDict::new(py);
    for (role, law) in [("outer", outer), ("inner", inner)] {
        law.map_or(Ok(()), |law| handed.set_item(role, law.section))?;
    }
    facts.set_item("handed", handed)?;
    tables.shown(py, Vec::new(), facts)
}

fn laws(
    settings: &Settings,
    outer: Option<&PyLaw>,
    inner: Option<&PyLaw>,
) -> Result<[FlownLaw; 3], Failure> {
    let [of_outer, of_inner, mixer] = settings.laws()?.map(FlownLaw::from);
    Ok([
        outer.map_or(of_outer, FlownLaw::from),
        inner.map_or(of_inner, FlownLaw::from),
        mixer,
    ])
}

/// The flight that settings describe, with the laws of Python in place of theirs.
fn flight(
    settings: &Settings,
    outer: Option<Arc<PythonLaw>>,
    inner: Option<Arc<PythonLaw>>,
    raised: &Raised,
) -> Result<Simulator, Failure> {
    let rig = settings.rig()?;
    let theorem = match inner {
        None => settings.theorem()?,
        Some(_) => None,
    };
    if outer.is_none() && inner.is_none() {
        return Ok(Simulator::of(settings)?.with_monitor(theorem));
    }
    let outer = match outer {
        None => settings.outer_stage()?,
        Some(law) => {
            let signals = law.signals;
            let made = Made::<dyn OuterLaw>::of(Flying(law, raised.clone()), signals);
            GuardedOuter::new(made, settings.course()?.route(rig.period_s), &rig)
        }
    };
    let inner = match inner {
        None => settings.inner_stage()?,
        Some(law) => {
            let signals = law.signals;
            let made = Made::<dyn InnerLaw>::of(Flying(law, raised.clone()), signals);
            GuardedInner::new(made, &rig)
        }
    };
    Ok(Simulator::with(settings, outer, inner)?.with_monitor(theorem))
}
