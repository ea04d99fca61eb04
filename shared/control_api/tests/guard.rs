//! The rig's part of every law: what goes out when inputs are stale or answers are no numbers.

use std::sync::Arc;

use control_api::description::{Description, Refused, Settings, Signal, signal};
use control_api::law::{
    Desired, InnerInput, InnerLaw, Law, MixerInput, MixerLaw, OuterInput, OuterLaw, WrenchSetpoint,
};
use control_api::{GuardedInner, GuardedMixer, GuardedOuter, Rig, SavedState};
use messages::content::{
    Measured, Mode, NO_TICK, ROTORS, Reference, Setpoint, Stamped, State, Wrench,
};
use messages::role::{Channel, Role};
use messages::telemetry::Telemetry;
use messages::topic::Topic as _;
use proptest::prelude::*;

const HOLD_TICKS: u64 = 100;
const BLIND_TICKS: u64 = 1000;

/// A law of every role with a set output; it shows how often it was called and with what.
#[derive(Clone, Debug)]
struct Fixed {
    /// In which ticks its output is wrong, and what it is.
    wrong: fn(u64) -> Option<f64>,
    /// Its whole output, and telemetry that is not known.
    output: Option<[f64; ROTORS]>,
    calls: f64,
}

fn fixed(wrong: fn(u64) -> Option<f64>) -> Fixed {
    Fixed {
        wrong,
        output: None,
        calls: 0.0,
    }
}

impl Fixed {
    fn call(&mut self, telemetry: &mut Telemetry) -> Option<[f64; ROTORS]> {
        self.calls += 1.0;
        telemetry.value[0] = self.calls;
        if self.output.is_some() {
            telemetry.value.fill(f64::NAN);
        }
        self.output
    }
}

/// Its signals as an inner law; in the other roles it only sets the first.
const SHOWN: [Signal; 11] = [
    signal("calls", ""),
    signal("age", ""),
    signal("wanted_age", ""),
    signal("yaw", ""),
    signal("x", ""),
    signal("nothing", ""),
    signal("given_age", ""),
    signal("thrust_n", "N"),
    signal("pitch_nm", "N m"),
    signal("saturated", ""),
    signal("other_law", ""),
];

impl Law for Fixed {
    const DESCRIPTION: Description = Description {
        name: "fixed",
        role: Role::Inner,
        version: "1",
        summary: "",
        source: "",
        settings: &[],
        presets: &[],
        suited: None,
        telemetry: &SHOWN,
    };

    fn new(_: &Rig, _: &Settings) -> Result<Self, Refused> {
        Ok(fixed(|_| None))
    }
}

impl OuterLaw for Fixed {
    fn tick(&mut self, input: &OuterInput, telemetry: &mut Telemetry) -> Desired {
        let thrust_n = (self.wrong)(input.tick).unwrap_or(4.0);
        let [a, b, c, d] =
            self.call(telemetry)
                .unwrap_or([thrust_n, 0.1, 0.2, input.reference.yaw_rad]);
        Desired {
            thrust_n: a,
            attitude_rad: [b, c, d],
            attitude_rate_rad_s: if self.output.is_some() {
                [d, a, b]
            } else {
                [0.0; 3]
            },
            ..Desired::default()
        }
    }
}

impl InnerLaw for Fixed {
    fn tick(&mut self, input: &InnerInput, telemetry: &mut Telemetry) -> WrenchSetpoint {
        let age = |age: u64| if age == u64::MAX { -1.0 } else { age as f64 };
        let ages = [input.measured_age, input.wanted_age, input.given_age].map(age);
        let (wanted, given) = (&input.wanted, &input.given);
        let shown = [
            ages[0],
            ages[1],
            wanted.attitude_rad[2],
            input.reference.position_w_m[0],
            f64::NAN,
            ages[2],
            given.thrust_n,
            given.torque_b_nm[1],
            given.saturated as f64,
            given.other_law as f64,
            9.0,
        ];
        telemetry.value[1..12].copy_from_slice(&shown);
        let torque = (self.wrong)(input.tick).unwrap_or(0.01);
        let usual = [wanted.thrust_n, 0.0, torque, 0.0];
        let [thrust_n, x, y, z] = self.call(telemetry).unwrap_or(usual);
        WrenchSetpoint {
            thrust_n,
            torque_b_nm: [x, y, z],
        }
    }
}

