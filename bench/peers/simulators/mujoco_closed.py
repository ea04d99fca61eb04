"""MuJoCo in closed loop: a free body with thrust and torque, RK4, and a geometric PD controller in plain Python."""

import math

import mujoco

import closed_loop
from mujoco_body import free_body

PERIOD_S = 1e-3
MASS_KG, INERTIA_KG_M2, GRAVITY_M_S2 = 0.5, (3.65e-3, 3.68e-3, 7.03e-3), 9.81
POSITION_GAINS, ATTITUDE_GAINS = (6.5, 4.0), (310.0, 35.0)
model = free_body(PERIOD_S, MASS_KG, INERTIA_KG_M2, GRAVITY_M_S2)


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def unit(a):
    length = math.sqrt(dot(a, a))
    return (a[0] / length, a[1] / length, a[2] / length)


def control(t, qpos, qvel):
    """Thrust [N] and torque [N m], and the distance to the reference [m]; the yaw is held at zero."""
    position, velocity, acceleration = closed_loop.reference(t)
    (kp, kd), (kp_attitude, kd_attitude) = POSITION_GAINS, ATTITUDE_GAINS
    force = [
        MASS_KG * (kp * (position[i] - qpos[i]) + kd * (velocity[i] - qvel[i]) + acceleration[i]) for i in range(3)
    ]
    force[2] += MASS_KG * GRAVITY_M_S2
    w, x, y, z = qpos[3:]
    columns = (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )
    up = unit(force)
    left = unit(cross(up, (1.0, 0.0, 0.0)))
    wanted = (cross(left, up), left, up)
    # The vector of (Rd' R - R' Rd) / 2, in the body's frame.
    turned = lambda i, j: 0.5 * (dot(wanted[i], columns[j]) - dot(columns[i], wanted[j]))
    error = (turned(2, 1), turned(0, 2), turned(1, 0))
    rate = qvel[3:]
    spin = [INERTIA_KG_M2[i] * rate[i] for i in range(3)]
    gyroscopic = cross(rate, spin)
    torque = [
        INERTIA_KG_M2[i] * (-kp_attitude * error[i] - kd_attitude * rate[i]) + gyroscopic[i] for i in range(3)
    ]
    return [max(dot(force, columns[2]), 0.0), *torque], math.dist(position, qpos[:3])


def fly(ticks):
    data = mujoco.MjData(model)
    position, velocity, _ = closed_loop.reference(0.0)
    data.qpos[:] = [*position, 1.0, 0.0, 0.0, 0.0]
    data.qvel[:3] = velocity
    largest = 0.0
    for tick in range(ticks):
        data.ctrl[:], error = control(tick * PERIOD_S, data.qpos.tolist(), data.qvel.tolist())
        largest = max(largest, error)
        mujoco.mj_step(model, data)
    return largest


flights, seconds = closed_loop.arguments()
closed_loop.report(closed_loop.one_by_one(fly), PERIOD_S, flights, seconds)
