//! A law continues from its saved state as the one that was saved flies on, to the last bit of output and telemetry.

use std::sync::Arc;

use control_api::description::Settings;
use control_api::guard::Guarded;
use control_api::law::CopyState;
use control_api::saved_state::Field;
use control_api::{GuardedInner, GuardedMixer, GuardedOuter, Rig, SavedState};
use controller::laws::{INNER, OUTER};
use messages::content::{Reference, Setpoint, Stamped, State, Wrench};
use messages::layout::Visit;
use proptest::prelude::*;

/// The newest messages at a tick.
#[derive(Clone, Debug)]
struct Inputs {
    tick: u64,
    state: Stamped<State>,
    setpoint: Stamped<Setpoint>,
}

fn flight() -> impl Strategy<Value = Vec<Inputs>> {
    let ticks = prop_oneof![85 => Just(1_u64), 12 => 2_u64..90, 3 => 90_u64..1500];
    let bad = prop_oneof![9 => Just(0.0), 1 => Just(f64::NAN)];
    let arrive = [prop::bool::weighted(0.8), prop::bool::weighted(0.8)];
    let drawn = (ticks, arrive, -1.0..1.0, bad);
    let ever_arrive = [prop::bool::weighted(0.9), prop::bool::weighted(0.9)];
    let drawn = (ever_arrive, prop::collection::vec(drawn, 20..200));
    drawn.prop_map(|(ever_arrive, drawn)| {
        let mut inputs = Inputs {
            tick: 0,
            state: Stamped::never(),
            setpoint: Stamped::never(),
        };
        let next = |(ticks, arrive, x, bad): (u64, [bool; 2], f64, f64)| {
            inputs.tick += ticks;
            if arrive[0] && ever_arrive[0] {
                inputs.state = crate::state(inputs.tick);
                let measured = &mut inputs.state.content.measured;
                measured.position_w_m = [x, 1.0, x + bad];
                measured.velocity_w_m_s = [x, -x, x * x];
                measured.rate_b_rad_s = [x, x * x, -x];
                measured.rotor_speed_squared_mean_rad2_s2[0] *= 1.0 + x;
            }
            if arrive[1] && ever_arrive[1] {
                inputs.setpoint = crate::setpoint(inputs.tick);
                inputs.setpoint.content.thrust_n += x + bad;
                inputs.setpoint.content.attitude_rad = [0.5 * x, 0.2, x * x];
            }
            inputs.clone()
        };
        drawn.into_iter().map(next).collect()
    })
}

fn saved<L: CopyState + ?Sized, M: Field + Clone>(law: &mut Guarded<L, M>) -> SavedState {
    let mut state = SavedState::new();
    assert!(law.save(&mut state));
    state
}

/// Flies half of a flight, saves the law, and loads the state into a new law and into one that has flown on, with
/// more measurements.
fn assert_continues<L: CopyState + ?Sized, M: Field + Clone, O: Visit>(
    flight: &[Inputs],
    make: impl Fn() -> Guarded<L, M>,
    tick: impl Fn(&mut Guarded<L, M>, &Inputs) -> O,
) {
    let (before, after) = flight.split_at(flight.len() / 2);
    let [mut law, mut fresh, mut flown] = [make(), make(), make()];
    for inputs in before {
        tick(&mut law, inputs);
    }
    for mut inputs in after.iter().cloned() {
        inputs.state.tick = inputs.tick;
        tick(&mut flown, &inputs);
    }
    let (state, unused) = (saved(&mut law), saved(&mut fresh));
    let [mut of_another, mut longer] = [state.clone(), state.clone()];
    of_another[0] ^= 1;
    longer.push(0).unwrap();
    for wrong in [&of_another, &longer, &state[1..], &state[..state.len() - 1]] {
        assert!(!fresh.load(wrong) && saved(&mut fresh) == unused);
    }
    for other in [&mut fresh, &mut flown] {
        assert!(other.load(&state) && saved(other) == state);
    }
    for inputs in after {
        let expected = tick(&mut law, inputs);
        for other in [&mut fresh, &mut flown] {
            assert!(tick(other, inputs).is_same(&expected), "{inputs:?}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn every_law_continues_from_its_saved_state(flight in flight()) {
        let (rig, settings) = (Rig::default(), Settings::default());
        for law in OUTER {
            let route = Arc::new(|_, _: &State| Reference::default());
            let make = || GuardedOuter::new(law.make(&rig, &settings).unwrap(), route.clone(), &rig);
            assert_continues(&flight, make, |law, inputs| {
                law.tick(inputs.tick, &inputs.state).unwrap_or_default()
            });
        }
        for law in INNER {
            let make = || GuardedInner::new(law.make(&rig, &settings).unwrap(), &rig);
            assert_continues(&flight, make, |law, inputs| {
                law.tick(inputs.tick, &inputs.state, &inputs.setpoint)
            });
        }
        for law in mixer::LAWS {
            let make = || GuardedMixer::new(law.make(&rig, &settings).unwrap(), &rig);
            assert_continues(&flight, make, |law, inputs| {
                let thrust_n = inputs.setpoint.content.thrust_n;
                let wrench = Wrench { thrust_n, ..Wrench::default() };
                law.tick(inputs.tick, &Stamped::new(inputs.setpoint.tick, wrench))
            });
        }
    }
}
