//! When a swap of parameters holds.

use super::{fly, plant};
use messages::content::{Change, State};
use messages::parameters::{Airframe, Parameter};
use plant::swap::PENDING_SWAPS;
use plant::{Swap, SwapError};

#[test]
fn a_swap_holds_from_its_tick_on_and_all_of_it_together() {
    use Parameter::{Mass, RotationalDrag};
    let mut plant = plant();
    let swap = Swap::new(5, &[(Mass, 0.6), (RotationalDrag, 0.525)]).unwrap();
    assert_eq!(plant.schedule(swap), Ok(5));
    for tick in 0..5 {
        let state = fly(&mut plant, tick);
        assert_eq!(
            (state.parameter_epoch, state.truth.get(RotationalDrag)),
            (0, 0.105)
        );
        assert_eq!(plant.airframe(), &Airframe::nominal());
        assert!(plant.applied().is_empty());
    }
    let state = plant.begin(5);
    assert_eq!(
        (state.parameter_epoch, state.truth.get(RotationalDrag)),
        (1, 0.525)
    );
    assert_eq!((plant.airframe().m(), plant.airframe().k_r()), (0.6, 0.525));
    let [applied] = plant.applied() else {
        panic!("{:?}", plant.applied())
    };
    assert_eq!((applied.tick, applied.epoch), (5, 1));
    assert_eq!(
        applied.changes.as_slice(),
        [
            Change {
                parameter: Mass,
                old: 0.52,
                new: 0.6,
                steps: 1
            },
            Change {
                parameter: RotationalDrag,
                old: 0.105,
                new: 0.525,
                steps: 1
            }
        ]
    );
    plant.finish();
    plant.begin(6);
    assert!(plant.applied().is_empty());
}

#[test]
fn a_swap_for_a_tick_that_has_begun_is_for_the_next() {
    let mass = |tick, value| Swap::new(tick, &[(Parameter::Mass, value)]).unwrap();
    let mut plant = plant();
    assert_eq!(
        plant.schedule(mass(0, 0.55)),
        Ok(0),
        "tick 0 is still to come"
    );
    for tick in 0..10 {
        fly(&mut plant, tick);
    }
    assert_eq!(plant.airframe().m(), 0.55);
    assert_eq!(
        plant.schedule(mass(10, 0.6)),
        Ok(10),
        "tick 9 is finished, tick 10 has not begun"
    );
    plant.begin(10);
    assert_eq!(plant.airframe().m(), 0.6);
    assert_eq!(plant.schedule(mass(10, 0.7)), Ok(11));
    assert_eq!(plant.schedule(mass(2, 0.8)), Ok(11));
    assert_eq!(plant.airframe().m(), 0.6);
    plant.begin(11);
    assert_eq!(
        plant.airframe().m(),
        0.8,
        "the later arrival is applied last"
    );
    let epochs: Vec<_> = plant
        .applied()
        .iter()
        .map(|swap| (swap.tick, swap.epoch))
        .collect();
    assert_eq!(epochs, [(11, 3), (11, 4)]);
    assert_eq!(plant.parameter_epoch(), 4);
}

#[test]
fn a_swap_of_a_skipped_tick_holds_from_that_tick_on() {
    let drag = |tick| Swap::new(tick, &[(Parameter::RotationalDrag, 0.525)]).unwrap();
    let mut skipping = plant();
    let mut steady = plant();
    for plant in [&mut skipping, &mut steady] {
        plant.schedule(drag(7)).unwrap();
    }
    for tick in 0..10 {
        steady.begin(tick);
        steady.finish();
    }
    skipping.begin(4);
    skipping.finish();
    let state = skipping.begin(10);
    assert_eq!(
        state,
        State {
            ticks_skipped: 9,
            ..steady.begin(10)
        }
    );
    assert_eq!(
        skipping
            .applied()
            .iter()
            .map(|swap| swap.tick)
            .collect::<Vec<_>>(),
        [7]
    );
}

#[test]
fn refused_swaps_change_nothing() {
    let mut plant = plant();
    let mut unchecked = Swap::new(0, &[(Parameter::Mass, 0.6)]).unwrap();
    unchecked.targets[0].value = f64::NAN;
    assert!(matches!(
        plant.schedule(unchecked),
        Err(SwapError::Value(_))
    ));
    for tick in 0..PENDING_SWAPS as u64 {
        plant
            .schedule(Swap::new(tick + 1, &[(Parameter::Mass, 0.6)]).unwrap())
            .unwrap();
    }
    assert_eq!(
        plant.schedule(Swap::new(1, &[(Parameter::Mass, 0.7)]).unwrap()),
        Err(SwapError::Full)
    );
    assert_eq!(plant.begin(0).parameter_epoch, 0);
    assert_eq!(plant.airframe(), &Airframe::nominal());
    assert_eq!(
        plant.begin(PENDING_SWAPS as u64).parameter_epoch,
        PENDING_SWAPS as u64
    );
    assert_eq!(plant.applied().len(), PENDING_SWAPS);
}
