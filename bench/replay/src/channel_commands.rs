//! The commands that the plant took in a flight whose channels fly different laws: of each tick, that of the channel that
//! flew then.

use std::path::PathBuf;

use config::Settings;
use errors::Failure;
use faults::live::FaultKind;
use flight_log::entry::LogEntry;
use flight_log::reader::LogReader;
use ipc::DEEP;
use messages::content::{NO_TICK, RotorSpeeds};
use messages::header::Message;
use messages::message_window::MessageWindow;
use messages::role::Channel;

pub struct ChannelCommands {
    /// From which tick on which group flies, by its first channel.
    switchovers: Vec<(u64, Channel)>,
    others: Vec<(Channel, CommandReader)>,
    taken: MessageWindow<RotorSpeeds>,
    next_tick: u64,
}

impl ChannelCommands {
    /// Opens the logs of the channels with other laws; nothing if there are none.
    pub fn open(settings: &Settings, logs: &[(Channel, PathBuf)]) -> Result<Option<Self>, Failure> {
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
            switchovers,
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
            let switchover = self.switchovers.iter().rfind(|(from, _)| *from <= tick);
            let group = switchover.map_or(Channel::A, |(_, group)| *group);
            let command = match self.others.iter_mut().find(|(of, _)| *of == group) {
                Some((_, commands)) => commands.of(tick)?,
                None => own.of(tick).copied(),
            };
            if let Some(command) = command {
                self.taken.push(command);
                self.taken.advance();
            }
            self.next_tick += 1;
        }
        Ok(&self.taken)
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
