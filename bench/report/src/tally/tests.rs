//! Counts that add up, and stay bounded.

use controller::Trajectory;
use model::envelope::{Envelope, Stamps};
use model::role::STAGES;

use super::*;

#[test]
fn ticks_add_up_in_flight_whatever_the_plant_has_skipped_since() {
    let grid = Grid { t0_ns: 1_000_000_000, period_ns: 1_000_000 };
    let tracking = Tracking::of(Trajectory::Hover, 1e-3);
    let mut tally = Tally::new(Pace::Realtime(grid), grid.t0_ns, tracking).unwrap();
    // Ticks 3 and 4 were skipped.
    for (seq, tick) in (0..).zip([0, 1, 2, 5, 6]) {
        let sample_ns = grid.begin_of(tick) + 20_000;
        let envelope = Envelope { tick, seq, sample_ns, ..Envelope::new() };
        let content = State { ticks_skipped: if tick > 2 { 2 } else { 0 }, ..State::default() };
        tally.state(&Message { envelope, content });
    }
    let phase =
        |phase: boards::RunPhase| boards::Run { phase: phase as u64, ticks_skipped: 9, ..boards::Run::default() };
    let flying = tally.ticks(&phase(boards::RunPhase::Flying));
    assert_eq!((flying.run, flying.skipped, flying.elapsed_periods, flying.identity_holds), (5, 2, 7, true));
    // At the end the plant's own count is held against the messages.
    assert!(!tally.ticks(&phase(boards::RunPhase::Closed)).identity_holds);
}

/// Messages of a tick as a flight on `grid` has them: every 50th is late, and brings a swap.
fn take_tick(tally: &mut Tally, grid: Grid, seq: u64, tick: u64) {
    let envelope = |sent_us: u64| {
        let mut envelope = Envelope { tick, seq, sample_ns: grid.begin_of(tick) + 20_000, ..Envelope::new() };
        envelope.input_tick = [tick; 3];
        let stamps = Stamps { receive_ns: grid.begin_of(tick) + 10_000, send_ns: grid.begin_of(tick) + sent_us * 1000 };
        envelope.stamps = [stamps; STAGES.len()];
        envelope
    };
    let (is_late, late) = (seq.is_multiple_of(50), seq / 50);
    let content = State { deadlines_missed: late, deadline_miss_run: u64::from(is_late), ..State::default() };
    tally.state(&Message { envelope: envelope(20), content });
    tally.setpoint(&Message { envelope: envelope(30), content: Setpoint::default() });
    tally.wrench(&Message { envelope: envelope(40), content: Wrench::default() });
    let sent_us = if is_late { 1_100 } else { 50 };
    tally.rotor_speeds(&Message { envelope: envelope(sent_us), content: RotorSpeeds::default() });
    if is_late {
        let envelope = Envelope { tick, seq: late, ..Envelope::new() };
        tally.swap(&Message { envelope, content: SwapRecord::default() });
    }
}

#[test]
fn what_is_kept_is_bounded_however_long_a_flight_is() {
    let grid = Grid { t0_ns: 1_000_000_000, period_ns: 1_000_000 };
    let mut tally = Tally::new(Pace::Realtime(grid), grid.t0_ns, Tracking::of(Trajectory::Hover, 1e-3)).unwrap();
    tally.begin_autopsy(true, true);
    for tick in 0..60_000 {
        take_tick(&mut tally, grid, tick, tick);
        if let Some(autopsy) = &mut tally.autopsy {
            autopsy.look();
        }
        assert!(tally.passages.len() <= 8 && tally.commands.len() <= 2, "tick {tick}");
    }
    assert_eq!((tally.swaps.len(), tally.swaps_seen), (SWAPS_KEPT, 1200));
    assert!(tally.late_commands.stretches().len() <= deadlines::KEPT && tally.late_commands.left_out() > 0);
    assert!(tally.miss_runs.lengths().len() <= 2, "{:?}", tally.miss_runs.lengths());
    assert_eq!(tally.lost(), [0; TOPICS.len()]);
}

#[test]
fn a_flight_of_30_days_is_counted_as_one_of_a_minute_is() {
    const DAYS_30: u64 = 30 * 86_400_000;
    let grid = Grid { t0_ns: 1_000_000_000, period_ns: 1_000_000 };
    let tracking = Tracking::of(Trajectory::Lissajous, 1e-3);
    let mut tally = Tally::joining(Pace::Realtime(grid), grid.t0_ns, tracking).unwrap();
    for tick in DAYS_30 - 1000..=DAYS_30 {
        take_tick(&mut tally, grid, tick, tick);
    }
    assert_eq!((tally.states, tally.newest_tick(), tally.lost()), (1001, DAYS_30, [0; TOPICS.len()]));
    let late = tally.late_commands.stretches();
    assert!(late.len() >= 20 && late.iter().all(|stretch| stretch.late_ns == 100_000), "{late:?}");
    assert!(tracking.position_w_m(DAYS_30).iter().all(|m| m.is_finite() && m.abs() < 10.0));
}
