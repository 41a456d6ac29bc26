"""`plan`, the planner to use, iterated to convergence; `plan_scp`, its name by the method."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from functools import partial
from itertools import repeat

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.motion.threads import one_for_arrays
from drake_rho.planning.constraints.separation import COUPLINGS, Coupling, CouplingName, decoupled
from drake_rho.planning.constraints.tightening import check_room, with_finer_margins
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.options import DEFAULTS, Options
from drake_rho.planning.planners.bends import SPREADS, spread
from drake_rho.planning.planners.convex import linearised_once
from drake_rho.planning.planners.from_paths import AlongWays, no_plan, plan_along_ways
from drake_rho.planning.planners.related import can_be_slower, fitted, rescaled
from drake_rho.planning.programs.parallel import OnWorkers
from drake_rho.planning.programs.solve import Solver, SolverName, solver_of
from drake_rho.planning.progress import Progress, tell, within
from drake_rho.planning.scp.fleet_subproblem import Improvement
from drake_rho.planning.scp.restoration import Restoration
from drake_rho.planning.scp.sequential_convex import GROWTH, MAX_RESTORATIONS, iterate, restored
from drake_rho.planning.scp.subproblem import Subproblem, coupling_for, plan_around
from drake_rho.planning.time_limit import with_time_limit, within_time
from drake_rho.planning.wall_time import with_wall_time
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.records import Scenario

_SLOWLY = 1.7, 36
"""How fast penalties grow in the last attempt at a restoration, and how many there are."""

_SHORTER = 0.75, 0.5
"""Parts of a duration that are tried where it has no plan, but motions can be flown slower."""

_FEW = 0.25
"""Part of a fleet that may be in trouble with obstacles while the others fly as if alone."""


@checked
@with_wall_time
@with_time_limit
@one_for_arrays()
def plan(
    scenario: Scenario,
    *,
    reference: Plan | None = None,
    coupling: Coupling | CouplingName | None = None,
    solver: Solver | SolverName | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    options: Options | None = None,
) -> Plan:
    """The best plan that this package can find.

    The convex method's plan is linearised anew until its cost stops falling. Where the first
    linearisation has no solution, the vehicles it fails are given ways round the obstacles first,
    and fleets that are to keep apart are restored to it.

    The half-space of (15) lies inside what (8) allows, so every iterate meets the true
    constraints, and since it is itself allowed by the next linearisation, the cost does not rise
    (in exact arithmetic). Neither a trust region nor a line search is needed.

    Args:
        scenario: what is asked.
        reference: a motion to linearise around at first, in place of the plan without obstacles.
            It may be a plan of a related scenario: of more vehicles, from rest to rest in less
            time (`fitted`), with more obstacles or tighter limits. What keeps every constraint of
            this one is a plan in any case.
        coupling: how pairs are kept apart, a word or what it is called in this package: `coupled`,
            at the least cost; `decoupled`, every vehicle with a program of its own; or `grouped`,
            the same around references in which groups of vehicles are coupled, at almost the least
            cost. If not given, coupled as long as the
            fleet is small (`options.max_coupled`), grouped up to `options.max_grouped` vehicles,
            and decoupled beyond.
        solver: `"clarabel"`, `"daqp"` or `"osqp"`, or a Drake solver; Clarabel if not given.
        executor: where programs are solved, in blocks of vehicles, and ways round the obstacles
            are looked for, vehicle by vehicle: any of PEP 3148. The plan is the same, whoever
            works. A Drake solver cannot be sent to processes, DAQP can. If not given, here.
        progress: called with a few words on what is being done, as after each linearisation.
        options: tolerances and bounds; `Options()` if not given.

    Returns:
        A plan that meets every constraint of the scenario.

    Raises:
        InfeasibleError: a vehicle has no plan without the obstacles, or no way round was found.
        OutOfTimeError: `options.time_limit` was over before there was a plan.
        SolverError: the solvers fail numerically.
        TypeError: an argument is of another type.
        ValueError: the solver is not available, or the reference is for other vehicles or another
            grid.

    Examples:
        >>> plan = rho.plan(rho.load_scenario("paper"))
        >>> plan
        <Plan of paper: 4 vehicles, 50 knots, cost 16741.4 m²/s⁴>
    """
    options = options or DEFAULTS
    if isinstance(coupling, str):
        coupling = COUPLINGS[coupling]
    own, kept_apart = solver_of(solver), coupling or coupling_for(scenario, options)
    backend = OnWorkers(own, executor) if executor is not None else own

    if reference is not None:
        reference = fitted(reference, scenario)

    def best(asked: Scenario) -> Plan:
        try:
            first = _first(asked, reference, backend, progress, options)
        except InfeasibleError as error:
            first = _first_slowly(asked, error, backend, progress, options)
        return _iterated(first, kept_apart, backend, progress, options)

    return with_finer_margins(best, scenario)


def _iterated(
    first: Plan,
    coupling: Coupling,
    solver: Solver | OnWorkers | None,
    progress: Progress | None,
    options: Options,
) -> Plan:
    """Return the plan that linearising anew ends with, from one that keeps every constraint."""
    scenario = first.scenario
    if not scenario.known and scenario.separation is None:
        return first
    tolerance = options.tolerance_of(
        scenario, together=coupling.together, in_groups=coupling.in_groups
    )
    if scenario.separation is None or coupling.together:
        subproblem = Subproblem(scenario, coupling, solver)
    else:
        subproblem = Improvement(scenario, coupling, solver, options.max_group)
    return iterate(subproblem, first, tolerance, most=options.max_iterations, progress=progress)


@checked
@with_wall_time
def plan_scp(
    scenario: Scenario,
    *,
    reference: Plan | None = None,
    coupling: Coupling | CouplingName | None = None,
    solver: Solver | SolverName | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    options: Options | None = None,
) -> Plan:
    """Sequential convex programming to convergence: `plan`, by the name of its method.

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


