//! Reads a campaign's file, and reports every mistake in it with its line.

use crate::campaign::{Campaign, Factor, Submission, Target, Variant};
use crate::distribution::{Distribution, fractional};
use crate::fault::{Fault, is_loop_fault, value_type};
use crate::gates::{
    Gates, METRICS, RECOVERED_BELOW_M, SignalGate, TRACKING_ERROR, TRACKING_YAW_ERROR,
    YAW_ERROR_MAX_RAD,
};
use crate::lines::Lines;
use crate::spread::{SOBOL_DIMENSIONS, SOBOL_FLIGHTS};
use analysis::phrase::count;
use errors::{Failure, toml_mistake};
use faults::ValueType;
use messages::parameters::{Parameter, did_you_mean, nearest};
use messages::telemetry::LAW_ROLES;
use std::collections::BTreeMap;
use std::fmt::Display;
use std::ops::RangeInclusive;
use std::time::Duration;
use toml::de::DeTable;
use toml::{Table, Value};

const FLIGHTS_MAX: i64 = 1_000_000_000;
/// Flights in a file of rows, where the campaign does not set it.
const CHUNK: u64 = 1000;
/// Flights in a file of rows at the most: they are held in memory.
const CHUNK_MAX: i64 = 100_000;
/// Longest time limit: engines count minutes in 32 bits [s].
const TIME_LIMIT_MAX_S: f64 = 1e8;
const PROCESSORS_MAX: i64 = 4096;
/// Name of the only arm, where the campaign names none.
const ONLY_ARM: &str = "base";
/// Sections that are the campaign's own; all others are the settings'.
const OWN: [&str; 6] = ["campaign", "factors", "fault", "arms", "success", "submit"];
/// Sections and keys of the settings that change no row: a campaign simulates one channel without a clock, and its limits
/// are in [success].
const WITHOUT_EFFECT: &str = "rt simplex channel recorder flight.pace flight.slowdown flight.tracking_error_max_m flight.tracking_yaw_error_max_rad";
/// The seed of the sensors' noise, which flights draw unless the file sets it.
const NOISE_SEED: &str = "flight.seed";
const TIMING: &str = "timing";
const RECORDED: &str = "a recorded flight, its directory or its log";
const PARTS: [&str; 5] = ["what", "value", "at_s", "over_s", "for_s"];
const KINDS: &str = "fixed, choice, grid, uniform, normal, loguniform, latin, sobol";

