"""The command `simulate`: flight of a scenario in wind."""

from __future__ import annotations

from enum import StrEnum
from functools import partial
from typing import Annotated

import numpy as np
import typer

from drake_rho.cli.checks import check_outputs, requested_drawing
from drake_rho.cli.console import working
from drake_rho.cli.options import (
    ContingenciesOption,
    DurationOption,
    FiguresOption,
    FormatOption,
    FreeFinalTimeOption,
    LatencyOption,
    Method,
    MethodOption,
    OutputOption,
    ReplanEveryOption,
    ScenarioArgument,
    StepOption,
    WidthOption,
    WorldOption,
    planners,
)
from drake_rho.cli.reports import finish
from drake_rho.cli.sources import read
from drake_rho.planning.horizon.receding_horizon import RecedingHorizon
from drake_rho.scenario.records import Scenario
from drake_rho.simulation import winds
from drake_rho.simulation.attack import attack
from drake_rho.simulation.winds import Wind
from drake_rho.simulation.worst_case import worst_case

Direction = tuple[float, float, float]


class WindName(StrEnum):
    """Winds, by their names on the command line."""

    NONE = "none"
    CONSTANT = "constant"
    GUST = "gust"
    NOISE = "noise"
    WORST = "worst"


class Plant(StrEnum):
    """Vehicle models, by their names on the command line."""

    POINT = "point"
    QUADROTOR = "quadrotor"


DIRECTED = (WindName.CONSTANT, WindName.GUST, WindName.WORST)
"""Winds for which a direction can be given."""


def simulate(
    scenario: ScenarioArgument,
    output: OutputOption = None,
    wind: Annotated[
        WindName,
        typer.Option(
            help="none; constant; gust, in the middle half of the flight; noise, independent for "
            "each vehicle; or worst, the worst case. The disturbance of the scenario gives the "
            "strength of each."
        ),
    ] = WindName.NONE,
    direction: Annotated[
        Direction | None,
        typer.Option(
            metavar="X Y Z",
            help="Direction in which a constant wind or a gust blows, by default x; or in which "
            "the worst wind drives the vehicles by the end of the first window, by default towards "
            "the constraint to which the plan of that window is closest.",
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the noise and of the state estimation errors.")
    ] = 1,
    plant: Annotated[
        Plant, typer.Option(help="Vehicle model: point masses or Drake's quadrotors.")
    ] = Plant.POINT,
    replan_every: ReplanEveryOption = 5,
    free_final_time: FreeFinalTimeOption = False,
    method: MethodOption = Method.AUTO,
    contingencies: ContingenciesOption = False,
    latency: LatencyOption = 0.0,
    duration: DurationOption = None,
    step: StepOption = None,
    world: WorldOption = None,
    figures: FiguresOption = None,
    file_format: FormatOption = None,
    width: WidthOption = None,
) -> int:
    """Simulate a scenario in wind and verify the true motion."""
    # importing Drake's simulator takes long
    from drake_rho.simulation.simulate import simulate as simulated

    drawing = requested_drawing(figures, file_format, width)
    check_outputs(output, drawing)
    problem = read(scenario, duration, step, world)
    check_wind(problem, wind, direction)
    wind_rng, error_rng = np.random.default_rng(seed).spawn(2)
    with working("computing the wind") as work:
        planner, fallback = planners(method, work.detail)
        horizon = partial(
            RecedingHorizon,
            problem,
            replan_every=replan_every,
            free_final_time=free_final_time,
            planner=planner,
            fallback=fallback,
            contingencies=contingencies,
            latency=latency,
        )
        wind_model, description = _wind(horizon(), wind, direction, wind_rng)
        flown = simulated(
            horizon(progress=work),
            wind=wind_model,
            plant="quadrotor" if plant is Plant.QUADROTOR else None,
            rng=error_rng,
        )
    return finish(flown, output, drawing, f"{description}; seed {seed}")


def check_wind(scenario: Scenario, wind: WindName, direction: Direction | None) -> None:
    """Check that the options of wind fit each other and the scenario.

    Raises:
        ValueError: the scenario does not give the strength of the wind, the wind takes no
            direction, or the direction has no length.
    """
    if wind is not WindName.NONE and scenario.disturbance is None:
        expected = "a scenario with the strength of the wind, as disturbance: {acceleration: 0.3}"
        raise ValueError(f"--wind: got {wind}, expected {expected}")
    if direction is None:
        return
    given = " ".join(f"{each:g}" for each in direction)
    if wind not in DIRECTED:
        raise ValueError(
            f"--direction: got {given} with --wind {wind}, expected constant, gust or worst"
        )
    if not 0.0 < float(np.linalg.norm(direction)) < np.inf:
        raise ValueError(f"--direction: got {given}, expected three numbers, not all 0")


def _wind(
    horizon: RecedingHorizon,
    name: WindName,
    direction: Direction | None,
    rng: np.random.Generator,
) -> tuple[Wind, str]:
    """Return the wind of a name, and a description of it."""
    scenario, grid = horizon.scenario, horizon.scenario.grid
    vector = direction or (1.0, 0.0, 0.0)
    along = " ".join(f"{each:g}" for each in vector)
    if name is WindName.CONSTANT:
        return winds.constant(scenario, vector), f"constant along {along}"
    if name is WindName.GUST:
        begin, lasting = grid.start + 0.25 * grid.duration, 0.5 * grid.duration
        description = f"gust along {along} from {begin:g} s to {begin + lasting:g} s"
        return winds.gust(scenario, vector, begin=begin, duration=lasting), description
    if name is WindName.NOISE:
        return winds.coloured_noise(scenario, rng), "noise"
    if name is WindName.NONE:
        return winds.none(), "none"
    if direction is not None:
        end = float(grid.times[min(horizon.replan_every, grid.knots - 1)])
        return worst_case(scenario, direction, end), f"worst along {along} by {end:g} s"
    found = attack(scenario, horizon.step(scenario.fleet.start_states, grid.start).plan)
    who = " and ".join(found.vehicles)
    return found.wind, f"worst for the first plan: {who}, {found.constraint}, by {found.time:.4g} s"
