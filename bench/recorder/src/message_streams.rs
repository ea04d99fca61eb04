//! Reads the topics and distributes each message: to observers, the log, the statistics and the Lyapunov monitor.

use analysis::flight_statistics::{FlightStatistics, is_final_command};
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
use messages::telemetry::Telemetry;

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
    /// Of a flight with several channels: for each group with the same laws, by its first channel.
    merges: Vec<(Channel, ChannelMerge)>,
    /// The plant's account of the channels.
    redundancy: Option<BlackboardReader<Redundancy>>,
    pub statistics: FlightStatistics,
    pairs: Pairs,
    inner_states: InnerStates,
    monitor: FlightMonitor,
    joiner: Joiner,
    parameter_epoch: u64,
    arrangement: Arrangement,
}

impl MessageStreams {
    pub fn new(
        ports: StreamPorts,
        pace: Pace,
        arrangement: Arrangement,
        redundancy: Option<BlackboardReader<Redundancy>>,
        statistics: FlightStatistics,
        inner_states: InnerStates,
        monitor: FlightMonitor,
    ) -> Self {
        let leaders = arrangement.leaders();
        // Which group flies is known when the next tick has its state.
        let behind = if leaders.clone().count() > 1 { 2 } else { 0 };
        let merge_of = |leader| {
            let own = Channel::first(arrangement.channels);
            let own = own.filter(|it| arrangement.are_alike(*it, leader));
            (leader, ChannelMerge::new(own.count(), pace, behind))
        };
        let merges = match arrangement.channels {
            1 => Vec::new(),
            _ => leaders.map(merge_of).collect(),
        };
        Self {
            ports,
            merges,
            arrangement,
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
        let Self {
            ports:
                StreamPorts {
                    receivers,
                    others,
                    relays,
                },
            merges,
            redundancy,
            arrangement,
            statistics,
            joiner,
            pairs,
            inner_states,
            parameter_epoch,
            ..
        } = self;
        let mut newest_state = statistics.newest_tick();
        // Logs the message for its group, or for all groups; the rest sees only what is flown.
        let mut take = |entry: &LogEntry, group: Option<Channel>, is_flown: bool| {
            files.log(entry, group);
            let mut flown = *entry;
            if let (Some(telemetry), true) = (
                flown.telemetry_mut(),
                group.is_some_and(|it| it != Channel::A),
            ) {
                // The report and observers know the signals of channel a.
                *telemetry = Telemetry::default();
            }
            let entry = &flown;
            if !is_flown {
                return;
            }
            files.note(OBSERVERS, relays.pass_on(entry).map_err(Failure::from));
            let tick = entry.envelope().tick;
            match entry {
                LogEntry::State(message) => {
                    *parameter_epoch = message.content.parameter_epoch;
                    statistics.state(message);
                    pairs.state(&inner_states.with_faults(message));
                    joiner.take(tick, LoopMessage::State(message.content));
                }
                LogEntry::Setpoint(message) => {
                    statistics.setpoint(message);
                    joiner.take(tick, LoopMessage::Setpoint(message.content));
                }
                LogEntry::Wrench(message) => {
                    statistics.wrench(message);
                    pairs.wrench(message);
                }
                LogEntry::RotorSpeeds(message) => {
                    statistics.rotor_speeds(message);
                    if !is_final_command(message) {
                        joiner.take(tick, LoopMessage::RotorSpeeds(message.content));
                    }
                }
                LogEntry::Swap(message) => statistics.swap(message),
                // The recorder computes these itself.
                LogEntry::Theorem(_) => {}
            }
        };
        if merges.is_empty() {
            receivers.drain(horizon, |entry| take(entry, None, true))?;
        } else {
            let mut merge = |channel, entry: &LogEntry| {
                let group = arrangement.group(channel);
                let merge = merges.iter_mut().find(|(leader, _)| *leader == group);
                merge.is_some_and(|(_, merge)| merge.take(channel, entry))
            };
            receivers.drain(horizon, |entry| {
                if !merge(Channel::A, entry) {
                    newest_state = newest_state.max(entry.envelope().tick);
                    take(entry, None, true);
                }
            })?;
            for (channel, ports) in others {
                ports.drain(horizon, |entry| _ = merge(*channel, entry))?;
            }
            let redundancy = redundancy.as_ref().map(BlackboardReader::get);
            let flown = |tick| redundancy.map_or(Channel::A, |it| it.group_at(tick));
            let mut closed = Vec::new();
            for (group, merge) in merges {
                let newest = (!ends).then_some(newest_state);
                merge.close(newest, |entry| closed.push((*group, *entry)));
            }
            closed.sort_by_key(|(_, entry)| entry.envelope().tick);
            for (group, entry) in &closed {
                take(entry, Some(*group), flown(entry.envelope().tick) == *group);
            }
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
                files.log(&entry, None);
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
