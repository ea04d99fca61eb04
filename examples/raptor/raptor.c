// RAPTOR, a neural policy for quadrotors, as an inner law: it flies from position error to rotor speeds by itself, and of
// the outer law uses the reference only. README.md beside this file says how to build and fly it.
//
// Sources: Eschmann, Albani, Loianno, "RAPTOR: A Foundation Policy for Quadrotor Control", 2025 (arXiv:2509.11481).
// Network and weights: PyPI, foundation-policy 1.0.2 (MIT licence); weights.py makes raptor_weights.h of it.
// Interface to the vehicle: PX4, src/modules/mc_raptor (BSD licence); the policy's simulator l2f of rl-tools.
//
// Input (22): position, rotation matrix row by row, velocity, body rate, last action. As in PX4, position and velocity
// are errors to the reference, in a frame turned by its yaw and cut to +-0.5 m and +-1 m/s, and the first "last action"
// is 0. The action is four rotor speeds, -1 the slowest, 1 the fastest (l2f: thrust is a polynomial of it,
// nearly its square). What lies outside is cut for the rotors, but not in the "last action", as in PX4 and l2f.
//
// Differences:
// * The rotors of l2f and PX4 spin the other way round. Here the policy's body x axis is the vehicle's y axis: with that
//   quarter turn each of its rotors is one that spins as expected.
// * A law outputs thrust and torque. They are those of the wanted rotor speeds, so the mixer returns these speeds,
//   unless their roll and pitch torque without the yaw torque are beyond a rotor's limit: then it cuts roll and pitch.
// * PX4 also evaluates the policy between its steps of 10 ms; here the action is held.
// * Without a measurement of this tick there is no step; the next one comes with the next measurement.

#include "ironbird_attitude.h"
#include "raptor_weights.h"

#include <stdio.h>
#include <stdlib.h>

#define STEP_S 0.01
enum { INPUTS = 22, HIDDEN = 16, ACTIONS = IRONBIRD_ROTORS };

enum { POSITION, VELOCITY, SETTINGS };
static const IronbirdSetting settings[SETTINGS] = {
    [POSITION] = {.name = "position_error_max_m", .unit = "m", .meaning = "cut of the position error, per axis",
                  .kind = IRONBIRD_NUMBER, .default_number = {0.5}, .min = 0.01, .max = 10},
    [VELOCITY] = {.name = "velocity_error_max_m_s", .unit = "m/s", .meaning = "cut of the velocity error, per axis",
                  .kind = IRONBIRD_NUMBER, .default_number = {1}, .min = 0.01, .max = 10},
};
static const IronbirdSignal telemetry[] = {{"action_1", ""}, {"action_2", ""}, {"action_3", ""}, {"action_4", ""}};

// What changes in flight: an instance in a restarted process continues from it.
typedef struct {
    double hidden[HIDDEN];
    double action[ACTIONS]; // front right, rear right, rear left, front left of the policy's frame
    uint64_t next_tick;     // of the next step; 0 before the first
} Memory;

typedef struct {
    IronbirdRig rig;
    IronbirdValue set[SETTINGS];
    uint64_t step_ticks;
    Memory memory;
} Raptor;

static double row(const float *weight, float bias, const double *input, int count)
{
    double sum = bias;
    for (int i = 0; i < count; i++)
        sum += weight[i] * input[i];
    return sum;
}

static double sigmoid(double x)
{
    return 1 / (1 + exp(-x));
}

// The forward pass: dense with ReLU, a gated recurrent unit, dense. Exported for weights.py --check.
//
//     x = max(0, W input + b)            r = sigmoid(Wir x + bir + Whr h + bhr)    z likewise
//     n = tanh(Win x + bin + r (Whn h + bhn))        h+ = z h + (1 - z) n          action = Wo h+ + bo
void raptor_step(double hidden[HIDDEN], const double input[INPUTS], double action[ACTIONS]);
void raptor_step(double hidden[HIDDEN], const double input[INPUTS], double action[ACTIONS])
{
    double x[HIDDEN], of_input[3 * HIDDEN], of_hidden[3 * HIDDEN]; // r, z, n
    for (int i = 0; i < HIDDEN; i++)
        x[i] = fmax(0, row(&dense_weight[i * INPUTS], dense_bias[i], input, INPUTS));
    for (int i = 0; i < 3 * HIDDEN; i++) {
        of_input[i] = row(&gru_input_weight[i * HIDDEN], gru_input_bias[i], x, HIDDEN);
        of_hidden[i] = row(&gru_hidden_weight[i * HIDDEN], gru_hidden_bias[i], hidden, HIDDEN);
    }
    for (int i = 0; i < HIDDEN; i++) {
        const double r = sigmoid(of_input[i] + of_hidden[i]), z = sigmoid(of_input[HIDDEN + i] + of_hidden[HIDDEN + i]);
        const double n = tanh(of_input[2 * HIDDEN + i] + r * of_hidden[2 * HIDDEN + i]);
        hidden[i] = z * hidden[i] + (1 - z) * n;
    }
    for (int i = 0; i < ACTIONS; i++)
        action[i] = row(&output_weight[i * HIDDEN], output_bias[i], hidden, HIDDEN);
}

