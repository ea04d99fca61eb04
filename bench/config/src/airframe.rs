//! Airframes to choose from: built in, or of a file; each with its rotors and what the controller believes.
//!
//! An airframe file is TOML with the sections `[airframe]`, `[rotor]` and, where the controller is to believe something
//! else, `[model]`. What has no size may be left out: it then has the value of the table. docs/airframes.md has the
//! format; the built-in ones are files of this format.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;

use errors::{Failure, line_of, toml_mistake};
use messages::limits::RotorLimits;
use messages::parameters::{Airframe, Parameter, ParameterError, SPECS};
use serde::Deserialize;
use toml::{Spanned, Table, Value};

use crate::airframe_checks::impossible_body;
use crate::toml_access::{DEFAULT_TABLE, nearest, text_of};
use crate::trajectory::{is_file, sha256_of};
use crate::validation::within;

const BUILT_IN: [(&str, &str); 3] = [
    (PAPER, include_str!("../airframes/paper.toml")),
    ("crazyflie", include_str!("../airframes/crazyflie.toml")),
    ("x500", include_str!("../airframes/x500.toml")),
];

pub const PAPER: &str = "paper";
/// Name of an airframe that the settings describe themselves.
pub const OWN: &str = "own";

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Design {
    pub airframe: Airframe,
    pub rotor: RotorLimits,
    /// Where the controller believes something else.
    pub believed: BTreeMap<String, f64>,
    /// SHA-256 of its file; empty where it is built in.
    pub sha256: String,
}

pub(super) fn design(name: &str) -> Result<Design, Failure> {
    let (text, sha256) = match BUILT_IN.iter().find(|(known, _)| *known == name) {
        Some((_, text)) => ((*text).to_owned(), String::new()),
        None if is_file(name) => {
            let text = text_of(Path::new(name)).map_err(|e| {
                Failure::usage(format!("cannot read the airframe file {name}: {e}"))
                    .help("name a file that you can read; `ironbird docs airframes` has one to begin with")
            })?;
            let sha256 = sha256_of(&text);
            (text, sha256)
        }
        None => {
            let names = BUILT_IN.map(|(name, _)| name.to_owned());
            return Err(Failure::usage(format!(
                "unknown airframe `{name}`{}",
                nearest(name, names.iter())
            ))
            .help(format!(
                "known are {}; a file's name ends in .toml",
                names.join(", ")
            )));
        }
    };
    let design = read(&text).map_err(|mistakes| {
        Failure::usage(format!("airframe file {name}: {}", mistakes.join("; "))).help(
            "`ironbird docs airframes` has the format; `ironbird params` lists names, units and ranges",
        )
    })?;
    Ok(Design { sha256, ..design })
}

/// An airframe file; its numbers with their places in the text.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AirframeFile {
    airframe: Spanned<Numbers>,
    rotor: Rotor,
    #[serde(default)]
    model: Numbers,
}

type Numbers = BTreeMap<String, Spanned<f64>>;

#[derive(Deserialize)]
#[serde(deny_unknown_fields, expecting = "a section: [rotor]")]
struct Rotor {
    min_rad_s: Spanned<f64>,
    max_rad_s: Spanned<f64>,
}

/// Reads the text of an airframe file, or returns the mistakes in it, each with its line: the first one of its form, or
/// all of its numbers.
fn read(text: &str) -> Result<Design, Vec<String>> {
    let file: AirframeFile = toml::from_str(text).map_err(|e| {
        let mut sections = ["airframe", "rotor"].into_iter();
        let missing = sections.find(|name| e.message() == format!("missing field `{name}`"));
        vec![match missing {
            Some(section) => format!("the section [{section}] is missing"),
            None => toml_mistake(text, e.message(), e.span()),
        }]
    })?;
    let mut mistakes = Mistakes::new();
    let airframe = check_airframe(&file.airframe, &mut mistakes);
    let Rotor {
        min_rad_s,
        max_rad_s,
    } = &file.rotor;
    check_rotor(min_rad_s, max_rad_s, &mut mistakes);
    check_model(&file.model, airframe.as_ref(), &mut mistakes);
    let believed = file.model.into_iter();
    let believed = believed.map(|(name, value)| (name, value.into_inner()));
    match airframe.filter(|_| mistakes.is_empty()) {
        Some(airframe) => Ok(Design {
            airframe,
            rotor: RotorLimits {
                min_rad_s: *min_rad_s.as_ref(),
                max_rad_s: *max_rad_s.as_ref(),
            },
            believed: believed.collect(),
            sha256: String::new(),
        }),
        None => {
            mistakes.sort_by_key(|(span, _)| span.start);
            let mistakes = mistakes.into_iter();
            let describe = |(span, mistake): (Range<usize>, String)| {
                format!("line {}: {mistake}", line_of(text, span.start))
            };
            Err(mistakes.map(describe).collect())
        }
    }
}

