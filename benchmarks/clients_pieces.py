"""Random polynomial pieces judged by the referee, beside dense samples."""

from __future__ import annotations

import time

import numpy as np

import drake_rho as rho
from benchmarks.all_cores import on_all_cores
from benchmarks.tables import Goal, Table
from tests.test_referee import DENSE, drake, field, random_pieces, wrong

RATE = 1000.0
"""Least number of pieces a second."""

BATCH = 1000
"""Pieces of a batch, judged in one process."""


def run(pieces: int) -> Table:
    """Judge as many pieces, and compare every check with dense samples of every piece."""
    began = time.monotonic()
    found = on_all_cores(_batch, range(-(-pieces // BATCH)), "pieces", at_once=1)
    count, checks = sum(each[0] for each in found), sum(each[3] for each in found)
    bad = [each for batch in found for each in batch[2]]
    rates = np.array([each[0] / each[1] for each in found])
    median = float(np.median(rates))
    return Table(
        name="clients_pieces",
        title="Polynomials of any planner, judged",
        columns=("pieces", "checks", "wrong", "pieces a second, median", "least"),
        rows=((count, checks, len(bad), median, float(rates.min())),),
        notes=(f"{_WORK} It took {(time.monotonic() - began) / 60:.0f} minutes.", *bad[:20]),
        goals=(
            Goal("checks that a sample exceeds, or that no sample is near", 0, len(bad)),
            Goal("processor time of 1000 pieces, median [s]", 1000.0 / RATE, 1000.0 / median),
        ),
    )


_WORK = f"""\
One to five vehicles with one to 60 pieces each of degree 0 to 7 that do not join, judged for boxes,
norms, two obstacles at rest and one in motion, a separation with downwash and two requirements.
Wrong is a check that one of {DENSE} samples of each piece exceeds by more than 0.02 of its
tolerance, or to whose value no sample comes near. The rate is that of `rho.verify`, in
processor time of one core."""


def _batch(seed: int) -> tuple[int, float, list[str], int]:
    """Return pieces, processor seconds, wrong checks and the number of checks of a batch."""
    rng, pieces, seconds, bad, checks = np.random.default_rng([50, seed]), 0, 0.0, list[str](), 0
    while pieces < BATCH:
        vehicles, count = int(rng.integers(1, 6)), int(rng.integers(1, 60))
        instants, c = random_pieces(rng, vehicles, count)
        scenario = field(vehicles, float(instants[-1]))
        named = {f"v{n}": drake(instants, each) for n, each in enumerate(c)}
        trajectories = rho.Trajectories.of(named)
        began = time.process_time()
        report = rho.verify(trajectories, scenario)
        seconds += time.process_time() - began
        checks += len(report.checks)
        bad += wrong(scenario, instants, c)
        pieces += vehicles * count
    return pieces, seconds, bad, checks
