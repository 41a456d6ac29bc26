"""Receding horizon optimisation (RHO): plan the rest of the flight, fly a few steps, plan again."""

from __future__ import annotations

import dataclasses
from functools import partial
from numbers import Integral
from typing import Any

import numpy as np
import numpy.typing as npt

from drake_rho.motion.flight import Flight, Window
from drake_rho.motion.measurements import MeasurementLog
from drake_rho.planning.call.options import Options
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.call.time_limit import within_time
from drake_rho.planning.call.wall_time import with_wall_time
from drake_rho.planning.horizon.continued_plans import lasting_until
from drake_rho.planning.horizon.cost_bounds import cost_bound
from drake_rho.planning.horizon.fallbacks import FAILURES
from drake_rho.planning.horizon.first_window import FirstWindow
from drake_rho.planning.horizon.free_final_time import check_rest_at_goals, next_window
from drake_rho.planning.horizon.interfaces import (
    Planner,
    Reference,
    free_reference,
    tail_reference,
    with_options,
)
from drake_rho.planning.horizon.known_now import changes_of
from drake_rho.planning.horizon.measured_states import checked_states, from_measured
from drake_rho.planning.horizon.next_flight import is_crowded, next_flight
from drake_rho.planning.horizon.rolling import RollingHorizon
from drake_rho.planning.horizon.situation import Situation, WindowStart, latency_in_samples
from drake_rho.planning.horizon.waypoints_ahead import (
    free_of,
    with_guessed_times,
    with_waypoints,
)
from drake_rho.planning.horizon.windows import WindowPlanner
from drake_rho.planning.planners.convex import plan_convex
from drake_rho.planning.planners.plan import plan as best_plan
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend, Solver, SolverName
from drake_rho.planning.scp.violations import violations_of
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray, unchecked
from drake_rho.scenario.objective import check_only_effort
from drake_rho.scenario.penalties import NO_BOUND, NO_COST, check_no_penalties
from drake_rho.scenario.records import Scenario
from drake_rho.system.threads import single_threaded_blas


@dataclasses.dataclass(frozen=True, eq=False)
class Proposal:
    """Window that was planned, and the situation of the flight if it is flown."""

    window: Window
    """the window"""
    situation: Situation
    """situation after it"""
    ended: Flight | None = None
    """flight that ends where it begins, if another one begins there"""


