//! Every name that a fault can have, other than those of parameters.

use model::fault::PORTS;
use model::parameters::nearest;
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
    let possible = stages.filter(|stage| *stage != (Role::Plant, "kill"));
    known.extend(possible.map(|(role, word)| format!("{role}.{word}")));
    known.extend(OF_PROCESSOR.map(str::to_owned));
    known
}

/// The error about a name that is not known.
pub(super) fn unknown(name: &str) -> FaultError {
    let known = known();
    let nearest = nearest(name, known.iter().map(String::as_str)).map(str::to_owned);
    FaultError::Unknown { name: name.to_owned(), nearest }
}
