//! The nominal airframe and the period.

/// T [s].
pub const T: f64 = 0.001;
/// g [m/s^2].
pub const G: f64 = 9.8;
/// m [kg].
pub const M: f64 = 0.52;
/// k_t [kg/s].
pub const K_T: f64 = 0.95;
/// k [N s^2].
pub const K: f64 = 3.13e-5;
/// kappa = d/k [m].
pub const KAPPA: f64 = 7.5e-7 / K;
/// l sqrt(2)/2 [m].
pub const C: f64 = 0.205 * std::f64::consts::SQRT_2 / 2.0;
/// I_x, I_y, I_z [kg m^2].
pub const I_X: f64 = 0.0069;
pub const I_Y: f64 = 0.0069;
pub const I_Z: f64 = 0.0129;
