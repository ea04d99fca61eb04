//! Reads a campaign's file, and reports every mistake in it with its line.

use crate::campaign::{Campaign, Factor, Submission, Target, Variant};
use crate::distribution::{Distribution, fractional};
use crate::fault::{Fault, Number, is_of_the_loop};
use crate::gates::{Gates, METRICS, RECOVERED_BELOW_M, SignalGate};
use crate::lines::{Lines, line_of};
use crate::spread::{SOBOL_DIMENSIONS, SOBOL_FLIGHTS};
use errors::Failure;
use messages::parameters::{Parameter, did_you_mean, nearest};
use messages::telemetry::LAW_ROLES;
use std::collections::BTreeMap;
use std::fmt::Display;
use std::ops::RangeInclusive;
use std::time::Duration;
use toml::{Table, Value};
use toml_edit::Document;

const FLIGHTS_MAX: i64 = 1_000_000_000;
/// Flights in a file of rows, where the campaign says nothing.
const CHUNK: i64 = 1000;
/// Flights in a file of rows at the most: they are held in memory.
const CHUNK_MAX: i64 = 100_000;
/// Longest time limit: engines count minutes in 32 bits [s].
const TIME_LIMIT_MAX_S: f64 = 1e8;
const PROCESSORS_MAX: i64 = 4096;
/// Name of the only arm, where the campaign names none.
const ONLY_ARM: &str = "base";
/// Sections that are the campaign's own; all others are the settings'.
const OWN: [&str; 6] = ["campaign", "factors", "fault", "arms", "success", "submit"];
/// The seed of the sensors' noise, which flights draw unless the file says otherwise.
const NOISE_SEED: &str = "flight.seed";
const TIMING: &str = "timing";
const RECORDED: &str = "a recorded flight, its directory or its log";
const FAULTS: &str = "faults are written as [[fault]], each with what, value and at_s";
const KINDS: [&str; 8] = [
    "fixed",
    "choice",
    "grid",
    "uniform",
    "normal",
    "loguniform",
    "latin",
    "sobol",
];

pub fn read(text: &str) -> Result<Campaign, Failure> {
    let failure = |mistakes: &[(usize, String)]| {
        let line = |(line, mistake): &(usize, String)| format!("line {line}: {mistake}");
        let lines: Vec<String> = mistakes.iter().map(line).collect();
        Failure::usage(lines.join("; ")).help("docs/campaigns.md explains the file")
    };
    let unread = |message: &str, span: Option<std::ops::Range<usize>>| {
        let line = span.map_or(1, |span| line_of(text, &span));
        failure(&[(line, message.trim_end().replace('\n', ", "))])
    };
    let given: Table = text
        .parse()
        .map_err(|e: toml::de::Error| unread(e.message(), e.span()))?;
    let document = Document::parse(text).map_err(|e| unread(e.message(), e.span()))?;
    let order = |section: &str| -> Vec<String> {
        let keys = document.get(section).and_then(|it| it.as_table_like());
        let keys = keys.into_iter().flat_map(|keys| keys.iter());
        keys.map(|(key, _)| key.to_owned()).collect()
    };
    let mut reader = Reader {
        lines: Lines::of(text),
        mistakes: Vec::new(),
        flights: 0,
        dimensions: 0,
    };
    let mut campaign = reader.campaign(&given, &order("factors"), &order("arms"));
    if reader.mistakes.is_empty() {
        campaign.lines = reader.lines;
        return Ok(campaign);
    }
    reader.mistakes.sort_by_key(|(line, _)| *line);
    Err(failure(&reader.mistakes))
}

struct Reader {
    lines: Lines,
    mistakes: Vec<(usize, String)>,
    flights: u64,
    /// Dimensions of Sobol's sequence that the factors so far take.
    dimensions: usize,
}

fn wrong(path: &str, value: &Value, expected: impl Display) -> String {
    format!("{path} = {value}: expected {expected}")
}

fn number(value: &Value) -> Option<f64> {
    let whole = || value.as_integer().map(|whole| whole as f64);
    value.as_float().or_else(whole)
}

fn range(value: &Value) -> Option<[f64; 2]> {
    let numbers: Option<Vec<f64>> = value.as_array()?.iter().map(number).collect();
    let numbers: Option<[f64; 2]> = numbers?.try_into().ok();
    numbers.filter(|numbers| numbers.iter().all(|number| number.is_finite()))
}

