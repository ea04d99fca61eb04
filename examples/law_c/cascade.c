// An inner law in C: the attitude loop of ironbird_attitude.h, rate PI, and the model's drag fed forward.
//
//     cc -std=c11 -O2 -fPIC -shared -I shared/ironbird_law/include -o libcascade.so examples/law_c/cascade.c -lm
//     ironbird simulate --inner ./libcascade.so

#include "ironbird_attitude.h"

#include <stdio.h>
#include <stdlib.h>

enum { ATTITUDE, FILTER, RATE, INTEGRAL, SETTINGS };
static const IronbirdSetting settings[SETTINGS] = {
    [ATTITUDE] = {.name = "attitude_1_s", .unit = "1/s", .meaning = "gain of the attitude error: roll, pitch, yaw",
                  .kind = IRONBIRD_THREE, .default_number = {8, 8, 3}, .min = 0.1, .max = 100},
    [FILTER] = {.name = "command_filter_rad_s", .unit = "rad/s", .meaning = "bandwidth of the attitude wanted",
                .kind = IRONBIRD_THREE, .default_number = {20, 20, 3}, .min = 0.1, .max = 500},
    [RATE] = {.name = "rate_1_s", .unit = "1/s", .meaning = "gain of the rate error",
              .kind = IRONBIRD_NUMBER, .default_number = {200}, .min = 1, .max = 900},
    [INTEGRAL] = {.name = "integral_1_s2", .unit = "1/s^2", .meaning = "gain of the rate error's integral; 0 is off",
                  .kind = IRONBIRD_NUMBER, .default_number = {0}, .min = 0, .max = 1e4},
};
static const IronbirdSignal telemetry[] = {
    {"rate_error_x_rad_s", "rad/s"}, {"rate_error_y_rad_s", "rad/s"}, {"rate_error_z_rad_s", "rad/s"},
};

// What changes in flight: an instance in a restarted process continues from it.
typedef struct {
    IronbirdAttitude attitude;
    double integral[3]; // of the rate error [rad]
} Memory;

typedef struct {
    IronbirdRig rig;
    IronbirdValue set[SETTINGS];
    Memory memory;
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

static uint64_t save(const void *law, void *bytes, uint64_t size)
{
    if (size < sizeof(Memory))
        return 0;
    memcpy(bytes, &((const Cascade *)law)->memory, sizeof(Memory));
    return sizeof(Memory);
}

static uint64_t load(void *law, const void *bytes, uint64_t size)
{
    if (size != sizeof(Memory))
        return 0;
    memcpy(&((Cascade *)law)->memory, bytes, size);
    return 1;
}

static void tick(void *instance, const IronbirdInnerInput *in, IronbirdDemand *out, IronbirdTelemetry *shown)
{
    Cascade *law = instance;
    const IronbirdAirframe *air = &law->rig.airframe;
    const IronbirdRates rates = ironbird_attitude(&law->memory.attitude, &law->rig, law->set[ATTITUDE].number,
                                                  law->set[FILTER].number, in);
    out->thrust_n = in->wanted.thrust_n;
    for (int i = 0; i < 3; i++) {
        out->torque_b_nm[i] = 0;
        if (!rates.fresh) // no torque is flown on an old measurement, and nothing is learnt from it
            continue;
        // The true drag, where nothing is swapped: a rival of a law that must learn it would leave it out.
        const double drag = air->rotational_drag_nm_s * in->measured.rate_b_rad_s[i];
        const double known = rates.wanted_dot[i] - rates.coupling[i]; // [rad/s^2]
        double *integral = &law->memory.integral[i];
        if (in->given.other_law) { // another law flies: the integral follows what that law adds to the known
            const double added = (in->given.torque_b_nm[i] - drag) / air->inertia_kg_m2[i] - known;
            *integral -= (added + law->set[INTEGRAL].number[0] * *integral) * law->rig.period_s / law->set[RATE].number[0];
        } else if (!in->given.saturated) { // what the rotors cannot give is not integrated
            *integral += rates.error[i] * law->rig.period_s;
        }
        const double pi = law->set[RATE].number[0] * rates.error[i] + law->set[INTEGRAL].number[0] * *integral;
        out->torque_b_nm[i] = air->inertia_kg_m2[i] * (known - pi) + drag;
        shown->value[i] = rates.error[i];
    }
}

static const IronbirdLaw law = {
    .interface_version = IRONBIRD_LAW_INTERFACE, .sizes = IRONBIRD_SIZES, .role = IRONBIRD_INNER,
    .name = "cascade", .version = "2", .summary = "attitude loop of `adaptive` and rate PI",
    .settings = settings, .settings_count = SETTINGS, .telemetry = telemetry, .telemetry_count = 3,
    .create = create, .destroy = free, .copy_into = copy_into, .save = save, .load = load,
    .tick_inner = tick,
};

const IronbirdLaw *ironbird_law(void)
{
    return &law;
}
