"""Bounds of flights among walls against the optimum that SCIP proves."""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import drake_rho as rho
from benchmarks.all_cores import on_all_cores
from benchmarks.tables import Goal, Table

GAP, SECONDS = 0.01, 60.0
"""Gap that is asked for, and time for it [s]."""

KNOTS, STEP, TALL, ACCELERATION = 11, 0.5, 50.0, 4.0
"""Knots, step [s], half of the height of walls [m], and limit of accelerations [m/s²]."""

_ROUNDED, _FAR = 1e-6, 100.0
"""What SCIP's tolerances may take of its optimum [m²/s⁴], and bound of all distances [m]."""


@dataclasses.dataclass(frozen=True)
class Lap:
    """One scene."""

    walls: int
    """number of walls"""
    optimum: float | None
    """cost that SCIP proves to be the least [m²/s⁴]; None if it did not in time"""
    cost: float
    """of the plan of `rho.plan_global` [m²/s⁴]"""
    bound: float
    """its lower bound [m²/s⁴]"""
    checked: float
    """bound that `rho.check_certificate` computes [m²/s⁴]"""
    branches: int
    """that cover all motions"""


def run(seeds: int = 50) -> Table:
    """Bound as many scenes, on all cores."""
    laps = on_all_cores(lap, range(seeds), "scenes with SCIP", at_once=1)
    known = [each for each in laps if each.optimum is not None]
    above = [max(each.bound, each.checked) - (each.optimum or 0.0) for each in known]
    open_ = [each for each in known if each.bound < (1.0 - GAP) * (each.optimum or 0.0) - _ROUNDED]
    return Table(
        name="bound_referee",
        title="Global optima beside SCIP",
        columns=(
            *("walls", "least cost by SCIP [m²/s⁴]", "cost of `plan_global`", "its bound"),
            *("bound of `check_certificate`", "branches"),
        ),
        rows=tuple(dataclasses.astuple(each) for each in laps),
        notes=(
            "One vehicle passes one to three walls that are higher than it can fly over, and is to "
            f"be outside of them at {KNOTS} knots: a program with four binary variables for each "
            f"wall and knot. A gap of {GAP:.0%} is asked for, in at most {SECONDS:.0f} s.",
        ),
        goals=(
            Goal("bounds above SCIP's optimum, largest [m²/s⁴]", _ROUNDED, max(above)),
            Goal("bounds below it by more than the gap", 0, len(open_)),
            Goal("scenes that SCIP did not solve", 0, len(laps) - len(known)),
        ),
        packages=("drake-rho", "drake", "numpy", "scipy", "pyscipopt"),
    )


def lap(seed: int) -> Lap:
    """Bound one scene."""
    scenario = scene(seed)
    certificate = rho.plan_global(scenario, gap=GAP, time_limit=SECONDS).certificate
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "mission.proof")
        certificate.save(path)
        checked = rho.check_certificate(path)
    return Lap(
        len(scenario.obstacles),
        optimum(scenario),
        certificate.cost,
        certificate.lower_bound,
        checked.lower_bound,
        checked.branches,
    )


def scene(seed: int) -> rho.Scenario:
    """Return a flight past one to three tall walls, which are to be avoided at the knots."""
    rng = np.random.default_rng([seed, 53])
    walls = []
    for x in np.linspace(3.0, 7.0, int(rng.integers(1, 4))):
        center, half = np.array([x, rng.uniform(-1.0, 1.0)]), rng.uniform(0.4, 1.2, 2)
        walls.append(rho.Box([*(center - half), -TALL], [*(center + half), TALL]))
    vehicle = rho.Vehicle("v", rho.State([0.0, 0.0, 0.0]), rho.State([10.0, rng.normal(), 0.0]))
    return rho.Scenario(
        f"walls {seed}",
        rho.Grid(STEP, KNOTS),
        [vehicle],
        rho.Limits(acceleration=rho.Box([-ACCELERATION] * 3, [ACCELERATION] * 3)),
        walls,
        between_knots=False,
    )


def optimum(scenario: rho.Scenario) -> float | None:
    """Return the least cost by SCIP; None if it does not prove it in time.

    At each knot, one binary variable for each side of a wall says that the vehicle is beyond it.
    """
    from pyscipopt import Model, quicksum

    (vehicle,), steps = scenario.vehicles, KNOTS - 1
    walls = [each for each in scenario.obstacles if isinstance(each, rho.Box)]
    model: Any = Model()
    model.hideOutput()
    model.setParam("limits/time", SECONDS)
    model.setParam("limits/gap", 1e-8)
    model.setParam("numerics/feastol", 1e-9)  # otherwise costs are lower by a millionth
    a = [[model.addVar(lb=-ACCELERATION, ub=ACCELERATION) for _ in range(2)] for _ in range(steps)]
    cost = model.addVar(lb=0.0, obj=1.0)
    model.addCons(quicksum(x * x for each in a for x in each) <= cost)
    start, goal = vehicle.start.position, np.asarray(vehicle.goal.position)

    def at(knot: int, axis: int) -> Any:
        return start[axis] + quicksum(STEP**2 * (knot - j - 0.5) * a[j][axis] for j in range(knot))

    for axis in range(2):
        model.addCons(at(steps, axis) == float(goal[axis]))
        model.addCons(quicksum(each[axis] for each in a) == 0.0)
    for knot in range(1, steps):
        for wall in walls:
            sides = [model.addVar(vtype="B") for _ in range(4)]
            model.addCons(quicksum(sides) == 1)
            for axis in range(2):
                low, high = float(wall.lower[axis]), float(wall.upper[axis])
                p, (below, above) = at(knot, axis), sides[2 * axis : 2 * axis + 2]
                model.addCons(p <= low + _FAR * (1 - below))
                model.addCons(p >= high - _FAR * (1 - above))
    model.optimize()
    return model.getObjVal() if model.getStatus() in ("optimal", "gaplimit") else None
