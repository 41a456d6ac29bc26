"""Table of a simulation's tracking errors and clearances for the terminal."""

from __future__ import annotations

import numpy as np
from rich.markup import escape
from rich.table import Table

from drake_rho.cli.documents import ErrorRow
from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.fields import FloatArray, IntArray

_MOST_ROWS = 20
"""Largest number of rows; of more vehicles, those with the largest errors have a row."""
_ZERO = 1e-9
"""Absolute value below which a number is printed as 0, in the units of the table."""
_ROUNDING = 1e-9
"""Rounding error of positions that is not counted as tracking error, over the motion's scale."""


def errors_of(simulation: Simulation) -> list[ErrorRow]:
    """Return the largest tracking error of each vehicle, and its least clearances.

    Clearances are distances in the record less the vehicle's radius, or less the separation.
    """
    errors = simulation.errors()
    ratios = _ratios(simulation, errors)
    to_obstacles, to_others = _to_obstacles(simulation), _to_others(simulation)
    return [
        ErrorRow(
            vehicle=vehicle.name,
            error_m=float(errors[:, i].max()),
            of_radius=_finite(ratios[i]),
            to_obstacles_m=_finite(to_obstacles[i]),
            to_others_m=_finite(to_others[i]),
        )
        for i, vehicle in enumerate(simulation.scenario.vehicles)
    ]


def simulation_table(simulation: Simulation) -> Table:
    """Return the table of `errors_of`; of many vehicles, those with the largest errors."""
    rows = errors_of(simulation)
    columns: dict[str, list[float | None]] = {
        "error \\[m]": [each.error_m for each in rows],
        "of radius \\[%]": [each.of_radius and 100.0 * each.of_radius for each in rows],
        "to obstacles \\[m]": [each.to_obstacles_m for each in rows],
        "to others \\[m]": [each.to_others_m for each in rows],
    }
    columns = {
        name: values
        for name, values in columns.items()
        if any(value is not None for value in values)
    }
    errors = np.array([each.error_m for each in rows])
    worst: IntArray = np.sort(np.argsort(-errors, kind="stable")[:_MOST_ROWS])
    table = Table(title=_title(simulation), title_justify="left", caption_justify="left")
    table.caption = "error: of position; distances: beyond radius or separation"
    table.add_column("vehicle")
    for name in columns:
        table.add_column(name, justify="right")
    for i in worst:
        table.add_row(escape(rows[i].vehicle), *(_number(values[i]) for values in columns.values()))
    if len(rows) > len(worst):
        table.caption += f"; the {len(worst)} of {len(rows)} vehicles with the largest errors"
    return table


def _title(simulation: Simulation) -> str:
    """Return the title: scenario, vehicle model and strongest wind."""
    strongest = float(np.linalg.norm(simulation.wind, axis=2).max())
    wind = f"in wind of up to {strongest:.3g} m/s²" if strongest > 0.0 else "without wind"
    return f"{escape(simulation.scenario.name)}: {escape(simulation.plant)} {wind}"


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return "0" if abs(value) < _ZERO else f"{value:.3g}"


def _ratios(simulation: Simulation, errors: FloatArray) -> FloatArray:
    """Return the largest ratio of error to tube radius, shape (N,); NaN without a tube."""
    radii = simulation.radii()
    wide = radii > 0.0
    if not np.any(wide):
        return np.full(errors.shape[1], np.nan)
    errors = np.maximum(errors - _ROUNDING * simulation.scenario.fleet.scale("position"), 0.0)
    ratios: FloatArray = (errors[wide] / radii[wide, None]).max(axis=0)
    return ratios


def _to_obstacles(simulation: Simulation) -> FloatArray:
    """Return each vehicle's least clearance from obstacles while known [m], shape (N,)."""
    least = np.full(len(simulation.scenario.vehicles), np.inf)
    positions, times = np.swapaxes(simulation.positions, 0, 1), simulation.times
    first = {
        number for number, _ in simulation.scenario.known
    }  # at the start, clock rounded or not
    for number, obstacle in enumerate(simulation.scenario.bodies, start=1):
        if np.any(known := (times >= obstacle.known_from) | (number in first)):
            distances = obstacle.distances(positions[:, known], times[known]).min(axis=1)
            least = np.minimum(least, distances - obstacle.deviation)
    return least - simulation.scenario.fleet.radii


def _to_others(simulation: Simulation) -> FloatArray:
    """Return each vehicle's least distance from another, less the separation [m], shape (N,)."""
    from scipy.spatial import cKDTree  # slow to import, hence only where needed

    separation = simulation.scenario.separation
    least = np.full(len(simulation.scenario.vehicles), np.inf)
    if separation is None or len(least) < 2:
        return least
    for points in separation.scaled(simulation.positions):
        least = np.minimum(least, cKDTree(points).query(points, k=2)[0][:, 1])
    return least - separation.distance
