//! Random flights replay, and every outage of their reports is in their logs: one to three channels, several rates, plants
//! that stand still, stopped and killed stages, and pairs of these. IRONBIRD_RANDOM_FLIGHTS sets their number,
//! IRONBIRD_RANDOM_SEED the first one, IRONBIRD_RANDOM_MS their length.

use std::collections::{BTreeMap, BTreeSet};

use analysis::command_verdicts::CommandVerdicts;
use analysis::schema::Report;
use fastrand::Rng;
use flight_log::entry::LogEntry;
use messages::header::Header;

use crate::rig::{Rig, read_log};

fn number(name: &str, default: u64) -> u64 {
    let value = std::env::var(name).ok();
    value.map_or(default, |text| text.parse().unwrap())
}

/// The flags of a flight.
fn plan(dice: &mut Rng) -> String {
    let channels = dice.u64(1..4);
    let rate_khz = [1, 1, 2, 4, 8][dice.usize(..5)];
    // Slow enough for a busy machine: ticks of a millisecond or more on the clock.
    let slowdown = rate_khz * [1, 1, 4][dice.usize(..3)];
    let (mut faults, mut kills, mut stops_plant) = (String::new(), false, false);
    for _ in 0..dice.u64(0..3) {
        let at_ms = dice.u64(20..250);
        let prefix = ["", "a.", "b.", "c."][dice.usize(..=channels as usize)];
        let stage = ["outer", "inner", "mixer"][dice.usize(..3)];
        let fault = match dice.u64(..4) {
            0 => {
                stops_plant = true;
                let ms = [1, 3, 40, 70, 130, 400, 2000][dice.usize(..7)];
                format!("plant.stop={}us", 1000 * ms / slowdown.max(1) + 500)
            }
            1 if channels > 1 => {
                kills = true;
                format!("{prefix}{stage}.kill")
            }
            2 => format!("{prefix}{stage}.late={}us", dice.u64(100..2000)),
            _ => format!("{prefix}{stage}.stop={}ms", dice.u64(1..60)),
        };
        let fault = match channels {
            1 => fault.replace("a.", ""),
            _ => fault,
        };
        let span = if fault.contains("late") {
            format!("{at_ms}ms..{}ms", at_ms + 40)
        } else {
            format!("{at_ms}ms")
        };
        faults += &format!(" --fault {fault}@{span}");
    }
    let on_death = match stops_plant && !kills {
        true => "end",
        false => "restart",
    };
    let ms = number("IRONBIRD_RANDOM_MS", 300);
    format!(
        "--channels {channels} --rate {rate_khz}k --set flight.slowdown={slowdown} --trajectory hover --duration {ms}ms \
         --on-death {on_death}{faults}"
    )
}

/// Checks the outages of a report by the messages of the log: in each of their ticks, the command missed its deadline, or a
/// stage sent nothing or worked with an older input.
fn check_outages(report: &Report, entries: &[LogEntry]) {
    let mut whole = BTreeMap::<u64, [bool; 4]>::new();
    let (mut verdicts, mut missed) = (CommandVerdicts::default(), BTreeSet::new());
    for entry in entries {
        let mut stage = |stage: usize, envelope: &Header| {
            let is_fresh = stage == 0 || envelope.input_tick[stage - 1] == envelope.tick;
            whole.entry(envelope.tick).or_default()[stage] = is_fresh;
        };
        match entry {
            LogEntry::Setpoint(it) => stage(1, &it.envelope),
            LogEntry::Wrench(it) => stage(2, &it.envelope),
            LogEntry::RotorSpeeds(it) => stage(3, &it.envelope),
            LogEntry::Decisions(it) => {
                it.content
                    .commands()
                    .iter()
                    .for_each(|it| verdicts.take(it));
                if it.envelope.tick > report.ticks.elapsed_periods - 1 {
                    verdicts.judge(it.envelope.tick, |tick| _ = missed.insert(tick - 1));
                }
            }
            LogEntry::State(it) => {
                stage(0, &it.envelope);
                if it.content.decision.count == 1 {
                    verdicts.take(&it.content.decision.command);
                }
                verdicts.judge(it.envelope.tick, |tick| _ = missed.insert(tick - 1));
            }
            LogEntry::Swap(_) | LogEntry::Theorem(_) | LogEntry::Loss(_) => {}
        }
    }
    assert_eq!(report.deadlines.missed, missed.len() as u64);
    for outage in &report.autopsy.worst {
        let ticks = outage.tick..outage.tick + outage.ticks;
        let in_it = missed.range(ticks.clone()).count() as u64;
        assert_eq!(in_it, outage.missed, "{outage:?}");
        for tick in ticks {
            let is_whole = whole.get(&tick) == Some(&[true; 4]);
            assert!(
                !is_whole || missed.contains(&tick),
                "tick {tick}: {outage:?}"
            );
        }
    }
    let classes = report.autopsy.classes.iter();
    assert_eq!(
        classes.map(|it| it.missed).sum::<u64>(),
        missed.len() as u64
    );
}

#[test]
fn random_flights_replay_and_their_outages_are_in_their_logs() {
    let first = number("IRONBIRD_RANDOM_SEED", 0);
    let flights = number("IRONBIRD_RANDOM_FLIGHTS", 3);
    let (mut seeds, mut flown) = (first.., 0);
    while flown < flights {
        let seed = seeds.next().unwrap();
        let flags = plan(&mut Rng::with_seed(seed));
        let rig = Rig::new("random");
        let ended = rig.run("fly", &flags);
        // Two faults that contradict each other are refused.
        if ended.code == Some(2) {
            continue;
        }
        flown += 1;
        let replayed = rig.run("replay", "latest --verify");
        assert!(
            replayed.stdout.contains(", identical; "),
            "seed {seed}: {flags}\n{replayed}\n{ended}"
        );
        println!("seed {seed}: {flags}");
        // Of the channels, the flown messages are logged as soon as the plant has decided.
        let log = rig.out().join("latest").join(flight_log::FILE);
        let (mut entries, _) = read_log(&log);
        entries.sort_by_key(|it| it.envelope().sent_ns());
        let report = Report::read(&log.with_file_name("report.json")).unwrap();
        check_outages(&report, &entries);
    }
}
