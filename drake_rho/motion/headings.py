"""Headings of vehicles along a motion, which the planned positions leave free.

A heading is the direction of a vehicle's nose in the horizontal plane, counted from east (the
scenario's x axis) anticlockwise seen from above [rad]. Each file format turns it to its own
convention.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Literal

import numpy as np

from drake_rho.motion.flown import Flown, sample
from drake_rho.scenario.fields import LARGEST, FloatArray

Direction = Literal["velocity"] | float | Sequence[float] | FloatArray
"""Heading of a vehicle: along its velocity, a constant angle [rad], or towards a point [m]."""
Heading = Direction | Mapping[str, Direction]
"""Heading of all vehicles, or of each vehicle by its name; along the x axis for those without."""

MAX_RATE = np.pi / 2.0
"""Largest rate of turning [rad/s]; a vehicle that cannot follow turns the shorter way."""
SLOW = 0.1
"""Horizontal speed [m/s], or distance from a point [m], below which the heading is held."""
STEP = 0.02
"""Time step in which headings are followed [s]."""
_MOST_STEPS = 20_000
"""Largest number of these steps; longer flights have longer steps."""
_AT_ONCE = 1000
"""Number of steps whose states are sampled at once, which bounds the memory."""


def direction_of(direction: Direction) -> Direction:
    """Return a valid direction, a point as an array.

    Raises:
        ValueError: it is not valid.
    """
    expected = "'velocity', an angle in rad, or the x, y, z of a point to look at"
    if isinstance(direction, str):
        if direction == "velocity":
            return direction
        raise ValueError(f"heading: got {direction!r}, expected {expected}")
    try:
        numbers = np.array(direction, dtype=np.float64)
        if np.asarray(direction).dtype == bool:
            raise TypeError
    except (TypeError, ValueError):
        numbers = np.array(np.nan)
    if numbers.shape not in ((), (3,)) or not np.all(np.abs(numbers) <= LARGEST):
        raise ValueError(f"heading: got {direction!r}, expected {expected}")
    return numbers if numbers.shape else float(numbers)


def directions_of(names: Sequence[str], heading: Heading | None) -> list[Direction]:
    """Return the direction of each vehicle by name; None stands for the x axis.

    Raises:
        ValueError: a name is not that of a vehicle, or a direction is none of those allowed.
    """
    given = heading if isinstance(heading, Mapping) else dict.fromkeys(names, heading)
    if unknown := sorted(map(str, given.keys() - set(names))):
        expected = f"names of vehicles: {', '.join(names)}"
        raise ValueError(f"heading: got {unknown[0]!r}, expected {expected}")
    return [0.0 if (each := given.get(name)) is None else direction_of(each) for name in names]


def headings(flown: Flown, elapsed: FloatArray, directions: Sequence[Direction]) -> FloatArray:
    """Return headings of all vehicles along a motion, as `headings_of` does."""
    lead, end = flown.scenario.lead, float(flown.scenario.grid.elapsed[-1])

    def states(times: FloatArray) -> tuple[FloatArray, FloatArray]:
        samples = sample(flown, times)
        return samples.positions, samples.velocities

    return headings_of(states, (-lead, end + lead), elapsed, directions)


def headings_of(
    states: Callable[[FloatArray], tuple[FloatArray, FloatArray]],
    span: tuple[float, float],
    elapsed: FloatArray,
    directions: Sequence[Direction],
) -> FloatArray:
    """Return headings of all vehicles, without jumps of a whole turn [rad], shape (N, M).

    The heading along a velocity or towards a point turns at most at `MAX_RATE`, and is held where
    the vehicle is slow or at the point. It begins in the first direction that is defined.

    Args:
        states: function from times [s], (P,), to positions [m] and velocities [m/s], (N, P, 3).
        span: times at which the motion begins and ends [s].
        elapsed: times of the headings [s], shape (M,), from the same time on.
        directions: one of each vehicle.
    """
    found = np.empty((len(directions), len(elapsed)))
    turning = [i for i, each in enumerate(directions) if not isinstance(each, float)]
    if turning:
        times = _times(*span)
        parts = np.array_split(times, -(-len(times) // _AT_ONCE))
        targets = np.concatenate([angles(*states(part), directions) for part in parts], axis=1)
        followed = _followed(targets, float(times[1] - times[0]))
        found[turning] = [np.interp(elapsed, times, values) for values in followed]
    for i, each in enumerate(directions):
        if isinstance(each, float):
            found[i] = each
    return found


def _times(begin: float, end: float) -> FloatArray:
    """Return the times at which headings are followed [s]."""
    steps = min(max(1, int(np.ceil((end - begin) / STEP))), _MOST_STEPS)
    return np.linspace(begin, end, steps + 1)


def angles(
    positions: FloatArray, velocities: FloatArray, directions: Sequence[Direction]
) -> FloatArray:
    """Return the angles that turning vehicles turn to [rad], NaN where undefined, shape (n, M).

    Args:
        positions: positions of all vehicles [m], shape (N, M, 3).
        velocities: their velocities [m/s], shape (N, M, 3).
        directions: one of each vehicle, n of which are no constant angles.
    """
    vectors = np.array(list(_vectors(positions, velocities, directions)))
    x, y = np.moveaxis(vectors[:, :, :2], -1, 0)
    return np.where(np.hypot(x, y) >= SLOW, np.arctan2(y, x), np.nan)


def turned(now: FloatArray, targets: FloatArray, step: float) -> FloatArray:
    """Return headings after a step of time [s] towards angles [rad], NaN where there is none."""
    turn = np.remainder(targets - now + np.pi, 2.0 * np.pi) - np.pi
    most = MAX_RATE * step
    return np.asarray(now + np.clip(np.nan_to_num(turn), -most, most))


def _vectors(
    positions: FloatArray, velocities: FloatArray, directions: Sequence[Direction]
) -> Iterator[FloatArray]:
    """Yield the vectors that turning vehicles look along, shape (M, 3) each."""
    for p, v, direction in zip(positions, velocities, directions, strict=True):
        if not isinstance(direction, float):
            yield v if isinstance(direction, str) else np.asarray(direction) - p


def _followed(targets: FloatArray, step: float) -> FloatArray:
    """Return headings that follow targets at a limited rate [rad], shape (n, M)."""
    defined = np.isfinite(targets)
    first = np.argmax(defined, axis=1)
    now = np.nan_to_num(targets[np.arange(len(targets)), first])
    found = np.empty(targets.shape)
    for m, target in enumerate(targets.T):
        found[:, m] = now = turned(now, target, step)
    return found
