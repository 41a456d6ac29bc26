"""Records of the gap of a plan to a lower bound on the cost of every plan."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from drake_rho.analysis.check_certificate import CheckedBound
from drake_rho.analysis.proof import Proved, written
from drake_rho.scenario.described import Described
from drake_rho.scenario.records import Scenario
from drake_rho.system.html import html_table
from drake_rho.system.numbers import percent

GLOBAL_GAP = 1e-6
"""Relative gap up to which a plan counts as globally optimal."""


_SHOWN = 3
"""Largest number of obstacles left out of the bound that a printed certificate names."""

_MAX_ROWS = 20
"""Largest number of vehicles that a printed certificate shows: those with the largest gaps."""


_HEADS = ("vehicle", "cost", "lower bound", "gap", "eigenvalue")
"""Heads of a printed certificate's columns."""

_COLUMNS = (
    "gap: (cost - lower bound) / cost; the optimum is between the two",
    "eigenvalue: the Hessian's least; above 0 with nothing left out, a converged plan is optimal",
)
"""Explanation of the columns, printed below the table."""


@dataclasses.dataclass(frozen=True)
class VehicleCertificate(metaclass=Described):
    """Certificate of one vehicle, or of a group of vehicles coupled by separation."""

    vehicle: str
    """name of the vehicle; for a group, that of the first and the number of the others"""
    cost: float
    """cost of this vehicle or group, with the price of its soft limits [m²/s⁴]"""
    lower_bound: float
    """lower bound on this part of the cost of every plan [m²/s⁴]"""
    least_eigenvalue: float
    """least eigenvalue of the Lagrangian's Hessian at the converged plan, restricted to changes
    that leave the final state unchanged. The cost alone has 2. If it is above 0, the bound equals
    the converged plan's cost"""
    stationarity: float
    """KKT residual: norm of the Lagrangian's gradient at the converged plan, relative to that of
    the cost's gradient"""
    complementarity: float
    """KKT residual: largest product of a multiplier and its constraint's violation, relative to the
    cost"""
    planned_bound: float | None = None
    """lower bound for plans that keep the planners' margins [m²/s⁴]; None without a disturbance,
    where there are no margins"""

    @property
    def gap(self) -> float:
        """Relative gap (cost - lower bound) / cost; negative if violated constraints save cost."""
        return _gap(self.cost, self.lower_bound)


