"""The list of convex constraints, and the table of how each kind of requirement is planned for."""

from __future__ import annotations

from drake_rho.planning.constraints.base import Constraint
from drake_rho.planning.constraints.boxes import boxes_of
from drake_rho.planning.constraints.margins import PlanMargins
from drake_rho.planning.constraints.norms import norms_of
from drake_rho.planning.constraints.waypoints import waypoints_of
from drake_rho.scenario.records import Scenario


def convex_constraints(scenario: Scenario, margins: PlanMargins) -> list[Constraint]:
    """Return what holds whatever the reference: keep-in constraints."""
    return [
        *boxes_of(scenario, margins),
        *norms_of(scenario, margins),
        *waypoints_of(scenario, margins),
    ]


_BOX = "rows of its sides where a motion is beyond them"
_NORM = "tangent planes where a motion is outside, cones where these come to no end"

TREATMENT = {
    "dynamics": "states are affine in the accelerations, which are the unknowns",
    "goals": "equalities of the accelerations, kept by the space of programs",
    "position": _BOX,
    "velocity": _BOX,
    "acceleration": _BOX,
    "jerk": _BOX,
    "max_speed": _NORM,
    "max_acceleration": _NORM,
    "max_thrust": _NORM,
    "max_tilt": _NORM,
    "max_jerk": _NORM,
    "waypoints": "tangent planes of the ball of positions at the waypoint's time",
    "obstacles": "half-spaces around a reference (`Problem.linearized`)",
    "moving obstacles": "half-spaces where the obstacle is at the time",
    "late obstacles": "half-spaces in windows from when it is known",
    "active obstacles": "half-spaces in the interval of time only",
    "separation": "half-spaces of pairs around a reference (`Problem.linearized`)",
    "disturbance": "all rows tightened by the radius of the errors",
}
"""How every kind of requirement is planned for."""
