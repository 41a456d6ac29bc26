"""Jumps of flights where windows begin at measured states."""

from __future__ import annotations

import numpy as np

from drake_rho.motion.deviations import Deviation
from drake_rho.motion.plan import Plan
from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import TOLERANCE


def jump_sizes(plan: Plan) -> tuple[FloatArray, FloatArray]:
    """Return the sizes of all jumps of positions [m] and velocities [m/s], (N, J) each.

    A jump at the first knot is from the scenario's starts.
    """
    knots = np.array(plan.jumps, dtype=np.int64)
    before = np.maximum(knots - 1, 0)
    p, v, a = (each[:, before] for each in (plan.positions, plan.velocities, plan.accelerations))
    h = plan.scenario.grid.step
    p, v = p + h * (v + h / 2.0 * a), v + h * a
    if plan.jumps[:1] == (0,):
        p[:, 0], v[:, 0] = plan.scenario.fleet.start_positions, plan.scenario.fleet.start_velocities
    return (
        np.linalg.norm(plan.positions[:, knots] - p, axis=2),
        np.linalg.norm(plan.velocities[:, knots] - v, axis=2),
    )


def largest_jump(plan: Plan) -> Deviation | None:
    """Return the largest jump of a motion; None if there is none beyond rounding.

    It is the one of the position or, where no position jumps, of the velocity.
    """
    if not plan.jumps:
        return None
    fleet, (away, faster) = plan.scenario.fleet, jump_sizes(plan)
    for sizes, scale in ((away, fleet.scale("position")), (faster, fleet.scale("velocity"))):
        if (sizes > TOLERANCE * scale[:, None]).any():
            i, j = np.unravel_index(np.argmax(sizes), sizes.shape)
            return Deviation(
                vehicle=plan.scenario.names[i],
                time=float(plan.times[plan.jumps[j]]),
                position=float(away[i, j]),
                velocity=float(faster[i, j]),
            )
    return None


def check_continuous(plan: Plan, expected: str) -> None:
    """Check that a motion to be flown does not jump.

    Args:
        plan: the motion, such as the record of a flight.
        expected: text of what is expected instead.

    Raises:
        ValueError: it jumps to measured states.
    """
    if (jump := largest_jump(plan)) is not None:
        got = f"a flight that jumps to measured states, as {jump.vehicle} at "
        got += f"{clock_time(jump.time)} by {jump}"
        raise ValueError(f"flown: got {got}, expected {expected}")
