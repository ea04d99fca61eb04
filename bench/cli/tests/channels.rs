//! Redundant channels: real processes are killed and stopped, and the flight is the one of `simulate`.

use crate::c_laws::misbehaving;
use crate::rig::{Rig, Running};
use analysis::schema::{RedundancySection, Report};
use std::fs;

/// So that no tick is lost where the machine is busy: the bits are those of real time.
const SLOW: &str = "trajectory = \"lissajous\"\nslowdown = 20\n";

fn start(rig: &Rig, channels: usize, flags: &str) -> Running {
    let config = rig.airborne(SLOW);
    rig.start(
        "fly",
        format!("--channels {channels} --rt prefer --config {config} {flags}"),
    )
}

fn redundancy(report: &Report) -> &RedundancySection {
    report.redundancy.as_ref().unwrap()
}

#[test]
fn processes_that_are_killed_or_stopped_in_one_channel_cost_no_tick_and_no_bit() {
    let rig = Rig::new("channels");
    let faults =
        "--fault a.inner.kill@200ms --fault b.inner.kill@400ms --fault a.mixer.stop=2ms@600ms";
    start(&rig, 2, &format!("--duration 800ms {faults}"))
        .end()
        .expect(0);
    let report = rig.final_report();
    let section = redundancy(&report);
    assert_eq!(section.ticks_not_fresh, 0, "{section:?}");
    let of = |channel, tick: u64| {
        let near = |outage: &&analysis::schema::ChannelOutage| {
            outage.channel == channel && outage.tick.abs_diff(tick) <= 2
        };
        let outage = section.outages.iter().find(near);
        outage.unwrap_or_else(|| panic!("{channel} {tick}: {section:?}"))
    };
    assert!(of("a", 200).handover && !of("b", 400).handover && of("a", 600).handover);
    assert!(
        section.ticks_flown["b"] > 0 && section.active == "a",
        "{section:?}"
    );
    let roles: Vec<&str> = report.deaths.iter().map(|it| it.role.as_str()).collect();
    assert_eq!(roles, ["inner", "b.inner"]);
    assert_eq!(section.mismatches, 0, "{section:?}");
    // The same flight without faults, in one process.
    let replayed = rig.ok("replay latest --verify");
    let (_, hash) = replayed.stdout.trim().rsplit_once(' ').unwrap();
    let config = rig.airborne("trajectory = \"lissajous\"\n");
    rig.ok(&format!("simulate --duration 800ms --config {config}"))
        .says(&format!("outputs={hash}"));
    rig.assert_nothing_left();
}

#[test]
fn a_flipped_bit_of_a_controller_is_detected_with_two_channels_and_outvoted_with_three() {
    for channels in [2, 3] {
        let rig = Rig::new("flips");
        let config = misbehaving(&rig, "flip", 200);
        let settings = fs::read_to_string(&config).unwrap();
        let slow = format!("[flight]\n{SLOW}");
        let settings = settings.replace("trajectory = \"hover\"\n", "");
        fs::write(&config, settings.replace("[flight]\n", &slow)).unwrap();
        let flags = format!("--channels {channels} --rt off --config {config} --duration 800ms");
        rig.start("fly", flags).end().expect(0);
        let report = rig.final_report();
        let section = redundancy(&report);
        assert_eq!(section.first_mismatch_s, Some(0.201), "{section:?}");
        assert_eq!(section.ticks_not_fresh, 0, "{section:?}");
        let outvoted = section.ticks_outvoted["b"];
        if channels == 2 {
            // In some ticks channel b may have had no command.
            assert!(
                section.mismatches + section.ticks_unprotected >= 600 && outvoted == 0,
                "{section:?}"
            );
            continue;
        }
        // Its processes were killed, and came back with the state of another channel.
        assert!(
            outvoted >= 3 && section.mismatches == outvoted,
            "{section:?}"
        );
        let killed = "killed: two channels contradicted its channel";
        let of_b = report.deaths.iter().filter(|it| it.role.starts_with("b."));
        assert!(
            of_b.clone().count() == 3 && of_b.clone().all(|it| it.how == killed),
            "{report:?}"
        );
        rig.ok("replay latest --verify");
    }
}

