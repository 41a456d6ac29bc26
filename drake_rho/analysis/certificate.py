"""`certify`: how far a plan is above the best one there is, by a lower bound that needs no trust.

The bound is the minimum of a Lagrangian (`drake_rho.analysis.lagrangian`), computed in closed form
with what rounding may lose taken off, so it does not lean on any solver's tolerance: solvers only
propose the multipliers. A constraint that is left out only lowers it, so a bound found with some
instants of an obstacle holds for plans that keep out of it at every instant.

The bound is one for plans that keep their constraints exactly. A plan may break them by the
verifier's tolerance, a millionth, and then cost less than the bound by as little.

Of a disturbed scenario it is one for all plans that bear the disturbance, as `verify` judges them.
Planners keep a little more, the greatest radius of errors of a step in all of the step; a second
bound is for plans that do, so that it can be told what the plan and what the margins cost.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np

from drake_rho.analysis.lagrangian import Lagrangian
from drake_rho.motion.plan import Flight, Plan
from drake_rho.planning.constraints.separation import coupled
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.options import ALONE
from drake_rho.planning.planners.plan import plan_scp
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend, Solver, SolverName
from drake_rho.planning.progress import Progress, tell
from drake_rho.planning.scp.cutting_planes import CuttingPlanes
from drake_rho.planning.scp.sequential_convex import sequential_convex
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.planning.time_limit import check_time, seconds_left, with_time_limit
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Scenario
from drake_rho.verification.verify import verify

GLOBAL_GAP = 1e-6
"""Relative gap up to which a plan counts as globally optimal."""

MOST_CERTIFIED_TOGETHER = 25
"""Vehicles up to which pairs count for the bound; for larger fleets it is that without them."""

_MAX_POLISHINGS = 30
"""Bound on the linearisations with which a fleet's plan is brought to a certificate's precision."""

_SHOWN = 3
"""Obstacles without a part in the bound that are named where a certificate is printed."""

_MOST_ROWS = 20
"""Vehicles that a printed certificate shows; of more, those with most to gain."""

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

_ENOUGH = 1e-8
"""Relative distance from a converged plan's cost at which a bound is not improved any more."""


@dataclasses.dataclass(frozen=True)
class VehicleCertificate(metaclass=Described):
    """What is known of the part of a plan that one vehicle has, or several that pairs couple."""

    vehicle: str
    """name; where pairs couple vehicles, that of the first and how many more"""
    cost: float
    """its part of the cost [m²/s⁴]"""
    lower_bound: float
    """no plan of this vehicle can cost less [m²/s⁴]"""
    least_eigenvalue: float
    """of the Lagrangian's Hessian at the converged plan, on the motions that leave the goal where
    it is; 2 is that of the cost alone; above 0, the bound meets the converged plan's cost"""
    stationarity: float
    """KKT: norm of the Lagrangian's gradient at the converged plan, over that of the cost's"""
    complementarity: float
    """KKT: the largest product of a multiplier and its constraint's breach, over the cost"""
    planned_bound: float | None = None
    """no plan of this vehicle that keeps planners' margins can cost less [m²/s⁴]; None where
    nothing disturbs, as there are no margins then"""

    @property
    def gap(self) -> float:
        """(cost - lower bound) / cost; negative for a plan that breaks its constraints to save."""
        return _gap(self.cost, self.lower_bound)


@dataclasses.dataclass(frozen=True)
class Certificate(metaclass=Described):
    """How far a plan is above the optimum; prints as a short table."""

    scenario: Scenario
    """what was asked"""
    vehicles: tuple[VehicleCertificate, ...]
    """one for each vehicle or, where pairs couple them, for all"""
    holds: bool
    """whether the plan meets its constraints; what breaks them may cost less than the bound"""
    left_out: tuple[str, ...] = ()
    """obstacles that the plan leans on and the bound does not count, so that the gap is not only
    the plan's: those that are neither balls nor ellipsoids"""
    cut: bool = False
    """whether time was up before the bound was as good as it can be made"""

    @property
    def cost(self) -> float:
        """The plan's cost [m²/s⁴], the performance index f (13)."""
        return sum(each.cost for each in self.vehicles)

    @property
    def lower_bound(self) -> float:
        """No plan of the scenario can cost less [m²/s⁴]."""
        return sum(each.lower_bound for each in self.vehicles)

    @property
    def gap(self) -> float:
        """(cost - lower bound) / cost; negative for a plan that breaks its constraints to save."""
        return _gap(self.cost, self.lower_bound)

    @property
    def planned_gap(self) -> float:
        """(cost - bound) / cost with the bound of plans that keep planners' margins.

        What the planner may have missed; the rest of `gap` is what its margins may cost.
        """
        known = [each.planned_bound for each in self.vehicles]
        bounds = [bound for bound in known if bound is not None]
        return _gap(self.cost, sum(bounds)) if bounds else self.gap

    @property
    def is_globally_optimal(self) -> bool:
        """Whether the plan holds and its gap is at most `GLOBAL_GAP`."""
        return self.holds and abs(self.gap) <= GLOBAL_GAP

    @property
    def least_eigenvalue(self) -> float:
        """The least of the vehicles'."""
        return min(each.least_eigenvalue for each in self.vehicles)

    def _as_planned(self) -> str:
        if self.scenario.disturbance is None:
            return ""
        return f" ({self.planned_gap:.1e} with the margins that planners keep)"

    def _without(self) -> str:
        if not self.left_out:
            return ""
        shown = ", ".join(self.left_out[:_SHOWN])
        more = f" and {len(self.left_out) - _SHOWN} more" if len(self.left_out) > _SHOWN else ""
        return f"; the bound does not count {shown}{more}"

    def __str__(self) -> str:
        verdict = "globally optimal" if self.is_globally_optimal else "not proved optimal"
        verdict = verdict if self.holds else "breaks its constraints"
        verdict = (
            f"{verdict} (time was up)" if self.cut and not self.is_globally_optimal else verdict
        )
        lines = [
            f"{self.scenario.name}: {verdict}; cost {self.cost:.6f}, no plan below "
            f"{self.lower_bound:.6f} m²/s⁴, gap {self.gap:.1e}"
            f"{self._as_planned()}{self._without()}",
            f"{'vehicle':<12} {'cost':>14} {'lower bound':>14} {'gap':>9} {'eigenvalue':>11}",
        ]
        shown = self.vehicles
        if len(shown) > _MOST_ROWS:
            shown = tuple(sorted(shown, key=lambda each: each.lower_bound - each.cost)[:_MOST_ROWS])
        lines += [
            f"{each.vehicle:<12} {each.cost:>14.6f} {each.lower_bound:>14.6f} {each.gap:>9.1e} "
            f"{each.least_eigenvalue:>11.4f}"
            for each in shown
        ]
        more = len(self.vehicles) - len(shown)
        return "\n".join([*lines, *([f"… and {more} more, with less to gain"] if more else [])])


