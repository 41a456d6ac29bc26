"""Methods for planning or flying the scenarios of a study."""

from __future__ import annotations

import dataclasses
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, Literal, cast

import numpy as np
from pydantic import BeforeValidator, Field, JsonValue

from drake_rho.analysis.certify import certify
from drake_rho.analysis.minimum_time import plan_minimum_time
from drake_rho.campaigns.evaluation import Evaluation, evaluate
from drake_rho.campaigns.functions import check_arguments, name_of, named
from drake_rho.campaigns.wind_models import AnyWind
from drake_rho.motion.flight import Flight
from drake_rho.motion.flown import Flown, Planned
from drake_rho.motion.plan import Plan
from drake_rho.motion.trajectories import Trajectories
from drake_rho.planning.call.options import Options
from drake_rho.planning.constraints.separation import CouplingName
from drake_rho.planning.horizon.plan_rho import plan_rho
from drake_rho.planning.horizon.settings import DEFAULTS, PlainSettings, Windows, by_names
from drake_rho.planning.planners.convex import plan_convex
from drake_rho.planning.planners.plan import plan as best_plan
from drake_rho.planning.programs.backend import SolverName
from drake_rho.scenario.fields import Count, Margin, Name, Positive, record
from drake_rho.scenario.records import Scenario
from drake_rho.simulation.closed_loop import fly
from drake_rho.simulation.simulate import simulate

Knots = Annotated[Count, Field(ge=2)]


@dataclasses.dataclass(frozen=True)
class Found:
    """Result of a method for one scenario."""

    planned: Planned
    """plan, flight or simulation; of trajectories the plan with their states at the knots"""
    evaluation: Evaluation
    """evaluation of it by `verify`"""
    seconds: float
    """time to plan or fly [s]"""
    verify_seconds: float
    """time to verify [s]"""
    bound: float | None = None
    """lower bound on the cost of every plan [m²/s⁴]; None if it was not requested"""


@record
class Method(ABC):
    """Base class of all methods."""

    name: Annotated[Name, Field(description="name of the method in tables and figures")]
    planner: str

    @abstractmethod
    def run(self, scenario: Scenario, rng: np.random.Generator) -> Found:
        """Plan or fly a scenario, with randomness from a generator.

        Raises:
            InfeasibleError: no plan exists, or none was found.
            SolverError: the solvers fail numerically.
        """


@record
class ByPlan(Method):
    """Planning of the whole flight by `drake_rho.plan`."""

    planner: Literal["plan"]
    """name of the planner"""
    coupling: CouplingName | None = None
    """coupling of vehicles by their separation; chosen by the size of the fleet if not given"""
    options: Options | None = None
    """tolerances and bounds"""
    solver: SolverName = "clarabel"
    """solver of the quadratic programs"""
    certify: bool = False
    """whether to compute a lower bound of the cost, too, which takes longer than planning"""

    def run(self, scenario: Scenario, rng: np.random.Generator) -> Found:
        """Plan one scenario."""
        work = partial(best_plan, coupling=self.coupling, options=self.options)
        return _found(partial(work, scenario), self.solver, self.certify)


@record
class ByPlanConvex(Method):
    """Planning of the whole flight by `drake_rho.plan_convex`, the paper's convex method."""

    planner: Literal["plan_convex"]
    """name of the planner"""
    steps: tuple[Positive, ...] = ()
    """further steps of the grid to try if there is no plan [s]"""
    solver: SolverName = "clarabel"
    """solver of the quadratic programs"""
    certify: bool = False
    """whether to compute a lower bound of the cost, too, which takes longer than planning"""

    def run(self, scenario: Scenario, rng: np.random.Generator) -> Found:
        """Plan one scenario."""
        work = partial(plan_convex, scenario, steps=self.steps)
        return _found(work, self.solver, self.certify)


@record
class InWindows(PlainSettings, Method):
    """Base class of methods that plan in windows."""

    windows: Annotated[
        Literal["auto", "convex", "scp"],
        Field(
            description="planner of windows: convex is `plan_convex`, scp is `plan`, and auto is "
            "`plan` where `plan_convex` fails"
        ),
    ] = "auto"
    reference: Annotated[
        Literal["free", "tail"] | None,
        Field(
            description="reference around which windows are linearised; the default of `plan_rho` "
            "if not given"
        ),
    ] = None
    solver: Annotated[
        SolverName | None,
        Field(description="solver of the quadratic programs; Clarabel if not given"),
    ] = None
    options: Annotated[
        Options | None,
        Field(
            description="tolerances, bounds, and the time limit: of the whole flight for "
            "`plan_rho`, of planning each window for `simulate`"
        ),
    ] = None

    @property
    def settings(self) -> Windows:
        """Settings of windows. Fields that are None are not given."""
        given = {name: getattr(self, name, None) for name in Windows.__annotations__}
        known = cast(Windows, {name: each for name, each in given.items() if each is not None})
        return known | by_names(self.windows, self.reference)


