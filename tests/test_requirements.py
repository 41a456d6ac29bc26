"""Requirements: each holds and has an effect, costs what a twin says, and is verified densely."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import drake_rho as rho
from tests.arrays import FloatArray
from tests.cones import TWIN, twin_cost
from tests.requirements import Egg, outside, random_scene
from tests.scenarios import examples, fleet, single, slow

NEAR = 1e-6
"""Tolerance of all constraints, relative to the motion's length scale."""


def two(*requirements: rho.KeepIn, **fields: Any) -> rho.Scenario:
    """Return two vehicles that fly beside each other and apart again, with requirements."""
    scenario = fleet([[0, 0, 0], [0, 3, 0]], [[12, 0, 0], [12, 9, 0]], **fields)
    return dataclasses.replace(scenario, separation=None, requirements=requirements)


LINK = rho.KeepIn(rho.Ball([0, 0, 0], 4.0), vehicles="v1", relative_to="v0", active=(0.0, 7.0))
TRACK = rho.Track([0, 4, 10], [[0, 3, 0], [3, 6, 2], [12, 9, 0]])
CASES: dict[str, tuple[rho.KeepIn, ...]] = {
    "link": (LINK,),
    "own set": (dataclasses.replace(LINK, set=Egg([0, 0, 0], 4.0)),),
    "two links": (LINK, dataclasses.replace(LINK, set=rho.Box([-2, 1, -1], [2, 4, 1]))),
    "floor": (rho.KeepIn(rho.HalfSpace([0, 0, -1], -1.0), active=(3.0, 6.0)),),
    "instant": (rho.KeepIn(rho.Ball([5, 2, 3], 0.3), vehicles="v0", active=(4.1, 4.1)),),
    "exact instant": (rho.KeepIn(rho.Box([5, 2, 3], [5, 2, 3]), vehicles="v0", active=(4.1, 4.1)),),
    "corridor": (
        rho.KeepIn(rho.Box([-1, -1, -1], [6, 1, 2]), vehicles="v0", active=(0.0, 4.3)),
        rho.KeepIn(rho.Box([4, -1, 1], [13, 3, 4]), vehicles="v0", active=(4.3, 7.7)),
    ),
    "following": (rho.KeepIn(rho.Ball([0, 0, 0], 0.5), vehicles="v1", relative_to=TRACK),),
    "gate": (
        rho.KeepIn(rho.Ball([6, 2, 1], 0.5), vehicles="v0", active=(5.0, 5.0)),
        rho.KeepIn(
            rho.Cone([0, 0, 0], [0, 1, 0], 0.3), of="velocity", vehicles="v0", active=(5.0, 5.0)
        ),
    ),
    "same speed": (
        rho.KeepIn(
            rho.Ball([0, 0, 0], 0.1), of="velocity", vehicles="v1", relative_to="v0", active=(2, 6)
        ),
    ),
    "with a current": (
        rho.KeepIn(
            rho.Ball([0, 0, 0], 1.0), of="velocity", vehicles="v1", relative_to=TRACK, active=(3, 6)
        ),
    ),
    "push": (rho.KeepIn(rho.Box([-1, -1, -0.1], [0.55, 1, 1]), of="acceleration"),),
    "lean": (rho.KeepIn(rho.Cone([0, 0, 0], [0, 0, 1], 0.06), of="thrust"),),
    "jerk": (rho.KeepIn(rho.Ball([0, 0, 0], 0.13), of="jerk", active=(1.0, 9.0)),),
    "formation": (
        rho.KeepIn(rho.Ball([0, 3, 1], 0.2), vehicles="v1", relative_to="v0", active=(3.0, 6.0)),
    ),
}
"""Requirements that the motions of least effort violate."""


@pytest.mark.parametrize("between_knots", [True, False])
@pytest.mark.parametrize("case", CASES)
def test_every_requirement_holds_and_has_an_effect(case: str, between_knots: bool) -> None:
    scenario = two(*CASES[case], between_knots=between_knots)
    free = rho.plan(dataclasses.replace(scenario, requirements=()))
    kept = rho.plan(scenario)
    assert rho.verify(kept).ok
    assert max(outside(kept, i) for i in range(len(CASES[case]))) <= 12.0 * NEAR
    same = rho.Plan.from_accelerations(scenario, free.accelerations)
    assert {each.kind for each in rho.verify(same).violations} == {"requirements"}
    assert kept.cost > free.cost * (1.0 + 1e-9)


@pytest.mark.parametrize("case", CASES)
def test_the_verifier_finds_the_worst_of_dense_samples(case: str) -> None:
    rng = np.random.default_rng(0)
    scenario = two(*CASES[case])
    wild = rho.Plan.from_accelerations(scenario, 3.0 * rng.standard_normal((2, 20, 3)))
    checks = [
        each for each in rho.verify(wild).checks if each.kind == "requirements" and each.asked
    ]
    for number in range(len(CASES[case])):
        own = [each for each in checks if each.constraint == f"requirement {number + 1}"]
        worst = max(each.value for each in own)
        assert worst >= outside(wild, number) - 1e-9 * abs(worst)
        assert worst == pytest.approx(outside(wild, number, 20_001), rel=1e-3, abs=1e-3)


def ball(asked: rho.KeepIn) -> rho.Sphere:
    """Return the set of a requirement, which is a ball."""
    assert isinstance(asked.set, rho.Sphere)
    return asked.set


