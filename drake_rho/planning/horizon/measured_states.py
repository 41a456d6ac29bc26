"""States as they are measured, beside those that are planned: how far apart they may be."""

from __future__ import annotations

import numpy as np

from drake_rho.motion.tube import tube_of
from drake_rho.scenario.disturbance import Tracking
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.records import TOLERANCE, Scenario

ROUNDING = 1e-9
"""Part of a motion's scale by which a state may differ from that of the plan and still count as the
same: what integration adds to it by rounding."""


def tracked_anew(whole: Scenario, left: Scenario, unseen: Scenario | None) -> Tracking | None:
    """Return how a plan that begins with what is left of a flight is tracked.

    Args:
        whole: the flight's scenario, whose feedback goes on.
        left: what is left of it.
        unseen: what is left of the previous plan, where a vehicle was not seen: it may be as far
            from where that has it as the tube reaches, and one tube is for all.
    """
    if left.disturbance is None:
        return None
    first = estimated_within(left)
    if unseen is not None:
        first = max(first[0], within(unseen)[0]), max(first[1], within(unseen)[1])
    return Tracking(left.grid.start, tube_of(whole).gains, *first)


def estimated_within(scenario: Scenario) -> tuple[float, float]:
    """Return how far an estimated state may be from the true one [m, m/s]."""
    around = scenario.disturbance
    return (0.0, 0.0) if around is None else around.first_error(scenario.grid)


def within(tail: Scenario) -> tuple[float, float]:
    """Return how far a vehicle may be from the plan whose rest begins now [m, m/s]."""
    if tail.disturbance is None:
        return 0.0, 0.0
    tube, now = tube_of(tail), tail.grid.start
    return float(tube.position(now)), float(tube.velocity(now))


def off_tube(tail: Scenario, away: tuple[FloatArray, FloatArray]) -> BoolArray:
    """Return which vehicles were estimated further from the plan whose rest begins now than can be.

    Args:
        tail: what is left of the flight as it was planned.
        away: estimated less planned positions [m] and velocities [m/s], shape (N, 3) each.
    """
    if not (away[0].any() or away[1].any()):
        return np.zeros(len(away[0]), dtype=bool)
    (position, velocity), estimate = within(tail), estimated_within(tail)
    return beyond(tail, away, position + estimate[0], velocity + estimate[1])


def beyond(
    scenario: Scenario,
    away: tuple[FloatArray, FloatArray],
    position: float,
    velocity: float,
    tolerance: float = TOLERANCE,
) -> BoolArray:
    """Return which are further away than radii [m, m/s] and a part of their scale, (N,)."""
    if not (away[0].any() or away[1].any()):
        return np.zeros(len(away[0]), dtype=bool)
    fleet = scenario.fleet
    far = np.linalg.norm(away[0], axis=1) > position + tolerance * fleet.scale("position")
    fast = np.linalg.norm(away[1], axis=1) > velocity + tolerance * fleet.scale("velocity")
    either: BoolArray = far | fast
    return either
