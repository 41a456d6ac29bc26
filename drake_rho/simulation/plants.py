"""Feedback for a plant with lag, which counts as a delay of the loop.

A quadrotor reaches a commanded acceleration `LAG` later. Planned accelerations are commanded that
much earlier, but feedback cannot be. Gains are therefore those of a loop with additional samples of
delay and without prediction, so that they are as slow as the lag requires (`docs/flight.md`).
"""

from __future__ import annotations

import dataclasses

from drake_rho.motion.scenario_tube import error_tube, tube_of
from drake_rho.planning.errors import InfeasibleError
from drake_rho.planning.horizon.settings import DEFAULTS, Windows
from drake_rho.scenario.disturbance import Tracking
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import steps_lasting
from drake_rho.simulation.attitude import LAG

_NEGLIGIBLE = 0.25
"""Largest lag that is ignored, in samples: all gains are stable with it."""


def lag_in_samples(scenario: Scenario) -> int:
    """Return the number of samples by which a quadrotor delays the feedback."""
    if scenario.disturbance is None:
        return 0
    sample = scenario.disturbance.sample(scenario.grid)
    return steps_lasting(LAG, sample) if _NEGLIGIBLE * sample < LAG else 0


def declared(scenario: Scenario) -> Scenario:
    """Return a scenario whose feedback a quadrotor can fly: the delay includes its lag.

    If measurements may be lost, the feedback needs prediction. Its gains are then those without
    prediction for measurements of the greatest possible age.
    """
    disturbance, lag = scenario.disturbance, lag_in_samples(scenario)
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


def planned_ahead(scenario: Scenario, windows: Windows) -> Windows:
    """Return settings that plan windows early enough for a quadrotor to turn.

    Args:
        scenario: scenario to fly.
        windows: given settings.

    Raises:
        ValueError: there is a disturbance, and windows follow each other faster than a quadrotor
            turns, so that accelerations of a window would be commanded late.
    """
    settings, step = DEFAULTS | windows, scenario.grid.step
    every, fewest = settings["replan_every"], steps_lasting(LAG, step)
    if scenario.disturbance is not None and every < fewest:
        expected = f"at least {fewest} for a quadrotor: its lag is {LAG:g} s, the step {step:g} s"
        raise ValueError(f"replan_every: got {every!r}, expected {expected}")
    least = min(LAG, every * step)
    latency = settings["latency"]
    return {**windows, "latency": least if 0.0 <= latency < least else latency}


def check_declared(scenario: Scenario) -> None:
    """Check that a quadrotor can fly a horizon's feedback.

    Raises:
        ValueError: the delay does not include the lag, or the feedback predicts.
    """
    disturbance, lag = scenario.disturbance, lag_in_samples(scenario)
    if disturbance is None or lag == 0:
        return
    tube = tube_of(scenario)
    if disturbance.delay >= lag and (disturbance.dropouts > 0 or not tube.measurements.predicted):
        return
    can = declared(scenario).disturbance
    raise ValueError(
        f"scenario.disturbance: got feedback with {_gains(tube.gains)}, which a quadrotor cannot "
        f"hold, expected a delay of {_lag(lag)} more for its lag of {LAG:g} s, without prediction: "
        f"delay {can.delay if can else lag}, {_gains(tube_of(declared(scenario)).gains)}"
    )


def with_gains(error: InfeasibleError, scenario: Scenario) -> InfeasibleError:
    """Return the error of the first window, extended by the gains that a quadrotor can hold.

    Args:
        error: error of the first window.
        scenario: scenario with feedback that a quadrotor can fly.
    """
    own = f"{_gains(tube_of(scenario).gains)} that a quadrotor can hold"
    because = error.because or "constraints cannot be met together"
    return error.replaced(because=f"{because}, with the {own}")


def _gains(gains: tuple[float, float]) -> str:
    k_p, k_v = gains
    return f"gains of {k_p:.3g} 1/s² and {k_v:.3g} 1/s"


def _lag(samples: int) -> str:
    return f"{samples} sample{'s' if samples > 1 else ''}"
