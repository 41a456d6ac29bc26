"""Thrust and attitude of a quadrotor for smoothed acceleration commands.

A quadrotor turns before it accelerates in another direction. Every jump of the command is therefore
spread over `WIDTH`, symmetrically about a time `LAG` later: the commanded thrust then has two
derivatives, which the attitude loop feeds forward, and the acceleration is that of a point mass
with a delay of `LAG`. Averages stay in the convex set of allowed commands, so the tilt limit holds.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Self

import numpy as np
from pydrake.common.value import Value
from pydrake.examples import QuadrotorPlant
from pydrake.math import RollPitchYaw, RotationMatrix
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from drake_rho.scenario.fields import FloatArray

UP = np.array([0.0, 0.0, 1.0])
"""Direction against gravity."""

WIDTH = 0.1
"""Duration of the thrust's change after a jump of the command [s]."""

LAG = WIDTH / 2.0
"""Mean delay from a commanded acceleration to the actual one [s]."""

MAX_TILT = math.radians(60.0)
"""Largest tilt of the commanded thrust [rad]: roll, pitch and yaw are far from gimbal lock."""

_LEAST_LIFT = 0.2
"""Least vertical part of the commanded thrust, in weights."""

_BANDWIDTH, _DAMPING = 40.0, 1.0
"""Natural frequency [rad/s] and damping ratio of the attitude error."""

_YAWING = np.array([1.0, -1.0, 1.0, -1.0])
"""Change of rotor inputs that changes only the moment of yaw."""

_APART = 1e-3
"""Time step of finite differences for rates and angular accelerations [s]."""


@dataclasses.dataclass(frozen=True, eq=False)
class SmoothCommand:
    """Commanded acceleration with each of its jumps spread over `WIDTH`; immutable."""

    value: FloatArray
    """latest command [m/s²], shape (3,)"""
    jumps: tuple[tuple[float, FloatArray], ...] = ()
    """times of the last jumps [s] and their sizes [m/s²], (3,) each"""

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Return the command itself, since Drake's contexts copy their state."""
        return self

    def followed_by(self, command: FloatArray, time: float) -> Self:
        """Return this command after a possible change of its value at a time."""
        if np.array_equal(command, self.value):
            return self
        jumps = [jump for jump in self.jumps if time - jump[0] < WIDTH]
        jumps.append((time, command - self.value))
        return dataclasses.replace(self, value=command, jumps=tuple(jumps))

    def at(self, time: float) -> FloatArray:
        """Return the smooth acceleration [m/s²] at a time and two derivatives, shape (3, 3)."""
        found = np.array([self.value, np.zeros(3), np.zeros(3)])
        for since, jump in self.jumps:
            x = (time - since) / WIDTH
            if x < 1.0:
                missing = x * x * x * (10.0 - 15.0 * x + 6.0 * x * x) - 1.0
                first = 30.0 * (x * (1.0 - x)) ** 2 / WIDTH
                second = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / WIDTH**2
                found += np.multiply.outer((missing, first, second), jump)
        return found


