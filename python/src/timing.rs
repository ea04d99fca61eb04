//! Latencies tick by tick, from the stamps of a log's messages; the names are those of the report's series.

use messages::grid::{Grid, Pace};
use messages::header::Header;
use messages::role::{Role, STAGES};

use crate::columns::Column;
use crate::table::Table;

const GROUP: &str = "timing";

/// The latencies of a flight.
#[derive(Debug)]
pub(crate) struct Timing {
    /// None in lockstep, where ticks have no place on the clock.
    grid: Option<Grid>,
    /// By stage.
    tables: [Table; STAGES.len()],
}

impl Timing {
    /// Of a flight at a pace, before its first message.
    pub(crate) fn of(pace: Pace) -> Self {
        let grid = match pace {
            Pace::Realtime(grid) => Some(grid),
            Pace::Lockstep => None,
        };
        let on_clock = |name: &str| grid.map(|_| name.to_owned());
        let table = |names: Vec<Option<String>>| {
            let columns = names.into_iter().flatten().map(|name| Column {
                group: GROUP.into(),
                name: format!("{name}_us"),
                unit: "us".into(),
                width: None,
                values: Vec::new(),
            });
            Table::of_columns(columns.collect())
        };
        let each = |role: Role, hop: Option<&str>| {
            vec![
                on_clock(&format!("wake_{role}")),
                Some(format!("compute_{role}")),
                hop.map(str::to_owned),
            ]
        };
        let [plant, outer, inner, mixer] = STAGES;
        let plant = [vec![on_clock("timer")], each(plant, None)].concat();
        let mixer = [
            each(mixer, Some("hop_inner_mixer")),
            vec![Some("loop".into()), on_clock("slack")],
        ]
        .concat();
        let outer = each(outer, Some("hop_plant_outer"));
        let inner = each(inner, Some("hop_outer_inner"));
        Self {
            grid,
            tables: [plant, outer, inner, mixer].map(table),
        }
    }

    pub(crate) fn state(&mut self, envelope: &Header) {
        let timer = self.grid.map(|_| us(envelope.timer_late_ns, 0));
        let row = [vec![timer], self.each(Role::Plant, envelope)].concat();
        self.push(Role::Plant, envelope.tick, row);
    }

    pub(crate) fn setpoint(&mut self, envelope: &Header) {
        let row = [
            self.each(Role::Outer, envelope),
            vec![hop(Role::Plant, Role::Outer, 0, envelope)],
        ]
        .concat();
        self.push(Role::Outer, envelope.tick, row);
    }

    pub(crate) fn wrench(&mut self, envelope: &Header) {
        let row = [
            self.each(Role::Inner, envelope),
            vec![hop(Role::Outer, Role::Inner, 1, envelope)],
        ]
        .concat();
        self.push(Role::Inner, envelope.tick, row);
    }

    pub(crate) fn rotor_speeds(&mut self, envelope: &Header) {
        let sent_ns = envelope.stamps_of(Role::Mixer).send_ns;
        let whole = if envelope.sample_ns > 0 {
            us(sent_ns, envelope.sample_ns)
        } else {
            f64::NAN
        };
        let slack = self
            .grid
            .map(|grid| us(grid.begin_of(envelope.tick + 1), sent_ns));
        let hop = hop(Role::Inner, Role::Mixer, 2, envelope);
        let row = [
            self.each(Role::Mixer, envelope),
            vec![hop, Some(whole), slack],
        ]
        .concat();
        self.push(Role::Mixer, envelope.tick, row);
    }

    pub(crate) fn into_tables(self) -> Vec<Table> {
        self.tables.into()
    }

    /// What every stage has: how late it woke, and how long it took.
    fn each(&self, role: Role, envelope: &Header) -> Vec<Option<f64>> {
        let stamps = envelope.stamps_of(role);
        let wake = self
            .grid
            .map(|grid| us(stamps.receive_ns, grid.begin_of(envelope.tick)));
        vec![wake, Some(us(stamps.send_ns, stamps.receive_ns))]
    }

    fn push(&mut self, role: Role, tick: u64, row: Vec<Option<f64>>) {
        self.tables[role as usize].push_row(tick, row.into_iter().flatten());
    }
}

/// From one stage's publishing to the next one's having the message in hand; no number where that was of another tick.
fn hop(from: Role, to: Role, input: usize, envelope: &Header) -> Option<f64> {
    let is_fresh = envelope.input_tick[input] == envelope.tick;
    let ns = us(
        envelope.stamps_of(to).receive_ns,
        envelope.stamps_of(from).send_ns,
    );
    Some(if is_fresh { ns } else { f64::NAN })
}

/// From one instant to a later one [us]; below 0 where it is earlier.
fn us(to_ns: u64, from_ns: u64) -> f64 {
    to_ns.wrapping_sub(from_ns).cast_signed() as f64 / 1e3
}
