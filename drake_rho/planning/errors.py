"""Why there is no plan: plain data, which can be pickled and prints without solving anything."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from drake_rho.motion.statistics import Statistics
from drake_rho.scenario.errors import DrakeRhoError

if TYPE_CHECKING:
    from drake_rho.motion.plan import Plan
    from drake_rho.scenario.records import Scenario

Names = tuple[str, ...]

_NAMED = 4
"""Vehicles without room that a message names one by one."""


class InfeasibleError(DrakeRhoError):
    """The constraints cannot be met together, obstacles and pairs as they were linearised.

    Where no obstacle and no other vehicle takes part in the conflict this is proved of the scenario
    itself. Where one does, it is proved of its linearisation (15): another reference may have a
    plan. `drake_rho.infeasible_subset` narrows the conflicts down, `drake_rho.diagnose` says what
    would mend the scenario.

    Attributes:
        conflicts: for each vehicle without a plan, by name, constraints that cannot be met
            together, as the solver's proof weighs them; there may be fewer that cannot.
        obstacles: for each of these vehicles, numbers of the obstacles that its path came up
            against; 0 stands for other vehicles that it has to keep apart from.
        steps_tried: steps h for which no plan was found [s], in the order tried.
        scenario: what was asked; None where it is not known.
        reference: the motion around which obstacles and pairs were linearised; None without it.
        statistics: what it took to find out.
        bearable: where starts, goals and limits leave no room for the disturbance, the largest wind
            [m/s²] that they do leave room for with the same feedback, all else as it is; 0 where
            errors of the estimate are too much already. None where that is not why.
    """

    def __init__(
        self,
        conflicts: Mapping[str, Names],
        steps_tried: tuple[float, ...] = (),
        statistics: Statistics | None = None,
        scenario: Scenario | None = None,
        obstacles: Mapping[str, frozenset[int]] | None = None,
        reference: Plan | None = None,
        bearable: float | None = None,
    ) -> None:
        self.conflicts = dict(conflicts)
        self.obstacles = dict(obstacles or {})
        self.steps_tried = steps_tried
        self.statistics = statistics or Statistics()
        self.scenario = scenario
        self.reference = reference
        self.bearable = bearable
        super().__init__(
            self.conflicts,
            steps_tried,
            self.statistics,
            scenario,
            self.obstacles,
            reference,
            bearable,
        )

    @property
    def about_linearisation(self) -> bool:
        """Whether something is in the way of every vehicle, so that another reference may help."""
        return all(self.obstacles.get(vehicle) for vehicle in self.conflicts)

    def __str__(self) -> str:
        reasons = "; ".join(
            f"{vehicle} cannot meet together: {', '.join(constraints)}"
            for vehicle, constraints in self.conflicts.items()
        )
        steps = ", ".join(f"{step:g} s" for step in self.steps_tried)
        tried = f" (steps tried: {steps})" if steps else ""
        if self.bearable is not None:
            told = [f"{name}: {', '.join(why)}" for name, why in self.conflicts.items()]
            if len(told) > _NAMED:
                told[_NAMED:] = [f"and {len(told) - _NAMED} vehicles more"]
            return (
                f"no plan{tried}: no room for the errors that the disturbance leads to: "
                f"{'; '.join(told)} (room for {self.bearable:.3g} m/s² with this feedback)"
            )
        if not self.about_linearisation:
            return f"no plan{tried}: {reasons}"
        pairs = any(0 in numbers for numbers in self.obstacles.values())
        what = "obstacles and pairs" if pairs else "obstacles"
        searched = f"{self.statistics.searched}; " if self.statistics.searched else ""
        return (
            f"no plan{tried} with the {what} linearised around this reference: {reasons} "
            f"({searched}another reference or a finer step may have a plan)"
        )


class SolverError(DrakeRhoError):
    """The solvers gave neither a solution nor a proof that there is none.

    Attributes:
        statistics: what it took to find out, as far as it was counted.
    """

    def __init__(self, message: str, statistics: Statistics | None = None) -> None:
        self.statistics = statistics or Statistics()
        super().__init__(message, self.statistics)

    def __str__(self) -> str:
        return str(self.args[0])


class NotInstalledError(DrakeRhoError, ImportError):
    """What was asked for needs a package that is not installed."""
