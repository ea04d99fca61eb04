//! Units and frames of the fields, derived from their names.

use std::collections::BTreeMap;

use messages::header::Header;
use messages::layout::{Field, Kind, Layout as _};
use messages::parameters::{PARAMETERS, SPECS};

use crate::codec::{Logged, is_telemetry};

const UNITS: [(&str, &str); 16] = [
    ("_rad2_s2", "rad^2/s^2"),
    ("_rad_s2", "rad/s^2"),
    ("_rad_s", "rad/s"),
    ("_rad", "rad"),
    ("_m_s4", "m/s^4"),
    ("_m_s3", "m/s^3"),
    ("_m_s2", "m/s^2"),
    ("_m_s", "m/s"),
    ("_nm_s", "N m s"),
    ("_kg_m2", "kg m^2"),
    ("_ns", "ns of CLOCK_MONOTONIC"),
    ("_nm", "N m"),
    ("_kg", "kg"),
    ("_m", "m"),
    ("_n", "N"),
    ("tick", "tick; 18446744073709551615 is none"),
];

/// Where the unit stands if no name says it.
const ELSEWHERE: &str = "docs/conventions.md";

const FRAMES: [(&str, &str); 4] = [
    ("_w_", "world: right-handed, z up"),
    ("_b_", "body: x forward, y left, z up"),
    (
        "attitude_quaternion",
        "body to world: unit quaternion w, x, y, z",
    ),
    (
        "attitude_",
        "body to world: ZYX Euler angles roll, pitch, yaw",
    ),
];

/// `unit.FIELD` and `frame.FIELD` of all numbers of a topic's messages; fields without a frame have none.
pub fn describe<C: Logged>() -> BTreeMap<String, String> {
    let mut facts = BTreeMap::new();
    describe_fields("envelope.", Header::FIELDS, &mut facts);
    describe_fields("", C::FIELDS, &mut facts);
    facts
}

/// What the metadata of a topic say that does not apply to a flight.
pub fn not_applicable(why: &str) -> (String, String) {
    ("not_applicable".into(), why.into())
}

fn describe_fields(path: &str, fields: &[Field], facts: &mut BTreeMap<String, String>) {
    for field in fields.iter().filter(|field| !is_telemetry(field)) {
        let name = format!("{path}{}", field.name);
        if let Kind::Struct { fields, .. } = field.kind {
            describe_fields(&format!("{name}."), fields, facts);
            continue;
        }
        if let Some((_, frame)) = FRAMES.iter().find(|(part, _)| field.name.contains(part)) {
            facts.insert(format!("frame.{name}"), (*frame).into());
        }
        facts.insert(format!("unit.{name}"), unit(field));
    }
}

/// The unit of a field's numbers as tables have it: empty for a ratio, a count or a flag, and where no name says it.
pub fn of(field: &Field) -> String {
    let unit = unit(field);
    // Tables have no number where a log says which tick is none.
    match unit.split(';').next().unwrap_or_default() {
        "1" | ELSEWHERE => String::new(),
        unit => unit.to_owned(),
    }
}

/// The unit at the end of a field's name.
pub fn of_name(name: &str) -> Option<&'static str> {
    let unit = UNITS.iter().find(|(end, _)| name.ends_with(end));
    unit.map(|(_, unit)| *unit)
}

/// The unit of a field; 1 for counts, flags and fingerprints, and where to look where no name says it.
fn unit(field: &Field) -> String {
    if field.kind == Kind::F64 && field.length == Some(PARAMETERS) {
        let unit = |spec: &messages::parameters::Spec| format!("{} [{}]", spec.name, spec.unit);
        let units = SPECS.iter().map(unit).collect::<Vec<_>>().join(", ");
        return match field.name {
            // In the order of the table.
            "parameter" => units,
            _ => format!("that of the parameter at the same place; {units}"),
        };
    }
    match field.name {
        "attitude_quaternion" => "1".into(),
        "parameter" => "row of the table of parameters, from 0".into(),
        name => {
            let other = if field.kind == Kind::F64 {
                ELSEWHERE
            } else {
                "1"
            };
            of_name(name).unwrap_or(other).into()
        }
    }
}
