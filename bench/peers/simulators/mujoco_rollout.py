"""MuJoCo in closed loop without Python: `rollout` of a free body, RK4, and the controller of mujoco_control.c."""

import ctypes
import math
import subprocess
import tempfile
from pathlib import Path

import mujoco
import numpy as np
from mujoco import rollout

import closed_loop
from mujoco_body import free_body

PERIOD_S = 1e-3
FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
source = Path(__file__).with_name("mujoco_control.c")
with tempfile.TemporaryDirectory() as directory:
    library = Path(directory, "control.so")
    package = Path(mujoco.__file__).parent
    (mujoco_library,) = package.glob("libmujoco.so*")
    subprocess.run(["cc", "-O3", "-march=native", "-shared", "-fPIC", f"-I{package}/include", source, mujoco_library, "-o", library],
                   check=True)
    control = ctypes.CDLL(str(library)).control
model = free_body(PERIOD_S, 0.5, (3.65e-3, 3.68e-3, 7.03e-3), 9.81, user_numbers=1)
mujoco.set_mjcb_control(control)


def fly(flights, ticks):
    data = mujoco.MjData(model)
    position, velocity, _ = closed_loop.reference(0.0)
    data.qpos[:] = [*position, 1.0, 0.0, 0.0, 0.0]
    data.qvel[:3] = velocity
    start = np.zeros(mujoco.mj_stateSize(model, FULL))
    mujoco.mj_getState(model, data, start, FULL)
    states, _ = rollout.rollout(model, data, np.tile(start, (flights, 1)), nstep=ticks)
    # A full state is time, qpos, qvel.
    position, _, _ = closed_loop.reference(states[0, -1, 0])
    return max(math.dist(state[1:4], position) for state in states[:, -1])


flights, seconds = closed_loop.arguments()
closed_loop.report(fly, PERIOD_S, flights, seconds)
