"""Tracking errors over time with the radii of the error tube, drawn on given axes.

Times are those of the scenario's clock. Every function takes the axes first and returns the artists
it has drawn.
"""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from drake_rho.display.common.names import as_text, brief
from drake_rho.display.common.style import FORBIDDEN, vehicle_colours
from drake_rho.display.plots.panels import draw_ring
from drake_rho.motion.simulation import Simulation
from drake_rho.motion.tube_shares import largest_shares, rounding_of
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import UNITS, Quantity

LABELS: dict[Quantity, str] = {
    "position": f"position error [{UNITS['position']}]",
    "velocity": f"velocity error [{UNITS['velocity']}]",
    "acceleration": f"feedback [{UNITS['acceleration']}]",
}
"""Axis labels of the quantities with a tube."""
_TUBE = "#4A4A4A"
"""Colour of the radii."""
_TOP = 1.1
"""Upper limit of the axes, over the greatest radius or error."""


@dataclasses.dataclass(frozen=True, eq=False)
class Errors:
    """Errors and radii while one window is in force, both ends included."""

    times: FloatArray
    """times on the scenario's clock [s], shape (M,)"""
    errors: FloatArray
    """error of each vehicle [m, m/s or m/s²], shape (M, N)"""
    radii: FloatArray
    """upper bounds on the errors, shape (M,)"""


def errors_of(simulation: Simulation, quantity: Quantity) -> list[Errors]:
    """Return the errors of each window; both windows have errors at the time of a change."""
    errors, radii = simulation.errors(quantity), simulation.radii(quantity)
    numbers = simulation.in_force(simulation.times)
    found = []
    for number, window in enumerate(simulation.flight.windows):
        here = np.flatnonzero(numbers == number)
        times, of_window, tube = simulation.times[here], errors[here], radii[here]
        if quantity != "acceleration" and len(here) > 0 and here[-1] + 1 < len(numbers):
            end = here[-1] + 1  # the next window's plan begins here, and this one's ends
            at = simulation.times[end]
            plan = window.plan.motion().at(quantity, at - window.plan.scenario.grid.start)[:, 0]
            true = simulation.positions if quantity == "position" else simulation.velocities
            last = np.linalg.norm(true[end] - plan, axis=1)
            times, of_window = np.append(times, at), np.vstack([of_window, last])
            tube = np.append(tube, getattr(simulation.tubes[number], quantity)(at))
        found.append(Errors(times, of_window, tube))
    return found


def greatest_ratio(windows: list[Errors], negligible: float | FloatArray = 0.0) -> float:
    """Return the largest ratio of error, less a negligible part, to radius; 0 without a tube."""
    return max(float(largest_shares(each.errors, each.radii, negligible).max()) for each in windows)


def draw_errors(ax: Axes, simulation: Simulation, quantity: Quantity) -> list[Line2D]:
    """Draw each vehicle's error over time, and the radius of the error tube.

    Args:
        ax: axes to draw in.
        simulation: simulation to draw.
        quantity: position, velocity, or acceleration for the feedback.

    Returns:
        The curves of each window in turn, one for each vehicle, and a ring at the greatest error.
    """
    windows = errors_of(simulation, quantity)
    colours = vehicle_colours(len(simulation.scenario.vehicles))
    lines: list[Line2D] = []
    radii = max(float(each.radii.max()) for each in windows)
    top = _TOP * max(radii, *(float(each.errors.max()) for each in windows)) or 1.0
    for each in windows:
        if radii > 0.0:
            ax.fill_between(each.times, each.radii, top, color=FORBIDDEN, alpha=0.18, linewidth=0)
        ax.plot(each.times, each.radii, color=_TUBE, linewidth=1.0)
        for error, colour in zip(each.errors.T, colours, strict=True):
            lines += ax.plot(each.times, error, color=colour, linewidth=1.0)
    for before, after in pairwise(windows):
        ends = [before.radii[-1], after.radii[0]]
        ax.plot([after.times[0]] * 2, ends, color=_TUBE, linewidth=1.0)
    lines.append(_draw_greatest(ax, simulation, quantity, windows))
    grid = simulation.scenario.grid
    ax.set(xlabel="time [s]", ylabel=LABELS[quantity], ylim=(0, top), xlim=(grid.start, grid.end))
    return lines


def _draw_greatest(
    ax: Axes, simulation: Simulation, quantity: Quantity, windows: list[Errors]
) -> Line2D:
    """Draw a ring at the greatest error, and describe it above the axes with its ratio."""
    each = max(windows, key=lambda window: float(window.errors.max()))
    m, i = np.unravel_index(np.argmax(each.errors), each.errors.shape)
    error, time = each.errors[m, i], each.times[m]
    name = as_text(brief(simulation.scenario.vehicles[int(i)].name))
    label = f"{error:.3g} {UNITS[quantity]} at {time:.4g} s: {name}"
    if any(window.radii.max() > 0.0 for window in windows):
        share = greatest_ratio(windows, rounding_of(simulation, quantity))
        label += f"; at most {100.0 * share:.1f} % of the radius"
    return draw_ring(ax, (float(time), float(error)), label)


def tube_handle() -> Line2D:
    """Return the legend entry of the tube's radii."""
    return Line2D([], [], color=_TUBE, linewidth=1.0, label="tube radius")