def first_plan(
    scenario: Scenario,
    *,
    reference: Plan | None = None,
    solver: Solver | OnWorkers | None = None,
    progress: Progress | None = None,
    options: Options = DEFAULTS,
) -> Plan:
    """Return the plan that `plan` begins with: it keeps every constraint, and is not iterated.

    Args and errors are those of `plan`.
    """
    return with_finer_margins(
        lambda asked: _first(asked, reference, solver, progress, options), scenario
    )


def plan_near(
    scenario: Scenario,
    reference: Plan,
    *,
    solver: Solver | OnWorkers | None = None,
    progress: Progress | None = None,
) -> Plan:
    """Return a first plan that is found from a reference alone: no ways are looked for.

    Args:
        scenario: what is asked.
        reference: positions of the same vehicles at as many knots, that need not be flown.
        solver: a Drake solver or `Daqp()`; Clarabel if not given.
        progress: called after each linearisation.

    Raises:
        InfeasibleError: there is no plan, or none was found from there.
        SolverError: the solvers fail numerically.
    """

    def find(asked: Scenario) -> Plan:
        check_room(asked)
        if not asked.known and asked.separation is None:
            return linearised_once(asked, None, solver)
        apart = asked.separation is not None
        subproblem = Restoration(asked, solver) if apart else Subproblem(asked, decoupled, solver)
        return restored(reference, subproblem, progress)

    return with_finer_margins(find, scenario)


