//! A law continues from its saved state as the one that was saved flies on, to the last bit of output and telemetry.

use std::sync::Arc;

use control_api::description::{Description, Settings};
use control_api::guard::{Guarded, Memory};
use control_api::law::CopyState;
use control_api::registry::Made;
use control_api::{GuardedInner, GuardedMixer, GuardedOuter, Rig, SavedState};
use controller::laws::{INNER, OUTER};
use messages::content::{Measured, Reference, Setpoint, Stamped, State, Wrench};
use messages::layout::Visit;
use messages::parameters::Airframe;
use proptest::prelude::*;

/// Inputs of one tick; each role takes its part.
#[derive(Clone, Debug)]
struct Inputs {
    tick: u64,
    state: Stamped<State>,
    setpoint: Stamped<Setpoint>,
    wrench: Stamped<Wrench>,
}

/// Ticks skipped, which messages arrive, whether a number in each is NaN, and the others, from -1 to 1.
type Drawn = (u64, [bool; 2], bool, [f64; 12]);

fn flight() -> impl Strategy<Value = Vec<Inputs>> {
    let skipped = prop_oneof![95 => Just(0_u64), 3 => 1_u64..200, 2 => 200_u64..1500];
    let arrives = [prop::bool::weighted(0.8), prop::bool::weighted(0.8)];
    let is_nan = prop::bool::weighted(0.1);
    let drawn = (skipped, arrives, is_nan, prop::array::uniform12(-1.0..1.0));
    let never_come = [prop::bool::weighted(0.1), prop::bool::weighted(0.1)];
    (never_come, prop::collection::vec(drawn, 20..200)).prop_map(inputs)
}

fn inputs((never_come, drawn): ([bool; 2], Vec<Drawn>)) -> Vec<Inputs> {
    let mut inputs = Inputs {
        tick: 0,
        state: Stamped::never(),
        setpoint: Stamped::never(),
        wrench: Stamped::never(),
    };
    let next = |(skipped, [state_comes, rest_comes], is_nan, numbers): Drawn| {
        let tick = inputs.tick + 1 + skipped;
        inputs.tick = tick;
        let [a, b, c, d, e, f, g, ..] = numbers;
        let bad = if is_nan { f64::NAN } else { 0.0 };
        let speed = [d, e, f, g].map(|x| Airframe::nominal().hover_speed_rad_s() * (1.0 + 0.3 * x));
        if state_comes && !never_come[0] {
            let measured = Measured {
                position_w_m: [a, b, c + bad],
                velocity_w_m_s: [d, e, f],
                attitude_rad: [0.5 * g, 0.5 * a, b],
                attitude_quaternion: [1.0, 0.5 * e, 0.5 * f, g],
                rate_b_rad_s: [3.0 * d, 3.0 * e, 3.0 * f],
                rotor_speed_mean_rad_s: speed,
                rotor_speed_squared_mean_rad2_s2: speed.map(|w| w * w),
                rotor_speed_command_rad_s: speed,
                ..Measured::default()
            };
            let content = State {
                measured,
                ..State::default()
            };
            inputs.state = Stamped::new(tick, content);
        }
        if rest_comes && !never_come[1] {
            let [.., a, b, c, d, e] = numbers;
            let setpoint = Setpoint {
                thrust_n: 6.0 + a + bad,
                attitude_rad: [0.5 * b, 0.5 * c, d],
                attitude_rate_rad_s: [e, d, c],
                reference: reference(tick),
                ..Setpoint::default()
            };
            inputs.setpoint = Stamped::new(tick, setpoint);
            let wrench = Wrench {
                thrust_n: 6.0 + a,
                torque_b_nm: [b, c, d],
                ..Wrench::default()
            };
            inputs.wrench = Stamped::new(tick, wrench);
        }
        inputs.clone()
    };
    drawn.into_iter().map(next).collect()
}

fn reference(tick: u64) -> Reference {
    Reference {
        position_w_m: [(tick as f64 * 1e-3).sin(), 0.0, 1.0],
        yaw_rad: tick as f64 * 1e-4,
        ..Reference::default()
    }
}

