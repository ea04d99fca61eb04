//! Builds the report of a flight from what has been recorded so far.

use std::collections::BTreeMap;
use std::time::{Duration, UNIX_EPOCH};

use analysis::distribution::buckets;
use analysis::flight_statistics::FlightStatistics;
use analysis::gates::judge;
use analysis::laws::{NotFinite, SignalStatistics};
use analysis::miss_analysis::MissAnalysis;
use analysis::outages::WORST_SHOWN;
use analysis::schema::{self, LawSection, MarginSection, Report, Verdicts};
use analysis::sections::{self, rejections};
use analysis::series::Series;
use errors::Failure;
use flight_log::TOPICS;
use host::cpu_times::hostname;
use ipc::clock::now_ns;
use messages::blackboards::{EndReason, Run};
use messages::role::Channel;
use process::rt::UsageMeter;

use super::recording::Recorder;
use crate::injected_faults::injected;
use config::Settings;
use config::law_settings::Chosen;
use flight_log::wall_time::utc;

/// Makes reports; it holds the parts of them that do not change in flight.
pub struct ReportBuilder<'a> {
    /// The laws as loaded at the start: a law file that disappears during the flight does not matter.
    laws: [Chosen; 3],
    channel_laws: BTreeMap<String, String>,
    margin: Option<MarginSection>,
    instance: String,
    meter: &'a UsageMeter,
    /// When this recorder began [ns].
    began_ns: u64,
}

impl<'a> ReportBuilder<'a> {
    pub fn new(
        settings: &Settings,
        instance: &str,
        meter: &'a UsageMeter,
        margin: Option<MarginSection>,
    ) -> Result<Self, Failure> {
        Ok(Self {
            laws: settings.chosen_laws()?,
            channel_laws: settings.named_channel_laws()?,
            margin,
            instance: instance.into(),
            meter,
            began_ns: now_ns(),
        })
    }

    /// The figures so far; the final ones if there is an ending.
    pub fn build(
        &self,
        recorded: &Recorder<'_>,
        ending: Option<EndReason>,
    ) -> Result<Report, Failure> {
        let (settings, host) = (recorded.settings, &recorded.host);
        let (statistics, run) = (recorded.streams.statistics(), &recorded.armed.run.get());
        let period_s = settings.flight.period_s;
        let ticks = statistics.ticks(run);
        let ticks_without_state = (ticks.run + ticks.skipped).saturating_sub(statistics.states);
        let performance = schema::ControlPerformance {
            ticks_without_state,
            ..statistics.flight()
        };
        let live = &recorded.faults.faults;
        let planned = settings.planned_faults_beside(live)?;
        let faults = [planned, injected(live, period_s)].concat();
        let autopsy = statistics.autopsy.as_ref().map(MissAnalysis::section);
        let mut autopsy =
            autopsy
                .unwrap_or_default()
                .with_faults(&faults, period_s, &statistics.deaths.deaths);
        if ending.is_none() {
            // This report is written every second: only what is shown.
            autopsy.worst.truncate(WORST_SHOWN);
        }
        let [.., mixer] = recorded.roles.loops(Channel::A);
        let redundancy = recorded.streams.redundancy();
        let mut report = Report {
            schema: schema::SCHEMA.into(),
            words: Verdicts::default(),
            run: self.run_section(settings, run, statistics, ending),
            verdict: schema::AcceptanceResult::default(),
            deadlines: deadlines(statistics, &ticks),
            ticks,
            margin: self.margin.clone().map(|margin| margin.with(&autopsy)),
            autopsy,
            redundancy: redundancy.map(|it| schema::RedundancySection {
                laws: self.channel_laws.clone(),
                ..sections::redundancy(&it, period_s)
            }),
            firmware: statistics.stages.firmware.section(),
            deaths: statistics.deaths.deaths.clone(),
            deaths_left_out: statistics.deaths.left_out,
            flight: performance,
            theorem: statistics.stages.theorem.section(),
            swaps: statistics.swaps.clone(),
            swaps_left_out: statistics.swaps_seen - statistics.swaps.len() as u64,
            targets: statistics.targets.followed.clone(),
            targets_left_out: Some(statistics.targets.left_out).filter(|it| *it > 0),
            faults,
            series: statistics.series.statistics(),
            roles: recorded.roles.sections(run.t0_ns),
            lead: statistics.lead(&run.lead, mixer.rehearsals),
            recorder: self.recorder_section(recorded, run),
            host: host.host.clone(),
            doctor: host.diagnosis.clone(),
            steal: host.steal(),
            container: host.container(),
            interrupts: host.interrupts(),
            // Only the page shows these, so they are computed once, at the end.
            distributions: if ending.is_some() {
                statistics.series.distributions(run.period_ns)
            } else {
                Vec::new()
            },
            // The launcher measures them after all processes have landed.
            beside: None,
            loss: None,
            traces: ending.map(|_| statistics.tracer.traces()),
        };
        judge(&mut report, ending, &settings.requested_gates());
        Ok(report)
    }

