//! The rows of a campaign as columns with names, units and meanings.

use std::fmt;

use faults::ValueType;
use messages::parameters::Parameter;
use sha2::{Digest as _, Sha256};
use toml::Value;

use crate::campaign::{Campaign, Factor, Target, hex};
use crate::distribution::Distribution;
use crate::fault::value_type;
use crate::gates::{METRICS, Outcome};

#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    pub flight: u64,
    pub arm: usize,
    pub draws: Vec<Value>,
    pub outcome: Outcome,
}

pub const HOLDS: &str = "holds.";
pub const TELEMETRY: &str = "telemetry.";

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Number,
    Integer,
    /// Its cells are integers with the same bits.
    Unsigned,
    Flag,
    Text,
}

#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    Number(f64),
    Integer(i64),
    Flag(bool),
    Text(String),
}

pub type Cells = Vec<Option<Cell>>;

#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    pub name: String,
    pub unit: String,
    pub meaning: String,
    pub kind: Kind,
    pub optional: bool,
    pub cells: Cells,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    pub columns: Vec<Column>,
}

/// A row as text, by the names of its columns.
pub type TextRow = Vec<(String, String)>;

impl fmt::Display for Cell {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(number) => number.fmt(f),
            Self::Integer(integer) => integer.fmt(f),
            Self::Flag(flag) => flag.fmt(f),
            Self::Text(text) => text.fmt(f),
        }
    }
}

fn hash_into(hash: &mut Sha256, cell: &Option<Cell>) {
    hash.update([u8::from(cell.is_some())]);
    match cell {
        Some(Cell::Number(number)) => hash.update(number.to_bits().to_le_bytes()),
        Some(Cell::Integer(integer)) => hash.update(integer.to_le_bytes()),
        Some(Cell::Flag(flag)) => hash.update([u8::from(*flag)]),
        Some(Cell::Text(text)) => {
            hash.update((text.len() as u64).to_le_bytes());
            hash.update(text);
        }
        None => {}
    }
}

