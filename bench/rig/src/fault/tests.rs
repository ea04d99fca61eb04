//! Tests of the grammar of faults, of what is refused, and of what faults are in ticks.

use messages::fault::live::{FaultKind, LiveFault};
use messages::fault::{Kind, LONGEST_DELAY, MOST, PORTS, Place, Port, Span};
use messages::role::{Role, STAGES};
use proptest::prelude::*;

use super::change::known;
use super::plan::{Lateness, Planned, StageFault, StageTicks};
use super::*;
use messages::parameters::{Parameter, SPECS};
use plant::Target;

fn swap(text: &str) -> Result<Swap, FaultError> {
    text.parse::<Fault>()?
        .swap(0.001, &Airframe::nominal())
        .map(Option::unwrap)
}

fn planned(texts: &[&str]) -> Result<Planned, FaultError> {
    let faults: Vec<Fault> = texts
        .iter()
        .map(|text| text.parse())
        .collect::<Result<_, _>>()?;
    Planned::new(&faults, 0.001, &Airframe::nominal(), 7)
}

#[test]
fn both_instants_and_several_changes_are_read() {
    let fault: Fault = "rotational_drag_nm_s=0.525@8s".parse().unwrap();
    assert_eq!(
        fault
            .swap(0.001, &Airframe::nominal())
            .unwrap()
            .unwrap()
            .tick,
        8000
    );
    let fault: Fault = "mass_kg=0.6, rotor_efficiency_3=0.7@tick8000"
        .parse()
        .unwrap();
    assert_eq!((fault.from, fault.to), (At::Tick(8000), None));
    let values: Vec<_> = fault
        .wanted()
        .iter()
        .map(|wanted| wanted.of(&Airframe::nominal()).unwrap())
        .collect();
    assert_eq!(
        values,
        [(Parameter::Mass, 0.6), (Parameter::RotorEfficiency3, 0.7)]
    );
}

#[test]
fn a_ramp_takes_the_ticks_of_its_time_and_one_at_least() {
    let target = |text: &str, period_s| {
        text.parse::<Desired>()
            .unwrap()
            .target(&Airframe::nominal(), period_s)
    };
    let to = |parameter, value, steps| {
        Ok(Target {
            parameter,
            value,
            steps,
        })
    };
    assert_eq!(
        target("mass_kg=0.6~2s", 0.001),
        to(Parameter::Mass, 0.6, 2000)
    );
    assert_eq!(
        target("mass_kg=+30%~1m1s500ms", 0.0025),
        to(Parameter::Mass, 0.52 * 1.3, 24_600)
    );
    assert_eq!(
        target("mass_kg = nominal ~ 10us", 0.001),
        to(Parameter::Mass, 0.52, 1)
    );
    assert_eq!(target("mass_kg=0.6", 0.001), to(Parameter::Mass, 0.6, 1));
    assert!(target("mass_kg=0.6~30d", 1e-4).is_ok());
}

#[test]
fn a_share_is_of_what_the_airframe_was_built_with() {
    let mut airframe = Airframe::nominal();
    airframe.set(Parameter::Mass, 0.8).unwrap();
    let value = |text: &str| {
        text.parse::<Desired>()
            .unwrap()
            .of(&airframe)
            .map(|(_, value)| value)
    };
    assert_eq!(value("mass_kg=+30%"), Ok(0.52 * 1.3));
    assert_eq!(value("mass_kg=-50%"), Ok(0.26));
    assert_eq!(value("mass_kg=nominal"), Ok(0.52));
    assert_eq!(value("rotor_efficiency_2=-100%"), Ok(0.0));
    let said = |text: &str| value(text).unwrap_err().to_string();
    assert!(said("mass_kg=+1000%").contains("is out of range: allowed are 0.05 to 5.0 kg"));
    assert_eq!(
        said("gyro_noise_rad_s=+10%"),
        "gyro_noise_rad_s is nominally 0, of which there is no share: write a number in rad/s"
    );
}

