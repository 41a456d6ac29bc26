"""Box constraints (4) to (7): one row for each side of a box that a motion exceeds."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.extremes import turning_points
from drake_rho.planning.constraints.base import (
    VIOLATED,
    Constraint,
    GivenEnd,
    HalfSpaces,
    constrained_knots,
    with_neighbours,
)
from drake_rho.planning.constraints.margins import Margins, PlanMargins, jerk_factor
from drake_rho.scenario.bounds import Bounds
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import END_MARGIN

QUANTITIES: tuple[Quantity, ...] = ("position", "velocity", "acceleration", "jerk")
"""Quantities that a box can limit."""

_SIDES = np.concatenate([np.eye(3), -np.eye(3)])
"""Inward normals of a box's sides: the three lower sides, then the three upper sides."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepInBox(Constraint):
    """Box constraint on one quantity of every vehicle."""

    bounds: Bounds
    """boxes of all vehicles"""
    times: FloatArray
    """times of the constrained knots since the first knot [s], shape (T,)"""
    first: int
    """index of the first of `times` among the quantity's values"""
    margins: Margins
    """required distances of values from the sides of their boxes"""

    def violated_rows(
        self, motion: Motion, vehicles: IntArray, *, between: bool = False, neighbours: int = 0
    ) -> HalfSpaces:
        """Return rows of violated sides at the knots, or at extrema of a coordinate."""
        if self.margins.pieces > 1:
            motion = motion.subdivided(self.margins.pieces)
        if between:
            return self._violated_between(motion, vehicles)
        values = motion.values(self.quantity)[:, self.first : self.first + len(self.times)]
        least, most = self._extremes
        if len(vehicles) < len(values):
            values, least, most = values[vehicles], least[vehicles], most[vehicles]
        if self.margins.tube is not None:
            inside = self._margins[:, None]
            least, most = least + inside, most - inside
        low, high = values < least, values > most  # neither where a jerk is unknown
        if not (low | high).any():
            return self.none
        violated = np.moveaxis(np.concatenate([low, high], axis=2), 2, 1)
        if neighbours > 0:
            runs = np.repeat(np.arange(6 * len(vehicles)), len(self.times))
            selected = with_neighbours(violated.reshape(-1), runs, neighbours)
            violated = selected.reshape(violated.shape) & ~np.isnan(values[:, None, :, 0])
        which, sides, knots = np.nonzero(violated)
        return self.rows(vehicles[which], sides, self.times[knots])

    @cached_property
    def _extremes(self) -> tuple[FloatArray, FloatArray]:
        """Least and greatest values that satisfy the boxes without margins, (N, 1, 3) each."""
        tolerances = VIOLATED * self.bounds.tolerances
        return (self.bounds.lower - tolerances)[:, None], (self.bounds.upper + tolerances)[:, None]

    @cached_property
    def _margins(self) -> FloatArray:
        """Margins at the constrained knots, shape (T,)."""
        knots = self.margins.knots[self.quantity]
        return knots[self.first : self.first + len(self.times)]

    def _violated_between(self, motion: Motion, vehicles: IntArray) -> HalfSpaces:
        times, positions = turning_points(motion.of(vehicles))
        tolerances = VIOLATED * self.bounds.tolerances[vehicles]
        inside = self.margins.steps[self.quantity][:, None]
        below = positions < (self.bounds.lower[vehicles] - tolerances)[:, None] + inside
        above = positions > (self.bounds.upper[vehicles] + tolerances)[:, None] - inside
        beyond = np.concatenate([below, above], axis=2)
        at_start = times <= END_MARGIN * motion.step
        beyond &= ~np.concatenate([at_start, at_start], axis=2)
        which, steps, sides = np.nonzero(beyond)
        order = np.lexsort((steps, sides, which))  # successive instants of a side are adjacent
        which, steps, sides = which[order], steps[order], sides[order]
        return self.rows(vehicles[which], sides, times[which, steps, sides % 3])

    def rows(self, vehicles: IntArray, sides: IntArray, times: FloatArray) -> HalfSpaces:
        """Return the rows of sides of vehicles' boxes at times, three arrays of shape (R,)."""
        axes = sides % 3
        lower, upper = self.bounds.lower[vehicles, axes], self.bounds.upper[vehicles, axes]
        bounds = np.where(sides < 3, lower, -upper) + self.margins.at(self.quantity, times)
        tolerances = self.bounds.tolerances[vehicles, axes]
        normals = _SIDES[sides]
        rows = HalfSpaces(self, vehicles, vehicles, sides, times, normals, bounds, tolerances)
        return rows if self.given_end is None else self.given_end.without(rows)

    def every_row(self, motion: Motion) -> HalfSpaces:
        """Return the rows of all bounded sides at all constrained knots.

        Args:
            motion: the motion of all vehicles; where its jerks are unknown, they are free.
        """
        count, knots = len(motion.before), len(self.times)
        vehicles, rest = np.divmod(np.arange(6 * count * knots), 6 * knots)
        sides, k = np.divmod(rest, knots)
        if self.quantity == "jerk":
            known = ~np.isnan(motion.jerks()[vehicles, k, 0])
            vehicles, sides, k = vehicles[known], sides[known], k[known]
        rows = self.rows(vehicles, sides, self.times[k])
        return rows.select(np.isfinite(rows.bounds))

    def detail(self, rows: HalfSpaces, names: Sequence[str]) -> str:
        """Return the axes of the rows, as in ' x/z'."""
        axes = np.any(rows.normals, axis=0)
        return " " + "/".join(axis for axis, taken in zip("xyz", axes, strict=True) if taken)


def boxes_of(scenario: Scenario, margins: PlanMargins) -> list[KeepInBox]:
    """Return the box constraints of all vehicles.

    Positions and velocities are not constrained at the first and the last knot, where start and
    goal fix them. Between knots only positions can violate a box: velocities are linear there,
    accelerations are constant, and jerks are their changes at the knots. Those of averages follow
    from these (`jerk_factor`).
    """
    boxes = list[KeepInBox]()
    for quantity in QUANTITIES:
        bounds = scenario.fleet.bounds(quantity)
        if bounds is None:
            continue
        inner, open_end = quantity in ("position", "velocity"), scenario.fleet.open_end
        own = margins.of(quantity)
        if quantity == "jerk":
            bounds = bounds.scaled(jerk_factor(scenario))
        boxes.append(
            KeepInBox(
                kind=quantity,
                key=quantity,
                name=f"{quantity} box",
                quantity=quantity,
                bounds=bounds,
                times=own.grid.elapsed[constrained_knots(quantity, open_end=open_end)],
                open_end=open_end,
                given_end=GivenEnd.of(scenario, quantity) if open_end else None,
                first=int(inner),
                margins=own,
                searches=sys.maxsize * (scenario.between_knots and quantity == "position"),
            )
        )
    return boxes
