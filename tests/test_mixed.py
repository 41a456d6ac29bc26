"""Random scenes that mix all kinds of requirements: plans hold, known motions are found."""

from __future__ import annotations

import dataclasses
from contextlib import nullcontext, suppress
from pathlib import Path

import numpy as np
import pytest

import drake_rho as rho
from tests.judged import violations
from tests.mixed import Mixed, mixed
from tests.mixed_frames import Frame, moved, quarter_turn
from tests.requirements import Egg
from tests.scenarios import slow

FAST = (500, 503, 504, 505, 506, 508, 511, 512, 513)
MORE, MANY = (501, 502, 507, 509, 510, 514), range(515, 600)
"""Seeds."""

SAME = 1e-4
"""Relative, of costs in two frames: solvers resolve a cost to 1e-10, and a waypoint's time to its
square root."""

NO_PLAN = (rho.InfeasibleError, rho.SolverError)


def bounds_time(scenario: rho.Scenario) -> bool:
    """Return whether a limit or a requirement bounds how fast each vehicle may fly."""
    limits = scenario.limits
    bounded = any(getattr(limits, f.name) is not None for f in dataclasses.fields(limits)[1:])
    return bounded or any(each.of != "position" for each in scenario.requirements)


def holds(planned: rho.Plan | rho.Flight) -> bool:
    """Return whether `verify` and dense samples agree that a plan holds.

    `verify` judges a flight in wind by its windows' error tubes, each of which starts anew.
    """
    plan = planned.plan if isinstance(planned, rho.Flight) else planned
    report, found = rho.verify(planned), violations(plan)
    assert report.ok, report
    assert found == []
    return True


@pytest.mark.parametrize("seed", [*FAST, *slow(*MORE, *MANY)])
def test_known_motions_are_found_and_plans_hold(seed: int) -> None:
    """A scene with a known motion has a plan, which `verify` and dense samples accept."""
    scene = mixed(seed)
    if scene.is_certain:
        assert holds(rho.plan(scene.scenario))
        return
    with suppress(*NO_PLAN):  # planners keep margins of which the known motion knows nothing
        assert holds(rho.plan(scene.scenario))


@pytest.mark.parametrize("seed", slow(*MANY[::2]))
def test_windows_hold(seed: int) -> None:
    """A flight in windows holds wherever its first window has a plan."""
    with suppress(*NO_PLAN):
        assert holds(rho.plan_rho(mixed(seed).scenario, replan_every=3))


@pytest.mark.parametrize("seed", slow(*MANY[::3]))
def test_least_times_are_at_most_known_ones(seed: int) -> None:
    """The least time is at most that of the known motion."""
    scene = mixed(seed, leave_out=("smoothing", "disturbance"))
    bounded = bounds_time(scene.scenario)
    with nullcontext() if bounded else suppress(rho.ScenarioError):  # the least time may be zero
        plan = rho.plan_minimum_time(scene.scenario)
        assert holds(plan)
        known = scene.scenario.grid.duration
        assert plan.scenario.grid.duration <= known * (1.0 + 2e-3)


def _frame(rng: np.random.Generator, scene: Mixed) -> Frame:
    size = float(np.ptp(scene.known.positions, axis=1).max())
    later = float(rng.choice([0.0, 1.0, 1000.0])) * scene.scenario.grid.step
    return Frame(quarter_turn(rng), size * rng.normal(size=3), later, bool(rng.integers(2)))


@pytest.mark.parametrize("seed", [500, 503, 512, *slow(506, 509, *MANY[::2])])
def test_frames_change_nothing(seed: int) -> None:
    """Shifted, turned, later and with the vehicles in another order, a plan costs the same."""
    rng = np.random.default_rng([46, seed])
    scene = mixed(seed, leave_out=("smoothing", "disturbance"))
    plan = rho.plan(scene.scenario)
    again = rho.plan(moved(scene.scenario, _frame(rng, scene)))
    assert again.cost == pytest.approx(plan.cost, rel=SAME)


@pytest.mark.parametrize("seed", [500, 503, 512, *slow(506, 509, *MANY[1::2])])
@pytest.mark.parametrize("speed", [*slow(0.0), 1.0], ids=["at rest", "moving"])
def test_what_is_far_away_changes_nothing(seed: int, speed: float) -> None:
    """An obstacle a thousand flights away, at rest or in motion, leaves the cost as it is."""
    scene = mixed(seed, leave_out=("smoothing", "disturbance"))
    scenario, size = scene.scenario, float(np.ptp(scene.known.positions, axis=1).max())
    shape = rho.Sphere(scene.known.positions[0, 0] + [1e3 * size, 0.0, 0.0], size)
    grid = scenario.grid
    corners = np.array([grid.start, grid.end])
    track = rho.Track(corners, shape.center + np.outer([0.0, speed * size], [0, 1, 0]))
    far = rho.Obstacle(shape, track=track if speed else None)
    plan = rho.plan(scenario)
    again = rho.plan(dataclasses.replace(scenario, obstacles=(*scenario.obstacles, far)))
    assert again.cost == pytest.approx(plan.cost, rel=SAME)


@pytest.mark.parametrize("seed", [500, 505, *slow(510, *MANY[::4])])
def test_every_call_ends_in_an_answer_or_a_documented_error(seed: int, tmp_path: Path) -> None:
    """Certificates, reasons, files, flights in wind: answers, or errors with a reason."""
    scenario = mixed(seed).scenario
    try:
        plan = rho.plan(scenario)
    except rho.InfeasibleError:
        rho.diagnose(scenario, time_limit=5.0)
        return
    assert str(rho.verify(plan))
    certificate = rho.certify(plan)
    assert certificate.lower_bound <= plan.cost * (1.0 + 1e-6)
    if not any(isinstance(each.set, Egg) for each in scenario.requirements):  # no file has these
        rho.save(plan, tmp_path / "plan.npz")
        assert rho.load(tmp_path / "plan.npz").cost == plan.cost
    rho.export(plan, tmp_path / "plan.csv", format="csv")
    if scenario.disturbance is not None:
        wind = rho.winds.constant(scenario, np.array([1.0, 0.5, 0.0]))
        assert rho.verify(rho.simulate(plan, wind=wind)).ok
