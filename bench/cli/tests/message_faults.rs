//! Faults of messages and stages: their effects in a simulation, and that processes and replay fly the same bits.

use config::Settings;
use messages::content::Mode;
use sim::simulate::{SimulatedFlight, fly};
use sim::simulator::Simulator;

const TICKS: u64 = 3001;

fn settings(faults: &[&str]) -> Settings {
    let text = format!("[flight]\nduration_s = 3.0\nfaults = {faults:?}\n");
    Settings::of(text.parse().unwrap(), &Vec::new()).unwrap()
}

/// A flight with faults, and for each tick whether a setpoint, a wrench, a rotor command and a fresh wrench were published.
fn flown(settings: &Settings) -> (SimulatedFlight, Simulator, Vec<[bool; 4]>) {
    let mut rig = Simulator::of(settings)
        .unwrap()
        .with_monitor(settings.theorem().unwrap());
    let mut ticks = Vec::new();
    let simulated = fly(&mut rig, settings, |rig| {
        let wrench = rig.new_wrench();
        ticks.push([
            rig.setpoint().is_some(),
            wrench.is_some(),
            rig.new_rotor_speeds().is_some(),
            wrench.is_some_and(|wrench| wrench.mode == Mode::Fresh as u64),
        ]);
        Ok(())
    });
    (simulated.unwrap(), rig, ticks)
}

#[test]
fn faults_silence_stages_and_miss_deadlines_as_planned() {
    const OUTER: usize = 0;
    const INNER: usize = 1;
    const MIXER: usize = 2;
    const FRESH: usize = 3;
    let undisturbed = flown(&settings(&[])).0.outputs;
    for (fault, place, silent, missed, skipped) in [
        ("outer.state.drop=1@1s..tick1050", OUTER, 50, 0, 0),
        ("rotor_speeds.drop=1@1s..tick1010", MIXER, 0, 10, 0),
        // Each is late, and the last ones are overtaken.
        ("rotor_speeds.delay=3@1s..tick1010", MIXER, 0, 10, 0),
        ("outer.stop=15ms@1s", OUTER, 15, 0, 0),
        ("inner.stop=15ms@1s", INNER, 15, 0, 0),
        ("mixer.stop=15ms@1s", MIXER, 15, 15, 0),
        ("plant.stop=15ms,mass_kg=0.55@1s", OUTER, 15, 0, 15),
        // A stage may be a little late; and the last command of the mixer is due, too.
        ("inner.late=300us@1s..2s", FRESH, 0, 0, 0),
        ("rotor_speeds.drop=1@tick3000", MIXER, 0, 1, 0),
        // A period more is a tick more: no setpoint is missed, but each is stale.
        ("outer.late=1ms@1s..tick1030", OUTER, 0, 0, 0),
        ("outer.late=1ms@1s..tick1030", FRESH, 30, 0, 0),
        // It works every third tick.
        ("mixer.late=2500us@1s..tick1030", MIXER, 20, 30, 0),
        ("inner.kill@1s", INNER, 100, 0, 0),
    ] {
        let (simulated, rig, ticks) = flown(&settings(&[fault]));
        assert_eq!(simulated.ticks, TICKS, "{fault}");
        assert_eq!(simulated.departure, None, "{fault}");
        let is_silent = |tick: &usize| !ticks[*tick][place];
        let expected = 1000..1000 + if place == FRESH { 31 } else { 30.max(silent) };
        let found: Vec<usize> = (0..ticks.len()).filter(is_silent).collect();
        assert_eq!(found.len(), silent, "{fault}: {found:?}");
        assert!(
            found.iter().all(|tick| expected.contains(tick)),
            "{found:?}"
        );
        let state = rig.state();
        let is_late = fault.starts_with("mixer.late") && state.deadlines_missed > missed;
        assert!(state.deadlines_missed == missed || is_late, "{fault}");
        assert_eq!(state.ticks_skipped, skipped, "{fault}");
        assert_eq!(rig.rejections().total(), 0, "{fault}");
        let swaps: Vec<u64> = simulated.swaps.iter().map(|swap| swap.tick).collect();
        assert!(!fault.contains("mass") || swaps == [1000], "{swaps:?}");
        if (silent, missed, skipped) == (0, 0, 0) && !fault.contains("outer") {
            assert_eq!(simulated.outputs, undisturbed, "{fault}");
        }
    }
}

#[test]
fn a_killed_stage_continues_from_its_state_and_a_law_of_an_object_cannot_be_killed() {
    let (_, killed, _) = flown(&settings(&["inner.kill@1s"]));
    let (_, stopped, _) = flown(&settings(&["inner.stop=100ms@1s"]));
    assert_eq!(killed.wrench(), stopped.wrench());
    let checked = |rig: &Simulator| {
        let monitor = rig.monitor().unwrap();
        monitor.ticks_checked + monitor.ticks_stale
    };
    // The monitor goes on with the law's state.
    assert_eq!(checked(&killed), checked(&stopped));
    let settings = settings(&["inner.kill@1s"]);
    let (outer, inner) = (
        settings.outer_stage().unwrap(),
        settings.inner_stage().unwrap(),
    );
    let refused = Simulator::with(&settings, outer, inner).err().unwrap();
    let why = "inner.kill: this law was passed as an object";
    assert!(refused.to_string().contains(why), "{refused}");
}
