"""Branch and bound over the sides of obstacles and of other vehicles: `Tree`.

A node is a branch (`sides.py`) with multipliers for which the Lagrangian's minimum bounds the cost
of all its motions. Its parts begin with the node's multipliers; terms that the motion at the
minimum violates enter, and the minimum is maximised again. Nothing in a bound depends on a solver:
a node is closed by the value of a closed form alone, also where it is empty.
"""

from __future__ import annotations

import dataclasses
import heapq
import time
from collections.abc import Iterable
from contextlib import suppress
from itertools import count
from typing import Any

import numpy as np

from drake_rho.analysis.ascent import Climb, climbed
from drake_rho.analysis.lagrangian import Lagrangian, Proposal
from drake_rho.analysis.nodes import Node, Split
from drake_rho.analysis.proof import Proof
from drake_rho.analysis.sides import Sides
from drake_rho.analysis.terms import AffineTerms, GroupChanges
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan
from drake_rho.planning.call.time_limit import check_time, within_time
from drake_rho.planning.constraints.base import Constraint, HalfSpaces
from drake_rho.planning.constraints.separation import coupled
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.problem import Problem
from drake_rho.planning.scp.sequential_convex import sequential_convex
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario
from drake_rho.system.threads import single_threaded_blas

_ROUNDS = 4
"""Number of times that violated terms enter a node's Lagrangian."""

_GAIN = 0.1
"""Part of the distance to what is enough by which a round has to raise the bound, or it is the
last one."""

_MOST_ROUNDS = 20
"""Number of times that they enter where no sides are left, whatever a round gains."""

_PRECISION = 1e-5
"""Relative precision of one maximisation."""

_PIECES = 2
"""Pieces of a violated stretch of rows whose worst rows enter."""

_LINEARISATIONS, _PROMISING = (2, 18), 1.1
"""Largest numbers of linearisations of a plan in a branch, at first and if its cost is then at most
so many times what is enough."""

_TOLERANCE = 1e-4
"""Relative fall of the cost at which such a plan has converged."""

_ON = 1e-6
"""Distance beyond a row at which a plan satisfies it, in units of the changes."""

AT_ONCE = 4
"""Number of nodes that are split at a time, whatever the number of workers."""


