//! `ironbird laws`: lists the laws that can fly, explains one, and tries the law of a file.

use std::path::Path;

use clap::Args;
use control_api::description::{Description, Refused, Value};
use control_api::law::Rig;
use ironbird_law::abi::IRONBIRD_LAW_INTERFACE;
use messages::role::Role;
use messages::telemetry::LAW_ROLES;
use plugin::Library;

use config::law_settings::{DEFAULT_PRESET, known, meant_or_known};
use errors::output::print;
use errors::{Failure, GATE, OK};
use plugin::trial::{self, ANSWER, BadAnswer, Candidate, Findings, HOT, INPUTS, Watchdog};
use render::document::{Table, row};

/// Flags of `laws`.
#[derive(Clone, Debug, Args)]
pub struct LawsArgs {
    /// Explain this law: its settings, presets and telemetry; or the law of a file, as ./libmy.so.
    #[arg(value_name = "NAME|FILE")]
    pub name: Option<String>,
}

/// Prints the list, or the description of one law. The law of a file is also tried: code 3 if it fails.
pub fn laws(args: &LawsArgs) -> Result<u8, Failure> {
    let all: Vec<&Description> = LAW_ROLES.into_iter().flat_map(known).collect();
    match &args.name {
        None => print(&list(&all))?,
        Some(name) if plugin::is_file(name) => {
            let library = plugin::load(Path::new(name))?;
            print(&(explanation(library.description) + &of_file(library)))?;
            return try_library(library);
        }
        Some(name) => {
            let law = all.iter().find(|law| law.name == name).ok_or_else(|| {
                let names: Vec<&str> = all.iter().map(|law| law.name).collect();
                let names = meant_or_known(name, &names);
                Failure::usage(format!("no law is named `{name}`{names}"))
                    .help("`ironbird laws` lists them with their roles")
            })?;
            print(&explanation(law))?;
        }
    }
    Ok(OK)
}

fn list(all: &[&Description]) -> String {
    let rows = all
        .iter()
        .map(|law| row([&law.role, &law.name, &law.summary]));
    Table::new(["role", "law", "what it is"], rows).list_within(80)
        + "fly one with --outer, --inner or --mixer NAME; `ironbird laws NAME` explains it\n"
}

fn explanation(law: &Description) -> String {
    let unit = |unit: &str| match unit {
        "" => String::new(),
        unit => format!(" [{unit}]"),
    };
    let or_none = |rows: String, none: &str| if rows.is_empty() { none.into() } else { rows };
    let (role, version) = (law.role, law.version);
    let mut text = format!(
        "{}: {}\n  role       {role}\n  version    {version}\n",
        law.name, law.summary
    );
    if !law.source.is_empty() {
        text += &format!("  source     {}\n", law.source);
    }
    let settings = law.settings.iter().map(|it| {
        let (name, default, unit) = (it.name, toml_text(&it.default()), unit(it.unit));
        let (meaning, allowed) = (it.meaning, it.allowed());
        format!("  {name} = {default}{unit}\n    {meaning}; allowed: {allowed}\n")
    });
    text += &format!("\nSettings, in the section [{role}]\n");
    text += &or_none(settings.collect(), "  none\n");
    for preset in law.presets {
        let values = preset.values.iter();
        let values = values.map(|(name, value)| format!("  {name} = {}\n", toml_text(value)));
        text += &format!("\nPreset {}\n", preset.name);
        text += &or_none(values.collect(), "  the defaults\n");
    }
    let signals = law.telemetry.iter();
    let signals = signals.map(|signal| format!("  {}{}\n", signal.name, unit(signal.unit)));
    text + "\nTelemetry\n" + &or_none(signals.collect(), "  none\n")
}

fn toml_text(value: &Value) -> String {
    match value {
        Value::Number(number) => toml::Value::from(*number),
        Value::Three(numbers) => toml::Value::from(numbers.to_vec()),
        Value::Word(word) => toml::Value::from(*word),
    }
    .to_string()
}

fn of_file(library: &Library) -> String {
    let (role, sha256) = (library.description.role, &library.sha256);
    let file = library.file.display();
    let time = match library.not_real_time {
        true => "not real-time: it promises nothing about its time",
        false => "real-time",
    };
    let warm_up = match (library.not_real_time, library.is_rehearsed) {
        (true, _) => "no: it is not real-time",
        (false, true) => "yes",
        (false, false) => "no: it has no copy_into",
    };
    format!(
        "\nFile\n  {file}\n  SHA-256    {sha256}\n  interface  version {IRONBIRD_LAW_INTERFACE}\n  time       {time}\n  \
         warm-up    {warm_up}\nfly it with --{role} {file}\n"
    )
}

