//! Metadata of the flight log: build, settings, laws, host and planned faults.

use std::collections::BTreeMap;
use std::iter;

use analysis::host::Host;
use analysis::laws::NotFinite;
use analysis::schema::RoleSection;
use analysis::theorem::no_theorem;
use errors::Failure;
use flight_log::facts::{
    CHANNEL, FAULTS, FORMAT, Facts, HOST, LAWS, POINTS, REALTIME, RUN, Record, SETTINGS, record,
};
use messages::blackboards;
use messages::header::LAYOUT;
use messages::role::Channel;

use config::Settings;
use config::law_settings::Chosen;
use flight_log::build;
use serde_json::{Value, json};

/// The facts of the log of a flight, and with several channels of each one's own.
pub fn metadata_of_logs(
    run: &blackboards::Run,
    settings: &Settings,
    instance: &str,
    host: &Host,
    roles: &BTreeMap<String, RoleSection>,
) -> Result<Vec<(Option<Channel>, Facts)>, Failure> {
    let channels = settings.rt.channels;
    let own = Channel::first(channels).filter(|_| channels > 1).map(Some);
    let logs = iter::once(None).chain(own);
    let facts = |channel| metadata(run, settings, channel, instance, host, roles);
    logs.map(|channel| Ok((channel, facts(channel)?))).collect()
}

/// The facts of the log of a flight, or of a channel's own.
pub fn metadata(
    run: &blackboards::Run,
    settings: &Settings,
    channel: Option<Channel>,
    instance: &str,
    host: &Host,
    roles: &BTreeMap<String, RoleSection>,
) -> Result<Facts, Failure> {
    let (pace, sample_time_ns) = (run.pace(), run.sample_time_ns);
    let wall_offset_ns = i128::from(run.t0_wall_ns) - i128::from(run.t0_ns);
    let own = settings.of_channel(channel.unwrap_or(Channel::A));
    let mut run = record(&[
        ("format", FORMAT),
        ("layout", &format!("{LAYOUT:016x}")),
        ("instance", instance),
        ("run_id", &run.run_id.to_string()),
        ("settings", &format!("{:016x}", run.settings)),
        (
            "clock",
            "CLOCK_MONOTONIC of the machine, in ns; plus wall_offset_ns it is ns since 1970",
        ),
        ("wall_offset_ns", &wall_offset_ns.to_string()),
        ("t0_ns", &run.t0_ns.to_string()),
        ("period_ns", &run.period_ns.to_string()),
        ("sample_time_ns", &run.sample_time_ns.to_string()),
        ("last_tick", &run.last_tick.to_string()),
    ]);
    run.extend(fields(&json!(build::executable())));
    if let Some(channel) = channel {
        run.insert(CHANNEL.to_owned(), channel.to_string());
    }
    let mut texts = record(&[
        ("settings.toml", &settings.commented()?),
        ("shared", &settings.shared_text()?),
    ]);
    if let Some(points) = &settings.points {
        texts.insert(POINTS.to_owned(), points.text.clone());
    }
    let laws = own
        .chosen_laws()?
        .into_iter()
        .flat_map(law_entries)
        .collect();
    let realtime = roles
        .iter()
        .map(|(role, section)| (role.clone(), granted(section)))
        .collect();
    let laws_flown = own.flown_laws()?;
    let faults = (1..).zip(settings.injected()?);
    let faults: Record = faults
        .map(|(n, fault)| (format!("{n}"), render::sentences::fault(&fault)))
        .collect();
    let mut records = vec![
        (RUN, run),
        (SETTINGS, texts),
        (LAWS, laws),
        (HOST, fields(&json!(host))),
        (REALTIME, realtime),
    ];
    if !faults.is_empty() {
        records.push((FAULTS, faults));
    }
    Ok(Facts {
        pace,
        sample_time_ns,
        plan: settings.log_plan(),
        signals: laws_flown.signals,
        no_theorem: laws_flown.without_theorem.map(no_theorem),
        records,
    })
}

/// The fields of a JSON object as texts.
fn fields(object: &Value) -> Record {
    let text = |value: &Value| match value {
        Value::String(text) => text.clone(),
        Value::Null => "unknown".into(),
        other => other.to_string(),
    };
    let fields = object.as_object().into_iter().flatten();
    fields
        .map(|(key, value)| (key.clone(), text(value)))
        .collect()
}

fn law_entries(law: Chosen) -> Vec<(String, String)> {
    let section = law.section(NotFinite::default(), Vec::new());
    let role = law.description().role;
    let entries = [
        ("name", Some(section.name)),
        ("version", Some(section.version)),
        ("file", section.file),
        ("sha256", section.sha256),
    ];
    let entry = |(key, text): (_, Option<String>)| Some((format!("{role}.{key}"), text?));
    entries.into_iter().filter_map(entry).collect()
}

/// Which real-time settings a process requested and got, one per line.
fn granted(section: &RoleSection) -> String {
    let mut text = section.scheduling.clone();
    for step in &section.realtime {
        let requested = step
            .asked
            .map(|value| format!(" {value}"))
            .unwrap_or_default();
        let refused = step
            .refused
            .as_ref()
            .map(|reason| format!("refused: {reason}"));
        let outcome = refused.unwrap_or_else(|| "granted".into());
        text.push_str(&format!("\n{}{requested}: {outcome}", step.step));
    }
    text
}
