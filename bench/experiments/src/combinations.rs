//! Combinations of laws: every outer law with every inner law and mixer.

use std::path::Path;

use analysis::comparison::Laws;
use messages::role::Role;
use render::plot::LAWS;
use toml::Value;

use config::{Overrides, Settings};
use errors::Failure;

/// At most `most` combinations.
pub fn of(
    outer: &[String],
    inner: &[String],
    mixer: &[String],
    most: usize,
) -> Result<Vec<Overrides>, Failure> {
    let mut all = vec![Overrides::new()];
    for (role, key, names) in [
        (Role::Outer, "outer.law", outer),
        (Role::Mixer, "mixer.law", mixer),
        (Role::Inner, "inner.law", inner),
    ] {
        let mut numbered = names.iter().enumerate();
        if let Some((_, twice)) = numbered.find(|(i, name)| names[..*i].contains(name)) {
            let what = format!("the {role} law `{twice}` is named twice");
            let help = "name each law once; `ironbird laws` lists those that";
            return Err(Failure::usage(what).help(format!("{help} --{role} can name")));
        }
        if !names.is_empty() {
            let with = |set: &Overrides, name: &String| {
                [set.clone(), vec![(key, Value::from(name.clone()))]].concat()
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
pub fn resolve(
    config: Option<&Path>,
    overrides: &Overrides,
    combinations: &[Overrides],
) -> Result<Vec<Settings>, Failure> {
    let mut seen: Vec<([&str; 3], &Overrides)> = Vec::new();
    let mut all = Vec::new();
    for laws in combinations {
        let settings = Settings::resolve(config, &[&overrides[..], laws].concat())?;
        let names = settings.laws()?.map(|law| law.name);
        if let Some((_, before)) = seen.iter().find(|(seen, _)| *seen == names) {
            let differing = before.iter().zip(laws).find(|(before, it)| before != it);
            let [first, second] = differing.map_or([""; 2], |((_, first), (_, second))| {
                [first, second].map(|law| law.as_str().unwrap_or_default())
            });
            let [outer, inner, mixer] = names;
            return Err(Failure::usage(format!(
                "{first} and {second} have one name: both would be called {outer} + {inner} + {mixer}"
            ))
            .help("give one of the two laws another name"));
        }
        seen.push((names, laws));
        all.push(settings);
    }
    Ok(all)
}

pub fn laws(settings: &Settings) -> Result<Laws, Failure> {
    let [outer, inner, mixer] = settings.laws()?.map(|law| law.name.to_owned());
    Ok(Laws {
        outer,
        inner,
        mixer,
    })
}
