"""Curves of a plan over time, drawn on given axes: separation, velocities, accelerations.

Times are those of the scenario's clock. Curves show the exact motion, not straight lines from knot
to knot. The knots are marked, unless there are too many vehicles to distinguish. Every function
takes the axes first and returns the artists it has drawn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from drake_rho.display.common.drawable import Drawn, Prediction
from drake_rho.display.common.names import as_text, brief
from drake_rho.display.common.style import (
    COLOURS,
    EXTREMUM_STYLE,
    FORBIDDEN,
    LIMIT_STYLE,
    MAX_NAMED,
    PLANNED_STYLE,
    dense_times,
    vehicle_colours,
    vehicle_marker,
    with_gaps,
)
from drake_rho.display.plots.labels import Labels, along
from drake_rho.display.plots.legends import add_above, width_of
from drake_rho.display.plots.overlapping_curves import marks_every, show_overlapping
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.norms import Norm
from drake_rho.scenario.parts import UNITS, Quantity

_NORM_LABELS: dict[Norm, str] = {
    "max_speed": r"$\Vert v \Vert$ [m/s]",
    "max_acceleration": r"$\Vert a \Vert$ [m/s²]",
    "max_jerk": r"$\Vert j \Vert$ [m/s³]",
    "max_thrust": "thrust [m/s²]",
    "max_tilt": "tilt [rad]",
}

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
    times = plan.scenario.grid.start + found.times
    shown = with_gaps(plan, found.times, found.distances)
    (curve,) = ax.plot(plan.scenario.grid.start + shown[0], shown[1], color=COLOURS[0])
    for piece in plan.planned:
        near = piece.shown.closest_two(separation)
        draw_planned(ax, piece, near.times, near.distances[None])
    m = int(np.argmin(found.distances))
    closest = (vehicles[index].name for index in (found.one[m], found.other[m]))
    names = " and ".join(as_text(brief(name)) for name in closest)
    label = f"{found.distances[m]:.4g} m at {times[m]:.4g} s: {names}"
    (ring,) = ax.plot(times[m], found.distances[m], label=label, **EXTREMUM_STYLE)
    add_above(ax, [ring])
    scaled = "" if separation.downwash == 1.0 else f", z / {separation.downwash:g}"
    ax.set(xlabel="time [s]", ylabel=f"minimum vehicle distance{scaled} [m]")
    # A dense fleet is always close to its limit; on an axis from zero the curve would look flat.
    low, high = min(separation.distance, found.distances[m]), float(found.distances.max())
    span = max(high - low, 0.02 * separation.distance)
    bottom, top = max(0.0, low - 0.5 * span), high + 0.1 * span
    ax.set_ylim(bottom, top)
    draw_limit(ax, separation.distance, f"separation {separation.distance:g} m", bottom)
    ax.set_xlim(plan.scenario.grid.start, plan.scenario.grid.end)
    return [curve, ring]


def draw_components(axes: Sequence[Axes], plan: Drawn, quantity: Quantity) -> list[Line2D]:
    """Draw the components of velocities or accelerations over time with their bounds, one each."""
    times, values, knots, marked = _values_of(plan, quantity)
    values, marked = _rounded(values), _rounded(marked)
    lines = []
    for axis, ax in enumerate(axes):
        lines += [
            draw_curve(ax, plan, i, (times, values[i, :, axis]), (knots, marked[i, :, axis]))
            for i in range(len(values))
        ]
        _finish_component(ax, plan, quantity, axis)
        _widen_flat_range(ax, values)
        _show_overlapping(ax, plan, lines[-len(values) :])
    axes[-1].set_xlabel("time [s]")
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
    times, values, knots, marked = _values_of(plan, limit.kind.quantity)
    norms, at_knots = (_rounded(limit.kind.measured(each)) for each in (values, marked))
    lines = [
        draw_curve(ax, plan, index, (times, norms[index]), (knots, at_knots[index]))
        for index in range(len(norms))
    ]
    ax.set(xlabel="time [s]", ylabel=_NORM_LABELS[norm], ylim=(0, None))
    ax.set_xlim(plan.scenario.grid.start, plan.scenario.grid.end)
    _show_overlapping(ax, plan, lines)
    return lines


def _values_of(
    plan: Drawn, quantity: Quantity
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return times [s] and values (N, M, 3) of a quantity, then the same at the knots.

    Accelerations, and jerks at the knots, are constant in steps.
    """
    grid, begins = plan.scenario.grid, plan.times[:-1]
    if quantity == "velocity":
        times = dense_times(plan)
        exact = np.moveaxis(plan.motion().at("velocity", times), 1, 2)
        times, exact = with_gaps(plan, times, exact)
        return grid.start + times, np.moveaxis(exact, 2, 1), plan.times, plan.velocities
    if quantity == "acceleration":
        ends, steps = plan.commands
    else:
        ends, steps = grid.start + grid.step * (np.arange(grid.knots + 1.0) - 0.5), plan.jerks
    marked = steps[:, grid.clock.last_begun(ends[1:-1], begins) + 1]
    return np.repeat(ends, 2)[1:-1], np.repeat(steps, 2, axis=1), begins, marked


