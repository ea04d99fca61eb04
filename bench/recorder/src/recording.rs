//! The recorder's process: reads the topics until the plant closes the run, then writes the final report.

use std::thread::sleep;
use std::time::Duration;

use analysis::flight_statistics::FlightStatistics;
use analysis::schema::{MarginSection, Report};
use analysis::tracking::Tracking;
use errors::Failure;
use flight_log::channel_merge::ChannelMerge;
use flight_log::facts::record;
use hdrhistogram::serialization::V2DeflateSerializer;
use host::Machine;
use host::sampler::fallen;
use ipc::clock::now_ns;
use messages::blackboards::{EndReason, RolePhase, RunPhase, Status};
use messages::channels::REDUNDANCY;
use messages::grid::{NS_PER_S, Pace};
use messages::role::{Channel, Replica, Role};
use process::lead::left_by;
use process::rt::UsageMeter;
use process::session::{Armed, RoleSession};

use super::faulty_inputs::FaultyInputs;
use super::hlog::{self, Hlog};
use super::host_monitor::HostMonitor;
use super::injected_faults::{InjectedFaults, injected_record};
use super::log_metadata::metadata_of_logs;
use super::message_streams::{MessageStreams, StreamPorts};
use super::ports::{DRAIN_EVERY, rest};
use super::report_builder::ReportBuilder;
use super::role_statuses::RoleStatuses;
use super::run_files::{Files, RunFiles};
use config::Settings;
use controller::flight_monitor::FlightMonitor;
use faults::live::LIVE;

/// How long the recorder waits for the final status of the other processes.
const LANDING_TIMEOUT: Duration = Duration::from_secs(2);
/// How long it then waits for the records of the last parameter changes, which do not come from the plant's loop.
const LAST_SWAPS_TIMEOUT: Duration = Duration::from_millis(500);

/// Records until the plant closes the run; returns the flight's report. `margin` gives what the report compares outages
/// with.
pub fn run(
    mut session: RoleSession,
    settings: &Settings,
    files: &Files,
    margin: impl FnOnce(Pace) -> Result<Option<MarginSection>, Failure>,
) -> Result<Report, Failure> {
    let channels = settings.rt.channels;
    let mut ports = StreamPorts::open(session.wire(), channels)?;
    let machine = Machine::here(
        settings.rt.priority + Replica::from(Role::Mixer).priority_step(settings.rt.channel_cpus),
        settings.realtime()?.cpu,
    );
    let (mut roles, mut faults) = (RoleStatuses::default(), InjectedFaults::default());
    let (mut redundancy, mut injected) = (None, None);
    let armed = session.join(|wire, expected, _| {
        // Before the plant takes off: a flight can be over before the recorder has created its files.
        roles = RoleStatuses::open(wire)?;
        faults = InjectedFaults::open(wire)?;
        injected = wire.blackboard_reader(LIVE)?;
        if channels > 1 {
            redundancy = wire.blackboard_reader(REDUNDANCY)?;
        }
        ports.arm(expected)
    })?;
    let meter = UsageMeter::start();
    let lines = hlog::create(&files.directory)?;
    let (mut out, mut serializer) = (lines.clone(), V2DeflateSerializer::new());
    let run = armed.run.get();
    let seconds = now_ns().saturating_sub(run.t0_ns) / NS_PER_S;
    let every_s = settings.recorder.hlog_every_s;
    let latencies = Hlog::begin(
        &lines,
        &mut out,
        &mut serializer,
        run.t0_wall_ns,
        every_s,
        u32::try_from(seconds / every_s).unwrap_or(u32::MAX),
    )?;

    let instance = session.wire().instance();
    let tracking = Tracking::along(settings.course()?, settings.flight.period_s);
    let laws = settings.flown_laws()?;
    let mut host = HostMonitor::start(&machine, &roles, settings.recorder.trace, instance)?;
    let mut statistics = FlightStatistics::new(armed.pace, armed.run.get().t0_ns, tracking)?;
    statistics
        .stages
        .theorem
        .set_airframe(&settings.airframe()?);
    statistics.set_laws(laws);
    statistics.set_channels(channels);
    let (rt, period_ns) = (settings.realtime()?, armed.run.get().period_ns);
    let leads_ns = Channel::ALL.map(|channel| left_by(channel, &rt, period_ns));
    statistics.begin_autopsy(host.counters.processor.is_some(), leads_ns);
    // The counters before the first tick.
    host.sample(&roles, Channel::A, &mut statistics, false)?;
    let run = armed.run.get();
    let sections = roles.sections(run.t0_ns);
    let logs = metadata_of_logs(&run, settings, instance.name(), &host.host, &sections)?;
    let monitor = FlightMonitor::new(settings.theorem()?);
    let (arrangement, waits_ticks) = (settings.arrangement(), settings.waiting_ticks());
    let merge = || ChannelMerge::new(arrangement, waits_ticks, laws.signals);
    let merge = (channels > 1).then(merge);
    let streams = MessageStreams::new(
        ports,
        merge,
        redundancy,
        statistics,
        FaultyInputs::new(settings.planned()?.loops, injected),
        monitor,
    );
    let recorder = Recorder {
        // This loads the laws, so it comes first: their files may disappear once the flight has a log.
        report: ReportBuilder::new(settings, instance.name(), &meter, margin(armed.pace)?)?,
        settings,
        armed: &armed,
        files: RunFiles::create(files, settings, &logs, latencies, (tracking, laws))?,
        streams,
        host,
        roles,
        faults,
        seconds,
    };
    let outcome = recorder.record(&mut session);
    session.land(&meter);
    outcome
}

