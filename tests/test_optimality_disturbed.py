"""Certificates of disturbed plans bound every plan that the verifier accepts."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import drake_rho as rho
from tests.scenarios import box, single, slow, through_the_middle

GLOBAL_GAP = 1e-6
"""Relative gap up to which a plan counts as globally optimal."""

NOISY = rho.Disturbance(0.2, 0.01, 0.02, 0.1, 1, 0.4)
COARSE = rho.Disturbance(0.2, feedback_every=0.5)


def past_a_ball() -> rho.Scenario:
    """Return one vehicle whose best path touches the ball."""
    return single(obstacles=(rho.Sphere([5.0, 2.1, -1.0], 1.0),), between_knots=True)


CASES = {
    "ball": past_a_ball(),
    "velocity box": single(limits=rho.Limits(velocity=box(1.8))),
    "acceleration box": single(limits=rho.Limits(acceleration=box(2.0)), between_knots=True),
    "speed": single(limits=rho.Limits(max_speed=2.3)),
    "ball and box": single(
        limits=rho.Limits(velocity=box(2.0)),
        obstacles=(rho.Sphere([5.0, 2.1, -1.0], 1.0),),
    ),
}


@pytest.mark.parametrize("disturbance", [*slow(NOISY), COARSE])
@pytest.mark.parametrize("name", CASES)
def test_a_disturbed_plan_is_optimal_except_for_the_cost_of_margins(
    name: str, disturbance: rho.Disturbance
) -> None:
    plan = rho.plan_scp(dataclasses.replace(CASES[name], disturbance=disturbance))
    certificate = rho.certify(plan)
    assert certificate.holds
    assert abs(certificate.planned_gap) <= GLOBAL_GAP
    assert certificate.planned_gap - GLOBAL_GAP <= certificate.gap <= 1e-3
    calm = rho.certify(rho.plan_scp(CASES[name]))
    # margins cost something
    assert calm.lower_bound <= certificate.lower_bound * (1.0 + GLOBAL_GAP)
    assert "with the margins that planners keep" in str(certificate)
    assert "margins" not in str(calm)


SHAPES = {
    "ball": past_a_ball(),
    "ellipsoid": single(
        obstacles=(rho.Ellipsoid([5.0, 2.1, -1.0], [1.0, 1.5, 0.5]),),
        limits=rho.Limits(max_speed=2.4),
        between_knots=True,
    ),
    "pair": through_the_middle(2, separation=rho.Separation(0.8)),
    "pair with downwash": through_the_middle(2, separation=rho.Separation(0.8, 2.0)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ellipsoid", *slow("ball", "pair"), "pair with downwash"])
def test_no_plan_from_any_reference_is_below_the_bound(name: str) -> None:
    scenario = dataclasses.replace(SHAPES[name], disturbance=NOISY)
    certificate = rho.certify(rho.plan_scp(scenario))
    rng = np.random.default_rng(5)
    free = rho.plan_scp(scenario.without_obstacles().without_separation())
    found = 0
    for _ in range(10):
        moved = free.accelerations + 0.5 * rng.normal(size=free.accelerations.shape)
        reference = rho.Plan.from_accelerations(scenario, moved)
        try:
            plan = rho.plan_scp(scenario, reference=reference)
        except (rho.InfeasibleError, rho.SolverError):
            continue
        found += 1
        assert rho.verify(plan).ok
        assert certificate.lower_bound <= plan.cost * (1.0 + GLOBAL_GAP)
    assert found >= 5


def test_a_plan_with_smaller_margins_does_not_cost_less_than_the_bound() -> None:
    """In a slightly thinner tube, margins in steps are about this tube's radii at the instants."""
    scenario = dataclasses.replace(past_a_ball(), disturbance=COARSE)
    (best,) = rho.certify(rho.plan_scp(scenario)).vehicles
    tracking = rho.error_tube(scenario).tracking
    thinner = dataclasses.replace(COARSE, acceleration=0.995 * 0.2, tracking=tracking)
    plan = rho.plan_scp(dataclasses.replace(scenario, disturbance=thinner))
    checked = rho.Plan.from_accelerations(scenario, plan.accelerations)
    assert rho.verify(checked).ok
    assert best.planned_bound is not None
    assert best.lower_bound <= checked.cost < best.planned_bound * (1.0 - 1e-5)


@pytest.mark.slow
def test_shapes_other_than_quadrics_count_in_bounds() -> None:
    cuboid = rho.Box([4.0, 1.0, -2.0], [6.0, 2.5, 0.0])
    scenario = dataclasses.replace(
        single(obstacles=(cuboid,), between_knots=True), disturbance=NOISY
    )
    certificate = rho.certify(rho.plan_scp(scenario))
    assert certificate.left_out == ()
    assert certificate.lower_bound < certificate.cost
