"""Which vehicles of a fleet come too close to each other on their way, and when.

Which pairs come close at all is asked of k-d trees, never of all pairs.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.close_pairs import CloseApproaches, close_pairs, close_pairs_at_knots
from drake_rho.motion.dynamics import Motion, step_at
from drake_rho.motion.penetration import Pieces, deepest
from drake_rho.planning.constraints.base import AT_ONCE, VIOLATED
from drake_rho.planning.constraints.margins import Margins
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.parts import Separation
from drake_rho.scenario.records import Scenario


def pairs_within(
    separation: Separation,
    motion: Motion,
    within: float,
    *,
    between: bool,
    of: IntArray | None = None,
) -> CloseApproaches:
    """Pairs closer than `within` [m] on their way: at any instant, or at the knots.

    Args:
        separation: how distances are measured.
        motion: of all vehicles.
        within: the distance.
        between: whether at any instant.
        of: vehicles of which each pair has one or two, rising indices; all if not given.
    """
    find = close_pairs if between else close_pairs_at_knots
    return _under_way(find(motion, separation, within, of=of), motion)


def too_close(
    separation: Separation,
    motion: Motion,
    margins: Margins,
    *,
    between: bool,
    of: IntArray | None = None,
) -> CloseApproaches:
    """Pairs that break their separation; distances are less what both keep beside it.

    Args:
        separation: what they keep.
        motion: of all vehicles.
        margins: what each of a pair keeps beside it.
        between: whether at every instant.
        of: as for `pairs_within`.
    """
    least = separation.distance - VIOLATED * separation.tolerance
    if margins.most == 0.0:
        return pairs_within(separation, motion, least, between=between, of=of)
    within = least + most_beside(separation, margins)
    found = pairs_within(separation, motion, within, between=between, of=of)
    if not separation.is_round:
        found = _measured(separation, motion, margins, found, between=between)
    kept = 2.0 * margins.at("position", found.times)
    found = dataclasses.replace(found, distances=found.distances - kept)
    return found.select(found.distances < least)


def most_beside(separation: Separation, margins: Margins) -> float:
    """Return the largest margin of a pair beside its separation, where that is a ball [m]."""
    return 2.0 * margins.most * float(separation.shape.scales.max())


def _measured(
    separation: Separation,
    motion: Motion,
    margins: Margins,
    found: CloseApproaches,
    *,
    between: bool,
) -> CloseApproaches:
    """Pairs with their distance from an ellipsoid, at the worst instants of the steps given.

    What is kept beside an ellipsoid is no ellipsoid, so that distances from it are measured as they
    are; the separation is added to them.
    """
    shape, h, last = separation.shape, motion.step, motion.accelerations.shape[1] - 1
    if not between:
        k = step_at(found.times, h)
        offsets = motion.positions[found.one, k] - motion.positions[found.other, k]
        distances = separation.distance + shape.signed_distance(offsets)
        return dataclasses.replace(found, distances=distances)
    k = np.clip(step_at(found.times, h), 0, last)
    before = np.maximum(k - 1, 0)  # a closest approach at a knot may be the end of a step
    steps = np.stack([np.tile(found.one, 2), np.tile(found.other, 2), np.append(k, before)])
    one, other, k = np.unique(steps, axis=1)
    pieces = Pieces(
        np.arange(len(k)),
        np.float64(h) * k,
        np.full(len(k), h),
        motion.positions[one, k] - motion.positions[other, k],
        motion.velocities[one, k] - motion.velocities[other, k],
        motion.accelerations[one, k] - motion.accelerations[other, k],
    )
    below = 2.0 * margins.steps["position"][k] - VIOLATED * separation.tolerance
    tolerances = np.full(len(k), separation.tolerance)
    which, times = deepest(shape, pieces, below, tolerances)
    distances = shape.signed_distance(pieces.select(which).at(times - pieces.times[which]))
    worst = CloseApproaches(one[which], other[which], times, separation.distance + distances)
    return _under_way(worst, motion)


def separation_of(scenario: Scenario) -> Separation:
    """Return the separation of a scenario that has one.

    Raises:
        ValueError: it has none.
    """
    if scenario.separation is None:
        raise ValueError("scenario: got one without a separation, expected one with it")
    return scenario.separation


def _under_way(found: CloseApproaches, motion: Motion) -> CloseApproaches:
    """Approaches after the start and before the end: at these nothing can be changed."""
    first = AT_ONCE * motion.step
    last = motion.accelerations.shape[1] * motion.step - first
    return found.select((found.times > first) & (found.times < last))
