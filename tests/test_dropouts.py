"""Measurements that are lost: the tube is the largest over all patterns, and is reached."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import drake_rho as rho
from tests.loop import Array, fine_times, summed_responses
from tests.scenarios import slow
from tests.test_tube import random_tube, scenario_of, sizes_of
from tests.test_worst_case import QUANTITIES, flown_case
from tests.tolerances import ROUNDING


def longest_run(lost: Array) -> int:
    """Return the largest number of lost measurements in a row, over all vehicles."""
    columns = np.asarray(lost).reshape(len(lost), -1).T
    return max(
        (sum(1 for _ in run) for each in columns for is_lost, run in itertools.groupby(each) if is_lost),
        default=0,
    )


def patterns(samples: int, most: int) -> list[Array]:
    """Return every pattern of lost measurements with at most this many in a row."""
    every = np.array(list(itertools.product([False, True], repeat=samples)))
    return [each for each in every if longest_run(each) <= most]


@pytest.mark.parametrize("dropouts", [1, 2, 3])
@pytest.mark.parametrize("seed", [*range(4), *slow(*range(4, 12))])
def test_radii_are_the_largest_of_all_patterns(seed: int, dropouts: int) -> None:
    while True:
        tube, loop = random_tube(seed, dropouts)
        if 3 <= loop.samples <= 7:
            break
        seed += 100
    parts = 4
    times = tube.grid.start + fine_times(loop, parts)
    radii = tube.position(times), tube.velocity(times), tube.acceleration(times[:-1:parts])
    known = [np.zeros(each.shape) for each in radii]
    for lost in patterns(loop.samples, dropouts):
        found = summed_responses(loop, parts, sizes_of(tube), lost)
        known = [np.maximum(*both) for both in zip(known, found, strict=True)]
    for largest, radius in zip(known, radii, strict=True):
        assert np.all(largest <= radius * (1.0 + ROUNDING) + ROUNDING * radius.max())
        np.testing.assert_allclose(largest, radius, rtol=0, atol=radius.max() / parts**2)
    if loop.samples > loop.delay + 2:  # a lost measurement has an effect
        none = summed_responses(loop, parts, sizes_of(tube))
        assert np.any(known[0] > 1.001 * none[0])


@pytest.mark.parametrize("dropouts", [1, 2, 3, 7])
@pytest.mark.parametrize("seed", range(12))
def test_the_worst_case_with_its_lost_measurements_reaches_the_radius(
    seed: int, dropouts: int
) -> None:
    tube, loop = random_tube(2000 + seed, dropouts)
    rng = np.random.default_rng(seed)
    quantity = QUANTITIES[seed % 3]
    time = tube.grid.start + rng.uniform(0.3, 1.0) * tube.grid.duration
    direction = rng.normal(size=3)
    scenario = scenario_of(tube.disturbance, tube.grid)
    case = rho.worst_case(scenario, direction, time, quantity, tube=tube)  # type: ignore[arg-type]
    assert longest_run(case.lost) <= dropouts
    flown = flown_case(tube, loop, case, time)
    reached = flown[quantity] @ direction / np.linalg.norm(direction)
    assert reached == pytest.approx(float(getattr(tube, quantity)(time)), rel=1e-9, abs=1e-12)
    assert flown["all"].max() <= 1.0 + 1e-9


def test_more_lost_measurements_make_no_radius_smaller() -> None:
    for seed in range(6):
        tubes = [random_tube(seed, dropouts)[0] for dropouts in (1, 2, 4)]
        times = np.linspace(tubes[0].grid.start, tubes[0].grid.end, 57)
        for quantity in ("position", "velocity", "acceleration"):
            radii = [getattr(tube, quantity)(times) for tube in tubes]
            for fewer, more in itertools.pairwise(radii):
                assert np.all(more >= fewer * (1.0 - ROUNDING))
