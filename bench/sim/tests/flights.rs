//! Simulated flights are, to the bit, as in `snapshots/`: `INSTA_UPDATE=always cargo test -p sim` accepts a change.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use std::fs;
use std::path::{Path, PathBuf};

use config::{Settings, overrides};
use sim::recorded_timing::Timing;
use sim::simulate::{self, InvalidOutputs, OutputFiles};
use sim::simulator::Simulator;

fn settings(duration_s: &str, set: &[&str]) -> Settings {
    let duration = format!("flight.duration_s={duration_s}");
    let all = std::iter::once(duration.as_str()).chain(set.iter().copied());
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
    let [states, plot] = ["states.csv", "flight.svg"].map(|file| directory.path().join(file));
    let files = OutputFiles {
        states: Some(&states),
        plot: Some(&plot),
    };
    let (reported, code) = simulate::report(settings, timing, &files).unwrap();
    assert_eq!(reported.outputs, flight.outputs);
    let lines = |file| fs::read_to_string(file).unwrap().lines().count();
    format!(
        "{flight:?}\n{:?}\n{:?} {:?}\n{:?}\nexit code {code}, {} rows, {} lines of a picture\n\n",
        rig.joined(),
        rig.rejections(),
        unusable.sentences(settings).unwrap(),
        rig.innovation(),
        lines(states),
        lines(plot),
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
    let simulated: [&[&str]; 8] = [
        &["flight.faults=[\"mass_kg=0.6~50ms@100ms\"]"],
        &[
            "outer.law=estimating",
            "inner.law=indi",
            "flight.preset=soft",
        ],
        &[
            "flight.faults=[\"inner.stop=20ms@100ms\", \"outer.kill@150ms\", \"mixer.late=1500us@50ms..80ms\", \
             \"state.drop=0.2@50ms..300ms\", \"plant.stop=5ms@350ms\"]",
        ],
        &[
            "inner.law=pid",
            "flight.faults=[\"inner.kill@100ms\", \"mixer.kill@250ms\", \
             \"state.position_w_m.z.nan@tick220..tick230\", \"rotor_speeds.delay=3@300ms\"]",
        ],
        &["flight.trajectory=step", "flight.position_error_max_m=0.5"],
        &[
            "flight.tilt_max_rad=0.1",
            "initial.attitude_rad=[0.3, 0, 0]",
        ],
        &["initial.position_w_m=[0, 0, -0.3]"],
        &[
            "recorder.gate_theorem=true",
            "flight.tracking_error_max_m=0",
        ],
    ];
    for set in simulated {
        text += &format!("{set:?}\n{}", flown(&settings("0.4", set), None));
    }
    let timed: [&[&str]; 2] = [&[], &["inner.law=pid", "flight.trajectory=fast"]];
    for set in timed {
        text += &format!(
            "timed {set:?}\n{}",
            flown(&settings("0.2", set), Some(&timing))
        );
    }
    insta::assert_snapshot!(text);
}

#[test]
fn a_recorded_timing_is_refused_for_another_flight() {
    let timing = Timing::read(&recorded("real-time")).unwrap();
    let refused: [(&str, &[&str], &str); 3] = [
        (
            "0.2",
            &["flight.period_s=0.002"],
            "has ticks of 1000000 ns, this one of 2000000 ns",
        ),
        ("0.201", &[], "ends at tick 200, this one at tick 201"),
        (
            "0.2",
            &["flight.faults=[\"inner.stop=5ms@10ms\"]"],
            "cannot be combined with recorded timing",
        ),
    ];
    for (duration_s, set, said) in refused {
        let refusal = timing
            .check(&settings(duration_s, set), "timing")
            .unwrap_err();
        assert!(refusal.to_string().contains(said), "{refusal}");
    }
    let refusal = Timing::read(&recorded("swap")).unwrap_err();
    assert!(
        refusal.to_string().contains("was flown in lockstep"),
        "{refusal}"
    );
}

#[test]
fn a_branch_of_a_flight_goes_on_as_the_whole_flight() {
    let plain = settings("0.4", &[]);
    let faults = "flight.faults=[\"state.lag=3@200ms\", \"inner.stop=9ms@250ms\"]";
    let faulty = settings("0.4", &[faults]);
    let mut base = Simulator::of(&plain).unwrap();
    let mut whole = Simulator::of(&faulty).unwrap();
    for _ in 0..100 {
        base.tick();
        whole.tick();
    }
    let mut branch = base.branch(&faulty).unwrap().unwrap();
    for _ in 100..400 {
        branch.tick();
        whole.tick();
        assert_eq!(
            format!("{:?}", branch.joined()),
            format!("{:?}", whole.joined())
        );
    }
}
