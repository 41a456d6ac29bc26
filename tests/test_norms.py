"""Limits on norms of accelerations, thrusts and tilts: convex sets, by tangent planes."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import drake_rho as rho
from drake_rho.analysis.trials import PRECISION, is_monotone
from drake_rho.planning.problem import Problem
from drake_rho.planning.scp.minimum_violation import minimum_violation
from drake_rho.scenario.norms import NORMS, Norm
from tests.arrays import FloatArray
from tests.cones import TWIN, twin_cost
from tests.scenarios import (
    box,
    examples,
    fleet,
    mapped,
    random_scenario,
    single,
    slow,
    through_the_middle,
)
from tests.tolerances import INDEX, MOTION
from tests.written import as_yaml, from_yaml

G = 9.81
"""Gravity [m/s²], independent of the package's constant."""

TURNING = rho.State([0.0, 0.0, 0.0], [-1.0, 1.5, 1.0])
"""Start from which the acceleration turns on the way."""

CASES: dict[str, tuple[rho.Limits, str]] = {
    "maximum acceleration": (rho.Limits(max_acceleration=1.3), "m/s²"),
    "maximum thrust": (rho.Limits(max_thrust=9.95), "m/s²"),
    "maximum tilt": (rho.Limits(max_tilt=0.12), "rad"),
}


def _limited_values(accelerations: FloatArray) -> dict[str, FloatArray]:
    """Return the limited values of accelerations (..., 3), without the package."""
    x, y, up = np.moveaxis(accelerations, -1, 0)
    up = up + G
    return {
        "maximum acceleration": np.sqrt(x**2 + y**2 + (up - G) ** 2),
        "maximum thrust": np.sqrt(x**2 + y**2 + up**2),
        "maximum tilt": np.arccos(up / np.sqrt(x**2 + y**2 + up**2)),
    }


@pytest.mark.parametrize("kind", CASES)
def test_a_limit_holds_has_an_effect_and_is_verified(kind: str) -> None:
    limits, unit = CASES[kind]
    free, plan = rho.plan_convex(single(start=TURNING)), None
    scenario = single(start=TURNING, limits=limits)
    plan = rho.plan_convex(scenario)
    (most,) = (each for each in dataclasses.asdict(limits).values() if each is not None)
    assert rho.verify(plan).ok
    assert _limited_values(plan.accelerations)[kind].max() == pytest.approx(most, rel=1e-6)
    assert plan.cost > free.cost * 1.001

    (violation,) = rho.verify(rho.Plan.from_accelerations(scenario, free.accelerations)).violations
    values = _limited_values(free.accelerations[0])[kind]
    assert (violation.constraint, violation.part, violation.unit) == (kind, "", unit)
    assert violation.limit == most
    assert violation.value == pytest.approx(values.max(), rel=1e-9)
    assert violation.excess == pytest.approx(values.max() - most, rel=1e-9)
    assert violation.time == scenario.grid.times[np.argmax(values)]


@pytest.mark.parametrize("knots", [5, 17, 60])
@pytest.mark.parametrize("part", [0.75, 0.9])
@pytest.mark.parametrize("kind", [*NORMS, "all"])
def test_the_cost_equals_that_of_the_program_with_cones(knots: int, part: float, kind: str) -> None:
    grid = rho.Grid(8.0 / (knots - 1), knots)
    free = single(start=TURNING, grid=grid)
    limits = _tightened(free, NORMS if kind == "all" else (kind,), part)
    if limits is None:
        return
    scenario = dataclasses.replace(free, limits=limits)
    known = twin_cost(scenario)
    if known is None:
        with pytest.raises(rho.InfeasibleError):
            rho.plan_convex(scenario)
        return
    plan = rho.plan_convex(scenario)
    assert plan.cost == pytest.approx(known, rel=TWIN)
    assert rho.verify(plan).ok
    assert rho.certify(plan).is_globally_optimal


