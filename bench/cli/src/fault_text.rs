//! What `ironbird faults` prints.

use faults::{LONGEST_DELAY_TICKS, PORTS};
use messages::role::STAGES;

use faults::grammar::typed;
use faults::plan::RESTART;
use render::document::{Cell, Table, row};

/// What, value and meaning.
const KINDS: &str = "\
PARAMETER | see `ironbird params` | changes the airframe; takes no TO
TOPIC.drop | up to 1, or n/m | loses a random share of the messages, or the first n of each m
TOPIC.delay | DELAYS | messages arrive this many ticks late, and stale
TOPIC.lag | DELAYS | messages arrive on time with the content of this many ticks earlier
TOPIC.freeze |  | messages arrive on time with the last content before the fault
TOPIC.FIELD.noise | number | adds normal noise with this standard deviation, in the field's unit
TOPIC.FIELD.bias | number | adds a constant, in the field's unit
TOPIC.FIELD.nan |  | not a number: inspection rejects the message
ROLE.late | time, or 40us..400us | the stage computes longer by this time; one tick without TO
ROLE.stop | time | the stage pauses for this time; takes no TO
ROLE.kill |  | the process is killed; in a simulation it restarts RESTART later
CHANNEL.switch |  | not a fault: with redundant channels, that one flies from then on; takes no TO
cpu.hog | 1 to 99 | a process of this SCHED_FIFO priority is always busy on the loops' processor
cpu.load | up to 1 | an ordinary process is busy there for this share of the time
a lasting fault | off | ends it; takes no TO
";

pub fn text() -> String {
    let kinds = KINDS
        .replace("DELAYS", &format!("1 to {LONGEST_DELAY_TICKS}"))
        .replace("RESTART", &typed(RESTART));
    let cells = |line: &str| line.split(" | ").map(Cell::from).collect::<Vec<_>>();
    let kinds = Table::new(["what", "value", "meaning"], kinds.lines().map(cells));
    let mut fields = Vec::new();
    for (place, port) in PORTS.into_iter().enumerate() {
        let is_of_topic = |other: &faults::Port| other.topic() == port.topic();
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
         ironbird inject WHAT[=VALUE]... [--at-tick N | --in TIME] [--for TIME]      into a running flight\n\n\
         {}\nROLE is one of {}; a flight ends with its plant, so there is no plant.kill.\n\
         With redundant channels, b.ROLE is the stage of channel b; CHANNEL is a, b or c.\n\
         TOPIC means every input of it; ROLE.TOPIC means one. FIELD may end in one of its axes.\n\n{}",
        kinds.list(),
        STAGES.map(|role| role.name()).join(", "),
        fields.list()
    )
}

#[cfg(test)]
mod tests {
    #[test]
    fn every_kind_of_fault_is_listed() {
        let text = super::text();
        let is_listed = |it: faults::code::FaultSpec| text.contains(&format!(".{} ", it.name));
        assert!(faults::code::FAULTS.into_iter().all(is_listed), "{text}");
    }
}
