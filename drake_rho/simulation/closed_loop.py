"""Exact closed-loop simulation of point masses without a Drake diagram, for many flights."""

from __future__ import annotations

import dataclasses
from typing import Unpack

import numpy as np

from drake_rho.motion.flight import Flight, Window
from drake_rho.motion.plan import Plan
from drake_rho.motion.simulation import Simulation
from drake_rho.planning.horizon.receding_horizon import RecedingHorizon
from drake_rho.planning.horizon.settings import Windows, takes_windows
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario
from drake_rho.simulation import winds
from drake_rho.simulation.estimates import EstimationErrors
from drake_rho.simulation.feedback import Feedback
from drake_rho.simulation.small_steps import in_small_steps
from drake_rho.simulation.small_windows import as_flown
from drake_rho.simulation.timeline import Timeline
from drake_rho.simulation.winds import Wind, checked_wind


@dataclasses.dataclass(frozen=True)
class OnePlan:
    """Horizon of a single window: one plan tracked from its start to its end."""

    plan: Plan

    @property
    def scenario(self) -> Scenario:
        """Scenario of the plan."""
        return self.plan.scenario

    @property
    def knots(self) -> range:
        """Knots at which windows start: the first only."""
        return range(1)

    @property
    def flight(self) -> Flight:
        """Flight with the plan as its only window."""
        return Flight(self.plan, (Window(0, self.plan, self.plan),))

    @property
    def latency(self) -> int:
        """Number of samples by which states are predicted: none, without replanning."""
        return 0

    def step(self, states: FloatArray, time: float) -> Window:
        """Return the only window."""
        return self.flight.windows[0]


@takes_windows
def fly(
    scenario: Scenario,
    *,
    wind: Wind | None = None,
    rng: np.random.Generator | None = None,
    **windows: Unpack[Windows],
) -> Simulation:
    """Simulate point masses as `rho.simulate` does, but faster, without Drake's simulator.

    Raises:
        InfeasibleError: the first window has no plan.
        SolverError: the solvers fail numerically in the first window.
        ValueError: an argument is invalid.
    """
    horizon = RecedingHorizon(scenario, **windows)
    return flown(Feedback(as_flown(horizon)), wind, rng)


def fly_plan(
    scenario: Scenario,
    plan: Plan,
    *,
    wind: Wind | None = None,
    rng: np.random.Generator | None = None,
) -> Simulation:
    """Fly one plan in wind with the scenario's feedback, without replanning.

    Args:
        scenario: scenario with the disturbance and the feedback.
        plan: plan for the same vehicles and grid, possibly made for another disturbance.
        wind: wind to fly in; none if not given.
        rng: source of random estimation errors; without it there are none, unless the wind has
            its own.

    Raises:
        ValueError: the plan is for other vehicles or another grid, or the wind is invalid.
    """
    return flown(Feedback(OnePlan(in_small_steps(adopted(scenario, plan)))), wind, rng)


def adopted(scenario: Scenario, plan: Plan) -> Plan:
    """Return the plan as one of another scenario with the same vehicles and grid.

    Raises:
        ValueError: the scenario has another number of vehicles or another grid.
        ScenarioError: the scenario has another smoothing.
    """
    own = plan.scenario
    if own.smoothing != scenario.smoothing:
        expected = f"that of the plan, {own.smoothing}"
        raise ScenarioError("smoothing", scenario.smoothing, expected)
    if own.grid != scenario.grid or len(own.vehicles) != len(scenario.vehicles):
        expected = f"one for {len(scenario.vehicles)} vehicles on {scenario.grid}"
        raise ValueError(
            f"plan: got one for {len(own.vehicles)} on {own.grid}, expected {expected}"
        )
    return Plan(scenario, plan.positions, plan.velocities, plan.accelerations, plan.statistics)


def flown(feedback: Feedback, wind: Wind | None, rng: np.random.Generator | None) -> Simulation:
    """Fly point masses with feedback, once.

    Raises:
        ValueError: the wind is invalid, or `rng` is not a generator.
    """
    wind = winds.none() if wind is None else wind
    scenario = feedback.scenario
    timeline = Timeline.of(scenario, wind)
    errors = EstimationErrors.of(scenario, wind, rng)
    states = np.empty((len(timeline.times), len(feedback.starts), 6))
    acting, commands = np.empty((2, len(states), len(feedback.starts), 3))
    acting[:] = _known_before(wind, timeline, len(feedback.starts))
    states[0] = feedback.starts
    memory = feedback.start
    for j in range(feedback.samples):
        first, last = timeline.samples[j : j + 2]
        memory = feedback.next(memory, j, errors.added_to(j, states[first]))
        commands[first:last] = memory.commands[-1]
        here = slice(first, last + 1)
        _move(wind, timeline, here, states[here], acting[here], memory.commands[-1])
    acting[-1], commands[-1] = acting[-2], commands[-2]
    return Simulation(
        feedback.horizon.flight,
        timeline.times,
        states[..., :3],
        states[..., 3:],
        acting,
        commands,
        elapsed=timeline.elapsed,
        lost=errors.lost,
    )


def _known_before(wind: Wind, timeline: Timeline, vehicles: int) -> FloatArray:
    """Return a wind at all times [m/s²], shape (M, N, 3); NaN if it depends on the states."""
    shape = (len(timeline.times), vehicles, 3)
    if not hasattr(wind, "over"):
        return np.full(shape, np.nan)
    found = np.asarray(wind.over(timeline.times, vehicles), dtype=np.float64)
    if found.shape != shape or not np.isfinite(found).all():
        raise ValueError(f"wind: got shape {found.shape}, expected finite ones of shape {shape}")
    return found


def _move(
    wind: Wind,
    timeline: Timeline,
    here: slice,
    states: FloatArray,
    acting: FloatArray,
    command: FloatArray,
) -> None:
    """Fill in the wind, and the states that follow from the first one under one command."""
    steps = np.diff(timeline.elapsed[here])[:, None, None]
    p, v = states[..., :3], states[..., 3:]
    if np.isnan(acting[0, 0, 0]):
        for k, (h,) in enumerate(steps[:, 0]):
            acting[k] = checked_wind(wind, float(timeline.times[here][k]), p[k], v[k])
            a = command + acting[k]
            p[k + 1], v[k + 1] = p[k] + h * (v[k] + h / 2.0 * a), v[k] + h * a
        return
    a = command + acting[:-1]
    v[1:] = v[0] + np.cumsum(steps * a, axis=0)
    p[1:] = p[0] + np.cumsum(steps * (v[:-1] + steps / 2.0 * a), axis=0)