#[test]
fn a_fault_prints_as_it_is_typed() {
    for text in [
        "mass_kg=0.6~1m30s@tick8000",
        "mass_kg=+30.5%,gyro_noise_rad_s=0.01@1m1s500ms",
        "mass_kg=nominal@3s",
    ] {
        let fault: Fault = text.parse().unwrap();
        assert_eq!(
            fault.to_string().parse::<Fault>().unwrap(),
            fault,
            "{fault}"
        );
    }
}

#[test]
fn every_mistake_is_named() {
    for (text, said) in [
        ("mass_kg=0.6", "has no time"),
        ("mass_kg=0.6@soon", "`soon` is no instant"),
        ("mass_kg=0.6@tick-1", "`tick-1` is no instant"),
        ("mass_kg@8s", "`mass_kg` is not an assignment"),
        ("mass_kg=heavy@8s", "mass_kg = `heavy` is not a number"),
        ("mas_kg=0.6@8s", "did you mean `mass_kg`"),
        (
            "mass_kg=-1@8s",
            "mass_kg = -1 is out of range: allowed are 0.05 to 5.0 kg",
        ),
        (
            "mass_kg=30%@8s",
            "`mass_kg=30%` has no sign: write NAME=+30%",
        ),
        ("mass_kg=+a%@8s", "mass_kg = `+a%` is not a number"),
        ("mass_kg=+nan%@8s", "mass_kg = `+nan%` is not a number"),
        ("mass_kg=-inf%@8s", "mass_kg = `-inf%` is not a number"),
        ("mass_kg=1e300@8s", "mass_kg = 1e300 is out of range"),
        ("mass_kg=0.6,mass_kg=0.7@8s", "mass_kg is given twice"),
        ("@8s", "`` is not an assignment"),
        (
            "mass_kg=9~2s@8s",
            "mass_kg = 9 is out of range: allowed are 0.05 to 5.0 kg",
        ),
        ("mass_kg=~2s@8s", "mass_kg = `` is not a number"),
        (
            "mass_kg=0.4~0s@8s",
            "mass_kg: a ramp of `0s`: it is no time; without ~ the change is at once; write",
        ),
        ("mass_kg=0.4~0@8s", "mass_kg: a ramp of `0`: it is no time"),
        (
            "mass_kg=0.4~-2s@8s",
            "mass_kg: a ramp of `-2s`: a time is not negative; write the time",
        ),
        ("mass_kg=0.4~nan@8s", "mass_kg: a ramp of `nan`: "),
        ("mass_kg=0.4~2@8s", "as in mass_kg=0.4~2s or ~500ms"),
        ("mass_kg=0.4~@8s", "mass_kg: a ramp of ``: "),
        (
            "mass_kg=+30%~31d@8s",
            "mass_kg: a ramp of `31d`: it is longer than the longest flight, 30 days",
        ),
    ] {
        let error = swap(text).unwrap_err().to_string();
        assert!(error.contains(said), "{text}: {error}");
    }
}