def _first(
    scenario: Scenario,
    reference: Plan | None,
    solver: Solver | OnWorkers | None,
    progress: Progress | None,
    options: Options,
) -> Plan:
    """Return `first_plan` with the margins that a scenario has."""
    check_room(scenario)
    if scenario.separation is not None:
        return _first_apart(scenario, reference, solver, progress, options)
    try:
        return linearised_once(scenario, reference, solver)
    except SolverError:
        if (held := _held(scenario, reference)) is not None:
            return held
        if not scenario.known:
            raise
        everyone = [vehicle.name for vehicle in scenario.vehicles]
        return _ways_round(scenario, everyone, None, solver, options, progress)
    except InfeasibleError as error:
        if (held := _held(scenario, reference)) is not None:
            return held
        if not error.about_linearisation:
            raise
        stuck = list(error.conflicts)
        return _ways_round(scenario, stuck, error, solver, options, progress)


def _first_apart(
    scenario: Scenario,
    reference: Plan | None,
    solver: Solver | OnWorkers | None,
    progress: Progress | None,
    options: Options,
) -> Plan:
    """`first_plan` of vehicles that keep apart.

    Vehicles that do not know of each other are a good beginning as long as few of them are in
    trouble with obstacles: each of those then has a way of its own. Else, and where they cannot be
    brought apart, all get ways that know of each other.
    """
    if (apart := _around_if_apart(scenario, reference, solver)) is not None:
        return apart
    alone = scenario.without_separation()
    try:
        try:
            tell(progress, "planning each vehicle without the others")
            careless = linearised_once(alone, reference, solver)
        except SolverError:
            if not scenario.known:
                raise
            return _along_ways(scenario, None, solver, options, progress)
        except InfeasibleError as error:
            if not error.about_linearisation or len(error.conflicts) > _FEW * len(alone.vehicles):
                raise
            few, single = list(error.conflicts), dataclasses.replace(options, max_ways=1)
            careless = _ways_round(alone, few, error, solver, single, progress)
        start = Plan.from_accelerations(scenario, careless.accelerations, careless.statistics)
        return _brought_apart(start, solver, progress)
    except InfeasibleError as error:
        error.scenario = scenario  # what was asked, apart and all
        if not error.about_linearisation:
            raise
        return _along_ways(scenario, error, solver, options, progress)


def _brought_apart(
    start: Plan, solver: Solver | OnWorkers | None, progress: Progress | None
) -> Plan:
    """A plan whose vehicles keep apart, from one in which they do not know of each other.

    Where restoration from there comes to no end, it begins with the vehicles spread, and at last
    it goes in smaller steps.

    Raises:
        InfeasibleError: no plan was found.
    """
    scenario, spent = start.scenario, Statistics()
    failure: InfeasibleError | SolverError | None = None
    for reference, growth, most in _attempts(start):
        subproblem = Restoration(scenario, solver)
        try:
            plan = restored(reference, subproblem, progress, growth=growth, most=most)
        except (InfeasibleError, SolverError) as error:
            failure = failure if isinstance(failure, InfeasibleError) else error
            spent += error.statistics
        else:
            return plan.with_statistics(spent + plan.statistics)
    assert failure is not None  # noqa: S101  # there was an attempt
    failure.statistics = spent
    raise failure


def _attempts(start: Plan) -> Iterator[tuple[Plan, float, int]]:
    """What to restore a fleet from, how fast penalties grow, and how many there are."""
    yield start, GROWTH, MAX_RESTORATIONS
    for number in range(SPREADS):
        yield spread(start, number), GROWTH, MAX_RESTORATIONS
    yield start.with_statistics(Statistics()), *_SLOWLY


def _along_ways(
    scenario: Scenario,
    failure: InfeasibleError | None,
    solver: Solver | OnWorkers | None,
    options: Options,
    progress: Progress | None,
) -> Plan:
    """A first plan along ways of all vehicles, where there was none without them."""
    along = plan_along_ways(scenario, solver, options, progress)
    spent = along.spent if failure is None else failure.statistics + along.spent
    if along.plan is None:
        raise no_plan([along], scenario, spent, failure) from None
    return along.plan.with_statistics(spent)


