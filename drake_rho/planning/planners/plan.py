"""The main planner, `plan`, iterated to convergence; `plan_scp` is another name for it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from concurrent.futures import Executor
from functools import partial

from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.motion.trajectories import Trajectories
from drake_rho.planning.call.options import DEFAULTS, Options
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.call.time_limit import with_time_limit
from drake_rho.planning.call.wall_time import with_wall_time
from drake_rho.planning.constraints.separation import COUPLINGS, Coupling, CouplingName
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.planners.first_plan import FirstPlan, plan_near
from drake_rho.planning.planners.other_goals import has_other_goals, on_cheaper_goals
from drake_rho.planning.planners.other_sides import has_other_sides, on_cheaper_sides
from drake_rho.planning.planners.related import fitted
from drake_rho.planning.planners.smoothed import with_own_margin
from drake_rho.planning.planners.waypoint_times import WaypointTimes, at_times_tried
from drake_rho.planning.problem import Problem, with_finer_margins
from drake_rho.planning.programs.backend import Backend, Solver, SolverName
from drake_rho.planning.scp.fleet_improvement import AroundReferences
from drake_rho.planning.scp.sequential_convex import sequential_convex
from drake_rho.planning.scp.subproblem import Subproblem, coupling_for
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.penalties import NO_TIMES, check_no_penalties
from drake_rho.scenario.records import Scenario
from drake_rho.system.threads import single_threaded_blas


@checked
@with_wall_time
@with_time_limit
@single_threaded_blas
def plan(
    scenario: Scenario,
    *,
    reference: Plan | Trajectories | None = None,
    coupling: Coupling | CouplingName | None = None,
    solver: Solver | SolverName | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    options: Options | None = None,
) -> Plan:
    """Return the best plan that this package can find.

    Obstacles and pairs are linearised around the latest plan, beginning with that of the convex
    method, until the cost stops falling. If the first linearisation is infeasible, paths around the
    obstacles are searched for the vehicles that fail, and fleets with a separation go through
    feasibility restoration.

    The half-space (15) is a subset of the set that (8) allows, so every iterate satisfies the true
    constraints. Each iterate is feasible for the next linearisation too, so the cost does not rise
    (in exact arithmetic). Neither a trust region nor a line search is needed.

    Args:
        scenario: the problem to solve.
        reference: first motion to linearise around, in place of the plan without obstacles. It may
            be a plan of a related scenario: with more vehicles, from rest to rest in less time
            (`fitted`), with more obstacles or tighter limits. A reference that already satisfies
            every constraint is kept as a fallback. Of trajectories of another planner it is the
            states at the knots (`Trajectories.as_plan`).
        coupling: treatment of pairs, by name or as this package's object of that name: `coupled`,
            with the least cost; `decoupled`, with one program per vehicle; or `grouped`, decoupled
            around references in which groups of vehicles are coupled, with almost the least cost.
            By default coupled up to `options.max_coupled` vehicles, grouped up to
            `options.max_grouped`, and decoupled beyond.
        solver: `"clarabel"`, `"daqp"` or `"osqp"`, or a Drake solver; Clarabel if not given.
        executor: any PEP 3148 executor, which solves programs in blocks of vehicles and searches
            for paths vehicle by vehicle. The result does not depend on the number of workers. DAQP
            can be sent to processes, a Drake solver cannot. The calling process if not given.
        progress: called with a short text on the current activity, as after each linearisation.
        options: tolerances and bounds; `Options()` if not given.

    Returns:
        A plan that meets every constraint of the scenario.

    Raises:
        InfeasibleError: a vehicle has no plan even without obstacles, or no path around was found.
        OutOfTimeError: `options.time_limit` was over before there was a plan.
        ScenarioError: a limit is soft, and a waypoint has no time.
        SolverError: the solvers fail numerically.
        TypeError: an argument has the wrong type.
        ValueError: the solver is not available or does not know an option, or the reference has
            other vehicles or another grid.

    Examples:
        >>> plan = rho.plan(rho.load_scenario("paper"))
        >>> plan
        <Plan of paper: 4 vehicles, 50 knots, cost 16741.4 m²/s⁴>
    """
    options = options or DEFAULTS
    if isinstance(reference, Trajectories):
        reference = reference.as_plan(scenario)
    if isinstance(coupling, str):
        coupling = COUPLINGS[coupling]
    coupling = coupling or coupling_for(scenario, options)
    backend = Backend.of(solver, executor, options.solver_options)
    search = FirstPlan(backend, progress, options)
    times = WaypointTimes(scenario, backend.here(), progress)
    if times.any_free:
        check_no_penalties(scenario.penalties, NO_TIMES)
        return _with_free_times(times, reference, coupling, search)
    return _with_given_times(scenario, reference, coupling, search)


def _with_free_times(
    times: WaypointTimes, reference: Plan | None, coupling: Coupling, search: FirstPlan
) -> Plan:
    """Return the best plan with free waypoint times optimised locally.

    Raises:
        InfeasibleError: no plan at any of the times tried; this is proved only if there is none
            without these waypoints either.
    """
    times.check()
    failures = list[Exception]()
    for guess in _all_times(times, reference, coupling, search):
        try:
            first = _with_given_times(times.scenario_at(guess), reference, coupling, search)
        except (InfeasibleError, SolverError, ScenarioError) as error:
            failures.append(error)
        else:
            return _with_better_times(times, first, coupling, search)
    raise at_times_tried(failures, times.scenario)


def _all_times(
    times: WaypointTimes, reference: Plan | None, coupling: Coupling, search: FirstPlan
) -> Iterator[FloatArray]:
    """Yield candidate times of the waypoints, the most promising first.

    Raises:
        InfeasibleError: there is no plan without these waypoints either.
    """
    guesses = times.guesses()
    yield next(guesses)
    without = _with_given_times(times.without_free(), reference, coupling, search)
    yield from times.towards(without)
    yield from guesses


def _with_better_times(
    times: WaypointTimes, first: Plan, coupling: Coupling, search: FirstPlan
) -> Plan:
    """Return a plan, or a cheaper one with waypoint times optimised near it."""
    if not first.scenario.avoided and first.scenario.separation is None:
        return first
    try:
        better = times.scenario_at(times.near(first))
        again = _with_given_times(better, first, coupling, search)
    except (InfeasibleError, SolverError, OutOfTimeError, ScenarioError):
        return first
    return min(first, again, key=lambda plan: plan.cost)


def _with_given_times(
    scenario: Scenario, reference: Plan | None, coupling: Coupling, search: FirstPlan
) -> Plan:
    """Return the best plan of a scenario with given times of all waypoints."""
    if reference is not None:
        reference = fitted(reference, scenario)

    def best(problem: Problem) -> Plan:
        first = search.of_any_duration(problem, reference)
        plan = _iterated(problem, first, coupling, search)
        if reference is None and has_other_sides(problem):
            plan = _on_cheaper_sides(problem, plan, search)
            if has_other_goals(problem):
                plan = _on_cheaper_goals(problem, plan, coupling, search)
        if reference is None and _enters_obstacles(problem, plan):
            plan = _outside_if_cheaper(problem, plan, coupling, search)
        return plan

    if scenario.smoothing_margin > 0.0 and scenario.fleet.flown is None:
        again = partial(_from_similar, coupling, search)
        return with_own_margin(best, again, Problem.of(scenario))
    return with_finer_margins(best, Problem.of(scenario))


def _enters_obstacles(problem: Problem, plan: Plan) -> bool:
    """Return whether a plan pays for entering soft obstacles, before a flight."""
    scenario = problem.scenario
    soft = any(obstacle.penalty is not None for _, obstacle in scenario.avoided)
    return soft and not scenario.under_way and float(problem.prices(plan).sum()) > 0.0


def _outside_if_cheaper(
    problem: Problem, plan: Plan, coupling: Coupling, search: FirstPlan
) -> Plan:
    """Return a plan, or a cheaper one that begins with a plan outside soft obstacles.

    Linearised deep inside an obstacle, no motion leaves it at a lower price.
    """
    tell(search.progress, "trying to stay outside soft obstacles")
    hard = dataclasses.replace(problem, scenario=problem.scenario.with_hard_obstacles())
    try:
        first = search.of(hard)
        first = Plan.from_accelerations(problem.scenario, first.accelerations, first.statistics)
        other = _iterated(problem, first, coupling, search)
    except (InfeasibleError, SolverError) as error:
        return plan.with_statistics(plan.statistics.with_work(error.statistics))
    except OutOfTimeError:
        return plan.with_statistics(plan.statistics.with_work(Statistics(cut=True)))
    best, worse = sorted((plan, other), key=problem.total_cost)
    return best.with_statistics(best.statistics.with_work(worse.statistics))


def _on_cheaper_goals(problem: Problem, plan: Plan, coupling: Coupling, search: FirstPlan) -> Plan:
    """Return the plan with vehicles elsewhere in goals that are sets where this costs less."""
    return on_cheaper_goals(
        problem,
        plan,
        lambda exact: _with_given_times(exact, None, coupling, search),
        lambda first: _iterated(problem, first, coupling, search),
    )


def _on_cheaper_sides(problem: Problem, plan: Plan, search: FirstPlan) -> Plan:
    """Return the plan with vehicles on other sides of obstacles where this costs less."""
    options = search.options
    return on_cheaper_sides(
        problem,
        plan,
        options.tolerance_of(problem.scenario, together=False),
        most=options.max_iterations,
        backend=search.backend,
        progress=search.progress,
    )


def _from_similar(coupling: Coupling, search: FirstPlan, problem: Problem, similar: Plan) -> Plan:
    """Return the plan of a problem, starting from a similar one's plan with small violations."""
    try:
        first = plan_near(problem, similar, backend=search.backend, progress=search.progress)
    except (InfeasibleError, SolverError):
        first = search.of_any_duration(problem, similar)
    return _iterated(problem, first, coupling, search)


