"""Interfaces of the functions that plan windows, and of their references."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Protocol

from drake_rho.motion.plan import Plan
from drake_rho.planning.call.options import Options
from drake_rho.planning.planners.convex import plan_convex
from drake_rho.planning.planners.plan import plan, plan_scp
from drake_rho.planning.programs.backend import Solver
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.records import Scenario


class Planner(Protocol):
    """Interface of planners for `plan_rho`: `plan_convex`, `plan_scp`, or another function."""

    def __call__(
        self, scenario: Scenario, *, reference: Plan | None, solver: Solver | None
    ) -> Plan:
        """Return a plan for `scenario`, found from `reference`."""
        ...


Reference = Callable[[Scenario, Plan | None, Solver | None], Plan | None]
"""Function that returns the reference of a window, the motion around which it is linearised.

Its arguments are the window's scenario, the rest of the previous prediction (None in the first
window) and the solver. It returns a motion of the same vehicles on the same grid, or None for the
planners' own reference."""


@checked
def free_reference(scenario: Scenario, remaining: Plan | None, solver: Solver | None) -> None:
    """Return None, for the paper's reference: each window's own solution without the obstacles.

    Planners use this reference if they are given none.
    """


@checked
def tail_reference(
    scenario: Scenario, remaining: Plan | None, solver: Solver | None
) -> Plan | None:
    """Return the rest of the previous prediction; in the first window, the paper's reference.

    It satisfies every constraint of the window, so there is always a plan, up to rounding.
    """
    return remaining


def with_options(options: Options, planner: Planner) -> Planner:
    """Return a planner with options, if it is one of this package's.

    The time limit is omitted, since it applies to the whole flight or step.
    """
    if planner not in (plan, plan_scp, plan_convex):
        return planner
    ours: Planner = partial(planner, options=dataclasses.replace(options, time_limit=None))
    return ours
