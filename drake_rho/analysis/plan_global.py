"""`plan_global`: a plan with a proof of how far it is from the global optimum."""

from __future__ import annotations

import dataclasses
from concurrent.futures import Executor

from drake_rho.analysis.certificate import Certificate
from drake_rho.analysis.certify import certified, check_gap
from drake_rho.motion.plan import Plan
from drake_rho.planning.call.progress import Progress
from drake_rho.planning.call.time_limit import with_time_limit
from drake_rho.planning.planners.plan import plan
from drake_rho.planning.programs.backend import Solver, SolverName
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.described import Described
from drake_rho.scenario.records import Scenario
from drake_rho.system.threads import single_threaded_blas


@dataclasses.dataclass(frozen=True)
class GlobalPlan(metaclass=Described):
    """Plan with the certificate of its cost; prints as the certificate."""

    plan: Plan
    """best plan that was found"""
    certificate: Certificate
    """lower bound on the cost of every plan, and the plan's gap to it"""

    def __str__(self) -> str:
        return str(self.certificate)


@checked
@with_time_limit
@single_threaded_blas
def plan_global(
    scenario: Scenario,
    *,
    gap: float = 0.01,
    solver: Solver | SolverName | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    time_limit: float | None = None,
) -> GlobalPlan:
    """Return a plan whose cost is proved to be within a gap of the least cost of all plans.

    It begins with the plan of `plan` and the bound of `certify`. Motions are then divided by the
    sides of obstacles and of other vehicles on which vehicles are at chosen instants. Each part has
    a bound of its own, the part with the least bound is divided next, and plans on the way replace
    the best one. At a time limit, the certificate says how far the bound came.

    Args:
        scenario: the problem to solve.
        gap: relative gap (cost - lower bound) / cost at which the search ends, above 0, below 1.
        solver: `"clarabel"`, `"daqp"` or `"osqp"`, or a Drake solver; Clarabel if not given.
        executor: any PEP 3148 executor that works on the branches. The result does not depend on
            the number of workers, unless time is up.
        progress: called with a short description of the current step.
        time_limit: seconds, above 0, after which the best plan and bound so far are returned.

    Raises:
        InfeasibleError: no plan was found.
        OutOfTimeError: time was up before there was a plan.
        SolverError: the solvers fail numerically.
        ValueError: the gap is not above 0 and below 1.

    Examples:
        >>> best = rho.plan_global(rho.load_scenario("paper"))
        >>> best.certificate.gap < 0.01
        True
    """
    check_gap(gap)
    first = plan(scenario, solver=solver, progress=progress)
    certificate, best = certified(
        first, gap=gap, solver=solver, executor=executor, progress=progress, of_best=True
    )
    return GlobalPlan(best, certificate)
