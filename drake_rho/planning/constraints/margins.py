"""Constraint tightening margins, for error tubes and for smooth motions.

Averages of a plan are in every convex set that contains the plan, so that a smoothing needs a
margin only for sets to keep out of (`scenario/smoothing.py`).
"""

from __future__ import annotations

import dataclasses
from functools import cached_property, lru_cache

import numpy as np

from drake_rho.motion.dynamics import step_at
from drake_rho.motion.scenario_tube import tube_of
from drake_rho.motion.tube import ErrorTube
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import Grid, Quantity
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import Clock

_AT_KNOTS: tuple[Quantity, ...] = ("position", "velocity", "jerk")
"""Quantities with a value at every knot."""


UNBOUNDED = np.float64(np.inf)
"""Accelerations that only limits bound [m/s²]."""


@dataclasses.dataclass(frozen=True, eq=False)
class Margins:
    """Radii of an error tube for planning, constant over each step: the largest radius in it.

    At a knot the margin is the larger one of the two adjacent steps, since limits that hold on all
    closed steps hold at every instant. The radius of the feedback at a knot is that of the step
    that begins there.

    If the slack is too small with these margins, a finer grid is used (`PlanMargins.inner`).
    """

    grid: Grid
    """grid of the plan, or a finer one"""
    steps: dict[Quantity, FloatArray]
    """margins in each step, in the quantity's unit, shape (K-1,) each"""
    knots: dict[Quantity, FloatArray]
    """margins at each knot, (K,), of accelerations in the step that begins there, (K-1,)"""
    tube: ErrorTube | None = None
    """error tube with these radii; None without a disturbance"""
    pieces: int = 1
    """number of equal pieces of each step of the plan (`Motion.subdivided`) that `grid` has"""

    def at(self, quantity: Quantity, times: FloatArray) -> FloatArray:
        """Return margins at times since the first knot [s] of any shape, in the quantity's unit."""
        if self.tube is None and not (quantity == "position" and self.largest > 0.0):
            return np.zeros(times.shape)
        steps, knots = self.steps[quantity], self.knots[quantity]
        k = np.clip(step_at(times, self.grid.step), 0, len(knots) - 1)
        at_knot = Clock.of(self.grid.step).same(times, self.grid.step * k)
        return np.where(at_knot, knots[k], steps[np.minimum(k, len(steps) - 1)])

    @cached_property
    def largest(self) -> float:
        """Largest margin of the position [m]."""
        return float(self.steps["position"].max())

    @cached_property
    def pointwise(self) -> Margins:
        """Radii of the same tube at the instants themselves, not the largest in their steps."""
        return PointMargins(self.grid, self.steps, self.knots, self.tube, self.pieces)


@dataclasses.dataclass(frozen=True, eq=False)
class PointMargins(Margins):
    """Radii of an error tube at each instant; for feedback, those of whole steps."""

    def at(self, quantity: Quantity, times: FloatArray) -> FloatArray:
        """Return radii at times since the first knot [s] of any shape, in the quantity's unit."""
        if self.tube is None or quantity not in ("position", "velocity"):
            return super().at(quantity, times)
        radii: FloatArray = getattr(self.tube, quantity)(self.grid.start + times)
        return radii


@dataclasses.dataclass(frozen=True, eq=False)
class PlanMargins:
    """Margins of distances, and of values in convex sets, on the grids on which they are constant.

    The grids have the plan's steps or, for `inner` and `states`, pieces of these if no plan is
    found with margins over whole steps.
    """

    steps: Margins
    """margins of distances from obstacles and between vehicles, constant over each step"""
    inner: Margins
    """margins of these distances, constant over each piece of a step"""
    states: Margins
    """margins of positions and velocities in convex sets"""
    inputs: Margins
    """margins of accelerations and jerks in convex sets"""

    def of(self, quantity: Quantity) -> Margins:
        """Return the margins of a quantity in convex sets."""
        return self.states if quantity in ("position", "velocity") else self.inputs


