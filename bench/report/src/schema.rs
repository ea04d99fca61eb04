//! The report of a flight: every number, as written to report.json.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::autopsy;
use crate::beside::Beside;
use crate::deaths::Death;
use crate::finding::Diagnosis;
use crate::host::{Host, InterruptSection, Steal};
use crate::injected::InjectedFault;
use crate::laws::LawSection;
use crate::lead::LeadSection;
use crate::margin;
use crate::status::FlightStatus;
use crate::swaps::AppliedSwap;
use crate::tally::distribution::{Bucket, Distribution};
use crate::tally::series::Statistics;
use crate::tally::theorem::Theorem;
use crate::traces::Traces;
use crate::words::Words;
use flight_log::build::Build;

/// Version of the schema: changed whenever a key changes its meaning or goes.
pub const SCHEMA: &str = "ironbird-report/2";

/// A flight in numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// [`SCHEMA`].
    pub schema: String,
    /// What was flown.
    pub run: RunSection,
    /// Did it track, was it in time, does the theorem hold; empty in reports from before they were told apart.
    #[serde(default)]
    pub words: Words,
    /// Whether it passed.
    pub verdict: FlightVerdict,
    /// Ticks and the identity that they must satisfy.
    pub ticks: Ticks,
    /// Deadlines of the rotor commands.
    pub deadlines: DeadlineSection,
    /// Why they were missed.
    #[serde(default)]
    pub autopsy: autopsy::section::Section,
    /// The worst outage against what the loop bears; none in lockstep, where there are no outages, and in reports from
    /// before margins were measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub margin: Option<margin::line::Section>,
    /// Processes that ended while the flight needed them; the first 500.
    #[serde(default)]
    pub deaths: Vec<Death>,
    /// Later ones.
    #[serde(default)]
    pub deaths_left_out: u64,
    /// The control performance.
    pub flight: ControlPerformance,
    /// The theorem, watched; empty in reports from before it was. Where the inner law has none, it says so and no more.
    #[serde(default, serialize_with = "Theorem::serialize_applicable")]
    pub theorem: Theorem,
    /// Swaps of plant parameters, in order; the first 500.
    pub swaps: Vec<AppliedSwap>,
    /// Later ones.
    #[serde(default)]
    pub swaps_left_out: u64,
    /// Faults of messages and stages that were planned.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<InjectedFault>,
    /// Latencies.
    pub series: Vec<Statistics>,
    /// The processes.
    pub roles: BTreeMap<String, RoleSection>,
    /// How far ahead of its tick the plant's timer is set, and at what price; empty in reports from before it was.
    #[serde(default)]
    pub lead: LeadSection,
    /// The recorder's own losses.
    pub recorder: RecorderSection,
    /// The machine.
    pub host: Host,
    /// Whether the machine can fly in real time, as far as looking tells: nothing is measured beside a flight.
    #[serde(default)]
    pub doctor: Diagnosis,
    /// What the host took during the flight.
    pub steal: Steal,
    /// What interrupted the loops' processor during the flight.
    #[serde(default)]
    pub interrupts: InterruptSection,
    /// How the latencies are distributed; empty while the flight is in the air.
    #[serde(default)]
    pub distributions: Vec<Distribution>,
    /// The machine's floors, where they were asked for.
    #[serde(default)]
    pub beside: Option<Beside>,
    /// The flight over time; none while it is in the air.
    #[serde(default)]
    pub traces: Option<Traces>,
}

/// What was flown.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunSection {
    /// Number of the run: its start on the wall clock [ns since 1970].
    pub run_id: u64,
    /// Its start, for people.
    pub started: String,
    /// Instance.
    pub instance: String,
    /// Version of ironbird.
    pub version: String,
    /// The executable; unknown in reports from before builds were named.
    #[serde(default)]
    pub build: Build,
    /// Reference trajectory.
    pub trajectory: String,
    /// Airframe, or the name of its file; empty in reports from before it was named.
    #[serde(default)]
    pub airframe: String,
    /// SHA-256 of its file; empty where it is built in.
    #[serde(default)]
    pub airframe_sha256: String,
    /// Preset of the laws.
    pub preset: String,
    /// Sample time of the laws [us].
    pub period_us: f64,
    /// Length of a tick on the clock [us]; 0 in lockstep, where ticks have none.
    pub wall_period_us: f64,
    /// Fingerprint of the settings that all roles shared.
    pub settings_fingerprint: String,
    /// The law of each role; empty in reports from before they could be chosen.
    #[serde(default)]
    pub laws: BTreeMap<String, LawSection>,
    /// How it ended.
    pub ending: String,
    /// What the process that died said last, a line each; empty where none did.
    #[serde(default)]
    pub last_words: Vec<String>,
    /// Whether these are the numbers so far of a flight in the air.
    pub in_flight: bool,
}

/// Whether a flight passed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlightVerdict {
    /// What it came to.
    pub status: FlightStatus,
    /// Exit code of the flight.
    pub exit_code: u8,
    /// Each gate.
    pub gates: Vec<Gate>,
}

/// Something that a flight must satisfy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gate {
    /// What is looked at, with its unit.
    pub name: String,
    /// What is allowed.
    pub limit: String,
    /// What was found.
    pub value: String,
    /// Whether it held.
    pub held: bool,
    /// Whether it was asked for; some are of every flight.
    #[serde(default)]
    pub asked: bool,
}

