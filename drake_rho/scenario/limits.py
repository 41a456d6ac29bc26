"""`Limits` of a vehicle: boxes and norms."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import numpy as np
from pydantic import BeforeValidator, Field

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import (
    LARGEST,
    NOT_BOOLEAN,
    Positive,
    record,
)
from drake_rho.scenario.shapes.polyhedra import Box

GRAVITY = 9.81
"""g [m/s²]. A vehicle with acceleration a has the thrust a + g e_z per unit mass, z upwards."""


def _no_degrees(value: object) -> object:
    """Return a tilt unless it is too large for radians, such as an angle in degrees."""
    if isinstance(value, int | float) and np.pi / 2.0 <= value:
        radians = f"; {value:g}° are {np.radians(value):.4g} rad" if value < 90.0 else ""
        raise ScenarioError("", value, f"an angle in radians, less than a right angle{radians}")
    return value


@record
class Limits:
    """Limits of a vehicle: boxes (4) to (7) and norms. A limit that is not given does not apply.

    Thrust and tilt are those of a + g e_z, the acceleration that rotors have to produce for the
    vehicle to fly with acceleration a, where g = 9.81 m/s² (`GRAVITY`) and e_z points upwards.
    Hovering is always allowed.

    Examples:
        >>> slow = rho.Limits(max_speed=2.0)
        >>> rho.Limits(max_speed=4.0, max_tilt=0.5).overridden_by(slow).max_speed
        2.0
    """

    position: Box | None = None
    """the flyable volume (4) [m]"""
    velocity: Box | None = None
    """bounds on the velocity (6) [m/s]"""
    acceleration: Box | None = None
    """bounds on the acceleration (5) [m/s²]"""
    jerk: Box | None = None
    """bounds on the jerk (7), j[k] = (a[k] - a[k-1]) / h, or that of a smooth motion [m/s³], from
    the acceleration before the start to the one after the goal (`State.acceleration`)"""
    max_speed: Positive | None = None
    """largest norm of the velocity, in any direction [m/s]"""
    max_acceleration: Positive | None = None
    """largest norm of the acceleration, in any direction [m/s²]"""
    max_thrust: (
        Annotated[float, Field(ge=GRAVITY, le=LARGEST, allow_inf_nan=False), NOT_BOOLEAN] | None
    ) = None
    """largest norm of a + g e_z [m/s²], the thrust per unit mass; at least g = 9.81 m/s², the
    thrust of hovering"""
    max_tilt: (
        Annotated[
            float,
            Field(ge=1.0 / LARGEST, lt=np.pi / 2.0, allow_inf_nan=False),
            NOT_BOOLEAN,
            BeforeValidator(_no_degrees),
        ]
        | None
    ) = None
    """largest angle between a + g e_z and the upward vertical [rad], less than a right angle: the
    largest tilt of a multicopter"""
    max_jerk: Positive | None = None
    """largest norm of the jerk j[k] = (a[k] - a[k-1]) / h, in any direction [m/s³], at start and
    goal as for `jerk`"""

    def overridden_by(self, own: Limits | None) -> Limits:
        """Return these limits, overridden by the fields that `own` gives."""
        if own is None:
            return self
        limits = {
            field.name: getattr(own, field.name) or getattr(self, field.name)
            for field in dataclasses.fields(Limits)
        }
        return Limits(**limits)
