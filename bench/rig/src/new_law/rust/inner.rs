//! my_law: a cascade from attitude to body rates to torque. Change `tick`.

use ironbird_law::{
    Demand, Description, Inner, InnerInput, InnerLaw, Law, Refused, Rig, Setting, SettingKind, Settings, Signal,
    Telemetry,
};

const ATTITUDE: Setting = Setting {
    name: "attitude_1_s",
    unit: "1/s",
    meaning: "rate per error of attitude",
    kind: SettingKind::Number { default: 12.0, min: 0.1, max: 100.0 },
};

const RATE: Setting = Setting {
    name: "rate_1_s",
    unit: "1/s",
    meaning: "acceleration per error of rate",
    kind: SettingKind::Number { default: 60.0, min: 0.1, max: 500.0 },
};

/// What the law remembers from tick to tick belongs in here.
#[derive(Clone)]
struct MyLaw {
    rig: Rig,
    attitude_1_s: f64,
    rate_1_s: f64,
}

impl Law for MyLaw {
    type Role = Inner;
    const DESCRIPTION: Description = Description {
        name: "my_law",
        version: "1",
        summary: "attitude to rates to torque, with proportional gains",
        settings: &[ATTITUDE, RATE],
        telemetry: &[
            Signal { name: "roll_error_rad", unit: "rad" },
            Signal { name: "pitch_error_rad", unit: "rad" },
            Signal { name: "yaw_error_rad", unit: "rad" },
        ],
        ..Description::EMPTY
    };

    fn new(rig: &Rig, settings: &Settings) -> Result<Self, Refused> {
        let (attitude_1_s, rate_1_s) = (settings.number(&ATTITUDE), settings.number(&RATE));
        if 2.0 * attitude_1_s > rate_1_s {
            return Err(Refused(format!(
                "attitude_1_s = {attitude_1_s} is too quick for rate_1_s = {rate_1_s}: allowed is up to half of it"
            )));
        }
        Ok(Self { rig: *rig, attitude_1_s, rate_1_s })
    }
}

impl InnerLaw for MyLaw {
    fn tick(&mut self, input: &InnerInput, telemetry: &mut Telemetry) -> Demand {
        let InnerInput { measured, wanted, .. } = input;
        let inertia = self.rig.airframe.inertia_kg_m2;
        let rate = measured.rate_b_rad_s;

        // Rates of roll, pitch, yaw that reduce the attitude's error, and the body rates p, q, r that they are.
        let error: [f64; 3] = std::array::from_fn(|i| wanted.attitude_rad[i] - measured.attitude_rad[i]);
        let [roll, pitch, yaw]: [f64; 3] =
            std::array::from_fn(|i| wanted.attitude_rate_rad_s[i] + self.attitude_1_s * error[i]);
        let (sin_roll, cos_roll) = measured.attitude_rad[0].sin_cos();
        let (sin_pitch, cos_pitch) = measured.attitude_rad[1].sin_cos();
        let rate_wanted = [
            roll - sin_pitch * yaw,
            cos_roll * pitch + sin_roll * cos_pitch * yaw,
            -sin_roll * pitch + cos_roll * cos_pitch * yaw,
        ];
        telemetry.value[..3].copy_from_slice(&error);

        // Euler's equation of the rigid body gives the torque.
        let torque_b_nm = std::array::from_fn(|x| {
            let (y, z) = ((x + 1) % 3, (x + 2) % 3);
            let acceleration = self.rate_1_s * (rate_wanted[x] - rate[x]) + wanted.attitude_acceleration_rad_s2[x];
            inertia[x] * acceleration + (inertia[z] - inertia[y]) * rate[y] * rate[z]
        });
        Demand { thrust_n: wanted.thrust_n, torque_b_nm }
    }
}

ironbird_law::export!(MyLaw);
