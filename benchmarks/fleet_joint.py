"""Joint SCP, the published way to plan a fleet, in the same run as this package's."""

from __future__ import annotations

import dataclasses
import math
import statistics
from collections.abc import Callable, Sequence

from rich.progress import track

import drake_rho as rho
from benchmarks.fleet_b1 import scenario
from benchmarks.fleets import THIS_PACKAGE
from benchmarks.peers import joint_scp_cvxpy
from benchmarks.stopwatch import Stopwatch, Taken, median
from benchmarks.tables import Cell, Goal, Table

VEHICLES = (4, 8, 12)
"""Sizes; joint SCP takes minutes for a fleet of twenty vehicles."""

JOINT, KNOTS = "joint SCP, CVXPY + Clarabel", f"{THIS_PACKAGE}, at the knots"

COLUMNS = (
    "vehicles",
    "method",
    "fleets",
    "success_percent",
    "median_processor_s",
    "median_wall_s",
    "worst_processor_s",
    "median_part_of_joint_processor",
    "median_index_above_joint_percent",
    "worst_index_above_joint_percent",
)


@dataclasses.dataclass(frozen=True)
class Lap:
    """One fleet by one method."""

    taken: Taken
    """time from the scenario record to the verified plan, or to the failure"""
    index: float
    """f (13) [m²/s⁴]; NaN without a plan that satisfies the constraints"""
    fault: str = ""
    """reason for having none"""


def run(seeds: int = 5) -> Table:
    """Plan the first `seeds` fleets of each size in three ways."""
    methods: dict[str, Callable[[rho.Scenario], rho.Plan]] = {
        THIS_PACKAGE: rho.plan_scp,
        KNOTS: _at_knots,
        JOINT: _jointly,
    }
    for first in methods.values():  # loading and set-up do not count
        first(scenario(VEHICLES[0], 0))
    found: dict[tuple[int, str], list[Lap]] = {}
    for count, seed in track([(N, seed) for N in VEHICLES for seed in range(seeds)], "fleets"):
        for method, plan in methods.items():
            found.setdefault((count, method), []).append(_lap(scenario(count, seed), plan))
    rows = [_row(*key, laps, found[key[0], JOINT]) for key, laps in found.items()]
    last = VEHICLES[-1]
    ours, knots, joint = (found[last, each] for each in (THIS_PACKAGE, KNOTS, JOINT))
    return Table(
        name="fleet_joint",
        title="The published method, joint SCP, on the same fleets",
        columns=COLUMNS,
        rows=tuple(rows),
        notes=(_faults(found), _WORK, _LIMITATIONS),
        goals=(
            Goal(f"{last} vehicles, time / joint SCP, median", 1 / 50, _times(ours, joint)),
            Goal(
                f"{last} vehicles, index above joint SCP's, worst [%]",
                0.5,
                _above(ours, joint, max),
            ),
            Goal("the same at the knots: time", 1 / 50, _times(knots, joint)),
            Goal("the same at the knots: index [%]", 0.5, _above(knots, joint, max)),
        ),
        packages=("drake-rho", "drake", "numpy", "scipy", "cvxpy", "clarabel"),
    )


def _at_knots(scenario: rho.Scenario) -> rho.Plan:
    return rho.plan_scp(dataclasses.replace(scenario, between_knots=False))


def _jointly(scenario: rho.Scenario) -> rho.Plan:
    answer = joint_scp_cvxpy.solve(scenario)
    if not answer.converged:
        raise RuntimeError(f"not converged after {answer.programs} programs")
    at_knots = dataclasses.replace(scenario, between_knots=False)
    return rho.Plan.from_accelerations(at_knots, answer.accelerations)


def _lap(scenario: rho.Scenario, plan: Callable[[rho.Scenario], rho.Plan]) -> Lap:
    watch = Stopwatch()
    try:
        found = plan(scenario)
        report = rho.verify(found)
    except (RuntimeError, rho.DrakeRhoError) as error:
        return Lap(watch.taken(), math.nan, str(error).splitlines()[0])
    taken = watch.taken()
    if not report.ok:
        return Lap(taken, math.nan, f"{len(report.violations)} constraints violated")
    return Lap(taken, found.cost)


def _faults(found: dict[tuple[int, str], list[Lap]]) -> str:
    lines = [
        f"- {method}, {count} vehicles, seed {seed}: {lap.fault}"
        for (count, method), laps in found.items()
        for seed, lap in enumerate(laps)
        if lap.fault
    ]
    return "\n".join(lines) or "All methods planned all fleets."


def _row(count: int, method: str, laps: Sequence[Lap], joint: Sequence[Lap]) -> tuple[Cell, ...]:
    return (
        count,
        method,
        len(laps),
        100.0 * sum(not lap.fault for lap in laps) / len(laps),
        *median(lap.taken for lap in laps).both,
        max(lap.taken.processor for lap in laps),
        _times(laps, joint),
        _above(laps, joint, statistics.median),
        _above(laps, joint, max),
    )


def _times(laps: Sequence[Lap], joint: Sequence[Lap]) -> float | None:
    """Return the median processor time over joint SCP's, of the fleets that both planned."""
    both = zip(laps, joint, strict=True)
    parts = [a.taken.processor / b.taken.processor for a, b in both if not (a.fault or b.fault)]
    return statistics.median(parts) if parts else None


def _above(
    laps: Sequence[Lap], joint: Sequence[Lap], of: Callable[[list[float]], float]
) -> float | None:
    """Return the excess of the index over joint SCP's, of the fleets that both planned [%]."""
    both = zip(laps, joint, strict=True)
    parts = [a.index / b.index for a, b in both if not (a.fault or b.fault)]
    return 100.0 * (of(parts) - 1.0) if parts else None


_WORK = """\
The fleets of B1 (`fleet_b1`), seeds from 0. Joint SCP is that of Augugliaro, Schoellig and
D'Andrea (2012), reference [10] of the paper: all vehicles in one program of least index, every
pair at every knot linearised around the iterate before, the first iterate without pairs, until all
pairs are separated at the knots (to 1 µm) and the index changes by less than a thousandth. It is
written with CVXPY without loops over pairs or knots, and solved by Clarabel with default settings.
The three methods plan each fleet in turn, in one process, after one fleet that does not count. A
time runs from the scenario record to the verified plan."""

_LIMITATIONS = """\
Limitations. Joint SCP is verified at the knots only, as published. This package's first line holds
at every instant; its second, at the knots, is directly comparable. The success of joint SCP was
published with violations of 5 cm allowed; here none is. Both end in local optima, which need not
be the same, so on a single fleet either may cost far less than the other. The machine has other
work at times: trust the ratios."""
