"""No kind of requirement is forgotten: each part of the package treats every kind as it should."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.analysis.relaxations import relaxations_of
from drake_rho.analysis.time_sensitivity import timed_of
from drake_rho.motion.rest_tube import RestTube
from drake_rho.planning.problem import Problem
from drake_rho.scenario.kinds import KINDS, LIMITS, kinds_of
from drake_rho.verification import checkers as verification
from drake_rho.verification.averages import averaged
from drake_rho.verification.check import Column
from drake_rho.verification.holds import _checkers, first_violation
from drake_rho.verification.quick_bounds import QuickBounds
from drake_rho.verification.rest import Rest, check_rest
from drake_rho.verification.trajectory import PiecewiseTrajectory
from drake_rho.verification.tubes import Tubes
from tests.disturbed import disturbed
from tests.scenarios import box, fleet, single

SPHERE = rho.Sphere([5.0, 2.2, -0.9], 1.5)
_OBSTACLES = {
    "obstacles": rho.Obstacle(SPHERE),
    "moving obstacles": rho.Obstacle(SPHERE, velocity=[0.0, 0.1, 0.0]),
    "late obstacles": rho.Obstacle(SPHERE, known_from=1.0),
    "active obstacles": rho.Obstacle(SPHERE, active=(2.0, 6.0)),
    "uncertain obstacles": rho.Obstacle(SPHERE, velocity_error=0.05, seen_at=1.0),
}
_LOOSE = {"position": 50.0, "velocity": 9.0, "acceleration": 9.0, "jerk": 9.0}
_LOOSE_NORMS = {"max_speed": 9.0, "max_thrust": 15.0, "max_tilt": 1.0}


def _scenario(kind: str) -> rho.Scenario:
    """Return a scenario that has a kind of requirement."""
    if kind in LIMITS:
        value: Any = box(_LOOSE[kind]) if kind in _LOOSE else _LOOSE_NORMS.get(kind, 9.0)
        return single(limits=rho.Limits(**{kind: value}))
    if kind in _OBSTACLES:
        return single(obstacles=[_OBSTACLES[kind]], between_knots=True)
    if kind == "waypoints":
        return single(waypoints=[rho.Waypoint(3.0, [4.0, 1.0, -1.0], 0.3)])
    if kind == "requirements":
        return _required("position", relative=False)
    if kind == "separation":
        ends = [[0, 0, 0], [0, 4, 0]], [[10, 4, 0], [10, 0, 0]]
        return fleet(*ends, separation=rho.Separation(1.0))
    if kind == "smoothing":
        limits = rho.Limits(max_acceleration=2.0)
        averaged = single(limits=limits, obstacles=[SPHERE], between_knots=True)
        return dataclasses.replace(averaged, smoothing=rho.Smoothing(0.5, 2))
    if kind == "holding":
        return dataclasses.replace(single(obstacles=[SPHERE]), hold_at_goal=True)
    return disturbed(0) if kind == "disturbance" else single()


_SETS: dict[str, Any] = {
    "position": rho.Sphere([5.0, 1.0, -1.0], 2.0),
    "velocity": rho.Sphere([1.0, 0.0, 0.0], 3.0),
    "acceleration": rho.Sphere([0.0, 0.0, 0.0], 3.0),
    "thrust": rho.Cone([0.0, 0.0, 0.0], [0.0, 0.0, 1.0], 0.5),
    "jerk": rho.Sphere([0.0, 0.0, 0.0], 9.0),
}


def _required(of: Any, *, relative: bool) -> rho.Scenario:
    """Return a scenario in which a quantity, or a difference of two, is kept in a set."""
    if not relative:
        return dataclasses.replace(
            single(), requirements=(rho.KeepIn(_SETS[of], of=of, active=(4.0, 5.0)),)
        )
    pair = fleet([[0, 0, 0], [0, 4, 0]], [[10, 4, 0], [10, 8, 0]])
    size = 4.5 if of == "position" else 2.0
    link = rho.KeepIn(
        rho.Sphere([0, 0, 0], size), of=of, vehicles="v1", relative_to="v0", active=(1.0, 6.0)
    )
    return dataclasses.replace(pair, requirements=(link,))


@pytest.mark.parametrize("kind", KINDS)
def test_scenarios_have_the_kinds_that_they_are_made_with(kind: str) -> None:
    assert kind in kinds_of(_scenario(kind))
    assert kinds_of(_scenario(kind)) <= set(KINDS)
    assert {"dynamics", "goals"} == kinds_of(single())


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_planned_for_and_verified(kind: str) -> None:
    scenario = _scenario(kind)
    plan = rho.plan(scenario)
    constraints = {each.kind for each in Problem.of(scenario).linearized(plan, rho.coupled)}
    of_their_own = {*LIMITS, "waypoints", "requirements", "obstacles", "separation"}
    known = kinds_of(scenario if scenario.known else scenario.without_obstacles())
    assert constraints == known & of_their_own
    flown = rho.plan_rho(scenario) if kind == "late obstacles" else plan
    assert rho.verify(flown).ok
    assert rho.certify(plan).lower_bound <= plan.cost * (1.0 + 1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_written_in_the_program_or_refused(kind: str) -> None:
    scenario = _scenario(kind)
    if kind in ("smoothing", "disturbance"):
        with pytest.raises(rho.ScenarioError, match=f"^{kind}: "):
            rho.program(scenario)
        return
    constraints = Problem.of(scenario).linearized(rho.plan(scenario), rho.coupled)
    assert set(rho.program(scenario).bindings) == {"effort", "goal"} | {c.name for c in constraints}


@pytest.mark.parametrize(
    "kind",
    [
        each
        for each in KINDS
        if each not in ("dynamics", "goals", "disturbance", "holding", "smoothing")
    ],
)
def test_what_breaks_a_requirement_is_not_said_to_hold(kind: str) -> None:
    """A motion through everything in its way, or with too much of everything, is seen."""
    scenario, rng = _scenario(kind), np.random.default_rng(0)
    accelerations = 40.0 * rng.standard_normal((len(scenario.vehicles), scenario.grid.knots - 1, 3))
    checked = "obstacles" if kind in _OBSTACLES else kind
    if checked in ("obstacles", "separation"):
        straight = scenario.without_obstacles().without_separation()
        accelerations = rho.plan_convex(straight).accelerations
    plan = rho.Plan.from_accelerations(scenario, accelerations)
    assert checked in {each.kind for each in rho.verify(plan).violations} or _is_late(scenario)
    # windows are verified by what is known when they begin
    columns = _columns_in_windows(plan)
    assert checked in {each.kind for each in columns if not each.holds} or _is_late(scenario)


def _columns_in_windows(plan: rho.Plan) -> list[Column]:
    """Return the columns that windows check; no quick bound passes over one that does not hold."""
    trajectory = PiecewiseTrajectory.of(plan.scenario, plan.motion(), Tubes.of(plan))
    smooth, found = averaged(trajectory), list[Column]()
    for each in _checkers(plan, trajectory, None):
        columns = list(each.check(smooth))
        assert {column.kind for column in columns} <= {*each.kinds}
        if not all(column.holds for column in columns):
            assert smooth.is_smooth or not each.surely_holds(QuickBounds.of(smooth))
        found += columns
    return found


@pytest.mark.parametrize(
    "kind",
    [
        *(each for each in LIMITS if "jerk" not in each),  # jerks at rest are zero in any wind
        *(each for each in _OBSTACLES if each != "active obstacles"),
        "requirements",
        "separation",
    ],
)
def test_what_errors_break_after_the_end_is_found(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every requirement that vehicles may break at their goals is seen where errors are large."""
    scenario = dataclasses.replace(
        _scenario(kind), hold_at_goal=True, disturbance=rho.Disturbance(1e-4)
    )
    if kind == "requirements":
        link = rho.KeepIn(rho.Sphere([5.0, 2.0, -1.0], 20.0))
        scenario = dataclasses.replace(scenario, requirements=(link,))
    checked = "obstacles" if kind in _OBSTACLES else kind
    rest = Rest.of(scenario)
    assert rest is not None
    columns = {each.kind: each.holds for each in rest.columns()}
    assert columns[checked] or kind == "uncertain obstacles"  # whose uncertainty always grows
    monkeypatch.setattr(RestTube, "largest", lambda *_: 1e3)
    columns = {each.kind: each.holds for each in rest.columns()}
    assert not columns[checked]
    assert not all(each.holds for each in check_rest(scenario))


