"""Why there is no plan."""

from __future__ import annotations

from drake_rho.scenario.errors import DrakeRhoError


class InfeasibleError(DrakeRhoError):
    """No plan can meet all constraints.

    Attributes:
        conflicts: for each vehicle without a plan, by name, the constraints that cannot be met
            together.
        steps_tried: steps h for which no plan was found [s], in the order tried.
    """

    def __init__(
        self, conflicts: dict[str, tuple[str, ...]], steps_tried: tuple[float, ...] = ()
    ) -> None:
        self.conflicts = conflicts
        self.steps_tried = steps_tried
        super().__init__(conflicts, steps_tried)

    def __str__(self) -> str:
        reasons = "; ".join(
            f"{vehicle} cannot meet together: {', '.join(constraints)}"
            for vehicle, constraints in self.conflicts.items()
        )
        steps = ", ".join(f"{step:g} s" for step in self.steps_tried)
        return f"no plan (steps tried: {steps}): {reasons}" if steps else f"no plan: {reasons}"


class SolverError(DrakeRhoError):
    """The solvers gave neither a solution nor a proof that there is none."""
