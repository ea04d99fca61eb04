//! `ironbird laws`: lists the laws that can fly, and explains one.

pub mod trial;

use std::path::Path;

use clap::Args;
use control_api::description::{Description, Refused, Value};
use control_api::law::Rig;
use ironbird_law::abi::IRONBIRD_LAW_INTERFACE;
use messages::role::Role;
use plugin::Library;

use crate::laws::trial::watchdog::Watchdog;
use crate::laws::trial::{Candidate, words};
use crate::output::print;
use crate::settings::law_settings::{DEFAULT_PRESET, SECTIONS, known, nearest_first};
use errors::{Failure, GATE, OK};

/// Flags of `laws`.
#[derive(Clone, Debug, Args)]
pub struct LawsArgs {
    /// Explain this law: its settings, presets and telemetry; or the law of a file, as ./libmy.so.
    #[arg(value_name = "NAME|FILE")]
    pub name: Option<String>,
}

/// Prints the list, or what one law says of itself. The law of a file is also tried: code 3 where it fails.
///
/// # Errors
/// Usage: no law has the name; a file has no law; the law refuses its own defaults.
pub fn laws(args: &LawsArgs) -> Result<u8, Failure> {
    let all: Vec<&Description> = SECTIONS.iter().flat_map(|(_, role)| known(*role)).collect();
    let text = match &args.name {
        None => list(&all),
        Some(name) if plugin::is_file(name) => {
            let library = plugin::load(Path::new(name))?;
            print(&(explained(library.description) + &of_file(library)))?;
            return tried(library);
        }
        Some(name) => {
            let law = all.iter().find(|law| law.name == name).ok_or_else(|| {
                let names = all.iter().map(|law| law.name).collect();
                Failure::usage(format!(
                    "no law is named `{name}`; there are {}",
                    nearest_first(name, names)
                ))
                .help("`ironbird laws` lists them with their roles")
            })?;
            explained(law)
        }
    };
    print(&text)?;
    Ok(OK)
}

fn list(all: &[&Description]) -> String {
    let mut text = format!("{:<6} {:<12} what it is\n", "role", "law");
    for law in all {
        text += &format!(
            "{:<6} {:<12} {}\n{:<19} {}\n",
            law.role.to_string(),
            law.name,
            law.summary,
            "",
            law.source
        );
    }
    text + "fly one with --outer, --inner or --mixer NAME; `ironbird laws NAME` explains its settings\n"
}

fn explained(law: &Description) -> String {
    let mut text = format!("{}: {}\n", law.name, law.summary);
    text += &format!("  role       {}\n  version    {}\n", law.role, law.version);
    if !law.source.is_empty() {
        text += &format!("  source     {}\n", law.source);
    }
    text += &format!("\nSettings, in the section [{}]\n", law.role);
    if law.settings.is_empty() {
        text += "  none\n";
    }
    for setting in law.settings {
        let unit = if setting.unit.is_empty() {
            String::new()
        } else {
            format!(" [{}]", setting.unit)
        };
        text += &format!("  {} = {}{unit}\n", setting.name, shown(&setting.default()));
        text += &format!("    {}; allowed: {}\n", setting.meaning, setting.allowed());
    }
    for preset in law.presets {
        text += &format!("\nPreset {}\n", preset.name);
        if preset.values.is_empty() {
            text += "  the defaults\n";
        }
        for (name, value) in preset.values {
            text += &format!("  {name} = {}\n", shown(value));
        }
    }
    text += "\nTelemetry\n";
    if law.telemetry.is_empty() {
        text += "  none\n";
    }
    for signal in law.telemetry {
        let unit = if signal.unit.is_empty() {
            String::new()
        } else {
            format!(" [{}]", signal.unit)
        };
        text += &format!("  {}{unit}\n", signal.name);
    }
    text
}

fn of_file(library: &Library) -> String {
    let role = library.description.role;
    let time = if library.not_real_time {
        "not real-time: it promises nothing about its time"
    } else {
        "real-time"
    };
    format!(
        "\nFile\n  {}\n  SHA-256    {}\n  interface  version {IRONBIRD_LAW_INTERFACE}\n  time       {time}\n  \
         rehearsal  {}\nfly it with --{role} {}\n",
        library.file.display(),
        library.sha256,
        if library.is_rehearsed() {
            "yes"
        } else {
            "no: it has no copy_into"
        },
        library.file.display()
    )
}

/// Tries the law of a file with its defaults on the paper's airframe, and prints what was found.
fn tried(library: &'static Library) -> Result<u8, Failure> {
    let (rig, law) = (Rig::default(), library.description);
    let settings = law.preset(DEFAULT_PRESET).unwrap_or_default();
    let make = || match law.role {
        Role::Outer => library.outer(&rig, &settings).map(Candidate::Outer),
        Role::Mixer => library.mixer(&rig, &settings).map(Candidate::Mixer),
        _ => library.inner(&rig, &settings).map(Candidate::Inner),
    };
    let watchdog = Watchdog::start(law.name)?;
    let refused = |Refused(why)| {
        Failure::usage(format!(
            "the law `{}` refuses its own defaults: {why}",
            law.name
        ))
    };
    let findings = trial::trial(&rig, make, || watchdog.hear()).map_err(refused)?;
    let modes = library.modes_put_back();
    let said = modes.as_ref().map_or_else(
        || "left as they were".to_owned(),
        |what| format!("NO: {what}"),
    );
    print(&format!(
        "{}  modes        {said}\n",
        words::render(&findings, law, library.not_real_time)
    ))?;
    Ok(
        if findings.passes(library.not_real_time) && modes.is_none() {
            OK
        } else {
            GATE
        },
    )
}

/// A value as a settings file has it.
fn shown(value: &Value) -> String {
    match value {
        Value::Number(number) => toml::Value::from(*number).to_string(),
        Value::Three(numbers) => toml::Value::from(numbers.to_vec()).to_string(),
        Value::Word(word) => toml::Value::from(*word).to_string(),
    }
}
