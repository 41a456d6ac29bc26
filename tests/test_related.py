"""Plans of related scenarios: as references, and where a longer flight has no plan of its own."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import drake_rho as rho
from benchmarks.gap_scenes import KINDS, GapScene, gap_scene
from drake_rho.planning.planners.first_plan import FirstPlan
from drake_rho.planning.planners.related import can_be_slower, fitted, rescaled
from drake_rho.planning.problem import Problem
from drake_rho.planning.scp.subproblem import Subproblem
from tests.scenarios import slow

DOOR = gap_scene("door", 4, np.random.default_rng(3))


def wider(limits: rho.Limits) -> rho.Limits:
    """Return limits with twice the acceleration."""
    assert limits.max_acceleration is not None
    return dataclasses.replace(limits, max_acceleration=2.0 * limits.max_acceleration)


ASKED = DOOR.scenario
GRID = ASKED.grid
RELATED = {
    "the same": ASKED,
    "slower": ASKED.on_grid(rho.Grid(1.7 * GRID.step, GRID.knots, GRID.start)),
    "longer": ASKED.on_grid(rho.Grid(GRID.step, GRID.knots + 7, GRID.start)),
    "fewer obstacles": dataclasses.replace(ASKED, obstacles=ASKED.obstacles[:1]),
    "looser limits": dataclasses.replace(ASKED, limits=wider(ASKED.limits)),
    "fewer vehicles": dataclasses.replace(ASKED, vehicles=ASKED.vehicles[1:3]),
}


@pytest.mark.parametrize("name", RELATED)
def test_a_known_plan_is_a_plan_of_every_relaxed_scenario(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def around(*_: object) -> rho.Plan:
        raise rho.SolverError("none")

    monkeypatch.setattr(Subproblem, "solve_around", around)
    plan = rho.plan(RELATED[name], reference=DOOR.known)
    assert rho.verify(plan).ok
    assert plan.scenario == RELATED[name]


@pytest.mark.parametrize(
    "name",
    ["the same", "fewer obstacles", "fewer vehicles", *slow("slower", "longer", "looser limits")],
)
def test_a_known_plan_is_improved(name: str) -> None:
    plan = rho.plan(RELATED[name], reference=DOOR.known)
    assert rho.verify(plan).ok
    assert plan.cost < 0.9 * fitted(DOOR.known, RELATED[name]).cost


def test_a_vehicle_keeps_a_known_plan_where_its_linearisation_has_none() -> None:
    """The obstacle-free plan is no feasible reference; the path around it was known."""
    scenario = dataclasses.replace(ASKED, vehicles=ASKED.vehicles[:1], separation=None)
    plan = rho.plan(scenario, reference=DOOR.known)
    assert rho.verify(plan).ok


def test_plans_are_not_stretched_if_obstacles_move_or_starts_differ() -> None:
    tail = rho.plan(rescaled(ASKED, 2.0), reference=DOOR.known).tail(3)
    assert fitted(tail, ASKED) is tail
    faster = rescaled(ASKED, 0.5)
    assert fitted(DOOR.known, faster) is DOOR.known


def test_a_longer_flight_without_a_plan_is_a_shorter_one_slowed_down(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first, asked, reported = FirstPlan.of, rescaled(ASKED, 2.0), list[str]()

    def missed(self: FirstPlan, problem: Problem, reference: rho.Plan | None = None) -> rho.Plan:
        scenario = problem.scenario
        if reference is None and scenario.grid == asked.grid:
            names = [vehicle.name for vehicle in scenario.vehicles]
            told_of = dict.fromkeys(names, frozenset({1}))
            raise rho.InfeasibleError(dict.fromkeys(names, ("obstacle 1",)), obstacles=told_of)
        return first(self, problem, reference)

    monkeypatch.setattr(FirstPlan, "of", missed)
    assert can_be_slower(asked)
    plan = rho.plan(asked, progress=reported.append)
    assert rho.verify(plan).ok
    assert any("trying a duration" in words for words in reported)
    ball = rho.Obstacle(rho.Sphere([0, 0, 99], 1), velocity=[0, 0, 1])
    moving = dataclasses.replace(asked, obstacles=(*asked.obstacles, ball))
    with pytest.raises(rho.InfeasibleError):
        rho.plan(moving)


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        ("door", 2),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in (("door", 0), ("two doors", 1), ("window", 3))
        ),
    ],
)
def test_fleets_through_a_gap_are_planned(kind: str, seed: int) -> None:
    scene = gap_scene(kind, 4, np.random.default_rng(seed))
    plan = rho.plan(scene.scenario)
    assert rho.verify(plan).ok
    assert plan.cost < scene.known.cost


@pytest.mark.parametrize("longer", [1.3, *slow(2.0, 5.0)])
@pytest.mark.parametrize("kind", [KINDS[0], *slow(*KINDS[1:])])
def test_more_time_never_hurts(kind: str, longer: float) -> None:
    """The known motion of a scene, slowed down or held at the goals, is one of each of these."""
    scenario = gap_scene(kind, 4, np.random.default_rng(1)).scenario
    knots = 1 + round(longer * (scenario.grid.knots - 1))
    for grid in (
        rho.Grid(longer * scenario.grid.step, scenario.grid.knots),
        rho.Grid(scenario.grid.step, knots),
    ):
        assert rho.verify(rho.plan(scenario.on_grid(grid))).ok


@pytest.mark.parametrize("kind", KINDS)
def test_gap_scenes_have_the_plan_they_are_built_around(kind: str) -> None:
    scene: GapScene = gap_scene(kind, 6, np.random.default_rng(7))
    assert rho.verify(scene.known).ok
    through = np.abs(np.diff(np.sign(scene.known.positions[:, :, 0]), axis=1)).sum(axis=1)
    assert np.all(through >= 2.0)
