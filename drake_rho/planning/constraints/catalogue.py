"""The one list of what vehicles keep in, whatever the reference."""

from __future__ import annotations

from drake_rho.planning.constraints.base import Constraint
from drake_rho.planning.constraints.boxes import boxes_of
from drake_rho.planning.constraints.margins import PlanMargins
from drake_rho.planning.constraints.norms import norms_of
from drake_rho.planning.constraints.waypoints import waypoints_of
from drake_rho.scenario.records import Scenario


def convex_constraints(scenario: Scenario, margins: PlanMargins) -> list[Constraint]:
    """What holds whatever the reference: keep-in constraints."""
    return [
        *boxes_of(scenario, margins),
        *norms_of(scenario, margins),
        *waypoints_of(scenario, margins),
    ]