@checked
@with_time_limit
def certify(
    flown: Plan | Flight,
    *,
    solver: Solver | SolverName | None = None,
    progress: Progress | None = None,
    time_limit: float | None = None,
) -> Certificate:
    """Bound from below what any plan of the scenario costs, and compare.

    The multipliers come from plans iterated to convergence, from this one and from the plan
    without obstacles; where the Lagrangian is not convex there, they are scaled down and the bound
    is then maximised over them. Whatever multipliers are used, the bound is one.

    Args:
        flown: any plan or flight of a scenario; it need not be optimal, nor hold. A flight whose
            windows begin with thinner tubes than a plan has by then may cost less than any plan.
        solver: `"clarabel"`, `"daqp"` or `"osqp"`, or a Drake solver; Clarabel if not given.
        progress: called with a few words on what is being done, as after each linearisation.
        time_limit: seconds, above 0, after which the bound so far is returned (`cut`): at the least
            that of the motions of minimum effort.

    Raises:
        InfeasibleError: no plan was found to take multipliers from.
        SolverError: the solvers fail numerically.

    Examples:
        >>> certificate = rho.certify(rho.plan(rho.load_scenario("paper")))
        >>> certificate.is_globally_optimal
        True
    """
    backend = Backend.of(solver)
    plan = flown.plan if isinstance(flown, Flight) else flown
    scenario, vehicles = plan.scenario, len(plan.scenario.vehicles)
    if vehicles > MOST_CERTIFIED_TOGETHER:  # without pairs the bound is lower, and still one
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
    """Return the certificate of a group by minimum effort alone: with no multipliers at all."""
    bound = float(np.sum(efforts[group])) * (1.0 - _ENOUGH)
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
    """Yield plans iterated to convergence: from this one, if it allows that, and from none."""
    found = False
    with suppress(InfeasibleError, SolverError):  # a plan that breaks its scenario may lead nowhere
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

    A plan that keeps finer margins only is one of these.
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
        subproblem.around(plan)  # raises what ended the iteration
    assert subproblem.planes is not None  # noqa: S101  # solved above
    return subproblem.planes


def _groups(vehicles: int, proposals: Sequence[CuttingPlanes]) -> list[IntArray]:
    """Vehicles that have a program together in one of the proposals, group by group."""
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
    """The largest minimum of the Lagrangian that is found, in its own unit.

    First with the multipliers of the converged program; where the Lagrangian is convex there they
    are the best. Else those of the obstacles are scaled down until it is, and the minimum, a
    concave function of the multipliers with the constraints' breaches as slopes, is maximised.
    """
    weights, multipliers = lagrangian.weights, lagrangian.multipliers
    first = lagrangian.minimum(weights, multipliers)
    index = float(np.sum(lagrangian.solution**2))
    if first.value >= index * (1 - _ENOUGH) or len(weights) + len(multipliers) == 0:
        return first.value
    bend = 1.0 - lagrangian.curvature(weights)  # grows in proportion to the weights
    scaled = weights * min(1.0, 0.98 / bend if bend > 0.0 else 1.0)
    return max(first.value, _climb(lagrangian, scaled, multipliers))


def _climb(lagrangian: Lagrangian, weights: FloatArray, multipliers: FloatArray) -> float:
    """Maximise the minimum over λ, y >= 0, from where the Lagrangian is convex."""
    from scipy.optimize import minimize  # slow to load, so only where needed

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
