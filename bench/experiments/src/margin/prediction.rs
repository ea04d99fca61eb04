//! Predicted margins: the frequency response of the sampled loop at hover.
//!
//! An impulse d is added somewhere in the loop, in two flights of opposite sign. Half of the difference of what comes back
//! there, per d, is the response C of the closed loop, and L = -C / (1 + C) the open one. It contains all that a law does
//! for small signals, so it needs no knowledge of the law. The loop is cut where the fault of the flights acts:
//!
//! * for the delay at the rotor commands: d is added to those along one axis, before the plant measures the rotors;
//! * for the gain behind the measured rotors: d is an angular acceleration, by the gain of the disturbance h(t) in (3), and
//!   the torque of the rotors comes back, with the reaction of those that change their speed.
//!   An observer that measures the rotors knows their torque. It attributes the extra acceleration of a higher gain to a
//!   disturbance and compensates it; a cut at the commands hides this and overestimates the gain margin.

use std::f64::consts::{PI, TAU};
use std::sync::atomic::AtomicBool;

use analysis::margin::{LoopMargin, Prediction};
use errors::Failure;
use messages::parameters::Parameter;
use messages::rate_dynamics::disturbance;
use nalgebra::{Complex, ComplexField, Vector3, Vector4};

use crate::margin::flights::{base, rig};
use crate::parallel::check_stop;
use config::Settings;
use sim::simulator::Simulator;

/// Rotors that an axis speeds up or slows down.
const AXES: [(&str, [f64; 4]); 3] = [
    ("roll", [1.0, -1.0, -1.0, 1.0]),
    ("pitch", [1.0, 1.0, -1.0, -1.0]),
    ("yaw", [1.0, -1.0, 1.0, -1.0]),
];
/// When the loop is settled [s].
const FROM_S: f64 = 15.0;
/// How long the response is recorded [s].
const LENGTH_S: f64 = 8.0;
/// The impulse, as a share of the rotor speed in hover.
const IMPULSE: f64 = 1e-4;
/// The impulse of the gain of the disturbance, which lasts for a tick [rad/s^2].
const ACCELERATION_RAD_S2: f64 = 0.01;
const DISTURBANCE: Parameter = Parameter::DisturbanceGain;
/// Share of the response's peak that may be left at its end.
const REST: f64 = 0.02;
/// The lowest frequency: below are the position loops [rad/s].
const LOWEST_RAD_S: f64 = 2.0;
const FREQUENCIES: i32 = 300;

pub fn predicted(settings: &Settings, stop: &AtomicBool) -> Result<Prediction, Failure> {
    // An external program is not deterministic, so the difference of two flights with one means nothing.
    if firmware::is_program(settings.laws()?[1].name) {
        return Ok(Prediction::default());
    }
    let mut settings = settings.clone();
    settings.flight.trajectory = "hover".into();
    settings.trajectory.size = 1.0;
    settings.trajectory.period = 1.0;
    settings.trajectory.sha256.clear();
    settings.points = None;
    settings.flight.duration_s = FROM_S + LENGTH_S;
    let period_s = settings.flight.period_s;
    let from = (FROM_S / period_s).round() as u64;
    let airframe = settings.airframe()?;
    let impulse = IMPULSE * airframe.hover_speed_rad_s();
    let base = base(&settings, from, stop)?;
    let mut flown = |faults: Vec<String>, look: &dyn Fn(&Simulator) -> Vector3<f64>| {
        settings.flight.faults = faults;
        let mut rig = rig(base.as_deref(), &settings)?;
        let mut seen = Vec::new();
        while rig.next_tick() <= settings.last_tick() {
            check_stop(stop)?;
            rig.tick();
            if rig.flown_tick() >= from {
                seen.push(look(&rig));
            }
        }
        Ok::<_, Failure>(seen)
    };
    let [above, below] = [1.0, -1.0].map(|sign| {
        let gain = airframe.delta() + sign * ACCELERATION_RAD_S2;
        let set = |gain: f64, tick: u64| format!("{}={gain}@tick{tick}", DISTURBANCE.name());
        let faults = vec![set(gain, from), set(airframe.delta(), from + 1)];
        flown(faults, &|rig| {
            let torque = Vector3::from(rig.plant().mean_torque_b_nm());
            torque.component_div(&Vector3::from(airframe.i_m()))
        })
    });
    let h = disturbance((from as f64 + 0.5) * period_s);
    let accelerations: Vec<Vector3<f64>> = above?
        .into_iter()
        .zip(below?)
        .map(|(a, b)| (a - b).component_div(&(2.0 * ACCELERATION_RAD_S2 * h)))
        .collect();
    let mut prediction = Prediction::default();
    for (i, (axis, signs)) in AXES.into_iter().enumerate() {
        let mut commands = |impulse: f64| {
            let biases = (1..)
                .zip(signs)
                .map(|(i, sign)| format!("rotor_speeds.speed_rad_s.{i}.bias={}", sign * impulse));
            let biases = biases.collect::<Vec<_>>().join(",");
            let fault = format!("{biases}@tick{from}..tick{}", from + 1);
            flown(vec![fault], &|rig| {
                let speeds = Vector4::from(rig.rotor_speeds().speed_rad_s);
                Vector3::repeat(Vector4::from(signs).dot(&speeds) / 4.0)
            })
        };
        let pair = commands(impulse)?.into_iter().zip(commands(-impulse)?);
        let response: Vec<f64> = pair.map(|(a, b)| (a - b).x / (2.0 * impulse)).collect();
        let behind: Vec<f64> = accelerations.iter().map(|it| it[i]).collect();
        match margin(axis, &response, period_s).zip(margin(axis, &behind, period_s)) {
            Some((at_commands, behind_rotors)) => prediction.axes.push(LoopMargin {
                gain: behind_rotors.gain,
                ..at_commands
            }),
            None => prediction.unsettled.push(axis.into()),
        }
    }
    Ok(prediction)
}

