"""`simulate`: closed-loop simulation of a scenario, a plan or a flight in wind, in Drake."""

from __future__ import annotations

import dataclasses
from typing import Literal, Unpack

import numpy as np

from drake_rho.motion.flight import Flight
from drake_rho.motion.headings import Heading, directions_of
from drake_rho.motion.jumps import check_continuous
from drake_rho.motion.plan import Plan
from drake_rho.motion.simulation import Simulation
from drake_rho.planning.errors import InfeasibleError
from drake_rho.planning.horizon.receding_horizon import RecedingHorizon
from drake_rho.planning.horizon.settings import Windows, refuse_settings, takes_windows
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.records import Disturbance, Scenario
from drake_rho.simulation import winds
from drake_rho.simulation.closed_loop import OnePlan, adopted
from drake_rho.simulation.diagram import simulated
from drake_rho.simulation.feedback import Horizon
from drake_rho.simulation.plants import PLANTS
from drake_rho.simulation.small_steps import in_small_steps
from drake_rho.simulation.small_windows import as_flown
from drake_rho.simulation.winds import Wind


@checked
@takes_windows
def simulate(
    scenario: Scenario | Plan | Flight | RecedingHorizon,
    *,
    wind: Wind | None = None,
    disturbance: Disturbance | None = None,
    plant: Literal["quadrotor"] | None = None,
    heading: Heading | None = None,
    rng: np.random.Generator | None = None,
    **windows: Unpack[Windows],
) -> Simulation:
    """Fly in wind with feedback, in Drake's simulator.

    A scenario, or a given `RecedingHorizon`, is flown with a receding horizon, which plans windows
    during the flight. A plan, or the plan of a flight, is tracked without replanning, with the
    feedback of its scenario; a flight that jumps to measured states is refused. Without a
    disturbance there is no feedback, and `verify` notes this.

    With smoothing, the averaged plans and windows are flown in small steps of constant
    acceleration. The simulation's scenario has these steps; its windows begin when their averages
    do. Feedback begins with the smooth motion and is held for all small steps of its sample.

    Args:
        scenario: scenario to fly, a receding horizon that has not begun, or the plan or flight to
            track.
        wind: a wind of `rho.winds`, `rho.worst_case`, or a function of time [s], positions [m] and
            velocities [m/s], (N, 3) each, to accelerations [m/s²], (N, 3); none if not given.
        disturbance: disturbance to fly with, which determines the feedback, for a scenario without
            one.
        plant: point masses if not given; `"quadrotor"` for Drake's `QuadrotorPlant`, each with a
            controller of thrust and attitude. Its lag is then part of the simulated scenario's
            delay, and windows are planned that much earlier.
        heading: headings of quadrotors along the planned motion, as for `rho.export`; along the x
            axis if not given. `Simulation.heading_errors` tells how far they are off.
        rng: source of random estimation errors; without it there are none, unless the wind has
            its own.
        **windows: settings of windows, as for `RecedingHorizon`; for a scenario only.

    Returns:
        The true motion, with windows, winds and commands. Equal arguments and equally seeded
        generators give bit-equal motions.

    Raises:
        InfeasibleError: the first window has no plan; with a quadrotor the error names the gains
            that it can hold.
        SolverError: the solvers fail numerically in the first window.
        ValueError: an argument is invalid, or a quadrotor cannot hold a horizon's feedback.

    Examples:
        >>> scenario = rho.load_scenario("courier")
        >>> flown = rho.simulate(scenario, wind=rho.winds.constant(scenario, [0, 1, 0]))
        >>> rho.verify(flown).ok
        True

        A plan without a disturbance is tracked in gusts, with the feedback for winds up to 1 m/s².

        >>> plan = rho.plan(rho.load_scenario("paper"))
        >>> gusts = lambda t, p, v: np.sin([[0.1 * t, 0, 0]]) * np.ones_like(p)
        >>> flown = rho.simulate(plan, wind=gusts, disturbance=rho.Disturbance(1.0))
        >>> float(flown.errors().max()) < float(flown.radii().max())
        True
    """
    horizon: Horizon
    kind = PLANTS[plant]
    if heading is not None and not kind.has_heading:
        expected = f"none with a {kind.name}, which has no attitude, or plant='quadrotor'"
        raise ValueError(f"heading: got one, expected {expected}")
    if isinstance(scenario, Scenario):
        flown = kind.declared(_disturbed(scenario, disturbance))
        horizon = RecedingHorizon(flown, **kind.planned_ahead(flown, windows))
    elif isinstance(scenario, RecedingHorizon):
        refuse_settings(windows, "receding horizon")
        if disturbance is not None:
            expected = "none beside a receding horizon, whose scenario has its own"
            got = f"one of {disturbance.acceleration:g} m/s²"
            raise ValueError(f"disturbance: got {got}, expected {expected}")
        if scenario.windows:
            got = "a receding horizon that has windows"
            raise ValueError(f"scenario: got {got}, expected one that has not begun")
        kind.check_declared(scenario.scenario)
        horizon = scenario
    else:
        refuse_settings(windows, scenario.kind)
        expected = f"a plan, or a {scenario.kind} without jumps, which vehicles could follow"
        check_continuous(scenario.plan, expected)
        flown = kind.declared(_disturbed(scenario.plan.scenario, disturbance))
        plan = adopted(flown, scenario.plan)
        horizon = OnePlan(in_small_steps(plan))
    names, wind = horizon.scenario.names, winds.none() if wind is None else wind
    directions = None if heading is None else directions_of(names, heading)
    try:
        return simulated(as_flown(horizon), wind, kind, rng, directions)
    except InfeasibleError as error:
        if kind.lag == 0.0 or not horizon.scenario.disturbance:
            raise
        raise kind.with_gains(error, horizon.scenario) from None


def _disturbed(scenario: Scenario, disturbance: Disturbance | None) -> Scenario:
    """Return the scenario to fly, with a disturbance if one is given.

    Raises:
        ValueError: the scenario has a disturbance of its own.
    """
    if disturbance is None:
        return scenario
    if scenario.disturbance is not None:
        got, own = (each.acceleration for each in (disturbance, scenario.disturbance))
        expected = f"none: {scenario.name} has its own, of {own:g} m/s²"
        raise ValueError(f"disturbance: got one of {got:g} m/s², expected {expected}")
    return dataclasses.replace(scenario, disturbance=disturbance)