impl MixerLaw for Fixed {
    fn tick(&mut self, input: &MixerInput, telemetry: &mut Telemetry) -> ([f64; ROTORS], bool) {
        let first = (self.wrong)(input.tick).unwrap_or(200.0);
        let usual = [first, 200.0, 210.0, 200.0];
        (self.call(telemetry).unwrap_or(usual), false)
    }
}

fn inner(wrong: fn(u64) -> Option<f64>) -> GuardedInner {
    GuardedInner::new(fixed(wrong).into(), &Rig::default())
}

fn mixer_of(wrong: fn(u64) -> Option<f64>) -> GuardedMixer {
    GuardedMixer::new(fixed(wrong).into(), &Rig::default())
}

fn outer(wrong: fn(u64) -> Option<f64>) -> GuardedOuter {
    let route = |tick: u64, _: &State| Reference {
        yaw_rad: tick as f64 / 1000.0,
        ..Reference::default()
    };
    GuardedOuter::new(fixed(wrong).into(), Arc::new(route), &Rig::default())
}

fn state(tick: u64) -> Stamped<State> {
    let measured = Measured {
        position_w_m: [tick as f64, 0.0, 1.0],
        attitude_rad: [0.0, 0.0, 0.3],
        ..Measured::default()
    };
    let content = State {
        measured,
        ..State::default()
    };
    Stamped::new(tick, content)
}

fn setpoint(tick: u64) -> Stamped<Setpoint> {
    let content = Setpoint {
        thrust_n: 6.0,
        attitude_rad: [0.2, 0.0, 0.4],
        ..Setpoint::default()
    };
    Stamped { tick, content }
}

fn hover_n() -> f64 {
    Rig::default().airframe.m() * Rig::default().airframe.g()
}

fn expected(age: Option<u64>) -> Mode {
    match age {
        Some(0) => Mode::Fresh,
        Some(age) if age <= HOLD_TICKS => Mode::Held,
        _ => Mode::Fallback,
    }
}

