"""Reports: their first lines against other means, and what their tables list."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings

import drake_rho as rho
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.system.numbers import percent
from drake_rho.verification.summary import least_effort
from tests.scenarios import scenarios


def test_a_report_without_limits_has_no_table() -> None:
    drone = rho.Vehicle("drone", rho.State([0, 0, 0]), rho.State([1, 1, 1]))
    report = rho.verify(rho.plan(rho.Scenario("free", rho.Grid(0.1, 31), [drone])))
    assert str(report).splitlines()[-1].startswith("cost ")
    assert "<table>" not in report._repr_html_()


def _fact(report: rho.Report, name: str) -> str:
    return dict(report.printed().facts)[name]


@given(scenario=scenarios())
@settings(max_examples=30)
def test_least_effort_is_that_of_the_planners_closed_form(scenario: rho.Scenario) -> None:
    cheapest = MinimumEffort.of(scenario).motion.accelerations
    assert least_effort(scenario) == pytest.approx(np.sum(cheapest**2), rel=1e-9, abs=1e-12)


def test_a_plan_without_constraints_is_at_its_bound() -> None:
    vehicles = (rho.Vehicle("solo", rho.State([0, 0, 0]), rho.State([8.0, 0, 0])),)
    report = rho.verify(rho.plan(rho.Scenario("free", rho.Grid(0.5, 21), vehicles)))
    assert report.summary.cost == pytest.approx(report.summary.least_effort, rel=1e-12)
    assert _fact(report, "cost").endswith("gap to the optimum at most 0.0001 % (quick bound)")
    assert report.clearance is None
    assert report.separation is None


def test_the_first_lines_are_those_of_dense_samples() -> None:
    scenario = rho.load_scenario("paper_assembly")
    plan = rho.plan(scenario)
    report, times = rho.verify(plan), np.linspace(0.0, 49.0, 49 * 200 + 1)
    sampled = plan.at(times)
    speeds = np.linalg.norm(sampled.velocities, axis=2)
    assert report.summary.top_speed == pytest.approx(speeds.max(), rel=1e-12)
    vehicle, instant = np.unravel_index(speeds.argmax(), speeds.shape)
    assert report.summary.fastest == sampled.names[vehicle]
    assert report.summary.fastest_at == times[instant]
    (sphere,) = scenario.spheres
    distances = np.linalg.norm(sampled.positions - sphere.center, axis=2) - sphere.radius
    assert report.clearance is not None
    assert report.clearance.value == pytest.approx(distances.min(), abs=1e-2)
    assert report.clearance.value <= distances.min()
    apart = np.linalg.norm(sampled.positions[:, None] - sampled.positions[None], axis=3)
    apart[np.arange(len(apart)), np.arange(len(apart))] = np.inf
    assert report.separation is not None
    assert report.separation.value == pytest.approx(apart.min(), abs=1e-2)
    assert report.separation.left == report.separation.value - 100.0
    pair = {report.separation.vehicle, report.separation.part.split()[1]}
    one, other, _ = np.unravel_index(apart.argmin(), apart.shape)
    assert pair == {sampled.names[one], sampled.names[other]}


def test_a_dip_between_knots_is_told_first_even_if_it_is_not_required() -> None:
    plan = rho.plan(rho.load_scenario("paper"))
    report = rho.verify(plan)
    assert report.ok
    assert "3.5" in _fact(report, "  between knots")
    assert _fact(report, "  between knots").endswith("not required")
    safe = rho.plan(dataclasses.replace(plan.scenario, between_knots=True))
    assert "  between knots" not in dict(rho.verify(safe).printed().facts)


def test_a_violated_plan_claims_no_distance_from_the_optimum() -> None:
    plan = rho.plan(rho.load_scenario("paper"))
    coasting = rho.Plan.from_accelerations(plan.scenario, np.zeros_like(plan.accelerations))
    report = rho.verify(coasting)
    assert not report.ok
    assert "optimum" not in str(report)
    assert "negative where it is violated" in str(report)


@pytest.mark.parametrize(
    ("ratio", "text"),
    [
        (0.0, "0.0001 %"),
        (2e-8, "0.0001 %"),
        (1.23e-6, "0.00012 %"),
        (0.0035, "0.35 %"),
        (0.23, "23 %"),
        (0.0996, "10 %"),
        (2.346, "235 %"),
        (123.4, "12340 %"),
        (-0.1, "10 %"),
        (float("inf"), "inf %"),
    ],
)
def test_percentages_have_two_digits_and_no_exponent(ratio: float, text: str) -> None:
    assert percent(ratio) == text
