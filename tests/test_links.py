"""The benchmarks of requirements: their scenes have plans, and their own distances are right."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

import drake_rho as rho
from tests.arrays import FloatArray

pytest.importorskip("benchmarks")  # a source archive has the tests without them

from benchmarks import linked, links_formation
from benchmarks.chain_scenes import chain_scene
from benchmarks.clearance import distances
from benchmarks.corridor_scenes import corridor
from benchmarks.kept import dense_positions, outside
from tests.requirements import outside as outside_by_requirement
from tests.scenarios import slow


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_distances_from_endless_cylinders_are_those_of_the_shape(axis: str) -> None:
    pole = rho.Cylinder([1.0, -2.0, 0.5], 0.7, axis=axis)  # type: ignore[arg-type]
    positions = np.random.default_rng(0).normal(0.0, 3.0, (500, 3))
    np.testing.assert_allclose(distances(pole, positions), pole.signed_distance(positions))
    with pytest.raises(TypeError, match="endless"):
        distances(rho.Cylinder([0, 0, 0], 1.0, 2.0), positions)


@pytest.mark.parametrize("seed", range(4))
def test_distances_from_required_sets_are_those_of_another_sampling(seed: int) -> None:
    known = chain_scene(seed).known
    accelerations = known.accelerations * np.random.default_rng(seed).uniform(0.9, 1.1)
    wild = rho.Plan.from_accelerations(known.scenario, accelerations)
    links = range(len(known.scenario.requirements))
    other = max(outside_by_requirement(wild, number, 4001) for number in links)
    assert outside(wild) == pytest.approx(other, rel=1e-9)
    times = np.linspace(0.0, known.scenario.grid.duration, dense_positions(wild).shape[1])
    np.testing.assert_allclose(dense_positions(wild), wild.motion().at("position", times))


def test_other_requirements_than_of_positions_are_refused() -> None:
    slow_flight = rho.KeepIn(rho.Ball([0, 0, 0], 3.0), of="velocity")
    scenario = dataclasses.replace(chain_scene(0).scenario, requirements=(slow_flight,))
    still = rho.Plan.from_accelerations(scenario, np.zeros((len(scenario.vehicles), 40, 3)))
    with pytest.raises(TypeError, match="expected positions"):
        outside(still)


@pytest.mark.parametrize("seed", [*range(6), *slow(*range(6, 50))])
def test_every_chain_has_a_motion(seed: int) -> None:
    scene = chain_scene(seed)
    assert rho.verify(scene.known).ok
    assert outside(scene.known) < 0.0


@pytest.mark.parametrize("seed", [4, 8, *slow(2, 32)])
def test_chains_are_planned(seed: int) -> None:
    scene = chain_scene(seed)
    trial = linked.attempt(scene.scenario)
    assert trial.counts
    assert trial.cost < scene.known.cost
    assert max(trial.excess, trial.near) <= linked.KEPT


def test_a_formation_on_a_straight_path_keeps_its_offsets_and_meets_trees() -> None:
    forest = links_formation.scene(0)
    free = dataclasses.replace(forest, obstacles=(), requirements=())
    straight = rho.Plan.from_accelerations(forest, rho.plan(free).accelerations)
    assert outside(straight) == pytest.approx(-links_formation.WITHIN)
    assert {each.kind for each in rho.verify(straight).violations} == {"obstacles"}


def _stopping(scenario: rho.Scenario) -> rho.Plan:
    """Return the motion along a corridor that rests wherever two boxes meet."""
    (vehicle,), found = scenario.vehicles, list[FloatArray]()
    corners = [vehicle.start.position, *_meetings(scenario), vehicle.goal.position]
    for asked, (first, last) in zip(scenario.requirements, pairwise(corners), strict=True):
        assert asked.active is not None
        steps = round((asked.active[1] - asked.active[0]) / scenario.grid.step)
        half = steps // 2
        push = (last - first) / (half * (steps - half) * scenario.grid.step**2)
        found += [push] * half + [np.zeros(3)] * (steps - 2 * half) + [-push] * half
    return rho.Plan.from_accelerations(scenario, np.array(found)[None])


def _meetings(scenario: rho.Scenario) -> list[FloatArray]:
    """Return the middles of what each two boxes of a corridor share."""
    boxes = [each.set for each in scenario.requirements]
    found = list[FloatArray]()
    for one, other in pairwise(boxes):
        assert isinstance(one, rho.Box)
        assert isinstance(other, rho.Box)
        lower, upper = np.maximum(one.lower, other.lower), np.minimum(one.upper, other.upper)
        assert np.all(lower <= upper)
        found.append((lower + upper) / 2.0)
    return found


@pytest.mark.parametrize("seed", [*range(8), *slow(*range(8, 20))])
def test_every_corridor_has_a_motion(seed: int) -> None:
    scenario = corridor(seed, every_instant=True)
    assert rho.verify(_stopping(scenario)).ok


def test_corridors_and_links_cost_what_cvxpy_says() -> None:
    pytest.importorskip("cvxpy")  # of the bench extra, which tests do without
    from benchmarks import links_corridors, links_cvxpy

    for lap in links_corridors.laps_of(0):
        assert lap.difference <= links_corridors.EQUAL
        assert lap.excess <= linked.KEPT
    for seed, planned in ((8, True), (9, True), (7, False)):
        found = links_cvxpy.lap(links_cvxpy.scene(seed))
        assert found.difference <= links_cvxpy.EQUAL
        assert np.isfinite(found.cost) == planned