/// The recorder of a flight: its inputs, files and statistics, and the builder of its report.
pub struct Recorder<'a> {
    pub settings: &'a Settings,
    pub armed: &'a Armed,
    pub streams: MessageStreams,
    pub files: RunFiles<'a>,
    pub host: HostMonitor,
    pub roles: RoleStatuses,
    pub faults: InjectedFaults,
    report: ReportBuilder<'a>,
    /// Completed seconds of the flight.
    seconds: u64,
}

impl Recorder<'_> {
    fn record(mut self, session: &mut RoleSession) -> Result<Report, Failure> {
        let ending = self.record_flight(session)?;
        let closed_ns = now_ns();
        self.update_faults();
        self.wait_for_landing();
        self.drain(false)?;
        self.wait_for_swaps()?;
        let report = self.finish(ending, closed_ns)?;
        if let Some(not_fresh) = &report.deadlines.not_fresh {
            session.status.commands_missed = not_fresh.missed;
            session.status.commands_stale = not_fresh.stale;
        }
        session.status.wrenches_unwatched = report.theorem.ticks_unwatched;
        Ok(report)
    }

    /// Records until the plant closes the run or dies.
    fn record_flight(&mut self, session: &mut RoleSession) -> Result<EndReason, Failure> {
        loop {
            rest(self.armed.pace);
            self.drain(false)?;
            self.sample_host();
            let (statistics, status) = (self.streams.statistics(), &mut session.status);
            status.ticks_run = statistics.newest_tick();
            status.rounds += 1;
            (status.commands_missed, status.commands_stale) = statistics.commands_not_fresh();
            status.wrenches_unwatched = statistics.stages.theorem.unwatched;
            session.pass_on_stop();
            self.update_faults();
            self.files.flush_log();
            let run = self.armed.run.get();
            if now_ns() >= run.t0_ns + (self.seconds + 1) * NS_PER_S {
                self.seconds += 1;
                self.write_each_second()?;
            }
            let run = self.armed.run.get();
            if run.phase() == RunPhase::Closed {
                return Ok(run.ending());
            }
            if !session.plant_lives() {
                return Ok(EndReason::Failed);
            }
        }
    }

    fn write_each_second(&mut self) -> Result<(), Failure> {
        let every = self.settings.recorder.hlog_every_s;
        if self.seconds.is_multiple_of(every) {
            self.files
                .write_latencies(&mut self.streams.statistics_mut().series);
        }
        let report = self.report.build(self, None)?;
        self.files.write_partial_report(&report);
        self.files.flush_states();
        Ok(())
    }

    fn drain(&mut self, ends: bool) -> Result<(), Failure> {
        let Armed { pace, run, .. } = self.armed;
        self.streams.drain(*pace, run, &mut self.files, ends)
    }

    fn sample_host(&mut self) {
        let is_over = self.armed.run.get().phase() == RunPhase::Closed;
        let traced = self.host.sample(
            &self.roles,
            self.streams.active(),
            self.streams.statistics_mut(),
            is_over,
        );
        self.files.note(TRACE, traced);
    }

    fn update_faults(&mut self) {
        if let Some(faults) = self.faults.update() {
            self.files.log_injected(&injected_record(faults));
        }
    }

    /// Waits for the final status of the processes that still run.
    fn wait_for_landing(&self) {
        let until = now_ns() + LANDING_TIMEOUT.as_nanos() as u64;
        let landed = || {
            let loops = self.roles.loops(Channel::A);
            let is_over =
                |(status, fallen): (&Status, bool)| fallen || status.phase() == RolePhase::Landed;
            loops.iter().zip(fallen(&loops)).all(is_over)
        };
        while !landed() && now_ns() < until {
            sleep(DRAIN_EVERY);
        }
    }

    fn wait_for_swaps(&mut self) -> Result<(), Failure> {
        let until = now_ns() + LAST_SWAPS_TIMEOUT.as_nanos() as u64;
        let counted = self.armed.run.get().parameter_epoch;
        while !self.streams.has_all_swaps(counted) && now_ns() < until {
            sleep(DRAIN_EVERY);
            self.drain(false)?;
        }
        Ok(())
    }

    /// Completes the statistics and the files, and writes the report.
    fn finish(mut self, ending: EndReason, closed_ns: u64) -> Result<Report, Failure> {
        let run = self.armed.run.get();
        self.drain(true)?;
        let loops = self.roles.loops(self.streams.active());
        let statistics = self.streams.statistics_mut();
        statistics.finish(&run, closed_ns);
        let newest = statistics.newest_tick();
        statistics.deaths.finish(fallen(&loops), newest);
        self.files.finish_latencies(&mut statistics.series);
        self.streams.finish_states(&mut self.files);
        let statistics = self.streams.statistics_mut();
        let traced = self.host.finish(&loops, statistics, run.deadlines_missed);
        self.files.note(TRACE, traced);
        statistics
            .miss_runs
            .update(run.deadlines_missed, run.deadline_miss_run);
        self.files.prepare_final_report();
        let mut report = self.report.build(&self, Some(ending))?;
        let last_record = record(&[
            ("ending", ending.name()),
            ("ticks_run", &run.ticks_run.to_string()),
            ("ticks_skipped", &run.ticks_skipped.to_string()),
            ("deadlines_missed", &run.deadlines_missed.to_string()),
        ]);
        self.files.finish(&mut report, last_record);
        Ok(report)
    }
}

/// The report names this if the kernel's trace could not be read.
const TRACE: &str = "the trace of the loops' processor";
