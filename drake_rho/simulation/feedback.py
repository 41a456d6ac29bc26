"""Sampled feedback that tracks the nominal motion of a receding horizon.

At sample j the command is a(t) + u_j, where a is the nominal acceleration and

    u_j = -k_p (p_est - p_nom) - k_v (v_est - v_nom)     of sample j - d,

and u_j = 0 for the first d samples after the tracked plan began, as in `docs/flight.md`. The
feedback maps its memory and an estimate to a new memory; the simulation without a diagram and the
Drake system share it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Protocol, Self

import numpy as np

from drake_rho.motion.flight import Flight, Window
from drake_rho.motion.scenario_tube import error_tube
from drake_rho.scenario.disturbance import Disturbance
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import SAME_TIME
from drake_rho.scenario.records import Scenario


class Horizon(Protocol):
    """Interface of planners of windows: `rho.RecedingHorizon`, or a single plan."""

    @property
    def scenario(self) -> Scenario:
        """Scenario of the flight."""
        ...

    @property
    def knots(self) -> Sequence[int]:
        """Knots at which windows start, counted from 0."""
        ...

    @property
    def flight(self) -> Flight:
        """Windows so far, as a flight."""
        ...

    def step(self, states: FloatArray, time: float) -> Window:
        """Return the window that is flown from a knot on.

        Args:
            states: estimated positions [m] and velocities [m/s], shape (N, 6).
            time: time of the knot on the scenario's clock [s].
        """
        ...


@dataclasses.dataclass(frozen=True, eq=False)
class Memory:
    """State of the feedback between two samples; immutable."""

    window: Window
    """current window"""
    since: int
    """sample at which the tracked plan began"""
    estimates: tuple[FloatArray, ...] = ()
    """latest estimated states (N, 6), the newest last: one more than the delay in samples"""
    errors: tuple[FloatArray, ...] = ()
    """estimates minus the states of the plan that was tracked at their time, (N, 6) each"""
    commands: tuple[FloatArray, ...] = ()
    """latest commanded accelerations (N, 3) [m/s²], the newest last"""

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Return the memory itself, since Drake's contexts copy their state."""
        return self


class Feedback:
    """Commands of one flight, sample by sample.

    The constructor plans the first window from the scenario's starts, so a missing plan is reported
    before anything flies.

    Raises:
        InfeasibleError: the first window has no plan; other errors of the horizon are passed on.
    """

    def __init__(self, horizon: Horizon) -> None:
        scenario = horizon.scenario
        disturbance = scenario.disturbance or Disturbance(0.0)
        self.scenario, self.horizon = scenario, horizon
        self._held = disturbance.steps_per_sample(scenario.grid.step)
        self.sample = disturbance.sample(scenario.grid) / self._held
        self.samples = round(scenario.grid.duration / self.sample)
        self._times = scenario.grid.times
        self._delay = disturbance.delay
        self._per_step = disturbance.samples_per_step(scenario.grid.step)
        self._knots = frozenset(horizon.knots)
        self._gains = np.array(error_tube(scenario).gains)
        self.starts = scenario.fleet.start_states
        self.start = Memory(horizon.step(self.starts, scenario.grid.start), 0)

    def next(self, memory: Memory, j: int, estimate: FloatArray) -> Memory:
        """Return the memory after sample j, with the command until the next sample.

        Args:
            memory: memory of the sample before, or `start`.
            j: number of the sample, from 0.
            estimate: estimated positions and velocities at the sample, shape (N, 6). A row with a
                value that is not finite is a vehicle that was not observed: it is assumed to be as
                planned.
        """
        d = self._delay
        seen = np.isfinite(estimate).all(axis=1, keepdims=True)
        estimate = np.where(seen, estimate, np.nan)
        estimates = (*memory.estimates, estimate)[-(d + 1) :]
        window, since = memory.window, memory.since
        knot, past = divmod(j, self._per_step)
        if j > 0 and past == 0 and knot in self._knots:
            states = self._predicted(j, estimates, memory.commands)
            window = self.horizon.step(states, float(self._times[knot]))
            since = self._tracked_since(window)
        p, v, a = self.nominal(window, j * self.sample)
        errors = memory.errors
        if j % self._held == 0:  # else the feedback is held while the plan's acceleration changes
            error = np.where(seen, estimate - np.concatenate([p, v], axis=1), 0.0)
            errors = (*errors, error)[-(d + 1) :]
        command = a
        if (j - since) // self._held >= d:  # the oldest error then refers to the tracked plan
            k_p, k_v = self._gains
            command = a - k_p * errors[0][:, :3] - k_v * errors[0][:, 3:]
        commands = (*memory.commands, command)[-max(d, 1) :]
        return Memory(window, since, estimates, errors, commands)

    def nominal(self, window: Window, elapsed: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return planned positions, velocities and accelerations at a time since the start [s].

        They have shape (N, 3) each. After the last knot the final velocity is kept.
        """
        plan, h = window.plan, self.scenario.grid.step
        s = elapsed - h * window.first_knot
        k = max(int(s / h + SAME_TIME), 0)
        if k >= plan.accelerations.shape[1]:
            k = plan.accelerations.shape[1]
            v = plan.velocities[:, k]
            return plan.positions[:, k] + (s - h * k) * v, v, np.zeros_like(v)
        s -= h * k
        v, a = plan.velocities[:, k], plan.accelerations[:, k]
        return plan.positions[:, k] + s * (v + s / 2.0 * a), v + s * a, a

    def _tracked_since(self, window: Window) -> int:
        """Return the sample at which the plan that a window tracks began."""
        disturbance, grid = window.plan.scenario.disturbance, window.plan.scenario.grid
        tracking = None if disturbance is None else disturbance.tracking
        since = grid.start if tracking is None else tracking.since
        return round((since - self.scenario.grid.start) / self.sample)

    def _predicted(
        self, j: int, estimates: tuple[FloatArray, ...], commands: tuple[FloatArray, ...]
    ) -> FloatArray:
        """Return states at sample j, from the estimate of d samples ago and the commands since."""
        d, h = min(self._delay, j), self.sample
        states = estimates[0] if j >= self._delay else self.starts
        p, v = states[:, :3], states[:, 3:]
        for a in commands[len(commands) - d :]:
            p, v = p + h * (v + h / 2.0 * a), v + h * a
        return np.concatenate([p, v], axis=1)
