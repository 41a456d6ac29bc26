"""What came of a simulation, as a table for the terminal."""

from __future__ import annotations

import numpy as np
from rich.markup import escape
from rich.table import Table

from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.fields import FloatArray, IntArray

_MOST_ROWS = 20
"""Most vehicles with a row each; of more, those with the greatest errors."""
_NOTHING = 1e-9
"""What is put down to rounding, in the units of the table."""
_ROUNDING = 1e-9
"""Part of a motion's scale that rounding may be off, and no error."""


def simulation_table(simulation: Simulation) -> Table:
    """How far each vehicle was off its plan, and how close it came to what it keeps clear of.

    Clearances are what is left above the vehicle's radius, or above the separation, in the record.
    """
    vehicles = simulation.scenario.vehicles
    errors = simulation.errors()
    columns = {"error \\[m]": errors.max(axis=0)}
    if (parts := _parts(simulation, errors)) is not None:
        columns["of radius \\[%]"] = 100.0 * parts
    if simulation.scenario.obstacles:
        columns["to obstacles \\[m]"] = _from_obstacles(simulation)
    if simulation.scenario.separation is not None and len(vehicles) > 1:
        columns["to others \\[m]"] = _from_others(simulation)
    worst: IntArray = np.sort(np.argsort(-errors.max(axis=0), kind="stable")[:_MOST_ROWS])
    table = Table(title=_title(simulation), title_justify="left", caption_justify="left")
    table.caption = "error of position; distances above those that are kept"
    table.add_column("vehicle")
    for name in columns:
        table.add_column(name, justify="right")
    for i in worst:
        row = (_number(float(values[i])) for values in columns.values())
        table.add_row(escape(vehicles[i].name), *row)
    if len(vehicles) > len(worst):
        table.caption += f"; the {len(worst)} of {len(vehicles)} vehicles with the greatest errors"
    return table


def _title(simulation: Simulation) -> str:
    """What was flown in what."""
    strongest = float(np.linalg.norm(simulation.wind, axis=2).max())
    wind = f"in wind of up to {strongest:.3g} m/s²" if strongest > 0.0 else "without wind"
    return f"{escape(simulation.scenario.name)}: {escape(simulation.plant)} {wind}"


def _number(value: float) -> str:
    if not np.isfinite(value):
        return "-"
    return "0" if abs(value) < _NOTHING else f"{value:.3g}"


def _parts(simulation: Simulation, errors: FloatArray) -> FloatArray | None:
    """The greatest part of its radius that each error had, shape (N,); None without a tube."""
    radii = simulation.radii()
    wide = radii > 0.0
    if not np.any(wide):
        return None
    errors = np.maximum(errors - _ROUNDING * simulation.scenario.fleet.scale("position"), 0.0)
    parts: FloatArray = (errors[wide] / radii[wide, None]).max(axis=0)
    return parts


def _from_obstacles(simulation: Simulation) -> FloatArray:
    """Least clearance of each vehicle from any obstacle that is known then [m], shape (N,)."""
    least = np.full(len(simulation.scenario.vehicles), np.inf)
    positions, times = np.swapaxes(simulation.positions, 0, 1), simulation.times
    for obstacle in simulation.scenario.bodies:
        if np.any(known := times >= obstacle.known_from):
            distances = obstacle.distances(positions[:, known], times[known]).min(axis=1)
            least = np.minimum(least, distances - obstacle.deviation)
    return least - simulation.scenario.fleet.radii


def _from_others(simulation: Simulation) -> FloatArray:
    """Least distance of each vehicle from another, less the separation [m], shape (N,)."""
    from scipy.spatial import cKDTree  # slow to load, so only where needed

    separation = simulation.scenario.separation
    least = np.full(len(simulation.scenario.vehicles), np.inf)
    if separation is None:
        return least
    for points in separation.scaled(simulation.positions):
        least = np.minimum(least, cKDTree(points).query(points, k=2)[0][:, 1])
    return least - separation.distance
