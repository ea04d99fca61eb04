"""Laws that do what no law should, and airframes that break."""

import subprocess

from rig import ROOT, demand, need

DIES = {"crash": "SIGSEGV", "overflow": "SIGSEGV", "abort": "SIGABRT", "exit": "it called exit()"}


def misbehaving(rig, how, from_tick):
    need("cc")
    library = rig.directory / "libmisbehaving.so"
    subprocess.run(["cc", "-std=c11", "-O2", "-fPIC", "-shared", "-I", ROOT / "shared/ironbird_law/include", "-o", library,
                    ROOT / "bench/rig/tests/laws_c/misbehaving.c", "-lm"], check=True)
    return rig.settings('[flight]\ntrajectory = "hover"\nground_z_m = -100.0\n[inner]\nlaw = "libmisbehaving.so"\n'
                        f'misbehave = "{how}"\nfrom_tick = {from_tick}\n')


def law_dies(make, n, how):
    """A law in C that ends its process: it is named with the tick; the others land."""
    for _ in range(n):
        with make() as rig:
            config = misbehaving(rig, how, 300)
            flight = rig.start("fly", "--rt", "off", "--config", config, "--duration", "900ms")
            ended = flight.end().expect(1).says(DIES[how]).says("failed in tick")
            demand(ended.result()["status"] == "ABORTED", "not ABORTED")
            rig.demand_nothing_left()
            yield {}


def law_hangs(make, n):
    """A law that computes without an end: its process is killed and started again, until limit or envelope end the flight."""
    for _ in range(n):
        with make() as rig:
            config = misbehaving(rig, "loop", 300)
            flight = rig.start("fly", "--rt", "off", "--on-death", "restart", "--config", config, "--duration", "20s")
            flight.end().expect(1, 3).says("hung, and was killed; it is started again")
            deaths = rig.report()["deaths"]
            demand(deaths and deaths[0]["noticed_after_ms"] is not None, f"{deaths}")
            demand(rig.report()["run"]["ending"] != "completed", "the flight completed with a law that never answers")
            rig.demand_nothing_left()
            yield {"ms noticed": round(deaths[0]["noticed_after_ms"], 1)}


def law_is_wrong(make, n):
    """A law that answers NaN: never sent on, counted, and the flight is flown on what is safe."""
    for _ in range(n):
        with make() as rig:
            config = misbehaving(rig, "nan", 300)
            rig.start("fly", "--pace", "lockstep", "--config", config, "--duration", "900ms").end().expect(0, 3)
            said = rig.report()["run"]["laws"]["inner"]["ticks_not_finite"]
            demand(said == 601, f"{said} ticks counted, not 601")
            refused = sum(sum(role["rejected"].values()) for role in rig.report()["roles"].values())
            demand(refused == 0, f"{refused} messages refused: something was sent on")
            rig.demand_nothing_left()
            yield {}


def law_is_slow(make, n):
    """A law that computes for 2.4 ms in each tick of 1 ms: ticks are skipped and counted, and the flight goes on."""
    for _ in range(n):
        with make() as rig:
            config = misbehaving(rig, "slow", 300)
            flight = rig.start("fly", "--rt", "off", "--config", config, "--duration", "1500ms")
            flight.end().expect(0, 1, 3)
            report = rig.report()
            late = report["roles"]["inner"]["ticks_skipped"]
            demand(late > 100, f"inner skipped {late} ticks")
            rig.demand_nothing_left()
            yield {"ticks skipped": late}


def tilted(make, n):
    """A rotor that gives a tenth of its thrust: the airframe tilts beyond its limit, and the flight ends and says so."""
    for _ in range(n):
        with make() as rig:
            limit = rig.settings("[flight]\nposition_error_max_m = 1000.0\ntilt_max_rad = 0.5\n")
            fault = ("--fault", "rotor_efficiency_1=0.1@1s", "--trajectory", "hover", "--pace", "lockstep")
            rig.start("fly", "--config", limit, *fault, "--duration", "5s").end().expect(3)
            ending = rig.report()["run"]["ending"]
            demand(ending == "left the envelope: tilt beyond its limit", ending)
            rig.demand_nothing_left()
            yield {}


def worn(make, n):
    """Rotors that lose a fifth of their thrust, one after the other: the flight holds its height and place."""
    for i in range(n):
        with make() as rig:
            fault = ("--fault", f"rotor_efficiency_{i % 4 + 1}=0.8@1s", "--outer", "estimating")
            rig.end_completed(rig.start("fly", *fault, "--pace", "lockstep", "--trajectory", "hover", "--duration", "8s"))
            rig.demand_replay()
            rig.demand_nothing_left()
            yield {}


ROWS = [
    *({"name": f"law.{how}", "fault": f"a law {words}", "injector": law_dies, "arguments": {"how": how},
       "expected": "ABORTED, law and tick named; others end", "n": 5, "short": int(how == "crash")}
      for how, words in {"crash": "reads invalid memory", "overflow": "recurses without end",
                         "abort": "aborts (a panic)", "exit": "calls exit()"}.items()),
    {"name": "law.loop", "fault": "a law loops forever", "injector": law_hangs,
     "expected": "killed and restarted each time; the flight ends with the reason", "n": 3,
     "guards": ("heartbeat",)},
    {"name": "law.nan", "fault": "a law returns NaN", "injector": law_is_wrong,
     "expected": "replaced and counted each tick; never sent", "n": 5},
    {"name": "law.slow", "fault": "a law computes for 2.4 ms per 1 ms", "injector": law_is_slow,
     "expected": "ticks skipped and counted; no hang", "n": 5},
    {"name": "airframe.tilted", "fault": "a rotor with a tenth of its thrust", "injector": tilted,
     "expected": "the flight ends and names the envelope limit", "n": 5, "guards": ("envelope",)},
    {"name": "airframe.worn", "fault": "a rotor with four fifths of its thrust", "injector": worn,
     "expected": "completed; replay identical", "n": 8, "short": 1},
]
