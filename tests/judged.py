"""What plans violate, by dense samples and formulas of the tests' own.

Of the package, only the signed distances of maps and of sets that a scenario names are used, and
the smooth motion of plans with a smoothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

import drake_rho as rho
from tests.requirements import GRAVITY, of_track
from tests.sampled import _center, _signed_distance, _uncertainty, flown

Array = np.ndarray

ALLOWED = 1e-5
"""Violation that counts as rounding, as a part of what is judged: ten times the verifier's."""

UP = np.array([0.0, 0.0, GRAVITY])
"""Thrust of hovering per unit mass [m/s²]."""

_SAMPLES = 64
"""Samples of each step."""

_PARTS = 80
"""Samples of each average: their mean is off by a part of 1e-5 of what an acceleration moves."""


def violations(plan: rho.Plan) -> list[str]:
    """Return a line for each requirement that a plan violates at a sample; none if it holds."""
    found = [*_goals(plan), *_limits(plan), *_waypoints(plan)]
    return [*found, *_obstacles(plan), *_separation(plan), *_requirements(plan)]


def _line(what: str, excess: Array | float, scale: float) -> list[str]:
    """Return a line if an excess is above what rounding explains."""
    worst = float(np.max(excess, initial=-np.inf))
    return [f"{what}: {worst:.3g} beyond (scale {scale:.3g})"] if worst > ALLOWED * scale else []


def _times(plan: rho.Plan, *, positions: bool = True) -> Array:
    """Return times since the first knot at which positions and velocities are judged [s]."""
    grid = plan.scenario.grid
    if positions and not plan.scenario.between_knots:
        return np.asarray(grid.elapsed)
    lead = plan.scenario.lead
    return np.linspace(-lead, grid.duration + lead, (grid.knots - 1) * _SAMPLES + 1)


def _at(plan: rho.Plan, of: str, elapsed: Array) -> Array:
    """Return values of a quantity at times since the first knot, (N, M, 3)."""
    scenario = plan.scenario
    grid = scenario.grid
    if scenario.smoothing is not None:
        sampled = plan.at(grid.start + elapsed)
        return np.asarray(getattr(sampled, "accelerations" if of == "thrust" else _FIELDS[of]))
    if of == "position":
        return flown(plan, elapsed)
    k = np.clip((elapsed / grid.step + 1e-9).astype(int), 0, grid.knots - 2)
    a = plan.accelerations[:, k]
    if of == "velocity":
        v = np.array([each.start.velocity for each in scenario.vehicles])[:, None]
        sums = v + grid.step * np.cumsum(
            np.concatenate([np.zeros_like(plan.accelerations[:, :1]), plan.accelerations], axis=1),
            axis=1,
        )
        return np.asarray(sums[:, k] + (elapsed - grid.step * k)[:, None] * a)
    return a


_FIELDS = {"position": "positions", "velocity": "velocities", "acceleration": "accelerations"}


def _scale(plan: rho.Plan, of: str = "position") -> float:
    """Return the size of the flight, or the largest value of another quantity."""
    h = plan.scenario.grid.step
    if of == "position":
        return float(np.ptp(plan.positions, axis=1).max())
    if of == "velocity":
        slow = 1e-3 * _scale(plan) / plan.scenario.grid.duration
        return float(np.abs(plan.velocities).max()) + slow
    largest = float(np.abs(plan.accelerations).max())
    return largest / h if of == "jerk" else largest


def _coordinates(plan: rho.Plan) -> float:
    """Return what rounding of coordinates and of the clock may move positions by [m]."""
    grid = plan.scenario.grid
    clock = 4e-16 * max(abs(grid.start), abs(grid.end)) * 8.0
    return 1e-14 * float(np.abs(plan.positions).max()) + clock * float(
        np.abs(plan.velocities).max()
    )


