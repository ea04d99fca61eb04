"""From errors of position and velocity to thrust and attitude. Change `tick`."""

import numpy as np


class Law:
    """Thrust along the acceleration that the errors ask for."""

    role = "outer"
    name = "my_law"
    version = "1"
    settings = {
        "position_1_s2": {
            "default": 6.0, "min": 0.1, "max": 100.0, "unit": "1/s^2", "meaning": "acceleration per error of position",
        },
        "velocity_1_s": {
            "default": 4.0, "min": 0.1, "max": 100.0, "unit": "1/s", "meaning": "acceleration per error of velocity",
        },
    }
    telemetry = {"x_error_m": "m", "y_error_m": "m", "z_error_m": "m"}

    def __init__(self, rig, settings):
        self.mass, self.gravity = rig.airframe["mass_kg"], rig.airframe["gravity_m_s2"]
        self.drag = rig.airframe["translational_drag_kg_s"]
        self.most = 4 * rig.airframe["thrust_coefficient_n_s2"] * rig.rotor_max_rad_s**2
        self.position_1_s2, self.velocity_1_s = settings["position_1_s2"], settings["velocity_1_s"]
        if self.velocity_1_s**2 < self.position_1_s2:
            raise ValueError(
                f"velocity_1_s = {self.velocity_1_s} damps position_1_s2 = {self.position_1_s2} too little: "
                "allowed is its root or more"
            )

    def tick(self, tick, measured, reference):
        # Acceleration by thrust: what the reference asks, the errors, gravity and drag.
        error = reference.position_w_m - measured.position_w_m
        slower = reference.velocity_w_m_s - measured.velocity_w_m_s
        a = reference.acceleration_w_m_s2 + self.position_1_s2 * error + self.velocity_1_s * slower
        a = a + self.drag / self.mass * measured.velocity_w_m_s + np.array([0.0, 0.0, self.gravity])

        # Body z along it, at the yaw of the reference.
        sin, cos = np.sin(reference.yaw_rad), np.cos(reference.yaw_rad)
        ahead, left = cos * a[0] + sin * a[1], cos * a[1] - sin * a[0]
        attitude = np.array([np.arctan2(-left, np.hypot(ahead, a[2])), np.arctan2(ahead, a[2]), reference.yaw_rad])
        rate = np.array([0.0, 0.0, reference.yaw_rate_rad_s])
        acceleration = np.array([0.0, 0.0, reference.yaw_acceleration_rad_s2])
        return min(self.mass * np.sqrt(a @ a), self.most), attitude, rate, acceleration, error