def _soft(scenario: rho.Scenario, penalty: float) -> rho.Scenario:
    """Return a scenario in which all that can be soft is."""
    vehicles = [
        dataclasses.replace(
            vehicle,
            waypoints=tuple(dataclasses.replace(w, penalty=penalty) for w in vehicle.waypoints),
        )
        for vehicle in scenario.vehicles
    ]
    return dataclasses.replace(
        scenario,
        vehicles=tuple(vehicles),
        obstacles=tuple(dataclasses.replace(each, penalty=penalty) for each in scenario.bodies),
        requirements=tuple(
            dataclasses.replace(each, penalty=penalty) for each in scenario.requirements
        ),
    )


def _missed(of: Any, *, relative: bool) -> rho.Scenario:
    """Return a scenario with a set far from any value of the quantity, or of a difference."""
    scenario = _required(of, relative=relative)
    far = dataclasses.replace(scenario.requirements[0], set=rho.Sphere([9.0, 9.0, 9.0], 0.1))
    return dataclasses.replace(scenario, requirements=(far,))


_CAN_BE_SOFT = {
    **{kind: _scenario(kind) for kind in (*_OBSTACLES, "waypoints")},
    **{f"{of} of one": _missed(of, relative=False) for of in _SETS},
    **{f"{of} of two": _missed(of, relative=True) for of in _SETS},
}


