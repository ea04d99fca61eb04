//! Reads a campaign's file, and tells every mistake in it with its line.

use crate::campaign::{Campaign, Factor, Submission, Target, Variant};
use crate::distribution::{Distribution, fractional};
use crate::fault::{Fault, Number, is_of_the_loop};
use crate::gates::{Gates, METRICS, RECOVERED_BELOW_M, SignalGate};
use crate::lines::{Lines, line_of};
use crate::spread::{SOBOL_DIMENSIONS, SOBOL_FLIGHTS};
use errors::Failure;
use messages::parameters::{Parameter, did_you_mean, nearest};
use std::collections::BTreeMap;
use std::time::Duration;
use toml::{Table, Value};
use toml_edit::Document;

const FLIGHTS_MAX: i64 = 1_000_000_000;
/// Flights in a file of rows, where the campaign says nothing.
const CHUNK: i64 = 1000;
/// Flights in a file of rows at the most: they are held in memory.
const CHUNK_MAX: i64 = 100_000;
/// Name of the only arm, where the campaign names none.
const ONLY_ARM: &str = "base";
/// Sections that are the campaign's own; all others are the settings'.
const OWN: [&str; 6] = ["campaign", "factors", "fault", "arms", "success", "submit"];
/// The seed of the sensors' noise, which flights draw unless the file says otherwise.
const NOISE_SEED: &str = "flight.seed";

const FAULTS: &str = "faults are written as [[fault]], each with what, value and at_s";

/// Reads the text of a campaign's file.
pub fn read(text: &str) -> Result<Campaign, Failure> {
    let told = |mistakes: Vec<(usize, String)>| {
        let told: Vec<String> = mistakes
            .iter()
            .map(|(line, mistake)| format!("line {line}: {mistake}"))
            .collect();
        Failure::usage(told.join("; ")).help("docs/campaigns.md explains the file")
    };
    let unread = |message: &str, span: Option<std::ops::Range<usize>>| {
        let line = span.map_or(1, |span| line_of(text, &span));
        told(vec![(line, message.trim_end().replace('\n', ", "))])
    };
    let given: Table = text
        .parse()
        .map_err(|e: toml::de::Error| unread(e.message(), e.span()))?;
    let document = Document::parse(text).map_err(|e| unread(e.message(), e.span()))?;
    let order = |section: &str| -> Vec<String> {
        let keys = document
            .get(section)
            .and_then(toml_edit::Item::as_table_like);
        keys.map_or_else(Vec::new, |keys| {
            keys.iter().map(|(key, _)| key.to_owned()).collect()
        })
    };
    let mut reader = Reader {
        lines: Lines::of(text),
        mistakes: Vec::new(),
        taken: Taken::default(),
    };
    let campaign = reader.campaign(&given, &order("factors"), &order("arms"));
    if reader.mistakes.is_empty() {
        return Ok(Campaign {
            lines: reader.lines,
            ..campaign
        });
    }
    reader.mistakes.sort_by_key(|(line, _)| *line);
    Err(told(reader.mistakes))
}

/// Collects the mistakes of a file.
struct Reader {
    lines: Lines,
    mistakes: Vec<(usize, String)>,
    taken: Taken,
}

impl Reader {
    /// Notes a mistake at a key.
    fn says(&mut self, path: &str, mistake: impl Into<String>) {
        self.mistakes
            .push((self.lines.of_key(path), mistake.into()));
    }

