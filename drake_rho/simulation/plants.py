"""Plants to simulate, whose lag counts as a delay of the feedback.

A quadrotor reaches a commanded acceleration `LAG` later. Planned accelerations are commanded that
much earlier, but feedback cannot be. Gains are therefore those of a loop with additional samples of
delay and without prediction, so that they are as slow as the lag requires (`docs/flight.md`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from pydrake.systems.framework import Context, System

from drake_rho.motion.scenario_tube import error_tube, tube_of
from drake_rho.planning.errors import InfeasibleError
from drake_rho.planning.horizon.settings import DEFAULTS, Windows
from drake_rho.scenario.disturbance import Tracking
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import steps_lasting
from drake_rho.simulation.attitude import LAG
from drake_rho.simulation.quadrotors import LONGEST, lean, quadrotors
from drake_rho.simulation.systems import WindyPointMass

_NEGLIGIBLE = 0.25
"""Largest lag that is ignored, in samples: all gains are stable with it."""


def _has_no_attitude(
    system: System, root: Context, accelerations: FloatArray, headings: FloatArray
) -> None:
    """Leave point masses as they are."""


@dataclasses.dataclass(frozen=True)
class Plant:
    """Kind of vehicles to simulate."""

    name: str
    """name in records"""
    system: Callable[[Scenario], System]
    """function that returns the system of a scenario's vehicles"""
    command: str = "command"
    """output port of the controller that it follows"""
    lag: float = 0.0
    """time from a commanded acceleration to the actual one [s]"""
    longest: float = np.inf
    """longest step of the simulation [s]"""
    turn: Callable[[System, Context, FloatArray, FloatArray], None] = _has_no_attitude
    """function that turns vehicles to their first attitudes, given the system, the context of the
    whole simulation, the first accelerations [m/s²], (N, 3), and the first headings [rad], (N,)"""

    @property
    def has_heading(self) -> bool:
        """Whether its vehicles have a heading."""
        return self.turn is not _has_no_attitude

    def lag_in_samples(self, scenario: Scenario) -> int:
        """Return the number of samples by which the plant delays the feedback of a scenario."""
        if scenario.disturbance is None:
            return 0
        sample = scenario.disturbance.sample(scenario.grid)
        return steps_lasting(self.lag, sample) if _NEGLIGIBLE * sample < self.lag else 0

    def declared(self, scenario: Scenario) -> Scenario:
        """Return a scenario whose feedback the plant can fly: the delay includes its lag.

        If measurements may be lost, the feedback needs prediction. Its gains are then those without
        prediction for measurements of the greatest possible age.
        """
        disturbance, lag = scenario.disturbance, self.lag_in_samples(scenario)
        if disturbance is None or lag == 0:
            return scenario
        slow = dataclasses.replace(
            disturbance,
            delay=disturbance.delay + lag + disturbance.dropouts,
            dropouts=0,
            prediction=False,
        )
        if disturbance.dropouts == 0:
            return dataclasses.replace(scenario, disturbance=slow)
        gains = error_tube(dataclasses.replace(scenario, disturbance=slow)).gains
        tracking = Tracking(scenario.grid.start - scenario.lead, gains)
        delayed = dataclasses.replace(
            disturbance, delay=disturbance.delay + lag, prediction=True, tracking=tracking
        )
        return dataclasses.replace(scenario, disturbance=delayed)

    def planned_ahead(self, scenario: Scenario, windows: Windows) -> Windows:
        """Return settings that plan windows early enough for the plant to turn.

        Args:
            scenario: scenario to fly.
            windows: given settings.

        Raises:
            ValueError: there is a disturbance, and windows follow each other faster than the plant
                turns, so that accelerations of a window would be commanded late.
        """
        if self.lag == 0.0:
            return windows
        settings, step = DEFAULTS | windows, scenario.grid.step
        every, fewest = settings["replan_every"], steps_lasting(self.lag, step)
        if scenario.disturbance is not None and every < fewest:
            lag = f"its lag is {self.lag:g} s, the step {step:g} s"
            expected = f"at least {fewest} for a {self.name}: {lag}"
            raise ValueError(f"replan_every: got {every!r}, expected {expected}")
        least = min(self.lag, every * step)
        latency = settings["latency"]
        return {**windows, "latency": least if 0.0 <= latency < least else latency}

    def check_declared(self, scenario: Scenario) -> None:
        """Check that the plant can fly a horizon's feedback.

        Raises:
            ValueError: the delay does not include the lag, or the feedback predicts.
        """
        disturbance, lag = scenario.disturbance, self.lag_in_samples(scenario)
        if disturbance is None or lag == 0:
            return
        tube = tube_of(scenario)
        slow = disturbance.dropouts > 0 or not tube.measurements.predicted
        if disturbance.delay >= lag and slow:
            return
        can = self.declared(scenario)
        more = f"{lag} sample{'s' if lag > 1 else ''} more for its lag of {self.lag:g} s"
        raise ValueError(
            f"scenario.disturbance: got feedback with {_gains(tube.gains)}, which a {self.name} "
            f"cannot hold, expected a delay of {more}, without prediction: "
            f"delay {can.disturbance_or_calm.delay}, {_gains(tube_of(can).gains)}"
        )

    def with_gains(self, error: InfeasibleError, scenario: Scenario) -> InfeasibleError:
        """Return the error of the first window, extended by the gains that the plant can hold.

        Args:
            error: error of the first window.
            scenario: scenario with feedback that the plant can fly.
        """
        own = f"{_gains(tube_of(scenario).gains)} that a {self.name} can hold"
        because = error.because or "constraints cannot be met together"
        return error.replaced(because=f"{because}, with the {own}")


PLANTS = {
    None: Plant("point mass", WindyPointMass),
    "quadrotor": Plant("quadrotor", quadrotors, "ahead", LAG, LONGEST, lean),
}
"""Plants by the argument of `simulate`."""


def _gains(gains: tuple[float, float]) -> str:
    k_p, k_v = gains
    return f"gains of {k_p:.3g} 1/s² and {k_v:.3g} 1/s"
