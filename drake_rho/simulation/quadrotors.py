"""Drake's quadrotors, each with a controller that maps commanded accelerations to rotor inputs."""

from __future__ import annotations

import math

import numpy as np
from pydrake.examples import QuadrotorPlant
from pydrake.math import RollPitchYaw
from pydrake.systems.framework import (
    BasicVector,
    Context,
    Diagram,
    DiagramBuilder,
    DiscreteValues,
    EventStatus,
    LeafSystem,
)
from pydrake.systems.primitives import Adder, Demultiplexer, Multiplexer

from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario
from drake_rho.simulation.systems import WindyPointMass

LONGEST = 1e-3
"""Longest time between two updates of a quadrotor's controller [s]: it runs at 1 kHz or faster."""

_BANDWIDTH, _DAMPING = 40.0, 1.0
"""Natural frequency [rad/s] and damping ratio of the attitude loop, which settles in about 0.1 s.
"""


class AttitudeController(LeafSystem):
    """Controller of a quadrotor's thrust and attitude for a commanded acceleration.

    By differential flatness the thrust vector is m (a + g e_z); its direction is the body's z axis
    and the yaw is 0. The attitude is tracked by the geometric controller on SO(3) of Lee, Leok and
    McClamroch (2010), without feed-forward of rates, because the commanded acceleration has no
    derivative. Rotors cannot pull, so inputs are at least 0.

    Ports: inputs `acceleration` (3) and `state` (12, of a `QuadrotorPlant`); output `rotors` (4),
    updated at each step of the simulator.
    """

    def __init__(self, plant: QuadrotorPlant) -> None:
        super().__init__()
        self._mass, self._inertia = plant.m(), np.asarray(plant.inertia())
        self._gravity = np.array([0.0, 0.0, plant.g()])
        arm, lift, drag = plant.length(), plant.force_constant(), plant.moment_constant()
        mixing = np.array(  # of rotor inputs: thrust and moments about x, y, z
            [
                [lift, lift, lift, lift],
                [0.0, arm * lift, 0.0, -arm * lift],
                [-arm * lift, 0.0, arm * lift, 0.0],
                [drag, -drag, drag, -drag],
            ]
        )
        self._rotors_for = np.linalg.inv(mixing)
        self._acceleration = self.DeclareVectorInputPort("acceleration", 3)
        self._state = self.DeclareVectorInputPort("state", 12)
        self.DeclareStateOutputPort("rotors", self.DeclareDiscreteState(4))
        self.DeclarePerStepDiscreteUpdateEvent(self._update)

    def _update(self, context: Context, discrete: DiscreteValues) -> EventStatus:
        state, a = self._state.Eval(context), self._acceleration.Eval(context)
        discrete.set_value(self.rotors(state, a))
        return EventStatus.Succeeded()

    def rotors(self, state: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Return rotor inputs (4,) for a state (12,) and a commanded acceleration [m/s²], (3,)."""
        roll_pitch_yaw = RollPitchYaw(state[3:6])
        R = roll_pitch_yaw.ToRotationMatrix().matrix()
        rates = R.T @ roll_pitch_yaw.CalcAngularVelocityInParentFromRpyDt(state[9:12])
        thrust = self._mass * (acceleration + self._gravity)
        wanted = _upright_along(thrust)
        error = wanted.T @ R - R.T @ wanted
        error = 0.5 * np.array([error[2, 1], error[0, 2], error[1, 0]])
        spin = -(_BANDWIDTH**2) * error - 2.0 * _DAMPING * _BANDWIDTH * rates
        moment = self._inertia @ spin + _cross(rates, self._inertia @ rates)
        inputs = self._rotors_for @ np.array([thrust @ R[:, 2], *moment])
        return np.asarray(np.maximum(inputs, 0.0))


def _upright_along(thrust: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) with z axis along a thrust and zero yaw: x has no y component."""
    length = math.sqrt(thrust @ thrust)
    z = thrust / length if length > 0.0 else np.array([0.0, 0.0, 1.0])  # arbitrary in free fall
    upright = math.hypot(z[0], z[2])
    x = np.array([z[2], 0.0, -z[0]]) / upright if upright > 1e-9 else np.array([1.0, 0.0, 0.0])
    return np.array([x, _cross(z, x), z]).T


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the cross product of two vectors; numpy's takes twenty times as long."""
    (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


class _FromOrigin(LeafSystem):
    """Map from states of quadrotors (12N) to their positions and velocities (6N)."""

    def __init__(self, count: int) -> None:
        super().__init__()
        self._plants = self.DeclareVectorInputPort("plants", 12 * count)
        self.DeclareVectorOutputPort("states", 6 * count, self._report)

    def _report(self, context: Context, output: BasicVector) -> None:
        states = self._plants.Eval(context).reshape(-1, 12)
        output.SetFromVector(states[:, [0, 1, 2, 6, 7, 8]].reshape(-1))


def quadrotors(scenario: Scenario) -> Diagram:
    """Return a diagram with a quadrotor for each vehicle and the ports of a `WindyPointMass`.

    `QuadrotorPlant` has no wind port and no drag, so its accelerations do not depend on its
    position and velocity. Quadrotors therefore begin hovering at rest in the origin, and the motion
    due to initial states and wind is integrated separately and added, which is exact.
    """
    builder, count = DiagramBuilder(), len(scenario.vehicles)
    commands = builder.AddSystem(Demultiplexer(3 * count, 3))
    plants = builder.AddSystem(Multiplexer([12] * count))
    for i in range(count):
        plant = builder.AddSystem(QuadrotorPlant())
        controller = builder.AddSystem(AttitudeController(plant))
        builder.Connect(commands.get_output_port(i), controller.GetInputPort("acceleration"))
        builder.Connect(plant.get_output_port(0), controller.GetInputPort("state"))
        builder.Connect(controller.get_output_port(), plant.get_input_port(0))
        builder.Connect(plant.get_output_port(0), plants.get_input_port(i))
    flown = builder.AddSystem(_FromOrigin(count))
    drift = builder.AddSystem(WindyPointMass(scenario))  # initial states and wind only
    total = builder.AddSystem(Adder(2, 6 * count))
    builder.Connect(plants.get_output_port(), flown.get_input_port())
    builder.Connect(flown.get_output_port(), total.get_input_port(0))
    builder.Connect(drift.get_output_port(), total.get_input_port(1))
    builder.ExportInput(commands.get_input_port(), "acceleration")
    builder.ExportInput(drift.GetInputPort("wind"), "wind")
    builder.ExportOutput(total.get_output_port(), "states")
    return builder.Build()
