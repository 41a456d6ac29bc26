"""Distances between vehicles, compared with dense sampling and with a visit to every pair."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import drake_rho as rho
from drake_rho.motion import candidate_pairs
from drake_rho.motion.close_pairs import CloseApproaches, PairSearch
from drake_rho.motion.dynamics import Motion, roll_out
from tests.tolerances import ROUNDING

seeds = st.integers(0, 2**32 - 1)


def _swarm(seed: int) -> tuple[Motion, rho.Separation]:
    """Return vehicles with random motions, some in the same place for a while."""
    rng = np.random.default_rng(seed)
    count, steps = int(rng.integers(2, 9)), int(rng.integers(1, 9))
    size, h = 10 ** rng.uniform(-2, 4), 10 ** rng.uniform(-2, 2)
    p, v = size * rng.normal(size=(count, 3)), size / h * rng.normal(size=(count, 3))
    a = size / h**2 * rng.normal(size=(count, steps, 3)) * rng.integers(0, 2)
    if rng.random() < 0.3:
        p[1], v[1], a[1] = p[0], v[0], a[0]
    motion = Motion(h, *roll_out(p, v, a, h), a, *2 * [np.full((count, 3), np.nan)])
    return motion, rho.Separation(size * rng.uniform(0.1, 2.0), rng.choice([0.5, 1.0, 2.0]))


def _sampled(motion: Motion, separation: rho.Separation, per_step: int) -> np.ndarray:
    """Return distances of all pairs, shape (N, N, K-1, S), at equal times in every step."""
    h, steps = motion.step, motion.accelerations.shape[1]
    s = np.linspace(0.0, h, per_step + 1)[:, None]
    p, v = motion.positions[:, :steps, None], motion.velocities[:, :steps, None]
    path = (p + s * v + s**2 / 2 * motion.accelerations[:, :, None]) / [1, 1, separation.downwash]
    distances: np.ndarray = np.linalg.norm(path[:, None] - path[None], axis=-1)
    return distances


@given(seed=seeds)
def test_no_sample_is_closer_than_the_closest_approach(seed: int) -> None:
    motion, separation = _swarm(seed)
    found = PairSearch(separation).in_steps(motion, 1e12)  # every pair in every step
    count, steps = motion.accelerations.shape[:2]
    assert len(found) == count * (count - 1) // 2 * steps
    dense = _sampled(motion, separation, 500).min(axis=3)
    scale = np.abs(motion.positions).max() + 1e-300
    order = [(one, other, k) for one, other in combinations(range(count), 2) for k in range(steps)]
    for (one, other, k), time, distance in zip(order, found.times, found.distances, strict=True):
        assert k * motion.step <= time <= (k + 1) * motion.step * (1 + ROUNDING)
        assert distance <= dense[one, other, k] + ROUNDING * scale
        two = motion.of(np.array([one, other])).at("position", time)[:, 0]
        attained = np.linalg.norm(separation.scaled(two[0] - two[1]))
        assert distance == pytest.approx(attained, abs=ROUNDING * scale)


@given(seed=seeds, within=st.floats(0.05, 5.0))
def test_the_pairs_found_equal_a_visit_to_every_pair(seed: int, within: float) -> None:
    motion, separation = _swarm(seed)
    radius, steps = within * separation.distance, motion.accelerations.shape[1]
    every = PairSearch(separation).in_steps(motion, 1e12)
    expected = every.select(every.distances < radius)
    found = PairSearch(separation).in_steps(motion, radius)
    np.testing.assert_array_equal(found.one, expected.one)
    np.testing.assert_array_equal(found.other, expected.other)
    np.testing.assert_allclose(found.distances, expected.distances, rtol=ROUNDING, atol=1e-12)
    knots = PairSearch(separation).at_knots(motion, radius)
    assert np.all(knots.one < knots.other)
    scaled = separation.scaled(motion.positions)
    known = {
        (one, other, k): float(np.linalg.norm(scaled[one, k] - scaled[other, k]))
        for one, other in combinations(range(len(scaled)), 2)
        for k in range(steps + 1)
    }
    k = np.rint(knots.times / motion.step).astype(int)
    keys = list(zip(knots.one.tolist(), knots.other.tolist(), k.tolist(), strict=True))
    assert keys == [key for key, distance in known.items() if distance <= radius]
    np.testing.assert_allclose(knots.distances, [known[key] for key in keys], rtol=ROUNDING)


@pytest.mark.parametrize("find", [PairSearch.in_steps, PairSearch.at_knots])
@pytest.mark.parametrize("count", [0, 5, 50])
def test_pairs_equal_a_visit_to_every_pair_in_every_search_mode(
    find: Any, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Trees or no trees, all instants at once or parallel batches: the pairs are the same."""
    rng = np.random.default_rng(count)
    p, v = 3.0 * rng.normal(size=(80, 3)), rng.normal(size=(80, 3))
    a = rng.normal(size=(80, 25, 3))
    motion = Motion(0.3, *roll_out(p, v, a, 0.3), a, *2 * [np.full((80, 3), np.nan)])
    separation = rho.Separation(1.0, 2.0)
    of = np.sort(rng.permutation(80)[:count]) if count else None
    found = list[CloseApproaches]()
    for name, value in (("_HANDFUL", 80), ("_HANDFUL", 32), ("_MANY", 1)):
        monkeypatch.setattr(candidate_pairs, name, value)
        found.append(find(PairSearch(separation), motion, 1.5, of=of))
    every, *others = found
    assert len(every) > 20
    assert of is None or np.all(np.isin(every.one, of) | np.isin(every.other, of))
    for each in others:
        np.testing.assert_array_equal(each.one, every.one)
        np.testing.assert_array_equal(each.other, every.other)
        np.testing.assert_allclose(each.times, every.times, rtol=ROUNDING)
        np.testing.assert_allclose(each.distances, every.distances, rtol=ROUNDING)


