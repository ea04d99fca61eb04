//! Inner law `indi`: incremental inversion of the angular acceleration.
//!
//! Source: Ewoud J. J. Smeur, Qiping Chu, Guido C. H. E. de Croon, "Adaptive Incremental Nonlinear Dynamic Inversion
//! for Attitude Control of Micro Air Vehicles", Journal of Guidance, Control, and Dynamics 39 (3), 2016. What the
//! airframe does beyond its inertia is not modelled but measured: torque is added to that which the rotors gave when
//! the gyro showed an acceleration, in proportion to what is missing.
//!
//! ```text
//!     H(s) = w_n^2/(s^2 + 2 zeta w_n s + w_n^2)
//!     dnu2_f = H (nu2 - nu2_-)/T,   tau_f = H tau_m,   tau_m of (7) at f_i = k mean(w_i^2)
//!     nu2_r = K_eta 2 vec(q^-1 q_d) + nu2_d
//!     nu = K_nu2 (nu2_r - nu2) + dnu2_d
//!     tau = tau_f + I_M (nu - dnu2_f)
//! ```
//!
//! Both filters are the same and both samples cover the same tick, so that the airframe's own answer to the torque
//! cancels, whatever the lag of the rotors or the delay of the chain.
//!
//! Differences from the paper:
//! * The control effectiveness is the airframe's I_M and A of (7); it is not estimated.
//! * The propellers' own inertia (the paper's G_2) has no part in the airframe's model, and none here.
//! * tau_m comes from measured speeds instead of a model of the actuators.
//! * Rates and accelerations along the reference (nu2_d, dnu2_d) are fed forward; the paper has none.

use control_api::description::{
    Description, Preset, Refused, Settings, Signal, Value, number, settings, three, xyz,
};
use control_api::law::{Fields, InnerInput, InnerLaw, Law, Rig, WrenchSetpoint};
use messages::allocation::Allocation;
use messages::attitude::Attitude;
use messages::content::ROTORS;
use messages::role::Role;
use messages::telemetry::Telemetry;
use nalgebra::{Vector3, Vector4};

use crate::laws::cascade::{self, DesiredAttitude, LastRates, RateStep};
use crate::laws::low_pass::LowPass;

settings! {
    ATTITUDE = "attitude_1_s", "1/s", three([8.0, 8.0, 3.0], 0.1, 200.0), "K_eta of the attitude error: roll, pitch, yaw";
    RATE = "rate_1_s", "1/s", three([40.0, 40.0, 20.0], 0.1, 1000.0), "K_nu2 of the rate error: roll, pitch, yaw";
    FILTER = "filter_rad_s", "rad/s", number(50.0, 1.0, 5000.0), "w_n of the filter of acceleration and torque";
    DAMPING = "filter_damping", "", number(0.55, 0.3, 2.0), "zeta of that filter";
}

const SIGNALS: [[Signal; 3]; 3] = [
    xyz!("acceleration", "rad_s2", "rad/s^2"),
    xyz!("torque", "nm", "N m"),
    xyz!("disturbance", "rad_s2", "rad/s^2"),
];

#[derive(Clone, Debug)]
pub struct Indi {
    period_s: f64,
    allocation: Allocation,
    /// Thrust coefficient [N s^2].
    k: f64,
    i_m: Vector3<f64>,
    k_eta: Vector3<f64>,
    k_nu2: Vector3<f64>,
    /// tau_f [N m] and dnu2_f [rad/s^2] are what came out of these last.
    torque: LowPass,
    acceleration: LowPass,
    last: LastRates,
    thrust_n: f64,
}

