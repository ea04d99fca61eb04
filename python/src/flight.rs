//! A flight as Python gets it: its messages by topic as columns, and facts by name.

use std::fs;
use std::path::Path;

use analysis::faults::AppliedSwap;
use analysis::tracking::Tracking;
use config::Settings;
use config::law_settings::known;
use control_api::description::Description;
use errors::Failure;
use flight_log::codec::Logged;
use messages::content::{RotorSpeeds, Setpoint, State, Wrench};
use messages::monitor::Monitor;
use messages::role::{ROLES, Role, STAGES};
use pyo3::exceptions::PyMemoryError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use python_law::array;
use sim::simulator::Simulator;
use toml::{Table as Section, Value};

use crate::table::{ShownColumn, Signals, Table, rows};

pub(crate) type Shown<'py> = (Vec<ShownColumn<'py>>, Bound<'py, PyDict>);

#[derive(Clone, Debug)]
pub(crate) struct FlownLaw {
    pub name: String,
    /// None where only the law's file knows their names.
    pub signals: Option<Signals>,
}

impl From<&'static Description> for FlownLaw {
    fn from(law: &'static Description) -> Self {
        let signals = law.telemetry.iter();
        let signals = signals.map(|signal| (signal.name.into(), signal.unit.into()));
        Self {
            name: law.name.into(),
            signals: Some(signals.collect()),
        }
    }
}

impl FlownLaw {
    /// The laws of a flight that was recorded: outer, inner, mixer. No file of a law is opened, as its code would run.
    pub(crate) fn recorded(settings: &Settings) -> [Self; 3] {
        let law = |(role, section): (Role, &Section)| {
            let name = section.get("law").and_then(Value::as_str);
            let name = name.unwrap_or_default();
            let built_in = known(role).into_iter().find(|law| law.name == name);
            built_in.map_or_else(
                || {
                    let file = Path::new(name).file_name().unwrap_or_default();
                    let name = file.to_string_lossy().into_owned();
                    let signals = None;
                    Self { name, signals }
                },
                Self::from,
            )
        };
        [
            (Role::Outer, &settings.outer),
            (Role::Inner, &settings.inner),
            (Role::Mixer, &settings.mixer),
        ]
        .map(law)
    }
}

/// Copies of the number of a tick that a flight keeps beside its columns: rows, `tick` and `t`.
const BESIDE: u64 = 3;

/// The messages of a flight, and its reference.
#[derive(Debug)]
pub(crate) struct Tables {
    /// By the sender: state, setpoint, wrench, rotor speeds, and the recorder's theorem.
    topics: [Table; ROLES.len()],
    /// The reference of each state: also where the outer law has published nothing.
    reference: Table,
    tracking: Tracking,
}

impl Tables {
    /// Empty, for what these laws show: outer, inner, mixer.
    pub(crate) fn of(
        settings: &Settings,
        [outer, inner, mixer]: &[FlownLaw; 3],
    ) -> Result<Self, Failure> {
        let none = Some(Signals::new());
        Ok(Self {
            topics: [
                Table::of::<State>(&none),
                Table::of::<Setpoint>(&outer.signals),
                Table::of::<Wrench>(&inner.signals),
                Table::of::<RotorSpeeds>(&mixer.signals),
                Table::of::<Monitor>(&none),
            ],
            reference: Table::of_reference(),
            tracking: Tracking::along(settings.course()?, settings.flight.period_s),
        })
    }

    pub(crate) fn push<C: Logged>(&mut self, tick: u64, content: &C) {
        self.topics[C::SENDER as usize].push(tick, content);
    }

    pub(crate) fn push_reference(&mut self, tick: u64, state: &State) {
        let reference = self.tracking.reference(tick, state);
        self.reference.push(tick, &reference);
    }

    fn all(&self) -> impl Iterator<Item = &Table> {
        self.topics.iter().chain([&self.reference])
    }

    /// Takes the memory of so many ticks before the flight begins: the interpreter would end where none is left.
    pub(crate) fn reserve(&mut self, ticks: u64) -> PyResult<()> {
        let numbers = self.all().map(Table::numbers).sum::<u64>() + BESIDE;
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
        let mut tables = self.topics.iter_mut().chain([&mut self.reference]);
        let reserved = tables.try_for_each(|table| table.reserve(rows));
        reserved.map_err(|_| refused("this process may not have as many"))
    }

    pub(crate) fn take(&mut self, rig: &Simulator) {
        let tick = rig.flown_tick();
        self.push(tick, rig.state());
        self.push_reference(tick, rig.state());
        rig.setpoint()
            .into_iter()
            .for_each(|it| self.push(tick, it));
        rig.new_wrench()
            .into_iter()
            .for_each(|it| self.push(tick, it));
        rig.new_rotor_speeds()
            .into_iter()
            .for_each(|it| self.push(tick, it));
        rig.monitor().into_iter().for_each(|it| self.push(tick, it));
    }

    /// All of it on the same ticks, with tables beside; nothing of the theorem where nothing was said of it.
    pub(crate) fn shown<'py>(
        self,
        py: Python<'py>,
        mut beside: Vec<Table>,
        facts: Bound<'py, PyDict>,
    ) -> PyResult<Shown<'py>> {
        let mut tables = Vec::from(self.topics);
        if tables.last().is_some_and(Table::is_empty) {
            tables.pop();
        }
        tables.push(self.reference);
        let rows = rows(&tables);
        tables.append(&mut beside);
        let ticks: Vec<f64> = rows.iter().map(|tick| *tick as f64).collect();
        facts.set_item("tick", array(py, &ticks)?)?;
        let columns = tables.into_iter().flat_map(|table| table.on(&rows));
        let columns = columns.map(|column| column.shown(py));
        Ok((columns.collect::<PyResult<_>>()?, facts))
    }
}

/// What is known of every flight; the settings also as text.
pub(crate) fn facts<'py>(
    py: Python<'py>,
    settings: &Settings,
    text: &str,
    laws: &[FlownLaw; 3],
    swaps: &[AppliedSwap],
) -> PyResult<Bound<'py, PyDict>> {
    let facts = PyDict::new(py);
    facts.set_item("settings", text)?;
    facts.set_item("period_s", settings.flight.period_s)?;
    facts.set_item("trajectory", settings.trajectory_name())?;
    let names = PyDict::new(py);
    for (role, law) in STAGES[1..].iter().zip(laws) {
        names.set_item(role.name(), &law.name)?;
    }
    facts.set_item("laws", names)?;
    let mut faults = Vec::new();
    for swap in swaps {
        for change in &swap.changes {
            let (name, old, new) = (&change.name, change.old, change.new);
            faults.push((swap.tick, swap.time_s, name, old, new, change.over_s));
        }
    }
    facts.set_item("faults", faults)?;
    Ok(facts)
}

/// Memory that can be had without swapping [bytes]; none where the system does not say.
fn available() -> Option<u64> {
    let said = fs::read_to_string("/proc/meminfo").ok()?;
    let mut lines = said.lines();
    let kib = lines.find_map(|line| line.strip_prefix("MemAvailable:")?.strip_suffix(" kB"))?;
    kib.trim().parse::<u64>().ok()?.checked_mul(1024)
}
