"""The verifier finds violations, quantifies them, and relies on no one else's computation."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given

import drake_rho as rho
from tests.scenarios import acceleration_outside, box, examples, scenarios, single


@pytest.fixture(scope="module")
def plan() -> rho.Plan:
    """Return a plan under limits of every kind, past an obstacle."""
    limits = rho.Limits(box(30), box(3), box(2), box(2), max_speed=2.5)
    return rho.plan_scp(single(limits=limits, obstacles=(rho.Sphere([5.0, 2.3, -1.0], 1.0),)))


def test_a_good_plan_passes_every_check(plan: rho.Plan) -> None:
    report = rho.verify(plan)
    assert report.ok
    assert not report.violations
    kinds = {check.constraint for check in report.checks}
    assert kinds == {
        "dynamics",
        "goal",
        "position box",
        "velocity box",
        "acceleration box",
        "jerk box",
        "maximum speed",
        "obstacle 1",
    }


@pytest.mark.parametrize("quantity", ["positions", "velocities"])
def test_inconsistent_states_are_found(plan: rho.Plan, quantity: str) -> None:
    states = np.array(getattr(plan, quantity))
    states[0, 7, 1] += 0.01
    changed: dict[str, Any] = {quantity: states}
    report = rho.verify(dataclasses.replace(plan, **changed))
    (violation,) = report.violations
    assert violation.constraint == "dynamics"
    assert violation.time == 3.5
    assert violation.excess == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("kind", "limits", "limit"),
    [
        ("position box", rho.Limits(position=rho.Box([-1, -9, -9], [10, 9, 9])), 1.0),
        ("velocity box", rho.Limits(velocity=box(1.0)), 1.0),
        ("acceleration box", rho.Limits(acceleration=box(0.5)), 0.5),
        ("jerk box", rho.Limits(jerk=box(0.2)), 0.2),
    ],
)
def test_a_violated_box_is_named_with_value_limit_and_excess(
    kind: str, limits: rho.Limits, limit: float
) -> None:
    goal = rho.State([10.0, 4.0, -2.0], [0.0, 0.0, 0.0])
    start = rho.State([0.0, 0.0, 0.0], [-2.0, 0.0, 0.0] if kind == "position box" else [0, 0, 0])
    free = rho.plan_convex(single(start=start, goal=goal))
    scenario = single(start=start, goal=goal, limits=limits)
    (violation, *_) = rho.verify(
        rho.Plan.from_accelerations(scenario, free.accelerations)
    ).violations
    assert violation.vehicle == "solo"
    assert violation.constraint == kind
    assert violation.excess == pytest.approx(abs(violation.value) - abs(violation.limit))
    assert abs(violation.limit) == limit


def test_a_dip_is_named_with_obstacle_time_and_depth() -> None:
    spheres = (rho.Sphere([-5.0, 0.0, 0.0], 1.0), rho.Sphere([5.0, 2.0, -1.0], 1.0))
    scenario = single(obstacles=spheres)
    through = rho.plan_convex(scenario.without_obstacles())
    (violation,) = rho.verify(dataclasses.replace(through, scenario=scenario)).violations
    assert violation.constraint == "obstacle 2"
    assert violation.time == 4.0
    assert violation.value == pytest.approx(-1.0, abs=1e-9)  # in its centre
    assert violation.limit == 0.0
    assert violation.excess == pytest.approx(1.0)
    assert "obstacle 2" in str(rho.verify(dataclasses.replace(through, scenario=scenario)))


def test_the_smallest_excess_over_the_tolerance_is_found() -> None:
    limit = 1.0
    scenario = single(limits=rho.Limits(acceleration=box(limit)))
    plan = rho.plan_convex(scenario)
    tolerance = 1e-6 * np.linalg.norm([10.0, 4.0, -2.0]) / 8.0**2
    for beyond, ok in ((0.9, True), (1.1, False)):
        a = np.array(plan.accelerations)
        a[0, 0, 0] = limit + beyond * tolerance
        checks = rho.verify(rho.Plan.from_accelerations(scenario, a)).checks
        (check,) = (check for check in checks if check.constraint == "acceleration box")
        assert check.holds == ok


def test_a_wide_side_does_not_loosen_another() -> None:
    """A ceiling of 3 m counts, whatever number stands for "no limit" on the other axes."""
    start, goal = rho.State([0, 0, 1], [0, 0, 2]), rho.State([20, 0, 1])
    wide = rho.Limits(
        position=rho.Box([-1e9, -1e9, -1e9], [1e9, 1e9, 3.0]),
        velocity=rho.Box([-1e9, -1e9, -1e9], [1e9, 1e9, 2.0]),
    )
    free = rho.plan_convex(single(start=start, goal=goal))
    assert free.positions[0, :, 2].max() > 3.3
    plan = rho.plan_convex(single(start=start, goal=goal, limits=wide))
    assert plan.positions[0, :, 2].max() <= 3.0 + 1e-4
    through = rho.Plan.from_accelerations(plan.scenario, free.accelerations)
    assert not rho.verify(through).ok


def test_a_flight_can_be_verified_directly(paper: rho.Scenario) -> None:
    flight = rho.plan_rho(paper)
    assert rho.verify(flight) == rho.verify(flight.plan)


def test_nan_never_passes(plan: rho.Plan) -> None:
    a = np.array(plan.accelerations)
    a[0, 3, 2] = np.nan
    with pytest.raises(ValueError, match=r"accelerations: got nan for .* at knot 3"):
        rho.verify(rho.Plan.from_accelerations(plan.scenario, a))


def test_a_long_list_of_violations_is_cut(paper: rho.Scenario) -> None:
    vehicles = tuple(
        dataclasses.replace(paper.vehicles[0], name=f"UAV-{number}") for number in range(20)
    )
    many = dataclasses.replace(paper, vehicles=vehicles)
    report = rho.verify(rho.Plan.from_accelerations(many, np.zeros((20, 49, 3))))
    assert len(report.violations) == 40
    lines = str(report).splitlines()
    assert len(lines[lines.index("") :]) == 17  # the last is the note
    assert lines[-3] == "… and 28 more"
    every = report.printed(every_row=True)
    assert sum("VIOLATED" in row for row in every.rows) == 40


def test_the_vehicle_named_as_closest_is_the_closest() -> None:
    """Tolerances differ from vehicle to vehicle; the excess alone determines the closest."""
    # the short flight takes 0.2 m/s², the long one 1.2 of 2
    own = rho.Limits(acceleration=box(0.5))
    vehicles = (
        rho.Vehicle("long", rho.State([0, 0, 0]), rho.State([500, 0, 0])),
        rho.Vehicle("short", rho.State([0, 9, 0]), rho.State([78, 9, 0]), own),
    )
    limits = rho.Limits(acceleration=box(2.0))
    scenario = rho.Scenario("two", rho.Grid(1.0, 51), vehicles, limits)
    report = rho.verify(rho.plan_convex(scenario))
    assert report.ok
    boxes = [check for check in report.checks if check.constraint == "acceleration box"]
    closest = max(boxes, key=lambda check: check.excess)
    assert closest.vehicle == "short"
    (row,) = (row for row in str(report).splitlines() if "acceleration box" in row)
    assert row.split()[-4] == "short"


def test_each_unit_has_a_row_of_the_report(plan: rho.Plan) -> None:
    report = rho.verify(plan)
    rows = str(report.printed(every_row=True)).splitlines()
    for what in ("dynamics position", "dynamics velocity", "goal position", "goal velocity"):
        assert sum(what in row for row in rows) == 1
        assert what not in str(report)  # only rounding is left of an equality that holds


def test_every_row_says_whether_it_holds(plan: rho.Plan) -> None:
    assert not plan.scenario.between_knots
    for every_row, held in ((True, "holds"), (False, "")):
        for row in rho.verify(plan).printed(every_row=every_row).rows:
            assert row[-1] == ("not required" if "at all times" in row[0] else held)
    coasting = rho.Plan.from_accelerations(plan.scenario, np.zeros_like(plan.accelerations))
    rows = rho.verify(coasting).printed().rows
    assert rows
    assert all(row[-1] == "VIOLATED" for row in rows)


def test_a_violated_side_is_named_before_a_larger_excess_within_tolerance() -> None:
    """The tolerance of a narrow side is a thousandth of a wide one's."""
    limits = rho.Limits(acceleration=rho.Box([-1.0, -1.0, -1e-6], [1.0, 1.0, 1e-6]))
    goal = rho.State([10.0, 0.0, 0.0])
    scenario = single(goal=goal, limits=limits)
    a = np.array(rho.plan_convex(scenario).accelerations)
    wide, _, narrow = scenario.fleet.bounds("acceleration").tolerances[0]  # type: ignore[union-attr]
    a[0, 0] = [1.0 + 0.5 * wide, 0.0, 1e-6 + 3.0 * narrow]
    assert 3.0 * narrow < 0.5 * wide
    checks = rho.verify(rho.Plan.from_accelerations(scenario, a)).checks
    (check,) = (check for check in checks if check.constraint == "acceleration box")
    assert (check.part, check.holds) == ("z upper", False)


