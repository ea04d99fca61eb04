//! The airframe's parameters as parameters of the WebSocket protocol, and one that injects faults.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use foxglove::websocket::{
    AnyClient, GetParametersResponder, Parameter, ParameterHandler, ParameterValue,
    SetParametersResponder,
};
use ipc::instance::Instance;
use messages::blackboards::ActiveParameters;
use messages::parameters::{self, SPECS};

use crate::fault::{Desired, RequestedValue};
use crate::inject::{When, ask, injected, words_of};
use errors::Failure;

/// The active parameters as clients see them.
#[derive(Debug)]
pub(super) struct ParameterMirror {
    instance: Instance,
    in_force: Mutex<ActiveParameters>,
    allows_swaps: bool,
}

/// The parameter whose value is a fault to inject, as `state.drop=0.1 for 1s`; its value is what came of the last one.
const INJECT: &str = "inject";

const READ_ONLY: &str =
    "this bridge is read-only: start it with --allow-swaps, or use `ironbird inject`";

impl ParameterMirror {
    pub(super) fn new(instance: Instance, in_force: ActiveParameters, allows_swaps: bool) -> Self {
        Self {
            instance,
            in_force: Mutex::new(in_force),
            allows_swaps,
        }
    }

    /// Takes the active parameters; returns all values if any client's change has taken effect.
    pub(super) fn update(&self, active: ActiveParameters) -> Option<Vec<Parameter>> {
        let mut known = self.in_force();
        if *known == active {
            return None;
        }
        *known = active;
        Some(values(&known, &[]))
    }

    fn in_force(&self) -> MutexGuard<'_, ActiveParameters> {
        // Nobody who holds it can panic.
        self.in_force.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Values by name; of all parameters if no name is given.
fn values(in_force: &ActiveParameters, names: &[String]) -> Vec<Parameter> {
    SPECS
        .iter()
        .zip(in_force.value)
        .filter(|(spec, _)| names.is_empty() || names.iter().any(|name| name == spec.name))
        .map(|(spec, value)| Parameter::float64(spec.name, value))
        .collect()
}

/// Injects the faults in a parameter's text; returns the plant's answer.
fn inject_text(instance: &Instance, wanted: &Parameter) -> Result<String, Failure> {
    let Some(ParameterValue::String(text)) = &wanted.value else {
        return Err(Failure::usage(format!(
            "{INJECT} takes words, as state.drop=0.1 for 1s"
        )));
    };
    let (changes, lasts) = words_of(text).map_err(Failure::usage)?;
    injected(instance, &changes, When::In(Duration::ZERO), lasts)
}

/// The changes that a client requests, as one request: they take effect in the same tick.
fn changes(wanted: &[Parameter]) -> Result<Vec<Desired>, Failure> {
    let mut changes = Vec::new();
    for Parameter { name, value, .. } in wanted {
        let usage = |e: parameters::ParameterError| Failure::usage(e.to_string());
        let parameter = parameters::Parameter::from_name(name).map_err(usage)?;
        let value = match value {
            Some(ParameterValue::Float64(value)) => *value,
            // As a client writes a number without a fraction.
            Some(ParameterValue::Integer(value)) => *value as f64,
            Some(ParameterValue::String(text)) => {
                return Err(Failure::usage(format!("{name} = `{text}` is not a number")));
            }
            Some(_) => return Err(Failure::usage(format!("{name} is not a number"))),
            None => {
                return Err(Failure::usage(format!(
                    "{name} cannot be unset: an airframe has one"
                )));
            }
        };
        changes.push(Desired {
            parameter,
            value: RequestedValue::Number(value),
            over: None,
        });
    }
    Ok(changes)
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
        let mut known = values(&self.in_force(), &names);
        if self.allows_swaps && (names.is_empty() || names.iter().any(|name| name == INJECT)) {
            known.push(Parameter::string(INJECT, ""));
        }
        responder.respond(known);
    }

    fn set(
        &self,
        client: AnyClient,
        wanted: Vec<Parameter>,
        _: Option<String>,
        responder: SetParametersResponder,
    ) {
        let (faults, wanted): (Vec<Parameter>, Vec<Parameter>) = wanted
            .into_iter()
            .partition(|parameter| self.allows_swaps && parameter.name == INJECT);
        let names: Vec<String> = wanted
            .iter()
            .map(|parameter| parameter.name.clone())
            .collect();
        let (instance, mut present, allows_swaps) =
            (self.instance.clone(), *self.in_force(), self.allows_swaps);
        // The plant may take a while, and the client's other messages do not wait for it.
        thread::spawn(move || {
            let mut injected = Vec::new();
            for fault in &faults {
                let answer = inject_text(&instance, fault).unwrap_or_else(|failure| {
                    client.send_error(failure.to_string());
                    String::new()
                });
                injected.push(Parameter::string(INJECT, answer.trim_end()));
            }
            if wanted.is_empty() && !injected.is_empty() {
                return responder.respond(injected);
            }
            let requested = if allows_swaps {
                changes(&wanted)
            } else {
                Err(Failure::usage(READ_ONLY))
            };
            match requested.and_then(|changes| ask(&instance, &changes, When::In(Duration::ZERO))) {
                Ok(applied) => {
                    for change in applied.changes {
                        present.value[change.parameter as usize] = change.new;
                    }
                }
                // The values stay; the client is sent them, and the reason.
                Err(failure) => client.send_error(failure.to_string()),
            }
            let known: Vec<String> = names
                .into_iter()
                .filter(|name| SPECS.iter().any(|s| s.name == name))
                .collect();
            // `values` takes no names as all names.
            let values = if known.is_empty() {
                Vec::new()
            } else {
                values(&present, &known)
            };
            responder.respond([values, injected].concat());
        });
    }
}
