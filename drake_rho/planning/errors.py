"""Why there is no plan."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from drake_rho.motion.plan import Statistics
from drake_rho.scenario.errors import DrakeRhoError
from drake_rho.scenario.records import Scenario

_diagnose: list[Callable[[Scenario], Any]] = []


def diagnosed_by(diagnose: Callable[[Scenario], Any]) -> None:
    """Tell errors how to make their diagnosis: it stands on this room and cannot be imported."""
    _diagnose[:] = [diagnose]


Names = tuple[str, ...]


class Conflicts(Mapping[str, Names]):
    """Vehicles without a plan, and for each the constraints that cannot be met together.

    To narrow these down takes many small programs, so it is done when they are first looked at.
    """

    def __init__(self, finders: Mapping[str, Callable[[], Names]]) -> None:
        self._finders = dict(finders)
        self._found: dict[str, Names] = {}

    def __getitem__(self, vehicle: str) -> Names:
        if vehicle not in self._found:
            self._found[vehicle] = self._finders[vehicle]()
        return self._found[vehicle]

    def __iter__(self) -> Iterator[str]:
        return iter(self._finders)

    def __len__(self) -> int:
        return len(self._finders)

    def __repr__(self) -> str:
        return repr(dict(self))


class InfeasibleError(DrakeRhoError):
    """The constraints cannot be met together, obstacles as they were linearised.

    Where no obstacle takes part in the conflict this is proved of the scenario itself. Where one
    does, it is proved of its linearisation (15): another reference may have a plan.

    Attributes:
        conflicts: for each vehicle without a plan, by name, constraints that cannot be met
            together; those left out have no part in the contradiction.
        obstacles: for each of these vehicles, the names of obstacles that its path came up against,
            and "separation" for other vehicles.
        steps_tried: steps h for which no plan was found [s], in the order tried.
        scenario: what was asked; None where it is not known.
        statistics: what it took to find out.
    """

    def __init__(
        self,
        conflicts: Mapping[str, Names],
        steps_tried: tuple[float, ...] = (),
        statistics: Statistics | None = None,
        scenario: Scenario | None = None,
        obstacles: Mapping[str, frozenset[str]] | None = None,
    ) -> None:
        self.conflicts = conflicts
        self.obstacles = obstacles or {}
        self.steps_tried = steps_tried
        self.statistics = statistics or Statistics()
        self.scenario = scenario
        super().__init__(conflicts, steps_tried, self.statistics, scenario, obstacles)

    @property
    def diagnosis(self) -> Any:
        """What `drake_rho.diagnose` says of the scenario; found when it is asked for.

        It takes many programs, so an error that is caught and dealt with does not pay for it.
        """
        if self.scenario is None or not _diagnose:
            return None
        return _diagnose[0](self.scenario)

    @property
    def about_linearisation(self) -> bool:
        """Whether obstacles are in the way of every vehicle, so that another reference may help."""
        return all(self.obstacles.get(vehicle) for vehicle in self.conflicts)

    def __str__(self) -> str:
        reasons = "; ".join(
            f"{vehicle} cannot meet together: {', '.join(constraints)}"
            for vehicle, constraints in self.conflicts.items()
        )
        steps = ", ".join(f"{step:g} s" for step in self.steps_tried)
        tried = f" (steps tried: {steps})" if steps else ""
        if not self.about_linearisation:
            return f"no plan{tried}: {reasons}"
        touched = frozenset[str]().union(*self.obstacles.values())
        what = "obstacles and pairs" if "separation" in touched else "obstacles"
        return (
            f"no plan{tried} with the {what} linearised around this reference: {reasons} "
            "(another reference or a finer step may have a plan)"
        )


class SolverError(DrakeRhoError):
    """The solvers gave neither a solution nor a proof that there is none."""
