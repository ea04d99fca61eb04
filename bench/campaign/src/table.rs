//! The rows of a campaign as columns with names, units and meanings.

use messages::parameters::Parameter;
use sha2::{Digest as _, Sha256};
use toml::Value;

use crate::campaign::{Campaign, Factor, Target};
use crate::distribution::Distribution;
use crate::fault::Number;
use crate::gates::METRICS;
use crate::outcome::Outcome;

#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    pub flight: u64,
    pub arm: usize,
    /// What it drew, in the order of the factors.
    pub draws: Vec<Value>,
    pub outcome: Outcome,
}

/// Prefix of the columns that say which gates held.
pub const HOLDS: &str = "holds.";
/// Prefix of the columns with what laws showed.
pub const TELEMETRY: &str = "telemetry.";

/// The cells of a column, one for each row; `None` where the row has no value.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    Numbers(Vec<Option<f64>>),
    Integers(Vec<Option<i64>>),
    Flags(Vec<Option<bool>>),
    Texts(Vec<Option<String>>),
}

#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    pub name: String,
    pub unit: &'static str,
    pub meaning: String,
    /// Rows may have no value.
    pub optional: bool,
    pub values: Values,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    pub columns: Vec<Column>,
}

/// A row as text, by the names of its columns.
pub type Cells = Vec<(String, String)>;

impl Values {
    pub fn len(&self) -> usize {
        match self {
            Self::Numbers(values) => values.len(),
            Self::Integers(values) => values.len(),
            Self::Flags(values) => values.len(),
            Self::Texts(values) => values.len(),
        }
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Whether each row has a value.
    pub fn filled(&self) -> Vec<bool> {
        match self {
            Self::Numbers(values) => values.iter().map(Option::is_some).collect(),
            Self::Integers(values) => values.iter().map(Option::is_some).collect(),
            Self::Flags(values) => values.iter().map(Option::is_some).collect(),
            Self::Texts(values) => values.iter().map(Option::is_some).collect(),
        }
    }

    fn append(&mut self, more: Self) {
        match (self, more) {
            (Self::Numbers(values), Self::Numbers(more)) => values.extend(more),
            (Self::Integers(values), Self::Integers(more)) => values.extend(more),
            (Self::Flags(values), Self::Flags(more)) => values.extend(more),
            (Self::Texts(values), Self::Texts(more)) => values.extend(more),
            _ => {}
        }
    }

    /// The cell of a row as text; empty where there is no value.
    fn cell(&self, row: usize) -> String {
        fn text(value: &Option<impl ToString>) -> String {
            value.as_ref().map_or_else(String::new, ToString::to_string)
        }
        match self {
            Self::Numbers(values) => text(&values[row]),
            Self::Integers(values) => text(&values[row]),
            Self::Flags(values) => text(&values[row]),
            Self::Texts(values) => text(&values[row]),
        }
    }

    /// Adds every bit of every cell to a hash.
    fn hash_into(&self, hash: &mut Sha256) {
        fn each<T>(hash: &mut Sha256, values: &[Option<T>], add: impl Fn(&mut Sha256, &T)) {
            for value in values {
                hash.update([u8::from(value.is_some())]);
                if let Some(value) = value {
                    add(hash, value);
                }
            }
        }
        match self {
            Self::Numbers(values) => each(hash, values, |hash, value| {
                hash.update(value.to_bits().to_le_bytes());
            }),
            Self::Integers(values) => {
                each(hash, values, |hash, value| hash.update(value.to_le_bytes()));
            }
            Self::Flags(values) => {
                each(hash, values, |hash, value| hash.update([u8::from(*value)]));
            }
            Self::Texts(values) => each(hash, values, |hash, value| {
                hash.update((value.len() as u64).to_le_bytes());
                hash.update(value);
            }),
        }
    }
}

impl Table {
    pub fn new(campaign: &Campaign, rows: &[Row]) -> Self {
        let number =
            |value: &dyn Fn(&Row) -> Option<f64>| Values::Numbers(rows.iter().map(value).collect());
        let text = |value: &dyn Fn(&Row) -> Option<String>| {
            Values::Texts(rows.iter().map(value).collect())
        };
        let mut columns = vec![
            column(
                "flight",
                "",
                "number of the flight, from 0",
                Values::Integers(
                    rows.iter()
                        .map(|row| Some(row.flight.cast_signed()))
                        .collect(),
                ),
            ),
            column(
                "arm",
                "",
                "what flew it",
                text(&|row| Some(campaign.arms[row.arm].name.clone())),
            ),
        ];
        for (i, factor) in campaign.factors.iter().enumerate() {
            let (unit, meaning) = unit_and_meaning(campaign, factor);
            let values = match factor.distribution.ends().first() {
                Some(Value::Float(_)) => number(&|row| row.draws[i].as_float()),
                Some(Value::Integer(_)) => {
                    Values::Integers(rows.iter().map(|row| row.draws[i].as_integer()).collect())
                }
                _ => text(&|row| Some(shown(&row.draws[i]))),
            };
            columns.push(column(&factor.name, unit, &meaning, values));
        }
        columns.push(column(
            "success",
            "",
            "flown to its end within its envelope, and every gate held",
            Values::Flags(
                rows.iter()
                    .map(|row| Some(campaign.gates.is_success(&row.outcome)))
                    .collect(),
            ),
        ));
        columns.push(
            column(
                "lost",
                "",
                "why the flight counts as lost",
                text(&|row| row.outcome.lost.clone()),
            )
            .optional(),
        );
        for (i, metric) in METRICS.iter().enumerate() {
            let values = number(&|row| row.outcome.metrics[i]);
            columns.push(column(metric.name, metric.unit, metric.meaning, values).optional());
        }
        let held: Vec<Vec<Option<bool>>> = rows
            .iter()
            .map(|row| campaign.gates.held(&row.outcome))
            .collect();
        for (i, name) in campaign.gates.names().enumerate() {
            let meaning = format!("whether the gate {name} held");
            let values = Values::Flags(held.iter().map(|held| held[i]).collect());
            columns.push(column(&format!("{HOLDS}{name}"), "", &meaning, values).optional());
        }
        for (i, gate) in campaign.gates.telemetry.iter().enumerate() {
            for (end, (suffix, which)) in [("min", "smallest"), ("max", "largest")]
                .into_iter()
                .enumerate()
            {
                let name = format!("{TELEMETRY}{}.{suffix}", gate.name());
                let meaning = format!("{which} that the {} law showed of it", gate.role);
                let values =
                    number(&|row| row.outcome.telemetry[i].range().map(|range| range[end]));
                columns.push(column(&name, "", &meaning, values).optional());
            }
        }
        columns.push(column(
            "outputs",
            "",
            "hash over all outputs, as `ironbird simulate` prints it",
            text(&|row| Some(row.outcome.outputs.clone())),
        ));
        Self { columns }
    }

