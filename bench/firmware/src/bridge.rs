//! The law whose value is another program's answer.
//!
//! A tick sends one state and one remote control, waits for the motor commands, and turns them into the wrench of those
//! rotor speeds by the airframe as it is known; the mixer turns it back into the same speeds. The wait ends in time for
//! the rest of the chain. Without an answer the last motors are held, as a speed controller does; when the process has
//! ended they stop. A tick without a fresh state sends nothing, so the firmware sees the gap.
//!
//! Where ticks do not come by the clock, the law keeps to it if the firmware does: Betaflight's loops take real time.

use std::any::Any;
use std::os::unix::process::ExitStatusExt as _;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use control_api::Rig;
use control_api::description::{Refused, Setting, Settings, number, settings, signal};
use control_api::law::{CopyState, InnerInput, InnerLaw, WrenchSetpoint};
use fastrand::Rng;
use ironbird_law::Measured;
use messages::allocation::Allocation;
use messages::content::ROTORS;
use messages::telemetry::{ANSWERS, AnswerOutcome as Outcome, Signal, Telemetry};
use nalgebra::Vector4;

use crate::Port;
use crate::exchange::Answer;
use crate::launch::{Armed, Launch, executable};
use crate::sticks::{StickScale, Sticks};

settings! {
    pub SETTINGS;
    ANGLE_LIMIT_RAD = "angle_limit_rad", "rad", number(std::f64::consts::FRAC_PI_4, 0.1, 1.5), "tilt at full deflection, as in the firmware (angle_limit)";
    YAW_RATE_MAX_RAD_S = "yaw_rate_max_rad_s", "rad/s", number(std::f64::consts::TAU, 0.1, 100.0), "yaw rate at full deflection, as in the firmware (yaw_srate)";
    YAW_1_S = "yaw_1_s", "1/s", number(2.0, 0.0, 100.0), "from yaw error to yaw rate";
    IDLE = "idle", "", number(0.055, 0.0, 0.5), "motor command at throttle 0, as in the firmware (motor_idle)";
    pub ANSWER_LIMIT = "answer_limit", "", number(0.6, 0.01, 10.0), "longest wait for an answer, as a share of the period, where ticks come by the clock";
    pub ARMING_LIMIT_S = "arming_limit_s", "s", number(8.0, 0.1, 60.0), "longest wait until the firmware has armed";
    pub PRIORITY = "priority", "", number(70.0, 0.0, 99.0), "SCHED_FIFO priority of the firmware where ticks come by the clock; 0 is none";
    SPACING = "spacing", "", number(0.2, 0.0, 1.0), "least time between an answer and the next state, as a share of the period; 0 sends each state when it is due, answered or not, as other simulators do";
    JITTER_S = "jitter_s", "s", number(0.0, 0.0, 1.0), "each packet is sent up to this much later than its time, where ticks do not come by the clock";
    JITTER_SEED = "jitter_seed", "", number(1.0, 0.0, 1e9), "seed of the jitter";
}

// Of a firmware that flies its own mode.
settings! {
    pub LOCKSTEP_ARMING_LIMIT_S = "arming_limit_s", "s", number(120.0, 0.1, 3600.0), "longest wait until a firmware has come, and again until it has armed";
    pub UDP_PORT = "port", "", number(9002.0, 1024.0, 65_533.0), "UDP port that the firmware sends to";
}

/// How long an answer is waited for where ticks do not come by the clock: a firmware that is slow is no firmware that is
/// silent.
const PATIENCE: Duration = Duration::from_millis(200);

/// Signals of a tick: the exchange, then motor commands and sticks.
pub const SIGNALS: &[Signal] = &[
    signal(ANSWERS[0], ""),
    signal(ANSWERS[1], "us"),
    signal(ANSWERS[2], ""),
    signal(ANSWERS[3], ""),
    signal(ANSWERS[4], ""),
    signal(ANSWERS[5], ""),
    signal("motor_1", ""),
    signal("motor_2", ""),
    signal("motor_3", ""),
    signal("motor_4", ""),
    signal("stick_roll", ""),
    signal("stick_pitch", ""),
    signal("stick_yaw", ""),
    signal("stick_throttle", ""),
];

/// Signals of a firmware without sticks.
pub const LOCKSTEP_SIGNALS: &[Signal] = SIGNALS.split_at(ANSWERS.len() + ROTORS).0;

