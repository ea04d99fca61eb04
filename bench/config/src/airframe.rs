//! Airframes to choose from: built in, or of a file; each with its rotors and what the controller believes.
//!
//! An airframe file is TOML with the sections `[airframe]`, `[rotor]` and, where the controller is to believe something
//! else, `[model]`. What has no size may be left out: it then has the value of the table. docs/airframes.md has the
//! format; the built-in ones are files of this format.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;

use errors::{Failure, of_toml};
use messages::limits::RotorLimits;
use messages::parameters::{Airframe, Parameter, ParameterError, SPECS, shown};
use toml::de::DeTable;
use toml::{Table, Value};

use crate::airframe_checks::impossible_body;
use crate::toml_access::{DEFAULT_TABLE, nearest, table, text_of};
use crate::trajectory::{is_file, sha256_of};

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

/// The mistakes of a file, each with its line; those of the whole file have the last one.
struct Mistakes<'a> {
    text: &'a str,
    found: Vec<(usize, String)>,
}

/// The numbers of a section by key, each with its line; `None` for a value that is no number, a mistake of its own.
type Numbers = BTreeMap<String, (Option<f64>, usize)>;

const SECTIONS: [&str; 3] = ["airframe", "rotor", "model"];

/// Reads the text of an airframe file, or returns every mistake in it.
fn read(text: &str) -> Result<Design, Vec<String>> {
    let unread = |e: toml::de::Error| {
        let line = e.span().map_or(1, |span| line_of(text, &span));
        let what = of_toml(e.message()).replace('\n', ", ");
        vec![format!("line {line}: {what}")]
    };
    let values: Table = text.parse().map_err(unread)?;
    let spans = DeTable::parse(text).map_err(unread)?;
    let mut mistakes = Mistakes {
        text,
        found: Vec::new(),
    };
    let mut sections = SECTIONS.map(|_| Numbers::new());
    for (key, item) in spans.get_ref() {
        let (name, line) = (&**key.get_ref(), line_of(text, &key.span()));
        let place = SECTIONS.iter().position(|known| *known == name);
        match (place, item.get_ref().as_table().zip(table(&values, name))) {
            (Some(place), Some((spans, values))) => {
                sections[place] = mistakes.numbers(name, spans, values);
            }
            (Some(_), None) => {
                let mistake = format!("`{name}` must be a section: [{name}]");
                mistakes.found.push((line, mistake));
            }
            (None, _) => {
                let known = "the sections are [airframe], [rotor], [model]";
                let mistake = format!("unknown `{name}`: {known}");
                mistakes.found.push((line, mistake));
            }
        }
    }
    let [airframe, rotor, model] = &sections;
    let airframe = mistakes.airframe(airframe);
    let rotor = mistakes.rotor(rotor);
    let believed = mistakes.believed(model, airframe.as_ref());
    match airframe.filter(|_| mistakes.found.is_empty()) {
        Some(airframe) => Ok(Design {
            airframe,
            rotor,
            believed,
            sha256: String::new(),
        }),
        None => Err(mistakes.describe()),
    }
}

