"""Map updates in flight: obstacles for the cells that a newer map adds or removes.

A newer map does not replace an older one, against which the flight so far was planned. Common cells
stay an obstacle. Added cells become an obstacle known from now on, and removed cells one that is
active until now. Windows, reports and files thus treat them like any other obstacle.
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
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.parts import Grid
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.rest_of_flight import with_obstacles
from drake_rho.scenario.shapes.base import Solid

_JUST_BEFORE = 1e-6
"""Time before the present at which removed cells stop being active, in steps."""

LONGEST = 50
"""Largest number of characters of a map's name in the names of its added and removed parts."""


Parts = Mapping[int, tuple[int, ...]]
"""Numbers of the obstacles that each map at rest consists of at present, by its own number."""


def parts_of_maps(scenario: Scenario) -> Parts:
    """Return the parts of a scenario's maps at rest, each a single one."""
    return {
        number: (number,)
        for number, body in enumerate(scenario.bodies, start=1)
        if isinstance(body.shape, Map) and not body.moves
    }


def with_newer_maps(
    scenario: Scenario, parts: Parts, newer: Map | Mapping[str, Map], time: float
) -> tuple[Scenario, Parts]:
    """Return a scenario in which newer maps are known from a time on, and the parts of its maps.

    Args:
        scenario: of the whole flight.
        parts: of its maps until then.
        newer: the latest map; if the scenario has several, a mapping from their names.
        time: on the scenario's clock [s].

    Raises:
        ValueError: the scenario has no such map, or has several and no name is given.
    """
    bodies, present = list(scenario.bodies), dict(parts)
    for number, latest in _numbered(scenario, parts, newer):
        own = list(present.get(number, ()))
        name = (bodies[number - 1].name if number <= len(bodies) else None) or "map"
        name, at, newer_map = name[:LONGEST], clock_time(time), _Newer(latest)
        for each in tuple(own):
            body = bodies[each - 1]
            common, removed = newer_map.compared(body.shape)
            if removed is None:
                continue
            former = _until(time, scenario, body, removed, f"{name} until {at}")
            if common is None:
                own.remove(each)
                bodies[each - 1] = unchecked(former, name=body.name)
            else:
                bodies[each - 1] = unchecked(body, shape=common)
                bodies.append(former)
        if newer_map.added is not None:
            penalty = bodies[number - 1].penalty if number <= len(bodies) else None
            added = Obstacle(
                newer_map.added, known_from=time, name=f"{name} from {at}", penalty=penalty
            )
            bodies.append(added)
            own.append(len(bodies))
        present[number] = tuple(own)
    return with_obstacles(scenario, tuple(bodies)), present


def _until(time: float, scenario: Scenario, body: Obstacle, removed: Solid, name: str) -> Obstacle:
    """Return the removed part of an obstacle, active from when it became known until now.

    It counts as known from the start.
    """
    begin = scenario.grid.start - scenario.grid.step
    if body.known_from > 0.0:
        begin = body.known_from
    active, known = (begin, just_before(time, scenario.grid)), body.known_by(0.0)
    return unchecked(known, shape=removed, active=active, name=name)


def _numbered(
    scenario: Scenario, parts: Parts, newer: Map | Mapping[str, Map]
) -> Iterable[tuple[int, Map]]:
    """Return newer maps with the numbers of their obstacles."""
    if isinstance(newer, Map):
        if len(parts) > 1:
            expected = "a mapping from names to maps, since the scenario has several"
            raise ValueError(f"map: got one map, expected {expected}")
        return [(next(iter(parts), len(scenario.bodies) + 1), newer)]
    names = {scenario.bodies[number - 1].name: number for number in parts}
    known = [name for name in names if name is not None]
    for name in newer:
        if name not in known:
            raise ValueError(f"map: got {name!r}, expected {one_of(known, str(name))}")
    return [(names[name], latest) for name, latest in newer.items()]


def just_before(time: float, grid: Grid) -> float:
    """Return the last time that counts as before a time on the scenario's clock [s]."""
    return time - max(_JUST_BEFORE * grid.step, grid.clock.tick)


@dataclasses.dataclass
class _Newer:
    """Newer map, compared with the parts of an older one in turn."""

    added: Map | None

    def compared(self, older: Solid) -> tuple[Solid | None, Solid | None]:
        """Return the common and the removed cells of an older part, None for nothing.

        Maps on different grids are compared as a whole.
        """
        newer = self.added
        if newer is None:
            return None, older
        shift = None
        if isinstance(older, Voxels) and isinstance(newer, Voxels):
            shift = _shift(older, newer)
        if shift is None or not (isinstance(older, Voxels) and isinstance(newer, Voxels)):
            same = older == newer
            self.added = None if same else newer
            return (older, None) if same else (None, older)
        cells = newer.occupied + shift
        removed = difference(older.occupied, cells)
        self.added = _of(older, difference(cells, older.occupied))
        if len(removed) == 0:
            return older, None
        return _of(older, difference(older.occupied, removed)), _of(older, removed)


def _of(like: Voxels, cells: IntArray) -> Voxels | None:
    """Return some cells of a map's grid; None for no cells."""
    if len(cells) == 0:
        return None
    return dataclasses.replace(like, occupied=cells, source=None)


def _shift(one: Voxels, other: Voxels) -> IntArray | None:
    """Return by how many cells the indices of two grids differ; None if the grids differ."""
    frame, turned = (np.eye(3) if each.rotation is None else each.rotation for each in (one, other))
    if one.resolution != other.resolution or not np.array_equal(frame, turned):
        return None
    shift = (other.origin - one.origin) @ frame / one.resolution
    whole = np.rint(shift)
    return whole.astype(np.int64) if np.allclose(shift, whole, rtol=0.0, atol=1e-9) else None
