"""Errors of planners: plain data, which can be pickled and printed without solving anything."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Self

from drake_rho.motion.statistics import Statistics
from drake_rho.scenario.errors import DrakeRhoError

if TYPE_CHECKING:
    from drake_rho.motion.plan import Plan
    from drake_rho.scenario.records import Scenario

Names = tuple[str, ...]

_NAMED = 4
"""Largest number of vehicles whose conflicts a message lists individually."""


class PlanningError(DrakeRhoError):
    """Error of a planner, with the statistics of its attempts."""

    statistics: Statistics

    def replaced(self, **changes: Any) -> Self:
        """Return this error with other attributes, as if it had been raised with them."""
        return type(self)(**(vars(self) | changes)).with_traceback(self.__traceback__)


class InfeasibleError(PlanningError):
    """Infeasibility: no plan was found, since constraints contradict each other.

    If the scenario has no disturbance, and no conflict includes obstacles or other vehicles, the
    scenario itself is proved infeasible (`is_proved`). Otherwise the proof is of the linearisation
    (15): there may be a plan around another reference. With a disturbance the proof is for the
    planners' constraint tightening, which is slightly larger than the errors, and with a smoothing
    for its margin. Where a planner chose the times of waypoints, nothing is proved.
    `drake_rho.infeasible_subset` reduces the conflicts, and `drake_rho.diagnose` computes changes
    that would make the scenario feasible.

    Attributes:
        conflicts: for each vehicle without a plan, by name, constraints that cannot be met
            together: those with a weight in the solver's proof. A subset of them may suffice.
        obstacles: for each of these vehicles, numbers of the obstacles in its conflict; 0 stands
            for the separation from other vehicles.
        steps_tried: steps h for which no plan was found [s], in the order tried.
        scenario: scenario to plan; None if it is not known.
        reference: motion around which obstacles and pairs were linearised; None without one.
        statistics: statistics of the attempts.
        bearable: largest wind [m/s²] that starts, goals and limits tolerate with the same feedback,
            all else unchanged, if they do not tolerate the disturbance; 0 if the errors of the
            estimate alone are too large. None if the error has another reason.
        because: reason of conflicts that no solver has proved; otherwise empty.
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
        because: str = "",
    ) -> None:
        self.conflicts = dict(conflicts)
        self.obstacles = dict(obstacles or {})
        self.steps_tried = steps_tried
        self.statistics = statistics or Statistics()
        self.scenario = scenario
        self.reference = reference
        self.bearable = bearable
        self.because = because
        super().__init__(
            self.conflicts,
            steps_tried,
            self.statistics,
            scenario,
            self.obstacles,
            reference,
            bearable,
            because,
        )

    @property
    def is_proved(self) -> bool:
        """True if the scenario is proved to have no plan."""
        return bool(self.conflicts) and not (self.premise or self.because)

    @property
    def about_linearisation(self) -> bool:
        """True if obstacles or pairs are in every conflict, so that another reference may help."""
        return all(self.obstacles.get(vehicle) for vehicle in self.conflicts)

    def __str__(self) -> str:
        steps = ", ".join(f"{step:g} s" for step in self.steps_tried)
        none = f"no plan (steps tried: {steps})" if steps else "no plan"
        if self.because:
            listed = [f"{name}: {', '.join(why)}" for name, why in self.conflicts.items()]
            if len(listed) > _NAMED:
                listed[_NAMED:] = [f"and {len(listed) - _NAMED} more vehicles"]
            what = f"{none}: {self.because}: {'; '.join(listed)}"
            if self.bearable is None:
                return what
            return f"{what} (largest tolerable wind {self.bearable:.3g} m/s² with this feedback)"
        reasons = "; ".join(
            f"{vehicle} cannot meet together: {', '.join(constraints)}"
            for vehicle, constraints in self.conflicts.items()
        )
        if premise := self.premise:
            none = f"{none} {premise}"
        if not self.about_linearisation:
            return f"{none}: {reasons}"
        searched = f"{self.statistics.searched}; " if self.statistics.searched else ""
        return f"{none}: {reasons} ({searched}another reference or a finer step may lead to a plan)"

    @property
    def premise(self) -> str:
        """Assumptions of the proof that there is no plan; empty if it needs none."""
        what = []
        if self.about_linearisation:
            pairs = any(0 in numbers for numbers in self.obstacles.values())
            obstacles = "the obstacles and pairs" if pairs else "the obstacles"
            what.append(f"{obstacles} linearised around this reference")
        if self.scenario is not None and self.scenario.disturbance is not None:
            what.append("the constraints tightened for the disturbance")
        if self.scenario is not None and self.scenario.smoothing is not None:
            what.append("the margin that is kept for the smoothing")
        return f"with {' and '.join(what)}" if what else ""


class SolverError(PlanningError):
    """Numerical failure: the solvers found neither a solution nor a proof of infeasibility.

    Of a program that its user has changed (`drake_rho.program`): the solver found no solution.

    Attributes:
        message: description of the failure.
        statistics: statistics of the attempts, as far as they were counted.
    """

    def __init__(self, message: str, statistics: Statistics | None = None) -> None:
        self.message = message
        self.statistics = statistics or Statistics()
        super().__init__(message, self.statistics)

    def __str__(self) -> str:
        return self.message


class OutOfTimeError(PlanningError):
    """Expiry of a time limit, or Ctrl-C, before there was a result.

    Attributes:
        doing: last progress text; empty if there was none.
        time_limit: time limit [s]; None if Ctrl-C came before it or there was none.
        statistics: statistics of the attempts; only the time of the unfinished one is counted.
    """

    def __init__(
        self, doing: str = "", time_limit: float | None = None, statistics: Statistics | None = None
    ) -> None:
        self.doing, self.time_limit = doing, time_limit
        self.statistics = statistics or Statistics()
        super().__init__(doing, time_limit, self.statistics)

    def while_doing(self, words: str, time_limit: float | None) -> OutOfTimeError:
        """Return this error with a progress text and a time limit where it has none of its own."""
        limit = time_limit if self.time_limit is None else self.time_limit
        return self.replaced(doing=self.doing or words, time_limit=limit)

    def __str__(self) -> str:
        limit = self.time_limit
        ended = "stopped" if limit is None else f"the time limit of {limit:g} s was over"
        doing = f"; last activity: {self.doing}" if self.doing else ""
        return f"{ended} before there was an answer{doing}"


class NotInstalledError(DrakeRhoError, ImportError):
    """Missing package that a request needs."""
