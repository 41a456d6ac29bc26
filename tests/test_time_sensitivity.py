"""Limits that make a flight as long as it is: closed forms, finite differences, refusals."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import drake_rho as rho
from tests.scenarios import box, single
from tests.test_cli import run
from tests.test_cli_json import read

FAST = rho.Limits(max_acceleration=4.0, max_speed=3.0)


def straight(limits: rho.Limits, knots: int = 41, **fields: object) -> rho.Scenario:
    """Return a vehicle that flies 9 m along an axis from rest to rest."""
    ends = {"start": rho.State([0, 0, 0]), "goal": rho.State([9, 0, 0])}
    return single(limits=limits, grid=rho.Grid(0.4, knots), **ends, **fields)  # type: ignore[arg-type]


def effects(plan: rho.Plan, planned: rho.Scenario | None = None) -> dict[str, float]:
    """Return the saved part of the time for each limit of a plan."""
    return {each.limit: each.less_time for each in rho.diagnose(plan, planned=planned).limits}


def saved(plan: rho.Plan, other: rho.Scenario) -> float:
    """Return by which part a plan of another scenario takes less time."""
    return 1.0 - rho.plan_minimum_time(other).scenario.grid.duration / plan.scenario.grid.duration


@pytest.mark.parametrize("form", ["max_acceleration", "acceleration"])
def test_with_one_limit_of_accelerations_time_falls_with_its_root(form: str) -> None:
    limits = rho.Limits(**{form: 2.5 if form.startswith("max") else box(2.5)})  # type: ignore[arg-type]
    plan = rho.plan_minimum_time(straight(limits))
    assert effects(plan) == {form: pytest.approx(0.005, rel=1e-3)}


@pytest.mark.parametrize("form", ["norms", "boxes"])
def test_speed_and_acceleration_have_the_shares_of_the_closed_form(form: str) -> None:
    """T = d/v + v/a: v has d/v - v/a of it, a has v/a."""
    d, v, a = 9.0, 2.0, 2.5
    limits, names = {
        "norms": (rho.Limits(max_speed=v, max_acceleration=a), ["max_speed", "max_acceleration"]),
        "boxes": (rho.Limits(velocity=box(v), acceleration=box(a)), ["velocity", "acceleration"]),
    }[form]
    found = rho.diagnose(rho.plan_minimum_time(straight(limits, 201)))
    least = d / v + v / a
    assert [each.limit for each in found.limits] == names
    shares = [100.0 * each.less_time for each in found.limits]
    np.testing.assert_allclose(shares, [(d / v - v / a) / least, v / a / least], atol=0.01)
    assert {each.vehicles for each in found.limits} == {("solo",)}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_shares_add_up_as_the_dimensions_of_time_say(seed: int) -> None:
    """Speeds, accelerations and jerks λ, λ² and λ³ times as large divide the time by λ."""
    rng = np.random.default_rng(seed)
    limits = rho.Limits(
        max_speed=rng.uniform(1.5, 4.0),
        max_acceleration=rng.uniform(2.0, 5.0),
        jerk=box(rng.uniform(8.0, 30.0)),
    )
    balls = [rho.Sphere(rng.uniform([3, -1, -1], [6, 1, 1]), 1.0)] if seed else []
    gate = [rho.Waypoint(None, rng.uniform([1, 1, 0], [2, 3, 0]), 0.1)] if seed < 2 else []
    plan = rho.plan_minimum_time(straight(limits, 41, obstacles=balls, waypoints=gate))
    found = effects(plan)
    powers = {"max_speed": 1.0, "max_acceleration": 2.0, "jerk": 3.0}
    total = sum(100.0 * power * found.get(name, 0.0) for name, power in powers.items())
    assert total == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
def test_they_are_what_plans_with_other_limits_save() -> None:
    gate, ball = rho.Waypoint(None, [3.0, 2.0, 0.0], 0.2), rho.Sphere([6.0, 0.2, 0.0], 1.0)
    scenario = straight(FAST, 25, waypoints=[gate], obstacles=[ball])
    plan = rho.plan_minimum_time(scenario)
    found = effects(plan)
    changed = dataclasses.replace
    vehicle = changed(scenario.vehicles[0], waypoints=(changed(gate, within=0.21),))
    others = {
        "max_speed": changed(scenario, limits=changed(FAST, max_speed=3.03)),
        "max_acceleration": changed(scenario, limits=changed(FAST, max_acceleration=4.04)),
        "waypoint 1": changed(scenario, vehicles=(vehicle,)),
        "obstacle 1": changed(scenario, obstacles=(changed(ball, radius=0.99),)),
    }
    assert set(found) == set(others)
    for name, other in others.items():
        assert found[name] == pytest.approx(saved(plan, other), rel=0.1, abs=3e-5), name


@pytest.mark.slow
def test_so_they_are_for_thrusts_wind_requirements_and_moving_obstacles() -> None:
    changed, ball = dataclasses.replace, rho.Sphere([4.0, 0.3, 0.0], 1.5)
    limits = rho.Limits(max_tilt=0.5, max_thrust=13.0, max_jerk=40.0)
    hover = straight(limits, 31)
    calm, slow = straight(FAST, 31), rho.KeepIn(rho.Sphere([0, 0, 0], 2.0), of="velocity")
    calm = changed(calm, requirements=(slow,))
    windy = straight(FAST, 25, obstacles=[ball], between_knots=True)
    windy = changed(windy, disturbance=rho.Disturbance(0.1))
    moves = rho.Obstacle(rho.Sphere([4, -3, 0], 1.2), velocity=[0, 1.5, 0])
    among = straight(FAST, 25, obstacles=[moves])
    wider = rho.KeepIn(rho.Sphere([0, 0, 0], 2.01), of="velocity")
    cases = [
        (hover, "max_tilt", changed(hover, limits=changed(limits, max_tilt=0.505))),
        (hover, "max_thrust", changed(hover, limits=changed(limits, max_thrust=13.13))),
        (hover, "max_jerk", changed(hover, limits=changed(limits, max_jerk=40.4))),
        (calm, "requirement 1", changed(calm, requirements=(wider,))),
        (windy, "wind", changed(windy, disturbance=rho.Disturbance(0.099))),
        (among, "max_speed", changed(among, limits=changed(FAST, max_speed=3.03))),
    ]
    plans = {id(each): rho.plan_minimum_time(each) for each in (hover, calm, windy, among)}
    for scenario, name, other in cases:
        plan = plans[id(scenario)]
        expected = saved(plan, other)
        assert effects(plan)[name] == pytest.approx(expected, rel=0.1, abs=3e-5), name


def fleet(*ends: tuple[Sequence[float], Sequence[float]], **fields: object) -> rho.Scenario:
    """Return vehicles between starts and goals."""
    vehicles = [rho.Vehicle(f"v{i}", rho.State(a), rho.State(b)) for i, (a, b) in enumerate(ends)]
    return rho.Scenario("fleet", rho.Grid(0.2, 21), vehicles, FAST, **fields)  # type: ignore[arg-type]


def test_the_slowest_vehicles_are_named_also_if_several_are_as_slow() -> None:
    scenario = fleet(([0, 0, 0], [9, 0, 0]), ([0, 3, 0], [9, 3, 0]), ([0, 6, 0], [7, 6, 0]))
    for each in rho.diagnose(rho.plan_minimum_time(scenario)).limits:
        assert each.vehicles == ("v0", "v1")


@pytest.mark.slow
def test_a_separation_has_an_effect_where_vehicles_meet() -> None:
    ends = ([-4, 0, 0], [4, 0.1, 0]), ([4, 0, 0], [-4, -0.1, 0])
    near, far = fleet(*ends, separation=rho.Separation(1.5)), fleet(*ends)
    plan = rho.plan_minimum_time(near)
    found = effects(plan)
    closer = dataclasses.replace(near, separation=rho.Separation(1.485))
    assert found["separation"] == pytest.approx(saved(plan, closer), rel=0.15, abs=3e-5)
    assert "separation" not in effects(rho.plan_minimum_time(far))


def test_given_times_count_where_the_scenario_says_so() -> None:
    late = straight(FAST, 21, waypoints=[rho.Waypoint(5.0, [4.0, 0.0, 0.0])])
    plan = rho.plan_minimum_time(late)
    kept = effects(plan, late)
    total = kept["time of waypoint 1"] + kept["max_speed"] + 2.0 * kept["max_acceleration"]
    assert 100.0 * total == pytest.approx(1.0, abs=0.01)  # as all are times
    with pytest.raises(ValueError, match=r"plan: got one of .* expected a plan of"):
        rho.diagnose(plan)


def test_what_cannot_be_diagnosed_is_refused() -> None:
    scenario = straight(FAST, 21)
    slow = rho.plan(dataclasses.replace(scenario, grid=rho.Grid(0.3, 21)))
    with pytest.raises(ValueError, match=r"plan: got one of 6 s, near which"):
        rho.diagnose(slow)
    plan = rho.plan_minimum_time(scenario)
    other = straight(FAST, 21, waypoints=[rho.Waypoint(None, [1.0, 1.0, 0.0])])
    with pytest.raises(ValueError, match=r"planned: .* expected the scenario of the plan"):
        rho.diagnose(plan, planned=other)
    with pytest.raises(ValueError, match=r"planned: .* expected it beside a plan"):
        rho.diagnose(scenario, planned=scenario)  # type: ignore[call-overload]
    free = rho.plan(dataclasses.replace(scenario, limits=rho.Limits()))
    with pytest.raises(rho.ScenarioError, match="there is no least time"):
        rho.diagnose(free)


def test_the_command_prints_the_table_and_the_document(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    scenario = straight(FAST, 21)
    plan = rho.plan_minimum_time(scenario)
    rho.save(plan, "plan.npz")
    rho.save_scenario(scenario, "asked.yaml")
    expected = rho.diagnose(plan)
    assert run(capsys, monkeypatch, "diagnose", "plan.npz") == (0, f"{expected}\n", "")
    planned = "plan.npz", "--planned", "asked.yaml"
    status, out, _ = run(capsys, monkeypatch, "diagnose", *planned, "--json")
    found = read(out, "diagnose plan.npz")
    assert status == 0
    assert [each["limit"] for each in found["limits"]] == [each.limit for each in expected.limits]
    assert found["limits"][0]["vehicles"] == ["solo"]
    assert "max_speed" in expected._repr_html_()
    status, _, err = run(capsys, monkeypatch, "diagnose", "asked.yaml", "--planned", "asked.yaml")
    assert (status, err.count("\n")) == (2, 1)
    assert "--planned" in err
    rho.save(rho.plan_rho(scenario), "flight.npz")
    status, _, err = run(capsys, monkeypatch, "diagnose", "flight.npz")
    assert (status, err) == (2, "drake-rho: flight.npz: got a flight, expected a plan\n")
