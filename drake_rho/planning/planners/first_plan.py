"""First feasible plan, from which sequential convex programming starts.

If the first linearisation is infeasible, the vehicles that fail get paths around the obstacles, and
fleets are separated by feasibility restoration.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from contextlib import suppress
from itertools import repeat

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.call.options import Options
from drake_rho.planning.call.progress import Progress, tell, within
from drake_rho.planning.call.time_limit import within_time
from drake_rho.planning.constraints.separation import decoupled
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.planners.convex import linearised_once
from drake_rho.planning.planners.from_paths import PathResult, no_plan, plan_along_paths
from drake_rho.planning.planners.related import can_be_slower, fitted, rescaled
from drake_rho.planning.problem import Problem, with_finer_margins
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.scp.fleet_steps import FleetSteps
from drake_rho.planning.scp.restoration import MAX_RESTORATIONS, restore_feasibility
from drake_rho.planning.scp.subproblem import Subproblem, plan_around

_SHORTER = 0.75, 0.5
"""Fractions of the duration that are tried if it has no plan and motions can be flown slower."""

_FEW = 0.25
"""Largest fraction of a fleet that may violate obstacles in an independent start."""


@dataclasses.dataclass(frozen=True)
class FirstPlan:
    """Search for a first feasible plan of a problem."""

    backend: Backend = dataclasses.field(default_factory=Backend)
    """solver of its programs"""
    progress: Progress | None = None
    """called with a short text on the current activity"""
    options: Options = dataclasses.field(default_factory=Options)
    """bounds of the search"""
    most: int = MAX_RESTORATIONS
    """largest number of penalties in one restoration of a fleet"""
    thorough: bool = True
    """whether to try paths that avoid each other if restoration does not separate a fleet, and
    finer grids and perturbed initial guesses if no path of a vehicle leads to a plan"""

    def of_any_duration(self, problem: Problem, reference: Plan | None = None) -> Plan:
        """Return a first plan, possibly one for a shorter duration flown slower.

        Args and errors are those of `plan`.
        """
        try:
            return self.of(problem, reference)
        except InfeasibleError as error:
            failure = error
        try:
            return self._slower(problem, failure)
        except InfeasibleError as error:
            return self._around_then_apart(problem, error)

    def of(self, problem: Problem, reference: Plan | None = None) -> Plan:
        """Return a first plan, with the margins of a problem.

        Args and errors are those of `plan`.
        """
        scenario = problem.scenario
        problem.check_tightening_slack()
        if scenario.separation is not None:
            return self._of_fleet(problem, reference)
        try:
            return linearised_once(problem, reference, self.backend)
        except SolverError:
            if (held := self._held(problem, reference)) is not None:
                return held
            if not scenario.avoided:
                raise
            return self._around_obstacles(problem, [each.name for each in scenario.vehicles])
        except InfeasibleError as error:
            if (held := self._held(problem, reference)) is not None:
                return held
            if not error.about_linearisation:
                raise
            return self._around_obstacles(problem, list(error.conflicts), error)

    def _of_fleet(self, problem: Problem, reference: Plan | None) -> Plan:
        """Return a first plan of a fleet with a separation.

        Independent plans are a good start as long as few vehicles violate obstacles: these get
        paths of their own. Otherwise, or if restoration cannot separate the fleet, all vehicles get
        paths that avoid each other.
        """
        if (apart := self._around_if_apart(problem, reference)) is not None:
            return apart
        independent, scenario = problem.without_separation(), problem.scenario
        try:
            try:
                tell(self.progress, "planning each vehicle without the others")
                plan = linearised_once(independent, reference, self.backend)
            except SolverError:
                if not scenario.avoided:
                    raise
                return self._along_paths(problem, None)
            except InfeasibleError as error:
                if not error.about_linearisation or len(error.conflicts) > _FEW * len(problem):
                    raise
                single = dataclasses.replace(
                    self, options=dataclasses.replace(self.options, max_ways=1)
                )
                plan = single._around_obstacles(independent, list(error.conflicts), error)
            return self._apart(problem, plan)
        except InfeasibleError as error:
            failure = error.replaced(scenario=scenario)  # with its separation
            if not (failure.about_linearisation and self.thorough):
                raise failure from None
            return self._along_paths(problem, failure)

    def _apart(self, problem: Problem, independent: Plan) -> Plan:
        """Return a first plan of a fleet, restored from a plan without its separation."""
        accelerations, spent = independent.accelerations, independent.statistics
        start = Plan.from_accelerations(problem.scenario, accelerations, spent)
        return restored(problem, start, self.backend, self.progress, self.most)

    def _around_then_apart(self, problem: Problem, failure: InfeasibleError) -> Plan:
        """Return a first plan of a fleet near vehicles' own plans along their own paths.

        A fleet's paths may not exist on a grid on which every vehicle alone has one.

        Raises:
            InfeasibleError: the failure, if it is proved, the vehicles need no paths, or this leads
                to no plan either.
        """
        together = problem.scenario.separation is not None and len(problem) > 1
        if not (together and failure.about_linearisation):
            raise failure
        try:
            alone = self.of(problem.without_separation())
            # without paths, this was the start of the search that failed
            first = None if alone.statistics.searched is None else self._apart(problem, alone)
        except (InfeasibleError, SolverError) as error:
            spent = error.statistics + failure.statistics  # with the failure's path search
            raise failure.replaced(statistics=spent) from None
        if first is None:
            raise failure
        return first.with_statistics(failure.statistics + first.statistics)

    def _along_paths(self, problem: Problem, failure: InfeasibleError | None) -> Plan:
        """Return a first plan along paths of all vehicles, after other attempts have failed."""
        along = plan_along_paths(problem, self.backend, self.options, self.progress)
        spent = along.spent if failure is None else failure.statistics + along.spent
        if along.plan is None:
            raise no_plan([along], problem.scenario, spent, failure) from None
        return along.plan.with_statistics(spent)

    def _around_if_apart(self, problem: Problem, reference: Plan | None) -> Plan | None:
        """Return a fleet's plan around a reference that meets the separation, or None."""
        subproblem = Subproblem(problem, decoupled, self.backend)
        if reference is None or len(subproblem.violations(reference).pairs) > 0:
            return None
        with suppress(InfeasibleError, SolverError):
            return subproblem.solve_around(reference)
        return self._held(problem, reference)

    def _held(self, problem: Problem, reference: Plan | None) -> Plan | None:
        """Return a reference as a plan if it violates nothing; otherwise None."""
        if reference is None or not Subproblem(problem, decoupled).holds(reference):
            return None
        return Plan.from_accelerations(problem.scenario, reference.accelerations)

    def _slower(self, problem: Problem, failure: InfeasibleError) -> Plan:
        """Return a first plan from one for a shorter duration, flown slower.

        Raises:
            InfeasibleError: the failure, if it is proved, motions cannot be flown slower, or no
                shorter duration has a plan.
        """
        scenario, searched = problem.scenario, failure.statistics.searched
        no_path = searched is not None and searched.ways == 0
        if no_path or not failure.about_linearisation or not can_be_slower(scenario):
            raise failure
        spent = failure.statistics
        for factor in _SHORTER:
            shorter = rescaled(scenario, factor)
            words = f"trying a duration of {shorter.grid.duration:.4g} s"
            tell(self.progress, words)
            search = dataclasses.replace(self, progress=within(self.progress, words))
            try:
                plan = search.of(dataclasses.replace(problem, scenario=shorter))
            except (InfeasibleError, SolverError) as error:
                spent += error.statistics
                if isinstance(error, InfeasibleError) and not error.about_linearisation:
                    break  # too short even without obstacles and other vehicles
                continue
            first = self.of(problem, fitted(plan, scenario))
            return first.with_statistics(spent + plan.statistics + first.statistics)
        raise failure.replaced(statistics=spent)

    def _around_obstacles(
        self, problem: Problem, failing: Sequence[str], failure: InfeasibleError | None = None
    ) -> Plan:
        """Return a first plan with paths for the vehicles whose first linearisation is infeasible.

        Raises:
            InfeasibleError: one of them has no plan along any path.
        """
        scenario = problem.scenario
        free = plan_around(problem.without_obstacles(), None, self.backend)
        spent = free.statistics if failure is None else failure.statistics + free.statistics
        indices = problem.with_linked(np.sort([scenario.index_of(name) for name in failing]))
        labels = problem.linked_groups[indices]
        groups = [indices[labels == label] for label in dict.fromkeys(labels.tolist())]
        alone = [
            dataclasses.replace(problem, scenario=scenario.of_vehicles(group.tolist()))
            for group in groups
        ]
        thorough = repeat(self.thorough)
        if self.backend.executor is not None:  # workers cannot report progress
            own = repeat(self.backend.here()), repeat(self.options)
            found = list(self.backend.executor.map(_on_worker, alone, *own, thorough))
        else:
            parts = [within(self.progress, scenario.names[group[0]]) for group in groups]
            own = repeat(self.backend), repeat(self.options)
            found = list(map(plan_along_paths, alone, *own, parts, thorough))
        accelerations = np.array(free.accelerations)
        for group, along in zip(groups, found, strict=True):
            spent += along.spent
            if along.plan is not None:
                accelerations[group] = along.plan.accelerations
        if lost := [along for along in found if along.plan is None]:
            raise no_plan(lost, scenario, spent, failure)
        reference = Plan.from_accelerations(scenario, accelerations)
        try:
            plan = plan_around(problem, reference, self.backend)
        except (InfeasibleError, SolverError, OutOfTimeError):  # rounding errors, without any slack
            if not Subproblem(problem, decoupled, self.backend).holds(reference):
                raise
            plan = reference
        return plan.with_statistics(spent + plan.statistics)


