//! What each process of a flight takes from the settings, and what is warned of before take-off.

use std::collections::BTreeMap;

use control_api::description::{self, Description, Refused};
use control_api::registry::{Entry, Made};
use control_api::{GuardedInner, GuardedMixer, GuardedOuter, Rig};
use controller::feasibility::{Start, excesses};
use controller::{Limits, TheoremMonitor, motor_lag};
use host::{Machine, cpu_list};
use messages::blackboards::LOCKSTEP;
use messages::parameters::{Airframe, Parameter, ParameterError};
use messages::realtime::{LONGEST_LEAD_NS, LeadSetting, RealtimeMode, RealtimeSettings};
use messages::role::{Channel, MOST_CHANNELS, Replica, Role};
use messages::telemetry::{LAW_ROLES, Signals};
use plant::command_hold::waiting_ticks;
use plugin::Library;
use redundancy::{Arrangement, SimplexLimits};
use toml::{Table, Value};

use super::airframe::{OWN, PAPER, built};
use super::airframe_checks::{implausible, impossible_body};
use super::law_settings::{self, Chosen, LAW};
use super::settings::{PaceName, Settings};
use super::trajectory::PointsFile;
use super::validation::refused;
use analysis::laws::FlownLaws;
use analysis::phrase::count;
use analysis::theorem::SEVERAL_LAWS;
use errors::Failure;

impl Settings {
    /// The true airframe at tick 0.
    pub fn airframe(&self) -> Result<Airframe, Failure> {
        self.airframe_of("plant", &self.plant.parameters)
    }

    pub fn plant(&self) -> Result<plant::PlantSettings, Failure> {
        Ok(plant::PlantSettings {
            period_s: self.flight.period_s,
            substeps: self.plant.substeps,
            airframe: self.airframe()?,
            rotor: self.rotor,
            seed: self.flight.seed,
            initial: self.initial,
            ground: self.ground.plane(self.flight.ground_z_m),
            tilt_max_rad: self.flight.tilt_max_rad,
            follows_targets: self.course()?.follows_targets(),
        })
    }

    /// What the laws know of the rig.
    pub fn rig(&self) -> Result<Rig, Failure> {
        Ok(Rig {
            period_s: self.flight.period_s,
            airframe: self.airframe_of("model", &self.model)?,
            rotor: self.rotor,
        })
    }

    /// The flag with which `ironbird params` lists this airframe.
    pub(super) fn airframe_flag(&self) -> String {
        match self.flight.airframe.as_str() {
            PAPER | OWN => String::new(),
            other => format!(" --airframe {other}"),
        }
    }

    /// The airframe that was built, with the values of a section.
    fn airframe_of(
        &self,
        section: &str,
        values: &BTreeMap<String, f64>,
    ) -> Result<Airframe, Failure> {
        let mut airframe = self.as_built()?;
        for (name, value) in values {
            Parameter::from_name(name)
                .and_then(|parameter| airframe.set(parameter, *value))
                .map_err(|e| self.refused_parameter(section, e))?;
        }
        Ok(airframe)
    }

    fn refused_parameter(&self, section: &str, e: ParameterError) -> Failure {
        let help = format!("see `ironbird params{}`", self.airframe_flag());
        Failure::usage(format!("{section}.{e}")).help(help)
    }

    /// The airframe as it was built.
    pub fn as_built(&self) -> Result<Airframe, Failure> {
        built(&self.airframe).map_err(|e| self.refused_parameter("airframe", e))
    }

    pub fn law_sections(&self) -> [(Role, &Table); 3] {
        LAW_ROLES.map(|role| (role, self.section(role)))
    }

    fn section(&self, role: Role) -> &Table {
        match role {
            Role::Outer => &self.outer,
            Role::Mixer => &self.mixer,
            _ => &self.inner,
        }
    }

    /// The name of a role's law, or its file.
    pub fn law_name(&self, role: Role) -> &str {
        let name = self.section(role).get(LAW).and_then(Value::as_str);
        name.unwrap_or_default()
    }

    /// The laws of single channels: of which channel and role, and their sections.
    pub fn channel_laws(&self) -> impl Iterator<Item = (Channel, Role, &Table)> {
        let laws = self.channel.iter();
        laws.flat_map(|(channel, laws)| laws.iter().map(|(role, law)| (*channel, *role, law)))
    }

