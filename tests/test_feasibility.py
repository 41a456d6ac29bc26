"""Diagnoses: known answers, and suggestions that work."""

from __future__ import annotations

import dataclasses
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings

import drake_rho as rho
from drake_rho.analysis.trials import PRECISION, PRECISION_WITH_SEPARATION, is_monotone
from drake_rho.planning.planners.related import rescaled
from tests.scenarios import box, scenarios, single, slow, through_the_middle


def test_bang_bang_is_the_shortest_from_rest_to_rest() -> None:
    """D = a T² / 4 on the longest axis."""
    weak = single(limits=rho.Limits(acceleration=box(0.5)))
    reason = rho.diagnose(weak)
    assert not reason.feasible
    assert reason.is_monotone
    assert reason.shortest_duration == pytest.approx(np.sqrt(4 * 10.0 / 0.5), rel=2 * PRECISION)
    assert reason.acceleration_factor == pytest.approx(4 * 10.0 / 8.0**2 / 0.5, rel=2 * PRECISION)
    assert reason.conflicts == {"solo": ("goal x", "acceleration box x from 0 s to 7.5 s")}
    assert {check.constraint for check in reason.violations} == {"goal"}


def test_the_printed_suggestions_are_sufficient() -> None:
    weak = 0.0944444444
    start, goal = rho.State([0, 0, 0]), rho.State([10, 0, 0])

    def scaled(factor: float, step: float = 1.0) -> rho.Scenario:
        limits = rho.Limits(acceleration=box(factor * weak))
        return single(limits=limits, grid=rho.Grid(step, 11), start=start, goal=goal)

    text = str(rho.diagnose(scaled(1.0)))
    strong = float(text.split("acceleration: ±")[1].split()[0])
    step = float(text.split("a step of ")[1].split()[0])
    assert rho.verify(rho.plan_scp(scaled(strong / weak))).ok
    assert rho.verify(rho.plan_scp(scaled(1.0, step))).ok


def test_no_plan_is_shorter_than_the_shortest() -> None:
    weak = single(limits=rho.Limits(acceleration=box(0.5), velocity=box(2.0)))
    plan = rho.shortest_plan(weak)
    assert rho.verify(plan).ok
    assert plan.scenario.grid.knots == weak.grid.knots
    shorter = rho.Grid(plan.scenario.grid.step * (1 - 2 * PRECISION), weak.grid.knots)
    with pytest.raises(rho.InfeasibleError):
        rho.plan_scp(dataclasses.replace(weak, grid=shorter))


def test_a_feasible_scenario_has_no_conflict_and_a_shorter_duration() -> None:
    reason = rho.diagnose(single(limits=rho.Limits(acceleration=box(2.0))))
    assert reason.feasible
    assert reason.violations == ()
    assert reason.acceleration_factor == 1.0
    assert reason.shortest_duration == pytest.approx(np.sqrt(4 * 10.0 / 2.0), rel=2 * PRECISION)
    assert "there is a plan" in str(reason)


@pytest.mark.slow
@given(scenario=scenarios(tight=True, between_knots=True))
@settings(max_examples=3)
def test_suggestions_of_a_diagnosis_work(scenario: rho.Scenario) -> None:
    scenario = scenario.without_obstacles()
    reason = rho.diagnose(scenario)
    assume(not reason.feasible)
    _check_suggestions(scenario, reason)


def test_suggestions_of_a_diagnosis_work_past_an_obstacle() -> None:
    weak = single(
        limits=rho.Limits(acceleration=box(0.5)),
        obstacles=(rho.Sphere([5.0, 2.3, -1.0], 1.0),),
        between_knots=True,
    )
    reason = rho.diagnose(weak)
    assert not reason.feasible
    assert reason.shortest_duration is not None
    assert reason.acceleration_factor is not None
    _check_suggestions(weak, reason)


