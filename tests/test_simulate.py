"""Simulation in Drake: flights equal those without Drake; quadrotors; custom diagrams."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import pytest
from pydrake.examples import QuadrotorPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

import drake_rho as rho
from drake_rho.planning.horizon.settings import Windows
from drake_rho.simulation.attitude import AttitudeController
from drake_rho.simulation.closed_loop import fly, fly_plan
from drake_rho.simulation.quadrotors import quadrotors
from drake_rho.simulation.systems import WindSource
from drake_rho.simulation.timeline import Timeline
from tests.disturbed import KINDS, disturbed, winds_for
from tests.scenarios import single, slow
from tests.studies import small, table
from tests.test_free_final_time import WIND, arrivals, crossing
from tests.test_latency import scene, windy
from tests.test_windows import EVERYTHING, MISSION, assert_same_flight, settings_of
from tests.tolerances import ROUNDING
from tests.written import from_yaml

ARRAYS = ("times", "positions", "velocities", "wind", "commands")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_the_simulator_and_the_loop_give_the_same_flight(kind: str, seed: int) -> None:
    scenario = disturbed(20 + seed)
    wind = winds_for(scenario, seed)[kind]
    one, other = (
        fly_it(scenario, wind=wind, rng=np.random.default_rng(seed), replan_every=4)
        for fly_it in (rho.simulate, fly)
    )
    for name in ARRAYS:
        found, expected = getattr(one, name), getattr(other, name)
        np.testing.assert_allclose(found, expected, atol=ROUNDING * max(1.0, expected.max()))
    assert len(one.flight.windows) == len(other.flight.windows)
    for window, twin in zip(one.flight.windows, other.flight.windows, strict=True):
        assert window.infeasible == twin.infeasible
        np.testing.assert_allclose(window.plan.accelerations, twin.plan.accelerations, atol=1e-6)


def test_the_simulator_and_the_loop_arrive_alike() -> None:
    scenario = dataclasses.replace(crossing(knots=21, step=0.4), disturbance=WIND)
    wind = rho.winds.constant(scenario, [0, 1, 0])
    one, other = (
        each(scenario, replan_every=5, free_final_time=True, fallback=None, wind=wind)
        for each in (fly, rho.simulate)
    )
    assert arrivals(one) == arrivals(other)
    assert np.abs(one.positions - other.positions).max() < 1e-5  # solvers amplify rounding


def test_the_simulator_and_the_loop_plan_ahead_alike() -> None:
    scenario = scene(windy(1, 1))
    wind = rho.winds.constant(scenario, [0, 1, 0])
    one, other = (
        fly_it(scenario, replan_every=4, latency=0.5, wind=wind, rng=np.random.default_rng(3))
        for fly_it in (rho.simulate, fly)
    )
    np.testing.assert_allclose(other.positions, one.positions, atol=1e-9)


@pytest.mark.parametrize("fly_it", [rho.simulate, fly])
def test_a_simulation_is_reproduced_bit_by_bit_from_its_seed(
    fly_it: Callable[..., rho.Simulation],
) -> None:
    scenario = disturbed(7)
    one, again, other = (
        fly_it(
            scenario,
            wind=rho.winds.coloured_noise(scenario, np.random.default_rng(seed)),
            rng=np.random.default_rng([seed, 1]),
        )
        for seed in (3, 3, 4)
    )
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(one, name), getattr(again, name))
    assert not np.array_equal(one.positions, other.positions)


def test_without_wind_windows_are_those_of_plan_rho() -> None:
    scenario = disturbed(3)
    still, flight = rho.simulate(scenario), rho.plan_rho(scenario)
    for window, twin in zip(still.flight.windows, flight.windows, strict=True):
        np.testing.assert_allclose(window.plan.accelerations, twin.plan.accelerations, atol=1e-9)


def test_a_plan_and_a_flight_are_tracked_as_they_are() -> None:
    scenario = disturbed(3)
    plan = rho.plan(scenario)
    wind = rho.winds.constant(scenario, [0.0, 1.0, 0.0])
    tracked, twin = rho.simulate(plan, wind=wind), fly_plan(scenario, plan, wind=wind)
    assert len(tracked.windows) == 1
    np.testing.assert_array_equal(tracked.plan.accelerations, plan.accelerations)
    for name in ARRAYS:
        np.testing.assert_allclose(getattr(tracked, name), getattr(twin, name), atol=1e-9)
    assert rho.verify(tracked).ok
    flight = rho.plan_rho(scenario, replan_every=6)
    again = rho.simulate(flight, wind=wind)
    np.testing.assert_array_equal(again.plan.accelerations, flight.plan.accelerations)


def test_a_plan_without_a_disturbance_flies_without_feedback_or_with_one_that_is_given() -> None:
    plan = rho.plan(single())
    gust = rho.Disturbance(0.2, feedback_every=0.1)

    def wind(time: float, positions: np.ndarray, velocities: np.ndarray) -> np.ndarray:
        return np.full_like(positions, 0.2 / np.sqrt(3.0))

    free = rho.simulate(plan, wind=wind)
    elapsed = plan.scenario.grid.duration
    assert free.errors()[-1, 0] == pytest.approx(0.2 * elapsed**2 / 2.0, rel=1e-9)
    assert "flown without feedback: the scenario has no disturbance" in rho.verify(free).notes
    held = rho.simulate(plan, wind=wind, disturbance=gust)
    assert held.scenario.disturbance == gust
    assert 0.0 < held.errors()[-1, 0] < 0.2 * free.errors()[-1, 0]
    assert np.all(held.errors() <= held.radii()[:, None] + 1e-9)
    assert not any("without feedback" in note for note in rho.verify(held).notes)
    for arguments, words in (
        ({"disturbance": gust}, "disturbance: got one of 0.2 m/s², expected none: .* has its own"),
        ({"replan_every": 3}, "replan_every: got 3, expected none for a plan"),
        ({"planner": rho.plan_scp}, "planner: got plan_scp, expected none for a plan"),
        ({"fallback": None}, "fallback: got None, expected none for a plan"),
        ({"wind": lambda t, p, v: p[:-1]}, r"wind: got shape \(0, 3\)"),
    ):
        with pytest.raises(ValueError, match=words):
            rho.simulate(held.plan if "disturbance" in arguments else plan, **arguments)
    with pytest.raises(TypeError, match="scenario: got an object of type Simulation"):
        rho.simulate(held)  # type: ignore[arg-type]


def test_a_scenario_without_a_disturbance_can_be_simulated() -> None:
    simulation = rho.simulate(single())
    assert simulation.errors().max() <= 1e-9
    np.testing.assert_allclose(simulation.positions[-1], [[10.0, 4.0, -2.0]], atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_rotors_produce_the_commanded_thrust_and_moments(seed: int) -> None:
    """In the attitude of an acceleration, the plant has that acceleration and no angular one."""
    rng = np.random.default_rng(seed)
    inertia = np.diag(rng.uniform(1e-3, 4e-3, 3))
    plant = QuadrotorPlant(*rng.uniform([0.3, 0.1], [2.0, 0.4]), inertia, 1.7, 0.03)
    controller = AttitudeController(plant)
    acceleration = rng.uniform(-3.0, 3.0, 3)
    x, y, z = acceleration + np.array([0.0, 0.0, plant.g()])
    pitch = np.arctan2(x, z)
    roll = np.arctan2(-y, np.hypot(x, z))
    state = np.zeros(12)
    state[3:5] = roll, pitch
    context = plant.CreateDefaultContext()
    context.SetContinuousState(state)
    plant.get_input_port(0).FixValue(context, controller.rotors(state, acceleration))
    derivative = plant.EvalTimeDerivatives(context).CopyToVector()
    np.testing.assert_allclose(derivative[6:9], acceleration, atol=1e-9)
    np.testing.assert_allclose(derivative[9:], 0.0, atol=1e-6)

    state[3:6] += rng.uniform(-0.3, 0.3, 3)  # from another attitude it turns back
    context.SetContinuousState(state)
    plant.get_input_port(0).FixValue(context, controller.rotors(state, acceleration))
    turning = plant.EvalTimeDerivatives(context).CopyToVector()[9:]
    assert turning @ (state[3:6] - [roll, pitch, 0.0]) < 0.0


@pytest.mark.slow
def test_quadrotors_follow_and_the_difference_is_reported() -> None:
    scenario = disturbed(12, delay=0, errors=False)
    wind = rho.winds.constant(scenario, [1, -1, 0.3])
    simulation = rho.simulate(scenario, plant="quadrotor", wind=wind)
    assert simulation.plant == "quadrotor"
    assert np.diff(simulation.times).max() <= 1e-3 * (1.0 + 1e-9)
    left = np.diff(simulation.velocities, axis=0) / np.diff(simulation.times)[:, None, None]
    left -= simulation.commands[:-1] + simulation.wind[:-1]
    reported = simulation.tracking_difference
    np.testing.assert_allclose(reported, np.linalg.norm(left, axis=2).max(axis=0), rtol=1e-12)
    assert np.all(reported > 1e-3)  # attitudes do not jump like accelerations
    lasting = np.linalg.norm(left, axis=2)
    assert np.median(lasting) < 0.05 * reported.max()  # only while they turn
    goals = simulation.scenario.fleet.goal_positions
    assert np.linalg.norm(simulation.positions[-1] - goals, axis=1).max() < 0.1


def test_a_hovering_quadrotor_is_carried_by_the_wind() -> None:
    """With a constant command the plant settles, and moves like a point mass except for turning."""
    scenario = single(start=rho.State([1.0, 2.0, 3.0], [0.3, 0.2, 0.1]))
    builder = DiagramBuilder()
    plant = builder.AddSystem(quadrotors(scenario))
    for name, value in (("acceleration", [0.0, 0.0, 0.0]), ("wind", [0.1, 0.2, -0.3])):
        source = builder.AddSystem(ConstantVectorSource(value))
        builder.Connect(source.get_output_port(), plant.GetInputPort(name))
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(2.0)
    states = plant.GetOutputPort("states").Eval(plant.GetMyContextFromRoot(simulator.get_context()))
    wind = np.array([0.1, 0.2, -0.3])
    expected = np.array([1.0, 2.0, 3.0]) + 2.0 * np.array([0.3, 0.2, 0.1]) + 2.0 * wind
    np.testing.assert_allclose(states[:3], expected, atol=1e-6)
    np.testing.assert_allclose(states[3:], np.array([0.3, 0.2, 0.1]) + 2.0 * wind, atol=1e-6)


def _diagram(
    scenario: rho.Scenario, wind: rho.winds.Wind
) -> tuple[Simulator, rho.RecedingHorizonController, rho.WindyPointMass]:
    builder = DiagramBuilder()
    controller = builder.AddSystem(rho.RecedingHorizonController(rho.RecedingHorizon(scenario)))
    plant = builder.AddSystem(rho.WindyPointMass(scenario))
    source = builder.AddSystem(WindSource(scenario, wind))
    for one, name, other, port in (
        (plant, "states", controller, "states"),
        (plant, "states", source, "states"),
        (controller, "command", plant, "acceleration"),
        (source, "wind", plant, "wind"),
    ):
        builder.Connect(one.GetOutputPort(name), other.GetInputPort(port))
    return Simulator(builder.Build()), controller, plant


def test_the_loop_refuses_what_the_simulator_refuses() -> None:
    scenario = disturbed(1)
    plan, shape = rho.plan(scenario), rf"shape \(3,\) at .* \({len(scenario.vehicles)}, 3\)$"
    with pytest.raises(ValueError, match="^wind: got " + shape):
        fly_plan(scenario, plan, wind=lambda t, p, v: np.zeros(3))
    with pytest.raises(ValueError, match=r"^wind: got \[\[nan.* at .* s, expected finite"):
        fly_plan(scenario, plan, wind=lambda t, p, v: p * np.nan)
    with pytest.raises(ValueError, match=r"^rng: got 3, expected a numpy.random.Generator"):
        fly_plan(scenario, plan, rng=3)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^plan: got one for 1 on "):
        fly_plan(scenario, rho.plan(single()))
    with pytest.raises(ValueError, match=r"^replan_every: got 0"):
        fly(scenario, replan_every=0)


def test_a_time_with_rounding_is_that_of_the_record() -> None:
    scenario = disturbed(4)
    wind = rho.worst_case(scenario, [1, 0, 0], scenario.grid.start + 0.77 * scenario.grid.duration)
    timeline = Timeline.of(scenario, wind)
    for elapsed, time in zip(timeline.elapsed, timeline.times, strict=True):
        for rounded in (np.nextafter(elapsed, -1.0), elapsed, elapsed + 1e-12):
            assert timeline.nearest(float(rounded)) == time


def test_a_custom_diagram_flies_like_simulate() -> None:
    scenario = disturbed(12)
    wind = rho.winds.constant(scenario, [1, 2, 0])
    simulator, controller, plant = _diagram(scenario, wind)
    simulator.AdvanceTo(scenario.grid.duration)
    context = plant.GetMyContextFromRoot(simulator.get_context())
    states = plant.GetOutputPort("states").Eval(context).reshape(-1, 6)
    expected = fly(scenario, wind=wind)
    np.testing.assert_allclose(states[:, :3], expected.positions[-1], atol=1e-9)
    np.testing.assert_allclose(states[:, 3:], expected.velocities[-1], atol=1e-9)
    assert len(controller.flight.windows) == len(expected.flight.windows)


def test_a_controller_of_a_scenario_has_a_horizon_of_its_own() -> None:
    scenario = disturbed(12)
    own = rho.RecedingHorizonController(scenario)
    given = rho.RecedingHorizonController(rho.RecedingHorizon(scenario))
    ours, theirs = own.flight.plan.accelerations, given.flight.plan.accelerations
    np.testing.assert_array_equal(ours, theirs)


def test_the_nominal_motion_is_the_plan_of_the_window_in_force() -> None:
    scenario = disturbed(12)
    horizon = rho.RecedingHorizon(scenario, replan_every=3)
    builder = DiagramBuilder()
    controller = builder.AddSystem(rho.RecedingHorizonController(horizon))
    plant = builder.AddSystem(rho.WindyPointMass(scenario))
    builder.Connect(plant.get_output_port(), controller.get_input_port())
    builder.Connect(controller.GetOutputPort("command"), plant.GetInputPort("acceleration"))
    log = LogVectorOutput(controller.GetOutputPort("nominal"), builder, publish_period=0.017)
    simulator = Simulator(builder.Build())
    grid = scenario.grid
    simulator.AdvanceTo(grid.duration + 1.0)
    logged = log.FindLog(simulator.get_context())
    assert len(horizon.windows) == len(horizon.knots)
    for elapsed, values in zip(logged.sample_times(), logged.data().T, strict=True):
        planned = values.reshape(-1, 3, 3)
        if elapsed > grid.duration:  # with the last velocity, here zero
            goals = scenario.fleet.goal_positions
            np.testing.assert_allclose(planned[:, 0], goals, atol=1e-5)
            np.testing.assert_array_equal(planned[:, 2], 0.0)
            continue
        first = 3 * min(int(elapsed / grid.step / 3 + 1e-9), len(horizon.windows) - 1)
        window = next(each for each in horizon.windows if each.first_knot == first)
        motion = window.plan.motion()
        for place, quantity in enumerate(("position", "velocity", "acceleration")):
            found = motion.at(quantity, elapsed - first * grid.step)[:, 0]  # type: ignore[arg-type]
            np.testing.assert_allclose(planned[:, place], found, atol=1e-9)


def test_a_controller_never_raises_in_flight_but_refuses_a_second_one() -> None:
    """States may be anything, far off or not even numbers."""
    scenario = disturbed(12)
    for states in (1e3, np.nan, np.inf):
        builder = DiagramBuilder()
        controller = builder.AddSystem(rho.RecedingHorizonController(rho.RecedingHorizon(scenario)))
        source = builder.AddSystem(
            ConstantVectorSource(np.full(6 * len(scenario.vehicles), states))
        )
        builder.Connect(source.get_output_port(), controller.get_input_port())
        simulator = Simulator(builder.Build())
        simulator.AdvanceTo(scenario.grid.duration)
        assert len(controller.flight.windows) > 1
        again = Simulator(simulator.get_system())
        with pytest.raises(ValueError, match=r"^controller: got a second flight"):
            again.Initialize()


def test_a_first_window_without_a_plan_raises_at_construction() -> None:
    scenario = single(limits=rho.Limits(max_speed=0.5))
    with pytest.raises(rho.InfeasibleError):
        rho.RecedingHorizonController(rho.RecedingHorizon(scenario))
    with pytest.raises(rho.InfeasibleError):
        rho.simulate(scenario)


def test_every_context_has_a_plan_as_its_state() -> None:
    scenario = disturbed(12)
    simulator, controller, _ = _diagram(scenario, rho.winds.constant(scenario, [0, 1, 0]))
    simulator.AdvanceTo(1.0)
    kept = simulator.get_context().Clone()
    ports = [controller.GetOutputPort(name) for name in ("nominal", "command")]
    before = [port.Eval(controller.GetMyContextFromRoot(kept)).copy() for port in ports]
    simulator.AdvanceTo(scenario.grid.duration)
    assert len(controller.flight.windows) == 2
    for port, expected in zip(ports, before, strict=True):
        again = port.Eval(controller.GetMyContextFromRoot(kept))
        np.testing.assert_array_equal(again, expected)
        now = port.Eval(controller.GetMyContextFromRoot(simulator.get_context()))
        assert not np.allclose(now, expected)


def test_invalid_arguments_of_simulate_are_refused_by_name() -> None:
    scenario = disturbed(12)
    with pytest.raises(ValueError, match=r"^plant: got 'rocket', expected 'quadrotor' or None"):
        rho.simulate(scenario, plant="rocket")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^replan_every: got 2.5"):
        rho.simulate(scenario, replan_every=2.5)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"^rng: got 'seed'"):
        rho.simulate(scenario, rng="seed")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^wind: got shape \(3,\)"):
        rho.simulate(scenario, wind=lambda t, p, v: np.zeros(3))


def test_drakes_systems_are_loaded_only_to_fly() -> None:
    code = "import sys, drake_rho; print('pydrake.systems.framework' in sys.modules)"
    printed = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert printed.stdout.strip() == "False"


def test_the_settings_of_the_loop_are_those_of_a_receding_horizon() -> None:
    assert settings_of(fly) == settings_of(rho.RecedingHorizon)
    hints = get_type_hints(rho.RecedingHorizon.__init__)
    assert get_type_hints(Windows) == {name: hints[name] for name in settings_of(rho.plan_rho)}


@pytest.mark.slow
def test_the_loop_with_every_setting_is_the_simulator() -> None:
    scenario = from_yaml(MISSION)
    wind = rho.winds.constant(scenario, [0, 1, 0])
    own, other = (
        fly_it(scenario, wind=wind, rng=np.random.default_rng(5), **EVERYTHING)
        for fly_it in (fly, rho.simulate)
    )
    assert all(window.contingency or window.no_contingency for window in own.windows)
    np.testing.assert_allclose(own.positions, other.positions, atol=1e-9)


@pytest.mark.slow
def test_methods_of_studies_take_the_settings(tmp_path: Path) -> None:
    scenario = from_yaml(MISSION)
    settings: dict[str, Any] = {"reference": "tail", "solver": "osqp", "windows": "convex"}
    settings |= {name: EVERYTHING[name] for name in ("replan_every", "contingencies", "latency")}
    settings |= {"bounded_cost": True, "options": {"max_memory": 1e8}}
    methods = [{"name": kind, "planner": kind, **settings} for kind in ("plan_rho", "simulate")]
    methods[1]["estimates"] = False
    source = {"name": "gap", "scenario": scenario}
    study = small(1, scenarios=[source], methods=methods, plans=True)
    results = rho.campaign(study, tmp_path / "runs.sqlite")
    keys = dict(table(tmp_path / "runs.sqlite", ("method", "key")))
    assert_same_flight(results.plan(keys["plan_rho"]).flight, rho.plan_rho(scenario, **EVERYTHING))
    flown = results.plan(keys["simulate"])
    assert isinstance(flown, rho.Simulation)
    np.testing.assert_array_equal(flown.positions, fly(scenario, **EVERYTHING).positions)
    assert_same_flight(flown.flight, fly(scenario, **EVERYTHING).flight)