    /// Their names, those from files with the file, by stage, such as `b.inner`.
    pub fn named_channel_laws(&self) -> Result<BTreeMap<String, String>, Failure> {
        let named = |(channel, role, _): (Channel, Role, _)| {
            let law = self.of_channel(channel).chosen(role)?.0;
            Ok((format!("{channel}.{role}"), law.named()))
        };
        self.channel_laws().map(named).collect()
    }

    /// The sections of a channel's laws: outer, inner, mixer.
    fn sections_of(&self, channel: Channel) -> [&Table; 3] {
        let own = self.channel.get(&channel);
        let of = |(role, shared)| own.and_then(|laws| laws.get(&role)).unwrap_or(shared);
        self.law_sections().map(of)
    }

    /// The settings as the processes of a channel take them: with its laws.
    pub fn of_channel(&self, channel: Channel) -> Self {
        let [outer, inner, mixer] = self.sections_of(channel).map(Table::clone);
        Self {
            outer,
            inner,
            mixer,
            group: Some(self.groups()[channel as usize]),
            ..self.clone()
        }
    }

    /// Of each channel, the first one that flies the same laws.
    pub fn groups(&self) -> [Channel; MOST_CHANNELS] {
        Channel::ALL.map(|channel| {
            let is_like = |it: &Channel| self.sections_of(*it) == self.sections_of(channel);
            Channel::ALL.into_iter().find(is_like).unwrap_or(channel)
        })
    }

    pub fn arrangement(&self) -> Arrangement {
        Arrangement {
            groups: self.groups(),
            ..Arrangement::alike(self.rt.channels)
        }
    }

    /// Ticks for which a command can wait in the plant.
    pub fn waiting_ticks(&self) -> u64 {
        waiting_ticks(self.flight.period_s) as u64
    }

    pub fn has_several_laws(&self) -> bool {
        self.groups() != [Channel::A; MOST_CHANNELS]
    }

    pub(super) fn chosen(&self, role: Role) -> Result<(Chosen, description::Settings), Failure> {
        law_settings::chosen(role, self.section(role), &self.moved)
    }

    /// The chosen laws: outer, inner, mixer.
    pub fn chosen_laws(&self) -> Result<[Chosen; 3], Failure> {
        Ok([
            self.chosen(Role::Outer)?.0,
            self.chosen(Role::Inner)?.0,
            self.chosen(Role::Mixer)?.0,
        ])
    }

    /// Whether no law is that of a file, which may have memory that flights share, or another program.
    pub fn has_built_in_laws(&self) -> Result<bool, Failure> {
        let is_built_in =
            |law: &Chosen| law.library().is_none() && !firmware::is_program(law.description().name);
        Ok(self.chosen_laws()?.iter().all(is_built_in))
    }

    pub fn laws(&self) -> Result<[&'static Description; 3], Failure> {
        Ok(self.chosen_laws()?.map(Chosen::description))
    }

    /// The options that choose the laws other than the default ones.
    pub fn law_options(&self) -> Result<String, Failure> {
        let is_requested = |law: &Chosen| {
            let law = law.description();
            law_settings::known(law.role)[0].name != law.name
        };
        let option = |law: Chosen| format!("--{} {}", law.description().role, law.named());
        let laws = self.chosen_laws()?.into_iter();
        let options: Vec<String> = laws.filter(is_requested).map(option).collect();
        Ok(options.join(" "))
    }

