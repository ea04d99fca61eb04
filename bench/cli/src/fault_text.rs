//! What `ironbird faults` prints.

use faults::{FAULTS, FaultSpec, Lasts, PORTS};
use flight_log::units;
use messages::role::STAGES;

use render::document::{Cell, Table, row};

/// What, value and meaning.
fn kind(spec: &FaultSpec) -> [String; 3] {
    let until = match spec.lasts {
        Lasts::ForGood => "",
        Lasts::OneTick => "; one tick without TO",
        Lasts::Instant => "; takes no TO",
    };
    [
        format!("{}.{}", spec.kind.scope().prefix(), spec.name),
        spec.value.brief(),
        format!("{}{until}", spec.meaning),
    ]
}

pub fn text() -> String {
    let parameter = [
        "PARAMETER",
        "see `ironbird params`",
        "changes the airframe; takes no TO",
    ];
    let end = ["a lasting fault", "off", "ends it; takes no TO"];
    let kinds = FAULTS.iter().map(kind);
    let [first, last] = [parameter, end].map(|cells| cells.map(String::from));
    let kinds = [first].into_iter().chain(kinds).chain([last]);
    let kinds = kinds.map(|cells| cells.map(Cell::from).into());
    let kinds = Table::new(["what", "value", "meaning"], kinds);
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
                &units::of_name(field.name).unwrap_or_default(),
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