#[test]
fn messages_and_stages_are_read_with_their_ticks() {
    let all = Place {
        field: 4,
        axis: None,
    };
    let planned = planned(&[
        "state.drop=0.25,inner.setpoint.delay=5@8s..9s",
        "outer.state.position_w_m.z.bias=0.5,mixer.wrench.drop=2/5@tick100",
        "inner.state.rate_b_rad_s.noise=0.1@1s",
        "rotor_speeds.freeze,mass_kg=0.6@2s",
        "inner.stop=20ms@3s",
    ])
    .unwrap();
    let (a, b) = (
        Span {
            from: 8000,
            to: 9000,
        },
        Span {
            from: 100,
            to: Span::FOR_GOOD,
        },
    );
    let messages: Vec<_> = planned
        .loops
        .messages
        .iter()
        .map(|(_, fault)| (fault.port, fault.kind, fault.span))
        .collect();
    assert_eq!(
        messages,
        [
            (Port::OuterState, Kind::Drop(0.25), a),
            (Port::InnerState, Kind::Drop(0.25), a),
            (Port::InnerSetpoint, Kind::Delay(5), a),
            (
                Port::OuterState,
                Kind::Bias(
                    Place {
                        field: 0,
                        axis: Some(2)
                    },
                    0.5
                ),
                b
            ),
            (Port::MixerWrench, Kind::DropEach { lost: 2, of: 5 }, b),
            (
                Port::InnerState,
                Kind::Noise(all, 0.1),
                Span {
                    from: 1000,
                    to: Span::FOR_GOOD
                }
            ),
            (
                Port::PlantRotorSpeeds,
                Kind::Freeze,
                Span {
                    from: 2000,
                    to: Span::FOR_GOOD
                }
            ),
        ]
    );
    assert_eq!(planned.swaps.len(), 1);
    let out = StageFault {
        role: Role::Inner,
        kind: StageTicks::Out,
        span: Span {
            from: 3000,
            to: 3020,
        },
    };
    assert_eq!(planned.stages, [out]);
}

#[test]
fn a_late_stage_misses_the_ticks_that_begin_while_it_computes() {
    let late = |text: &str| planned(&[text]).unwrap().stages[0];
    let lateness = |text: &str, tick| late(text).kind.lateness(Role::Inner, 7, tick);
    assert_eq!(
        lateness("inner.late=300us@1s", 0),
        Lateness { output: 0, next: 1 },
        "within its tick"
    );
    assert_eq!(
        lateness("inner.late=1ms@1s", 0),
        Lateness { output: 1, next: 1 }
    );
    assert_eq!(
        lateness("inner.late=2500us@1s", 0),
        Lateness { output: 2, next: 3 }
    );
    assert_eq!(
        late("inner.late=1ms@1s").span,
        Span {
            from: 1000,
            to: 1001
        },
        "without an end it is once"
    );
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
        planned(texts)
            .unwrap()
            .loops
            .messages
            .iter()
            .map(|(_, fault)| fault.span)
            .collect()
    };
    let ended = spans(&["state.drop=0.1@8s", "inner.state.drop=off@9s"]);
    assert_eq!(
        ended,
        [
            Span {
                from: 8000,
                to: Span::FOR_GOOD
            },
            Span {
                from: 8000,
                to: 9000
            }
        ]
    );
    assert_eq!(
        spans(&["state.drop=1/2@8s", "state.drop=off@9s"]),
        spans(&["state.drop=1/2@8s..9s"])
    );
    let late = planned(&["inner.late=1ms@1s..9s", "inner.late=off@2s"]).unwrap();
    assert_eq!(
        late.stages[0].span,
        Span {
            from: 1000,
            to: 2000
        }
    );
    assert_eq!(
        [1999, 2000].map(|tick| late.loops.late.late_ns(Role::Inner, tick)),
        [1_000_000, 0]
    );
    let acts = planned(&[
        "cpu.hog=90@1s",
        "cpu.load=0.5@1s..2s",
        "cpu.hog=off@3s",
        "inner.kill@4s",
    ])
    .unwrap()
    .acts;
    let spans: Vec<_> = acts
        .iter()
        .map(|act| (act.ends, act.span.from, act.span.to))
        .collect();
    assert_eq!(
        spans,
        [
            (false, 1000, Span::FOR_GOOD),
            (false, 1000, 2000),
            (true, 3000, 3001),
            (false, 4000, 4001)
        ]
    );
}

#[test]
fn a_kill_is_an_outage_of_the_time_that_a_restart_takes() {
    let [kill] = planned(&["outer.kill@2s"]).unwrap().stages[..] else {
        panic!()
    };
    assert_eq!(
        (kill.kind, kill.span),
        (
            StageTicks::Anew,
            Span {
                from: 2000,
                to: 2100
            }
        )
    );
}

