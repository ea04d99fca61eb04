//! Texts that the server sends the page, as JSON: functions of the dashboard's model.
//!
//! ```text
//!   flight   once, and to each new page: what stays; the poses so far
//!   pose     20 times a second
//!   news     twice a second: verdicts, latencies, outages, channels, processes, faults, events, parameters
//!   answer   to a request of the page
//! ```

use std::collections::BTreeMap;

use analysis::schema::{Explained, FlightVerdict, RedundancySection};
use analysis::sections;
use analysis::series::{Latencies, Series, Statistics};
use analysis::theorem::no_theorem;
use faults::PORTS;
use faults::grammar::Change;
use messages::blackboards::EndReason;
use messages::content::Mode;
use messages::parameters::{Airframe, ESTIMATED, Parameter, SPECS};
use messages::role::{Channel, Replica, Role, STAGES};
use messages::telemetry::LAW_ROLES;
use serde_json::{Value, json};

use super::filed_report::FiledReport;
use crate::parameter_text::rows;
use crate::watch::dashboard_model::{Event, Judged, Model, Pose, WatchedFlight};

/// Bins of a histogram in a decade.
const BINS: f64 = 12.0;
/// Times below 100 ns count in the bin from there on.
const FIRST_BIN: i32 = 2 * BINS as i32;
const EVENTS: usize = 100;
/// Handovers among them, the newest ones; the account of the channels counts all.
const HANDOVERS: usize = 3;
const OUTAGES: usize = 8;

/// The facts of a flight that stay, and the poses so far; without a flight, none.
pub(super) fn flight(model: &Model, allows_control: bool) -> Value {
    let mut text = json!({
        "kind": "flight",
        "instance": model.instance,
        "allows_control": allows_control,
    });
    if let Some(flight) = &model.flight {
        let run = &flight.run;
        let settings = &flight.settings;
        let course = [&*settings.flight.trajectory, &settings.flight.preset];
        let laws = LAW_ROLES.map(|role| settings.law_name(role));
        let conditions = [&course[..], &laws].concat();
        text["flight"] = json!({
            "run": run.run_id.to_string(),
            "channels": channels(flight),
            "duration_s": run.flight_time_s(run.last_tick),
            "conditions": conditions,
            "no_estimates": flight.laws.without_theorem.map(no_theorem),
            "estimated": ESTIMATED.map(|parameter| [parameter.name(), parameter.spec().unit]),
            "hover_rad_s": hover_rad_s(&flight.airframe),
            "reference": flight.reference_line(),
            "poses": flight.poses.iter().map(pose_numbers).collect::<Vec<_>>(),
            "parameters": rows(&flight.airframe, None).as_slice(),
            "faults": fault_rows(channels(flight), run.flight_time_s(1)),
        });
    }
    text
}

fn channels(flight: &WatchedFlight) -> usize {
    flight.run.channels.max(1) as usize
}

/// Speed of each rotor in hover by the nominal parameters.
fn hover_rad_s(airframe: &Airframe) -> f64 {
    use Parameter::{Gravity, Mass, ThrustCoefficient};
    let [mass, gravity, k] = [Mass, Gravity, ThrustCoefficient].map(|it| airframe.get(it));
    (mass * gravity / (4.0 * k)).sqrt()
}

fn pose_numbers(pose: &Pose) -> Value {
    json!({
        "t": pose.time_s, "p": pose.position_w_m, "q": pose.attitude, "yaw": pose.yaw_rad, "r": pose.reference_w_m,
        "ryaw": pose.reference_yaw_rad, "w": pose.rotor_command_rad_s, "e": pose.position_error_m,
        "th": pose.estimates, "true": pose.estimated,
    })
}

pub(super) fn pose(flight: &WatchedFlight) -> Option<Value> {
    let mut text = pose_numbers(&flight.newest_pose()?);
    text["kind"] = "pose".into();
    Some(text)
}

