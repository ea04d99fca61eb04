//! What the check word of a message costs: sealing it and opening it once, per topic.
//!
//!     cargo run --release -p messages --example check_word
//!
//! A hop is one of each. `valgrind --tool=callgrind --toggle-collect='*check_word*'` counts instructions, with `once`
//! behind it.

use std::hint::black_box;
use std::io::Write as _;
use std::time::Instant;

use messages::check_word::check_word;
use messages::content::{RotorSpeeds, Setpoint, State, Wrench};
use messages::header::Message;

const CALLS: u32 = 20_000;
const ROUNDS: usize = 200;

#[inline(never)]
fn measured(words: &[u64]) -> u64 {
    check_word(words)
}

fn main() -> std::io::Result<()> {
    let is_once = std::env::args().nth(1).is_some();
    let mut out = std::io::stdout().lock();
    for (topic, bytes) in [
        ("state", size_of::<Message<State>>()),
        ("setpoint", size_of::<Message<Setpoint>>()),
        ("wrench", size_of::<Message<Wrench>>()),
        ("rotor_speeds", size_of::<Message<RotorSpeeds>>()),
    ] {
        let words: Vec<u64> = (0..bytes as u64 / 8)
            .map(|i| (i as f64 * 0.37).to_bits())
            .collect();
        if is_once {
            writeln!(
                out,
                "{topic}: {} words, {:016x}",
                words.len(),
                measured(&words)
            )?;
            continue;
        }
        let mut rounds: Vec<f64> = (0..ROUNDS)
            .map(|_| {
                let begin = Instant::now();
                for _ in 0..CALLS {
                    black_box(measured(black_box(&words)));
                }
                begin.elapsed().as_nanos() as f64 / f64::from(CALLS)
            })
            .collect();
        rounds.sort_by(f64::total_cmp);
        let [least, median] = [0, ROUNDS / 2].map(|at| rounds[at]);
        writeln!(
            out,
            "{topic:12} {:3} words: one word {least:.1} ns at the least, {median:.1} at the median; a hop {:.1} ns",
            words.len(),
            2.0 * median
        )?;
    }
    Ok(())
}
