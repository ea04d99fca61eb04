// ironbird_attitude.h: the attitude loop of the built-in law `adaptive`, for inner laws in C and C++.
//
// A law that has its own rate loop calls ironbird_attitude once in every tick:
//
//     const IronbirdRates rates = ironbird_attitude(&self->attitude, &self->rig, k_eta, w_f, input);
//     if (!rates.fresh) return; // and asks for no torque
//     torque[i] = inertia[i] * (rates.wanted_dot[i] - rates.coupling[i] - gain * rates.error[i]);
//
// Symbols are those of the paper: nu2 body rates, eta2 roll, pitch, yaw, ec and e1 the filtered eta2 and its derivative.
// Singular at a pitch of +-90 degrees.

#pragma once

#include "ironbird_law.h"

#include <math.h>
#include <string.h>

// After so many seconds without a measurement the filter starts anew, at rest at the attitude that is measured next.
#define IRONBIRD_HOLD_S 0.1

// What the loop remembers from tick to tick: part of a law's saved state. All zero before tick 0.
typedef struct IronbirdAttitude {
  // ec [rad] and e1 [rad/s].
  double filtered_rad[3];
  double filtered_rate_rad_s[3];
  // Input of the filter in the last tick [rad/s^2], and the tick that the filter is valid for.
  double input_rad_s2[3];
  uint64_t filter_tick;
  // Tick of the newest measurement, plus 1; 0 before the first.
  uint64_t after_measured;
} IronbirdAttitude;

// What a rate loop works with.
typedef struct IronbirdRates {
  // 1 where `measured` is of this tick; else nothing below is set, and no torque is flown.
  int fresh;
  // 1 where the tick before was measured too: a law that differentiates or learns may do so.
  int consecutive;
  // 1 at the first measurement, and at the first after IRONBIRD_HOLD_S without: what a law remembers is too old.
  int lost;
  // nu2_d, the body rates wanted [rad/s], and their derivative [rad/s^2].
  double wanted[3];
  double wanted_dot[3];
  // nu2 - nu2_d [rad/s].
  double error[3];
  // f = -I^-1 (nu2 x I nu2): what the rates gain by themselves [rad/s^2].
  double coupling[3];
} IronbirdRates;

// Thrust [N] and torque [N m] of rotors at these squared speeds [rad^2/s^2], by the nominal model: the paper's (7).
static inline IronbirdDemand ironbird_wrench(const IronbirdRig *rig, const double speed_squared[IRONBIRD_ROTORS])
{
  const IronbirdAirframe *air = &rig->airframe;
  const double arm = air->arm_length_m * sqrt(0.5), k = air->thrust_coefficient_n_s2;
  const double *w2 = speed_squared;
  IronbirdDemand wrench;
  wrench.thrust_n = k * (w2[0] + w2[1] + w2[2] + w2[3]);
  wrench.torque_b_nm[0] = arm * k * (w2[0] - w2[1] - w2[2] + w2[3]);
  wrench.torque_b_nm[1] = arm * k * (w2[0] + w2[1] - w2[2] - w2[3]);
  wrench.torque_b_nm[2] = air->drag_factor_nm_s2 * (w2[0] - w2[1] + w2[2] - w2[3]);
  return wrench;
}

// f at body rates [rad/s].
static inline void ironbird_coupling(const IronbirdRig *rig, const double nu2[3], double f[3])
{
  const double *i_m = rig->airframe.inertia_kg_m2;
  for (int x = 0; x < 3; x++) {
    const int y = (x + 1) % 3, z = (x + 2) % 3;
    f[x] = (i_m[y] - i_m[z]) / i_m[x] * nu2[y] * nu2[z];
  }
}

// W xi: body rates of Euler rates, at roll and pitch.
static inline void ironbird_body_rates(const double eta2[3], const double xi[3], double nu2[3])
{
  const double s = sin(eta2[0]), c = cos(eta2[0]), across = cos(eta2[1]) * xi[2];
  nu2[0] = xi[0] - sin(eta2[1]) * xi[2];
  nu2[1] = c * xi[1] + s * across;
  nu2[2] = c * across - s * xi[1];
}

// J2 nu2: Euler rates of body rates.
static inline void ironbird_euler_rates(const double eta2[3], const double nu2[3], double d_eta2[3])
{
  const double s = sin(eta2[0]), c = cos(eta2[0]), d_psi = (s * nu2[1] + c * nu2[2]) / cos(eta2[1]);
  d_eta2[0] = nu2[0] + sin(eta2[1]) * d_psi;
  d_eta2[1] = c * nu2[1] - s * nu2[2];
  d_eta2[2] = d_psi;
}