fn proper(kind: &str, value: &Value) -> Result<[f64; 2], String> {
    let why = match range(value) {
        Some([low, high]) if low < high => return Ok([low, high]),
        Some(_) => "the range is empty: expected",
        None => "expected two numbers,",
    };
    Err(format!(
        "{kind} = {value}: {why} [low, high] with low below high"
    ))
}

/// A list of values of one kind; whole and fractional numbers may be mixed: then all are fractional.
fn values(kind: &str, value: &Value) -> Result<Vec<Value>, String> {
    let is_uniform = |values: &[Value]| values.windows(2).all(|pair| pair[0].same_type(&pair[1]));
    let mut values: Vec<Value> = value.as_array().into_iter().flatten().cloned().collect();
    if !is_uniform(&values) {
        values = values.into_iter().map(fractional).collect();
    }
    if values.is_empty() || !is_uniform(&values) {
        let expected = "a list of values of one kind, as in [0.4, 0.5]";
        return Err(wrong(kind, value, expected));
    }
    Ok(values)
}

fn is_name(name: &str) -> bool {
    let is_allowed = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    (1..=64).contains(&name.len()) && name.chars().all(is_allowed)
}

/// Keys of the settings, whether they are written `"inner.law" = ..` or `inner.law = ..`: section, key, value.
fn flat(keys: &Table) -> Vec<(String, String, Value)> {
    let mut all: BTreeMap<(String, String), Value> = BTreeMap::new();
    for (name, value) in keys {
        match (name.split_once('.'), value) {
            (None, Value::Table(inner)) => {
                let inner = inner.iter();
                all.extend(inner.map(|(key, value)| ((name.clone(), key.clone()), value.clone())));
            }
            (split, value) => {
                let (section, key) = split.unwrap_or((name, ""));
                all.insert((section.to_owned(), key.to_owned()), value.clone());
            }
        }
    }
    let all = all.into_iter();
    all.map(|((section, key), value)| (section, key, value))
        .collect()
}

impl Reader {
    fn mistake(&mut self, path: &str, mistake: impl Into<String>) {
        let line = self.lines.of_key(path);
        self.mistakes.push((line, mistake.into()));
    }

    /// The value, or nothing where it is a mistake, which is noted.
    fn noted<T>(&mut self, path: &str, read: Result<T, String>) -> Option<T> {
        read.map_err(|mistake| self.mistake(path, mistake)).ok()
    }

    fn campaign(&mut self, given: &Table, factors: &[String], arms: &[String]) -> Campaign {
        let known = ["name", "flights", "seed", "chunk", TIMING];
        let own = self.section(given, "campaign", Some(&known));
        if !given.contains_key("campaign") {
            self.mistake("", "there is no section [campaign] with name and flights");
        }
        let name = own.get("name").and_then(Value::as_str).unwrap_or_default();
        if !is_name(name) {
            self.mistake(
                "campaign.name",
                "campaign.name must be 1 to 64 letters, digits, - or _, as in name = \"mass-and-drag\"",
            );
        }
        self.flights = self.whole(&own, "flights", None, 1..=FLIGHTS_MAX);
        let seed = self.whole(&own, "seed", Some(1), 0..=i64::MAX);
        let chunk = self.whole(&own, "chunk", Some(CHUNK), 1..=CHUNK_MAX);
        let mut base = given.clone();
        base.retain(|section, _| !OWN.contains(&section));
        let has_setting = |key| base.get("flight").is_some_and(|it| it.get(key).is_some());
        let section = self.section(given, "factors", None);
        let mut drawn = self.factors(&section, factors);
        let is_drawn = |drawn: &[Factor], name| drawn.iter().any(|factor| factor.name == name);
        if !is_drawn(&drawn, NOISE_SEED) && !has_setting("seed") {
            let target = Target::Setting {
                section: "flight".into(),
                key: "seed".into(),
            };
            drawn.push(Factor {
                name: NOISE_SEED.into(),
                target,
                distribution: Distribution::Seed,
                line: 1,
            });
        }
        let faults = self.faults(given, &mut drawn);
        self.set_strides(&mut drawn);
        let has_fault =
            !faults.is_empty() || has_setting("faults") || is_drawn(&drawn, "flight.faults");
        let success = self.section(given, "success", None);
        let timing = own.get(TIMING);
        Campaign {
            name: name.to_owned(),
            flights: self.flights,
            seed,
            chunk,
            timing: timing.and_then(|it| self.recorded("campaign.timing", it, &drawn)),
            arms: self.arms(given, arms, &drawn),
            gates: self.gates(&success, has_fault),
            submission: self.submission(given),
            base,
            factors: drawn,
            faults,
            lines: Lines::default(),
        }
    }

