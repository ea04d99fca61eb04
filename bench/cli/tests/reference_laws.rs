//! Flights by the paper's laws with gains, an airframe and a delay that a test chooses.

use control_api::description::Settings;
use control_api::law::Law as _;
use control_api::{GuardedInner, GuardedMixer, GuardedOuter, Rig};
use controller::laws::{Adaptive, Pd};
use controller::{Gains, ScaledTrajectory, Trajectory};
use messages::content::{Setpoint, Stamped, State, Wrench};
use messages::parameters::{Airframe, Parameter};
use mixer::RollPitchFirst;
use plant::{Plant, PlantSettings, Swap};

pub fn stages(
    rig: &Rig,
    trajectory: Trajectory,
    gains: &Gains,
) -> (GuardedOuter, GuardedInner, GuardedMixer) {
    let route = ScaledTrajectory::of(trajectory).route(rig.period_s);
    let outer = Pd::new(rig, &Settings::default()).unwrap();
    let mixer = RollPitchFirst::new(rig, &Settings::default()).unwrap();
    (
        GuardedOuter::new(outer.into(), route, rig),
        GuardedInner::new(Adaptive::with(rig, gains).into(), rig),
        GuardedMixer::new(mixer.into(), rig),
    )
}

/// A flight of the nominal airframe, as `ironbird simulate` flies it; a test changes the fields.
#[derive(Clone, Debug)]
pub struct Flight {
    pub rig: Rig,
    pub trajectory: Trajectory,
    pub gains: Gains,
    /// Parameters of the plant from the start on, which the laws do not know.
    pub start: Vec<(Parameter, f64)>,
    pub swaps: Vec<(u64, Parameter, f64)>,
    /// Ticks from a sample to the actuation of the command that was computed from it; the rig's chain has 1.
    pub delay_ticks: u64,
    pub seed: u64,
    pub last_tick: u64,
}

/// What is there at the end of a tick.
pub struct Tick {
    pub tick: u64,
    pub sampled: State,
    /// The state that the laws know.
    pub state: Stamped<State>,
    pub setpoint: Stamped<Setpoint>,
    pub wrench: Wrench,
    pub is_saturated: bool,
}

impl Flight {
    pub fn new(trajectory: Trajectory, preset: &str, seconds: u64) -> Self {
        Self {
            rig: Rig::default(),
            trajectory,
            gains: Gains::preset(preset).unwrap(),
            start: Vec::new(),
            swaps: Vec::new(),
            delay_ticks: 1,
            seed: 1,
            last_tick: 1000 * seconds,
        }
    }

    pub fn starts_with(mut self, parameter: Parameter, value: f64) -> Self {
        self.start.push((parameter, value));
        self
    }

    pub fn swaps(mut self, tick: u64, parameter: Parameter, value: f64) -> Self {
        self.swaps.push((tick, parameter, value));
        self
    }

    /// `deliver` may change the state that the laws see, or keep it back.
    pub fn fly(
        &self,
        mut deliver: impl FnMut(u64, State) -> Option<State>,
        mut watch: impl FnMut(&Tick),
    ) {
        let mut airframe = Airframe::nominal();
        for (parameter, value) in &self.start {
            airframe.set(*parameter, *value).unwrap();
        }
        let mut plant = Plant::new(&PlantSettings {
            period_s: self.rig.period_s,
            airframe,
            seed: self.seed,
            ..PlantSettings::default()
        });
        for (tick, parameter, value) in &self.swaps {
            let swap = Swap::new(*tick, &[(*parameter, *value)]).unwrap();
            plant.schedule(swap).unwrap();
        }
        let (mut outer, mut inner, mut mixer) = stages(&self.rig, self.trajectory, &self.gains);
        let mut state = Stamped::never();
        let mut setpoint = Stamped::never();
        for tick in 0..=self.last_tick {
            // A command without delay acts in the tick whose state it was computed from: a copy shows that state.
            let has_delay = self.delay_ticks > 0;
            let sampled = if has_delay {
                plant.begin(tick)
            } else {
                plant.clone().begin(tick)
            };
            if let Some(content) = deliver(tick, sampled) {
                state = Stamped::new(tick, content);
            }
            if let Some(content) = outer.tick(tick, &state) {
                setpoint = Stamped::new(tick, content);
            }
            let wrench = inner.tick(tick, &state, &setpoint);
            let command = mixer.tick(tick, &Stamped::new(tick, wrench));
            // The plant holds a command back until the tick after its own, so a command without delay is dated back;
            // that of tick 0 is lost.
            let dated = tick.wrapping_sub(u64::from(!has_delay));
            plant.offer(&Stamped::new(dated, command), tick + self.delay_ticks);
            if !has_delay {
                plant.begin(tick);
            }
            plant.finish();
            assert_eq!(plant.envelope(), Ok(()));
            watch(&Tick {
                tick,
                sampled,
                state,
                setpoint,
                wrench,
                is_saturated: command.saturated > 0,
            });
        }
    }
}
