//! The messages of a topic by tick, and topics joined: a tick without a message is a row that holds no numbers.

use std::collections::{BTreeSet, TryReserveError};

use flight_log::codec::Logged;

use crate::columns::{Column, Columns, Signals};

#[derive(Debug)]
pub(crate) struct Table {
    ticks: Vec<u64>,
    columns: Columns,
}

impl Table {
    pub(crate) fn of<C: Logged>(signals: &Option<Signals>) -> Self {
        Self {
            ticks: Vec::new(),
            columns: Columns::of::<C>(signals),
        }
    }

    /// Of columns that are filled row by row.
    pub(crate) fn of_columns(columns: Vec<Column>) -> Self {
        Self {
            ticks: Vec::new(),
            columns: Columns::from(columns),
        }
    }

    pub(crate) fn push_row(&mut self, tick: u64, row: impl Iterator<Item = f64>) {
        self.ticks.push(tick);
        self.columns.push_row(row);
    }

    pub(crate) fn push<C: Logged>(&mut self, tick: u64, content: &C) {
        self.ticks.push(tick);
        self.columns.push(content);
    }

    /// How many numbers a row has, with that of its tick.
    pub(crate) fn numbers(&self) -> u64 {
        1 + self.columns.numbers()
    }

    pub(crate) fn reserve(&mut self, rows: usize) -> Result<(), TryReserveError> {
        self.ticks.try_reserve_exact(rows)?;
        self.columns.reserve(rows)
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.ticks.is_empty()
    }

    /// Its columns, with a row for each of these ticks.
    pub(crate) fn on(self, rows: &[u64]) -> Vec<Column> {
        let columns = self.columns.into_columns();
        if self.ticks == rows {
            return columns;
        }
        let place = |tick| rows.binary_search(tick).ok();
        let places: Vec<Option<usize>> = self.ticks.iter().map(place).collect();
        let spread = |column| spread(column, &places, rows.len());
        columns.into_iter().map(spread).collect()
    }
}

/// Every tick of some tables, once and in order.
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
    let width = column.width.unwrap_or(1);
    let mut values = vec![f64::NAN; rows * width];
    for (row, place) in column.values.chunks(width).zip(places) {
        if let Some(place) = place {
            values[place * width..][..width].copy_from_slice(row);
        }
    }
    Column { values, ..column }
}