def _tightened(scenario: rho.Scenario, kinds: Any, part: float) -> rho.Limits | None:
    """Return limits that are a fraction of the free plan's; None where the ends violate them."""
    free = dataclasses.replace(scenario, limits=rho.Limits(), obstacles=())
    plan = rho.plan_convex(free)
    largest = {
        name: float(values.max()) for name, values in _limited_values(plan.accelerations).items()
    }
    most: dict[str, Any] = {
        "max_speed": part * float(np.linalg.norm(plan.velocities, axis=2).max()),
        "max_acceleration": part * largest["maximum acceleration"],
        "max_thrust": G + part * max(1e-3, largest["maximum thrust"] - G),
        "max_tilt": min(1.5, part * largest["maximum tilt"]),
        "max_jerk": part * float(np.nanmax(np.linalg.norm(plan.motion().jerks(), axis=2))),
    }
    limits = dataclasses.replace(scenario.limits, **{kind: most[kind] for kind in kinds})
    try:
        dataclasses.replace(scenario, limits=limits)
    except rho.ScenarioError:
        return None
    return limits


def _of_gravitys_size(scenario: rho.Scenario, seed: int) -> rho.Scenario:
    """Return the scenario scaled so that gravity is comparable to its accelerations."""
    size = G * 10 ** np.random.default_rng(seed).uniform(-1.5, 0.0)
    length = size / float(scenario.fleet.scale("acceleration").max())
    return mapped(scenario, np.eye(3), np.zeros(3), length)


@given(
    seed=st.integers(0, 2**32 - 1),
    tight=st.booleans(),
    kinds=st.sets(st.sampled_from(list(NORMS)), min_size=1),
    part=st.floats(0.7, 0.95),
)
@examples(few=8, many=20)
def test_costs_of_random_scenarios_equal_those_of_the_programs_with_cones(
    seed: int, tight: bool, kinds: set[Norm], part: float
) -> None:
    """The scenarios have boxes, and spheres linearised around the plan without them."""
    scenario = _of_gravitys_size(random_scenario(seed, tight=tight), seed)
    limits = _tightened(scenario, sorted(kinds), part)
    if limits is None:
        return
    scenario = dataclasses.replace(scenario, limits=limits)
    try:
        reference = rho.plan_convex(scenario.without_obstacles())
    except rho.InfeasibleError:
        assert twin_cost(scenario.without_obstacles()) is None
        return
    if any(
        np.linalg.norm(reference.positions - sphere.center, axis=2).min() < 1e-3 * sphere.radius
        for sphere in scenario.spheres
    ):
        return  # through a centre, where the planner chooses any direction
    known = twin_cost(scenario, reference)
    try:
        plan = rho.plan_convex(scenario, reference=reference)
    except rho.InfeasibleError:
        assert known is None
        return
    assert known is not None
    assert plan.cost == pytest.approx(known, rel=TWIN)


@given(angle=st.floats(0.0, 2.0 * np.pi), boxes=st.booleans())
@examples(few=3, many=6)
def test_turning_about_the_vertical_turns_the_plan(angle: float, boxes: bool) -> None:
    """With boxes the angle is a quarter turn, else any; gravity keeps its direction."""
    limits = rho.Limits(max_speed=2.3, max_acceleration=1.4, max_thrust=9.97, max_tilt=0.13)
    if boxes:
        angle = np.pi / 2.0
        limits = dataclasses.replace(limits, acceleration=rho.Box([-1, -1.3, -1], [1.1, 1.2, 1]))
    turn = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()
    turn = np.round(turn) if boxes else turn
    scenario = single(start=TURNING, limits=limits)
    plan = rho.plan_convex(scenario)
    other = rho.plan_convex(mapped(scenario, turn, np.array([3.0, -2.0, 1.0])))
    assert other.cost == pytest.approx(plan.cost, rel=INDEX)
    expected = plan.accelerations @ turn.T
    largest = np.abs(expected).max()
    np.testing.assert_allclose(other.accelerations, expected, atol=100 * MOTION * largest)


def test_a_largest_acceleration_has_no_direction() -> None:
    """Its ball may be turned by any rotation."""
    scenario = single(start=TURNING, limits=rho.Limits(max_acceleration=1.3))
    turn = Rotation.random(random_state=1).as_matrix()
    other = mapped(scenario, turn, np.zeros(3), 3.0, 0.5)
    cost = 12.0**2 * rho.plan_convex(scenario).cost
    assert rho.plan_convex(other).cost == pytest.approx(cost, rel=INDEX)