    /// The rig, and the law of a role for it: one of these, or that of a library.
    fn law<L: ?Sized + 'static>(
        &self,
        role: Role,
        built_in: &[&'static [Entry<L>]],
        of_library: impl Fn(&'static Library, &Rig, &description::Settings) -> Result<Made<L>, Refused>,
    ) -> Result<(Rig, Made<L>), Failure> {
        let (rig, (law, settings)) = (self.rig()?, self.chosen(role)?);
        let made = match law {
            Chosen::BuiltIn(law) => law_settings::entry(built_in, law).make(&rig, &settings),
            Chosen::Library(library) => of_library(library, &rig, &settings),
        };
        Ok((rig, made.map_err(refused)?))
    }

    pub fn outer_stage(&self) -> Result<GuardedOuter, Failure> {
        let (rig, law) = self.law(Role::Outer, &[controller::laws::OUTER], Library::outer)?;
        let route = self.course()?.route(rig.period_s);
        Ok(GuardedOuter::new(law, route, &rig).in_group(self.group.unwrap_or(Channel::A)))
    }

    pub fn inner_stage(&self) -> Result<GuardedInner, Failure> {
        let built_in = [controller::laws::INNER, firmware::LAWS];
        let (rig, law) = self.law(Role::Inner, &built_in, Library::inner)?;
        Ok(GuardedInner::new(law, &rig).in_group(self.group.unwrap_or(Channel::A)))
    }

    pub fn mixer_stage(&self) -> Result<GuardedMixer, Failure> {
        let (rig, law) = self.law(Role::Mixer, &[mixer::LAWS], Library::mixer)?;
        Ok(GuardedMixer::new(law, &rig))
    }

    /// Where a channel with other laws takes over.
    pub fn simplex_limits(&self) -> Option<SimplexLimits> {
        let simplex = &self.simplex;
        simplex.enabled.then_some(SimplexLimits {
            tilt_max_rad: simplex.tilt_max_rad,
            rate_max_rad_s: simplex.rate_max_rad_s,
            error_max_m: simplex.error_max_m,
            command_step_max_rad_s: simplex.command_step_max_rad_s,
        })
    }

    /// Checks whether the law of a role can be created. A law of a file is asked, if `asks`.
    pub(super) fn check_law(&self, role: Role, asks: bool) -> Result<(), Failure> {
        let made = || match role {
            Role::Outer => self.outer_stage().map(drop),
            Role::Mixer => self.mixer_stage().map(drop),
            _ => self.inner_stage().map(drop),
        };
        match self.chosen(role)?.0.library() {
            None => made(),
            Some(_) if !asks => Ok(()),
            Some(law) => {
                let answer = || made().map(|()| String::new());
                plugin::ask(&format!("the {}", law.words), answer).map(drop)
            }
        }
    }

    /// The theorem's monitor before tick 0; none if the chosen inner law, with its settings, has no theorem, or if it is not
    /// the only one.
    pub fn theorem(&self) -> Result<Option<TheoremMonitor>, Failure> {
        if self.has_several_laws() {
            return Ok(None);
        }
        let (law, settings) = self.chosen(Role::Inner)?;
        let rig = self.rig()?;
        Ok(controller::laws::theorem(law.description().name, &settings)
            .map(|gains| TheoremMonitor::new(&rig, &gains)))
    }

    /// The name of the chosen inner law if it, with its settings, has no theorem, and so no estimates.
    pub fn law_without_theorem(&self) -> Result<Option<&'static str>, Failure> {
        Ok(self.flown_laws()?.without_theorem)
    }

    pub fn flown_laws(&self) -> Result<FlownLaws, Failure> {
        let (inner, settings) = self.chosen(Role::Inner)?;
        let (outer, mixer) = (self.chosen(Role::Outer)?.0, self.chosen(Role::Mixer)?.0);
        let [outer, inner, mixer] = [outer, inner, mixer].map(Chosen::description);
        let theorem = controller::laws::theorem(inner.name, &settings);
        let without_theorem = match self.has_several_laws() {
            true => Some(SEVERAL_LAWS),
            false => theorem.is_none().then_some(inner.name),
        };
        Ok(FlownLaws {
            signals: Signals {
                outer: outer.telemetry,
                inner: inner.telemetry,
                mixer: mixer.telemetry,
            },
            without_theorem,
        })
    }

    /// What to request from the system.
    pub fn realtime(&self) -> Result<RealtimeSettings, Failure> {
        let lead = self.lead()?;
        let cpu = match &self.rt.cpu {
            Value::String(auto) if auto == "auto" => None,
            Value::Integer(cpu) if (0..1024).contains(cpu) => usize::try_from(*cpu).ok(),
            other => {
                return Err(Failure::usage(format!(
                    "rt.cpu = {other}: allowed are a processor's number and \"auto\""
                ))
                .help("`taskset -p $$` shows the processors that this shell may use"));
            }
        };
        let settings = RealtimeSettings {
            mode: self.rt.mode,
            priority: self.rt.priority,
            cpu,
            loop_cpus: self.rt.loop_cpus,
            channels: self.rt.channels,
            groups: self.groups(),
            channel_cpus: match self.rt.channels {
                1 => 1,
                _ => self.rt.channel_cpus,
            },
            lead,
            rehearse: self.rt.rehearse,
        };
        self.check_channels(&settings)?;
        Ok(match self.flight.pace {
            // In slow motion nothing is gained by an early wake-up.
            PaceName::Realtime if self.flight.slowdown > 1 => RealtimeSettings {
                loop_cpus: 1,
                ..settings
            },
            PaceName::Realtime => settings,
            // A SCHED_FIFO process that never sleeps is throttled by the kernel, and starves the others on its processor.
            PaceName::Lockstep => RealtimeSettings {
                mode: RealtimeMode::Off,
                cpu: None,
                loop_cpus: 1,
                channel_cpus: 1,
                lead: LeadSetting::Fixed(0),
                rehearse: false,
                ..settings
            },
        })
    }

