"""What a report says of a disturbance below its table, in words."""

from __future__ import annotations

import numpy as np

from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.disturbance import Disturbance
from drake_rho.scenario.parts import Grid, Quantity
from drake_rho.scenario.records import Scenario
from drake_rho.verification.course import Course
from drake_rho.verification.simulated import POINT_MASS

_SHOWN = 3
"""Vehicles off the tube that are named."""

_ROUNDING = 1e-9
"""Part of a motion's scale that rounding may be off."""

_FULL = 1.0 + 1e-6
"""Part of a radius beyond which an error is outside, and not by rounding."""

_TOLD: dict[Quantity, str] = {
    "position": "position",
    "velocity": "velocity",
    "acceleration": "feedback",
}
"""What has a radius, and what it is called."""


def notes_on(course: Course) -> tuple[str, ...]:
    """What disturbance plans are judged with, and where vehicles end that reach their goals."""
    around, tubes = course.scenario.disturbance, course.tubes
    if around is None or tubes is None:
        return ()
    tube, end = tubes.last, course.scenario.grid.end
    position, velocity = float(tube.position(end)), float(tube.velocity(end))
    return (
        f"judged {disturbance_in_words(around, course.scenario.grid)}",
        f"vehicles end within {position:.4g} m and {velocity:.4g} m/s of their goals",
    )


def notes_on_tracks(scenario: Scenario) -> tuple[str, ...]:
    """Tell of obstacles whose tracks end in motion before the flight does."""
    grid = scenario.grid
    return tuple(
        f"{scenario.obstacle_name(number)} is taken to rest from {clock_time(track.times[-1])} on: "
        f"its track ends before the flight does, at {clock_time(grid.end)}"
        for number, body in enumerate(scenario.bodies, start=1)
        if (track := body.track) is not None
        and track.after is None
        and track.times[-1] < grid.end - grid.rounding
        and np.any(track.last_velocity)
    )


def notes_on_simulation(simulation: Simulation, course: Course) -> tuple[str, ...]:
    """What became of the windows and of the tube in a simulation, and what its plant was."""
    return tuple(
        note
        for note in (
            _windows(simulation),
            _off_tube(simulation),
            _filled(simulation),
            _plant(simulation, course),
        )
        if note
    )


def _windows(simulation: Simulation) -> str:
    windows = simulation.flight.windows
    kept = sum(window.kept for window in windows)
    without = sum(bool(window.infeasible) and not window.kept for window in windows)
    words = [f"{len(windows)} {'window' if len(windows) == 1 else 'windows'}"]
    if kept > 0:
        words.append(f"{kept} of them kept the previous plan")
    if without > 0:
        words.append(f"{without} had none that holds")
    return ", ".join(words)


def _off_tube(simulation: Simulation) -> str:
    """Which vehicles a window found off the tube, and when first."""
    found: dict[str, float] = {}
    for window in simulation.flight.windows:
        for name in window.off_tube:
            found.setdefault(name, window.plan.scenario.grid.start)
    told = [f"{name} from {clock_time(time)}" for name, time in found.items()]
    more = f" and {len(told) - _SHOWN} more" if len(told) > _SHOWN else ""
    return f"off the tube: {', '.join(told[:_SHOWN])}{more}" if told else ""


def _filled(simulation: Simulation) -> str:
    """How much of the tube's radii errors were, at most."""
    if simulation.scenario.disturbance is None:
        return ""
    parts = tube_filled(simulation)
    told = ", ".join(f"{parts[quantity]:.3f} ({name})" for quantity, name in _TOLD.items())
    left = "" if max(parts.values()) <= _FULL else ": vehicles left their tube"
    return f"errors were at most {told} of the tube's radii{left}"


def tube_filled(simulation: Simulation) -> dict[Quantity, float]:
    """The greatest errors over their radii, of position, velocity and feedback.

    Where nothing is allowed yet, a rounding of the motion's coordinates counts as nothing.
    """
    filled: dict[Quantity, float] = {}
    for quantity in _TOLD:
        errors, radii = simulation.errors(quantity), simulation.radii(quantity)[:, None]
        rounding = _ROUNDING * simulation.scenario.fleet.scale(quantity)
        errors = np.maximum(errors - rounding, 0.0)
        parts = np.divide(errors, radii, out=np.where(errors > 0.0, np.inf, 0.0), where=radii > 0.0)
        filled[quantity] = float(parts.max())
    return filled


def _plant(simulation: Simulation, course: Course) -> str:
    if simulation.plant == POINT_MASS:
        return ""
    off = float(simulation.tracking_difference.max())
    return (
        f"{simulation.plant}: judged by its record, every {course.durations.max():.3g} s, as if "
        f"accelerations were constant between; off its commands and the wind by up to {off:.3g} "
        "m/s²"
    )


def disturbance_in_words(around: Disturbance, grid: Grid) -> str:
    """What a scenario says of a disturbance, as in 'for every wind up to 0.3 m/s²'."""
    words = [f"for every wind up to {around.acceleration:g} m/s²"]
    if around.position_error > 0.0 or around.velocity_error > 0.0:
        errors = f"{around.position_error:g} m and {around.velocity_error:g} m/s"
        words.append(f"estimates up to {errors} off")
    late = f", {around.delay} late" if around.delay > 0 else ""
    words.append(f"feedback every {around.sample(grid):g} s{late}")
    return ", ".join(words)
