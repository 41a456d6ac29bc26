"""Sampled feedback that tracks the nominal motion of a receding horizon.

At sample j the command is a(t) + u_j, where a is the nominal acceleration and

    u_j = -k_p (p_est - p_nom) - k_v (v_est - v_nom).

The estimate is the newest measurement available, d samples old or more, propagated to sample j by
the commands since. Until a measurement taken during the tracked plan arrives, u_j = 0. Without
prediction, estimate and plan are those of sample j - d (`docs/flight.md`). The feedback maps its
memory and a measurement to a new memory; the simulation without a diagram and the Drake system
share it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Protocol, Self

import numpy as np

from drake_rho.motion.flight import Flight, Window
from drake_rho.motion.scenario_tube import error_tube
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import steps_begun


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

    @property
    def latency(self) -> int:
        """Number of samples by which states are predicted, for the planning time of a window."""
        ...

    def step(self, states: FloatArray, time: float) -> Window:
        """Return the window to fly from a knot on.

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
    planned: Window
    """latest window planned, which begins after the latency"""
    since: int
    """sample at which the tracked plan began"""
    states: FloatArray
    """estimated states at the sample, (N, 6)"""
    arrived: IntArray
    """sample of the newest measurement of each vehicle, (N,); -1 if none has arrived"""
    measured: tuple[FloatArray, ...] = ()
    """latest measured states (N, 6), the newest last: one more than the delay in samples"""
    errors: tuple[FloatArray, ...] = ()
    """measured states minus those of the plan tracked at that time, (N, 6) each; empty if the
    feedback predicts the state"""
    sample: int = -1
    """number of the latest sample"""
    feedback: tuple[FloatArray, ...] = ()
    """feedback of the latest samples (N, 3) [m/s²], the newest last: one more than the lag"""
    commands: tuple[FloatArray, ...] = ()
    """accelerations commanded for the latest samples (N, 3) [m/s²], the newest last"""

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Return the memory itself, since Drake's contexts copy their state."""
        return self


