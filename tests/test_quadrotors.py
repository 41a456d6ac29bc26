"""Quadrotors in declared wind: smooth commands, bounded tilts, and gains that their lag allows."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

import drake_rho as rho
from drake_rho.simulation.attitude import LAG, MAX_TILT, WIDTH, SmoothCommand, allocated, held
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


def hurried(seed: int, delay: int) -> tuple[rho.Scenario, rho.winds.Wind]:
    """Return a vehicle with a delay whose last window has 0.1 s for corrections."""
    rng = np.random.default_rng(seed)
    grid, most = rho.Grid.lasting(0.8, step=0.02), float(rng.uniform(2.5, 5.0))
    far = most * grid.duration**2 / 4.0 * rng.uniform(0.3, 0.6)
    goal = rho.State([far, rng.uniform(-0.05, 0.05), 1.0 + 0.05 * rng.uniform()])
    scenario = rho.Scenario(
        "hurried",
        grid,
        [rho.Vehicle("one", rho.State([0.0, 0.0, 1.0]), goal)],
        rho.Limits(max_acceleration=most),
        disturbance=rho.Disturbance(most * rng.uniform(0.05, 0.15), delay=delay),
    )
    return scenario, rho.winds.constant(scenario, rng.normal(size=3))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5, 8, 17])
def test_sudden_corrections_just_before_the_goal_are_flown(seed: int) -> None:
    """With rotor inputs that are just cut off at 0, goals are missed by up to 0.08 m/s or 7 mm."""
    scenario, wind = hurried(seed, delay=1)
    flown = rho.simulate(scenario, wind=wind, plant="quadrotor")
    assert rho.verify(flown).ok


@pytest.mark.slow
def test_measurements_before_a_window_count_where_the_delay_is_longer_than_windows() -> None:
    """Without them windows would begin unseen, in a tube that widens without any feedback."""
    scenario, wind = hurried(3, delay=3)
    flown = rho.simulate(scenario, wind=wind, plant="quadrotor")
    around = flown.scenario.disturbance
    assert around is not None
    assert around.delay > 5  # steps in a window, of a sample each
    assert not any(window.unseen or window.off_tube for window in flown.windows)
    assert rho.verify(flown).ok
    first = [tube.initial for tube in flown.tubes[1:]]
    assert max(first) == min(first)


def test_where_rotors_would_have_to_pull_only_the_yaw_gives_way() -> None:
    wanted = np.random.default_rng(3).uniform(-1.0, 3.0, (500, 4))
    mixing = np.array([[1.0, 1, 1, 1], [0, 1, 0, -1], [-1, 0, 1, 0]])  # lift, roll and pitch
    pulling = 0
    for inputs in wanted:
        found = allocated(inputs)
        assert found.min() >= 0.0
        lift, roll, pitch = mixing @ inputs
        if inputs.min() >= 0.0:
            np.testing.assert_array_equal(found, inputs)
        elif abs(roll) + abs(pitch) <= lift:  # all that rotors can do
            pulling += 1
            np.testing.assert_allclose(mixing @ found, [lift, roll, pitch], atol=1e-12)
    assert pulling > 100


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


def test_windows_shorter_than_the_lag_are_refused() -> None:
    """Their accelerations would be commanded later than planned: goals were missed by 1 cm."""
    scenario, _ = hurried(1, delay=0)
    with pytest.raises(ValueError, match=r"replan_every: got 2, expected at least 3 for a quadr"):
        rho.simulate(scenario, plant="quadrotor", replan_every=2)
