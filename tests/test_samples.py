"""States at given times: `at` of plans, flights and simulations against Drake and finer records."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import drake_rho as rho
from tests.disturbed import disturbed
from tests.scenarios import through_the_middle

CLOCKS = (0.0, -3.5, 1_764_000_000.0)
"""Starts of flights: zero, before it, and today's Unix time."""


def plan_from(start: float) -> rho.Plan:
    scenario = through_the_middle(2)
    grid = dataclasses.replace(scenario.grid, start=start)
    return rho.plan(dataclasses.replace(scenario, grid=grid))


@pytest.mark.parametrize("start", CLOCKS)
def test_a_plan_at_its_knots_is_the_plan_to_the_last_digit(start: float) -> None:
    plan = plan_from(start)
    found = plan.at(plan.times)
    np.testing.assert_array_equal(found.positions, plan.positions)
    np.testing.assert_array_equal(found.velocities, plan.velocities)
    np.testing.assert_array_equal(found.accelerations[:, :-1], plan.accelerations)
    np.testing.assert_array_equal(found.accelerations[:, -1], plan.accelerations[:, -1])
    assert found.names == plan.scenario.names


@pytest.mark.parametrize("start", CLOCKS)
def test_between_knots_a_plan_is_drakes_trajectory(start: float) -> None:
    plan = plan_from(start)
    grid = plan.scenario.grid
    elapsed = np.random.default_rng(1).uniform(0.0, grid.duration, 40)
    times = grid.start + elapsed
    for vehicle in plan.scenario.vehicles:
        found = plan.at(times, vehicle=vehicle.name)
        trajectory = plan.trajectory(vehicle.name)
        late = 1e-6 * max(1.0, abs(start) / 1e9)  # rounding of the clock
        for values, order in zip((found.positions, found.velocities), (0, 1), strict=True):
            expected = [trajectory.EvalDerivative(time, order).ravel() for time in times]
            np.testing.assert_allclose(values, expected, atol=late * 10.0)
        assert found.names == (vehicle.name,)
        assert found.positions.shape == found.accelerations.shape == (40, 3)


def test_a_flight_is_its_flown_plan_and_a_simulation_its_true_motion() -> None:
    flight = rho.plan_rho(through_the_middle(2), replan_every=4)
    times = np.linspace(flight.plan.times[0], flight.plan.times[-1], 33)
    np.testing.assert_array_equal(flight.at(times).states, flight.plan.at(times).states)
    scenario = disturbed(3)
    flown = rho.simulate(scenario, wind=rho.winds.constant(scenario, [1.0, 0.0, 0.0]))
    found = flown.at(flown.times)
    np.testing.assert_allclose(found.positions, np.swapaxes(flown.positions, 0, 1), atol=1e-12)
    np.testing.assert_allclose(found.velocities, np.swapaxes(flown.velocities, 0, 1), atol=1e-12)
    middle = 0.5 * (flown.times[:-1] + flown.times[1:])
    expected = np.swapaxes(flown.commands[:-1] + flown.wind[:-1], 0, 1)
    np.testing.assert_allclose(flown.at(middle).accelerations, expected, atol=1e-6)


def test_a_single_time_is_one_sample() -> None:
    plan = plan_from(0.0)
    one = plan.at(plan.times[3], vehicle=plan.scenario.names[1])
    assert one.positions.shape == (1, 3)
    np.testing.assert_array_equal(one.positions[0], plan.positions[1, 3])
    assert repr(plan.at([0.0, 1.0])) == "<Samples of 2 vehicles at 2 times>"
    assert repr(one) == f"<Samples of {plan.scenario.names[1]} at 1 time>"


def test_columns_are_the_rows_of_a_table() -> None:
    plan = plan_from(0.0)
    times = np.linspace(0.0, plan.times[-1], 7)
    columns = plan.at(times).columns()
    assert columns["vehicle"] == [name for name in plan.scenario.names for _ in times]
    assert columns["time [s]"] == 2 * times.tolist()
    for axis, name in enumerate("xyz"):
        expected = plan.at(times).velocities[..., axis].ravel().tolist()
        assert columns[f"v{name} [m/s]"] == expected
    one = plan.at(times, vehicle=plan.scenario.names[0]).columns()
    assert {name: values[:7] for name, values in columns.items()} == one


@pytest.mark.parametrize(
    ("flown", "arguments", "words"),
    [
        ("plan", (99.0,), "times: got 99 s, expected times of the flight, from 0 to"),
        ("plan", ([0.0, -0.1],), "times: got -0.1 s, expected"),
        ("plan", ([0.0, np.nan],), "times: got nan s, expected"),
        ("plan", ([[0.0]],), r"times: got shape \(1, 1\), expected \(T,\) or a single time"),
        ("plan", (0.0, "v00"), r"vehicle: got 'v00', expected one of v0, v1; did you mean v"),
        ("simulation", (1e3,), "times: got 1000 s, expected"),
        ("simulation", (0.0, "nobody"), "vehicle: got 'nobody', expected one of"),
    ],
)
def test_a_time_outside_the_flight_and_an_unknown_vehicle_are_refused(
    flown: str, arguments: tuple[object, ...], words: str
) -> None:
    found: rho.Plan | rho.Simulation = (
        plan_from(0.0) if flown == "plan" else rho.simulate(disturbed(3))
    )
    with pytest.raises(ValueError, match=words):
        found.at(*arguments)  # type: ignore[arg-type]


def test_of_a_large_fleet_the_nearest_name_is_suggested() -> None:
    scenario = rho.circle_swap(40, radius=20.0, duration=10.0, step=0.5)
    wrong = scenario.names[17] + "x"
    with pytest.raises(ValueError, match="expected one of 40 names; did you mean"):
        scenario.index_of(wrong)
