"""The sampled feedback that holds vehicles to the nominal of a receding horizon.

At sample j the command is a(t) + u_j: a is the nominal acceleration and

    u_j = -k_p (p_est - p_nom) - k_v (v_est - v_nom)     of sample j - d,

0 for the first d samples after the plan that is tracked began, as in `docs/flight.md`. Written once
for the loop without a diagram and for the one in Drake's systems: memory and estimate in, memory
out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Protocol, Self

import numpy as np

from drake_rho.motion.plan import Flight, Window
from drake_rho.motion.tube import error_tube
from drake_rho.scenario.disturbance import Disturbance
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario


class Horizon(Protocol):
    """What gives the windows: `rho.RecedingHorizon`, or what keeps one plan."""

    @property
    def scenario(self) -> Scenario:
        """What is flown."""
        ...

    @property
    def knots(self) -> Sequence[int]:
        """The knots at which windows start, counted from 0."""
        ...

    @property
    def flight(self) -> Flight:
        """The windows so far."""
        ...

    def step(self, states: FloatArray, time: float) -> Window:
        """The window flown from a knot on, at a time on the scenario's clock [s].

        Args:
            states: estimated positions [m] and velocities [m/s], shape (N, 6).
            time: of the knot [s].
        """
        ...


@dataclasses.dataclass(frozen=True, eq=False)
class Memory:
    """What the feedback knows from one sample to the next; never written to."""

    window: Window
    """in force"""
    since: int
    """the sample with which the plan that is tracked began"""
    estimates: tuple[FloatArray, ...] = ()
    """estimated states (N, 6), the latest last, one more of them than the delay has samples"""
    errors: tuple[FloatArray, ...] = ()
    """each of them less the plan that was in force then"""
    commands: tuple[FloatArray, ...] = ()
    """accelerations commanded (N, 3) [m/s²], the latest last"""

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Itself: for Drake, whose contexts copy the state that they keep."""
        return self


class Feedback:
    """The commands of one flight, from sample to sample.

    Plans the first window at once, from the scenario's starts: where it has no plan, that is told
    before anything flies.

    Raises:
        InfeasibleError: the first window has no solution; it raises what the horizon does.
    """

    def __init__(self, horizon: Horizon) -> None:
        scenario = horizon.scenario
        around = scenario.disturbance or Disturbance(0.0)
        self.scenario, self.horizon = scenario, horizon
        self.sample = around.sample(scenario.grid)
        self.samples = around.samples(scenario.grid)
        self._times = scenario.grid.times
        self._delay = around.delay
        self._per_step = around.samples_per_step(scenario.grid.step)
        self._knots = frozenset(horizon.knots)
        self._gains = np.array(error_tube(scenario).gains)
        self.starts = scenario.fleet.start_states
        self.start = Memory(horizon.step(self.starts, scenario.grid.start), 0)

    def next(self, memory: Memory, j: int, estimate: FloatArray) -> Memory:
        """What is known and commanded from sample j on, until the next.

        Args:
            memory: of the sample before, or `start`.
            j: number of the sample, from 0.
            estimate: of the states now, positions and velocities, shape (N, 6). A row that is not
                all finite is a vehicle that was not seen: it is taken to be as planned.
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
        error = np.where(seen, estimate - np.concatenate([p, v], axis=1), 0.0)
        errors = (*memory.errors, error)[-(d + 1) :]
        command = a
        if j - since >= d:  # the oldest error is then one from the plan that is tracked
            k_p, k_v = self._gains
            command = a - k_p * errors[0][:, :3] - k_v * errors[0][:, 3:]
        commands = (*memory.commands, command)[-max(d, 1) :]
        return Memory(window, since, estimates, errors, commands)

    def nominal(self, window: Window, elapsed: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Planned positions, velocities, accelerations, (N, 3) each, at a time since the start [s].

        After the last knot the plan goes on with the velocity it ends with.
        """
        plan, h = window.plan, self.scenario.grid.step
        s = elapsed - h * window.first_knot
        k = max(int(s / h + 1e-9), 0)
        if k >= plan.accelerations.shape[1]:
            k = plan.accelerations.shape[1]
            v = plan.velocities[:, k]
            return plan.positions[:, k] + (s - h * k) * v, v, np.zeros_like(v)
        s -= h * k
        v, a = plan.velocities[:, k], plan.accelerations[:, k]
        return plan.positions[:, k] + s * (v + s / 2.0 * a), v + s * a, a

    def _tracked_since(self, window: Window) -> int:
        """The sample with which the plan that a window tracks began."""
        around, grid = window.plan.scenario.disturbance, window.plan.scenario.grid
        tracking = None if around is None else around.tracking
        since = grid.start if tracking is None else tracking.since
        return round((since - self.scenario.grid.start) / self.sample)

    def _predicted(
        self, j: int, estimates: tuple[FloatArray, ...], commands: tuple[FloatArray, ...]
    ) -> FloatArray:
        """The states at sample j, of the estimate d samples ago and the commands given since."""
        d, h = min(self._delay, j), self.sample
        states = estimates[0] if j >= self._delay else self.starts
        p, v = states[:, :3], states[:, 3:]
        for a in commands[len(commands) - d :]:
            p, v = p + h * (v + h / 2.0 * a), v + h * a
        return np.concatenate([p, v], axis=1)