impl Mistakes<'_> {
    fn add_missing<'a>(
        &mut self,
        section: &str,
        given: &Numbers,
        needed: impl Iterator<Item = &'a str>,
    ) {
        let missing: Vec<&str> = needed.filter(|key| !given.contains_key(*key)).collect();
        if !missing.is_empty() {
            let mistake = format!("missing in [{section}]: {}", missing.join(", "));
            self.found.push((usize::MAX, mistake));
        }
    }

    fn describe(mut self) -> Vec<String> {
        self.found.sort_by_key(|(line, _)| *line);
        let describe = |(line, mistake)| match line {
            usize::MAX => mistake,
            line => format!("line {line}: {mistake}"),
        };
        self.found.into_iter().map(describe).collect()
    }

    fn numbers(&mut self, section: &str, spans: &DeTable<'_>, values: &Table) -> Numbers {
        let mut numbers = Numbers::new();
        for (key, item) in spans {
            let (key, line) = (&**key.get_ref(), line_of(self.text, &item.span()));
            let value = values.get(key);
            let whole = || value?.as_integer().map(|whole| whole as f64);
            let number = value.and_then(Value::as_float).or_else(whole);
            if number.is_none() {
                let found = value.map(Value::to_string).unwrap_or_default();
                let mistake = format!("{section}.{key} = {found}: expected a number");
                self.found.push((line, mistake));
            }
            numbers.insert(key.to_owned(), (number, line));
        }
        numbers
    }

    fn airframe(&mut self, given: &Numbers) -> Option<Airframe> {
        let before = self.found.len();
        let mut values = *Airframe::nominal().values();
        for (name, &(value, line)) in given {
            let checked = Parameter::from_name(name).and_then(|parameter| match value {
                Some(value) => Ok((parameter, parameter.widest().check(parameter, value)?)),
                None => Ok((parameter, f64::NAN)),
            });
            match checked {
                Ok((parameter, value)) => values[parameter as usize] = value,
                Err(error) => self.found.push((line, format!("airframe: {error}"))),
            }
        }
        let needed = SPECS
            .iter()
            .filter(|spec| spec.parameter.has_size() || spec.parameter == Parameter::Gravity);
        self.add_missing("airframe", given, needed.map(|spec| spec.name));
        let is_right = self.found.len() == before;
        let airframe = Airframe::built_with(values).ok().filter(|_| is_right)?;
        if let Some(why) = impossible_body(&airframe) {
            let line = given.get("inertia_x_kg_m2").map_or(1, |(_, line)| *line);
            self.found.push((line, format!("airframe: {why}")));
        }
        Some(airframe)
    }

    fn rotor(&mut self, given: &Numbers) -> RotorLimits {
        const KEYS: [&str; 2] = ["min_rad_s", "max_rad_s"];
        for (key, &(value, line)) in given {
            if !KEYS.contains(&key.as_str()) {
                let mistake =
                    format!("unknown key `rotor.{key}`: the keys are min_rad_s, max_rad_s");
                self.found.push((line, mistake));
            } else if let Some(value) = value.filter(|value| !(0.0..=1e5).contains(value)) {
                let mistake = format!(
                    "rotor.{key} = {} is out of range: allowed are 0 to 100000 rad/s",
                    shown(value)
                );
                self.found.push((line, mistake));
            }
        }
        self.add_missing("rotor", given, KEYS.into_iter());
        let [(min, line), (max, _)] = KEYS.map(|key| given.get(key).copied().unwrap_or_default());
        if let (Some(min), Some(max)) = (min, max)
            && min > max
        {
            let mistake =
                format!("rotor.min_rad_s = {min} must not be above rotor.max_rad_s = {max}");
            self.found.push((line, mistake));
        }
        RotorLimits {
            min_rad_s: min.unwrap_or_default(),
            max_rad_s: max.unwrap_or_default(),
        }
    }

    fn believed(&mut self, given: &Numbers, airframe: Option<&Airframe>) -> BTreeMap<String, f64> {
        let model = table(&DEFAULT_TABLE, "model")
            .into_iter()
            .flat_map(Table::keys);
        let model: Vec<&String> = model.collect();
        let mut believed = BTreeMap::new();
        for (name, &(value, line)) in given {
            if !model.contains(&name) {
                let like = nearest(name, model.iter().copied());
                self.found
                    .push((line, format!("unknown key `model.{name}`{like}")));
            }
            let Some(value) = value else { continue };
            if let (Some(airframe), Ok(parameter)) = (airframe, Parameter::from_name(name))
                && let Err(error) = airframe.check(parameter, value)
            {
                self.found.push((line, format!("model: {error}")));
            }
            believed.insert(name.clone(), value);
        }
        believed
    }
}

/// The line of a place in a text, from 1.
pub(super) fn line_of(text: &str, span: &Range<usize>) -> usize {
    1 + text[..span.start].matches('\n').count()
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
    fn all_mistakes_of_a_file_are_reported_at_once_with_their_lines() {
        let paper = BUILT_IN[0].1;
        let believes = |what: &str| format!("{paper}\n[model]\n{what}\n");
        let wrong = "[airframe]\nmas_kg = 1\ngravity_m_s2 = nan\narm_length_m = \"long\"\nmotor_time_constant_s = 9\n\
                     [rotor]\nmin_rad_s = -3\nidle = 4\n[modle]\n[model]\nrotor_inertia_kg_m2 = 1\n";
        for (text, expected) in [
            (
                wrong,
                "line 2: airframe: unknown parameter `mas_kg`; did you mean `mass_kg`?
                 line 3: airframe: gravity_m_s2 = NaN is out of range: allowed are 0.0 to 30.0 m/s^2
                 line 4: airframe.arm_length_m = \"long\": expected a number
                 line 5: airframe: motor_time_constant_s = 9 is out of range
                 line 7: rotor.min_rad_s = -3 is out of range
                 line 8: unknown key `rotor.idle`
                 line 9: unknown `modle`
                 line 11: unknown key `model.rotor_inertia_kg_m2`
                 missing in [airframe]: mass_kg, translational_drag_kg_s, rotational_drag_nm_s, thrust_coefficient_n_s2,
                 missing in [rotor]: max_rad_s",
            ),
            ("[airframe\n", "line 1: "),
            (&believes("mass_kg = \"light\""), "line 25: model.mass_kg = \"light\": expected a number"),
            (&believes("mass_kg = 50"), "line 25: model: mass_kg = 50 is out of range"),
            (
                "airframe = 3\n",
                "line 1: `airframe` must be a section
                 missing in [airframe]:
                 missing in [rotor]: min_rad_s, max_rad_s",
            ),
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
