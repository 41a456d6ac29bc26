"""Notes below a report's table: disturbances, tracks that end in motion, and simulations."""

from __future__ import annotations

from collections.abc import Container

import numpy as np

from drake_rho.motion.jumps import largest_jump
from drake_rho.motion.plan import Plan
from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.disturbance import Disturbance
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.parts import Grid, Quantity
from drake_rho.scenario.records import Scenario
from drake_rho.verification.states import POINT_MASS
from drake_rho.verification.trajectory import PiecewiseTrajectory

_SHOWN = 3
"""Largest number of vehicles outside the tube that are named."""

_ROUNDING = 1e-9
"""Rounding error of a motion, relative to its scale."""

_FULL = 1.0 + 1e-6
"""Ratio of error to radius above which an error is outside the tube, beyond rounding."""

_NAMES: dict[Quantity, str] = {
    "position": "position",
    "velocity": "velocity",
    "acceleration": "feedback",
}
"""Name of each quantity that has an error radius."""


def notes_on(trajectory: PiecewiseTrajectory) -> tuple[str, ...]:
    """Return notes on a plan's disturbance and on the errors at its end."""
    disturbance = trajectory.scenario.disturbance
    if disturbance is None:
        return ()
    tube, end = trajectory.tubes.last, trajectory.scenario.grid.end
    position, velocity = float(tube.position(end)), float(tube.velocity(end))
    return (
        f"verified {disturbance_in_words(disturbance, trajectory.scenario.grid)}",
        f"vehicles end within {position:.4g} m and {velocity:.4g} m/s of their goals",
    )


def notes_on_jumps(plan: Plan) -> tuple[str, ...]:
    """Return a note on the largest jump of a flight whose windows began at measured states."""
    if (jump := largest_jump(plan)) is None:
        return ()
    count = len(plan.jumps)
    windows = "1 window" if count == 1 else f"{count} windows"
    return (
        f"{windows} began at measured states off the motion before: its largest jump is that of "
        f"{jump.vehicle} at {clock_time(jump.time)}, by {jump}"
        + ("; no disturbance allows for it" if plan.scenario.disturbance is None else ""),
    )


def notes_on_late_obstacles(scenario: Scenario, violated: Container[str]) -> tuple[str, ...]:
    """Return notes on violated obstacles that become known after the start.

    A plan for the whole flight, made before, does not avoid them.

    Args:
        scenario: scenario of a plan.
        violated: names of the constraints that do not hold.
    """
    known = {number for number, _ in scenario.known}
    return tuple(
        f"{name} becomes known at {clock_time(body.known_from)}, and a plan made before does not "
        "avoid it: replan in flight (`plan_rho`, `drake-rho fly`)"
        for number, body in enumerate(scenario.bodies, start=1)
        if number not in known and (name := scenario.obstacle_name(number)) in violated
    )


def notes_on_separation(scenario: Scenario) -> tuple[str, ...]:
    """Return a note on several vehicles without a separation, whose distances are not limited."""
    if len(scenario.vehicles) == 1 or scenario.separation is not None:
        return ()
    return ("vehicles may collide with each other: the scenario has no separation",)


def notes_on_tracks(scenario: Scenario) -> tuple[str, ...]:
    """Return notes on obstacles whose tracks end, in motion, before the flight does."""
    grid = scenario.grid
    return tuple(
        f"{scenario.obstacle_name(number)} is assumed to be at rest from "
        f"{clock_time(track.times[-1])} on: its track ends before the flight, which ends at "
        f"{clock_time(grid.end)}"
        for number, body in enumerate(scenario.bodies, start=1)
        if (track := body.track) is not None
        and track.after is None
        and grid.clock.before(track.times[-1], grid.end)
        and np.any(track.last_velocity)
    )


def notes_on_uncertainty(scenario: Scenario) -> tuple[str, ...]:
    """Return notes on uncertain obstacles, whose distances allow for every possible position."""
    return tuple(
        f"distances from {scenario.obstacle_name(number)} are from where it may be: "
        f"{_uncertainty(body)}"
        for number, body in enumerate(scenario.bodies, start=1)
        if body.is_uncertain
    )


def _uncertainty(body: Obstacle) -> str:
    """Return an obstacle's uncertainty as text, as '0.2 m off, and 0.1 m/s from 3 s on'."""
    off = [f"{body.position_error:g} m off"] if body.position_error > 0.0 else []
    if body.velocity_error > 0.0:
        since = clock_time(body.errors_from)
        off.append(f"{body.velocity_error:g} m/s from {since} on")
    return ", and ".join(off)