def _on_worker(problem: Problem, backend: Backend, options: Options, thorough: bool) -> PathResult:
    """Return the plan along paths of a problem, in a worker process."""
    with within_time(options.time_limit):
        return plan_along_paths(problem, backend, options, perturbed=thorough)


def restored(
    problem: Problem,
    start: Plan,
    backend: Backend | None,
    progress: Progress | None = None,
    most: int = MAX_RESTORATIONS,
) -> Plan:
    """Return a plan near a motion, restored by raising the penalties of its violations.

    Args:
        problem: to be solved, with the margins to keep.
        start: motion of the same vehicles, which may violate any constraint.
        backend: Clarabel if not given.
        progress: called after each linearisation.
        most: the largest number of penalties.

    Raises:
        InfeasibleError: no plan was found.
    """
    subproblem = Subproblem(problem, decoupled, backend)
    # links of two vehicles couple their programs, which references in groups do not support
    in_groups = problem.scenario.separation is not None and not problem.has_links
    step = FleetSteps(subproblem) if in_groups else None
    return restore_feasibility(subproblem, start, step=step, most=most, progress=progress)


def plan_near(
    problem: Problem,
    reference: Plan,
    *,
    backend: Backend | None = None,
    progress: Progress | None = None,
    most: int = MAX_RESTORATIONS,
) -> Plan:
    """Return a first plan near a reference, without a path search.

    Args:
        problem: to be solved.
        reference: positions of the same vehicles at as many knots; may be dynamically inconsistent.
        backend: Clarabel if not given.
        progress: called after each linearisation.
        most: the largest number of penalties of a restoration.

    Raises:
        InfeasibleError: there is no plan, or none was found from the reference.
        SolverError: the solvers fail numerically.
    """

    def find(problem: Problem) -> Plan:
        scenario = problem.scenario
        problem.check_tightening_slack()
        if not scenario.avoided and scenario.separation is None:
            return linearised_once(problem, None, backend)
        return restored(problem, reference, backend, progress, most)

    return with_finer_margins(find, problem)


def first_plan(
    problem: Problem, *, backend: Backend | None = None, progress: Progress | None = None
) -> Plan:
    """Return the first iterate of `plan`: it satisfies every constraint, but is not iterated.

    Args and errors are those of `plan_near`.
    """
    return with_finer_margins(FirstPlan(backend or Backend(), progress).of, problem)
