//! The theorem on a flight: the monitor's counts, the verdict, and (18) in words.
//!
//! docs/theorem.md explains how to read it.

use crate::phrase::{count, list, surrounded};
use crate::schema::sum;
use controller::FlightMonitor;
use controller::assumptions::EXCUSES;
use controller::excitation::EXCITING;
use controller::innovation::Innovation;
use controller::laws::may_have_theorem;
use messages::monitor::{CAUSES, Cause, Monitor, TorqueCounts};
use messages::parameters::{Airframe, ESTIMATED};
use serde::ser::SerializeStruct as _;
use serde::{Deserialize, Serialize, Serializer};
use std::collections::BTreeMap;

/// Share of a parameter's size, or of what its estimate was off by first, within which it counts as found.
pub const FOUND: f64 = 0.01;

/// Share of the steps in which a bound may hold an estimate back without a warning: it does while the estimates learn.
const AT_BOUND: f64 = 0.1;
/// Ticks at the start of a flight whose torque is that of no command.
const FIRST_TICKS: u64 = 2;
/// Share of the sample that the estimates may leave unexplained.
const UNEXPLAINED: f64 = 0.02;

/// Name of no cause among the largest rises; the last in the alphabet of causes.
pub const NO_CAUSE: &str = "none";

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Theorem {
    /// Whether no step was unexplained, the estimates moved as predicted, and the torque was that of (19).
    pub holds: bool,
    /// The inner law, where it has no theorem with its settings.
    pub law_without: Option<String>,
    /// Ticks with a wrench.
    pub ticks: u64,
    pub ticks_checked: u64,
    /// Steps at which every assumption of V_th held, so that a rise has no excuse.
    pub ticks_judged: u64,
    /// Watched ticks that were not judged, by the causes in force; several may be in one tick.
    pub unjudged: BTreeMap<String, u64>,
    /// Wrenches that were not judged, because a message before them was lost, or another process took over.
    pub ticks_unwatched: u64,
    /// Steps at which V_th rose, or changed by other than the step owes, by cause.
    pub violations: BTreeMap<String, u64>,
    /// Largest rise of V_th in a step, by the cause in force, or `none`.
    pub largest_rise: BTreeMap<String, Rise>,
    /// V_th at the start, or after a parameter change where that is more [rad^2/s^2].
    pub v_th_start: f64,
    /// V_th at the end [rad^2/s^2].
    pub v_th_end: f64,
    /// Fall of V_th over all steps without a cause [rad^2/s^2].
    pub descent: f64,
    /// The same as the theorem predicts it [rad^2/s^2].
    pub descent_predicted: f64,
    /// Whether the estimates moved as predicted, where something was.
    pub is_live: bool,
    /// Largest excess of a step over what it owes, as a share of what rounding is allowed.
    pub step_excess_max: f64,
    pub steps_adapted: u64,
    /// Steps at which V, with the rate error, changed by more than its bound, by cause; not judged.
    pub v_above_bound: BTreeMap<String, u64>,
    pub rate_error_max_rad_s: f64,
    /// Rate error at the end [rad/s].
    pub rate_error_final_rad_s: f64,
    /// Root mean square of the rate error over the last second or so [rad/s].
    pub rate_error_rms_rad_s: f64,
    pub torque: Torque,
    /// Ticks whose command in force could not be met.
    pub ticks_saturated: u64,
    pub ticks_stale: u64,
    /// Changes of the true value of an estimated parameter; a ramp is one.
    pub live_swaps: u64,
    pub estimates: Vec<Watched>,
    /// Excitation of the worst direction in the last window of at most 10 s, e-folds of the error.
    pub excitation: f64,
    pub excitation_least: f64,
    pub innovation: InnovationSection,
    /// Assumptions that did not hold since the start, or since the last parameter change: no bound is proven under them.
    pub broken: Vec<String>,
    /// Whether (18) held: every estimate was found.
    pub converged: bool,
    pub convergence: String,
}

impl Theorem {
    /// Why it says nothing of a flight whose inner law has no theorem.
    pub fn inapplicable(&self) -> Option<String> {
        self.law_without.as_deref().map(no_theorem)
    }

