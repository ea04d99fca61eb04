//! Tests of what the report says of the theorem, through restarts of the inner loop and lost messages.

use super::*;

fn monitor(unexplained: u64, is_live: u64) -> Monitor {
    let mut monitor = Monitor { ticks_checked: 10, is_live, v_th_start: 1.0, ..Monitor::default() };
    monitor.violations[Cause::Unexplained as usize] = unexplained;
    monitor.rise_max[Cause::GyroNoise as usize] = 0.5;
    monitor
}

#[test]
fn an_unexplained_violation_or_lifeless_estimates_fail() {
    assert!(Theorem::of(&monitor(0, 1), [0.0; 3], [1.0; 3], 0).holds);
    for (monitor, said) in [(monitor(1, 1), "1 unexplained"), (monitor(0, 0), "do not move as predicted")] {
        let theorem = Theorem::of(&monitor, [0.0; 3], [1.0; 3], 0);
        assert!(!theorem.holds && theorem.found().contains(said), "{theorem:?}");
        assert!(theorem.text().contains("DOES NOT HOLD"), "{}", theorem.text());
    }
}

#[test]
fn no_bound_is_claimed_where_an_assumption_was_broken_since_the_last_live_swap() {
    fn with(causes: u64) -> Monitor {
        Monitor { causes, estimate_error: [1.0; 3], estimate_error_start: [1.0; 3], ..monitor(0, 1) }
    }
    let broken = Cause::BrokenModel.bit();
    let mut tally = TheoremTally::default();
    tally.take(1, &with(broken));
    tally.take(1, &with(Cause::Delay.bit()));
    let theorem = tally.section();
    assert_eq!(theorem.broken, ["broken_model"]);
    assert!(theorem.text().contains("no bound under broken_model"), "{}", theorem.text());
    assert!(!theorem.text().contains("by the theorem"), "{}", theorem.text());
    let said = &theorem.convergence;
    assert!(said.contains("promises nothing for the estimates under broken_model"), "{said}");
    assert!(!said.contains("xpected"), "{said}");
    tally.take(1, &with(Cause::LiveSwap.bit()));
    let theorem = tally.section();
    assert!(theorem.broken.is_empty(), "{:?}", theorem.broken);
    // The bound of 0 is less than the error: what is proven is said with what it leaves out.
    assert!(theorem.text().contains("beside the trapezoidal rule"), "{}", theorem.text());
    tally.take(1, &with(broken));
    tally.take(2, &with(0));
    assert!(tally.section().broken.is_empty(), "another inner loop begins anew");
}

#[test]
fn a_restarted_inner_loop_continues_the_counts() {
    let mut tally = TheoremTally::default();
    assert_eq!(tally.section(), Theorem::default());
    assert!(tally.section().text().contains("not watched"));
    tally.take(1, &monitor(0, 1));
    tally.take(1, &monitor(2, 0));
    tally.take(7, &Monitor { v_th_start: 3.0, excitation: 0.25, ..monitor(1, 1) });
    let theorem = tally.section();
    assert_eq!((theorem.ticks_checked, theorem.unexplained(), theorem.is_live), (20, 3, false));
    assert_eq!((theorem.v_th_start, theorem.excitation), (3.0, 0.25));
    assert_eq!(theorem.largest_rise["gyro_noise"], Rise { absolute: 0.5, relative: 0.5 / 3.0 });
}

#[test]
fn what_was_not_watched_is_said() {
    let mut tally = TheoremTally::default();
    tally.unwatched();
    tally.unwatched();
    assert!(tally.section().text().contains("before the first step was lost, and 2 ticks went by"));
    tally.take(1, &monitor(0, 1));
    let theorem = tally.section();
    assert_eq!((theorem.ticks_checked, theorem.ticks_unwatched, theorem.holds), (10, 2, true));
    assert!(theorem.text().contains("10 steps checked, 2 not watched after a lost message, V rose in none"));
}