impl Law for Indi {
    const DESCRIPTION: Description = Description {
        name: "indi",
        role: Role::Inner,
        version: "1",
        summary: "incremental nonlinear dynamic inversion: rejects what no model names, from gyro and rotor speeds",
        source: "Smeur, Chu, de Croon, Adaptive Incremental Nonlinear Dynamic Inversion for Attitude Control of \
                 Micro Air Vehicles, JGCD 39(3), 2016, without the adaptation",
        settings: &[ATTITUDE, RATE, FILTER, DAMPING],
        presets: &[Preset {
            name: "soft",
            values: &[
                ("attitude_1_s", Value::Three([6.0, 6.0, 2.0])),
                ("rate_1_s", Value::Three([24.0, 24.0, 10.0])),
                ("filter_rad_s", Value::Number(30.0)),
            ],
        }],
        suited: None,
        telemetry: SIGNALS.as_flattened(),
    };

    fn new(rig: &Rig, settings: &Settings) -> Result<Self, Refused> {
        let (attitude, rate) = (settings.three(&ATTITUDE), settings.three(&RATE));
        cascade::check((&ATTITUDE, &attitude), (&RATE, &rate), rig.period_s)?;
        let (w_n, zeta) = (settings.number(&FILTER), settings.number(&DAMPING));
        let filter = LowPass::new(&FILTER, w_n, zeta, rig.period_s)?;
        Ok(Self {
            period_s: rig.period_s,
            allocation: Allocation::new(&rig.airframe),
            k: rig.airframe.k(),
            i_m: rig.airframe.i_m().into(),
            k_eta: attitude.into(),
            k_nu2: rate.into(),
            torque: filter,
            acceleration: filter,
            last: LastRates::default(),
            thrust_n: rig.airframe.m() * rig.airframe.g(),
        })
    }

    fn state(&mut self, fields: &mut Fields) {
        fields.all([&mut self.torque, &mut self.acceleration]);
        fields.all([&mut self.last, &mut self.thrust_n]);
    }
}

impl Indi {
    /// Takes the measurement of `tick`: both filters move on where the tick before it was measured too.
    fn take(&mut self, tick: u64, nu2: &Vector3<f64>, speed_squared: &[f64; ROTORS]) {
        match self.last.take(tick, nu2, self.period_s) {
            RateStep::Whole(acceleration) => {
                let f = Vector4::from(*speed_squared) * self.k;
                self.torque.take(&self.allocation.wrench(&f).1);
                self.acceleration.take(&acceleration);
            }
            RateStep::Forget => {
                self.torque.forget();
                self.acceleration.forget();
            }
            RateStep::Nothing => {}
        }
    }
}

impl InnerLaw for Indi {
    /// Without a measurement of this tick: no torque, and the last thrust.
    fn tick(&mut self, input: &InnerInput, telemetry: &mut Telemetry) -> WrenchSetpoint {
        if input.measured_age != 0 {
            return cascade::no_torque(self.thrust_n);
        }
        let state = &input.measured;
        let nu2 = Vector3::from(state.rate_b_rad_s);
        self.take(input.tick, &nu2, &state.rotor_speed_squared_mean_rad2_s2);

        let desired = DesiredAttitude::of(&input.wanted);
        let q_e = Attitude::of_wxyz(state.attitude_quaternion)
            .inverse()
            .times(&desired.attitude)
            .short_way();
        let nu2_r = 2.0 * self.k_eta.component_mul(&q_e.vector()) + q_e.to_world(&desired.nu2);
        let nu = self.k_nu2.component_mul(&(nu2_r - nu2)) + q_e.to_world(&desired.dnu2);
        let (tau_f, dnu2_f) = (self.torque.output(), self.acceleration.output());
        let tau = tau_f + self.i_m.component_mul(&(nu - dnu2_f));

        self.thrust_n = input.wanted.thrust_n;
        let disturbance = dnu2_f - tau_f.component_div(&self.i_m);
        for (shown, vector) in
            telemetry
                .value
                .chunks_exact_mut(3)
                .zip([dnu2_f, tau_f, &disturbance])
        {
            shown.copy_from_slice(vector.as_slice());
        }
        WrenchSetpoint {
            thrust_n: self.thrust_n,
            torque_b_nm: tau.into(),
        }
    }
}