class AttitudeController(LeafSystem):
    """Controller of a quadrotor's thrust and attitude for a commanded acceleration.

    By differential flatness the thrust vector is m (a + g e_z); its direction is the body's z axis,
    and the nose points along the heading, 0 if none is commanded. The attitude is a rotation whose
    error is the vector part of a quaternion, so there is no gimbal lock. The vertical thrust is as
    commanded even while the quadrotor turns. Rotors cannot pull, so inputs are at least 0; where
    one would have to, the moment of yaw is reduced.

    Ports: inputs `acceleration` (3), `state` (12, of a `QuadrotorPlant`) and, optionally, `heading`
    (2N: heading [rad] and rate [rad/s] of each vehicle in turn); output `rotors` (4), updated at
    each step of the simulator.

    Args:
        plant: the quadrotor.
        vehicle: its index.
        count: N, the number of vehicles.
    """

    def __init__(self, plant: QuadrotorPlant, vehicle: int = 0, count: int = 1) -> None:
        super().__init__()
        self._mass, self._inertia = plant.m(), np.asarray(plant.inertia())
        self._gravity = plant.g()
        arm, lift, drag = plant.length(), plant.force_constant(), plant.moment_constant()
        mixing = np.array(  # from rotor inputs to thrust and moments about x, y, z
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
        self._heading = self.DeclareVectorInputPort("heading", 2 * count)
        self._own = slice(2 * vehicle, 2 * vehicle + 2)
        self._command = self.DeclareAbstractState(Value[object](None))
        self.DeclareStateOutputPort("rotors", self.DeclareDiscreteState(4))
        self.DeclarePerStepUnrestrictedUpdateEvent(self._update)

    def _update(self, context: Context, state: State) -> EventStatus:
        wanted = held(self._acceleration.Eval(context), self._gravity)
        before = context.get_abstract_state(self._command).get_value()
        command = SmoothCommand(wanted) if before is None else before
        command = command.followed_by(wanted, context.get_time())
        state.get_mutable_abstract_state(self._command).set_value(command)
        heading = [0.0, 0.0]
        if self._heading.HasValue(context):
            heading = self._heading.Eval(context)[self._own].tolist()
        inputs = self.rotors(self._state.Eval(context), *command.at(context.get_time()), *heading)
        state.get_mutable_discrete_state(0).SetFromVector(inputs)
        return EventStatus.Succeeded()

    def rotors(
        self,
        state: FloatArray,
        acceleration: FloatArray,
        jerk: FloatArray | float = 0.0,
        snap: FloatArray | float = 0.0,
        heading: float = 0.0,
        rate: float = 0.0,
    ) -> FloatArray:
        """Return rotor inputs, shape (4,).

        Args:
            state: state of the `QuadrotorPlant`, shape (12,).
            acceleration: commanded acceleration [m/s²], shape (3,).
            jerk: its derivative [m/s³], shape (3,).
            snap: its second derivative [m/s⁴], shape (3,).
            heading: commanded heading [rad].
            rate: its derivative [rad/s].
        """
        angles = RollPitchYaw(state[3:6])
        R = angles.ToRotationMatrix().matrix()
        rates = R.T @ angles.CalcAngularVelocityInParentFromRpyDt(state[9:12])
        thrust = acceleration + self._gravity * UP
        wanted = upright_along(thrust, heading)
        spin = -(_BANDWIDTH**2) * _rotation_vector(wanted, R) - 2.0 * _DAMPING * _BANDWIDTH * rates
        if np.any(jerk) or np.any(snap) or rate:
            beside = (
                upright_along(thrust + t * (jerk + t / 2.0 * snap), heading + t * rate)
                for t in (-_APART, _APART)
            )
            turning, faster = _turning(wanted, *beside)
            spin += R.T @ wanted @ (2.0 * _DAMPING * _BANDWIDTH * turning + faster)
        moment = self._inertia @ spin + _cross(rates, self._inertia @ rates)
        lift = self._mass * thrust[2] / max(R[2, 2], math.cos(MAX_TILT) / 2.0)
        return allocated(self._rotors_for @ np.array([lift, *moment]))


def allocated(inputs: FloatArray) -> FloatArray:
    """Return rotor inputs (4,) of at least 0, with the same lift and tilting where possible.

    Opposite rotors spin alike. More of one pair and as much less of the other changes only the
    moment of yaw, which does not move the vehicle. Inputs that are just cut off at 0 change the
    lift and the moment that tilts it, so that sudden turns fail.

    Args:
        inputs: inputs for the wanted lift and moments, of either sign, shape (4,).
    """
    least, most = -min(inputs[0], inputs[2]), min(inputs[1], inputs[3])
    shift = min(max(least, 0.0), most) if least <= most else (least + most) / 2.0
    return np.asarray(np.maximum(inputs + shift * _YAWING, 0.0))


def held(acceleration: FloatArray, gravity: float) -> FloatArray:
    """Return the acceleration limited to the largest tilt, (3,).

    Args:
        acceleration: desired acceleration [m/s²], shape (3,).
        gravity: g [m/s²].
    """
    x, y, z = acceleration.tolist()
    lift = max(z + gravity, _LEAST_LIFT * gravity)
    most, aside = math.tan(MAX_TILT) * lift, math.hypot(x, y)
    part = 1.0 if aside <= most else most / aside
    return np.array([part * x, part * y, lift - gravity])


def upright_along(thrust: FloatArray, heading: float = 0.0) -> FloatArray:
    """Return the rotation (3, 3) with z axis along a thrust and x axis above a heading [rad]."""
    cos, sin = math.cos(heading), math.sin(heading)
    x, y, z = thrust.tolist()
    x, y = cos * x + sin * y, cos * y - sin * x
    upright, length = math.hypot(x, z), math.sqrt(x * x + y * y + z * z)
    a, b = z / upright, x / upright
    c, d = upright / length, y / length
    level = np.array([[a, -b * d, b * c], [0.0, c, d], [-b, -a * d, a * c]])
    return np.asarray(np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ level)


def _turning(
    wanted: FloatArray, earlier: FloatArray, later: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the rate [rad/s] and angular acceleration [rad/s²] of a desired attitude, (3,).

    Args:
        wanted: the attitude, shape (3, 3).
        earlier: the attitude `_APART` before.
        later: the attitude `_APART` afterwards.
    """
    before, after = (_rotation_vector(wanted, each) / _APART for each in (earlier, later))
    return (after - before) / 2.0, (after + before) / _APART


def _rotation_vector(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return twice the vector part of the quaternion from one rotation to another, (3,)."""
    turned = RotationMatrix(one.T @ other).ToQuaternion()
    return np.asarray(2.0 * math.copysign(1.0, turned.w()) * turned.xyz())


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the cross product of two vectors; numpy's takes twenty times as long."""
    (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])