@pytest.mark.parametrize("kind", _CAN_BE_SOFT)
def test_every_kind_that_can_be_soft_is_priced_everywhere(kind: str) -> None:
    """No part of the package takes a soft limit for a hard one, or forgets its price."""
    scenario = _soft(_CAN_BE_SOFT[kind], 1e-3)
    assert scenario.penalties
    flown = rho.plan_rho(scenario)
    plan = flown.plan if kind == "late obstacles" else rho.plan(scenario)
    report = rho.verify(plan)
    assert report.ok
    assert report.exceeded
    assert report.price == pytest.approx(sum(each.price or 0.0 for each in report.checks))
    assert rho.verify(flown).ok
    assert rho.verify(flown).exceeded
    assert all(column.holds for column in _columns_in_windows(plan))
    certificate = rho.certify(plan)
    assert certificate.cost == pytest.approx(plan.cost + report.price)
    assert certificate.lower_bound <= certificate.cost * (1.0 + 1e-6)
    if kind != "late obstacles":
        assert float(Problem.of(scenario).prices(plan).sum()) == pytest.approx(
            report.price, rel=1e-5
        )
        assert "penalties" in rho.program(scenario).bindings
    for refused in (
        lambda: rho.plan_minimum_time(scenario),
        lambda: rho.plan_rho(scenario, bounded_cost=True),
    ):
        with pytest.raises(rho.ScenarioError, match=r"penalty: got 0\.001, "):
            refused()
    windy = dataclasses.replace(scenario, disturbance=rho.Disturbance(0.01), separation=None)
    with pytest.raises(ValueError, match="expected obstacles, a separation"):
        rho.attack(windy, plan)