def _check_suggestions(scenario: rho.Scenario, reason: rho.Diagnosis) -> None:
    assert set(reason.conflicts) <= {vehicle.name for vehicle in scenario.vehicles}
    assert reason.violations
    if reason.shortest_duration is not None:
        step = reason.shortest_duration / (scenario.grid.knots - 1)
        longer = dataclasses.replace(scenario, grid=rho.Grid(step, scenario.grid.knots))
        assert rho.verify(rho.plan_scp(longer)).ok
    if reason.acceleration_factor is not None:
        limits = scenario.limits.acceleration
        assert limits is not None
        factor = reason.acceleration_factor
        wider = rho.Box(factor * limits.lower, factor * limits.upper)
        stronger = dataclasses.replace(
            scenario, limits=dataclasses.replace(scenario.limits, acceleration=wider)
        )
        assert rho.verify(rho.plan_scp(stronger)).ok


def test_an_error_carries_the_data_of_a_diagnosis() -> None:
    weak = single(limits=rho.Limits(acceleration=box(0.5)))
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan_rho(weak)
    assert caught.value.scenario == weak
    assert rho.diagnose(weak).conflicts == rho.infeasible_subset(caught.value)
    assert rho.infeasible_subset(rho.InfeasibleError({"a": ("b",)})) == {"a": ("b",)}


def _hurry(**limits: Any) -> rho.Scenario:
    """Return a flight of 20 m from rest to rest in 10 s, and less, under limits."""
    vehicles = [
        rho.Vehicle(name, rho.State([0, y, 2]), rho.State([far, y, 2]))
        for name, y, far in (("scout", 0.0, 20.0), ("other", 5.0, 8.0))
    ]
    return rho.Scenario("hurry", rho.Grid(0.25, 41), vehicles, limits=rho.Limits(**limits))


KNOWN = {"max_speed": 20.0 / (39 * 0.25), "max_acceleration": 4 * 20.0 / 10.0**2}
"""Least limits of 20 m in 10 s: full speed after the first step, and bang-bang."""


@pytest.mark.parametrize("field", ["max_speed", *slow("max_acceleration")])
def test_the_least_change_of_a_limit_is_known_and_suffices(field: str) -> None:
    reason = rho.diagnose(_hurry(**{field: 0.8 * KNOWN[field]}))
    time, change = reason.changes
    assert [each.limit for each in time.numbers] == ["duration"]
    (numbers,) = change.numbers
    assert (numbers.limit, numbers.now) == (field, (0.8 * KNOWN[field],))
    (needed,) = numbers.needed
    assert needed == pytest.approx(KNOWN[field], rel=5 * PRECISION)
    assert rho.verify(rho.plan(_hurry(**{field: needed}))).ok
    with pytest.raises(rho.InfeasibleError):
        rho.plan(_hurry(**{field: needed * (1.0 - 5 * PRECISION)}))
    for each in reason.changes:
        assert rho.verify(rho.plan(each.scenario)).ok


def test_what_is_missed_comes_first_with_its_vehicle_and_amount() -> None:
    reason = rho.diagnose(_hurry(max_acceleration=0.6))
    assert [(each.vehicle, each.kind) for each in reason.violations] == [("scout", "goals")]
    lines = str(reason).splitlines()
    assert lines[1] == "the motion with the least total violation misses:"
    assert lines[2] == f"  scout: goal position by {reason.violations[0].excess:.3g} m"


def test_limits_that_suffice_together_only_change_together() -> None:
    scenario = _hurry(**{field: 0.8 * least for field, least in KNOWN.items()})
    reason = rho.diagnose(scenario)
    together = reason.changes[-1]
    assert {each.limit for each in together.numbers} == set(KNOWN)
    assert rho.verify(rho.plan(together.scenario)).ok


def test_the_error_of_a_planner_is_diagnosed_without_another_search() -> None:
    scenario, reported = _hurry(max_speed=1.5), list[str]()
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan(scenario)
    reason = rho.diagnose(caught.value, progress=reported.append)
    assert str(reason) == str(rho.diagnose(scenario))
    assert reported[0] == "looking for the least violation"


