"""Flights with a controller, in other simulators: seconds of flight per second of processor time, on one processor."""

import functools
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


# Packages of each peer's environment: the first one gives the version.
PACKAGES = {
    "crazyflow": ["crazyflow==0.4.0"],
    "mujoco": ["mujoco==4.0.0"],
    "rotorpy": ["rotorpy==3.0.0"],
    "rotorpy-batched": ["rotorpy[batched]==3.0.0", "torch==2.15.0"],
}
# Peer, what flies, ticks per second, its environment and script; flights and seconds of each.
ROWS = [
    ("ironbird", "campaign, 1 kHz, RK4 in 4 steps, f64", 1000, None, ()),
    ("ironbird", "campaign, 500 Hz, RK4 in 4 steps, f64", 500, None, ()),
    ("Crazyflow", "batch, default: 500 Hz, Euler, f32", 500, "crazyflow", ("crazyflow_closed.py", 1000, 2, "default")),
    ("Crazyflow", "batch, equal work: 500 Hz, RK4 in 4 steps, f64", 500, "crazyflow", ("crazyflow_closed.py", 1000, 1, "equal")),
    ("MuJoCo", "rollout, RK4, f64, controller in C", 1000, "mujoco", ("mujoco_rollout.py", 50, 2)),
    ("MuJoCo", "RK4, f64, controller in Python", 1000, "mujoco", ("mujoco_closed.py", 5, 5)),
    ("RotorPy", "batch on torch, 500 Hz, RK4, f64", 500, "rotorpy-batched", ("rotorpy_batched.py", 1000, 0.1)),
    ("RotorPy", "RK45, f64", 1000, "rotorpy", ("rotorpy_closed.py", 1, 1)),
]


def install(rate_hz, environment, script):
    if environment is None:
        program = executable()
        return commit(), lambda: campaign(program, 1 / rate_hz)
    packages = PACKAGES[environment]
    command = [pip(environment, *packages), "-W", "ignore", SIMULATORS / script[0], *script[1:]]
    cache = {"JAX_COMPILATION_CACHE_DIR": str(PEERS / "jax"), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    return packages[0].split("==")[1], lambda: json.loads(call(command, cwd=PEERS, env={**os.environ, **cache}).splitlines()[-1])


def sides():
    bases = {rate_hz: f"{peer}, {what}" for peer, what, rate_hz, *_ in ROWS if peer == "ironbird"}
    return [Side(peer, what, functools.partial(install, *of), bases[of[0]]) for peer, what, *of in ROWS]


COLUMNS = [
    ("flight-seconds per second of processor time", figure("flight_s_per_cpu_s", ".4g")),
    ("over ironbird at that rate", times("flight_s_per_cpu_s", ".2g")),
    ("position error", lambda results, _: f"{results[-1]['position_error_m']:.3f} m" if "position_error_m" in results[-1] else "-"),
    STEAL,
]


def main(args):
    compare(args, "closed", sides(), COLUMNS)