/// Mistakes and their places in the text.
type Mistakes = Vec<(Range<usize>, String)>;

fn check_airframe(given: &Spanned<Numbers>, mistakes: &mut Mistakes) -> Option<Airframe> {
    let (place, given) = (given.span(), given.as_ref());
    let mut values = *Airframe::nominal().values();
    for (name, value) in given {
        let parameter = Parameter::from_name(name);
        match parameter.and_then(|it| Ok((it, it.widest().check(it, *value.as_ref())?))) {
            Ok((parameter, value)) => values[parameter as usize] = value,
            Err(error) => mistakes.push((value.span(), format!("airframe: {error}"))),
        }
    }
    let is_needed = |parameter: Parameter| parameter.has_size() || parameter == Parameter::Gravity;
    let needed = SPECS.iter().filter(|spec| is_needed(spec.parameter));
    let mut missing: Vec<&str> = needed.map(|spec| spec.name).collect();
    missing.retain(|name| !given.contains_key(*name));
    if !missing.is_empty() {
        let mistake = format!("missing in [airframe]: {}", missing.join(", "));
        mistakes.push((place, mistake));
    }
    let is_right = mistakes.is_empty();
    let airframe = Airframe::built_with(values).ok().filter(|_| is_right)?;
    if let Some(why) = impossible_body(&airframe) {
        mistakes.push((given["inertia_x_kg_m2"].span(), format!("airframe: {why}")));
    }
    Some(airframe)
}

fn check_rotor(min: &Spanned<f64>, max: &Spanned<f64>, mistakes: &mut Mistakes) {
    for (key, value) in [("rotor.min_rad_s", min), ("rotor.max_rad_s", max)] {
        if let Err(error) = within(key, *value.as_ref(), 0.0, 1e5) {
            mistakes.push((value.span(), error.to_string()));
        }
    }
    if min.as_ref() > max.as_ref() {
        let [min_rad_s, max_rad_s] = [min, max].map(Spanned::as_ref);
        let mistake = format!(
            "rotor.min_rad_s = {min_rad_s} must not be above rotor.max_rad_s = {max_rad_s}"
        );
        mistakes.push((min.span(), mistake));
    }
}

fn check_model(given: &Numbers, airframe: Option<&Airframe>, mistakes: &mut Mistakes) {
    for (name, value) in given {
        let known = || {
            DEFAULT_TABLE["model"]
                .as_table()
                .into_iter()
                .flat_map(Table::keys)
        };
        if !known().any(|known| known == name) {
            let like = nearest(name, known());
            mistakes.push((value.span(), format!("unknown key `model.{name}`{like}")));
        }
        if let (Some(airframe), Ok(parameter)) = (airframe, Parameter::from_name(name))
            && let Err(error) = airframe.check(parameter, *value.as_ref())
        {
            mistakes.push((value.span(), format!("model: {error}")));
        }
    }
}

impl Design {
    /// Puts it into the settings: what it was built with, how it is at tick 0, what is believed of it, its rotors.
    pub(super) fn lay(&self, settings: &mut Table) {
        let built = self.airframe.as_built();
        let airframe = SPECS.iter().map(|spec| {
            (
                spec.name.to_owned(),
                Value::Float(built.get(spec.parameter)),
            )
        });
        settings.insert("airframe".into(), Value::Table(airframe.collect()));
        for (section, keys) in settings.iter_mut() {
            let Value::Table(keys) = keys else { continue };
            let mut set = |key: &str, value| keys.insert(key.into(), Value::Float(value));
            match section.as_str() {
                "rotor" => {
                    set("min_rad_s", self.rotor.min_rad_s);
                    set("max_rad_s", self.rotor.max_rad_s);
                }
                "flight" => {
                    let sum = Value::String(self.sha256.clone());
                    keys.insert("airframe_sha256".into(), sum);
                }
                "plant" | "model" => {
                    for (name, value) in keys.iter_mut() {
                        let Some(spec) = SPECS.iter().find(|spec| spec.name == name) else {
                            continue;
                        };
                        let believed = self.believed.get(name).filter(|_| section == "model");
                        let built = self.airframe.get(spec.parameter);
                        *value = Value::Float(believed.copied().unwrap_or(built));
                    }
                }
                _ => {}
            }
        }
    }
}