@pytest.mark.parametrize("relative", [False, True], ids=["single", "relative"])
@pytest.mark.parametrize("of", _SETS)
def test_every_quantity_is_required_of_one_or_of_two(of: str, relative: bool) -> None:
    scenario = _required(of, relative=relative)
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    assert rho.verify(rho.plan_rho(scenario)).ok
    assert rho.certify(plan).lower_bound <= plan.cost * (1.0 + 1e-6)
    rng = np.random.default_rng(0)
    accelerations = 40.0 * rng.standard_normal(plan.accelerations.shape)
    wild = rho.Plan.from_accelerations(scenario, accelerations)
    assert "requirements" in {each.kind for each in rho.verify(wild).violations}
    worst = first_violation(wild)
    assert worst is not None
    assert "requirements" in {each.kind for each in _columns_in_windows(wild) if not each.holds}


_GOALS: dict[str, Any] = {
    "free velocity": rho.State([10.0, 4.0, -2.0], None),
    "position": rho.Sphere([10.0, 4.0, -2.0], 1.0),
    "velocity": rho.Goal([10.0, 4.0, -2.0], velocity=rho.Sphere([1.0, 0.0, 0.0], 0.3)),
    "both": rho.Goal(rho.Sphere([10.0, 4.0, -2.0], 1.0), velocity=rho.Sphere([1.0, 0.0, 0.0], 0.3)),
    "anywhere": rho.Goal(None),
    "free": None,
}


@pytest.mark.parametrize("kind", _GOALS)
def test_every_kind_of_goal_is_planned_for_verified_and_written_in_the_program(kind: str) -> None:
    vehicle = rho.Vehicle("solo", rho.State([0.0, 0.0, 0.0], [0.5, 0.0, 0.0]), _GOALS[kind])
    scenario = dataclasses.replace(single(obstacles=[SPHERE]), vehicles=(vehicle,))
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    assert rho.verify(rho.plan_rho(scenario)).ok
    assert rho.certify(plan).lower_bound <= plan.cost * (1.0 + 1e-6) + 1e-9
    names = {each.name for each in Problem.of(scenario).linearized(plan, rho.coupled)}
    own = {each for each in names if each.startswith("goal of")}
    assert own == ({"goal of solo"} if scenario.goal_sets else set())
    equal = {"goal"} if not scenario.fleet.open_end or kind not in ("both", "free") else set()
    assert set(rho.program(scenario).bindings) == {"effort"} | equal | names
    rng = np.random.default_rng(0)
    wild = rho.Plan.from_accelerations(scenario, 40.0 * rng.standard_normal((1, 16, 3)))
    broken = {each.kind for each in _columns_in_windows(wild) if not each.holds}
    assert ("goals" in broken) == (kind != "free")
    assert ("goals" in {each.kind for each in rho.verify(wild).violations}) == (kind != "free")


def _is_late(scenario: rho.Scenario) -> bool:
    """Return whether an obstacle is not known at the start, so that plans need not avoid it."""
    return any(each.known_from > 0.0 for each in scenario.bodies)