def margins_of(
    scenario: Scenario, pieces: int = 1, accelerations: FloatArray | np.float64 = UNBOUNDED
) -> PlanMargins:
    """Return the margins for plans of a scenario; zero without a disturbance or a smoothing.

    Args:
        scenario: the scenario to plan.
        pieces: the number of pieces of each step for positions and velocities.
        accelerations: largest norms in each step and the neighbours within the averages' width
            [m/s²], shape (K-1,), for the margin of a smoothing. Limits bound them as well.
    """
    if scenario.smoothing is not None:
        margins = np.full(scenario.grid.knots - 1, scenario.smoothing_margin)
        margins = np.minimum(margins, scenario.smoothing.margins(accelerations))
        if scenario.disturbance is None:
            none = without_errors(scenario.grid)
            larger = _of_positions(none, margins)
            return PlanMargins(larger, larger, none, none)
        tube, grid = tube_of(scenario), scenario.grid
        convex = _around_averages(tube, grid.step, grid.knots, grid.start, scenario.lead)
        own = _around_averages(tube, grid.step, grid.knots, grid.start, 0.0).steps["position"]
        larger = _of_positions(without_errors(grid), margins + own)
        return PlanMargins(larger, larger, convex, convex)
    steps = _margins(scenario, 1)
    inner = steps if pieces == 1 else _margins(scenario, pieces)
    return PlanMargins(steps, inner, inner, steps)


def _margins(scenario: Scenario, pieces: int) -> Margins:
    grid = scenario.grid
    if scenario.disturbance is None:
        return _none(grid.step, grid.knots, grid.start)
    return _around(tube_of(scenario), grid.start, grid.knots, pieces, scenario.between_knots)


def without_errors(grid: Grid) -> Margins:
    """Return zero margins, for quantities without errors."""
    return _none(grid.step, grid.knots, grid.start)


@lru_cache(maxsize=64)
def _none(step: float, knots: int, start: float) -> Margins:
    quantities: tuple[Quantity, ...] = ("position", "velocity", "acceleration", "jerk")
    steps = {each: np.zeros(knots - 1) for each in quantities}
    every = {each: np.zeros(knots) for each in _AT_KNOTS}
    return Margins(Grid(step, knots, start), steps, steps | every)


def _of_positions(none: Margins, margins: FloatArray) -> Margins:
    """Return zero margins except for positions in each step [m], shape (K-1,)."""
    steps = none.steps | {"position": margins}
    return Margins(none.grid, steps, none.knots | {"position": _greater(margins)})


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
    for quantity in _AT_KNOTS:
        knots[quantity] = _greater(steps[quantity])
    if not between_knots:  # positions are constrained at knots only
        knots["position"] = greatest.ends
    return Margins(grid, steps, knots, tube, pieces)


@lru_cache(maxsize=64)
def _around_averages(
    tube: ErrorTube, step: float, knots: int, start: float, half_width: float
) -> Margins:
    """Return the margins of a plan whose averages an error tube surrounds.

    An average depends on values of the plan up to `half_width` before and after its time. Each of
    these has to be in the set tightened by the radius at that time. So a step has the largest
    radius over all times within `half_width` of it.

    Args:
        tube: tube around the smooth motion.
        step: h [s].
        knots: K.
        start: time of the first knot [s].
        half_width: half the total width of the averages [s].
    """
    grid = Grid(step, knots, start)
    begins, ends = grid.times[:-1] - half_width, grid.times[1:] + half_width
    begins[0] = max(begins[0], tube.grid.start)
    steps: dict[Quantity, FloatArray] = {
        "position": tube.position_over(begins, ends),
        "velocity": tube.velocity_over(begins, ends),
        "acceleration": tube.acceleration_over(begins, ends),
        "jerk": np.zeros(knots - 1),
    }
    return Margins(grid, steps, steps | {each: _greater(steps[each]) for each in _AT_KNOTS}, tube)


def _greater(steps: FloatArray) -> FloatArray:
    """Return the larger value of the two steps adjacent to each knot."""
    greater: FloatArray = np.maximum(np.append(steps, 0.0), np.append(0.0, steps))
    return greater


def jerk_factor(scenario: Scenario) -> float:
    """Return the factor w / h of limits of jerks for the plan itself; 1 without a smoothing.

    The jerk of one average over w is (a(t + w/2) - a(t - w/2)) / w; that of several is an average
    of it. As w is at most a step, it is 0 or the difference of two accelerations, of neighbouring
    steps or of rest and the first or last step, over w. These are the plan's own jerks (7) times
    h / w. So it is in a convex set with 0 if the plan's jerks are in w / h times the set. The bound
    is tight with one or two averages, and conservative with three.
    """
    smoothing = scenario.smoothing
    return 1.0 if smoothing is None else smoothing.width / scenario.grid.step
