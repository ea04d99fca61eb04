//! Inner law `pid`: the cascade that flight stacks fly, attitude P and rate PID.
//!
//! Source: the multicopter attitude and rate controllers of the PX4 autopilot (BSD-3-Clause), as its documentation
//! draws them ("Controller Diagrams"), and for the attitude Dario Brescianini, Markus Hehn, Raffaello D'Andrea,
//! "Nonlinear Quadrocopter Attitude Control", ETH Zurich, 2013: tilt first, yaw with a weight.
//!
//! ```text
//!     q_t = shortest turn of R z_e into R_d z_e, then q
//!     q_t^-1 q_d is a turn about z by some angle a:   q_w = q_t z(yaw_weight a)
//!     nu2_r = P_eta 2 vec(q^-1 q_w) + nu2_d, each axis within its largest rate;   e = nu2_r - nu2
//!     tau = I_M( P e + i - D H(s) d(nu2) )
//!     i <- clip(i + T I max(0, 1 - (e/400 deg/s)^2) e, +-i_max); an axis whose torque the rotors cannot give takes no
//!                                                                error that asks for more of it
//! ```
//!
//! While another law flies, i follows the torque tau_g that is flown instead, P/I after it:
//!
//! ```text
//!     i <- clip(i + T I/P (I_M^-1 tau_g + D H(s) d(nu2) - i), +-i_max)
//! ```
//!
//! Differences from PX4:
//! * The torque is normalised by the inertia, so that P is in 1/s, I in 1/s^2, and D a ratio, on any airframe.
//! * The rates along the reference are fed forward on all axes: here the outer law knows them. PX4 does so for yaw.
//! * (7) inverted gives whether the rotors can give the torque in the same tick, not the mixer's answer.
//! * The acceleration is filtered by a low-pass of second order; the filter of the rates themselves is left out.

use std::f64::consts::FRAC_1_SQRT_2;

use control_api::description::{Description, Refused, Settings, number, settings, signal, three};
use control_api::law::{Fields, InnerInput, InnerLaw, Law, Rig, WrenchSetpoint};
use messages::allocation::Allocation;
use messages::attitude::Attitude;
use messages::math::{atan2, sin_cos};
use messages::role::Role;
use messages::telemetry::Telemetry;
use nalgebra::Vector3;

use crate::laws::cascade::{self, DesiredAttitude, LastRates, RateStep};
use crate::laws::low_pass::LowPass;

/// Rate error at which the integrator takes nothing any more [rad/s].
const INTEGRATOR_ERROR_MAX: f64 = 400_f64.to_radians();

settings! {
    SETTINGS;
    ATTITUDE = "attitude_1_s", "1/s", three([8.0, 8.0, 3.0], 0.1, 200.0), "P of the attitude error: roll, pitch, yaw";
    YAW_WEIGHT = "yaw_weight", "", number(0.4, 0.05, 1.0), "share of a yaw error that the attitude error holds; the gain makes up for it, up to the largest rate";
    RATE_MAX = "rate_max_rad_s", "rad/s", three([4.0, 4.0, 3.5], 0.1, 40.0), "largest rates wanted: roll, pitch, yaw";
    RATE = "rate_1_s", "1/s", three([40.0, 40.0, 20.0], 0.1, 1000.0), "P of the rate error: roll, pitch, yaw";
    INTEGRAL = "integral_1_s2", "1/s^2", three([120.0, 120.0, 40.0], 0.0, 1e5), "I of the rate error: roll, pitch, yaw";
    DERIVATIVE = "derivative", "", three([0.2, 0.2, 0.0], 0.0, 0.9), "D, ratio of the angular acceleration: roll, pitch, yaw";
    INTEGRAL_MAX = "integral_max_rad_s2", "rad/s^2", three([60.0, 60.0, 10.0], 0.0, 1e4), "largest integrator: roll, pitch, yaw";
    FILTER = "filter_rad_s", "rad/s", number(190.0, 1.0, 5000.0), "bandwidth of the low-pass of the angular acceleration";
}

