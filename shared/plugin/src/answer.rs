//! The description of a law as data, which one process reads from a library and others use.

use control_api::description::{Description, Preset, Setting, SettingKind, Signal};
use ironbird_law::abi::{IronbirdLaw, IronbirdValue};
use messages::role::Role;
use serde::{Deserialize, Serialize};

#[derive(Serialize, Deserialize)]
pub(crate) struct Answer {
    role: Role,
    /// Name, version, summary and source.
    texts: [String; 4],
    /// Name, unit, meaning and kind.
    settings: Vec<([String; 3], Kind)>,
    /// Name, and a value for each setting.
    presets: Vec<(String, Vec<PresetValue>)>,
    /// Name and unit.
    telemetry: Vec<[String; 2]>,
    pub(crate) not_real_time: bool,
    pub(crate) is_rehearsed: bool,
}

/// The numbers, and the index of the word, of an [`IronbirdValue`].
type PresetValue = ([f64; 3], u64);

/// The default with its bounds, or the words.
#[derive(Serialize, Deserialize)]
enum Kind {
    Number(f64, f64, f64),
    Three([f64; 3], f64, f64),
    Word(Vec<String>),
}

impl Answer {
    pub(crate) fn of(table: &IronbirdLaw, law: &Description) -> Self {
        let owned = |texts: [&str; 3]| texts.map(str::to_owned);
        Self {
            role: law.role,
            texts: [law.name, law.version, law.summary, law.source].map(str::to_owned),
            settings: law
                .settings
                .iter()
                .map(|it| (owned([it.name, it.unit, it.meaning]), Kind::of(&it.kind)))
                .collect(),
            presets: law
                .presets
                .iter()
                .map(|preset| {
                    let values = law.settings.iter().zip(preset.values);
                    let values = values.map(|(setting, (_, value))| setting.to_abi(value));
                    let values = values.map(|value| (value.number, value.word));
                    (preset.name.to_owned(), values.collect())
                })
                .collect(),
            telemetry: law
                .telemetry
                .iter()
                .map(|it| [it.name, it.unit].map(str::to_owned))
                .collect(),
            not_real_time: table.not_real_time != 0,
            is_rehearsed: table.copy_into.is_some(),
        }
    }

    pub(crate) fn text(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The description. It is kept until the process ends.
    pub(crate) fn description(&self) -> Description {
        let [name, version, summary, source] = self.texts.each_ref().map(|it| kept(it));
        let settings = self
            .settings
            .iter()
            .map(|([name, unit, meaning], kind)| Setting {
                name: kept(name),
                unit: kept(unit),
                meaning: kept(meaning),
                kind: kind.setting_kind(),
            });
        let settings: &'static [Setting] = settings.collect::<Vec<_>>().leak();
        let presets = self.presets.iter().map(|(name, values)| {
            let values = settings
                .iter()
                .zip(values)
                .map(|(setting, &(number, word))| {
                    (
                        setting.name,
                        setting.from_abi(&IronbirdValue { number, word }),
                    )
                });
            Preset {
                name: kept(name),
                values: values.collect::<Vec<_>>().leak(),
            }
        });
        let telemetry = self.telemetry.iter().map(|[name, unit]| Signal {
            name: kept(name),
            unit: kept(unit),
        });
        Description {
            name,
            role: self.role,
            version,
            summary,
            source,
            settings,
            presets: presets.collect::<Vec<_>>().leak(),
            suited: None,
            telemetry: telemetry.collect::<Vec<_>>().leak(),
        }
    }
}

impl Kind {
    fn of(kind: &SettingKind) -> Self {
        match *kind {
            SettingKind::Number { default, min, max } => Self::Number(default, min, max),
            SettingKind::Three { default, min, max } => Self::Three(default, min, max),
            SettingKind::Word(words) => {
                Self::Word(words.iter().map(|it| (*it).to_owned()).collect())
            }
        }
    }

    fn setting_kind(&self) -> SettingKind {
        match *self {
            Self::Number(default, min, max) => SettingKind::Number { default, min, max },
            Self::Three(default, min, max) => SettingKind::Three { default, min, max },
            Self::Word(ref words) => {
                SettingKind::Word(words.iter().map(|it| kept(it)).collect::<Vec<_>>().leak())
            }
        }
    }
}

fn kept(text: &str) -> &'static str {
    text.to_owned().leak()
}
