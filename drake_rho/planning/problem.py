"""Planning problem: a scenario, compiled once for all planners."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import cached_property

import numpy as np

from drake_rho.motion.close_pairs import CloseApproaches, PairSearch
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan
from drake_rho.planning.constraints.base import Constraint
from drake_rho.planning.constraints.boxes import KeepInBox, boxes_of
from drake_rho.planning.constraints.close_pairs import separation_of
from drake_rho.planning.constraints.keep_in import KeepInSets
from drake_rho.planning.constraints.keep_out import KeepOutOfObstacle
from drake_rho.planning.constraints.limits import norms_of, requirements_of, waypoints_of
from drake_rho.planning.constraints.margins import UNBOUNDED, PlanMargins, margins_of
from drake_rho.planning.constraints.obstacles import obstacles_of
from drake_rho.planning.constraints.separation import Coupling, KeepApart, pairs_of
from drake_rho.planning.constraints.tightening import (
    CANNOT_HOLD,
    NO_SLACK,
    largest_tolerable_wind,
    missing_slack,
    missing_slack_at_rest,
    without_wind,
)
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.requirements import linked_groups
from drake_rho.scenario.waypoints import check_times

_PIECES = 16
"""Least number of pieces of a step over which finer margins are constant."""

_REDUCTION = 0.02
"""Least relative reduction of margins for which a second search is worth its time."""


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """Minimisation of the cost of a scenario's motions subject to its constraints.

    All data that planners derive from the scenario are computed here, on first use.
    """

    scenario: Scenario
    """scenario to plan"""
    pieces: int = 1
    """number of equal pieces of a step with constant margins of positions and velocities"""
    elastic: bool = False
    """true if only violations are penalised and goals may be missed"""
    accelerations: FloatArray | np.float64 = UNBOUNDED
    """largest accelerations for the margin of a smoothing, as in `margins_of`"""
    before: Motion | None = None
    """plan in force, at whose close approaches to obstacles rows are tried first; None for none"""

    @classmethod
    def of(cls, scenario: Scenario, *, before: Motion | None = None) -> Problem:
        """Return the problem of a scenario with margins that are constant over steps.

        Args:
            scenario: to plan.
            before: the plan in force, if a window is planned.

        Raises:
            ScenarioError: a waypoint has no time.
        """
        check_times(scenario.vehicles)
        return cls(scenario, before=before)

    def __len__(self) -> int:
        """Return the number of vehicles, N."""
        return len(self.scenario.vehicles)

    @cached_property
    def margins(self) -> PlanMargins:
        """Constraint tightening for the errors of disturbed flights."""
        return margins_of(self.scenario, self.pieces, self.accelerations)

    @cached_property
    def effort(self) -> MinimumEffort:
        """Minimum-effort motions; the unknowns of programs are changes of these."""
        effort = MinimumEffort.of(self.scenario)
        if not self.elastic:
            return effort
        return effort.without_goals(self.scenario.fleet.units_of_violations)

    @cached_property
    def boxes(self) -> list[KeepInBox]:
        """Limits that are boxes."""
        return boxes_of(self.scenario, self.margins)

    @cached_property
    def norms_and_waypoints(self) -> list[KeepInSets]:
        """Limits on norms, and waypoints."""
        scenario, margins = self.scenario, self.margins
        return [*norms_of(scenario, margins), *waypoints_of(scenario, margins)]

    @cached_property
    def requirements(self) -> list[KeepInSets]:
        """Requirements (`KeepIn`) that have not ended."""
        return requirements_of(self.scenario, self.margins)

    @cached_property
    def convex(self) -> tuple[Constraint, ...]:
        """Convex constraints, which need no reference."""
        return (*self.boxes, *self.norms_and_waypoints, *self.requirements)

    @cached_property
    def pair_search(self) -> PairSearch:
        """Search for close pairs of vehicles.

        Raises:
            ValueError: the scenario has no separation.
        """
        return PairSearch(separation_of(self.scenario))

    @cached_property
    def linked_groups(self) -> IntArray:
        """Number of each vehicle's group, equal for vehicles that requirements link, (N,)."""
        scenario = self.scenario
        return linked_groups(scenario.required, scenario.names, scenario.grid)

    @cached_property
    def has_links(self) -> bool:
        """Whether a requirement constrains the difference of two vehicles."""
        groups = self.linked_groups
        return len(np.unique(groups)) < len(groups)

    def with_linked(self, vehicles: IntArray) -> IntArray:
        """Return vehicles and all others that requirements link to them, as increasing indices."""
        if not self.has_links:
            return vehicles
        groups = self.linked_groups
        return np.flatnonzero(np.isin(groups, groups[vehicles]))

    def obstacles_around(self, reference: Motion) -> list[KeepOutOfObstacle]:
        """Return constraints of known obstacles, linearised (15) around a motion."""
        return obstacles_of(self.scenario, self.margins, reference, self.before)

    def pairs_around(
        self,
        reference: Motion,
        coupling: Coupling,
        *,
        penalty: float = np.inf,
        one_normal: bool = False,
        of: IntArray | None = None,
        close: CloseApproaches | None = None,
    ) -> KeepApart:
        """Return the separation constraint of all pairs, linearised around a motion.

        Arguments are those of `pairs_of`.

        Raises:
            ValueError: the scenario has no separation.
        """
        return pairs_of(
            self.scenario,
            self.margins,
            self.pair_search,
            reference,
            coupling,
            penalty=penalty,
            one_normal=one_normal,
            of=of,
            close=close,
        )

    def linearized(
        self,
        reference: Plan | None,
        coupling: Coupling | None = None,
        *,
        vehicles: IntArray | None = None,
    ) -> list[Constraint]:
        """Return all constraints, with obstacles and pairs linearised around a reference.

        Arguments and errors are those of `avoidance`.
        """
        return [*self.convex, *self.avoidance(reference, coupling, vehicles=vehicles)]

    def avoidance(
        self,
        reference: Plan | None,
        coupling: Coupling | None = None,
        *,
        vehicles: IntArray | None = None,
    ) -> list[Constraint]:
        """Return the constraints of obstacles and pairs, linearised around a reference.

        Args:
            reference: the reference plan; None omits obstacles and pairs.
            coupling: the form of rows for pairs; None omits pairs.
            vehicles: increasing indices of vehicles; each pair includes at least one of them. All
                if None.

        Raises:
            ValueError: the reference has another number of vehicles or another grid.
        """
        if reference is None:
            return []
        self.check_fits(reference)
        motion = reference.motion()
        constraints: list[Constraint] = [*self.obstacles_around(motion)]
        if coupling is not None and self.scenario.separation is not None:
            constraints.append(self.pairs_around(motion, coupling, of=vehicles))
        return constraints

    def prices(self, plan: Plan) -> FloatArray:
        """Return the price of each vehicle's soft limits in a plan [m²/s⁴], shape (N,).

        It is measured from the limits themselves, obstacles not linearised, with planners' margins.
        """
        if not self.scenario.penalties:
            return self._no_prices
        total, everyone, motion = np.zeros(len(self)), np.arange(len(self)), plan.motion()
        for each in [*self.convex, *self.obstacles_around(motion)]:
            if each.prices is None:
                continue
            excess = np.zeros(len(self))
            for between in (False, True)[: 1 + (each.searches > 0)]:
                rows = each.violated_rows(motion, everyone, between=between)
                violations = -rows.margins(motion)
                violations[violations <= rows.tolerances] = 0.0  # as `verify` counts them
                np.maximum.at(excess, rows.vehicles, violations)
            total += each.prices * excess
        return total

    @cached_property
    def _no_prices(self) -> FloatArray:
        return np.zeros(len(self))

    def total_cost(self, plan: Plan) -> float:
        """Return the cost by which plans are compared [m²/s⁴]: of accelerations, and prices."""
        return float(plan.cost + sum(self.prices(plan).tolist()))

    def check_fits(self, reference: Plan) -> None:
        """Check that a reference has the same number of vehicles and the same grid.

        Raises:
            ValueError: the number of vehicles or the grid differs.
        """
        theirs, ours = (
            (len(each.vehicles), each.grid.knots, each.grid.step)
            for each in (reference.scenario, self.scenario)
        )
        if theirs != ours:
            words = "{} vehicles on {} knots, {:g} s apart"
            got, expected = words.format(*theirs), words.format(*ours)
            raise ValueError(f"reference: got {got}, expected {expected}")

    def check_tightening_slack(self) -> None:
        """Check that limits, starts and goals leave sufficient slack for the disturbance, if any.

        Goals are checked for holding after the end too (`Scenario.hold_at_goal`).

        A flight under way is not checked here: each window is checked when it is planned.

        Raises:
            InfeasibleError: the slack is insufficient; the error has the largest tolerable wind.
        """
        scenario = self.scenario
        if scenario.under_way:
            return
        if scenario.disturbance is None:
            if conflicts := missing_slack_at_rest(scenario):
                raise InfeasibleError(conflicts, scenario=scenario, because=CANNOT_HOLD)
            return
        if conflicts := missing_slack(scenario, self.margins):
            calm = dataclasses.replace(self, scenario=without_wind(scenario)).margins
            wind = largest_tolerable_wind(scenario, self.margins, calm)
            raise InfeasibleError(conflicts, scenario=scenario, bearable=wind, because=NO_SLACK)

    def for_accelerations(self, accelerations: FloatArray) -> Problem:
        """Return this problem with the smoothing margin of accelerations, as in `margins_of`."""
        return dataclasses.replace(self, accelerations=accelerations)

    def without_obstacles(self) -> Problem:
        """Return this problem without obstacles."""
        return dataclasses.replace(self, scenario=self.scenario.without_obstacles())

    def without_separation(self) -> Problem:
        """Return this problem without a separation, so that vehicles are independent."""
        return dataclasses.replace(self, scenario=self.scenario.without_separation())

    def of_violations(self) -> Problem:
        """Return the problem in which only violations are penalised and goals may be missed."""
        return dataclasses.replace(self, elastic=True)

    def with_finer_margins(self) -> Problem | None:
        """Return this problem with margins over pieces of steps; None if they are hardly smaller.

        A flight under way has no finer margins either: time is short, and the previous plan serves
        as a fallback.
        """
        scenario = self.scenario
        smooth = scenario.smoothing is not None
        if scenario.disturbance is None or smooth or self.pieces > 1 or scenario.under_way:
            return None
        samples = scenario.disturbance.samples_per_step(scenario.grid.step)
        # a few samples: a whole number of pieces each
        pieces = samples * math.ceil(_PIECES / samples) if samples < _PIECES else _PIECES
        finer = dataclasses.replace(self, pieces=pieces)
        return finer if finer._has_smaller_margins() else None

    def _has_smaller_margins(self) -> bool:
        """Return whether margins over pieces are smaller than over steps by `_REDUCTION`."""
        inner, steps = self.margins.inner, self.margins.steps
        return any(
            np.any(inner.knots[each][:: self.pieces] < (1.0 - _REDUCTION) * steps.knots[each])
            for each in ("position", "velocity")
        )


def with_finer_margins(find: Callable[[Problem], Plan], problem: Problem) -> Plan:
    """Return a plan with margins over steps or, if none is found, over pieces of steps.

    Args:
        find: function that plans a problem; it may raise `InfeasibleError` and `SolverError`.
        problem: the problem with margins over steps.

    Raises:
        InfeasibleError: no plan is found with either margins.
        SolverError: the solvers fail numerically.
    """
    try:
        return find(problem)
    except InfeasibleError as error:
        if (finer := problem.with_finer_margins()) is None:
            raise
        try:
            plan = find(finer)
        except InfeasibleError as again:  # its slack is that of the finest margins
            spent = error.statistics + again.statistics
            raise again.replaced(steps_tried=error.steps_tried, statistics=spent) from None
        except SolverError as again:
            raise error.replaced(statistics=error.statistics + again.statistics) from None
        return plan.with_statistics(error.statistics + plan.statistics)


def finest(scenario: Scenario) -> Problem:
    """Return the problem of a scenario, with finer margins if these are smaller."""
    problem = Problem.of(scenario)
    return problem.with_finer_margins() or problem
