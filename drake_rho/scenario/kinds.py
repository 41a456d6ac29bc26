"""Kinds of requirements that scenarios have.

`tests/test_completeness.py` puts every kind through planners, windows, the verifier, certificates,
sensitivities, attacks, exports and figures. The verifier refuses a scenario unless it has checked
every kind.
"""

from __future__ import annotations

import dataclasses
from typing import get_args

from drake_rho.scenario.limits import Limits
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario

BOXES: tuple[Quantity, ...] = get_args(Quantity)
"""Kinds that are boxes of a quantity."""

LIMITS: tuple[str, ...] = tuple(field.name for field in dataclasses.fields(Limits))
"""Kinds that are fields of `Limits`."""

KINDS: tuple[str, ...] = (
    "dynamics",
    "goals",
    *LIMITS,
    "waypoints",
    "requirements",
    "obstacles",
    "moving obstacles",
    "late obstacles",
    "active obstacles",
    "uncertain obstacles",
    "separation",
    "disturbance",
    "holding",
    "smoothing",
)
"""All kinds. Moving, late, temporarily active and uncertain obstacles are obstacles too."""


def kinds_of(scenario: Scenario) -> set[str]:
    """Return the kinds of requirements that a scenario has."""
    fleet, bodies = scenario.fleet, scenario.bodies
    has = {
        "waypoints": bool(fleet.waypoints),
        "requirements": any(not each.is_goal for each in scenario.required),
        "obstacles": bool(bodies),
        "moving obstacles": any(each.moves for each in bodies),
        "late obstacles": any(each.known_from > 0.0 for each in bodies),
        "active obstacles": any(each.active is not None for each in bodies),
        "uncertain obstacles": any(each.is_uncertain for each in bodies),
        "separation": scenario.separation is not None and len(scenario.vehicles) > 1,
        "disturbance": scenario.disturbance is not None,
        "holding": scenario.hold_at_goal is True,
        "smoothing": scenario.smoothing is not None,
    }
    given = [scenario.limits, *(each.limits for each in scenario.vehicles if each.limits)]
    limits = {kind for each in given for kind in LIMITS if getattr(each, kind) is not None}
    return {"dynamics", "goals", *limits, *(kind for kind in has if has[kind])}
