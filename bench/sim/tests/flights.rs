//! Simulated flights are, to the bit, as in `snapshots/`: `INSTA_UPDATE=always cargo test -p sim` accepts a change.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::any::Any;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use config::{Settings, overrides};
use control_api::GuardedInner;
use control_api::description::Refused;
use control_api::law::{CopyState, InnerInput, InnerLaw, WrenchSetpoint};
use control_api::registry::Made;
use messages::content::{FlightTarget, TargetKind};
use messages::telemetry::Telemetry;
use sim::recorded_timing::{Event, Source, Timing};
use sim::simulate::{self, InvalidOutputs, OutputFiles};
use sim::simulator::Simulator;

/// The settings of a flight [s], and `KEY=VALUE; ...`.
fn settings(duration_s: f64, set: &str) -> Settings {
    let all = format!("flight.duration_s={duration_s}; {set}");
    let all = all.split("; ").filter(|text| !text.is_empty());
    let all: Vec<_> = all
        .map(|text| overrides::set("--set", text).unwrap())
        .collect();
    Settings::resolve(None, &all).unwrap()
}

fn recorded(flight: &str) -> PathBuf {
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cli/tests/golden");
    golden.join(flight).join("flight.mcap")
}

/// The result of a flight, its last tick, and the exit code and files that `ironbird simulate` leaves.
fn flown(settings: &Settings, timing: Option<&Timing>) -> String {
    let mut rig = Simulator::of(settings)
        .unwrap()
        .with_monitor(settings.theorem().unwrap());
    let mut unusable = InvalidOutputs::default();
    let flight = simulate::fly_with(&mut rig, settings, timing, |rig| {
        unusable.take(rig);
        Ok(())
    })
    .unwrap();
    let directory = tempfile::tempdir().unwrap();
    let states = directory.path().join("states.csv");
    let files = OutputFiles {
        states: Some(&states),
        plot: None,
    };
    let (reported, result) = simulate::report(settings, timing, &files).unwrap();
    let code = result.exit_code;
    assert_eq!(reported.outputs, flight.outputs);
    let rows = fs::read_to_string(states).unwrap().lines().count();
    format!(
        "{flight:?}\n{:?}\n{:?} {:?}\n{:?}\nexit code {code}, {rows} rows\n\n",
        rig.joined(),
        rig.rejections(),
        unusable.sentences(settings).unwrap(),
        rig.theorem().innovation(),
    )
}

#[test]
fn flights_with_faults_losses_and_recorded_timing_are_their_snapshots() {
    let timing = Timing::read(&recorded("real-time")).unwrap();
    let mut text = format!(
        "{} events, timing {}\n\n",
        timing.events.len(),
        timing.sum()
    );
    for set in [
        "flight.faults=[\"mass_kg=0.6~50ms@100ms\"]",
        "outer.law=estimating; inner.law=indi; flight.preset=soft",
        "flight.faults=[\"inner.stop=20ms@100ms\", \"inner.kill@150ms\", \"mixer.late=1500us@50ms..80ms\", \
         \"state.drop=0.2@50ms..300ms\", \"plant.stop=5ms@350ms\"]",
        "inner.law=pid; flight.faults=[\"outer.kill@100ms\", \"mixer.kill@250ms\", \
         \"state.position_w_m.z.nan@tick220..tick230\", \"rotor_speeds.delay=3@300ms\"]",
        "flight.trajectory=step; flight.position_error_max_m=0.5",
        "flight.tilt_max_rad=0.1; initial.attitude_rad=[0.3, 0, 0]",
        "initial.position_w_m=[0, 0, -0.3]",
        "recorder.gate_theorem_strict=true",
    ] {
        text += &format!("{set}\n{}", flown(&settings(0.4, set), None));
    }
    for set in ["", "inner.law=pid; flight.trajectory=fast"] {
        let flown = flown(&settings(0.2, set), Some(&timing));
        text += &format!("timed {set}\n{flown}");
    }
    insta::assert_snapshot!(text);
}

/// The gates of a flight of 2 s at one place, without ground, with these settings.
fn judged(set: &str) -> Vec<String> {
    let set = format!("flight.trajectory=hover; flight.ground_z_m=-100; {set}");
    let files = OutputFiles::default();
    let (_, result) = simulate::report(&settings(2.0, &set), None, &files).unwrap();
    let gates = result.gates.into_iter();
    gates
        .map(|it| format!("{} {}: {}", it.held, it.name, it.value))
        .collect()
}

