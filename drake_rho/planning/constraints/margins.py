"""How far inside their limits plans keep, so that flights do wherever in the tube they are."""

from __future__ import annotations

import dataclasses
from functools import lru_cache

import numpy as np

from drake_rho.motion.dynamics import step_at
from drake_rho.motion.scenario_tube import tube_of
from drake_rho.motion.tube import ErrorTube
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import SAME_TIME, Grid, Quantity
from drake_rho.scenario.records import Scenario


@dataclasses.dataclass(frozen=True, eq=False)
class Margins:
    """A tube's radii as planners use them: constant over each step, at their greatest there.

    At a knot the greater one of the two steps that meet there counts: what holds on the closed
    steps holds at every instant. The feedback's radius is that of the step that begins there.

    Where that leaves no room, steps are those of a finer grid (`PlanMargins.inner`).
    """

    grid: Grid
    """of the plan, or a finer one"""
    steps: dict[Quantity, FloatArray]
    """in each step, in the quantity's unit, shape (K-1,) each"""
    knots: dict[Quantity, FloatArray]
    """at each knot, or in each step that begins there, in the quantity's unit"""
    tube: ErrorTube | None = None
    """whose radii they are; None where nothing disturbs"""

    def at(self, quantity: Quantity, times: FloatArray) -> FloatArray:
        """Return margins at times since the first knot [s], in the quantity's unit, any shape."""
        if self.tube is None:
            return np.zeros(times.shape)
        steps, knots = self.steps[quantity], self.knots[quantity]
        k = np.clip(step_at(times, self.grid.step), 0, len(knots) - 1)
        at_knot = np.abs(times - self.grid.step * k) <= SAME_TIME * self.grid.step
        return np.where(at_knot, knots[k], steps[np.minimum(k, len(steps) - 1)])

    def exactly(self, times: FloatArray) -> FloatArray:
        """Return the radius of the position at times since the first knot [s], in m, any shape."""
        if self.tube is None:
            return np.zeros(times.shape)
        return self.tube.position(self.grid.start + times)

    @property
    def most(self) -> float:
        """The greatest margin of the position [m]."""
        return float(self.steps["position"].max())


@dataclasses.dataclass(frozen=True, eq=False)
class PlanMargins:
    """Margins of all quantities of a scenario, on the grids on which they are constant."""

    steps: Margins
    """constant over each step of the plan"""
    inner: Margins
    """of positions and velocities: the same or, where these leave no plan, constant over pieces of
    each step"""
    pieces: int
    """equal pieces of a step over which `inner` is constant"""

    def of(self, quantity: Quantity) -> tuple[Margins, int]:
        """Return the margins of a quantity, and over how many pieces of a step."""
        inner = quantity in ("position", "velocity")
        return (self.inner, self.pieces) if inner else (self.steps, 1)


def margins_of(scenario: Scenario, pieces: int = 1) -> PlanMargins:
    """Return what plans of a scenario keep inside their limits; nothing where nothing disturbs.

    Args:
        scenario: to be planned.
        pieces: into how many pieces steps are cut for positions and velocities.
    """
    steps = _margins(scenario, 1)
    return PlanMargins(steps, steps if pieces == 1 else _margins(scenario, pieces), pieces)


def _margins(scenario: Scenario, pieces: int) -> Margins:
    grid = scenario.grid
    if scenario.disturbance is None:
        return _none(grid.step, grid.knots, grid.start)
    return _around(tube_of(scenario), grid.start, grid.knots, pieces, scenario.between_knots)


@lru_cache(maxsize=64)
def _none(step: float, knots: int, start: float) -> Margins:
    quantities: tuple[Quantity, ...] = ("position", "velocity", "acceleration", "jerk")
    steps = {each: np.zeros(knots - 1) for each in quantities}
    inner = {each: np.zeros(knots) for each in quantities[:2]}
    return Margins(Grid(step, knots, start), steps, steps | inner)


@lru_cache(maxsize=64)
def _around(tube: ErrorTube, start: float, count: int, pieces: int, between_knots: bool) -> Margins:
    step = tube.grid.step
    grid = Grid(step / pieces, pieces * (count - 1) + 1, start)
    first = round((start - tube.grid.start) / step)
    greatest = tube.over_steps(first, count - 1, pieces)
    steps: dict[Quantity, FloatArray] = {
        "position": greatest.position,
        "velocity": greatest.velocity,
        "acceleration": greatest.acceleration,
        "jerk": np.zeros(len(greatest.position)),
    }
    knots = dict(steps)
    knots["position"], knots["velocity"] = _greater(steps["position"]), _greater(steps["velocity"])
    if not between_knots:  # positions matter then only
        knots["position"] = greatest.ends
    return Margins(grid, steps, knots, tube)


def _greater(steps: FloatArray) -> FloatArray:
    """Return at each knot the greater value of the steps beside it."""
    greater: FloatArray = np.maximum(np.append(steps, 0.0), np.append(0.0, steps))
    return greater
