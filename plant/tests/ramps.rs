//! Ramps: the value at every tick, what replaces one, and that one of a tick is a swap.

use messages::content::{Change, RotorSpeeds, Stamped, State};
use messages::parameters::{Airframe, Parameter};
use plant::parameter_server::swap_record;
use plant::{Plant, PlantSettings, Swap, SwapError, Target};
use proptest::prelude::*;

fn ramp(tick: u64, value: f64, steps: u64) -> Swap {
    Swap::to(
        tick,
        &[Target {
            parameter: Parameter::Mass,
            value,
            steps,
        }],
    )
    .unwrap()
}

fn fly(plant: &mut Plant, tick: u64) -> State {
    let state = plant.begin(tick);
    let speed_rad_s = [Airframe::nominal().hover_speed_rad_s(); 4];
    plant.offer(
        &Stamped {
            tick,
            content: RotorSpeeds {
                speed_rad_s,
                ..RotorSpeeds::default()
            },
        },
        tick + 1,
    );
    plant.finish();
    state
}

/// The mass in every tick up to the last.
fn masses(swaps: &[Swap], last_tick: u64) -> Vec<f64> {
    let mut plant = Plant::new(&PlantSettings::default());
    for swap in swaps {
        plant.schedule(swap.clone()).unwrap();
    }
    (0..=last_tick)
        .map(|tick| fly(&mut plant, tick).truth.get(Parameter::Mass))
        .collect()
}

#[test]
fn a_ramp_takes_its_first_step_at_its_tick_and_ends_on_its_target() {
    let flown = masses(&[ramp(10, 0.72, 4)], 20);
    assert_eq!(flown[..10], [0.52; 10]);
    for (step, mass_kg) in [(1.0, flown[10]), (2.0, flown[11]), (3.0, flown[12])] {
        assert!(
            (mass_kg - (0.52 + 0.05 * step)).abs() < 1e-15,
            "{mass_kg} after step {step}"
        );
    }
    assert_eq!(flown[13..], [0.72; 8]);
}

#[test]
fn a_ramp_is_one_swap_whatever_its_length() {
    let mut plant = Plant::new(&PlantSettings::default());
    plant.schedule(ramp(5, 0.6, 1000)).unwrap();
    let mut records = Vec::new();
    for tick in 0..=1100 {
        let state = plant.begin(tick);
        records.extend(plant.applied().to_vec());
        assert_eq!(state.parameter_epoch, u64::from(tick >= 5));
        assert_eq!(
            plant.changed_tick().is_some(),
            (5..1005).contains(&tick),
            "tick {tick}"
        );
        plant.finish();
    }
    let [applied] = records.as_slice() else {
        panic!("{records:?}")
    };
    let change = Change {
        parameter: Parameter::Mass,
        old: 0.52,
        new: 0.6,
        steps: 1000,
    };
    assert_eq!(
        (applied.tick, applied.epoch, applied.changes.as_slice()),
        (5, 1, [change].as_slice())
    );
    assert_eq!(swap_record(applied).changes().collect::<Vec<_>>(), [change]);
}

#[test]
fn a_later_swap_replaces_what_is_left_of_a_ramp_and_starts_from_what_held() {
    let swapped = masses(&[ramp(10, 0.72, 100), ramp(60, 0.4, 1)], 200);
    assert_eq!((swapped[59], &swapped[60..]), (0.62, [0.4; 141].as_slice()));
    let turned = masses(&[ramp(10, 0.72, 100), ramp(60, 0.52, 50)], 200);
    assert_eq!((turned[59], turned[109]), (0.62, 0.52));
    assert!(
        (turned[84] - 0.57).abs() < 1e-15,
        "halfway back: {}",
        turned[84]
    );
    assert_eq!(turned[109..], [0.52; 92], "the first ramp does not go on");
    // Another parameter's swap does.
    let drag = Swap::new(60, &[(Parameter::RotationalDrag, 0.2)]).unwrap();
    assert_eq!(
        masses(&[ramp(10, 0.72, 100), drag], 200),
        masses(&[ramp(10, 0.72, 100)], 200)
    );
}

#[test]
fn what_is_skipped_of_a_ramp_is_flown_like_the_rest() {
    let mut steady = Plant::new(&PlantSettings::default());
    let mut skipping = steady.clone();
    for plant in [&mut steady, &mut skipping] {
        plant.schedule(ramp(7, 0.6, 10)).unwrap();
    }
    for tick in 0..12 {
        steady.begin(tick);
        steady.finish();
    }
    let state = skipping.begin(12);
    assert_eq!(
        state,
        State {
            ticks_skipped: 12,
            ..steady.begin(12)
        }
    );
    assert_eq!(skipping.changed_tick(), Some(12));
}

#[test]
fn a_ramp_beyond_the_airframes_range_is_refused_before_it_begins() {
    let mut plant = Plant::new(&PlantSettings::default());
    assert!(matches!(
        plant.schedule(ramp(0, 400.0, 100)),
        Err(SwapError::Value(_))
    ));
    let mut unchecked = ramp(0, 0.6, 100);
    unchecked.targets[0].steps = 0;
    assert_eq!(
        plant.schedule(unchecked),
        Err(SwapError::Steps {
            parameter: Parameter::Mass,
            steps: 0
        })
    );
    assert_eq!(masses(&[], 3), [0.52; 4]);
}

/// Any parameter, and a value of its range.
fn changes() -> impl Strategy<Value = (Parameter, f64)> {
    (0..messages::parameters::PARAMETERS as u64, 0.0..=1.0_f64).prop_map(|(index, share)| {
        let parameter = Parameter::from_index(index).unwrap();
        let spec = parameter.spec();
        (
            parameter,
            (spec.min + (spec.max - spec.min) * share).clamp(spec.min, spec.max),
        )
    })
}

proptest! {
    #[test]
    fn a_ramp_of_one_tick_is_a_swap((parameter, value) in changes(), tick in 0_u64..8) {
        let mut swapped = Plant::new(&PlantSettings::default());
        let mut ramped = swapped.clone();
        swapped.schedule(Swap::new(tick, &[(parameter, value)]).unwrap()).unwrap();
        ramped.schedule(Swap::to(tick, &[Target { parameter, value, steps: 1 }]).unwrap()).unwrap();
        for tick in 0..10 {
            // A flight with hardly any inertia is soon no number, which equals nothing.
            let (swapped_state, ramped_state) = (fly(&mut swapped, tick), fly(&mut ramped, tick));
            prop_assert_eq!(format!("{swapped_state:?}"), format!("{ramped_state:?}"));
            prop_assert_eq!(swapped.applied(), ramped.applied());
        }
    }

    #[test]
    fn a_ramp_stays_between_its_ends_and_never_turns((parameter, value) in changes(), steps in 1_u64..200) {
        let mut plant = Plant::new(&PlantSettings::default());
        plant.schedule(Swap::to(3, &[Target { parameter, value, steps }]).unwrap()).unwrap();
        let start = parameter.spec().nominal;
        let mut before = start;
        for tick in 0..steps + 3 {
            plant.begin(tick);
            let now = plant.airframe().get(parameter);
            prop_assert!((start.min(value)..=start.max(value)).contains(&now));
            prop_assert!((now - before) * (value - start) >= 0.0, "{before} to {now} on the way to {value}");
            before = now;
            plant.finish();
        }
        prop_assert_eq!(before, value);
    }
}
