"""Separation of every two vehicles, verified at the knots and at every instant."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.verification.check import AT_ALL_TIMES, AT_KNOTS, PRECISION, Column
from drake_rho.verification.closest_pairs import FAR, closest_at_all_times, closest_at_knots
from drake_rho.verification.trajectory import PiecewiseTrajectory


def check_separation(trajectory: PiecewiseTrajectory, far: float = FAR) -> Iterator[Column]:
    """Verify each vehicle's distance from its closest other vehicle, at knots and all times.

    The distance is that of the separation constraint: z is divided by the downwash factor. With
    position errors it is the separation plus the signed distance of the other vehicle from the
    separation's ellipsoid, because an error radius is the same in every direction.

    Args:
        trajectory: the trajectory to verify.
        far: cut-off distance in separations, as in `closest_at_all_times`.
    """
    scenario = trajectory.scenario
    separation = scenario.separation
    if separation is None or len(scenario.vehicles) < 2:
        return
    knots = closest_at_knots(trajectory, separation)
    precision = PRECISION * separation.tolerance
    always = closest_at_all_times(trajectory, separation, knots, precision, far)
    for part, found in ((AT_KNOTS, knots), (AT_ALL_TIMES, always)):
        names = [scenario.vehicles[partner].name for partner in found.partners]
        limits = separation.distance + found.errors
        yield Column(
            kind="separation",
            constraint="separation",
            parts=[f"from {name} {part}" for name in names],
            times=scenario.grid.start + found.times,
            values=found.distances,
            limits=limits,
            excess=limits - found.distances,
            tolerances=np.full(len(names), separation.tolerance),
            errors=found.errors,
            unit="m",
            concerned=np.ones(len(names), dtype=bool),
            asked=part == AT_KNOTS or scenario.between_knots,
            partners=found.partners,
        )
