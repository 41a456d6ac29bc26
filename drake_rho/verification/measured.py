"""Verification of measured states by themselves, at the times of the samples only.

A sample is judged by the distance functions of the records: boxes and limits of positions and
velocities, requirements, obstacles while they are known and active, and the separation of vehicles
that were seen at the same time. It counts as it was measured, without an error radius. A vehicle
that was not seen neither fails nor holds, and nothing is said about the time between samples.

Goals, waypoints and what is required there are not judged: they are met at instants that need not
have a sample. So are accelerations and jerks, which are not measured.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.motion.deviations import Deviations, largest_deviation
from drake_rho.motion.flight import Flight
from drake_rho.scenario.clock import clock_number, clock_time
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.pairs import nearest_others
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import TOLERANCE, Scenario
from drake_rho.verification.boxes import box_column, box_constrained
from drake_rho.verification.check import MEASURED, Column
from drake_rho.verification.highest_over_time import Highest
from drake_rho.verification.norms import length_constrained, norm_column
from drake_rho.verification.obstacles import (
    Nearest,
    distance_from_box,
    least_at,
    obstacle_column,
)
from drake_rho.verification.requirements import requirement_column, requirement_constrained
from drake_rho.verification.separation import Closest, separation_column
from drake_rho.verification.trajectory import PiecewiseTrajectory
from drake_rho.verification.tubes import NO_ERRORS, Tubes

_NAMED = 3
"""Largest number of vehicles that a note names."""


def check_measured(trajectory: PiecewiseTrajectory, flight: Flight) -> Iterator[Column]:
    """Yield the checks of measured states, all required unless the limit is soft.

    Args:
        trajectory: motion of the flight, whose scenario has the requirements.
        flight: flight with measurements, or without.
    """
    samples = Deviations.of(flight)
    if samples is None or not samples.seen.any():
        return
    yield from _check_sets(trajectory, samples)
    scenario = trajectory.scenario
    for number in range(1, len(scenario.bodies) + 1):
        yield _check_obstacle(scenario, number, samples)
    if scenario.separation is not None and len(scenario.vehicles) > 1:
        closest = _closest(scenario.separation.scaled(samples.positions), samples)
        yield separation_column(scenario, scenario.separation, MEASURED, closest)


def _check_sets(trajectory: PiecewiseTrajectory, samples: Deviations) -> Iterator[Column]:
    """Yield the checks of boxes, of limits on the speed, and of requirements."""
    scenario, fleet = trajectory.scenario, trajectory.scenario.fleet
    unknown: dict[Quantity, BoolArray] = {
        "position": ~samples.seen,
        "velocity": np.isnan(samples.velocities[..., 0]),
    }
    values: dict[Quantity, FloatArray] = {
        "position": np.nan_to_num(samples.positions),  # a user's set may refuse NaN
        "velocity": np.nan_to_num(samples.velocities),
    }
    times = samples.elapsed
    for quantity, unseen in unknown.items():
        if (box := fleet.bounds(quantity)) is not None:
            constrained = box_constrained(trajectory, quantity, box)
            greatest = constrained.at_samples(times, values[quantity], unseen)
            yield box_column(scenario, quantity, MEASURED, box, greatest)
    for limit in fleet.norms.values():
        if limit.kind.quantity == "velocity":
            constrained = length_constrained(trajectory, limit)
            found = constrained.at_samples(times, values["velocity"], unknown["velocity"])
            found = Highest(scenario.grid.start + found.times, found.values, found.errors)
            column = norm_column(limit, found, limit.limits, limit.sets.tolerances, MEASURED)
            yield column.where(np.isfinite(found.values))
    for number, required in enumerate(scenario.required, start=1):
        at_instant = required.is_goal or required.at_waypoint
        if at_instant or required.quantity not in values or not required.interval(scenario.grid):
            continue
        constrained = requirement_constrained(trajectory, required)
        quantity = required.quantity
        found = constrained.at_samples(times, values[quantity], unknown[quantity])
        known = np.zeros(len(scenario.vehicles), dtype=bool)
        known[constrained.members] = ~np.isneginf(found.values)
        yield requirement_column(constrained, number, found, MEASURED).where(known)


def _check_obstacle(scenario: Scenario, number: int, samples: Deviations) -> Column:
    """Return the check of distances from where an obstacle may be, once it is known."""
    grid, obstacle = scenario.grid, scenario.bodies_in_flight[number - 1]
    here = obstacle.is_active(samples.elapsed, grid.clock)
    if number not in {known for known, _ in scenario.known}:
        here &= ~grid.clock.before(samples.elapsed, obstacle.known_from)
    times, seen = samples.elapsed[here], samples.seen[:, here]
    count = len(seen)
    found = Nearest(np.zeros(count), np.full(count, np.inf), np.zeros(count))
    if seen.any():
        x = np.nan_to_num(samples.positions[:, here]) - obstacle.centers(times)
        uncertainty = obstacle.uncertainty(times)
        at_least = np.where(seen, distance_from_box(x, obstacle.shape.extent) - uncertainty, np.inf)
        k, distances = least_at(obstacle.shape, x, at_least, uncertainty)
        distances = np.where(seen.any(axis=1), distances, np.inf)
        found = Nearest(times[k], distances, np.zeros(count))
    column = obstacle_column(scenario, number, MEASURED, found)
    return column.softened(obstacle.prices(scenario.fleet.weights), counted=False)


def _closest(scaled: FloatArray, samples: Deviations) -> Closest:
    """Return the closest approach of each vehicle to another one that was seen at that time.

    Args:
        scaled: positions, scaled so that the separation is round [m], shape (N, M, 3).
        samples: measurements in the flight.
    """
    count = len(scaled)
    partners: IntArray = np.zeros(count, dtype=np.int64)
    times, distances = np.zeros(count), np.full(count, np.inf)
    for m in np.flatnonzero(samples.seen.sum(axis=0) > 1).tolist():
        who = np.flatnonzero(samples.seen[:, m])
        away, others = nearest_others(scaled[who, m])
        closer = away < distances[who]
        closest = who[closer]
        partners[closest], distances[closest] = who[others[closer]], away[closer]
        times[closest] = samples.elapsed[m]
    return Closest(partners, times, distances, np.zeros(count))


def notes_on_measured(flight: Flight) -> tuple[str, ...]:
    """Return notes on the measurements of a flight: how many, how far from the planned motion.

    With a disturbance it is told whether all are in the error tube, enlarged by the errors of the
    estimate.
    """
    samples, deviation = Deviations.of(flight), largest_deviation(flight)
    if samples is None:
        return ()
    if deviation is None:
        return ("no vehicle was measured during the flight",)
    names, counts = flight.scenario.names, samples.seen.sum(axis=1).tolist()
    fewest = sorted(sorted(range(len(names)), key=lambda i: counts[i])[:_NAMED])
    listed = ", ".join(f"{names[i]} {counts[i]} times" for i in fewest)
    more = f", {len(names) - _NAMED} more at least as often" if len(names) > _NAMED else ""
    first, last = (flight.scenario.grid.start + t for t in samples.elapsed[[0, -1]].tolist())
    times = f"from {clock_number(first)} to {clock_time(last)}"
    later = f"; {samples.later} after the end are not judged" if samples.later else ""
    return (
        f"measured: {listed}{more}, {times}{later}",
        "largest deviation of a measured sample from the planned motion: that of "
        f"{deviation.vehicle} at {clock_time(deviation.time)}, by {deviation}",
        *_outside_tube(flight, samples),
    )


def _outside_tube(flight: Flight, samples: Deviations) -> Iterator[str]:
    """Yield a note on vehicles measured outside the tube, and when first; or on none of them."""
    scenario, tubes = flight.scenario, Tubes.of(flight)
    if (disturbance := scenario.disturbance) is None or tubes is NO_ERRORS:
        return
    times = scenario.grid.start + samples.elapsed
    quantities: tuple[Quantity, ...] = ("position", "velocity")
    estimated = disturbance.position_error, disturbance.velocity_error
    outside = np.zeros(samples.seen.shape, dtype=bool)
    for quantity, error, off in zip(quantities, estimated, samples.from_planned, strict=True):
        negligible = TOLERANCE * scenario.fleet.scale(quantity)[:, None]
        outside |= off > tubes.at(quantity, times) + error + negligible  # false for NaN
    if not outside.any():
        yield "all measured samples are within the error tube and the errors of the estimate"
        return
    firsts = {i: times[np.argmax(outside[i])] for i in np.flatnonzero(outside.any(axis=1)).tolist()}
    order = sorted(firsts, key=lambda i: firsts[i])
    texts = [f"{scenario.names[i]} from {clock_time(firsts[i])}" for i in order]
    more = f" and {len(texts) - _NAMED} more" if len(texts) > _NAMED else ""
    yield (
        "measured outside the error tube, with the errors of the estimate: "
        f"{', '.join(texts[:_NAMED])}{more}"
    )
