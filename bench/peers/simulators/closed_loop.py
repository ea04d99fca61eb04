"""Closed loops of the peers: a quadrotor of their own along one curve, and a controller that answers in every tick."""

import json
import math
import time

import common

# Amplitude [m] and angular frequency [rad/s] along x and y, and the height [m].
X, Y, HEIGHT_M = (2.0, 0.5), (1.0, 1.0), 1.5


def reference(t):
    """Position, velocity and acceleration of the curve."""
    position, velocity, acceleration = [], [], []
    for amplitude, frequency in (X, Y):
        sine, cosine = math.sin(frequency * t), math.cos(frequency * t)
        position.append(amplitude * sine)
        velocity.append(amplitude * frequency * cosine)
        acceleration.append(-amplitude * frequency * frequency * sine)
    return [*position, HEIGHT_M], [*velocity, 0.0], [*acceleration, 0.0]


def one_by_one(fly):
    """Flies single flights in turn; `fly(ticks)` gives the largest distance to the curve [m]."""
    return lambda flights, ticks: max(fly(ticks) for _ in range(flights))


def report(fly, period_s, flights, seconds, warm_flights=1):
    """`fly(flights, ticks)` gives a distance to the curve [m]. A tenth is flown first and not counted."""
    ticks = round(seconds / period_s)
    fly(warm_flights, ticks // 10)
    begin = time.process_time()
    distance_m = fly(flights, ticks)
    cpu_s = time.process_time() - begin
    print(json.dumps({"flight_s_per_cpu_s": flights * seconds / cpu_s, "position_error_m": distance_m}))


def arguments(usage="FLIGHTS SECONDS"):
    flights, seconds, *more = common.argument(usage)
    return int(flights), float(seconds), *more
