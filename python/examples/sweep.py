"""Sweeps the mass over two outer laws: which one keeps its height when the vehicle grows heavier in flight?"""

import sys

import ironbird

MASSES_PERCENT = [-20, -10, 0, 10, 20, 30]


def sag_mm(law: str, percent: int) -> float:
    """How far below its reference the vehicle is in the last two seconds [mm]."""
    flight = ironbird.simulate("hover", 15, outer=law, faults=[f"mass_kg={percent:+d}%@5s"])
    below_m = flight.reference.position_w_m - flight.state.position_w_m
    return 1e3 * float(below_m[flight.t > 13, 2].mean())


sags = {law: [sag_mm(law, percent) for percent in MASSES_PERCENT] for law in ("pd", "estimating")}
try:
    import matplotlib.pyplot as plt
except ImportError:
    print("mass [%]".ljust(12), *(f"{percent:+8d}" for percent in MASSES_PERCENT))
    for law, values in sags.items():
        print(law.ljust(12), *(f"{value:8.1f}" for value in values), "mm below")
else:
    for law, values in sags.items():
        plt.plot(MASSES_PERCENT, values, marker="o", label=law)
    plt.xlabel("change of mass [%]")
    plt.ylabel("below its reference [mm]")
    plt.legend()
    plt.savefig(sys.argv[1] if len(sys.argv) > 1 else "sweep.svg")
