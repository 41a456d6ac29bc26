"""Search for the global optimum: a tree of branches for each group of vehicles that interact."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from itertools import repeat

import numpy as np

from drake_rho.analysis.branch_and_bound import Relaxation, Tree, split
from drake_rho.analysis.lagrangian import Proposal
from drake_rho.analysis.nodes import Node, Split
from drake_rho.analysis.proof import Proved
from drake_rho.analysis.sides import Sides
from drake_rho.motion.costs import costs_of
from drake_rho.motion.plan import Plan
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.call.time_limit import check_time, seconds_left
from drake_rho.planning.errors import OutOfTimeError
from drake_rho.planning.scp.cutting_planes import CuttingPlanes
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Scenario
from drake_rho.system.numbers import percent
from drake_rho.verification.report import Report
from drake_rho.verification.verify import verify

_CHEAPER = 1e-7
"""Relative fall of the cost for which a plan replaces the best one."""


@dataclasses.dataclass(eq=False)
class Part:
    """Group of vehicles whose costs are bounded together."""

    group: IntArray
    """indices of the vehicles, shape (G,)"""
    bound: float
    """lower bound on the cost of the group [m²/s⁴]"""
    root: Node | None = None
    """node of all its motions; None if the group was joined"""
    tree: Tree | None = None
    """nodes of the group's motions; None before the first is split"""
    alone: float = np.inf
    """least cost of the group's plans that other vehicles exclude [m²/s⁴]"""
    nearest: int = -1
    """index of the vehicle of another group that comes closest to such a plan; -1 without one"""
    proofs: tuple[Proved, ...] = ()
    """trees of branches that prove `bound`"""

    @property
    def lower(self) -> float:
        """Best lower bound on the cost of the group [m²/s⁴]."""
        return self.bound if self.tree is None else max(self.bound, self.tree.bound)

    @property
    def proved(self) -> tuple[Proved, ...]:
        """Trees of branches that prove the best lower bound."""
        if self.tree is None or self.tree.bound < self.bound:
            return self.proofs
        return ((self.group, self.tree.proof),)


