//! Tests a law: same output twice, after warm-up runs and from its saved state; finite; time and allocations of a tick.

use std::cmp::min_by_key;
use std::hint::black_box;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use control_api::law::{
    CopyState, Desired, Fields, Given, InnerInput, InnerLaw, MixerInput, MixerLaw, OuterInput,
    OuterLaw, Rig, WrenchSetpoint,
};
use control_api::registry::Made;
use control_api::saved_state::{GUARD_BYTES, SavedState};
use errors::{Failure, GATE};
use messages::attitude::Attitude;
use messages::content::{Measured, Reference};
use messages::realtime::Usage;
use messages::telemetry::{TELEMETRY, Telemetry};
use nalgebra::Vector3;
use process::rt::UsageMeter;

use errors::output::say;

use crate::process_exit::end_now;

pub const INPUTS: u64 = 100_000;
/// Inputs with a warm-up run before each, and inputs of an instance that is periodically replaced by one from its saved
/// state.
const REHEARSED: u64 = 10_000;
/// A law is created anew after this many inputs, so that the consequences of an odd start are found too.
const INPUTS_PER_LIFE: u64 = 1000;
/// Timed ticks with warm caches; as many before them warm the caches.
pub const HOT: usize = 10_000;
/// Timed ticks, each after the caches were filled with something else.
const COLD: usize = 101;
/// Larger than the last cache of most machines [bytes].
const CACHES: usize = 64 << 20;
const TICKS: u64 = INPUTS + 2 * REHEARSED + 4 * HOT as u64 + COLD as u64;
/// How long a tick may take before the trial is ended.
const TICK_TIMEOUT: Duration = Duration::from_secs(10);

pub enum Candidate {
    Outer(Made<dyn OuterLaw>),
    Inner(Made<dyn InnerLaw>),
    Mixer(Made<dyn MixerLaw>),
}

/// An input that two instances of a law answered differently, or with a number that is not finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BadAnswer {
    pub input: u64,
    pub index: usize,
    pub values: [f64; 2],
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Findings {
    /// The first difference between two instances with the same inputs.
    pub difference: Option<BadAnswer>,
    pub not_finite: Option<BadAnswer>,
    /// Whether an instance can take over the memory of another one, as a warm-up needs.
    pub is_copied: bool,
    /// The first difference between an instance and one with a warm-up before each tick, or that warm-up; not tested
    /// after a `difference`.
    pub rehearsed: Option<BadAnswer>,
    /// Whether its state can be saved, and what was saved can be loaded.
    pub is_saved: bool,
    pub is_loaded: bool,
    /// The first difference between an instance and those that continue from its saved state; not tested after a
    /// `difference`.
    pub restored: Option<BadAnswer>,
    /// Median and 99th percentile of a tick with warm caches [ns].
    pub hot_ns: [u64; 2],
    /// Median of a tick with cold caches [ns].
    pub cold_ns: u64,
    pub usage: Usage,
}

impl Findings {
    /// Whether the law does what every law must; one that promises nothing about its time may also allocate.
    pub const fn passes(&self, not_real_time: bool) -> bool {
        let uses_nothing = matches!(self.usage.counted_allocations(), None | Some(0))
            && self.usage.minor_faults == 0
            && self.usage.major_faults == 0;
        let is_the_same =
            self.difference.is_none() && self.rehearsed.is_none() && self.restored.is_none();
        is_the_same
            && self.is_loaded
            && self.not_finite.is_none()
            && (not_real_time || uses_nothing)
    }
}

/// Number of outputs of the role with most.
pub const ANSWER: usize = 10;

/// The numbers that other stages read, then the telemetry.
type Answer = [f64; ANSWER + TELEMETRY];

/// The instance of a law that flies, or its twin, which flies warm-up runs.
fn instance<L: ?Sized>(made: &mut Made<L>, is_twin: bool) -> &mut L {
    if is_twin {
        &mut made.twin
    } else {
        &mut made.law
    }
}

impl Candidate {
    /// Answers the input of an inner loop; the other roles take their part of it, and a mixer what is `given`.
    fn tick(&mut self, input: &InnerInput, is_twin: bool) -> Answer {
        match self {
            Self::Outer(made) => tick_outer(instance(made, is_twin), input),
            Self::Inner(made) => tick_inner(instance(made, is_twin), input),
            Self::Mixer(made) => tick_mixer(instance(made, is_twin), input),
        }
    }