class Relaxation:
    """Bounds of nodes of one scenario.

    Args:
        scenario: scenario of the vehicles of one group.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.problem, self.sides = Problem.of(scenario), Sides(scenario)
        everyone = np.arange(len(scenario.vehicles))
        self.changes = GroupChanges(self.problem, everyone, as_planned=False)

    def root(self, proposals: Iterable[Proposal], enough: float) -> Node:
        """Return the node of all motions, with the multipliers of one of the proposals."""
        nodes = [self._bounded(Node.proposed(each), enough) for each in proposals]
        return max(nodes, key=lambda each: each.bound)

    def with_plan(self, node: Node, plan: Plan) -> Node:
        """Return a node with a known plan among its motions."""
        plans = (*node.plans, self.changes.of(plan.accelerations))
        return dataclasses.replace(node, plans=plans)

    def split(self, node: Node, enough: float) -> Split:
        """Return the parts of a node with their bounds, and a plan on its sides.

        A node whose motion leaves no side to split is its only part, if its bound rises.
        """
        motion = self._motion(node.at)
        losses = self._losses(node)
        division = self.sides.parts_of(node.branch, motion, node.by_place, node.curved, losses)
        if division is None:
            better = self._bounded(node, enough, _MOST_ROUNDS, 0.0)
            rises = better.bound - node.bound > _GAIN * (enough - node.bound)
            return Split((better,) if rises else ())
        where, regions = division
        found, plans, vain = None, node.plans, node.vain
        if not plans and not vain:  # else the search would end there again, or in nothing
            found = self._plan(node, motion, enough)
            plans, vain = () if found is None else (self.changes.of(found),), found is None
        parts = list[Node]()
        for region, rows in zip(regions, self.sides.rows(where, regions), strict=True):
            beyond = self.changes.affine(rows, kept=True)
            part = dataclasses.replace(
                node,
                branch={**node.branch, where: region},
                affine=node.affine.union(beyond),
                multipliers=np.append(node.multipliers, np.zeros(len(beyond))),
                plans=tuple(v for v in plans if _holds(beyond, v)),
                vain=vain and where in node.branch,
            )
            # where the relaxed problem's solution is on these sides, the bound cannot rise
            parts.append(part if _holds(beyond, node.at) else self._bounded(part, enough))
        return Split(tuple(parts), where, *self.sides.place(where), found)

    def _losses(self, node: Node) -> FloatArray:
        """Return the sizes of the curved terms of a node's Lagrangian at its motion, (S,)."""
        lagrangian = Lagrangian(self.changes, node.curved, node.affine)
        weights, _ = lagrangian.within_prices(node.weights, node.multipliers)
        return np.abs(weights * lagrangian.slopes(node.at)[0])

    def _motion(self, at: FloatArray) -> Motion:
        scenario = self.problem.scenario
        return Plan.from_accelerations(scenario, self.changes.accelerations(at)).motion()

    def _bounded(
        self, node: Node, enough: float, rounds: int = _ROUNDS, gain: float = _GAIN
    ) -> Node:
        """Return a node with a better bound and the multipliers that prove it."""
        for number in range(rounds):
            check_time()
            lagrangian = Lagrangian(self.changes, node.curved, node.affine)
            climb = climbed(
                lagrangian, node.weights, node.multipliers, enough=enough, tolerance=_PRECISION
            )
            minimum = lagrangian.minimum(climb.weights, climb.multipliers)
            bound = self.changes.unit**2 * minimum.value
            gained, node = self._with(node, bound, climb)
            if node.bound >= enough or not np.isfinite(minimum.value):
                break
            if number > 0 and gained < gain * (enough - node.bound):
                break
            violated = self._violated(self._motion(climb.at))
            if not violated:
                break
            node = self._with_terms(node, violated)
        return node

    def _with(self, node: Node, bound: float, climb: Climb) -> tuple[float, Node]:
        """Return how much a bound is better than a node's, and the node with it, if it is."""
        if bound < node.bound and node.bound > 0.0:
            return 0.0, dataclasses.replace(node, at=climb.at)
        curved, affine = climb.weights > 0.0, (climb.multipliers > 0.0) | node.affine.kept
        better = dataclasses.replace(
            node,
            bound=max(bound, node.bound),
            curved=node.curved.select(curved),
            affine=node.affine.select(affine),
            weights=climb.weights[curved],
            multipliers=climb.multipliers[affine],
            at=climb.at,
        )
        return bound - node.bound, better

    def _with_terms(self, node: Node, rows: Iterable[HalfSpaces]) -> Node:
        """Return a node with more terms, with multipliers of zero."""
        curved, affine = self.changes.terms(rows)
        curved = curved.select(np.isfinite(curved.sizes))
        return dataclasses.replace(
            node,
            curved=node.curved.union(curved),
            affine=node.affine.union(affine),
            weights=np.append(node.weights, np.zeros(len(curved))),
            multipliers=np.append(node.multipliers, np.zeros(len(affine))),
        )

    def _violated(self, motion: Motion) -> list[HalfSpaces]:
        """Return the worst rows of all constraints that a motion violates."""
        problem, found = self.problem, list[HalfSpaces]()
        constraints: list[Constraint] = [*problem.convex, *problem.obstacles_around(motion)]
        if problem.scenario.separation is not None and len(problem) > 1:
            constraints.append(problem.pairs_around(motion, coupled))
        everyone, gap = np.arange(len(problem)), 1.5 * problem.scenario.grid.step
        for each in constraints:
            rows = each.violated_rows(motion, everyone)
            if len(rows) == 0 and each.searches > 0:
                rows = each.violated_rows(motion, everyone, between=True)
            if len(rows) > 0:
                found.append(rows.worst(motion, _PIECES, gap=gap))
        return found

    def _plan(self, node: Node, motion: Motion, enough: float) -> FloatArray | None:
        """Return the accelerations of a plan on a node's sides; None if none is found.

        Far more expensive ones than what is enough are not iterated to convergence.
        """
        scenario = self.problem.scenario
        requirements = (*scenario.requirements, *self.sides.requirements(node.branch))
        narrowed = scenario.derived(requirements=requirements)
        reached = Plan.from_accelerations(narrowed, motion.accelerations)
        subproblem = Subproblem(Problem.of(narrowed), coupled)
        together = np.zeros(len(self.problem), dtype=int)
        with suppress(InfeasibleError, SolverError):
            reached = subproblem.solve_around(reached)
            for most in _LINEARISATIONS:
                reached = sequential_convex(
                    subproblem, reached, _TOLERANCE, labels=together, most=most
                )
                if reached.cost > _PROMISING * enough:
                    break
            return reached.accelerations
        return None


