//! A flight of any laws in one process: the plant, an outer and an inner law, the mixer.

use control_api::GuardedMixer;
use control_api::description::{Settings, Value};
use control_api::law::{InnerInput, InnerLaw, Law, OuterInput, OuterLaw, Rig, WrenchSetpoint};
use controller::Trajectory;
use messages::content::{Measured, Stamped, Wrench};
use messages::parameters::Parameter;
use messages::telemetry::Telemetry;
use mixer::RollPitchFirst;
use nalgebra::{Vector3, Vector4};
use plant::{Initial, Plant, PlantSettings, Swap};

pub type Inner = Box<dyn InnerLaw>;
pub type Outer = Box<dyn OuterLaw>;

/// What is flown, and what goes wrong in it.
#[derive(Clone, Debug)]
pub struct ScaledTrajectory {
    pub trajectory: Trajectory,
    pub initial: Initial,
    /// Parameters that differ from what the laws believe, each from a tick on.
    pub faults: Vec<(u64, Parameter, f64)>,
    pub delay_ticks: u64,
    /// Every so many ticks the laws are not asked, and the rotors get no command.
    pub skip_every: Option<u64>,
    pub seconds: f64,
}

#[derive(Clone, Debug, Default)]
pub struct Track {
    pub error_m: Vec<f64>,
    pub measured: Vec<Measured>,
    /// What the outer law shows of itself.
    pub telemetry: Vec<Telemetry>,
}

pub fn course(trajectory: Trajectory) -> ScaledTrajectory {
    ScaledTrajectory {
        trajectory,
        initial: Initial::default(),
        faults: vec![],
        delay_ticks: 1,
        skip_every: None,
        seconds: 20.0,
    }
}

impl ScaledTrajectory {
    pub fn with(mut self, at_s: f64, parameter: Parameter, value: f64) -> Self {
        self.faults.push(((at_s * 1e3) as u64, parameter, value));
        self
    }

    pub fn skipping(mut self, every: u64) -> Self {
        self.skip_every = Some(every);
        self
    }

    pub fn delayed(mut self, delay_ticks: u64) -> Self {
        self.delay_ticks = delay_ticks;
        self
    }
}

impl Track {
    /// Largest error from an instant on [m].
    pub fn worst(&self, from_s: f64) -> f64 {
        self.error_m[(from_s * 1e3) as usize..]
            .iter()
            .copied()
            .fold(0.0, f64::max)
    }

    /// Root mean square of the largest change of a rotor command per tick in the second half [rad/s].
    pub fn agitation(&self) -> f64 {
        let half = &self.measured[self.measured.len() / 2..];
        let changes = half.windows(2).map(|pair| {
            let [before, now] = [0, 1].map(|i| Vector4::from(pair[i].rotor_speed_command_rad_s));
            (now - before).amax().powi(2)
        });
        (changes.sum::<f64>() / half.len() as f64).sqrt()
    }
}

fn law<L: Law>(values: Vec<(&'static str, Value)>) -> L {
    L::new(&Rig::default(), &Settings::new(values)).expect("the settings go together")
}

pub fn inner<L: Law + InnerLaw>(values: Vec<(&'static str, Value)>) -> Inner {
    Box::new(law::<L>(values))
}

pub fn outer<L: Law + OuterLaw>(values: Vec<(&'static str, Value)>) -> Outer {
    Box::new(law::<L>(values))
}

/// Flies a course to its end, or until the vehicle is lost: then every error is infinite.
pub fn fly(course: &ScaledTrajectory, mut outer: Outer, mut inner: Inner) -> Track {
    let Rig {
        period_s,
        airframe,
        rotor,
    } = Rig::default();
    let mut plant = Plant::new(&PlantSettings {
        period_s,
        airframe,
        rotor,
        seed: 1,
        initial: course.initial,
        ..PlantSettings::default()
    });
    for &(tick, parameter, value) in &course.faults {
        let swap = Swap::new(tick, &[(parameter, value)]).unwrap();
        plant.schedule(swap).unwrap();
    }
    let mut mixer = GuardedMixer::new(law::<RollPitchFirst>(vec![]).into(), &Rig::default());
    let mut track = Track::default();
    let ticks = (course.seconds / period_s).round() as u64;
    for tick in 0..ticks {
        let measured = plant.begin(tick).measured;
        let reference = course.trajectory.reference(tick as f64 * period_s);
        let mut telemetry = Telemetry::default();
        if course
            .skip_every
            .is_none_or(|every| tick % every != every - 1)
        {
            let input = OuterInput {
                tick,
                measured,
                reference,
                ..OuterInput::default()
            };
            let wanted = outer.tick(&input, &mut telemetry);
            let input = InnerInput {
                tick,
                measured,
                wanted,
                reference,
                ..InnerInput::default()
            };
            let WrenchSetpoint {
                thrust_n,
                torque_b_nm,
            } = inner.tick(&input, &mut Telemetry::default());
            let wrench = Wrench {
                thrust_n,
                torque_b_nm,
                ..Wrench::default()
            };
            let command = mixer.tick(tick, &Stamped::new(tick, wrench));
            plant.offer(&Stamped::new(tick, command), tick + course.delay_ticks);
        }
        let error = Vector3::from(measured.position_w_m) - Vector3::from(reference.position_w_m);
        let lost = plant.envelope().is_err();
        track
            .error_m
            .push(if lost { f64::INFINITY } else { error.norm() });
        track.measured.push(measured);
        track.telemetry.push(telemetry);
        if lost {
            track.error_m = vec![f64::INFINITY; ticks as usize];
            return track;
        }
        plant.finish();
    }
    track
}
