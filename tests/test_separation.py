"""Separation is a record, and starts and goals that are too close are named."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import drake_rho as rho
from tests.tolerances import ROUNDING, TOLERANCE
from tests.written import as_yaml, from_yaml, in_plan_file

GRID = rho.Grid(1.0, 5)


def swarm(starts: np.ndarray, goals: np.ndarray, separation: rho.Separation | None) -> rho.Scenario:
    """Return vehicles `a0`, `a1`, ... between starts and goals, shape (N, 3) each."""
    vehicles = [
        rho.Vehicle(f"a{index}", rho.State(start), rho.State(goal))
        for index, (start, goal) in enumerate(zip(starts, goals, strict=True))
    ]
    return rho.Scenario("swarm", GRID, vehicles, separation=separation)


def apart(count: int) -> np.ndarray:
    """Return positions ten metres apart on a line, shape (count, 3)."""
    return np.outer(np.arange(count), [10.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("values", "field", "words"),
    [
        ((0.0,), "separation.distance", "greater than 0"),
        ((-1.0,), "separation.distance", "-1"),
        ((float("nan"),), "separation.distance", "nan"),
        ((1e13,), "separation.distance", "1e+12"),
        ((1.0, 0.0), "separation.downwash", "greater than"),
        ((1.0, 1e-4), "separation.downwash", "0.001"),
        ((1.0, 1e4), "separation.downwash", "1000"),
        ((1.0, float("inf")), "separation.downwash", "inf"),
    ],
)
def test_an_invalid_separation_is_refused(
    values: tuple[float, ...], field: str, words: str
) -> None:
    with pytest.raises(rho.ScenarioError) as caught:
        rho.Separation(*values)
    assert caught.value.field == field
    assert words in str(caught.value)


def test_scaled_positions_have_the_distances_of_the_ellipsoid() -> None:
    separation = rho.Separation(0.35, downwash=2.0)
    positions = np.random.default_rng(0).normal(size=(4, 7, 3))
    scaled = separation.scaled(positions)
    assert scaled.shape == positions.shape
    dx, dy, dz = np.moveaxis(positions[0] - positions[1], -1, 0)
    np.testing.assert_allclose(
        np.linalg.norm(scaled[0] - scaled[1], axis=-1),
        np.sqrt(dx**2 + dy**2 + (dz / 2.0) ** 2),
        rtol=ROUNDING,
    )
    assert separation.tolerance == pytest.approx(TOLERANCE * 0.35)
    assert rho.Separation(3.0).scaled(positions) == pytest.approx(positions)


@pytest.mark.parametrize("end", ["start", "goal"])
def test_two_vehicles_that_are_too_close_are_named_with_their_distance(end: str) -> None:
    close = apart(5)
    close[3] = close[1] + [0.0, 0.0, 1.0]
    ends = {"start": apart(5), "goal": apart(5), end: close}
    separation = rho.Separation(0.6, downwash=2.0)
    with pytest.raises(rho.ScenarioError) as caught:
        swarm(ends["start"], ends["goal"], separation)
    assert caught.value.field == f"scenario.vehicles[3].{end}.position"
    assert caught.value.value == close[3].tolist()
    words = caught.value.expected
    assert words == "a3 at least 0.6 m, with dz / 2, from a1, not 0.5 m"
    assert swarm(ends["start"], ends["goal"], rho.Separation(0.5, downwash=2.0))
    assert swarm(ends["start"], ends["goal"], None)


def test_the_papers_scenario_refuses_a_separation(paper: rho.Scenario) -> None:
    with pytest.raises(rho.ScenarioError, match="UAV-2 at least 1 m from UAV-1, not 0 m"):
        dataclasses.replace(paper, separation=rho.Separation(1.0))


def test_touching_counts_as_separated_within_the_tolerance() -> None:
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    for factor, good in ((1.0, True), (1.0 + 0.9e-6, True), (1.0 + 1.1e-6, False)):
        separation = rho.Separation(factor)
        if good:
            swarm(points, apart(2), separation)
        else:
            with pytest.raises(rho.ScenarioError, match=r"vehicles\[1\]\.start\.position"):
                swarm(points, apart(2), separation)


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 12), same=st.booleans())
def test_refused_pairs_equal_a_visit_to_every_pair(seed: int, count: int, same: bool) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.0, 1.0, (count, 3))
    if same:  # where points coincide, neighbours have no order
        points = points[rng.integers(0, count, count)]
    separation = rho.Separation(rng.uniform(0.1, 0.8), downwash=rng.uniform(0.5, 3.0))
    scaled = separation.scaled(points)
    pairs = {
        (one, other): float(np.linalg.norm(scaled[one] - scaled[other]))
        for one, other in itertools.combinations(range(count), 2)
    }
    closest = min(pairs.values(), default=np.inf)
    if closest >= separation.distance:
        assert swarm(points, apart(count), separation).separation == separation
        return
    with pytest.raises(rho.ScenarioError) as caught:
        swarm(points, apart(count), separation)
    named = [
        pair
        for pair in pairs
        if caught.value.field == f"scenario.vehicles[{pair[1]}].start.position"
        and caught.value.expected.startswith(f"a{pair[1]} at least")
        and f"from a{pair[0]}, not" in caught.value.expected
    ]
    assert [pairs[pair] for pair in named] == pytest.approx([closest], abs=ROUNDING)


def test_files_preserve_the_separation() -> None:
    scenario = swarm(apart(3), apart(3)[::-1], rho.Separation(0.1 + 0.2, downwash=2.0))
    assert from_yaml(as_yaml(scenario)) == scenario
    assert in_plan_file(scenario)[1] == scenario
    text = as_yaml(scenario).replace(", downwash: 2.0", "")
    read = from_yaml(text)
    assert read.separation == rho.Separation(0.1 + 0.2)
    assert read != scenario
    with pytest.raises(rho.ScenarioError, match=r"separation\.gap: .* no field of this name"):
        from_yaml(as_yaml(scenario).replace("downwash:", "gap:"))


def test_states_reached_by_a_plan_are_not_checked_again() -> None:
    scenario = swarm(apart(2), apart(2)[::-1], rho.Separation(5.0))
    middle = np.full((2, GRID.knots, 3), 5.0)
    still = np.zeros_like(middle)
    begun = rho.Plan(scenario, middle, still, still[:, 1:]).tail(2).scenario
    assert begun.separation == scenario.separation
    with pytest.raises(rho.ScenarioError, match="a1 at least 5 m from a0"):
        begun.check_ends()


def test_the_schema_has_units_of_the_separation() -> None:
    fields = rho.scenario_schema()["$defs"]["Separation"]["properties"]
    assert "[m]" in fields["distance"]["description"]
    assert fields["downwash"]["default"] == 1.0


@pytest.mark.parametrize(
    ("duration", "step", "knots"), [(10.0, 0.2, 51), (9.8, 0.2, 50), (1.0, 1.0, 2), (0.3, 0.1, 4)]
)
def test_a_grid_for_a_duration_has_that_duration(duration: float, step: float, knots: int) -> None:
    grid = rho.Grid.lasting(duration, step=step)
    assert grid.knots == knots
    assert grid.step == pytest.approx(step, rel=ROUNDING)
    assert grid.duration == pytest.approx(duration, rel=1e-15)


@pytest.mark.parametrize(
    ("duration", "step", "field"),
    [
        (1.0, 0.3, "step"),
        (1.0, 2.0, "step"),
        (1.0, 0.0, "step"),
        (1.0, float("nan"), "step"),
        (-1.0, 0.1, "duration"),
        (float("inf"), 0.1, "duration"),
        (1e6, 1e-3, "grid.knots"),
    ],
)
def test_an_impossible_grid_is_refused(duration: float, step: float, field: str) -> None:
    with pytest.raises(rho.ScenarioError) as caught:
        rho.Grid.lasting(duration, step=step)
    assert caught.value.field == field
