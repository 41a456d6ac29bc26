"""Convex program of a scenario in Drake's own classes: `rho.program`."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydrake.solvers import Binding, MathematicalProgram, MathematicalProgramResult

from drake_rho.motion.plan import Plan, summary
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.errors import SolverError
from drake_rho.planning.planners.convex import plan_convex
from drake_rho.planning.problem import Problem
from drake_rho.planning.scp.subproblem import coupling_for
from drake_rho.planning.user_program.conic import conic_of
from drake_rho.planning.user_program.constraints import (
    Draft,
    add_boxes,
    add_cost,
    add_goals,
    add_norms,
    add_obstacles,
    add_requirements,
    add_separation,
    add_waypoints,
)
from drake_rho.planning.user_program.values import Values, on_every_axis
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.described import Described
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.maps.parts import Parts
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario


@dataclasses.dataclass(frozen=True, eq=False)
class Program(metaclass=Described):
    """One convex program of a scenario, written out at the knots in Drake's own classes.

    Its variables are the accelerations, in m/s². Costs and constraints of one's own are added to
    `prog`, as expressions of `position`, `velocity` and `jerk` or as matrices by `coefficients`;
    those of the scenario can be removed. Knots are counted from 0, as arrays are.

    Examples:
        >>> p = rho.program(rho.load_scenario("paper"))
        >>> p.position("UAV-1", 1)[0]
        <Expression "(10 + 0.5 * a_UAV-1(0,0))">
        >>> low = p.prog.AddLinearConstraint(p.position("UAV-1", 25)[2] <= 2000.0)
        >>> from pydrake.solvers import ClarabelSolver
        >>> p.plan(ClarabelSolver().Solve(p.prog))
        <Plan of paper: 4 vehicles, 50 knots, cost 21256.3 m²/s⁴>
    """

    scenario: Scenario
    """scenario of the vehicles"""
    prog: MathematicalProgram
    """program with the cost, by default (13), and all constraints of the scenario"""
    accelerations: np.ndarray[Any, Any]
    """decision variables a[k] [m/s²], shape (N, K-1, 3)"""
    bindings: Mapping[str, tuple[Binding[Any], ...]]
    """costs and constraints by the names of reports, such as "effort", "goal", "position box",
    "maximum speed" or "obstacle 1"; each has a description with its vehicle and knot"""
    reference: Plan | None = None
    """motion around which obstacles and pairs are linearised; None without them"""

    def __repr__(self) -> str:
        """Return '<Program of paper: 4 vehicles, 50 knots, 588 variables>'."""
        return f"<Program of {summary(self.scenario)}, {self.prog.num_vars()} variables>"

    @checked
    def position(self, vehicle: str, knot: int) -> np.ndarray[Any, Any]:
        """Return the position p[k] (11) as Drake's expressions [m], shape (3,).

        Args:
            vehicle: name of the vehicle.
            knot: knot from 0; negative ones count from the end.

        Raises:
            ValueError: there is no such vehicle or knot.
        """
        return self._expressions("position", vehicle, knot)

    @checked
    def velocity(self, vehicle: str, knot: int) -> np.ndarray[Any, Any]:
        """Return the velocity v[k] (10) as Drake's expressions [m/s], shape (3,).

        Arguments and errors are those of `position`.
        """
        return self._expressions("velocity", vehicle, knot)

    @checked
    def jerk(self, vehicle: str, knot: int) -> np.ndarray[Any, Any]:
        """Return the jerk j[k] (7) as Drake's expressions [m/s³], shape (3,).

        The first and the last are those from and to the accelerations outside the flight.

        Arguments are those of `position`.

        Raises:
            ValueError: there is no such vehicle or knot, or the jerk is free: at a start or a goal
                in motion without an acceleration.
        """
        return self._expressions("jerk", vehicle, knot)

    @checked
    def coefficients(
        self, quantity: Quantity, vehicle: str, knot: int
    ) -> tuple[FloatArray, FloatArray]:
        """Return A and b of a quantity A @ x + b, where x is `accelerations[vehicle].ravel()`.

        Args:
            quantity: "position", "velocity", "acceleration" or "jerk".
            vehicle: name of the vehicle; x has the accelerations of its number alone.
            knot: as for `position`.

        Returns:
            Matrix of shape (3, 3 (K-1)), and vector of shape (3,) in the quantity's unit; NaN where
            a jerk is free.

        Raises:
            ValueError: there is no such vehicle or knot.
        """
        index, time = self._place(quantity, vehicle, knot)
        values = Values(self.scenario, self.accelerations)
        A = on_every_axis(values.coefficients(quantity, time))
        return A, values.at(quantity, index, time).offset

    @checked
    def plan(self, result: MathematicalProgramResult) -> Plan:
        """Return the plan of a solver's result, which `rho.verify` judges.

        Raises:
            SolverError: the solver has found no solution.
            ValueError: it is the result of another program.
        """
        solver, status = result.get_solver_id().name(), result.get_solution_result().name
        if not result.is_success():
            raise SolverError(f"result: got {status} from {solver}, expected a solution")
        try:
            found = np.stack([result.GetSolution(own) for own in self.accelerations])
        except (RuntimeError, ValueError):
            expected = "that of `prog`: solve it again"
            raise ValueError(f"result: got that of another program, expected {expected}") from None
        statistics = Statistics(
            programs=1, linearisations=int(self.reference is not None), solver=solver
        )
        plan = Plan.from_accelerations(self.scenario, found, statistics)
        return plan if self.reference is None else plan.found_around(self.reference)

    def _expressions(self, quantity: Quantity, vehicle: str, knot: int) -> np.ndarray[Any, Any]:
        index, time = self._place(quantity, vehicle, knot)
        x = Values(self.scenario, self.accelerations).at(quantity, index, time)
        if np.isnan(x.offset).any():
            expected = "another: no acceleration is given beyond it, so that the jerk is free"
            raise ValueError(f"knot: got {knot}, expected {expected}")
        return x.expressions

    def _place(self, quantity: Quantity, vehicle: str, knot: int) -> tuple[int, float]:
        """Return the index of a vehicle and the time of a knot since the first [s]."""
        index, grid = self.scenario.index_of(vehicle), self.scenario.grid
        count = grid.knots - (quantity == "acceleration")
        if knot not in range(-count, count):
            raise ValueError(f"knot: got {knot}, expected an integer from {-count} to {count - 1}")
        knot = int(knot)
        return index, float(grid.elapsed[knot % count])


@checked
def program(scenario: Scenario, around: Plan | None = None) -> Program:
    """Return the convex program (16) of a scenario, to be changed and solved with Drake.

    Obstacles and pairs of vehicles are linearised around a plan (15). All constraints are written
    out at the knots, of waypoints and ends of requirements at their own times. The optimum is then
    that of `rho.plan_convex` with `between_knots=False`, which adds rows only where they are
    violated. Whether a plan also holds between knots is for `rho.verify` to say.

    The tolerances of solvers are absolute. Where accelerations are below 1e-2 m/s², ask the solver
    for more than its default.

    Args:
        scenario: the problem to write out, without a disturbance, a smoothing, maps, sets of one's
            own and waypoints without a time.
        around: motion to linearise around, on the scenario's grid; if not given, the plan without
            obstacles and separation, as in step 2 of `rho.plan_convex`.

    Raises:
        InfeasibleError: there is no plan without obstacles and separation to linearise around.
        ScenarioError: the scenario has what no single program describes.
        ValueError: `around` has other vehicles or another grid.
    """
    check_writable(scenario)
    problem, reference = Problem.of(scenario), around
    if reference is not None:
        problem.check_fits(reference)
    if not scenario.avoided and scenario.separation is None:
        reference = None
    elif reference is None:
        reference = plan_convex(scenario.without_obstacles().without_separation())
    draft = _draft(problem, reference)
    bindings = {name: tuple(own) for name, own in draft.bindings.items()}
    return Program(scenario, draft.prog, draft.values.accelerations, bindings, reference)


def _draft(problem: Problem, reference: Plan | None) -> Draft:
    """Return the program of a problem, linearised around a reference if there is one."""
    prog, steps = MathematicalProgram(), problem.scenario.grid.knots - 1
    names = problem.scenario.names
    a = np.stack([prog.NewContinuousVariables(steps, 3, f"a_{name}") for name in names])
    draft = Draft(problem, prog, Values(problem.scenario, a))
    add_cost(draft)
    add_goals(draft)
    add_boxes(draft)
    add_norms(draft)
    add_waypoints(draft)
    add_requirements(draft)
    if reference is not None:
        motion = reference.motion()
        add_obstacles(draft, motion)
        if problem.scenario.separation is not None:
            add_separation(draft, motion, coupling_for(problem.scenario))
    return draft


def check_writable(scenario: Scenario) -> None:
    """Check that one program at the knots can describe a scenario.

    Raises:
        ScenarioError: it has something else; the error names the field.
    """
    for field in ("smoothing", "disturbance"):
        if getattr(scenario, field) is not None:
            expected = "none: a program has no margins; plan with `rho.plan_convex`"
            raise ScenarioError(field, Description("one"), expected)
    for number, obstacle in scenario.avoided:
        if isinstance(obstacle.shape, Parts):
            expected = "a shape: which parts of a map need rows is known only while planning"
            raise ScenarioError(f"obstacles[{number - 1}].shape", Description("a map"), expected)
    for index, requirement in enumerate(scenario.requirements):
        try:
            if requirement.penalty is not None and requirement.deviation > 0.0:
                expected = "0 beside a penalty: the excess is not a distance from a set"
                raise ScenarioError("relative_to.deviation", requirement.deviation, expected)
            conic_of(requirement.set).tightened(requirement.deviation)
        except ScenarioError as error:
            raise error.inside(f"requirements[{index}]") from None
    for i, vehicle in enumerate(scenario.vehicles):
        for k, waypoint in enumerate(vehicle.waypoints):
            if waypoint.velocity is not None and not isinstance(waypoint.velocity, np.ndarray):
                try:
                    conic_of(waypoint.velocity)
                except ScenarioError as error:
                    where = f"vehicles[{i}].waypoints[{k}].velocity"
                    raise ScenarioError(where, error.value, error.expected) from None