#[test]
fn what_no_stage_published_counts_in_no_gate() {
    let effort = "recorder.max_agitation_rad_s=0.03; recorder.max_saturated_percent=50";
    let check = |set: &str, words: &str| {
        let gates = judged(set);
        assert!(gates.last().unwrap().contains(words), "{gates:?}");
    };
    // The rotors stand still before the first command; the step from there is not one of the mixer.
    check(
        &format!("{effort}; flight.faults=[\"mixer.stop=10ms@0s\"]"),
        "true change of a rotor's command in a tick, rms [rad/s]: 0.01",
    );
    // Without a rotor command there is nothing to judge.
    check(
        &format!("{effort}; flight.faults=[\"mixer.stop=60s@0s\"]"),
        "false change of a rotor's command in a tick, rms [rad/s]: measured nothing: no rotor command was seen",
    );
    let unmoved = "outer.stop=200ms@0s\", \"mixer.stop=60s@0s";
    check(
        &format!("recorder.gate_theorem=true; flight.faults=[\"{unmoved}\"]"),
        "no torque was compared with (19)",
    );
    // Wrenches in ticks without a state count, too: this is less than half of them.
    check(
        "recorder.gate_theorem=true; flight.faults=[\"plant.stop=1200ms@500ms\"]",
        "false theorem: 0 unexplained, estimates live, V_th judged in",
    );
    check(
        "rt.channels=2; recorder.gate_channels=true",
        "measured nothing: no commands of two channels could be compared",
    );
}

#[test]
fn the_rate_error_of_a_short_flight_is_the_mean_of_what_there_was() {
    let settings = settings(0.05, "");
    let rig = Simulator::of(&settings).unwrap();
    let mut rig = rig.with_monitor(settings.theorem().unwrap());
    let (mut steps, mut sum) = (0.0, 0.0);
    simulate::fly(&mut rig, &settings, |rig| {
        let error = rig.theorem().rate_error_rad_s().unwrap();
        (steps, sum) = (steps + 1.0, sum + error * error);
        Ok(())
    })
    .unwrap();
    let (mean, rms) = (
        f64::sqrt(sum / steps),
        rig.theorem().rate_error_rms_rad_s().unwrap(),
    );
    assert!(
        mean > 0.0 && (rms / mean - 1.0).abs() < 0.05,
        "{rms}, {mean}"
    );
}

#[test]
fn a_flight_that_left_its_envelope_without_a_setpoint_is_lost() {
    let blown = "\"outer.stop=2s@10ms\", \"wind_x_m_s=10@10ms\"";
    let set = format!("flight.position_error_max_m=1; flight.faults=[{blown}]");
    let gates = judged(&set);
    let begin = "false flight envelope: the flight left its envelope: position error up to ";
    assert!(gates[0].starts_with(begin), "{gates:?}");
    let settings = settings(2.0, &format!("flight.trajectory=hover; {set}"));
    let mut rig = Simulator::of(&settings).unwrap();
    let flown = simulate::fly(&mut rig, &settings, |_| Ok(())).unwrap();
    // It flew to its end, as the outer loop was silent.
    assert_eq!(flown.ticks, 2001);
    let error_m = |tick: u64| {
        let mut rig = Simulator::of(&settings).unwrap();
        rig.start().unwrap();
        (0..=tick).for_each(|_| rig.tick());
        rig.state().truth.position_w_m[0]
    };
    let tick = flown.departure_tick.unwrap();
    assert!(error_m(tick) > 1.0 && error_m(tick - 1) <= 1.0);
}

#[test]
fn what_stages_sent_after_the_last_state_counts_and_skipped_ticks_are_flight_time() {
    let mut timing = Timing::read(&recorded("real-time")).unwrap();
    let is_last_state = |event: &Event| event.tick == 200 && matches!(event.source, Source::State);
    timing.events.retain(|event| !is_last_state(event));
    // The inner loop goes on with what it had.
    for event in timing.events.iter_mut().filter(|event| event.tick == 200) {
        if let Source::Wrench { state, setpoint } = &mut event.source {
            (*state, *setpoint) = (199, 199);
        }
    }
    timing.last_tick = 199;
    let settings = settings(0.199, "");
    let fly = |timing: &Timing| {
        let (mut rig, mut ticks) = (Simulator::of(&settings).unwrap(), String::new());
        let flight = simulate::fly_with(&mut rig, &settings, Some(timing), |rig| {
            ticks += &format!("{:?}\n", rig.joined());
            Ok(())
        });
        let flight = flight.unwrap();
        ((flight.outputs, flight.ticks), ticks)
    };
    let whole = fly(&timing);
    timing.events.retain(|event| event.tick < 200);
    let cut = fly(&timing);
    assert_ne!(whole.0.0, cut.0.0);
    assert!(whole.1 == cut.1 && whole.1.lines().count() == 200);
    // Skipped ticks, also at the end, are a part of the flight.
    let is_skipped = |tick| (50..53).contains(&tick) || tick >= 195;
    timing.events.retain(|event| !is_skipped(event.tick));
    let skipping = fly(&timing);
    assert_eq!((skipping.0.1, skipping.1.lines().count()), (200, 192));
}