class RecedingHorizon:
    """Model predictive control from measured states: the horizon shrinks to the goals, or rolls.

    Every window plans again from the measured states, with a new error tube. The plan is for the
    whole fleet; if there is none, the fleet continues the previous plan in its tube. If the first
    window has a plan, nothing new becomes known, and disturbances are within those declared, then
    every window has a valid plan.

    With a free final time every window arrives at the earliest knot for which a plan is found, and
    vehicles then rest at their goals. Under the same assumptions no window arrives later than the
    one before. The grid's last knot is the latest arrival.

    The times of free waypoints are found with the first window, by `plan`. Later they change only
    in proportion to an earlier arrival.

    With `horizon`, every window plans that far ahead, and ends at rest where vehicles may stay. So
    the mission needs no end: goals can change at any time, and without a goal (None) a vehicle
    stops. What is proved is that vehicles stay safe, not that they arrive. Once a goal is within
    reach, the time of the arrival stays. Requirements with an interval of time count as far as a
    window plans.

    With a smoothing, windows continue the plan and the tube of the window before: a start at
    measured states would be a jump. A flight depends on the plan up to `Scenario.lead` later, so
    windows are planned that much earlier.

    The keyword arguments are the settings of windows, which `plan_rho`, `simulate` and
    `RecedingHorizonController` pass on.

    Args:
        scenario: to be flown.
        replan_every: d, the number of steps flown of each window; the last has the remaining ones.
        free_final_time: whether windows may arrive before the grid's last knot.
        planner: planner of one window.
        fallback: planner of a window, including the first, if `planner` has no solution or its
            solvers fail; None to continue the previous plan at once.
        reference: motion around which a window is linearised: `free_reference` (the paper's),
            `tail_reference`, or another function of this form. By default the paper's and, for
            fleets with a separation, the rest of the previous plan, which is feasible already.
        solver: `"clarabel"`, `"daqp"` or `"osqp"`, or a Drake solver; Clarabel if not given.
        progress: called with a short text when a window begins, as 'window 3 of 10'.
        options: of this package's planners. When a step exceeds `time_limit`, the previous plan is
            continued.
        contingencies: whether every window also has a motion that brakes to rest from the start of
            the next window, clear of everything known, or the reason for having none
            (`Window.contingency`). It is flown if something seen late leaves no plan.
        latency: time that planning a window takes [s]: the states of a window are predicted that
            much ahead, with the feedback in force, and its tube begins with the errors of the
            prediction. New information reaches only windows that begin that much later.
        bounded_cost: whether a new plan is accepted only if it costs no more than the rest of the
            previous one, moved to the measured states. The cost of the flight then has a bound
            (`Window.cost_bound`), whatever the disturbance.
        horizon: time that every window plans ahead [s], rounded up to whole steps. Windows then end
            at rest where vehicles may stay, drawn towards their goals along the shortest paths, and
            the grid only gives the step. If not given, windows plan up to the last knot.
        rest_for: time for which vehicles have to be able to stay there, as long as the errors of
            obstacles grow [s]. Otherwise they can stay for ever.

    Attributes:
        replan_every: as given.
        free_final_time: as given.
        latency: number of samples of the feedback that last as long as the latency, or longer.
        windows: windows planned so far.

    Raises:
        ValueError: `replan_every` is not a whole number of at least 1, the latency is longer than
            a window is flown, the cost is to be bounded with a free final time, or another setting
            does not fit the horizon.
        ScenarioError: a vehicle moves at its goal and the final time is free, a limit is soft and
            the final time is free or the cost is to be bounded, or the horizon rolls and the
            scenario has waypoints, a smoothing, or a feedback with which errors grow.
    """

    @checked
    def __init__(
        self,
        scenario: Scenario,
        *,
        replan_every: int = 5,
        free_final_time: bool = False,
        planner: Planner = plan_convex,
        fallback: Planner | None = best_plan,
        reference: Reference | None = None,
        solver: Solver | SolverName | None = None,
        progress: Progress | None = None,
        options: Options | None = None,
        contingencies: bool = False,
        latency: float = 0.0,
        bounded_cost: bool = False,
        horizon: float | None = None,
        rest_for: float = 60.0,
    ) -> None:
        whole = isinstance(replan_every, Integral)
        if not whole or replan_every < 1:
            raise ValueError(f"replan_every: got {replan_every!r}, expected a whole number >= 1")
        if bounded_cost:
            check_only_effort(scenario.objective, "with bounded costs, which are those of effort")
            check_no_penalties(scenario.penalties, NO_BOUND)
        if free_final_time:
            check_no_penalties(scenario.penalties, NO_COST)
            check_rest_at_goals(scenario)
            if bounded_cost:
                expected = "False with a free final time, since earlier arrivals cost more"
                raise ValueError(f"bounded_cost: got True, expected {expected}")
        self.latency = latency_in_samples(scenario, latency, int(replan_every))
        if horizon is not None and (free_final_time or bounded_cost or reference is not None):
            others = "free_final_time, bounded_cost and reference"
            raise ValueError(f"horizon: got {horizon:g} s, expected none beside {others}")
        if reference is None:
            reference = free_reference if scenario.separation is None else tail_reference
        self.replan_every, self.free_final_time = int(replan_every), free_final_time
        self.windows: list[Window] = []
        self._log = MeasurementLog()
        self._ended, self._passed, self._ends_flight = list[Flight](), 0, False
        self._given = scenario
        self._situation, self._rolling = Situation.of(scenario, self.latency), None
        if horizon is not None:
            self._rolling = RollingHorizon.of(scenario, horizon, rest_for, self.replan_every)
            self._situation = self._rolling.begun(self._situation)
        self._options, self._progress = options or Options(), progress
        self._planner = WindowPlanner(
            with_options(self._options, planner),
            fallback and with_options(self._options, fallback),
            reference,
            Backend.of(solver).solver,
            braking_after=self.replan_every if contingencies else None,
            brakes=contingencies or horizon is not None,
            bounded_cost=bounded_cost,
        )

    @property
    def scenario(self) -> Scenario:
        """Scenario as given, with what was told since when, and the times found for waypoints.

        With a latency or a smoothing, obstacles become known in flight that much later. With
        `horizon` it ends with the last window, or with that of the last of `knots`.
        """
        scenario, last = self._situation.scenario, self._situation.last
        if self._rolling is None:
            return scenario
        latest = last.first_knot if last is not None else 0
        if not self._ended:
            latest = max(latest, self.knots[-1])
        return self._rolling.until(scenario, latest)

    @property
    def knots(self) -> range:
        """Knots at which windows start, counted from 0."""
        return range(0, self._given.grid.knots - 1, self.replan_every)

    def planned(self, knot: int) -> FloatArray:
        """Return the planned states at a knot, from the last window, shape (N, 6).

        Before there is a window, these are the starts of the scenario. With a smoothing they are
        those of the averages `Scenario.lead` before the knot, when the next window is planned.

        Args:
            knot: counted from 0, not before the start of the last window.
        """
        return self._situation.planned(knot - self._passed)

    @checked
    def step(
        self,
        states: npt.ArrayLike,
        time: float,
        *,
        scenario: Scenario | None = None,
    ) -> Window:
        """Plan the next window.

        The starts of a scenario are exact. So are the states of the first window if they equal the
        starts; otherwise its tube begins with the errors of the estimate. Windows do not fail: if
        there is no plan, `Window.infeasible` gives the reason. Only the first window raises an
        error, if the scenario has no plan from its own starts either.

        Args:
            states: estimated position [m] and velocity [m/s] of each vehicle at this time, shape
                (N, 6); predicted from the newest measurement that has arrived by the commands given
                since, and with a latency by the feedback in force until this time, if the
                measurement was at most `delay` + `dropouts` samples old when planning began. A row
                of NaN, or of numbers larger than in any flight, stands for a vehicle that was not
                seen: its planned state is used, and the tube begins with the errors that it may
                have there.
                With a smoothing, states are those `Scenario.lead` before this time, and only tell
                which vehicles are off the tube.
            time: of a knot at which a step begins, after that of the previous window, on the
                scenario's clock [s]. The first window starts at the first knot.
            scenario: the scenario as it is known now, if that has changed. Vehicles, obstacles and
                requirements are matched by their names; those without one are as before only if
                they are equal. Obstacles may appear, vanish, change or, as `Obstacle.seen`, move
                otherwise; maps at rest may have other cells; requirements, goals and waypoints
                ahead may be others; starts are ignored. What is new holds from this time on, what
                is gone until then. The rest of the previous plan, with its own goals and waypoints,
                stays valid if it keeps to all else, for an obstacle that was seen again within its
                former errors as it was.

        Returns:
            The window. Its plan is flown until the next window.

        Raises:
            InfeasibleError: the scenario has no plan from its own starts, even with the fallback.
            SolverError: the solvers fail numerically there, even with the fallback.
            ScenarioError: the scenario differs in what stays the same in a flight.
            ValueError: the states have another shape or are not numbers, or the time is not that
                of a later knot.
        """
        self.accept(self._proposed(states, time, scenario))
        return self.windows[-1]

    @checked
    def propose(
        self, states: npt.ArrayLike, time: float, *, scenario: Scenario | None = None
    ) -> Proposal:
        """Plan the next window without flying it: the plan in force stays until `accept`.

        Args, results and errors are those of `step`.
        """
        return self._proposed(states, time, scenario)

    def _proposed(self, states: npt.ArrayLike, time: float, scenario: Scenario | None) -> Proposal:
        """Return the next window, not flown yet; see `step`."""
        situation, ended = self._situation, None
        if scenario is not None:
            situation.knot_at(time)  # an impossible time is refused first
        if self._begins_flight(scenario):
            ended, situation, scenario = self._next_flight(time, scenario)
        if scenario is not None:
            situation = situation.with_news(scenario, time)
            if self._rolling is not None:
                situation = self._rolling.begun(situation)
        with within_time(self._options.time_limit):
            window = self._window(situation, states, time)
        return Proposal(window, situation.with_window(window), ended)

    def _begins_flight(self, scenario: Scenario | None) -> bool:
        """Return whether the next window begins another flight."""
        known, last = self._situation.known, self._situation.last
        if self._rolling is None or last is None:
            return False
        changed = scenario is not None and changes_of(known.told, scenario)
        return bool(changed) or self._ends_flight or is_crowded(known)

    def _next_flight(
        self, time: float, scenario: Scenario | None
    ) -> tuple[Flight, Situation, Scenario | None]:
        """Return the flight that ends, the situation of the next one, and what is left to tell.

        Args:
            time: at which the next window begins, on the scenario's clock [s].
            scenario: as it is known now, if it is told.
        """
        rolling, situation = self._rolling, self._situation
        assert rolling is not None  # noqa: S101  # callers check this
        knot = situation.knot_at(time)
        windows = [*self.windows[:-1], lasting_until(self.windows[-1], knot)]
        ended = rolling.ended(situation, knot).flight(windows)
        changed = scenario is not None and changes_of(situation.known.told, scenario)
        now, left = (scenario, None) if changed else (None, scenario)
        remaining = rolling.remaining(situation, knot)
        return ended, next_flight(situation, remaining, now, rolling.endless), left

    def accept(self, proposal: Proposal) -> None:
        """Fly a proposed window from its first knot on."""
        if proposal.ended is not None:
            measured, self._log = self._log.measurements, MeasurementLog()
            self._ended.append(dataclasses.replace(proposal.ended, measured=measured))
            self._passed += proposal.ended.scenario.grid.knots - 1
            self.windows, self._ends_flight = [], False
        if self._rolling is not None and self.windows:  # which rests after its end
            self.windows[-1] = lasting_until(self.windows[-1], proposal.window.first_knot)
        self.windows.append(proposal.window)
        self._situation = proposal.situation

    @with_wall_time
    @single_threaded_blas
    def _window(self, situation: Situation, states: npt.ArrayLike, time: float) -> Window:
        """Return the next window; see `step`."""
        measured = checked_states(situation.scenario, states)
        knot, notes = situation.knot_at(time), dict[str, Any]()
        if (last := situation.last) is not None:
            notes["skipped"] = max(knot - last.first_knot - self.replan_every, 0)
        tell(self._progress, f"window {knot // self.replan_every + 1} of {len(self.knots)}")
        if situation.last is None:
            window = self._first(situation.at_start, measured)
        else:
            window, start = self._next(situation, knot, measured)
            notes["off_tube"] = start.off if start.scenario.disturbance is not None else ()
        window = self._planner.with_contingency(window)
        if self._planner.bounded_cost:
            notes["cost_bound"] = cost_bound(window.plan, self.replan_every, self.latency)
        unseen = np.isnan(measured[:, 0]).nonzero()[0]  # whole rows of NaN
        notes["unseen"] = tuple([situation.scenario.names[i] for i in unseen])
        window = unchecked(window, **notes)
        return _with_sightings(window, situation.last or window)

    def _next(
        self, situation: Situation, knot: int, states: FloatArray
    ) -> tuple[Window, WindowStart]:
        """Return a window after the first, from measured states at a knot, and its start."""
        if self._rolling is not None:
            return self._rolling.next(self._planner, situation, knot, states)
        start = self._timed(situation.at(knot, states))
        if self.free_final_time:
            return next_window(self._planner, start), start
        return self._planner.next(start), start

    def _timed(self, start: WindowStart) -> WindowStart:
        """Return a start with times for waypoints told without; guesses if no plan has any."""
        if not start.has_news or not any(map(any, free_of(start.scenario))):
            return start
        times = with_options(self._options, best_plan)
        try:
            found = times(start.scenario, reference=None, solver=self._planner.solver)
        except (*FAILURES, ScenarioError):
            scenario = with_guessed_times(start.scenario)
        else:
            scenario = with_waypoints(start.scenario, found.scenario.vehicles)
        return dataclasses.replace(start, scenario=scenario)

    @checked
    def record(self, time: npt.ArrayLike, states: npt.ArrayLike) -> None:
        """Record measured states for `Flight.measured`; nothing is planned from them.

        They may be measured at any rate, between windows, before the first and after the last. The
        states given to `step`, which may be predictions, are not recorded by it.

        Args:
            time: on the scenario's clock [s], after all recorded ones; or times, shape (M,).
            states: measured position [m] and velocity [m/s] of each vehicle, shape (N, 6), or
                (M, N, 6) for several times. A row is NaN for a vehicle that was not seen, and ends
                with three NaN if only its position was.

        Raises:
            ValueError: a time is before the flight or not after the one before, the shapes differ,
                or a vehicle has neither finite numbers nor NaN.
        """
        self._log.add(self.scenario, time, states)

    @property
    def flight(self) -> Flight:
        """Flight composed of the windows so far, each flown until the next, with what was recorded.

        Raises:
            ValueError: there is no window yet, or a mission has several flights (`flights`).
        """
        if self._ended:
            expected = "one: `flights` has all of them"
            raise ValueError(f"flight: got {len(self._ended) + 1} flights, expected {expected}")
        return self._flight

    @property
    def flights(self) -> tuple[Flight, ...]:
        """Flights of the mission so far, each until the next one begins.

        There is one, unless `horizon` is given. Then another flight begins where vehicles leave or
        join, limits, separation or objective change, or where a map has changed so often that it is
        told anew; and where `end_flight` says so.

        Raises:
            ValueError: there is no window yet.
        """
        return (*self._ended, self._flight)

    def end_flight(self) -> tuple[Flight, ...]:
        """Let another flight begin with the next window, and forget the flights before.

        So missions without an end can be stored piece by piece, with bounded memory.

        Returns:
            The flights that ended since the last call; the current one will be among those that the
            next call returns.

        Raises:
            ValueError: `horizon` is not given.
        """
        if self._rolling is None:
            raise ValueError("horizon: got None, expected a time: other flights end at their goals")
        self._ends_flight, ended = bool(self.windows), tuple(self._ended)
        self._ended.clear()
        return ended

    @property
    def _flight(self) -> Flight:
        """Current flight."""
        if not self.windows:
            raise ValueError("windows: got none, expected at least one planned window")
        situation = self._situation
        if self._rolling is not None:
            situation = self._rolling.ended(situation)
        flight = situation.flight(self.windows)
        return dataclasses.replace(flight, measured=self._log.measurements)

    def _first(self, scenario: Scenario, states: FloatArray) -> Window:
        """Return the first window of a scenario, from measured states."""
        measured = partial(from_measured, states=states)
        if self._rolling is not None:
            return self._rolling.first(self._planner, scenario, measured)
        times = with_options(self._options, best_plan)
        return FirstWindow(self._planner, times, measured, self.free_final_time).of(scenario)


def _with_sightings(window: Window, before: Window) -> Window:
    """Return a window with its newly known obstacles, and the violated ones among them.

    Only obstacles that become known in flight are considered.

    Args:
        window: that was planned.
        before: previous window.
    """
    scenario = window.plan.scenario
    late = {number for number, _ in scenario.known if scenario.bodies[number - 1].known_from > 0.0}
    if not late:
        return window
    known, violated = {number for number, _ in before.plan.scenario.known}, set[int]()
    if window.infeasible or scenario.penalties:  # a new plan avoids all that it has to
        violated = violations_of(Problem.of(scenario), window.plan).inside.keys() & late
    return dataclasses.replace(
        window, learned=tuple(sorted(late - known)), not_avoided=tuple(sorted(violated))
    )
