//! The text of `ironbird faults`: the kinds of faults, and the fields of messages that can be wrong.

use messages::fault::{LONGEST_DELAY, PORTS};
use messages::role::STAGES;

use crate::fault::error::typed;
use crate::fault::plan::RESTART;
use report::render::document::{Cell, Table, row};

/// What, value and meaning.
const KINDS: &str = "\
PARAMETER | see `ironbird params` | the airframe has another value; no TO
TOPIC.drop | 0 to 1, or n/m | a share is lost at random, or the first n of each m
TOPIC.delay | DELAYS | messages come so many ticks later, and are as stale as that
TOPIC.lag | DELAYS | messages come in time, with the content of so many ticks before
TOPIC.freeze |  | messages come in time, with the content of the last one before
TOPIC.FIELD.noise | number | standard deviation of normal noise that is added, in the field's unit
TOPIC.FIELD.bias | number | what is added, in the field's unit
TOPIC.FIELD.nan |  | no number, which inspection refuses
ROLE.late | time, or 40us..400us | the stage computes so much longer; without TO in one tick
ROLE.stop | time | the stage does nothing for so long; no TO
ROLE.kill |  | the stage ends; simulated, a new one works RESTART later
cpu.hog | 1 to 99 | a process of this SCHED_FIFO priority is always busy on the loops' processor
cpu.load | 0 to 1 | an ordinary process is busy there in this share of its time
what lasts | off | it ends; no TO
";

pub fn text() -> String {
    let kinds = KINDS
        .replace("DELAYS", &format!("1 to {LONGEST_DELAY}"))
        .replace("RESTART", &typed(RESTART));
    let cells = |line: &str| line.split(" | ").map(Cell::from).collect::<Vec<_>>();
    let kinds = Table::new(["what", "value", "meaning"], kinds.lines().map(cells));
    let mut fields = Vec::new();
    for (place, port) in PORTS.into_iter().enumerate() {
        let is_of_topic = |other: &messages::fault::Port| other.topic() == port.topic();
        if PORTS[..place].iter().any(is_of_topic) {
            continue;
        }
        let inputs = PORTS.into_iter().filter(is_of_topic);
        let inputs: Vec<String> = inputs.map(|port| port.to_string()).collect();
        let inputs = inputs.join(" ");
        fields.extend(port.fields().iter().map(|field| {
            row([
                &port.topic(),
                &inputs,
                &field.name,
                &field.axes.join(" "),
                &field.unit,
            ])
        }));
    }
    let fields = Table::new(["topic", "inputs", "field", "axes", "unit"], fields);
    format!(
        "--fault 'WHAT[=VALUE][,WHAT[=VALUE]...]@FROM[..TO]'      FROM, TO: 8s, 500ms, tick8000\n\
         ironbird inject WHAT[=VALUE]... [--at-tick N | --in TIME] [--for TIME]      into a flight in the air\n\n\
         {}\nROLE is one of {}; a flight ends with its plant, so there is no plant.kill.\n\
         TOPIC means every input of it; ROLE.TOPIC means one. FIELD may end in one of its axes.\n\n{}",
        kinds.list(),
        STAGES.map(|role| role.name()).join(", "),
        fields.list()
    )
}
