"""Plans along ways: feasibility restoration from references that keep clear.

A reference along a way is on the right side of everything, but no motion that can be flown;
restoration finds one near it. Of several ways the one is kept that costs least after a few
linearisations: what is left to gain then is less than what most ways differ by.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import islice

from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.motion.threads import one_for_arrays
from drake_rho.planning.constraints.separation import decoupled
from drake_rho.planning.constraints.tightening import with_room
from drake_rho.planning.errors import InfeasibleError, Names, OutOfTimeError, SolverError
from drake_rho.planning.options import DEFAULTS, Options
from drake_rho.planning.path_search.continuation import continuation_step
from drake_rho.planning.path_search.initial_guesses import paths_on_grids
from drake_rho.planning.planners.bends import BENDS, bent_alone
from drake_rho.planning.programs.solve import Solver
from drake_rho.planning.progress import Progress, tell, within
from drake_rho.planning.scp.sequential_convex import DeadEnds, Follow, iterate, restored
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.scenario.records import Scenario

_NAMED = 4
"""Obstacles in the way of a vehicle without a way that are named one by one."""

_GRIDS = 2
"""Grids on which ways are looked for, as long as no plan is found along those on the one before."""

_MOST_LINEARISATIONS = 30
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
    grids = paths_on_grids(with_room(scenario), options.max_ways, options.max_memory)
    attempts, best = _Attempts(scenario, solver), None
    for found in islice(grids, _GRIDS):
        attempts.spent += Statistics(searched=found.searched)
        if (best := _best_along(found.references, attempts, progress)) is not None:
            break
    if best is None and found.references and len(scenario.vehicles) == 1:
        best = _by_bends(attempts, progress)
    spent, failure = attempts.spent, attempts.failure
    if best is not None or failure is None:
        conflicts, obstacles = _everything(scenario) if best is None else ({}, {})
        return AlongWays(scenario, best, spent, conflicts, obstacles)
    return AlongWays(scenario, None, spent, failure.conflicts, failure.obstacles)


class _Attempts:
    """Restorations of one scenario from several references.

    Args:
        scenario: what is asked.
        solver: a Drake solver or `Daqp()`; Clarabel if not given.

    Attributes:
        scenario: as given.
        dead_ends: where those without a plan ended.
        spent: on all of them.
        failure: why the first without a plan has none; None if there is none such.
    """

    def __init__(self, scenario: Scenario, solver: Solver | None) -> None:
        self.scenario, self.dead_ends = scenario, DeadEnds(scenario)
        self.spent = Statistics()
        self.failure: InfeasibleError | None = None
        self._subproblem = Subproblem(scenario, decoupled, solver)

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
            reference: where to begin.
            progress: called after each linearisation.
            follow: as in `iterate`.
            improved: whether to go on until the plan can be told from others.
        """
        subproblem = self._subproblem = self._subproblem.afresh()
        try:
            plan = restored(reference, subproblem, progress, follow, dead_ends=self.dead_ends)
        except (InfeasibleError, SolverError) as error:
            self.spent = error.statistics + self.spent
            if isinstance(error, InfeasibleError):
                self.failure = self.failure or error
            return None
        if improved:
            plan = iterate(subproblem, plan, _ROUGHLY, progress=progress)
        self.spent = plan.statistics + self.spent
        return plan


def _best_along(
    references: Sequence[Plan], attempts: _Attempts, progress: Progress | None
) -> Plan | None:
    """Return the cheapest plan near one of some references; None if none is found.

    References that stay clear keep the sides of a way even where what they have to keep of it
    cannot be flown together with others; a fleet's restoration then follows its motions instead.
    One vehicle's cheapest motion is bent later on.
    """
    best: Plan | None = None
    alone, several = len(attempts.scenario.vehicles) == 1, len(references) > 1
    for number, reference in enumerate(references, start=1):
        along = within(progress, f"way {number} of {len(references)}")
        try:
            plan = attempts.plan_near(reference, along, continuation_step, improved=several)
            if plan is None and not alone:
                plan = attempts.plan_near(reference, along, improved=several)
        except OutOfTimeError:
            if best is None:
                raise
            return best
        if plan is not None and (best is None or plan.cost < best.cost):
            best = plan
    return best


def _by_bends(attempts: _Attempts, progress: Progress | None) -> Plan | None:
    """Return a plan of one vehicle from its cheapest motion, bent in several ways, if any."""
    begun, since = attempts.spent.linearisations, 0
    for number in range(BENDS):
        linearisations = attempts.spent.linearisations - begun
        if linearisations > _MOST_LINEARISATIONS or since == _KNOWN_ENDS:
            break
        known = len(attempts.dead_ends)
        bent = within(progress, f"bend {number + 1} of {BENDS}")
        plan = attempts.plan_near(bent_alone(attempts.scenario, number), bent)
        if plan is not None:
            return plan
        since = 0 if len(attempts.dead_ends) > known else since + 1
    return None


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
