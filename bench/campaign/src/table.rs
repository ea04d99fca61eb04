//! Rows of flights as columns of Arrow, with their units.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::builder::{BooleanBuilder, Float64Builder, Int64Builder, StringBuilder};
use arrow_array::{ArrayRef, RecordBatch};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use failure::Failure;
use model::parameters::Parameter;
use toml::Value;

use crate::campaign::{Campaign, Factor, Target};
use crate::distribution::Distribution;
use crate::fault::Number;
use crate::gates::METRICS;
use crate::outcome::Outcome;

/// A flight by an arm.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// The flight, from 0.
    pub flight: u64,
    /// Place of the arm.
    pub arm: usize,
    /// What it drew, in the order of the factors.
    pub draws: Vec<Value>,
    /// What came of it.
    pub outcome: Outcome,
}

/// Prefix of the columns that say which gates held.
pub const HOLDS: &str = "holds.";
/// Prefix of the columns with what laws showed.
pub const TELEMETRY: &str = "telemetry.";

/// The columns of a campaign.
#[derive(Clone, Debug)]
pub struct Columns {
    schema: SchemaRef,
}

impl Columns {
    /// Of a campaign.
    #[must_use]
    pub fn new(campaign: &Campaign) -> Self {
        let mut fields = vec![
            field("flight", DataType::Int64, "", "number of the flight, from 0"),
            field("arm", DataType::Utf8, "", "what flew it"),
        ];
        fields.extend(campaign.factors.iter().map(|factor| factor_field(campaign, factor)));
        fields.push(field(
            "success",
            DataType::Boolean,
            "",
            "flown to its end within its envelope, and every gate held",
        ));
        fields.push(field("lost", DataType::Utf8, "", "why the flight counts as lost").with_nullable(true));
        let metrics =
            METRICS.iter().map(|it| field(it.name, DataType::Float64, it.unit, it.meaning).with_nullable(true));
        fields.extend(metrics);
        for name in campaign.gates.names() {
            let meaning = format!("whether the gate {name} held");
            fields.push(field(&format!("{HOLDS}{name}"), DataType::Boolean, "", &meaning).with_nullable(true));
        }
        for gate in &campaign.gates.telemetry {
            for (end, meaning) in [("min", "smallest"), ("max", "largest")] {
                let name = format!("{TELEMETRY}{}.{end}", gate.name());
                let meaning = format!("{meaning} that the {} law showed of it", gate.role);
                fields.push(field(&name, DataType::Float64, "", &meaning).with_nullable(true));
            }
        }
        fields.push(field("outputs", DataType::Utf8, "", "hash over all outputs, as `ironbird simulate` prints it"));
        Self { schema: Arc::new(Schema::new(fields)) }
    }

    /// Their names, kinds, units and meanings.
    #[must_use]
    pub fn schema(&self) -> SchemaRef {
        Arc::clone(&self.schema)
    }

    /// Rows as columns.
    ///
    /// # Errors
    /// [`Failure`] where a value is not of its column's kind, which the file's reader rules out.
    pub fn batch(&self, campaign: &Campaign, rows: &[Row]) -> Result<RecordBatch, Failure> {
        let mut arrays: Vec<ArrayRef> = vec![
            whole(rows.iter().map(|row| Some(row.flight.cast_signed()))),
            text(rows.iter().map(|row| Some(campaign.arms[row.arm].name.as_str()))),
        ];
        for (i, factor) in campaign.factors.iter().enumerate() {
            arrays.push(match kind(&factor.distribution) {
                DataType::Float64 => numbers(rows.iter().map(|row| row.draws[i].as_float())),
                DataType::Int64 => whole(rows.iter().map(|row| row.draws[i].as_integer())),
                _ => text(
                    rows.iter().map(|row| Some(shown(&row.draws[i]))).collect::<Vec<_>>().iter().map(Option::as_deref),
                ),
            });
        }
        arrays.push(flags(rows.iter().map(|row| Some(campaign.gates.is_success(&row.outcome)))));
        arrays.push(text(rows.iter().map(|row| row.outcome.lost.as_deref())));
        arrays.extend((0..METRICS.len()).map(|i| numbers(rows.iter().map(|row| row.outcome.metrics[i]))));
        let held: Vec<Vec<Option<bool>>> = rows.iter().map(|row| campaign.gates.held(&row.outcome)).collect();
        arrays.extend((0..campaign.gates.names().count()).map(|i| flags(held.iter().map(|held| held[i]))));
        for i in 0..campaign.gates.telemetry.len() {
            for end in 0..2 {
                let shown = rows.iter().map(|row| row.outcome.telemetry[i].range().map(|range| range[end]));
                arrays.push(numbers(shown));
            }
        }
        arrays.push(text(rows.iter().map(|row| Some(row.outcome.outputs.as_str()))));
        RecordBatch::try_new(self.schema(), arrays).map_err(|e| Failure::failed(format!("rows of flights: {e}")))
    }
}

