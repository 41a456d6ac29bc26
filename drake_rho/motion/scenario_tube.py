"""Error tubes of scenarios: the best gains, and the largest disturbance that a radius allows."""

from __future__ import annotations

import dataclasses
from functools import lru_cache

import numpy as np

from drake_rho.motion.gains import (
    Loop,
    best_gains,
    largest_wind,
    prediction_is_better,
    tolerable_wind,
)
from drake_rho.motion.tube import ErrorTube
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.disturbance import Disturbance, Tracking
from drake_rho.scenario.fields import unchecked
from drake_rho.scenario.parts import Grid
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import steps_lasting


@checked
def error_tube(
    scenario: Scenario,
    initial: tuple[float, float] | None = None,
    *,
    gains: tuple[float, float] | None = None,
) -> ErrorTube:
    """Return the error tube of a scenario's vehicles around any plan, with the best gains.

    Without a disturbance there is no feedback, and the tube contains only initial errors. If the
    disturbance describes how a plan is tracked (`Disturbance.tracking`), the gains are those given
    there, and so are the initial errors and the beginning of the tube unless `initial` is given.
    With a smoothing the tube is around the smooth motion and begins with it, before the first knot.

    With a delay, `Disturbance.prediction` determines the feedback. If it is not given, the feedback
    predicts the state if that reduces the largest radius, with the best gains of each and no
    initial error. The tube's own `disturbance` states the choice.

    Args:
        scenario: the scenario.
        initial: largest norms of the errors of position [m] and velocity [m/s] at the first knot;
            zero if not given, as vehicles begin exactly at their starts.
        gains: k_p [1/s²] and k_v [1/s], such as those of another tube. If not given, they are
            optimised: the largest radius of the position is minimal, subject to a radius of the
            feedback of at most its share of the tightest acceleration limit.

    Raises:
        ValueError: the initial radii are not two finite numbers of at least 0.

    Examples:
        >>> scenario = rho.load_scenario("courier")
        >>> tube = rho.error_tube(scenario)
        >>> print(f"{tube.position(scenario.grid.end):.3f} m")
        0.241 m
    """
    disturbance, grid = _decided(scenario), _grid_of_flight(scenario)
    if (tracked := disturbance.tracking) and gains is None:
        if initial is None:
            return _tracked(disturbance, tracked, grid)
        gains = tracked.gains
    tube = ErrorTube(disturbance, grid, gains or (0.0, 0.0), initial or (0.0, 0.0))
    if gains is not None or not scenario.disturbance:
        return tube
    alpha, beta = best_gains(_loop(scenario, tube))
    return dataclasses.replace(tube, gains=(alpha / tube.sample**2, beta / tube.sample))


def tube_of(scenario: Scenario) -> ErrorTube:
    """Return `error_tube` of a scenario, which may be under way, from a cache.

    Planners tighten their constraints by the radii of this tube.
    """
    return _cached(error_tube(scenario))


def tracking_of(scenario: Scenario) -> Tracking | None:
    """Return the feedback of a scenario's tube, for plans under way; None without a disturbance."""
    return tube_of(scenario).tracking if scenario.disturbance else None


def _grid_of_flight(scenario: Scenario) -> Grid:
    """Return the grid of a flight: the plan's, extended in whole steps for a smoothing."""
    grid, lead = scenario.grid, scenario.lead
    if lead == 0.0:
        return grid
    more = steps_lasting(2.0 * lead, grid.step)
    return Grid(grid.step, grid.knots + more, grid.start - lead)


def _tracked(disturbance: Disturbance, tracked: Tracking, grid: Grid) -> ErrorTube:
    """Return the tube around a tracked plan, which begins at that plan's first knot."""
    before = round((grid.start - tracked.since) / grid.step)
    whole = grid if before == 0 else Grid(grid.step, grid.knots + before, tracked.since)
    return ErrorTube(disturbance, whole, tracked.gains, (tracked.position, tracked.velocity))


def _decided(scenario: Scenario) -> Disturbance:
    """Return a scenario's disturbance with the choice of `prediction` made."""
    disturbance = scenario.disturbance_or_calm
    if tracked := disturbance.tracking:
        return unchecked(disturbance, prediction=tracked.prediction)
    if disturbance.prediction is not None or disturbance.delay == 0:
        return disturbance
    loop = _loop(scenario, ErrorTube(disturbance, _grid_of_flight(scenario)))
    return unchecked(disturbance, prediction=prediction_is_better(loop))


@lru_cache(maxsize=64)
def _cached(tube: ErrorTube) -> ErrorTube:
    """Return the cached tube that equals this one, with everything it has already computed."""
    return tube


@checked
def largest_disturbance(
    scenario: Scenario, position: float, initial: tuple[float, float] = (0.0, 0.0)
) -> float:
    """Return the largest W [m/s²] with which the tube's position radius is at most `position` [m].

    Estimation errors, delay, share, and the gains of its `tracking`, if given, are the scenario's.
    The result is infinite only for an infinite radius, and 0 where the estimation errors alone
    exceed it.

    Raises:
        ValueError: the scenario has no disturbance, or the radius is negative or NaN.

    Examples:
        >>> print(f"{rho.largest_disturbance(rho.load_scenario('courier'), 0.5):.3f} m/s²")
        0.636 m/s²
    """
    if not position >= 0.0:
        raise ValueError(f"position: got {position}, expected a radius of at least 0 in m")
    if not scenario.disturbance:
        raise ValueError("scenario.disturbance: got None, expected one, which has the feedback")
    if scenario.disturbance.tracking:
        tube = error_tube(scenario, None if initial == (0.0, 0.0) else initial)
        loop = _loop(scenario, tube)._replace(limit=np.inf)
        return tolerable_wind(loop, tube.responses, position / tube.sample**2)
    tube = ErrorTube(scenario.disturbance, _grid_of_flight(scenario), initial=initial)
    loops = [_loop(scenario, tube)]
    if scenario.disturbance.prediction is None:
        loops = loops[0].alternatives
    return max(largest_wind(loop, position / tube.sample**2) for loop in loops)


def tightest_acceleration(scenario: Scenario) -> float:
    """Return the least bound on an acceleration of any vehicle [m/s²]; infinite if none has one.

    Bounds are the absolute bounds of boxes and the largest norms.
    """
    bounds, norms = scenario.fleet.bounds("acceleration"), scenario.fleet.norms
    sides = [] if bounds is None else [np.abs(bounds.lower), np.abs(bounds.upper)]
    most = [norms["max_acceleration"].limits] if "max_acceleration" in norms else []
    return min((float(each.min()) for each in (*sides, *most)), default=np.inf)


def _loop(scenario: Scenario, tube: ErrorTube) -> Loop:
    """Return the feedback loop for which gains are optimised."""
    limit = tube.disturbance.share * tightest_acceleration(scenario)
    W, E_p, E_v, r_p, r_v = map(float, tube.sizes)
    return Loop(tube.measurements, tube.samples, (W, E_p, E_v, r_p, r_v), limit)
