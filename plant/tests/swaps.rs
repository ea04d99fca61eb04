//! Swaps and ramps: when they hold, what replaces a ramp, what is refused, and that a ramp of one tick is a swap.

use messages::content::{Change, State};
use messages::parameters::{Airframe, Parameter, ParameterError};
use plant::swap::PENDING_SWAPS;
use plant::{Plant, PlantSettings, Swap, SwapError, Target};
use proptest::prelude::*;

use crate::{fly, fly_at, hover, miss, plant};

fn ramp_of(tick: u64, parameter: Parameter, value: f64, steps: u64) -> Swap {
    let target = Target {
        parameter,
        value,
        steps,
    };
    Swap::to(tick, &[target]).unwrap()
}

/// A ramp of the mass.
fn ramp(tick: u64, value: f64, steps: u64) -> Swap {
    ramp_of(tick, Parameter::Mass, value, steps)
}

fn change(parameter: Parameter, old: f64, new: f64, steps: u64) -> Change {
    Change {
        parameter,
        old,
        new,
        steps,
    }
}

/// The mass in every tick up to the last.
fn masses(swaps: &[Swap], last_tick: u64) -> Vec<f64> {
    let mut plant = plant();
    for swap in swaps {
        plant.schedule(swap.clone()).unwrap();
    }
    let mass = |tick| fly_at(&mut plant, tick, hover()).truth.get(Parameter::Mass);
    (0..=last_tick).map(mass).collect()
}

#[test]
fn a_swap_holds_from_its_tick_on_and_all_of_it_together() {
    use Parameter::{Mass, RotationalDrag};
    let mut plant = plant();
    let swap = Swap::new(5, &[(Mass, 0.6), (RotationalDrag, 0.525)]).unwrap();
    assert_eq!(plant.schedule(swap), Ok(5));
    let seen = |state: &State| (state.parameter_epoch, state.truth.get(RotationalDrag));
    for tick in 0..5 {
        assert_eq!(seen(&fly(&mut plant, tick)), (0, 0.105));
        assert_eq!(plant.airframe(), &Airframe::nominal());
        assert!(plant.applied().is_empty());
    }
    assert_eq!(seen(&plant.begin(5)), (1, 0.525));
    assert_eq!((plant.airframe().m(), plant.airframe().k_r()), (0.6, 0.525));
    let [applied] = plant.applied() else {
        panic!("{:?}", plant.applied())
    };
    let changes = [
        change(Mass, 0.52, 0.6, 1),
        change(RotationalDrag, 0.105, 0.525, 1),
    ];
    assert_eq!((applied.tick, applied.epoch), (5, 1));
    assert_eq!(applied.changes.as_slice(), changes);
    plant.finish();
    plant.begin(6);
    assert!(plant.applied().is_empty());
}

#[test]
fn a_swap_for_a_tick_that_has_begun_is_for_the_next() {
    let mass = |tick, value| Swap::new(tick, &[(Parameter::Mass, value)]).unwrap();
    let mut plant = plant();
    assert_eq!(plant.schedule(mass(0, 0.55)), Ok(0), "tick 0 is to come");
    for tick in 0..10 {
        fly(&mut plant, tick);
    }
    assert_eq!(plant.airframe().m(), 0.55);
    assert_eq!(plant.schedule(mass(10, 0.6)), Ok(10), "tick 9 is finished");
    plant.begin(10);
    assert_eq!(plant.schedule(mass(10, 0.7)), Ok(11));
    assert_eq!(plant.schedule(mass(2, 0.8)), Ok(11));
    assert_eq!(plant.airframe().m(), 0.6);
    plant.begin(11);
    // The later arrival is applied last.
    assert_eq!((plant.airframe().m(), plant.parameter_epoch()), (0.8, 4));
    let applied = plant.applied().iter().map(|swap| (swap.tick, swap.epoch));
    assert!(applied.eq([(11, 3), (11, 4)]));
}

#[test]
fn what_is_skipped_of_swaps_and_ramps_holds_all_the_same() {
    for (swap, applied) in [(ramp(7, 0.6, 1), 7), (ramp(7, 0.6, 10), 7)] {
        let (mut skipping, mut steady) = (plant(), plant());
        for plant in [&mut skipping, &mut steady] {
            plant.schedule(swap.clone()).unwrap();
        }
        for tick in 0..12 {
            miss(&mut steady, tick);
        }
        miss(&mut skipping, 4);
        let expected = State {
            ticks_skipped: 11,
            ..steady.begin(12)
        };
        assert_eq!(skipping.begin(12), expected);
        let mut ticks = skipping.applied().iter().map(|swap| swap.tick);
        assert!(ticks.by_ref().eq([applied]));
    }
}

