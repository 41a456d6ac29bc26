"""How the scenarios of a study are planned or flown."""

from __future__ import annotations

import dataclasses
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, JsonValue

from drake_rho.analysis.certificate import certify
from drake_rho.campaigns.blowing import AnyWind
from drake_rho.campaigns.functions import check_arguments, name_of, named
from drake_rho.campaigns.judgement import Judgement, judge
from drake_rho.motion.plan import Flight, Plan
from drake_rho.motion.simulation import Simulation
from drake_rho.planning.constraints.separation import CouplingName
from drake_rho.planning.horizon.receding_horizon import plan_rho
from drake_rho.planning.horizon.windows import free_reference, tail_reference
from drake_rho.planning.options import Options
from drake_rho.planning.planners.convex import plan_convex
from drake_rho.planning.planners.plan import plan as best_plan
from drake_rho.planning.programs.backend import SolverName
from drake_rho.scenario.fields import Count, Name, Positive, record
from drake_rho.scenario.records import Scenario
from drake_rho.simulation.closed_loop import fly
from drake_rho.simulation.simulate import simulate

Planned = Plan | Flight | Simulation
ReplanEvery = Annotated[Count, Field(ge=1)]

_REFERENCES = {"free": free_reference, "tail": tail_reference}
_WINDOWS: dict[str, tuple[Any, Any]] = {
    "auto": (plan_convex, best_plan),
    "convex": (plan_convex, None),
    "scp": (best_plan, None),
}


@dataclasses.dataclass(frozen=True)
class Found:
    """What a method found for one scenario."""

    planned: Planned
    """itself"""
    judgement: Judgement
    """how good it is"""
    seconds: float
    """what it took to plan or fly, before it was judged [s]"""
    verify_seconds: float
    """what it took to judge it [s]"""
    bound: float | None = None
    """no plan costs less [m²/s⁴]; None if it was not asked for"""


class Runs(ABC):
    """What every method can do."""

    name: str

    @abstractmethod
    def run(self, scenario: Scenario, rng: np.random.Generator) -> Found:
        """Plan or fly a scenario, with chance from a generator.

        Raises:
            InfeasibleError: there is no plan, or none was found.
            SolverError: the solvers fail numerically.
        """


@record
class ByPlan(Runs):
    """In one piece by `drake_rho.plan`, the best plan found."""

    name: Name
    """in tables and figures"""
    planner: Literal["plan"]
    """which function of this package"""
    coupling: CouplingName | None = None
    """how pairs are kept apart; by the size of the fleet if not given"""
    options: Options | None = None
    """tolerances and bounds"""
    solver: SolverName = "clarabel"
    """of the quadratic programs"""
    certify: bool = False
    """whether a lower bound of the cost is found too, which takes longer than the plan"""

    def run(self, scenario: Scenario, rng: np.random.Generator) -> Found:
        """Plan one scenario."""
        work = partial(best_plan, coupling=self.coupling, options=self.options)
        return _found(partial(work, scenario), self.solver, self.certify)


@record
class ByPlanConvex(Runs):
    """In one piece by `drake_rho.plan_convex`, the paper's convex method."""

    name: Name
    """in tables and figures"""
    planner: Literal["plan_convex"]
    """which function of this package"""
    steps: tuple[Positive, ...] = ()
    """further steps to try if there is no plan [s]"""
    solver: SolverName = "clarabel"
    """of the quadratic programs"""
    certify: bool = False
    """whether a lower bound of the cost is found too, which takes longer than the plan"""

    def run(self, scenario: Scenario, rng: np.random.Generator) -> Found:
        """Plan one scenario."""
        work = partial(plan_convex, scenario, steps=self.steps)
        return _found(work, self.solver, self.certify)


