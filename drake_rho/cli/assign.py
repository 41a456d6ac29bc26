"""The command `assign`: exchange of goals between vehicles."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from drake_rho.cli.checks import check_writable
from drake_rho.cli.console import answer, plain_table, tell, working
from drake_rho.cli.options import ScenarioArgument
from drake_rho.cli.sources import read
from drake_rho.motion.costs import cost_of
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.planners.assignment import assign_goals, assignment
from drake_rho.scenario.files import save_scenario
from drake_rho.scenario.records import Scenario
from drake_rho.verification.summary import least_effort


@dataclasses.dataclass(frozen=True)
class AssignedGoal:
    """Goal assigned to a vehicle."""

    vehicle: str
    """name of the vehicle"""
    goal_of: str
    """name of the vehicle that had this goal before"""
    goal_m: list[float]
    """position of the goal: x, y and z; of a set, the point nearest to the vehicle's start"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Assigned:
    """Goals assigned to the vehicles of a scenario."""

    scenario: str
    """name of the scenario"""
    effort: float
    """least cost with the goals exchanged, without other constraints"""
    effort_before: float
    """least cost with the original goals, without other constraints"""
    vehicles: list[AssignedGoal]
    """goal of each vehicle"""
    file: str | None
    """path of the saved scenario; None if it was not saved"""


def assign(
    scenario: ScenarioArgument,
    output: Annotated[
        str | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="Save the scenario to this file (.yaml)."
        ),
    ] = None,
) -> int:
    """Exchange goals between vehicles to minimise their total effort."""
    check_writable(output, (".yaml", ".yml"), "--output")
    problem = read(scenario)
    with working("assigning goals"):
        indices, better = assignment(problem), assign_goals(problem)
    others = [problem.vehicles[index] for index in indices]
    document = Assigned(
        scenario=problem.name,
        effort=_effort(better),
        effort_before=_effort(problem),
        vehicles=[
            AssignedGoal(vehicle.name, other.name, goal.tolist())
            for vehicle, other, goal in zip(
                problem.vehicles, others, better.fleet.goal_positions, strict=True
            )
        ],
        file=output,
    )
    if output is None:
        return answer(document, *_summary(document))
    save_scenario(better, output)
    return tell(document, *_summary(document), f"saved to {output}")


def _effort(scenario: Scenario) -> float:
    """Return the least cost of all motions from the starts to the goals [m²/s⁴]."""
    if scenario.goal_sets:
        return least_effort(scenario)
    return cost_of(scenario, MinimumEffort.of(scenario).motion)


def _summary(found: Assigned) -> list[str | Table]:
    """Return the least effort and a table of the vehicles whose goals change."""
    effort = f"least effort {found.effort:.6g} m²/s⁴"
    moved = [each for each in found.vehicles if each.goal_of != each.vehicle]
    if not moved:
        return [f"{found.scenario}: every vehicle keeps its goal; {effort}"]
    heading = (
        f"{found.scenario}: {len(moved)} of {len(found.vehicles)} vehicles have another goal; "
        f"{effort} instead of {found.effort_before:.6g} m²/s⁴"
    )
    table = plain_table("vehicle", "goal of", "position [m]", texts=3)
    for each in moved:
        position = "  ".join(f"{value:.4g}" for value in each.goal_m)
        table.add_row(escape(each.vehicle), escape(each.goal_of), position)
    return [heading, table]
