"""The receding horizon: its windows, the part of them that is flown, and failing windows."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.solvers import SolverInterface

import drake_rho as rho
from drake_rho.planning.horizon.interfaces import Planner
from drake_rho.planning.minimum_effort import Changes
from drake_rho.planning.programs import solve as blocks
from drake_rho.planning.programs.reduced import programs_of
from tests.scenarios import box, scenarios, single
from tests.tolerances import INDEX, ROUNDING


@pytest.mark.parametrize("replan_every", [1, 5, 7, 48, 49, 100])
def test_the_flight_is_the_beginning_of_every_window(
    paper: rho.Scenario, replan_every: int
) -> None:
    flight = rho.plan_rho(paper, replan_every=replan_every)
    assert [window.first_knot for window in flight.windows] == list(range(0, 49, replan_every))
    assert rho.verify(flight.plan).ok
    for window in flight.windows:
        first = window.first_knot
        last = min(first + replan_every, 49)
        np.testing.assert_allclose(
            flight.plan.positions[:, first : last + 1],
            window.plan.positions[:, : last - first + 1],
            rtol=ROUNDING,
            atol=1e-6,
        )
        assert rho.verify(window.plan).ok
        assert not window.infeasible


def test_one_window_is_the_convex_method(paper: rho.Scenario) -> None:
    flight = rho.plan_rho(paper, replan_every=49)
    np.testing.assert_array_equal(flight.plan.accelerations, rho.plan_convex(paper).accelerations)


def test_the_reference_of_a_window_is_its_obstacle_free_motion(paper: rho.Scenario) -> None:
    flight = rho.plan_rho(paper)
    for window in flight.windows[:-1]:
        free = rho.plan_convex(window.plan.scenario.without_obstacles())
        np.testing.assert_allclose(window.reference.positions, free.positions, atol=1e-6)


def test_the_previous_tail_as_reference_never_costs_more_along_the_flight(
    paper: rho.Scenario,
) -> None:
    flight = rho.plan_rho(paper, reference=rho.tail_reference)
    assert rho.verify(flight.plan).ok
    spent = 0.0
    predicted = []
    for window in flight.windows:
        predicted.append(spent + window.plan.cost)
        spent += float(np.sum(window.plan.accelerations[:, :5] ** 2))
    assert np.all(np.diff(predicted) <= INDEX * predicted[0])


def test_any_planner_can_be_passed(paper: rho.Scenario) -> None:
    flight = rho.plan_rho(paper, planner=rho.plan_scp)
    assert rho.verify(flight.plan).ok
    # iterated to convergence, every window finds the same motion again
    assert flight.cost == pytest.approx(rho.plan_scp(paper).cost, rel=INDEX)


def _failing_after(windows: int) -> Planner:
    left = [windows]

    def planner(
        scenario: rho.Scenario,
        *,
        reference: rho.Plan | None,
        solver: SolverInterface | None = None,
    ) -> rho.Plan:
        left[0] -= 1
        if left[0] < 0:
            raise rho.InfeasibleError({"UAV-1": ("goal x", "obstacle 1 at 9 s")})
        return rho.plan_convex(scenario, reference=reference, solver=solver)

    return planner


def test_a_window_without_a_plan_continues_the_previous_one(paper: rho.Scenario) -> None:
    planner = _failing_after(2)
    flight = rho.plan_rho(paper, planner=planner, fallback=None)
    assert rho.verify(flight.plan).ok
    assert [bool(window.infeasible) for window in flight.windows] == [False] * 2 + [True] * 8
    assert "obstacle 1 at 9 s" in flight.windows[2].infeasible
    np.testing.assert_allclose(
        flight.plan.accelerations[:, 5:], flight.windows[1].plan.accelerations, rtol=ROUNDING
    )


class RecordingPlanner:
    """Planner that fails in some windows and records the references it is given."""

    def __init__(self, planner: Planner, failing: frozenset[int], error: Exception) -> None:
        self.planner, self.failing, self.error = planner, failing, error
        self.references: list[rho.Plan | None] = []

    def __call__(
        self,
        scenario: rho.Scenario,
        *,
        reference: rho.Plan | None,
        solver: SolverInterface | None = None,
    ) -> rho.Plan:
        """Return a plan, or raise the error."""
        self.references.append(reference)
        if len(self.references) - 1 in self.failing:
            raise self.error
        return self.planner(scenario, reference=reference, solver=solver)


SPENT = rho.Statistics(programs=1000, solver="none")
NO_PLAN = [
    rho.InfeasibleError({"UAV-1": ("goal x",)}, statistics=SPENT),
    rho.SolverError("numerically", SPENT),
]


@pytest.mark.parametrize("error", NO_PLAN)
def test_where_the_planner_fails_the_fallback_plans_from_the_tail(
    paper: rho.Scenario, error: Exception
) -> None:
    planner = RecordingPlanner(rho.plan_convex, frozenset([0, 3]), error)
    fallback = RecordingPlanner(rho.plan, frozenset(), error)
    flight = rho.plan_rho(paper, planner=planner, fallback=fallback)
    assert rho.verify(flight.plan).ok
    assert len(planner.references) == len(flight.windows) == 10
    assert not any(window.infeasible for window in flight.windows)
    first, later = fallback.references
    assert first is None
    assert later is not None
    tail = flight.windows[2].plan.tail(5)
    np.testing.assert_array_equal(later.accelerations, tail.accelerations)
    for number, reference in ((0, None), (3, tail)):
        window = flight.windows[number]
        alone = rho.plan(window.plan.scenario, reference=reference)
        np.testing.assert_allclose(window.plan.accelerations, alone.accelerations, atol=1e-9)
        assert window.plan.statistics.programs == 1000 + alone.statistics.programs
        assert window.reference is window.plan.reference
    assert flight.statistics.programs > 2000


def test_the_fallback_is_used_by_default_where_the_convex_method_has_no_plan() -> None:
    """The obstacle-free motion passes an obstacle's centre: one linearisation has no plan."""
    scenario = single(
        start=rho.State([0, 1, 2]),
        goal=rho.State([20, 1, 2]),
        grid=rho.Grid(0.25, 41),
        limits=rho.Limits(velocity=box(4.0)),
        obstacles=(rho.Sphere([10, 1, 2], 2.0),),
    )
    with pytest.raises(rho.InfeasibleError):
        rho.plan_rho(scenario, fallback=None)
    flight = rho.plan_rho(scenario)
    assert rho.verify(flight.plan).ok
    first = flight.windows[0]
    assert not first.infeasible
    assert first.plan.cost == pytest.approx(rho.plan(scenario).cost, rel=INDEX)