def _iterated(problem: Problem, first: Plan, coupling: Coupling, search: FirstPlan) -> Plan:
    """Return the converged plan of sequential convex programming from a feasible first plan."""
    scenario, options = problem.scenario, search.options
    if not scenario.avoided and scenario.separation is None:
        return first
    subproblem = Subproblem(problem, coupling, search.backend)
    # references in groups would have to keep linked vehicles in one group
    # and know nothing of soft limits
    in_turn = (
        scenario.separation is None
        or coupling.together
        or problem.has_links
        or len(scenario.penalties) > 0
    )
    return sequential_convex(
        subproblem,
        first,
        options.tolerance_of(scenario, together=coupling.together, in_groups=coupling.in_groups),
        improve=None if in_turn else AroundReferences(subproblem, options.max_group),
        most=options.max_iterations,
        progress=search.progress,
    )


@checked
@with_wall_time
@single_threaded_blas
def plan_scp(
    scenario: Scenario,
    *,
    reference: Plan | Trajectories | None = None,
    coupling: Coupling | CouplingName | None = None,
    solver: Solver | SolverName | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    options: Options | None = None,
) -> Plan:
    """Plan by sequential convex programming to convergence: the same as `plan`.

    Args and errors are those of `plan`.
    """
    return plan(
        scenario,
        reference=reference,
        coupling=coupling,
        solver=solver,
        executor=executor,
        progress=progress,
        options=options,
    )
