//! The recorder's figures so far, as a report.

use std::collections::BTreeMap;
use std::time::{Duration, UNIX_EPOCH};

use model::boards::{Ending, Run};
use role::rt::UsageMeter;
use wire::BoardReader;
use wire::clock::now_ns;

use super::Recorder;
use crate::fault::live::injected;
use crate::record::facts::injected_record;
use crate::record::ports::Ports;
use crate::run_directory::make_latest;
use crate::settings::laws::Chosen;
use crate::wall_time::utc;
use failure::Failure;
use flight_log::TOPICS;
use flight_log::writer::FlightLog;
use machine::cpu_times::CpuTimes;
use machine::interrupts::Interrupts;
use report::autopsy::Autopsy;
use report::autopsy::section::WORST_SHOWN;
use report::host::InterruptSection;
use report::laws::{LawSection, NotFinite};
use report::schema::{self, Report, RunLength};
use report::sections::{log_section, rejected};
use report::states::StatesWriter;
use report::tally::deadlines::LateStretch;
use report::tally::distribution::buckets;
use report::tally::series::Series;
use report::tally::telemetry::TelemetryTally;
use report::verdict::{gates, verdict};
use report::words::{Evidence, Words};

impl Recorder<'_> {
    /// The numbers so far; final with an ending.
    pub(super) fn report(
        &self,
        run: &Run,
        ports: &Ports,
        meter: &UsageMeter,
        ending: Option<Ending>,
    ) -> Result<Report, Failure> {
        let ticks = self.tally.ticks(run);
        let ticks_without_state = (ticks.run + ticks.skipped).saturating_sub(self.tally.states);
        let late = self.tally.series.flight(Series::Late);
        let missed = self.tally.miss_runs.missed();
        let deadlines = schema::DeadlineSection {
            missed,
            missed_ppm: missed as f64 * 1e6 / (ticks.run + ticks.skipped).max(1) as f64,
            missed_by_stamps: self.tally.late_commands.count(),
            late: late.map(buckets).unwrap_or_default(),
            runs: self
                .tally
                .miss_runs
                .lengths()
                .into_iter()
                .map(|(length_ticks, count)| RunLength { length_ticks, count })
                .collect(),
            stretches: self.tally.late_commands.stretches().iter().map(|stretch| self.late_stretch(stretch)).collect(),
            stretches_left_out: self.tally.late_commands.left_out(),
        };
        let series = self.tally.series.statistics();
        let theorem = self.tally.theorem.section();
        let lost_messages = self.tally.lost().iter().sum();
        let lost = TOPICS.iter().zip(self.tally.lost()).map(|(topic, lost)| ((*topic).to_owned(), lost)).collect();
        let elapsed_ns = now_ns().saturating_sub(run.t0_ns).max(1);
        let started = utc(UNIX_EPOCH + Duration::from_nanos(run.t0_wall_ns));
        let steal = self.cpu_times.steal_until(&CpuTimes::read(self.watch.processor));
        let roles = self.crew.sections();
        let performance = schema::ControlPerformance { ticks_without_state, ..self.tally.flight() };
        let section = schema::RunSection {
            run_id: run.run_id,
            started,
            instance: self.instance.clone(),
            version: env!("CARGO_PKG_VERSION").into(),
            build: crate::build::here(),
            trajectory: self.settings.trajectory_name().into(),
            airframe: self.settings.airframe_name().into(),
            airframe_sha256: self.settings.flight.airframe_sha256.clone(),
            preset: self.settings.flight.preset.clone(),
            period_us: self.period_s * 1e6,
            wall_period_us: run.period_ns as f64 / 1e3,
            settings_fingerprint: format!("{:016x}", run.settings),
            laws: self.laws(),
            ending: ending.unwrap_or(Ending::None).words().into(),
            last_words: Vec::new(),
            in_flight: ending.is_none(),
        };
        let evidence = Evidence {
            run: &section,
            ending,
            ticks: &ticks,
            deadlines: &deadlines,
            performance: &performance,
            theorem: &theorem,
            series: &series,
            roles: &roles,
            steal: &steal,
            lost: lost_messages,
        };
        let faults = [self.settings.injected()?, injected(&self.injected, self.period_s)].concat();
        let mut autopsy = self.tally.autopsy.as_ref().map(Autopsy::section).unwrap_or_default().struck_by(&faults);
        if ending.is_none() {
            // Written every second: as much as is shown.
            autopsy.worst.truncate(WORST_SHOWN);
        }
        let words = Words::of(&evidence, &self.settings.tracking_limits());
        let gates = gates(&self.settings.gates_asked(), &evidence);
        Ok(Report {
            schema: schema::SCHEMA.into(),
            words,
            run: section,
            verdict: verdict(gates, lost_messages, ending),
            ticks,
            deadlines,
            margin: self.margin.clone().map(|margin| margin.with(&autopsy)),
            autopsy,
            deaths: self.tally.deaths.deaths.clone(),
            deaths_left_out: self.tally.deaths.left_out,
            flight: performance,
            theorem,
            swaps: self.tally.swaps.clone(),
            swaps_left_out: self.tally.swaps_seen - self.tally.swaps.len() as u64,
            faults,
            series,
            roles,
            lead: self.tally.lead(&run.lead, self.crew.rehearsals()),
            recorder: schema::RecorderSection {
                lost,
                rejected: rejected(&ports.rejections()),
                incomplete_ticks: self.joiner.incomplete,
                cpu_percent: 100.0 * meter.read().cpu_ns as f64 / elapsed_ns as f64,
                log: log_section(
                    self.settings.recorder.log.name(),
                    &self.log.as_ref().map(FlightLog::fate).unwrap_or_default(),
                ),
                unwritten: self.unwritten.iter().map(|(file, why)| ((*file).to_owned(), why.clone())).collect(),
            },
            host: self.host.clone(),
            doctor: self.doctor.clone(),
            steal,
            interrupts: InterruptSection {
                processor: self.watch.processor,
                counts: self.interrupts.until(&Interrupts::read(self.watch.processor)),
            },
            // What only a page shows is worked out once, at the end.
            distributions: if ending.is_some() { self.tally.series.distributions(run.period_ns) } else { Vec::new() },
            // The launcher measures them when everybody has landed.
            beside: None,
            traces: ending.map(|_| self.tally.tracer.traces()),
        })
    }

    /// Takes what was injected so far.
    pub(super) fn look_for_faults(&mut self) {
        let Some(board) = self.live.as_mut().and_then(BoardReader::news) else { return };
        self.injected = board.iter().collect();
        if let Some(log) = &mut self.log {
            log.tell_injected(injected_record(&self.injected));
        }
    }

    /// Hands the states so far to the disk.
    pub(super) fn keep_states(&mut self) {
        let kept = self.states.iter_mut().try_for_each(StatesWriter::flush);
        self.note("states.csv", kept);
    }

    /// Points `latest` at this flight as soon as it has a report.
    pub(super) fn point_latest(&mut self) {
        if !self.is_latest && self.directory.join("report.json").exists() {
            self.is_latest = true;
            let pointed = make_latest(self.directory);
            self.note("latest", pointed);
        }
    }

    /// The laws that fly, with what they show, and their answers that could not be used.
    fn laws(&self) -> BTreeMap<String, LawSection> {
        let counted = self.chosen.into_iter().zip(self.tally.not_finite).zip(&self.tally.telemetry);
        let section = |((law, not_finite), telemetry): ((Chosen, NotFinite), &TelemetryTally)| {
            (law.description().role.to_string(), law.section(not_finite, telemetry.section()))
        };
        counted.map(section).collect()
    }

    fn late_stretch(&self, stretch: &LateStretch) -> schema::LateStretchSection {
        schema::LateStretchSection {
            tick: stretch.tick,
            time_s: stretch.tick as f64 * self.period_s,
            length_ticks: stretch.length_ticks,
            late_us: stretch.late_ns as f64 / 1e3,
        }
    }
}
