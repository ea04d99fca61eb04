//! In flight, a tick of a loop allocates once (the middleware's loan) and faults no page, whatever clients do meanwhile.

use crate::parameter_changes::mass;
use crate::restarts::in_the_air;
use crate::rig::{Rig, lacks_feature, not_tested};
use ipc::{SwapOrder, SwapOutcome, Wire};
use messages::content::NO_TICK;
use process::rt::fifo_refusal;
use std::time::Duration;

/// Only ends a test that hangs.
const LONG: Duration = Duration::from_secs(60);

#[test]
fn a_tick_allocates_only_the_loan_and_faults_no_page() {
    if !cfg!(feature = "instrumented") {
        return lacks_feature("allocations of the loops", "instrumented");
    }
    let rig = Rig::with_features("ticks");
    // In slow motion, with warm-up runs before each tick.
    let config = in_the_air(&rig, 5);
    let flight = rig.take_off(format!("--rt prefer --config {config} --duration 1200ms"));
    rig.await_tick(50);
    // Parameter changes of clients that come and go, ramps, and faults of every input and stage.
    for client in 0..20 {
        let wire = Wire::open(&rig.known()).unwrap();
        let order = mass(NO_TICK, 0.5 + f64::from(client) / 100.0);
        let answer = wire
            .client::<SwapOrder>()
            .unwrap()
            .request(order, LONG)
            .unwrap();
        assert_eq!(answer.verdict, SwapOutcome::Applied as u64);
    }
    rig.ok("inject rotational_drag_nm_s=0.3~100ms rotor_efficiency_2=0.9 gyro_noise_rad_s=0.01");
    rig.ok("inject state.lag=3,setpoint.freeze,wrench.delay=1,rotor_speeds.drop=0.1 --for 10ms");
    rig.ok("inject outer.late=1us,inner.late=1us,mixer.late=1us,plant.late=1us --for 10ms");
    flight.end().expect(0);
    let report = rig.final_report();
    for role in ["plant", "outer", "inner", "mixer"] {
        let loops = &report.roles[role];
        let usage = loops.usage.as_ref().unwrap();
        // With what the first ticks fetch once. `law_matrix.md` shows that a law's allocations are counted.
        let most = loops.ticks_run + 5;
        assert!(usage.allocations.unwrap() <= most, "{role}: {usage:?}");
        let locked = loops
            .realtime
            .iter()
            .all(|it| it.step != "memory_lock" || it.granted);
        let faults = (usage.minor_faults, usage.major_faults);
        if locked && fifo_refusal(80).is_none() {
            assert_eq!(faults, (0, 0), "{role}: {usage:?}");
        } else {
            not_tested("page faults: memory could not be locked");
        }
    }
}
