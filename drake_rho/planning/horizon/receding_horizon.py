"""The receding horizon (RHO): plan the whole rest of the flight, fly a few steps, plan again."""

from __future__ import annotations

import dataclasses
from functools import partial
from numbers import Integral

import numpy as np
import numpy.typing as npt

from drake_rho.motion.plan import Flight, Plan, Window
from drake_rho.motion.statistics import Statistics
from drake_rho.motion.threads import one_for_arrays
from drake_rho.planning.horizon.measured_states import ROUNDING, beyond, off_tube, tracked_anew
from drake_rho.planning.horizon.windows import (
    Planner,
    Reference,
    WindowPlanner,
    free_reference,
    tail_reference,
)
from drake_rho.planning.options import Options
from drake_rho.planning.planners.convex import plan_convex
from drake_rho.planning.planners.plan import plan as best_plan
from drake_rho.planning.planners.plan import plan_scp
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend, Solver, SolverName
from drake_rho.planning.progress import Progress, tell
from drake_rho.planning.scp.violations import violations_of
from drake_rho.planning.time_limit import with_time_limit, within_time
from drake_rho.planning.wall_time import with_wall_time
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.clock import clock_number, clock_time
from drake_rho.scenario.fields import LARGEST, FloatArray, unchecked
from drake_rho.scenario.records import TOLERANCE, Scenario

_CLOCK = 1e-4
"""Part of a step by which a time may miss its knot: that much a caller's own clock may be off."""


