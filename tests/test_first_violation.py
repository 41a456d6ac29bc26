"""The quick check of windows agrees with `verify`, and a horizon flies nothing that fails it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

import drake_rho as rho
from drake_rho.scenario.fields import unchecked
from drake_rho.verification import quick_bounds
from drake_rho.verification.holds import first_violation
from tests.disturbed import disturbed
from tests.scenarios import (
    box,
    examples,
    independent,
    random_fleet,
    random_scenario,
    single,
    slow,
    through_the_middle,
)
from tests.test_smoothing import smooth
from tests.test_uncertain import pushed

Array = NDArray[np.float64]

seeds = st.integers(0, 2**32 - 1)


def changed(plan: rho.Plan, rng: np.random.Generator, by: float) -> rho.Plan:
    """Return the plan with accelerations changed by a fraction of the largest, goals kept."""
    a = np.array(plan.accelerations)
    knot = int(rng.integers(max(1, a.shape[1] - 3)))
    push = by * np.abs(a).max() * rng.normal(size=(len(a), 3))
    # neither velocity nor position changes at the end
    for place, sign in enumerate((1.0, -2.0, 1.0)):
        if a.shape[1] >= 4:
            a[:, knot + place] += sign * push
    return rho.Plan.from_accelerations(plan.scenario, a, plan.statistics)


@given(seed=seeds, kind=st.sampled_from(["plain", "fleet", "disturbed"]), by=st.floats(-9, 0))
@examples(few=10, many=26)
def test_the_quick_check_agrees_with_verify(seed: int, kind: str, by: float) -> None:
    rng = np.random.default_rng(seed)
    scenario = {
        "plain": lambda: random_scenario(seed, between_knots=bool(rng.integers(2))),
        "fleet": lambda: random_fleet(seed, between_knots=bool(rng.integers(2))),
        "disturbed": lambda: disturbed(seed),
    }[kind]()
    try:
        plan = rho.plan_convex(scenario)
    except (rho.InfeasibleError, rho.SolverError):
        return
    for each in (plan, changed(plan, rng, 10.0**by)):
        assert (first_violation(each) is None) == rho.verify(each).ok


@pytest.mark.parametrize("seed", [2, 3, *slow(0, 1, 4, 5)])
def test_the_quick_check_agrees_with_verify_on_the_rest_of_a_plan(seed: int) -> None:
    try:
        plan = rho.plan(disturbed(seed))
    except rho.InfeasibleError:
        return
    for knot in range(plan.scenario.grid.knots - 1):
        tail = plan.tail(knot)
        assert rho.error_tube(tail.scenario) == rho.error_tube(plan.scenario)
        assert (first_violation(tail) is None) == rho.verify(tail).ok


def test_only_known_obstacles_and_requested_checks_are_evaluated() -> None:
    late = rho.Obstacle(rho.Sphere([5.0, 2.0, -1.0], 1.0), known_from=2.0)
    scenario = single(obstacles=[late], between_knots=True)
    plan = rho.plan_convex(scenario)
    assert first_violation(plan) is None
    broken = first_violation(plan, [1])
    assert broken is not None
    assert broken.constraint == "obstacle 1"
    assert not rho.verify(plan).ok
    broken = first_violation(plan.tail(4))
    assert broken is not None
    assert broken.constraint == "obstacle 1"
    assert first_violation(plan.tail(4), []) is None


@pytest.mark.parametrize("what", ["max_tilt", "many"])
def test_cases_that_the_quick_check_cannot_decide_are_verified_in_full(
    what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = single(limits=rho.Limits(max_tilt=0.6))
    wild = changed(rho.plan(scenario), np.random.default_rng(1), 1e3)
    if what == "many":
        monkeypatch.setattr(quick_bounds, "_ALL_PAIRS", 1)
        scenario = through_the_middle(2)
        wild = independent(scenario)
    assert first_violation(rho.plan(scenario)) is None
    assert first_violation(wild) is not None


def biased(samples: int, error: Array) -> object:
    """Return no wind, and an estimate with its largest error in one direction at every sample."""

    class Still:
        position_errors = np.broadcast_to(error, (samples, *error.shape))
        velocity_errors = np.zeros_like(position_errors)

        def __call__(self, time: float, positions: Array, velocities: Array) -> Array:
            return np.zeros_like(positions)

    return Still()


@pytest.mark.parametrize("close", ["wall", *slow("room", "pair")])
@pytest.mark.parametrize("every", [*slow(2), 5])
def test_the_tube_fits_at_the_goal_in_every_window(close: str, every: int) -> None:
    around = rho.Disturbance(0.02, 0.3, 0.0, feedback_every=0.25)
    room = 0.1  # the first tube, exact at the start, is thinner at the goal than the later ones
    vehicles = [rho.Vehicle("v", rho.State([0, 0, 0]), rho.State([3, 0, 0]))]
    scenario = rho.Scenario(
        "goal", rho.Grid(0.5, 11), vehicles, rho.Limits(max_acceleration=2.0), disturbance=around
    )
    if close == "wall":
        scenario = dataclasses.replace(
            scenario, obstacles=(rho.Box([3 + room, -5, -5], [4, 5, 5]),)
        )
    elif close == "room":
        limits = rho.Limits(max_acceleration=2.0, position=rho.Box([-1, -1, -1], [3 + room, 1, 1]))
        scenario = dataclasses.replace(scenario, limits=limits)
    else:
        other = rho.Vehicle("w", rho.State([9, 0, 0]), rho.State([3.5 + 2 * room, 0, 0]))
        scenario = dataclasses.replace(
            scenario, vehicles=(*vehicles, other), separation=rho.Separation(0.5)
        )
    error = np.array([-0.3, 0.0, 0.0])
    if close == "pair":  # each estimates a larger distance from the other than the true one
        error = np.stack([error, -error])
    wind = biased(around.samples(scenario.grid), error)
    flown = rho.simulate(scenario, replan_every=every, wind=wind)  # type: ignore[arg-type]  # has that form
    assert rho.verify(flown).ok
    assert all(
        first_violation(window.plan) is None or window.kept for window in flown.flight.windows
    )
    assert all(window.kept or not window.infeasible for window in flown.flight.windows)
    if close == "wall":
        assert flown.positions[:, 0, 0].max() < 3 + room
    assert any(window.kept for window in flown.flight.windows)


def test_a_window_whose_tube_exceeds_a_waypoint_is_refused() -> None:
    around = rho.Disturbance(0.01, 0.1, 0.0, feedback_every=0.5)
    waypoint = rho.Waypoint(4.0, [5.0, 2.0, -1.0], 0.12)
    scenario = dataclasses.replace(single(waypoints=[waypoint]), disturbance=around)
    horizon = rho.RecedingHorizon(scenario, replan_every=7)
    first = horizon.step(scenario.fleet.start_states, 0.0)
    assert first_violation(first.plan) is None
    now = horizon.step(first.plan.states(7), 3.5)
    tube = rho.error_tube(now.plan.scenario)
    assert float(tube.position(4.0)) <= 0.12 + 1e-6
    assert rho.verify(now.plan).ok or now.kept


@pytest.mark.parametrize("short", [*slow(0.0, 0.5), 0.9])
def test_a_tail_is_accepted_with_the_tolerance_of_its_plan(short: float) -> None:
    around = rho.Disturbance(0.05, 0.3, 0.0, feedback_every=0.25)
    scenario = rho.Scenario(
        "tunnel",
        rho.Grid(0.5, 11),
        [rho.Vehicle("v", rho.State([0, 0, 0]), rho.State([3, 0, 0]))],
        rho.Limits(max_acceleration=2.0),
        disturbance=around,
    )
    end = 3.0 + float(rho.error_tube(scenario).position_over([4.5], [5.0])[0]) - short * 1e-6
    walls = [
        rho.Box([-3, 0.2, -3], [6, 2, 3]),
        rho.Box([-3, -2, -3], [6, -0.2, 3]),
        rho.Box([end, -1, -1], [end + 2, 1, 1]),
    ]
    scenario = dataclasses.replace(scenario, obstacles=tuple(walls))
    flown = rho.simulate(scenario, replan_every=2, wind=rho.winds.none())
    assert rho.verify(flown.flight.windows[0].plan).ok
    assert all(window.kept for window in flown.flight.windows[1:])
    assert rho.verify(flown).ok


def test_windows_without_a_disturbance_are_not_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> str:
        raise AssertionError("a window was checked")

    monkeypatch.setattr("drake_rho.planning.horizon.windows.first_violation", refused)
    scenario = single(limits=rho.Limits(acceleration=box(3.0)), between_knots=True)
    rho.plan_rho(scenario)
    with pytest.raises(AssertionError, match="checked"):
        rho.plan_rho(unchecked(scenario, disturbance=rho.Disturbance(0.1)))


def test_a_plan_is_verified_for_the_scenario_given_to_its_planner() -> None:
    """The scenario that the returned plan names is irrelevant."""
    ball = rho.Sphere([5.0, 2.0, -1.0], 1.0)
    asked = single(obstacles=[ball], between_knots=True)
    asked = dataclasses.replace(asked, disturbance=rho.Disturbance(0.1, 0.01))

    def ignorant_planner(scenario: rho.Scenario, **options: object) -> rho.Plan:
        return rho.plan_convex(dataclasses.replace(scenario, disturbance=None, obstacles=()))

    with pytest.raises(rho.InfeasibleError, match="violates constraints: solo: obstacle 1"):
        rho.plan_rho(asked, planner=ignorant_planner, fallback=None)
    flight = rho.plan_rho(asked, planner=ignorant_planner)
    assert rho.verify(flight).ok


@pytest.mark.parametrize("every", [2, 5])
def test_tolerances_of_windows_do_not_exceed_those_of_the_flight(every: int) -> None:
    """An early waypoint requires large accelerations, which enlarge the scale of the flight."""
    waypoints = [rho.Waypoint(1.0, [2.0, 0, 0], 0.0), rho.Waypoint(12.0, [0.5, 1.0, 0], 0.0)]
    scenario = single(grid=rho.Grid(0.5, 41), goal=rho.State([1.0, 0, 0]), waypoints=waypoints)
    flight = rho.plan_rho(scenario, replan_every=every)
    assert rho.verify(flight).ok
    whole = scenario.fleet.scale("position")
    for window in flight.windows:
        assert np.all(window.plan.scenario.fleet.scale("position") <= whole)


@pytest.mark.parametrize("seed", [1, 3, 4, 5, *slow(0, 2, *range(6, 60))])
def test_the_verdict_on_obstacles_alone_is_that_of_their_checks(seed: int) -> None:
    plan = pushed(seed)
    rows = [each for each in rho.verify(plan).checks if each.kind == "obstacles" and each.asked]
    found = first_violation(plan, range(1, len(plan.scenario.bodies) + 1))
    assert (found is None) == all(each.holds for each in rows)


def test_the_rest_of_a_smooth_plan_and_its_contingencies_have_no_violation() -> None:
    scenario = smooth(rho.Smoothing(0.5, 2))
    plan = rho.plan(scenario)
    assert all(first_violation(plan.tail(knot)) is None for knot in (1, 2, 3, 9))
    for window in rho.plan_rho(scenario, contingencies=True).windows:
        assert window.contingency is not None
        assert first_violation(window.contingency) is None