    /// A section that may be missing; a value that is no section is a mistake, and so is a key that is not known.
    fn section(&mut self, given: &Table, name: &str, known: Option<&[&str]>) -> Table {
        if given.get(name).is_some_and(|section| !section.is_table()) {
            self.mistake(name, format!("`{name}` must be a section: [{name}]"));
        }
        let section = given.get(name).and_then(Value::as_table);
        let section = section.cloned().unwrap_or_default();
        for key in section.keys().filter(|_| known.is_some()) {
            self.check_key(name, key, known.unwrap_or_default());
        }
        section
    }

    fn check_key(&mut self, path: &str, key: &str, known: &[&str]) {
        if !known.contains(&key) {
            let hint = did_you_mean(nearest(key, known.iter().copied()));
            let section = path.split('.').next().unwrap_or_default();
            let known = known.join(", ");
            self.mistake(
                &format!("{path}.{key}"),
                format!("unknown key `{key}` in [{section}], which has {known}{hint}"),
            );
        }
    }

    fn whole(
        &mut self,
        own: &Table,
        key: &str,
        default: Option<i64>,
        allowed: RangeInclusive<i64>,
    ) -> u64 {
        let given = own.get(key);
        let value = match given {
            None => default,
            Some(value) => value.as_integer().filter(|value| allowed.contains(value)),
        };
        if value.is_none() {
            let given = given.map_or_else(|| "is missing".to_owned(), |value| format!("= {value}"));
            let (path, least, most) = (format!("campaign.{key}"), allowed.start(), allowed.end());
            self.mistake(
                &path,
                format!("{path} {given}: expected a whole number from {least} to {most}"),
            );
        }
        value.unwrap_or(1).cast_unsigned()
    }

    fn factors(&mut self, given: &Table, order: &[String]) -> Vec<Factor> {
        let mut factors = Vec::new();
        for name in order {
            let Some(value) = given.get(name) else {
                continue;
            };
            let path = format!("factors.{name}");
            let target = match name.split_once('.') {
                Some((section, key)) => Target::Setting {
                    section: section.into(),
                    key: key.into(),
                },
                None if name == TIMING => Target::Timing,
                None => {
                    self.mistake(
                        &path,
                        format!("`{name}` is no key of the settings: write \"section.key\", as in \"plant.mass_kg\""),
                    );
                    continue;
                }
            };
            let Some(distribution) = self.distribution(&path, name, value) else {
                continue;
            };
            let is_recording = |value: &Value| value.as_str().is_some_and(|name| !name.is_empty());
            if target == Target::Timing && !distribution.ends().iter().all(is_recording) {
                let expected = format!("for each choice {RECORDED}");
                self.mistake(&path, wrong(TIMING, value, expected));
                continue;
            }
            factors.push(Factor {
                name: name.clone(),
                target,
                distribution,
                line: self.lines.of_key(&path),
            });
        }
        factors
    }

