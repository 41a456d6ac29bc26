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
    """No plan was found: constraints cannot be met together, as they were tried.

    Where nothing disturbs, and no obstacle and no other vehicle takes part in the conflict, this is
    proved of the scenario itself (`is_proved`). Where one does, it is proved of its linearisation
    (15): another reference may have a plan. With a disturbance it is proved of the margins that
    planners keep for it, which are a little larger than the errors. `drake_rho.infeasible_subset`
    narrows the conflicts down, `drake_rho.diagnose` says what would mend the scenario.

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
        because: how conflicts are told that no solver has proved, as in 'no room'; else empty.
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

    def after(self, steps_tried: tuple[float, ...], statistics: Statistics) -> InfeasibleError:
        """Return this error with the steps that were tried [s], and with what all of them took."""
        return InfeasibleError(
            self.conflicts,
            steps_tried,
            statistics,
            self.scenario,
            self.obstacles,
            self.reference,
            self.bearable,
            self.because,
        )

    @property
    def is_proved(self) -> bool:
        """Whether the scenario has no plan, whatever is tried."""
        return bool(self.conflicts) and not (self.premise or self.because)

    @property
    def about_linearisation(self) -> bool:
        """Whether something is in the way of every vehicle, so that another reference may help."""
        return all(self.obstacles.get(vehicle) for vehicle in self.conflicts)

    def __str__(self) -> str:
        steps = ", ".join(f"{step:g} s" for step in self.steps_tried)
        none = f"no plan (steps tried: {steps})" if steps else "no plan"
        if self.because:
            told = [f"{name}: {', '.join(why)}" for name, why in self.conflicts.items()]
            if len(told) > _NAMED:
                told[_NAMED:] = [f"and {len(told) - _NAMED} vehicles more"]
            what = f"{none}: {self.because}: {'; '.join(told)}"
            if self.bearable is None:
                return what
            return f"{what} (room for {self.bearable:.3g} m/s² with this feedback)"
        reasons = "; ".join(
            f"{vehicle} cannot meet together: {', '.join(constraints)}"
            for vehicle, constraints in self.conflicts.items()
        )
        if premise := self.premise:
            none = f"{none} {premise}"
        if not self.about_linearisation:
            return f"{none}: {reasons}"
        searched = f"{self.statistics.searched}; " if self.statistics.searched else ""
        return f"{none}: {reasons} ({searched}another reference or a finer step may have a plan)"

    @property
    def premise(self) -> str:
        """What the proof that there is no plan is about, if not the scenario itself; else empty."""
        what = []
        if self.about_linearisation:
            pairs = any(0 in numbers for numbers in self.obstacles.values())
            obstacles = "the obstacles and pairs" if pairs else "the obstacles"
            what.append(f"{obstacles} linearised around this reference")
        if self.scenario is not None and self.scenario.disturbance is not None:
            what.append("the margins that are kept for the disturbance")
        return f"with {' and '.join(what)}" if what else ""


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


class OutOfTimeError(DrakeRhoError):
    """Time was up, by a time limit or by Ctrl-C, before there was anything to return.

    Attributes:
        doing: the last words on what was being done; empty where nothing was told.
        time_limit: the limit [s]; None where Ctrl-C came before it, or there was none.
        statistics: what it took; of what was under way only the time is known.
    """

    def __init__(
        self, doing: str = "", time_limit: float | None = None, statistics: Statistics | None = None
    ) -> None:
        self.doing, self.time_limit = doing, time_limit
        self.statistics = statistics or Statistics()
        super().__init__(doing, time_limit, self.statistics)

    def while_doing(self, words: str, time_limit: float | None) -> OutOfTimeError:
        """Return this error with what was being done and the limit, unless these are told."""
        limit = time_limit if self.time_limit is None else self.time_limit
        return OutOfTimeError(self.doing or words, limit, self.statistics)

    def __str__(self) -> str:
        limit = self.time_limit
        ended = "stopped" if limit is None else f"the time limit of {limit:g} s was over"
        doing = f"; the last that was done: {self.doing}" if self.doing else ""
        return f"{ended} before there was an answer{doing}"


class NotInstalledError(DrakeRhoError, ImportError):
    """What was asked for needs a package that is not installed."""