/// The margins of a loop, from the closed loop's response to an impulse at its first tick; none if that does not decay.
fn margin(axis: &str, response: &[f64], period_s: f64) -> Option<LoopMargin> {
    let mut margin = LoopMargin {
        axis: axis.into(),
        ..LoopMargin::default()
    };
    let peak = |part: &[f64]| part.iter().fold(0.0_f64, |most, it| most.max(it.abs()));
    let end = response.len() - response.len() / 10;
    // Also where a flight diverged.
    if peak(&response[end..]) > REST * peak(response) {
        return None;
    }
    // Frequencies in radians per tick.
    let open = |w: f64| {
        let z = Complex::new(w.cos(), -w.sin());
        let sum = |sum: Complex<f64>, it: &f64| sum * z + it;
        let closed = response.iter().rev().fold(Complex::default(), sum);
        -closed / (closed + 1.0)
    };
    let lowest = LOWEST_RAD_S * period_s;
    let frequency = |i: i32| lowest * (PI / lowest).powf(f64::from(i) / f64::from(FREQUENCIES));
    let curve: Vec<(f64, Complex<f64>)> = (0..=FREQUENCIES)
        .map(|i| (frequency(i), open(frequency(i))))
        .collect();
    let crossings = |of: fn(Complex<f64>) -> f64| {
        let pairs = curve
            .windows(2)
            .filter(move |pair| of(pair[0].1) * of(pair[1].1) < 0.0);
        let root = move |pair: &[(f64, Complex<f64>)]| {
            let (mut low, mut high) = (pair[0].0, pair[1].0);
            for _ in 0..30 {
                let middle = (low + high) / 2.0;
                match of(open(middle)) * of(pair[0].1) > 0.0 {
                    true => low = middle,
                    false => high = middle,
                }
            }
            (low, open(low))
        };
        pairs.map(root)
    };
    let delay = |(w, l): (f64, Complex<f64>)| (w, (l.argument() + PI).rem_euclid(TAU));
    let crossovers = crossings(|l| l.modulus() - 1.0).map(delay);
    if let Some((w, phase)) = crossovers.min_by(|a, b| (a.1 / a.0).total_cmp(&(b.1 / b.0))) {
        margin.crossover_rad_s = Some(w / period_s);
        margin.phase_margin_deg = Some(phase.to_degrees());
        margin.delay_ticks = Some(phase / w);
    }
    let real = crossings(|l| l.im).chain([(PI, open(PI))]);
    let gains = real
        .filter(|(_, l)| l.re < 0.0 && l.modulus() < 1.0)
        .map(|(_, l)| 1.0 / l.modulus());
    margin.gain = gains.min_by(f64::total_cmp);
    Some(margin)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The rate loop of docs/paper.md: an integrator of gain c per tick, and a delay of d ticks.
    #[test]
    fn the_margins_of_a_delayed_integrator_are_those_of_its_rule() {
        for (c, d) in [(0.1813, 1), (0.3, 2), (0.05, 8)] {
            let mut response: Vec<f64> = Vec::new();
            let mut rate = vec![0.0];
            for k in 0..8000_usize {
                // The command of d ticks ago acts, with the impulse at the first tick.
                let command = -c * k.checked_sub(d).map_or(0.0, |it| rate[it]);
                let impulse = if k == 0 { 1.0 } else { 0.0 };
                response.push(command);
                rate.push(rate[k] + command + impulse);
            }
            let found = margin("roll", &response, 1e-3).unwrap();
            let limit = |d: f64| 2.0 * (PI / (2.0 * (2.0 * d + 1.0))).sin();
            let gain = limit(d as f64) / c;
            // At d and the delay margin, c is the limit.
            let delay = (PI / (2.0 * (c / 2.0_f64).asin()) - 1.0) / 2.0 - d as f64;
            let close = |found: Option<f64>, of: f64| (found.unwrap() / of - 1.0).abs() < 1e-6;
            assert!(close(found.gain, gain), "{found:?}, gain {gain}");
            assert!(close(found.delay_ticks, delay), "{found:?}, delay {delay}");
        }
        // An oscillation that stays is no response to an impulse.
        let rings: Vec<f64> = (0..8000).map(|k| f64::from(k).sin()).collect();
        assert_eq!(margin("yaw", &rings, 1e-3), None);
    }
}
