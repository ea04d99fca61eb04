//! The control laws of a flight: their signals, and outputs that could not be used.

use crate::phrase::count;
use crate::schema::{LawSection, RoleSection, RunSection, SignalSection};
use crate::series::Statistics;
use crate::speed::Speed;
use controller::laws::may_have_theorem;
use messages::content::{Mode, Wrench};
use messages::parameters::{ESTIMATED, Parameter};
use messages::role::Role;
use messages::telemetry::{LAW_ROLES, RATE_ERROR, Signal, Signals, TELEMETRY, Telemetry};
use std::collections::BTreeMap;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FlownLaws {
    pub signals: Signals,
    /// The inner law, where it has no theorem with its settings, and so no estimates.
    pub without_theorem: Option<&'static str>,
}

/// Where what a law shows of a vector stands in its telemetry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Places([usize; 3]);

impl Places {
    pub fn of(&self, wrench: &Wrench) -> [f64; 3] {
        self.0.map(|place| wrench.telemetry.value[place])
    }
}

impl FlownLaws {
    /// Where the rate error of the inner law is [rad/s]; none where it shows none.
    pub fn rate_error(&self) -> Option<Places> {
        self.signals.places(Role::Inner, RATE_ERROR).map(Places)
    }

    /// Where its estimates of I_R [kg m^2], k_r [N m s], delta [rad/s^2] are; none where it estimates nothing.
    pub fn estimates(&self) -> Option<Places> {
        let names = ESTIMATED.map(Parameter::name);
        let places = self.signals.places(Role::Inner, names);
        places
            .filter(|_| self.without_theorem.is_none())
            .map(Places)
    }
}

