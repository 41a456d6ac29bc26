"""Close approaches of pairs of vehicles, and pairs that violate their separation.

Candidate pairs are found with k-d trees; the search never visits all pairs.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.close_pairs import CloseApproaches, PairSearch
from drake_rho.motion.dynamics import Motion, step_at
from drake_rho.motion.penetration import Pieces, deepest
from drake_rho.planning.constraints.base import VIOLATED
from drake_rho.planning.constraints.margins import Margins
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.parts import Separation
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import END_MARGIN


def pairs_within(
    search: PairSearch,
    motion: Motion,
    within: float,
    *,
    between: bool,
    of: IntArray | None = None,
    open_end: bool = False,
) -> CloseApproaches:
    """Return pairs closer than `within` [m] after the start and before the end.

    Args:
        search: the search, by the separation whose shape measures distances.
        motion: the motion of all vehicles.
        within: the distance [m].
        between: whether to check every instant instead of the knots.
        of: increasing indices of vehicles; each pair includes at least one of them. All if None.
        open_end: whether the end counts too, as goals do not fix all positions there.
    """
    find = search.in_steps if between else search.at_knots
    return _under_way(find(motion, within, of=of), motion, open_end)


def violating_pairs(
    search: PairSearch,
    motion: Motion,
    margins: Margins,
    *,
    between: bool,
    of: IntArray | None = None,
    open_end: bool = False,
) -> CloseApproaches:
    """Return pairs that violate their separation, with distances reduced by both margins.

    Args:
        search: the search, by the required separation.
        motion: the motion of all vehicles.
        margins: the margins that each vehicle of a pair adds to the separation.
        between: whether to check every instant instead of the knots.
        of: increasing indices of vehicles; each pair includes at least one of them. All if None.
        open_end: as for `pairs_within`.
    """
    separation = search.separation
    least = separation.distance - VIOLATED * separation.tolerance
    if margins.largest == 0.0:
        return pairs_within(search, motion, least, between=between, of=of, open_end=open_end)
    within = least + max_pair_margin(separation, margins)
    found = pairs_within(search, motion, within, between=between, of=of, open_end=open_end)
    if not separation.is_round:
        found = _measured(separation, motion, margins, found, between, open_end)
    both = 2.0 * margins.at("position", found.times)
    found = dataclasses.replace(found, distances=found.distances - both)
    return found.select(found.distances < least)


def max_pair_margin(separation: Separation, margins: Margins) -> float:
    """Return the largest sum of a pair's margins where the separation is scaled to a ball [m]."""
    return 2.0 * margins.largest * float(separation.shape.scales.max())


def _measured(
    separation: Separation,
    motion: Motion,
    margins: Margins,
    found: CloseApproaches,
    between: bool,
    open_end: bool,
) -> CloseApproaches:
    """Return pairs with Euclidean distances from the ellipsoid, at the worst instants of steps.

    An ellipsoid enlarged by a margin is no ellipsoid. Its signed distance is therefore measured
    without scaling, and the separation is added to it.
    """
    shape, h, last = separation.shape, motion.step, motion.accelerations.shape[1] - 1
    if not between:
        k = step_at(found.times, h)
        offsets = motion.positions[found.one, k] - motion.positions[found.other, k]
        distances = separation.distance + shape.local_distance(offsets)
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
        parts=np.zeros(len(k), dtype=np.int64),
        errors=np.zeros(len(k)),
        growths=np.zeros(len(k)),
    )
    below = 2.0 * margins.steps["position"][k] - VIOLATED * separation.tolerance
    tolerances = np.full(len(k), separation.tolerance)
    which, times = deepest(shape, pieces, below, tolerances)
    distances = shape.local_distance(pieces.select(which).at(times - pieces.times[which]))
    worst = CloseApproaches(one[which], other[which], times, separation.distance + distances)
    return _under_way(worst, motion, open_end)


def separation_of(scenario: Scenario) -> Separation:
    """Return the separation of a scenario.

    Raises:
        ValueError: the scenario has none.
    """
    if scenario.separation is None:
        raise ValueError("scenario: got one without a separation, expected one with a separation")
    return scenario.separation


def _under_way(found: CloseApproaches, motion: Motion, open_end: bool) -> CloseApproaches:
    """Return approaches after the start and, unless it is open, before the end."""
    first = END_MARGIN * motion.step
    last = motion.accelerations.shape[1] * motion.step - first
    return found.select((found.times > first) & (open_end | (found.times < last)))
