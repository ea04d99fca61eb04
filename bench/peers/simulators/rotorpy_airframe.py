"""RotorPy flies the common work: its Multirotor without aerodynamics, its default integrator, one `step` per tick."""

import importlib.metadata
import time

import numpy as np
from rotorpy.vehicles.multirotor import Multirotor

import common

(path,) = common.argument("WORK.json")
work = common.load(path)
c = work["arm_length_m"] / np.sqrt(2.0)
i_x, i_y, i_z = work["inertia_kg_m2"]
AIRFRAME = {
    "mass": work["mass_kg"],
    **{"Ixx": i_x, "Iyy": i_y, "Izz": i_z, "Ixy": 0.0, "Ixz": 0.0, "Iyz": 0.0},
    "num_rotors": 4,
    # Rear left, rear right, front right, front left; x forward, y left.
    "rotor_pos": {f"r{i}": np.array(r) for i, r in enumerate([(-c, c, 0), (-c, -c, 0), (c, -c, 0), (c, c, 0)], 1)},
    "rotor_directions": np.array([1, -1, 1, -1]),
    "rotor_speed_min": 0.0,
    "rotor_speed_max": 1e4,
    "k_eta": work["thrust_coefficient_n_s2"],
    "k_m": work["drag_factor_nm_s2"],
    # Has no effect: every tick begins with its rotors at the speed that is commanded.
    "tau_m": 0.005,
}


def vehicle():
    made = Multirotor(AIRFRAME, aero=False)
    # RotorPy's own is 9.81 and no argument.
    made.weight = np.array([0.0, 0.0, -work["mass_kg"] * work["gravity_m_s2"]])
    return made


def fly(craft, speeds):
    state = {"x": np.zeros(3), "v": np.zeros(3), "q": np.array([0.0, 0.0, 0.0, 1.0]), "w": np.zeros(3), "wind": np.zeros(3)}
    for speed in speeds:
        state["rotor_speeds"] = speed
        state = craft.step(state, {"cmd_motor_speeds": speed}, work["period_s"])
    return state


class Counting(Multirotor):
    """Counts how often the derivative is evaluated."""

    evaluations = 0

    def _s_dot_fn(self, *arguments):
        self.evaluations += 1
        return super()._s_dot_fn(*arguments)


speeds = np.array([command["speed_rad_s"] for command in work["commands"]])
warm = speeds[: common.WARM_TICKS]
counting = Counting(AIRFRAME, aero=False)
counting.weight = vehicle().weight
fly(counting, warm)

craft = vehicle()
begin = time.perf_counter()
end = fly(craft, speeds)
wall_s = time.perf_counter() - begin
common.report(
    work,
    wall_s,
    end["x"],
    end["q"],
    version=importlib.metadata.version("rotorpy"),
    evaluations_per_tick=counting.evaluations / len(warm),
)
