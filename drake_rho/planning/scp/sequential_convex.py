"""Sequential convex programming: the one loop that linearises anew."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from itertools import islice, repeat

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.constraints.separation import coupled
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.options import DEFAULTS
from drake_rho.planning.programs.solve import Solver, SolverName, solver_of
from drake_rho.planning.progress import Progress
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.planning.time_limit import check_time
from drake_rho.planning.wall_time import with_wall_time
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Scenario

Follow = Callable[[Plan, Plan], Plan]
"""What is linearised around next, of a reference and the plan that was found around it."""

MAX_RESTORATIONS = 100
"""Bound on the penalties of one restoration."""

PATIENCE = 20
"""Penalties after which a restoration is given up if there are no fewer vehicles in trouble."""

_STALLED, _FALL = 4, 0.98
"""Penalties after which it is given up, where nobody has to keep apart, if the worst breach has not
fallen to this part: what is left then is the least that linearising around it leads to."""

_SAME, _ARRIVED = 0.05, 3
"""Part of the least that is kept out of by which motions may differ that come to the same end; and
the penalties after which that can be told."""

GROWTH = 3.0
"""How fast the penalty grows."""

_BACK = 3
"""How many penalties are tried in one step, each after the first one step less."""

_CLOSER = 10.0
"""Times the first penalty for a reference that is a way among obstacles and cannot be flown: what
is drawn aside from it too far comes out on other sides of them."""


def iterate(
    subproblem: Subproblem,
    plan: Plan,
    tolerance: float,
    penalties: Iterable[float] | None = None,
    *,
    most: int = DEFAULTS.max_iterations,
    progress: Progress | None = None,
    follow: Follow | None = None,
    dead_ends: DeadEnds | None = None,
) -> Plan:
    """Linearise obstacles and pairs around one plan after the other.

    Without penalties the plan has to keep its constraints. Every iterate then does, and the
    iteration ends when the cost falls by less than the tolerance: of each vehicle by itself, of
    fleets that keep apart as a whole. With penalties, pairs of the plan may be too close, and one
    penalty after the other is tried until they are not (feasibility restoration), or until as many
    vehicles as before are left in trouble for `PATIENCE` of them.

    Args:
        subproblem: what is solved in each iteration.
        plan: where to begin.
        tolerance: relative fall of the cost at which a plan has converged.
        penalties: cost of each metre by which a pair is too close, rising.
        most: bound on the linearisations.
        progress: called after each.
        follow: what a restoration linearises around next, as long as a plan is far from keeping
            its constraints; the plan itself if not given.
        dead_ends: where other restorations ended: one that comes near them is given up. If this
            one ends without a plan, it is added.

    Returns:
        The last plan; `statistics.converged` says whether its cost fell by less than the tolerance.

    Raises:
        InfeasibleError: no penalty keeps the pairs apart.
        SolverError: the solvers fail numerically where they are apart.
    """
    restoring, falling = penalties is not None, np.arange(len(plan.accelerations))
    patience = _Patience(subproblem, dead_ends)
    cut, fall = False, None
    converged, spent, around = False, plan.statistics, plan
    for number, penalty in enumerate(islice(penalties or repeat(np.inf), most)):
        if restoring and subproblem.holds(plan):
            break
        try:
            check_time()
            if restoring:
                after = _nearer(subproblem, around, penalty, subproblem.begun + number)
            else:
                after = subproblem.improved(plan, falling, tolerance)
        except (InfeasibleError, SolverError):  # by rounding, where there is no room at all
            break
        except OutOfTimeError:
            if restoring:
                raise
            cut = True
            break
        spent += after.statistics
        if progress is not None:
            worst = subproblem.worst_breach(after) if restoring else 0.0
            left = len(subproblem.in_trouble(after)) if worst > 0.0 else 0
            progress(_words(spent.linearisations, after.cost, worst, left))
        if restoring:
            far = follow is not None and not subproblem.almost_holds(after)
            plan, around = after, follow(around, after) if follow and far else after
            if patience.ends(after):
                break
            continue
        fall = max(0.0, 1.0 - after.cost / plan.cost) if plan.cost > 0.0 else 0.0
        plan, falling = _better(subproblem, plan, after, falling, tolerance)
        if converged := len(falling) == 0 or subproblem.settled:
            break
    if restoring and (failure := subproblem.failure(plan, spent)) is not None:
        if dead_ends is not None:
            dead_ends.add(plan)
        raise failure
    done = dataclasses.replace(
        spent, converged=converged or restoring, cut=cut, last_fall=fall, tolerance=tolerance
    )
    return plan.with_statistics(done)


class DeadEnds:
    """Where restorations of one scenario ended without a plan: each place once.

    Args:
        scenario: what is asked.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._near = _SAME * _room(scenario)
        self._positions = list[FloatArray]()

    def __len__(self) -> int:
        """How many there are."""
        return len(self._positions)

    def is_near(self, plan: Plan) -> bool:
        """Return whether a plan is close to one of them all the time."""
        return any(np.abs(plan.positions - end).max() < self._near for end in self._positions)

    def add(self, plan: Plan) -> None:
        """Note where a restoration ended, unless one has ended there."""
        if not self.is_near(plan):
            self._positions.append(plan.positions)


