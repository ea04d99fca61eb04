"""What every peer needs: the common work, and the error of an end state."""

import json
import math
import sys

WARM_TICKS = 1000  # flown first and not timed: they find caches cold


def load(path):
    with open(path) as file:
        return json.load(file)


def argument(usage):
    """The arguments after the program's name; ends the program where there is another number of them."""
    if len(sys.argv) != len(usage.split()) + 1:
        sys.exit(f"usage: {sys.argv[0]} {usage}")
    return sys.argv[1:]


def errors(work, end):
    """Distance [m] and angle [rad] between an end state and the reference."""
    reference = work["reference"]["end"]
    (x, y, z, w), (a, b, c, d) = (unit(state["quaternion_wb_xyzw"]) for state in (end, reference))
    # The vector part of the quotient keeps its digits where the angle is tiny.
    vector = (d * x - w * a - y * c + z * b, d * y - w * b - z * a + x * c, d * z - w * c - x * b + y * a)
    return {
        "position_error_m": math.dist(end["position_w_m"], reference["position_w_m"]),
        "attitude_error_rad": 2.0 * math.atan2(math.hypot(*vector), abs(w * d + x * a + y * b + z * c)),
    }


def unit(quaternion):
    length = math.hypot(*quaternion)
    return [part / length for part in quaternion]


def report(work, wall_s, position, quaternion, **more):
    end = {"position_w_m": [float(x) for x in position], "quaternion_wb_xyzw": [float(x) for x in quaternion]}
    print(json.dumps({"wall_s": wall_s, **more, **end, **errors(work, end)}))
