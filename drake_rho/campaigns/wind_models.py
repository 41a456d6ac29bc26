"""Wind models of studies; each run makes one into a wind of `drake_rho.simulation.winds`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from drake_rho.scenario.fields import Finite, FloatArray, Positive, Vector, record
from drake_rho.scenario.records import Scenario
from drake_rho.simulation import winds
from drake_rho.simulation.winds import Wind


class WindModel(ABC):
    """Model from which each run makes its wind."""

    @abstractmethod
    def over(self, scenario: Scenario, rng: np.random.Generator) -> Wind:
        """Return the wind of one run, as strong as the scenario's disturbance allows."""


@record
class ConstantWind(WindModel):
    """Constant wind: the strongest of the scenario in one direction."""

    wind: Literal["constant"]
    """name of the model"""
    direction: Vector | None = None
    """direction, of any length above 0; drawn for every run if not given"""

    def over(self, scenario: Scenario, rng: np.random.Generator) -> Wind:
        """Return the wind of one run."""
        return winds.constant(scenario, _direction(self.direction, rng))


@record
class Gust(WindModel):
    """Gust that rises to the strongest wind and falls again."""

    wind: Literal["gust"]
    """name of the model"""
    duration: Positive
    """duration of the whole gust [s]"""
    direction: Vector | None = None
    """direction, of any length above 0; drawn for every run if not given"""
    begin: Finite | None = None
    """beginning on the scenario's clock [s]; drawn uniformly over the flight if not given"""

    def over(self, scenario: Scenario, rng: np.random.Generator) -> Wind:
        """Return the wind of one run."""
        direction, grid = _direction(self.direction, rng), scenario.grid
        begin = float(rng.uniform(grid.start, grid.end)) if self.begin is None else self.begin
        return winds.gust(scenario, direction, begin=begin, duration=self.duration)


@record
class ColouredNoise(WindModel):
    """Noise with Dryden's spectrum, independent for every vehicle and axis."""

    wind: Literal["coloured_noise"]
    """name of the model"""
    correlation: Positive = 1.0
    """correlation time τ [s]"""
    intensity: Positive = 0.5
    """standard deviation of each axis, relative to the strongest wind"""

    def over(self, scenario: Scenario, rng: np.random.Generator) -> Wind:
        """Return the wind of one run."""
        return winds.coloured_noise(
            scenario, rng, correlation=self.correlation, intensity=self.intensity
        )


AnyWind = Annotated[ConstantWind | Gust | ColouredNoise, Field(discriminator="wind")]
"""One of the wind models, distinguished by its name."""


def _direction(given: FloatArray | None, rng: np.random.Generator) -> FloatArray:
    return rng.normal(size=3) if given is None else given
