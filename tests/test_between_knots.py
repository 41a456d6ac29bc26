"""No plan leaves a required set between the knots: what planners return, verify and samples accept.

The scenes have known motions that keep all requirements, so that a plan exists.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import drake_rho as rho
from drake_rho.planning.constraints.worst_instants import worst_instants
from tests.arrays import FloatArray
from tests.known_requirements import (
    GRAVITY,
    QUANTITIES,
    Known,
    beyond,
    known_scene,
    set_around,
)

MISSED = 0.06
"""Part of a violation, or of the threshold, by which a greater one may be missed."""


def two_humps(start: float) -> rho.Scenario:
    """Return a scene in which a step leaves a box once in each half, later further."""
    vehicle = rho.Vehicle(
        "v",
        rho.State([26.74500305, 81.44979754, 37.87616441], [0.87519292, 1.2043095, 2.56058646]),
        rho.State([43.07752061, 18.07841849, 82.81484035], [2.30433192, -2.98459748, 2.72184204]),
    )
    box = rho.Box([26.72660338, 81.27500598, 37.83475254], [27.31666542, 81.64594355, 39.98816974])
    asked = rho.KeepIn(box, active=(start + 0.1620162, start + 0.6754825))
    return rho.Scenario("two", rho.Grid(0.7, 19, start), [vehicle], requirements=[asked])


def one_of_two_humps(origin: Any) -> rho.Scenario:
    """Return a scene of this kind whose interval is a whole step, anywhere in space."""
    at = np.asarray(origin)
    goal = [0.19170319, 1.02432985, 0.55752402]
    vehicle = rho.Vehicle(
        "v",
        rho.State(at, [-0.95743234, -0.02733324, 0.00674617]),
        rho.State(at + goal, [-0.30870186, -0.57094986, 0.18135494]),
    )
    low, high = [-0.22669414, 0.01736799, 0.02711362], [-0.18399195, 0.12450863, 0.11059422]
    asked = rho.KeepIn(rho.Box(at + low, at + high), active=(0.3, 0.6))
    return rho.Scenario("one", rho.Grid(0.3, 9), [vehicle], requirements=[asked])


@pytest.mark.parametrize(
    "scenario",
    [
        two_humps(0.0),
        two_humps(1700000005.5),
        one_of_two_humps([0, 0, 0]),
        one_of_two_humps([19758.67266062, 31716.43032392, 60303.68019716]),
    ],
)
def test_a_second_hump_is_found(scenario: rho.Scenario) -> None:
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    assert beyond(plan) <= 1.0


@pytest.mark.parametrize(
    "seed", [*range(40), *(pytest.param(k, marks=pytest.mark.slow) for k in range(40, 400))]
)
def test_plans_keep_what_known_motions_keep(seed: int) -> None:
    plan = rho.plan(known_scene(seed))
    assert rho.verify(plan).ok
    assert beyond(plan) <= 1.0


@given(seed=st.integers(0, 10**6))
def test_the_worst_of_dense_samples_is_found_in_a_piece(seed: int) -> None:
    rng = np.random.default_rng(seed)
    step, size = float(rng.choice([0.01, 0.3, 2.0])), 10.0 ** rng.uniform(-3.0, 3.0)
    p, v, a = (size / step**k * rng.normal(size=(1, 1, 3)) for k in range(3))
    first, last = step * np.sort(rng.uniform(0.0, 1.0, 2))
    where = set_around(rng, p[0] + 0.3 * size * rng.normal(size=(5, 3)), size)
    margin, threshold = float(0.1 * size * rng.random()), size * 10.0 ** rng.uniform(-7.0, -1.0)
    who, times = worst_instants(
        (p, v, a),
        step,
        np.array([[first, last]]),
        lambda _who, x, _times: np.asarray(where.signed_distance(x)),
        np.array([margin]),
        np.array([threshold]),
        np.array([4]),
    )

    def values(at: FloatArray) -> FloatArray:
        s = at[:, None]
        x = p[0] + s * (v[0] + s / 2.0 * a[0])
        return np.asarray(where.signed_distance(x) + margin)

    most = float(values(np.linspace(first, last, 4001)).max())
    if len(times) == 0:
        assert most <= threshold * (1.0 + MISSED)
    else:
        assert who.tolist() == [4]
        assert first <= times[0] <= last
        assert values(times)[0] > threshold
        assert values(times)[0] * (1.0 + MISSED) >= most


@pytest.mark.parametrize("of", QUANTITIES)
def test_an_instant_at_the_last_knot_is_that_of_the_last_step(of: Any) -> None:
    vehicle = rho.Vehicle("v", rho.State([0, 0, 0]), rho.State([1, 0, 0]))
    centre = GRAVITY if of == "thrust" else np.zeros(3)
    if of == "position":
        centre = np.array([1.0, 0.0, 0.0])
    asked = rho.KeepIn(rho.Ball(centre, 0.1), of=of, active=(3.0, 3.0))
    scenario = rho.Scenario("end", rho.Grid(0.3, 11), [vehicle], requirements=[asked])
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    assert beyond(plan) <= 1.0
    if of in ("acceleration", "thrust"):
        assert np.linalg.norm(plan.accelerations[0, -1]) <= 0.1 + 1e-6
    if of == "jerk":  # of the change to rest
        assert np.linalg.norm(plan.accelerations[0, -1]) <= 0.1 * 0.3 + 1e-6


@pytest.mark.parametrize("required", [False, True])
@pytest.mark.parametrize("far", [0.0, 4e4, 3e5])
@pytest.mark.parametrize("seed", range(6))
def test_points_passed_beside_knots_far_from_the_origin_have_a_plan(
    seed: int, far: float, required: bool
) -> None:
    """Nothing else is asked, so a plan exists; planes through one point are no contradiction."""
    rng = np.random.default_rng(seed)
    step, knots, size = 0.5, 11, 0.05
    at, v, a = far * rng.normal(size=3), np.zeros(3), rng.normal(size=(1, knots - 1, 3))
    known = Known.of(at[None], v[None], size / 10.0 * a, step)
    times = step * (np.array([2.0, 5.0, 8.0]) + rng.choice([-1e-6, 0.0, 1e-7, 1e-3, 0.3], 3))
    points = known.values("position", 0, times)
    start, goal = rho.State(at, v), rho.State(known.positions[0, -1], known.velocities[0, -1])
    passed = [rho.Waypoint(time, x) for time, x in zip(times.tolist(), points, strict=True)]
    asked = [
        rho.KeepIn(rho.Box(x, x), active=(time, time))
        for time, x in zip(times.tolist(), points, strict=True)
    ]
    vehicle = rho.Vehicle("v", start, goal, waypoints=() if required else passed)
    plan = rho.plan(
        rho.Scenario(
            "far", rho.Grid(step, knots), [vehicle], requirements=asked if required else ()
        )
    )
    assert rho.verify(plan).ok
    missed = Known.planned(plan).values("position", 0, times) - points
    assert np.abs(missed).max() <= 1e-6 * size + 1e-13 * far