    fn faults(&mut self, given: &Table, factors: &mut Vec<Factor>) -> Vec<Fault> {
        let tables = match given.get("fault") {
            None => return Vec::new(),
            Some(Value::Array(tables)) => tables.as_slice(),
            Some(_) => {
                self.mistake("fault", FAULTS);
                return Vec::new();
            }
        };
        let mut faults = Vec::new();
        for (number, table) in (1..).zip(tables) {
            let Some(table) = table.as_table() else {
                self.mistake("fault", FAULTS);
                continue;
            };
            let path = format!("fault.{number}");
            for key in table.keys() {
                self.check_key(&path, key, &["what", "value", "at_s", "over_s", "for_s"]);
            }
            let what = table.get("what").and_then(Value::as_str);
            let is_valued = what.is_none_or(|what| Number::of(what) != Number::None);
            let mut part = |part: &str| self.fault_part(&path, part, table, factors);
            let [what, value, at_s, over_s, for_s] =
                ["what", "value", "at_s", "over_s", "for_s"].map(&mut part);
            for (part, is_needed) in [("what", true), ("value", is_valued), ("at_s", true)] {
                if is_needed && !table.contains_key(part) {
                    self.mistake(
                        &path,
                        format!("fault {number} has no `{part}`: a fault has what, value and at_s"),
                    );
                }
            }
            if !is_valued && value.is_some() {
                self.mistake(
                    &format!("{path}.value"),
                    format!("fault {number} takes no value: leave it out"),
                );
            }
            if let (Some(what), Some(at_s)) = (what, at_s)
                && (value.is_some() || !is_valued)
            {
                faults.push(Fault {
                    what,
                    value,
                    at_s,
                    over_s,
                    for_s,
                });
            }
        }
        faults
    }

    /// Adds a part of a fault to the factors; its place among them.
    fn fault_part(
        &mut self,
        path: &str,
        part: &str,
        table: &Table,
        factors: &mut Vec<Factor>,
    ) -> Option<usize> {
        let name = format!("{path}.{part}");
        let distribution = self.distribution(&name, &name, table.get(part)?)?;
        let distribution = distribution.fractional();
        for end in distribution.ends() {
            let checked = check_part(part, &name, &end);
            self.noted(&name, checked);
        }
        factors.push(Factor {
            line: self.lines.of_key(&name),
            name,
            target: Target::Fault,
            distribution,
        });
        Some(factors.len() - 1)
    }

    fn arms(&mut self, given: &Table, order: &[String], factors: &[Factor]) -> Vec<Variant> {
        let section = self.section(given, "arms", None);
        let mut arms = Vec::new();
        for name in order {
            let path = format!("arms.{name}");
            // It is part of the names of files.
            if !is_name(name) {
                self.mistake(
                    &path,
                    format!("an arm is named by 1 to 64 letters, digits, - or _, and not `{name}`"),
                );
                continue;
            }
            let Some(mut keys) = section.get(name).and_then(Value::as_table).cloned() else {
                self.mistake(
                    &path,
                    format!("`{name}` must be a section: [arms.{name}], with keys of the settings"),
                );
                continue;
            };
            let timing = keys.remove(TIMING);
            let timing =
                timing.and_then(|it| self.recorded(&format!("{path}.{TIMING}"), &it, factors));
            let mut settings = Vec::new();
            for (section, key, value) in flat(&keys) {
                let full = format!("{section}.{key}");
                if key.is_empty() {
                    self.mistake(
                        &path,
                        format!("`{section}` is no key of the settings: write \"section.key\", as in \"inner.law\""),
                    );
                } else if factors.iter().any(|factor| factor.name == full) {
                    self.mistake(
                        &path,
                        format!("`{full}` is drawn as a factor, so the arm {name} cannot set it"),
                    );
                } else {
                    settings.push((section, key, value));
                }
            }
            arms.push(Variant {
                name: name.clone(),
                settings,
                timing,
                line: self.lines.of_key(&path),
            });
        }
        if arms.is_empty() {
            arms.push(Variant {
                name: ONLY_ARM.into(),
                settings: Vec::new(),
                timing: None,
                line: 1,
            });
        }
        arms
    }

    fn gates(&mut self, given: &Table, has_fault: bool) -> Gates {
        let mut gates = Gates {
            recovered_below_m: RECOVERED_BELOW_M,
            ..Gates::default()
        };
        let names = METRICS.iter().map(|metric| metric.name);
        let known: Vec<&str> = names.chain(["recovered_below_m", "telemetry"]).collect();
        for (key, value) in given {
            let path = format!("success.{key}");
            let most = number(value).filter(|most| *most >= 0.0 && most.is_finite());
            let place = known.iter().position(|name| name == key);
            match (key.as_str(), place, most) {
                (_, None, _) => self.check_key("success", key, &known),
                ("telemetry", ..) => gates.telemetry = self.signals(value),
                ("recovery_max_s", ..) if !has_fault => {
                    self.mistake(&path, "recovery_max_s is the time after a fault, and the campaign has no [[fault]] and no flight.faults");
                }
                (_, _, None) => {
                    let expected = "a number from 0 on, the most that counts as success";
                    self.mistake(&path, wrong(&path, value, expected));
                }
                ("recovered_below_m", _, Some(bound_m)) => gates.recovered_below_m = bound_m,
                (_, Some(place), Some(most)) => gates.limits.push((place, most)),
            }
        }
        gates.limits.sort_by_key(|(place, _)| *place);
        gates
    }

