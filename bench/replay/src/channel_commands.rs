//! The commands that the plant took in a flight whose channels fly different laws: of each tick, that of the channel that
//! flew then.

use std::collections::VecDeque;
use std::path::PathBuf;

use config::Settings;
use errors::Failure;
use faults::live::FaultKind;
use flight_log::entry::LogEntry;
use flight_log::reader::LogReader;
use ipc::DEEP;
use messages::channels::Candidate;
use messages::content::{NO_TICK, RotorSpeeds};
use messages::grid::Pace;
use messages::header::Message;
use messages::message_window::MessageWindow;
use messages::role::{Channel, Role};

pub struct ChannelCommands {
    pace: Pace,
    /// From which tick on which group is to fly, by its first channel.
    switchovers: VecDeque<(u64, Channel)>,
    /// The group that is to fly as soon as it has a usable command.
    requested: Option<Channel>,
    active: Channel,
    others: Vec<(Channel, CommandReader)>,
    taken: MessageWindow<RotorSpeeds>,
    next_tick: u64,
}

impl ChannelCommands {
    /// Opens the logs of the channels with other laws; nothing if there are none.
    pub fn open(
        settings: &Settings,
        pace: Pace,
        logs: &[(Channel, PathBuf)],
    ) -> Result<Option<Self>, Failure> {
        if logs.is_empty() {
            return Ok(None);
        }
        let groups = settings.groups();
        let planned = settings.planned()?;
        let switchovers = planned.table.begun().filter_map(|fault| match fault.kind {
            FaultKind::Switch { channel } => Some((fault.span.from, groups[channel as usize])),
            _ => None,
        });
        let mut switchovers: Vec<_> = switchovers.collect();
        switchovers.sort_by_key(|(tick, _)| *tick);
        let open = |(channel, log): &(Channel, PathBuf)| {
            let (reader, newest) = (LogReader::open(log)?, None);
            Ok((*channel, CommandReader { reader, newest }))
        };
        Ok(Some(Self {
            pace,
            switchovers: switchovers.into(),
            requested: None,
            active: Channel::A,
            others: logs.iter().map(open).collect::<Result<_, Failure>>()?,
            taken: MessageWindow::keeping(DEEP),
            next_tick: 0,
        }))
    }

    /// The commands up to the one of tick `last`, with those of channel a in `own`.
    pub fn up_to(
        &mut self,
        last: u64,
        own: &MessageWindow<RotorSpeeds>,
    ) -> Result<&MessageWindow<RotorSpeeds>, Failure> {
        while last != NO_TICK && self.next_tick <= last {
            let tick = self.next_tick;
            while let Some((_, group)) = self.switchovers.pop_front_if(|(from, _)| *from <= tick) {
                self.requested = Some(group);
            }
            if let Some(requested) = self.requested
                && let Some(command) = self.command(requested, tick, own)?
                && self.is_usable(requested, &command)
            {
                (self.active, self.requested) = (requested, None);
            }
            if let Some(command) = self.command(self.active, tick, own)? {
                self.taken.push(command);
                self.taken.advance();
            }
            self.next_tick += 1;
        }
        Ok(&self.taken)
    }

    fn command(
        &mut self,
        group: Channel,
        tick: u64,
        own: &MessageWindow<RotorSpeeds>,
    ) -> Result<Option<Message<RotorSpeeds>>, Failure> {
        match self.others.iter_mut().find(|(of, _)| *of == group) {
            Some((_, commands)) => commands.of(tick),
            None => Ok(own.of(tick).copied()),
        }
    }

    fn is_usable(&self, group: Channel, command: &Message<RotorSpeeds>) -> bool {
        let sent_ns = command.envelope.stamps_of(Role::Mixer).send_ns;
        let effective_tick = self.pace.effective_tick(command.envelope.tick, sent_ns);
        Candidate::of(group, command, effective_tick).is_some_and(|it| it.is_usable())
    }
}

/// The commands in a log, in order.
struct CommandReader {
    reader: LogReader,
    newest: Option<Message<RotorSpeeds>>,
}

impl CommandReader {
    fn of(&mut self, tick: u64) -> Result<Option<Message<RotorSpeeds>>, Failure> {
        while self.newest.is_none_or(|it| it.envelope.tick < tick) {
            match self.reader.next_entry()? {
                Some(LogEntry::RotorSpeeds(message)) => self.newest = Some(*message),
                Some(_) => {}
                None => return Ok(None),
            }
        }
        Ok(self.newest.filter(|it| it.envelope.tick == tick))
    }
}
