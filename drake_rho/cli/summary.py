"""Table of a simulation's tracking errors and clearances for the terminal."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from rich.markup import escape
from rich.table import Table

from drake_rho.cli.console import plain_table
from drake_rho.motion.nearest_vehicles import nearest_vehicles
from drake_rho.motion.obstacle_clearances import clearances
from drake_rho.motion.simulation import Simulation
from drake_rho.motion.tube_shares import largest_shares, rounding_of
from drake_rho.scenario.fields import FloatArray, IntArray

_MOST_ROWS = 20
"""Largest number of rows; with more vehicles, those with the largest errors are listed."""
_ZERO = 1e-9
"""Absolute value below which a number is printed as 0, in the units of the table."""


@dataclasses.dataclass(frozen=True)
class VehicleErrors:
    """Tracking error and least distances of one vehicle in a simulation."""

    vehicle: str
    """name of the vehicle"""
    error_m: float
    """largest position error with respect to the plan in force"""
    of_radius: float | None
    """largest ratio of the position error to the radius of the tube; None without a tube"""
    to_obstacles_m: float | None
    """least distance from an obstacle, less the vehicle's radius; None if none was known"""
    to_others_m: float | None
    """least distance from another vehicle, less the separation; None without a separation"""


def errors_of(simulation: Simulation) -> list[VehicleErrors]:
    """Return the largest tracking error of each vehicle, and its least clearances.

    Clearances are distances in the record less the vehicle's radius, or less the separation.
    """
    errors = simulation.errors()
    radii, negligible = simulation.radii(), rounding_of(simulation, "position")
    shares = largest_shares(errors, radii, negligible)
    to_obstacles, to_others = _to_obstacles(simulation), _to_others(simulation)
    return [
        VehicleErrors(
            vehicle=vehicle.name,
            error_m=float(errors[:, i].max()),
            of_radius=float(shares[i]) if np.any(radii > 0.0) else None,
            to_obstacles_m=_finite(to_obstacles[i]),
            to_others_m=_finite(to_others[i]),
        )
        for i, vehicle in enumerate(simulation.scenario.vehicles)
    ]


def simulation_text(simulation: Simulation) -> Iterator[str | Table]:
    """Yield a title, the table of `errors_of`, and a note; only the largest errors of many."""
    rows = errors_of(simulation)
    columns: dict[str, list[float | None]] = {
        "error [m]": [each.error_m for each in rows],
        "of radius [%]": [each.of_radius and 100.0 * each.of_radius for each in rows],
        "to obstacles [m]": [each.to_obstacles_m for each in rows],
        "to others [m]": [each.to_others_m for each in rows],
    }
    columns = {
        name: values
        for name, values in columns.items()
        if any(value is not None for value in values)
    }
    errors = np.array([each.error_m for each in rows])
    worst: IntArray = np.sort(np.argsort(-errors, kind="stable")[:_MOST_ROWS])
    table = plain_table("vehicle", *columns)
    for i in worst:
        table.add_row(escape(rows[i].vehicle), *(_number(values[i]) for values in columns.values()))
    note = "error: of position; distances: beyond radius or separation"
    if len(worst) < len(rows):
        note += f"; the {len(worst)} of {len(rows)} vehicles with the largest errors"
    yield ""
    yield _title(simulation)
    yield table
    yield note


def _title(simulation: Simulation) -> str:
    """Return the title: scenario, vehicle model and strongest wind."""
    strongest = float(np.linalg.norm(simulation.wind, axis=2).max())
    wind = f"in wind of up to {strongest:.3g} m/s²" if strongest > 0.0 else "without wind"
    return f"{simulation.scenario.name}: {simulation.plant} {wind}"


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return "0" if abs(value) < _ZERO else f"{value:.3g}"


def _to_obstacles(simulation: Simulation) -> FloatArray:
    """Return each vehicle's least clearance from obstacles while known [m], shape (N,)."""
    scenario, times = simulation.scenario, simulation.times
    least = np.full(len(scenario.vehicles), np.inf)
    positions = np.swapaxes(simulation.positions, 0, 1)
    first = {number for number, _ in scenario.known}  # at the start, clock rounded or not
    for number, obstacle in enumerate(scenario.bodies, start=1):
        if np.any(known := (times >= obstacle.known_from) | (number in first)):
            margins = clearances(scenario, obstacle, positions[:, known], times[known])
            least = np.minimum(least, margins.min(axis=1))
    return least


def _to_others(simulation: Simulation) -> FloatArray:
    """Return each vehicle's least distance from another, less the separation [m], shape (N,)."""
    separation = simulation.scenario.separation
    if separation is None:
        return np.full(len(simulation.scenario.vehicles), np.inf)
    away, _ = nearest_vehicles(np.swapaxes(separation.scaled(simulation.positions), 0, 1))
    least: FloatArray = away.min(axis=1) - separation.distance
    return least
