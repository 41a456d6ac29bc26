"""Random worst cases, flown: they should attain the tube's radius, and nothing should exceed it."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

import drake_rho as rho
from benchmarks.error_loop import fly, random_tube, scenario_with
from benchmarks.tables import Cell, Goal, Table
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.parts import Quantity

CASES = 200

QUANTITIES: tuple[Quantity, ...] = ("position", "velocity", "acceleration")
"""Quantities whose radii are to be attained in turn; for the acceleration, the feedback's."""


class Found(NamedTuple):
    """One case, flown."""

    quantity: Quantity
    """quantity that was to attain its radius"""
    delay: int
    """delay in samples"""
    dropouts: int
    """largest number of measurements lost in a row"""
    reached: float
    """fraction of its radius attained, in the given direction and at the given time"""
    largest: float
    """largest error over its radius at any time"""


def run() -> Table:
    """Fly all cases."""
    rng = np.random.default_rng(0)
    found = [fly_case(rng, QUANTITIES[number % len(QUANTITIES)]) for number in range(CASES)]
    least = min(each.reached for each in found)
    largest = max(each.largest for each in found)
    return Table(
        name="flight_worst_case",
        title="The worst case: does it reach the tube",
        columns=(
            "quantity",
            "cases",
            "delays",
            "lost_in_a_row",
            "least_reached",
            "largest_error_over_radius",
        ),
        rows=tuple(_row(found, quantity) for quantity in QUANTITIES),
        notes=(_ABOUT,),
        goals=(
            Goal("part of a radius that is not reached", 1e-3, 1.0 - least),
            Goal("part of its radius by which an error is above it", 1e-9, max(0.0, largest - 1.0)),
        ),
    )


def fly_case(rng: np.random.Generator, quantity: Quantity) -> Found:
    """Draw a tube, a time and a direction, and fly the worst case for them."""
    tube = random_tube(rng)
    grid, around, sample = tube.grid, tube.disturbance, tube.sample
    silent = around.delay * sample if quantity == "acceleration" else 0.0  # no feedback acts yet
    time = grid.start + rng.uniform(min(silent, 0.9 * grid.duration), grid.duration)
    direction = rng.normal(size=3)
    case = rho.worst_case(scenario_with(around, grid), direction, time, quantity, tube=tube)
    flown = fly(tube, case, time)
    other = fly(tube, dataclasses.replace(case, lost=_pattern(rng, case.lost, around)), time)
    samples = grid.start + sample * np.arange(tube.samples)
    at = int(np.argmin(np.abs(flown.times - time)))
    values = {
        "position": flown.positions[at],
        "velocity": flown.velocities[at],
        "acceleration": flown.feedback[np.searchsorted(samples, time, side="right") - 1],
    }
    reached = values[quantity] @ direction / np.linalg.norm(direction)
    largest = max(
        max(
            _largest(each.positions, tube.position(each.times)),
            _largest(each.velocities, tube.velocity(each.times)),
            _largest(each.feedback, tube.acceleration(samples)),
        )
        for each in (flown, other)
    )
    return Found(quantity, around.delay, around.dropouts, _part(reached, case.radius), largest)


def _pattern(rng: np.random.Generator, lost: BoolArray, around: rho.Disturbance) -> BoolArray:
    """Return another pattern of lost measurements, with no more in a row than declared."""
    found, run = np.zeros_like(lost), 0
    for j, draw in enumerate(rng.random(len(lost)) < rng.random()):
        found[j] = draw and run < around.dropouts
        run = run + 1 if found[j] else 0
    return found


def _part(reached: float, radius: float) -> float:
    """Return the attained fraction of the radius; 1 for a radius of 0."""
    return float(reached / radius) if radius > 0.0 else 1.0


def _largest(errors: FloatArray, radii: FloatArray) -> float:
    """Return the largest error over its radius; infinite for an error where the radius is 0."""
    sizes = np.linalg.norm(errors, axis=1)
    possible = radii > 0.0
    if np.any(sizes[~possible] > 0.0):
        return np.inf
    return float(np.max(sizes[possible] / radii[possible], initial=0.0))


def _row(found: list[Found], quantity: Quantity) -> tuple[Cell, ...]:
    """Return the row of all cases of a quantity."""
    these = [each for each in found if each.quantity == quantity]
    delays, dropouts = (
        sorted({getattr(each, name) for each in these}) for name in ("delay", "dropouts")
    )
    return (
        quantity,
        len(these),
        f"{delays[0]} to {delays[-1]} samples",
        f"{dropouts[0]} to {dropouts[-1]}",
        f"{min(each.reached for each in these):.9f}",
        f"{max(each.largest for each in these):.12f}",
    )


_ABOUT = """\
Gains are drawn among the stable ones, samples from 0.01 to 3 s, wind, errors of the estimate and
of the first state, times and directions at random. Half of the loops predict the state over the
delay, and may lose up to three measurements in a row. `rho.worst_case` gives the wind, the errors
of the estimate, the lost measurements and the initial errors, and a loop without code of the tube
integrates them: p'' = u + w exactly from one change to the next (`benchmarks/error_loop.py`).
Reached is the error in the given direction and at the given time, over its radius. The largest
error is that of any of the three quantities at any step of any flight, over its radius at that
time; each wind is also flown with another, random pattern of lost measurements."""
