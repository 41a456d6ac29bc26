"""Curved sets as cones in programs, where tangent planes converge slowly."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.planning.planners.from_paths import plan_along_paths
from drake_rho.planning.problem import Problem
from drake_rho.planning.scp import curved_sets
from drake_rho.scenario.convex_sets import Balls, Cones, ConvexSets
from tests.cones import TWIN, twin_cost
from tests.scenarios import single

TURNING = rho.State([0.0, 0.0, 0.0], [-1.0, 1.5, 1.0])

LIMITS = {
    "speed": rho.Limits(max_speed=2.6),
    "acceleration": rho.Limits(max_acceleration=1.3),
    "thrust": rho.Limits(max_thrust=9.95),
    "tilt": rho.Limits(max_tilt=0.12),
    "all": rho.Limits(max_speed=2.6, max_acceleration=1.4, max_thrust=9.97, max_tilt=0.13),
}


@pytest.fixture(params=[0, 10], ids=["cones", "tangents"])
def creeping(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """Set the rounds of tangent planes before cones enter: none, or as many as by default."""
    monkeypatch.setattr(curved_sets, "_MAX_PLANE_ROUNDS", request.param)
    return int(request.param)


@pytest.mark.parametrize(
    ("sets", "free"),
    [
        (
            Balls(np.array([[1.0, 2.0, -9.81]]), np.array([1e-6]), np.array([3.0])),
            {"radii": np.inf},
        ),
        (
            Cones(np.array([[0.0, 0.0, -9.81]]), np.array([1e-6]), np.array([0.8])),
            {"angles": np.pi},
        ),
    ],
    ids=["ball", "cone"],
)
def test_a_cone_equals_the_set_and_measures_the_distance_to_it(
    sets: ConvexSets, free: dict[str, float]
) -> None:
    rng, count = np.random.default_rng(1), 400
    values, who = rng.normal(size=(count, 3)) * 3.0, np.zeros(count, dtype=int)
    values[:, 2] = np.abs(values[:, 2])  # above the apex, which is then never the nearest point
    matrices, reaches = sets.cones(who)
    seen = np.einsum("rij,rj->ri", matrices, values)
    excess = np.linalg.norm(seen[:, 1:], axis=1) - seen[:, 0] - reaches
    known = sets.signed_distance(who, sets.origins + values)
    assert 50 < np.sum(known < 0.0) < count - 50
    np.testing.assert_allclose(excess, known, atol=1e-12)
    limitless = {name: np.array([value]) for name, value in free.items()}
    assert np.all(np.isinf(dataclasses.replace(sets, **limitless).cones(who)[1]))


@pytest.mark.parametrize("kind", LIMITS)
def test_plans_cost_the_same_with_cones_and_with_tangent_planes(creeping: int, kind: str) -> None:
    scenario = single(limits=LIMITS[kind], start=TURNING)
    known = twin_cost(scenario)
    plan = rho.plan_convex(scenario)
    assert plan.cost == pytest.approx(known, rel=TWIN)
    assert rho.verify(plan).ok
    assert rho.certify(plan).is_globally_optimal  # with multipliers of tangent planes
    if creeping == 0 and kind != "all":
        assert plan.statistics.programs <= 3


@pytest.mark.parametrize("limits", [rho.Limits(max_acceleration=0.6), rho.Limits(max_tilt=0.03)])
def test_where_there_is_no_plan_tangent_planes_contradict_each_other(
    creeping: int, limits: rho.Limits
) -> None:
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan_convex(single(limits=limits))
    assert caught.value.is_proved
    (names,) = caught.value.conflicts.values()
    assert any("maximum" in name for name in names)
    assert any("goal" in name for name in names)


def _nearly_impossible(duration: float) -> rho.Scenario:
    """Return a flight past a sphere near infeasibility: it needs 6.36 s, and 6.42 s are too few."""
    return rho.Scenario(
        "in a hurry",
        rho.Grid(duration / 20, 21),
        [rho.Vehicle("a", rho.State([0, 0, 1]), rho.State([20, 2, 3]), radius=0.2)],
        limits=rho.Limits(max_acceleration=2.0),
        obstacles=[rho.Sphere([7, 1, 1.5], 1.5)],
    )


@pytest.mark.slow
def test_near_the_boundary_of_feasibility_few_programs_give_an_answer() -> None:
    """With tangent planes alone, programs had thousands of rows and gave no answer in minutes."""
    found = plan_along_paths(Problem.of(_nearly_impossible(6.40625)))
    assert found.plan is None
    assert found.spent.programs < 2000
    assert found.spent.rows < 20_000
    plan = rho.plan(_nearly_impossible(6.45))
    assert rho.verify(plan).ok
    assert plan.statistics.programs < 1000