@pytest.mark.parametrize("error", NO_PLAN)
def test_where_planner_and_fallback_fail_the_tail_is_flown_with_a_reason(
    paper: rho.Scenario, error: Exception
) -> None:
    last = rho.InfeasibleError({"UAV-2": ("obstacle 1 at 9 s",)}, statistics=SPENT)
    planner = RecordingPlanner(rho.plan_convex, frozenset([2]), error)
    fallback = RecordingPlanner(rho.plan, frozenset([0]), last)
    flight = rho.plan_rho(paper, planner=planner, fallback=fallback)
    assert rho.verify(flight.plan).ok
    assert [window.infeasible for window in flight.windows] == [""] * 2 + [str(last)] + [""] * 7
    window, before = flight.windows[2], flight.windows[1]
    tail = before.plan.tail(5)
    np.testing.assert_array_equal(window.plan.accelerations, tail.accelerations)
    assert window.plan.statistics.programs == 2000  # the sum of both
    with pytest.raises(rho.InfeasibleError, match="UAV-2"):
        rho.plan_rho(
            paper,
            planner=RecordingPlanner(rho.plan_convex, frozenset([0]), error),
            fallback=RecordingPlanner(rho.plan, frozenset([0]), last),
        )


def test_a_window_that_fails_is_not_explained(
    paper: rho.Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No program with soft constraints is built unless an explanation is requested."""
    written: list[bool] = []

    def counted(changes: Changes, *args: Any, **options: Any) -> Iterator[Any]:
        written.append(changes.free)
        return programs_of(changes, *args, **options)

    monkeypatch.setattr(blocks, "programs_of", counted)
    weak = dataclasses.replace(paper, limits=rho.Limits(acceleration=box(6.0)))
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan_rho(weak)
    windows = 0

    def weaker(
        scenario: rho.Scenario,
        *,
        reference: rho.Plan | None,
        solver: SolverInterface | None = None,
    ) -> rho.Plan:
        nonlocal windows
        windows += 1
        if windows > 1:
            limits = dataclasses.replace(scenario.limits, jerk=box(1e-3))
            scenario = dataclasses.replace(scenario, limits=limits)
        return rho.plan_convex(scenario, reference=None, solver=solver)

    flight = rho.plan_rho(paper, planner=weaker, fallback=None)
    assert sum(bool(window.infeasible) for window in flight.windows) > 5
    assert written
    assert not any(written)
    rho.infeasible_subset(caught.value)
    assert any(written)


def test_a_first_window_without_a_plan_is_an_error(paper: rho.Scenario) -> None:
    with pytest.raises(rho.InfeasibleError):
        rho.plan_rho(paper, planner=_failing_after(0), fallback=None)


@pytest.mark.parametrize("replan_every", [0, -1, 2.5, float("nan")])
def test_replan_every_is_a_whole_number_of_at_least_one(
    paper: rho.Scenario, replan_every: object
) -> None:
    with pytest.raises(ValueError, match="replan_every"):
        rho.plan_rho(paper, replan_every=replan_every)  # type: ignore[arg-type]  # what is tested
    for word in ("5", None, True):
        with pytest.raises(TypeError, match="expected a number"):
            rho.plan_rho(paper, replan_every=word)  # type: ignore[arg-type]  # the same


def test_the_jerk_limit_holds_where_windows_meet() -> None:
    limits = rho.Limits(jerk=rho.Box([-1.0] * 3, [1.0] * 3))
    obstacles = (rho.Sphere([5.0, 2.3, -1.0], 2.2),)
    scenario = single(limits=limits, obstacles=obstacles)
    flight = rho.plan_rho(scenario, replan_every=3)
    assert rho.verify(flight.plan).ok
    free = rho.plan_rho(single(obstacles=obstacles), replan_every=3)
    jerks = np.abs(np.diff(free.plan.accelerations, axis=1)).max() / scenario.grid.step
    assert jerks > 1.5  # without the limit, some joint or step violates it


@given(scenario=scenarios(), replan_every=st.integers(1, 9), tail=st.booleans())
@settings(max_examples=13)
def test_a_flight_whose_first_window_has_a_plan_ends_at_its_goal(
    scenario: rho.Scenario, replan_every: int, tail: bool
) -> None:
    reference = rho.tail_reference if tail else rho.free_reference
    try:
        flight = rho.plan_rho(scenario, replan_every=replan_every, reference=reference)
    except rho.InfeasibleError:
        return
    report = rho.verify(flight.plan)
    assert report.ok, report


def test_a_vehicle_that_hovers_among_others_is_planned_in_every_window() -> None:
    here = rho.State([27.4, -46.0, -91.8])
    scenario = rho.Scenario(
        "hover",
        rho.Grid(0.5, 17),
        (
            rho.Vehicle("hover", here, here),
            rho.Vehicle("mover", rho.State([0, 0, 0]), rho.State([10, 0, 0])),
        ),
        rho.Limits(acceleration=rho.Box([-3, -3, -2], [3, 3, 4])),
    )
    flight = rho.plan_rho(scenario, replan_every=1)
    assert rho.verify(flight.plan).ok
    assert not any(window.infeasible for window in flight.windows)


def test_a_flight_counts_the_work_of_all_its_windows(paper: rho.Scenario) -> None:
    flight = rho.plan_rho(paper)
    programs = sum(
        window.plan.statistics.programs + window.reference.statistics.programs
        for window in flight.windows
    )
    assert flight.statistics.programs == programs > 10
    assert flight.statistics.linearisations == 10
