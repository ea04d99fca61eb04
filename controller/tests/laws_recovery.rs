//! Lee's law from almost upside down: flights through attitudes that Euler angles do not pass.

use control_api::description::Settings;
use control_api::law::{Desired, InnerLaw as _, Law as _, Rig};
use controller::laws::Geometric;
use controller::laws::attitude::Attitude;
use messages::allocation::Allocation;
use messages::content::Measured;
use messages::content::Reference;
use messages::content::Stamped;
use messages::limits::RotorLimits;
use messages::parameters::Airframe;
use messages::rate_dynamics::Inertia;
use messages::telemetry::Telemetry;
use mixer::mix::{mix, speeds};
use nalgebra::{Vector3, Vector4};
use plant::rotors::effort;

/// A rigid body by (1) and (8), with its attitude as a quaternion.
#[derive(Clone, Copy, Debug)]
struct Body {
    p: Vector3<f64>,
    v: Vector3<f64>,
    q: Attitude,
    nu2: Vector3<f64>,
}

impl Body {
    /// Derivative under rotors that turn at `w` [rad/s].
    fn rate(&self, airframe: &Airframe, w: &Vector4<f64>) -> Self {
        let effort = effort(airframe, w);
        let inertia = Inertia::new(airframe.i_m().into());
        let theta = Vector3::new(airframe.i_r(), airframe.k_r(), 0.0);
        let spin = Attitude {
            w: 0.0,
            v: self.nu2,
        };
        let dq = self.q.times(&spin);
        let lift = self.q.turn(&Vector3::z()) * (effort.u / airframe.m());
        Self {
            p: self.v,
            v: lift - airframe.g() * Vector3::z() - self.v * (airframe.k_t() / airframe.m()),
            q: Attitude {
                w: 0.5 * dq.w,
                v: 0.5 * dq.v,
            },
            nu2: inertia.coupling(&self.nu2)
                + inertia.regressor(&self.nu2, effort.om, &Vector3::zeros()) * theta
                + inertia.acceleration(&effort.tau),
        }
    }

    fn along(&self, rate: &Self, dt_s: f64) -> Self {
        Self {
            p: self.p + dt_s * rate.p,
            v: self.v + dt_s * rate.v,
            q: Attitude {
                w: self.q.w + dt_s * rate.q.w,
                v: self.q.v + dt_s * rate.q.v,
            },
            nu2: self.nu2 + dt_s * rate.nu2,
        }
    }

    /// Four steps of Runge-Kutta over a tick, with the quaternion brought back to norm 1.
    fn after(mut self, airframe: &Airframe, w: &Vector4<f64>, period_s: f64) -> Self {
        let dt = period_s / 4.0;
        for _ in 0..4 {
            let k1 = self.rate(airframe, w);
            let k2 = self.along(&k1, dt / 2.0).rate(airframe, w);
            let k3 = self.along(&k2, dt / 2.0).rate(airframe, w);
            let k4 = self.along(&k3, dt).rate(airframe, w);
            for (k, weight) in [(k1, 1.0), (k2, 2.0), (k3, 2.0), (k4, 1.0)] {
                self = self.along(&k, weight * dt / 6.0);
            }
            let norm = (self.q.w * self.q.w + self.q.v.norm_squared()).sqrt();
            self.q = Attitude {
                w: self.q.w / norm,
                v: self.q.v / norm,
            };
        }
        self
    }

    /// Angle between body z and up [degrees].
    fn tilt_degrees(&self) -> f64 {
        self.q
            .turn(&Vector3::z())
            .z
            .clamp(-1.0, 1.0)
            .acos()
            .to_degrees()
    }
}

#[derive(Debug)]
struct Recovery {
    /// Instant from which on the tilt is below 10 degrees [s].
    upright_s: f64,
    /// Lowest height [m].
    lowest_m: f64,
    /// Distance from the start after ten seconds [m].
    left_m: f64,
}

/// Ten seconds from an attitude, told to hold the origin.
fn recovery(eta2_degrees: [f64; 3], nu2: [f64; 3]) -> Recovery {
    let rig = Rig {
        period_s: 1e-3,
        airframe: Airframe::nominal(),
        rotor: RotorLimits::default(),
    };
    let Rig {
        period_s,
        airframe,
        rotor,
    } = rig;
    let (allocation, k) = (Allocation::new(&airframe), airframe.k());
    let mut law = Geometric::new(&rig, &Settings::default()).expect("the defaults go together");
    let eta2 = Vector3::from(eta2_degrees.map(f64::to_radians));
    let zero = Vector3::zeros();
    let mut body = Body {
        p: zero,
        v: zero,
        q: Attitude::of(&eta2),
        nu2: nu2.into(),
    };
    let mut w = Vector4::repeat(airframe.hover_speed_rad_s());
    let mut recovery = Recovery {
        upright_s: 0.0,
        lowest_m: 0.0,
        left_m: 0.0,
    };
    for tick in 0..10_000 {
        let Attitude { w: q_w, v: q } = body.q;
        let measured = Measured {
            position_w_m: body.p.into(),
            velocity_w_m_s: body.v.into(),
            attitude_quaternion: [q_w, q.x, q.y, q.z],
            rate_b_rad_s: body.nu2.into(),
            ..Measured::default()
        };
        let (measured, wanted) = (
            Stamped {
                tick,
                content: measured,
            },
            Stamped {
                tick,
                content: Desired::default(),
            },
        );
        let demand = law.tick(
            tick,
            &measured,
            &wanted,
            &Reference::default(),
            &mut Telemetry::default(),
        );
        let mixed = mix(
            &allocation,
            demand.thrust_n,
            &demand.torque_b_nm.into(),
            rotor.f_min(k),
            rotor.f_max(k),
        );
        body = body.after(&airframe, &w, period_s);
        // One tick of delay: this command acts in the next tick.
        w = speeds(&mixed.f, k);
        recovery.lowest_m = recovery.lowest_m.min(body.p.z);
        if body.tilt_degrees() > 10.0 {
            recovery.upright_s = (tick + 1) as f64 * period_s;
        }
    }
    recovery.left_m = body.p.norm();
    recovery
}

#[test]
fn it_recovers_from_a_roll_of_170_degrees() {
    let recovery = recovery([170.0, 0.0, 0.0], [0.0; 3]);
    println!("{recovery:?}");
    assert!(recovery.left_m < 1e-3, "{recovery:?}");
    assert!(
        recovery.upright_s < 2.0 && recovery.lowest_m > -3.0,
        "{recovery:?}"
    );
}

#[test]
fn it_recovers_from_any_side_and_tumbling() {
    let starts = [
        ([0.0, 89.0, 0.0], [0.0; 3]),
        ([0.0, 170.0, 120.0], [0.0; 3]),
        ([179.0, 0.0, -30.0], [0.0; 3]),
        ([95.0, -80.0, 170.0], [3.0, -4.0, 2.0]),
        ([-170.0, 20.0, 60.0], [-8.0, 8.0, 3.0]),
    ];
    for (eta2_degrees, nu2) in starts {
        let recovery = recovery(eta2_degrees, nu2);
        println!("{eta2_degrees:?}, {nu2:?}: {recovery:?}");
        assert!(
            recovery.left_m < 1e-3,
            "{eta2_degrees:?}, {nu2:?}: {recovery:?}"
        );
    }
}
