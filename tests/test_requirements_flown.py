"""Requirements in windows, in wind, in fleets, in studies and in what explains a missing plan."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.planning.problem import Problem
from tests.requirements import outside
from tests.scenarios import fleet, slow
from tests.studies import small
from tests.test_requirements import BALLS, CASES, LINK, NEAR, two

WIND = rho.Disturbance(acceleration=0.15, position_error=0.005, velocity_error=0.01)


@pytest.mark.parametrize(
    "case", ["link", "instant", "corridor", "gate", "push", "jerk", "following"]
)
def test_windows_keep_requirements_that_begin_and_end_anywhere(case: str) -> None:
    flight = rho.plan_rho(two(*CASES[case]))
    assert rho.verify(flight).ok
    assert not any(window.infeasible for window in flight.windows)
    for number in range(len(CASES[case])):
        assert outside(flight.plan, number) <= 12.0 * NEAR


def test_a_window_after_the_interval_is_planned_without_the_requirement() -> None:
    scenario = two(rho.KeepIn(rho.Ball([3, 2, 3], 0.5), vehicles="v0", active=(3.0, 3.0)))
    flight = rho.plan_rho(scenario)
    kinds = [
        {each.kind for each in Problem.of(window.plan.scenario).convex} for window in flight.windows
    ]
    assert "requirements" in kinds[0]
    assert "requirements" not in kinds[-1]


def test_a_flight_under_way_may_begin_outside_of_a_required_set() -> None:
    """A gust has moved a vehicle: the window says what is violated, and the next ones return."""
    scenario = two(
        rho.KeepIn(rho.Ball([0, 0, 0], 4.0), vehicles="v1", relative_to="v0", active=(0, 6))
    )
    horizon = rho.RecedingHorizon(scenario)
    window = horizon.step(scenario.fleet.start_states, 0.0)
    assert not window.infeasible
    time = 1.0
    at = window.plan.at(np.array([time]))
    states = np.concatenate([at.positions[:, 0], at.velocities[:, 0]], axis=1)
    assert not horizon.step(states, time).infeasible
    states = np.array(states)
    states[1, 1] += 2.0
    gust = rho.RecedingHorizon(scenario)
    gust.step(scenario.fleet.start_states, 0.0)
    after = gust.step(states, time)
    assert "requirement 1" in after.infeasible
    assert outside(after.plan, 0) < 2.5


def test_far_from_zero_on_the_clock_plans_are_the_same() -> None:
    now = 1.7e9
    later = tuple(
        dataclasses.replace(
            each, active=each.active and (each.active[0] + now, each.active[1] + now)
        )
        for each in BALLS
    )
    one, other = rho.plan(two(*BALLS)), rho.plan(two(*later, grid=rho.Grid(0.5, 21, now)))
    assert other.cost == pytest.approx(one.cost, rel=1e-5)
    assert rho.verify(other).ok


@pytest.mark.parametrize("case", ["link", "floor", "instant", "gate", *slow("formation")])
def test_wind_tightens_requirements_by_the_tubes_of_all_vehicles_concerned(case: str) -> None:
    calm = two(*CASES[case])
    windy = dataclasses.replace(calm, disturbance=WIND)
    plan = rho.plan(windy)
    report = rho.verify(plan)
    assert report.ok
    tube = rho.error_tube(windy)
    checks = [each for each in report.checks if each.kind == "requirements" and each.asked]
    for check in checks:
        asked = windy.requirements[int(check.constraint.split()[1]) - 1]
        vehicles = 1.0 if asked.relative_to is None else 2.0
        base: Any = asked.quantity
        radius = vehicles * float(getattr(tube, base)(np.array([check.time]))[0])
        if base != "velocity":  # at an end of a sample, the radius of the sample before counts
            assert check.errors == pytest.approx(radius, rel=1e-6, abs=1e-12)
        assert check.errors > 0.0
    assert plan.cost >= rho.plan(calm).cost


@pytest.mark.parametrize("seed", range(4))
def test_in_any_wind_that_is_declared_requirements_hold(seed: int) -> None:
    requirements = (*CASES["link"], *CASES["floor"])
    scenario = dataclasses.replace(two(*requirements), disturbance=WIND)
    wind = rho.winds.coloured_noise(scenario, np.random.default_rng(seed))
    simulation = rho.simulate(rho.plan(scenario), wind=wind)
    assert rho.verify(simulation).ok


def test_the_worst_wind_aims_at_the_link_with_least_left() -> None:
    tight = dataclasses.replace(
        two(*CASES["formation"]),
        disturbance=dataclasses.replace(
            WIND, acceleration=0.02, position_error=0.0, velocity_error=0.0
        ),
    )
    plan = rho.plan(tight)
    found = rho.attack(tight, plan)
    assert found.constraint.startswith("requirement 1")
    assert set(found.vehicles) == {"v0", "v1"}
    assert found.bound == pytest.approx(found.clearance, abs=1e-3)
    assert found.bound >= -1e-6


@pytest.mark.parametrize("coupling", ["coupled", "decoupled", "grouped"])
def test_linked_fleets_keep_apart_in_every_coupling(coupling: Any) -> None:
    """Two chains of three cross each other."""
    starts = [[0, y, 0] for y in (0, 2, 4)] + [[12, y, 0] for y in (0, 2, 4)]
    goals = [[12, y, 0] for y in (0, 2, 4)] + [[0, y, 0] for y in (0, 2, 4)]
    scenario = fleet(starts, goals, separation=rho.Separation(1.0))
    links = [
        rho.KeepIn(rho.Ball([0, 0, 0], 2.4), vehicles=f"v{i}", relative_to=f"v{i - 1}")
        for i in (1, 2, 4, 5)
    ]
    scenario = dataclasses.replace(scenario, requirements=tuple(links))
    plan = rho.plan(scenario, coupling=coupling)
    assert rho.verify(plan).ok
    assert max(outside(plan, number) for number in range(4)) <= 12.0 * NEAR


@pytest.mark.slow
def test_links_hold_among_obstacles_that_the_first_linearisation_meets() -> None:
    """A wall with a door forces a chain through one opening."""
    lanes = [[0, 2.0 * i, 2] for i in range(3)]
    wall = [rho.Box([5, -9, 0], [6, 0.5, 6]), rho.Box([5, 2.5, 0], [6, 13, 6])]
    scenario = fleet(
        lanes, [[12, y, z] for _, y, z in lanes], separation=rho.Separation(0.5), obstacles=wall
    )
    box = rho.KeepIn(rho.Box([-5, -8, 0.5], [20, 12, 5.5]), name="room")
    links = [
        rho.KeepIn(rho.Ball([0, 0, 0], 3.5), vehicles=f"v{i}", relative_to=f"v{i - 1}")
        for i in (1, 2)
    ]
    scenario = dataclasses.replace(scenario, requirements=(box, *links))
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    assert max(outside(plan, number) for number in range(3)) <= 12.0 * NEAR


FAR_AWAY = two(
    LINK,
    rho.KeepIn(rho.Ball([6, 20, 0], 1.0), vehicles="v1", active=(5.0, 5.0), name="detour"),
    limits=rho.Limits(max_speed=3.0),
)
"""A detour is required for which there is no time."""


def test_a_missing_plan_names_the_requirement() -> None:
    with pytest.raises(rho.InfeasibleError) as found:
        rho.plan(FAR_AWAY)
    assert "requirement 2 (detour) at 5 s" in str(found.value)
    assert found.value.is_proved
    subset = rho.infeasible_subset(found.value)
    assert any("detour" in each for names in subset.values() for each in names)


@pytest.mark.slow
def test_a_diagnosis_names_the_requirement() -> None:
    assert "detour" in str(rho.diagnose(FAR_AWAY))


def test_two_requirements_that_exclude_each_other_are_named() -> None:
    pair = (
        rho.KeepIn(rho.Ball([6, 3, 0], 1.0), vehicles="v0", active=(5.0, 5.0), name="one"),
        rho.KeepIn(rho.Ball([6, 6, 0], 1.0), vehicles="v0", active=(5.0, 5.0), name="other"),
    )
    with pytest.raises(rho.InfeasibleError) as found:
        rho.plan(two(*pair))
    assert "(one)" in str(found.value)
    assert "(other)" in str(found.value)


def test_the_shortest_plan_keeps_requirements() -> None:
    scenario = two(
        dataclasses.replace(LINK, active=None, set=rho.Ball([0, 0, 0], 9.5)),
        limits=rho.Limits(max_acceleration=2.0),
    )
    plan = rho.shortest_plan(scenario)
    assert plan.scenario.grid.duration < scenario.grid.duration
    assert rho.verify(plan).ok


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"vehicles": "v7"}, "requirements[0].vehicles"),
        ({"vehicles": ["v0", "v0"]}, "vehicles"),
        ({"vehicles": []}, "vehicles"),
        ({"relative_to": "nobody"}, "requirements[0].relative_to"),
        ({"vehicles": "v0", "relative_to": "v0"}, "vehicles"),
        ({"relative_to": 3}, "relative_to"),
        ({"of": "speed"}, "of"),
        ({"of": "jerk", "relative_to": rho.Track([0], [[0, 0, 0]])}, "of"),
        ({"active": (3.0, 2.0)}, "active"),
        ({"active": (0.0, 11.0)}, "requirements[0].active"),
        ({"active": (-1.0, 2.0)}, "requirements[0].active"),
        ({"active": (0.0, np.nan)}, "active[1]"),
        ({"set": rho.Ball([9, 9, 9], 1.0)}, "vehicles[0].start.position"),
        ({"set": rho.Ball([9, 9, 9], 1.0), "active": (9, 10)}, "vehicles[0].goal.position"),
        ({"set": rho.Ball([9, 9, 9], 1.0), "of": "velocity"}, "vehicles[0].start.velocity"),
        ({"set": rho.Ball([0, 9, 0], 1.0), "relative_to": "v0"}, "vehicles[1].start.position"),
        ({"set": None}, "set"),
        ({"name": ""}, "name"),
    ],
)  # fmt: skip
def test_bad_requirements_are_one_error_that_names_the_field(
    fields: dict[str, Any], field: str
) -> None:
    with pytest.raises(rho.ScenarioError) as found:
        two(rho.KeepIn(**({"set": rho.Ball([0, 0, 0], 90.0)} | fields)))
    assert found.value.field.endswith(field)
    assert len(str(found.value).splitlines()) == 1


def test_a_waypoint_outside_of_a_required_set_is_refused() -> None:
    scenario = two()
    vehicle = dataclasses.replace(scenario.vehicles[0], waypoints=(rho.Waypoint(5.0, [6, 4, 0]),))
    fence = rho.KeepIn(rho.Box([-1, -1, -1], [13, 3, 3]), vehicles="v0")
    with pytest.raises(rho.ScenarioError, match=r"vehicles\[0\].waypoints\[0\].position"):
        dataclasses.replace(
            scenario, vehicles=(vehicle, scenario.vehicles[1]), requirements=(fence,)
        )


def test_studies_vary_requirements(tmp_path: Path) -> None:
    """The radius of a link and the time of a gate are drawn; what is drawn is planned."""
    gate = {"set": {"center": [4, 2, 0], "radius": 3.0}, "vehicles": ["solo"], "active": [2.5, 3.0]}
    vehicle = {"name": "solo", "start": {"position": [0, 0, 0]}, "goal": {"position": [8, 0, 0]}}
    past = {
        "name": "past",
        "grid": {"step": 0.5, "knots": 13},
        "vehicles": [vehicle],
        "requirements": [gate],
    }
    varied = {"requirements[0].set.radius": {"uniform": [1.0, 1.9]}}
    study = small(3, scenarios=[{"name": "past", "scenario": past, "vary": varied}])
    results = rho.campaign(study, tmp_path / "runs.sqlite")
    rows = list(results.rows())
    assert all(row.status == "solved" and row.verified for row in rows)
    assert len({row.cost for row in rows}) > 1  # of two methods, each in three draws
