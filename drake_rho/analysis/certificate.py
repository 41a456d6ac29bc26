"""`certify`: lower bound on the cost of every plan, and the gap of a given plan to it.

The bound is the minimum of a Lagrangian (`drake_rho.analysis.lagrangian`), computed in closed form
less a bound on rounding errors. So it does not depend on any solver's tolerance: solvers only
propose the multipliers. A constraint that is left out only lowers the bound. So a bound computed
with some instants of an obstacle is valid for plans that avoid it at every instant.

The bound is valid for plans that satisfy their constraints exactly. A plan may violate them by the
verifier's tolerance, a millionth, and then cost less than the bound by about as much.

With a disturbance the bound is valid for every plan that satisfies its tightened constraints as
`verify` checks them. Planners tighten a little more: they use the greatest error radius of a step
throughout the step. A second bound is valid for plans with these margins, which separates what the
plan may have missed from what the margins cost.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np

from drake_rho.analysis.lagrangian import Lagrangian
from drake_rho.motion.plan import Flight, Plan
from drake_rho.planning.call.options import ALONE
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.call.time_limit import check_time, seconds_left, with_time_limit
from drake_rho.planning.constraints.separation import coupled
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.planners.plan import plan_scp
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend, Solver, SolverName
from drake_rho.planning.scp.cutting_planes import CuttingPlanes
from drake_rho.planning.scp.sequential_convex import sequential_convex
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Scenario
from drake_rho.verification.verify import verify

GLOBAL_GAP = 1e-6
"""Relative gap up to which a plan counts as globally optimal."""

MOST_CERTIFIED_TOGETHER = 25
"""Largest number of vehicles for which the bound includes the separation of pairs; for larger
fleets it leaves it out."""

_MAX_POLISHINGS = 30
"""Largest number of linearisations that bring a fleet's plan to a certificate's precision."""

_SHOWN = 3
"""Largest number of obstacles left out of the bound that a printed certificate names."""

_MAX_ROWS = 20
"""Largest number of vehicles that a printed certificate shows: those with the largest gaps."""

TREATMENT = {
    "dynamics": "exact in the Lagrangian, whose unknowns are accelerations",
    "goals": "equalities of the Lagrangian",
    "position": "multipliers of its rows, which hold for every plan",
    "velocity": "multipliers of its rows, which hold for every plan",
    "acceleration": "multipliers of its rows, which hold for every plan",
    "jerk": "multipliers of its rows, which hold for every plan",
    "max_speed": "multipliers of its rows, which hold for every plan",
    "max_acceleration": "multipliers of its rows, which hold for every plan",
    "max_thrust": "multipliers of its rows, which hold for every plan",
    "max_tilt": "multipliers of its rows, which hold for every plan",
    "max_jerk": "multipliers of its rows, which hold for every plan",
    "waypoints": "multipliers of its rows, which hold for every plan",
    "obstacles": "quadratics of balls and ellipsoids inside; others are left out (`not_counted`)",
    "moving obstacles": "as obstacles, where they are at the time",
    "late obstacles": "as obstacles, where they are known at the start",
    "active obstacles": "as obstacles, at instants of the interval",
    "separation": "quadratics of the separation's ellipsoid; left out in large fleets",
    "disturbance": "a bound for the plan's margins, and one without them",
}
"""What counts in the lower bound, of every kind of requirement."""

_CONVERGED = 1e-8
"""Relative gap to a converged plan's cost at which a bound is not improved any more."""

_COLUMNS = (
    "gap: (cost - lower bound) / cost",
    "eigenvalue: least of the Lagrangian's Hessian; if above 0, a converged plan meets its bound",
)
"""Explanation of the columns, printed below the table."""


@dataclasses.dataclass(frozen=True)
class VehicleCertificate(metaclass=Described):
    """Certificate of one vehicle, or of a group of vehicles that separation constraints couple."""

    vehicle: str
    """name of the vehicle; for a group, the name of the first and the number of the others"""
    cost: float
    """part of the plan's cost that is due to this vehicle or group [m²/s⁴]"""
    lower_bound: float
    """lower bound on this part of the cost of every plan [m²/s⁴]"""
    least_eigenvalue: float
    """least eigenvalue of the Lagrangian's Hessian at the converged plan, restricted to changes
    that leave the final state unchanged. The cost alone has 2. If it is above 0, the bound equals
    the converged plan's cost"""
    stationarity: float
    """KKT residual: norm of the Lagrangian's gradient at the converged plan, relative to that of
    the cost's gradient"""
    complementarity: float
    """KKT residual: largest product of a multiplier and its constraint's violation, relative to the
    cost"""
    planned_bound: float | None = None
    """lower bound for plans that keep the planners' margins [m²/s⁴]; None without a disturbance,
    where there are no margins"""

    @property
    def gap(self) -> float:
        """Relative gap (cost - lower bound) / cost; negative if violated constraints save cost."""
        return _gap(self.cost, self.lower_bound)


