/* my_law: from errors of position and velocity to thrust and attitude. Change `tick`. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "ironbird_law.h"

/* What the law remembers from tick to tick belongs in here: the rig makes several instances. */
typedef struct {
    IronbirdRig rig;
    double position_1_s2;
    double velocity_1_s;
} Law;

static void tick(void *law, const IronbirdOuterInput *input, IronbirdWanted *wanted, IronbirdTelemetry *telemetry) {
    const Law *self = law;
    const IronbirdAirframe *airframe = &self->rig.airframe;
    const IronbirdMeasured *measured = &input->measured;
    const IronbirdReference *reference = &input->reference;

    /* Acceleration by thrust: what the reference asks, the errors, gravity and drag. */
    double a[3];
    for (int i = 0; i < 3; i++) {
        double error = reference->position_w_m[i] - measured->position_w_m[i];
        double slower = reference->velocity_w_m_s[i] - measured->velocity_w_m_s[i];
        double drag = airframe->translational_drag_kg_s / airframe->mass_kg * measured->velocity_w_m_s[i];
        a[i] = reference->acceleration_w_m_s2[i] + self->position_1_s2 * error + self->velocity_1_s * slower + drag;
        telemetry->value[i] = error;
    }
    a[2] += airframe->gravity_m_s2;

    /* Body z along it, at the yaw of the reference. */
    const double yaw = reference->yaw_rad;
    const double ahead = cos(yaw) * a[0] + sin(yaw) * a[1];
    const double left = -sin(yaw) * a[0] + cos(yaw) * a[1];
    const double most = 4.0 * airframe->thrust_coefficient_n_s2 * self->rig.rotor_max_rad_s * self->rig.rotor_max_rad_s;
    const double thrust = airframe->mass_kg * sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]);
    *wanted = (IronbirdWanted){
        .thrust_n = fmin(thrust, most),
        .attitude_rad = {atan2(-left, hypot(ahead, a[2])), atan2(ahead, a[2]), yaw},
        .attitude_rate_rad_s = {0.0, 0.0, reference->yaw_rate_rad_s},
        .attitude_acceleration_rad_s2 = {0.0, 0.0, reference->yaw_acceleration_rad_s2},
        .limited = thrust > most,
    };
}

static const IronbirdSetting settings[] = {
    {.name = "position_1_s2", .unit = "1/s^2", .meaning = "acceleration per error of position", .kind = IRONBIRD_NUMBER,
     .default_number = {6.0}, .min = 0.1, .max = 100.0},
    {.name = "velocity_1_s", .unit = "1/s", .meaning = "acceleration per error of velocity", .kind = IRONBIRD_NUMBER,
     .default_number = {4.0}, .min = 0.1, .max = 100.0},
};

static const IronbirdSignal signals[] = {
    {.name = "x_error_m", .unit = "m"},
    {.name = "y_error_m", .unit = "m"},
    {.name = "z_error_m", .unit = "m"},
};

static void *create(void *context, const IronbirdRig *rig, const IronbirdValue *values, char *refused, uint64_t size) {
    (void)context;
    double position_1_s2 = values[0].number[0], velocity_1_s = values[1].number[0];
    if (velocity_1_s * velocity_1_s < position_1_s2) {
        snprintf(refused, size, "velocity_1_s = %g damps position_1_s2 = %g too little: allowed is its root or more",
                 velocity_1_s, position_1_s2);
        return NULL;
    }
    Law *law = malloc(sizeof *law);
    if (law != NULL) {
        *law = (Law){.rig = *rig, .position_1_s2 = position_1_s2, .velocity_1_s = velocity_1_s};
    }
    return law;
}

static void copy_into(const void *law, void *other) { *(Law *)other = *(const Law *)law; }

static const IronbirdLaw law = {
    .interface_version = IRONBIRD_LAW_INTERFACE,
    .sizes = IRONBIRD_SIZES,
    .role = IRONBIRD_OUTER,
    .name = "my_law",
    .version = "1",
    .summary = "thrust along the acceleration that the errors ask for",
    .settings = settings,
    .settings_count = sizeof settings / sizeof settings[0],
    .telemetry = signals,
    .telemetry_count = sizeof signals / sizeof signals[0],
    .create = create,
    .destroy = free,
    .copy_into = copy_into,
    .tick_outer = tick,
};

const IronbirdLaw *ironbird_law(void) { return &law; }
