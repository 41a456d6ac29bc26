"""Obstacles known to planners at the first knot, and those active during the flight."""

from __future__ import annotations

from collections.abc import Sequence

from drake_rho.scenario.fields import unchecked
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.parts import Grid


def known_at_start(
    obstacles: Sequence[Obstacle], in_flight: Sequence[Obstacle], grid: Grid
) -> tuple[tuple[int, Obstacle], ...]:
    """Return the obstacles that planners know at the first knot of a grid.

    Args:
        obstacles: all obstacles, on the scenario's clock.
        in_flight: the same obstacles on a clock that is 0 at that knot.
        grid: of the scenario or of the remainder of its flight.

    Returns:
        The known elements of `in_flight`, with their numbers from 1.
    """
    both = enumerate(zip(obstacles, in_flight, strict=True), start=1)
    return tuple((number, body) for number, (each, body) in both if not each.is_late(grid))


def active_during(
    known: Sequence[tuple[int, Obstacle]], grid: Grid
) -> tuple[tuple[int, Obstacle], ...]:
    """Return the known obstacles that are active at any time of a flight, with their numbers.

    An obstacle that is active all through the flight is returned without its interval, so that
    plans are as if it had none. A map is replaced by its cover, of which planners keep clear.

    Args:
        known: obstacles and their numbers, on a clock that is 0 at the first knot.
        grid: of the flight or of its remainder.
    """
    found = list[tuple[int, Obstacle]]()
    for number, each in known:
        body = each if each.shape.cover is each.shape else unchecked(each, shape=each.shape.cover)
        if body.is_always_active(grid):
            always = body if body.active is None else unchecked(body, active=None)
            found.append((number, always))
        elif body.active is None or grid.clock.overlap(body.active, (0.0, grid.duration)):
            found.append((number, body))
    return tuple(found)
