"""Constraints of a scenario, and a table of the planners' treatment of each requirement kind."""

from __future__ import annotations

import sys

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.convex_obstacles import KeepOutOfShape
from drake_rho.planning.constraints.keep_out import EvaluationPoints
from drake_rho.planning.constraints.maps import KeepOutOfMap
from drake_rho.planning.constraints.margins import PlanMargins
from drake_rho.planning.constraints.obstacles import KeepOutOfObstacle
from drake_rho.scenario.kinds import BOXES
from drake_rho.scenario.maps.parts import Parts
from drake_rho.scenario.norms import NORMS
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.shapes.base import Solid


def obstacles_of(
    scenario: Scenario, margins: PlanMargins, reference: Motion
) -> list[KeepOutOfObstacle]:
    """Return constraints of the obstacles known at the start, linearised (15) around a motion."""
    known = scenario.avoided
    if not known:
        return []
    reference = reference.subdivided(margins.inner.pieces)
    inner_knots = EvaluationPoints.at_inner_knots(reference)
    constraints: list[KeepOutOfObstacle] = []
    for number, obstacle in known:
        shape: Solid = obstacle.shape
        kind = KeepOutOfMap if isinstance(shape, Parts) else KeepOutOfShape
        constraints.append(
            kind(
                shape=shape,  # type: ignore[arg-type]  # of that kind
                kind="obstacles",
                key=("obstacle", number),
                number=number,
                clock=scenario.grid.clock,
                name=scenario.obstacle_name(number),
                quantity="position",
                reference=reference,
                searches=sys.maxsize * scenario.between_knots,
                every_instant=scenario.between_knots,
                obstacle=obstacle,
                inner_knots=inner_knots,
                required=scenario.fleet.radii + obstacle.deviation,
                margins=margins.inner,
                tolerances=scenario.fleet.obstacle_tolerances(obstacle.shape),
            )
        )
    return constraints


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