#[derive(Clone, Debug)]
pub struct Pid {
    rig: Rig,
    allocation: Allocation,
    i_m: Vector3<f64>,
    attitude: Vector3<f64>,
    yaw_weight: f64,
    rate_max: Vector3<f64>,
    p: Vector3<f64>,
    i: Vector3<f64>,
    d: Vector3<f64>,
    integral_max: Vector3<f64>,
    /// i [rad/s^2].
    integral: Vector3<f64>,
    acceleration: LowPass,
    last: LastRates,
    thrust_n: f64,
}

impl Law for Pid {
    const DESCRIPTION: Description = Description {
        name: "pid",
        role: Role::Inner,
        version: "1",
        summary: "attitude P on the quaternion and rate PID, in the structure that flight stacks fly",
        source: "PX4 autopilot, multicopter attitude and rate control; Brescianini, Hehn, D'Andrea, Nonlinear \
                 Quadrocopter Attitude Control, 2013",
        settings: SETTINGS,
        presets: &[],
        suited: None,
        telemetry: &[
            signal("rate_error_x_rad_s", "rad/s"),
            signal("rate_error_y_rad_s", "rad/s"),
            signal("rate_error_z_rad_s", "rad/s"),
            signal("integral_x_rad_s2", "rad/s^2"),
            signal("integral_y_rad_s2", "rad/s^2"),
            signal("integral_z_rad_s2", "rad/s^2"),
            signal("saturated", ""),
        ],
    };

    fn new(rig: &Rig, settings: &Settings) -> Result<Self, Refused> {
        let (attitude, rate) = (settings.three(&ATTITUDE), settings.three(&RATE));
        cascade::check((&ATTITUDE, &attitude), (&RATE, &rate), rig.period_s)?;
        Ok(Self {
            rig: *rig,
            allocation: Allocation::new(&rig.airframe),
            i_m: rig.airframe.i_m().into(),
            attitude: attitude.into(),
            yaw_weight: settings.number(&YAW_WEIGHT),
            rate_max: settings.three(&RATE_MAX).into(),
            p: rate.into(),
            i: settings.three(&INTEGRAL).into(),
            d: settings.three(&DERIVATIVE).into(),
            integral_max: settings.three(&INTEGRAL_MAX).into(),
            integral: Vector3::zeros(),
            acceleration: LowPass::new(
                &FILTER,
                settings.number(&FILTER),
                FRAC_1_SQRT_2,
                rig.period_s,
            )?,
            last: LastRates::default(),
            thrust_n: rig.airframe.m() * rig.airframe.g(),
        })
    }

    fn state(&mut self, fields: &mut Fields) {
        fields.all([&mut self.integral, &mut self.acceleration]);
        fields.all([&mut self.last, &mut self.thrust_n]);
    }
}

/// The attitude wanted with its turn about z, beyond the tilt from `q`, reduced to `weight` of it.
fn weighted(q: &Attitude, q_d: &Attitude, weight: f64) -> Attitude {
    let axis = |attitude: &Attitude| attitude.to_world(&Vector3::z());
    // Upside down no tilt is the shortest, and the attitude wanted is taken as it is.
    let Some(tilt) = Attitude::between(&axis(q), &axis(q_d)) else {
        return *q_d;
    };
    let q_t = tilt.times(q);
    let about_z = q_t.inverse().times(q_d).short_way();
    let (sin, cos) = sin_cos(weight * atan2(about_z.vector().z, about_z.scalar()));
    q_t.times(&Attitude::of_parts(cos, sin * Vector3::z()))
}

impl Pid {
    /// Takes the measurement of `tick`: the filter moves on where the tick before it was measured too.
    fn take(&mut self, tick: u64, nu2: &Vector3<f64>) {
        match self.last.take(tick, nu2, self.rig.period_s) {
            RateStep::Whole(acceleration) => {
                self.acceleration.take(&acceleration);
            }
            RateStep::Forget => {
                self.acceleration.forget();
                self.integral = Vector3::zeros();
            }
            RateStep::Nothing => {}
        }
    }

