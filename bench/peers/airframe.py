"""The airframe alone, in other simulators: the time of the same 10 s open loop, and where each ends."""

import functools
import json
import os
import shutil

from common import errors, load
from rounds import ROOT
from sides import HERE, PEERS, STEAL, Side, call, cargo, commit, compare, figure, pip, qdldl, target, times

SIMULATORS = HERE / "simulators"

WORK = PEERS / "work.json"


def ironbird(steps):
    call(["cargo", "build", "--release", "--locked", "-p", "ironbird", "--example", "open_loop"], cwd=ROOT)
    program = target() / "release" / "examples" / "open_loop"
    WORK.write_text(call([program, "work"]))
    return commit(), [program, "fly", WORK, steps], 4 * steps


def rotorpy(_):
    python = pip("rotorpy", "rotorpy==3.0.0")
    return "3.0.0", [python, SIMULATORS / "rotorpy_airframe.py", WORK], None


def mujoco(steps):
    python = pip("mujoco", "mujoco==4.0.0")
    return "4.0.0", [python, SIMULATORS / "mujoco_airframe.py", WORK, steps], 4 * steps


def peng(steps):
    # A solver that peng_quad brings, and this flight does not call, is built with CMake.
    cmake = [] if shutil.which("cmake") else [str(pip("cmake", "cmake").parent)]
    path = os.pathsep.join([os.environ["PATH"], *cmake])
    pointer = qdldl(PEERS / "archives", "qdldl==0.1.9.post1")
    version, built = cargo(HERE / "peng" / "Cargo.toml", "peng_quad", PATH=path, CMAKE_TOOLCHAIN_FILE=str(pointer))
    return version, [built / "peng", WORK, steps], 4 * steps


def sides():
    def install(peer, steps):
        version, command, derivatives = peer(steps)
        return version, lambda: measure(command, derivatives)

    def measure(command, derivatives):
        work, flown = load(WORK), json.loads(call(command, cwd=PEERS))
        simulated_s = len(work["commands"]) * work["period_s"]
        return {"us_per_simulated_s": flown["wall_s"] / simulated_s * 1e6, **errors(work, flown),
                "derivatives": flown.get("evaluations_per_tick", derivatives)}

    rows = [("ironbird", ironbird, 1, "RK4, 1 step"), ("ironbird", ironbird, 4, "RK4, 4 steps"), ("MuJoCo", mujoco, 1, "RK4, 1 step"),
            ("MuJoCo", mujoco, 4, "RK4, 4 steps"), ("peng_quad", peng, 1, "RK4 in f32, 1 step"),
            ("peng_quad", peng, 4, "RK4 in f32, 4 steps"), ("RotorPy", rotorpy, 4, "RK45, adaptive, its tolerances")]
    bases = {steps: f"ironbird, {what}" for peer, _, steps, what in rows if peer == "ironbird"}
    return [Side(peer, what, functools.partial(install, of, steps), bases[steps]) for peer, of, steps, what in rows]


COLUMNS = [
    ("derivatives per tick", lambda results, _: f"{results[-1]['derivatives']:g}"),
    ("us per simulated s", figure("us_per_simulated_s", ".0f")),
    ("times ironbird's", times("us_per_simulated_s", ".1f")),
    ("end-state error", lambda results, _: f"{results[-1]['position_error_m']:.1e} m, {results[-1]['attitude_error_rad']:.1e} rad"),
    STEAL,
]


def main(args):
    compare(args, "airframe", sides(), COLUMNS)