    fn campaign(&mut self, given: &Table, factors: &[String], arms: &[String]) -> Campaign {
        let own = self.section(given, "campaign");
        self.check_keys(
            "campaign",
            &own,
            &["name", "flights", "seed", "chunk", TIMING],
        );
        if !given.contains_key("campaign") {
            self.says("", "there is no section [campaign] with name and flights");
        }
        let name = self.name(&own);
        let flights = self.whole(&own, "flights", None, 1..=FLIGHTS_MAX);
        let seed = self.whole(&own, "seed", Some(1), 0..=i64::MAX);
        let chunk = self.whole(&own, "chunk", Some(CHUNK), 1..=CHUNK_MAX);
        self.taken.flights = flights;
        let mut base = given.clone();
        base.retain(|section, _| !OWN.contains(&section));
        let section = self.section(given, "factors");
        let mut drawn = self.factors(&section, factors);
        if drawn.iter().all(|factor| factor.name != NOISE_SEED)
            && base.get("flight").is_none_or(|it| it.get("seed").is_none())
        {
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
        self.grids(&mut drawn);
        let has_fault = !faults.is_empty()
            || base
                .get("flight")
                .is_some_and(|it| it.get("faults").is_some())
            || drawn.iter().any(|factor| factor.name == "flight.faults");
        let success = self.section(given, "success");
        let timing = own
            .get(TIMING)
            .and_then(|value| self.recorded("campaign.timing", value, &drawn));
        Campaign {
            name,
            flights,
            seed,
            chunk,
            arms: self.arms(given, arms, &drawn),
            gates: self.gates(&success, has_fault),
            submission: self.submission(given),
            base,
            timing,
            factors: drawn,
            faults,
            lines: Lines::default(),
        }
    }

    /// A section that may be missing; what is no section is a mistake.
    fn section(&mut self, given: &Table, name: &str) -> Table {
        if given.get(name).is_some_and(|section| !section.is_table()) {
            self.says(name, format!("`{name}` must be a section: [{name}]"));
        }
        given
            .get(name)
            .and_then(Value::as_table)
            .cloned()
            .unwrap_or_default()
    }

    fn check_keys(&mut self, section: &str, given: &Table, known: &[&str]) {
        for key in given.keys().filter(|key| !known.contains(&key.as_str())) {
            let hint = did_you_mean(nearest(key, known.iter().copied()));
            let dotted = section.split('.').next().unwrap_or_default();
            self.says(
                &format!("{section}.{key}"),
                format!(
                    "unknown key `{key}` in [{dotted}], which has {}{hint}",
                    known.join(", ")
                ),
            );
        }
    }

    fn name(&mut self, own: &Table) -> String {
        let name = own.get("name").and_then(Value::as_str).unwrap_or_default();
        if !is_name(name) {
            self.says(
                "campaign.name",
                "campaign.name must be 1 to 64 letters, digits, - or _, as in name = \"mass-and-drag\"",
            );
        }
        name.to_owned()
    }

    fn whole(
        &mut self,
        own: &Table,
        key: &str,
        default: Option<i64>,
        allowed: std::ops::RangeInclusive<i64>,
    ) -> u64 {
        let path = format!("campaign.{key}");
        let value = match own.get(key) {
            None => default,
            Some(value) => value.as_integer().filter(|value| allowed.contains(value)),
        };
        if value.is_none() {
            let given = own
                .get(key)
                .map_or_else(|| "is missing".to_owned(), |value| format!("= {value}"));
            let (least, most) = (allowed.start(), allowed.end());
            self.says(
                &path,
                format!("{path} {given}: expected a whole number from {least} to {most}"),
            );
        }
        value.unwrap_or(1).cast_unsigned()
    }

    fn factors(&mut self, given: &Table, order: &[String]) -> Vec<Factor> {
        let mut factors = Vec::new();
        for name in order {
            let path = format!("factors.{name}");
            if name == TIMING {
                factors.extend(given.get(name).and_then(|value| self.drawn_timing(value)));
                continue;
            }
            let Some((section, key)) = name.split_once('.') else {
                self.says(
                    &path,
                    format!("`{name}` is no key of the settings: write \"section.key\", as in \"plant.mass_kg\""),
                );
                continue;
            };
            let Some(distribution) = given
                .get(name)
                .and_then(|value| self.distribution(&path, name, value))
            else {
                continue;
            };
            let target = Target::Setting {
                section: section.into(),
                key: key.into(),
            };
            factors.push(Factor {
                name: name.clone(),
                target,
                distribution,
                line: self.lines.of_key(&path),
            });
        }
        factors
    }

    /// Faults, whose parts join the factors.
    fn faults(&mut self, given: &Table, factors: &mut Vec<Factor>) -> Vec<Fault> {
        let tables = match given.get("fault") {
            None => return Vec::new(),
            Some(Value::Array(tables)) => tables.clone(),
            Some(_) => {
                self.says("fault", FAULTS);
                return Vec::new();
            }
        };
        let mut faults = Vec::new();
        for (number, table) in (1..).zip(&tables) {
            let path = format!("fault.{number}");
            let Some(table) = table.as_table() else {
                self.says("fault", FAULTS);
                continue;
            };
            self.check_keys(&path, table, &["what", "value", "at_s", "over_s", "for_s"]);
            let mut part = |part: &str, is_needed: bool| {
                let name = format!("{path}.{part}");
                let Some(value) = table.get(part) else {
                    if is_needed {
                        self.says(
                            &path,
                            format!(
                                "fault {number} has no `{part}`: a fault has what, value and at_s"
                            ),
                        );
                    }
                    return None;
                };
                let distribution = self.distribution(&name, &name, value)?.fractional();
                self.check_part(part, &name, &distribution);
                let line = self.lines.of_key(&name);
                factors.push(Factor {
                    name,
                    target: Target::Fault,
                    distribution,
                    line,
                });
                Some(factors.len() - 1)
            };
            let is_valued = table
                .get("what")
                .and_then(Value::as_str)
                .is_none_or(|it| Number::of(it) != Number::None);
            let (what, value, at_s) = (
                part("what", true),
                part("value", is_valued),
                part("at_s", true),
            );
            let (over_s, for_s) = (part("over_s", false), part("for_s", false));
            if !is_valued && value.is_some() {
                self.says(
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

    /// Refuses a part of a fault that is no parameter, value or time. Faults of messages and stages are tried when the
    /// first flight is.
    fn check_part(&mut self, part: &str, path: &str, distribution: &Distribution) {
        for end in distribution.ends() {
            match (part, &end) {
                ("what", Value::String(name)) if is_of_the_loop(name) => {}
                ("what", Value::String(name)) => {
                    if let Err(e) = Parameter::from_name(name) {
                        self.says(path, e.to_string());
                    }
                }
                ("what", _) => self.says(
                    path,
                    format!("{path} = {end}: expected the name of a parameter, or state.drop and the like"),
                ),
                ("value", Value::Float(_) | Value::String(_)) => {}
                ("value", _) => self.says(path, format!("{path} = {end}: expected a number, \"nominal\" or \"+30%\"")),
                (_, Value::Float(time)) if (0.0..=1e9).contains(time) => {}
                (_, _) => self.says(path, format!("{path} = {end}: expected a time from 0 s on, as in 4.0")),
            }
        }
    }

    fn arms(&mut self, given: &Table, order: &[String], factors: &[Factor]) -> Vec<Variant> {
        let section = self.section(given, "arms");
        let mut arms = Vec::new();
        for name in order {
            let path = format!("arms.{name}");
            // It is part of the names of files.
            if !is_name(name) {
                self.says(
                    &path,
                    format!("an arm is named by 1 to 64 letters, digits, - or _, and not `{name}`"),
                );
                continue;
            }
            let Some(mut keys) = section.get(name).and_then(Value::as_table).cloned() else {
                self.says(
                    &path,
                    format!("`{name}` must be a section: [arms.{name}], with keys of the settings"),
                );
                continue;
            };
            let timing = keys.remove(TIMING);
            let timing = timing
                .and_then(|value| self.recorded(&format!("{path}.{TIMING}"), &value, factors));
            let mut settings = Vec::new();
            for (section, key, value) in flat(&keys) {
                let full = format!("{section}.{key}");
                if key.is_empty() {
                    self.says(
                        &path,
                        format!("`{section}` is no key of the settings: write \"section.key\", as in \"inner.law\""),
                    );
                } else if factors.iter().any(|factor| factor.name == full) {
                    self.says(
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
        for (key, value) in given {
            let path = format!("success.{key}");
            let number = value
                .as_float()
                .or_else(|| value.as_integer().map(|whole| whole as f64));
            let place = METRICS.iter().position(|metric| metric.name == key);
            match (
                key.as_str(),
                place,
                number.filter(|number| *number >= 0.0 && number.is_finite()),
            ) {
                ("telemetry", ..) => gates.telemetry = self.signals(value),
                ("recovered_below_m", _, Some(bound_m)) => gates.recovered_below_m = bound_m,
                ("recovery_max_s", ..) if !has_fault => {
                    self.says(&path, "recovery_max_s is the time after a fault, and the campaign has no [[fault]] and no flight.faults");
                }
                (_, Some(place), Some(most)) => gates.limits.push((place, most)),
                ("recovered_below_m", ..) | (_, Some(_), None) => {
                    self.says(
                        &path,
                        format!("{path} = {value}: expected a number from 0 on, the most that counts as success"),
                    );
                }
                (_, None, _) => {
                    let known = METRICS
                        .iter()
                        .map(|metric| metric.name)
                        .chain(["recovered_below_m", "telemetry"]);
                    let hint = did_you_mean(nearest(key, known.clone()));
                    let known: Vec<&str> = known.collect();
                    self.says(
                        &path,
                        format!(
                            "unknown key `{key}` in [success], which has {}{hint}",
                            known.join(", ")
                        ),
                    );
                }
            }
        }
        gates.limits.sort_by_key(|(place, _)| *place);
        gates
    }

    fn signals(&mut self, value: &Value) -> Vec<SignalGate> {
        let Some(keys) = value.as_table() else {
            self.says(
                "success.telemetry",
                "`telemetry` must be a section: [success.telemetry]",
            );
            return Vec::new();
        };
        let mut gates = Vec::new();
        for (role, signal, value) in flat(keys) {
            let path = format!("success.telemetry.{role}");
            let role = messages::telemetry::LAW_ROLES
                .into_iter()
                .find(|known| known.name() == role);
            let range = self.range(&value).filter(|[low, high]| low <= high);
            match (role, signal.is_empty(), range) {
                (Some(role), false, Some(range)) => gates.push(SignalGate {
                    role,
                    signal,
                    range,
                }),
                _ => self.says(
                    &path,
                    "a number of a law is named by its role, with the range that it must stay in: \
                     \"inner.rotational_drag_nm_s\" = [0.0, 1.0]",
                ),
            }
        }
        gates
    }
}

/// Whether a name can be part of the name of a file.
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
                all.extend(
                    inner
                        .iter()
                        .map(|(key, value)| ((name.clone(), key.clone()), value.clone())),
                );
            }
            (Some((section, key)), value) => {
                all.insert((section.to_owned(), key.to_owned()), value.clone());
            }
            (None, value) => {
                all.insert((name.clone(), String::new()), value.clone());
            }
        }
    }
    all.into_iter()
        .map(|((section, key), value)| (section, key, value))
        .collect()
}

/// The ways to draw, by their keys.
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

/// What the factors so far take.
#[derive(Debug, Default)]
pub(super) struct Taken {
    pub flights: u64,
    dimensions: usize,
}

impl Reader {
    /// What a value of the file draws; none where it is a mistake, which is noted.
    pub(super) fn distribution(
        &mut self,
        path: &str,
        name: &str,
        value: &Value,
    ) -> Option<Distribution> {
        let Some(table) = value.as_table() else {
            return Some(Distribution::Fixed(value.clone()));
        };
        let kinds: Vec<&String> = table.keys().filter(|key| *key != "within").collect();
        let [kind] = kinds[..] else {
            self.says(
                path,
                format!("`{name}` is drawn in one way: one of {}", KINDS.join(", ")),
            );
            return None;
        };
        let argument = &table[kind.as_str()];
        let distribution = match kind.as_str() {
            "fixed" => Some(Distribution::Fixed(argument.clone())),
            "choice" => self.values(path, kind, argument).map(Distribution::Choice),
            "grid" => self
                .values(path, kind, argument)
                .map(|values| Distribution::Grid { values, stride: 1 }),
            "uniform" => self.proper(path, kind, argument).map(Distribution::Uniform),
            "loguniform" => self.proper(path, kind, argument).and_then(|range| {
                let is_positive = range[0] > 0.0;
                if !is_positive {
                    self.says(
                        path,
                        format!("loguniform = {argument}: both ends must be above 0"),
                    );
                }
                is_positive.then_some(Distribution::LogUniform(range))
            }),
            "latin" => {
                let flights = self.taken.flights;
                self.proper(path, kind, argument)
                    .map(|range| Distribution::Latin { range, flights })
            }
            "sobol" => self.sobol(path, kind, argument),
            "normal" => self.normal(path, argument, table.get("within")),
            unknown => {
                self.says(
                    path,
                    format!("`{unknown}` is no way to draw: one of {}", KINDS.join(", ")),
                );
                None
            }
        }?;
        if table.contains_key("within") && kind != "normal" {
            self.says(
                path,
                "`within` bounds a normal distribution; the others have their ends",
            );
        }
        if !distribution.is_likely() {
            self.says(
                path,
                "fewer than one draw in a hundred would be `within`: widen it, or move the mean",
            );
        }
        Some(distribution)
    }

    fn values(&mut self, path: &str, kind: &str, argument: &Value) -> Option<Vec<Value>> {
        let values: Vec<Value> = argument.as_array().into_iter().flatten().cloned().collect();
        let is_uniform = values.windows(2).all(|pair| pair[0].same_type(&pair[1]));
        // Whole and fractional numbers may be mixed: then all are fractional.
        let values: Vec<Value> = if is_uniform {
            values
        } else {
            values.into_iter().map(fractional).collect()
        };
        if values.is_empty() || !values.windows(2).all(|pair| pair[0].same_type(&pair[1])) {
            self.says(
                path,
                format!(
                    "{kind} = {argument}: expected a list of values of one kind, as in [0.4, 0.5]"
                ),
            );
            return None;
        }
        Some(values)
    }

    fn sobol(&mut self, path: &str, kind: &str, argument: &Value) -> Option<Distribution> {
        let range = self.proper(path, kind, argument)?;
        let dimension = self.taken.dimensions;
        self.taken.dimensions += 1;
        if dimension >= SOBOL_DIMENSIONS {
            self.says(
                path,
                format!(
                    "sobol draws {SOBOL_DIMENSIONS} factors at the most: draw this one as latin"
                ),
            );
        }
        if self.taken.flights > SOBOL_FLIGHTS {
            self.says(
                path,
                format!("sobol has {SOBOL_FLIGHTS} points: fly fewer flights"),
            );
        }
        Some(Distribution::Sobol { range, dimension })
    }

    fn normal(
        &mut self,
        path: &str,
        argument: &Value,
        within: Option<&Value>,
    ) -> Option<Distribution> {
        let Some([mean, deviation]) = self
            .range(argument)
            .filter(|[_, deviation]| *deviation > 0.0)
        else {
            self.says(
                path,
                format!(
                    "normal = {argument}: expected [mean, standard deviation], the second above 0"
                ),
            );
            return None;
        };
        let within = match within {
            Some(within) => Some(self.proper(path, "within", within)?),
            None => None,
        };
        Some(Distribution::Normal {
            mean,
            deviation,
            within,
        })
    }

    /// Two numbers, the second above the first.
    fn proper(&mut self, path: &str, kind: &str, argument: &Value) -> Option<[f64; 2]> {
        let range = self.range(argument);
        let proper = range.filter(|[low, high]| low < high);
        if proper.is_none() {
            let why = if range.is_some() {
                "the range is empty: expected"
            } else {
                "expected two numbers,"
            };
            self.says(
                path,
                format!("{kind} = {argument}: {why} [low, high] with low below high"),
            );
        }
        proper
    }

    pub(super) fn range(&self, value: &Value) -> Option<[f64; 2]> {
        let number = |value: &Value| {
            value
                .as_float()
                .or_else(|| value.as_integer().map(|whole| whole as f64))
        };
        let numbers: Option<Vec<f64>> = value.as_array()?.iter().map(number).collect();
        numbers?
            .try_into()
            .ok()
            .filter(|numbers: &[f64; 2]| numbers.iter().all(|number| number.is_finite()))
    }

    /// Sets the grids' strides: the last one changes with every flight.
    pub(super) fn grids(&mut self, factors: &mut [Factor]) {
        let mut cells: u64 = 1;
        for factor in factors.iter_mut().rev() {
            if let Distribution::Grid { values, stride } = &mut factor.distribution {
                *stride = cells;
                cells = cells.saturating_mul(values.len() as u64);
            }
        }
        if cells > self.taken.flights {
            let flights = self.taken.flights;
            self.says(
                "campaign.flights",
                format!(
                    "the grids have {cells} cells, and {flights} flights leave some of them out"
                ),
            );
        }
    }
}

/// Longest time limit: engines count minutes in 32 bits [s].
const TIME_LIMIT_MAX_S: f64 = 1e8;
/// Processors of a shard at the most.
const PROCESSORS_MAX: i64 = 4096;

impl Reader {
    /// The section `[submit]`.
    pub(super) fn submission(&mut self, given: &Table) -> Submission {
        let own = self.section(given, "submit");
        self.check_keys(
            "submit",
            &own,
            &["partition", "time_limit_s", "requeue", "processors"],
        );
        let is_name = |name: &&str| {
            let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.,".contains(c);
            !name.is_empty() && !name.starts_with('-') && name.chars().all(is_plain)
        };
        let partition = self.key(
            &own,
            "partition",
            "a partition's name, as in \"batch\"",
            |value| value.as_str().filter(is_name).map(str::to_owned),
        );
        let time_limit = self.key(
            &own,
            "time_limit_s",
            "a time from 60 to 1e8 s, as in 1800.0",
            |value| {
                let seconds = value
                    .as_float()
                    .or_else(|| value.as_integer().map(|whole| whole as f64))?;
                (60.0..=TIME_LIMIT_MAX_S)
                    .contains(&seconds)
                    .then(|| Duration::from_secs_f64(seconds))
            },
        );
        let requeue = self.key(&own, "requeue", "true or false", Value::as_bool);
        let processors = self.key(
            &own,
            "processors",
            "a whole number from 1 to 4096",
            |value| {
                value
                    .as_integer()
                    .filter(|number| (1..=PROCESSORS_MAX).contains(number))
                    .map(i64::cast_unsigned)
            },
        );
        Submission {
            partition,
            time_limit,
            requeue: requeue.unwrap_or(true),
            processors: processors.unwrap_or(1),
        }
    }

    /// A key of the section that may be missing.
    fn key<T>(
        &mut self,
        own: &Table,
        key: &str,
        expected: &str,
        read: impl Fn(&Value) -> Option<T>,
    ) -> Option<T> {
        let value = own.get(key)?;
        let read = read(value);
        if read.is_none() {
            let path = format!("submit.{key}");
            self.says(&path, format!("{path} = {value}: expected {expected}"));
        }
        read
    }
}

/// The key, which is none of the settings.
pub(super) const TIMING: &str = "timing";

impl Reader {
    /// The recorded flight of a key; none where it is a mistake, which is noted.
    pub(super) fn recorded(
        &mut self,
        path: &str,
        value: &Value,
        factors: &[Factor],
    ) -> Option<String> {
        if factors.iter().any(|factor| factor.target == Target::Timing) {
            self.says(
                path,
                format!("`timing` is drawn as a factor, so {path} cannot set it"),
            );
            return None;
        }
        let name = value.as_str().filter(|name| !name.is_empty());
        if name.is_none() {
            self.says(
                path,
                format!("{path} = {value}: expected {EXPECTED}, as in timing = \"runs/latest\""),
            );
        }
        name.map(str::to_owned)
    }

    /// The recorded flights that are drawn from.
    pub(super) fn drawn_timing(&mut self, value: &Value) -> Option<Factor> {
        let path = format!("factors.{TIMING}");
        let distribution = self.distribution(&path, TIMING, value)?;
        let is_name = |value: &Value| value.as_str().is_some_and(|name| !name.is_empty());
        if !distribution.ends().iter().all(is_name) {
            self.says(
                &path,
                format!("{TIMING} = {value}: expected for each choice {EXPECTED}"),
            );
            return None;
        }
        let line = self.lines.of_key(&path);
        Some(Factor {
            name: TIMING.into(),
            target: Target::Timing,
            distribution,
            line,
        })
    }
}

const EXPECTED: &str = "a recorded flight, its directory or its log";