/// Flies half of a flight, saves the law, and loads the state into a new law and into one that has flown on, with
/// more measurements.
fn assert_continues<L: CopyState + ?Sized, M: Memory, O: Visit>(
    law: &Description,
    flight: &[Inputs],
    make: impl Fn() -> Guarded<L, M>,
    tick: impl Fn(&mut Guarded<L, M>, &Inputs) -> O,
) {
    let (before, after) = flight.split_at(flight.len() / 2);
    let [mut saved, mut fresh, mut flown] = [make(), make(), make()];
    before.iter().for_each(|inputs| {
        tick(&mut saved, inputs);
    });
    after.iter().cloned().for_each(|mut inputs| {
        inputs.state.tick = inputs.tick;
        tick(&mut flown, &inputs);
    });
    let (mut state, mut again) = (SavedState::new(), SavedState::new());
    assert!(saved.save(&mut state), "{}", law.name);
    for other in [&mut fresh, &mut flown] {
        assert!(other.load(&state) && other.save(&mut again), "{}", law.name);
        assert_eq!(state, again, "{}", law.name);
    }
    for inputs in after {
        let expected = tick(&mut saved, inputs);
        for other in [&mut fresh, &mut flown] {
            let is_same = tick(other, inputs).is_same(&expected);
            assert!(is_same, "{} at tick {}", law.name, inputs.tick);
        }
    }
}

fn outer(made: Made<dyn control_api::law::OuterLaw>) -> GuardedOuter {
    GuardedOuter::new(made, Arc::new(reference), &Rig::default())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn every_law_continues_from_its_saved_state(flight in flight()) {
        let (rig, settings) = (Rig::default(), Settings::default());
        for law in OUTER {
            let make = || outer(law.make(&rig, &settings).unwrap());
            assert_continues(law.description, &flight, make, |law, inputs| {
                law.tick(inputs.tick, &inputs.state).unwrap_or_default()
            });
        }
        for law in INNER {
            let make = || GuardedInner::new(law.make(&rig, &settings).unwrap(), &rig);
            assert_continues(law.description, &flight, make, |law, inputs| {
                law.tick(inputs.tick, &inputs.state, &inputs.setpoint)
            });
        }
        for law in mixer::LAWS {
            let make = || GuardedMixer::new(law.make(&rig, &settings).unwrap(), &rig);
            assert_continues(law.description, &flight, make, |law, inputs| {
                law.tick(inputs.tick, &inputs.wrench)
            });
        }
    }
}

#[test]
fn the_state_of_another_law_version_or_length_is_refused_and_changes_nothing() {
    let (rig, settings) = (Rig::default(), Settings::default());
    let save = |law: &mut GuardedInner| {
        let mut state = SavedState::new();
        assert!(law.save(&mut state));
        state
    };
    for (i, law) in INNER.iter().enumerate() {
        let make = || law.make(&rig, &settings).unwrap();
        let mut flown = GuardedInner::new(make(), &rig);
        let mut state = crate::state(1);
        state.content.measured.position_w_m = [0.0, 0.0, 0.5];
        flown.tick(1, &state, &crate::setpoint(1));
        let good = save(&mut flown);
        let [mut cut, mut longer] = [good.clone(), good.clone()];
        cut.pop();
        longer.push(0).unwrap();
        let newer = Description {
            version: "new",
            ..*law.description
        };
        let state_hash = newer.state_hash();
        let mut newer = GuardedInner::new(
            Made {
                state_hash,
                ..make()
            },
            &rig,
        );
        let other = INNER[(i + 1) % INNER.len()].make(&rig, &settings);
        let mut other = GuardedInner::new(other.unwrap(), &rig);
        let mut law = GuardedInner::new(make(), &rig);
        let before = save(&mut law);
        // The law's own fields stand last.
        assert_ne!(before.last_chunk::<8>(), good.last_chunk());
        for wrong in [
            cut,
            longer,
            save(&mut newer),
            save(&mut other),
            SavedState::new(),
        ] {
            assert!(!law.load(&wrong));
            assert_eq!(save(&mut law), before);
        }
        assert!(law.load(&good));
    }
}
