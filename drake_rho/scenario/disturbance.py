"""Disturbances that move vehicles off their plans, and the sampled feedback against them."""

from __future__ import annotations

import math
from typing import Annotated, Self

from pydantic import Field, model_validator

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import (
    LARGEST,
    NOT_BOOLEAN,
    Boolean,
    Finite,
    Positive,
    record,
    unchecked,
)
from drake_rho.scenario.parts import Grid
from drake_rho.scenario.times import divides, steps_lasting

_Size = Annotated[float, Field(ge=0.0, le=LARGEST, allow_inf_nan=False), NOT_BOOLEAN]

_MOST_IN_A_STEP, _MOST = 1000, 1_000_000
"""Largest numbers of feedback samples in a step and in a flight, which bound the size of arrays."""


@record
class Tracking:
    """Feedback that has tracked a plan since an earlier time.

    It describes windows of a receding horizon, whose initial states are not known exactly.
    """

    since: Finite
    """time of the first knot of the tracked plan, on the scenario's clock [s]"""
    gains: tuple[Finite, Finite]
    """gains of the feedback, k_p [1/s²] and k_v [1/s]"""
    position: _Size = 0.0
    """largest position error at that time [m]"""
    velocity: _Size = 0.0
    """largest velocity error at that time [m/s]"""
    prediction: Boolean = True
    """whether the feedback predicts the present state (`Disturbance.prediction`)"""


@record
class Disturbance:
    """Unknown accelerations, errors of the estimated state, and the feedback against both.

    The motion of a vehicle is p'' = a + u + w with the planned acceleration a, the unknown one w,
    and the feedback u. The feedback is constant from one sample to the next and linear in the
    error, either predicted from the newest measurement that has arrived or as measured some time
    ago. At the first knot, vehicles are exactly at their starts; a receding horizon with other
    given states there treats them as estimates.

    Examples:
        >>> wind = rho.Disturbance(acceleration=0.5, feedback_every=0.05)
        >>> wind.acceleration
        0.5
    """

    acceleration: _Size
    """W, the largest norm of the unknown acceleration, from wind or model errors [m/s²]"""
    position_error: _Size = 0.0
    """E_p, the largest distance of an estimated position from the true one [m]"""
    velocity_error: _Size = 0.0
    """E_v, the largest norm of the error of an estimated velocity [m/s]"""
    feedback_every: Positive | None = None
    """time from one sample of the feedback to the next, which divides the grid's step [s]; the step
    itself if not given. In a scenario with `tracking` it may also be several steps"""
    delay: Annotated[int, Field(ge=0, le=50), NOT_BOOLEAN] = 0
    """number of samples from a measurement to the feedback that answers it"""
    share: Annotated[float, Field(gt=0.0, le=1.0, allow_inf_nan=False), NOT_BOOLEAN] = 0.5
    """part of the tightest acceleration limit that is reserved for the feedback"""
    tracking: Tracking | None = None
    """feedback that already tracks a plan under way; if not given, feedback with the best gains
    begins at the first knot, where all vehicles are exactly at their starts"""
    dropouts: Annotated[int, Field(ge=0, le=50), NOT_BOOLEAN] = 0
    """largest number of measurements in a row that may be lost; needs `prediction`"""
    prediction: Boolean | None = None
    """whether the feedback predicts the present state from the newest measurement and its own
    effect since; if false, it is linear in the error measured `delay` samples before; if not given,
    the one with the smaller error tube"""

    @model_validator(mode="after")
    def _check(self) -> Self:
        expected = "true or none, since measurements may be lost (dropouts)"
        if self.dropouts > 0 and self.prediction is False:
            raise ScenarioError("prediction", False, expected)
        if self.dropouts > 0 and self.tracking is not None and not self.tracking.prediction:
            raise ScenarioError("tracking.prediction", False, expected)
        return self

    def samples_per_step(self, step: float) -> int:
        """Return the number of feedback samples in a step of the grid [s]."""
        return max(1, round(step / (self.feedback_every or step)))

    def steps_per_sample(self, step: float) -> int:
        """Return the number of steps of the grid [s] in a sample of the feedback: 1 or more.

        Only a simulated smooth motion has more, whose steps are small.
        """
        return max(1, round((self.feedback_every or step) / step))

    def samples(self, grid: Grid) -> int:
        """Return the number of feedback samples in a flight; the last one may be cut short."""
        steps = math.ceil((grid.knots - 1) / self.steps_per_sample(grid.step))
        return steps * self.samples_per_step(grid.step)

    def sample(self, grid: Grid) -> float:
        """Return the time from one feedback sample to the next on a grid [s]."""
        step = grid.step * self.steps_per_sample(grid.step)
        return step / self.samples_per_step(grid.step)

    def check(self, grid: Grid, lead: float = 0.0) -> None:
        """Check that the feedback fits the grid of its scenario.

        Args:
            grid: the grid.
            lead: time by which the motion begins before the first knot [s].

        Raises:
            ScenarioError: its samples do not divide the step, or there are too many; or the first
                knot of the tracked plan is not a knot of the grid extended backwards in time.
        """
        if self.tracking is not None:
            start = grid.start - lead
            steps = (start - self.tracking.since) / grid.step
            if round(steps) < 0 or abs(steps - round(steps)) > 1e-4:
                expected = f"a whole number of steps of {grid.step:g} s before {start:g} s"
                raise ScenarioError("disturbance.tracking.since", self.tracking.since, expected)
        every, most = self.feedback_every or grid.step, _most_per_step(grid)
        whole = self.steps_per_sample(grid.step)
        if self.tracking is not None and whole > 1 and divides(every, whole * grid.step):
            return
        if round(grid.step / every) > most or not divides(every, grid.step):
            expected = f"a time that divides the step, {grid.step:g} s, into 1 to {most} parts"
            raise ScenarioError("disturbance.feedback_every", self.feedback_every, expected)

    def first_error(self, grid: Grid) -> tuple[float, float]:
        """Return the largest errors of the present estimate, position [m] and velocity [m/s].

        With a delay of d samples of length δ and up to m lost measurements in a row, the newest
        measurement is up to D = d + m samples old and is propagated to the present by the commands
        since: E_p + Dδ E_v + W (Dδ)²/2, and E_v + W Dδ.
        """
        age = (self.delay + self.dropouts) * self.sample(grid)
        velocity = self.velocity_error + self.acceleration * age
        return self.position_error + age * (self.velocity_error + velocity) / 2.0, velocity

    def for_grid(self, grid: Grid) -> Self:
        """Return the disturbance for another grid, for planners that try other steps.

        Samples keep their length or, if that does not divide the step, are shortened as little as
        possible. They are longer if there would be too many.
        """
        if self.feedback_every is None:
            return self
        parts = steps_lasting(grid.step, self.feedback_every)
        parts = min(max(parts, 1), _most_per_step(grid))
        return unchecked(self, feedback_every=grid.step / parts)


CALM = Disturbance(0.0)
"""Disturbance of scenarios without one: no wind, exact estimates, one sample a step."""


def _most_per_step(grid: Grid) -> int:
    """Return the largest number of feedback samples in a step of a grid."""
    return min(_MOST_IN_A_STEP, max(1, _MOST // (grid.knots - 1)))
