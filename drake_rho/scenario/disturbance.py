"""What moves vehicles off their plans, and the sampled feedback that holds them near."""

from __future__ import annotations

import math
from typing import Annotated, Self

from pydantic import Field

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import LARGEST, NO_TRUTH, Finite, Positive, record, unchecked
from drake_rho.scenario.parts import Grid

NotNegative = Annotated[float, Field(ge=0.0, le=LARGEST, allow_inf_nan=False), NO_TRUTH]

_MOST_IN_A_STEP, _MOST = 1000, 1_000_000
"""Most feedback samples in a step and in a flight: what arrays over all of them have room for."""


@record
class Tracking:
    """Since when a feedback has held vehicles to a plan, and how.

    For the windows of a receding horizon, which do not begin where everything is known exactly.
    """

    since: Finite
    """time of the first knot of the plan that is tracked, on the scenario's clock [s]"""
    gains: tuple[Finite, Finite]
    """k_p [1/s²] and k_v [1/s]"""
    position: NotNegative = 0.0
    """largest error of the position then [m]"""
    velocity: NotNegative = 0.0
    """largest error of the velocity then [m/s]"""


@record
class Disturbance:
    """Unknown accelerations, errors of the estimated state, and the feedback against both.

    A vehicle moves by p'' = a + u + w: a is planned, w unknown, and u the feedback, constant from
    one sample to the next and linear in the estimated error of `delay` samples ago. At the first
    knot vehicles are at their starts exactly; a receding horizon that is given other states there
    takes them for estimates.

    Examples:
        >>> wind = rho.Disturbance(acceleration=0.5, feedback_every=0.05)
        >>> wind.acceleration
        0.5
    """

    acceleration: NotNegative
    """W, the largest norm of the unknown acceleration, from wind or from errors of the model
    [m/s²]"""
    position_error: NotNegative = 0.0
    """E_p, the largest distance of an estimated position from the true one [m]"""
    velocity_error: NotNegative = 0.0
    """E_v, the largest norm of the error of an estimated velocity [m/s]"""
    feedback_every: Positive | None = None
    """time from one sample of the feedback to the next, which divides the grid's step [s]; the step
    itself if not given"""
    delay: Annotated[int, Field(ge=0, le=50), NO_TRUTH] = 0
    """how many samples pass from an estimate to the feedback that is made of it, in samples"""
    share: Annotated[float, Field(gt=0.0, le=1.0, allow_inf_nan=False), NO_TRUTH] = 0.5
    """the part of the tightest acceleration limit that the feedback may take"""
    tracking: Tracking | None = None
    """of a plan under way, since when it is tracked; if not given, from the first knot on, where
    all vehicles are as planned, with the best gains"""

    def samples_per_step(self, step: float) -> int:
        """How many feedback samples there are in a step of the grid [s]."""
        return 1 if self.feedback_every is None else max(1, round(step / self.feedback_every))

    def samples(self, grid: Grid) -> int:
        """How many feedback samples there are in a flight."""
        return (grid.knots - 1) * self.samples_per_step(grid.step)

    def sample(self, grid: Grid) -> float:
        """The time from one feedback sample to the next on a grid [s]."""
        return grid.step / self.samples_per_step(grid.step)

    def check(self, grid: Grid) -> None:
        """See that the feedback fits the grid of the scenario that this is in.

        Raises:
            ScenarioError: its samples do not divide the step, or are too many; or it tracks a plan
                whose first knot is none of this grid, if that is continued backwards.
        """
        if self.tracking is not None:
            steps = (grid.start - self.tracking.since) / grid.step
            if round(steps) < 0 or abs(steps - round(steps)) > 1e-4:
                expected = f"a whole number of steps of {grid.step:g} s before {grid.start:g} s"
                raise ScenarioError("disturbance.tracking.since", self.tracking.since, expected)
        if self.feedback_every is None:
            return
        parts, most = grid.step / self.feedback_every, _most_per_step(grid)
        if not 1 <= round(parts) <= most or abs(parts - round(parts)) > 1e-9 * parts:
            expected = f"a time that divides the step, {grid.step:g} s, into 1 to {most} parts"
            raise ScenarioError("disturbance.feedback_every", self.feedback_every, expected)

    def first_error(self, grid: Grid) -> tuple[float, float]:
        """How far a state estimated now may be from the true one, position [m] and velocity [m/s].

        With a delay the estimate is as old as that, and is brought up to now by the commands that
        were given since: E_p + dδ E_v + W (dδ)²/2, and E_v + W dδ.
        """
        late = self.delay * self.sample(grid)
        velocity = self.velocity_error + self.acceleration * late
        return self.position_error + late * (self.velocity_error + velocity) / 2.0, velocity

    def for_grid(self, grid: Grid) -> Self:
        """This disturbance on another grid: samples are as long, or as little shorter as divides.

        For a planner that tries other steps. Where samples would be too many, they are longer.
        """
        if self.feedback_every is None:
            return self
        parts = math.ceil(grid.step / self.feedback_every * (1.0 - 1e-9))
        parts = min(max(parts, 1), _most_per_step(grid))
        return unchecked(self, feedback_every=grid.step / parts)


def _most_per_step(grid: Grid) -> int:
    """Most feedback samples that a step of a grid may have."""
    return min(_MOST_IN_A_STEP, max(1, _MOST // (grid.knots - 1)))
