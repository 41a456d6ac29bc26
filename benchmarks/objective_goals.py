"""Goals that are sets or free, beside CVXPY; regions among obstacles, beside exact goals."""

from __future__ import annotations

import dataclasses
import math
import time

import numpy as np

import drake_rho as rho
from benchmarks.all_cores import on_all_cores
from benchmarks.objective_scenes import to_a_region, with_goals
from benchmarks.peers import cvxpy_objective
from benchmarks.tables import Cell, Goal, Table
from drake_rho.scenario.fields import FloatArray

SAMPLES, EQUAL = 50, 1e-6
"""Exact goals sampled in each region, and the largest relative excess over another's cost."""

NOTHING = 1e-12
"""Least cost to which an excess is relative [m²/s⁴]: free goals may cost nothing but rounding."""

COLUMNS = (
    "scenes",
    "number",
    "with a plan",
    "verified",
    "median excess over the other",
    "largest excess over the other",
    "cost more",
    "median seconds",
    "median seconds of the other",
)


@dataclasses.dataclass(frozen=True)
class Lap:
    """One scene."""

    cost: float
    """cost of the plan; infinite if there is none [m²/s⁴]"""
    other: float
    """cost of CVXPY's program, or of the cheapest exact goal; infinite if there is none"""
    ok: bool
    """whether the plan is verified"""
    seconds: float
    """processor time of the plan [s]"""
    other_seconds: float
    """processor time of the other, of one exact goal [s]"""

    @property
    def excess(self) -> float:
        """Relative excess of the plan's cost over the other."""
        if math.isinf(self.other):
            return 0.0 if math.isinf(self.cost) else -math.inf
        return (self.cost - self.other) / max(self.other, NOTHING)


def run(seeds: int = 60) -> Table:
    """Plan scenes of both kinds, as many as given of each, on all cores."""
    convex = on_all_cores(beside_cvxpy, range(seeds), "goals without obstacles")
    regions = on_all_cores(beside_samples, range(seeds), "regions among obstacles")
    differences = [abs(each.excess) for each in convex]
    return Table(
        name="objective_goals",
        title="Goals that are sets or free",
        columns=COLUMNS,
        rows=(
            _row("goals of every kind, CVXPY", convex),
            _row(f"regions among obstacles, {SAMPLES} exact goals", regions),
        ),
        notes=(_WORK,),
        goals=(
            Goal("relative difference from CVXPY, largest", EQUAL, max(differences)),
            Goal("regions that cost more than an exact goal", 0, _costing_more(regions)),
            Goal("not verified", 0, sum(not each.ok for each in (*convex, *regions))),
        ),
        packages=("drake-rho", "drake", "numpy", "scipy", "cvxpy", "clarabel"),
    )


def beside_cvxpy(seed: int) -> Lap:
    """Return a scene without obstacles, beside CVXPY's program."""
    scenario = with_goals(seed)
    cost, ok, seconds = _planned(scenario)
    began = time.process_time()
    other = cvxpy_objective.least_cost(scenario)
    return Lap(cost, other, ok, seconds, time.process_time() - began)


def beside_samples(seed: int) -> Lap:
    """Return a region among obstacles, beside the cheapest of exact goals in it."""
    scenario = to_a_region(seed)
    cost, ok, seconds = _planned(scenario)
    vehicle, began, costs = scenario.vehicles[0], time.process_time(), [math.inf]
    for place in _clear_places(scenario, np.random.default_rng([51, seed])):
        exact = dataclasses.replace(vehicle, goal=rho.State(place, vehicle.goal.velocity))
        costs.append(_planned(dataclasses.replace(scenario, vehicles=(exact,)))[0])
    return Lap(cost, min(costs), ok, seconds, (time.process_time() - began) / SAMPLES)


def _planned(scenario: rho.Scenario) -> tuple[float, bool, float]:
    """Return the cost of a plan, whether it is verified, and the processor time."""
    began = time.process_time()
    try:
        plan = rho.plan(scenario)
    except rho.InfeasibleError:
        return math.inf, True, time.process_time() - began
    return plan.cost, rho.verify(plan).ok, time.process_time() - began


def _clear_places(scenario: rho.Scenario, rng: np.random.Generator) -> list[FloatArray]:
    """Return random places in a region, outside of all obstacles."""
    vehicle, found = scenario.vehicles[0], list[FloatArray]()
    region = vehicle.goal.position
    for x in rng.uniform(-1.0, 1.0, (2000, 3)) * region.extent + region.center:
        clear = all(
            body.distances(x[None], np.zeros(1))[0] >= vehicle.radius for body in scenario.bodies
        )
        if clear and region.signed_distance(x) <= 0.0:
            found.append(x)
    return found[:SAMPLES]


def _costing_more(laps: list[Lap]) -> int:
    return sum(each.excess > EQUAL for each in laps)


def _row(kind: str, laps: list[Lap]) -> tuple[Cell, ...]:
    excesses = [each.excess for each in laps]
    return (
        kind,
        len(laps),
        sum(math.isfinite(each.cost) for each in laps),
        sum(each.ok for each in laps),
        float(np.median(excesses)),
        max(excesses),
        _costing_more(laps),
        float(np.median([each.seconds for each in laps])),
        float(np.median([each.other_seconds for each in laps])),
    )


_WORK = f"""\
Without obstacles: one to six vehicles with limits, whose goals have an exact position, a ball, a
box or none, and an exact velocity, a ball or none. Among obstacles: one vehicle, 8 m in 6 s past
two to six balls to a ball or a box, at rest or with any velocity, beside the cheapest plan to
{SAMPLES} exact goals drawn in it."""
