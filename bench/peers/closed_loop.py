"""Closed loops of the peers: a quadrotor of their own along one curve, a controller's answer every millisecond."""

import json
import math
import time

import common

PERIOD_S = 1e-3
# Amplitude [m] and angular frequency [rad/s] along x and y, and the height [m].
X, Y, HEIGHT_M = (2.0, 0.5), (1.0, 1.0), 1.5


def arguments():
    """Flights, and ticks of each."""
    flights, seconds = common.argument("FLIGHTS SECONDS")
    return int(flights), round(float(seconds) / PERIOD_S)


def reference(t):
    """Position, velocity and acceleration of the curve."""
    position, velocity, acceleration = [], [], []
    for amplitude, frequency in (X, Y):
        sine, cosine = math.sin(frequency * t), math.cos(frequency * t)
        position.append(amplitude * sine)
        velocity.append(amplitude * frequency * cosine)
        acceleration.append(-amplitude * frequency * frequency * sine)
    return [*position, HEIGHT_M], [*velocity, 0.0], [*acceleration, 0.0]


def report(fly, version):
    """Flies one flight that is not timed, then all that are asked for; `fly(ticks)` gives its largest error [m]."""
    flights, ticks = arguments()
    fly(min(ticks, common.WARM_TICKS))
    begin = time.perf_counter()
    largest = max(fly(ticks) for _ in range(flights))
    wall_s = time.perf_counter() - begin
    print(json.dumps({"flights": flights, "wall_s": wall_s, "position_error_max_m": largest, "version": version}))
