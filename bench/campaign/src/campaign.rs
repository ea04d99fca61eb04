//! A campaign: what its flights share, what each draws, and by which arms.

use std::time::Duration;

use sha2::{Digest as _, Sha256};
use toml::{Table, Value};

use crate::distribution::Distribution;
use crate::fault::Fault;
use crate::gates::Gates;
use crate::generator::Stream;
use crate::lines::Lines;

pub fn hex(hash: Sha256) -> String {
    format!("{:x}", hash.finalize())
}

#[derive(Clone, Debug)]
pub struct Campaign {
    pub name: String,
    pub flights: u64,
    pub seed: u64,
    pub chunk: u64,
    /// Sections of the settings that all flights begin with.
    pub base: Table,
    /// The recorded flight whose timing flights have, unless their arm or their draw names another; on time without.
    pub timing: Option<String>,
    /// What is drawn for each flight, in the order of the columns.
    pub factors: Vec<Factor>,
    pub faults: Vec<Fault>,
    pub arms: Vec<Variant>,
    pub gates: Gates,
    /// Request to an engine; rows do not depend on it.
    pub submission: Submission,
    pub lines: Lines,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Submission {
    /// Partition of Slurm; its default one where there is none.
    pub partition: Option<String>,
    /// Time after which the engine ends a shard; none where nothing limits it but the engine.
    pub time_limit: Option<Duration>,
    /// Whether the engine starts a shard again whose node was lost.
    pub requeue: bool,
    pub processors: u64,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Factor {
    pub name: String,
    pub target: Target,
    pub distribution: Distribution,
    pub line: usize,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    Setting {
        section: String,
        key: String,
    },
    /// A part of a fault, which names the factor.
    Fault,
    Timing,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Variant {
    pub name: String,
    pub settings: Vec<(String, String, Value)>,
    pub timing: Option<String>,
    pub line: usize,
}

impl Campaign {
    /// Whether the flights of an arm have faults from which they may recover.
    pub fn has_faults(&self, arm: &Variant) -> bool {
        let own = arm
            .settings
            .iter()
            .find(|(section, key, _)| section == "flight" && key == "faults");
        let of_all = self
            .base
            .get("flight")
            .and_then(|flight| flight.get("faults"));
        let planned = own.map(|(_, _, faults)| faults).or(of_all);
        !self.faults.is_empty()
            || self
                .factors
                .iter()
                .any(|factor| factor.name == "flight.faults")
            || planned
                .and_then(Value::as_array)
                .is_some_and(|faults| !faults.is_empty())
    }

    /// Whether a flight by an arm has faults from which it may recover: it may draw none.
    pub fn is_faulted(&self, arm: &Variant, flight: u64) -> bool {
        let mut factors = self.factors.iter();
        match factors.find(|factor| factor.name == "flight.faults") {
            Some(factor) if self.faults.is_empty() => {
                let stream = Stream::new(self.seed, &factor.name);
                let drawn = factor.distribution.draw(stream, flight);
                drawn.as_array().is_some_and(|faults| !faults.is_empty())
            }
            _ => self.has_faults(arm),
        }
    }

    /// What a flight draws, in the order of the factors: of its number and the seed alone.
    pub fn draws(&self, flight: u64) -> Vec<Value> {
        let draw = |factor: &Factor| {
            let stream = Stream::new(self.seed, &factor.name);
            factor.distribution.draw(stream, flight)
        };
        self.factors.iter().map(draw).collect()
    }

    /// Sections of the settings of a flight by an arm, as a settings file would have them.
    pub fn given(&self, arm: &Variant, draws: &[Value]) -> Table {
        let mut given = self.base.clone();
        let set = |given: &mut Table, section: &str, key: &str, value: Value| {
            let section = given.entry(section);
            let section = section.or_insert_with(|| Value::Table(Table::new()));
            if let Some(section) = section.as_table_mut() {
                section.insert(key.to_owned(), value);
            }
        };
        for (factor, value) in self.factors.iter().zip(draws) {
            if let Target::Setting { section, key } = &factor.target {
                set(&mut given, section, key, value.clone());
            }
        }
        for (section, key, value) in &arm.settings {
            set(&mut given, section, key, value.clone());
        }
        if !self.faults.is_empty() {
            let own = given.get("flight").and_then(|it| it.get("faults"));
            let own = own.and_then(Value::as_array).into_iter().flatten();
            let faults = self.faults.iter();
            let drawn = faults.map(|fault| Value::from(fault.text(draws)));
            let faults = own.cloned().chain(drawn).collect();
            set(&mut given, "flight", "faults", Value::Array(faults));
        }
        given
    }

    /// The recorded flight whose timing a flight by an arm has, as the file names it.
    pub fn timing<'a>(&'a self, arm: &'a Variant, draws: &'a [Value]) -> Option<&'a str> {
        let mut drawn = self.factors.iter().zip(draws);
        let drawn = drawn.find(|(factor, _)| factor.target == Target::Timing);
        let drawn = drawn.and_then(|(_, name)| name.as_str());
        drawn.or(arm.timing.as_deref()).or(self.timing.as_deref())
    }

    /// All recorded flights whose timing flights by an arm have, and the key of the file that names them.
    pub fn timings(&self, arm: &Variant) -> (String, Vec<String>) {
        let drawn = self.factors.iter().find(|it| it.target == Target::Timing);
        let of = |name: &Option<String>| name.iter().cloned().collect();
        match (drawn, &arm.timing) {
            (Some(factor), _) => {
                let names = factor.distribution.ends().into_iter();
                let names = names.filter_map(|name| Some(name.as_str()?.to_owned()));
                ("factors.timing".into(), names.collect())
            }
            (None, Some(_)) => (format!("arms.{}.timing", arm.name), of(&arm.timing)),
            (None, None) => ("campaign.timing".into(), of(&self.timing)),
        }
    }

    /// What the rows of the same campaign agree in, whatever its length: `settings` are those of each arm, resolved, with
    /// whatever else its flights depend on.
    pub fn fingerprint(&self, settings: &[String]) -> String {
        let Self { seed, chunk, .. } = self;
        let mut text = format!("ironbird-campaign/1\nseed {seed}\nchunk {chunk}\n");
        for factor in &self.factors {
            text += &format!("factor {} {:?}\n", factor.name, factor.distribution);
        }
        for fault in &self.faults {
            text += &format!("{fault:?}\n");
        }
        text += &format!("{:?}\n", self.gates);
        for (arm, settings) in self.arms.iter().zip(settings) {
            text += &format!("arm {} {:?}\n{settings}\n", arm.name, arm.settings);
        }
        hex(Sha256::new_with_prefix(text))[..32].to_owned()
    }

    pub fn arm(&self, name: &str) -> Option<usize> {
        self.arms.iter().position(|arm| arm.name == name)
    }
}
