//! A batch of plants: several flights at the same tick, integrated in the lanes of the processor's vectors.
//!
//! A lane computes what [`Plant::finish`] computes, with the same functions in the same order, and rounds the same: the
//! numbers of all bodies lie side by side, and the compiler turns the loop over them into vectors.

use messages::vectors::{Columns, LANES, vectorised};
use nalgebra::Vector3;

use super::Plant;
use crate::integrator::{SUBSTEPS, runge_kutta_4};
use crate::rigid_body::{Dynamics, Forcing, RigidBody};

/// Instants of a tick at which the forcing is known: the ends and middles of all steps.
const INSTANTS: usize = 2 * SUBSTEPS as usize + 1;

/// Does for each plant what [`Plant::finish`] does.
pub fn finish<'a>(plants: impl IntoIterator<Item = &'a mut Plant>) {
    let mut group: heapless::Vec<&mut Plant, LANES> = heapless::Vec::new();
    for plant in plants {
        let is_alike = |first: &&mut Plant| first.tick == plant.tick && first.steps == plant.steps;
        if !plant.has_begun || plant.ground.is_some() || !group.first().is_none_or(is_alike) {
            plant.finish();
            continue;
        }
        let _ = group.push(plant);
        if group.is_full() {
            finish_group(&mut group);
            group.clear();
        }
    }
    finish_group(&mut group);
}

fn finish_group(group: &mut [&mut Plant]) {
    // Vectors take as long, however few lanes are used.
    let [first, _, _, ..] = group else {
        group.iter_mut().for_each(|plant| plant.finish());
        return;
    };
    let (half_s, substeps) = (first.steps.half_s, first.steps.substeps as usize);
    let mut h = first.steps.disturbances(first.tick);
    let h: [Vector3<f64>; INSTANTS] = std::array::from_fn(|_| h.next_h());
    // Without a lag the rotors do the same all through the tick.
    let instants = if group.iter().any(|plant| plant.spin().lags()) {
        2 * substeps + 1
    } else {
        1
    };
    let (mut body, mut dynamics) = (Columns::ZERO, Columns::ZERO);
    let mut forcing: heapless::Vec<Columns<5>, INSTANTS> = heapless::Vec::new();
    let _ = forcing.resize(instants, Columns::ZERO);
    for (lane, plant) in group.iter_mut().enumerate() {
        let spin = plant.spin();
        body.put(lane, &mut plant.body);
        dynamics.put(lane, &mut plant.dynamics);
        for (instant, forcing) in forcing.iter_mut().enumerate() {
            let effort = spin.effort(instant as f64 * half_s);
            forcing.put(lane, &mut plant.dynamics.forcing(&effort));
        }
    }
    integrate(&mut body, &dynamics, &forcing, &h[..=2 * substeps], half_s);
    for (lane, plant) in group.iter_mut().enumerate() {
        let body: RigidBody = body.of(lane);
        let eta2 = body.attitude.euler_near(&plant.eta2);
        let spin = plant.spin();
        plant.arrive(&spin, body, eta2);
    }
}

vectorised! {
    /// Carries all bodies to the next tick, as [`crate::integrator::integrate`] does one.
    fn integrate(
        bodies: &mut Columns<13>,
        dynamics: &Columns<21>,
        forcing: &[Columns<5>],
        h: &[Vector3<f64>],
        half_s: f64,
    ) {
        for start in (0..h.len() - 1).step_by(2) {
            let instants = [start, start + 1, start + 2];
            let forcing = instants.map(|instant| &forcing[instant.min(forcing.len() - 1)]);
            let h = instants.map(|instant| h[instant]);
            for lane in 0..LANES {
                let (body, dynamics): (RigidBody, Dynamics) = (bodies.of(lane), dynamics.of(lane));
                let [start, middle, end]: [Forcing; 3] =
                    std::array::from_fn(|i| dynamics.disturbed(&forcing[i].of(lane), &h[i]));
                let forcing = [&start, &middle, &end];
                bodies.put(lane, &mut runge_kutta_4(&body, &dynamics, forcing, half_s));
            }
        }
        for lane in 0..LANES {
            let body: RigidBody = bodies.of(lane);
            bodies.put(lane, &mut RigidBody { attitude: body.attitude.normalised(), ..body });
        }
    }
}