    fn both(&mut self) -> (&mut dyn CopyState, &mut dyn CopyState) {
        match self {
            Self::Outer(made) => (&mut *made.law, &mut *made.twin),
            Self::Inner(made) => (&mut *made.law, &mut *made.twin),
            Self::Mixer(made) => (&mut *made.law, &mut *made.twin),
        }
    }
}

fn tick_outer(law: &mut dyn OuterLaw, input: &InnerInput) -> Answer {
    let mut telemetry = Telemetry::default();
    let input = OuterInput {
        tick: input.tick,
        given_age: input.given_age,
        measured: input.measured,
        reference: input.reference,
        given: input.given,
    };
    let desired = law.tick(&input, &mut telemetry);
    let vectors = [
        desired.attitude_rad,
        desired.attitude_rate_rad_s,
        desired.attitude_acceleration_rad_s2,
    ];
    let numbers = [desired.thrust_n].into_iter();
    answer(numbers.chain(vectors.into_iter().flatten()), &telemetry)
}

fn tick_inner(law: &mut dyn InnerLaw, input: &InnerInput) -> Answer {
    let mut telemetry = Telemetry::default();
    let wrench = law.tick(input, &mut telemetry);
    let [x, y, z] = wrench.torque_b_nm;
    answer([wrench.thrust_n, x, y, z], &telemetry)
}

fn tick_mixer(law: &mut dyn MixerLaw, input: &InnerInput) -> Answer {
    let mut telemetry = Telemetry::default();
    let input = MixerInput {
        tick: input.tick,
        demand: WrenchSetpoint {
            thrust_n: input.given.thrust_n,
            torque_b_nm: input.given.torque_b_nm,
        },
    };
    let ([a, b, c, d], is_saturated) = law.tick(&input, &mut telemetry);
    answer([a, b, c, d, f64::from(is_saturated)], &telemetry)
}

fn answer(numbers: impl IntoIterator<Item = f64>, telemetry: &Telemetry) -> Answer {
    let mut answer = [0.0; ANSWER + TELEMETRY];
    let places = answer.iter_mut().zip(numbers);
    places.for_each(|(place, number)| *place = number);
    answer[ANSWER..].copy_from_slice(&telemetry.value);
    answer
}

/// Tries a law that `make` makes anew each time it is called. `alive` is called after every tick.
pub fn trial<E>(
    rig: &Rig,
    make: impl Fn() -> Result<Candidate, E>,
    alive: impl Fn(),
) -> Result<Findings, E> {
    trial_of(rig, [INPUTS, REHEARSED], COLD, make, alive)
}

/// The same with other numbers of inputs, the second one with warm-ups and of replaced instances, and of cold ticks.
pub fn trial_of<E>(
    rig: &Rig,
    [inputs, rehearsed_inputs]: [u64; 2],
    cold_ticks: usize,
    make: impl Fn() -> Result<Candidate, E>,
    alive: impl Fn(),
) -> Result<Findings, E> {
    let plain = |law: &mut Candidate, input: &InnerInput| Ok(Some([law.tick(input, false); 2]));
    let [difference, not_finite] = compare(rig, inputs, &make, &alive, plain)?;
    let (mut is_copied, mut is_saved, mut is_loaded) = (true, true, true);
    let (mut rehearsed, mut restored) = (None, None);
    if difference.is_none() {
        [rehearsed, _] = compare(rig, rehearsed_inputs, &make, &alive, |law, input| {
            let (flies, twin) = law.both();
            is_copied = flies.copy_into(twin.as_any());
            if !is_copied {
                return Ok(None);
            }
            let answers = [law.tick(input, true), law.tick(input, false)];
            // The twin goes ahead: only the next copy makes it equal again.
            let tick = input.tick + 1;
            black_box(law.tick(&InnerInput { tick, ..*input }, true));
            Ok(Some(answers))
        })?;
    }
    let (hot_ns, cold_ns, usage) = timed([make()?, make()?], &hover(rig), cold_ticks, &alive);
    // Last: the instances made here can cause a page fault in ticks that are timed after them.
    if difference.is_none() {
        [restored, _] = compare(rig, rehearsed_inputs, &make, &alive, |law, input| {
            if input.tick % 16 > 0 {
                return plain(law, input);
            }
            let mut state = SavedState::from([0; GUARD_BYTES]);
            is_saved = law.both().0.transfer(&mut Fields::Write(&mut state));
            if is_saved {
                *law = make()?;
                is_loaded = law
                    .both()
                    .0
                    .transfer(&mut Fields::Read(&state[GUARD_BYTES..]));
            }
            match is_saved && is_loaded {
                true => plain(law, input),
                false => Ok(None),
            }
        })?;
    }
    Ok(Findings {
        difference,
        not_finite,
        is_copied,
        rehearsed,
        is_saved,
        is_loaded,
        restored,
        hot_ns,
        cold_ns,
        usage,
    })
}