    fn signals(&mut self, value: &Value) -> Vec<SignalGate> {
        let Some(keys) = value.as_table() else {
            let mistake = "`telemetry` must be a section: [success.telemetry]";
            self.mistake("success.telemetry", mistake);
            return Vec::new();
        };
        let mut gates = Vec::new();
        for (name, signal, value) in flat(keys) {
            let role = LAW_ROLES.into_iter().find(|role| role.name() == name);
            let range = range(&value).filter(|[low, high]| low <= high);
            match (role, signal.is_empty(), range) {
                (Some(role), false, Some(range)) => gates.push(SignalGate {
                    role,
                    signal,
                    range,
                }),
                _ => self.mistake(
                    &format!("success.telemetry.{name}"),
                    "a number of a law is named by its role, with the range that it must stay in: \
                     \"inner.rotational_drag_nm_s\" = [0.0, 1.0]",
                ),
            }
        }
        gates
    }

    /// The distribution of a value of the file; none where it is a mistake, which is noted.
    fn distribution(&mut self, path: &str, name: &str, value: &Value) -> Option<Distribution> {
        let Some(table) = value.as_table() else {
            return Some(Distribution::Fixed(value.clone()));
        };
        let kinds: Vec<&String> = table.keys().filter(|key| *key != "within").collect();
        let [kind] = kinds[..] else {
            let kinds = KINDS.join(", ");
            self.mistake(
                path,
                format!("`{name}` is drawn in one way: one of {kinds}"),
            );
            return None;
        };
        let read = self.drawn(path, kind, &table[kind.as_str()], table.get("within"));
        let distribution = self.noted(path, read)?;
        if table.contains_key("within") && kind != "normal" {
            self.mistake(
                path,
                "`within` bounds a normal distribution; the others have their ends",
            );
        }
        if !distribution.is_likely() {
            self.mistake(
                path,
                "fewer than one draw in a hundred would be `within`: widen it, or move the mean",
            );
        }
        Some(distribution)
    }

    fn drawn(
        &mut self,
        path: &str,
        kind: &str,
        argument: &Value,
        within: Option<&Value>,
    ) -> Result<Distribution, String> {
        let range = || proper(kind, argument);
        Ok(match kind {
            "fixed" => Distribution::Fixed(argument.clone()),
            "choice" => Distribution::Choice(values(kind, argument)?),
            "grid" => Distribution::Grid {
                values: values(kind, argument)?,
                stride: 1,
            },
            "uniform" => Distribution::Uniform(range()?),
            "loguniform" if range()?[0] <= 0.0 => {
                return Err(format!(
                    "loguniform = {argument}: both ends must be above 0"
                ));
            }
            "loguniform" => Distribution::LogUniform(range()?),
            "latin" => Distribution::Latin {
                range: range()?,
                flights: self.flights,
            },
            "sobol" => Distribution::Sobol {
                range: range()?,
                dimension: self.sobol_dimension(path),
            },
            "normal" => {
                let numbers = self::range(argument).filter(|[_, deviation]| *deviation > 0.0);
                let expected = "[mean, standard deviation], the second above 0";
                let [mean, deviation] = numbers.ok_or_else(|| wrong(kind, argument, expected))?;
                Distribution::Normal {
                    mean,
                    deviation,
                    within: within.map(|it| proper("within", it)).transpose()?,
                }
            }
            unknown => {
                let kinds = KINDS.join(", ");
                return Err(format!("`{unknown}` is no way to draw: one of {kinds}"));
            }
        })
    }