@pytest.mark.parametrize("seed", [1, 2, *slow(0, 3, 4, 5)])
def test_linked_vehicles_cost_what_a_program_with_cones_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count, radius = int(rng.integers(2, 4)), float(rng.uniform(3.0, 6.0))
    lanes = np.stack([np.zeros(count), 2.0 * np.arange(count), np.zeros(count)], axis=1)
    goals = lanes + np.array([20.0, 0.0, 0.0])
    starts = [rho.State(each, 3.0 * rng.normal(size=3)) for each in lanes]
    ends = [rho.State(each, 3.0 * rng.normal(size=3)) for each in goals]
    vehicles = [
        rho.Vehicle(f"v{i}", start, end)
        for i, (start, end) in enumerate(zip(starts, ends, strict=True))
    ]
    links = [
        rho.KeepIn(rho.Ball([0, 0, 0], radius), vehicles=f"v{i}", relative_to=f"v{i - 1}")
        for i in range(1, count)
    ]
    grid = rho.Grid.lasting(10.0, step=0.5)
    scenario = rho.Scenario("l", grid, vehicles, requirements=links, between_knots=False)
    plan = rho.plan(scenario)
    assert plan.cost == pytest.approx(twin_cost(scenario), rel=TWIN)
    certificate = rho.certify(plan)
    assert certificate.lower_bound == pytest.approx(plan.cost, rel=1e-6)


def _moved(scenario: rho.Scenario, shift: FloatArray, turns: int) -> rho.Scenario:
    """Return a scenario with balls only, turned about z by right angles and shifted in space."""
    turn = np.rint(np.linalg.matrix_power([[0, -1, 0], [1, 0, 0], [0, 0, 1]], turns)).astype(float)

    def state(each: rho.State) -> rho.State:
        return rho.State(turn @ each.position + shift, turn @ each.velocity)

    def asked(each: rho.KeepIn) -> rho.KeepIn:
        off = shift if each.relative_to is None and each.of == "position" else 0.0
        center = turn @ ball(each).center + off
        return dataclasses.replace(each, set=rho.Ball(center, ball(each).radius))

    vehicles = tuple(
        dataclasses.replace(each, start=state(each.start), goal=state(each.goal))
        for each in scenario.vehicles
    )
    requirements = tuple(map(asked, scenario.requirements))
    return dataclasses.replace(scenario, vehicles=vehicles, requirements=requirements)


BALLS = (
    LINK,
    rho.KeepIn(rho.Ball([5, 2, 3], 1.0), vehicles="v0", active=(4.1, 4.6)),
    rho.KeepIn(rho.Ball([1, 0, 0], 0.5), of="velocity", vehicles="v0", active=(5, 6)),
)


@given(seed=st.integers(0, 10**6), turns=st.integers(0, 3))
@examples(few=3, many=6)
def test_plans_move_and_turn_with_their_requirements(seed: int, turns: int) -> None:
    scenario, shift = two(*BALLS), np.random.default_rng(seed).uniform(-50.0, 50.0, 3)
    one, other = rho.plan(scenario), rho.plan(_moved(scenario, shift, turns))
    assert other.cost == pytest.approx(one.cost, rel=1e-5)
    turn = np.linalg.matrix_power(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]), turns)
    difference = one.positions @ turn.T + shift - other.positions
    assert np.abs(difference).max() < 2e-3


def test_plans_do_not_depend_on_the_order_of_vehicles_and_requirements() -> None:
    scenario = two(*BALLS)
    other = dataclasses.replace(
        scenario,
        vehicles=scenario.vehicles[::-1],
        requirements=scenario.requirements[::-1],
    )
    one, swapped = rho.plan(scenario), rho.plan(other)
    assert swapped.cost == pytest.approx(one.cost, rel=1e-6)
    assert np.abs(one.positions - swapped.positions[::-1]).max() < 2e-3


def test_a_link_counts_the_same_in_both_directions() -> None:
    mirrored = dataclasses.replace(LINK, vehicles=("v0",), relative_to="v1")
    assert rho.plan(two(mirrored)).cost == pytest.approx(rho.plan(two(LINK)).cost, rel=1e-6)


def test_limits_and_waypoints_are_cases_of_requirements() -> None:
    grid = rho.Grid.lasting(10.0, step=0.5)
    limits = rho.Limits(max_speed=1.6, max_acceleration=1.2, position=rho.Box([-3] * 3, [11] * 3))
    asked = [
        rho.KeepIn(rho.Ball([0, 0, 0], 1.6), of="velocity"),
        rho.KeepIn(rho.Ball([0, 0, 0], 1.2), of="acceleration"),
        rho.KeepIn(rho.Box([-3] * 3, [11] * 3)),
        rho.KeepIn(rho.Ball([4, 1, -0.5], 0.2), active=(3.3, 3.3)),
    ]
    vehicle = dataclasses.replace(single().vehicles[0], limits=None)
    passing = dataclasses.replace(vehicle, waypoints=(rho.Waypoint(3.3, [4, 1, -0.5], 0.2),))
    one = rho.plan(rho.Scenario("limits", grid, [passing], limits))
    other = rho.plan(rho.Scenario("sets", grid, [vehicle], requirements=asked))
    assert other.cost == pytest.approx(one.cost, rel=1e-5)
    with pytest.raises(rho.InfeasibleError):
        rho.plan(
            dataclasses.replace(
                other.scenario,
                requirements=(*asked, rho.KeepIn(rho.Ball([9, 9, 9], 1), active=(3, 4))),
            )
        )


@pytest.mark.parametrize("seed", [*range(0, 30, 3), *slow(*range(30, 60, 3))])
def test_random_scenes_keep_their_requirements_at_dense_instants(seed: int) -> None:
    scenario = random_scene(seed)
    try:
        plan = rho.plan(scenario)
    except rho.InfeasibleError:
        return
    assert rho.verify(plan).ok
    length = float(scenario.fleet.lengths.max())
    for number in range(len(scenario.requirements)):
        assert outside(plan, number) <= 2.0 * NEAR * length