@pytest.mark.parametrize("kind", LIMITS)
def test_the_verifier_refuses_what_it_does_not_check(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = rho.plan(_scenario(kind))
    for check in ("check_boxes", "check_norms"):
        monkeypatch.setattr(verification, check, lambda *_: iter(()))
    with pytest.raises(NotImplementedError, match=f"verify: nothing checks {kind}"):
        rho.verify(plan)
    monkeypatch.setattr(verification, "KNOWN", verification.KNOWN - {kind})
    with pytest.raises(NotImplementedError, match=kind):
        first_violation(plan)


_NAMES = {
    **{kind: f"{kind} box" for kind in LIMITS if kind in _LOOSE},
    **{kind: f"maximum {kind[4:]}" for kind in LIMITS if kind not in _LOOSE},
    "waypoints": "waypoint 1",
    "requirements": "requirement 1",
    **dict.fromkeys(_OBSTACLES, "obstacle 1"),
    "separation": "separation",
    "disturbance": "wind",
    "smoothing": "smoothing",
}
"""Names of what each kind requires in messages and reports."""

_ROOM = ("acceleration", "max_acceleration", "jerk", "max_jerk", "max_tilt")
"""Limits that have room for any error: feedback gets its share of accelerations, jerks are limits
of the plan alone, and a cone has room for any ball further up."""


@pytest.mark.parametrize(
    "kind",
    [
        each
        for each in _NAMES
        if each not in ("disturbance", "smoothing", "late obstacles", "active obstacles")
    ],
)
def test_requirements_without_room_for_the_errors_are_named_before_planning(kind: str) -> None:
    scenario = _scenario(kind)
    if kind == "requirements":  # at the start as well
        whole = rho.KeepIn(rho.Sphere([5.0, 2.0, -1.0], 9.0))
        scenario = dataclasses.replace(scenario, requirements=(whole,))
    stormy = dataclasses.replace(scenario, disturbance=rho.Disturbance(500.0))
    if kind in _ROOM:
        limits = dataclasses.replace(scenario.limits, position=box(20.0))
        stormy = dataclasses.replace(stormy, limits=limits)
    with pytest.raises(rho.InfeasibleError, match="no room for the errors") as refused:
        rho.plan(stormy)
    named = any(_NAMES[kind] in why for each in refused.value.conflicts.values() for why in each)
    assert named == (kind not in _ROOM)


@pytest.mark.parametrize("kind", [each for each in KINDS if each != "holding"])
def test_every_limit_of_the_time_is_relaxed(kind: str) -> None:
    """A least time changes with every kind but the motion's equations, its ends, and holding."""
    scenario = _scenario(kind)
    timed = timed_of(rho.plan(scenario), scenario)
    relaxations = relaxations_of(timed)
    names = [each.limit for each in relaxations]
    if kind in ("dynamics", "goals", "late obstacles"):  # which are not known at the start
        assert names == []
    else:
        assert any(_NAMES[kind] in each or kind in each for each in names)
    for each in relaxations:
        assert each.relaxed(timed, each.vehicles) != timed


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_bound_on_the_time_names_what_it_leaves_out(kind: str) -> None:
    scenario = _scenario(kind)
    quick = dataclasses.replace(scenario.limits, max_acceleration=2.0)
    plan = rho.plan_minimum_time(dataclasses.replace(scenario, limits=quick), knots=17)
    certificate = rho.certify_time(plan, gap=0.2)
    assert certificate.bound <= plan.scenario.grid.duration * (1.0 + 1e-6)
    words = {
        "requirements": "the requirements",
        "separation": "the separation",
        "disturbance": "the disturbance",
        "smoothing": "the margin of the smoothing",
        "uncertain obstacles": "the growth of errors of obstacles",
    }
    expected = {words[each] for each in kinds_of(scenario) if each in words}
    assert set(words.values()) & set(certificate.left_out) == expected


@pytest.mark.parametrize("kind", KINDS)
def test_the_attack_aims_at_every_clearance(kind: str) -> None:
    """Windy flights keep clear of obstacles, of vehicles, and of the surfaces of sets."""
    scenario = _scenario(kind)
    windy = scenario
    if scenario.disturbance is None:
        windy = dataclasses.replace(scenario, disturbance=rho.Disturbance(0.01))
    plan = rho.plan_convex(scenario.without_obstacles())
    if kind in ("position", "requirements", "separation", "disturbance", *_OBSTACLES):
        found = rho.attack(windy, plan)
        assert _NAMES.get(kind, "") in found.constraint or kind == "disturbance"
        assert found.bound < found.planned
        assert found.clearance == pytest.approx(found.bound, abs=1e-6)
    elif kind not in ("holding", "smoothing"):
        with pytest.raises(ValueError, match="expected obstacles, a separation"):
            rho.attack(windy, plan)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_drawn_and_exported(kind: str, tmp_path: object) -> None:
    plan = rho.plan(_scenario(kind))
    rho.paths_figure(plan)
    rho.velocities_figure(plan)
    rho.accelerations_figure(plan)
    if plan.scenario.obstacles:
        rho.distances_figure(plan)
    rho.export(plan, f"{tmp_path}/out.csv", format="csv")