    fn recorder_section(&self, recorded: &Recorder<'_>, run: &Run) -> schema::RecorderSection {
        let Recorder { streams, files, .. } = recorded;
        let lost = TOPICS.into_iter().zip(streams.statistics().lost());
        let elapsed_ns = now_ns().saturating_sub(run.t0_ns.max(self.began_ns)).max(1);
        schema::RecorderSection {
            lost: lost.map(|(topic, lost)| (topic.into(), lost)).collect(),
            rejected: rejections(&streams.rejections()),
            incomplete_ticks: streams.incomplete_ticks(),
            cpu_percent: 100.0 * self.meter.read().cpu_ns as f64 / elapsed_ns as f64,
            log: files.log_section(),
            unwritten: files.incomplete.clone(),
        }
    }

    fn run_section(
        &self,
        settings: &Settings,
        run: &Run,
        statistics: &FlightStatistics,
        ending: Option<EndReason>,
    ) -> schema::RunSection {
        let started = utc(UNIX_EPOCH + Duration::from_nanos(run.t0_wall_ns));
        schema::RunSection {
            run_id: run.run_id,
            started,
            hostname: hostname(),
            instance: self.instance.clone(),
            version: env!("CARGO_PKG_VERSION").into(),
            build: flight_log::build::executable(),
            trajectory: settings.trajectory_name().into(),
            airframe: settings.airframe_name().into(),
            airframe_sha256: settings.flight.airframe_sha256.clone(),
            preset: settings.flight.preset.clone(),
            period_us: settings.flight.period_s * 1e6,
            wall_period_us: run.period_ns as f64 / 1e3,
            settings_fingerprint: format!("{:016x}", run.settings),
            laws: self.laws(statistics),
            ending: ending.unwrap_or(EndReason::None).name().into(),
            last_words: Vec::new(),
            in_flight: ending.is_none(),
        }
    }

    /// The laws of the flight with their telemetry and their unusable outputs.
    fn laws(&self, statistics: &FlightStatistics) -> BTreeMap<String, LawSection> {
        let laws = self.laws.into_iter().zip(statistics.stages.not_finite);
        let section = |((law, not_finite), telemetry): ((Chosen, NotFinite), &SignalStatistics)| {
            let role = law.description().role.to_string();
            (role, law.section(not_finite, telemetry.section()))
        };
        laws.zip(&statistics.stages.telemetry)
            .map(section)
            .collect()
    }
}

fn deadlines(statistics: &FlightStatistics, ticks: &schema::Ticks) -> schema::DeadlineSection {
    let late = statistics.series.flight(Series::Late);
    let missed = statistics.miss_runs.missed;
    schema::DeadlineSection {
        not_fresh: statistics.not_fresh(ticks),
        missed,
        missed_ppm: missed as f64 * 1e6 / (ticks.run + ticks.skipped).max(1) as f64,
        missed_by_stamps: statistics.late_commands.count,
        late: late.map(buckets).unwrap_or_default(),
        runs: statistics.miss_runs.lengths(),
        stretches: statistics.late_commands.stretches.clone(),
        stretches_left_out: statistics.late_commands.left_out,
    }
}
