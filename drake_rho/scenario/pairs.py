"""Separation check of many vehicles at one instant, without visiting every pair."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import Separation, Vehicle


def check_separation(
    separation: Separation, vehicles: Sequence[Vehicle], where: str, positions: FloatArray
) -> None:
    """Check that no two vehicles are closer than their separation, within its tolerance.

    Args:
        separation: required of every pair.
        vehicles: the vehicles, whose names appear in the error.
        where: field of a vehicle that holds the positions, such as `"start.position"`.
        positions: of the vehicles [m], shape (N, 3).

    Raises:
        ScenarioError: two vehicles are too close; it names the closest pair and its distance.
    """
    if len(vehicles) < 2:
        return
    first, second, distance = _closest(separation.scaled(positions))
    if distance < separation.distance - separation.tolerance:
        dz = f", with dz / {separation.downwash:g}," if separation.downwash != 1.0 else ""
        expected = (
            f"{vehicles[second].name} at least {separation.distance:g} m{dz} "
            f"from {vehicles[first].name}, not {distance:.7g} m"
        )
        value = positions[second].tolist()
        raise ScenarioError(f"vehicles[{second}].{where}", value, expected)


def _closest(points: FloatArray) -> tuple[int, int, float]:
    """Return the closest two of `points`, shape (N, 3), N >= 2: increasing indices and distance."""
    from scipy.spatial import cKDTree  # imported here: loading it takes a tenth of a second

    distances, neighbours = cKDTree(points).query(points, k=2)
    one = int(np.argmin(distances[:, 1]))
    # where points coincide, either of the two neighbours may be the point itself
    other = next(int(index) for index in neighbours[one] if index != one)
    return min(one, other), max(one, other), float(distances[one, 1])
