//! The reference at an instant: where the vehicle should be, with derivatives up to snap.

use crate::layout::layout;

/// Reference of position, world frame, and of yaw.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct Reference {
    /// p_d [m].
    pub position_w_m: [f64; 3],
    /// First derivative of p_d [m/s].
    pub velocity_w_m_s: [f64; 3],
    /// Second derivative of p_d [m/s^2].
    pub acceleration_w_m_s2: [f64; 3],
    /// Third derivative of p_d [m/s^3].
    pub jerk_w_m_s3: [f64; 3],
    /// Fourth derivative of p_d [m/s^4].
    pub snap_w_m_s4: [f64; 3],
    /// psi_d [rad], not wrapped.
    pub yaw_rad: f64,
    /// First derivative of psi_d [rad/s].
    pub yaw_rate_rad_s: f64,
    /// Second derivative of psi_d [rad/s^2].
    pub yaw_acceleration_rad_s2: f64,
}

layout!(Reference {
    position_w_m,
    velocity_w_m_s,
    acceleration_w_m_s2,
    jerk_w_m_s3,
    snap_w_m_s4,
    yaw_rad,
    yaw_rate_rad_s,
    yaw_acceleration_rad_s2,
});