/// Everything that changes and is no pose.
pub(super) fn news(model: &Model, filed: &FiledReport, pages: usize) -> Value {
    let mut text = json!({"kind": "news", "pages": pages});
    let Some(flight) = &model.flight else {
        return text;
    };
    let (mut verdicts, not_fresh) = flight.verdicts();
    if let Some(report) = filed.complete() {
        verdicts = report.words.clone();
    }
    let verdict = |it: Judged<'_>| match flight.lost_at() {
        // Without a recorder, it is of the past.
        Some(tick) => {
            let why = format!("up to tick {tick}: {}", it.why);
            json!({"word": it.word, "why": why, "tone": tone(None)})
        }
        None => json!({"word": it.word, "why": it.why, "tone": tone(it.is_good)}),
    };
    text["flight"] = json!({
        "phase": phase(flight, filed, &verdicts.flight),
        "tick": flight.tick(),
        "verdicts": Judged::all(&verdicts).map(verdict),
        "broken": broken(flight),
        "changed": changed(flight),
        "missed": flight.run.deadlines_missed,
        "skipped": flight.run.ticks_skipped,
        "not_fresh": not_fresh.ticks,
        "lost": flight.lost(),
        "series": latencies(flight),
        "outages": outages(filed),
        "redundancy": redundancy(flight),
        "processes": processes(flight),
        "failed": flight.supervision.failed,
        "restarted": flight.supervision.restarted,
        "faults": flight.active_faults(),
        "events": events(flight),
        "parameters": flight.active.value,
        "report": filed.path,
        "status": filed.complete().map(|it| it.verdict.status.to_string()),
    });
    text
}

const fn tone(is_good: Option<bool>) -> &'static str {
    match is_good {
        Some(true) => "good",
        Some(false) => "bad",
        None => "open",
    }
}

fn phase(flight: &WatchedFlight, filed: &FiledReport, track: &Explained<FlightVerdict>) -> Value {
    let report = filed.complete();
    let active = flight.redundancy.map(|it| it.active_channel());
    let active = active.filter(|_| flight.run.channels > 1);
    let active = active.map_or_else(String::new, |it| format!("channel {it} flies"));
    let (word, why, is_good) = match flight.ending {
        _ if track.word == FlightVerdict::Lost => ("lost", track.why.as_str(), Some(false)),
        None => ("flying", active.as_str(), Some(true)),
        Some(EndReason::Completed) => ("ended", "its duration is over", None),
        Some(ending) => {
            let why = report.map_or(ending.name(), |it| it.run.ending.as_str());
            ("ended", why, Some(false))
        }
    };
    let is_over = flight.ending.is_some();
    json!({"word": word, "why": why, "tone": tone(is_good), "is_over": is_over})
}

/// Missing processes, active faults and stages that use old data, at this moment.
fn broken(flight: &WatchedFlight) -> Vec<String> {
    if flight.ending.is_some() {
        return Vec::new();
    }
    let mut broken = Vec::new();
    for replica in &flight.missing {
        broken.push(format!(
            "no {} process",
            name_in(channels(flight), *replica)
        ));
    }
    for (what, rest_s) in flight.active_faults() {
        broken.push(match rest_s {
            Some(rest_s) => format!("fault {what}, {rest_s:.1} s more"),
            None => format!("fault {what}"),
        });
    }
    for (stage, mode, since) in flight.modes() {
        let does = match mode {
            Mode::Fresh => continue,
            Mode::Held => "works with its last input",
            Mode::Fallback => "sends its fallback, its input is too old",
            Mode::Idle => "commands idle rotors",
            Mode::NotFinite => "replaces its law's output, which is not finite",
        };
        let since_s = flight.run.flight_time_s(since);
        let stage = name_in(channels(flight), stage.into());
        broken.push(format!("{stage}, since {since_s:.3} s: {does}"));
    }
    broken
}

/// Parameters that are not nominal.
fn changed(flight: &WatchedFlight) -> Vec<String> {
    let all = SPECS.iter().zip(flight.active.value);
    let all = all.map(|(spec, value)| (spec, value, flight.airframe.get(spec.parameter)));
    let changed = all.filter(|(_, value, nominal)| value != nominal);
    let words = changed.map(|(spec, value, nominal)| {
        let digits = |it: f64| format!("{it:.4e}").parse().unwrap_or(it);
        format!(
            "{} {} (nominal {})",
            spec.name,
            digits(value),
            digits(nominal)
        )
    });
    words.collect()
}

const fn is_of_channel(replica: Replica) -> bool {
    !matches!(replica.role, Role::Plant | Role::Record)
}

/// Name of a process, with its channel if there are several.
fn name_in(channels: usize, replica: Replica) -> String {
    match channels > 1 && is_of_channel(replica) {
        true => format!("{}.{}", replica.channel, replica.role),
        false => replica.to_string(),
    }
}

fn latencies(flight: &WatchedFlight) -> Vec<Value> {
    let hops = STAGES.windows(2).map(|pair| Series::Hop(pair[0], pair[1]));
    let wakes = STAGES.map(Series::Wake);
    let shown = [Series::Loop].into_iter().chain(hops).chain(wakes);
    let known = shown.filter_map(|series| {
        let latencies = flight.statistics.series.flight(series)?;
        let statistics = Statistics::of(&series.name(), latencies);
        Some(json!({
            "name": statistics.name, "count": statistics.count, "p50": statistics.p50_us, "p99": statistics.p99_us,
            "p999": statistics.p999_us, "max": statistics.max_us, "bins": bins(latencies),
        }))
    });
    known.collect()
}

