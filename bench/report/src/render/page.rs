//! The report as one self-contained web page: no network, no font; its script only reads charts out.
//!
//! It shows what report.json holds, and nothing else.

use crate::laws::in_order;
use crate::render::figures::{ESTIMATED, Figures, ROTORS};
use crate::render::html::{Key, cell, chart, number, table, us};
use crate::render::plot::STYLE;
use crate::render::theorem_text::explained;
use crate::render::{facts_text, html, latency_page, outage_page, text};
use crate::schema::SignalSection;
use crate::schema::{FlightVerdict, StabilityVerdict, TimingVerdict, Verdicts};
use crate::schema::{Report, RoleSection};
use crate::status::FlightStatus;
use crate::swaps::seconds;
use crate::{margin_section, message_loss};
use maud::{DOCTYPE, Markup, PreEscaped, html};
use messages::role::STAGES;

/// What the page looks like, without its charts.
const PAGE_STYLE: &str = include_str!("page.css");

/// Reads a chart out where a pointer is.
const READOUT: &str = include_str!("readout.js");

/// The page may load nothing, wherever the words in it come from.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'; base-uri 'none'";

#[must_use]
pub fn render(report: &Report) -> String {
    let run = &report.run;
    let build = run.build.of_version(&run.version).to_string();
    let body = html! {
        (head(report))
        (contents(report))
        main {
            (latency_page::section(report))
            (outage_page::section(report))
            (run_section(report))
            (flight_section(report))
            (stability_section(report))
            (setup_section(report))
        }
        footer { "ironbird " (build) ", report.json of " (run.started) }
    };
    document(&text::title(run), &build, body)
}

/// A page of its own that a build has made.
#[must_use]
pub fn document(title: &str, build: &str, body: Markup) -> String {
    let page: Markup = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                meta name="generator" content=(format!("ironbird {build}"));
                // An empty picture, so that no browser asks a server for one.
                link rel="icon" href="data:,";
                title { (title) }
                style { (PreEscaped(STYLE)) (PreEscaped(PAGE_STYLE)) }
            }
            body {
                (body)
                script { (PreEscaped(READOUT)) }
            }
        }
    };
    page.into_string()
}

/// What was flown, the three words, key numbers.
fn head(report: &Report) -> Markup {
    let run = &report.run;
    let verdict = &report.verdict;
    let failed = verdict.status != FlightStatus::Pass && !run.in_flight;
    html! {
        header {
            h1 {
                (run.flown()) " "
                span.verdict.bad[failed] { (verdict.words()) }
            }
            (words(report))
            @for sentence in message_loss::sentences(report) { p.bad { (sentence) } }
            @if !run.last_words.is_empty() { p { (run.ending) ". Last messages of the process:" } pre { (run.last_words.join("\n")) } }
            (tiles(report))
            @if let Some(margin) = margin_section::sentence(report) { p { "Margin: " (margin) "." } }
            p {
                (run.started) ", instance " (run.instance) ", "
                @if run.in_flight { "in flight: numbers so far, plots come with its end" } @else { (run.ending) }
                ". " (text::pace(report)) ". Laws: " (facts_text::laws(&run.laws)) ". " (text::machine(report)) ". Real time here: " (text::here(report)) "."
            }
        }
    }
}

/// Whether a word is good news, bad news, or neither.
fn tones(words: &Verdicts) -> [&'static str; 3] {
    let flight = match words.flight.word {
        FlightVerdict::Tracked => "good",
        FlightVerdict::OffTrack | FlightVerdict::Lost => "bad",
        FlightVerdict::NotSeen | FlightVerdict::CutShort => "open",
    };
    let timing = match words.timing.word {
        TimingVerdict::InTime => "good",
        TimingVerdict::Late => "bad",
        TimingVerdict::NotMeasured | TimingVerdict::CutShort => "open",
    };
    let theorem = match words.theorem.word {
        StabilityVerdict::Holds => "good",
        StabilityVerdict::Broken => "bad",
        StabilityVerdict::NotApplicable | StabilityVerdict::PartlyWatched => "open",
    };
    [flight, timing, theorem]
}

fn words(report: &Report) -> Markup {
    html! {
        dl.words {
            @for ((subject, word, why), tone) in report.words.each().into_iter().zip(tones(&report.words)) {
                div.(tone) { dt { (subject) } dd.word { (word) } dd.why { (why) } }
            }
        }
    }
}