class RecedingHorizon:
    """A receding horizon that shrinks towards the goals, fed with measured states.

    Every window plans anew from the state that is measured, with a tube that begins anew. The fleet
    does so together or, where there is no such plan, keeps to the previous one and its tube. If the
    first window has a plan, nothing new becomes known, and disturbances are as the scenario says,
    then no window is without a plan that holds.

    Args:
        scenario: what is asked.
        replan_every: d, the steps flown of each window; the last window has what is left.
        planner: plans one window.
        fallback: plans a window, the first included, for which `planner` has no solution or whose
            solvers fail; None for nothing but the rest of the previous plan.
        reference: what a window is linearised around, `free_reference` (the paper's),
            `tail_reference`, or another function of this form. If not given, the paper's and, for
            fleets that keep apart, the tail, which is a plan for the next window already.
        solver: `"clarabel"`, `"daqp"` or `"osqp"`, or a Drake solver; Clarabel if not given.
        progress: called with a few words when a window begins, as 'window 3 of 10'.
        options: of this package's planners; after `time_limit` in a step the previous plan is kept.

    Attributes:
        scenario: as given.
        replan_every: as given.
        windows: those planned so far.

    Raises:
        ValueError: `replan_every` is not a whole number of at least 1.
    """

    @checked
    def __init__(
        self,
        scenario: Scenario,
        *,
        replan_every: int = 5,
        planner: Planner = plan_convex,
        fallback: Planner | None = best_plan,
        reference: Reference | None = None,
        solver: Solver | SolverName | None = None,
        progress: Progress | None = None,
        options: Options | None = None,
    ) -> None:
        whole = isinstance(replan_every, Integral) and not isinstance(replan_every, bool)
        if not whole or replan_every < 1:
            raise ValueError(f"replan_every: got {replan_every!r}, expected a whole number >= 1")
        if reference is None:
            reference = free_reference if scenario.separation is None else tail_reference
        self.scenario, self.replan_every = scenario, int(replan_every)
        self.windows: list[Window] = []
        self._planner, self._progress = (
            WindowPlanner(
                _with(options, planner),
                None if fallback is None else _with(options, fallback),
                reference,
                Backend.of(solver).solver,
            ),
            progress,
        )
        self._time_limit = None if options is None else options.time_limit

    @property
    def knots(self) -> range:
        """The knots at which windows start, counted from 0."""
        return range(0, self.scenario.grid.knots - 1, self.replan_every)

    def planned(self, knot: int) -> FloatArray:
        """The states that the last window has at a knot, or the starts before there is one, (N, 6).

        Args:
            knot: counted from 0, not before the last window starts.
        """
        if not self.windows:
            return self.scenario.fleet.start_states
        last = self.windows[-1]
        return last.plan.states(knot - last.first_knot)

    def step(self, states: npt.ArrayLike, time: float) -> Window:
        """Plan the next window.

        A scenario's starts are exact, and so is the first window where the states are just these;
        from any others its tube begins with what estimates may be off. No window fails: where there
        is no plan, `Window.infeasible` says why. Only the first one raises, if the scenario has
        none from its own starts either.

        Args:
            states: position [m] and velocity [m/s] of each vehicle as estimated for this time,
                shape (N, 6); with a delay, predicted from what was measured by the commands given
                since then. A row of NaN, or of numbers beyond any flight, is a vehicle that was not
                seen: it goes on from where it was planned to be, and the tube begins with the
                errors that it may have there.
            time: of a knot at which a step begins, after that of the window before, on the
                scenario's clock [s]. The first window starts at the first knot.

        Returns:
            The window. Until the next one its plan is flown.

        Raises:
            InfeasibleError: the scenario has no plan from its own starts, nor with the fallback.
            SolverError: the solvers fail numerically there, with the fallback too.
            ValueError: the states are no numbers of this shape, or the time is another.
        """
        with within_time(self._time_limit):
            self.windows.append(self._window(states, time))
        return self.windows[-1]

    @with_wall_time
    @one_for_arrays()
    def _window(self, states: npt.ArrayLike, time: float) -> Window:
        """Return the next window; see `step`."""
        measured = self._checked(states)
        knot = self._knot(time)
        number = knot // self.replan_every + 1
        tell(self._progress, f"window {number} of {len(self.knots)}")
        if not self.windows:
            window = self._planner.first(self.scenario, self._begun(measured))
        else:
            window = self._next(knot, measured)
        names = [vehicle.name for vehicle in self.scenario.vehicles]
        unseen = tuple(names[i] for i in np.flatnonzero(np.isnan(measured).any(axis=1)))
        if unseen:
            window = dataclasses.replace(window, unseen=unseen)
        return _with_sightings(window, self.windows[-1] if self.windows else window)

    @property
    def flight(self) -> Flight:
        """The windows so far, each flown until the next, from the start of the scenario.

        Raises:
            ValueError: there is none yet.
        """
        if not self.windows:
            raise ValueError("windows: got none, expected at least one to be planned before")
        ends = [*(window.first_knot for window in self.windows[1:]), self.scenario.grid.knots - 1]
        flown = [
            window.plan.accelerations[:, : end - window.first_knot]
            for window, end in zip(self.windows, ends, strict=True)
        ]
        statistics = sum((window.statistics for window in self.windows), Statistics())
        plan = Plan.from_accelerations(self.scenario, np.concatenate(flown, axis=1), statistics)
        return Flight(plan, tuple(self.windows))

    def _checked(self, states: npt.ArrayLike) -> FloatArray:
        """Return positions and velocities side by side, (N, 6); NaN for vehicles not seen."""
        count = len(self.scenario.vehicles)
        array = np.array(states, dtype=np.float64)
        if array.shape != (count, 6):
            raise ValueError(f"states: got shape {array.shape}, expected {(count, 6)}")
        unseen = np.isnan(array).all(axis=1)
        wrong = ~np.isfinite(array).all(axis=1) & ~unseen
        if wrong.any():
            vehicle = self.scenario.vehicles[int(np.argmax(wrong))].name
            expected = f"finite numbers for {vehicle}, or NaN in its whole row if it was not seen"
            raise ValueError(f"states: got {array.tolist()}, expected {expected}")
        array[(np.abs(array) > LARGEST).any(axis=1)] = np.nan  # no such place is in any flight
        return array

    def _knot(self, time: float) -> int:
        """The number of the knot at a time."""
        grid, last = self.scenario.grid, -1
        if self.windows:
            last = self.windows[-1].first_knot
        steps = (time - grid.start) / grid.step
        knot = round(steps) if np.isfinite(steps) else -1
        most = grid.knots - 2 if self.windows else 0
        off = abs(steps - knot) * grid.step
        if not last < knot <= most or off > max(_CLOCK * grid.step, grid.rounding):
            first, end = (grid.times[min(k, grid.knots - 1)] for k in (last + 1, most))
            expected = f"the time of a knot from {clock_number(first)} to {clock_time(end)}"
            raise ValueError(f"time: got {time!r}, expected {expected}")
        return knot

    def _begun(self, states: FloatArray) -> Scenario:
        """Return the scenario from where the vehicles are, itself if they are at their starts.

        Starts are exact, and so are states that are just these; any other is an estimate, around
        which the tube begins with what that may be off. A vehicle that was not seen is at its
        start.
        """
        scenario = self.scenario
        positions, velocities = _split(_seen(states, scenario.fleet.start_states))
        fleet, tolerance = scenario.fleet, TOLERANCE if scenario.disturbance is None else ROUNDING
        away = positions - fleet.start_positions, velocities - fleet.start_velocities
        if not beyond(scenario, away, 0.0, 0.0, tolerance).any():
            return scenario
        unseen = np.isnan(states).any()
        tracking = tracked_anew(scenario, scenario, scenario if unseen else None)
        begun = scenario.from_states(
            scenario.grid, positions, velocities, fleet.accelerations_before, tracking
        )
        return begun.derived(under_way=False)  # there is no previous plan

    def _next(self, knot: int, states: FloatArray) -> Window:
        """Return a later window."""
        last = self.windows[-1]
        tail = last.plan.tail(knot - last.first_knot)
        left, unseen = tail.scenario, np.isnan(states).any(axis=1)
        positions, velocities = _split(_seen(states, tail.states(0)))
        away = positions - tail.positions[:, 0], velocities - tail.velocities[:, 0]
        tracking = tracked_anew(self.scenario, left, left if unseen.any() else None)
        if beyond(left, away, 0.0, 0.0, ROUNDING).any():
            before = left.fleet.accelerations_before
            left = left.from_states(left.grid, positions, velocities, before, tracking)
        elif left.disturbance is not None:
            around = unchecked(left.disturbance, tracking=tracking)
            left = left.derived(disturbance=around, under_way=True)
        off = off_tube(tail.scenario, away)
        window = self._planner.next(left, knot, tail, last=last, on_plan=not off.any())
        if left.disturbance is None or not off.any():
            return window
        names = tuple(left.vehicles[i].name for i in np.flatnonzero(off))
        return dataclasses.replace(window, off_tube=names)