#[test]
fn refused_swaps_change_nothing() {
    let mut plant = plant();
    let swap = |tick, value| Swap::new(tick, &[(Parameter::Mass, value)]).unwrap();
    let mut unchecked = swap(0, 0.6);
    unchecked.targets[0].value = f64::NAN;
    assert!(matches!(
        plant.schedule(unchecked),
        Err(SwapError::Value(_))
    ));
    let beyond = plant.schedule(ramp(0, 400.0, 100));
    assert!(matches!(beyond, Err(SwapError::Value(_))));
    let mut unchecked = ramp(0, 0.6, 100);
    unchecked.targets[0].steps = 0;
    let (parameter, steps) = (Parameter::Mass, 0);
    let refused = Err(SwapError::Steps { parameter, steps });
    assert_eq!(plant.schedule(unchecked), refused);
    let pending = PENDING_SWAPS as u64;
    for tick in 1..=pending {
        plant.schedule(swap(tick, 0.6)).unwrap();
    }
    assert_eq!(plant.schedule(swap(1, 0.7)), Err(SwapError::Full));
    assert_eq!(plant.begin(0).parameter_epoch, 0);
    assert_eq!(plant.airframe(), &Airframe::nominal());
    assert_eq!(plant.begin(pending).parameter_epoch, pending);
    assert_eq!(plant.applied().len(), PENDING_SWAPS);

    let mut values = *Airframe::nominal().values();
    values[Parameter::Mass as usize] = 0.027;
    let airframe = Airframe::built_with(values).unwrap();
    let mut small = Plant::new(&PlantSettings {
        airframe,
        ..PlantSettings::default()
    });
    let refused = small.schedule(swap(0, 0.52)).unwrap_err();
    let is_range = matches!(
        refused,
        SwapError::Value(ParameterError::OutOfRange { parameter, .. }) if parameter == Parameter::Mass
    );
    assert!(is_range, "{refused}");
    small.schedule(swap(0, 0.03)).unwrap();
    small.begin(0);
    assert_eq!((small.airframe().m(), small.parameter_epoch()), (0.03, 1));
    assert_eq!(small.airframe().as_built(), airframe);
}

#[test]
fn a_ramp_takes_its_first_step_at_its_tick_and_ends_on_its_target() {
    let flown = masses(&[ramp(10, 0.72, 4)], 20);
    assert_eq!(
        (&flown[..10], &flown[13..]),
        (&[0.52; 10][..], &[0.72; 8][..])
    );
    for (mass_kg, expected) in flown[10..13].iter().zip([0.57, 0.62, 0.67]) {
        assert!(
            (mass_kg - expected).abs() < 1e-15,
            "{mass_kg} for {expected}"
        );
    }
}

#[test]
fn a_ramp_is_one_swap_whatever_its_length() {
    let mut plant = plant();
    plant.schedule(ramp(5, 0.6, 1000)).unwrap();
    let mut records = Vec::new();
    for tick in 0..=1100 {
        let state = plant.begin(tick);
        records.extend(plant.applied().to_vec());
        assert_eq!(state.parameter_epoch, u64::from(tick >= 5));
        let is_ramp = (5..1005).contains(&tick);
        assert_eq!(plant.changed_tick().is_some(), is_ramp, "tick {tick}");
        plant.finish();
    }
    let [applied] = records.as_slice() else {
        panic!("{records:?}")
    };
    let change = change(Parameter::Mass, 0.52, 0.6, 1000);
    assert_eq!((applied.tick, applied.epoch), (5, 1));
    assert_eq!(applied.changes.as_slice(), [change]);
    assert!(applied.record().changes().eq([change]));
}

#[test]
fn a_later_swap_replaces_what_is_left_of_a_ramp_and_starts_from_what_held() {
    let up = ramp(10, 0.72, 100);
    let swapped = masses(&[up.clone(), ramp(60, 0.4, 1)], 200);
    assert_eq!((swapped[59], &swapped[60..]), (0.62, [0.4; 141].as_slice()));
    let turned = masses(&[up.clone(), ramp(60, 0.52, 50)], 200);
    assert_eq!((turned[59], &turned[109..]), (0.62, [0.52; 92].as_slice()));
    let halfway_back = turned[84];
    assert!((halfway_back - 0.57).abs() < 1e-15, "{halfway_back}");
    // The swap of another parameter does not.
    let drag = Swap::new(60, &[(Parameter::RotationalDrag, 0.2)]).unwrap();
    assert_eq!(masses(&[up.clone(), drag], 200), masses(&[up], 200));
}

/// Any parameter, and a value of its range.
fn changes() -> impl Strategy<Value = (Parameter, f64)> {
    (0..messages::parameters::PARAMETERS as u64, 0.0..=1.0_f64).prop_map(|(index, share)| {
        let parameter = Parameter::from_index(index).unwrap();
        let spec = parameter.spec();
        let value = spec.min + (spec.max - spec.min) * share;
        (parameter, value.clamp(spec.min, spec.max))
    })
}

proptest! {
    #[test]
    fn a_ramp_of_one_tick_is_a_swap((parameter, value) in changes(), tick in 0_u64..8) {
        let (mut swapped, mut ramped) = (plant(), plant());
        swapped.schedule(Swap::new(tick, &[(parameter, value)]).unwrap()).unwrap();
        ramped.schedule(ramp_of(tick, parameter, value, 1)).unwrap();
        for tick in 0..10 {
            // A flight with hardly any inertia is soon no number, which equals nothing.
            let states = [&mut swapped, &mut ramped].map(|plant| format!("{:?}", fly_at(plant, tick, hover())));
            prop_assert_eq!(&states[0], &states[1]);
            prop_assert_eq!(swapped.applied(), ramped.applied());
        }
    }

    #[test]
    fn a_ramp_stays_between_its_ends_and_never_turns((parameter, value) in changes(), steps in 1_u64..200) {
        let mut plant = plant();
        plant.schedule(ramp_of(3, parameter, value, steps)).unwrap();
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
