"""Simulation of a flight as a Drake diagram of controller, plant, wind and estimator."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder, System

from drake_rho.motion.headings import Direction
from drake_rho.motion.simulation import Simulation
from drake_rho.simulation.estimates import EstimationErrors
from drake_rho.simulation.feedback import Horizon
from drake_rho.simulation.heading_source import HeadingSource
from drake_rho.simulation.plants import Plant
from drake_rho.simulation.systems import Estimator, RecedingHorizonController, WindSource
from drake_rho.simulation.timeline import Timeline
from drake_rho.simulation.winds import Wind


def simulated(
    horizon: Horizon,
    wind: Wind,
    plant: Plant,
    rng: np.random.Generator | None,
    directions: Sequence[Direction] | None = None,
) -> Simulation:
    """Fly a receding horizon in wind; arguments as for `simulate`.

    Args:
        horizon: planner of windows.
        wind: wind to fly in.
        plant: kind of vehicles.
        rng: source of estimation errors.
        directions: headings to command, one of each vehicle; None to command none.

    Raises:
        InfeasibleError: the first window has no plan; other errors of the horizon are passed on.
        ValueError: the wind or `rng` is invalid.
    """
    scenario = horizon.scenario
    timeline = Timeline.of(scenario, wind, plant.longest)
    errors = EstimationErrors.of(scenario, wind, rng)
    flying, delay = plant.system(scenario), plant.lag_in_samples(scenario)
    controller = RecedingHorizonController(horizon, lag=plant.lag, delay=delay)
    source = WindSource(scenario, wind, timeline)
    estimator = Estimator(scenario, errors, float(timeline.elapsed[timeline.samples[1]]))
    first_plan = controller.flight.windows[0].plan
    turns = None if directions is None else HeadingSource(first_plan, directions)
    simulator = _simulator(flying, plant.command, controller, source, estimator, timeline, turns)
    root = simulator.get_mutable_context()
    read = [(flying, "states"), (source, "wind"), (controller, "command")]
    if turns:
        read += [(flying, "headings"), (turns, "heading")]
    ports = [(each.GetOutputPort(name), each.GetMyContextFromRoot(root)) for each, name in read]
    count = len(scenario.vehicles)
    first = turns.first if turns else np.zeros(count)
    plant.turn(flying, root, ports[2][0].Eval(ports[2][1]).reshape(count, 3), first)
    states = np.empty((len(timeline.times), count, 6))
    acting, commands = np.empty((2, len(states), count, 3))
    noses = np.tile(first, (2, len(states), 1))  # true and commanded headings
    states[0] = ports[0][0].Eval(ports[0][1]).reshape(count, 6)
    for m, time in enumerate(timeline.elapsed[1:].tolist(), start=1):
        simulator.AdvanceTo(time)
        states[m], acting[m - 1], commands[m - 1], *headings = (
            port.Eval(context).reshape(count, -1) for port, context in ports
        )
        if headings:
            noses[:, m] = [each[:, 0] for each in headings]
    acting[-1], commands[-1] = acting[-2], commands[-2]
    noses[0] = np.unwrap(noses[0], axis=0)  # the plant begins with angles from -π to π
    return Simulation(
        controller.flight,
        timeline.times,
        states[..., :3],
        states[..., 3:],
        acting,
        commands,
        plant.name,
        timeline.elapsed,
        errors.lost,
        *(noses if turns else ()),
    )


def _simulator(
    plant: System,
    command: str,
    controller: RecedingHorizonController,
    source: WindSource,
    estimator: Estimator,
    timeline: Timeline,
    turns: HeadingSource | None,
) -> Simulator:
    """Return a simulator of the closed loop: true states, estimates, commands, true states."""
    builder = DiagramBuilder()
    for system in (plant, controller, source, estimator):
        builder.AddSystem(system)
    builder.Connect(plant.GetOutputPort("states"), estimator.GetInputPort("states"))
    builder.Connect(plant.GetOutputPort("states"), source.GetInputPort("states"))
    builder.Connect(estimator.GetOutputPort("states"), controller.GetInputPort("states"))
    builder.Connect(controller.GetOutputPort(command), plant.GetInputPort("acceleration"))
    builder.Connect(source.GetOutputPort("wind"), plant.GetInputPort("wind"))
    if turns:
        builder.AddSystem(turns)
        builder.Connect(controller.GetOutputPort("nominal"), turns.GetInputPort("nominal"))
        builder.Connect(turns.GetOutputPort("heading"), plant.GetInputPort("heading"))
    simulator = Simulator(builder.Build())
    longest = float(np.diff(timeline.elapsed).max())
    ResetIntegratorFromFlags(simulator, "runge_kutta3", 2.0 * longest)
    simulator.get_mutable_integrator().set_fixed_step_mode(True)
    simulator.Initialize()
    return simulator