/// Lower edges [us] and counts of the bins with values.
fn bins(latencies: &Latencies) -> Vec<(f64, u64)> {
    let mut counts = BTreeMap::<i32, u64>::new();
    for value in latencies.iter_recorded() {
        let bin = ((value.value_iterated_to().max(1) as f64).log10() * BINS).floor() as i32;
        let bin = bin.max(FIRST_BIN);
        *counts.entry(bin).or_default() += value.count_at_value();
    }
    let edge_us = |bin: i32| 10_f64.powf(f64::from(bin) / BINS) / 1e3;
    counts
        .into_iter()
        .map(|(bin, count)| (edge_us(bin), count))
        .collect()
}

/// Outages as the recorder has classed them so far.
fn outages(filed: &FiledReport) -> Value {
    let Some(report) = &filed.report else {
        return Value::Null;
    };
    let section = &report.autopsy;
    let classes = section.classes.iter().map(|it| {
        json!({"cause": it.class.words(), "stage": it.stage, "outages": it.outages, "missed": it.missed})
    });
    let worst = section.worst.iter().take(OUTAGES).map(|it| {
        json!({
            "tick": it.tick, "time_s": it.time_s, "ticks": it.ticks, "missed": it.missed, "cause": it.class.words(),
            "stage": it.stage, "evidence": it.evidence, "faults": it.faults,
        })
    });
    json!({
        "classes": classes.collect::<Vec<_>>(),
        "pending": section.pending,
        "worst": worst.collect::<Vec<_>>(),
    })
}

/// The plant's account of the channels with their newest outages; none of a flight with one channel.
fn redundancy(flight: &WatchedFlight) -> Option<RedundancySection> {
    let account = flight.redundancy.filter(|_| flight.run.channels > 1)?;
    let mut section = sections::redundancy(&account, flight.run.flight_time_s(1));
    section.outages.reverse();
    section.outages.truncate(OUTAGES);
    Some(section)
}

fn processes(flight: &WatchedFlight) -> Vec<Value> {
    let all = flight.statuses.iter().map(|(replica, status)| {
        json!({
            "name": name_in(channels(flight), *replica), "pid": status.pid, "missing": flight.missing.contains(replica),
            "phase": format!("{:?}", status.phase()).to_lowercase(), "ticks": status.ticks_run,
            "skipped": status.ticks_skipped, "stale": status.ticks_stale,
        })
    });
    all.collect()
}

fn events(flight: &WatchedFlight) -> Vec<Value> {
    let events = flight.events(HANDOVERS).into_iter().take(EVENTS);
    let event = |it: Event| json!({"tick": it.tick, "time_s": flight.run.flight_time_s(it.tick), "kind": it.kind, "text": it.text});
    events.map(event).collect()
}

/// Buttons by what they act on.
fn fault_rows(channels: usize, period_s: f64) -> Vec<Value> {
    let delay_ticks = (3e-3 / period_s).round().max(1.0);
    let delay = format!("delay {:.0} ms", 1e3 * delay_ticks * period_s);
    let delay_fault = format!("delay={delay_ticks}");
    let of_messages = [
        ("drop 20 %", "drop=0.2"),
        (&delay, &delay_fault),
        ("freeze", "freeze"),
    ];
    let of_process = [
        ("kill", "kill"),
        ("3 ms late", "late=3ms"),
        ("stop 20 ms", "stop=20ms"),
    ];
    let of_vehicle = [
        ("gust along x", "wind_x_m_s", "2"),
        ("gust along y", "wind_y_m_s", "2"),
        ("weak rotor 1", "rotor_efficiency_1", "0.7"),
        ("weak rotor 2", "rotor_efficiency_2", "0.7"),
        ("weak rotor 3", "rotor_efficiency_3", "0.7"),
        ("weak rotor 4", "rotor_efficiency_4", "0.7"),
    ];
    let row = |name: String, buttons: Vec<Value>| json!({"name": name, "buttons": buttons});
    let faults = |kind: &str, of: &str, faults: [(&str, &str); 3]| {
        let button = |(label, fault)| button(label, &format!("{of}.{fault}"), None);
        row(format!("{kind} {of}"), faults.map(button).into())
    };
    let mut topics = PORTS.map(|port| port.topic()).to_vec();
    topics.dedup();
    let topics = topics.into_iter().map(|topic| topic.to_string());
    let processes = Replica::all(channels).filter(|it| is_of_channel(*it));
    let processes = processes.map(|it| name_in(channels, it));
    let mut rows: Vec<Value> = topics
        .map(|topic| faults("messages", &topic, of_messages))
        .chain(processes.map(|it| faults("process", &it, of_process)))
        .collect();
    if channels > 1 {
        let fly = |it| button(&format!("fly {it}"), &format!("{it}.switch"), None);
        let switch = Channel::first(channels).map(fly);
        rows.push(row("channel".into(), switch.collect()));
    }
    let for_2s = of_vehicle.map(|(label, name, value)| {
        let back = format!("{name}=nominal~200ms");
        button(label, &format!("{name}={value}~200ms"), Some((&back, "2s")))
    });
    rows.push(row("vehicle, for 2 s".into(), for_2s.into()));
    rows
}

