//! Every name that a fault can have, other than those of parameters.

use model::fault::PORTS;
use model::parameters::{did_you_mean, nearest};
use model::role::{Role, STAGES};

use crate::fault::FaultError;

/// What can be wrong with whole messages.
pub const OF_MESSAGES: [&str; 4] = ["drop", "delay", "lag", "freeze"];
/// What can be wrong with a number.
pub const OF_NUMBERS: [&str; 3] = ["noise", "bias", "nan"];
/// What can be wrong with a stage.
pub const OF_STAGES: [&str; 3] = ["late", "stop", "kill"];

/// What can be wrong with the loops' processor.
pub const OF_PROCESSOR: [&str; 2] = ["cpu.hog", "cpu.load"];

/// All names, those of single numbers left out.
pub(super) fn known() -> Vec<String> {
    let mut known: Vec<String> = Vec::new();
    for port in PORTS {
        for input in [port.topic().to_owned(), port.to_string()] {
            known.extend(OF_MESSAGES.iter().map(|word| format!("{input}.{word}")));
            let fields = port.fields().iter().flat_map(|field| OF_NUMBERS.map(|word| (field.name, word)));
            known.extend(fields.map(|(field, word)| format!("{input}.{field}.{word}")));
        }
    }
    let stages = STAGES.into_iter().flat_map(|role| OF_STAGES.map(|word| (role, word)));
    let possible = stages.filter(|(role, word)| is_possible(*role, word));
    known.extend(possible.map(|(role, word)| format!("{role}.{word}")));
    known.extend(OF_PROCESSOR.map(str::to_owned));
    known
}

/// A flight ends with its plant.
fn is_possible(role: Role, word: &str) -> bool {
    (role, word) != (Role::Plant, "kill")
}

/// The error about a name that is not known.
pub(super) fn unknown(name: &str) -> FaultError {
    let known = known();
    let like = || did_you_mean(nearest(name, known.iter().map(String::as_str)));
    FaultError::Unknown { name: name.to_owned(), hint: amiss(name).unwrap_or_else(like) }
}

/// What is amiss with a name of which each part is a word of its own.
fn amiss(name: &str) -> Option<String> {
    if let Some(word) = name.strip_prefix("record.").filter(|word| OF_STAGES.contains(word)) {
        let stages: Vec<String> =
            STAGES.into_iter().filter(|role| is_possible(*role, word)).map(|role| role.to_string()).collect();
        return Some(format!(": the recorder is no stage; `STAGE.{word}` is for {}", stages.join(", ")));
    }
    let (rest, word) = name.rsplit_once('.').filter(|(_, word)| OF_NUMBERS.contains(word))?;
    let inputs = PORTS.into_iter().flat_map(|port| [(port, port.topic().to_owned()), (port, port.to_string())]);
    inputs.into_iter().find_map(|(port, input)| {
        let field = port.fields().first()?.name;
        if rest == input {
            return Some(format!(": it is a fault of a number: name which, as in `{input}.{field}.{word}`"));
        }
        let (field, _axis) = rest.strip_prefix(&input)?.strip_prefix('.')?.split_once('.')?;
        let axes = port.fields().iter().find(|known| known.name == field)?.axes;
        Some(match axes {
            [] => format!(": `{field}` is one number, without axes"),
            axes => format!(": the axes of `{field}` are {}", axes.join(", ")),
        })
    })
}
