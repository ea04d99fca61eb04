//! `ironbird faults`: lists what can go wrong with messages, stages and their processor, and the fields that can be wrong.

use messages::fault::fields::Field;
use messages::fault::{LONGEST_DELAY, PORTS, Port};
use messages::role::STAGES;

use crate::fault::error::typed;
use crate::fault::plan::RESTART;
use crate::output::print;
use errors::{Failure, OK};
use report::render::document::{Cell, Table, row};

pub fn faults() -> Result<u8, Failure> {
    print(&text())?;
    Ok(OK)
}

fn text() -> String {
    let mut text = "--fault 'WHAT[=VALUE][,WHAT[=VALUE]...]@FROM[..TO]'      FROM, TO: 8s, 500ms, tick8000\n\
         ironbird inject WHAT[=VALUE]... [--at-tick N | --in TIME] [--for TIME]      into a flight in the air\n\n"
        .to_owned();
    let delays = format!("1 to {LONGEST_DELAY}");
    let restart = format!(
        "the stage ends; simulated, a new one works {} later",
        typed(RESTART)
    );
    let kinds = [
        [
            "PARAMETER",
            "see `ironbird params`",
            "the airframe has another value; no TO",
        ],
        [
            "TOPIC.drop",
            "0 to 1, or n/m",
            "a share is lost at random, or the first n of each m",
        ],
        [
            "TOPIC.delay",
            &delays,
            "messages come so many ticks later, and are as stale as that",
        ],
        [
            "TOPIC.lag",
            &delays,
            "messages come in time, with the content of so many ticks before",
        ],
        [
            "TOPIC.freeze",
            "",
            "messages come in time, with the content of the last one before",
        ],
        [
            "TOPIC.FIELD.noise",
            "number",
            "standard deviation of normal noise that is added, in the field's unit",
        ],
        [
            "TOPIC.FIELD.bias",
            "number",
            "what is added, in the field's unit",
        ],
        ["TOPIC.FIELD.nan", "", "no number, which inspection refuses"],
        [
            "ROLE.late",
            "time, or 40us..400us",
            "the stage computes so much longer; without TO in one tick",
        ],
        [
            "ROLE.stop",
            "time",
            "the stage does nothing for so long; no TO",
        ],
        ["ROLE.kill", "", &restart],
        [
            "cpu.hog",
            "1 to 99",
            "a process of this SCHED_FIFO priority is always busy on the loops' processor",
        ],
        [
            "cpu.load",
            "0 to 1",
            "an ordinary process is busy there in this share of its time",
        ],
        ["what lasts", "off", "it ends; no TO"],
    ];
    let kinds = kinds.map(|cells| cells.map(Cell::from).into());
    text += &Table::new(["what", "value", "meaning"], kinds).list();
    let stages = STAGES.map(|role| role.name()).join(", ");
    text += &format!(
        "\nROLE is one of {stages}; a flight ends with its plant, so there is no plant.kill.\nTOPIC means every input of it; \
         ROLE.TOPIC means one. FIELD may end in one of its axes.\n\n"
    );
    let mut rows = Vec::new();
    let mut listed: Vec<&str> = Vec::new();
    for port in PORTS {
        if !listed.contains(&port.topic()) {
            listed.push(port.topic());
            rows.extend(port.fields().iter().map(|field| field_row(port, field)));
        }
    }
    text + &Table::new(["topic", "inputs", "field", "axes", "unit"], rows).list()
}

fn field_row(port: Port, field: &Field) -> Vec<Cell> {
    let inputs = PORTS
        .into_iter()
        .filter(|other| other.topic() == port.topic());
    let inputs: Vec<String> = inputs.map(|port| port.to_string()).collect();
    row([
        &port.topic(),
        &inputs.join(" "),
        &field.name,
        &field.axes.join(" "),
        &field.unit,
    ])
}
