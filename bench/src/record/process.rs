//! The recorder's process: drains the topics, writes the files of the flight's directory.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use controller::outer::position_error_m;
use hdrhistogram::serialization::V2DeflateSerializer;
use hdrhistogram::serialization::interval_log::{IntervalLogWriter, IntervalLogWriterBuilder};
use shared::boards::{Ending, RolePhase, Run, RunPhase, Status};
use shared::clock::{NS_PER_S, now_ns};
use shared::inspection::Rejections;
use shared::messages::{RotorSpeeds, Setpoint, State, SwapRecord, Wrench};
use shared::role::{ROLES, Role};
use shared::rt::UsageMeter;
use shared::station::{Armed, Station, status_board};
use shared::wire::{BoardReader, DEEP, Receiver, Wire};

use super::host::{CpuTimes, Host};
use super::report::{self, Gate, Report, RunLength};
use super::sections::{buckets, rejected, role_section, verdict};
use super::series::{Series, Statistics};
use super::states::{Joiner, Part, StatesWriter};
use super::tally::{TOPICS, Tally, is_last_word};
use super::text;
use super::theorem::Theorem;
use crate::failure::{Failure, InFile as _};
use crate::in_process::TickRecord;
use crate::plot::FlightPlot;
use crate::settings::Settings;

/// How often the topics are drained: far less than the receivers' depth takes to fill.
const DRAIN_EVERY: Duration = Duration::from_millis(10);
/// How long the recorder waits for the roles' last figures.
const LANDING: Duration = Duration::from_secs(2);

/// Where the recorder writes.
#[derive(Clone, Debug)]
pub struct Files {
    /// The flight's directory.
    pub directory: PathBuf,
    /// A second place for the states.
    pub states: Option<PathBuf>,
}

/// Records until the plant closes the run; gives the flight's report.
///
/// # Errors
/// Those of the station and the ports; [`Failure`] names a file that cannot be written.
pub fn run(mut station: Station, settings: &Settings, files: &Files) -> Result<Report, Failure> {
    let mut ports = Ports::new(station.wire())?;
    let host = Host::read();
    let armed = station.join(|expected, _| ports.arm(expected))?;
    let meter = UsageMeter::start();
    let path = files.directory.join("latency.hlog");
    let mut log_file = BufWriter::new(File::create(&path).in_file("write", &path)?);
    let mut serializer = V2DeflateSerializer::new();
    let start = UNIX_EPOCH + Duration::from_nanos(armed.run.get().t0_wall_ns);
    let mut log = begin_log(&mut log_file, &mut serializer, start)?;
    let mut recorder = Recorder::new(&armed, settings, files, host, station.wire())?;
    let outcome = recorder.record(&mut ports, &mut station, &armed, &meter, &mut log);
    station.land(&meter);
    outcome
}

fn begin_log<'a>(
    file: &'a mut BufWriter<File>,
    serializer: &'a mut V2DeflateSerializer,
    start: SystemTime,
) -> Result<IntervalLogWriter<'a, 'a, BufWriter<File>, V2DeflateSerializer>, Failure> {
    IntervalLogWriterBuilder::new()
        .add_comment("[ironbird: values in nanoseconds, a tag per series, an interval per second]")
        .with_start_time(start)
        .with_base_time(start)
        .with_max_value_divisor(1e6)
        .begin_log_with(file, serializer)
        .map_err(|e| Failure::failed(format!("cannot write latency.hlog: {e:?}")))
}

struct Ports {
    states: Receiver<State>,
    setpoints: Receiver<Setpoint>,
    wrenches: Receiver<Wrench>,
    rotor_speeds: Receiver<RotorSpeeds>,
    swaps: Receiver<SwapRecord>,
}

impl Ports {
    fn new(wire: &Wire) -> Result<Self, shared::error::Error> {
        Ok(Self {
            states: wire.receiver(DEEP)?,
            setpoints: wire.receiver(DEEP)?,
            wrenches: wire.receiver(DEEP)?,
            rotor_speeds: wire.receiver(DEEP)?,
            swaps: wire.receiver(DEEP)?,
        })
    }

    fn arm(&mut self, expected: shared::inspection::Expected) -> Result<(), shared::error::Error> {
        self.states.arm(expected)?;
        self.setpoints.arm(expected)?;
        self.wrenches.arm(expected)?;
        self.rotor_speeds.arm(expected)?;
        self.swaps.arm(expected)
    }

    fn rejections(&self) -> Rejections {
        self.states
            .rejections()
            .and(self.setpoints.rejections())
            .and(self.wrenches.rejections())
            .and(self.rotor_speeds.rejections())
            .and(self.swaps.rejections())
    }
}