def _rounded(values: FloatArray) -> FloatArray:
    """Round values to the visible digits.

    The last digits differ between processors. They decide whether points are collinear, and so
    would change single pixels.
    """
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    return np.round(values, _DIGITS - math.ceil(math.log10(largest))) if largest else values


def draw_limit(ax: Axes, least: float, name: str, bottom: float = 0.0) -> None:
    """Draw a required distance [m] with its name, and shade the range down to `bottom`."""
    ax.axhspan(bottom, least, color=FORBIDDEN, alpha=0.18, linewidth=0)
    ax.axhline(least, **LIMIT_STYLE)
    Labels.of(ax).add(name, along(ax, least), bbox=None)


def draw_curve(
    ax: Axes,
    plan: Drawn,
    index: int,
    exact: tuple[FloatArray, FloatArray],
    knots: tuple[FloatArray, FloatArray],
) -> Line2D:
    """Draw a vehicle's curve in its colour, with marks at the knots if vehicles are named."""
    colour = vehicle_colours(len(plan.positions))[index]
    name = as_text(plan.scenario.vehicles[index].name)
    (line,) = ax.plot(*exact, color=colour, label=name)
    if len(plan.positions) <= MAX_NAMED:
        every = marks_every(len(knots[0]), width_of(ax))
        ax.plot(
            *(each[::every] for each in knots),
            color=colour,
            linestyle="none",
            marker=vehicle_marker(index),
            markersize=2.4,
            clip_on=False,  # whole marks at both ends of the flight
        )
    return line


def draw_planned(
    ax: Axes, piece: Prediction, times: FloatArray, values: FloatArray
) -> list[Line2D]:
    """Draw a window's planned values for each vehicle as dotted lines.

    Args:
        ax: axes to draw in.
        piece: prediction whose part in force is drawn.
        times: times since its first knot [s], shape (M,) or (N, M).
        values: values of all vehicles at these times, shape (N, M).
    """
    start, colours = piece.shown.scenario.grid.start, vehicle_colours(len(values))
    lines = []
    for each, at, colour in zip(values, np.broadcast_to(times, values.shape), colours, strict=True):
        shown = piece.in_force(at)
        lines += ax.plot(start + at[shown], each[shown], color=colour, **PLANNED_STYLE)
    return lines


def _show_overlapping(ax: Axes, plan: Drawn, lines: Sequence[Line2D]) -> None:
    """Make overlapping curves visible, if vehicles are named."""
    if len(plan.positions) <= MAX_NAMED:
        show_overlapping(ax, lines)


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


def _finish_component(ax: Axes, plan: Drawn, quantity: Quantity, axis: int) -> None:
    for vehicle in plan.scenario.vehicles:
        box = getattr(plan.scenario.limits_of(vehicle), quantity)
        if box is not None:
            ax.axhline(box.lower[axis], **LIMIT_STYLE)
            ax.axhline(box.upper[axis], **LIMIT_STYLE)
    ax.set_ylabel(f"${quantity[0]}_{'xyz'[axis]}$ [{UNITS[quantity]}]")
    ax.set_xlim(plan.scenario.grid.start, plan.scenario.grid.end)
