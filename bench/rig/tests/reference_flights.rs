//! Four flights of 20 s against the reference flights, column by column.
//!
//! The references come from an independent implementation; a row every 50 ms (shared/reference).

use crate::reference_laws;
use controller::laws::adaptive;
use controller::{Gains, Trajectory};
use ironbird::simulator::Simulator;
use messages::parameters::Parameter;
use plant::Swap;
use report::states::TickRecord;

const PERIOD_S: f64 = 0.001;
const LAST_TICK: u64 = 20_000;
const TICKS_PER_ROW: u64 = 50;
const ROWS: usize = 401;

/// Columns with a tolerance in common.
struct Group {
    name: &'static str,
    columns: &'static [&'static str],
    tolerance: f64,
    values: fn(&TickRecord) -> Vec<f64>,
}

const GROUPS: [Group; 8] = [
    Group {
        name: "time [s]",
        columns: &["t"],
        tolerance: 1e-12,
        values: |record| vec![record.tick as f64 * PERIOD_S],
    },
    Group {
        name: "position, velocity, attitude [m, m/s, rad]",
        columns: &["x", "y", "z", "vx", "vy", "vz", "phi", "theta", "psi"],
        tolerance: 1e-9,
        values: |TickRecord { state, .. }| {
            [
                state.measured.position_w_m,
                state.measured.velocity_w_m_s,
                state.measured.attitude_rad,
            ]
            .concat()
        },
    },
    Group {
        name: "body rates [rad/s]",
        columns: &["p", "q", "r"],
        tolerance: 1e-9,
        values: |record| record.state.measured.rate_b_rad_s.to_vec(),
    },
    Group {
        name: "estimates",
        columns: &["IR_hat", "kr_hat", "delta_hat"],
        tolerance: 1e-9,
        values: |record| adaptive::estimate(&record.wrench.telemetry).to_vec(),
    },
    Group {
        name: "rotor speeds [rad/s]",
        columns: &["w1", "w2", "w3", "w4"],
        tolerance: 1e-6,
        values: |record| record.rotor_speeds.speed_rad_s.to_vec(),
    },
    Group {
        name: "thrust and torque [N, N m]",
        columns: &["u", "tau_p", "tau_q", "tau_r"],
        tolerance: 1e-8,
        values: |TickRecord { wrench, .. }| {
            [&[wrench.thrust_n], wrench.torque_b_nm.as_slice()].concat()
        },
    },
    Group {
        name: "rate error [rad/s]",
        columns: &["e_p", "e_q", "e_r"],
        tolerance: 1e-9,
        values: |record| adaptive::rate_error(&record.wrench.telemetry).to_vec(),
    },
    Group {
        name: "reference [m, rad]",
        columns: &["xd", "yd", "zd", "psid"],
        tolerance: 1e-9,
        values: |record| {
            let setpoint = record.setpoint.unwrap();
            [
                setpoint.reference.position_w_m.as_slice(),
                &[setpoint.reference.yaw_rad],
            ]
            .concat()
        },
    },
];

fn flight(trajectory: Trajectory, preset: &str) -> Simulator {
    let rig = control_api::Rig {
        period_s: PERIOD_S,
        ..control_api::Rig::default()
    };
    let (outer, inner, mixer) =
        reference_laws::stages(&rig, trajectory, &Gains::preset(preset).unwrap());
    let control_api::Rig {
        airframe, rotor, ..
    } = rig;
    let plant = plant::PlantSettings {
        period_s: PERIOD_S,
        airframe,
        rotor,
        seed: 0,
        ..plant::PlantSettings::default()
    };
    Simulator::new(&plant, outer, inner, mixer)
}

/// Flies on and compares every row of a reference; the largest error of each group.
fn compare(mut flight: Simulator, file: &str) -> [f64; GROUPS.len()] {
    let path = format!(
        "{}/../../shared/reference/{file}",
        env!("CARGO_MANIFEST_DIR")
    );
    let mut reader = csv::Reader::from_path(path).unwrap();
    let header = reader.headers().unwrap().clone();
    let columns: Vec<&str> = GROUPS
        .iter()
        .flat_map(|group| group.columns)
        .copied()
        .collect();
    assert_eq!(
        header.iter().collect::<Vec<_>>(),
        columns,
        "columns of {file}"
    );

    let mut worst = [0.0_f64; GROUPS.len()];
    let mut rows = 0;
    let mut records = reader.deserialize::<Vec<f64>>();
    for tick in 0..=LAST_TICK {
        flight.tick();
        let record = flight.record();
        assert_eq!(flight.plant().envelope(), Ok(()));
        if tick % TICKS_PER_ROW != 0 {
            continue;
        }
        let expected = records
            .next()
            .unwrap_or_else(|| panic!("{file} ends before tick {tick}"))
            .unwrap();
        let mut expected = expected.iter();
        for (group, worst) in GROUPS.iter().zip(&mut worst) {
            let values = (group.values)(&record);
            assert_eq!(values.len(), group.columns.len(), "{}", group.name);
            for ((column, value), expected) in group.columns.iter().zip(values).zip(&mut expected) {
                let error = (value - expected).abs();
                assert!(
                    error <= group.tolerance,
                    "{file}, row {rows} (tick {tick}), column {column}: {value} is not {expected}, off by {error:e}"
                );
                *worst = worst.max(error);
            }
        }
        rows += 1;
    }
    assert!(
        records.next().is_none(),
        "{file} goes on after tick {LAST_TICK}"
    );
    assert_eq!(rows, ROWS, "rows of {file}");
    worst
}

#[test]
fn lissajous_with_the_flight_gains() {
    compare(
        flight(Trajectory::Lissajous, "flight"),
        "flight_lissajous.csv",
    );
}

#[test]
fn step_with_the_flight_gains() {
    compare(flight(Trajectory::Step, "flight"), "flight_step.csv");
}

#[test]
fn lissajous_with_the_papers_gains() {
    compare(
        flight(Trajectory::Lissajous, "paper"),
        "paper_lissajous.csv",
    );
}

#[test]
fn lissajous_with_a_swap_of_the_rotational_drag() {
    let mut flight = flight(Trajectory::Lissajous, "flight");
    let swap = Swap::new(8000, &[(Parameter::RotationalDrag, 0.525)]).unwrap();
    assert_eq!(flight.plant_mut().schedule(swap), Ok(8000));
    compare(flight, "flight_lissajous_swap.csv");
}
