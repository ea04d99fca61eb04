//! The exchange of a tick: a state goes out, motor commands come back or not, and each case is counted.

use std::io::{self, ErrorKind};
use std::mem::take;
use std::thread;
use std::time::{Duration, Instant};

use ironbird_law::Measured;
use messages::telemetry::AnswerOutcome as Outcome;
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use crate::sticks::Sticks;
use crate::{Link, Message, Motors, Port, Sample};

/// An answer of a tick, or why there is none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Answer {
    pub outcome: Outcome,
    /// From sending the state to having the motor commands; none without an answer.
    pub latency: Option<Duration>,
    /// The newest motor commands, if some came.
    pub motors: Option<Motors>,
    /// Packets that came before this tick's state was sent, while an older one had no answer.
    pub late: u64,
    /// Packets that came when no state was without an answer, or whose number had come before.
    pub repeated: u64,
}

/// The exchange with a firmware.
pub struct Exchange {
    link: Box<dyn Link>,
    is_lockstep: bool,
    /// States without an answer, and until when the firmware may still work on one.
    open: u64,
    busy_until: Option<Instant>,
    /// When the newest answer came.
    answered: Option<Instant>,
    /// Time and stamp of the newest state.
    stamped: Option<(Duration, Duration)>,
    /// Number of the newest motor commands, and how many came with a number that was not above it.
    newest: Option<u64>,
    old: u64,
    /// Whether something came from the firmware, and whether it has gone.
    pub heard: bool,
    pub gone: bool,
}

/// Greatest step between two stamps. Betaflight does not correct the rate of its clock by longer ones, and so would keep
/// one that a stall has spoilt.
const STEP: Duration = Duration::from_millis(15);

/// A state without an answer for this long counts as lost, and the next one is sent. A firmware that has stalled would
/// take both at once, and its clock would jump; a packet to this machine itself is hardly ever lost.
const LOST: Duration = Duration::from_millis(100);

impl Exchange {
    pub fn new(port: &Port, link: Box<dyn Link>) -> Self {
        Self {
            link,
            is_lockstep: port.is_lockstep,
            open: 0,
            busy_until: None,
            answered: None,
            stamped: None,
            newest: None,
            old: 0,
            heard: false,
            gone: false,
        }
    }

    pub fn try_clone(&self, port: &Port) -> io::Result<Self> {
        Ok(Self::new(port, self.link.try_clone()?))
    }

    /// Takes what has come, counts nothing, and goes on from a time, at which a state may still be without an answer until
    /// an instant.
    pub fn forget(&mut self, time: Duration, busy_until: Option<Instant>) {
        while self.receive().is_some() {}
        self.old = 0;
        (self.open, self.busy_until) = (busy_until.is_some().into(), busy_until);
        self.stamped = Some((time, time));
    }

    /// Sends the packets of a time, later by as long as it has to wait before, and waits for the answer, at most for
    /// `limit`. Allocates nothing.
    ///
    /// With a `spacing` nothing is sent while the firmware still works on a state, nor for that time after its answer:
    /// states that reach Betaflight close together speed its clock up (docs/firmware.md).
    pub fn ask(
        &mut self,
        time: Duration,
        (measured, sticks): (&Measured, &Sticks),
        spacing: Option<Duration>,
        limit: Duration,
    ) -> Answer {
        let mut answer = Answer {
            outcome: Outcome::Silent,
            ..Answer::default()
        };
        while let Some(motors) = self.receive() {
            answer.motors = motors.ok().or(answer.motors);
            match self.open {
                0 => answer.repeated += 1,
                _ => {
                    (answer.late, self.open) = (answer.late + 1, self.open - 1);
                    self.answered = Some(Instant::now());
                }
            }
        }
        let rest = spacing.zip(self.answered);
        let rest = rest.map_or(Duration::ZERO, |(spacing, it)| {
            spacing.saturating_sub(it.elapsed())
        });
        let is_busy = self.open > 0 && self.busy_until.is_some_and(|until| Instant::now() < until);
        if spacing.is_none() || !(is_busy || rest > limit) {
            thread::sleep(rest);
            let sent = Instant::now();
            self.send(time + rest, measured, sticks);
            self.wait_for_answer(sent, limit.saturating_sub(rest), &mut answer);
        }
        answer.repeated += take(&mut self.old);
        answer
    }

