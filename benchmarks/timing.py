"""The least time along a path within limits of velocity and acceleration along each axis."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import diags_array, vstack

from drake_rho.scenario.fields import FloatArray


def least_time(path: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> float:
    """Return the least time from rest to rest along a path given by equidistant points [s].

    With s the length along the path and u = (ds/dt)², the acceleration q' d²s/dt² + q'' u and the
    squared velocity q'² u are linear in u, since d²s/dt² = du/ds / 2. The largest u everywhere is
    the fastest, and a linear program finds it; this is time-optimal path parameterisation.

    Args:
        path: [m], shape (P, 3).
        velocity: limit along each axis, both ways [m/s], shape (3,).
        acceleration: limit along each axis, both ways [m/s²], shape (3,).

    Returns:
        Infinite if the path has no feasible timing.
    """
    ways = np.diff(path, axis=0)
    step = float(np.mean(np.linalg.norm(ways, axis=1)))
    first = ways / step  # q' of each piece
    bends = np.zeros_like(path)
    bends[1:-1] = np.diff(ways, axis=0) / step**2
    second = (bends[1:] + bends[:-1]) / 2.0  # q'' of each piece
    count = len(path)
    rows = [
        diags_array(
            [-a / (2.0 * step) + b / 2.0, a / (2.0 * step) + b / 2.0],
            offsets=[0, 1],
            shape=(count - 1, count),
        )
        for a, b in zip(first.T, second.T, strict=True)
    ]
    most = np.repeat(acceleration, count - 1)
    with np.errstate(divide="ignore"):
        fastest = np.min(velocity**2 / first**2, axis=1)
    upper = np.minimum(np.append(fastest, np.inf), np.append(np.inf, fastest))
    upper[[0, -1]] = 0.0
    matrix = vstack(rows)
    found = linprog(
        -np.ones(count),
        A_ub=vstack([matrix, -matrix]),
        b_ub=np.concatenate([most, most]),
        bounds=np.stack([np.zeros(count), upper], axis=1),
    )
    if found.x is None:
        return np.inf
    speeds = np.sqrt(np.maximum(found.x, 0.0))
    with np.errstate(divide="ignore"):
        return float(np.sum(2.0 * step / (speeds[1:] + speeds[:-1])))
