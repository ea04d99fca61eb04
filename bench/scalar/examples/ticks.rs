//! Flies so many ticks by the rig's laws, or by hand, for a profiler: `ticks laws 10000`, `ticks hand 10000`.

use std::hint::black_box;

use controller::Trajectory;
use scalar::ScalarFlight;
use scalar::laws::Laws;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [who, ticks] = arguments.as_slice() else {
        return Err("two arguments: laws or hand, and a number of ticks".into());
    };
    let ticks = ticks
        .parse::<u64>()
        .map_err(|e| format!("{ticks:?} is no number of ticks: {e}"))?;
    match who.as_str() {
        "laws" => {
            let mut laws = Laws::new(Trajectory::Lissajous, 0)?;
            (0..ticks).for_each(|_| black_box(&mut laws).tick());
        }
        "hand" => {
            let mut hand = ScalarFlight::new();
            for _ in 0..ticks {
                black_box(black_box(&mut hand).tick());
            }
        }
        _ => return Err(format!("{who:?} is neither laws nor hand").into()),
    }
    Ok(())
}
