"""Least times from rest to rest along an axis, beside closed forms."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy.optimize import brentq

import drake_rho as rho
from benchmarks.least_times import found
from benchmarks.tables import Cell, Goal, Table

KNOTS = (11, 21, 41, 81, 161, 2561)

EQUAL = 1e-6
"""Goal: relative difference from the least time on the same knots, and from the closed form on the
most."""

COLUMNS = (
    "speed limit [m/s]",
    "knots",
    "T [s]",
    "closed form [s]",
    "T / closed form - 1",
    "least T on these knots / closed form - 1",
    "T / least T on these knots - 1",
    "plan, processor [s]",
    "plan, wall [s]",
    "verified",
)


@dataclasses.dataclass(frozen=True)
class Straight:
    """Motion along an axis from rest to rest."""

    distance: float
    """d [m]"""
    acceleration: float
    """a, largest along each axis both ways [m/s²]"""
    speed: float = math.inf
    """v, largest [m/s]"""

    @property
    def duration(self) -> float:
        """The least time in closed form [s]."""
        d, a, v = self.distance, self.acceleration, self.speed
        return d / v + v / a if v**2 <= a * d else 2.0 * math.sqrt(d / a)

    def on(self, knots: int) -> float:
        """Return the least time with equal steps of constant acceleration [s].

        The fastest motion of N steps of h has the speed min(k a h, (N - k) a h, v) at each knot k,
        and h times their sum is the farthest that it comes.
        """
        steps = knots - 1
        k = np.arange(1, steps)
        ramps = self.acceleration * np.minimum(k, steps - k)

        def missing(h: float) -> float:
            return h * float(np.sum(np.minimum(ramps * h, self.speed))) - self.distance

        least = self.duration / steps
        return steps * float(brentq(missing, 0.99 * least, 3.0 * least, xtol=1e-15, rtol=1e-14))

    def scenario(self, knots: int) -> rho.Scenario:
        """Return the scenario, whose step is twice as long as it need be."""
        box = rho.Box([-self.acceleration] * 3, [self.acceleration] * 3)
        most = self.speed if math.isfinite(self.speed) else None
        return rho.Scenario(
            "straight",
            rho.Grid(2.0 * self.duration / (knots - 1), knots),
            [rho.Vehicle("one", rho.State([0.0] * 3), rho.State([self.distance, 0.0, 0.0]))],
            limits=rho.Limits(acceleration=box, max_speed=most),
        )


MOTIONS = (Straight(10.0, 2.0), Straight(10.0, 2.0, speed=3.0), Straight(10.0, 2.0, speed=1.1))


def run() -> Table:
    """Plan every motion on every number of knots."""
    found(MOTIONS[0].scenario(KNOTS[0]))  # loading does not count
    rows, off, far, faults = list[tuple[Cell, ...]](), list[float](), list[float](), list[str]()
    for motion in MOTIONS:
        for knots in KNOTS:
            mine = found(motion.scenario(knots))
            least, exact, T = motion.on(knots), motion.duration, mine.duration
            if T is None:
                faults.append(f"- {knots} knots, {motion.speed:g} m/s: {mine.words or 'violated'}")
            else:
                off.append(T / least - 1.0)
                far += [T / exact - 1.0] if knots == max(KNOTS) else []
            rows.append(
                (
                    motion.speed if math.isfinite(motion.speed) else "none",
                    knots,
                    None if T is None else f"{T:.6f}",
                    f"{exact:.6f}",
                    None if T is None else T / exact - 1.0,
                    least / exact - 1.0,
                    None if T is None else T / least - 1.0,
                    *mine.taken.both,
                    mine.holds,
                )
            )
    largest = None if faults else max(map(abs, off))
    furthest = None if faults else max(map(abs, far))
    missing = ["\n".join(["Without a verified plan:", "", *faults])] if faults else []
    return Table(
        name="time_closed_forms",
        title="Least times along an axis, beside closed forms",
        columns=COLUMNS,
        rows=tuple(rows),
        notes=(*missing, _WORK),
        goals=(
            Goal("T / least T on the same knots - 1, largest", EQUAL, largest),
            Goal(f"T / closed form - 1 on {max(KNOTS)} knots, largest", EQUAL, furthest),
            Goal("motions without a verified plan", 0.0, float(len(faults))),
        ),
    )


_WORK = """\
From rest to rest along x, d = 10 m, accelerations up to a = 2 m/s² along each axis: 2 √(d/a)
without a limit on speed, d/v + v/a with one that is reached. With equal steps the fastest motion
has the speeds min(k a h, (N - k) a h, v) at the knots k = 0..N, which gives the least T on these
knots exactly. Without a limit on speed and with an even number of steps N, the change from a to -a
is at a knot, and the closed form is exact; an odd N would take N / √(N² - 1) times as long. With
the limit it is exact if v/(a h) is a whole number; else each of the two corners that the speed cuts
off costs at most a h²/(8 v). The grid that is given lasts twice as long as it need."""
