"""Least times from rest to rest under limits of the jerk, beside Ruckig's."""

from __future__ import annotations

import dataclasses

import numpy as np
import ruckig

import drake_rho as rho
from benchmarks.least_times import found
from benchmarks.stopwatch import Taken, median
from benchmarks.tables import Cell, Goal, Table

KNOTS = 80

DRAWS = 200
"""Draws for each number of axes."""

CLOSE = 2e-3
"""Goal: relative difference of T + h from Ruckig's time."""

COLUMNS = (
    "axes",
    "draws",
    "(T + h) / Ruckig - 1, least",
    "median",
    "largest",
    "T / Ruckig - 1, least",
    "without a verified plan",
    "plan, median, processor [s]",
    "plan, median, wall [s]",
)


@dataclasses.dataclass(frozen=True)
class Hop:
    """Motion from rest to rest with limits of each axis."""

    way: tuple[float, ...]
    """from start to goal along each axis [m]"""
    speed: tuple[float, ...]
    """largest of each axis [m/s]"""
    acceleration: tuple[float, ...]
    """largest of each axis [m/s²]"""
    jerk: tuple[float, ...]
    """largest of each axis [m/s³]"""

    @classmethod
    def drawn(cls, rng: np.random.Generator, axes: int) -> Hop:
        """Return a random motion, in which each limit may or may not matter.

        Speeds and accelerations are drawn around those that the jerk alone would reach, in units of
        length and time from millimetres to kilometres.
        """
        length, time = 10.0 ** rng.uniform(-2.0, 3.0), 10.0 ** rng.uniform(-1.0, 2.0)
        way = np.zeros(3)
        way[:axes] = length * rng.uniform(0.1, 1.0, axes) * rng.choice([-1.0, 1.0], axes)
        jerk = length / time**3 * 10.0 ** rng.uniform(-0.5, 0.5, 3)
        reached = np.cbrt(np.maximum(np.abs(way), 1e-3 * length) * jerk**2 / 2.0)  # by jerk alone
        acceleration = reached * rng.uniform(0.3, 1.5, 3)
        reached = (np.maximum(np.abs(way), 1e-3 * length) / 2.0) ** (2 / 3) * np.cbrt(jerk)
        speed = reached * rng.uniform(0.3, 1.5, 3)
        parts = way, speed, acceleration, jerk
        return cls(*(tuple(each.tolist()) for each in parts))

    @property
    def duration(self) -> float:
        """Ruckig's time, the least one of the slowest axis [s]."""
        given = ruckig.InputParameter(3)
        given.current_position, given.target_position = [0.0] * 3, list(self.way)
        given.max_velocity = list(self.speed)
        given.max_acceleration = list(self.acceleration)
        given.max_jerk = list(self.jerk)
        motion = ruckig.Trajectory(3)
        answer = ruckig.Ruckig(3).calculate(given, motion)
        if answer not in (ruckig.Result.Working, ruckig.Result.Finished):
            raise RuntimeError(f"Ruckig: {answer}")
        return float(motion.duration)

    def scenario(self, knots: int = KNOTS) -> rho.Scenario:
        """Return the scenario, whose step is twice as long as it need be."""
        limits = rho.Limits(
            velocity=_box(self.speed), acceleration=_box(self.acceleration), jerk=_box(self.jerk)
        )
        return rho.Scenario(
            "hop",
            rho.Grid(2.0 * self.duration / (knots - 1), knots),
            [rho.Vehicle("one", rho.State([0.0] * 3), rho.State(self.way))],
            limits=limits,
        )


def _box(most: tuple[float, ...]) -> rho.Box:
    return rho.Box([-each for each in most], most)


def run() -> Table:
    """Plan all draws along one axis and along three."""
    rows, apart, faults = list[tuple[Cell, ...]](), list[float](), list[str]()
    for axes in (1, 3):
        longer, alone, times, missing = list[float](), list[float](), list[Taken](), 0
        for seed in range(DRAWS):
            hop = Hop.drawn(np.random.default_rng([axes, seed]), axes)
            mine, known = found(hop.scenario()), hop.duration
            times.append(mine.taken)
            if mine.duration is None:
                missing += 1
                faults.append(f"- {axes} axes, draw {seed}: {mine.words or 'violated'}")
                continue
            longer.append(mine.duration * KNOTS / (KNOTS - 1) / known - 1.0)
            alone.append(mine.duration / known - 1.0)
        spread = np.min(longer), np.median(longer), np.max(longer), np.min(alone)
        rows.append((axes, DRAWS, *map(float, spread), missing, *median(times).both))
        apart += np.abs(longer).tolist()
    missed = ["\n".join(["Without a verified plan:", "", *faults])] if faults else []
    return Table(
        name="time_ruckig",
        title="Least times with limited jerk, beside Ruckig",
        columns=COLUMNS,
        rows=tuple(rows),
        notes=(*missed, _WORK),
        goals=(
            Goal("(T + h) / Ruckig - 1, largest magnitude", CLOSE, max(apart)),
            Goal("draws without a verified plan", 0.0, float(len(faults))),
        ),
        packages=("drake-rho", "drake", "ruckig", "numpy", "scipy"),
    )


_WORK = f"""\
From rest to rest with boxes of velocity, acceleration and jerk, each axis with limits of its own,
on {KNOTS} knots; lengths from a centimetre to a kilometre. Ruckig computes the least time of
motions whose jerk is a step function, in closed form; of three axes it is that of the slowest.
Plans have accelerations that are step functions, so that the jerk (7) is spread over a step, from
the acceleration before the first step, zero at rest, to the one after the last. Averaged over one
step h such a plan is a motion with the same limits that begins h / 2 earlier and ends h / 2 later:
so T + h is never less than Ruckig's time, and T alone is up to a step less."""
