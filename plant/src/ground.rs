//! Ground: contact of the airframe with a level plane.
//!
//! The airframe is a box with a corner under and over each rotor. After every step of the integrator, corners that
//! have come below the plane get impulses: along the normal so large that they do not sink further, across it as large
//! as Coulomb's friction allows. The impulses are found by projected Gauss-Seidel sweeps. No stiffness limits the step,
//! and none gives back energy. Where the body is, they count as forces that acted all through the step: what stands
//! does not creep. What is still below the plane is raised to it, and the motion pays for the height.

use std::f64::consts::FRAC_1_SQRT_2;

use messages::parameters::Airframe;
use nalgebra::{Matrix3, Vector3};

use crate::envelope_violation::Crash;
use crate::rigid_body::RigidBody;

const CORNERS: usize = 8;
/// Sweeps over the corners that touch; four feet at rest need fewer.
const SWEEPS: usize = 20;

/// The plane, and what of the airframe matters to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ground {
    pub z_m: f64,
    /// From the plane of the rotors to the feet, and to the top [m].
    pub leg_m: f64,
    pub friction: f64,
    pub crash_speed_m_s: f64,
    /// Largest tilt in a touch that is a landing [rad].
    pub crash_tilt_rad: f64,
}

/// What the ground did to the body in a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Contact {
    /// Sum of the impulses, world frame [N s].
    pub impulse_w: Vector3<f64>,
    /// Fastest approach of a corner that touched [m/s].
    pub speed_m_s: f64,
    pub tilt_rad: f64,
}

/// A corner that touches: how impulses there act, and those that it has got.
#[derive(Clone, Copy, Debug)]
struct Corner {
    /// From the centre of mass, body frame [m].
    arm_b: Vector3<f64>,
    /// Velocity per impulse along each axis of the world [1/kg].
    per_impulse: Vector3<f64>,
    /// World frame [N s].
    impulse_w: Vector3<f64>,
}

struct ContactBody<'a> {
    body: &'a mut RigidBody,
    rot_wb: Matrix3<f64>,
    per_mass: f64,
    per_inertia: Vector3<f64>,
}

impl ContactBody<'_> {
    fn velocity_w(&self, arm_b: &Vector3<f64>) -> Vector3<f64> {
        self.body.v + self.rot_wb * self.body.nu2.cross(arm_b)
    }

    fn push(&mut self, arm_b: &Vector3<f64>, impulse_w: &Vector3<f64>) {
        let turn = arm_b.cross(&self.rot_wb.tr_mul(impulse_w));
        self.body.v += impulse_w * self.per_mass;
        self.body.nu2 += turn.component_mul(&self.per_inertia);
    }

    fn corner(&self, arm_b: Vector3<f64>) -> Corner {
        let per_impulse = Vector3::from_fn(|axis, _| {
            let turn = arm_b.cross(&self.rot_wb.row(axis).transpose());
            self.per_mass + turn.dot(&turn.component_mul(&self.per_inertia))
        });
        Corner {
            arm_b,
            per_impulse,
            impulse_w: Vector3::zeros(),
        }
    }
}

/// Takes from the motion of a body what contact has given it in energy since `free`, the end of a step that fell by
/// `fall_m_s2` [m/s^2]. What the motion cannot pay is left below the plane: some nanometres, where nearly at rest.
fn take_back(airframe: &Airframe, free: &RigidBody, fall_m_s2: f64, body: &mut RigidBody) {
    let i_m = Vector3::from(airframe.i_m());
    let kinetic_j = |body: &RigidBody| {
        (airframe.m() * body.v.norm_squared() + body.nu2.component_mul(&i_m).dot(&body.nu2)) / 2.0
    };
    let weight_n = airframe.m() * fall_m_s2;
    let moving_j = kinetic_j(body);
    let given_j = moving_j - kinetic_j(free) + weight_n * (body.eta1.z - free.eta1.z);
    if given_j > 0.0 && weight_n > 0.0 {
        let kept = (1.0 - given_j / moving_j).max(0.0).sqrt();
        body.v *= kept;
        body.nu2 *= kept;
        body.eta1.z -= (given_j - moving_j).max(0.0) / weight_n;
    }
}