@given(seed=seeds, moved=st.floats(0.0, 2.0), share=st.floats(0.0, 1.0))
def test_a_search_after_others_finds_what_a_first_one_finds(
    seed: int, moved: float, share: float
) -> None:
    """Whether a motion stays in the balls of the earlier ones, leaves a few, or leaves most."""
    rng = np.random.default_rng(seed)
    p, v = 3.0 * rng.normal(size=(60, 3)), rng.normal(size=(60, 3))
    a = rng.normal(size=(60, 8, 3))
    ends = 2 * [np.full((60, 3), np.nan)]
    separation = rho.Separation(1.0, 2.0)
    search = PairSearch(separation)
    for _ in range(4):
        motion = Motion(0.3, *roll_out(p, v, a, 0.3), a, *ends)
        of = np.flatnonzero(rng.random(60) < 0.3) if rng.random() < 0.5 else None
        within = rng.uniform(0.8, 1.5)
        for find in (PairSearch.in_steps, PairSearch.at_knots):
            again = find(search, motion, within, of=of)
            first = find(PairSearch(separation), motion, within, of=of)
            np.testing.assert_array_equal(again.one, first.one)
            np.testing.assert_array_equal(again.other, first.other)
            np.testing.assert_allclose(again.times, first.times, rtol=ROUNDING)
            np.testing.assert_allclose(again.distances, first.distances, rtol=ROUNDING)
        a = a + (rng.random((60, 1, 1)) < share) * moved * rng.normal(size=a.shape)


def test_an_encounter_in_the_middle_of_a_step_is_found() -> None:
    """They pass at 3 m beside and 4 m above, which counts as 2 m with a downwash of 2."""
    p = np.array([[[-5.0, 0.0, 0.0]], [[5.0, 3.0, 4.0]]])
    v = np.array([[[2.0, 0.0, 0.0]], [[-2.0, 0.0, 0.0]]])
    a = np.zeros((2, 5, 3))
    motion = Motion(1.0, *roll_out(p[:, 0], v[:, 0], a, 1.0), a, *2 * [np.full((2, 3), np.nan)])
    search = PairSearch(rho.Separation(4.0, 2.0))
    found = search.in_steps(motion, 4.0)
    best = np.argmin(found.distances)
    assert (found.one[best], found.other[best]) == (0, 1)
    assert found.times[best] == pytest.approx(2.5)
    assert found.distances[best] == pytest.approx(np.sqrt(3.0**2 + 2.0**2))
    assert search.at_knots(motion, 3.7).times.size == 0


def test_the_same_instant_counts_once() -> None:
    motion, separation = _swarm(3)
    some = PairSearch(separation).in_steps(motion, 4.0 * separation.distance)
    assert len(some) > 0
    both = some.merged(some)
    np.testing.assert_array_equal(both.times, some.times)
    np.testing.assert_array_equal(both.one, some.one)
    none = some.select(np.zeros(len(some), dtype=bool))
    assert len(none.union(none)) == 0
    assert len(none.union(some)) == len(some)
