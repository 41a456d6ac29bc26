"""The command `simulate`: flight of a scenario in wind."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import typer

from drake_rho.cli.checks import check_outputs, requested_drawing
from drake_rho.cli.console import working
from drake_rho.cli.headings import HeadingOption, heading_of
from drake_rho.cli.options import (
    FiguresOption,
    FormatOption,
    OutputOption,
    WidthOption,
)
from drake_rho.cli.reports import finish
from drake_rho.cli.sources import is_result, load_result, read
from drake_rho.cli.windows import refuse_windows, takes_windows, windows_of
from drake_rho.motion.plan import Plan
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


@takes_windows
def simulate(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO|FILE",
            help="A scenario, or a file (.npz) with a plan or flight, which is tracked as it is.",
        ),
    ],
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
    *,
    heading: HeadingOption = None,
    figures: FiguresOption = None,
    file_format: FormatOption = None,
    width: WidthOption = None,
    **windows: Any,
) -> int:
    """Simulate a scenario or a plan in wind and verify the true motion."""
    # importing Drake's simulator takes long
    from drake_rho.simulation.simulate import simulate as simulated

    drawing = requested_drawing(figures, file_format, width)
    check_outputs(output, drawing)
    turned = heading_of(heading)
    if turned is not None and plant is Plant.POINT:
        raise ValueError("--heading: got one with points, expected --plant quadrotor")
    wind_rng, error_rng = np.random.default_rng(seed).spawn(2)
    vehicles: Literal["quadrotor"] | None = "quadrotor" if plant is Plant.QUADROTOR else None
    if is_result(source):
        refuse_windows(source, windows)
        plan = _plan_in(source)
        check_wind(plan.scenario, wind, direction)
        with working("computing the wind"):
            found = _wind(plan.scenario, wind, direction, wind_rng, plan.scenario.grid.end, plan)
            flown = simulated(plan, wind=found.wind, plant=vehicles, heading=turned, rng=error_rng)
        return finish(flown, output, drawing, f"{found.description}; seed {seed}")
    problem = read(source)
    check_wind(problem, wind, direction)
    with working("computing the wind") as work:
        settings, grid = windows_of(work, **windows), problem.grid
        end = float(grid.times[min(windows["replan_every"], grid.knots - 1)])
        horizon = RecedingHorizon(problem, **settings)
        found = _wind(problem, wind, direction, wind_rng, end, horizon)
        flown = simulated(
            problem, wind=found.wind, plant=vehicles, heading=turned, rng=error_rng, **settings
        )
    return finish(flown, output, drawing, f"{found.description}; seed {seed}")


def _plan_in(source: str) -> Plan:
    """Return the plan in a file of a plan or a flight.

    Raises:
        ValueError: it holds a simulation, or is damaged.
    """
    flown = load_result(Path(source))
    if flown.simulation is not None:
        raise ValueError(f"{source}: got a simulation, expected a plan or a flight")
    return flown.plan


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


class _Described(NamedTuple):
    """Wind and its description."""

    wind: Wind
    """wind"""
    description: str
    """name, direction and times"""


def _wind(
    scenario: Scenario,
    name: WindName,
    direction: Direction | None,
    rng: np.random.Generator,
    end: float,
    flown: RecedingHorizon | Plan,
) -> _Described:
    """Return a wind by name.

    Args:
        scenario: scenario to fly.
        name: name of the wind.
        direction: direction of the wind; the default if None.
        rng: source of noise.
        end: time at which the worst wind's displacement is largest [s].
        flown: target of the worst wind: a plan, or the first plan of a horizon.
    """
    grid = scenario.grid
    vector = direction or (1.0, 0.0, 0.0)
    along = " ".join(f"{each:g}" for each in vector)
    if name is WindName.CONSTANT:
        return _Described(winds.constant(scenario, vector), f"constant along {along}")
    if name is WindName.GUST:
        begin, lasting = grid.start + 0.25 * grid.duration, 0.5 * grid.duration
        description = f"gust along {along} from {begin:g} s to {begin + lasting:g} s"
        gust = winds.gust(scenario, vector, begin=begin, duration=lasting)
        return _Described(gust, description)
    if name is WindName.NOISE:
        return _Described(winds.coloured_noise(scenario, rng), "noise")
    if name is WindName.NONE:
        return _Described(winds.none(), "none")
    if direction is not None:
        worst = worst_case(scenario, direction, end)
        return _Described(worst, f"worst along {along} by {end:g} s")
    plan, whose = flown, "the plan"
    if isinstance(plan, RecedingHorizon):
        plan, whose = plan.step(scenario.fleet.start_states, grid.start).plan, "the first plan"
    found = attack(scenario, plan)
    who = " and ".join(found.vehicles)
    description = f"worst for {whose}: {who}, {found.constraint}, by {found.time:.4g} s"
    return _Described(found.wind, description)
