//! Tests of the grammar of faults, of what is refused, and of what faults are in ticks.

use crate::swap::Target;
use crate::{FAULTS, FaultSpec, FaultValue, Port, Span, StageTicks, ValueType};
use messages::parameters::{Parameter, SPECS};
use messages::role::Role;
use proptest::prelude::*;

use super::change::{TARGETS, known};
use super::*;
use crate::plan::{Lateness, Planned};

fn planned(texts: &[&str]) -> Result<Planned, FaultError> {
    let faults = texts.iter().map(|text| text.parse());
    let faults = faults.collect::<Result<Vec<Fault>, _>>()?;
    Planned::new(&faults, 0.001, &Airframe::nominal(), 7)
}

#[test]
fn both_instants_and_several_changes_are_read() {
    let at_time = planned(&["rotational_drag_nm_s=0.525@8s"]).unwrap();
    assert_eq!(at_time.swaps[0].tick, 8000);
    let text = "mass_kg=0.6, rotor_efficiency_3=0.7@tick8000";
    let fault: Fault = text.parse().unwrap();
    assert_eq!((fault.from, fault.to), (At::Tick(8000), None));
    let value = |wanted: &Desired| wanted.of(&Airframe::nominal()).unwrap();
    let values: Vec<_> = fault.wanted().iter().map(value).collect();
    assert_eq!(
        values,
        [(Parameter::Mass, 0.6), (Parameter::RotorEfficiency3, 0.7)]
    );
}

#[test]
fn faults_of_messages_and_those_of_stages_act_on_the_loop_and_changes_of_parameters_do_not() {
    let spares = |text| planned(&[text]).unwrap().has_no_loop_faults();
    let texts = [
        "mass_kg=0.6@1s",
        "inner.late=1ms@1s..9s",
        "state.drop=0.1@1s..9s",
    ];
    assert_eq!(texts.map(spares), [true, false, false]);
}

#[test]
fn a_ramp_takes_the_ticks_of_its_time_and_one_at_least() {
    let parameter = Parameter::Mass;
    for (text, period_s, value, steps) in [
        ("mass_kg=0.6~2s", 0.001, 0.6, 2000),
        ("mass_kg=+30%~1m1s500ms", 0.0025, 0.52 * 1.3, 24_600),
        ("mass_kg = nominal ~ 10us", 0.001, 0.52, 1),
        ("mass_kg=0.6", 0.001, 0.6, 1),
        ("mass_kg=0.6~30d", 1e-4, 0.6, 25_920_000_000),
    ] {
        let wanted: Desired = text.parse().unwrap();
        let target = Target {
            parameter,
            value,
            steps,
        };
        assert_eq!(wanted.target(&Airframe::nominal(), period_s), Ok(target));
    }
}

#[test]
fn a_share_is_of_what_the_airframe_was_built_with() {
    let mut airframe = Airframe::nominal();
    airframe.set(Parameter::Mass, 0.8).unwrap();
    let value = |text: &str| {
        let wanted: Desired = text.parse().unwrap();
        let value = wanted.of(&airframe).map(|(_, value)| value);
        value.map_err(|e| e.to_string())
    };
    assert_eq!(value("mass_kg=+30%"), Ok(0.52 * 1.3));
    assert_eq!(value("mass_kg=-50%"), Ok(0.26));
    assert_eq!(value("mass_kg=nominal"), Ok(0.52));
    assert_eq!(value("rotor_efficiency_2=-100%"), Ok(0.0));
    let too_much = value("mass_kg=+1000%").unwrap_err();
    assert!(too_much.contains("is out of range: allowed are 0.05 to 5.0 kg"));
    assert_eq!(
        value("gyro_noise_rad_s=+10%").unwrap_err(),
        "gyro_noise_rad_s is nominally 0, of which there is no share: write a number in rad/s"
    );
}

#[test]
fn messages_and_stages_are_read_with_their_ticks() {
    let planned = planned(&[
        "state.drop=0.25,inner.setpoint.delay=5@8s..9s",
        "outer.state.position_w_m.z.bias=0.5,mixer.wrench.drop=2/5@tick100",
        "inner.state.rate_b_rad_s.noise=0.1@1s",
        "rotor_speeds.freeze,mass_kg=0.6@2s",
        "inner.stop=20ms@3s",
    ])
    .unwrap();
    let messages: Vec<LiveFault> = planned.loops.messages.iter().map(|(_, it)| *it).collect();
    assert_eq!(
        planned_again(&messages)
            .iter()
            .map(Fault::to_string)
            .collect::<Vec<_>>(),
        [
            "state.drop=0.25@tick8000..tick9000",
            "inner.setpoint.delay=5@tick8000..tick9000",
            "outer.state.position_w_m.z.bias=0.5@tick100",
            "mixer.wrench.drop=2/5@tick100",
            "inner.state.rate_b_rad_s.noise=0.1@tick1000",
            "plant.rotor_speeds.freeze@tick2000",
        ]
    );
    let ports = messages.iter().map(|it| it.kind.port());
    assert_eq!(
        ports.take(2).collect::<Vec<_>>(),
        [Some(Port::OuterState), Some(Port::InnerState)]
    );
    assert_eq!(planned.swaps.len(), 1);
    let [stop] = planned.stages[..] else {
        panic!("{:?}", planned.stages)
    };
    assert_eq!(
        (stop.role, stop.ticks),
        (Role::Inner, StageTicks::Out(20_000_000))
    );
    assert_eq!(stop.span, Span::new(3000, 3020));
}

