//! Plants abreast: several flights at the same tick, integrated in the lanes of the processor's vectors.
//!
//! A lane computes what [`Plant::finish`] computes, with the same functions in the same order, and rounds the same: the
//! numbers of all bodies lie side by side, and the compiler turns the loop over them into vectors. What has a branch of
//! its own in every flight, the ground and a body at a rare attitude, is computed by itself.

use messages::vectors::vectorised;
use nalgebra::Vector3;

use super::Plant;
use crate::integrator::{SUBSTEPS, runge_kutta_4};
use crate::rigid_body::{Dynamics, Forcing, RigidBody};
use crate::rotors::Spin;

/// Plants that are integrated at once: as many numbers as the widest vectors have.
pub const LANES: usize = 8;

/// Instants of a tick at which the forcing is known: the ends and middles of all steps.
const INSTANTS: usize = 2 * SUBSTEPS as usize + 1;

/// N numbers of each lane, those of one kind side by side.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
struct Columns<const N: usize>([[f64; LANES]; N]);

impl<const N: usize> Columns<N> {
    const ZERO: Self = Self([[0.0; LANES]; N]);

    #[inline(always)]
    fn of(&self, lane: usize) -> [f64; N] {
        std::array::from_fn(|i| self.0[i][lane])
    }

    #[inline(always)]
    fn put(&mut self, lane: usize, numbers: [f64; N]) {
        for (column, number) in self.0.iter_mut().zip(numbers) {
            column[lane] = number;
        }
    }
}

/// Room to lay plants side by side.
#[derive(Clone, Debug)]
pub struct PlantBatch {
    body: Columns<13>,
    /// Roll, pitch, yaw, and 1 where they are not known.
    eta2: Columns<4>,
    dynamics: Columns<21>,
    /// Without the disturbance. Of rotors without a lag, that of the first instant is that of all.
    forcing: [Columns<5>; INSTANTS],
}

impl Default for PlantBatch {
    fn default() -> Self {
        Self {
            body: Columns::ZERO,
            eta2: Columns::ZERO,
            dynamics: Columns::ZERO,
            forcing: [Columns::ZERO; INSTANTS],
        }
    }
}

impl PlantBatch {
    /// Does for each plant what [`Plant::finish`] does.
    pub fn finish<'a>(&mut self, plants: impl IntoIterator<Item = &'a mut Plant>) {
        let mut group: heapless::Vec<&mut Plant, LANES> = heapless::Vec::new();
        for plant in plants {
            if !plant.has_begun {
                continue;
            }
            let fits = group
                .first()
                .is_none_or(|first| first.tick == plant.tick && first.steps == plant.steps);
            if plant.ground.is_some() || !fits {
                plant.finish();
                continue;
            }
            if group.is_full() {
                self.finish_group(&mut group);
                group.clear();
            }
            // There is room, as has just been seen to.
            let _ = group.push(plant);
        }
        self.finish_group(&mut group);
    }

    fn finish_group(&mut self, group: &mut [&mut Plant]) {
        // Vectors cost what they cost, however few lanes are used.
        let [first, _, _, ..] = group else {
            group.iter_mut().for_each(|plant| plant.finish());
            return;
        };
        let half_s = first.steps.half_s;
        let mut h = first.steps.disturbances(first.tick);
        let h: [Vector3<f64>; INSTANTS] = std::array::from_fn(|_| h.next_h());
        let spins: heapless::Vec<Spin, LANES> = group.iter().map(|plant| plant.spin()).collect();
        let lags = spins.iter().any(Spin::lags);
        for lane in 0..LANES {
            // Lanes without a flight compute that of the first once more.
            let at = if lane < group.len() { lane } else { 0 };
            let (plant, spin) = (&group[at], &spins[at]);
            self.body.put(lane, plant.body.numbers());
            self.dynamics.put(lane, plant.dynamics.numbers());
            self.eta2
                .put(lane, [plant.eta2.x, plant.eta2.y, plant.eta2.z, 0.0]);
            let instants = if lags { INSTANTS } else { 1 };
            for (half_steps, forcing) in self.forcing.iter_mut().take(instants).enumerate() {
                let effort = spin.effort(half_steps as f64 * half_s);
                forcing.put(lane, plant.dynamics.forcing(&effort).numbers());
            }
        }
        let (body, eta2) = (&mut self.body, &mut self.eta2);
        let forcing = &self.forcing[..if lags { INSTANTS } else { 1 }];
        integrate(body, &self.dynamics, forcing, &h, half_s);
        follow(body, eta2);
        for (lane, (plant, spin)) in group.iter_mut().zip(&spins).enumerate() {
            let body = RigidBody::of_numbers(body.of(lane));
            let [roll, pitch, yaw, unknown] = eta2.of(lane);
            let eta2 = if unknown == 0.0 {
                Vector3::new(roll, pitch, yaw)
            } else {
                body.attitude.euler_near(&plant.eta2)
            };
            plant.arrive(spin, body, eta2);
        }
    }
}

vectorised! {
    /// Carries all bodies to the next tick, as [`crate::integrator::integrate`] does one.
    fn integrate(
        body: &mut Columns<13>,
        dynamics: &Columns<21>,
        forcing: &[Columns<5>],
        h: &[Vector3<f64>; INSTANTS],
        half_s: f64,
    ) {
        let forcing_at = |instant: usize| if forcing.len() == INSTANTS { &forcing[instant] } else { &forcing[0] };
        for step in 0..SUBSTEPS as usize {
            let instants = [2 * step, 2 * step + 1, 2 * step + 2];
            let (forcings, h) = (instants.map(forcing_at), instants.map(|instant| h[instant]));
            for lane in 0..LANES {
                let dynamics = Dynamics::of_numbers(dynamics.of(lane));
                let [start, middle, end]: [Forcing; 3] = std::array::from_fn(|i| {
                    dynamics.disturbed(&Forcing::of_numbers(forcings[i].of(lane)), &h[i])
                });
                let start_of_step = RigidBody::of_numbers(body.of(lane));
                let moved = runge_kutta_4(&start_of_step, &dynamics, [&start, &middle, &end], half_s);
                body.put(lane, moved.numbers());
            }
        }
        for lane in 0..LANES {
            let moved = RigidBody::of_numbers(body.of(lane));
            body.put(lane, RigidBody { attitude: moved.attitude.normalised(), ..moved }.numbers());
        }
    }
}

vectorised! {
    /// Follows the attitudes of all bodies from where they were.
    fn follow(body: &Columns<13>, eta2: &mut Columns<4>) {
        for lane in 0..LANES {
            let [roll, pitch, yaw, _] = eta2.of(lane);
            let attitude = RigidBody::of_numbers(body.of(lane)).attitude;
            let (now, is_known) = attitude.euler_near_of_most(&Vector3::new(roll, pitch, yaw));
            eta2.put(lane, [now.x, now.y, now.z, if is_known { 0.0 } else { 1.0 }]);
        }
    }
}
