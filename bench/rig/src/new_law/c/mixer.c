/* my_law: thrust and torque to rotor speeds, each rotor cut to what it can. Change `tick`. */
#include <math.h>
#include <stdlib.h>

#include "ironbird_law.h"

/* What the law remembers from tick to tick belongs in here: the rig makes several instances. */
typedef struct {
    IronbirdRig rig;
} Law;

static void tick(void *law, const IronbirdMixerInput *input, IronbirdRotorSpeeds *speeds, IronbirdTelemetry *telemetry) {
    const Law *self = law;
    const IronbirdAirframe *airframe = &self->rig.airframe;
    const IronbirdDemand *demand = &input->demand;

    /* Rotors 1 rear left, 2 rear right, 3 front right, 4 front left: the signs of roll, pitch and yaw torque. */
    static const double sign[IRONBIRD_ROTORS][3] = {{1, 1, 1}, {-1, 1, -1}, {-1, -1, 1}, {1, -1, -1}};
    const double arm = airframe->arm_length_m * sqrt(0.5);
    const double lever[3] = {arm, arm, airframe->drag_factor_nm_s2 / airframe->thrust_coefficient_n_s2};

    speeds->saturated = 0;
    for (int rotor = 0; rotor < IRONBIRD_ROTORS; rotor++) {
        double thrust = demand->thrust_n / 4.0;
        for (int axis = 0; axis < 3; axis++) {
            thrust += sign[rotor][axis] * demand->torque_b_nm[axis] / (4.0 * lever[axis]);
        }
        double speed = sqrt(fmax(thrust, 0.0) / airframe->thrust_coefficient_n_s2);
        double possible = fmin(fmax(speed, self->rig.rotor_min_rad_s), self->rig.rotor_max_rad_s);
        speeds->speed_rad_s[rotor] = possible;
        speeds->saturated |= possible != speed;
        telemetry->value[0] = fmax(telemetry->value[0], fabs(possible - speed));
    }
}

static const IronbirdSignal signals[] = {
    {.name = "cut_rad_s", .unit = "rad/s"},
};

static void *create(void *context, const IronbirdRig *rig, const IronbirdValue *values, char *refused, uint64_t size) {
    (void)context, (void)values, (void)refused, (void)size;
    Law *law = malloc(sizeof *law);
    if (law != NULL) {
        *law = (Law){.rig = *rig};
    }
    return law;
}

static void copy_into(const void *law, void *other) { *(Law *)other = *(const Law *)law; }

static const IronbirdLaw law = {
    .interface_version = IRONBIRD_LAW_INTERFACE,
    .sizes = IRONBIRD_SIZES,
    .role = IRONBIRD_MIXER,
    .name = "my_law",
    .version = "1",
    .summary = "inverse allocation, each rotor cut to its range",
    .telemetry = signals,
    .telemetry_count = sizeof signals / sizeof signals[0],
    .create = create,
    .destroy = free,
    .copy_into = copy_into,
    .tick_mixer = tick,
};

const IronbirdLaw *ironbird_law(void) { return &law; }
