"""Largest wind for which a scenario has a plan, where the wind is why it has none."""

from __future__ import annotations

import dataclasses
from functools import partial

from drake_rho.analysis.trials import Trials, boundary, precision_of
from drake_rho.planning.call.work_limit import within_work, work_left
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.planners.first_plan import first_plan
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.scenario.records import Scenario


def undisturbed(error: InfeasibleError, scenario: Scenario, backend: Backend) -> InfeasibleError:
    """Return the error without the disturbance, if any, since it is more informative."""
    try:
        with within_work(work_left() / 2.0):
            first_plan(Problem.of(scenario.with_disturbance(None)), backend=backend)
    except InfeasibleError as other:
        return other
    except (SolverError, OutOfTimeError):
        pass
    return error


def has_plan_in_calm(scenario: Scenario, trials: Trials) -> bool:
    """Return whether a plan is found without the disturbance, for a scenario with one."""
    if scenario.disturbance is None:
        return False
    return trials.has_plan(lambda: dataclasses.replace(scenario, disturbance=None), "no wind")


def largest_tolerable_wind(scenario: Scenario, trials: Trials) -> float | None:
    """Return the largest wind with a plan [m/s²], for a scenario with a plan in calm.

    None if it is not known whether there is a plan with the errors of estimates alone.
    """
    disturbance = scenario.disturbance
    assert disturbance is not None  # noqa: S101  # there is a plan in calm only

    def tolerates(factor: float, near: bool = False) -> bool:
        weaker = dataclasses.replace(disturbance, acceleration=factor * disturbance.acceleration)
        words = f"wind up to {weaker.acceleration:.4g} m/s²"
        make = partial(dataclasses.replace, scenario, disturbance=weaker)
        return trials.has_plan(make, words, near=near)

    before = trials.unfinished
    if disturbance.acceleration == 0.0 or not tolerates(0.0):
        return 0.0 if trials.unfinished == before else None
    return boundary(tolerates, 0.0, 1.0, precision_of(scenario)) * disturbance.acceleration
