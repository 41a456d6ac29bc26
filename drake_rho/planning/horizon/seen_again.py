"""Sightings of obstacles in flight: new positions with their errors, from that time on.

A sighting does not change the obstacles of the flight so far. The obstacle as it was known is
active until now, and a new one, whose errors start anew, is known and active from now on. Windows,
reports and files thus treat both like any other obstacle.

The true position is in the uncertainty sets of the former and of the new sighting, neither of which
need contain the other. A new plan keeps clear of the new set. The rest of the previous plan keeps
clear of the former one, which suffices as well, so a window that continues it keeps the former
sighting too. A sighting outside of the former set proves that set wrong and always replaces it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import numpy.typing as npt

from drake_rho.planning.horizon.newer_maps import LONGEST, just_before
from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.errors import one_of
from drake_rho.scenario.fields import LARGEST, FloatArray, unchecked
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.rest_of_flight import with_obstacles
from drake_rho.scenario.tracks import Track

Seen = tuple[npt.ArrayLike, npt.ArrayLike]
"""Position of the centre [m] and velocity [m/s] of an obstacle, shape (3,) each."""

_ROUNDING = 1e-9
"""Tolerance of a sighting within the former uncertainty set, in sizes of the obstacle."""


def seen_again(
    scenario: Scenario, sightings: Mapping[str, Seen], time: float, ago: float = 0.0
) -> tuple[Scenario, Scenario]:
    """Return the scenario with all sightings, and the one with the necessary ones only.

    Args:
        scenario: of the whole flight, or of its rest.
        sightings: position [m] and velocity [m/s] by the name of the obstacle.
        time: first time at which the sightings apply, on the scenario's clock [s].
        ago: time since the obstacles were seen, before this time [s].

    Returns:
        The scenario with all sightings, and the one with only those that contradict the former
        errors: the rest of the previous plan is valid if it keeps clear of the obstacles of that.

    Raises:
        ValueError: there is no obstacle of a name, or more than one, or a sighting is not two
            vectors.
    """
    found = [(_number(scenario, name), _state(name, state)) for name, state in sightings.items()]
    wrong = [_excludes(scenario.bodies[n - 1], state[0], time, time - ago) for n, state in found]
    must = [each for each, excluded in zip(found, wrong, strict=True) if excluded]
    may = [each for each, excluded in zip(found, wrong, strict=True) if not excluded]
    necessary = _with(scenario, must, time, time - ago)
    return _with(necessary, may, time, time - ago), necessary


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
    """Return whether a sighting contradicts the known position of an obstacle and its errors.

    An obstacle that was not known was not avoided: every sighting contradicts it.
    """
    then = np.array([seen_at])
    away = float(np.linalg.norm(position - body.centers(then)[0]))
    errors = body.deviation + float(body.uncertainty(then)[0]) + body.position_error
    return body.known_from > time or away > errors + _ROUNDING * body.shape.size


def _with(
    scenario: Scenario, sightings: Iterable[tuple[int, FloatArray]], time: float, seen_at: float
) -> Scenario:
    """Return a scenario with sightings; the same object if none applies."""
    bodies, grid = list(scenario.bodies), scenario.grid
    for number, (position, velocity) in sightings:
        body = bodies[number - 1]
        first, last = body.active or (grid.start - grid.step, grid.end + grid.step)
        before, active = just_before(time, grid), (max(first, time), last)
        if not grid.clock.after(last, time):  # no longer active
            continue
        if not grid.clock.before(first, before):  # active only later, so never so far
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
