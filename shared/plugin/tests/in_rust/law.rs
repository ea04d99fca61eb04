//! A law in Rust that uses only the crate `ironbird_law`.

use ironbird_law::{
    WrenchSetpoint, Description, Inner, InnerInput, InnerLaw, Law, Preset, Refused, Rig, Setting, SettingKind, Settings,
    Signal, Telemetry, Value,
};

const GAIN: Setting = Setting {
    name: "gain_nm",
    unit: "N m",
    meaning: "torque per rad",
    kind: SettingKind::Number { default: 0.5, min: 0.0, max: 9.0 },
};
const AXES: Setting = Setting {
    name: "axes",
    unit: "",
    meaning: "share of each axis",
    kind: SettingKind::Three { default: [1.0, 2.0, 3.0], min: 0.0, max: 9.0 },
};
const ENDS: Setting =
    Setting { name: "ends", unit: "", meaning: "how", kind: SettingKind::Word(&["never", "refused", "new", "tick"]) };

#[derive(Clone)]
struct Spring {
    gain: f64,
    axes: [f64; 3],
    ends: &'static str,
    ticks: u64,
}

impl Law for Spring {
    type Role = Inner;
    const DESCRIPTION: Description = Description {
        name: "spring",
        version: "3",
        summary: "turns back",
        source: "Hooke, 1678",
        settings: &[GAIN, AXES, ENDS],
        presets: &[Preset { name: "stiff", values: &[("gain_nm", Value::Number(8.0)), ("ends", Value::Word("tick"))] }],
        telemetry: &[Signal { name: "ticks", unit: "" }],
        not_real_time: true,
    };

    fn new(rig: &Rig, settings: &Settings) -> Result<Self, Refused> {
        let ends = settings.word(&ENDS);
        match ends {
            "refused" => Err(Refused(format!("ends = refused with a period of {} s; choose another", rig.period_s))),
            "new" => panic!("no spring at {} s", rig.period_s),
            _ => Ok(Self { gain: settings.number(&GAIN), axes: settings.three(&AXES), ends, ticks: 0 }),
        }
    }

    fn save(&self, bytes: &mut [u8]) -> usize {
        bytes[..8].copy_from_slice(&self.ticks.to_le_bytes());
        8
    }

    fn load(&mut self, bytes: &[u8]) -> bool {
        bytes.try_into().is_ok_and(|bytes| {
            self.ticks = u64::from_le_bytes(bytes);
            true
        })
    }
}

impl InnerLaw for Spring {
    fn tick(&mut self, input: &InnerInput, telemetry: &mut Telemetry) -> WrenchSetpoint {
        assert!(self.ends != "tick", "the spring broke in tick {}", input.tick);
        self.ticks += 1;
        telemetry.value[0] = self.ticks as f64;
        let attitude_rad = input.measured.attitude_rad;
        WrenchSetpoint {
            thrust_n: input.wanted.thrust_n,
            torque_b_nm: std::array::from_fn(|i| -self.gain * self.axes[i] * attitude_rad[i]),
        }
    }
}

ironbird_law::export!(Spring);