#[test]
fn a_channel_that_is_out_leaves_the_stage_to_the_others() {
    assert_eq!(planned(&["b.inner.stop=20ms@2s"]).unwrap().stages, []);
}

#[test]
fn a_late_stage_misses_the_ticks_that_begin_while_it_computes() {
    let late = |text: &str| planned(&[text]).unwrap().stages[0];
    let lateness = |text: &str, tick| late(text).lateness(7, tick).unwrap();
    for (text, output, next) in [
        ("inner.late=300us@1s", 0, 1),
        ("inner.late=1ms@1s", 1, 1),
        ("inner.late=2500us@1s", 2, 3),
    ] {
        assert_eq!(lateness(text, 0), Lateness { output, next }, "{text}");
    }
    let once = late("inner.late=1ms@1s").span;
    assert_eq!(once, Span::new(1000, 1001), "without an end");
    let outputs: Vec<u64> = (0..1000)
        .map(|tick| lateness("inner.late=500us..3500us@1s", tick).output)
        .collect();
    for (output, expected) in [(0, 167), (1, 333), (2, 333), (3, 167)] {
        let count = outputs.iter().filter(|it| **it == output).count();
        assert!(
            count.abs_diff(expected) < 75,
            "{count} outputs are {output} ticks late"
        );
    }
}

#[test]
fn what_lasts_is_ended_by_its_name() {
    let spans = |texts: &[&str]| -> Vec<Span> {
        let messages = planned(texts).unwrap().loops.messages;
        messages.iter().map(|(_, fault)| fault.span).collect()
    };
    assert_eq!(
        spans(&["state.drop=0.1@8s", "inner.state.drop=off@9s"]),
        [Span::new(8000, Span::FOR_GOOD), Span::new(8000, 9000)]
    );
    assert_eq!(
        spans(&["state.drop=1/2@8s", "state.drop=off@9s"]),
        spans(&["state.drop=1/2@8s..9s"])
    );
    let late = planned(&["inner.late=1ms@1s..9s", "inner.late=off@2s"]).unwrap();
    assert_eq!(late.stages[0].span, Span::new(1000, 2000));
    let late_ns = |tick| late.loops.late_ns(Role::Inner, tick);
    assert_eq!([1999, 2000].map(late_ns), [1_000_000, 0]);
    let processes = [
        "cpu.hog=90@1s",
        "cpu.load=0.5@1s..2s",
        "cpu.hog=off@3s",
        "inner.kill@4s",
    ];
    let acts = planned(&processes).unwrap().acts;
    let acts: Vec<_> = acts.iter().map(|act| (act.ends, act.span)).collect();
    assert_eq!(
        acts,
        [
            (false, Span::new(1000, Span::FOR_GOOD)),
            (false, Span::new(1000, 2000)),
            (true, Span::new(3000, 3001)),
            (false, Span::new(4000, 4001))
        ]
    );
}

#[test]
fn a_kill_is_an_outage_of_the_time_that_a_restart_takes() {
    let kill = planned(&["outer.kill@2s"]).unwrap().stages[0];
    assert!(kill.starts_anew());
    assert_eq!(kill.span, Span::new(2000, 2100));
}

