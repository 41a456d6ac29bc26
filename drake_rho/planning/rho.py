"""The receding horizon (RHO): plan the whole rest of the flight, fly a few steps, plan again."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from numbers import Integral
from typing import Protocol

import numpy as np
from pydrake.solvers import SolverInterface

from drake_rho.motion.plan import Flight, Plan, Statistics, Window
from drake_rho.planning.best import plan as best_plan
from drake_rho.planning.breaches import breaches_of
from drake_rho.planning.convex import plan_convex
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.keep_apart import decoupled
from drake_rho.planning.minimum_violation import minimum_breach
from drake_rho.planning.subproblem import Subproblem
from drake_rho.planning.threads import one_for_arrays
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario


class Planner(Protocol):
    """What `plan_rho` asks of a planner: `plan_convex`, `plan_scp`, or another of this form."""

    def __call__(
        self, scenario: Scenario, *, reference: Plan | None, solver: SolverInterface | None
    ) -> Plan:
        """A plan for `scenario`, found from `reference`."""
        ...


Reference = Callable[[Scenario, Plan | None, SolverInterface | None], Plan | None]
"""What a window is linearised around: (its scenario, the previous prediction's tail or None in the
first window, the solver) -> a motion of the same vehicles on the same grid, or None for the one
that planners make by themselves."""


def free_reference(scenario: Scenario, tail: Plan | None, solver: SolverInterface | None) -> None:
    """The paper's reference: each window's own solution without the obstacles.

    Planners begin with that one when they are given none.
    """


def tail_reference(
    scenario: Scenario, tail: Plan | None, solver: SolverInterface | None
) -> Plan | None:
    """What is left of the previous prediction; in the first window, the paper's reference.

    The tail meets every constraint of the window, so there is always a plan, up to rounding.
    """
    return tail


@one_for_arrays()
def plan_rho(
    scenario: Scenario,
    *,
    replan_every: int = 5,
    planner: Planner = plan_convex,
    fallback: Planner | None = best_plan,
    reference: Reference | None = None,
    solver: SolverInterface | None = None,
) -> Flight:
    """Fly with a receding horizon that shrinks towards the fixed goal and arrival time.

    Each window plans from the state reached to the goal and is flown for `replan_every` steps.
    Where the planner has no solution the fallback is asked, from the previous prediction's tail;
    a window for which that has none either flies on along the tail, which is still valid. Its
    `Window.infeasible` says why.

    Windows know of an obstacle if it is known at their start. Where one becomes known too late to
    be avoided, the plan that comes least too close to it is flown, and planning goes on from there;
    `Flight.sightings` tells what was learned when.

    Args:
        scenario: what is asked.
        replan_every: d, the steps flown of each window; the last window has what is left.
        planner: plans one window.
        fallback: plans a window, the first included, for which `planner` has no solution or whose
            solvers fail; None for nothing but the tail.
        reference: what a window is linearised around, `free_reference` (the paper's),
            `tail_reference`, or another function of this form. If not given, the paper's and, for
            fleets that keep apart, the tail, which is a plan for the next window already.
        solver: a Drake solver; Clarabel if not given.

    Returns:
        The flight; `flight.plan` meets every constraint of the scenario, but for obstacles that
        became known too late.

    Raises:
        InfeasibleError: the first window has no solution, with the fallback neither.
        SolverError: the solvers fail numerically in the first window, with the fallback too.
        ValueError: `replan_every` is not a whole number of at least 1.
    """
    if isinstance(replan_every, bool) or not isinstance(replan_every, Integral) or replan_every < 1:
        raise ValueError(f"replan_every: got {replan_every!r}, expected a whole number >= 1")
    if reference is None:
        reference = free_reference if scenario.separation is None else tail_reference
    began = time.perf_counter()
    replan_every = int(replan_every)
    windows: list[Window] = []
    flown: list[FloatArray] = []
    for first_knot in range(0, scenario.grid.knots - 1, replan_every):
        tail = windows[-1].plan.tail(replan_every) if windows else None
        window = plan_window(
            scenario if tail is None else tail.scenario,
            first_knot,
            tail,
            planner=planner,
            fallback=fallback,
            reference=reference,
            solver=solver,
        )
        windows.append(_with_sightings(window, windows[-1] if windows else window))
        flown.append(window.plan.accelerations[:, :replan_every])
    statistics = sum((window.statistics for window in windows), Statistics())
    statistics = dataclasses.replace(statistics, seconds=time.perf_counter() - began)
    plan = Plan.from_accelerations(scenario, np.concatenate(flown, axis=1), statistics)
    return Flight(plan, tuple(windows))


def plan_window(
    scenario: Scenario,
    first_knot: int,
    tail: Plan | None,
    *,
    planner: Planner,
    fallback: Planner | None,
    reference: Reference,
    solver: SolverInterface | None,
) -> Window:
    """One window of `plan_rho`.

    Args:
        scenario: what is left of the flight.
        first_knot: where in the whole flight the window starts, counted from 0.
        tail: what is left of the previous prediction; None in the first window.
        planner: as for `plan_rho`.
        fallback: as for `plan_rho`.
        reference: as for `plan_rho`.
        solver: a Drake solver; Clarabel if not given.

    Raises:
        InfeasibleError: there is no plan, and no tail to fly on along.
        SolverError: the solvers fail numerically, and there is no tail.
    """
    around, spent, failure = None, Statistics(), None
    if tail is not None and (inside := _begins_inside(scenario)):
        names = ", ".join(map(scenario.obstacle_name, inside))
        flown_on = minimum_breach(tail, solver)
        return Window(first_knot, flown_on, flown_on, infeasible=f"it begins too close to {names}")
    try:
        if scenario.obstacles or scenario.separation is not None:
            around = reference(scenario, tail, solver)
        plan = planner(scenario, reference=around, solver=solver)
        return Window(first_knot, plan, around or plan.reference or plan)
    except (InfeasibleError, SolverError) as error:
        failure, spent = error, error.statistics
    if fallback is not None:
        try:
            plan = fallback(scenario, reference=tail, solver=solver)
            plan = plan.with_statistics(spent + plan.statistics)
            return Window(first_knot, plan, plan.reference or plan)
        except (InfeasibleError, SolverError) as error:
            failure, spent = error, spent + error.statistics
    if tail is None:
        raise failure
    plan = tail
    if not Subproblem(scenario, decoupled, solver).holds(tail):  # of what is known by now
        plan = minimum_breach(tail, solver)
        spent += plan.statistics
    plan = plan.with_statistics(spent)
    return Window(first_knot, plan, around or plan, infeasible=str(failure))


def _begins_inside(scenario: Scenario) -> list[int]:
    """Numbers of the known obstacles that vehicles are too close to at the first knot."""
    starts, radii = scenario.fleet.start_positions, scenario.fleet.radii
    time = np.array([scenario.grid.start])
    return [
        number
        for number, obstacle in scenario.known
        if np.any(
            obstacle.shape.signed_distance(starts - obstacle.centers(time))
            < radii - 10.0 * obstacle.shape.tolerance
        )
    ]


def _with_sightings(window: Window, before: Window) -> Window:
    """A window that says which obstacles it learned of, and which of those seen late it breaks."""
    scenario = window.plan.scenario
    known = {number for number, _ in before.plan.scenario.known}
    late = {number for number, obstacle in scenario.known if obstacle.known_from > 0.0}
    if not late:
        return window
    broken = breaches_of(scenario, window.plan).inside.keys() & late
    return dataclasses.replace(
        window, learned=tuple(sorted(late - known)), not_avoided=tuple(sorted(broken))
    )