@pytest.mark.slow
def test_a_gap_that_is_too_narrow_gives_the_largest_radius() -> None:
    """A vehicle as wide as the gap fits, as does one in a higher room."""
    walls = [rho.Box([4.5, 0.35, -9], [5.5, 9, 9]), rho.Box([4.5, -9, -9], [5.5, -0.35, 9])]
    vehicle = rho.Vehicle("v", rho.State([0, 0, 3]), rho.State([10, 0, 3]), radius=0.5)
    room = rho.Limits(position=rho.Box([-2, -7, 0], [12, 7, 8]))
    scenario = rho.Scenario("gap", rho.Grid(0.5, 17), [vehicle], obstacles=walls, limits=room)
    found = {each.numbers[0].limit: each for each in rho.diagnose(scenario).changes}
    assert found["radius"].numbers[0].needed[0] == pytest.approx(0.35, rel=5e-3)
    for each in found.values():
        assert rho.verify(rho.plan(each.scenario)).ok


@pytest.mark.slow
def test_a_diagnosis_says_that_more_time_does_not_help() -> None:
    walls = rho.Limits(position=rho.Box([-1, -2, -3], [11, 6, 1]))
    wall = rho.Sphere([5.0, 2.0, -1.0], 4.9)
    reason = rho.diagnose(single(limits=walls, obstacles=(wall,), between_knots=True))
    assert not reason.feasible
    assert reason.shortest_duration is None
    (change,) = reason.changes
    assert [each.limit for each in change.numbers] == ["position"]
    assert rho.verify(rho.plan(change.scenario)).ok
    with pytest.raises(rho.ScenarioError, match="there is no least time"):
        rho.shortest_plan(reason.scenario)
    bound = dataclasses.replace(walls, max_speed=50.0)
    with pytest.raises(rho.InfeasibleError):
        rho.shortest_plan(dataclasses.replace(reason.scenario, limits=bound))


def test_monotone_is_claimed_from_rest_to_rest_only() -> None:
    assert is_monotone(single(limits=rho.Limits(box(50), box(2), box(2), box(2))))
    assert not is_monotone(single(start=rho.State([0, 0, 0], [1, 0, 0])))
    assert not is_monotone(single(obstacles=(rho.Sphere([5, 2, -1], 1),)))
    assert not is_monotone(through_the_middle(2))
    assert is_monotone(through_the_middle(2).without_separation())
    forward = rho.Limits(velocity=rho.Box([0.1, -2, -2], [2, 2, 2]))
    with pytest.raises(rho.ScenarioError):  # at rest it would not move forward
        single(limits=forward)


def test_two_vehicles_that_pass_each_other_take_no_longer_than_one() -> None:
    """They pass sideways, where there is room and strength: D = a T² / 4 along the path."""
    limits = rho.Limits(rho.Box([-6, -6, -0.1], [6, 6, 0.1]), acceleration=box(0.9))
    reason = rho.diagnose(through_the_middle(2, limits=limits, grid=rho.Grid(6.6 / 20, 21)))
    assert set(reason.conflicts) == {"v0", "v1"}
    shortest = np.sqrt(4 * 10.0 / 0.9)
    assert reason.shortest_duration == pytest.approx(shortest, rel=2 * PRECISION_WITH_SEPARATION)
    assert "or perhaps less" in str(reason)


@pytest.mark.slow
def test_the_violation_of_two_vehicles_that_cannot_pass_is_reported() -> None:
    """With two steps the only motion from rest to rest passes through the middle together."""
    reason = rho.diagnose(through_the_middle(2, grid=rho.Grid(5.0, 3)))
    assert set(reason.conflicts) == {"v0", "v1"}
    assert str(reason).count("separation from") == 1
    assert all("separation" in str(names) for names in reason.conflicts.values())
    assert {check.constraint for check in reason.violations} == {"separation"}
    assert reason.violations[0].excess == pytest.approx(1.0)
    assert reason.violations[0].time == pytest.approx(5.0)
    assert reason.shortest_duration is None
    assert "no plan was found with more time" in str(reason)


