//! The description of a law as data, which one process reads from a library and others use.

use control_api::description::{Description, Preset, Setting, SettingKind, Signal};
use ironbird_law::abi::IronbirdValue;
use messages::role::Role;
use serde::{Deserialize, Serialize};

#[derive(Serialize, Deserialize)]
pub(crate) struct Answer {
    pub(crate) role: Role,
    /// Name, version, summary and source.
    pub(crate) texts: [String; 4],
    /// Name, unit, meaning and kind.
    pub(crate) settings: Vec<([String; 3], Kind)>,
    /// Name, and a value for each setting.
    pub(crate) presets: Vec<(String, Vec<PresetValue>)>,
    /// Name and unit.
    pub(crate) telemetry: Vec<[String; 2]>,
    pub(crate) not_real_time: bool,
    pub(crate) is_rehearsed: bool,
}

/// The numbers, and the index of the word, of an [`IronbirdValue`].
pub(crate) type PresetValue = ([f64; 3], u64);

/// The default with its bounds, or the words.
#[derive(Serialize, Deserialize)]
pub(crate) enum Kind {
    Number(f64, f64, f64),
    Three([f64; 3], f64, f64),
    Word(Vec<String>),
}

impl Answer {
    pub(crate) fn text(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The description, which is kept until the process ends. An error names a value that its setting does not allow.
    pub(crate) fn description(&self) -> Result<Description, String> {
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
        for (i, setting) in settings.iter().enumerate() {
            let (name, default, allowed) = (setting.name, setting.default(), setting.allowed());
            if !setting.allows(&default) {
                return Err(format!(
                    "its setting {i}, `{name}`: its default is {default:?}, and allowed is {allowed}"
                ));
            }
        }
        let mut presets = Vec::new();
        for (i, (name, given)) in self.presets.iter().enumerate() {
            let mut values = Vec::new();
            for (setting, &(number, word)) in settings.iter().zip(given) {
                let value = setting.from_abi(&IronbirdValue { number, word });
                if !setting.allows(&value) {
                    return Err(format!(
                        "its preset {i}, `{name}`: its {} is {value:?}: allowed is {}",
                        setting.name,
                        setting.allowed()
                    ));
                }
                values.push((setting.name, value));
            }
            presets.push(Preset {
                name: kept(name),
                values: values.leak(),
            });
        }
        let telemetry = self.telemetry.iter().map(|[name, unit]| Signal {
            name: kept(name),
            unit: kept(unit),
        });
        Ok(Description {
            name,
            role: self.role,
            version,
            summary,
            source,
            settings,
            presets: presets.leak(),
            suited: None,
            telemetry: telemetry.collect::<Vec<_>>().leak(),
        })
    }
}

impl Kind {
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