#[test]
fn a_stage_whose_law_cannot_be_saved_is_not_started_again_beside_another_channel() {
    let rig = Rig::new("unsaved");
    let law = crate::c_laws::library(
        &rig,
        "libfollow.so",
        "bench/cli/tests/laws_c/others.c",
        &["-DROLE=IRONBIRD_OUTER"],
    );
    let flags = format!("--outer {law} --duration 600ms --fault a.outer.kill@200ms");
    let ended = start(&rig, 2, &flags).end().expect(0);
    assert!(
        ended
            .stderr
            .contains("; the flight goes on without channel a"),
        "{ended}"
    );
    let report = rig.final_report();
    let section = redundancy(&report);
    assert_eq!(
        (section.active.as_str(), section.ticks_not_fresh),
        ("b", 0),
        "{section:?}"
    );
    assert!(
        report.deaths[0].how.contains("its law cannot be saved"),
        "{:?}",
        report.deaths
    );
    rig.ok("replay latest --verify");
}

#[test]
fn another_law_flies_in_its_channel_from_the_tick_that_is_requested_and_the_flight_replays() {
    let rig = Rig::new("switched");
    let flags = "--channel b:inner=pid --duration 1500ms --fault b.switch@300ms";
    let flight = start(&rig, 2, flags);
    rig.await_tick(500);
    let back = rig.ok("switch --to a --at-tick 1200");
    assert!(back.stdout.contains("a.switch"), "{back}");
    rig.refused("switch --to c")
        .complains("the flight has 2 channels: a to b");
    flight.end().expect(0);
    let report = rig.final_report();
    let section = redundancy(&report);
    let switched = section.switchovers.iter();
    let switched: Vec<_> = switched
        .map(|it| (it.tick, it.to.as_str(), it.reason.as_str()))
        .collect();
    assert_eq!(
        switched,
        [(300, "b", "requested"), (1200, "a", "requested")]
    );
    assert_eq!(section.ticks_not_fresh, 0, "{section:?}");
    assert_eq!(section.ticks_flown["b"], 900, "{section:?}");
    assert_eq!(
        section.differences["b"].ticks + section.differences["a"].ticks,
        1501
    );
    let verified = rig.ok("replay latest --verify");
    let alone = rig.ok("replay latest/channel-b --verify");
    let values = |output: &str| -> u64 {
        let (before, _) = output.split_once(" values").unwrap();
        before.rsplit_once(' ').unwrap().1.parse().unwrap()
    };
    assert!(values(&verified.stdout) > values(&alone.stdout));
    rig.start("fly", "--pace lockstep --duration 10ms")
        .end()
        .expect(0);
    rig.ok("runs --prune --keep 1").says("removed");
    assert_eq!(rig.run_directories().len(), 1);
    rig.assert_nothing_left();
}

#[test]
fn a_channel_with_another_law_takes_over_from_one_that_is_silent_or_leaves_the_envelope() {
    for (name, limits, fault, reason) in [
        (
            "silent",
            "",
            "--fault a.inner.kill@200ms",
            "no fresh command on time",
        ),
        ("tilted", "tilt_max_rad = 0.02\n", "", "tilt"),
    ] {
        let rig = Rig::new(name);
        let config = rig.airborne(&format!("{SLOW}[simplex]\nenabled = true\n{limits}"));
        let flags = format!("--channels 2 --channel b:inner=pid --rt prefer --config {config}");
        let flight = rig.start("fly", format!("{flags} --duration 800ms {fault}"));
        flight.end().expect(0);
        let report = rig.final_report();
        let section = redundancy(&report);
        let [only] = &section.switchovers[..] else {
            panic!("{section:?}");
        };
        assert_eq!((only.to.as_str(), only.reason.as_str()), ("b", reason));
        if name == "silent" {
            assert!(only.tick.abs_diff(200) <= 2, "{section:?}");
        }
        assert_eq!((section.active.as_str(), section.ticks_not_fresh), ("b", 0));
        rig.ok("replay latest --verify");
    }
}
