"""`diagnose`: why a scenario has no plan, by how much it fails, and what would mend it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Protocol

from drake_rho.analysis.diagnosis import Diagnosis
from drake_rho.analysis.infeasible_subset import infeasible_subset
from drake_rho.motion.plan import Plan
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.options import Options
from drake_rho.planning.planners.first_plan import first_plan, plan_near
from drake_rho.planning.planners.plan import plan_scp
from drake_rho.planning.planners.related import can_be_slower, paced, rescaled
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend, Solver, SolverName
from drake_rho.planning.progress import Progress, tell, within
from drake_rho.planning.scp.minimum_violation import minimum_violation
from drake_rho.planning.time_limit import check_time, with_time_limit
from drake_rho.planning.wall_time import with_wall_time
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.records import Box, Limits, Scenario, Vehicle
from drake_rho.verification.report import Check
from drake_rho.verification.verify import verify

BISECTED = 1e-4
"""Relative precision of the shortest duration and of the smallest relaxation."""

BISECTED_AROUND = 1e-3
"""Relative precision with obstacles, where a trial may have to look for ways round."""

BISECTED_APART = 1e-2
"""Relative precision for fleets that keep apart, where a trial that fails is a long search."""

LARGEST_FACTOR = 2.0**10
"""How much longer, or how much stronger vehicles, are looked at."""

_ANEW = 3
"""How often a boundary that plans near each other lead to is looked beyond everywhere."""

SHORTER = 0.5**0.5
"""The next shorter duration that is tried, in parts of the last one, where shorter may help: the
durations that have a plan may be few."""


@checked
@with_time_limit
def diagnose(
    scenario: Scenario,
    *,
    solver: Solver | SolverName | None = None,
    progress: Progress | None = None,
    time_limit: float | None = None,
) -> Diagnosis:
    """Say why a scenario has no plan, by how much, and what would mend it.

    Obstacles are taken as in the first linearisation, around the plan without them; the repairs
    are found with the first plan of `plan_scp`, which also tries ways round.

    Where longer is not always possible (`can_be_slower`), shorter durations are tried as well.

    Args:
        scenario: what is asked.
        solver: `"clarabel"`, `"daqp"` or `"osqp"`, or a Drake solver; Clarabel if not given.
        progress: called with a few words on what is being done, as on each trial.
        time_limit: seconds, above 0, after which what is known then is returned (`cut`).

    Raises:
        OutOfTimeError: time was up before there was a plan, or a reason why there is none.
        SolverError: the solvers fail numerically.

    Examples:
        >>> scenario = rho.Scenario(
        ...     "hurry",
        ...     rho.Grid.lasting(10.0, step=0.25),
        ...     [rho.Vehicle("scout", rho.State([0, 0, 2]), rho.State([20, 0, 2]))],
        ...     limits=rho.Limits(max_acceleration=0.7),
        ... )
        >>> rho.diagnose(scenario).conflicts
        {'scout': ('goal x', 'maximum acceleration from 0 s to 9.75 s')}
    """
    backend = Backend.of(solver)
    violations: tuple[Check, ...] = ()
    bearable, premise, trials = None, "", _Trials(backend, progress)
    try:
        plan = first_plan(Problem.of(scenario), backend=backend, progress=progress)
    except InfeasibleError as error:
        trials.begin(None)
        bearable = _bearable_wind(scenario, trials)
        conflicts, premise = error.conflicts, error.premise
        try:
            if bearable is None and scenario.disturbance is not None:
                error = _undisturbed(error, scenario, backend)
            tell(progress, "looking for constraints that cannot be met together")
            conflicts, premise = infeasible_subset(error, solver=backend.solver), error.premise
            tell(progress, "looking for the least breach")
            violations = verify(minimum_violation(Problem.of(scenario), backend)).violations
        except OutOfTimeError:
            trials.cut = True
        if bearable is not None:  # what is left can be met, so that it has a part in every conflict
            conflicts = {name: (*why, "disturbance") for name, why in conflicts.items()}
    else:
        trials.begin(plan)
        conflicts, violations = {}, verify(plan).violations
    shortest, longest = _durations(scenario, trials)
    stronger = _smallest_relaxation(scenario, trials)
    return Diagnosis(
        scenario=scenario,
        conflicts=conflicts,
        violations=tuple(one for one in violations if one.vehicle in conflicts),
        shortest_duration=shortest,
        longest_duration=longest,
        is_monotone=is_monotone(scenario),
        acceleration_factor=stronger,
        premise=premise,
        bearable_wind=bearable,
        cut=trials.cut,
    )


@checked
@with_wall_time
@with_time_limit
def shortest_plan(
    scenario: Scenario,
    *,
    solver: Solver | SolverName | None = None,
    progress: Progress | None = None,
    options: Options | None = None,
) -> Plan:
    """Return the plan of least duration, on as many knots, everything else unchanged.

    The flight begins at the same time, and obstacles move as they did. The duration is found by
    bisection to a relative `BISECTED`. Where feasibility grows with the duration (`is_monotone`)
    none is shorter; else a shorter one may have been passed over, and where longer is not always
    possible (`can_be_slower`), a scenario without a plan may have one for a shorter duration.

    Args:
        scenario: what is asked; its own duration need not be feasible.
        solver: `"clarabel"`, `"daqp"` or `"osqp"`, or a Drake solver; Clarabel if not given.
        progress: called with a few words on what is being done, as on each trial.
        options: of the plan that is returned, and `time_limit` of all trials together: then the
            shortest so far is returned (`statistics.cut`).

    Raises:
        InfeasibleError: no duration that was tried, up to `LARGEST_FACTOR` times the scenario's,
            has a plan.
        OutOfTimeError: time was up before one was found.
    """
    trials = _Trials(Backend.of(solver), progress)
    duration, _ = _durations(scenario, trials)
    if duration is None:
        check_time()
        plan_scp(scenario, solver=solver, progress=progress, options=options)  # says why
        raise SolverError("a duration had a plan that could not be found again")
    found = trials.plan
    assert found is not None  # noqa: S101  # of that duration
    shortest = rescaled(scenario, duration / scenario.grid.duration)
    try:
        reference = paced(found, shortest)
        plan = plan_scp(
            shortest, reference=reference, solver=solver, progress=progress, options=options
        )
    except OutOfTimeError:
        plan = found
    return plan.with_statistics(dataclasses.replace(plan.statistics, cut=trials.cut))


def is_monotone(scenario: Scenario) -> bool:
    """Return whether a plan for one duration means that one is found for every longer one.

    With obstacles or a separation that is not claimed where it is true of the problem
    (`can_be_slower`) either, since the planner may miss the plan of one duration and find that of
    another.
    """
    return can_be_slower(scenario) and not scenario.obstacles and scenario.separation is None


class _Trials:
    """Whether scenarios have a plan, one after the other.

    A plan of one is where the search for that of the next begins.

    Args:
        backend: solves their programs.
        progress: called with a few words on each trial.

    Attributes:
        plan: the last that was found.
        begun: whether the scenario that they are about has a plan, if that is known.
        cut: whether time was up; then no other scenario has a plan as far as is known.
    """

    def __init__(self, backend: Backend, progress: Progress | None) -> None:
        self.plan: Plan | None = None
        self.begun: bool | None = None
        self.cut = False
        self._backend, self._progress = backend, progress

    def begin(self, plan: Plan | None) -> None:
        """Begin with the plan of the scenario itself, or with its having none."""
        self.plan, self.begun = plan, plan is not None

    def has_plan(self, make: Callable[[], Scenario], words: str, *, near: bool = False) -> bool:
        """Return whether a plan is found for what is made.

        Args:
            make: a scenario like those before it.
            words: what is tried, to be told.
            near: whether to look near the last plan only.
        """
        if self.cut:
            return False
        words = f"trying {words}"
        tell(self._progress, words)
        try:
            self.plan = self._found(make(), within(self._progress, words), near)
        except (InfeasibleError, SolverError, ScenarioError):
            return False
        except OutOfTimeError:
            self.cut = True
            return False
        return True

    def _found(self, scenario: Scenario, progress: Progress | None, near: bool) -> Plan:
        problem = Problem.of(scenario)
        if near and self.plan is not None:
            reference = paced(self.plan, scenario)
            return plan_near(problem, reference, backend=self._backend, progress=progress)
        return first_plan(problem, backend=self._backend, progress=progress)


def _undisturbed(error: InfeasibleError, scenario: Scenario, backend: Backend) -> InfeasibleError:
    """Return why there is no plan without the disturbance either, which says more than with it."""
    try:
        first_plan(Problem.of(scenario.with_disturbance(None)), backend=backend)
    except InfeasibleError as other:
        return other
    except SolverError:
        pass
    return error


def _durations(scenario: Scenario, trials: _Trials) -> tuple[float | None, float | None]:
    """Return the least duration with a plan, and the greatest if that is below the scenario's [s].

    None where none is found; and for the greatest, where the scenario's own, or a longer one, has a
    plan.
    """
    duration, precision = scenario.grid.duration, _precision(scenario)

    def lasting(factor: float, near: bool = False) -> bool:
        words = f"a duration of {factor * duration:.5g} s"
        return trials.has_plan(lambda: rescaled(scenario, factor), words, near=near)

    high = _some_factor(lasting, trials.begun, shorter=not can_be_slower(scenario))
    if high is None:
        return None, None
    longest = None
    if high < 1.0:
        found = trials.plan
        longest = duration * _boundary(lasting, high, high / SHORTER, precision)
        trials.plan = found
    while 1.0 >= high > 1.0 / LARGEST_FACTOR and lasting(high / 2.0):
        high /= 2.0
    if high > 1.0 / LARGEST_FACTOR:
        high = _boundary(lasting, high, high / 2.0, precision)
    return duration * high, longest


class _Trial(Protocol):
    """Whether there is a plan with some factor; `near` looks near the last one found only."""

    def __call__(self, factor: float, near: bool = False) -> bool: ...


def _some_factor(has_plan: _Trial, begun: bool | None, *, shorter: bool) -> float | None:
    """Return a factor that has a plan, of powers of two and, if `shorter`, of `SHORTER`.

    Whether 1 has one may be known (`begun`).
    """
    if has_plan(1.0) if begun is None else begun:
        return 1.0
    longer, less = 2.0, SHORTER
    while longer <= LARGEST_FACTOR:
        if has_plan(longer):
            return longer
        while shorter and less >= 1.0 / longer:
            if has_plan(less):
                return less
            less *= SHORTER
        longer *= 2.0
    return None


def _boundary(has_plan: _Trial, one: float, other: float, precision: float) -> float:
    """Return the last factor with a plan on the way from one that has it to one that has not.

    Plans are looked for near those before them, which takes a part of the time. Where none is left,
    one is looked for everywhere; if there is one, it goes on from there.
    """
    without = other
    for _ in range(_ANEW):
        other = without
        while abs(one - other) > precision * max(one, other):
            middle = (one + other) / 2.0
            one, other = (middle, other) if has_plan(middle, near=True) else (one, middle)
        if other == without or not has_plan(other):
            break
        one = other
    return one


def _least_factor(has_plan: _Trial, begun: bool | None, precision: float) -> float | None:
    """Return the least factor from 1 on that has a plan, by doubling, then bisection.

    None if none up to the largest has. Whether 1 has one may be known (`begun`).
    """
    factor = _some_factor(has_plan, begun, shorter=False)
    if factor is None or factor == 1.0:
        return factor
    return _boundary(has_plan, factor, factor / 2.0, precision)


def _precision(scenario: Scenario) -> float:
    """Relative precision to which trials of a scenario are worth their time."""
    precision = BISECTED_AROUND if scenario.obstacles else BISECTED
    return BISECTED_APART if scenario.separation is not None else precision


def _bearable_wind(scenario: Scenario, trials: _Trials) -> float | None:
    """The largest wind with a plan [m/s²], of a scenario that has none; see `Diagnosis`."""
    around = scenario.disturbance
    if around is None:
        return None

    def bears(part: float) -> bool:
        weaker = dataclasses.replace(around, acceleration=part * around.acceleration)
        words = f"wind up to {weaker.acceleration:.4g} m/s²"
        return trials.has_plan(lambda: dataclasses.replace(scenario, disturbance=weaker), words)

    if not trials.has_plan(lambda: dataclasses.replace(scenario, disturbance=None), "no wind"):
        return None
    if around.acceleration == 0.0 or not bears(0.0):
        return 0.0
    low, high = 0.0, 1.0
    while high - low > _precision(scenario):
        middle = (low + high) / 2.0
        low, high = (middle, high) if bears(middle) else (low, middle)
    return low * around.acceleration


def _smallest_relaxation(scenario: Scenario, trials: _Trials) -> float | None:
    limits = [scenario.limits_of(vehicle) for vehicle in scenario.vehicles]
    if not any(each.acceleration or each.max_acceleration for each in limits):
        return None

    def suffices(factor: float, near: bool = False) -> bool:
        words = f"acceleration limits {factor:.5g} times as wide"
        return trials.has_plan(lambda: _stronger(scenario, factor), words, near=near)

    return _least_factor(suffices, trials.begun, _precision(scenario))


def _stronger(scenario: Scenario, factor: float) -> Scenario:
    """The scenario with every limit on accelerations `factor` times as wide, around zero."""

    def wider(limits: Limits | None) -> Limits | None:
        if limits is None:
            return None
        box, most = limits.acceleration, limits.max_acceleration
        return dataclasses.replace(
            limits,
            acceleration=box and Box(factor * box.lower, factor * box.upper),
            max_acceleration=most and factor * most,
        )

    def stronger(vehicle: Vehicle) -> Vehicle:
        return dataclasses.replace(vehicle, limits=wider(vehicle.limits))

    return dataclasses.replace(
        scenario,
        limits=wider(scenario.limits) or Limits(),
        vehicles=tuple(stronger(vehicle) for vehicle in scenario.vehicles),
    )
