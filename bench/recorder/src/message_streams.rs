//! Reads the topics and distributes each message: to observers, the log, the statistics and the Lyapunov monitor.

use analysis::flight_statistics::FlightStatistics;
use analysis::states::{Joined, Joiner, LoopMessage};
use errors::Failure;
use flight_log::entry::LogEntry;
use ipc::error::Error;
use ipc::{BlackboardReader, Wire};
use messages::content::{Stamped, State, Wrench};
use messages::grid::Pace;
use messages::header::Message;
use messages::inspection::{Expected, Rejections};
use messages::role::Channel;
use process::session::JoinedRun;

use super::channel_merge::ChannelMerge;
use super::inner_states::InnerStates;
use super::pairs::Pairs;
use super::ports::{ChannelPorts, Ports, Relays, horizon};
use super::run_files::RunFiles;
use controller::flight_monitor::FlightMonitor;

use messages::channels::{Arrangement, Redundancy};

/// The report names this if messages could not be passed on to observers.
const OBSERVERS: &str = "what observers see";

/// The recorder's ports, opened before the plant takes off.
pub struct StreamPorts {
    receivers: Ports,
    /// Of the channels after the first.
    others: Vec<(Channel, ChannelPorts)>,
    relays: Relays,
}

impl StreamPorts {
    pub fn open(wire: &Wire, channels: usize) -> Result<Self, Error> {
        let others = Channel::first(channels).skip(1);
        Ok(Self {
            receivers: Ports::new(wire, Channel::A)?,
            others: others
                .map(|channel| Ok((channel, ChannelPorts::new(wire, channel)?)))
                .collect::<Result<_, Error>>()?,
            relays: Relays::new(wire)?,
        })
    }

    pub fn arm(&mut self, expected: Expected) -> Result<(), Error> {
        let mut others = self.others.iter_mut();
        others.try_for_each(|(_, ports)| ports.arm(expected))?;
        self.receivers.arm(expected)
    }
}

pub struct MessageStreams {
    ports: StreamPorts,
    /// Of a flight with several channels.
    merge: Option<ChannelMerge>,
    /// The plant's account of the channels.
    redundancy: Option<BlackboardReader<Redundancy>>,
    pub statistics: FlightStatistics,
    pairs: Pairs,
    inner_states: InnerStates,
    monitor: FlightMonitor,
    joiner: Joiner,
    parameter_epoch: u64,
}

impl MessageStreams {
    pub fn new(
        ports: StreamPorts,
        arrangement: Arrangement,
        redundancy: Option<BlackboardReader<Redundancy>>,
        statistics: FlightStatistics,
        inner_states: InnerStates,
        monitor: FlightMonitor,
    ) -> Self {
        let has_channels = arrangement.channels > 1;
        Self {
            ports,
            merge: has_channels.then(|| ChannelMerge::new(arrangement)),
            redundancy,
            statistics,
            pairs: Pairs::default(),
            inner_states,
            monitor,
            joiner: Joiner::default(),
            parameter_epoch: 0,
        }
    }

    pub fn redundancy(&self) -> Option<Redundancy> {
        self.redundancy.as_ref().map(BlackboardReader::get)
    }