class GlobalSearch:
    """Branch and bound for a plan, group by group.

    Args:
        plan: the best plan that is known.
        relaxed: its scenario, or one with more plans, which is bounded.
        parts: groups of vehicles and their bounds.
        solved: function that returns converged programs around a plan.
        executor: any PEP 3148 executor that splits nodes; None for this process.
        progress: called with bound, cost, gap and nodes after each step.

    Attributes:
        plan: the best plan found.
        cut: whether time was up.
        history: number of nodes, bound and best cost [m²/s⁴] after each step.
    """

    def __init__(
        self,
        plan: Plan,
        relaxed: Scenario,
        parts: Sequence[Part],
        solved: Callable[[Plan], CuttingPlanes],
        executor: Executor | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.plan, self.parts, self.cut, self._relaxed = plan, list(parts), False, relaxed
        self._solved, self._executor, self._progress = solved, executor, progress
        self._costs = vehicle_costs(plan)
        self.history = [(0, self.bound, self.cost)]

    @property
    def cost(self) -> float:
        """Cost of the best plan [m²/s⁴], with the prices of soft limits."""
        return float(self._costs.sum())

    @property
    def bound(self) -> float:
        """Lower bound on the cost of every plan [m²/s⁴]."""
        return sum(part.lower for part in self.parts)

    @property
    def nodes(self) -> int:
        """Number of nodes that were bounded."""
        return sum(part.tree.nodes for part in self.parts if part.tree is not None)

    def run(self, gap: float) -> None:
        """Split nodes until the relative gap is at most a given one, or time or nodes end.

        Args:
            gap: relative gap (cost - bound) / cost.
        """
        try:
            while self.cost - self.bound > gap * self.cost:
                able = [each for each in self.parts if self._is_open(each, gap)]
                if not able:
                    break
                self._step(max(able, key=lambda each: self._of(each) - each.lower), gap)
                self._tell()
        except OutOfTimeError:
            self.cut = True

    def _of(self, part: Part) -> float:
        """Return the cost of a group in the best plan [m²/s⁴]."""
        return float(self._costs[part.group].sum())

    def _is_open(self, part: Part, gap: float) -> bool:
        """Return whether the bound of a part is too low and may rise."""
        if self._excluded(part, gap):
            return True
        enough = self._enough(part, gap)
        return part.lower < enough and (part.tree is None or part.tree.has_below(enough))

    def _enough(self, part: Part, gap: float) -> float:
        """Return the bound of a part at which its tree ends [m²/s⁴]: it is at most `alone`."""
        return (1.0 - gap) * min(self._of(part), part.alone)

    def _excluded(self, part: Part, gap: float) -> bool:
        """Return whether another vehicle excludes a plan of a part that closes the gap."""
        return part.nearest >= 0 and part.alone < (1.0 - gap) * self._of(part)

    def _step(self, part: Part, gap: float) -> None:
        """Split some nodes of a part, or join it to another."""
        if self._excluded(part, gap):
            self._join(part)
            return
        enough = self._enough(part, gap)
        tree = part.tree = part.tree or self._tree(part, enough)
        nodes = tree.least(enough)
        try:
            results = list(self._split(tree, nodes, enough))
        except BaseException:
            tree.put_back(nodes)
            raise
        for node, result in zip(nodes, results, strict=True):
            tree.replace(node, result, enough)
            if result.found is not None:
                self._try(part, tree, result.found)

    def _tree(self, part: Part, enough: float) -> Tree:
        """Return the tree of a part."""
        name = group_name(self.plan.scenario, part.group)
        tell(self._progress, f"bounding the cost of {name}")
        scenario = self._relaxed.of_vehicles(part.group.tolist())
        plan = Plan.from_accelerations(scenario, self.plan.accelerations[part.group])
        relaxation, root = Relaxation(scenario), part.root
        if root is None:
            everyone = np.arange(len(part.group))
            proposal = Proposal.of(self._solved(plan), everyone, as_planned=False)
            root = relaxation.root([proposal], enough)
        return Tree(scenario, relaxation.with_plan(root, plan))

    def _split(self, tree: Tree, nodes: Sequence[Node], enough: float) -> Iterable[Split]:
        """Return the results of splitting nodes, side by side if there is an executor."""
        check_time()
        if self._executor is None:
            return [split(tree.scenario, node, enough) for node in nodes]
        ends = time.time() + seconds_left()  # workers do not have this call's deadline
        given = repeat(tree.scenario), nodes, repeat(enough), repeat(ends)
        return self._executor.map(split, *given)

    def _try(self, part: Part, tree: Tree, accelerations: FloatArray) -> None:
        """Replace the best plan by one with other motions of a part, if it is better."""
        alone = Plan.from_accelerations(tree.scenario, accelerations)
        cost = float(vehicle_costs(alone).sum())
        if cost > (1.0 - _CHEAPER) * min(self._of(part), part.alone) or not verify(alone).ok:
            return
        every = self.plan.accelerations.copy()
        every[part.group] = accelerations
        plan = Plan.from_accelerations(self.plan.scenario, every, self.plan.statistics)
        if verify(plan).ok:
            self.plan, self._costs, part.alone = plan, vehicle_costs(plan), np.inf
        else:
            part.alone, part.nearest = cost, self._nearest(part, plan)

    def _nearest(self, part: Part, plan: Plan) -> int:
        """Return the vehicle of another part that comes closest to a part; -1 without any."""
        others = np.setdiff1d(np.arange(len(self._costs)), part.group)
        if self._relaxed.separation is None or len(others) == 0:
            return -1
        at = plan.motion().at("position", Sides(self._relaxed).times)
        pairs = at[part.group][:, None] - at[others]
        distances = self._relaxed.separation.shape.local_distance(pairs)
        return int(others[np.argmin(distances.min(axis=(0, 2), initial=np.inf))])

    def _join(self, part: Part) -> None:
        """Join a part with the part of its nearest vehicle."""
        (other,) = (each for each in self.parts if part.nearest in each.group)
        group = np.sort(np.append(part.group, other.group))
        proofs = (*part.proved, *other.proved)
        joined = Part(group, part.lower + other.lower, proofs=proofs)
        self.parts = [each for each in self.parts if each not in (part, other)] + [joined]

    def _tell(self) -> None:
        left = sum(part.tree.left for part in self.parts if part.tree is not None)
        self.history.append((self.nodes, self.bound, self.cost))
        gap = max(0.0, 1.0 - self.bound / self.cost) if self.cost > 0.0 else 0.0
        tell(
            self._progress,
            f"bound {self.bound:.6g}, best cost {self.cost:.6g} m²/s⁴, gap {percent(gap)}, "
            f"{self.nodes} nodes, {left} left",
        )


def group_name(scenario: Scenario, group: IntArray) -> str:
    """Return the name of a group: its vehicle, or the first one and the number of others."""
    name = scenario.vehicles[group[0]].name
    return name if len(group) == 1 else f"{name} and {len(group) - 1} more"


def vehicle_costs(plan: Plan) -> FloatArray:
    """Return the cost of each vehicle with the price of its soft limits [m²/s⁴], shape (N,)."""
    costs = costs_of(plan.scenario, plan)
    return costs + prices_of(verify(plan)) if plan.scenario.penalties else costs


def prices_of(report: Report) -> FloatArray:
    """Return the price of the soft limits for each vehicle [m²/s⁴], shape (N,)."""
    prices = dict.fromkeys(report.scenario.names, 0.0)
    for check in report.exceeded:
        prices[check.vehicle] += check.price or 0.0
    return np.array(list(prices.values()))