    /// Refuses slow motion with ticks so long that processes do not see the end of the flight in time, or with a firmware.
    pub fn check_slow_motion(&self) -> Result<(), Failure> {
        const LONGEST_TICK_S: f64 = 1.0;
        let slowdown = self.flight.slowdown;
        if slowdown == 1 || self.flight.pace == PaceName::Lockstep {
            return Ok(());
        }
        let tick_s = self.flight.period_s * slowdown as f64;
        if tick_s > LONGEST_TICK_S {
            return Err(Failure::usage(format!(
                "flight.slowdown = {slowdown}: a tick would take {tick_s} s, allowed are up to {LONGEST_TICK_S} s"
            ))
            .help("processes look for the end of the flight once a tick; lower flight.slowdown"));
        }
        let of_channels = self
            .channel
            .keys()
            .map(|channel| self.of_channel(*channel).laws());
        for laws in std::iter::once(self.laws()).chain(of_channels) {
            let inner = laws?[1].name;
            if firmware::is_program(inner) {
                return Err(Failure::usage(format!(
                    "flight.slowdown = {slowdown}: slow motion is not supported with a firmware, and `{inner}` is one"
                ))
                .help("leave it out"));
            }
        }
        Ok(())
    }

    fn check_channels(&self, settings: &RealtimeSettings) -> Result<(), Failure> {
        let channels = settings.channels;
        let loop_cpus = settings.loop_cpus;
        let refused = |what: String, help: &str| Err(Failure::usage(what).help(help));
        let of_channel = |channel: Channel| (channel as usize >= channels).then_some(channel);
        if let Some(channel) = self.channel.keys().copied().find_map(of_channel) {
            return refused(
                format!(
                    "channel.{channel}: the flight has {}",
                    count(channels as u64, "channel")
                ),
                "fly with more: --channels 2 has channels a and b, --channels 3 also c",
            );
        }
        if self.simplex.enabled && !self.has_several_laws() {
            return refused(
                "simplex.enabled = true: all channels fly the same laws".into(),
                "name another one for a channel: --channels 2 --channel b:inner=pid",
            );
        }
        if channels == 1 {
            return Ok(());
        }
        if loop_cpus > 1 {
            return refused(
                format!(
                    "rt.channels = {channels} and rt.loop_cpus = {loop_cpus}: redundant channels keep to one processor each"
                ),
                "leave out --loop-cpus; --channel-cpus 2 flies channels b and c on another processor",
            );
        }
        let lowest = Replica::new(Role::Outer, Channel::ALL[channels - 1]);
        if settings.priority + lowest.priority_step(settings.channel_cpus) < 1 {
            return refused(
                format!(
                    "rt.priority = {}: {channels} channels need {} priorities below it",
                    settings.priority,
                    -lowest.priority_step(settings.channel_cpus)
                ),
                "80 is the default",
            );
        }
        Ok(())
    }

    fn lead(&self) -> Result<LeadSetting, Failure> {
        let tick_ns = match self.wall_period_ns() {
            LOCKSTEP => self.sample_time_ns(),
            period_ns => period_ns,
        };
        let most_us = (tick_ns / 2).min(LONGEST_LEAD_NS) / 1000;
        match &self.rt.lead_us {
            Value::String(auto) if auto == "auto" => Ok(LeadSetting::Auto),
            Value::Integer(us) if us.cast_unsigned() <= most_us => {
                Ok(LeadSetting::Fixed(us.cast_unsigned() * 1000))
            }
            other => Err(Failure::usage(format!(
                "rt.lead_us = {other}: allowed are \"auto\" and whole microseconds from 0 (at the tick) to {most_us}: half \
                 a period, and at most {} ms",
                LONGEST_LEAD_NS / 1_000_000
            ))
            .help("`ironbird fly --print-config` explains every setting")),
        }
    }