@pytest.mark.parametrize("knots", [100, 400])
@pytest.mark.parametrize("kind", CASES)
def test_many_knots_take_few_rounds(kind: str, knots: int) -> None:
    grid = rho.Grid(8.0 / (knots - 1), knots)
    plan = rho.plan_convex(single(limits=CASES[kind][0], grid=grid, start=TURNING))
    assert rho.verify(plan).ok
    assert plan.statistics.programs <= 15


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        (rho.Limits(max_acceleration=0.6), "maximum acceleration from 0 s to 7.5 s"),
        pytest.param(rho.Limits(max_thrust=9.815), "maximum thrust from", marks=pytest.mark.slow),
        pytest.param(rho.Limits(max_tilt=0.03), "maximum tilt from", marks=pytest.mark.slow),
    ],
)
def test_a_conflicting_limit_is_named_and_diagnosed(limits: rho.Limits, words: str) -> None:
    scenario = single(limits=limits)
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan_convex(scenario)
    assert any(words in name for names in caught.value.conflicts.values() for name in names)
    (names,) = rho.infeasible_subset(caught.value).values()
    assert words in names[-1]
    reason = rho.diagnose(scenario)
    assert not reason.feasible
    assert reason.conflicts == {"solo": names}
    assert reason.is_monotone
    assert reason.violations
    assert reason.shortest_duration is not None
    assert reason.shortest_duration > 8.0
    longer = dataclasses.replace(scenario, grid=rho.Grid(reason.shortest_duration / 16, 17))
    assert rho.verify(rho.plan(longer)).ok


def test_known_shortest_durations() -> None:
    """Straight up, 16 steps, with twice the thrust of hovering.

    Upward with g for twelve steps and, upside down, back with 3 g for four: D = 96 g h². Upright
    throughout, upward with g for eight steps and back with g: D = 64 g h².
    """
    up = rho.State([0.0, 0.0, 100.0])
    for tilt, squares in ((None, 96.0), (0.3, 64.0)):
        scenario = single(goal=up, limits=rho.Limits(max_thrust=2.0 * G, max_tilt=tilt))
        known = 16.0 * np.sqrt(100.0 / (squares * G))
        found = rho.shortest_plan(scenario).scenario.grid.duration
        assert known * (1.0 - 1e-6) <= found <= known * (1.0 + 2 * PRECISION)


@pytest.mark.slow
def test_the_acceleration_factor_widens_the_largest_acceleration() -> None:
    """The flight has D = a T² / 4 along its path, in any direction."""
    scenario = single(limits=rho.Limits(max_acceleration=0.5))
    reason = rho.diagnose(scenario)
    far = float(np.linalg.norm([10.0, 4.0, -2.0]))
    assert reason.acceleration_factor == pytest.approx(4 * far / 64.0 / 0.5, rel=2 * PRECISION)
    assert reason.shortest_duration == pytest.approx(np.sqrt(4 * far / 0.5), rel=2 * PRECISION)
    both = rho.Limits(acceleration=box(0.5), max_acceleration=0.6)
    reason = rho.diagnose(single(limits=both))
    known = max(4 * 10.0 / 64.0 / 0.5, 4 * far / 64.0 / 0.6)
    assert reason.acceleration_factor == pytest.approx(known, rel=2 * PRECISION)


def test_a_slower_flight_is_feasible_where_it_is_monotone() -> None:
    limits = rho.Limits(max_speed=1.9, max_acceleration=0.9, max_thrust=10.0, max_tilt=0.095)
    scenario = single(limits=limits)
    assert is_monotone(scenario)
    plan = rho.plan_convex(scenario)
    for factor in (1.1, 3.0):
        grid = rho.Grid(0.5 * factor, 17)
        slower = rho.Plan.from_accelerations(
            single(limits=limits, grid=grid), plan.accelerations / factor**2
        )
        assert rho.verify(slower).ok


