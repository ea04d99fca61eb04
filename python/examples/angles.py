"""An inner law in Python: proportional to the errors of angles and rates, with inertia and drag of the model."""

import numpy as np


class Law:
    """Proportional control of angles and body rates."""

    role = "inner"
    name = "angles"
    settings = {
        "attitude_1_s2": {"default": 100.0, "min": 0.0, "max": 1000.0, "unit": "1/s^2", "meaning": "gain of the angles"},
        "rate_1_s": {"default": 20.0, "min": 0.0, "max": 200.0, "unit": "1/s", "meaning": "gain of the body rates"},
    }
    telemetry = {"largest_error_rad": "rad"}

    def __init__(self, rig, settings):
        self.inertia_kg_m2 = np.array([rig.airframe[f"inertia_{axis}_kg_m2"] for axis in "xyz"])
        self.drag_nm_s = rig.airframe["rotational_drag_nm_s"]
        self.attitude_1_s2, self.rate_1_s = settings["attitude_1_s2"], settings["rate_1_s"]
        self.largest_rad = 0.0

    def tick(self, tick, measured, wanted, reference):
        error = wanted.attitude_rad - measured.attitude_rad
        self.largest_rad = max(self.largest_rad, np.abs(error).max())
        slip = wanted.attitude_rate_rad_s - measured.rate_b_rad_s
        torque = self.inertia_kg_m2 * (self.attitude_1_s2 * error + self.rate_1_s * slip)
        return wanted.thrust_n, torque + self.drag_nm_s * measured.rate_b_rad_s, [self.largest_rad]
