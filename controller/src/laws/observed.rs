//! What the laws with an observer of the disturbance share: the attitude and rate loop of the paper's inner law, where
//! that which an observer says takes the place of the estimates of I_R, k_r and delta.
//!
//! ```text
//!     tau = I_M( dnu2_d - a_d e - f(nu2) - w ),   e = nu2 - nu2_d,   a_d = (1 - exp(-alpha T))/T
//! ```
//!
//! w is the disturbance [rad/s^2]: what the rates gained over the last tick beyond g = T (I_M^-1 tau_m + fb). tau_m is the
//! torque of (7) at the measured squared speeds of the rotors, and fb the mean of f at both ends of the tick. As it says
//! what the rotors really gave, delay, saturation and slow motors are no disturbance.
//!
//! A tick counts only if both its start and its end were measured. After a gap the observer begins anew from the measured
//! rates, and after more than 100 ms it has forgotten the disturbance too.

use control_api::description::{Description, Refused, Setting, Settings, Value, number, settings};
use control_api::law::{Fields, InnerInput, InnerLaw, Law, Rig, WrenchSetpoint};
use messages::content::Measured;
use messages::rate_dynamics::Inertia;
use messages::telemetry::Telemetry;
use nalgebra::Vector3;

use crate::adaptation::Samples;
use crate::attitude_loop::AttitudeLoop;
use crate::gains::{self, Gains};
use crate::rate_law::sampled_gain;
use crate::rate_loop;

settings! {
    pub ALPHA_1_S = "alpha_1_s", "1/s", number(150.0, f64::MIN_POSITIVE, f64::MAX), "alpha, decay of the rate error";
}

/// A whole tick as an observer sees it.
pub struct RateTick {
    /// nu2 at its start and at its end [rad/s].
    pub start: Vector3<f64>,
    pub end: Vector3<f64>,
    /// g, what the model says that the rates have gained [rad/s].
    pub gained: Vector3<f64>,
}

pub trait Observer: Clone + Send + 'static {
    const DESCRIPTION: Description;

    fn new(settings: &Settings, period_s: f64) -> Self;

    fn take(&mut self, tick: &RateTick);

    /// Begins anew from measured rates [rad/s], after a gap; after a long one it forgets the disturbance too.
    fn restart(&mut self, nu2: &Vector3<f64>, is_long: bool);

    /// w at body rates `nu2` [rad/s^2].
    fn disturbance(&self, nu2: &Vector3<f64>) -> Vector3<f64>;

    fn state(&mut self, fields: &mut Fields);

    /// Its signals, three numbers each.
    fn shown(&self) -> impl IntoIterator<Item = Vector3<f64>>;
}

#[derive(Clone, Debug)]
pub struct Observed<O> {
    inertia: Inertia,
    period_s: f64,
    gain: f64,
    attitude: AttitudeLoop,
    samples: Samples,
    observer: O,
}

impl<O: Observer> Observed<O> {
    /// With a measurement of this tick: observes the last tick, then asks for a torque [N m].
    fn control(&mut self, tick: u64, measured: &Measured, shown: &mut Telemetry) -> Vector3<f64> {
        let (inertia, newest) = (&self.inertia, self.samples.newest_tick());
        let nu2 = Vector3::from(measured.rate_b_rad_s);
        if let Some(last) = self.samples.take(tick, measured) {
            let (start, end) = (last.nu2_start, last.nu2_end);
            let f = 0.5 * (inertia.coupling(&start) + inertia.coupling(&end));
            let gained = self.period_s * (inertia.acceleration(&last.tau_m) + f);
            self.observer.take(&RateTick { start, end, gained });
        } else {
            let is_long = self.attitude.is_lost(newest, tick);
            self.observer.restart(&nu2, is_long);
        }
        let reference = self.attitude.reference(&measured.attitude_rad.into(), &nu2);
        let e = nu2 - reference.nu2_d;
        let unmodelled = inertia.coupling(&nu2) + self.observer.disturbance(&nu2);
        let wanted = reference.dnu2_d - self.gain * e - unmodelled;
        let signals = [e].into_iter().chain(self.observer.shown());
        for (shown, signal) in shown.value.chunks_exact_mut(3).zip(signals) {
            shown.copy_from_slice(signal.as_slice());
        }
        inertia.i_m().component_mul(&wanted)
    }
}

impl<O: Observer> Law for Observed<O> {
    const DESCRIPTION: Description = O::DESCRIPTION;

    fn new(rig: &Rig, settings: &Settings) -> Result<Self, Refused> {
        let gains = gains(settings);
        rate_loop::check_alpha(rig, gains.alpha_1_s, rate_loop::CHAIN_DELAY_TICKS, "")?;
        Ok(Self {
            inertia: Inertia::new(rig.airframe.i_m().into()),
            period_s: rig.period_s,
            gain: sampled_gain(gains.alpha_1_s, rig.period_s),
            attitude: AttitudeLoop::new(rig, &gains),
            samples: Samples::new(rig),
            observer: O::new(settings, rig.period_s),
        })
    }

    fn state(&mut self, fields: &mut Fields) {
        self.attitude.state(fields);
        self.samples.state(fields);
        self.observer.state(fields);
    }
}

impl<O: Observer> InnerLaw for Observed<O> {
    fn tick(&mut self, input: &InnerInput, telemetry: &mut Telemetry) -> WrenchSetpoint {
        let newest = self.samples.newest_tick();
        let (tick, wanted) = (input.tick, &input.wanted);
        let measured = (input.measured_age == 0).then_some(&input.measured);
        self.attitude.begin(tick, wanted, newest, measured);
        let tau = measured.map(|measured| self.control(tick, measured, telemetry));
        self.attitude.end(tick);
        WrenchSetpoint {
            thrust_n: wanted.thrust_n,
            torque_b_nm: tau.unwrap_or_default().into(),
        }
    }
}

fn gains(settings: &Settings) -> Gains {
    Gains {
        alpha_1_s: settings.number(&ALPHA_1_S),
        ..Gains::of(settings)
    }
}

/// As [`gains::suited`]. A setting of the observer that is a frequency to some power goes with alpha; nothing in an
/// observer depends on the size of the airframe.
pub fn suited(settings: &Settings, rig: &Rig, observers: &[(&Setting, i32)]) -> Settings {
    let (suited, slowed) = gains::suited_of(settings, &gains(settings), rig);
    observers.iter().fold(suited, |suited, (setting, power)| {
        let factor = (0..*power).fold(1.0, |factor, _| factor * slowed);
        let value = match suited.value(setting) {
            Value::Number(number) => Value::Number(factor * number),
            Value::Three(numbers) => Value::Three(numbers.map(|number| factor * number)),
            word @ Value::Word(_) => word,
        };
        suited.with(setting, value)
    })
}