@dataclasses.dataclass(frozen=True)
class Certificate(metaclass=Described):
    """Bound on how far a plan is from the optimum; prints as a short table."""

    scenario: Scenario
    """scenario of the plan"""
    vehicles: tuple[VehicleCertificate, ...]
    """one certificate for each vehicle or, where separation couples vehicles, for each group"""
    holds: bool
    """whether the plan satisfies its constraints; one that does not may cost less than the bound"""
    left_out: tuple[str, ...] = ()
    """obstacles that are active for the plan but left out of the bound, because they are neither
    balls nor ellipsoids; they may account for part of the gap"""
    cut: bool = False
    """whether time was up before the bound had converged"""

    @property
    def cost(self) -> float:
        """Cost of the plan [m²/s⁴], the performance index f (13)."""
        return sum(each.cost for each in self.vehicles)

    @property
    def lower_bound(self) -> float:
        """Lower bound on the cost of every plan of the scenario [m²/s⁴]."""
        return sum(each.lower_bound for each in self.vehicles)

    @property
    def gap(self) -> float:
        """Relative gap (cost - lower bound) / cost; negative if violated constraints save cost."""
        return _gap(self.cost, self.lower_bound)

    @property
    def planned_gap(self) -> float:
        """Relative gap to the lower bound for plans that keep the planners' margins.

        This is what the planner may have missed; the rest of `gap` is what its margins may cost.
        """
        known = [each.planned_bound for each in self.vehicles]
        bounds = [bound for bound in known if bound is not None]
        return _gap(self.cost, sum(bounds)) if bounds else self.gap

    @property
    def is_globally_optimal(self) -> bool:
        """True if the plan satisfies its constraints and its gap is at most `GLOBAL_GAP`."""
        return self.holds and abs(self.gap) <= GLOBAL_GAP

    @property
    def least_eigenvalue(self) -> float:
        """Least of the vehicles' eigenvalues."""
        return min(each.least_eigenvalue for each in self.vehicles)

    def _above_bound(self) -> str:
        if not self.lower_bound > 0.0:
            return ""
        percent = 100.0 * (self.cost / self.lower_bound - 1.0)
        return f"{abs(percent):.3g} % {'below' if percent < 0.0 else 'above'} the "

    def _planned_gap(self) -> str:
        if self.scenario.disturbance is None:
            return ""
        return f" ({self.planned_gap:.1e} with the margins that planners keep)"

    def _left_out(self) -> str:
        if not self.left_out:
            return ""
        shown = ", ".join(self.left_out[:_SHOWN])
        more = f" and {len(self.left_out) - _SHOWN} more" if len(self.left_out) > _SHOWN else ""
        return f"; the bound leaves out {shown}{more}"

    def __str__(self) -> str:
        verdict = "globally optimal" if self.is_globally_optimal else "not proved optimal"
        verdict = verdict if self.holds else "violates its constraints"
        verdict = (
            f"{verdict} (time was up)" if self.cut and not self.is_globally_optimal else verdict
        )
        lines = [
            f"{self.scenario.name}: {verdict}; cost {self.cost:.6f} m²/s⁴, {self._above_bound()}"
            f"lower bound {self.lower_bound:.6f}; gap {self.gap:.1e} of the cost"
            f"{self._planned_gap()}{self._left_out()}",
            f"{'vehicle':<12} {'cost':>14} {'lower bound':>14} {'gap':>9} {'eigenvalue':>11}",
        ]
        shown = self.vehicles
        if len(shown) > _MAX_ROWS:
            shown = tuple(sorted(shown, key=lambda each: each.lower_bound - each.cost)[:_MAX_ROWS])
        lines += [
            f"{each.vehicle:<12} {each.cost:>14.6f} {each.lower_bound:>14.6f} {each.gap:>9.1e} "
            f"{each.least_eigenvalue:>11.4f}"
            for each in shown
        ]
        more = len(self.vehicles) - len(shown)
        rest = [f"… and {more} more, with smaller gaps"] if more else []
        return "\n".join([*lines, *rest, *_COLUMNS])