def test_the_least_violation_of_each_limit_is_finite_and_reported() -> None:
    for limits, _ in CASES.values():
        tight: dict[str, Any] = {
            name: 9.811 if name == "max_thrust" else 0.2 * value
            for name, value in dataclasses.asdict(limits).items()
            if value is not None
        }
        plan = minimum_violation(Problem.of(single(limits=rho.Limits(**tight))))
        assert np.abs(plan.accelerations).max() < 100.0
        assert not rho.verify(plan).ok


@pytest.mark.parametrize("coupling", [*slow(rho.coupled), rho.decoupled])
def test_every_vehicle_of_a_fleet_satisfies_its_own_limits(coupling: object) -> None:
    limits = rho.Limits(max_acceleration=0.55, max_thrust=9.84, max_tilt=0.056)
    scenario = through_the_middle(4, limits=limits)
    weak = dataclasses.replace(scenario.vehicles[0], limits=rho.Limits(max_tilt=0.05))
    scenario = dataclasses.replace(scenario, vehicles=(weak, *scenario.vehicles[1:]))
    plan = rho.plan_scp(scenario, coupling=coupling)  # type: ignore[arg-type]  # a coupling
    report = rho.verify(plan)
    assert report.ok
    found = {each.vehicle: each.limit for each in report.checks if "tilt" in each.constraint}
    assert found == {"v0": 0.05, "v1": 0.056, "v2": 0.056, "v3": 0.056}
    tilts = _limited_values(plan.accelerations)["maximum tilt"].max(axis=1)
    assert tilts[0] <= 0.05 * (1.0 + 1e-6) < tilts[1:].min()


def test_only_vehicles_with_a_limit_are_checked_for_it() -> None:
    scenario = fleet([[0, 0, 0], [0, 5, 0]], [[9, 0, 0], [9, 5, 0]])
    for field, most in (("max_acceleration", 0.41), ("max_thrust", 9.8155), ("max_tilt", 0.042)):
        own = rho.Limits(**{field: most})  # type: ignore[arg-type]  # a field and its value
        weak = dataclasses.replace(scenario.vehicles[0], limits=own)
        plan = rho.plan_convex(dataclasses.replace(scenario, vehicles=(weak, scenario.vehicles[1])))
        report = rho.verify(plan)
        assert report.ok
        (check,) = (check for check in report.checks if check.constraint.startswith("maximum"))
        assert (check.vehicle, check.limit) == ("v0", most)
        free = rho.Plan.from_accelerations(plan.scenario, rho.plan_convex(scenario).accelerations)
        (violation,) = rho.verify(free).violations
        assert (violation.vehicle, violation.constraint) == ("v0", check.constraint)


@pytest.mark.parametrize("replan_every", [1, 5])
@pytest.mark.parametrize("kind", CASES)
def test_windows_satisfy_the_limits(kind: str, replan_every: int) -> None:
    """Windows begin with an acceleration that is at the limit."""
    sphere, limits = rho.Sphere([6.0, 2.0, -1.0], 0.8), CASES[kind][0]
    # with less, the capability left to one window is missing in a later one
    if limits.max_thrust is not None:
        limits = rho.Limits(max_thrust=9.99)
    scenario = single(start=TURNING, limits=limits, obstacles=(sphere,), between_knots=True)
    flight = rho.plan_rho(scenario, replan_every=replan_every)
    assert rho.verify(flight).ok
    assert not any(window.infeasible for window in flight.windows)
    (most,) = (v for v in dataclasses.asdict(scenario.limits).values() if v is not None)
    starts = [window.plan.scenario.vehicles[0].start.acceleration for window in flight.windows[1:]]
    values = _limited_values(np.array(starts))[kind]
    assert values.max() <= most * (1.0 + 1e-14)
    if replan_every == 1:
        assert values.max() > most * (1.0 - 1e-6)


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        (rho.Limits(max_acceleration=1.0), "a norm of at most 1, not 1.414214"),
        (rho.Limits(max_thrust=10.0), "a thrust of at most 10, not 10.85615"),
        (rho.Limits(max_tilt=0.05), "a tilt of at most 0.05, not 0.09224"),
    ],
)
def test_a_start_that_violates_a_limit_is_refused(limits: rho.Limits, expected: str) -> None:
    with pytest.raises(rho.ScenarioError) as caught:
        single(limits=limits, start=rho.State([0, 0, 0], acceleration=[1.0, 0.0, 1.0]))
    assert caught.value.field == "scenario.vehicles[0].start.acceleration"
    assert expected in str(caught.value)