// The critically damped filter ec'' = win - 2 w_f ec' - w_f^2 ec over a time [s], exact for a held input.
static inline void ironbird_filter(IronbirdAttitude *self, const double w_f[3], double dt_s)
{
  for (int i = 0; i < 3; i++) {
    const double target = self->input_rad_s2[i] / (w_f[i] * w_f[i]), decay = exp(-w_f[i] * dt_s);
    const double y0 = self->filtered_rad[i] - target, e1 = self->filtered_rate_rad_s[i];
    self->filtered_rad[i] = target + decay * (y0 + dt_s * (w_f[i] * y0 + e1));
    self->filtered_rate_rad_s[i] = decay * (e1 - w_f[i] * dt_s * (w_f[i] * y0 + e1));
  }
}

// The loop in a tick: `k_eta` [1/s] closes the error of roll, pitch and yaw, `w_f` [rad/s] is the bandwidth of the filter.
static inline IronbirdRates ironbird_attitude(IronbirdAttitude *self, const IronbirdRig *rig, const double k_eta[3],
                                              const double w_f[3], const IronbirdInnerInput *in)
{
  const double *eta2 = in->measured.attitude_rad, *nu2 = in->measured.rate_b_rad_s;
  const uint64_t since = in->tick + 1 - self->after_measured;
  IronbirdRates rates;
  memset(&rates, 0, sizeof rates);
  rates.fresh = in->measured_age == 0;
  rates.lost = rates.fresh && (self->after_measured == 0 || since > (uint64_t)round(IRONBIRD_HOLD_S / rig->period_s));
  rates.consecutive = rates.fresh && self->after_measured != 0 && since == 1;
  if (rates.lost) {
    memcpy(self->filtered_rad, eta2, sizeof self->filtered_rad);
    memset(self->filtered_rate_rad_s, 0, sizeof self->filtered_rate_rad_s);
  } else if (in->tick > self->filter_tick) {
    ironbird_filter(self, w_f, (double)(in->tick - self->filter_tick) * rig->period_s);
  }
  for (int i = 0; i < 3; i++)
    self->input_rad_s2[i] = in->wanted.attitude_acceleration_rad_s2[i] + 2.0 * w_f[i] * in->wanted.attitude_rate_rad_s[i] +
                            w_f[i] * w_f[i] * in->wanted.attitude_rad[i];
  if (rates.fresh) {
    double d_eta2[3], xi[3], d_xi[3];
    ironbird_euler_rates(eta2, nu2, d_eta2);
    for (int i = 0; i < 3; i++) {
      const double ec = self->filtered_rad[i], e1 = self->filtered_rate_rad_s[i];
      const double e2 = self->input_rad_s2[i] - 2.0 * w_f[i] * e1 - w_f[i] * w_f[i] * ec;
      // Yaw the short way round.
      const double error = i < 2 ? ec - eta2[i] : remainder(ec - eta2[i], 6.283185307179586);
      xi[i] = e1 + k_eta[i] * error;
      d_xi[i] = e2 + k_eta[i] * (e1 - d_eta2[i]);
    }
    ironbird_body_rates(eta2, xi, rates.wanted);
    ironbird_body_rates(eta2, d_xi, rates.wanted_dot);
    // d(W)/dt xi, at the Euler rates d_eta2.
    const double s = sin(eta2[0]), c = cos(eta2[0]), sp = sin(eta2[1]), cp = cos(eta2[1]);
    const double across = cp * xi[2], d_across = -sp * d_eta2[1] * xi[2];
    rates.wanted_dot[0] -= cp * d_eta2[1] * xi[2];
    rates.wanted_dot[1] += d_eta2[0] * (c * across - s * xi[1]) + s * d_across;
    rates.wanted_dot[2] += -d_eta2[0] * (s * across + c * xi[1]) + c * d_across;
    ironbird_coupling(rig, nu2, rates.coupling);
    for (int i = 0; i < 3; i++)
      rates.error[i] = nu2[i] - rates.wanted[i];
    self->after_measured = in->tick + 1;
  }
  ironbird_filter(self, w_f, rig->period_s);
  self->filter_tick = in->tick + 1;
  return rates;
}