    /// Reads every message that has arrived since the last call; if it `ends`, no message arrives any more.
    pub fn drain(
        &mut self,
        pace: Pace,
        run: &JoinedRun,
        files: &mut RunFiles<'_>,
        ends: bool,
    ) -> Result<(), Failure> {
        let horizon = horizon(pace, || run.get());
        let mut newest_state = self.statistics.newest_tick();
        // Takes a message of the flight, for everything but the logs of the channels.
        let mut take = |files: &mut RunFiles<'_>, entry: &LogEntry| {
            files.log(entry, |of| of.is_none());
            let relayed = self.ports.relays.pass_on(entry);
            files.note(OBSERVERS, relayed.map_err(Failure::from));
            let tick = entry.envelope().tick;
            self.statistics.take(entry);
            if let Some(part) = LoopMessage::of(entry) {
                self.joiner.take(tick, part);
            }
            match entry {
                LogEntry::State(message) => {
                    self.parameter_epoch = message.content.parameter_epoch;
                    self.pairs.state(&self.inner_states.with_faults(message));
                }
                LogEntry::Wrench(message) => self.pairs.wrench(message),
                _ => {}
            }
        };
        if let Some(merge) = &mut self.merge {
            // Read first: the messages that it counts have arrived by then.
            let account = self.redundancy.as_ref().map(BlackboardReader::get);
            let account = account.unwrap_or_default();
            self.ports.receivers.drain(horizon, |entry| {
                let is_of_channel = merge.take(Channel::A, entry);
                files.log(entry, |of| {
                    of.is_some_and(|it| it == Channel::A || !is_of_channel)
                });
                if !is_of_channel {
                    newest_state = newest_state.max(entry.envelope().tick);
                    take(files, entry);
                }
            })?;
            for (channel, ports) in &mut self.ports.others {
                ports.drain(horizon, |entry| {
                    merge.take(*channel, entry);
                    files.log(entry, |of| of == Some(*channel));
                })?;
            }
            let newest = (!ends).then_some(newest_state);
            merge.close(newest, &account, |entry| take(files, entry));
        } else {
            let receivers = &mut self.ports.receivers;
            receivers.drain(horizon, |entry| take(files, entry))?;
        }
        while let Some((wrench, state)) = self.pairs.paired() {
            self.monitor_wrench(&wrench, state.as_ref(), files);
        }
        while let Some(joined) = self.joiner.next_complete() {
            self.write_state(&joined, files);
        }
        Ok(())
    }

    /// Whether every parameter change that the plant counted has been received.
    pub fn has_all_swaps(&self, counted_by_plant: u64) -> bool {
        // The plant also counts the change of a tick that was skipped at the very end, which is in no state.
        self.statistics.swaps_seen >= self.parameter_epoch.max(counted_by_plant)
    }

    /// Passes the last wrenches to the monitor; no state arrives any more.
    pub fn finish_monitor(&mut self, files: &mut RunFiles<'_>) {
        while let Some((wrench, state)) = self.pairs.rest() {
            self.monitor_wrench(&wrench, state.as_ref(), files);
        }
    }

    /// Writes the states whose tick is incomplete; no message arrives any more.
    pub fn finish_states(&mut self, files: &mut RunFiles<'_>) {
        while let Some(joined) = self.joiner.rest() {
            self.write_state(&joined, files);
        }
        files.finish_states();
    }

    /// Messages that did not pass inspection.
    pub fn rejections(&self) -> Rejections {
        let others = self.ports.others.iter();
        let own = self.ports.receivers.rejections();
        others.fold(own, |all, (_, ports)| all.and(&ports.rejections()))
    }

    pub const fn incomplete_ticks(&self) -> u64 {
        self.joiner.incomplete
    }

    /// Evaluates the Lyapunov monitor for a wrench, then publishes, logs and counts its result.
    fn monitor_wrench(
        &mut self,
        wrench: &Message<Wrench>,
        state: Option<&Stamped<State>>,
        files: &mut RunFiles<'_>,
    ) {
        let result = self.monitor.watch(wrench, state);
        match &result {
            Some(message) => {
                let entry = LogEntry::Theorem(*message);
                let relayed = self.ports.relays.pass_on(&entry);
                files.note(OBSERVERS, relayed.map_err(Failure::from));
                files.log(&entry, |of| of.is_none());
                self.statistics.theorem(message);
                let innovation = self.monitor.innovation();
                self.statistics.theorem.innovation(&innovation);
            }
            None if self.monitor.applies() => self.statistics.theorem.count_unwatched(),
            None => {}
        }
        let result = result.map(|message| message.content);
        let content = LoopMessage::Wrench(wrench.content, result);
        self.joiner.take(wrench.envelope.tick, content);
    }

    fn write_state(&mut self, joined: &Joined, files: &mut RunFiles<'_>) {
        self.statistics.tracer.take(joined);
        files.write_state(joined);
    }
}