    pub fn unexplained(&self) -> u64 {
        let unexplained = self.violations.get(Cause::Unexplained.name());
        unexplained.copied().unwrap_or(0)
    }

    /// In how many ticks V_th could be judged, and how often it rose.
    pub fn counts(&self) -> String {
        let ticks = count(self.ticks, "tick");
        let unjudged = surrounded(" (", &list(listed(&self.unjudged)), ")");
        let mut counts = format!("V_th judged in {} of {ticks}{unjudged}", self.ticks_judged);
        if self.ticks_unwatched > 0 {
            let unwatched = self.ticks_unwatched;
            let why = "a message was lost, or another process took over";
            counts += &format!(", {unwatched} not watched ({why})");
        }
        counts += &match self.rises() {
            0 => "; it rose in none".to_owned(),
            rises => format!(
                "; violated in {rises}, {} of them unexplained",
                self.unexplained()
            ),
        };
        for (name, steps) in &self.innovation.steps_at_bound {
            if *steps as f64 > AT_BOUND * self.ticks_checked as f64 {
                counts += &format!("; {name} at its bound in {}", count(*steps, "step"));
            }
        }
        counts
    }

    /// Steps at which V_th rose, or fell by less than the step owes.
    pub fn rises(&self) -> u64 {
        sum(&self.violations)
    }

    /// Whether V_th could be judged, or the torque of (19) acted, in so few ticks that nothing good is said of it.
    pub fn is_hardly_judged(&self) -> bool {
        let is_hardly_judged = self.ticks > 0 && self.ticks_judged < self.ticks / 2;
        is_hardly_judged || self.torque.hardly_acted(self.ticks)
    }

    /// In how many ticks the torque of (19) acted, and why not in the others.
    pub fn torque(&self) -> String {
        self.torque.says(self.ticks)
    }

    pub fn summary(&self) -> String {
        let live = match self.is_live {
            true => "live",
            false => "do not move as predicted",
        };
        let torque = match self.torque.unexplained() {
            0 => "",
            _ => ", the torque is not that of (19)",
        };
        format!(
            "{} unexplained, estimates {live}{torque}",
            self.unexplained()
        )
    }

    /// Writes the section; of a law without a theorem, why there is none.
    pub fn serialize_applicable<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let (Some(law), Some(why)) = (&self.law_without, self.inapplicable()) else {
            return self.serialize(serializer);
        };
        let mut section = serializer.serialize_struct("Theorem", 2)?;
        section.serialize_field("law_without", law)?;
        section.serialize_field("not_applicable", &why)?;
        section.end()
    }
}

/// The inner law's name, in place of one, of a flight whose channels fly different laws.
pub const SEVERAL_LAWS: &str = "several laws";

/// Why the theorem says nothing of a flight with this inner law.
pub fn no_theorem(law: &str) -> String {
    if law == SEVERAL_LAWS {
        return "the channels fly different laws".into();
    }
    let settings = may_have_theorem(law).then_some(" with its settings");
    format!(
        "the inner law `{law}` has no theorem{}",
        settings.unwrap_or_default()
    )
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Rise {
    /// In a step [rad^2/s^2].
    pub absolute: f64,
    pub relative: f64,
}

/// The torque of (19): how often the law computed it, and how often it acted.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Torque {
    /// Wrenches that were compared with (19) of their inputs, and those that differ.
    pub wrenches: u64,
    pub wrenches_wrong: u64,
    /// Ticks whose rotors were compared with the wrench of their command, and those with another torque, by cause.
    pub rotors: u64,
    pub rotors_wrong: BTreeMap<String, u64>,
}

impl Torque {
    fn of(counts: &TorqueCounts) -> Self {
        Self {
            wrenches: counts.wrenches,
            wrenches_wrong: counts.wrenches_wrong,
            rotors: counts.rotors,
            rotors_wrong: by_cause(&counts.rotors_wrong),
        }
    }

    /// Wrenches that are not (19), and ticks whose rotors gave another torque without a cause.
    pub fn unexplained(&self) -> u64 {
        let rotors = self.rotors_wrong.get(Cause::Unexplained.name());
        let rotors = rotors.copied().unwrap_or(0);
        self.wrenches_wrong.saturating_add(rotors)
    }