    pub fn rows(&self) -> usize {
        self.columns.first().map_or(0, |column| column.values.len())
    }

    /// Adds the rows of a table of the same campaign.
    pub fn append(&mut self, more: Self) {
        for (column, more) in self.columns.iter_mut().zip(more.columns) {
            column.values.append(more.values);
        }
    }

    /// The cells of a row as text.
    pub fn cells(&self, row: usize) -> Cells {
        self.columns
            .iter()
            .map(|column| (column.name.clone(), column.values.cell(row)))
            .collect()
    }

    /// SHA-256 over the names of the columns and every bit of every cell, whatever file they are in.
    pub fn rows_sha256(&self) -> String {
        let mut hash = Sha256::new();
        for column in &self.columns {
            hash.update(&column.name);
            column.values.hash_into(&mut hash);
        }
        hex(&hash)
    }
}

/// The digest of a hash in hexadecimal digits.
pub fn hex(hash: &Sha256) -> String {
    hash.clone()
        .finalize()
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

impl Column {
    fn optional(self) -> Self {
        Self {
            optional: true,
            ..self
        }
    }
}

fn column(name: &str, unit: &'static str, meaning: &str, values: Values) -> Column {
    Column {
        name: name.to_owned(),
        unit,
        meaning: meaning.to_owned(),
        optional: false,
        values,
    }
}

/// A value as a cell of text.
fn shown(value: &Value) -> String {
    value
        .as_str()
        .map_or_else(|| value.to_string(), str::to_owned)
}

/// Unit and meaning of the column of a factor.
pub(crate) fn unit_and_meaning(campaign: &Campaign, factor: &Factor) -> (&'static str, String) {
    let of_parameter = |name: &str| Parameter::from_name(name).ok().map(Parameter::spec);
    match &factor.target {
        Target::Setting { section, key } => {
            match of_parameter(key).filter(|_| section == "plant" || section == "model") {
                Some(spec) => (spec.unit, spec.meaning.to_owned()),
                None => ("", format!("{key} of [{section}]")),
            }
        }
        Target::Fault => of_fault(campaign, &factor.name),
        Target::Timing => ("", "recorded flight whose timing the flight has".into()),
    }
}

/// Unit and meaning of a fault's part.
fn of_fault(campaign: &Campaign, name: &str) -> (&'static str, String) {
    let part = name.rsplit('.').next().unwrap_or_default();
    let place = campaign
        .factors
        .iter()
        .position(|factor| factor.name == name);
    let fault = campaign.faults.iter().find(|fault| place == fault.value);
    let what = fault.map(|fault| &campaign.factors[fault.what].distribution);
    match (part, what) {
        ("what", _) => ("", "what goes wrong".into()),
        ("value", Some(Distribution::Fixed(Value::String(name)))) => {
            let of_parameter =
                || Parameter::from_name(name).map_or("", |parameter| parameter.spec().unit);
            (
                Number::of(name).unit().unwrap_or_else(of_parameter),
                format!("value of {name}"),
            )
        }
        ("value", _) => ("", "value of the fault".into()),
        ("at_s", _) => ("s", "when the fault strikes".into()),
        ("for_s", _) => ("s", "how long the fault lasts".into()),
        _ => ("s", "how long the fault takes".into()),
    }
}