def _goals(plan: rho.Plan) -> Iterator[str]:
    """Judge that plans end at their goals."""
    end = np.array([plan.scenario.grid.duration])
    stepwise = plan.stepwise() if plan.scenario.smoothing else plan
    for of in ("position", "velocity"):
        if getattr(plan.scenario.objective, f"terminal_{of}") > 0.0:
            continue  # it may be missed at a price
        reached = flown(stepwise, end)[:, -1] if of == "position" else stepwise.velocities[:, -1]
        scale = _scale(plan, of) + 1e5 * _coordinates(plan)
        for i, vehicle in enumerate(plan.scenario.vehicles):
            wanted = None if vehicle.goal is None else getattr(vehicle.goal, of, vehicle.goal)
            if of == "velocity" and _is_set(vehicle.goal):
                wanted = np.zeros(3)  # a set of positions is reached at rest
            off = 0.0 if wanted is None else _beyond(wanted, reached[i])
            yield from _line(f"{vehicle.name} goal {of}", off, scale)


def _beyond(wanted: Any, value: Array) -> float:
    """Return how far a value is outside of a set, or from a point."""
    if _is_set(wanted):
        return float(wanted.signed_distance(value))
    return float(np.abs(value - wanted).max())


def _is_set(value: object) -> bool:
    return hasattr(value, "signed_distance")


def _limits(plan: rho.Plan) -> Iterator[str]:
    """Judge boxes, norms, thrusts, tilts and jerks."""
    scenario, smooth = plan.scenario, plan.scenario.smoothing is not None
    for i, vehicle in enumerate(scenario.vehicles):
        limits = scenario.limits_of(vehicle)
        for of in ("position", "velocity", "acceleration", "jerk"):
            bounds = getattr(limits, of)
            if bounds is None or (of == "jerk" and smooth):
                continue
            x = _jerks(plan)[i] if of == "jerk" else _at(plan, of, _times(plan))[i]
            over = np.maximum(x - bounds.upper, bounds.lower - x)
            off = 1e5 * _coordinates(plan) if of == "position" else 0.0
            yield from _line(
                f"{vehicle.name} {of} box", over, float(np.max(bounds.upper - bounds.lower)) + off
            )
        for field, of in (
            ("max_speed", "velocity"),
            ("max_acceleration", "acceleration"),
            ("max_thrust", "thrust"),
            ("max_jerk", "jerk"),
        ):
            most = getattr(limits, field)
            if most is None or (of == "jerk" and smooth):
                continue
            x = _jerks(plan)[i] if of == "jerk" else _at(plan, of, _times(plan, positions=False))[i]
            if of == "thrust":
                x = x + UP
            yield from _line(f"{vehicle.name} {field}", np.linalg.norm(x, axis=-1) - most, most)
        if limits.max_tilt is not None:
            x = _at(plan, "thrust", _times(plan, positions=False))[i] + UP
            tilt = np.arctan2(np.linalg.norm(x[:, :2], axis=-1), x[:, 2])
            beyond = np.linalg.norm(x, axis=-1) * np.sin(tilt - limits.max_tilt)  # of the cone
            yield from _line(f"{vehicle.name} tilt", beyond, GRAVITY)


def _jerks(plan: rho.Plan) -> Array:
    """Return jerks from one step to the next (N, ., 3), with the ends at which states are known."""
    rows = []
    for vehicle, a in zip(plan.scenario.vehicles, plan.accelerations, strict=True):
        known = [a]
        if vehicle.start.acceleration is not None:
            known.insert(0, vehicle.start.acceleration[None])
        elif not np.any(vehicle.start.velocity):
            known.insert(0, np.zeros((1, 3)))
        goal = vehicle.goal
        velocity = np.zeros(3) if _is_set(goal) else getattr(goal, "velocity", None)
        if getattr(goal, "acceleration", None) is not None:
            known.append(goal.acceleration[None])
        elif isinstance(velocity, np.ndarray) and not np.any(velocity):
            known += [np.zeros((1, 3))] * (plan.scenario.objective.terminal_velocity == 0.0)
        jerks = np.diff(np.concatenate(known), axis=0) / plan.scenario.grid.step
        rows.append(np.pad(jerks, ((0, len(a) + 1 - len(jerks)), (0, 0))))
    return np.array(rows)