    /// Ticks whose rotors gave the torque of (19).
    pub fn acted(&self) -> u64 {
        self.rotors.saturating_sub(sum(&self.rotors_wrong))
    }

    /// Whether the torque of (19) acted, or a wrench was compared with it, in less than half of the ticks.
    fn hardly_acted(&self, ticks: u64) -> bool {
        // No command is in force in the first ticks.
        let least = (ticks / 2).saturating_sub(FIRST_TICKS).max(1);
        self.acted().min(self.wrenches) < least
    }

    /// In how many ticks the torque of (19) acted, and why not in the others.
    fn says(&self, ticks: u64) -> String {
        if self.rotors == 0 {
            return "no torque was compared with (19)".into();
        }
        let mut causes = listed(&self.rotors_wrong);
        let unknown = ticks.saturating_sub(self.rotors);
        if unknown > FIRST_TICKS {
            causes.push(format!("not compared in {unknown} more"));
        }
        let (acted, rotors) = (self.acted(), count(self.rotors, "tick"));
        let causes = surrounded(" (", &list(causes), ")");
        let mut says = format!("the torque of (19) acted in {acted} of {rotors}{causes}");
        if self.wrenches < ticks / 2 {
            let wrenches = count(self.wrenches, "wrench message");
            says += &format!("; only {wrenches} could be compared with (19)");
        }
        if self.wrenches_wrong > 0 {
            let wrenches = count(self.wrenches, "wrench message");
            says += &format!("; {} of {wrenches} are not (19)", self.wrenches_wrong);
        }
        says
    }
}

/// What shows without ground truth whether the estimates explain the flight.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct InnovationSection {
    /// |Y - X th_hat|, what the estimates leave unexplained: root mean square over the last second or so [rad/s^2].
    pub rms_rad_s2: f64,
    /// |Y|, what there was to explain [rad/s^2].
    pub sample_rms_rad_s2: f64,
    /// Correlation of the unfiltered innovation with that of the step before: noise has none, a missing cause has.
    pub correlation: f64,
    pub says: ResidualCause,
    /// Steps in which a bound held an estimate back, where there are any.
    pub steps_at_bound: BTreeMap<String, u64>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ResidualCause {
    #[default]
    NotKnown,
    /// Less than 2 % of the sample is left.
    Explained,
    /// What is left is noise.
    Noise,
    /// What is left has a cause: the estimates still learn, or the model lacks it.
    MissingCause,
}