def test_another_duration_begins_at_the_same_time_and_obstacles_stay_on_the_clock() -> None:
    ball = rho.Sphere([5.0, 9.0, -1.0], 1.0)
    track = rho.Track([100.0, 106.0], [[5, 9, -1], [5, 20, -1]])
    obstacles = (
        ball,
        rho.Obstacle(ball, track=track, known_from=101.0),
        rho.Obstacle(ball, known_from=107.0, name="late"),
    )
    scenario = single(grid=rho.Grid(0.5, 17, 100.0), obstacles=obstacles)
    for factor in (0.5, 0.1, 3.0):
        other = rescaled(scenario, factor)
        assert other.grid == rho.Grid(0.5 * factor, 17, 100.0)
        for old, new in zip(scenario.bodies, other.bodies, strict=True):
            assert new == dataclasses.replace(old, known_from=min(old.known_from, other.grid.end))
            times = np.linspace(100.0, 110.0, 11)
            np.testing.assert_array_equal(new.centers(times), old.centers(times))
    assert not is_monotone(scenario)


def test_an_obstacle_known_after_a_shorter_end_does_not_end_the_search() -> None:
    """The shortest flight takes 6.4 s, and the obstacle, far away, is known at 7.9 s."""
    far = rho.Obstacle(rho.Sphere([0.0, 99.0, 0.0], 1.0), known_from=7.9)
    scenario = single(limits=rho.Limits(acceleration=box(1.0)), obstacles=(far,))
    shortest = rho.shortest_plan(scenario).scenario.grid.duration
    assert shortest == pytest.approx(np.sqrt(4 * 10.0 / 1.0), rel=2e-3)


def _walled() -> rho.Scenario:
    """Return a flight through a wall of voxels that is as wide and high as the room."""
    voxels = [[0, y, z] for y in range(6) for z in range(6)]
    wall = rho.Obstacle(rho.Voxels(voxels, 0.75, [4.0, -2.25, -2.25]))
    vehicle = rho.Vehicle("v", rho.State([0, 0, 0]), rho.State([8, 0, 0]), radius=0.3)
    room = rho.Box([-1, -2, -2], [9, 2, 2])
    limits = rho.Limits(position=room, max_speed=3.0, max_acceleration=3.0, max_jerk=9.0)
    return rho.Scenario("walled", rho.Grid(0.5, 13), [vehicle], limits=limits, obstacles=[wall])


@pytest.mark.parametrize(("work", "finds"), [(60.0, False), (150.0, True)])
def test_a_diagnosis_does_a_bounded_amount_of_work_and_says_what_it_left_out(
    work: float, finds: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan(_walled())
    monkeypatch.setattr(sys.modules["drake_rho.analysis.diagnose"], "_WORK", work)
    told = list[str]()
    reason = rho.diagnose(caught.value, progress=told.append)
    trials = {each.split(": l")[0] for each in told if each.startswith("trying")}
    assert 0 < len(trials) <= work
    assert reason.cut
    assert reason.violations
    assert "not everything was tried to the end" in str(reason)
    assert bool(reason.changes) == finds
    assert ("position" in reason.untried) == (not finds)
    assert all(limit in str(reason) for limit in reason.untried)
    assert all(rho.verify(rho.plan(each.scenario)).ok for each in reason.changes)
    assert str(rho.diagnose(caught.value)) == str(reason)


def test_a_time_limit_replaces_the_bound_on_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = rho.diagnose(_walled())
    assert not whole.cut
    monkeypatch.setattr(sys.modules["drake_rho.analysis.diagnose"], "_WORK", 1.0)
    assert rho.diagnose(_walled()).cut
    assert str(rho.diagnose(_walled(), time_limit=1e6)) == str(whole)