def _holds(rows: AffineTerms, v: FloatArray) -> bool:
    """Return whether changes v satisfy rows."""
    return bool(np.all(np.einsum("rma,ma->r", rows.matrix, v) >= rows.lower - _ON))


@single_threaded_blas
def split(scenario: Scenario, node: Node, enough: float, ends: float = np.inf) -> Split:
    """Return the parts of a node of a scenario, in this process or another.

    Args:
        scenario: scenario of the vehicles of one group.
        node: to be split.
        enough: bound at which a part needs no further split [m²/s⁴].
        ends: deadline on the clock of `time.time` [s].
    """
    with within_time(None if ends == np.inf else ends - time.time()):
        return Relaxation(scenario).split(node, enough)


class Tree:
    """Nodes that contain all motions of a group of vehicles.

    Args:
        scenario: scenario of these vehicles.
        root: node of all motions.

    Attributes:
        scenario: scenario of these vehicles.
        nodes: number of nodes that were bounded.
    """

    def __init__(self, scenario: Scenario, root: Node) -> None:
        self.scenario, self.nodes = scenario, 1
        self._open, self._closed = list[tuple[float, int, Node]](), np.inf
        self._numbers = count()  # of equal bounds, the node that was added first
        self._proof = Proof(root)
        self.put_back([root])

    @property
    def bound(self) -> float:
        """Lower bound on the cost of all motions [m²/s⁴]."""
        return min(self._open[0][0] if self._open else np.inf, self._closed)

    @property
    def left(self) -> int:
        """Number of nodes that are left to split."""
        return len(self._open)

    @property
    def proof(self) -> dict[str, Any]:
        """Branches and their multipliers, as a certificate's file has them."""
        return self._proof.content

    def has_below(self, enough: float) -> bool:
        """Return whether a node to split has a bound below `enough` [m²/s⁴]."""
        return bool(self._open) and self._open[0][0] < enough

    def least(self, enough: float) -> list[Node]:
        """Remove and return the nodes with the least bounds below `enough` [m²/s⁴]."""
        taken = list[Node]()
        while self.has_below(enough) and len(taken) < AT_ONCE:
            taken.append(heapq.heappop(self._open)[2])
        return taken

    def put_back(self, nodes: Iterable[Node]) -> None:
        """Add nodes that are left to split."""
        for each in nodes:
            heapq.heappush(self._open, (each.bound, next(self._numbers), each))

    def replace(self, node: Node, result: Split, enough: float) -> None:
        """Add the parts of a node that was removed; without any, keep its bound."""
        if not result.parts:
            self._closed = min(self._closed, node.bound)
            return
        self._proof.split(node, result)
        for part in result.parts:
            self.nodes += 1
            if part.bound >= enough:
                self._closed = min(self._closed, part.bound)
            else:
                self.put_back([part])
