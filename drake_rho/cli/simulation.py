"""The command `simulate`: a scenario flown in wind, and what came of it."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import numpy as np
import typer

from drake_rho.cli.checks import asked_drawing, check_kept
from drake_rho.cli.console import working
from drake_rho.cli.options import (
    DurationOption,
    FiguresOption,
    FormatOption,
    Method,
    MethodOption,
    OutputOption,
    ReplanEveryOption,
    ScenarioArgument,
    StepOption,
    WidthOption,
    WorldOption,
    planners,
    read,
)
from drake_rho.cli.reports import finish
from drake_rho.planning.horizon.receding_horizon import RecedingHorizon
from drake_rho.scenario.records import Scenario
from drake_rho.simulation import winds
from drake_rho.simulation.attack import attack
from drake_rho.simulation.winds import Wind
from drake_rho.simulation.worst_case import worst_case

Direction = tuple[float, float, float]


class WindName(StrEnum):
    """Winds by their names on the command line."""

    NONE = "none"
    CONSTANT = "constant"
    GUST = "gust"
    NOISE = "noise"
    WORST = "worst"


class Plant(StrEnum):
    """What is flown, by its name on the command line."""

    POINT = "point"
    QUADROTOR = "quadrotor"


DIRECTED = (WindName.CONSTANT, WindName.GUST, WindName.WORST)
"""Winds that have a direction."""


def simulate(
    scenario: ScenarioArgument,
    output: OutputOption = None,
    wind: Annotated[
        WindName,
        typer.Option(
            help="None; constant; a gust in the middle half of the flight; noise, of its own for "
            "each vehicle; or the worst there is. Each as strong as the disturbance says."
        ),
    ] = WindName.NONE,
    direction: Annotated[
        Direction | None,
        typer.Option(
            metavar="X Y Z",
            help="Where a constant wind or a gust blows to, along x if not given, or where the "
            "worst one drives the vehicles by the end of the first window; if not given, towards "
            "what the first window's plan comes closest to.",
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, help="Of noise, and of the errors of estimated states.")
    ] = 1,
    plant: Annotated[
        Plant, typer.Option(help="What is flown: point masses, or Drake's quadrotors.")
    ] = Plant.POINT,
    replan_every: ReplanEveryOption = 5,
    method: MethodOption = Method.AUTO,
    duration: DurationOption = None,
    step: StepOption = None,
    world: WorldOption = None,
    figures: FiguresOption = None,
    file_format: FormatOption = None,
    width: WidthOption = None,
) -> int:
    """Fly a scenario in wind, and judge the true motion."""
    # Drake's simulator takes long to load
    from drake_rho.simulation.simulate import simulate as simulated

    drawing = asked_drawing(figures, file_format, width)
    check_kept(output, drawing)
    asked = read(scenario, duration, step, world)
    check_wind(asked, wind, direction)
    for_wind, for_errors = np.random.default_rng(seed).spawn(2)
    with working("looking for the wind") as work:
        planner, fallback = planners(method, work.detail)
        horizon = RecedingHorizon(
            asked, replan_every=replan_every, planner=planner, fallback=fallback
        )
        blowing, words = _wind(horizon, wind, direction, for_wind)
        flown = simulated(
            asked,
            replan_every=replan_every,
            planner=planner,
            fallback=fallback,
            wind=blowing,
            plant="quadrotor" if plant is Plant.QUADROTOR else None,
            rng=for_errors,
            progress=work,
        )
    return finish(flown, output, drawing, f"{words}; seed {seed}")


def check_wind(scenario: Scenario, wind: WindName, direction: Direction | None) -> None:
    """See that there can be such a wind.

    Raises:
        ValueError: the scenario does not say how strong wind is, or the wind has no direction, or
            the direction has no length.
    """
    if wind is not WindName.NONE and scenario.disturbance is None:
        expected = "a scenario that says how strong wind is, as disturbance: {acceleration: 0.3}"
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
    """The wind of a name, and what it is in words."""
    scenario, grid = horizon.scenario, horizon.scenario.grid
    towards = direction or (1.0, 0.0, 0.0)
    along = " ".join(f"{each:g}" for each in towards)
    if name is WindName.CONSTANT:
        return winds.constant(scenario, towards), f"constant along {along}"
    if name is WindName.GUST:
        begin, lasting = grid.start + 0.25 * grid.duration, 0.5 * grid.duration
        words = f"gust along {along} from {begin:g} s to {begin + lasting:g} s"
        return winds.gust(scenario, towards, begin=begin, duration=lasting), words
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