@record
class ByPlanRho(Runs):
    """With a receding horizon by `drake_rho.plan_rho`."""

    name: Name
    """in tables and figures"""
    planner: Literal["plan_rho"]
    """which function of this package"""
    replan_every: ReplanEvery = 5
    """steps flown of each window"""
    windows: Literal["auto", "convex", "scp"] = "auto"
    """how they are planned: by `plan_convex`, by `plan`, or by the one where the other fails"""
    reference: Literal["free", "tail"] | None = None
    """what windows are linearised around; as `plan_rho` does if not given"""
    solver: SolverName = "clarabel"
    """of the quadratic programs"""
    certify: bool = False
    """whether a lower bound of the cost is found too, which takes longer than the flight"""

    def run(self, scenario: Scenario, rng: np.random.Generator) -> Found:
        """Plan one flight."""
        planner, fallback = _WINDOWS[self.windows]
        work = partial(
            plan_rho,
            scenario,
            replan_every=self.replan_every,
            planner=planner,
            fallback=fallback,
            reference=None if self.reference is None else _REFERENCES[self.reference],
        )
        return _found(work, self.solver, self.certify)


@record
class BySimulate(Runs):
    """With a receding horizon and feedback in wind, as `drake_rho.simulate` flies it."""

    name: Name
    """in tables and figures"""
    planner: Literal["simulate"]
    """which function of this package"""
    replan_every: ReplanEvery = 5
    """steps flown of each window"""
    windows: Literal["auto", "convex", "scp"] = "auto"
    """how they are planned: by `plan_convex`, by `plan`, or by the one where the other fails"""
    wind: AnyWind | None = None
    """none if not given"""
    plant: Literal["quadrotor"] | None = None
    """Drake's quadrotor with a controller; point masses if not given, which are flown exactly and
    without Drake's simulator"""
    estimates: bool = True
    """whether estimates of the states err, as far as the scenario's disturbance says"""

    def run(self, scenario: Scenario, rng: np.random.Generator) -> Found:
        """Fly one scenario."""
        planner, fallback = _WINDOWS[self.windows]
        flown = fly if self.plant is None else partial(simulate, plant=self.plant)
        wind_rng, estimate_rng = rng.spawn(2)
        wind = None if self.wind is None else self.wind.over(scenario, wind_rng)
        began = time.perf_counter()
        simulation = flown(
            scenario,
            replan_every=self.replan_every,
            planner=planner,
            fallback=fallback,
            wind=wind,
            rng=estimate_rng if self.estimates else None,
        )
        return _judged(simulation, time.perf_counter() - began)


@record
class ByFunction(Runs):
    """By a function of one's own, so that other planners are compared, and judged alike."""

    name: Name
    """in tables and figures"""
    planner: Literal["function"]
    """that it is one"""
    function: Annotated[str, BeforeValidator(name_of)]
    """its name, as package.module:function, or in Python the function itself; called with the
    scenario and the arguments, it returns a plan, a flight or a simulation of it"""
    arguments: dict[str, JsonValue] = dataclasses.field(default_factory=dict)
    """further ones, by name"""
    certify: bool = False
    """whether a lower bound of the cost is found too, which takes longer than the plan"""

    def __post_init__(self) -> None:
        check_arguments(named(self.function), self.arguments)

    def run(self, scenario: Scenario, rng: np.random.Generator) -> Found:
        """Plan one scenario."""
        began = time.perf_counter()
        planned = named(self.function)(scenario, **self.arguments)
        seconds = time.perf_counter() - began
        if not isinstance(planned, Planned):
            kind = type(planned).__name__
            raise TypeError(f"{self.function}: got {kind}, expected a plan, flight or simulation")
        if planned.scenario != scenario:  # it would be judged by another one
            raise ValueError(f"{self.function}: got a plan of another scenario, expected of this")
        return _judged(planned, seconds, self.certify)


AnyMethod = Annotated[
    ByPlan | ByPlanConvex | ByPlanRho | BySimulate | ByFunction, Field(discriminator="planner")
]
"""One of the methods, told apart by its planner."""


def _found(work: Callable[..., Plan | Flight], solver: SolverName, bounded: bool) -> Found:
    """Do some planning with a solver, and judge what comes of it."""
    planned = work(solver=solver)
    return _judged(planned, planned.statistics.seconds, bounded)


def _judged(planned: Planned, seconds: float, bounded: bool = False) -> Found:
    """What took some seconds, with its judgement, and a bound if it is wanted."""
    began = time.perf_counter()
    judgement = judge(planned)
    verify_seconds = time.perf_counter() - began
    flight = planned.flight if isinstance(planned, Simulation) else planned
    bound = certify(flight).lower_bound if bounded else None
    return Found(planned, judgement, seconds, verify_seconds, bound)