impl Table {
    pub fn new(campaign: &Campaign, rows: &[Row]) -> Self {
        use Kind::{Flag, Integer, Number, Text};
        let mut columns = Vec::new();
        // Adds a column whose cells may be empty if `optional`.
        let mut add = |name: &str,
                       (unit, meaning): (&'static str, &str),
                       kind: Kind,
                       optional: bool,
                       cell: &dyn Fn(&Row) -> Option<Cell>| {
            columns.push(Column {
                name: name.to_owned(),
                unit: unit.to_owned(),
                meaning: meaning.to_owned(),
                kind,
                optional,
                cells: rows.iter().map(cell).collect(),
            });
        };
        let number = ("", "number of the flight, from 0");
        add("flight", number, Integer, false, &|row| {
            Some(Cell::Integer(row.flight.cast_signed()))
        });
        add("arm", ("", "variant that flew it"), Text, false, &|row| {
            Some(Cell::Text(campaign.arms[row.arm].name.clone()))
        });
        for (i, factor) in campaign.factors.iter().enumerate() {
            let (unit, meaning) = unit_and_meaning(campaign, factor);
            let kind = match factor.distribution.ends().first() {
                Some(Value::Float(_)) => Number,
                Some(Value::Integer(_)) => Integer,
                _ => Text,
            };
            add(&factor.name, (unit, &meaning), kind, false, &|row| {
                let draw = &row.draws[i];
                match kind {
                    Number => draw.as_float().map(Cell::Number),
                    Integer => draw.as_integer().map(Cell::Integer),
                    _ => Some(Cell::Text(text(draw))),
                }
            });
        }
        let success = "flown to its end within its envelope, and every gate held";
        add("success", ("", success), Flag, false, &|row| {
            Some(Cell::Flag(campaign.gates.is_success(&row.outcome)))
        });
        let lost = "why the flight counts as lost";
        add("lost", ("", lost), Text, true, &|row| {
            row.outcome.lost.clone().map(Cell::Text)
        });
        for (i, metric) in METRICS.iter().enumerate() {
            let meaning = (metric.unit, metric.meaning);
            add(metric.name, meaning, Number, true, &|row| {
                row.outcome.metrics[i].map(Cell::Number)
            });
        }
        for (i, gate) in campaign.gates.names().enumerate() {
            let meaning = format!("whether the gate {gate} held");
            let name = format!("{HOLDS}{gate}");
            add(&name, ("", &meaning), Flag, true, &|row| {
                campaign.gates.held(&row.outcome)[i].map(Cell::Flag)
            });
        }
        for (i, gate) in campaign.gates.telemetry.iter().enumerate() {
            for (end, suffix) in ["min", "max"].into_iter().enumerate() {
                let which = ["smallest", "largest"][end];
                let name = format!("{TELEMETRY}{}.{suffix}", gate.name());
                let meaning = format!("{which} value of the {} law's signal", gate.role);
                add(&name, ("", &meaning), Number, true, &|row| {
                    let range = row.outcome.telemetry[i].filter(|[low, high]| low <= high);
                    range.map(|range| Cell::Number(range[end]))
                });
            }
        }
        let outputs = "hash over all outputs, as `ironbird simulate` prints it";
        add("outputs", ("", outputs), Text, false, &|row| {
            Some(Cell::Text(row.outcome.outputs.clone()))
        });
        Self { columns }
    }

    pub fn rows(&self) -> usize {
        self.columns.first().map_or(0, |column| column.cells.len())
    }

    pub fn append(&mut self, more: Self) {
        for (column, more) in self.columns.iter_mut().zip(more.columns) {
            column.cells.extend(more.cells);
        }
    }

    /// A row as text; a cell without a value is empty.
    pub fn text_row(&self, row: usize) -> TextRow {
        let text = |column: &Column| {
            let cell = column.cells[row].as_ref();
            let text = cell.map_or_else(String::new, ToString::to_string);
            (column.name.clone(), text)
        };
        self.columns.iter().map(text).collect()
    }

    /// SHA-256 over the names of the columns and every bit of every cell, whatever file they are in.
    pub fn rows_sha256(&self) -> String {
        let mut hash = Sha256::new();
        for column in &self.columns {
            hash.update(&column.name);
            let cells = column.cells.iter();
            cells.for_each(|cell| hash_into(&mut hash, cell));
        }
        hex(hash)
    }
}

fn text(value: &Value) -> String {
    let text = value.as_str();
    text.map_or_else(|| value.to_string(), str::to_owned)
}

pub(crate) fn unit_and_meaning(campaign: &Campaign, factor: &Factor) -> (&'static str, String) {
    let of_parameter = |name: &str| Parameter::from_name(name).ok().map(Parameter::spec);
    match &factor.target {
        Target::Setting { section, key } => match of_parameter(key) {
            Some(spec) if section == "plant" || section == "model" => {
                (spec.unit, spec.meaning.to_owned())
            }
            _ => ("", format!("{key} of [{section}]")),
        },
        Target::Fault => of_fault(campaign, &factor.name),
        Target::Timing => ("", "recorded flight whose timing the flight has".into()),
    }
}

fn of_fault(campaign: &Campaign, name: &str) -> (&'static str, String) {
    let part = name.rsplit('.').next().unwrap_or_default();
    let place = campaign.factors.iter().position(|it| it.name == name);
    let fault = campaign.faults.iter().find(|fault| place == fault.value);
    let what = fault.map(|fault| &campaign.factors[fault.what].distribution);
    match (part, what) {
        ("what", _) => ("", "kind of the fault".into()),
        ("value", Some(Distribution::Fixed(Value::String(name)))) => {
            let unit = match value_type(name) {
                ValueType::Integer { .. } => "ticks",
                ValueType::Time | ValueType::TimeRange => "s",
                _ => Parameter::from_name(name).map_or("", |it| it.spec().unit),
            };
            (unit, format!("value of {name}"))
        }
        ("value", _) => ("", "value of the fault".into()),
        ("at_s", _) => ("s", "when the fault begins".into()),
        ("for_s", _) => ("s", "how long the fault lasts".into()),
        _ => ("s", "how long the fault takes".into()),
    }
}
