"""`python casadi_least_time.py TRACKS TIMES`: least times of tracks by CasADi and IPOPT.

It runs in an environment that has CasADi and not this package, and so imports neither the package
nor its benchmarks. A point mass begins and ends at rest, passes waypoints in the order given, and
keeps the norm of a + g e_z within a limit. Accelerations are constant in each step, and positions
and velocities at the knots are variables too (multiple shooting). Both files are JSON:

- TRACKS: a list of records with `waypoints` [m], the start first and the goal last, shape (L + 1,
  3) with L of at least 2; `steps`, those of each leg; `thrust` and `gravity` [m/s²]; and `uniform`:
  whether the step is the same everywhere, so that waypoints lie between knots, or each leg has its
  own.
- TIMES: for each, `time` [s], the least time found; `seconds`, from the record to the answer;
  `programs`, the number of programs; and `error`, how far the motion of the accelerations alone is
  from waypoints, rest and the limit at most, in m, m/s and m/s².
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

OPTIONS: dict[str, Any] = {
    "expand": True,  # scalar expressions, whose derivatives evaluate several times faster
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-9,
    "ipopt.max_iter": 1000,
}

AT_AN_END = 1e-4
"""Part of a step from its end within which a waypoint moves on to the next."""

FALLS = 1e-9
"""Relative fall of the time below which waypoints stay in their steps."""


class Track(NamedTuple):
    """What a motion has to do."""

    waypoints: np.ndarray
    """start, waypoints and goal [m], shape (L + 1, 3)"""
    steps: int
    """steps of each leg"""
    thrust: float
    """largest norm of a + g e_z [m/s²]"""
    gravity: float
    """g [m/s²]"""

    @property
    def legs(self) -> int:
        """Number of legs L."""
        return len(self.waypoints) - 1


class Motion(NamedTuple):
    """Motion through a track with M steps."""

    steps: np.ndarray
    """lengths of the steps [s], shape (M,)"""
    positions: np.ndarray
    """at the knots [m], shape (M + 1, 3)"""
    velocities: np.ndarray
    """at the knots [m/s], shape (M + 1, 3)"""
    accelerations: np.ndarray
    """in each step [m/s²], shape (M, 3)"""
    passed: np.ndarray
    """step in which each waypoint but start and goal is passed, counted from 0, shape (L - 1,)"""
    parts: np.ndarray
    """part of that step that has passed by then, shape (L - 1,)"""

    @property
    def duration(self) -> float:
        """T [s]."""
        return float(np.sum(self.steps))


def straight(track: Track) -> Motion:
    """Return a motion along straight legs that rests at every waypoint, within the limit."""
    room = 0.99 * (track.thrust - track.gravity)  # in any direction
    K = track.steps
    ways = np.diff(track.waypoints, axis=0)
    h = 2.0 * np.sqrt(np.linalg.norm(ways, axis=1) / room) / K
    signs = np.where(np.arange(K) < K // 2, 1.0, -1.0)
    accelerations = [
        4.0 * sign * way / (step * K) ** 2
        for way, step in zip(ways, h, strict=True)
        for sign in signs
    ]
    steps, a = np.repeat(h, K), np.array(accelerations)
    p, v = rolled(track.waypoints[0], steps, a)
    last = K * np.arange(1, track.legs)
    return Motion(steps, p, v, a, last - 1, np.ones(len(last)))


def rolled(start: np.ndarray, h: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and velocities at the knots, from rest, by exact integration."""
    p, v = [start], [np.zeros(3)]
    for step, acceleration in zip(h, a, strict=True):
        p.append(p[-1] + step * v[-1] + step**2 / 2.0 * acceleration)
        v.append(v[-1] + step * acceleration)
    return np.array(p), np.array(v)


def of_legs(track: Track, guess: Motion) -> Motion:
    """Return the fastest motion whose waypoints are knots, each leg with a step of its own."""
    opti, p, v, a = _variables(track, guess)
    h = opti.variable(1, track.legs)
    opti.set_initial(h, guess.steps[:: track.steps])
    each = ca.kron(h, ca.DM.ones(1, track.steps))
    _require_motion(opti, track, (p, v, a), ca.repmat(each, 3, 1))
    opti.subject_to(ca.vec(h) >= 1e-4)
    opti.subject_to(p[:, track.steps : -1 : track.steps] == track.waypoints[1:-1].T)
    opti.minimize(track.steps * ca.sum2(h))
    found = _solved(opti)
    h_found = np.repeat(np.atleast_1d(found.value(h)), track.steps)
    p_found, v_found, a_found = (np.asarray(found.value(x)).T for x in (p, v, a))
    return Motion(h_found, p_found, v_found, a_found, guess.passed, guess.parts)


