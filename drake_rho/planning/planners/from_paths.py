"""Plans along paths: feasibility restoration from collision-free references.

A reference along a path passes every obstacle on a free side, but is dynamically inconsistent.
Restoration finds a feasible motion near it. Among several paths, the one with the cheapest plan
after a few linearisations is chosen: further linearisations gain less than the difference between
most paths.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial
from itertools import islice

from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.call.options import DEFAULTS, Options
from drake_rho.planning.call.progress import Progress, tell, within
from drake_rho.planning.constraints.separation import decoupled
from drake_rho.planning.constraints.tightening import enlarged_by_margins
from drake_rho.planning.errors import InfeasibleError, Names, OutOfTimeError, SolverError
from drake_rho.planning.path_search.continuation import continuation_step
from drake_rho.planning.path_search.initial_guesses import paths_on_grids
from drake_rho.planning.planners.perturbed_guesses import PERTURBATIONS, perturbed_vehicle
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.scp.patience import DeadEnds
from drake_rho.planning.scp.restoration import Follow, restore_feasibility
from drake_rho.planning.scp.sequential_convex import sequential_convex
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.scenario.records import Scenario
from drake_rho.system.threads import single_threaded_blas

_NAMED = 4
"""Largest number of obstacles that a message about a vehicle without a path lists individually."""

_GRIDS = 2
"""Largest number of grids. The next grid is searched if paths on the last one lead to no plan."""

_MOST_LINEARISATIONS = 30
"""Linearisations after which no further perturbation is tried: successful searches took fewer."""

_KNOWN_ENDS = 4
"""Consecutive perturbations that lead to known dead ends, after which no further one is tried."""

_ROUGHLY = 1e-2
"""Relative fall of the cost per linearisation at which plans along different paths are compared."""


@dataclasses.dataclass(frozen=True, eq=False)
class PathResult:
    """Result of planning along paths: the best plan, or the conflicts that prevented one."""

    scenario: Scenario
    """scenario to plan"""
    plan: Plan | None
    """plan that meets every constraint; None if none was found"""
    spent: Statistics
    """statistics of the path search and of all restorations"""
    conflicts: dict[str, Names]
    """conflicting constraints of each vehicle if there is no plan, as in `InfeasibleError`"""
    obstacles: dict[str, frozenset[int]]
    """numbers of the obstacles among them, 0 for other vehicles"""


@single_threaded_blas
def plan_along_paths(
    problem: Problem,
    backend: Backend | None = None,
    options: Options = DEFAULTS,
    progress: Progress | None = None,
    perturbed: bool = True,
) -> PathResult:
    """Search for paths around the obstacles, and for a plan near one of them.

    Args:
        problem: to be solved.
        backend: Clarabel if not given.
        options: `max_ways` bounds the paths that are tried.
        progress: called with a short text on the current activity.
        perturbed: whether a second grid and perturbed initial guesses of a vehicle are tried if all
            paths fail.
    """
    tell(progress, "looking for paths around the obstacles")
    scenario, larger = problem.scenario, enlarged_by_margins(problem.scenario, problem.margins)
    grids = paths_on_grids(larger.without_penalties(), options.max_ways, options.max_memory)
    attempts, best = _Attempts(problem, backend), None
    for found in islice(grids, _GRIDS if perturbed else 1):
        attempts.count(Statistics(searched=found.searched))
        if (best := _best_along(found.references, attempts, progress)) is not None:
            break
    if best is None and found.references and len(scenario.vehicles) == 1 and perturbed:
        best = _near_perturbed(attempts, progress)
    spent, failure = attempts.spent, attempts.failure
    if best is not None or failure is None:
        conflicts, obstacles = _everything(scenario) if best is None else ({}, {})
        return PathResult(scenario, best, spent, conflicts, obstacles)
    return PathResult(scenario, None, spent, failure.conflicts, failure.obstacles)


class _Attempts:
    """Restorations of one problem from several references.

    Args:
        problem: to be solved.
        backend: Clarabel if not given.

    Attributes:
        scenario: of the problem.
        follow: continuation of a reference towards a plan.
        dead_ends: motions at which restorations without a plan ended.
        spent: statistics of all restorations.
        failure: error of the first restoration without a plan; None as long as there is none.
    """

    def __init__(self, problem: Problem, backend: Backend | None) -> None:
        self.scenario, self.dead_ends = problem.scenario, DeadEnds(problem.scenario)
        self.follow = partial(continuation_step, margin=problem.margins.steps.largest)
        self.spent = Statistics()
        self.failure: InfeasibleError | None = None
        self._subproblem = Subproblem(problem, decoupled, backend)

    def total_cost(self, plan: Plan) -> float:
        """Return the cost by which plans are compared [m²/s⁴]."""
        return self._subproblem.problem.total_cost(plan)

    def count(self, spent: Statistics) -> None:
        """Add the statistics of a search for references."""
        self.spent += spent

    def plan_near(
        self,
        reference: Plan,
        progress: Progress | None,
        follow: Follow | None = None,
        *,
        improved: bool = False,
    ) -> Plan | None:
        """Return a plan near a reference; None if none is found.

        Args:
            reference: around which to linearise first.
            progress: called after each linearisation.
            follow: gives the next reference, as in `restore_feasibility`.
            improved: whether to iterate until the cost can be compared with that of other plans.
        """
        subproblem = self._subproblem = self._subproblem.restarted()
        try:
            plan = restore_feasibility(
                subproblem,
                reference,
                progress=progress,
                follow=follow,
                dead_ends=self.dead_ends,
            )
        except (InfeasibleError, SolverError) as error:
            self.spent = error.statistics + self.spent
            if isinstance(error, InfeasibleError):
                self.failure = self.failure or error
            return None
        if improved:
            plan = sequential_convex(subproblem, plan, _ROUGHLY, progress=progress)
        self.spent = plan.statistics + self.spent
        return plan


def _best_along(
    references: Sequence[Plan], attempts: _Attempts, progress: Progress | None
) -> Plan | None:
    """Return the cheapest plan near any of the references; None if none is found.

    Continuation keeps the reference on the sides of a path even if vehicles cannot fly together on
    these sides. If it fails for a fleet, restoration is repeated with each motion as the next
    reference. A single vehicle has perturbed initial guesses instead.
    """
    best: Plan | None = None
    single, several = len(attempts.scenario.vehicles) == 1, len(references) > 1
    for number, reference in enumerate(references, start=1):
        along = within(progress, f"path {number} of {len(references)}")
        try:
            plan = attempts.plan_near(reference, along, attempts.follow, improved=several)
            if plan is None and not single:
                plan = attempts.plan_near(reference, along, improved=several)
        except OutOfTimeError:
            if best is None:
                raise
            return best
        total = attempts.total_cost
        if plan is not None and (best is None or total(plan) < total(best)):
            best = plan
    return best


def _near_perturbed(attempts: _Attempts, progress: Progress | None) -> Plan | None:
    """Return a plan of one vehicle near a perturbation of its minimum effort; None if none."""
    before, since = attempts.spent.linearisations, 0
    for number in range(PERTURBATIONS):
        linearisations = attempts.spent.linearisations - before
        if linearisations > _MOST_LINEARISATIONS or since == _KNOWN_ENDS:
            break
        known = len(attempts.dead_ends)
        guess = within(progress, f"perturbed initial guess {number + 1} of {PERTURBATIONS}")
        plan = attempts.plan_near(perturbed_vehicle(attempts.scenario, number), guess)
        if plan is not None:
            return plan
        since = 0 if len(attempts.dead_ends) > known else since + 1
    return None


def _everything(scenario: Scenario) -> tuple[dict[str, Names], dict[str, frozenset[int]]]:
    """Return all known obstacles as the conflicts of each vehicle, by name and by number."""
    numbers = frozenset(number for number, _ in scenario.avoided)
    listed = tuple(map(scenario.obstacle_name, sorted(numbers)))
    if len(listed) > _NAMED:
        listed = (f"some of {listed[0]} to {listed[-1]}",)
    names = [vehicle.name for vehicle in scenario.vehicles]
    return dict.fromkeys(names, listed), dict.fromkeys(names, numbers)


def no_plan(
    lost: Sequence[PathResult],
    scenario: Scenario,
    spent: Statistics,
    failure: InfeasibleError | None,
) -> InfeasibleError:
    """Return the error for vehicles without a plan along any path.

    Args:
        lost: results without a plan.
        scenario: to be planned, with these vehicles and others.
        spent: statistics of all attempts.
        failure: error for which paths were searched. The conflicts that it names for a vehicle are
            proved of the linearisation, and replace those of the vehicle's attempts along paths.
    """
    conflicts: dict[str, Names] = {}
    obstacles: dict[str, frozenset[int]] = {}
    for along in lost:
        conflicts |= along.conflicts
        obstacles |= along.obstacles
    reference = None
    if failure is not None:
        reference = failure.reference
        conflicts |= {k: v for k, v in failure.conflicts.items() if k in conflicts}
        obstacles |= {k: v for k, v in failure.obstacles.items() if k in obstacles}
    return InfeasibleError(
        conflicts, statistics=spent, scenario=scenario, obstacles=obstacles, reference=reference
    )
