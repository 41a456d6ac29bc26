"""Drake's quadrotors, each with a controller that maps commanded accelerations to rotor inputs."""

from __future__ import annotations

import numpy as np
from pydrake.examples import QuadrotorPlant
from pydrake.math import RollPitchYaw, RotationMatrix
from pydrake.systems.framework import (
    BasicVector,
    Context,
    Diagram,
    DiagramBuilder,
    LeafSystem,
    System,
)
from pydrake.systems.primitives import Adder, Demultiplexer, Multiplexer

from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario
from drake_rho.simulation.attitude import UP, AttitudeController, held, upright_along
from drake_rho.simulation.systems import WindyPointMass

LONGEST = 1e-3
"""Longest time between two updates of a quadrotor's controller [s]: it runs at 1 kHz or faster."""


class _FromOrigin(LeafSystem):
    """Map from states of quadrotors (12N) to positions and velocities (6N), and to headings (N)."""

    def __init__(self, count: int) -> None:
        super().__init__()
        self._plants = self.DeclareVectorInputPort("plants", 12 * count)
        self.DeclareVectorOutputPort("states", 6 * count, self._report)
        self.DeclareVectorOutputPort("headings", count, self._report_headings)

    def _report(self, context: Context, output: BasicVector) -> None:
        states = self._plants.Eval(context).reshape(-1, 12)
        output.SetFromVector(states[:, [0, 1, 2, 6, 7, 8]].reshape(-1))

    def _report_headings(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._plants.Eval(context).reshape(-1, 12)[:, 5])  # yaws


def quadrotors(scenario: Scenario) -> Diagram:
    """Return a diagram with a quadrotor for each vehicle and the ports of a `WindyPointMass`.

    Beside these it has an input `heading`, as `AttitudeController`, which need not be connected,
    and an output `headings` (N) with the true ones.

    `QuadrotorPlant` has no wind port and no drag, so its accelerations do not depend on its
    position and velocity. Quadrotors therefore begin at rest at the origin, hovering unless
    `lean` turns them, and the motion due to initial states and wind is integrated separately and
    added, which is exact.
    """
    builder, count = DiagramBuilder(), len(scenario.vehicles)
    commands = builder.AddSystem(Demultiplexer(3 * count, 3))
    plants, heading = builder.AddSystem(Multiplexer([12] * count)), None
    for i in range(count):
        plant = builder.AddSystem(QuadrotorPlant())
        controller = builder.AddSystem(AttitudeController(plant, i, count))
        builder.Connect(commands.get_output_port(i), controller.GetInputPort("acceleration"))
        builder.Connect(plant.get_output_port(0), controller.GetInputPort("state"))
        builder.Connect(controller.get_output_port(), plant.get_input_port(0))
        builder.Connect(plant.get_output_port(0), plants.get_input_port(i))
        if heading is None:
            heading = builder.ExportInput(controller.GetInputPort("heading"), "heading")
        else:
            builder.ConnectInput(heading, controller.GetInputPort("heading"))
    flown = builder.AddSystem(_FromOrigin(count))
    drift = builder.AddSystem(WindyPointMass(scenario))  # initial states and wind only
    total = builder.AddSystem(Adder(2, 6 * count))
    builder.Connect(plants.get_output_port(), flown.get_input_port())
    builder.Connect(flown.GetOutputPort("states"), total.get_input_port(0))
    builder.Connect(drift.get_output_port(), total.get_input_port(1))
    builder.ExportInput(commands.get_input_port(), "acceleration")
    builder.ExportInput(drift.GetInputPort("wind"), "wind")
    builder.ExportOutput(total.get_output_port(), "states")
    builder.ExportOutput(flown.GetOutputPort("headings"), "headings")
    return builder.Build()


def lean(
    quadrotors: System, root: Context, accelerations: FloatArray, headings: FloatArray
) -> None:
    """Turn quadrotors to the attitudes of their first accelerations and headings.

    Args:
        quadrotors: diagram made by `quadrotors`.
        root: context of the whole simulation.
        accelerations: first commands [m/s²], shape (N, 3).
        headings: first headings [rad], shape (N,).
    """
    plants = [each for each in quadrotors.GetSystems() if isinstance(each, QuadrotorPlant)]
    for plant, acceleration, heading in zip(plants, accelerations, headings.tolist(), strict=True):
        thrust = held(acceleration, plant.g()) + plant.g() * UP
        state = np.zeros(12)
        state[3:6] = RollPitchYaw(RotationMatrix(upright_along(thrust, heading))).vector()
        plant.GetMyContextFromRoot(root).SetContinuousState(state)