static double cut(double x, double max)
{
    return fmax(-max, fmin(max, x));
}

// What the policy sees. Its world frame is turned by the reference's yaw, and both its frames by a quarter turn more.
static void observe(const Raptor *law, const IronbirdInnerInput *in, double input[INPUTS])
{
    const double *q = in->measured.attitude_quaternion, w = q[0], x = q[1], y = q[2], z = q[3];
    const double rot_wb[3][3] = {
        {1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
        {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
        {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)},
    };
    const double s = sin(in->reference.yaw_rad), c = cos(in->reference.yaw_rad);
    const double axis_w[3][3] = {{-s, c, 0}, {-c, -s, 0}, {0, 0, 1}}; // of the policy's world
    const double axis_b[3][3] = {{0, 1, 0}, {-1, 0, 0}, {0, 0, 1}};   // of the policy's body
    memset(input, 0, INPUTS * sizeof *input);
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            input[i] += axis_w[i][j] * (in->measured.position_w_m[j] - in->reference.position_w_m[j]);
            input[12 + i] += axis_w[i][j] * (in->measured.velocity_w_m_s[j] - in->reference.velocity_w_m_s[j]);
            input[15 + i] += axis_b[i][j] * in->measured.rate_b_rad_s[j];
            for (int k = 0; k < 9; k++)
                input[3 + 3 * i + j] += axis_w[i][k / 3] * rot_wb[k / 3][k % 3] * axis_b[j][k % 3];
        }
        input[i] = cut(input[i], law->set[POSITION].number[0]);
        input[12 + i] = cut(input[12 + i], law->set[VELOCITY].number[0]);
    }
    memcpy(&input[18], law->memory.action, sizeof law->memory.action);
}

static void *create(void *context, const IronbirdRig *rig, const IronbirdValue *values, char *refused, uint64_t size)
{
    (void)context;
    const double ticks = STEP_S / rig->period_s;
    if (ticks < 0.999 || fabs(ticks - round(ticks)) > 1e-6 * ticks) {
        snprintf(refused, size, "the policy has a step of 10 ms, which is no whole number of ticks of %g ms: fly with a "
                 "--rate that is a multiple of 100 Hz", rig->period_s * 1e3);
        return NULL;
    }
    Raptor *law = calloc(1, sizeof *law);
    if (law != NULL) {
        law->rig = *rig;
        law->step_ticks = (uint64_t)round(ticks);
        memcpy(law->set, values, sizeof law->set);
        for (int i = 0; i < HIDDEN; i++)
            law->memory.hidden[i] = gru_initial[i];
    }
    return law;
}

static void copy_into(const void *law, void *other)
{
    *(Raptor *)other = *(const Raptor *)law;
}

static uint64_t save(const void *law, void *bytes, uint64_t size)
{
    if (size < sizeof(Memory))
        return 0;
    memcpy(bytes, &((const Raptor *)law)->memory, sizeof(Memory));
    return sizeof(Memory);
}

static uint64_t load(void *law, const void *bytes, uint64_t size)
{
    if (size != sizeof(Memory))
        return 0;
    memcpy(&((Raptor *)law)->memory, bytes, size);
    return 1;
}

static void tick(void *instance, const IronbirdInnerInput *in, IronbirdDemand *out, IronbirdTelemetry *shown)
{
    Raptor *law = instance;
    Memory *memory = &law->memory;
    if (in->measured_age == 0 && in->wanted_age != IRONBIRD_NEVER && in->tick >= memory->next_tick) {
        double input[INPUTS];
        observe(law, in, input);
        raptor_step(memory->hidden, input, memory->action);
        memory->next_tick = in->tick + law->step_ticks;
    }
    if (memory->next_tick == 0) { // no step yet: thrust of hover, which is wanted without an outer law, and no torque
        *out = (IronbirdDemand){.thrust_n = in->wanted.thrust_n};
        return;
    }
    const double slowest = law->rig.rotor_min_rad_s, range = law->rig.rotor_max_rad_s - slowest;
    double speed_squared[IRONBIRD_ROTORS];
    for (int i = 0; i < ACTIONS; i++) {
        const double speed = slowest + range * (cut(memory->action[i], 1) + 1) / 2;
        speed_squared[3 - i] = speed * speed; // the quarter turn: its front right is the front left here
        shown->value[i] = memory->action[i];
    }
    *out = ironbird_wrench(&law->rig, speed_squared);
}

static const IronbirdLaw law = {
    .interface_version = IRONBIRD_LAW_INTERFACE, .sizes = IRONBIRD_SIZES, .role = IRONBIRD_INNER,
    .name = "raptor", .version = "1", .summary = "RAPTOR, a recurrent neural policy, from position error to rotor speeds",
    .source = "Eschmann, Albani, Loianno, RAPTOR: A Foundation Policy for Quadrotor Control, 2025; foundation-policy 1.0.2",
    .settings = settings, .settings_count = SETTINGS, .telemetry = telemetry, .telemetry_count = ACTIONS,
    .create = create, .destroy = free, .copy_into = copy_into, .save = save, .load = load,
    .tick_inner = tick,
};

const IronbirdLaw *ironbird_law(void)
{
    return &law;
}
