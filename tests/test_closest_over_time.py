"""The closest pair of a fleet over time, compared with a visit to every pair."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.nearest_vehicles import closest_over_time
from tests.motions import closest_approach
from tests.scenarios import slow
from tests.tolerances import ROUNDING


def _wandering(vehicles: int, seed: int) -> rho.Plan:
    """Return vehicles with random motions in a small room."""
    rng = np.random.default_rng(seed)
    room = rho.flight_cube(vehicles / 4)
    scenario = rho.random_transitions(vehicles, rng, volume=room, duration=3.0, step=0.3)
    return rho.Plan.from_accelerations(scenario, rng.uniform(-2.0, 2.0, (vehicles, 10, 3)))


def _every_pair(plan: rho.Plan, separation: rho.Separation) -> dict[tuple[int, int], Motion]:
    """Return the relative motion of every pair, scaled so that the separation is a sphere."""
    whole = plan.motion()
    parts = whole.positions, whole.velocities, whole.accelerations, whole.before, whole.after
    scaled = [separation.scaled(part) for part in parts]
    return {
        (i, j): Motion(whole.step, *(each[i] - each[j] for each in scaled))
        for i, j in combinations(range(len(scaled[0])), 2)
    }


@pytest.mark.parametrize("seed", [*range(2), *slow(*range(2, 5))])
@pytest.mark.parametrize("vehicles", [2, 3, 12])
@pytest.mark.parametrize("per_step", [1, 5])
def test_the_least_distance_of_every_step_is_found(vehicles: int, seed: int, per_step: int) -> None:
    plan, separation = _wandering(vehicles, seed), rho.Separation(0.35, downwash=2.0)
    found = closest_over_time(plan.motion(), separation, per_step=per_step)
    pairs = _every_pair(plan, separation)
    exact = np.array([closest_approach(m, np.zeros(3))[1] for m in pairs.values()])
    assert np.all(np.diff(found.times) >= 0.0)
    for k in range(10):
        inside = (found.times >= 0.3 * k - 1e-9) & (found.times <= 0.3 * (k + 1) + 1e-9)
        assert found.distances[inside].min() == pytest.approx(exact[:, k].min(), rel=ROUNDING)
    for one, other, time, distance in zip(
        found.one, found.other, found.times, found.distances, strict=True
    ):
        there = {pair: m.at("position", time)[0] for pair, m in pairs.items()}
        apart = {pair: float(np.linalg.norm(difference)) for pair, difference in there.items()}
        assert apart[one, other] == pytest.approx(distance, rel=ROUNDING)
        assert distance == pytest.approx(min(apart.values()), rel=ROUNDING)


def test_two_vehicles_in_the_same_place_are_a_pair() -> None:
    states = (rho.State([0.0, 0, 0]), rho.State([2.0, 0, 0]))
    ways = (states, states[::-1], (rho.State([0.0, 5, 0]), rho.State([0.0, 5, 0])))
    vehicles = [rho.Vehicle(f"v{i}", start, goal) for i, (start, goal) in enumerate(ways)]
    plan = rho.plan_convex(rho.Scenario("head on", rho.Grid(1.0, 5), vehicles))
    found = closest_over_time(plan.motion(), rho.Separation(0.5), per_step=2)
    m = np.argmin(found.distances)
    assert (found.one[m], found.other[m]) == (0, 1)
    assert found.times[m] == pytest.approx(2.0)
    assert found.distances[m] == pytest.approx(0.0, abs=1e-9)
    assert np.all(found.one < found.other)
