//! Twenty flights in a row replay bit for bit, flown at 1 kHz on a machine that has something else to do.
//!
//! `stress-ng` keeps two processors busy. Where it is not installed the flights are left out, and that is said.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use crate::rig;

use std::process::{Child, Command, Stdio};

use crate::rig::{Rig, lacks_tool};

const FLIGHTS: usize = 20;

/// Load that ends with the test, also when it panics.
struct Stress(Child);

impl Stress {
    fn start() -> Option<Self> {
        let mut command = Command::new("stress-ng");
        command.args(["--cpu", "2", "--timeout", "10m"]).stdout(Stdio::null()).stderr(Stdio::null());
        command.spawn().ok().map(Self)
    }
}

impl Drop for Stress {
    fn drop(&mut self) {
        // It ends its workers on this signal.
        rig::send(self.0.id(), rustix::process::Signal::TERM);
        let _ = self.0.wait();
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn twenty_flights_under_load_are_identical() {
    let Some(_stress) = Stress::start() else {
        lacks_tool("no flights under load: stress-ng is not installed");
        return;
    };
    for flight in 0..FLIGHTS {
        let rig = Rig::new("stressed");
        // Real time where it is granted, and as one of many where the load shows most.
        let rt = if flight % 2 == 0 { "prefer" } else { "off" };
        let noise = format!("gyro_noise_rad_s=0.01@tick{}", 50 + flight);
        let faults = ["--fault", &noise, "--fault", "mass_kg=0.6,rotor_efficiency_2=0.9@tick301"];
        let flown = rig.run("fly", &[&["--rt", rt, "--duration", "700ms"], faults.as_slice()].concat());
        assert!(!rig.run_directories().is_empty(), "{flown}");
        let verified = rig.run("replay", &["--verify"]).expect(0);
        assert!(verified.stdout.contains(" values, identical; outputs "), "{verified}");
    }
}