    fn send(&mut self, time: Duration, measured: &Measured, sticks: &Sticks) {
        let longest = if self.is_lockstep {
            Duration::MAX
        } else {
            STEP
        };
        let stamp = self.stamped.map_or(time, |(last, stamp)| {
            stamp + time.saturating_sub(last).min(longest)
        });
        self.stamped = Some((time, stamp));
        // A refused packet means that the firmware has ended, which receiving or its process says.
        let _ = self.link.send(&Sample {
            stamp,
            measured,
            sticks,
        });
        (self.busy_until, self.open) = (Some(Instant::now() + LOST), self.open + 1);
    }

    fn wait_for_answer(&mut self, sent: Instant, limit: Duration, answer: &mut Answer) {
        loop {
            match self.receive() {
                Some(Ok(motors)) => {
                    answer.outcome = Outcome::Answered;
                    answer.latency = Some(sent.elapsed());
                    answer.motors = Some(motors);
                    (self.answered, self.open) = (Some(Instant::now()), 0);
                    return;
                }
                Some(Err(outcome)) => (answer.outcome, self.open) = (outcome, 0),
                None => {
                    let left = limit.saturating_sub(sent.elapsed());
                    if self.gone || left.is_zero() || !self.wait(left) {
                        return;
                    }
                }
            }
        }
    }

    /// The next motor commands, if some are there.
    pub fn receive(&mut self) -> Option<Result<Motors, Outcome>> {
        while !self.gone {
            match self.link.receive() {
                Ok(Message::Broken(outcome)) => return Some(Err(outcome)),
                Ok(Message::Motors(motors)) => {
                    self.heard = true;
                    if motors.number.is_none() || motors.number > self.newest {
                        self.newest = motors.number;
                        return Some(Ok(motors));
                    }
                    self.old += 1;
                }
                Ok(Message::Other) => self.heard = true,
                Err(e) if e.kind() == ErrorKind::WouldBlock => return None,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(_) => self.gone = true,
            }
        }
        None
    }

    /// Waits for a packet or a signal; false if the time is over.
    pub fn wait(&self, left: Duration) -> bool {
        let left = Timespec {
            tv_sec: left.as_secs().cast_signed(),
            tv_nsec: left.subsec_nanos().into(),
        };
        let mut sockets = [PollFd::from_borrowed_fd(
            self.link.descriptor(),
            PollFlags::IN,
        )];
        poll(&mut sockets, Some(&left)) != Ok(0)
    }
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::os::fd::{AsFd as _, BorrowedFd};
    use std::sync::mpsc::{Sender, channel};

    use super::*;
    use crate::betaflight;

    /// A firmware that answers each state at once.
    struct Prompt {
        stamps: Sender<Duration>,
        has_answer: bool,
        descriptor: File,
    }

    impl Link for Prompt {
        fn send(&mut self, sample: &Sample) -> io::Result<()> {
            self.has_answer = true;
            self.stamps.send(sample.stamp).map_err(io::Error::other)
        }

        fn receive(&mut self) -> io::Result<Message> {
            match take(&mut self.has_answer) {
                true => Ok(Message::motors([0.5; 4], true, None)),
                false => Err(ErrorKind::WouldBlock.into()),
            }
        }

        fn descriptor(&self) -> BorrowedFd<'_> {
            self.descriptor.as_fd()
        }

        fn try_clone(&self) -> io::Result<Box<dyn Link>> {
            Err(ErrorKind::Unsupported.into())
        }
    }

    #[test]
    fn a_state_that_waits_for_the_spacing_has_a_stamp_that_is_later_by_the_wait() {
        let (stamps, sent) = channel();
        let link = Prompt {
            stamps,
            has_answer: false,
            descriptor: File::open("/dev/null").unwrap(),
        };
        let mut exchange = Exchange::new(&betaflight::PORT, Box::new(link));
        let sample = (&Measured::default(), &Sticks::default());
        // Longer than any wait on a busy machine, but the stamp rises by 15 ms at most.
        let (spacing, limit) = (Duration::from_millis(500), Duration::from_secs(1));
        for ms in [1, 2] {
            let time = Duration::from_millis(ms);
            let answer = exchange.ask(time, sample, Some(spacing), limit);
            assert_eq!(answer.outcome, Outcome::Answered);
        }
        let stamps: Vec<Duration> = sent.try_iter().collect();
        assert_eq!(stamps, [1, 1 + 15].map(Duration::from_millis));
    }
}