struct Recorder<'a> {
    settings: &'a Settings,
    directory: &'a Path,
    instance: String,
    host: Host,
    tally: Tally,
    joiner: Joiner,
    states: Vec<StatesWriter>,
    plot: FlightPlot,
    crew: BTreeMap<Role, BoardReader<Status>>,
    cpu_times: CpuTimes,
    period_s: f64,
}

impl<'a> Recorder<'a> {
    fn new(armed: &Armed, settings: &'a Settings, files: &'a Files, host: Host, wire: &Wire) -> Result<Self, Failure> {
        let period_s = settings.flight.period_s;
        let every = settings.recorder.states_every_ticks;
        let mut states = vec![StatesWriter::create(&files.directory.join("states.csv"), period_s, every)?];
        if let Some(path) = &files.states {
            states.push(StatesWriter::create(path, period_s, every)?);
        }
        let mut crew = BTreeMap::new();
        for role in ROLES {
            if let Some(board) = wire.board_reader(&status_board(role))? {
                crew.insert(role, board);
            }
        }
        Ok(Self {
            settings,
            directory: &files.directory,
            instance: wire.instance().name().into(),
            host,
            tally: Tally::new(armed.pace, armed.run.get().t0_ns, period_s)?,
            joiner: Joiner::default(),
            states,
            plot: FlightPlot::new(period_s, armed.last_tick),
            crew,
            cpu_times: CpuTimes::read(),
            period_s,
        })
    }

    fn record(
        &mut self,
        ports: &mut Ports,
        station: &mut Station,
        armed: &Armed,
        meter: &UsageMeter,
        log: &mut IntervalLogWriter<'_, '_, BufWriter<File>, V2DeflateSerializer>,
    ) -> Result<Report, Failure> {
        let second = Duration::from_secs(1);
        let mut seconds = 0;
        let ending = loop {
            sleep(DRAIN_EVERY);
            self.drain(ports)?;
            station.status.ticks_run = self.tally.newest_tick();
            station.pass_on_stop();
            if now_ns() >= armed.run.get().t0_ns + (seconds + 1) * NS_PER_S {
                self.tally.series.close_second(log, seconds as u32 * second, second)?;
                seconds += 1;
                self.report(&armed.run.get(), ports, meter, None)?.write(&self.directory.join("report.json"))?;
            }
            let run = armed.run.get();
            if run.phase() == RunPhase::Closed {
                break run.ending();
            }
            if !station.plant_lives() {
                break Ending::Failed;
            }
        };
        self.await_landing();
        self.drain(ports)?;
        self.tally.series.close_second(log, seconds as u32 * second, second)?;
        self.joiner.finish();
        for states in &mut self.states {
            states.flush()?;
        }
        let run = armed.run.get();
        self.tally.miss_runs.update(run.deadlines_missed, run.deadline_miss_run);
        let report = self.report(&run, ports, meter, Some(ending))?;
        report.write(&self.directory.join("report.json"))?;
        let path = self.directory.join("report.txt");
        std::fs::write(&path, text::render(&report)).in_file("write", &path)?;
        let title = format!("{} with gains {}, {}", report.run.trajectory, report.run.preset, report.run.started);
        self.plot.write(&self.directory.join("flight.svg"), &title)?;
        Ok(report)
    }

    /// Waits for the figures of roles that still live.
    fn await_landing(&self) {
        let until = now_ns() + LANDING.as_nanos() as u64;
        let landed = || {
            self.crew
                .iter()
                .filter(|(role, _)| **role != Role::Record)
                .all(|(_, board)| board.get().phase() == RolePhase::Landed)
        };
        while !landed() && now_ns() < until {
            sleep(DRAIN_EVERY);
        }
    }

    fn drain(&mut self, ports: &mut Ports) -> Result<(), Failure> {
        // What passed the loops' own inspection is recorded whatever tick it is of.
        let any_tick = u64::MAX - 1;
        let mut complete: Vec<TickRecord> = Vec::new();
        let (tally, joiner) = (&mut self.tally, &mut self.joiner);
        ports.states.drain(any_tick, |message| {
            tally.state(message);
            complete.extend(joiner.take(message.envelope.tick, Part::State(message.content)));
        })?;
        ports.setpoints.drain(any_tick, |message| {
            tally.setpoint(message);
            complete.extend(joiner.take(message.envelope.tick, Part::Setpoint(message.content)));
        })?;
        ports.wrenches.drain(any_tick, |message| {
            tally.wrench(message);
            complete.extend(joiner.take(message.envelope.tick, Part::Wrench(message.content)));
        })?;
        ports.rotor_speeds.drain(any_tick, |message| {
            tally.rotor_speeds(message);
            if !is_last_word(message) {
                complete.extend(joiner.take(message.envelope.tick, Part::RotorSpeeds(message.content)));
            }
        })?;
        ports.swaps.drain(any_tick, |message| tally.swap(message))?;
        complete.sort_by_key(|record| record.tick);
        for record in &complete {
            if let Some(setpoint) = &record.setpoint {
                self.tally.position_error(position_error_m(&record.state, setpoint));
            }
            self.plot.take(record);
            for states in &mut self.states {
                states.write(record)?;
            }
        }
        Ok(())
    }

