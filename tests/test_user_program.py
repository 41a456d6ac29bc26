"""`rho.program`: its optimum is that of `plan_convex`, and users change and solve it."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from pydrake.solvers import ClarabelSolver, OsqpSolver, SolverOptions

import drake_rho as rho
from tests.cones import PRECISE
from tests.mixed import mixed, timed
from tests.requirements import Egg, random_scene
from tests.scenarios import box, fleet, mapped, random_fleet, random_scenario, single, slow
from tests.tolerances import INDEX, ROUNDING

SAME, SAME_BY_OSQP = 1e-7, 1e-5
"""Relative, for costs: the accuracy of each solver."""

TURNING = rho.State([0.0, 0.0, 0.0], [-1.0, 1.5, 1.0])
POLE = rho.Cylinder([5, 1.6, -1], 1.2)
EGGS = rho.Ellipsoid([5, 1.6, -1], [1.5, 1, 2])
TURNED = rho.Posed(rho.Box([-1, -1, -1], [1, 1, 1]), [0.3, 0.2, 0.5], [5, 1.6, -0.8])
GOES_BY = rho.Obstacle(rho.Sphere([5, 4, -1], 1.0), velocity=[0.0, -0.6, 0.0])
UNSURE = rho.Obstacle(
    rho.Sphere([5, 1.6, -1], 1.0), active=(2.0, 5.2), position_error=0.2, velocity_error=0.05, seen_at=0.0
)
LATER = rho.Obstacle(rho.Sphere([5, 2, -1], 1.0), known_from=3.0)


def _keeps(*sets: Any, **fields: Any) -> rho.Scenario:
    """Return the flight of one vehicle, turning at first, that keeps in some sets."""
    requirements = [rho.KeepIn(each, **fields) for each in sets]
    return dataclasses.replace(single(start=TURNING), requirements=tuple(requirements))


def _two(**fields: Any) -> rho.Scenario:
    """Return two vehicles of different weights that cross, without a separation."""
    scenario = fleet([[0, 0, 0], [10, 0.5, 0]], [[10, 0.5, 0.5], [0, 0, 0]], between_knots=False)
    heavy = dataclasses.replace(scenario.vehicles[1], weight=3.0)
    fields = {"separation": None, "vehicles": (scenario.vehicles[0], heavy)} | fields
    return dataclasses.replace(scenario, **fields)


POINT = rho.Track([0.0, 4.0, 8.0], [[0, 0, 0], [6, 4, 0], [10, 4, -2]], deviation=0.1)
CURVED = {
    "max_speed": single(limits=rho.Limits(max_speed=2.6), start=TURNING),
    "norms": single(
        limits=rho.Limits(max_acceleration=1.4, max_thrust=9.97, max_tilt=0.13, max_jerk=1.6),
        start=TURNING,
    ),
    "waypoint within": single(waypoints=[rho.Waypoint(3.3, [5.0, 4.0, 0.0], 0.5)]),
    "ball and cone": _keeps(
        rho.Ball([0.5, 0.5, 0], 2.2), rho.Cone([-2, 0, 0], [1, 0, 0], 0.7), of="velocity"
    ),
    "capsule": _keeps(rho.Capsule([0, 0, 0], [10, 4, -2], 0.8)),
    "ellipsoid": _keeps(rho.Ellipsoid([5, 2, -1], [6.5, 2.6, 2.2])),
    "turned cylinder": _keeps(
        rho.Posed(rho.Cylinder([0, 0, 0], 1.0, 14.0, "x"), [0, 0.18, 0.38], [5, 2, -1])
    ),
    "endless cylinder": _keeps(rho.Cylinder([5, 2, 0], 5.6)),
    "moving point": _keeps(rho.Sphere([0, 0, 0], 1.6), relative_to=POINT),
    "link": _two(
        requirements=(rho.KeepIn(rho.Ball([0, 0, 0], 2.0), relative_to="v0", active=(3.0, 6.2)),)
    ),
}
FLAT = {
    "boxes": single(
        limits=rho.Limits(
            position=rho.Box([-0.3, -0.1, -2.1], [10.1, 4.3, 0.3]),
            velocity=box(2.0),
            acceleration=box(1.6),
            jerk=box(3.5),
        ),
        start=rho.State([0, 0, 0], [-0.3, 0.5, 0.4], [0.1, 0, 0]),
    ),
    "waypoints": single(
        waypoints=[rho.Waypoint(2.5, [4.0, 3.0, 0.0]), rho.Waypoint(5.7, [6.0, 4.0, -1.0])]
    ),
    "polytope and half-space": _keeps(
        rho.Polytope([[-1, -1, -3], [11, -1, -3], [5, 6, -3], [5, 2, 2]]),
        rho.HalfSpace([0, 0, 1], 0.2),
    ),
    "thrust": _keeps(rho.Box([-0.8, -0.9, 9.5], [0.8, 0.9, 10.6]), of="thrust"),
    "shapes": single(obstacles=[POLE, TURNED]),
    "moving": single(obstacles=[GOES_BY, UNSURE, LATER, EGGS]),
    "separation": _two(separation=rho.Separation(1.0, downwash=2.0)),
}
KINDS = CURVED | FLAT


def _solved(p: rho.Program, solver: Any = ClarabelSolver, options: Any = PRECISE) -> rho.Plan:
    return p.plan(solver().Solve(p.prog, None, options))


@pytest.mark.parametrize("kind", KINDS)
def test_the_optimum_is_that_of_the_convex_method(kind: str) -> None:
    scenario = KINDS[kind]
    plan, p = rho.plan_convex(scenario), rho.program(scenario)
    written = _solved(p)
    assert written.cost == pytest.approx(plan.cost, rel=SAME)
    assert rho.verify(written).ok
    free = dataclasses.replace(scenario, limits=rho.Limits(), requirements=(), obstacles=())
    free = dataclasses.replace(free.without_separation(), vehicles=scenario.vehicles)
    if not any(each.waypoints for each in scenario.vehicles):
        assert rho.plan_convex(free).cost < plan.cost * (1.0 - 1e-4)
    if kind in FLAT:
        accurate = SolverOptions()
        accurate.SetOption(OsqpSolver.id(), "eps_abs", 1e-8)
        accurate.SetOption(OsqpSolver.id(), "eps_rel", 1e-8)
        accurate.SetOption(OsqpSolver.id(), "max_iter", 100_000)
        assert _solved(p, OsqpSolver, accurate).cost == pytest.approx(plan.cost, rel=SAME_BY_OSQP)
