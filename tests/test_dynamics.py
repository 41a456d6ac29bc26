"""Motion is exact: at the knots, between them, and as a response to the accelerations."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import drake_rho as rho
from drake_rho.motion.dynamics import Motion, response, roll_out, vectors_of
from tests.motions import from_start
from tests.scenarios import single
from tests.tolerances import ROUNDING

seeds = st.integers(0, 2**32 - 1)


def _random_motion(seed: int, before: bool = True) -> tuple[rho.State, Motion]:
    rng = np.random.default_rng(seed)
    step, steps = 10 ** rng.uniform(-2, 2), int(rng.integers(1, 40))
    start = rho.State(
        rng.normal(size=3), rng.normal(size=3), rng.normal(size=3) if before else None
    )
    return start, from_start(start, rng.normal(size=(steps, 3)), step)


def test_constant_acceleration_is_a_parabola() -> None:
    p0, v0, a = np.array([1.0, 2.0, 3.0]), np.array([-1.0, 0.0, 4.0]), np.array([0.5, -2.0, 9.81])
    p, v = roll_out(p0, v0, np.tile(a, (10, 1)), 0.3)
    t = 0.3 * np.arange(11)[:, None]
    np.testing.assert_allclose(p, p0 + v0 * t + a * t**2 / 2, rtol=ROUNDING)
    np.testing.assert_allclose(v, v0 + a * t, rtol=ROUNDING)


@given(seed=seeds)
def test_the_roll_out_is_equations_1_and_2(seed: int) -> None:
    _, motion = _random_motion(seed)
    h, p, v, a = motion.step, motion.positions, motion.velocities, motion.accelerations
    scale = np.abs(p).max()
    for k in range(len(a)):
        np.testing.assert_allclose(v[k + 1], v[k] + h * a[k], atol=ROUNDING * scale / h)
        step = h * v[k] + h**2 / 2 * a[k]
        np.testing.assert_allclose(p[k + 1], p[k] + step, atol=ROUNDING * scale)


@given(seed=seeds)
def test_responses_equal_the_motion_at_any_time(seed: int) -> None:
    start, motion = _random_motion(seed)
    steps, h = len(motion.accelerations), motion.step
    times = np.concatenate(
        [
            h * np.arange(steps + 1),
            np.random.default_rng(seed).uniform(0, h * steps, 20),
        ]
    )
    p = response("position", h, steps + 1, times) @ motion.accelerations
    v = response("velocity", h, steps + 1, times) @ motion.accelerations
    p += start.position + times[:, None] * start.velocity
    v += start.velocity
    scale = np.abs(motion.positions).max()
    np.testing.assert_allclose(p, motion.at("position", times), atol=ROUNDING * scale)
    np.testing.assert_allclose(v, motion.at("velocity", times), atol=ROUNDING * (1 + scale / h))


@given(seed=seeds, given_before=st.booleans())
def test_jerk_is_equation_7(seed: int, given_before: bool) -> None:
    start, motion = _random_motion(seed, given_before)
    a, h = motion.accelerations, motion.step
    after = np.array([1.0, -2.0, 0.5])
    motion = dataclasses.replace(motion, after=after)
    jerk = motion.at("jerk", h * np.arange(len(a) + 1))
    np.testing.assert_array_equal(jerk, motion.jerks())
    np.testing.assert_allclose(jerk[1:-1], (a[1:] - a[:-1]) / h, rtol=ROUNDING)
    first = np.full(3, np.nan) if start.acceleration is None else (a[0] - start.acceleration) / h
    np.testing.assert_allclose(jerk[0], first, rtol=ROUNDING)
    np.testing.assert_allclose(jerk[-1], (after - a[-1]) / h, rtol=ROUNDING)
    answer = response("jerk", h, len(a) + 1, h * np.arange(1, len(a) + 1)) @ a
    answer[-1] += after / h
    np.testing.assert_allclose(answer, jerk[1:], rtol=ROUNDING, atol=ROUNDING / h)


@pytest.mark.parametrize("quantity", ["acceleration", "jerk"])
@pytest.mark.parametrize("part", [0.0, 0.25, 0.5, 0.75, 0.999])
@given(seed=seeds)
def test_acceleration_and_jerk_belong_to_the_step_of_a_time(
    quantity: Any, part: float, seed: int
) -> None:
    """They are right-continuous: a knot belongs to the step that it begins."""
    _, motion = _random_motion(seed)
    a, h = motion.accelerations, motion.step
    times = np.array([h * (k + part) for k in range(len(a))])
    values = motion.at(quantity, times)
    known = a if quantity == "acceleration" else np.diff(a, axis=0, prepend=[motion.before]) / h
    np.testing.assert_array_equal(values, known)
    states = motion.positions, motion.velocities, a, motion.before, motion.after
    several = Motion(h, *(np.stack([np.zeros_like(each), each]) for each in states))
    own = several.each_at(quantity, np.ones(len(a), dtype=int), times)
    np.testing.assert_array_equal(own, known)
    if quantity == "acceleration":
        answer = response(quantity, h, len(a) + 1, times) @ a
        np.testing.assert_allclose(answer, known, rtol=ROUNDING)


def test_vectors_are_selected_by_both_indices_in_any_memory_order() -> None:
    rng = np.random.default_rng(0)
    array = rng.normal(size=(7, 11, 3))
    vehicles, k = rng.integers(0, 7, 40), rng.integers(0, 5, 40)
    for each in (array, array[:, 3:], array[::2].repeat(2, axis=0)[:7], array.transpose(1, 0, 2)):
        taken = vectors_of(each, vehicles, k)
        np.testing.assert_array_equal(taken, [each[i, j] for i, j in zip(vehicles, k, strict=True)])


def test_motion_between_knots_equals_numerical_integration() -> None:
    _, motion = _random_motion(3)
    h, a = motion.step, motion.accelerations
    state = np.concatenate([motion.positions[0], motion.velocities[0]])
    for k in range(len(a)):

        def rates(t: float, x: np.ndarray, thrust: np.ndarray = a[k]) -> np.ndarray:
            return np.concatenate([x[3:], thrust])

        flown = solve_ivp(rates, (0, h), state, t_eval=[0.4 * h, h])
        middle = motion.at("position", [(k + 0.4) * h])[0]
        np.testing.assert_allclose(flown.y[:3, 0], middle, rtol=1e-7, atol=1e-7 * h)
        state = flown.y[:, 1]


def test_the_trajectory_in_drake_is_the_plan(paper: rho.Scenario) -> None:
    plan = rho.plan_convex(paper)
    times = np.linspace(0.0, plan.scenario.grid.duration, 301)
    motion = plan.motion()
    for index, vehicle in enumerate(paper.vehicles):
        drakes = plan.trajectory(vehicle.name)
        assert drakes.get_number_of_segments() == 49
        for quantity, order in (("position", 0), ("velocity", 1)):
            theirs = np.array([drakes.EvalDerivative(t, order)[:, 0] for t in times])
            ours = motion.at(quantity, times)[index]  # type: ignore[arg-type]  # a literal
            np.testing.assert_allclose(theirs, ours, rtol=ROUNDING, atol=1e-6)


def test_the_jerks_of_a_plan_include_the_accelerations_outside_of_it() -> None:
    start = rho.State([0, 0, 0], acceleration=[5.0, 0.0, 0.0])
    goal = rho.State([10, 4, -2], acceleration=[0.0, 3.0, 0.0])
    plan = rho.plan_convex(single(start=start, goal=goal))
    jerk = plan.motion().at("jerk", plan.times)
    assert jerk.shape == (1, 17, 3)
    np.testing.assert_allclose(jerk[0, 0], (plan.accelerations[0, 0] - [5, 0, 0]) / 0.5)
    np.testing.assert_allclose(jerk[0, -1], ([0, 3, 0] - plan.accelerations[0, -1]) / 0.5)
    np.testing.assert_array_equal(plan.motion().at("position", 2.0)[:, 0], plan.positions[:, 4])


def test_an_unknown_quantity_is_refused() -> None:
    with pytest.raises(ValueError, match=r"'positon'.*position, velocity, acceleration, jerk"):
        rho.plan_convex(single()).motion().at("positon", [0.0])  # type: ignore[arg-type]  # tested


@pytest.mark.parametrize("knot", [-1, 16, 17, 99])
def test_a_tail_begins_with_a_step(knot: int) -> None:
    with pytest.raises(ValueError, match="knot: got"):
        rho.plan_convex(single()).tail(knot)


def test_the_goal_is_met_to_rounding_after_many_windows(paper: rho.Scenario) -> None:
    plan = rho.plan_rho(paper, replan_every=1).plan
    goals = np.array([vehicle.goal.position for vehicle in paper.vehicles])
    np.testing.assert_allclose(plan.positions[:, -1], goals, atol=1e-9)
    np.testing.assert_allclose(plan.velocities[:, -1], 0.0, atol=1e-11)


def test_an_unknown_vehicle_has_no_trajectory() -> None:
    plan = rho.plan_convex(single())
    with pytest.raises(ValueError, match=r"'nobody'.*solo"):
        plan.trajectory("nobody")


def test_a_plan_of_the_wrong_shape_is_refused() -> None:
    scenario = single()
    with pytest.raises(ValueError, match="positions: got shape"):
        rho.Plan(scenario, np.zeros((1, 5, 3)), np.zeros((1, 17, 3)), np.zeros((1, 16, 3)))


@given(knot=st.integers(0, 15))
def test_the_tail_of_a_plan_is_the_same_motion(knot: int) -> None:
    plan = rho.plan_convex(single())
    tail = plan.tail(knot)
    assert tail.scenario.grid == rho.Grid(0.5, 17 - knot, 0.5 * knot)
    assert rho.verify(tail).ok
    later = np.linspace(0, tail.scenario.grid.duration, 50)
    np.testing.assert_allclose(
        tail.motion().at("position", later),
        plan.motion().at("position", later + 0.5 * knot),
        atol=ROUNDING * 10,
    )
