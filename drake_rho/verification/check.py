"""`Check`: one constraint of one vehicle at its worst instant, and columns of them for a fleet."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Self

import numpy as np

from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray

AT_KNOTS, AT_ALL_TIMES = "at knots", "at all times"
"""Instants at which a constraint is verified, as named in `Check.part`."""

MEASURED = "at measured samples"
"""Instants at which states were measured: a check of these states, not of the motion."""

PRECISION = 0.01
"""Precision of the worst values between the knots, as a fraction of a constraint's tolerance."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Check(metaclass=Described):
    """Check of one constraint of one vehicle, at the instant where it is worst."""

    vehicle: str
    """name of the vehicle"""
    kind: str
    """kind of requirement: dynamics, goals, a limit's field, waypoints, obstacles or separation"""
    constraint: str
    """name of the constraint: dynamics, goal, position box, velocity box, acceleration box,
    jerk box, maximum speed, maximum acceleration, maximum thrust, maximum tilt, waypoint 1, …,
    obstacle 1, obstacle 2 (intruder), …, separation"""
    part: str = ""
    """side of a box, quantity of dynamics and goal, or partner and instants; empty if the
    constraint has one part only"""
    time: float
    """time on the scenario's clock [s]"""
    value: float
    """value of the plan, in `unit`; for an obstacle the signed distance, negative inside"""
    limit: float
    """bound on the value, in `unit`, tightened by the error radius; for an obstacle the sum of the
    vehicle's radius, the deviation of the obstacle's track, and the error radius"""
    excess: float
    """amount by which the value is beyond the limit, in `unit`; negative where the constraint holds
    with a margin"""
    tolerance: float
    """excess that is attributed to rounding, in `unit`: `TOLERANCE` times the constraint's scale"""
    errors: float = 0.0
    """part of the limit that is reserved for errors, in `unit`: how far the vehicle may be from its
    plan, or the sum for both vehicles of a pair; 0 without a disturbance"""
    unit: str
    """SI unit of value, limit, excess, tolerance and errors"""
    asked: bool = True
    """whether the scenario requires the constraint; others are reported only"""
    penalty: float | None = None
    """cost of each unit of excess, the vehicle's weight included [m²/s⁴ per unit], if the
    limit is soft; such a limit is not required"""
    deciding_rate: float | None = None
    """of a sampled motion that may or may not violate the constraint: about the number of samples a
    second that would decide, infinite if none does [1/s]; None for a check that is decided"""

    @property
    def price(self) -> float | None:
        """Price of the excess of a soft limit [m²/s⁴], 0 where it holds; else None."""
        if self.penalty is None:
            return None
        return 0.0 if self.holds else self.penalty * self.excess

    @property
    def is_measured(self) -> bool:
        """Whether it is of measured states, at the samples, and not of the motion."""
        return self.part.endswith(MEASURED)

    @property
    def what(self) -> str:
        """Name of the constraint and its part."""
        return f"{self.constraint} {self.part}".rstrip()

    @property
    def left(self) -> float:
        """Margin between the value and its limit, in `unit`; negative if it is violated."""
        return 0.0 - self.excess  # never -0.0

    @property
    def holds(self) -> bool:
        """True if the excess is within the tolerance; False if it is NaN."""
        return self.excess <= self.tolerance

    @property
    def is_undecided(self) -> bool:
        """Whether the samples of a motion neither show that it holds nor that it is violated."""
        return self.deciding_rate is not None

    @property
    def badness(self) -> float:
        """Excess for comparing checks of one constraint; NaN is the worst."""
        return np.inf if np.isnan(self.excess) else self.excess


@dataclasses.dataclass(frozen=True, kw_only=True)
class Column:
    """One check of every vehicle: the fields of `Check` as arrays of shape (N,)."""

    kind: str  # of the requirement that is checked, one of `KINDS`
    constraint: str
    parts: Sequence[str]
    times: FloatArray
    values: FloatArray
    limits: FloatArray
    excess: FloatArray
    tolerances: FloatArray
    errors: FloatArray
    unit: str
    concerned: BoolArray  # which vehicles have this constraint
    asked: bool = True
    partners: IntArray | None = None  # index of the other vehicle of each pair
    penalties: FloatArray | None = None  # of a soft limit, per unit of excess
    rates: FloatArray | None = None  # that would decide, NaN where it is decided [1/s]

    @property
    def is_at_knots(self) -> bool:
        """Whether it covers the knots only, and another column covers every instant."""
        return self.parts[0].endswith(AT_KNOTS)

    @property
    def is_at_all_times(self) -> bool:
        """Whether it covers every instant, and another column covers the knots."""
        return self.parts[0].endswith(AT_ALL_TIMES)

    @property
    def holds(self) -> bool:
        """True if no vehicle violates the constraint, or if the scenario does not require it."""
        met = (self.excess <= self.tolerances) | ~self.concerned
        return not self.asked or bool(met.all())

    def softened(self, penalties: FloatArray | None, *, counted: bool = True) -> Self:
        """Return the column of a soft limit; itself if that is None.

        Args:
            penalties: cost of each unit of excess of every vehicle [m²/s⁴ per unit], shape (N,).
            counted: whether the excess is that of the worst required instant, which has the price.
        """
        if penalties is None:
            return self
        return dataclasses.replace(self, asked=False, penalties=penalties if counted else None)

    def where(self, concerned: BoolArray) -> Self:
        """Return the column for those of its vehicles that a flag selects, shape (N,)."""
        return dataclasses.replace(self, concerned=self.concerned & concerned)

    def is_beyond(self, vehicle: int, part: float = 1.0) -> bool:
        """Return whether a vehicle is beyond a limit by more than a part of the tolerance."""
        beyond = not self.excess[vehicle] <= part * self.tolerances[vehicle]  # true for NaN as well
        return beyond and bool(self.concerned[vehicle])

    def checks(self, names: Sequence[str]) -> list[Check | None]:
        """Return the check of each vehicle; None for a vehicle without this constraint."""
        numbers = (self.times, self.values, self.limits, self.excess, self.tolerances, self.errors)
        rows = zip(*[each.tolist() for each in numbers], strict=True)
        checks = list[Check | None]()
        prices = [None] * len(names) if self.penalties is None else self.penalties.tolist()
        rates = [np.nan] * len(names) if self.rates is None else self.rates.tolist()
        for has_it, name, part, (
            time,
            value,
            limit,
            excess,
            tolerance,
            error,
        ), penalty, rate in zip(
            self.concerned.tolist(), names, self.parts, rows, prices, rates, strict=True
        ):
            if not has_it:
                checks.append(None)
                continue
            own = Check(
                vehicle=name,
                kind=self.kind,
                constraint=self.constraint,
                part=part,
                time=time,
                value=value,
                limit=limit,
                excess=excess,
                tolerance=tolerance,
                errors=error,
                unit=self.unit,
                asked=self.asked,
                penalty=penalty,
                deciding_rate=None if np.isnan(rate) else rate,
            )
            checks.append(own)
        return checks
