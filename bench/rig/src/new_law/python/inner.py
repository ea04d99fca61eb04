"""A cascade from attitude to body rates to torque. Change `tick`."""

import numpy as np


class Law:
    """Attitude to rates to torque, with proportional gains."""

    role = "inner"
    name = "my_law"
    version = "1"
    settings = {
        "attitude_1_s": {
            "default": 12.0, "min": 0.1, "max": 100.0, "unit": "1/s", "meaning": "rate per error of attitude",
        },
        "rate_1_s": {
            "default": 60.0, "min": 0.1, "max": 500.0, "unit": "1/s", "meaning": "acceleration per error of rate",
        },
    }
    telemetry = {"roll_error_rad": "rad", "pitch_error_rad": "rad", "yaw_error_rad": "rad"}

    def __init__(self, rig, settings):
        self.inertia = np.array([rig.airframe[f"inertia_{axis}_kg_m2"] for axis in "xyz"])
        self.attitude_1_s, self.rate_1_s = settings["attitude_1_s"], settings["rate_1_s"]
        if 2 * self.attitude_1_s > self.rate_1_s:
            raise ValueError(
                f"attitude_1_s = {self.attitude_1_s} is too quick for rate_1_s = {self.rate_1_s}: "
                "allowed is up to half of it"
            )

    def tick(self, tick, measured, wanted, reference):
        # Rates of roll, pitch, yaw that reduce the attitude's error, and the body rates p, q, r that they are.
        error = wanted.attitude_rad - measured.attitude_rad
        roll, pitch, yaw = wanted.attitude_rate_rad_s + self.attitude_1_s * error
        sin_roll, sin_pitch, _ = np.sin(measured.attitude_rad)
        cos_roll, cos_pitch, _ = np.cos(measured.attitude_rad)
        rate_wanted = np.array([
            roll - sin_pitch * yaw,
            cos_roll * pitch + sin_roll * cos_pitch * yaw,
            -sin_roll * pitch + cos_roll * cos_pitch * yaw,
        ])

        # Euler's equation of the rigid body gives the torque.
        rate = measured.rate_b_rad_s
        acceleration = self.rate_1_s * (rate_wanted - rate) + wanted.attitude_acceleration_rad_s2
        torque = self.inertia * acceleration + np.cross(rate, self.inertia * rate)
        return wanted.thrust_n, torque, error
