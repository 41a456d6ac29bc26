"""The least duration by bisection over durations that are planned for, as one does by hand."""

from __future__ import annotations

import dataclasses

import drake_rho as rho

PRECISION = 1e-2
"""Relative precision, that of `shortest_plan` for fleets while it bisected."""

_LONGEST = 2.0**6
"""Largest factor on the scenario's duration that is tried."""


def bisected(scenario: rho.Scenario, limit: float | None = None) -> rho.Plan:
    """Return the plan of the least duration that bisection finds, with the same knots.

    Args:
        scenario: whose obstacles do not move.
        limit: time limit of each trial [s].

    Raises:
        InfeasibleError: no duration tried has a plan.
    """
    options = rho.Options(time_limit=limit)

    def plan(factor: float) -> rho.Plan | None:
        grid = dataclasses.replace(scenario.grid, step=factor * scenario.grid.step)
        try:
            return rho.plan(scenario.on_grid(grid), options=options)
        except (rho.InfeasibleError, rho.OutOfTimeError, rho.SolverError, rho.ScenarioError):
            return None

    least, found = 1.0, plan(1.0)
    while found is None and least < _LONGEST:
        least *= 2.0
        found = plan(least)
    if found is None:
        return rho.plan(scenario, options=options)  # raises the reason
    without = least / 2.0
    while least <= 1.0 and (shorter := plan(without)) is not None:
        found, least, without = shorter, without, without / 2.0
    while least - without > PRECISION * least:
        middle = (least + without) / 2.0
        trial = plan(middle)
        if trial is None:
            without = middle
        else:
            found, least = trial, middle
    return found