proptest! {
    #[test]
    fn whatever_arrives_the_mode_follows_the_ages_and_torque_needs_a_fresh_state(
        arrives in prop::collection::vec(
            (0..4_u8, 0..4_u8, prop_oneof![97 => Just(1_u64), 2 => Just(120), 1 => Just(1100)]),
            50..600,
        ),
    ) {
        let mut guarded = inner(|_| None);
        let (mut last_state, mut last_setpoint) = (Stamped::<State>::never(), Stamped::<Setpoint>::never());
        let (mut measured_at, mut last_thrust_n, mut tick) = (None, 0.0, 0);
        let first = arrives[0].2;
        for (state_comes, setpoint_comes, gap) in arrives {
            tick += gap;
            if state_comes > 0 {
                // Some come a tick late, and do not count.
                last_state = state(tick - u64::from(state_comes == 1));
            }
            if setpoint_comes > 0 {
                last_setpoint = setpoint(tick);
            }
            let age = |at: u64| (at != NO_TICK).then(|| tick - at);
            let wrench = guarded.tick(tick, &last_state, &last_setpoint);
            let was_measured = measured_at.map(|at: u64| tick - at);
            let (mode, thrust_n) = if last_state.tick == tick {
                measured_at = Some(tick);
                let mode = expected(age(last_setpoint.tick));
                (mode, if mode == Mode::Fallback { hover_n() } else { 6.0 })
            } else {
                match expected(was_measured) {
                    _ if tick - measured_at.unwrap_or(first) > BLIND_TICKS => (Mode::Idle, 0.0),
                    Mode::Fallback => (Mode::Fallback, hover_n()),
                    _ => (Mode::Held, last_thrust_n),
                }
            };
            prop_assert_eq!((Mode::from_wire(wrench.mode), wrench.thrust_n), (Some(mode), thrust_n));
            let torque = if last_state.tick == tick { 0.01 } else { 0.0 };
            prop_assert_eq!(wrench.torque_b_nm, [0.0, torque, 0.0]);
            prop_assert!(wrench.finite() && wrench.plausible());
            last_thrust_n = wrench.thrust_n;
        }
    }

    #[test]
    fn whatever_a_law_answers_what_goes_out_is_plausible(
        answers in prop::collection::vec(prop::num::f64::ANY, ROTORS),
        fresh in any::<bool>(),
    ) {
        let answers = <[f64; ROTORS]>::try_from(answers).unwrap_or_default();
        let rig = Rig::default();
        let law = Fixed { output: Some(answers), ..fixed(|_| None) };
        let mut outer = GuardedOuter::new(law.clone().into(), Arc::new(|_, _: &State| Reference::default()), &rig);
        let mut inner = GuardedInner::new(law.clone().into(), &rig);
        let mut mixer = GuardedMixer::new(law.clone().into(), &rig);
        for tick in 7..200 {
            let state = if fresh { state(tick) } else { state(6) };
            if let Some(setpoint) = outer.tick(tick, &state) {
                prop_assert!(setpoint.finite() && setpoint.plausible(), "{setpoint:?}");
            }
            let wrench = inner.tick(tick, &state, &setpoint(tick));
            prop_assert!(wrench.finite() && wrench.plausible(), "{wrench:?}");
            let speeds = mixer.tick(tick, &Stamped::new(tick, wrench));
            prop_assert!(speeds.finite() && speeds.plausible(), "{speeds:?}");
            let inside = speeds.speed_rad_s.iter().all(|w| (29.999..350.001).contains(w));
            prop_assert!(inside, "{speeds:?}");
        }
    }
}

#[test]
fn the_law_is_called_in_every_tick_with_the_ages_of_its_inputs() {
    let mut guarded = inner(|_| None);
    guarded.tick(0, &Stamped::never(), &Stamped::never());
    guarded.tick(1, &state(1), &setpoint(1));
    let held = guarded.tick(5, &state(1), &setpoint(3)).telemetry;
    assert_eq!(held.value[..3], [3.0, 4.0, 2.0]);
    assert!(held.value[5].is_nan(), "telemetry goes out as it is");
}

#[test]
fn the_law_is_given_the_active_command_and_whether_another_law_made_it() {
    let mut guarded = inner(|_| None);
    let never = guarded.tick(0, &Stamped::never(), &setpoint(0)).telemetry;
    assert_eq!(never.value[6..10], [-1.0, 0.0, 0.0, 0.0]);
    let speeds = mixer_of(|_| None).tick(6, &Stamped::new(6, Wrench::default()));
    let mut state = state(9);
    state.content.measured.rotor_speed_command_rad_s = speeds.speed_rad_s;
    (state.content.command_tick, state.content.command_saturated) = (6, 1);
    let published = guarded.tick(10, &state, &setpoint(10)).telemetry;
    let [_, pitch_nm, _] = speeds.torque_b_nm;
    assert_eq!(
        published.value[6..10],
        [4.0, speeds.thrust_n, pitch_nm, 1.0]
    );
    assert!(pitch_nm < 0.0, "the front pushes more: {pitch_nm}");
    // Of three channels, c flies its own law.
    for (group, flying, other_law) in [
        (Channel::A, Channel::A, 0.0),
        (Channel::A, Channel::C, 1.0),
        (Channel::C, Channel::A, 1.0),
        (Channel::C, Channel::C, 0.0),
    ] {
        let mut guarded = inner(|_| None).in_group(group);
        state.content.decision.group = flying as u64;
        let shown = guarded.tick(10, &state, &setpoint(10)).telemetry;
        assert_eq!(shown.value[10], other_law, "{group} while {flying} flies");
        // Before the first command no law flies.
        let never = guarded.tick(11, &Stamped::never(), &setpoint(11)).telemetry;
        assert_eq!(never.value[10], 0.0, "{group}");
    }
}