@dataclasses.dataclass(frozen=True)
class Certificate(metaclass=Described):
    """Lower bound on the cost of every plan, with a plan's gap to it; prints as a short table.

    With a smoothing it bounds plans that also meet the constraints before averaging.
    """

    scenario: Scenario
    """scenario of the plan"""
    vehicles: tuple[VehicleCertificate, ...]
    """one certificate for each vehicle or, where separation couples vehicles, for each group"""
    holds: bool
    """whether the plan satisfies its constraints; one that does not may cost less than the bound"""
    left_out: tuple[str, ...] = ()
    """obstacles that are active for the plan but left out of the bound, because they have no
    interior, and the separation of a fleet too large to be bounded together; they may account for
    part of the gap"""
    cut: bool = False
    """whether time was up before the bound had converged"""
    jumps: bool = False
    """whether this is the certificate of a flight that jumps to measured states: it is not a plan
    from the starts, and may cost less than each of these"""
    nodes: int = 0
    """number of branches that were bounded, 0 if the bound is without branches"""
    better: float | None = None
    """cost of the best plan that was found on the way [m²/s⁴]; None if none was cheaper"""
    history: tuple[tuple[int, float, float], ...] = dataclasses.field(default=(), repr=False)
    """number of branches, lower bound and best cost [m²/s⁴] at the beginning and after each step of
    branch and bound; empty without"""
    proofs: tuple[Proved, ...] = dataclasses.field(default=(), repr=False, compare=False)
    """groups of vehicles with the branches and multipliers that prove their bounds, as `save`
    writes them; none if time was up before there were any"""

    @property
    def cost(self) -> float:
        """Cost of the plan [m²/s⁴]: the performance index f (13), and prices of limits."""
        return sum(each.cost for each in self.vehicles)

    @property
    def lower_bound(self) -> float:
        """Lower bound on the cost of every plan of the scenario [m²/s⁴]."""
        return sum(each.lower_bound for each in self.vehicles)

    @property
    def gap(self) -> float:
        """Relative gap (cost - lower bound) / cost; negative if violated constraints save cost."""
        return _gap(self.cost, self.lower_bound)

    @property
    def planned_gap(self) -> float:
        """Relative gap to the lower bound for plans that keep the planners' margins.

        It bounds the planner's suboptimality; the rest of `gap` is at most the cost of its margins.
        """
        known = [each.planned_bound for each in self.vehicles]
        bounds = [bound for bound in known if bound is not None]
        return _gap(self.cost, sum(bounds)) if bounds else self.gap

    @property
    def is_globally_optimal(self) -> bool:
        """True if the plan satisfies its constraints and its gap is at most `GLOBAL_GAP`."""
        return self.holds and not self.jumps and abs(self.gap) <= GLOBAL_GAP

    @property
    def least_eigenvalue(self) -> float:
        """Least of the vehicles' eigenvalues."""
        return min(each.least_eigenvalue for each in self.vehicles)

    def save(self, path: str | Path) -> CheckedBound:
        """Write the proof of the bound to a file, which `check_certificate` checks.

        The file has the scenario, the branches and the multipliers, as numbers. It is checked
        before it is written, and the bound that it proves is returned: it may be lower than
        `lower_bound` by rounding. Of maps it has the parts that the bound rests on.

        Args:
            path: file to write, such as `mission.proof`.

        Raises:
            OSError: the file cannot be written.
            ValueError: there are no multipliers, since time was up, or the scenario has what such
                files do not hold: other costs than effort, penalties, a disturbance, a smoothing,
                sets of one's own, and velocities relative to a track.
        """
        if not self.proofs:
            raise ValueError("certificate: got none with multipliers, since time was up")
        return written(Path(path), self.scenario, self.proofs)

    def _planned_gap(self) -> str:
        if self.scenario.smoothing is not None:
            return " (of plans that meet the constraints before they are averaged too)"
        if self.scenario.disturbance is None:
            return ""
        return f" ({percent(self.planned_gap)} with the margins that planners keep)"

    def _left_out(self) -> str:
        if not self.left_out:
            return ""
        shown = ", ".join(self.left_out[:_SHOWN])
        more = f" and {len(self.left_out) - _SHOWN} more" if len(self.left_out) > _SHOWN else ""
        return f"; the bound leaves out {shown}{more}"

    def __str__(self) -> str:
        form = "{:<12} {:>14} {:>14} {:>9} {:>11}"
        rows = (form.format(*each) for each in (_HEADS, *self._rows()))
        return "\n".join([self._title(), *rows, *self._below()])

    def _repr_html_(self) -> str:
        """Return the printed certificate as a table for a notebook."""
        return html_table(self._title(), _HEADS, self._rows(), self._below(), left=1)

    def _title(self) -> str:
        verdict = "globally optimal" if self.is_globally_optimal else "not proved optimal"
        verdict = "no plan, since it jumps to measured states" if self.jumps else verdict
        verdict = verdict if self.holds else "violates its constraints"
        verdict += " (time was up)" if self.cut and not self.is_globally_optimal else ""
        return (
            f"{self.scenario.name}: {verdict}; cost {self.cost:.6f} m²/s⁴, "
            f"lower bound {self.lower_bound:.6f}; gap {_in_percent(self.gap)}"
            f"{self._planned_gap()}{self._searched()}{self._left_out()}"
        )

    def _searched(self) -> str:
        count = f"{self.nodes} branches" if self.nodes > 1 else "one branch"
        branches = f" after {count}" if self.nodes > 0 else ""
        if self.better is None:
            return branches
        less = percent(1.0 - self.better / self.cost)
        return f"{branches}; a plan that costs {less} less was found (`plan_global` returns it)"

    def _rows(self) -> list[tuple[str, ...]]:
        """Return the cells of each vehicle; of many vehicles, of those with the largest gaps."""
        shown = self.vehicles
        if len(shown) > _MAX_ROWS:
            shown = tuple(sorted(shown, key=lambda each: each.lower_bound - each.cost)[:_MAX_ROWS])
        return [
            (
                each.vehicle,
                f"{each.cost:.6f}",
                f"{each.lower_bound:.6f}",
                _in_percent(each.gap),
                f"{each.least_eigenvalue:.4f}",
            )
            for each in shown
        ]

    def _below(self) -> list[str]:
        more = len(self.vehicles) - _MAX_ROWS
        return [*([f"… and {more} more, with smaller gaps"] if more > 0 else []), *_COLUMNS]


def _in_percent(gap: float) -> str:
    """Return a gap in per cent; one that is within the precision of plans as an upper bound."""
    if abs(gap) <= GLOBAL_GAP:
        return f"≤ {percent(GLOBAL_GAP)}"
    return f"{'-' if gap < 0.0 else ''}{percent(gap)}"


def _gap(cost: float, lower_bound: float) -> float:
    largest = max(cost, lower_bound)
    return (cost - lower_bound) / (cost or largest) if largest > 0.0 else 0.0