    /// Whether a rotor would have to leave its range for thrust `u` [N] and torque `tau` [N m].
    fn saturates(&self, u: f64, tau: &Vector3<f64>) -> bool {
        let (k, rotor) = (self.rig.airframe.k(), &self.rig.rotor);
        let range = rotor.f_min(k)..=rotor.f_max(k);
        let thrusts = self.allocation.thrusts(u, tau);
        !thrusts.iter().all(|f| range.contains(f))
    }

    /// The integrator after a tick in which another law's torque `flown` [N m] acted.
    fn following(&self, flown: &Vector3<f64>, damping: &Vector3<f64>) -> Vector3<f64> {
        let wanted = flown.component_div(&self.i_m) + damping;
        let rate = self.i.component_div(&self.p) * self.rig.period_s;
        let moved = self.integral + rate.component_mul(&(wanted - self.integral));
        moved.sup(&-self.integral_max).inf(&self.integral_max)
    }

    /// The integrator after a tick with rate error `e` [rad/s] that asked for `tau` [N m].
    fn integrated(&self, e: &Vector3<f64>, tau: &Vector3<f64>, saturated: bool) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| {
            let (e, limit) = (e[axis], self.integral_max[axis]);
            let asks_for_more = saturated && e * tau[axis] > 0.0;
            let taken = if asks_for_more { 0.0 } else { e };
            let factor = (1.0 - (e / INTEGRATOR_ERROR_MAX) * (e / INTEGRATOR_ERROR_MAX)).max(0.0);
            (self.integral[axis] + self.rig.period_s * self.i[axis] * factor * taken)
                .clamp(-limit, limit)
        })
    }
}

impl InnerLaw for Pid {
    /// Without a measurement of this tick: no torque, and the last thrust.
    fn tick(&mut self, input: &InnerInput, telemetry: &mut Telemetry) -> WrenchSetpoint {
        if input.measured_age != 0 {
            return cascade::no_torque(self.thrust_n);
        }
        let state = &input.measured;
        let nu2 = Vector3::from(state.rate_b_rad_s);
        self.take(input.tick, &nu2);

        let desired = DesiredAttitude::of(&input.wanted);
        let q_d = desired.attitude;
        let q = Attitude::of_wxyz(state.attitude_quaternion);
        let q_e = q
            .inverse()
            .times(&weighted(&q, &q_d, self.yaw_weight))
            .short_way();
        // The weight is for large errors alone: undone in the gain, as PX4 does.
        let gain = self
            .attitude
            .component_div(&Vector3::new(1.0, 1.0, self.yaw_weight));
        let ahead = q.inverse().times(&q_d).to_world(&desired.nu2);
        let nu2_r = (2.0 * gain.component_mul(&q_e.vector()) + ahead)
            .sup(&-self.rate_max)
            .inf(&self.rate_max);
        let e = nu2_r - nu2;
        let damping = self.d.component_mul(self.acceleration.output());
        let tau = self
            .i_m
            .component_mul(&(self.p.component_mul(&e) + self.integral - damping));

        self.thrust_n = input.wanted.thrust_n;
        let saturated = self.saturates(self.thrust_n, &tau);
        self.integral = if input.given.other_law == 1 {
            self.following(&input.given.torque_b_nm.into(), &damping)
        } else {
            self.integrated(&e, &tau, saturated)
        };
        let i = &self.integral;
        let shown = [e.x, e.y, e.z, i.x, i.y, i.z, f64::from(u8::from(saturated))];
        telemetry.value[..shown.len()].copy_from_slice(&shown);
        WrenchSetpoint {
            thrust_n: self.thrust_n,
            torque_b_nm: tau.into(),
        }
    }
}