@checked
@with_wall_time
@with_time_limit
@one_for_arrays()
def plan_rho(
    scenario: Scenario,
    *,
    replan_every: int = 5,
    planner: Planner = plan_convex,
    fallback: Planner | None = best_plan,
    reference: Reference | None = None,
    solver: Solver | SolverName | None = None,
    progress: Progress | None = None,
    options: Options | None = None,
) -> Flight:
    """Fly with a receding horizon that shrinks towards the fixed goal and arrival time.

    Each window plans from the state reached to the goal and is flown for `replan_every` steps.
    Where the planner has no solution the fallback is asked, from the previous prediction's tail;
    a window for which that has none either flies on along the tail, which is still valid. Its
    `Window.infeasible` says why.

    This is `RecedingHorizon` with perfect measurements: every window begins where its vehicles were
    planned to be. In a scenario with a disturbance each has a tube that begins anew there, and
    flights that are disturbed within it keep all constraints.

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
        solver: `"clarabel"`, `"daqp"` or `"osqp"`, or a Drake solver; Clarabel if not given.
        progress: called with a few words when a window begins, as 'window 3 of 10'.
        options: of this package's planners; after `time_limit` in all the previous plan is kept.

    Returns:
        The flight; `flight.plan` meets every constraint of the scenario, but for obstacles that
        became known too late.

    Raises:
        InfeasibleError: the first window has no solution, with the fallback neither.
        OutOfTimeError: time was up before the first window had a plan.
        SolverError: the solvers fail numerically in the first window, with the fallback too.
        ValueError: `replan_every` is not a whole number of at least 1.

    Examples:
        >>> flight = rho.plan_rho(rho.load_scenario("paper"), replan_every=5)
        >>> len(flight.windows), flight.plan
        (10, <Plan of paper: 4 vehicles, 50 knots, cost 17027.2 m²/s⁴>)
    """
    horizon = RecedingHorizon(
        scenario,
        replan_every=replan_every,
        planner=planner,
        fallback=fallback,
        reference=reference,
        solver=solver,
        progress=progress,
        options=options,
    )
    times = scenario.grid.times
    for knot in horizon.knots:
        horizon.step(horizon.planned(knot), times[knot])
    return horizon.flight


def _with(options: Options | None, planner: Planner) -> Planner:
    """Return a planner with options, if it is one of this package's; time is for a whole call."""
    if options is None or planner not in (best_plan, plan_scp, plan_convex):
        return planner
    ours: Planner = partial(planner, options=dataclasses.replace(options, time_limit=None))
    return ours


def _seen(states: FloatArray, predicted: FloatArray) -> FloatArray:
    """Return states, those of vehicles that were not seen as they were predicted, (N, 6)."""
    return np.asarray(np.where(np.isnan(states), predicted, states))


def _split(states: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return positions [m] and velocities [m/s], (N, 3) each."""
    return states[:, :3], states[:, 3:]


def _with_sightings(window: Window, before: Window) -> Window:
    """A window that says which obstacles it learned of, and which of those seen late it breaks."""
    scenario = window.plan.scenario
    late = {number for number, _ in scenario.known if scenario.bodies[number - 1].known_from > 0.0}
    if not late:
        return window
    known = {number for number, _ in before.plan.scenario.known}
    broken = violations_of(Problem.of(scenario), window.plan).inside.keys() & late
    return dataclasses.replace(
        window, learned=tuple(sorted(late - known)), not_avoided=tuple(sorted(broken))
    )