/// A button that injects a change, and may inject another one later.
fn button(label: &str, change: &str, later: Option<(&str, &str)>) -> Value {
    let inject: Vec<_> = [(change, None)]
        .into_iter()
        .chain(later.map(|(change, after)| (change, Some(after))))
        .collect();
    let (meaning, lasts) = match change.parse::<Change>() {
        Ok(change) => {
            let meaning = match &change {
                Change::Parameter(desired) => desired.parameter.spec().meaning,
                Change::Loop(change) => change.kind.spec().meaning,
            };
            (meaning, change.lasts())
        }
        Err(_) => ("", false),
    };
    json!({"label": label, "inject": inject, "meaning": meaning, "lasts": lasts})
}

pub(super) fn answer(id: u64, answered: &Result<String, String>) -> Value {
    let (is_ok, text) = match answered {
        Ok(text) => (true, text),
        Err(text) => (false, text),
    };
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    json!({"kind": "answer", "id": id, "ok": is_ok, "text": text})
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::made_up;
    use flight_log::entry::LogEntry;
    use messages::content::Wrench;

    #[test]
    fn every_button_injects_what_can_be_injected_and_says_what_it_means() {
        for (channels, buttons) in [(1, 27), (3, 48)] {
            let rows = fault_rows(channels, 1e-3);
            let all = rows
                .iter()
                .flat_map(|row| row["buttons"].as_array().unwrap());
            let all: Vec<&Value> = all.collect();
            assert_eq!(all.len(), buttons);
            for button in all {
                assert_ne!(button["meaning"], "", "{button}");
                for part in button["inject"].as_array().unwrap() {
                    let text = part[0].as_str().unwrap();
                    let read = crate::inject::parse_line(text);
                    assert!(read.is_ok(), "{text}: {read:?}");
                }
            }
        }
    }
    #[test]
    fn what_is_broken_is_of_this_moment_and_a_changed_parameter_is_none() {
        let mut model = made_up::joined(&made_up::run(), &[]);
        let flight = made_up::flight(&mut model);
        assert_eq!(broken(flight), [""; 0]);
        let modes = [Mode::Fresh, Mode::Held, Mode::Held, Mode::Fresh, Mode::Held];
        let words = [
            None,
            Some("inner, since 0.011 s: works with its last input"),
            Some("inner, since 0.011 s: works with its last input"),
            None,
            Some("inner, since 0.014 s: works with its last input"),
        ];
        for ((tick, mode), words) in (10..).zip(modes).zip(words) {
            let content = Wrench {
                mode: mode as u64,
                ..Wrench::default()
            };
            flight.take(&LogEntry::Wrench(made_up::message(tick, content)));
            assert_eq!(broken(flight), Vec::from_iter(words));
        }
        assert_eq!(changed(flight), [""; 0]);
        flight.active.value[Parameter::RotationalDrag as usize] = 0.315;
        let words = "rotational_drag_nm_s 0.315 (nominal 0.105)";
        assert_eq!(changed(flight), [words]);
        assert_eq!(broken(flight).len(), 1);
    }

    #[test]
    fn a_flight_that_ends_by_its_duration_has_ended_and_a_lost_one_says_why() {
        let mut model = made_up::joined(&made_up::run(), &[]);
        let flight = made_up::flight(&mut model);
        use EndReason::{Completed, Interrupted};
        use FlightVerdict::{CutShort, Lost, Tracked};
        for (ending, track, word, why) in [
            (None, Tracked, "flying", ""),
            (None, Lost, "lost", "below ground"),
            (Some(Completed), Tracked, "ended", "its duration is over"),
            (Some(Completed), Lost, "lost", "below ground"),
            (Some(Interrupted), CutShort, "ended", "interrupted"),
        ] {
            flight.ending = ending;
            let track = Explained::new(track, "below ground".into());
            let phase = phase(flight, &FiledReport::default(), &track);
            assert_eq!((&phase["word"], &phase["why"]), (&word.into(), &why.into()));
            assert_eq!(phase["is_over"], ending.is_some());
        }
    }
}
