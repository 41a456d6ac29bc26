"""Every constraint holds and has an effect: without it, it would be violated."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.solvers import SolverInterface

import drake_rho as rho
from tests.scenarios import box, single

LIMITS = {
    "position box": rho.Limits(position=rho.Box([-1.0, -1.0, -2.5], [10.5, 5.0, 1.0])),
    "velocity box": rho.Limits(velocity=box(1.5)),
    "acceleration box": rho.Limits(acceleration=box(0.8)),
    "jerk box": rho.Limits(jerk=box(1.0)),
    "maximum speed": rho.Limits(max_speed=1.5),
    "maximum acceleration": rho.Limits(max_acceleration=0.8),
    "maximum thrust": rho.Limits(max_thrust=9.9),
    "maximum tilt": rho.Limits(max_tilt=0.07),
}
STARTS = {
    # running past the goal activates the position box
    "position box": rho.State([0.0, 0.0, 0.0], [4.0, 1.0, 3.0]),
    # no thrust before, so that the cheapest first acceleration is a jump
    "jerk box": rho.State([0.0, 0.0, 0.0], acceleration=[0.0, 0.0, 0.0]),
}


@pytest.mark.parametrize("kind", LIMITS)
def test_a_limit_holds_and_has_an_effect(kind: str, solver: SolverInterface) -> None:
    start = STARTS.get(kind)
    free = rho.plan_convex(single(start=start), solver=solver)
    limited = rho.plan_convex(single(start=start, limits=LIMITS[kind]), solver=solver)
    assert rho.verify(limited).ok
    assert limited.cost > free.cost * 1.001

    unlimited = rho.Plan.from_accelerations(limited.scenario, free.accelerations)
    violations = rho.verify(unlimited).violations
    assert {violation.constraint for violation in violations} == {kind}


def test_the_goal_holds_and_has_an_effect() -> None:
    plan = rho.plan_convex(single())
    np.testing.assert_allclose(plan.positions[0, -1], [10.0, 4.0, -2.0], atol=1e-9)
    np.testing.assert_allclose(plan.velocities[0, -1], 0.0, atol=1e-9)
    coasting = rho.Plan.from_accelerations(plan.scenario, np.zeros((1, 16, 3)))
    assert {violation.constraint for violation in rho.verify(coasting).violations} == {"goal"}


def test_the_acceleration_before_the_first_knot_counts_for_the_jerk() -> None:
    limits = rho.Limits(jerk=box(1.0))
    free = rho.plan_convex(single(limits=limits))
    start = rho.State([0.0, 0.0, 0.0], acceleration=[-0.2, 0.0, 0.0])
    bound = rho.plan_convex(single(limits=limits, start=start))
    assert rho.verify(bound).ok
    assert bound.accelerations[0, 0, 0] <= -0.2 + 1.0 * 0.5 + 1e-6
    assert free.accelerations[0, 0, 0] > 0.0
    assert bound.cost > free.cost
    unlimited = rho.Plan.from_accelerations(bound.scenario, free.accelerations)
    assert {violation.constraint for violation in rho.verify(unlimited).violations} == {"jerk box"}


SPHERES = (
    rho.Sphere([3.0, 1.3, -0.5], 1.0),
    rho.Sphere([6.5, 2.2, -1.5], 1.2),
)


@pytest.mark.parametrize("count", [1, 2])
def test_obstacles_are_avoided_and_have_an_effect(count: int, solver: SolverInterface) -> None:
    scenario = single(obstacles=SPHERES[:count])
    through = rho.plan_convex(scenario.without_obstacles(), solver=solver)
    around = rho.plan_convex(scenario, solver=solver)
    for plan, ok in ((around, True), (through, False)):
        for number, sphere in enumerate(SPHERES[:count]):
            distance = np.linalg.norm(plan.positions[0] - sphere.center, axis=1).min()
            assert (distance >= sphere.radius * (1 - 1e-6)) == ok, number
    assert around.cost > through.cost


def test_overlapping_obstacles_are_avoided() -> None:
    overlapping = (rho.Sphere([5.0, 1.5, -1.0], 1.0), rho.Sphere([5.0, 2.5, -0.5], 1.3))
    assert rho.verify(rho.plan_scp(single(obstacles=overlapping))).ok


def test_a_vehicles_own_limits_bind_only_that_vehicle(paper: rho.Scenario) -> None:
    free = rho.plan_convex(paper.without_obstacles())
    slow = rho.Limits(velocity=box(140.0))
    vehicles = (
        rho.Vehicle("UAV-1", paper.vehicles[0].start, paper.vehicles[0].goal, slow),
        *paper.vehicles[1:],
    )
    scenario = rho.Scenario("slow", paper.grid, vehicles, paper.limits)
    plan = rho.plan_convex(scenario)
    assert rho.verify(plan).ok
    assert np.abs(free.velocities[0]).max() > 141.0
    assert np.abs(plan.velocities[0]).max() == pytest.approx(140.0, rel=1e-6)
    np.testing.assert_allclose(plan.accelerations[1:], free.accelerations[1:], atol=1e-9)


def test_a_box_of_zero_width_keeps_the_flight_in_a_plane() -> None:
    flat = rho.Limits(position=rho.Box([-20, -20, 0], [20, 20, 0]))
    goal = rho.State([10.0, 4.0, 0.0])
    plan = rho.plan_scp(single(limits=flat, goal=goal, obstacles=(rho.Sphere([5, 2.2, 0.3], 1),)))
    assert rho.verify(plan).ok
    np.testing.assert_allclose(plan.positions[0, :, 2], 0.0, atol=1e-5)


def test_a_reference_through_the_very_centre_has_a_direction() -> None:
    # the knot in the middle of the straight path is the centre itself
    sphere = rho.Sphere([5.0, 2.0, -1.0], 0.01)
    plan = rho.plan_convex(single(obstacles=(sphere,)))
    assert rho.verify(plan).ok
    distance = np.linalg.norm(plan.positions[0] - sphere.center, axis=1).min()
    assert distance == pytest.approx(0.01, rel=1e-5)
    again = rho.plan_convex(single(obstacles=(sphere,)))
    np.testing.assert_array_equal(plan.positions, again.positions)


def test_a_vehicle_that_starts_at_its_goal_stays() -> None:
    here = rho.State([1.0, 2.0, 3.0])
    plan = rho.plan_convex(single(start=here, goal=here, limits=rho.Limits(box(5), box(1), box(1))))
    assert rho.verify(plan).ok
    assert plan.cost == pytest.approx(0.0, abs=1e-12)


def test_a_jerk_box_without_zero_leaves_unknown_accelerations_in_motion_alone() -> None:
    braking = rho.Limits(jerk=rho.Box([-1.0, -1.0, -1.0], [-0.01, 1.0, 1.0]))
    start, goal = rho.State([0, 0, 0], [1, 0, 0]), rho.State([10, 4, -2], [1, 0, 0])
    plan = rho.plan_convex(single(limits=braking, start=start, goal=goal))
    assert rho.verify(plan).ok
    assert np.all(np.diff(plan.accelerations[0, :, 0]) / 0.5 <= -0.01 + 1e-6)
    with pytest.raises(rho.InfeasibleError):  # from rest to rest it begins and ends at zero
        rho.plan_convex(single(limits=braking))
