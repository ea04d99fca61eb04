//! Airframes to choose from: built in, or of a file; each with its rotors and what the controller believes.
//!
//! An airframe file is TOML with the sections `[airframe]`, `[rotor]` and, where the controller is to believe something
//! else, `[model]`. What has no size may be left out: it then has the value of the table. docs/airframes.md has the
//! format; the built-in ones are files of this format.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;

use errors::Failure;
use messages::limits::RotorLimits;
use messages::parameters::{Airframe, Parameter, ParameterError, SPECS, shown};
use toml::{Table, Value};
use toml_edit::{Document, Item};

use crate::settings::DEFAULT;
use crate::settings::toml_access::{nearest, section, text_of};
use crate::settings::trajectory::sha256_of;

const BUILT_IN: [(&str, &str); 3] = [
    (PAPER, include_str!("../../airframes/paper.toml")),
    ("crazyflie", include_str!("../../airframes/crazyflie.toml")),
    ("x500", include_str!("../../airframes/x500.toml")),
];

/// Name of the paper's airframe, which is the default.
pub(crate) const PAPER: &str = "paper";

/// An airframe as it was built, with its rotors.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Design {
    pub airframe: Airframe,
    pub rotor: RotorLimits,
    /// Where the controller believes something else.
    pub believed: BTreeMap<String, f64>,
    /// SHA-256 of its file; empty where it is built in.
    pub sha256: String,
}