    /// Checks whether this process may use the processor that is named for the loops, and as many as they are to share.
    pub fn check_cpu(&self) -> Result<(), Failure> {
        if let Some(Ok(cpu)) = self.rt.cpu.as_integer().map(usize::try_from) {
            check_cpu(&format!("rt.cpu = {cpu}"), cpu)?;
        }
        let realtime = self.realtime()?;
        let Some(list) = allowed_processors() else {
            return Ok(());
        };
        for (key, wanted, flag) in [
            ("loop_cpus", realtime.loop_cpus, "--loop-cpus 1"),
            ("channel_cpus", realtime.channel_cpus, "--channel-cpus 1"),
        ] {
            if cpu_list(&list).len() < wanted {
                return Err(Failure::usage(format!(
                    "rt.{key} = {wanted}: this process may use the processors {list} alone"
                ))
                .help(format!("fly on fewer processors: {flag}")));
            }
        }
        Ok(())
    }

    /// Demands of the flight beyond its limits, gains that do not suit the airframe's motors, and what the user has to start.
    pub fn warnings(&self) -> Result<Vec<String>, Failure> {
        let rig = self.rig()?;
        let name = self.trajectory_name();
        let start = Start {
            position_w_m: self.initial.position_w_m,
            yaw_rad: self.initial.attitude_rad[2],
            ground_z_m: self.flight.ground_z_m,
        };
        let duration_s = self.flight.duration_s;
        let course = self.course()?;
        // The plant keeps the targets of a ground station within limits.
        let excesses = match course.follows_targets() {
            true => Vec::new(),
            false => excesses(&course, &rig, self.limits()?, &start, duration_s),
        };
        let excesses = excesses.iter().map(|it| format!("trajectory {name} {it}"));
        let built = rig.airframe.as_built();
        let mut warnings = implausible(&built, &rig.rotor);
        let body = impossible_body(&self.airframe()?);
        warnings.extend(body.map(|why| format!("the airframe at tick 0 is flown as it is: {why}")));
        let points = self.points.iter().flat_map(PointsFile::warnings);
        warnings.extend(points.map(|it| format!("trajectory {name} {it}")));
        warnings.extend(excesses);
        warnings.extend(self.motor_lag(&rig)?);
        let (law, settings) = self.chosen(Role::Inner)?;
        warnings.extend(firmware::to_start(law.description().name, &settings));
        Ok(warnings)
    }

    /// How long no process may come further at a start [s].
    pub fn start_timeout_s(&self) -> Result<f64, Failure> {
        let (law, settings) = self.chosen(Role::Inner)?;
        let program_s = firmware::start_limit_s(law.description().name, &settings);
        Ok(self.rt.start_timeout_s + program_s)
    }

    /// The active limits of the thrust acceleration, and the role whose law has them. An inner law that has some
    /// overrides the outer one.
    fn limits(&self) -> Result<Option<(Role, Limits)>, Failure> {
        for role in [Role::Inner, Role::Outer] {
            let (law, settings) = self.chosen(role)?;
            if let Some(limits) = Limits::of(law.description(), &settings) {
                return Ok(Some((role, limits)));
            }
        }
        Ok(None)
    }

    /// Warnings of loops that do not suit the motors.
    fn motor_lag(&self, rig: &Rig) -> Result<Vec<String>, Failure> {
        let [inner, outer] = [self.chosen(Role::Inner)?, self.chosen(Role::Outer)?];
        let built_s = rig.airframe.motor_time_constant_s();
        let lag_s = self.airframe()?.motor_time_constant_s();
        Ok(motor_lag::warnings(
            (inner.0.description(), &inner.1),
            (outer.0.description(), &outer.1),
            built_s,
            lag_s,
        ))
    }
}

/// Checks whether this process may use a processor that the user names as `named`.
pub fn check_cpu(named: &str, cpu: usize) -> Result<(), Failure> {
    match allowed_processors() {
        Some(list) if !cpu_list(&list).contains(&cpu) => Err(Failure::usage(format!(
            "{named}: this process may use the processors {list}"
        ))
        .help("name one of them with --cpu N, or none: the highest-numbered one is taken")),
        _ => Ok(()),
    }
}

fn allowed_processors() -> Option<String> {
    Machine::files().field("/proc/self/status", "Cpus_allowed_list")
}
