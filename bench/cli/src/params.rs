//! `ironbird params`: lists the airframe's parameters, with the active values.

use ipc::instance::Instance;
use messages::blackboards::{ActiveParameters, IN_FORCE};
use messages::parameters::Airframe;

use crate::cli::ParamsArgs;
use analysis::json::print_json;
use config::airframe::named;
use errors::output::print;
use errors::{Failure, OK};
use live::inject::{self, flight};
use live::parameter_text::{bound, number, rows};
use render::document::{Table, known, row};

pub fn params(args: &ParamsArgs) -> Result<u8, Failure> {
    let instance = Instance::new(&args.instance)?;
    let (mut active, mut airframe) = (None, Airframe::nominal());
    if let Some((wire, _)) = flight(&instance)? {
        let board = wire.blackboard_reader::<ActiveParameters>(IN_FORCE)?;
        active = board.map(|board| board.get());
        airframe = inject::airframe(&wire)?;
    }
    if let Some(name) = &args.airframe {
        airframe = named(name)?;
    }
    let rows = rows(&airframe, active.as_ref());
    if args.json {
        print_json(&rows.as_slice())?;
        return Ok(OK);
    }
    let columns = "name unit min max nominal in_force equation meaning".split(' ');
    let columns = columns.map(|column| column.replace('_', " "));
    let cells = rows.iter().map(|it| {
        let [min, max] = [it.min, it.max].map(bound);
        let (nominal, active) = (number(it.nominal), known(it.in_force.map(number)));
        let (unit, equation, meaning) = (&it.unit, &it.equation, &it.meaning);
        row([
            &it.name, unit, &min, &max, &nominal, &active, equation, meaning,
        ])
    });
    let name = instance.name();
    let note = match active.map(|active| (active.tick, active.parameter_epoch)) {
        Some((tick, epoch)) => {
            format!("in force at instance `{name}` since tick {tick}, parameter epoch {epoch}\n")
        }
        None => format!("no flight is running as instance `{name}`: no values in force\n"),
    };
    print(&(Table::new(columns, cells).list() + &note))?;
    Ok(OK)
}
