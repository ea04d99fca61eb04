// A law of the outer loop and one of the mixer, one per library: ROLE says which.

#include "ironbird_law.h"

#include <math.h>
#include <stdlib.h>

static void *create(void *context, const IronbirdRig *rig, const IronbirdValue *values, char *refused, uint64_t size)
{
    (void)context, (void)values, (void)refused, (void)size;
    IronbirdRig *law = malloc(sizeof *law);
    if (law != NULL)
        *law = *rig;
    return law;
}

// PD on the position, by small angles, along yaw 0.
static void follow(void *law, const IronbirdOuterInput *in, IronbirdWanted *out, IronbirdTelemetry *shown)
{
    const IronbirdAirframe *air = &((IronbirdRig *)law)->airframe;
    double a[3];
    for (int i = 0; i < 3; i++) {
        const double error = in->reference.position_w_m[i] - in->measured.position_w_m[i];
        const double drag = air->translational_drag_kg_s / air->mass_kg * in->measured.velocity_w_m_s[i];
        a[i] = in->reference.acceleration_w_m_s2[i] + 4 * error + drag
               + 3 * (in->reference.velocity_w_m_s[i] - in->measured.velocity_w_m_s[i]);
        shown->value[i] = error;
        out->attitude_rad[i] = out->attitude_rate_rad_s[i] = out->attitude_acceleration_rad_s2[i] = 0;
    }
    out->attitude_rad[0] = -a[1] / air->gravity_m_s2;
    out->attitude_rad[1] = a[0] / air->gravity_m_s2;
    out->thrust_n = air->mass_kg * (air->gravity_m_s2 + a[2]);
}

// The allocation inverted; what a rotor cannot give is not given.
static void mix(void *law, const IronbirdMixerInput *in, IronbirdRotorSpeeds *out, IronbirdTelemetry *shown)
{
    const IronbirdRig *rig = law;
    const double c = rig->airframe.arm_length_m * sqrt(0.5), k = rig->airframe.thrust_coefficient_n_s2;
    const double kappa = rig->airframe.drag_factor_nm_s2 / k, *tau = in->demand.torque_b_nm;
    const double roll[] = {1, -1, -1, 1}, pitch[] = {1, 1, -1, -1}, yaw[] = {1, -1, 1, -1};
    out->saturated = 0;
    for (int i = 0; i < IRONBIRD_ROTORS; i++) {
        const double thrust =
            (in->demand.thrust_n + (roll[i] * tau[0] + pitch[i] * tau[1]) / c + yaw[i] * tau[2] / kappa) / 4;
        const double wanted = sqrt(fmax(thrust, 0) / k);
        out->speed_rad_s[i] = fmin(fmax(wanted, rig->rotor_min_rad_s), rig->rotor_max_rad_s);
        out->saturated |= out->speed_rad_s[i] != wanted;
        shown->value[i] = thrust;
    }
}

static const IronbirdLaw law = {
    .interface_version = IRONBIRD_LAW_INTERFACE, .sizes = IRONBIRD_SIZES, .role = ROLE,
    .name = ROLE == IRONBIRD_OUTER ? "follow" : "mix", .version = "1", .summary = "flies in a test",
    .create = create, .destroy = free,
    .tick_outer = ROLE == IRONBIRD_OUTER ? follow : NULL, .tick_mixer = ROLE == IRONBIRD_MIXER ? mix : NULL,
};

const IronbirdLaw *ironbird_law(void)
{
    return &law;
}