@checked
@with_time_limit
def certify(
    flown: Plan | Flight,
    *,
    solver: Solver | SolverName | None = None,
    progress: Progress | None = None,
    time_limit: float | None = None,
) -> Certificate:
    """Compute a lower bound on the cost of every plan of a scenario, and the gap of this plan.

    The multipliers come from plans iterated to convergence, from this plan and from the one
    without obstacles. Where the Lagrangian is not convex there, the multipliers are scaled down and
    the bound is then maximised over them. The bound is valid for any multipliers.

    Args:
        flown: any plan or flight of a scenario; it need not be optimal or satisfy its constraints.
            A flight whose windows begin with thinner tubes than a plan has by then may cost less
            than any plan.
        solver: `"clarabel"`, `"daqp"` or `"osqp"`, or a Drake solver; Clarabel if not given.
        progress: called with a short description of the current step, as after each linearisation.
        time_limit: seconds, above 0, after which the best bound so far is returned (`cut`): at
            least that of the minimum-effort motions.

    Raises:
        InfeasibleError: no plan was found from which to take multipliers.
        SolverError: the solvers fail numerically.

    Examples:
        >>> certificate = rho.certify(rho.plan(rho.load_scenario("paper")))
        >>> certificate.is_globally_optimal
        True
    """
    backend = Backend.of(solver)
    plan = flown.plan
    scenario, vehicles = plan.scenario, len(plan.scenario.vehicles)
    if vehicles > MOST_CERTIFIED_TOGETHER:  # without separation the bound is lower, but still valid
        scenario = scenario.without_separation()
    start = Plan.from_accelerations(scenario, plan.accelerations)
    cut, proposals = False, list[CuttingPlanes]()
    try:
        for each in _converged(start, backend.solver, progress):
            proposals.append(_solved_around(each, backend, progress))
    except OutOfTimeError:
        cut = True
    efforts = np.sum(Problem.of(scenario).effort.motion.accelerations ** 2, axis=(1, 2))
    certificates, left_out = [], set[str]()
    disturbed = scenario.disturbance is not None
    groups = _groups(vehicles, proposals)
    for number, group in enumerate(groups, start=1):
        name = scenario.vehicles[group[0]].name
        name = name if len(group) == 1 else f"{name} and {len(group) - 1} more"
        tell(progress, f"bounding the cost of {name} ({number} of {len(groups)})")
        if not proposals:
            certificates.append(_by_effort(name, plan, efforts, group))
            continue
        lagrangians = [Lagrangian(solved, group) for solved in proposals]
        bounds = planned = [each.unit**2 * _best_bound(each) for each in lagrangians]
        if disturbed:
            looser = [Lagrangian(solved, group, as_planned=False) for solved in proposals]
            bounds = [each.unit**2 * _best_bound(each) for each in looser]
        here = lagrangians[0]
        left_out |= set[str]().union(*(each.left_out for each in lagrangians))
        stationarity, complementarity = here.kkt_residuals()
        certificates.append(
            VehicleCertificate(
                vehicle=name,
                cost=float(np.sum(plan.accelerations[group] ** 2)),
                lower_bound=max(0.0, *bounds),
                least_eigenvalue=2.0 * here.curvature(here.weights),
                stationarity=stationarity,
                complementarity=complementarity,
                planned_bound=max(0.0, *planned) if disturbed else None,
            )
        )
    names = [scenario.obstacle_name(number) for number, _ in scenario.known]
    not_counted = tuple(name for name in names if name in left_out)
    cut = cut or seconds_left() <= 0.0
    return Certificate(plan.scenario, tuple(certificates), verify(flown).ok, not_counted, cut)


def _by_effort(name: str, plan: Plan, efforts: FloatArray, group: IntArray) -> VehicleCertificate:
    """Return the certificate of a group from its minimum effort alone, without multipliers."""
    bound = float(np.sum(efforts[group])) * (1.0 - _CONVERGED)
    return VehicleCertificate(
        vehicle=name,
        cost=float(np.sum(plan.accelerations[group] ** 2)),
        lower_bound=bound,
        least_eigenvalue=2.0,
        stationarity=1.0,
        complementarity=0.0,
        planned_bound=bound if plan.scenario.disturbance is not None else None,
    )


