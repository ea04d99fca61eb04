"""How the drill counts: tries again, flights that stand for several trials, what cannot be tried, what grows."""

import importlib.machinery
import importlib.util
import sys
import unittest
from pathlib import Path
from unittest import mock

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
sys.dont_write_bytecode = True

import page  # noqa: E402
import soak  # noqa: E402
from rig import Broken, NotHere, Rig, Wrong  # noqa: E402
from rows import Row  # noqa: E402

LOADER = importlib.machinery.SourceFileLoader("drill_run", str(HERE / "run"))
RUN = importlib.util.module_from_spec(importlib.util.spec_from_loader("drill_run", LOADER))
LOADER.exec_module(RUN)


def row_of(*outcomes, trials=1):
    """A row whose flights come out so, one after the other: None is as expected."""
    left = list(outcomes)

    def injector(make, n):
        while n > 0:
            with make(trials=trials):
                outcome = left.pop(0)
                if outcome:
                    raise outcome
            yield from ({} for _ in range(trials))
            n -= trials
    return Row("row", "fault", injector, "expected", 1)


def fly(n, *outcomes, **options):
    result = RUN.fly(row_of(*outcomes, **options), n, RUN.maker(Path("/bin/true")))
    return [result[key] for key in ("tried", "survived", "flights_lost", "passed")]


