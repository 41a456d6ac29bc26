"""Common parts of the peers of Example 4: the loop over windows, without the solving.

Every vehicle is assumed to have the scenario's own limits, as in the paper.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from drake_rho import Scenario
from drake_rho.scenario.fields import FloatArray

REPLAN_EVERY = 5
"""Steps d flown of each window."""


@dataclasses.dataclass(frozen=True)
class HalfSpaces:
    """Obstacles linearised as (15): normal · p[k] >= offset at every inner knot."""

    normals: FloatArray
    """outward unit normals, shape (N, M, K-2, 3)"""
    offsets: FloatArray
    """offsets [m], shape (N, M, K-2)"""


@dataclasses.dataclass(frozen=True)
class Window:
    """Rest of the flight from some knot, for all vehicles."""

    knots: int
    """number of knots K of the window, its first and last included"""
    positions: FloatArray
    """initial positions p[1] [m], shape (N, 3)"""
    velocities: FloatArray
    """initial velocities v[1] [m/s], shape (N, 3)"""
    half_spaces: HalfSpaces | None = None
    """linearised obstacles; None while the reference is computed"""


WindowSolver = Callable[[Window], FloatArray]
"""Function that returns the accelerations of least index in a window [m/s²], shape (N, K-1, 3)."""


def fly_windows(scenario: Scenario, solve: WindowSolver) -> FloatArray:
    """Fly the paper's receding horizon: solve, linearise obstacles, solve again, fly d steps.

    Args:
        scenario: the scenario.
        solve: the peer's method for one window.

    Returns:
        The accelerations flown [m/s²], shape (N, K-1, 3).
    """
    step, knots = scenario.grid.step, scenario.grid.knots
    p, v = scenario.fleet.start_positions, scenario.fleet.start_velocities
    flown = []
    for first in range(0, knots - 1, REPLAN_EVERY):
        window = Window(knots - first, p, v)
        reference, _ = roll_out(step, p, v, solve(window))
        half_spaces = linearise(scenario, reference[:, 1:-1])
        accelerations = solve(dataclasses.replace(window, half_spaces=half_spaces))
        flown.append(accelerations[:, :REPLAN_EVERY])
        positions, velocities = roll_out(step, p, v, flown[-1])
        p, v = positions[:, -1], velocities[:, -1]
    return np.concatenate(flown, axis=1)


def roll_out(
    step: float, start: FloatArray, velocity: FloatArray, accelerations: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return positions and velocities by (1) and (2), each of shape (N, K, 3)."""
    N, steps, _ = accelerations.shape
    p, v = np.empty((N, steps + 1, 3)), np.empty((N, steps + 1, 3))
    p[:, 0], v[:, 0] = start, velocity
    v[:, 1:] = velocity[:, None] + step * np.cumsum(accelerations, axis=1)
    moved = step * v[:, :-1] + step**2 / 2 * accelerations
    p[:, 1:] = start[:, None] + np.cumsum(moved, axis=1)
    return p, v


def linearise(scenario: Scenario, reference: FloatArray) -> HalfSpaces:
    """Linearise every obstacle by (15) around the inner knots of a reference [m], (N, K-2, 3)."""
    centers = np.array([sphere.center for sphere in scenario.spheres])
    radii = np.array([sphere.radius for sphere in scenario.spheres])
    away = reference[:, None] - centers[:, None]
    normals = away / np.linalg.norm(away, axis=-1, keepdims=True)
    offsets = radii[:, None] + np.einsum("nmki,mi->nmk", normals, centers)
    return HalfSpaces(normals, offsets)
