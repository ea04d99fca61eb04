//! Reads the topics and distributes each message: to observers, the log, the statistics and the Lyapunov monitor.

use analysis::flight_statistics::FlightStatistics;
use analysis::states::{Joined, Joiner};
use errors::Failure;
use flight_log::causal_order::CausalOrder;
use flight_log::channel_merge::ChannelMerge;
use flight_log::entry::LogEntry;
use ipc::clock::{Horizon, now_ns};
use ipc::error::Error;
use ipc::{BlackboardReader, DEEP, Wire};
use messages::content::{Setpoint, Stamped, State, Wrench};
use messages::grid::Pace;
use messages::header::Message;
use messages::inspection::{Expected, Rejections};
use messages::message_window::MessageWindow;
use messages::role::Channel;
use process::session::JoinedRun;

use super::faulty_inputs::FaultyInputs;
use super::ports::{ChannelPorts, Ports, Relays, horizon};
use super::run_files::RunFiles;
use controller::flight_monitor::FlightMonitor;

use messages::channels::Redundancy;

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

    /// Reads what has arrived of every topic.
    fn drain(&mut self, horizon: impl Horizon, order: &mut CausalOrder) -> Result<(), Error> {
        self.receivers
            .drain(horizon, |entry| order.receive(Channel::A, entry))?;
        for (channel, ports) in &mut self.others {
            ports.drain(horizon, |entry| order.receive(*channel, entry))?;
        }
        Ok(())
    }
}

pub struct MessageStreams {
    ports: StreamPorts,
    order: CausalOrder,
    /// Of a flight with several channels.
    merge: Option<ChannelMerge>,
    /// The plant's account of the channels.
    redundancy: Option<BlackboardReader<Redundancy>>,
    flight: FlightStream,
}

/// The events of the flight's messages, in the order in which they were sent.
pub struct FlightStream {
    pub statistics: FlightStatistics,
    /// The newest states: a stage that was stopped between reading and working may use one this old.
    states: MessageWindow<State>,
    setpoints: MessageWindow<Setpoint>,
    /// Inputs of the newest wrench.
    used: (Stamped<State>, Stamped<Setpoint>),
    inputs: FaultyInputs,
    monitor: FlightMonitor,
    joiner: Joiner,
    parameter_epoch: u64,
}

impl MessageStreams {
    pub fn new(
        ports: StreamPorts,
        merge: Option<ChannelMerge>,
        redundancy: Option<BlackboardReader<Redundancy>>,
        statistics: FlightStatistics,
        inputs: FaultyInputs,
        monitor: FlightMonitor,
    ) -> Self {
        Self {
            ports,
            order: CausalOrder::default(),
            merge,
            redundancy,
            flight: FlightStream {
                statistics,
                states: MessageWindow::keeping(DEEP),
                setpoints: MessageWindow::keeping(DEEP),
                used: (Stamped::never(), Stamped::never()),
                inputs,
                monitor,
                joiner: Joiner::default(),
                parameter_epoch: 0,
            },
        }
    }

    pub const fn statistics(&self) -> &FlightStatistics {
        &self.flight.statistics
    }

    pub const fn statistics_mut(&mut self) -> &mut FlightStatistics {
        &mut self.flight.statistics
    }

    pub fn redundancy(&self) -> Option<Redundancy> {
        self.redundancy.as_ref().map(BlackboardReader::get)
    }

    /// The channel whose commands fly.
    pub fn active(&self) -> Channel {
        let redundancy = self.redundancy();
        redundancy.map_or(Channel::A, |it| it.active_channel())
    }

