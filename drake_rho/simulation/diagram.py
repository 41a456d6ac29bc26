"""The diagram of a flight: horizon, plant and wind as Drake systems, flown and recorded."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder, System

from drake_rho.motion.simulation import Simulation
from drake_rho.simulation.estimates import EstimationErrors
from drake_rho.simulation.feedback import Horizon
from drake_rho.simulation.quadrotors import LONGEST, quadrotors
from drake_rho.simulation.systems import (
    Estimator,
    RecedingHorizonController,
    WindSource,
    WindyPointMass,
)
from drake_rho.simulation.timeline import Timeline
from drake_rho.simulation.winds import Wind

_PLANTS = {None: "point mass", "quadrotor": "quadrotor"}
"""What can be flown, and what it is called in records."""


def simulated(
    horizon: Horizon,
    wind: Wind,
    plant: Literal["quadrotor"] | None,
    rng: np.random.Generator | None,
) -> Simulation:
    """Fly a horizon in a wind; arguments as for `simulate`.

    Raises:
        InfeasibleError: the first window has no plan; it raises what the horizon does.
        ValueError: the wind or `rng` makes no sense.
    """
    scenario = horizon.scenario
    timeline = Timeline.of(scenario, wind, np.inf if plant is None else LONGEST)
    errors = EstimationErrors.of(scenario, wind, rng)
    flying = WindyPointMass(scenario) if plant is None else quadrotors(scenario)
    controller = RecedingHorizonController(horizon)
    source = WindSource(scenario, wind, timeline)
    estimator = Estimator(scenario, errors, float(timeline.elapsed[timeline.samples[1]]))
    simulator = _simulator(flying, controller, source, estimator, timeline)
    root = simulator.get_context()
    ports = [
        (system.GetOutputPort(name), system.GetMyContextFromRoot(root))
        for system, name in ((flying, "states"), (source, "wind"), (controller, "command"))
    ]
    count = len(scenario.vehicles)
    states = np.empty((len(timeline.times), count, 6))
    blowing, commands = np.empty((2, len(states), count, 3))
    states[0] = ports[0][0].Eval(ports[0][1]).reshape(count, 6)
    for m, time in enumerate(timeline.elapsed[1:].tolist(), start=1):
        simulator.AdvanceTo(time)
        states[m], blowing[m - 1], commands[m - 1] = (
            port.Eval(context).reshape(count, -1) for port, context in ports
        )
    blowing[-1], commands[-1] = blowing[-2], commands[-2]
    return Simulation(
        controller.flight,
        timeline.times,
        states[..., :3],
        states[..., 3:],
        blowing,
        commands,
        _PLANTS[plant],
        timeline.elapsed,
    )


def _simulator(
    plant: System,
    controller: RecedingHorizonController,
    source: WindSource,
    estimator: Estimator,
    timeline: Timeline,
) -> Simulator:
    """The diagram, ready to fly: true states -> estimates -> commands -> true states."""
    builder = DiagramBuilder()
    for system in (plant, controller, source, estimator):
        builder.AddSystem(system)
    builder.Connect(plant.GetOutputPort("states"), estimator.GetInputPort("states"))
    builder.Connect(plant.GetOutputPort("states"), source.GetInputPort("states"))
    builder.Connect(estimator.GetOutputPort("states"), controller.GetInputPort("states"))
    builder.Connect(controller.GetOutputPort("command"), plant.GetInputPort("acceleration"))
    builder.Connect(source.GetOutputPort("wind"), plant.GetInputPort("wind"))
    simulator = Simulator(builder.Build())
    longest = float(np.diff(timeline.elapsed).max())
    ResetIntegratorFromFlags(simulator, "runge_kutta3", 2.0 * longest)
    simulator.get_mutable_integrator().set_fixed_step_mode(True)
    simulator.Initialize()
    return simulator
