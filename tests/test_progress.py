"""Progress reports of long work, in texts of one form."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.planning.problem import Problem
from drake_rho.planning.scp.violations import violations_of
from tests.scenarios import box, single
from tests.studies import small

BREACH = r"(, worst violation [\d.e+-]+ m, \d+ vehicles violating)?"
LINEARISED = r"linearised (once|\d+ times), cost [\d.e+-]+ m²/s⁴" + BREACH


@pytest.fixture
def swap() -> rho.Scenario:
    """Return ten vehicles that meet in the middle."""
    apart = rho.Separation(0.4, downwash=2.0)
    return rho.circle_swap(10, radius=2.0, duration=8.0, step=0.2, separation=apart)


@pytest.mark.parametrize("planner", [rho.plan, rho.plan_scp])
def test_planners_report_each_linearisation(
    planner: Callable[..., rho.Plan], swap: rho.Scenario
) -> None:
    reported = list[str]()
    plan = planner(swap, progress=reported.append)
    iterations = [each for each in reported if re.fullmatch(LINEARISED, each)]
    assert iterations[0].startswith("linearised once, cost")
    assert f"linearised {plan.statistics.linearisations} times" in iterations[-1]
    assert "worst violation" in iterations[0]  # they meet in the middle
    assert "worst violation" not in iterations[-1]
    last = float(iterations[-1].split()[4])
    assert last == pytest.approx(plan.cost, rel=0.03)  # it was stopped because it saves too little


def test_the_worst_violation_of_pairs_is_their_missing_separation(swap: rho.Scenario) -> None:
    independent = rho.plan_convex(swap.without_separation())
    plan = rho.Plan.from_accelerations(swap, independent.accelerations)
    times = np.linspace(0.0, swap.grid.duration, 4001)
    assert swap.separation is not None
    paths = plan.motion().at("position", times) / [1.0, 1.0, swap.separation.downwash]
    apart = min(
        np.linalg.norm(paths[i] - paths[j], axis=-1).min() for i in range(6) for j in range(i)
    )
    breach = violations_of(Problem.of(swap), plan).worst
    assert breach == pytest.approx(swap.separation.distance - apart, abs=1e-4)


def test_the_worst_violation_of_an_obstacle_is_the_depth_inside() -> None:
    plan = rho.plan_convex(single())  # straight through (5, 2, -1)
    scenario = single(obstacles=[rho.Sphere([5.0, 2.0, -1.0], 1.5)], between_knots=True)
    inside = rho.Plan.from_accelerations(scenario, plan.accelerations)
    assert violations_of(Problem.of(scenario), inside).worst == pytest.approx(1.5, abs=1e-6)
    assert violations_of(Problem.of(scenario), rho.plan(scenario)).worst == 0.0


def test_a_receding_horizon_reports_each_window(paper: rho.Scenario) -> None:
    reported = list[str]()
    flight = rho.plan_rho(paper, replan_every=7, progress=reported.append)
    number = len(flight.windows)
    assert reported == [f"window {k} of {number}" for k in range(1, number + 1)]
    within = list[str]()
    planner = partial(rho.plan, progress=within.append)
    rho.plan_rho(paper, replan_every=25, planner=planner)
    assert all(re.fullmatch(LINEARISED, each) for each in within)
    assert within


def test_a_simulation_reports_each_window(paper: rho.Scenario) -> None:
    reported = list[str]()
    rho.simulate(paper, replan_every=25, progress=reported.append)
    assert reported == ["window 1 of 2", "window 2 of 2"]


def test_a_certificate_reports_iterations_and_vehicles(paper: rho.Scenario) -> None:
    reported = list[str]()
    rho.certify(rho.plan_convex(paper), progress=reported.append)
    assert reported[-4:] == [f"bounding the cost of UAV-{k} ({k} of 4)" for k in range(1, 5)]
    assert all(re.fullmatch(LINEARISED, each) for each in reported[:-4])


def test_a_diagnosis_reports_its_trials() -> None:
    reported = list[str]()
    scenario = single(limits=rho.Limits(acceleration=box(0.3)))
    diagnosis = rho.diagnose(scenario, progress=reported.append)
    assert "looking for the least violation" in reported
    assert "trying a duration of 16 s" in reported  # twice as long, the first that holds
    assert "trying no limit on acceleration" in reported
    durations = [
        float(each.split()[4]) for each in reported if each.startswith("trying a duration")
    ]
    assert diagnosis.shortest_duration is not None
    assert min(abs(each - diagnosis.shortest_duration) for each in durations) < 1e-3
    again = list[str]()
    shortest = rho.shortest_plan(scenario, progress=again.append)
    assert again[0].startswith("looking for the least time")
    assert again[-1] == f"final time {shortest.scenario.grid.duration:.6g} s"


def test_a_campaign_reports_its_progress(tmp_path: Path) -> None:
    reported = list[str]()
    rho.campaign(small(1), tmp_path / "runs.sqlite", progress=lambda now: reported.append(str(now)))
    total = len(small(1))
    assert reported[0] == f"0 of {total} runs done, 0 failed"
    assert reported[-1].startswith(f"{total} of {total} runs done, ")