#[test]
fn without_a_set_point_the_reference_rests_where_the_vehicle_was() {
    let mut guarded = inner(|_| None);
    guarded.tick(9, &state(9), &setpoint(9));
    for tick in 110..130 {
        let shown = guarded.tick(tick, &state(tick), &setpoint(9)).telemetry;
        // The last yaw setpoint, and where it was when it fell back.
        assert_eq!(shown.value[3..5], [0.4, 110.0]);
    }
    guarded.tick(130, &state(130), &setpoint(130));
    let shown = guarded.tick(300, &state(300), &setpoint(130)).telemetry;
    assert_eq!(shown.value[4], 300.0, "a new outage, a new place");
    let shown = inner(|_| None)
        .tick(7, &state(7), &Stamped::never())
        .telemetry;
    // Without any setpoint, its own yaw.
    assert_eq!(shown.value[2..4], [-1.0, 0.3]);
}

#[test]
fn an_answer_that_is_no_number_is_no_torque_with_the_last_thrust_and_then_hover() {
    let kinds: [fn(u64) -> Option<f64>; 2] = [
        |tick| (tick > 9).then_some(f64::NAN),
        |tick| (tick > 9).then_some(1e9),
    ];
    for wrong in kinds {
        let mut guarded = inner(wrong);
        for tick in 0..10 {
            let wrench = guarded.tick(tick, &state(tick), &setpoint(tick));
            assert_eq!(wrench.mode, Mode::Fresh as u64);
        }
        for tick in 10..300 {
            let wrench = guarded.tick(tick, &state(tick), &setpoint(tick));
            let is_held = tick <= 9 + HOLD_TICKS;
            let thrust_n = if is_held { 6.0 } else { hover_n() };
            assert_eq!(wrench.mode, Mode::NotFinite as u64);
            assert_eq!(wrench.thrust_n, thrust_n);
            assert_eq!(wrench.torque_b_nm, [0.0; 3]);
        }
    }
}

#[test]
fn a_set_point_that_is_no_number_is_the_last_one_and_then_level_at_its_yaw() {
    let mut guarded = outer(|tick| (tick > 9).then_some(f64::INFINITY));
    assert_eq!(guarded.tick(9, &state(8)), None, "a state of another tick");
    let last = guarded.tick(9, &state(9)).unwrap_or_default();
    assert_eq!((last.mode, last.thrust_n), (Mode::Fresh as u64, 4.0));
    for tick in 10..300 {
        let setpoint = guarded.tick(tick, &state(tick)).unwrap_or_default();
        assert_eq!(setpoint.mode, Mode::NotFinite as u64);
        // The reference is that of the tick.
        assert_eq!(setpoint.reference.yaw_rad, tick as f64 / 1000.0);
        let expected = match tick <= 9 + HOLD_TICKS {
            true => (4.0, last.attitude_rad),
            false => (hover_n(), [0.0, 0.0, 0.009]),
        };
        assert_eq!((setpoint.thrust_n, setpoint.attitude_rad), expected);
    }
    let first = outer(|_| Some(f64::NAN)).tick(0, &state(0)).unwrap();
    let level_at_the_measured_yaw = (hover_n(), [0.0, 0.0, 0.3]);
    assert_eq!(
        (first.thrust_n, first.attitude_rad),
        level_at_the_measured_yaw
    );
}

