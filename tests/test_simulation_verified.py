"""`verify` of simulations, compared with the record evaluated by hand."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from tests.disturbed import KINDS, crowded, disturbed, least_margin, winds_for
from tests.scenarios import box, single, slow
from tests.tolerances import ROUNDING

KEPT = ("obstacle", "separation", "position box", "velocity box", "acceleration box")


def least_reported(report: rho.Report) -> float:
    """Return the least margin in a report of the constraints of `least_margin`, at all times."""
    excesses = [each.excess for each in report.checks if each.constraint.startswith(KEPT)]
    return -max(excesses)


def harsh(scenario: rho.Scenario, times: float) -> rho.Scenario:
    """Return the scenario with a stronger wind than that of its plans."""
    around = scenario.disturbance
    assert around is not None
    stronger = dataclasses.replace(around, acceleration=times * around.acceleration)
    return dataclasses.replace(scenario, disturbance=stronger)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [*slow(2), 5])
def test_the_report_agrees_with_the_record(kind: str, seed: int) -> None:
    scenario = disturbed(seed)
    rng = np.random.default_rng(seed)
    simulation = rho.simulate(
        scenario, wind=winds_for(scenario, seed)[kind], rng=rng, replan_every=4
    )
    report = rho.verify(simulation)
    assert report.ok
    reported, seen = least_reported(report), least_margin(simulation)
    between = np.abs(simulation.velocities).max() * np.diff(simulation.times).max()
    assert seen - between <= reported <= seen + ROUNDING * np.abs(simulation.positions).max()
    for quantity in ("position", "velocity", "acceleration"):
        errors, radii = simulation.errors(quantity), simulation.radii(quantity)
        assert np.all(errors <= radii[:, None] * (1.0 + 1e-9) + 1e-9)
    assert "over the tube's radii" in str(report)
    assert "left the tube" not in str(report)


@pytest.mark.parametrize("seed", [2, 5, 7])
def test_too_strong_a_wind_violates_the_reported_constraints(seed: int) -> None:
    scenario = disturbed(seed)
    plan = rho.plan(scenario)
    stormy = harsh(scenario, 40.0)
    wind = rho.winds.constant(stormy, [0.0, 1.0, 0.3])
    flown = rho.simulate(rho.Plan.from_accelerations(stormy, plan.accelerations), wind=wind)
    # verified for the original scenario
    simulation = dataclasses.replace(flown, flight=_one_window(plan))
    report = rho.verify(simulation)
    assert not report.ok
    broken = {violation.constraint for violation in report.violations}
    assert "goal" in broken
    assert "dynamics" not in broken
    missed = np.linalg.norm(simulation.positions[-1] - scenario.fleet.goal_positions, axis=1)
    goals = [each for each in report.checks if each.what == "goal position"]
    np.testing.assert_allclose([each.value for each in goals], missed, rtol=1e-9)
    radius = rho.error_tube(scenario).position(scenario.grid.end)
    assert all(each.limit == each.errors == radius for each in goals)
    assert "vehicles left the tube" in str(report)
    reported, seen = least_reported(report), least_margin(simulation)
    assert reported <= seen + 1e-9
    assert (reported < 0.0) == bool(broken - {"goal"})


def _one_window(plan: rho.Plan) -> rho.Flight:
    return rho.Flight(plan, (rho.Window(0, plan, plan),))


def test_limits_on_accelerations_are_on_the_commands() -> None:
    scenario = disturbed(5)
    rng = np.random.default_rng(3)
    wind = winds_for(scenario, 5)["noise"]
    simulation = rho.simulate(scenario, wind=wind, rng=rng, replan_every=4)
    largest = np.linalg.norm(simulation.commands, axis=2).max(axis=0)
    for factor, holds in ((1.0 + 1e-3, True), (1.0 - 1e-3, False)):
        limits = dataclasses.replace(
            scenario.limits, max_acceleration=factor * float(largest.max())
        )
        report = rho.verify(_with_scenario(simulation, limits=limits))
        checks = [each for each in report.checks if each.constraint == "maximum acceleration"]
        np.testing.assert_allclose([each.value for each in checks], largest, rtol=1e-12)
        assert all(each.holds for each in checks) == holds
        assert all(each.errors == 0.0 for each in checks)


def _with_scenario(simulation: rho.Simulation, **changes: Any) -> rho.Simulation:
    """Return the simulation with another scenario of its plan."""
    plan = simulation.flight.plan
    scenario = dataclasses.replace(plan.scenario, **changes)
    plan = rho.Plan(scenario, plan.positions, plan.velocities, plan.accelerations)
    return dataclasses.replace(simulation, flight=rho.Flight(plan, simulation.flight.windows))


def test_no_violation_between_two_times_of_a_record_is_missed() -> None:
    """The pole is thinner than the distance between two times of the record."""
    scenario = dataclasses.replace(
        single(grid=rho.Grid(2.0, 5), goal=rho.State([40.0, 0.0, 0.0])),
        disturbance=rho.Disturbance(0.0),
        between_knots=True,
    )
    simulation = rho.simulate(scenario)
    m = len(simulation.times) // 2
    middle = simulation.positions[m : m + 2, 0].mean(axis=0)
    pole = rho.Sphere(middle, 0.05 * float(np.ptp(simulation.positions[m : m + 2, 0], axis=0)[0]))
    report = rho.verify(_with_scenario(simulation, obstacles=(pole,)))
    at_knots, always = (each for each in report.checks if each.constraint == "obstacle 1")
    assert at_knots.holds
    assert not always.holds
    assert simulation.times[m] < always.time < simulation.times[m + 1]
    assert always.value == pytest.approx(-pole.radius, abs=0.01 * pole.radius)


def test_a_record_that_was_not_flown_is_found() -> None:
    simulation = rho.simulate(disturbed(5))
    positions = np.array(simulation.positions)
    positions[17, 0, 1] += 0.01
    (violation,) = rho.verify(dataclasses.replace(simulation, positions=positions)).violations
    assert violation.what == "dynamics position"
    assert violation.time == pytest.approx(simulation.times[17], abs=1e-12)
    assert violation.excess == pytest.approx(0.01)


def test_windows_with_the_previous_plan_and_vehicles_off_the_tube_are_reported() -> None:
    scenario = crowded(14)
    simulation = rho.simulate(scenario, wind=winds_for(scenario, 14)["constant"], replan_every=3)
    kept = sum(window.kept for window in simulation.flight.windows)
    assert kept > 0
    report = rho.verify(simulation)
    assert report.ok
    assert f"{len(simulation.flight.windows)} windows, {kept} of them kept" in str(report)
    last = simulation.flight.windows[-1]
    off = dataclasses.replace(last, off_tube=("v1",))
    flight = dataclasses.replace(simulation.flight, windows=(*simulation.flight.windows[:-1], off))
    reported = str(rho.verify(dataclasses.replace(simulation, flight=flight)))
    assert f"outside the error tube: v1 from {last.plan.scenario.grid.start:g} s" in reported


@pytest.mark.slow
def test_a_quadrotor_is_verified_by_its_record() -> None:
    scenario = disturbed(12, delay=0, errors=False)
    wind = rho.winds.constant(scenario, [1, -1, 0.3])
    simulation = rho.simulate(scenario, plant="quadrotor", wind=wind)
    report = rho.verify(simulation)
    assert "quadrotor: verified from states recorded every 0.000998 s" in str(report)
    assert not any(each.constraint == "dynamics" for each in report.checks)
    reported, seen = least_reported(report), least_margin(simulation)
    assert seen - 1e-2 <= reported <= seen + 1e-9


def test_a_window_without_a_plan_in_free_space_violates_least() -> None:
    """More wind than declared pushes the vehicle out of its box, and it plans on from there."""
    scenario = dataclasses.replace(
        single(limits=rho.Limits(velocity=box(1.5))),
        disturbance=rho.Disturbance(0.05, feedback_every=0.1),
    )
    horizon = rho.RecedingHorizon(scenario)
    horizon.step(np.zeros((1, 6)), 0.0)
    window = horizon.step([[1.0, 0.5, 0.0, 2.5, 0.0, 0.0]], 2.5)
    assert window.infeasible
    assert not window.kept
    assert window.off_tube == ("solo",)
    broken = {each.constraint for each in rho.verify(window.plan).violations}
    assert "velocity box" in broken


def test_the_verified_jerk_is_that_of_the_plans() -> None:
    scenario = dataclasses.replace(
        single(limits=rho.Limits(jerk=box(5.0))),
        disturbance=rho.Disturbance(0.2, feedback_every=0.1),
    )
    simulation = rho.simulate(scenario, wind=rho.winds.constant(scenario, [0.0, 1.0, 0.0]))
    (check,) = (each for each in rho.verify(simulation).checks if each.constraint == "jerk box")
    jerks = simulation.flight.plan.motion().jerks()[:, 1:]
    assert abs(check.value) == pytest.approx(np.abs(jerks).max(), rel=1e-9)