class Counting(unittest.TestCase):
    def test_a_flight_that_failed_once_is_flown_again_and_both_are_counted(self):
        self.assertEqual(fly(2, None, Wrong("late"), None), [3, 2, 1, True])
        self.assertEqual(fly(1, Wrong("late"), Wrong("late")), [2, 0, 2, False])
        self.assertEqual(fly(3, Wrong("late"), None, Wrong("late"), None), [4, 2, 2, False])

    def test_what_no_busy_machine_explains_is_not_flown_again(self):
        self.assertEqual(fly(1, Broken("left: a segment")), [1, 0, 1, False])

    def test_a_flight_that_fails_costs_all_of_its_trials(self):
        self.assertEqual(fly(8, Wrong("fell"), None, trials=8), [16, 8, 1, True])
        self.assertEqual(fly(8, Broken("left"), trials=8), [8, 0, 1, False])

    def test_what_cannot_be_tried_is_told_as_such(self):
        result = RUN.fly(row_of(NotHere("there is no strace")), 1, RUN.maker(Path("/bin/true")))
        self.assertEqual((result["tried"], result["lack"]), (0, "there is no strace"))
        self.assertIn("NOT TRIED: there is no strace", RUN.said_of(row_of(), result))

    def test_a_flight_thrown_out_of_the_air_is_not_completed(self):
        with Rig("/bin/true") as rig, mock.patch.object(rig, "report", lambda: {"run": {"ending": "left the envelope"}}):
            with self.assertRaisesRegex(Wrong, "did not complete: left the envelope"):
                rig.end_completed(rig.start("clean"))

    def test_a_gap_is_borne_where_a_sender_died_and_nowhere_else(self):
        said = "error: the log has a gap: at tick 12 the `setpoint` of tick 12 was used, which is not in it"
        death = {"role": "outer", "tick": 11, "ticks_lost": 50}
        for deaths, borne in (([death], True), ([], False), ([{**death, "role": "inner"}], False),
                              ([{**death, "tick": 12}], False), ([{**death, "ticks_lost": 0}], False)):
            with Rig("/bin/true") as rig:
                ended = rig.launch(["sh", "-c", f"echo '{said}' >&2; exit 1"]).end()
                with mock.patch.object(rig, "run", lambda *_, ended=ended: ended):
                    if borne:
                        self.assertEqual(rig.replay_or_gap(deaths), 1)
                    else:
                        self.assertRaises(Broken, rig.replay_or_gap, deaths)

    def test_the_interval_is_that_of_flights_where_trials_share_them(self):
        row = {"name": "n", "fault": "f", "injector": "i", "expected": "e", "tried": 8, "survived": 8, "flights": 1,
               "flights_lost": 0, "trial": "death", "shares_flights": True, "why": "", "lack": "", "figures": {}, "build": "A",
               "executable": "1", "date": "2026-01-01"}
        self.assertIn("| 8 deaths, 1 flight | 8 | 20.65 |", page.line([row], {}))
        self.assertIn("| 8 | 8 | 67.55 |", page.line([{**row, "trial": "flight", "shares_flights": False}], {}))

    def test_a_row_says_of_which_build_it_is_where_there_are_several(self):
        row = {"name": "n", "fault": "f", "injector": "i", "expected": "e", "tried": 8, "survived": 8, "flights": 8,
               "flights_lost": 0, "trial": "flight", "shares_flights": False, "why": "", "lack": "", "figures": {},
               "build": "A", "executable": "1", "date": "2026-01-01"}
        other = {**row, "name": "m", "build": "B"}
        alone, both = page.builds([row, row]), page.builds([row, other])
        self.assertIn("| `n` |", page.line([row], alone))
        self.assertEqual(page.told_of_builds([row, row], alone), "All rows with one build, `A` on 2026-01-01")
        self.assertIn("| `n` (a) |", page.line([row], both))
        self.assertIn("| `m` (b) |", page.line([other], both))
        self.assertEqual(page.alike([row, {**row, "name": "o", "fault": "g"}, other], both),
                         [[row, {**row, "name": "o", "fault": "g"}], [other]])
        self.assertEqual(page.merged(["SIGTERM to outer", "SIGTERM to inner"]), "SIGTERM to outer, inner")
        self.assertEqual(page.merged(["a link in place", "a pipe in place", "a link in place"]), "a link, pipe in place")
        self.assertEqual(page.merged(["all killed"]), "all killed")
        self.assertIn("| `n`, `o` | f, g |", page.line([row, {**row, "name": "o", "fault": "g"}], alone))
        self.assertIn("1 rows (a) with `A` on 2026-01-01, 1 rows (b) with `B`", page.told_of_builds([row, other], both))

    def test_a_dead_process_of_a_soak_that_is_not_back_is_wrong_and_a_silent_successor_is_within_a_death(self):
        back = {"back_after_ms": 90.0, "ticks_lost": 89, "within": None}
        away, silent = {**back, "back_after_ms": None}, {"back_after_ms": None, "ticks_lost": None, "within": 7}
        self.assertEqual(soak.told_of([back, silent]), {"deaths": 2, "silent": 1, "away": 0, "lost": [89]})
        self.assertEqual(soak.told_of([away, silent])["away"], 1)
        looks = [(10.0 * i, {what: 100 for what in soak.GROWTH_MOST}) for i in range(90)]
        for deaths, wrong in (([back, silent], []), ([away, back], ["soak flight 1: 1 of 2 dead processes are not back"])):
            def flown(make, total_s, draw, told, its=deaths):
                told["looks"] += looks
                told.update(soak.told_of(its))
            with mock.patch.object(soak, "flight", flown), mock.patch.object(soak.os, "nice"), mock.patch("builtins.print"):
                self.assertEqual(soak.soak(None, "a build", "800s")["failed"], wrong)

    def test_what_grows_in_a_soak_is_judged(self):
        still = {what: 100 for what in soak.GROWTH_MOST}
        # A step is no growth in every round; what rises with each fault is.
        looks = [(10.0 * i, {**still, "descriptors": 100 + 2 * i, "segments": 103 if i > 60 else 100}) for i in range(90)]
        growth = soak.grown(looks)
        self.assertEqual(growth["descriptors"], (108, 108))
        self.assertEqual(growth["segments"], (0, 3))
        for what, words in (("descriptors", "descriptors grew by 108 in every round, together; 8 are allowed"),
                            ("threads", "threads grew by 7 in all; 2 are allowed")):
            flown_looks = [(at, {**still, what: seen[what] if what == "descriptors" else 100 + 7 * (at > 700)}) for at, seen in looks]

            def flown(make, total_s, draw, told, its=flown_looks):
                told["looks"] += its
            with mock.patch.object(soak, "flight", flown), mock.patch.object(soak.os, "nice"), mock.patch("builtins.print"):
                failed = soak.soak(None, "a build", "800s")["failed"]
            self.assertEqual(len(failed), 1, failed)
            self.assertIn(words, failed[0])


if __name__ == "__main__":
    unittest.main()
