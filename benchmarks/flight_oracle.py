"""The tube compared with reachable sets that ampyc computes as polytopes."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

import drake_rho as rho
from benchmarks.apart import run_apart, version
from benchmarks.error_loop import scenario_with, stable_gains
from benchmarks.tables import Cell, Goal, Table

CASES = 20

SAMPLES = (12, 4)
"""Number of flights without delay, and with one of one sample: a third dimension takes long."""

FLATTEST = 1e-5
"""Area or volume of a set at the end over that at the beginning: see `_LIMITATIONS`."""


class Case(NamedTuple):
    """Loop in the units of its samples and its wind, δ = W = 1."""

    alpha: float
    beta: float
    delay: int
    position_error: float
    velocity_error: float
    samples: int

    @property
    def tube(self) -> rho.ErrorTube:
        """Return the tube of this package."""
        around = rho.Disturbance(
            1.0, self.position_error, self.velocity_error, delay=self.delay, prediction=False
        )
        scenario = scenario_with(around, rho.Grid(1.0, self.samples + 1))
        return rho.error_tube(scenario, gains=(self.alpha, self.beta))


def run() -> Table:
    """Compute both for all cases.

    Raises:
        Skipped: there is no environment with ampyc.
    """
    rng = np.random.default_rng(0)
    cases = [draw(rng, number % 2) for number in range(CASES)]
    supports = np.array(_supports(cases))
    ends = [(case.tube, float(case.samples)) for case in cases]
    radii = np.array([[tube.position(end), tube.velocity(end)] for tube, end in ends])
    away = supports / radii - 1.0
    rows: list[tuple[Cell, ...]] = []
    for delay in (0, 1):
        these = away[[case.delay == delay for case in cases]]
        for name, parts in zip(("position", "velocity"), these.T, strict=True):
            rows.append((delay, name, len(parts), float(parts.min()), float(parts.max())))
    return Table(
        name="flight_oracle",
        title="The tube and ampyc's reachable sets",
        columns=("delay_samples", "quantity", "cases", "least_difference", "largest_difference"),
        rows=tuple(rows),
        notes=(f"ampyc {version('ampyc')}. {_ABOUT}", _LIMITATIONS),
        goals=(Goal("difference, relative", 0.01, float(np.abs(away).max())),),
    )


def draw(rng: np.random.Generator, delay: int) -> Case:
    """Draw stable gains that flatten no set too much, and errors of the estimate."""
    samples, flat = SAMPLES[delay], 0.0
    while flat < FLATTEST:
        alpha, beta = stable_gains(rng, delay)
        flat = abs((delay == 0) + alpha / 2.0 - beta) ** (samples - 1)
    position_error, velocity_error = map(float, rng.uniform(0.1, 1.5, 2))
    return Case(alpha, beta, delay, position_error, velocity_error, samples)


def _supports(cases: list[Case]) -> list[list[float]]:
    """Return the largest position and velocity at the end of each case, computed with ampyc."""
    with tempfile.TemporaryDirectory() as folder:
        given, found = Path(folder) / "cases.json", Path(folder) / "supports.json"
        given.write_text(json.dumps([case._asdict() for case in cases]), encoding="utf-8")
        run_apart("ampyc", "ampyc_sets.py", given, found)
        answer: list[list[float]] = json.loads(found.read_text(encoding="utf-8"))
    return answer


_ABOUT = """\
The computation is for one axis, as the error is a ball: ampyc adds up polytopes by Minkowski sums
(`compute_drs`), and the support of the last is the largest error at the end of the flight. Its
wind is constant in quarters of a sample, so the result can be slightly below the tube and never
above. Gains are drawn among the stable ones, errors of the estimate at random. Differences are
relative, ampyc less the tube. `tests/test_tube_oracle.py` compares more cases (delays of up to
five samples, feedback and initial errors) with supports computed backwards in time by matrix
exponentials: in 200 cases they are at most 1.1e-4 below, and never above."""

_LIMITATIONS = """\
Limitations. ampyc replaces a polytope thinner than 1e-7 by the line from its first vertex to the
one farthest away, which is only a part of it unless the first vertex is an end. A loop that takes
one error to zero almost at once (α = 1.63, β = 1.83) therefore came out 3 % too small in position
and 8 % in velocity, while the supports of the same polytopes, added up one by one, are those of
the tube. So gains with such thin sets are not drawn."""
