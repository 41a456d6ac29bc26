"""The paper's convex method: one linearisation of obstacles, around a plan that ignores them."""

from __future__ import annotations

from collections.abc import Iterable

from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.call.options import Options
from drake_rho.planning.call.plan_in_force import motion_in_force
from drake_rho.planning.call.time_limit import with_time_limit
from drake_rho.planning.call.wall_time import with_wall_time
from drake_rho.planning.errors import InfeasibleError
from drake_rho.planning.problem import Problem, with_finer_margins
from drake_rho.planning.programs.backend import Backend, Solver, SolverName
from drake_rho.planning.scp.cutting_planes import CuttingPlanes
from drake_rho.planning.scp.subproblem import Subproblem, coupling_for
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import unchecked
from drake_rho.scenario.records import Grid, Scenario


@checked
@with_wall_time
@with_time_limit
def plan_convex(
    scenario: Scenario,
    *,
    reference: Plan | None = None,
    steps: Iterable[float] = (),
    solver: Solver | SolverName | None = None,
    options: Options | None = None,
) -> Plan:
    """Plan by the paper's convex method.

    Step 1: the scenario's h. Step 2: solve without the obstacles, linearise (8) around the result
    as (15), solve again. Step 3: if there is no solution, try another h of the same duration.

    A separation, which the paper leaves to future work, is linearised in step 2 as well. Where
    vehicles meet, linearisation around the plan without it is seldom feasible: use `plan_scp`.

    Args:
        scenario: the problem to solve.
        reference: motion to linearise around in place of step 2's own; on the scenario's grid.
        steps: further steps h [s] to try in this order, if the scenario's own has no solution. The
            plan has the chosen one in `scenario.grid`, and all that were tried in
            `statistics.steps_tried`.
        solver: `"clarabel"`, `"daqp"` or `"osqp"`, or a Drake solver; Clarabel if not given.
        options: only `time_limit` and `solver_options` are used; `Options()` if not given.

    Returns:
        A plan that meets every constraint of the scenario.

    Raises:
        InfeasibleError: no step has a solution; the error names the conflicting constraints.
        OutOfTimeError: `options.time_limit` was over before there was a plan.
        SolverError: the solvers fail numerically.
        ValueError: a step does not divide the duration, the reference does not fit, or the solver
            does not know an option.

    Examples:
        >>> rho.plan_convex(rho.load_scenario("paper"))
        <Plan of paper: 4 vehicles, 50 knots, cost 20920.4 m²/s⁴>
    """
    others = [_grid(step, scenario.grid) for step in steps]
    if reference is not None and others:
        raise ValueError("steps: got some beside a reference, expected none: it has one step")
    backend = Backend.of(solver, options=options.solver_options if options else None)
    failures: list[InfeasibleError] = []
    statistics = Statistics()
    steps_tried: tuple[float, ...] = ()
    for grid in (scenario.grid, *others):
        tried = scenario.on_grid(grid) if steps_tried else scenario
        steps_tried += (grid.step,)
        try:
            plan = with_finer_margins(
                lambda problem: linearised_once(problem, reference, backend),
                Problem.of(tried, before=motion_in_force(tried)),
            )
        except InfeasibleError as error:
            failures.append(error)
            statistics += error.statistics
        else:
            statistics = unchecked(statistics + plan.statistics, steps_tried=steps_tried)
            return plan.with_statistics(statistics)
    first = failures[0]
    if first.bearable is not None:
        raise first
    raise first.replaced(steps_tried=steps_tried, statistics=statistics)


def linearised_once(
    problem: Problem, reference: Plan | None = None, backend: Backend | None = None
) -> Plan:
    """Return a plan by steps 1 and 2 for the scenario's h, with the margins of a problem.

    Raises:
        InfeasibleError: there is none.
        SolverError: the solvers fail numerically.
    """
    scenario = problem.scenario
    problem.check_tightening_slack()
    try:
        return _plan(problem, reference, backend)
    except InfeasibleError as error:
        raise error.replaced(steps_tried=(scenario.grid.step,)) from None


def _plan(problem: Problem, reference: Plan | None, backend: Backend | None) -> Plan:
    """Return a plan by steps 1 and 2 for one h, where limits leave tightening slack."""
    scenario = problem.scenario
    if reference is not None:
        return Subproblem(problem, coupling_for(scenario), backend).solve_around(reference)
    planes = CuttingPlanes(problem, backend)
    planes.keep_to(problem.convex)
    free = planes.plan()
    if scenario.separation is not None:
        plan = Subproblem(problem, coupling_for(scenario), backend).solve_around(free)
        return plan.with_statistics(free.statistics + plan.statistics)
    obstacles = problem.obstacles_around(free.motion())
    if not obstacles:
        return free
    planes.keep_to(obstacles, reference=free)
    return planes.plan(free)


def _grid(step: float, like: Grid) -> Grid:
    """Return the grid of the same duration with another step.

    Raises:
        ValueError: `step` is not positive or does not divide the duration.
    """
    try:
        return Grid.lasting(like.duration, step=step, start=like.start)
    except ScenarioError as error:
        raise ValueError(f"steps: got {step}, expected {error.expected}") from None
