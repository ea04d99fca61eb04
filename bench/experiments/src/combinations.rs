//! Combinations of laws: every outer law with every inner law and mixer.

use std::path::Path;

use analysis::comparison::Laws;
use messages::role::Role;
use messages::telemetry::LAW_ROLES;
use render::plot::LAWS;
use toml::Value;

use config::law_settings::{Chosen, DEFAULT_PRESET};
use config::{Overrides, Settings, overrides};
use errors::Failure;
use errors::output::say;

/// The laws of outer and inner loop and mixer, each with the settings of its own; none is the default law.
pub type Combination = [Option<String>; 3];

/// At most `most` combinations.
pub fn of(
    outer: &[String],
    inner: &[String],
    mixer: &[String],
    most: usize,
) -> Result<Vec<Combination>, Failure> {
    let mut all = vec![Combination::default()];
    for (place, role, names) in [
        (0, Role::Outer, outer),
        (2, Role::Mixer, mixer),
        (1, Role::Inner, inner),
    ] {
        let mut numbered = names.iter().enumerate();
        if let Some((_, twice)) = numbered.find(|(i, name)| names[..*i].contains(name)) {
            let what = format!("the {role} law `{twice}` is named twice");
            let help = "name each law once; `ironbird laws` lists those that";
            return Err(Failure::usage(what).help(format!("{help} --{role} can name")));
        }
        if !names.is_empty() {
            let with = |set: &Combination, name: &String| {
                let mut set = set.clone();
                set[place] = Some(name.clone());
                set
            };
            let sets = all.iter();
            let sets = sets.flat_map(|set| names.iter().map(move |name| with(set, name)));
            all = sets.collect();
        }
    }
    match all.len() {
        count if count <= most => Ok(all),
        more => Err(
            Failure::usage(format!("{more} combinations of laws: allowed are {most}"))
                .help("name fewer laws: every outer law is flown with every inner law and mixer"),
        ),
    }
}

/// As many as a page tells apart.
pub const PAGE_MAX: usize = LAWS.len();
/// As many as tables of plain text may have.
pub const TABLE_MAX: usize = 2 * PAGE_MAX;

/// The settings of each combination. Refuses combinations with the same name: two library files may hold laws of one name.
///
/// A combination none of whose laws has the preset of the flight flies its defaults, if another one has it.
pub fn resolve(
    config: Option<&Path>,
    overrides: &Overrides,
    combinations: &[Combination],
) -> Result<Vec<Settings>, Failure> {
    let mut seen: Vec<(Laws, &Combination)> = Vec::new();
    let (mut all, mut lacking) = (Vec::new(), Vec::new());
    for combination in combinations {
        let (settings, refused) = resolve_one(config, overrides, combination)?;
        let names = laws(&settings)?;
        if let Some((_, before)) = seen.iter().find(|(seen, _)| *seen == names) {
            let mut pairs = before.iter().zip(combination);
            let differing = pairs.find(|(before, it)| before != it);
            let [first, second] = differing.map_or([""; 2], |(first, second)| {
                [first, second].map(|law| law.as_deref().unwrap_or_default())
            });
            let name = names.name(true);
            return Err(Failure::usage(format!(
                "{first} and {second} have one name: both would be called {name}"
            ))
            .help("give one of the two laws another name"));
        }
        lacking.extend(refused.map(|refused| (names.name(false), refused)));
        seen.push((names, combination));
        all.push(settings);
    }
    if lacking.len() == all.len()
        && let Some((_, refused)) = lacking.pop()
    {
        return Err(refused);
    }
    for (name, _) in lacking {
        say(&format!(
            "note: {name} does not have the preset, and flies its defaults\n"
        ));
    }
    Ok(all)
}

/// Prints the warnings of all combinations, each once.
pub fn warn<'a>(all: impl IntoIterator<Item = &'a Settings>) -> Result<(), Failure> {
    let mut seen: Vec<String> = Vec::new();
    for settings in all {
        for warning in settings.warnings()? {
            if !seen.contains(&warning) {
                say(&format!("warning: {warning}\n"));
                seen.push(warning);
            }
        }
    }
    Ok(())
}

/// The preset that is flown by the combinations that have it.
pub fn preset(all: &[Settings]) -> &str {
    let mut presets = all.iter().map(|it| &*it.flight.preset);
    let preset = presets.find(|preset| *preset != DEFAULT_PRESET);
    preset.unwrap_or(DEFAULT_PRESET)
}

/// The settings of a combination; of one none of whose laws has the preset of the flight, those of its defaults, and why
/// that preset is refused.
fn resolve_one(
    config: Option<&Path>,
    overrides: &Overrides,
    combination: &Combination,
) -> Result<(Settings, Option<Failure>), Failure> {
    const PRESET: &str = "flight.preset";
    let mut overrides = overrides.clone();
    for (role, law) in LAW_ROLES.into_iter().zip(combination) {
        if let Some(law) = law {
            overrides.extend(overrides::law(role, law)?);
        }
    }
    let of_flag = overrides::value_of(&overrides, PRESET).cloned();
    let of_file = || Settings::in_file(config, "flight", "preset");
    let asked = of_flag.map_or_else(of_file, |preset| Ok(Some(preset)));
    let resolved = match (Settings::resolve(config, &overrides), asked) {
        (Err(refused), Ok(Some(Value::String(asked)))) => {
            overrides.push((PRESET, DEFAULT_PRESET.into()));
            let has = |law: &Chosen| law.description().preset(&asked).is_some();
            match Settings::resolve(config, &overrides) {
                Ok(settings) if !settings.chosen_laws()?.iter().any(has) => {
                    (settings, Some(refused))
                }
                _ => return Err(refused),
            }
        }
        (resolved, _) => (resolved?, None),
    };
    let (mut settings, refused) = resolved;
    settings.variants = combination.each_ref().map(|law| {
        let variant = law.as_deref().map(overrides::variant);
        variant.unwrap_or_default().to_owned()
    });
    Ok((settings, refused))
}

pub fn laws(settings: &Settings) -> Result<Laws, Failure> {
    let names = settings.laws()?.map(|law| law.name);
    let name = |i: usize| format!("{}{}", names[i], settings.variants[i]);
    Ok(Laws {
        outer: name(0),
        inner: name(1),
        mixer: name(2),
    })
}
