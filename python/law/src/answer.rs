//! The answer of a law, number by number: an error names the place, and the number that is missing or wrong.

use ironbird_law::{Desired, WrenchSetpoint};
use messages::telemetry::Telemetry;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

const OUTER: &str =
    "thrust_n, attitude_rad[3], attitude_rate_rad_s[3], attitude_acceleration_rad_s2[3]";
const INNER: &str = "thrust_n, torque_b_nm[3]";

/// An answer, with what its errors begin with.
pub(crate) struct Answer<'a, 'py> {
    pub value: &'a Bound<'py, PyAny>,
    /// Where the law stands, and the tick: "law.py:7: tick() of `law` at tick 12".
    pub place: String,
}

impl Answer<'_, '_> {
    pub(crate) fn wrench(
        &self,
        telemetry: &mut Telemetry,
        signals: usize,
    ) -> PyResult<WrenchSetpoint> {
        self.check(INNER, signals)?;
        let wrench = WrenchSetpoint {
            thrust_n: self.number(0, "thrust_n")?,
            torque_b_nm: self.three(1, "torque_b_nm")?,
        };
        self.telemetry(2, telemetry, signals)?;
        Ok(wrench)
    }

    pub(crate) fn desired(&self, telemetry: &mut Telemetry, signals: usize) -> PyResult<Desired> {
        self.check(OUTER, signals)?;
        let desired = Desired {
            thrust_n: self.number(0, "thrust_n")?,
            attitude_rad: self.three(1, "attitude_rad")?,
            attitude_rate_rad_s: self.three(2, "attitude_rate_rad_s")?,
            attitude_acceleration_rad_s2: self.three(3, "attitude_acceleration_rad_s2")?,
            limited: 0,
        };
        self.telemetry(4, telemetry, signals)?;
        Ok(desired)
    }

    /// Whether there are as many values as there should be.
    fn check(&self, names: &str, signals: usize) -> PyResult<()> {
        let mut names = names.to_owned();
        if signals > 0 {
            names += &format!(", telemetry[{signals}]");
        }
        let given = match self.value.len() {
            Ok(given) if given == names.split(", ").count() => return Ok(()),
            Ok(given) => format!(" of length {given}"),
            Err(_) => String::new(),
        };
        let (place, kind) = (&self.place, self.kind());
        Err(PyTypeError::new_err(format!(
            "{place} gave {kind}{given}; return ({names})"
        )))
    }

    fn kind(&self) -> String {
        if self.value.is_none() {
            return "nothing".into();
        }
        match self.value.get_type().name() {
            Ok(name) => format!("a value of type {name}"),
            Err(_) => "something else".into(),
        }
    }

    fn number(&self, at: usize, name: &str) -> PyResult<f64> {
        let value = self.value.get_item(at)?;
        let number = value.extract::<f64>().ok().map(|number| [number]);
        let finite = self.finite(number, &value, name, "a finite number");
        finite.map(|[number]| number)
    }

    fn three(&self, at: usize, name: &str) -> PyResult<[f64; 3]> {
        let value = self.value.get_item(at)?;
        self.finite(value.extract().ok(), &value, name, "three finite numbers")
    }

    fn finite<const N: usize>(
        &self,
        numbers: Option<[f64; N]>,
        value: &Bound<'_, PyAny>,
        name: &str,
        expected: &str,
    ) -> PyResult<[f64; N]> {
        let is_finite = |numbers: &[f64; N]| numbers.iter().all(|number| number.is_finite());
        numbers.filter(is_finite).ok_or_else(|| {
            let (place, value) = (&self.place, repr(value));
            PyValueError::new_err(format!(
                "{place} gave {name} = {value}; expected {expected}"
            ))
        })
    }

    /// The numbers that the law shows: anything goes, as no stage reads them.
    fn telemetry(&self, at: usize, telemetry: &mut Telemetry, count: usize) -> PyResult<()> {
        if count == 0 {
            return Ok(());
        }
        let value = self.value.get_item(at)?;
        let numbers = value.extract::<Vec<f64>>().ok().filter(|numbers| numbers.len() == count).ok_or_else(|| {
            PyValueError::new_err(format!(
                "{} gave telemetry = {}; return telemetry[{count}], a number for each name of `telemetry`",
                self.place,
                repr(&value)
            ))
        })?;
        telemetry.value[..count].copy_from_slice(&numbers);
        Ok(())
    }
}

/// A value as Python prints it, in a line of bearable length.
fn repr(value: &Bound<'_, PyAny>) -> String {
    const LONGEST: usize = 80;
    let text = value.repr();
    let text = text.map_or_else(
        |_| "?".into(),
        |text| text.to_string_lossy().replace('\n', " "),
    );
    if text.chars().count() <= LONGEST {
        return text;
    }
    text.chars().take(LONGEST).chain("...".chars()).collect()
}
