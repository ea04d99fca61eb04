/* my_law: a cascade from attitude to body rates to torque. Change `tick`. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "ironbird_law.h"

/* What the law remembers from tick to tick belongs in here: the rig makes several instances. */
typedef struct {
    IronbirdRig rig;
    double attitude_1_s;
    double rate_1_s;
} Law;

static void tick(void *law, const IronbirdInnerInput *input, IronbirdDemand *demand, IronbirdTelemetry *telemetry) {
    const Law *self = law;
    const double *inertia = self->rig.airframe.inertia_kg_m2;
    const IronbirdMeasured *measured = &input->measured;
    const IronbirdWanted *wanted = &input->wanted;
    const double *rate = measured->rate_b_rad_s;

    /* Rates of roll, pitch, yaw that reduce the attitude's error, and the body rates p, q, r that they are. */
    double euler_rate[3];
    for (int i = 0; i < 3; i++) {
        double error = wanted->attitude_rad[i] - measured->attitude_rad[i];
        euler_rate[i] = wanted->attitude_rate_rad_s[i] + self->attitude_1_s * error;
        telemetry->value[i] = error;
    }
    const double sin_roll = sin(measured->attitude_rad[0]), cos_roll = cos(measured->attitude_rad[0]);
    const double sin_pitch = sin(measured->attitude_rad[1]), cos_pitch = cos(measured->attitude_rad[1]);
    const double rate_wanted[3] = {
        euler_rate[0] - sin_pitch * euler_rate[2],
        cos_roll * euler_rate[1] + sin_roll * cos_pitch * euler_rate[2],
        -sin_roll * euler_rate[1] + cos_roll * cos_pitch * euler_rate[2],
    };

    /* Euler's equation of the rigid body gives the torque. */
    demand->thrust_n = wanted->thrust_n;
    for (int x = 0; x < 3; x++) {
        int y = (x + 1) % 3, z = (x + 2) % 3;
        double acceleration = self->rate_1_s * (rate_wanted[x] - rate[x]) + wanted->attitude_acceleration_rad_s2[x];
        demand->torque_b_nm[x] = inertia[x] * acceleration + (inertia[z] - inertia[y]) * rate[y] * rate[z];
    }
}

static const IronbirdSetting settings[] = {
    {.name = "attitude_1_s", .unit = "1/s", .meaning = "rate per error of attitude", .kind = IRONBIRD_NUMBER,
     .default_number = {12.0}, .min = 0.1, .max = 100.0},
    {.name = "rate_1_s", .unit = "1/s", .meaning = "acceleration per error of rate", .kind = IRONBIRD_NUMBER,
     .default_number = {60.0}, .min = 0.1, .max = 500.0},
};

static const IronbirdSignal signals[] = {
    {.name = "roll_error_rad", .unit = "rad"},
    {.name = "pitch_error_rad", .unit = "rad"},
    {.name = "yaw_error_rad", .unit = "rad"},
};

static void *create(void *context, const IronbirdRig *rig, const IronbirdValue *values, char *refused, uint64_t size) {
    (void)context;
    double attitude_1_s = values[0].number[0], rate_1_s = values[1].number[0];
    if (2.0 * attitude_1_s > rate_1_s) {
        snprintf(refused, size, "attitude_1_s = %g is too quick for rate_1_s = %g: allowed is up to half of it",
                 attitude_1_s, rate_1_s);
        return NULL;
    }
    Law *law = malloc(sizeof *law);
    if (law != NULL) {
        *law = (Law){.rig = *rig, .attitude_1_s = attitude_1_s, .rate_1_s = rate_1_s};
    }
    return law;
}

static void copy_into(const void *law, void *other) { *(Law *)other = *(const Law *)law; }

static const IronbirdLaw law = {
    .interface_version = IRONBIRD_LAW_INTERFACE,
    .sizes = IRONBIRD_SIZES,
    .role = IRONBIRD_INNER,
    .name = "my_law",
    .version = "1",
    .summary = "attitude to rates to torque, with proportional gains",
    .settings = settings,
    .settings_count = sizeof settings / sizeof settings[0],
    .telemetry = signals,
    .telemetry_count = sizeof signals / sizeof signals[0],
    .create = create,
    .destroy = free,
    .copy_into = copy_into,
    .tick_inner = tick,
};

const IronbirdLaw *ironbird_law(void) { return &law; }
