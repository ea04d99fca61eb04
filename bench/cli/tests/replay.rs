//! Replay: logs with gaps, faults and restarts give every bit again; damaged ones never pass.

use crate::recorded::{Published, TickFaults, facts, fly, settings, write};
use errors::Failure;
use fastrand::Rng;
use flight_log::entry::LogEntry;
use flight_log::facts::record;
use flight_log::reader::LogReader;
use flight_log::writer::FlightLog;
use messages::content::TakenCommand;
use messages::header::Message;
use messages::role::{Channel, Role, STAGES};
use messages::telemetry::{Signal, Signals};
use messages::topic::Topic;
use replay::{ReplayResult, fly_again};
use sim::recorded_timing::Timing;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Writes a log again with this landing record, without the messages that `keep` does not want, which it may also change.
/// It may be that of a channel.
fn rewrite(
    channel: Option<Channel>,
    from: &Path,
    to: &Path,
    text: &str,
    landing: &[(&str, &str)],
    mut keep: impl FnMut(&mut LogEntry) -> bool,
) {
    let mut reader = LogReader::open(from).unwrap();
    let mut log = FlightLog::create(to, &facts(&settings(text), channel)).unwrap();
    while let Some(mut entry) = reader.next_entry().unwrap().copied() {
        if keep(&mut entry) {
            log.take(&entry, reader.position());
        }
    }
    log.finish(record(landing)).unwrap();
}

const SHORT: &str = "[flight]\nduration_s = 0.1\n";
const NOISY: &str = "[flight]\nduration_s = 0.4\ntrajectory = \"fast\"\nfaults = [\"gyro_noise_rad_s=0.02@tick7\", \
    \"rotational_drag_nm_s=0.525,mass_kg=0.6@60ms\", \"rotor_efficiency_3=0.5@tick200\", \"mass_kg=0.5@tick400\"]\n\
    [rotor]\nmax_rad_s = 220.0\n";

struct Recording {
    directory: TempDir,
    log: PathBuf,
    published: Published,
}

fn record_flight(text: &str, faults: impl Fn(u64) -> TickFaults) -> Recording {
    let directory = tempfile::tempdir_in("/dev/shm").unwrap();
    let (log, settings) = (directory.path().join("flight.mcap"), settings(text));
    let published = fly(&settings, faults);
    write(&log, &settings, &published);
    Recording {
        directory,
        log,
        published,
    }
}

fn noisy() -> Recording {
    record_flight(NOISY, |_| TickFaults::default())
}

impl Recording {
    fn path(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }
}

fn verify(path: &Path) -> Result<ReplayResult, Failure> {
    fly_again(path, 0, true, &[])
}

#[track_caller]
fn assert_identical(path: &Path) -> ReplayResult {
    let replayed = verify(path).unwrap();
    assert!(replayed.is_identical(), "{:?}", replayed.comparison.first);
    replayed
}

#[track_caller]
fn assert_refused(path: &Path, words: &str) {
    let said = verify(path).unwrap_err().to_string();
    assert!(said.contains(words), "no `{words}` in {said}");
}

#[test]
fn a_flight_without_faults_is_identical_and_every_value_is_compared() {
    fn values<C: Topic>(messages: &[Message<C>], signals: &[Signal]) -> u64 {
        let content = C::default();
        let telemetry = content.telemetry();
        let unnamed = telemetry.map_or(0, |it| it.value.len() - signals.len());
        ((size_of::<C>() / size_of::<u64>() - unnamed) * messages.len()) as u64
    }
    let flight = record_flight(SHORT, |_| TickFaults::default());
    let replayed = assert_identical(&flight.log);
    assert_eq!(replayed.summary.ticks, 101);
    let Signals {
        outer,
        inner,
        mixer,
    } = settings(SHORT).flown_laws().unwrap().signals;
    assert_eq!([outer.len(), inner.len(), mixer.len()], [3, 6, 3]);
    let published = &flight.published;
    let expected = values(&published.setpoints, outer)
        + values(&published.wrenches, inner)
        + values(&published.rotor_speeds, mixer)
        + values(&published.states, &[])
        + values(&published.theorem, &[]);
    assert_eq!(replayed.comparison.values, expected);
    let later = fly_again(&flight.log, 60, true, &[]).unwrap();
    assert!(later.is_identical() && later.summary.ticks == 41);
    let beyond = fly_again(&flight.log, 102, true, &[]).unwrap_err();
    let beyond = beyond.to_string();
    assert!(
        beyond.contains("--from 102: the log ends at tick 100"),
        "{beyond}"
    );
}

