"""Requirements (`KeepIn`), verified by membership alone: the distance of values from their set.

The support function and the normals of a set, which planners use, are not used.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.requirements import KeepIn
from drake_rho.verification.check import AT_ALL_TIMES, AT_KNOTS, MEASURED, PRECISION, Column
from drake_rho.verification.highest_over_time import Highest
from drake_rho.verification.keep_in import EVER, Constrained
from drake_rho.verification.trajectory import PiecewiseTrajectory


def check_requirements(trajectory: PiecewiseTrajectory) -> Iterator[Column]:
    """Yield the checks of every requirement that is active in the flight, and of sets as goals."""
    scenario = trajectory.scenario
    for number, required in enumerate(scenario.required, start=1):
        if required.interval(scenario.grid) is None:
            yield _expired(trajectory, number, required)
        elif required.quantity == "position" and not required.is_goal:
            yield from check_positions(trajectory, number)
        else:
            quantity = requirement_constrained(trajectory, required)
            yield requirement_column(quantity, number, quantity.greatest(), "")


def check_positions(trajectory: PiecewiseTrajectory, number: int) -> Iterator[Column]:
    """Yield the checks of a requirement of positions, at the knots and at every instant.

    Args:
        trajectory: trajectory of all vehicles.
        number: number of the requirement, from 1; it is active in the flight.
    """
    quantity = requirement_constrained(trajectory, trajectory.scenario.required[number - 1])
    yield requirement_column(quantity, number, quantity.at_knots(), AT_KNOTS)
    yield requirement_column(quantity, number, quantity.greatest(), AT_ALL_TIMES)


def requirement_constrained(trajectory: PiecewiseTrajectory, required: KeepIn) -> Constrained:
    """Return the quantity that a requirement keeps in its set."""
    scenario, grid = trajectory.scenario, trajectory.scenario.grid
    own, names, fleet = required.since(grid), scenario.names, scenario.fleet
    interval = (own.active and own.interval(grid.beginning_at(0.0))) or EVER
    sets, members = own.sets(fleet, names), own.members(names)

    def outside(who: IntArray, x: FloatArray, times: FloatArray) -> FloatArray:
        """Return distances of values from their sets; of the farther one, where these jump."""
        distances = sets.signed_distance(who, x - sets.offset(times, clock=grid.clock))
        if not sets.jumps:
            return distances
        places = sets.offset(times, before=True, clock=grid.clock)
        before = sets.signed_distance(who, x - places)
        late = grid.clock.after(times, interval[0])
        return np.maximum(distances, np.where(late, before, -np.inf))

    turns = np.append(own.corners, interval)
    return Constrained(
        trajectory.cut(grid.clock.apart(turns, trajectory.elapsed)),
        own.quantity,
        outside,
        PRECISION * sets.tolerances[members],
        members,
        interval,
        own.partner(names),
        sets.deviation,
        scenario.between_knots,
    )


def requirement_column(quantity: Constrained, number: int, worst: Highest, when: str) -> Column:
    """Return the checks of the vehicles concerned at their worst instants."""
    scenario = quantity.trajectory.scenario
    required, count = scenario.required[number - 1], len(scenario.vehicles)
    times, values, errors, tolerances = whole = np.zeros((4, count))
    own = required.tolerances(scenario.fleet, scenario.names)
    whole[:, quantity.members] = worst.times, worst.values, worst.errors, own
    column = Column(
        kind="goals" if required.is_goal else "requirements",
        constraint=required.called(number),
        parts=[" ".join(filter(None, (_about(required), when)))] * count,
        times=scenario.grid.start + times,
        values=values,
        limits=0.0 - errors,
        excess=values + errors,
        tolerances=tolerances,
        unit=required.unit,
        asked=when != AT_ALL_TIMES or scenario.between_knots or quantity.is_instant,
        partners=None if quantity.partner is None else np.full(count, quantity.partner),
        errors=errors,
        concerned=np.isin(np.arange(count), quantity.members),
    )
    always = scenario.between_knots or quantity.is_instant
    prices = required.prices(scenario.fleet, scenario.names)
    counted = when not in (MEASURED, AT_KNOTS if always else AT_ALL_TIMES)
    return column.softened(prices, counted=counted)


def _about(required: KeepIn) -> str:
    """Return the name of the constrained quantity, unless it is the position itself."""
    if required.is_goal:
        return required.of
    of = "" if required.of == "position" or required.at_waypoint else f"of {required.of}"
    other = required.leader or ("a moving point" if required.track is not None else "")
    return " ".join(filter(None, (of, other and f"relative to {other}")))


def _expired(trajectory: PiecewiseTrajectory, number: int, required: KeepIn) -> Column:
    """Return an empty check of an expired requirement, so that it counts as checked."""
    count = len(trajectory.scenario.vehicles)
    zero = np.zeros(count)
    return Column(
        kind="requirements",
        constraint=required.called(number),
        parts=[""] * count,
        times=zero,
        values=zero,
        limits=zero,
        excess=zero,
        tolerances=zero,
        errors=zero,
        unit=required.unit,
        concerned=np.zeros(count, dtype=bool),
    )