pub fn read(text: &str) -> Result<Campaign, Failure> {
    let refused = |mistakes: String| {
        Failure::usage(mistakes).help("`ironbird docs campaigns` explains the file")
    };
    let unread = |e: toml::de::Error| refused(toml_mistake(text, e.message(), e.span()));
    let given: Table = text.parse().map_err(unread)?;
    let document = DeTable::parse(text).map_err(unread)?.into_inner();
    let order = |section: &str| -> Vec<String> {
        let table = document.get(section).and_then(|it| it.get_ref().as_table());
        let mut keys: Vec<_> = table.into_iter().flat_map(DeTable::keys).collect();
        keys.sort_by_key(|key| key.span().start);
        keys.iter().map(|key| key.get_ref().to_string()).collect()
    };
    let mut reader = Reader {
        lines: Lines::of(text, &document),
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
    let lines = reader.mistakes.iter();
    let lines: Vec<String> = lines
        .map(|(line, what)| format!("line {line}: {what}"))
        .collect();
    Err(refused(lines.join("; ")))
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

impl Reader {
    fn mistake(&mut self, path: &str, mistake: impl Into<String>) {
        let line = self.lines.of_key(path);
        self.mistakes.push((line, mistake.into()));
    }

    /// Keys of the settings, whether they are written `"inner.law" = ..` or `inner.law = ..`: section, key, value. One that
    /// is written in both ways is a mistake, which is noted.
    fn flat(&mut self, path: &str, keys: &Table) -> Vec<(String, String, Value)> {
        let mut all = BTreeMap::new();
        for (name, value) in keys {
            let (section, key) = name.split_once('.').unwrap_or((name, ""));
            let inner = value.as_table().filter(|_| !name.contains('.'));
            let inner = inner.map(|it| {
                it.iter()
                    .map(|(key, value)| (key.as_str(), value))
                    .collect()
            });
            for (key, value) in inner.unwrap_or_else(|| vec![(key, value)]) {
                let place = (section.to_owned(), key.to_owned());
                if all.insert(place, value.clone()).is_some() {
                    let what = format!(
                        "`{section}.{key}` is given twice: as \"{section}.{key}\" and in a section"
                    );
                    self.mistake(path, what);
                }
            }
        }
        let key = |((section, key), value)| (section, key, value);
        all.into_iter().map(key).collect()
    }

    /// The value; none where it is a mistake, which is noted.
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
            let expected = "1 to 64 letters, digits, - or _, as in name = \"mass-and-drag\"";
            self.mistake("campaign.name", format!("campaign.name must be {expected}"));
        }
        if !own.contains_key("flights") {
            let expected = format!("expected a whole number from 1 to {FLIGHTS_MAX}");
            let path = "campaign.flights";
            self.mistake(path, format!("{path} is missing: {expected}"));
        }
        let flights = self.whole(&own, "campaign.flights", 1..=FLIGHTS_MAX);
        self.flights = flights.unwrap_or(1);
        let seed = self.whole(&own, "campaign.seed", 0..=i64::MAX);
        let chunk = self.whole(&own, "campaign.chunk", 1..=CHUNK_MAX);
        let mut base = given.clone();
        base.retain(|section, _| !OWN.contains(&section));
        for (section, key, _) in self.flat("", &base) {
            let name = format!("{section}.{key}");
            self.check_effect(&name, &name);
        }
        let has_setting = |key| base.get("flight").is_some_and(|it| it.get(key).is_some());
        let mut drawn = self.factors(given, factors);
        let is_drawn = |drawn: &[Factor], name| drawn.iter().any(|factor| factor.name == name);
        if !is_drawn(&drawn, NOISE_SEED) && !has_setting("seed") {
            drawn.push(Factor {
                name: NOISE_SEED.into(),
                target: Target::Setting {
                    section: "flight".into(),
                    key: "seed".into(),
                },
                distribution: Distribution::Seed,
                line: 1,
            });
        }
        let faults = self.faults(given, &mut drawn);
        self.set_strides(&mut drawn);
        let mut campaign = Campaign {
            name: name.to_owned(),
            flights: self.flights,
            seed: seed.unwrap_or(1),
            chunk: chunk.unwrap_or(CHUNK),
            timing: self.recorded(&own, "campaign.timing", &drawn),
            arms: self.arms(given, arms, &drawn),
            gates: Gates::default(),
            submission: self.submission(given),
            base,
            factors: drawn,
            faults,
            lines: Lines::default(),
        };
        let mut arms = campaign.arms.iter();
        let has_fault = arms.any(|arm| campaign.has_faults(arm));
        campaign.gates = self.gates(given, has_fault);
        campaign
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
            let what = format!("unknown key `{key}` in [{section}], which has {known}{hint}");
            self.mistake(&format!("{path}.{key}"), what);
        }
    }

    fn check_effect(&mut self, path: &str, name: &str) {
        let section = name.split('.').next();
        let mut without = WITHOUT_EFFECT.split(' ');
        if without.any(|it| it == name || Some(it) == section) {
            let why =
                "a campaign simulates one channel without a clock, with its limits in [success]";
            self.mistake(path, format!("`{name}` has no effect: {why}"));
        }
    }

    /// The value of a key of a section; none where it is missing or a mistake, which is noted.
    fn key<T>(
        &mut self,
        own: &Table,
        path: &str,
        expected: &str,
        read: impl Fn(&Value) -> Option<T>,
    ) -> Option<T> {
        let value = own.get(path.rsplit('.').next()?)?;
        let read = read(value).ok_or_else(|| wrong(path, value, expected));
        self.noted(path, read)
    }

    fn whole(&mut self, own: &Table, path: &str, allowed: RangeInclusive<i64>) -> Option<u64> {
        let (least, most) = (allowed.start(), allowed.end());
        let expected = format!("a whole number from {least} to {most}");
        let read = |value: &Value| value.as_integer().filter(|value| allowed.contains(value));
        let whole = self.key(own, path, &expected, read);
        whole.map(i64::cast_unsigned)
    }

    fn factors(&mut self, given: &Table, order: &[String]) -> Vec<Factor> {
        let section = self.section(given, "factors", None);
        let mut factors = Vec::new();
        for name in order {
            let path = format!("factors.{name}");
            self.check_effect(&path, name);
            let target = match name.split_once('.') {
                Some((section, key)) => Target::Setting {
                    section: section.into(),
                    key: key.into(),
                },
                None if name == TIMING => Target::Timing,
                None => {
                    self.mistake(&path, no_setting(name, "plant.mass_kg"));
                    continue;
                }
            };
            let value = &section[name];
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
        let tables = given.get("fault").map_or(Some(Vec::new()), |tables| {
            let tables = tables.as_array()?.iter().map(Value::as_table);
            tables.collect()
        });
        if tables.is_none() {
            let expected = "faults are written as [[fault]], each with what, value and at_s";
            self.mistake("fault", expected);
        }
        let mut faults = Vec::new();
        for (number, table) in (1..).zip(tables.unwrap_or_default()) {
            let path = format!("fault.{number}");
            for key in table.keys() {
                self.check_key(&path, key, &PARTS);
            }
            let what = table.get("what").and_then(Value::as_str);
            let has_value = what.is_none_or(|what| value_type(what) != ValueType::None);
            let [what, value, at_s, over_s, for_s] =
                PARTS.map(|part| self.fault_part(&path, part, table, factors));
            for (part, is_needed) in [("what", true), ("value", has_value), ("at_s", true)] {
                if is_needed && !table.contains_key(part) {
                    let what = "a fault has what, value and at_s";
                    self.mistake(&path, format!("fault {number} has no `{part}`: {what}"));
                }
            }
            if !has_value && value.is_some() {
                let what = format!("fault {number} takes no value: leave it out");
                self.mistake(&format!("{path}.value"), what);
            }
            if let (Some(what), Some(at_s)) = (what, at_s) {
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
                let expected = "an arm is named by 1 to 64 letters, digits, - or _";
                self.mistake(&path, format!("{expected}, and not `{name}`"));
                continue;
            }
            let Some(mut keys) = section[name].as_table().cloned() else {
                let expected = format!("a section: [arms.{name}], with keys of the settings");
                self.mistake(&path, format!("`{name}` must be {expected}"));
                continue;
            };
            let timing = self.recorded(&keys, &format!("{path}.{TIMING}"), factors);
            keys.remove(TIMING);
            let settings = self.flat(&path, &keys);
            for (section, key, _) in &settings {
                let full = format!("{section}.{key}");
                if key.is_empty() {
                    self.mistake(&path, no_setting(section, "inner.law"));
                } else if factors.iter().any(|factor| factor.name == full) {
                    let what =
                        format!("`{full}` is drawn as a factor, so the arm {name} cannot set it");
                    self.mistake(&path, what);
                }
                self.check_effect(&format!("{path}.{full}"), &full);
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
                line: 1,
                ..Variant::default()
            });
        }
        arms
    }

    fn gates(&mut self, given: &Table, has_fault: bool) -> Gates {
        let own = self.section(given, "success", None);
        let mut gates = Gates {
            recovered_below_m: RECOVERED_BELOW_M,
            recovered_yaw_below_rad: YAW_ERROR_MAX_RAD,
            ..Gates::default()
        };
        let names = METRICS.iter().map(|metric| metric.name);
        let known: Vec<&str> = names
            .chain(["recovered_below_m", "recovered_yaw_below_rad", "telemetry"])
            .collect();
        for (key, value) in &own {
            let path = format!("success.{key}");
            let most = number(value).filter(|most| *most >= 0.0 && most.is_finite());
            let place = known.iter().position(|name| name == key);
            match (key.as_str(), place, most) {
                (_, None, _) => self.check_key("success", key, &known),
                ("telemetry", ..) => gates.telemetry = self.signals(&own),
                ("recovery_max_s", ..) if !has_fault => {
                    let why = "the campaign has no [[fault]] and no flight.faults";
                    let what = format!("recovery_max_s is the time after a fault, and {why}");
                    self.mistake(&path, what);
                }
                (_, _, None) => {
                    let expected = "a number from 0 on, the most that counts as success";
                    self.mistake(&path, wrong(&path, value, expected));
                }
                ("recovered_below_m", _, Some(bound_m)) => gates.recovered_below_m = bound_m,
                ("recovered_yaw_below_rad", _, Some(bound)) => {
                    gates.recovered_yaw_below_rad = bound
                }
                (_, Some(place), Some(most)) => gates.limits.push((place, most)),
            }
        }
        let place = |metric| known.iter().position(|name| *name == metric);
        let is_limited = |metric| gates.limits.iter().any(|it| Some(it.0) == place(metric));
        if is_limited(TRACKING_ERROR) && !is_limited(TRACKING_YAW_ERROR) {
            let yaw = place(TRACKING_YAW_ERROR).map(|place| (place, YAW_ERROR_MAX_RAD));
            gates.limits.extend(yaw);
        }
        gates.limits.sort_by_key(|(place, _)| *place);
        gates
    }

    fn signals(&mut self, success: &Table) -> Vec<SignalGate> {
        let Some(keys) = success["telemetry"].as_table() else {
            let mistake = "`telemetry` must be a section: [success.telemetry]";
            self.mistake("success.telemetry", mistake);
            return Vec::new();
        };
        let mut gates = Vec::new();
        for (name, signal, value) in self.flat("success.telemetry", keys) {
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
            self.mistake(
                path,
                format!("`{name}` is drawn in one way: one of {KINDS}"),
            );
            return None;
        };
        let read = self.drawn(path, kind, &table[kind.as_str()], table.get("within"));
        let distribution = self.noted(path, read)?;
        if table.contains_key("within") && kind != "normal" {
            let mistake = "`within` bounds a normal distribution; the others have their ends";
            self.mistake(path, mistake);
        }
        if !distribution.is_likely() {
            let remedy = "widen it, or move the mean";
            let mistake = format!("fewer than one draw in a hundred would be `within`: {remedy}");
            self.mistake(path, mistake);
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
                let expected = "both ends must be above 0";
                return Err(format!("loguniform = {argument}: {expected}"));
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
            unknown => return Err(format!("`{unknown}` is no way to draw: one of {KINDS}")),
        })
    }

    fn sobol_dimension(&mut self, path: &str) -> usize {
        let dimension = self.dimensions;
        self.dimensions += 1;
        if dimension >= SOBOL_DIMENSIONS {
            let most = format!("sobol draws {SOBOL_DIMENSIONS} factors at the most");
            self.mistake(path, most + ": draw this one as latin");
        }
        if self.flights > SOBOL_FLIGHTS {
            let most = format!("sobol has {SOBOL_FLIGHTS} points: fly fewer flights");
            self.mistake(path, most);
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
            let fewer = format!("{} cannot cover them", count(flights, "flight"));
            let mistake = format!("the grids have {cells} cells, and {fewer}");
            self.mistake("campaign.flights", mistake);
        }
    }

    fn submission(&mut self, given: &Table) -> Submission {
        let known = ["partition", "time_limit_s", "requeue", "processors"];
        let own = self.section(given, "submit", Some(&known));
        let is_name = |name: &&str| {
            let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.,".contains(c);
            !name.is_empty() && !name.starts_with('-') && name.chars().all(is_plain)
        };
        let name = |value: &Value| value.as_str().filter(is_name).map(str::to_owned);
        let expected = "a partition's name, as in \"batch\"";
        let partition = self.key(&own, "submit.partition", expected, name);
        let time = |value: &Value| {
            let allowed = 60.0..=TIME_LIMIT_MAX_S;
            let seconds = number(value).filter(|seconds| allowed.contains(seconds));
            seconds.map(Duration::from_secs_f64)
        };
        let expected = "a time from 60 to 1e8 s, as in 1800.0";
        let time_limit = self.key(&own, "submit.time_limit_s", expected, time);
        let requeue = self.key(&own, "submit.requeue", "true or false", Value::as_bool);
        let processors = self.whole(&own, "submit.processors", 1..=PROCESSORS_MAX);
        Submission {
            partition,
            time_limit,
            requeue: requeue.unwrap_or(true),
            processors: processors.unwrap_or(1),
        }
    }

    /// The recorded flight of the key `timing` of a section.
    fn recorded(&mut self, own: &Table, path: &str, factors: &[Factor]) -> Option<String> {
        own.get(TIMING)?;
        if factors.iter().any(|factor| factor.target == Target::Timing) {
            let mistake = format!("`timing` is drawn as a factor, so {path} cannot set it");
            self.mistake(path, mistake);
            return None;
        }
        let expected = format!("{RECORDED}, as in timing = \"runs/latest\"");
        let name = |value: &Value| Some(value.as_str()?.to_owned()).filter(|it| !it.is_empty());
        self.key(own, path, &expected, name)
    }
}

fn no_setting(name: &str, example: &str) -> String {
    format!("`{name}` is no key of the settings: write \"section.key\", as in \"{example}\"")
}

/// Rejects a part of a fault that is no parameter, value or time. Faults of messages and stages are tried when the
/// first flight is.
fn check_part(part: &str, path: &str, end: &Value) -> Result<(), String> {
    let expected = match (part, end) {
        ("what", Value::String(name)) if is_loop_fault(name) => return Ok(()),
        ("what", Value::String(name)) => {
            let parameter = Parameter::from_name(name).map(drop);
            return parameter.map_err(|e| e.to_string());
        }
        ("what", _) => "the name of a parameter, or state.drop and the like",
        ("value", Value::Float(_) | Value::String(_)) => return Ok(()),
        ("value", _) => "a number, \"nominal\" or \"+30%\"",
        (_, Value::Float(time)) if (0.0..=1e9).contains(time) => return Ok(()),
        _ => "a time from 0 s on, as in 4.0",
    };
    Err(wrong(path, end, expected))
}
