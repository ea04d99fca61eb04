//! Replay: logs with gaps, faults and restarts give every bit again; damaged ones never pass.

use crate::recorded::rewritten::{change, flip, rewrite, rewrite_landing};
use crate::recorded::{self, Dice, FaultKind, Published, fly, settings, write};
use crate::rig::{self, Rig, lacks_tool, stop_for, wait_until};
use errors::Failure;
use flight_log::entry::LogEntry;
use flight_log::facts::record;
use flight_log::reader::LogReader;
use flight_log::writer::FlightLog;
use ironbird::replay::{LOOKAHEAD, ReplayResult, fly_again};
use ironbird::settings::law_settings::Moved;
use messages::header::Message;
use messages::role::Role;
use messages::telemetry::{Signal, Signals};
use messages::topic::Topic;
use rustix::process::Signal as ProcessSignal;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::Duration;
use tempfile::TempDir;

const SHORT: &str = "[flight]\nduration_s = 0.1\n";
const NOISY: &str = "[flight]\nduration_s = 0.4\ntrajectory = \"fast\"\nfaults = [\"gyro_noise_rad_s=0.02@tick7\", \
    \"rotational_drag_nm_s=0.525,mass_kg=0.6@60ms\", \"rotor_efficiency_3=0.5@tick200\", \"mass_kg=0.5@tick400\"]\n\
    [rotor]\nmax_rad_s = 220.0\n";

struct Place {
    directory: TempDir,
}

