//! Plants abreast fly as each of them does by itself, bit for bit.

use messages::content::{RotorSpeeds, Stamped, State};
use messages::layout::Visit as _;
use messages::parameters::Parameter;
use plant::{Ground, Initial, LANES, Plant, PlantBatch, PlantSettings, Swap, Target};
use proptest::prelude::*;

use crate::{airframe, command_of};

const TICKS: u64 = 40;

/// A random plant, and the rotor speeds commanded in each tick [rad/s].
#[derive(Clone, Debug)]
struct Drawn {
    mass_kg: f64,
    inertia_x_kg_m2: f64,
    lag_s: f64,
    i_r_kg_m2: f64,
    w20_m_s: f64,
    attitude_rad: [f64; 3],
    rate_b_rad_s: [f64; 3],
    /// 1 of 4 has a ground, at 0.
    has_ground: bool,
    height_m: f64,
    speed_rad_s: [f64; 4],
    swap_tick: u64,
}

fn angle() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => -3.2..3.2_f64,
        1 => Just(std::f64::consts::FRAC_PI_2),
        1 => Just(std::f64::consts::PI),
        2 => Just(0.0),
    ]
}

prop_compose! {
    fn drawn()(
        mass_kg in 0.3..0.7_f64,
        inertia_x_kg_m2 in 0.004..0.01_f64,
        lag_s in prop_oneof![Just(0.0), 0.001..0.1_f64],
        i_r_kg_m2 in -1e-4..1e-4_f64,
        w20_m_s in prop_oneof![Just(0.0), 0.1..20.0_f64],
        attitude_rad in prop::array::uniform3(angle()),
        rate_b_rad_s in [-20.0..20.0_f64, -20.0..20.0, -9.0..9.0],
        has_ground in prop::bool::weighted(0.25),
        height_m in -0.2..2.0_f64,
        speed_rad_s in prop::array::uniform4(0.0..400.0_f64),
        swap_tick in 0..TICKS,
    ) -> Drawn {
        Drawn {
            mass_kg,
            inertia_x_kg_m2,
            lag_s,
            i_r_kg_m2,
            w20_m_s,
            attitude_rad,
            rate_b_rad_s,
            has_ground,
            height_m,
            speed_rad_s,
            swap_tick,
        }
    }
}

impl Drawn {
    fn plant(&self) -> Plant {
        let airframe = airframe(&[
            (Parameter::Mass, self.mass_kg),
            (Parameter::InertiaX, self.inertia_x_kg_m2),
            (Parameter::MotorTimeConstant, self.lag_s),
            (Parameter::RotorInertia, self.i_r_kg_m2),
            (Parameter::Turbulence, self.w20_m_s),
            (Parameter::WindY, 2.0),
        ]);
        let ground = Ground {
            z_m: 0.0,
            leg_m: 0.05,
            friction: 0.6,
            crash_speed_m_s: 2.0,
            crash_tilt_rad: 0.8,
        };
        let mut plant = Plant::new(&PlantSettings {
            airframe,
            initial: Initial {
                position_w_m: [0.0, 0.0, self.height_m],
                velocity_w_m_s: [0.3, -0.1, -0.5],
                attitude_rad: self.attitude_rad,
                rate_b_rad_s: self.rate_b_rad_s,
            },
            ground: self.has_ground.then_some(ground),
            ..PlantSettings::default()
        });
        let target = Target {
            parameter: Parameter::RotorEfficiency2,
            value: 0.4,
            steps: 5,
        };
        let swap = Swap::to(self.swap_tick, &[target]).unwrap();
        plant.schedule(swap).unwrap();
        plant
    }

    fn command(&self, tick: u64) -> Stamped<RotorSpeeds> {
        command_of(tick, self.speed_rad_s.map(|w| w + (tick % 7) as f64))
    }
}

/// States of all plants in all ticks, flown one by one or abreast; the first ends some ticks earlier.
fn flown(drawn: &[Drawn], abreast: Option<&mut PlantBatch>) -> Vec<State> {
    let mut plants: Vec<Plant> = drawn.iter().map(Drawn::plant).collect();
    let mut states = Vec::new();
    let mut abreast = abreast;
    for tick in 0..TICKS {
        let from = usize::from(tick > TICKS - 5);
        for (plant, drawn) in plants.iter_mut().zip(drawn).skip(from) {
            states.push(plant.begin(tick));
            plant.offer(&drawn.command(tick), tick + 1);
        }
        match &mut abreast {
            Some(abreast) => abreast.finish(plants.iter_mut().skip(from)),
            None => plants.iter_mut().skip(from).for_each(Plant::finish),
        }
    }
    states
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn plants_abreast_fly_as_by_themselves(drawn in prop::collection::vec(drawn(), 1..2 * LANES + 2)) {
        let (alone, abreast) = (flown(&drawn, None), flown(&drawn, Some(&mut PlantBatch::default())));
        for (i, (alone, abreast)) in alone.iter().zip(&abreast).enumerate() {
            prop_assert!(alone.is_same(abreast), "{i}: {alone:?}\n{abreast:?}");
        }
    }
}
