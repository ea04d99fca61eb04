//! `ironbird._rig`: the rig as a module of Python. `python/package/ironbird/__init__.py` is what users import.

#![warn(missing_docs)]

mod campaign_rows;
mod errors;
mod flight;
mod py_laws;
mod read;
mod settings;
mod simulate;
mod table;
mod timing;

use pyo3::prelude::*;

/// The rig.
#[pymodule]
mod _rig {
    #[pymodule_export]
    use python_law::{Desired, Given, Measured, Reference, Rig};

    #[allow(non_upper_case_globals, reason = "Python's name for it")]
    #[pymodule_export]
    const __version__: &str = env!("CARGO_PKG_VERSION");
    #[pymodule_export]
    use crate::campaign_rows::read_rows;
    #[pymodule_export]
    use crate::errors::{LogError, SettingsError};
    #[pymodule_export]
    use crate::read::read;
    #[pymodule_export]
    use crate::simulate::simulate;
}