    /// The numbers so far; final with an ending.
    fn report(&self, run: &Run, ports: &Ports, meter: &UsageMeter, ending: Option<Ending>) -> Result<Report, Failure> {
        let ticks = self.tally.ticks(run);
        let late = self.tally.series.flight(Series::Late);
        let missed = self.tally.miss_runs.missed();
        let deadlines = report::Deadlines {
            missed,
            missed_ppm: missed as f64 * 1e6 / (ticks.run + ticks.skipped).max(1) as f64,
            missed_by_stamps: self.tally.late_commands,
            late: late.map(buckets).unwrap_or_default(),
            runs: self
                .tally
                .miss_runs
                .lengths()
                .into_iter()
                .map(|(length_ticks, count)| RunLength { length_ticks, count })
                .collect(),
        };
        let series = self.tally.series.statistics();
        let theorem = self.tally.theorem.section();
        let gates = self.gates(&ticks, &deadlines, &series, &theorem, ending);
        let lost = TOPICS.iter().zip(self.tally.lost()).map(|(topic, lost)| ((*topic).to_owned(), lost)).collect();
        let elapsed_ns = now_ns().saturating_sub(run.t0_ns).max(1);
        let started = jiff::Timestamp::from_nanosecond(i128::from(run.t0_wall_ns)).unwrap_or_default();
        Ok(Report {
            schema: report::SCHEMA.into(),
            run: report::Run {
                run_id: run.run_id,
                started: started.strftime("%Y-%m-%d %H:%M:%S UTC").to_string(),
                instance: self.instance.clone(),
                version: env!("CARGO_PKG_VERSION").into(),
                trajectory: self.settings.flight.trajectory.name().into(),
                preset: self.settings.flight.preset.name().into(),
                period_us: self.period_s * 1e6,
                wall_period_us: run.period_ns as f64 / 1e3,
                settings_fingerprint: format!("{:016x}", run.settings),
                ending: ending.unwrap_or(Ending::None).words().into(),
                in_flight: ending.is_none(),
            },
            verdict: verdict(gates, ending),
            ticks,
            deadlines,
            flight: self.tally.flight(),
            theorem,
            swaps: self.tally.swaps.clone(),
            series,
            roles: self.crew.iter().map(|(role, board)| (role.name().to_owned(), role_section(&board.get()))).collect(),
            recorder: report::RecorderSection {
                lost,
                rejected: rejected(&ports.rejections()),
                incomplete_ticks: self.joiner.incomplete,
                cpu_percent: 100.0 * meter.read().cpu_ns as f64 / elapsed_ns as f64,
            },
            host: self.host.clone(),
            steal: self.cpu_times.steal_until(&CpuTimes::read()),
        })
    }

    fn gates(
        &self,
        ticks: &report::Ticks,
        deadlines: &report::Deadlines,
        series: &[Statistics],
        theorem: &Theorem,
        ending: Option<Ending>,
    ) -> Vec<Gate> {
        let mut gates = vec![
            Gate {
                name: "flight envelope".into(),
                limit: format!("position error <= {} m, pitch <= 80 deg", self.settings.flight.position_error_max_m),
                value: ending.unwrap_or(Ending::None).words().into(),
                held: !ending.is_some_and(Ending::left_envelope),
            },
            Gate {
                name: "ticks run + skipped = elapsed / period".into(),
                limit: ticks.elapsed_periods.to_string(),
                value: (ticks.run + ticks.skipped).to_string(),
                held: ticks.identity_holds,
            },
        ];
        let ppm = self.settings.recorder.max_miss_rate_ppm;
        if ppm >= 0.0 {
            gates.push(Gate {
                name: "deadlines missed per million".into(),
                limit: format!("<= {ppm}"),
                value: format!("{:.1}", deadlines.missed_ppm),
                held: deadlines.missed_ppm <= ppm,
            });
        }
        let limit_us = self.settings.recorder.max_loop_p999_us;
        if limit_us >= 0.0 {
            let value = series.iter().find(|series| series.name == Series::Loop.name()).and_then(|s| s.p999_us);
            gates.push(Gate {
                name: "loop p99.9 [us]".into(),
                limit: format!("<= {limit_us}"),
                value: value.map_or_else(|| "too few samples".into(), |us| format!("{us:.1}")),
                held: value.is_some_and(|us| us <= limit_us),
            });
        }
        if self.settings.recorder.gate_theorem {
            gates.push(Gate::theorem(theorem));
        }
        gates
    }
}
