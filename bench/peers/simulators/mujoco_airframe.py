"""MuJoCo flies the common work: a free body with four actuators in its own frame, RK4, the loop in MuJoCo's C."""

import time

import mujoco
import numpy as np
from mujoco import rollout

import common
from mujoco_body import free_body

path, steps = common.argument("WORK.json STEPS_PER_TICK")
work, steps = common.load(path), int(steps)
values = [work[key] for key in ("mass_kg", "inertia_kg_m2", "gravity_m_s2")]
model = free_body(work["period_s"] / steps, *values)
data = mujoco.MjData(model)

control = np.array([[command["thrust_n"], *command["torque_b_nm"]] for command in work["commands"]])
control = np.repeat(control, steps, axis=0)
start = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
mujoco.mj_getState(model, data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
states = np.zeros((1, len(control), len(start)))

warm = common.WARM_TICKS * steps
rollout.rollout(model, data, start, control[:warm])
begin = time.perf_counter()
states, _ = rollout.rollout(model, data, start, control, state=states)
wall_s = time.perf_counter() - begin

# A full state is time, qpos (position, then quaternion w x y z), qvel.
qpos = states[0, -1, 1:8]
common.report(work, wall_s, qpos[:3], [*qpos[4:], qpos[3]], version=mujoco.__version__)