/// The way to each section, always in sight, and the switch of what is drawn in all charts.
fn contents(report: &Report) -> Markup {
    let has_outages = !report.autopsy.classes.is_empty();
    let has_miss_lines = report.traces.is_some() && !report.deadlines.stretches.is_empty();
    html! {
        nav {
            @for (id, title) in [
                ("latency", "Latency"),
                ("outages", "Outages"),
                ("gates", "Gates"),
                ("flight", "Flight"),
                ("theorem", "Theorem"),
                ("setup", "Processes and machine"),
            ] {
                @if id != "outages" || has_outages { a href=(format!("#{id}")) { (title) } }
            }
            @if has_miss_lines {
                label { input #miss-lines type="checkbox" checked; "missed deadlines in charts" }
            }
        }
    }
}

fn tiles(report: &Report) -> Markup {
    let series = |name: &str| report.series(name);
    let tile = |title: &str, value: String, unit: &str| {
        html! { div { dt { (title) } dd { (value) " " span.unit { (unit) } } } }
    };
    let missed = &report.deadlines;
    let error_m = report.flight.position_error_rms_m;
    let (error, unit) = if error_m < 1.0 {
        (error_m * 1e3, "mm")
    } else {
        (error_m, "m")
    };
    html! {
        dl.tiles {
            @if let Some(whole) = series("loop") {
                (tile("loop p50", us(whole.p50_us), "us"))
                (tile("loop p99", us(whole.p99_us), "us"))
                @match whole.p999_us {
                    Some(value) => (tile("loop p99.9", us(value), "us")),
                    None => (tile("loop p99.9", "-".into(), "too few values")),
                }
            }
            @if let Some(wake) = series("wake.plant") { (tile("wake p99", us(wake.p99_us), "us")) }
            @if report.run.wall_period_us > 0.0 {
                @match &missed.not_fresh {
                    Some(sum) => {
                        (tile("ticks without a fresh command", sum.ticks.to_string(), &format!("{:.1} ppm", sum.per_million)))
                        (tile("missed + stale + skipped", format!("{} + {} + {}", sum.missed, sum.stale, sum.skipped), ""))
                    }
                    None => (tile("deadlines missed", missed.missed.to_string(), &format!("{:.1} ppm", missed.missed_ppm))),
                }
            }
            (tile("ticks flown", report.ticks.run.to_string(), ""))
            (tile("ticks skipped", report.ticks.skipped.to_string(), ""))
            (tile("position error rms", format!("{error:.3}"), unit))
        }
    }
}

fn run_section(report: &Report) -> Markup {
    let ticks = &report.ticks;
    let sum = ticks.run + ticks.skipped;
    html::section(
        "gates",
        "Gates",
        html! {
            p {
                "Ticks: run " (ticks.run) " + skipped " (ticks.skipped) " = " (sum) " "
                @if ticks.identity_holds { "=" } @else { strong { "is not" } }
                " elapsed " (format!("{:.3}", ticks.elapsed_s)) " s / period = " (ticks.elapsed_periods) "."
            }
            (table(&["gate", "found", "allowed", ""], report.verdict.gates.iter().map(|gate| {
                let word = if gate.held { "held" } else { "FAILED" };
                vec![
                    cell(&gate.name),
                    cell(&gate.value),
                    cell(&gate.limit),
                    html! { span.good[gate.held].bad[!gate.held] { (word) } },
                ]
            })))
            h3 { "Live swaps" }
            @if report.swaps.is_empty() { p { "No parameter of the airframe was swapped." } }
            @else { (swaps(report)) }
            @if report.swaps_left_out > 0 { p { "And " (report.swaps_left_out) " later ones." } }
            @if !report.faults.is_empty() {
                h3 { "Faults" }
                (faults(report))
            }
        },
    )
}

fn swaps(report: &Report) -> Markup {
    let rows = report.swaps.iter().flat_map(|swap| {
        swap.changes.iter().map(move |change| {
            vec![
                cell(&change.name),
                cell(format!("{:.3} s", swap.time_s)),
                cell(swap.tick),
                cell(change.old),
                cell(change.new),
                cell(if change.over_s > 0.0 {
                    seconds(change.over_s)
                } else {
                    "at once".into()
                }),
            ]
        })
    });
    table(&["parameter", "at", "tick", "old", "new", "over"], rows)
}

fn faults(report: &Report) -> Markup {
    let rows = report.faults.iter().map(|fault| {
        let how = if fault.live {
            "injected in flight"
        } else {
            "planned"
        };
        vec![
            cell(&fault.what),
            cell(format!("{:.3} s", fault.time_s)),
            cell(fault.tick),
            cell(fault.until()),
            cell(how),
        ]
    });
    table(&["fault", "from", "tick", "until", "how"], rows)
}

fn setup_section(report: &Report) -> Markup {
    let content = html! {
        h3 { "Processes" }
        (processes(report))
        (rejections(report))
        h3 { "Real time, asked and granted" }
        (realtime(report))
        @if let Some(lead) = text::lead(report) { p { (lead) } }
        div.columns {
            div { h3 { "Machine" } (machine(report)) }
            div { h3 { "Recorder" } (recorder(report)) }
        }
    };
    html::section("setup", "Processes and machine", content)
}

fn processes(report: &Report) -> Markup {
    let columns = [
        "process",
        "scheduling",
        "ticks",
        "skipped",
        "stale",
        "rejected",
        "allocations per tick",
        "page faults",
        "waits",
        "preempted",
        "cpu per tick [us]",
    ];
    table(
        &columns,
        stages(report).map(|(name, role)| process(name, role)),
    )
}

/// The processes of the loop, in the order of the data's way.
fn stages(report: &Report) -> impl Iterator<Item = (&'static str, &RoleSection)> {
    STAGES
        .into_iter()
        .filter_map(|role| Some((role.name(), report.roles.get(role.name())?)))
}

fn process(name: &str, role: &RoleSection) -> Vec<Markup> {
    let mut row = vec![
        html! { span.key.(name) { (name) } },
        cell(&role.scheduling),
        cell(role.ticks_run),
        cell(role.ticks_skipped),
        cell(role.ticks_stale),
        cell(role.rejected.values().sum::<u64>()),
    ];
    match &role.usage {
        Some(usage) => row.extend([
            cell(usage.allocations.map_or_else(
                || "-".to_owned(),
                |all| format!("{:.3}", all as f64 / role.ticks_run.max(1) as f64),
            )),
            cell(format!(
                "{} + {} with disk",
                usage.minor_faults, usage.major_faults
            )),
            cell(usage.voluntary_switches),
            cell(usage.involuntary_switches),
            cell(us(usage.cpu_per_tick_us)),
        ]),
        None => row.extend((0..5).map(|_| cell("-"))),
    }
    row
}

fn rejections(report: &Report) -> Markup {
    let struck: Vec<String> = stages(report)
        .map(|(name, role)| (name, &role.rejected))
        .chain([("record", &report.recorder.rejected)])
        .flat_map(|(name, reasons)| {
            let reasons = reasons.iter().filter(|(_, count)| **count > 0);
            reasons
                .map(move |(reason, count)| format!("{name} rejected {count} messages: {reason}"))
        })
        .collect();
    html! { @if !struck.is_empty() { ul { @for line in struck { li { (line) } } } } }
}

fn realtime(report: &Report) -> Markup {
    let rows = stages(report).flat_map(|(name, role)| {
        role.realtime.iter().map(move |step| {
            let granted = match &step.refused {
                None => html! { span.good { "granted" } },
                Some(reason) => html! { span.bad { "refused" } ": " (reason) },
            };
            let asked = step
                .asked
                .map_or_else(|| "yes".into(), |value| value.to_string());
            vec![
                html! { span.key.(name) { (name) } },
                cell(step.step.replace('_', " ")),
                cell(asked),
                granted,
            ]
        })
    });
    let rows: Vec<_> = rows.collect();
    html! {
        @if rows.is_empty() { p { "Nothing was asked: not a real-time flight." } }
        @else if stages(report).flat_map(|(_, role)| &role.realtime).all(|step| step.granted) {
            details { summary { "All of it was granted." } (table(&REALTIME, rows)) }
        } @else { (table(&REALTIME, rows)) }
    }
}

const REALTIME: [&str; 4] = ["process", "step", "asked", "outcome"];

fn machine(report: &Report) -> Markup {
    let host = &report.host;
    let facts = [
        ("kernel", host.kernel.clone()),
        ("preemption", host.preemption.clone()),
        ("processors", format!("{} x {}", host.cpus, host.cpu)),
        (
            "hypervisor",
            host.hypervisor
                .map_or("not known", |it| if it { "yes" } else { "none" })
                .into(),
        ),
        ("clock source", host.clock_source.clone()),
        ("sched_rt_runtime_us", host.rt_runtime_us.to_string()),
        (
            "stolen by the host",
            format!(
                "{} ms, {:.2} %",
                report.steal.stolen_ms, report.steal.percent
            ),
        ),
        (
            "build",
            format!("{} for {}", report.run.build, report.run.build.target),
        ),
        ("settings", report.run.settings_fingerprint.clone()),
        ("run", report.run.run_id.to_string()),
    ];
    facts_table(&facts)
}

fn recorder(report: &Report) -> Markup {
    let recorder = &report.recorder;
    let log = &recorder.log;
    let lost = message_loss::lost(report);
    let mut facts = vec![
        ("messages lost", lost.to_string()),
        ("ticks incomplete", recorder.incomplete_ticks.to_string()),
        (
            "share of a processor",
            format!("{:.1} %", recorder.cpu_percent),
        ),
        ("flight log", facts_text::log(log)),
    ];
    let unwritten = recorder
        .unwritten
        .iter()
        .map(|(file, reason)| ("incomplete", format!("{file}: {reason}")));
    facts.extend(unwritten);
    facts_table(&facts)
}

fn facts_table(facts: &[(&str, String)]) -> Markup {
    html! { dl.facts { @for (name, value) in facts { dt { (name) } dd { (value) } } } }
}

/// Attitude, position, errors, torque, rotors, path; estimates of a law that has some; each law's telemetry.
fn flight_section(report: &Report) -> Markup {
    let flight = &report.flight;
    let estimates = flight.estimates.iter().map(|estimate| {
        let digits = |value: f64| cell(format!("{value:.6e}"));
        vec![
            cell(&estimate.name),
            digits(estimate.estimated),
            digits(estimate.actual),
        ]
    });
    let content = html! {
        p {
            "Position error rms " (number(flight.position_error_rms_m)) " m, largest "
            (number(flight.position_error_max_m)) " m, at the end " (number(flight.position_error_final_m))
            " m, over " (html::count(flight.states, "state")) (text::without_state(report))
            @if let Some(e) = flight.rate_error_final_rad_s {
                "; rate error of the inner law at the end " span.nobreak { (number(e)) " rad/s" }
            }
            "; rotors saturated in " (html::count(flight.saturated_ticks, "tick")) "."
        }
        (flight_plots(report))
        @if !flight.estimates.is_empty() {
            h3 { "Estimates at the end" }
            (table(&["parameter", "estimated", "true"], estimates))
        }
        (laws_table(report))
    };
    html::section("flight", "Flight", content)
}

fn flight_plots(report: &Report) -> Markup {
    let Some(traces) = &report.traces else {
        return html! {};
    };
    let figures = Figures::of(traces, report);
    const ANGLES: [&str; 3] = ["roll", "pitch", "yaw"];
    const AXES: [&str; 3] = ["x", "y", "z"];
    const AXIS_KEYS: [Key<'_>; 3] = [("x", "x"), ("y", "y"), ("z", "z")];
    const ANGLE_KEYS: [Key<'_>; 3] = [("roll", "roll"), ("pitch", "pitch"), ("yaw", "yaw")];
    let rotors: [Key<'_>; 4] = [
        (ROTORS[0], "1"),
        (ROTORS[1], "2"),
        (ROTORS[2], "3"),
        (ROTORS[3], "4"),
    ];
    let symbols = ["I_R", "k_r", "delta"];
    html! {
        p.marks {
            "In every plot over time: " span.key.mark.swap { @if report.faults.is_empty() { "live swap" } @else { "live swap, fault" } } " "
            span.key.mark.missed { "missed deadline" } " Each line is drawn through the smallest and the largest value of "
            (html::count(traces.flight.every_ticks, "tick")) "."
        }
        div.plots {
            @for i in 0..3 {
                (chart(ANGLES[i], &format!("Attitude: {}", ANGLES[i]),
                    &[(ANGLES[i], "actual"), ("reference", "reference")], &figures.attitude(i)))
            }
            @for i in 0..3 {
                (chart(AXES[i], &format!("Position: {}", AXES[i]),
                    &[(AXES[i], "actual"), ("reference", "reference")], &figures.position(i)))
            }
            (chart("position-error", "Tracking error: position", &AXIS_KEYS, &figures.position_error()))
            @if traces.has_rate_error() {
                (chart("rate-error", "Tracking error: body rates", &ANGLE_KEYS, &figures.rate_error()))
            }
            (chart("distance", "Distance from the reference", &[], &figures.distance()))
            (chart("thrust", "Thrust demanded", &[], &figures.thrust()))
            (chart("torque", "Torque demanded", &ANGLE_KEYS, &figures.torque()))
            (chart("rotors", "Rotor speeds", &rotors, &figures.rotor_speeds()))
        }
        @if traces.has_estimates() {
            div.plots {
                @for i in 0..3 {
                    (chart(ESTIMATED[i], &format!("Estimate of {}", symbols[i]),
                        &[(ESTIMATED[i], "estimated"), ("reference", "true")], &figures.estimate(i)))
                }
                @for i in 0..3 {
                    (chart(&format!("{}-error", ESTIMATED[i]), &format!("Estimation error of {}", symbols[i]),
                        &[(ESTIMATED[i], "estimated less true")], &figures.estimate_error(i)))
                }
            }
        }
        div.plots {
            @for (across, up, title) in [(0, 1, "from above"), (0, 2, "along y"), (1, 2, "along x")] {
                (chart(&format!("path-{}{}", AXES[across], AXES[up]), &format!("Path seen {title}"),
                    &[("flown", "flown"), ("reference", "reference"), ("swap ring", "live swap")],
                    &figures.path(across, up)))
            }
        }
        p.note { "Paths show at most the last minute; both axes have the same scale." }
    }
}

/// A table and charts for each law, in the order of the data flow; nothing in reports from before it was kept.
fn laws_table(report: &Report) -> Markup {
    let laws = &report.run.laws;
    if laws.values().all(|law| law.telemetry.is_empty()) {
        return html! {};
    }
    html! {
        h3 #telemetry { "Telemetry of the laws" }
        p.note {
            "What each law shows of itself, as it names it (" code { "ironbird laws NAME" } "). Where a law knew no \
             number, there is none."
        }
        @for (role, law) in in_order(laws) {
            h4 { (capital(role)) " law " code { (law.name) } }
            @if law.telemetry.is_empty() {
                p { "It shows nothing." }
            } @else {
                (charts(report, role, &law.telemetry))
                details {
                    summary { "Numbers of " (html::count(law.telemetry.len() as u64, "signal")) }
                    (numbers(&law.telemetry))
                }
            }
        }
    }
}

fn charts(report: &Report, role: &'static str, signals: &[SignalSection]) -> Markup {
    let Some(traces) = &report.traces else {
        return html! {};
    };
    let Some(group) = traces.telemetry.get(role) else {
        return html! {};
    };
    let figures = Figures::of(traces, report);
    html! {
        div.plots {
            @for signal in signals.iter().filter(|signal| group.has(&signal.name)) {
                (chart(&format!("{role}-{}", signal.name), &titled(signal), &[], &figures.signal(role, group, signal)))
            }
        }
    }
}

/// A word as a heading begins with it.
fn capital(word: &str) -> String {
    word.chars()
        .take(1)
        .map(|first| first.to_ascii_uppercase())
        .chain(word.chars().skip(1))
        .collect()
}

fn titled(signal: &SignalSection) -> String {
    if signal.unit.is_empty() {
        signal.name.clone()
    } else {
        format!("{} [{}]", signal.name, signal.unit)
    }
}

fn numbers(signals: &[SignalSection]) -> Markup {
    let number =
        |value: Option<f64>| cell(value.map_or_else(|| "-".into(), |value| format!("{value:.4e}")));
    let rows = signals.iter().map(|signal| {
        vec![
            cell(&signal.name),
            cell(&signal.unit),
            number(signal.last),
            number(signal.min),
            number(signal.max),
        ]
    });
    table(
        &["signal", "unit", "at the end", "smallest", "largest"],
        rows,
    )
}

fn stability_section(report: &Report) -> Markup {
    let theorem = &report.theorem;
    if let Some(why) = theorem.inapplicable() {
        return html::section(
            "theorem",
            "Theorem",
            html! { p { "Not applicable: " (why) "." } },
        );
    }
    if theorem.ticks_checked == 0 {
        let content = html! { p { "Not watched: no step of the estimates was seen." } };
        return html::section("theorem", "Theorem", content);
    }
    let content = html! {
        p {
            strong { (theorem.verdict()) } ": " (html::count(theorem.ticks_checked, "step")) " checked, "
            (theorem.unexplained()) " unexplained. V_th " (exponent(theorem.v_th_start)) " rad^2/s^2 at the start, "
            (exponent(theorem.v_th_end)) " at the end; fell by " (exponent(theorem.descent))
            " where the theorem predicts " (exponent(theorem.descent_predicted)) ". Estimates "
            @if theorem.is_live { "move as predicted" } @else { strong { "do not move as predicted" } }
            ", in " (html::count(theorem.steps_adapted, "step")) ". Largest excess of a step over what it owes: "
            (exponent(theorem.step_excess_max)) " of what rounding is allowed."
        }
        @if theorem.ticks_unwatched > 0 {
            p.note {
                (html::count(theorem.ticks_unwatched, "tick")) " not watched: the monitor lacks a message before them."
            }
        }
        p { (theorem.convergence) }
        (stability_plots(report))
        div.columns {
            div { h3 { "Steps against the theorem" } (causes(report)) }
            div {
                h3 { "Estimates" }
                (estimates(report))
                @if !theorem.broken.is_empty() {
                    p.note { "The theorem bounds no estimate under " (theorem.broken.join(", ")) "." }
                }
            }
        }
        p {
            "Rate error " (exponent(theorem.rate_error_max_rad_s)) " rad/s at most, "
            (exponent(theorem.rate_error_final_rad_s)) " at the end; "
            (html::count(theorem.ticks_saturated, "saturated tick")) ", "
            (theorem.ticks_stale) " with a stale input, " (html::count(theorem.live_swaps, "live swap"))
            " of an estimated parameter. Excitation of the worst direction: " (exponent(theorem.excitation))
            " e-folds of the error in the last 10 s, " (exponent(theorem.excitation_least)) " in the least of all 10 s."
        }
    };
    html::section("theorem", "Theorem", content)
}

/// A number that no line is broken in.
fn exponent(value: f64) -> Markup {
    html! { span.exponent { (format!("{value:.3e}")) } }
}

fn stability_plots(report: &Report) -> Markup {
    let Some(traces) = &report.traces else {
        return html! {};
    };
    let figures = Figures::of(traces, report);
    let keys = [("v", "V"), ("v_th", "V_th")];
    html! {
        div.plots {
            (chart("v", "V and V_th", &keys, &figures.lyapunov()))
            (chart("v-change", "Their change in a tick", &keys, &figures.lyapunov_change()))
            @for cause in traces.violations.keys() {
                (chart(&format!("violations-{cause}"), &format!("Violations under {}", cause.replace('_', " ")), &[],
                    &figures.violations(cause)))
            }
        }
        p.note { "The axis of the changes is logarithmic to both sides of 0, and linear in its middle." }
    }
}

/// Every cause that struck, with its counts.
fn causes(report: &Report) -> Markup {
    let theorem = &report.theorem;
    let mut names: Vec<&String> = theorem
        .violations
        .keys()
        .chain(theorem.v_above_bound.keys())
        .collect();
    names.sort();
    names.dedup();
    let rows = names.into_iter().map(|cause| {
        let rise = theorem.largest_rise.get(if cause == "unexplained" {
            "none"
        } else {
            cause
        });
        vec![
            html! { (cause) br; small { (explained(cause)) } },
            cell(theorem.violations.get(cause).copied().unwrap_or(0)),
            rise.map_or_else(|| cell("-"), |rise| exponent(rise.absolute)),
            cell(theorem.v_above_bound.get(cause).copied().unwrap_or(0)),
        ]
    });
    table(
        &[
            "cause",
            "violations",
            "largest rise of V_th",
            "V above its bound (not judged)",
        ],
        rows,
    )
}

fn estimates(report: &Report) -> Markup {
    let rows = report.theorem.estimates.iter().map(|estimate| {
        vec![
            cell(&estimate.name),
            exponent(estimate.error),
            exponent(estimate.error_start),
            if report.theorem.broken.is_empty() {
                exponent(estimate.error_bound)
            } else {
                cell("no bound")
            },
            exponent(estimate.identifiability),
            cell(if estimate.found { "yes" } else { "no" }),
        ]
    });
    table(
        &[
            "parameter",
            "error",
            "first error",
            "at most, by the theorem",
            "excitation",
            "found",
        ],
        rows,
    )
}
