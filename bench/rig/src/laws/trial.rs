//! A law on the bench: same output twice and after rehearsals, finite, how long a tick takes, what it allocates.

pub mod watchdog;
pub mod words;

use std::hint::black_box;
use std::time::Instant;

use control_api::law::{Desired, InnerLaw, MixerLaw, OuterLaw, Rig, WrenchSetpoint};
use control_api::registry::Made;
use messages::attitude::Attitude;
use messages::content::Measured;
use messages::content::Reference;
use messages::content::Stamped;
use messages::realtime::Usage;
use messages::telemetry::{TELEMETRY, Telemetry};
use nalgebra::Vector3;
use process::rt::UsageMeter;

pub const INPUTS: u64 = 100_000;

/// As many of them are rehearsed before they are flown.
const REHEARSED: u64 = 10_000;

/// A law is begun anew after so many of them, so that what an odd start leaves behind is seen too.
const INPUTS_PER_LIFE: u64 = 1000;

/// Ticks of which the time is taken, with warm caches, and before that as many that warm them.
pub const HOT: usize = 10_000;

/// Ticks of which the time is taken, each after the caches were filled with something else.
const COLD: usize = 101;

/// Larger than the last cache of most machines [bytes].
const CACHES: usize = 64 << 20;

/// How often `alive` is called in a whole trial.
pub const ROUNDS: u64 = INPUTS + REHEARSED + 2 * HOT as u64 + COLD as u64;

/// A law of any role, made.
#[allow(missing_debug_implementations, reason = "a law need not have one")]
pub enum Candidate {
    Outer(Made<dyn OuterLaw>),
    Inner(Made<dyn InnerLaw>),
    Mixer(Made<dyn MixerLaw>),
}

/// Where two instances of a law, told the same, answered differently.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    pub input: u64,
    /// Index among the numbers of the answer, telemetry behind them.
    pub index: usize,
    /// What the two instances gave there.
    pub values: [f64; 2],
}

/// An answer with a number that is not finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NotFinite {
    pub input: u64,
    /// Index among the numbers of the answer.
    pub index: usize,
    pub value: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Findings {
    /// The first difference between two instances that were told the same.
    pub difference: Option<Difference>,
    /// The first answer with a number that is not finite.
    pub not_finite: Option<NotFinite>,
    /// Whether an instance takes over the memory of another one, as a rehearsal needs.
    pub is_copied: bool,
    /// The first difference between an instance and one that was rehearsed before each tick; looked for where the law
    /// repeats itself.
    pub rehearsed: Option<Difference>,
    /// Median and 99th percentile of a tick with warm caches [ns].
    pub hot_ns: [u64; 2],
    /// Median of a tick after its caches were filled with something else [ns].
    pub cold_ns: u64,
    pub usage: Usage,
}

impl Findings {
    /// Whether the law does what every law must; one that promises nothing about its time may also allocate.
    #[must_use]
    pub const fn passes(&self, not_real_time: bool) -> bool {
        let uses_nothing = matches!(self.usage.counted_allocations(), None | Some(0))
            && self.usage.minor_faults == 0
            && self.usage.major_faults == 0;
        let is_the_same = self.difference.is_none() && self.rehearsed.is_none();
        is_the_same && self.not_finite.is_none() && (not_real_time || uses_nothing)
    }
}

/// What a law is told in a tick; each role takes its part.
#[derive(Clone, Copy, Debug)]
struct Input {
    tick: u64,
    measured: Stamped<Measured>,
    wanted: Stamped<Desired>,
    reference: Reference,
    demand: WrenchSetpoint,
}

/// Numbers of an answer: as many as the longest has.
pub const ANSWER: usize = 10;

/// An answer: the numbers that other stages read, then the telemetry.
type Answer = [f64; ANSWER + TELEMETRY];

