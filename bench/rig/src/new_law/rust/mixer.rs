//! my_law: thrust and torque to rotor speeds, each rotor cut to what it can. Change `tick`.

use ironbird_law::{
    Description, Law, Mixer, MixerInput, MixerLaw, Refused, Rig, RotorSpeeds, Settings, Signal, Telemetry,
};

/// Rotors 1 rear left, 2 rear right, 3 front right, 4 front left: the signs of roll, pitch and yaw torque.
const SIGN: [[f64; 3]; 4] = [[1.0, 1.0, 1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0], [1.0, -1.0, -1.0]];

/// What the law remembers from tick to tick belongs in here.
#[derive(Clone)]
struct MyLaw {
    rig: Rig,
}

impl Law for MyLaw {
    type Role = Mixer;
    const DESCRIPTION: Description = Description {
        name: "my_law",
        version: "1",
        summary: "inverse allocation, each rotor cut to its range",
        telemetry: &[Signal { name: "cut_rad_s", unit: "rad/s" }],
        ..Description::EMPTY
    };

    fn new(rig: &Rig, _: &Settings) -> Result<Self, Refused> {
        Ok(Self { rig: *rig })
    }
}

impl MixerLaw for MyLaw {
    fn tick(&mut self, input: &MixerInput, telemetry: &mut Telemetry) -> RotorSpeeds {
        let airframe = &self.rig.airframe;
        let arm = airframe.arm_length_m * 0.5_f64.sqrt();
        let lever = [arm, arm, airframe.drag_factor_nm_s2 / airframe.thrust_coefficient_n_s2];
        let mut speeds = RotorSpeeds { speed_rad_s: [0.0; 4], saturated: 0 };
        for (possible, sign) in speeds.speed_rad_s.iter_mut().zip(SIGN) {
            let torque: f64 = (0..3).map(|i| sign[i] * input.demand.torque_b_nm[i] / (4.0 * lever[i])).sum();
            let thrust = input.demand.thrust_n / 4.0 + torque;
            let speed = (thrust.max(0.0) / airframe.thrust_coefficient_n_s2).sqrt();
            *possible = speed.max(self.rig.rotor_min_rad_s).min(self.rig.rotor_max_rad_s);
            speeds.saturated |= u64::from(*possible != speed);
            telemetry.value[0] = telemetry.value[0].max((*possible - speed).abs());
        }
        speeds
    }
}

ironbird_law::export!(MyLaw);