@pytest.mark.parametrize("huge", [1e100, 1e160, 1e300])
def test_huge_numbers_are_verified_without_warnings(plan: rho.Plan, huge: float) -> None:
    far = rho.Vehicle("other", rho.State([0, 50, 0]), rho.State([0, 60, 0]))
    scenario = dataclasses.replace(
        plan.scenario,
        vehicles=(*plan.scenario.vehicles, far),
        separation=rho.Separation(0.1),
        between_knots=True,
        limits=rho.Limits(box(90), box(3), box(2), box(2), max_speed=3.0, max_tilt=0.5),
    )
    a = np.zeros((2, *plan.accelerations.shape[1:]))
    a[0, 3, 2], a[1, 5] = huge, [-huge, huge, 0.0]
    flown = rho.Plan.from_accelerations(scenario, a)
    report = rho.verify(flown)  # warnings are errors in tests
    assert not report.ok
    assert "acceleration box" in {check.constraint for check in report.violations}
    assert str(report)


@given(scenario=scenarios())
@examples(few=8, many=15)
def test_random_plans_hold_in_an_independent_check(scenario: rho.Scenario) -> None:
    """Random scenarios are solved and verified, here by plain loops, or raise."""
    try:
        plan = rho.plan_scp(scenario)
    except rho.InfeasibleError:
        return
    assert rho.verify(plan).ok
    h = scenario.grid.step
    for index, vehicle in enumerate(scenario.vehicles):
        limits = scenario.limits_of(vehicle)
        p, v = vehicle.start.position.copy(), vehicle.start.velocity.copy()
        before, after = map(acceleration_outside, (vehicle.start, vehicle.goal))
        way = scenario.fleet.lengths[scenario.index_of(vehicle.name)]
        for a in plan.accelerations[index]:
            for sphere in scenario.spheres:
                assert np.linalg.norm(p - sphere.center) >= sphere.radius * (1 - 2e-6)
            jerk = np.nan_to_num((a - before) / h)
            T = scenario.grid.duration
            for value, bounds, scale in (
                (p, limits.position, 1.0),
                (v, limits.velocity, T),
                (a, limits.acceleration, T**2),
                (jerk, limits.jerk, T**2 * h),
            ):
                if bounds is not None:
                    room = 2e-6 * way / scale
                    assert np.all(value >= bounds.lower - room)
                    assert np.all(value <= bounds.upper + room)
            p, v, before = p + h * v + h**2 / 2 * a, v + h * a, a
        if limits.jerk is not None:
            jerk, room = np.nan_to_num((after - before) / h), 2e-6 * way / (T**2 * h)
            assert np.all((jerk >= limits.jerk.lower - room) & (jerk <= limits.jerk.upper + room))
        assert np.linalg.norm(p - vehicle.goal.position) <= 1e-6 * way
        assert np.linalg.norm(v - vehicle.goal.velocity) <= 1e-6 * way / scenario.grid.duration


def test_the_closest_of_many_obstacles_are_reported() -> None:
    spheres = [rho.Sphere([5.0, 5.0 + 3.0 * number, 0.0], 1.0) for number in range(30)]
    scenario = single(obstacles=spheres[::-1], goal=rho.State([10.0, 0.0, 0.0]), between_knots=True)
    free = rho.plan_convex(scenario.without_obstacles())
    report = rho.verify(dataclasses.replace(free, scenario=scenario))
    assert len([check for check in report.checks if "obstacle" in check.constraint]) == 60
    rows = str(report).splitlines()
    reported = [row.split()[1] for row in rows if row.startswith("obstacle")]
    assert reported == [str(number) for number in range(19, 31)]
    assert rows[-2] == "… and 18 more obstacles, further away"
