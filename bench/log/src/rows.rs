//! Messages as rows of a table, driven by their layouts. A column has the name, the unit and the place of one number.
//!
//! Numbers are written so that every bit can be read back. What a law shows has rows of its own
//! ([`crate::telemetry`]).

use std::fmt;

use messages::content::{NO_TICK, RotorSpeeds, Setpoint, State, Wrench};
use messages::fields::Faulty as _;
use messages::header::{Header, Message};
use messages::layout::{self, Field, Kind, Layout as _, Visit, Visitor};
use messages::monitor::{CAUSES, Cause};
use messages::parameters::{ESTIMATED, PARAMETERS, SPECS};
use messages::role::STAGES;
use messages::topic::Topic;

use crate::codec::{Logged, is_telemetry};
use crate::units;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Column {
    /// With the path of its field, as in `measured.position_w_m.x` and `truth.mass_kg`.
    pub name: String,
    /// Empty for a ratio, a count or a flag.
    pub unit: String,
    pub is_number: bool,
}

impl Column {
    /// A column of floating-point numbers.
    pub fn number(name: impl Into<String>, unit: &str) -> Self {
        Self {
            name: name.into(),
            unit: unit.to_owned(),
            is_number: true,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cell {
    /// Of a tick that stands for none, or of a message that was not published.
    Missing,
    Integer(u64),
    Number(f64),
}

impl Cell {
    /// A number of a table that has no other kind.
    pub const fn number(self) -> f64 {
        match self {
            Self::Missing => f64::NAN,
            Self::Integer(integer) => integer as f64,
            Self::Number(number) => number,
        }
    }
}

/// As in CSV.
impl fmt::Display for Cell {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Missing => Ok(()),
            Self::Integer(integer) => integer.fmt(f),
            Self::Number(number) => write!(f, "{number:?}"),
        }
    }
}

/// The columns of a topic's messages: content, then envelope.
pub fn columns<C: Logged>() -> Vec<Column> {
    let mut columns = content_columns::<C>();
    name_columns("envelope.", Header::FIELDS, &mut columns);
    columns
}

pub fn content_columns<C: Visit>() -> Vec<Column> {
    let mut columns = Vec::new();
    name_columns("", C::FIELDS, &mut columns);
    columns
}

fn name_columns(path: &str, fields: &[Field], columns: &mut Vec<Column>) {
    for field in fields.iter().filter(|field| !is_telemetry(field)) {
        let axes = axes(field);
        let names = axes.iter().map(|axis| match is_parameters(field) {
            true => format!("{path}{axis}"),
            false => format!("{path}{}.{axis}", field.name),
        });
        let names: Vec<_> = match field.length {
            None => vec![format!("{path}{}", field.name)],
            Some(_) => names.collect(),
        };
        for (place, name) in names.into_iter().enumerate() {
            match field.kind {
                Kind::Struct { fields, .. } => name_columns(&format!("{name}."), fields, columns),
                kind => columns.push(Column {
                    name,
                    unit: match is_parameters(field) {
                        true => SPECS[place].unit.to_owned(),
                        false => units::of(field),
                    },
                    is_number: kind == Kind::F64,
                }),
            }
        }
    }
}

/// Whether a field has a value of each parameter of the airframe.
pub fn is_parameters(field: &Field) -> bool {
    (field.name, field.kind, field.length) == ("parameter", Kind::F64, Some(PARAMETERS))
}

/// Names of the numbers of an array, as they are declared; numbers from 1 where none are. Empty for a single number.
pub fn axes(field: &Field) -> Vec<String> {
    let fields = [
        State::FAULT_FIELDS,
        Setpoint::FAULT_FIELDS,
        Wrench::FAULT_FIELDS,
        RotorSpeeds::FAULT_FIELDS,
    ];
    let declared = fields
        .into_iter()
        .flatten()
        .find(|it| it.name == field.name);
    let length = field.length.unwrap_or(0);
    let axes: Vec<&str> = match field.name {
        "input_tick" => vec![State::NAME, Setpoint::NAME, Wrench::NAME],
        "stamps" => STAGES.map(|role| role.name()).to_vec(),
        _ if is_parameters(field) => SPECS.iter().map(|spec| spec.name).collect(),
        _ if length == CAUSES => Cause::ALL.map(Cause::name).to_vec(),
        "estimate_error" | "estimate_error_start" | "estimate_error_bound" | "identifiability" => {
            ESTIMATED.map(|it| it.spec().name).to_vec()
        }
        name => match declared {
            Some(declared) => declared.axes.to_vec(),
            // A vector that no law reads, as the reference's acceleration.
            None if name.contains("_w_") || name.contains("_b_") => fields[0][0].axes.to_vec(),
            None => Vec::new(),
        },
    };
    if axes.len() == length {
        return axes.into_iter().map(str::to_owned).collect();
    }
    (1..=length).map(|number| number.to_string()).collect()
}

/// The words of a content in the order of its columns: whole numbers, and the bits of the others.
pub fn words<L: Visit>(content: &L) -> Vec<u64> {
    const WORD: usize = size_of::<u64>();
    let (all, mut words) = (layout::words(content), Vec::new());
    for field in L::FIELDS.iter().filter(|field| !is_telemetry(field)) {
        words.extend(&all[field.offset / WORD..][..field.size / WORD]);
    }
    words
}

/// Name and value of each number of a content, the value in words.
pub fn named<C: Logged>(content: &C) -> Vec<(String, String)> {
    let names = content_columns::<C>().into_iter().map(|column| column.name);
    let values = content_cells(content).into_iter().map(|cell| match cell {
        Cell::Missing => "none".into(),
        cell => cell.to_string(),
    });
    names.zip(values).collect()
}

/// The cells of a message, in the order of [`columns`].
pub fn cells<C: Logged>(message: &Message<C>) -> Vec<Cell> {
    let mut row = Row(content_cells(&message.content));
    message.envelope.visit(&mut row);
    row.0
}

pub fn content_cells<C: Visit>(content: &C) -> Vec<Cell> {
    let mut row = Row(Vec::new());
    content.visit(&mut row);
    row.0
}

struct Row(Vec<Cell>);

impl Visitor for Row {
    fn integers(&mut self, _: &'static Field, values: &[u64]) {
        self.0.extend(values.iter().map(|value| match *value {
            NO_TICK => Cell::Missing,
            value => Cell::Integer(value),
        }));
    }

    fn numbers(&mut self, _: &'static Field, values: &[f64]) {
        self.0.extend(values.iter().copied().map(Cell::Number));
    }

    fn structs<L: Visit>(&mut self, field: &'static Field, values: &[L]) {
        if !is_telemetry(field) {
            values.iter().for_each(|value| value.visit(self));
        }
    }
}
