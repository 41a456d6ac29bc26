"""The settings of windows mean the same wherever a receding horizon is flown."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

import drake_rho as rho
from tests.scenarios import slow
from tests.test_cli import run

MISSION = """
name: gap
grid: {step: 0.2, knots: 25}
vehicles:
  - {name: scout, radius: 0.2, start: {position: [0, 0, 1]}, goal: {position: [8, 0, 1]}}
limits: {max_acceleration: 4, max_speed: 5}
obstacles:
  - {shape: {center: [5, 0.3, 1], radius: 0.5}, known_from: 0.7}
disturbance: {acceleration: 0.2, position_error: 0.01, feedback_every: 0.1, share: 0.4}
"""

SETTINGS: dict[str, dict[str, Any]] = {
    "replan_every": {"replan_every": 4},
    "free_final_time": {"free_final_time": True},
    "planner": {"planner": rho.plan},
    "fallback": {"fallback": None},
    "reference": {"reference": rho.tail_reference},
    "solver": {"solver": "osqp"},
    "progress": {"progress": lambda words: None},
    "options": {"options": rho.Options(max_iterations=1)},
    "contingencies": {"contingencies": True},
    "latency": {"latency": 0.4},
    "bounded_cost": {"bounded_cost": True},
    "horizon": {"horizon": 2.0},
    "rest_for": {"rest_for": 5.0},
}
"""A value other than the default of every setting."""

EVERYTHING: dict[str, Any] = {
    "replan_every": 4,
    "planner": rho.plan_convex,
    "fallback": None,
    "reference": rho.tail_reference,
    "solver": "osqp",
    "options": rho.Options(max_memory=1e8),
    "contingencies": True,
    "latency": 0.35,
    "bounded_cost": True,
}
"""Settings that can be given together."""

WORDS = {
    "--replan-every": "4",
    "--method": "convex",
    "--reference": "tail",
    "--solver": "osqp",
    "--max-memory": "1e8",
    "--latency": "0.35",
    "--contingencies": None,
    "--bounded-cost": None,
}
"""The same on the command line."""


@pytest.fixture
def mission(tmp_path: Path) -> str:
    """Write a scenario with an obstacle that is seen in flight."""
    path = tmp_path / "mission.yaml"
    path.write_text(MISSION)
    return str(path)


@pytest.fixture
def scenario(mission: str) -> rho.Scenario:
    return rho.load_scenario(mission)


def assert_same_flight(one: rho.Flight | None, other: rho.Flight | None) -> None:
    """Check that two flights have equal windows, to the last digit."""
    assert one is not None
    assert other is not None
    assert one.scenario == other.scenario
    assert len(one.windows) == len(other.windows)
    for own, same in zip(one.windows, other.windows, strict=True):
        np.testing.assert_array_equal(own.plan.accelerations, same.plan.accelerations)
        assert (own.learned, own.cost_bound) == (same.learned, same.cost_bound)
        assert own.plan.statistics.solver == same.plan.statistics.solver
        assert (own.contingency is None) == (same.contingency is None)
        if own.contingency is not None and same.contingency is not None:
            stop = same.contingency.accelerations
            np.testing.assert_array_equal(own.contingency.accelerations, stop)


def flown_by_hand(horizon: rho.RecedingHorizon) -> rho.Flight:
    for knot in horizon.knots:
        horizon.step(horizon.planned(knot), horizon.scenario.grid.times[knot])
    return horizon.flight


def settings_of(function: Callable[..., object]) -> dict[str, inspect.Parameter]:
    shown = inspect.signature(function).parameters
    return {name: each for name, each in shown.items() if name in SETTINGS}


@pytest.mark.parametrize("door", [rho.plan_rho, rho.simulate, rho.RecedingHorizonController])
def test_every_setting_is_shown_with_its_default(door: Callable[..., object]) -> None:
    assert settings_of(door) == settings_of(rho.RecedingHorizon)
    assert list(SETTINGS) == list(settings_of(door))


def test_a_flight_with_every_setting_is_a_horizon_stepped_with_planned_states(
    scenario: rho.Scenario,
) -> None:
    by_hand = flown_by_hand(rho.RecedingHorizon(scenario, **EVERYTHING))
    assert_same_flight(rho.plan_rho(scenario, **EVERYTHING), by_hand)


@pytest.mark.parametrize(
    "name", ["reference", "contingencies", "latency", "bounded_cost", "free_final_time", "horizon"]
)
def test_a_setting_has_an_effect_on_a_flight(name: str, scenario: rho.Scenario) -> None:
    without = rho.plan_rho(scenario, replan_every=4)
    with_it = rho.plan_rho(scenario, replan_every=4, **SETTINGS[name])
    with pytest.raises(AssertionError):
        assert_same_flight(with_it, without)
    if name == "latency":
        known = [[w.first_knot for w in each.windows if w.learned] for each in (without, with_it)]
        assert known == [[4], [8]]


def test_a_simulation_with_every_setting_is_that_of_a_horizon(scenario: rho.Scenario) -> None:
    given, noise = rho.RecedingHorizon(scenario, **EVERYTHING), partial(np.random.default_rng, 5)
    wind = rho.winds.constant(scenario, [0, 1, 0])
    own = rho.simulate(scenario, wind=wind, rng=noise(), **EVERYTHING)
    other = rho.simulate(given, wind=wind, rng=noise())
    assert all(window.contingency or window.no_contingency for window in own.windows)
    np.testing.assert_array_equal(own.positions, other.positions)
    assert_same_flight(own.flight, other.flight)


def test_a_controller_of_a_scenario_has_every_setting(scenario: rho.Scenario) -> None:
    flights = []
    for controller in (
        rho.RecedingHorizonController(scenario, **EVERYTHING),
        rho.RecedingHorizonController(rho.RecedingHorizon(scenario, **EVERYTHING)),
    ):
        builder = DiagramBuilder()
        plant = builder.AddSystem(rho.WindyPointMass(scenario))
        builder.AddSystem(controller)
        builder.Connect(plant.get_output_port(), controller.GetInputPort("states"))
        command = controller.GetOutputPort("command")
        builder.Connect(command, plant.GetInputPort("acceleration"))
        Simulator(builder.Build()).AdvanceTo(2.0)
        flights.append(controller.flight)
    assert len(flights[0].windows) == 3
    assert_same_flight(*flights)


@pytest.mark.slow
@pytest.mark.parametrize("latency", [0.02, 0.4])
def test_a_quadrotors_windows_are_planned_early_enough_for_it_and_for_the_planner(
    latency: float, scenario: rho.Scenario
) -> None:
    settings: dict[str, Any] = {"replan_every": 25, "latency": latency}
    flown = rho.simulate(scenario, plant="quadrotor", **settings)
    ahead = rho.RecedingHorizon(flown.scenario, replan_every=25, latency=max(latency, 0.05))
    (obstacle,) = flown.flight.windows[0].plan.scenario.bodies
    assert [obstacle.known_from] == [each.known_from for each in ahead.scenario.bodies]


@pytest.mark.parametrize("name", [name for name in SETTINGS if name != "progress"])
def test_what_is_flown_as_it_is_takes_no_settings(name: str, scenario: rho.Scenario) -> None:
    plan, horizon = rho.plan(scenario), rho.RecedingHorizon(scenario)
    for kind, fly_by in (
        ("plan", partial(rho.simulate, plan)),
        ("receding horizon", partial(rho.simulate, horizon)),
        ("receding horizon", partial(rho.RecedingHorizonController, horizon)),
    ):
        with pytest.raises(ValueError, match=f"^{name}: got .*, expected none for a {kind}, which"):
            fly_by(**SETTINGS[name])


def test_an_unknown_setting_is_refused_by_the_function_it_was_given_to(
    scenario: rho.Scenario,
) -> None:
    horizon = rho.RecedingHorizon(scenario)
    for function, given in (
        (rho.plan_rho, scenario),
        (rho.simulate, scenario),
        (rho.simulate, horizon),
        (rho.RecedingHorizonController, horizon),
    ):
        unknown: Any = function
        with pytest.raises(
            TypeError, match=rf"^{function.__name__}.*\(\) got an unexpected keyword argument 'ever"
        ):
            unknown(given, every=3)


@pytest.mark.parametrize("command", ["fly", *slow("simulate")])
def test_a_command_with_every_option_is_the_call_from_python(
    command: str,
    scenario: rho.Scenario,
    mission: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    words = [word for pair in WORDS.items() for word in pair if word is not None]
    saved = tmp_path / "flown.npz"
    if command == "simulate":
        words += ["--wind", "constant", "--time-limit", "1000"]
    status, _, err = run(capsys, monkeypatch, command, mission, *words, "-o", str(saved))
    assert status == 0, err
    if command == "fly":
        assert_same_flight(rho.load(saved).flight, rho.plan_rho(scenario, **EVERYTHING))
        return
    errors = np.random.default_rng(1).spawn(2)[1]  # of estimates, from the default seed
    wind = rho.winds.constant(scenario, [1, 0, 0])
    same = rho.simulate(scenario, wind=wind, rng=errors, **EVERYTHING)
    found = rho.load(saved)
    assert isinstance(found, rho.Simulation)
    np.testing.assert_array_equal(found.positions, same.positions)
    assert_same_flight(found.flight, same.flight)


@pytest.mark.parametrize("option", [*WORDS, "--free-final-time", "--time-limit"])
def test_a_plan_of_a_file_takes_no_options_of_windows(
    option: str,
    scenario: rho.Scenario,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    saved = str(tmp_path / "plan.npz")
    rho.save(rho.plan(scenario), saved)
    value = {"--time-limit": "3"}.get(option, WORDS.get(option))
    given = [option] if value is None else [option, value]
    status, out, err = run(capsys, monkeypatch, "simulate", saved, *given)
    assert (status, out) == (2, "")
    assert f"{option}: got " in err
    assert "expected a scenario with it: the plan in" in err
