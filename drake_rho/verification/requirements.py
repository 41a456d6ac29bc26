"""Requirements (`KeepIn`), verified by membership alone: the distance of values from their set.

The support function and the normals of a set, which planners use, are not used.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.requirements import KeepIn
from drake_rho.verification.check import AT_ALL_TIMES, AT_KNOTS, PRECISION, Column
from drake_rho.verification.highest_over_time import Highest
from drake_rho.verification.keep_in import EVER, Kept
from drake_rho.verification.trajectory import PiecewiseTrajectory


def check_requirements(trajectory: PiecewiseTrajectory) -> Iterator[Column]:
    """Yield the checks of every requirement that is active in the flight."""
    scenario = trajectory.scenario
    for number, asked in enumerate(scenario.requirements, start=1):
        if asked.interval(scenario.grid) is None:
            yield _nothing_left(trajectory, number, asked)
        elif asked.quantity == "position":
            yield from check_positions(trajectory, number)
        else:
            kept = _kept(trajectory, asked)
            yield _column(kept, number, kept.greatest(), "")


def check_positions(trajectory: PiecewiseTrajectory, number: int) -> Iterator[Column]:
    """Yield the checks of a requirement of positions, at the knots and at every instant.

    Args:
        trajectory: trajectory of all vehicles.
        number: number of the requirement, from 1; it is active in the flight.
    """
    kept = _kept(trajectory, trajectory.scenario.requirements[number - 1])
    yield _column(kept, number, kept.at_knots(), AT_KNOTS)
    yield _column(kept, number, kept.greatest(), AT_ALL_TIMES)


def _kept(trajectory: PiecewiseTrajectory, asked: KeepIn) -> Kept:
    """Return the quantity that a requirement keeps in its set."""
    scenario, grid = trajectory.scenario, trajectory.scenario.grid
    own, names, fleet = asked.since(grid), scenario.names, scenario.fleet
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
    return Kept(
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


def _column(kept: Kept, number: int, worst: Highest, when: str) -> Column:
    """Return the checks of the vehicles concerned at their worst instants."""
    scenario = kept.trajectory.scenario
    asked, count = scenario.requirements[number - 1], len(scenario.vehicles)
    times, values, errors, tolerances = whole = np.zeros((4, count))
    own = asked.tolerances(scenario.fleet, scenario.names)
    whole[:, kept.members] = worst.times, worst.values, worst.errors, own
    return Column(
        kind="requirements",
        constraint=asked.called(number),
        parts=[" ".join(filter(None, (_about(asked), when)))] * count,
        times=scenario.grid.start + times,
        values=values,
        limits=0.0 - errors,
        excess=values + errors,
        tolerances=tolerances,
        unit=asked.unit,
        asked=when != AT_ALL_TIMES or scenario.between_knots or kept.is_instant,
        always=when == AT_ALL_TIMES,
        partners=None if kept.partner is None else np.full(count, kept.partner),
        errors=errors,
        concerned=np.isin(np.arange(count), kept.members),
    )


def _about(asked: KeepIn) -> str:
    """Return the name of the constrained quantity, unless it is the position itself."""
    of = "" if asked.of == "position" else f"of {asked.of}"
    other = asked.leader or ("a moving point" if asked.track is not None else "")
    return " ".join(filter(None, (of, other and f"relative to {other}")))


def _nothing_left(trajectory: PiecewiseTrajectory, number: int, asked: KeepIn) -> Column:
    """Return an empty check of an expired requirement, so that it counts as checked."""
    count = len(trajectory.scenario.vehicles)
    zero = np.zeros(count)
    return Column(
        kind="requirements",
        constraint=asked.called(number),
        parts=[""] * count,
        times=zero,
        values=zero,
        limits=zero,
        excess=zero,
        tolerances=zero,
        errors=zero,
        unit=asked.unit,
        concerned=np.zeros(count, dtype=bool),
    )