/// The airframe of a name or of a file.
///
/// `model` has the parameters that the controller believes in as its keys.
pub(super) fn design(name: &str, model: &Table) -> Result<Design, Failure> {
    let place = || format!("airframe file {name}");
    let (text, sha256) = match BUILT_IN.iter().find(|(known, _)| *known == name) {
        Some((_, text)) => ((*text).to_owned(), String::new()),
        None if is_path(name) => {
            let text = text_of(Path::new(name)).map_err(|e| {
                Failure::usage(format!("cannot read the {}: {e}", place()))
                    .help("name a file that you can read; docs/airframes.md has one to begin with")
            })?;
            let sha256 = sha256_of(&text);
            (text, sha256)
        }
        None => {
            let names: Vec<String> = BUILT_IN
                .iter()
                .map(|(name, _)| (*name).to_owned())
                .collect();
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
    let help = "docs/airframes.md has the format; `ironbird params` lists names, units and ranges";
    let design = read(&text, model);
    let design = design.map_err(|mistakes| {
        Failure::usage(format!("{}: {}", place(), mistakes.join("; "))).help(help)
    })?;
    Ok(Design { sha256, ..design })
}

/// Whether it names a file, by its ending or a folder in it.
fn is_path(name: &str) -> bool {
    name.contains('/') || Path::new(name).extension().is_some()
}

/// Reads the text of an airframe file, or tells every mistake in it.
fn read(text: &str, model: &Table) -> Result<Design, Vec<String>> {
    let document = Document::parse(text).map_err(|e| {
        let line = e.span().map_or(1, |span| line_of(text, &span));
        vec![format!("line {line}: {}", e.message().replace('\n', ", "))]
    })?;
    let mut reader = Reader {
        text,
        mistakes: Vec::new(),
    };
    let mut sections: BTreeMap<&str, BTreeMap<String, (f64, usize)>> = BTreeMap::new();
    for (name, item) in document.iter() {
        let line = document
            .key(name)
            .and_then(toml_edit::Key::span)
            .map_or(1, |span| line_of(text, &span));
        match (
            ["airframe", "rotor", "model"]
                .into_iter()
                .find(|known| *known == name),
            item.as_table_like(),
        ) {
            (Some(known), Some(_)) => {
                sections.insert(known, reader.numbers(known, item));
            }
            (Some(known), None) => {
                reader.says(line, format!("`{known}` must be a section: [{known}]"))
            }
            (None, _) => reader.says(
                line,
                format!("unknown `{name}`: the sections are [airframe], [rotor], [model]"),
            ),
        }
    }
    let values = sections.remove("airframe").unwrap_or_default();
    let (believed, rotor) = (
        sections.remove("model").unwrap_or_default(),
        sections.remove("rotor").unwrap_or_default(),
    );
    let airframe = reader.airframe(&values);
    let rotor = reader.rotor(&rotor);
    let believed = reader.believed(&believed, model, airframe.as_ref());
    match (airframe, reader.mistakes.is_empty()) {
        (Some(airframe), true) => Ok(Design {
            airframe,
            rotor,
            believed,
            sha256: String::new(),
        }),
        _ => Err(reader.told()),
    }
}

/// Collects the mistakes of a file.
struct Reader<'a> {
    text: &'a str,
    /// With their lines; those of the whole file come last.
    mistakes: Vec<(usize, String)>,
}

impl Reader<'_> {
    fn says(&mut self, line: usize, mistake: String) {
        self.mistakes.push((line, mistake));
    }

    fn told(mut self) -> Vec<String> {
        self.mistakes.sort_by_key(|(line, _)| *line);
        let told = |(line, mistake)| match line {
            usize::MAX => mistake,
            line => format!("line {line}: {mistake}"),
        };
        self.mistakes.into_iter().map(told).collect()
    }

    /// The numbers of a section, with their lines.
    fn numbers(&mut self, section: &str, item: &Item) -> BTreeMap<String, (f64, usize)> {
        let mut numbers = BTreeMap::new();
        for (key, item) in item
            .as_table_like()
            .into_iter()
            .flat_map(|table| table.iter())
        {
            let line = item.span().map_or(1, |span| line_of(self.text, &span));
            let number = item
                .as_float()
                .or_else(|| item.as_integer().map(|whole| whole as f64));
            match number {
                Some(number) => {
                    numbers.insert(key.to_owned(), (number, line));
                }
                None => {
                    let found = item.to_string();
                    self.says(
                        line,
                        format!("{section}.{key} = {}: expected a number", found.trim()),
                    );
                    // It is there, so it is not missing as well.
                    numbers.insert(key.to_owned(), (f64::NAN, usize::MAX));
                }
            }
        }
        numbers
    }

    fn airframe(&mut self, given: &BTreeMap<String, (f64, usize)>) -> Option<Airframe> {
        let before = self.mistakes.len();
        let mut values = *Airframe::nominal().values();
        for (name, &(value, line)) in given {
            match Parameter::from_name(name).and_then(|parameter| {
                parameter
                    .widest()
                    .check(parameter, value)
                    .map(|_| parameter)
            }) {
                Ok(parameter) => values[parameter as usize] = value,
                Err(ParameterError::OutOfRange { .. }) if line == usize::MAX => {}
                Err(error) => self.says(line, format!("airframe: {error}")),
            }
        }
        let needed = SPECS
            .iter()
            .filter(|spec| spec.parameter.has_size() || spec.parameter == Parameter::Gravity);
        let missing: Vec<&str> = needed
            .map(|spec| spec.name)
            .filter(|name| !given.contains_key(*name))
            .collect();
        if !missing.is_empty() {
            self.says(
                usize::MAX,
                format!("missing in [airframe]: {}", missing.join(", ")),
            );
        }
        if self.mistakes.len() > before {
            None
        } else {
            Airframe::built_with(values).ok()
        }
    }

    fn rotor(&mut self, given: &BTreeMap<String, (f64, usize)>) -> RotorLimits {
        let mut limits = RotorLimits {
            min_rad_s: 0.0,
            max_rad_s: 0.0,
        };
        for (key, &(value, line)) in given {
            let place = match key.as_str() {
                "min_rad_s" => &mut limits.min_rad_s,
                "max_rad_s" => &mut limits.max_rad_s,
                _ => {
                    self.says(
                        line,
                        format!("unknown key `rotor.{key}`: the keys are min_rad_s, max_rad_s"),
                    );
                    continue;
                }
            };
            *place = value;
            if line != usize::MAX && !(0.0..=1e5).contains(&value) {
                self.says(
                    line,
                    format!(
                        "rotor.{key} = {} is out of range: allowed are 0 to 100000 rad/s",
                        shown(value)
                    ),
                );
            }
        }
        let missing: Vec<&str> = ["min_rad_s", "max_rad_s"]
            .into_iter()
            .filter(|key| !given.contains_key(*key))
            .collect();
        if !missing.is_empty() {
            self.says(
                usize::MAX,
                format!("missing in [rotor]: {}", missing.join(", ")),
            );
        }
        let [min, max] = [limits.min_rad_s, limits.max_rad_s];
        if let (true, Some((_, line))) = (min > max, given.get("min_rad_s")) {
            self.says(
                *line,
                format!("rotor.min_rad_s = {min} must not be above rotor.max_rad_s = {max}"),
            );
        }
        limits
    }

    fn believed(
        &mut self,
        given: &BTreeMap<String, (f64, usize)>,
        model: &Table,
        airframe: Option<&Airframe>,
    ) -> BTreeMap<String, f64> {
        let mut believed = BTreeMap::new();
        for (name, &(value, line)) in given {
            if !model.contains_key(name) {
                self.says(
                    line,
                    format!("unknown key `model.{name}`{}", nearest(name, model.keys())),
                );
            } else if line == usize::MAX {
                // It is no number, which has been said.
            } else if let (Some(airframe), Ok(parameter)) = (airframe, Parameter::from_name(name))
                && let Err(error) = airframe.check(parameter, value)
            {
                self.says(line, format!("model: {error}"));
            } else {
                believed.insert(name.clone(), value);
            }
        }
        believed
    }
}

