//! What each process of a flight takes from the settings.

use std::collections::BTreeMap;

use control_api::description::{self, Description};
use control_api::{GuardedInner, GuardedMixer, GuardedOuter, Rig};
use controller::TheoremMonitor;
use messages::parameters::{Airframe, Parameter, ParameterError};
use messages::role::Role;
use messages::telemetry::Signals;
use toml::Table;

use super::airframe::built;
use super::law_settings::Chosen;
use super::validation::refused;
use super::{Settings, law_settings};
use errors::Failure;
use report::laws::FlownLaws;

impl Settings {
    /// The true airframe at tick 0.
    pub fn airframe(&self) -> Result<Airframe, Failure> {
        self.airframe_of("plant", &self.plant)
    }

    pub fn plant(&self) -> Result<plant::PlantSettings, Failure> {
        Ok(plant::PlantSettings {
            period_s: self.flight.period_s,
            airframe: self.airframe()?,
            rotor: self.rotor,
            seed: self.flight.seed,
            initial: (&self.initial).into(),
            ground: self.ground.plane(self.flight.ground_z_m),
            tilt_max_rad: self.flight.tilt_max_rad,
        })
    }

    /// What the laws are told of the rig.
    pub fn rig(&self) -> Result<Rig, Failure> {
        let airframe = self.airframe_of("model", &self.model)?;
        Ok(Rig {
            period_s: self.flight.period_s,
            airframe,
            rotor: self.rotor,
        })
    }

    pub(crate) fn law_sections(&self) -> [(Role, &Table); 3] {
        [
            (Role::Outer, &self.outer),
            (Role::Inner, &self.inner),
            (Role::Mixer, &self.mixer),
        ]
    }

    /// The law of a role, with its settings.
    ///
    /// # Errors
    /// A usage [`Failure`] names the law, its file or its setting, and what is allowed.
    pub(super) fn chosen(&self, role: Role) -> Result<(Chosen, description::Settings), Failure> {
        let section = match role {
            Role::Outer => &self.outer,
            Role::Mixer => &self.mixer,
            _ => &self.inner,
        };
        law_settings::chosen(role, section, &self.moved)
    }

    /// The chosen laws: outer, inner, mixer.
    pub fn chosen_laws(&self) -> Result<[Chosen; 3], Failure> {
        Ok([
            self.chosen(Role::Outer)?.0,
            self.chosen(Role::Inner)?.0,
            self.chosen(Role::Mixer)?.0,
        ])
    }

    /// What the chosen laws say of themselves: outer, inner, mixer.
    ///
    /// # Errors
    /// A usage [`Failure`] names the law, its file or its setting, and what is allowed.
    pub fn laws(&self) -> Result<[&'static Description; 3], Failure> {
        Ok(self.chosen_laws()?.map(Chosen::description))
    }

    /// The options that choose the laws, of those that fly only when they are asked for.
    pub fn law_options(&self) -> Result<String, Failure> {
        let asked = |law: &Chosen| {
            let law = law.description();
            law_settings::known(law.role)
                .first()
                .is_some_and(|first| first.name != law.name)
        };
        let option = |law: Chosen| format!("--{} {}", law.description().role, law.named());
        let options = self.chosen_laws()?.into_iter().filter(asked).map(option);
        Ok(options.collect::<Vec<_>>().join(" "))
    }

    /// The outer loop before tick 0.
    pub fn outer_stage(&self) -> Result<GuardedOuter, Failure> {
        let (rig, (law, settings)) = (self.rig()?, self.chosen(Role::Outer)?);
        let made = match law {
            Chosen::BuiltIn(law) => {
                law_settings::entry(controller::laws::OUTER, law).make(&rig, &settings)
            }
            Chosen::Library(library) => library.outer(&rig, &settings),
        };
        Ok(GuardedOuter::new(
            made.map_err(refused)?,
            self.course()?.route(rig.period_s),
            &rig,
        ))
    }

    /// The inner loop before tick 0.
    pub fn inner_stage(&self) -> Result<GuardedInner, Failure> {
        let (rig, (law, settings)) = (self.rig()?, self.chosen(Role::Inner)?);
        let made = match law {
            Chosen::BuiltIn(law) => {
                law_settings::entry(controller::laws::INNER, law).make(&rig, &settings)
            }
            Chosen::Library(library) => library.inner(&rig, &settings),
        };
        Ok(GuardedInner::new(made.map_err(refused)?, &rig))
    }

    pub fn mixer_stage(&self) -> Result<GuardedMixer, Failure> {
        let (rig, (law, settings)) = (self.rig()?, self.chosen(Role::Mixer)?);
        let made = match law {
            Chosen::BuiltIn(law) => law_settings::entry(mixer::LAWS, law).make(&rig, &settings),
            Chosen::Library(library) => library.mixer(&rig, &settings),
        };
        Ok(GuardedMixer::new(made.map_err(refused)?, &rig))
    }

    /// Whether the law of a role can be made. That of a file is made by those alone who fly it: its code is not run
    /// where it is not needed.
    pub(super) fn check_law(&self, role: Role, makes: &[Role]) -> Result<(), Failure> {
        if self.chosen(role)?.0.library().is_some() && !makes.contains(&role) {
            return Ok(());
        }
        match role {
            Role::Outer => self.outer_stage().map(drop),
            Role::Mixer => self.mixer_stage().map(drop),
            _ => self.inner_stage().map(drop),
        }
    }

    /// Whether a law is that of a file.
    pub(crate) fn has_own_laws(&self) -> Result<bool, Failure> {
        let chosen = self.law_sections().map(|(role, _)| self.chosen(role));
        let mut has = false;
        for law in chosen {
            has |= law?.0.library().is_some();
        }
        Ok(has)
    }

    /// The theorem's monitor before tick 0; none where the chosen inner law, with its settings, has no theorem.
    pub fn theorem(&self) -> Result<Option<TheoremMonitor>, Failure> {
        let (law, settings) = self.chosen(Role::Inner)?;
        let rig = self.rig()?;
        Ok(controller::laws::theorem(law.description().name, &settings)
            .map(|gains| TheoremMonitor::new(&rig, &gains)))
    }

    /// The name of the chosen inner law where it, with its settings, has no theorem, and so no estimates.
    pub fn law_without_theorem(&self) -> Result<Option<&'static str>, Failure> {
        let (law, settings) = self.chosen(Role::Inner)?;
        Ok(law_settings::without_theorem(law.description(), &settings))
    }

    /// What the report knows of the chosen laws.
    pub fn flown_laws(&self) -> Result<FlownLaws, Failure> {
        let [outer, inner, mixer] = self.laws()?.map(|law| law.telemetry);
        Ok(FlownLaws {
            signals: Signals {
                outer,
                inner,
                mixer,
            },
            without_theorem: self.law_without_theorem()?,
        })
    }

    /// The airframe that was built, with the values of a section.
    fn airframe_of(
        &self,
        section: &str,
        values: &BTreeMap<String, f64>,
    ) -> Result<Airframe, Failure> {
        let refused = |section: &str, e: ParameterError| {
            Failure::usage(format!("{section}.{e}")).help(format!(
                "see `ironbird params --airframe {}`",
                self.flight.airframe
            ))
        };
        let mut airframe = built(&self.airframe).map_err(|e| refused("airframe", e))?;
        for (name, value) in values {
            Parameter::from_name(name)
                .and_then(|parameter| airframe.set(parameter, *value))
                .map_err(|e| refused(section, e))?;
        }
        Ok(airframe)
    }
}