/// Tries the law of a file with its defaults on the paper's airframe, and prints the findings.
fn try_library(library: &'static Library) -> Result<u8, Failure> {
    let (rig, law) = (Rig::default(), library.description);
    let settings = law.preset(DEFAULT_PRESET).unwrap_or_default();
    let make = || match law.role {
        Role::Outer => library.outer(&rig, &settings).map(Candidate::Outer),
        Role::Mixer => library.mixer(&rig, &settings).map(Candidate::Mixer),
        _ => library.inner(&rig, &settings).map(Candidate::Inner),
    };
    let watchdog = Watchdog::start(law.name)?;
    let findings = trial::trial(&rig, make, || watchdog.feed());
    let findings = findings.map_err(|Refused(why)| {
        let name = law.name;
        Failure::usage(format!("the law `{name}` refuses its own defaults: {why}"))
    })?;
    let changed = library.changed_modes_warning();
    let modes = match &changed {
        None => "left as they were".to_owned(),
        Some(what) => format!("NO: {what}"),
    };
    let text = findings_text(&findings, law, library.not_real_time);
    print(&format!("{text}  modes        {modes}\n"))?;
    let passes = findings.passes(library.not_real_time) && changed.is_none();
    Ok(if passes { OK } else { GATE })
}

pub fn findings_text(findings: &Findings, law: &Description, not_real_time: bool) -> String {
    let place = |bad: &BadAnswer| {
        let BadAnswer { input, index, .. } = *bad;
        format!("{} of input {input}", number_name(law, index))
    };
    let same = findings.difference.map(|bad| {
        let (place, [one, other]) = (place(&bad), bad.values);
        format!("NO: {place} was {one:?} and then {other:?}; it cannot be replayed")
    });
    let continued = |bad: Option<BadAnswer>, why: &str, cannot: Option<&str>| match (bad, cannot) {
        (Some(bad), _) => {
            let (place, [one, other]) = (place(&bad), bad.values);
            format!("NO: {place} was {one:?}, and {other:?} {why}")
        }
        (None, Some(cannot)) => cannot.to_owned(),
        (None, None) if findings.difference.is_some() => "not tried".to_owned(),
        (None, None) => "yes".to_owned(),
    };
    let why = "in or after a warm-up; a copy must be equal, and have memory of its own";
    let cannot = (!findings.is_copied).then_some("it is not: it cannot be copied");
    let warm_up = continued(findings.rehearsed, why, cannot);
    let why = "from its saved state; save and load all that changes in flight";
    let cannot = match (findings.is_saved, findings.is_loaded) {
        (true, true) => None,
        (true, false) => Some("NO: it does not load the state that it saved"),
        _ => Some("it is not: it cannot be saved, nor reintegrated after a restart"),
    };
    let restored = continued(findings.restored, why, cannot);
    let finite = findings.not_finite.map(|bad| {
        let (place, value) = (place(&bad), bad.values[0]);
        format!("NO: {place} was {value}; the rig does not fly such an answer")
    });
    let [same, finite] = [same, finite].map(|bad| bad.unwrap_or_else(|| "yes".into()));
    let us = |ns: u64| format!("{:.2} us", ns as f64 / 1e3);
    let [median, p99] = findings.hot_ns.map(us);
    let cold = us(findings.cold_ns);
    let used = |count: u64| match (count, not_real_time) {
        (0, _) => "none".to_owned(),
        (count, true) => format!("{count} in {HOT} ticks"),
        (count, false) => format!("NO: {count} in {HOT} ticks; each can make a tick late"),
    };
    let usage = &findings.usage;
    let uncounted = "- (a build with `--features instrumented` counts them)";
    let allocations = usage.counted_allocations().map_or(uncounted.into(), used);
    let page_faults = used(usage.minor_faults + usage.major_faults);
    format!(
        "\nTrial: {INPUTS} inputs drawn at random, then {HOT} ticks of hover\n  same twice   {same}\n  warm-up      \
         {warm_up}\n  restored     {restored}\n  finite       {finite}\n  warm caches  a tick takes {median} in the median, {p99} at the 99th \
         percentile\n  cold caches  {cold} in the median\n  allocations  {allocations}\n  page faults  {page_faults}\n"
    )
}

fn number_name(law: &Description, index: usize) -> String {
    const AXES: [&str; 3] = ["x", "y", "z"];
    const ANGLES: [&str; 3] = ["roll", "pitch", "yaw"];
    let quantities = [
        "attitude_rad",
        "attitude_rate_rad_s",
        "attitude_acceleration_rad_s2",
    ];
    match (law.role, index) {
        (_, ANSWER..) => match law.telemetry.get(index - ANSWER) {
            Some(signal) => signal.name.to_owned(),
            None => format!("telemetry {}", index - ANSWER),
        },
        (Role::Mixer, 4) => "saturated".to_owned(),
        (Role::Mixer, rotor) => format!("speed_rad_s of rotor {}", rotor + 1),
        (_, 0) => "thrust_n".to_owned(),
        (Role::Inner, i) => format!("torque_b_nm about {}", AXES[(i - 1) % 3]),
        (_, i) => format!("{} of {}", quantities[(i - 1) / 3 % 3], ANGLES[(i - 1) % 3]),
    }
}
