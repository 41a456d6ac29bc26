"""Bounds of what a flight costs: no window costs more than the previous one, moved."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import lstsq

import drake_rho as rho
from drake_rho.planning.horizon.cost_bounds import cost_bound, effort_of_errors


def scene(
    acceleration: float = 0.3, count: int = 2, estimate: tuple[float, float] = (0.0, 0.0)
) -> rho.Scenario:
    """Return vehicles that pass a sphere in wind."""
    vehicles = [
        rho.Vehicle(
            f"v{i}",
            rho.State([0, 1.5 * i, 1]),
            rho.State([8, 1.5 * i, 1]),
            radius=0.2,
            weight=1.0 + i,
        )
        for i in range(count)
    ]
    around = rho.Disturbance(acceleration, *estimate, feedback_every=0.1)
    return rho.Scenario(
        "passing",
        rho.Grid.lasting(6.0, step=0.2),
        vehicles,
        rho.Limits(max_acceleration=4.0),
        [rho.Sphere([4, 0.2, 1], 0.8)],
        separation=rho.Separation(0.4),
        disturbance=around,
    )


@pytest.mark.parametrize("steps", [2, 3, 7])
def test_the_effort_of_errors_is_that_of_the_least_accelerations(steps: int) -> None:
    """The twin rolls the double integrator out, acceleration by acceleration."""
    h, rng = 0.3, np.random.default_rng(steps)
    columns = []
    for i in range(steps):
        p = v = 0.0
        for k in range(steps):
            a = float(k == i)
            p, v = p + h * v + h**2 / 2 * a, v + h * a
        columns.append([p, v])
    effort = effort_of_errors(steps, h)
    for _ in range(5):
        p, v = error = rng.normal(size=2)
        least = lstsq(np.transpose(columns), [-(p + steps * h * v), -v])[0]
        np.testing.assert_allclose(error @ effort @ error, least @ least, rtol=1e-9)


def test_without_a_disturbance_no_flight_costs_more_than_its_first_window() -> None:
    scenario = rho.load_scenario("paper")
    flight = rho.plan_rho(scenario, bounded_cost=True)
    first = flight.windows[0]
    assert first.cost_bound == pytest.approx(first.plan.cost, rel=1e-12)
    assert flight.cost <= first.plan.cost * (1 + 1e-9)
    assert rho.verify(flight).summary.cost_bound == first.cost_bound
    assert "first window's bound" in str(rho.verify(flight))
    unbounded = rho.plan_rho(scenario)
    assert all(window.cost_bound is None for window in unbounded.windows)


@pytest.mark.parametrize("seed", range(4))
def test_in_wind_flights_cost_at_most_their_bounds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scenario = scene(rng.uniform(0.1, 0.5), estimate=(0.01, 0.03))
    wind = (
        rho.winds.constant(scenario, rng.normal(size=3))
        if seed % 2
        else rho.winds.coloured_noise(scenario, rng)
    )
    horizon = rho.RecedingHorizon(scenario, replan_every=5, bounded_cost=True)
    flown = rho.simulate(horizon, wind=wind, rng=rng)
    plan = flown.flight.plan
    weights = np.array([1.0, 2.0])
    squares = np.sum(plan.accelerations**2, axis=2).T @ weights
    for window in flown.windows:
        assert window.cost_bound is not None
        from_here = float(squares[window.first_knot :].sum())
        assert from_here <= window.cost_bound * (1 + 1e-9)
        assert window.cost_bound >= window.plan.cost * (1 - 1e-12)


def test_a_costlier_plan_is_not_accepted_and_the_window_says_so() -> None:
    scenario = scene(count=1)

    def wiggling(scenario: rho.Scenario, *, reference: rho.Plan | None, solver: object) -> rho.Plan:
        """Plan, and add a motion that comes back to where it was."""
        plan = rho.plan(scenario, reference=reference)
        accelerations = plan.accelerations.copy()
        accelerations[:, :3, 1] += np.array([0.2, -0.4, 0.2])
        return rho.Plan.from_accelerations(scenario, accelerations)

    bounded = rho.plan_rho(scenario, planner=wiggling, fallback=None, bounded_cost=True)
    free = rho.plan_rho(scenario, planner=wiggling, fallback=None)
    assert not any(window.kept for window in free.windows)
    assert all(window.kept for window in bounded.windows[1:])
    assert all("costs more" in window.infeasible for window in bounded.windows[1:])
    assert bounded.cost < free.cost
    assert rho.verify(bounded).ok


@pytest.mark.parametrize("seed", range(3))
def test_a_plan_that_is_the_rest_of_the_previous_one_moved_is_accepted(seed: int) -> None:
    """Where nothing is active, the least accelerations to the goal are those of the rest, moved."""
    around = rho.Disturbance(0.05, 0.01, 0.02, feedback_every=0.1)
    vehicle = rho.Vehicle("v", rho.State([0, 0, 1]), rho.State([8, 1, 2]))
    scenario = rho.Scenario("alone", rho.Grid.lasting(6.0, step=0.2), [vehicle], disturbance=around)
    horizon = rho.RecedingHorizon(scenario, replan_every=3, bounded_cost=True)
    flight = rho.simulate(horizon, rng=np.random.default_rng(seed)).flight
    assert not any(window.infeasible for window in flight.windows)


def test_bounds_grow_with_the_wind_and_with_the_number_of_windows() -> None:
    plans = [rho.plan(scene(wind)) for wind in (0.1, 0.3)]
    increases = [np.sqrt(cost_bound(plan, 5)) - np.sqrt(plan.cost) for plan in plans]
    assert 0.0 < increases[0] < increases[1]
    assert cost_bound(plans[0], 5) > cost_bound(plans[0], 10)


def test_bounds_are_in_files(tmp_path: Path) -> None:
    flight = rho.plan_rho(scene(), bounded_cost=True)
    rho.save(flight, tmp_path / "flight.npz")
    loaded = rho.load(tmp_path / "flight.npz")
    assert len(loaded.windows) == len(flight.windows)
    assert [window.cost_bound for window in loaded.windows] == [
        window.cost_bound for window in flight.windows
    ]
