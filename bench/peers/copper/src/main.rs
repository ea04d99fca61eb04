//! Four stages as Copper tasks, 1 kHz: `copper SECONDS LOG.copper` prints the latency and lateness of each tick as JSON.

use std::error::Error;
use std::sync::atomic::{AtomicU64, Ordering};

use bincode::{Decode, Encode};
use cu29::curuntime::LoopRateLimiter;
use cu29::prelude::*;
use rustix::mm::{MlockAllFlags, mlockall};

const RATE_HZ: u64 = 1000;
const PERIOD_NS: u64 = 1_000_000_000 / RATE_HZ;
/// Preallocated size of Copper's log: a tick takes less than 1 kB of it.
const LOG_BYTES: usize = 64 << 20;

/// When the plant began its tick, and when the mixer ended it, on Copper's clock [ns].
static SAMPLED_NS: AtomicU64 = AtomicU64::new(0);
static PUBLISHED_NS: AtomicU64 = AtomicU64::new(0);

macro_rules! message {
    ($name:ident, $numbers:literal) => {
        #[derive(Clone, Debug, Default, Decode, Encode, Serialize, Deserialize, Reflect)]
        struct $name([f64; $numbers]);
    };
}
message!(State, 16);
message!(Setpoint, 16);
message!(Wrench, 4);

/// A task without a state: its type, its Copper trait and messages, and the work of a tick.
macro_rules! task {
    ($name:ident: $kind:ident, { $($type:ident = $message:ty),* }, |$($arg:ident: $of:ty),*| $work:block) => {
        #[derive(Reflect)]
        struct $name;

        impl Freezable for $name {}

        impl $kind for $name {
            type Resources<'r> = ();
            $(type $type<'m> = $message;)*

            fn new(_: Option<&ComponentConfig>, _: Self::Resources<'_>) -> CuResult<Self> {
                Ok(Self)
            }

            fn process(&mut self, $($arg: $of),*) -> CuResult<()> {
                $work
                Ok(())
            }
        }
    };
}

task!(Plant: CuSrcTask, { Output = output_msg!(State) }, |ctx: &CuContext, output: &mut Self::Output<'_>| {
    let now_ns = ctx.now().as_nanos();
    SAMPLED_NS.store(now_ns, Ordering::Relaxed);
    let phase = now_ns as f64 * 1e-9;
    output.set_payload(State(std::array::from_fn(|i| (phase + 0.1 * i as f64).fract())));
});

task!(Outer: CuTask, { Input = input_msg!(State), Output = output_msg!(Setpoint) },
|_ctx: &CuContext, input: &Self::Input<'_>, output: &mut Self::Output<'_>| {
    let State(state) = input.payload().ok_or("no state")?;
    output.set_payload(Setpoint(std::array::from_fn(|i| -6.5 * state[i] - 4.0 * state[(i + 3) % 16])));
});

task!(Inner: CuTask, { Input = input_msg!(Setpoint), Output = output_msg!(Wrench) },
|_ctx: &CuContext, input: &Self::Input<'_>, output: &mut Self::Output<'_>| {
    let Setpoint(wanted) = input.payload().ok_or("no setpoint")?;
    output.set_payload(Wrench(std::array::from_fn(|i| 0.1 * wanted[i] + 0.02 * wanted[i + 4])));
});

task!(Mixer: CuSinkTask, { Input = input_msg!(Wrench) }, |ctx: &CuContext, input: &Self::Input<'_>| {
    let Wrench([f, x, y, z]) = input.payload().ok_or("no wrench")?;
    let squares = [f + y - z, f - x + z, f - y - z, f + x + z];
    std::hint::black_box(squares.map(|square| square.max(0.0).sqrt()));
    PUBLISHED_NS.store(ctx.now().as_nanos(), Ordering::Relaxed);
});

#[copper_runtime(config = "copperconfig.ron")]
struct Rig {}

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().collect();
    let [_, seconds, log] = args.as_slice() else {
        return Err("usage: copper SECONDS LOG.copper".into());
    };
    let ticks = seconds.parse::<u64>()? * RATE_HZ;
    let clock = RobotClock::new();
    let app = Rig::builder()
        .with_clock(clock.clone())
        .with_log_path(log, Some(LOG_BYTES))?
        .build()?;
    let mut app = app.start()?;
    let (mut loops_us, mut lates_us) = (Vec::new(), Vec::new());
    mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE)?;

    // As in the loop that Copper generates, but it knows when the limiter's schedule began and ends after SECONDS.
    let schedule = || -> CuResult<_> {
        let limiter = LoopRateLimiter::from_rate_target_hz(RATE_HZ, &clock)?;
        Ok((limiter, clock.now().as_nanos()))
    };
    schedule()?; // Warm, the two readings of the clock are 0.1 us apart.
    let (mut limiter, begin_ns) = schedule()?;
    let (mut missed, mut next_tick) = (0, 1);
    while next_tick <= ticks {
        limiter.limit(&clock);
        app.run_one_iteration()?;
        let (sampled_ns, published_ns) = (
            SAMPLED_NS.load(Ordering::Relaxed),
            PUBLISHED_NS.load(Ordering::Relaxed),
        );
        loops_us.push((published_ns - sampled_ns) as f64 / 1e3);
        // A tick that was skipped is late until the next one that began.
        let tick = ((sampled_ns - begin_ns) / PERIOD_NS).max(next_tick);
        for late in next_tick..=tick {
            lates_us.push((sampled_ns as f64 - (begin_ns + late * PERIOD_NS) as f64) / 1e3);
        }
        missed += tick - next_tick + u64::from(published_ns > begin_ns + (tick + 1) * PERIOD_NS);
        next_tick = tick + 1;
    }
    app.stop()?;
    println!(
        "{}",
        serde_json::json!({ "loop_us": loops_us, "late_us": lates_us, "ticks": ticks, "missed": missed })
    );
    Ok(())
}