#[test]
fn a_stage_that_is_silent_or_starts_again_is_identical() {
    for stage in STAGES {
        let is_silent = |tick: u64| (40..43).contains(&tick) || (120..260).contains(&tick);
        let flight = record_flight(NOISY, |tick| TickFaults {
            silent: STAGES.map(|role| role == stage && is_silent(tick)),
            inner_restarts: stage == Role::Inner && tick == 260,
            inner_resumes: stage == Role::Inner && tick == 300,
            ..TickFaults::default()
        });
        let replayed = assert_identical(&flight.log);
        let restarts = if stage == Role::Inner { 2 } else { 0 };
        assert_eq!(replayed.summary.restarts, restarts);
        let skipped = flight
            .published
            .states
            .last()
            .unwrap()
            .content
            .ticks_skipped;
        assert_eq!(skipped, if stage == Role::Plant { 143 } else { 0 });
    }
}

#[test]
fn a_replay_from_a_tick_counts_what_came_from_then_on() {
    let flight = record_flight(NOISY, |tick| {
        let plant_is_silent = (40..50).contains(&tick) || (300..303).contains(&tick);
        TickFaults {
            silent: [plant_is_silent, false, false, false],
            mixer_late_ns: u64::from(tick == 30 || tick == 310) * 1_500_000,
            inner_restarts: tick == 100 || tick == 350,
            ..TickFaults::default()
        }
    });
    let missed_before = |tick: u64| {
        let states = &flight.published.states;
        let before = states.iter().rfind(|message| message.envelope.tick < tick);
        before.map_or(0, |message| message.content.deadlines_missed)
    };
    let text = |from: u64| {
        let again = fly_again(&flight.log, from, false, &[]).unwrap();
        again.summary.text(&again.survey)
    };
    let (whole, later) = (text(0), text(200));
    let (before, all) = (missed_before(200), missed_before(401));
    assert!(
        before > 0 && all > before,
        "there are misses before and after"
    );
    for (text, skipped, missed, restarts) in [
        (&whole, 13, all, "2 times"),
        (&later, 3, all - before, "1 time"),
    ] {
        let plural = if missed == 1 { "" } else { "s" };
        let counts = format!("; {skipped} skipped, {missed} deadline{plural} missed\n");
        let restarts = format!("; started {restarts} in flight\n");
        assert!(text.contains(&counts) && text.contains(&restarts), "{text}");
    }
    let first_swap = "parameter change 1 at tick 7:";
    assert!(whole.contains(first_swap) && !later.contains(first_swap));
    assert!(whole.contains("ticks replayed, to tick 400"), "{whole}");
    assert!(later.contains("parameter change 3 at tick 200:"), "{later}");
    assert!(
        later.contains("198 ticks replayed, from tick 200 to tick 400"),
        "{later}"
    );
}

#[test]
#[ignore = "long: part of the gate"]
fn faults_of_all_kinds_at_once_are_identical() {
    let mut seen = [0; 4];
    for seed in 0..60 {
        let mut dice = Rng::with_seed(seed);
        let mut plan: Vec<TickFaults> = Vec::new();
        while plan.len() <= 400 {
            let mut faults = TickFaults {
                silent: [0; 4].map(|_| dice.u64(..12) == 0),
                plant_is_late: dice.u64(..12) == 0,
                mixer_late_ns: u64::from(dice.u64(..6) == 0) * dice.u64(..4_000_000),
                inner_restarts: dice.u64(..100) == 0,
                inner_resumes: false,
            };
            plan.push(faults);
            faults.inner_restarts = false;
            let further = u64::from(dice.u64(..15) == 0) * dice.u64(..90);
            plan.extend((0..further).map(|_| faults));
        }
        let flight = record_flight(NOISY, |tick| plan[tick as usize]);
        let replayed = assert_identical(&flight.log);
        let state = flight.published.states.last().unwrap().content;
        seen[0] += state.ticks_skipped;
        seen[1] += state.deadlines_missed;
        seen[2] += replayed.summary.restarts;
        let (setpoints, states) = (&flight.published.setpoints, &flight.published.states);
        seen[3] += u64::from(setpoints.len() < states.len());
    }
    assert!(seen.iter().all(|count| *count > 0), "{seen:?}");
}

