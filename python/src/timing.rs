//! Latencies tick by tick, from the stamps of a log's messages; the names are those of the report's series.

use messages::grid::{Grid, Pace};
use messages::header::Header;
use messages::role::{Role, STAGES};

use crate::table::{Column, Table};

const GROUP: &str = "timing";

#[derive(Debug)]
pub(crate) struct Timing {
    /// None in lockstep, where ticks have no place on the clock.
    grid: Option<Grid>,
    pub(crate) tables: [Table; STAGES.len()],
}

impl Timing {
    /// Of a flight at a pace, before its first message.
    pub(crate) fn of(pace: Pace) -> Self {
        let grid = match pace {
            Pace::Realtime(grid) => Some(grid),
            Pace::Lockstep => None,
        };
        let [plant, outer, inner, mixer] = STAGES;
        let tables = [
            (plant, None),
            (outer, Some("hop_plant_outer")),
            (inner, Some("hop_outer_inner")),
            (mixer, Some("hop_inner_mixer")),
        ];
        let table = |(role, hop): (Role, Option<&str>)| {
            let on_clock = |name: String| grid.map(|_| name);
            let timer = on_clock("timer".into()).filter(|_| role == plant);
            let wake = on_clock(format!("wake_{role}"));
            let compute = Some(format!("compute_{role}"));
            let whole = (role == mixer).then(|| "loop".to_owned());
            let slack = on_clock("slack".into()).filter(|_| role == mixer);
            let names = [timer, wake, compute, hop.map(str::to_owned), whole, slack];
            let column = |name| Column {
                group: GROUP.into(),
                name: format!("{name}_us"),
                unit: "us".into(),
                axes: Vec::new(),
                values: Vec::new(),
            };
            Table::of_columns(names.into_iter().flatten().map(column).collect())
        };
        Self {
            grid,
            tables: tables.map(table),
        }
    }

    pub(crate) fn take(&mut self, role: Role, envelope: &Header) {
        let (tick, stamps) = (envelope.tick, envelope.stamps_of(role));
        let (received_ns, sent_ns) = (stamps.receive_ns, stamps.send_ns);
        let timer = self.grid.map(|_| us(envelope.timer_late_ns, 0));
        let wake = self.grid.map(|grid| us(received_ns, grid.begin_of(tick)));
        let compute = Some(us(sent_ns, received_ns));
        let whole = match envelope.sample_ns {
            0 => f64::NAN,
            sample_ns => us(sent_ns, sample_ns),
        };
        let slack = self.grid.map(|grid| us(grid.begin_of(tick + 1), sent_ns));
        let row = match role {
            Role::Plant => vec![timer, wake, compute],
            Role::Outer => vec![wake, compute, hop(Role::Plant, role, 0, envelope)],
            Role::Inner => vec![wake, compute, hop(Role::Outer, role, 1, envelope)],
            _ => {
                let hop = hop(Role::Inner, role, 2, envelope);
                vec![wake, compute, hop, Some(whole), slack]
            }
        };
        self.tables[role as usize].push_row(tick, row.into_iter().flatten());
    }
}

/// From one stage's publishing to the next one's having the message in hand; no number where that was of another tick.
fn hop(from: Role, to: Role, input: usize, envelope: &Header) -> Option<f64> {
    let is_fresh = envelope.input_tick[input] == envelope.tick;
    let (from, to) = (envelope.stamps_of(from), envelope.stamps_of(to));
    let hop_us = us(to.receive_ns, from.send_ns);
    Some(if is_fresh { hop_us } else { f64::NAN })
}

/// From one instant to a later one [us]; below 0 where it is earlier.
fn us(to_ns: u64, from_ns: u64) -> f64 {
    to_ns.wrapping_sub(from_ns).cast_signed() as f64 / 1e3
}
