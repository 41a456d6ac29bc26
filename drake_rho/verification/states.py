"""The states that a plan says, and its goals."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import TOLERANCE, Quantity, Scenario
from drake_rho.verification.course import Course
from drake_rho.verification.report import UNITS, Column


def check_planned(plan: Plan, course: Course) -> Iterator[Column]:
    """(1)-(2): a plan's own positions and velocities are those that are flown; and (3): its goals.

    The first knot is the start by construction.
    """
    yield from check_flown(course, plan.positions, plan.velocities)
    yield from check_goal(course, (0.0, 0.0))


def check_flown(course: Course, positions: FloatArray, velocities: FloatArray) -> Iterator[Column]:
    """Positions and velocities at the instants, (N, J + 1, 3), are those of the course."""
    pairs: tuple[tuple[Quantity, FloatArray, FloatArray], ...] = (
        ("position", positions, course.positions),
        ("velocity", velocities, course.velocities),
    )
    for quantity, own, flown in pairs:
        differences = np.linalg.norm(own - flown, axis=2)
        k = np.argmax(differences, axis=1)
        largest = np.take_along_axis(differences, k[:, None], axis=1)[:, 0]
        yield _difference(course.scenario, "dynamics", quantity, course.times[k], largest, 0.0)


def check_goal(course: Course, within: tuple[float, float]) -> Iterator[Column]:
    """The last state is the goal, or as near to it as errors are large [m, m/s]."""
    fleet, errors = course.scenario.fleet, dict(zip(("position", "velocity"), within, strict=True))
    pairs: tuple[tuple[Quantity, FloatArray, FloatArray], ...] = (
        ("position", course.positions[:, -1], fleet.goal_positions),
        ("velocity", course.velocities[:, -1], fleet.goal_velocities),
    )
    for quantity, reached, wanted in pairs:
        missed = np.linalg.norm(reached - wanted, axis=1)
        times = np.full(len(missed), course.scenario.grid.end)
        yield _difference(course.scenario, "goal", quantity, times, missed, errors[quantity])


def _difference(
    scenario: Scenario,
    constraint: str,
    quantity: Quantity,
    times: FloatArray,
    values: FloatArray,
    most: float,
) -> Column:
    """Checks of something that should be zero, or as small as an error."""
    limits = np.full(len(values), most)
    return Column(
        kind="goals" if constraint == "goal" else "dynamics",
        constraint=constraint,
        parts=[quantity] * len(values),
        times=times,
        values=values,
        limits=limits,
        excess=values - limits,
        tolerances=TOLERANCE * scenario.fleet.scale(quantity),
        errors=limits,
        unit=UNITS[quantity],
    )