def _waypoints(plan: rho.Plan) -> Iterator[str]:
    """Judge waypoints at their times."""
    start = plan.scenario.grid.start
    for i, vehicle in enumerate(plan.scenario.vehicles):
        for number, way in enumerate(vehicle.waypoints, start=1):
            if way.time is None:
                yield f"{vehicle.name} waypoint {number}: a plan without its time"
                continue
            x = flown(plan, _averaged_over(plan, way.time - start))[i].mean(axis=0)
            off = float(np.linalg.norm(x - way.position)) - way.within
            scale = _scale(plan) + 1e5 * _coordinates(plan)
            if way.penalty is None:
                yield from _line(f"{vehicle.name} waypoint {number}", off, scale)
            if way.velocity is not None and _is_plain(plan):
                v = _at(plan, "velocity", np.array([way.time - start]))[i, 0]
                over = _beyond(way.velocity, v)
                clock = 4e-16 * abs(way.time) * 1e5 * float(np.abs(plan.accelerations).max())
                limit = _scale(plan, "velocity") + clock
                yield from _line(f"{vehicle.name} velocity at waypoint {number}", over, limit)
            if way.dwell > 0.0 and _is_plain(plan):
                yield from _dwell(plan, i, way, f"{vehicle.name} dwell at waypoint {number}")


def _dwell(plan: rho.Plan, vehicle: int, way: rho.Waypoint, label: str) -> Iterator[str]:
    """Judge the rest at a waypoint by samples over its dwell."""
    assert way.time is not None
    begin = way.time - plan.scenario.grid.start
    times = np.linspace(begin, begin + way.dwell, 41)
    if not plan.scenario.between_knots:
        known = plan.scenario.grid.elapsed
        times = known[(known >= begin - 1e-6) & (known <= begin + way.dwell + 1e-6)]
    off = np.linalg.norm(_at(plan, "position", times)[vehicle] - way.position, axis=1) - way.within
    scale = _scale(plan) + 1e5 * _coordinates(plan)
    if way.penalty is None:
        yield from _line(label, off, scale)
    v = _at(plan, "velocity", times)[vehicle]
    clock = 4e-16 * abs(way.time) * 1e5 * float(np.abs(plan.accelerations).max())
    sets = _is_set(way.velocity)
    over = way.velocity.signed_distance(v) if sets else np.linalg.norm(v, axis=1)  # type: ignore[union-attr]
    yield from _line(label, over, _scale(plan, "velocity") + clock)


def _is_plain(plan: rho.Plan) -> bool:
    """Return whether a plan is flown as it is, without averages."""
    return plan.scenario.smoothing is None


def _averaged_over(plan: rho.Plan, time: float) -> Array:
    """Return times of the plan over whose positions a smooth motion is the mean at a time [s].

    Before the start and after the goal the plan is at rest there.
    """
    smoothing, times = plan.scenario.smoothing, np.array([time])
    if smoothing is None:
        return times
    parts = (np.arange(_PARTS) + 0.5) / _PARTS - 0.5
    for _ in range(smoothing.times):
        times = (times[:, None] + smoothing.width * parts).ravel()
    return np.asarray(np.clip(times, 0.0, plan.scenario.grid.duration))


def _obstacles(plan: rho.Plan) -> Iterator[str]:
    """Judge obstacles while they are active and known."""
    scenario, elapsed = plan.scenario, _times(plan)
    clock, radii = scenario.grid.start + elapsed, [each.radius for each in scenario.vehicles]
    x = _at(plan, "position", elapsed)
    for number, body in enumerate(scenario.bodies, start=1):
        if body.known_from > max(scenario.grid.start, 0.0):
            continue
        if body.penalty is not None:
            continue
        first, last = body.active or (-np.inf, np.inf)
        due = (clock >= first) & (clock <= last)
        centres = _center(body, clock)
        if body.track is not None and body.track.after == "goes_on":
            beyond = np.maximum(clock - body.track.times[-1], 0.0)
            centres = centres + beyond[:, None] * body.track.last_velocity
        for i, radius in enumerate(radii):
            if isinstance(body.shape, rho.Sphere | rho.Ellipsoid | rho.Cylinder | rho.Box):
                distance = _signed_distance(x[i] - centres, body.shape)
            else:
                distance = body.shape.local_distance(x[i] - centres)
            least = radius + body.deviation + _uncertainty(body, clock)
            size = min(_scale(plan), float(getattr(body.shape, "size", np.inf))) + radius
            off = 1e5 * _coordinates(plan)
            yield from _line(
                f"{scenario.names[i]} obstacle {number}", (least - distance)[due], size + off
            )


