//! Times both flights in turn: laws, hand, laws, hand.
//!
//! Interleaving them makes a disturbance of the machine hit both.

use std::hint::black_box;
use std::time::Instant;

use control_api::description::Refused;

use crate::ScalarFlight;
use crate::laws::Laws;

/// One pair: the same ticks by the rig's laws and by hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedPair {
    /// By the laws, without monitor [s per tick].
    pub laws_s: f64,
    /// By hand [s per tick].
    pub scalar_s: f64,
}

impl TimedPair {
    /// How many times longer the laws take.
    #[must_use]
    pub fn ratio(&self) -> f64 {
        self.laws_s / self.scalar_s
    }
}

/// Flies the first `ticks` ticks by the laws and by hand, in turn, `pairs` times.
///
/// One pair before them is flown and not counted: it finds caches and processor cold.
pub fn pairs(pairs: usize, ticks: u64) -> Result<Vec<TimedPair>, Refused> {
    let pair = || {
        Ok(TimedPair {
            laws_s: time(ticks, Laws::new()?, Laws::tick),
            scalar_s: time(ticks, ScalarFlight::new(), ScalarFlight::tick),
        })
    };
    black_box(pair()?);
    (0..pairs).map(|_| pair()).collect()
}

/// Seconds per tick of a flight from its beginning.
fn time<F, S>(ticks: u64, flight: F, tick: impl Fn(&mut F) -> S) -> f64 {
    let mut flight = black_box(flight);
    let start = Instant::now();
    for _ in 0..ticks {
        black_box(tick(black_box(&mut flight)));
    }
    start.elapsed().as_secs_f64() / ticks as f64
}

#[cfg(test)]
mod tests {
    use controller::laws::adaptive;

    use super::*;

    /// Ticks of a flight of 10 s.
    const TICKS: u64 = 10_000;

    #[test]
    fn the_flight_by_hand_is_the_flight_of_the_laws() {
        let (mut laws, mut hand) = (Laws::new().unwrap(), ScalarFlight::new());
        for tick in 0..=TICKS {
            laws.tick();
            let (state, wrench, speeds) = laws.newest();
            let sample = hand.tick();
            let attitude = [state.measured.attitude_rad, state.measured.rate_b_rad_s].concat();
            let body = [
                [state.measured.position_w_m, state.measured.velocity_w_m_s].concat(),
                attitude,
            ]
            .concat();
            let demand = [[wrench.thrust_n].as_slice(), &wrench.torque_b_nm].concat();
            for (name, ours, by_hand) in [
                ("body", body.as_slice(), sample.body.as_slice()),
                ("thrust and torque", &demand, &sample.wrench),
                (
                    "estimates",
                    &adaptive::estimate(&wrench.telemetry),
                    &sample.estimate,
                ),
                ("rotor speeds", &speeds.speed_rad_s, &sample.speed),
            ] {
                for (i, (ours, by_hand)) in ours.iter().zip(by_hand).enumerate() {
                    let off = (ours - by_hand).abs();
                    assert!(
                        off < 1e-9,
                        "{name} {i} at tick {tick}: {by_hand} by hand, {ours} by the laws: {off:e}"
                    );
                }
            }
        }
        let (state, ..) = laws.newest();
        assert!(
            state.measured.position_w_m[2] > 1.0,
            "it flew: {:?}",
            state.measured.position_w_m
        );
    }

    #[test]
    fn every_pair_is_two_times_and_there_are_as_many_as_were_asked_for() {
        let pairs = pairs(2, 100).unwrap();
        assert_eq!(pairs.len(), 2);
        for pair in pairs {
            assert!(
                pair.laws_s > 0.0 && pair.scalar_s > 0.0 && pair.ratio().is_finite(),
                "{pair:?}"
            );
        }
    }
}
