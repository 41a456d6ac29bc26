"""Table of the planners' treatment of each requirement kind."""

from __future__ import annotations

from drake_rho.scenario.kinds import BOXES
from drake_rho.scenario.norms import NORMS

TREATMENT: dict[str, str] = {
    "dynamics": "states are affine in the accelerations, which are the unknowns",
    "goals": "equalities of the accelerations, satisfied throughout the space of programs",
    **dict.fromkeys(BOXES, "rows of the sides that a motion exceeds"),
    **dict.fromkeys(NORMS, "tangent planes where a motion is outside, or cones"),
    "waypoints": "tangent planes of the ball of positions at the waypoint's time",
    "requirements": "supporting half-spaces of the set; of two vehicles about their difference",
    "obstacles": "half-spaces around a reference (`Problem.linearized`)",
    "moving obstacles": "half-spaces at the obstacle's position at the time",
    "late obstacles": "half-spaces in the windows in which the obstacle is known",
    "active obstacles": "half-spaces within the active interval only",
    "uncertain obstacles": "half-spaces at a distance that grows with time",
    "separation": "half-spaces of pairs around a reference (`Problem.linearized`)",
    "disturbance": "all rows tightened by the radius of the error tube",
    "holding": "no rows: it depends on goals alone, which are checked before planning",
    "smoothing": "a margin of obstacles and pairs; rows of averages for waypoints and jerks",
}
"""Planners' treatment of every kind of requirement."""
