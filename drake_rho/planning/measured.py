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


def tracked_anew(whole: Scenario, left: Scenario) -> Tracking | None:
    """How a plan that begins with what is left of a flight is tracked."""
    if left.disturbance is None:
        return None
    return Tracking(left.grid.start, tube_of(whole).gains, *estimated_within(left))


def estimated_within(scenario: Scenario) -> tuple[float, float]:
    """How far an estimated state may be from the true one [m, m/s]."""
    around = scenario.disturbance
    return (0.0, 0.0) if around is None else around.first_error(scenario.grid)


def tube_and_estimate(tail: Scenario) -> tuple[float, float]:
    """How far an estimated state may be from that of a plan whose rest begins now [m, m/s]."""
    position, velocity = estimated_within(tail)
    if tail.disturbance is None:
        return position, velocity
    tube, now = tube_of(tail), tail.grid.start
    return position + float(tube.position(now)), velocity + float(tube.velocity(now))


def beyond(
    scenario: Scenario,
    away: tuple[FloatArray, FloatArray],
    position: float,
    velocity: float,
    tolerance: float = TOLERANCE,
) -> BoolArray:
    """Which vehicles are further away than radii [m, m/s], but for a part of their scale, (N,)."""
    if not (away[0].any() or away[1].any()):
        return np.zeros(len(away[0]), dtype=bool)
    fleet = scenario.fleet
    far = np.linalg.norm(away[0], axis=1) > position + tolerance * fleet.scale("position")
    fast = np.linalg.norm(away[1], axis=1) > velocity + tolerance * fleet.scale("velocity")
    either: BoolArray = far | fast
    return either