@record
class ByPlanRho(InWindows):
    """Planning with a receding horizon by `drake_rho.plan_rho`."""

    planner: Literal["plan_rho"]
    """name of the planner"""
    solver: SolverName = "clarabel"
    """solver of the quadratic programs"""
    certify: bool = False
    """whether to compute a lower bound of the cost, too, which takes longer than the flight"""

    def run(self, scenario: Scenario, rng: np.random.Generator) -> Found:
        """Plan one flight."""
        return _found(partial(plan_rho, scenario, **self.settings), self.solver, self.certify)


@record
class ByPlanMinimumTime(Method):
    """Minimum-time planning by `drake_rho.plan_minimum_time`."""

    planner: Literal["plan_minimum_time"]
    """name of the planner"""
    knots: Knots | None = None
    """number of knots of the plan; the scenario's if not given"""
    options: Options | None = None
    """time limit, and bounds of the searches for first plans"""
    solver: SolverName = "clarabel"
    """solver of the first plans"""

    def run(self, scenario: Scenario, rng: np.random.Generator) -> Found:
        """Plan one scenario."""
        work = partial(plan_minimum_time, scenario, knots=self.knots, options=self.options)
        return _found(work, self.solver, bounded=False)


@record
class BySimulate(InWindows):
    """Simulation with a receding horizon and feedback in wind, as by `drake_rho.simulate`."""

    planner: Literal["simulate"]
    """name of the planner"""
    latency: Margin = DEFAULTS["latency"]
    """planning time of a window [s], at most the time for which it is flown"""
    wind: AnyWind | None = None
    """model of the wind; no wind if not given"""
    plant: Literal["quadrotor"] | None = None
    """Drake's quadrotor with a controller; if not given, point masses, which are flown exactly and
    without Drake's simulator"""
    estimates: bool = True
    """whether estimated states have errors, within the bounds of the scenario's disturbance"""

    def run(self, scenario: Scenario, rng: np.random.Generator) -> Found:
        """Fly one scenario."""
        wind_rng, estimate_rng = rng.spawn(2)
        wind = None if self.wind is None else self.wind.over(scenario, wind_rng)
        errors = estimate_rng if self.estimates else None
        began = time.perf_counter()
        fly_by = fly if self.plant is None else partial(simulate, plant=self.plant)
        simulation = fly_by(scenario, wind=wind, rng=errors, **self.settings)
        return _evaluated(simulation, time.perf_counter() - began)


@record
class ByFunction(Method):
    """Planning by a function from outside this package, verified in the same way."""

    planner: Literal["function"]
    """kind of the method"""
    function: Annotated[str, BeforeValidator(name_of)]
    """name of the function as package.module:function, or in Python the function itself. It is
    called with the scenario and the arguments and returns a plan, a flight, a simulation or
    trajectories"""
    arguments: dict[str, JsonValue] = dataclasses.field(default_factory=dict)
    """further arguments of the function, by name"""
    certify: bool = False
    """whether to compute a lower bound of the cost, too, which takes longer than planning"""

    def __post_init__(self) -> None:
        check_arguments(named(self.function), self.arguments)

    def run(self, scenario: Scenario, rng: np.random.Generator) -> Found:
        """Plan one scenario."""
        began = time.perf_counter()
        planned = named(self.function)(scenario, **self.arguments)
        seconds = time.perf_counter() - began
        if not isinstance(planned, Flown):
            kind = type(planned).__name__
            expected = "a plan, flight, simulation or trajectories"
            raise TypeError(f"{self.function}: got {kind}, expected {expected}")
        if isinstance(planned, Trajectories):
            planned = planned.for_scenario(scenario)
        if planned.scenario != scenario:  # otherwise it would be verified against another scenario
            raise ValueError(f"{self.function}: got a plan of another scenario, expected of this")
        return _evaluated(planned, seconds, self.certify)


AnyMethod = Annotated[
    ByPlan | ByPlanConvex | ByPlanRho | ByPlanMinimumTime | BySimulate | ByFunction,
    Field(discriminator="planner"),
]
"""One of the methods, distinguished by its planner."""

_FLOWN = "name planner replan_every free_final_time windows"
_STORED = {
    "plan_rho": f"{_FLOWN} reference solver contingencies bounded_cost certify latency options",
    "simulate": f"{_FLOWN} wind plant estimates contingencies bounded_cost latency reference "
    "solver options",
}
"""Order of fields in stored keys of runs, where it is not that of the record."""


def in_stored_order(content: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a method in the order on which keys of runs in stores depend.

    Fields that are not listed, such as newer ones, follow in the order of the record.
    """
    first = _STORED.get(content["planner"], "").split()
    return {name: content[name] for name in first if name in content} | content


def _found(work: Callable[..., Plan | Flight], solver: SolverName, bounded: bool) -> Found:
    """Plan with a solver and evaluate the result."""
    planned = work(solver=solver)
    return _evaluated(planned, planned.statistics.seconds, bounded)


def _evaluated(planned: Flown, seconds: float, bounded: bool = False) -> Found:
    """Return a result with its evaluation and, if `bounded`, a lower bound of the cost."""
    began = time.perf_counter()
    evaluation = evaluate(planned)
    verify_seconds = time.perf_counter() - began
    bound = certify(planned.flight or planned.plan).lower_bound if bounded else None
    kept = planned.plan if isinstance(planned, Trajectories) else planned
    return Found(kept, evaluation, seconds, verify_seconds, bound)