pub struct Bridge {
    launch: Launch,
    scale: StickScale,
    allocation: Allocation,
    /// Thrust of a rotor at motor command 1 [N].
    full_n: f64,
    answer_limit: Duration,
    /// As in [`crate::exchange::Exchange::ask`].
    spacing: Option<Duration>,
    pace: Pace,
    comes_by_the_clock: bool,
    firmware: Option<Armed>,
    began: Option<Beginning>,
    motors: [f64; ROTORS],
}

/// The first tick.
#[derive(Clone, Copy, Debug)]
struct Beginning {
    tick: u64,
    at: Instant,
    /// Stamp of its packet.
    stamp: Duration,
    /// Position of the vehicle [m], which is the origin of the positions that the firmware gets.
    position_w_m: [f64; 3],
}

/// The clock of ticks that come as soon as the last one is done.
#[derive(Clone, Debug)]
struct Pace {
    jitter_s: f64,
    random: Rng,
    /// How much later than its time the next packet is sent.
    late: Duration,
    /// When the first tick would have been, had none been late.
    zero: Option<Instant>,
}

impl Pace {
    /// When the packet of a tick is due, so long after the first; from now on, if all before were on time.
    fn due(&self, after: Duration, now: Instant) -> Instant {
        self.zero.unwrap_or(now) + after + self.late
    }

    /// Waits until the packet of a tick is due, and draws how late the next one is.
    fn wait(&mut self, after: Duration) {
        let now = Instant::now();
        // Time that is lost is not made up for, except that of the jitter.
        let latest = now.checked_sub(after + Duration::from_secs_f64(self.jitter_s));
        let zero = self.zero.unwrap_or(now);
        self.zero = Some(latest.map_or(zero, |latest| zero.max(latest)));
        std::thread::sleep(self.due(after, now).saturating_duration_since(now));
        self.late = Duration::from_secs_f64(self.jitter_s * self.random.f64());
    }
}

impl Bridge {
    pub fn new(port: &'static Port, rig: &Rig, settings: &Settings) -> Result<Self, Refused> {
        Ok(Self::of(port, executable(port)?, rig, settings))
    }

    /// The bridge to an executable, or to a firmware that the user starts.
    pub fn of(
        port: &'static Port,
        executable: Option<PathBuf>,
        rig: &Rig,
        settings: &Settings,
    ) -> Self {
        let number = |setting: &Setting| settings.number(port.setting(setting));
        let period = Duration::from_secs_f64(rig.period_s);
        let full_n = rig.rotor.f_max(rig.airframe.k());
        let spacing = period.mul_f64(number(&SPACING));
        Self {
            launch: Launch {
                port,
                number: number(&UDP_PORT) as u16,
                executable,
                priority: number(&PRIORITY) as i32,
                period,
                limit: Duration::from_secs_f64(number(&ARMING_LIMIT_S)),
            },
            scale: StickScale {
                angle_rad: number(&ANGLE_LIMIT_RAD),
                yaw_rad_s: number(&YAW_RATE_MAX_RAD_S),
                yaw_gain_1_s: number(&YAW_1_S),
                idle: number(&IDLE),
                full_thrust_n: ROTORS as f64 * full_n,
            },
            allocation: Allocation::new(&rig.airframe),
            full_n,
            answer_limit: period.mul_f64(number(&ANSWER_LIMIT)),
            spacing: match port.is_lockstep {
                true => port.answers_each.then_some(Duration::ZERO),
                false => (!spacing.is_zero()).then_some(spacing),
            },
            pace: Pace {
                jitter_s: number(&JITTER_S),
                random: Rng::with_seed(number(&JITTER_SEED) as u64),
                late: Duration::ZERO,
                zero: None,
            },
            comes_by_the_clock: false,
            firmware: None,
            began: None,
            motors: [0.0; ROTORS],
        }
    }
}

impl CopyState for Bridge {
    /// Another program cannot be copied.
    fn copy_into(&self, _: &mut dyn Any) -> bool {
        false
    }

    fn as_any(&mut self) -> &mut dyn Any {
        self
    }
}