/// A value as a cell of text.
fn shown(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// The kind of a factor's column.
fn kind(distribution: &Distribution) -> DataType {
    match distribution.ends().first() {
        Some(Value::Float(_)) => DataType::Float64,
        Some(Value::Integer(_)) => DataType::Int64,
        _ => DataType::Utf8,
    }
}

fn field(name: &str, kind: DataType, unit: &str, meaning: &str) -> Field {
    let told = [("unit", unit), ("meaning", meaning)].into_iter().filter(|(_, text)| !text.is_empty());
    let told: HashMap<String, String> = told.map(|(key, text)| (key.to_owned(), text.to_owned())).collect();
    Field::new(name, kind, false).with_metadata(told)
}

fn factor_field(campaign: &Campaign, factor: &Factor) -> Field {
    let of_parameter = |name: &str| Parameter::from_name(name).ok().map(Parameter::spec);
    let (unit, meaning) = match &factor.target {
        Target::Setting { section, key } => {
            match of_parameter(key).filter(|_| section == "plant" || section == "model") {
                Some(spec) => (spec.unit, spec.meaning.to_owned()),
                None => ("", format!("{key} of [{section}]")),
            }
        }
        Target::Fault => of_fault(campaign, &factor.name),
        Target::Timing => ("", "recorded flight whose timing the flight has".into()),
    };
    field(&factor.name, kind(&factor.distribution), unit, &meaning)
}

/// Unit and meaning of a fault's part.
fn of_fault(campaign: &Campaign, name: &str) -> (&'static str, String) {
    let part = name.rsplit('.').next().unwrap_or_default();
    let place = campaign.factors.iter().position(|factor| factor.name == name);
    let fault = campaign.faults.iter().find(|fault| place == fault.value);
    let what = fault.map(|fault| &campaign.factors[fault.what].distribution);
    match (part, what) {
        ("what", _) => ("", "what goes wrong".into()),
        ("value", Some(Distribution::Fixed(Value::String(name)))) => {
            let of_parameter = || Parameter::from_name(name).map_or("", |parameter| parameter.spec().unit);
            (Number::of(name).unit().unwrap_or_else(of_parameter), format!("value of {name}"))
        }
        ("value", _) => ("", "value of the fault".into()),
        ("at_s", _) => ("s", "when the fault strikes".into()),
        ("for_s", _) => ("s", "how long the fault lasts".into()),
        _ => ("s", "how long the fault takes".into()),
    }
}

fn numbers(values: impl Iterator<Item = Option<f64>>) -> ArrayRef {
    let mut builder = Float64Builder::new();
    values.for_each(|value| builder.append_option(value));
    Arc::new(builder.finish())
}

fn whole(values: impl Iterator<Item = Option<i64>>) -> ArrayRef {
    let mut builder = Int64Builder::new();
    values.for_each(|value| builder.append_option(value));
    Arc::new(builder.finish())
}

fn flags(values: impl Iterator<Item = Option<bool>>) -> ArrayRef {
    let mut builder = BooleanBuilder::new();
    values.for_each(|value| builder.append_option(value));
    Arc::new(builder.finish())
}

fn text<'a>(values: impl Iterator<Item = Option<&'a str>>) -> ArrayRef {
    let mut builder = StringBuilder::new();
    values.for_each(|value| builder.append_option(value));
    Arc::new(builder.finish())
}
