//! Four stages as HORUS nodes, 1 kHz: `horus SECONDS` prints the latency and lateness of each tick as JSON, in its last line.

use std::error::Error;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use horus_core::communication::Topic;
use horus_core::core::{DurationExt, Node, Rate};
use horus_core::scheduling::Scheduler;
use serde::{Deserialize, Serialize};

const RATE_HZ: u64 = 1000;
const PERIOD_NS: u64 = 1_000_000_000 / RATE_HZ;

/// When the plant began its tick, and when the mixer ended it [ns].
static SAMPLED_NS: AtomicU64 = AtomicU64::new(0);
static PUBLISHED_NS: AtomicU64 = AtomicU64::new(0);
static BEGIN: LazyLock<Instant> = LazyLock::new(Instant::now);

fn now_ns() -> u64 {
    BEGIN.elapsed().as_nanos() as u64
}

#[derive(Clone, Copy, Serialize, Deserialize)]
struct State([f64; 16]);
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Setpoint([f64; 16]);
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Wrench([f64; 4]);

/// A node: its type, its topics, and the work of a tick.
macro_rules! node {
    ($name:ident($($topic:ident: $message:ty),*), |$node:ident| $work:block) => {
        struct $name {
            $($topic: Topic<$message>,)*
        }

        impl $name {
            fn new() -> Result<Self, horus_core::HorusError> {
                Ok(Self { $($topic: Topic::new(stringify!($topic))?,)* })
            }
        }

        impl Node for $name {
            fn name(&self) -> &str {
                stringify!($name)
            }

            fn tick(&mut self) {
                let $node = self;
                $work
            }
        }
    };
}

node!(Plant(state: State), |node| {
    let now_ns = now_ns();
    SAMPLED_NS.store(now_ns, Ordering::Relaxed);
    let phase = now_ns as f64 * 1e-9;
    let state = std::array::from_fn(|i| (phase + 0.1 * i as f64).fract());
    node.state.send(State(state));
});

node!(Outer(state: State, setpoint: Setpoint), |node| {
    let State(state) = node.state.recv().expect("no state");
    let wanted = std::array::from_fn(|i| -6.5 * state[i] - 4.0 * state[(i + 3) % 16]);
    node.setpoint.send(Setpoint(wanted));
});

node!(Inner(setpoint: Setpoint, wrench: Wrench), |node| {
    let Setpoint(wanted) = node.setpoint.recv().expect("no setpoint");
    let wrench = std::array::from_fn(|i| 0.1 * wanted[i] + 0.02 * wanted[i + 4]);
    node.wrench.send(Wrench(wrench));
});

node!(Mixer(wrench: Wrench), |node| {
    let Wrench([f, x, y, z]) = node.wrench.recv().expect("no wrench");
    let squares = [f + y - z, f - x + z, f - y - z, f + x + z];
    std::hint::black_box(squares.map(|square| square.max(0.0).sqrt()));
    PUBLISHED_NS.store(now_ns(), Ordering::Relaxed);
});

fn main() -> Result<(), Box<dyn Error>> {
    let seconds = std::env::args().nth(1).ok_or("usage: horus SECONDS")?;
    let ticks = seconds.parse::<u64>()? * RATE_HZ;
    // SCHED_FIFO and locked memory. Nodes have no `rate`: each would get a thread of its own.
    let mut scheduler = Scheduler::new().require_rt().tick_rate(RATE_HZ.hz());
    scheduler.add(Plant::new()?).order(0).build()?;
    scheduler.add(Outer::new()?).order(1).build()?;
    scheduler.add(Inner::new()?).order(2).build()?;
    scheduler.add(Mixer::new()?).order(3).build()?;
    scheduler.tick_once()?; // Initializes the nodes and real time.

    let (mut loops_us, mut lates_us) = (Vec::new(), Vec::new());
    let (mut missed, mut tick) = (0, 0);
    let mut rate = Rate::new(RATE_HZ as f64);
    let mut due_ns = now_ns();
    while tick < ticks {
        rate.sleep();
        due_ns += PERIOD_NS;
        let woken_ns = now_ns();
        scheduler.tick_once()?;
        let [sampled_ns, published_ns] =
            [&SAMPLED_NS, &PUBLISHED_NS].map(|ns| ns.load(Ordering::Relaxed));
        loops_us.push((published_ns - sampled_ns) as f64 / 1e3);
        // A tick that was skipped is late until the next one that began.
        let skipped = woken_ns.saturating_sub(due_ns) / PERIOD_NS;
        for late in 0..=skipped {
            lates_us.push((sampled_ns as f64 - (due_ns + late * PERIOD_NS) as f64) / 1e3);
        }
        if skipped > 0 {
            due_ns = woken_ns; // Here `Rate` begins its schedule anew.
        }
        missed += skipped + u64::from(published_ns > due_ns + PERIOD_NS);
        tick += skipped + 1;
    }
    println!(
        "{}",
        serde_json::json!({ "loop_us": loops_us, "late_us": lates_us, "ticks": tick, "missed": missed })
    );
    Ok(())
}
