//! The messages of a topic as a table: a column for each field, a row for each message, by tick; and topics joined: a
//! tick without a message is a row that holds no numbers.

use std::collections::{BTreeSet, TryReserveError};
use std::iter::repeat_n;

use flight_log::codec::Logged;
use flight_log::rows::{axes, is_parameters};
use flight_log::units;
use messages::content::Reference;
use messages::layout::{Field, Kind, Layout as _, Visit, Visitor};
use messages::parameters::{SPECS, Spec};
use pyo3::prelude::*;

#[derive(Debug)]
pub(crate) struct Column {
    /// The group that it is shown in, as `state` or `telemetry.inner`.
    pub group: String,
    pub name: String,
    pub unit: String,
    /// Names of the numbers of a row, where it is an array.
    pub axes: Vec<String>,
    pub values: Vec<f64>,
}

#[derive(Debug, Default)]
pub(crate) struct Table {
    ticks: Vec<u64>,
    columns: Vec<Column>,
    /// The column of each number of a message, in the order of the layout; none where it is left out.
    places: Vec<Option<usize>>,
    next: usize,
}

pub(crate) type Signals = Vec<(String, String)>;

impl Table {
    /// That of a topic whose law shows these signals; one column for all of them where their names are not known.
    pub(crate) fn of<C: Logged>(signals: &Option<Signals>) -> Self {
        let mut table = Self::default();
        let telemetry = format!("telemetry.{}", C::SENDER);
        table.plan(C::FIELDS, C::NAME, &telemetry, signals);
        table
    }

    pub(crate) fn of_reference() -> Self {
        let mut table = Self::default();
        table.plan(Reference::FIELDS, "reference", "", &None);
        table
    }

    /// Columns for these fields of a message; the signals of a law in the group `telemetry`.
    fn plan(&mut self, fields: &[Field], group: &str, telemetry: &str, signals: &Option<Signals>) {
        for field in fields {
            let numbers = field.size / size_of::<u64>();
            let begin = self.columns.len();
            // The names and units of numbers that have a column each; the others are left out.
            let apart = match (field.name, field.kind, signals) {
                ("value", _, Some(signals)) if group == telemetry => signals.clone(),
                _ if is_parameters(field) => {
                    let spec = |spec: &Spec| (spec.name.to_owned(), spec.unit.to_owned());
                    SPECS.iter().map(spec).collect()
                }
                // The plant's records for the replay, which a simulation does not have, and what has a table of its own.
                ("decision" | "target" | "reference", Kind::Struct { .. }, _) => Signals::new(),
                (name, Kind::Struct { fields, .. }, _) => {
                    let group = match name {
                        "truth" => name,
                        "telemetry" => telemetry,
                        _ => group,
                    };
                    self.plan(fields, group, telemetry, signals);
                    continue;
                }
                (name, ..) => {
                    self.places.extend(repeat_n(Some(begin), numbers));
                    self.column(group, name.to_owned(), units::of(field), axes(field));
                    continue;
                }
            };
            let place = |number| (number < apart.len()).then_some(begin + number);
            self.places.extend((0..numbers).map(place));
            for (name, unit) in apart {
                self.column(group, name, unit, Vec::new());
            }
        }
    }

    fn column(&mut self, group: &str, name: String, unit: String, axes: Vec<String>) {
        self.columns.push(Column {
            group: group.to_owned(),
            name,
            unit,
            axes,
            values: Vec::new(),
        });
    }

    /// Of columns that are filled row by row.
    pub(crate) fn of_columns(columns: Vec<Column>) -> Self {
        Self {
            columns,
            ..Self::default()
        }
    }

    pub(crate) fn push_row(&mut self, tick: u64, row: impl Iterator<Item = f64>) {
        self.ticks.push(tick);
        for (column, value) in self.columns.iter_mut().zip(row) {
            column.values.push(value);
        }
    }

    pub(crate) fn push<C: Visit>(&mut self, tick: u64, content: &C) {
        self.ticks.push(tick);
        self.next = 0;
        content.visit(self);
    }

    /// How many numbers a row has, with that of its tick.
    pub(crate) fn numbers(&self) -> u64 {
        let widths = self.columns.iter().map(Column::width);
        1 + widths.sum::<usize>() as u64
    }

    pub(crate) fn reserve(&mut self, rows: usize) -> Result<(), TryReserveError> {
        self.ticks.try_reserve_exact(rows)?;
        self.columns.iter_mut().try_for_each(|column| {
            let numbers = rows.saturating_mul(column.width());
            column.values.try_reserve_exact(numbers)
        })
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.ticks.is_empty()
    }

    pub(crate) fn on(self, rows: &[u64]) -> Vec<Column> {
        if self.ticks == rows {
            return self.columns;
        }
        let place = |tick| rows.binary_search(tick).ok();
        let places: Vec<Option<usize>> = self.ticks.iter().map(place).collect();
        let spread = |column| spread(column, &places, rows.len());
        self.columns.into_iter().map(spread).collect()
    }

    fn take(&mut self, values: impl ExactSizeIterator<Item = f64>) {
        let places = &self.places[self.next..];
        self.next += values.len();
        for (place, value) in places.iter().zip(values) {
            if let Some(column) = *place {
                self.columns[column].values.push(value);
            }
        }
    }
}

impl Visitor for Table {
    fn integers(&mut self, _: &'static Field, values: &[u64]) {
        // Of the counts and ticks in messages, the largest one stands for none.
        self.take(values.iter().map(|value| match *value {
            u64::MAX => f64::NAN,
            value => value as f64,
        }));
    }

    fn numbers(&mut self, _: &'static Field, values: &[f64]) {
        self.take(values.iter().copied());
    }
}

/// A column as Python has it: group, name, unit, names of an array's numbers, array.
pub(crate) type ShownColumn<'py> = (String, String, String, Vec<String>, Bound<'py, PyAny>);

impl Column {
    /// How many numbers a row has.
    fn width(&self) -> usize {
        self.axes.len().max(1)
    }

    pub(crate) fn shown<'py>(self, py: Python<'py>) -> PyResult<ShownColumn<'py>> {
        let flat = python_law::array(py, &self.values)?;
        let array = match self.axes.len() {
            0 => flat,
            width => flat.call_method1("reshape", (-1, width))?,
        };
        Ok((self.group, self.name, self.unit, self.axes, array))
    }
}

pub(crate) fn rows(tables: &[Table]) -> Vec<u64> {
    let [first, others @ ..] = tables else {
        return Vec::new();
    };
    let rises = first.ticks.is_sorted_by(|a, b| a < b);
    if rises && others.iter().all(|table| table.ticks == first.ticks) {
        return first.ticks.clone();
    }
    let ticks = tables.iter().flat_map(|table| &table.ticks);
    let ticks: BTreeSet<u64> = ticks.copied().collect();
    ticks.into_iter().collect()
}

/// A column whose rows stand at places among more rows.
fn spread(column: Column, places: &[Option<usize>], rows: usize) -> Column {
    let width = column.width();
    let mut values = vec![f64::NAN; rows * width];
    for (row, place) in column.values.chunks(width).zip(places) {
        if let Some(place) = place {
            values[place * width..][..width].copy_from_slice(row);
        }
    }
    Column { values, ..column }
}
