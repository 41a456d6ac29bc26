"""Obstacles that are seen again in flight: from then on they are where they were seen.

A sighting does not change what the flight so far was planned with. The obstacle as it was known is
avoided until now, and a new one, with its errors counted anew, is known and avoided from now on. So
windows, reports and files treat both like any other obstacle.

The true position is in the space of the former sighting and in that of the new one, neither of
which need contain the other. A new plan keeps clear of the new space. The rest of the previous plan
keeps clear of the former one, which suffices as well: a window that keeps it keeps the former
sighting too. Only a sighting outside of the former space, which is wrong then, holds in any case.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import numpy.typing as npt

from drake_rho.planning.horizon.newer_maps import LONGEST, just_before, with_obstacles
from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.errors import one_of
from drake_rho.scenario.fields import LARGEST, FloatArray, unchecked
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.tracks import Track

Seen = tuple[npt.ArrayLike, npt.ArrayLike]
"""Position of the centre [m] and velocity [m/s] of an obstacle, shape (3,) each."""

_ROUNDING = 1e-9
"""Distance from the former space up to which a sighting is within it, in sizes of the obstacle."""


def seen_again(
    scenario: Scenario, sightings: Mapping[str, Seen], time: float, ago: float = 0.0
) -> tuple[Scenario, Scenario]:
    """Return the scenario in which obstacles are where they were seen, and one of what must be.

    Args:
        scenario: of the whole flight, or of its rest.
        sightings: position [m] and velocity [m/s] by the name of the obstacle.
        time: from which on they are planned with, on the scenario's clock [s].
        ago: how long before this time the obstacles were seen [s].

    Returns:
        The scenario with all sightings, and the one with those only that the former errors exclude:
        it is enough for the rest of the previous plan to keep clear of what that one has.

    Raises:
        ValueError: there is no obstacle of a name, or more than one, or a sighting is not two
            vectors.
    """
    found = [(_number(scenario, name), _state(name, state)) for name, state in sightings.items()]
    wrong = [_excludes(scenario.bodies[n - 1], state[0], time, time - ago) for n, state in found]
    must = [each for each, excluded in zip(found, wrong, strict=True) if excluded]
    may = [each for each, excluded in zip(found, wrong, strict=True) if not excluded]
    due = _with(scenario, must, time, time - ago)
    return _with(due, may, time, time - ago), due


def _number(scenario: Scenario, name: str) -> int:
    """Return the number of the only obstacle of a name."""
    names = [body.name for body in scenario.bodies if body.name is not None]
    if name not in names:
        raise ValueError(f"sightings: got {name!r}, expected {one_of(names, str(name))}")
    if names.count(name) > 1:
        expected = "a name that one obstacle has alone"
        raise ValueError(f"sightings: got {name!r}, expected {expected}")
    return next(k for k, body in enumerate(scenario.bodies, start=1) if body.name == name)


def _state(name: str, state: Seen) -> FloatArray:
    """Return a position and a velocity, shape (2, 3)."""
    expected = f"a position and a velocity, two vectors of numbers up to {LARGEST:g}"
    try:
        array = np.array(state, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"sightings[{name!r}]: got {state!r}, expected {expected}") from None
    if array.shape != (2, 3) or not (np.abs(array) <= LARGEST).all():  # true for NaN
        raise ValueError(f"sightings[{name!r}]: got {array.tolist()}, expected {expected}")
    return array


def _excludes(body: Obstacle, position: FloatArray, time: float, seen_at: float) -> bool:
    """Return whether an obstacle, as it was known, cannot have been seen at a position.

    What was not known was not avoided, and excludes every position.
    """
    then = np.array([seen_at])
    away = float(np.linalg.norm(position - body.centers(then)[0]))
    errors = body.deviation + float(body.uncertainty(then)[0]) + body.position_error
    return body.known_from > time or away > errors + _ROUNDING * body.shape.size


def _with(
    scenario: Scenario, sightings: Iterable[tuple[int, FloatArray]], time: float, seen_at: float
) -> Scenario:
    """Return a scenario with obstacles where they were seen, the same one without sightings."""
    bodies, grid = list(scenario.bodies), scenario.grid
    for number, (position, velocity) in sightings:
        body = bodies[number - 1]
        first, last = body.active or (grid.start - grid.step, grid.end + grid.step)
        before, active = just_before(time, grid), (max(first, time), last)
        if not grid.clock.after(last, time):  # it is avoided no more, wherever it is
            continue
        if not grid.clock.before(first, before):  # to be avoided later only, so that it never was
            first, before = grid.start - 2.0 * grid.step, grid.start - grid.step
        name = f"{(body.name or '')[:LONGEST]} until {clock_time(time)}"
        bodies[number - 1] = unchecked(body, active=(first, before), name=name)
        track = Track([seen_at, seen_at + 1.0], [position, position + velocity], after="goes_on")
        bodies.append(
            unchecked(
                body,
                velocity=None,
                track=track,
                known_from=time,
                seen_at=seen_at,
                active=active,
            )
        )
    if len(bodies) == len(scenario.bodies):
        return scenario
    return with_obstacles(scenario, tuple(bodies))
