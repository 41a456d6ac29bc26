"""Random loops from measured states, with an integration of their own of what was commanded."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from math import comb, factorial
from typing import Any

import numpy as np

import drake_rho as rho
from tests.arrays import FloatArray

ROUNDING = 1e-9
"""Largest difference of two ways to integrate, over the scale of a motion."""
SAMPLES = 40
"""Own samples of each step."""
Motion = Callable[[FloatArray], FloatArray]
"""Function of times since the first knot, shape (T,)."""


@dataclasses.dataclass(frozen=True, eq=False)
class Piece:
    """Motion from one measurement to the next, as it was commanded."""

    begin: float
    """since the flight's first knot [s]"""
    states: FloatArray
    """positions and velocities that it begins with, shape (N, 6)"""
    accelerations: FloatArray
    """commands, step by step [m/s²], shape (N, S, 3)"""
    step: float

    @property
    def end(self) -> float:
        """Time at which it ends, since the flight's first knot [s]."""
        return self.begin + self.step * int(self.accelerations.shape[1])

    def at(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return positions and velocities at times from its begin to its end, (N, T, 3) each.

        A step that begins at b adds the double integral of its acceleration.
        """
        s, h = times - self.begin, self.step
        p = self.states[:, None, :3] + s[:, None] * self.states[:, None, 3:]
        v = np.repeat(self.states[:, None, 3:], len(s), axis=1)
        for k in range(self.accelerations.shape[1]):
            acted = np.clip(s - k * h, 0.0, h)
            a = self.accelerations[:, k : k + 1]
            p = p + (acted * (s - k * h - acted / 2.0))[:, None] * a
            v = v + acted[:, None] * a
        return p, v


@dataclasses.dataclass(frozen=True, eq=False)
class Loop:
    """A flown loop: its horizon, and its motion by an integration of its own."""

    horizon: rho.RecedingHorizon
    pieces: list[Piece]
    jumps: list[tuple[int, FloatArray]]
    """knots at which measurements were off the motion, and by how much, (N, 6)"""
    words: str

    @property
    def flight(self) -> rho.Flight:
        """The record."""
        return self.horizon.flight

    def at(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return own positions and velocities at times since the first knot, (N, T, 3) each.

        At a jump they are those after it. With a smoothing they are averages.
        """
        smoothing = self.horizon.scenario.smoothing
        if smoothing is not None:
            return averages(self.pieces[0], smoothing, times)
        count = len(self.pieces[0].states)
        p, v = np.full((2, count, len(times), 3), np.nan)
        for piece in self.pieces:
            here = times >= piece.begin - 1e-9 * piece.step
            p[:, here], v[:, here] = piece.at(times[here])
        return p, v


def averages(
    piece: Piece, smoothing: rho.Smoothing, times: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return moving averages of a motion from rest, by truncated powers, as `at` does.

    The acceleration is a sum of jumps, each averaged n times: n-fold differences of powers.
    """
    n, w, h = smoothing.times, smoothing.width, piece.step
    still = np.zeros_like(piece.accelerations[:, :1])
    changes = np.diff(np.concatenate([still, piece.accelerations, still], axis=1), axis=1)
    p = np.repeat(piece.states[:, None, :3], len(times), axis=1)
    v = np.zeros_like(p)
    for k in range(changes.shape[1]):
        s = times - piece.begin - k * h
        for j in range(n + 1):
            after = np.maximum(s + (n / 2.0 - j) * w, 0.0)
            sign = (-1.0) ** j * comb(n, j) / w**n
            jump = changes[:, k : k + 1]
            p = p + (sign * after ** (n + 2) / factorial(n + 2))[:, None] * jump
            v = v + (sign * after ** (n + 1) / factorial(n + 1))[:, None] * jump
    return p, v


def random_loop(seed: int) -> Loop | None:
    """Return a loop with a random combination of abilities; None if its scene has no plan."""
    rng = np.random.default_rng(seed)
    scenario, size = _scenario(rng)
    words, options = _options(rng, scenario)
    horizon = rho.RecedingHorizon(scenario, **options)
    grid, knots, as_planned = scenario.grid, list(horizon.knots), rng.random() < 0.2
    kind = rng.choice(["all", "some", "few"])
    steps = horizon.scenario.grid.knots - 1
    begun: list[tuple[int, FloatArray | None]] = []
    jumps: list[tuple[int, FloatArray]] = []
    for number, knot in enumerate(knots):
        if number > 0 and rng.random() < 0.1:
            continue  # a window that never came
        planned = horizon.planned(knot)
        states = np.array(planned)
        off = rng.random() < {"all": 1.0, "some": 0.5, "few": 0.1}[kind]
        if off and not as_planned:
            states = states + _deviation(rng, horizon, knot, size, planned)
        if rng.random() < 0.15:
            states[rng.integers(len(states))] = np.nan
        try:
            window = horizon.step(states, grid.times[knot])
        except (rho.InfeasibleError, rho.SolverError):
            if number > 0:
                raise
            return None
        measured = np.where(np.isnan(states), planned, states)
        goes_on = window.kept
        same = np.abs(measured - planned).max() == 0.0
        goes_on = goes_on or same or scenario.smoothing is not None
        if window.stopping and scenario.disturbance is not None:
            # flown in its old tube, or planned anew from the measured states
            goes_on = bool(np.abs(window.plan.states(0) - planned).max() < 1e-6 * size)
        begun.append((knot, None if goes_on and number > 0 else measured))
        if number == 0:
            start = scenario.fleet.start_states
            if same or scenario.smoothing is not None:
                begun[0] = (knot, np.array(start))
        if not goes_on and not same:
            jumps.append((knot, measured - planned))
    return Loop(horizon, _pieces(horizon, begun, steps), jumps, words)


def _pieces(
    horizon: rho.RecedingHorizon, begun: list[tuple[int, FloatArray | None]], steps: int
) -> list[Piece]:
    h = horizon.scenario.grid.step
    ends = [knot for knot, _ in begun[1:]] + [steps]
    pieces: list[Piece] = []
    for (knot, states), end, window in zip(begun, ends, horizon.windows, strict=True):
        commands = window.plan.accelerations[:, : end - knot]
        if states is None:
            last = pieces.pop()
            joined = np.concatenate([last.accelerations, commands], axis=1)
            pieces.append(Piece(last.begin, last.states, joined, h))
        else:
            pieces.append(Piece(h * knot, states, commands, h))
    return pieces


def _deviation(
    rng: np.random.Generator,
    horizon: rho.RecedingHorizon,
    knot: int,
    size: float,
    planned: FloatArray,
) -> FloatArray:
    """Return how far vehicles are from their plans: in the tube if there is one, or by anything."""
    scenario = horizon.scenario
    count, seconds = len(planned), scenario.grid.duration
    directions = rng.normal(size=(2, count, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    away = 10.0 ** rng.uniform(-5.0, -1.7) * size
    rates = away / seconds, away
    if scenario.disturbance is not None and horizon.windows and rng.random() < 0.8:
        window = horizon.windows[-1]
        tube, now = rho.error_tube(window.plan.scenario), scenario.grid.times[knot]
        part = rng.uniform(0.0, 0.95)
        rates = part * float(tube.velocity(now)), part * float(tube.position(now))
    changes = np.concatenate([rates[1] * directions[0], rates[0] * directions[1]], axis=1)
    if rng.random() < 0.3:
        changes[rng.integers(count)] = 0.0
    return np.asarray(changes)


def _options(rng: np.random.Generator, scenario: rho.Scenario) -> tuple[str, dict[str, Any]]:
    every = int(rng.integers(1, 5))
    options: dict[str, Any] = {"replan_every": every}
    if rng.random() < 0.25 and scenario.smoothing is None:
        options["free_final_time"] = True
    if rng.random() < 0.3 and scenario.smoothing is None:
        options["contingencies"] = True
    if rng.random() < 0.3:
        options["latency"] = float(rng.uniform(0.0, 1.0)) * every * scenario.grid.step
    words = f"{scenario.disturbance and 'disturbed'} {scenario.smoothing} {options}"
    return words, options


def _scenario(rng: np.random.Generator) -> tuple[rho.Scenario, float]:
    """Return a random scene, and its size [m]."""
    size = float(10.0 ** rng.uniform(-1.0, 3.0))
    seconds = float(rng.uniform(3.0, 9.0))
    start = float(rng.choice([0.0, 12.5, 1.7e9]))
    knots = int(rng.integers(12, 31))
    step = seconds / (knots - 1)
    count = int(rng.integers(1, 4))
    pace = size / seconds
    vehicles = [
        rho.Vehicle(
            f"v{i}",
            rho.State([0.0, 0.25 * size * i, 0.0]),
            rho.State([size, 0.25 * size * ((i + 1) % count), 0.1 * size]),
            radius=0.01 * size * float(rng.uniform(0.0, 1.0)),
            waypoints=[
                rho.Waypoint(
                    time=start + step * int(rng.integers(3, knots - 3)),
                    position=[0.5 * size, 0.25 * size * i, 0.25 * size],
                    within=0.1 * size,
                )
            ]
            if rng.random() < 0.2
            else [],
        )
        for i in range(count)
    ]
    obstacles: list[rho.Obstacle] = []
    for _ in range(int(rng.integers(0, 3))):
        place = size * np.array([rng.uniform(0.3, 0.7), rng.uniform(-0.2, 0.9), 0.05])
        moves = rng.random() < 0.5
        shape = rho.Sphere(place, float(rng.uniform(0.04, 0.1)) * size)
        known = start + seconds * float(rng.uniform(0.1, 0.5)) if rng.random() < 0.3 else 0.0
        speed = pace * rng.normal(size=3) * 0.1 if moves else np.zeros(3)
        active = None
        if rng.random() < 0.2:
            active = (start + seconds * 0.2, start + step * int(rng.integers(6, knots)))
        track = rho.Track([start, start + seconds], [place, place + seconds * speed])
        obstacles.append(
            rho.Obstacle(shape, track=track if moves else None, known_from=known, active=active)
        )
    disturbance = smoothing = None
    if rng.random() < 0.5:
        wind = 0.1 * size / seconds**2 * float(rng.uniform(0.1, 1.0))
        error = float(rng.choice([0.0, 1e-3])) * size
        disturbance = rho.Disturbance(
            wind,
            position_error=error,
            velocity_error=error / seconds,
            feedback_every=step / int(rng.integers(1, 4)),
            delay=int(rng.integers(0, 2)),
        )
    if rng.random() < 0.2:
        smoothing = rho.Smoothing(step * float(rng.uniform(0.3, 1.0)), int(rng.integers(1, 4)))
    scenario = rho.Scenario(
        "loop",
        rho.Grid(step, knots, start),
        vehicles,
        rho.Limits(max_speed=4.0 * pace, max_acceleration=16.0 * pace / seconds),
        obstacles=obstacles,
        separation=rho.Separation(0.08 * size) if count > 1 else None,
        disturbance=disturbance,
        smoothing=smoothing,
        between_knots=smoothing is not None or bool(rng.random() < 0.8),
    )
    return scenario, size


def off_record(loop: Loop) -> float:
    """Return how far the record is from the own integration, over the scales of the motion."""
    flight, scenario = loop.flight, loop.flight.scenario
    grid, fleet = scenario.grid, scenario.fleet
    parts = np.arange(SAMPLES) / SAMPLES
    times = np.append((grid.elapsed[:-1, None] + grid.step * parts).ravel(), grid.elapsed[-1])
    p, v = loop.at(times)
    found = flight.sampled(times)
    away = np.abs(found.positions - p).max(axis=(1, 2)) / fleet.scale("position")
    fast = np.abs(found.velocities - v).max(axis=(1, 2)) / fleet.scale("velocity")
    return float(max(away.max(), fast.max()))


def closed_pieces(loop: Loop) -> Iterator[tuple[FloatArray, Motion]]:
    """Yield sample times of each piece, both of its ends included, and its positions at times.

    Among the times are those at which obstacles become known or active, or cease to be.
    """
    scenario = loop.flight.scenario
    clock = [end for each in scenario.bodies for end in (each.known_from, *(each.active or ()))]
    ends = np.array(clock) - scenario.grid.start
    for piece in loop.pieces:
        begin, end, steps = piece.begin, piece.end, piece.accelerations.shape[1]
        begin, end = begin - scenario.lead, end + scenario.lead
        times = np.linspace(begin, end, SAMPLES * steps + 1)
        times = np.union1d(times, ends[(ends > begin) & (ends < end)])
        if scenario.smoothing is None:
            yield times, partial(_positions, piece)
        else:
            yield times, partial(_positions, loop)


def _positions(motion: Piece | Loop, times: FloatArray) -> FloatArray:
    return motion.at(times)[0]


def least_of(values: Motion, times: FloatArray) -> FloatArray:
    """Return the least of each row of values at times, (N, T), sampled again around it, (N,)."""
    coarse = values(times)
    least = coarse.min(axis=1)
    for row, k in enumerate(np.argmin(coarse, axis=1)):
        near = times[max(k - 1, 0)], times[min(k + 1, len(times) - 1)]
        least[row] = min(least[row], values(np.linspace(*near, 801))[row].min())
    return np.asarray(least)


def radii_at(loop: Loop, times: FloatArray, begin: float, end: float) -> FloatArray:
    """Return radii of the tubes of the windows in force in a piece from begin to end, (T,)."""
    scenario = loop.horizon.scenario
    if scenario.disturbance is None:
        return np.zeros(len(times))
    h, start = scenario.grid.step, scenario.grid.start
    firsts = [h * window.first_knot for window in loop.horizon.windows]
    radii = np.zeros(len(times))
    for (first, last), window in zip(
        pairwise([*firsts, np.inf]), loop.horizon.windows, strict=True
    ):
        if first < begin - h / 2.0 or first > end - h / 2.0:
            continue
        here = (times >= first - 1e-9 * h) & (times <= last + 1e-9 * h)
        if begin <= first < begin + h / 2.0:
            here &= times >= begin
        tube = rho.error_tube(window.plan.scenario)
        radii[here] = np.maximum(radii[here], tube.position(start + times[here]))
    return radii


def least_distances(loop: Loop) -> list[tuple[str, str, float, float, bool]]:
    """Return vehicles, constraints, own least distances less errors [m], reported, and if asked.

    Own ones are the least of samples of every piece, both of its ends included. An obstacle that
    becomes known, or active, just at a jump counts from the state after it.
    """
    report, scenario = rho.verify(loop.flight), loop.flight.scenario
    start, near = scenario.grid.start, 1e-6 * scenario.grid.step
    own: dict[tuple[str, str], float] = {}
    known = {number for number, _ in scenario.known}
    for times, positions in closed_pieces(loop):
        errors = partial(radii_at, loop, begin=times[0], end=times[-1])
        for number, body in enumerate(scenario.bodies, start=1):
            first, last = body.active or (-np.inf, np.inf)
            since = -np.inf if number in known else body.known_from
            begin = max(first, since) - start
            counts = (times >= begin - near) & (times <= last - start + near)
            counts &= (times < times[-1] - near) | (abs(times[-1] - begin) > near)
            if not counts.any():
                continue
            assert isinstance(body.shape, rho.Sphere)
            radius = body.shape.radius

            centers = scenario.bodies_in_flight[number - 1].centers  # no clock rounds them

            def left(
                at: FloatArray, centers: Motion = centers, radius: float = radius
            ) -> FloatArray:
                away = np.linalg.norm(positions(at) - centers(at), axis=2)  # noqa: B023
                return np.asarray(away - radius - errors(at))  # noqa: B023

            for name, least in zip(scenario.names, least_of(left, times[counts]), strict=True):
                key = name, scenario.obstacle_name(number)
                own[key] = min(own.get(key, np.inf), float(least))

        def apart(at: FloatArray) -> FloatArray:
            p = positions(at)  # noqa: B023
            away = np.linalg.norm(p[:, None] - p, axis=3)
            away[np.arange(len(p)), np.arange(len(p))] = np.inf
            return np.asarray(away.min(axis=1) - 2.0 * errors(at))  # noqa: B023

        for name, least in zip(scenario.names, least_of(apart, times), strict=True):
            key = name, "separation"
            own[key] = min(own.get(key, np.inf), float(least))
    return [
        (
            each.vehicle,
            each.constraint,
            own[each.vehicle, each.constraint],
            each.value - each.errors,
            each.asked,
        )
        for each in report.checks
        if each.part.endswith("at all times") and (each.vehicle, each.constraint) in own
    ]
