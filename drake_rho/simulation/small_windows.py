"""Smoothed windows in small steps of constant acceleration, for simulation.

A window of a `RecedingHorizon` with smoothing is planned `lead` before its first knot, when its
averages begin (`drake_rho/planning/horizon/situation.py`). In small steps it begins there.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from drake_rho.motion.flight import Flight, Window
from drake_rho.motion.remainders import remainder
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.rest_of_flight import known_later
from drake_rho.simulation.feedback import Horizon
from drake_rho.simulation.small_steps import averaged_in, small_scenario, small_step


def as_flown(horizon: Horizon) -> Horizon:
    """Return a horizon to simulate: in small steps if it has smoothing."""
    return horizon if horizon.scenario.smoothing is None else SmallWindows(horizon)


class SmallWindows:
    """Horizon without smoothing, whose windows are averages of another horizon's.

    Contingencies belong to the other horizon's windows.

    Args:
        horizon: horizon of a scenario with smoothing.

    Attributes:
        windows: windows planned so far, in small steps.
    """

    def __init__(self, horizon: Horizon) -> None:
        scenario = horizon.scenario
        self._horizon, self._step = horizon, small_step(scenario)
        self._per_step = round(scenario.grid.step / self._step)
        self._whole: tuple[Scenario, Scenario] | None = None
        self.windows: list[Window] = []

    @property
    def scenario(self) -> Scenario:
        """Scenario of the flight in small steps, with the times at which obstacles become known."""
        given = self._horizon.scenario
        if self._whole is None or self._whole[0] is not given:
            self._whole = given, small_scenario(known_later(given, -given.lead), self._step)
        return self._whole[1]

    @property
    def knots(self) -> list[int]:
        """Small knots at which averages of windows begin, counted from 0."""
        return [self._per_step * knot for knot in self._horizon.knots]

    @property
    def latency(self) -> int:
        """Number of small samples by which states are predicted, for a window's planning time."""
        scenario = self._horizon.scenario
        sample = scenario.disturbance_or_calm.sample(scenario.grid)
        return self._horizon.latency * round(sample / self._step)

    def step(self, states: FloatArray, time: float) -> Window:
        """Return the window whose averages begin at a small knot.

        Args:
            states: estimated positions [m] and velocities [m/s], shape (N, 6).
            time: time of the small knot on the scenario's clock [s].
        """
        grid = self._horizon.scenario.grid
        knot = round((time - self.scenario.grid.start) / grid.step)
        window = self._horizon.step(states, float(grid.times[knot]))
        plan = averaged_in(self._from(self._per_step * knot), window.plan)
        changes: dict[str, Any] = {"plan": plan, "reference": plan, "contingency": None}
        window = dataclasses.replace(window, first_knot=self._per_step * knot, **changes)
        self.windows.append(window)
        return window

    def _from(self, knot: int) -> Scenario:
        """Return the scenario from the previous window's state at a small knot."""
        if not self.windows:
            return self.scenario
        last = self.windows[-1]
        return remainder(last.plan.scenario, last.plan.motion(), knot - last.first_knot)

    @property
    def flight(self) -> Flight:
        """Flight composed of the windows so far, each flown until the next."""
        return Flight.composed(self.scenario, self.windows)
