//! my_law: from errors of position and velocity to thrust and attitude. Change `tick`.

use ironbird_law::{
    Description, Law, Outer, OuterInput, OuterLaw, Refused, Rig, Setting, SettingKind, Settings, Signal, Telemetry,
    Wanted,
};

const POSITION: Setting = Setting {
    name: "position_1_s2",
    unit: "1/s^2",
    meaning: "acceleration per error of position",
    kind: SettingKind::Number { default: 6.0, min: 0.1, max: 100.0 },
};

const VELOCITY: Setting = Setting {
    name: "velocity_1_s",
    unit: "1/s",
    meaning: "acceleration per error of velocity",
    kind: SettingKind::Number { default: 4.0, min: 0.1, max: 100.0 },
};

/// What the law remembers from tick to tick belongs in here.
#[derive(Clone)]
struct MyLaw {
    rig: Rig,
    position_1_s2: f64,
    velocity_1_s: f64,
}

impl Law for MyLaw {
    type Role = Outer;
    const DESCRIPTION: Description = Description {
        name: "my_law",
        version: "1",
        summary: "thrust along the acceleration that the errors ask for",
        settings: &[POSITION, VELOCITY],
        telemetry: &[
            Signal { name: "x_error_m", unit: "m" },
            Signal { name: "y_error_m", unit: "m" },
            Signal { name: "z_error_m", unit: "m" },
        ],
        ..Description::EMPTY
    };

    fn new(rig: &Rig, settings: &Settings) -> Result<Self, Refused> {
        let (position_1_s2, velocity_1_s) = (settings.number(&POSITION), settings.number(&VELOCITY));
        if velocity_1_s * velocity_1_s < position_1_s2 {
            return Err(Refused(format!(
                "velocity_1_s = {velocity_1_s} damps position_1_s2 = {position_1_s2} too little: allowed is its root \
                 or more"
            )));
        }
        Ok(Self { rig: *rig, position_1_s2, velocity_1_s })
    }
}

impl OuterLaw for MyLaw {
    fn tick(&mut self, input: &OuterInput, telemetry: &mut Telemetry) -> Wanted {
        let OuterInput { measured, reference, .. } = input;
        let airframe = &self.rig.airframe;

        // Acceleration by thrust: what the reference asks, the errors, gravity and drag.
        let error: [f64; 3] = std::array::from_fn(|i| reference.position_w_m[i] - measured.position_w_m[i]);
        telemetry.value[..3].copy_from_slice(&error);
        let mut a: [f64; 3] = std::array::from_fn(|i| {
            let slower = reference.velocity_w_m_s[i] - measured.velocity_w_m_s[i];
            let drag = airframe.translational_drag_kg_s / airframe.mass_kg * measured.velocity_w_m_s[i];
            reference.acceleration_w_m_s2[i] + self.position_1_s2 * error[i] + self.velocity_1_s * slower + drag
        });
        a[2] += airframe.gravity_m_s2;

        // Body z along it, at the yaw of the reference.
        let (sin, cos) = reference.yaw_rad.sin_cos();
        let (ahead, left) = (cos * a[0] + sin * a[1], cos * a[1] - sin * a[0]);
        let most = 4.0 * airframe.thrust_coefficient_n_s2 * self.rig.rotor_max_rad_s * self.rig.rotor_max_rad_s;
        let thrust = airframe.mass_kg * (a[0] * a[0] + a[1] * a[1] + a[2] * a[2]).sqrt();
        Wanted {
            thrust_n: thrust.min(most),
            attitude_rad: [(-left).atan2(ahead.hypot(a[2])), ahead.atan2(a[2]), reference.yaw_rad],
            attitude_rate_rad_s: [0.0, 0.0, reference.yaw_rate_rad_s],
            attitude_acceleration_rad_s2: [0.0, 0.0, reference.yaw_acceleration_rad_s2],
            limited: u64::from(thrust > most),
        }
    }
}

ironbird_law::export!(MyLaw);