    fn sobol_dimension(&mut self, path: &str) -> usize {
        let dimension = self.dimensions;
        self.dimensions += 1;
        if dimension >= SOBOL_DIMENSIONS {
            self.mistake(
                path,
                format!(
                    "sobol draws {SOBOL_DIMENSIONS} factors at the most: draw this one as latin"
                ),
            );
        }
        if self.flights > SOBOL_FLIGHTS {
            self.mistake(
                path,
                format!("sobol has {SOBOL_FLIGHTS} points: fly fewer flights"),
            );
        }
        dimension
    }

    /// Sets the grids' strides: the last one changes with every flight.
    fn set_strides(&mut self, factors: &mut [Factor]) {
        let mut cells: u64 = 1;
        for factor in factors.iter_mut().rev() {
            if let Distribution::Grid { values, stride } = &mut factor.distribution {
                *stride = cells;
                cells = cells.saturating_mul(values.len() as u64);
            }
        }
        let flights = self.flights;
        if cells > flights {
            self.mistake(
                "campaign.flights",
                format!(
                    "the grids have {cells} cells, and {flights} flights leave some of them out"
                ),
            );
        }
    }

    fn submission(&mut self, given: &Table) -> Submission {
        let known = ["partition", "time_limit_s", "requeue", "processors"];
        let own = self.section(given, "submit", Some(&known));
        let is_name = |name: &&str| {
            let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.,".contains(c);
            !name.is_empty() && !name.starts_with('-') && name.chars().all(is_plain)
        };
        let expected = "a partition's name, as in \"batch\"";
        let partition = self.submit_key(&own, "partition", expected, |value| {
            value.as_str().filter(is_name).map(str::to_owned)
        });
        let expected = "a time from 60 to 1e8 s, as in 1800.0";
        let time_limit = self.submit_key(&own, "time_limit_s", expected, |value| {
            number(value)
                .filter(|seconds| (60.0..=TIME_LIMIT_MAX_S).contains(seconds))
                .map(Duration::from_secs_f64)
        });
        let requeue = self.submit_key(&own, "requeue", "true or false", Value::as_bool);
        let expected = "a whole number from 1 to 4096";
        let processors = self.submit_key(&own, "processors", expected, |value| {
            let number = value.as_integer();
            number.filter(|number| (1..=PROCESSORS_MAX).contains(number))
        });
        Submission {
            partition,
            time_limit,
            requeue: requeue.unwrap_or(true),
            processors: processors.unwrap_or(1).cast_unsigned(),
        }
    }

    /// A key of the section [submit] that may be missing.
    fn submit_key<T>(
        &mut self,
        own: &Table,
        key: &str,
        expected: &str,
        read: impl Fn(&Value) -> Option<T>,
    ) -> Option<T> {
        let (path, value) = (format!("submit.{key}"), own.get(key)?);
        let read = read(value).ok_or_else(|| wrong(&path, value, expected));
        self.noted(&path, read)
    }

    /// The recorded flight of a key.
    fn recorded(&mut self, path: &str, value: &Value, factors: &[Factor]) -> Option<String> {
        if factors.iter().any(|factor| factor.target == Target::Timing) {
            self.mistake(
                path,
                format!("`timing` is drawn as a factor, so {path} cannot set it"),
            );
            return None;
        }
        let name = value.as_str().filter(|name| !name.is_empty());
        let expected = format!("{RECORDED}, as in timing = \"runs/latest\"");
        let name = name.ok_or_else(|| wrong(path, value, expected));
        self.noted(path, name).map(str::to_owned)
    }
}

/// Rejects a part of a fault that is no parameter, value or time. Faults of messages and stages are tried when the
/// first flight is.
fn check_part(part: &str, path: &str, end: &Value) -> Result<(), String> {
    match (part, end) {
        ("what", Value::String(name)) if is_of_the_loop(name) => Ok(()),
        ("what", Value::String(name)) => Parameter::from_name(name)
            .map(drop)
            .map_err(|e| e.to_string()),
        ("what", _) => Err(wrong(
            path,
            end,
            "the name of a parameter, or state.drop and the like",
        )),
        ("value", Value::Float(_) | Value::String(_)) => Ok(()),
        ("value", _) => Err(wrong(path, end, "a number, \"nominal\" or \"+30%\"")),
        (_, Value::Float(time)) if (0.0..=1e9).contains(time) => Ok(()),
        (_, _) => Err(wrong(path, end, "a time from 0 s on, as in 4.0")),
    }
}
