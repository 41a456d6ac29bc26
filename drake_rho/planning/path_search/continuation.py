"""References that stay clear while they come nearer to motions that can be flown.

A motion near a way may lead through a wall before penalties are large. Linearised around it, the
wall would ask for one side here and for the other there, and the way would be lost. A reference
that has followed the motion only as far as it is clear keeps the sides, and where on the way a
vehicle can be at which time comes out by itself.
"""

from __future__ import annotations

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.records import Scenario

_PARTS = np.linspace(0.0, 1.0, 17)
"""Parts of the way from the reference to the motion at which clearance is looked at."""

_BETWEEN = (0.25, 0.5, 0.75)
"""Parts of a step at which it is looked at too."""

_DEEP = 0.3
"""Part of an obstacle's least extent by which a reference may cut its corners between knots."""

_REPAIRS = 5
"""How often steps that lead too deep are taken back; each time their neighbours may follow."""


def towards(reference: Plan, plan: Plan, *, margin: float) -> Plan:
    """A reference whose positions have moved to those of a plan as far as they stay clear.

    Args:
        reference: keeps clear of obstacles at the knots.
        plan: a motion of the same vehicles, at the same knots.
        margin: what is kept beside each vehicle's distance from obstacles [m].
    """
    scenario, here, there = plan.scenario, reference.positions, plan.positions
    way = there - here
    clear = np.ones((len(_PARTS), *here.shape[:2]), dtype=bool)
    for part, at in zip(_PARTS[1:], clear[1:], strict=True):
        at[:] = _is_clear(scenario, here + part * way, scenario.grid.elapsed, margin)
    far = _PARTS[np.sum(np.logical_and.accumulate(clear, axis=0), axis=0) - 1]
    moved = here + far[..., None] * way
    for _ in range(_REPAIRS):
        deep = _deep_steps(scenario, moved, margin)
        if not deep.any():
            break
        none = np.zeros((len(deep), 1), dtype=bool)
        back = np.concatenate([deep, none], axis=1) | np.concatenate([none, deep], axis=1)
        moved[back] = here[back]
    return straight_between(scenario, moved)


def straight_between(scenario: Scenario, positions: FloatArray) -> Plan:
    """The motion that is at given positions at the knots, (N, K, 3), and straight between them.

    It cannot be flown: its accelerations are zero, and its velocities jump.
    """
    velocities = np.diff(positions, axis=1) / scenario.grid.step
    accelerations = np.zeros_like(velocities)
    velocities = np.concatenate([velocities, velocities[:, -1:]], axis=1)
    return Plan(scenario, positions, velocities, accelerations)


def _deep_steps(scenario: Scenario, positions: FloatArray, margin: float) -> BoolArray:
    """Which steps of a motion straight between knots lead deep into an obstacle, (N, K-1)."""
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
    """Which positions, (N, M, 3), at times (M,), are not too deep in what is kept: (N, M).

    Args:
        scenario: with the obstacles.
        positions: of the vehicles [m].
        times: since the first knot [s].
        margin: beside each vehicle's distance [m].
        depth: how deep they may be, in parts of an obstacle's least extent.
    """
    clear = np.ones(positions.shape[:2], dtype=bool)
    for _, body in scenario.known:
        tolerances = scenario.fleet.obstacle_tolerances(body.shape)[:, None]
        kept = scenario.fleet.radii[:, None] + body.deviation + margin - tolerances
        deepest = kept - depth * float(body.shape.extent.min())
        clear &= body.distances(positions, times) >= deepest
    return clear