impl InnovationSection {
    fn of(innovation: &Innovation, at_bound_before: [u64; 3]) -> Self {
        /// Correlation from which on the innovation is no noise.
        const LASTING: f64 = 0.5;
        let names = ESTIMATED.map(|parameter| parameter.name().to_owned());
        let (rms, sample) = (innovation.rms_rad_s2(), innovation.sample_rms_rad_s2());
        let correlation = innovation.correlation();
        Self {
            rms_rad_s2: rms,
            sample_rms_rad_s2: sample,
            correlation: correlation.unwrap_or(0.0),
            says: match rms / sample {
                share if share.is_nan() => ResidualCause::NotKnown,
                ..UNEXPLAINED => ResidualCause::Explained,
                _ => match correlation {
                    None => ResidualCause::NotKnown,
                    Some(..LASTING) => ResidualCause::Noise,
                    Some(_) => ResidualCause::MissingCause,
                },
            },
            steps_at_bound: names
                .into_iter()
                .zip(innovation.steps_at_bound.iter().zip(at_bound_before))
                .map(|(name, (steps, before))| (name, steps + before))
                .filter(|(_, steps)| *steps > 0)
                .collect(),
        }
    }
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Watched {
    pub name: String,
    pub actual: f64,
    pub error: f64,
    /// Size of the error at the start, or after the last parameter change.
    pub error_start: f64,
    /// Its upper bound by the theorem, for the exact model; valid only where [`Theorem::broken`] is empty.
    pub error_bound: f64,
    /// How much rounding and the trapezoidal rule may add to the bound.
    #[serde(default)]
    pub error_allowed: f64,
    /// Excitation of this parameter alone in the last window of at most 10 s, e-folds of the error.
    pub identifiability: f64,
    /// Whether it is within 1 % ([`FOUND`]).
    pub found: bool,
}

/// Follows topic `theorem` through a flight, and through restarts of the inner loop.
#[derive(Clone, Copy, Debug, Default)]
pub struct TheoremStatistics {
    ended: Option<Monitor>,
    /// Start of the present one, and what its monitor said last.
    newest: Option<(u64, Monitor)>,
    theta: [f64; 3],
    /// True values at the wrench that was watched last.
    theta_watched: [f64; 3],
    error_allowed: [f64; 3],
    /// Steps in which a bound held back an estimate, by monitors that have ended.
    at_bound_before: [u64; 3],
    /// Values that the airframe was built with, if it is not the nominal one: an estimate of a parameter that is 0 is held
    /// against them.
    built: Option<[f64; 3]>,
    /// Broken assumptions since the bounds began, as the sum of [`Cause::bit`].
    broken: u64,
    ticks: u64,
    judged: u64,
    unjudged: [u64; CAUSES],
    /// Wrenches that nothing was said of.
    pub unwatched: u64,
    innovation: Innovation,
    rate_error_rad_s: f64,
    /// From the monitor itself: its messages average from 0 on, which is too little in the first second.
    rate_error_rms_rad_s: Option<f64>,
    /// The inner law, where it has no theorem.
    law_without: Option<&'static str>,
}

/// Causes under which the theorem gives the estimates no bound. A parameter change is none: the bound begins anew with it.
const UNBOUNDED: [Cause; 4] = {
    use Cause::*;
    [OutOfBounds, BrokenModel, GyroNoise, MotorLag]
};

impl TheoremStatistics {
    pub fn set_airframe(&mut self, airframe: &Airframe) {
        let built = |parameter| airframe.as_built().get(parameter).abs();
        self.built = Some(ESTIMATED.map(built));
    }

    pub fn truth(&mut self, theta: [f64; 3]) {
        self.theta = theta;
    }

    /// Follows an inner law without a theorem.
    pub fn does_not_apply(&mut self, law: &'static str) {
        self.law_without = Some(law);
    }

    pub const fn applies(&self) -> bool {
        self.law_without.is_none()
    }

    /// Counts a wrench that nothing is said of.
    pub fn count_unwatched(&mut self) {
        self.ticks += 1;
        self.unwatched += 1;
    }

    /// Takes from the monitor what its messages do not have.
    pub fn monitored(&mut self, monitor: &FlightMonitor) {
        let innovation = monitor.innovation();
        for (i, before) in self.at_bound_before.iter_mut().enumerate() {
            // A monitor that begins anew counts from 0.
            if innovation.steps_at_bound[i] < self.innovation.steps_at_bound[i] {
                *before += self.innovation.steps_at_bound[i];
            }
        }
        self.innovation = innovation;
        self.error_allowed = monitor.error_allowed();
        self.rate_error_rad_s = monitor.rate_error_rad_s().unwrap_or(self.rate_error_rad_s);
        self.rate_error_rms_rad_s = monitor.rate_error_rms_rad_s();
    }

    /// Takes what is said of a wrench; `epoch` tells one start of the inner loop from the next.
    pub fn take(&mut self, epoch: u64, monitor: &Monitor) {
        let checked = match &self.newest {
            None => 0,
            Some((known, last)) if *known == epoch => last.ticks_checked,
            Some((_, last)) => {
                self.ended = Some(self.ended.map_or(*last, |ended| together(&ended, last)));
                self.broken = 0;
                0
            }
        };
        if monitor.causes & Cause::LiveSwap.bit() != 0 {
            self.broken = 0;
        }
        let is_excused = EXCUSES
            .iter()
            .any(|cause| monitor.causes & cause.bit() != 0);
        self.ticks += 1;
        let is_checked = monitor.ticks_checked > checked;
        self.judged += u64::from(is_checked && !is_excused);
        let no_step = (!is_checked).then_some(Cause::StaleInput);
        for cause in EXCUSES.into_iter().chain(no_step) {
            let is_in_force = monitor.causes & cause.bit() != 0;
            self.unjudged[cause as usize] += u64::from(is_in_force);
        }
        self.broken |= monitor.causes;
        self.newest = Some((epoch, *monitor));
        self.theta_watched = self.theta;
    }

