"""Rest means rest: jerks are limited from the acceleration before a start to that after a goal."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ruckig

import drake_rho as rho
from tests.scenarios import box, single, slow

KNOTS = 80

CLOSE = 2e-3
"""Relative, for least times T + h on 80 knots: what steps of that length cost."""

EXACT = 1e-6
"""Relative, for limits and times: accuracy of planners."""

HOP = rho.Limits(max_speed=5.0, max_acceleration=4.0, max_jerk=4.0)


def hop(start: rho.State, goal: rho.State, limits: rho.Limits, knots: int = KNOTS) -> rho.Scenario:
    """Return one vehicle whose final time is to be found."""
    return single(start=start, goal=goal, limits=limits, grid=rho.Grid(0.1, knots))


def least_time(start: rho.State, goal: rho.State, limits: rho.Limits) -> float:
    """Return the least time with jerks that are step functions [s], by Ruckig."""
    given, motion = ruckig.InputParameter(3), ruckig.Trajectory(3)
    given.current_position, given.target_position = list(start.position), list(goal.position)
    given.current_velocity, given.target_velocity = list(start.velocity), list(goal.velocity)
    for state, field in ((start, "current_acceleration"), (goal, "target_acceleration")):
        if state.acceleration is not None:
            setattr(given, field, list(state.acceleration))
    for quantity in ("velocity", "acceleration", "jerk"):
        setattr(given, f"max_{quantity}", list(getattr(limits, quantity).upper))
    ruckig.Ruckig(3).calculate(given, motion)
    return float(motion.duration)


def drawn(seed: int, axes: int) -> tuple[rho.State, rho.Limits]:
    """Return a random goal of a motion from rest at zero, and limits of which each may matter."""
    rng = np.random.default_rng([seed, axes])
    length, time = 10.0 ** rng.uniform(-2.0, 3.0), 10.0 ** rng.uniform(-1.0, 1.0)
    way = np.zeros(3)
    way[:axes] = length * rng.uniform(0.1, 1.0, axes) * rng.choice([-1.0, 1.0], axes)
    most = [rng.uniform(*ends, 3) for ends in ((0.3, 1.5), (0.5, 4.0), (4.0, 30.0))]
    speed, acceleration, jerk = (
        rho.Box(-each * unit, each * unit)
        for each, unit in zip(most, _units(length, time), strict=True)
    )
    return rho.State(way), rho.Limits(velocity=speed, acceleration=acceleration, jerk=jerk)


def _units(length: float, time: float) -> list[float]:
    return [length / time**power for power in (1, 2, 3)]


@pytest.mark.parametrize("axes", [1, 3])
@pytest.mark.parametrize("seed", [0, *slow(*range(1, 20))])
def test_least_times_with_limited_jerk_are_known(seed: int, axes: int) -> None:
    """Averaged over a step, a plan is a motion that Ruckig might choose, which lasts T + h."""
    goal, limits = drawn(seed, axes)
    start = rho.State([0, 0, 0])
    known = least_time(start, goal, limits)
    plan = rho.plan_minimum_time(hop(start, goal, limits).derived(grid=rho.Grid(known / 40, KNOTS)))
    grid = plan.scenario.grid
    assert rho.verify(plan).ok
    # a phase of full jerk may be shorter than a step, over which the acceleration steps at once
    assert limits.acceleration is not None
    assert limits.jerk is not None
    phase = min(grid.step, float((limits.acceleration.upper / limits.jerk.upper)[:axes].min()))
    assert known * (1.0 - EXACT) <= grid.duration + grid.step
    assert grid.duration + phase <= known * (1.0 + CLOSE)


def _averaged(state: rho.State, step: float, sign: float) -> rho.State:
    """Return the average over a step of constant acceleration, half a step before or after."""
    a, s = state.acceleration, sign * step / 2.0
    assert a is not None
    position = state.position + s * state.velocity + (s**2 / 2.0 + step**2 / 24.0) * a
    return rho.State(position, state.velocity + s * a, a)


@pytest.mark.parametrize("seed", [*range(2), *slow(2, 3)])
def test_given_accelerations_in_motion_are_what_a_plan_begins_and_ends_with(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start = rho.State([0, 0, 0], rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3))
    goal = rho.State(rng.uniform(3, 9, 3), rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3))
    limits = rho.Limits(velocity=box(3.0), acceleration=box(2.0), jerk=box(4.0))
    plan = rho.plan_minimum_time(hop(start, goal, limits))
    assert rho.verify(plan).ok
    assert rho.verify(plan).notes == ()
    grid = plan.scenario.grid
    before, after = _averaged(start, grid.step, -1.0), _averaged(goal, grid.step, 1.0)
    assert grid.duration + grid.step >= least_time(before, after, limits) * (1.0 - EXACT)
    jerks = plan.motion().jerks()[0]
    np.testing.assert_allclose(
        jerks[0], (plan.accelerations[0, 0] - start.acceleration) / grid.step, rtol=1e-12
    )
    np.testing.assert_allclose(
        jerks[-1], (goal.acceleration - plan.accelerations[0, -1]) / grid.step, rtol=1e-12
    )
    assert jerks.shape == (KNOTS, 3)
    assert np.abs(jerks).max() <= 4.0 * (1.0 + EXACT)


@pytest.mark.parametrize("given", [None, [0.0, 0.0, 0.0]])
def test_a_hop_from_rest_to_rest_takes_its_seven_phases(given: Any) -> None:
    """10 m at up to 5 m/s, 4 m/s² and 4 m/s³ take 4.317 s, without reaching the speed."""
    start, goal = rho.State([0, 0, 0], acceleration=given), rho.State([10, 0, 0])
    speed, a, jerk = 5.0, 4.0, 4.0
    ramp = speed / a + a / jerk  # time from rest to the largest speed [s]
    known = 2.0 * ramp + (10.0 - speed * ramp) / speed if speed * ramp <= 10.0 else None
    if known is None:  # the largest speed is not reached: v² / a + v a / jerk = 10
        top = (-(a**2) / jerk + np.sqrt(a**4 / jerk**2 + 4.0 * a * 10.0)) / 2.0
        known = 2.0 * (top / a + a / jerk)
    plan = rho.plan_minimum_time(hop(start, goal, HOP))
    grid = plan.scenario.grid
    assert known * (1.0 - EXACT) <= grid.duration + grid.step <= known * (1.0 + CLOSE)
    report = rho.verify(plan)
    assert report.ok
    assert report.notes == ()
    jumps = np.diff(plan.accelerations[0], axis=0, prepend=0.0, append=0.0)
    assert np.linalg.norm(jumps, axis=1).max() <= jerk * grid.step * (1.0 + EXACT)


@pytest.mark.parametrize("limit", [{"max_jerk": 2.0}, {"jerk": box(2.0)}, {}], ids=str)
def test_each_end_is_verified(limit: dict[str, Any]) -> None:
    asked = () if limit else (rho.KeepIn(rho.Box([-2.0] * 3, [2.0] * 3), of="jerk"),)
    scenario = dataclasses.replace(single(limits=rho.Limits(**limit)), requirements=asked)
    held = rho.plan(scenario)
    assert rho.verify(held).ok
    rise = np.linspace(0.5, 2.0, 16)[:, None] * [1.0, 0.0, 0.0]  # to rest within 0.5 s
    for end, accelerations in ((0, rise[::-1]), (-1, rise)):
        report = rho.verify(rho.Plan.from_accelerations(scenario, accelerations[None]))
        jerky = {"maximum jerk", "jerk box", "requirement 1"}
        times = [each.time for each in report.violations if each.constraint in jerky]
        assert scenario.grid.times[end] in times


def test_a_goal_acceleration_counts_like_one_before_the_start() -> None:
    """Turned in time, it is the same motion."""
    pushed = rho.State([0, 0, 0], [1, 0, 0], [-0.5, 0, -0.2])
    goal, limits = rho.State([10, 4, -2]), rho.Limits(max_jerk=1.0)
    there = rho.plan(single(start=pushed, goal=goal, limits=limits))
    turned = rho.State([0, 0, 0], [-1, 0, 0], [-0.5, 0, -0.2])
    back = rho.plan(single(start=goal, goal=turned, limits=limits))
    np.testing.assert_allclose(back.accelerations[:, ::-1], there.accelerations, atol=1e-5)
    plain = rho.plan(single(start=goal, goal=rho.State([0, 0, 0], [-1, 0, 0]), limits=limits))
    assert plain.cost < back.cost * (1.0 - EXACT)


def test_unknown_accelerations_in_motion_are_free_and_noted() -> None:
    start, goal = rho.State([0, 0, 0], [2, 0, 0]), rho.State([10, 4, -2], [0, 1, 0])
    plan = rho.plan(single(start=start, goal=goal, limits=rho.Limits(max_jerk=1.0)))
    report, jerks = rho.verify(plan), plan.motion().jerks()[0]
    assert report.ok
    assert [note.split(":")[0] for note in report.notes] == [
        "the jerk at the start is not limited for solo",
        "the jerk at the goal is not limited for solo",
    ]
    assert np.isnan(jerks[[0, -1]]).all()
    assert np.linalg.norm(jerks[1:-1], axis=1).max() <= 1.0 + EXACT
    unlimited = rho.plan(single(start=start, goal=goal))
    assert rho.verify(unlimited).notes == ()


@pytest.mark.parametrize("active", [(0.0, 0.4), (7.6, 8.0), (3.0, 4.0)])
def test_notes_on_requirements_are_about_the_ends_that_they_include(active: Any) -> None:
    start, goal = rho.State([0, 0, 0], [2, 0, 0]), rho.State([10, 4, -2], [0, 1, 0])
    asked = rho.KeepIn(rho.Ball([0, 0, 0], 1.0), of="jerk", active=active)
    scenario = dataclasses.replace(single(start=start, goal=goal), requirements=(asked,))
    notes = rho.verify(rho.plan(scenario)).notes
    ends = [end for end in ("start", "goal") if any(f"at the {end} " in note for note in notes)]
    assert ends == {0.0: ["start"], 7.6: ["goal"], 3.0: []}[active[0]]


def test_files_have_the_acceleration_after_a_goal(tmp_path: Path) -> None:
    goal = rho.State([10, 4, -2], [1, 0, 0], [0.5, 0, 0])
    scenario = single(goal=goal, limits=rho.Limits(max_jerk=1.0))
    rho.save_scenario(scenario, path := tmp_path / "pushed.yaml")
    assert rho.load_scenario(path) == scenario
    plan = rho.plan(scenario)
    rho.save(plan, tmp_path / "pushed.npz")
    again = rho.load(tmp_path / "pushed.npz").plan
    assert again.scenario.vehicles[0].goal.acceleration is not None
    np.testing.assert_array_equal(again.motion().jerks(), plan.motion().jerks())


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"limits": rho.Limits(max_acceleration=0.4)}, "goal.acceleration"),
        ({"hold_at_goal": True}, "goal.acceleration"),
        ({"limits": HOP, "smoothing": rho.Smoothing(0.2)}, "goal.acceleration"),
    ],
)
def test_what_a_goal_acceleration_contradicts_is_told(changes: Any, field: str) -> None:
    goal = rho.State([10, 4, -2], acceleration=[0.5, 0, 0])
    scenario = dataclasses.replace(single(between_knots=True), **changes)
    vehicle = dataclasses.replace(scenario.vehicles[0], goal=goal)
    with pytest.raises(rho.ScenarioError, match=field):
        dataclasses.replace(scenario, vehicles=(vehicle,))


@pytest.mark.parametrize("limit", [{"max_jerk": 4.0}, {"jerk": box(3.0)}], ids=str)
def test_flights_rest_after_their_arrival(limit: dict[str, Any]) -> None:
    """Windows go on from what was flown; arrivals and contingencies fall to rest within limits."""
    scenario = single(limits=rho.Limits(max_acceleration=2.0, **limit), grid=rho.Grid(0.25, 41))
    options = {"free_final_time": True}
    for flight in (rho.plan_rho(scenario, replan_every=3), rho.plan_rho(scenario, **options)):  # type: ignore[arg-type]
        assert rho.verify(flight).ok
        jumps = np.diff(flight.plan.accelerations[0], axis=0, prepend=0.0, append=0.0) / 0.25
        most = np.linalg.norm(jumps, axis=1) if "max_jerk" in limit else np.abs(jumps)
        assert most.max() <= next(iter(limit.values() if "max_jerk" in limit else [3.0])) + EXACT
    assert flight.plan.arrivals[0] < scenario.grid.end


def test_bounds_of_the_least_time_hold_with_limited_jerk() -> None:
    plan = rho.plan_minimum_time(hop(rho.State([0, 0, 0]), rho.State([10, 0, 0]), HOP))
    bound = rho.certify_time(plan).bound
    assert 0.99 * plan.scenario.grid.duration <= bound <= plan.scenario.grid.duration
