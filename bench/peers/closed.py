"""Flights with a controller, in other simulators: seconds of flight per second of processor time, on one processor."""

import json
import os
import tempfile

from rounds import cpu_seconds, executable
from sides import HERE, PEERS, STEAL, Absent, Side, call, commit, compare, figure, pip, times

SIMULATORS = HERE / "simulators"
# Flights of the campaign, and the length of each [s].
FLIGHTS, FLIGHT_S = 200, 5.0
CAMPAIGN = """[campaign]
name = "closed-loop"
flights = {flights}
[flight]
duration_s = {flight_s}
period_s = {period_s}
trajectory = "lissajous"
[inner]
law = "geometric"
[factors]
"plant.inertia_x_kg_m2" = {{ uniform = [0.006, 0.008] }}
"""


def campaign(program, period_s):
    """Seconds of flight per second of processor time, from the start of the process to its end."""
    with tempfile.TemporaryDirectory(dir=PEERS) as rows:
        file = os.path.join(rows, "campaign.toml")
        with open(file, "w") as text:
            text.write(CAMPAIGN.format(flights=FLIGHTS, flight_s=FLIGHT_S, period_s=period_s))
        cpu_s, said = cpu_seconds([program, "campaign", "run", file, "--jobs", "1", "--out", os.path.join(rows, "out")])
    if f"flown={FLIGHTS} " not in said:
        raise Absent(said.strip())
    return {"flight_s_per_cpu_s": FLIGHTS * FLIGHT_S / cpu_s}


def ironbird(period_s):
    program = executable()
    return commit(), lambda: campaign(program, period_s)


def script(environment, packages, name, *arguments):
    """A script of a peer, which prints the same figure."""
    python = pip(environment, *packages)
    version = packages[0].split("==")[1]
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(PEERS / "jax"), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    return version, lambda: json.loads(call([python, "-W", "ignore", SIMULATORS / name, *arguments], env=environment).splitlines()[-1])


# Peer, what flies, how it is installed, ticks per second.
ROWS = [
    ("ironbird", "campaign, 1 kHz, RK4 in 4 steps, f64", lambda: ironbird(0.001), 1000),
    ("ironbird", "campaign, 500 Hz, RK4 in 4 steps, f64", lambda: ironbird(0.002), 500),
    ("Crazyflow", "1000 at once, its default: 500 Hz, Euler, f32", lambda: script("crazyflow", ["crazyflow==0.4.0"], "crazyflow_closed.py", 1000, 5, "default"), 500),
    ("Crazyflow", "1000 at once, equal work: 500 Hz, RK4 in 4 steps, f64", lambda: script("crazyflow", ["crazyflow==0.4.0"], "crazyflow_closed.py", 1000, 1, "equal"), 500),
    ("MuJoCo", "rollout, RK4, f64, a geometric PD in C", lambda: script("python", ["mujoco==4.0.0"], "mujoco_rollout.py", 50, 2), 1000),
    ("MuJoCo", "RK4, f64, a geometric PD in Python", lambda: script("python", ["mujoco==4.0.0"], "mujoco_closed.py", 5, 5), 1000),
    ("RotorPy", "1000 at once (torch), 500 Hz, RK4, f64", lambda: script("rotorpy-batched", ["rotorpy[batched]==3.0.0", "torch==2.15.0"], "rotorpy_batched.py", 1000, 0.1), 500),
    ("RotorPy", "its Hummingbird and SE3Control, RK45, f64", lambda: script("python", ["rotorpy==3.0.0"], "rotorpy_closed.py", 1, 1), 1000),
]


def sides():
    bases = {rate: f"{peer}, {what}" for peer, what, _, rate in ROWS if peer == "ironbird"}
    return [Side(peer, what, install, bases[rate]) for peer, what, install, rate in ROWS]


COLUMNS = [
    ("flight-seconds per second of processor time", figure("flight_s_per_cpu_s", 1)),
    ("over ironbird at that rate", times("flight_s_per_cpu_s", 4)),
    ("position error", lambda results, _: f"{max(it['position_error_m'] for it in results):.3f} m" if "position_error_m" in results[0] else "-"),
    STEAL,
]


def main(args):
    compare(args, "closed", sides(), COLUMNS)
