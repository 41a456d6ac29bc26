"""Keep in a box: (4) to (7), a row for each side that a motion is beyond."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.extremes import turning_points
from drake_rho.planning.constraints.base import AT_ONCE, VIOLATED, Constraint, HalfSpaces
from drake_rho.planning.constraints.margins import Margins, PlanMargins
from drake_rho.planning.constraints.stretches import near
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.fleet import Bounds
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario

QUANTITIES: tuple[Quantity, ...] = ("position", "velocity", "acceleration", "jerk")
"""Quantities that can be kept in a box."""

_SIDES = np.concatenate([np.eye(3), -np.eye(3)])
"""Normals of a box's sides, pointing inwards: the lower ones, then the upper ones."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepInBox(Constraint):
    """The box of a quantity of every vehicle."""

    bounds: Bounds
    """the boxes"""
    times: FloatArray
    """knots at which it is asked [s], shape (T,)"""
    first: int
    """which of the quantity's values is that of the first of `times`"""
    margins: Margins
    """how far inside of the boxes values stay"""

    def violated_rows(
        self, motion: Motion, vehicles: IntArray, *, between: bool = False, reach: int = 0
    ) -> HalfSpaces:
        """Return rows of violated sides: at the knots, or where a coordinate turns round."""
        motion = motion.subdivided(self.pieces)
        if between:
            return self._violated_between(motion, vehicles)
        values = motion.values(self.quantity)[:, self.first : self.first + len(self.times)]
        (least, most), before = self._extremes, motion.before
        if len(vehicles) < len(values):
            values, before = values[vehicles], before[vehicles]
            least, most = least[vehicles], most[vehicles]
        if self.margins.tube is not None:
            inside = self._margins[:, None]
            least, most = least + inside, most - inside
        low, high = values < least, values > most
        if not (low | high).any():
            return self.none
        broken = np.concatenate([low, high], axis=2)
        if self.quantity == "jerk":  # the first acceleration may be free of a jerk limit
            broken[np.isnan(before[:, 0]), 0] = False
        broken = np.moveaxis(broken, 2, 1)
        if reach > 0:
            runs = np.repeat(np.arange(6 * len(vehicles)), len(self.times))
            broken = near(broken.reshape(-1), runs, reach).reshape(broken.shape)
            broken &= self._asked(before)
        which, sides, knots = np.nonzero(broken)
        return self.rows(vehicles[which], sides, self.times[knots])

    @cached_property
    def _extremes(self) -> tuple[FloatArray, FloatArray]:
        """The least and the greatest values that break nothing without margins, (N, 1, 3) each."""
        room = VIOLATED * self.bounds.tolerances
        return (self.bounds.lower - room)[:, None], (self.bounds.upper + room)[:, None]

    @cached_property
    def _margins(self) -> FloatArray:
        """At the knots at which it is asked, shape (T,)."""
        knots = self.margins.knots[self.quantity]
        return knots[self.first : self.first + len(self.times)]

    def _asked(self, before: FloatArray) -> BoolArray:
        """At which knots it is asked, shape (P, 1, T): of a jerk perhaps not at the first."""
        asked = np.ones((len(before), 1, len(self.times)), dtype=bool)
        if self.quantity == "jerk":
            asked[np.isnan(before[:, 0]), :, 0] = False
        return asked

    def _violated_between(self, motion: Motion, vehicles: IntArray) -> HalfSpaces:
        times, positions = turning_points(motion.of(vehicles))
        room = VIOLATED * self.bounds.tolerances[vehicles]
        inside = self.margins.steps[self.quantity][:, None]
        below = positions < (self.bounds.lower[vehicles] - room)[:, None] + inside
        above = positions > (self.bounds.upper[vehicles] + room)[:, None] - inside
        beyond = np.concatenate([below, above], axis=2)
        at_once = times <= AT_ONCE * motion.step
        beyond &= ~np.concatenate([at_once, at_once], axis=2)
        which, steps, sides = np.nonzero(beyond)
        order = np.lexsort((steps, sides, which))  # neighbours in time one after the other
        which, steps, sides = which[order], steps[order], sides[order]
        return self.rows(vehicles[which], sides, times[which, steps, sides % 3])

    def rows(self, vehicles: IntArray, sides: IntArray, times: FloatArray) -> HalfSpaces:
        """Return rows of given sides, vehicles and times, three arrays of shape (R,)."""
        axes = sides % 3
        lower, upper = self.bounds.lower[vehicles, axes], self.bounds.upper[vehicles, axes]
        bounds = np.where(sides < 3, lower, -upper) + self.margins.at(self.quantity, times)
        tolerances = self.bounds.tolerances[vehicles, axes]
        return HalfSpaces(self, vehicles, vehicles, sides, times, _SIDES[sides], bounds, tolerances)

    def detail(self, rows: HalfSpaces, names: Sequence[str]) -> str:
        """Return the axes, as in ' x/z'."""
        axes = np.any(rows.normals, axis=0)
        return " " + "/".join(axis for axis, taken in zip("xyz", axes, strict=True) if taken)


def boxes_of(scenario: Scenario, margins: PlanMargins) -> list[Constraint]:
    """Return the constraints of the vehicles' boxes.

    The first and the last knot are left out where the start and the goal decide. Between knots
    only positions can break theirs: velocity is linear there, acceleration and jerk are constant.
    """
    boxes = list[Constraint]()
    for quantity in QUANTITIES:
        bounds = scenario.fleet.bounds(quantity)
        if bounds is None:
            continue
        inner = quantity in ("position", "velocity")
        own, pieces = margins.of(quantity)
        times = own.grid.elapsed
        boxes.append(
            KeepInBox(
                kind=quantity,
                key=quantity,
                name=f"{quantity} box",
                quantity=quantity,
                bounds=bounds,
                times=times[1:-1] if inner else times[:-1],
                first=int(inner),
                margins=own,
                pieces=pieces,
                searches=sys.maxsize * (scenario.between_knots and quantity == "position"),
            )
        )
    return boxes