#[test]
fn speeds_that_are_no_numbers_are_the_thrust_without_torque() {
    let content = Wrench {
        thrust_n: 5.0,
        ..Wrench::default()
    };
    let wrench = Stamped::new(3, content);
    let speeds = mixer_of(|_| Some(f64::NAN)).tick(3, &wrench);
    assert_eq!((speeds.mode, speeds.saturated), (Mode::NotFinite as u64, 1));
    assert!((speeds.thrust_n - 5.0).abs() < 1e-12, "{speeds:?}");
    assert!(speeds.torque_b_nm.iter().all(|tau| tau.abs() < 1e-15));
    let speeds = mixer_of(|_| Some(900.0)).tick(3, &wrench);
    assert_eq!((speeds.mode, speeds.saturated), (Mode::Fresh as u64, 1));
    assert!((speeds.speed_rad_s[0] - 350.0).abs() < 1e-9, "{speeds:?}");
}

#[test]
fn what_a_law_does_not_say_is_unknown_and_what_it_has_no_name_for_is_not_shown() {
    let nothing_more =
        |telemetry: &Telemetry| telemetry.value[SHOWN.len()..].iter().all(|it| *it == 0.0);
    let unsaid =
        |telemetry: &Telemetry| telemetry.value[1..SHOWN.len()].iter().all(|it| it.is_nan());
    let wrench = inner(|_| None).tick(0, &state(0), &setpoint(0));
    assert_eq!(wrench.telemetry.value[..3], [1.0, 0.0, 0.0]);
    assert!(nothing_more(&wrench.telemetry), "{:?}", wrench.telemetry);
    let setpoint = outer(|_| None).tick(0, &state(0)).unwrap();
    assert_eq!(setpoint.telemetry.value[0], 1.0);
    assert!(unsaid(&setpoint.telemetry) && nothing_more(&setpoint.telemetry));
    let mut mixer = mixer_of(|_| None);
    let idle = mixer.idle().telemetry;
    assert!(idle.value[0].is_nan() && unsaid(&idle) && nothing_more(&idle));
    let asked = mixer.tick(0, &Stamped::new(0, wrench)).telemetry;
    assert!(asked.value[0] == 1.0 && unsaid(&asked) && nothing_more(&asked));
}

#[test]
fn a_rehearsal_gives_what_the_tick_gives_and_changes_nothing() {
    let mut guarded = inner(|_| None);
    guarded.tick(0, &state(0), &setpoint(0));
    for _ in 0..3 {
        let rehearsed = guarded.rehearse(1, &state(1), &setpoint(1)).unwrap();
        assert_eq!(rehearsed.telemetry.value[0], 2.0);
    }
    let flown = guarded.tick(1, &state(1), &setpoint(1));
    assert_eq!(flown.telemetry.value[0], 2.0);
}

#[test]
fn the_rig_does_not_take_a_rehearsal_for_a_tick_either() {
    let mut guarded = inner(|_| None);
    assert!(guarded.rehearse(0, &state(0), &setpoint(0)).is_some());
    let wrench = guarded.tick(1, &Stamped::never(), &setpoint(0));
    let no_state_to_hold = (Mode::Fallback as u64, hover_n());
    assert_eq!((wrench.mode, wrench.thrust_n), no_state_to_hold);
    let mut guarded = outer(|tick| (tick > 9).then_some(f64::NAN));
    assert!(guarded.rehearse(9, &state(9)).is_some());
    let setpoint = guarded.tick(10, &state(10)).unwrap();
    let no_answer_to_hold = (hover_n(), [0.0, 0.0, 0.3]);
    assert_eq!(
        (setpoint.thrust_n, setpoint.attitude_rad),
        no_answer_to_hold
    );
}

#[test]
fn a_law_that_lists_no_state_cannot_be_saved() {
    let mut state = SavedState::from_slice(&[1, 2, 3]).unwrap();
    assert!(!inner(|_| None).save(&mut state) && state.is_empty());
}