class Feedback:
    """Commands of one flight, sample by sample.

    The constructor plans the first window from the scenario's starts, so a missing plan is reported
    before anything flies.

    Args:
        horizon: planner of windows.
        lag: number of samples of the scenario's delay between a command and its effect; the
            measurement delay is that much shorter. The feedback of a sample acts this many samples
            later, as the scenario says, whatever the plant's own lag.

    Raises:
        InfeasibleError: the first window has no plan; other errors of the horizon are passed on.
    """

    def __init__(self, horizon: Horizon, lag: int = 0) -> None:
        scenario = horizon.scenario
        disturbance = scenario.disturbance_or_calm
        self.scenario, self.horizon = scenario, horizon
        self._held = disturbance.steps_per_sample(scenario.grid.step)
        self.sample = disturbance.sample(scenario.grid) / self._held
        self.samples = round(scenario.grid.duration / self.sample)
        self._times = scenario.grid.times
        self._lag = lag * self._held
        self._delay = disturbance.delay * self._held - self._lag
        self._dropouts = disturbance.dropouts * self._held
        self._per_step = disturbance.samples_per_step(scenario.grid.step)
        self._knots, self._latency = frozenset(horizon.knots), horizon.latency
        tube = error_tube(scenario)
        self._gains, self._predicts = np.array(tube.gains), tube.measurements.predicted
        self.starts = scenario.fleet.start_states
        none = np.full(len(self.starts), -1)
        first = horizon.step(self.starts, scenario.grid.start)
        self.start = Memory(first, first, 0, self.starts, none)

    def next(self, memory: Memory, j: int, measured: FloatArray) -> Memory:
        """Return the memory after sample j, with the command until the next sample.

        Args:
            memory: memory of the sample before, or `start`.
            j: number of the sample, from 0.
            measured: measured positions and velocities at the sample, shape (N, 6), which arrive
                after the delay. A row with a value that is not finite is a lost measurement.
        """
        seen = np.isfinite(measured).all(axis=1, keepdims=True)
        latest = (*memory.measured, np.where(seen, measured, np.nan))[-(self._delay + 1) :]
        states, arrived = self._estimated(memory, j, latest)
        now = dataclasses.replace(memory, states=states, arrived=arrived, measured=latest)
        now = self._adopted(self._planned(self._adopted(now, j), j), j)
        if j % self._held == 0:  # otherwise it is held while the plan's acceleration changes
            now = self._answered(now, j)
        else:
            now = dataclasses.replace(now, feedback=(*now.feedback, now.feedback[-1]))
        feedback = now.feedback[-(self._lag + 1) :]
        now = dataclasses.replace(now, sample=j, feedback=feedback)
        a = self.nominal(now.window, j * self.sample)[2]
        commands = (*now.commands, a + self._acting(feedback, j, j, now.since))
        return dataclasses.replace(now, commands=commands[-max(self._delay, 1) :])

    def commanded(self, memory: Memory, elapsed: float, ahead: float) -> FloatArray:
        """Return commands (N, 3) [m/s²] at a time, with planned accelerations in advance.

        Args:
            memory: memory of the current sample, or `start`.
            elapsed: time since the start [s].
            ahead: time by which planned accelerations are commanded in advance [s].
        """
        later = elapsed + ahead
        i = int(steps_begun(later, self.sample))
        window = self._in_force(memory, i)
        acting = self._acting(memory.feedback, memory.sample, i, self._tracked_since(window))
        return self.nominal(window, later)[2] + acting

    def _in_force(self, memory: Memory, i: int) -> Window:
        """Return the window in force at a sample: the current or the planned one."""
        begins = memory.planned.first_knot * self._per_step
        return memory.planned if i >= begins else memory.window

    def _acting(
        self, feedback: Sequence[FloatArray], j: int, i: int, since: int
    ) -> FloatArray | float:
        """Return the feedback (N, 3) that acts at a sample, computed `lag` samples earlier.

        Args:
            feedback: feedback of the samples up to j, the newest last.
            j: number of the latest sample.
            i: number of the sample at which it acts.
            since: sample at which the plan tracked at sample i began; feedback of an earlier plan
                does not act.
        """
        of = min(i - self._lag, j)
        return 0.0 if of < since or j - of >= len(feedback) else feedback[of - j - 1]

    def _answered(self, now: Memory, j: int) -> Memory:
        """Return the memory with the feedback of sample j."""
        errors = now.errors
        if self._predicts:
            window = self._in_force(now, j + self._lag)
            arrived = now.arrived >= self._tracked_since(window)
            states = self._when_it_acts(now, now.feedback, j, now.states)
            error = states - self._nominal_states(window, j + self._lag)
            error = np.where(arrived[:, None], error, 0.0)
        else:
            error = now.measured[-1] - self._nominal_states(now.window, j)
            errors = (*errors, np.nan_to_num(error))  # a lost measurement counts as no error
            errors = errors[-(self._delay // self._held + 1) :]
            error = errors[0] if j - now.since >= self._delay else np.zeros_like(error)
        return dataclasses.replace(
            now, errors=errors, feedback=(*now.feedback, self._answer(error))
        )

    def _when_it_acts(
        self, now: Memory, feedback: Sequence[FloatArray], j: int, states: FloatArray
    ) -> FloatArray:
        """Predict states (N, 6) from sample j to the time at which its feedback acts.

        Args:
            now: memory with the windows.
            feedback: feedback of the samples before j, the newest last.
            j: number of the sample.
            states: states at the sample, shape (N, 6).
        """
        for i in range(j, j + self._lag):
            window = self._in_force(now, i)
            acting = self._acting(feedback, j - 1, i, self._tracked_since(window))
            states = self._moved(states, (self.nominal(window, i * self.sample)[2] + acting,))
        return states

    def _planned(self, now: Memory, j: int) -> Memory:
        """Return the memory with the next window, if planning it begins at sample j."""
        knot, past = divmod(j + self._latency, self._per_step)
        if past > 0 or knot == 0 or knot not in self._knots:
            return now
        oldest = j - self._delay - self._dropouts  # older ones are too uncertain for a window
        if self._latency > self._lag:  # feedback of samples from j on acts before the window
            oldest = max(oldest, now.since)  # and predicts it, once it has begun
        states = np.where((now.arrived < oldest)[:, None], np.nan, self._expected(now, j))
        return dataclasses.replace(now, planned=self.horizon.step(states, float(self._times[knot])))

    def _adopted(self, now: Memory, j: int) -> Memory:
        """Return the memory with the planned window in force, if it begins at sample j."""
        planned = now.planned
        if planned is now.window or planned.first_knot * self._per_step != j:
            return now
        return dataclasses.replace(now, window=planned, since=self._tracked_since(planned))

    def _expected(self, now: Memory, j: int) -> FloatArray:
        """Predict the states at the beginning of the window planned at sample j, (N, 6).

        The prediction starts at the estimates and applies the feedback without disturbances.
        """
        age = 0 if self._predicts or j < self._delay else self._delay  # 0 if none has arrived
        path = [now.states if age == 0 else now.measured[0]]  # states of samples j - age to j
        for command in now.commands[len(now.commands) - age :]:
            path.append(self._moved(path[-1], (command,)))
        feedback, ahead = list(now.feedback), self._lag if self._predicts else 0
        for i in range(j, j + self._latency):
            states = self._when_it_acts(now, feedback, i, path[0]) if ahead else path[0]
            error = states - self._nominal_states(now.window, i - age + ahead)
            feedback.append(self._answer(error))
            acting = self._acting(feedback, i, i, now.since)
            command = self.nominal(now.window, i * self.sample)[2] + acting
            path = [*path[1:], self._moved(path[-1], (command,))][-(age + 1) :]
        return path[-1]

    def _answer(self, error: FloatArray) -> FloatArray:
        """Return the feedback for errors of states (N, 6)."""
        k_p, k_v = self._gains
        feedback: FloatArray = -k_p * error[:, :3] - k_v * error[:, 3:]
        return feedback

    def _nominal_states(self, window: Window, j: int) -> FloatArray:
        """Return planned positions and velocities at sample j, shape (N, 6)."""
        return np.concatenate(self.nominal(window, j * self.sample)[:2], axis=1)

    def nominal(self, window: Window, elapsed: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return planned positions, velocities and accelerations at a time since the start [s].

        They have shape (N, 3) each. After the last knot the final velocity is kept.
        """
        plan, h = window.plan, self.scenario.grid.step
        s = elapsed - h * window.first_knot
        k = max(int(steps_begun(s, h)), 0)
        if k >= plan.accelerations.shape[1]:
            k = plan.accelerations.shape[1]
            v = plan.velocities[:, k]
            return plan.positions[:, k] + (s - h * k) * v, v, np.zeros_like(v)
        s -= h * k
        v, a = plan.velocities[:, k], plan.accelerations[:, k]
        return plan.positions[:, k] + s * (v + s / 2.0 * a), v + s * a, a

    def _tracked_since(self, window: Window) -> int:
        """Return the sample at which a window's plan began."""
        tracking = window.plan.scenario.disturbance_or_calm.tracking
        since = tracking.since if tracking else window.plan.scenario.grid.start
        return round((since - self.scenario.grid.start) / self.sample)

    def _estimated(
        self, memory: Memory, j: int, latest: tuple[FloatArray, ...]
    ) -> tuple[FloatArray, IntArray]:
        """Return the estimated states at sample j, and the samples of the measurements used.

        Args:
            memory: memory of the sample before.
            j: number of the sample.
            latest: measured states of samples j - d to j, where available.
        """
        d = self._delay
        states = memory.states
        if j > 0:
            states = self._moved(states, memory.commands[-1:])
        if j < d or (j - d) % self._held > 0:
            return states, memory.arrived
        arrives = np.asarray(np.isfinite(latest[0]).all(axis=1))
        newer = self._moved(latest[0], memory.commands[len(memory.commands) - d :])
        newest = np.where(arrives, j - d, memory.arrived)
        return np.where(arrives[:, None], newer, states), newest

    def _moved(self, states: FloatArray, commands: tuple[FloatArray, ...]) -> FloatArray:
        """Propagate states (N, 6) over samples with given commands."""
        p, v, h = states[:, :3], states[:, 3:], self.sample
        for a in commands:
            p, v = p + h * (v + h / 2.0 * a), v + h * a
        return np.concatenate([p, v], axis=1)