/// Faults as they are typed, at 8 s where there is no instant, and a part of the error.
#[test]
fn every_mistake_is_named() {
    for row in [
        "mass_kg=0.6@ -> `` is no instant",
        "mass_kg=0.6@soon -> `soon` is no instant",
        "mass_kg=0.6@tick-1 -> `tick-1` is no instant",
        "mass_kg -> `mass_kg` is not an assignment",
        "mass_kg=heavy -> mass_kg = `heavy` is not a number",
        "mas_kg=0.6 -> did you mean `mass_kg`",
        "mass_kg=-1 -> mass_kg = -1 is out of range: allowed are 0.05 to 5.0 kg",
        "mass_kg=30% -> `mass_kg=30%` has no sign: write NAME=+30%",
        "mass_kg=+a% -> mass_kg = `+a%` is not a number",
        "mass_kg=1e300 -> mass_kg = 1e300 is out of range",
        "mass_kg=0.6,mass_kg=0.7 -> mass_kg is given twice",
        "@8s -> `` is not an assignment",
        "mass_kg=9~2s -> mass_kg = 9 is out of range: allowed are 0.05 to 5.0 kg",
        "mass_kg=0.4~0s -> a ramp of `0s`: it is no time; without ~ the change is at once; write",
        "mass_kg=0.4~-2s -> mass_kg: a ramp of `-2s`: a time is not negative; write the time",
        "mass_kg=0.4~nan -> mass_kg: a ramp of `nan`: ",
        "mass_kg=0.4~2 -> as in mass_kg=0.4~2s or ~500ms",
        "mass_kg=0.4~ -> mass_kg: a ramp of ``: ",
        "mass_kg=+30%~31d -> a ramp of `31d`: it is longer than the longest flight, 30 days",
        "state.dorp=0.1 -> unknown fault `state.dorp`; did you mean `state.drop`?",
        "inner.stat.drop=0.1 -> did you mean `inner.state.drop`?",
        "state.position_m.bias=1 -> unknown fault `state.position_m.bias`; did you mean",
        "state.position_w_m.w.bias=1 -> the axes of `position_w_m` are x, y, z",
        "state.bias=1 -> it is a fault of a number: name which, as in `state.",
        "inner.setpoint.noise=1 -> name which, as in `inner.setpoint.",
        "inner.pause=1s -> unknown fault `inner.pause`",
        "outer.wrench.drop=1 -> outer does not receive `wrench`: it receives `state`",
        "inner.rotor_speeds.drop=1 -> it receives `state` and `setpoint`",
        "record.stop=1s -> the recorder is no stage; `STAGE.stop` is for plant, outer, inner, mixer",
        "state.drop=1.5 -> write a share above 0 and up to 1, as in state.drop=0.1, or n/m for",
        "state.drop=0 -> state.drop = `0`: write a share",
        "state.drop=3/2 -> state.drop = `3/2`: write",
        "state.drop -> state.drop = ``: write",
        "state.delay=61 -> state.delay = `61`: write whole ticks from 1 to 60",
        "state.freeze=1 -> state.freeze takes no value: leave out `=1`",
        "wrench.thrust_n.noise=-1 -> `-1`: write a standard deviation above 0",
        "wrench.thrust_n.bias=nan -> `nan`: write a number other than 0",
        "inner.late=0s -> `0s`: write a time above 0 and up to 1m",
        "inner.late=3ms..1ms -> inner.late = `3ms..1ms`: write",
        "inner.stop=61s -> `61s`: write a time above 0 and up to 1m, as in inner.stop=20ms",
        "inner.stop=900us -> inner.stop=900us: write a time of at least one tick, which is 1 ms here",
        "inner.kill=1 -> inner.kill takes no value: leave out `=1`",
        "state.drop=0.1@3s..4s,outer.stop=20ms@6s -> has several instants: give --fault once for each",
        "record.kill -> the recorder is no stage; `STAGE.kill` is for outer, inner, mixer",
        "plant.kill -> plant.kill: a flight ends with its plant; plant.stop=20ms stops it",
        "cpu.hog=100 -> write a SCHED_FIFO priority from 1 to 99, as in cpu.hog=90",
        "cpu.hog -> cpu.hog = ``: write a SCHED_FIFO priority",
        "cpu.load=0 -> `0`: write a share above 0 and up to 1, as in cpu.load=0.1",
        "cpu.lod=0.5 -> unknown fault `cpu.lod`; did you mean `cpu.load`?",
        "state.drop=off -> state.drop=off: it is not active then or later",
        "cpu.hog=off -> cpu.hog=off: it is not active then or later",
        "inner.stop=off -> inner.stop happens once: there is nothing to end",
        "inner.kill=off -> inner.kill happens once: there is nothing to end",
        "state.dorp=off -> did you mean `state.drop`?",
        "state.drop=off@8s..9s -> state.drop=off happens once, at an instant: leave the end out",
        "state.drop=0.1@9s..8s -> ends at tick 8000, and begins at tick 9000",
        "state.drop=0.1@8s..tick8000 -> ends at tick 8000, and begins at tick 8000: write an end from tick 8001 on",
        "state.drop=0.1@8s..soon -> `soon` is no instant",
        "state.drop=0.1@..9s -> `` is no instant",
        "mass_kg=0.6@8s..9s -> holds until it is changed again: leave the end out, and plan",
        "inner.stop=20ms@8s..9s -> inner.stop happens once, at an instant: leave the end out",
        "state.drop=0.1,inner.state.drop=1/2 -> `drop` is given twice for the same ticks at inner.state",
        "state.rate_b_rad_s.bias=1,state.rate_b_rad_s.x.bias=1 -> `bias` is given twice for",
        "cpu.hog=90,cpu.hog=80 -> cpu.hog is given for these ticks already: let one end before",
        "inner.stop=20ms,inner.kill -> another fault of inner acts in these ticks: let one end before",
    ] {
        let (text, said) = row.split_once(" -> ").unwrap();
        let at_8s = format!("{text}@8s");
        let typed = if text.contains('@') { text } else { &at_8s };
        let error = planned(&[typed]).unwrap_err();
        assert!(error.to_string().contains(said), "{text}: {error}");
    }
    let error = planned(&["mass_kg=0.6"]).unwrap_err();
    assert!(error.to_string().contains("has no time"), "{error}");
}