/// Ticks of the plant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ticks {
    /// Published.
    pub run: u64,
    /// Skipped because the plant woke too late.
    pub skipped: u64,
    /// From the beginning of tick 0 to the end of the last tick [s], by the clock.
    pub elapsed_s: f64,
    /// The same in periods.
    pub elapsed_periods: u64,
    /// Whether run + skipped is that number.
    pub identity_holds: bool,
}

/// Deadlines of the rotor commands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DeadlineSection {
    /// Missed, by the plant's own verdicts.
    pub missed: u64,
    /// The same per million ticks.
    pub missed_ppm: f64,
    /// Missed, by the stamps of the rotor commands.
    pub missed_by_stamps: u64,
    /// How late the commands were: from .. below .. [us], how many.
    pub late: Vec<Bucket>,
    /// Runs of consecutive misses: length in ticks, how many.
    pub runs: Vec<RunLength>,
    /// Late commands by their stamps, those of consecutive ticks together; the first 500 stretches.
    #[serde(default)]
    pub stretches: Vec<LateStretchSection>,
    /// Late commands in later stretches.
    #[serde(default)]
    pub stretches_left_out: u64,
}

/// Consecutive ticks whose commands were late.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LateStretchSection {
    /// The first of them.
    pub tick: u64,
    /// Its time of the flight [s].
    pub time_s: f64,
    /// How many.
    pub length_ticks: u64,
    /// Largest lateness [us].
    pub late_us: f64,
}

/// Runs of one length.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunLength {
    /// Ticks.
    pub length_ticks: u64,
    /// Runs.
    pub count: u64,
}

/// The control performance.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ControlPerformance {
    /// Root mean square of the position error over all states [m].
    pub position_error_rms_m: f64,
    /// Largest position error [m].
    pub position_error_max_m: f64,
    /// Position error at the end [m].
    pub position_error_final_m: f64,
    /// States that these are of; 0 in reports from before all states counted.
    pub states: u64,
    /// Ticks that have no state: skipped by the plant, or lost by the recorder.
    pub ticks_without_state: u64,
    /// Largest position error in the last 5 s [m].
    pub recent_error_max_m: f64,
    /// How long these were [s]: less than 5 in a short flight.
    pub recent_s: f64,
    /// Lowest point of the flight, world frame [m].
    pub lowest_z_m: f64,
    /// Norm of the inner law's rate error at the end [rad/s]; missing where the law shows none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate_error_final_rad_s: Option<f64>,
    /// Ticks in which the rotors could not do what was asked.
    pub saturated_ticks: u64,
    /// Estimates at the end, with what is true; missing where the inner law estimates nothing.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub estimates: Vec<Estimate>,
}

/// An estimated parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Name with unit.
    pub name: String,
    /// What the inner loop believes.
    pub estimated: f64,
    /// What the plant flies with.
    pub actual: f64,
}

/// A process of the rig: of a role that died and was started again, the last one. What the dead ones missed is among
/// [`Report::deaths`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RoleSection {
    /// Ticks that it worked.
    pub ticks_run: u64,
    /// Ticks that it skipped.
    pub ticks_skipped: u64,
    /// Ticks that it worked with a stale input.
    pub ticks_stale: u64,
    /// Messages that it rejected, by reason.
    pub rejected: BTreeMap<String, u64>,
    /// Whether its figures are final.
    pub landed: bool,
    /// Resources of its loop since it was armed; none unless it has landed.
    pub usage: Option<LoopUsage>,
    /// Scheduling in force: `fifo 80` or `other`.
    pub scheduling: String,
    /// What the system was asked for.
    pub realtime: Vec<RtStep>,
}

/// Resources of a loop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LoopUsage {
    /// Calls to the allocator.
    pub allocations: u64,
    /// Page faults without a disk.
    pub minor_faults: u64,
    /// Page faults with one.
    pub major_faults: u64,
    /// Waits.
    pub voluntary_switches: u64,
    /// Preemptions.
    pub involuntary_switches: u64,
    /// Processor time per tick [us].
    pub cpu_per_tick_us: f64,
}

/// A step of the real-time set-up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RtStep {
    /// The step.
    pub step: String,
    /// What was asked: a priority or a processor, where the step has a number.
    pub asked: Option<u64>,
    /// Whether it was granted.
    pub granted: bool,
    /// Why not.
    pub refused: Option<String>,
}

/// The recorder's own losses.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RecorderSection {
    /// Messages that were overwritten before it read them, by topic.
    pub lost: BTreeMap<String, u64>,
    /// Messages that it rejected.
    pub rejected: BTreeMap<String, u64>,
    /// Ticks of which a topic had no message.
    pub incomplete_ticks: u64,
    /// Share of one processor that it used [%].
    pub cpu_percent: f64,
    /// The flight log.
    pub log: LogSection,
    /// Other files that could not be written, with the first reason.
    pub unwritten: BTreeMap<String, String>,
}

/// What became of the messages on their way to flight.mcap and the files that go on from it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LogSection {
    /// What it was to keep: `all`, `around-misses` or `off`; empty in reports from before that could be chosen.
    pub kept: String,
    /// Files that are there.
    pub files: u64,
    /// Their length [bytes].
    pub file_bytes: u64,
    /// Messages in them, by topic.
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
    /// Statistics of a series by name.
    #[must_use]
    pub fn series(&self, name: &str) -> Option<&Statistics> {
        self.series.iter().find(|series| series.name == name)
    }
}
