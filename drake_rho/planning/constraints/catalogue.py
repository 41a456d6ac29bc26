"""Constraints of a scenario, and a table of the planners' treatment of each requirement kind."""

from __future__ import annotations

import sys

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import Constraint
from drake_rho.planning.constraints.boxes import boxes_of
from drake_rho.planning.constraints.convex_obstacles import KeepOutOfShape
from drake_rho.planning.constraints.keep_out import EvaluationPoints
from drake_rho.planning.constraints.limits import norms_of, requirements_of, waypoints_of
from drake_rho.planning.constraints.maps import KeepOutOfMap
from drake_rho.planning.constraints.margins import PlanMargins
from drake_rho.planning.constraints.obstacles import KeepOutOfObstacle
from drake_rho.scenario.maps.parts import Parts
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.shapes.base import Solid


def convex_constraints(scenario: Scenario, margins: PlanMargins) -> list[Constraint]:
    """Return the convex constraints, which need no reference: from boxes to requirements."""
    return [
        *boxes_of(scenario, margins),
        *norms_of(scenario, margins),
        *waypoints_of(scenario, margins),
        *requirements_of(scenario, margins),
    ]


def obstacles_of(
    scenario: Scenario, margins: PlanMargins, reference: Motion
) -> list[KeepOutOfObstacle]:
    """Return constraints of the obstacles known at the start, linearised (15) around a motion."""
    known = scenario.avoided
    if not known:
        return []
    reference = reference.subdivided(margins.pieces)
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
                obstacle_number=number,
                active=obstacle.active,
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
                pieces=margins.pieces,
                tolerances=scenario.fleet.obstacle_tolerances(obstacle.shape),
            )
        )
    return constraints