def _separation(plan: rho.Plan) -> Iterator[str]:
    """Judge distances of pairs."""
    apart = plan.scenario.separation
    if apart is None:
        return
    x = _at(plan, "position", _times(plan)) / np.array([1.0, 1.0, apart.downwash])
    for i in range(len(x)):
        for j in range(i):
            short = apart.distance - np.linalg.norm(x[i] - x[j], axis=-1)
            yield from _line(f"pair {i}, {j}", short, apart.distance + 1e5 * _coordinates(plan))


def _requirements(plan: rho.Plan) -> Iterator[str]:
    """Judge requirements by the signed distances of their sets."""
    scenario = plan.scenario
    grid, names = scenario.grid, list(scenario.names)
    for number, asked in enumerate(scenario.requirements, start=1):
        if asked.penalty is not None:
            continue
        first, last = asked.active or (grid.start, grid.end)
        members = asked.vehicles or tuple(n for n in names if n != asked.relative_to)
        for name in members:
            who = names.index(name)
            if asked.between is not None:
                first, last = _leg(plan, who, asked.between)
            partner = names.index(asked.relative_to) if isinstance(asked.relative_to, str) else None
            if asked.of == "jerk":
                if scenario.smoothing is not None:
                    continue
                values, when = _jerks_inside(plan), grid.elapsed[1:-1] + grid.start
            elif asked.of in ("position", "velocity"):
                elapsed = _times(plan)
                # both ends of the interval, beside the samples
                if scenario.between_knots:
                    within = np.clip([first, last], grid.start, grid.end) - grid.start
                    elapsed = np.union1d(elapsed, within)
                values, when = _at(plan, asked.of, elapsed), grid.start + elapsed
            else:
                # not at the knots themselves, where one step ends and the next begins
                elapsed = (np.arange((grid.knots - 1) * _SAMPLES) + 0.5) * grid.step / _SAMPLES
                values, when = _at(plan, asked.of, elapsed), grid.start + elapsed
            own = values[who] if partner is None else values[who] - values[partner]
            if asked.of == "thrust" and partner is None:
                own = own + UP
            if isinstance(asked.relative_to, rho.Track):
                own = own - of_track(asked.relative_to, asked.of, when)
            due = (when >= first) & (when <= last)
            scale = _scale(plan, "acceleration" if asked.of == "thrust" else asked.of)
            size = max(1e-3 * scale, min(scale, float(getattr(asked.set, "size", np.inf))))
            off = 1e5 * _coordinates(plan) if asked.of == "position" else 0.0
            if due.any():
                distance = asked.set.signed_distance(own[due])
                yield from _line(f"{name} requirement {number}", distance, size + off)


def _leg(plan: rho.Plan, vehicle: int, between: tuple[str, str]) -> tuple[float, float]:
    """Return the times of the two ends of a leg [s]."""
    grid = plan.scenario.grid
    ways = {each.name: each.time for each in plan.scenario.vehicles[vehicle].waypoints}
    times = {"start": grid.start, "goal": grid.end} | ways
    first, last = (times[name] for name in between)
    assert first is not None
    assert last is not None
    return float(first), float(last)


def _jerks_inside(plan: rho.Plan) -> Array:
    return np.asarray(np.diff(plan.accelerations, axis=1) / plan.scenario.grid.step)