class _Patience:
    """When a restoration is given up.

    Args:
        subproblem: that is restored.
        dead_ends: of others before it, if there are any.
    """

    def __init__(self, subproblem: Subproblem, dead_ends: DeadEnds | None) -> None:
        self._subproblem, self._dead_ends = subproblem, dead_ends
        self._left, self._worst = len(subproblem.labels) + 1, np.inf
        self._steps = self._since_left = self._since_worst = 0
        self._apart = subproblem.scenario.separation is not None

    def ends(self, plan: Plan) -> bool:
        """Return whether the next penalty is not worth its time after this plan."""
        left = len(self._subproblem.in_trouble(plan))
        worst = self._subproblem.worst_breach(plan)
        self._steps += 1
        self._since_left += 1
        self._since_worst += 1
        if worst < _FALL * self._worst or left < self._left:
            self._worst, self._since_worst = worst, 0
        if left < self._left:
            self._left, self._since_left = left, 0
        stalled = self._since_worst >= _STALLED and not self._apart
        if self._since_left >= PATIENCE or stalled:
            return True
        known = self._dead_ends
        return known is not None and self._steps >= _ARRIVED and known.is_near(plan)


def _nearer(subproblem: Subproblem, around: Plan, penalty: float, number: int) -> Plan:
    """Return a restoration's next step, at a penalty that is less by as much as solvers ask for.

    Raises:
        InfeasibleError: the constraints without any obstacle or pair cannot be met.
        SolverError: the solvers fail numerically at lower penalties too.
    """
    spent = Statistics()
    for back in range(_BACK):
        try:
            after = subproblem.restored(around, penalty / GROWTH**back, max(number - back, 0))
        except SolverError as error:
            spent += error.statistics
            failure = SolverError(str(error), spent)
        else:
            return after.with_statistics(spent + after.statistics)
    raise failure


def _words(linearisations: int, cost: float, worst: float, left: int) -> str:
    times = "once" if linearisations == 1 else f"{linearisations} times"
    breach = f", worst breach {worst:.3g} m, {left} vehicles in trouble" if worst > 0.0 else ""
    return f"linearised {times}, cost {cost:.6g} m²/s⁴{breach}"


def _better(
    subproblem: Subproblem, plan: Plan, after: Plan, falling: IntArray, tolerance: float
) -> tuple[Plan, IntArray]:
    """For each vehicle, or all that stop together, the better plan; and who goes on."""
    labels = subproblem.labels
    differences = plan.accelerations**2 - after.accelerations**2
    fallen = np.bincount(labels, np.sum(differences, axis=(1, 2)))[labels]
    falling = falling[fallen[falling] > tolerance * plan.cost]
    if np.all(fallen >= 0.0):
        return after, falling
    if not np.any(fallen > 0.0):
        return plan, falling
    accelerations = np.where((fallen > 0.0)[:, None, None], after.accelerations, plan.accelerations)
    better = Plan.from_accelerations(plan.scenario, accelerations)
    return better if after.reference is None else better.found_around(after.reference), falling


def restored(
    plan: Plan,
    subproblem: Subproblem,
    progress: Progress | None = None,
    follow: Follow | None = None,
    *,
    most: int = MAX_RESTORATIONS,
    growth: float = GROWTH,
    dead_ends: DeadEnds | None = None,
) -> Plan:
    """A plan that keeps out of obstacles and of other vehicles, from one that need not.

    The penalty grows from one linearisation to the next. Each vehicle yields half, so all are
    planned side by side.

    Args:
        plan: of a scenario; its positions may be ones that cannot be flown.
        subproblem: of that scenario, decoupled.
        progress: called after each linearisation.
        follow: as in `iterate`.
        most: bound on the penalties.
        growth: of the penalty, from one linearisation to the next.
        dead_ends: as in `iterate`.

    Raises:
        InfeasibleError: none was found.
    """
    first = _first_penalty(plan, subproblem.least_cost)
    if not subproblem.is_flown(plan):
        first *= _CLOSER
    numbers = range(subproblem.begun, subproblem.begun + most)
    penalties = (first * min(growth**number, subproblem.steepest) for number in numbers)
    return iterate(
        subproblem, plan, 1.0, penalties, progress=progress, follow=follow, dead_ends=dead_ends
    )


@checked
@with_wall_time
def scp_step(plan: Plan, *, solver: Solver | SolverName | None = None) -> Plan:
    """One iteration: the plan of least cost with obstacles linearised around `plan`.

    Pairs, if there is a separation, are linearised too, and coupled.

    Raises:
        InfeasibleError: there is none.
        SolverError: the solvers fail numerically.
    """
    return Subproblem(plan.scenario, coupled, solver_of(solver)).around(plan)


def _first_penalty(plan: Plan, effort: float) -> float:
    """What a metre is worth at first: the cost of moving aside, and that of the plan, a metre.

    Args:
        plan: where to begin.
        effort: the least cost of all motions [m²/s⁴].
    """
    scenario = plan.scenario
    room, T = _room(scenario), scenario.grid.duration
    aside = scenario.grid.knots * (4.0 * room / T**2) ** 2
    return (max(plan.cost, effort) / len(scenario.vehicles) + aside) / room


def _room(scenario: Scenario) -> float:
    """Return the least extent of anything that is kept out of [m]."""
    rooms = [float(obstacle.shape.extent.min()) for _, obstacle in scenario.known]
    if scenario.separation is not None:
        rooms.append(scenario.separation.distance)
    return min(rooms, default=float(scenario.fleet.lengths.max()))
