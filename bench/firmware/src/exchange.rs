//! The exchange of a tick: a state and a remote control go out, motor commands come back or not, and each case is
//! counted.

use std::io;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::thread;
use std::time::{Duration, Instant};

use messages::content::ROTORS;
use messages::telemetry::AnswerOutcome as Outcome;
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use crate::{PACKET_BYTES, Port};

/// An answer of a tick, or why there is none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Answer {
    pub outcome: Outcome,
    /// From sending the state to having the motor commands; none without an answer.
    pub latency: Option<Duration>,
    /// The newest motor commands, if some came.
    pub motors: Option<[f64; ROTORS]>,
    /// Packets that came before this tick's state was sent, while an older one had no answer.
    pub late: u64,
    /// Packets that came when no state was without an answer.
    pub repeated: u64,
}

/// The sockets to a firmware.
#[derive(Debug)]
pub struct Exchange {
    state: UdpSocket,
    remote: UdpSocket,
    motors: UdpSocket,
    decode: fn(&[u8]) -> Result<[f64; ROTORS], Outcome>,
    /// States without an answer.
    open: u64,
    /// When the newest state was sent, and the newest answer came.
    sent: Option<Instant>,
    answered: Option<Instant>,
    /// Time and stamp of the newest state.
    stamped: Option<(Duration, Duration)>,
}

/// Greatest step between two stamps. Betaflight does not correct the rate of its clock by longer ones, and so would keep
/// one that a stall has spoilt.
const STEP: Duration = Duration::from_millis(15);

/// A state without an answer for this long counts as lost, and the next one is sent. A firmware that has stalled would
/// take both at once, and its clock would jump; a packet to this machine itself is hardly ever lost.
const LOST: Duration = Duration::from_millis(100);

impl Exchange {
    /// Opens the sockets. Fails where another flight has the port of the motor commands.
    pub fn new(port: &Port) -> io::Result<Self> {
        let local = |udp: u16| SocketAddrV4::new(Ipv4Addr::LOCALHOST, udp);
        let motors = UdpSocket::bind(local(port.motors_udp))?;
        motors.set_nonblocking(true)?;
        let to = |udp: u16| {
            let socket = UdpSocket::bind(local(0))?;
            socket.set_nonblocking(true)?;
            socket.connect(local(udp))?;
            Ok::<_, io::Error>(socket)
        };
        Ok(Self {
            state: to(port.state_udp)?,
            remote: to(port.remote_udp)?,
            motors,
            decode: port.motors,
            open: 0,
            sent: None,
            answered: None,
            stamped: None,
        })
    }

    pub fn try_clone(&self) -> io::Result<Self> {
        Ok(Self {
            state: self.state.try_clone()?,
            remote: self.remote.try_clone()?,
            motors: self.motors.try_clone()?,
            decode: self.decode,
            open: 0,
            sent: None,
            answered: None,
            stamped: None,
        })
    }

    /// Takes what has come, counts nothing, and goes on from a time.
    pub fn forget(&mut self, time: Duration) {
        while self.receive().is_some() {}
        (self.open, self.stamped) = (0, Some((time, time)));
    }

    /// How long to wait until the firmware has had `spacing` to itself since its newest answer; nothing before the first.
    fn rest(&self, spacing: Duration) -> Duration {
        let since = self.answered.map_or(spacing, |it| it.elapsed());
        spacing.saturating_sub(since)
    }

    /// Sends the packets of a time, state and remote control, and waits for the answer, at most for `limit`. `write` writes
    /// them with a stamp [s] and returns their lengths. Allocates nothing.
    ///
    /// With a `spacing` nothing is sent while the firmware still works on a state, nor for that time after its answer:
    /// states that reach it close together speed its clock up (docs/firmware.md).
    pub fn ask(
        &mut self,
        time: Duration,
        write: impl FnOnce(f64, &mut [[u8; PACKET_BYTES]; 2]) -> [usize; 2],
        spacing: Duration,
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
        let is_open = |at: &Instant| at.elapsed() <= LOST;
        let rest = self.rest(spacing);
        let is_busy = self.open > 0 && self.sent.as_ref().is_some_and(is_open);
        if !spacing.is_zero() && (is_busy || rest > limit) {
            return answer;
        }
        thread::sleep(rest);
        let stamp = self.stamped.map_or(time, |(last, stamp)| {
            stamp + time.saturating_sub(last).min(STEP)
        });
        self.stamped = Some((time, stamp));
        let mut packets = [[0; PACKET_BYTES]; 2];
        let [states, remotes] = write(stamp.as_secs_f64(), &mut packets);
        let (state, remote) = (&packets[0][..states], &packets[1][..remotes]);
        let (sent, limit) = (Instant::now(), limit.saturating_sub(rest));
        // A refused packet means that the firmware has ended, which its process says.
        let _ = self.remote.send(remote);
        let _ = self.state.send(state);
        (self.sent, self.open) = (Some(sent), self.open + 1);
        loop {
            match self.receive() {
                Some(Ok(motors)) => {
                    answer.outcome = Outcome::Answered;
                    answer.latency = Some(sent.elapsed());
                    answer.motors = Some(motors);
                    (self.answered, self.open) = (Some(Instant::now()), 0);
                    return answer;
                }
                Some(Err(outcome)) => answer.outcome = outcome,
                None => {
                    let left = limit.saturating_sub(sent.elapsed());
                    if left.is_zero() || !self.wait(left) {
                        return answer;
                    }
                }
            }
        }
    }

    /// The next packet, if one is there.
    pub fn receive(&self) -> Option<Result<[f64; ROTORS], Outcome>> {
        let mut packet = [0; PACKET_BYTES];
        let bytes = self.motors.recv(&mut packet).ok()?;
        Some((self.decode)(&packet[..bytes]))
    }

    /// Waits for a packet or a signal; false if the time is over.
    pub fn wait(&self, left: Duration) -> bool {
        let left = Timespec {
            tv_sec: left.as_secs().cast_signed(),
            tv_nsec: left.subsec_nanos().into(),
        };
        let mut sockets = [PollFd::new(&self.motors, PollFlags::IN)];
        poll(&mut sockets, Some(&left)) != Ok(0)
    }
}