/// Why the theorem says nothing of a flight with this inner law.
pub fn no_theorem(law: &str) -> String {
    let settings = may_have_theorem(law).then_some(" with its settings");
    format!(
        "the inner law `{law}` has no theorem{}",
        settings.unwrap_or_default()
    )
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NotFinite {
    ticks: u64,
    first: Option<u64>,
}

impl NotFinite {
    pub fn take(&mut self, tick: u64, mode: u64) {
        if mode == Mode::NotFinite as u64 {
            self.ticks += 1;
            self.first.get_or_insert(tick);
        }
    }

    pub fn section(self, name: &str, telemetry: Vec<SignalSection>) -> LawSection {
        LawSection {
            name: name.into(),
            ticks_not_finite: self.ticks,
            first_not_finite: self.first,
            telemetry,
            ..LawSection::default()
        }
    }
}

impl LawSection {
    pub fn named(&self) -> String {
        let name = format!("`{}`", self.name);
        match self.file_name() {
            Some(file) => format!("{name} ({file})"),
            None => name,
        }
    }

    pub fn file_name(&self) -> Option<&str> {
        self.file.as_deref()?.rsplit('/').next()
    }

    /// What is said of answers that could not be used, where there were some.
    pub fn not_finite(&self, role: &str) -> Option<String> {
        let (first, ticks) = (self.first_not_finite?, count(self.ticks_not_finite, "tick"));
        Some(format!(
            "{role} law {} gave a number that is not finite, or beyond any airframe, in {ticks}, first at tick {first}",
            self.named()
        ))
    }
}

pub fn in_order(
    laws: &BTreeMap<String, LawSection>,
) -> impl Iterator<Item = (&'static str, &LawSection)> {
    LAW_ROLES
        .into_iter()
        .filter_map(|role| Some((role.name(), laws.get(role.name())?)))
}

/// What laws did that no law should, a sentence each: of every law its answers that could not be used; of one of a
/// file also its time, its allocations and its page faults.
pub fn sentences(
    run: &RunSection,
    series: &[Statistics],
    roles: &BTreeMap<String, RoleSection>,
) -> Vec<String> {
    let of = |(role, law): (&String, &LawSection)| {
        let mut said = Vec::from_iter(law.not_finite(role));
        if law.file.is_some() {
            let name = format!("compute.{role}");
            let computed = series.iter().find(|series| series.name == name);
            let too_long = computed.and_then(|computed| too_long(run, computed));
            let unsteady = roles.get(role).map(|section| unsteady(role, section));
            let all = too_long.into_iter().chain(unsteady.into_iter().flatten());
            said.extend(all.map(|what| format!("{role} law {} {what}", law.named())));
        }
        said
    };
    run.laws.iter().flat_map(of).collect()
}

/// Whether a stage computed for longer than a tick, in more than a hundredth of its ticks: a host's stalls are rarer.
fn too_long(run: &RunSection, computed: &Statistics) -> Option<String> {
    let tick_us = run.wall_period_us;
    let is_on_the_clock = run.speed() != Speed::Lockstep;
    (is_on_the_clock && computed.p99_us > tick_us).then(|| {
        format!(
            "took longer than a tick of {tick_us} us: {:.1} us in the median, {:.1} us at the most",
            computed.p50_us, computed.max_us
        )
    })
}

/// What the process of a law did in flight that costs time of nobody's choosing.
fn unsteady(name: &str, role: &RoleSection) -> Vec<String> {
    let Some(usage) = &role.usage else {
        return Vec::new();
    };
    let mut said = Vec::new();
    // The middleware lends one message a tick, and the mixer's last word.
    let last_word = u64::from(name == Role::Mixer.name());
    let lent = role.ticks_run.saturating_add(last_word);
    let own = usage.allocations.map_or(0, |all| all.saturating_sub(lent));
    if own > 0 {
        let calls = count(own, "call");
        said.push(format!(
            "allocated memory in flight: {calls} beside the middleware's one a tick"
        ));
    }
    let is_granted = |name: &str| {
        let mut steps = role.realtime.iter();
        steps.any(|step| step.step == name && step.granted)
    };
    let is_locked = is_granted("memory_lock") && is_granted("prefault");
    let faults = usage.minor_faults.saturating_add(usage.major_faults);
    if is_locked && faults > 0 {
        let faults = count(faults, "page fault");
        said.push(format!("met memory that was not there: {faults} in flight"));
    }
    said
}

#[derive(Clone, Copy, Debug)]
pub struct SignalStatistics {
    signals: &'static [Signal],
    /// Newest, smallest and largest value of each; NaN of one that is not known.
    seen: [[f64; 3]; TELEMETRY],
}

impl SignalStatistics {
    pub const fn new(signals: &'static [Signal]) -> Self {
        Self {
            signals,
            seen: [[f64::NAN; 3]; TELEMETRY],
        }
    }

    /// Takes what it shows of a tick: numbers alone.
    pub fn take(&mut self, telemetry: &Telemetry) {
        for ([last, min, max], (_, value)) in self.seen.iter_mut().zip(telemetry.of(self.signals)) {
            if value.is_finite() {
                (*last, *min, *max) = (value, min.min(value), max.max(value));
            }
        }
    }

    pub fn section(&self) -> Vec<SignalSection> {
        let section = |(signal, [last, min, max]): (&Signal, [f64; 3])| SignalSection {
            name: signal.name.into(),
            unit: signal.unit.into(),
            last: Some(last).filter(|it| it.is_finite()),
            min: Some(min).filter(|it| it.is_finite()),
            max: Some(max).filter(|it| it.is_finite()),
        };
        self.signals.iter().zip(self.seen).map(section).collect()
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::sample::Sample;

    fn law(file: Option<&str>) -> LawSection {
        LawSection {
            name: "x".into(),
            file: file.map(str::to_owned),
            ..LawSection::default()
        }
    }

    #[test]
    fn only_what_a_law_of_a_file_did_itself_is_said_of_it() {
        let mut sample = Sample::good();
        let usage = |allocations: u64, minor_faults: u64| {
            let usage = json!({ "major_faults": 0, "voluntary_switches": 0, "involuntary_switches": 0,
                "cpu_per_tick_us": 1.0, "allocations": allocations, "minor_faults": minor_faults });
            serde_json::from_value(usage).unwrap()
        };
        let steps = ["memory_lock", "prefault"]
            .map(|step| json!({ "step": step, "asked": null, "granted": true, "refused": null }));
        for (name, role) in &mut sample.roles {
            role.usage = usage(20_000 + u64::from(name == "mixer"), 0);
            role.realtime = serde_json::from_value(json!(steps)).unwrap();
        }
        let of_files =
            ["outer", "inner", "mixer"].map(|role| (role.into(), law(Some("/a/libx.so"))));
        sample.run.laws = of_files.into();
        let computed = Statistics {
            name: "compute.inner".into(),
            p99_us: 1000.0,
            ..sample.series[0].clone()
        };
        sample.series.push(computed);
        let said =
            |sample: &Sample| sentences(&sample.run, &sample.series, &sample.roles).join("\n");
        assert_eq!(said(&sample), "");
        sample.roles.get_mut("inner").unwrap().usage = usage(20_002, 3);
        sample.series.last_mut().unwrap().p99_us = 1000.1;
        let all = said(&sample);
        assert_eq!(all.matches("inner law `x` (libx.so) ").count(), 3, "{all}");
        for part in [
            "took longer than a tick of 1000 us",
            "in flight: 2 calls beside",
            "not there: 3 page faults",
        ] {
            assert!(all.contains(part), "{all}");
        }
        sample.run.wall_period_us = 0.0;
        assert!(
            !said(&sample).contains("took longer"),
            "in lockstep nobody waits"
        );
        sample.roles.get_mut("inner").unwrap().realtime[0].granted = false;
        assert!(
            !said(&sample).contains("page fault"),
            "the memory was not locked"
        );
        sample.run.laws = [("inner".to_owned(), law(None))].into();
        assert_eq!(said(&sample), "", "ours are held by tests");
    }

    #[test]
    fn a_law_without_numbers_is_counted_and_named() {
        let mut inner = NotFinite::default();
        for (tick, mode) in [
            (3, Mode::Fresh),
            (4, Mode::NotFinite),
            (5, Mode::Held),
            (9, Mode::NotFinite),
        ] {
            inner.take(tick, mode as u64);
        }
        let outer = NotFinite::default().section("pd", Vec::new());
        let sections = [("outer", outer), ("inner", inner.section("x", Vec::new()))];
        let mut sample = Sample::good();
        sample.run.laws = sections.map(|(role, law)| (role.to_owned(), law)).into();
        assert_eq!(
            crate::render::flight::laws(&sample.run.laws),
            "outer pd, inner x"
        );
        let said = sentences(&sample.run, &sample.series, &sample.roles).join("\n");
        assert!(
            said.starts_with("inner law `x` gave") && !said.contains('\n'),
            "{said}"
        );
        assert!(said.ends_with("in 2 ticks, first at tick 4"), "{said}");
    }

    const SIGNALS: [Signal; 3] = {
        const fn signal(name: &'static str, unit: &'static str) -> Signal {
            Signal { name, unit }
        }
        [
            signal("mass_kg", "kg"),
            signal("limited", ""),
            signal("never", ""),
        ]
    };

    #[test]
    fn what_was_not_known_is_no_number_of_the_flight() {
        let mut statistics = SignalStatistics::new(&SIGNALS);
        for mass_kg in [0.5, 0.7, 0.6] {
            let mut telemetry = Telemetry::unknown(3);
            telemetry.value[..2].copy_from_slice(&[mass_kg, 1.0]);
            statistics.take(&telemetry);
        }
        statistics.take(&Telemetry::unknown(3));
        let section = statistics.section();
        let numbers = section
            .iter()
            .map(|signal| [signal.last, signal.min, signal.max]);
        let expected = [[Some(0.6), Some(0.5), Some(0.7)], [Some(1.0); 3], [None; 3]];
        assert!(numbers.eq(expected), "{section:?}");
        assert_eq!((&*section[0].name, &*section[0].unit), ("mass_kg", "kg"));
    }
}