def test_invalid_limits_are_refused() -> None:
    for field, value in (
        ("max_acceleration", 0.0),
        ("max_thrust", 9.8),
        ("max_tilt", 0.0),
        ("max_tilt", np.pi / 2.0),
        ("max_tilt", -0.1),
    ):
        with pytest.raises(rho.ScenarioError) as caught:
            rho.Limits(**{field: value})  # type: ignore[arg-type]  # a field and its value
        assert caught.value.field == f"limits.{field}"
        assert caught.value.value == value


@pytest.mark.parametrize(
    ("degrees", "expected"),
    [
        (30, "radians, less than a right angle; 30° are 0.5236 rad"),
        (90.0, "radians, less than a right angle"),
        (np.inf, "radians, less than a right angle"),
    ],
)
def test_the_error_of_a_tilt_in_degrees_gives_it_in_radians(degrees: float, expected: str) -> None:
    with pytest.raises(rho.ScenarioError) as caught:
        rho.Limits(max_tilt=degrees)
    assert str(caught.value) == f"limits.max_tilt: got {degrees}, expected an angle in {expected}"


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("max_velocity", "max_speed"),
        ("speed", "max_speed"),
        ("max_speeed", "max_speed"),
        ("velocty", "velocity"),
    ],
)
def test_the_error_of_a_limit_by_another_name_suggests_the_field(name: str, meant: str) -> None:
    with pytest.raises(rho.ScenarioError, match=f"no field of this name; did you mean {meant}\\?$"):
        rho.Limits(**{name: 3.0})  # type: ignore[arg-type]  # of another name


def test_files_and_schema_preserve_the_limits() -> None:
    limits = rho.Limits(max_speed=3.0, max_acceleration=4.0, max_thrust=15.0, max_tilt=0.6)
    own = rho.Vehicle("own", rho.State([0, 0, 0]), rho.State([1, 0, 0]), rho.Limits(max_tilt=0.2))
    scenario = dataclasses.replace(single(limits=limits), vehicles=(own,))
    assert from_yaml(as_yaml(scenario)) == scenario
    merged = scenario.limits_of(own)
    assert merged == dataclasses.replace(limits, max_tilt=0.2)
    fields = rho.scenario_schema()["$defs"]["Limits"]["properties"]
    for field, unit in (("max_acceleration", "m/s²"), ("max_thrust", "m/s²"), ("max_tilt", "rad")):
        assert f"[{unit}]" in fields[field]["description"]


def test_every_constraint_has_a_key_of_its_own() -> None:
    limits = rho.Limits(box(50), box(5), box(5), box(5), 3.0, 4.0, 15.0, 0.6)
    constraints = Problem.of(single(limits=limits)).convex
    assert len(constraints) == 8
    assert len({each.key for each in constraints}) == 8
    assert len({each.name for each in constraints}) == 8


def test_a_vehicle_upside_down_is_brought_upright() -> None:
    """The values are below the cone's apex: downward thrust is not allowed."""
    down = rho.State([0.0, 0.0, -60.0])
    grid = rho.Grid(0.25, 17)
    free = rho.plan_convex(single(goal=down, grid=grid))
    assert free.accelerations[..., 2].min() < -2.0 * G
    falling = single(goal=down, grid=grid, limits=rho.Limits(max_tilt=0.4))
    plan = rho.plan_convex(falling)
    assert rho.verify(plan).ok
    assert plan.accelerations[..., 2].min() == pytest.approx(-G, rel=1e-6)
    assert plan.cost == pytest.approx(twin_cost(falling), rel=TWIN)
    checked = rho.verify(rho.Plan.from_accelerations(falling, free.accelerations))
    assert [each.constraint for each in checked.violations] == ["maximum tilt"]
    assert checked.violations[0].value == pytest.approx(np.pi)
