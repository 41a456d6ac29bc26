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

SAME, SAME_BY_OSQP = 1e-7, 1e-5
"""Relative, for costs: the accuracy of each solver."""

ACCEPTED = 5e-6
"""Relative, for costs: planners accept a violation of requirements by a quarter of the tolerance,
and of waypoints by what their time may be rounded."""

TURNING = rho.State([0.0, 0.0, 0.0], [-1.0, 1.5, 1.0])
POLE = rho.Cylinder([5, 1.6, -1], 1.2)
EGGS = rho.Ellipsoid([5, 1.6, -1], [1.5, 1, 2])
TURNED = rho.Posed(rho.Box([-1, -1, -1], [1, 1, 1]), [0.3, 0.2, 0.5], [5, 1.6, -0.8])
GOES_BY = rho.Obstacle(rho.Sphere([5, 4, -1], 1.0), velocity=[0.0, -0.6, 0.0])
UNSURE = rho.Obstacle(
    rho.Sphere([5, 1.6, -1], 1.0),
    active=(2.0, 5.2),
    position_error=0.2,
    velocity_error=0.05,
    seen_at=0.0,
)
LATER = rho.Obstacle(rho.Sphere([5, 9, -1], 1.0), known_from=3.0)


def _keeps(*sets: Any, **fields: Any) -> rho.Scenario:
    """Return the flight of one vehicle, turning at first, that keeps in some sets."""
    requirements = [rho.KeepIn(each, active=(0.8, 7.4), **fields) for each in sets]
    return dataclasses.replace(single(start=TURNING), requirements=tuple(requirements))


STARTS, GOALS = ((0, 0, 0), (10, 0.5, 0)), ((10, 0.5, 0.5), (0, 0, 0))


def _two(**fields: Any) -> rho.Scenario:
    """Return two vehicles of different weights that cross, without a separation."""
    scenario = fleet(np.array(STARTS), np.array(GOALS), between_knots=False)
    heavy = dataclasses.replace(scenario.vehicles[1], weight=3.0)
    fields = {"separation": None, "vehicles": (scenario.vehicles[0], heavy)} | fields
    return dataclasses.replace(scenario, **fields)