impl Place {
    fn new() -> Self {
        Self {
            directory: tempfile::tempdir_in("/dev/shm").unwrap(),
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    /// The log of a flight with trouble.
    fn log(&self, text: &str, trouble: impl Fn(u64) -> FaultKind) -> (PathBuf, Published) {
        let (path, settings) = (self.path("flight.mcap"), settings(text));
        let published = fly(&settings, trouble);
        write(&path, &settings, &published);
        (path, published)
    }
}

fn verify(path: &Path) -> Result<ReplayResult, Failure> {
    fly_again(path, 0, true, &Moved::new())
}

#[track_caller]
fn assert_identical(path: &Path) -> ReplayResult {
    let replayed = verify(path).unwrap();
    assert!(replayed.is_identical(), "{:?}", replayed.comparison.first);
    replayed
}

#[test]
fn a_flight_without_trouble_is_identical_and_every_value_is_compared() {
    fn values<C: Topic>(messages: &[Message<C>], signals: &[Signal]) -> u64 {
        let unnamed = C::default()
            .telemetry()
            .map_or(0, |telemetry| telemetry.value.len() - signals.len());
        ((size_of::<C>() / size_of::<u64>() - unnamed) * messages.len()) as u64
    }
    let place = Place::new();
    let (path, published) = place.log(SHORT, |_| FaultKind::default());
    let replayed = assert_identical(&path);
    assert_eq!(replayed.summary.ticks, 101);
    let Signals {
        outer,
        inner,
        mixer,
    } = settings(SHORT).flown_laws().unwrap().signals;
    assert_eq!([outer.len(), inner.len(), mixer.len()], [3, 6, 2]);
    let loops = values(&published.setpoints, outer)
        + values(&published.wrenches, inner)
        + values(&published.rotor_speeds, mixer);
    let beside = values(&published.states, &[]) + values(&published.theorem, &[]);
    assert_eq!(replayed.comparison.values, beside + loops);
    let later = fly_again(&path, 60, true, &Moved::new()).unwrap();
    assert!(
        later.is_identical() && later.summary.ticks == 41,
        "{:?}",
        later.summary
    );
    let beyond = fly_again(&path, 102, true, &Moved::new()).unwrap_err();
    assert!(
        beyond
            .to_string()
            .contains("--from 102: the log ends at tick 100"),
        "{beyond}"
    );
}

#[test]
fn swaps_noise_and_saturation_are_identical() {
    let place = Place::new();
    let (path, published) = place.log(NOISY, |_| FaultKind::default());
    assert!(
        published
            .rotor_speeds
            .iter()
            .any(|message| message.content.saturated == 1),
        "nothing saturates"
    );
    assert_eq!(
        published.swaps.len(),
        4,
        "the last one holds from the last tick on"
    );
    assert_identical(&path);
}

#[test]
fn a_stage_that_sleeps_or_starts_again_is_identical() {
    let place = Place::new();
    for stage in 0..4 {
        let asleep = |tick: u64| (40..43).contains(&tick) || (120..260).contains(&tick);
        let (path, published) = place.log(NOISY, |tick| FaultKind {
            plant_sleeps: stage == 0 && asleep(tick),
            outer_sleeps: stage == 1 && asleep(tick),
            inner_sleeps: stage == 2 && asleep(tick),
            mixer_sleeps: stage == 3 && asleep(tick),
            inner_restarts: stage == 2 && tick == 260,
            ..FaultKind::default()
        });
        let replayed = assert_identical(&path);
        assert_eq!(replayed.summary.restarts, u64::from(stage == 2));
        assert_eq!(
            published.states.last().unwrap().content.ticks_skipped,
            if stage == 0 { 143 } else { 0 }
        );
    }
}

#[test]
fn a_replay_from_a_tick_counts_what_came_from_then_on() {
    let place = Place::new();
    let (path, published) = place.log(NOISY, |tick| FaultKind {
        plant_sleeps: (40..50).contains(&tick) || (300..303).contains(&tick),
        mixer_late_ns: if tick == 30 || tick == 310 {
            1_500_000
        } else {
            0
        },
        inner_restarts: tick == 100 || tick == 350,
        ..FaultKind::default()
    });
    let missed = |tick: u64| {
        let before = published
            .states
            .iter()
            .rfind(|message| message.envelope.tick < tick);
        before.map_or(0, |message| message.content.deadlines_missed)
    };
    let text = |from: u64| {
        let again = fly_again(&path, from, false, &Moved::new()).unwrap();
        again.summary.text(&again.survey)
    };
    let (whole, later) = (text(0), text(200));
    assert!(
        missed(200) > 0 && missed(401) > missed(200),
        "there are misses before and after"
    );
    for (text, skipped, missed, restarts) in [
        (&whole, 13, missed(401), "2 times"),
        (&later, 3, missed(401) - missed(200), "1 time"),
    ] {
        let s = if missed == 1 { "" } else { "s" };
        assert!(
            text.contains(&format!(
                "; {skipped} skipped, {missed} deadline{s} missed\n"
            )),
            "{text}"
        );
        assert!(
            text.contains(&format!("; started {restarts} in flight\n")),
            "{text}"
        );
    }
    assert!(
        whole.contains("swap 1 at tick 7:") && whole.contains("ticks replayed, to tick 400"),
        "{whole}"
    );
    assert!(
        !later.contains("swap 1 at tick 7:") && later.contains("swap 3 at tick 200:"),
        "{later}"
    );
    assert!(
        later.contains("198 ticks replayed, from tick 200 to tick 400"),
        "{later}"
    );
}

#[test]
#[ignore = "long: part of the gate"]
fn trouble_of_all_kinds_at_once_is_identical() {
    let place = Place::new();
    let mut seen = [0; 4];
    for seed in 0..60 {
        let mut dice = Dice(seed);
        let mut plan: Vec<FaultKind> = Vec::new();
        while plan.len() <= 400 {
            let trouble = FaultKind {
                plant_sleeps: dice.roll(12) == 0,
                plant_is_late: dice.roll(12) == 0,
                outer_sleeps: dice.roll(12) == 0,
                inner_sleeps: dice.roll(12) == 0,
                mixer_sleeps: dice.roll(12) == 0,
                mixer_late_ns: if dice.roll(6) == 0 {
                    dice.roll(4_000_000)
                } else {
                    0
                },
                inner_restarts: dice.roll(100) == 0,
            };
            let length = if dice.roll(15) == 0 {
                1 + dice.roll(90)
            } else {
                1
            };
            plan.push(trouble);
            plan.extend((1..length).map(|_| FaultKind {
                inner_restarts: false,
                ..trouble
            }));
        }
        let (path, published) = place.log(NOISY, |tick| plan[tick as usize]);
        let replayed = verify(&path).unwrap();
        assert!(
            replayed.is_identical(),
            "seed {seed}: {:?}",
            replayed.comparison.first
        );
        let state = published.states.last().unwrap().content;
        seen[0] += state.ticks_skipped;
        seen[1] += state.deadlines_missed;
        seen[2] += replayed.summary.restarts;
        seen[3] += u64::from(published.setpoints.len() < published.states.len());
    }
    assert!(
        seen.iter().all(|count| *count > 0),
        "there was trouble: {seen:?}"
    );
}

#[test]
#[ignore = "long: part of the gate"]
fn a_changed_value_with_whole_checksums_diverges_at_its_tick_stage_and_field() {
    let place = Place::new();
    let (path, _) = place.log(NOISY, |_| FaultKind::default());
    let changed = place.path("changed.mcap");
    for (stage, field) in [
        ("plant", "state.measured.position_w_m[1]"),
        ("outer", "setpoint.thrust_n"),
        ("inner", "wrench.torque_b_nm[2]"),
        ("inner", "inner_telemetry.rotational_drag_nm_s"),
        ("mixer", "rotor_speeds.saturated"),
        ("mixer", "mixer_telemetry.yaw_share"),
        ("record", "theorem.v_th"),
        ("plant", "swaps.old[0]"),
    ] {
        rewrite(&path, &changed, NOISY, |entry| {
            change(entry, field);
            true
        });
        let divergence = verify(&changed)
            .unwrap()
            .comparison
            .first
            .unwrap_or_else(|| panic!("{field}"));
        let found = format!("{}.{}", divergence.topic, divergence.field);
        assert_eq!((divergence.stage.name(), found.as_str()), (stage, field));
        assert_eq!(
            divergence.tick,
            if field == "swaps.old[0]" { 60 } else { 90 },
            "{divergence}"
        );
        assert_ne!(divergence.recorded, divergence.replayed);
    }
    // A swap to another value changes the flight from its tick on.
    rewrite(&path, &changed, NOISY, |entry| {
        if let LogEntry::Swap(message) = entry {
            flip(&mut message.content.new[0]);
        }
        true
    });
    assert!(!verify(&changed).unwrap().is_identical());
}

#[test]
fn a_log_with_a_gap_is_refused_and_the_gap_named() {
    let place = Place::new();
    let (path, _) = place.log(NOISY, |_| FaultKind::default());
    let thinned = place.path("thinned.mcap");
    let refused = |keep: &dyn Fn(&LogEntry) -> bool| {
        rewrite(&path, &thinned, NOISY, |entry| keep(entry));
        verify(&thinned).unwrap_err().to_string()
    };
    let said = refused(
        &|entry| !matches!(entry, LogEntry::Wrench(message) if message.envelope.tick == 50),
    );
    assert!(
        said.contains("topic `wrench` lacks 1 message before tick 51"),
        "{said}"
    );
    let said =
        refused(&|entry| !matches!(entry, LogEntry::State(message) if message.envelope.tick < 3));
    assert!(
        said.contains("topic `state` lacks 3 messages before tick 3"),
        "{said}"
    );
    let said = refused(
        &|entry| !matches!(entry, LogEntry::Swap(message) if message.content.parameter_epoch == 4),
    );
    assert!(
        said.contains("its last state knows 4 swaps, and it holds 3"),
        "{said}"
    );
    let said = refused(&|_| false);
    assert!(said.contains("holds no message"), "{said}");
}

#[test]
fn what_is_wrong_with_a_log_comes_before_what_differs_in_it() {
    let place = Place::new();
    let (path, _) = place.log(NOISY, |_| FaultKind::default());
    let changed = place.path("changed.mcap");
    let rewritten = |gap_at: Option<u64>| {
        rewrite(&path, &changed, NOISY, |entry| {
            change(entry, "setpoint.thrust_n");
            !matches!(entry, LogEntry::Wrench(message) if Some(message.envelope.tick) == gap_at)
        });
        verify(&changed)
    };
    let divergence = rewritten(None).unwrap().comparison.first.unwrap();
    assert_eq!(
        (divergence.tick, divergence.field.as_str()),
        (90, "thrust_n")
    );
    let said = rewritten(Some(350)).unwrap_err().to_string();
    assert!(
        said.contains("topic `wrench` lacks 1 message before tick 351"),
        "{said}"
    );
    let said = fly_again(&changed, 1000, true, &Moved::new())
        .unwrap_err()
        .to_string();
    assert!(
        said.contains("topic `wrench` lacks 1 message"),
        "before the tick that it ends before: {said}"
    );
    let mut flipped = std::fs::read(&path).unwrap();
    let middle = flipped.len() / 2;
    flipped[middle] ^= 1;
    std::fs::write(&changed, flipped).unwrap();
    let said = verify(&changed).unwrap_err().to_string();
    assert!(
        said.contains("changed.mcap is damaged or no flight log: "),
        "{said}"
    );
}

#[test]
fn a_swap_is_waited_for_that_is_recorded_long_after_its_tick() {
    let place = Place::new();
    let text = "[flight]\nduration_s = 6.0\nfaults = [\"mass_kg=0.6@tick7\"]\n";
    let (path, published) = place.log(text, |_| FaultKind::default());
    assert!(
        4 * published.states.len() > LOOKAHEAD + 100,
        "the state that knows the swap is due before its record"
    );
    let late = place.path("late.mcap");
    let mut reader = LogReader::open(&path).unwrap();
    let mut log = FlightLog::create(&late, &recorded::facts(&settings(text))).unwrap();
    let mut swaps = Vec::new();
    while let Some(entry) = reader.next_entry().unwrap() {
        match entry {
            LogEntry::Swap(_) => swaps.push(*entry),
            _ => log.take(*entry),
        }
    }
    assert_eq!(swaps.len(), 1);
    swaps.into_iter().for_each(|swap| log.take(swap));
    log.finish(record(&[])).unwrap();
    assert_identical(&late);
}

/// Writes a log again as far as its first messages, with the landing record of the whole one and an end of its own.
fn cut_and_finish(from: &Path, to: &Path, text: &str, keep: usize, landing: bool) {
    let mut reader = LogReader::open(from).unwrap();
    let mut kept = 0;
    let cut = to.with_extension("cut");
    rewrite(from, &cut, text, |_| {
        kept += 1;
        kept <= keep
    });
    while reader.next_entry().unwrap().is_some() {}
    // The same bytes up to the landing record, and behind it what a whole log ends with.
    let bytes = std::fs::read(&cut).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let mut writer = mcap::Writer::new(std::fs::File::create(to).unwrap()).unwrap();
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
fn a_log_that_ends_before_its_landing_says_is_refused() {
    let place = Place::new();
    let (path, published) = place.log(NOISY, |_| FaultKind::default());
    let cut = place.path("cut.mcap");
    let all = published.states.len() + published.setpoints.len() + published.wrenches.len();
    cut_and_finish(&path, &cut, NOISY, usize::MAX, true);
    assert_identical(&cut);
    cut_and_finish(&path, &cut, NOISY, all / 2, true);
    let said = verify(&cut).unwrap_err().to_string();
    assert!(
        said.contains("messages of topic `state`, and its recorder wrote 401"),
        "{said}"
    );
    // As tools leave it that give a cut file an index.
    cut_and_finish(&path, &cut, NOISY, all / 2, false);
    let said = verify(&cut).unwrap_err().to_string();
    assert!(said.contains("its record `landing` is missing"), "{said}");
    // As a recorder leaves it that did not get the plant's last states.
    rewrite_landing(&path, &cut, NOISY, "450");
    let said = verify(&cut).unwrap_err().to_string();
    assert!(
        said.contains("the plant published 450 states, and it holds 401: the last 49 are missing"),
        "{said}"
    );
}

#[test]
fn a_log_of_other_settings_is_refused() {
    let place = Place::new();
    let (path, _) = place.log(NOISY, |_| FaultKind::default());
    let other = place.path("other.mcap");
    rewrite(&path, &other, SHORT, |_| true);
    let said = verify(&other).unwrap_err().to_string();
    assert!(said.contains("the log mixes runs"), "{said}");
}

#[test]
fn whatever_bit_of_the_file_is_flipped_the_log_is_never_identical() {
    let place = Place::new();
    let text = "[flight]\nduration_s = 0.03\nfaults = [\"mass_kg=0.6@tick7\"]\n";
    let (path, _) = place.log(text, |_| FaultKind::default());
    assert_identical(&path);
    let whole = std::fs::read(&path).unwrap();
    let flipped_path = place.path("flipped.mcap");
    let ends = 300;
    let places = (0..ends)
        .chain((ends..whole.len() - ends).step_by(13))
        .chain(whole.len() - ends..whole.len());
    let mut unseen = Vec::new();
    for place in places {
        let mut flipped = whole.clone();
        flipped[place] ^= 1 << (place % 8);
        std::fs::write(&flipped_path, &flipped).unwrap();
        if verify(&flipped_path).is_ok_and(|replayed| replayed.is_identical()) {
            unseen.push(place);
        }
    }
    assert!(
        unseen.is_empty(),
        "flips at {unseen:?} of {} bytes were not seen",
        whole.len()
    );
}

#[test]
fn a_truncated_log_is_read_to_its_last_whole_chunk_and_never_identical() {
    let place = Place::new();
    let (path, published) = place.log(SHORT, |_| FaultKind::default());
    let whole = std::fs::read(&path).unwrap();
    let cut_path = place.path("cut.mcap");
    let mut most = 0;
    for length in (0..whole.len()).step_by(whole.len() / 60) {
        std::fs::write(&cut_path, &whole[..length]).unwrap();
        let mut reader = LogReader::open(&cut_path).unwrap();
        let mut states = 0;
        while let Ok(Some(entry)) = reader.next_entry() {
            states += usize::from(matches!(entry, LogEntry::State(_)));
        }
        assert!(
            states >= most,
            "the longer the file, the more of it is read"
        );
        most = states;
        match verify(&cut_path) {
            Ok(replayed) => assert!(
                !replayed.is_identical() && replayed.comparison.first.is_none(),
                "{length}"
            ),
            Err(failure) => {
                let said = failure.to_string();
                let known = [
                    "truncated before its first message",
                    "it ends before its first record",
                ];
                assert!(
                    states == 0 && known.iter().any(|words| said.contains(words)),
                    "{said}"
                );
            }
        }
    }
    assert!(most > 50 && most <= published.states.len(), "{most}");
}

/// Ticks of 10 ms, rotors that saturate, noise, and swaps.
const TROUBLED: &str = "[flight]\nslowdown = 10\ntrajectory = \"fast\"\nduration_s = 0.8\n\
    faults = [\"gyro_noise_rad_s=0.02@tick40\", \"rotor_efficiency_3=0.9@tick790\"]\n[rotor]\nmax_rad_s = 220.0\n";

#[track_caller]
fn verifies(rig: &Rig) {
    let verified = rig
        .ok("replay --verify")
        .complains(" s replayed in ")
        .complains(" times real time)");
    let (ticks, said) = (
        rig.report()["ticks"]["run"].clone(),
        verified.stdout.clone(),
    );
    assert!(
        said.starts_with(&format!("replay: {ticks} ticks, "))
            && said.contains(" values, identical; outputs "),
        "{said}"
    );
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_whose_stages_are_stopped_one_after_the_other_is_identical() {
    let rig = Rig::new("replayed");
    let flight = rig.take_off(format!("--rt off --config {}", rig.settings(TROUBLED)));
    let roles = flight.roles();
    for (role, ms) in [
        ("outer", 100),
        ("inner", 60),
        ("mixer", 23),
        ("plant", 40),
        ("plant", 430),
        ("mixer", 300),
    ] {
        sleep(Duration::from_millis(120));
        stop_for(roles[role], Duration::from_millis(ms));
    }
    rig.run("inject", "mass_kg=0.55 rotational_drag_nm_s=0.2");
    flight.end();
    let report = rig.report();
    let number = |section: &str, key: &str| report[section][key].as_u64().unwrap();
    assert!(
        number("ticks", "skipped") > 10 && number("deadlines", "missed") > 10,
        "{report}"
    );
    assert!(
        report["roles"]["inner"]["ticks_stale"].as_u64().unwrap() > 5,
        "{report}"
    );
    verifies(&rig);
    rig.ok("replay --verify --from 100").says("identical");
    let told = rig.ok("replay");
    told.says("swap 1 at tick 40: gyro_noise_rad_s 0 -> 0.02")
        .says("agrees with the record");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_plant_that_stood_still_between_its_two_looks_at_the_commands_is_replayed() {
    let rig = Rig::new("twice");
    // Half of a tick lies between the two.
    let flight = rig.take_off("--trajectory hover --duration 5s --lead 500");
    let plant = flight.roles()["plant"];
    for i in 0..10 {
        // Longer than commands can wait; at other instants of a tick each time.
        stop_for(plant, Duration::from_millis(90));
        sleep(Duration::from_micros(180_000 + 300 * i));
    }
    flight.end();
    assert!(rig.report()["ticks"]["skipped"].as_u64().unwrap() > 500);
    verifies(&rig);
}

#[test]
fn a_rehearsed_flight_is_identical_and_says_how_often_it_was_rehearsed() {
    let rig = Rig::new("rehearsed");
    let settings = rig.settings(TROUBLED);
    let fly = |lead: &str| {
        rig.run("fly", format!("--rt off --config {settings} --lead {lead}"));
        rig.report()["lead"].clone()
    };
    let lead = fly("4000");
    for key in ["lead_us", "least_us", "median_us", "most_us"] {
        assert_eq!(
            lead[key], 4000.0,
            "a lead that is set stays: {key} of {lead}"
        );
    }
    let number = |key: &str| lead[key].as_f64().unwrap();
    assert!(
        number("rehearsals") > 0.0
            && number("rehearsal_us") > 0.0
            && number("processor_percent") > 0.0,
        "{lead}"
    );
    assert!(
        rig.report()["ticks"]["run"].as_f64().unwrap() >= number("rehearsals"),
        "{lead}"
    );
    verifies(&rig);
    let told = rig.ok("report --section processes");
    told.says("Lead 4000 us before the tick (before take-off: timer p90 ")
        .says("; rehearsed ")
        .says("; waiting took ");
    let none = fly("0");
    assert_eq!(
        (none["lead_us"].as_f64(), none["rehearsals"].as_u64()),
        (Some(0.0), Some(0))
    );
    verifies(&rig);
    rig.ok("report --section processes")
        .says("Lead none: the plant's timer is set to the beginning");
}

#[test]
fn rehearsals_before_take_off_do_not_count_as_rehearsed_ticks() {
    let rig = Rig::new("few-ticks");
    // 200 ms before it, and 9 ticks of 10 ms.
    let settings = rig.settings("[flight]\nslowdown = 10\nduration_s = 0.008\n");
    rig.run("fly", format!("--rt off --config {settings} --lead 4000"));
    let report = rig.report();
    let (ticks, rehearsals) = (
        report["ticks"]["run"].as_u64().unwrap(),
        report["lead"]["rehearsals"].as_u64().unwrap(),
    );
    assert!(
        ticks <= 9 && rehearsals < ticks,
        "{rehearsals} rehearsals in {ticks} ticks"
    );
    assert!(
        report["lead"]["rehearsal_us"].as_f64().unwrap() > 0.0,
        "and there were some: {report}"
    );
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_with_an_inner_loop_that_dies_and_comes_back_is_identical() {
    let rig = Rig::new("reborn");
    let settings = rig.settings(&TROUBLED.replace("0.8", "0.6").replace("790", "590"));
    let args = format!("--rt off --config {}", settings);
    let start = |role: &str| rig.start(role, &args);
    let (recorder, plant) = (start("record"), start("plant"));
    let (outer, inner, mixer) = (start("outer"), start("inner"), start("mixer"));
    rig.await_flight();
    sleep(Duration::from_millis(500));
    inner.signal(ProcessSignal::KILL);
    inner.end();
    let again = start("inner");
    let instance = rig.known();
    wait_until("another inner loop", || {
        (instance.pid_of(Role::Inner) == Some(again.pid())).then_some(())
    });
    for role in [plant, outer, again, mixer, recorder] {
        role.end();
    }
    verifies(&rig);
    rig.ok("replay").says("started 1 time in flight");
}

#[test]
#[ignore = "long: part of the gate"]
fn a_flight_that_a_signal_ends_is_identical() {
    let rig = Rig::new("signalled");
    let flight = rig.take_off(format!("--rt off --config {} --duration 1h", rig.slow(10)));
    sleep(Duration::from_millis(700));
    flight.signal(ProcessSignal::INT);
    flight.end().expect(130);
    verifies(&rig);
}

#[test]
fn a_flight_in_lockstep_is_identical() {
    let rig = Rig::new("in-step");
    let options = "--pace lockstep --duration 2s --preset paper --fault mass_kg=0.6@1s";
    rig.run("fly", options).expect(0);
    verifies(&rig);
}

/// A flight that calls every function of `messages::math`, and the hash over its outputs, the same on every machine: it
/// changes with the laws, and with nothing else.
const EVERY_FUNCTION: &str = "--trajectory fast --duration 2s --fault motor_time_constant_s=0.02,gyro_noise_rad_s=0.01,command_delay_s=0.002@200ms --fault rotational_drag_nm_s=0.525@1s";

#[test]
fn a_flight_its_simulation_and_its_replay_put_out_the_same_bits() {
    let rig = Rig::new("bits");
    let simulated = rig.run("simulate", EVERY_FUNCTION).expect(0).result();
    let outputs = &simulated["outputs"];
    assert_eq!(outputs.len(), 16, "{simulated:?}");
    rig.ok(&format!("fly --pace lockstep {EVERY_FUNCTION}"));
    let replayed = rig.ok("replay --verify");
    assert!(
        replayed
            .stdout
            .ends_with(&format!("identical; outputs {outputs}\n")),
        "{replayed}, simulated: {outputs}"
    );
    rig.ok("replay").says(&format!("outputs    {outputs}\n"));
    let other = rig
        .run(
            "simulate",
            format!("{EVERY_FUNCTION} --fault mass_kg=0.5200001@1s"),
        )
        .result();
    assert_ne!(&other["outputs"], outputs);
}

const FLIGHTS: usize = 20;

/// Load that ends with the test, also when it panics.
struct Stress(Child);

impl Stress {
    fn start() -> Option<Self> {
        let mut command = Command::new("stress-ng");
        command
            .args(["--cpu", "2", "--timeout", "10m"])
            .stdout(Stdio::null())
            .stderr(Stdio::null());
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
        let faults = [
            "--fault",
            &noise,
            "--fault",
            "mass_kg=0.6,rotor_efficiency_2=0.9@tick301",
        ];
        let flown = rig.run(
            "fly",
            [&["--rt", rt, "--duration", "700ms"], faults.as_slice()].concat(),
        );
        assert!(!rig.run_directories().is_empty(), "{flown}");
        let verified = rig.ok("replay --verify");
        assert!(
            verified.stdout.contains(" values, identical; outputs "),
            "{verified}"
        );
    }
}
