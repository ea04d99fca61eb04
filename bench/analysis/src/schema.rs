//! The report of a flight: every number, as written to report.json.

use crate::baseline::Baseline;
use crate::distribution::{Bucket, Distribution};
use crate::faults::{AppliedSwap, InjectedFault, ProcessFailure};
use crate::finding::Diagnosis;
use crate::host::{ContainerSection, Host, InterruptSection, Steal};
use crate::outages;
use crate::phrase::name_of;
use crate::series::Statistics;
use crate::targets::FollowedTarget;
use crate::theorem::Theorem;
use crate::timer_lead::LeadSection;
use crate::traces::Traces;
use errors::{FAILED, GATE, INTERRUPTED, OK};
use flight_log::build::Build;
use messages::blackboards::LOCKSTEP;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// Version of the schema: changed whenever a key changes its meaning or goes.
pub const SCHEMA: &str = "ironbird-report/2";

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    pub schema: String,
    pub run: RunSection,
    /// Verdicts on tracking, timing and the theorem.
    pub words: Verdicts,
    pub verdict: AcceptanceResult,
    /// Ticks and the identity that they must satisfy.
    pub ticks: Ticks,
    pub deadlines: DeadlineSection,
    pub autopsy: outages::OutageSection,
    /// The worst outage against what the loop tolerates; none in lockstep, where there are no outages.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub margin: Option<MarginSection>,
    /// What the redundant channels did; none of a flight with one channel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub redundancy: Option<RedundancySection>,
    /// The answers of a program that flew as the inner law; none of another law.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub firmware: Option<FirmwareSection>,
    /// Processes that ended while the flight needed them; the first 500.
    pub deaths: Vec<ProcessFailure>,
    pub deaths_left_out: u64,
    pub flight: ControlPerformance,
    /// Result of the Lyapunov monitor; `not applicable` where the inner law has no theorem.
    #[serde(serialize_with = "Theorem::serialize_applicable")]
    pub theorem: Theorem,
    /// Swaps of plant parameters, in order; the first 500.
    pub swaps: Vec<AppliedSwap>,
    pub swaps_left_out: u64,
    /// Targets of a ground station, in order; the first 500. None with a trajectory that is known before the flight.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub targets: Vec<FollowedTarget>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub targets_left_out: Option<u64>,
    /// Faults of messages and stages that were planned.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<InjectedFault>,
    pub series: Vec<Statistics>,
    pub roles: BTreeMap<String, RoleSection>,
    /// How far ahead of its tick the plant's timer is set, and at what price.
    pub lead: LeadSection,
    pub recorder: RecorderSection,
    pub host: Host,
    /// Whether the machine can fly in real time, by inspection: nothing is measured during a flight.
    pub doctor: Diagnosis,
    /// What the host took during the flight.
    pub steal: Steal,
    /// Limits of the loops' container.
    pub container: ContainerSection,
    /// What interrupted the loops' processor during the flight.
    pub interrupts: InterruptSection,
    /// How the latencies are distributed; empty while the flight is in the air.
    pub distributions: Vec<Distribution>,
    /// The machine's baselines, if requested.
    pub beside: Option<Baseline>,
    /// Of a lost flight: what became of it in a simulation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub loss: Option<LossSection>,
    /// The flight over time; none while it is in the air.
    pub traces: Option<Traces>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunSection {
    /// Number of the run: its start on the wall clock [ns since 1970].
    pub run_id: u64,
    pub started: String,
    /// Name of the machine.
    pub hostname: String,
    pub instance: String,
    pub version: String,
    /// The executable.
    pub build: Build,
    pub trajectory: String,
    /// Airframe, or the name of its file.
    pub airframe: String,
    /// SHA-256 of its file; empty where it is built in.
    pub airframe_sha256: String,
    pub preset: String,
    pub period_us: f64,
    /// Length of a tick on the clock [us]; 0 in lockstep, where ticks have none.
    pub wall_period_us: f64,
    /// Fingerprint of the settings that all roles shared.
    pub settings_fingerprint: String,
    /// The law of each role.
    pub laws: BTreeMap<String, LawSection>,
    pub ending: String,
    /// What the process that died said last, a line each; empty where none did.
    pub last_words: Vec<String>,
    /// Whether the flight is still running, so that these are partial numbers.
    pub in_flight: bool,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AcceptanceResult {
    pub status: FlightStatus,
    pub exit_code: u8,
    pub gates: Vec<Gate>,
}

/// The answers of another program that flew as the inner law ([`crate::firmware`]): ticks, by what became of them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FirmwareSection {
    /// Ticks whose state it was to answer.
    pub asked: u64,
    pub answered: u64,
    /// Nothing came in time.
    pub silent: u64,
    pub wrong_size: u64,
    pub not_finite: u64,
    pub after_its_end: u64,
    pub unanswered_percent: f64,
    /// Ticks without a state of their own, in which nothing was sent.
    pub not_asked: u64,
    /// Answers that came after their tick.
    pub late: u64,
    /// Answers that came though no state was without one.
    pub repeated: u64,
    /// Ticks in which it had disarmed, and when the first one was [s].
    pub disarmed: u64,
    pub disarmed_at_s: Option<f64>,
    /// Its exit status, if it ended in flight; 128 and the number of a signal.
    pub exit_status: Option<i64>,
    pub ended_at_s: Option<f64>,
    /// From sending a state to having its answer; none without an answer.
    pub latency_p50_us: Option<f64>,
    pub latency_p99_us: Option<f64>,
    pub latency_p999_us: Option<f64>,
    pub latency_max_us: Option<f64>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gate {
    /// What is looked at, with its unit.
    pub name: String,
    pub limit: String,
    pub value: String,
    pub held: bool,
    /// Whether it was requested; some apply to every flight.
    pub asked: bool,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Ticks {
    pub run: u64,
    /// Skipped because the plant woke too late.
    pub skipped: u64,
    /// From the beginning of tick 0 to the end of the last tick [s], by the clock.
    pub elapsed_s: f64,
    pub elapsed_periods: u64,
    /// Whether run + skipped is that number.
    pub identity_holds: bool,
}

impl Ticks {
    pub const fn all(&self) -> u64 {
        self.run.saturating_add(self.skipped)
    }

    /// How much of the flight its ticks are [s]: in lockstep and in slow motion not what the clock shows.
    pub fn flown_s(&self, run: &RunSection) -> f64 {
        self.all() as f64 * run.period_us / 1e6
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DeadlineSection {
    /// Ticks that flew without a fresh command on time; none in lockstep.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub not_fresh: Option<NotFresh>,
    pub missed: u64,
    pub missed_ppm: f64,
    /// Missed, by the stamps of the rotor commands.
    pub missed_by_stamps: u64,
    /// How late the commands were: from .. below .. [us], how many.
    pub late: Vec<Bucket>,
    /// Runs of consecutive misses: length in ticks, how many.
    pub runs: Vec<RunLength>,
    /// Late commands by their stamps, those of consecutive ticks together; the first 500 stretches.
    pub stretches: Vec<LateStretchSection>,
    pub stretches_left_out: u64,
}

/// Name of [`NotFresh::ticks`], the number that leads the timing verdict, wherever it is shown.
pub const NOT_FRESH: &str = "ticks without a fresh command on time";

/// Ticks that flew without a fresh command on time ([`crate::freshness`]).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NotFresh {
    pub ticks: u64,
    pub per_million: f64,
    /// The tick ran, and its command was late or never came: *late* in texts, as a skipped tick misses its deadline, too.
    pub missed: u64,
    /// The command was on time, but a stage had worked with an older input.
    pub stale: u64,
    pub skipped: u64,
}

impl NotFresh {
    pub fn new(missed: u64, stale: u64, ticks: &Ticks) -> Self {
        let skipped = ticks.skipped;
        let not_fresh = missed.saturating_add(stale).saturating_add(skipped);
        let all = ticks.run.saturating_add(skipped).max(1);
        Self {
            ticks: not_fresh,
            per_million: not_fresh as f64 * 1e6 / all as f64,
            missed,
            stale,
            skipped,
        }
    }

    /// Share of the ticks with a fresh command on time [%], rounded down to two digits: 100 means all of them.
    pub fn on_time_percent(&self) -> f64 {
        (10_000.0 - self.per_million / 100.0).floor() / 100.0
    }

    pub fn sentence(&self, ticks: &Ticks) -> String {
        let all = ticks.run.saturating_add(ticks.skipped);
        let (without, ppm, parts) = (self.ticks, self.per_million, self.parts());
        format!("{without} of {all} {NOT_FRESH} ({ppm:.1} per million): {parts}")
    }

    pub fn parts(&self) -> String {
        let (missed, stale, skipped) = (self.missed, self.stale, self.skipped);
        format!("{missed} late + {stale} stale + {skipped} skipped")
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LateStretchSection {
    pub tick: u64,
    pub time_s: f64,
    pub length_ticks: u64,
    pub late_us: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunLength {
    pub length_ticks: u64,
    pub count: u64,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ControlPerformance {
    /// Root mean square of the position error over all states [m].
    pub position_error_rms_m: f64,
    pub position_error_max_m: f64,
    pub position_error_final_m: f64,
    /// States that these are of.
    pub states: u64,
    /// Ticks that have no state: skipped by the plant, or lost by the recorder.
    pub ticks_without_state: u64,
    pub recent_error_max_m: f64,
    /// How long these were [s]: less than 5 in a short flight.
    pub recent_s: f64,
    /// Difference of the yaw from the reference's, at most pi; none without a state, and in reports that lack it.
    pub yaw_error: Option<AngleErrors>,
    /// Angle between body z and the thrust that the reference needs.
    pub tilt_error: Option<AngleErrors>,
    pub lowest_z_m: f64,
    /// When it was there [s]; none without a state.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lowest_at_s: Option<f64>,
    /// Norm of the inner law's rate error at the end [rad/s]; missing where the law shows none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate_error_final_rad_s: Option<f64>,
    /// Ticks in which the rotors could not deliver the demand.
    pub saturated_ticks: u64,
    /// None without a rotor command, and in reports that lack it.
    pub effort: Option<RotorEffort>,
    /// Estimates at the end, with what is true; missing where the inner law estimates nothing.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub estimates: Vec<Estimate>,
}

/// Errors of an angle, none below 0 [rad].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AngleErrors {
    pub rms_rad: f64,
    pub max_rad: f64,
    pub final_rad: f64,
    pub recent_max_rad: f64,
}

/// Title of [`RotorEffort::agitation_rad_s`].
pub const AGITATION: &str = "change of a rotor's command in a tick, rms [rad/s]";

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RotorEffort {
    /// Rotor commands that these are of.
    pub commands: u64,
    /// Share of the commands that could not deliver the demand [%].
    pub saturated_percent: f64,
    /// Root mean square of the change of a rotor's command from tick to tick [rad/s].
    pub agitation_rad_s: f64,
    /// Mean of all rotors' commands [rad/s].
    pub command_mean_rad_s: f64,
}

impl RotorEffort {
    /// Above it, saturation is large [% of the commands].
    pub const SATURATED_PERCENT: f64 = 1.0;
    /// Above it, the change of a command in a tick is large [% of the mean command].
    pub const AGITATION_PERCENT: f64 = 5.0;

    /// Whether a summary should name it.
    pub fn is_large(&self) -> bool {
        let agitation_percent = 100.0 * self.agitation_rad_s / self.command_mean_rad_s;
        self.saturated_percent > Self::SATURATED_PERCENT
            || agitation_percent > Self::AGITATION_PERCENT
    }
}

/// Error of one quantity of a flight, in its unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuantityError {
    pub name: &'static str,
    pub unit: &'static str,
    pub rms: f64,
    pub max: f64,
    pub last: f64,
    /// Largest error of the last 5 s.
    pub recent_max: f64,
}

impl ControlPerformance {
    /// The errors of position, yaw and tilt; each none where it is unknown.
    pub fn errors(&self) -> [Option<QuantityError>; 3] {
        let angle = |name, it: &AngleErrors| QuantityError {
            name,
            unit: "rad",
            rms: it.rms_rad,
            max: it.max_rad,
            last: it.final_rad,
            recent_max: it.recent_max_rad,
        };
        let position = QuantityError {
            name: "position error",
            unit: "m",
            rms: self.position_error_rms_m,
            max: self.position_error_max_m,
            last: self.position_error_final_m,
            recent_max: self.recent_error_max_m,
        };
        [
            (self.states > 0).then_some(position),
            self.yaw_error.as_ref().map(|it| angle("yaw error", it)),
            self.tilt_error.as_ref().map(|it| angle("tilt error", it)),
        ]
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    pub name: String,
    pub estimated: f64,
    pub actual: f64,
}

/// A process of the rig: of a role that died and was started again, the last one. What the dead ones missed is among
/// [`Report::deaths`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RoleSection {
    pub ticks_run: u64,
    pub ticks_skipped: u64,
    /// Ticks that it worked with a stale input.
    pub ticks_stale: u64,
    /// True for a process that replaced one of this flight; the ticks of its predecessor are not counted here.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub is_successor: bool,
    pub rejected: BTreeMap<String, u64>,
    pub landed: bool,
    /// Resources of its loop since it was armed; none unless it has landed.
    pub usage: Option<LoopUsage>,
    /// Scheduling in force: `fifo 80` or `other`.
    pub scheduling: String,
    pub realtime: Vec<RtStep>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LoopUsage {
    /// Only a build with the feature `instrumented` counts them.
    pub allocations: Option<u64>,
    pub minor_faults: u64,
    pub major_faults: u64,
    pub voluntary_switches: u64,
    pub involuntary_switches: u64,
    pub cpu_per_tick_us: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RtStep {
    pub step: String,
    /// The requested priority or processor, if the step has a number.
    pub asked: Option<u64>,
    pub granted: bool,
    pub refused: Option<String>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RecorderSection {
    /// Messages that were overwritten before it read them, by topic.
    pub lost: BTreeMap<String, u64>,
    pub rejected: BTreeMap<String, u64>,
    /// Ticks of which a topic had no message.
    pub incomplete_ticks: u64,
    pub cpu_percent: f64,
    pub log: LogSection,
    /// Other files that could not be written, with the first reason.
    pub unwritten: BTreeMap<String, String>,
}

/// What became of the messages on their way to flight.mcap and the files that go on from it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LogSection {
    /// Setting of the log: `all`, `around-misses` or `off`.
    pub kept: String,
    pub files: u64,
    /// Their length [bytes].
    pub file_bytes: u64,
    pub messages: BTreeMap<String, u64>,
    /// Messages that the disk did not take, by topic.
    pub dropped: BTreeMap<String, u64>,
    /// Messages that were not to be kept, by topic.
    pub left_out: BTreeMap<String, u64>,
    /// Messages in files that were removed for newer ones, by topic.
    pub removed: BTreeMap<String, u64>,
    /// Stretches of the flight that are kept, where not all of it is.
    pub stretches: u64,
    /// Why it did not take something, the first time.
    pub refused: Option<String>,
}

impl Report {
    pub fn series(&self, name: &str) -> Option<&Statistics> {
        self.series.iter().find(|series| series.name == name)
    }

    /// Messages that were overwritten before the recorder read them.
    pub fn lost(&self) -> u64 {
        sum(&self.recorder.lost)
    }

    /// Messages that the disk did not take.
    pub fn unlogged(&self) -> u64 {
        sum(&self.recorder.log.dropped)
    }
}

pub fn sum(counts: &BTreeMap<String, u64>) -> u64 {
    counts.values().copied().fold(0, u64::saturating_add)
}

/// A law that flew, by its role in the report.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LawSection {
    pub name: String,
    pub version: String,
    /// Its file; none where it is built in.
    pub file: Option<String>,
    pub sha256: Option<String>,
    /// Whether it promises nothing about its time.
    pub not_real_time: bool,
    /// Ticks in which its answer was not finite, or one that no airframe can give, and was replaced.
    pub ticks_not_finite: u64,
    pub first_not_finite: Option<u64>,
    /// Telemetry of the law, in the order of its signals.
    pub telemetry: Vec<SignalSection>,
}

/// A number that a law showed; none where it never knew it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SignalSection {
    pub name: String,
    pub unit: String,
    pub last: Option<f64>,
    pub min: Option<f64>,
    pub max: Option<f64>,
}

/// What stands for outages of all stages at once: `machine` in a table of margins.
pub const MACHINE: &str = "machine";

/// What a flight's loop tolerates, and how near the flight came to it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct MarginSection {
    /// Fingerprint of the settings that margins depend on: the name of their table.
    pub fingerprint: String,
    /// How to measure them, where they are not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unknown: Option<String>,
    /// The longest outage survived, by stage; empty where not known.
    #[serde(rename = "bears")]
    pub tolerated: BTreeMap<String, RobustnessMargin>,
    /// The longest outage from which the flight recovers in a few seconds, by stage.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub recovers: BTreeMap<String, RobustnessMargin>,
    /// Phases of the trajectory that these are the least of.
    pub phases: u64,
    /// The build that measured, where another one flew.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measured_by: Option<String>,
    /// The longest outages of this flight, by stage [ticks].
    pub outages: BTreeMap<String, u64>,
    /// Outages of this flight whose length by stage is not known, because messages were lost there.
    pub unmeasured: u64,
    /// The stage whose outage came nearest to what is tolerated; none without an outage or without a known margin.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nearest: Option<String>,
    /// The tolerated outage over its outage; no flight survived a margin below 1 in simulation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub margin: Option<f64>,
}

/// The longest outage of a stage that a limit allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobustnessMargin {
    pub ticks: u64,
    pub is_most: bool,
}

/// [`Report::loss`]: the same flight, with its faults and parameter changes, in a simulation.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LossSection {
    /// With no delay but those of the faults.
    pub without_delays: SimulatedLoss,
    /// With the delays of the flight; none if they cannot be simulated.
    pub with_delays: Option<SimulatedLoss>,
    /// Why they cannot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why_not: Option<String>,
    /// The flag of a law with which the flight without delays is not lost, if that was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub held_by: Option<String>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SimulatedLoss {
    /// When it is lost; none if it is not.
    pub lost_at_s: Option<f64>,
    pub how: Option<String>,
}

/// [`Report::redundancy`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RedundancySection {
    pub channels: u64,
    /// The channel whose command was in force last.
    pub active: String,
    /// Ticks whose command was each channel's.
    pub ticks_flown: BTreeMap<String, u64>,
    /// Ticks for which fewer than two channels had a fresh command on time.
    pub ticks_unprotected: u64,
    pub longest_unprotected_ms: f64,
    /// Ticks in which the fresh command on time was not that of the first channel with the laws that flew.
    pub ticks_masked: u64,
    /// Ticks without a fresh command on time from any channel.
    pub ticks_not_fresh: u64,
    /// Ticks in which fresh commands of channels with the same laws, states and inputs were compared.
    pub ticks_compared: u64,
    /// Ticks of these in which two differed in a bit.
    pub mismatches: u64,
    pub first_mismatch_s: Option<f64>,
    /// Ticks in which two channels contradicted each channel.
    pub ticks_outvoted: BTreeMap<String, u64>,
    pub handovers: u64,
    /// Ticks in a row without a command that could be flown, by channel, in their order; the 64 longest.
    pub outages: Vec<ChannelOutage>,
    pub outages_left_out: u64,
    /// The laws of single channels, by stage, such as `b.inner`. Likewise below: only if channels fly different laws.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub laws: BTreeMap<String, String>,
    /// When channels with other laws took over; the first 16.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub switchovers: Vec<Switchover>,
    /// How far the commands of a channel with other laws were from those that flew, by channel.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub differences: BTreeMap<String, CommandDifference>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Switchover {
    pub time_s: f64,
    /// The first tick whose command was the other channel's.
    pub tick: u64,
    pub from: String,
    pub to: String,
    pub reason: String,
    /// Largest change of a rotor's command from the tick before [rad/s].
    pub command_step_rad_s: f64,
}

/// Of the commands of the rotors, the largest difference in each tick.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CommandDifference {
    /// Ticks in which both had a fresh command on time.
    pub ticks: u64,
    pub rms_rad_s: f64,
    pub max_rad_s: f64,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ChannelOutage {
    pub channel: String,
    pub time_s: f64,
    pub tick: u64,
    pub ticks: u64,
    pub reason: String,
    /// Whether it was the channel that flew.
    pub handover: bool,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FlightVerdict {
    #[default]
    NotSeen,
    Tracked,
    /// It did as far as it flew: it was aborted or interrupted.
    CutShort,
    OffTrack,
    /// The vehicle left the flight envelope, or was below ground.
    Lost,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TimingVerdict {
    /// Its latencies tell nothing of the loops.
    #[default]
    NotMeasured,
    /// Every tick flew with a fresh command on time.
    InTime,
    /// It was as far as it flew: it was aborted or interrupted.
    CutShort,
    Late,
}

/// Whether the theorem holds on a flight.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StabilityVerdict {
    #[default]
    NotApplicable,
    Holds,
    /// The theorem holds in the steps that the monitor saw, which are not all.
    PartlyWatched,
    /// Nothing contradicts it, but in most ticks an assumption was broken, or no step was checked.
    NotJudged,
    /// It does not, and no cause is known.
    Broken,
}

/// A word with the numbers that it follows from, as a sentence without its full stop.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Explained<W> {
    pub word: W,
    pub why: String,
    /// The numbers alone, where `why` begins with the end of a flight that was cut short.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_then: Option<String>,
}

impl<W> Explained<W> {
    pub const fn new(word: W, why: String) -> Self {
        Self {
            word,
            why,
            until_then: None,
        }
    }

    /// The numbers that the word follows from.
    pub fn numbers(&mut self) -> &mut String {
        self.until_then.as_mut().unwrap_or(&mut self.why)
    }

    /// Puts the end of the flight, which was cut short, before the numbers.
    pub fn begin_with(&mut self, end: &str) {
        let numbers = std::mem::take(self.numbers());
        self.why = format!("{end}; until then {numbers}");
        self.until_then = Some(numbers);
    }
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Verdicts {
    pub flight: Explained<FlightVerdict>,
    pub timing: Explained<TimingVerdict>,
    pub theorem: Explained<StabilityVerdict>,
}

/// The status of a flight.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum FlightStatus {
    #[default]
    Flying,
    Pass,
    /// The same without a requested gate.
    Completed,
    /// It held its gates as far as it was seen; not all was, or not all was logged.
    Incomplete,
    Fail,
    Interrupted,
    Aborted,
}

impl FlightStatus {
    pub const fn exit_code(self) -> u8 {
        match self {
            Self::Flying | Self::Pass | Self::Completed | Self::Incomplete => OK,
            Self::Fail => GATE,
            Self::Interrupted => INTERRUPTED,
            Self::Aborted => FAILED,
        }
    }

    pub const fn is_over(self) -> bool {
        self.is_good() || matches!(self, Self::Incomplete | Self::Fail)
    }

    pub const fn is_good(self) -> bool {
        matches!(self, Self::Pass | Self::Completed)
    }
}

impl fmt::Display for FlightStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&name_of(self))
    }
}

/// The pace of a flight: real time, slow motion or lockstep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Speed {
    Lockstep,
    Clock,
    Slowed(u64),
}

impl Speed {
    /// Of ticks that are so long on the clock, or [`LOCKSTEP`], of laws with this sample time [ns].
    pub const fn of(period_ns: u64, sample_time_ns: u64) -> Self {
        match period_ns
            .saturating_add(sample_time_ns / 2)
            .checked_div(sample_time_ns)
        {
            _ if period_ns == LOCKSTEP => Self::Lockstep,
            None | Some(0 | 1) => Self::Clock,
            Some(times) => Self::Slowed(times),
        }
    }

    /// Why latencies tell nothing of real time, where they do not.
    pub fn why_not_real_time(self) -> Option<String> {
        match self {
            Self::Lockstep => Some("in lockstep there are no deadlines".into()),
            Self::Clock => None,
            Self::Slowed(times) => Some(format!("slowed {times} times: latencies of a slow clock")),
        }
    }
}

impl RunSection {
    pub fn speed(&self) -> Speed {
        let [period_ns, sample_time_ns] =
            [self.wall_period_us, self.period_us].map(|us| (us * 1e3).round() as u64);
        Speed::of(period_ns, sample_time_ns)
    }
}