    /// Reads every message that has arrived since the last call; if it `ends`, no message arrives any more.
    pub fn drain(
        &mut self,
        pace: Pace,
        run: &JoinedRun,
        files: &mut RunFiles<'_>,
        ends: bool,
    ) -> Result<(), Failure> {
        let Self {
            ports,
            order,
            merge,
            flight,
            ..
        } = self;
        let begun_ns = if ends { u64::MAX } else { now_ns() };
        ports.drain(horizon(pace, || run.get()), order)?;
        let relays = &mut ports.relays;
        order.release(begun_ns, |channel, entry| {
            files.next_position();
            match merge {
                None => flight.take(entry, relays, files),
                Some(merge) => {
                    let is_of_all = matches!(entry, LogEntry::State(_) | LogEntry::Swap(_));
                    let is_own = !matches!(entry, LogEntry::Decisions(_));
                    files.log(entry, |of| {
                        of.is_some_and(|of| is_of_all || is_own && of == channel)
                    });
                    merge.take(channel, entry, |entry| flight.take(entry, relays, files));
                }
            }
        });
        files.next_position();
        if let Some(merge) = merge.as_mut().filter(|_| ends) {
            merge.finish(|entry| flight.take(entry, relays, files));
        }
        flight.write_complete(files);
        Ok(())
    }

    /// Whether every parameter change that the plant counted has been received.
    pub fn has_all_swaps(&self, counted_by_plant: u64) -> bool {
        self.flight.statistics.swaps_seen >= self.flight.parameter_epoch.max(counted_by_plant)
    }

    /// Writes the states whose tick is incomplete; no message arrives any more.
    pub fn finish_states(&mut self, files: &mut RunFiles<'_>) {
        while let Some(joined) = self.flight.joiner.rest() {
            self.flight.write_state(&joined, files);
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
        self.flight.joiner.incomplete
    }
}

impl FlightStream {
    /// Takes a message of the flight, for everything but the logs of the channels.
    fn take(&mut self, entry: &LogEntry, relays: &mut Relays, files: &mut RunFiles<'_>) {
        self.publish(entry, relays, files);
        self.joiner.take(entry);
        let (inputs, autopsy) = (&mut self.inputs, &mut self.statistics.autopsy);
        let withheld = |stage| {
            if let Some(autopsy) = autopsy {
                autopsy.withheld(entry.envelope().tick, stage);
            }
        };
        match entry {
            LogEntry::State(message) => {
                self.parameter_epoch = message.content.parameter_epoch;
                self.states.push(&inputs.state(message, withheld));
            }
            LogEntry::Setpoint(message) => {
                let passed = inputs.setpoints.pass(message, withheld);
                self.setpoints.push(&Message {
                    content: passed.unwrap_or(message.content),
                    ..*message
                });
            }
            LogEntry::Wrench(message) => {
                inputs.wrenches.pass(message, withheld);
                self.monitor_wrench(message, relays, files);
            }
            LogEntry::RotorSpeeds(message) => {
                inputs.rotor_speeds.pass(message, withheld);
                self.monitor
                    .command(message.envelope.tick, &message.content);
            }
            _ => {}
        }
    }

    fn publish(&mut self, entry: &LogEntry, relays: &mut Relays, files: &mut RunFiles<'_>) {
        files.log(entry, |of| of.is_none());
        let relayed = relays.pass_on(entry);
        files.note(OBSERVERS, relayed.map_err(Failure::from));
        self.statistics.take(entry);
    }

    /// Evaluates the Lyapunov monitor for a wrench, then publishes, logs and counts its result.
    fn monitor_wrench(
        &mut self,
        wrench: &Message<Wrench>,
        relays: &mut Relays,
        files: &mut RunFiles<'_>,
    ) {
        let [of_state, of_setpoint, _] = wrench.envelope.input_tick;
        let (state, setpoint) = (
            self.states.input_kept(of_state, &mut self.used.0),
            self.setpoints.input_kept(of_setpoint, &mut self.used.1),
        );
        let result = self.monitor.watch(wrench, state, setpoint);
        match result {
            Some(message) => {
                let entry = LogEntry::Theorem(message);
                self.publish(&entry, relays, files);
                self.joiner.take(&entry);
                self.statistics.stages.theorem.monitored(&self.monitor);
            }
            None if self.monitor.applies() => self.statistics.stages.theorem.count_unwatched(),
            None => {}
        }
    }

    fn write_complete(&mut self, files: &mut RunFiles<'_>) {
        while let Some(joined) = self.joiner.next_complete() {
            self.write_state(&joined, files);
        }
    }

    fn write_state(&mut self, joined: &Joined, files: &mut RunFiles<'_>) {
        self.statistics.tracer.take(joined);
        files.write_state(joined);
    }
}