def of_one_step(track: Track, guess: Motion) -> Motion:
    """Return the fastest motion with one step whose waypoints are in the steps of the guess."""
    opti, p, v, a = _variables(track, guess)
    M = a.shape[1]
    h, s = opti.variable(), opti.variable(1, track.legs - 1)
    opti.set_initial(h, guess.duration / M)
    opti.set_initial(s, guess.parts)
    _require_motion(opti, track, (p, v, a), h)
    opti.subject_to(h >= 1e-4)
    opti.subject_to(opti.bounded(0.0, ca.vec(s), 1.0))
    for j, k in enumerate(guess.passed):
        at = s[j] * h
        passes = p[:, int(k)] + at * v[:, int(k)] + at**2 / 2.0 * a[:, int(k)]
        opti.subject_to(passes == track.waypoints[j + 1])
    opti.minimize(M * h)
    found = _solved(opti)
    h_found, parts = np.full(M, float(found.value(h))), np.atleast_1d(found.value(s))
    p_found, v_found, a_found = (np.asarray(found.value(x)).T for x in (p, v, a))
    return Motion(h_found, p_found, v_found, a_found, guess.passed, np.clip(parts, 0.0, 1.0))


def _variables(track: Track, guess: Motion) -> tuple[ca.Opti, ca.MX, ca.MX, ca.MX]:
    """Return a program and its positions, velocities and accelerations, one a column."""
    opti, M = ca.Opti(), len(guess.steps)
    p, v, a = opti.variable(3, M + 1), opti.variable(3, M + 1), opti.variable(3, M)
    opti.set_initial(p, guess.positions.T)
    opti.set_initial(v, guess.velocities.T)
    opti.set_initial(a, guess.accelerations.T)
    return opti, p, v, a


def _require_motion(
    opti: ca.Opti, track: Track, motion: tuple[ca.MX, ca.MX, ca.MX], h: ca.MX
) -> None:
    """Require the double integrator, the limit, and rest at start and goal."""
    p, v, a = motion
    opti.subject_to(p[:, 1:] == p[:, :-1] + h * v[:, :-1] + h**2 / 2.0 * a)
    opti.subject_to(v[:, 1:] == v[:, :-1] + h * a)
    thrust = a + ca.DM([0.0, 0.0, track.gravity])
    opti.subject_to(ca.vec(ca.sum1(thrust**2)) / track.thrust**2 <= 1.0)
    for values, ends in ((p, track.waypoints), (v, np.zeros((2, 3)))):
        opti.subject_to(values[:, 0] == ends[0])
        opti.subject_to(values[:, -1] == ends[-1])


def _solved(opti: ca.Opti) -> Any:  # CasADi has no types
    opti.solver("ipopt", OPTIONS)
    return opti.solve()


def resampled(track: Track, given: Motion) -> Motion:
    """Return about the same motion with as many steps of equal length."""
    M = len(given.steps)
    times = np.concatenate([[0.0], np.cumsum(given.steps)])
    h = times[-1] / M
    even = h * np.arange(M + 1)
    p, v = (
        np.stack([np.interp(even, times, axis) for axis in values.T], axis=1)
        for values in (given.positions, given.velocities)
    )
    waypoints = times[track.steps : -1 : track.steps]
    passed = np.minimum(np.floor(waypoints / h).astype(int), M - 1)
    return Motion(np.full(M, h), p, v, np.diff(v, axis=0) / h, passed, waypoints / h - passed)


def fastest(track: Track, *, uniform: bool) -> tuple[Motion, int]:
    """Return the fastest motion found and the number of programs that it took.

    With one step, waypoints that reach the end of a step go on to the next and the program is
    solved again, until the time falls no more: the motion before is one of the next program.
    """
    best, programs = of_legs(track, straight(track)), 1
    if not uniform:
        return best, programs
    best, programs = of_one_step(track, resampled(track, best)), 2
    while True:
        moves = (best.parts > 1.0 - AT_AN_END).astype(int) - (best.parts < AT_AN_END)
        passed = np.clip(best.passed + moves, 0, len(best.steps) - 1)
        if np.array_equal(passed, best.passed):
            return best, programs
        guess = best._replace(passed=passed, parts=np.clip(best.parts - moves, 0.0, 1.0))
        found, programs = of_one_step(track, guess), programs + 1
        if found.duration > (1.0 - FALLS) * best.duration:
            return best, programs
        best = found


def error(track: Track, motion: Motion) -> float:
    """Return how far the accelerations alone are from what is required at most."""
    p, v = rolled(track.waypoints[0], motion.steps, motion.accelerations)
    k, at = motion.passed, (motion.parts * motion.steps[motion.passed])[:, None]
    passes = p[k] + at * v[k] + at**2 / 2.0 * motion.accelerations[k]
    hover = np.array([0.0, 0.0, track.gravity])
    thrust = np.linalg.norm(motion.accelerations + hover, axis=1)
    return float(
        max(
            np.abs(passes - track.waypoints[1:-1]).max(initial=0.0),
            np.abs(p[-1] - track.waypoints[-1]).max(),
            np.abs(v[-1]).max(),
            thrust.max() - track.thrust,
        )
    )


def answer(record: dict[str, Any]) -> dict[str, Any]:
    """Return the record of `TIMES` for one of `TRACKS`."""
    began, worked = time.perf_counter(), time.process_time()
    track = Track(
        np.array(record["waypoints"], dtype=float),
        record["steps"],
        record["thrust"],
        record["gravity"],
    )
    found, programs = fastest(track, uniform=record["uniform"])
    return {
        "time": found.duration,
        "seconds": time.perf_counter() - began,
        "processor": time.process_time() - worked,
        "programs": programs,
        "error": error(track, found),
    }


if __name__ == "__main__":
    records = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    answers = [answer(record) for record in records]
    Path(sys.argv[2]).write_text(json.dumps(answers), encoding="utf-8")