impl Candidate {
    fn tick(&mut self, input: &Input) -> Answer {
        match self {
            Self::Outer(made) => Asked::Outer(&mut *made.law).tick(input),
            Self::Inner(made) => Asked::Inner(&mut *made.law).tick(input),
            Self::Mixer(made) => Asked::Mixer(&mut *made.law).tick(input),
        }
    }

    /// Has its twin fly a tick as it would; false where it cannot be copied.
    fn rehearse(&mut self, input: &Input) -> bool {
        let is_copied = self.is_copied();
        if is_copied {
            black_box(match self {
                Self::Outer(made) => Asked::Outer(&mut *made.twin).tick(input),
                Self::Inner(made) => Asked::Inner(&mut *made.twin).tick(input),
                Self::Mixer(made) => Asked::Mixer(&mut *made.twin).tick(input),
            });
        }
        is_copied
    }

    fn is_copied(&mut self) -> bool {
        match self {
            Self::Outer(made) => made.law.copy_into(&mut *made.twin),
            Self::Inner(made) => made.law.copy_into(&mut *made.twin),
            Self::Mixer(made) => made.law.copy_into(&mut *made.twin),
        }
    }
}

/// An instance of a law: the one that flies, or its twin.
enum Asked<'a> {
    Outer(&'a mut dyn OuterLaw),
    Inner(&'a mut dyn InnerLaw),
    Mixer(&'a mut dyn MixerLaw),
}

impl Asked<'_> {
    fn tick(self, input: &Input) -> Answer {
        let Input {
            tick,
            measured,
            wanted,
            reference,
            demand,
        } = input;
        let mut telemetry = Telemetry::default();
        let mut answer = [0.0; ANSWER + TELEMETRY];
        match self {
            Self::Outer(law) => {
                let wanted = law.tick(*tick, &measured.content, reference, &mut telemetry);
                answer[0] = wanted.thrust_n;
                answer[1..4].copy_from_slice(&wanted.attitude_rad);
                answer[4..7].copy_from_slice(&wanted.attitude_rate_rad_s);
                answer[7..10].copy_from_slice(&wanted.attitude_acceleration_rad_s2);
            }
            Self::Inner(law) => {
                let demand = law.tick(*tick, measured, wanted, reference, &mut telemetry);
                answer[0] = demand.thrust_n;
                answer[1..4].copy_from_slice(&demand.torque_b_nm);
            }
            Self::Mixer(law) => {
                let (speed_rad_s, is_saturated) = law.tick(*tick, demand, &mut telemetry);
                answer[..4].copy_from_slice(&speed_rad_s);
                answer[4] = f64::from(u8::from(is_saturated));
            }
        }
        answer[ANSWER..].copy_from_slice(&telemetry.value);
        answer
    }
}

/// Tries a law that `make` begins anew each time it is called. `alive` is called whenever the law has come back.
pub fn trial<E>(
    rig: &Rig,
    make: impl Fn() -> Result<Candidate, E>,
    alive: impl Fn(),
) -> Result<Findings, E> {
    let mut draw = Draw::new(rig);
    let (mut difference, mut not_finite) = (None, None);
    for life in 0..INPUTS / INPUTS_PER_LIFE {
        let (mut one, mut other) = (make()?, make()?);
        draw.begin();
        for input in life * INPUTS_PER_LIFE..(life + 1) * INPUTS_PER_LIFE {
            let told = draw.input();
            let answers = [one.tick(&told), other.tick(&told)];
            alive();
            difference = difference.or_else(|| differing(input, &answers));
            not_finite = not_finite.or_else(|| {
                let index = answers[0][..ANSWER]
                    .iter()
                    .position(|value| !value.is_finite())?;
                Some(NotFinite {
                    input,
                    index,
                    value: answers[0][index],
                })
            });
        }
    }
    let rehearsed = if difference.is_none() {
        rehearsed(rig, &make, &alive)?
    } else {
        None
    };
    let mut candidate = make()?;
    let is_copied = candidate.is_copied();
    let hover = Input::hover(rig);
    let mut hot = vec![0; HOT];
    timed(&mut candidate, &hover, 0, &mut hot, &alive);
    let meter = UsageMeter::start();
    timed(&mut candidate, &hover, HOT as u64, &mut hot, &alive);
    let usage = meter.read();
    hot.sort_unstable();
    let mut elsewhere = vec![0_u8; CACHES];
    let mut cold = vec![0; COLD];
    for (i, time_ns) in cold.iter_mut().enumerate() {
        elsewhere
            .iter_mut()
            .step_by(64)
            .for_each(|byte| *byte = byte.wrapping_add(1));
        black_box(&mut elsewhere);
        timed(
            &mut candidate,
            &hover,
            (2 * HOT + i) as u64,
            std::slice::from_mut(time_ns),
            &alive,
        );
    }
    cold.sort_unstable();
    Ok(Findings {
        difference,
        not_finite,
        is_copied,
        rehearsed,
        hot_ns: [hot[HOT / 2], hot[HOT * 99 / 100]],
        cold_ns: cold[COLD / 2],
        usage,
    })
}

/// The first difference between an instance and another one that is rehearsed before each tick.
fn rehearsed<E>(
    rig: &Rig,
    make: &impl Fn() -> Result<Candidate, E>,
    alive: &impl Fn(),
) -> Result<Option<Difference>, E> {
    let mut draw = Draw::new(rig);
    for life in 0..REHEARSED / INPUTS_PER_LIFE {
        let (mut one, mut other) = (make()?, make()?);
        draw.begin();
        for input in life * INPUTS_PER_LIFE..(life + 1) * INPUTS_PER_LIFE {
            let told = draw.input();
            if !other.rehearse(&told) {
                return Ok(None);
            }
            let found = differing(input, &[one.tick(&told), other.tick(&told)]);
            alive();
            if found.is_some() {
                return Ok(found);
            }
        }
    }
    Ok(None)
}

/// Flies a tick for each place of `times_ns` and leaves there how long it took.
fn timed(
    candidate: &mut Candidate,
    hover: &Input,
    from: u64,
    times_ns: &mut [u64],
    alive: &impl Fn(),
) {
    for (tick, time_ns) in (from..).zip(times_ns) {
        let input = black_box(hover.at(tick));
        let begun = Instant::now();
        black_box(candidate.tick(&input));
        *time_ns = u64::try_from(begun.elapsed().as_nanos()).unwrap_or(u64::MAX);
        alive();
    }
}

/// NaN is a difference from everything but the same bits.
fn differing(input: u64, answers: &[Answer; 2]) -> Option<Difference> {
    let [one, other] = answers;
    let index = one
        .iter()
        .zip(other)
        .position(|(one, other)| one.to_bits() != other.to_bits())?;
    Some(Difference {
        input,
        index,
        values: [one[index], other[index]],
    })
}

impl Input {
    /// Level in the origin, where the reference is too.
    fn hover(rig: &Rig) -> Self {
        let Rig { airframe, .. } = rig;
        let (thrust_n, speed) = (airframe.m() * airframe.g(), airframe.hover_speed_rad_s());
        let measured = Measured {
            specific_force_b_m_s2: [0.0, 0.0, airframe.g()],
            rotor_speed_mean_rad_s: [speed; 4],
            rotor_speed_squared_mean_rad2_s2: [speed * speed; 4],
            rotor_speed_command_rad_s: [speed; 4],
            ..Measured::default()
        };
        Self {
            tick: 0,
            measured: Stamped {
                tick: 0,
                content: measured,
            },
            wanted: Stamped {
                tick: 0,
                content: Desired {
                    thrust_n,
                    ..Desired::default()
                },
            },
            reference: Reference::default(),
            demand: WrenchSetpoint {
                thrust_n,
                torque_b_nm: [0.0; 3],
            },
        }
    }

    const fn at(mut self, tick: u64) -> Self {
        self.tick = tick;
        self.measured.tick = tick;
        self.wanted.tick = tick;
        self
    }
}

/// Draws inputs that the rig could hand over: each number within its physical range, ticks in order, some left out,
/// some inputs held. Always the same ones.
struct Draw {
    rng: fastrand::Rng,
    rig: Rig,
    last: Input,
}

impl Draw {
    fn new(rig: &Rig) -> Self {
        Self {
            rng: fastrand::Rng::with_seed(1),
            rig: *rig,
            last: Input::hover(rig),
        }
    }

    fn begin(&mut self) {
        self.last = Input::hover(&self.rig).at(0);
    }

    fn input(&mut self) -> Input {
        let skipped = if self.rng.u8(..) < 16 {
            self.rng.u64(1..500)
        } else {
            0
        };
        let tick = self.last.tick + 1 + skipped;
        let Self { rng, rig, last } = self;
        last.tick = tick;
        if rng.u8(..) >= 16 {
            last.measured = Stamped {
                tick,
                content: measured(rng, rig),
            };
        }
        if rng.u8(..) >= 16 {
            last.wanted = Stamped {
                tick,
                content: wanted(rng, rig),
            };
            last.reference = reference(rng);
        }
        last.demand = WrenchSetpoint {
            thrust_n: last.wanted.content.thrust_n,
            torque_b_nm: numbers(rng, 10.0),
        };
        *last
    }
}

fn numbers<const N: usize>(rng: &mut fastrand::Rng, size: f64) -> [f64; N] {
    std::array::from_fn(|_| size * (2.0 * rng.f64() - 1.0))
}

/// Roll, pitch, yaw [rad].
fn angles(rng: &mut fastrand::Rng) -> [f64; 3] {
    let [roll, pitch, yaw] = numbers(rng, std::f64::consts::PI);
    [roll, pitch / 2.0, yaw]
}

fn measured(rng: &mut fastrand::Rng, rig: &Rig) -> Measured {
    let attitude_rad = angles(rng);
    let speed = |rng: &mut fastrand::Rng| {
        std::array::from_fn(|_| {
            rig.rotor.min_rad_s + (rig.rotor.max_rad_s - rig.rotor.min_rad_s) * rng.f64()
        })
    };
    let mean: [f64; 4] = speed(rng);
    Measured {
        position_w_m: numbers(rng, 1e3),
        velocity_w_m_s: numbers(rng, 100.0),
        attitude_rad,
        attitude_quaternion: Attitude::of_euler(&Vector3::from(attitude_rad)).wxyz(),
        rate_b_rad_s: numbers(rng, 50.0),
        specific_force_b_m_s2: numbers(rng, 100.0),
        rotor_speed_mean_rad_s: mean,
        rotor_speed_squared_mean_rad2_s2: mean.map(|speed| speed * speed),
        rotor_speed_command_rad_s: speed(rng),
    }
}

fn wanted(rng: &mut fastrand::Rng, rig: &Rig) -> Desired {
    Desired {
        thrust_n: 4.0 * rig.rotor.f_max(rig.airframe.k()) * rng.f64(),
        attitude_rad: angles(rng),
        attitude_rate_rad_s: numbers(rng, 10.0),
        attitude_acceleration_rad_s2: numbers(rng, 100.0),
        limited: u64::from(rng.bool()),
    }
}

fn reference(rng: &mut fastrand::Rng) -> Reference {
    let [yaw_rad] = numbers(rng, std::f64::consts::PI);
    let [yaw_rate_rad_s, yaw_acceleration_rad_s2] = numbers(rng, 10.0);
    Reference {
        position_w_m: numbers(rng, 1e3),
        velocity_w_m_s: numbers(rng, 50.0),
        acceleration_w_m_s2: numbers(rng, 50.0),
        jerk_w_m_s3: numbers(rng, 500.0),
        snap_w_m_s4: numbers(rng, 5e3),
        yaw_rad,
        yaw_rate_rad_s,
        yaw_acceleration_rad_s2,
    }
}