    pub fn section(&self) -> Theorem {
        let section = self.newest.map(|(_, newest)| {
            self.of_monitor(&self.ended.map_or(newest, |ended| together(&ended, &newest)))
        });
        let law_without = self.law_without.filter(|_| section.is_none());
        let mut unjudged = by_cause(&self.unjudged);
        unjudged.retain(|_, ticks| *ticks > 0);
        let section = section.unwrap_or_default();
        let rms = self.rate_error_rms_rad_s;
        Theorem {
            unjudged,
            rate_error_rms_rad_s: rms.unwrap_or(section.rate_error_rms_rad_s),
            law_without: law_without.map(str::to_owned),
            ticks: self.ticks,
            ticks_judged: self.judged,
            ticks_unwatched: self.unwatched,
            innovation: InnovationSection::of(&self.innovation, self.at_bound_before),
            rate_error_final_rad_s: self.rate_error_rad_s,
            ..section
        }
    }

    /// The section of what a monitor said last.
    fn of_monitor(&self, monitor: &Monitor) -> Theorem {
        let nominal = || ESTIMATED.map(|parameter| parameter.spec().nominal);
        let (theta, built) = (self.theta_watched, self.built.unwrap_or_else(nominal));
        let broken = UNBOUNDED
            .into_iter()
            .filter(|cause| self.broken & cause.bit() != 0);
        let broken: Vec<String> = broken.map(|cause| cause.name().to_owned()).collect();
        let estimate = |i: usize| {
            let error = monitor.estimate_error[i];
            let error_start = monitor.estimate_error_start[i];
            let size = error_start.max(theta[i].abs()).max(built[i]);
            Watched {
                name: ESTIMATED[i].name().into(),
                actual: theta[i],
                error,
                error_start,
                error_bound: monitor.estimate_error_bound[i],
                error_allowed: self.error_allowed[i],
                identifiability: monitor.identifiability[i],
                found: error.abs() <= FOUND * size,
            }
        };
        let estimates: Vec<Watched> = (0..3).map(estimate).collect();
        let start = monitor.v_th_start;
        let rise = |(cause, absolute): (Cause, f64)| {
            let relative = if start > 0.0 { absolute / start } else { 0.0 };
            let is_explained = cause != Cause::Unexplained;
            let name = if is_explained { cause.name() } else { NO_CAUSE };
            let is_told = !is_explained || absolute > 0.0;
            is_told.then(|| (name.to_owned(), Rise { absolute, relative }))
        };
        let rises = Cause::ALL.into_iter().zip(monitor.rise_max);
        let is_live = monitor.is_live == 1;
        let torque = Torque::of(&monitor.torque);
        let is_explained = monitor.violations[Cause::Unexplained as usize] == 0;
        Theorem {
            holds: is_live && is_explained && torque.unexplained() == 0,
            ticks_checked: monitor.ticks_checked,
            violations: by_cause(&monitor.violations),
            largest_rise: rises.filter_map(rise).collect(),
            v_th_start: monitor.v_th_start,
            v_th_end: monitor.v_th,
            descent: monitor.descent,
            descent_predicted: monitor.descent_predicted,
            is_live,
            step_excess_max: monitor.step_excess_max,
            steps_adapted: monitor.steps_adapted,
            v_above_bound: by_cause(&monitor.v_above_bound),
            rate_error_max_rad_s: monitor.rate_error_max_rad_s,
            rate_error_rms_rad_s: monitor.rate_error_rms_rad_s,
            torque,
            ticks_saturated: monitor.ticks_saturated,
            ticks_stale: monitor.ticks_stale,
            live_swaps: monitor.live_swaps,
            converged: estimates.iter().all(|estimate| estimate.found),
            convergence: convergence(monitor, &estimates, &broken),
            broken,
            estimates,
            excitation: monitor.excitation,
            excitation_least: monitor.excitation_least,
            ..Theorem::default()
        }
    }
}

/// Two monitors in a row: counts add up, largest values stay, the rest is the later one's.
fn together(earlier: &Monitor, later: &Monitor) -> Monitor {
    let sum = |a: [u64; CAUSES], b: [u64; CAUSES]| std::array::from_fn(|i| a[i] + b[i]);
    Monitor {
        ticks_checked: earlier.ticks_checked + later.ticks_checked,
        violations: sum(earlier.violations, later.violations),
        v_above_bound: sum(earlier.v_above_bound, later.v_above_bound),
        rise_max: std::array::from_fn(|i| earlier.rise_max[i].max(later.rise_max[i])),
        is_live: earlier.is_live & later.is_live,
        v_th_start: earlier.v_th_start.max(later.v_th_start),
        descent: earlier.descent + later.descent,
        descent_predicted: earlier.descent_predicted + later.descent_predicted,
        step_excess_max: earlier.step_excess_max.max(later.step_excess_max),
        rate_error_max_rad_s: earlier.rate_error_max_rad_s.max(later.rate_error_max_rad_s),
        excitation_least: earlier.excitation_least.min(later.excitation_least),
        steps_adapted: earlier.steps_adapted + later.steps_adapted,
        ticks_saturated: earlier.ticks_saturated + later.ticks_saturated,
        ticks_stale: earlier.ticks_stale + later.ticks_stale,
        live_swaps: earlier.live_swaps + later.live_swaps,
        torque: TorqueCounts {
            wrenches: earlier.torque.wrenches + later.torque.wrenches,
            wrenches_wrong: earlier.torque.wrenches_wrong + later.torque.wrenches_wrong,
            rotors: earlier.torque.rotors + later.torque.rotors,
            rotors_wrong: sum(earlier.torque.rotors_wrong, later.torque.rotors_wrong),
        },
        ..*later
    }
}

/// Causes with their ticks, those that have any.
fn listed(ticks: &BTreeMap<String, u64>) -> Vec<String> {
    let causes = ticks.iter().filter(|(_, ticks)| **ticks > 0);
    let words = causes.map(|(cause, ticks)| format!("{cause} in {ticks}"));
    words.collect()
}

fn by_cause(counts: &[u64; CAUSES]) -> BTreeMap<String, u64> {
    let all = Cause::ALL.into_iter().zip(counts);
    let listed = all.filter(|(cause, count)| *cause == Cause::Unexplained || **count > 0);
    listed
        .map(|(cause, count)| (cause.name().to_owned(), *count))
        .collect()
}

fn convergence(monitor: &Monitor, estimates: &[Watched], broken: &[String]) -> String {
    let names = |pick: &dyn Fn(&Watched) -> bool| {
        let picked = estimates.iter().filter(|estimate| pick(estimate));
        list(picked.map(|estimate| &estimate.name))
    };
    let exciting = monitor.excitation_least >= EXCITING;
    let least = monitor.excitation_least;
    let least = format!("at least {least:.2e} e-folds of the error in any window of at most 10 s");
    let lost = names(&|e| !e.found);
    if lost.is_empty() {
        let is = match exciting {
            true => ". The flight is",
            false => ", although the flight is not",
        };
        return format!(
            "(18) held: every estimate is within 1 %{is} persistently exciting, {least}."
        );
    }
    let mut text = format!("(18) did not hold: not within 1 %: {lost}.");
    if !broken.is_empty() {
        // How long the flight was, and how exciting, explains nothing where the theorem does not apply.
        let broken = broken.join(", ");
        return format!("{text} The theorem promises nothing for the estimates under {broken}.");
    }
    // What the theorem itself leaves large is no surprise; what it does not, something else keeps away.
    let owed = |e: &Watched| {
        let size = e.error_start.max(e.actual.abs()).max(f64::MIN_POSITIVE);
        e.error_bound <= FOUND * size
    };
    let expected = names(&|e| !e.found && !owed(e));
    let kept = names(&|e| !e.found && owed(e));
    if !expected.is_empty() {
        let why = match exciting {
            true => format!("exciting enough, {least}, but was too short for these gains"),
            false => format!("not persistently exciting, {least}"),
        };
        text += &format!(
            " Expected for {expected}: the flight is {why}. The proof covers the prediction error, and e where \
             nothing is late, but not the estimates."
        );
    }
    if !kept.is_empty() {
        text += &format!(" Not expected for {kept}: excited enough, and no cause is known.");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn monitor(unexplained: u64, is_live: u64) -> Monitor {
        let mut monitor = Monitor {
            ticks_checked: 10,
            is_live,
            v_th_start: 1.0,
            ..Monitor::default()
        };
        monitor.violations[Cause::Unexplained as usize] = unexplained;
        monitor.rise_max[Cause::GyroNoise as usize] = 0.5;
        monitor
    }

    #[test]
    fn an_unexplained_violation_or_lifeless_estimates_fail() {
        let theorem = |monitor| TheoremStatistics::default().of_monitor(&monitor);
        assert!(theorem(monitor(0, 1)).holds);
        for (monitor, found) in [
            (monitor(1, 1), "1 unexplained"),
            (monitor(0, 0), "do not move as predicted"),
        ] {
            let theorem = theorem(monitor);
            assert!(!theorem.holds);
            assert!(theorem.summary().contains(found), "{theorem:?}");
        }
    }

    #[test]
    fn no_bound_is_claimed_where_an_assumption_was_broken_since_the_last_live_swap() {
        let with = |cause: Option<Cause>| Monitor {
            causes: cause.map_or(0, Cause::bit),
            estimate_error: [1.0; 3],
            estimate_error_start: [1.0; 3],
            ..monitor(0, 1)
        };
        let mut statistics = TheoremStatistics::default();
        statistics.take(1, &with(Some(Cause::BrokenModel)));
        statistics.take(1, &with(Some(Cause::Delay)));
        let Theorem {
            broken,
            convergence,
            ..
        } = statistics.section();
        assert_eq!(broken, ["broken_model"]);
        let nothing = "promises nothing for the estimates under broken_model";
        assert!(convergence.contains(nothing), "{convergence}");
        assert!(!convergence.contains("xpected"), "{convergence}");
        statistics.take(1, &with(Some(Cause::LiveSwap)));
        assert_eq!(statistics.section().broken, [""; 0]);
        // Another inner loop begins anew.
        statistics.take(1, &with(Some(Cause::BrokenModel)));
        statistics.take(2, &with(None));
        assert_eq!(statistics.section().broken, [""; 0]);
    }

    #[test]
    fn a_restarted_inner_loop_continues_the_counts() {
        let mut statistics = TheoremStatistics::default();
        assert_eq!(statistics.section(), Theorem::default());
        let restarted = Monitor {
            v_th_start: 3.0,
            excitation: 0.25,
            ..monitor(1, 1)
        };
        for (epoch, monitor) in [(1, monitor(0, 1)), (1, monitor(2, 0)), (7, restarted)] {
            statistics.take(epoch, &monitor);
        }
        let theorem = statistics.section();
        assert_eq!((theorem.ticks_checked, theorem.unexplained()), (20, 3));
        // The second says nothing of a step that the first has not said.
        assert_eq!((theorem.ticks, theorem.ticks_judged), (3, 2));
        assert!(!theorem.is_live);
        assert_eq!((theorem.v_th_start, theorem.excitation), (3.0, 0.25));
        let rise = theorem.largest_rise["gyro_noise"];
        assert_eq!((rise.absolute, rise.relative), (0.5, 0.5 / 3.0));
    }

    #[test]
    fn ticks_that_were_not_watched_are_counted() {
        let mut statistics = TheoremStatistics::default();
        statistics.count_unwatched();
        statistics.count_unwatched();
        assert_eq!(statistics.section().ticks_unwatched, 2);
        statistics.take(1, &monitor(0, 1));
        let counts = "V_th judged in 1 of 3 ticks, 2 not watched (a message was lost, or another process took over); it rose in none";
        assert_eq!(statistics.section().counts(), counts);
        let excused = Monitor {
            ticks_checked: 11,
            causes: Cause::MotorLag.bit() | Cause::Delay.bit(),
            ..monitor(0, 1)
        };
        statistics.take(1, &excused);
        let section = statistics.section();
        assert!(section.is_hardly_judged(), "{section:?}");
        assert!(
            section
                .counts()
                .starts_with("V_th judged in 1 of 4 ticks (motor_lag in 1)")
        );
    }
}