POINT = rho.Track([0.0, 4.0, 8.0], [[0, 0, 0], [6, 4, 0], [10, 4, -2]], deviation=0.1)
CURVED = {
    "max_speed": single(limits=rho.Limits(max_speed=2.1), start=TURNING),
    "norms": single(
        limits=rho.Limits(max_acceleration=1.4, max_thrust=9.97, max_tilt=0.13, max_jerk=1.6),
        start=TURNING,
    ),
    "waypoint within": single(waypoints=[rho.Waypoint(3.3, [5.0, 4.0, 0.0], 0.5)]),
    "ball and cone": _keeps(
        rho.Ball([0.5, 0.5, 0], 1.6), rho.Cone([-2, 0, 0], [1, 0, 0], 0.7), of="velocity"
    ),
    "capsule": _keeps(rho.Capsule([0, 0, 0], [10, 4, -2], 0.8)),
    "ellipsoid": _keeps(rho.Ellipsoid([5, 2, -1], [6.5, 2.6, 1.2])),
    "turned cylinder": _keeps(
        rho.Posed(rho.Cylinder([0, 0, 0], 1.0, 14.0, "x"), [0, 0.18, 0.38], [5, 2, -1])
    ),
    "endless cylinder": _keeps(rho.Cylinder([5, 4, 0], 5.0)),
    "moving point": _keeps(rho.Sphere([0, 0, 0], 1.6), relative_to=POINT),
    "link": _two(
        requirements=(rho.KeepIn(rho.Ball([0, 0, 0], 2.0), relative_to="v0", active=(3.0, 6.2)),)
    ),
}
FLAT = {
    "boxes": single(
        limits=rho.Limits(
            position=rho.Box([-0.3, -0.1, -2.1], [10.1, 4.3, 0.3]),
            velocity=box(1.9),
            acceleration=box(0.97),
            jerk=box(1.7),
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


ACCURATE = SolverOptions()
for _name, _value in (("eps_abs", 1e-8), ("eps_rel", 1e-8), ("max_iter", 100_000)):
    ACCURATE.SetOption(OsqpSolver.id(), _name, _value)


def _solved(p: rho.Program, solver: Any = ClarabelSolver, options: Any = PRECISE) -> rho.Plan:
    return p.plan(solver().Solve(p.prog, None, options))


def _same(scenario: rho.Scenario, plan: rho.Plan) -> Any:
    """Return the costs of the program that count as a plan's."""
    late = scenario.grid.start != 0.0 and any(each.waypoints for each in scenario.vehicles)
    accepted = late or scenario.requirements
    return pytest.approx(plan.cost, rel=ACCEPTED if accepted else SAME)


@pytest.mark.parametrize("kind", KINDS)
def test_the_optimum_is_that_of_the_convex_method(kind: str) -> None:
    scenario = KINDS[kind]
    plan, p = rho.plan_convex(scenario), rho.program(scenario)
    written = _solved(p)
    assert written.cost == _same(scenario, plan)
    assert rho.verify(written).ok
    if kind in FLAT:
        assert _solved(p, OsqpSolver, ACCURATE).cost == pytest.approx(plan.cost, rel=SAME_BY_OSQP)


@pytest.mark.parametrize("kind", KINDS)
def test_every_constraint_is_written_and_has_an_effect(kind: str) -> None:
    scenario = KINDS[kind]
    p = rho.program(scenario)
    cost = _solved(p).cost
    own = [name for name in p.bindings if name not in ("effort", "goal")]
    for name in own:
        for each in p.bindings[name]:
            p.prog.RemoveConstraint(each)
    free = _solved(p)
    assert free.cost < cost * (1.0 - 1e-4)
    found = {each.constraint for each in rho.verify(free).violations}
    assert found <= set(own)


def _human(scenario: rho.Scenario) -> rho.Scenario:
    """Return a scenario in units in which it takes 10 s and is 10 m wide, as tolerances need."""
    ends = [[each.start.position, each.goal.position] for each in scenario.vehicles]
    units = 10.0 / np.abs(ends).max(), 10.0 / scenario.grid.duration
    return mapped(scenario, np.eye(3), np.zeros(3), *units)


def _random(seed: int) -> rho.Scenario:
    """Return one of four kinds of random scenes, whose constraints hold at the knots."""
    kind, number = divmod(seed, 10)
    if kind == 0:
        return _human(random_scenario(number))
    if kind == 1:
        return _human(random_fleet(number, between_knots=False))
    if kind == 2:
        scenario = random_scene(number)
    else:
        drawn = mixed(number, leave_out=("smoothing", "disturbance", "map"))
        scenario = timed(drawn.scenario, drawn.known)
    requirements = tuple(each for each in scenario.requirements if not isinstance(each.set, Egg))
    return dataclasses.replace(scenario, between_knots=False, requirements=requirements)


@pytest.mark.parametrize("seed", [2, 16, *slow(*({*range(40)} - {2, 16}))])
def test_the_optimum_of_random_scenes_is_that_of_the_convex_method(seed: int) -> None:
    scenario = _random(seed)
    try:
        plan = rho.plan_convex(scenario)
    except rho.InfeasibleError:
        with pytest.raises((rho.InfeasibleError, rho.SolverError)):
            _solved(rho.program(scenario))
        return
    written = _solved(rho.program(scenario))
    assert rho.verify(written).ok
    assert written.cost == _same(scenario, plan)


@pytest.mark.parametrize("seed", [6, 32, 39])
def test_all_pairs_are_written_also_where_planners_leave_out_distant_ones(seed: int) -> None:
    scenario = _human(random_fleet(seed, between_knots=False))
    written = _solved(rho.program(scenario))
    assert rho.verify(written).ok
    cost = rho.plan_convex(scenario).cost
    assert cost * (1.0 - SAME) < written.cost < 1.01 * cost


def test_knots_are_functions_of_the_accelerations() -> None:
    scenario = KINDS["boxes"]
    p, at = rho.program(scenario), {"position": 8, "velocity": -1, "acceleration": 3, "jerk": 16}
    result = ClarabelSolver().Solve(p.prog)
    plan = p.plan(result)
    for of, knot in at.items():
        A, b = p.coefficients(of, "solo", knot)  # type: ignore[arg-type]
        values = plan.motion().values(of)[0, knot]  # type: ignore[arg-type]
        np.testing.assert_allclose(A @ plan.accelerations[0].ravel() + b, values, atol=1e-9)
        if of != "acceleration":
            x = getattr(p, of)("solo", knot)
            found = [each.Evaluate() for each in result.GetSolution(x).ravel()]
            np.testing.assert_allclose(found, values, atol=1e-9)


def test_an_own_constraint_and_an_own_cost_change_the_plan() -> None:
    scenario = single()
    p = rho.program(scenario)
    p.prog.AddLinearConstraint(p.position("solo", 8)[2] >= 0.5)
    assert _solved(p).positions[0, 8, 2] == pytest.approx(0.5, abs=1e-6)
    for each in p.bindings["effort"]:
        p.prog.RemoveCost(each)
    for k in range(17):
        A, b = p.coefficients("jerk", "solo", k)
        p.prog.Add2NormSquaredCost(A, -b, p.accelerations[0].ravel())
    least, plan = _solved(p).motion().jerks(), rho.plan_convex(scenario).motion().jerks()
    assert np.sum(least**2) < 0.8 * np.sum(plan**2)


def test_bindings_say_what_they_are() -> None:
    scenario = dataclasses.replace(KINDS["separation"], obstacles=(rho.Sphere([5, 3, 0], 1.0),))
    p = rho.program(scenario)
    assert set(p.bindings) == {"effort", "goal", "obstacle 1", "separation"}
    (first, *_) = p.bindings["obstacle 1"]
    assert first.evaluator().get_description() == "obstacle 1: v0 at knot 1"
    (*_, last) = p.bindings["separation"]
    assert last.evaluator().get_description() == "separation: v0, v1 at knot 19"
    p = rho.program(KINDS["waypoint within"])
    (passed,) = p.bindings["waypoint 1"]
    assert passed.evaluator().get_description() == "waypoint 1: solo at 3.3 s"
    p = rho.program(KINDS["moving"])
    assert "obstacle 2" in p.bindings
    assert "obstacle 3" not in p.bindings  # which is not known at the start
    assert repr(p) == "<Program of single: 1 vehicle, 17 knots, 48 variables>"


def test_a_plan_around_which_it_is_linearised_can_be_given(paper: rho.Scenario) -> None:
    plan = rho.plan_convex(paper)
    written = _solved(rho.program(paper, around=plan), options=None)
    assert written.cost == pytest.approx(rho.scp_step(plan).cost, rel=SAME)
    assert written.reference is not None
    np.testing.assert_array_equal(written.reference.positions, plan.positions)
    with pytest.raises(ValueError, match="reference"):
        rho.program(paper, around=plan.tail(5))


def test_a_result_without_a_solution_is_refused() -> None:
    p = rho.program(single())
    p.prog.AddLinearConstraint(p.velocity("solo", 16)[0] >= 1.0)
    with pytest.raises(rho.SolverError, match="kInfeasibleConstraints from Clarabel"):
        _solved(p)
    with pytest.raises(TypeError, match="result"):
        p.plan(p.prog)


def test_a_result_of_another_program_is_refused() -> None:
    one, other = rho.program(single()), rho.program(single())
    with pytest.raises(ValueError, match="result: got that of another program"):
        one.plan(ClarabelSolver().Solve(other.prog))


WIDE = tuple(dataclasses.replace(each, radius=0.1) for each in single().vehicles)


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        ({"smoothing": rho.Smoothing(0.5), "between_knots": True}, "smoothing"),
        ({"disturbance": rho.Disturbance(0.01)}, "disturbance"),
        ({"vehicles": WIDE, "obstacles": (rho.Voxels([[9, 9, 9]], 0.5),)}, r"obstacles\[0\].shape"),
        ({"requirements": (rho.KeepIn(Egg([5, 2, -1], 20.0)),)}, r"requirements\[0\].set"),
        (
            {"requirements": (rho.KeepIn(rho.Ellipsoid([0, 0, 0], [9, 8, 7]), relative_to=POINT),)},
            r"requirements\[0\].relative_to.deviation",
        ),
        (
            {"vehicles": single(waypoints=[rho.Waypoint(None, [5, 4, 0])]).vehicles},
            r"vehicles\[0\].waypoints\[0\].time",
        ),
    ],
)
def test_what_one_program_cannot_describe_is_refused(fields: dict[str, Any], named: str) -> None:
    scenario = dataclasses.replace(single(), **fields)
    with pytest.raises(rho.ScenarioError, match=f"^{named}: "):
        rho.program(scenario)


def test_unknown_vehicles_knots_and_free_jerks_are_refused() -> None:
    p = rho.program(single(start=TURNING))
    with pytest.raises(ValueError, match=r"vehicle: got 'sole'.*did you mean solo"):
        p.position("sole", 3)
    knots: list[Any] = [17, -18, 2.5]
    for knot in knots:
        with pytest.raises(
            ValueError, match=f"knot: got {knot}, expected an integer from -17 to 16"
        ):
            p.velocity("solo", knot)
    with pytest.raises(ValueError, match="knot: got 0, expected another"):
        p.jerk("solo", 0)
