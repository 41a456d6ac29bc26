"""Goal constraints (3) as rows, for problems in which goals may be missed.

In all other problems goals hold exactly, because programs only contain motions that reach them.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import VIOLATED, Constraint, HalfSpaces
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.shapes.base import TOLERANCE


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class ReachGoal(Constraint):
    """Goal constraint on one axis of the position or the velocity at the last knot."""

    axis: int
    """index of the axis, 0, 1 or 2"""
    time: float
    """time T of the last knot since the first knot [s]"""
    goals: FloatArray
    """goals of all vehicles, in the quantity's unit, shape (N, 3)"""
    required: BoolArray
    """mask of the vehicles that have to reach it, shape (N,)"""
    tolerances: FloatArray
    """largest deviations that count as reached, in the quantity's unit, shape (N,)"""

    def violated_rows(
        self, motion: Motion, vehicles: IntArray, *, between: bool = False, neighbours: int = 0
    ) -> HalfSpaces:
        """Return one row, a lower or an upper bound, for each vehicle that misses its goal."""
        missed = (motion.values(self.quantity)[vehicles, -1] - self.goals[vehicles])[:, self.axis]
        violated = self.required[vehicles]
        violated &= np.abs(missed) > VIOLATED * self.tolerances[vehicles]
        own, above = vehicles[violated], missed[violated] > 0.0
        normals = np.zeros((len(own), 3))
        normals[:, self.axis] = np.where(above, -1.0, 1.0)
        return HalfSpaces(
            self,
            vehicles=own,
            partners=own,
            sides=above.astype(int),
            times=np.full(len(own), self.time),
            normals=normals,
            bounds=normals[:, self.axis] * self.goals[own, self.axis],
            tolerances=self.tolerances[own],
        )

    def describe(self, rows: HalfSpaces, names: object, start: float) -> str:
        """Return the name without times: goals apply at the end only."""
        return self.name


def goals_of(scenario: Scenario) -> list[Constraint]:
    """Return the goal constraints of position and velocity on every axis."""
    fleet = scenario.fleet
    states: tuple[tuple[Literal["position", "velocity"], FloatArray], ...] = (
        ("position", fleet.goal_positions),
        ("velocity", fleet.goal_velocities),
    )
    return [
        ReachGoal(
            kind="goals",
            key=("goal", axis, quantity),
            name=f"goal {'xyz'[axis]}",
            quantity=quantity,
            axis=axis,
            time=scenario.grid.duration,
            goals=goals,
            required=fleet.fixed(quantity),
            tolerances=TOLERANCE * fleet.scale(quantity),
        )
        for axis in range(3)
        for quantity, goals in states
    ]
