"""Missions and draws of benchmarks of maps, and distances from cells by code of their own."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

import drake_rho as rho
from benchmarks.stopwatch import Stopwatch, Taken

Array = npt.NDArray[np.float64]

LIMIT = 200.0
"""Time limit of one plan [s]."""

_SAMPLES = 4001
"""Instants at which distances are measured."""


@dataclasses.dataclass(frozen=True)
class Tried:
    """A plan, or the lack of one."""

    plan: rho.Plan | None
    """plan, if there is one"""
    taken: Taken
    """time of `rho.plan`"""
    words: str = ""
    """error without a plan"""

    @property
    def ok(self) -> bool:
        """Whether there is a plan that `rho.verify` accepts."""
        return self.plan is not None and rho.verify(self.plan).ok

    def positions(self) -> Array:
        """Return positions of all vehicles at many times [m], shape (P, 3)."""
        assert self.plan is not None  # noqa: S101  # callers check this
        times = self.plan.scenario.grid.elapsed
        elapsed = np.linspace(times[0], times[-1], _SAMPLES)
        return np.asarray(self.plan.motion().at("position", elapsed).reshape(-1, 3))


def tried(scenario: rho.Scenario) -> Tried:
    """Return the plan of a scenario with the time that it took."""
    watch = Stopwatch()
    try:
        plan = rho.plan(scenario, options=rho.Options(time_limit=LIMIT))
    except (rho.InfeasibleError, rho.OutOfTimeError, rho.SolverError) as error:
        return Tried(None, watch.taken(), type(error).__name__)
    return Tried(plan, watch.taken())


def beyond_radius(found: Tried, voxels: rho.Voxels) -> float:
    """Return the least distance of any vehicle from any cell, less the radius [m].

    Cells within two radii are found by their centres; the distance from a cube is exact.
    """
    assert found.plan is not None  # noqa: S101  # callers check this
    h, radius = voxels.resolution, float(found.plan.scenario.fleet.radii.max())
    x = (found.positions() - voxels.origin) / h
    centers = voxels.occupied + 0.5
    reach = 2.0 * radius / h + np.sqrt(0.75)
    near = KDTree(centers).query(x, k=min(60, len(centers)), distance_upper_bound=reach)[1]
    least = np.inf
    for k in range(near.shape[1]):
        known = near[:, k] < len(centers)
        gaps = np.maximum(np.abs(x[known] - centers[near[known, k]]) - 0.5, 0.0)
        least = min(least, float(np.linalg.norm(gaps, axis=1).min(initial=np.inf)))
    return h * least - radius
