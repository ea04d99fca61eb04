//! Laws in Python: a function, an object, a class, or a file of one.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use config::check_foreign_law;
use config::law_settings::{LAW, SHA256, check_same};
use control_api::law::Rig;
use messages::role::Role;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use python_law::{Looked, PythonLaw, is_refusal, load};

use crate::errors::{SettingsError, settings_error};
use crate::flight::FlownLaw;
use crate::settings::table;

#[derive(Debug)]
pub(crate) struct PyLaw<'py> {
    looked: Looked,
    settings: Bound<'py, PyDict>,
    /// Its section of the settings, as a flight has it.
    pub section: Bound<'py, PyDict>,
}

/// The file of a law, whose code has run.
struct File {
    named: String,
    /// Absolute, without links.
    path: PathBuf,
    sha256: String,
}

impl<'py> PyLaw<'py> {
    /// The law of a role: the one that is given, or that of the file that arguments or else settings name. Its
    /// section goes out of the settings and its name out of the arguments, whose law it is not.
    pub(crate) fn of(
        role: Role,
        settings: &Bound<'py, PyDict>,
        arguments: &Bound<'py, PyDict>,
        law: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Option<Self>> {
        let (py, key) = (settings.py(), format!("{role}.{LAW}"));
        let refused = |raised| as_settings_error(py, raised);
        let section = match settings.get_item(role.name())? {
            Some(section) => section.cast_into::<PyDict>()?.copy()?,
            None => PyDict::new(py),
        };
        let text =
            |value: Option<Bound<'_, PyAny>>| value.and_then(|text| text.extract::<String>().ok());
        let named = text(section.get_item(LAW)?);
        let asked = text(arguments.get_item(&key)?);
        let asked = asked.as_ref().or(named.as_ref());
        let (law, file) = match (law, asked.filter(|name| name.ends_with(".py"))) {
            (Some(law), _) => (law.clone(), None),
            (None, Some(name)) => {
                let (law, sha256) = load(py, name).map_err(refused)?;
                let file = File {
                    named: name.clone(),
                    path: canonical(name),
                    sha256,
                };
                (law, Some(file))
            }
            (None, None) => return Ok(None),
        };
        let looked = Looked::at(&law, role.name()).map_err(refused)?;
        let is_named = |name: &String| match &file {
            Some(file) => canonical(name) == file.path,
            None => *name == looked.name,
        };
        let other = file.as_ref().map_or(&looked.name, |file| &file.named);
        if !named.as_ref().is_none_or(is_named) {
            check_foreign_law(role, &table(&section, role.name())?, other)
                .map_err(settings_error)?;
        } else if let Some(File { path, sha256, .. }) = &file
            && text(section.get_item(SHA256)?).is_some_and(|sum| !sum.is_empty())
        {
            check_same(role, path, sha256, &table(&section, role.name())?)
                .map_err(settings_error)?;
        }
        for (dict, key) in [
            (settings, role.name()),
            (arguments, &key),
            (&section, LAW),
            (&section, SHA256),
        ] {
            if dict.contains(key)? {
                dict.del_item(key)?;
            }
        }
        let settings = looked.settled(py, &section).map_err(refused)?;
        let section = settings.copy()?;
        match file {
            None => section.set_item(LAW, &looked.name)?,
            Some(File { path, sha256, .. }) => {
                section.set_item(LAW, path.to_string_lossy())?;
                section.set_item(SHA256, sha256)?;
            }
        }
        Ok(Some(Self {
            looked,
            settings,
            section,
        }))
    }

    pub(crate) fn law(&self, rig: Rig) -> PyResult<Arc<PythonLaw>> {
        let rig = python_law::Rig((&rig).into());
        let law = self.looked.make(self.settings.py(), rig, &self.settings);
        law.map(Arc::new)
    }
}

impl From<&PyLaw<'_>> for FlownLaw {
    fn from(law: &PyLaw<'_>) -> Self {
        Self {
            name: law.looked.name.clone(),
            signals: Some(law.looked.telemetry.clone()),
        }
    }
}

/// A path without links; as it is, where it leads nowhere.
fn canonical(path: &str) -> PathBuf {
    Path::new(path)
        .canonicalize()
        .unwrap_or_else(|_| path.into())
}

/// A refusal as the exception that the module has for it.
fn as_settings_error(py: Python<'_>, raised: PyErr) -> PyErr {
    if is_refusal(py, &raised) {
        SettingsError::new_err(raised.value(py).to_string())
    } else {
        raised
    }
}