#[test]
fn names_that_are_suggested_are_names_that_are_known() {
    for name in known() {
        let taken = ["", "=1", "=0.5", "=20ms"]
            .iter()
            .any(|value| format!("{name}{value}@8s").parse::<Fault>().is_ok());
        assert!(taken, "{name}");
    }
}

fn instants() -> impl Strategy<Value = At> {
    let times = (1_u64..10_000_000_000).prop_map(|us| At::Time(Duration::from_micros(us)));
    prop_oneof![any::<u64>().prop_map(At::Tick), times]
}

/// Faults of the loop: every target with every kind that it can have.
fn loop_changes() -> impl Strategy<Value = Change> {
    let target = (0..TARGETS.len(), 0..FAULTS.len());
    let ns = || (1_u64..60_000_000).prop_map(|us| us * 1000);
    let numbers = (
        any::<f64>(),
        0.0..1.0_f64,
        1_u64..61,
        0_u64..1000,
        ns(),
        ns(),
    );
    (target, numbers).prop_filter_map(
        "allowed numbers",
        |((target, kind), (number, share, ticks, more, ns, other_ns))| {
            let target = &TARGETS[target];
            let is_of_target = |spec: &&FaultSpec| spec.kind.scope() == target.scope;
            let kinds: Vec<_> = FAULTS.iter().filter(is_of_target).collect();
            let spec = kinds[kind % kinds.len()];
            let value = match spec.value {
                ValueType::None => [0, 0],
                ValueType::Share => [share.to_bits(), 0],
                ValueType::Positive(_) | ValueType::NotZero => [number.to_bits(), 0],
                ValueType::Pattern => [ticks, ticks + more],
                ValueType::Integer { .. } => [ticks, 0],
                ValueType::Time => [ns, 0],
                ValueType::TimeRange => [ns.min(other_ns), ns.max(other_ns)],
            };
            target.change(spec, FaultValue(value)).map(Change::Loop)
        },
    )
}

fn changes() -> impl Strategy<Value = Change> {
    let ramps = proptest::option::of((1_u64..60_000_000).prop_map(Duration::from_micros));
    let finite = any::<f64>().prop_filter("finite", |number| number.is_finite());
    let parameters = (0..SPECS.len(), finite, ramps).prop_map(|(index, number, over)| {
        Change::Parameter(Desired {
            parameter: SPECS[index].parameter,
            value: RequestedValue::Number(number),
            over,
        })
    });
    prop_oneof![3 => loop_changes(), 1 => parameters]
}

proptest! {
    #[test]
    fn whatever_is_printed_is_read_again(
        change in changes(),
        from in instants(),
        to in proptest::option::of(instants()),
    ) {
        let fault = Fault { from, to: to.filter(|_| change.lasts()), changes: vec![change] };
        prop_assert_eq!(fault.to_string().parse::<Fault>(), Ok(fault.clone()), "{}", fault);
    }

    /// Injected faults, printed and read again, plan the same.
    #[test]
    fn what_was_injected_is_planned_again(change in changes(), from in 0_u64..10_000, ticks in 1_u64..10_000) {
        let live: Vec<LiveFault> = change.faults(Span { from, to: from + ticks }).collect();
        let typed: Vec<Fault> = planned_again(&live).iter().map(|fault| fault.to_string().parse().unwrap()).collect();
        let again: Vec<LiveFault> = typed
            .iter()
            .flat_map(|fault| fault.changes[0].faults(fault.span(1e-3).unwrap()).collect::<Vec<_>>())
            .collect();
        prop_assert_eq!(&again, &live);
        let off = live.first().map(|_| format!("{}=off", change.what()).parse::<Change>());
        if let Some(Ok(off)) = off {
            prop_assert!(off.kinds().iter().zip(&live).all(|((kind, _), it)| kind.is_like(&it.kind)));
            prop_assert_eq!(off.to_string().parse::<Change>().unwrap(), off);
        }
    }

    #[test]
    fn no_text_is_a_panic(text in ".{0,60}", at in "[@.0-9stick]{0,12}") {
        let _ = planned(&[&text]);
        let _ = planned(&[&format!("state.drop=0.1{at}")]);
        let _ = planned(&[&format!("{text}@8s..9s")]);
    }
}