pub fn built(values: &BTreeMap<String, f64>) -> Result<Airframe, ParameterError> {
    let mut array = *Airframe::nominal().values();
    for (name, value) in values {
        array[Parameter::from_name(name)? as usize] = *value;
    }
    Airframe::built_with(array)
}

/// The airframe of a name or file, as it was built.
pub fn named(name: &str) -> Result<Airframe, Failure> {
    Ok(design(name)?.airframe)
}

/// The section `[airframe]` of the paper's airframe.
pub(super) fn paper() -> BTreeMap<String, f64> {
    let nominal = SPECS
        .iter()
        .map(|spec| (spec.name.to_owned(), spec.nominal));
    nominal.collect()
}

/// The section `[airframe]` as text, for the commented settings.
pub(super) fn commented(values: &BTreeMap<String, f64>) -> String {
    let about =
        "What the airframe was built with: its ranges follow from it (`ironbird docs airframes`).";
    let mut text = format!("\n# {about}\n[airframe]\n");
    for spec in &SPECS {
        let value = values.get(spec.name).copied().unwrap_or(spec.nominal);
        text += &format!("{} = {}\n", spec.name, Value::from(value));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_built_in_airframe_hovers_on_less_than_its_rotors_give() {
        for (name, _) in BUILT_IN {
            let Design {
                airframe, rotor, ..
            } = design(name).unwrap();
            let hover = airframe.hover_speed_rad_s();
            let hovers = rotor.min_rad_s < 0.2 * hover && 1.1 * hover < rotor.max_rad_s;
            assert!(hovers, "{name}: {hover}");
        }
    }

    #[test]
    fn all_wrong_numbers_of_a_file_are_reported_at_once_with_their_lines() {
        let paper = BUILT_IN[0].1;
        let believes = |what: &str| format!("{paper}\n[model]\n{what}\n");
        let rotor = "[rotor]\nmin_rad_s = 3\nmax_rad_s = 400\n";
        let wrong = "[airframe]\nmas_kg = 1\ngravity_m_s2 = nan\narm_length_m = 1\nmotor_time_constant_s = 9\n\
                     [rotor]\nmin_rad_s = -3\nmax_rad_s = -4\n[model]\nrotor_inertia_kg_m2 = 1\n";
        for (text, expected) in [
            (
                wrong,
                "line 1: missing in [airframe]: mass_kg, translational_drag_kg_s, rotational_drag_nm_s, thrust_coefficient_n_s2,
                 line 2: airframe: unknown parameter `mas_kg`; did you mean `mass_kg`?
                 line 3: airframe: gravity_m_s2 = NaN is out of range: allowed are 0.0 to 30.0 m/s^2
                 line 5: airframe: motor_time_constant_s = 9 is out of range
                 line 7: rotor.min_rad_s = -3 is out of range: allowed are 0
                 line 7: rotor.min_rad_s = -3 must not be above rotor.max_rad_s = -4
                 line 8: rotor.max_rad_s = -4 is out of range
                 line 10: unknown key `model.rotor_inertia_kg_m2`",
            ),
            ("[airframe\n", "line 1, `[airframe`: "),
            (&believes("mass_kg = \"light\""), "line 25, `mass_kg = \"light\"`: invalid type: string \"light\", expected a number"),
            (&believes("mass_kg = 50"), "line 25: model: mass_kg = 50 is out of range"),
            (&format!("{paper}[modle]\n"), "line 23, `[modle]`: unknown key `modle`, expected one of"),
            (&format!("airframe = 3\n{rotor}"), "line 1, `airframe = 3`: invalid type: integer `3`, expected a section"),
            ("rotor = 3\n[airframe]\n", "line 1, `rotor = 3`: invalid type: integer `3`, expected a section: [rotor]"),
            (&format!("{rotor}idle = 4\n[airframe]\n"), "line 4, `idle = 4`: unknown key `idle`, expected `min_rad_s` or `max_rad_s`"),
            ("[airframe]\n[rotor]\nmin_rad_s = 3\n", "line 2, `[rotor]`: missing key `max_rad_s`"),
            (rotor, "the section [airframe] is missing"),
        ] {
            let mistakes = read(text).unwrap_err();
            let expected: Vec<&str> = expected.lines().map(str::trim_start).collect();
            assert_eq!(mistakes.len(), expected.len(), "{mistakes:?}");
            for (mistake, expected) in mistakes.iter().zip(expected) {
                assert!(mistake.starts_with(expected), "{mistake}: {expected}");
            }
        }
    }
}