/// The line of a place in a text, from 1.
pub(super) fn line_of(text: &str, span: &Range<usize>) -> usize {
    1 + text
        .as_bytes()
        .iter()
        .take(span.start)
        .filter(|byte| **byte == b'\n')
        .count()
}

impl Design {
    /// Puts it into the settings: what it was built with, how it is at tick 0, what is believed of it, its rotors.
    pub(super) fn lay(&self, settings: &mut Table) {
        let built = |name: &str| {
            Parameter::from_name(name).map_or(0.0, |parameter| self.airframe.get(parameter))
        };
        settings.insert("airframe".into(), Value::Table(table_of(&self.airframe)));
        for section in ["plant", "model"] {
            for (name, value) in settings
                .get_mut(section)
                .and_then(Value::as_table_mut)
                .into_iter()
                .flatten()
            {
                let believed = self.believed.get(name).filter(|_| section == "model");
                *value = Value::Float(believed.copied().unwrap_or_else(|| built(name)));
            }
        }
        if let Some(rotor) = settings.get_mut("rotor").and_then(Value::as_table_mut) {
            rotor.insert("min_rad_s".into(), Value::Float(self.rotor.min_rad_s));
            rotor.insert("max_rad_s".into(), Value::Float(self.rotor.max_rad_s));
        }
        if let Some(flight) = settings.get_mut("flight").and_then(Value::as_table_mut) {
            flight.insert("airframe_sha256".into(), Value::String(self.sha256.clone()));
        }
    }
}

/// What an airframe was built with, by name.
fn table_of(airframe: &Airframe) -> Table {
    let built = airframe.as_built();
    SPECS
        .iter()
        .map(|spec| {
            (
                spec.name.to_owned(),
                Value::Float(built.get(spec.parameter)),
            )
        })
        .collect()
}

/// The airframe that a section `[airframe]` of the settings describes.
pub(crate) fn built(values: &BTreeMap<String, f64>) -> Result<Airframe, ParameterError> {
    let mut array = *Airframe::nominal().values();
    for (name, value) in values {
        array[Parameter::from_name(name)? as usize] = *value;
    }
    Airframe::built_with(array)
}

/// The keys and values of a settings text, which is TOML of lines `section.key = value`; strings without their quotes.
pub(crate) fn pairs(text: &str) -> BTreeMap<String, String> {
    let table: Table = text.parse().unwrap_or_default();
    let sections = table
        .iter()
        .flat_map(|(section, keys)| keys.as_table().map(|keys| (section, keys)));
    let told = |value: &Value| {
        value
            .as_str()
            .map_or_else(|| value.to_string(), str::to_owned)
    };
    sections
        .flat_map(|(section, keys)| {
            keys.iter()
                .map(move |(k, v)| (format!("{section}.{k}"), told(v)))
        })
        .collect()
}

/// The airframe, as it was built, of settings that all roles share.
pub(crate) fn airframe_of(settings: &BTreeMap<String, String>) -> Result<Airframe, Failure> {
    let named = |(key, value): (&String, &String)| {
        Some((
            key.strip_prefix("airframe.")?.to_owned(),
            value.parse().unwrap_or(f64::NAN),
        ))
    };
    built(&settings.iter().filter_map(named).collect())
        .map_err(|e| Failure::failed(format!("the flight's settings describe no airframe: {e}")))
}

