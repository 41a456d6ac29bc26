"""Curves of a plan over time, drawn on given axes: separation, velocities, accelerations.

Times are those of the scenario's clock. Curves show the exact motion, not straight lines from knot
to knot. The knots are marked, unless there are too many vehicles to distinguish. Every function
takes the axes first and returns the artists it has drawn.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from drake_rho.display.common import measured
from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.minima import Minima
from drake_rho.display.common.names import as_text, brief
from drake_rho.display.common.style import COLOURS, LIMIT_STYLE, dense_times, with_gaps
from drake_rho.display.plots.panels import (
    draw_curve,
    draw_limit,
    draw_measured,
    draw_minimum,
    draw_planned,
    finish,
    mark_knots,
)
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.norms import Kind, Norm
from drake_rho.scenario.parts import UNITS, Quantity

_NO_CHANGE = 1e-6
"""Relative range of a component that is only rounding, over the largest value of all."""
_DIGITS = 6
"""Significant digits of drawn values, counted from the largest value."""
_FLAT_RANGE = 0.05
"""Half the axis range of a component without changes, over the largest value of all."""


def draw_separation(ax: Axes, plan: Drawn) -> list[Line2D]:
    """Draw the exact minimum distance between vehicles over time, with the required separation.

    Distances are measured as for the separation: z is divided by its downwash factor.

    Args:
        ax: axes to draw in.
        plan: motion to draw.

    Returns:
        The curve, and a ring at the closest approach; its label names the two vehicles.

    Raises:
        ValueError: the scenario has no separation, or only one vehicle.
    """
    separation, vehicles = plan.scenario.separation, plan.scenario.vehicles
    if separation is None or len(vehicles) < 2:
        got = "none" if separation is None else "one for a single vehicle"
        raise ValueError(f"separation: got {got}, expected one and at least two vehicles")
    found = plan.closest_two(separation)
    times, distances = with_gaps(plan, found.times, found.distances)
    (curve,) = ax.plot(plan.scenario.grid.start + times, distances, color=COLOURS[0])
    for piece in plan.planned:
        near = piece.shown.closest_two(separation)
        draw_planned(ax, piece, near.times, near.distances[None])
    samples = np.full(1, np.nan)
    if plan.measured is not None:
        samples = measured.closest_two(separation, plan.measured)
        draw_measured(ax, plan, samples[None])
    least = Minima(found.one, found.times, found.distances).least
    other = as_text(brief(vehicles[found.other[least.row]].name))
    ring = draw_minimum(ax, plan, least, f" and {other}")
    scaled = "" if separation.downwash == 1.0 else f", z / {separation.downwash:g}"
    ax.set_ylabel(f"minimum vehicle distance{scaled} [m]")
    # A dense fleet is always close to its limit; on an axis from zero the curve would look flat.
    low = float(np.nanmin([separation.distance, least.value, *samples]))
    high = float(np.nanmax([found.distances.max(), *samples]))
    span = max(high - low, 0.02 * separation.distance)
    bottom, top = max(0.0, low - 0.5 * span), high + 0.1 * span
    ax.set_ylim(bottom, top)
    draw_limit(ax, separation.distance, f"separation {separation.distance:g} m", bottom)
    finish(ax, plan, [])
    return [curve, ring]


def draw_components(axes: Sequence[Axes], plan: Drawn, quantity: Quantity) -> list[Line2D]:
    """Draw the components of velocities or accelerations over time with their bounds, one each."""
    sampled = _values_of(plan, quantity)
    values, marked = _rounded(sampled.values), _rounded(sampled.at_knots)
    lines = []
    for axis, ax in enumerate(axes):
        own = _draw(ax, plan, sampled, values[..., axis], marked[..., axis])
        for vehicle in plan.scenario.vehicles:
            box = getattr(plan.scenario.limits_of(vehicle), quantity)
            if box is not None:
                ax.axhline(box.lower[axis], **LIMIT_STYLE)
                ax.axhline(box.upper[axis], **LIMIT_STYLE)
        if plan.measured is not None and quantity == "velocity":
            draw_measured(ax, plan, plan.measured.velocities[..., axis])
        ax.set_ylabel(f"${quantity[0]}_{'xyz'[axis]}$ [{UNITS[quantity]}]")
        _widen_flat_range(ax, values)
        finish(ax, plan, own)
        lines += own
    return lines


def draw_norm(ax: Axes, plan: Drawn, norm: Norm) -> list[Line2D]:
    """Draw the quantity of a limit on a norm over time, for each vehicle, with the limits.

    Args:
        ax: axes to draw in.
        plan: motion to draw.
        norm: the field of `Limits`; at least one vehicle has such a limit.
    """
    limit = plan.scenario.fleet.norms[norm]
    for most in np.unique(limit.limits[np.isfinite(limit.limits)]):
        ax.axhline(most, **LIMIT_STYLE)
    sampled = _values_of(plan, limit.kind.quantity)
    lengths = (limit.kind.measured(each) for each in (sampled.values, sampled.at_knots))
    lines = _draw(ax, plan, sampled, *map(_rounded, lengths))
    if plan.measured is not None and limit.kind.quantity == "velocity":
        draw_measured(ax, plan, limit.kind.measured(plan.measured.velocities))
    ax.set(ylabel=_label(limit.kind), ylim=(0, None))
    finish(ax, plan, lines)
    return lines


def _label(kind: Kind) -> str:
    """Return the axis label of a limited measure: its name, or the norm of its quantity."""
    norm = rf"$\Vert {kind.quantity[0]} \Vert$"
    return f"{norm if kind.measure == 'norm' else kind.what} [{kind.unit}]"


@dataclasses.dataclass(frozen=True, eq=False)
class _Sampled:
    """Values of a quantity over time, on the scenario's clock."""

    times: FloatArray
    """times [s], shape (M,)"""
    values: FloatArray
    """values, shape (N, M, 3)"""
    knots: FloatArray
    """times of marked knots [s], shape (K,)"""
    at_knots: FloatArray
    """values at these, shape (N, K, 3)"""


