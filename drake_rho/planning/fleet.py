"""Plans of vehicles that keep apart: the rows of pairs, and a first plan that is separated."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from pydrake.solvers import SolverInterface

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.pairs import Meetings, at_knots, closest
from drake_rho.motion.plan import Plan, Statistics
from drake_rho.planning.constraints import WORST, Listed
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.halfspaces import HalfSpaces
from drake_rho.planning.loop import Programs, constraints_around
from drake_rho.planning.search import MAX_ROUNDS
from drake_rho.planning.separation import NAME, Coupling, by_halves, directions, jointly
from drake_rho.scenario.fields import BoolArray, IntArray, unchecked
from drake_rho.scenario.parts import Separation
from drake_rho.scenario.records import Scenario

MOST_TOGETHER = 15
"""Vehicles up to which a fleet is planned jointly."""

NEAR = 1.6
"""Pairs within so many times the separation, in the reference, get rows from the start."""

ALMOST = 0.95
"""Part of the separation from which on the rows of a first plan are tried as hard ones."""

GRAZING = 1.1
"""Times the separation within which closest approaches between knots, in the reference, may get
rows from the start; where these may give way, only those that are too close."""

_AT_ONCE = 1e-6
"""Part of a step after the start, or before the end, in which nothing can be changed."""

_TOUCHING = 100.0
"""Tolerances within which a row holds a solution back."""

ROOM = 1.02
"""Times the separation that rows ask for while they may give way, so that what is given away, and
what comes closer between knots, is none of the separation itself."""

_SOFT_SOLVES = 2
"""Times that a program whose pairs may give way is solved: with the rows of its reference, and with
those of what it then breaks."""

MAX_SPREADS = 20
"""Bound on the iterations towards a first plan."""


def by_size(scenario: Scenario) -> Coupling:
    """How a fleet is kept apart if nothing else is asked: jointly as long as it is small."""
    return jointly if len(scenario.vehicles) <= MOST_TOGETHER else by_halves


def meetings_of(scenario: Scenario, motion: Motion, within: float) -> Meetings:
    """Pairs closer than `within` [m]: at the knots or, if that is asked, at any instant."""
    separation = _separation(scenario)
    find = closest if scenario.between_knots else at_knots
    return _under_way(scenario, find(motion, separation, within))


def _under_way(scenario: Scenario, where: Meetings) -> Meetings:
    """Those after the start and before the end, which starts and goals decide."""
    grid = scenario.grid
    inner = (where.times > _AT_ONCE * grid.step) & (
        where.times < grid.duration - _AT_ONCE * grid.step
    )
    return where.select(inner)


def too_close(scenario: Scenario, motion: Motion) -> Meetings:
    """Pairs that break their separation."""
    separation = _separation(scenario)
    return meetings_of(scenario, motion, separation.distance - WORST * separation.tolerance)


class Apart:
    """Plans of a fleet around one reference after the other.

    The rows that held one plan back are in the programs of the next from the start.

    Args:
        scenario: with a separation.
        coupling: how the rows of pairs are written.
        solver: a Drake solver; Clarabel if not given.

    Attributes:
        programs: those that were solved last.
    """

    def __init__(
        self, scenario: Scenario, coupling: Coupling, solver: SolverInterface | None = None
    ) -> None:
        self._scenario, self._coupling, self._solver = scenario, coupling, solver
        self._held: IntArray = np.zeros(0, dtype=int)
        self._boxes: list[HalfSpaces] = []
        self.programs: Programs | None = None

    def around(
        self,
        reference: Plan,
        *,
        price: float = np.inf,
        aside: bool = False,
        rounds: int = MAX_ROUNDS,
    ) -> Plan:
        """The plan of least index with obstacles and pairs linearised around `reference`.

        Args:
            reference: a motion of the same vehicles on the same grid.
            price: what the index may rise for each metre that a pair is too close.
            aside: whether close encounters of the reference get one direction each.
            rounds: in which rows of pairs are added; with fewer they may be broken.

        Raises:
            InfeasibleError: there is none.
            SolverError: the solvers fail numerically.
        """
        scenario, motion = self._scenario, reference.motion()
        separation = _separation(scenario)
        soft = bool(np.isfinite(price))
        kept = ~self._crowded(motion) if soft else np.zeros(len(scenario.vehicles), dtype=bool)
        programs = Programs(
            scenario,
            together=self._coupling is jointly,
            kept=(kept, reference.accelerations) if np.any(kept) else None,
        )
        constraints = constraints_around(scenario, reference)
        constraints += [Listed(rows, np.ones(len(rows), dtype=bool)) for rows in self._boxes]
        near = _under_way(scenario, at_knots(motion, separation, NEAR * separation.distance))
        within = separation.distance * (1.0 if soft else GRAZING)
        where = near.and_also(meetings_of(scenario, motion, within))
        asked = separation
        if soft:
            asked = unchecked(separation, distance=ROOM * separation.distance)
        solves = _SOFT_SOLVES if soft else MAX_ROUNDS
        for _ in range(solves):
            n = directions(separation, motion, where, aside=aside)
            rows = self._coupling(asked, motion, where, n, price)
            constraints.append(Listed(rows, np.isin(self._keys(rows), self._held), rounds))
            try:
                programs.keep_to(constraints, self._solver)
            except InfeasibleError:
                if self._coupling is by_halves:
                    raise
                # by halves there is none either, and each vehicle's reasons can be told
                halves = Apart(scenario, by_halves, self._solver)
                plan = halves.around(reference)
                self.programs = halves.programs
                return plan
            where = too_close(scenario, programs.motion)
            if len(where) == 0:
                break
        else:
            if not soft:
                raise SolverError(f"pairs were still too close after {solves} rounds")
        self._remember(programs)
        self.programs = programs
        return programs.plan(reference)

    def _crowded(self, motion: Motion) -> BoolArray:
        """Which vehicles are too close to another."""
        close = too_close(self._scenario, motion)
        crowded = np.zeros(len(self._scenario.vehicles), dtype=bool)
        crowded[close.one] = crowded[close.other] = True
        return crowded

    def _remember(self, programs: Programs) -> None:
        """Which rows hold the solutions back; those of boxes are the same around any reference."""
        motion = programs.motion
        active = [
            part.select(part.margins(motion) < _TOUCHING * part.tolerances)
            for part in programs.rows
        ]
        keys = [self._keys(part) for part in active if part.name == NAME]
        self._held = np.concatenate([self._held[:0], *keys])
        self._boxes = [part for part in active if part.name.endswith("box") and len(part) > 0]

    def _keys(self, rows: HalfSpaces) -> IntArray:
        """A number for each pair and knot."""
        grid, count = self._scenario.grid, len(self._scenario.vehicles)
        partners = rows.vehicles if rows.partners is None else rows.partners
        knots = np.rint(rows.times / grid.step).astype(int)
        keys: IntArray = (rows.vehicles * count + partners) * grid.knots + knots
        return keys


def spread(scenario: Scenario, plan: Plan, solver: SolverInterface | None = None) -> Plan:
    """A plan whose vehicles keep apart, from one that need not.

    Every pair's rows may give way at a price, which triples from one linearisation to the next
    until none of them does. Each vehicle yields half, so all are planned side by side; those that
    are in nobody's way keep to what they have.

    Raises:
        InfeasibleError: none was found.
    """
    spent, price = plan.statistics, _first_price(scenario, plan)
    apart = Apart(scenario, by_halves, solver)
    for number in range(MAX_SPREADS):
        broken = too_close(scenario, plan.motion())
        if len(broken) == 0:
            return plan.with_statistics(spent)
        if broken.distances.min() > ALMOST * _separation(scenario).distance:
            with suppress(InfeasibleError, SolverError):
                found = apart.around(plan)
                return found.with_statistics(spent + found.statistics)
        try:
            plan = apart.around(plan, price=price, aside=number == 0, rounds=1 + number // 2)
        except SolverError:  # a price beyond all numbers: the pairs cannot be paid apart
            break
        spent += plan.statistics
        price *= 3.0
    raise _crowded_error(scenario, plan.motion(), spent)


def _crowded_error(scenario: Scenario, motion: Motion, spent: Statistics) -> InfeasibleError:
    """The pairs that were left too close, and when."""
    names = [vehicle.name for vehicle in scenario.vehicles]
    left = too_close(scenario, motion)
    conflicts: dict[str, tuple[str, ...]] = {}
    for one, other, time in zip(left.one, left.other, left.times, strict=True):
        for vehicle, partner in ((one, other), (other, one)):
            reason = f"{NAME} from {names[partner]} at {time:.4g} s"
            conflicts[names[vehicle]] = (*conflicts.get(names[vehicle], ()), reason)
    touched = {name: frozenset([NAME]) for name in conflicts}
    return InfeasibleError(conflicts, statistics=spent, scenario=scenario, obstacles=touched)


def _first_price(scenario: Scenario, plan: Plan) -> float:
    """What a metre is worth at first: the index of moving aside, and that of the plan, a metre."""
    separation, T = _separation(scenario), scenario.grid.duration
    aside = scenario.grid.knots * (4.0 * separation.distance / T**2) ** 2
    return (plan.cost / len(scenario.vehicles) + aside) / separation.distance


def _separation(scenario: Scenario) -> Separation:
    if scenario.separation is None:
        raise ValueError("scenario: got one without a separation, expected one with it")
    return scenario.separation
