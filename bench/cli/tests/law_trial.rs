//! The trial of laws: the built-in laws pass it, and each way to fail is found.

use control_api::description::{Description, Refused, Settings};
use control_api::law::{Fields, InnerInput, InnerLaw, Law, Rig, WrenchSetpoint};
use ironbird::laws::findings_text;
use messages::role::Role;
use messages::telemetry::Telemetry;
use plugin::trial::{Candidate, trial, trial_of};
use std::hint::black_box;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

#[test]
fn every_built_in_law_passes() {
    let (rig, settings) = (Rig::default(), Settings::default());
    let passes = |name: &str, make: &dyn Fn() -> Result<Candidate, Refused>| {
        let findings = trial_of(&rig, [10_000, 1000], 11, make, || ()).unwrap();
        let states = [findings.rehearsed, findings.restored];
        let ticks = [findings.difference, findings.not_finite];
        assert_eq!([states, ticks], [[None; 2]; 2], "{name}");
        assert!(findings.is_copied && findings.is_saved, "{name}");
        let [median, p99] = findings.hot_ns;
        assert!(
            0 < median && median <= p99 && 0 < findings.cold_ns,
            "{name}: {findings:?}"
        );
    };
    for law in controller::laws::OUTER {
        let make = || law.make(&rig, &settings).map(Candidate::Outer);
        passes(law.description.name, &make);
    }
    for law in controller::laws::INNER {
        let make = || law.make(&rig, &settings).map(Candidate::Inner);
        passes(law.description.name, &make);
    }
    for law in mixer::LAWS {
        let make = || law.make(&rig, &settings).map(Candidate::Mixer);
        passes(law.description.name, &make);
    }
}

/// Counts its ticks in memory that its copies share, and does not save the count. One tick causes page faults.
#[derive(Clone)]
struct Shares(Arc<AtomicU64>);

impl Law for Shares {
    const DESCRIPTION: Description = Description {
        name: "shares",
        role: Role::Inner,
        version: "1",
        summary: "fails",
        source: "nowhere",
        settings: &[],
        presets: &[],
        suited: None,
        telemetry: &[],
    };

    fn new(_: &Rig, _: &Settings) -> Result<Self, Refused> {
        Ok(Self(Arc::default()))
    }

    fn state(&mut self, _: &mut Fields) {}
}

impl InnerLaw for Shares {
    fn tick(&mut self, _: &InnerInput, _: &mut Telemetry) -> WrenchSetpoint {
        let ticks = self.0.fetch_add(1, Ordering::Relaxed);
        touch_new_memory_at(15_000, ticks);
        WrenchSetpoint {
            thrust_n: ticks as f64,
            torque_b_nm: [0.0; 3],
        }
    }
}

#[test]
fn a_law_that_warm_ups_or_restarts_change_is_found_and_one_that_refuses_is_not_tried() {
    let (rig, settings) = (Rig::default(), Settings::default());
    let make = || Shares::new(&rig, &settings).map(|law| Candidate::Inner(law.into()));
    let findings = trial(&rig, make, || ()).unwrap();
    // Without warm-ups it repeats itself.
    assert_eq!(findings.difference, None);
    let rehearsed = findings.rehearsed.map(|it| (it.input, it.index, it.values));
    assert_eq!(rehearsed, Some((0, 0, [0.0, 1.0])));
    assert!(!findings.passes(true));
    let text = findings_text(&findings, &Shares::DESCRIPTION, true);
    let words = "warm-up      NO: thrust_n of input 0 was 0.0, and 1.0 in or after a warm-up";
    assert!(text.contains(words), "{text}");
    let words = "restored     NO: thrust_n of input 15 was 15.0, and 0.0 from its saved state;";
    assert!(text.contains(words), "{text}");

    let refused = Refused("no".into());
    let tried = trial(&rig, || Err(refused.clone()), || ());
    assert_eq!(tried, Err(refused));
}

#[test]
fn page_faults_are_the_laws_if_another_instance_has_them_too() {
    let (rig, settings) = (Rig::default(), Settings::default());
    let law = || Shares::new(&rig, &settings).map(|law| Candidate::Inner(law.into()));
    let findings = trial_of(&rig, [0, 0], 11, law, || ()).unwrap();
    assert!(findings.usage.minor_faults > 0 && !findings.passes(false));

    let law = || mixer::LAWS[0].make(&rig, &settings).map(Candidate::Mixer);
    let calls = AtomicU64::new(0);
    let once = || touch_new_memory_at(15_000, calls.fetch_add(1, Ordering::Relaxed));
    let findings = trial_of(&rig, [0, 0], 11, law, once).unwrap();
    assert_eq!(findings.usage.minor_faults, 0);
}

/// Longer than what `malloc` takes from memory that was used before.
fn touch_new_memory_at(tick: u64, now: u64) {
    if now == tick {
        black_box(vec![1_u8; 33 << 20]);
    }
}