/// The airframe of a name or file, as it was built.
pub(crate) fn named(name: &str) -> Result<Airframe, Failure> {
    let default: Table = DEFAULT
        .parse()
        .map_err(|e| Failure::failed(format!("the default is broken: {e}")))?;
    Ok(design(name, &section(&default, "model"))?.airframe)
}

/// The section `[airframe]` of the paper's airframe.
pub(super) fn paper() -> BTreeMap<String, f64> {
    SPECS
        .iter()
        .map(|spec| (spec.name.to_owned(), spec.nominal))
        .collect()
}

/// The section `[airframe]` as text, for the commented settings.
pub(super) fn commented(values: &BTreeMap<String, f64>) -> toml_edit::Table {
    let mut table = toml_edit::Table::new();
    table.decor_mut().set_prefix(
        "\n# What the airframe was built with: its ranges follow from it (docs/airframes.md).\n",
    );
    for spec in &SPECS {
        let value = values.get(spec.name).copied().unwrap_or(spec.nominal);
        table.insert(spec.name, toml_edit::value(value));
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model() -> Table {
        let table: Table = DEFAULT.parse().unwrap();
        table["model"].as_table().unwrap().clone()
    }

    #[test]
    fn the_papers_file_is_the_table() {
        let paper = design(PAPER, &model()).unwrap();
        assert_eq!(paper.airframe, Airframe::nominal());
        assert_eq!(paper.rotor, RotorLimits::default());
    }

    #[test]
    fn every_built_in_airframe_hovers_on_less_than_its_rotors_give() {
        for (name, _) in BUILT_IN {
            let Design {
                airframe, rotor, ..
            } = design(name, &model()).unwrap();
            let hover = airframe.hover_speed_rad_s();
            assert!(
                rotor.min_rad_s < 0.2 * hover && 1.1 * hover < rotor.max_rad_s,
                "{name}: {hover}"
            );
        }
    }

    #[test]
    fn every_mistake_of_a_file_is_told_at_once_with_its_line() {
        let text = "[airframe]\nmas_kg = 1\ngravity_m_s2 = nan\narm_length_m = \"long\"\nmotor_time_constant_s = 9\n\
                    [rotor]\nmin_rad_s = -3\nidle = 4\n[modle]\n[model]\nrotor_inertia_kg_m2 = 1\n";
        let mistakes = read(text, &model()).unwrap_err().join("; ");
        for told in [
            "line 2: airframe: unknown parameter `mas_kg`; did you mean `mass_kg`?",
            "line 3: airframe: gravity_m_s2 = NaN is out of range: allowed are 0.0 to 30.0 m/s^2",
            "line 4: airframe.arm_length_m = \"long\": expected a number",
            "line 5: airframe: motor_time_constant_s = 9 is out of range",
            "line 7: rotor.min_rad_s = -3 is out of range",
            "line 8: unknown key `rotor.idle`",
            "line 9: unknown `modle`",
            "line 11: unknown key `model.rotor_inertia_kg_m2`",
            "missing in [airframe]: mass_kg, translational_drag_kg_s, rotational_drag_nm_s, thrust_coefficient_n_s2,",
            "missing in [rotor]: max_rad_s",
        ] {
            assert!(mistakes.contains(told), "{told}: {mistakes}");
        }
        assert!(
            !mistakes.contains("arm_length_m, "),
            "it is there, if wrong: {mistakes}"
        );
        assert_eq!(read("[airframe\n", &model()).unwrap_err().len(), 1);
        let (_, paper) = BUILT_IN[0];
        let believes =
            |what: &str| read(&format!("{paper}\n[model]\n{what}\n"), &model()).unwrap_err();
        let (no_number, too_much) = (believes("mass_kg = \"light\""), believes("mass_kg = 50"));
        assert!(
            no_number[0].contains("model.mass_kg = \"light\": expected a number"),
            "{no_number:?}"
        );
        assert!(
            too_much[0].contains("model: mass_kg = 50 is out of range"),
            "{too_much:?}"
        );
        assert_eq!(
            (no_number.len(), too_much.len()),
            (1, 1),
            "{no_number:?} {too_much:?}"
        );
        assert!(
            read("airframe = 3\n", &model()).unwrap_err()[0]
                .starts_with("line 1: `airframe` must be a section")
        );
        assert!(
            read("", &model())
                .unwrap_err()
                .join(" ")
                .contains("missing in [rotor]: min_rad_s, max_rad_s")
        );
    }
}
