"""Plan that is flown while its successor is sought, as a hint for planners.

It is a context variable, visible to all functions within a call without an argument, as deadlines
are (`time_limit`), so that planners of windows need no further one. A planner may look at it to
choose the rows with which programs begin, never for what it requires of a plan.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan
from drake_rho.scenario.records import Scenario

_PLAN: ContextVar[Plan | None] = ContextVar("_PLAN", default=None)


@contextmanager
def in_force(plan: Plan | None) -> Iterator[None]:
    """Let a plan be in force within the block.

    Args:
        plan: the rest of it, from the first knot of the plans that are sought; None for none.
    """
    before = _PLAN.set(plan)
    try:
        yield
    finally:
        _PLAN.reset(before)


def motion_in_force(scenario: Scenario) -> Motion | None:
    """Return the motion of the plan in force, for constraints between the knots of a scenario.

    It is None without such constraints, and if the plan has other vehicles or another grid.
    """
    plan = _PLAN.get()
    if plan is None or not scenario.between_knots or plan.scenario.grid != scenario.grid:
        return None
    return plan.motion() if plan.scenario.names == scenario.names else None
