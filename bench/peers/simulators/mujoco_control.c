// The controller of mujoco_closed.py in C, as MuJoCo's control callback. RK4 calls it four times a step: it answers once.
#include <math.h>
#include <mujoco/mujoco.h>

static const double mass = 0.5, inertia[3] = {3.65e-3, 3.68e-3, 7.03e-3}, gravity = 9.81;
static const double kp = 6.5, kd = 4.0, kp_attitude = 310.0, kd_attitude = 35.0;

void control(const mjModel *model, mjData *data) {
    (void)model;
    double call = data->userdata[0];
    data->userdata[0] = call < 3 ? call + 1 : 0;
    if (call > 0) return;
    double t = data->time, s1 = sin(0.5 * t), c1 = cos(0.5 * t), s2 = sin(t), c2 = cos(t);
    double position[3] = {2 * s1, s2, 1.5}, velocity[3] = {c1, c2, 0}, acceleration[3] = {-0.5 * s1, -s2, 0};
    double force[3], rot_wb[9], wanted[3][3], column[3][3], x_w[3] = {1, 0, 0}, spin[3], gyroscopic[3];
    for (int i = 0; i < 3; i++) {
        force[i] = mass * (kp * (position[i] - data->qpos[i]) + kd * (velocity[i] - data->qvel[i]) + acceleration[i]);
    }
    force[2] += mass * gravity;
    mju_quat2Mat(rot_wb, data->qpos + 3);
    for (int i = 0; i < 9; i++) column[i % 3][i / 3] = rot_wb[i];
    mju_copy3(wanted[2], force);
    mju_normalize3(wanted[2]);
    mju_cross(wanted[1], wanted[2], x_w);
    mju_normalize3(wanted[1]);
    mju_cross(wanted[0], wanted[1], wanted[2]);
    const double *rate = data->qvel + 3;
    for (int i = 0; i < 3; i++) spin[i] = inertia[i] * rate[i];
    mju_cross(gyroscopic, rate, spin);
    data->ctrl[0] = fmax(mju_dot3(force, column[2]), 0);
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        double error = 0.5 * (mju_dot3(wanted[k], column[j]) - mju_dot3(column[k], wanted[j]));
        data->ctrl[1 + i] = inertia[i] * (-kp_attitude * error - kd_attitude * rate[i]) + gyroscopic[i];
    }
}