def _converged(plan: Plan, solver: Solver | None, progress: Progress | None) -> Iterator[Plan]:
    """Yield plans iterated to convergence: from this one, if possible, and without a reference."""
    found = False
    with suppress(InfeasibleError, SolverError):  # this may fail from a plan with violations
        yield plan_scp(plan.scenario, reference=plan, solver=solver, progress=progress)
        found = True
    try:
        other = plan_scp(plan.scenario, solver=solver, progress=progress)
    except (InfeasibleError, SolverError):
        if not found:
            raise
    else:
        yield other


def _solved_around(plan: Plan, backend: Backend, progress: Progress | None) -> CuttingPlanes:
    """Return the programs around a plan iterated on to the precision that a certificate needs.

    If they are infeasible, margins on a finer partition of the steps are used, where there are any:
    the plan may satisfy its constraints with these only.
    """
    problem = Problem.of(plan.scenario)
    try:
        return _solved(problem, plan, backend, progress)
    except InfeasibleError:
        if (finer := problem.with_finer_margins()) is None:
            raise
        return _solved(finer, plan, backend, progress)


def _solved(
    problem: Problem, plan: Plan, backend: Backend, progress: Progress | None
) -> CuttingPlanes:
    """Return the programs around a plan with the margins that a problem has."""
    subproblem = Subproblem(problem, coupled, backend)
    everyone = np.zeros(len(problem), dtype=int)  # the multipliers of all are wanted
    sequential_convex(
        subproblem, plan, ALONE, labels=everyone, most=_MAX_POLISHINGS, progress=progress
    )
    if subproblem.planes is None:
        subproblem.around(plan)  # raises the error that ended the iteration
    assert subproblem.planes is not None  # noqa: S101  # solved above
    return subproblem.planes


def _groups(vehicles: int, proposals: Sequence[CuttingPlanes]) -> list[IntArray]:
    """Return groups of vehicles: those that share a program in one of the proposals."""
    label = np.arange(vehicles)
    for solved in proposals:
        for vehicle in range(vehicles):
            met = np.unique(label[solved.working.group(vehicle)])
            label[np.isin(label, met)] = met[0]
    return [np.flatnonzero(label == each) for each in np.unique(label)]


def _gap(cost: float, lower_bound: float) -> float:
    largest = max(cost, lower_bound)
    return (cost - lower_bound) / (cost or largest) if largest > 0.0 else 0.0


def _best_bound(lagrangian: Lagrangian) -> float:
    """Return the largest minimum of the Lagrangian that is found, in the Lagrangian's unit.

    The multipliers of the converged program are tried first; if the Lagrangian is convex there,
    they are optimal. Else the obstacles' multipliers are scaled down until it is convex. Then the
    minimum, a concave function of the multipliers whose gradient consists of the constraints'
    violations, is maximised.
    """
    weights, multipliers = lagrangian.weights, lagrangian.multipliers
    first = lagrangian.minimum(weights, multipliers)
    index = float(np.sum(lagrangian.solution**2))
    if first.value >= index * (1 - _CONVERGED) or len(weights) + len(multipliers) == 0:
        return first.value
    loss = 1.0 - lagrangian.curvature(weights)  # proportional to the weights
    scaled = weights * min(1.0, 0.98 / loss if loss > 0.0 else 1.0)
    return max(first.value, _climb(lagrangian, scaled, multipliers))


def _climb(lagrangian: Lagrangian, weights: FloatArray, multipliers: FloatArray) -> float:
    """Maximise the Lagrangian's minimum over λ, y >= 0, from multipliers for which it is convex."""
    from scipy.optimize import minimize  # imported here because it is slow to load

    start = np.concatenate([weights, multipliers])
    sizes = np.maximum(start, 1e-3 * start.max())
    best = -np.inf

    def descend(x: FloatArray) -> tuple[float, FloatArray]:
        nonlocal best
        check_time()
        given = np.maximum(x, 0.0) * sizes
        found = lagrangian.minimum(given[: len(weights)], given[len(weights) :])
        if not np.isfinite(found.value):
            return 1e3 * scale, np.zeros_like(x)
        best = max(best, found.value)
        return -found.value, -np.concatenate(lagrangian.slopes(found.at)) * sizes

    scale = float(np.sum(lagrangian.solution**2)) + 1.0
    with suppress(OutOfTimeError):
        minimize(
            descend,
            start / sizes,
            jac=True,
            method="L-BFGS-B",
            bounds=[(0.0, None)] * len(start),
            options={"maxiter": 300},
        )
    return best