#[test]
fn every_mistake_in_faults_of_the_loop_is_named() {
    for (text, said) in [
        (
            "state.dorp=0.1@8s",
            "unknown fault `state.dorp`; did you mean `state.drop`?",
        ),
        ("inner.stat.drop=0.1@8s", "did you mean `inner.state.drop`?"),
        (
            "state.position_m.bias=1@8s",
            "unknown fault `state.position_m.bias`; did you mean",
        ),
        (
            "state.position_w_m.w.bias=1@8s",
            "`state.position_w_m.w.bias`: the axes of `position_w_m` are x, y, z",
        ),
        (
            "state.bias=1@8s",
            "unknown fault `state.bias`: it is a fault of a number: name which, as in `state.",
        ),
        (
            "inner.setpoint.noise=1@8s",
            "name which, as in `inner.setpoint.",
        ),
        ("inner.pause=1s@8s", "unknown fault `inner.pause`"),
        (
            "outer.wrench.drop=1@8s",
            "outer does not receive `wrench`: it receives `state`",
        ),
        (
            "inner.rotor_speeds.drop=1@8s",
            "inner does not receive `rotor_speeds`: it receives `state` and `setpoint`",
        ),
        (
            "record.stop=1s@8s",
            "unknown fault `record.stop`: the recorder is no stage; `STAGE.stop` is for plant, outer, inner, mixer",
        ),
        (
            "state.drop=1.5@8s",
            "state.drop = `1.5`: write a share above 0 and up to 1, or n/m for the first n of each m",
        ),
        ("state.drop=0@8s", "state.drop = `0`: write a share"),
        ("state.drop=3/2@8s", "state.drop = `3/2`: write"),
        ("state.drop=0/2@8s", "state.drop = `0/2`: write"),
        ("state.drop@8s", "state.drop = ``: write"),
        (
            "state.delay=61@8s",
            "state.delay = `61`: write whole ticks from 1 to 60",
        ),
        (
            "state.lag=0@8s",
            "state.lag = `0`: write whole ticks from 1 to 60",
        ),
        (
            "state.freeze=1@8s",
            "state.freeze takes no value: write state.freeze@8s or",
        ),
        (
            "wrench.thrust_n.nan=1@8s",
            "wrench.thrust_n.nan takes no value",
        ),
        (
            "wrench.thrust_n.noise=-1@8s",
            "wrench.thrust_n.noise = `-1`: write a standard deviation above 0",
        ),
        (
            "wrench.thrust_n.bias=nan@8s",
            "wrench.thrust_n.bias = `nan`: write a number other than 0",
        ),
        (
            "inner.late=0s@8s",
            "inner.late = `0s`: write a time above 0 and up to 1m",
        ),
        ("inner.late=3ms..1ms@8s", "inner.late = `3ms..1ms`: write"),
        (
            "inner.stop=61s@8s",
            "inner.stop = `61s`: write a time above 0 and up to 1m, as in inner.stop=20ms",
        ),
        (
            "inner.stop=900us@8s",
            "inner.stop = `900us`: write a time of at least one tick, which is 1 ms here",
        ),
        (
            "inner.kill=1@8s",
            "inner.kill takes no value: write inner.kill@8s",
        ),
        (
            "state.drop=0.1@3s..4s,outer.stop=20ms@6s",
            "has several instants: give --fault once for each",
        ),
        (
            "record.kill@8s",
            "the recorder is no stage; `STAGE.kill` is for outer, inner, mixer",
        ),
        (
            "plant.kill@8s",
            "plant.kill: a flight ends with its plant; plant.stop=20ms stops it",
        ),
        (
            "cpu.hog=100@8s",
            "cpu.hog = `100`: write a SCHED_FIFO priority from 1 to 99, as in cpu.hog=90",
        ),
        ("cpu.hog@8s", "cpu.hog = ``: write a SCHED_FIFO priority"),
        (
            "cpu.load=0@8s",
            "cpu.load = `0`: write a share above 0 and up to 1, as in cpu.load=0.5",
        ),
        (
            "cpu.lod=0.5@8s",
            "unknown fault `cpu.lod`; did you mean `cpu.load`?",
        ),
        (
            "state.drop=off@8s",
            "state.drop=off: it does not strike then or later",
        ),
        (
            "inner.late=off@8s",
            "inner.late=off: it does not strike then or later",
        ),
        (
            "cpu.hog=off@8s",
            "cpu.hog=off: it does not strike then or later",
        ),
        (
            "inner.stop=off@8s",
            "inner.stop happens once: there is nothing to end",
        ),
        (
            "inner.kill=off@8s",
            "inner.kill happens once: there is nothing to end",
        ),
        ("state.dorp=off@8s", "did you mean `state.drop`?"),
        (
            "state.drop=off@8s..9s",
            "state.drop=off happens once, at an instant: leave the end out",
        ),
        (
            "state.drop=0.1@9s..8s",
            "`state.drop=0.1@9s..8s` ends at tick 8000, and begins at tick 9000",
        ),
        (
            "state.drop=0.1@8s..tick8000",
            "ends at tick 8000, and begins at tick 8000",
        ),
        ("state.drop=0.1@8s..soon", "`soon` is no instant"),
        ("state.drop=0.1@..9s", "`` is no instant"),
        (
            "mass_kg=0.6@8s..9s",
            "mass_kg holds until it is changed again: leave the end out, and plan the change back",
        ),
        (
            "inner.stop=20ms@8s..9s",
            "inner.stop happens once, at an instant: leave the end out",
        ),
        ("inner.kill@8s..9s", "inner.kill happens once"),
        (
            "state.drop=0.1,inner.state.drop=1/2@8s",
            "`drop` is given twice for the same ticks at inner.state",
        ),
        (
            "state.rate_b_rad_s.bias=1,state.rate_b_rad_s.x.bias=1@8s",
            "`bias` is given twice for the same ticks at outer",
        ),
        (
            "cpu.hog=90,cpu.hog=80@8s",
            "cpu.hog is given for these ticks already: let one end before the other begins",
        ),
        (
            "inner.stop=20ms,inner.kill@8s",
            "two faults of inner meet: one from tick 8000, one from tick 8000",
        ),
    ] {
        let error = planned(&[text]).unwrap_err().to_string();
        assert!(error.contains(said), "{text}: {error}");
    }
}

