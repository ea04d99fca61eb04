//! Processes and machine: the work of each loop, real-time grants, recorder losses.

use maud::{Markup, html};
use model::role::STAGES;

use crate::losses;
use crate::page::parts::{self, cell, table};
use crate::schema::{Report, RoleSection};
use crate::text;

/// The section.
pub fn section(report: &Report) -> Markup {
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
    parts::section("setup", "Processes and machine", content)
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
    table(&columns, stages(report).map(|(name, role)| process(name, role)))
}

/// The processes of the loop, in the order of the data's way.
fn stages(report: &Report) -> impl Iterator<Item = (&'static str, &RoleSection)> {
    STAGES.into_iter().filter_map(|role| Some((role.name(), report.roles.get(role.name())?)))
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
            cell(format!("{:.3}", usage.allocations as f64 / role.ticks_run.max(1) as f64)),
            cell(format!("{} + {} with disk", usage.minor_faults, usage.major_faults)),
            cell(usage.voluntary_switches),
            cell(usage.involuntary_switches),
            cell(parts::us(usage.cpu_per_tick_us)),
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
            reasons.map(move |(reason, count)| format!("{name} rejected {count} messages: {reason}"))
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
            let asked = step.asked.map_or_else(|| "yes".into(), |value| value.to_string());
            vec![html! { span.key.(name) { (name) } }, cell(step.step.replace('_', " ")), cell(asked), granted]
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
        ("hypervisor", host.hypervisor.map_or("not known", |it| if it { "yes" } else { "none" }).into()),
        ("clock source", host.clock_source.clone()),
        ("sched_rt_runtime_us", host.rt_runtime_us.to_string()),
        ("stolen by the host", format!("{} ms, {:.2} %", report.steal.stolen_ms, report.steal.percent)),
        ("build", format!("{} for {}", report.run.build, report.run.build.target)),
        ("settings", report.run.settings_fingerprint.clone()),
        ("run", report.run.run_id.to_string()),
    ];
    facts_table(&facts)
}

fn recorder(report: &Report) -> Markup {
    let recorder = &report.recorder;
    let log = &recorder.log;
    let lost = losses::lost(report);
    let mut facts = vec![
        ("messages lost", lost.to_string()),
        ("ticks incomplete", recorder.incomplete_ticks.to_string()),
        ("share of a processor", format!("{:.1} %", recorder.cpu_percent)),
        ("flight log", losses::log(log)),
    ];
    let unwritten = recorder.unwritten.iter().map(|(file, reason)| ("incomplete", format!("{file}: {reason}")));
    facts.extend(unwritten);
    facts_table(&facts)
}

fn facts_table(facts: &[(&str, String)]) -> Markup {
    html! { dl.facts { @for (name, value) in facts { dt { (name) } dd { (value) } } } }
}
