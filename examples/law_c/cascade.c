// An inner law in C: attitude P on Euler angles, rate PI, and the model's drag fed forward.
//
//     cc -std=c11 -O2 -fPIC -shared -I shared/ironbird_law/include -o libcascade.so examples/law_c/cascade.c -lm
//     ironbird simulate --inner ./libcascade.so

#include "ironbird_law.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double TURN = 6.283185307179586;
enum { ATTITUDE, RATE, INTEGRAL, SETTINGS };
static const IronbirdSetting settings[SETTINGS] = {
    [ATTITUDE] = {.name = "attitude_1_s", .unit = "1/s", .meaning = "gain of the attitude error: roll, pitch, yaw",
                  .kind = IRONBIRD_THREE, .default_number = {8, 8, 3}, .min = 0.1, .max = 100},
    [RATE] = {.name = "rate_1_s", .unit = "1/s", .meaning = "gain of the rate error",
              .kind = IRONBIRD_NUMBER, .default_number = {200}, .min = 1, .max = 900},
    [INTEGRAL] = {.name = "integral_1_s2", .unit = "1/s^2", .meaning = "gain of the rate error's integral; 0 is off",
                  .kind = IRONBIRD_NUMBER, .default_number = {0}, .min = 0, .max = 1e4},
};
static const IronbirdSignal telemetry[] = {
    {"rate_error_x_rad_s", "rad/s"}, {"rate_error_y_rad_s", "rad/s"}, {"rate_error_z_rad_s", "rad/s"},
};

typedef struct {
    IronbirdRig rig;
    IronbirdValue set[SETTINGS];
    double integral[3]; // of the rate error [rad]
} Cascade;

static void *create(void *context, const IronbirdRig *rig, const IronbirdValue *values, char *refused, uint64_t size)
{
    (void)context;
    if (values[ATTITUDE].number[0] > values[RATE].number[0]) {
        snprintf(refused, size, "attitude_1_s = %g is above rate_1_s = %g: the attitude loop must be the slower one",
                 values[ATTITUDE].number[0], values[RATE].number[0]);
        return NULL;
    }
    Cascade *law = calloc(1, sizeof *law);
    if (law != NULL) {
        law->rig = *rig;
        memcpy(law->set, values, sizeof law->set);
    }
    return law;
}

static void copy_into(const void *law, void *other)
{
    *(Cascade *)other = *(const Cascade *)law;
}

// What changes in flight: an instance in a restarted process continues from it.
static uint64_t save(const void *law, void *bytes, uint64_t size)
{
    const Cascade *cascade = law;
    if (size < sizeof cascade->integral)
        return 0;
    memcpy(bytes, cascade->integral, sizeof cascade->integral);
    return sizeof cascade->integral;
}

static uint64_t load(void *law, const void *bytes, uint64_t size)
{
    Cascade *cascade = law;
    if (size != sizeof cascade->integral)
        return 0;
    memcpy(cascade->integral, bytes, size);
    return 1;
}

// Body rates of Euler rates, at a roll and a pitch: nu = W d(eta).
static void body_rates(const double eta[3], const double d_eta[3], double nu[3])
{
    const double s = sin(eta[0]), c = cos(eta[0]), cp = cos(eta[1]);
    nu[0] = d_eta[0] - sin(eta[1]) * d_eta[2];
    nu[1] = c * d_eta[1] + s * cp * d_eta[2];
    nu[2] = -s * d_eta[1] + c * cp * d_eta[2];
}

static void tick(void *instance, const IronbirdInnerInput *in, IronbirdDemand *out, IronbirdTelemetry *shown)
{
    Cascade *law = instance;
    const IronbirdAirframe *air = &law->rig.airframe;
    const double *eta = in->measured.attitude_rad, *nu = in->measured.rate_b_rad_s, *i_m = air->inertia_kg_m2;
    out->thrust_n = in->wanted.thrust_n;
    out->torque_b_nm[0] = out->torque_b_nm[1] = out->torque_b_nm[2] = 0;
    if (in->measured_age > 0) // no torque is flown on an old measurement, and nothing is learnt from it
        return;
    double xi[3], nu_wanted[3], feed[3];
    for (int i = 0; i < 3; i++) {
        const double error = remainder(in->wanted.attitude_rad[i] - eta[i], TURN); // the short way round
        xi[i] = in->wanted.attitude_rate_rad_s[i] + law->set[ATTITUDE].number[i] * error;
    }
    body_rates(eta, xi, nu_wanted);
    body_rates(eta, in->wanted.attitude_acceleration_rad_s2, feed);
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        const double error = nu[i] - nu_wanted[i];
        const double coupling = (i_m[k] - i_m[j]) * nu[j] * nu[k];
        law->integral[i] += error * law->rig.period_s;
        shown->value[i] = error;
        const double pi = law->set[RATE].number[0] * error + law->set[INTEGRAL].number[0] * law->integral[i];
        out->torque_b_nm[i] = coupling + air->rotational_drag_nm_s * nu[i] + i_m[i] * (feed[i] - pi);
    }
}

static const IronbirdLaw law = {
    .interface_version = IRONBIRD_LAW_INTERFACE, .sizes = IRONBIRD_SIZES, .role = IRONBIRD_INNER,
    .name = "cascade", .version = "1", .summary = "attitude P on Euler angles and rate PI",
    .settings = settings, .settings_count = SETTINGS, .telemetry = telemetry, .telemetry_count = 3,
    .create = create, .destroy = free, .copy_into = copy_into, .save = save, .load = load,
    .tick_inner = tick,
};

const IronbirdLaw *ironbird_law(void)
{
    return &law;
}
