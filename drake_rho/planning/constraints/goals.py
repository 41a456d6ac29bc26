"""The goal (3) as rows, for problems in which it may be missed.

Elsewhere it is kept exactly, by the space in which programs are written.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import VIOLATED, Constraint, HalfSpaces
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.shapes.base import TOLERANCE


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class ReachGoal(Constraint):
    """One axis of the position or the velocity at the last knot is that of the goal."""

    axis: int
    """0, 1 or 2"""
    time: float
    """T [s]"""
    wanted: FloatArray
    """of all vehicles, in the quantity's unit, shape (N, 3)"""
    tolerances: FloatArray
    """how much may be missed, in the quantity's unit, shape (N,)"""

    def violated_rows(
        self, motion: Motion, vehicles: IntArray, *, between: bool = False, reach: int = 0
    ) -> HalfSpaces:
        """Return a row for each vehicle that misses its goal: at least, or at most, the goal."""
        missed = (motion.values(self.quantity)[vehicles, -1] - self.wanted[vehicles])[:, self.axis]
        broken = np.abs(missed) > VIOLATED * self.tolerances[vehicles]
        own, above = vehicles[broken], missed[broken] > 0.0
        normals = np.zeros((len(own), 3))
        normals[:, self.axis] = np.where(above, -1.0, 1.0)
        return HalfSpaces(
            self,
            vehicles=own,
            partners=own,
            sides=above.astype(int),
            times=np.full(len(own), self.time),
            normals=normals,
            bounds=normals[:, self.axis] * self.wanted[own, self.axis],
            tolerances=self.tolerances[own],
        )

    def describe(self, rows: HalfSpaces, names: object, start: float) -> str:
        """Return the name alone: goals are reached at the end."""
        return self.name


def goals_of(scenario: Scenario) -> list[Constraint]:
    """Return position and velocity of every axis of the goals."""
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
            wanted=wanted,
            tolerances=TOLERANCE * fleet.scale(quantity),
        )
        for axis in range(3)
        for quantity, wanted in states
    ]
