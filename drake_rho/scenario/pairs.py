"""Separation check of many vehicles at one instant, and the nearest other of each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Separation, Vehicle


def check_separation(
    separation: Separation,
    vehicles: Sequence[Vehicle],
    where: str,
    positions: FloatArray,
    known: IntArray,
) -> None:
    """Check that no two vehicles are closer than their separation, within its tolerance.

    Args:
        separation: required of every pair.
        vehicles: the vehicles, whose names appear in the error.
        where: field of a vehicle that holds the positions, such as `"start.position"`.
        positions: of the vehicles [m], shape (N, 3).
        known: indices of the vehicles whose positions are known.

    Raises:
        ScenarioError: two vehicles are too close; it names the closest pair and its distance.
    """
    if len(known) < 2:
        return
    one, other, distance = closest_two(separation.scaled(positions[known]))
    first, second = int(known[one]), int(known[other])
    if distance < separation.distance - separation.tolerance:
        dz = f", with dz / {separation.downwash:g}," if separation.downwash != 1.0 else ""
        expected = (
            f"{vehicles[second].name} at least {separation.distance:g} m{dz} "
            f"from {vehicles[first].name}, not {distance:.7g} m"
        )
        value = positions[second].tolist()
        raise ScenarioError(f"vehicles[{second}].{where}", value, expected)


def nearest_others(points: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the distance and the index of each point's nearest other point, N >= 2, shape (N,)."""
    from scipy.spatial import cKDTree  # imported here: loading it takes a tenth of a second

    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
    distances, neighbours = tree.query(points, k=2)
    # where points coincide, either of the two neighbours may be the point itself
    own = neighbours[:, 0] == np.arange(len(points))
    return distances[:, 1], np.where(own, neighbours[:, 1], neighbours[:, 0])


def closest_two(points: FloatArray) -> tuple[int, int, float]:
    """Return the increasing indices of the closest two of N >= 2 points, and their distance."""
    distances, others = nearest_others(points)
    one = int(np.argmin(distances))
    other = int(others[one])
    return min(one, other), max(one, other), float(distances[one])