impl Ground {
    /// Height of the lowest corner above the plane [m].
    pub fn clearance_m(&self, airframe: &Airframe, body: &RigidBody) -> f64 {
        let down_b = body.attitude.rot_wb().row(2).transpose();
        let lowest = |least: f64, arm_b: &Vector3<f64>| least.min(down_b.dot(arm_b));
        body.eta1.z - self.z_m + self.corners(airframe).iter().fold(f64::INFINITY, lowest)
    }

    /// Keeps a body above the plane after a step of `step_s` [s] from `start`, and adds what that took to `contact`.
    pub fn keep_above(
        &self,
        airframe: &Airframe,
        start: &RigidBody,
        body: &mut RigidBody,
        step_s: f64,
        contact: &mut Contact,
    ) {
        let clearance_m = self.clearance_m(airframe, body);
        // Not a number is not below ground either.
        if clearance_m.is_nan() || clearance_m > 0.0 {
            return;
        }
        contact.tilt_rad = contact.tilt_rad.max(body.tilt_rad());
        let rot_wb = body.attitude.rot_wb();
        let (height_m, free) = (body.eta1.z - self.z_m, *body);
        let per_inertia = Vector3::from(airframe.i_m()).map(f64::recip);
        let mut contact_body = ContactBody {
            body,
            rot_wb,
            per_mass: 1.0 / airframe.m(),
            per_inertia,
        };
        let mut touching: heapless::Vec<Corner, CORNERS> = self
            .corners(airframe)
            .into_iter()
            .filter(|arm_b| height_m + (rot_wb * arm_b).z <= 0.0)
            .map(|arm_b| contact_body.corner(arm_b))
            .collect();
        for corner in &touching {
            contact.speed_m_s = contact
                .speed_m_s
                .max(-contact_body.velocity_w(&corner.arm_b).z);
        }
        for _ in 0..SWEEPS {
            for corner in &mut touching {
                self.settle(corner, &mut contact_body);
            }
        }
        for corner in &touching {
            contact.impulse_w += corner.impulse_w;
        }
        let half_s = step_s / 2.0;
        body.eta1 += (body.v - free.v) * half_s;
        body.attitude = body
            .attitude
            .along(&body.attitude.rate(&(body.nu2 - free.nu2)), half_s)
            .normalised();
        body.eta1.z -= self.clearance_m(airframe, body).min(0.0);
        take_back(airframe, &free, (start.v.z - free.v.z) / step_s, body);
    }

    /// Whether a contact was none of a landing.
    pub fn crash(&self, tick: u64, contact: &Contact) -> Option<Crash> {
        let (speed_m_s, tilt_rad) = (contact.speed_m_s, contact.tilt_rad);
        let (speed_max_m_s, tilt_max_rad) = (self.crash_speed_m_s, self.crash_tilt_rad);
        (speed_m_s > speed_max_m_s || tilt_rad > tilt_max_rad).then_some(Crash {
            tick,
            speed_m_s,
            tilt_rad,
            speed_max_m_s,
            tilt_max_rad,
        })
    }

    /// One step of the sweep: the corner stops sinking, then sliding, as far as it may be pushed for that.
    fn settle(&self, corner: &mut Corner, contact_body: &mut ContactBody<'_>) {
        let mut wanted = corner.impulse_w;
        wanted.z =
            (wanted.z - contact_body.velocity_w(&corner.arm_b).z / corner.per_impulse.z).max(0.0);
        contact_body.push(&corner.arm_b, &(wanted - corner.impulse_w));
        corner.impulse_w = wanted;
        let sliding = contact_body.velocity_w(&corner.arm_b);
        wanted.x -= sliding.x / corner.per_impulse.x;
        wanted.y -= sliding.y / corner.per_impulse.y;
        let (across, allowed) = (
            (wanted.x * wanted.x + wanted.y * wanted.y).sqrt(),
            self.friction * wanted.z,
        );
        if across > allowed {
            wanted.x *= allowed / across;
            wanted.y *= allowed / across;
        }
        contact_body.push(&corner.arm_b, &(wanted - corner.impulse_w));
        corner.impulse_w = wanted;
    }

    /// From the centre of mass, body frame [m].
    fn corners(&self, airframe: &Airframe) -> [Vector3<f64>; CORNERS] {
        let c = airframe.l() * FRAC_1_SQRT_2;
        std::array::from_fn(|i| {
            let side = |bit: usize, length: f64| if (i >> bit) & 1 == 0 { -length } else { length };
            Vector3::new(side(0, c), side(1, c), side(2, self.leg_m))
        })
    }
}
