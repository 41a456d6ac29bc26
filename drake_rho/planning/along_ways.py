"""Plans along ways: feasibility restoration from references that keep clear.

A reference along a way is on the right side of everything, but no motion that can be flown;
restoration finds one near it. Of several ways the one is kept that costs least after a few
linearisations: what is left to gain then is less than what most ways differ by.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.motion.threads import one_for_arrays
from drake_rho.planning.bends import BENDS, bent_alone
from drake_rho.planning.errors import InfeasibleError, Names, SolverError
from drake_rho.planning.keep_apart import decoupled
from drake_rho.planning.options import DEFAULTS, Options
from drake_rho.planning.progress import Progress, tell, within
from drake_rho.planning.room import with_room
from drake_rho.planning.scp import DeadEnds, iterate, restored
from drake_rho.planning.solve import Solver
from drake_rho.planning.subproblem import Subproblem
from drake_rho.planning.towards import towards
from drake_rho.planning.ways import find_ways
from drake_rho.scenario.records import Scenario

_NAMED = 4
"""Obstacles in the way of a vehicle without a way that are named one by one."""

_MOST_LINEARISATIONS = 60
"""Linearisations after which no other bend is tried: what is found at all is found with fewer."""

_KNOWN_ENDS = 4
"""Bends in a row that come to dead ends which are known, after which no other is tried."""

_ROUGHLY = 1e-2
"""Relative fall of the cost at which a way's plan can be told from those of others."""


@dataclasses.dataclass(frozen=True, eq=False)
class AlongWays:
    """The best plan along ways."""

    scenario: Scenario
    """what was asked"""
    plan: Plan | None
    """keeps every constraint; None if none was found"""
    spent: Statistics
    """what it took, the search for ways and all that were tried"""
    conflicts: dict[str, Names]
    """what is in the way of each vehicle where there is no plan, as in `InfeasibleError`"""
    obstacles: dict[str, frozenset[int]]
    """and the numbers of these obstacles, 0 for other vehicles"""


@one_for_arrays()
def plan_along_ways(
    scenario: Scenario,
    solver: Solver | None = None,
    options: Options = DEFAULTS,
    progress: Progress | None = None,
) -> AlongWays:
    """Look for ways, and for a plan near one of them.

    Args:
        scenario: what is asked.
        solver: a Drake solver or `Daqp()`; Clarabel if not given.
        options: `max_ways` bounds the ways that are tried.
        progress: called with a few words on what is being done.
    """
    tell(progress, "looking for ways")
    found = find_ways(with_room(scenario), options.max_ways, options.max_memory)
    spent = Statistics(searched=found.searched)
    best: Plan | None = None
    failure: InfeasibleError | None = None
    dead_ends = DeadEnds(scenario)
    subproblem = Subproblem(scenario, decoupled, solver)
    for number, reference in enumerate(found.references, start=1):
        subproblem = subproblem.afresh()
        along = within(progress, f"way {number} of {len(found.references)}")
        try:
            plan = restored(reference, subproblem, along, towards, dead_ends=dead_ends)
        except SolverError as error:
            spent = error.statistics + spent
            continue
        except InfeasibleError as error:
            spent, failure = error.statistics + spent, failure or error
            continue
        if len(found.references) > 1:
            plan = iterate(subproblem, plan, _ROUGHLY, progress=along)
        spent = plan.statistics + spent
        if best is None or plan.cost < best.cost:
            best = plan
    if best is None and found.references and len(scenario.vehicles) == 1:
        best, more = _by_bends(subproblem, progress, dead_ends)
        spent = more + spent
    if best is not None or failure is None:
        conflicts, obstacles = _everything(scenario) if best is None else ({}, {})
        return AlongWays(scenario, best, spent, conflicts, obstacles)
    return AlongWays(scenario, None, spent, failure.conflicts, failure.obstacles)


def _by_bends(
    subproblem: Subproblem, progress: Progress | None, dead_ends: DeadEnds
) -> tuple[Plan | None, Statistics]:
    """A plan of one vehicle from its cheapest motion, bent in several ways; and what it took."""
    spent, known, since = Statistics(), 0, 0
    for number in range(BENDS):
        known, since = len(dead_ends), 0 if len(dead_ends) > known else since + 1
        if spent.linearisations > _MOST_LINEARISATIONS or since > _KNOWN_ENDS:
            break
        subproblem = subproblem.afresh()
        reference = bent_alone(subproblem.scenario, number)
        try:
            bent = within(progress, f"bend {number + 1} of {BENDS}")
            plan = restored(reference, subproblem, bent, dead_ends=dead_ends)
        except (InfeasibleError, SolverError) as error:
            spent += error.statistics
        else:
            return plan, spent + plan.statistics
    return None, spent


def _everything(scenario: Scenario) -> tuple[dict[str, Names], dict[str, frozenset[int]]]:
    """All known obstacles, as what is in the way of each vehicle."""
    numbers = frozenset(number for number, _ in scenario.known)
    told = tuple(map(scenario.obstacle_name, sorted(numbers)))
    if len(told) > _NAMED:
        told = (f"{told[0]} to {told[-1]}, some of them",)
    names = [vehicle.name for vehicle in scenario.vehicles]
    return dict.fromkeys(names, told), dict.fromkeys(names, numbers)


def no_plan(
    lost: Sequence[AlongWays],
    scenario: Scenario,
    spent: Statistics,
    failure: InfeasibleError | None,
) -> InfeasibleError:
    """Why there is no plan, where one was looked for in vain along ways.

    Args:
        lost: without a plan.
        scenario: what was asked, these vehicles and others.
        spent: on all of it.
        failure: why ways were looked for; what it says of a vehicle is a proof of the
            linearisation, and goes before what is in the way of its best try.
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