def notes_on_simulation(simulation: Simulation, trajectory: PiecewiseTrajectory) -> tuple[str, ...]:
    """Return notes on a simulation's windows, its errors relative to the tube, and its plant."""
    return tuple(
        note
        for note in (
            _windows(simulation),
            _no_feedback(simulation),
            _outside_tube(simulation),
            _largest_errors(simulation),
            _plant(simulation, trajectory),
        )
        if note
    )


def _windows(simulation: Simulation) -> str:
    windows = simulation.flight.windows
    fallbacks = sum(window.kept for window in windows)
    stops = sum(window.stopping for window in windows)
    without = sum(bool(each.infeasible) for each in windows) - fallbacks - stops
    unprepared = sum(bool(window.no_contingency) for window in windows)
    words = [f"{len(windows)} {'window' if len(windows) == 1 else 'windows'}"]
    if fallbacks > 0:
        words.append(f"{fallbacks} of them kept the previous plan")
    if stops > 0:
        words.append(f"{stops} of them flew a contingency, which brakes to rest")
    if without > 0:
        words.append(f"{without} of them had no plan that meets every constraint")
    if unprepared > 0:
        words.append(f"{unprepared} of them found no contingency")
    return ", ".join(words)


def _no_feedback(simulation: Simulation) -> str:
    """Return a note if nothing corrects deviations from the plan."""
    if simulation.scenario.disturbance is not None:
        return ""
    return "flown without feedback: the scenario has no disturbance"


def _outside_tube(simulation: Simulation) -> str:
    """Return a sentence on vehicles found outside the error tube, and when first."""
    found: dict[str, float] = {}
    for window in simulation.flight.windows:
        for name in window.off_tube:
            found.setdefault(name, window.plan.scenario.grid.start)
    texts = [f"{name} from {clock_time(time)}" for name, time in found.items()]
    more = f" and {len(texts) - _SHOWN} more" if len(texts) > _SHOWN else ""
    return f"outside the error tube: {', '.join(texts[:_SHOWN])}{more}" if texts else ""


def _largest_errors(simulation: Simulation) -> str:
    """Return the largest errors relative to the tube's radii, as a sentence."""
    if simulation.scenario.disturbance is None:
        return ""
    ratios = largest_error_ratios(simulation)
    texts = ", ".join(f"{ratios[quantity]:.3f} ({name})" for quantity, name in _NAMES.items())
    outside = "" if max(ratios.values()) <= _FULL else "; vehicles left the tube"
    return f"largest errors over the tube's radii: {texts}{outside}"


def largest_error_ratios(simulation: Simulation) -> dict[Quantity, float]:
    """Return the largest ratio of error to tube radius, for position, velocity and feedback.

    The motion's rounding errors are subtracted first; else they would count where the radius is
    still zero.
    """
    ratios: dict[Quantity, float] = {}
    for quantity in _NAMES:
        errors, radii = simulation.errors(quantity), simulation.radii(quantity)[:, None]
        least = _ROUNDING * simulation.scenario.fleet.scale(quantity)
        errors = np.maximum(errors - least, 0.0)
        ratio = np.divide(errors, radii, out=np.where(errors > 0.0, np.inf, 0.0), where=radii > 0.0)
        ratios[quantity] = float(ratio.max())
    return ratios


def _plant(simulation: Simulation, trajectory: PiecewiseTrajectory) -> str:
    if simulation.plant == POINT_MASS:
        return ""
    off = float(simulation.tracking_difference.max())
    turned, headings = simulation.heading_errors, ""
    if turned is not None:
        headings = f", and headings from commanded ones by up to {np.rad2deg(turned.max()):.2g}°"
    return (
        f"{simulation.plant}: verified from states recorded every "
        f"{trajectory.durations.max():.3g} s, with accelerations taken as constant between them; "
        f"these differ from commands plus wind by up to {off:.3g} m/s²{headings}"
    )


def disturbance_in_words(disturbance: Disturbance, grid: Grid) -> str:
    """Describe a scenario's disturbance, as in 'for every wind up to 0.3 m/s²'."""
    words = [f"for every wind up to {disturbance.acceleration:g} m/s²"]
    if disturbance.position_error > 0.0 or disturbance.velocity_error > 0.0:
        errors = f"{disturbance.position_error:g} m and {disturbance.velocity_error:g} m/s"
        words.append(f"estimation errors up to {errors}")
    samples = "sample" if disturbance.delay == 1 else "samples"
    delay = f", delayed by {disturbance.delay} {samples}" if disturbance.delay > 0 else ""
    if delay and disturbance.prediction is False:
        delay += " without a prediction"
    words.append(f"feedback every {disturbance.sample(grid):g} s{delay}")
    if disturbance.dropouts > 0:
        words.append(f"up to {disturbance.dropouts} lost measurements in a row")
    return ", ".join(words)