#[test]
fn a_flight_has_room_for_so_many_faults_of_messages() {
    let texts: Vec<String> = (0..=MOST)
        .map(|i| format!("setpoint.drop=1@tick{i}..tick{}", i + 1))
        .collect();
    let texts: Vec<&str> = texts.iter().map(String::as_str).collect();
    assert!(planned(&texts[..MOST]).is_ok());
    assert_eq!(planned(&texts), Err(FaultError::TooMany));
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

fn times() -> impl Strategy<Value = Duration> {
    (1_u64..60_000_000).prop_map(Duration::from_micros)
}

fn whole() -> impl Strategy<Value = Kind> {
    prop_oneof![
        (0.0..1.0_f64)
            .prop_filter("a share", |share| *share > 0.0)
            .prop_map(Kind::Drop),
        (1_u64..1000, 0_u64..1000).prop_map(|(lost, more)| Kind::DropEach {
            lost,
            of: lost + more
        }),
        (1..=LONGEST_DELAY).prop_map(Kind::Delay),
        (1..=LONGEST_DELAY).prop_map(Kind::Lag),
        Just(Kind::Freeze),
    ]
}

fn kinds(port: Port) -> impl Strategy<Value = Kind> {
    let place = (0..port.fields().len()).prop_flat_map(move |field| {
        let axes = port.fields()[field].axes.len();
        (0..=axes).prop_map(move |axis| Place {
            field,
            axis: (axis < axes).then_some(axis),
        })
    });
    let number = any::<f64>().prop_filter("a number other than 0", |number| {
        number.is_finite() && *number != 0.0
    });
    let of_numbers = (place, number, 0..3).prop_map(|(place, number, which)| match which {
        0 => Kind::Noise(place, number.abs()),
        1 => Kind::Bias(place, number),
        _ => Kind::Nan(place),
    });
    prop_oneof![whole(), of_numbers]
}

fn changes() -> impl Strategy<Value = (Change, bool)> {
    let messages = (0..PORTS.len(), any::<bool>()).prop_flat_map(|(port, every_input)| {
        let port = PORTS[port];
        // What a topic stands for begins with its first input.
        let first = PORTS
            .into_iter()
            .find(|it| it.topic() == port.topic())
            .unwrap_or(port);
        let port = if every_input { first } else { port };
        kinds(port).prop_map(move |kind| (FaultKind::Messages { port, kind }, every_input))
    });
    let ns = || times().prop_map(|time| u64::try_from(time.as_nanos()).unwrap());
    let role = || (1..STAGES.len()).prop_map(|role| STAGES[role]);
    let others = prop_oneof![
        (role(), ns(), ns()).prop_map(|(role, a, b)| FaultKind::Late {
            role,
            least_ns: a.min(b),
            most_ns: a.max(b)
        }),
        (role(), ns()).prop_map(|(role, for_ns)| FaultKind::Stop { role, for_ns }),
        role().prop_map(|role| FaultKind::Kill { role }),
        (1_u64..100).prop_map(|priority| FaultKind::Hog { priority }),
        (0.0..1.0_f64)
            .prop_filter("a share", |share| *share > 0.0)
            .prop_map(|share| FaultKind::Load { share }),
    ];
    let loops = prop_oneof![messages, others.prop_map(|kind| (kind, false))];
    let loops = loops.prop_map(|(kind, every_input)| {
        let change = LoopChange {
            kind,
            every_input,
            ends: false,
        };
        (Change::Loop(change), !kind.is_once())
    });
    let parameters = (0..SPECS.len(), any::<f64>(), proptest::option::of(times())).prop_filter_map(
        "finite",
        |(index, number, over)| {
            let value = RequestedValue::Number(number);
            let wanted = Desired {
                parameter: SPECS[index].parameter,
                value,
                over,
            };
            number
                .is_finite()
                .then_some((Change::Parameter(wanted), false))
        },
    );
    prop_oneof![loops, parameters]
}

proptest! {
    #[test]
    fn whatever_is_printed_is_read_again(
        (change, lasts) in changes(),
        from in instants(),
        to in proptest::option::of(instants()),
    ) {
        let fault = Fault { from, to: to.filter(|_| lasts), changes: vec![change] };
        prop_assert_eq!(fault.to_string().parse::<Fault>(), Ok(fault.clone()), "{}", fault);
    }

    /// Injected faults, printed and read again, plan the same.
    #[test]
    fn what_was_injected_is_planned_again((change, _) in changes(), from in 0_u64..10_000, ticks in 1_u64..10_000) {
        let live: Vec<LiveFault> = change.faults(Span { from, to: from + ticks }).collect();
        let typed: Vec<Fault> = planned_again(&live).iter().map(|fault| fault.to_string().parse().unwrap()).collect();
        let again: Vec<LiveFault> = typed
            .iter()
            .flat_map(|fault| fault.changes[0].faults(fault.span(1e-3).unwrap()).collect::<Vec<_>>())
            .collect();
        prop_assert_eq!(&again, &live);
        let off = live.first().map(|_| format!("{}=off", change.what()).parse::<Change>());
        if let Some(Ok(off)) = off {
            prop_assert!(off.kinds().iter().zip(&live).all(|((trouble, _), it)| trouble.is_like(&it.trouble)));
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
