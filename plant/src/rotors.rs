//! Rotors: commanded to actual speed, thrust (6), torque (7), net speed (4).
//!
//! Source: "An Adaptive Scheme to Estimate Unknown Parameters of an Unmanned Aerial Vehicle" (Imran, Montazeri). This
//! file owns the rotors' motion between two ticks and the telemetry of it, which the adaptation relies on.
//!
//! Differences from the paper (docs/paper.md lists them all):
//! * The k of (6) is missing from Table I. The parameter table has the k of Bouabdallah's OS4.
//! * Row 4 of (7) uses kappa = d/k. With the printed d, this length would be 7.5e-7 and there would be no yaw
//!   authority.
//! * Three additions to the paper: an efficiency per rotor, which scales its thrust and thus its drag torque, a
//!   first-order lag of the speeds, and with a lag the reaction torque -I_R d(Om) of rotors that change their speed.
//!   Nominally all are off. A positive I_R is the paper's convention and not physical (docs/conventions.md): its
//!   reaction would turn the body the wrong way, so there is none.

use messages::allocation::{Allocation, net_speed};
use messages::math::{exp, exp_m1};
use messages::parameters::Airframe;
use nalgebra::{Vector3, Vector4};

use crate::rigid_body::Effort;

/// How the rotors turn from one grid tick to the next, under a command that is held.
///
/// With a time constant the speeds are the exact w(t) = w_c + (w_0 - w_c) exp(-t/tau), without one they are w_c from
/// the first instant on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spin {
    rotors: Rotors,
    /// Commanded speeds w_c [rad/s].
    command: Vector4<f64>,
    /// Speeds at the tick, w_0 [rad/s].
    start: Vector4<f64>,
}

/// Means over a tick, per rotor: what a speed controller would report.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpinMeans {
    /// Mean speed [rad/s].
    pub speed: Vector4<f64>,
    /// Mean squared speed [rad^2/s^2].
    pub speed_squared: Vector4<f64>,
    /// Mean change of the speed [rad/s^2]; 0 for rotors without a lag.
    pub acceleration: Vector4<f64>,
}

impl SpinMeans {
    /// The means of rotors that turn at a constant speed [rad/s].
    pub fn steady(speed: &Vector4<f64>) -> Self {
        Self {
            speed: *speed,
            speed_squared: speed.component_mul(speed),
            acceleration: Vector4::zeros(),
        }
    }
}

impl Spin {
    /// The motion from `start` [rad/s] under `command` [rad/s], with the motors of the airframe.
    pub fn new(airframe: &Airframe, start: Vector4<f64>, command: Vector4<f64>) -> Self {
        Rotors::new(airframe).spin(start, command)
    }

    /// Whether the speeds follow the command with a lag.
    pub fn lags(&self) -> bool {
        self.rotors.time_constant_s != 0.0
    }

    /// Speeds w [rad/s] at `offset_s` [s] after the tick.
    pub fn speed(&self, offset_s: f64) -> Vector4<f64> {
        if !self.lags() {
            return self.command;
        }
        self.command + (self.start - self.command) * exp(-offset_s / self.rotors.time_constant_s)
    }

    /// What the rotors do at `offset_s` [s] after the tick.
    pub fn effort(&self, offset_s: f64) -> Effort {
        let (w, rotors) = (self.speed(offset_s), &self.rotors);
        let mut effort = rotors.effort(&w);
        if self.lags() {
            let d_w = (self.command - w) / rotors.time_constant_s;
            rotors.react(&d_w, &mut effort.tau);
        }
        effort
    }

    /// Exact means of w and w^2 over the first `period_s` [s] after the tick: the integrals of the exponential.
    pub fn means(&self, period_s: f64) -> SpinMeans {
        let (w_c, start, tau) = (self.command, self.start, self.rotors.time_constant_s);
        if tau == 0.0 {
            return SpinMeans::steady(&w_c);
        }
        let gap = start - w_c;
        let ratio = tau / period_s;
        // exp_m1 keeps its digits where the motors are slow, and the means close to the start.
        let decay = -exp_m1(-1.0 / ratio) * ratio;
        let decay_squared = -exp_m1(-2.0 / ratio) * ratio / 2.0;
        SpinMeans {
            speed: w_c + gap * decay,
            speed_squared: w_c.component_mul(&w_c)
                + w_c.component_mul(&gap) * (2.0 * decay)
                + gap.component_mul(&gap) * decay_squared,
            acceleration: gap * (-decay / tau),
        }
    }
}

/// (4), (6), (7) with the parameters of one airframe, its true efficiencies among them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rotors {
    k: f64,
    efficiency: Vector4<f64>,
    allocation: Allocation,
    /// Time constant of the motors [s]; 0 is none.
    time_constant_s: f64,
    /// I_R [kg m^2].
    i_r: f64,
}

impl Rotors {
    pub(crate) fn new(airframe: &Airframe) -> Self {
        Self {
            k: airframe.k(),
            efficiency: airframe.rotor_efficiency().into(),
            allocation: Allocation::new(airframe),
            time_constant_s: airframe.motor_time_constant_s(),
            i_r: airframe.i_r(),
        }
    }

    /// As [`Spin::new`].
    #[inline]
    pub(crate) const fn spin(&self, start: Vector4<f64>, command: Vector4<f64>) -> Spin {
        Spin {
            rotors: *self,
            command,
            start,
        }
    }

    /// (6): total thrust of rotors that turn at `w` [rad/s] [N].
    #[inline]
    pub(crate) fn thrust(&self, w: &Vector4<f64>) -> f64 {
        self.forces(w).sum()
    }

    /// (6) for each rotor that turns at `w` [rad/s]: thrust [N].
    #[inline]
    fn forces(&self, w: &Vector4<f64>) -> Vector4<f64> {
        w.component_mul(w).component_mul(&self.efficiency) * self.k
    }

    /// Adds the reaction torque -I_R d(Om) of rotors whose speed changes by `d_w` [rad/s^2], where I_R is physical.
    #[inline]
    fn react(&self, d_w: &Vector4<f64>, tau: &mut Vector3<f64>) {
        if self.i_r < 0.0 {
            tau.z -= self.i_r * net_speed(d_w);
        }
    }

    /// (7) with the reaction torque, averaged over a tick [N m].
    pub(crate) fn mean_torque(&self, means: &SpinMeans) -> Vector3<f64> {
        let forces = means.speed_squared.component_mul(&self.efficiency) * self.k;
        let (_, mut tau) = self.allocation.wrench(&forces);
        self.react(&means.acceleration, &mut tau);
        tau
    }

    #[inline]
    fn effort(&self, w: &Vector4<f64>) -> Effort {
        let (u, tau) = self.allocation.wrench(&self.forces(w));
        Effort {
            u,
            tau,
            om: net_speed(w),
        }
    }
}

/// (4), (6), (7): thrust, torque and net speed of rotors that turn at `w` [rad/s], with the true efficiencies.
pub fn effort(airframe: &Airframe, w: &Vector4<f64>) -> Effort {
    Rotors::new(airframe).effort(w)
}

/// Speeds of all four rotors in hover [rad/s].
pub fn hover(airframe: &Airframe) -> Vector4<f64> {
    Vector4::repeat(airframe.hover_speed_rad_s())
}