def _around_if_apart(
    scenario: Scenario, reference: Plan | None, solver: Solver | OnWorkers | None
) -> Plan | None:
    """A fleet's plan around a reference whose vehicles keep apart; None if there is none."""
    subproblem = Subproblem(scenario, decoupled, solver)
    if reference is not None and subproblem.keeps_apart(reference):
        with suppress(InfeasibleError, SolverError):
            return subproblem.around(reference)
        return _held(scenario, reference)
    return None


def _held(scenario: Scenario, reference: Plan | None) -> Plan | None:
    """A reference as a plan, if it keeps every constraint; None else."""
    if reference is None or not Subproblem(scenario, decoupled).holds(reference):
        return None
    return Plan.from_accelerations(scenario, reference.accelerations)


def _first_slowly(
    scenario: Scenario,
    failure: InfeasibleError,
    solver: Solver | OnWorkers | None,
    progress: Progress | None,
    options: Options,
) -> Plan:
    """A first plan that is one for a shorter duration, flown slower.

    Raises:
        InfeasibleError: the failure, where motions cannot be flown slower, it is proved, or no
            shorter duration has a plan.
    """
    searched = failure.statistics.searched
    no_way = searched is not None and searched.ways == 0
    if no_way or not failure.about_linearisation or not can_be_slower(scenario):
        raise failure
    for factor in _SHORTER:
        shorter = rescaled(scenario, factor)
        words = f"trying a duration of {shorter.grid.duration:.4g} s"
        tell(progress, words)
        try:
            plan = _first(shorter, None, solver, within(progress, words), options)
        except (InfeasibleError, SolverError) as error:
            failure.statistics += error.statistics
            if isinstance(error, InfeasibleError) and not error.about_linearisation:
                break  # too short even without what is in the way
            continue
        first = _first(scenario, fitted(plan, scenario), solver, progress, options)
        return first.with_statistics(failure.statistics + plan.statistics + first.statistics)
    raise failure


def _plan_along_ways(
    pieces: int, scenario: Scenario, solver: Solver | None, options: Options
) -> AlongWays:
    """Look for a plan along ways on a worker, to which a scenario comes without its pieces."""
    with within_time(options.time_limit):
        return plan_along_ways(scenario.derived(margin_pieces=pieces), solver, options)


def _ways_round(
    scenario: Scenario,
    stuck: Sequence[str],
    failure: InfeasibleError | None,
    solver: Solver | OnWorkers | None,
    options: Options,
    progress: Progress | None,
) -> Plan:
    """A first plan where the first linearisation has none: along ways for the vehicles it failed.

    Raises:
        InfeasibleError: for one of them none was found.
    """
    free = plan_around(scenario.without_obstacles(), None, solver)
    spent = free.statistics if failure is None else failure.statistics + free.statistics
    indices = [scenario.index_of(name) for name in stuck]
    alone = [scenario.of_vehicles([index]) for index in indices]
    if isinstance(solver, OnWorkers):  # which cannot tell from where they are
        along_ways = partial(_plan_along_ways, scenario.margin_pieces)
        each_of, own = solver.executor.map, repeat(solver.solver)
        found = list(each_of(along_ways, alone, own, repeat(options)))
    else:
        parts = [within(progress, name) for name in stuck]
        found = list(map(plan_along_ways, alone, repeat(solver), repeat(options), parts))
    accelerations = np.array(free.accelerations)
    for index, along in zip(indices, found, strict=True):
        spent += along.spent
        if along.plan is not None:
            accelerations[index] = along.plan.accelerations[0]
    if lost := [along for along in found if along.plan is None]:
        raise no_plan(lost, scenario, spent, failure)
    around = Plan.from_accelerations(scenario, accelerations)
    try:
        plan = plan_around(scenario, around, solver)
    except (InfeasibleError, SolverError, OutOfTimeError):  # by rounding, where there is no room
        if not Subproblem(scenario, decoupled, solver).holds(around):
            raise
        plan = around
    return plan.with_statistics(spent + plan.statistics)
