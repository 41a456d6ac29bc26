"""The closest two of many vehicles, found without a visit to every pair."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import Separation, Vehicle


def check_apart(
    separation: Separation, vehicles: Sequence[Vehicle], where: str, positions: FloatArray
) -> None:
    """See that no two vehicles are closer than their separation, to its tolerance.

    Args:
        separation: what they keep.
        vehicles: whose names an error gives.
        where: the field of a vehicle that holds its position, as `"start.position"`.
        positions: of the vehicles [m], shape (N, 3).

    Raises:
        ScenarioError: two are; it names the closest two and how far apart they are.
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
    """Indices, rising, and distance of the closest two of `points`, shape (N, 3), N >= 2."""
    from scipy.spatial import cKDTree  # takes a tenth of a second to load, so only where needed

    distances, neighbours = cKDTree(points).query(points, k=2)
    one = int(np.argmin(distances[:, 1]))
    # where points coincide, either of the two that were found may be the point itself
    other = next(int(index) for index in neighbours[one] if index != one)
    return min(one, other), max(one, other), float(distances[one, 1])
