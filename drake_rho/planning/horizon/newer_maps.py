"""Maps that are seen piece by piece: obstacles for what a newer map adds, and removes.

A newer map does not replace an older one, against which the flight so far was planned. What both
have stays an obstacle. Cells that only the newer one has are an obstacle that is known from now on,
and cells that it has no more are one that is active until now. So windows, reports and files treat
them like any other obstacle.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping

import numpy as np

from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.errors import one_of
from drake_rho.scenario.fields import IntArray, unchecked
from drake_rho.scenario.maps.cells import difference
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.maps.voxels import Voxels
from drake_rho.scenario.obstacles import AnyObstacle, Obstacle
from drake_rho.scenario.records import Scenario

_JUST_BEFORE = 1e-6
"""Time before the present until which cells count that are seen to be gone, in steps."""


class SeenMaps:
    """Maps of a flight as they are known at present.

    Args:
        scenario: to be flown; each of its maps at rest may be followed by newer ones.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._parts = {
            number: [number]
            for number, body in enumerate(scenario.bodies, start=1)
            if isinstance(body.shape, Map) and not body.moves
        }

    def seen(self, scenario: Scenario, newer: Map | Mapping[str, Map], time: float) -> Scenario:
        """Return a scenario in which newer maps are known from a time on.

        Args:
            scenario: of the whole flight.
            newer: the map that is known now; if the scenario has several, by their names.
            time: on the scenario's clock [s].

        Raises:
            ValueError: the scenario has no such map, or several and it is not said which one.
        """
        bodies, now, step = list(scenario.bodies), float(time), scenario.grid.step
        for number, latest in self._numbered(scenario, newer):
            parts = self._parts.setdefault(number, [])
            name = (bodies[number - 1].name if number <= len(bodies) else None) or "map"
            rest = latest
            for each in list(parts):
                body = bodies[each - 1]
                stays, goes, rest = _compared(body.shape, rest)
                if goes is None:
                    continue
                first = scenario.grid.start if body.active is None else body.active[0]
                until = (min(first, now) - step, now - _JUST_BEFORE * step)
                parts.remove(each)
                gone = unchecked(
                    body, shape=goes, active=until, name=f"{name} until {clock_time(now)}"
                )
                if stays is None:
                    bodies[each - 1] = unchecked(gone, name=body.name)
                else:
                    bodies[each - 1] = unchecked(body, shape=stays)
                    bodies.append(gone)
                    parts.append(each)
            if rest is not None:
                bodies.append(Obstacle(rest, known_from=now, name=f"{name} from {clock_time(now)}"))
                parts.append(len(bodies))
        return with_obstacles(scenario, tuple(bodies))

    def _numbered(
        self, scenario: Scenario, newer: Map | Mapping[str, Map]
    ) -> Iterable[tuple[int, Map]]:
        """Return newer maps with the numbers of the obstacles that they are of."""
        if isinstance(newer, Map):
            if len(self._parts) > 1:
                expected = "a mapping from names to maps, since the scenario has several"
                raise ValueError(f"map: got one map, expected {expected}")
            return [(next(iter(self._parts), len(scenario.bodies) + 1), newer)]
        names = {scenario.bodies[number - 1].name: number for number in self._parts}
        known = [name for name in names if name is not None]
        for name in newer:
            if name not in known:
                raise ValueError(f"map: got {name!r}, expected {one_of(known, name)}")
        return [(names[name], latest) for name, latest in newer.items()]


def with_obstacles(scenario: Scenario, obstacles: tuple[AnyObstacle, ...]) -> Scenario:
    """Return a scenario, or the rest of one, with other obstacles at rest.

    Obstacles at rest do not change the scales of motions, so that the fleet stays the same.
    """
    return scenario.derived(obstacles=obstacles, fleet=scenario.fleet)


def _compared(older: Map, newer: Map | None) -> tuple[Map | None, Map | None, Map | None]:
    """Return what stays of a map, what goes, and what a newer one has beside it; None for nothing.

    Only cells of the same grid are compared one by one.
    """
    if newer is None:
        return None, older, None
    if not (isinstance(older, Voxels) and isinstance(newer, Voxels)):
        return (older, None, None) if older == newer else (None, older, newer)
    shift = _shift(older, newer)
    if shift is None:
        return None, older, newer
    cells = newer.occupied + shift
    goes, more = difference(older.occupied, cells), difference(cells, older.occupied)
    stays = difference(older.occupied, goes)
    return _of(older, stays), None if len(goes) == 0 else _of(older, goes), _of(older, more)


def _of(like: Voxels, cells: IntArray) -> Voxels | None:
    """Return some cells of a map's grid; the map itself if they are all of its cells."""
    if len(cells) == 0:
        return None
    return dataclasses.replace(like, occupied=cells, source=None)


def _shift(one: Voxels, other: Voxels) -> IntArray | None:
    """Return by how many cells the indices of two grids differ; None if the grids differ."""
    turned = (np.eye(3) if each.rotation is None else each.rotation for each in (one, other))
    if one.resolution != other.resolution or not np.array_equal(*turned):
        return None
    frame = np.eye(3) if one.rotation is None else one.rotation
    shift = (other.origin - one.origin) @ frame / one.resolution
    whole = np.rint(shift)
    return whole.astype(np.int64) if np.allclose(shift, whole, rtol=0.0, atol=1e-9) else None
