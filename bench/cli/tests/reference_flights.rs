//! Four flights of 20 s against the reference flights of an independent implementation, column by column.

use crate::c_laws::root;
use crate::reference_laws;
use analysis::states::Joined;
use controller::laws::adaptive;
use controller::{Gains, Trajectory};
use messages::parameters::Parameter;
use plant::Swap;
use sim::simulator::Simulator;

const PERIOD_S: f64 = 0.001;
const LAST_TICK: u64 = 20_000;
const TICKS_PER_ROW: u64 = 50;

/// Columns, their tolerance, and where a record has them.
type Group = (&'static str, f64, fn(&Joined) -> Vec<f64>);

/// Seconds, metres, radians, newtons, newton metres.
const GROUPS: [Group; 8] = [
    ("t", 1e-12, |it| vec![it.tick as f64 * PERIOD_S]),
    ("x y z vx vy vz phi theta psi", 1e-9, |it| {
        let measured = &it.state.measured;
        let (position, velocity) = (measured.position_w_m, measured.velocity_w_m_s);
        [position, velocity, measured.attitude_rad].concat()
    }),
    ("p q r", 1e-9, |it| it.state.measured.rate_b_rad_s.to_vec()),
    ("IR_hat kr_hat delta_hat", 1e-9, |it| {
        adaptive::estimate(&it.wrench.unwrap().telemetry).to_vec()
    }),
    ("w1 w2 w3 w4", 1e-6, |it| {
        it.rotor_speeds.unwrap().speed_rad_s.to_vec()
    }),
    ("u tau_p tau_q tau_r", 1e-8, |it| {
        let wrench = it.wrench.unwrap();
        [&[wrench.thrust_n], &wrench.torque_b_nm[..]].concat()
    }),
    ("e_p e_q e_r", 1e-9, |it| {
        adaptive::rate_error(&it.wrench.unwrap().telemetry).to_vec()
    }),
    ("xd yd zd psid", 1e-9, |it| {
        let reference = it.setpoint.unwrap().reference;
        [&reference.position_w_m[..], &[reference.yaw_rad]].concat()
    }),
];

fn compare(trajectory: Trajectory, preset: &str, swap: Option<Swap>, file: &str) {
    let rig = control_api::Rig {
        period_s: PERIOD_S,
        ..control_api::Rig::default()
    };
    let gains = Gains::preset(preset).unwrap();
    let (outer, inner, mixer) = reference_laws::stages(&rig, trajectory, &gains);
    let plant = plant::PlantSettings {
        period_s: PERIOD_S,
        airframe: rig.airframe,
        rotor: rig.rotor,
        seed: 0,
        ..plant::PlantSettings::default()
    };
    let mut flight = Simulator::new(&plant, outer, inner, mixer);
    if let Some(swap) = swap {
        assert_eq!(flight.plant_mut().schedule(swap), Ok(8000));
    }
    let path = root().join("shared/reference").join(file);
    let mut reader = csv::Reader::from_path(path).unwrap();
    let columns: Vec<String> = reader
        .headers()
        .unwrap()
        .iter()
        .map(str::to_owned)
        .collect();
    let groups = GROUPS.map(|(names, ..)| names).join(" ");
    assert_eq!(columns.join(" "), groups, "columns of {file}");
    let tolerances = GROUPS
        .iter()
        .flat_map(|(names, tolerance, _)| names.split(' ').map(move |_| *tolerance));
    let tolerances: Vec<f64> = tolerances.collect();
    let mut rows = reader.deserialize::<Vec<f64>>();
    for tick in 0..=LAST_TICK {
        flight.tick();
        assert_eq!(flight.plant().envelope(), Ok(()));
        if tick % TICKS_PER_ROW != 0 {
            continue;
        }
        let record = flight.joined();
        let expected = rows.next().expect("a row for every 50 ticks").unwrap();
        let values: Vec<f64> = GROUPS
            .iter()
            .flat_map(|(.., values)| values(&record))
            .collect();
        assert_eq!(values.len(), columns.len());
        for (i, (value, expected)) in values.iter().zip(&expected).enumerate() {
            let error = (value - expected).abs();
            assert!(
                error <= tolerances[i],
                "{file}, tick {tick}, column {}: {value} is not {expected}, off by {error:e}",
                columns[i]
            );
        }
    }
    assert!(
        rows.next().is_none(),
        "{file} goes on after tick {LAST_TICK}"
    );
}

#[test]
fn flights_are_those_of_the_independent_implementation() {
    let drag = Swap::new(8000, &[(Parameter::RotationalDrag, 0.525)]).unwrap();
    let lissajous = Trajectory::Lissajous;
    compare(lissajous, "flight", None, "flight_lissajous.csv");
    compare(lissajous, "flight", Some(drag), "flight_lissajous_swap.csv");
    compare(lissajous, "paper", None, "paper_lissajous.csv");
    compare(Trajectory::Step, "flight", None, "flight_step.csv");
}