def _values_of(plan: Drawn, quantity: Quantity) -> _Sampled:
    """Return the values of a quantity. Accelerations, and jerks at knots, are constant in steps."""
    grid, begins = plan.scenario.grid, plan.times[:-1]
    if quantity == "velocity":
        times = dense_times(plan)
        exact = np.moveaxis(plan.motion().at("velocity", times), 1, 2)
        times, exact = with_gaps(plan, times, exact)
        return _Sampled(grid.start + times, np.moveaxis(exact, 2, 1), plan.times, plan.velocities)
    if quantity == "acceleration":
        ends, steps = plan.commands
    else:
        ends, steps = grid.start + grid.step * (np.arange(grid.knots + 1.0) - 0.5), plan.jerks
    marked = steps[:, grid.clock.last_begun(ends[1:-1], begins) + 1]
    return _Sampled(np.repeat(ends, 2)[1:-1], np.repeat(steps, 2, axis=1), begins, marked)


def _draw(
    ax: Axes, plan: Drawn, sampled: _Sampled, values: FloatArray, marked: FloatArray
) -> list[Line2D]:
    """Draw each vehicle's values (N, M) at the sampled times, and marks (N, K) at the knots."""
    lines = []
    for index in range(len(values)):
        lines.append(draw_curve(ax, plan, index, sampled.times, values[index]))
        mark_knots(ax, plan, index, sampled.knots, marked[index])
    return lines


def _rounded(values: FloatArray) -> FloatArray:
    """Round values to the visible digits.

    The last digits differ between processors. They decide whether points are collinear, and so
    would change single pixels.
    """
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    return np.round(values, _DIGITS - math.ceil(math.log10(largest))) if largest else values


def _widen_flat_range(ax: Axes, values: FloatArray) -> None:
    """Widen the range of axes with constant curves, which rounding would fill otherwise.

    Args:
        ax: axes of one component.
        values: all components of all vehicles.
    """
    low, high = ax.get_ylim()
    largest = float(np.max(np.abs(values), initial=0.0))
    if high - low < _NO_CHANGE * largest:
        middle = (low + high) / 2.0
        ax.set_ylim(middle - _FLAT_RANGE * largest, middle + _FLAT_RANGE * largest)
