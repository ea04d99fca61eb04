//! The airframe's parameters as parameters of the WebSocket protocol, and one that injects faults.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;

use foxglove::websocket::{
    AnyClient, GetParametersResponder, Parameter, ParameterHandler, ParameterValue,
    SetParametersResponder,
};
use ipc::instance::Instance;
use messages::blackboards::ActiveParameters;
use messages::parameters::{self, SPECS};

use crate::inject::{When, ask, inject_line};
use errors::Failure;
use faults::grammar::{Desired, RequestedValue};

/// The active parameters as clients see them.
#[derive(Debug)]
pub(super) struct ParameterMirror {
    pub(super) instance: Instance,
    /// None before the first flight.
    pub(super) active: Mutex<Option<ActiveParameters>>,
    pub(super) allows_swaps: bool,
}

/// The parameter whose value is a fault to inject, as `state.drop=0.1 for 1s`; its answer is the plant's.
const INJECT: &str = "inject";
const READ_ONLY: &str =
    "this bridge is read-only: start it with --allow-swaps, or use `ironbird inject`";

impl ParameterMirror {
    /// Takes the active parameters; returns all values if any has changed.
    pub(super) fn update(&self, active: ActiveParameters) -> Option<Vec<Parameter>> {
        let mut known = self.active();
        let has_changed = known.replace(active) != Some(active);
        has_changed.then(|| values(known.as_ref(), |_| true))
    }

    fn active(&self) -> MutexGuard<'_, Option<ActiveParameters>> {
        self.active.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn values(active: Option<&ActiveParameters>, is_named: impl Fn(&str) -> bool) -> Vec<Parameter> {
    let all = active
        .into_iter()
        .flat_map(|active| SPECS.iter().zip(active.value));
    all.filter(|(spec, _)| is_named(spec.name))
        .map(|(spec, value)| Parameter::float64(spec.name, value))
        .collect()
}

/// Injects the faults in a parameter's text; returns the plant's answer.
fn inject_text(instance: &Instance, requested: &Parameter) -> Result<String, Failure> {
    let Some(ParameterValue::String(text)) = &requested.value else {
        let what = format!("{INJECT} takes a text, as state.drop=0.1 for 1s");
        return Err(Failure::usage(what));
    };
    inject_line(instance, text)
}

/// A change that a client requests.
fn change(Parameter { name, value, .. }: &Parameter) -> Result<Desired, Failure> {
    let parameter = parameters::Parameter::from_name(name);
    let parameter = parameter.map_err(|e| Failure::usage(e.to_string()))?;
    let value = match value {
        Some(ParameterValue::Float64(value)) => Ok(*value),
        // As a client writes a number without a fraction.
        Some(ParameterValue::Integer(value)) => Ok(*value as f64),
        Some(ParameterValue::String(text)) => Err(format!("{name} = `{text}` is not a number")),
        Some(_) => Err(format!("{name} is not a number")),
        None => Err(format!("{name} cannot be unset: an airframe has one")),
    };
    Ok(Desired {
        parameter,
        value: RequestedValue::Number(value.map_err(Failure::usage)?),
        over: None,
    })
}

impl ParameterHandler for ParameterMirror {
    fn get(
        &self,
        client: AnyClient,
        names: Vec<String>,
        _: Option<String>,
        responder: GetParametersResponder,
    ) {
        for name in &names {
            if let Err(unknown) = parameters::Parameter::from_name(name)
                && !(self.allows_swaps && name == INJECT)
            {
                client.send_warning(unknown.to_string());
            }
        }
        // No names stand for all names.
        let is_named = |name: &str| names.is_empty() || names.iter().any(|it| it == name);
        let mut known = values(self.active().as_ref(), is_named);
        if self.allows_swaps && is_named(INJECT) {
            known.push(Parameter::string(INJECT, ""));
        }
        responder.respond(known);
    }

    fn set(
        &self,
        client: AnyClient,
        requested: Vec<Parameter>,
        _: Option<String>,
        responder: SetParametersResponder,
    ) {
        let (instance, allows_swaps) = (self.instance.clone(), self.allows_swaps);
        let mut active = *self.active();
        // The plant may take a while, and the client's other messages do not wait for it.
        thread::spawn(move || {
            let is_fault = |parameter: &Parameter| allows_swaps && parameter.name == INJECT;
            let (faults, swaps): (Vec<Parameter>, Vec<Parameter>) =
                requested.into_iter().partition(is_fault);
            let mut answers = Vec::new();
            for fault in &faults {
                let answer = inject_text(&instance, fault).unwrap_or_else(|failure| {
                    client.send_error(failure.to_string());
                    String::new()
                });
                answers.push(Parameter::string(INJECT, answer.trim_end()));
            }
            if swaps.is_empty() && !answers.is_empty() {
                return responder.respond(answers);
            }
            let changes = match allows_swaps {
                true => swaps.iter().map(change).collect::<Result<Vec<_>, _>>(),
                false => Err(Failure::usage(READ_ONLY)),
            };
            // As one request, so that they take effect in the same tick.
            match changes.and_then(|changes| ask(&instance, &changes, When::NOW)) {
                Ok(applied) => {
                    for change in applied.changes {
                        if let Some(active) = &mut active {
                            active.value[change.parameter as usize] = change.new;
                        }
                    }
                }
                // The values stay; the client is sent them, and the reason.
                Err(failure) => client.send_error(failure.to_string()),
            }
            let is_named = |name: &str| swaps.iter().any(|swap| swap.name == name);
            responder.respond([values(active.as_ref(), is_named), answers].concat());
        });
    }
}
