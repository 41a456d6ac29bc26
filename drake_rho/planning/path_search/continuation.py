"""Continuation from a collision-free reference to a dynamically consistent motion.

While penalties are small, a motion near a path may cut through a wall. Linearised around such a
motion, the wall would push its parts to opposite sides, and the path would be lost. Here the
reference follows the motion only as far as it stays collision-free. It keeps its side of each
obstacle, and converges to a feasible time scaling of the path.
"""

from __future__ import annotations

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.records import Scenario

_PARTS = np.linspace(0.0, 1.0, 17)
"""Fractions of the displacement from the reference to the motion at which clearance is checked."""

_BETWEEN = (0.25, 0.5, 0.75)
"""Fractions of a time step at which clearance is checked between the knots."""

_DEEP = 0.3
"""Allowed depth of a cut corner of an obstacle between knots, as a fraction of the obstacle's least
extent."""

_REPAIRS = 5
"""Number of rounds that reset steps that penetrate too deep. A reset moves the ends of the
neighbouring steps, which may then need one too."""


def continuation_step(reference: Plan, plan: Plan, *, margin: float) -> Plan:
    """Return a reference moved to the positions of a plan as far as they stay collision-free.

    Args:
        reference: clear of obstacles at the knots.
        plan: a motion of the same vehicles, at the same knots.
        margin: margin added to each vehicle's distance from obstacles [m].
    """
    scenario, here, there = plan.scenario, reference.positions, plan.positions
    displacement = there - here
    clear = np.ones((len(_PARTS), *here.shape[:2]), dtype=bool)
    for part, at in zip(_PARTS[1:], clear[1:], strict=True):
        at[:] = _is_clear(scenario, here + part * displacement, scenario.grid.elapsed, margin)
    far = _PARTS[np.sum(np.logical_and.accumulate(clear, axis=0), axis=0) - 1]
    moved = here + far[..., None] * displacement
    for _ in range(_REPAIRS):
        deep = _deep_steps(scenario, moved, margin)
        if not deep.any():
            break
        none = np.zeros((len(deep), 1), dtype=bool)
        back = np.concatenate([deep, none], axis=1) | np.concatenate([none, deep], axis=1)
        moved[back] = here[back]
    return piecewise_linear(scenario, moved)


def piecewise_linear(scenario: Scenario, positions: FloatArray) -> Plan:
    """Return the piecewise linear motion through given positions at the knots, (N, K, 3).

    It is dynamically inconsistent: its accelerations are zero, and its velocities jump.
    """
    velocities = np.diff(positions, axis=1) / scenario.grid.step
    accelerations = np.zeros_like(velocities)
    velocities = np.concatenate([velocities, velocities[:, -1:]], axis=1)
    return Plan(scenario, positions, velocities, accelerations)


def _deep_steps(scenario: Scenario, positions: FloatArray, margin: float) -> BoolArray:
    """Return flags of the steps of a piecewise linear motion deep in an obstacle, (N, K-1)."""
    deep = np.zeros((len(positions), positions.shape[1] - 1), dtype=bool)
    times = scenario.grid.elapsed
    for part in _BETWEEN:
        x = (1.0 - part) * positions[:, :-1] + part * positions[:, 1:]
        at = times[:-1] + part * scenario.grid.step
        deep |= ~_is_clear(scenario, x, at, margin, _DEEP)
    return deep


def _is_clear(
    scenario: Scenario,
    positions: FloatArray,
    times: FloatArray,
    margin: float,
    depth: float = 0.0,
) -> BoolArray:
    """Return flags of positions (N, M, 3) at times (M,) with the required distances, (N, M).

    Args:
        scenario: with the obstacles.
        positions: of the vehicles [m].
        times: since the first knot [s].
        margin: added to each vehicle's required distance [m].
        depth: allowed shortfall of a distance, as a fraction of an obstacle's least extent.
    """
    clear = np.ones(positions.shape[:2], dtype=bool)
    for _, body in scenario.avoided:
        tolerances = scenario.fleet.obstacle_tolerances(body.shape)[:, None]
        required = scenario.fleet.radii[:, None] + body.deviation + margin - tolerances
        deepest = required - depth * body.shape.thickness
        most = float(deepest.max(initial=-np.inf))
        clear &= body.distances(positions, times, most) >= deepest
    return clear