/// A law that counts how often it is started.
#[derive(Clone, Default)]
struct Counting(Arc<AtomicU64>);

impl CopyState for Counting {
    fn copy_into(&self, _: &mut dyn Any) -> bool {
        false
    }

    fn as_any(&mut self) -> &mut dyn Any {
        self
    }
}

impl InnerLaw for Counting {
    fn start(&mut self, comes_by_the_clock: bool) -> Result<(), Refused> {
        assert!(!comes_by_the_clock);
        self.0.fetch_add(1, Ordering::Relaxed);
        Ok(())
    }

    fn tick(&mut self, input: &InnerInput, _: &mut Telemetry) -> WrenchSetpoint {
        assert_eq!(self.0.load(Ordering::Relaxed), 1, "tick {}", input.tick);
        WrenchSetpoint {
            thrust_n: input.wanted.thrust_n,
            torque_b_nm: [0.0; 3],
        }
    }
}

#[test]
fn a_law_is_started_once_before_tick_0_with_and_without_recorded_timing() {
    let timing = Timing::read(&recorded("real-time")).unwrap();
    let settings = settings(0.1, "");
    let rig = settings.rig().unwrap();
    for timing in [None, Some(&timing)] {
        let law = Counting::default();
        let inner = GuardedInner::new(Made::<dyn InnerLaw>::of(law.clone(), 0), &rig);
        let outer = settings.outer_stage().unwrap();
        let mut rig = Simulator::with(&settings, outer, inner).unwrap();
        simulate::fly_with(&mut rig, &settings, timing, |_| Ok(())).unwrap();
        assert_eq!(law.0.load(Ordering::Relaxed), 1);
    }
}

/// Inner laws of different kinds follow the reference that the plant makes of targets.
#[test]
fn a_vehicle_that_a_ground_station_flies_stays_near_its_reference() {
    let (position, velocity) = (TargetKind::Position as u64, TargetKind::Velocity as u64);
    let target = |from_tick, kind, position_w_m, velocity_w_m_s, yaw_rad| FlightTarget {
        from_tick,
        kind,
        position_w_m,
        velocity_w_m_s,
        yaw_rad,
    };
    let targets = [
        target(500, position, [0.0, 0.0, 2.0], [0.0; 3], 0.0),
        target(4000, position, [6.0, -5.0, 3.0], [0.0; 3], 3.0),
        // On the way, back.
        target(5500, position, [-2.0, 0.0, 3.0], [0.0; 3], -3.0),
        target(8000, velocity, [0.0; 3], [0.0, 2.0, -0.5], 1.0),
        target(9000, 0, [0.0; 3], [0.0; 3], 1.0),
    ];
    for inner in ["adaptive", "indi", "geometric"] {
        let settings = settings(
            12.0,
            &format!("flight.trajectory=mavlink; inner.law={inner}"),
        );
        let refused = Simulator::of(&settings).err().unwrap().to_string();
        assert!(refused.contains("flown by a ground station"), "{refused}");
        let (outer, inner_stage) = (
            settings.outer_stage().unwrap(),
            settings.inner_stage().unwrap(),
        );
        let mixer = settings.mixer_stage().unwrap();
        let mut rig = Simulator::new(&settings.plant().unwrap(), outer, inner_stage, mixer);
        let (mut due, mut worst_m, mut farthest_m) = (targets.iter().peekable(), 0.0_f64, 0.0_f64);
        for tick in 0..=settings.last_tick() {
            if let Some(target) = due.next_if(|it| it.from_tick == tick) {
                assert!(rig.plant_mut().aim(*target));
            }
            rig.tick();
            let state = rig.state();
            assert_eq!(rig.setpoint().unwrap().reference, state.reference);
            worst_m = worst_m.max(state.position_error_m(&state.reference));
            farthest_m = farthest_m.max(state.truth.position_w_m[0]);
        }
        assert!(
            worst_m < 0.05 && farthest_m > 1.0,
            "{inner}: {worst_m} m, {farthest_m} m"
        );
    }
}
