"""Winds as a study gives them, which become winds of `drake_rho.simulation.winds` in each run."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from drake_rho.scenario.fields import Finite, FloatArray, Positive, Vector, record
from drake_rho.scenario.records import Scenario
from drake_rho.simulation import winds
from drake_rho.simulation.winds import Wind


class Blowing(ABC):
    """What makes the wind of one run."""

    @abstractmethod
    def over(self, scenario: Scenario, rng: np.random.Generator) -> Wind:
        """A wind as strong as the scenario's disturbance says."""


@record
class ConstantWind(Blowing):
    """The strongest wind of the scenario in one direction."""

    wind: Literal["constant"]
    """its name"""
    direction: Vector | None = None
    """of any length; drawn for every run if not given"""

    def over(self, scenario: Scenario, rng: np.random.Generator) -> Wind:
        """The wind of one run."""
        return winds.constant(scenario, _direction(self.direction, rng))


@record
class Gust(Blowing):
    """A gust that rises to the strongest wind and falls again."""

    wind: Literal["gust"]
    """its name"""
    duration: Positive
    """of the whole gust [s]"""
    direction: Vector | None = None
    """of any length; drawn for every run if not given"""
    begin: Finite | None = None
    """on the scenario's clock [s]; drawn evenly over the flight if not given"""

    def over(self, scenario: Scenario, rng: np.random.Generator) -> Wind:
        """The wind of one run."""
        direction, grid = _direction(self.direction, rng), scenario.grid
        begin = float(rng.uniform(grid.start, grid.end)) if self.begin is None else self.begin
        return winds.gust(scenario, direction, begin=begin, duration=self.duration)


@record
class ColouredNoise(Blowing):
    """Gusts of their own for every vehicle and axis, with Dryden's spectrum."""

    wind: Literal["coloured_noise"]
    """its name"""
    correlation: Positive = 1.0
    """τ, the time in which it forgets [s]"""
    intensity: Positive = 0.5
    """standard deviation of each axis as a part of the strongest wind"""

    def over(self, scenario: Scenario, rng: np.random.Generator) -> Wind:
        """The wind of one run."""
        return winds.coloured_noise(
            scenario, rng, correlation=self.correlation, intensity=self.intensity
        )


AnyWind = Annotated[ConstantWind | Gust | ColouredNoise, Field(discriminator="wind")]
"""One of the winds, told apart by its name."""


def _direction(given: FloatArray | None, rng: np.random.Generator) -> FloatArray:
    return rng.normal(size=3) if given is None else given
