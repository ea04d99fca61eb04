"""The curve of degree 9 through points, by exact fractions: writes exact.json beside it.

It takes no part of the Rust solution: all coefficients are unknown, and every condition is a row of one dense system.
"""

import json
from fractions import Fraction
from math import perm
from pathlib import Path

DEGREE = 9
CASES = [
    [("0", "0"), ("1", "1")],
    [("0", "0"), ("1", "1"), ("2", "-1"), ("3", "2"), ("4", "0")],
    [("0", "1.5"), ("0.5", "1.25"), ("2", "-2"), ("2.25", "-1.5"), ("6", "3")],
]


def powers(u: Fraction, order: int) -> list[Fraction]:
    return [perm(n, order) * u ** (n - order) if n >= order else Fraction(0) for n in range(DEGREE + 1)]


def solve(rows: list[list[Fraction]]) -> list[Fraction]:
    """Gauss and Jordan; the last column is the right side."""
    for i in range(len(rows)):
        pivot = next(k for k in range(i, len(rows)) if rows[k][i] != 0)
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for k, row in enumerate(rows):
            if k != i and row[i] != 0:
                rows[k] = [value - row[i] * of for value, of in zip(row, rows[i])]
    return [row[-1] for row in rows]


def curve(points: list[tuple[Fraction, Fraction]]) -> list[list[Fraction]]:
    count, width = len(points) - 1, DEGREE + 1
    rows = []

    def condition(right: Fraction, *terms: tuple[int, Fraction, int, int]) -> None:
        row = [Fraction(0)] * (count * width + 1)
        row[-1] = right
        for segment, u, order, sign in terms:
            for n, value in enumerate(powers(u, order)):
                row[segment * width + n] += sign * value
        rows.append(row)

    for i in range(count):
        length = points[i + 1][0] - points[i][0]
        condition(points[i][1], (i, Fraction(0), 0, 1))
        condition(points[i + 1][1], (i, length, 0, 1))
        for order in range(1, 9) if i + 1 < count else ():
            condition(Fraction(0), (i, length, order, 1), (i + 1, Fraction(0), order, -1))
    for order in range(1, 5):
        condition(Fraction(0), (0, Fraction(0), order, 1))
        condition(Fraction(0), (count - 1, points[-1][0] - points[-2][0], order, 1))
    solution = solve(rows)
    return [solution[i * width : (i + 1) * width] for i in range(count)]


def main() -> None:
    cases = []
    for texts in CASES:
        points = [(Fraction(t), Fraction(value)) for t, value in texts]
        segments = curve(points)
        samples = []
        for i, coefficients in enumerate(segments):
            for share in (0, Fraction(1, 3), Fraction(3, 4)):
                u = share * (points[i + 1][0] - points[i][0])
                derivatives = [sum(c * p for c, p in zip(coefficients, powers(u, order))) for order in range(5)]
                samples.append([float(points[i][0] + u), *map(float, derivatives)])
        cases.append({"points": [[float(t), float(v)] for t, v in points], "samples": samples})
    Path(__file__).with_name("exact.json").write_text(json.dumps(cases, indent=1) + "\n")


main()
