//! `ironbird params`: lists the airframe's parameters, with the values in force.

use ipc::instance::Instance;
use messages::blackboards::{ActiveParameters, IN_FORCE};
use messages::parameters::{Airframe, SPECS};
use serde::Serialize;

use crate::cli::ParamsArgs;
use crate::inject::{self, flight};
use crate::output::print;
use crate::settings::airframe::named;
use errors::{Failure, OK};
use report::render::document::{Table, known, row};

#[derive(Serialize)]
struct Row {
    name: &'static str,
    unit: &'static str,
    min: f64,
    max: f64,
    nominal: f64,
    in_force: Option<f64>,
    equation: &'static str,
    meaning: &'static str,
}

pub fn params(args: &ParamsArgs) -> Result<u8, Failure> {
    let instance = Instance::new(&args.instance)?;
    let (in_force, flown) = match flight(&instance)? {
        Some((wire, _)) => (
            wire.blackboard_reader::<ActiveParameters>(IN_FORCE)?
                .map(|board| board.get()),
            Some(inject::airframe(&wire)?),
        ),
        None => (None, None),
    };
    let airframe = match &args.airframe {
        Some(name) => named(name)?,
        None => flown.unwrap_or(Airframe::nominal()),
    };
    let rows: Vec<Row> = SPECS
        .iter()
        .map(|spec| Row {
            name: spec.name,
            unit: spec.unit,
            min: airframe.range(spec.parameter).min,
            max: airframe.range(spec.parameter).max,
            nominal: airframe.as_built().get(spec.parameter),
            in_force: in_force.map(|values| values.value[spec.parameter as usize]),
            equation: spec.equation,
            meaning: spec.meaning,
        })
        .collect();
    if args.json {
        let text =
            serde_json::to_string_pretty(&rows).map_err(|e| Failure::failed(e.to_string()))?;
        print(&(text + "\n"))?;
        return Ok(OK);
    }
    let columns = [
        "name", "unit", "min", "max", "nominal", "in force", "equation", "meaning",
    ];
    let cells = rows.iter().map(|it| {
        let in_force = known(it.in_force.map(number));
        let [min, max] = [it.min, it.max].map(bound);
        let nominal = number(it.nominal);
        row([
            &it.name,
            &it.unit,
            &min,
            &max,
            &nominal,
            &in_force,
            &it.equation,
            &it.meaning,
        ])
    });
    let mut text = Table::new(columns, cells).list();
    text.push_str(&match in_force {
        Some(values) => format!(
            "in force at instance `{}` since tick {}, parameter epoch {}\n",
            instance.name(),
            values.tick,
            values.parameter_epoch
        ),
        None => format!(
            "no flight is running as instance `{}`: no values in force\n",
            instance.name()
        ),
    });
    print(&text)?;
    Ok(OK)
}

/// An end of a range; of an airframe of another size it is a quotient, which is shown in short.
pub(crate) fn bound(value: f64) -> String {
    let whole = number(value);
    if whole.len() > 8 {
        format!("{value:.2e}")
    } else {
        whole
    }
}

/// A value as it was typed; small ones as powers of ten. One on a ramp has more digits, and is shown in short.
pub(crate) fn number(value: f64) -> String {
    let is_small = value != 0.0 && value.abs() < 1e-3;
    let whole = if is_small {
        format!("{value:e}")
    } else {
        format!("{value}")
    };
    match (whole.len() > 12, is_small) {
        (false, _) => whole,
        (true, true) => format!("{value:.3e}"),
        (true, false) => format!("{value:.6}"),
    }
}
