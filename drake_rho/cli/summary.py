"""What came of a simulation, as a table for the terminal."""

from __future__ import annotations

import numpy as np
from rich.markup import escape
from rich.table import Table

from drake_rho.cli.documents import ErrorRow
from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.fields import FloatArray, IntArray

_MOST_ROWS = 20
"""Most vehicles with a row each; of more, those with the greatest errors."""
_NOTHING = 1e-9
"""What is put down to rounding, in the units of the table."""
_ROUNDING = 1e-9
"""Part of a motion's scale that rounding may be off, and no error."""


def errors_of(simulation: Simulation) -> list[ErrorRow]:
    """How far each vehicle was off its plan, and how close it came to what it keeps clear of.

    Clearances are what is left above the vehicle's radius, or above the separation, in the record.
    """
    errors = simulation.errors()
    columns = (_parts(simulation, errors), _from_obstacles(simulation), _from_others(simulation))
    return [
        ErrorRow(
            vehicle=vehicle.name,
            error_m=float(errors[:, i].max()),
            of_radius=_finite(columns[0][i]),
            to_obstacles_m=_finite(columns[1][i]),
            to_others_m=_finite(columns[2][i]),
        )
        for i, vehicle in enumerate(simulation.scenario.vehicles)
    ]


def simulation_table(simulation: Simulation) -> Table:
    """The rows of `errors_of`, those of the greatest errors where there are many."""
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
    table.caption = "error of position; distances above those that are kept"
    table.add_column("vehicle")
    for name in columns:
        table.add_column(name, justify="right")
    for i in worst:
        table.add_row(escape(rows[i].vehicle), *(_number(values[i]) for values in columns.values()))
    if len(rows) > len(worst):
        table.caption += f"; the {len(worst)} of {len(rows)} vehicles with the greatest errors"
    return table


def _title(simulation: Simulation) -> str:
    """What was flown in what."""
    strongest = float(np.linalg.norm(simulation.wind, axis=2).max())
    wind = f"in wind of up to {strongest:.3g} m/s²" if strongest > 0.0 else "without wind"
    return f"{escape(simulation.scenario.name)}: {escape(simulation.plant)} {wind}"


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return "0" if abs(value) < _NOTHING else f"{value:.3g}"


def _parts(simulation: Simulation, errors: FloatArray) -> FloatArray:
    """The greatest part of its radius that each error had, shape (N,); NaN without a tube."""
    radii = simulation.radii()
    wide = radii > 0.0
    if not np.any(wide):
        return np.full(errors.shape[1], np.nan)
    errors = np.maximum(errors - _ROUNDING * simulation.scenario.fleet.scale("position"), 0.0)
    parts: FloatArray = (errors[wide] / radii[wide, None]).max(axis=0)
    return parts


def _from_obstacles(simulation: Simulation) -> FloatArray:
    """Least clearance of each vehicle from any obstacle that is known then [m], shape (N,)."""
    least = np.full(len(simulation.scenario.vehicles), np.inf)
    positions, times = np.swapaxes(simulation.positions, 0, 1), simulation.times
    first = {number for number, _ in simulation.scenario.known}  # whatever the clock says
    for number, obstacle in enumerate(simulation.scenario.bodies, start=1):
        if np.any(known := (times >= obstacle.known_from) | (number in first)):
            distances = obstacle.distances(positions[:, known], times[known]).min(axis=1)
            least = np.minimum(least, distances - obstacle.deviation)
    return least - simulation.scenario.fleet.radii


def _from_others(simulation: Simulation) -> FloatArray:
    """Least distance of each vehicle from another, less the separation [m], shape (N,)."""
    from scipy.spatial import cKDTree  # slow to load, so only where needed

    separation = simulation.scenario.separation
    least = np.full(len(simulation.scenario.vehicles), np.inf)
    if separation is None or len(least) < 2:
        return least
    for points in separation.scaled(simulation.positions):
        least = np.minimum(least, cKDTree(points).query(points, k=2)[0][:, 1])
    return least - separation.distance
