//! Room for the arrays of a flight, before it begins: the interpreter would end where none is left.

use std::collections::TryReserveError;
use std::fs;

use pyo3::exceptions::PyMemoryError;
use pyo3::prelude::*;

use crate::flight::Tables;

/// Copies of the number of a tick that a flight keeps beside its columns: rows, `tick` and `t`.
const BESIDE: u64 = 3;

pub(crate) fn reserve(tables: &mut Tables, ticks: u64) -> PyResult<()> {
    let numbers = tables.all().map(|table| table.numbers());
    let numbers = numbers.iter().sum::<u64>() + BESIDE;
    let needed = numbers.saturating_mul(8).saturating_mul(ticks);
    let refused = |available: &str| {
        PyMemoryError::new_err(format!(
            "{ticks} ticks take {needed} bytes, and {available}: fly shorter, or without arrays: `ironbird simulate \
             --states FILE` writes a row every recorder.states_every_ticks ticks"
        ))
    };
    if let Some(available) = available().filter(|available| *available < needed) {
        return Err(refused(&format!("{available} are available")));
    }
    let rows = usize::try_from(ticks).unwrap_or(usize::MAX);
    let mut tables = tables.all().into_iter();
    let reserved: Result<(), TryReserveError> = tables.try_for_each(|table| table.reserve(rows));
    reserved.map_err(|_| refused("this process may not have as many"))
}

/// Memory that can be had without swapping [bytes]; none where the system does not say.
fn available() -> Option<u64> {
    let said = fs::read_to_string("/proc/meminfo").ok()?;
    let mut lines = said.lines();
    let kib = lines.find_map(|line| line.strip_prefix("MemAvailable:")?.strip_suffix(" kB"))?;
    kib.trim().parse::<u64>().ok()?.checked_mul(1024)
}