impl InnerLaw for Bridge {
    fn start(&mut self, comes_by_the_clock: bool) -> Result<(), Refused> {
        self.comes_by_the_clock = comes_by_the_clock;
        self.firmware = Some(self.launch.start(comes_by_the_clock)?);
        // Armed motors idle.
        self.motors = [self.scale.idle; ROTORS];
        Ok(())
    }

    fn tick(&mut self, input: &InnerInput, telemetry: &mut Telemetry) -> WrenchSetpoint {
        let sticks = self.scale.sticks(
            &input.wanted,
            input.measured.attitude_rad[2],
            input.reference.yaw_rate_rad_s,
        );
        let answer = self.exchange(input, &sticks);
        self.show(&answer, &sticks, telemetry);
        let thrusts = Vector4::from(self.motors).map(|motor| self.full_n * motor * motor);
        let (thrust_n, torque) = self.allocation.wrench(&thrusts);
        WrenchSetpoint {
            thrust_n,
            torque_b_nm: torque.into(),
        }
    }
}

impl Bridge {
    fn exchange(&mut self, input: &InnerInput, sticks: &Sticks) -> Answer {
        let Some(firmware) = &mut self.firmware else {
            self.motors = [0.0; ROTORS];
            return Answer {
                outcome: Outcome::Ended,
                ..Answer::default()
            };
        };
        let period = self.launch.period;
        let began = *self.began.get_or_insert_with(|| Beginning {
            tick: input.tick,
            at: Instant::now(),
            stamp: firmware.take_off(period) + period,
            position_w_m: input.measured.position_w_m,
        });
        let after = period.mul_f64((input.tick - began.tick) as f64);
        let is_paced = !self.comes_by_the_clock && !self.launch.port.is_lockstep;
        if is_paced {
            self.pace.wait(after);
        }
        if input.measured_age > 0 {
            return Answer::default();
        }
        let (position, start) = (input.measured.position_w_m, began.position_w_m);
        let measured = Measured {
            position_w_m: [0, 1, 2].map(|i| position[i] - start[i]),
            ..input.measured
        };
        let limit = match (self.comes_by_the_clock, is_paced && self.spacing.is_none()) {
            (true, _) => self.answer_limit,
            (false, false) => PATIENCE,
            // The next packet waits for nothing.
            (false, true) => {
                let now = Instant::now();
                let next = self.pace.due(after + period, now);
                next.saturating_duration_since(now)
            }
        };
        // If stamps differed from the times of sending, the rate of a firmware's own clock would change.
        let since = match self.comes_by_the_clock && !self.launch.port.is_lockstep {
            true => began.at.elapsed(),
            false => after,
        };
        let exchange = &mut firmware.exchange;
        let sample = (&measured, sticks);
        let mut answer = exchange.ask(began.stamp + since, sample, self.spacing, limit);
        self.motors = answer.motors.map_or(self.motors, |it| it.commands);
        if answer.outcome != Outcome::Answered && firmware.has_ended() {
            answer.outcome = Outcome::Ended;
            self.motors = [0.0; ROTORS];
        }
        answer
    }

    /// Shows the exchange in the order of [`SIGNALS`].
    fn show(&mut self, answer: &Answer, sticks: &Sticks, telemetry: &mut Telemetry) {
        let port = self.launch.port;
        let is_wanted = port.is_lockstep || sticks.throttle > 0.0;
        let is_disarmed = is_wanted && answer.motors.is_some_and(|motors| !motors.is_armed);
        let ended = self
            .firmware
            .as_mut()
            .filter(|_| answer.outcome == Outcome::Ended);
        let ended = ended.and_then(|firmware| firmware.program.as_mut()?.ended());
        // As a shell has it: 128 and the number of the signal.
        let status = ended.map(|it| it.code().unwrap_or(128 + it.signal().unwrap_or(0)));
        let numbers = [
            answer.outcome as u64 as f64,
            answer.latency.map_or(f64::NAN, |it| it.as_secs_f64() * 1e6),
            answer.late as f64,
            answer.repeated as f64,
            f64::from(u8::from(is_disarmed)),
            status.map_or(f64::NAN, f64::from),
        ];
        let positions = [sticks.roll, sticks.pitch, sticks.yaw, sticks.throttle];
        let all = numbers.iter().chain(&self.motors).chain(&positions);
        telemetry
            .value
            .iter_mut()
            .zip(all.take(port.description.telemetry.len()))
            .for_each(|(it, number)| *it = *number);
    }
}