fn flip(value: &mut f64) {
    *value = f64::from_bits(value.to_bits() ^ 1);
}

/// A stage, a tick, and a field of a message of that tick.
const CHANGES: [(&str, u64, &str); 8] = [
    ("plant", 90, "state.measured.position_w_m.y"),
    ("outer", 90, "setpoint.thrust_n"),
    ("inner", 90, "wrench.torque_b_nm.z"),
    ("inner", 90, "inner_telemetry.rotational_drag_nm_s"),
    ("mixer", 90, "rotor_speeds.saturated"),
    ("mixer", 90, "mixer_telemetry.yaw_share"),
    ("record", 90, "theorem.v_th"),
    ("plant", 60, "swaps.old.1"),
];

/// Changes a field of the messages of a tick; keeps all messages.
fn change(tick: u64, field: &str) -> impl FnMut(&mut LogEntry) -> bool {
    move |entry| {
        let is_then = entry.envelope().tick == tick;
        match (entry, field) {
            _ if !is_then => {}
            (LogEntry::State(it), "state.measured.position_w_m.y") => {
                flip(&mut it.content.measured.position_w_m[1]);
            }
            (LogEntry::Setpoint(it), "setpoint.thrust_n") => flip(&mut it.content.thrust_n),
            (LogEntry::Wrench(it), "wrench.torque_b_nm.z") => flip(&mut it.content.torque_b_nm[2]),
            (LogEntry::Wrench(it), "inner_telemetry.rotational_drag_nm_s") => {
                flip(&mut it.content.telemetry.value[4]);
            }
            (LogEntry::RotorSpeeds(it), "rotor_speeds.saturated") => it.content.saturated ^= 1,
            (LogEntry::RotorSpeeds(it), "mixer_telemetry.yaw_share") => {
                flip(&mut it.content.telemetry.value[1]);
            }
            (LogEntry::Theorem(it), "theorem.v_th") => flip(&mut it.content.v_th),
            (LogEntry::Swap(it), "swaps.old.1") => flip(&mut it.content.old[0]),
            _ => {}
        }
        true
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_changed_value_with_whole_checksums_diverges_at_its_tick_stage_and_field() {
    let flight = noisy();
    let changed = flight.path("changed.mcap");
    for (stage, tick, field) in CHANGES {
        rewrite(None, &flight.log, &changed, NOISY, &[], change(tick, field));
        let found = verify(&changed).unwrap().comparison.first.expect(field);
        let name = format!("{}.{}", found.topic, found.field);
        let place = (found.stage.role.name(), found.tick, &*name);
        assert_eq!(place, (stage, tick, field));
        assert_ne!(found.recorded, found.replayed);
    }
    // A swap to another value changes the flight from its tick on.
    rewrite(None, &flight.log, &changed, NOISY, &[], |entry| {
        if let LogEntry::Swap(message) = entry {
            flip(&mut message.content.new[0]);
        }
        true
    });
    assert!(!verify(&changed).unwrap().is_identical());
}

/// Changes what a process decided in a tick: the commands that the plant took, or the state that a stage continued from.
fn change_decision(entry: &mut LogEntry, dice: &mut Rng) -> bool {
    fn another(word: &mut u64, dice: &mut Rng) {
        *word = [word.wrapping_add(1), word.wrapping_sub(1)][dice.usize(..2)];
    }
    fn of_command(command: &mut TakenCommand, dice: &mut Rng) {
        match dice.usize(..4) {
            0 => another(&mut command.of_tick, dice),
            1 => another(&mut command.seq, dice),
            2 => another(&mut command.acts_from, dice),
            _ => command.is_offered ^= 1,
        }
    }
    match entry {
        LogEntry::State(it) => {
            let decision = &mut it.content.decision;
            match dice.usize(..3) {
                0 => another(&mut decision.count, dice),
                1 => another(&mut decision.refused, dice),
                _ if decision.count == 1 => of_command(&mut decision.command, dice),
                _ => return false,
            }
        }
        LogEntry::Decisions(it) => {
            let count = it.content.commands().len();
            match dice.usize(..2) {
                0 => another(&mut it.content.count, dice),
                _ if count > 0 => of_command(&mut it.content.command[dice.usize(..count)], dice),
                _ => return false,
            }
        }
        LogEntry::Setpoint(Message { envelope, .. })
        | LogEntry::Wrench(Message { envelope, .. })
        | LogEntry::RotorSpeeds(Message { envelope, .. })
            if envelope.sample_ns > 0 =>
        {
            let state = &mut envelope.law_state;
            match dice.usize(..4) {
                0 => another(&mut state.from_tick, dice),
                1 => another(&mut state.channel, dice),
                2 => another(&mut state.before, dice),
                _ => another(&mut state.after, dice),
            }
        }
        _ => return false,
    }
    true
}

#[test]
#[ignore = "long: part of the gate"]
fn a_decision_that_was_altered_removed_or_moved_is_found_at_its_tick() {
    let flight = record_flight(NOISY, |tick| TickFaults {
        silent: [(90..100).contains(&tick), tick == 200, false, tick == 300],
        mixer_late_ns: u64::from(tick % 50 == 30) * 1_500_000,
        ..TickFaults::default()
    });
    let (entries, _) = crate::rig::read_log(&flight.log);
    let decisions = entries
        .iter()
        .filter(|it| matches!(it, LogEntry::Decisions(_)));
    assert!(decisions.count() > 5);
    let changed = flight.path("changed.mcap");
    for seed in 0..200 {
        let mut dice = Rng::with_seed(seed);
        // Half of them in the few messages of topic `decisions` and in what is around a disturbance.
        let ticks = [10..390, 95..103][dice.usize(..2)].clone();
        let (mut at, from) = (None, dice.u64(ticks));
        let (mut is_removed, is_moved) = (false, seed % 10 == 9);
        rewrite(None, &flight.log, &changed, NOISY, &[], |entry| {
            let tick = entry.envelope().tick;
            if at.is_some() || tick < from || dice.u64(..3) > 0 {
                return true;
            }
            let is_changed = match entry {
                LogEntry::Decisions(it) if is_moved => {
                    it.envelope.tick += 1;
                    true
                }
                LogEntry::Decisions(_) if seed % 5 == 4 => {
                    is_removed = true;
                    true
                }
                _ => change_decision(entry, &mut dice),
            };
            at = is_changed.then_some(tick);
            !is_removed
        });
        let at = at.unwrap();
        match verify(&changed) {
            // The difference is in the messages of the tick, or in the next one of the stage or the plant.
            Ok(replayed) => {
                let found = replayed.comparison.first.map(|it| it.tick);
                let found = found.unwrap_or_else(|| panic!("{seed}: not found at {at}"));
                assert!(
                    (at..=at + 12).contains(&found),
                    "{seed}: {at}, found {found}"
                );
            }
            Err(failure) => {
                let said = failure.to_string();
                let ticks = at..=at + 12;
                let is_named = ticks
                    .clone()
                    .any(|tick| said.contains(&format!("tick {tick}")));
                assert!(is_named, "{seed}: {at}: {said}");
            }
        }
    }
}

#[test]
#[ignore = "long: part of the gate"]
fn a_changed_value_in_any_log_of_redundant_channels_diverges_at_its_tick() {
    let text = format!("{NOISY}[rt]\nchannels = 2\n");
    let flight = record_flight(&text, |_| TickFaults::default());
    let own = |channel: Channel| {
        flight
            .path(&flight_log::log_directory(channel))
            .join(flight_log::FILE)
    };
    let whole =
        |entry: &mut LogEntry| !matches!(entry, LogEntry::Theorem(_) | LogEntry::Decisions(_));
    for channel in Channel::first(2) {
        std::fs::create_dir(own(channel).parent().unwrap()).unwrap();
        rewrite(Some(channel), &flight.log, &own(channel), &text, &[], whole);
    }
    assert_identical(&flight.log);
    let before = flight.path("before.mcap");
    let logs = Channel::first(2).map(|channel| (Some(channel), own(channel)));
    for (channel, log) in logs.chain([(None, flight.log.clone())]) {
        for (_, tick, field) in CHANGES {
            if field.starts_with("theorem") && channel.is_some() {
                continue;
            }
            std::fs::rename(&log, &before).unwrap();
            rewrite(channel, &before, &log, &text, &[], change(tick, field));
            match verify(&flight.log) {
                Err(failure) => {
                    assert!(field.starts_with("swaps"), "{channel:?} {field}: {failure}")
                }
                Ok(replayed) => {
                    let found = replayed.comparison.first.map(|it| it.tick);
                    assert_eq!(found, Some(tick), "{channel:?} {field}");
                }
            }
            std::fs::rename(&before, &log).unwrap();
        }
    }
}

#[test]
fn a_log_with_a_gap_or_of_other_settings_is_refused_and_the_reason_named() {
    let flight = noisy();
    let (thinned, mixed) = (flight.path("thinned.mcap"), flight.path("mixed.mcap"));
    let lacks = |is_absent: fn(&LogEntry) -> bool, words: &str| {
        rewrite(None, &flight.log, &thinned, NOISY, &[], |entry| {
            !is_absent(entry)
        });
        assert_refused(&thinned, words);
        if words.starts_with("topic") {
            let said = Timing::read(&thinned).unwrap_err().to_string();
            assert!(said.contains(words), "{said}");
        }
    };
    lacks(
        |entry| matches!(entry, LogEntry::Wrench(it) if it.envelope.tick == 50),
        "topic `wrench` lacks 1 message before tick 51",
    );
    lacks(
        |entry| matches!(entry, LogEntry::State(it) if it.envelope.tick < 3),
        "topic `state` lacks 3 messages before tick 3",
    );
    lacks(
        |entry| matches!(entry, LogEntry::Swap(it) if it.content.parameter_epoch == 4),
        "its last state knows 4 parameter changes, and it holds 3",
    );
    lacks(|_| true, "holds no message");
    rewrite(None, &flight.log, &mixed, SHORT, &[], |_| true);
    assert_refused(&mixed, "the log mixes runs");
}

#[test]
fn what_is_wrong_with_a_log_comes_before_what_differs_in_it() {
    let flight = noisy();
    let changed = flight.path("changed.mcap");
    let rewritten = |gap_at: Option<u64>| {
        rewrite(None, &flight.log, &changed, NOISY, &[], |entry| {
            let is_kept = change(90, "setpoint.thrust_n")(entry);
            is_kept && !matches!(entry, LogEntry::Wrench(it) if Some(it.envelope.tick) == gap_at)
        });
    };
    rewritten(None);
    let found = verify(&changed).unwrap().comparison.first.unwrap();
    assert_eq!((found.tick, found.field.as_str()), (90, "thrust_n"));
    rewritten(Some(350));
    let gap = "topic `wrench` lacks 1 message";
    assert_refused(&changed, &format!("{gap} before tick 351"));
    // Also before a tick after the end.
    let said = fly_again(&changed, 1000, true, &[]).unwrap_err();
    assert!(said.to_string().contains(gap), "{said}");
    let mut flipped = std::fs::read(&flight.log).unwrap();
    let middle = flipped.len() / 2;
    flipped[middle] ^= 1;
    std::fs::write(&changed, flipped).unwrap();
    assert_refused(&changed, "changed.mcap is damaged or no flight log: ");
}

/// Writes a log again as far as its first messages, with the landing record of the whole one and an end of its own.
fn cut_and_finish(from: &Path, to: &Path, text: &str, keep: usize, landing: bool) {
    let mut reader = LogReader::open(from).unwrap();
    let mut kept = 0;
    let cut = to.with_extension("cut");
    rewrite(None, from, &cut, text, &[], |_| {
        kept += 1;
        kept <= keep
    });
    while reader.next_entry().unwrap().is_some() {}
    // The same bytes up to the landing record, and behind it what a whole log ends with.
    let bytes = std::fs::read(&cut).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    // In one chunk, as they are: within a chunk, messages are in the order of their topics.
    let options = mcap::WriteOptions::new().chunk_size(Some(1 << 24));
    let mut writer = options.create(std::fs::File::create(to).unwrap()).unwrap();
    for index in &summary.metadata_indexes {
        let mut metadata = mcap::read::metadata(&bytes, index).unwrap();
        let is_landing = metadata.name == "landing";
        if is_landing && landing {
            for topic in flight_log::TOPICS {
                let name = format!("messages.{topic}");
                let written = reader.landed(&name).unwrap().unwrap();
                metadata.metadata.insert(name, written.to_string());
            }
        }
        if !is_landing || landing {
            writer.write_metadata(&metadata).unwrap();
        }
    }
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        writer.write(&message.unwrap()).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn a_log_that_ends_before_its_landing_record_says_is_refused() {
    let flight = noisy();
    let published = &flight.published;
    let all = published.states.len() + published.setpoints.len() + published.wrenches.len();
    let cut = flight.path("cut.mcap");
    cut_and_finish(&flight.log, &cut, NOISY, usize::MAX, true);
    assert_identical(&cut);
    cut_and_finish(&flight.log, &cut, NOISY, all / 2, true);
    assert_refused(
        &cut,
        "messages of topic `state`, and its recorder wrote 401",
    );
    // As tools leave it that give a cut file an index.
    cut_and_finish(&flight.log, &cut, NOISY, all / 2, false);
    assert_refused(&cut, "its record `landing` is missing");
    // As a recorder leaves it that did not get the plant's last states.
    rewrite(
        None,
        &flight.log,
        &cut,
        NOISY,
        &[("ticks_run", "450")],
        |_| true,
    );
    let words = "the plant published 450 states, and it lacks the last 49";
    assert_refused(&cut, words);
}

#[test]
fn whatever_bit_of_the_file_is_flipped_the_log_is_never_identical() {
    let text = "[flight]\nduration_s = 0.03\nfaults = [\"mass_kg=0.6@tick7\"]\n";
    let flight = record_flight(text, |_| TickFaults::default());
    assert_identical(&flight.log);
    let whole = std::fs::read(&flight.log).unwrap();
    let flipped_path = flight.path("flipped.mcap");
    let (ends, middle) = (300, whole.len() - 300);
    let places = (0..ends)
        .chain((ends..middle).step_by(29))
        .chain(middle..whole.len());
    for place in places {
        let mut flipped = whole.clone();
        flipped[place] ^= 1 << (place % 8);
        std::fs::write(&flipped_path, &flipped).unwrap();
        let is_unseen = verify(&flipped_path).is_ok_and(|replayed| replayed.is_identical());
        assert!(
            !is_unseen,
            "a flip at {place} of {} bytes was not seen",
            whole.len()
        );
    }
}

#[test]
fn a_truncated_log_is_read_to_its_last_whole_chunk_and_never_identical() {
    let flight = record_flight(SHORT, |_| TickFaults::default());
    let whole = std::fs::read(&flight.log).unwrap();
    let cut = flight.path("cut.mcap");
    let mut most = 0;
    for length in (0..whole.len()).step_by(whole.len() / 60) {
        std::fs::write(&cut, &whole[..length]).unwrap();
        let mut reader = LogReader::open(&cut).unwrap();
        let mut states = 0;
        while let Ok(Some(entry)) = reader.next_entry() {
            states += usize::from(matches!(entry, LogEntry::State(_)));
        }
        assert!(
            states >= most,
            "the longer the file, the more of it is read"
        );
        most = states;
        match verify(&cut).map_err(|failure| failure.to_string()) {
            Ok(it) => assert!(
                !it.is_identical() && it.comparison.first.is_none(),
                "{length}"
            ),
            Err(said) => assert!(
                states == 0
                    && (said.contains("truncated before its first message")
                        || said.contains("it ends before its first record")),
                "{said}"
            ),
        }
    }
    assert!(most > 50 && most <= flight.published.states.len(), "{most}");
}