/// Median and 99th percentile of a tick with warm caches, and median of one with cold caches [ns]; and what the ticks use.
fn timed(
    [mut first, mut second]: [Candidate; 2],
    hover: &InnerInput,
    cold_ticks: usize,
    alive: &impl Fn(),
) -> ([u64; 2], u64, Usage) {
    let time = |candidate: &mut Candidate, first_tick: usize, times_ns: &mut [u64]| {
        for (tick, time_ns) in (first_tick as u64..).zip(times_ns) {
            let input = black_box(InnerInput { tick, ..*hover });
            let begun = Instant::now();
            black_box(candidate.tick(&input, false));
            *time_ns = begun.elapsed().as_nanos() as u64;
            alive();
        }
    };
    let (mut hot, mut cold) = (vec![0; HOT], vec![0; cold_ticks]);
    // A page fault in the memory of an instance recurs in the second instance, which gets the same inputs.
    let [one, other] = [&mut first, &mut second].map(|candidate| {
        time(candidate, 0, &mut hot);
        let meter = UsageMeter::start();
        time(candidate, HOT, &mut hot);
        meter.read()
    });
    let usage = min_by_key(one, other, |it| it.minor_faults + it.major_faults);
    hot.sort_unstable();
    let mut elsewhere = vec![0_u8; CACHES];
    for (i, time_ns) in cold.chunks_mut(1).enumerate() {
        let lines = elsewhere.iter_mut().step_by(64);
        lines.for_each(|byte| *byte = byte.wrapping_add(1));
        black_box(&mut elsewhere);
        time(&mut second, 2 * HOT + i, time_ns);
    }
    cold.sort_unstable();
    let hot = [hot[HOT / 2], hot[HOT * 99 / 100]];
    (hot, cold[cold_ticks / 2], usage)
}

/// Gives two instances of a law the same random inputs. `second` returns the answers of the second one, of a warm-up and
/// of the tick; nothing if it cannot. Finds the first answer that differs from that of the first instance, and the first
/// that is not finite.
fn compare<E>(
    rig: &Rig,
    inputs: u64,
    make: &impl Fn() -> Result<Candidate, E>,
    alive: &impl Fn(),
    mut second: impl FnMut(&mut Candidate, &InnerInput) -> Result<Option<[Answer; 2]>, E>,
) -> Result<[Option<BadAnswer>; 2], E> {
    // Always the same inputs.
    let mut rng = fastrand::Rng::with_seed(1);
    let (mut difference, mut not_finite) = (None, None);
    let first = |input: u64, [one, other]: &[Answer; 2], is_bad: fn(f64, f64) -> bool| {
        let mut both = one.iter().zip(other);
        let index = both.position(|(one, other)| is_bad(*one, *other))?;
        Some(BadAnswer {
            input,
            index,
            values: [one[index], other[index]],
        })
    };
    for life in 0..inputs / INPUTS_PER_LIFE {
        let (mut one, mut other) = (make()?, make()?);
        let mut input = hover(rig);
        for number in life * INPUTS_PER_LIFE..(life + 1) * INPUTS_PER_LIFE {
            draw_next(&mut input, &mut rng, rig);
            let Some(others) = second(&mut other, &input)? else {
                return Ok([None; 2]);
            };
            let answer = one.tick(&input, false);
            let pairs = others.map(|other| [answer, other]);
            alive();
            // NaN is a difference from everything but the same bits.
            let differs = |one: f64, other: f64| one.to_bits() != other.to_bits();
            difference =
                difference.or_else(|| pairs.iter().find_map(|it| first(number, it, differs)));
            not_finite = not_finite.or_else(|| {
                let is_bad = first(number, &pairs[0], |value, _| !value.is_finite());
                is_bad.filter(|bad| bad.index < ANSWER)
            });
        }
    }
    Ok([difference, not_finite])
}

