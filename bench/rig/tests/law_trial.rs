//! The trial of laws: what comes with the rig passes it, and each way to fail is found.

use control_api::description::{Description, Refused, Settings};
use control_api::law::{Desired, InnerLaw, Law, Rig, WrenchSetpoint};
use ironbird::laws::trial::{Candidate, Findings, trial, words};
use messages::content::{Measured, Reference, Stamped};
use messages::role::Role;
use messages::telemetry::Telemetry;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

fn passes(name: &str, findings: &Findings) {
    assert_eq!(findings.difference, None, "{name}");
    assert_eq!(findings.not_finite, None, "{name}");
    assert!(findings.is_copied, "{name}");
    assert_eq!(findings.rehearsed, None, "{name}");
    let [median, p99] = findings.hot_ns;
    assert!(
        0 < median && median <= p99 && 0 < findings.cold_ns,
        "{name}: {findings:?}"
    );
}

#[test]
fn every_law_that_comes_with_the_rig_passes() {
    let (rig, settings) = (Rig::default(), Settings::default());
    for entry in controller::laws::OUTER {
        let make = || entry.make(&rig, &settings).map(Candidate::Outer);
        passes(entry.description.name, &trial(&rig, make, || ()).unwrap());
    }
    for entry in controller::laws::INNER {
        let make = || entry.make(&rig, &settings).map(Candidate::Inner);
        passes(entry.description.name, &trial(&rig, make, || ()).unwrap());
    }
    for entry in mixer::LAWS {
        let make = || entry.make(&rig, &settings).map(Candidate::Mixer);
        passes(entry.description.name, &trial(&rig, make, || ()).unwrap());
    }
}

/// Counts its ticks in memory that its copies share.
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
}

impl InnerLaw for Shares {
    fn tick(
        &mut self,
        _: u64,
        _: &Stamped<Measured>,
        _: &Stamped<Desired>,
        _: &Reference,
        _: &mut Telemetry,
    ) -> WrenchSetpoint {
        WrenchSetpoint {
            thrust_n: self.0.fetch_add(1, Ordering::Relaxed) as f64,
            torque_b_nm: [0.0; 3],
        }
    }
}

#[test]
fn a_law_that_its_rehearsals_change_is_found() {
    let (rig, settings) = (Rig::default(), Settings::default());
    let findings = trial(
        &rig,
        || Shares::new(&rig, &settings).map(|law| Candidate::Inner(law.into())),
        || (),
    )
    .unwrap();
    assert_eq!(findings.difference, None, "asked alone it repeats itself");
    assert_eq!(
        findings.rehearsed.map(|it| (it.input, it.index, it.values)),
        Some((0, 0, [0.0, 1.0]))
    );
    assert!(!findings.passes(true));
    let said = words::render(&findings, &Shares::DESCRIPTION, true);
    assert!(
        said.contains("rehearsed    NO: thrust_n of input 0 was 0.0, and 1.0 where it had been"),
        "{said}"
    );
}

#[test]
fn a_law_that_refuses_to_begin_is_not_tried() {
    let refused = Refused("no".into());
    let make = || Err(refused.clone());
    assert_eq!(trial(&Rig::default(), make, || ()).unwrap_err(), refused);
}
