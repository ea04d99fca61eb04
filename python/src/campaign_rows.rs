//! A file of a campaign's rows, which needs no other package to be read.

use std::path::PathBuf;

use campaign::parquet_file::read_columns;
use campaign::table::Cell;
use pyo3::IntoPyObjectExt as _;
use pyo3::prelude::*;

use crate::errors::log_error;

type ShownCells<'py> = Vec<Option<Bound<'py, PyAny>>>;

/// Name and values of each column; None where there is no value.
#[pyfunction]
pub(crate) fn read_rows(py: Python<'_>, path: PathBuf) -> PyResult<Vec<(String, ShownCells<'_>)>> {
    let columns = py.detach(|| read_columns(&path)).map_err(log_error)?;
    let shown = |cell: Cell| match cell {
        Cell::Number(number) => number.into_bound_py_any(py),
        Cell::Integer(integer) => integer.into_bound_py_any(py),
        Cell::Flag(flag) => flag.into_bound_py_any(py),
        Cell::Text(text) => text.into_bound_py_any(py),
    };
    let column = |(name, cells): (String, Vec<Option<Cell>>)| {
        let cells = cells.into_iter().map(|cell| cell.map(shown).transpose());
        Ok((name, cells.collect::<PyResult<_>>()?))
    };
    columns.into_iter().map(column).collect()
}