/// Ends the process with code 3 if a law does not return.
#[derive(Debug)]
pub struct Watchdog(Arc<AtomicU64>);

impl Watchdog {
    /// Starts to watch a law that calls [`feed`](Self::feed) after every tick.
    pub fn start(law: &str) -> Result<Self, Failure> {
        let (ticks, law) = (Arc::new(AtomicU64::new(0)), law.to_owned());
        let watched = Arc::clone(&ticks);
        let watching = thread::Builder::new().spawn(move || watch(&watched, &law));
        watching.map_err(|e| {
            Failure::failed(format!(
                "cannot start the thread that watches the trial: {e}"
            ))
        })?;
        Ok(Self(ticks))
    }

    pub fn feed(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }
}

fn watch(ticks: &AtomicU64, law: &str) {
    let begun = Instant::now();
    let (mut last, mut since, mut reported) = (0, begun, begun);
    loop {
        thread::sleep(TICK_TIMEOUT / 20);
        let done = ticks.load(Ordering::Relaxed);
        if reported.elapsed() > TICK_TIMEOUT {
            reported = Instant::now();
            let (percent, seconds) = (100 * done / TICKS, begun.elapsed().as_secs());
            say(&format!(
                "the trial of `{law}`: {percent} % in {seconds} s; a fast law takes one\n"
            ));
        }
        if done != last {
            (last, since) = (done, Instant::now());
        } else if since.elapsed() > TICK_TIMEOUT {
            say(&format!(
                "error: the law `{law}` did not come back within {TICK_TIMEOUT:?}, after {done} inputs\n"
            ));
            // Without the library's exit handlers: they may not return either.
            crate::leave(GATE);
            end_now(i32::from(GATE));
        }
    }
}

/// Level in the origin, where the reference is too.
fn hover(rig: &Rig) -> InnerInput {
    let Rig { airframe, .. } = rig;
    let (thrust_n, speed) = (airframe.m() * airframe.g(), airframe.hover_speed_rad_s());
    InnerInput {
        given_age: 1,
        measured: Measured {
            specific_force_b_m_s2: [0.0, 0.0, airframe.g()],
            rotor_speed_mean_rad_s: [speed; 4],
            rotor_speed_squared_mean_rad2_s2: [speed * speed; 4],
            rotor_speed_command_rad_s: [speed; 4],
            ..Measured::default()
        },
        wanted: Desired {
            thrust_n,
            ..Desired::default()
        },
        given: Given {
            thrust_n,
            ..Given::default()
        },
        ..InnerInput::default()
    }
}

/// Draws the next input as a flight could have it: each number within its physical range, some ticks skipped, some
/// inputs held.
fn draw_next(input: &mut InnerInput, rng: &mut fastrand::Rng, rig: &Rig) {
    let is_skipped = rng.u8(..) < 16;
    let skipped = if is_skipped { rng.u64(1..500) } else { 0 };
    input.tick += 1 + skipped;
    input.measured_age += 1 + skipped;
    input.wanted_age += 1 + skipped;
    if rng.u8(..) >= 16 {
        (input.measured_age, input.measured) = (0, measured(rng, rig));
    }
    if rng.u8(..) >= 16 {
        (input.wanted_age, input.wanted) = (0, desired(rng, rig));
        input.reference = reference(rng);
    }
    input.given = Given {
        thrust_n: input.wanted.thrust_n,
        torque_b_nm: numbers(rng, 10.0),
        saturated: input.tick % 2,
        other_law: input.tick / 64 % 2,
    };
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
    let (least, most) = (rig.rotor.min_rad_s, rig.rotor.max_rad_s);
    let speed =
        |rng: &mut fastrand::Rng| std::array::from_fn(|_| least + (most - least) * rng.f64());
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

fn desired(rng: &mut fastrand::Rng, rig: &Rig) -> Desired {
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
