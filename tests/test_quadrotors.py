"""Quadrotors in declared wind: smooth commands, bounded tilts, and gains that their lag allows."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

import drake_rho as rho
from drake_rho.simulation.attitude import LAG, MAX_TILT, WIDTH, SmoothCommand, held
from drake_rho.simulation.quadrotors import quadrotors
from tests.disturbed import windy_room
from tests.scenarios import single, slow

G = 9.81
"""Gravity [m/s²]."""

RESIDUAL = 1e-3
"""Position by which a quadrotor may be off its smooth motion's mean [m], beside the tube."""

NEARLY = 1.05
"""Factor up to which the feedback of a quadrotor, which is no point mass, is within its radius."""


@pytest.mark.parametrize("seed", [3, *slow(*range(4, 12))])
def test_quadrotors_end_within_the_tube_of_their_plant(seed: int) -> None:
    """Without the lag in the gains, all of them tumble."""
    scenario, wind = windy_room(seed)
    flown = rho.simulate(scenario, wind=wind, plant="quadrotor")
    around = flown.scenario.disturbance
    assert around is not None
    assert around.delay * around.sample(scenario.grid) >= LAG - 1e-9
    errors, radii = flown.errors(), flown.radii()
    assert np.all(errors[-1] <= radii[-1] + 1e-9)
    feedback, bound = flown.errors("acceleration"), flown.radii("acceleration")
    assert np.all(feedback <= NEARLY * bound[:, None] + 1e-9)
    assert feedback.max() > 0.0
    assert rho.verify(flown).ok
    assert np.all(errors <= radii[:, None] + RESIDUAL)


def test_a_smooth_command_is_the_command_a_lag_later() -> None:
    jumps = np.random.default_rng(1).uniform(-4.0, 4.0, (3, 3))
    command, since = SmoothCommand(np.zeros(3)), [0.0, 0.03, 0.05]
    for time, jump in zip(since, jumps, strict=True):
        command = command.followed_by(command.value + jump, time)
    times = np.linspace(0.05, 0.05 + WIDTH, 4001)
    values = np.array([command.at(time) for time in times])
    step = times[1] - times[0]
    for order in (0, 1):  # derivatives
        slopes = np.gradient(values[:, order], step, axis=0)
        np.testing.assert_allclose(
            slopes[2:-2], values[2:-2, order + 1], atol=0.05 * 10 ** (2 * order)
        )
    np.testing.assert_allclose(values[-1, 0], jumps.sum(axis=0), atol=1e-9)
    alone = SmoothCommand(np.zeros(3)).followed_by(jumps[0], 0.0)
    times = np.linspace(0.0, WIDTH, 4001)
    mean = np.mean([alone.at(time)[0] for time in times], axis=0)
    np.testing.assert_allclose(mean * WIDTH, jumps[0] * (WIDTH - LAG), atol=1e-3)


def test_no_commanded_acceleration_tilts_a_quadrotor_too_far() -> None:
    rng = np.random.default_rng(2)
    for acceleration in rng.normal(size=(200, 3)) * 10.0 ** rng.uniform(-1.0, 4.0, (200, 1)):
        x, y, z = held(acceleration, G)
        assert np.hypot(x, y) <= np.tan(MAX_TILT) * (z + G) * (1.0 + 1e-9)
    np.testing.assert_allclose(held(np.array([2.0, -1.0, 3.0]), G), [2.0, -1.0, 3.0], atol=1e-12)


@pytest.mark.parametrize("command", [[90.0, 0.0, -40.0], [-1e4, 1e4, 0.0], [0.0, 0.0, -50.0]])
def test_commands_that_no_quadrotor_follows_do_not_overturn_it(command: list[float]) -> None:
    """Drake's plant has roll, pitch and yaw, and ends where the pitch is a right angle."""
    scenario = single()
    builder = DiagramBuilder()
    plant = builder.AddSystem(quadrotors(scenario))
    for name, value in (("acceleration", command), ("wind", [0.0, 0.0, 0.0])):
        source = builder.AddSystem(ConstantVectorSource(value))
        builder.Connect(source.get_output_port(), plant.GetInputPort(name))
    simulator = Simulator(builder.Build())
    simulator.get_mutable_integrator().set_maximum_step_size(1e-3)
    simulator.AdvanceTo(0.5)
    root = simulator.get_context()
    states = plant.GetOutputPort("states").Eval(plant.GetMyContextFromRoot(root))
    assert np.isfinite(states).all()


def test_a_horizon_is_refused_with_the_gains_that_a_quadrotor_can_hold() -> None:
    scenario, _ = windy_room(3)
    with pytest.raises(ValueError, match=r"cannot hold, expected a delay of .* gains of .* 1/s²"):
        rho.simulate(rho.RecedingHorizon(scenario), plant="quadrotor")
    narrow = rho.Scenario(
        "narrow",
        rho.Grid.lasting(2.0, step=0.1),
        [rho.Vehicle("one", rho.State([0, 0, 1]), rho.State([1, 0, 1]))],
        rho.Limits(rho.Box([-0.1, -0.1, 0.9], [1.1, 0.1, 1.1]), max_acceleration=3.0),
        disturbance=rho.Disturbance(1.0),
    )
    rho.plan_rho(narrow)  # deadbeat gains have room for the errors
    with pytest.raises(rho.InfeasibleError, match=r"gains of .* that a quadrotor can hold"):
        rho.simulate(narrow, plant="quadrotor")
